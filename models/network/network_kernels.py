# mypy: ignore-errors
"""What couples the rods of a network: where bodies stand, elements, and their sums.

Numbers in parentheses are those of ``docs/networks.md``. The rods are integrated by the backbone kernels, those of one build in
one launch. Before it stand ``stand`` (bodies and their loads) and ``hand_over`` (unknowns and inputs of the networks to their
rods), after it ``form`` (an element of each rod) and ``add_up`` (residual, ``Gamma`` and the end effector). All sizes are those
of the arrays: one kernel each serves all networks.
"""

import warp as wp

from multirod.capabilities import Loading
from multirod.models.backbone.kernels.numbers.scalars import turned_about_z
from multirod.models.joint_kernels import column, vector
from multirod.models.rotation_kernels import inverse_right_jacobian, left_jacobian, rotation_from_vector, rotation_vector
from multirod.status import Fault

f64 = wp.float64

POSE = 6  # unknowns of a body
MOST = 3  # coordinates of a joint
TURNING = 3  # directions in which the base of a rod may turn
SOFT = 0.01  # L^3/EI by which rods give way along themselves while the network is put together
ALONG_VECTORS = 4  # inputs that act along rods; the third of them is gravity
# rows of an element after those of its variables
TIP_TURN_AT = 0  # (5) how the tip turns and the force on it changes, in the axes of the base
TIP_FORCE_AT = 3
TENSION_AT = 6  # (22) at the tip, then at the base
TIP_POSE_AT = 8  # of a rod that is the end effector: position, then rotation vector
MORE = 14
CARRIED_AT = 0  # of values, after those of the rows: what acts along the rod, in the world
MORE_VALUES = 3


@wp.struct
class Networks:
    """Whole networks: the first axis is the instance; a rod's index is ``instance * rod_count + rod``."""

    rod_count: int
    body_count: int
    unknown_count: int
    direction_count: int
    first_pose: int
    own: int  # variables of an element that are its rod's own
    size: int  # all of them: own, angles at base and tip, poses there, holes at tip and base if there are any
    width: int  # columns of an element: by its variables, along directions, and, with holes, by the length of its piece
    height: int  # rows of an element
    holes: int  # whether rods slide through any
    effector: int  # number of the body that is the end effector, after the ground; 0 where it is a rod
    effector_rod: int  # -1 where it is a body
    # unknowns, inputs, results
    order: wp.array[int]
    active: wp.array[int]
    load_factor: wp.array[wp.float64]
    unknowns: wp.array2d[wp.float64]
    inputs: wp.array2d[wp.float64]
    directions: wp.array3d[wp.float64]
    fault: wp.array[int]
    step_count: wp.array[int]
    residual: wp.array2d[wp.float64]
    numbers: wp.array2d[wp.float64]  # those that are kept of Gamma
    residual_directions: wp.array3d[wp.float64]
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    pose_columns: wp.array3d[wp.float64]
    # where inputs begin
    rotation_at: int
    translation_at: int
    force_at: int  # LOADED, of each load place
    moment_at: int
    follower_force_at: int  # FOLLOWING, likewise
    follower_moment_at: int
    along_at: int
    # rods; arrays with two ends say of bases, then of tips
    holder: wp.array2d[int]  # (end, rod): 0 the ground, from 1 on a body, -1 nothing
    attachment_position: wp.array3d[wp.vec3d]  # (instance, end, rod), frame of what holds it
    attachment_rotation: wp.array3d[wp.mat33d]
    count: wp.array2d[int]  # (end, rod): coordinates of the joint
    inner: wp.array2d[wp.mat33d]  # (2) A_1
    outer: wp.array2d[wp.mat33d]  # A_2
    spring: wp.array2d[wp.vec3d]
    rest: wp.array2d[wp.vec3d]
    driven: wp.array3d[int]  # (end, rod, coordinate): which input it is, -1 of an unknown
    variable: wp.array2d[int]  # (rod, variable): which unknown, -1 of what there is not
    load_place: wp.array[int]  # (rod,): among what forces act on, of a rod whose tip is free
    length: wp.array2d[wp.float64]  # (instance, rods and bodies): scales
    stiffness: wp.array2d[wp.float64]
    # (20) of pieces
    owner: wp.array[int]  # (rod,): whose rotation and translation it has
    share: wp.array[wp.float64]
    pieces: wp.array[int]
    shared: wp.array[int]  # whether its base is the hole at the tip of the piece below
    softness: wp.array3d[wp.float64]  # (instance, rod, 6): inverse stiffnesses, of bending and torsion, then shear and stretching
    at_rest: wp.array2d[wp.vec3d]  # (instance, rod): precurvature
    # bodies
    reference_position: wp.array2d[wp.vec3d]  # (instance, body): where unknown poses are zero
    reference_rotation: wp.array2d[wp.mat33d]
    mass: wp.array[wp.float64]
    mass_centre: wp.array[wp.vec3d]
    pulled_out: wp.array[int]  # (instance,): whether a rod was pulled out of a hole since this was 0
    # of the path from the network taken apart
    opening: wp.array2d[wp.float64]
    opened_at: wp.array2d[wp.float64]
    soft: wp.array[wp.float64]
    shift: wp.array2d[wp.vec3d]  # (instance, rod), (29) of where tips are held, in the frames of the bodies [m]
    loading: wp.array[int]
    # where bodies are, after the ground, and what acts on them
    body_position: wp.array2d[wp.vec3d]
    body_rotation: wp.array2d[wp.mat33d]
    body_turns: wp.array2d[wp.mat33d]  # rotation vectors by the unknowns of rotation, in the world
    load: wp.array2d[wp.float64]  # (instance, 6 bodies), as rows of (11)
    load_turns: wp.array4d[wp.float64]  # (instance, body, 6, 3): by the unknowns of rotation
    load_directions: wp.array3d[wp.float64]
    # what each rod says
    value: wp.array3d[wp.float64]  # (instance, rod, row)
    element: wp.array4d[wp.float64]  # (instance, rod, row, column)
    tip_position: wp.array2d[wp.vec3d]  # in the world
    tip_rotation: wp.array2d[wp.mat33d]
    rod_fault: wp.array2d[int]
    rod_steps: wp.array2d[int]
    # what stands where: sums of rows (unknown), and of numbers of elements
    row_start: wp.array[int]
    row_rod: wp.array[int]
    row_row: wp.array[int]
    number_place: wp.array[int]
    number_start: wp.array[int]
    number_rod: wp.array[int]
    number_row: wp.array[int]
    number_column: wp.array[int]
    turn_place: wp.array3d[int]  # (body, 6, 3): where its balance stands by how it turns
    yield_rod: wp.array[int]  # (12) whose tips are held
    yield_unknown: wp.array[int]  # which of its variables is the force along its base
    yield_place: wp.array[int]


@wp.struct
class RodGroup:
    """Rods of one build, a launch of one backbone kernel: the index is ``instance * count + place``."""

    count: int
    unknown_count: int
    direction_count: int
    turns: int  # whether the first directions are turns of the base
    slides: int  # whether the last is the length
    along_at: int
    rod: wp.array[int]  # (place,): which of its network
    first_force: int  # of the unknowns
    moment_by: wp.array3d[wp.float64]  # (rod of all instances, 3, unknown): moment at the base
    moment_rest: wp.array[wp.vec3d]  # less this
    force_unit: wp.array[wp.float64]
    order: wp.array[int]
    active: wp.array[int]
    load_factor: wp.array[wp.float64]
    unknowns: wp.array2d[wp.float64]
    inputs: wp.array2d[wp.float64]
    directions: wp.array3d[wp.float64]
    fault: wp.array[int]
    step_count: wp.array[int]
    residual: wp.array2d[wp.float64]
    gamma: wp.array3d[wp.float64]
    residual_directions: wp.array3d[wp.float64]
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    pose_columns: wp.array3d[wp.float64]
    wrench: wp.array2d[wp.float64]
    wrench_columns: wp.array3d[wp.float64]


@wp.func
def level_of(net: wp.ref[Networks], b: int) -> f64:
    """What multiplies all loads of an instance."""
    if net.loading[b] == wp.static(int(Loading.NONE)):
        return f64(0.0)
    if net.loading[b] == wp.static(int(Loading.FULL)):
        return f64(1.0)
    return net.load_factor[b]


@wp.func
def along(net: wp.ref[Networks], b: int, d: int, first: int) -> wp.vec3d:
    """Three numbers of a direction in input space."""
    return wp.vec3d(net.directions[b, d, first], net.directions[b, d, first + 1], net.directions[b, d, first + 2])


@wp.func
def nothing() -> wp.vec3d:
    return wp.vec3d(f64(0.0), f64(0.0), f64(0.0))


# ---- bodies ----


@wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
def stand(net: Networks):
    """(4) Poses of the bodies, and (11) what acts on them."""
    b = net.order[wp.tid()]
    if net.active[b] == 0:
        return
    level = level_of(net, b)
    gravity = vector(net.inputs, b, net.along_at + 6)
    for k in range(net.body_count):
        L = net.length[b, net.rod_count + k]
        EI = net.stiffness[b, net.rod_count + k]
        first = net.first_pose + wp.static(POSE) * k
        axes = net.reference_rotation[b, k]
        a = L * vector(net.unknowns, b, first + 3)
        rotation = axes * rotation_from_vector(a)
        turns = L * (axes * left_jacobian(a))
        net.body_position[b, k + 1] = net.reference_position[b, k] + (L * L) * (axes * vector(net.unknowns, b, first))
        net.body_rotation[b, k + 1] = rotation
        net.body_turns[b, k + 1] = turns
        inward = wp.transpose(axes)
        pull = L / EI
        twist = f64(1.0) / EI
        mass = net.mass[k]
        weight = (level * mass) * gravity
        centre = rotation * net.mass_centre[k]
        # (28)
        pushes = rotation * (level * vector(net.inputs, b, net.follower_force_at + 3 * k))
        twists = rotation * (level * vector(net.inputs, b, net.follower_moment_at + 3 * k))
        push = pull * (inward * (level * vector(net.inputs, b, net.force_at + 3 * k) + weight + pushes))
        moment = level * vector(net.inputs, b, net.moment_at + 3 * k) + wp.cross(centre, weight) + twists
        moment = twist * (inward * moment)
        push_by_turn = -pull * (inward * (wp.skew(pushes) * turns))
        by_turn = twist * (inward * ((wp.skew(weight) * wp.skew(centre) - wp.skew(twists)) * turns))
        at = wp.static(POSE) * k
        for i in range(3):
            net.load[b, at + i] = push[i]
            net.load[b, at + 3 + i] = moment[i]
            for j in range(3):
                net.load_turns[b, k, i, j] = push_by_turn[i, j]
                net.load_turns[b, k, 3 + i, j] = by_turn[i, j]
        for d in range(net.direction_count):
            heave = mass * along(net, b, d, net.along_at + 6)
            pushes = rotation * along(net, b, d, net.follower_force_at + 3 * k)
            push = pull * (inward * (along(net, b, d, net.force_at + 3 * k) + heave + pushes))
            moment = along(net, b, d, net.moment_at + 3 * k) + wp.cross(centre, heave)
            moment += rotation * along(net, b, d, net.follower_moment_at + 3 * k)
            moment = twist * (inward * moment)
            for i in range(3):
                net.load_directions[b, at + i, d] = push[i]
                net.load_directions[b, at + 3 + i, d] = moment[i]


# ---- ends of rods ----


@wp.struct
class End:
    """(1) to (3) One end of a rod as its body and its joint have it, in the world but for what is said to be in its pose."""

    arm: wp.vec3d  # from the body
    frame: wp.mat33d  # of the pose on the body
    position: wp.vec3d
    rotation: wp.mat33d  # of the end
    body_turns: wp.mat33d
    angle: wp.vec3d
    joint: wp.mat33d  # E, in the pose
    turns: wp.mat33d  # G
    axes: wp.mat33d  # W
    second: wp.mat33d  # axes that turn with the first
    first: wp.mat33d  # by which turns
    count: int


@wp.func(inline=False)
def end_at(net: wp.ref[Networks], b: int, rod: int, e: int) -> End:
    """An end of a rod, that something holds."""
    end = End()
    holder = net.holder[e, rod]
    R = net.body_rotation[b, holder]
    arm = net.attachment_position[b, e, rod]
    if e == 1:  # (29)
        arm += (f64(1.0) - net.load_factor[b]) * net.shift[b, rod]
    end.arm = R * arm
    end.frame = R * net.attachment_rotation[b, e, rod]
    end.position = net.body_position[b, holder] + end.arm
    end.rotation = end.frame
    end.body_turns = net.body_turns[b, holder]
    end.joint = wp.identity(3, dtype=f64)
    end.count = net.count[e, rod]
    if end.count > 0:
        for j in range(end.count):
            given = net.driven[e, rod, j]
            if given >= 0:  # (24)
                end.angle[j] = net.inputs[b, given]
            else:
                end.angle[j] = net.length[b, rod] * net.unknowns[b, net.variable[rod, net.own + wp.static(MOST) * e + j]]
        a = net.inner[e, rod] * end.angle
        end.first = left_jacobian(a) * net.inner[e, rod]
        end.joint = rotation_from_vector(a)
        end.turns = end.first
        end.axes = net.inner[e, rod]
        if end.count == 2:  # a universal joint
            c = net.outer[e, rod] * end.angle
            end.second = end.joint * net.outer[e, rod]
            end.turns = end.first + end.joint * (left_jacobian(c) * net.outer[e, rod])
            end.axes = net.inner[e, rod] + end.second
            end.joint = end.joint * rotation_from_vector(c)
        end.rotation = end.frame * end.joint
    return end


@wp.func
def extension(net: wp.ref[Networks], b: int, rod: int) -> f64:
    """(20) How much longer a piece is than it is taken to be."""
    given = net.share[rod] * net.inputs[b, net.translation_at + net.owner[rod]]
    if net.holes == 0:
        return given
    L = net.length[b, rod]
    moved = f64(0.0)
    tip = net.variable[rod, net.size - 2]
    base = net.variable[rod, net.size - 1]
    if tip >= 0:
        moved += net.unknowns[b, tip]
    if base >= 0:
        moved -= net.unknowns[b, base]
    return (net.share[rod] * f64(net.pieces[rod]) - f64(1.0)) * L + given + L * L * moved


@wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
def hand_over(net: Networks, group: RodGroup):
    """(6), (20) Unknowns, inputs and directions of the networks to their rods."""
    t = group.order[wp.tid()]
    b = t // group.count
    group.active[t] = net.active[b]
    if net.active[b] == 0:
        return
    rod = group.rod[t % group.count]
    level = level_of(net, b)
    group.load_factor[t] = level
    for i in range(group.unknown_count):
        group.unknowns[t, i] = net.unknowns[b, net.variable[rod, i]]
    own = net.owner[rod]
    angle = f64(0.0)
    if net.shared[rod] == 0:
        angle = net.inputs[b, net.rotation_at + own]
    group.inputs[t, 0] = angle
    longer = extension(net, b, rod)
    group.inputs[t, 1] = wp.where(longer <= -net.length[b, rod], f64(0.0), longer)
    end = end_at(net, b, rod, 0)
    back = wp.transpose(end.rotation)
    first = wp.static(TURNING) * group.turns
    for v in range(wp.static(ALONG_VECTORS)):
        at = group.along_at + 3 * v
        local = back * vector(net.inputs, b, net.along_at + 3 * v)
        for i in range(3):
            group.inputs[t, at + i] = local[i]
        if group.turns != 0:
            by_turn = level * wp.skew(local)
            for j in range(3):
                for i in range(3):
                    group.directions[t, j, at + i] = by_turn[i, j]
        for d in range(net.direction_count):
            local = back * along(net, b, d, net.along_at + 3 * v)
            for i in range(3):
                group.directions[t, first + d, at + i] = local[i]
    for d in range(net.direction_count):
        if net.shared[rod] == 0:
            group.directions[t, first + d, 0] = net.directions[b, d, net.rotation_at + own]
        group.directions[t, first + d, 1] = net.share[rod] * net.directions[b, d, net.translation_at + own]
    if group.slides != 0:
        group.directions[t, group.direction_count - 1, 1] = f64(1.0)


# ---- elements ----


@wp.struct
class Element:
    """A rod as integrated, its ends, and what its rows are told in."""

    b: int
    rod: int
    free: int  # whether nothing holds the tip
    base: End
    tip: End
    back: wp.mat33d  # from the world to the base
    rotation: wp.mat33d  # of the tip, in the base
    position: wp.vec3d
    apart: wp.vec3d  # from where the tip is to be to the base, in its axes
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
    base_turn: wp.vec3d  # of the body there
    base_angle: wp.vec3d
    tip_move: wp.vec3d
    tip_turn: wp.vec3d
    tip_angle: wp.vec3d
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
        write(net.element, b, rod, 0, k, gap / (L * L))  # (7)
        tip = change.tip_turn + own.tip.frame * (own.tip.turns * change.tip_angle)
        lack = wp.transpose(own.rotation) * (turn - own.back * tip)
        write(net.element, b, rod, 3, k, (own.by_turn * lack) / L)  # (8)
    if own.base.count > 0:  # (9)
        moment = own.base.joint * own.base_moment
        by_all = own.base.joint * change.base_m - wp.cross(moment, own.base.turns * change.base_angle)
        torque = torque_change(own.base, -net.spring[0, rod], moment, by_all, change.base_angle) / EI
        if net.shared[rod] != 0:  # (19)
            torque = -torque
        write(net.element, b, rod, angles, k, torque)
    by_force = frame * n
    by_moment = frame * m
    if own.tip.count > 0:
        inward = wp.transpose(own.tip.frame)
        moment = frame * own.moment
        by_all = inward * (by_moment + wp.cross(moment, change.tip_turn))
        torque = torque_change(own.tip, net.spring[1, rod], inward * moment, by_all, change.tip_angle) / EI
        write(net.element, b, rod, angles + wp.static(MOST), k, torque)
    # (11)
    holder = net.holder[0, rod]
    if holder > 0:
        force = -(frame * own.base_force)
        push = -(frame * (change.base_n + wp.cross(beta, own.base_force)))
        twist = -(frame * (change.base_m + wp.cross(beta, own.base_moment))) + wp.cross(own.base.arm, push)
        twist += wp.cross(force, wp.cross(own.base.arm, change.base_turn))
        write_balance(net, b, rod, holder, poses, k, push, twist)
    holder = net.holder[1, rod]
    if holder > 0:
        twist = by_moment + wp.cross(own.tip.arm, by_force)
        twist += wp.cross(frame * own.force, wp.cross(own.tip.arm, change.tip_turn))
        write_balance(net, b, rod, holder, poses + wp.static(POSE), k, by_force, twist)
    more = net.size
    write(net.element, b, rod, more + wp.static(TIP_TURN_AT), k, turn)
    write(net.element, b, rod, more + wp.static(TIP_FORCE_AT), k, n)
    if net.holes != 0:  # (22)
        by_tip = wp.dot(own.stretched, change.n) + wp.dot(own.bent, change.m) + wp.dot(own.turned, change.phi)
        by_base = wp.dot(own.base_stretched, change.base_n) + wp.dot(own.base_bent, change.base_m)
        net.element[b, rod, more + wp.static(TENSION_AT), k] = by_tip
        net.element[b, rod, more + wp.static(TENSION_AT + 1), k] = by_base
        net.element[b, rod, more - 2, k] = (L / EI) * by_tip
        net.element[b, rod, more - 1, k] = -(L / EI) * by_base
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
        moment += group.unknowns[t, k] * column(group.moment_by, t, 0, k)
    turned = turned_about_z(group.inputs[t, 0])
    own.base_moment = turned * moment
    own.base_force = turned * (group.force_unit[t] * vector(group.unknowns, t, group.first_force))


@wp.func
def base_wrench_change(group: wp.ref[RodGroup], t: int, own: wp.ref[Element], change: wp.ref[Change], k: int, d: int):
    """(5b) Their changes with the unknown ``k`` of the rod, or along its direction ``d``; negative of what is not meant."""
    change.base_m = nothing()
    change.base_n = nothing()
    if k >= 0:
        turned = turned_about_z(group.inputs[t, 0])
        change.base_m = turned * column(group.moment_by, t, 0, k)
        j = k - group.first_force
        if j >= 0 and j < 3:
            change.base_n = turned * unit_vector(j, group.force_unit[t])
    if d >= 0:
        axis = wp.vec3d(f64(0.0), f64(0.0), group.directions[t, d, 0])
        change.base_m = wp.cross(axis, own.base_moment)
        change.base_n = wp.cross(axis, own.base_force)


@wp.func(inline=False)
def integrated(group: wp.ref[RodGroup], t: int, change: wp.ref[Change], index: int, beta: wp.vec3d):
    """(5), (6) A change of what the integration says: its column ``index``, if that is not negative, and a turn of the base."""
    change.beta = beta
    change.q = nothing()
    change.phi = nothing()
    change.n = nothing()
    change.m = nothing()
    if index >= 0:
        change.q = column(group.pose_columns, t, 0, index)
        change.phi = column(group.pose_columns, t, 3, index)
        change.n = column(group.wrench_columns, t, 0, index)
        change.m = column(group.wrench_columns, t, 3, index)
    if group.turns != 0:
        for j in range(wp.static(TURNING)):
            k = group.unknown_count + j
            change.q += beta[j] * column(group.pose_columns, t, 0, k)
            change.phi += beta[j] * column(group.pose_columns, t, 3, k)
            change.n += beta[j] * column(group.wrench_columns, t, 0, k)
            change.m += beta[j] * column(group.wrench_columns, t, 3, k)


@wp.func
def column_of(values: wp.mat33d, k: int) -> wp.vec3d:
    return wp.vec3d(values[0, k], values[1, k], values[2, k])


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
        write_value(net.value, b, rod, 0, (own.apart + own.position) / (L * L))
        write_value(net.value, b, rod, 3, own.log / L)
    angles = net.own
    if own.base.count > 0:
        torque = wp.transpose(own.base.axes) * (own.base.joint * own.base_moment)
        torque = (torque - wp.cw_mul(net.spring[0, rod], own.base.angle - net.rest[0, rod])) / EI
        write_value(net.value, b, rod, angles, wp.where(net.shared[rod] != 0, -torque, torque))
    force = frame * own.force
    moment = frame * own.moment
    if own.tip.count > 0:
        torque = wp.transpose(own.tip.axes) * (wp.transpose(own.tip.frame) * moment)
        torque = (torque + wp.cw_mul(net.spring[1, rod], own.tip.angle - net.rest[1, rod])) / EI
        write_value(net.value, b, rod, angles + wp.static(MOST), torque)
    carried = frame * own.base_force - force
    write_value(net.value, b, rod, net.size + wp.static(CARRIED_AT), carried)
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
        scaled = tension * own.length / own.stiffness
        if e == 0:
            own.stretched = Q * (axis + stretched)
            own.bent = Q * (rest + bent)
            own.turned = wp.cross(own.stretched, own.force) + wp.cross(own.bent, own.moment)
            net.value[b, rod, net.size - 2] = scaled
        else:
            own.base_stretched = axis + stretched
            own.base_bent = rest + bent
            net.value[b, rod, net.size - 1] = -scaled


@wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
def form(net: Networks, group: RodGroup):
    """(5) to (11), (22) The element of each rod, and its own rows beside those of its tip."""
    t = group.order[wp.tid()]
    b = t // group.count
    if net.active[b] == 0:
        return
    rod = group.rod[t % group.count]
    own = Element()
    own.b = b
    own.rod = rod
    own.length = net.length[b, rod]
    own.stiffness = net.stiffness[b, rod]
    own.base = end_at(net, b, rod, 0)
    own.back = wp.transpose(own.base.rotation)
    own.position = group.position[t]
    own.rotation = group.rotation[t]
    own.force = vector(group.wrench, t, 0)
    own.moment = vector(group.wrench, t, 3)
    base_wrench(group, t, own)
    place = net.load_place[rod]
    if net.holder[1, rod] >= 0:
        own.tip = end_at(net, b, rod, 1)
        own.apart = own.back * (own.base.position - own.tip.position)
        own.log = rotation_vector(wp.transpose(own.tip.rotation) * (own.base.rotation * own.rotation))
        own.by_turn = inverse_right_jacobian(own.log)
    else:
        own.free = 1
        level = level_of(net, b)
        own.given_force = own.back * (level * vector(net.inputs, b, net.force_at + 3 * place))
        own.given_moment = own.back * (level * vector(net.inputs, b, net.moment_at + 3 * place))
        own.following_force = own.rotation * (level * vector(net.inputs, b, net.follower_force_at + 3 * place))
        own.following_moment = own.rotation * (level * vector(net.inputs, b, net.follower_moment_at + 3 * place))
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
                beta = own.back * (own.base.frame * (own.base.turns * change.base_angle))
        elif j < wp.static(2 * MOST):
            there = wp.where(net.variable[rod, k] >= 0, 1, 0)
            if there != 0:
                change.tip_angle = unit_vector(j - wp.static(MOST), L)
        elif j < wp.static(2 * MOST + 2 * POSE):
            i = j - wp.static(2 * MOST)
            e = i // wp.static(POSE)
            i = i % wp.static(POSE)
            holder = net.holder[e, rod]
            there = wp.where(holder > 0, 1, 0)
            if there != 0:
                move = nothing()
                turn = nothing()
                if i < 3:
                    scale = net.length[b, net.rod_count + holder - 1]
                    move = (scale * scale) * column_of(net.reference_rotation[b, holder - 1], i)
                else:
                    turn = column_of(net.body_turns[b, holder], i - 3)
                    move = wp.cross(turn, wp.where(e == 0, own.base.arm, own.tip.arm))
                if e == 0:
                    change.base_move = move
                    change.base_turn = turn
                    beta = own.back * turn
                else:
                    change.tip_move = move
                    change.tip_turn = turn
        elif d < 0:
            there = 0  # holes: from the column by the length
        elif d < net.direction_count:
            index = ahead + d
            for i in range(wp.static(MOST)):  # (24)
                if net.driven[0, rod, i] >= 0:
                    change.base_angle[i] = net.directions[b, d, net.driven[0, rod, i]]
                if net.driven[1, rod, i] >= 0:
                    change.tip_angle[i] = net.directions[b, d, net.driven[1, rod, i]]
            beta = own.back * (own.base.frame * (own.base.turns * change.base_angle))
            if own.free != 0:
                change.given_force = along(net, b, d, net.force_at + 3 * place)
                change.given_moment = along(net, b, d, net.moment_at + 3 * place)
                change.following_force = along(net, b, d, net.follower_force_at + 3 * place)
                change.following_moment = along(net, b, d, net.follower_moment_at + 3 * place)
        else:
            index = ahead + net.direction_count
            there = group.slides
        if there != 0:
            integrated(group, t, change, index, beta)
            along_direction = wp.where(d >= 0 and d < net.direction_count, index - m, -1)
            base_wrench_change(group, t, own, change, wp.where(k < m, k, -1), along_direction)
            write_column(net, own, change, k)
            # the rod's own rows beside those of its tip
            for i in range(6, m):
                if k < m:
                    net.element[b, rod, i, k] = group.gamma[t, i, k]
                elif index >= m:
                    net.element[b, rod, i, k] = group.residual_directions[t, i, index - m]
    for i in range(6, m):
        net.value[b, rod, i] = group.residual[t, i]
    if group.slides != 0:  # (20)
        for i in range(net.height):
            by_length = (L * L) * net.element[b, rod, i, net.width - 1]
            net.element[b, rod, i, net.size - 2] = by_length
            net.element[b, rod, i, net.size - 1] = -by_length
    net.tip_position[b, rod] = own.base.position + own.base.rotation * own.position
    net.tip_rotation[b, rod] = own.base.rotation * own.rotation
    net.rod_fault[b, rod] = group.fault[t]
    net.rod_steps[b, rod] = group.step_count[t]
    if extension(net, b, rod) <= -L:
        net.value[b, rod, 0] = f64(0.0) / f64(0.0)
        net.pulled_out[b] = 1


# ---- sums ----


@wp.func
def add_up_pose(net: wp.ref[Networks], b: int):
    """(4), (6) Pose of the end effector, and its columns."""
    rod = net.effector_rod
    if rod < 0:
        net.position[b] = net.body_position[b, net.effector]
        net.rotation[b] = net.body_rotation[b, net.effector]
    else:
        net.position[b] = net.tip_position[b, rod]
        net.rotation[b] = net.tip_rotation[b, rod]
    if net.pose_columns.shape[2] == 1:
        return
    if rod < 0:
        body = net.effector - 1
        L = net.length[b, net.rod_count + body]
        at = net.first_pose + wp.static(POSE) * body
        for k in range(3):
            for i in range(3):
                net.pose_columns[b, i, at + k] = (L * L) * net.reference_rotation[b, body][i, k]
                net.pose_columns[b, 3 + i, at + 3 + k] = net.body_turns[b, body + 1][i, k]
        return
    for i in range(6):
        row = net.size + wp.static(TIP_POSE_AT) + i
        for k in range(net.size):
            place = net.variable[rod, k]
            if place >= 0:
                net.pose_columns[b, i, place] = net.element[b, rod, row, k]
        for k in range(net.direction_count):
            net.pose_columns[b, i, net.unknown_count + k] = net.element[b, rod, row, net.size + k]


@wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
def add_up(net: Networks):
    """(5) to (12) Residual, ``Gamma`` and the end effector."""
    b = net.order[wp.tid()]
    if net.active[b] == 0:
        return
    n = net.unknown_count
    d = net.direction_count
    open = f64(1.0) - net.load_factor[b]
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
        net.residual[b, i] = total
        size += wp.abs(total)
        for k in range(d):
            total = f64(0.0)
            for e in range(net.row_start[i], net.row_start[i + 1]):
                total += net.element[b, net.row_rod[e], net.row_row[e], net.size + k]
            if i >= net.first_pose:
                total -= net.load_directions[b, i - net.first_pose, k]
            net.residual_directions[b, i, k] = total
    for p in range(net.number_place.shape[0]):
        total = f64(0.0)
        for e in range(net.number_start[p], net.number_start[p + 1]):
            total += net.element[b, net.number_rod[e], net.number_row[e], net.number_column[e]]
        net.numbers[b, net.number_place[p]] = total
        size += wp.abs(total)
    for k in range(net.body_count):
        for i in range(6):
            for j in range(3):
                at = net.turn_place[k, i, j]
                net.numbers[b, at] = net.numbers[b, at] - net.load_turns[b, k, i, j]
    soft = f64(wp.static(SOFT)) * open * net.soft[b]
    if soft != f64(0.0):  # (12)
        for i in range(net.yield_rod.shape[0]):
            row = net.variable[net.yield_rod[i], 2]
            k = net.variable[net.yield_rod[i], net.yield_unknown[i]]
            at = net.yield_place[i]
            net.numbers[b, at] = net.numbers[b, at] + soft
            net.residual[b, row] = net.residual[b, row] + soft * (net.unknowns[b, k] - net.opened_at[b, k])
    if not wp.isfinite(size) and fault == 0:
        fault = wp.static(int(Fault.NONFINITE))
    net.fault[b] = fault
    net.step_count[b] = steps
    add_up_pose(net, b)
