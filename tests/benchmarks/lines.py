"""What tendons cost: an integration of a batch against rods without, rounds interleaved; steps of a control loop; random scenes.

python tests/benchmarks/lines.py [--rounds N] [--scenes N]
"""

import argparse
from collections.abc import Iterator
from time import perf_counter, process_time

import numpy as np

import multirod as mr

BATCH = 2048
STEPS = 50
SHEARS = {"shear_stiffness": 500.0, "axial_stiffness": 1500.0}


def helix(s: float) -> tuple[float, float]:
    return 0.006 * np.cos(30 * s), 0.006 * np.sin(30 * s)


def tendons(count: int, routed: bool = False) -> list[mr.Tendon]:
    angles = 2 * np.pi * np.arange(count) / 3
    straight = [mr.Tendon(offset=(0.008 * np.cos(a), 0.008 * np.sin(a))) for a in angles]
    return [*straight[:-1], mr.Tendon(route=helix)] if routed else straight


class Case:
    """One batch, to be integrated again and again."""

    def __init__(self, lines: list[mr.Tendon], **stiffness: float) -> None:
        rod = mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines, **stiffness)
        robot = mr.SingleRod(rod)
        random = np.random.default_rng(0)
        values = {"tip_force": random.uniform(-0.2, 0.2, (BATCH, 3))}
        if lines:
            values["tension"] = random.uniform(0, 2, (BATCH, len(lines)))
        self.problem = robot.problem(robot.inputs(**values), integrator=mr.RK4(STEPS))
        self()

    def __call__(self) -> float:
        """Microseconds an instance, in processor time."""
        begin = process_time()
        self.problem.integrate()
        return 1e6 * (process_time() - begin) / BATCH


# ---- a control loop ----


def followed() -> Iterator[tuple[str, mr.SingleRod, str, np.ndarray]]:
    """What is driven, by which input, and how: samples at 200 Hz, in which tendons go slack and taut again."""
    t, own = 0.005 * np.arange(600)[:, None], {"bending_stiffness": 0.01, "torsional_stiffness": 0.0077}
    turned = np.arange(3) * 2 * np.pi / 3
    around = 0.008 * np.column_stack([np.cos(turned), np.sin(turned)])
    by_length = {"driven": "displacement", "axial_stiffness": 300.0}
    one = mr.SingleRod(mr.Rod(length=0.2, **own, lines=[mr.Tendon(offset) for offset in around]))
    yield "three tendons by tension", one, "tension", 1 + np.cos(3 * t - turned)
    pulled = mr.SingleRod(mr.Rod(length=0.2, **own, lines=[mr.Tendon(offset, **by_length) for offset in around]))
    yield "three tendons by displacement", pulled, "displacement", 0.002 * np.cos(3 * t - turned) + 0.0004 * np.cos(9 * t)
    sections = [mr.Section(length=0.1, **own), mr.Section(length=0.1, **own)]
    first = [mr.Tendon(offset, end=0.1, **by_length) for offset in around]
    two = mr.SingleRod(mr.Rod(sections=sections, lines=first + [mr.Tendon(-offset, **by_length) for offset in around]))
    pull = np.concatenate(
        [0.002 * np.cos(3 * t - turned), 0.002 * np.cos(2 * t - turned) + 0.001 * np.cos(3 * t - turned)], axis=1
    )
    yield "two segments, six by displacement", two, "displacement", pull


def follow() -> None:
    """Print what steps take."""
    print(f"\nTracker.step, RK4({STEPS}), 600 samples at 200 Hz\n")
    print("| robot | failed | integrations, median, mean | µs, median |\n|---|---|---|---|")
    for name, robot, drive, motion in followed():
        tracker = mr.Tracker(
            robot, dt=0.005, inputs=robot.inputs(**{drive: motion[0]}), solver=mr.Shooting(integrator=mr.RK4(STEPS))
        )
        failed, counts, times = 0, [], []
        for values in motion:
            begin = perf_counter()
            sample = tracker.step(**{drive: values})
            times.append(1e6 * (perf_counter() - begin))
            failed += sample.status.failed
            counts.append(sample.integrations)
        print(f"| {name} | {failed} | {np.median(counts):.0f}, {np.mean(counts):.1f} | {np.median(times):.0f} |")


# ---- random scenes ----


def scenes(count: int) -> Iterator[tuple[str, mr.SingleRod, np.ndarray, np.ndarray]]:
    """Robots, displacements (count, lines) and forces over EI/L^2 (count, 3)."""
    random, own = np.random.default_rng(1), {"bending_stiffness": 0.01, "torsional_stiffness": 0.0077}
    by_length = {"driven": "displacement"}

    def around(angles: np.ndarray) -> np.ndarray:
        return 0.008 * np.column_stack([np.cos(angles), np.sin(angles)])

    third, quarter = np.arange(3) * 2 * np.pi / 3, np.arange(4) * np.pi / 2
    stiff = [mr.Tendon(offset, **by_length) for offset in around(quarter)]
    elastic = {**by_length, "axial_stiffness": 300.0}
    six = [mr.Tendon(offset, end=0.1, **elastic) for offset in around(third)] + [
        mr.Tendon(o, **elastic) for o in around(third + 1)
    ]
    sections = [mr.Section(length=0.1, bending_stiffness=k * 0.01, torsional_stiffness=0.0077) for k in (2, 1)]
    mixed = [mr.Tendon(route=helix, end=0.15, **by_length), *(mr.Tendon(o, **elastic) for o in ((0.007, 0), (-0.003, -0.006)))]
    push = [mr.PushRod(offset, bending_stiffness=0.004, axial_stiffness=1000.0) for offset in around(third)]
    robots = {
        "four that do not stretch": mr.Rod(length=0.2, **own, lines=stiff),
        "two segments, six elastic": mr.Rod(sections=sections, lines=six),
        "a helix, shear, precurvature": mr.Rod(length=0.2, **own, **SHEARS, precurvature=(3, -4, 2), lines=mixed),
        "three push rods": mr.Rod(length=0.2, **own, lines=push),
    }
    for name, rod in robots.items():
        for size in (1.0, 10.0):
            pull = random.uniform(-0.004, 0.006, (count, len(rod.lines)))
            if name.startswith("four"):  # antagonists cannot both be pulled
                pair = random.uniform(-0.004, 0.004, (count, 2))
                pull = np.concatenate([pair, -pair - random.uniform(0, 0.002, (count, 2))], axis=1)
            if name.endswith("push rods"):  # what all do together stretches them
                pull -= 0.95 * pull.mean(axis=1, keepdims=True)
            force = random.normal(size=(count, 3))
            force *= size * random.uniform(0, 1, (count, 1)) / np.linalg.norm(force, axis=1, keepdims=True)
            yield f"{name}, loads to {size:.0f} EI/L^2", mr.SingleRod(rod), pull, 0.01 / 0.2**2 * force


def try_scenes(count: int) -> None:
    """Print how many are solved, and whether lengths are what they must be, by another integration."""
    print(f"\n{count} random scenes each\n")
    print("| scene | solved | slack lines | unstable | largest gap of a length, m |\n|---|---|---|---|---|")
    for name, robot, pull, force in scenes(count):
        found = mr.solve(robot, robot.inputs(displacement=pull, tip_force=force))
        solved = found.status == mr.Status.CONVERGED
        rest, stiffness = mr.solve(robot).line_length, np.array([line.axial_stiffness for line in robot.rods[0].lines])
        gap = (found.line_length - (rest - pull + rest / stiffness * found.tension))[solved]
        gap = np.where(found.slack[solved], np.maximum(gap, 0), np.abs(gap))
        print(f"| {name} | {solved.sum()} | {found.slack[solved].mean():.0%} | {(found.index > 0).sum()} | {gap.max():.0e} |")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--scenes", type=int, default=1000)
    options = parser.parse_args()
    rounds = options.rounds
    cases = {
        "no lines": Case([]),
        "one tendon": Case(tendons(1)),
        "three tendons": Case(tendons(3)),
        "three, one of them a helix": Case(tendons(3, routed=True)),
        "shear, no lines": Case([], **SHEARS),
        "shear, three tendons": Case(tendons(3), **SHEARS),
    }
    times = {name: [] for name in cases}
    for _ in range(rounds):
        for name, case in cases.items():
            times[name].append(case())
    print(f"Residual and Gamma of {BATCH} rods, RK4({STEPS}), one thread; must be 3 at most for three tendons\n")
    print("| rod | µs each, median | least | times that without lines |\n|---|---|---|---|")
    for name, values in times.items():
        without = times["shear, no lines" if name.startswith("shear") else "no lines"]
        ratio = np.median(np.array(values) / np.array(without))
        print(f"| {name} | {np.median(values):.1f} | {min(values):.1f} | {ratio:.1f} |")
    follow()
    try_scenes(options.scenes)


if __name__ == "__main__":
    main()
