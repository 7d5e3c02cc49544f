# mypy: ignore-errors
"""What holds the end of a rod: its pose, its joint, and what the two say of a tip. Numbers are those of ``docs/held.md``."""

import warp as wp

from multirod.models.held.kernels.arguments import ACROSS, SOFT, Held
from multirod.models.held.kernels.base_kernels import base_moment, drawn_or, weight_of_phase
from multirod.models.joint_kernels import CLAMPED, Joint, along, joint_at, joint_rows, joint_rows_variation, vector
from multirod.models.rotation_kernels import left_jacobian, rotation_from_vector

f64 = wp.float64


@wp.struct
class End:
    """Pose of what holds the end, in the world."""

    position: wp.vec3d
    rotation: wp.mat33d
    turn: wp.mat33d  # rotation vector, in the world, by end_rotation


@wp.func
def end_pose(held: Held, b: int) -> End:
    """(1) to (2b) The pose on the way from that of the rod at rest."""
    end = End()
    path = wp.where(held.direct[b] != 0, f64(1.0), held.problem.load_factor[b])
    rest = path - f64(1.0)
    goal = held.end_position[b] + vector(held.problem.inputs, b, held.pose)
    end.position = goal + rest * (goal - held.rest_position[b])
    swing = held.swing[b]
    if rest != f64(0.0) and wp.length_sq(swing) > f64(0.0):
        base = held.base_position[b]
        line = held.rest_position[b] - base
        longer = path * wp.length(goal - base) / wp.length(line) - rest
        end.position = base + longer * (rotation_from_vector(path * swing) * line)
    a = path * vector(held.problem.inputs, b, held.pose + 3)
    end.rotation = rotation_from_vector(a) * (rotation_from_vector(rest * held.rest_turn[b]) * held.end_frame[b])
    end.turn = path * left_jacobian(a)
    return end


@wp.func
def phase_of(held: Held, b: int) -> wp.vec3d:
    """(11) Across the axis about which the rod is to bend, in the frame of the base: there is to be no moment."""
    if held.beside[b] != 0:
        return held.drawn[b]
    turn = wp.transpose(held.base_frame[b]) * (vector(held.problem.inputs, b, held.pose + 3) + held.rest_turn[b])
    across = wp.vec3d(turn[1], -turn[0], f64(0.0))
    size = wp.length(across)
    if size > f64(wp.static(ACROSS)):
        return across / size
    return drawn_or(held, b, wp.vec3d(f64(1.0), f64(0.0), f64(0.0)))


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


@wp.struct
class Tip:
    """The tip of a rod as what holds the end sees it."""

    end: End
    joint: Joint
    to_guide: wp.mat33d
    apart: wp.vec3d
    force: wp.vec3d  # that the rod carries there, less what acts on the tip, in the world
    moment: wp.vec3d
    weight: f64  # of the phase
    phase: Phase


@wp.func
def tip_of(held: Held, b: int, position: wp.vec3d, rotation: wp.mat33d, force: wp.vec3d, moment: wp.vec3d) -> Tip:
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
    # clamps along the rod tell of that turn
    tip.weight = wp.where(held.clamped == 0, weight_of_phase(held, b), f64(0.0))
    if tip.weight != f64(0.0):
        tip.phase.axis = held.base_frame[b] * wp.vec3d(f64(0.0), f64(0.0), f64(1.0))
        tip.phase.across = phase_of(held, b)
        tip.phase.lag = tip.weight * tip.joint.curvature * wp.dot(tip.phase.across, base_moment(held, b))
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
    if tip.weight != f64(0.0):
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
    if tip.weight != f64(0.0):
        lags = tip.weight * bent * wp.dot(tip.phase.across, db)
        by_force = wp.cross(tip.phase.axis, dn) - wp.cross(turn, wp.cross(tip.phase.axis, tip.force))
        by_moment = wp.cross(tip.phase.axis, dm) - wp.cross(tip_turn, wp.cross(tip.phase.axis, tip.moment))
        more, twist = phase_rows(held, b, tip.joint, tip.to_guide, by_force, by_moment)
        shift += lags * tip.phase.pull + tip.phase.lag * more
        change += lags * tip.phase.twist + tip.phase.lag * twist
    return shift, change
