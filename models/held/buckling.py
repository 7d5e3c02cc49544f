"""How a straight rod buckles whose ends are held: about which axis, to which side, by what moments and force.

Numbers in parentheses are those of ``docs/held.md``.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.held.costless import (
    AXIS,
    acting,
    force_along,
    forces,
    least_bending_stiffness,
    loaded,
    on_axis,
    straight_at_rest,
)
from multirod.models.joint_kernels import CLAMPED, REVOLUTE, SPHERICAL
from multirod.out_of_reach import TAUT
from multirod.problem import BegunAgain
from multirod.rod import DENSITY
from multirod.rotations import cross, leading_axis, matrices
from multirod.status import Status
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.held.problem import HeldProblem

ALONG = 0.99  # cosine of the angle between axes that are taken for one
# of the length, and of how far its middle moves, the end may stand beside the axis, turned across it by as much [rad]
BESIDE, BESIDE_BEND = 1e-2, 0.1
SLIGHT = 1e-3  # of EI/L: torques about the axis by which the rest of it then draws a rod to a side
STIFF, FAR = 1e-2, 10.0  # largest strain at its critical load of a rod that begins buckled, and times which it is shortened
BEYOND = 2.0  # times which it is shortened that begins so where another way came to an end
BENT, LED = 1, 2  # how what came to an end begins again: bent, and led further beside the axis
NEARLY, FURTHER = 1e-4, 3.0  # of the way, of which no more is left of that, and times as far beside the axis
STIFF_IN_MEDIUM = 2e-3  # the same where another mode is the first, whose event is not told
ELEMENTS = 48  # of a rod that is not equally stiff all along: its critical load is off by 0.2 %
PARTS = np.array([0.5, *[1.0] * (ELEMENTS - 1), 0.5])  # of an element that stand where each ends
CRUMBS = 1e-9  # of the larger part of an axis: that is rounding
RIGID = 1e6  # times as stiff as in bending, what is rigid in torsion is taken for
ROUND = 10.0  # times the part of the shortening by which the end beside it tells the plane alone


@dataclass(frozen=True)
class Mode:
    """(23) How a straight rod buckles that is equally stiff all along; but for the thrust, over the root of what it is shortened
    by.

    Attributes:
        thrust: In ``EI/L^2``.
        base_moment: In ``EI/L``.
        tip_moment: In ``EI/L``.
        base_turn: By which its base turns in its joint [rad].
    """

    thrust: float
    base_moment: float
    tip_moment: float
    base_turn: float


ROOT = 4.493409457909064  # the first of tan z = z
SHORTER = 0.5 + np.cos(ROOT) ** 2 - 1.5 * np.sin(ROOT) * np.cos(ROOT) / ROOT
HINGED = np.sqrt(2 / SHORTER) * ROOT  # largest moment of a rod that is hinged at one end
MODES = {  # by whether base and end turn freely about the axis
    (False, False): Mode(4 * np.pi**2, 4 * np.pi, 4 * np.pi, 0.0),
    (False, True): Mode(ROOT**2, -HINGED * np.sin(ROOT), 0.0, 0.0),
    (True, False): Mode(ROOT**2, 0.0, -HINGED * np.sin(ROOT), HINGED * (1 - np.cos(ROOT)) / ROOT),
    (True, True): Mode(np.pi**2, 0.0, 0.0, 2.0),
}


@dataclass(frozen=True)
class Modes:
    """(23), (33) How rods buckle, each about an axis of its own; but for the thrust, over the root of what they are shortened by.

    Attributes:
        thrust: [N], shape (instance_count,).
        base_moment: [N m], likewise.
        tip_moment: [N m].
        base_turn: By which the base turns in its joint [rad].
        hinged: (34) Of strips on hinges, what they do instead.
    """

    thrust: FloatArray
    base_moment: FloatArray
    tip_moment: FloatArray
    base_turn: FloatArray
    hinged: "Hinged | None" = None


@dataclass(frozen=True)
class Hinged:
    """(34) How strips on hinges buckle, in no plane if these are aside of their axes; but for the thrust, over the root of what
    they are shortened by.

    Attributes:
        chosen: Which instances do, shape (instance_count,).
        about: The axis about which their first half bends, unit vectors, shape (instance_count, 3).
        thrust: [N], shape (instance_count,).
        base_moment: [N m], shape (instance_count, 3), and so on.
        tip_moment: [N m].
        base_turn: By which the base turns in its joint [rad].
    """

    chosen: NDArray[np.bool_]
    about: FloatArray
    thrust: FloatArray
    base_moment: FloatArray
    tip_moment: FloatArray
    base_turn: FloatArray


def modes_about(problem: "HeldProblem", about: FloatArray, chosen: NDArray[np.bool_], hinged: Hinged | None = None) -> Modes:
    """(23) How straight rods buckle about axes, (instance_count, 3); (33) of the ``chosen`` ones, shape (instance_count,), that
    are not equally stiff all along; (34) or as strips that are ``hinged``."""
    holders, material, length = problem.holders, problem.rod.arrays.material[:, 0], problem.length_in_use()
    stiffness = (problem.rod.each(material[..., :2]) * about[:, None, :2] ** 2).sum(axis=2)
    free = [_turns(kind, own, about) for kind, own in ((holders.base_joint, holders.base_axis), (holders.joint, holders.axis))]
    first = stiffness[:, 0]
    units = first / length**2, first / length, first / length, np.ones_like(length)
    found = np.zeros((4, problem.instance_count))
    for (base, end), mode in MODES.items():
        own = (free[0] == base) & (free[1] == end)
        found[:, own] = np.array([mode.thrust, mode.base_moment, mode.tip_moment, mode.base_turn])[:, None]
    found *= units
    uneven = chosen & (stiffness != first[:, None]).any(axis=1)
    if uneven.any():
        ends = problem.rod.each(problem.rod.arrays.end[:, 0]) + (length - problem.length)[:, None]
        found[:, uneven] = _uneven(ends[uneven], stiffness[uneven], length[uneven], *(own[uneven] for own in free))
    if hinged is not None:
        found[0] = np.where(hinged.chosen, hinged.thrust, found[0])
    return Modes(found[0], found[1], found[2], found[3], hinged)


def hinged_strips(problem: "HeldProblem") -> Hinged | None:
    """(34) Of the strips of a robot with a hinge that is not along them; None of others."""
    holders, length = problem.holders, problem.length_in_use()
    joints = ((holders.base_joint, holders.base_axis), (holders.joint, holders.axis))
    stiffness = problem.rod.each(problem.rod.arrays.material[:, 0, :, :3])
    chosen = np.asarray(stiffness[:, 0, 0] != stiffness[:, 0, 1])
    if not chosen.any() or not any(kind == REVOLUTE and abs(axis[2]) <= ALONG for kind, axis in joints):
        return None
    ends = problem.rod.each(problem.rod.arrays.end[:, 0]) + (length - problem.length)[:, None]
    rods = np.concatenate([length[:, None], ends, stiffness.reshape(len(length), -1)], axis=1)
    different, which = np.unique(rods[chosen], axis=0, return_inverse=True)
    parts = ends.shape[1]
    found = np.array([_hinged(own[0], own[1 : 1 + parts], own[1 + parts :].reshape(parts, 3), joints) for own in different])
    result = np.zeros((len(length), found.shape[1]))
    result[chosen] = found[which.reshape(-1)]
    return Hinged(chosen, result[:, 1:4], result[:, 0], result[:, 4:7], result[:, 7:10], result[:, 10:])


def _hinged(length: float, ends: FloatArray, stiffness: FloatArray, joints: tuple[tuple[int, FloatArray], ...]) -> FloatArray:
    """(34) Of one rod of sections that end at ``ends``, ``stiffness`` (section, 3): thrust, axis, moments and turn, (13,)."""
    stiffness = np.minimum(stiffness, RIGID * stiffness[:, :2].max())
    n, soft = ELEMENTS + 1, _soft(ends, stiffness, np.array(length))
    K, M = np.zeros((2 * n + 2, 2 * n + 2)), np.concatenate([np.tile(length / ELEMENTS * PARTS, 2), [0.0, 0.0]])
    for plane in range(2):
        at = slice(plane * n, (plane + 1) * n)
        K[at, at] = _springs(1 / np.diff(soft[:, plane]))
    places = (np.array([0, n, 2 * n]), np.array([n - 1, 2 * n - 1, 2 * n + 1]))
    spins = [kind == SPHERICAL or (kind == REVOLUTE and abs(axis[2]) > ALONG) for kind, axis in joints]
    twist = 0.0 if any(spins) else 1 / soft[-1, 2]  # an end that spins bears no torque
    K[-2:, -2:] = twist * np.array([[1.0, -1.0], [-1.0, 1.0]])
    columns = [np.eye(2 * n + 2)[:, plane * n + 1 : plane * n + n - 1] for plane in range(2)]
    for (kind, axis), place, spin in zip(joints, places, spins, strict=True):
        own = np.eye(3)[:2] if kind == SPHERICAL else np.array([axis])[: int(kind == REVOLUTE and not spin)]
        columns.append(np.zeros((2 * n + 2, len(own))))
        columns[-1][place] = own.T
    T = np.concatenate(columns, axis=1)
    root = np.sqrt(M @ T**2)
    A = (T.T @ K @ T) / (root[:, None] * root)
    sides = np.zeros((2 * n + 2, 2))  # what the end moves aside by
    sides[:n, 0], sides[n : 2 * n, 1] = M[:n], M[n : 2 * n]
    Q = np.linalg.qr(T.T @ sides / root[:, None])[0]
    P = np.eye(len(A)) - Q @ Q.T
    values, vectors = np.linalg.eigh(P @ A @ P + 10 * np.diag(A).max() * Q @ Q.T)
    turn = np.sqrt(2 * length) * (T @ (vectors[:, 0] / root))
    if spins[0]:
        turn[2 * n] = turn[2 * n + 1]
    bends = (M[: 2 * n] * turn[: 2 * n]).reshape(2, n)[:, : n // 2].sum(axis=1)
    bends[np.abs(bends) < CRUMBS * np.abs(bends).max()] = 0.0
    turn *= np.sign(bends[np.abs(bends).argmax()])  # about a positive axis, as others
    rows = (K @ turn - values[0] * M * turn)[: 2 * n].reshape(2, n)
    rows -= (rows[:, 1:-1].sum(axis=1) / M[1 : n - 1].sum())[:, None] * M[:n]
    torque = twist * (turn[-1] - turn[-2])
    about = np.array([*(bends * np.sign(bends[np.abs(bends).argmax()]) / np.linalg.norm(bends)), 0.0])
    return np.array([values[0], *about, *-rows[:, 0], torque, *rows[:, -1], torque, *turn[places[0]]])


def _uneven(
    ends: FloatArray, stiffness: FloatArray, length: FloatArray, base: NDArray[np.bool_], end: NDArray[np.bool_]
) -> FloatArray:
    """(33) Of rods of several sections, which end at ``ends``, (count, section): the attributes of ``Modes``, (4, count)."""
    count, n, at = len(length), ELEMENTS + 1, np.arange(ELEMENTS)
    K = _springs(1 / np.diff(_soft(ends, stiffness[:, :, None], length)[..., 0], axis=1))
    M = (length / ELEMENTS)[:, None] * PARTS
    root = np.sqrt(M)
    held = np.stack([~base, ~end], axis=1)
    A, away = K / (root[:, :, None] * root[:, None]), np.zeros((count, n))
    far = 10 * A[:, at, at].max(axis=1)
    for node, own in zip((0, ELEMENTS), held.T, strict=True):
        A[own, node], A[own, :, node] = 0.0, 0.0
        A[own, node, node] = far[own]
        away[:, node] = own
    aside = np.where(away > 0, 0.0, root)  # no turn of the rod as one, which moves its end
    aside /= np.linalg.norm(aside, axis=1)[:, None]
    P = np.eye(n) - aside[:, :, None] * aside[:, None]
    values, vectors = np.linalg.eigh(P @ A @ P + far[:, None, None] * (aside[:, :, None] * aside[:, None]))
    thrust, turn = values[:, 0], np.sqrt(2 * length)[:, None] * vectors[:, :, 0] / root
    rows = (K @ turn[:, :, None])[:, :, 0] - thrust[:, None] * M * turn
    push = (rows * (1 - away)).sum(axis=1) / (M * (1 - away)).sum(axis=1)
    rows -= push[:, None] * M
    moments = np.stack([-rows[:, 0], rows[:, -1]]) * held.T
    side = np.where(np.where(base, turn[:, 0], moments[0]) < 0, -1.0, 1.0)
    return np.stack([thrust, side * moments[0], side * moments[1], np.where(base, side * turn[:, 0], 0.0)])


def _soft(ends: FloatArray, stiffness: FloatArray, length: FloatArray) -> FloatArray:
    """The angles that units of moment turn rods by from the base to where each element ends, (..., ELEMENTS + 1, k), of sections
    that end at ``ends`` (..., section) and are as stiff as ``stiffness`` (..., section, k)."""
    mesh = length[..., None] * np.linspace(0.0, 1.0, ELEMENTS + 1)
    begins = np.concatenate([np.zeros((*ends.shape[:-1], 1)), np.clip(ends[..., :-1], 0.0, None)], axis=-1)
    within = np.clip(mesh[..., :, None] - begins[..., None, :], 0.0, np.clip(ends - begins, 0.0, None)[..., None, :])
    return np.asarray((within[..., None] / stiffness[..., None, :, :]).sum(axis=-2))


def _springs(k: FloatArray) -> FloatArray:
    """Moments by the angles where elements end, (..., ELEMENTS + 1, ELEMENTS + 1), each as stiff as ``k`` (..., ELEMENTS)."""
    at = np.arange(ELEMENTS)
    result = np.zeros((*k.shape[:-1], ELEMENTS + 1, ELEMENTS + 1))
    for i, j, sign in ((at, at, 1.0), (at + 1, at + 1, 1.0), (at, at + 1, -1.0), (at + 1, at, -1.0)):
        result[..., i, j] += sign * k
    return result


def hinge_of(problem: "HeldProblem") -> FloatArray | None:
    """The axis across a straight rod, (3,), about which a round one buckles first, as it turns about it at one end or both; None
    where there is none, or two that differ."""
    holders = problem.holders
    joints = ((holders.base_joint, holders.base_axis), (holders.joint, holders.axis))
    axes = [axis for kind, axis in joints if kind == REVOLUTE and abs(axis[2]) < 1 - ALONG]
    if not axes or (len(axes) == 2 and abs(axes[0] @ axes[1]) < ALONG):
        return None
    across = axes[0] * [1.0, 1.0, 0.0]
    return np.asarray(across / np.linalg.norm(across))


def drawn_beside(problem: "HeldProblem") -> FloatArray:
    """(32) Where a round rod bends whose end is to be a little beside the axis of its base, or turned across it by as little, in
    the frame of the base, unit vectors (instance_count, 3); zero of all others."""
    holders, length = problem.holders, problem.length_in_use()[:, None]
    place, frame = problem.goal()
    away = np.einsum("bji,bj->bi", problem.base_frame, place - problem.rod.table.base_position.numpy()) / length
    tangent = np.einsum("bji,bj->bi", problem.base_frame, frame[:, :, 2])
    offset, tilt, force = (
        own * [1.0, 1.0, 0.0] for own in (away, tangent, np.einsum("bji,bj->bi", problem.base_frame, force_along(problem)))
    )
    short = np.clip(1 - np.linalg.norm(away, axis=1), 0.0, None)[:, None]
    root, size = np.sqrt(short), np.linalg.norm(offset, axis=1)[:, None]
    ball = holders.joint == SPHERICAL
    force *= (problem.length**2 / problem.stiffness)[:, None]
    pull = root * (force / np.pi - (HINGED * -np.sin(ROOT) * offset if ball else 4 * np.pi * tilt))
    drive = np.linalg.norm(pull, axis=1)[:, None]
    moment, _, torque, _, field = acting(problem).T
    told = torque | field | (moment & (holders.joint != CLAMPED))
    most = np.where(problem.bends == LED, FURTHER, 1.0)[:, None]
    near = (size < most * np.minimum(BESIDE, BESIDE_BEND * root)) & (np.linalg.norm(tilt, axis=1)[:, None] < BESIDE)
    near &= drive < SLIGHT
    near &= (size > 0) | tilt.any(axis=1)[:, None]
    chosen = near[:, 0] & problem.alike & ~told & (tangent[:, 2] > 0) & (holders.slide is None) & ~on_axis(problem)
    stiffness = problem.rod.each(problem.rod.arrays.material[:, 0, :, :3].mean(axis=1))
    softer = (stiffness[:, 2] <= stiffness[:, 0])[:, None]
    plane = np.where(softer, cross(AXIS, offset), offset) / np.where(size > 0, size, 1.0)
    along = (pull * plane).sum(axis=1)[:, None]
    sided = cross(to_side(problem, cross(AXIS, plane)), AXIS)
    plane = np.where(along != 0, np.sign(along) * plane, sided)
    way = np.where(ball | (drive > ROUND * short * size**2), pull / np.where(drive > 0, drive, 1.0), plane)
    return np.asarray(np.where(chosen[:, None], way, 0.0))


def to_side(problem: "HeldProblem", axis: FloatArray) -> FloatArray:
    """An axis (instance_count, 3) of the base or minus that: the rod that bends about it goes to the side asked for, by (5) of
    ``docs/branches.md``."""
    moves = np.einsum("bij,bj->bi", problem.base_frame, cross(axis, AXIS))
    first = leading_axis(np.abs(moves))
    return np.asarray(axis * problem.side * np.sign(moves[np.arange(len(moves)), first])[:, None])


def buckled(problem: "HeldProblem", axis: FloatArray, modes: Modes, size: FloatArray) -> FloatArray:
    """(23) Unknowns (instance_count, n) of rods that buckle about an axis (instance_count, 3), ``size`` (instance_count, 1) the
    root of what they are shortened by."""
    holders, m, whole = problem.holders, problem.rod.unknown_count, problem.length[:, None]
    about, unit, length = size * axis, problem.stiffness[:, None], problem.length_in_use()[:, None]
    result = np.zeros((problem.instance_count, problem.unknown_count))
    base, tip, turn = (own[:, None] * about for own in (modes.base_moment, modes.tip_moment, modes.base_turn))
    if (hinged := modes.hinged) is not None:
        chosen, side = hinged.chosen[:, None], size * np.sign((axis * hinged.about).sum(axis=1))[:, None]
        own = (hinged.base_moment, hinged.tip_moment, hinged.base_turn)
        base, tip, turn = (np.where(chosen, side * new, old) for new, old in zip(own, (base, tip, turn), strict=True))
    result[:, :3] = base / unit
    force = (whole / unit) * (cross(base - tip, AXIS) / length - modes.thrust[:, None] * AXIS)
    turned = turn @ holders.base_axes.T
    result[:, m - 3 : m] = np.einsum("bji,bj->bi", matrices(turned @ holders.base_axes), force)  # in the frame that turns
    result[:, m:] = turned / whole
    return result


def _turns(kind: int, own: FloatArray, axis: FloatArray) -> NDArray[np.bool_]:
    """Whether a joint, if revolute about its ``own`` axis, turns freely about an axis (instance_count, 3)."""
    return np.asarray((kind == SPHERICAL) | ((kind == REVOLUTE) & (np.abs(axis @ own) > ALONG)))


def pushed_far(problem: "HeldProblem", end: FloatArray, far: float = FAR) -> NDArray[np.bool_]:
    """Whether a rod that is straight at rest, and hardly stretches until it buckles, is shortened by ``far`` times that, its end
    at ``end``, (instance_count, 3); shape (instance_count,)."""
    material, length = problem.rod.arrays.material[:, 0], problem.length_in_use()
    soft, stretch = least_bending_stiffness(problem), problem.rod.each(material[..., 8].max(axis=1))
    strain = np.asarray(MODES[False, False].thrust * soft * stretch / length**2)
    short = 1 - np.linalg.norm(end - problem.rod.table.base_position.numpy(), axis=1) / length
    stiff = (strain > 0) & (strain < (STIFF_IN_MEDIUM if problem.rod.arrays.loads else STIFF)) & (problem.holders.slide is None)
    return np.asarray(stiff & (short > far * strain) & straight_at_rest(problem))


def begin_bent(problem: "HeldProblem", status: NDArray[np.int32], reached: FloatArray, tried: int) -> BegunAgain | None:
    """As ``BoundaryProblem.begin_again``: first what is pushed far beyond where it buckles, and came to an end on the way there,
    from where it is bent, as rods begin that do not give way; then what came nearly to its end, whose end stands further beside
    the axis than (32) is right to the first order, led as those nearer to it."""
    assert problem._begun is not None  # or nothing came to an end
    some, before = np.isin(status, (Status.STALLED, Status.BRANCH_END)), problem.bends.copy()
    if tried:
        some &= (reached > 1 - NEARLY) & ~problem.led
        problem.bends[some] = LED
        some &= drawn_beside(problem).any(axis=1)
    else:
        some &= ~problem._begun[1].bent & pushed_far(problem, problem.goal()[0], BEYOND)
    problem.bends[:] = np.where(some, LED if tried else BENT, before)
    return (some, problem.guess(), problem.guess_integrations) if some.any() else None


def straight(problem: "HeldProblem", status: NDArray[np.int32]) -> tuple[NDArray[np.bool_], FloatArray] | None:
    """(35) As ``BoundaryProblem.standing``: what is as long as its ends are apart, and bears what acts along it."""
    terms, whole, axis = problem.rod.features, problem.length_in_use(), problem.base_frame[:, :, 2]
    if problem.holders.slide is not None or terms.members or terms.loads or terms.profile_degree >= 0:
        return None
    away = problem.goal()[0] - problem.rod.table.base_position.numpy() - whole[:, None] * axis
    some = np.isin(status, (Status.STALLED, Status.BRANCH_END)) & (np.linalg.norm(away, axis=1) <= TAUT * whole)
    some &= straight_at_rest(problem) & loaded(problem)
    if not some.any():
        return None
    material = problem.rod.arrays.material[:, 0]
    soft, density = problem.rod.each(material[..., 8]), problem.rod.each(material[..., DENSITY])
    soft = np.where(soft.any(axis=1, keepdims=True), soft, 1.0)
    ends = problem.rod.each(problem.rod.arrays.end[:, 0]) + (whole - problem.length)[:, None]
    parts = np.diff(np.clip(ends, 0.0, None), axis=1, prepend=0.0)
    own, gravity = ((values * axis).sum(axis=1)[:, None] for values in forces(problem))
    pushed = (own + density * gravity) * parts
    borne = np.cumsum(pushed, axis=1) - 0.5 * pushed
    result = np.zeros((problem.instance_count, problem.unknown_count))
    pull = (soft * parts * borne).sum(axis=1) / (soft * parts).sum(axis=1)
    result[:, problem.rod.unknown_count - 1] = pull * problem.length / problem.stiffness
    return some, result
