"""Batches: solves a second, against a bare C loop on as many threads, by size, by threads, with impossible instances, of all
robots.

python tests/benchmarks/batches.py [--rounds N] [--quick]
"""

import argparse
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter

import concentric_tubes
import numpy as np
import parallel_rods
from scipy.integrate import solve_ivp
from scipy.optimize import root
from single_rod import STEPS, c_loop

import multirod as mr
from multirod.batch import thread_count
from multirod.studies.experiment import wire

NEWTON = mr.Shooting(integrator=mr.RK4(STEPS))
SIZES = (100, 1000, 10_000, 100_000)
COUNT = 10_000


def forces(count: int, impossible: float = 0.0) -> np.ndarray:
    """Tip forces [N], a part of them far beyond what the wire's branch holds."""
    force = np.random.default_rng(0).uniform(-1, 1, (count, 3))
    if impossible:
        force[:: round(1 / impossible)] = (0, 0, -30)
    return force


class Batch:
    """One batch, to be solved again and again."""

    def __init__(self, robot: mr.Assembly, inputs: mr.Inputs, threads: int) -> None:
        self.robot, self.inputs, self.threads = robot, inputs, threads
        self.count = inputs.batch_shape[0]
        self.solution = self.solve()

    def solve(self) -> mr.Solution:
        return mr.solve(self.robot, self.inputs, solver=NEWTON, threads=self.threads, progress=False)

    def __call__(self) -> float:
        """Microseconds an instance, the best of several runs: short enough to find a quiet time."""
        times = []
        for _ in range(max(3, min(20, 10_000 // self.count))):
            begin = perf_counter()
            self.solve()
            times.append(perf_counter() - begin)
        return 1e6 * min(times) / self.count


def motions(solver: mr.Solver, count: int) -> tuple[float, float]:
    """Microseconds a sample and instance of a batch of motions on one thread: all of ``simulate``, and the solver's steps in
    it."""
    t = 0.005 * np.arange(200)
    phase = np.random.default_rng(0).uniform(0, 6, count)
    force = np.stack([np.sin(t[:, None] + phase), np.cos(t[:, None] + phase), 0 * t[:, None] + 0 * phase], axis=-1)
    robot = mr.SingleRod(wire())
    inputs = robot.inputs(tip_force=force)
    times = []
    for _ in range(3):
        begin = perf_counter()
        history = mr.simulate(robot, inputs, time=t, solver=solver, threads=1, progress=False)
        times.append((perf_counter() - begin, history.step_time.sum()))
    whole, steps = min(times)
    return 1e6 * whole / (len(t) * count), 1e6 * steps / (len(t) * count)


def scipy_loop(forces: np.ndarray) -> float:
    """Microseconds an instance of shooting as one writes it with SciPy, at an accuracy of 1e-8 or so; checked against ours."""
    rod = wire()
    section = rod.sections[0]
    K = np.array([*section.bending_stiffness, float(section.torsional_stiffness)])
    curvature = np.array(section.precurvature)
    length = float(rod.length)

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        u, N = y[:3], y[3:6]
        R = y[6:].reshape(3, 3)
        M = K * (u - curvature)
        turn = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
        return np.concatenate([(-np.cross(u, M) - np.cross((0, 0, 1), N)) / K, -np.cross(u, N), (R @ turn).ravel()])

    def tip(u: np.ndarray, force: np.ndarray) -> np.ndarray:
        start = np.concatenate([u, force, np.eye(3).ravel()])
        return np.asarray(solve_ivp(rates, (0, length), start, rtol=1e-8, atol=1e-10).y[:, -1])

    begin = perf_counter()
    found = [root(lambda u, f=f: tip(u, f)[:3] - curvature, curvature, tol=1e-9).x for f in forces]
    took = perf_counter() - begin
    ours = mr.solve(mr.SingleRod(rod), mr.SingleRod(rod).inputs(tip_force=forces)).unknowns
    assert np.abs(np.array(found) - ours).max() < 1e-5, "SciPy's loop is not the same problem"
    return 1e6 * took / len(forces)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="leave the largest batches out")
    options = parser.parse_args()
    cores = thread_count(None)
    robot = mr.SingleRod(wire())

    def single(count: int, threads: int, impossible: float = 0.0) -> Batch:
        return Batch(robot, robot.inputs(tip_force=forces(count, impossible)), threads)

    sizes = SIZES[:-1] if options.quick else SIZES
    runs: dict[str, Callable[[], float]] = {
        f"{COUNT} on one thread": single(COUNT, 1),
        f"{COUNT} on {cores} threads": single(COUNT, cores),
        f"{COUNT}, 1 % impossible": single(COUNT, cores, 0.01),
        **{f"{count} instances": single(count, cores) for count in sizes},
        **{f"{count} instances, one thread": single(count, 1) for count in sizes},
    }
    with tempfile.TemporaryDirectory() as folder:
        floor = c_loop(Path(folder))
        floors: list[float] = []
        lone: list[float] = []
        times: dict[str, list[float]] = {name: [] for name in runs}
        for _ in range(options.rounds):
            if floor is not None:
                lone.append(floor())
                with ThreadPoolExecutor(cores) as pool:  # as many at once as there are threads
                    floors.append(float(np.mean(list(pool.map(lambda _: floor(), range(cores))))))
            for name, run in runs.items():
                times[name].append(run())
    all_cores = runs[f"{COUNT} on {cores} threads"]
    assert isinstance(all_cores, Batch)
    integrations = float(all_cores.solution.integrations.mean())
    print(f"the paper's rod under random tip forces, Newton from u* to 1e-9, RK4({STEPS}): {integrations:.2f} integrations each")
    print("\n| what | µs an instance | spread |\n|---|---|---|")
    for name, values in times.items():
        print(f"| {name} | {np.median(values):.1f} | {min(values):.1f} to {max(values):.1f} |")
    alone, shared, spoilt = (np.array(times[name]) for name in list(runs)[:3])
    print(f"\n{1e6 / np.median(shared):.0f} solves a second on {cores} threads")
    if floors:
        ratio = shared * cores / (np.array(floors) * integrations)
        print(
            f"{np.median(ratio):.2f} times a bare C loop of the same integrations on as many threads "
            f"({np.median(floors):.2f} µs each)"
        )
    for text, ratio in (
        (f"times as fast on {cores} threads as on one", alone / shared),
        ("times the time with 1 % impossible", spoilt / shared),
    ):
        print(f"{np.median(ratio):.2f} {text} ({ratio.min():.2f} to {ratio.max():.2f})")
    each = scipy_loop(forces(12))
    print(f"a loop of SciPy shooting: {each:.0f} µs each, {each / np.median(shared):.0f} times as long")

    print(
        "\n| robots | seconds | solves a second | integrations a rod, mean | most | the same alone, mean |\n"
        "|---|---|---|---|---|---|"
    )
    tubes, hexapod = concentric_tubes.tubes(), parallel_rods.robot(6)
    random = np.random.default_rng(1)
    few = 10 if options.quick else 1
    many = {
        "three tubes": (tubes, concentric_tubes.scattered(tubes, 20_000 // few)),
        "three loaded tubes": (tubes, concentric_tubes.scattered(tubes, 20_000 // few, tip_force=(0.0, 0.2, 0.1))),
        "six legs": (
            hexapod,
            hexapod.inputs(
                translation=random.uniform(-0.01, 0.01, (5000 // few, 6)), tip_force=random.uniform(-1, 1, (5000 // few, 3))
            ),
        ),
    }
    for name, (assembly, inputs) in many.items():
        mr.solve(assembly, inputs, solver=NEWTON, instances=[0])
        begin = perf_counter()
        solution = mr.solve(assembly, inputs, solver=NEWTON, progress=False)
        took = perf_counter() - begin
        count = inputs.batch_shape[0]
        chosen = np.arange(0, count, count // 50)
        alone = [mr.solve(assembly, inputs, solver=NEWTON, instances=[k]).integrations[0] for k in chosen]
        assert (solution.integrations[chosen] == alone).all()
        print(
            f"| {count} of {name} | {took:.1f} | {count / took:.0f} | {solution.integrations.mean():.1f} "
            f"| {solution.integrations.max()} | {np.mean(alone):.1f} |"
        )

    print(
        "\n| motions of 200 samples at once, one thread | µs a sample and instance | of which steps of the solver |\n"
        "|---|---|---|"
    )
    for name, solver in (("observer", mr.Observer(integrator=mr.RK4(STEPS))), ("Newton", NEWTON)):
        for count in (1, 10, 100, 1000):
            whole, steps = motions(solver, count)
            print(f"| {count}, {name} | {whole:.1f} | {steps:.1f} |")


if __name__ == "__main__":
    main()
