"""Down in energy, of many at once: by the turns of tips, or by damped dynamics.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from multirod.batch import IntArray
from multirod.integrators import RK45
from multirod.problem import BoundaryProblem
from multirod.solvers.energy_descent import EnergyDescent, EnergyDescentTrack
from multirod.solvers.following.descent import RADIUS, SOFT, Point
from multirod.solvers.following.serving.many import Server
from multirod.solvers.following.serving.requests import EDGES, Answer, Descend, Settle
from multirod.solvers.following.serving.rounds import AROUND, DESCENT_STEPS, Rounds
from multirod.status import NOT_RUN, Status
from multirod.validation import FloatArray

SHORTEST = 1e-3  # turn of the tip by a step, that is not halved again [rad]
TOO_LONG = (Status.NONFINITE, Status.STEP_LIMIT, Status.LINE_LIMIT)  # as which steps of damped dynamics end that may have been so
FINER = (0.05,)  # radii of the shorter ones that are tried then [rad]


def descend(server: Server, asked: dict[int, Descend]) -> dict[int, Answer]:
    """(4) Where going down in energy leads from each point, after turning the tip by ``first``; None where it leads nowhere."""
    places, all_ = np.array(list(asked)), list(asked.values())
    count = len(places)
    level, tolerance = np.array([one.point.level for one in all_]), np.array([one.tolerance for one in all_])
    left = np.array([one.left for one in all_])
    unknowns, facing = np.array([one.point.unknowns for one in all_]), np.array([one.slope.facing for one in all_])
    step = np.array([one.slope.change(one.first) if one.first.any() else one.slope.step(RADIUS) for one in all_])
    slopes = [one.slope for one in all_]
    radius, on = np.full(count, RADIUS), np.ones(count, dtype=bool)
    integrations, spent = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)
    there: list[Point | None] = [None] * count
    edge, rounds = np.full(count, NOT_RUN), Rounds(np.array([one.point.periods for one in all_]), unknowns)
    for k in range(DESCENT_STEPS * rounds.times):
        if k == DESCENT_STEPS:
            on &= rounds.turning(unknowns)
        if k in (AROUND, DESCENT_STEPS):
            rounds.since(unknowns)
        spent |= on & (integrations >= left)
        on &= ~spent
        now = np.flatnonzero(on)
        if not len(now):
            break
        _, _, over = server.evaluate(places[now], unknowns[now] + step[now], level[now])
        integrations[now] += 1
        spent[now] = over
        on[now[over]] = False
        points = server.points(places[now])
        found = points.slopes
        # beyond, the rod would snap though its tip were held: not in one long step
        good = found.fit & (found.facing == facing[now])
        shorter = now[~good & ~over]
        radius[shorter] *= 0.5
        ended = shorter[radius[shorter] < SHORTEST]
        on[ended] = False
        nowhere = ended[~np.isfinite(points.size[np.searchsorted(now, ended)])]
        why = server.reasons(places[nowhere])
        edge[nowhere] = np.where(np.isin(why, EDGES), why, NOT_RUN)
        for i in shorter[on[shorter]].tolist():
            step[i] = slopes[i].step(float(radius[i]))
        with np.errstate(invalid="ignore"):
            rests = good & ~over & (points.size <= tolerance[now]) & (found.values[:, 0] >= -SOFT)
        for i in np.flatnonzero(rests).tolist():
            there[now[i]] = points[i]
        on[now[rests]] = False
        rows = np.flatnonzero(good & ~over & ~rests)
        some = now[rows]
        around = rounds.passes(some, unknowns[some], points.unknowns[rows])
        edge[some[around]], on[some[around]] = Status.LOOSE, False
        unknowns[some] = points.unknowns[rows]
        radius[some] = np.minimum(RADIUS, 1.5 * radius[some])
        step[some] = found.steps(rows, radius[some])
        for i, row in zip(some.tolist(), rows.tolist(), strict=True):
            slopes[i] = found[row]
    return {
        place: Answer(there[i], int(integrations[i]), int(integrations[i]), bool(spent[i]), edge=Status(int(edge[i])))
        for i, place in enumerate(places.tolist())
    }


def settle(
    part: BoundaryProblem, asked: dict[int, Settle], periods: FloatArray, taken: IntArray, steps: IntArray, *, raised: bool
) -> dict[int, tuple[FloatArray | None, int, Status]]:
    """(11) Where damped dynamics rest, or None, how many integrations that took, and why there is nothing, as ``Answer.edge``.

    Where a long step leads to no state, they go on in shorter ones from where they began.

    Args:
        part: The problem; its instances are where they are asked of.
        asked: By instance.
        periods: As of ``BoundaryProblem``, shape (instance_count, m).
        taken: Steps along all rods of each, (instance_count,): added to.
        steps: That each may take, (instance_count,).
        raised: Whether loads are raised on the way, not inputs.
    """
    method, count = EnergyDescent(integrator=RK45(), feed_forward=False), part.instance_count
    if method.unsupported(part):
        return {k: (None, 0, Status.NOT_RUN) for k in asked}
    guess, level, on, left = part.read("unknowns"), np.ones(count), np.zeros(count, dtype=bool), 0
    for k, request in asked.items():
        guess[k], level[k], on[k], left = request.unknowns, request.level, True, request.most
    result: dict[int, tuple[FloatArray | None, int, Status]] = {k: (None, 0, Status.NOT_RUN) for k in asked}
    for radius in (method.radius, *FINER):
        if not on.any() or left <= 0:
            break
        part.reasons(np.zeros(count, dtype=np.int32))  # what was so before is not why
        track, rounds = EnergyDescentTrack(replace(method, radius=radius), part, corrected=False), Rounds(periods, guess)
        outcome = track.settle(
            tolerance=None,
            max_iterations=left,
            ramp=1,
            guess=guess,
            level=level if raised else 1.0,
            chosen=on,
            most_steps=steps,
            ends=partial(rounds.ends, part),
        )
        taken += track.integrator_steps
        steps = steps - track.integrator_steps
        found, why = part.read("unknowns"), part.reasons(outcome.status)
        for k in np.flatnonzero(on).tolist():
            edge = Status(int(why[k])) if why[k] in (*EDGES, Status.LINE_LIMIT) else Status.NOT_RUN
            rests = not Status(int(outcome.status[k])).failed
            result[k] = found[k] if rests else None, result[k][1] + int(outcome.integrations[k]), edge
        left -= int(outcome.integrations[on].max())
        on &= np.isin(outcome.status, TOO_LONG)
    return result
