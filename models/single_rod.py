"""One rod, clamped at its base, free at its tip: the robot of the paper."""

from collections.abc import Sequence
from math import inf
from typing import Any

import numpy as np

from multirod.assembly import Assembly, pose
from multirod.inputs import Inputs, InputSpec
from multirod.models.backbone import BackboneProblem
from multirod.models.integrators import Integrator
from multirod.rod import Rod
from multirod.validation import Described, refuse

BACKBONE_INPUTS = (
    InputSpec(name="rotation", unit="rad", per_rod=True, load=False, description="angle of each rod's base about its axis"),
    InputSpec(name="translation", unit="m", per_rod=True, load=False, description="how far each rod is pushed out of the base"),
    InputSpec(name="tip_force", unit="N", description="dead force on the tip, world frame"),
    InputSpec(name="tip_moment", unit="N m", description="dead moment on the tip, world frame"),
    InputSpec(name="follower_force", unit="N", dead_twin="tip_force", description="force on the tip, fixed in the tip frame"),
    InputSpec(name="follower_moment", unit="N m", description="moment on the tip, fixed in the tip frame"),
    InputSpec(name="distributed_force", unit="N/m", function=True, description="dead force per length, world frame"),
    InputSpec(name="distributed_moment", unit="N", function=True, description="dead moment per length, world frame"),
    InputSpec(name="gravity", unit="m/s^2", description="acceleration, world frame; acts on linear_density"),
)


def check_weight(rods: Sequence[Rod], inputs: Inputs) -> None:
    """Refuse gravity on rods that weigh nothing."""
    if inputs.is_active("gravity") and not any(np.any(section.linear_density) for rod in rods for section in rod.sections):
        refuse("gravity", inputs.gravity.tolist(), "must be zero: no rod has a linear_density (or, for Rod.tube, a density)")


class SingleRod(Assembly):
    """One rod clamped at its base.

    Inputs: ``rotation`` and ``translation`` of the base (the length in use is ``length + translation``: the rod is pushed
    out of its base, section ends move outward, and what is added continues the first section); the loads of
    ``input_specs``; and ``tip_curvature``, a measured curvature at the tip [1/m] that takes the place of the boundary
    condition ``u(L) = u*``.

    Args:
        rod: The rod.
        base: Pose of the base in the world, shape (..., 4, 4); the identity by default.

    Raises:
        ValueError: If ``base`` is not a pose.
        TypeError: If ``rod`` is not a ``Rod``.
    """

    def __init__(self, rod: Rod, *, base: Any = None) -> None:
        if not isinstance(rod, Rod):
            raise TypeError(f"SingleRod takes a Rod, not {type(rod).__name__}")
        self.rods = (rod,)
        self.base = pose("SingleRod.base", base)
        try:
            _ = self.batch_shape
        except ValueError:
            batch = Described(f"leading axes {self.base.shape[:-2]}")
            refuse("SingleRod.base", batch, f"must broadcast with the rod's {rod.batch_shape}")

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of the rod's parameters and of the base."""
        return np.broadcast_shapes(self.rods[0].batch_shape, self.base.shape[:-2])

    @property
    def input_specs(self) -> tuple[InputSpec, ...]:  # noqa: D102
        measured = InputSpec(
            name="tip_curvature", unit="1/m", load=False, optional=True, description="measured curvature at the tip, tip frame"
        )
        return (*BACKBONE_INPUTS, measured)

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        length = self.rods[0].length + inputs.translation[..., 0]
        if np.any(length <= 0):
            shortest = float(np.min(inputs.translation))
            refuse(
                "translation", shortest, f"must be > -length = {-float(np.min(self.rods[0].length)):g} m: no rod is left in use"
            )

        for name in ("tip_moment", "follower_moment"):
            if "tip_curvature" in inputs.given and inputs.is_active(name):
                refuse(
                    name,
                    getattr(inputs, name).tolist(),
                    "must be zero beside tip_curvature, which takes the place of this condition",
                )
        check_weight(self.rods, inputs)

    def bounds(self, name: str) -> tuple[float, float]:  # noqa: D102
        return (-float(np.min(self.rods[0].length)), inf) if name == "translation" else (-inf, inf)

    def problem(  # noqa: D102
        self,
        inputs: Inputs,
        *,
        integrator: Integrator,
        device: str = "cpu",
        pose_sensitivities: bool = False,
        direction_count: int = 0,
        enabled: Sequence[str] = (),
    ) -> BackboneProblem:
        return BackboneProblem(
            self.rods,
            self.base,
            inputs,
            integrator=integrator,
            device=device,
            pose_sensitivities=pose_sensitivities,
            direction_count=direction_count,
            enabled=enabled,
        )

    def __repr__(self) -> str:
        return f"SingleRod({self.rods[0]!r})"
