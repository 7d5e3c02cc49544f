"""The solver within an estimator: one integration and one update a sample. Numbers in parentheses: ``docs/estimation.md``."""

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.kernels.shared import Shared
from multirod.launch import expect, record
from multirod.problem import BoundaryProblem
from multirod.solver import Outcome, Solver, Track
from multirod.solvers.shooting import Shooting
from multirod.status import Status, failures
from multirod.tasks.condensed import condensed
from multirod.tasks.condensed_kernels import Condensed
from multirod.tasks.estimating.bounded import Bounds
from multirod.tasks.estimating.crossing import crossed
from multirod.tasks.estimating.filter_kernels import Filter, make_filter
from multirod.tasks.estimating.inference import Posterior, deviations, largest_square, roots
from multirod.tasks.estimating.iterated import BENT, iterated
from multirod.tasks.estimating.iteration import Known, Part
from multirod.tasks.formulation import input_units
from multirod.tasks.measuring.along import Along
from multirod.tasks.measuring.along_rows import AlongRows
from multirod.tasks.measuring.sensors import Live
from multirod.tasks.rows import PoseRows
from multirod.tasks.watch import Watch
from multirod.tasks.watch_kernels import LOOK, NEXT
from multirod.validation import FloatArray, frozen

FIRST = 30  # iterations of the first sample


class FilterSolver(Solver):
    """The solver that a tracker steps; what it knows outlives the problem, which is made anew where another load comes in.

    Attributes:
        state: What kernels and NumPy share, by the names of ``filter_kernels``; what NumPy has of it are attributes too.
        unknowns: Of the boundary problem, shape (b, n).
        sound: Whether all instances go on from their last sample; the others are estimated by themselves.
        rejected: Whether what each sensor says now was left out as an outlier, shape (b, sensor_count).
        counted: Rows that were not, and are not missing, shape (b,).
    """

    def __init__(
        self, known: Known, live: Live, walked: FloatArray, start: FloatArray, gate: float | None, bounds: Bounds
    ) -> None:
        self.known, self.live, self.start, self.bounds = known, live, start, bounds
        self.names = known.unknown.names
        self.integrator = known.solver.integrator
        self.pose_sensitivities = True
        self.present: Any = None
        count, k = start.shape[:2]
        sizes: dict[str, tuple[int, ...]] = dict.fromkeys(("walked", "covariance", "free", "grown"), (k, k))
        sizes |= dict.fromkeys(("mean", "prior"), (k,)) | dict.fromkeys(("square", "sign", "moved", "bent"), ())
        self.state = {name: Shared((count, *shape), wp.float64, known.device) for name, shape in sizes.items()}
        self.state |= {name: Shared((count,), wp.int32, known.device) for name in ("begun", "status", "doubt", "again")}
        for name, values in {"walked": walked, "covariance": start, "free": start}.items():
            self.state[name].values[:] = values
        self.mean, self.covariance, self.free, self.square, self.sign, self.begun, self.status, self.bent = (
            self.state[name].values for name in ("mean", "covariance", "free", "square", "sign", "begun", "status", "bent")
        )
        self.unknowns = np.zeros((count, 0))
        self.sound = False
        self.once: Any = frozen(np.ones(count, dtype=np.int32))
        self._none_rejected = np.zeros(live.missing.shape, dtype=bool)
        self.state["rejected"] = Shared(live.missing.shape, wp.int32, known.device)
        self.most = None if gate is None else largest_square(np.arange(1 + live.known.shape[1]), gate)
        self.let_through()
        expect(make_filter, known.device)

    def let_through(self) -> None:
        """All that is measured, until it is looked at."""
        self.rejected, self.counted = self._none_rejected, self.live.counted

    def leave_out(self) -> None:
        """(15) What the last sample found to be outliers."""
        rejected = self.state["rejected"].values != 0
        if not rejected.any():
            return
        kept = self.live.known.copy()
        for j, rows in enumerate(self.live.slices):
            kept[:, rows] &= ~rejected[:, j, None]
        self.rejected, self.counted = rejected, kept.sum(axis=1)

    def outliers(self) -> tuple[str, ...]:
        """What of the first instance was left out, in words."""
        if self.rejected is self._none_rejected:
            return ()
        return tuple(f"sensor {k}, an outlier" for k in np.flatnonzero(self.rejected[0]))

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        return Shooting(integrator=self.integrator).solve(problem, guess)

    def track(self, problem: BoundaryProblem, dt: float) -> "FilterTrack":  # noqa: D102
        return FilterTrack(self, problem)


class _Markers:
    """Poses along rods, as kernels read them: the fields of ``state`` that are of markers."""

    def __init__(self, live: Live, state: Any, count: int, n: int, k: int, device: str) -> None:  # noqa: ANN401  (of Warp)
        own = [rows.place if isinstance(rows, PoseRows) else None for rows in live.rows]
        self.places = [place for place in own if place is not None]
        numbers = [-1 if place is None else sum(other is not None for other in own[:i]) for i, place in enumerate(own)]
        state.marker = wp.array(np.array(numbers, dtype=np.int32), dtype=wp.int32, device=device)
        size = count * max(len(self.places), 1)
        state.marks, self._shared = Condensed(), []
        for fields, name, shape, dtype in (
            (state.marks, "position", (), wp.vec3d),
            (state.marks, "rotation", (), wp.mat33d),
            (state, "columns", (6, n + k), wp.float64),
        ):
            shared = Shared((size, *shape), dtype, device)
            setattr(fields, name, shared.array)
            self._shared.append(shared)
        self._values = [shared.values.reshape(count, -1, *shared.values.shape[1:]) for shared in self._shared]
        state.marks.carried, state.marker_r, state.marker_J = (
            wp.zeros((size, 6, *rest), dtype=wp.float64, device=device) for rest in ((1 + k,), (), (k,))
        )

    def put(self, found: Along) -> None:
        """What the last integration said of them."""
        if not self.places:
            return
        position, rotation, columns = self._values
        for j, (rod, place) in enumerate(self.places):
            there = found.poses[rod]
            position[:, j], rotation[:, j], columns[:, j] = (
                there.position[:, place],
                there.rotation[:, place],
                there.columns[:, place],
            )
        for shared in self._shared:
            shared.send()


class FilterTrack(Track):
    """The filter on the buffers of one problem."""

    def __init__(self, known: FilterSolver, problem: BoundaryProblem) -> None:
        self.known, self.problem = known, problem
        live = known.live
        self.task = live.task(problem, known.names)
        count, n, k, m = problem.instance_count, problem.unknown_count, self.task.count, live.known.shape[1]
        if known.unknowns.shape[1] != n:
            # what else is compiled in has other unknowns: as at the first sample
            known.unknowns, known.begun[:], known.sound = np.zeros((count, n)), 0, False
        state: Any = Filter()
        state.task, self._columns = condensed(self.task)
        shared = known.state | live.poses | {"known": live.there, "whitening": live.whitening}
        apart = not wp.get_device(problem.device).is_cpu
        self._sent, self._fetched = (list(each.values()) if apart else [] for each in (shared, known.state))
        sensed = [index for index, rows in enumerate(live.rows) if isinstance(rows, AlongRows)]
        self._told = Shared((count, m, 1 + n + k) if sensed else (1, 1, 1), wp.float64, problem.device)
        self._sensed = [(index, self._told.values[:, live.slices[index]]) for index in sensed]
        self._markers = _Markers(live, state, count, n, k, problem.device)
        for name, each in (shared | {"told": self._told}).items():
            setattr(state, name, each.array)
        room = {
            "r": (m,),
            "J": (m, k),
            "normal": (k, 1 + k),
            "system": (k, k),
            "sides": (k, 1 + k),
            "offset": (k,),
            "unknowns": (n,),
        }
        for name, shape in room.items():
            setattr(state, name, wp.zeros((count, *shape), dtype=wp.float64, device=problem.device))
        firsts = [own.start for own in live.slices]
        state.kind = wp.array(np.array(live.kinds, dtype=np.int32), dtype=wp.vec3i, device=problem.device)
        state.row = wp.array(np.array(firsts, dtype=np.int32), dtype=wp.int32, device=problem.device)
        state.gated = int(known.most is not None)
        state.most = wp.array(np.zeros(1) if known.most is None else known.most, dtype=wp.float64, device=problem.device)
        units = {"curvature": problem.curvature_scale(), "unit": input_units(known.known.robot, known.names)}
        self._watch = Watch(self.task, units["unit"])
        state.watched = self._watch.state
        for name, values in units.items():
            setattr(state, name, wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=problem.device))
        self._state = state  # whose arrays the launch works in
        self._launch = record(make_filter, count, [state], problem.device)
        self._placed, self._kinked = False, len(problem.kinks) > 0

    def step(self) -> Outcome:
        """What has begun goes on; what has not, or was lost, is estimated by itself."""
        known = self.known
        fresh = known.begun == 0
        known.let_through()
        outcome = self._go_on() if known.sound or known.begun.any() else Outcome.zeros(len(fresh))
        if not known.sound:
            self._begin(np.flatnonzero(fresh), outcome)
            known.sound = bool(known.begun.all())
        return outcome

    def _go_on(self) -> Outcome:
        """(10) to (12), (15): one integration at what is expected, and the step that the measurements ask for."""
        known, problem = self.known, self.problem
        with problem.alone:
            if not self._placed:
                self.task.write(known.unknowns, known.mean)
                self._placed = True
            self._watch.catch_up()
            self.task.integrate()
            mean, covariance = known.mean.copy(), known.covariance.copy()
            begun = np.array(problem.read("unknowns")) if self._kinked else None
            self.update()
            spent = known.once if begun is None else crossed(self, begun, known.once)
            if known.bent.max() > BENT:
                spent = iterated(self, spent)
            self._keep_within(mean)
            if known.state["doubt"].values.any():
                spent = spent.copy()
                self._look(spent, mean, covariance)
        known.unknowns = problem.read("unknowns")
        if known.most is not None:
            known.leave_out()
        if not known.sound:  # what begins anew says otherwise
            return Outcome(known.status.copy(), known.once.copy(), spent.copy())
        known.sound = bool(known.begun.all())
        return Outcome(known.status.copy(), known.once, spent)

    def again(self, rows: IntArray) -> None:
        """The update of some instances from what they began this sample with, by an integration where the problem is."""
        chosen, mark = np.zeros(len(self.known.begun), dtype=bool), self.known.state["again"]
        chosen[rows] = True
        mark.values[:] = np.where(chosen, 1, -1)
        with self.problem.only(chosen):
            self.task.integrate()
        self.update()
        mark.write(0)

    def update(self) -> None:
        """The step that the measurements ask for, by the last integration."""
        self._tell()
        for shared in self._sent:
            shared.send()
        self._launch.launch()
        for shared in self._fetched:
            shared.fetch()

    def _keep_within(self, before: FloatArray) -> None:
        """(11) What an update leads beyond a limit, from ``before`` (b, k), ends at the most probable mean within the limits."""
        known, problem = self.known, self.problem
        step = known.mean - before
        out = known.bounds.leading_out(step, before)
        if not len(out):
            return
        covariance, step, before = known.covariance[out], step[out], before[out]
        count, k = step.shape
        free = Posterior(step, covariance, np.zeros(count))
        told = np.zeros((count, 0, k)), np.zeros((count, 0)), roots(covariance), -step, deviations(covariance)
        kept = known.bounds.kept(before + known.bounds.step(free, before, told)[0], before)
        unknowns = problem.read("unknowns")
        shift = self._state.task.shift.numpy()[out, :, 1:]
        unknowns[out] += (shift @ (kept - known.mean[out])[..., None])[..., 0]
        known.mean[out] = kept
        self.task.write(unknowns, known.mean)

    def _look(self, spent: NDArray[np.int32], mean: FloatArray, covariance: FloatArray) -> None:
        """(17) of docs/tasks.md: whether samples are stable that may not be; one that is not is lost, and what was estimated
        before is kept."""
        known, problem, watch = self.known, self.problem, self._watch
        doubt = known.state["doubt"].values
        rows = np.flatnonzero(doubt == NEXT)
        if len(rows):
            watch.keep(rows, watch.gamma()[rows])
        rows = np.flatnonzero(doubt == LOOK)
        if not len(rows):
            return
        unknowns = problem.read("unknowns")
        stable, taken = watch.look(rows)
        problem.write("unknowns", unknowns)  # (12): the next sample begins there
        spent[rows] += taken
        lost = rows[~stable]
        if not len(lost):
            return
        known.status[lost], known.begun[lost], known.square[lost] = Status.UNSTABLE, 0, np.nan
        known.mean[lost] = mean[lost]
        known.covariance[lost] = covariance[lost] + known.state["walked"].values[lost]
        self.task.write(problem.read("unknowns"), known.mean)

    def _tell(self) -> None:
        """Rows that kernels do not know of; columns that they do not find."""
        self._columns.update()
        if not (self._sensed or self._markers.places):
            return
        found = self.task.sensed()
        for index, told in self._sensed:
            rows: Any = self.known.live.rows[index]
            rows.put(found, told)
        self._told.send()
        self._markers.put(found)

    def _begin(self, chosen: NDArray[np.intp], outcome: Outcome) -> None:
        """The first sample of some instances, estimated by itself; the next is the first again where it fails."""
        if not len(chosen):
            return
        known, scene = self.known, self.known.known
        every = len(chosen) == len(known.begun)
        now = replace(scene, inputs=scene.unknown.at_means(scene.robot, known.present(), scene.batch_shape))
        measured = known.live if every else known.live.take(chosen)
        part = Part(now, slice(None) if every else chosen, None if every else chosen, measured)
        part.run()
        ended = part.outcome
        known.mean[chosen], known.covariance[chosen], known.square[chosen] = part.p, part.covariance, part.square
        known.unknowns[chosen], known.free[chosen] = part.x, known.start[chosen]
        known.begun[chosen] = ~failures(ended.status)
        self.task.evaluate(known.unknowns, known.mean, np.isin(np.arange(len(known.begun)), chosen))
        gamma = self.problem.read("gamma")[chosen].reshape(len(chosen), *2 * (part.x.shape[1],))
        known.sign[chosen] = _signs(gamma)
        begun = known.begun[chosen] != 0
        self._watch.begin(chosen[begun], gamma[begun])
        outcome.status[chosen], outcome.iterations[chosen] = ended.status, ended.iterations
        outcome.integrations[chosen] = ended.integrations + 1 + self.task.count * begun


def _signs(gamma: FloatArray) -> FloatArray:
    """Of the determinant of each matrix, shape (b,)."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.linalg.slogdet(gamma)[0])
