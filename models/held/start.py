"""Where the path of a held rod begins that is straight at rest and cannot give way there: bent to an arc, or as it buckles.

Numbers in parentheses are those of ``docs/held.md``.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.models.backbone.kernels.loads.foundation import Foundation, RisingFoundation
from multirod.models.held.buckling import (
    FAR,
    MODES,
    buckled,
    drawn_beside,
    hinge_of,
    hinged_strips,
    modes_about,
    pushed_far,
    to_side,
)
from multirod.models.held.costless import (
    AXIS,
    between_balls,
    drawn_aside,
    force_along,
    free_in_balls,
    hold_base,
    loaded,
    pulled,
    straight_at_rest,
    swing,
    turned_to,
)
from multirod.models.held.kernels.arguments import ACROSS, BALL_AND_CLAMP, BESIDE, IN_BALLS
from multirod.results.events import BranchEvent
from multirod.rotations import cross, matrices, vectors
from multirod.status import Status
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.held.holders import Holders
    from multirod.models.held.problem import HeldProblem
    from multirod.rod.arrays import RodArrays

ANGLE = 1.0  # of an arc [rad]
ASIDE = 0.3  # part of that across the plane in which the end moves: no symmetry lets a branch end on the way
INTEGRATIONS_AT_REST = 3
SETTLING = 4  # and more where a rod begins buckled
REGULAR = 1e-7  # smallest singular value of Gamma at rest, from which the path begins there
SINGULAR = 1e-12  # the same, to rounding
STRETCHES = 1e-11  # the same of thin rods that stretch, however little
SAME = 1e-9  # of its length, and rad: what the end may be aside of where it is at rest, and no rod has to bend for
# of its length, what a rod is shortened by that begins buckled: from where on it is, the least where its end is turned, the most
BUCKLED, TURNED, MOST = 1e-6, 0.05, 0.3
WEIGHED, AT_MOST = 0.1, 0.5  # load in EI/L^2 by which both sides are weighed, and the part of its own that it is at most
WEIGHING = 3  # integrations of each
NOTED = 1e-11  # of EI/L: the least difference between their energies that is no rounding: integration errs alike in mirror images
HARDLY = 1e-3  # load across a rod whose end slides, in EI/L^2, under which it is held in the plane that this tells
TOUCH = 1e-3  # load in EI/L^2 by which it is told where forces draw a rod
BUCKLING = 0.01  # the same of one between two balls under forces


@dataclass(frozen=True)
class Begun:
    """Where a path begins.

    Attributes:
        unknowns: [1/m], shape (instance_count, n).
        residual: There [1/m], which closes along the path, shape (instance_count, n).
        least: Least singular value of ``Gamma`` there, shape (instance_count,).
        integrations: That it took, shape (instance_count,).
        passed: By instance, where it buckles that begins beyond.
        beside: (32) Whether it is led to an end beside the axis of its base, 0 or 1, shape (instance_count,).
        bent: Whether a rod that is straight at rest begins bent, shape (instance_count,).
    """

    unknowns: FloatArray
    residual: FloatArray
    least: FloatArray
    integrations: IntArray
    passed: dict[int, BranchEvent]
    beside: IntArray
    bent: NDArray[np.bool_]


@dataclass(frozen=True)
class Start:
    """Where paths begin.

    Attributes:
        unknowns: Shape (instance_count, n).
        direct: Whether the path leads straight from there to the end, shape (instance_count,).
        buckled: Whether it is nearly the equilibrium of a rod whose end stands at ``end``, shape (instance_count,).
        twin: The same, buckled to the other side, where nothing but loads and ``side`` tells which, shape (instance_count, n).
        twofold: Whether that is so, shape (instance_count,).
        end: On the axis of the base, in the world, shape (instance_count, 3).
        way: Along which its middle begins to move, in the world, shape (instance_count, 3).
        thrust: Under which it buckles [N], shape (instance_count,).
    """

    unknowns: FloatArray
    direct: NDArray[np.bool_]
    buckled: NDArray[np.bool_]
    twin: FloatArray
    twofold: NDArray[np.bool_]
    end: FloatArray
    way: FloatArray
    thrust: FloatArray


def begun_without_medium(holders: "Holders") -> "RodArrays":
    """The rod; if it does not stretch, nor its end slides, with its medium raised on the path: pushed together it begins buckled
    as (23) says, which is no equilibrium in a stiff medium."""
    arrays = holders.arrays
    if holders.slide is not None or arrays.material[..., 6:9].any() or Foundation not in arrays.loads:
        return arrays
    return replace(arrays, loads=tuple(RisingFoundation if load is Foundation else load for load in arrays.loads))


def begin(problem: "HeldProblem") -> Begun:
    """The rod at rest, its end where that is; where it is straight there and its end does not slide, a little bent."""
    x = np.zeros((problem.instance_count, problem.unknown_count))
    buckled, weighed, beside = np.zeros((3, problem.instance_count), dtype=bool)
    turned = np.zeros(problem.instance_count, dtype=np.intp)
    passed: dict[int, BranchEvent] = {}
    for array in (problem.table.opening, problem.table.direct, problem.table.beside):
        array.zero_()
    with problem.everyone(), problem.at_load(0.0):
        problem.evaluate(x)
        position, rotation = problem.rod.read("position"), problem.rod.read("rotation").reshape(-1, 3, 3)
        problem.table.rest_position.assign(position)
        problem.table.rest_turn.assign(vectors(problem.end_frame @ np.swapaxes(rotation, 1, 2)))
        led = between_balls(problem)[0]
        if led.any():
            x, buckled, turned = _led(problem, x, np.array(position), led)
            position = np.array(problem.table.rest_position.numpy())
        taut = pulled(problem)
        problem.table.swing.assign(swing(problem, position, taut))
        residual, gamma = problem.evaluate(x)
        if buckled.any():
            x, residual, gamma = _settled(problem, x, residual, gamma, buckled)
        least = _least_singular_value(gamma)
        gives_way = (least > REGULAR) | ((least > STRETCHES) & taut)
        stuck = ~gives_way & ~_stays(problem, position, rotation) & ~led
        if stuck.any() or problem.rod.features.shear:
            by_place = np.where(led[:, None], 0.0, drawn_beside(problem))
            aside = np.where(led[:, None], 0.0, drawn_aside(problem)) + by_place
            start = bent_rods(problem, x, aside)
            far = start.twofold & pushed_far(problem, start.end) & ~stuck & ~led
            passed = _passed(problem, start, far & ~loaded(problem) & ~by_place.any(axis=1))
            stuck |= far | ((problem.bends > 0) & ~led)
        if stuck.any():
            x = np.where(stuck[:, None], start.unknowns, x)
            problem.table.direct.assign((stuck & start.direct).astype(np.int32))
            begins = stuck & start.buckled
            drawn, beside = begins & aside.any(axis=1), begins & by_place.any(axis=1)
            _draw(problem, aside, drawn, x)
            problem.table.beside.assign(beside.astype(np.int32) * BESIDE)
            buckled |= begins
            problem.table.rest_position.assign(np.where(begins[:, None], start.end, position))
            residual, gamma = problem.evaluate(x)
            if begins.any():
                x, residual, gamma = _settled(problem, x, residual, gamma, begins)
            weighed = begins & start.twofold & loaded(problem) & ~drawn
            if weighed.any():
                x, residual, gamma = _lower(problem, x, start, weighed)
            least = _least_singular_value(gamma)
        if problem.holders.slide is not None:
            aside = np.where(led[:, None], 0.0, drawn_aside(problem))
            beside = aside.any(axis=1) & (np.linalg.norm(aside, axis=1) < HARDLY) & ~stuck
            _draw(problem, aside, beside, x)
            problem.table.beside.assign(beside.astype(np.int32) * BESIDE)
    integrations = INTEGRATIONS_AT_REST + turned + SETTLING * buckled + (2 + SETTLING + 2 * WEIGHING) * weighed
    return Begun(x, residual, least, integrations, passed, beside.astype(np.int32), stuck)


def _draw(problem: "HeldProblem", aside: FloatArray, drawn: NDArray[np.bool_], unknowns: FloatArray) -> None:
    """(31) Hold on the way those that are ``drawn``, (instance_count,), by forces ``aside``, (instance_count, 3), in their plane;
    (29) a base in a ball as it is turned by ``unknowns``."""
    pull, table = np.linalg.norm(aside, axis=1), problem.table
    table.drawn.assign(np.where(drawn[:, None], aside / np.where(drawn, pull, 1.0)[:, None], 0.0))
    table.leading.assign(np.where(drawn, np.minimum(pull, 1.0), table.leading.numpy()))
    if (clamped := table.balls.numpy() == BALL_AND_CLAMP).any():
        turn = problem.length[:, None] * unknowns[:, problem.rod.unknown_count :]
        hold_base(problem, turn, np.broadcast_to(AXIS, turn.shape), clamped)


def _led(
    problem: "HeldProblem", unknowns: FloatArray, position: FloatArray, led: NDArray[np.bool_]
) -> tuple[FloatArray, NDArray[np.bool_], IntArray]:
    """(30) The ``led``, between two balls, turned as one to where their ends are to be and forces draw them; which of them begin
    buckled, and how many integrations it took. The end of the rod at rest is at ``position`` (instance_count, 3)."""
    frame, m, length = problem.base_frame, problem.rod.unknown_count, problem.length_in_use()
    base = np.broadcast_to(problem.rod.table.base_position.numpy(), position.shape)
    way, rest = (np.einsum("bji,bj->bi", frame, own - base) for own in (problem.goal()[0], position))
    apart, reach = np.linalg.norm(way, axis=1), np.linalg.norm(rest, axis=1)
    led = led & (np.minimum(apart, reach) > SAME * length)
    axis, own = (v / np.where(led, size, 1.0)[:, None] for v, size in ((way, apart), (rest, reach)))
    swung = np.where(
        led[:, None, None], turned_to(np.where(led[:, None], own, AXIS), np.where(led[:, None], axis, AXIS)), np.eye(3)
    )
    force = np.einsum("bji,bj->bi", frame, force_along(problem))
    drawn = force - (force * axis).sum(axis=1)[:, None] * axis
    drawn[np.linalg.norm(drawn, axis=1) <= SAME * np.linalg.norm(force, axis=1)] = 0.0
    load = np.linalg.norm(drawn, axis=1) * length**2 / problem.rod.sizes.least_stiffness
    stiffness = problem.rod.each(problem.rod.arrays.material[:, 0, 0, :2])
    straight, even = straight_at_rest(problem), stiffness[:, 0] == stiffness[:, 1]
    # of a round rod the plane in which it bends, of others the angle by which it is turned about the line between the balls
    softer = np.where((stiffness[:, 0] < stiffness[:, 1])[:, None], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    pulled = np.einsum("bji,bj->bi", swung, drawn)
    size = np.linalg.norm(pulled, axis=1)[:, None]
    about = np.where((even[:, None]) & (size > 0), cross(AXIS, pulled) / np.where(size > 0, size, 1.0), softer)
    about = np.where(size > 0, about, to_side(problem, about))
    bow = np.einsum("bij,bj->bi", swung, cross(about, AXIS))
    angle = np.where(size[:, 0] > 0, _angle(bow, drawn, axis), 0.0)
    bent = led & ~straight & (size[:, 0] > 0)
    if bent.any():
        angle = np.where(bent, _drawn_to(problem, unknowns, swung, axis, load, bent), angle)
    turn = matrices(axis * angle[:, None]) @ swung
    short = np.clip(1 - apart / length, 0.0, MOST)
    stretch = problem.rod.each(problem.rod.arrays.material[:, 0, :, 8].max(axis=1))
    strain = MODES[True, True].thrust * stiffness.min(axis=1) * stretch / length**2
    pushed = (strain < BUCKLING) & (short > np.maximum(BUCKLED, FAR * strain)) & (problem.holders.slide is None)
    buckles = led & straight & pushed
    modes = modes_about(problem, about, buckles)
    x = np.where(buckles[:, None], buckled(problem, about, modes, np.sqrt(short)[:, None]), unknowns)
    turned = vectors(turn @ matrices(problem.length[:, None] * x[:, m:]))
    x[:, m:] = turned / problem.length[:, None]
    hold_base(problem, turned, axis, led)
    problem.table.leading.assign(np.where(led, np.minimum(load, 1.0), 0.0))
    begin = base + np.einsum("bij,bj->bi", frame, axis) * np.where(buckles, (1 - short) * length, reach)[:, None]
    problem.table.rest_position.assign(np.where(led[:, None], begin, position))
    return np.where(led[:, None], x, unknowns), buckles, 2 * bent.astype(np.intp)


def _drawn_to(
    problem: "HeldProblem", unknowns: FloatArray, swung: FloatArray, axis: FloatArray, load: FloatArray, bent: NDArray[np.bool_]
) -> FloatArray:
    """(30) By which angles about ``axis`` the ``bent`` rods at rest are turned from ``swung`` where forces on them do the most
    work, shape (instance_count,): by the moment of these about that, here and a quarter of a turn further."""
    m, world = problem.rod.unknown_count, np.einsum("bij,bj->bi", problem.base_frame, axis)
    moments = []
    with problem.at_load(TOUCH / np.maximum(load, 1.0)):
        for angle in (0.0, 0.5 * np.pi):
            x = np.array(unknowns)
            turned = vectors(matrices(angle * axis) @ swung)
            x[:, m:] = np.where(bent[:, None], turned / problem.length[:, None], 0.0)
            problem.evaluate(x)
            moments.append(-(world * problem.rod.tip_wrench.numpy()[:, 3:]).sum(axis=1))
    return np.asarray(np.arctan2(moments[0], -moments[1]))


def _angle(v: FloatArray, other: FloatArray, axis: FloatArray) -> FloatArray:
    """From vectors (count, 3) to others, about unit axes across both, shape (count,)."""
    return np.asarray(np.arctan2((cross(v, other) * axis).sum(axis=1), (v * other).sum(axis=1)))


def _stays(problem: "HeldProblem", position: FloatArray, rotation: FloatArray) -> NDArray[np.bool_]:
    """Whether the end is held where it is at rest, (instance_count, 3) and (instance_count, 3, 3), nothing acts, and the rod is
    bent there, so that its force is determined, if only just; shape (instance_count,)."""
    place, frame = problem.goal()
    away = np.linalg.norm(place - position, axis=1) / problem.length_in_use()
    turned = np.linalg.norm(vectors(frame @ np.swapaxes(rotation, 1, 2)), axis=1) + np.abs(problem.read("inputs")[:, 0])
    return np.asarray((away + turned < SAME) & ~loaded(problem) & ~straight_at_rest(problem))


def _passed(problem: "HeldProblem", start: Start, far: NDArray[np.bool_]) -> dict[int, BranchEvent]:
    """(26) Where rods buckle whose ends are pushed ``far``, (instance_count,), beyond."""
    if not far.any():
        return {}
    material, length = problem.rod.arrays.material[:, 0], problem.length_in_use()
    stretch = problem.rod.each(material[..., 8].max(axis=1))
    shear = problem.rod.each(material[..., 6:8].max(axis=(1, 2)))
    more = shear - stretch
    thrust = 2 * start.thrust / (1 + np.sqrt(1 + 4 * start.thrust * more))
    short = 1 - np.linalg.norm(start.end - problem.rod.table.base_position.numpy(), axis=1) / length
    return {
        k: BranchEvent(
            status=Status.BIFURCATED,
            fold=False,
            load_factor=float(thrust[k] * stretch[k] / short[k]),
            progress=np.nan,
            energy_lost=0.0,
            tip_displacement=np.zeros(3),
            rod_displacement=start.way[k],
        )
        for k in np.flatnonzero(far).tolist()
    }


def _settled(
    problem: "HeldProblem", x: FloatArray, residual: FloatArray, gamma: FloatArray, chosen: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The ``chosen`` after some steps of Newton's method, with residual and ``Gamma``; as they were where these lead away."""
    first, residuals, gammas = x, residual, gamma
    for _ in range(SETTLING):
        x = x - _newton_step(residual, gamma, chosen)
        residual, gamma = problem.evaluate(x)
    with np.errstate(invalid="ignore"):
        away = ~(np.abs(residual).max(axis=1) < np.abs(residuals).max(axis=1)) | ~chosen
    x[away], residual[away], gamma[away] = first[away], residuals[away], gammas[away]
    return x, residual, gamma


def _lower(
    problem: "HeldProblem", x: FloatArray, start: Start, weighed: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of ``x`` and its twin that on which the loads do work, with residual and ``Gamma``: by the energies at a part of the load,
    the end where it is, which must differ by more than rounding."""
    twin = np.where(weighed[:, None], start.twin, x)
    twin = _settled(problem, twin, *problem.evaluate(twin), weighed)[0]
    level = np.minimum(WEIGHED / np.maximum(problem.load_scale(), WEIGHED), AT_MOST)
    standing = problem.table.rest_position.numpy()
    problem.table.rest_position.assign((standing - level[:, None] * problem.goal()[0]) / (1 - level)[:, None])
    energies = []
    with problem.at_load(level):
        for own in (x, twin):
            found = own
            for _ in range(WEIGHING):
                found = found - _newton_step(*problem.evaluate(found), weighed)
            problem.write("unknowns", found)
            energies.append(problem.stability.potential())
    problem.table.rest_position.assign(standing)
    with np.errstate(invalid="ignore"):
        better = weighed & (energies[1] < energies[0] - NOTED * problem.stiffness / problem.length)
    x = np.where(better[:, None], twin, x)
    return x, *problem.evaluate(x)


def _newton_step(residual: FloatArray, gamma: FloatArray, chosen: NDArray[np.bool_]) -> FloatArray:
    """Of the ``chosen``, (instance_count, n): of least norm where ``Gamma`` is singular, as of a rod that spins in two balls."""
    step, least = np.zeros_like(residual), _least_singular_value(gamma)
    size = SINGULAR * np.maximum(1.0, np.abs(gamma).sum(axis=(1, 2)))
    regular, others = chosen & (least > size), chosen & (least <= size)
    step[regular] = np.linalg.solve(gamma[regular], residual[regular, :, None])[..., 0]
    step[others] = (np.linalg.pinv(gamma[others], rcond=SINGULAR) @ residual[others, :, None])[..., 0]
    return step


def _least_singular_value(gamma: FloatArray) -> FloatArray:
    """Of matrices (batch, n, n); NaN where they are not finite."""
    least = np.full(len(gamma), np.nan)
    sound = np.isfinite(gamma).all(axis=(1, 2))
    least[sound] = np.linalg.svd(gamma[sound], compute_uv=False)[:, -1]
    return least


def bent_rods(problem: "HeldProblem", unknowns: FloatArray, aside: FloatArray) -> Start:
    """(4), (23), (31) What is straight at rest, at ``unknowns`` (instance_count, n), bent; ``aside`` is where forces draw round
    ones, (instance_count, 3), in ``EI/L^2``.

    As a column buckles, strips, and others where a turn about the axis of the base will cost nothing; else to an arc, by a moment
    at the end; and where the end of such a one is turned by more than ``ANGLE``, to an arc of that turn. Strips bend about their
    softer axis, others about that about which the end is turned, if it is across the axis of the base, else about y: so that the
    moment at the base of a column that buckles is about the positive axis.
    """
    length = problem.length_in_use()[:, None]
    turn = problem.read("inputs")[:, problem.input_slice("end_rotation")] + problem.table.rest_turn.numpy()
    across = np.einsum("bji,bj->bi", problem.base_frame, turn) * [1.0, 1.0, 0.0]
    size = np.linalg.norm(across, axis=1)[:, None]
    stiffness = problem.rod.each(problem.rod.arrays.material[:, 0, 0, :2])
    softer = np.where(stiffness[:, :1] < stiffness[:, 1:], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    uneven, hinge = stiffness[:, :1] != stiffness[:, 1:], hinge_of(problem)
    if hinge is not None:
        softer = np.where(uneven, softer, hinge)
    if (hinged := hinged_strips(problem)) is not None:
        softer = np.where(hinged.chosen[:, None], hinged.about, softer)
    turned, neutral = size > ACROSS, problem.goal_is_neutral()[:, None]
    sign = np.where(loaded(problem), 1, problem.side)[:, None]
    axis = np.where(turned, across / np.maximum(size, ACROSS), -sign * softer)
    direct = neutral & (size > ANGLE)
    # of a strip that begins aside of the plane in which it buckles, the path ends in an unstable state
    buckles = (neutral & ~direct) | uneven | (hinge is not None) | (free_in_balls(problem) > IN_BALLS)[:, None]
    base = np.broadcast_to(problem.rod.table.base_position.numpy(), axis.shape)
    short = 1 - np.linalg.norm(problem.goal()[0] - base, axis=1)[:, None] / length
    pull = np.linalg.norm(aside, axis=1)[:, None]
    short = np.clip(short, np.where(turned & ~neutral & (pull == 0), TURNED, 0.0), MOST)
    drawn = (pull > 0) & (short > BUCKLED)
    buckles = buckles | drawn
    beside = np.stack([axis[:, 1], -axis[:, 0], axis[:, 2]], axis=1)
    arc = np.where(direct, across, ANGLE * (axis + ASIDE * beside)) / length
    result = np.array(unknowns)
    result[:, :2] += np.where(buckles, 0.0, arc[:, :2] * stiffness / problem.stiffness[:, None])
    along = (axis * softer).sum(axis=1)[:, None]
    about = np.where(neutral, -axis, np.where(along > 0, -softer, softer))
    told = turned & (neutral | (np.abs(along) > ACROSS))  # by the way in which the end is turned
    about = np.where(told, about, to_side(problem, about))
    about = np.where(drawn, cross(AXIS, aside) / np.where(drawn, pull, 1.0), about)
    begins = (buckles & (short > BUCKLED))[:, 0]
    modes = modes_about(problem, about, buckles[:, 0], hinged)
    bent = [np.where(buckles, buckled(problem, sign * about, modes, np.sqrt(short)), 0.0) for sign in (1.0, -1.0)]
    end = base + (1 - short) * length * problem.base_frame[:, :, 2]
    way = np.einsum("bij,bj->bi", problem.base_frame, cross(about, AXIS))
    return Start(result + bent[0], direct[:, 0], begins, result + bent[1], begins & ~told[:, 0], end, way, modes.thrust)
