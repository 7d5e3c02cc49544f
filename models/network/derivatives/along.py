"""How the rods of a network vary along themselves. Numbers in parentheses are those of ``docs/derivatives.md``."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.derivatives.along import Along, AlongPass, PosesAlong, Told, along_member, of_member
from multirod.models.backbone.derivatives.designs import POSE
from multirod.models.backbone.derivatives.ends import MOVED_BY
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

AT_BASE = 1e-12  # of the length, that a place at the base of a piece is behind it, where a step may end


@dataclass(frozen=True)
class Member:
    """A piece of a rod or tube that is asked about: what integrates it, where among its members, and which of its tubes."""

    group: "RodGroup"
    place: int
    tube: int

    @property
    def piece(self) -> int:
        """Its number among all pieces."""
        return int(self.group.members[self.place])


def find_rod(problem: "NetworkProblem", names: Sequence[str], rod: int) -> list[Member]:
    """The pieces of a rod or tube, counted as results count them, from its base; ``names`` are by what it is asked to vary.

    Raises:
        NotImplementedError: If it slides through holes; or if it is cut into segments whose ends these move.
    """
    graph = problem.graph
    whole = int(np.searchsorted(graph.first_tube, rod, side="right")) - 1
    pieces, tube = graph.slides.of(whole), rod - int(graph.first_tube[whole])
    if graph.slides.sliding[pieces[0]]:
        name = graph.whole_names[whole]
        raise NotImplementedError(f"derivatives along {name!r} are not known: it slides through holes, its arclengths with it")
    if len(pieces) > 1 and (moved := [name for name in names if name in MOVED_BY]):
        name = graph.whole_names[whole]
        raise NotImplementedError(f"derivatives along {name!r} by {moved[0]} are not known: it moves the ends of its segments")
    found = []
    for piece in pieces:
        group = next(group for group in problem.groups if piece in group.members)
        found.append(Member(group, int(np.flatnonzero(group.members == piece)[0]), tube))
    return found


def on_piece(problem: "NetworkProblem", piece: int, places: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(43) of ``docs/networks.md``: rising arclengths (instance_count, count) of a rod as those of one of its pieces, and which
    are there; in the place of the others stand some that rise too."""
    slides, size = problem.graph.slides, places.shape[1]
    if not slides.cut[piece]:
        return places, np.ones(places.shape, dtype=bool)
    pushed = problem.read("inputs")[:, problem.input_slice("translation")][:, problem.graph.first_tube[slides.owner[piece]]]
    length = problem.length[:, piece, None] + slides.share[piece] * pushed[:, None]
    last, number = int(slides.pieces[piece]) - 1, int(slides.order[piece])
    which = np.clip(np.floor(places / length), 0, last)
    own, local = which == number, np.maximum(places - number * length, AT_BASE * length)
    below, above = (values.sum(axis=1, keepdims=True) for values in (which < number, which > number))
    there = own.any(axis=1, keepdims=True)
    start = np.where(there, np.where(own, local, np.inf).min(axis=1, keepdims=True), 0.5 * length)
    end = np.where(there, np.where(own, local, 0.0).max(axis=1, keepdims=True), 0.5 * length)
    order = np.arange(size)
    before = start * (order + 1) / (below + 1)
    behind = end + (length - end) * (order - size + above + 1) / np.maximum(above, 1)
    return np.where(own, local, np.where(which < number, before, behind)), own


def merged(told: Sequence[Told], there: Sequence[NDArray[np.bool_]]) -> Told:
    """What is told of a rod by its pieces; ``there`` are, of each but the first, its places, (instance_count, count)."""
    result = told[0]
    for other, own in zip(told[1:], there, strict=True):
        result = result.where(own, other)
    return result


def columns_along(problem: "NetworkProblem", names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:
    """(D21) What ``NetworkProblem.along`` returns."""
    members = find_rod(problem, names, rod)
    problem.hand_over()
    local, there = zip(*(on_piece(problem, own.piece, places) for own in members), strict=True)
    told = []
    for own, at in zip(members, local, strict=True):
        found = along_member(own.group.backbones, own.tube, own.place, at)
        told.append(of_network(problem, problem.aim_of(names), own.group, own.place, found))
    return merged(told, there[1:]).columns


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
        self.problem, self._places = problem, np.asarray(places)
        self._there: dict[int, NDArray[np.bool_]] = {}  # which of these were on a piece of the last launch, where rods are cut
        self._passes: list[AlongPass] = [group.backbones.derivatives.sensing(places) for group in problem.groups]
        self._launches = list(launches)
        self._launches[2:-1:3] = self._passes

    def launch(self) -> None:
        """Integrate."""
        problem = self.problem
        if problem.graph.segments:  # how long these are may have changed
            places = np.broadcast_to(self._places, (problem.instance_count, len(self._places)))
            for group, own in zip(problem.groups, self._passes, strict=True):
                pieces = group.members.tolist()
                local, there = zip(*(on_piece(problem, piece, places) for piece in pieces), strict=True)
                own.place(np.stack(local, axis=1).reshape(-1, len(self._places)))
                self._there.update(zip(pieces, there, strict=True))
        problem.integrate_by(self._launches)

    def curvature(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """Of the last launch, as ``Sensing`` says."""
        problem, members, told = self.problem, find_rod(self.problem, names, rod), []
        aim = problem.aim_of(names)
        for own in members:
            bent = self._pass(own).curvature(own.tube)
            curvature, columns = (of_member(values, problem.instance_count, own.place) for values in bent)
            base, _, turn = base_columns(problem, aim, own.piece)
            columns = by_network(problem, aim, own.group, own.place, columns, np.swapaxes(base, 1, 2) @ turn)
            at_rates(problem, aim, columns)
            told.append(Along({"curvature": columns}, {"curvature": np.array(curvature)}))
        found = merged(told, self._beyond(members))
        return found.arms["curvature"], found.columns["curvature"]

    def poses(self, names: Sequence[str], rod: int) -> PosesSensed:
        """Of the last launch, as ``Sensing`` says."""
        problem, members, told = self.problem, find_rod(self.problem, names, rod), []
        for own in members:
            found = self._pass(own).poses(own.tube).of_member(problem.instance_count, own.place)
            along = of_network(problem, problem.aim_of(names), own.group, own.place, found)
            base = problem.state().ends[0].rotation[:, own.piece, None]
            told.append(PosesAlong(along.columns, along.arms, base @ found.rotation))
        return merged(told, self._beyond(members)).at(ground_of(problem)[0])

    def wrench(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """Of the last launch, as ``Sensing`` says."""
        problem, members, told = self.problem, find_rod(self.problem, names, rod), []
        for own in members:
            found = self._pass(own).wrenches().of_member(problem.instance_count, own.place)
            told.append(of_network(problem, problem.aim_of(names), own.group, own.place, found))
        found = merged(told, self._beyond(members))
        return found.arms["wrench"], found.columns["wrench"]

    def _pass(self, own: Member) -> AlongPass:
        return self._passes[self.problem.groups.index(own.group)]

    def _beyond(self, members: Sequence[Member]) -> list[NDArray[np.bool_]]:
        """Which places were on each piece of a rod but the first."""
        return [self._there[own.piece] for own in members[1:]]
