"""How the rods of a network vary along themselves. Numbers in parentheses are those of ``docs/derivatives.md``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from multirod.models.backbone.derivatives.along import AlongPass, along_member, of_member
from multirod.models.network.elements.elements import TURNING
from multirod.rotations import cross
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.elements.groups import RodGroup
    from multirod.models.network.problem import NetworkProblem


def find_rod(problem: "NetworkProblem", rod: int) -> tuple["RodGroup", int, int]:
    """Of a rod or tube, counted as results count them: what integrates it, where among its members, and which of its tubes.

    Raises:
        NotImplementedError: If it slides through holes.
    """
    graph = problem.graph
    whole = int(np.searchsorted(graph.first_tube, rod, side="right")) - 1
    pieces = graph.slides.of(whole)
    if len(pieces) > 1:
        name = graph.whole_names[whole]
        raise NotImplementedError(f"derivatives along {name!r} are not known: it slides through holes, its arclengths with it")
    group = next(group for group in problem.groups if pieces[0] in group.members)
    return group, int(np.flatnonzero(group.members == pieces[0])[0]), rod - int(graph.first_tube[whole])


def columns_along(problem: "NetworkProblem", names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:
    """(D21) What ``NetworkProblem.along`` returns."""
    group, place, tube = find_rod(problem, rod)
    problem.hand_over()
    found, lever = along_member(group.backbones, tube, place, places)
    base, move, turn = base_columns(problem, names, int(group.members[place]))
    beta = np.swapaxes(base, 1, 2) @ turn
    result = {name: by_network(problem, group, place, values, beta) for name, values in found.items()}
    for name in ("position", "rotation"):
        result[name] = base[:, None] @ result[name]
    arm = (base[:, None] @ lever[..., None])[..., 0]
    result["rotation"] += turn[:, None]
    result["position"] += move[:, None] + np.swapaxes(cross(np.swapaxes(turn, 1, 2)[:, None], arm[:, :, None]), 2, 3)
    return result


def base_columns(problem: "NetworkProblem", names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(1), (4), (5) of ``docs/networks.md``: the frame of a rod's base, (instance_count, 3, 3), and how it moves and turns, in
    the world, by the unknowns, then by each number that is named, each of shape (instance_count, 3, n + k)."""
    n, layout, state = problem.unknown_count, problem.layout, problem.state()
    graph, end = problem.graph, state.ends[0]
    directions = np.concatenate([problem.directions_by(name) for name in names], axis=1)
    move, turn = np.zeros((2, problem.instance_count, 3, n + len(directions[0])))
    by_angles = end.frame[:, rod] @ end.joints.turns[:, rod]
    at = problem.places[rod, layout.angles_at[0]]
    for j in np.flatnonzero(at >= 0).tolist():
        turn[..., at[j]] = problem.length[:, rod, None] * by_angles[..., j]
    if (graph.driven_at[0][rod] >= 0).any():  # (24) there
        first = problem.input_slice("angle").start
        for j in np.flatnonzero(graph.driven_at[0][rod] >= 0).tolist():
            rate = directions[..., first + graph.driven_at[0][rod, j]]
            turn[..., n:] += by_angles[..., j, None] * rate[:, None]
    holder = int(graph.ends[0].frame[rod])
    if holder:
        pose, frames, body = problem.places[rod, layout.poses_at[0]], state.frames, holder - 1
        size = problem.length[:, problem.rod_count + body, None, None]
        turns = frames.turns[:, holder]
        arm = end.position[:, rod] - frames.position[:, holder]
        move[..., pose[:3]] = size**2 * frames.axes[:, body]
        move[..., pose[3:]] = np.swapaxes(cross(np.swapaxes(turns, 1, 2), arm[:, None]), 1, 2)
        turn[..., pose[3:]] = turns
    return end.rotation[:, rod], move, turn


def by_network(problem: "NetworkProblem", group: "RodGroup", place: int, found: FloatArray, beta: FloatArray) -> FloatArray:
    """(D21) Columns of a rod in its base, (instance_count, ..., m + turns + k), as columns (..., n + k) by the unknowns of the
    network, then by each number that is named; ``beta`` is how the base turns, in its own axes."""
    n, m, k = problem.unknown_count, group.backbones.unknown_count, beta.shape[2] - problem.unknown_count
    turns = TURNING * group.turns
    result = np.zeros((*found.shape[:-1], n + k))
    result[..., problem.places[group.members[place], :m]] = found[..., :m]
    result[..., n:] = found[..., m + turns : m + turns + k]
    if turns:
        result += found[..., m : m + turns] @ beta[:, None]
    return result


class NetworkSensing:
    """A ``NetworkProblem``'s integration that tells its rods' curvatures at some places too.

    Args:
        problem: The problem.
        places: Rising arclengths (count,); of a rod, those past its end are not.
        launches: Of its own integration: the first, three of each build, and the last.
    """

    def __init__(self, problem: "NetworkProblem", places: FloatArray, launches: Sequence[Any]) -> None:
        self.problem = problem
        self._passes: list[AlongPass] = [group.backbones.sensing(places) for group in problem.groups]
        self._launches = list(launches)
        self._launches[2:-1:3] = self._passes

    def launch(self) -> None:
        """Integrate."""
        self.problem.integrate_by(self._launches)

    def curvature(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """Of the last launch, as ``BoundaryProblem.sensed`` says."""
        problem = self.problem
        group, place, tube = find_rod(problem, rod)
        found = self._passes[problem.groups.index(group)].curvature(tube)
        curvature, columns = (of_member(values, problem.instance_count, place) for values in found)
        base, _, turn = base_columns(problem, names, int(group.members[place]))
        return curvature, by_network(problem, group, place, columns, np.swapaxes(base, 1, 2) @ turn)
