# mypy: ignore-errors
"""The kernel that integrates segments of backbones, each from a given state, with columns by that state.

Numbers in parentheses are those of ``docs/model.md``. A segment begins and ends at any arclength; several, end to end, carry the
rods (``docs/solvers.md``). The unknowns of a segment are the variations of its first state: the moment in the units of (10), of
several rods their torques likewise, the rotation over the rod's length and the angles of several rods likewise, where loads
depend on it the position, lengths of lines and what friction leaves of them, (5) there; then what is the same all along: tensions
in the units of (L7) of ``docs/lines.md`` and, where something follows the tip, the base force in the units of (13). Where loads'
forces depend on the configuration, that is the force where the segment begins. A segment of several rods that begins at their
base varies by their unknowns, of which a torque twists its rod behind the plate too.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from multirod.integrators import Tableau
from multirod.kernels.own_module import own_module
from multirod.models.backbone.kernels.instance import section_unit
from multirod.models.backbone.kernels.integration.walk import make_carry, make_parts
from multirod.models.backbone.kernels.layout.arguments import FAULT, OUTPUT, STOP, Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.layout import breakpoint_state
from multirod.models.backbone.kernels.numbers.scalars import axes_rotation, body_rotation, rotate, rotate_inverse
from multirod.status import Fault

f64 = wp.float64


@wp.struct
class SegmentCall:
    """What one launch over segments reads and writes beside ``Call``; the first axis is the segment."""

    instance: wp.array[int]
    start: wp.array[wp.float64]  # arclength [m]
    end: wp.array[wp.float64]
    at_tip: wp.array[int]  # 1 where the segment ends at the tip
    steps: wp.array[int]  # equal steps over the segment, each stretch of it its share; 0: by the integrator's error control
    state: wp.array2d[wp.float64]  # ``breakpoint_state`` at the start; at the base it is that of the unknowns, unless
    given: int  # 1 where states at the base are given too, and what they vary by is known there
    # outputs
    end_state: wp.array2d[wp.float64]
    columns: wp.array3d[wp.float64]  # of the end: variations in the units of the unknowns, position [m], (.., d + 3, column)
    fault: wp.array[int]
    taken: wp.array[int]  # steps of the integrator
    energy: wp.array[wp.float64]
    work: wp.array[wp.float64]
    line_length: wp.array2d[wp.float64]


@cache
def make_segment_kernel(features: Features, tableau: Tableau, W: int = 8):
    """Kernel for one set of features and one integrator; arguments ``(RodTable, Call, memory, SegmentCall)``."""
    parts = make_parts(features, tableau, "float64", W)
    own, grid, base, tip, record = parts.own, parts.grid, parts.base, parts.tip, parts.record
    layout, memory_type = own.layout, own.memory_type
    first_column, column_count, begin, onto_stretch = own.first_column, own.column_count, own.begin, own.onto_stretch
    force_at, precurvature_here, cause, step_count = own.force_at, own.precurvature_here, own.cause, own.step_count
    load_until, load_rate_until, output_arclength = grid.load_until, grid.load_rate_until, grid.output_arclength
    make_base_of, base_force, base_state, base_column = base.make_base_of, base.base_force, base.base_state, base.base_column
    unknown_unit, base_force_unit = base.unknown_unit, base.force_unit
    find_ends, write_tip, write_tip_column = tip.find_ends, tip.write_tip, tip.write_tip_column
    frame, frame_column = tip.frame, tip.frame_column
    body_moment, body_moment_column = tip.body_moment, tip.body_moment_column
    state_in, column_in, force_column_in = record.state_in, record.column_in, record.force_column_in
    put_state, put_column = record.put_state, record.put_column
    State, Column = base.State, base.Column
    NODES, FIXED, FORCE_ACTS = layout.NODES, layout.FIXED, layout.FORCE
    s_, c_ = layout.state, layout.column
    Q_AT, P_AT, N_AT, ENERGY_AT, WORK_AT = s_["frame"], s_["position"], s_["force"], s_["energy"], s_["work"]
    LENGTHS, LENGTHS_AT = layout.LENGTHS, s_["lengths"]
    DRIVES_VARY, load_drive_columns = layout.DRIVES_VARY, grid.load_drive_columns
    conditions, CONDITIONS = grid.conditions, layout.CONDITIONS
    write_conditions, write_condition_column = conditions.write, conditions.write_column
    length_unit, length_place = conditions.length_unit, conditions.length_place
    GRIPS, GRIPS_AT = features.grip_count, s_["grips"]  # a column's stands alike
    b_, M_AT = breakpoint_state(features), s_["moment"]  # a column's stands alike
    MOMENT_IN, FRAME_IN, POSITION_IN, ANGLES_IN, TORQUES_IN, LENGTHS_IN, GRIPS_IN, WORLD_IN = (b_[name] for name in b_.named)
    MOMENT, TUBES, FIRST, ANGLES, TORQUES = layout.MOMENT, layout.TUBES, layout.FIRST, features.turning_count, layout.TORQUES
    THETA_AT, TAU_AT, TWISTED, FORCE_UNKNOWN = s_["angles"], s_["torques"], layout.seed("torques"), features.base_force_unknown
    TURNED = layout.unknowns.places["angles"].start
    BENT, TURN, LONGER, GRIP = (layout.seed(name) for name in ("moment", "frame", "lengths", "grips"))
    PLACE, PUSHED = layout.unknowns["place"], layout.seed("force")  # variations by them
    WORLD_AT, WORLD_STATE, BY_PLACE = s_["world_force"], layout.WORLD_STATE, features.loads_by_place
    VARIED = layout.UNKNOWNS
    DQ_AT, DP_AT, FORCE_STATE, COLUMN_FRAME = c_["frame"], c_["position"], layout.FORCE_STATE, layout.COLUMN_FRAME

    @wp.func
    def count(call: wp.ref[Call], seg: wp.ref[SegmentCall]) -> int:
        return seg.instance.shape[0]

    @wp.func
    def wanted(call: wp.ref[Call], seg: wp.ref[SegmentCall], t: int) -> bool:
        return True

    @wp.func
    def instance_of(call: wp.ref[Call], seg: wp.ref[SegmentCall], t: int) -> int:
        return seg.instance[t]

    @wp.func
    def given_state(seg: wp.ref[SegmentCall], t: int, known: State, n0: wp.vec3d) -> State:
        """The state where a segment begins."""
        y = known
        q = wp.vec4d(
            seg.state[t, FRAME_IN],
            seg.state[t, wp.static(FRAME_IN + 1)],
            seg.state[t, wp.static(FRAME_IN + 2)],
            seg.state[t, wp.static(FRAME_IN + 3)],
        )
        if wp.static(MOMENT):
            M = wp.vec3d(seg.state[t, MOMENT_IN], seg.state[t, wp.static(MOMENT_IN + 1)], seg.state[t, wp.static(MOMENT_IN + 2)])
            if wp.static(FIXED):
                M = rotate(q, M)
            for j in range(3):
                y[M_AT + j] = M[j]
        for j in range(3):
            y[P_AT + j] = seg.state[t, POSITION_IN + j]
        for i in range(wp.static(ANGLES)):
            y[wp.static(THETA_AT) + i] = seg.state[t, wp.static(ANGLES_IN) + i]
        for i in range(wp.static(TORQUES)):
            y[wp.static(TAU_AT) + i] = seg.state[t, wp.static(TORQUES_IN) + i]
        for j in range(4):
            y[Q_AT + j] = q[j]
        if wp.static(FORCE_STATE):
            N = rotate_inverse(q, n0)
            for j in range(3):
                y[N_AT + j] = N[j]
        for i in range(wp.static(CONDITIONS)):
            y[length_place(i)] = seg.state[t, wp.static(LENGTHS_IN) + i]
        for i in range(wp.static(GRIPS)):
            y[wp.static(GRIPS_AT) + i] = seg.state[t, wp.static(GRIPS_IN) + i]
        if wp.static(WORLD_STATE):
            for j in range(3):
                y[WORLD_AT + j] = seg.state[t, wp.static(WORLD_IN) + j]
        if wp.static(NODES):
            y[ENERGY_AT] = f64(0.0)
        return y

    @wp.func
    def varied(rods: wp.ref[RodTable], case: wp.ref[Instance], base: wp.vec4d, y: State, known: Column, k: int) -> Column:
        """(15), (18b) Column k by what varies where a segment begins: the moment, a torque, the rotation, an angle, the position
        along the axes of the rod at its ``base``, a length or a grip.
        """
        v = known
        q = frame(y)
        if wp.static(TUBES):
            unit = unknown_unit(rods, case)
            v = Column()
            if wp.static(WORLD_STATE):
                if k >= wp.static(PUSHED):  # before these the force varies as it turns with the rods at the base
                    for j in range(3):
                        v[WORLD_AT + j] = known[WORLD_AT + j]
            for i in range(wp.static(ANGLES)):
                if k == wp.static(TURNED) + i:
                    v[wp.static(THETA_AT) + i] = case.scale
            for i in range(wp.static(TORQUES)):
                if k == wp.static(TWISTED) + i:
                    own = section_unit(rods, case, i + wp.static(FIRST), 0)
                    v[wp.static(TAU_AT) + i] = f64(1.0) / own[2]
        dM = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        if wp.static(MOMENT):
            if k >= wp.static(BENT) and k < wp.static(BENT + 3):
                if wp.static(TUBES):
                    for j in range(3):
                        if k == wp.static(BENT) + j:
                            dM[j] = f64(1.0) / unit[j]
                else:
                    dM = wp.vec3d(known[M_AT], known[M_AT + 1], known[M_AT + 2])
        dq = wp.vec4d(f64(0.0), f64(0.0), f64(0.0), f64(0.0))
        if k >= wp.static(TURN) and k < wp.static(TURN + 3):
            e = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
            e[k - wp.static(TURN)] = f64(0.5) * case.scale
            r = wp.vec3d(q[0], q[1], q[2])
            a = q[3] * e + wp.cross(r, e)
            dq = wp.vec4d(a[0], a[1], a[2], -wp.dot(r, e))
        for j in range(4):
            v[DQ_AT + j] = dq[j]
        if wp.static(FIXED):
            m = wp.vec3d(y[M_AT], y[M_AT + 1], y[M_AT + 2])
            dM = rotate(q, dM) + wp.cross(axes_rotation(q, dq), m)
        if wp.static(MOMENT):
            for j in range(3):
                v[M_AT + j] = dM[j]
        for i in range(wp.static(CONDITIONS)):
            if k == wp.static(LONGER) + i:
                v[length_place(i)] = length_unit(rods, case, i)
        for i in range(wp.static(GRIPS)):
            if k == wp.static(GRIP) + i:
                v[wp.static(GRIPS_AT) + i] = case.scale
        if wp.static(BY_PLACE):
            if k >= wp.static(PLACE) and k < wp.static(PLACE + 3):
                e = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
                e[k - wp.static(PLACE)] = case.scale * case.scale
                dp = rotate(base, e)
                for j in range(3):
                    v[DP_AT + j] = dp[j]
        return v

    @wp.func(inline=False)
    def enter(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        seg: wp.ref[SegmentCall],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        p: int,
        job: int,
    ):
        """A lane where its segment begins."""
        t = job // call.parts
        start = seg.start[t]
        given = start > f64(0.0) or seg.given == 1
        b = make_base_of(rods, call, case)
        n0 = base_force(rods, call, case, b.q)
        b.N = rotate_inverse(b.q, n0)
        y = base_state(rods, call, case, b, n0)
        n_start = n0
        if wp.static(FORCE_ACTS):
            if start > f64(0.0):
                n_start -= load_until(rods, call, case, start)
        if given:
            y = given_state(seg, t, y, n_start)
        put_state(case, memory, o, l, y)
        for c in range(column_count(call, job)):
            k = first_column(call, job) + c
            v, dn = base_column(rods, call, case, b, k)
            if wp.static(COLUMN_FRAME):
                if k < call.unknown_columns:
                    if wp.static(TUBES):
                        if given:
                            v = varied(rods, case, b.q, y, v, k)
                            if k < wp.static(PUSHED):  # which at the base turns the force with the rods
                                dn = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
                    else:
                        if wp.static(FIXED):  # the moment's columns as the frame sees them
                            for j in range(3):
                                v[M_AT + j] = f64(0.0)
                                if k == wp.static(BENT) + j:
                                    v[M_AT + j] = f64(1.0) / b.unit[j]
                        v = varied(rods, case, b.q, y, v, k)
                else:
                    if given:
                        # what directions vary is known where the segment begins
                        v = Column()
                    if wp.static(FORCE_ACTS):
                        if start > f64(0.0):
                            dn -= load_rate_until(rods, call, case, start, k - call.unknown_columns)
            put_column(case, memory, o, l, c, v, dn)
            if wp.static(DRIVES_VARY):
                load_drive_columns(rods, call, case, memory, o, l, c, k)
        stop = seg.end[t]
        if seg.at_tip[t] == 1:
            stop = case.length
        begin(call, case, memory, o, l, p, start, stop, n_start)
        if wp.static(NODES):
            output = int(0)
            while output_arclength(rods, call, case, output + 1) <= start:
                output += int(1)
            call.lane[p, OUTPUT] = f64(output)

    @wp.func(inline=False)
    def go_on(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        seg: wp.ref[SegmentCall],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        p: int,
        job: int,
    ):
        """On to the next stretch, by the segment's own equal steps or as in a whole rod."""
        t = job // call.parts
        steps = f64(seg.steps[t])
        multiple = f64(1.0)
        over = call.lane[p, STOP] - seg.start[t]
        if steps == f64(0.0):
            steps = call.steps
            multiple = call.step_multiple
            over = case.length
        onto_stretch(rods, call, case, memory, o, l, p, job, steps, multiple, over)

    @wp.func(inline=False)
    def finish(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        seg: wp.ref[SegmentCall],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        p: int,
        job: int,
        s: f64,
    ):
        """What a lane has found where its segment ends, and the residual, if that is the tip."""
        t = job // call.parts
        y = state_in(case, memory, o, l)
        ends = find_ends(rods, call, case, s)
        n_end = force_at(call, p)
        if wp.static(WORLD_STATE or BY_PLACE or (TUBES and FORCE_UNKNOWN)):
            base = make_base_of(rods, call, case)
        if wp.static(WORLD_STATE):
            n_end = wp.vec3d(y[WORLD_AT], y[WORLD_AT + 1], y[WORLD_AT + 2])
        q = frame(y)
        unit = unknown_unit(rods, case)
        total = f64(0.0)
        if job % call.parts == 0:
            if wp.static(MOMENT):
                M = body_moment(y)
                for j in range(3):
                    seg.end_state[t, MOMENT_IN + j] = M[j]
                    total += wp.abs(M[j])
            for j in range(3):
                seg.end_state[t, POSITION_IN + j] = y[P_AT + j]
            for i in range(wp.static(ANGLES)):
                seg.end_state[t, wp.static(ANGLES_IN) + i] = y[wp.static(THETA_AT) + i]
            for i in range(wp.static(TORQUES)):
                seg.end_state[t, wp.static(TORQUES_IN) + i] = y[wp.static(TAU_AT) + i]
                total += wp.abs(y[wp.static(TAU_AT) + i])
            for j in range(4):
                seg.end_state[t, FRAME_IN + j] = q[j]
            for i in range(wp.static(CONDITIONS)):
                seg.end_state[t, wp.static(LENGTHS_IN) + i] = y[length_place(i)]
            for i in range(wp.static(GRIPS)):
                seg.end_state[t, wp.static(GRIPS_IN) + i] = y[wp.static(GRIPS_AT) + i]
            if wp.static(WORLD_STATE):
                for j in range(3):
                    seg.end_state[t, wp.static(WORLD_IN) + j] = n_end[j]
            if wp.static(NODES):
                seg.energy[t] = y[ENERGY_AT]
                seg.work[t] = y[WORK_AT]
                for i in range(wp.static(LENGTHS)):
                    seg.line_length[t, i] = y[wp.static(LENGTHS_AT) + i]
            if seg.at_tip[t] == 1:
                total += write_tip(rods, call, case, ends, y, n_end, precurvature_here(case, memory, o, l))
                if wp.static(CONDITIONS > 0):
                    total += write_conditions(rods, call, case, y)
            seg.fault[t] = int(call.lane[p, FAULT])
            seg.taken[t] = step_count(memory, o, l)
        first = first_column(call, job)
        for c in range(column_count(call, job)):
            v = column_in(case, memory, o, l, c)
            dM = body_moment_column(y, v)
            turn = body_rotation(q, frame_column(v)) / case.scale
            k = first + c
            for i in range(wp.static(VARIED)):  # tensions and the base force stay
                seg.columns[t, i, k] = wp.where(i == k, f64(1.0), f64(0.0))
            for j in range(3):
                if wp.static(MOMENT):
                    seg.columns[t, wp.static(BENT) + j, k] = unit[j] * dM[j]
                seg.columns[t, wp.static(TURN) + j, k] = turn[j]
                seg.columns[t, wp.static(VARIED) + j, k] = v[wp.static(DP_AT) + j]
                total += wp.abs(dM[j])
            for i in range(wp.static(ANGLES)):
                seg.columns[t, wp.static(TURNED) + i, k] = v[wp.static(THETA_AT) + i] / case.scale
            for i in range(wp.static(TORQUES)):
                own = section_unit(rods, case, i + wp.static(FIRST), 0)
                seg.columns[t, wp.static(TWISTED) + i, k] = own[2] * v[wp.static(TAU_AT) + i]
                total += wp.abs(v[wp.static(TAU_AT) + i])
            for i in range(wp.static(CONDITIONS)):
                seg.columns[t, wp.static(LONGER) + i, k] = v[length_place(i)] / length_unit(rods, case, i)
            for i in range(wp.static(GRIPS)):
                seg.columns[t, wp.static(GRIP) + i, k] = v[wp.static(GRIPS_AT) + i] / case.scale
            dn = force_column_in(case, memory, o, l, c)
            if wp.static(WORLD_STATE):
                dn = wp.vec3d(v[WORLD_AT], v[WORLD_AT + 1], v[WORLD_AT + 2])
            if wp.static(WORLD_STATE or (TUBES and FORCE_UNKNOWN)):
                pushed = rotate_inverse(base.q, dn) / base_force_unit(rods, case)
                for j in range(3):
                    seg.columns[t, wp.static(PUSHED) + j, k] = pushed[j]
            if wp.static(BY_PLACE):
                place = rotate_inverse(base.q, wp.vec3d(v[DP_AT], v[DP_AT + 1], v[DP_AT + 2])) / (case.scale * case.scale)
                for j in range(3):
                    seg.columns[t, wp.static(PLACE) + j, k] = place[j]
            if seg.at_tip[t] == 1:
                total += write_tip_column(rods, call, case, ends, y, v, n_end, dn, k)
                if wp.static(CONDITIONS > 0):
                    total += write_condition_column(rods, call, case, v, k)
        if not wp.isfinite(total):
            seg.fault[t] = cause(memory, o, l, wp.static(int(Fault.NONFINITE)))

    jobs = SimpleNamespace(
        Jobs=SegmentCall, count=count, wanted=wanted, instance_of=instance_of, enter=enter, go_on=go_on, finish=finish
    )
    carry = make_carry(parts, features, jobs)

    @own_module(max_unroll=1)
    def integrate(rods: RodTable, call: Call, memory: wp.array2d(dtype=f64), seg: SegmentCall):
        """From the start of each segment to its end, stretch by stretch; then the residual, if that is the tip."""
        thread = wp.tid()
        carry(rods, call, seg, memory[thread], thread)

    return integrate
