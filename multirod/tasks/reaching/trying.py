"""The search of a batch in parts, and from elsewhere where it stops. Numbers in parentheses: ``docs/tasks.md``."""

from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.batch import IntArray, take
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem
from multirod.running.simulation import solve
from multirod.solver import Solver
from multirod.status import Status, failures
from multirod.tasks.controlling.shape_limits import INSET
from multirod.tasks.formulation import Task
from multirod.tasks.freed import whole, with_values
from multirod.tasks.limits import LimitRows, Limits, nearest
from multirod.tasks.reaching.anew import anew, met_past_folds
from multirod.tasks.reaching.border import bordered
from multirod.tasks.reaching.easing import eased
from multirod.tasks.reaching.goals import Goals, Place, Prefer
from multirod.tasks.reaching.nearing import neared
from multirod.tasks.reaching.reached import ShapeHolds
from multirod.tasks.reaching.redundancy import steadied
from multirod.tasks.reaching.search import AT_LIMIT, REACHED, Search
from multirod.tasks.reaching.sliding import Slid, slid
from multirod.tasks.reaching.tightened import tightened
from multirod.tasks.rows import Pose
from multirod.validation import (
    FloatArray,
)

TRIES = 32  # starts that a target is sought from, the nearest of all


@dataclass
class Work:
    """What the parts of a batch have in common."""

    robot: Assembly
    target: Pose
    inputs: Inputs
    free: tuple[str, ...]
    limits: LimitRows
    of_shape: Limits | None
    unit: FloatArray
    options: dict[str, Any]
    centre: FloatArray | None
    prefer: Prefer
    starts: int
    method: Solver
    tolerance: float
    max_integrations: int
    device: str
    batch_shape: tuple[int, ...]
    unknowns: FloatArray
    lock: Lock = field(default_factory=Lock)
    pool: "_Pool | None" = None
    slid: dict[int, Slid] = field(default_factory=dict)  # along limits of the shape, by instance


@dataclass(frozen=True)
class _Pool:
    """Stable equilibria at scattered inputs: for all instances, or for each of some; axes (1 or instance, start, ...)."""

    unknowns: FloatArray
    values: FloatArray
    position: FloatArray
    rotation: FloatArray
    usable: NDArray[np.bool_]
    integrations: int


def search_part(
    work: Work, problem: BoundaryProblem, piece: slice, numbers: IntArray | None, status: NDArray[np.int32]
) -> Search:
    """All of one part of a batch."""
    task, length = Task(problem, work.free), work.robot.longest
    goals = Goals(
        rows=work.target.rows(length, work.batch_shape, numbers),
        limits=work.limits,
        of_shape=work.of_shape,
        unit=work.unit,
        length=length,
        tolerance=work.tolerance,
        residual_tolerance=problem.tolerance(getattr(work.method, "tolerance", None)),
        centre=work.centre,
        max_integrations=work.max_integrations,
    )
    sound = ~failures(status)
    x, whole = problem.adopt(work.unknowns[piece]), bool(sound.all())
    search = Search(task, goals, x if whole else np.where(sound[:, None], x, 0.0), task.values())
    within = sound
    if work.of_shape is not None:
        rows, within = np.flatnonzero(sound), sound.copy()
        within[rows] = ~search.beyond(rows)
    search.sought(within)
    if not search.all_reached:
        search.status[~sound], search.status[sound & ~within] = status[~sound], Status.OUT_OF_LIMITS
        tightened(search, within)
        rows = met_past_folds(search, within)
        if len(rows) and not work.robot.batch_shape:
            own = piece.start + rows
            inputs = work.inputs.take(work.batch_shape, own) if work.batch_shape else work.inputs.broadcast_to((1,))
            anew(search, rows, work.robot, inputs, work.method)
        if work.of_shape is not None and not work.robot.batch_shape:
            _along_limits(work, search, piece, np.flatnonzero(within & (search.status != REACHED)))
        if work.starts:
            _from_elsewhere(work, search, piece, sound)
    if work.prefer == "stability":
        steadied(search)
    if not search.all_reached:
        search.returned()
        neared(search, within)
        for row, ended in bordered(search, within).items():
            held_by = () if work.of_shape is None else tuple(np.array(work.of_shape.shape_names)[ended.held].tolist())
            place = search.last.x[row].copy(), search.last.p[row].copy()
            work.slid[piece.start + row] = Slid(*place, ended.numbers, held_by)
        eased(search)
    search.leave()
    return search


def held_by_shape(work: Work, search: Search, piece: slice) -> ShapeHolds | None:
    """What limits of the shape hold of results, if there are any.

    Of what slid along one to where it is, the last step says so; of what stopped before one, it holds all.
    """
    if work.of_shape is None:
        return None
    count, names = len(search.status), work.of_shape.shape_names
    numbers, limits = np.zeros((count, len(work.unit)), dtype=bool), np.zeros((count, len(names)), dtype=bool)
    rows = np.flatnonzero(search.status == AT_LIMIT)
    for row in rows.tolist():
        found = work.slid.get(piece.start + row)
        if found is not None and np.array_equal(found.values, search.last.p[row]):
            numbers[row] = found.at_limit
            limits[row] = np.isin(names, found.held_by)
    near = work.limits.near(search.last.p[rows], work.unit)
    stopped = rows[~(near.any(axis=1) | limits[rows].any(axis=1))]
    if len(stopped):
        left = search.room(stopped)
        numbers[stopped], limits[stopped] = True, left <= left.min(axis=1, keepdims=True) + INSET
    return ShapeHolds(numbers, limits)


def _along_limits(work: Work, search: Search, piece: slice, rows: IntArray) -> None:
    """Take those along limits of the shape that stopped before them, and on to their targets from where that leads."""
    assert work.of_shape is not None
    x, p, going = np.zeros((len(rows), search.last.x.shape[1])), np.zeros((len(rows), search.last.p.shape[1])), []
    for k, row in enumerate(rows.tolist()):
        number = piece.start + row
        inputs = work.inputs.take(work.batch_shape, np.array([number]))[0] if work.batch_shape else work.inputs
        found, spent = slid(
            work.robot,
            search.goals.rows.take(slice(row, row + 1)),
            inputs,
            work.unknowns[number],
            free=work.free,
            limits=work.of_shape,
            solver=work.method,
            device=work.device,
            tolerance=work.tolerance,
            max_integrations=work.max_integrations,
        )
        search.integrations[row] += spent
        if found is not None:
            x[k], p[k] = search.task.problem.adopt(found.unknowns[None])[0], found.values
            work.slid[number] = found
            going.append(k)
    if not going:
        return
    rows, place = rows[going], Place(x[going], p[going])
    search.begin(rows, place)
    chosen = np.zeros(len(search.status), dtype=bool)
    chosen[rows] = True
    search.tried(chosen)
    left = search.status[rows] != REACHED
    search.rest_at_limit(rows[left], Place(place.x[left], place.p[left]))


def _from_elsewhere(work: Work, search: Search, piece: slice, sound: NDArray[np.bool_]) -> None:
    """Try again from other starts, for each instance the nearest ones first."""
    open_ = sound & (search.status != REACHED)
    if not open_.any():
        return
    pool = _pool(work, search, piece)
    shared = len(pool.values) == 1
    search.integrations[open_] += 0 if shared else pool.integrations
    rows = np.flatnonzero(open_)
    distance = np.full((len(open_), pool.values.shape[1]), np.inf)
    for row in rows.tolist():
        own = 0 if shared else row
        goal = search.goals.rows.take(slice(row, row + 1))
        away = np.linalg.norm(goal.errors(pool.position[own], pool.rotation[own])[0], axis=1)
        distance[row] = np.where(pool.usable[own], away, np.inf)
    order = np.argsort(distance, axis=1)
    for attempt in range(min(TRIES, order.shape[1])):
        rows = np.flatnonzero(open_)
        taken = order[rows, attempt]
        usable = np.isfinite(distance[rows, taken])
        rows, taken = rows[usable], taken[usable]
        if not len(rows):
            return
        place = np.zeros(len(rows), dtype=np.intp) if shared else rows
        search.begin(rows, Place(pool.unknowns[place, taken], pool.values[place, taken]))
        chosen = np.zeros(len(open_), dtype=bool)
        chosen[rows] = True
        search.tried(chosen)
        open_ &= search.status != REACHED


def _pool(work: Work, search: Search, piece: slice) -> _Pool:
    """Scattered starts; one pool for all instances that differ in nothing but their targets."""
    others = [name for name in work.inputs.arrays if name not in whole(work.free)]
    alike = not work.robot.batch_shape and all(work.inputs.array(name).ndim == 1 for name in others)
    origin = search.origin
    if not alike or np.ptp(origin, axis=0).any():
        return _scattered(work, search, origin, np.arange(piece.start, piece.stop))
    with work.lock:
        if work.pool is None:
            work.pool = _scattered(work, search, origin[:1], np.arange(piece.start, piece.start + 1))
        return work.pool


def _scattered(work: Work, search: Search, origin: FloatArray, numbers: IntArray) -> _Pool:
    """Equilibria at inputs that are scattered within the limits, around the start where there are none."""
    random = np.random.default_rng(len(origin))
    count, starts, k = len(origin), work.starts, origin.shape[1]
    limits = work.limits
    reach = np.where(work.unit == 1.0, np.pi, 2 * work.unit)
    low, high = np.broadcast_to(origin - reach, (count, k)).copy(), np.broadcast_to(origin + reach, (count, k)).copy()
    for row, least, most in zip(limits.matrix, limits.low, limits.high, strict=True):
        own = np.flatnonzero(row)
        if len(own) == 1:
            low[:, own[0]] = np.maximum(low[:, own[0]], least) if np.isinf(least) or np.isinf(most) else least
            high[:, own[0]] = np.minimum(high[:, own[0]], most) if np.isinf(least) or np.isinf(most) else most
    wanted = low[:, None] + random.uniform(size=(count, starts, k)) * (high - low)[:, None]
    begin = np.repeat(origin, starts, axis=0)
    wanted = wanted.reshape(-1, k)
    drawn = nearest(limits, wanted, work.unit)
    # what was outside is drawn in from the border that it was put on
    outside = (limits.outside(wanted, work.unit) > 0).any(axis=1, keepdims=True)
    inwards = random.uniform(0.6, 1.0, size=(len(begin), 1)) ** outside
    values = (begin + inwards * (drawn - begin)).reshape(count, starts, k)
    arrays = {}
    for name, given in work.inputs.arrays.items():
        if name not in whole(work.free):
            other = take(given, work.batch_shape, numbers, tail=1)
            arrays[name] = np.repeat(other[:, None], starts, axis=1)
    robot, sides = work.robot, with_values(work.inputs.with_arrays(arrays), work.free, values)
    if robot.batch_shape:
        raise NotImplementedError("starts need a robot whose parameters have no leading axes")
    found = solve(robot, sides, solver=work.method, device=work.device, threads=1, progress=False)
    usable = ~found.failed & np.isin(found.stability, (0, 1))
    adopted = search.task.problem.adopt(np.nan_to_num(found.unknowns.reshape(count * starts, -1)))
    return _Pool(
        adopted.reshape(count, starts, -1),
        values,
        np.nan_to_num(found.tip_position),
        np.where(usable[..., None, None], found.tip_rotation, np.eye(3)),
        usable,
        int(found.integrations.sum() // count),
    )
