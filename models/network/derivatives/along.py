"""How the rods of a network vary along themselves. Numbers in parentheses are those of ``docs/derivatives.md``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from multirod.models.backbone.derivatives.along import Along, AlongPass, PosesAlong, along_member, of_member
from multirod.models.backbone.derivatives.designs import POSE
from multirod.models.network.derivatives.designs import Aim, by_numbers
from multirod.models.network.elements.elements import TURNING
from multirod.models.network.places import FIXED
from multirod.models.network.poses import ground_of
from multirod.problem import PosesSensed
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
    found = along_member(group.backbones, tube, place, places)
    return of_network(problem, problem.aim_of(names), group, place, found).columns


def of_network(problem: "NetworkProblem", aim: Aim, group: "RodGroup", place: int, found: Along) -> Along:
    """(D21) What is told along a rod in the frame of its base, as it is in the world, with columns by the network's unknowns and
    numbers; its places from the origin of the ground."""
    member, n = int(group.members[place]), problem.unknown_count
    base, move, turn = base_columns(problem, aim, member)
    beta = np.swapaxes(base, 1, 2) @ turn
    columns = {name: by_network(problem, aim, group, place, values, beta) for name, values in found.columns.items()}
    for name in columns.keys() - {"curvature"}:
        columns[name] = _turned(base, columns[name])
    arms = {name: _turned(base, arm[..., None])[..., 0] for name, arm in found.arms.items()}
    result = Along(columns, arms)
    result.turn(np.swapaxes(turn, 1, 2), slice(None))
    if "position" in columns:
        columns["position"] += move[:, None]
        arms["position"] += (problem.state().ends[0].position[:, member] - ground_of(problem)[0])[:, None]
    for own in aim.numbers_of("base"):
        result.carry(slice(n + own.start, n + own.stop))
    for values in columns.values():
        at_rates(problem, aim, values)
    return result


def _turned(base: FloatArray, values: FloatArray) -> FloatArray:
    """Vectors, three rows each (b, count, rows, column), turned by frames (b, 3, 3)."""
    vectors = values.reshape(*values.shape[:2], -1, 3, values.shape[-1])
    return np.asarray((base[:, None, None] @ vectors).reshape(values.shape))


def at_rates(problem: "NetworkProblem", aim: Aim, values: FloatArray) -> None:
    """(D9) In place: columns (..., 3, n + k) by numbers at fixed unknowns, not at what the unknowns stand for."""
    if aim.is_parameter and not problem.eliminates:
        n = problem.unknown_count
        values[..., n:] -= values[..., :n] @ aim.unknown_rates()[:, None]


def base_columns(problem: "NetworkProblem", aim: Aim, rod: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(1), (4), (5), (34), (35) of ``docs/networks.md``: the frame of a rod's base, (instance_count, 3, 3), and how it moves and
    turns, in the world, by the unknowns, then by each number that is named, each of shape (instance_count, 3, n + k)."""
    n, layout, state = problem.unknown_count, problem.layout, problem.state()
    graph, end, frames = problem.graph, state.ends[0], state.frames
    directions = np.array(problem.buffer("directions"))
    size = sum(columns.numbers for columns in aim.every)
    move, turn = np.zeros((2, problem.instance_count, 3, n + size))
    along_move, along_turn = np.zeros((2, problem.instance_count, 3, directions.shape[1]))
    by_angles, by_slides = end.frame[:, rod] @ end.joints.turns[:, rod], end.frame[:, rod] @ end.joints.slides[rod]
    at = problem.places[rod, layout.angles_at[0]]
    for j in np.flatnonzero(at >= 0).tolist():
        turn[..., at[j]] = problem.length[:, rod, None] * by_angles[..., j]
        move[..., at[j]] = problem.length[:, rod, None] * by_slides[..., j]
    for j in np.flatnonzero(graph.driven_at[0][rod] >= 0).tolist():  # (24) there
        along = directions[..., problem.driven_place.start + graph.driven_at[0][rod, j]][:, None]
        along_turn += by_angles[..., j, None] * along
        along_move += by_slides[..., j, None] * along
    holder, stand = int(graph.ends[0].frame[rod]), int(graph.ends[0].stand[rod])
    arm = end.position[:, rod] - frames.position[:, stand]
    if holder:
        pose, body = problem.places[rod, layout.poses_at[0]], holder - 1
        length = problem.length[:, problem.rod_count + body, None, None]
        turns = frames.turns[:, holder]
        move[..., pose[:3]] = length**2 * frames.axes[:, body]
        move[..., pose[3:]] = np.swapaxes(cross(np.swapaxes(turns, 1, 2), arm[:, None]), 1, 2)
        turn[..., pose[3:]] = turns
    elif stand:
        k = stand - problem.body_count - 1
        moved, turned = (directions[..., problem.input_slice(name)][..., 3 * k : 3 * k + 3] for name in FIXED)
        turned = turned @ np.swapaxes(frames.turns[:, stand], 1, 2)
        along_turn += np.swapaxes(turned, 1, 2)
        along_move += np.swapaxes(moved + cross(turned, np.broadcast_to(arm[:, None], turned.shape)), 1, 2)
    axes = frames.rotation[:, stand] if stand else ground_of(problem)[1]
    for columns in aim.every:
        if columns.name == "joint_pose":
            along_move[..., columns.start : columns.start + 3] += axes
            along_turn[..., columns.start + 3 : columns.start + POSE] += axes
            slid = (end.frame[:, rod] @ end.joints.moved[:, rod, :, None])[..., 0]  # (36) which goes with the pose
            turned = cross(np.swapaxes(axes, 1, 2), np.broadcast_to(slid[:, None], axes.shape))
            along_move[..., columns.start + 3 : columns.start + POSE] += np.swapaxes(turned, 1, 2)
    move[..., n:], turn[..., n:] = (by_numbers(aim.every, rod, values) for values in (along_move, along_turn))
    return end.rotation[:, rod], move, turn


def by_network(
    problem: "NetworkProblem", aim: Aim, group: "RodGroup", place: int, found: FloatArray, beta: FloatArray
) -> FloatArray:
    """(D21) Columns of a rod in its base, (instance_count, ..., m + turns + d), as columns (..., n + k) by the unknowns of the
    network, then by each number that is named; ``beta`` is how the base turns, in its own axes."""
    n, m, rod = problem.unknown_count, group.backbones.unknown_count, int(group.members[place])
    turns = TURNING * group.turns
    result = np.zeros((*found.shape[:-1], beta.shape[2]))
    result[..., problem.places[rod, :m]] = found[..., :m]
    result[..., n:] = by_numbers(aim.every, rod, found[..., m + turns : m + turns + problem.direction_count])
    if turns:
        result += found[..., m : m + turns] @ beta.reshape(len(beta), *(1,) * (found.ndim - beta.ndim), *beta.shape[1:])
    return result


class NetworkSensing:
    """A ``NetworkProblem``'s integration that tells more, at some places along its rods: a ``Sensing``.

    Args:
        problem: The problem.
        places: Rising arclengths (count,); of a rod, those past its end are not.
        launches: Of its own integration: the first, three of each build, and the last.
    """

    def __init__(self, problem: "NetworkProblem", places: FloatArray, launches: Sequence[Any]) -> None:
        self.problem = problem
        self._passes: list[AlongPass] = [group.backbones.derivatives.sensing(places) for group in problem.groups]
        self._launches = list(launches)
        self._launches[2:-1:3] = self._passes

    def launch(self) -> None:
        """Integrate."""
        self.problem.integrate_by(self._launches)

    def curvature(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """Of the last launch, as ``Sensing`` says."""
        problem = self.problem
        group, place, tube = find_rod(problem, rod)
        found = self._passes[problem.groups.index(group)].curvature(tube)
        curvature, columns = (of_member(values, problem.instance_count, place) for values in found)
        aim = problem.aim_of(names)
        base, _, turn = base_columns(problem, aim, int(group.members[place]))
        columns = by_network(problem, aim, group, place, columns, np.swapaxes(base, 1, 2) @ turn)
        at_rates(problem, aim, columns)
        return curvature, columns

    def poses(self, names: Sequence[str], rod: int) -> PosesSensed:
        """Of the last launch, as ``Sensing`` says."""
        problem = self.problem
        group, place, tube = find_rod(problem, rod)
        found = self._passes[problem.groups.index(group)].poses(tube).of_member(problem.instance_count, place)
        told = of_network(problem, problem.aim_of(names), group, place, found)
        base = problem.state().ends[0].rotation[:, int(group.members[place]), None]
        return PosesAlong(told.columns, told.arms, base @ found.rotation).at(ground_of(problem)[0])

    def wrench(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """Of the last launch, as ``Sensing`` says."""
        problem = self.problem
        group, place, _ = find_rod(problem, rod)
        found = self._passes[problem.groups.index(group)].wrenches().of_member(problem.instance_count, place)
        told = of_network(problem, problem.aim_of(names), group, place, found)
        return told.arms["wrench"], told.columns["wrench"]
