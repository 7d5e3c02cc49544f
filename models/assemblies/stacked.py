"""Parallel robots on top of each other, as a network."""

from collections.abc import Mapping, Sequence

from multirod.models.assemblies.concentric_tubes import ConcentricTubes
from multirod.models.assemblies.network import Network
from multirod.models.assemblies.parallel_rods import ParallelRods
from multirod.models.joint_kernels import JOINTS
from multirod.models.network.joining.bodies import Body, Ground, ground, standing
from multirod.models.network.joining.joints import Joint
from multirod.naming import names_checked
from multirod.rod import Rod
from multirod.types import Poses
from multirod.validation import Described, refuse

PAIR = ("lower", "upper")


@names_checked
def stacked(
    *robots: ParallelRods,
    names: Sequence[str] | None = None,
    end_effector: str | None = None,
    to: Body | Ground = ground,
    base: Poses | None = None,
    segments: Mapping[str, int] | None = None,
) -> Network:
    """Parallel robots on top of each other: the legs of each stand on the platform of the one before.

    Platforms are bodies by ``names``, and the legs of ``"lower"`` are the rods ``"lower 0"``, ``"lower 1"``, ...

    Args:
        *robots: From the ground up. ``base`` of the first is in the frame of the ground, of each other
            one in that of the platform below it.
        names: Of their platforms, as many; ``"lower"`` and ``"upper"`` by default, of more or less than two ``"level 1"``,
            ``"level 2"``, ...
        end_effector: Name of a platform; the last by default.
        to: What the first stands on: ``mr.ground``, or a fixed body, which inputs move.
        base: Pose of the ground in the world, shape (..., 4, 4), or a ``Pose``; the identity by default.
        segments: Into how many legs are cut that are long, soft and pulled, ``{"lower 0": 4}``, as of a ``Network``: cables.

    Returns:
        The network: loads are given by the names of platforms, ``robot.inputs(force={"upper": (0, 0, -2)})``, what legs do by
        theirs, ``rotation={"lower 0": 0.1}``, or as arrays in the order of the robots and their legs.

    Raises:
        TypeError: If a robot is not ``ParallelRods``.
        ValueError: If there is none, a leg is one that ``Network`` refuses, or names are not as many or
            not different.
    """
    if not robots:
        refuse("stacked.robots", Described("none"), "give one at least, from the ground up")
    for k, robot in enumerate(robots):
        if not isinstance(robot, ParallelRods):
            raise TypeError(f"stacked.robots[{k}] = {robot!r} is not allowed: must be ParallelRods, not {type(robot).__name__}")
    called = _names(names, len(robots))
    kinds = {code: kind for kind, code in JOINTS.items()}
    rods: dict[str, Rod | ConcentricTubes] = {}
    bodies: list[Body] = []
    joints: list[Joint] = []
    below = standing("stacked.to", to)
    if isinstance(below, Body):
        bodies.append(below)
    for name, robot in zip(called, robots, strict=True):
        geometry = robot.geometry
        platform = Body(name, mass=geometry.mass, mass_centre=geometry.mass_centre if geometry.mass else (0.0, 0.0, 0.0))
        for k, leg in enumerate(robot.legs):
            own, kind = f"{name} {k}", kinds[int(geometry.joints[k])]
            rods[own] = leg
            axis = geometry.axes[k] if kind == "revolute" else None
            joints.append(Joint(own, "base", to=below, pose=geometry.base[..., k, :, :]))
            joints.append(Joint(own, "tip", to=platform, pose=geometry.platform[..., k, :, :], kind=kind, axis=axis))  # type: ignore[arg-type]  # one of them
        bodies.append(platform)
        below = platform
    return Network(rods=rods, bodies=bodies, joints=joints, end_effector=end_effector, base=base, segments=segments)


def _names(given: Sequence[str] | None, count: int) -> tuple[str, ...]:
    if given is None:
        return PAIR if count == 2 else tuple(f"level {k + 1}" for k in range(count))
    names = tuple(given) if isinstance(given, (list, tuple)) else (given,)
    if len(names) != count:
        refuse("stacked.names", given, f"must be {count}, one for each robot")
    for name in names:
        if names.count(name) > 1:
            refuse("stacked.names", given, f"must differ: {name!r} is there twice")
    return names
