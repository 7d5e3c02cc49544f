"""What tendons cost: an integration of a batch against rods without, rounds interleaved; steps of a control loop, observers too;
solves from nothing and loops by how tendons are driven.

python tests/benchmarks/lines.py [--rounds N]
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


def observe() -> None:
    """Print how the nonlinear observer follows what is driven by displacement, from the rod at rest, against solutions."""
    *_, (name, robot, drive, motion) = followed()
    time = 0.005 * np.arange(len(motion))
    turning = 0.05 * np.stack([np.cos(2 * time), np.sin(2 * time), 0 * time], axis=1)
    inputs = robot.inputs(**{drive: motion}, tip_force=turning)
    exact = mr.simulate(robot, inputs, time=time, progress=False).raise_if_failed()
    print(f"\n{name}, 200 Hz, under a turning force, observers from the rod at rest; tip error against solutions\n")
    print("| observer | at 0.1 s, mm | at 0.5 s, mm | mean from then on, mm | status other than TRACKING | µs a sample |")
    print("|---|---|---|---|---|---|")
    for coupling in ("full", "per-rod"):
        for feed_forward in (False, True):
            solver = mr.Observer(coupling=coupling, feed_forward=feed_forward)
            found = mr.simulate(robot, inputs, time=time, solver=solver, progress=False)
            error = 1e3 * np.linalg.norm(found.tip_position - exact.tip_position, axis=1)
            others = (np.asarray(found.status) != mr.Status.TRACKING).sum()
            print(
                f"| {coupling}{', feed-forward' * feed_forward} | {error[20]:.2g} | {error[100]:.2g} | {error[100:].mean():.2g} "
                f"| {others} | {1e6 * np.median(found.step_time):.0f} |"
            )


def drive() -> None:
    """Print what solves from nothing and steps of a loop take of one rod with four tendons, by how these are driven."""
    random, quarters = np.random.default_rng(0), np.pi / 2 * np.arange(4)
    bends = 0.002 * random.uniform(-1, 1, (200, 2))
    lengths, t = np.concatenate([bends, -bends], axis=1), 0.005 * np.arange(400)[:, None]
    turning = 0.002 * np.cos(3 * t - quarters)

    def robot(**own: object) -> mr.SingleRod:
        lines = [mr.Tendon(offset=(0.006 * np.cos(a), 0.006 * np.sin(a)), **own) for a in quarters]
        return mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.006, torsional_stiffness=0.0046, lines=lines))

    by_length = {"driven": "displacement"}
    cases = {
        "by tension": (robot(), {"tension": random.uniform(0, 5, (200, 4))}, {"tension": 1 + 500 * turning}),
        "by displacement, which stretch": (
            robot(**by_length, axial_stiffness=1000.0),
            {"displacement": lengths},
            {"displacement": turning},
        ),
        "by displacement, which do not": (robot(**by_length), {"displacement": lengths}, {"displacement": turning}),
        "the same, let out by 1 um": (robot(**by_length), {"displacement": lengths - 1e-6}, {"displacement": turning - 1e-6}),
        "the same, let out by 1 mm": (robot(**by_length), {"displacement": lengths - 1e-3}, {"displacement": turning - 1e-3}),
    }
    print("\nfour tendons, solves of a batch of 200 from nothing, and a loop of 400 samples at 200 Hz, by default solvers\n")
    print("| tendons | failed | integrations, median | µs each, of processor time | a sample, integrations | µs, median |")
    print("|---|---|---|---|---|---|")
    for name, (own, batch, motion) in cases.items():
        times, failed = [], 0
        for _ in range(4):  # the first compiles
            begin = process_time()
            found = mr.solve(own, own.inputs(**batch), progress=False)
            times.append(1e6 * (process_time() - begin) / 200)
        history = mr.simulate(own, own.inputs(**motion), time=t[:, 0], progress=False)
        failed = int(found.failed.sum() + history.failed.sum())
        taken = f"{np.median(history.integrations):.0f} | {1e6 * np.median(history.step_time):.0f}"
        print(f"| {name} | {failed} | {np.median(found.integrations):.0f} | {np.median(times[1:]):.0f} | {taken} |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
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
    observe()
    drive()


if __name__ == "__main__":
    main()
