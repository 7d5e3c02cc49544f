"""A robot's inputs along a moving target, one integration a sample. Numbers in parentheses: ``docs/tasks.md``."""

from collections.abc import Sequence
from math import exp, nan, sqrt
from threading import Lock
from typing import Any, Generic

import numpy as np

from multirod import plausibility
from multirod.assembly import Robot_co
from multirod.batch import solved_each
from multirod.exclusive import Uncopied
from multirod.inputs import Inputs
from multirod.integrators import RK45, Integrator
from multirod.rotations import matrices, vectors
from multirod.running.simulation import solve
from multirod.running.tracker import Unpack
from multirod.scene import Scene
from multirod.solution import Solution
from multirod.solver import Outcome
from multirod.solvers.shooting import Shooting
from multirod.status import Status
from multirod.tasks.formulation import Evaluation, Task, freed, input_units, with_values
from multirod.tasks.gauss_newton import step
from multirod.tasks.limits import SAME, Limits, freed_labels, limit_rows, nearest, refuse_start, told
from multirod.tasks.rows import Pose
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, array, device_name, frozen, instance, positive_float, refuse, unknown_names

SOFTNESS = 1e-8  # of the largest number of J, squared: a ten thousandth of what moves the tip most is damped
LONGEST = 0.3  # step of a sample, in units (9)
NEAR = 1e-6  # of a target [1/m], within which a limit does not hold it back
LAG = 5.0  # samples, of the correction by default
OWN = "position", "rotation", "axis", "measured_position", "measured_rotation"  # of a sample, beside inputs
SHORT = 1e-3  # part of what is asked for that a step leaves over where nothing else holds it: the task is singular


class Command(Solution[Robot_co]):
    """What a sample of a controller asks for: a ``Solution`` at ``inputs``, to first order from the place of its integration.

    Attributes:
        target_error: Distance of the model's tip from the position asked for, what was measured taken into account [m].
        at_limit: Which of the freed numbers are held by a limit, shape (k,).
        singular: Whether the freed inputs cannot bring the tip where it is to be: the step was bounded.
        missing: Whether a measurement was given that is NaN, and left out.
        offset: By how much the robot's tip is off the model's, as the measurements say [m], shape (3,); zero without.
    """

    target_error: float
    at_limit: Any
    singular: bool
    missing: bool
    offset: FloatArray
    free: tuple[str, ...]
    _by_free: FloatArray

    @property
    def _asides(self) -> dict[str, str]:
        labels = freed_labels(self.free, [getattr(self.inputs, name).shape[-1] for name in self.free])
        held = ", ".join(label for label, own in zip(labels, self.at_limit, strict=True) if own)
        return told(self.target_error, nan, held) | ({"singular": "yes"} if self.singular else {})

    def _jacobian(self, names: tuple[object, ...], of: str, at: Any, rod: int | str) -> FloatArray:
        """By the inputs that are free, without another integration: the columns of the sample's own."""
        if of == "pose" and names == self.free and at is None:
            return np.asarray(frozen(self._by_free))
        return super()._jacobian(names, of, at, rod)


class Controller(Uncopied, Generic[Robot_co]):
    """Chooses inputs so that the end effector follows a target, one integration of each rod a sample.

    Each sample is evaluated where the last one expected the target to be, and corrected to first order to where it is; then the
    target's motion is extrapolated by its last two changes. What is measured is never extrapolated so: it corrects the target by
    a filtered offset between robot and model. One thread steps a controller at a time.

    Args:
        robot: The assembly; without leading axes.
        dt: Time between samples [s].
        free: Names of the inputs that it chooses.
        inputs: Where it begins, and all that is not free. Without ``guess`` too: all by default, or as near to that as the limits
            allow.
        limits: Of the freed inputs, kept at every sample.
        correction_time: Of the filter between measurement and correction [s]; five samples by default.
        guess: The equilibrium at ``inputs``.
        integrator: Of the spatial equations; ``RK4(50)`` takes the same time at each sample.
        device: Warp device.

    Raises:
        TypeError: If an argument is not what it must be, or an input is not one of the robot's.
        ValueError: If a number is out of range, or the limits exclude the start, or there are leading axes.
        SolveError: If there is no equilibrium at the start.
    """

    instead = "make another Controller"

    def __init__(
        self,
        robot: Robot_co,
        *,
        dt: float,
        free: Sequence[str],
        inputs: Inputs | None = None,
        limits: Limits | None = None,
        correction_time: float | None = None,
        guess: Solution | None = None,
        integrator: Integrator | None = None,
        device: str = "cpu",
    ) -> None:
        self.dt = positive_float("Controller.dt", dt)
        plausibility.of_dt("Controller.dt", self.dt, "a controller")
        self.free = freed("Controller.free", robot, free)
        lag = LAG * self.dt if correction_time is None else positive_float("Controller.correction_time", correction_time)
        if limits is not None:
            instance("Controller.limits", limits, Limits, "Limits, such as Limits(translation=(-0.1, 0))")
            if limits.of_shape:
                refuse("Controller.limits", limits, "must be of inputs alone: of the shape, each sample's properties tell")
        method, device = RK45() if integrator is None else integrator, device_name("Controller.device", device)
        given = robot.accept(guess.inputs if inputs is None and guess is not None else inputs)
        if given.batch_shape or robot.batch_shape:
            refuse("Controller.inputs", Described(f"leading axes {given.batch_shape}"), "there must be none")
        given = given.with_arrays(given.arrays | self._zeros(given))
        self._robot, self._unit, self._length = robot, input_units(robot, self.free), robot.longest
        self._rows = limit_rows(robot, limits, self.free)
        if inputs is None and guess is None:
            given = self._within(given)
        start = solve(robot, given, solver=Shooting(integrator=method), device=device) if guess is None else guess
        start.raise_if_failed()
        self._task = Task.of(robot, given, self.free, integrator=method, device=device)
        problem = self._task.problem
        self._x, self._p = np.array(problem.adopt(start.unknowns[None])), self._task.values()
        refuse_start("Controller.limits", self._rows, self._p, robot, self.free)
        self._scaled = self._rows.matrix * self._unit
        unpack = Unpack(given, {name: problem.input_slice(name) for name in given.arrays}, ())
        self._given = given
        self._scene: Scene[Robot_co] = Scene(robot, (), method, device, problem.record_fields, unpack)
        self._none_held = np.zeros((1, len(self._rows.low)), dtype=np.int8)
        self._sign = 0.0
        keep = exp(-self.dt / lag)
        self._gains = 1 - keep**2, (1 - keep) ** 2
        self._offset, self._drift = np.zeros((2, 6))
        self._good: tuple[FloatArray, FloatArray] = self._x, self._p
        self._tip: tuple[FloatArray, FloatArray] | None = None
        self._last_target: Pose | None = None
        self._last_motion: FloatArray | None = None
        self._lock = Lock()

    def _zeros(self, given: Inputs) -> dict[str, FloatArray]:
        """Freed inputs that were not given."""
        for name in self.free:
            if name in given.profiles:
                refuse("Controller.free", self.free, f"{name} is a function of the arclength: it cannot be chosen")
        return {name: np.array(getattr(given, name)) for name in self.free if name not in given.given}

    def _within(self, given: Inputs) -> Inputs:
        """The inputs by default, those that are free as near to that as limits allow."""
        p = np.concatenate([given.array(name) for name in self.free])
        if not (self._rows.outside(p[None], self._unit) > SAME).any():
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
        *,
        position: Numbers | None = None,
        rotation: Numbers | None = None,
        axis: Numbers | None = None,
        measured_position: Numbers | None = None,
        measured_rotation: Numbers | None = None,
        **changes: Numbers,
    ) -> Command[Robot_co]:
        """Choose inputs for the present target.

        Args:
            position: Of the tip, in the world [m], shape (3,).
            rotation: Of the tip, body to world, shape (3, 3).
            axis: Direction of the tip's z axis in the world, shape (3,), in place of the rotation.
            measured_position: Where the robot's tip is seen to be [m], under the inputs of the last sample. NaN is a sensor that
                dropped out: the sample goes on without it, and says so.
            measured_rotation: Its rotation, likewise.
            **changes: Inputs that are not free, by name, where they have changed.

        Returns:
            The inputs to apply, with the equilibrium that they lead to. ``TRACKING``; ``AT_LIMIT`` where a limit holds the tip
            back. A failure is ``UNSTABLE`` where the equilibrium lost its stability at a fold, or that of the integration; the
            next sample then starts from the last good one.

        Raises:
            TypeError: If a name is not an input of the robot, or is free.
            ValueError: If a value is out of range, or no target is given.
            RuntimeError: If another thread is in ``step``.
        """
        if changes:
            unknown_names("Controller.step()", changes, [*OWN, *(spec.name for spec in self._robot.input_specs)])
        target = Pose(position=position, rotation=rotation, axis=axis)
        if target.batch_shape or not target.complete.all():
            refuse("Controller.step(target)", target, "must be finite, without leading axes")
        if not self._lock.acquire(False):
            raise RuntimeError("this Controller is in use on another thread: make a Controller for each thread")
        try:
            if changes:
                self._change(changes)
            missing = self._measure(measured_position, measured_rotation)
            return self._sample(target, missing)
        finally:
            self._lock.release()

    def _change(self, changes: dict[str, Any]) -> None:
        """Other values of what is not free."""
        for name in changes:
            if name in self.free:
                raise TypeError(f"Controller.step() takes no {name!r}: it is free")
        new, problem = self._robot.inputs(**changes), self._task.problem
        if new.batch_shape or new.profiles:
            refuse("Controller.step()", Described(", ".join(changes)), "must be numbers, without leading axes")
        for name, value in changes.items():
            if new.is_active(name) and not problem.takes(name):
                refuse(f"Controller.step({name})", value, "must be given, not zero, at the start: it is compiled in there")
        rows = problem.read("inputs")
        for name in changes:
            rows[:, problem.input_slice(name)] = getattr(new, name)
        problem.write("inputs", rows)

    def _measure(self, position: Any, rotation: Any) -> bool:
        """(15) The offset between robot and model, filtered; whether a measurement is missing."""
        self._offset = self._offset + self._drift
        missing = False
        for value, tail, place in ((position, (3,), slice(0, 3)), (rotation, (3, 3), slice(3, 6))):
            if value is None:
                continue
            seen = array("Controller.step(measured)", value, tail, finite=False)
            if not np.isfinite(seen).all():
                missing = True
                self._drift[place] = 0.0
                continue
            if self._tip is None:
                continue
            off = seen - self._tip[0] if tail == (3,) else vectors((seen @ self._tip[1].T)[None])[0]
            surprise = off - self._offset[place]
            self._offset[place] += self._gains[0] * surprise
            self._drift[place] += self._gains[1] * surprise
        return missing

    def _corrected(self, target: Pose) -> Pose:
        """The target of the model, whose robot is off it."""
        if not self._offset.any():
            return target
        turn = matrices(-self._offset[None, 3:])[0]
        return Pose(
            position=None if target.position is None else target.position - self._offset[:3],
            rotation=None if target.rotation is None else turn @ target.rotation,
            axis=None if target.axis is None else turn @ target.axis,
        )

    def _sample(self, target: Pose, missing: bool) -> Command[Robot_co]:
        rows = self._corrected(target).rows(self._length)
        found = self._task.evaluate(self._x, self._p)
        errors, by_x, by_p = rows.at(found)
        r, J = found.condensed(errors, by_x, by_p)
        J = J * self._unit
        status = self._judged(found, r)
        if status is not Status.TRACKING:
            return self._failed(target, status, missing)
        towards, by = found.eliminated
        ahead = self._expected(target, rows.weight, rows.count)
        at_once, later = self._unlimited(J, r, ahead)
        d, held = self._solved(J, r, self._p, at_once)
        left = r + (J @ d[..., None])[..., 0]
        change = self._unit * d
        x = self._x + towards + (by @ change[..., None])[..., 0]
        p = self._p + change
        moved = found.pose_by_free + found.pose_by_unknowns @ by
        off = (found.pose_by_unknowns @ towards[..., None])[..., 0] + (moved @ change[..., None])[..., 0]
        self._tip = found.position[0] + off[0, :3], matrices(off[:, 3:])[0] @ found.rotation[0]
        short = float(np.abs(left).max())
        limited = bool(held.any()) and short > NEAR
        singular = not held.any() and short > max(NEAR, SHORT * float(np.abs(r).max()))
        problem, fields = self._task.problem, self._task.problem.record_fields
        self._task.write(x, p)
        record = problem.snapshot()
        record[:, fields["position"]], record[:, fields["rotation"]] = self._tip[0], self._tip[1].reshape(1, 9)
        ones = np.ones(1, dtype=np.int32)
        code = np.array([Status.AT_LIMIT if limited else Status.TRACKING], dtype=np.int32)
        result = self._command(record, Outcome(code, ones, ones), missing)
        weight = rows.weight[0] if rows.position is not None else rows.weight[1]
        result.target_error = float(np.linalg.norm(left[0, : min(3, left.shape[1])])) / float(weight)
        result.at_limit = frozen(((held[0][:, None] != 0) & (self._rows.matrix != 0)).any(axis=0))
        result.singular, result._by_free = singular, moved[0]
        result._remarks = self._rows.remarks(p[0], target.position, result.target_error)
        self._x, self._p = self._good = x, p
        if ahead is not None:
            d, _ = self._solved(J, ahead, p, later)
            change = self._unit * d
            self._x, self._p = x + (by @ change[..., None])[..., 0], p + change
        return result

    def _judged(self, found: Evaluation, r: FloatArray) -> Status:
        """Whether there is a stable equilibrium to go on from: the sign of det Gamma changes at a fold."""
        if found.failed[0] or not np.isfinite(r).all():
            return Status.NONFINITE
        sign = float(np.linalg.slogdet(found.gamma)[0][0])
        if self._sign == 0.0:
            self._sign = sign
        return Status.TRACKING if sign == self._sign else Status.UNSTABLE

    def _unlimited(self, J: FloatArray, r: FloatArray, ahead: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """(8) The steps of this sample and of the next one where no limit holds, by one factorisation, each of shape (1, k)."""
        m, k = J.shape[1:]
        root = sqrt(_softness(J))
        system, sides = np.zeros((k + m, k + m)), np.zeros((k + m, 2))
        diagonal = system.reshape(-1)[:: k + m + 1]
        diagonal[:k], diagonal[k:] = root, -root
        system[:k, k:], system[k:, :k] = J[0].T, J[0]
        sides[k:, 0] = -r[0]
        if ahead is not None:
            sides[k:, 1] = -ahead[0]
        found = solved_each(system[None], sides[None])[0, :k].T
        return found[:1], found[1:]

    def _solved(self, J: FloatArray, r: FloatArray, p: FloatArray, unlimited: FloatArray) -> tuple[FloatArray, Any]:
        """(7) The step of a sample, bounded; ``unlimited`` if that keeps the limits."""
        rows, d, held = self._rows, unlimited, self._none_held
        at = p @ rows.matrix.T
        there = at + d @ self._scaled.T
        if not ((there >= rows.low) & (there <= rows.high)).all():
            low, high = np.minimum(rows.low - at, 0.0), np.maximum(rows.high - at, 0.0)
            found = step(J, r, softness=_softness(J), limits=self._scaled, low=low, high=high)
            d, held = found.change, found.held
        return d * min(1.0, LONGEST / max(float(np.abs(d).max()), 1e-300)), held

    def _expected(self, target: Pose, weight: FloatArray, count: int) -> FloatArray | None:
        """(16) By how much the next sample's rows will be off: the target's last change, and what that changed by."""
        before, self._last_target = self._last_target, target
        motion = np.zeros(6)
        if before is not None and before.count == target.count:
            if target.position is not None and before.position is not None:
                motion[:3] = target.position - before.position
            if target.rotation is not None and before.rotation is not None:
                motion[3:] = vectors((target.rotation @ before.rotation.T)[None])[0]
            if target.axis is not None and before.axis is not None:
                motion[3:] = np.cross(before.axis, target.axis)
        last, self._last_motion = self._last_motion, motion
        expected = motion if last is None else 2 * motion - last
        if before is None or not expected.any():
            return None
        ahead = np.zeros((1, count))
        row = 0
        if target.position is not None:
            ahead[0, :3] = -weight[0] * expected[:3]
            row = 3
        if target.rotation is not None:
            ahead[0, row:] = -weight[1] * expected[3:]
        elif target.axis is not None:
            # how a still tip would be tilted from an axis that turns
            turned = matrices(expected[None, 3:])[0].T @ target.axis
            frame = np.zeros((1, 3, 3))
            frame[0, :, 2] = turned
            wanted = Pose(position=target.position, axis=target.axis).rows(self._length)
            ahead[0, row:] = wanted.errors(np.zeros((1, 3)), frame)[0][0, row:]
        return ahead

    def _failed(self, target: Pose, status: Status, missing: bool) -> Command[Robot_co]:
        ones = np.ones(1, dtype=np.int32)
        result = self._command(self._task.problem.snapshot(), Outcome(status * ones, ones, ones), missing)
        result.target_error, result.singular = np.nan, False
        result.at_limit = np.zeros(len(self._unit), dtype=bool)
        result._by_free = np.full((6, len(self._unit)), np.nan)
        self._x, self._p = self._good
        result._remarks = self._rows.remarks(self._p[0], target.position, np.nan)
        self._last_target = self._last_motion = None
        return result

    def _command(self, record: FloatArray, outcome: Outcome, missing: bool) -> Command[Robot_co]:
        result: Command[Robot_co] = Command(self._scene, record, outcome)
        result.missing, result.free = missing, self.free
        result.offset = frozen(self._offset[:3].copy())
        return result


def _softness(J: FloatArray) -> float:
    return SOFTNESS * max(float((J * J).max()), 1e-300)
