"""Tubes side by side: each at an offset from a line that all follow, sliding along it."""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Self, Unpack

import numpy as np

from multirod import plausibility
from multirod.assembly import Backbone
from multirod.inputs import Inputs, InputSpec, InputSpecs
from multirod.models.assemblies.concentric_tubes import refuse_behind_plate
from multirod.models.assemblies.inputs import EccentricTubesInput, EccentricTubesInputs, listed
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.derivatives.designs import BY_LOAD
from multirod.models.backbone.inputs import BY_MATERIAL, TUBE_INPUTS
from multirod.naming import hinted
from multirod.rod import Rod, RodArrays, lower
from multirod.types import Numbers, Poses
from multirod.validation import FloatArray, array, refuse, sequence

MOST_TUBES = 6
INPUTS = tuple(spec for spec in TUBE_INPUTS if spec.name not in BY_MATERIAL)


class EccentricTubes(BackboneAssembly):
    """Tubes that run side by side, held at constant offsets from one line by guides that they slide through, and turn in.

    The line starts at the assembly's base, along z, and its frame does not twist about it. Tube ``i`` runs at ``offsets[i]``
    along the first two axes of that frame: shorter than the line on the inside of a bend and more curved, longer and less curved
    on the outside. Each tube is turned and pushed at its own base behind a plate, as one of ``ConcentricTubes`` is, and has its
    own twist. With offsets of zero they are concentric tubes in a sheath that bends but does not twist.

    Arclengths are those of the line: where a tube ends, and its precurvature as a function. Loads act on the line. A solution's
    ``position`` and ``rotation`` are those of the line's end; ``rod(i)`` is tube i, where it is. What keeps the line from
    twisting takes up a torque. ``rod(i).force`` is the force of all tubes together, in the frame of one.

    Args:
        tubes: 1 to 6, in any order.
        offsets: Of the tubes from the line [m], shape (len(tubes), 2).
        base: Pose of the plate in the world, shape (..., 4, 4), or a ``Pose``; the identity by default.

    Raises:
        ValueError: If tubes shear, differ in stiffness between their axes, are magnetised, or have members, lines or a
            foundation, or ``offsets`` are not two finite numbers a tube, or ``base`` is not a pose.
        TypeError: If ``tubes`` are not ``Rod`` objects.
    """

    transmission = True

    @hinted("tubes are one list, and offsets another, EccentricTubes([left, right], offsets=[(0.002, 0), (-0.003, 0)])")
    def __init__(self, tubes: Sequence[Rod], offsets: Numbers, *, base: Poses | None = None) -> None:
        sequence("EccentricTubes.tubes", tubes, Rod, "Rod")
        if not 1 <= len(tubes) <= MOST_TUBES:
            refuse("EccentricTubes.tubes", f"{len(tubes)} tubes", f"must be 1 to {MOST_TUBES}")
        for k, tube in enumerate(tubes):
            _check(f"EccentricTubes.tubes[{k}]", tube)
        self.offsets: FloatArray = array("EccentricTubes.offsets", offsets, (len(tubes), 2))
        if self.offsets.shape != (len(tubes), 2):
            refuse("EccentricTubes.offsets", f"shape {self.offsets.shape}", f"must be ({len(tubes)}, 2)")
        super().__init__(tuple(tubes), base)
        plausibility.of_offsets("EccentricTubes.offsets", self.offsets, self.rods)

    @property
    def tubes(self) -> tuple[Rod, ...]:
        """The tubes, in the order of their offsets."""
        return self.rods

    if TYPE_CHECKING:
        _input_name: EccentricTubesInput

    @listed(*INPUTS)
    def inputs(self, **values: Unpack[EccentricTubesInputs]) -> Inputs:  # type: ignore[override]  # noqa: D102  (as ``listed`` says)
        return super().inputs(**EccentricTubesInputs(**values))

    @property
    def input_specs(self) -> tuple[InputSpec, ...]:  # noqa: D102
        return InputSpecs(INPUTS)

    @cached_property
    def arrays(self) -> RodArrays:  # noqa: D102
        return lower(self.rods, self.offsets)

    @property
    def parameters(self) -> tuple[str, ...]:  # noqa: D102
        return tuple(name for name in super().parameters if name not in BY_LOAD)

    @property
    def backbones(self) -> tuple[Backbone, ...]:
        """Not told: of tubes side by side ``rod(k)`` has not what guides hold."""
        raise NotImplementedError("what tubes side by side do to their plate together is not told; base_torque is, of each")

    def with_rods(self, rods: Sequence[Rod]) -> Self:  # noqa: D102
        for k, tube in enumerate(rods):
            _check(f"EccentricTubes.tubes[{k}]", tube)
        return super().with_rods(rods)

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        refuse_behind_plate(inputs, self.rods)

    def __repr__(self) -> str:
        return f"EccentricTubes({list(self.rods)!r}, {self.offsets.tolist()!r})"


def _check(field: str, tube: Rod) -> None:
    """Refuse what is not modelled of tubes side by side."""
    for section in tube.sections:
        if np.isfinite(section.shear_stiffness).any() or np.isfinite(section.axial_stiffness).any():
            refuse(field, tube, "shear_stiffness and axial_stiffness must be inf")
        if np.any(section.bending_stiffness[..., 0] != section.bending_stiffness[..., 1]):
            refuse(field, tube, "bending_stiffness must be the same about both axes")
        if section.foundation.any() or section.magnetisation.any():
            refuse(field, tube, "must have no foundation and no magnetisation")
    if tube.members or tube.lines or tube.loads:
        refuse(field, tube, "must have no members, no lines and no loads of its own")
