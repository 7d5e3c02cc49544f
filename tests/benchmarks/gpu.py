"""Batches on a GPU against the same on all cores of the processor, by robot and size: microseconds an instance.

python tests/benchmarks/gpu.py [--sizes N ...] [--rounds N] [--robots rod tubes legs] [--precision float32]
"""

import argparse
from collections.abc import Callable
from time import perf_counter

import concentric_tubes
import numpy as np
import parallel_rods
import warp as wp

import multirod as mr
from multirod.batch import thread_count
from multirod.studies.experiment import wire


def scene(name: str, count: int) -> tuple[mr.Assembly, mr.Inputs]:
    """A robot with random loads on its tip, all within what its branch holds."""
    rng = np.random.default_rng(0)
    force = rng.uniform(-1, 1, (count, 3))
    if name == "rod":
        robot: mr.Assembly = mr.SingleRod(wire())
        return robot, robot.inputs(tip_force=force)
    if name == "tubes":
        robot = concentric_tubes.tubes()
        still = concentric_tubes.motion(0.0)
        rotation = rng.uniform(-1, 1, (count, 3))
        return robot, robot.inputs(tip_force=0.05 * force, rotation=rotation, translation=still["translation"])
    robot = parallel_rods.robot(6)
    return robot, robot.inputs(tip_force=force, translation=rng.uniform(0, 0.02, (count, 6)))


def timed(work: Callable[[], object], rounds: int) -> float:
    """Seconds, the median of several runs after one that compiles."""
    work()
    wp.synchronize()
    times = []
    for _ in range(rounds):
        begin = perf_counter()
        work()
        wp.synchronize()
        times.append(perf_counter() - begin)
    return float(np.median(times))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--robots", nargs="+", default=["rod", "tubes", "legs"], choices=["rod", "tubes", "legs"])
    parser.add_argument("--device", default="cuda", help="what is compared with the processor")
    parser.add_argument("--precision", default="float64", choices=["float64", "float32"])
    options = parser.parse_args()
    integrator = mr.RK4(50, precision=options.precision)
    print(f"{wp.get_device(options.device).name} against {thread_count(None)} threads, one for one integration; {integrator}")
    print(f"{'':>6} {'instances':>9} {'integrations':>12}   {'whole solve [us each]':^25}   {'one integration':^25}")
    print(f"{'':>29}   {'cpu':>8} {'gpu':>8} {'ratio':>6}   {'cpu':>8} {'gpu':>8} {'ratio':>6}   {'tips apart [m]':>14}")
    for name in options.robots:
        for count in options.sizes:
            robot, inputs = scene(name, count)
            found, whole, one = [], [], []
            for device in ("cpu", options.device):

                def solve(device: str = device) -> mr.Solution:
                    return mr.solve(robot, inputs, solver=mr.Shooting(integrator=integrator), device=device, progress=False)  # noqa: B023

                found.append(solve())
                whole.append(1e6 * timed(solve, options.rounds) / count)
                problem = robot.problem(inputs, integrator=integrator, device=device)
                problem.write("unknowns", problem.guess())
                one.append(1e6 * timed(problem.integrate, options.rounds) / count)
            here, there = found
            apart = np.nanmax(np.abs(here.tip_position - there.tip_position))
            same = "" if (here.status == there.status).all() else f"  {(here.status != there.status).mean():.2%} end otherwise"
            print(
                f"{name:>6} {count:>9} {here.integrations.mean():>12.2f}"
                f"   {whole[0]:>8.2f} {whole[1]:>8.2f} {whole[0] / whole[1]:>6.1f}"
                f"   {one[0]:>8.3f} {one[1]:>8.3f} {one[0] / one[1]:>6.1f}   {apart:>14.1e}{same}",
                flush=True,
            )


if __name__ == "__main__":
    main()
