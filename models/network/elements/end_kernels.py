# mypy: ignore-errors
"""Ends of the rods of a network: where bodies and joints have them, and how rods come out of their bases.

Numbers in parentheses are those of ``docs/networks.md``.
"""

import warp as wp

from multirod.models.joint_kernels import load_level
from multirod.models.network.elements.records import Networks, RodGroup
from multirod.models.network.joining.joints import MOST
from multirod.models.rotation_kernels import left_jacobian, rotation_from_vector

f64 = wp.float64


@wp.func
def nothing() -> wp.vec3d:
    return wp.vec3d(f64(0.0), f64(0.0), f64(0.0))


@wp.struct
class End:
    """(1) to (3) One end of a rod as its body and its joint have it, in the world but for what is said to be in its pose."""

    arm: wp.vec3d  # from the body
    frame: wp.mat33d  # of the pose on the body
    position: wp.vec3d
    rotation: wp.mat33d  # of the end
    angle: wp.vec3d
    joint: wp.mat33d  # E, in the pose
    turns: wp.mat33d  # G
    axes: wp.mat33d  # W
    slide: wp.mat33d  # (36) T, in the pose
    second: wp.mat33d  # axes that turn with the first
    first: wp.mat33d  # by which turns
    count: int


@wp.func(inline=False)
def end_at(net: wp.ref[Networks], b: int, rod: int, e: int) -> End:
    """An end of a rod, that something holds."""
    end = End()
    at = net.frame[e, rod]
    R = net.body_rotation[b, at]
    arm = net.attachment_position[b, e, rod]
    if e == 1:  # (29)
        arm += (f64(1.0) - net.problem.load_factor[b]) * net.shift[b, rod]
    end.arm = R * arm
    end.frame = R * net.attachment_rotation[b, e, rod]
    end.position = net.body_position[b, at] + end.arm
    end.rotation = end.frame
    end.joint = wp.identity(3, dtype=f64)
    end.count = net.count[e, rod]
    if end.count > 0:
        for j in range(end.count):
            given = net.driven[e, rod, j]
            if given >= 0:  # (24)
                end.angle[j] = net.problem.inputs[b, given]
            else:
                end.angle[j] = net.length[b, rod] * net.problem.unknowns[b, net.variable[rod, net.own + wp.static(MOST) * e + j]]
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
        end.slide = net.slide[e, rod]  # (36)
        moved = end.frame * (end.slide * end.angle)
        end.arm += moved
        end.position += moved
    return end


@wp.func
def torque_unit(net: wp.ref[Networks], b: int, rod: int, e: int) -> wp.vec3d:
    """(9) What torques about the axes of a joint are told in: of a stiff spring, so that it is the angle which is told."""
    EI = net.stiffness[b, rod]
    return wp.vec3d(EI, EI, EI) + net.length[b, rod] * net.spring[e, rod]


@wp.func
def pushed_at(net: wp.ref[Networks], b: int, rod: int, e: int) -> wp.vec3d:
    """(40) What acts along the coordinates of a joint."""
    result = nothing()
    level = load_level(net.loading[b], net.problem.load_factor[b])
    for j in range(net.count[e, rod]):
        if net.pushed[e, rod, j] >= 0:
            result[j] = level * net.unit[e, rod][j] * net.problem.inputs[b, net.pushed[e, rod, j]]
    return result


@wp.func
def extension(net: wp.ref[Networks], b: int, rod: int) -> f64:
    """(20) How much longer a piece is than it is taken to be."""
    given = net.share[rod] * net.problem.inputs[b, net.translation_at + net.owner[rod]]
    L = net.length[b, rod]
    moved = f64(0.0)
    tip = net.variable[rod, net.size - 2]
    base = net.variable[rod, net.size - 1]
    if tip >= 0:
        moved += net.problem.unknowns[b, tip]
    if base >= 0:
        moved -= net.problem.unknowns[b, base]
    return (net.share[rod] * f64(net.pieces[rod]) - f64(1.0)) * L + given + L * L * moved


@wp.func
def stretched(net: wp.ref[Networks], b: int, rod: int) -> f64:
    """(37) How far the spring at the hole at the tip of a piece is stretched."""
    given = net.problem.inputs[b, net.translation_at + net.owner[rod]]
    L = net.length[b, rod]
    place = net.below[rod] * (f64(net.pieces[rod]) * L + given) + L * L * net.problem.unknowns[b, net.variable[rod, net.size - 2]]
    return place - given - net.hole_rest[rod]


@wp.struct
class Behind:
    """(9) of the model: the first of several tubes behind their plate, and the angle at which it comes out of that."""

    angle: f64
    torque: f64  # that twists it
    compliance: f64  # integral of 1/GJ
    twist_rate: f64  # u*_z at the plate
    compliance_rate: f64  # 1/GJ there


@wp.func(inline=False)
def behind_plate(group: wp.ref[RodGroup], t: int) -> Behind:
    """The frame at the base is that of the first tube."""
    result = Behind()
    result.angle = group.problem.inputs[t, 0]
    if group.transmission == 0:
        return result
    rods = group.table
    r = t * rods.stride
    terms = rods.precurvature.shape[3] // 3
    depth = -group.problem.inputs[t, group.rods]
    result.torque = group.moment_by[t, 2, 2] * group.problem.unknowns[t, 2]
    begin = f64(0.0)
    for m in range(rods.end.shape[2]):
        end = rods.end[r, 0, m]
        half = f64(0.5) * (end - begin)
        if half > f64(0.0) and begin <= depth:
            size = wp.min(end, depth) - begin
            x = size / half - f64(1.0)
            upper = f64(0.0)
            lower = f64(0.0)
            rate = f64(0.0)
            for k in range(terms):
                j = terms - 1 - k
                c = rods.precurvature[r, 0, m, 3 * j + 2]
                rate = x * rate + c
                upper = x * upper + c / f64(j + 1)
                lower = c / f64(j + 1) - lower
            soft = rods.material[r, 0, m, 5]
            result.compliance += size * soft
            result.angle += half * (x * upper + lower)
            result.twist_rate = rate
            result.compliance_rate = soft
        begin = end
    result.angle += result.compliance * result.torque
    return result
