# mypy: ignore-errors
"""What couples rods that hold one platform: joints, and the equilibrium of the platform.

Numbers in parentheses are those of ``docs/parallel.md``. The legs are integrated by the backbone kernels, many at a time;
around each such launch stand ``hand_over`` (unknowns and inputs of the robots to their legs), ``attach`` (pose and wrench of
each leg's tip to the residual of its joint) and ``balance`` (the platform).
"""

import warp as wp

from multirod.kernels.problem_arrays import ProblemArrays
from multirod.models.backbone.kernels.layout.arguments import TipWrench
from multirod.models.backbone.kernels.numbers.scalars import turned_about_z
from multirod.models.joint_kernels import (
    SOFT,
    Joint,
    along,
    column,
    column_of,
    joint_at,
    joint_rows,
    joint_rows_variation,
    load_level,
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
FORCE_AT, MOMENT_AT = 0, 3
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
    problem: ProblemArrays
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
    problem: ProblemArrays
    wrench: TipWrench


@wp.func
def length_of(robots: Robots, b: int, leg: int) -> f64:
    """Length scale of a leg, or of the platform."""
    return robots.length[b * robots.stride, leg]


@wp.func
def stiffness_of(robots: Robots, b: int, leg: int) -> f64:
    """Stiffness scale of a leg, or of the platform."""
    return robots.stiffness[b * robots.stride, leg]


@wp.kernel(enable_backward=False)
def hand_over(robots: Robots, legs: Legs):
    """Unknowns, inputs and directions of the robots to their legs."""
    t = legs.problem.order[wp.tid()]
    b = t // legs.count
    place = t % legs.count
    legs.problem.active[t] = robots.problem.active[b]
    if robots.problem.active[b] == 0:
        return
    leg = legs.leg[place]
    legs.problem.load_factor[t] = load_level(robots.loading[b], robots.problem.load_factor[b])
    for i in range(legs.unknown_count):
        legs.problem.unknowns[t, i] = robots.problem.unknowns[b, legs.first_unknown[place] + i]
    for i in range(legs.rods):
        rod = legs.first_rod[place] + i
        legs.problem.inputs[t, i] = robots.problem.inputs[b, rod]
        legs.problem.inputs[t, legs.rods + i] = robots.problem.inputs[b, robots.rod_count + rod]
        for k in range(robots.leg_direction_count):
            legs.problem.directions[t, k, i] = robots.problem.directions[b, k, rod]
            legs.problem.directions[t, k, legs.rods + i] = robots.problem.directions[b, k, robots.rod_count + rod]
    for i in range(wp.static(3 * len(LEG_VECTORS))):
        legs.problem.inputs[t, legs.vectors + i] = robots.problem.inputs[b, robots.leg_vectors + i]
        for k in range(robots.leg_direction_count):
            legs.problem.directions[t, k, legs.vectors + i] = robots.problem.directions[b, k, robots.leg_vectors + i]
    for i in range(legs.drive.shape[1]):
        drive = legs.drive[place, i]
        legs.problem.inputs[t, legs.drives + i] = robots.problem.inputs[b, drive]
        for k in range(robots.leg_direction_count):
            legs.problem.directions[t, k, legs.drives + i] = robots.problem.directions[b, k, drive]
    if robots.inverse != 0:
        # (10) the unknown translation, and its own column
        L = length_of(robots, b, leg)
        x = robots.problem.unknowns[b, robots.unknown_count - wp.static(POSE) + leg]
        legs.problem.inputs[t, legs.rods] = legs.problem.inputs[t, legs.rods] + L * L * x
        legs.problem.directions[t, robots.leg_direction_count, legs.rods] = L * L


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
        pose.position = vector(robots.problem.inputs, b, robots.pose)
        a = vector(robots.problem.inputs, b, robots.pose + 3)
        pose.rotation = rotation_from_vector(a)
        pose.turn = left_jacobian(a)
        return pose
    first = robots.unknown_count - wp.static(POSE)
    pose.position = robots.reference_position[b * robots.stride] + pose.length * pose.length * vector(
        robots.problem.unknowns, b, first
    )
    a = pose.length * vector(robots.problem.unknowns, b, first + 3)
    pose.rotation = rotation_from_vector(a) * robots.reference_rotation[b * robots.stride]
    pose.turn = left_jacobian(a)
    return pose


@wp.func
def pose_direction(robots: Robots, b: int, k: int, pose: Platform):
    """Change of the pose with direction k at fixed unknowns: what the inverse problem is given."""
    move = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    turn = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    if robots.inverse != 0:
        move = along(robots.problem.directions, b, k, robots.pose)
        turn = pose.turn * along(robots.problem.directions, b, k, robots.pose + 3)
    return move, turn


@wp.func
def load_joint(robots: Robots, legs: Legs, t: int, b: int, leg: int, pose: Platform) -> Joint:
    """A joint as it stands."""
    g = b * robots.stride
    frame = pose.rotation * robots.attachment_rotation[g, leg]
    joint = joint_at(robots.joint[leg], robots.axis[leg], frame, legs.problem.rotation[t], vector(legs.wrench.values, t, 3))
    joint.arm = pose.rotation * robots.attachment_position[g, leg]
    joint.length = length_of(robots, b, leg)
    joint.curvature = f64(1.0) / stiffness_of(robots, b, leg)
    return joint


@wp.kernel(enable_backward=False)
def attach(robots: Robots, legs: Legs):
    """(4) to (7): residual of each leg's joint, its columns, and what the leg does to the platform."""
    t = legs.problem.order[wp.tid()]
    b = t // legs.count
    if robots.problem.active[b] == 0:
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
    force = vector(legs.wrench.values, t, 0)
    moment = vector(legs.wrench.values, t, 3)

    gap = to_gap * (legs.problem.position[t] - pose.position - joint.arm)
    rows = joint_rows(joint)
    open = f64(1.0) - robots.problem.load_factor[b]
    give = f64(wp.static(SOFT)) * open * robots.soft[b]  # (9b)
    turned = turned_about_z(legs.problem.inputs[t, 0])
    gap += give * (turned * vector(legs.problem.unknowns, t, m - 3))
    for j in range(3):
        robots.problem.residual[b, first + j] = gap[j] - open * robots.opening[b, first + j]
        robots.problem.residual[b, first + 3 + j] = rows[j] - open * robots.opening[b, first + 3 + j]
    for i in range(wp.static(POSE), m):
        robots.problem.residual[b, first + i] = legs.problem.residual[t, i] - open * robots.opening[b, first + i]

    bent = f64(1.0) / stiffness_of(robots, b, robots.leg_count)
    pull = pose.length * bent
    extra = robots.leg_direction_count
    if robots.inverse != 0:
        extra += 1
    for k in range(m + extra):
        dp = column(legs.problem.pose_columns, t, 0, k)
        tip_turn = column(legs.problem.pose_columns, t, 3, k)
        dn = column(legs.wrench.columns, t, 0, k)
        dm = column(legs.wrench.columns, t, 3, k)
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
            write_rows(robots.problem.gamma, b, first, first + k, gap, rows)
            write_rows(robots.problem.gamma, b, platform, first + k, push, twist)
            for i in range(wp.static(POSE), m):
                robots.problem.gamma[b, first + i, first + k] = legs.problem.gamma[t, i, k]
        elif k - m < robots.leg_direction_count:
            write_rows(robots.problem.residual_directions, b, first, k - m, gap, rows)
            for i in range(wp.static(POSE), m):
                robots.problem.residual_directions[b, first + i, k - m] = legs.problem.residual_directions[t, i, k - m]
        else:
            write_rows(robots.problem.gamma, b, first, platform + leg, gap, rows)
            write_rows(robots.problem.gamma, b, platform, platform + leg, push, twist)
            for i in range(wp.static(POSE), m):
                robots.problem.gamma[b, first + i, platform + leg] = legs.problem.residual_directions[t, i, k - m]
    for k in range(robots.leg_direction_count, robots.direction_count):
        move, turn = pose_direction(robots, b, k, pose)
        gap = -(to_gap * (move + wp.cross(turn, joint.arm)))
        write_rows(robots.problem.residual_directions, b, first, k, gap, joint_rows_variation(joint, zero, turn, zero, moment))
        for i in range(wp.static(POSE), m):
            robots.problem.residual_directions[b, first + i, k] = f64(0.0)
    if robots.inverse == 0:
        for k in range(3):
            move = zero
            move[k] = pose.length * pose.length
            turn = pose.length * wp.vec3d(pose.turn[0, k], pose.turn[1, k], pose.turn[2, k])
            write_rows(robots.problem.gamma, b, first, platform + k, -(to_gap * move), zero)
            rows = joint_rows_variation(joint, zero, turn, zero, moment)
            write_rows(robots.problem.gamma, b, first, platform + 3 + k, -(to_gap * wp.cross(turn, joint.arm)), rows)

    q = b * robots.leg_count + leg
    total = moment + wp.cross(joint.arm, force)
    turned = wp.skew(force) * wp.skew(joint.arm)  # (turn x arm) x force = turned turn
    for j in range(3):
        robots.law[q, wp.static(FORCE_AT) + j] = force[j]
        robots.law[q, wp.static(MOMENT_AT) + j] = total[j]
        for k in range(3):
            robots.law[q, wp.static(TURN_AT) + 3 * j + k] = turned[j, k]
    for k in range(robots.leg_direction_count):
        dn = column(legs.wrench.columns, t, 0, m + k)
        dm = column(legs.wrench.columns, t, 3, m + k)
        dm += wp.cross(joint.arm, dn)
        for j in range(3):
            robots.law[q, wp.static(DIRECTIONS_AT) + 6 * k + j] = dn[j]
            robots.law[q, wp.static(DIRECTIONS_AT) + 6 * k + 3 + j] = dm[j]
    robots.leg_fault[q] = legs.problem.fault[t]
    robots.leg_step_count[q] = legs.problem.step_count[t]


@wp.kernel(enable_backward=False)
def balance(robots: Robots):
    """(8): equilibrium of each platform, with its columns; and its pose."""
    b = robots.problem.order[wp.tid()]
    if robots.problem.active[b] == 0:
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

    load = load_level(robots.loading[b], robots.problem.load_factor[b])
    open = f64(1.0) - robots.problem.load_factor[b]
    first = robots.loads
    tip_force = load * vector(robots.problem.inputs, b, first)
    tip_moment = load * vector(robots.problem.inputs, b, first + 3)
    follower_force = load * (pose.rotation * vector(robots.problem.inputs, b, first + 6))
    follower_moment = load * (pose.rotation * vector(robots.problem.inputs, b, first + 9))
    point = pose.rotation * vector(robots.problem.inputs, b, first + 12)
    gravity = robots.leg_vectors + 6
    weight = (load * robots.mass) * vector(robots.problem.inputs, b, gravity)
    centre = pose.rotation * robots.mass_centre
    pushed = tip_force + follower_force
    force -= pushed + weight
    moment -= tip_moment + follower_moment + wp.cross(point, pushed) + wp.cross(centre, weight)
    for j in range(3):
        robots.problem.residual[b, platform + j] = pull * force[j] - open * robots.opening[b, platform + j]
        robots.problem.residual[b, platform + 3 + j] = bent * moment[j] - open * robots.opening[b, platform + 3 + j]
        total += wp.abs(force[j]) + wp.abs(moment[j])
    if not wp.isfinite(total) and fault == 0:
        fault = int(1)
    robots.problem.fault[b] = fault
    robots.problem.step_count[b] = steps
    robots.problem.position[b] = pose.position
    robots.problem.rotation[b] = pose.rotation

    # change of loads that act at points of the platform, or turn with it, by its rotation vector
    turned -= wp.skew(pushed) * wp.skew(point) + wp.skew(weight) * wp.skew(centre)
    turned += wp.skew(follower_moment) + wp.skew(point) * wp.skew(follower_force)
    for k in range(3):
        if robots.inverse == 0:
            turn = pose.length * wp.vec3d(pose.turn[0, k], pose.turn[1, k], pose.turn[2, k])
            write_rows(robots.problem.gamma, b, platform, platform + k, zero, zero)
            write_rows(
                robots.problem.gamma,
                b,
                platform,
                platform + 3 + k,
                -pull * wp.cross(turn, follower_force),
                bent * (turned * turn),
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
        push = along(robots.problem.directions, b, k, first) + pose.rotation * along(robots.problem.directions, b, k, first + 6)
        heave = robots.mass * along(robots.problem.directions, b, k, gravity)
        dn -= push + heave
        dm -= along(robots.problem.directions, b, k, first + 3) + pose.rotation * along(
            robots.problem.directions, b, k, first + 9
        )
        dm -= wp.cross(point, push) + wp.cross(centre, heave)
        dm -= wp.cross(pose.rotation * along(robots.problem.directions, b, k, first + 12), pushed)
        write_rows(robots.problem.residual_directions, b, platform, k, pull * dn, bent * dm)
        if robots.problem.pose_columns.shape[2] > 1:
            write_rows(robots.problem.pose_columns, b, 0, robots.unknown_count + k, move, turn)
    if robots.problem.pose_columns.shape[2] > 1 and robots.inverse == 0:
        for k in range(3):
            move = zero
            move[k] = pose.length * pose.length
            turn = pose.length * wp.vec3d(pose.turn[0, k], pose.turn[1, k], pose.turn[2, k])
            write_rows(robots.problem.pose_columns, b, 0, platform + k, move, zero)
            write_rows(robots.problem.pose_columns, b, 0, platform + 3 + k, zero, turn)
