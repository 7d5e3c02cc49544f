"""Settings run on a motion one after the other, each within its share of the time."""

from collections.abc import Mapping
from math import ceil
from threading import Timer
from time import monotonic
from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.batch import Interrupted
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem
from multirod.simulation import Runner, as_solver, simulate
from multirod.solution import History
from multirod.solver import Outcome, Solver, Track
from multirod.tradeoffs.reference import Reference
from multirod.tradeoffs.settings import Setting, grid, registered, settings
from multirod.tradeoffs.table import Measured, Tradeoff
from multirod.validation import Described, FloatArray, array, nonnegative_float, positive_float, refuse

START = 3  # samples of a first run
TRIAL = 20  # samples that say how long all will take
FEWEST = 50  # samples after settling that errors and a 95th percentile may come from
LARGEST_PART = 0.5  # of the time left, that one setting may take if it needs that much for the fewest
PATIENCE = 2.0  # times its estimate, after which a run is stopped


class Measurement:
    """A grid of settings on a motion: the reference is computed first, then ``measure`` takes one setting after the other.

    ``table`` holds what there is at any time: a run that is stopped in between loses nothing that was measured.

    Args:
        robot: See ``tradeoff`` for these.
        inputs: Of the motion.
        time: Of the samples.
        solvers: By name.
        models: By name.
        settle: Errors count from here on [s].
        budget: Of time [s].
    """

    def __init__(
        self,
        robot: Assembly,
        inputs: Inputs,
        *,
        time: Any,
        solvers: Mapping[str, Solver] | None = None,
        models: Mapping[str, tuple[Assembly, Inputs]] | None = None,
        settle: float = 0.3,
        budget: float = 60.0,
    ) -> None:
        limit = positive_float("budget", budget)
        if solvers is not None and not solvers:
            refuse("solvers", solvers, "there must be one")
        as_solver(robot, None)
        inputs, samples = robot.accept(inputs), array("time", time)
        _one_motion("inputs", robot, inputs)
        for name, (other, given) in (models or {}).items():
            as_solver(other, None)
            _one_motion(f"models[{name!r}]", other, other.accept(given))
            if other.rod_count != robot.rod_count:
                refuse(f"models[{name!r}]", Described(f"{other.rod_count} rods"), f"must be {robot.rod_count} as the robot's")
        if samples.ndim != 1 or not (samples >= nonnegative_float("settle", settle)).any():
            refuse("settle", settle, f"must be before the last sample, {np.max(samples, initial=0):g} s")
        self._skipped: dict[str, str] = {}
        if solvers is None:
            solvers = grid(robot, inputs)
            for name, made in registered():
                if isinstance(made, Solver):
                    solvers[name] = made
                else:
                    self._skipped[name] = made
        for solver in solvers.values():
            as_solver(robot, solver)
        self.settings = settings(robot, inputs, solvers, models or {})
        begin = monotonic()
        self.reference = Reference(robot, inputs, samples)
        # however long the reference took, the settings have half
        self._left = max(limit - (monotonic() - begin), 0.5 * limit)
        self._time, self._settled, self._settle = samples, samples >= settle, settle
        self._waiting = set(self.settings)
        self._rows: list[Measured] = []
        self._tips: dict[str, FloatArray] = {}

    @property
    def table(self) -> Tradeoff:
        """What has been measured."""
        waiting = {name: "the run ended before" for name in self.settings if name in self._waiting}
        return Tradeoff(self._rows, {**self._skipped, **waiting}, self.reference, self._tips, self._settle)

    def measure(self, name: str) -> Measured | None:
        """Run one setting, within its share of the time left; None where it gave nothing, ``table.skipped`` then says why."""
        setting = self.settings[name]
        share = self._left / len(self._waiting)
        reason, row, used = "no time was left", None, 0.0
        if self._left > 0:
            try:
                self._compile(setting)
                begin = monotonic()
                try:
                    row, reason = self._run(name, setting, share)
                finally:
                    used = monotonic() - begin
            except Exception as error:  # a solver of someone else may raise anything: the others go on
                reason = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        self._left -= used
        self._waiting.discard(name)
        if row is None:
            self._skipped[name] = reason
        else:
            self._rows.append(row)
        return row

    def repeat(self, name: str) -> Measured:
        """A setting once more, on the whole motion, however long it takes."""
        setting = self.settings[name]
        history = simulate(setting.robot, setting.inputs, time=self._time, solver=setting.solver, progress=False)
        return measured(name, setting, history, self.reference, self._settled)

    def _compile(self, setting: Setting) -> None:
        """Let kernels be made, which is no part of any time."""
        inputs = setting.inputs
        first = inputs[0] if inputs.batch_shape else inputs
        Runner(setting.robot, setting.solver, first, 1.0, "cpu", inputs.active).problem.integrate()

    def _run(self, name: str, setting: Setting, share: float) -> tuple[Measured | None, str]:
        total, first = len(self._time), int(np.argmax(self._settled))
        fewest = min(total, first + FEWEST)
        allowed = max(share, LARGEST_PART * self._left)
        begin = monotonic()
        trial = _simulate(setting, self._time, min(START, total), allowed)
        if trial is None:
            return None, "a sample takes longer than its share of the time"
        fixed = monotonic() - begin
        each = float(np.median(trial.step_time))
        if each * TRIAL < 0.5 * share and total > TRIAL:
            _simulate(setting, self._time, TRIAL, allowed)
            # what a sample adds, apart from what a run takes to begin
            each = max(each, (monotonic() - begin - 2 * fixed) / (TRIAL - START))
        within = int((share - (monotonic() - begin) - fixed) / each)
        count = total if total <= within else min(total, max(fewest, within))
        if each * count > allowed:
            return None, f"a sample takes {each:.2g} s, which leaves no time for the {fewest} that are needed"
        history = _simulate(setting, self._time, count, fixed + PATIENCE * max(share, each * count))
        if history is None:
            return None, f"it took longer than its first samples, {each:.2g} s, promised"
        self._tips[name] = history.tip_position
        return measured(name, setting, history, self.reference, self._settled), ""


def measured(name: str, setting: Setting, history: History, reference: Reference, settled: Any) -> Measured:
    """What a setting came to in its first samples; only those count in which the reference has a result."""
    count = len(history.time)
    failed = np.asarray(~np.isfinite(history.tip_position).all(axis=-1))
    counted = settled[:count] & reference.known[:count]
    errors = reference.errors(history)

    def largest(values: FloatArray) -> float:
        return float(np.max(values[counted])) if counted.any() and not failed[counted].any() else np.inf

    warm = slice(2 if count > 2 else 0, None)  # the first start from nothing
    return Measured(
        name=name,
        solver=setting.solver,
        position=largest(errors.position),
        rotation=largest(errors.rotation),
        shape=largest(errors.shape),
        residual=largest(np.asarray(history.residual)),
        median=float(np.median(history.step_time[warm])),
        slow=float(np.percentile(history.step_time[warm], 95)),
        integrations=float(np.mean(history.integrations[warm])),
        samples=count,
        failed=int(failed.sum()),
        model=setting.model,
    )


def _simulate(setting: Setting, time: FloatArray, count: int, seconds: float) -> History | None:
    """The first samples; None where they take longer than that."""
    inputs = setting.inputs
    if inputs.batch_shape:
        # not inputs[:count]: what is zero in the first samples only must be compiled in as for all
        inputs = inputs.take(inputs.batch_shape, np.arange(count))
    solver = _Limited(setting.solver, seconds)
    try:
        return simulate(setting.robot, inputs, time=time[:count], solver=solver, progress=False)
    except Interrupted:
        return None
    finally:
        solver.cancel()


class _Limited(Solver):
    """A solver whose run along a motion is stopped after some time, at its next integration; its samples cost nothing more."""

    def __init__(self, solver: Solver, seconds: float) -> None:
        self._solver, self._seconds = solver, ceil(1e3 * seconds) / 1e3
        self._timer: Timer | None = None
        self.integrator = solver.integrator
        self.pose_sensitivities = solver.pose_sensitivities
        self.direction_count = solver.direction_count

    def unsupported(self, problem: BoundaryProblem) -> tuple[str, ...]:
        return self._solver.unsupported(problem)

    def track(self, problem: BoundaryProblem, dt: float) -> Track:
        def stop() -> None:
            if problem.stop is not None:
                problem.stop.set()

        self._timer = Timer(self._seconds, stop)
        self._timer.daemon = True
        self._timer.start()
        return self._solver.track(problem, dt)

    def cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        return self._solver._solve(problem, guess)


def _one_motion(field: str, robot: Assembly, inputs: Inputs) -> None:
    axes = max(inputs.batch_shape[1:], robot.batch_shape, key=len)
    if axes:
        refuse(field, Described(f"leading axes {(*inputs.batch_shape[:1], *axes)}"), "there must be one, time: no batch of motions")
