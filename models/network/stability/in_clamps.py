"""The second variation by clamps along rods, where what is free at their ends does not tell it.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.rotations import cross
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem
    from multirod.models.network.state import State

PIECES = 6  # into which clamps cut each rod
SPARE = 2.0  # by how much longer pieces may be than (7) of the stability of rods has segments
GIVE = 1e-6  # of L^3/EI: what holds the end of a rod gives way by
BENT = 1e-6  # of EI/L: a moment across a rod that bends it
ALIGNED = 1e-9  # of its length, and rad: what an end may be off the axis of the other


@dataclass(frozen=True)
class InClamps:
    """Eigenvalues of some instances.

    Attributes:
        values: Over ``K/L``, ascending, shape (k, turns).
        uncertainty: How far the form is from symmetric along each eigenvector, over ``K/L``, likewise.
    """

    values: FloatArray
    uncertainty: FloatArray


def in_clamps(problem: "NetworkProblem", rows: IntArray) -> InClamps | None:
    """(45) By how clamps turn, and what is free at the ends, of the instances ``rows``; None where there can be no clamps."""
    parts = problem.parts
    if parts is None or not parts.all_clamped:
        return None
    part = parts.clamped(rows, PIECES)
    clamps = part.clamps
    assert clamps is not None  # as it is in pieces
    clamps.put(np.zeros((len(rows), clamps.size)))
    with part.at_load(np.array(problem.buffer("load_factor"))[rows]), np.errstate(all="ignore"):
        part.integrate()
        pairs, n, size = clamps.pairs, part.unknown_count, part.unknown_count + clamps.size
        pairs.update()
        gamma = np.zeros((len(rows), size, size))
        gamma[:, :n, :n] = part.read("gamma").reshape(-1, n, n)
        gamma[:, :n, n:] = part.residual_directions.numpy()[..., : clamps.size]
        gamma[:, n:, n:] = -np.eye(clamps.size)
        scale = pairs.scale.numpy()
        forces = np.append(pairs.forces, np.arange(n, size))
        others = np.setdiff1d(np.arange(n), pairs.forces)
        turned = np.concatenate(
            [pairs.columns.numpy()[:, :, :size] / scale[..., None], clamps.turned(), gamma[:, others]], axis=1
        )
        give = clamps.give()
        if give is not None:
            order = np.append(pairs.forces, others)
            places = np.append(np.arange(len(pairs.forces)), np.arange(len(forces), size))
            turned[:, places, :n] += GIVE * give[:, order]
        unit = np.concatenate([pairs.unit.numpy() * scale, clamps.unit], axis=1)
        try:
            ways = np.linalg.inv(turned)[:, :, : len(forces)]
        except np.linalg.LinAlgError:
            return None
        form = unit[:, :, None] * gamma[:, forces] @ ways / pairs.stiffness[:, None, None]
    if not np.isfinite(form).all():
        return None
    values, vectors = np.linalg.eigh(0.5 * (form + form.swapaxes(1, 2)))
    rest = 0.5 * (form - form.swapaxes(1, 2)) @ vectors
    return InClamps(values, np.linalg.norm(rest, axis=1))


def short_enough(problem: "NetworkProblem") -> NDArray[np.bool_]:
    """Of which instances no piece has a mode of its own, shape (instance_count,); after rods were integrated."""
    result = np.ones(problem.instance_count, dtype=bool)
    for group in problem.groups:
        result &= (group.backbones.stability.segments().reshape(problem.instance_count, -1) <= SPARE * PIECES).all(axis=1)
    return result


def turned_for_nothing(problem: "NetworkProblem", state: "State") -> NDArray[np.bool_]:
    """Which instances have a round rod, straight at rest, that is bent between two clamps on one axis that do not move: it may be
    turned about that, and the forces and turns of (16) tell of it nothing; shape (instance_count,)."""
    base, tip = state.ends
    still = problem.graph.held_still & (problem.graph.ends[0].table.free == 0) & (problem.graph.ends[1].table.free == 0)
    result = np.zeros(problem.instance_count, dtype=bool)
    for group in problem.groups:
        members = group.members[still[group.members]]
        if not len(members) or len(group.backbones.rods) > 1:
            continue
        arrays, own = group.backbones.arrays, group.backbones
        alike = (arrays.material[..., 0] == arrays.material[..., 1]).all(axis=(1, 2))
        bends = np.abs(arrays.precurvature.reshape(*arrays.precurvature.shape[:3], -1, 3)[..., :2]).max(axis=(1, 2, 3, 4))
        count = problem.instance_count
        round_one = np.asarray(own.each(alike & (bends == 0))).reshape(count, -1)
        moment = np.array(own.tip_wrench.numpy()[:, 3:]).reshape(count, -1, 3)
        for place, rod in enumerate(group.members.tolist()):
            if not still[rod]:
                continue
            axis, L = base.rotation[:, rod, :, 2], problem.length[:, rod]
            away = tip.position[:, rod] - base.position[:, rod]
            off = np.linalg.norm(cross(axis, away), axis=1) / L
            off = np.maximum(off, np.linalg.norm(cross(axis, tip.rotation[:, rod, :, 2]), axis=1))
            across = moment[:, place, :2]  # in the axes of the base, which is along the tip
            bent = np.linalg.norm(across, axis=1) * L > BENT * problem.stiffness[:, rod]
            result |= round_one[:, place] & (off < ALIGNED) & bent
    return result
