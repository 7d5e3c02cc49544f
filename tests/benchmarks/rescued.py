"""What rescues cost in a batch, and what rods at the extremes cost one by one, in integrations and processor time; and whether
fewer starts find the same lowest equilibria.

OMP_NUM_THREADS=1 python tests/benchmarks/rescued.py                  batches of 10,000, with and without 1 % of hard ones: that
                                                                      only segments solve, that buckle, tubes that snap, and of
                                                                      500 platforms, whose legs buckle
OMP_NUM_THREADS=1 python tests/benchmarks/rescued.py --extremes 5000  random extreme single rods, each alone
OMP_NUM_THREADS=1 python tests/benchmarks/rescued.py --starts 25      random pairs of tubes, 150 turns of each, by fewer and
                                                                      more starts
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from meant import meant
from random_scenes import SINGLE, Scene, draw

import multirod as mr
from multirod.batch import IntArray
from multirod.solvers.starting import multistart
from multirod.validation import FloatArray

LENGTH, EI = 0.4, 0.02
SLOW = 2.0  # s
TURNS = 150  # of a robot of tubes
FEWER, ALL = (8, 16, 32, 128), 512  # starts in a round

Pair = tuple[mr.Assembly, dict[str, FloatArray], dict[str, FloatArray]]  # a robot, its easy inputs, and with hard ones


def _rescued(robot: mr.SingleRod, size: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Forces of these sizes, those that multiple shooting solves: others lead where the rod snaps."""
    way = rng.normal(size=(len(size), 3))
    force = size * way / np.linalg.norm(way, axis=1)[:, None]
    solution = mr.solve(robot, robot.inputs(tip_force=force), solver=mr.MultipleShooting(), threads=1, progress=False)
    return force[solution.status == mr.Status.MULTIPLE_SHOOTING]


def _pulled(count: int, hard: IntArray, rng: np.random.Generator) -> Pair:
    """Forces of up to 12 EI/L^2 every way, and the same with a part of them of 600 to 2400, which only segments solve."""
    rod = mr.Rod(length=LENGTH, bending_stiffness=(EI, 1.5 * EI), torsional_stiffness=0.6 * EI, precurvature=(4, -2, 6))
    robot, unit = mr.SingleRod(rod), EI / LENGTH**2
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    easy = way * unit * rng.uniform(0, 12, size=(count, 1))
    mixed = easy.copy()
    mixed[hard] = _rescued(robot, unit * rng.uniform(600, 2400, size=(3 * len(hard), 1)), rng)[: len(hard)]
    return robot, {"tip_force": easy}, {"tip_force": mixed}


def _pressed(count: int, hard: IntArray, rng: np.random.Generator) -> Pair:
    """Straight strips under up to 0.9 of Euler's load, and the same with a part of them under 1.05 to 1.5 of it."""
    robot = mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=(EI, 2 * EI), torsional_stiffness=0.6 * EI))
    critical = np.pi**2 / 4 * EI / LENGTH**2
    easy = np.zeros((count, 3))
    easy[:, 2] = -critical * rng.uniform(0, 0.9, count)
    mixed = easy.copy()
    mixed[hard, 2] = -critical * rng.uniform(1.05, 1.5, len(hard))
    return robot, {"tip_force": easy}, {"tip_force": mixed}


def _turned(count: int, hard: IntArray, rng: np.random.Generator) -> Pair:
    """Pairs of curved tubes that are turned by up to 3 rad, and the same with a part of them by 4.5 to 6, which snap."""
    robot = mr.ConcentricTubes(
        [mr.Rod(length=0.3, bending_stiffness=EI, torsional_stiffness=0.75 * EI, precurvature=(9, 0, 0)),
         mr.Rod(length=0.25, bending_stiffness=EI, torsional_stiffness=0.75 * EI, precurvature=(8, 0, 0))]
    )  # fmt: skip
    easy = np.zeros((count, 2))
    easy[:, 1] = rng.uniform(-3, 3, count)
    mixed = easy.copy()
    mixed[hard, 1] = rng.uniform(4.5, 6, len(hard))
    return robot, {"rotation": easy}, {"rotation": mixed}


def _platforms(count: int, hard: IntArray, rng: np.random.Generator) -> Pair:
    """Platforms on six legs, pressed by up to 0.6 of what buckles them, and the same with a part of them under 1.1 to 2 of it."""
    angles, leg = np.arange(6) * np.pi / 3, mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=0.7 * EI)
    base, platform = np.zeros((2, 6, 4, 4)) + np.eye(4)
    for ends, radius, turned in ((base, 0.15, 0.2), (platform, 0.08, -0.2)):
        ends[:, 0, 3] = radius * np.cos(angles + turned * (-1.0) ** np.arange(6))
        ends[:, 1, 3] = radius * np.sin(angles + turned * (-1.0) ** np.arange(6))
    robot = mr.ParallelRods(legs=[leg] * 6, base=base, platform=platform)
    critical = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -EI / LENGTH**2)))[0].load_factor * EI / LENGTH**2
    easy = np.zeros((count, 3))
    easy[:, 2] = -critical * rng.uniform(0, 0.6, count)
    mixed = easy.copy()
    mixed[hard, 2] = -critical * rng.uniform(1.1, 2, len(hard))
    return robot, {"tip_force": easy}, {"tip_force": mixed}


@meant()
def batch(name: str, count: int, part: float) -> None:
    """One batch with and without what is hard, in turns."""
    rng = np.random.default_rng(0)
    count //= FEW.get(name, 1)
    hard = rng.choice(count, int(part * count), replace=False)
    robot, easy, mixed = BATCHES[name](count, hard, rng)
    seconds: dict[str, list[float]] = {"without": [], "stopped at": [], "with": []}
    for k in range(4):
        for which, given in (("without", easy), ("stopped at", mixed), ("with", mixed)):
            solver = mr.Shooting(at_fold="stop" if which == "stopped at" else "follow")
            start = process_time()
            solution = mr.solve(robot, robot.inputs(**given), solver=solver, threads=1, progress=False)
            taken = process_time() - start
            if k == 0:
                continue  # compiles
            seconds[which].append(taken)
            said = Counter(str(status) for status in map(mr.Status, solution.status))
            print(f"{count} {name}, {which} hard ones: {taken:.2f} s, {dict(said)}", flush=True)
    ratio = np.array(seconds["with"]) / seconds["without"]
    each, stopped = (1e3 * (np.array(seconds[which]) - seconds["without"]) / len(hard) for which in ("with", "stopped at"))
    print(f"| {count} {name}, {part:.0%} hard | ratio of processor times {np.median(ratio):.2f} ({ratio.min():.2f} to "
          f"{ratio.max():.2f}) | {np.median(each):.1f} ms a hard one ({each.min():.1f} to {each.max():.1f}), "
          f"{solution.integrations[hard].mean():.0f} integrations; "
          f"{np.median(stopped):.2g} ms where it is not followed |")  # fmt: skip


BATCHES: dict[str, Callable[[int, IntArray, np.random.Generator], Pair]] = {
    "pulled rods": _pulled,
    "pressed strips": _pressed,
    "turned tubes": _turned,
    "pressed platforms": _platforms,
}
FEW = {"pressed platforms": 20}  # of which there are so many times fewer


@meant()
def _timed(scene: Scene) -> tuple[mr.Solution, float]:
    start = process_time()
    solution = mr.solve(scene.robot, scene.inputs, progress=False)
    return solution, process_time() - start


def extremes(count: int, first: int) -> None:
    """Random extreme single rods: statuses, integrations, and the slowest."""
    seconds, integrations, said = [], [], Counter()
    for kind in SINGLE:
        scene = draw(kind, 99_999)  # compiles
        mr.solve(scene.robot, scene.inputs)
    for k in range(count):
        kind, seed = list(SINGLE)[k % len(SINGLE)], first + k // len(SINGLE)
        scene = draw(kind, seed)
        solution, taken = _timed(scene)
        if taken > SLOW:
            solution, taken = _timed(scene)  # the first time kernels may have been compiled
        seconds.append(taken)
        integrations.append(int(solution.integrations))
        said[str(solution.status)] += 1
        if seconds[-1] > SLOW:
            print(f"{kind}, seed {seed}: {seconds[-1]:.1f} s, {integrations[-1]} integrations, {solution.status}", flush=True)
    solved = sum(number for name, number in said.items() if not mr.Status[name].failed)
    parts = (50, 95, 99, 100)
    print(f"{count} rods, {solved} solved: {dict(said)}")
    print(f"integrations, {parts} %: {np.percentile(integrations, parts).astype(int).tolist()}")
    slow = int(np.sum(np.array(seconds) > SLOW))
    print(f"processor time [s]: {np.percentile(seconds, parts).round(3).tolist()}, over {SLOW:g} s: {slow}")


def _pair(rng: np.random.Generator) -> mr.ConcentricTubes:
    """Two tubes by lot, straight where they begin."""
    tubes = []
    for k, length in enumerate(np.sort(rng.uniform(0.1, 0.9, 2))[::-1].tolist()):
        straight, EI = rng.uniform(0, 0.6) * length, rng.uniform(0.005, 0.04) * (1 + k)
        bent = [(straight, (0, 0, 0)), (length - straight, (rng.uniform(2, 16), 0, 0))]
        GJ = EI * rng.uniform(0.6, 0.9)
        tubes.append(mr.Rod(length=length, bending_stiffness=EI, torsional_stiffness=GJ, precurvature=bent))
    return mr.ConcentricTubes(tubes)


def starts(robots: int, seed: int) -> None:
    """How many of the lowest equilibria that 512 starts in a round find are not those that fewer find."""
    usual, rng = multistart.STARTS_ON_A_LINE, np.random.default_rng(seed)
    searched, others = 0, Counter[int]()
    multistart.STARTS_IN_A_ROUND = ALL
    for _ in range(robots):
        robot = _pair(rng)
        inputs, found = robot.inputs(rotation=rng.uniform(-12, 12, (TURNS, 2))), {}
        for number in (*FEWER, ALL):
            multistart.STARTS_ON_A_LINE = number
            found[number] = mr.solve(robot, inputs, threads=1, progress=False)
        searched += int((found[ALL].status == mr.Status.LOWEST_ENERGY).sum())
        for number in FEWER:
            same = np.isclose(found[number].potential, found[ALL].potential, rtol=1e-8, atol=0, equal_nan=True)
            others[number] += int((~same).sum())
    print(f"{searched} pairs that snap; of these, by so many starts in a round (usual: {usual}), elsewhere: {dict(others)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--extremes", type=int, default=0, help="random extreme single rods, in place of the batch")
    parser.add_argument("--seed", type=int, default=0, help="the first of each kind")
    parser.add_argument("--count", type=int, default=10_000, help="rods of the batch")
    parser.add_argument("--starts", type=int, default=0, help="random pairs of tubes, by fewer and more starts")
    options = parser.parse_args()
    if options.starts:
        starts(options.starts, options.seed)
    elif options.extremes:
        extremes(options.extremes, options.seed)
    else:
        for name in BATCHES:
            batch(name, options.count, 0.01)


if __name__ == "__main__":
    main()
