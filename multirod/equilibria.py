"""All equilibria of one robot at one set of inputs."""

from collections.abc import Iterator

import numpy as np

from multirod.assembly import Assembly
from multirod.critical_loads import natural_start, unloaded
from multirod.inputs import Inputs
from multirod.simulation import solve
from multirod.solution import Solution, SolveError
from multirod.solvers.multistart import ROUND, STARTS, Catalogue, converge, degrees, limits
from multirod.solvers.shooting import Shooting
from multirod.validation import Described, FloatArray, device_name, positive_int, refuse


def equilibria(
    robot: Assembly, inputs: Inputs | None = None, *, starts: int = STARTS, solver: Shooting | None = None, device: str = "cpu"
) -> Solution:
    """All equilibria that Newton's method finds from many starts, the one of lowest potential energy first.

    Starts cover all base moments and torques that an equilibrium can have (for parallel robots, poses of the platform), in rounds,
    until a round brings nothing new and the signs of ``determinant`` add up as they must (``docs/stability.md``). Then branches
    that cross the natural one as loads are raised are followed. That is no proof that none is missing.

    Args:
        robot: The assembly.
        inputs: Made by ``robot.inputs(...)``, without leading axes; none are all zero.
        starts: Starts at most.
        solver: ``Shooting()`` by default, of which the tolerance, the iteration limit and the integrator, in double precision, are used.
        device: Warp device.

    Returns:
        The equilibria, shape (k,): each with ``stability``, ``index``, ``potential``, ``condition`` and all that a solution
        has. Where loads have no potential (moments, follower loads), they are in the order of their elastic energy.

    Raises:
        SolveError: If none is found.
        TypeError, ValueError: If an argument is not what it must be, or the robot or its inputs have leading axes.
    """
    if not isinstance(robot, Assembly):
        raise TypeError(f"robot must be an assembly such as SingleRod(rod), not {type(robot).__name__}")
    method = Shooting() if solver is None else solver
    if not isinstance(method, Shooting):
        raise TypeError(f"solver: equilibria() needs Shooting(), not {type(method).__name__}")
    method = method.in_double()
    device = device_name("device", device)
    inputs = robot.accept(inputs)
    batch = np.broadcast_shapes(inputs.batch_shape, robot.batch_shape)
    if batch:
        refuse(
            "inputs", Described(f"leading axes {batch}"), "there must be none: ask for the equilibria of one instance at a time"
        )
    count = min(ROUND, positive_int("starts", starts))
    problem = robot.problem(_repeated(inputs, count), integrator=method.integrator, device=device)
    if not len(problem.starts(1)):
        raise TypeError(f"{type(robot).__name__} offers no starts: its problem has no starts()")
    limit = limits(problem.starts(ROUND)[:, :1])
    newton = method.newton(problem)
    catalogue = Catalogue(float(degrees(problem)[0]) if problem.signs_add_up else None)
    everyone = np.ones(count, dtype=bool)
    for first in range(0, starts, count):
        reached = converge(problem, newton, problem.starts(count, first)[:, 0], everyone, limit)
        unknowns, gamma = problem.read("unknowns"), problem.read("gamma").reshape(count, problem.unknown_count, -1)
        for k in np.flatnonzero(reached):
            catalogue.add(unknowns[k], gamma[k])
        catalogue.end_round()
        if catalogue.settled:
            break
    for chunk in _chunks(_connected(robot, inputs, method, device), count):
        reached = converge(problem, newton, chunk, everyone, np.inf)
        unknowns, gamma = problem.read("unknowns"), problem.read("gamma").reshape(count, problem.unknown_count, -1)
        for k in np.flatnonzero(reached):
            catalogue.add(unknowns[k], gamma[k])
    if not catalogue.unknowns:
        raise SolveError(f"no equilibrium was found from {starts} starts: raise starts, or loosen the solver's tolerance")
    inputs = _repeated(inputs, len(catalogue.unknowns))
    found = solve(robot, inputs, solver=method, guess=np.array(catalogue.unknowns), device=device)
    energy = found.potential if np.isfinite(found.potential).all() else found.energy
    return solve(robot, inputs, solver=method, guess=found.unknowns[np.argsort(energy, kind="stable")], device=device)


def _connected(robot: Assembly, inputs: Inputs, method: Shooting, device: str) -> list[FloatArray]:
    """Guesses on the natural branch and on those that cross it as loads are raised; none where no load acts."""
    begin = unloaded(robot, inputs)
    if not any(inputs.is_active(name) for name in set(inputs.given) - {n for n in begin.given if begin.is_active(n)}):
        return []
    try:
        branch, first = natural_start(robot, begin, inputs, method, device)
    except SolveError:
        return []
    return branch.connected(first, 1.0) if first.modes.known[0] else []


def _chunks(guesses: list[FloatArray], count: int) -> Iterator[FloatArray]:
    """Guesses as arrays (count, n), the last ones repeated."""
    for first in range(0, len(guesses), count):
        some = guesses[first : first + count]
        yield np.array(some + [some[-1]] * (count - len(some)))


def _repeated(inputs: Inputs, count: int) -> Inputs:
    """The same inputs for ``count`` instances."""
    names = {"rotation", *(name for name in inputs.given if name not in inputs.profiles)}
    values = {name: np.asarray(getattr(inputs, name)) for name in names}
    return inputs.with_arrays({name: np.broadcast_to(value, (count, value.shape[-1])) for name, value in values.items()})
