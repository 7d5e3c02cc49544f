"""What a result was computed of: all that its samples have in common."""

from collections.abc import Callable
from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING, Any, Generic

import numpy as np

from multirod.assembly import Assembly, Robot_co
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.problem import BoundaryProblem
from multirod.results.telling import Telling
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.studies.terms.simplify import Dropped


@dataclass(frozen=True)
class Scene(Generic[Robot_co]):
    """What the samples of one problem have in common.

    Attributes:
        assembly: The robot.
        batch_shape: Leading axes of the results.
        integrator: Of the spatial equations.
        device: Warp device.
        fields: Where the fields of a record stand.
        unpack: Inputs from their rows, where the records hold them.
        threads: That share what is computed later.
        dropped: The terms that were left out of the robot and inputs that were given.
        telling: What samples of a loop ask for derivatives that they do not carry.
    """

    assembly: Robot_co
    batch_shape: tuple[int, ...]
    integrator: Integrator
    device: str
    fields: dict[str, slice]
    unpack: Callable[[FloatArray], Inputs] | None = None
    threads: int = 1
    dropped: tuple["Dropped", ...] = ()
    telling: Telling | None = None


def stand_in(robot: Assembly, inputs: Inputs, **options: Any) -> BoundaryProblem:  # noqa: ANN401  (of the robot's own ``problem``)
    """A problem of some instances in the place of one of none: what is empty has its shapes."""
    if prod(np.broadcast_shapes(inputs.batch_shape, robot.batch_shape)):
        return robot.problem(inputs, instances=np.zeros(1, dtype=np.intp), **options)
    zeros = {name: np.zeros(array.shape[-1]) for name, array in inputs.arrays.items()}
    return robot.problem(inputs.with_arrays(zeros), **options)
