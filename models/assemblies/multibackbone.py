"""Robots of several rods through discs, as a network."""

from collections.abc import Sequence

import numpy as np

from multirod import plausibility
from multirod.models.assemblies.network import Network
from multirod.models.backbone.segments.cutting import piece, uniform
from multirod.models.network.joining.bodies import Body, Ground, ground, standing
from multirod.models.network.joining.joints import HOLES, Joint
from multirod.naming import names_checked
from multirod.rod import Rod
from multirod.types import Numbers, Poses
from multirod.validation import FloatArray, array, choice, nonnegative_float, positive_int, refuse


@names_checked
def multibackbone(
    backbone: Rod,
    rods: Sequence[Rod],
    *,
    offsets: Numbers,
    discs: int,
    hole: str = "cylindrical",
    disc_mass: float = 0.0,
    to: Body | Ground = ground,
    base: Poses | None = None,
) -> Network:
    """A backbone that is clamped to discs, and rods beside it that slide through holes of these and are pushed at their bases.

    Discs are equally far apart along the backbone, the last at its tip, and are bodies ``"disc 1"``, ``"disc 2"``, ... from the
    ground up. The rods are ``"rod 0"``, ``"rod 1"``, ...; they are clamped to the ground and to the last disc. Between discs the
    backbone is ``"backbone 1"``, ``"backbone 2"``, ...

    Args:
        backbone: The same all along: of one section.
        rods: Those beside it, as long as it is at rest, likewise.
        offsets: Where each is in the plane of every disc [m], shape (rod_count, 2).
        discs: How many.
        hole: How rods turn in the holes of all discs but the last: ``"cylindrical"``, ``"prismatic"`` or ``"spherical"``, as of
            ``Joint``.
        disc_mass: Of each disc [kg].
        to: What it stands on: ``mr.ground``, or a fixed body, which inputs move.
        base: Pose of the ground in the world, shape (..., 4, 4), or a ``Pose``; the identity by default.

    Returns:
        The network: ``robot.inputs(translation={"rod 0": -0.002}, force={"disc 5": (0, 0, -1)})``. ``translation`` pushes a rod
        out of its base: pulled rods bend the robot to their side. Motors drive the rods, not the backbone between its discs, so
        that ``mr.reach(robot, target, free="translation")`` and a ``Controller`` push rods alone.

    Raises:
        ValueError: If there is no disc or rod, a rod is not as long as the backbone, offsets are not one pair for each rod, or
            ``Network`` refuses a rod.
        TypeError: If a rod is no ``Rod``, or ``rods`` no list of them.
    """
    count = positive_int("multibackbone.discs", discs)
    if not isinstance(rods, (list, tuple, np.ndarray)) or (isinstance(rods, np.ndarray) and not rods.ndim):
        raise TypeError(f"multibackbone.rods = {rods!r} is not allowed: must be a list of Rod, one for each pair of offsets")
    for k, rod in enumerate((backbone, *rods)):
        if not isinstance(rod, Rod):
            name = f"rods[{k - 1}]" if k else "backbone"
            raise TypeError(f"multibackbone.{name} = {rod!r} is not allowed: must be a Rod, not {type(rod).__name__}")
        if k and not np.allclose(rod.length, backbone.length, rtol=1e-9, atol=0):
            refuse(f"multibackbone.rods[{k - 1}]", rod, f"must be as long as the backbone, {float(np.min(backbone.length)):g} m")
    if not len(rods):
        refuse("multibackbone.rods", rods, "give one at least")
    if not uniform(backbone) or backbone.carried:
        refuse("multibackbone.backbone", backbone, "must be the same all along, of one section, without members or lines")
    at = _offsets(offsets, len(rods))
    plausibility.of_offsets("multibackbone.offsets", at[:, :2, 3], rods)
    plausibility.of_rods_through_discs(backbone, rods, at[:, :2, 3])
    kind = choice("multibackbone.hole", hole, HOLES)
    mass = nonnegative_float("multibackbone.disc_mass", disc_mass)
    plates = [Body(f"disc {k + 1}", mass=mass) for k in range(count)]
    short = piece(backbone, count)
    parts = {f"backbone {k + 1}": short for k in range(count)} | {f"rod {i}": rod for i, rod in enumerate(rods)}
    joints: list[Joint] = []
    below = standing("multibackbone.to", to)
    for k, plate in enumerate(plates):
        joints += [Joint(f"backbone {k + 1}", "base", to=below), Joint(f"backbone {k + 1}", "tip", to=plate)]
        below = plate
    length = float(np.min(backbone.length))
    for i, pose in enumerate(at):
        joints += [Joint(f"rod {i}", "base", to=to, pose=pose), Joint(f"rod {i}", "tip", to=plates[-1], pose=pose)]
        for k, plate in enumerate(plates[:-1]):
            joints.append(Joint(f"rod {i}", "along", at=length * (k + 1) / count, to=plate, pose=pose, kind=kind))  # type: ignore[arg-type]  # one of them
    bodies = [to, *plates] if isinstance(to, Body) else plates
    return Network(rods=parts, bodies=bodies, joints=joints, base=base, driven=[f"rod {i}" for i in range(len(at))])


def _offsets(given: Numbers, count: int) -> FloatArray:
    """Poses of the holes in the frame of a disc, shape (count, 4, 4)."""
    places = array("multibackbone.offsets", given, (2,))
    if places.shape != (count, 2):
        refuse("multibackbone.offsets", given, f"must have shape ({count}, 2): one pair for each rod")
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :2, 3] = places
    return poses
