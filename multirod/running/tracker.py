"""One sample at a time: a solver in a control loop."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from inspect import Parameter, Signature
from threading import Lock
from typing import Any, Generic

import numpy as np

from multirod import plausibility
from multirod.assembly import Assembly, Robot_co
from multirod.by_name import completed
from multirod.exclusive import Uncopied
from multirod.inputs import Inputs
from multirod.models.assemblies.inputs import KnownInputs
from multirod.naming import names_checked, unknown_names
from multirod.results.derivatives import Columns, known_names, twins_of
from multirod.results.scene import Scene
from multirod.results.solution import Solution
from multirod.results.telling import Telling
from multirod.running.plain import PlainInputs
from multirod.running.simulation import Runner, as_solver
from multirod.solver import Solver
from multirod.types import Numbers, P, Takes
from multirod.validation import Described, FloatArray, device_name, positive_float, refuse, some_names


def _broadcasts(shape: tuple[int, ...], target: tuple[int, ...]) -> bool:
    try:
        return np.broadcast_shapes(shape, target) == target
    except ValueError:
        return False


@dataclass(frozen=True)
class Unpack:
    """Makes inputs of rows that hold their numbers; it can be pickled."""

    like: Inputs
    places: dict[str, slice]
    batch_shape: tuple[int, ...]

    def __call__(self, rows: FloatArray) -> Inputs:
        """The inputs of these rows."""
        shape = self.batch_shape
        return self.like.with_arrays({name: rows[:, own].reshape(*shape, -1) for name, own in self.places.items()}, shape)


def _time_step(dt: float | None, solver: Solver) -> float:
    """Time between samples [s]; NaN where there is none and the solver needs none."""
    if dt is None:
        if solver.needs_dt:
            raise TypeError(f"Tracker needs dt, the time between samples [s]: {type(solver).__name__} goes by it")
        return math.nan
    positive_float("Tracker.dt", dt)
    if solver.needs_dt:
        plausibility.of_dt("Tracker.dt", float(dt))
    return float(dt)


class Tracker(Uncopied, Generic[Robot_co]):
    """A solver in a control loop: one sample a call, buffers and launches made once.

    One thread steps it at a time: each sample starts from the last. Several loops need a tracker each. The first step solves from
    nothing, and compiles what that takes, seconds: take one before the loop.

    Args:
        robot: The assembly.
        solver: ``Shooting()`` by default.
        dt: Time between samples [s]; needed by solvers that have dynamics of their own, such as ``Observer``.
        inputs: At the start; their batch axes are kept. Loads given here, zero or not, are compiled in now: another load
            named later is compiled in when it first comes, which takes seconds once.
        guess: Unknowns at the first sample, as for ``solve``.
        jacobian: Input or parameter, or several, whose columns each integration carries: ``jacobian``, ``vjp`` by these, as many
            of them as you like, then take no integration of their own. By fixed steps under a tip force alone, samples with
            columns and without differ by the error of the steps (``docs/derivatives.md``).
        device: Warp device.

    Raises:
        TypeError, ValueError: If an argument is not what it must be, or the solver needs ``dt`` and there is none, or columns
            are asked for of a solver that has its own.
        NotImplementedError: If the assembly does not give the derivatives asked for.
    """

    instead = "make a new Tracker(robot, solver=..., dt=..., inputs=tracker.inputs, guess=solution)"
    _called = "Tracker"  # by who made it
    _options: Mapping[str, Any] | None = None  # of the problem, beside what the solver needs

    @names_checked
    def __init__(
        self,
        robot: Robot_co,
        *,
        solver: Solver | None = None,
        dt: float | None = None,
        inputs: Inputs | None = None,
        guess: Solution | Numbers | None = None,
        jacobian: str | Iterable[str] = (),
        device: str = "cpu",
    ) -> None:
        self._solver = as_solver(robot, solver)
        self._robot: Assembly = robot
        self._dt = _time_step(dt, self._solver)
        self._device = device_name("Tracker.device", device)
        self._inputs = robot.accept(inputs)
        self._enabled: set[str] = set()
        self._columns = self._columns_of(some_names("Tracker.jacobian", jacobian))
        self._started = guess is not None
        self._lock = Lock()
        self._prepare(guess)

    def _columns_of(self, names: tuple[str, ...]) -> dict[str, Any]:
        """What samples carry columns by, and where these stand; in the place of a follower force the dead one."""
        if not names:
            return {}
        if self._solver.direction_count:
            refuse(
                "Tracker.jacobian",
                names,
                f"must not be given with {self._solver!r}, whose columns are its own: sample.jacobian(...) integrates for itself",
            )
        known = known_names(self._robot, names, "Tracker(jacobian=...)")
        twins = twins_of(self._robot, lambda: self._inputs, known)
        stand_ins = list(dict.fromkeys(twin or name for name, twin in zip(known, twins, strict=True)))
        self._enabled |= {name for name in stand_ins if name not in self._robot.parameters}
        self._options = {"pose_sensitivities": True, **self._robot.input_directions(*stand_ins)}
        ends = np.cumsum([self._robot.column_count(name) for name in stand_ins])
        return dict(zip(stand_ins, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))

    def _prepare(self, guess: object) -> None:
        inputs = self._inputs
        if 0 in inputs.batch_shape:
            refuse(f"{self._called}.inputs", Described(f"leading axes {inputs.batch_shape}"), "there must be an instance")
        self._enabled |= set(inputs.given)
        runner = Runner(self._robot, self._solver, inputs, self._dt, self._device, self._enabled, options=self._options)
        count = runner.problem.instance_count
        runner.start(guess, count, slice(0, count))
        self._problem, self._track = runner.problem, runner.track
        if self._columns:
            self._problem.eliminates = True
            self._problem.aim(*self._columns)
        self._batch_shape = np.broadcast_shapes(inputs.batch_shape, self._robot.batch_shape)
        self._telling = Telling(self._robot, inputs, self._enabled, self._solver.integrator, self._device)
        self._rebind()

    def _rebind(self) -> None:
        """Make the checked inputs those that changes by name start from."""
        problem, inputs = self._problem, self._inputs
        slices = {name: problem.input_slice(name) for name in inputs.arrays}
        unpack = Unpack(inputs, slices, self._batch_shape)
        results = self._batch_shape, self._solver.integrator, self._device, problem.record_fields, unpack
        self._scene: Scene[Any] = Scene(self._robot, *results, telling=self._telling)
        self._unpack = unpack
        self._plain = PlainInputs(self._robot, problem, inputs)

    def __repr__(self) -> str:
        said = [repr(self._robot), repr(self._solver), *([] if math.isnan(self._dt) else [f"dt {self._dt:g} s"])]
        return f"Tracker({', '.join(said + [f'batch {self._batch_shape}'] * bool(self._batch_shape))})"

    @property
    def inputs(self) -> Inputs:
        """The present inputs.

        Raises:
            RuntimeError: If another thread is in ``step``.
        """
        self._take()
        try:
            return self._present()
        finally:
            self._lock.release()

    def _take(self) -> None:
        """Keep other threads out: waiting would order their samples, but each counts on the one before being its own."""
        if not self._lock.acquire(False):
            raise RuntimeError("this Tracker is in use on another thread: make a Tracker for each thread")

    def _present(self) -> Inputs:
        return self._unpack(self._problem.read("inputs"))

    def step(
        self: "Tracker[Takes[P]]",  # type: ignore[type-var]  # a robot, by the inputs that it takes
        inputs: Inputs | None = None,
        *others: P.args,
        **changes: P.kwargs,
    ) -> Solution[Robot_co]:
        """Solve the next sample.

        Args:
            inputs: All inputs anew; or
            **changes: Inputs by name, those that ``robot.inputs`` takes; what is not named keeps its value, of an input that is
                given by the names of rods, lines, bodies or joints too.

        Returns:
            The sample's equilibrium or estimate, with its status.

        Raises:
            TypeError: If a name is not an input of the robot, or both forms are used.
            ValueError: If a value is out of range, not finite, or changes the batch shape.
            RuntimeError: If another thread is in ``step`` or reads ``inputs``; nothing is changed.
        """
        if others:
            raise TypeError("Tracker.step takes inputs, or inputs by name")
        self._take()
        try:
            if inputs is not None or not self._plain.write(changes):
                self._apply(inputs, **changes)
            restored = self._problem.restored
            outcome = self._track.step()
            self._started = True
            sample = Solution(self._scene, self._problem.snapshot(), outcome)
            if self._columns and restored == self._problem.restored and not outcome.breakpoints:
                sample._columns = Columns.of(self._problem, self._columns)
            return sample
        finally:
            self._lock.release()

    def _apply(self, inputs: Inputs | None, **changes: object) -> None:
        """Check new inputs, and compile in what they need."""
        if inputs is not None:
            if changes:
                raise TypeError("Tracker.step takes inputs or named changes, not both")
            new = self._robot.accept(inputs)
        else:
            unknown_names("Tracker.step()", changes, (spec.name for spec in self._robot.input_specs))
            present = self._present()
            held: dict[str, Any] = {name: getattr(present, name) for name in present.arrays}
            held |= dict(present.profiles)
            # named so, for editors that follow them from ``step`` on
            given = KnownInputs(**changes)  # type: ignore[typeddict-item]
            new = self._robot.inputs(**{**held, **completed(self._robot, present, given)})
        if not _broadcasts(new.batch_shape, self._batch_shape):
            refuse(
                f"inputs ({', '.join(changes)})" if changes else "inputs",
                Described(f"leading axes {new.batch_shape}"),
                f"must broadcast to those at the start, {self._batch_shape}",
            )
        named = {*changes, *new.active}
        known = self._inputs.profiles
        same_profiles = new.profiles.keys() == known.keys() and all(new.profiles[name] is known[name] for name in known)
        self._inputs = new
        if same_profiles and all(self._problem.takes(name) for name in named):
            self._problem.write("inputs", self._problem.pack(new))
            self._rebind()
            return
        self._enabled |= named
        self._prepare(self._problem.read("unknowns") if self._started else None)


# for ``help`` and notebooks, which see no types
_CHANGES = [Parameter(name, Parameter.KEYWORD_ONLY, default=Described("unchanged")) for name in KnownInputs.__annotations__]
Tracker.step.__signature__ = Signature(  # type: ignore[attr-defined]
    [
        Parameter("self", Parameter.POSITIONAL_OR_KEYWORD),
        Parameter("inputs", Parameter.POSITIONAL_OR_KEYWORD, default=None),
        *_CHANGES,
        Parameter("changes", Parameter.VAR_KEYWORD),
    ],
    return_annotation="Solution",
)
