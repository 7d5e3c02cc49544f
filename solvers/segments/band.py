"""The Jacobians of multiple shooting of several instances: their factors, solutions, and how they change along a branch.

Numbers in parentheses are those of ``docs/solvers.md``.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.launch import record
from multirod.segments import Cuts, Propagation, replaced_rows
from multirod.solvers.continuation.acceptance import LARGEST_RATIO, RATIO_POWERS, SMALLEST_RATIO
from multirod.solvers.segments.band_kernels import Band, Krylov, Sides, change, factorise, solve
from multirod.status import BoolArray
from multirod.validation import FloatArray

VECTORS = 32  # of Arnoldi's method
SETTLED = 0.1  # how far an eigenvalue may be from where Arnoldi's method has it


@dataclass(frozen=True)
class Step:
    """A change of all unknowns of several instances, or a right-hand side of as many numbers.

    Attributes:
        own: Of the unknowns, or what is lacking at the tip, shape (count, n).
        rows: Of the states where segments begin, zero at the base, or the gaps at their ends, zero at the tip, shape
            (segment_count, d).
    """

    own: FloatArray
    rows: FloatArray

    def times(self, cuts: Cuts, factor: FloatArray) -> "Step":
        """Each instance's by a factor of its own, (count,)."""
        return Step(factor[:, None] * self.own, factor[cuts.owner, None] * self.rows)

    def plus(self, other: "Step") -> "Step":
        """The sum, on the same segments."""
        return Step(self.own + other.own, self.rows + other.rows)

    def chosen(self, cuts: Cuts, some: BoolArray) -> "Step":
        """Of some of the instances, (count,)."""
        return self if some.all() else Step(self.own[some], self.rows[some[cuts.owner]])

    def put(self, cuts: Cuts, some: BoolArray, others: Cuts, other: "Step") -> "Step":
        """This, of the segments ``cuts``, with that of ``others`` in place of some of the instances, (count,)."""
        if some.all():
            return other
        own = self.own.copy()
        own[some] = other.own
        return Step(own, np.concatenate([self.rows, other.rows])[replaced_rows(cuts, some, others)])

    def norm(self, cuts: Cuts) -> FloatArray:
        """Euclidean, of each instance, shape (count,)."""
        return np.asarray(np.sqrt((self.own**2).sum(axis=1) + np.add.reduceat((self.rows**2).sum(axis=1), cuts.first[:-1])))


class Systems:
    """The Jacobians (2) at some states, each of one instance; factored when first needed.

    Args:
        cuts: The segments.
        found: Where they lead.
        places: Of the unknowns among the variations at the base, shape (n,).
        device: Warp device.
    """

    def __init__(self, cuts: Cuts, found: Propagation, places: NDArray[np.intp], device: str) -> None:
        self.cuts, self.found, self.places, self.device = cuts, found, places, device
        self.n, self.d, self.count = len(places), found.transition.shape[1], len(cuts.instances)
        self._band: Any = None

    def chosen(self, some: BoolArray) -> "Systems":
        """Of some of the instances, (count,)."""
        if some.all():
            return self
        return Systems(self.cuts.chosen(some), self.found.chosen(self.cuts, some), self.places, self.device)

    def put(self, some: BoolArray, other: "Systems") -> "Systems":
        """These, with others in place of some of the instances, (count,)."""
        found = self.found.put(self.cuts, some, other.cuts, other.found)
        return Systems(self.cuts.put(some, other.cuts), found, self.places, self.device)

    def _array(self, values: Any, kind: Any = wp.float64) -> Any:
        # kernels only read it
        return wp.array(np.ascontiguousarray(values), dtype=kind, device=self.device, copy=not wp.get_device(self.device).is_cpu)

    def _zeros(self, *shape: int, kind: Any = wp.float64) -> Any:
        return wp.zeros(shape, dtype=kind, device=self.device)

    def _launch(self, kernel: Any, *arguments: Any) -> None:
        record(lambda: kernel, self.count, arguments, self.device).launch()

    @property
    def band(self) -> Any:
        """Arguments of kernels, factored."""
        if self._band is None:
            count, n, d = len(self.cuts.start), self.n, self.d
            self._band = band = Band()
            band.first = self._array(self.cuts.first.astype(np.int32), wp.int32)
            band.places = self._array(self.places.astype(np.int32), wp.int32)
            band.transition, band.tip = self._array(self.found.transition), self._array(self.found.residual_columns)
            band.factors, band.pivots = self._zeros(count, 2 * d - n, 2 * d), self._zeros(count, d, kind=wp.int32)
            band.singular, band.front = self._zeros(self.count, kind=wp.int32), self._zeros(count, 2 * d - n)
            self._launch(factorise, band)
        return self._band

    @property
    def singular(self) -> BoolArray:
        """Where elimination meets a pivot that is zero, or numbers that are not finite, shape (count,)."""
        return np.asarray(self.band.singular.numpy() != 0)

    def _sides(self, step: Step | None = None) -> Any:
        result: Any = Sides()
        if step is None:
            result.own, result.rows = self._zeros(self.count, self.n), self._zeros(len(self.cuts.start), self.d)
        else:
            result.own, result.rows = self._array(step.own), self._array(step.rows)
        return result

    def solve(self, right: Step) -> Step:
        """``J^-1`` times right-hand sides; NaN where it is singular."""
        x = self._sides()
        self._launch(solve, self.band, self._sides(right), x)
        return Step(np.array(x.own.numpy()), np.array(x.rows.numpy()))

    def same_branch(self, after: "Systems") -> BoolArray:
        """Whether no mode came near zero or changed sign between these equilibria and those ``after``, on the same breakpoints,
        shape (count,).

        The eigenvalues of ``J_new J_old^-1`` do not depend on the units of states and residuals, nor on the frames they are told
        in, and their product is the ratio of the determinants of ``Gamma``. Those of the breakpoints are one. Those furthest from
        one are found by Arnoldi's method; where it has not settled, the answer is no.
        """
        sound = ~(self.singular | after.singular)
        if not sound.any():
            return sound
        if not sound.all():
            result = sound.copy()
            result[sound] = self.chosen(sound).same_branch(after.chosen(sound))
            return result
        most = VECTORS
        space: Any = Krylov()
        space.own = self._zeros(self.count, most + 1, self.n)
        space.rows = self._zeros(len(self.cuts.start), most + 1, self.d)
        space.projected, space.left = self._zeros(self.count, most, most), self._zeros(self.count)
        space.along = self._zeros(self.count, most)
        self._launch(change, self.band, after.band, space, self._sides(), self._sides())
        return _near_one(np.array(space.projected.numpy()), np.array(space.left.numpy()))


def _near_one(shift: FloatArray, left: FloatArray) -> BoolArray:
    """Whether one and all eigenvalues of each matrix (count, m, m) lie where those of one branch do, (count,).

    ``left`` is how much leads out of the space in which the matrices are known, (count,).
    """
    result = np.zeros(len(shift), dtype=bool)
    finite = np.isfinite(shift).all(axis=(1, 2)) & np.isfinite(left)
    power, bound, E = 1.0, np.full(len(shift), np.inf), np.where(finite[:, None, None], shift, 0.0)
    while power <= RATIO_POWERS:
        bound = np.minimum(bound, np.linalg.norm(E, axis=(1, 2)) ** (1 / power))
        if (bound < 0.5 * (1 - SMALLEST_RATIO)).all():
            break
        E, power = E @ E, 2 * power
    # half of the radius, as Arnoldi's method need not have settled
    result[finite & (bound < 0.5 * (1 - SMALLEST_RATIO))] = True
    open_ = np.flatnonzero(finite & ~result)
    if len(open_):
        values, vectors = np.linalg.eig(shift[open_])
        apart = left[open_, None] * np.abs(vectors[:, -1])
        outside = np.abs(values) > 0.5 * (1 - SMALLEST_RATIO)
        values = 1 + values
        inside = (values.real > SMALLEST_RATIO) & (np.abs(values) < LARGEST_RATIO)
        result[open_] = (inside & ~(outside & (apart > SETTLED))).all(axis=1)
    return result
