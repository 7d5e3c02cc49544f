# mypy: ignore-errors
"""The base of a backbone: unknowns and inputs turned into its state there, (9), (10), and into its columns, one lane at a time.

Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.instance import bending_stiffness, section_unit
from multirod.models.backbone.kernels.layout.arguments import Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.layout.rows import InputOffsets
from multirod.models.backbone.kernels.numbers.scalars import axes_rotation, rotate, rotate_inverse, turn_base

f64 = wp.float64


def make_base(layout: Layout, grid: SimpleNamespace) -> SimpleNamespace:
    """Functions of the base."""
    n, features = layout.n, layout.features
    State = wp.types.vector(length=layout.state.size, dtype=f64)
    Column = wp.types.vector(length=layout.column.size, dtype=f64)
    PerRod = wp.types.vector(length=n, dtype=f64)
    s, c = layout.state, layout.column
    N_AT, THETA_AT, TAU_AT, Q_AT, ENERGY_AT = s["force"], s["angles"], s["torques"], s["frame"], s["energy"]
    M_AT = s["moment"]
    DQ_AT, WORLD_AT, WORLD_STATE = c["frame"], s["world_force"], layout.WORLD_STATE  # a column's stands alike
    FORCE_STATE, FRAME, COLUMN_FRAME = layout.FORCE_STATE, layout.FRAME, layout.COLUMN_FRAME
    FORCE_UNKNOWN, TRANSMISSION, TUBES = features.base_force_unknown, features.transmission, layout.TUBES
    FIRST, CONCENTRIC = layout.FIRST, not layout.ECCENTRIC
    GRIPS, GRIPS_AT = layout.DRIVES * layout.FRICTION, s["grips"]
    MOMENT, TORQUES, FORCE, FIXED = layout.MOMENT, layout.TORQUES, layout.FORCE, layout.FIXED
    HELD, NODES, CURVATURE_TERMS = features.held, layout.NODES, layout.CURVATURE_TERMS
    # unknowns, and so columns: bending moments, torques, base force, directions. The third of the moments is the torque of rod 1,
    # where the frame is its own; of rods rigid in torsion that of all, and so it is of rods side by side. Several unloaded rods
    # have torques only, that of rod 1 the negative sum of the others
    WHOLE = TUBES and (TORQUES == 0 or layout.ECCENTRIC)
    FIRST_MOMENT, FIRST_FORCE = layout.seed("moment"), layout.seed("force")
    FIRST_TORQUE = layout.seed("torques") - FIRST  # less the index of its rod
    MOMENTS = FIRST_MOMENT + ((3 if WHOLE else 2) if MOMENT else 0)
    LAST_TORQUE = FIRST_TORQUE + n if TORQUES > 0 or not TUBES else MOMENTS
    at = InputOffsets(n)
    ROTATION, TRANSLATION = at.ROTATION, at.TRANSLATION
    total_load, total_load_rate = grid.total_load, grid.total_load_rate
    section_from, moved = grid.section_from, grid.moved

    @wp.struct
    class Base:
        """The base of one instance, as its state and its columns need it."""

        q: wp.vec4d
        M: wp.vec3d  # (10)
        N: wp.vec3d
        unit: wp.vec3d  # (10) curvature per moment
        torque_unit: PerRod  # (10) curvature per torque of each rod
        angles: PerRod
        torques: PerRod
        # (9) the rods behind the base plate, from their bases to s = 0
        twist: PerRod  # integral of u*_z
        compliance: PerRod  # integral of 1/GJ
        twist_rate: PerRod  # u*_z at s = 0
        compliance_rate: PerRod  # 1/GJ at s = 0

    @wp.func
    def torsional_precurvature(rods: wp.ref[RodTable], case: wp.ref[Instance], i: int, m: int, t: f64) -> f64:
        """(6) u*_z of section m of rod i, at t from -1 to 1."""
        u = f64(0.0)
        for k in range(wp.static(CURVATURE_TERMS)):
            u = t * u + rods.precurvature[case.rods, i, m, 3 * (wp.static(CURVATURE_TERMS - 1) - k) + 2]
        return u

    @wp.func
    def torsional_precurvature_integral(rods: wp.ref[RodTable], case: wp.ref[Instance], i: int, m: int, t: f64) -> f64:
        """Integral of u*_z of section m of rod i over -1 to t."""
        upper = f64(0.0)
        lower = f64(0.0)
        for k in range(wp.static(CURVATURE_TERMS)):
            j = wp.static(CURVATURE_TERMS - 1) - k
            a = rods.precurvature[case.rods, i, m, 3 * j + 2] / f64(j + 1)
            upper = t * upper + a
            lower = a - lower
        return t * upper + lower

    @wp.func
    def unknown_unit(rods: wp.ref[RodTable], case: wp.ref[Instance]) -> wp.vec3d:
        """(10) Curvature per moment, by the first sections: it does not jump when a section is pulled into the base."""
        result = section_unit(rods, case, 0, 0)
        if wp.static(TUBES):
            EI = f64(0.0)
            for j in range(rods.end.shape[1]):
                EI += bending_stiffness(rods, case, j, 0)
            result[0] = f64(1.0) / EI
            result[1] = f64(1.0) / EI
        return result

    @wp.func
    def force_unit(rods: wp.ref[RodTable], case: wp.ref[Instance]) -> f64:
        """(13) Force per unknown of the base force."""
        return bending_stiffness(rods, case, 0, 0) / case.scale

    @wp.func
    def unknown_vector(call: wp.ref[Call], case: wp.ref[Instance], j: int) -> wp.vec3d:
        """Three unknowns."""
        t = case.index
        return wp.vec3d(call.problem.unknowns[t, j], call.problem.unknowns[t, j + 1], call.problem.unknowns[t, j + 2])

    @wp.func
    def base_torques(call: wp.ref[Call], case: wp.ref[Instance], unit: PerRod) -> PerRod:
        """(10) tau_i(0) of several rods."""
        torques = PerRod()
        last = int(wp.static(TORQUES + FIRST))
        for i in range(wp.static(0 if MOMENT else FIRST), last):
            torques[i] = call.problem.unknowns[case.index, wp.static(FIRST_TORQUE) + i] / unit[i]
            if wp.static(CONCENTRIC and not MOMENT):
                torques[0] = torques[0] - torques[i]
        return torques

    @wp.func
    def base_moment(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], b: Base) -> wp.vec3d:
        """(10) M(0)."""
        if wp.static(not MOMENT):
            return wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        M = unknown_vector(call, case, wp.static(FIRST_MOMENT))
        if wp.static(not TUBES):
            r = case.rods
            M -= wp.vec3d(rods.precurvature[r, 0, 0, 0], rods.precurvature[r, 0, 0, 1], rods.precurvature[r, 0, 0, 2])
        M = wp.cw_div(M, b.unit)
        if wp.static(TUBES and not WHOLE):
            M[2] = f64(0.0)
            for i in range(rods.end.shape[1]):
                M[2] = M[2] + b.torques[i]
        return M

    @wp.func
    def behind_plate(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], known: Base) -> Base:
        """(9) What the rods twist behind the plate; what stands at s = 0 is of the sections that go on from there."""
        b = known
        factor = f64(1.0)
        if wp.static(TUBES and not HELD):
            factor = wp.sqrt(call.problem.load_factor[case.index])  # raised with the loads, as along the rod
        for i in range(rods.end.shape[1]):
            depth = -call.problem.inputs[case.index, wp.static(TRANSLATION) + i]
            if depth >= f64(0.0):
                begin = f64(0.0)
                last = wp.min(section_from(rods, call, case, i, f64(0.0)), rods.end.shape[2] - 1)
                for m in range(last + 1):
                    end = rods.end[case.rods, i, m]
                    half = f64(0.5) * (end - begin)
                    if half > f64(0.0):
                        size = wp.min(end, depth) - begin
                        t = size / half - f64(1.0)
                        GJ_inverse = rods.material[case.rods, i, m, 5]
                        b.compliance[i] = b.compliance[i] + size * GJ_inverse
                        b.compliance_rate[i] = GJ_inverse
                        b.twist[i] = b.twist[i] + factor * half * torsional_precurvature_integral(rods, case, i, m, t)
                        b.twist_rate[i] = factor * torsional_precurvature(rods, case, i, m, t)
                    begin = end
        return b

    @wp.func
    def base_force(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], q: wp.vec4d) -> wp.vec3d:
        """n(0): unknown under a follower force (13) or with a held tip, else all that acts further on (3a)."""
        if wp.static(not FORCE):
            return wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        if wp.static(not FORCE_UNKNOWN):
            return total_load(rods, call, case)
        return rotate(q, force_unit(rods, case) * unknown_vector(call, case, wp.static(FIRST_FORCE)))

    @wp.func
    def frame_angle(b: Base) -> f64:
        """Angle of the frame at the base: that of rod 1, or none."""
        if wp.static(CONCENTRIC):
            return b.angles[0]
        return f64(0.0)

    @wp.func(inline=False)
    def make_base_of(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance]) -> Base:
        """(9), (10)"""
        b = Base()
        b.unit = unknown_unit(rods, case)
        for i in range(rods.end.shape[1]):
            own = section_unit(rods, case, i, 0)
            b.torque_unit[i] = own[2]
        if wp.static(TUBES and TORQUES > 0):
            b.torques = base_torques(call, case, b.torque_unit)
        b.M = base_moment(rods, call, case, b)
        if wp.static(not TUBES):
            b.torques[0] = b.M[2]
        for i in range(rods.end.shape[1]):
            b.angles[i] = call.problem.inputs[case.index, wp.static(ROTATION) + i]
            if wp.static(not HELD):
                if i > 0:  # the natural branch of several rods begins where none is turned against another
                    b.angles[i] = b.angles[0] + call.problem.load_factor[case.index] * (b.angles[i] - b.angles[0])
        if wp.static(TRANSMISSION):
            b = behind_plate(rods, call, case, b)
            b.angles += b.twist + wp.cw_mul(b.compliance, b.torques)
        half = f64(0.5) * frame_angle(b)
        b.q = wp.vec4d(f64(0.0), f64(0.0), wp.sin(half), wp.cos(half))
        return b

    @wp.func
    def base_state(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], b: Base, n0: wp.vec3d) -> State:
        """(9), (10): the state at the base, where the force is n0."""
        y = State()
        if wp.static(MOMENT):
            M = b.M
            if wp.static(FIXED):  # (4b)
                M = rotate(b.q, M)
            for j in range(3):
                y[M_AT + j] = M[j]
        if wp.static(FORCE_STATE):
            N = rotate_inverse(b.q, n0)
            for j in range(3):
                y[N_AT + j] = N[j]
        if wp.static(WORLD_STATE):
            for j in range(3):
                y[WORLD_AT + j] = n0[j]
        for i in range(wp.static(FIRST), rods.end.shape[1]):
            y[wp.static(THETA_AT) + i - wp.static(FIRST)] = b.angles[i] - frame_angle(b)
        if wp.static(TORQUES > 0):
            for i in range(wp.static(FIRST), rods.end.shape[1]):
                y[wp.static(TAU_AT) + i - wp.static(FIRST)] = b.torques[i]
        for i in range(wp.static(GRIPS)):
            y[wp.static(GRIPS_AT) + i] = f64(1.0)
        if wp.static(FRAME):
            for j in range(4):
                y[Q_AT + j] = b.q[j]
        if wp.static(NODES and TRANSMISSION):  # what is stored behind the base plate
            y[ENERGY_AT] = f64(0.5) * wp.dot(b.compliance, wp.cw_mul(b.torques, b.torques))
        return y

    @wp.func
    def angle_rate(call: wp.ref[Call], case: wp.ref[Instance], b: Base, k: int, i: int) -> f64:
        """(9) Variation of an angle for direction k: a rod that is pushed out has less of itself behind the plate."""
        rate = call.problem.directions[case.direction, k, wp.static(ROTATION) + i]
        if wp.static(TRANSMISSION):
            rate -= moved(call, case, k, i) * (b.twist_rate[i] + b.compliance_rate[i] * b.torques[i])
        return rate

    @wp.func(inline=False)
    def base_column(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], b: Base, k: int):
        """(9), (10), (15), (16): column k at the base, and its dn; ``k`` counts unknowns, then directions."""
        y = Column()
        dn = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        dN = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))  # beside the frame's turning
        turn = f64(0.0)  # of rod 1
        direction = k - call.unknown_columns
        if direction < 0:
            if k < wp.static(MOMENTS):
                j = k - wp.static(FIRST_MOMENT)
                y[M_AT + j] = f64(1.0) / b.unit[j]
            if k >= wp.static(MOMENTS) and k < wp.static(LAST_TORQUE):
                i = k - wp.static(FIRST_TORQUE)
                torque = f64(1.0) / b.torque_unit[i]
                others = f64(0.0)  # what the frame of rod 1 takes the other rods' angles back by
                if wp.static(CONCENTRIC):
                    if wp.static(MOMENT):
                        y[wp.static(M_AT + 2)] = torque
                        if i == 0:
                            turn = b.compliance[0] * torque
                    else:
                        turn = -b.compliance[0] * torque
                others -= turn
                for j in range(wp.static(FIRST), rods.end.shape[1]):
                    angle = others
                    if j == i:
                        angle += b.compliance[j] * torque
                        if wp.static(TORQUES > 0):
                            y[wp.static(TAU_AT) + j - wp.static(FIRST)] = torque
                    y[wp.static(THETA_AT) + j - wp.static(FIRST)] = angle
            if wp.static(FORCE_UNKNOWN):
                if k >= wp.static(FIRST_FORCE):
                    dN[k - wp.static(FIRST_FORCE)] = force_unit(rods, case)
        else:
            if wp.static(CONCENTRIC):
                turn = angle_rate(call, case, b, direction, 0)
            for j in range(wp.static(FIRST), rods.end.shape[1]):
                y[wp.static(THETA_AT) + j - wp.static(FIRST)] = angle_rate(call, case, b, direction, j) - turn
        if wp.static(FORCE):
            if wp.static(FORCE_UNKNOWN):
                dn = rotate(b.q, dN + turn * wp.vec3d(-b.N[1], b.N[0], f64(0.0)))  # N is given in the frame: n turns with it
            else:
                if direction >= 0:
                    dn = total_load_rate(rods, call, case, direction)
            if wp.static(FORCE_STATE):
                dN = rotate_inverse(b.q, dn) + turn * wp.vec3d(b.N[1], -b.N[0], f64(0.0))
                for j in range(3):
                    y[N_AT + j] = dN[j]
        if wp.static(WORLD_STATE):
            for j in range(3):
                y[WORLD_AT + j] = dn[j]
        if wp.static(COLUMN_FRAME):
            dq = turn_base(b.q, turn)
            for j in range(4):
                y[DQ_AT + j] = dq[j]
            if wp.static(FIXED):  # (18b)
                m = rotate(b.q, b.M)
                dm = rotate(b.q, wp.vec3d(y[M_AT], y[M_AT + 1], y[M_AT + 2])) + wp.cross(axes_rotation(b.q, dq), m)
                for j in range(3):
                    y[M_AT + j] = dm[j]
        return y, dn

    return SimpleNamespace(
        State=State,
        Column=Column,
        PerRod=PerRod,
        make_base_of=make_base_of,
        base_force=base_force,
        base_state=base_state,
        base_column=base_column,
        unknown_unit=unknown_unit,
        force_unit=force_unit,
    )
