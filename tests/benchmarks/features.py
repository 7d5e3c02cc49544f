"""What leaving out saves: a scene's own kernel against the full model of its assembly, rounds interleaved, the same answer.

The full model has every load of the assembly compiled in, follower loads and so an unknown base force among them, and shear and
extension of a single rod, anisotropy of tubes; "dead" is the same without the follower force and its three unknowns. Times are of
one integration with residual and Gamma (the whole step of Newton's method but for its small linear algebra), and of a cold solve;
both per robot, on one thread, in processor time.

python tests/benchmarks/features.py [--rounds N]
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from time import process_time
from typing import Any

import numpy as np

import multirod as mr
from multirod.models.backbone.influence.envelope import LOADS
from multirod.models.backbone.problem import BackboneProblem

INTEGRATOR = mr.RK4(50)
SOLVER = mr.Shooting(integrator=INTEGRATOR)
BATCH = 64
LAUNCHES = 12
SAME = 1e-7  # of the length; what is compiled in as nearly rigid still gives way by 1e-9
EVERY_TUBE = [(0.00387, 0.00301, 0.431, 0.103, 9.0), (0.01717, 0.01402, 0.332, 0.113, 6.0), (0.03977, 0.05022, 0.174, 0.134, 3.5)]
DEAD = [name for name in LOADS if name != "follower_force"]
STIFF = 1e12  # [N]: shear and extension that are compiled in, and do nothing
UNEVEN = 1 + 1e-12  # the same for the two axes of bending


def tubes(count: int = 3, *, uneven: float = 1.0, torsion: float = 1.0) -> mr.ConcentricTubes:
    """The innermost tubes of three with the stiffness of stored case 09c, less strongly curved."""
    rods = []
    for EI, GJ, length, curved, curvature in EVERY_TUBE[:count]:
        precurvature = [(length - curved, (0, 0, 0)), (curved, (curvature, 0, 0))]
        stiffness = {"bending_stiffness": (EI, EI * uneven), "torsional_stiffness": GJ * torsion}
        rods.append(mr.Rod(length=length, precurvature=precurvature, linear_density=0.01, **stiffness))
    return mr.ConcentricTubes(rods)


def wire(*, shear: float = inf) -> mr.SingleRod:
    """The wire of the paper."""
    stiffness = {
        "bending_stiffness": 0.223349,
        "torsional_stiffness": 0.063814,
        "shear_stiffness": shear,
        "axial_stiffness": shear,
    }
    return mr.SingleRod(mr.Rod(length=0.4, precurvature=(14, 5, 0), linear_density=0.05, **stiffness))


def scattered(robot: mr.Assembly, **loads: Any) -> mr.Inputs:
    """Inputs of a batch, each base turned otherwise."""
    random = np.random.default_rng(0)
    count = robot.rod_count
    values = {"rotation": random.uniform(-0.5, 0.5, (BATCH, count))}
    if count > 1:  # one tube starts at the plate: behind it a tube twists, a rod does not
        values["translation"] = np.array([-0.28, -0.22, -0.1])[:count] + random.uniform(-0.02, 0.02, (BATCH, 1))
    return robot.inputs(**values, **loads)


@dataclass(frozen=True)
class Side:
    """One of two ways to solve the same scene.

    Attributes:
        robot: The assembly.
        inputs: Of a batch.
        enabled: Loads that are compiled in beside those that act.
        options: Of the problem.
    """

    robot: mr.Assembly
    inputs: mr.Inputs
    enabled: Sequence[str] = ()
    pose: bool = True

    def problem(self) -> Any:
        """A new problem."""
        problem: Any = self.robot.problem(self.inputs, integrator=INTEGRATOR, enabled=self.enabled)
        if not self.pose:
            problem = BackboneProblem(
                self.robot.rods, self.robot.base, self.inputs, integrator=INTEGRATOR, enabled=self.enabled, pose=False
            )
        return problem

    def integration(self) -> Callable[[], float]:
        """Microseconds of one integration."""
        problem = self.problem()
        problem.write("unknowns", problem.guess())
        return lambda: timed(problem.integrate, LAUNCHES)

    def solve(self) -> Callable[[], float]:
        """Microseconds of a solve from nothing, all that Python adds to a batch included."""
        problem = self.problem()
        return lambda: timed(lambda: SOLVER.solve(problem), 1)

    def tip(self) -> np.ndarray:
        """Tips of the solution [m], or all that it knows where the pose is left out."""
        problem = self.problem()
        outcome = SOLVER.solve(problem)
        assert (outcome.arrays["status"] == mr.Status.CONVERGED).all(), outcome.arrays["status"]
        return problem.read("position") if self.pose else problem.read("unknowns")


def timed(run: Callable[[], Any], times: int) -> float:
    """Median processor time a robot [µs]: a launch longer than what a busy machine gives at once is not counted twice."""
    taken = []
    for _ in range(times):
        begin = process_time()
        run()
        taken.append(process_time() - begin)
    return 1e6 * float(np.median(taken)) / BATCH


def scenes() -> dict[str, tuple[Side, Side]]:
    """Name, the scene's own kernel, and what it is compared with."""
    force, weight = {"tip_force": (0.0, 0.2, 0.1)}, {"gravity": (0.0, 0.0, -9.81)}
    three, full_three, rigid, nearly = tubes(), tubes(uneven=UNEVEN), tubes(torsion=inf), tubes(torsion=1e6)
    one, full_one = tubes(1), tubes(1, uneven=UNEVEN)
    own, full_own = mr.SingleRod(one.rods[0]), wire(shear=STIFF)
    rod = wire()
    return {
        "three tubes, no load | full": (Side(three, scattered(three)), Side(full_three, scattered(three), LOADS)),
        "three tubes, no load | full, dead": (Side(three, scattered(three)), Side(full_three, scattered(three), DEAD)),
        "three tubes, no load | and a tip force": (
            Side(three, scattered(three)),
            Side(three, scattered(three), ["tip_force"]),
        ),
        "three tubes, tip force | full": (
            Side(three, scattered(three, **force)),
            Side(full_three, scattered(three, **force), LOADS),
        ),
        "three tubes, tip force | full, dead": (
            Side(three, scattered(three, **force)),
            Side(full_three, scattered(three, **force), DEAD),
        ),
        "three tubes, tip force | and gravity": (
            Side(three, scattered(three, **force)),
            Side(three, scattered(three, **force), ["gravity"]),
        ),
        "three tubes rigid in torsion, tip force | twisting": (
            Side(rigid, scattered(rigid, **force)),
            Side(nearly, scattered(nearly, **force)),
        ),
        "three tubes rigid in torsion, tip force | full": (
            Side(rigid, scattered(rigid, **force)),
            Side(tubes(uneven=UNEVEN, torsion=1e6), scattered(nearly, **force), LOADS),
        ),
        "one tube, tip force | full": (Side(one, scattered(one, **force)), Side(full_one, scattered(one, **force), LOADS)),
        "one tube as a SingleRod, tip force | full tube": (
            Side(own, scattered(own, **force)),
            Side(full_one, scattered(one, **force), LOADS),
        ),
        "one tube, tip force | full, dead": (Side(one, scattered(one, **force)), Side(full_one, scattered(one, **force), DEAD)),
        "one rod, no load | full": (Side(rod, scattered(rod)), Side(full_own, scattered(rod), LOADS)),
        "one rod, tip force | full": (Side(rod, scattered(rod, **force)), Side(full_own, scattered(rod, **force), LOADS)),
        "one rod, tip force | full, dead": (Side(rod, scattered(rod, **force)), Side(full_own, scattered(rod, **force), DEAD)),
        "one rod, tip force | and gravity": (
            Side(rod, scattered(rod, **force)),
            Side(rod, scattered(rod, **force), ["gravity"]),
        ),
        "one rod, gravity | and shear": (Side(rod, scattered(rod, **weight)), Side(full_own, scattered(rod, **weight))),
        "one rod, tip force | and shear": (Side(rod, scattered(rod, **force)), Side(full_own, scattered(rod, **force))),
        "one rod, tip force, pose not needed | pose": (
            Side(rod, scattered(rod, **force), pose=False),
            Side(rod, scattered(rod, **force)),
        ),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    every = scenes()
    apart = {}
    for name, (least, more) in every.items():
        a, b = least.tip(), Side(more.robot, more.inputs, more.enabled, least.pose).tip()
        scale = max(float(rod.length.max()) for rod in least.robot.rods) if least.pose else np.abs(a).max()
        apart[name] = float(np.abs(a - b).max() / scale)
        assert apart[name] < SAME, (name, apart[name])
    runs = {name: [side.integration() for side in sides] + [side.solve() for side in sides] for name, sides in every.items()}
    times: dict[str, list[list[float]]] = {name: [] for name in runs}
    for k in range(options.rounds + 1):
        for name, four in runs.items():
            sample = [run() for run in four]
            if k:  # the first compiles
                times[name].append(sample)
    print(
        "| scene | against | integration [µs] | against [µs] | ratio | quartiles "
        "| cold solve, ratio | quartiles | tips apart / L |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name, samples in times.items():
        values = np.array(samples)
        shown = []
        for low, high in ((0, 1), (2, 3)):
            ratio = values[:, high] / values[:, low]
            shown.append(f"{np.median(ratio):.2f} | {np.quantile(ratio, 0.25):.2f} to {np.quantile(ratio, 0.75):.2f}")
        scene, against = name.split(" | ")
        own, other = np.median(values[:, :2], axis=0)
        print(f"| {scene} | {against} | {own:.2f} | {other:.2f} | {shown[0]} | {shown[1]} | {apart[name]:.0e} |")


if __name__ == "__main__":
    main()
