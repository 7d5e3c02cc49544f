# mypy: ignore-errors
"""What couples rods that hold one platform: joints, and the equilibrium of the platform.

Numbers in parentheses are those of ``docs/parallel.md``. The legs are integrated by the backbone kernels, many at a time;
around each such launch stand ``hand_over`` (unknowns and inputs of the robots to their legs), ``attach`` (pose and wrench of
each leg's tip to the residual of its joint) and ``balance`` (the platform).
"""

import warp as wp

from multirod.capabilities import Loading
from multirod.models.backbone.kernels.numbers.scalars import turned_about_z
from multirod.models.joint_kernels import (
    SOFT,
    Joint,
    column,
    column_of,
    joint_at,
    joint_rows,
    joint_rows_variation,
    vector,
    write_rows,
)
from multirod.models.rotation_kernels import left_jacobian, rotation_from_vector

# one module: to read Warp's headers takes longer than to compile its kernels, which are always used together
wp.set_module_options({"max_unroll": 1})

f64 = wp.float64

POSE = 6  # unknowns and residuals of the platform, and of a leg's joint
PLATFORM_VECTORS = ("tip_force", "tip_moment", "follower_force", "follower_moment", "force_point")
LEG_VECTORS = ("distributed_force", "distributed_moment", "gravity", "magnetic_field")
POSE_VECTORS = ("platform_position", "platform_rotation")  # of the inverse problem
# what a leg hands to the balance of its platform
FORCE_AT = 0
MOMENT_AT = 3
TURN_AT = 6  # change of the moment by the rotation vector of the platform, row by row
DIRECTIONS_AT = 15  # change of force and moment by each direction


@wp.struct
class Robots:
    """Whole robots: the first axis is the instance, a leg's index is ``instance * leg_count + leg``."""

    leg_count: int
    rod_count: int
    unknown_count: int
    direction_count: int
    leg_direction_count: int  # the first of them, that touch legs: they have columns for these
    inverse: int  # whether the pose is given and the legs' translations are unknown
    # unknowns, inputs, results
    order: wp.array[int]  # instances that a launch passes over
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
    # geometry
    stride: int  # 1 if each instance has its own, else 0
    reference_position: wp.array[wp.vec3d]  # (batch): where the unknown pose is zero
    reference_rotation: wp.array[wp.mat33d]
    attachment_position: wp.array2d[wp.vec3d]  # (instance or 1, leg), platform frame
    attachment_rotation: wp.array2d[wp.mat33d]
    joint: wp.array[int]  # (leg,)
    axis: wp.array[wp.vec3d]  # (leg,): of a revolute joint, attachment frame
    length: wp.array2d[wp.float64]  # (instance or 1, leg + 1): length scale of each leg, and of the platform
    stiffness: wp.array2d[wp.float64]  # bending stiffness that scales wrenches, likewise
    mass: wp.float64
    mass_centre: wp.vec3d
    # where inputs begin
    pose: int  # POSE_VECTORS
    loads: int  # PLATFORM_VECTORS
    leg_vectors: int  # LEG_VECTORS
    # of the path from open to closed joints
    opening: wp.array2d[wp.float64]  # (instance, unknown): residual of the unloaded robot where the path begins
    soft: wp.array[wp.float64]  # (instance,): whether tips give way on it
    loading: wp.array[int]  # ``Loading``: how loads act while joints close
    # what each leg hands to the platform
    law: wp.array2d[wp.float64]  # (leg of all instances, DIRECTIONS_AT + 6 directions)
    leg_fault: wp.array[int]
    leg_step_count: wp.array[int]


@wp.struct
class Legs:
    """Legs of one build, a launch of one backbone kernel: the index is ``instance * count + place``."""

    count: int
    rods: int  # concentric rods of each
    unknown_count: int
    vectors: int  # where LEG_VECTORS begin in the legs' inputs
    drives: int  # where what drives members begins in a leg's inputs
    drive: wp.array2d[int]  # (place, drive): where each of these stands in the robot's
    leg: wp.array[int]  # (place,): which leg of its robot
    first_rod: wp.array[int]  # (place,): among the robot's rods
    first_unknown: wp.array[int]  # (place,): of the robot
    to_base: wp.array[wp.mat33d]  # world to the frame of the base
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
def direction(robots: Robots, b: int, k: int, first: int) -> wp.vec3d:
    """Part of a direction in input space."""
    return wp.vec3d(robots.directions[b, k, first], robots.directions[b, k, first + 1], robots.directions[b, k, first + 2])


@wp.func
def length_of(robots: Robots, b: int, leg: int) -> f64:
    """Length scale of a leg, or of the platform."""
    return robots.length[b * robots.stride, leg]


@wp.func
def stiffness_of(robots: Robots, b: int, leg: int) -> f64:
    """Stiffness scale of a leg, or of the platform."""
    return robots.stiffness[b * robots.stride, leg]


@wp.func
def load_of(robots: Robots, b: int) -> f64:
    """What multiplies all loads of an instance."""
    if robots.loading[b] == wp.static(int(Loading.NONE)):
        return f64(0.0)
    if robots.loading[b] == wp.static(int(Loading.FULL)):
        return f64(1.0)
    return robots.load_factor[b]


@wp.kernel(enable_backward=False)
def hand_over(robots: Robots, legs: Legs):
    """Unknowns, inputs and directions of the robots to their legs."""
    t = legs.order[wp.tid()]
    b = t // legs.count
    place = t % legs.count
    legs.active[t] = robots.active[b]
    if robots.active[b] == 0:
        return
    leg = legs.leg[place]
    legs.load_factor[t] = load_of(robots, b)
    for i in range(legs.unknown_count):
        legs.unknowns[t, i] = robots.unknowns[b, legs.first_unknown[place] + i]
    for i in range(legs.rods):
        rod = legs.first_rod[place] + i
        legs.inputs[t, i] = robots.inputs[b, rod]
        legs.inputs[t, legs.rods + i] = robots.inputs[b, robots.rod_count + rod]
        for k in range(robots.leg_direction_count):
            legs.directions[t, k, i] = robots.directions[b, k, rod]
            legs.directions[t, k, legs.rods + i] = robots.directions[b, k, robots.rod_count + rod]
    for i in range(wp.static(3 * len(LEG_VECTORS))):
        legs.inputs[t, legs.vectors + i] = robots.inputs[b, robots.leg_vectors + i]
        for k in range(robots.leg_direction_count):
            legs.directions[t, k, legs.vectors + i] = robots.directions[b, k, robots.leg_vectors + i]
    for i in range(legs.drive.shape[1]):
        drive = legs.drive[place, i]
        legs.inputs[t, legs.drives + i] = robots.inputs[b, drive]
        for k in range(robots.leg_direction_count):
            legs.directions[t, k, legs.drives + i] = robots.directions[b, k, drive]
    if robots.inverse != 0:
        # (10) the unknown translation, and its own column
        L = length_of(robots, b, leg)
        x = robots.unknowns[b, robots.unknown_count - wp.static(POSE) + leg]
        legs.inputs[t, legs.rods] = legs.inputs[t, legs.rods] + L * L * x
        legs.directions[t, robots.leg_direction_count, legs.rods] = L * L


@wp.struct
class Platform:
    """Pose of a platform in the world."""

    position: wp.vec3d
    rotation: wp.mat33d
    turn: wp.mat33d  # rotation vector, in the world, by the three numbers that give the rotation
    length: f64


@wp.func
def platform_pose(robots: Robots, b: int) -> Platform:
    """(1), (2) The pose that the unknowns give, or, in the inverse problem, the inputs."""
    pose = Platform()
    pose.length = length_of(robots, b, robots.leg_count)
    if robots.inverse != 0:
        pose.position = vector(robots.inputs, b, robots.pose)
        a = vector(robots.inputs, b, robots.pose + 3)
        pose.rotation = rotation_from_vector(a)
        pose.turn = left_jacobian(a)
        return pose
    first = robots.unknown_count - wp.static(POSE)
    pose.position = robots.reference_position[b * robots.stride] + pose.length * pose.length * vector(robots.unknowns, b, first)
    a = pose.length * vector(robots.unknowns, b, first + 3)
    pose.rotation = rotation_from_vector(a) * robots.reference_rotation[b * robots.stride]
    pose.turn = left_jacobian(a)
    return pose


@wp.func
def pose_direction(robots: Robots, b: int, k: int, pose: Platform):
    """Change of the pose with direction k at fixed unknowns: what the inverse problem is given."""
    move = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    turn = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    if robots.inverse != 0:
        move = direction(robots, b, k, robots.pose)
        turn = pose.turn * direction(robots, b, k, robots.pose + 3)
    return move, turn


@wp.func
def load_joint(robots: Robots, legs: Legs, t: int, b: int, leg: int, pose: Platform) -> Joint:
    """A joint as it stands."""
    g = b * robots.stride
    frame = pose.rotation * robots.attachment_rotation[g, leg]
    joint = joint_at(robots.joint[leg], robots.axis[leg], frame, legs.rotation[t], vector(legs.wrench, t, 3))
    joint.arm = pose.rotation * robots.attachment_position[g, leg]
    joint.length = length_of(robots, b, leg)
    joint.curvature = f64(1.0) / stiffness_of(robots, b, leg)
    return joint


@wp.kernel(enable_backward=False)
def attach(robots: Robots, legs: Legs):
    """(4) to (7): residual of each leg's joint, its columns, and what the leg does to the platform."""
    t = legs.order[wp.tid()]
    b = t // legs.count
    if robots.active[b] == 0:
        return
    place = t % legs.count
    leg = legs.leg[place]
    first = legs.first_unknown[place]
    m = legs.unknown_count
    platform = robots.unknown_count - wp.static(POSE)
    zero = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    pose = platform_pose(robots, b)
    joint = load_joint(robots, legs, t, b, leg, pose)
    to_gap = legs.to_base[t] / (joint.length * joint.length)
    force = vector(legs.wrench, t, 0)
    moment = vector(legs.wrench, t, 3)

    gap = to_gap * (legs.position[t] - pose.position - joint.arm)
    rows = joint_rows(joint)
    open = f64(1.0) - robots.load_factor[b]
    give = f64(wp.static(SOFT)) * open * robots.soft[b]  # (9b)
    turned = turned_about_z(legs.inputs[t, 0])
    gap += give * (turned * vector(legs.unknowns, t, m - 3))
    for j in range(3):
        robots.residual[b, first + j] = gap[j] - open * robots.opening[b, first + j]
        robots.residual[b, first + 3 + j] = rows[j] - open * robots.opening[b, first + 3 + j]
    for i in range(wp.static(POSE), m):
        robots.residual[b, first + i] = legs.residual[t, i] - open * robots.opening[b, first + i]

    bent = f64(1.0) / stiffness_of(robots, b, robots.leg_count)
    pull = pose.length * bent
    extra = robots.leg_direction_count
    if robots.inverse != 0:
        extra += 1
    for k in range(m + extra):
        dp = column(legs.pose_columns, t, 0, k)
        tip_turn = column(legs.pose_columns, t, 3, k)
        dn = column(legs.wrench_columns, t, 0, k)
        dm = column(legs.wrench_columns, t, 3, k)
        move = zero
        turn = zero
        if k >= m and k - m < robots.leg_direction_count:
            move, turn = pose_direction(robots, b, k - m, pose)
        gap = to_gap * (dp - move - wp.cross(turn, joint.arm))
        if k >= m - 3 and k < m:
            gap += give * column_of(turned, k - m + 3)
        rows = joint_rows_variation(joint, tip_turn, turn, dm, moment)
        # (8) on the platform; what a turn of it does, balance adds
        push = pull * dn
        twist = bent * (dm + wp.cross(joint.arm, dn))
        if k < m:
            write_rows(robots.gamma, b, first, first + k, gap, rows)
            write_rows(robots.gamma, b, platform, first + k, push, twist)
            for i in range(wp.static(POSE), m):
                robots.gamma[b, first + i, first + k] = legs.gamma[t, i, k]
        elif k - m < robots.leg_direction_count:
            write_rows(robots.residual_directions, b, first, k - m, gap, rows)
            for i in range(wp.static(POSE), m):
                robots.residual_directions[b, first + i, k - m] = legs.residual_directions[t, i, k - m]
        else:
            write_rows(robots.gamma, b, first, platform + leg, gap, rows)
            write_rows(robots.gamma, b, platform, platform + leg, push, twist)
            for i in range(wp.static(POSE), m):
                robots.gamma[b, first + i, platform + leg] = legs.residual_directions[t, i, k - m]
    for k in range(robots.leg_direction_count, robots.direction_count):
        move, turn = pose_direction(robots, b, k, pose)
        gap = -(to_gap * (move + wp.cross(turn, joint.arm)))
        write_rows(robots.residual_directions, b, first, k, gap, joint_rows_variation(joint, zero, turn, zero, moment))
        for i in range(wp.static(POSE), m):
            robots.residual_directions[b, first + i, k] = f64(0.0)
    if robots.inverse == 0:
        for k in range(3):
            move = zero
            move[k] = pose.length * pose.length
            turn = pose.length * wp.vec3d(pose.turn[0, k], pose.turn[1, k], pose.turn[2, k])
            write_rows(robots.gamma, b, first, platform + k, -(to_gap * move), zero)
            rows = joint_rows_variation(joint, zero, turn, zero, moment)
            write_rows(robots.gamma, b, first, platform + 3 + k, -(to_gap * wp.cross(turn, joint.arm)), rows)

    q = b * robots.leg_count + leg
    total = moment + wp.cross(joint.arm, force)
    turned = wp.skew(force) * wp.skew(joint.arm)  # (turn x arm) x force = turned turn
    for j in range(3):
        robots.law[q, wp.static(FORCE_AT) + j] = force[j]
        robots.law[q, wp.static(MOMENT_AT) + j] = total[j]
        for k in range(3):
            robots.law[q, wp.static(TURN_AT) + 3 * j + k] = turned[j, k]
    for k in range(robots.leg_direction_count):
        dn = column(legs.wrench_columns, t, 0, m + k)
        dm = column(legs.wrench_columns, t, 3, m + k)
        dm += wp.cross(joint.arm, dn)
        for j in range(3):
            robots.law[q, wp.static(DIRECTIONS_AT) + 6 * k + j] = dn[j]
            robots.law[q, wp.static(DIRECTIONS_AT) + 6 * k + 3 + j] = dm[j]
    robots.leg_fault[q] = legs.fault[t]
    robots.leg_step_count[q] = legs.step_count[t]


@wp.kernel(enable_backward=False)
def balance(robots: Robots):
    """(8): equilibrium of each platform, with its columns; and its pose."""
    b = robots.order[wp.tid()]
    if robots.active[b] == 0:
        return
    zero = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    pose = platform_pose(robots, b)
    platform = robots.unknown_count - wp.static(POSE)
    legs = robots.leg_count
    bent = f64(1.0) / stiffness_of(robots, b, legs)
    pull = pose.length * bent

    force = zero
    moment = zero
    turned = wp.mat33d()
    fault = int(0)
    steps = int(0)
    total = f64(0.0)
    for leg in range(legs):
        q = b * legs + leg
        force += vector(robots.law, q, wp.static(FORCE_AT))
        moment += vector(robots.law, q, wp.static(MOMENT_AT))
        for j in range(3):
            for k in range(3):
                turned[j, k] = turned[j, k] + robots.law[q, wp.static(TURN_AT) + 3 * j + k]
        fault = wp.max(fault, robots.leg_fault[q])
        steps += robots.leg_step_count[q]

    load = load_of(robots, b)
    open = f64(1.0) - robots.load_factor[b]
    first = robots.loads
    tip_force = load * vector(robots.inputs, b, first)
    tip_moment = load * vector(robots.inputs, b, first + 3)
    follower_force = load * (pose.rotation * vector(robots.inputs, b, first + 6))
    follower_moment = load * (pose.rotation * vector(robots.inputs, b, first + 9))
    point = pose.rotation * vector(robots.inputs, b, first + 12)
    gravity = robots.leg_vectors + 6
    weight = (load * robots.mass) * vector(robots.inputs, b, gravity)
    centre = pose.rotation * robots.mass_centre
    pushed = tip_force + follower_force
    force -= pushed + weight
    moment -= tip_moment + follower_moment + wp.cross(point, pushed) + wp.cross(centre, weight)
    for j in range(3):
        robots.residual[b, platform + j] = pull * force[j] - open * robots.opening[b, platform + j]
        robots.residual[b, platform + 3 + j] = bent * moment[j] - open * robots.opening[b, platform + 3 + j]
        total += wp.abs(force[j]) + wp.abs(moment[j])
    if not wp.isfinite(total) and fault == 0:
        fault = int(1)
    robots.fault[b] = fault
    robots.step_count[b] = steps
    robots.position[b] = pose.position
    robots.rotation[b] = pose.rotation

    # change of loads that act at points of the platform, or turn with it, by its rotation vector
    turned -= wp.skew(pushed) * wp.skew(point) + wp.skew(weight) * wp.skew(centre)
    turned += wp.skew(follower_moment) + wp.skew(point) * wp.skew(follower_force)
    for k in range(3):
        if robots.inverse == 0:
            turn = pose.length * wp.vec3d(pose.turn[0, k], pose.turn[1, k], pose.turn[2, k])
            write_rows(robots.gamma, b, platform, platform + k, zero, zero)
            write_rows(
                robots.gamma, b, platform, platform + 3 + k, -pull * wp.cross(turn, follower_force), bent * (turned * turn)
            )
    for k in range(robots.direction_count):
        dn = zero
        dm = zero
        for leg in range(legs):
            if k >= robots.leg_direction_count:
                break
            q = b * legs + leg
            dn += vector(robots.law, q, wp.static(DIRECTIONS_AT) + 6 * k)
            dm += vector(robots.law, q, wp.static(DIRECTIONS_AT) + 6 * k + 3)
        move, turn = pose_direction(robots, b, k, pose)
        dm += turned * turn
        dn -= wp.cross(turn, follower_force)
        push = direction(robots, b, k, first) + pose.rotation * direction(robots, b, k, first + 6)
        heave = robots.mass * direction(robots, b, k, gravity)
        dn -= push + heave
        dm -= direction(robots, b, k, first + 3) + pose.rotation * direction(robots, b, k, first + 9)
        dm -= wp.cross(point, push) + wp.cross(centre, heave)
        dm -= wp.cross(pose.rotation * direction(robots, b, k, first + 12), pushed)
        write_rows(robots.residual_directions, b, platform, k, pull * dn, bent * dm)
        if robots.pose_columns.shape[2] > 1:
            write_rows(robots.pose_columns, b, 0, robots.unknown_count + k, move, turn)
    if robots.pose_columns.shape[2] > 1 and robots.inverse == 0:
        for k in range(3):
            move = zero
            move[k] = pose.length * pose.length
            turn = pose.length * wp.vec3d(pose.turn[0, k], pose.turn[1, k], pose.turn[2, k])
            write_rows(robots.pose_columns, b, 0, platform + k, move, zero)
            write_rows(robots.pose_columns, b, 0, platform + 3 + k, zero, turn)
