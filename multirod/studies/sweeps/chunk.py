"""Solving one chunk, wherever an executor takes it."""

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.results.events import BranchEvent
from multirod.results.solution import Solution
from multirod.running.simulation import solve
from multirod.solver import Solver
from multirod.studies.sweeps.table import Arrays

RESULTS = (
    "status",
    "residual",
    "iterations",
    "integrations",
    "tip_position",
    "tip_rotation",
    "unknowns",
)
FURTHER = (
    "boundary_residual",
    "condition",
    "determinant",
    "energy",
    "event_count",
    "event_load_factor",
    "gamma",
    "index",
    "load_factor",
    "potential",
    "smallest_singular_value",
    "stability",
    "stability_margin",
    "stiffness",
    "tip_error",
)
OF_EVENTS: dict[str, Callable[[tuple[BranchEvent, ...]], float]] = {
    "event_count": len,
    "event_load_factor": lambda events: events[0].load_factor if events else np.nan,
}


class Settings(TypedDict):
    """What all chunks of a study have in common."""

    solver: Solver
    options: dict[str, Any]
    quantities: tuple[str, ...]


@dataclass(frozen=True)
class Chunk:
    """What it takes to solve some instances of a study.

    Attributes:
        robot: The assembly.
        inputs: Of these instances only, a batch of one axis; of all of them where ``instances`` says which.
        instances: Flat indices into the batch where the rods vary with it too, else None.
        solver: How.
        options: Further keywords of ``solve``.
        quantities: Of the solution, that are kept.
    """

    robot: Assembly
    inputs: Inputs
    instances: NDArray[np.intp] | None
    solver: Solver
    options: dict[str, Any]
    quantities: tuple[str, ...]

    @classmethod
    def of(
        cls,
        robot: Assembly,
        inputs: Inputs,
        batch_shape: tuple[int, ...],
        instances: NDArray[np.intp],
        **settings: Unpack[Settings],
    ) -> "Chunk":
        """Some instances of a study: only their inputs travel, unless the rods vary too."""
        if robot.batch_shape:
            return cls(robot, inputs, instances, **settings)
        return cls(robot, inputs.take(batch_shape, instances), None, **settings)

    def run(self) -> Arrays:
        """Solve, and return the quantities by name, each of shape (instance, ...)."""
        options = self.options if self.instances is None else {**self.options, "instances": self.instances}
        solution = solve(self.robot, self.inputs, solver=self.solver, progress=False, **options)
        return {name: _taken(solution, name) for name in self.quantities}


def _taken(solution: Solution[Any], name: str) -> NDArray[Any]:
    if name in OF_EVENTS:
        return np.array([OF_EVENTS[name](events) for events in np.asarray(solution.events)])
    return np.asarray(getattr(solution, name))


@dataclass(frozen=True)
class Raised:
    """An exception that solving a chunk raised: the chunk's own, not of what carried it."""

    error: Exception


def run(chunk: Chunk) -> Arrays | Raised:
    """Run a chunk in an executor. What this raises, or the executor in its place, is not the chunk's doing."""
    try:
        return chunk.run()
    except Exception as error:  # noqa: BLE001  (whatever it is, the driver raises it)
        error.add_note(traceback.format_exc())  # a traceback does not travel between processes
        return Raised(error)
