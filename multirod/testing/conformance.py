"""Whether an assembly keeps the contract that solvers and results count on."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs, InputSpec
from multirod.integrators import RK45
from multirod.problem import BoundaryProblem
from multirod.running.simulation import solve
from multirod.solver import registered_solvers
from multirod.solvers.shooting import Shooting
from multirod.stability import Stability
from multirod.status import Status
from multirod.testing.derivatives import derivatives, input_derivatives, jacobian
from multirod.testing.study import ALIKE, INTEGRATED, TIGHT, Nonconformance, Study, same, shape
from multirod.validation import FloatArray, instance

LOAD_UNITS = ("N", "N m", "N/m", "Pa", "m/s^2", "T")
STATE = ("records", "active", "load_factor", "order", "directions")


def check_assembly(
    robot: Assembly,
    inputs: Inputs | None = None,
    *,
    vary: Sequence[str] | None = None,
    tip_rod: int | None = 0,
    solvers: Sequence[str] | None = None,
) -> None:
    """Check that an assembly keeps the contract at some inputs, by numbers: derivatives, batches, load factor, solvers, shapes,
    energy.

    It solves the scene some tens of times, and takes as long as compiling its kernels does the first time.

    Args:
        robot: The assembly, without leading axes.
        inputs: Made by ``robot.inputs(...)``, without leading axes: loads that bend it well, far from any fold. None are all
            zero.
        vary: Inputs by which derivatives are checked; by default those that were given, and are no functions of arclength.
        tip_rod: The rod that ends at the end effector; None where none does, as for a platform.
        solvers: Names of registered solvers; all by default. A solver that refuses the problem, or says that it failed, is no
            error, but for ``shooting``.

    Raises:
        Nonconformance: If a check failed; the message lists all that did.
        TypeError, ValueError: If an argument is not what it must be.
    """
    instance("robot", robot, Assembly, "an Assembly")
    inputs = robot.accept(inputs)
    if np.broadcast_shapes(inputs.batch_shape, robot.batch_shape):
        raise ValueError("check_assembly takes one instance: neither the robot nor its inputs may have leading axes")
    registered = registered_solvers()
    chosen = {name: registered[name]() for name in (registered if solvers is None else solvers)}
    names = list(inputs.arrays) if vary is None else vary
    study = Study(robot, inputs, tuple(names), tip_rod, chosen)
    found: list[str] = []
    for name, check in CHECKS.items():
        with _recorded(name, found):
            check(study)
    if found:
        raise Nonconformance(f"{type(robot).__name__} breaks the contract:\n- " + "\n- ".join(found))


@contextmanager
def _recorded(name: str, found: list[str]) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # noqa: BLE001  (whatever it is, the other checks go on)
        kind = "" if isinstance(error, Nonconformance) else f"{type(error).__name__}: "
        found.append(f"{name}: {kind}{error}")


def _inputs(study: Study) -> None:
    """Specs have names of their own, and places of their own in a row, which ``pack`` fills."""
    specs = study.robot.input_specs
    names = [spec.name for spec in specs]
    if len(set(names)) < len(names):
        raise Nonconformance(f"input_specs names an input twice: {names}")
    for spec in specs:
        if (spec.unit in LOAD_UNITS) != (spec.load is not None):
            raise Nonconformance(
                f"{spec.name} is in {spec.unit}, but its load is {spec.load!r}: it must say 'force' or 'moment' if it is one"
            )
    problem = study.problem()
    taken = np.zeros(problem.input_count, dtype=int)
    for spec in specs:
        place, size = problem.input_slice(spec.name), spec.size(study.robot.rod_count)
        if place.stop - place.start != size or place.start < 0 or place.stop > problem.input_count:
            raise Nonconformance(f"input_slice({spec.name!r}) is {place}: it must hold {size} of {problem.input_count} numbers")
        taken[place] += 1
    if taken.max(initial=0) > 1:
        raise Nonconformance(f"two inputs share numbers {np.flatnonzero(taken > 1).tolist()} of a row")
    row = problem.pack(study.inputs)[0]
    for name in study.inputs.given:
        if name not in study.inputs.profiles:
            same(f"pack(inputs) at {name}", row[problem.input_slice(name)], getattr(study.inputs, name), 0.0)
    same("the problem's row of inputs", problem.read("inputs")[0], row, 0.0)


def _blocks(study: Study) -> None:
    """Every unknown and every residual belongs to one block, and a block has as many of both."""
    problem = study.problem()
    n = problem.unknown_count
    for what in ("unknowns", "residuals"):
        places = [np.arange(n)[getattr(block, what)] for block in problem.blocks]
        if sorted(np.concatenate(places).tolist()) != list(range(n)):
            raise Nonconformance(f"the blocks hold the {what} {[place.tolist() for place in places]}: each of {n} must be in one")
    for block in problem.blocks:
        sizes = [len(np.arange(n)[part]) for part in (block.unknowns, block.residuals)]
        if sizes[0] != sizes[1]:
            raise Nonconformance(f"block {block.name!r} has {sizes[0]} unknowns but {sizes[1]} residuals")


def _guess(study: Study) -> None:
    """Where the load factor is 0, ``guess()`` is an equilibrium; ``evaluate`` there leaves it so."""
    problem = study.problem()
    x = problem.guess()
    shape("guess()", x, (1, problem.unknown_count))
    with problem.at_load(0.0):
        residual, _ = problem.evaluate(x)
    limit = float(problem.tolerance(None)[0])
    if not np.abs(residual).max() <= limit:
        raise Nonconformance(
            f"at a load_factor of 0 the residual of guess() is {np.abs(residual).max():.3g} 1/m, more than {limit:.1g}"
        )


def _batches(study: Study) -> None:
    """An instance of a batch is what it is alone, also where ``instances`` asks for it; leaving others out leaves them as they
    are."""
    x, count = study.near, len(study.near)
    problem = study.problem(study.repeated(count))
    residual, gamma = problem.evaluate(x)
    position = problem.read("position")
    for k in range(count):
        alone = study.problem()
        r, g = alone.evaluate(x[k][None])
        for what, one, many in (("residual", r, residual), ("Gamma", g, gamma), ("position", alone.read("position"), position)):
            same(f"the {what} of instance {k} of a batch, against it alone", many[k], one[0], ALIKE)
    part = study.problem(study.repeated(count), instances=np.array([1]))
    same("the residual of instances=[1]", part.evaluate(x[1][None])[0][0], residual[1], ALIKE)
    before = problem.snapshot()
    chosen = np.array([True, False, False])
    with problem.only(chosen):
        problem.write("unknowns", x[::-1])
        problem.integrate()
    problem.write("unknowns", x)
    after = problem.snapshot()
    same("what is not active, after an integration", after[1:], before[1:], 0.0)
    _batch_failure(study, problem, x, residual)


def _batch_failure(study: Study, problem: BoundaryProblem, x: FloatArray, residual: FloatArray) -> None:
    """Unknowns that are not finite have no residual, and are nobody else's matter."""
    broken = x.copy()
    broken[0] = np.nan
    found, gamma = problem.evaluate(broken)
    if np.isfinite(found[0]).all() or np.isfinite(gamma[0]).all():
        raise Nonconformance("unknowns that are NaN have a finite residual or Gamma")
    same("the residual of an instance beside one that fails", found[1:], residual[1:], ALIKE)


def _questions(study: Study) -> None:
    """Asking changes nothing: buffers, active instances and load factors are as they were."""
    problem = study.problem(pose_sensitivities=True, direction_count=1)
    problem.evaluate(study.near[:1])
    questions: dict[str, Callable[[], Any]] = {
        "natural_singular_value": lambda: problem.natural_singular_value,
        "curvature_scale": problem.curvature_scale,
        "load_scale": problem.load_scale,
        "turning": problem.turning,
        "mode_bounds": problem.mode_bounds,
        "guess": problem.guess,
    }
    stability, shapes, starts = problem.stability, problem.shapes, problem.starts
    if stability is not None:
        questions |= {"stability.modes": stability.modes, "stability.potential": stability.potential}
        questions["stability.has_potential"] = lambda: stability.has_potential
    if shapes is not None:
        questions["shapes.at_nodes"] = lambda: shapes.at_nodes(5)
    if starts is not None:
        questions["starts.guesses"] = lambda: starts.guesses(2)
    for name, ask in questions.items():
        before = {field: np.array(getattr(problem, field).numpy()) for field in STATE}
        ask()
        for field, values in before.items():
            if not np.array_equal(getattr(problem, field).numpy(), values, equal_nan=True):
                raise Nonconformance(f"asking for {name} changes {field}")


def _solvers(study: Study) -> None:
    """Every solver finds the equilibrium that ``shooting`` finds, to what its residual allows, or says that it failed."""
    robot, inputs = study.robot, study.inputs
    truth = solve(robot, inputs, solver=Shooting(tolerance=TIGHT, integrator=RK45())).raise_if_failed()
    for name, solver in study.solvers.items():
        problem = robot.problem(
            inputs,
            integrator=solver.integrator,
            pose_sensitivities=solver.pose_sensitivities,
            direction_count=solver.direction_count,
        )
        if solver.unsupported(problem):
            continue
        found = solve(robot, inputs, solver=solver)
        if name == "shooting":
            found.raise_if_failed()
        if Status(int(np.asarray(found.status))).failed:
            if np.isfinite(found.unknowns).any() or np.isfinite(found.tip_position).any():
                raise Nonconformance(f"{name} failed, but its result is not NaN")
            continue
        distance = float(np.linalg.norm(found.unknowns - truth.unknowns))
        left = np.linalg.norm(found.boundary_residual) + np.linalg.norm(truth.boundary_residual)
        # columns have a part in the control of steps: integrations of the same unknowns differ by their tolerance
        left = 3 * left + INTEGRATED * float(problem.curvature_scale()[0])
        allowed = float(left) / float(truth.smallest_singular_value)
        if not distance <= allowed:
            raise Nonconformance(
                f"{name} is {distance:.3g} 1/m from the equilibrium that shooting finds; allowed is {allowed:.1g}"
            )


def _shapes(study: Study) -> None:
    """A rod's last node is the end effector, and frames are rotations."""
    if study.problem().shapes is None:
        return
    length = max(float(np.max(rod.length)) for rod in study.robot.rods)
    for k in range(study.robot.rod_count):
        shape = study.solution.rod(k, nodes=9)
        turn = shape.rotation @ np.swapaxes(shape.rotation, -1, -2)
        same(f"R R^T of rod {k}", turn, np.broadcast_to(np.eye(3), turn.shape), 1e-8)
        if k == study.tip_rod:
            same(f"the end of rod {k}", shape.position[-1], study.solution.tip_position, 0.0, 1e-6 * length)
            same("its tangent", shape.rotation[-1, :, 2], study.solution.tip_rotation[:, 2], 0.0, 1e-5)


def _potential(study: Study) -> None:
    """A dead force on the tip does the work that the potential loses: dV/dF + p is the same at two forces.

    Not where the pose is given: drives that follow from it do work too.
    """
    specs = {spec.name for spec in study.robot.input_specs}
    if "tip_force" not in specs or "platform_position" in specs or not np.isfinite(study.solution.potential):
        return
    force = np.asarray(study.inputs.tip_force)
    step = 1e-3 * max(1e-2, float(np.abs(force).max()))
    sides = np.concatenate([np.eye(3), -np.eye(3)]) * step
    slopes, tips = [], []
    for shift in (0.0, 30.0):
        around = study.solve(study.changed("tip_force", sides + shift * step)).raise_if_failed()
        middle = study.solve(study.changed("tip_force", np.full((1, 3), shift * step))).raise_if_failed()
        slopes.append((around.potential[:3] - around.potential[3:]) / (2 * step))
        tips.append(middle.tip_position[0])
    length = max(float(np.max(rod.length)) for rod in study.robot.rods)
    same("the change of dV/d(tip_force)", slopes[1] - slopes[0], tips[0] - tips[1], 1e-3, 1e-6 * length)


def _stability(study: Study) -> None:
    """Between two equilibria, ``det Gamma`` changes sign with each unstable mode that comes or goes."""
    problem = study.problem()
    if problem.stability is None:
        return
    names = list(study.inputs.arrays)
    loads = [name for name in names if _specs(study)[name].load is not None]
    unloaded = study.solve(study.inputs.without([*loads, *study.inputs.profiles])).raise_if_failed()
    parity = []
    for solution in (unloaded, study.solution):
        if solution.stability in (Stability.UNKNOWN, Stability.FOLD) or solution.index < 0:
            return
        parity.append(np.sign(solution.determinant) * (-1.0) ** solution.index)
    if parity[0] != parity[1]:
        raise Nonconformance(
            f"the index is {unloaded.index} without loads and {study.solution.index} with them, "
            "but the sign of det Gamma says otherwise"
        )


def _specs(study: Study) -> dict[str, InputSpec]:
    return {spec.name: spec for spec in study.robot.input_specs}


CHECKS: dict[str, Callable[[Study], None]] = {
    "inputs": _inputs,
    "blocks": _blocks,
    "guess": _guess,
    "derivatives": derivatives,
    "derivatives by inputs": input_derivatives,
    "jacobian": jacobian,
    "batches": _batches,
    "questions": _questions,
    "solvers": _solvers,
    "shapes": _shapes,
    "potential": _potential,
    "stability": _stability,
}
