"""What derivatives cost against the integrations, samples and solves they belong to; ``docs/derivatives.md`` has the table.

    OMP_NUM_THREADS=1 python tests/benchmarks/derivatives.py [--jax] [--torch]

Medians of the processor's time, of runs that take turns, so that another load on the machine falls on all. That of a batch is
what all cores take together. Each line says how many integrations of one rod a bare C loop does in that time, which takes turns
with them too.
"""

import argparse
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from single_rod import c_loop

import multirod as mr

SOLVER = mr.Shooting(integrator=mr.RK4(50))
FORCE = (0.05, 0.1, 0.1)
LOOP = "C loop"
LOOPS = 10  # times that it takes its turn

Floor = Callable[[], float] | None


def interleaved(runs: dict[str, Callable[[], object]], floor: Floor, count: int = 200) -> dict[str, float]:
    """Median of the processor's time of each [s]; of an integration of the bare C loop too, NaN without a C compiler."""
    for run in runs.values():
        for _ in range(3):
            run()
    times: dict[str, list[float]] = {name: [] for name in runs}
    loops = [np.nan] if floor is None else []
    for turn in range(count):
        if floor is not None and turn % max(1, count // LOOPS) == 0:
            loops.append(1e-6 * floor())
        for name, run in runs.items():
            begin = process_time()
            run()
            times[name].append(process_time() - begin)
    return {name: float(np.median(values)) for name, values in (times | {LOOP: loops}).items()}


def tubes(*, curved_all_along: bool = False) -> mr.ConcentricTubes:
    """Three, straight but for their ends, or curved all along."""
    own = [(0.4, 0.1, 14, 0.004), (0.28, 0.08, 6, 0.02), (0.2, 0.07, 4, 0.1)]
    return mr.ConcentricTubes(
        [
            mr.Rod(
                length=length,
                bending_stiffness=EI,
                torsional_stiffness=0.77 * EI,
                precurvature=(0, curvature / 3, 0)
                if curved_all_along
                else [(length - curved, (0, 0, 0)), (curved, (0, curvature, 0))],
            )
            for length, curved, curvature, EI in own
        ]
    )


def wire() -> mr.SingleRod:
    """The rod of the observer's paper."""
    return mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814, precurvature=(14, 5, 0)))


SLID = {"rotation": (-1.2, -0.4, 0.1), "translation": (-0.16, -0.13, -0.1), "tip_force": FORCE}
SCENES = {
    "three loaded tubes, straight but for their ends": (tubes(), SLID, ("precurvature",)),
    "three loaded tubes": (tubes(curved_all_along=True), SLID, ("precurvature", "length", "torsional_stiffness")),
    "the paper's rod": (wire(), {"rotation": 0.3, "tip_force": FORCE}, ("precurvature",)),
}


def row(what: str, time: float, loop: float, **against: float) -> None:
    """One line; ``loop`` is an integration of the bare C loop."""
    ratios = ", ".join(f"{time / other:.2f} {name}" for name, other in ({"C loops": loop} | against).items())
    print(f"{what:<84} {1e6 * time:9.1f} us   {ratios}", flush=True)


def of_scene(
    name: str, robot: mr.SingleRod | mr.ConcentricTubes, values: dict[str, object], design: tuple[str, ...], floor: Floor
) -> None:
    """Derivatives, shapes, samples and solves of one robot."""
    inputs = robot.inputs(**values)
    solution = mr.solve(robot, inputs, solver=SOLVER)
    tracker = mr.Tracker(robot, dt=1e-3, solver=SOLVER, inputs=inputs)
    tracker.step()
    plain = tracker.step()
    carrying = mr.Tracker(robot, dt=1e-3, solver=SOLVER, inputs=inputs, jacobian=("rotation", "tip_force"))
    for _ in range(2):
        sample = carrying.step()
    problem = robot.problem(inputs, integrator=SOLVER.integrator, pose_sensitivities=True)
    problem.write("unknowns", problem.adopt(solution.unknowns[None]))
    count = sum(map(robot.column_count, design))
    designed = robot.problem(inputs, integrator=SOLVER.integrator, pose_sensitivities=True, **robot.input_directions(*design))
    designed.write("unknowns", designed.adopt(solution.unknowns[None]))
    designed.eliminates = True
    designed.aim(*design)
    cost = interleaved(
        {
            "integration": problem.integrate,
            "designed": designed.integrate,
            "jacobian": lambda: solution.jacobian(*design),
            "by inputs": lambda: solution.jacobian("rotation", "tip_force"),
            "shape": lambda: solution[()].rod(0),
            "stability": lambda: solution[()].stability,
            "step": lambda: tracker.step(rotation=values["rotation"]),
            "carrying": lambda: carrying.step(rotation=values["rotation"]),
            "of a sample": lambda: sample.jacobian("rotation", "tip_force"),
            "of a plain sample": lambda: plain.jacobian("rotation", "tip_force"),
            "solve": lambda: mr.solve(robot, inputs, solver=SOLVER),
        },
        floor,
    )
    own = partial(row, loop=cost[LOOP])
    assert sample._columns is not None
    print(f"\n{name}")
    own("an integration with Gamma and the pose's columns", cost["integration"])
    own(f"the same with {count} columns by {', '.join(design)}", cost["designed"], integrations=cost["integration"])
    own(f"solution.jacobian by these {count}", cost["jacobian"], integrations=cost["integration"])
    own("Tracker.step(rotation=...), the inputs as they were", cost["step"], integrations=cost["integration"])
    own('the same of Tracker(jacobian=("rotation", "tip_force"))', cost["carrying"], steps=cost["step"])
    own('jacobian("rotation", "tip_force") of its sample', cost["of a sample"], steps=cost["step"])
    own("the same of a sample of the other, by an integration of its own", cost["of a plain sample"], steps=cost["step"])
    own('solution.jacobian("rotation", "tip_force")', cost["by inputs"], steps=cost["step"], solves=cost["solve"])
    own("solution.rod(0)", cost["shape"], steps=cost["step"], solves=cost["solve"])
    own("solution.stability", cost["stability"], steps=cost["step"], solves=cost["solve"])
    own("mr.solve from nothing", cost["solve"], steps=cost["step"])


Batch = Callable[[np.ndarray], object]


def by_jax(robot: mr.ConcentricTubes, **options: Any) -> tuple[Batch, Batch]:
    """Values of a batch, and gradients."""
    import jax

    tip = mr.jax.function(robot, **options)

    def loss(u: Any) -> Any:
        return (tip(precurvature=u) ** 2).sum()

    value, slope = jax.jit(loss), jax.jit(jax.grad(loss))

    def ready(call: Any, u: np.ndarray) -> object:
        with jax.enable_x64(True):
            return call(u).block_until_ready()

    return partial(ready, value), partial(ready, slope)


def by_torch(robot: mr.ConcentricTubes, **options: Any) -> tuple[Batch, Batch]:
    """The same."""
    import torch

    layer = mr.torch.Layer(robot, **options)

    def value(u: np.ndarray) -> object:
        return (layer(precurvature=torch.from_numpy(u)) ** 2).sum()

    def slope(u: np.ndarray) -> object:
        tensor = torch.from_numpy(u).requires_grad_()
        (layer(precurvature=tensor) ** 2).sum().backward()
        return tensor.grad

    return value, slope


def of_batches(name: str, make: Callable[..., tuple[Batch, Batch]], floor: Floor, count: int = 500) -> None:
    """A gradient by 18 numbers of precurvature, of a batch."""
    robot, values, _ = next(iter(SCENES.values()))
    inputs = robot.inputs(**values)
    print(f"\n{name}, three loaded tubes, a batch of {count}, each")
    nominal = mr.solve(robot, inputs, solver=SOLVER)
    own = np.array([[section.precurvature for section in rod.sections] for rod in robot.rods])
    curves = own * (1 + 0.05 * np.random.default_rng(0).standard_normal((count, 1, 1, 1)))
    for said, guess in (("from nothing", None), ("from the equilibrium of their mean", nominal)):
        value, slope = make(robot, inputs=inputs, solver=SOLVER, guess=guess)
        cost = interleaved({"value": partial(value, curves), "slope": partial(slope, curves)}, floor, 10)
        row(f"value, {said}", cost["value"] / count, cost[LOOP])
        row(
            "gradient by 18 numbers of precurvature, with the value",
            cost["slope"] / count,
            cost[LOOP],
            values=cost["value"] / count,
        )


def main() -> None:
    """All of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jax", action="store_true", help="gradients through JAX too")
    parser.add_argument("--torch", action="store_true", help="gradients through PyTorch too")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        floor = c_loop(Path(folder), repeats=200)
        for name, (robot, values, design) in SCENES.items():
            of_scene(name, robot, values, design, floor)
        for name, make in (("jax", by_jax), ("torch", by_torch)):
            if getattr(arguments, name):
                of_batches(name, make, floor)


if __name__ == "__main__":
    main()
