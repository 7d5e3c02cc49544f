"""The way to a target: unknowns and freed inputs step together, many instances at once. Numbers: ``docs/tasks.md``."""

import numpy as np

from multirod.batch import IntArray
from multirod.stability import Modes, modes_of
from multirod.status import Status
from multirod.tasks.controlling.shape_limits import room
from multirod.tasks.formulation import Task
from multirod.tasks.limits import LimitRows
from multirod.tasks.reaching.drive import DriveArrays
from multirod.tasks.reaching.drive_kernels import (
    ANGLE_WEIGHT,
    LEAST,
    LENGTH,
    PART,
    POSITION_WEIGHT,
    PULLED,
    RADIUS,
    RESUMED,
    ROUGH,
    SHAPED,
    TOLERANCE,
)
from multirod.tasks.reaching.goals import BoolArray, Goals, Place
from multirod.tasks.reaching.search_kernels import BEGINNING, ENDED, MOST_STEPS, NOT_REACHED
from multirod.validation import FloatArray

LEAST_PART = 0.01  # of the way
SINGULAR = 1e-5  # least over largest singular value of J, from which a target that is not reached is called singular
SETTLING = 4  # integrations that an equilibrium that was found by other kernels is brought to its tolerance by
SETTLING_FAR = 12  # the same of where a search ended short of its target
# as NumPy compares an array with them at once, and takes as long as a tenth of an integration with a member of ``Status``
REACHED, AT_LIMIT = int(Status.REACHED), int(Status.AT_LIMIT)
UNREACHED = np.isin(np.arange(max(Status) + 1), [Status.UNREACHABLE, Status.SINGULAR_TASK, Status.UNSTABLE])
CAREFUL = 0.125  # part of the way that is gone at once where all of it ended at an equilibrium that is not stable


def _limiting(limits: LimitRows, unit: FloatArray) -> dict[str, FloatArray]:
    """What kernels are told of limits of the freed inputs."""
    low, high = limits.inset(unit)
    result = {"unit": unit, "limits": limits.matrix, "step_limits": limits.matrix * unit}
    result |= {"low": limits.low, "high": limits.high, "near": limits.nearness(unit)}
    return result | {"inset_low": low, "inset_high": high}


class Search:
    """Drives the instances of one task to their targets, and judges what comes of it.

    Attributes:
        last: Where each instance is.
        status: Values of ``Status``, shape (b,).
        integrations: Of each instance, shape (b,).
        iterations: Steps that were kept, shape (b,).
        errors: Of the target's rows at ``last`` [1/m], shape (b, m).
        past: What is free where the target was met at an equilibrium that is not stable, past a fold, NaN where it was not, shape
            (b, k).
        met: Whether one of these is all that is known of a target: it was found where the robot is not stable, (b,).
    """

    def __init__(self, task: Task, goals: Goals, x: FloatArray, p: FloatArray) -> None:
        self.task, self.goals = task, goals
        rows, limits, problem = goals.rows, goals.limits, task.problem
        kind = rows.kind
        key = ("search", task.free, kind, len(limits.low))
        arrays: DriveArrays = problem.tool(key, lambda: DriveArrays(task, kind, len(limits.low)))
        arrays.clear()
        self._arrays = arrays
        problem.expect_judging()
        self._values = values = self._arrays.values
        self.origin, self.origin_unknowns = p, x
        self.past = np.full(p.shape, np.nan)
        self.met = np.zeros(len(x), dtype=bool)
        self.origin_errors = np.full((len(x), rows.count), np.nan)  # NaN where the start is not known
        if arrays.limits is not limits:
            arrays.limit(limits, _limiting(limits, goals.unit))
        scale = problem.curvature_scale()
        if arrays.scale is not scale:
            arrays.scale = scale
            values["curvature"][:] = scale
        for name in rows.given:
            values[name][:] = getattr(rows, name)
        values["residual_tolerance"][:] = goals.residual_tolerance
        if goals.centre is not None:
            values["centre"][:] = goals.centre
        settings = values["settings"]
        settings[LENGTH], settings[TOLERANCE] = goals.length, goals.tolerance
        settings[POSITION_WEIGHT], settings[ANGLE_WEIGHT] = rows.weight.tolist()
        settings[SHAPED], settings[PULLED] = goals.of_shape is not None, goals.centre is not None
        settings[ROUGH] = problem.coarse is not None
        self.start, self.last, self.here, self._fold = arrays.places
        arrays.all_x[:], arrays.all_p[:] = x, p
        self.status, self.integrations, self.iterations = (values[name] for name in ("status", "integrations", "iterations"))
        self.errors, self.J, self.by = (values[name] for name in ("errors", "J", "by"))  # at ``last``, in units (9)
        self._first_errors, self._first_sign = values["first_errors"], values["first_sign"]

    def begin(self, chosen: IntArray, start: Place) -> None:
        """Let some instances begin elsewhere, rows of ``start`` in their order."""
        self.start.x[chosen], self.start.p[chosen] = start.x, start.p

    def drive(self, chosen: BoolArray, part: float = 1.0, least: float = LEAST_PART) -> None:
        """Bring the instances chosen from ``start`` to their targets: all the way at once, or by parts of it.

        Parts that fail are shortened, to no less than ``least``, others lengthened. ``status`` is then ``REACHED``, ``AT_LIMIT``,
        ``UNREACHABLE``, ``SINGULAR_TASK`` or ``INTEGRATION_LIMIT``, or ``UNSTABLE`` if the only equilibrium found is past a fold.
        """
        many = int(np.count_nonzero(chosen))
        if not many:
            return
        values, arrays = self._values, self._arrays
        values["phase"][:] = BEGINNING if many == len(chosen) else np.where(chosen, BEGINNING, ENDED)
        settings = values["settings"]
        settings[LEAST], settings[PART], settings[RESUMED] = least, part, 0.0
        np.add(self.integrations, self.goals.max_integrations, out=values["allowed"])
        arrays.send()
        with self.task.problem.alone:
            # a launch that repeats integrations begins too
            under_way = many if many == len(chosen) and arrays.begins else arrays.launch()[0]
            while under_way:
                under_way = self._pass(under_way)
        arrays.fetch()
        if self.all_reached:
            return
        self._begin_exactly(np.flatnonzero(chosen & (self.status != REACHED) & (self._values["roughly"] != 0)))
        self._settle(np.flatnonzero(chosen & (self.status == AT_LIMIT)))
        self._say_why(np.flatnonzero(self.status == NOT_REACHED))

    def _begin_exactly(self, rows: IntArray) -> None:
        """How far off those were where they began, of which a coarse integration told, and which is told of again."""
        if not len(rows):
            return
        chosen = np.zeros(len(self.status), dtype=bool)
        chosen[rows] = True
        self.here.x[rows], self.here.p[rows] = self.start.x[rows], self.start.p[rows]
        found = self.task.evaluate(self.here.x, self.here.p, chosen)
        self.integrations[rows] += 1
        self._first_errors[rows] = self.goals.rows.take(rows).at(found)[0]

    def _settle(self, rows: IntArray) -> IntArray:
        """Bring those that limits hold to their equilibria: steps along limits may end before the rest of the robot is at rest.
        Which of the rows could not be brought there."""
        if not len(rows):
            return rows
        self.here.x[rows], self.here.p[rows] = self.last.x[rows], self.last.p[rows]
        settled = self.settled(rows)
        self.last.put(settled, self.here)
        return np.setdiff1d(rows, settled)

    def _pass(self, under_way: int) -> int:
        """Integrations of those under way until one of them ends or asks, which then is answered; how many are under way then."""
        arrays = self._arrays
        if under_way == len(self.status):
            left, asked = arrays.go_on(under_way)
        else:
            arrays.fetch()
            with self.task.problem.only(self._values["phase"] != ENDED):
                left, asked = arrays.go_on(under_way)
        while asked:
            arrays.fetch()
            self._answer()
            self._values["settings"][RESUMED] = 1.0
            arrays.send()
            self.task.write(self.here.x, self.here.p)
            left, asked = arrays.launch()
            self._values["settings"][RESUMED] = 0.0
            arrays.send()
        return left

    def _answer(self) -> None:
        """Look at the shapes of those that asked."""
        rows = np.flatnonzero(self._values["asked"])
        self._values["verdict"][rows] = self.beyond(rows)

    def _say_why(self, rows: IntArray) -> None:
        """Targets that are not reached: of an unstable equilibrium past a fold, of a singular task, or neither."""
        if not len(rows):
            return
        folded = rows[self._values["folded"][rows] != 0]
        last = Place(self.last.x[folded], self.last.p[folded])
        self.last.put(folded, self._fold)
        unstable = folded[self.unstable(folded)]
        self.last.x[folded], self.last.p[folded] = last.x, last.p
        values = np.linalg.svd(self.J[rows], compute_uv=False)
        left = np.minimum(np.linalg.norm(self._values["r"][rows], axis=1), 1 / self.goals.length)  # a length, a radian at most
        singular = (values[:, -1] <= SINGULAR * values[:, 0]) | (left > MOST_STEPS * RADIUS * values[:, 0])
        self.status[rows] = np.where(singular, Status.SINGULAR_TASK, Status.UNREACHABLE)
        self.status[unstable] = Status.UNSTABLE
        self.met[unstable] = True

    # ---- what is judged ----

    def modes(self, rows: IntArray) -> Modes:
        """Of the equilibria at ``last``."""
        self.task.write(self.last.x, self.last.p)
        return modes_of(self.task.problem, rows)

    def margin(self, rows: IntArray) -> FloatArray:
        """Stability margins of the equilibria at ``last``, NaN where not known, shape (len(rows),)."""
        return self.modes(rows).eigenvalue(0)

    def room(self, rows: IntArray) -> FloatArray:
        """What limits of the shape leave at ``last``, as ``shape_limits.room`` has it, shape (len(rows), 1 or 2)."""
        assert self.goals.of_shape is not None
        self.task.write(self.last.x, self.last.p)
        return room(self.task.problem, self.goals.of_shape, rows)

    def beyond(self, rows: IntArray) -> BoolArray:
        """Whether the shapes at ``last`` are beyond their limits, or not known to be within, shape (len(rows),)."""
        if self.goals.of_shape is None or not len(rows):
            return np.zeros(len(rows), dtype=bool)
        return np.asarray(~(self.room(rows) >= 0).all(axis=1))  # NaN is not within either

    def unstable(self, rows: IntArray, *, asked: bool = False) -> BoolArray:
        """Whether the equilibria at ``last`` are not stable, as far as that can be said, shape (len(rows),); ``asked`` whether
        ``_surely_stable`` was, and did not say so."""
        if not len(rows):
            return np.zeros(0, dtype=bool)
        if not asked and len(rows) == len(self.status) and self._surely_stable():
            return np.zeros(len(rows), dtype=bool)
        return self.modes(rows).left

    def _surely_stable(self) -> bool:
        """Whether the equilibria at ``last`` are all stable, and that is told at once."""
        stability = self.task.problem.stability
        if stability is None:
            return False
        self.task.write(self.last.x, self.last.p)
        return stability.surely_stable()

    @property
    def all_reached(self) -> bool:
        """Whether all instances are at their targets."""
        return bool(self.status.tobytes() == self._arrays.all_reached)  # bytes are compared at once

    def tried(self, chosen: BoolArray) -> None:
        """Drive the instances chosen from where they begin now, at once or not at all.

        Those that do not get there are as before, or nearer at a limit.
        """
        rows = np.flatnonzero(chosen)
        names = ("errors", "r", "J", "towards", "by", "residual", "status")
        before = {name: self._values[name][rows] for name in names}
        last = Place(self.last.x[rows].copy(), self.last.p[rows].copy())
        self.drive(chosen, least=0.5)
        self.status[self._not_stable(chosen)] = Status.UNSTABLE
        missed = chosen & (self.status != REACHED)
        if self._values["settings"][PULLED] and missed.any():  # the target comes before the middle
            self._values["settings"][PULLED] = 0.0
            self.drive(missed, least=0.5)
            self.status[self._not_stable(missed)] = Status.UNSTABLE
            self._values["settings"][PULLED] = 1.0
        now, limited = self.status[rows], before["status"] == AT_LIMIT
        nearer = np.linalg.norm(self.errors[rows], axis=1) < np.linalg.norm(before["errors"], axis=1)
        better = (now == REACHED) | ((now == AT_LIMIT) & (nearer | ~limited))
        worse = ~better
        for name, value in before.items():
            self._values[name][rows[worse]] = value[worse]
        self.last.x[rows[worse]], self.last.p[rows[worse]] = last.x[worse], last.p[worse]

    def sought(self, chosen: BoolArray) -> None:
        """Drive the instances chosen, and again with care where what was found is not stable; ``UNSTABLE`` if so again."""
        self.drive(chosen)
        reached = self.all_reached
        if reached and self._surely_stable():
            self.origin_errors[:] = self._first_errors
            return
        unstable, folded = self._not_stable(chosen, asked=reached), chosen & (self._values["folded"] != 0)
        self.past[folded], self.past[unstable] = self._fold.p[folded], self.last.p[unstable]
        if unstable.any():
            self.drive(unstable, CAREFUL)
            unstable = self._not_stable(unstable)
            self.met |= unstable & (self.status == REACHED)
            self.status[unstable] = Status.UNSTABLE
        sound = chosen & (self._first_sign != 0)
        self.origin_errors[sound] = self._first_errors[sound]
        missed = chosen & (self.status != REACHED)
        if self._values["settings"][PULLED] and missed.any():  # the target comes before the middle
            self._values["settings"][PULLED] = 0.0
            self.sought(missed)
            self._values["settings"][PULLED] = 1.0

    def rest_at_limit(self, rows: IntArray, place: Place) -> None:
        """Put some instances to places, in their order, that a limit of the shape holds: those that are nearer so, stable and
        within their limits are ``AT_LIMIT`` there."""
        if not len(rows):
            return
        before, errors = self.last.copy(), self.errors.copy()
        self.here.x[rows], self.here.p[rows] = place.x, place.p
        settled = self.settled(rows)
        self.last.put(settled, self.here)
        fit = settled[np.linalg.norm(self.errors[settled], axis=1) < np.linalg.norm(errors[settled], axis=1)]
        fit = fit[~(self.unstable(fit) | self.beyond(fit))]
        others = np.setdiff1d(rows, fit)
        self.last.put(others, before)
        self.errors[others] = errors[others]
        self.status[fit] = Status.AT_LIMIT

    def returned(self) -> None:
        """Put those back to where they began that are not ``REACHED`` and ended farther off than that; statuses stay.

        A result, ``AT_LIMIT``, only where that is stable and within the limits of shapes.
        """
        nearer = np.linalg.norm(self.origin_errors, axis=1) < np.linalg.norm(self.errors, axis=1)
        rows = np.flatnonzero(nearer & (self.status != REACHED))
        if not len(rows):
            return
        ended, errors = self.last.copy(), self.errors.copy()
        self.here.x[rows], self.here.p[rows] = self.origin_unknowns[rows], self.origin[rows]
        settled = self.settled(rows)
        self.last.put(settled, self.here)
        results = settled[self.status[settled] == AT_LIMIT]
        unfit = np.setdiff1d(rows, settled)
        if len(results):
            unfit = np.union1d(unfit, results[self.unstable(results) | self.beyond(results)])
        self.last.put(unfit, ended)
        self.errors[unfit] = errors[unfit]

    def settled(self, rows: IntArray, most: int = SETTLING) -> IntArray:
        """Newton's method on the unknowns alone, from ``here``, whose errors are then known; which of the rows converged."""
        settled = np.zeros(len(self.status), dtype=bool)
        for _ in range(most):
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

    def tell_errors(self, rows: IntArray) -> None:
        """Errors of what did not get there, at an equilibrium: near where the search ended, or, without one within the limits of
        the shape, where it began."""
        if not len(rows):
            return
        self.here.x[rows], self.here.p[rows] = self.last.x[rows], self.last.p[rows]
        settled = self.settled(rows, SETTLING_FAR)
        self.last.put(settled, self.here)
        farther = np.linalg.norm(self.errors[rows], axis=1) > np.linalg.norm(self.origin_errors[rows], axis=1)
        back = np.union1d(np.setdiff1d(rows, settled), rows[farther | self.beyond(rows)])
        self.last.x[back], self.last.p[back] = self.origin_unknowns[back], self.origin[back]
        self.errors[back] = self.origin_errors[back]

    def _found(self) -> BoolArray:
        """Which are results."""
        return np.asarray((self.status == REACHED) | (self.status == AT_LIMIT))

    def _not_stable(self, chosen: BoolArray, *, asked: bool = False) -> BoolArray:
        result = np.zeros(len(chosen), dtype=bool)
        rows = np.flatnonzero(chosen & self._found())
        if len(rows):
            result[rows] = self.unstable(rows, asked=asked)
        return result

    def leave(self) -> None:
        """Leave the problem's buffers at ``last``, and what its own test refuses as failed."""
        problem, done = self.task.problem, self.all_reached
        if not done:
            self.status[self._settle(np.flatnonzero(self.status == AT_LIMIT))] = Status.UNREACHABLE
        if self.goals.of_shape is not None:
            rows = np.flatnonzero(self._found())
            self.status[rows[self.beyond(rows)]] = Status.OUT_OF_LIMITS  # of another start
        if not done:
            self.tell_errors(np.flatnonzero(UNREACHED[self.status]))
        last, here, x = self.last, self.here, problem.read("unknowns")
        at, there = last.x.tobytes(), last.p.tobytes()  # bytes that are the same are compared at once
        if not (x.tobytes() == at == here.x.tobytes() and here.p.tobytes() == there):
            found = self._found()
            stale = found & ((x != last.x) | (here.x != last.x)).any(axis=1) | (found & (here.p != last.p).any(axis=1))
            if stale.any():
                self.here.put(stale, self.last)
                self.task.evaluate(self.last.x, self.last.p, stale)
                self.integrations[stale] += 1
        self.task.write(self.last.x, self.last.p)
        if problem.result_test is not None:
            found = self._found()
            refusals = problem.result_test.refusals(found)
            refused = found & (refusals != Status.NOT_RUN)
            self.status[refused] = refusals[refused]
