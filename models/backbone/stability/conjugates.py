"""What the residuals of one backbone with a free tip do work on; ``docs/energy_descent.md``, equations (7) to (9)."""

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.capabilities import Conjugates
from multirod.launch import record
from multirod.models.backbone.inputs import LOADS
from multirod.models.backbone.stability.conjugate_kernels import Pairs, find_displacements
from multirod.models.backbone.units import unit_stiffness
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem
    from multirod.problem import BoundaryProblem

GIVE = 1e-6  # of the compliance in bending: what a rod that is rigid in torsion gives way by
STRETCH = 1e-8  # of ``L^3/EI``: what a tip gives way by along a rod whose base force is unknown


class BackboneConjugates(Conjugates):
    """Of a ``BackboneProblem`` that is free at its tip.

    Args:
        problem: Its residuals, rods and loads.
        seen: The problem whose pose and columns tell the displacements; it, by default.
    """

    def __init__(self, problem: "BackboneProblem", seen: "BoundaryProblem | None" = None) -> None:
        self.problem, device = problem, problem.device
        count, n, terms, places = problem.instance_count, problem.unknown_count, problem.features, problem.rows.places
        whole = np.arange(n)
        # (7m) a dead force is on the tip of a rod in a medium, wherever that goes
        given = [places["conditions"], *([] if terms.follower_force else [places["force"]])]
        self.forces = np.delete(whole, np.concatenate([whole[place] for place in given]))
        m = len(self.forces)
        of = problem if seen is None else seen

        array = problem.buffers.array
        length = np.broadcast_to(problem.table.length_scale.numpy(), count)
        scale, unit = np.ones((count, m)), np.ones((count, m))
        moment, force = self._row(places["moment"]), self._row(places["force"])
        last = problem.arrays.material[:, :, -1, :3]
        stiffness = unit_stiffness(last)
        if moment >= 0:
            unit[:, moment : moment + 3] = last[:, 0] if terms.measured else stiffness[:, 0]
        if force >= 0:
            scale[:, force : force + 3] = length[:, None]
            unit[:, force : force + 3] = (problem.each(last[:, 0, :2].max(axis=1)) / length)[:, None]
        self.unit, self.scale = array(unit), array(scale)
        self.columns = wp.zeros((count, m, n + problem.direction_count), dtype=wp.float64, device=device)
        self.stiffness: FloatArray = problem.sizes.stiffness_over_length()
        rigid = terms.eccentric or not np.isfinite(last[:, :, 2]).all()
        if rigid and moment >= 0:
            # of an instance that is not rigid it is as little
            self.give += ((moment + 2, moment + 2, GIVE * length),)
        if force >= 0:
            # a straight rod that does not stretch; others give way by as little more
            self.give += ((self.forces[force + 2], problem.slots.places["force"].start + 2, STRETCH * length**2),)
        vectors = [spec.name for spec in LOADS if not spec.potential]
        self.without = tuple(k for name in vectors for k in range(problem.input_count)[problem.input_slice(name)])
        self.has_potential = problem.has_potential
        pairs: Any = Pairs()
        problem.share(pairs, ("active", "inputs"))
        pairs.rotation = of.rotation
        pairs.columns_at = problem.angle_columns if of is problem else of.pose_columns
        pairs.end, pairs.stride = problem.table.end, problem.table.stride
        pairs.base_axes, pairs.base_stride = problem.table.base_rotation, problem.table.base_stride
        pairs.rods, pairs.first = len(problem.rods), len(problem.rods) - terms.turning_count
        pairs.moment, pairs.force, pairs.torques = moment, force, self._row(places["torques"])
        pairs.torque_count, pairs.fixed = terms.torque_count, int(terms.fixed_moment and not terms.measured)
        pairs.bending, pairs.torsion = array(last[:, :, :2].max(axis=2)), array(stiffness[:, :, 2])
        pairs.unit, pairs.columns = self.unit, self.columns
        self._fixed = bool(pairs.fixed)
        self._launch = record(find_displacements, count, [pairs], device)

    def _row(self, place: slice) -> int:
        """Where residuals begin among those that are forces; -1 where there are none."""
        found = np.flatnonzero(self.forces == place.start)
        return int(found[0]) if place.stop > place.start and found.size else -1

    def update(self) -> None:  # noqa: D102
        self._launch.launch()

    def seen_from(self, problem: "BoundaryProblem") -> "BackboneConjugates | None":
        """None of several rods, and where moments are fixed in the world: their residual turns with the base."""
        if len(self.problem.rods) > 1 or self._fixed or not problem.pose_sensitivities:
            return None
        return BackboneConjugates(self.problem, problem)
