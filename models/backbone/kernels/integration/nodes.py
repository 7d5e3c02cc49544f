# mypy: ignore-errors
"""What is written where a lane stands on a node: one rod there, and how its configuration varies with the unknowns.

Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.arguments import Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout, Memory
from multirod.models.backbone.kernels.numbers.lanes import lanes
from multirod.models.backbone.kernels.numbers.scalars import rotate, rotation_matrix, turned_about_z

f64 = wp.float64


def make_nodes(layout: Layout, memory: Memory, base: SimpleNamespace, tip: SimpleNamespace, W: int, d):
    """Functions that write nodes; the record of the place must have been made anew where the lanes stand."""
    get_lane = lanes(W, d).get
    memory_type = wp.array(dtype=d)
    n, TORQUES, TUBES, FIRST, ECCENTRIC = layout.n, layout.TORQUES, layout.TUBES, layout.FIRST, layout.ECCENTRIC
    State, Column = base.State, base.Column
    THETA_AT, TAU_AT = layout.state["angles"], layout.state["torques"]
    PLACE, Z, OFFSET, MEMBERS = memory.PLACES, memory.STRETCH, layout.stretch["offset"], bool(layout.features.members)
    p = layout.place
    MOMENT_AT, FORCE_AT, CURVATURE_AT = p["moment"], p["force"], p["curvature"]
    OWN_CURVATURE, TOTAL_MOMENT, OWN_MOMENT, OWN_FORCE = p["own_curvature"], p["total_moment"], p["own_moment"], p["own_force"]
    GRIPS, GRIPS_AT = layout.DRIVES * layout.FRICTION, layout.state["grips"]
    frame, world_position = tip.frame, tip.world_position
    turn_column, body_moment_column = tip.turn_column, tip.body_moment_column
    SINGLE, UNIT, DQ_AT = d is wp.float32, layout.column.size + layout.given["unit"], layout.column["frame"]

    @wp.func
    def vector_of(memory: memory_type, row: int, l: int) -> wp.vec3d:
        return wp.vec3d(f64(get_lane(memory, row, l)), f64(get_lane(memory, row + 1, l)), f64(get_lane(memory, row + 2, l)))

    @wp.func
    def write_node(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        y: State,
        output: int,
        s: f64,
    ):
        """One rod at an output node at s."""
        t = case.index
        a = o + wp.static(PLACE)
        u = vector_of(memory, a + wp.static(CURVATURE_AT), l) / case.unit
        M = case.moment * vector_of(memory, a + wp.static(MOMENT_AT), l)
        N = case.force * vector_of(memory, a + wp.static(FORCE_AT), l)
        to_rod = wp.identity(3, dtype=f64)
        aside = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        i = int(wp.static(n))  # the rod, n of all together
        if wp.static(n == 1):
            i = int(0)
        else:
            i = call.node_rod
        if i < wp.static(n):
            u = vector_of(memory, a + wp.static(OWN_CURVATURE) + 3 * i, l) / case.unit
            M = case.moment * vector_of(memory, a + wp.static(TOTAL_MOMENT) + 3 * i, l)
            if wp.static(TUBES):
                if i >= wp.static(FIRST):
                    to_rod = turned_about_z(-y[wp.static(THETA_AT) + i - wp.static(FIRST)])
            if wp.static(ECCENTRIC):
                aside[0] = case.unit * f64(get_lane(memory, o + wp.static(Z + OFFSET) + 2 * i, l))
                aside[1] = case.unit * f64(get_lane(memory, o + wp.static(Z + OFFSET + 1) + 2 * i, l))
        if wp.static(MEMBERS):
            if call.unknown_columns == 0:  # a shape: the rod's own, beside what its members carry
                call.node_total_moment[t, output] = to_rod * M
                call.node_total_force[t, output] = to_rod * N
                N = case.force * vector_of(memory, a + wp.static(OWN_FORCE), l)
                if i < wp.static(n):
                    M = case.moment * vector_of(memory, a + wp.static(OWN_MOMENT) + 3 * i, l)
        for j in range(wp.static(GRIPS)):
            call.node_left[t, output, j] = y[wp.static(GRIPS_AT) + j]
        call.node_arclength[t, output] = s
        call.node_position[t, output] = world_position(case, y) + case.base_rotation * rotate(frame(y), aside)
        call.node_rotation[t, output] = case.base_rotation * rotation_matrix(frame(y)) * wp.transpose(to_rod)
        call.node_curvature[t, output] = to_rod * u
        call.node_moment[t, output] = to_rod * M
        call.node_force[t, output] = to_rod * N

    @wp.func
    def write_node_column(
        call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, at: int, l: int, passed: int, q: wp.vec4d, s: f64, k: int
    ):
        """How the configuration at s, of frame q, varies with an unknown, whose column stands ``at``: rotation vector of the
        longest rod in the world, or of the line that rods side by side follow, then the angle of each other rod from it.
        """
        t = case.index
        unit = f64(1.0)
        if wp.static(SINGLE):
            unit = f64(get_lane(memory, at + wp.static(UNIT), l))
        dq = wp.vec4d(f64(0.0), f64(0.0), f64(0.0), f64(0.0))
        if wp.static(layout.COLUMN_FRAME):
            for j in range(4):
                dq[wp.static(j)] = unit * f64(get_lane(memory, at + wp.static(DQ_AT + j), l))
        longest = f64(0.0)  # how much the angle of the rod that ends at the tip varies
        count = int(wp.static(n))
        if wp.static(not ECCENTRIC):
            if case.longest >= wp.static(FIRST):
                longest = unit * f64(get_lane(memory, at + wp.static(THETA_AT - FIRST) + case.longest, l))
        call.column_arclength[t, passed] = s
        turn = turn_column(case, q, dq, longest)
        for j in range(3):
            call.node_columns[t, passed, j, k] = turn[j]
        row = int(3)
        for i in range(count):
            if wp.static(ECCENTRIC) or i != case.longest:
                angle = -longest
                if i >= wp.static(FIRST):
                    angle += unit * f64(get_lane(memory, at + wp.static(THETA_AT - FIRST) + i, l))
                call.node_columns[t, passed, row, k] = angle
                row += int(1)

    @wp.func
    def write_tip_column(call: wp.ref[Call], case: wp.ref[Instance], y: State, v: Column, k: int):
        """Momenta of that configuration at the tip: the moment of all rods in the world, then the torque that each other rod has
        at its own end. The moment itself is taken to be zero, so the frame's turning adds nothing.
        """
        t = case.index
        dM = body_moment_column(y, v)
        moment = case.base_rotation * rotate(frame(y), dM)
        for j in range(3):
            call.tip_columns[t, j, k] = moment[j]
        inner = dM[2]
        last = int(wp.static(0 if ECCENTRIC else TORQUES + 1))
        for i in range(1, last):
            inner -= v[wp.static(TAU_AT) + i - 1]
        row = int(3)
        count = int(wp.static(n))
        for i in range(count):
            if wp.static(ECCENTRIC) or i != case.longest:
                torque = inner
                if wp.static(TORQUES > 0):
                    if i >= wp.static(FIRST):
                        torque = v[wp.static(TAU_AT) + i - wp.static(FIRST)]
                call.tip_columns[t, row, k] = torque
                row += int(1)

    return SimpleNamespace(write_node=write_node, write_node_column=write_node_column, write_tip_column=write_tip_column)
