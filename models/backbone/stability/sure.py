"""Stability of few instances that is beyond doubt, in one launch: of most results nothing else is asked."""

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.launch import record
from multirod.models.backbone.node_pass import NEAR, NodePass
from multirod.models.backbone.passes import LanePass
from multirod.models.backbone.stability.sure_kernels import Sure, make_sure
from multirod.problem import FEW
from multirod.repeated_kernels import callable_from_kernels
from multirod.shared import Shared

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem


def may_be_sure(problem: "BackboneProblem") -> bool:
    """Whether a problem is one of those that ``SureStability`` looks at: free rods under loads with a potential, on the CPU."""
    own = problem.features
    others = (own.members, own.eccentric, own.magnetised, own.foundation, own.measured, own.friction, own.profile_degree >= 0)
    return (
        own.moment
        and not any(others)
        and not (problem.held or problem.breakpoints or (own.turning_count and problem.rigid_in_torsion))
        and wp.get_device(problem.device).is_cpu
        and problem.instance_count <= FEW
        and isinstance(problem.launch, LanePass)
    )


class SureStability:
    """Finds which equilibria are surely stable, as ``BackboneStability.modes`` would.

    Args:
        problem: Of which ``may_be_sure`` holds.

    Attributes:
        nodes: Of the last look; 0 before the first.
    """

    def __init__(self, problem: "BackboneProblem") -> None:
        self._problem = problem
        self.nodes = 0
        self._launch: Any = None
        self._kept: tuple[Any, ...] = ()  # what the launch works in

    def holds(self, nodes: int) -> bool:
        """Whether all instances are stable at the problem's unknowns, by so many nodes; False says nothing."""
        if nodes != self.nodes:
            self._make(nodes)
        if self._launch is None:
            return False
        self._launch.launch()
        return bool(self._sure.all())

    @property
    def needed(self) -> float:
        """Segments that the last look called for."""
        return float(self._needed.max())

    def _make(self, nodes: int) -> None:
        problem, self.nodes = self._problem, nodes
        made: NodePass = problem.nodes_of_all(nodes)
        free, n, device = 3 + problem.features.turning_count, len(problem.rods), problem.device
        form = made.form(free, n, device)
        state: Any = Sure()
        problem.share(state, ("inputs", "fault", "position", "rotation"))
        state.first, state.near = problem.input_slice("translation").start, NEAR / 3
        bend, _, kappa = problem.bend_by_section()
        if not problem.features.turning_count:
            bend, kappa = np.zeros_like(bend), np.zeros_like(kappa)
        constants = {"length": problem.each(problem.arrays.end[:, :, -1]), "stiffness": problem.least_stiffness()}
        for name, values in (constants | {"bend": bend, "kappa": kappa}).items():
            setattr(state, name, wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=device))
        for name in ("column_arclength", "node_curvature", "node_moment", "node_force"):
            setattr(state, name, getattr(made.call, name))
        state.node_position, state.node_rotation = made.call.position, made.call.rotation
        for name in ("ends", "unit", "matrix", "conjugate", "known", "open"):
            setattr(state, name, form.array(name))
        form.want_all()
        count = problem.instance_count
        needed, sure = Shared((count,), wp.float64, device), Shared((count,), wp.int32, device)
        state.needed, state.sure, self._needed, self._sure = needed.array, sure.array, needed.values, sure.values
        state.work = wp.zeros((count, free, free), dtype=wp.float64, device=device)
        launches = made.launch.recorded
        calls = None if launches is None else callable_from_kernels((*launches, form.launch))
        self._launch = None if calls is None else record(make_sure, 1, [state, calls], device)
        self._kept = made, form, state, calls
