"""Launches of the segment kernels, and their arrays."""

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.batch import IntArray
from multirod.kernels.warp_types import Struct
from multirod.launch import record
from multirod.models.backbone.kernels.integration.segments import SegmentCall, make_segment_kernel
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.layout import breakpoint_state, unknowns_of
from multirod.models.backbone.passes.lane_pass import deal, layout_of, own, threads, width

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem
    from multirod.models.backbone.segments.segments import BackboneSegments

NODES_KEPT = 1024  # of all instances, of a launch over nodes that is kept for the next
STEPS_ALLOWED = 16384  # of a segment: numbers that overflow on its equal steps would go on by ever shorter ones
WHOLE = ("instance", "at_tip", "steps", "fault", "taken")  # numbers of a segment
GIVEN = ("instance", "at_tip", "steps", "start", "end", "state")
FOUND = ("end_state", "columns", "fault", "energy", "work", "line_length")


class Room:
    """A recorded launch over up to ``capacity`` segments, and its arrays.

    Args:
        problem: Of the segments.
        features: Of the kernel.
        call: Its arguments; a copy is made, whose arrays are the same.
        table: The rods.
        capacity: Segments.
        columns: By the states where segments begin; without any there are none by directions either.
        directions: Along which there are columns.
        given: Whether states at the base are given too.
    """

    def __init__(
        self,
        problem: "BackboneProblem",
        features: Features,
        call: Struct,
        table: Struct,
        capacity: int,
        columns: int,
        directions: int,
        given: bool,
    ) -> None:
        self.call, self.table = own(call), table
        device, lanes = problem.device, width("float64", problem.device)
        call = self.call
        if call.node_count == 0:  # else a segment's steps are those of a whole rod
            call.step_limit = min(call.step_limit, STEPS_ALLOWED)
        call.unknown_columns, call.direction_columns = columns, directions if columns else 0
        memory = deal(call, layout_of(features), problem.integrator, "float64", device, capacity, lanes)
        shapes: dict[str, tuple[tuple[int, ...], Any]] = {name: ((capacity,), wp.int32) for name in WHOLE}
        shapes |= {name: ((capacity,), wp.float64) for name in ("start", "end", "energy", "work")}
        size, varied = breakpoint_state(features).size, unknowns_of(features).size
        shapes |= {name: ((capacity, size), wp.float64) for name in ("state", "end_state")}
        shapes["columns"] = ((capacity, varied + 3, columns + call.direction_columns), wp.float64)
        shapes["line_length"] = ((capacity, problem.drive_count), wp.float64)
        self._arrays = {name: wp.zeros(shape, dtype=kind, device=device) for name, (shape, kind) in shapes.items()}
        self._views = {name: a.numpy() for name, a in self._arrays.items()} if wp.get_device(device).is_cpu else {}
        self._count, self._lanes = 0, lanes  # segments of the last launch
        self._seg: Any = SegmentCall()
        self._seg.given = int(given)
        for name, array in self._arrays.items():
            setattr(self._seg, name, array)

        self._launch = record(
            partial(make_segment_kernel, features, problem.integrator.tableau, lanes),
            threads(call, capacity),
            [table, call, memory, self._seg],
            device,
        )

    def run(self, count: int, given: dict[str, Any]) -> dict[str, Any]:
        """What a launch over ``count`` segments finds, of each; ``given`` is what it is told of them."""
        order = self._longest_first(given["steps"])
        if self._views:
            for name in GIVEN:
                self._views[name][:count] = given[name] if order is None else given[name][order]
            for name in FOUND:
                self._views[name][:count] = 0
        else:
            for name, array in self._arrays.items():
                if name in given:
                    array[:count].assign(np.ascontiguousarray(given[name]).astype(array.numpy().dtype))
                else:
                    array.zero_()
        if count != self._count:
            self._count = count
            self._seg.instance = self._arrays["instance"][:count]
            self._launch.set_param_at_index(3, self._seg)
            self._launch.set_dim(threads(self.call, count))
        self._launch.launch()
        if order is not None:
            back = np.argsort(order)
            return {name: self._views[name][back] for name in FOUND}
        if self._views:
            return {name: self._views[name][:count].copy() for name in FOUND}
        return {name: self._arrays[name].numpy()[:count] for name in FOUND}

    def _longest_first(self, steps: IntArray) -> IntArray | None:
        """In which order segments of so many steps keep the lanes busy to the end, as each takes the next; None if in any.

        No lane changes what another finds, bit by bit.
        """
        if not self._views or len(steps) <= self._lanes or steps.min() == steps.max():
            return None
        return np.argsort(-steps, kind="stable")


class NodeRooms:
    """Rooms of segments that write nodes; small ones are kept for the next look at as many nodes."""

    def __init__(self, segments: "BackboneSegments") -> None:
        self._segments = segments
        self._rooms: dict[tuple[int, int], Room] = {}

    def of(self, features: Features, node_count: int, count: int) -> Room:
        """Room for so many segments."""
        segments, problem = self._segments, self._segments.problem
        kept = problem.instance_count * node_count <= NODES_KEPT
        capacity = 1 << max(count - 1, 3).bit_length() if kept else count
        room = self._rooms.get((node_count, capacity))
        if room is None:
            call = problem.buffers.call(node_count)
            call.node_rod = 0
            for name in segments.own_arguments:
                setattr(call.problem, name, getattr(segments.call.problem, name))
            call.wrench = segments.call.wrench
            room = segments.make_room(features, call, segments.table, capacity, 0)
            if kept:
                self._rooms[node_count, capacity] = room
        return room
