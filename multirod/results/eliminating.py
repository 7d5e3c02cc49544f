"""Unknowns eliminated from derivatives, and what is left of them where ``Gamma`` is singular to rounding.

Numbers in parentheses: ``docs/derivatives.md``.
"""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import solved_each
from multirod.kernels.elimination_kernels import eliminate_unknowns
from multirod.kernels.shared import Shared
from multirod.launch import record
from multirod.problem import BoundaryProblem
from multirod.validation import FloatArray
from multirod.warning import warn

POSE = 6
BoolArray: TypeAlias = NDArray[np.bool_]
LOST = 1e-14  # singular values of (D1e), over the largest, that are rounding: what integrations leave of it in Gamma
DOUBTFUL = 1e-10  # one over (D1d), below which singular values are asked for
ASIDE = 1e-8  # of a row or column, what of it may be along a direction that is lost


def eliminated(slopes: FloatArray, rows: FloatArray, gamma: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(D1) What is left of rows once the unknowns follow, shape (b, m, k); and of which instances ``Gamma``, singular to
    rounding, does not tell all of it (D1e), shape (b,): that is NaN.

    Args:
        slopes: Of the residual by numbers, shape (b, n, k).
        rows: By the unknowns, then by these numbers, shape (b, m, n + k).
        gamma: Shape (b, n, n); not finite where all is NaN.
    """
    n = gamma.shape[-1]
    solved = solved_each(gamma, np.concatenate([slopes, _probe(gamma)], axis=2))
    result = np.asarray(rows[:, :, n:] - rows[:, :, :n] @ solved[:, :, :-1])
    return result, untold(result, slopes, rows, gamma, doubtful(_reach(gamma, solved[:, :, -1])))


def pulled_back(cotangent: FloatArray, slopes: FloatArray, rows: FloatArray, gamma: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(D13) Cotangents (b, m) by the same numbers, shape (b, k), and of which instances ``Gamma`` does not tell all of it: what
    ``eliminated`` does not tell is NaN here too, where a cotangent asks for it."""
    n = gamma.shape[-1]
    c, across, turned = cotangent[..., None], np.swapaxes(rows, 1, 2), np.swapaxes(gamma, 1, 2)
    solved = solved_each(turned, np.concatenate([across[:, :n] @ c, _probe(gamma)], axis=2))
    result = (across[:, n:] @ c - np.swapaxes(slopes, 1, 2) @ solved[:, :, :1])[..., 0]
    silent = doubtful(_reach(turned, solved[:, :, -1]))
    asked = np.flatnonzero(silent)
    if len(asked):
        left, _ = eliminated(slopes[asked], rows[asked], gamma[asked])
        for k, own in zip(asked, left, strict=True):
            part = cotangent[k] != 0
            result[k] = cotangent[k, part] @ own[part]
        silent[asked] = np.isnan(result[asked]).any(axis=1)
    return np.asarray(result), silent


def doubtful(reach: FloatArray) -> BoolArray:
    """Of which instances singular values are to be asked for, by (D1d), shape (b,)."""
    return np.asarray(~(reach < 1 / DOUBTFUL))


def untold(result: FloatArray, slopes: FloatArray, rows: FloatArray, gamma: FloatArray, asked: BoolArray) -> BoolArray:
    """(D1e) Have NaN in the ``result`` (b, m, k) of (D1), of those ``asked`` (b,), where ``Gamma`` does not tell it, and what it
    tells elsewhere; of which instances that is so."""
    silent = np.zeros(len(asked), dtype=bool)
    for t in np.flatnonzero(asked):
        if not np.isfinite(gamma[t]).all():
            result[t] = np.nan
            continue
        n, (out, size, along) = gamma.shape[-1], np.linalg.svd(gamma[t])
        lost = size <= LOST * size[0]
        if not lost.any():
            continue
        sides, own = out.T @ slopes[t], rows[t, :, :n] @ along.T
        result[t] = rows[t, :, n:] - own[:, ~lost] @ (sides[~lost] / size[~lost, None])
        moved, pushed = _along(own[:, lost], own), _along(sides[lost].T, sides.T)
        result[t, moved] = np.nan
        result[t][:, pushed] = np.nan
        silent[t] = moved.any() or pushed.any()
    return silent


def _along(lost: FloatArray, whole: FloatArray) -> BoolArray:
    """Which rows (c, ...) have a part that is lost, beyond rounding of their own and of all."""
    size = np.linalg.norm(whole, axis=1)
    return np.asarray(np.abs(lost).max(axis=1, initial=0.0) > ASIDE * size + LOST * size.max(initial=0.0))


def _probe(gamma: FloatArray) -> FloatArray:
    """``b`` of (D1d), shape (b, n, 1)."""
    count, n = gamma.shape[:2]
    return np.broadcast_to((1.0 + 0.5 * np.cos(1.0 + np.arange(n)))[:, None], (count, n, 1))


def _reach(gamma: FloatArray, probed: FloatArray) -> FloatArray:
    """(D1d), shape (b,); ``Gamma^-1 b`` has shape (b, n)."""
    return np.asarray(np.abs(gamma).max(axis=(1, 2), initial=0.0) * np.abs(probed).sum(axis=1))


def warn_of_nan(names: Sequence[object], which: BoolArray, why: str) -> None:
    """Say that there are no derivatives by these names, of which instances (b,), and why."""
    if which.any():
        of = f" of {which.sum()} of {len(which)} instances" if len(which) > 1 else ""
        warn(f"derivatives by {', '.join(map(str, names))}{of} are NaN{why}", RuntimeWarning)


def warn_of_singular(names: Sequence[object], silent: BoolArray) -> None:
    """Say that ``Gamma`` does not tell some derivatives, of some instances (b,)."""
    warn_of_nan(
        names,
        silent,
        " where Gamma is singular to rounding and they hang on that: at a fold or a bifurcation, or of what moves at no cost; "
        "ask for them a little beside it",
    )


class Eliminated:
    """What is left of the pose's columns by all directions of a problem once the unknowns follow."""

    def __init__(self, problem: BoundaryProblem) -> None:
        count, n, k, device = problem.instance_count, problem.unknown_count, problem.residual_directions.shape[2], problem.device
        room: list[Any] = [wp.zeros((count, n, size), dtype=wp.float64, device=device) for size in (n, k + 1)]
        self._problem, self._columns = problem, (problem.residual_directions, problem.pose_columns)
        self._reach = Shared((count,), wp.float64, device)
        self._left = Shared((count, POSE, k), wp.float64, device)
        arguments = [problem.gamma, problem.residual_directions, problem.pose_columns, *room, self._left.array, self._reach.array]
        self._launch = record(eliminate_unknowns, count, arguments, device)

    def find(self) -> tuple[FloatArray, BoolArray]:
        """Of the last integration, shapes (instance_count, 6, k) and (instance_count,), as ``eliminated`` has it."""
        self._launch.launch()
        result, asked = np.array(self._left.fetched()), doubtful(self._reach.fetched())
        if not asked.any():
            return result, asked
        n = self._problem.unknown_count
        slopes, rows = (own.numpy() for own in self._columns)
        return result, untold(result, slopes, rows, self._problem.read("gamma").reshape(-1, n, n), asked)


def pose_derivative(problem: BoundaryProblem, names: Sequence[str]) -> tuple[FloatArray, BoolArray] | None:
    """(D1) By inputs and parameters, in one integration, as ``eliminated`` has it; None, and none is done, where more is to
    be looked at than what it leaves in place."""
    problem.eliminates, found = True, None
    if problem.leaves_columns(*names):
        left = problem.tool("eliminated", lambda: Eliminated(problem))  # compiled, the first time, at once with the integration
        problem.part_ends(names)
        problem.integrate_along(*names)
        found = left.find()
    problem.eliminates = False  # after an error it is not used again
    return found
