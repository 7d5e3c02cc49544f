# mypy: ignore-errors
"""Equations (1) to (5) and (14) to (20) along the backbone: the rates of the state and its columns.

Numbers in parentheses are those of ``docs/model.md``. ``y`` is the state, ``z`` a stretch between two nodes, ``x`` the
arclength from its start. What all rates need is found once for each place: ``a``, a ``Point``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_equation_kernels import make_equation_functions
from multirod.models.backbone_layout_kernels import Layout
from multirod.models.backbone_tube_kernels import make_point_types, make_tube_functions
from multirod.models.features import Features


def make_rate_functions(layout: Layout, features: Features, stretch: SimpleNamespace) -> SimpleNamespace:
    """The rates of the state and its columns."""
    n, C, NX, ND = layout.n, layout.C, layout.NX, layout.ND
    real, vec3, vec4 = layout.real, layout.vec3, layout.vec4
    State, Column, Stretch = layout.State, layout.Column, layout.Stretch
    types = make_point_types(layout)
    Point, Given = types.Point, types.Given
    N_AT, THETA_AT, TAU_AT, STATICS = layout.N_AT, layout.THETA_AT, layout.TAU_AT, layout.STATICS
    COLUMN_Q_AT, COLUMN_P_AT, COLUMN_SIZE = layout.COLUMN_Q_AT, layout.COLUMN_P_AT, layout.COLUMN_SIZE
    Q_AT, P_AT, ENERGY_AT, WORK_AT = layout.Q_AT, layout.P_AT, layout.ENERGY_AT, layout.WORK_AT
    TUBES, MOMENT, TORQUES = n > 1, layout.MOMENT, layout.TORQUES
    FORCE, FORCE_STATE, FRAME, COLUMN_FRAME = layout.FORCE, layout.FORCE_STATE, layout.FRAME, layout.COLUMN_FRAME
    SPREAD_MOMENT, SHEAR, NODES = layout.SPREAD_MOMENT, features.shear, features.nodes
    POSE, POSE_COLUMNS = layout.POSE, layout.POSE_COLUMNS
    # terms of a column that an input imposes; an unknown base force makes n depend on unknowns too
    GIVEN_FORCE = FORCE and not FORCE_STATE and (ND > 0 or (features.base_force_unknown and NX > 0))
    GIVEN_MOMENT = ND > 0 and COLUMN_FRAME
    GIVEN_CURVATURE = ND > 0 and layout.CURVATURE_TERMS > 1

    equation = make_equation_functions(real)
    rotate, rotate_inverse, tangent, body_rotation = (
        equation.rotate,
        equation.rotate_inverse,
        equation.tangent,
        equation.body_rotation,
    )
    quaternion_rate, moment_rate, force_rate = equation.quaternion_rate, equation.moment_rate, equation.force_rate
    moment_rate_variation = equation.moment_rate_variation
    precurvature, compliance, shear_compliance = stretch.precurvature, stretch.compliance, stretch.shear_compliance
    spread_moment, world_force, growth = stretch.spread_moment, stretch.world_force, stretch.growth
    world_force_rate, spread_moment_rate = stretch.world_force_rate, stretch.spread_moment_rate
    precurvature_rate = stretch.precurvature_rate
    tube = make_tube_functions(layout, features, types, stretch)
    turned_tubes, flexibility, shared_curvature = tube.turned_tubes, tube.flexibility, tube.shared_curvature
    with_turned_stiffness, tube_energy, turn_into_rod_1 = tube.with_turned_stiffness, tube.tube_energy, tube.turn_into_rod_1
    angle_rate, torque_rate = tube.angle_rate, tube.torque_rate
    angle_rate_variation, torque_rate_variation = tube.angle_rate_variation, tube.torque_rate_variation
    shared_curvature_variation = tube.shared_curvature_variation

    @wp.func
    def frame(y: State) -> vec4:
        """q; where nothing depends on the frame, that of no rotation."""
        if wp.static(FRAME):
            return vec4(y[Q_AT], y[Q_AT + 1], y[Q_AT + 2], y[Q_AT + 3])
        return vec4(real(0.0), real(0.0), real(0.0), real(1.0))

    @wp.func
    def body_force(y: State, z: Stretch, x: real) -> vec3:
        """N: a state (3b), or from the frame (3a)."""
        if wp.static(FORCE_STATE):
            return vec3(y[N_AT], y[N_AT + 1], y[N_AT + 2])
        if wp.static(FORCE and not FORCE_STATE):
            return rotate_inverse(frame(y), world_force(z, x))
        return vec3(real(0.0), real(0.0), real(0.0))

    @wp.func
    def point_at(y: State, z: Stretch, x: real) -> Point:
        """Force (3a) and strains (5) to (7) at x from the start of the stretch."""
        a = Point()
        a.q = frame(y)
        if wp.static(MOMENT):
            a.M = vec3(y[0], y[1], y[2])
        a.N = body_force(y, z, x)
        a.u_star = precurvature(z, 0, x)
        if wp.static(TUBES):
            a.tubes = turned_tubes(y, z, x)
            a.flexibility = flexibility(z, a.tubes)
            a.u = shared_curvature(y, z, a)
            a.tubes = with_turned_stiffness(a)
        else:
            a.u = a.u_star + wp.cw_mul(compliance(z), a.M)
        if wp.static(SHEAR):
            a.extension = wp.cw_mul(shear_compliance(z), a.N)
        if wp.static(SPREAD_MOMENT):
            a.moment_load = rotate_inverse(a.q, spread_moment(z, x))
        return a

    @wp.func
    def moment_rate_at(a: Point) -> vec3:
        """(4) M'."""
        rate = moment_rate(a.M, a.u, a.N)
        if wp.static(SHEAR):
            rate += wp.cross(a.N, a.extension)
        if wp.static(SPREAD_MOMENT):
            rate -= a.moment_load
        return rate

    @wp.func
    def position_rate(a: Point) -> vec3:
        """(1) p'."""
        rate = tangent(a.q)
        if wp.static(SHEAR):
            rate += rotate(a.q, a.extension)
        return rate

    @wp.func
    def energy_rate(y: State, z: Stretch, x: real, a: Point) -> real:
        """(14) Energy per length."""
        energy = wp.dot(a.N, a.extension)
        if wp.static(TUBES):
            energy += tube_energy(y, z, x, a)
        else:
            energy += wp.dot(a.M, a.u - a.u_star)
        return real(0.5) * energy

    @wp.func
    def given_by_direction(z: Stretch, x: real, a: Point, k: int) -> Given:
        """What direction k imposes on its column, the force aside."""
        given = Given()
        if wp.static(GIVEN_MOMENT):
            given.moment_load = rotate_inverse(a.q, spread_moment_rate(z, x, k))
        if wp.static(GIVEN_CURVATURE):
            for i in range(wp.static(n)):
                du_star = precurvature_rate(z, i, x, k)
                if wp.static(TUBES):
                    du_star = turn_into_rod_1(a, i, du_star)
                for j in range(3):
                    given.u_star[i, j] = du_star[j]
        return given

    @wp.func
    def column_rotation(q: vec4, column: Column) -> vec3:
        """(15) dphi of a column."""
        if wp.static(COLUMN_FRAME):
            j = wp.static(COLUMN_Q_AT)
            return body_rotation(q, vec4(column[j], column[j + 1], column[j + 2], column[j + 3]))
        return vec3(real(0.0), real(0.0), real(0.0))

    @wp.func
    def column_force(a: Point, column: Column, dphi: vec3, given: Given) -> vec3:
        """(16) dN of a column."""
        dN = vec3(real(0.0), real(0.0), real(0.0))
        if wp.static(FORCE_STATE):
            dN = vec3(column[N_AT], column[N_AT + 1], column[N_AT + 2])
        elif wp.static(FORCE):
            dN = wp.cross(a.N, dphi)
        if wp.static(GIVEN_FORCE):
            dN += given.force
        return dN

    @wp.func
    def column_curvature(z: Stretch, a: Point, column: Column, given: Given) -> vec3:
        """(17) du of a column."""
        if wp.static(TUBES):
            return shared_curvature_variation(z, a, column, given)
        du = wp.cw_mul(compliance(z), vec3(column[0], column[1], column[2]))
        if wp.static(GIVEN_CURVATURE):
            du += vec3(given.u_star[0, 0], given.u_star[0, 1], given.u_star[0, 2])
        return du

    @wp.func
    def column_moment_rate(z: Stretch, a: Point, column: Column, dphi: vec3, dN: vec3, du: vec3, given: Given) -> vec3:
        """(18) dM' of a column."""
        rate = moment_rate_variation(a.M, vec3(column[0], column[1], column[2]), a.u, du, dN)
        if wp.static(SHEAR):
            rate += wp.cross(dN, a.extension) + wp.cross(a.N, wp.cw_mul(shear_compliance(z), dN))
        if wp.static(SPREAD_MOMENT):
            rate -= wp.cross(a.moment_load, dphi)
        if wp.static(GIVEN_MOMENT):
            rate -= given.moment_load
        return rate

    @wp.func
    def column_position_rate(z: Stretch, a: Point, dphi: vec3, dN: vec3) -> vec3:
        """(19) dp' of a column."""
        e3 = vec3(real(0.0), real(0.0), real(1.0))
        if wp.static(SHEAR):
            return rotate(a.q, wp.cross(dphi, e3 + a.extension) + wp.cw_mul(shear_compliance(z), dN))
        return rotate(a.q, wp.cross(dphi, e3))

    @wp.func
    def column_rate(z: Stretch, a: Point, column: Column, given: Given) -> Column:
        """(15) to (19): rate of one column."""
        dphi = column_rotation(a.q, column)
        dN = column_force(a, column, dphi, given)
        du = column_curvature(z, a, column, given)
        d = Column()
        if wp.static(MOMENT):
            dM_s = column_moment_rate(z, a, column, dphi, dN, du, given)
            for j in range(3):
                d[j] = dM_s[j]
        if wp.static(FORCE_STATE):
            dN_s = wp.cross(dN, a.u) + wp.cross(a.N, du)
            for j in range(3):
                d[N_AT + j] = dN_s[j]
        for i in range(1, wp.static(n)):
            d[wp.static(THETA_AT) + i - 1] = angle_rate_variation(z, column, du, given, i)
        for i in range(1, wp.static(TORQUES + 1)):
            d[wp.static(TAU_AT) + i - 1] = torque_rate_variation(a, column, du, given, i)
        if wp.static(COLUMN_FRAME):
            k = wp.static(COLUMN_Q_AT)
            dq = vec4(column[k], column[k + 1], column[k + 2], column[k + 3])
            dq_s = quaternion_rate(dq, a.u) + quaternion_rate(a.q, du)
            for j in range(4):
                d[COLUMN_Q_AT + j] = dq_s[j]
        if wp.static(POSE_COLUMNS):
            dp_s = column_position_rate(z, a, dphi, dN)
            for j in range(3):
                d[COLUMN_P_AT + j] = dp_s[j]
        return d

    @wp.func
    def as_column(y: State) -> Column:
        """What of the state itself stands in a column."""
        column = Column()
        for j in range(wp.static(STATICS)):
            column[j] = y[j]
        for j in range(wp.static(COLUMN_P_AT - COLUMN_Q_AT)):
            column[COLUMN_Q_AT + j] = y[Q_AT + j]
        for j in range(wp.static(COLUMN_SIZE - COLUMN_P_AT)):
            column[COLUMN_P_AT + j] = y[P_AT + j]
        return column

    @wp.func
    def column_of(y: State, k: int) -> Column:
        """Column k of the state."""
        column = Column()
        for j in range(wp.static(COLUMN_SIZE)):
            column[j] = y[STATICS + k * COLUMN_SIZE + j]
        return column

    @wp.func
    def rates(y: State, z: Stretch, x: real) -> State:
        """(1) to (8), (14), and for each column (15) to (20)."""
        a = point_at(y, z, x)
        d = State()
        if wp.static(MOMENT):
            M_s = moment_rate_at(a)
            for j in range(3):
                d[j] = M_s[j]
        if wp.static(FORCE_STATE):
            N_s = force_rate(a.N, a.u)
            for j in range(3):
                d[N_AT + j] = N_s[j]
        for i in range(1, wp.static(n)):
            d[wp.static(THETA_AT) + i - 1] = angle_rate(y, z, x, a, i)
        for i in range(1, wp.static(TORQUES + 1)):
            d[wp.static(TAU_AT) + i - 1] = torque_rate(a, i)
        if wp.static(FRAME):
            q_s = quaternion_rate(a.q, a.u)
            for j in range(4):
                d[Q_AT + j] = q_s[j]
        if wp.static(POSE):
            p_s = position_rate(a)
            for j in range(3):
                d[P_AT + j] = p_s[j]
        if wp.static(NODES):
            d[ENERGY_AT] = energy_rate(y, z, x, a)
            d[WORK_AT] = a.N[2] + wp.dot(a.N, a.extension)
        for c in range(wp.static(C)):
            given = Given()
            if wp.static(c >= NX):
                given = given_by_direction(z, x, a, c - NX)
            if wp.static(GIVEN_FORCE and c < NX):
                given.force = rotate_inverse(a.q, vec3(z.force_columns[c, 0], z.force_columns[c, 1], z.force_columns[c, 2]))
            if wp.static(GIVEN_FORCE and c >= NX):
                given.force = rotate_inverse(a.q, world_force_rate(z, x, c - NX))
            column_s = column_rate(z, a, column_of(y, c), given)
            if wp.static(c >= NX):
                column_s += growth(z, c - NX) * as_column(d)  # (20)
            for j in range(wp.static(COLUMN_SIZE)):
                d[wp.static(STATICS + c * COLUMN_SIZE) + j] = column_s[j]
        return d

    return SimpleNamespace(
        frame=frame,
        body_force=body_force,
        point_at=point_at,
        column_of=column_of,
        column_rotation=column_rotation,
        inner_torque=tube.inner_torque,
        turn_into_rod_1=tube.turn_into_rod_1,
        rates=rates,
    )
