"""Integrations in single against double precision, rounds interleaved: time and error, on one thread.

OMP_NUM_THREADS=1 python tests/benchmarks/precision.py [--rounds N] [--device DEVICE]
"""

import argparse
from time import perf_counter
from typing import Any

import concentric_tubes
import numpy as np
import parallel_rods
import warp as wp

import multirod as mr
from multirod.studies.experiment import wire

COUNT = 10_000
FEW = 1000  # robots of several legs
STEPS = 50
PRECISIONS = ("float64", "float32")


def scenes() -> dict[str, tuple[mr.Assembly, mr.Inputs, dict[str, Any]]]:
    """Robots with the inputs of a batch and the options of its problem."""
    random = np.random.default_rng(0)
    force = random.uniform(-1, 1, (COUNT, 3))
    rod = mr.SingleRod(wire())
    soft = mr.SingleRod(
        mr.Rod(
            length=0.3,
            bending_stiffness=0.01,
            torsional_stiffness=0.008,
            shear_stiffness=50.0,
            axial_stiffness=200.0,
            precurvature=(1, 2, 0),
            linear_density=0.1,
        )
    )
    tubes, legs = concentric_tubes.tubes(), parallel_rods.robot(6)
    loads = soft.inputs(tip_force=0.1 * force, tip_moment=0.003 * force[:, ::-1], gravity=(0, 0, -9.81))
    move = random.uniform(-0.01, 0.01, (FEW, 6))
    return {
        "a rod, residual and Gamma": (rod, rod.inputs(tip_force=force), {"pose": False}),
        "a rod, and the tip's pose": (rod, rod.inputs(tip_force=force), {}),
        "a rod with shear, weight, force and moment": (soft, loads, {}),
        "three unloaded tubes": (tubes, concentric_tubes.scattered(tubes, COUNT), {}),
        "three loaded tubes": (tubes, concentric_tubes.scattered(tubes, COUNT, tip_force=(0.0, 0.2, 0.1)), {}),
        "six legs": (legs, legs.inputs(translation=move, tip_force=force[:FEW]), {}),
    }


class Pair:
    """One batch at its equilibria, to be integrated in both precisions."""

    def __init__(
        self, robot: mr.Assembly, inputs: mr.Inputs, options: dict[str, Any], integrators: list[Any], device: str
    ) -> None:
        self.device = device
        shooting = mr.Shooting(integrator=mr.RK4(STEPS))
        found = mr.solve(robot, inputs, solver=shooting, progress=False)
        self.problems = [robot.problem(inputs, integrator=one, device=device, **options) for one in integrators]
        self.count = self.problems[0].instance_count
        unknowns = np.nan_to_num(found.unknowns.reshape(self.count, -1))
        for problem in self.problems:
            problem.write("unknowns", unknowns)
            problem.integrate()
        double, single = self.problems
        sound = ~np.isnan(found.residual)
        gap = np.abs(single.read("residual") - double.read("residual"))[sound].max(axis=1) / single.curvature_scale()[sound]
        self.gap = float(np.median(gap)), float(gap.max())
        length = max(float(np.max(rod.length)) for rod in robot.rods)
        again = mr.solve(robot, inputs, solver=mr.Shooting(integrator=integrators[1], fallback=False), progress=False)
        both = sound & ~np.isnan(again.residual) & (again.status == found.status)
        with np.errstate(invalid="ignore"):
            off = np.linalg.norm(again.tip_position - found.tip_position, axis=-1) / length
        both &= np.isfinite(off)
        self.lost = int(sound.sum() - both.sum())
        self.tip = float(np.median(off[both])), float(off[both].max())

    def measure(self) -> list[float]:
        """Microseconds of an integration in each precision, the best of five, in turn."""
        best = [np.inf, np.inf]
        for _ in range(5):
            for k, problem in enumerate(self.problems):
                wp.synchronize_device(self.device)
                begin = perf_counter()
                problem.integrate()
                wp.synchronize_device(self.device)
                best[k] = min(best[k], perf_counter() - begin)
        return [1e6 * value / self.count for value in best]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--device", default="cpu", help="Warp device")
    options = parser.parse_args()
    methods = {
        f"RK4({STEPS})": [mr.RK4(STEPS, precision=name) for name in PRECISIONS],
        "RK45(1e-6, 1e-7)": [mr.RK45(1e-6, 1e-7, precision=name) for name in PRECISIONS],
    }
    pairs = {}
    for name, (robot, inputs, further) in scenes().items():
        for method, integrators in methods.items():
            if "50" in method or name == "a rod, and the tip's pose":
                pairs[f"{name}, {method}"] = Pair(robot, inputs, further, integrators, options.device)
    times: dict[str, list[list[float]]] = {name: [] for name in pairs}
    for _ in range(options.rounds):
        for name, pair in pairs.items():
            times[name].append(pair.measure())
    print(
        "| an integration of | float64 [µs] | float32 [µs] | float32 / float64 "
        "| residual differs, median, most | tip, median, most | lost |"
    )
    print("|---|---|---|---|---|---|---|")
    for name, pair in pairs.items():
        double, single = np.array(times[name]).T
        ratio = single / double
        print(
            f"| {name} | {np.median(double):.2f} | {np.median(single):.2f} "
            f"| {np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f}) "
            f"| {pair.gap[0]:.0e}, {pair.gap[1]:.0e} | {pair.tip[0]:.0e}, {pair.tip[1]:.0e} | {pair.lost} of {pair.count} |"
        )


if __name__ == "__main__":
    main()
