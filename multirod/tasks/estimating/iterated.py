"""Samples of an estimator that lead far. Numbers in parentheses: ``docs/estimation.md``."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.status import Status

if TYPE_CHECKING:
    from multirod.tasks.estimating.filtering import FilterTrack

BENT = 2.0  # (28) standard deviations, by which rows may be off
PASSES = 4  # updates of a sample, beside the first


def iterated(track: "FilterTrack", once: NDArray[np.int32]) -> NDArray[np.int32]:
    """(28) Make the update of a sample again where it led to, until it leads no farther.

    Args:
        track: After that update.
        once: Integrations that it took, shape (b,).

    Returns:
        How many it took in all, shape (b,).
    """
    known, problem, spent = track.known, track.problem, once.copy()
    rows, doubt = np.flatnonzero(known.bent > BENT), known.state["doubt"]
    for _ in range(PASSES):
        if not len(rows):
            break
        before = {name: own.values[rows] for name, own in known.state.items()}
        begun = problem.read("unknowns")
        track.again(rows)
        spent[rows] += 1
        x = problem.read("unknowns")
        nearer = (known.status[rows] == Status.TRACKING) & (known.state["moved"].values[rows] < before["moved"])
        nearer &= ((x > 0) == (begun > 0))[rows][:, problem.kinks].all(axis=1)  # of lines: (27) has told their sides
        back = rows[~nearer]
        if len(back):
            for name, own in known.state.items():
                own.values[back] = before[name][~nearer]
                own.send()
            x[back] = begun[back]
            track.task.write(x, known.mean)
        doubt.values[rows] = np.maximum(doubt.values[rows], before["doubt"])  # what there was on the way counts too
        rows = rows[nearer & (known.bent[rows] > BENT)]
    return spent
