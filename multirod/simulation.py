"""Solving one set of inputs, a motion, or one sample at a time."""

from math import inf
from time import perf_counter
from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem
from multirod.solution import History, Scene, Solution
from multirod.solver import Outcome, Solver
from multirod.solvers.shooting import Shooting
from multirod.validation import Described, FloatArray, array, positive_float, refuse, unknown_names


def _check(robot: object, solver: object) -> Solver:
    if not isinstance(robot, Assembly):
        raise TypeError(f"robot must be an assembly such as SingleRod(rod), not {type(robot).__name__}")
    if solver is None:
        return Shooting()
    if not isinstance(solver, Solver):
        raise TypeError(f"solver must be a Solver such as Shooting(), not {type(solver).__name__}")
    return solver


def _guess(guess: Any, problem: BoundaryProblem) -> FloatArray | None:
    """A guess of the unknowns as (instance_count, n), from a solution or an array."""
    if guess is None:
        return None
    values = guess.unknowns if isinstance(guess, Solution) else array("guess", guess)
    flat = values.reshape(-1, values.shape[-1] if values.ndim else 1)
    if len(flat) not in (1, problem.instance_count):
        refuse("guess", Described(f"array of shape {values.shape}"), f"must broadcast to {problem.instance_count} instances")
    return np.array(problem.adopt(np.broadcast_to(flat, (problem.instance_count, flat.shape[1]))))


def _needs(solver: Solver) -> dict[str, Any]:
    return {
        "integrator": solver.integrator,
        "pose_sensitivities": solver.pose_sensitivities,
        "direction_count": solver.direction_count,
    }


def solve(
    robot: Assembly, inputs: Inputs | None = None, *, solver: Solver | None = None, guess: Any = None, device: str = "cpu"
) -> Solution:
    """Static equilibrium of every instance of ``inputs``.

    Args:
        robot: The assembly.
        inputs: Made by ``robot.inputs(...)``; none are all zero.
        solver: ``Shooting()`` by default.
        guess: Where to start: a ``Solution``, also one under other loads, or unknowns (..., n). Without it, the equilibrium on the natural branch is
            meant: the one reached from the unloaded assembly by raising all loads in proportion.
        device: Warp device.

    Returns:
        One equilibrium an instance, each with its status; an instance that fails never raises.

    Raises:
        TypeError, ValueError: If an argument is not what it must be.
    """
    method = _check(robot, solver)
    inputs = robot.accept(inputs)
    problem = robot.problem(inputs, device=device, **_needs(method))
    outcome = method.solve(problem, _guess(guess, problem))
    batch_shape = np.broadcast_shapes(inputs.batch_shape, robot.batch_shape)
    return Solution(_scene(robot, method, problem, inputs, batch_shape), problem.snapshot(), outcome, inputs)


def _scene(robot: Assembly, solver: Solver, problem: BoundaryProblem, inputs: Inputs, batch_shape: tuple[int, ...]) -> Scene:
    names = [name for name in inputs.given if name not in inputs.profiles]

    def unpack(rows: FloatArray) -> Inputs:
        return inputs.with_arrays({name: rows[:, problem.input_slice(name)].reshape(*batch_shape, -1) for name in names})

    return Scene(robot, batch_shape, solver.integrator, problem.device, problem.record_fields, unpack)


def simulate(
    robot: Assembly,
    inputs: Inputs,
    *,
    time: Any,
    solver: Solver | None = None,
    guess: Any = None,
    device: str = "cpu",
    progress: Any = None,
) -> History:
    """Follow a motion from sample to sample.

    Args:
        robot: The assembly.
        inputs: Made by ``robot.inputs(...)``, with time as the first axis of what varies.
        time: Of the samples [s], evenly spaced and increasing, shape (sample_count,).
        solver: ``Shooting()`` by default.
        guess: Unknowns at the first sample, as for ``solve``.
        device: Warp device.
        progress: Called with the number of samples done after each one.

    Returns:
        The series, each sample with its status and the time that it took.

    Raises:
        ValueError: If ``time`` is not evenly spaced and increasing, or the inputs' first axis is not time.
    """
    method = _check(robot, solver)
    inputs = robot.accept(inputs)
    time = array("time", time)
    if time.ndim != 1 or len(time) < 1:
        refuse("time", Described(f"array of shape {time.shape}"), "must have shape (sample_count,)")
    steps = np.diff(time)
    if len(steps) and not (steps.min() > 0 and np.allclose(steps, steps.mean(), rtol=1e-6, atol=0)):
        refuse("time", time if time.size < 20 else Described(f"{time.size} samples"), "must be evenly spaced and increasing")
    count = len(time)
    if inputs.batch_shape and inputs.batch_shape[0] not in (1, count):
        refuse("inputs", Described(f"leading axes {inputs.batch_shape}"), f"the first must be time, {count} samples")
    batch_shape = np.broadcast_shapes(inputs.batch_shape[1:], robot.batch_shape)
    first = inputs[0] if inputs.batch_shape else inputs
    active = [name for name in inputs.given if inputs.is_active(name)]
    dt = float(steps.mean()) if len(steps) else 1.0
    runner = _Runner(robot, method, first, dt, device, active, guess)
    problem = runner.problem
    records = np.empty((count, *problem.records.shape))
    outcomes = []
    step_time = np.empty(count)
    moving = bool(inputs.batch_shape) and inputs.batch_shape[0] == count and count > 1
    packed = np.stack([problem.pack(inputs[k]) for k in range(count)]) if moving else None
    for k in range(count):
        start = perf_counter()
        if packed is not None:
            problem.write("inputs", packed[k])
        outcomes.append(runner.track.step())
        step_time[k] = perf_counter() - start
        records[k] = problem.snapshot()
        if progress is not None:
            progress(k + 1)
    inputs = _with_time(inputs, count, batch_shape)
    return History(
        _scene(robot, method, problem, inputs, (count, *batch_shape)),
        records.reshape(-1, records.shape[-1]),
        Outcome.joined(outcomes),
        inputs,
        time=time,
        step_time=step_time,
        description=repr(method),
    )


def _with_time(inputs: Inputs, count: int, batch_shape: tuple[int, ...]) -> Inputs:
    """The inputs with all axes, time first: what does not vary is repeated."""
    own = inputs.batch_shape or (1,)
    shape = (own[0], *(1,) * (len(batch_shape) - len(own) + 1), *own[1:])
    names = [name for name in inputs.given if name not in inputs.profiles]
    arrays = {}
    for name in names:
        value = getattr(inputs, name)
        arrays[name] = np.broadcast_to(value.reshape(*shape, value.shape[-1]), (count, *batch_shape, value.shape[-1]))
    return inputs.with_arrays(arrays)


def _broadcasts(shape: tuple[int, ...], target: tuple[int, ...]) -> bool:
    try:
        return np.broadcast_shapes(shape, target) == target
    except ValueError:
        return False


_PLAIN_NUMBERS = (float, int, np.float64)


class _Runner:
    """A problem and the solver's track on it."""

    def __init__(self, robot: Assembly, solver: Solver, inputs: Inputs, dt: float, device: str, enabled: Any, guess: Any) -> None:
        self.problem: Any = robot.problem(inputs, device=device, enabled=tuple(enabled), **_needs(solver))
        reasons = solver.unsupported(self.problem)
        if reasons:
            raise ValueError(f"{type(solver).__name__} cannot take this problem: " + "; ".join(reasons))
        self.track = solver.track(self.problem, dt)
        start = _guess(guess, self.problem)
        if start is not None:
            self.track.start(start)


class Tracker:
    """A solver in a control loop: one sample a call, buffers and launches made once.

    Args:
        robot: The assembly.
        solver: ``Shooting()`` by default.
        dt: Time between samples [s].
        inputs: At the start; their batch axes are kept. Loads not zero here are compiled in now: another load named
            later is compiled in when it first comes, which takes seconds once.
        guess: Unknowns at the first sample, as for ``solve``.
        device: Warp device.

    Raises:
        TypeError, ValueError: If an argument is not what it must be.
    """

    def __init__(
        self,
        robot: Assembly,
        *,
        solver: Solver | None = None,
        dt: float,
        inputs: Inputs | None = None,
        guess: Any = None,
        device: str = "cpu",
    ) -> None:
        self._solver = _check(robot, solver)
        self._robot = robot
        self._dt = positive_float("Tracker.dt", dt)
        self._device = device
        self._inputs = robot.accept(inputs)
        self._enabled: set[str] = set()
        self._started = guess is not None
        self._prepare(guess)

    def _prepare(self, guess: Any) -> None:
        inputs = self._inputs
        self._enabled |= {name for name in inputs.given if inputs.is_active(name)}
        runner = _Runner(self._robot, self._solver, inputs, self._dt, self._device, self._enabled, guess)
        self._problem, self._track = runner.problem, runner.track
        self._batch_shape = np.broadcast_shapes(inputs.batch_shape, self._robot.batch_shape)
        self._rebind()

    def _rebind(self) -> None:
        """Make the checked inputs those that changes by name start from."""
        problem, inputs = self._problem, self._inputs
        self._scene = _scene(self._robot, self._solver, problem, inputs, self._batch_shape)
        self._rows: dict[str, Any] = {}
        view = problem.input_view()
        if view is None or self._batch_shape:
            return
        for spec in self._robot.input_specs:
            writable = spec.name in inputs.given and spec.name not in inputs.profiles and problem.takes(spec.name)
            if writable and not (spec.per_rod and inputs.profiles):
                self._rows[spec.name] = view[0, problem.input_slice(spec.name)]

    @property
    def inputs(self) -> Inputs:
        """The present inputs."""
        return self._scene.unpack(self._problem.read("inputs"))

    def step(self, inputs: Inputs | None = None, **changes: Any) -> Solution:
        """Solve the next sample.

        Args:
            inputs: All inputs anew; or
            **changes: inputs by name, the others keep their values.

        Returns:
            The sample's equilibrium or estimate, with its status.

        Raises:
            TypeError: If a name is not an input of the robot, or both forms are used.
            ValueError: If a value is out of range, not finite, or changes the batch shape.
        """
        if inputs is not None or not self._write(changes):
            self._apply(inputs, changes)
        outcome = self._track.step()
        self._started = True
        return Solution(self._scene, self._problem.snapshot(), outcome)

    def _write(self, changes: dict[str, Any]) -> bool:
        """Write finite numbers straight into the kernel's inputs; False where a change needs to be checked or compiled in."""
        staged = []
        for name, value in changes.items():
            row = self._rows.get(name)
            if row is None:
                return False
            listed = type(value) in (tuple, list) or (isinstance(value, np.ndarray) and value.ndim == 1)
            numbers = value if listed else (value,)
            if len(numbers) != len(row):
                return False
            total = numbers[0]
            for number in numbers[1:]:
                total = total + number
            # not a plain number, NaN, infinite or out of range: the checked path says so
            if type(total) not in _PLAIN_NUMBERS or not -inf < total < inf or not self._robot.surely_takes(name, numbers):
                return False
            staged.append((row, value))
        for row, value in staged:
            row[:] = value
        return True

    def _apply(self, inputs: Inputs | None, changes: dict[str, Any]) -> None:
        """Check new inputs, and compile in what they need."""
        if inputs is not None:
            if changes:
                raise TypeError("Tracker.step takes inputs or named changes, not both")
            new = self._robot.accept(inputs)
        else:
            unknown_names("Tracker.step()", changes, (spec.name for spec in self._robot.input_specs))
            present = self.inputs
            held: dict[str, Any] = {name: getattr(present, name) for name in present.given if name not in present.profiles}
            held |= dict(present.profiles)
            new = self._robot.inputs(**{**held, **changes})
        if not _broadcasts(new.batch_shape, self._batch_shape):
            refuse(
                "inputs",
                Described(f"leading axes {new.batch_shape}"),
                f"must broadcast to those at the start, {self._batch_shape}",
            )
        named = set(changes) | {name for name in new.given if new.is_active(name)}
        known = self._inputs.profiles
        same_profiles = new.profiles.keys() == known.keys() and all(new.profiles[name] is known[name] for name in known)
        self._inputs = new
        if same_profiles and all(self._problem.takes(name) for name in named):
            self._problem.write("inputs", self._problem.pack(new))
            self._rebind()
            return
        self._enabled |= named
        self._prepare(self._problem.read("unknowns") if self._started else None)
