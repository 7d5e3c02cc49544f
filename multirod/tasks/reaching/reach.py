"""A robot's inputs for a pose of its end effector. Numbers in parentheses: ``docs/tasks.md``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from threading import Event
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from multirod import plausibility
from multirod.assembly import Robot
from multirod.batch import broadcast_shapes, parts, run, thread_count
from multirod.inputs import Inputs
from multirod.naming import names_checked
from multirod.results.scene import Scene, stand_in
from multirod.results.solution import Solution
from multirod.reuse import borrowed
from multirod.running.simulation import as_solver, solve
from multirod.solver import Outcome, Solver
from multirod.tasks.formulation import Task
from multirod.tasks.freed import chosen, values_of, with_values
from multirod.tasks.limits import Limits, asked_before, known_rows, refuse_start
from multirod.tasks.preferred import centre_of
from multirod.tasks.reaching.drive import expect_search
from multirod.tasks.reaching.goals import Prefer
from multirod.tasks.reaching.reached import Aim, Chosen, Ends, Reached, ShapeHolds, Start
from multirod.tasks.reaching.trying import Work, held_by_shape, search_part
from multirod.tasks.rows import ON_TARGET, Pose
from multirod.validation import (
    Described,
    FloatArray,
    choice,
    device_name,
    first_of,
    instance,
    positive_float,
    positive_int,
    refuse,
)

MAX_INTEGRATIONS = 300
PREFERENCES = get_args(Prefer)


@names_checked
def reach(
    robot: Robot,
    target: Pose,
    inputs: Inputs | None = None,
    *,
    free: str | Sequence[str] | Mapping[str, Sequence[str] | None],
    limits: Limits | None = None,
    prefer: Prefer = "smallest motion",
    starts: int = 0,
    guess: Solution | None = None,
    solver: Solver | None = None,
    tolerance: float | None = None,
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
        free: Names of the inputs to be chosen, such as ``("rotation", "translation")``; also of what,
            ``{"translation": ["leg 0", "leg 1"], "angle": None}``, where None is all. All of ``rotation`` and ``translation`` is
            what motors do: of a network that says which rods are ``driven``, such as a ``multibackbone``, theirs.
        limits: Kept at every step; what the robot cannot do is a limit without them.
        prefer: What is done with freedom that the target leaves: the ``"smallest motion"`` from the start, the
            ``"smallest tension"`` of lines, by their squares, the ``"middle"`` of the limits, or the largest ``"stability"``
            margin.
        starts: How many other starts are scattered within the limits; what is not reached is tried from the nearest of them.
        guess: The equilibrium at ``inputs``, so that it need not be solved for.
        solver: For the start; its integrator is that of the search too. ``Shooting()`` by default.
        tolerance: Of the target [1/m]: positions count over the length of the longest rod squared, angles over that length. None,
            the default, is 4e-7 over that length: 4e-7 of it, and 4e-7 rad.
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
    if not target.ordinary:
        plausibility.of_place("target.position", target.position)
        if not target.whole:
            name, value = next((name, own) for name in target.given if not np.isfinite(own := getattr(target, name)).all())
            says = "must be finite: NaN is for a measurement that is missing; a batch has no instance without a target"
            part = "of a position, across=direction leaves one coordinate free, along=direction two"
            refuse(f"target.{name}", first_of(~np.isfinite(value), value, value), f"{says}; {part}")
    if target.measures or target.at is not None:
        refuse("target", target, "must be without sigma, covariance and at, which are of measurements")
    if guess is not None:
        instance("guess", guess, Solution, "a Solution")
    if limits is not None:
        instance("limits", limits, Limits, "Limits, such as Limits(translation=(-0.1, 0))")
    known = asked_before(robot, limits, free)
    names = chosen("free", robot, free) if known is None else free if isinstance(free, tuple) else tuple(free)
    given = robot.accept(guess._applied if inputs is None and guess is not None else inputs)
    if given.profiles:
        for name in names:
            if name in given.profiles:
                refuse("free", names, f"{name} is a function of the arclength: it cannot be chosen")
    choice("prefer", prefer, PREFERENCES)
    positive_int("starts", starts, 0)
    try:
        shape = broadcast_shapes(given.batch_shape, robot.batch_shape, target.batch_shape)
    except ValueError:
        refuse("target", Described(f"leading axes {target.batch_shape}"), f"must broadcast with the inputs' {given.batch_shape}")
    rows, unit, problem_options = known_rows(robot, limits, names) if known is None else known
    whole = shape == given.batch_shape and given.has(names)
    begin = _begin(given, names, shape, whole)
    refuse_start("limits", rows, begin.reshape(-1, begin.shape[-1]), robot, names)
    centre = centre_of("prefer", prefer, robot, names, rows, begin.reshape(-1, begin.shape[-1]))
    first = solve(robot, given, solver=method, threads=threads, device=device, progress=False) if guess is None else guess
    unknowns = _with_axes(first.unknowns, shape).reshape(-1, first.unknown_count)
    work = Work(
        robot=robot,
        target=target,
        inputs=given if whole else with_values(given, names, begin),
        free=names,
        limits=rows,
        of_shape=limits if limits is not None and limits.of_shape else None,
        unit=unit,
        options=problem_options,
        centre=centre,
        prefer=prefer,
        starts=starts,
        method=method,
        tolerance=ON_TARGET / robot.longest if tolerance is None else positive_float("tolerance", tolerance),
        max_integrations=positive_int("max_integrations", max_integrations),
        device=device,
        batch_shape=shape,
        unknowns=unknowns,
    )
    status = np.asarray(first.status, dtype=np.int32)
    status = (status if status.shape == shape else np.broadcast_to(status, shape)).reshape(-1)
    spent = np.zeros(len(status), dtype=np.int32)
    if guess is None:
        spent += np.broadcast_to(first.integrations, shape).reshape(-1)
    result = _run(work, status, spent, thread_count(threads))
    vars(result).update(_start=Start.of(first, shape))
    return result


def _begin(given: Inputs, free: tuple[str, ...], shape: tuple[int, ...], whole: bool) -> FloatArray:
    """The freed numbers of inputs with these leading axes, one input after another, shape (..., k); ``whole`` whether all were
    given so."""
    if whole and not shape:
        return values_of(given, free)
    return _with_axes(values_of(given, free), shape)


def _with_axes(values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Rows (..., n) with these leading axes."""
    return values if values.shape[:-1] == shape else np.broadcast_to(values, (*shape, values.shape[-1]))


def _run(work: Work, status: NDArray[np.int32], spent: NDArray[np.int32], threads: int) -> Reached[Any]:
    whole, of_shape = _Part.joined(_found(work, status, spent, threads)), work.of_shape
    shapes = () if of_shape is None else of_shape.shape_names
    aim = Aim(work.target, work.free, work.limits, work.unit, shapes, whole.weight, work.tolerance)
    chosen = Chosen(work.inputs, work.free, whole.places, work.batch_shape)
    scene = Scene(work.robot, work.batch_shape, work.method.integrator, work.device, whole.fields, chosen, threads=threads)
    result: Reached[Any] = Reached(scene, whole.records, Outcome(*whole.ended), aim, whole.ends)
    result.mind_strain()
    return result


def _found(work: Work, status: NDArray[np.int32], spent: NDArray[np.int32], threads: int) -> "list[_Part]":
    """What comes of each part of the batch, in their order."""
    count = prod(work.batch_shape)
    if not count:
        return [_none(work)]
    pieces = parts(count, threads, work.robot.rod_count, work.device)
    found: dict[int, _Part] = {}

    def one(piece: slice, stop: Event) -> None:
        numbers = None if len(pieces) == 1 else np.arange(piece.start, piece.stop)
        settings: dict[str, Any] = {"integrator": work.method.integrator, "device": work.device, "instances": numbers}
        with work.lock:
            loan = borrowed(work.robot, work.inputs, **settings, **work.options)
        with loan as problem:
            problem.stop = stop
            search = search_part(work, problem, piece, numbers, status[piece])
            records = problem.snapshot()
            ended = search.status.copy(), search.iterations.copy(), spent[piece] + search.integrations
            ends = Ends(search.errors.copy(), held_by_shape(work, search, piece))
            places, weight = search.task.places, search.goals.rows.weight
            found[piece.start] = _Part(records, ended, ends, problem.record_fields, places, weight)

    run(one, pieces, threads)
    return [found[piece.start] for piece in pieces]


@dataclass
class _Part:
    """What comes of a part of a batch: records of its problem, status, iterations and integrations, how the search ended; where
    fields of records are, where freed numbers stand in a row of inputs, and the weight of rows."""

    records: FloatArray
    ended: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]
    ends: Ends
    fields: dict[str, slice]
    places: NDArray[np.intp]
    weight: FloatArray

    @classmethod
    def joined(cls, parts: "list[_Part]") -> "_Part":
        """All of a batch, which may be one part alone."""
        first = parts[0]
        if len(parts) == 1:
            return first
        status, iterations, integrations = (np.concatenate([part.ended[k] for part in parts]) for k in range(3))
        records, ends = np.concatenate([part.records for part in parts]), Ends.joined([part.ends for part in parts])
        return cls(records, (status, iterations, integrations), ends, first.fields, first.places, first.weight)


def _none(work: Work) -> _Part:
    """What comes of no instance."""
    problem = stand_in(work.robot, work.inputs, integrator=work.method.integrator, device=work.device, **work.options)
    rows, nobody = work.target.rows(work.robot.longest, work.batch_shape), np.zeros(0, dtype=np.int32)
    by_shape = None
    if work.of_shape is not None:
        numbers, limits = (np.zeros((0, size), dtype=bool) for size in (len(work.unit), len(work.of_shape.shape_names)))
        by_shape = ShapeHolds(numbers, limits)
    ends = Ends(np.zeros((0, rows.count)), by_shape)
    places = Task(problem, work.free).places
    return _Part(problem.snapshot()[:0], (nobody, nobody, nobody), ends, problem.record_fields, places, rows.weight)
