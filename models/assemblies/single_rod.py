"""One rod, clamped at its base, free at its tip: the robot of the paper."""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Self, Unpack

import numpy as np

from multirod.inputs import Inputs, InputSpec, InputSpecs
from multirod.models.assemblies.inputs import SingleRodInput, SingleRodInputs, listed
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.checks import surely_driven
from multirod.models.backbone.inputs import BACKBONE_INPUTS, BY_MATERIAL, DRIVE_INPUTS, DRIVES, TIP_CURVATURE, drive_specs
from multirod.naming import hinted
from multirod.rod import Rod
from multirod.types import Poses
from multirod.validation import first_of, refuse


class SingleRod(BackboneAssembly):
    """One rod clamped at its base.

    Inputs: ``rotation`` and ``translation`` of the base (the length in use is ``length + translation``: the rod is pushed
    out of its base, section ends move outward, and what is added continues the first section); the loads of
    ``input_specs``; and ``tip_curvature``, a measured curvature at the tip [1/m] that takes the place of the boundary
    condition ``u(L) = u*``.

    Args:
        rod: The rod.
        base: Pose of the base in the world, shape (..., 4, 4), or a ``Pose``; the identity by default.

    Raises:
        ValueError: If ``base`` is not a pose.
        TypeError: If ``rod`` is not a ``Rod``.
    """

    @hinted("it is made of a rod, SingleRod(Rod(...)), which has length, stiffnesses and lines")
    def __init__(self, rod: Rod, *, base: Poses | None = None) -> None:
        if not isinstance(rod, Rod):
            several = isinstance(rod, (list, tuple)) and all(isinstance(item, Rod) for item in rod)
            hint = ": of several rods, make ConcentricTubes, EccentricTubes or ParallelRods" if several else ""
            raise TypeError(f"SingleRod takes a Rod, not {type(rod).__name__}{hint}")
        super().__init__((rod,), base)
        self._shortest = float(np.min(rod.length))
        self._pulled = min((-np.inf if line.rubs else line.reach for line in rod.lines), default=np.inf)

    @property
    def rod(self) -> Rod:
        """The rod."""
        return self.rods[0]

    if TYPE_CHECKING:
        _input_name: SingleRodInput

    @listed(*BACKBONE_INPUTS, *DRIVE_INPUTS, TIP_CURVATURE)
    def inputs(self, **values: Unpack[SingleRodInputs]) -> Inputs:  # type: ignore[override]  # noqa: D102  (as ``listed`` says)
        return super().inputs(**SingleRodInputs(**values))

    @property
    def input_specs(self) -> tuple[InputSpec, ...]:  # noqa: D102
        return self._specs

    @cached_property
    def _specs(self) -> InputSpecs:
        return InputSpecs((*BACKBONE_INPUTS, *drive_specs(self.rods), TIP_CURVATURE))

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        super().check(inputs)
        sure = not inputs.batch_shape and self.surely_takes("translation", inputs.translation.tolist())
        short = np.asarray(not sure and self.rods[0].length + inputs.translation[..., 0] <= 0)
        if short.any():
            pushed = np.broadcast_to(inputs.translation[..., 0], short.shape)
            shown = first_of(short, pushed, float(np.min(inputs.translation)))
            refuse("translation", shown, f"must be > -length = {-float(np.min(self.rods[0].length)):g} m: no rod is left in use")
        if "tip_curvature" in inputs.given and self.rods[0].carried:
            carried = "members" if self.rods[0].members else "lines"
            refuse("tip_curvature", inputs.tip_curvature.tolist(), f"must not be given: the rod has {carried}")
        for name in (spec.name for spec in BACKBONE_INPUTS if spec.acts == "tip" and spec.load == "moment"):
            if "tip_curvature" in inputs.given and inputs.is_active(name):
                refuse(
                    name,
                    getattr(inputs, name).tolist(),
                    "must be zero beside tip_curvature, which takes the place of this condition",
                )

    def surely_takes(self, name: str, values: Sequence[float]) -> bool:  # noqa: D102
        if name in DRIVES:
            return surely_driven(name, values, self.rods)
        if name == "translation":
            return values[0] == 0 or (values[0] > -self._shortest and values[0] >= -self._pulled)
        return name not in BY_MATERIAL

    def with_rods(self, rods: Sequence[Rod]) -> Self:  # noqa: D102
        result = super().with_rods(rods)
        result._shortest = float(np.min(rods[0].length))
        return result

    def __repr__(self) -> str:
        return f"SingleRod({self.rods[0]!r})"
