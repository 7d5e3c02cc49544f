"""Equilibria from many starts: Newton's method from each, what they reach told apart, and the stable ones of it."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.problem import BoundaryProblem
from multirod.rotations import leading_axis
from multirod.solver import Outcome
from multirod.solvers.continuation.acceptance import signs
from multirod.solvers.continuation.paths import Paths
from multirod.solvers.following.serving.requests import EDGES
from multirod.solvers.newton.iteration import Newton
from multirod.solvers.starting.assembling import GoOn, settle
from multirod.solvers.starting.continua import Curve, beside
from multirod.stability import Stability, StabilityAnalysis
from multirod.status import NOT_RUN, BoolArray, Status, failures
from multirod.validation import FloatArray

MOST_STARTS = 2048  # of one search
TOGETHER = 32  # instances of which all starts of a round are run at once
STARTS_IN_A_ROUND = 128  # starts after which it is asked whether more are needed
STARTS_ON_A_LINE = 32  # the same where the lowest is looked for of what has one unknown
SILENT_ROUNDS = 2  # that have to bring nothing new
# largest distance of two results that are one equilibrium, relative; near a fold Newton's error is the residual's root
SAME_WITHIN = 1e-5
NEVER_SAME_BEYOND = 1e-2  # further apart, relative, two results are never one
RESIDUALS = 4.0  # by how many tolerances the residuals of one equilibrium found twice may differ
WANDERING = 2.0  # times the largest start: an instance beyond goes no further
SETTLED, SETTLED_ROUND = 16, 4  # places at which what comes apart is put together, until a stable equilibrium is found
LAST = 50  # integrations of a place that come after its branch is followed, or tell what it leads to: as many are kept back
ALIKE = 1e-9  # part of their energy, by which that of mirror images may differ
SEEN_AT = 5  # nodes of each rod, at which these are told apart
TELLS = 0.1  # part of how far they are apart, that the tips of these must be to tell
PATIENCE = 25  # integrations from a start: what converges takes 5 to 15


class Catalogue:
    """The equilibria found of one instance.

    The signs of ``det Gamma`` over all equilibria add up to that of the unloaded one (``degree``), whatever the loads: none can
    appear or vanish but in pairs of opposite sign. So a sum that differs says that some are missing; one that agrees does not
    say that none are. Where that is not so, as for closed loops, ``degree`` is None.

    A closed curve of equilibria is taken in once, by the first of them that was found, and counts for 0: a small load that breaks
    its symmetry leaves two of them, of opposite sign.

    Args:
        degree: What the signs add up to.
        tolerance: To which residuals have been made zero [1/m].
        problem: Of this instance alone, on which such curves are looked for; None does not look for any.
    """

    def __init__(self, degree: float | None, tolerance: float = 0.0, problem: BoundaryProblem | None = None) -> None:
        self.degree = degree
        self.tolerance = tolerance
        self.unknowns: list[FloatArray] = []
        self.signs: list[float] = []
        self.curves: dict[int, Curve] = {}  # by the number of the equilibrium that stands for one
        self.unsolved: list[Curve] = []  # of whose equilibria no residual is within the tolerance
        self._problem = problem
        self._gammas: list[FloatArray] = []
        self._before = 0
        self._silent = 0

    @property
    def settled(self) -> bool:
        """Whether whole rounds of starts brought nothing new, and no equilibrium is known to be missing."""
        return self._silent >= SILENT_ROUNDS and self.missing in (None, 0)

    @property
    def missing(self) -> int | None:
        """How many equilibria (8) says are missing at least; None where it says nothing."""
        return None if self.degree is None else int(abs(self.degree - sum(self.signs)))

    def add(self, unknowns: FloatArray, gamma: FloatArray) -> None:
        """Take in an equilibrium unless it is there already."""
        self.add_all(unknowns[None], gamma[None])

    def add_all(self, unknowns: FloatArray, gamma: FloatArray) -> None:
        """The same of several, (k, n), with their ``Gamma``, (k, n, n), one after the other."""
        signs, compared = np.sign(np.linalg.det(gamma)), 0
        left = np.arange(len(unknowns))
        while len(left):
            for other in range(compared, len(self.unknowns)):
                left = left[~self._same(unknowns[left], gamma[left], signs[left], other)]
            compared = len(self.unknowns)
            if len(left):
                first, left = left[0], left[1:]
                if not self._on_a_curve(unknowns[first]):
                    curve = None if self._problem is None else Curve.through(self._problem, unknowns[first], gamma[first])
                    self._take(unknowns[first], gamma[first], float(signs[first]), curve)

    def _same(self, unknowns: FloatArray, gamma: FloatArray, signs: FloatArray, other: int) -> BoolArray:
        """Which of several are one that is there, by its number."""
        apart = unknowns - self.unknowns[other]
        distance, size = np.abs(apart).max(axis=1), np.maximum(1.0, np.abs(unknowns).max(axis=1))
        near = (signs == self.signs[other]) & (distance <= NEVER_SAME_BEYOND * size)
        # of one equilibrium, a residual within the tolerance leaves that much where Gamma is nearly singular
        residual = np.maximum(*(np.abs(matrix @ apart[..., None]).max(axis=(1, 2)) for matrix in (gamma, self._gammas[other])))
        return np.asarray(near & ((distance <= SAME_WITHIN * size) | (residual <= RESIDUALS * self.tolerance)))

    def add_beside(self, unknowns: FloatArray, residual: FloatArray, gamma: FloatArray) -> None:
        """Take in the closed curve of equilibria beside which Newton's method gave up, if there is one."""
        if self._problem is None or self._on_a_curve(unknowns):
            return
        there = beside(self._problem, unknowns, residual, gamma, self.tolerance)
        if there is None or self._on_a_curve(there[0]):
            return
        unknowns, gamma, solved = there
        curve = Curve.through(self._problem, unknowns, gamma)
        if curve is not None and solved:
            self._take(unknowns, gamma, 0.0, curve)
        elif curve is not None:
            self.unsolved.append(curve)

    def _on_a_curve(self, unknowns: FloatArray) -> bool:
        return any(curve.holds(unknowns) for curve in (*self.curves.values(), *self.unsolved))

    def _take(self, unknowns: FloatArray, gamma: FloatArray, sign: float, curve: Curve | None) -> None:
        if curve is not None:
            self.curves[len(self.unknowns)] = curve
        self.unknowns.append(np.array(unknowns))
        self.signs.append(sign if curve is None else 0.0)
        self._gammas.append(np.array(gamma))

    def end_round(self) -> None:
        """Note whether a round of starts brought something new."""
        found = len(self.unknowns)
        self._silent = self._silent + 1 if found == self._before else 0
        self._before = found


def degrees(problem: BoundaryProblem) -> FloatArray:
    """Sign of ``det Gamma`` at the unloaded equilibrium of each instance, 0 where that is not finite, shape (instance_count,)."""
    with problem.everyone(), problem.at_load(0.0):
        _, gamma = problem.evaluate(problem.guess())
    return signs(gamma)


def converge(
    problem: BoundaryProblem, newton: Newton, guesses: FloatArray, chosen: NDArray[np.bool_], limit: FloatArray | float
) -> BoolArray:
    """Newton's method from ``guesses`` (instance_count, n), given up beyond ``limit`` (instance_count, n); who converged."""
    problem.write("unknowns", np.where(chosen[:, None], guesses, problem.read("unknowns")))
    newton.start(chosen)
    with newton.iterating() as iterate:
        for _ in range(PATIENCE):
            if not iterate():
                break
            wandering = np.asarray((np.abs(problem.read("unknowns")) > limit).any(axis=1))
            if wandering.any():
                newton.give_up(wandering)
    return np.asarray(chosen & (newton.outcome().status == Status.CONVERGED))


def limits(starts: FloatArray) -> FloatArray:
    """Where Newton's method is given up, shape (instance_count, n); nowhere where all starts are zero."""
    size = np.abs(starts).max(axis=0)
    largest = size.max(axis=1, keepdims=True)
    return np.where(largest > 0, WANDERING * size + largest, np.inf)


def refuse_unstable(problem: BoundaryProblem, outcome: Outcome, chosen: NDArray[np.bool_]) -> None:
    """Say so where a search for the ``chosen`` that did not begin at a stable equilibrium led to an unstable one."""
    found = chosen & ~failures(outcome.status)
    if problem.stability is None or problem.stability.guess_is_stable or not found.any():
        return
    outcome.status[found & problem.stability.unstable()] = Status.UNSTABLE
    outcome.integrations += found


def lowest_stable(
    problem: BoundaryProblem,
    newton: Newton,
    outcome: Outcome,
    lost: NDArray[np.bool_],
    max_steps: int,
    go_on: GoOn,
    side: int = 1,
) -> None:
    """Put the instances ``lost`` on their stable equilibrium of lowest potential energy, if one is found.

    Their status is then ``LOWEST_ENERGY``; what is unstable, neutral but by symmetry, or cannot be said is never taken. They are
    told apart in double precision, and left so. Newton's method starts from many points; what comes apart is put together at
    several places (``settle``), ``go_on`` leads on from where that ends, and where its loads have no potential, that is done
    without them: then they are raised, in ``max_steps`` at most. Of mirror images it is the one on the positive side, or for a
    ``side`` of -1 the other, by (5) of ``docs/branches.md``.
    """
    stability, parts = problem.stability, problem.parts
    if stability is None or not stability.multistable or parts is None or problem.starts is None or not lost.any():
        return
    raised = lost & ~stability.has_potential if problem.joints is not None else np.zeros_like(lost)
    lost = lost & ~raised
    if raised.any():
        raised &= ~problem.is_loose()  # which rests nowhere without its loads
    ways = partial(_search, go_on=go_on, side=side), partial(_search_unloaded, max_steps=max_steps, go_on=go_on, side=side)
    for chosen, search in zip((lost, raised), ways, strict=True):
        for places in np.split(np.flatnonzero(chosen), range(TOGETHER, int(chosen.sum()), TOGETHER)):
            if not len(places):
                continue
            part = parts.of(places, double=True)
            found = search(part, newton.of(part, places))
            outcome.iterations[places] += found.iterations
            outcome.integrations[places] += found.integrations
            outcome.status[places[found.status == Status.CONVERGED]] = Status.LOWEST_ENERGY
            for said in (Status.INTEGRATION_LIMIT, *EDGES):
                outcome.status[places[found.status == said]] = said
            problem.keep(part, places)


def _stability(problem: BoundaryProblem) -> StabilityAnalysis:
    assert problem.stability is not None  # or nobody asked for what is stable
    return problem.stability


def _search_unloaded(problem: BoundaryProblem, newton: Newton, *, max_steps: int, go_on: GoOn, side: int) -> Outcome:
    """The same as ``_search`` without loads, then where raising them leads, unless that is unstable."""
    assert problem.joints is not None
    after, before = problem.read("inputs"), problem.joints.unloaded_inputs()
    if before is None:
        return Outcome.zeros(problem.instance_count)
    problem.write("inputs", before)
    outcome = _search(problem, newton, go_on=go_on, side=side)
    unknowns, gamma = problem.read("unknowns"), newton.gamma()
    problem.write("inputs", after)
    resting = outcome.status == Status.CONVERGED
    newton.allow(np.maximum(newton.allowed() - outcome.integrations - 2, 0))
    raised = Paths(problem, newton, max_steps).change_inputs(resting, before, unknowns, gamma)
    there = resting & (raised.status == Status.CONVERGED)
    with problem.everyone():
        problem.integrate()
        there &= ~_stability(problem).unstable()
    outcome.iterations += raised.iterations
    outcome.integrations += raised.integrations + 1 + resting
    outcome.status[resting & ~there] = Status.BRANCH_END
    return outcome


def _search(problem: BoundaryProblem, newton: Newton, *, go_on: GoOn, side: int) -> Outcome:
    """Leave every instance on the stable equilibrium of lowest potential energy that is found; where none is, as it was.

    What may not take all integrations of a round ends before it, undecided: fewer starts might miss the lowest.
    """
    outcome = Outcome.zeros(problem.instance_count)
    before = problem.read("unknowns")
    apart = problem.joints is not None
    catalogues = _settled(problem, newton, outcome, go_on) if apart else _converged(problem, newton, outcome)
    # what falls may come to rest where symmetry leaves a mode neutral, which was found to be so
    rests = (Stability.STABLE, Stability.FOLD) if apart else (Stability.STABLE,)
    best, chosen = _lowest(problem, catalogues, before, outcome, side, rests)
    chosen &= outcome.status != Status.INTEGRATION_LIMIT
    problem.write("unknowns", np.where(chosen[:, None], best, before))
    newton.run(chosen)
    last = newton.outcome()
    outcome.status[chosen] = last.status[chosen]
    outcome.integrations += chosen * last.integrations
    with problem.everyone():
        problem.integrate()  # the buffers hold every instance again
    return outcome


def _settled(problem: BoundaryProblem, newton: Newton, outcome: Outcome, go_on: GoOn) -> list[Catalogue]:
    """Stable equilibria that each instance comes to rest at; what is counted is added to ``outcome``, and why there are none,
    where that is known."""
    assert problem.parts is not None
    edges = np.full(problem.instance_count, NOT_RUN)
    catalogues = [Catalogue(None) for _ in range(problem.instance_count)]
    allowed, before = newton.allowed(), outcome.integrations.copy()
    needed = np.zeros_like(before)  # by the first round, as much as is to be left for another like it
    open_ = np.arange(problem.instance_count)
    others = range(SETTLED_ROUND, SETTLED, SETTLED_ROUND)
    # what is soon done at all others first: what is hard at four places has been so at all, or easy at some
    for first, on in ((0, go_on), *((k, None) for k in others), *((k, go_on) for k in others)):
        left = allowed - outcome.integrations
        share = left // SETTLED_ROUND - LAST
        stays = (share > 0) & ((on is None) | (left >= needed))
        outcome.status[open_[~stays[open_]]] = Status.INTEGRATION_LIMIT
        open_ = open_[stays[open_]]
        if not len(open_):
            break
        rows = np.repeat(open_, SETTLED_ROUND)
        trial = problem.parts.of(rows)
        method = newton.of(trial, rows)
        method.allow(share[rows])
        counts = settle(trial, method, np.tile(np.arange(first, first + SETTLED_ROUND), len(open_)), on)
        np.add.at(outcome.iterations, rows, counts.iterations)
        np.add.at(outcome.integrations, rows, counts.integrations)
        if first == 0:
            needed = outcome.integrations - before
        unknowns, gamma = trial.read("unknowns"), trial.read("gamma").reshape(len(rows), problem.unknown_count, -1)
        stability = _stability(trial).modes().stability
        turning = np.isin(np.arange(len(rows)), list(counts.turning)) & (stability == Stability.FOLD)
        stable = ~failures(counts.status) & ((stability == Stability.STABLE) | turning)
        for row in np.flatnonzero(stable):
            catalogues[rows[row]].add(unknowns[row], gamma[row])
        why = trial.reasons(counts.status)
        told = np.isin(why, EDGES)
        edges[rows[told]] = why[told]
        open_ = open_[[not catalogues[i].unknowns for i in open_]]
    outcome.status[:] = np.where([edges[k] and not own.unknowns for k, own in enumerate(catalogues)], edges, outcome.status)
    return catalogues


def _converged(problem: BoundaryProblem, newton: Newton, outcome: Outcome) -> list[Catalogue]:
    """Equilibria of each instance by Newton's method from many starts; what is counted is added to ``outcome``."""
    starts = problem.starts
    assert starts is not None
    assert problem.parts is not None
    tolerance = newton.state.tolerance.numpy()
    catalogues = [Catalogue(degree, float(least)) for degree, least in zip(degrees(problem), tolerance, strict=True)]
    count = min(STARTS_IN_A_ROUND, STARTS_ON_A_LINE**problem.unknown_count)
    limit = limits(starts.guesses(count))
    allowed = newton.allowed()
    open_, tried = np.arange(problem.instance_count), np.zeros(0, dtype=np.intp)
    for first in range(0, MOST_STARTS, count):
        spent = outcome.integrations[open_] + count * PATIENCE > allowed[open_]
        outcome.status[open_[spent]] = Status.INTEGRATION_LIMIT
        open_ = open_[~spent]
        if not len(open_):
            break
        rows = np.repeat(open_, count)
        if not np.array_equal(open_, tried):
            trial, tried = problem.parts.of(rows), open_
            method = newton.of(trial, rows)
        guesses = np.swapaxes(starts.guesses(count, first)[:, open_], 0, 1).reshape(len(rows), -1)
        reached = converge(trial, method, guesses, np.ones(len(rows), dtype=bool), limit[rows])
        counts = method.outcome()
        np.add.at(outcome.iterations, rows, counts.iterations)
        np.add.at(outcome.integrations, rows, counts.integrations)
        unknowns, gamma = trial.read("unknowns"), trial.read("gamma").reshape(len(rows), problem.unknown_count, -1)
        for i in open_.tolist():
            found = reached & (rows == i)
            catalogues[i].add_all(unknowns[found], gamma[found])
            catalogues[i].end_round()
        open_ = open_[[not catalogues[i].settled for i in open_]]
    return catalogues


def _lowest(
    problem: BoundaryProblem,
    catalogues: Sequence[Catalogue],
    unknowns: FloatArray,
    outcome: Outcome,
    side: int,
    rests: Sequence[Stability],
) -> tuple[FloatArray, Any]:
    """The equilibria of lowest potential energy whose stability is one of ``rests`` in place of ``unknowns``, and of which
    instances there is one.

    Below any equilibrium there is a stable one, as energies are bounded. So where one that is not stable, or not known to be, is
    lower than all that are, the lowest was missed, and there is none. Of mirror images it is that to the ``side``. The
    integrations that tell are counted in ``outcome``.
    """
    analysis = _stability(problem)
    best = np.array(unknowns)
    least, bottom = np.full(len(catalogues), np.inf), np.full(len(catalogues), np.inf)  # of what is stable, and of all
    for k in range(max(len(catalogue.unknowns) for catalogue in catalogues)):
        having = np.array([k < len(catalogue.unknowns) for catalogue in catalogues])
        trial = np.array(unknowns)
        for i in np.flatnonzero(having):
            trial[i] = catalogues[int(i)].unknowns[k]
        problem.write("unknowns", trial)
        with problem.everyone():
            stability = analysis.modes().stability
            potential = analysis.potential()
        outcome.integrations += having
        stable, rounding = having & np.isin(stability, rests), ALIKE * np.abs(potential)
        better = stable & (potential < least - rounding)
        alike = stable & ~better & (potential <= least + rounding)  # mirror images
        if alike.any():
            places = _places(problem)
            problem.write("unknowns", best)
            apart = places - _places(problem)
            better[alike] = [goes_to(own, side) for own in apart[alike]]
            outcome.integrations += 2 * alike
        best[better], least[better] = trial[better], np.fmin(least, potential)[better]
        bottom[having] = np.fmin(bottom, potential)[having]
    lowest = np.isfinite(least)
    lowest[lowest] = least[lowest] <= bottom[lowest] + ALIKE * np.abs(bottom[lowest])
    return best, lowest


def _places(problem: BoundaryProblem) -> FloatArray:
    """Of all rods at some nodes, the tip of the first one last, in the world [m], shape (instance_count, node, 3)."""
    assert problem.shapes is not None  # or no energy was told
    with problem.everyone():
        shapes, _ = problem.shapes.at_nodes(SEEN_AT)
    return np.concatenate([shape.position for shape in shapes[::-1]], axis=1)


def goes_to(apart: FloatArray, side: int) -> bool:
    """(5) of ``docs/branches.md``: whether places (node, 3) that are so far ``apart`` from those of a mirror image, the tip last,
    are on the positive side of it, or for a ``side`` of -1 on the negative one."""
    sizes = np.linalg.norm(apart, axis=1)
    way = apart[-1 if sizes[-1] >= TELLS * sizes.max() else int(sizes.argmax())]
    return bool(side * way[int(leading_axis(np.abs(way)))] > 0)
