"""What rods are joined to: rigid bodies, and the ground."""

from collections.abc import Mapping, Sequence

import numpy as np

from multirod import plausibility
from multirod.frames import pose as checked_pose
from multirod.naming import meant, names_checked
from multirod.read_only import ReadOnly
from multirod.types import Numbers, Poses
from multirod.validation import Described, FloatArray, array, frozen, nonnegative_float, refuse


class Ground:
    """What does not move, the world or the ``base`` of a ``Network``. There is one, ``mr.ground``."""

    name = "ground"

    def frame(self, name: str) -> FloatArray:
        """It has none: what stands there is told by its pose."""
        refuse("frame", name, "must not be given: the ground has no frames, a fixed body has")

    def __repr__(self) -> str:
        return "ground"


ground = Ground()
BY_RODS = "bodies are joined by rods alone; for a hinge between two, clamp a short stiff rod to one and join its tip to the other"


class Body(ReadOnly):
    """A rigid body that rods hold and that other rods may stand on: a platform, a disc, an object that is carried.

    Args:
        name: By which inputs and results call it.
        mass: [kg]; gravity acts on it at ``mass_centre``.
        mass_centre: In the frame of the body [m], shape (3,); only with a ``mass``.
        pose: About where it is, in the frame of the ground, shape (4, 4): where the search begins. By default it follows from the
            rods at rest. A fixed body is there, and must have one.
        frames: Places on it by name, poses in its frame, shape (4, 4): where joints are, ``mr.Joint(..., to=body, pose="left")``,
            or what is the end effector, ``mr.Network(..., end_effector=("top", "tool"))``.
        fixed: Whether it stays there, but for what the inputs ``fixed_position`` and ``fixed_rotation`` move it by: a hand that
            holds it. It has no mass, and no loads act on it.

    Raises:
        ValueError: If the name is empty or ``"ground"``, a number is out of range, a pose is none, or there is a
            ``mass_centre`` without a mass; if a fixed body has no pose, or a mass.
    """

    instead = "make another Body(...), and a network of it"

    @names_checked
    def __init__(
        self,
        name: str,
        *,
        mass: float = 0.0,
        mass_centre: Numbers = (0.0, 0.0, 0.0),
        pose: Poses | None = None,
        fixed: bool = False,
        frames: Mapping[str, Poses] | None = None,
    ) -> None:
        self.name = name_of("Body.name", name)
        if frames is not None and not isinstance(frames, Mapping):
            raise TypeError(f"Body.frames = {frames!r} is not allowed: must be a mapping of names to poses")
        self.frames: dict[str, FloatArray] = {
            frame_name(key): frozen(one_pose(f"Body.frames[{key!r}]", value)) for key, value in (frames or {}).items()
        }
        if not isinstance(fixed, (bool, np.bool_)):
            raise TypeError(f"Body.fixed = {fixed!r} is not allowed: must be True or False")
        self.fixed = bool(fixed)
        self.mass = nonnegative_float("Body.mass", mass)
        plausibility.of_body(self.name, self.mass)
        self.mass_centre = vector("Body.mass_centre", mass_centre)
        if self.mass_centre.any() and not self.mass:
            refuse("Body.mass_centre", mass_centre, "must not be given without a mass: where nothing weighs it does nothing")
        self.pose = None if pose is None else one_pose("Body.pose", pose)
        if self.fixed and pose is None:
            refuse("Body.pose", None, "must be given of a fixed body: it stands there")
        if self.fixed and self.mass:
            refuse("Body.mass", mass, "must be 0 of a fixed body: its weight does nothing")

    def frame(self, name: str) -> FloatArray:
        """Pose of one of its ``frames`` in its own, shape (4, 4).

        Raises:
            ValueError: If there is none of that name.
        """
        if name not in self.frames:
            known = ", ".join(map(repr, self.frames)) or "none: it has no frames, mr.Body(..., frames={...})"
            refuse("frame", name, f"must be one of those of body {self.name!r}: {known}{meant(name, self.frames)}")
        return self.frames[name]

    def __repr__(self) -> str:
        more = f", mass={self.mass:g}" * bool(self.mass) + ", fixed" * self.fixed
        return f"Body({self.name!r}{more})"


def standing(field: str, value: object) -> Body | Ground:
    """What a whole robot stands on."""
    if not isinstance(value, (Body, Ground)):
        raise TypeError(f"{field} = {value!r} is not allowed: must be mr.ground or a Body, not {type(value).__name__}")
    if isinstance(value, Body) and not value.fixed:
        refuse(field, value, "must be mr.ground, or a fixed body: nothing would hold it")
    return value


def name_of(field: str, value: object) -> str:
    """A name that tells a rod or body from others."""
    if not isinstance(value, str) or not value or value == Ground.name:
        refuse(field, value, "must be a name, and not 'ground'")
    return value


def number_of(body: object, bodies: Sequence[Body]) -> int:
    """Which of some bodies that is, or has this name."""
    names = [own.name for own in bodies]
    name = body.name if isinstance(body, Body) else body
    if not isinstance(name, str) or name not in names:
        hint = meant(name, names) if isinstance(name, str) else ""
        refuse("body", body, f"must be one of {', '.join(map(repr, names)) or 'none: there are no bodies'}{hint}")
    return names.index(name)


def place_of(body: str, frame: str) -> str:
    """What a frame of a body is called among what forces act on."""
    return f"{frame} of {body}"


def frame_name(value: object) -> str:
    """A name of a frame."""
    if not isinstance(value, str) or not value:
        refuse("Body.frames", value, "must be by name")
    return value


def vector(field: str, value: object) -> FloatArray:
    """Three numbers."""
    result = array(field, value, (3,))
    if result.shape != (3,):
        refuse(field, Described(f"array of shape {result.shape}"), "must have shape (3,)")
    return result


def one_pose(field: str, value: object) -> FloatArray:
    """One pose (4, 4)."""
    result = checked_pose(field, value)
    if result.ndim > 2:
        refuse(field, Described(f"array of shape {result.shape}"), "must have shape (4, 4)")
    return result
