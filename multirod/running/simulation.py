"""Solving one set of inputs, a motion, or a batch of either."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from math import prod
from threading import Event, Lock
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod import plausibility
from multirod.assembly import Assembly, Robot
from multirod.batch import IntArray, broadcast_shapes, parts, run, thread_count
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.naming import hinted, names_checked
from multirod.problem import BoundaryProblem
from multirod.results.history import History
from multirod.results.scene import Scene, stand_in
from multirod.results.solution import Solution
from multirod.reuse import borrowed
from multirod.running.gathered import Results
from multirod.running.progress import Watch
from multirod.segments import Breakpoints, taken
from multirod.solver import Left, Solver, Tested
from multirod.solvers.multiple_shooting import NOISY, MultipleShooting
from multirod.solvers.shooting import Shooting
from multirod.studies.terms.simplify import simplified
from multirod.types import Numbers
from multirod.validation import FEW, Described, FloatArray, array, device_name, first_of, integers, refuse

EVEN = 1e-6  # of a step, by which steps may differ that are the same
_DEFAULT = Shooting()
_BLOCK = 2**20  # numbers: inputs are made ready for as many samples at once


def as_robot(robot: Robot) -> Robot:
    """``robot``; refuses what is none."""
    if not isinstance(robot, Assembly):
        raise TypeError(f"robot must be an assembly such as SingleRod(rod), not {type(robot).__name__}")
    return robot


def as_solver(robot: object, solver: object) -> Solver:
    """``solver``, or the one that is meant by None; refuses what is none, and what is no robot."""
    as_robot(robot)  # type: ignore[type-var]  # of anything
    if solver is None:
        return _DEFAULT
    if not isinstance(solver, Solver):
        made = isinstance(solver, type) and issubclass(solver, Solver)
        hint = f": make one, {solver.__name__}()" if made else ""  # type: ignore[attr-defined]
        hint = f": give it to one, Shooting(integrator={solver!r})" if isinstance(solver, Integrator) else hint
        raise TypeError(f"solver must be a Solver such as Shooting(), not {type(solver).__name__}{hint}")
    return solver


def _needs(solver: Solver) -> dict[str, Any]:
    return {
        "integrator": solver.integrator,
        "pose_sensitivities": solver.pose_sensitivities,
        "direction_count": solver.direction_count,
    }


@hinted(
    "inputs are made by the robot, solve(robot, robot.inputs(tip_force=...)), and options are the solver's, "
    "solver=Shooting(tolerance=1e-9)"
)
def solve(
    robot: Robot,
    inputs: Inputs | None = None,
    *,
    solver: Solver | None = None,
    guess: Solution | Numbers | None = None,
    device: str = "cpu",
    threads: int | None = None,
    instances: Sequence[int] | NDArray[np.integer[Any]] | None = None,
    simplify: float | None = None,
    progress: bool | Callable[[int], object] = True,
) -> Solution[Robot]:
    """Static equilibrium of every instance of ``inputs`` and of the robot's own leading axes.

    A batch is solved in parts, on several threads. An instance is bitwise the same whatever the parts and threads.

    Args:
        robot: The assembly.
        inputs: Made by ``robot.inputs(...)``; none are all zero.
        solver: ``Shooting()`` by default.
        guess: Where to start: a ``Solution``, also one under other loads, or unknowns (..., n). A robot without loads takes the
            more unknowns of the same robot under loads too, and leaves out those that it has not. Instances of a
            ``Solution`` that failed start without a guess. Without one, the equilibrium on the natural branch is meant: the one
            reached from the unloaded assembly by raising all loads in proportion.
        device: Warp device.
        threads: That share the parts of a batch on the CPU; one for each core by default.
        instances: Numbers, in the flattened batch, of the only ones to be solved, shape (k,): the result has that shape.
        simplify: Drop the terms that together move no tip by more than this times the length in use (``docs/explain.md``); the
            solution is then of the robot and inputs without them, and ``solution.dropped`` names them. Of parallel robots that is
            an estimate, which does not see legs that buckle.
        progress: Whether to show a bar, in a terminal or a notebook, where it takes more than two seconds; or a function
            that is called with the number of instances done.

    Returns:
        One equilibrium an instance, each with its status; an instance that fails never raises.

    Raises:
        TypeError, ValueError: If an argument is not what it must be.
    """
    method = as_solver(robot, solver)
    device = device_name("device", device)
    robot, inputs, dropped = simplified(robot, robot.accept(inputs), simplify)
    whole = broadcast_shapes(inputs.batch_shape, robot.batch_shape)
    chosen = None if instances is None else _numbers(instances, prod(whole))
    batch_shape = whole if chosen is None else chosen.shape
    count = prod(batch_shape)
    workers = thread_count(threads)
    pieces = parts(count, workers, robot.rod_count, device) if count else []
    results, lock = Results(1, count), Lock()
    lefts: list[Left] = []
    if not count:
        results.put_none(stand_in(robot, inputs, device=device, **_needs(method)))

    def work(piece: slice, stop: Event) -> None:
        some = _some(chosen, piece, count)
        with ExitStack() as held:
            with lock:
                problem = held.enter_context(borrowed(robot, inputs, device=device, instances=some, **_needs(method)))
                problem.stop = stop
                start = unknowns_of_guess(guess, problem, count, piece)
                problem.breakpoints = states_of_guess(guess, problem, count, piece)
            outcome = method.solve(problem, start, leave=len(pieces) > 1)
            results.put(0, np.arange(piece.start, piece.stop), problem.snapshot(), outcome, problem)
        if outcome.left is not None:
            lefts.append(outcome.left.behind(piece.start))
        watch.advance(piece.stop - piece.start - (0 if outcome.left is None else len(outcome.left.numbers)))

    def finish(piece: slice, stop: Event) -> None:
        own = left.take(piece)
        some = own.numbers if chosen is None else chosen[own.numbers]
        with ExitStack() as held:
            with lock:
                problem = held.enter_context(borrowed(robot, inputs, device=device, instances=some, **_needs(method)))
                problem.stop = stop
            outcome = method.finish(problem, own)
            results.put(0, own.numbers, problem.snapshot(), outcome, problem)
        watch.advance(len(own.numbers))

    with Watch("solving", count, progress) as watch:
        run(work, pieces, workers)
        if lefts:
            left = Left.joined(lefts)
            run(finish, parts(len(left.numbers), workers, robot.rod_count, device), workers)
    scene = Scene(robot, batch_shape, method.integrator, device, results.fields, threads=workers, dropped=dropped)
    solution = Solution(scene, results.records[0], results.outcome(), inputs, chosen)
    solution.mind_strain()
    return solution


@names_checked
def simulate(
    robot: Robot,
    inputs: Inputs,
    *,
    time: Numbers,
    solver: Solver | None = None,
    guess: Solution | Numbers | None = None,
    device: str = "cpu",
    threads: int | None = None,
    simplify: float | None = None,
    progress: bool | Callable[[int], object] = True,
) -> History[Robot]:
    """Follow a motion from sample to sample, or a batch of motions.

    Args:
        robot: The assembly.
        inputs: Made by ``robot.inputs(...)``, with time as the first axis of what varies.
        time: Of the samples [s], increasing, shape (sample_count,); evenly spaced or not.
        solver: ``Shooting()`` by default.
        guess: Unknowns at the first sample, as for ``solve``.
        device: Warp device.
        threads: That share the parts of a batch on the CPU; one for each core by default.
        simplify: As for ``solve``: a term is dropped only where it may be in all samples.
        progress: Whether to show a bar, in a terminal or a notebook, where it takes more than two seconds; or a function
            that is called with the number of samples done.

    Returns:
        The series, each sample with its status and the time that it took.

    Raises:
        ValueError: If ``time`` does not increase, is not evenly spaced though a solver of others goes by one step, or the inputs'
            first axis is not time.
    """
    method = as_solver(robot, solver)
    device = device_name("device", device)
    inputs = robot.accept(inputs)
    time, spans = sample_times(time)
    dt = float(spans.mean())
    even = bool(np.allclose(spans, dt, rtol=EVEN, atol=0))
    if not (even or method.takes_uneven or not method.needs_dt):
        refuse("time", _told(time), f"must be evenly spaced, by {type(method).__name__}, which goes by one step")
    if method.needs_dt and len(time) > 1:
        plausibility.of_dt("time", dt)
    samples = len(time)
    if inputs.batch_shape and inputs.batch_shape[0] not in (1, samples):
        refuse("inputs", Described(f"leading axes {inputs.batch_shape}"), f"the first must be time, {samples} samples")
    batch_shape = np.broadcast_shapes(inputs.batch_shape[1:], robot.batch_shape)
    robot, inputs, dropped = simplified(robot, inputs, simplify, _with_time(inputs, samples, batch_shape))
    count = prod(batch_shape)
    workers = thread_count(threads)
    pieces = parts(count, workers, robot.rod_count, device) if count else []
    results, lock = Results(samples, count), Lock()
    step_time = np.zeros((len(pieces), samples))
    if count * samples:
        first = inputs[0] if inputs.batch_shape else inputs
    else:
        results.put_none(stand_in(robot, inputs, device=device, **_needs(method)))
        pieces = []

    def work(piece: slice, stop: Event) -> None:
        some = _some(None, piece, count)
        with lock:
            runner = Runner(robot, method, first, dt, device, inputs.active, instances=some)
            runner.start(guess, count, piece)
        problem, took, places = runner.problem, step_time[pieces.index(piece)], np.arange(piece.start, piece.stop)
        problem.stop = stop
        rows = _samples(problem, inputs, samples, batch_shape, some)
        for k in range(samples):
            row = next(rows, None)
            begin = perf_counter()
            if row is not None:
                problem.write("inputs", row)
            if not even:
                runner.track.pace(*spans[k : k + 2])
            outcome = runner.track.step()
            took[k] = perf_counter() - begin
            results.put(k, places, problem.snapshot(), outcome, problem)
            watch.advance()

    with Watch("samples", samples, progress, shares=len(pieces)) as watch:
        run(work, pieces, workers)
    history = History(
        Scene(robot, (samples, *batch_shape), method.integrator, device, results.fields, threads=workers, dropped=dropped),
        results.records.reshape(samples * count, results.records.shape[-1]),
        results.outcome(),
        _with_time(inputs, samples, batch_shape),
        time=time,
        step_time=step_time.sum(axis=0),
        description=", ".join([repr(method), *(f"without {term}" for term in dropped)]),
    )
    history.mind_strain()
    return history


class Runner:
    """A problem and the solver's track on it."""

    def __init__(
        self,
        robot: Assembly,
        solver: Solver,
        inputs: Inputs,
        dt: float,
        device: str,
        enabled: Iterable[str],
        *,
        instances: IntArray | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        needs = _needs(solver) | dict(options or {})
        needs["enabled"] = (*enabled, *needs.get("enabled", ()))
        self.problem: Any = robot.problem(inputs, device=device, instances=instances, **needs)
        reasons = solver.unsupported(self.problem)
        if reasons:
            raise ValueError(f"{type(solver).__name__} cannot take this problem: " + "; ".join(reasons))
        track = solver.track(self.problem, dt)
        self.track = track if self.problem.result_test is None else Tested(track)

    def start(self, guess: object, count: int, piece: slice) -> None:
        """Start from a guess of ``count`` instances, of which the problem's are a piece; None is no guess."""
        unknowns = unknowns_of_guess(guess, self.problem, count, piece)
        if unknowns is not None:
            self.problem.breakpoints = states_of_guess(guess, self.problem, count, piece)
            self.track.start(unknowns)


def _some(chosen: IntArray | None, piece: slice, count: int) -> IntArray | None:
    """Numbers of the instances of a part; None where it is all of a whole batch."""
    if chosen is not None:
        return chosen[piece]
    return None if piece == slice(0, count) else np.arange(piece.start, piece.stop)


def _numbers(instances: object, count: int) -> IntArray:
    values = integers("instances", instances)
    if values.size and not (values.min() >= 0 and values.max() < count):
        refuse("instances", Described(f"{values.min()} to {values.max()}"), f"must be from 0 to {count - 1}")
    return values


def unknowns_of_guess(guess: object, problem: BoundaryProblem, count: int, piece: slice | IntArray) -> FloatArray | None:
    """A guess of the problem's unknowns, (instance_count, n), from a solution or an array of all ``count`` instances."""
    if guess is None:
        return None
    wanted = f"a Solution or its unknowns, shape (..., {problem.unknown_count})"
    values = guess.unknowns if isinstance(guess, Solution) else array("guess", guess, finite=False, wanted=wanted)
    if not (isinstance(guess, Solution) or (known := np.isfinite(values)).all()):
        refuse("guess", first_of(~known, values, guess), "must be finite")
    if not values.size and count:
        refuse("guess", Described(f"array of shape {values.shape}"), f"must have shape (..., {problem.unknown_count})")
    flat = values.reshape(-1, values.shape[-1] if values.ndim else 1)
    longer = flat.shape[1] > problem.unknown_count and not isinstance(guess, Solution)
    if longer and problem.load_scale().any():  # what is unloaded takes the unknowns of what is loaded too
        refuse("guess", Described(f"array of shape {values.shape}"), f"must have shape (..., {problem.unknown_count})")
    if len(flat) not in (1, count):
        refuse("guess", Described(f"array of shape {values.shape}"), f"must broadcast to {count} instances")
    rows = flat if len(flat) == 1 else flat[piece]
    try:
        known = np.array(problem.adopt(np.broadcast_to(rows, (problem.instance_count, rows.shape[1]))))
    except ValueError:
        if not isinstance(guess, Solution):
            raise
        kind, size = type(guess.assembly).__name__, rows.shape[1]
        given = f"a {type(guess).__name__} of {kind} that has {size} unknowns{' an instance' * bool(guess.batch_shape)}"
        refuse("guess", Described(given), f"must be of this robot, which has {problem.unknown_count} here")
    return guess.assembly.begin_at(known, guess, problem, piece) if isinstance(guess, Solution) else known


def states_of_guess(guess: object, problem: BoundaryProblem, count: int, piece: slice) -> dict[int, Breakpoints]:
    """The states of a guess whose unknowns alone hardly lead to its tip, by the problem's instances, where they are such as the
    problem has: those that it is known by, or to which an integration at its own inputs leads."""
    if not isinstance(guess, Solution) or (segments := problem.segments) is None:
        return {}
    alone = prod(guess.batch_shape) == 1
    places = np.zeros(problem.instance_count, dtype=int) if alone else np.arange(problem.instance_count)
    rows = places if alone else np.arange(count)[piece]
    known = taken(guess._outcome.breakpoints, rows)
    with np.errstate(invalid="ignore", over="ignore"):
        sensitive = np.linalg.norm(guess._records[rows][:, guess._scene.fields["gamma"]], axis=1) > NOISY
    sensitive &= ~guess._failed[rows]
    if sensitive.any():
        with guess._problem(None if alone else piece) as there:
            if there.segments is not None:
                method = MultipleShooting(integrator=guess._scene.integrator)
                led = method.states(there, np.unique(places[sensitive]))
                known |= {k: led[places[k]] for k in np.flatnonzero(sensitive).tolist() if places[k] in led}
    size = segments.base_state(np.zeros(1, dtype=int), problem.guess()[:1]).shape[1] if known else 0
    return {k: own for k, own in known.items() if own.states.shape[1] == size}


def sample_times(time: object) -> tuple[FloatArray, FloatArray]:
    """Checked times of samples, and the time before each and after the last, shape (sample_count + 1,): at the ends as next to
    them, of one sample a second."""
    time = array("time", time)
    if time.ndim != 1:
        refuse("time", Described(f"array of shape {time.shape}"), "must have shape (sample_count,)")
    steps = np.diff(time)
    if len(steps) and not steps.min() > 0:
        refuse("time", _told(time), "must increase from each sample to the next")
    return time, np.pad(steps, 1, mode="edge") if len(steps) else np.ones(len(time) + 1)


def _told(time: FloatArray) -> object:
    return time if time.size < FEW else Described(f"{time.size} samples")


def _samples(
    problem: BoundaryProblem, inputs: Inputs, samples: int, batch_shape: tuple[int, ...], instances: IntArray | None
) -> Iterator[FloatArray]:
    """Rows of the inputs for each sample, made ready in blocks; none where nothing moves."""
    if samples == 1 or not inputs.batch_shape or inputs.batch_shape[0] != samples:
        return
    constant = problem.read("inputs")
    block = max(1, _BLOCK // constant.size)
    chosen = slice(None) if instances is None else instances
    for start in range(0, samples, block):
        present = inputs[start : start + block]
        rows = np.repeat(constant[None], present.batch_shape[0], axis=0)
        for name in present.arrays:
            value = getattr(present, name)
            own = value.reshape(len(value), *(1,) * (len(batch_shape) - value.ndim + 2), *value.shape[1:])
            every = np.broadcast_to(own, (len(value), *batch_shape, value.shape[-1]))
            rows[..., problem.input_slice(name)] = every.reshape(len(value), -1, value.shape[-1])[:, chosen]
        yield from rows


def _with_time(inputs: Inputs, count: int, batch_shape: tuple[int, ...]) -> Inputs:
    """The inputs with all axes, time first: what does not vary is repeated."""
    own = inputs.batch_shape or (1,)
    shape = (own[0], *(1,) * (len(batch_shape) - len(own) + 1), *own[1:])
    arrays = {}
    for name in inputs.arrays:
        value = getattr(inputs, name)
        arrays[name] = np.broadcast_to(value.reshape(*shape, value.shape[-1]), (count, *batch_shape, value.shape[-1]))
    return inputs.with_arrays(arrays, (count, *batch_shape))
