"""Of robots and tasks: poses, bodies, legs, tubes, times."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from multirod.plausibility.inputs import of_angles
from multirod.plausibility.limits import (
    ASIDE,
    DEVIATION,
    DT,
    FLAT,
    LENGTH,
    PLATFORM_MASS,
    REACH,
    TURNED_BY,
    WINDING,
    largest,
)
from multirod.plausibility.warning import say
from multirod.validation import FloatArray

DEPENDENT = 1e-6  # least singular value of six lines, of the largest, below which they are none

if TYPE_CHECKING:
    from multirod.assembly import Assembly
    from multirod.inputs import Inputs, InputSpec
    from multirod.rod import Rod


def of_pose(field: str, poses: FloatArray) -> None:
    """Warn of poses that are far away."""
    LENGTH.check(f"{field} position", np.maximum(np.abs(poses[..., :3, 3]), LENGTH.low))


def of_place(field: str, position: FloatArray | None) -> None:
    """Warn of a place, of a target or measured, that is far away; what is missing of it is NaN."""
    if position is not None and not np.abs(position).max(initial=0.0) <= LENGTH.high:
        LENGTH.check(field, np.maximum(np.abs(position), LENGTH.low))


def of_leg_lines(base: FloatArray, attached: FloatArray, origin: FloatArray) -> None:
    """Warn where the lines of six straight legs, from ``base`` to where they are ``attached`` (..., 6, 3), depend on each other:
    what pushes along them does not balance every wrench on the platform, at ``origin`` (..., 3)."""
    along, arm = attached - base, attached - origin[..., None, :]
    size = np.linalg.norm(arm, axis=-1).max(axis=-1)[..., None, None]
    along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        wrenches = np.concatenate([along, np.cross(arm, along) / size], axis=-1)
    lengths = np.linalg.svd(np.nan_to_num(wrenches), compute_uv=False)
    if (lengths[..., -1] < DEPENDENT * lengths[..., 0]).any():
        say(
            "the lines from bases to attachments depend on each other at this platform_position, as everywhere where base and "
            "platform are hexagons that are alike: what pushes along them does not hold the platform every way, and translations "
            "may not be told; attach legs elsewhere, such as in pairs that cross"
        )


def of_limits(field: str, name: str, values: FloatArray) -> None:
    """Warn of limits of what tubes are moved and turned by, in other units; infinite ones are none."""
    finite = values[np.isfinite(values)]
    if name == "translation":
        of_place(field, finite)
    elif name == "rotation" and finite.size and np.any(finite):
        of_angles(field, finite, largest(finite))


def of_pose_sigma(sigma: FloatArray, placed: int) -> None:
    """Warn of standard deviations (count,) that are no measurement's: of a position the first ``placed``, then of angles."""
    position, angles = sigma[:placed], sigma[placed:]
    for own, (least, most) in ((position, DEVIATION), (angles, TURNED_BY)):
        if not own.size or not ((least < own) & (own < most)).all():
            continue
        size = float(own.max())
        if own is position:
            say(f"Pose.sigma = {size:.6g} m of a position says next to nothing of it; if it is in mm, give {1e-3 * size:.6g}")
        else:
            meant = math.radians(size)
            say(f"Pose.sigma = {size:.6g} rad of angles says next to nothing of them; if it is in degrees, give {meant:.6g}")


def of_prior_sigma(field: str, sigma: FloatArray, spec: "InputSpec", robot: "Assembly") -> None:
    """Warn of standard deviations (..., k) of a load, or of a place, that are too large for a robot of this size."""
    least, length = float(sigma.min(initial=math.inf)), robot.longest
    milli = f"if it is in m{spec.unit}, give {1e-3 * least:.6g}"
    if spec.power and not spec.on and not any(rod.members for rod in robot.rods):
        unit = robot.stiffest / length**spec.power
        if FLAT[0] * unit < least < FLAT[1] * unit:
            unit_said = f"EI/L{'' if spec.power == 1 else f'^{spec.power}'}"
            says = f"is {least / unit:.3g} {unit_said}, of which some 10 bend the robot double, and says as little as inf"
            say(f"{field} = {least:.6g} {spec.unit} {says}; {milli}")
    elif spec.unit == "m" and length < least < DEVIATION[1]:
        say(f"{field} = {least:.6g} m is more than the robot is long, {length:.6g} m; {milli}")


def of_measured_curvature(value: FloatArray, furthest: float) -> None:
    """Warn of measured curvatures (..., components) that would wind a rod up before the last place where it is measured [m]."""
    most = float(np.nanmax(np.abs(value[..., :2]), initial=0.0))
    turns = most * furthest / (2 * np.pi)
    if turns > WINDING:
        say(
            f"Curvature.value = {most:.6g} 1/m winds a rod up {turns:.3g} times within {furthest:.6g} m; it is a strain over the "
            "distance of its fibre from the axis, in 1/m"
        )


def of_legs(base: FloatArray, platform: FloatArray, mass: float, rods: "tuple[Rod, ...]") -> None:
    """Warn of legs that are further apart than they are long, and of a heavy platform."""
    longest = max(float(np.max(rod.length)) for rod in rods)
    for name, poses in (("base", base), ("platform", platform)):
        size = largest(np.linalg.norm(poses[..., :3, 3] - poses[..., :1, :3, 3], axis=-1))
        if REACH * longest < size <= LENGTH.high:
            say(
                f"ParallelRods.{name}: legs of at most {longest:.6g} m are {size:.6g} m apart; positions are in m, those of "
                "platform in the platform's frame"
            )
    if mass > PLATFORM_MASS:
        say(f"ParallelRods.platform_mass = {mass:.6g} kg is heavy for slender legs; if it is in g, give {1e-3 * mass:.6g}")


def of_body(name: str, mass: float) -> None:
    """Warn of a heavy body."""
    if mass > PLATFORM_MASS:
        say(f"Body.mass = {mass:.6g} kg of {name!r} is heavy for slender rods; if it is in g, give {1e-3 * mass:.6g}")


def of_free_tip(name: str, others: "list[str]", body: str) -> None:
    """Warn of a rod whose tip is free, where those that are like it and stand beside it all end on one body."""
    like = ", ".join(map(repr, others))
    say(
        f"Network.joints: the tip of rod {name!r} is free, and {like} beside it, which are like it, end on {body!r}; if it is a "
        f"leg too, Joint({name!r}, 'tip', to=...) is missing"
    )


def of_idle_rotation(rotation: FloatArray, joint: str) -> None:
    """Warn of a base that is turned in a joint which lets it turn back."""
    most = largest(rotation)
    if most:
        say(f"rotation = {most:.6g} rad does nothing: the base turns back in its joint, HeldRod.base_joint = {joint!r}")


def of_idle_loads(inputs: "Inputs", taken: Mapping[str, str]) -> None:
    """Warn where all that is given are loads on an end that what holds it takes; ``taken`` says what would let each act."""
    acting = [name for name in inputs.given if inputs.is_active(name)]
    if acting and taken.keys() >= set(acting):
        name = acting[0]
        given = f"{name} = {largest(inputs.array(name)):.6g} {inputs.spec(name).unit}"
        say(f"{given} does nothing: what holds the end takes it; {taken[name]}")


def of_offsets(field: str, offsets: FloatArray, rods: "Sequence[Rod]") -> None:
    """Warn of rods that are far from the line that they run along."""
    aside, length = largest(offsets), max(float(np.max(rod.length)) for rod in rods)
    if aside > ASIDE * length:
        say(
            f"{field} of {aside:.6g} m are more than half of the length, {length:.6g} m; if they are in mm, give "
            f"{1e-3 * aside:.6g}"
        )


def of_rods_through_discs(backbone: "Rod", rods: "Sequence[Rod]", offsets: FloatArray) -> None:
    """Warn of rods, at ``offsets`` (rod_count, 2), whose lengths beside a backbone that bends in two planes contradict each other
    unless motors push them just so."""
    stretches = [any(np.isfinite(section.axial_stiffness).any() for section in rod.sections) for rod in (backbone, *rods)]
    still = np.flatnonzero(~np.array(stretches[1:]))
    by_bending = offsets[still]  # how much shorter each becomes by an angle about either axis, and as the backbone stretches
    freedom = np.linalg.matrix_rank(np.column_stack([by_bending, np.ones(len(still))]) if stretches[0] else by_bending)
    if len(still) > freedom:
        say(
            f"multibackbone.rods: {len(still)} of them do not stretch, and bending gives {freedom} of their lengths alone: "
            "between discs they buckle unless they are pushed by just what fits; give axial_stiffness, or "
            "Rod.wire(..., extensible=True)"
        )


def of_nested_lines(tubes: "Sequence[Rod]") -> None:
    """Warn of lines of tubes that do not run within the tube around theirs."""
    for k, (tube, around) in enumerate(pairwise(tubes)):
        given = tube.outer_diameter if around.inner_diameter is None else around.inner_diameter
        room = 0.0 if given is None else float(np.min(given))
        for line in tube.lines if given is not None else ():
            aside = line.arm(tube.sections)
            if aside > room / 2:
                found = f"; if it is in mm, give {1e-3 * aside:.6g}" if 1e-3 * aside <= room / 2 else ""
                say(
                    f"ConcentricTubes.tubes[{k}]: a line of it is {aside:.6g} m aside of its centreline, beyond the inside of "
                    f"the tube around it, of radius {room / 2:.6g} m{found}"
                )
                return


def of_dt(field: str, dt: float, loop: str = "an observer") -> None:
    """Warn of a time step that is no step of a control loop."""
    if dt > DT:
        milli = f"if it is in ms, give {1e-3 * dt:.6g}"
        say(f"{field} = {dt:.6g} s between samples is slow for {loop}; {milli}, if a rate in Hz, {1 / dt:.6g}")
