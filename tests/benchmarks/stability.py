"""What a stability test costs beside the solve: integrations, and time in units of one integration of the solve.

python tests/benchmarks/stability.py [--rounds N] [--batch N]
"""

import argparse
from collections.abc import Callable
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

import multirod as mr
from multirod.models.backbone.nodes.node_passes import NodePasses


def seconds(call: Callable[[], object], rounds: int) -> float:
    """Median of several runs, after one that compiles and warms."""
    call()
    times = []
    for _ in range(rounds):
        begin = perf_counter()
        call()
        times.append(perf_counter() - begin)
    return float(np.median(times))


def scenes(count: int) -> dict[str, tuple[mr.Assembly, mr.Inputs]]:
    """Robots with ``count`` instances of their inputs each."""
    rng = np.random.default_rng(1)
    wire = mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814, precurvature=(14, 5, 0))
    tubes = []
    for k, (EI, kappa) in enumerate(((0.01, 8.0), (0.03, 5.0), (0.08, 2.0))):
        pieces = [(0.1, (0, 0, 0)), (0.3 - 0.08 * k, (kappa, 0, 0))]
        tubes.append(mr.Rod(length=0.4 - 0.08 * k, bending_stiffness=EI, torsional_stiffness=EI / 1.3, precurvature=pieces))
    leg = mr.Rod(length=0.4, bending_stiffness=0.157, torsional_stiffness=0.126)
    base, platform = np.tile(np.eye(4), (6, 1, 1)), np.tile(np.eye(4), (6, 1, 1))
    for poses, lean in ((base, 0.0), (platform, 0.7)):
        angle = lean * (-1.0) ** np.arange(6) + np.pi / 3 * np.arange(6)
        poses[:, :2, 3] = 0.087 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    single, triple, hexapod = (
        mr.SingleRod(wire),
        mr.ConcentricTubes(tubes),
        mr.ParallelRods(legs=[leg] * 6, base=base, platform=platform),
    )
    force = rng.normal(size=(count, 3))
    return {
        "wire, 1 N": (single, single.inputs(tip_force=force)),
        "wire, 50 N": (single, single.inputs(tip_force=50 * (0.3 * force + (0, 0, 1)))),
        "three tubes": (triple, triple.inputs(tip_force=0.3 * force, rotation=rng.uniform(0, 1, (count, 3)))),
        "six legs": (hexapod, hexapod.inputs(tip_force=force)),
    }


def passes(problem: mr.BoundaryProblem) -> float:
    """Integrations of each leg that ``modes`` takes, the mean over instances."""
    taken: dict[int, float] = {}
    over = NodePasses.over

    def counted(self: NodePasses, node_count: int, chosen: NDArray[np.bool_], **options: object) -> object:
        taken[id(self)] = taken.get(id(self), 0.0) + float(chosen.mean())
        return over(self, node_count, chosen, **options)

    NodePasses.over = counted  # type: ignore[method-assign, assignment]
    try:
        problem.stability.modes()
    finally:
        NodePasses.over = over  # type: ignore[method-assign]
    return max(taken.values())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--batch", type=int, default=1000)
    options = parser.parse_args()
    print(f"Batch of {options.batch}; times a robot\n")
    print("| robot | integrator | solve: integrations | an integration [µs] | test: integrations | test [µs] | in integrations |")
    print("|---|---|---|---|---|---|---|")
    for name, (robot, inputs) in scenes(options.batch).items():
        for integrator in (mr.RK45(), mr.RK4(50)):
            solution = mr.solve(robot, inputs, solver=mr.Shooting(integrator=integrator))
            with solution._problem() as problem:
                calls = (problem.integrate, problem.stability.modes)
                one, test = (1e6 * seconds(call, options.rounds) / options.batch for call in calls)
            kind = type(integrator).__name__
            mean = np.mean(solution.integrations)
            print(
                f"| {name} | {kind} | {mean:.1f} | {one:.1f} | {passes(problem):.2f} | {test:.1f} | {test / one:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
