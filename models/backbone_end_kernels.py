# mypy: ignore-errors
"""Both ends of one backbone: the state at the base (9), (10), and the residual at the tip (11) to (13), with their columns.

Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_equation_kernels import make_equation_functions
from multirod.models.backbone_layout_kernels import Call, InputOffsets, Layout, RodTable
from multirod.models.features import Features

f64 = wp.float64


def make_base_functions(layout: Layout, features: Features, grid: SimpleNamespace) -> SimpleNamespace:
    """Functions that turn unknowns and inputs into the state at the base."""
    n, C, NX = layout.n, layout.C, layout.NX
    State, Column, Instance, Node = layout.State, layout.Column, layout.Instance, layout.Node
    PerRod, ColumnVectors, CURVATURE_TERMS = layout.PerRod, layout.ColumnVectors, layout.CURVATURE_TERMS
    N_AT, THETA_AT, TAU_AT, STATICS = layout.N_AT, layout.THETA_AT, layout.TAU_AT, layout.STATICS
    COLUMN_Q_AT, COLUMN_SIZE, Q_AT = layout.COLUMN_Q_AT, layout.COLUMN_SIZE, layout.Q_AT
    ENERGY_AT, NODES = layout.ENERGY_AT, features.nodes
    FORCE_STATE, FRAME, COLUMN_FRAME = layout.FORCE_STATE, layout.FRAME, layout.COLUMN_FRAME
    FORCE_UNKNOWN, TRANSMISSION, TUBES = features.base_force_unknown, features.transmission, n > 1
    MOMENT, TORQUES = layout.MOMENT, layout.TORQUES
    # unknowns, and so columns: bending moments, torques, base force, directions. Where several rods are rigid
    # in torsion, the torque of all is the third of the moments; several unloaded rods have torques only, that of rod 1 the
    # negative sum of the others
    RIGID = TUBES and TORQUES == 0
    FIRST_TORQUE = 2 if MOMENT else -1  # less the index of its rod
    MOMENTS = min((3 if RIGID else 2) if MOMENT else 0, NX)
    LAST_TORQUE = MOMENTS if RIGID else min(FIRST_TORQUE + n, NX)
    FIRST_FORCE = layout.UNKNOWNS - 3
    ROTATION = InputOffsets(n).ROTATION
    total_load = grid.total_load
    equation = make_equation_functions(layout.real)
    rotate, rotate_inverse, turn_base = equation.rotate, equation.rotate_inverse, equation.turn_base

    @wp.struct
    class Transmission:
        """(9) The rods behind the base plate, from their bases to s = 0."""

        twist: PerRod  # integral of u*_z
        compliance: PerRod  # integral of 1/GJ
        twist_rate: PerRod  # u*_z at s = 0
        compliance_rate: PerRod  # 1/GJ at s = 0

    @wp.func
    def torsional_precurvature(rods: RodTable, case: Instance, i: int, m: int, t: f64) -> f64:
        """(6) u*_z of section m of rod i, at t from -1 to 1."""
        u = f64(0.0)
        for k in range(wp.static(CURVATURE_TERMS)):
            u = t * u + rods.precurvature[case.rods, i, m, 3 * (wp.static(CURVATURE_TERMS - 1) - k) + 2]
        return u

    @wp.func
    def torsional_precurvature_integral(rods: RodTable, case: Instance, i: int, m: int, t: f64) -> f64:
        """Integral of u*_z of section m of rod i over -1 to t."""
        upper = f64(0.0)
        lower = f64(0.0)
        for k in range(wp.static(CURVATURE_TERMS)):
            j = wp.static(CURVATURE_TERMS - 1) - k
            c = rods.precurvature[case.rods, i, m, 3 * j + 2] / f64(j + 1)
            upper = t * upper + c
            lower = c - lower
        return t * upper + lower

    @wp.func
    def transmission_of(rods: RodTable, call: Call, case: Instance, node: Node) -> Transmission:
        """(9) What the rods twist behind the plate; what stands at s = 0 is of the sections that go on from there."""
        out = Transmission()
        if wp.static(TRANSMISSION):
            factor = f64(1.0)
            if wp.static(TUBES and not features.held):
                factor = wp.sqrt(call.load_factor[case.index])  # raised with the loads, as along the rod
            for i in range(wp.static(n)):
                depth = -case.shift[i]
                if depth > f64(0.0):
                    begin = f64(0.0)
                    for m in range(node.section[i] + 1):
                        end = rods.end[case.rods, i, m]
                        size = wp.min(end, depth) - begin
                        if size > f64(0.0):
                            half = f64(0.5) * (end - begin)
                            t = size / half - f64(1.0)
                            GJ_inverse = rods.material[case.rods, i, m, 5]
                            out.compliance[i] = out.compliance[i] + size * GJ_inverse
                            out.compliance_rate[i] = GJ_inverse
                            out.twist[i] = out.twist[i] + factor * half * torsional_precurvature_integral(rods, case, i, m, t)
                            out.twist_rate[i] = factor * torsional_precurvature(rods, case, i, m, t)
                        begin = end
        return out

    @wp.func
    def unknown_unit(rods: RodTable, case: Instance, i: int) -> wp.vec3d:
        """(10) Curvature per moment, by the first sections: it does not jump when a section is pulled into the base."""
        EI_x = rods.material[case.rods, i, 0, 0]
        EI_y = rods.material[case.rods, i, 0, 1]
        GJ = wp.min(rods.material[case.rods, i, 0, 2], wp.max(EI_x, EI_y))
        if wp.static(TUBES):
            EI = f64(0.0)
            for j in range(wp.static(n)):
                EI += wp.max(rods.material[case.rods, j, 0, 0], rods.material[case.rods, j, 0, 1])
            return wp.vec3d(f64(1.0) / EI, f64(1.0) / EI, f64(1.0) / GJ)
        return wp.vec3d(f64(1.0) / EI_x, f64(1.0) / EI_y, f64(1.0) / GJ)

    @wp.func
    def force_unit(rods: RodTable, case: Instance) -> f64:
        """(13) Force per unknown of the base force."""
        return wp.max(rods.material[case.rods, 0, 0, 0], rods.material[case.rods, 0, 0, 1]) / case.scale

    @wp.func
    def base_torques(rods: RodTable, call: Call, case: Instance) -> PerRod:
        """(10) tau_i(0) of several rods."""
        torques = PerRod()
        for i in range(wp.static(0 if MOMENT else 1), wp.static(TORQUES + 1)):
            unit = unknown_unit(rods, case, i)
            torques[i] = call.unknowns[case.index, wp.static(FIRST_TORQUE) + i] / unit[2]
            if wp.static(not MOMENT):
                torques[0] = torques[0] - torques[i]
        return torques

    @wp.func
    def base_moment(rods: RodTable, call: Call, case: Instance) -> wp.vec3d:
        """(10) M(0)."""
        if wp.static(not MOMENT):
            return wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        unit = unknown_unit(rods, case, 0)
        M = wp.vec3d(call.unknowns[case.index, 0], call.unknowns[case.index, 1], call.unknowns[case.index, 2])
        if wp.static(not TUBES):
            r = case.rods
            M -= wp.vec3d(rods.precurvature[r, 0, 0, 0], rods.precurvature[r, 0, 0, 1], rods.precurvature[r, 0, 0, 2])
        M = wp.cw_div(M, unit)
        if wp.static(TUBES and TORQUES > 0):
            torques = base_torques(rods, call, case)
            M[2] = f64(0.0)
            for i in range(wp.static(n)):
                M[2] = M[2] + torques[i]
        return M

    @wp.func
    def torques_behind_plate(rods: RodTable, call: Call, case: Instance) -> PerRod:
        """(9) Torques that twist the rods behind the plate."""
        if wp.static(TUBES):
            return base_torques(rods, call, case)
        torques = PerRod()
        M = base_moment(rods, call, case)
        torques[0] = M[2]
        return torques

    @wp.func
    def base_angles(rods: RodTable, call: Call, case: Instance, behind: Transmission) -> PerRod:
        """(9) Angles of the rods at s = 0."""
        angles = PerRod()
        for i in range(wp.static(n)):
            angles[i] = call.inputs[case.index, wp.static(ROTATION) + i]
            if wp.static(i > 0 and not features.held):
                # the natural branch of several rods begins where none is turned against another
                angles[i] = angles[0] + call.load_factor[case.index] * (angles[i] - angles[0])
        if wp.static(TRANSMISSION):
            angles += behind.twist + wp.cw_mul(behind.compliance, torques_behind_plate(rods, call, case))
        return angles

    @wp.func
    def base_angle_rates(rods: RodTable, call: Call, case: Instance, behind: Transmission, k: int) -> PerRod:
        """(9) Their variation for direction k: a rod that is pushed out has less of itself behind the plate."""
        rates = PerRod()
        for i in range(wp.static(n)):
            rates[i] = call.directions[case.direction, k, wp.static(ROTATION) + i]
        if wp.static(TRANSMISSION):
            torques = torques_behind_plate(rods, call, case)
            for i in range(wp.static(n)):
                twist = behind.twist_rate[i] + behind.compliance_rate[i] * torques[i]
                rates[i] = rates[i] - case.shift_rate[k, i] * twist
        return rates

    @wp.func
    def base_frame(angle: f64) -> wp.vec4d:
        """(9) q(0)."""
        half = f64(0.5) * angle
        return wp.vec4d(f64(0.0), f64(0.0), wp.sin(half), wp.cos(half))

    @wp.func
    def base_force(rods: RodTable, call: Call, case: Instance, q: wp.vec4d):
        """n(0) and its columns: unknown under a follower force (13) or with a held tip, else all that acts further on (3a)."""
        if wp.static(not FORCE_UNKNOWN):
            return total_load(rods, call, case)
        t = case.index
        j = wp.static(FIRST_FORCE)
        x = wp.vec3d(call.unknowns[t, j], call.unknowns[t, j + 1], call.unknowns[t, j + 2])
        return rotate(q, force_unit(rods, case) * x), ColumnVectors()

    @wp.func
    def turned_angles(column: Column, angles: PerRod) -> Column:
        """A column with its theta_i, which count from rod 1, where the rods turn by ``angles``."""
        out = column
        for i in range(1, wp.static(n)):
            out[wp.static(THETA_AT) + i - 1] = angles[i] - angles[0]
        return out

    @wp.func
    def torque_column(rods: RodTable, case: Instance, behind: Transmission, i: int):
        """(9), (10): column of the unknown torque of rod i, and how far it turns rod 1."""
        column = Column()
        angles = PerRod()
        unit = unknown_unit(rods, case, i)
        torque = f64(1.0) / unit[2]
        angles[i] = behind.compliance[i] * torque
        if wp.static(MOMENT):
            column[2] = torque
        else:
            angles[0] = -behind.compliance[0] * torque
        if i > 0:
            column[wp.static(TAU_AT - 1) + i] = torque
        return turned_angles(column, angles), angles[0]

    @wp.func
    def direction_column(rods: RodTable, call: Call, case: Instance, behind: Transmission, k: int):
        """(9) Column of direction k, and how far it turns rod 1."""
        angles = base_angle_rates(rods, call, case, behind, k)
        return turned_angles(Column(), angles), angles[0]

    @wp.func
    def turned_column(column: Column, turn: f64, q: wp.vec4d, N: wp.vec3d, dn: wp.vec3d) -> Column:
        """(15), (16): a column with its force and frame, where rod 1 turns and n varies by dn."""
        out = column
        if wp.static(FORCE_STATE):
            dN = rotate_inverse(q, dn) + turn * wp.vec3d(N[1], -N[0], f64(0.0))
            for j in range(3):
                out[N_AT + j] = dN[j]
        if wp.static(COLUMN_FRAME):
            dq = turn_base(q, turn)
            for j in range(4):
                out[COLUMN_Q_AT + j] = dq[j]
        return out

    @wp.func
    def base_columns(
        rods: RodTable,
        call: Call,
        case: Instance,
        behind: Transmission,
        state: State,
        q: wp.vec4d,
        n0: wp.vec3d,
        dn0: ColumnVectors,
    ):
        """(9), (10): the state with its columns at the base, and the columns of n."""
        y = state
        force_columns = dn0
        N = rotate_inverse(q, n0)
        unit = unknown_unit(rods, case, 0)
        for k in range(wp.static(C)):
            column = Column()
            turn = f64(0.0)
            if wp.static(k < MOMENTS):
                column[k] = f64(1.0) / unit[k]
            if wp.static(MOMENTS <= k < LAST_TORQUE):
                column, turn = torque_column(rods, case, behind, wp.static(k - FIRST_TORQUE))
            if wp.static(k >= NX):
                column, turn = direction_column(rods, call, case, behind, k - NX)
            dn = wp.vec3d(force_columns[k, 0], force_columns[k, 1], force_columns[k, 2])
            if wp.static(FORCE_UNKNOWN):
                dN = turn * wp.vec3d(-N[1], N[0], f64(0.0))  # N is given in the frame: n turns with it
                if wp.static(FIRST_FORCE <= k < NX):
                    dN[wp.static(k - FIRST_FORCE)] += force_unit(rods, case)
                dn = rotate(q, dN)
                for j in range(3):
                    force_columns[k, j] = dn[j]
            column = turned_column(column, turn, q, N, dn)
            for j in range(wp.static(COLUMN_SIZE)):
                y[wp.static(STATICS + k * COLUMN_SIZE) + j] = column[j]
        return y, force_columns

    @wp.func
    def at_base(rods: RodTable, call: Call, case: Instance, node: Node):
        """(9), (10): the state at the base, n there, and the columns of n."""
        y = State()
        behind = transmission_of(rods, call, case, node)
        angles = base_angles(rods, call, case, behind)
        q = base_frame(angles[0])
        n0, dn0 = base_force(rods, call, case, q)
        if wp.static(MOMENT):
            M = base_moment(rods, call, case)
            for j in range(3):
                y[j] = M[j]
        if wp.static(FORCE_STATE):
            N = rotate_inverse(q, n0)
            for j in range(3):
                y[N_AT + j] = N[j]
        for i in range(1, wp.static(n)):
            y[wp.static(THETA_AT) + i - 1] = angles[i] - angles[0]
        if wp.static(TORQUES > 0):
            torques = base_torques(rods, call, case)
            for i in range(1, wp.static(n)):
                y[wp.static(TAU_AT) + i - 1] = torques[i]
        if wp.static(FRAME):
            for j in range(4):
                y[Q_AT + j] = q[j]
        if wp.static(NODES and TRANSMISSION):  # what is stored behind the base plate
            turning = torques_behind_plate(rods, call, case)
            y[ENERGY_AT] = f64(0.5) * wp.dot(behind.compliance, wp.cw_mul(turning, turning))
        y, dn0 = base_columns(rods, call, case, behind, y, q, n0, dn0)
        return y, n0, dn0

    return SimpleNamespace(at_base=at_base, unknown_unit=unknown_unit)


def make_tip_functions(
    layout: Layout, features: Features, stretch: SimpleNamespace, rate: SimpleNamespace, grid: SimpleNamespace
) -> SimpleNamespace:
    """Functions that write the residual, its columns, the pose of the tip, and output nodes."""
    n, C, NX = layout.n, layout.C, layout.NX
    State, Stretch, Instance = layout.State, layout.Stretch, layout.Instance
    THETA_AT, TAU_AT, P_AT = layout.THETA_AT, layout.TAU_AT, layout.P_AT
    ENERGY_AT, WORK_AT, COLUMN_P_AT = layout.ENERGY_AT, layout.WORK_AT, layout.COLUMN_P_AT
    COLUMN_FRAME, STATICS, COLUMN_SIZE = layout.COLUMN_FRAME, layout.STATICS, layout.COLUMN_SIZE
    ColumnVectors = layout.ColumnVectors
    POSE, POSE_COLUMNS, NODES = layout.POSE, layout.POSE_COLUMNS, features.nodes
    TUBES, MEASURED = n > 1, features.measured
    MOMENT, TORQUES = layout.MOMENT, layout.TORQUES
    FIRST_TORQUE = 2 if MOMENT else -1  # row of the residual, less the index of the rod
    TIP_MOMENT, FOLLOWER, FOLLOWER_MOMENT = features.tip_moment, features.follower_force, features.follower_moment
    FIRST_FORCE = layout.UNKNOWNS - 3
    at = InputOffsets(n)
    TIP_FORCE_INPUT, TIP_MOMENT_INPUT, TIP_CURVATURE_INPUT = at.TIP_FORCE, at.TIP_MOMENT, at.TIP_CURVATURE
    FOLLOWER_FORCE_INPUT, FOLLOWER_MOMENT_INPUT = at.FOLLOWER_FORCE, at.FOLLOWER_MOMENT
    precurvature, compliance = stretch.precurvature, stretch.compliance
    frame, point_at, column_of, column_rotation = rate.frame, rate.point_at, rate.column_of, rate.column_rotation
    inner_torque, turn_into_rod_1 = rate.inner_torque, rate.turn_into_rod_1
    load_vector, direction_vector, section_end = grid.load_vector, grid.direction_vector, grid.section_end
    equation = make_equation_functions(layout.real)
    rotate, rotate_inverse = equation.rotate, equation.rotate_inverse
    rotation_matrix, turned_about_z = equation.rotation_matrix, equation.turned_about_z

    @wp.func
    def moment_unit(z: Stretch, i: int) -> wp.vec3d:
        """(11) C: curvature per moment; where torsion is stiffer than bending, the bending stiffness scales it."""
        GJ = wp.min(z.material[i, 2], wp.max(z.material[i, 0], z.material[i, 1]))
        if wp.static(TUBES):
            EI = f64(0.0)
            for j in range(wp.static(n)):
                EI += z.present[j] * wp.max(z.material[j, 0], z.material[j, 1])
            return wp.vec3d(f64(1.0) / EI, f64(1.0) / EI, f64(1.0) / GJ)
        return wp.vec3d(f64(1.0) / z.material[i, 0], f64(1.0) / z.material[i, 1], f64(1.0) / GJ)

    @wp.func
    def torque_unit(z: Stretch, i: int) -> f64:
        """The same for the torque of one of several rods."""
        unit = moment_unit(z, i)
        return unit[2]

    @wp.func
    def force_unit(z: Stretch, case: Instance) -> f64:
        """(13) L/EI at the tip."""
        return case.scale / wp.max(z.material[0, 0], z.material[0, 1])

    @wp.func
    def outer_torque(rods: RodTable, case: Instance, y: State, first: int) -> f64:
        """Sum of the torques of the rods that reach as far as rod 1; ``first`` is where those of rods 2 to n stand in y.

        The torque of a rod that has ended is constant from there on, and so is what the others leave of M_z.
        """
        torque = f64(0.0)
        last = rods.end.shape[2] - 1
        for i in range(1, wp.static(TORQUES + 1)):
            if section_end(rods, case, i, last) >= section_end(rods, case, 0, last):
                torque += y[first + i - 1]
        return torque

    @wp.func
    def applied_moment(call: Call, case: Instance, y: State) -> wp.vec3d:
        """(11) Moment on the tip, in the frame there."""
        moment = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        if wp.static(TIP_MOMENT):
            moment += rotate_inverse(frame(y), case.tip_moment)
        if wp.static(FOLLOWER_MOMENT):
            moment += load_vector(call, case.index, FOLLOWER_MOMENT_INPUT)
        return moment

    @wp.func
    def torque_on(case: Instance, i: int, moment: wp.vec3d) -> f64:
        """(11) What of a moment on the tip twists rod i: all of it the rod that ends there."""
        if i == case.longest:
            return moment[2]
        return f64(0.0)

    @wp.func
    def on_rod_1(case: Instance, moment: wp.vec3d) -> wp.vec3d:
        """(11) A moment on the tip as the residual of bending and of the torque of rod 1 sees it, or of all rods."""
        if wp.static(TORQUES == 0):
            return moment
        return wp.vec3d(moment[0], moment[1], torque_on(case, 0, moment))

    @wp.func
    def tip_gap(rods: RodTable, call: Call, case: Instance, y: State, z: Stretch) -> wp.vec3d:
        """(11), (12): what the boundary condition at the tip lacks."""
        M = wp.vec3d(y[0], y[1], y[2])
        if wp.static(MEASURED):
            t = case.index
            j = wp.static(TIP_CURVATURE_INPUT)
            measured = wp.vec3d(call.inputs[t, j], call.inputs[t, j + 1], call.inputs[t, j + 2])
            # raised with the loads, so that the unloaded rod is where load continuation begins
            return wp.cw_mul(compliance(z), M) - call.load_factor[t] * (measured - precurvature(z, 0, z.length))
        M -= on_rod_1(case, applied_moment(call, case, y))
        if wp.static(TUBES):
            M -= wp.vec3d(f64(0.0), f64(0.0), outer_torque(rods, case, y, TAU_AT))
        return wp.cw_mul(moment_unit(z, 0), M)

    @wp.func
    def applied_moment_column(case: Instance, y: State, k: int) -> wp.vec3d:
        """(11) Variation of the moment on the tip with column k, as the frame turns."""
        if wp.static(TIP_MOMENT):
            q = frame(y)
            return wp.cross(rotate_inverse(q, case.tip_moment), column_rotation(q, column_of(y, k)))
        return wp.vec3d(f64(0.0), f64(0.0), f64(0.0))

    @wp.func
    def gap_column(rods: RodTable, case: Instance, y: State, z: Stretch, k: int) -> wp.vec3d:
        """(11), (12): variation of the gap with column k."""
        column = column_of(y, k)
        dM = wp.vec3d(column[0], column[1], column[2])
        if wp.static(MEASURED):
            return wp.cw_mul(compliance(z), dM)
        if wp.static(TIP_MOMENT):
            dM -= on_rod_1(case, applied_moment_column(case, y, k))
        if wp.static(TUBES):
            first = wp.static(STATICS + TAU_AT) + k * wp.static(COLUMN_SIZE)
            dM -= wp.vec3d(f64(0.0), f64(0.0), outer_torque(rods, case, y, first))
        return wp.cw_mul(moment_unit(z, 0), dM)

    @wp.func
    def applied_moment_by_direction(call: Call, case: Instance, y: State, k: int) -> wp.vec3d:
        """(11) Variation of the moment on the tip with direction k."""
        dm = direction_vector(call, case, k, FOLLOWER_MOMENT_INPUT)
        if wp.static(COLUMN_FRAME):
            dm += rotate_inverse(frame(y), case.to_base * direction_vector(call, case, k, TIP_MOMENT_INPUT))
        return dm

    @wp.func
    def gap_by_direction(call: Call, case: Instance, y: State, z: Stretch, k: int) -> wp.vec3d:
        """(11), (12): variation of the gap with the inputs that stand in it; u* at the end of rod 1 stays with the rod."""
        if wp.static(MEASURED):
            return -direction_vector(call, case, k, TIP_CURVATURE_INPUT)
        return -wp.cw_mul(moment_unit(z, 0), on_rod_1(case, applied_moment_by_direction(call, case, y, k)))

    @wp.func
    def force_gap(call: Call, case: Instance, y: State, z: Stretch, n_tip: wp.vec3d) -> wp.vec3d:
        """(13) What the internal force at the tip lacks."""
        N = rotate_inverse(frame(y), n_tip - case.tip_force)
        return force_unit(z, case) * (N - load_vector(call, case.index, FOLLOWER_FORCE_INPUT))

    @wp.func
    def force_gap_column(case: Instance, y: State, z: Stretch, n_tip: wp.vec3d, dn: wp.vec3d, k: int) -> wp.vec3d:
        """(13), (16): its variation with column k, where n - F varies by dn."""
        q = frame(y)
        dphi = column_rotation(q, column_of(y, k))
        return force_unit(z, case) * (rotate_inverse(q, dn) + wp.cross(rotate_inverse(q, n_tip - case.tip_force), dphi))

    @wp.func
    def total_magnitude(a: wp.vec3d) -> f64:
        """Not finite if a component is not."""
        return wp.abs(a[0]) + wp.abs(a[1]) + wp.abs(a[2])

    @wp.func
    def write_column(call: Call, case: Instance, row: int, k: int, value: f64):
        """One number of Gamma, or of the residual's derivative by a direction."""
        if k < wp.static(NX):
            call.gamma[case.index, row, k] = value
        else:
            call.residual_directions[case.index, row, k - wp.static(NX)] = value

    @wp.func
    def write_residual(rods: RodTable, call: Call, case: Instance, y: State, z: Stretch, n_tip: wp.vec3d) -> f64:
        """(11) to (13): the residual. Returns a number that is not finite if a component is not."""
        t = case.index
        total = f64(0.0)
        if wp.static(MOMENT):
            gap = tip_gap(rods, call, case, y, z)
            total += total_magnitude(gap)
            for j in range(3):
                call.residual[t, j] = gap[j]
        for i in range(1, wp.static(TORQUES + 1)):
            lack_of_torque = y[wp.static(TAU_AT) + i - 1] - torque_on(case, i, applied_moment(call, case, y))
            torque = torque_unit(z, i) * lack_of_torque
            call.residual[t, wp.static(FIRST_TORQUE) + i] = torque
            total += wp.abs(torque)
        if wp.static(FOLLOWER):
            lack = force_gap(call, case, y, z, n_tip)
            total += total_magnitude(lack)
            for j in range(3):
                call.residual[t, wp.static(FIRST_FORCE) + j] = lack[j]
        return total

    @wp.func
    def write_residual_columns(
        rods: RodTable, call: Call, case: Instance, y: State, z: Stretch, n_tip: wp.vec3d, dn_tip: ColumnVectors
    ) -> f64:
        """Gamma, and the residual's derivatives by directions. Returns a number that is not finite if one of them is not."""
        total = f64(0.0)
        for k in range(wp.static(C)):
            if wp.static(MOMENT):
                gap = gap_column(rods, case, y, z, k)
                if wp.static(k >= NX):
                    gap += gap_by_direction(call, case, y, z, k - NX)
                total += total_magnitude(gap)
                for j in range(3):
                    write_column(call, case, j, k, gap[j])
            for i in range(1, wp.static(TORQUES + 1)):
                torque = y[wp.static(STATICS + k * COLUMN_SIZE + TAU_AT) + i - 1]
                torque -= torque_on(case, i, applied_moment_column(case, y, k))
                if wp.static(k >= NX):
                    torque -= torque_on(case, i, applied_moment_by_direction(call, case, y, k - NX))
                write_column(call, case, wp.static(FIRST_TORQUE) + i, k, torque_unit(z, i) * torque)
            if wp.static(FOLLOWER):
                dn = wp.vec3d(dn_tip[k, 0], dn_tip[k, 1], dn_tip[k, 2])
                if wp.static(k >= NX):
                    dn -= case.to_base * direction_vector(call, case, k - NX, TIP_FORCE_INPUT)
                lack = force_gap_column(case, y, z, n_tip, dn, k)
                if wp.static(k >= NX):
                    lack -= force_unit(z, case) * direction_vector(call, case, k - NX, FOLLOWER_FORCE_INPUT)
                for j in range(3):
                    write_column(call, case, wp.static(FIRST_FORCE) + j, k, lack[j])
        return total

    @wp.func
    def world_position(case: Instance, y: State) -> wp.vec3d:
        """p, in the world."""
        return case.base_position + case.base_rotation * wp.vec3d(y[P_AT], y[P_AT + 1], y[P_AT + 2])

    @wp.func
    def tip_angle(case: Instance, y: State, first: int) -> f64:
        """Angle, or its variation, of the rod that ends at the tip, from rod 1; ``first`` is where those of rods 2 to n stand."""
        angle = f64(0.0)
        for i in range(1, wp.static(n)):
            if i == case.longest:
                angle = y[first + i - 1]
        return angle

    @wp.func
    def write_tip(call: Call, case: Instance, y: State):
        """Pose of the tip and its columns in the world, and the energy."""
        t = case.index
        q = frame(y)
        if wp.static(POSE):
            call.position[t] = world_position(case, y)
            call.rotation[t] = case.base_rotation * rotation_matrix(q) * turned_about_z(tip_angle(case, y, THETA_AT))
        if wp.static(NODES):
            call.energy[t] = y[ENERGY_AT]
            call.work[t] = y[WORK_AT]
        if wp.static(POSE_COLUMNS):
            for k in range(wp.static(C)):
                column = column_of(y, k)
                o = wp.static(COLUMN_P_AT)
                dp = case.base_rotation * wp.vec3d(column[o], column[o + 1], column[o + 2])
                dtheta = tip_angle(case, y, wp.static(STATICS + THETA_AT) + k * wp.static(COLUMN_SIZE))
                turn = case.base_rotation * rotate(q, column_rotation(q, column) + wp.vec3d(f64(0.0), f64(0.0), dtheta))
                for j in range(3):
                    call.pose_columns[t, j, k] = dp[j]
                    call.pose_columns[t, 3 + j, k] = turn[j]

    @wp.func
    def write_node(call: Call, case: Instance, output: int, y: State, z: Stretch, x: f64, s: f64):
        """One rod at an output node, x from the start of the stretch and s from the base."""
        t = case.index
        a = point_at(y, z, x)
        u = a.u
        M = a.M
        to_rod = wp.identity(3, dtype=f64)
        if wp.static(TUBES):
            for i in range(wp.static(n)):
                if i == call.node_rod:
                    u_star = precurvature(z, i, x)
                    u[2] = u_star[2]
                    torque = f64(0.0) / f64(0.0)  # of rods that are rigid in torsion only the sum is determined
                    if wp.static(TORQUES > 0):
                        torque = inner_torque(y, z, a.M[2])
                        if wp.static(i > 0):
                            torque = y[wp.static(TAU_AT) + i - 1]
                        u[2] = u_star[2] + z.material[i, 5] * torque
                    if wp.static(i > 0):
                        to_rod = turned_about_z(-y[wp.static(THETA_AT) + i - 1])
                    e = a.u - turn_into_rod_1(a, i, u_star)
                    M = wp.vec3d(a.tubes[i, 0] * e[0] + a.tubes[i, 1] * e[1], a.tubes[i, 1] * e[0] + a.tubes[i, 2] * e[1], torque)
        call.node_arclength[t, output] = s
        call.node_position[t, output] = world_position(case, y)
        call.node_rotation[t, output] = case.base_rotation * rotation_matrix(a.q) * wp.transpose(to_rod)
        call.node_curvature[t, output] = to_rod * u
        call.node_moment[t, output] = to_rod * M
        call.node_force[t, output] = to_rod * a.N

    @wp.func
    def write_end(
        rods: RodTable, call: Call, case: Instance, y: State, z: Stretch, n_tip: wp.vec3d, dn_tip: ColumnVectors
    ) -> f64:
        """(11) to (13): residual and Gamma. Returns a number that is not finite if one of theirs is not."""
        return write_residual(rods, call, case, y, z, n_tip) + write_residual_columns(rods, call, case, y, z, n_tip, dn_tip)

    @wp.func
    def write_node_columns(call: Call, case: Instance, output: int, y: State, s: f64):
        """How the configuration at s varies with each unknown: rotation vector of the longest rod in the world, then the angle
        of each other rod from it.
        """
        t = case.index
        if output >= call.column_arclength.shape[1]:
            return
        call.column_arclength[t, output] = s
        q = frame(y)
        for k in range(wp.static(NX)):
            angles = wp.static(STATICS + THETA_AT) + k * wp.static(COLUMN_SIZE)
            dtheta = tip_angle(case, y, angles)
            turn = column_rotation(q, column_of(y, k)) + wp.vec3d(f64(0.0), f64(0.0), dtheta)
            turn = case.base_rotation * rotate(q, turn)
            for j in range(3):
                call.node_columns[t, output, j, k] = turn[j]
            row = int(3)
            for i in range(wp.static(n)):
                if i != case.longest:
                    angle = -dtheta
                    if i > 0:
                        angle += y[angles + i - 1]
                    call.node_columns[t, output, row, k] = angle
                    row += int(1)

    @wp.func
    def write_tip_columns(call: Call, case: Instance, y: State):
        """Momenta of that configuration at the tip: the moment of all rods in the world, then the torque that each other rod has
        at its own end. The moment itself is taken to be zero, so the frame's turning adds nothing.
        """
        t = case.index
        q = frame(y)
        for k in range(wp.static(NX)):
            column = column_of(y, k)
            moment = case.base_rotation * rotate(q, wp.vec3d(column[0], column[1], column[2]))
            for j in range(3):
                call.tip_columns[t, j, k] = moment[j]
            inner = column[2]
            for i in range(1, wp.static(n)):
                inner -= column[wp.static(TAU_AT) + i - 1]
            row = int(3)
            for i in range(wp.static(n)):
                if i != case.longest:
                    torque = inner
                    if i > 0:
                        torque = column[wp.static(TAU_AT) + i - 1]
                    call.tip_columns[t, row, k] = torque
                    row += int(1)

    return SimpleNamespace(
        outer_torque=outer_torque,
        moment_unit=moment_unit,
        torque_unit=torque_unit,
        force_unit=force_unit,
        force_gap=force_gap,
        force_gap_column=force_gap_column,
        total_magnitude=total_magnitude,
        write_column=write_column,
        write_end=write_end,
        write_tip=write_tip,
        write_node=write_node,
        write_node_columns=write_node_columns,
        write_tip_columns=write_tip_columns,
    )
