"""Whether a solve of concentric tubes ends on their natural branch: random scenes against small steps.

python tests/benchmarks/natural_branch.py [--scenes N] [--seed N] [--piece N] [--most ROOT]

The reference follows the same homotopy in steps of 1/80 and less, extrapolated from the last three equilibria, each corrected by
Newton's method in NumPy and kept only where the correction is a small part of the step and contracts by 50; a step that fails is
halved, to 1e-9. Where twice as many steps lead elsewhere, four times as many are taken, and so on.
"""

import argparse
from collections import Counter
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np

import multirod as mr
from multirod.problem import BoundaryProblem
from multirod.solvers.continuation.natural import natural_branch
from multirod.stability import Stability
from multirod.status import Status

INTEGRATOR = mr.RK4(40)  # of solve and reference alike: they are to differ in the path alone
KINDS = {
    "two tubes": (2, False, False, 0.2),
    "two tubes, tip force": (2, True, False, 0.2),
    "two tubes, weight": (2, False, True, 0.1),
    "three tubes": (3, False, False, 0.2),
    "three tubes, tip force": (3, True, False, 0.15),
    "three tubes, weight": (3, False, True, 0.1),
    "four tubes": (4, False, False, 0.05),
}
TURNS = np.pi * np.array([-2.0, -1.5, -1.0, -0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0])
MOST = 12.0  # L sqrt(c); of scenes whose whole load is often gone at once, 3
SAME = 1e-5  # of the unknowns, relative: near a fold Newton's error is the root of the tolerance
COARSEST = 80  # steps of the reference
FINEST = 6400
SHORTEST = 1e-9  # step of the reference, of the whole path
SLOWEST = 0.02  # contraction of the reference's Newton steps
TURNING = 6  # halvings of a step, after which it is no longer extrapolated
FURTHEST = 0.1  # of a step, that its correction may be


@dataclass
class Reference:
    """Where the natural branches lead.

    Attributes:
        level: 1, or where they end, shape (scene,).
        unknowns: There, shape (scene, n).
        agreed: Whether two resolutions led to the same, shape (scene,).
    """

    level: Any
    unknowns: Any
    agreed: Any


def draw(kind: str, count: int, seed: int, most: float = MOST) -> tuple[mr.ConcentricTubes, mr.Inputs]:
    """A batch of scenes of one kind, of unit length and with inner tubes of unit bending stiffness."""
    tubes, force, weight, _ = KINDS[kind]
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    EI = np.exp(rng.uniform(np.log(0.3), np.log(4), (count, tubes)))
    EI[rng.random(count) < 0.2] = 1.0
    EI[:, 0] = 1.0
    GJ = EI * np.where(rng.random((count, 1)) < 0.5, 1 / 1.3, rng.uniform(0.3, 1.0, (count, tubes)))
    reach = np.sort(rng.uniform(0.3, 1, (count, tubes)), axis=1)[:, ::-1]
    reach[rng.random(count) < 0.5] = 1.0
    reach[:, 0] = 1.0
    beta = -np.sort(rng.uniform(0, 1, (count, tubes)), axis=1)[:, ::-1]
    beta *= np.where(rng.random(count) < 0.5, 0.0, rng.uniform(0, 1, count))[:, None]
    straight = np.where(rng.random((count, 1)) < 0.5, 1e-3, rng.uniform(0.05, 0.8, (count, tubes))) * reach
    bend = np.exp(rng.uniform(np.log(0.3), np.log(3), (count, tubes)))
    azimuth = np.where(rng.random((count, 1)) < 0.6, 0.0, rng.uniform(-np.pi, np.pi, (count, tubes)))
    twist = np.where(rng.random((count, 1)) < 0.7, 0.0, rng.uniform(-2, 2, (count, tubes)))
    bend[rng.random(count) < 0.15] = 1.0
    size = rng.uniform(0.5, most, count) / np.sqrt(coupling(EI, GJ, bend))
    rods = []
    for k in range(tubes):
        u = np.stack([bend[:, k] * np.cos(azimuth[:, k]), bend[:, k] * np.sin(azimuth[:, k]), np.zeros(count)], axis=1)
        u *= size[:, None]
        u[:, 2] = twist[:, k]
        own = {"bending_stiffness": EI[:, k, None], "torsional_stiffness": GJ[:, k], "linear_density": np.ones(count)}
        first = straight[:, k] - beta[:, k]
        parts = [(first, np.zeros((count, 3))), (reach[:, k] - straight[:, k], u)]
        rods.append(mr.Rod(sections=[mr.Section(length=length, precurvature=bent, **own) for length, bent in parts]))
    anywhere = rng.uniform(-2 * np.pi, 2 * np.pi, (count, tubes))
    alpha = np.where(rng.random((count, 1)) < 0.7, anywhere, rng.choice(TURNS, (count, tubes)))
    robot = mr.ConcentricTubes(rods)
    direction = rng.normal(size=(count, 3))
    load = np.exp(rng.uniform(np.log(0.02), np.log(5), count)) * EI.sum(axis=1) / np.linalg.norm(direction, axis=1)
    load = load[:, None] * direction
    loads = {"tip_force": load} if force else {"gravity": load / tubes} if weight else {}
    return robot, robot.inputs(rotation=alpha, translation=beta, **loads)


def coupling(EI: Any, GJ: Any, bend: Any) -> Any:
    """``c`` of the stiffest pull that round tubes' precurvatures exert on their twist, (batch,): theta'' = c sin theta for
    two."""
    pull = EI * bend
    pair = pull[:, :, None] * pull[:, None] / EI.sum(axis=1)[:, None, None]
    count = EI.shape[1]
    pair[:, range(count), range(count)] = 0.0
    form = -pair
    form[:, range(count), range(count)] = pair.sum(axis=2)
    root = 1 / np.sqrt(GJ)
    return np.linalg.eigvalsh(form * root[:, :, None] * root[:, None])[:, -1]


def follow(problem: BoundaryProblem, steps: int) -> tuple[Any, Any]:
    """Level and unknowns at the end of each branch, by steps of 1/steps at most."""
    count, n = problem.instance_count, problem.unknown_count
    points, levels = np.zeros((4, count, n)), np.zeros((4, count))
    with problem.everyone(), problem.at_load(0.0):
        points[0] = problem.guess()
        _, gamma = problem.evaluate(points[0])
    signs = np.sign(np.linalg.det(gamma))
    known = np.ones(count, dtype=int)
    step = np.full(count, 1.0 / steps)
    failures = np.zeros(count, dtype=int)
    open_ = np.ones(count, dtype=bool)
    while open_.any():
        at = np.flatnonzero(open_)
        goal = np.minimum(1.0, levels[0] + step)
        factor = np.ones(count)
        factor[at] = goal[at]
        guess = points[0].copy()
        guess[at] = extrapolate(points[:, at], levels[:, at], known[at], goal[at])
        first, gamma = _correction(problem, guess, at, factor)
        found = guess.copy()
        found[at] += first
        size, moved = np.linalg.norm(first, axis=1), np.linalg.norm(found[at] - points[0, at], axis=1)
        good = np.isfinite(size)
        rough = np.flatnonzero(good & (size > 1e-7))
        if len(rough):
            again = at[rough]
            length = size[rough]
            for _ in range(3):
                last = length
                second, newer = _correction(problem, found, again, factor)
                length = np.linalg.norm(second, axis=1)
                good[rough] &= (length <= SLOWEST * last) | (length < 1e-9)
                found[again] += np.nan_to_num(second)
                gamma[rough] = newer
                if not (length[good[rough]] > 1e-7).any():
                    break
        good &= (known[at] < 3) | (size <= FURTHEST * moved + 1e-9)
        with np.errstate(invalid="ignore"):
            good &= np.sign(np.linalg.det(gamma)) == signs[at]
        kept, failed = at[good], at[~good]
        points[1:, kept], levels[1:, kept] = points[:-1, kept], levels[:-1, kept]
        points[0, kept], levels[0, kept] = found[kept], goal[kept]
        known[kept] = np.minimum(known[kept] + 1, 4)
        step[kept] = np.minimum(1.5 * step[kept], 1.0 / steps)
        step[failed] *= 0.5
        failures[kept] = 0
        failures[failed] += 1
        # equilibria far behind say nothing of a branch that turns here
        known[failures >= TURNING] = 1
        open_ &= (levels[0] < 1.0) & (step > SHORTEST)
    return levels[0], points[0]


def _correction(problem: BoundaryProblem, unknowns: Any, at: Any, factor: Any) -> tuple[Any, Any]:
    """Newton's step of the instances ``at`` (k,), and ``Gamma``, at a load factor of each instance."""
    with problem.only(np.isin(np.arange(problem.instance_count), at)), problem.at_load(factor):
        residual, gamma = problem.evaluate(unknowns)
    residual, gamma = residual[at], gamma[at]
    sound = np.isfinite(residual).all(axis=1) & (np.linalg.det(np.nan_to_num(gamma)) != 0)
    result = np.full(residual.shape, np.nan)
    result[sound] = -np.linalg.solve(gamma[sound], residual[sound][..., None])[..., 0]
    return result, gamma


def extrapolate(points: Any, levels: Any, known: Any, goal: Any) -> Any:
    """Polynomials through the equilibria known, (scene, n), by Lagrange's formula."""
    result = np.zeros(points.shape[1:])
    for number in range(1, 5):
        mine = known == number
        for i in range(number):
            weight = np.ones(mine.sum())
            for j in range(number):
                if j != i:
                    weight *= (goal[mine] - levels[j, mine]) / (levels[i, mine] - levels[j, mine])
            result[mine] += weight[:, None] * points[i, mine]
    return result


def reference(problem: BoundaryProblem) -> Reference:
    """Two resolutions that agree, or that they never did."""
    level, unknowns = follow(problem, COARSEST)
    agreed = np.zeros(len(level), dtype=bool)
    steps = COARSEST
    while steps < FINEST and not agreed.all():
        steps *= 2
        places = np.flatnonzero(~agreed)
        finer, there = follow(problem.parts.of(places), steps)
        same = (np.abs(finer - level[places]) < 1e-4) & ((finer < 1) == (level[places] < 1))
        same &= (finer < 1) | alike(there, unknowns[places])
        level[places], unknowns[places] = finer, there
        agreed[places] = same
    return Reference(level, unknowns, agreed)


def alike(a: Any, b: Any) -> Any:
    """Whether unknowns are the same."""
    return np.abs(a - b).max(axis=1) <= SAME * np.maximum(1.0, np.abs(b).max(axis=1))


def unstable(problem: BoundaryProblem, unknowns: Any) -> Any:
    """Whether an equilibrium is surely unstable."""
    problem.write("unknowns", unknowns)
    return problem.stability.modes().stability == Stability.UNSTABLE


def judge(kind: str, count: int, seed: int, most: float = MOST) -> dict[str, Any]:
    """One piece: what the search for the natural branch says, and what is so; flags and counts, one a scene."""
    robot, inputs = draw(kind, count, seed, most)
    problem: Any = robot.problem(inputs, integrator=INTEGRATOR)
    solver = mr.Shooting(integrator=INTEGRATOR)
    begin = process_time()
    outcome = natural_branch(problem, solver.newton(problem), solver.max_continuation_steps)
    taken = process_time() - begin
    unknowns, status = problem.read("unknowns"), outcome.status
    said = status == Status.CONVERGED
    truth = reference(problem)
    there = truth.level == 1.0
    same = alike(unknowns, truth.unknowns)
    return {
        "seconds": np.array([taken]),
        "integrations": outcome.integrations,
        "status": status,
        "level": truth.level,
        "wrong": said & ~(there & same) & truth.agreed,
        "unstable": said & unstable(problem, unknowns),
        "lost": ~said & there & truth.agreed,
        "undecided": ~truth.agreed,
        "reference unstable": there & unstable(problem, truth.unknowns),
        "reached": there,
    }


def study(
    scenes: int, seed: int, piece: int, kinds: tuple[str, ...] = tuple(KINDS), most: float = MOST
) -> dict[str, dict[str, Any]]:
    """All kinds, in pieces."""
    results: dict[str, dict[str, Any]] = {}
    share = {kind: KINDS[kind][3] for kind in kinds}
    for kind in kinds:
        count = round(scenes * share[kind] / sum(share.values()))
        parts = [judge(kind, min(piece, count - k), seed + k // piece, most) for k in range(0, count, piece)]
        results[kind] = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return results


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--piece", type=int, default=250)
    parser.add_argument("--most", type=float, default=MOST, help="of L sqrt(c)")
    parser.add_argument("--kind", choices=tuple(KINDS), action="append")
    parser.add_argument("--list", action="store_true", help="name the scenes that are wrong, unstable or lost")
    options = parser.parse_args()
    flags = ("reached", "wrong", "unstable", "lost", "undecided", "reference unstable")
    print("| tubes | scenes | " + " | ".join(flags) + " | integrations, mean | 99 % | µs a solve |")
    print("|" + "---|" * (len(flags) + 5))
    total: Counter[str] = Counter()
    for kind in options.kind or KINDS:
        share = KINDS[kind][3] / sum(KINDS[k][3] for k in options.kind or KINDS)
        found = study(round(options.scenes * share), options.seed, options.piece, (kind,), options.most)[kind]
        n, counts = len(found["status"]), found["integrations"]
        total.update({flag: int(found[flag].sum()) for flag in flags} | {"scenes": n})
        row = [kind, n, *(int(found[flag].sum()) for flag in flags), f"{counts.mean():.1f}", f"{np.percentile(counts, 99):.0f}"]
        print("| " + " | ".join(map(str, [*row, f"{1e6 * found['seconds'].sum() / n:.0f}"])) + " |", flush=True)
        if options.list:
            for flag in ("wrong", "unstable", "lost", "reference unstable"):
                print(f"  {flag}: {np.flatnonzero(found[flag]).tolist()}")
    print("| all | " + " | ".join(str(total[name]) for name in ("scenes", *flags)) + " | | | |")


if __name__ == "__main__":
    main()
