"""Parallel robots turned around: the pose of the platform is given, and how far each leg is pushed out is found."""

from collections.abc import Iterable, Sequence
from math import inf
from typing import TYPE_CHECKING, Any, ClassVar, Unpack

import numpy as np

from multirod import plausibility
from multirod.assembly import Assembly, Backbone
from multirod.inputs import Inputs, InputSpec, InputSpecs
from multirod.models.assemblies.inputs import (
    InverseParallelRodsInput,
    InverseParallelRodsInputs,
    listed,
)
from multirod.models.assemblies.parallel_rods import INPUTS, Limits, ParallelRods
from multirod.models.backbone.inputs import DRIVE_INPUTS
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.platform.problem import ParallelProblem
from multirod.reuse import reusable
from multirod.rod import Rod
from multirod.rotations import matrices
from multirod.validation import Described, FloatArray, array, frozen, instance, refuse

if TYPE_CHECKING:
    from multirod.results.found import Found
    from multirod.results.solution import Solution

POSE_INPUTS = (
    InputSpec(name="platform_position", unit="m", description="of the platform's origin, world frame", required=True),
    InputSpec(name="platform_rotation", unit="rad", description="rotation vector of the platform, world frame"),
)

ROUNDED = 1e-9  # of the longest rod, what is no length of a leg


class InverseParallelRods(Assembly):
    """Six legs and a given pose of their platform: the translations that lead there; see ``ParallelRods.inverse``.

    The pose is given by the inputs ``platform_position`` [m] and ``platform_rotation`` (rotation vector in the world [rad]); the
    loads are those of ``ParallelRods``. Unknowns are counted from an input ``translation``; in a solution,
    ``inputs.translation`` is what was found, for the drives.

    Every equilibrium that is found, also from a guess and along a motion, is tested: an unstable one is a failure with the status
    ``UNSTABLE``, one whose translations are beyond ``limits`` or leave no leg in use is ``OUT_OF_LIMITS``.

    Args:
        robot: The robot.
        limits: As for ``ParallelRods.inverse``.

    Attributes:
        limits: Least and greatest translation of each leg [m], shape (2, 6).
    """

    length_columns: ClassVar[bool] = True

    def __init__(self, robot: ParallelRods, *, limits: Limits | None = None) -> None:
        instance("InverseParallelRods.robot", robot, ParallelRods, "ParallelRods")
        legs = robot.legs
        if len(legs) != 6 or not all(isinstance(leg, Rod) for leg in legs):
            kinds = " and ".join(sorted({type(leg).__name__ for leg in legs}))
            refuse(
                "ParallelRods.legs",
                Described(f"{len(legs)} of {kinds}"),
                "the inverse problem needs 6 legs, each a Rod: a pose has 6 numbers; mr.reach takes any",
            )
        if any(leg.has_conditions for leg in robot.geometry.legs):
            refuse("ParallelRods.legs", list(legs), "the inverse problem takes no line that is driven by its displacement")
        self.robot = robot
        self.limits = _limits(limits, len(legs))
        self.geometry = robot.geometry
        self.rods = robot.rods
        self.mass_carried = robot.mass_carried

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of the rods' parameters and of the poses."""
        return self.robot.batch_shape

    if TYPE_CHECKING:
        _input_name: InverseParallelRodsInput

    @listed(*POSE_INPUTS, *INPUTS, *DRIVE_INPUTS)
    def inputs(self, **values: Unpack[InverseParallelRodsInputs]) -> Inputs:  # type: ignore[override]  # noqa: D102  (as ``listed`` says)
        result = super().inputs(**InverseParallelRodsInputs(**values))
        bent = (section.precurvature for rod in self.rods for section in rod.sections)
        if not any(not isinstance(own, np.ndarray) or own.any() for own in bent):
            plausibility.of_leg_lines(*self._ends(result), result.platform_position)
        return result

    def _ends(self, inputs: Inputs) -> tuple[FloatArray, FloatArray]:
        """Where legs begin, shape (..., 6, 3), and where they are held by the platform, in the world [m]."""
        position, turn = inputs.platform_position[..., None, :], matrices(inputs.platform_rotation)[..., None, :, :]
        base, platform = self.geometry.base, self.geometry.platform[..., :3, 3:]
        return base[..., :3, 3], position + (turn @ platform)[..., 0]

    @property
    def input_specs(self) -> tuple[InputSpec, ...]:  # noqa: D102
        return InputSpecs((*POSE_INPUTS, *self.robot.input_specs))

    @property
    def backbones(self) -> tuple[Backbone, ...]:  # noqa: D102
        return self.robot.backbones

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        self.robot.check(inputs)
        base, attached = self._ends(inputs)
        apart = np.linalg.norm(attached - base, axis=-1)
        if (none := apart <= ROUNDED * self.longest).any():
            *where, leg = np.argwhere(none)[0].tolist()
            given = np.broadcast_to(inputs.platform_position, (*none.shape[:-1], 3))[tuple(where)].tolist()
            refuse("platform_position", given, f"leg {leg} would end where it begins, nothing of it in use")

    def input_directions(self, *names: str) -> dict[str, Any]:  # noqa: D102
        return self.robot.input_directions(*names)

    def surely_takes(self, name: str, values: Sequence[float]) -> bool:  # noqa: D102
        return self.robot.surely_takes(name, values)

    @reusable
    def problem(self, inputs: Inputs, **options: Any) -> ParallelProblem:  # noqa: ANN401, D102  (of ``ParallelProblem``)
        return self.robot.problem(inputs, inverse=True, limits=self.limits, **options)

    def features(self, inputs: Inputs, *, enabled: Iterable[str] = ()) -> tuple[Features, ...]:  # noqa: D102
        return self.robot.features(inputs, enabled=enabled)

    def with_rods(self, rods: Sequence[Rod]) -> "InverseParallelRods":  # noqa: D102
        return InverseParallelRods(self.robot.with_rods(rods), limits=self.limits)

    def translations(self, solution: "Found") -> FloatArray:
        """Translation of each leg [m], shape (..., 6), as ``solution.inputs.translation``; NaN where the solution failed.

        Raises:
            TypeError: If the solution is none of an inverse problem.
        """
        robot = solution.assembly
        if not isinstance(robot, InverseParallelRods):
            raise TypeError(f"translations() takes a solution of an inverse problem; this is one of {type(robot).__name__}")
        return np.asarray(solution._applied.translation + robot._lengths(solution) ** 2 * solution.unknowns[..., -6:])

    def inputs_of(self, found: "Found") -> Inputs:
        """With the translations that were found, NaN of what failed."""
        arrays = found._applied.arrays | {"translation": frozen(self.translations(found))}
        return found._applied.with_arrays(arrays, found.batch_shape)

    def begin_at(self, unknowns: FloatArray, found: "Found", problem: Any, piece: Any) -> FloatArray:  # noqa: ANN401  (an index)
        """(10) Counted from the translations that the problem is given."""
        given = found._each(found._applied.translation)
        more = (given if len(given) == 1 else given[piece]) - problem.read("inputs")[:, problem.input_slice("translation")]
        return np.concatenate([unknowns[:, :-6], unknowns[:, -6:] + more / problem.length[:, :6] ** 2], axis=1)

    def _lengths(self, solution: "Found") -> FloatArray:
        lengths = self.geometry.scales()[0].reshape(*self.geometry.batch_shape, -1)[..., :-1]
        return solution._parameter(lengths, 1)  # of the instances at hand: a solution may hold some of a batch of robots

    def beyond_limits(self, solution: "Solution", instance: int) -> str:  # noqa: D102
        length = np.broadcast_to(self._lengths(solution), (*solution.batch_shape, 6)).reshape(-1, 6)[instance]
        x = solution._records[instance, solution._scene.fields["unknowns"]][-6:]
        found = solution._each(solution._applied.translation)[instance] + length**2 * x
        low, high = np.maximum(self.limits[0], -length), self.limits[1]
        beyond = np.maximum(low - found, found - high)
        k = int(beyond.argmax())
        if not beyond[k] >= 0:
            return ""
        return f", the translation of leg {k} would be {found[k]:.4g} m, allowed are {low[k]:.4g} to {high[k]:.4g}"

    def __repr__(self) -> str:
        limits = f"limits={self.limits.tolist()}" if np.isfinite(self.limits).any() else ""
        return f"{self.robot!r}.inverse({limits})"


def _limits(value: object, count: int) -> FloatArray:
    """Least and greatest translation of each leg [m], shape (2, count)."""
    if value is None:
        return np.repeat([[-inf], [inf]], count, axis=1)
    pair = list(value) if isinstance(value, (list, tuple)) or (type(value) is np.ndarray and value.ndim) else []
    if len(pair) != 2:
        refuse("inverse.limits", value, "must be a pair (low, high)")
    ends = [array("inverse.limits", end, finite=False) for end in pair]
    if any(end.shape not in ((), (count,)) or np.isnan(end).any() for end in ends) or (ends[0] > ends[1]).any():
        refuse("inverse.limits", value, f"must be (low, high), each a number or {count}, with low <= high")
    return np.stack([np.broadcast_to(end, count) for end in ends])
