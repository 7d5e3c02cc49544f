"""Settings run on a motion one after the other, each within its share of the time."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.batch import Interrupted
from multirod.inputs import Inputs
from multirod.results.history import History
from multirod.running.simulation import Runner, as_solver, sample_times, simulate
from multirod.solver import Solver
from multirod.studies.tradeoffs import limit as clock
from multirod.studies.tradeoffs.limit import Limited
from multirod.studies.tradeoffs.reference import SHAPE_NODES, Reference, load_kernels
from multirod.studies.tradeoffs.settings import Setting, grid, registered, settings
from multirod.studies.tradeoffs.table import Measured, Tradeoff
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, instance, nonnegative_float, positive_float, refuse

START = 6  # samples that say how long all will take
OVERHEAD = 2e-5  # of keeping a sample [s]
FEWEST = 50  # samples after settling that errors and a 95th percentile may come from
SLOW = 20.0  # times the median of all, beyond which a setting is run on the fewest samples only
SPENT = 0.8  # of the time left, that is shared out by such estimates
LARGEST_PART = 0.5  # of the time left, that one setting may take if it needs that much for the fewest
TRIED_PART = 0.5  # of the time, after which no more settings are tried but those that were are run
TRIAL_PART = 0.2  # the same for its first samples
RUN_PART = 0.25  # of the time, that those that were tried are run for, even if compiling them has taken all
TOTAL = 2.0  # times the budget, that the reference, all settings and what is run again may take
PATIENCE = 3.0  # times its share, that a setting may take


class Measurement:
    """A grid of settings on a motion: the reference is computed first, ``run`` does the rest.

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
        time: Numbers,
        solvers: Mapping[str, Solver] | None = None,
        models: Mapping[str, tuple[Assembly, Inputs]] | None = None,
        settle: float = 0.3,
        budget: float = 60.0,
    ) -> None:
        self._limit = limit = positive_float("budget", budget)
        if solvers is not None:
            instance("solvers", solvers, Mapping, "solvers by name")
            if not solvers:
                refuse("solvers", solvers, "there must be one")
            for name, solver in solvers.items():
                instance("solvers", name, str, "solvers by name")
                instance(f"solvers[{name!r}]", solver, Solver, "a Solver such as Shooting()")
        as_solver(robot, None)
        inputs, samples = robot.accept(inputs), sample_times(time)[0]
        models = {} if models is None else models
        _check_models(models)
        _one_motion("inputs", robot, inputs)
        for name, (other, given) in models.items():
            _one_motion(f"models[{name!r}]", other, other.accept(given, f"models[{name!r}]"))
            if other.rod_count != robot.rod_count:
                refuse(f"models[{name!r}]", Described(f"{other.rod_count} rods"), f"must be {robot.rod_count} as the robot's")
        if not len(samples):
            refuse("time", time, "there must be a sample")
        if not (samples >= nonnegative_float("settle", settle)).any():
            refuse("settle", settle, f"must be before the last sample, {np.max(samples, initial=0):g} s; settle=0 counts all")
        self._skipped: dict[str, str] = {}
        if solvers is None:
            solvers = grid(robot, inputs)
            for name, made in registered():
                if isinstance(made, Solver):
                    solvers[name] = made
                else:
                    self._skipped[name] = made
        self.settings = settings(robot, inputs, solvers, models)
        started = clock.now()
        load_kernels(robot, inputs)
        self._begin = clock.now()
        self.reference = Reference(robot, inputs, samples, budget=limit)
        # however long the reference and its kernels took, the settings have half
        self._left = self._whole = max(limit - (clock.now() - started), 0.5 * limit)
        self._time, self._settled, self._settle = samples, samples >= settle, settle
        self._waiting = set(self.settings)
        self._rows: list[Measured] = []
        self._tips: dict[str, FloatArray] = {}

    @property
    def table(self) -> Tradeoff:
        """What has been measured."""
        waiting = {name: "the run ended before" for name in self.settings if name in self._waiting}
        return Tradeoff(self._rows, {**self._skipped, **waiting}, self.reference, self._tips, self._settle)

    def run(self) -> Iterator[tuple[str, Measured | None]]:
        """Measure all: each setting is tried on a few samples first, then each is run on as many as there is time for.

        Yields:
            The setting that was tried, or run, and its row if it was run: ``2 * len(settings)`` in all.
        """
        trials: dict[str, _Trial] = {}
        for name in self.settings:
            with self._guarded(name):
                trials[name] = self._try(self.settings[name], first=not trials)
            yield name, None
        self._left = max(self._left, RUN_PART * self._whole)
        common = self._common(list(trials.values()))
        for name in self.settings:
            row = None
            if name in trials:
                with self._guarded(name):
                    row = self._run(name, trials[name], common)
                    self._rows.append(row)
            self._waiting.discard(name)
            yield name, row

    def repeat(self, name: str) -> Measured:
        """A setting once more, on the whole motion.

        Raises:
            ValueError: If twice the budget is over before it ends.
        """
        setting = self.settings[name]
        seconds = TOTAL * self._limit - (clock.now() - self._begin)
        history = self._simulate(setting, None, len(self._time), seconds) if seconds > 0 else None
        if history is None:
            refuse("budget", self._limit, f"twice as many seconds were over before {name} had run again on the whole motion")
        return measured(name, setting, history, self.reference, self._settled)

    @contextmanager
    def _guarded(self, name: str) -> Iterator[None]:
        """Count the time that a setting takes; where it raises, note why and go on: it may be a solver of someone else."""
        begin = clock.now()
        try:
            yield
        except (ValueError, _NoTime) as error:
            self._skipped[name] = str(error)
        except Exception as error:  # noqa: BLE001  (whatever it is, the others go on)
            self._skipped[name] = f"{type(error).__name__}: {error}"
        finally:
            self._left -= clock.now() - begin
            if name in self._skipped:
                self._waiting.discard(name)

    def _try(self, setting: Setting, *, first: bool) -> "_Trial":
        """Run the first samples; of the first setting, however long it takes to compile, or there might be no row at all."""
        if self._left <= (1 - TRIED_PART) * self._whole and not first:
            raise _NoTime("no time was left")
        begin = clock.now()
        one = setting.inputs[0] if setting.inputs.batch_shape else setting.inputs
        # kernels are made or loaded here, which is no part of any time
        problem = Runner(setting.robot, setting.solver, one, 1.0, "cpu", setting.inputs.active).problem
        problem.integrate()
        if problem.shapes is not None:
            problem.shapes.at_nodes(SHAPE_NODES)
        guess = None
        with suppress(ValueError):  # a model may have other unknowns
            guess = problem.adopt(self.reference.history.unknowns[:1]) if self.reference.known[0] else None
        left = self._left - (clock.now() - begin)
        begin = clock.now()
        seconds = max(left / len(self._waiting), TRIAL_PART * left, TRIAL_PART * self._whole if first else 0.0)
        if seconds <= 0:
            raise _NoTime("no time was left once its kernels were compiled")
        ends: list[float] = []
        history = self._simulate(setting, guess, START, seconds, lambda done: ends.append(clock.now()))
        if history is None:
            raise _NoTime("its first samples took longer than its share of the time")
        # by the clock, too: on a busy machine more goes by than a step takes
        each = max(float(np.median(history.step_time[-START + 1 :])), float(np.median(np.diff(ends)))) + OVERHEAD
        return _Trial(each, clock.now() - begin)

    def _common(self, trials: "list[_Trial]") -> int:
        """Samples that all settings but those much slower than most are run on, so that their errors are of the same motion."""
        total = len(self._time)
        if not trials:
            return total
        usual = SLOW * float(np.median([trial.each for trial in trials]))
        fast = [trial for trial in trials if trial.each <= usual]
        slow = sum(trial.fixed + trial.each * self._fewest for trial in trials if trial.each > usual)
        left = SPENT * self._left - min(slow, LARGEST_PART * self._left) - sum(trial.fixed for trial in fast)
        return int(np.clip(left / sum(trial.each for trial in fast), self._fewest, total))

    @property
    def _fewest(self) -> int:
        return min(len(self._time), int(np.argmax(self._settled)) + FEWEST)

    def _run(self, name: str, trial: "_Trial", common: int) -> Measured:
        share = self._left / len(self._waiting)
        allowed = max(share, LARGEST_PART * self._left)
        whole = trial.fixed + trial.each * common
        count = common if whole <= min(allowed, PATIENCE * share) else self._fewest
        if self._left <= 0:
            raise _NoTime("no time was left")
        if trial.each * count > allowed:
            raise _NoTime(f"too slow for the time that was left: {self._fewest} samples are needed")
        setting = self.settings[name]
        # from nothing, as in any run of one's own
        history = self._simulate(setting, None, count, min(self._left, max(allowed, PATIENCE * share)))
        if history is None:
            raise _NoTime("it took longer than its first samples promised")
        self._tips[name] = history.tip_position
        return measured(name, setting, history, self.reference, self._settled)

    def _simulate(
        self,
        setting: Setting,
        guess: FloatArray | None,
        count: int,
        seconds: float,
        progress: bool | Callable[[int], object] = False,
    ) -> History | None:
        """The first samples; None where they take longer than that."""
        count = min(count, len(self._time))
        inputs = setting.inputs
        if inputs.batch_shape not in ((), (1,)):
            # not inputs[:count]: what is zero in the first samples only must be compiled in as for all
            inputs = inputs.take(inputs.batch_shape, np.arange(count))
        solver = Limited(setting.solver, seconds)
        try:
            return simulate(setting.robot, inputs, time=self._time[:count], solver=solver, guess=guess, progress=progress)
        except Interrupted:
            return None


@dataclass(frozen=True)
class _Trial:
    """What a setting's first samples told.

    Attributes:
        each: Time that a sample adds [s].
        fixed: Time that a run takes to begin [s].
    """

    each: float
    fixed: float


class _NoTime(Exception):
    """Why a setting was not run."""


def measured(name: str, setting: Setting, history: History, reference: Reference, settled: NDArray[np.bool_]) -> Measured:
    """What a setting came to in its first samples; only those count in which the reference has a result."""
    count = len(history.time)
    failed = np.asarray(~np.isfinite(history.tip_position).all(axis=-1))
    counted = settled[:count] & reference.known[:count]
    errors = reference.errors(history, counted)

    def largest(values: FloatArray) -> float:
        return float(np.max(values)) if counted.any() and not failed[counted].any() else np.inf

    shape = largest(errors.shape)
    warm = slice(2 if count > 2 else 0, None)  # the first start from nothing
    return Measured(
        name=name,
        solver=setting.solver,
        position=max(largest(errors.position[counted]), shape if reference.by_shape else 0.0),
        rotation=largest(errors.rotation[counted]),
        shape=shape,
        residual=largest(np.asarray(history.residual)[counted]),
        median=float(np.median(history.step_time[warm])),
        slow=float(np.percentile(history.step_time[warm], 95)),
        integrations=float(np.mean(history.integrations[warm])),
        samples=count,
        failed=int(failed.sum()),
        model=setting.model,
    )


def _check_models(models: object) -> None:
    instance("models", models, Mapping, "robots and inputs by name")
    for name, model in cast(Mapping[object, object], models).items():
        instance("models", name, str, "robots and inputs by name")
        if not isinstance(model, (list, tuple)) or len(model) != 2:
            refuse(f"models[{name!r}]", model, "must be a pair, robot and inputs")
        instance(f"models[{name!r}]", model[0], Assembly, "a pair, robot and inputs")


def _one_motion(field: str, robot: Assembly, inputs: Inputs) -> None:
    axes = max(inputs.batch_shape[1:], robot.batch_shape, key=len)
    if axes:
        refuse(
            field, Described(f"leading axes {(*inputs.batch_shape[:1], *axes)}"), "there must be one, time: no batch of motions"
        )
