"""How rods turn more behind the plate as their numbers change. Numbers in parentheses: ``docs/derivatives.md``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.launch import record
from multirod.models.backbone.derivatives.behind_plate_kernels import (
    ALONE,
    NOTHING,
    OWN,
    SUM,
    BehindPlateArrays,
    turn_behind_plate,
)
from multirod.models.backbone.units import unit_stiffness
from multirod.types import WarpArray
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.derivatives.designs import Designs
    from multirod.models.backbone.problem import BackboneProblem


class BehindPlate:
    """(D8) How rods turn more behind the plate, at the torques that they have: as if they were turned at their bases.

    What varies with inputs and unknowns is found in a kernel, for the numbers of all parameters together.

    Args:
        problem: Of the rods.
        designs: Of these parameters, one after another.
        places: Where the directions along their numbers stand; by default from the first on.
        directions: Those of the problem, in which it is written; by default in an array for the angles alone.
    """

    def __init__(
        self,
        problem: "BackboneProblem",
        designs: Sequence["Designs"],
        places: NDArray[np.intp] | None = None,
        directions: WarpArray | None = None,
    ) -> None:
        device, arrays, features = problem.device, problem.arrays, problem.features
        parts = [np.concatenate(list(own), axis=1) for own in zip(*map(_weights, designs), strict=True)]
        weights = np.concatenate(parts, axis=-1)  # (b, direction, rod, piece, quantity)
        weights = np.moveaxis(weights.reshape(*weights.shape[:3], -1), 1, 2)
        terms: Any = BehindPlateArrays()
        for name, values in {
            "end": arrays.end,
            "material": arrays.material,
            "precurvature": arrays.precurvature,
            "rest": arrays.precurvature[:, 0, 0, 2],
            "unit": unit_stiffness(arrays.material[:, :, 0])[..., 2],
            "weights": weights,
        }.items():
            setattr(terms, name, wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=device))
        count, rods = weights.shape[2], weights.shape[1]
        places = np.arange(count) if places is None else places
        terms.places = wp.array(places.astype(np.int32), dtype=wp.int32, device=device)
        terms.rotation, terms.translation = (problem.input_slice(name).start for name in ("rotation", "translation"))
        self._turns: Any = directions
        if directions is None:
            terms.rotation = 0
            self._turns = wp.zeros((problem.instance_count, count, rods), dtype=wp.float64, device=device)
        terms.torques = problem.slots.places["torques"].start
        terms.first = features.rod_count - features.torque_count
        terms.torsion = NOTHING
        if not features.turning_count:
            terms.torsion = ALONE
        elif features.torque_count and not features.eccentric:
            terms.torsion = OWN if features.moment else SUM
        arguments = [terms, problem.unknowns, problem.inputs, self._turns]
        self._launch = record(turn_behind_plate, problem.instance_count, arguments, device)

    def turn(self) -> None:
        """Write it, at the inputs and unknowns that the problem has now."""
        self._launch.launch()

    def turns(self) -> FloatArray:
        """Angles by each number, of each rod, shape (instance_count, direction, rod); to be read at once."""
        self.turn()
        return np.asarray(self._turns.numpy())


def _weights(designs: "Designs") -> tuple[FloatArray, ...]:
    """What multiplies the quantities that the kernel finds, each (b, direction, rod, piece, quantity): the integrals of powers,
    the angle by torque, what is at the end, at the beginning, and what slides."""
    twisting = designs.precurvature.reshape(*designs.precurvature.shape[:4], -1, 3)[..., 2]
    before = np.zeros_like(designs.end)
    before[..., 1:] = -designs.end[..., :-1]
    return twisting, designs.softness[..., 2:], designs.end[..., None], before[..., None], -designs.shift[..., None]
