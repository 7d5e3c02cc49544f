"""A robot's inputs along a moving target, one integration a sample. Numbers in parentheses: ``docs/tasks.md``."""

from collections.abc import Mapping, Sequence
from math import exp, hypot
from threading import Lock
from typing import Any, Generic, Literal, get_args

import numpy as np

from multirod import plausibility
from multirod.assembly import Robot_co
from multirod.by_name import completed
from multirod.exclusive import Uncopied
from multirod.inputs import Inputs
from multirod.integrators import RK45, Integrator
from multirod.launch import expect
from multirod.naming import names_checked, unknown_names
from multirod.results.scene import Scene
from multirod.results.solution import Solution
from multirod.results.telling import Telling
from multirod.rotations import TURNED, refuse_unturned
from multirod.running.plain import PlainInputs
from multirod.running.simulation import as_robot, solve
from multirod.running.tracker import Unpack
from multirod.solver import Outcome
from multirod.solvers.shooting import Shooting
from multirod.status import Status
from multirod.tasks.controlling.command import Command
from multirod.tasks.controlling.control import ControlStep
from multirod.tasks.controlling.control_kernels import make_control
from multirod.tasks.controlling.judge import Judge
from multirod.tasks.controlling.recovery import Recovery
from multirod.tasks.controlling.shape_limits import ShapeLimits
from multirod.tasks.formulation import Task, input_units
from multirod.tasks.freed import chosen, refuse_freed, values_of, with_values
from multirod.tasks.given import plain, turned
from multirod.tasks.limits import ROUNDING_BEYOND, Limits, limit_rows, nearest, refuse_start
from multirod.tasks.preferred import centre_of
from multirod.tasks.rows import PARTS, Pose
from multirod.tasks.watch import Watch
from multirod.tasks.watch_kernels import LOOK, NEXT
from multirod.tasks.whitening import Kind
from multirod.types import Numbers
from multirod.validation import (
    SMALLEST_AXIS,
    Described,
    FloatArray,
    choice,
    device_name,
    frozen,
    instance,
    measurement,
    positive_float,
    refuse,
)

Prefer = Literal["start", "smallest motion", "smallest tension", "middle"]
PREFERENCES = get_args(Prefer)
STEADY = (
    f"must be one of {', '.join(map(repr, PREFERENCES))}: margins take more than the integration of a sample; "
    "reach(prefer='stability') finds a guess, and prefer='start' stays near it"
)
LAG = 5.0  # samples, of the correction by default
OWN = *PARTS, "measured_position", "measured_rotation"  # of a sample, beside inputs
# shared by all samples
CODES: list[Any] = [frozen(np.array([code], dtype=np.int32)) for code in range(max(Status) + 1)]
THE_ONE = np.arange(1)  # the number of the only instance
ONCE = frozen(np.array([1], dtype=np.int32))


class Controller(Uncopied, Generic[Robot_co]):
    """Chooses inputs so that the end effector follows a target, one integration of each rod a sample.

    Each sample is evaluated where the last one expected the target to be, and corrected to first order to where it is; then the
    target's motion is extrapolated by its last two changes. What is measured is never extrapolated so: it corrects the target by
    a filtered offset between robot and model, which is held where measurements are overdue. One thread steps a controller at a
    time.

    Args:
        robot: The assembly; without leading axes.
        dt: Time between samples [s].
        free: Names of the inputs that it chooses; also of what, as of ``reach``.
        inputs: Where it begins, and all that is not free: each load that will come, zero or not. Without ``guess`` too: all by
            default, or as near to that as the limits allow.
        limits: Kept at every sample: of the freed inputs, and of the shape. These cost a look at each command, an integration or
            two, and several where a command is near one (``docs/tasks.md``).
        prefer: Where inputs go that the target leaves free, sample by sample: back to the ``"start"``, to the ``"smallest
            tension"`` of lines, or to the ``"middle"`` of the limits; or the ``"smallest motion"`` of each sample, which drifts.
        correction_time: Of the filter between measurement and correction [s]; five samples by default.
        guess: The equilibrium at ``inputs``.
        integrator: Of the spatial equations; ``RK4(50)`` takes the same time at each sample.
        device: Warp device.

    Raises:
        TypeError: If an argument is not what it must be, or an input is not one of the robot's.
        ValueError: If a number is out of range, or the limits exclude the start or it is unstable, or there are leading axes.
        SolveError: If there is no equilibrium at the start.
    """

    instead = "make another Controller"

    @names_checked
    def __init__(
        self,
        robot: Robot_co,
        *,
        dt: float,
        free: str | Sequence[str] | Mapping[str, Sequence[str] | None],
        inputs: Inputs | None = None,
        limits: Limits | None = None,
        prefer: Prefer = "start",
        correction_time: float | None = None,
        guess: Solution | None = None,
        integrator: Integrator | None = None,
        device: str = "cpu",
    ) -> None:
        self.dt = positive_float("Controller.dt", dt)
        plausibility.of_dt("Controller.dt", self.dt, "a controller")
        self.free = chosen("Controller.free", as_robot(robot), free)
        asked: object = prefer
        if asked == "stability":
            refuse("Controller.prefer", asked, STEADY)
        self.prefer = choice("Controller.prefer", prefer, PREFERENCES)
        lag = LAG * self.dt if correction_time is None else positive_float("Controller.correction_time", correction_time)
        if limits is not None:
            instance("Controller.limits", limits, Limits, "Limits, such as Limits(translation=(-0.1, 0))")
        if guess is not None:
            instance("Controller.guess", guess, Solution, "a Solution")
        method, device = RK45() if integrator is None else integrator, device_name("Controller.device", device)
        instance("Controller.integrator", method, Integrator, "an Integrator, such as RK4(50)")
        expect(make_control, device)
        given = robot.accept(guess._applied if inputs is None and guess is not None else inputs)
        for field, own in (("robot", robot.batch_shape), ("inputs", given.batch_shape)):
            if own:
                refuse(f"Controller.{field}", Described(f"leading axes {own}"), "there must be none")
        given = given.with_arrays(given.arrays | self._zeros(given))
        self._robot, self._unit, self._length = robot, input_units(robot, self.free), robot.longest
        self._rows = limit_rows(robot, limits, self.free)
        if inputs is None and guess is None:
            given = self._within(given)
        start = solve(robot, given, solver=Shooting(integrator=method), device=device) if guess is None else guess
        start.raise_if_failed()
        self._task = Task.of(robot, given, self.free, integrator=method, device=device)
        problem = self._task.problem
        x, p = np.array(problem.adopt(start.unknowns[None])), self._task.values()
        refuse_start("Controller.limits", self._rows, p, robot, self.free)
        self._unpack = unpack = Unpack(given, {name: problem.input_slice(name) for name in given.arrays}, ())
        self._given = given
        telling = Telling(robot, given, given.given, method, device)
        self._scene: Scene[Robot_co] = Scene(robot, (), method, device, problem.record_fields, unpack, telling=telling)
        self._plain, self._names = PlainInputs(robot, problem, given, self.free), {spec.name for spec in robot.input_specs}
        keep = exp(-self.dt / lag)
        weight = np.array([1 / self._length**2, 1 / self._length])
        self._watch = Watch(self._task, self._unit)
        self._shape = None
        if limits is not None and limits.of_shape:
            self._shape = ShapeLimits(robot, given, self.free, limits, self._unit, method, device)
            self._refuse_shape(limits, problem.adopt(start.unknowns[None]))
        gains, shaped = (1 - keep**2, (1 - keep) ** 2), () if self._shape is None else self._shape.names
        centre = centre_of("Controller.prefer", prefer, robot, self.free, self._rows, p)
        centre = p[0].copy() if prefer == "start" else centre
        self._step = ControlStep(self._task, self._rows, self._unit, weight, gains, self._watch, centre, len(shaped))
        self._limit_names = *self._rows.names, *shaped, "stability"
        self._step.start(x, p)
        self._step.prepare((1, 0, 0), (1, 1, 0))  # what most loops ask for: a position, a pose
        self._begin(x, p, "Controller.inputs" if guess is None else "Controller.guess")
        self._looked = False
        self._recovery, self._judge = Recovery(start, method, self._step), Judge(self._task, self._watch, self._step)
        self._lock = Lock()

    def _begin(self, x: FloatArray, p: FloatArray, field: str) -> None:
        """At a stable equilibrium, as far as that can be said."""
        self._task.evaluate(x, p)
        gamma = self._watch.gamma()
        self._step.stand(self._task.problem.snapshot())
        if self._watch.unstable(THE_ONE).any():
            refuse(field, Described("an unstable equilibrium"), "must be stable: a robot would leave it")
        self._watch.begin(THE_ONE, gamma)
        self._task.write(x, p)

    def _refuse_shape(self, limits: Limits, unknowns: FloatArray) -> None:
        """A start whose shape is beyond its limits."""
        assert self._shape is not None
        found = self._shape.look(unknowns, self._task.problem.read("inputs"), np.zeros((unknowns.shape[1], self._task.count)))
        if not self._shape.within(found):
            refuse("Controller.limits", limits, f"must hold at the start too, where {self._shape.said(found)}")
        self._shape.last = found

    def _zeros(self, given: Inputs) -> dict[str, FloatArray]:
        """Freed inputs that were not given."""
        for name in self.free:
            if name in given.profiles:
                refuse("Controller.free", self.free, f"{name} is a function of the arclength: it cannot be chosen")
        return {name: np.array(getattr(given, name)) for name in self.free if name not in given.given}

    def _within(self, given: Inputs) -> Inputs:
        """The inputs by default, those that are free as near to that as limits allow."""
        p = values_of(given, self.free)
        if not (self._rows.outside(p[None], self._unit) > ROUNDING_BEYOND).any():
            return given
        return with_values(given, self.free, nearest(self._rows, p, self._unit))

    def __repr__(self) -> str:
        return f"Controller({self._robot!r}, {', '.join(self.free)} free, dt {self.dt:g} s)"

    @property
    def robot(self) -> Robot_co:
        """The robot."""
        return self._robot

    def step(
        self,
        *others: object,
        position: Numbers | None = None,
        rotation: Numbers | None = None,
        axis: Numbers | None = None,
        across: Numbers | None = None,
        along: Numbers | None = None,
        measured_position: Numbers | None = None,
        measured_rotation: Numbers | None = None,
        **changes: Numbers,
    ) -> Command[Robot_co]:
        """Choose inputs for the present target.

        Args:
            position: Of the tip, in the world [m], shape (3,).
            rotation: Of the tip, body to world, shape (3, 3).
            axis: Direction of the tip's z axis in the world, shape (3,), in place of the rotation.
            across, along: Direction across or along which alone the position counts, shape (3,), as of a ``Pose``.
            measured_position: Where the robot's tip is seen to be [m], under the inputs of the last sample. NaN is a sensor that
                dropped out: the sample goes on without it, and says so.
            measured_rotation: Its rotation, likewise.
            **changes: Inputs that are not free, by name, where they have changed. Where these are given by the names of rods,
                lines, bodies or joints, what is not named keeps its value, and what is not free may change.

        Returns:
            The inputs to apply, with the equilibrium that they lead to. ``TRACKING``; ``AT_LIMIT`` where a limit holds the tip
            back, ``OFF_TARGET`` where none does and it is off all the same. A step to what is not known to be stable is given up:
            then it is the last command again, and ``held_by`` has ``"stability"``. A failure is ``UNSTABLE`` where that may not
            be stable any more, as loads have changed, or that of the integration; the next sample then starts from the last good
            one, or where loads moved the robot from there. ``integrations`` is 2 and more where that was so, or the command
            itself was looked at.

        Raises:
            TypeError: If a name is not an input of the robot, or is free.
            ValueError: If a value is out of range, or no target is given.
            RuntimeError: If another thread is in ``step``.
        """
        if others:
            raise TypeError("Controller.step() takes nothing without a name: targets are position=, rotation= or axis=")
        if changes and not changes.keys() <= self._names:
            unknown_names("Controller.step()", changes, [*OWN, *(spec.name for spec in self._robot.input_specs)])
        if not self._lock.acquire(False):
            raise RuntimeError("this Controller is in use on another thread: make a Controller for each thread")
        try:
            seen = self._seen(measured_position, measured_rotation)
            kind = self._aim({"position": position, "rotation": rotation, "axis": axis, "across": across, "along": along})
            if not self._looked:  # once: who gives another unit does so from the first sample on
                self._look(position, measured_position)
            if changes:
                if not self._plain.write(changes):
                    self._change(changes)
                if self._step.others_changed():
                    self._watch.compare()
            return self._sample(kind, seen)
        finally:
            self._lock.release()

    def _look(self, *places: Numbers | None) -> None:
        """Warn of places that are far away, of the target and measured."""
        self._looked = True
        for name, place in zip(("position", "measured_position"), places, strict=True):
            if place is not None:
                plausibility.of_place(f"Controller.step({name})", np.asarray(place, dtype=np.float64))

    def _aim(self, told: dict[str, Any]) -> Kind:
        """Take the present target; what is not plainly right is checked at length."""
        given, position, rotation, axis = self._step.given, told["position"], told["rotation"], told["axis"]
        if (
            told["across"] is told["along"] is None
            and plain(position)
            and (rotation is None or (turned(rotation) and axis is None))
            and (axis is None or plain(axis))
        ):
            size = 1.0 if axis is None else hypot(*axis)
            if size > SMALLEST_AXIS:
                given["position"][:] = position
                if rotation is not None:
                    given["rotation"][:] = rotation
                if axis is not None:
                    given["axis"][:] = [value / size for value in axis]
                return 1, int(rotation is not None), int(axis is not None)
        target = Pose(**told)
        for name in target.given:
            value = getattr(target, name)
            if value.shape != given[name].shape or not np.isfinite(value).all():
                refuse(f"Controller.step({name})", told[name], "must be finite, without leading axes")
            given[name][:] = value
        return target.kind

    def _seen(self, position: Numbers | None, rotation: Numbers | None) -> tuple[int, int]:
        """Take what is measured; of both whether it is there, as ``ControlStep.given`` says."""
        given, found = self._step.given, []
        for name, value, tail in (("seen_position", position, (3,)), ("seen_rotation", rotation, (3, 3))):
            if value is None:
                found.append(0)
                continue
            sure = plain(value, tail)
            numbers = np.asarray(value) if sure else measurement(f"Controller.step(measured_{name[5:]})", value, tail)
            if numbers.shape != tail:
                refuse(f"Controller.step(measured_{name[5:]})", value, "must be of one robot, without leading axes")
            if tail == (3, 3) and not turned(value, TURNED):
                refuse_unturned("Controller.step(measured_rotation)", value, numbers, TURNED)
            there = sure or np.isfinite(numbers).all()
            if there:
                given[name][:] = numbers
            found.append(1 if there else -1)
        return found[0], found[1]

    def _change(self, changes: dict[str, Any]) -> None:
        """Other values of what is not free."""
        refuse_freed("Controller.step()", self.free, changes, "free")
        problem = self._task.problem
        rows = problem.read("inputs")
        new = self._robot.inputs(**completed(self._robot, self._unpack(rows), changes))
        if new.batch_shape or new.profiles:
            refuse("Controller.step()", Described(", ".join(changes)), "must be numbers, without leading axes")
        for name, value in changes.items():
            if new.is_active(name) and not problem.takes(name):
                refuse(f"Controller.step({name})", value, "must be given at the start too, or as zero: it is compiled in there")
        for name in changes:
            rows[:, problem.input_slice(name)] = getattr(new, name)
        problem.write("inputs", rows)

    def _sample(self, kind: Kind, seen: tuple[int, int]) -> Command[Robot_co]:
        self._step.given["seen"][:] = seen
        problem, spent = self._task.problem, ONCE
        if self._recovery.wanted:
            given = self._unpack(problem.read("inputs"))
            spent = frozen(spent + np.int32(self._recovery.run(self._task, self._watch, given, self.free)))
        self._watch.go_on()
        with problem.alone:
            problem.integrate()
            record, told, status, doubt = self._step.launch(kind)
            if doubt == NEXT:
                self._watch.renew()
            elif doubt == LOOK:
                unstable, looked = self._judge.unstable(record, told)
                spent = frozen(spent + looked)
                if unstable:
                    status = int(Status.UNSTABLE)
                    self._step.refuse(told)
            again = self._step.again(told) if status == Status.UNSTABLE else None
            if again is not None:
                record, told, status = again
            elif self._shape is not None and not Status(status).failed:
                status = self._judge.in_shape(self._shape, record, told, status)
                spent = frozen(spent + np.int32(self._shape.integrations))
            status, told = self._step.mind(status, told, record)
        result: Command[Robot_co] = Command(self._scene, record, Outcome(CODES[status], ONCE, spent))
        own = {"_free": self.free, "_told": told, "_rows": self._rows, "_limits": self._limit_names, "_aims": kind[0] == 1}
        vars(result).update(own, missing=-1 in seen)
        self._recovery.mind(result)
        return result
