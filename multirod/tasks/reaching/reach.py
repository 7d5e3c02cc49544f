"""A robot's inputs for a pose of its end effector. Numbers in parentheses: ``docs/tasks.md``."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from math import prod
from threading import Event, Lock
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from multirod import plausibility
from multirod.assembly import Assembly, Robot, Robot_co
from multirod.batch import IntArray, broadcast_shapes, parts, run, take, thread_count
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem
from multirod.results.scene import Scene
from multirod.results.solution import Solution
from multirod.reuse import borrowed
from multirod.running.simulation import as_solver, solve
from multirod.solver import Outcome, Solver
from multirod.status import Status, failures
from multirod.tasks.formulation import Task, freed, with_values
from multirod.tasks.limits import LimitRows, Limits, freed_labels, known_rows, middle, nearest, refuse_start, told
from multirod.tasks.reaching.drive import expect_search
from multirod.tasks.reaching.redundancy import steadied
from multirod.tasks.reaching.search import Goals, Place, Prefer, Search
from multirod.tasks.rows import Pose
from multirod.types import Index
from multirod.validation import (
    Described,
    FloatArray,
    choice,
    device_name,
    frozen,
    instance,
    positive_float,
    positive_int,
    refuse,
)

TOLERANCE = 1e-6  # of a target [1/m]: 0.16 um and 0.4 urad of 0.4 m
MAX_INTEGRATIONS = 300
TRIES = 32  # starts that a target is sought from, the nearest of all


class Reached(Solution[Robot_co]):
    """Equilibria whose end effectors are at their targets, or as near as limits let them be: a ``Solution``, and how near.

    Attributes:
        target: What was asked for.
        free: Names of the inputs that were chosen; ``inputs`` has their values.
        target_error: Distance from the position asked for [m], shape (...); also of an instance that failed, how near it came.
            NaN if no position was asked for.
        target_angle: Angle from the rotation or the axis asked for [rad], likewise.
        at_limit: Which of the freed numbers, in the order of ``free``, stand at a limit, shape (..., k).
    """

    def __init__(
        self,
        scene: Scene[Robot_co],
        records: FloatArray,
        outcome: Outcome,
        inputs: Inputs,
        *,
        target: Pose,
        free: Sequence[str],
        errors: FloatArray,
        at_limit: NDArray[np.bool_],
    ) -> None:
        super().__init__(scene, records, outcome, inputs)
        self.target, self.free = target, tuple(free)
        self.target_error = frozen(errors[:, 0].reshape(self.batch_shape))
        self.target_angle = frozen(errors[:, 1].reshape(self.batch_shape))
        self.at_limit = frozen(at_limit.reshape(*self.batch_shape, -1))

    @property
    def _asides(self) -> dict[str, str]:
        labels = freed_labels(self.free, [getattr(self.inputs, name).shape[-1] for name in self.free])
        held = ", ".join(label for label, own in zip(labels, self.at_limit, strict=True) if own)
        return told(float(self.target_error), float(self.target_angle), held)

    def __getitem__(self, index: Index) -> "Reached[Robot_co]":
        """The result of some instances: ``index`` as for an array with the leading axes ``batch_shape``."""
        plain: Any = super().__getitem__(index)
        result = object.__new__(Reached)
        result.__dict__.update(plain.__dict__)
        chosen: Any = index
        result.target, result.free = self.target, self.free
        result.target_error, result.target_angle = frozen(self.target_error[chosen]), frozen(self.target_angle[chosen])
        result.at_limit = frozen(self.at_limit[chosen])
        return result


@dataclass
class _Work:
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


@dataclass(frozen=True)
class _Pool:
    """Stable equilibria at scattered inputs: for all instances, or for each of some; axes (1 or instance, start, ...)."""

    unknowns: FloatArray
    values: FloatArray
    position: FloatArray
    rotation: FloatArray
    usable: NDArray[np.bool_]
    integrations: int


def reach(
    robot: Robot,
    target: Pose,
    inputs: Inputs | None = None,
    *,
    free: Sequence[str],
    limits: Limits | None = None,
    prefer: Prefer = "smallest motion",
    starts: int = 0,
    guess: Solution | None = None,
    solver: Solver | None = None,
    tolerance: float = TOLERANCE,
    max_integrations: int = MAX_INTEGRATIONS,
    device: str = "cpu",
    threads: int | None = None,
) -> Reached[Robot]:
    """Choose some inputs so that the end effector is at a target, in a stable equilibrium (``docs/tasks.md``).

    Unknowns and freed inputs step together, one integration of each rod a step. Where all of the way at once fails, or ends at an
    equilibrium that is not stable, the target is approached by parts of it. Leading axes of the target, the inputs and the robot
    broadcast: a batch is one call.

    Args:
        robot: The assembly.
        target: Where its end effector is to be: 3, 5 or 6 rows.
        inputs: Where the search begins, and all that is not free; those of ``guess`` by default.
        free: Names of the inputs to be chosen, such as ``("rotation", "translation")``.
        limits: Kept at every step; what the robot cannot do is a limit without them.
        prefer: What is done with freedom that the target leaves: the ``"smallest motion"`` from the start, the
            ``"smallest tension"`` of lines, by their squares, the ``"middle"`` of the limits, or the largest ``"stability"``
            margin.
        starts: How many other starts are scattered within the limits; what is not reached is tried from the nearest of them.
        guess: The equilibrium at ``inputs``, so that it need not be solved for.
        solver: For the start; its integrator is that of the search too. ``Shooting()`` by default.
        tolerance: Of the target [1/m]: positions count over the length of the longest rod squared, angles over that length.
        max_integrations: Allowed for one instance and start.
        device: Warp device.
        threads: That share the parts of a batch; one for each core by default.

    Returns:
        A solution with ``inputs``, ``target_error`` and ``at_limit``. Its status is ``REACHED``; ``AT_LIMIT`` where limits hold
        it back: as near as it comes; else a failure: ``UNREACHABLE``, ``SINGULAR_TASK``, ``UNSTABLE``, or that of the start. None
        ends farther off than it began: then it is the start that is returned.

    Raises:
        TypeError: If an argument is not what it must be, or an input is not one of the robot's.
        ValueError: If a number is out of range, limits exclude the start or leave nothing, or leading axes do not broadcast.
        NotImplementedError: If the derivatives by a freed input are not known.
    """
    method = as_solver(robot, solver)
    device = device_name("device", device)
    expect_search(device)
    instance("target", target, Pose, "a Pose, such as Pose(position=(0.1, 0, 0.2))")
    plausibility.of_place("target.position", target.position)
    if not target.whole:
        refuse("target", target, "must be finite: NaN is for a measurement that is missing")
    if guess is not None:
        instance("guess", guess, Solution, "a Solution")
    if limits is not None:
        instance("limits", limits, Limits, "Limits, such as Limits(translation=(-0.1, 0))")
    free = freed("free", robot, free)
    given = robot.accept(guess.inputs if inputs is None and guess is not None else inputs)
    for name in free:
        if name in given.profiles:
            refuse("free", free, f"{name} is a function of the arclength: it cannot be chosen")
    choice("prefer", prefer, get_args(Prefer))
    if starts != 0:
        positive_int("starts", starts, 0)
    try:
        shape = broadcast_shapes(given.batch_shape, robot.batch_shape, target.batch_shape)
    except ValueError:
        refuse("target", Described(f"leading axes {target.batch_shape}"), f"must broadcast with the inputs' {given.batch_shape}")
    rows, unit, problem_options = known_rows(robot, limits, free)
    begin = np.concatenate([_spread(getattr(given, name), shape) for name in free], axis=-1)
    refuse_start("limits", rows, begin.reshape(-1, begin.shape[-1]), robot, free)
    centre = middle(rows) if prefer == "middle" else None
    if prefer == "smallest tension":
        centre = _slack(robot, free, begin.reshape(-1, begin.shape[-1]))
    if centre is not None and np.isnan(centre).any():
        refuse("prefer", prefer, "needs limits on both sides of every freed input, which have a middle")
    first = solve(robot, given, solver=method, threads=threads, device=device, progress=False) if guess is None else guess
    unknowns = _spread(first.unknowns, shape).reshape(-1, first.unknown_count)
    work = _Work(
        robot=robot,
        target=target,
        inputs=given if shape == given.batch_shape and set(free) <= set(given.arrays) else with_values(given, free, begin),
        free=free,
        limits=rows,
        of_shape=limits if limits is not None and limits.of_shape else None,
        unit=unit,
        options=problem_options,
        centre=centre,
        prefer=prefer,
        starts=starts,
        method=method,
        tolerance=positive_float("tolerance", tolerance),
        max_integrations=positive_int("max_integrations", max_integrations),
        device=device,
        batch_shape=shape,
        unknowns=unknowns,
    )
    status = np.broadcast_to(np.asarray(first.status, dtype=np.int32), shape).reshape(-1)
    spent = np.zeros(len(status), dtype=np.int32)
    if guess is None:
        spent += np.broadcast_to(first.integrations, shape).reshape(-1)
    return _run(work, status, spent, thread_count(threads))


def _slack(robot: Assembly, free: tuple[str, ...], begin: FloatArray) -> FloatArray:
    """Where no line is tense and all else that is free is as at first, ``begin`` (b, k), shape (k,)."""
    if "tension" not in free:
        refuse("prefer", "smallest tension", "needs tension to be free")
    sizes = {spec.name: spec.size(robot.rod_count) for spec in robot.input_specs}
    others = np.concatenate([np.full(sizes[name], name != "tension") for name in free])
    if np.ptp(begin[:, others], axis=0).any():
        refuse("prefer", "smallest tension", "needs what else is free to begin at one place for all targets")
    return np.where(others, begin[0] if len(begin) else 0.0, 0.0)


def _spread(values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Rows (..., n) with these leading axes."""
    return values if values.shape[:-1] == shape else np.broadcast_to(values, (*shape, values.shape[-1]))


def _run(work: _Work, status: NDArray[np.int32], spent: NDArray[np.int32], threads: int) -> Reached[Any]:
    count, k = prod(work.batch_shape), len(work.unit)
    records: dict[str, Any] = {}
    outcome = Outcome(np.array(status), *np.zeros((2, count), dtype=np.int32))
    errors, values = np.full((count, 2), np.nan), np.zeros((count, k))
    at_limit = np.zeros((count, k), dtype=bool)
    pieces = parts(count, threads, work.robot.rod_count) if count else []

    def one(piece: slice, stop: Event) -> None:
        numbers = None if piece == slice(0, count) else np.arange(piece.start, piece.stop)
        settings: dict[str, Any] = {"integrator": work.method.integrator, "device": work.device, "instances": numbers}
        with ExitStack() as held:
            with work.lock:
                made = borrowed(work.robot, work.inputs, **settings, **work.options)
                problem: BoundaryProblem = held.enter_context(made)
                problem.stop = stop
            search = _search(work, problem, piece, numbers, status[piece])
            found, fields = problem.snapshot(), dict(problem.record_fields)
            with work.lock:
                if "all" not in records:
                    records["all"], records["fields"] = np.empty((count, found.shape[1])), fields
                records["all"][piece] = found
            outcome.status[piece], outcome.iterations[piece] = search.status, search.iterations
            outcome.integrations[piece] = spent[piece] + search.integrations
            values[piece] = search.last.p
            errors[piece] = _errors(search)
            at_limit[piece] = search.held(np.arange(len(found))) & ~failures(search.status)[:, None]

    run(one, pieces, threads)
    fields = {name: place for name, place in records["fields"].items() if name != "inputs"}
    scene = Scene(work.robot, work.batch_shape, work.method.integrator, work.device, fields, threads=threads)
    inputs = with_values(work.inputs, work.free, values.reshape(*work.batch_shape, k))
    result = Reached(scene, records["all"], outcome, inputs, target=work.target, free=work.free, errors=errors, at_limit=at_limit)
    if not work.batch_shape:
        result._remarks = work.limits.remarks(values[0], work.target.position, float(result.target_error))
    result.mind_strain()
    return result


def _errors(search: Search) -> FloatArray:
    """Distance [m] and angle [rad] from the targets, shape (b, 2)."""
    rows, result = search.goals.rows, np.full((len(search.errors), 2), np.nan)
    begin = 0
    if rows.position is not None:
        result[:, 0] = np.linalg.norm(search.errors[:, :3] / rows.weight[0], axis=1)
        begin = 3
    if rows.count > begin:
        result[:, 1] = np.linalg.norm(search.errors[:, begin:] / rows.weight[1], axis=1)
    return result


def _search(work: _Work, problem: BoundaryProblem, piece: slice, numbers: IntArray | None, status: NDArray[np.int32]) -> Search:
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
    x = np.where(sound[:, None], problem.adopt(work.unknowns[piece]), 0.0)
    search = Search(task, goals, x, task.values())
    within = sound.copy()
    rows = np.flatnonzero(sound)
    within[rows] = ~search.beyond(rows)
    search.sought(within)
    search.status[~sound], search.status[sound & ~within] = status[~sound], Status.OUT_OF_LIMITS
    if work.starts:
        _from_elsewhere(work, search, piece, sound)
    if work.prefer == "stability":
        steadied(search)
    search.returned()
    search.leave()
    return search


def _from_elsewhere(work: _Work, search: Search, piece: slice, sound: NDArray[np.bool_]) -> None:
    """Try again from other starts, for each instance the nearest ones first."""
    open_ = sound & (search.status != Status.REACHED)
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
        open_ &= search.status != Status.REACHED


def _pool(work: _Work, search: Search, piece: slice) -> _Pool:
    """Scattered starts; one pool for all instances that differ in nothing but their targets."""
    others = [name for name in work.inputs.arrays if name not in work.free]
    alike = not work.robot.batch_shape and all(work.inputs.array(name).ndim == 1 for name in others)
    origin = search.origin
    if not alike or np.ptp(origin, axis=0).any():
        return _scattered(work, search, origin, np.arange(piece.start, piece.stop))
    with work.lock:
        if work.pool is None:
            work.pool = _scattered(work, search, origin[:1], np.arange(piece.start, piece.start + 1))
        return work.pool


def _scattered(work: _Work, search: Search, origin: FloatArray, numbers: IntArray) -> _Pool:
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
        if name not in work.free:
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
