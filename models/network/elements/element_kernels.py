# mypy: ignore-errors
"""Elements of a network: what the two ends of each rod say of the bodies that hold them, linearised.

Numbers in parentheses are those of ``docs/networks.md``. A column of an element is a ``Change``, whatever it is by: one function
says what follows from it.
"""

import warp as wp

from multirod.kernels.own_module import own_module
from multirod.models.backbone.kernels.numbers.scalars import turned_about_z
from multirod.models.joint_kernels import SOFT, along, column, column_of, load_level, vector
from multirod.models.network.elements.end_kernels import (
    Behind,
    End,
    behind_plate,
    end_at,
    extension,
    nothing,
    pushed_at,
    stretched,
    torque_unit,
)
from multirod.models.network.elements.records import (
    CARRIED_AT,
    MORE,
    POSE,
    TENSION_AT,
    TIP_FORCE_AT,
    TIP_POSE_AT,
    TIP_TURN_AT,
    TURNING,
    Networks,
    RodGroup,
)
from multirod.models.network.joining.joints import MOST
from multirod.models.rotation_kernels import inverse_right_jacobian, rotation_vector

f64 = wp.float64


@wp.struct
class Element:
    """A rod as integrated, its ends, and what its rows are told in."""

    b: int
    rod: int
    free: int  # whether nothing holds the tip
    base: End
    tip: End
    behind: Behind
    back: wp.mat33d  # from the world to the base
    rotation: wp.mat33d  # of the tip, in the base
    position: wp.vec3d
    apart: wp.vec3d  # from where the tip is to be to the base, in its axes
    give: f64  # (12) by which the tip gives way to the force at the base
    log: wp.vec3d
    by_turn: wp.mat33d
    # forces and moments in the base, on the tip, and in the rod at its base
    force: wp.vec3d
    moment: wp.vec3d
    base_force: wp.vec3d
    base_moment: wp.vec3d
    given_force: wp.vec3d  # on a tip that is free
    given_moment: wp.vec3d
    following_force: wp.vec3d  # (28) likewise
    following_moment: wp.vec3d
    # (22) strains at the tip, in the base, and at the base
    stretched: wp.vec3d
    bent: wp.vec3d
    turned: wp.vec3d
    base_stretched: wp.vec3d
    base_bent: wp.vec3d
    length: f64
    stiffness: f64


@wp.struct
class Change:
    """A variation: of what the integration says, in the base as it stands, and of the ends."""

    q: wp.vec3d
    phi: wp.vec3d
    n: wp.vec3d
    m: wp.vec3d
    base_n: wp.vec3d
    base_m: wp.vec3d
    beta: wp.vec3d  # (5) turn of the base, in its axes
    base_move: wp.vec3d  # in the world
    base_arm: wp.vec3d  # of its arm from the body
    base_angle: wp.vec3d
    tip_move: wp.vec3d
    tip_turn: wp.vec3d  # of what holds it there
    tip_arm: wp.vec3d
    tip_angle: wp.vec3d
    base_push: wp.vec3d  # (40)
    tip_push: wp.vec3d
    given_force: wp.vec3d
    given_moment: wp.vec3d
    following_force: wp.vec3d  # in the frame of the tip
    following_moment: wp.vec3d


@wp.func
def write(element: wp.array4d[wp.float64], b: int, rod: int, row: int, k: int, values: wp.vec3d):
    for i in range(3):
        element[b, rod, row + i, k] = values[i]


@wp.func
def write_value(values: wp.array3d[wp.float64], b: int, rod: int, row: int, given: wp.vec3d):
    for i in range(3):
        values[b, rod, row + i] = given[i]


@wp.func
def torque_change(end: wp.ref[End], spring: wp.vec3d, moment: wp.vec3d, by_all: wp.vec3d, turn: wp.vec3d) -> wp.vec3d:
    """(9) Change of torques about the axes of a joint: with the moment, by turns of the axes, and of springs."""
    result = wp.transpose(end.axes) * by_all
    carried = end.first * turn
    for k in range(end.count):
        axis = wp.vec3d(end.second[0, k], end.second[1, k], end.second[2, k])
        result[k] = result[k] + wp.dot(wp.cross(axis, moment), carried) + spring[k] * turn[k]
    return result


@wp.func(inline=False)
def write_column(net: wp.ref[Networks], own: wp.ref[Element], change: wp.ref[Change], k: int):
    """(5) to (11) A column of an element."""
    b = own.b
    rod = own.rod
    L = own.length
    EI = own.stiffness
    beta = change.beta
    n = change.n + wp.cross(beta, own.force)
    m = change.m + wp.cross(beta, own.moment)
    frame = own.base.rotation
    turn = change.phi + beta
    angles = net.own
    poses = net.own + wp.static(2 * MOST)
    if own.free != 0:  # (10), (28)
        by_force = change.n - wp.cross(own.given_force, beta) - own.back * change.given_force
        by_force += wp.cross(own.following_force, change.phi) - own.rotation * change.following_force
        by_moment = change.m - wp.cross(own.given_moment, beta) - own.back * change.given_moment
        by_moment += wp.cross(own.following_moment, change.phi) - own.rotation * change.following_moment
        write(net.element, b, rod, 0, k, (L / EI) * by_force)
        write(net.element, b, rod, 3, k, by_moment / EI)
    else:
        gap = change.q + wp.cross(own.apart, beta) + own.back * (change.base_move - change.tip_move)
        write(net.element, b, rod, 0, k, gap / (L * L) + own.give * change.base_n)  # (7), (12)
        tip = change.tip_turn + own.tip.frame * (own.tip.turns * change.tip_angle)
        lack = wp.transpose(own.rotation) * (turn - own.back * tip)
        write(net.element, b, rod, 3, k, (own.by_turn * lack) / L)  # (8)
    if own.base.count > 0:  # (9)
        moment = own.base.joint * own.base_moment
        by_all = own.base.joint * change.base_m - wp.cross(moment, own.base.turns * change.base_angle)
        torque = torque_change(own.base, -net.spring[0, rod], moment, by_all, change.base_angle)
        force = own.base.joint * own.base_force  # (36)
        by_all = own.base.joint * change.base_n - wp.cross(force, own.base.turns * change.base_angle)
        torque = wp.cw_div(torque + wp.transpose(own.base.slide) * by_all + change.base_push, torque_unit(net, b, rod, 0))
        if net.shared[rod] != 0:  # (19)
            torque = -torque
        write(net.element, b, rod, angles, k, torque)
    by_force = frame * n
    by_moment = frame * m
    if own.tip.count > 0:
        inward = wp.transpose(own.tip.frame)
        moment = frame * own.moment
        by_all = inward * (by_moment + wp.cross(moment, change.tip_turn))
        torque = torque_change(own.tip, net.spring[1, rod], inward * moment, by_all, change.tip_angle)
        by_all = inward * (by_force + wp.cross(frame * own.force, change.tip_turn))  # (36)
        torque = wp.cw_div(torque + wp.transpose(own.tip.slide) * by_all - change.tip_push, torque_unit(net, b, rod, 1))
        write(net.element, b, rod, angles + wp.static(MOST), k, torque)
    # (11)
    holder = net.holder[0, rod]
    if holder > 0:
        force = -(frame * own.base_force)
        push = -(frame * (change.base_n + wp.cross(beta, own.base_force)))
        twist = -(frame * (change.base_m + wp.cross(beta, own.base_moment))) + wp.cross(own.base.arm, push)
        twist += wp.cross(change.base_arm, force)
        write_balance(net, b, rod, holder, poses, k, push, twist)
    holder = net.holder[1, rod]
    if holder > 0:
        twist = by_moment + wp.cross(own.tip.arm, by_force)
        twist += wp.cross(change.tip_arm, frame * own.force)
        write_balance(net, b, rod, holder, poses + wp.static(POSE), k, by_force, twist)
    more = net.size
    write(net.element, b, rod, more + wp.static(TIP_TURN_AT), k, turn)
    write(net.element, b, rod, more + wp.static(TIP_FORCE_AT), k, n)
    if net.holes != 0:  # (22)
        by_tip = wp.dot(own.stretched, change.n) + wp.dot(own.bent, change.m) + wp.dot(own.turned, change.phi)
        by_base = wp.dot(own.base_stretched, change.base_n) + wp.dot(own.base_bent, change.base_m)
        net.element[b, rod, more + wp.static(TENSION_AT), k] = by_tip
        net.element[b, rod, more + wp.static(TENSION_AT + 1), k] = by_base
        net.element[b, rod, more - 2, k] = (L / net.push_unit[b, 0, rod]) * by_tip
        net.element[b, rod, more - 1, k] = -(L / net.push_unit[b, 1, rod]) * by_base
    if rod == net.effector_rod:
        move = change.base_move + frame * (change.q + wp.cross(beta, own.position))
        write(net.element, b, rod, more + wp.static(TIP_POSE_AT), k, move)
        write(net.element, b, rod, more + wp.static(TIP_POSE_AT + 3), k, frame * turn)


@wp.func
def write_balance(net: wp.ref[Networks], b: int, rod: int, holder: int, row: int, k: int, force: wp.vec3d, moment: wp.vec3d):
    """(11) Force and moment on a body as rows of its balance."""
    L = net.length[b, net.rod_count + holder - 1]
    EI = net.stiffness[b, net.rod_count + holder - 1]
    inward = wp.transpose(net.reference_rotation[b, holder - 1])
    write(net.element, b, rod, row, k, (L / EI) * (inward * force))
    write(net.element, b, rod, row + 3, k, (inward * moment) / EI)


@wp.func
def unit_vector(k: int, size: f64) -> wp.vec3d:
    result = nothing()
    result[k] = size
    return result


@wp.func
def base_wrench(group: wp.ref[RodGroup], t: int, own: wp.ref[Element]):
    """(5b) Force and moment in a rod at its base, in the frame of that."""
    moment = -group.moment_rest[t]
    for k in range(group.unknown_count):
        moment += group.problem.unknowns[t, k] * column(group.moment_by, t, 0, k)
    own.behind = behind_plate(group, t)
    turned = turned_about_z(own.behind.angle)
    own.base_moment = turned * moment
    own.base_force = turned * (group.force_unit[t] * vector(group.problem.unknowns, t, group.first_force))


@wp.func
def base_wrench_change(group: wp.ref[RodGroup], t: int, own: wp.ref[Element], change: wp.ref[Change], k: int, d: int):
    """(5b) Their changes with the unknown ``k`` of the rod, or along its direction ``d``; negative of what is not meant."""
    change.base_m = nothing()
    change.base_n = nothing()
    rate = f64(0.0)
    if k >= 0:
        turned = turned_about_z(own.behind.angle)
        change.base_m = turned * column(group.moment_by, t, 0, k)
        j = k - group.first_force
        if j >= 0 and j < 3:
            change.base_n = turned * unit_vector(j, group.force_unit[t])
        if k == 2:
            rate = own.behind.compliance * group.moment_by[t, 2, 2]
    if d >= 0:
        rate = group.problem.directions[t, d, 0]
        if group.transmission != 0:
            pushed = group.problem.directions[t, d, group.rods]
            rate -= pushed * (own.behind.twist_rate + own.behind.compliance_rate * own.behind.torque)
    axis = wp.vec3d(f64(0.0), f64(0.0), rate)
    change.base_m += wp.cross(axis, own.base_moment)
    change.base_n += wp.cross(axis, own.base_force)


@wp.func(inline=False)
def integrated(group: wp.ref[RodGroup], t: int, change: wp.ref[Change], index: int, beta: wp.vec3d):
    """(5), (6) A change of what the integration says: its column ``index``, if that is not negative, and a turn of the base."""
    change.beta = beta
    change.q = nothing()
    change.phi = nothing()
    change.n = nothing()
    change.m = nothing()
    if index >= 0:
        change.q = column(group.problem.pose_columns, t, 0, index)
        change.phi = column(group.problem.pose_columns, t, 3, index)
        change.n = column(group.wrench.columns, t, 0, index)
        change.m = column(group.wrench.columns, t, 3, index)
    if group.turns != 0:
        for j in range(wp.static(TURNING)):
            k = group.unknown_count + j
            change.q += beta[j] * column(group.problem.pose_columns, t, 0, k)
            change.phi += beta[j] * column(group.problem.pose_columns, t, 3, k)
            change.n += beta[j] * column(group.wrench.columns, t, 0, k)
            change.m += beta[j] * column(group.wrench.columns, t, 3, k)


@wp.func(inline=False)
def carry_ends(net: wp.ref[Networks], own: wp.ref[Element], change: wp.ref[Change], d: int) -> wp.vec3d:
    """(34), (35) Where what holds the ends is moved along a direction; returns how it turns the base, in the world."""
    result = nothing()
    for e in range(2):
        at = net.frame[e, own.rod]
        if at >= 0:
            move = nothing()
            turn = nothing()
            arm = nothing()
            k = at - net.body_count - 1
            if k >= 0:
                turn = net.body_turns[own.b, at] * along(
                    net.problem.directions, own.b, d, net.fixed_at + 3 * (net.fixed_count + k)
                )
                move = along(net.problem.directions, own.b, d, net.fixed_at + 3 * k)
                move += wp.cross(turn, wp.where(e == 0, own.base.arm, own.tip.arm))
            i = net.moved[d] - wp.static(POSE) * e
            axes = net.body_rotation[own.b, at]
            if at == 0:
                axes = net.ground_rotation[own.b]
            if i >= 0 and i < 3:
                arm = column_of(axes, i)
                move += arm
            elif i >= 3 and i < wp.static(POSE):
                turn += column_of(axes, i - 3)
                slid = own.base.frame * (own.base.slide * own.base.angle)
                if e == 1:
                    slid = own.tip.frame * (own.tip.slide * own.tip.angle)
                arm = wp.cross(column_of(axes, i - 3), slid)  # (36) which goes with the pose
                move += arm
            if e == 0:
                change.base_move = move
                change.base_arm = arm
                result = turn
            else:
                change.tip_move = move
                change.tip_turn = turn
                change.tip_arm = arm
    return result


@wp.func
def slide_ends(own: wp.ref[Element], change: wp.ref[Change]):
    """(36) Where the ends slide as the coordinates of their joints change."""
    base = own.base.frame * (own.base.slide * change.base_angle)
    change.base_move += base
    change.base_arm += base
    if own.free == 0:
        tip = own.tip.frame * (own.tip.slide * change.tip_angle)
        change.tip_move += tip
        change.tip_arm += tip


@wp.func(inline=False)
def write_values(net: wp.ref[Networks], own: wp.ref[Element]):
    """(7) to (11), (22) The rows themselves."""
    b = own.b
    rod = own.rod
    L = own.length
    EI = own.stiffness
    frame = own.base.rotation
    if own.free != 0:
        write_value(net.value, b, rod, 0, (L / EI) * (own.force - own.given_force - own.following_force))
        write_value(net.value, b, rod, 3, (own.moment - own.given_moment - own.following_moment) / EI)
    else:
        write_value(net.value, b, rod, 0, (own.apart + own.position) / (L * L) + own.give * own.base_force)
        write_value(net.value, b, rod, 3, own.log / L)
    angles = net.own
    if own.base.count > 0:
        torque = wp.transpose(own.base.axes) * (own.base.joint * own.base_moment)
        torque += wp.transpose(own.base.slide) * (own.base.joint * own.base_force)  # (36)
        torque += pushed_at(net, b, rod, 0)  # (40)
        torque = wp.cw_div(torque - wp.cw_mul(net.spring[0, rod], own.base.angle - net.rest[0, rod]), torque_unit(net, b, rod, 0))
        write_value(net.value, b, rod, angles, wp.where(net.shared[rod] != 0, -torque, torque))
    force = frame * own.force
    moment = frame * own.moment
    if own.tip.count > 0:
        torque = wp.transpose(own.tip.axes) * (wp.transpose(own.tip.frame) * moment)
        torque += wp.transpose(own.tip.slide) * (wp.transpose(own.tip.frame) * force)  # (36)
        torque -= pushed_at(net, b, rod, 1)
        torque = wp.cw_div(torque + wp.cw_mul(net.spring[1, rod], own.tip.angle - net.rest[1, rod]), torque_unit(net, b, rod, 1))
        write_value(net.value, b, rod, angles + wp.static(MOST), torque)
    write_value(net.value, b, rod, net.size + wp.static(CARRIED_AT), frame * own.base_force - force)
    at = angles + wp.static(2 * MOST)
    for e in range(2):
        holder = net.holder[e, rod]
        if holder > 0:
            push = force
            twist = moment + wp.cross(own.tip.arm, force)
            if e == 0:
                push = -(frame * own.base_force)
                twist = -(frame * own.base_moment) + wp.cross(own.base.arm, push)
            length = net.length[b, net.rod_count + holder - 1]
            stiffness = net.stiffness[b, net.rod_count + holder - 1]
            inward = wp.transpose(net.reference_rotation[b, holder - 1])
            write_value(net.value, b, rod, at + wp.static(POSE) * e, (length / stiffness) * (inward * push))
            write_value(net.value, b, rod, at + wp.static(POSE) * e + 3, (inward * twist) / stiffness)


@wp.func(inline=False)
def write_slides(net: wp.ref[Networks], own: wp.ref[Element]):
    """(22) What slides at both ends, and the strains there by which it varies."""
    b = own.b
    rod = own.rod
    soft = net.softness
    Q = own.rotation
    k = wp.vec3d(soft[b, rod, 0], soft[b, rod, 1], soft[b, rod, 2])
    s = wp.vec3d(soft[b, rod, 3], soft[b, rod, 4], soft[b, rod, 5])
    axis = wp.vec3d(f64(0.0), f64(0.0), f64(1.0))
    half = f64(0.5)
    rest = net.at_rest[b, rod]
    for e in range(2):
        force = own.base_force
        moment = own.base_moment
        if e == 0:
            force = wp.transpose(Q) * own.force
            moment = wp.transpose(Q) * own.moment
        bent = wp.cw_mul(k, moment)
        stretched = wp.cw_mul(s, force)
        tension = wp.dot(force, axis + half * stretched) + wp.dot(moment, rest + half * bent)
        scaled = tension * own.length / net.push_unit[b, e, rod]
        if e == 0:
            own.stretched = Q * (axis + stretched)
            own.bent = Q * (rest + bent)
            own.turned = wp.cross(own.stretched, own.force) + wp.cross(own.bent, own.moment)
            net.value[b, rod, net.size - 2] = scaled
        else:
            own.base_stretched = axis + stretched
            own.base_bent = rest + bent
            net.value[b, rod, net.size - 1] = -scaled


@own_module(max_unroll=1)
def form(net: Networks, group: RodGroup):
    """(5) to (11), (22) The element of each rod, and its own rows beside those of its tip."""
    t = group.problem.order[wp.tid()]
    b = t // group.count
    if net.problem.active[b] == 0:
        return
    rod = group.rod[t % group.count]
    own = Element()
    own.b = b
    own.rod = rod
    own.length = net.length[b, rod]
    own.stiffness = net.stiffness[b, rod]
    own.base = end_at(net, b, rod, 0)
    own.back = wp.transpose(own.base.rotation)
    own.position = group.problem.position[t]
    own.rotation = group.problem.rotation[t]
    own.force = vector(group.wrench.values, t, 0)
    own.moment = vector(group.wrench.values, t, 3)
    base_wrench(group, t, own)
    place = net.load_place[rod]
    if net.holder[1, rod] >= 0:
        own.tip = end_at(net, b, rod, 1)
        own.apart = own.back * (own.base.position - own.tip.position)
        own.log = rotation_vector(wp.transpose(own.tip.rotation) * (own.base.rotation * own.rotation))
        own.by_turn = inverse_right_jacobian(own.log)
        own.give = f64(wp.static(SOFT)) * (f64(1.0) - net.problem.load_factor[b]) * net.soft[b] * own.length / own.stiffness
    else:
        own.free = 1
        level = load_level(net.loading[b], net.problem.load_factor[b])
        own.given_force = own.back * (level * vector(net.problem.inputs, b, net.force_at + 3 * place))
        own.given_moment = own.back * (level * vector(net.problem.inputs, b, net.moment_at + 3 * place))
        own.following_force = own.rotation * (level * vector(net.problem.inputs, b, net.follower_force_at + 3 * place))
        own.following_moment = own.rotation * (level * vector(net.problem.inputs, b, net.follower_moment_at + 3 * place))
    write_values(net, own)
    if net.holes != 0:
        write_slides(net, own)
    L = own.length
    m = group.unknown_count
    ahead = m + wp.static(TURNING) * group.turns  # columns before those along directions
    for k in range(net.width):
        change = Change()
        index = int(-1)
        beta = nothing()
        there = int(1)
        d = k - net.size
        j = k - net.own
        if k < net.own:
            index = k
            there = wp.where(k < m, 1, 0)
        elif j < wp.static(MOST):
            there = wp.where(net.variable[rod, k] >= 0, 1, 0)
            if there != 0:
                change.base_angle = unit_vector(j, L)
                slide_ends(own, change)
                beta = own.back * (own.base.frame * (own.base.turns * change.base_angle))
        elif j < wp.static(2 * MOST):
            there = wp.where(net.variable[rod, k] >= 0, 1, 0)
            if there != 0:
                change.tip_angle = unit_vector(j - wp.static(MOST), L)
                slide_ends(own, change)
        elif j < wp.static(2 * MOST + 2 * POSE):
            i = j - wp.static(2 * MOST)
            e = i // wp.static(POSE)
            i = i % wp.static(POSE)
            holder = net.holder[e, rod]
            there = wp.where(holder > 0, 1, 0)
            if there != 0:
                move = nothing()
                turn = nothing()
                arm = nothing()
                if i < 3:
                    scale = net.length[b, net.rod_count + holder - 1]
                    move = (scale * scale) * column_of(net.reference_rotation[b, holder - 1], i)
                else:
                    turn = column_of(net.body_turns[b, holder], i - 3)
                    arm = wp.cross(turn, wp.where(e == 0, own.base.arm, own.tip.arm))
                    move = arm
                if e == 0:
                    change.base_move = move
                    change.base_arm = arm
                    beta = own.back * turn
                else:
                    change.tip_move = move
                    change.tip_turn = turn
                    change.tip_arm = arm
        elif d < 0:
            there = 0  # holes: from the column by the length
        elif d < net.direction_count:
            index = ahead + d
            for i in range(wp.static(MOST)):  # (24)
                if net.driven[0, rod, i] >= 0:
                    change.base_angle[i] = net.problem.directions[b, d, net.driven[0, rod, i]]
                if net.driven[1, rod, i] >= 0:
                    change.tip_angle[i] = net.problem.directions[b, d, net.driven[1, rod, i]]
                if net.pushed[0, rod, i] >= 0:  # (40)
                    change.base_push[i] = net.unit[0, rod][i] * net.problem.directions[b, d, net.pushed[0, rod, i]]
                if net.pushed[1, rod, i] >= 0:
                    change.tip_push[i] = net.unit[1, rod][i] * net.problem.directions[b, d, net.pushed[1, rod, i]]
            beta = own.back * (own.base.frame * (own.base.turns * change.base_angle))
            if net.fixed_count > 0 or net.moved[d] >= 0:
                beta += own.back * carry_ends(net, own, change, d)
            slide_ends(own, change)
            if own.free != 0:
                change.given_force = along(net.problem.directions, b, d, net.force_at + 3 * place)
                change.given_moment = along(net.problem.directions, b, d, net.moment_at + 3 * place)
                change.following_force = along(net.problem.directions, b, d, net.follower_force_at + 3 * place)
                change.following_moment = along(net.problem.directions, b, d, net.follower_moment_at + 3 * place)
        else:
            index = ahead + net.direction_count
            there = group.slides
        if there != 0:
            integrated(group, t, change, index, beta)
            along_direction = wp.where(d >= 0 and d < net.direction_count, index - m, -1)
            base_wrench_change(group, t, own, change, wp.where(k < m, k, -1), along_direction)
            write_column(net, own, change, k)
            for i in range(group.drive_count * group.lengths):
                longer = f64(0.0)
                if index >= 0:
                    longer = group.length_columns[t, i, index]
                for c in range(wp.static(TURNING) * group.turns):
                    longer += beta[c] * group.length_columns[t, i, m + c]
                net.element[b, rod, net.size + wp.static(MORE) + i, k] = longer
            for i in range(group.angle_count):
                angle = f64(0.0)
                if index >= 0:
                    angle = group.angle_columns[t, wp.static(POSE) + i, index]
                for c in range(wp.static(TURNING) * group.turns):
                    angle += beta[c] * group.angle_columns[t, wp.static(POSE) + i, m + c]
                net.element[b, rod, group.angles_at + i, k] = angle
            # the rod's own rows beside those of its tip
            for i in range(6, m):
                total = f64(0.0)
                if k < m:
                    total = group.problem.gamma[t, i, k]
                elif index >= m:
                    total = group.problem.residual_directions[t, i, index - m]
                for c in range(wp.static(TURNING) * group.turns):
                    total += beta[c] * group.problem.residual_directions[t, i, c]
                net.element[b, rod, i, k] = total
    for i in range(6, m):
        net.value[b, rod, i] = group.problem.residual[t, i]
    if group.slides != 0:  # (20)
        for i in range(net.height):
            by_length = (L * L) * net.element[b, rod, i, net.width - 1]
            net.element[b, rod, i, net.size - 2] = by_length
            net.element[b, rod, i, net.size - 1] = -by_length
    if net.holes != 0 and net.hole_spring[rod] > f64(0.0):  # (37)
        pull = net.hole_spring[rod] * L / net.push_unit[b, 0, rod]
        net.value[b, rod, net.size - 2] -= pull * stretched(net, b, rod)
        net.element[b, rod, net.size - 2, net.size - 2] -= pull * L * L
        for d in range(net.direction_count):
            moved = net.problem.directions[b, d, net.translation_at + net.owner[rod]]
            net.element[b, rod, net.size - 2, net.size + d] += pull * (f64(1.0) - net.below[rod]) * moved
    net.tip_position[b, rod] = own.base.position + own.base.rotation * own.position
    net.tip_rotation[b, rod] = own.base.rotation * own.rotation
    net.rod_fault[b, rod] = group.problem.fault[t]
    net.rod_steps[b, rod] = group.problem.step_count[t]
    if net.holes != 0 and extension(net, b, rod) <= -L:
        net.value[b, rod, 0] = f64(0.0) / f64(0.0)
        net.pulled_out[b] = 1
