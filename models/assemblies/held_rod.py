"""One rod that is held at both ends."""

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, Unpack

import numpy as np

from multirod import plausibility
from multirod.assembly import Assembly, Backbone
from multirod.batch import IntArray
from multirod.frames import pose
from multirod.inputs import Inputs, InputSpec, InputSpecs
from multirod.integrators import RK45, Integrator
from multirod.models.assemblies.inputs import HeldRodInput, HeldRodInputs, listed
from multirod.models.assemblies.single_rod import SingleRod
from multirod.models.backbone.derivatives.designs import AROUND, COMPONENTS, parameter_size
from multirod.models.backbone.inputs import DRIVE_INPUTS, drive_specs
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.terms import scene_features
from multirod.models.held.holders import END_INPUTS, POSE_INPUTS, ROD_INPUTS, TIP_SPECS, HeldOptions, Holders
from multirod.models.held.problem import HeldProblem
from multirod.models.joint_kernels import JOINTS
from multirod.naming import names_checked
from multirod.read_only import changed
from multirod.reuse import reusable
from multirod.rod import Rod
from multirod.types import Numbers, Poses
from multirod.validation import Described, FloatArray, array, choice, directions, frozen, refuse

INPUTS = (*ROD_INPUTS[:2], *END_INPUTS, *TIP_SPECS, *ROD_INPUTS[2:])

Joint = Literal["clamped", "revolute", "spherical"]


class HeldRod(Assembly):
    """One rod whose ends are both held: each clamped or in a joint, and the end on a slide if it is to be pushed.

    The inputs ``end_position`` and ``end_rotation`` move what holds the end from ``end``: with the identity as ``end`` they are
    its pose. ``tip_force`` and ``tip_moment`` act on the end, as far as joint and slide leave it free: a thrust along the slide,
    a torque about the axis of a revolute joint. ``tip_position`` and ``tip_rotation`` of a solution are those of the rod's end,
    ``end_force`` and ``end_moment`` what its holder does to it.

    Args:
        rod: The rod. Its lines may be driven by displacement, and it may have a foundation and loads of its own, only
            where the base is clamped.
        base: Pose of what holds the base, in the world, shape (..., 4, 4), or a ``Pose``; the identity by default.
        end: Pose of what holds the end, in the world, shape (..., 4, 4), where ``end_position`` and ``end_rotation`` are zero; by
            default that of the end of the rod at rest.
        joint: At the end: ``"clamped"``, ``"revolute"`` (free to turn about its axis), or ``"spherical"`` (no moment).
        joint_axis: Of a revolute joint, and only of one, in the frame of the end's holder, shape (3,); x by default.
        slide: Direction in which the end slides without friction, in the frame of its holder, shape (3,); None if it does not.
        base_joint: At the base, as at the end.
        base_joint_axis: Likewise of the joint at the base, in the frame of the base's holder.

    Raises:
        ValueError: If a pose is none, a joint is not one of these, an axis is zero, or the rod cannot be held so.
        TypeError: If ``rod`` is not a ``Rod``.
    """

    length_columns: ClassVar[bool] = True
    end_held: ClassVar[bool] = True

    @names_checked
    def __init__(
        self,
        rod: Rod,
        *,
        base: Poses | None = None,
        end: Poses | None = None,
        joint: Joint = "clamped",
        joint_axis: Numbers | None = None,
        slide: Numbers | None = None,
        base_joint: Joint = "clamped",
        base_joint_axis: Numbers | None = None,
    ) -> None:
        if not isinstance(rod, Rod):
            raise TypeError(f"HeldRod takes a Rod, not {type(rod).__name__}")
        self.rods = (rod,)
        self.base = pose("HeldRod.base", base)
        self.end = None if end is None else pose("HeldRod.end", end)
        self.joint = choice("HeldRod.joint", joint, JOINTS)
        self.joint_axis = _joint_axis("joint", self.joint, joint_axis)
        self.slide = None if slide is None else _axis("HeldRod.slide", slide)
        self.base_joint = choice("HeldRod.base_joint", base_joint, JOINTS)
        self.base_joint_axis = _joint_axis("base_joint", self.base_joint, base_joint_axis)
        shapes = [rod.batch_shape, self.base.shape[:-2], () if self.end is None else self.end.shape[:-2]]
        try:
            np.broadcast_shapes(*shapes)
        except ValueError:
            refuse("HeldRod.end", Described(f"leading axes {shapes}"), "those of rod, base and end must broadcast")
        if self.base_joint != "clamped" and (rod.is_embedded or rod.loads):
            refuse("HeldRod.base_joint", base_joint, "must be 'clamped': a foundation or loads of its own turn with its base")
        if self.base_joint != "clamped" and self._free.has_conditions:
            refuse("HeldRod.base_joint", base_joint, "must be 'clamped': a line of the rod is driven by its displacement")

    @cached_property
    def _free(self) -> SingleRod:
        """The same rod with nothing that holds its end."""
        return SingleRod(self.rods[0], base=self.base)

    @cached_property
    def holders(self) -> Holders:
        """What holds the rod, in numbers."""
        return Holders(
            self._free,
            _end_at_rest(self._free) if self.end is None else self.end,
            JOINTS[self.joint],
            self.joint_axis,
            self.slide,
            JOINTS[self.base_joint],
            self.base_joint_axis,
            self._free.arrays,
            self.base,
        )

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of the rod's parameters and of the poses."""
        end = () if self.end is None else self.end.shape[:-2]
        return np.broadcast_shapes(self.rods[0].batch_shape, self.base.shape[:-2], end)

    if TYPE_CHECKING:
        _input_name: HeldRodInput

    @listed(*INPUTS, *DRIVE_INPUTS)
    def inputs(self, **values: Unpack[HeldRodInputs]) -> Inputs:  # type: ignore[override]  # noqa: D102  (as ``listed`` says)
        result = super().inputs(**HeldRodInputs(**values))
        if self._turns_back:
            plausibility.of_idle_rotation(result.rotation, self.base_joint)
        plausibility.of_idle_loads(result, self._taken)
        return result

    @property
    def _taken(self) -> dict[str, str]:
        """The loads on the end that never act, and what would let them."""
        result = {}
        if self.slide is None:
            result["tip_force"] = "HeldRod(slide=(0, 0, 1)) lets it act along z, end_position moves the end"
        if self.joint == "clamped":
            way = 'HeldRod(joint="revolute", joint_axis=(0, 0, 1)) lets it act about z, end_rotation turns the end'
            result["tip_moment"] = way
        return result

    @property
    def _turns_back(self) -> bool:
        """Whether the base turns back by whatever ``rotation`` turns it; between two balls that says where the rod bends to."""
        if self.base_joint == "spherical":
            return self.joint != "spherical"
        return self.base_joint == "revolute" and not self.base_joint_axis[:2].any()

    @property
    def input_specs(self) -> tuple[InputSpec, ...]:  # noqa: D102
        return InputSpecs((*INPUTS, *drive_specs(self.rods)))

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        own = [spec.name for spec in self._free.input_specs if spec.name in inputs.given and spec.name not in inputs.profiles]
        self._free.check(Inputs(self._free.input_specs, 1, {name: getattr(inputs, name) for name in own}))
        if self.base_joint != "clamped" and inputs.profiles:
            name = next(iter(inputs.profiles))
            refuse(name, Described("a function of arclength"), "must be numbers where the base turns in a joint")

    @property
    def backbones(self) -> tuple[Backbone, ...]:  # noqa: D102
        return (Backbone(slice(0, 1), tip=True),)

    @property
    def parameters(self) -> tuple[str, ...]:  # noqa: D102
        return tuple(name for name in COMPONENTS if name not in AROUND or self.base_joint == "clamped")

    def column_count(self, name: str) -> int:  # noqa: D102
        return parameter_size(name, self.rods) if name in COMPONENTS else super().column_count(name)

    def input_directions(self, *names: str) -> dict[str, Any]:  # noqa: D102
        own_numbers = [name for name in names if name in COMPONENTS]
        if own_numbers and self.end is None:
            raise NotImplementedError(
                f"the derivatives by {', '.join(own_numbers)} of a rod that is held where its end is at rest are not known: that "
                "moves too; give HeldRod an end"
            )
        on_rod = [name for name in names if name not in POSE_INPUTS]
        own = self._free.input_directions(*on_rod) if on_rod else {}
        return own | super().input_directions(*names)

    def ends_meet(self, inputs: Inputs) -> bool:  # noqa: D102
        return self._free.ends_meet(inputs)

    def surely_takes(self, name: str, values: Sequence[float]) -> bool:  # noqa: D102
        return name in POSE_INPUTS or self._free.surely_takes(name, values)

    @reusable
    def problem(  # noqa: D102
        self,
        inputs: Inputs,
        *,
        integrator: Integrator,
        instances: IntArray | None = None,
        **options: Unpack[HeldOptions],
    ) -> HeldProblem:
        holders = self.holders
        if instances is not None:
            whole = np.broadcast_shapes(inputs.batch_shape, self.batch_shape)
            holders, inputs = holders.take(whole, instances), inputs.take(whole, instances)
        return HeldProblem(holders, inputs, integrator=integrator, **options)

    def features(self, inputs: Inputs, *, enabled: Iterable[str] = ()) -> tuple[Features, ...]:  # noqa: D102
        on_rod = {spec.name for spec in ROD_INPUTS}
        active = [name for name in (*inputs.active, *enabled) if name in on_rod]
        options: dict[str, Any] = {"rod_count": 1, "transmission": False, "held": True}
        return (scene_features(self._free.arrays, active, inputs.profiles, **options),)

    def with_rods(self, rods: Sequence[Rod]) -> Self:
        """The same holders, where they are, with another rod."""
        computed = ("_free", "holders", "longest", "stiffest")
        return changed(self, computed=computed, rods=tuple(rods), end=self.holders.end)

    def __repr__(self) -> str:
        joints = [f"base_joint={self.base_joint!r}"] * (self.base_joint != "clamped")
        joints += [f"joint={self.joint!r}"] * (self.joint != "clamped")
        joints += [f"slide={self.slide.tolist()}"] if self.slide is not None else []
        return f"HeldRod({', '.join([repr(self.rods[0]), *joints])})"


def _joint_axis(joint: str, kind: str, value: Numbers | None) -> FloatArray:
    """What a joint turns about, (3,)."""
    field = f"HeldRod.{joint}_axis"
    if value is not None and kind != "revolute":
        refuse(field, value, f"must not be given: only a 'revolute' joint has an axis, and {joint} is {kind!r}")
    return _axis(field, (1.0, 0.0, 0.0) if value is None else value)


def _axis(field: str, value: Numbers) -> FloatArray:
    """A direction (3,), as long as 1."""
    axis = array(field, value, (3,))
    if axis.shape != (3,):
        refuse(field, value, "must have shape (3,)")
    return directions(field, value, axis)


def _end_at_rest(robot: SingleRod) -> FloatArray:
    """Pose of the end of a rod that nothing acts on, shape (..., 4, 4)."""
    problem = robot.problem(robot.make_inputs({}), integrator=RK45(rtol=1e-12, atol=1e-14))
    problem.evaluate(problem.guess())
    shape = robot.batch_shape
    result = np.zeros((*shape, 4, 4))
    result[..., 3, 3] = 1.0
    result[..., :3, 3] = problem.read("position").reshape(*shape, 3)
    result[..., :3, :3] = problem.read("rotation").reshape(*shape, 3, 3)
    return np.asarray(frozen(result))
