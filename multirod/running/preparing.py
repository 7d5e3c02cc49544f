"""Having the kernels of a scene compiled before they are needed: by doing what will be done, all of it at once."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from math import prod
from operator import attrgetter, methodcaller
from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.batch import SHORTEST_PART, IntArray
from multirod.inputs import Inputs
from multirod.kernels.compiling import COMPILER
from multirod.naming import unknown_names
from multirod.results.scene import Scene
from multirod.results.solution import Solution
from multirod.running.progress import Watch
from multirod.running.simulation import as_solver, simulate, solve
from multirod.running.tracker import Tracker
from multirod.solver import Outcome, Solver
from multirod.status import Status
from multirod.validation import boolean, device_name, some_names

SAMPLES = 3  # of a motion: the first is a cold start, the next follow it
STEP = 0.005  # between them [s]


def prepare(
    robot: Assembly,
    inputs: Inputs | None,
    *,
    solver: Solver | None,
    shape: bool,
    jacobian: str | Iterable[str],
    stability: bool,
    motion: bool,
    device: str,
    progress: bool | Callable[[int], Any],
) -> int:
    """What ``Assembly.compile`` says.

    Nothing tells beforehand which kernels a solve comes to, so it is done. What will be asked of its result is asked of a
    stand-in at the same time, for its kernels to be compiled beside those of the solve, and of the result itself in the end.
    """
    method = as_solver(robot, solver)
    device = device_name("compile(device)", device)
    inputs = robot.accept(inputs)
    for name, value in (("shape", shape), ("stability", stability), ("motion", motion)):
        boolean(f"compile({name})", value)
    names = some_names("compile(jacobian)", jacobian)
    unknown_names("compile(jacobian)", names, (spec.name for spec in robot.input_specs))
    questions: list[Callable[[Solution], Any]] = [methodcaller("jacobian", name) for name in names]
    if shape:
        questions.append(methodcaller("rod", 0))
    if stability:
        questions.append(attrgetter("stability"))
    first = inputs[0] if motion and inputs.batch_shape and inputs.batch_shape[0] else inputs
    batch_shape = np.broadcast_shapes(first.batch_shape, robot.batch_shape)
    if 0 in batch_shape:
        return 0
    some = np.arange(min(prod(batch_shape), SHORTEST_PART)) if batch_shape else None
    before = COMPILER.compiled
    with Watch("compiling", 0, progress) as watch, COMPILER.listening(watch.count), ThreadPoolExecutor() as pool:
        stand_in, tested = _stand_in(robot, first, method, device, some)
        beside: list[Callable[[Solution], Any]] = [*questions, attrgetter("stability")] if tested else questions
        for question in beside:
            pool.submit(_rehearse, question, stand_in())
        followed = pool.submit(_follow, robot, inputs, method, device, names) if motion else None
        solution = solve(robot, first, solver=method, device=device, instances=some, progress=False)
        for question in questions:
            question(solution)
        if followed is not None:
            followed.result()
    return COMPILER.compiled - before


def _stand_in(
    robot: Assembly, inputs: Inputs, solver: Solver, device: str, instances: IntArray | None
) -> tuple[Callable[[], Solution], bool]:
    """Solutions in the place of one, with zeros for unknowns; and whether a solve tests its result for stability."""
    problem = robot.problem(
        inputs,
        integrator=solver.integrator,
        pose_sensitivities=solver.pose_sensitivities,
        direction_count=solver.direction_count,
        device=device,
        instances=instances,
    )
    fields, width = problem.fields_found
    count = problem.instance_count
    shape = () if instances is None else instances.shape
    scene = Scene(robot, shape, solver.integrator, device, fields)

    def make() -> Solution:
        outcome = Outcome.zeros(count)
        outcome.status[:] = Status.CONVERGED
        records = np.zeros((count, width))
        return Solution(scene, records, outcome, inputs, instances)

    return make, problem.result_test is not None


def _rehearse(question: Callable[[Solution], Any], solution: Solution) -> None:
    # of no equilibrium the answer may be anything; what cannot be compiled is said where the question is asked in earnest
    with np.errstate(all="ignore"), suppress(Exception):
        question(solution)


def _follow(robot: Assembly, inputs: Inputs, solver: Solver, device: str, names: Sequence[str]) -> None:
    few = inputs[:SAMPLES] if inputs.batch_shape else inputs
    samples = few.batch_shape[0] if few.batch_shape and few.batch_shape[0] > 1 else SAMPLES
    simulate(robot, few, time=STEP * np.arange(samples), solver=solver, device=device, progress=False)
    if set(few.given) - set(few.active):
        # loads that are zero now: a motion of such has other kernels than a loop that is given them
        sample = Tracker(robot, solver=solver, dt=STEP, inputs=few[0] if few.batch_shape else few, device=device).step()
        for name in names:
            sample.jacobian(name)
