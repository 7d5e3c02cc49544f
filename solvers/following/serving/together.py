"""Serves the requests of many journeys, a launch at a time for all that ask for the same."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.budget import Spent
from multirod.problem import BoundaryProblem
from multirod.solvers.continuation.pace import MOST_STEPS
from multirod.solvers.following.descent import Point, Points
from multirod.solvers.following.serving.downhill import descend, settle
from multirod.solvers.following.serving.many import correct, trace
from multirod.solvers.following.serving.requests import (
    At,
    Clamp,
    Correct,
    Descend,
    Judge,
    Judgement,
    Request,
    Run,
    Settle,
    Trace,
    Weigh,
)
from multirod.solvers.following.serving.turns import ClampedTurns, Turns
from multirod.stability import StabilityAnalysis
from multirod.status import Status
from multirod.validation import FloatArray

SETTLING_STEPS = MOST_STEPS // 4  # of the integrator for each rod, in which damped dynamics are to rest: they take half of it
AT_ONCE = 32  # points with clamps whose numbers are kept as long as one of them is


def split(places: IntArray, most: int) -> list[IntArray]:
    """Instances in so many parts that none has more than so many."""
    return [some for some in np.split(places, range(most, len(places), most)) if len(some)]


class Together:
    """Serves the requests of all journeys, a launch at a time.

    Args:
        part: Their problem.
        before: Inputs where their ways begin; None where loads are raised.
        clamped: Make the same problem of some instances with clamps, by each way that there is.
        starts: Unknowns and levels where those wait that do not ask what stands, shapes (instance_count, n) and
            (instance_count,); None where they stay.
        judged: Whether more than residuals is asked for.

    Attributes:
        most_steps: Of the integrator, in all integrations of an instance.
        settling_steps: Of these, in which damped dynamics are to rest, all of them together.
    """

    def __init__(
        self,
        part: BoundaryProblem,
        before: FloatArray | None = None,
        clamped: Sequence[Callable[[IntArray], BoundaryProblem]] = (),
        starts: tuple[FloatArray, FloatArray] | None = None,
        judged: bool = True,
    ) -> None:
        self.part, self.before, self.after = part, before, part.read("inputs")
        self.levels = np.ones(part.instance_count)
        self.most_steps = MOST_STEPS * len(part.blocks)
        self._calm = starts
        self.settling_steps = self.most_steps
        self._steps, self._settled = np.zeros((2, part.instance_count), dtype=np.int64)  # of all integrations, of damped dynamics
        self._each = np.full(part.instance_count, 2**31)  # of the shortest, as which those go that are not counted
        self.tip = None if not judged or part.conjugates is None else Turns(part.conjugates)
        self._clamped = clamped
        self._periods = np.zeros((part.instance_count, 0)) if part.periods is None else part.periods
        self._pieces: dict[int, tuple[IntArray, ClampedTurns]] = {}  # the last that integrated, by its way
        self._whole: dict[int, ClampedTurns] = {}
        self._clamping: dict[int, int] = {}  # by how many unknowns there are with clamps

    def run(self, all_: Iterable[Run]) -> None:
        """Take all to their ends."""
        runs = dict(enumerate(all_))
        asked: dict[int, Request] = {}
        for k in list(runs):
            self._next(runs, asked, k, None)
        while asked:
            for k, answer in self._serve(asked).items():
                self._next(runs, asked, k, answer)

    def _serve(self, asked: dict[int, Request]) -> Mapping[int, Any]:
        """What those that ask for the same get, the others come next: what is soon done first, so that many ask together."""
        n = self.part.unknown_count
        plain = {k: at for k, at in asked.items() if isinstance(at, At) and len(at.unknowns) == n}
        if plain:
            return self._integrate(plain)
        if some := {k: own for k, own in asked.items() if isinstance(own, Correct)}:
            return correct(self, some)
        if falling := {k: own for k, own in asked.items() if isinstance(own, Descend)}:
            return descend(self, falling)
        if going := {k: own for k, own in asked.items() if isinstance(own, Trace)}:
            return trace(self, going)
        if clamped := {k: own for k, own in asked.items() if isinstance(own, At | Clamp)}:
            return self._integrate_clamped(clamped)
        if damped := {k: own for k, own in asked.items() if isinstance(own, Settle)}:
            return self._settle(damped)
        if judged := {k: own for k, own in asked.items() if isinstance(own, Judge)}:
            return self._judge(judged)
        return self._weigh({k: own for k, own in asked.items() if isinstance(own, Weigh)})

    def _next(self, runs: dict[int, Run], asked: dict[int, Request], k: int, answer: object) -> None:
        asked.pop(k, None)
        try:
            asked[k] = runs[k].send(answer) if self._steps[k] <= self.most_steps else runs[k].throw(Spent())
        except StopIteration:
            del runs[k]

    @contextmanager
    def _placed(self, part: BoundaryProblem, places: IntArray | None = None) -> Iterator[None]:
        """Within it, all instances are at ``levels``, or those that it has, (k,)."""
        some = slice(None) if places is None else places
        if self.before is None:
            with part.at_load(self.levels[some]):
                yield
        else:
            part.write("inputs", self.before[some] + self.levels[some, None] * (self.after[some] - self.before[some]))
            yield

    # ---- integrations ----

    def evaluate(
        self, places: IntArray, unknowns: FloatArray, level: FloatArray
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """As ``many.Server`` says."""
        part, n = self.part, self.part.unknown_count
        values, on = part.read("unknowns"), np.zeros(part.instance_count, dtype=bool)
        values[places], on[places] = unknowns, True
        part.write("unknowns", values)
        self.levels[places] = level
        with self._placed(part), part.only(on):
            part.integrate()
        taken = part.buffer("step_count")[places]
        self._each[places] = np.minimum(self._each[places], taken)
        self._steps[places] += taken
        residual, gamma = part.read("residual")[places], part.read("gamma").reshape(-1, n, n)[places]
        residual[part.buffer("fault")[places] != 0] = np.nan
        return residual, gamma, self._steps[places] > self.most_steps

    def points(self, places: IntArray) -> Points:
        """As ``many.Server`` says."""
        part, n = self.part, self.part.unknown_count
        residual, gamma = part.read("residual")[places], part.read("gamma").reshape(-1, n, n)
        residual[part.buffer("fault")[places] != 0] = np.nan
        forces, stiffness = np.arange(n), np.full(len(places), np.nan)
        unit, turned = np.full((len(places), n), np.nan), np.full((len(places), n, n), np.nan)
        if self.tip is not None:
            forces, stiffness = self.tip.forces, self.tip.stiffness[places]
            unit, turned = (values[places] for values in self.tip.after(gamma))
        first = part.read("unknowns")[places], self.levels[places], residual, gamma[places]
        seen = part.buffer("pose_columns")[places, None, :3, :n], part.read("position")[places]
        frames = part.read("rotation").reshape(-1, 1, 3, 3)[places]
        return Points(*first, forces, unit, turned, *seen, frames, stiffness, periods=self._periods[places])

    def reasons(self, places: IntArray) -> IntArray:
        """As ``many.Server`` says."""
        failed = np.full(self.part.instance_count, Status.NONFINITE, dtype=np.int32)
        return self.part.reasons(failed)[places].astype(np.intp)

    def _integrate(self, asked: Mapping[int, At]) -> dict[int, Point]:
        places = np.array(list(asked))
        self.evaluate(places, np.array([at.unknowns for at in asked.values()]), np.array([at.level for at in asked.values()]))
        points = self.points(places)
        return {k: points[row] for row, k in enumerate(asked)}

    def _integrate_clamped(self, asked: Mapping[int, At | Clamp]) -> dict[int, Point | None]:
        if not self._clamped:
            return dict.fromkeys(asked)
        ways = {k: at.clamping if isinstance(at, Clamp) else self._clamping[len(at.unknowns)] for k, at in asked.items()}
        clamping = min(ways.values())
        asked = {k: at for k, at in asked.items() if ways[k] == clamping}  # the others come next
        places, turns = self._in_pieces(clamping, list(asked))
        part, size, rows = turns.problem, turns.size, np.searchsorted(places, list(asked))
        self._clamping[size] = clamping
        unknowns = np.zeros((len(places), size))
        for row, (k, at) in zip(rows.tolist(), asked.items(), strict=True):
            unknowns[row, : len(at.unknowns)] = at.unknowns
            self.levels[k] = at.level
        turns.put(unknowns)
        # of points that are not fit, which their residual tells
        with self._placed(part, places), np.errstate(invalid="ignore", over="ignore"):
            part.integrate()
            residual, gamma, unit, turned = turns.after(unknowns)
            moved = np.concatenate([turns.clamps.moved(), part.buffer("pose_columns")[:, None, :3, :size]], axis=1)
            frames = np.concatenate([turns.clamps.frames(), part.read("rotation").reshape(-1, 1, 3, 3)], axis=1)
            costless = turns.clamps.costless() or ()
        residual[part.buffer("fault") != 0] = np.nan
        self._steps[places[rows]] += np.maximum(self._each[places[rows]], part.buffer("step_count")[rows])
        arrays = unit, turned, moved, part.read("position"), frames, turns.stiffness, *costless
        found: dict[int, Point | None] = {}
        for some in split(rows, AT_ONCE):
            first = unknowns[some], self.levels[places[some]], residual[some], gamma[some]
            known: dict[str, Any] = {"clamps": turns.held, "arrow": turns.arrow, "periods": self._periods[places[some]]}
            points = replace(Points(*first, turns.forces, *(own[some] for own in arrays)), **known)
            found |= {k: points[i] for i, k in enumerate(places[some].tolist())}
        return found

    def _in_pieces(self, clamping: int, asked: list[int]) -> tuple[IntArray, ClampedTurns]:
        """A problem with clamps of the instances that ask, and no more than as many others; which it has, ascending."""
        count = self.part.instance_count
        places, turns = self._pieces.get(clamping, (np.zeros(0, dtype=np.intp), None))
        if turns is None or not set(asked) <= set(places.tolist()) or 2 * len(asked) <= len(places):
            places = np.arange(count) if 2 * len(asked) > count else np.array(sorted(asked))
            turns = self._whole.get(clamping) if len(places) == count else None
            turns = ClampedTurns(self._clamped[clamping](places)) if turns is None else turns
            if len(places) == count:
                self._whole[clamping] = turns
            self._pieces[clamping] = places, turns
        return places, turns

    def _settle(self, asked: dict[int, Settle]) -> dict[int, tuple[FloatArray | None, int, Status]]:
        """Where damped dynamics rest."""
        most = max(request.most for request in asked.values())
        asked = {k: request for k, request in asked.items() if request.most == most}  # the others come next
        for k, request in asked.items():
            self.levels[k] = request.level
        steps = np.minimum(SETTLING_STEPS * len(self.part.blocks), self.most_steps - self._steps)
        steps, before = np.minimum(steps, self.settling_steps - self._settled), self._steps.copy()
        with self._placed(self.part):
            found = settle(self.part, asked, self._periods, self._steps, steps, raised=self.before is None)
        self._settled += self._steps - before
        return found

    def _judge(self, asked: dict[int, Judge]) -> dict[int, Judgement]:
        with self._standing(asked) as stability:
            modes = stability.modes()
        index, soft = modes.index, modes.soft
        falls, stands = (index > 0) | modes.diverging, (index == 0) & ~modes.diverging
        return {k: Judgement(bool(falls[k]), bool(stands[k]), int(soft[k])) for k in asked}

    def _weigh(self, asked: dict[int, Weigh]) -> dict[int, float]:
        with self._standing(asked) as stability:
            potential = stability.potential()
        return {k: float(potential[k]) for k in asked}

    @contextmanager
    def _standing(self, asked: Mapping[int, Judge | Weigh]) -> Iterator[StabilityAnalysis]:
        """Within it, instances are where they ask of."""
        stability = self.part.stability
        assert stability is not None  # or there was nothing to follow
        self._steps[list(asked)] += self._each[list(asked)]
        before = self.part.read("unknowns"), self.levels.copy()
        # all are looked at: of what a step led to far from any equilibrium, that may take a hundred times as long
        values, levels = before if self._calm is None else self._calm
        for own, own_levels in ((values, levels), before):
            for k, request in asked.items():
                own[k], own_levels[k] = request.unknowns, request.level
        self.levels[:] = levels
        self.part.write("unknowns", values)
        with self._placed(self.part), self.part.everyone():
            yield stability
        self.levels[:] = before[1]
        self.part.write("unknowns", before[0])  # of those that have come to an end, what is kept
