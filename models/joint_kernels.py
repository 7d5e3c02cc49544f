# mypy: ignore-errors
"""Joints between the tip of a rod and what holds it. Numbers in parentheses are those of ``docs/parallel.md``."""

import warp as wp

from multirod.capabilities import Loading
from multirod.models.rotation_kernels import inverse_right_jacobian, rotation_vector, swing
from multirod.rotations import AIMLESS, BACK, SIDEWAYS

f64 = wp.float64

SOFT = 0.01  # L^3/EI by which tips give way while joints close
AT_REST = 1e-9  # of the curvature scale, up to which the force in a rod is none: then they do

CLAMPED = 0
REVOLUTE = 1
SPHERICAL = 2
JOINTS = {"clamped": CLAMPED, "revolute": REVOLUTE, "spherical": SPHERICAL}


@wp.func
def vector(values: wp.array2d[wp.float64], t: int, first: int) -> wp.vec3d:
    """Three numbers of a row."""
    return wp.vec3d(values[t, first], values[t, first + 1], values[t, first + 2])


@wp.func
def column_of(values: wp.mat33d, k: int) -> wp.vec3d:
    return wp.vec3d(values[0, k], values[1, k], values[2, k])


@wp.func
def column(values: wp.array3d[wp.float64], t: int, first: int, k: int) -> wp.vec3d:
    """Three numbers of a column."""
    return wp.vec3d(values[t, first, k], values[t, first + 1, k], values[t, first + 2, k])


@wp.func
def along(directions: wp.array3d[wp.float64], b: int, d: int, first: int) -> wp.vec3d:
    """Three numbers of a direction in input space."""
    return wp.vec3d(directions[b, d, first], directions[b, d, first + 1], directions[b, d, first + 2])


@wp.func
def load_level(loading: int, factor: f64) -> f64:
    """What multiplies all loads of an instance, by how they act while joints close."""
    if loading == wp.static(int(Loading.NONE)):
        return f64(0.0)
    if loading == wp.static(int(Loading.FULL)):
        return f64(1.0)
    return factor


@wp.struct
class Joint:
    """A joint between a leg's tip and the platform."""

    kind: int
    arm: wp.vec3d  # from the platform's origin, world frame
    frame: wp.mat33d  # of the attachment, world frame
    tip: wp.mat33d  # of the leg's tip, world frame
    moment: wp.vec3d  # on the tip, in its frame
    axis: wp.vec3d  # of a revolute joint, attachment frame
    across: wp.vec3d  # two directions across it
    along: wp.vec3d
    log: wp.vec3d  # (3) rotation vector of the mismatch
    by_turn: wp.mat33d  # (4)
    tilted: wp.vec3d  # (6) the axis as the tip carries it, attachment frame
    swing: wp.vec2d
    back: int  # whether it is turned so far back that the angle is taken instead
    angle: f64
    about: wp.vec3d  # unit direction about which it is turned, attachment frame
    length: f64
    curvature: f64  # per moment


@wp.func
def joint_at(kind: int, axis: wp.vec3d, frame: wp.mat33d, tip: wp.mat33d, moment: wp.vec3d) -> Joint:
    """A joint whose attachment and tip have these frames, with a moment on the tip, all in the world; scales are left out."""
    joint = Joint()
    joint.kind = kind
    joint.frame = frame
    joint.tip = tip
    joint.moment = wp.transpose(tip) * moment
    mismatch = wp.transpose(frame) * tip
    if kind == wp.static(CLAMPED):
        joint.log = rotation_vector(mismatch)
        joint.by_turn = inverse_right_jacobian(joint.log)
    if kind == wp.static(REVOLUTE):
        joint.axis = axis
        least = int(0)
        if wp.abs(axis[1]) < wp.abs(axis[0]):
            least = int(1)
        if wp.abs(axis[2]) < wp.abs(axis[least]):
            least = int(2)
        other = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        other[least] = f64(1.0)
        joint.across = wp.normalize(wp.cross(axis, other))
        joint.along = wp.cross(axis, joint.across)
        joint.tilted = mismatch * axis
        cosine = wp.dot(axis, joint.tilted)
        if cosine > f64(wp.static(BACK)):
            joint.swing = swing(cosine)
        else:
            turned = wp.cross(axis, joint.tilted)
            joint.back = 1
            joint.angle = wp.atan2(wp.length(turned), cosine)
            joint.about = joint.across
            if wp.length(turned) > f64(wp.static(AIMLESS)):
                joint.about = wp.normalize(turned)
    return joint


@wp.func
def joint_rows(joint: Joint) -> wp.vec3d:
    """(5) to (7): the three residuals of a joint beside its position [1/m]."""
    if joint.kind == wp.static(SPHERICAL):
        return joint.curvature * joint.moment
    if joint.kind == wp.static(REVOLUTE):
        s = joint.angle * joint.about
        if joint.back == 0:
            s = joint.swing[0] * wp.cross(joint.axis, joint.tilted)
        return wp.vec3d(
            wp.dot(joint.across, s) / joint.length,
            wp.dot(joint.along, s) / joint.length,
            joint.curvature * wp.dot(joint.axis, joint.moment),
        )
    return joint.log / joint.length


@wp.func
def joint_rows_variation(joint: Joint, tip_turn: wp.vec3d, turn: wp.vec3d, dm: wp.vec3d, m: wp.vec3d) -> wp.vec3d:
    """(5) to (7): their change where tip and platform turn (world), and the moment m on the tip changes by dm (world)."""
    dM = wp.transpose(joint.tip) * (dm - wp.cross(tip_turn, m))
    if joint.kind == wp.static(SPHERICAL):
        return joint.curvature * dM
    if joint.kind == wp.static(REVOLUTE):
        by = wp.transpose(joint.frame) * (tip_turn - turn)
        tilt = wp.cross(by, joint.tilted)
        turned = wp.cross(joint.axis, joint.tilted)
        s = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        if joint.back == 0:
            s = joint.swing[0] * wp.cross(joint.axis, tilt)
            s += (joint.swing[1] * wp.dot(joint.axis, tilt)) * turned
        else:
            quotient = joint.angle / wp.max(wp.length(turned), f64(wp.static(SIDEWAYS)))
            straight = (f64(1.0) - quotient * wp.dot(joint.axis, joint.tilted)) * wp.dot(joint.about, by)
            s = quotient * wp.cross(joint.axis, tilt) + straight * joint.about
        return wp.vec3d(
            wp.dot(joint.across, s) / joint.length,
            wp.dot(joint.along, s) / joint.length,
            joint.curvature * wp.dot(joint.axis, dM),
        )
    return joint.by_turn * (wp.transpose(joint.tip) * (tip_turn - turn)) / joint.length


@wp.func
def write_rows(values: wp.array3d[wp.float64], b: int, row: int, k: int, a: wp.vec3d, c: wp.vec3d):
    """Six numbers of a column."""
    for j in range(3):
        values[b, row + j, k] = a[j]
        values[b, row + 3 + j, k] = c[j]
