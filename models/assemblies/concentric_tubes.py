"""Concentric tubes: one backbone, all tubes share its bending."""

from collections.abc import Sequence
from functools import cached_property
from itertools import combinations
from math import inf
from typing import TYPE_CHECKING, Self, Unpack

import numpy as np
from numpy.typing import NDArray

from multirod import plausibility
from multirod.inputs import Inputs, InputSpec, InputSpecs
from multirod.models.assemblies.inputs import ConcentricTubesInput, ConcentricTubesInputs, listed
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.checks import surely_driven
from multirod.models.backbone.inputs import BY_MATERIAL, DRIVE_INPUTS, DRIVES, TUBE_INPUTS, drive_specs
from multirod.naming import hinted
from multirod.rod import Rod
from multirod.types import Poses
from multirod.validation import Described, FloatArray, at_first, refuse, sequence

SAME_PLACE = 1e-12  # [m]: bases this close are at the same place


class ConcentricTubes(BackboneAssembly):
    """Tubes inside each other, each turned and pushed at its own base behind a plate, at the assembly's base.

    Tube ``i`` starts at ``translation[i] <= 0`` behind the plate, where it is straightened but twists freely, and ends at
    ``length + translation[i]``, past the plate. Bending is shared; every tube has its own twist. Loads act on the tip of the
    tube that reaches furthest. That need not be the innermost: a tube may be pulled back into those around it. Of several that
    end at one place, but for rounding, the innermost is loaded. An inner tube starts no less far back than those around it, or
    it could not be held, and where diameters are given it must fit. Lines turn and slide with the tube that carries them
    (``docs/lines.md``); behind the plate they do not twist it.

    Args:
        tubes: Innermost first, 1 to 6.
        base: Pose of the plate in the world, shape (..., 4, 4), or a ``Pose``; the identity by default.

    Raises:
        ValueError: If tubes do not nest (where diameters are given), or shear, or have members that are no lines, or ``base`` is
            not a pose.
        TypeError: If ``tubes`` are not ``Rod`` objects.
    """

    transmission = True

    @hinted("tubes are one list, ConcentricTubes([inner, outer])")
    def __init__(self, tubes: Sequence[Rod], *, base: Poses | None = None) -> None:
        sequence("ConcentricTubes.tubes", tubes, Rod, "Rod, innermost first")
        if not 1 <= len(tubes) <= 6:
            refuse("ConcentricTubes.tubes", f"{len(tubes)} tubes", "must be 1 to 6")
        for k, tube in enumerate(tubes):
            if any(np.isfinite(s.shear_stiffness).any() or np.isfinite(s.axial_stiffness).any() for s in tube.sections):
                refuse(f"ConcentricTubes.tubes[{k}]", tube, "shear_stiffness and axial_stiffness must be inf")
            if tube.members:
                refuse(f"ConcentricTubes.tubes[{k}]", tube, "must have no members: how tubes share them is not modelled")
        plausibility.of_nested_lines(tubes)
        super().__init__(tuple(tubes), base)
        for j, k in combinations(range(len(tubes)), 2):
            _check_nesting(tubes[j], tubes[k], j, k)
        self._pulled = [min((line.reach_straight for line in tube.lines), default=inf) for tube in tubes]
        self._shortest = [float(np.min(tube.length)) for tube in tubes]

    @property
    def tubes(self) -> tuple[Rod, ...]:
        """The tubes, innermost first."""
        return self.rods

    if TYPE_CHECKING:
        _input_name: ConcentricTubesInput

    @listed(*TUBE_INPUTS, *DRIVE_INPUTS)
    def inputs(self, **values: Unpack[ConcentricTubesInputs]) -> Inputs:  # type: ignore[override]  # noqa: D102  (as ``listed`` says)
        return super().inputs(**ConcentricTubesInputs(**values))

    @property
    def input_specs(self) -> tuple[InputSpec, ...]:  # noqa: D102
        return self._specs

    @cached_property
    def _specs(self) -> InputSpecs:
        return InputSpecs((*TUBE_INPUTS, *drive_specs(self.rods)))

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        super().check(inputs)
        beta = inputs.translation
        if not inputs.batch_shape and self.surely_takes("translation", beta.tolist()):
            return
        refuse_behind_plate(inputs, self.rods)
        for k in range(self.rod_count - 1):
            behind = beta[..., k] > beta[..., k + 1] + SAME_PLACE
            _refuse_where(behind, beta, k, f"must be <= translation[{k + 1}]: inner tubes start further back")

    def surely_takes(self, name: str, values: Sequence[float]) -> bool:  # noqa: D102
        if name in DRIVES:
            return surely_driven(name, values, self.rods)
        if name != "translation":
            return name not in BY_MATERIAL
        if any(value < -reach for value, reach in zip(values, self._pulled, strict=True)):
            return False
        low = -inf
        for value, length in zip(values, self._shortest, strict=True):
            if not (low <= value <= 0.0 and value > -length):
                return False
            low = value
        return True

    def with_rods(self, rods: Sequence[Rod]) -> Self:  # noqa: D102
        result = super().with_rods(rods)
        result._shortest = [float(np.min(tube.length)) for tube in rods]
        return result

    def __repr__(self) -> str:
        return f"ConcentricTubes({list(self.rods)!r})"


def _check_nesting(inner: Rod, outer: Rod, j: int, k: int) -> None:
    """Refuse a tube that cannot lie inside another, by the diameters that are given."""
    thickness, hollow, around = inner.outer_diameter, outer.inner_diameter, outer.outer_diameter
    if hollow is not None and not np.all(hollow):
        refuse(f"ConcentricTubes.tubes[{k}].inner_diameter", 0.0, f"must be > 0: tubes[{j}] lies inside")
    if thickness is None:
        return
    field = f"ConcentricTubes.tubes[{j}].outer_diameter"
    fits = inner.inner_diameter is not None and around is not None and np.all(np.less_equal(around, inner.inner_diameter))
    hint = "; tubes are listed innermost first" if fits else ""
    if hollow is not None and (wrong := np.greater(thickness, hollow)).any():
        thick, room = at_first(wrong, thickness, hollow)
        refuse(field, thick, f"must be <= the inner diameter of tubes[{k}], {room:g} m{hint}")
    if around is not None and (wrong := np.greater_equal(thickness, around)).any():
        thick, room = at_first(wrong, thickness, around)
        refuse(field, thick, f"must be < the outer diameter of tubes[{k}], {room:g} m, which lies around it{hint}")


def refuse_behind_plate(inputs: Inputs, tubes: Sequence[Rod]) -> None:
    """Refuse translations by which a tube starts in front of the plate, or ends behind it."""
    beta = inputs.translation
    for k, tube in enumerate(tubes):
        _refuse_where(beta[..., k] > 0, beta, k, "must be <= 0: a tube starts behind the plate")
        limit = -float(np.min(tube.length))
        out = tube.length + beta[..., k] <= 0
        millimetres = ", or is it in mm?" if np.any(out) and np.min(beta[..., k]) * 1e-3 > limit else ""
        _refuse_where(out, beta, k, f"must be > -length = {limit:g} m: the tube is pulled out of the plate{millimetres}")


def _refuse_where(wrong: np.bool_ | NDArray[np.bool_], beta: FloatArray, k: int, allowed: str) -> None:
    """Refuse the translation of tube k in the first instance where it is wrong."""
    if np.any(wrong):
        values = np.broadcast_to(beta[..., k], np.shape(wrong))
        first, count = float(values[wrong][0]), np.count_nonzero(wrong)
        place = f"{first} at {np.argwhere(wrong)[0].tolist()}" + (f", the first of {count}," if count > 1 else "")
        refuse(f"translation[{k}]", Described(place) if np.size(wrong) > 1 else first, allowed)
