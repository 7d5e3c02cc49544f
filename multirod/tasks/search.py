"""The way to a target: unknowns and freed inputs step together, many instances at once. Numbers: ``docs/tasks.md``."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.stability import Stability, modes_of
from multirod.status import Status
from multirod.tasks.formulation import Evaluation, Task
from multirod.tasks.gauss_newton import step
from multirod.tasks.limits import LimitRows, Limits
from multirod.tasks.rows import PoseRows
from multirod.validation import FloatArray

SOFTNESS = 1e-12  # of the largest number of J, squared: what moves the tip by less than a millionth of that is damped
RADIUS = 1.0  # longest step of a freed input, in units (9)
BEND = 5.0  # most that a step changes an unknown, in its scale of curvatures
GROWTH = 10.0  # of what is left, from which a step is taken back
LOST = 100.0  # of what was left when a part of the way began, from which it is given up
SHORTENED = 0.25  # what is left of a step that was taken back, or of a part of the way
LENGTHENED = 2.0  # times the part of a step that was kept, the next one's
LEAST_STEP = 0.01  # of a step
LEAST_PART = 0.01  # of the way
AT_REST = 1e-7  # a step in units (9) that is none
IN_PLACE = 1e-3  # the same of what the target leaves free
LOOSE = 1e3  # tolerances of places on the way, in those of the target
SINGULAR = 1e-5  # least over largest singular value of J, from which a target that is not reached is called singular
NEAR_LIMIT = 1e-8  # in units (9)
INSET = 1e-10  # likewise: limits are kept by so much, which rounding does not use up
MOST_STEPS = 40  # towards one goal
SETTLING = 4  # integrations that an equilibrium that was found by other kernels is brought to its tolerance by
PLACES = 12  # steps that a target that is reached gets for what it leaves free
CAREFUL = 0.125  # part of the way that is gone at once where all of it ended at an equilibrium that is not stable
NODES = 33  # of each rod, where its curvature is looked at

Prefer = Literal["smallest motion", "middle", "stability"]
BoolArray = NDArray[np.bool_]


@dataclass
class Place:
    """Unknowns and freed inputs; axes (instance, ...)."""

    x: FloatArray
    p: FloatArray

    def copy(self) -> "Place":
        """Another, that may change."""
        return Place(self.x.copy(), self.p.copy())

    def put(self, chosen: IntArray | BoolArray, other: "Place") -> None:
        """Take some instances of another."""
        self.x[chosen], self.p[chosen] = other.x[chosen], other.p[chosen]


@dataclass
class Goals:
    """What a search is for.

    Attributes:
        rows: Of the target.
        limits: Of the freed inputs.
        of_shape: Limits of shapes, if any.
        unit: (9), shape (k,).
        length: What makes rows numbers, the longest rod's [m].
        tolerance: Of the target, in its rows [1/m].
        residual_tolerance: Of ``eps`` [1/m], shape (b,).
        centre: Where what the target leaves free is pulled to, shape (k,); None are steps of least size.
        max_integrations: Allowed, of an instance and start.
    """

    rows: PoseRows
    limits: LimitRows
    of_shape: Limits | None
    unit: FloatArray
    length: float
    tolerance: float
    residual_tolerance: FloatArray
    centre: FloatArray | None
    max_integrations: int


class Search:
    """Drives the instances of one task to their targets, and judges what comes of it.

    Attributes:
        last: Where each instance is.
        status: Values of ``Status``, shape (b,).
        integrations: Of each instance, shape (b,).
        iterations: Steps that were kept, shape (b,).
        errors: Of the target's rows at ``last`` [1/m], shape (b, m).
    """

    def __init__(self, task: Task, goals: Goals, x: FloatArray, p: FloatArray) -> None:
        self.task, self.goals = task, goals
        (count, n), k, m = x.shape, p.shape[1], goals.rows.count
        self.origin, self.origin_unknowns = np.array(p), np.array(x)
        self.origin_errors = np.full((count, m), np.nan)  # NaN where the start is not known
        inset = np.minimum(INSET * np.abs(goals.limits.matrix) @ goals.unit, 0.25 * (goals.limits.high - goals.limits.low))
        self.low, self.high = goals.limits.low + inset, goals.limits.high - inset
        self.start = Place(np.array(x), np.array(p))
        self.last, self.base, self.here = self.start.copy(), self.start.copy(), self.start.copy()
        self.status = np.zeros(count, dtype=np.int32)
        self.integrations, self.iterations = np.zeros((2, count), dtype=np.int32)
        self.curvature = task.problem.curvature_scale()
        # of a drive: open, first evaluation to come, part of the way done, next part, its end, part of the last step, steps
        self.open, self.fresh = np.zeros((2, count), dtype=bool)
        self.done, self.part, self.goal, self.short = np.zeros((4, count))
        self.steps, self.settling = np.zeros((2, count), dtype=np.int32)
        self.blocked, self.folded = np.zeros((2, count), dtype=bool)
        self.least = LEAST_PART
        # at ``last``
        self.errors, self.first_errors, self.base_errors, self.r = np.zeros((4, count, m))
        self.J = np.zeros((count, m, k))
        self.towards, self.by, self.residual = np.zeros((count, n)), np.zeros((count, n, k)), np.zeros(count)
        self.sign, self.first_sign = np.zeros((2, count))
        self.merit, self.first_merit = np.full((2, count), np.inf)
        self.change = np.zeros((count, k))

    def begin(self, chosen: IntArray, start: Place) -> None:
        """Let some instances begin elsewhere, rows of ``start`` in their order."""
        self.start.x[chosen], self.start.p[chosen] = start.x, start.p

    def drive(self, chosen: BoolArray, part: float = 1.0, least: float = LEAST_PART) -> None:
        """Bring the instances chosen from ``start`` to their targets: all the way at once, or by parts of it.

        Parts that fail are shortened, to no less than ``least``, others lengthened. ``status`` is then ``REACHED``, ``AT_LIMIT``,
        ``UNREACHABLE``, ``SINGULAR_TASK`` or ``INTEGRATION_LIMIT``, or ``UNSTABLE`` if the only equilibrium found is past a fold.
        """
        for place in (self.last, self.base, self.here):
            place.put(chosen, self.start)
        self.open[:], self.fresh[chosen], self.least = chosen, True, least
        self.done[chosen], self.part[chosen], self.goal[chosen] = 0.0, part, part
        self.steps[chosen], self.settling[chosen], self.short[chosen] = 0, 0, 1.0
        self.merit[chosen], self.status[chosen] = np.inf, Status.NOT_RUN
        self.blocked[chosen], self.folded[chosen] = False, False
        begun = np.zeros(len(chosen), dtype=bool)
        allowed = self.integrations + self.goals.max_integrations
        while self.open.any():
            rows = np.flatnonzero(self.open)
            found = self.task.evaluate(self.here.x, self.here.p, self.open)
            self.integrations[rows] += 1
            kept = self._accept(rows, found)
            self._retreat(rows[~kept])
            rows = rows[kept]
            new = rows[~begun[rows]]
            self.first_errors[new], self.base_errors[new] = self.errors[new], self.errors[new]
            self.first_sign[new], begun[new] = self.sign[new], True
            self._arrive(rows)
            self._step(rows[self.open[rows]])
            self._end(np.flatnonzero(self.open & (self.integrations >= allowed)), Status.INTEGRATION_LIMIT)

    # ---- one pass ----

    def _left(self, rows: IntArray, values: FloatArray) -> FloatArray:
        """(13) Rows as they are short of the present goal."""
        return values - (1 - self.goal[rows, None]) * self.first_errors[rows]

    def _accept(self, rows: IntArray, found: Evaluation) -> BoolArray:
        """Take over what an integration said, where it is sound and no farther from the goal than a step may lead; which."""
        goals = self.goals
        errors, by_x, by_p = goals.rows.take(rows).at(found)
        r, J = found.condensed(errors, by_x, by_p)
        towards, by = found.eliminated
        bent = np.abs(towards).max(axis=1, initial=0.0) / self.curvature[rows]
        merit = np.maximum(goals.length * np.linalg.norm(self._left(rows, r), axis=1), bent)
        kept = np.isfinite(merit) & np.isfinite(J).all(axis=(1, 2)) & ~found.failed
        kept &= self.fresh[rows] | (merit <= GROWTH * self.merit[rows] + goals.length * goals.tolerance)
        chosen = rows[kept]
        self.last.put(chosen, self.here)
        self.iterations[chosen] += ~self.fresh[chosen]
        self.fresh[chosen], self.short[chosen] = False, np.minimum(1.0, LENGTHENED * self.short[chosen])
        self.errors[chosen], self.r[chosen], self.J[chosen] = errors[kept], r[kept], J[kept] * goals.unit
        self.towards[chosen], self.by[chosen] = towards[kept], by[kept] * goals.unit
        self.residual[chosen] = np.abs(found.residual[kept]).max(axis=1, initial=0.0)
        self.sign[chosen] = np.linalg.slogdet(found.gamma[kept])[0]
        self.merit[chosen] = merit[kept]
        return np.asarray(kept)

    def _retreat(self, rows: IntArray) -> None:
        """Take back a part of the last step, or all of this part of the way."""
        self.short[rows] *= SHORTENED
        failed = self.fresh[rows] | (self.short[rows] < LEAST_STEP)
        self._shorten(rows[failed])
        self._go(rows[~failed])

    def _go(self, rows: IntArray) -> None:
        """To where the last step leads, or a part of it."""
        d, part = self.change[rows], self.short[rows, None]
        self.here.x[rows] = self.last.x[rows] + part * (self.towards[rows] + (self.by[rows] @ d[..., None])[..., 0])
        self.here.p[rows] = self.last.p[rows] + part * self.goals.unit * d

    def _shorten(self, rows: IntArray) -> None:
        """Try a shorter part of the way, from where the last one ended."""
        self.part[rows] *= SHORTENED
        over = self.part[rows] < self.least
        ended = rows[over]
        self.last.put(ended, self.base)
        self.errors[ended] = self.base_errors[ended]
        self._end(ended[self.blocked[ended]], Status.AT_LIMIT)
        self._lose(ended[~self.blocked[ended]])
        rows = rows[~over]
        self.here.put(rows, self.base)
        self.goal[rows] = np.minimum(1.0, self.done[rows] + self.part[rows])
        self.fresh[rows], self.short[rows], self.steps[rows], self.merit[rows] = True, 1.0, 0, np.inf

    def _arrive(self, rows: IntArray) -> None:
        """What is at its goal is done, or gets the next."""
        goals, last = self.goals, self.goal[rows] == 1
        scale = np.where(last, 1.0, LOOSE)
        there = np.linalg.norm(self._left(rows, self.errors[rows]), axis=1) <= scale * goals.tolerance
        there &= self.residual[rows] <= scale * goals.residual_tolerance[rows]
        rows = rows[there]
        # past a fold: the sign of det Gamma is that of the start no more
        wrong = self.sign[rows] != self.first_sign[rows]
        folded = rows[wrong & (self.goal[rows] == 1)]
        self.folded[folded] = self.unstable(folded)
        if goals.of_shape is not None and not wrong.all():
            beyond = np.zeros(len(rows), dtype=bool)
            beyond[~wrong] = self.beyond(rows[~wrong])
            self.blocked[rows] = beyond
            wrong |= beyond
        self._shorten(rows[wrong])
        rows = rows[~wrong]
        final = self.goal[rows] == 1
        self._finish(rows[final])
        self._on(rows[~final])

    def _on(self, rows: IntArray) -> None:
        """The next part of the way, from where instances are."""
        self.base.put(rows, self.last)
        self.base_errors[rows] = self.errors[rows]
        self.done[rows] = self.goal[rows]
        self.part[rows] = np.minimum(1.0, 2 * self.part[rows])
        self.goal[rows] = np.minimum(1.0, self.done[rows] + self.part[rows])
        self.steps[rows] = 0

    def _finish(self, rows: IntArray) -> None:
        """Targets are reached; what they leave free may need a few steps more."""
        if self.goals.centre is not None:
            d = self._solved(rows)
            self.settling[rows] += 1
            rows = rows[(np.abs(d).max(axis=1, initial=0.0) <= IN_PLACE) | (self.settling[rows] > PLACES)]
        self._end(rows, Status.REACHED)

    def _solved(self, rows: IntArray) -> FloatArray:
        """(7) The step from ``last``, no longer than ``RADIUS`` and ``BEND``."""
        goals, J = self.goals, self.J[rows]
        p = self.last.p[rows]
        # steps of least size converge as Newton's do, pulled ones by a rate
        pull = 0.0 if goals.centre is None else (goals.centre - p) / goals.unit
        at = p @ goals.limits.matrix.T
        found = step(
            J,
            self._left(rows, self.r[rows]),
            softness=SOFTNESS * np.maximum((J**2).max(axis=(1, 2)), 1e-300),
            pull=pull,
            limits=goals.limits.matrix * goals.unit,
            low=np.minimum(self.low - at, 0.0),
            high=np.maximum(self.high - at, 0.0),
        )
        size = np.abs(found.change).max(axis=1) / RADIUS
        bend = np.abs(self.by[rows] @ found.change[..., None]).max(axis=(1, 2), initial=0.0) / (BEND * self.curvature[rows])
        return np.asarray(found.change * np.minimum(1.0, 1 / np.maximum(np.maximum(size, bend), 1e-300))[:, None])

    def _step(self, rows: IntArray) -> None:
        """Take the next step, or come to rest where there is none."""
        if not len(rows):
            return
        left = self._left(rows, self.r[rows])
        bent = np.abs(self.towards[rows]).max(axis=1, initial=0.0) / self.curvature[rows]
        self.merit[rows] = np.maximum(self.goals.length * np.linalg.norm(left, axis=1), bent)
        first = rows[self.steps[rows] == 0]
        self.first_merit[first] = self.merit[first]
        lost = self.merit[rows] > LOST * self.first_merit[rows]
        self._shorten(rows[lost])
        rows, left, bent = rows[~lost], left[~lost], bent[~lost]
        d = self._solved(rows)
        self.change[rows] = d
        self.steps[rows] += 1
        rest = (np.abs(d).max(axis=1, initial=0.0) <= AT_REST) & (bent <= AT_REST)
        rest &= np.linalg.norm(left + (self.J[rows] @ d[..., None])[..., 0], axis=1) > self.goals.tolerance
        stuck = rest | (self.steps[rows] > MOST_STEPS)
        # what is as near to a place on the way as it comes goes for the target itself, or on if a limit of the shape lies ahead
        short = self.goal[rows] < 1
        ahead = rows[stuck & short & self.blocked[rows]]
        onward = stuck & short & ~self.blocked[rows]
        self.goal[rows[onward]], self.steps[rows[onward]], self.merit[rows[onward]] = 1.0, 0, np.inf
        self.change[rows[onward]] = self._solved(rows[onward])
        ended = rows[stuck & ~short]
        held = self.held(ended).any(axis=1)
        self._lose(ended[~held])
        ended = ended[held]
        beyond = self.beyond(ended)
        self._end(ended[~beyond], Status.AT_LIMIT)
        self.blocked[ended[beyond]] = True
        too_far = self.beyond(ahead)
        self._on(ahead[~too_far])
        back = np.concatenate([ended[beyond], ahead[too_far]])
        rows = rows[self.open[rows]]
        self._go(rows[~np.isin(rows, back)])
        self._shorten(back)

    def _end(self, rows: IntArray, status: Status) -> None:
        self.status[rows], self.open[rows] = status, False

    def _lose(self, rows: IntArray) -> None:
        """Targets that are not reached: past a fold only, of a singular task, or neither."""
        self._end(rows[self.folded[rows]], Status.UNSTABLE)
        rows = rows[~self.folded[rows]]
        values = np.linalg.svd(self.J[rows], compute_uv=False)
        singular = values[:, -1] <= SINGULAR * values[:, 0]
        self._end(rows[singular], Status.SINGULAR_TASK)
        self._end(rows[~singular], Status.UNREACHABLE)

    # ---- what is judged ----

    def held(self, rows: IntArray) -> BoolArray:
        """Which freed inputs stand at a limit, shape (len(rows), k)."""
        limits, unit = self.goals.limits, self.goals.unit
        at, size = self.last.p[rows] @ limits.matrix.T, np.abs(limits.matrix) @ unit
        near = (at - limits.low <= NEAR_LIMIT * size) | (limits.high - at <= NEAR_LIMIT * size)
        return np.asarray((near[:, :, None] & (limits.matrix != 0)).any(axis=1))

    def stability(self, rows: IntArray) -> tuple[NDArray[np.int32], FloatArray]:
        """Values of ``Stability`` of the equilibria at ``last``, and their margins, shapes (len(rows),)."""
        problem = self.task.problem
        part = problem.parts
        self.task.write(self.last.x, self.last.p)
        if part is not None and len(rows) < problem.instance_count:
            problem = part.of(rows)
            modes = modes_of(problem)
            return modes.stability, modes.eigenvalue(0)
        modes = modes_of(problem)
        return modes.stability[rows], modes.eigenvalue(0)[rows]

    def bending(self, rows: IntArray) -> FloatArray:
        """Largest curvature of any rod [1/m], shape (len(rows),)."""
        problem = self.task.problem
        self.task.write(self.last.x, self.last.p)
        if problem.shapes is None:
            return np.zeros(len(rows))
        shapes, _ = problem.shapes.at_nodes(NODES)
        most = [np.nanmax(np.linalg.norm(shape.curvature[rows, :, :2], axis=-1), axis=1) for shape in shapes]
        return np.asarray(np.max(most, axis=0))

    def beyond(self, rows: IntArray) -> BoolArray:
        """Whether the shapes at ``last`` are beyond their limits, shape (len(rows),)."""
        limits = self.goals.of_shape
        result = np.zeros(len(rows), dtype=bool)
        if limits is None or not len(rows):
            return result
        if limits.curvature is not None:
            result |= self.bending(rows) > limits.curvature
        if limits.stability_margin is not None:
            stability, margin = self.stability(rows)
            result |= ~(margin >= limits.stability_margin) & (stability != Stability.UNKNOWN)
        return result

    def unstable(self, rows: IntArray) -> BoolArray:
        """Whether the equilibria at ``last`` are not stable, as far as that can be said, shape (len(rows),)."""
        if not len(rows):
            return np.zeros(0, dtype=bool)
        stability, _ = self.stability(rows)
        return np.asarray(np.isin(stability, (Stability.UNSTABLE, Stability.FOLD)))

    def tried(self, chosen: BoolArray) -> None:
        """Drive the instances chosen from where they begin now, at once or not at all.

        Those that do not get there are as before, or nearer at a limit.
        """
        rows = np.flatnonzero(chosen)
        before = {name: getattr(self, name)[rows].copy() for name in ("errors", "r", "J", "towards", "by", "residual", "status")}
        last = Place(self.last.x[rows].copy(), self.last.p[rows].copy())
        self.drive(chosen, least=0.5)
        self.status[self._not_stable(chosen)] = Status.UNSTABLE
        now, limited = self.status[rows], before["status"] == Status.AT_LIMIT
        nearer = np.linalg.norm(self.errors[rows], axis=1) < np.linalg.norm(before["errors"], axis=1)
        better = (now == Status.REACHED) | ((now == Status.AT_LIMIT) & (nearer | ~limited))
        worse = ~better
        for name, value in before.items():
            getattr(self, name)[rows[worse]] = value[worse]
        self.last.x[rows[worse]], self.last.p[rows[worse]] = last.x[worse], last.p[worse]

    def sought(self, chosen: BoolArray) -> None:
        """Drive the instances chosen, and again with care where what was found is not stable; ``UNSTABLE`` if so again."""
        self.drive(chosen)
        unstable = self._not_stable(chosen)
        if unstable.any():
            self.drive(unstable, CAREFUL)
            self.status[self._not_stable(unstable)] = Status.UNSTABLE
        sound = chosen & (self.first_sign != 0)
        self.origin_errors[sound] = self.first_errors[sound]

    def returned(self) -> None:
        """Put those back to where they began that are not ``REACHED`` and ended farther off than that; statuses stay.

        A result, ``AT_LIMIT``, only where that is stable and within the limits of shapes.
        """
        nearer = np.linalg.norm(self.origin_errors, axis=1) < np.linalg.norm(self.errors, axis=1)
        rows = np.flatnonzero(nearer & (self.status != Status.REACHED))
        if not len(rows):
            return
        ended, errors = self.last.copy(), self.errors.copy()
        self.here.x[rows], self.here.p[rows] = self.origin_unknowns[rows], self.origin[rows]
        settled = self._settled(rows)
        self.last.put(settled, self.here)
        results = settled[self.status[settled] == Status.AT_LIMIT]
        unfit = np.setdiff1d(rows, settled)
        if len(results):
            unfit = np.union1d(unfit, results[self.unstable(results) | self.beyond(results)])
        self.last.put(unfit, ended)
        self.errors[unfit] = errors[unfit]

    def _settled(self, rows: IntArray) -> IntArray:
        """Newton's method on the unknowns alone, from ``here``, whose errors are then known; which of the rows converged."""
        settled = np.zeros(len(self.status), dtype=bool)
        for _ in range(SETTLING):
            open_ = np.zeros(len(self.status), dtype=bool)
            open_[rows] = True
            found = self.task.evaluate(self.here.x, self.here.p, open_)
            self.integrations[rows] += 1
            there = np.abs(found.residual).max(axis=1, initial=0.0) <= self.goals.residual_tolerance[rows]
            self.errors[rows] = self.goals.rows.take(rows).at(found)[0]
            settled[rows[there]] = True
            rows = rows[~there]
            if not len(rows):
                break
            self.here.x[rows] += found.eliminated[0][~there]
        return np.flatnonzero(settled)

    def _not_stable(self, chosen: BoolArray) -> BoolArray:
        result = np.zeros(len(chosen), dtype=bool)
        rows = np.flatnonzero(chosen & np.isin(self.status, (Status.REACHED, Status.AT_LIMIT)))
        result[rows] = self.unstable(rows)
        return result

    def leave(self) -> None:
        """Leave the problem's buffers at ``last``, and what its own test refuses as failed."""
        rows = np.flatnonzero(np.isin(self.status, (Status.REACHED, Status.AT_LIMIT)))
        self.status[rows[self.beyond(rows)]] = Status.OUT_OF_LIMITS  # of another start
        problem, found = self.task.problem, np.isin(self.status, (Status.REACHED, Status.AT_LIMIT))
        differ = (problem.read("unknowns") != self.last.x).any(axis=1) | (self.here.x != self.last.x).any(axis=1)
        stale = found & (differ | (self.here.p != self.last.p).any(axis=1))
        self.here.put(stale, self.last)
        if stale.any():
            self.task.evaluate(self.last.x, self.last.p, stale)
            self.integrations[stale] += 1
        self.task.write(self.last.x, self.last.p)
        if problem.result_test is not None:
            refusals = problem.result_test.refusals(found)
            refused = found & (refusals != Status.NOT_RUN)
            self.status[refused] = refusals[refused]
