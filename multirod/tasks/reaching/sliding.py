"""Along limits of the shape, where a search stops before them. Numbers in parentheses: ``docs/tasks.md``."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.results.solution import Solution
from multirod.running.simulation import solve
from multirod.solver import Solver
from multirod.tasks.controlling.command import Command
from multirod.tasks.controlling.controller import Controller
from multirod.tasks.freed import values_of
from multirod.tasks.limits import Limits
from multirod.tasks.rows import PoseRows
from multirod.validation import FloatArray

PATIENCE = 4  # samples, which are to bring the tip nearer
NEARER = 1e-3  # by this part of what is left, or it has come to rest


@dataclass(frozen=True)
class Slid:
    """Where that leads.

    Attributes:
        unknowns: An equilibrium's to first order, shape (n,).
        values: Of freed inputs, shape (k,).
        at_limit: Which of them take part in a limit that holds there, shape (k,).
        held_by: Names of these limits.
    """

    unknowns: FloatArray
    values: FloatArray
    at_limit: NDArray[np.bool_]
    held_by: tuple[str, ...]


def slid(
    robot: Assembly,
    target: PoseRows,
    inputs: Inputs,
    unknowns: FloatArray,
    *,
    free: Sequence[str],
    limits: Limits,
    solver: Solver,
    device: str,
    tolerance: float,
    max_integrations: int,
) -> tuple[Slid | None, int]:
    """Where a controller whose target stands still takes the tip, along limits of the shape (18).

    Args:
        robot: Without leading axes.
        target: Of one instance.
        inputs: Where it begins: within limits, and stable.
        unknowns: The equilibrium there, shape (n,).
        free: Names of freed inputs.
        limits: Of what is free, and of the shape.
        solver: Its integrator is that of the controller.
        device: Warp device.
        tolerance: Of the target's rows.
        max_integrations: From which on no other sample is begun.

    Returns:
        What is there, None if there is no way; integrations that were taken.
    """
    start = solve(robot, inputs, solver=solver, guess=unknowns, device=device, progress=False)
    spent, left = int(start.integrations), [np.inf] * PATIENCE
    last: Command | None = None
    if not start.failed:
        loop = _loop(robot, start, free, limits, solver, device)
        goal = {name: getattr(target, name)[0] for name in target.given}
        while loop is not None and spent < max_integrations:
            command = loop.step(**goal)
            spent += int(command.integrations)
            if command.failed:
                break
            last = command
            left.append(float(np.linalg.norm(np.nan_to_num([command.target_error, command.target_angle]) * target.weight)))
            there = max(left[-2:]) <= tolerance  # twice: what is foreseen is off by the second order of the step
            if there or left[-1] > (1 - NEARER) * left[-1 - PATIENCE]:
                break
    if last is None:
        return None, spent
    return Slid(last.unknowns, values_of(last.inputs, free), last.at_limit, last.held_by), spent


def _loop(
    robot: Assembly, start: Solution, free: Sequence[str], limits: Limits, solver: Solver, device: str
) -> Controller | None:
    """The controller; None where it refuses the start, which may be as near to a limit as rounding."""
    settings: dict[str, Any] = {"free": free, "limits": limits, "integrator": solver.integrator, "device": device}
    try:
        return Controller(robot, dt=1.0, prefer="smallest motion", guess=start, **settings)
    except ValueError:
        return None
