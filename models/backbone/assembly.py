"""A robot that is one backbone."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar, Self, Unpack

import numpy as np

from multirod.assembly import Assembly, Backbone
from multirod.batch import IntArray, broadcast_shapes, take
from multirod.frames import pose
from multirod.inputs import Inputs, InputSpec, InputSpecs
from multirod.integrators import Integrator
from multirod.models.backbone.checks import check_drives, check_reach
from multirod.models.backbone.derivatives.designs import PARAMETERS, design_options, parameter_size, refuse_unknown
from multirod.models.backbone.derivatives.ends import ways_back
from multirod.models.backbone.influence.bound import Influence, influences
from multirod.models.backbone.inputs import BACKBONE_INPUTS
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.members import drives
from multirod.models.backbone.members.member import kinds
from multirod.models.backbone.problem import BackboneProblem, ProblemOptions
from multirod.models.backbone.terms import scene_features
from multirod.profile import Profile
from multirod.read_only import changed
from multirod.reuse import reusable
from multirod.rod import Rod, RodArrays, lower
from multirod.types import Poses
from multirod.validation import Described, FloatArray, frozen, refuse


class BackboneAssembly(Assembly):
    """An assembly that is one backbone, clamped at its base and free at its tip.

    Args:
        rods: Innermost first.
        base: Pose of the base in the world, shape (..., 4, 4); None is the identity.

    Raises:
        ValueError: If ``base`` is not a pose, or its leading axes do not broadcast with the rods'.
    """

    length_columns: ClassVar[bool] = True
    transmission: ClassVar[bool] = False  # whether the rods twist behind the base plate

    def __init__(self, rods: tuple[Rod, ...], base: Poses | None) -> None:
        field = f"{type(self).__name__}.base"
        self.rods = rods
        self.base = pose(field, base)
        own = super().batch_shape
        try:
            np.broadcast_shapes(own, self.base.shape[:-2])
        except ValueError:
            refuse(field, Described(f"leading axes {self.base.shape[:-2]}"), f"must broadcast with the rods' {own}")

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of the rods' parameters and of the base."""
        return broadcast_shapes(super().batch_shape, self.base.shape[:-2])

    @property
    def input_specs(self) -> tuple[InputSpec, ...]:  # noqa: D102
        return InputSpecs(BACKBONE_INPUTS)

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        if inputs.is_active("gravity") and not any(rod.has_mass for rod in self.rods):
            refuse("gravity", inputs.gravity.tolist(), "must be zero: no rod has a linear_density (or, for Rod.tube, a density)")
        if inputs.is_active("magnetic_field") and not any(rod.is_magnetised for rod in self.rods):
            refuse("magnetic_field", inputs.magnetic_field.tolist(), "must be zero: no rod has a magnetisation")
        check_drives(inputs, self.rods)
        if inputs.is_active("translation"):
            check_reach(inputs, self.rods, straight=self.transmission)

    @property
    def backbones(self) -> tuple[Backbone, ...]:  # noqa: D102
        return (Backbone(slice(0, self.rod_count), tip=False),)

    @property
    def has_conditions(self) -> bool:
        """Whether a line is driven by its length."""
        return any(kind.conditioned for rod in self.rods for kind in kinds(rod.carried))

    def input_directions(self, *names: str) -> dict[str, Any]:
        """Directions for the derivatives by some inputs; of rods with lines, of their lengths too."""
        varies = self.arrays.member_degree or self.arrays.degree
        if "translation" in names and varies and any(kind.rubs for kind in self.arrays.members):
            raise NotImplementedError(
                "the derivatives by translation of a rod whose line has friction are not known where a route or the precurvature "
                "is a function of arclength"
            )
        refuse_unknown(names, self.rods)
        lengths = {"lengths": True} if drives(self.arrays.members) else {}
        return {**super().input_directions(*names), **lengths, **design_options(names)}

    @property
    def parameters(self) -> tuple[str, ...]:  # noqa: D102
        return PARAMETERS

    def column_count(self, name: str) -> int:  # noqa: D102
        return parameter_size(name, self.rods) if name in PARAMETERS else super().column_count(name)

    def ends_meet(self, inputs: Inputs) -> bool:  # noqa: D102
        return bool(ways_back(self.arrays, inputs.translation.reshape(-1, self.rod_count), inputs).any())

    @cached_property
    def arrays(self) -> RodArrays:
        """The rods as kernels read them."""
        return lower(self.rods)

    def bent_at_base(self, unknowns: FloatArray) -> FloatArray | None:  # noqa: D102
        rest = self.rods[0].sections[0].precurvature
        rest = rest(0.0) if isinstance(rest, Profile) else rest
        if self.rod_count > 1 or self.transmission or self.rods[0].carried or rest.ndim > 1:
            return None
        return np.asarray(unknowns[:, :2] - rest[:2])

    def with_rods(self, rods: Sequence[Rod]) -> Self:  # noqa: D102
        return changed(self, computed=("arrays", "longest", "stiffest", "_specs"), rods=tuple(rods))

    def with_base(self, base: FloatArray) -> Self:  # noqa: D102
        return changed(self, base=frozen(base))

    def features(self, inputs: Inputs, *, enabled: Iterable[str] = ()) -> tuple[Features, ...]:  # noqa: D102
        active = (*inputs.active, *enabled)
        options: dict[str, Any] = {"rod_count": self.rod_count, "transmission": self.transmission}
        return (scene_features(self.arrays, active, inputs.profiles, **options),)

    def influences(self, inputs: Inputs) -> Mapping[str, Influence]:  # noqa: D102
        if self.arrays.members or self.arrays.loads or self.arrays.eccentric:
            return {}  # what they hold the rod back by is not bounded
        whole = np.broadcast_shapes(inputs.batch_shape, self.batch_shape)
        return influences(self.arrays, inputs, whole, transmission=self.transmission)

    @reusable
    def problem(  # noqa: D102
        self,
        inputs: Inputs,
        *,
        integrator: Integrator,
        instances: IntArray | None = None,
        **options: Unpack[ProblemOptions],
    ) -> BackboneProblem:
        arrays, base = self.arrays, self.base
        if instances is not None:
            whole = np.broadcast_shapes(inputs.batch_shape, self.batch_shape)
            inputs = inputs.take(whole, instances)
            arrays = arrays.take(whole, instances)
            base = take(base, whole, instances, tail=2) if base.ndim > 2 else base
        return BackboneProblem(
            self.rods, base, inputs, integrator=integrator, transmission=self.transmission, arrays=arrays, **options
        )
