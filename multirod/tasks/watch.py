"""Whether samples of a controller or an estimator are stable: looked at where a mode may have been lost since the last look."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.linalg.lapack import dgetrf, dgetri

from multirod.batch import IntArray, solved_each
from multirod.kernels.shared import Shared
from multirod.stability import modes_of
from multirod.tasks.formulation import Task
from multirod.tasks.watch_kernels import ELSE_COMPARE, FASTER, LOOK_AGAIN, SURE, UNTOLD, Watched
from multirod.validation import FloatArray

PROBED = 1e-2  # (17c) in units (9): steps of differences of ``Gamma``, which its second order is part of
LEAST_GROWN = 0.1  # (17c) of the fastest growth: a direction without any to first order may have some to second
LEAST_GONE = 1e-3  # (17d) way, in units (9), that tells how ``Gamma`` varies
LARGE = 16  # unknowns, from which what one freed number changes ``Gamma`` by is work for a sample
AT_ONCE = 2  # of these in one sample
HASTY = 0.6  # (17) from which what renews ``Gamma_0`` is done at once: at 0.8 a sample would take an integration more
SURELY = 0.5  # (17e) of a correction of Newton's method, that the next one is at most where an equilibrium is near
# (17e) times that ``Gamma`` may change by its own size on the way to an equilibrium: what is farther may be another
NEARBY = 3.0
SETTLED, ROUNDED = 1e-4, 1e-9  # corrections in scales of curvature: of what is at its equilibrium, and of what is rounding
BALANCING = 6  # passes of scales, after which they stay as they are to some per cent


class Watch:
    """Keeps ``Gamma`` of the last sample of each instance that is known to be stable ((17) of ``docs/tasks.md``).

    Args:
        task: Whose samples are watched.
        unit: (9), shape (k,).

    Attributes:
        state: The argument of kernels.
        strain: (17f) Of each instance, how much of what vouches for it the last ``look`` took, shape (b,): what took more than 1
            is not known to be stable.
    """

    def __init__(self, task: Task, unit: FloatArray) -> None:
        self._task, self._unit, self._problem = task, unit, task.problem
        problem = task.problem
        problem.expect_judging()
        count, n = problem.instance_count, problem.unknown_count
        self.strain = np.zeros(count)
        self.state: Any = Watched()
        self.state.on = int(problem.stability is not None)
        sizes = {"anchor": (n, n), "inverse": (n, n), "scale": (n,), "room": (1, n), "compared": (2,)}
        sizes |= dict.fromkeys(("place", "here", "command"), (task.count,)) | {"growth": (task.count, task.count), "least": (2,)}
        self._shared = {name: Shared((count, *size), wp.float64, problem.device) for name, size in sizes.items()}
        for name, each in self._shared.items():
            setattr(self.state, name, each.array)
        self._shared["inverse"].write(np.nan)
        self._scaled = np.zeros(count, dtype=bool)
        self._slopes = np.zeros((count, task.count, n, n))  # (17c) of ``Gamma`` by what is free, in units (9)
        self._anchored = np.zeros((count, task.count))  # what is free at ``anchor``, in units (9)
        self._others = np.zeros((count, problem.input_count))  # and what is not
        # of instances that were kept since the last sample: their way to there, if one tells, and by how much ``Gamma`` changed
        self._due: list[tuple[int, FloatArray | None, FloatArray]] = []
        self._renewal: Iterator[None] | None = None  # under way, a piece of it in each sample

    def gamma(self) -> FloatArray:
        """Of the last integration, shape (b, n, n)."""
        n = self._problem.unknown_count
        return np.asarray(self._problem.read("gamma").reshape(-1, n, n))

    def _far(self, rows: IntArray, gamma: FloatArray) -> FloatArray:
        """The left side of (17) of some instances at ``gamma`` (k, n, n), shape (k,)."""
        return self._size(rows, gamma - self._shared["anchor"].values[rows])

    def _size(self, rows: IntArray, change: FloatArray) -> FloatArray:
        """A ``change`` of ``Gamma`` (k, n, n) as (17) has it, shape (k,)."""
        inverse, scale = (self._shared[name].values[rows] for name in ("inverse", "scale"))
        with np.errstate(invalid="ignore", over="ignore"):
            off = inverse.swapaxes(1, 2) @ change * scale[:, None]
            return np.asarray(np.sqrt((off * off).sum(axis=(1, 2))))

    def begin(self, rows: IntArray, gamma: FloatArray) -> None:
        """Some instances stand at a place that is stable, as far as can be said, with ``gamma`` (k, n, n). How it varies there is
        found by an integration for each freed number; the problem is where it was."""
        task, chosen = self._task, np.zeros(self._problem.instance_count, dtype=bool)
        chosen[rows] = True
        if not len(rows):
            return
        self.catch_up()
        x, p = np.array(self._problem.read("unknowns")), task.values()
        by = np.zeros((*x.shape, task.count))
        by[rows] = task.last(rows).eliminated[1]
        for j, unit in enumerate(self._unit):
            step = np.zeros(task.count)
            step[j] = PROBED * unit
            self._slopes[rows, j] = (task.evaluate(x + by @ step, p + step, chosen).gamma - gamma) / PROBED
        task.write(x, p)
        self._stand(rows, 0.0)
        self._anchored[rows], self._others[rows] = np.nan, np.nan  # no way led here
        self.keep(rows, gamma)

    def _stand(self, rows: IntArray, off: FloatArray | float, then: FloatArray | float = 0.0) -> None:
        """Some instances are compared where the problem is, and are so far ``off`` there; what is done with the next sample."""
        place, compared = self._shared["place"], self._shared["compared"]
        place.fetch()
        compared.fetch()
        place.values[rows] = self._task.values()[rows] / self._unit
        compared.values[rows, 0], compared.values[rows, 1] = off, then
        place.send()
        compared.send()

    def keep(self, rows: IntArray, gamma: FloatArray) -> None:
        """Some instances are stable at ``gamma`` (k, n, n), that of the last comparison, as far as can be said; one that is
        singular is no place to go by. How ``Gamma`` varies there is left to ``catch_up``."""
        self._renewal = None
        anchor, inverse, scale, compared = (self._shared[name] for name in ("anchor", "inverse", "scale", "compared"))
        place = self._shared["place"]
        compared.fetch()
        place.fetch()
        compared.values[rows, 0] = 0.0
        others = self._problem.read("inputs")
        others[:, self._task.places] = 0.0
        for row, own in zip(rows.tolist(), gamma, strict=True):
            self._due.append((row, self._gone(row, place.values[row], others[row]), own - anchor.values[row]))
            self._anchored[row], self._others[row] = place.values[row], others[row]
            anchor.values[row], inverse.values[row] = own, np.nan
            if not np.isfinite(own).all():
                continue
            transposed = _inverse(own.T)
            if transposed is None:
                continue
            if not self._scaled[row]:
                scale.values[row], self._scaled[row] = _balance(np.abs(transposed.T) @ np.abs(own)), True
            inverse.values[row] = transposed / scale.values[row]
        for each in (anchor, inverse, scale, compared):
            each.send()

    def _gone(self, row: int, place: FloatArray, others: FloatArray) -> FloatArray | None:
        """The way of an instance from where ``Gamma_0`` was found to ``place`` (k,), in units (9), if it tells how that varies:
        it is no short one, and what is not free is the same."""
        gone = np.asarray(place - self._anchored[row])
        # NaN is neither: no way led here
        return gone if np.abs(gone).max() > LEAST_GONE and (others == self._others[row]).all() else None

    def catch_up(self) -> None:
        """(17c), (17d) How ``Gamma`` varies where instances were kept: before the next sample, lest one bears all of the work."""
        if not self._due:
            return
        for row, gone, change in self._due:
            for _ in self._varied(row, gone, change, self._shared["inverse"].values[row]):
                pass
        self._due.clear()
        for name in ("growth", "least"):
            self._shared[name].send()

    def _varied(self, row: int, gone: FloatArray | None, change: FloatArray, inverse: FloatArray) -> Iterator[None]:
        """Pieces of the work after which the slopes of an instance are right along the way ``gone``, on which ``Gamma_0`` changed
        by ``change`` (n, n), (17d), and ``Q`` is theirs, (17c), if ``inverse``, as ``Watched`` has it, is known."""
        slopes, scale = self._slopes[row], self._shared["scale"].values[row]
        left = None if gone is None else change - np.tensordot(gone, slopes, 1)
        yield
        off, step = np.empty_like(slopes), AT_ONCE if len(change) > LARGE else len(slopes)
        for first in range(0, len(slopes), step):
            own = slice(first, first + step)
            if gone is not None and left is not None:
                slopes[own] += np.multiply.outer(gone[own] / (gone @ gone), left)
            np.matmul(inverse.T, slopes[own], out=off[own])
            off[own] *= scale
            yield
        if np.isfinite(inverse[0, 0]):
            self._grow(row, off)

    def renew(self) -> None:
        """The only instance is stable at the last integration's ``Gamma``: from some samples on it is what others are compared
        with, as ``keep`` says. A piece of the work is done in each call of ``go_on``; one renewal at a time."""
        if self._renewal is not None:
            return
        gamma, place = self.gamma()[0], self._shared["place"].fetched()[0].copy()
        others = self._problem.read("inputs")[0]
        others[self._task.places] = 0.0
        self._renewal = self._renewed(gamma, place, others)

    def go_on(self) -> None:
        """Do what is to be done in each sample: a piece of what ``renew`` began, or what ``keep`` left."""
        if self._renewal is None:
            self.catch_up()
            return
        hasty = float(self._shared["compared"].fetched()[0, 0]) > HASTY
        for _ in self._renewal:
            if not hasty:
                return
        self._renewal = None

    def _renewed(self, gamma: FloatArray, place: FloatArray, others: FloatArray) -> Iterator[None]:
        """(17c), (17d) Pieces of a renewal; after them ``gamma`` (n, n) at what is free (k,) is ``Gamma_0``."""
        if not np.isfinite(gamma).all():
            return
        factors, pivots, failed = dgetrf(gamma.T)
        if failed:
            return
        yield
        transposed, failed = dgetri(factors, pivots, overwrite_lu=1)
        if failed:
            return
        anchor, inverse = self._shared["anchor"], self._shared["inverse"]
        back = np.asarray(transposed) / self._shared["scale"].values[0]
        yield
        yield from self._varied(0, self._gone(0, place, others), gamma - anchor.values[0], back)
        anchor.values[0], inverse.values[0] = gamma, back
        self._anchored[0], self._others[0] = place, others
        for name in ("anchor", "inverse", "growth", "least"):
            self._shared[name].send()
        self.compare()

    def _grow(self, row: int, off: FloatArray) -> None:
        """(17c) ``Q`` of an instance by ``F`` (k, n, n), and what it is at least."""
        off = off.reshape(len(off), -1)
        found = off @ off.T
        if not np.isfinite(found).all():
            off[~np.isfinite(off).all(axis=1)] = UNTOLD / np.sqrt(off.shape[1])
            found = off @ off.T
        self._shared["growth"].values[row] = found
        fastest = np.sqrt(found.diagonal().max())
        self._shared["least"].values[row] = LEAST_GROWN * fastest, max(UNTOLD, fastest)

    def compare(self) -> None:
        """The next sample, however short its way: something else has changed."""
        compared = self._shared["compared"]
        compared.fetch()
        compared.values[:, 1] = np.maximum(compared.values[:, 1], ELSE_COMPARE)
        compared.send()

    def look(self, rows: IntArray) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
        """Which of some instances are, to first order, at a stable equilibrium where the problem is, as far as that can be said,
        and integrations of each, shapes (k,). The next samples are compared with these; what was in doubt is at its equilibrium.
        """
        self._integrate(rows)
        spent = np.ones(len(rows), dtype=np.int32)
        left, off = self._correction(rows)
        fastest, begun, pulled = self._shared["least"].values[rows, 1], self.gamma(), self._pulled(rows)
        stable = self._far(rows, begun[rows]) + FASTER * fastest * off < SURE  # (17b), at the command itself
        doubtful = np.flatnonzero(~stable)
        self.strain[rows] = 0.0
        if len(doubtful):
            settled, taken = self._settle(rows[doubtful], left[doubtful], off[doubtful])
            spent[doubtful] += taken
            there, gamma = doubtful[settled], self.gamma()
            own = rows[there]
            stable[there] = self._far(own, gamma[own]) < SURE
            change = self._size(own, gamma[own] - begun[own]) / NEARBY
            change[(self._pulled(own) != pulled[there]).any(axis=1)] = 0.0  # ``Gamma`` jumps there
            unsure = ~stable[there]
            self.strain[own[unsure]] = np.fmax(self.strain[own], change)[unsure]
            asked = there[unsure & (change < 1)]
            if len(asked):
                stable[asked] = ~self.unstable(rows[asked])
        gamma = self.gamma()[rows]
        self._stand(rows, self._far(rows, gamma), np.where(stable, 0.0, LOOK_AGAIN))
        self.keep(rows[stable], gamma[stable])
        return stable, spent

    def _settle(self, rows: IntArray, left: FloatArray, off: FloatArray) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
        """(17e) Bring some instances to their equilibria, from where ``_correction`` says; which came there, and integrations of
        each, shapes (k,)."""
        problem, off = self._problem, off.copy()
        settled, spent = off <= ROUNDED, np.zeros(len(rows), dtype=np.int32)
        pulled, turns = self._pulled(rows), np.full(len(rows), len(problem.kinks))
        open_ = np.flatnonzero(~settled)
        while len(open_):
            own = rows[open_]
            unknowns = np.array(problem.read("unknowns"))
            unknowns[own] += left[open_]
            problem.write("unknowns", unknowns)
            self._integrate(own)
            spent[open_] += 1
            left[open_], now = self._correction(own)
            there = self._pulled(own)
            turned = (there != pulled[open_]).any(axis=1) & (turns[open_] > 0)  # a step says nothing of the next across a kink
            pulled[open_], turns[open_] = there, turns[open_] - turned
            part = now / (SURELY * off[open_])
            nearer = (part <= 1) | (now <= ROUNDED) | turned
            self.strain[own] = np.fmax(self.strain[own], np.where((now <= ROUNDED) | turned, 0.0, part))
            settled[open_] = nearer & (now <= SETTLED)
            off[open_] = now
            open_ = open_[nearer & (now > SETTLED)]
        return settled, spent

    def _pulled(self, rows: IntArray) -> NDArray[np.bool_]:
        """Which lines with kinks some instances have taut, shape (k, line)."""
        return np.asarray(self._problem.read("unknowns")[rows][:, self._problem.kinks] > 0)

    def _integrate(self, rows: IntArray) -> None:
        chosen = np.zeros(self._problem.instance_count, dtype=bool)
        chosen[rows] = True
        with self._problem.only(chosen):
            self._task.integrate()

    def _correction(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """(2) ``a`` of some instances by the last integration, shape (k, n), and its size in scales of curvature, (k,)."""
        residual = self._problem.read("residual")[rows]
        left = np.asarray(-solved_each(self.gamma()[rows], residual[..., None])[..., 0])
        return left, np.abs(left).max(axis=1, initial=0.0) / self._problem.curvature_scale()[rows]

    def unstable(self, rows: IntArray) -> NDArray[np.bool_]:
        """Which of some instances are not stable at the problem's unknowns, as far as that can be said, shape (k,)."""
        problem = self._problem
        if problem.stability is None:
            return np.zeros(len(rows), dtype=bool)
        if len(rows) == problem.instance_count and problem.stability.surely_stable():
            return np.zeros(len(rows), dtype=bool)
        return modes_of(problem, rows).left


def _inverse(matrix: FloatArray) -> FloatArray | None:
    """Of a matrix in Fortran's order, None of a singular one; NumPy, which solves for unit columns, takes longer by half."""
    factors, pivots, failed = dgetrf(matrix)
    if failed:
        return None
    found, failed = dgetri(factors, pivots, overwrite_lu=1)
    return None if failed else np.asarray(found)


def _balance(matrix: FloatArray) -> FloatArray:
    """Scales ``S``, shape (n,), by which rows and columns of ``S^-1 A S`` are of like size."""
    scale = np.ones(len(matrix))
    for _ in range(BALANCING):
        scaled = matrix * scale / scale[:, None]
        scale *= np.sqrt(np.linalg.norm(scaled, axis=1) / np.linalg.norm(scaled, axis=0))
    return scale
