"""What derivatives cost against the integrations, samples and solves they belong to; ``docs/derivatives.md`` has the table.

    OMP_NUM_THREADS=1 python tests/benchmarks/derivatives.py [--jax]

Ratios are of medians of runs that take turns, so that another load on the machine falls on both.
"""

import argparse
from collections.abc import Callable
from time import perf_counter, process_time

import numpy as np

import multirod as mr

SOLVER = mr.Shooting(integrator=mr.RK4(50))
FORCE = (0.05, 0.1, 0.1)


def interleaved(
    runs: dict[str, Callable[[], object]], count: int = 200, clock: Callable[[], float] = perf_counter
) -> dict[str, float]:
    """Median time of each [s]."""
    for run in runs.values():
        for _ in range(3):
            run()
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(count):
        for name, run in runs.items():
            begin = clock()
            run()
            times[name].append(clock() - begin)
    return {name: float(np.median(values)) for name, values in times.items()}


def tubes() -> mr.ConcentricTubes:
    """Three, whose inner one has two sections and the others one, 15 numbers of precurvature in all."""
    own = [(0.4, 0.1, 14, 0.004), (0.28, 0.08, 6, 0.02), (0.2, 0.07, 4, 0.1)]
    return mr.ConcentricTubes(
        [
            mr.Rod(
                length=length,
                bending_stiffness=EI,
                torsional_stiffness=0.77 * EI,
                precurvature=[(length - curved, (0, 0, 0)), (curved, (0, curvature, 0))],
            )
            for length, curved, curvature, EI in own
        ]
    )


def wire() -> mr.SingleRod:
    """The rod of the observer's paper."""
    return mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814, precurvature=(14, 5, 0)))


SCENES = {
    "three loaded tubes": (tubes(), {"rotation": (-1.2, -0.4, 0.1), "translation": (-0.16, -0.13, -0.1), "tip_force": FORCE}),
    "the paper's rod": (wire(), {"rotation": 0.3, "tip_force": FORCE}),
}


def row(what: str, time: float, **against: float) -> None:
    """One line."""
    ratios = ", ".join(f"{time / other:.2f} {name}" for name, other in against.items())
    print(f"{what:<72} {1e6 * time:9.1f} us   {ratios}", flush=True)


def of_scene(name: str, robot: mr.SingleRod | mr.ConcentricTubes, values: dict[str, object]) -> None:
    """Derivatives, shapes, samples and solves of one robot."""
    inputs = robot.inputs(**values)
    solution = mr.solve(robot, inputs, solver=SOLVER)
    tracker = mr.Tracker(robot, dt=1e-3, solver=SOLVER, inputs=inputs)
    tracker.step()
    carrying = mr.Tracker(robot, dt=1e-3, solver=SOLVER, inputs=inputs, jacobian=("rotation", "tip_force"))
    for _ in range(2):
        sample = carrying.step()
    problem = robot.problem(inputs, integrator=SOLVER.integrator, pose_sensitivities=True)
    problem.write("unknowns", problem.adopt(solution.unknowns[None]))
    count = robot.column_count("precurvature")
    designed = robot.problem(
        inputs, integrator=SOLVER.integrator, pose_sensitivities=True, **robot.input_directions("precurvature")
    )
    designed.write("unknowns", designed.adopt(solution.unknowns[None]))
    designed.aim("precurvature")
    cost = interleaved(
        {
            "integration": problem.integrate,
            "designed": designed.integrate,
            "jacobian": lambda: solution.jacobian("precurvature"),
            "by inputs": lambda: solution.jacobian("rotation", "tip_force"),
            "shape": lambda: solution[()].rod(0),
            "stability": lambda: solution[()].stability,
            "step": lambda: tracker.step(rotation=values["rotation"]),
            "carrying": lambda: carrying.step(rotation=values["rotation"]),
            "of a sample": lambda: sample.jacobian("rotation", "tip_force"),
            "solve": lambda: mr.solve(robot, inputs, solver=SOLVER),
        }
    )
    assert sample.columns is not None
    print(f"\n{name}")
    row("an integration with Gamma and the pose's columns", cost["integration"])
    row(f"the same with {count} columns by precurvature", cost["designed"], integrations=cost["integration"])
    row(f'solution.jacobian("precurvature"), {count} numbers', cost["jacobian"], integrations=cost["integration"])
    row("Tracker.step(rotation=...), the inputs as they were", cost["step"], integrations=cost["integration"])
    row('the same of Tracker(jacobian=("rotation", "tip_force"))', cost["carrying"], steps=cost["step"])
    row('jacobian("rotation", "tip_force") of its sample', cost["of a sample"], steps=cost["step"])
    row('solution.jacobian("rotation", "tip_force")', cost["by inputs"], steps=cost["step"], solves=cost["solve"])
    row("solution.rod(0)", cost["shape"], steps=cost["step"], solves=cost["solve"])
    row("solution.stability", cost["stability"], steps=cost["step"], solves=cost["solve"])
    row("mr.solve from nothing", cost["solve"], steps=cost["step"])


def of_jax(count: int = 500) -> None:
    """A gradient by 18 numbers of precurvature, of a batch."""
    import jax

    robot, values = SCENES["three loaded tubes"]
    with jax.enable_x64(True):
        tip = mr.jax.function(robot, inputs=robot.inputs(**values), solver=SOLVER)
        curves = np.repeat(tip.value_of("precurvature")[None], count, axis=0)
        curves = curves * (1 + 0.05 * np.random.default_rng(0).standard_normal((count, 1, 1, 1)))
        value = jax.jit(lambda u: (tip(precurvature=u) ** 2).sum())
        slope = jax.jit(jax.grad(lambda u: (tip(precurvature=u) ** 2).sum()))
        runs = {"value": lambda: value(curves).block_until_ready(), "slope": lambda: slope(curves).block_until_ready()}
        cost = interleaved(runs, 10, process_time)
    print(f"\nJAX, three loaded tubes, a batch of {count}, each, of the processor's time, which all cores share")
    row("value", cost["value"] / count)
    row("gradient by 18 numbers of precurvature, with the value", cost["slope"] / count, values=cost["value"] / count)


def main() -> None:
    """All of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jax", action="store_true", help="gradients through JAX too")
    arguments = parser.parse_args()
    for name, (robot, values) in SCENES.items():
        of_scene(name, robot, values)
    if arguments.jax:
        of_jax()


if __name__ == "__main__":
    main()
