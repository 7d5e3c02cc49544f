"""Which setting keeps a promise when it is run again."""

import numpy as np

from multirod.studies.tradeoffs.measurement import Measurement
from multirod.studies.tradeoffs.reference import AGREEMENT
from multirod.studies.tradeoffs.table import Measured
from multirod.validation import positive_float

MARGIN = 0.5  # of the time that a promised rate leaves: the next process took up to 1.9 times as long (docs/tradeoff.md)


def kept(measurement: Measurement, *, error: float | None = None, rate: float | None = None) -> Measured:
    """The best setting that keeps to ``error`` [m], or the time that ``rate`` leaves, when it is run on the whole motion.

    The grid's figures are the best of many, so flattered by luck, and may be of a part of the motion only; these are neither.

    Raises:
        ValueError: If there is none, or the reference could not be checked.
    """
    table = measurement.table
    if not table.checked:
        raise ValueError(
            f"the reference could not be checked: two of them are {table.reference_gap:.1e} of the length apart, not "
            f"{AGREEMENT:g}"
        )
    if rate is None:
        limit = positive_float("error", error)
        for row in table.fitting(error=limit):
            again = measurement.repeat(row.name)
            if again.position <= limit:
                return again
        raise ValueError(f"error = {error:g} is not allowed: no setting that kept to it at first did so on the whole motion")
    limit = MARGIN / positive_float("rate", rate)
    tried = []
    good = [row for row in table.rows if np.isfinite(row.position)]
    fastest = min(good, key=lambda row: row.slow, default=None)
    for row in table.fitting(time=limit) if fastest is None or fastest.slow <= limit else []:
        again = measurement.repeat(row.name)
        if again.slow <= limit and again.failed == 0:
            return again
        tried.append(again)
    fastest = min(tried or good, key=lambda row: row.slow)
    raise ValueError(
        f"rate = {rate:g} is not allowed: the fastest setting, {fastest.name}, takes {1e6 * fastest.slow:.0f} µs in 95 of 100 "
        f"samples, {1e6 * fastest.median:.0f} µs in the median; with {1 - MARGIN:.0%} of the time to spare that is "
        f"{MARGIN / fastest.slow:.0f} samples a second"
    )
