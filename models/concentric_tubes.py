"""Concentric tubes: one backbone, all tubes share its bending."""

from collections.abc import Sequence
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np

from multirod.inputs import Inputs
from multirod.models.backbone import BackboneAssembly
from multirod.rod import Rod
from multirod.validation import refuse


class ConcentricTubes(BackboneAssembly):
    """Tubes inside each other, each turned and pushed at its own base behind a plate, at the assembly's base.

    Tube ``i`` starts at ``translation[i] <= 0`` behind the plate, where it is straight and free to twist, and ends at
    ``length + translation[i]``. Bending is shared; every tube has its own twist. Loads act on the innermost tube.

    Args:
        tubes: Innermost first, 1 to 6.
        base: Pose of the plate in the world, shape (..., 4, 4); the identity by default.

    Raises:
        ValueError: If tubes do not nest (where diameters are given), or shear, or ``base`` is not a pose.
        TypeError: If ``tubes`` are not ``Rod`` objects.
    """

    transmission = True

    def __init__(self, tubes: Sequence[Rod], *, base: Any = None) -> None:
        if not isinstance(tubes, (list, tuple)) or not all(isinstance(tube, Rod) for tube in tubes):
            raise TypeError("ConcentricTubes takes a list of Rod, innermost first")
        if not 1 <= len(tubes) <= 6:
            refuse("ConcentricTubes.tubes", f"{len(tubes)} tubes", "must be 1 to 6")
        for k, (inner, outer) in enumerate(pairwise(tubes)):
            around, within = outer.inner_diameter, inner.outer_diameter
            if around is not None and within is not None and within > around:
                refuse(
                    f"ConcentricTubes.tubes[{k}].outer_diameter",
                    within,
                    f"must be <= the inner diameter of tubes[{k + 1}], {around:g} m",
                )
        for k, tube in enumerate(tubes):
            if any(np.isfinite(s.shear_stiffness).any() or np.isfinite(s.axial_stiffness).any() for s in tube.sections):
                refuse(f"ConcentricTubes.tubes[{k}]", tube, "shear_stiffness and axial_stiffness must be inf")
        super().__init__(tuple(tubes), base)

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        super().check(inputs)
        beta = inputs.translation
        tip = np.stack(np.broadcast_arrays(*(tube.length + beta[..., k] for k, tube in enumerate(self.rods))), axis=-1)
        for k in range(self.rod_count):
            if np.any(beta[..., k] > 0):
                refuse(f"translation[{k}]", float(beta[..., k].max()), "must be <= 0: a tube starts behind the plate")
            if np.any(tip[..., k] <= 0):
                limit = -float(np.min(self.rods[k].length))
                refuse(
                    f"translation[{k}]",
                    float(beta[..., k].min()),
                    f"must be > -length = {limit:g} m: the tube is pulled out of the plate",
                )
        for k in range(self.rod_count - 1):
            if np.any(beta[..., k] > beta[..., k + 1] + 1e-12):
                refuse(
                    f"translation[{k}]",
                    float(beta[..., k].max()),
                    f"must be <= translation[{k + 1}]: inner tubes start further back",
                )

    def bounds(self, name: str) -> tuple[float, float]:  # noqa: D102
        shortest = min(float(np.min(tube.length)) for tube in self.rods)
        return (-shortest, 0.0) if name == "translation" else (-inf, inf)

    def __repr__(self) -> str:
        return f"ConcentricTubes({list(self.rods)!r})"
