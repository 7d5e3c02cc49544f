"""The passes over nodes of a backbone: made once for each kind, kept for the next, and held to the solve."""

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.kernels.warp_types import Struct
from multirod.launch import expect
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.nodes.correction import held_to_solve
from multirod.models.backbone.nodes.node_pass import NodePass
from multirod.models.backbone.passes.lane_pass import LanePass, kernel_of
from multirod.models.backbone.terms import judging, teller, telling
from multirod.models.backbone.unknowns import with_moment
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

NODES_KEPT = 1024  # of all instances, of a pass over nodes that is kept for the next


class NodePasses:
    """Of a ``BackboneProblem``."""

    def __init__(self, problem: "BackboneProblem") -> None:
        self.problem = problem
        self._passes: dict[Any, NodePass] = {}

    def over(
        self,
        node_count: int,
        chosen: NDArray[np.bool_] | None = None,
        *,
        columns: bool = False,
        rod: int | None = None,
        unknowns: FloatArray | None = None,
        dead: bool = False,
    ) -> NodePass:
        """A pass over nodes of one rod, or of all together, by outputs of its own, until the next: those of the solve stay.

        Columns are those of the model with all its unknowns. ``unknowns`` are those of the solve by default: then it ends where
        the solve does, or its outputs are NaN (``held_to_solve``). Of ``dead`` forces alone, none that follow or depend on the
        configuration, it has no unknown base force.
        """
        changes: dict[str, Any] = {}
        if dead:
            kept = tuple(load for load in self.problem.features.loads if not load.force)
            changes = {"follower_force": False, "loads": kept}
        mine = unknowns is None
        if columns and mine and not self.problem.features.moment:
            unknowns = with_moment(self.problem, self.problem.read("unknowns"))
        made = self._pass(node_count, chosen, columns, rod, unknowns, changes)
        as_solve = node_count == 2 and not columns
        if not mine or as_solve or changes or not isinstance(self.problem.launch, LanePass):
            return made
        ran = self._listed() if chosen is None else np.array(chosen)
        for k in self.problem.breakpoints:
            ran[k] = False

        def again(others: FloatArray, some: NDArray[np.bool_], by_columns: bool) -> NodePass:
            return self._pass(node_count, some, by_columns, rod, others, changes)

        return held_to_solve(self.problem, made, again, ran)

    def bare(self, node_count: int, chosen: NDArray[np.bool_]) -> NodePass:
        """A pass without columns at the unknowns of the solve, wherever it ends; of two nodes, by its very steps, if equal."""
        return self._pass(node_count, chosen, False, None, None, {})

    def of_all(self, node_count: int, *, one_step: bool = False) -> NodePass:
        """A pass by columns over nodes of all rods together and all instances, not launched yet; of ``one_step`` alone between
        two nodes, or an end of a rod or section."""
        return self._make_node_pass(node_count, False, True, None, None, {}, one_step=one_step)

    def bare_of_all(self, node_count: int) -> NodePass:
        """A pass without columns over nodes of all rods together and all instances, at the unknowns of the solve whenever it is
        launched, wherever it ends."""
        return self._make_node_pass(node_count, False, False, None, None, {})

    def to_tip(self, chosen: NDArray[np.bool_]) -> NodePass:
        """Residual and tip of some instances by the very steps that the solve chooses, without columns; its outputs stay."""
        made = self._end_pass
        made.write("active", chosen)
        made.launch.launch()
        return made

    @cached_property
    def _end_pass(self) -> NodePass:
        problem, buffers = self.problem, self.problem.buffers
        call: Struct = buffers.call()
        buffers.own_ends(call, problem.unknown_count)
        own = call.problem
        own.active, own.fault, own.step_count = (buffers.zeros(dtype=wp.int32) for _ in range(3))
        call.line_length = buffers.zeros(problem.drive_count)
        if problem.held:
            call.wrench.values = buffers.zeros(6)
        launch = problem.lane_pass(replace(problem.features, pose=True), call, columns=(0, 0))
        return NodePass(call, launch, False, False, problem.on_host)

    def expect_columns(self) -> None:
        """Have the kernel of a pass by columns compiled in the background."""
        problem = self.problem
        if isinstance(problem.launch, LanePass):
            expect(kernel_of(self._terms(True, {}), problem.integrator.tableau, "float64", problem.device), problem.device)

    def _terms(self, columns: bool, changes: dict[str, Any]) -> Features:
        features = replace(self.problem.features, nodes=False, node_columns=False, design=False, **changes)
        without = replace(telling(features), pose_sensitivities=False, directions=False)
        return judging(features) if columns else teller(features, self.problem.integrator) or without

    def _listed(self) -> NDArray[np.bool_]:
        """Which instances launches evaluate, shape (instance_count,)."""
        result = np.zeros(self.problem.instance_count, dtype=bool)
        result[self.problem.order.numpy()[: self.problem.listed]] = True
        return np.asarray(result & (self.problem.active.numpy() != 0))

    def _pass(
        self,
        node_count: int,
        chosen: NDArray[np.bool_] | None,
        columns: bool,
        rod: int | None,
        unknowns: FloatArray | None,
        changes: dict[str, Any],
    ) -> NodePass:
        """A pass over nodes, wherever it ends."""
        key = (node_count, columns, rod, chosen is None, unknowns is None, *changes.items())
        made = self._passes.get(key)
        if made is None:
            made = self._make_node_pass(node_count, chosen is not None, columns, rod, unknowns, changes)
            if self.problem.on_host and self.problem.instance_count * node_count <= NODES_KEPT:
                while len(self._passes) > len(self.problem.rods) + 3:
                    del self._passes[next(iter(self._passes))]
                self._passes[key] = made
        else:
            made.clear()
        if chosen is not None:
            made.write("active", chosen)
        if unknowns is not None:
            made.write("unknowns", unknowns)
        made.launch.launch()
        return made

    def _make_node_pass(
        self,
        node_count: int,
        chosen: bool,
        columns: bool,
        rod: int | None,
        unknowns: FloatArray | None,
        changes: dict[str, Any],
        *,
        one_step: bool = False,
    ) -> NodePass:
        problem, buffers, features = self.problem, self.problem.buffers, self._terms(columns, changes)
        if columns:
            problem.expect_form()
        call: Struct = buffers.call(node_count)
        if one_step:
            call.steps = 1.0
        if unknowns is not None:
            call.problem.unknowns = buffers.array(unknowns)
        call.node_rod = len(problem.rods) if rod is None else rod
        m = features.unknown_count
        buffers.own_ends(call, m)
        if chosen:
            call.problem.active = buffers.zeros(dtype=wp.int32)
        if columns:
            nodes = node_count - 1 + problem.arrays.end[0].size + problem.table.profile_end.size
            call.column_arclength = buffers.zeros(nodes)
            call.column_arclength.fill_(np.nan)
            call.node_columns = buffers.zeros(nodes, m, m)
            call.tip_columns, call.problem.gamma = buffers.zeros(m, m), buffers.zeros(m, m)
            call.problem.pose_columns = buffers.zeros(6, m)
            call.line_length_columns = buffers.zeros(problem.drive_count, m)
        table = buffers.twisting_table() if columns else None
        launch = problem.lane_pass(features, call, table, columns=(m if columns else 0, 0))
        return NodePass(call, launch, columns, bool(features.members), problem.on_host)
