"""Segments of all backbones of a problem, end to end: the next one of each is integrated from where the one before it ends."""

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.launch import record
from multirod.models.backbone.kernels.integration.segments import SegmentCall, make_segment_kernel
from multirod.models.backbone.kernels.layout.layout import breakpoint_state, of_whole, residuals_of, unknowns_of
from multirod.models.backbone.passes.lane_pass import deal, layout_of, threads, width
from multirod.models.backbone.units import unit_stiffness
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem


class Chain:
    """A launch over one segment of each instance of a ``BackboneProblem``, any rods, by numbers and columns of its own.

    What is rigid in torsion is a little soft here, as columns need it.

    Args:
        problem: The backbones.
        loads: Directions, from the first on, along which what acts along the rods changes.

    Attributes:
        features: Of its kernel.
        scale: Length of each [m], shape (instance_count,), by which variations count.
        units: Moment of one of the moments among these, then of the torques [N m^2], shape (instance_count, 3 and more).
        state: What is known where a segment begins.
        variations: What that varies by, so many columns.
        whole: Places of the problem's unknowns among these.
        call: Its arguments: residual, ``gamma`` and wrench of the segments that end at the tip.
    """

    def __init__(self, problem: "BackboneProblem", loads: int = 0) -> None:
        options: dict[str, Any] = {"pose": True, "pose_sensitivities": True, "lengths": False, "directions": loads > 0}
        self.problem = problem
        self.features = replace(problem.features, segment=True, nodes=False, node_columns=False, **options)
        self.state, self.variations = breakpoint_state(self.features), unknowns_of(self.features)
        self.whole, d = of_whole(self.variations), self.variations.size
        self.scale, self.units = problem.each(problem.table.length_scale.numpy()), self._units()
        count, device = problem.instance_count, problem.device
        self.call: Any = problem.buffers.call_at_equal_steps()
        m = residuals_of(self.variations).size
        rooms = {"unknowns": (d,), "residual": (m,), "gamma": (m, d), "residual_directions": (m, max(loads, 1))}
        rooms |= {"pose_columns": (6, d + loads)}
        for name, shape in rooms.items():
            setattr(self.call.problem, name, wp.zeros((count, *shape), dtype=wp.float64, device=device))
        if problem.held:
            self.call.wrench.values = wp.zeros((count, 6), dtype=wp.float64, device=device)
            self.call.wrench.columns = wp.zeros((count, 6, d + loads), dtype=wp.float64, device=device)
        self.call.unknown_columns, self.call.direction_columns = d, loads
        lanes = width("float64", device)
        memory = deal(self.call, layout_of(self.features), problem.integrator, "float64", device, count, lanes)
        segment: Any = SegmentCall()
        segment.instance = wp.array(np.arange(count), dtype=wp.int32, device=device)
        segment.steps = wp.zeros(count, dtype=wp.int32, device=device)
        for name in ("start", "end"):
            setattr(segment, name, wp.zeros(count, dtype=wp.float64, device=device))
        for name in ("at_tip", "fault", "taken"):
            setattr(segment, name, wp.zeros(count, dtype=wp.int32, device=device))
        for name in ("state", "end_state"):
            setattr(segment, name, wp.zeros((count, self.state.size), dtype=wp.float64, device=device))
        segment.columns = wp.zeros((count, d + 3, d + loads), dtype=wp.float64, device=device)
        self._segment, tableau = segment, problem.integrator.tableau
        names = ("state", "start", "end", "at_tip", "fault", "taken", "end_state", "columns")
        # copies by Warp take as long as a segment, and are not needed where the memory is NumPy's too
        self._shared = {name: getattr(segment, name).numpy() for name in names} if problem.on_host else None
        self._unknowns = self.call.problem.unknowns.numpy() if problem.on_host else None
        self._launch = record(
            partial(make_segment_kernel, self.features, tableau, lanes),
            threads(self.call, count),
            [problem.buffers.twisting_table(), self.call, memory, segment],
            device,
        )

    def _units(self) -> FloatArray:
        """``units``: as (10) of ``docs/model.md`` has it."""
        problem = self.problem
        unit = np.array(unit_stiffness(problem.each(problem.arrays.material[:, :, 0])))
        if not self.features.turning_count:
            return np.array(unit[:, 0])
        bending = problem.each(problem.arrays.material[:, :, 0, :2].max(axis=2).sum(axis=1))
        together = np.concatenate([np.repeat(bending[:, None], 2, axis=1), unit[:, 0, 2:]], axis=1)
        torques = unit[:, unit.shape[1] - self.features.torque_count :, 2]
        return np.concatenate([together[:, : 3 * self.features.moment], torques], axis=1)

    def begin(self) -> None:
        """Let segments from the base begin as the problem's unknowns say."""
        self.problem.heed_stop()
        if self._unknowns is not None:
            self._unknowns[:, self.whole] = self.problem.read("unknowns")
            return
        unknowns = np.zeros((self.problem.instance_count, self.variations.size))
        unknowns[:, self.whole] = self.problem.read("unknowns")
        self.call.problem.unknowns.assign(unknowns)

    def over(self, states: FloatArray, start: FloatArray, end: FloatArray, *, last: bool) -> tuple[FloatArray, ...]:
        """The segments between arclengths [m] (instance_count,), the ``last`` to the tip.

        Args:
            states: Where they begin, (instance_count, state.size); not asked for at the base.
            start, end: As said.
            last: Whether they end at the tip.

        Returns:
            States where they end; how these vary by those where they begin, and along the ``loads``, then how the position does
            along the axes of the base, (instance_count, variations.size + 3, variations.size + loads); faults; steps taken.
        """
        segment, shared = self._segment, self._shared
        if shared is not None:
            for name, values in (("state", states), ("start", start), ("end", end), ("at_tip", last), ("fault", 0)):
                shared[name][...] = values
            self._launch.launch()
            return shared["end_state"].copy(), shared["columns"], shared["fault"], shared["taken"]
        segment.state.assign(states)
        segment.start.assign(start)
        segment.end.assign(end)
        segment.at_tip.fill_(int(last))
        segment.fault.zero_()
        self._launch.launch()
        found = segment.end_state, segment.columns, segment.fault, segment.taken
        return tuple(np.array(own.numpy()) for own in found)
