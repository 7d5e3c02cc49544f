# mypy: ignore-errors
"""What couples the rods of a network: where bodies stand, what rods are handed, and the sums of elements.

Numbers in parentheses are those of ``docs/networks.md``. The rods are integrated by the backbone kernels, those of one build in
one launch. Before it stand ``stand`` (bodies and their loads) and ``hand_over`` (unknowns and inputs of the networks to their
rods), after it ``form`` (``element_kernels.py``) and ``add_up`` (residual, ``Gamma`` and the end effector). All sizes are those
of the arrays: one kernel each serves all networks.
"""

import warp as wp

from multirod.kernels.own_module import own_module
from multirod.models.joint_kernels import along, column_of, load_level, vector
from multirod.models.network.elements.end_kernels import end_at, extension
from multirod.models.network.elements.records import ALONG_VECTORS, POSE, ROD_VECTORS, TIP_POSE_AT, TURNING, Networks, RodGroup
from multirod.models.rotation_kernels import left_jacobian, rotation_from_vector
from multirod.status import Fault

f64 = wp.float64

# ---- bodies ----


@wp.func
def on_body(net: wp.ref[Networks], b: int, at: int, k: int) -> wp.vec3d:
    """What an input, which begins ``at``, gives for a body; (43) those between segments are given nothing."""
    if k < net.given_bodies:
        return vector(net.problem.inputs, b, at + 3 * k)
    return wp.vec3d(f64(0.0), f64(0.0), f64(0.0))


@wp.func
def change_on_body(net: wp.ref[Networks], b: int, d: int, at: int, k: int) -> wp.vec3d:
    """The same along a direction."""
    if k < net.given_bodies:
        return along(net.problem.directions, b, d, at + 3 * k)
    return wp.vec3d(f64(0.0), f64(0.0), f64(0.0))


@own_module(max_unroll=1)
def stand(net: Networks):
    """(4) Poses of the bodies, and (11) what acts on them."""
    b = net.problem.order[wp.tid()]
    if net.problem.active[b] == 0:
        return
    level = load_level(net.loading[b], net.problem.load_factor[b])
    gravity = vector(net.problem.inputs, b, net.along_at + 6)
    for k in range(net.fixed_count):  # (34)
        at = net.body_count + 1 + k
        a = vector(net.problem.inputs, b, net.fixed_at + 3 * (net.fixed_count + k))
        net.body_position[b, at] = net.fixed_position[b, k] + vector(net.problem.inputs, b, net.fixed_at + 3 * k)
        net.body_rotation[b, at] = rotation_from_vector(a) * net.fixed_rotation[b, k]
        net.body_turns[b, at] = left_jacobian(a)
    for k in range(net.body_count):
        L = net.length[b, net.rod_count + k]
        EI = net.stiffness[b, net.rod_count + k]
        first = net.first_pose + wp.static(POSE) * k
        axes = net.reference_rotation[b, k]
        a = L * vector(net.problem.unknowns, b, first + 3)
        rotation = axes * rotation_from_vector(a)
        turns = L * (axes * left_jacobian(a))
        net.body_position[b, k + 1] = net.reference_position[b, k] + (L * L) * (axes * vector(net.problem.unknowns, b, first))
        net.body_rotation[b, k + 1] = rotation
        net.body_turns[b, k + 1] = turns
        inward = wp.transpose(axes)
        pull = L / EI
        twist = f64(1.0) / EI
        mass = net.mass[k]
        weight = (level * mass) * gravity
        centre = rotation * net.mass_centre[k]
        # (28)
        pushes = rotation * (level * on_body(net, b, net.follower_force_at, k))
        twists = rotation * (level * on_body(net, b, net.follower_moment_at, k))
        force = level * on_body(net, b, net.force_at, k) + weight
        moment = level * on_body(net, b, net.moment_at, k) + wp.cross(centre, weight)
        levers = wp.skew(weight) * wp.skew(centre)
        for f in range(net.frame_count):  # (39)
            if net.frame_body[f] == k:
                arm = rotation * net.frame_position[f]
                held = rotation * net.frame_rotation[f]
                place = 3 * (net.first_frame + f)
                given = level * vector(net.problem.inputs, b, net.force_at + place)
                following = held * (level * vector(net.problem.inputs, b, net.follower_force_at + place))
                force += given
                moment += level * vector(net.problem.inputs, b, net.moment_at + place) + wp.cross(arm, given)
                levers += wp.skew(given) * wp.skew(arm)
                pushes += following
                twists += held * (level * vector(net.problem.inputs, b, net.follower_moment_at + place))
                twists += wp.cross(arm, following)
        push = pull * (inward * (force + pushes))
        moment = twist * (inward * (moment + twists))
        push_by_turn = -pull * (inward * (wp.skew(pushes) * turns))
        by_turn = twist * (inward * ((levers - wp.skew(twists)) * turns))
        at = wp.static(POSE) * k
        for i in range(3):
            net.load[b, at + i] = push[i]
            net.load[b, at + 3 + i] = moment[i]
            for j in range(3):
                net.load_turns[b, k, i, j] = push_by_turn[i, j]
                net.load_turns[b, k, 3 + i, j] = by_turn[i, j]
        for d in range(net.direction_count):
            heave = mass * along(net.problem.directions, b, d, net.along_at + 6)
            force = change_on_body(net, b, d, net.force_at, k) + heave
            force += rotation * change_on_body(net, b, d, net.follower_force_at, k)
            moment = change_on_body(net, b, d, net.moment_at, k) + wp.cross(centre, heave)
            moment += rotation * change_on_body(net, b, d, net.follower_moment_at, k)
            for f in range(net.frame_count):
                if net.frame_body[f] == k:
                    place = 3 * (net.first_frame + f)
                    held = rotation * net.frame_rotation[f]
                    given = along(net.problem.directions, b, d, net.force_at + place)
                    given += held * along(net.problem.directions, b, d, net.follower_force_at + place)
                    force += given
                    moment += along(net.problem.directions, b, d, net.moment_at + place)
                    moment += held * along(net.problem.directions, b, d, net.follower_moment_at + place)
                    moment += wp.cross(rotation * net.frame_position[f], given)
            push = pull * (inward * force)
            moment = twist * (inward * moment)
            for i in range(3):
                net.load_directions[b, at + i, d] = push[i]
                net.load_directions[b, at + 3 + i, d] = moment[i]


@own_module(max_unroll=1)
def hand_over(net: Networks, group: RodGroup):
    """(6), (20) Unknowns, inputs and directions of the networks to their rods."""
    t = group.problem.order[wp.tid()]
    b = t // group.count
    group.problem.active[t] = net.problem.active[b]
    if net.problem.active[b] == 0:
        return
    rod = group.rod[t % group.count]
    level = load_level(net.loading[b], net.problem.load_factor[b])
    group.problem.load_factor[t] = level
    for i in range(group.unknown_count):
        group.problem.unknowns[t, i] = net.problem.unknowns[b, net.variable[rod, i]]
    own = net.owner[rod]
    n = group.rods
    for i in range(n):
        if net.shared[rod] == 0:
            group.problem.inputs[t, i] = net.problem.inputs[b, net.rotation_at + own + i]
        group.problem.inputs[t, n + i] = net.share[rod] * net.problem.inputs[b, net.translation_at + own + i]
    if net.holes != 0 and n == 1:  # tubes slide through none
        longer = extension(net, b, rod)
        group.problem.inputs[t, 1] = wp.where(longer <= -net.length[b, rod], f64(0.0), longer)
    for i in range(group.drive_count):
        drive = group.drive[t % group.count, i]
        group.problem.inputs[t, group.drives_at + i] = net.problem.inputs[b, drive]
    end = end_at(net, b, rod, 0)
    back = wp.transpose(end.rotation)
    first = wp.static(TURNING) * group.turns
    for v in range(wp.static(ALONG_VECTORS)):
        at = group.along_at + 3 * v
        own_at = net.rod_at + 3 * (v * net.rods_given + net.whole[rod])
        given = vector(net.problem.inputs, b, net.along_at + 3 * v)
        if v < wp.static(ROD_VECTORS):
            given += vector(net.problem.inputs, b, own_at)
        local = back * given
        for i in range(3):
            group.problem.inputs[t, at + i] = local[i]
        if group.turns != 0:
            by_turn = level * wp.skew(local)
            for j in range(3):
                for i in range(3):
                    group.problem.directions[t, j, at + i] = by_turn[i, j]
        for d in range(net.direction_count):
            change = along(net.problem.directions, b, d, net.along_at + 3 * v)
            if v < wp.static(ROD_VECTORS):
                change += along(net.problem.directions, b, d, own_at)
            local = back * change
            for i in range(3):
                group.problem.directions[t, first + d, at + i] = local[i]
    for d in range(net.direction_count):
        for i in range(n):
            if net.shared[rod] == 0:
                group.problem.directions[t, first + d, i] = net.problem.directions[b, d, net.rotation_at + own + i]
            group.problem.directions[t, first + d, n + i] = (
                net.share[rod] * net.problem.directions[b, d, net.translation_at + own + i]
            )
        for i in range(group.drive_count):
            drive = group.drive[t % group.count, i]
            group.problem.directions[t, first + d, group.drives_at + i] = net.problem.directions[b, d, drive]
    if group.slides != 0:
        group.problem.directions[t, group.direction_count - 1, 1] = f64(1.0)


# ---- sums ----


@wp.func_native(
    """
    const double* __restrict own = &wp::index(element, b, 0, 0, 0);
    double* __restrict all = &wp::index(numbers, b, 0);
    double size = 0.0;
    for (int p = 0, e = 0; p < place.shape[0]; ++p) {
        double total = 0.0;
        for (; e < start.data[p + 1]; ++e) total += own[at.data[e]];
        all[place.data[p]] = total;
        size += fabs(total);
    }
    return size;
    """
)
def sum_numbers(
    element: wp.array4d[wp.float64],
    numbers: wp.array2d[wp.float64],
    b: int,
    place: wp.array[int],
    start: wp.array[int],
    at: wp.array[int],
) -> wp.float64:
    """The numbers of ``Gamma``, and the sum of their magnitudes: Warp's own loops would find the place of each anew."""


@wp.func
def add_up_pose(net: wp.ref[Networks], b: int):
    """(4), (6) Pose of the end effector, and its columns."""
    rod = net.effector_rod
    if rod < 0:
        R = net.body_rotation[b, net.effector]
        net.problem.position[b] = net.body_position[b, net.effector] + R * net.effector_position
        net.problem.rotation[b] = R * net.effector_rotation
    else:
        net.problem.position[b] = net.tip_position[b, rod]
        net.problem.rotation[b] = net.tip_rotation[b, rod]
    if net.problem.pose_columns.shape[2] == 1:
        return
    if rod < 0:
        body = net.effector - 1
        L = net.length[b, net.rod_count + body]
        at = net.first_pose + wp.static(POSE) * body
        arm = net.body_rotation[b, net.effector] * net.effector_position
        for k in range(3):
            moved = wp.cross(column_of(net.body_turns[b, body + 1], k), arm)
            for i in range(3):
                net.problem.pose_columns[b, i, at + k] = (L * L) * net.reference_rotation[b, body][i, k]
                net.problem.pose_columns[b, i, at + 3 + k] = moved[i]
                net.problem.pose_columns[b, 3 + i, at + 3 + k] = net.body_turns[b, body + 1][i, k]
        return
    for i in range(6):
        row = net.size + wp.static(TIP_POSE_AT) + i
        for k in range(net.size):
            place = net.variable[rod, k]
            if place >= 0:
                net.problem.pose_columns[b, i, place] = net.element[b, rod, row, k]
        for k in range(net.direction_count):
            net.problem.pose_columns[b, i, net.unknown_count + k] = net.element[b, rod, row, net.size + k]


@own_module(max_unroll=1)
def add_up(net: Networks):
    """(5) to (12) Residual, ``Gamma`` and the end effector."""
    b = net.problem.order[wp.tid()]
    if net.problem.active[b] == 0:
        return
    n = net.unknown_count
    d = net.direction_count
    open = f64(1.0) - net.problem.load_factor[b]
    size = f64(0.0)
    fault = int(0)
    steps = int(0)
    for r in range(net.rod_count):
        fault = wp.max(fault, net.rod_fault[b, r])
        steps += net.rod_steps[b, r]
    for i in range(n):
        total = f64(0.0)
        for e in range(net.row_start[i], net.row_start[i + 1]):
            total += net.value[b, net.row_rod[e], net.row_row[e]]
        if i >= net.first_pose:
            total -= net.load[b, i - net.first_pose]
        total -= open * net.opening[b, i]
        net.problem.residual[b, i] = total
        size += wp.abs(total)
        for k in range(d):
            total = f64(0.0)
            for e in range(net.row_start[i], net.row_start[i + 1]):
                total += net.element[b, net.row_rod[e], net.row_row[e], net.size + k]
            if i >= net.first_pose:
                total -= net.load_directions[b, i - net.first_pose, k]
            net.problem.residual_directions[b, i, k] = total
    size += sum_numbers(net.element, net.numbers, b, net.number_place, net.number_start, net.number_at)
    for k in range(net.body_count):
        for i in range(6):
            for j in range(3):
                at = net.turn_place[k, i, j]
                net.numbers[b, at] = net.numbers[b, at] - net.load_turns[b, k, i, j]
    if not wp.isfinite(size) and fault == 0:
        fault = wp.static(int(Fault.NONFINITE))
    net.problem.fault[b] = fault
    net.problem.step_count[b] = steps
    add_up_pose(net, b)
