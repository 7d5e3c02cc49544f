"""Many starts for one backbone: base moments and torques that its equilibria can have."""

from collections.abc import Callable, Container, Iterable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import Starts
from multirod.models.backbone.units import unit_stiffness
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

_PARTS = 64  # of the length, over which starts are bounded
APART = 10_000  # numbers between the sequences of two members of an assembly
_CROWDING = 1.5  # most equilibria are far inside the bounds


class BackboneStarts(Starts):
    """Of a ``BackboneProblem``, at the inputs that it had when it was first asked for some."""

    def __init__(self, problem: "BackboneProblem") -> None:
        self.problem = problem

    @property
    def signs_add_up(self) -> bool:  # noqa: D102
        return not self.problem.features.condition_count

    def guesses(self, count: int, first: int = 0) -> FloatArray:  # noqa: D102
        n = len(self.problem.rods)
        moment, torque, unit = self._start_sizes
        points = quasirandom(np.arange(first, first + count), n + 2)[:, None]
        points = np.sign(points) * np.abs(points) ** _CROWDING
        torques = self.problem.features.torque_count
        slots = self.problem.slots
        parts = {name: np.zeros((count, self.problem.instance_count, 3)) for name in ("moment", "force")}
        parts["moment"][..., :2] = points[..., :2] * moment[:, None] * unit[:, :2]
        parts["torques"] = np.zeros((count, self.problem.instance_count, 0))
        parts["drives"] = np.zeros((count, self.problem.instance_count, self.problem.features.condition_count))
        if not torques:
            parts["moment"][..., 2] = points[..., 2] * moment * unit[:, 2]
            return np.asarray(slots.joined(parts) + self.problem.guess())
        tau = points[..., 2:] * torque
        if self.problem.features.eccentric:
            parts["torques"] = tau * unit[:, 2:]
            return np.asarray(slots.joined(parts))
        # all torques together balance the load
        tau[..., -1] = points[..., -1] * moment - tau[..., :-1].sum(axis=-1)
        turns = tau * unit[:, 2:]
        parts["moment"][..., 2], parts["torques"] = turns[..., 0], turns[..., 1:]
        return np.asarray(slots.joined(parts))

    @cached_property
    def _start_sizes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What bounds the equilibria: moment of the loads at the base [N m], (instance_count,), torques there that the tubes'
        precurvatures give each other [N m], (instance_count, n), and the unknowns of a unit moment or torque.
        """
        table = self.problem.arrays
        start = self.problem.read("inputs")[:, self.problem.input_slice("translation")]
        length = (table.end[:, :, -1] + start).max(axis=1)
        first = self.problem.each(table.material[:, :, 0, :3])
        bending = first[..., :2].max(axis=2)
        moment = self.problem.load_scale() * self.problem.each(table.material[:, 0, :, :3].min(axis=(1, 2))) / length
        torque = np.zeros((self.problem.instance_count, len(self.problem.rods)))
        pull = self.problem.lines.load_by_rod() if self.problem.drive_count else np.zeros_like(torque)
        for part in (np.arange(_PARTS) + 0.5) / _PARTS:
            stiffness, bend = self._bending_at((part * length)[:, None] - start)
            bend = bend + pull
            others = bend.sum(axis=1, keepdims=True) - bend
            torque += bend * others / stiffness.sum(axis=1, keepdims=True) * (length / _PARTS)[:, None]
        shared = np.broadcast_to(bending.sum(axis=1)[:, None], (self.problem.instance_count, 2))
        return moment, torque, 1 / np.concatenate([shared, unit_stiffness(first)[..., 2]], axis=1)

    def _bending_at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``EI`` [N m^2] and a bound of ``EI |u*_xy|`` [N m] of each rod at arclengths of its own, shape (instance_count, n)."""
        end = self.problem.each(self.problem.arrays.end)
        section = (s[..., None] >= end).sum(axis=2)[..., None]
        present = section[..., 0] < end.shape[2]
        section = np.minimum(section, end.shape[2] - 1)
        EI, kappa = self.problem.sizes.by_section
        values = (np.take_along_axis(value, section, axis=2)[..., 0] * present for value in (EI, EI * kappa))
        return next(values), next(values)


def twisted(
    members: Iterable[tuple["BackboneProblem", Sequence[int]]],
    x: FloatArray,
    numbers: IntArray,
    places: Callable[[int], IntArray],
    bent: Container[int] = (),
) -> FloatArray:
    """Unknowns of assemblies with the tubes of their rods turned against each other, each rod's own way.

    Args:
        members: Backbones of each build, and the numbers of their rods in an assembly.
        x: Unknowns [1/m], shape (instance_count, n).
        numbers: Of the entries meant of an endless sequence, by the first of which nothing is turned, shape (instance_count,).
        places: Where the unknowns of a rod stand among those of its assembly.
        bent: Rods that are bent too, as they start by themselves.
    """
    result, rows = np.array(x), np.flatnonzero(numbers > 0)
    for backbones, rods in members:
        if not backbones.features.torque_count:
            continue
        slots = backbones.slots.places
        for place, rod in enumerate(rods):
            at = np.r_[slots["moment"], slots["torques"]] if rod in bent else np.r_[slots["torques"]]
            for number in np.unique(numbers[rows]).tolist():
                own = np.flatnonzero(numbers == number)
                start = backbones.starts.guesses(1, number + APART * rod)[0, place :: len(rods)]
                result[np.ix_(own, places(rod)[at])] = start[np.ix_(own, at)]
    return result


def quasirandom(numbers: NDArray[np.int_], dimensions: int) -> FloatArray:
    """Points of a sequence that fills the cube from -1 to 1 evenly, number 0 in its centre, shape (len(numbers), dimensions).

    Roberts' additive recurrence: steps by powers of the generalised golden ratio.
    """
    ratio = 2.0
    for _ in range(40):
        ratio = (1 + ratio) ** (1 / (dimensions + 1))
    steps = ratio ** -np.arange(1.0, dimensions + 1)
    return np.asarray(2 * ((0.5 + np.outer(numbers, steps)) % 1) - 1)
