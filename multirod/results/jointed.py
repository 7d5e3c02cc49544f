"""Where the bodies and joints of networks are."""

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from multirod.assembly import Robot_co
from multirod.results.computed import Computed
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.joining.joints import Joint


class Jointed(Computed[Robot_co]):
    """Found equilibria, and where their bodies and joints are."""

    def body_position(self, body: str | tuple[str, str]) -> FloatArray:
        """Position of the frame of a body in the world [m], shape (..., 3), or of one of its ``frames``, ``("top", "tool")``.

        Raises:
            AttributeError: If the assembly has no bodies: ``Network`` has.
            ValueError: If there is no such body or frame.
        """
        index, frame = self._frame_of(body)
        position, rotation = self._body_poses
        return self._masked(position[:, index] + rotation[:, index] @ frame[:3, 3], (3,))

    def body_rotation(self, body: str | tuple[str, str]) -> FloatArray:
        """Rotation of a body, body to world, shape (..., 3, 3).

        Raises:
            AttributeError, ValueError: As ``body_position``.
        """
        index, frame = self._frame_of(body)
        return self._masked(self._body_poses[1][:, index] @ frame[:3, :3], (3, 3))

    def _frame_of(self, body: str | tuple[str, str]) -> tuple[int, FloatArray]:
        of: Callable[[object], tuple[int, FloatArray]] | None = getattr(self.assembly, "frame_of", None)
        if of is None:
            raise AttributeError(f"{type(self.assembly).__name__} has no bodies: Network has")
        return of(body)

    def joint_angle(self, joint: "Joint | str") -> FloatArray:
        """How far a joint is turned from where its ``pose`` says [rad], whether free, on a spring or driven.

        The end of the rod is turned by it against the frame of ``pose`` on what holds it: about ``axis``, counted by the right
        hand, shape (...), of a revolute and a cylindrical joint; about both axes of a universal one, shape (..., 2), the second
        as the first has turned it; of a spherical joint by a rotation vector in that frame, shape (..., 3). It goes on past half
        a turn, and that of a spherical joint to a whole one. What ``angle`` of a driven joint gives is what this says.

        Args:
            joint: The joint at an end of a rod, or its name: that of the rod and the end, ``"arm base"``.

        Raises:
            AttributeError: If the assembly has no joints of its own: ``Network`` has.
            ValueError: If there is no such joint, or it does not turn.
        """
        return self._coordinate(joint, slides=False)

    def joint_slide(self, joint: "Joint | str") -> FloatArray:
        """How far the end of a rod has slid in a prismatic or cylindrical joint from where ``pose`` says [m], shape (...).

        Along ``axis``, in the frame of ``pose`` on what holds it, positive where the end has moved that way.

        Args:
            joint: As for ``joint_angle``.

        Raises:
            AttributeError: If the assembly has no joints of its own: ``Network`` has.
            ValueError: If there is no such joint, or it does not slide.
        """
        return self._coordinate(joint, slides=True)

    def _coordinate(self, joint: "Joint | str", *, slides: bool) -> FloatArray:
        of: Callable[..., tuple[int, int, Any]] | None = getattr(self.assembly, "coordinates_of", None)
        if of is None:
            raise AttributeError(f"{type(self.assembly).__name__} has no joints whose coordinates are told: Network has")
        end, rod, which = of(joint, slides=slides)
        values = self._joint_coordinates[:, end, rod, which]
        return self._masked(values, values.shape[1:])

    @cached_property
    def _joint_coordinates(self) -> FloatArray:
        return np.asarray(self._gather(lambda problem: (problem.state().coordinates,))[0])  # type: ignore[attr-defined]

    @cached_property
    def _body_poses(self) -> list[FloatArray]:
        return self._gather(lambda problem: problem.body_poses())  # type: ignore[attr-defined]  # of a network

    @cached_property
    def _pushed_axes(self) -> tuple[FloatArray, FloatArray]:
        """Of the coordinates of a network's joints that ``joint_torque``, then ``slide_force`` act along: where the ends of rods
        are [m], and the axes, in the world, shapes (..., k, 3)."""
        origin, axes = self._gather(lambda problem: problem.pushed_axes())  # type: ignore[attr-defined]
        return self._masked(origin, origin.shape[1:]), self._masked(axes, axes.shape[1:])
