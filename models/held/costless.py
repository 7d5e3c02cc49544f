"""Turns of a held rod that cost nothing, and what holds those of a rod between two balls.

Numbers in parentheses are those of ``docs/held.md``.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.models.held.kernels.arguments import (
    ALONG,
    BALL_AND_CLAMP,
    BESIDE,
    IN_BALLS,
    ON_AXIS,
    ROUND_IN_BALLS,
    SPINS,
)
from multirod.models.joint_kernels import CLAMPED, REVOLUTE, SPHERICAL
from multirod.rotations import cross, cross_matrix, inverse_left_jacobian, matrices, vectors
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.held.problem import HeldProblem

AXIS = np.array([0.0, 0.0, 1.0])  # of a rod
STRAIGHT = 1e-6  # how little rods are bent that have no plane [rad]
NONE = 1e-9  # of EI/L^3: a load along the rod that is none; so little tells a place around to no tolerance
PULLED = 1e-9  # of its length, by which a rod that is pulled is longer
SMALL = 1e-4  # square of an angle under which quotients are series


def alike(problem: "HeldProblem") -> NDArray[np.bool_]:
    """(10) Whether nothing but what acts along the rod tells directions across its axis apart, shape (instance_count,)."""
    if problem.turns or problem.holders.joint == REVOLUTE or not _slides_along(problem):
        return np.zeros(problem.instance_count, dtype=bool)
    return round_about_itself(problem)


def _slides_along(problem: "HeldProblem") -> bool:
    """Whether the end slides along the axis of a rod that is straight, if it does."""
    return problem.holders.slide is None or abs(problem.holders.slide[2]) >= 1 - ON_AXIS


def round_about_itself(problem: "HeldProblem") -> NDArray[np.bool_]:
    """Whether it is straight at rest and nothing of the rod itself tells directions across it apart, shape (instance_count,)."""
    arrays, features = problem.rod.arrays, problem.rod.features
    if features.members or features.profile_degree >= 0:
        return np.zeros(problem.instance_count, dtype=bool)
    material = arrays.material[:, 0]
    same = (material[..., 0] == material[..., 1]).all(axis=1) & (material[..., 6] == material[..., 7]).all(axis=1)
    for load in features.loads:
        same = same & load.same_across(problem.rod.sizes)
    return np.asarray((problem.rod.each(same) == 1) & straight_at_rest(problem))


def in_balls(problem: "HeldProblem") -> NDArray[np.intp]:
    """(28) Which turns of a rod with its base in a ball cost nothing where no load acts, as ``kernels.arguments`` numbers
    them, 0 where none does, shape (instance_count,)."""
    holders, features = problem.holders, problem.rod.features
    if holders.base_joint != SPHERICAL or features.loads or features.profile_degree >= 0:
        return np.zeros(problem.instance_count, dtype=np.intp)
    same = round_about_itself(problem)
    if holders.joint == SPHERICAL:
        return np.where(same, ROUND_IN_BALLS, IN_BALLS)
    return np.where(same & _slides_along(problem) & (holders.joint == CLAMPED), BALL_AND_CLAMP, 0)


def free_in_balls(problem: "HeldProblem") -> IntArray:
    """(28) The same at the inputs."""
    kinds = problem.table.balls.numpy()
    if not kinds.any():
        return np.asarray(kinds)
    (between, free), (_, bare) = between_balls(problem), from_clamp(problem)
    spins = between & (kinds == ROUND_IN_BALLS)
    return np.asarray(np.where(free | bare, kinds, np.where(spins, SPINS, 0)))


def least_loads(problem: "HeldProblem") -> FloatArray:
    """(24) Loads that are none: of the moment on the tip [N m], then of ``ALONG``, each in its own unit, (instance_count, 5)."""
    length, mass = problem.length, _mass(problem)
    with np.errstate(divide="ignore"):
        weight = 1 / (mass * length**2)
    field = np.zeros_like(length)  # what is magnetised is turned by any
    own = np.stack([1 / length, 1 / length**3, 1 / length**2, weight, field], axis=1)
    return np.asarray(NONE * problem.stiffness[:, None] * own)


def acting(problem: "HeldProblem") -> NDArray[np.bool_]:
    """(24) Which loads act at the inputs, in the order of ``least_loads``, shape (instance_count, 5)."""
    inputs, first = problem.read("inputs"), problem.table.along
    along = inputs[:, first : first + 3 * len(ALONG)].reshape(-1, len(ALONG), 3)
    loads = np.concatenate([inputs[:, None, problem.input_slice("tip_moment")], along], axis=1)
    return np.asarray(np.linalg.norm(loads, axis=2) > problem.table.least.numpy())


def acts_across(problem: "HeldProblem") -> NDArray[np.bool_]:
    """(24) Whether any load along the rod tells directions across the axis of the base apart: not forces along that, shape
    (instance_count,)."""
    _, pushed, torque, heavy, field = acting(problem).T
    axis = problem.base_frame[:, :, 2]
    pushed, heavy = (there & ~_lie_along(own, axis) for there, own in zip((pushed, heavy), forces(problem), strict=True))
    return np.asarray(pushed | torque | heavy | field)


def _lie_along(values: FloatArray, axis: FloatArray) -> NDArray[np.bool_]:
    """Which vectors (count, 3) lie along others."""
    sizes = np.linalg.norm(values, axis=1) * np.linalg.norm(axis, axis=1)
    return np.asarray(np.linalg.norm(cross(values, axis), axis=1) <= ON_AXIS * sizes)


def between_balls(problem: "HeldProblem") -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(28) Whether a rod is between two balls and no moments act on it; whether what forces act along it are along the line
    between the balls, as is any slide. Shapes (instance_count,)."""
    moment, pushed, torque, heavy, field = acting(problem).T
    between = np.isin(problem.table.balls.numpy(), (IN_BALLS, ROUND_IN_BALLS)) & ~(moment | torque | field)
    force, weight = (own[:, None] * values for own, values in zip((pushed, heavy), forces(problem), strict=True))
    place, frame = problem.goal()
    chord = place - problem.rod.table.base_position.numpy()
    free = between.copy()
    for own in (force, weight):
        free &= _lie_along(own, chord)
    if problem.holders.slide is not None:
        guide = frame @ problem.holders.slide
        free &= np.where(pushed | heavy, _lie_along(guide, chord), ~_slides_straight(problem, guide, chord))
    return between, free


def _slides_straight(problem: "HeldProblem", guide: FloatArray, chord: FloatArray) -> NDArray[np.bool_]:
    """(28b) Which round rods whose ends slide along ``guide`` stay straight under their thrust, shape (instance_count,)."""
    along = (chord * guide).sum(axis=1) / np.maximum(np.linalg.norm(chord, axis=1), 1e-300)
    force = problem.read("inputs")[:, problem.table.tip_loads :][:, :3]
    thrust = -(force * guide).sum(axis=1) * np.sign(along)
    most = np.pi**2 * least_bending_stiffness(problem) * np.abs(along)
    below = thrust * problem.length_in_use() ** 2 <= most
    return np.asarray(below & (problem.table.balls.numpy() == ROUND_IN_BALLS))


def least_bending_stiffness(problem: "HeldProblem") -> FloatArray:
    """Of all along the rod [N m^2], shape (instance_count,)."""
    return np.asarray(problem.rod.each(problem.rod.arrays.material[..., :2].min(axis=(1, 2, 3))))


def from_clamp(problem: "HeldProblem") -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(28) Whether a round rod is from a ball to a clamp on its axis; whether nothing acts across that along it besides: a moment
    on an end that is clamped does no work. Shapes (instance_count,)."""
    there = (problem.table.balls.numpy() == BALL_AND_CLAMP) & on_axis(problem)
    return there, there & ~acts_across(problem)


def forces(problem: "HeldProblem") -> tuple[FloatArray, FloatArray]:
    """Force per length on a rod [N/m] and gravity [m/s^2], in the world, shapes (instance_count, 3)."""
    inputs, first = problem.read("inputs"), problem.table.along
    return inputs[:, first : first + 3], inputs[:, first + 6 : first + 9]


def force_along(problem: "HeldProblem") -> FloatArray:
    """All that forces on a rod and its weight are together, in the world [N], shape (instance_count, 3)."""
    own, gravity = forces(problem)
    return np.asarray(problem.length[:, None] * own + _mass(problem)[:, None] * gravity)


def _mass(problem: "HeldProblem") -> FloatArray:
    """Of the rod [kg], shape (instance_count,)."""
    arrays = problem.rod.arrays
    parts = np.diff(arrays.end[:, 0], axis=1, prepend=0.0)
    return np.asarray(problem.rod.each((parts * arrays.material[:, 0, :, 9]).sum(axis=1)))


def on_axis(problem: "HeldProblem") -> NDArray[np.bool_]:
    """(10) Whether the end is to be held on the axis of the base and along it, shape (instance_count,)."""
    away, frame = problem.goal()
    away = away - problem.rod.table.base_position.numpy()
    axis = problem.base_frame[:, :, 2]
    off = [np.linalg.norm(cross(axis, own), axis=1) for own in (away / problem.length[:, None], frame[:, :, 2])]
    return np.asarray(np.max(off, axis=0) < ON_AXIS)


def drawn_aside(problem: "HeldProblem") -> FloatArray:
    """(31) Forces across the axis of the base that alone tell in which plane a round rod bends, in the frame of the base, in
    ``EI/L^2``, shape (instance_count, 3): zero where moments act, or something else tells."""
    moment, _, torque, _, field = acting(problem).T
    round_one = (problem.alike | (problem.table.balls.numpy() == BALL_AND_CLAMP)) & on_axis(problem)
    told = torque | field | (moment & (problem.holders.joint != CLAMPED))
    force = np.einsum("bji,bj->bi", problem.base_frame, force_along(problem)) * [1.0, 1.0, 0.0]
    chosen = round_one & ~told & acts_across(problem)
    return np.asarray(np.where(chosen[:, None], force * (problem.length**2 / problem.stiffness)[:, None], 0.0))


@contextmanager
def led_on(problem: "HeldProblem") -> Iterator[None]:
    """``BoundaryProblem.led_on``"""
    beside, problem.leads_on = problem.table.beside, True
    try:
        yield
    finally:
        problem.leads_on = False
        beside.assign(np.minimum(beside.numpy(), BESIDE))


def turned_to(axis: FloatArray, other: FloatArray) -> FloatArray:
    """The least rotations (count, 3, 3) that lead unit vectors (count, 3) to others; by half a turn about any axis across."""
    about, cosine = cross(axis, other), (axis * other).sum(axis=1)
    any_across = cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)])
    back = (cosine < 0) & (np.linalg.norm(about, axis=1) < ON_AXIS)
    about = np.where(back[:, None], any_across, about)
    sine = np.linalg.norm(about, axis=1)
    angle = np.where(back, np.pi, np.arctan2(sine, cosine))
    return matrices(about * (angle / np.where(sine == 0, 1.0, sine))[:, None])


def hold_base(problem: "HeldProblem", turn: FloatArray, axis: FloatArray, chosen: NDArray[np.bool_]) -> None:
    """(29) Hold the bases of the ``chosen`` along the ways in which they turn where they are turned by ``turn``, the line between
    the ends being along ``axis``, both (instance_count, 3), in the frame of the base's holder."""
    table, back = problem.table, inverse_left_jacobian(turn)
    tangent = matrices(turn)[:, :, 2]
    about = table.balls.numpy() == IN_BALLS

    def unit(v: FloatArray) -> FloatArray:
        size = np.linalg.norm(v, axis=1, keepdims=True)
        return np.asarray(v / np.where(size > 0, size, 1.0))

    spin = unit((back @ tangent[:, :, None])[:, :, 0])
    whole = (back @ axis[:, :, None])[:, :, 0]
    apart = (back @ (axis - tangent)[:, :, None])[:, :, 0]
    apart -= (apart * spin).sum(axis=1)[:, None] * spin
    # a straight rod spins where it is turned as one: any other way will do, and where it points along its holder it bends about y
    other = np.eye(3)[np.argmin(np.abs(spin), axis=1)]
    other -= (other * spin).sum(axis=1)[:, None] * spin
    apart = np.where((np.linalg.norm(apart, axis=1) > STRAIGHT)[:, None], apart, other)
    ways = np.stack([spin, np.where(about[:, None], unit(whole), unit(apart))], axis=1)
    at = np.einsum("bki,bi->bk", ways, turn) / problem.length[:, None]
    for array, values in ((table.ways, ways), (table.held_at, at)):
        array.assign(np.where(chosen.reshape(-1, *(1,) * (values.ndim - 1)), values, array.numpy()))


def hold_bases_alone(problem: "HeldProblem", unknowns: FloatArray | None = None) -> None:
    """(29) As they are turned by ``unknowns`` (instance_count, n), NaN of none; by default as they are that point to their
    ends."""
    chosen = problem.table.balls.numpy() != 0
    if not chosen.any():
        return
    axis = problem.goal()[0] - problem.rod.table.base_position.numpy()
    axis = np.einsum("bji,bj->bi", problem.base_frame, axis)
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = np.where(size > 0, axis / np.where(size > 0, size, 1.0), AXIS)
    if unknowns is None:
        turn = vectors(turned_to(np.broadcast_to(AXIS, axis.shape), axis))
    else:
        turn = problem.length[:, None] * unknowns[:, problem.rod.unknown_count :]
        chosen &= np.isfinite(turn).all(axis=1)
        turn = np.where(chosen[:, None], turn, 0.0)
    hold_base(problem, turn, axis, chosen)


def holding(
    problem: "HeldProblem", chosen: IntArray, unknowns: FloatArray, level: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """(28) What is taken off the moments at the bases of the ``chosen``, (count, 3), and its columns by their rotation vectors
    over the length, (count, 3, 3), at unknowns (count, n) and levels of the load (count,); None where nothing is."""
    table = problem.table
    (between, free), (clamped, bare) = between_balls(problem), from_clamp(problem)
    held = (between | clamped)[chosen]
    if not held.any():
        return None
    fading = held * np.maximum(1 - level, 0.0) * table.leading.numpy()[chosen]
    spins = between & (table.balls.numpy() == ROUND_IN_BALLS)
    weights = np.stack([spins[chosen], np.where((free | bare)[chosen], 1.0, fading)], axis=1)
    length, ways = problem.length[chosen], table.ways.numpy()[chosen]
    turn = length[:, None] * unknowns[:, problem.rod.unknown_count :]
    lags = np.einsum("bki,bi->bk", ways, turn) / length[:, None] - table.held_at.numpy()[chosen]
    return _held_along(ways * np.sqrt(weights)[:, :, None], lags * np.sqrt(weights), turn, length)


def _held_along(ways: FloatArray, lags: FloatArray, turn: FloatArray, length: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same along ``ways`` (count, 2, 3) by whose ``lags`` (count, 2) [1/m] bases are off that are turned by ``turn``, both
    times the root of their weights."""
    rows, columns = np.zeros(turn.shape), np.zeros((*turn.shape, 3))
    K, factor, rate = cross_matrix(turn), *(values[:, None, None] for values in _of_inverse(turn))
    for q, lag in zip(ways.swapaxes(0, 1), lags.T, strict=True):
        across = cross(turn, q)
        twice = cross(turn, across)
        turned = q - 0.5 * across + factor[:, 0] * twice
        Q = cross_matrix(q)
        change = 0.5 * Q - factor * (cross_matrix(across) + K @ Q) + rate * twice[:, :, None] * turn[:, None]
        rows += lag[:, None] * turned
        columns += turned[:, :, None] * q[:, None] + (lag * length)[:, None, None] * change
    return rows, columns


def _of_inverse(turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of the square in ``J^-1(turn)``, and its rate by the angle over that, shape (count,)."""
    square = (turn**2).sum(axis=1)
    small = square < SMALL
    angle = np.where(small, 1.0, np.sqrt(square))
    half = 0.5 * angle
    cot, sine = 1 / np.tan(half), np.sin(half)
    rate = -2 / angle**3 + cot / (2 * angle**2) + 0.25 / (angle * sine**2)
    return (
        np.where(small, 1 / 12 + square / 720, 1 / angle**2 - cot / (2 * angle)),
        np.where(small, 1 / 360 + square / 7560, rate / angle),
    )


def straight_at_rest(problem: "HeldProblem") -> NDArray[np.bool_]:
    """Whether no part of the rod is bent at rest, shape (instance_count,)."""
    curvature = problem.rod.arrays.precurvature
    bent = np.abs(curvature.reshape(*curvature.shape[:3], -1, 3)[..., :2]).max(axis=(1, 2, 3, 4))
    return np.asarray(problem.rod.each(bent) == 0)


def pulled(problem: "HeldProblem") -> NDArray[np.bool_]:
    """Whether an end that does not slide is held further from the base than the rod is long, shape (instance_count,)."""
    way = problem.goal()[0] - problem.rod.table.base_position.numpy()
    beyond = np.linalg.norm(way, axis=1) > (1 + PULLED) * problem.length_in_use()
    return np.asarray(beyond & (problem.holders.slide is None))


def swing(problem: "HeldProblem", rest: FloatArray, taut: NDArray[np.bool_]) -> FloatArray:
    """(2b) Rotation vectors that lead the line from the base to ``rest``, where the end is at rest, to that to where it is to be,
    of rods that are ``taut`` alone, as ``pulled`` says; both of shape (instance_count, 3)."""
    base = problem.rod.table.base_position.numpy()
    lines = np.where(taut[:, None, None], np.stack([rest - base, problem.goal()[0] - base], axis=1), AXIS)
    size = np.linalg.norm(lines, axis=2, keepdims=True)
    apart = size[:, 0] > ON_AXIS * problem.length_in_use()[:, None]
    line, way = np.where(apart[:, None], lines / np.where(size > 0, size, 1.0), AXIS).swapaxes(0, 1)
    return vectors(turned_to(line, way))


def loaded(problem: "HeldProblem") -> NDArray[np.bool_]:
    """Whether anything acts on the rod or its end, shape (instance_count,)."""
    inputs = problem.read("inputs")[:, 2:-1]  # neither turned nor pushed out, nor the scale of functions of arclength
    inputs[:, problem.table.pose - 2 : problem.table.pose - 2 + 6] = 0.0
    terms = problem.rod.features
    return np.asarray(inputs.any(axis=1) | (terms.profile_degree >= 0) | terms.world_force_is_state)
