"""What a fit of parameters found, and what it says of those that it hardly saw."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from multirod.status import Status
from multirod.tasks.estimating.fit import Fit, Odd
from multirod.tasks.estimating.parameters import FACTOR, Key, Parameters
from multirod.validation import FloatArray

HARDLY_SEEN = 1.0  # deviation, of logarithms of factors over what was, of precurvatures in 1/m: a step there is a leap
ALONE, TAKES_PART = 0.95, 0.1  # component of a direction that is one number's, and of what is named of a mixture
ONE = 0.99  # part of all variance of numbers, that is along one direction


@dataclass(frozen=True)
class Fitted:
    """What a fit found, NaN where it failed, and what came of it; ``Calibration`` says of each.

    Attributes:
        places: Where the numbers of each parameter are among all.
        hardly_seen: Labels of numbers of which the measurements say next to nothing.
        mixture: Of these, where it is one mixture alone of which nothing is said, that direction; else empty.
        odd: Without which the others fit, where all do not.
        unknown: Names of the inputs that were found beside them.
        load_covariance: Of these, of each shape, (b, k, k).
    """

    places: dict[Key, slice]
    labels: tuple[str, ...]
    status: Status
    iterations: int
    integrations: int
    missing: NDArray[np.bool_]
    misfit: float
    degrees: int
    prior: FloatArray
    values: FloatArray
    covariance: FloatArray
    hardly_seen: tuple[str, ...]
    mixture: FloatArray = field(default_factory=lambda: np.zeros(0))
    odd: Odd | None = None
    unknown: tuple[str, ...] = ()
    load_covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0)))

    @property
    def unseen(self) -> str:
        """What is said of numbers that were hardly seen."""
        of, give = ", ".join(self.hardly_seen), "these"
        if len(self.mixture):
            of, give = f"a mixture, {mixed(self.hardly_seen, self.mixture)}", "one of these"
        return f"the measurements say next to nothing of {of}: give {give} a Prior, or measure more"


def mixed(labels: Sequence[str], direction: FloatArray) -> str:
    """A direction in words: what takes part in it, and by how much."""
    named = np.flatnonzero(np.abs(direction) > TAKES_PART)
    sign = np.sign(direction[np.abs(direction).argmax()])
    parts = [(sign * direction[k], labels[k].removesuffix(FACTOR)) for k in named.tolist()]
    return " ".join(f"{'-' if weight < 0 else '+'} {abs(weight):.2f} {label}" for weight, label in parts).removeprefix("+ ")


def fitted(numbers: Parameters, fit: Fit) -> Fitted:
    """What came of a fit of these numbers."""
    loads, shared = fit.loads, slice(fit.loads.shared)
    own, p = fit.covariance[shared, shared], fit.p[shared]
    hard = np.flatnonzero(np.sqrt(np.diagonal(own)) > HARDLY_SEEN)
    lost = np.nan if fit.status.failed else 1.0
    return Fitted(
        places=numbers.places,
        labels=numbers.labels,
        status=fit.status,
        iterations=fit.iterations,
        integrations=fit.integrations,
        missing=fit.missing,
        misfit=float(fit.square),
        degrees=fit.degrees,
        prior=numbers.covariance(p, numbers.prior),
        values=lost * numbers.values(p),
        covariance=lost * numbers.covariance(p, own),
        hardly_seen=tuple(numbers.labels[k] for k in hard.tolist()),
        mixture=_one_direction(own[np.ix_(hard, hard)]),
        odd=fit.odd,
        unknown=loads.names,
        load_covariance=lost * loads.blocks(fit.covariance),
    )


def _one_direction(covariance: FloatArray) -> FloatArray:
    """The unit vector along which nearly all of a covariance (k, k) is, of several numbers; empty where there is none."""
    if len(covariance) < 2 or not np.isfinite(covariance).all():
        return np.zeros(0)
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors[:, -1] if values[-1] > ONE * values.sum() else np.zeros(0))
