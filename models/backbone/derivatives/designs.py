"""Directions in which the numbers of the rods themselves change: precurvature, stiffnesses, lengths of sections.

Numbers in parentheses are those of ``docs/derivatives.md``.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from multirod.models.backbone.derivatives.behind_plate import BehindPlate
from multirod.models.backbone.inputs import LOADS
from multirod.models.backbone.kernels.layout.rows import DesignOffsets
from multirod.models.backbone.kernels.loads.foundation import Foundation
from multirod.models.backbone.kernels.loads.magnetic import Magnetic
from multirod.models.backbone.units import unit_stiffness
from multirod.rotations import cross_matrix
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem
    from multirod.models.network.problem import NetworkProblem
    from multirod.models.platform.problem import ParallelProblem
    from multirod.rod import Rod

AROUND = (Foundation.of_section,)  # what goes with the frame of the base
BY_LOAD = (*AROUND, Magnetic.of_section)
# numbers of a section
COMPONENTS = {"precurvature": 3, "bending_stiffness": 2, "torsional_stiffness": 1, "length": 1, **dict.fromkeys(BY_LOAD, 3)}
PARAMETERS = (*COMPONENTS, "base")
POSE = 6
DEAD = tuple(spec.name for spec in LOADS if not spec.follows)  # fixed in the world


def parameter_size(name: str, rods: Sequence["Rod"]) -> int:
    """How many columns derivatives by a parameter of a backbone have."""
    return POSE if name == "base" else len(rods) * max(len(rod.sections) for rod in rods) * COMPONENTS[name]


def design_options(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Options of a problem whose directions change these numbers of sections, among other names."""
    own = tuple(sorted({name for name in names if name in COMPONENTS}))
    return {"design": own} if own else {}


def refuse_unknown(names: Sequence[str], rods: Sequence["Rod"]) -> None:
    """Refuse parameters by which the derivatives of such rods are not known, by a ``NotImplementedError``."""
    asked = [name for name in names if name in COMPONENTS]
    if not asked:
        return
    by = f"the derivatives by {', '.join(asked)} of a rod"
    if any(rod.members for rod in rods):
        raise NotImplementedError(f"{by} with members are not known: their numbers may depend on those of the rod")
    lines = [line for rod in rods for line in rod.lines]
    if any(line.rubs for line in lines):
        raise NotImplementedError(f"{by} whose line has friction are not known: take differences (docs/estimation.md)")
    if lines and "length" in asked:
        raise NotImplementedError(f"{by} with lines are not known: where these end moves too")
    if "precurvature" in asked and any(line.conditioned for line in lines):
        raise NotImplementedError(f"{by} whose line is driven by displacement are not known: its length at rest varies")
    if lines and len(rods) > 1 and ("bending_stiffness" in asked or "torsional_stiffness" in asked):
        raise NotImplementedError(f"{by} among several, one of which has lines, are not known")


def carried(lever: FloatArray) -> FloatArray:
    """(D10) How a pose moves with the base, that is ``lever`` (batch, 3) away from it in the world, shape (batch, 6, 6)."""
    result = np.zeros((len(lever), POSE, POSE))
    result[:] = np.eye(POSE)
    result[:, :3, 3:] = -cross_matrix(lever)
    return result


def turned_loads(problem: "BackboneProblem | ParallelProblem | NetworkProblem", loads: Sequence[str]) -> FloatArray:
    """(D10) Directions by the pose of the base: ``loads``, that are fixed in the world, turn the other way, seen from it.

    Shape (instance_count, 6, input_count).
    """
    if problem.inputs_given.profiles:
        raise NotImplementedError("the derivatives by base are not known where loads are functions of arclength")
    inputs = problem.read("inputs")
    rows = np.zeros((problem.instance_count, POSE, problem.directions.shape[2]))
    for place in map(problem.input_slice, loads):
        for first in range(place.start, place.stop, 3):  # of a network, one for each place
            own = slice(first, first + 3)
            rows[:, 3:, own] = np.swapaxes(cross_matrix(inputs[:, own]), 1, 2)
    return rows


class Designs:
    """Changes of the rods of a ``BackboneProblem``, along every number of a parameter.

    A change is a change of the tables that its kernel reads, (D4): ``end``, ``shift`` (of the law of precurvature), ``bending``,
    ``softness`` (of the inverse of both bending stiffnesses and of the torsional one, relative to it), ``precurvature``, and the
    vector of ``loaded``, (D24), each of shape (batch, direction, rod, piece, ...).
    """

    def __init__(self, problem: "BackboneProblem", name: str) -> None:
        self.problem, self._name = problem, name
        arrays = problem.arrays
        batch, rods, pieces = arrays.end.shape
        self._sections = int(arrays.section.max()) + 1
        self.count: int = rods * self._sections * COMPONENTS[name]
        shape = (batch, self.count, rods, pieces)
        self.end, self.shift = np.zeros(shape), np.zeros(shape)
        self.bending = np.zeros((*shape, 2))
        self.softness = np.zeros((*shape, 3))
        self.precurvature = np.zeros((*shape, arrays.precurvature.shape[-1]))
        self.loaded = np.zeros((*shape, 3))
        self._set(name)

    def _set(self, name: str) -> None:
        arrays, count = self.problem.arrays, COMPONENTS[name]
        material = arrays.material
        for i in range(arrays.end.shape[1]):
            for section in range(self._sections):
                own = (arrays.section[:, i] == section).astype(np.float64)
                there = own.any(axis=1, keepdims=True)
                for k in range(count):
                    at = (i * self._sections + section) * count + k
                    if name == "precurvature":
                        self.precurvature[:, at, i, :, k] = own
                    elif name in BY_LOAD:
                        self.loaded[:, at, i, :, k] = own
                    elif name == "length":
                        after = there & (arrays.section[:, i] > section)
                        last = np.where(own > 0, arrays.end[:, i], -np.inf).max(axis=1, keepdims=True)
                        self.shift[:, at, i] = after
                        self.end[:, at, i] = after | ((own > 0) & (arrays.end[:, i] == last))
                    elif name == "bending_stiffness":
                        self.bending[:, at, i, :, k] = own
                        self.softness[:, at, i, :, k] = -own / material[:, i, :, k]
                    else:  # one that is rigid stays so
                        self.softness[:, at, i, :, 2] = -own * material[:, i, :, 5]

    def rows(self) -> FloatArray:
        """Directions as kernels read them, shape (instance_count, direction, input and rods)."""
        if not self.problem.transmission:
            return self.rows_at_rest
        result = self.rows_at_rest.copy()
        result[..., self.problem.input_slice("rotation")] = self._behind.turns()
        return result

    @cached_property
    def _behind(self) -> BehindPlate:
        return BehindPlate(self.problem, [self])

    @cached_property
    def rows_at_rest(self) -> FloatArray:
        """The same but for (D8), by which they depend on inputs and unknowns."""
        problem = self.problem
        terms = problem.arrays.precurvature.shape[-1]
        at = DesignOffsets(terms // 3, problem.features.loads)
        values = np.zeros((*self.end.shape, at.SIZE))
        values[..., at.END], values[..., at.SHIFT] = self.end, self.shift
        values[..., at.BENDING : at.BENDING + 2] = self.bending
        values[..., at.SOFTNESS : at.SOFTNESS + 3] = self.softness
        values[..., at.PRECURVATURE : at.PRECURVATURE + terms] = self.precurvature
        if (first := at.LOADS.get(self._name)) is not None:  # else it does not act
            values[..., first : first + 3] = self.loaded
        result = np.zeros((problem.instance_count, self.count, problem.input_count + values[0, 0].size))
        result[..., problem.input_count :] = values.reshape(len(values), self.count, -1)
        return result

    def unknown_rates(self) -> FloatArray:
        """(D9) By how much the unknowns must change for moments, torques and forces at the base to stay what they are.

        Shape (instance_count, n, direction).
        """
        problem = self.problem
        x, slots, features = problem.read("unknowns"), problem.slots, problem.features
        material = problem.each(problem.arrays.material)[:, :, 0]
        unit = unit_stiffness(material)
        bending = problem.each(self.bending)[..., 0, :]  # of the first pieces: (instance, direction, rod, 2)
        largest = self._largest()
        twisting = np.where(
            (material[..., 2] < material[..., :2].max(axis=-1))[:, None],
            -problem.each(self.softness)[..., 0, 2] * np.where(np.isfinite(material[..., 2]), material[..., 2], 0.0)[:, None],
            largest,
        )
        result = np.zeros((problem.instance_count, problem.unknown_count, self.count))
        relative = twisting / unit[:, None, :, 2]
        alone = not features.turning_count
        if features.moment:
            place = slots.places["moment"]
            if alone:
                curved = problem.each(problem.arrays.precurvature)[:, 0, 0, :3]
                rates = np.stack([bending[..., 0, 0], bending[..., 0, 1], twisting[..., 0]], axis=-1) / unit[:, None, 0]
                result[:, place] = np.swapaxes(
                    problem.each(self.precurvature)[:, :, 0, 0, :3] - rates * (x[:, None, place] - curved[:, None]), 1, 2
                )
            else:
                total = material[..., :2].max(axis=-1).sum(axis=-1)
                rates = np.repeat((largest.sum(axis=-1) / total[:, None])[..., None], 3, axis=-1)
                rates[..., 2] = relative[..., 0]
                result[:, place] = -np.swapaxes(rates * x[:, None, place], 1, 2)
        torques = slots.places["torques"]
        if torques.stop > torques.start:
            own = relative[..., features.rod_count - features.torque_count :]
            result[:, torques] = -np.swapaxes(own * x[:, None, torques], 1, 2)
        for name in ("drives", "force"):
            place = slots.places[name]
            rates = largest[..., 0] / material[:, 0, :2].max(axis=-1)[:, None]
            result[:, place] = -x[:, place, None] * rates[:, None]
        return result

    def _largest(self) -> FloatArray:
        """How the larger bending stiffness of each rod's first piece changes, shape (instance_count, direction, rod)."""
        material = self.problem.each(self.problem.arrays.material)[:, :, 0]
        larger = material[..., :2] == material[..., :2].max(axis=-1, keepdims=True)
        larger = larger / larger.sum(axis=-1, keepdims=True)  # of both where they are the same, as where they change together
        return np.asarray((self.problem.each(self.bending)[..., 0, :] * larger[:, None]).sum(axis=-1))

    def largest(self) -> FloatArray:
        """The same of one rod, shape (instance_count, direction)."""
        return self._largest()[..., 0]
