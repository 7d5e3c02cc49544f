# mypy: ignore-errors
"""(28) of ``docs/held.md``: turns of a rod whose base is in a ball that cost nothing, and what holds these."""

from math import pi

import warp as wp

from multirod.models.held.kernels.arguments import BALL_AND_CLAMP, FIELD, FORCE, ROUND_IN_BALLS, TORQUE, WEIGHT, Held
from multirod.models.held.kernels.base_kernels import acts, acts_across, leading, lies_along, on_axis, turn_of
from multirod.models.joint_kernels import column_of, vector
from multirod.models.rotation_kernels import rotation_from_vector

f64 = wp.float64


@wp.func
def slides_straight(held: Held, b: int, chord: wp.vec3d) -> bool:
    """(28b) Whether a round rod whose end slides, and which is not pushed along itself, stays straight under its thrust."""
    frame = rotation_from_vector(vector(held.problem.inputs, b, held.pose + 3)) * held.end_frame[b]
    guide = column_of(frame * held.guide, 2)
    along = wp.dot(chord, guide) / wp.max(wp.length(chord), f64(1e-300))
    thrust = -wp.dot(vector(held.problem.inputs, b, held.tip_loads), guide) * wp.sign(along)
    length = held.length[b] + held.problem.inputs[b, held.translation]
    return thrust * length * length <= f64(wp.static(pi**2)) * held.soft[b] * wp.abs(along)


@wp.func
def weights(held: Held, b: int) -> wp.vec2d:
    """(28) How the spin of a rod between two balls is held, and a turn about the line between its ends."""
    none = wp.vec2d(f64(0.0), f64(0.0))
    if held.balls[b] == 0:
        return none
    if held.balls[b] == wp.static(BALL_AND_CLAMP):
        if not on_axis(held, b):
            return none
        return wp.vec2d(f64(0.0), wp.where(acts_across(held, b), leading(held, b), f64(1.0)))
    force = vector(held.problem.inputs, b, held.along + wp.static(FORCE))
    weight = vector(held.problem.inputs, b, held.along + wp.static(WEIGHT))
    pushed, heavy = acts(held, b, held.along + wp.static(FORCE), 1), acts(held, b, held.along + wp.static(WEIGHT), 3)
    moments = acts(held, b, held.tip_loads + 3, 0)
    if moments or acts(held, b, held.along + wp.static(TORQUE), 2) or acts(held, b, held.along + wp.static(FIELD), 4):
        return none
    chord = held.end_position[b] + vector(held.problem.inputs, b, held.pose) - held.base_position[b]
    free = (not pushed or lies_along(force, chord)) and (not heavy or lies_along(weight, chord))
    if held.slides != 0 and (pushed or heavy):
        frame = rotation_from_vector(vector(held.problem.inputs, b, held.pose + 3)) * held.end_frame[b]
        free = free and lies_along(column_of(frame * held.guide, 2), chord)
    if held.slides != 0 and held.balls[b] == wp.static(ROUND_IN_BALLS) and not (pushed or heavy):
        free = free and not slides_straight(held, b, chord)
    turn = wp.where(free, f64(1.0), leading(held, b))
    # clamps along the rod tell of its spin
    spins = held.balls[b] == wp.static(ROUND_IN_BALLS) and held.clamped == 0
    spin = wp.where(spins, f64(1.0), f64(0.0))
    return wp.vec2d(spin, turn)


@wp.struct
class Spin:
    """(28) What stands in the rows of a ball at the base for turns that cost nothing."""

    there: bool
    weights: wp.vec2d
    angle: wp.vec3d  # rotation vector of the base


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
def spin_of(held: Held, b: int) -> Spin:
    spin = Spin()
    spin.weights = weights(held, b)
    spin.there = spin.weights[0] != f64(0.0) or spin.weights[1] != f64(0.0)
    spin.angle = turn_of(held, b)
    return spin


@wp.func
def spin_rows(held: Held, b: int, spin: Spin) -> wp.vec3d:
    """(28)"""
    total = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    for k in range(2):
        q = held.ways[b, k]
        lag = wp.dot(q, spin.angle) / held.length[b] - held.held_at[b, k]
        total += (spin.weights[k] * lag) * turned_by(spin.angle, q)
    return total


@wp.func
def spin_rows_variation(held: Held, b: int, spin: Spin, da: wp.vec3d) -> wp.vec3d:
    """(28) Their change where the rotation vector of the base changes by ``da``, over the length."""
    total = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    for k in range(2):
        q = held.ways[b, k]
        lag = wp.dot(q, spin.angle) / held.length[b] - held.held_at[b, k]
        change = lag * turned_by_variation(spin.angle, q, held.length[b] * da)
        total += spin.weights[k] * (change + wp.dot(q, da) * turned_by(spin.angle, q))
    return total
