"""Which joint holds which end, through which holes rods slide, and which are cut: what is no network is refused."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from multirod import plausibility
from multirod.models.backbone.segments.cutting import uniform
from multirod.models.network.graph import ENDS, Graph
from multirod.models.network.joining.bodies import BY_RODS, Body
from multirod.models.network.joining.joints import ALONG as ALONG_ROD
from multirod.models.network.joining.joints import SLIDING, Joint
from multirod.naming import meant
from multirod.rod import Rod
from multirod.validation import Described, positive_int, refuse


def joints_by_end(joints: Sequence[Joint], rods: Mapping[str, object], bodies: Sequence[Body]) -> dict[tuple[str, str], Joint]:
    """Joints by rod and end."""
    found: dict[tuple[str, str], Joint] = {}
    for joint in joints:
        if joint.rod not in rods:
            body = f": that is a body, and {BY_RODS}" if joint.rod in [body.name for body in bodies] else meant(joint.rod, rods)
            refuse("Network.joints", joint, f"there is no rod {joint.rod!r}{body}")
        if isinstance(joint.to, Body) and joint.to not in bodies:
            refuse("Network.joints", joint, f"body {joint.to.name!r} is not among bodies")
        if joint.end == ALONG_ROD:
            continue
        if (joint.rod, joint.end) in found:
            refuse("Network.joints", joint, f"the {joint.end} of rod {joint.rod!r} is held already")
        found[joint.rod, joint.end] = joint
    try:
        np.broadcast_shapes(*(joint.pose.shape[:-2] for joint in joints))
    except ValueError:
        shapes = [joint.pose.shape[:-2] for joint in joints]
        refuse("Network.joints", Described(f"leading axes {shapes}"), "those of their poses must broadcast")
    assert {end for _, end in found} <= set(ENDS)
    return found


def holes_by_rod(joints: Sequence[Joint], rods: Mapping[str, object]) -> dict[str, list[Joint]]:
    """Holes by the rods that slide through them, from the base to the tip."""
    found: dict[str, list[Joint]] = {}
    for joint in joints:
        if joint.end == ALONG_ROD:
            found.setdefault(joint.rod, []).append(joint)
    for name, holes in found.items():
        rod = rods[name]
        if not isinstance(rod, Rod):
            refuse(f"Network.rods[{name!r}]", rod, "must be a Rod: it slides through holes")
        holes.sort(key=lambda hole: float(hole.at or 0.0))
        places = [float(hole.at or 0.0) for hole in holes]
        for hole, place, before in zip(holes, places, [0.0, *places], strict=False):
            if place >= float(np.min(rod.length)):
                refuse("Joint.at", place, f"must be less than the length of rod {name!r}, {float(np.min(rod.length)):g} m")
            if place == before:
                refuse("Joint.at", place, f"another hole of rod {name!r} is there: {hole}")
        _refuse_varied(name, rod, "it slides through holes")
    return found


def _refuse_varied(name: str, rod: Rod, why: str) -> None:
    """Refuse a rod whose pieces would not be alike."""
    if not uniform(rod):
        refuse(f"Network.rods[{name!r}]", rod, f"must be the same all along, of one section: {why}")
    if rod.carried:
        refuse(f"Network.rods[{name!r}]", rod, f"must have no members and no lines: {why}")


def segments_by_rod(given: Mapping[str, int] | None, rods: Mapping[str, object], slid: Iterable[str]) -> dict[str, int]:
    """Into how many segments rods are cut, by name; ``slid`` are those that slide through holes."""
    if given is not None and not isinstance(given, Mapping):
        raise TypeError(f"Network.segments = {given!r} is not allowed: must be a mapping of names of rods to numbers of segments")
    for name, count in (given or {}).items():
        if name not in rods:
            hint = meant(name, rods) if isinstance(name, str) else ""
            refuse("Network.segments", name, f"must be by names of rods, of {', '.join(map(repr, rods))}{hint}")
        positive_int(f"Network.segments[{name!r}]", count)
        rod, why = rods[name], "it is cut into segments"
        if not isinstance(rod, Rod):
            refuse(f"Network.rods[{name!r}]", rod, f"must be a Rod: {why}")
        _refuse_varied(name, rod, why)
        if name in slid:
            refuse(f"Network.segments[{name!r}]", count, "must not be given: it slides through holes, and is cut there")
    return {name: int(count) for name, count in (given or {}).items()}


def joints_by_name(joints: Iterable[Joint]) -> dict[str, Joint]:
    """Those at ends of rods, as they are called, ``"arm base"``."""
    return {f"{own.rod} {own.end}": own for own in joints if own.end != ALONG_ROD}


def joint_called(joints: Iterable[Joint], joint: Joint | str, *, slides: bool) -> Joint:
    """The joint at an end of a rod that is given, or has this name, ``"arm base"``, and turns or ``slides``.

    Raises:
        ValueError: If there is no such joint.
    """
    ends = joints_by_name(joints)
    moving = {name: own for name, own in ends.items() if (own.kind in SLIDING if slides else own.angles)}
    name = joint if isinstance(joint, str) else next((name for name, own in ends.items() if own is joint), None)
    if name not in moving:
        what = "slides" if slides else "turns"
        known = f"one that {what}: {', '.join(map(repr, moving)) or 'none does'}"
        other = f"; {name!r} is {ends[name].kind}" if name in ends else ""
        hole = "; where a hole is along its rod, two nodes of rod(name) say" if getattr(joint, "end", "") == ALONG_ROD else ""
        hint = meant(joint, moving) if isinstance(joint, str) and not other else ""
        refuse("joint", joint, f"must be {known}{other}{hole}{hint}")
    return moving[str(name)]


def warn_of_free_tips(graph: Graph, effector: str) -> None:
    """Say so where a rod's tip is free, and is no end effector, while rods alike on the same body all end on one."""
    joints, rods = graph.joints, dict(zip(graph.whole_names, graph.whole, strict=True))
    for name, own in rods.items():
        if (name, "tip") in joints or name == effector or name in graph.holes:
            continue
        beside = [other for other in rods if (other, "tip") in joints and joints[other, "base"].to is joints[name, "base"].to]
        like = [other for other in beside if _alike(own.rods, rods[other].rods)]
        ends = {joints[other, "tip"].to for other in like}
        if len(like) > 1 and len(ends) == 1:
            plausibility.of_free_tip(name, like, ends.pop().name)


def _alike(rods: Sequence[Rod], others: Sequence[Rod]) -> bool:
    first, second = ([part for rod in own for part in rod.sections] for own in (rods, others))
    names = ("length", "bending_stiffness")
    pairs = ((getattr(a, name), getattr(b, name)) for a, b in zip(first, second, strict=False) for name in names)
    return len(first) == len(second) and all(np.array_equal(*pair) for pair in pairs)
