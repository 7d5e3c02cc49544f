# mypy: ignore-errors
"""The kernel that integrates one backbone carried by n >= 1 concentric rods, many instances side by side.

The equations are those of ``docs/model.md``; numbers in parentheses are theirs. The frame ``R`` is the material frame of
rod 1, the innermost; rod ``i`` is turned about it by ``theta_i`` (``theta_1 = 0``) and carries the torque ``tau_i``. ``M``
and ``N`` are the moment and force of all rods together in that frame. With one rod this is the Cosserat rod of equation
(1c) of the paper.

A thread has W lanes. Each carries one job, an instance with all or some of its columns, from node to node, by stretches and steps
of its own, and takes the next job when it is done (``walk``).
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from multirod.integrators import Tableau
from multirod.kernels.own_module import own_module
from multirod.models.backbone.kernels.integration.walk import SCALARS, make_carry, make_parts
from multirod.models.backbone.kernels.layout.arguments import FAULT, Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.numbers.scalars import rotate_inverse
from multirod.status import Fault

f64 = wp.float64


@cache
def make_kernel(features: Features, tableau: Tableau, precision: str = "float64", W: int = 8):
    """Kernel for one set of features, one integrator and W lanes; arguments ``(RodTable, Call, memory)``, see ``Memory``."""
    parts = make_parts(features, tableau, precision, W)
    own, base, tip, nodes, record = parts.own, parts.base, parts.tip, parts.nodes, parts.record
    memory_type, d = own.memory_type, SCALARS[precision]
    first_column, column_count, begin, onto_stretch = own.first_column, own.column_count, own.begin, own.onto_stretch
    force_at, precurvature_here, step_count, cause = own.force_at, own.precurvature_here, own.step_count, own.cause
    make_base_of, base_force, base_state, base_column = base.make_base_of, base.base_force, base.base_state, base.base_column
    find_ends, write_tip, write_tip_column = tip.find_ends, tip.write_tip, tip.write_tip_column
    write_pose, write_pose_column = tip.write_pose, tip.write_pose_column
    write_momenta = nodes.write_tip_column
    state_in, column_in, force_column_in = record.state_in, record.column_in, record.force_column_in
    put_state, put_column = record.put_state, record.put_column
    NODE_COLUMNS, WORLD_STATE = features.node_columns, features.world_force_is_state
    WORLD_AT = own.layout.state["world_force"]  # a column's stands alike
    LENGTHS, LENGTHS_AT = own.layout.LENGTHS, own.layout.state["lengths"]  # likewise
    CONDITIONS, conditions, load_drive_columns = own.layout.CONDITIONS, parts.grid.conditions, parts.grid.load_drive_columns
    DRIVES_VARY = own.layout.DRIVES_VARY
    write_conditions, write_condition_column = conditions.write, conditions.write_column

    @wp.func
    def count(call: wp.ref[Call], jobs: wp.ref[Call]) -> int:
        return call.problem.order.shape[0]

    @wp.func
    def wanted(call: wp.ref[Call], jobs: wp.ref[Call], t: int) -> bool:
        return call.problem.active[call.problem.order[t]] != 0

    @wp.func
    def instance_of(call: wp.ref[Call], jobs: wp.ref[Call], t: int) -> int:
        return call.problem.order[t]

    @wp.func(inline=False)
    def enter(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        jobs: wp.ref[Call],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        p: int,
        job: int,
    ):
        """A lane at the base of its instance."""
        b = make_base_of(rods, call, case)
        n0 = base_force(rods, call, case, b.q)
        b.N = rotate_inverse(b.q, n0)
        put_state(case, memory, o, l, base_state(rods, call, case, b, n0))
        for c in range(column_count(call, job)):
            v, dn = base_column(rods, call, case, b, first_column(call, job) + c)
            put_column(case, memory, o, l, c, v, dn)
            if wp.static(DRIVES_VARY):
                load_drive_columns(rods, call, case, memory, o, l, c, first_column(call, job) + c)
        begin(call, case, memory, o, l, p, f64(0.0), case.length, n0)

    @wp.func(inline=False)
    def go_on(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        jobs: wp.ref[Call],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        p: int,
        job: int,
    ):
        onto_stretch(rods, call, case, memory, o, l, p, job, call.steps, call.step_multiple, case.length)

    @wp.func(inline=False)
    def finish(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        jobs: wp.ref[Call],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        p: int,
        job: int,
        s: f64,
    ):
        """What a lane has found at the tip; its last stretch began at s."""
        t = case.index
        y = state_in(case, memory, o, l)
        ends = find_ends(rods, call, case, s)
        n_tip = force_at(call, p)
        if wp.static(WORLD_STATE):
            n_tip = wp.vec3d(y[WORLD_AT], y[WORLD_AT + 1], y[WORLD_AT + 2])
        total = f64(0.0)
        if job % call.parts == 0:
            total += write_tip(rods, call, case, ends, y, n_tip, precurvature_here(case, memory, o, l))
            if wp.static(CONDITIONS > 0):
                total += write_conditions(rods, call, case, y)
            write_pose(call, case, y)
            for i in range(wp.static(LENGTHS)):
                call.line_length[t, i] = y[wp.static(LENGTHS_AT) + i]
            call.problem.fault[t] = int(call.lane[p, FAULT])
            call.problem.step_count[t] = step_count(memory, o, l)
        first = first_column(call, job)
        for c in range(column_count(call, job)):
            v = column_in(case, memory, o, l, c)
            dn = force_column_in(case, memory, o, l, c)
            if wp.static(WORLD_STATE):
                dn = wp.vec3d(v[WORLD_AT], v[WORLD_AT + 1], v[WORLD_AT + 2])
            total += write_tip_column(rods, call, case, ends, y, v, n_tip, dn, first + c)
            if wp.static(CONDITIONS > 0):
                total += write_condition_column(rods, call, case, v, first + c)
            write_pose_column(call, case, y, v, first + c)
            for i in range(wp.static(LENGTHS)):
                call.line_length_columns[t, i, first + c] = v[wp.static(LENGTHS_AT) + i]
            if wp.static(NODE_COLUMNS):
                if call.node_count > 0:
                    write_momenta(call, case, y, v, first + c)
        if not wp.isfinite(total):
            call.problem.fault[t] = cause(memory, o, l, wp.static(int(Fault.NONFINITE)))

    jobs = SimpleNamespace(
        Jobs=Call, count=count, wanted=wanted, instance_of=instance_of, enter=enter, go_on=go_on, finish=finish
    )
    carry = make_carry(parts, features, jobs)

    @own_module(max_unroll=1)
    def integrate(rods: RodTable, call: Call, memory: wp.array2d(dtype=d)):
        """From the base to the tip, stretch by stretch; then the residual."""
        thread = wp.tid()
        carry(rods, call, call, memory[thread], thread)

    return integrate
