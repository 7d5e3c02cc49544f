"""Robots of ``tests/random_legs.py`` on segments, where a solution has them: an energy that is not the package's judges them."""

from itertools import pairwise
from typing import Any

import numpy as np
from leg_energy import Leg, LegEnergy
from random_legs import Drawn
from relaxation import rotation, vector_of
from tube_leg_energy import TubeLeg, TubeOnNodes

FINE = 4  # nodes of a shape for each segment, between which frames are interpolated


def on_segments(drawn: Drawn, solution: Any, count: int) -> LegEnergy:
    """The robot, each leg on ``count`` segments, one or two more of tubes, whose sections end nodes."""
    length = np.mean([leg[0][0]["length"] for leg in drawn.sections if len(leg) == 1] or [_reach(drawn.sections[0][0])])
    EI = np.mean([np.max(leg[0][0]["bending_stiffness"]) for leg in drawn.sections])
    legs, number = [], 0
    for k, rods in enumerate(drawn.sections):
        base, end = drawn.base[k].copy(), drawn.platform[k].copy()
        base[:3, 3] /= length
        end[:3, 3] /= length
        make = _tubes if len(rods) > 1 else _rod
        legs.append(make(drawn, solution, count, number, rods, (base, end, drawn.joints[k], drawn.axes[k]), length, EI))
        number += len(rods)
    force, moment = (np.asarray(drawn.loads.get(name, np.zeros(3))) for name in ("tip_force", "tip_moment"))
    result = LegEnergy(legs, np.array(solution.tip_position) / length, np.array(solution.tip_rotation), force * length**2 / EI)
    result.moment = moment * length / EI
    return result


def _reach(sections):
    return sum(section["length"] for section in sections)


def _stiffness(section):
    return np.array([*np.broadcast_to(section["bending_stiffness"], 2), section["torsional_stiffness"]])


def _rod(drawn, solution, count, number, rods, ends, length, EI):
    ((section,),) = rods
    base, *others = ends
    base[:3, :3] = base[:3, :3] @ rotation(np.array([0, 0, drawn.loads["rotation"][number]]))
    found, axial = solution.rod(number, nodes=count + 1), section.get("axial_stiffness")
    return Leg(
        (section["length"] + drawn.loads["translation"][number]) / length,
        _stiffness(section) / EI,
        None if axial is None else axial * length**2 / EI,
        np.array(section["precurvature"]) * length,
        base,
        *others,
        np.array(found.rotation),
        np.zeros(count + 1) if axial is None else found.force[:, 2] / axial,
    )


def _tubes(drawn, solution, count, number, rods, ends, length, EI):
    turned, pushed = (drawn.loads[name][number : number + len(rods)] for name in ("rotation", "translation"))
    edges = [beta + np.cumsum([0.0, *(section["length"] for section in rod)]) for rod, beta in zip(rods, pushed, strict=True)]
    tips = np.array([own[-1] for own in edges])
    order = np.argsort(-tips, kind="stable")  # the one that reaches the tip comes first
    cuts = sorted({0.0, *(place for own in edges for place in own if place > 0)})
    nodes = [np.zeros(1)]
    for a, b in pairwise(cuts):
        nodes.append(np.linspace(a, b, max(2, round(count * (b - a) / cuts[-1])) + 1)[1:])
    nodes = np.concatenate(nodes)
    frames = [_frames_at(solution.rod(number + i, nodes=FINE * count + 1), nodes[nodes <= tips[i]]) for i in order]
    tubes = []
    for i, own in zip(order, frames, strict=True):
        middle = 0.5 * (nodes[1:] + nodes[:-1])[: len(own) - 1]
        section = [rods[i][np.searchsorted(edges[i][1:], s)] for s in middle]
        give, twist = 0.0, 0.0
        for (a, b), behind in zip(pairwise(edges[i]), rods[i], strict=True):
            part = min(b, 0.0) - min(a, 0.0)
            give += part / behind["torsional_stiffness"]
            twist += part * behind["precurvature"][2]
        relative = np.swapaxes(frames[0][: len(own)], 1, 2) @ own
        tubes.append(
            TubeOnNodes(
                np.array([_stiffness(s) for s in section]) / EI,
                np.array([s["precurvature"] for s in section]) * length,
                turned[i] + twist,
                give * EI / length,
                np.unwrap(np.arctan2(relative[:, 1, 0], relative[:, 0, 0])),
            )
        )
    N = len(nodes) - 1
    own = (tips.max() / length, np.zeros(3), None, np.zeros(3), *ends, frames[0], np.zeros(N + 1))
    return TubeLeg(*own, nodes / tips.max(), tubes)


def _frames_at(shape, places):
    """Frames (place, 3, 3) of a shape between its nodes."""
    s, R = np.asarray(shape.arclength), np.asarray(shape.rotation)
    at = np.clip(np.searchsorted(s, places) - 1, 0, len(s) - 2)
    share = (places - s[at]) / (s[at + 1] - s[at])
    step = vector_of(np.swapaxes(R[at], 1, 2) @ R[at + 1])
    return R[at] @ rotation(share[:, None] * step)
