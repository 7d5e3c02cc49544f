"""How long and stiff the rods of each instance are, and how large what acts on them: bounds, and what results are counted in."""

from collections.abc import Iterable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from multirod.inputs import InputSpec
from multirod.models.backbone.inputs import LOADS
from multirod.models.backbone.kernels.layout.members import loads_in_material
from multirod.models.backbone.kernels.loads.load import Load
from multirod.rod import DENSITY
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem


WAVES = 4.0  # radians of waves in a medium, by which a segment amplifies a variation some twentyfold
PUSHED = 1.77  # the same of what pushes away: (28) of docs/stability.md, with a factor of 2 to spare


class Sizes:
    """Of a ``BackboneProblem``."""

    def __init__(self, problem: "BackboneProblem") -> None:
        self.problem = problem

    def ends(self) -> FloatArray:
        """Arclength at which each rod ends [m], shape (instance_count, n)."""
        inputs = self.problem.input_view()
        if inputs is None:
            inputs = self.problem.read("inputs")
        return np.asarray(self.problem.arrays.end[:, :, -1] + inputs[:, self.problem.input_slice("translation")])

    def furthest_end(self) -> FloatArray:
        """Arclength at which the last rod ends [m], shape (instance_count,)."""
        return np.asarray(self.ends().max(axis=1))

    def stiffness_over_length(self) -> FloatArray:
        """What stiffnesses of the tip are counted in [N m], shape (instance_count,): the least of the rods', over the length."""
        return np.asarray(self.least_stiffness / self.furthest_end())

    @cached_property
    def rigid_in_torsion(self) -> bool:
        """Whether a rod is, anywhere."""
        return not bool(np.isfinite(self.problem.arrays.material[..., 2]).all())

    @cached_property
    def least_stiffness(self) -> FloatArray:
        """The least of all that a rod resists bending or twisting with [N m^2], shape (instance_count,)."""
        return self.problem.each(self.problem.arrays.material[..., :3].min(axis=(1, 2, 3)))

    @cached_property
    def by_section(self) -> tuple[FloatArray, FloatArray]:
        """Larger ``EI`` [N m^2] and a bound of ``|u*_xy|`` [1/m] of each section, shape (instance_count, n, section)."""
        coefficients = self.problem.arrays.precurvature.reshape(*self.problem.arrays.precurvature.shape[:3], -1, 3)
        kappa = np.linalg.norm(coefficients[..., :2], axis=-1).sum(axis=-1)
        return self.problem.each(self.problem.arrays.material[..., :2].max(axis=-1)), self.problem.each(kappa)

    @cached_property
    def bend_by_section(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """``EI |u*_xy|`` [N m] of each section, (instance_count, n, section), the most of each rod together, (instance_count,),
        and ``|u*_xy|`` as ``by_section`` has it."""
        EI, kappa = self.by_section
        bend = EI * kappa
        return bend, bend.max(axis=2).sum(axis=1), kappa

    @cached_property
    def twist(self) -> FloatArray | float:
        """By which precurvature turns rods against each other [rad]."""
        if len(self.problem.rods) == 1 or self.problem.held:
            return 0.0
        size = np.diff(self.problem.arrays.end, axis=2, prepend=0.0)
        own = np.abs(self.problem.arrays.precurvature.reshape(*size.shape, -1, 3)[..., 2]).sum(axis=-1)
        return np.asarray((own * size).sum(axis=2).max(axis=1))

    @cached_property
    def curvature(self) -> FloatArray:
        """What curvatures of each instance are compared with [1/m], shape (instance_count,)."""
        arrays = self.problem.arrays
        bent = np.abs(arrays.precurvature).reshape(*arrays.precurvature.shape[:3], -1, 3).sum(axis=(3, 4))
        return self.problem.each(np.maximum(1 / arrays.end[:, 0, -1], bent.max(axis=(1, 2))))

    def load(self, inputs: FloatArray) -> FloatArray:
        """How much the loads of ``inputs`` (instance_count, input_count) can bend the rods, ``F L^2/EI``; (instance_count,)."""
        table, (stiffness, _) = self.problem.arrays, self._first_rod
        length = self._first_length(inputs)
        total = self._of_vectors(inputs, self.acting(inputs), length)
        for load in self.problem.features.loads:
            total += load.size(self)
        if self.problem.drive_count:
            total += self.problem.lines.load() * length / stiffness
        if self.problem.features.measured:
            gap = inputs[:, self.problem.input_slice("tip_curvature")] - table.precurvature[:, 0, -1, :3]
            total += np.linalg.norm(gap, axis=1) * length
        if self.problem.features.profile_degree >= 0:
            profile = self.problem.table.profile.numpy()
            size = np.abs(profile.reshape(len(profile), 6, -1)).sum(-1).max(0)
            total += (size[:3].max() * length**3 + size[3:].max() * length**2) / stiffness
        return total

    def load_change(self, before: FloatArray) -> FloatArray:
        """As ``BoundaryProblem.load_change``, of the loads that are vectors."""
        inputs = self.problem.read("inputs")
        return self._of_vectors(inputs - before, (spec for spec, _ in self.loads), self._first_length(inputs))

    def _of_vectors(self, values: FloatArray, specs: Iterable[InputSpec], length: FloatArray) -> FloatArray:
        """What vectors among ``values`` (instance_count, input_count) of inputs are as loads on the first rod, of a ``length``
        (instance_count,), but for those that depend on the configuration."""
        stiffness, weight = self._first_rod
        total = np.zeros(self.problem.instance_count)
        by_configuration = {load.input for load in self.problem.features.loads}
        for spec in specs:
            if spec.name in by_configuration:
                continue
            x, y, z = values[:, self.problem.input_slice(spec.name)].T
            size = np.sqrt(x * x + y * y + z * z) * length**spec.power / stiffness
            total += size * weight if spec.name == "gravity" else size
        return total

    def _first_length(self, inputs: FloatArray) -> FloatArray:
        """Where the first rod ends [m], shape (instance_count,)."""
        return np.asarray(self.problem.arrays.end[:, 0, -1] + inputs[:, self.problem.input_slice("translation").start])

    @cached_property
    def _first_rod(self) -> tuple[FloatArray, FloatArray]:
        """Least stiffness [N m^2] and largest linear density [kg/m] of the first rod."""
        material = self.problem.arrays.material[:, 0]
        return material[:, :, :3].min(axis=(1, 2)), material[:, :, DENSITY].max(axis=1)

    def waves(self) -> FloatArray:
        """Radians along the rods of waves in a medium, ``L (k/EI)^1/4``, at most, shape (instance_count,)."""
        springs = sum((load.spring_bound(self) for load in self.problem.features.loads), np.zeros(self.problem.instance_count))
        return np.asarray(self.furthest_end() * (springs / self.least_stiffness) ** 0.25)

    def segments(self) -> FloatArray:
        """(28) of ``docs/stability.md``: into how many segments what depends on where the rods are cuts them, shape
        (instance_count,)."""
        pushes = sum((load.push_bound(self) for load in self.problem.features.loads), np.zeros(self.problem.instance_count))
        pushed = self.furthest_end() * (pushes / self.least_stiffness) ** 0.25
        return np.asarray(np.maximum(self.waves() / WAVES, pushed / PUSHED))

    def largest(self, load: type[Load], name: str) -> FloatArray:
        """The largest of a parameter of a load that depends on the configuration, of any rod, shape (instance_count,)."""
        column = loads_in_material(self.problem.features)[load] + list(load.parameters).index(name)
        return self.problem.each(np.abs(self.problem.arrays.material[..., column]).max(axis=(1, 2)))

    def acting(self, inputs: FloatArray) -> list[InputSpec]:
        """The loads that are not zero in all instances of ``inputs`` (instance_count, input_count)."""
        return self.problem.found_for("acting", inputs, lambda: self._acting(inputs))

    def _acting(self, inputs: FloatArray) -> list[InputSpec]:
        acting: list[bool] = np.any(inputs, axis=0).tolist()
        return [spec for spec, own in self.loads if any(acting[own])]

    @cached_property
    def loads(self) -> list[tuple[InputSpec, slice]]:
        """The loads, and where they stand in a row of inputs."""
        return [(spec, self.problem.input_slice(spec.name)) for spec in LOADS]

    def moment_per_length(self) -> FloatArray:
        """Bound of the moment per length of loads that depend on the configuration [N], shape (instance_count,)."""
        bounds = [load.moment_bound(self) for load in self.problem.features.loads]
        return np.asarray(sum(bounds, np.zeros(self.problem.instance_count)))
