"""How many unstable modes concentric tubes can have, whatever their configuration, from their precurvatures and stiffnesses
alone.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.kernels.shared import Shared
from multirod.launch import record
from multirod.models.backbone.stability.mode_bounds_kernels import ROWS, Bounds, make_mode_bounds
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem


def may_be_bounded(problem: "BackboneProblem") -> bool:
    """Whether a problem's robots are those that ``ModeBounds`` tells of: concentric tubes that twist, alone."""
    own = problem.features
    return len(problem.rods) > 1 and own.torsion and not (problem.held or own.eccentric or own.members)


class ModeBounds:
    """(14) and (15) with what dead forces add, of the robots of a problem at its inputs."""

    def __init__(self, problem: "BackboneProblem") -> None:
        device, count, arrays = problem.device, problem.instance_count, problem.arrays
        rods, n, sections = arrays.end.shape
        EI, kappa = problem.sizes.by_section
        state: Any = Bounds()
        problem.share(state, ("inputs",))
        state.first, state.stride = problem.input_slice("translation").start, int(rods > 1)
        constants = {"end": arrays.end, "compliance": arrays.material[..., 5], "EI": EI[:rods], "kappa": kappa[:rods]}
        for name, values in constants.items():
            setattr(state, name, wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=device))
        stretches = n * sections
        rooms = {"cuts": (stretches + 1,), "together": (stretches,), "bend": (stretches, n), "rows": (ROWS, n)}
        for name, room in (rooms | dict.fromkeys(("whole", "matrix", "vectors"), (n, n))).items():
            setattr(state, name, wp.zeros((count, *room), dtype=wp.float64, device=device))
        self._force = Shared((count,), wp.float64, device)
        self._bounds = Shared((count, 2), wp.float64, device)
        state.force, state.bounds = self._force.array, self._bounds.array
        self._launch = record(make_mode_bounds, count, [state], device)

    def under(self, force: FloatArray) -> FloatArray:
        """A copy of them, shape (instance_count, 2): see ``BoundaryProblem.mode_bounds``.

        Args:
            force: Bounds of the internal force [N], shape (instance_count,).
        """
        self._force.write(force)
        self._launch.launch()
        return np.array(self._bounds.fetched())
