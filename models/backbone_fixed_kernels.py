# mypy: ignore-errors
"""A backbone on which a moment acts that is fixed in the world: its state carries the moment along the base's axes, (4b).

Seen from the frame that turns with the rod, such a moment and its columns turn with it, and what is exact along fixed axes
becomes a difference of numbers that can grow exponentially. ``in_axes`` and ``in_frame`` take a state, its columns included, from one
to the other: strains, and so all but the moment's own rate and balance, are those of the frame. Numbers in parentheses are those of
``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_equation_kernels import make_equation_functions
from multirod.models.backbone_held_kernels import make_held_functions
from multirod.models.backbone_layout_kernels import Call, InputOffsets, Layout, RodTable
from multirod.models.backbone_rates_kernels import make_rate_functions
from multirod.models.features import Features

f64 = wp.float64


def make_scene_rates(layout: Layout, features: Features, stretch: SimpleNamespace) -> SimpleNamespace:
    """The rates of the state as a scene's kernel carries it."""
    rate = make_rate_functions(layout, features, stretch)
    return make_fixed_rates(layout, features, stretch, rate) if features.fixed_moment else rate


def make_fixed_rates(layout: Layout, features: Features, stretch: SimpleNamespace, rate: SimpleNamespace) -> SimpleNamespace:
    """``rate``, of states whose moment stands along the base's axes."""
    C, NX = layout.C, layout.NX
    real, vec3 = layout.real, layout.vec3
    State, Stretch = layout.State, layout.Stretch
    STATICS, COLUMN_SIZE, COLUMN_Q_AT = layout.STATICS, layout.COLUMN_SIZE, layout.COLUMN_Q_AT
    FORCE, SHEAR, SPREAD_MOMENT = layout.FORCE, features.shear, layout.SPREAD_MOMENT
    FORCE_COLUMNS = features.base_force_unknown
    equation = make_equation_functions(real)
    rotate, rotate_inverse, tangent = equation.rotate, equation.rotate_inverse, equation.tangent
    rotation_matrix = equation.rotation_matrix
    frame, body_rates = rate.frame, rate.rates
    shear_compliance, world_force, world_force_rate = stretch.shear_compliance, stretch.world_force, stretch.world_force_rate
    spread_moment, spread_moment_rate, growth = stretch.spread_moment, stretch.spread_moment_rate, stretch.growth

    @wp.func
    def turn_of(y: State, c: int) -> vec3:
        """(15) Rotation vector of column c along the base's axes, ``2 vec(dq o conj(q)) / |q|^2``."""
        j = wp.static(STATICS + COLUMN_Q_AT) + c * wp.static(COLUMN_SIZE)
        q = frame(y)
        r = vec3(q[0], q[1], q[2])
        dr = vec3(y[j], y[j + 1], y[j + 2])
        return (real(2.0) / wp.dot(q, q)) * (q[3] * dr - y[j + 3] * r + wp.cross(r, dr))

    @wp.func
    def in_axes(y: State) -> State:
        """(4b), (18b) A state whose moment stands in the frame, with it along the base's axes."""
        out = y
        R = rotation_matrix(frame(y))
        m = R * vec3(y[0], y[1], y[2])
        for j in range(3):
            out[j] = m[j]
        for c in range(wp.static(C)):
            o = wp.static(STATICS + c * COLUMN_SIZE)
            dm = R * vec3(y[o], y[o + 1], y[o + 2]) + wp.cross(turn_of(y, c), m)
            for j in range(3):
                out[o + j] = dm[j]
        return out

    @wp.func
    def in_frame(y: State) -> State:
        """(4b), (18b) The reverse."""
        out = y
        to_frame = wp.transpose(rotation_matrix(frame(y)))
        m = vec3(y[0], y[1], y[2])
        M = to_frame * m
        for j in range(3):
            out[j] = M[j]
        for c in range(wp.static(C)):
            o = wp.static(STATICS + c * COLUMN_SIZE)
            dM = to_frame * (vec3(y[o], y[o + 1], y[o + 2]) + wp.cross(m, turn_of(y, c)))
            for j in range(3):
                out[o + j] = dM[j]
        return out

    @wp.func
    def extension(y: State, z: Stretch, n: vec3) -> vec3:
        """(5) What shear and extension add to p'."""
        q = frame(y)
        return rotate(q, wp.cw_mul(shear_compliance(z), rotate_inverse(q, n)))

    @wp.func
    def extension_variation(y: State, z: Stretch, n: vec3, dn: vec3, turn: vec3) -> vec3:
        """(17) Its variation where the frame turns by ``turn``, along the base's axes."""
        return wp.cross(turn, extension(y, z, n)) + extension(y, z, dn - wp.cross(turn, n))

    @wp.func
    def force_column(z: Stretch, x: real, c: int) -> vec3:
        """dn of column c."""
        if wp.static(NX < C):
            if c >= NX:
                return world_force_rate(z, x, c - NX)
        if wp.static(FORCE_COLUMNS):
            return vec3(z.force_columns[c, 0], z.force_columns[c, 1], z.force_columns[c, 2])
        return vec3(real(0.0), real(0.0), real(0.0))

    @wp.func
    def rates(y: State, z: Stretch, x: real) -> State:
        """As those in the frame, but for the moment (4b) and its columns (18b)."""
        d = body_rates(in_frame(y), z, x)
        q = frame(y)
        n = vec3(real(0.0), real(0.0), real(0.0))
        m_s = vec3(real(0.0), real(0.0), real(0.0))
        p_s = tangent(q)
        if wp.static(FORCE):
            n = world_force(z, x)
            if wp.static(SHEAR):
                p_s += extension(y, z, n)
            m_s = wp.cross(n, p_s)
        if wp.static(SPREAD_MOMENT):
            m_s -= spread_moment(z, x)
        for j in range(3):
            d[j] = m_s[j]
        for c in range(wp.static(C)):
            dm_s = vec3(real(0.0), real(0.0), real(0.0))
            if wp.static(FORCE):
                turn = turn_of(y, c)
                dn = force_column(z, x, c)
                dp_s = wp.cross(turn, tangent(q))
                if wp.static(SHEAR):
                    dp_s += extension_variation(y, z, n, dn, turn)
                dm_s = wp.cross(dn, p_s) + wp.cross(n, dp_s)
            if wp.static(c >= NX):
                dm_s += growth(z, c - NX) * m_s - spread_moment_rate(z, x, c - NX)
            for j in range(3):
                d[wp.static(STATICS + c * COLUMN_SIZE) + j] = dm_s[j]
        return d

    return SimpleNamespace(**(vars(rate) | {"rates": rates, "in_axes": in_axes, "in_frame": in_frame}))


def make_fixed_ends(
    layout: Layout, features: Features, rate: SimpleNamespace, base: SimpleNamespace, grid: SimpleNamespace, tip: SimpleNamespace
) -> SimpleNamespace:
    """``at_base``, and what of ``tip`` reads moments, of states whose moment stands along the base's axes."""
    n, C, NX, TORQUES = layout.n, layout.C, layout.NX, layout.TORQUES
    State, Stretch, Instance, Node = layout.State, layout.Stretch, layout.Instance, layout.Node
    ColumnVectors, STATICS, COLUMN_SIZE = layout.ColumnVectors, layout.STATICS, layout.COLUMN_SIZE
    FOLLOWER, FOLLOWER_MOMENT = features.follower_force, features.follower_moment
    FIRST_FORCE, FIRST_TORQUE = layout.UNKNOWNS - 3, 2
    at = InputOffsets(n)
    ROTATION, TIP_MOMENT, FOLLOWER_MOMENT_INPUT = at.ROTATION, at.TIP_MOMENT, at.FOLLOWER_MOMENT
    TIP_FORCE, FOLLOWER_FORCE = at.TIP_FORCE, at.FOLLOWER_FORCE
    equation = make_equation_functions(layout.real)
    rotate, turned_about_z = equation.rotate, equation.turned_about_z
    frame, column_of, column_rotation = rate.frame, rate.column_of, rate.column_rotation
    in_axes, in_frame = rate.in_axes, rate.in_frame
    load_vector, direction_vector = grid.load_vector, grid.direction_vector
    moment_unit, torque_unit, force_unit = tip.moment_unit, tip.torque_unit, tip.force_unit
    force_gap, force_gap_column = tip.force_gap, tip.force_gap_column
    write_column, total_magnitude = tip.write_column, tip.total_magnitude
    body_at_base, body_write_end, body_write_node = base.at_base, tip.write_end, tip.write_node
    body_write_tip_columns = tip.write_tip_columns
    held = make_held_functions(layout, features, rate, tip)
    free_torque, held_write_end = held.free_torque, held.write_end

    @wp.func
    def at_base(rods: RodTable, call: Call, case: Instance, node: Node):
        """(9), (10)."""
        y, n0, dn0 = body_at_base(rods, call, case, node)
        return in_axes(y), n0, dn0

    @wp.func
    def write_node(call: Call, case: Instance, output: int, y: State, z: Stretch, x: f64, s: f64):
        body_write_node(call, case, output, in_frame(y), z, x, s)

    @wp.func
    def write_tip_columns(call: Call, case: Instance, y: State):
        body_write_tip_columns(call, case, in_frame(y))

    @wp.func
    def axes(call: Call, case: Instance) -> wp.mat33d:
        """(11b) Axes of the residual, from those of the base: they turn with the input ``rotation`` of rod 1."""
        return turned_about_z(call.inputs[case.index, wp.static(ROTATION)])

    @wp.func
    def lacking(call: Call, case: Instance, y: State) -> wp.vec3d:
        """(11b) The moment at the tip less what acts there, along the base's axes."""
        m = wp.vec3d(y[0], y[1], y[2]) - case.tip_moment
        if wp.static(FOLLOWER_MOMENT):
            m -= rotate(frame(y), load_vector(call, case.index, FOLLOWER_MOMENT_INPUT))
        return m

    @wp.func
    def lacking_column(call: Call, case: Instance, y: State, k: int) -> wp.vec3d:
        """(11b) Its variation with column k."""
        o = wp.static(STATICS) + k * wp.static(COLUMN_SIZE)
        dm = wp.vec3d(y[o], y[o + 1], y[o + 2])
        q = frame(y)
        if wp.static(FOLLOWER_MOMENT):
            turn = column_rotation(q, column_of(y, k))
            dm -= rotate(q, wp.cross(turn, load_vector(call, case.index, FOLLOWER_MOMENT_INPUT)))
        if wp.static(NX < C):
            if k >= NX:
                dm -= case.to_base * direction_vector(call, case, k - NX, TIP_MOMENT)
                dm -= rotate(q, direction_vector(call, case, k - NX, FOLLOWER_MOMENT_INPUT))
        return dm

    @wp.func
    def gap(call: Call, case: Instance, y: State, z: Stretch) -> wp.vec3d:
        """(11b) in curvature units."""
        return wp.cw_mul(moment_unit(z, case.longest), wp.transpose(axes(call, case)) * lacking(call, case, y))

    @wp.func
    def gap_column(call: Call, case: Instance, y: State, z: Stretch, k: int) -> wp.vec3d:
        """(11b) Its variation with column k."""
        to_axes = wp.transpose(axes(call, case))
        dm = to_axes * lacking_column(call, case, y, k)
        if wp.static(NX < C):
            if k >= NX:
                m = to_axes * lacking(call, case, y)
                dm += call.directions[case.direction, k - NX, wp.static(ROTATION)] * wp.vec3d(m[1], -m[0], f64(0.0))
        return wp.cw_mul(moment_unit(z, case.longest), dm)

    @wp.func
    def row(case: Instance, j: int) -> int:
        """Residual of component j of the gap: the last stands for the torque of the rod that ends at the tip."""
        if wp.static(TORQUES > 0):
            if j == 2:
                return wp.static(FIRST_TORQUE) + case.longest
        return j

    @wp.func
    def write_balance(
        rods: RodTable, call: Call, case: Instance, y: State, z: Stretch, n_tip: wp.vec3d, dn_tip: ColumnVectors
    ) -> f64:
        """(11b), (13): residual and Gamma. Returns a number that is not finite if one of theirs is not."""
        t = case.index
        own = in_frame(y)
        lack = gap(call, case, y, z)
        total = total_magnitude(lack)
        for j in range(3):
            call.residual[t, row(case, j)] = lack[j]
        for i in range(wp.static(n)):
            if wp.static(TORQUES > 0):
                if i != case.longest:
                    torque = torque_unit(z, i) * free_torque(rods, case, own, i, 0)
                    call.residual[t, wp.static(FIRST_TORQUE) + i] = torque
                    total += wp.abs(torque)
        if wp.static(FOLLOWER):
            pull = force_gap(call, case, y, z, n_tip)
            total += total_magnitude(pull)
            for j in range(3):
                call.residual[t, wp.static(FIRST_FORCE) + j] = pull[j]
        for k in range(wp.static(C)):
            change = gap_column(call, case, y, z, k)
            total += total_magnitude(change)
            for j in range(3):
                write_column(call, case, row(case, j), k, change[j])
            for i in range(wp.static(n)):
                if wp.static(TORQUES > 0):
                    if i != case.longest:
                        torque = free_torque(rods, case, own, i, wp.static(STATICS) + k * wp.static(COLUMN_SIZE))
                        write_column(call, case, wp.static(FIRST_TORQUE) + i, k, torque_unit(z, i) * torque)
            if wp.static(FOLLOWER):
                dn = wp.vec3d(dn_tip[k, 0], dn_tip[k, 1], dn_tip[k, 2])
                if wp.static(k >= NX):
                    dn -= case.to_base * direction_vector(call, case, k - NX, TIP_FORCE)
                pull = force_gap_column(case, y, z, n_tip, dn, k)
                if wp.static(k >= NX):
                    pull -= force_unit(z, case) * direction_vector(call, case, k - NX, FOLLOWER_FORCE)
                for j in range(3):
                    write_column(call, case, wp.static(FIRST_FORCE) + j, k, pull[j])
        return total

    @wp.func
    def write_measured(
        rods: RodTable, call: Call, case: Instance, y: State, z: Stretch, n_tip: wp.vec3d, dn_tip: ColumnVectors
    ) -> f64:
        """(12), which stands in the frame at the tip."""
        return body_write_end(rods, call, case, in_frame(y), z, n_tip, dn_tip)

    @wp.func
    def write_wrench(
        rods: RodTable, call: Call, case: Instance, y: State, z: Stretch, n_tip: wp.vec3d, dn_tip: ColumnVectors
    ) -> f64:
        """(22), the moment as it is carried: not by way of the frame."""
        total = held_write_end(rods, call, case, in_frame(y), z, n_tip, dn_tip)
        m = case.base_rotation * wp.vec3d(y[0], y[1], y[2])
        for j in range(3):
            call.tip_wrench[case.index, 3 + j] = m[j]
        for k in range(wp.static(C)):
            o = wp.static(STATICS) + k * wp.static(COLUMN_SIZE)
            dm = case.base_rotation * wp.vec3d(y[o], y[o + 1], y[o + 2])
            for j in range(3):
                call.wrench_columns[case.index, 3 + j, k] = dm[j]
        return total

    write_end = write_wrench if features.held else write_measured if features.measured else write_balance
    changed = {"write_end": write_end, "write_node": write_node, "write_tip_columns": write_tip_columns}
    return SimpleNamespace(**(vars(tip) | changed), at_base=at_base)
