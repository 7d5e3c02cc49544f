# mypy: ignore-errors
"""What holds a rod at both ends: the pose of its end, joints there and at its base.

Numbers in parentheses are those of ``docs/held.md``. The rod is integrated by the backbone kernels; around that launch stand
``hand_over`` (unknowns and inputs to the rod) and ``hold`` (pose and wrench of its tip to the residual).
"""

import warp as wp

from multirod.kernels.problem_arrays import ProblemArrays
from multirod.models.backbone.kernels.layout.arguments import TipWrench
from multirod.models.joint_kernels import (
    CLAMPED,
    Joint,
    along,
    column,
    joint_at,
    joint_rows,
    joint_rows_variation,
    vector,
    write_rows,
)
from multirod.models.rotation_kernels import left_jacobian, rotation_from_vector

f64 = wp.float64

POSE = 6  # residuals of the end's joint
ON_AXIS = 1e-9  # what counts as on an axis, in lengths, and along it
ACROSS = 1e-6  # turn of the end across the axis of the base from which on it says where the rod bends [rad]
SOFT = 0.025  # of forces and moments in EI/L^2 and EI/L, by which a neutral turn is held: then it is as stiff as others
IN_BALLS, ROUND_IN_BALLS, BALL_AND_CLAMP = 1, 2, 3  # (24) rods in two balls, such ones that are alike about themselves, in one
ALONG = ("distributed_force", "distributed_moment", "gravity", "magnetic_field")  # as they stand in a row of a rod's inputs


@wp.struct
class Held:
    """Rods that are held at both ends; the first axis is the instance."""

    unknown_count: int
    rod_unknowns: int  # the first of them
    turns: int  # the last of them: angles of the base in its joint
    direction_count: int
    rod_inputs: int  # of a row, the scale of load profiles left out: they stand first in a row of this
    along: int  # where ALONG begin
    tip_loads: int  # tip_force, then tip_moment
    pose: int  # end_position, then end_rotation
    problem: ProblemArrays
    # geometry
    base_frame: wp.array[wp.mat33d]  # of the base's holder
    end_position: wp.array[wp.vec3d]  # of the end's holder where its inputs are zero
    end_frame: wp.array[wp.mat33d]
    rest_position: wp.array[wp.vec3d]  # of the end of the rod at rest
    rest_turn: wp.array[wp.vec3d]  # (2) rotation vector from there to end_frame
    length: wp.array[wp.float64]  # scales
    stiffness: wp.array[wp.float64]
    moment_unit: wp.array[wp.vec3d]  # curvature per base moment
    base_curvature: wp.array[wp.vec3d]  # where that is zero
    joint: int
    axis: wp.vec3d  # of a revolute joint, in the frame of the end's holder
    slides: int
    guide: wp.mat33d  # two directions across the one in which the end slides, then that one, in its holder's frame
    base_axes: wp.array[wp.vec3d]  # (turns,): of the base's joint, in its holder's frame
    opening: wp.array2d[wp.float64]  # residual of the rod at rest where the path begins
    direct: wp.array[int]  # whether the end's holder is where it is to be all along the path
    alike: wp.array[int]  # whether the rod is the same about its axis, whatever holds its end
    neutral: wp.array[int]  # whether a turn about the base's axis costs nothing
    clamped: int  # whether clamps tell of that turn, and (11) need not hold it
    balls: wp.array[int]  # (24) which turns of a rod whose base is in a ball cost nothing where no load acts
    rod: ProblemArrays  # as a backbone whose tip is held
    wrench: TipWrench
    base_position: wp.array[wp.vec3d]
    base_rotation: wp.array[wp.mat33d]  # the base's holder, turned in its joint


@wp.func
def turn_of(held: Held, b: int) -> wp.vec3d:
    """(8) Rotation vector by which the base is turned in its joint, in the frame of its holder."""
    a = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    for j in range(held.turns):
        a += (held.length[b] * held.problem.unknowns[b, held.rod_unknowns + j]) * held.base_axes[j]
    return a


@wp.func
def turn_axis(held: Held, b: int, j: int) -> wp.vec3d:
    """(8) Rotation vector of the rod by unknown j of its base's joint, in the world."""
    return held.length[b] * (held.base_frame[b] * (left_jacobian(turn_of(held, b)) * held.base_axes[j]))


@wp.func
def on_axis(held: Held, b: int) -> bool:
    """(10) Whether the end is to be held on the axis of the base and along it."""
    axis = held.base_frame[b] * wp.vec3d(f64(0.0), f64(0.0), f64(1.0))
    away = held.end_position[b] + vector(held.problem.inputs, b, held.pose) - held.base_position[b]
    frame = rotation_from_vector(vector(held.problem.inputs, b, held.pose + 3)) * held.end_frame[b]
    tangent = wp.vec3d(frame[0, 2], frame[1, 2], frame[2, 2])
    off = wp.max(wp.length(wp.cross(axis, away)) / held.length[b], wp.length(wp.cross(axis, tangent)))
    return off < f64(wp.static(ON_AXIS))


@wp.func
def is_neutral(held: Held, b: int) -> bool:
    """(10) The same of a rod that is alike about it."""
    return held.alike[b] != 0 and on_axis(held, b)


@wp.func
def base_moment(held: Held, b: int) -> wp.vec3d:
    """(6) Moment at the base, in the frame of the base."""
    return held.stiffness[b] * vector(held.problem.unknowns, b, 0)


@wp.func
def base_turn(held: Held, b: int) -> wp.vec2d:
    """Cosine and sine of the angle of the rod at its base."""
    angle = held.problem.load_factor[b] * held.problem.inputs[b, 0]
    return wp.vec2d(wp.cos(angle), wp.sin(angle))


@wp.func
def turned_back(held: Held, b: int, v: wp.vec3d) -> wp.vec3d:
    """From the frame of the base to that of the rod there."""
    turn = base_turn(held, b)
    return wp.vec3d(turn[0] * v[0] + turn[1] * v[1], turn[0] * v[1] - turn[1] * v[0], v[2])


@wp.kernel(module="unique", enable_backward=False)
def hand_over(held: Held):
    """Unknowns, inputs and directions to the rod, and its base as it is turned."""
    b = held.problem.order[wp.tid()]
    held.rod.active[b] = held.problem.active[b]
    if held.problem.active[b] == 0:
        return
    held.neutral[b] = int(is_neutral(held, b))
    path = held.problem.load_factor[b]
    held.rod.load_factor[b] = path
    for i in range(3, held.rod_unknowns - 3):
        held.rod.unknowns[b, i] = held.problem.unknowns[b, i]
    # (6) the rod's own turn with it
    M = turned_back(held, b, base_moment(held, b))
    N = turned_back(held, b, vector(held.problem.unknowns, b, held.rod_unknowns - 3))
    for j in range(3):
        held.rod.unknowns[b, j] = held.base_curvature[b][j] + held.moment_unit[b][j] * M[j]
        held.rod.unknowns[b, held.rod_unknowns - 3 + j] = N[j]
    held.rod.inputs[b, 0] = path * held.problem.inputs[b, 0]
    held.rod.inputs[b, 1] = held.problem.inputs[b, 1]
    for i in range(held.along, held.rod_inputs):
        held.rod.inputs[b, i] = held.problem.inputs[b, i]
    scale = held.problem.inputs.shape[1] - 1
    held.rod.inputs[b, held.rod_inputs] = held.problem.inputs[b, scale]
    for k in range(held.direction_count):
        held.rod.directions[b, k, 0] = path * held.problem.directions[b, k, 0]
        held.rod.directions[b, k, 1] = held.problem.directions[b, k, 1]
        for i in range(held.along, held.rod_inputs):
            held.rod.directions[b, k, i] = held.problem.directions[b, k, i]
        held.rod.directions[b, k, held.rod_inputs] = held.problem.directions[b, k, scale]
    held.base_rotation[b] = held.base_frame[b] * rotation_from_vector(turn_of(held, b))
    for j in range(held.turns):
        axis = turn_axis(held, b, j)
        for i in range(wp.static(len(ALONG))):
            first = held.along + 3 * i
            turned = wp.cross(axis, vector(held.problem.inputs, b, first))
            for c in range(3):
                # (9) the base turned back: what acts along the rod turns instead
                held.rod.directions[b, held.direction_count + j, first + c] = -path * turned[c]


@wp.struct
class End:
    """Pose of what holds the end, in the world."""

    position: wp.vec3d
    rotation: wp.mat33d
    turn: wp.mat33d  # rotation vector, in the world, by end_rotation


@wp.func
def end_pose(held: Held, b: int) -> End:
    """(1), (2) The pose on the way from that of the rod at rest."""
    end = End()
    path = wp.where(held.direct[b] != 0, f64(1.0), held.problem.load_factor[b])
    rest = path - f64(1.0)
    goal = held.end_position[b] + vector(held.problem.inputs, b, held.pose)
    end.position = goal + rest * (goal - held.rest_position[b])
    a = path * vector(held.problem.inputs, b, held.pose + 3)
    end.rotation = rotation_from_vector(a) * (rotation_from_vector(rest * held.rest_turn[b]) * held.end_frame[b])
    end.turn = path * left_jacobian(a)
    return end


@wp.func
def write_entry(held: Held, b: int, row: int, k: int, value: f64):
    """One number of Gamma, or, past its columns, of the residual's derivative by a direction; k as for a rod's columns."""
    if k < held.rod_unknowns:
        held.problem.gamma[b, row, k] = value
    elif k < held.rod_unknowns + held.direction_count:
        held.problem.residual_directions[b, row, k - held.rod_unknowns] = value
    else:
        held.problem.gamma[b, row, k - held.direction_count] = value


@wp.func
def phase_of(held: Held, b: int) -> wp.vec3d:
    """(11) Across the axis about which the rod is to bend, in the frame of the base: there is to be no moment."""
    turn = wp.transpose(held.base_frame[b]) * (vector(held.problem.inputs, b, held.pose + 3) + held.rest_turn[b])
    across = wp.vec3d(turn[1], -turn[0], f64(0.0))
    size = wp.length(across)
    if size > f64(wp.static(ACROSS)):
        return across / size
    return wp.vec3d(f64(1.0), f64(0.0), f64(0.0))


@wp.struct
class Phase:
    """(11) What stands in the residual for the turn about the axis of the base that costs nothing."""

    axis: wp.vec3d
    across: wp.vec3d
    lag: f64
    pull: wp.vec3d  # rows of the residual that it leaves
    twist: wp.vec3d


@wp.func
def phase_rows(held: Held, b: int, joint: Joint, to_guide: wp.mat33d, dn: wp.vec3d, dm: wp.vec3d):
    """(11) A force and a moment on the tip as rows."""
    size = f64(wp.static(SOFT)) * joint.length * joint.curvature
    pull = (joint.length * size) * (to_guide * dn)
    if held.slides != 0:
        pull[2] = f64(0.0)
    twist = size * (wp.transpose(joint.tip) * dm)
    if joint.kind != wp.static(CLAMPED):
        twist = f64(0.0) * twist
    return pull, twist


@wp.func
def to_unknowns(held: Held, b: int, values: wp.array3d[wp.float64], others: wp.array3d[wp.float64], first: int, row: int):
    """(6) A row of columns by the unknowns of the rod, as by those of this; directions stand in ``others`` from ``first`` on."""
    turn = base_turn(held, b)
    M = turned_back(held, b, base_moment(held, b))
    n = held.rod_unknowns - 3
    N = turned_back(held, b, vector(held.problem.unknowns, b, n))
    unit = held.moment_unit[b]
    by_moment = wp.vec3d(values[b, row, 0] * unit[0], values[b, row, 1] * unit[1], values[b, row, 2] * unit[2])
    by_force = wp.vec3d(values[b, row, n], values[b, row, n + 1], values[b, row, n + 2])
    for k in range(held.direction_count):
        rate = held.problem.load_factor[b] * held.problem.directions[b, k, 0]
        change = by_moment[0] * M[1] - by_moment[1] * M[0] + by_force[0] * N[1] - by_force[1] * N[0]
        others[b, row, first + k] = others[b, row, first + k] + rate * change
    values[b, row, 0] = held.stiffness[b] * (turn[0] * by_moment[0] - turn[1] * by_moment[1])
    values[b, row, 1] = held.stiffness[b] * (turn[1] * by_moment[0] + turn[0] * by_moment[1])
    values[b, row, 2] = held.stiffness[b] * by_moment[2]
    values[b, row, n] = turn[0] * by_force[0] - turn[1] * by_force[1]
    values[b, row, n + 1] = turn[1] * by_force[0] + turn[0] * by_force[1]


@wp.struct
class Tip:
    """The tip of a rod as what holds the end sees it."""

    end: End
    joint: Joint
    to_guide: wp.mat33d
    apart: wp.vec3d
    force: wp.vec3d  # that the rod carries there, less what acts on the tip, in the world
    moment: wp.vec3d
    neutral: int
    phase: Phase


@wp.func
def tip_of(held: Held, b: int, neutral: bool, position: wp.vec3d, rotation: wp.mat33d, force: wp.vec3d, moment: wp.vec3d) -> Tip:
    """A tip of this pose, at which the rod carries this force and moment, all in the world."""
    tip = Tip()
    path = held.problem.load_factor[b]
    tip.end = end_pose(held, b)
    tip.force = force - path * vector(held.problem.inputs, b, held.tip_loads)
    tip.moment = moment - path * vector(held.problem.inputs, b, held.tip_loads + 3)
    tip.joint = joint_at(held.joint, held.axis, tip.end.rotation, rotation, tip.moment)
    tip.joint.length = held.length[b]
    tip.joint.curvature = f64(1.0) / held.stiffness[b]
    tip.to_guide = wp.transpose(tip.end.rotation * held.guide)
    tip.apart = position - tip.end.position
    tip.neutral = int(neutral)
    if neutral:
        tip.phase.axis = held.base_frame[b] * wp.vec3d(f64(0.0), f64(0.0), f64(1.0))
        tip.phase.across = phase_of(held, b)
        tip.phase.lag = tip.joint.curvature * wp.dot(tip.phase.across, base_moment(held, b))
        pulled = wp.cross(tip.phase.axis, tip.force)
        twisted = wp.cross(tip.phase.axis, tip.moment)
        by_pull, by_twist = phase_rows(held, b, tip.joint, tip.to_guide, pulled, twisted)
        tip.phase.pull = by_pull
        tip.phase.twist = by_twist
    return tip


@wp.func
def tip_rows(held: Held, b: int, tip: Tip):
    """(5), (7), (11): the residuals at the end, those of its position first."""
    L = held.length[b]
    gap = tip.to_guide * (tip.apart / (L * L))
    pull = (L * tip.joint.curvature) * (tip.to_guide * tip.force)
    if held.slides != 0:
        gap[2] = pull[2]
    rows = joint_rows(tip.joint)
    if tip.neutral != 0:
        gap += tip.phase.lag * tip.phase.pull
        rows += tip.phase.lag * tip.phase.twist
    return gap, rows


@wp.func
def tip_rows_variation(
    held: Held, b: int, tip: Tip, d: int, dp: wp.vec3d, tip_turn: wp.vec3d, dn: wp.vec3d, dm: wp.vec3d, db: wp.vec3d
):
    """(5), (7), (11): their change where the tip moves and turns, force and moment there and the moment at the base ``db``
    change, and, unless d is negative, along direction d."""
    L = held.length[b]
    bent = tip.joint.curvature
    path = held.problem.load_factor[b]
    move = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    turn = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    if d >= 0:
        move = path * along(held.problem.directions, b, d, held.pose)
        turn = tip.end.turn * along(held.problem.directions, b, d, held.pose + 3)
        dn -= path * along(held.problem.directions, b, d, held.tip_loads)
        dm -= path * along(held.problem.directions, b, d, held.tip_loads + 3)
    shift = tip.to_guide * ((dp - move - wp.cross(turn, tip.apart)) / (L * L))
    if held.slides != 0:
        push = (L * bent) * (tip.to_guide * (dn - wp.cross(turn, tip.force)))
        shift[2] = push[2]
    change = joint_rows_variation(tip.joint, tip_turn, turn, dm, tip.moment)
    if tip.neutral != 0:
        lags = bent * wp.dot(tip.phase.across, db)
        by_force = wp.cross(tip.phase.axis, dn) - wp.cross(turn, wp.cross(tip.phase.axis, tip.force))
        by_moment = wp.cross(tip.phase.axis, dm) - wp.cross(tip_turn, wp.cross(tip.phase.axis, tip.moment))
        more, twist = phase_rows(held, b, tip.joint, tip.to_guide, by_force, by_moment)
        shift += lags * tip.phase.pull + tip.phase.lag * more
        change += lags * tip.phase.twist + tip.phase.lag * twist
    return shift, change


@wp.func
def balls_at(held: Held, b: int, away: wp.vec3d) -> int:
    """(24) Which turns cost nothing, its end's holder ``away`` from its base."""
    kind = held.balls[b]
    if kind == 0:
        return 0
    acting = f64(0.0)
    for i in range(3):
        acting += wp.abs(held.problem.inputs[b, held.tip_loads + 3 + i])
    for i in range(wp.static(3 * len(ALONG))):
        acting += wp.abs(held.problem.inputs[b, held.along + i])
    if acting != f64(0.0) or wp.length(away) < f64(wp.static(ON_AXIS)) * held.length[b]:
        return 0
    if kind == wp.static(BALL_AND_CLAMP) and not on_axis(held, b):
        return 0
    if held.clamped != 0 and kind == wp.static(ROUND_IN_BALLS):
        return wp.static(IN_BALLS)
    return kind


@wp.struct
class Spin:
    """(24) What stands in the rows of a ball at the base for turns that cost nothing."""

    kind: int
    apart: f64
    chord: wp.vec3d  # from base to end, in the frame of the base's holder
    angle: wp.vec3d  # rotation vector of the base
    turned: wp.vec3d  # what a moment about the chord turns it by
    lag: f64
    fall: f64


@wp.func
def inverse_factors(angle: f64) -> wp.vec2d:
    """Of ``a x (a x e)`` in ``J^-1(a) e``, and its rate by the angle over that."""
    square = angle * angle
    if square < f64(1e-4):
        return wp.vec2d(f64(1.0 / 12.0) + square / f64(720.0), f64(1.0 / 360.0) + square / f64(7560.0))
    half = f64(0.5) * angle
    cot = wp.cos(half) / wp.sin(half)
    factor = f64(1.0) / square - cot / (f64(2.0) * angle)
    rate = -f64(2.0) / (square * angle) + cot / (f64(2.0) * square) + f64(0.25) / (angle * wp.sin(half) * wp.sin(half))
    return wp.vec2d(factor, rate / angle)


@wp.func
def turned_by(a: wp.vec3d, e: wp.vec3d) -> wp.vec3d:
    """``J^-1(a) e``"""
    factor = inverse_factors(wp.length(a))
    across = wp.cross(a, e)
    return e - f64(0.5) * across + factor[0] * wp.cross(a, across)


@wp.func
def turned_by_variation(a: wp.vec3d, e: wp.vec3d, da: wp.vec3d) -> wp.vec3d:
    factor = inverse_factors(wp.length(a))
    across = wp.cross(a, e)
    dacross = wp.cross(da, e)
    more = factor[0] * (wp.cross(da, across) + wp.cross(a, dacross))
    return more - f64(0.5) * dacross + (factor[1] * wp.dot(a, da)) * wp.cross(a, across)


@wp.func
def spin_of(held: Held, b: int, away: wp.vec3d) -> Spin:
    spin = Spin()
    spin.kind = balls_at(held, b, away)
    if spin.kind != 0:
        spin.apart = wp.length(away)
        spin.chord = wp.transpose(held.base_frame[b]) * (away / spin.apart)
        spin.angle = turn_of(held, b)
        spin.turned = turned_by(spin.angle, spin.chord)
        spin.lag = wp.dot(spin.chord, spin.angle) / held.length[b]
        spin.fall = spin.angle[0] / held.length[b]
    return spin


@wp.func
def spin_rows(spin: Spin, turned: wp.vec3d, lag: f64, fall: f64) -> wp.vec3d:
    """(24)"""
    along = wp.vec3d(f64(0.0), f64(0.0), f64(1.0))
    if spin.kind == wp.static(BALL_AND_CLAMP):
        return fall * (turned - along)
    if spin.kind == wp.static(ROUND_IN_BALLS):
        return lag * turned + fall * along
    return lag * turned


@wp.func
def spin_rows_variation(held: Held, b: int, spin: Spin, da: wp.vec3d, move: wp.vec3d) -> wp.vec3d:
    """(24) Their change where the rotation vector of the base changes by ``da``, over the length, and the end's holder moves."""
    own = wp.transpose(held.base_frame[b]) * move
    dchord = (own - wp.dot(spin.chord, own) * spin.chord) / spin.apart
    dturned = turned_by(spin.angle, dchord) + turned_by_variation(spin.angle, spin.chord, held.length[b] * da)
    dlag = wp.dot(dchord, spin.angle) / held.length[b] + wp.dot(spin.chord, da)
    change = spin_rows(spin, spin.turned, dlag, da[0])
    if spin.kind == wp.static(BALL_AND_CLAMP):
        return change + spin.fall * dturned
    return change + spin.lag * dturned


@wp.kernel(module="unique", enable_backward=False)
def hold(held: Held):
    """(5), (7), (8), (11): the residual with its columns, and the pose of the tip with them."""
    b = held.problem.order[wp.tid()]
    if held.problem.active[b] == 0:
        return
    zero = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    open = f64(1.0) - held.problem.load_factor[b]
    m = held.rod_unknowns
    for i in range(wp.static(POSE)):
        to_unknowns(held, b, held.rod.pose_columns, held.rod.pose_columns, m, i)
        to_unknowns(held, b, held.wrench.columns, held.wrench.columns, m, i)
    for i in range(wp.static(POSE), m):
        to_unknowns(held, b, held.rod.gamma, held.rod.residual_directions, 0, i)
    bent = f64(1.0) / held.stiffness[b]
    force, moment = vector(held.wrench.values, b, 0), vector(held.wrench.values, b, 3)
    tip = tip_of(held, b, held.neutral[b] > held.clamped, held.rod.position[b], held.rod.rotation[b], force, moment)
    gap, rows = tip_rows(held, b, tip)
    total = f64(0.0)
    for j in range(3):
        held.problem.residual[b, j] = gap[j] - open * held.opening[b, j]
        held.problem.residual[b, 3 + j] = rows[j] - open * held.opening[b, 3 + j]
        total += wp.abs(gap[j]) + wp.abs(rows[j])
    for i in range(wp.static(POSE), m):
        held.problem.residual[b, i] = held.rod.residual[b, i] - open * held.opening[b, i]
    spin = spin_of(held, b, tip.end.position - held.base_position[b])
    spun = zero
    if spin.kind != 0:
        spun = spin_rows(spin, spin.turned, spin.lag, spin.fall)
    for j in range(held.turns):
        row = bent * base_moment(held, b) - spun
        held.problem.residual[b, m + j] = wp.dot(held.base_axes[j], row) - open * held.opening[b, m + j]

    for k in range(m + held.direction_count + held.turns):
        dp = column(held.rod.pose_columns, b, 0, k)
        tip_turn = column(held.rod.pose_columns, b, 3, k)
        dn = column(held.wrench.columns, b, 0, k)
        dm = column(held.wrench.columns, b, 3, k)
        d = int(-1)
        spun = zero
        if k >= m + held.direction_count:
            # (9) the rod turns with its base as one
            a = turn_axis(held, b, k - m - held.direction_count)
            if spin.kind != 0:
                spun = spin_rows_variation(held, b, spin, held.base_axes[k - m - held.direction_count], zero)
            dp += wp.cross(a, held.rod.position[b] - held.base_position[b])
            tip_turn += a
            dn += wp.cross(a, force)
            dm += wp.cross(a, moment)
        elif k >= m:
            d = k - m
            if spin.kind != 0:
                move = held.problem.load_factor[b] * along(held.problem.directions, b, d, held.pose)
                spun = spin_rows_variation(held, b, spin, zero, move)
        if held.problem.pose_columns.shape[2] > 1:
            place = k
            if k >= m + held.direction_count:
                place = k - held.direction_count
            elif k >= m:
                place = k + held.turns
            write_rows(held.problem.pose_columns, b, 0, place, dp, tip_turn)
        db = zero
        if k < 3:
            db[k] = held.stiffness[b]
        shift, change = tip_rows_variation(held, b, tip, d, dp, tip_turn, dn, dm, db)
        for j in range(3):
            write_entry(held, b, j, k, shift[j])
            write_entry(held, b, 3 + j, k, change[j])
        for i in range(wp.static(POSE), m):
            if k < m:
                held.problem.gamma[b, i, k] = held.rod.gamma[b, i, k]
            else:
                write_entry(held, b, i, k, held.rod.residual_directions[b, i, k - m])
        for j in range(held.turns):
            write_entry(held, b, m + j, k, wp.dot(held.base_axes[j], bent * db - spun))
    held.problem.position[b] = held.rod.position[b]
    held.problem.rotation[b] = held.rod.rotation[b]
    fault = held.rod.fault[b]
    if fault == 0 and not wp.isfinite(total):
        fault = 1
    held.problem.fault[b] = fault
    held.problem.step_count[b] = held.rod.step_count[b]


@wp.struct
class Ends:
    """Tips of rods that are known by their segments, in the world; the first axis is what ``instance`` lists."""

    instance: wp.array[int]
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    wrench: wp.array2d[wp.float64]
    # how position, rotation, force, moment and, in its own frame, the moment at the base vary (.., 15, column); columns along
    # directions are the last
    columns: wp.array3d[wp.float64]
    # outputs
    residual: wp.array2d[wp.float64]
    residual_columns: wp.array3d[wp.float64]


@wp.kernel(module="unique", enable_backward=False)
def hold_ends(held: Held, ends: Ends):
    """(5), (7), (11) of rods that are known by their segments."""
    t = wp.tid()
    b = ends.instance[t]
    open = f64(1.0) - held.problem.load_factor[b]
    force, moment = vector(ends.wrench, t, 0), vector(ends.wrench, t, 3)
    tip = tip_of(held, b, is_neutral(held, b), ends.position[t], ends.rotation[t], force, moment)
    gap, rows = tip_rows(held, b, tip)
    for j in range(3):
        ends.residual[t, j] = gap[j] - open * held.opening[b, j]
        ends.residual[t, 3 + j] = rows[j] - open * held.opening[b, 3 + j]
    count = ends.columns.shape[2]
    for k in range(count):
        d = wp.max(k - (count - held.direction_count), -1)
        dp, tip_turn = column(ends.columns, t, 0, k), column(ends.columns, t, 3, k)
        dn, dm = column(ends.columns, t, 6, k), column(ends.columns, t, 9, k)
        shift, change = tip_rows_variation(held, b, tip, d, dp, tip_turn, dn, dm, column(ends.columns, t, 12, k))
        write_rows(ends.residual_columns, t, 0, k, shift, change)
