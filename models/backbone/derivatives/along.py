"""How a rod varies along itself: columns of position, rotation, curvature and of what it carries at given arclengths.

Numbers in parentheses are those of ``docs/derivatives.md``.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self, TypeAlias, TypeVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.launch import record
from multirod.models.backbone.derivatives.along_kernels import curvatures, poses
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.passes.buffers import holder
from multirod.problem import PosesSensed
from multirod.rotations import cross
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

Posing: TypeAlias = tuple[Any, tuple[Any, Any, Any], list[FloatArray]]
WRENCH = 6
SHARED = ("residual", "gamma", "residual_directions", "pose_columns")


def of_member(values: FloatArray, count: int, place: int) -> FloatArray:
    """Of one of several rods that each of ``count`` instances has, from what is told of all of them together, (all, ...)."""
    return np.asarray(values.reshape(count, -1, *values.shape[1:])[:, place])


def along_member(backbones: "BackboneProblem", rod: int, place: int, places: FloatArray) -> "Along":
    """What ``BackboneProblem.along_itself`` says of one of several members that each instance has, at rising ``places``
    (instance_count, count): of a ``rod`` of the member at ``place``."""
    count = len(places)
    # members of other lengths are asked at the same part of theirs
    ends = backbones.sizes.ends()[:, rod].reshape(count, -1)
    each = places[:, None] * (ends / ends[:, place, None])[..., None]
    each[:, place] = places
    return backbones.derivatives.along_itself(rod, each.reshape(-1, places.shape[1])).of_member(count, place)


class AlongPass:
    """A pass of a ``BackboneProblem`` with columns by its unknowns and its directions at some places.

    With ``shared`` it leaves all else that an integration tells in the problem's own buffers, and may take the place of one.
    """

    def __init__(self, problem: "BackboneProblem", count: int, *, shared: bool = False) -> None:
        features = replace(
            problem.features,
            nodes=True,
            along=True,
            pose=True,
            pose_sensitivities=True,
            directions=True,
            node_columns=False,
            lengths=False,
        )
        self.problem, self.layout = problem, Layout(features)
        n, batch, device = problem.unknown_count, problem.instance_count, problem.device
        columns = n + problem.direction_count
        self._call: Any = problem.buffers.call(count + 1)
        self._call.node_rod = 0
        self._places = self._call.node_arclength.numpy()[:, 1:] if problem.on_host else None
        shapes = {
            "residual": (n,),
            "gamma": (n, n),
            "residual_directions": (n, max(problem.direction_count, 1)),
            "pose_columns": (6, columns),
            "node_columns": (count + 1, 2 * self.layout.column.size + WRENCH, columns + 1),
            "line_length_columns": (problem.drive_count, columns),
        }
        for name, shape in shapes.items():
            if not (shared and name in SHARED):
                setattr(holder(self._call, name), name, wp.zeros((batch, *shape), dtype=wp.float64, device=device))
        if not shared:
            own, wrench = self._call.problem, self._call.wrench
            own.position = wp.zeros(batch, dtype=wp.vec3d, device=device)
            own.rotation = wp.zeros(batch, dtype=wp.mat33d, device=device)
            if problem.held:
                wrench.values = wp.zeros((batch, 6), dtype=wp.float64, device=device)
                wrench.columns = wp.zeros((batch, 6, columns), dtype=wp.float64, device=device)
        self._bending: dict[int, tuple[Any, Any, FloatArray | None]] = {}
        self._posing: dict[int, Posing] = {}
        self._launch = problem.lane_pass(features, self._call, columns=(n, problem.direction_count))

    def at(self, places: FloatArray, rod: int) -> "Along":
        """All that is told of a rod at rising ``places`` (instance_count, count), by unknowns, then by directions."""
        self.place(places)
        self.launch()
        posed, carrying = self.poses(rod), self.wrenches()
        bent = {"curvature": np.array(self.curvature(rod)[1])}
        return Along(posed.columns | bent | carrying.columns, posed.arms | carrying.arms)

    def place(self, places: FloatArray) -> None:
        """Be at rising ``places`` (instance_count, count) from now on."""
        if self._places is None:
            self._call.node_arclength.assign(np.concatenate([np.zeros((len(places), 1)), places], axis=1))
        else:
            self._places[:] = places

    def launch(self) -> None:
        """Integrate."""
        self._launch.launch()

    def curvature(self, rod: int) -> tuple[FloatArray, FloatArray]:
        """Of the last launch: ``u`` of a rod (instance_count, count, 3), and its columns as of ``at``; to be read at once."""
        if rod not in self._bending:
            self._bending[rod] = self._bends(rod)
        launch, bent, values = self._bending[rod]
        launch.launch()
        told = values if values is not None else bent.numpy()
        return told[..., 0], told[..., 1:]

    def _bends(self, rod: int) -> tuple[Any, Any, FloatArray | None]:
        """What finds ``curvature``: its launch, the array it writes, on the CPU as NumPy sees it in place."""
        found, layout, device = self._call.node_columns, self.layout.column, self.problem.device
        bent: Any = wp.zeros((found.shape[0], found.shape[1] - 1, 3, found.shape[3]), dtype=wp.float64, device=device)
        launch = record(curvatures, len(bent), [found, layout["frame"], layout.size, _angle(layout, rod), bent], device)
        return launch, bent, bent.numpy() if wp.get_device(device).is_cpu else None

    def poses(self, rod: int) -> "PosesAlong":
        """(D12) Of the last launch: where the places of a rod are, and how they vary, by unknowns, then by directions."""
        if rod not in self._posing:
            self._posing[rod] = self._poses(rod)
        launch, found, same = self._posing[rod]
        launch.launch()
        lever, rotation, moved = (np.array(own) for own in (same or [each.numpy() for each in found]))
        return PosesAlong({"position": moved[:, :, :3], "rotation": moved[:, :, 3:]}, {"position": lever}, rotation)

    def wrenches(self) -> "Along":
        """(D25) Of the last launch: what all rods together carry at the places, and how that varies, likewise."""
        found = self._call.node_columns.numpy()[:, 1:, -WRENCH:]
        base = self.problem.table.base_rotation.numpy().reshape(-1, 1, 1, 3, 3)
        turned = base @ found.reshape(*found.shape[:2], 2, 3, -1)
        values = turned.reshape(found.shape)
        return Along({"wrench": values[..., :-1]}, {"wrench": values[..., -1]})

    def _poses(self, rod: int) -> Posing:
        """What finds ``poses``: its launch, the arrays it writes, on the CPU as NumPy sees them in place."""
        found, layout, device = self._call.node_columns, self.layout.column, self.problem.device
        count, places, columns = found.shape[0], found.shape[1] - 1, found.shape[3] - 1
        told: tuple[Any, Any, Any] = (
            wp.zeros((count, places), dtype=wp.vec3d, device=device),
            wp.zeros((count, places), dtype=wp.mat33d, device=device),
            wp.zeros((count, places, 6, columns), dtype=wp.float64, device=device),
        )
        given = [found, layout["frame"], layout["position"], _angle(layout, rod), self.problem.table.base_rotation]
        seen = [each.numpy() for each in told] if wp.get_device(device).is_cpu else []
        return record(poses, count, [*given, *told], device), told, seen


def _angle(layout: Any, rod: int) -> int:  # noqa: ANN401  (of a layout)
    """Where the angle of a rod stands against the frame; -1 of the rod whose frame it is."""
    return int(layout["angles"]) + rod - 1 if rod else -1


@dataclass(frozen=True)
class Along:
    """What is told at places along a rod.

    Attributes:
        columns: How each of ``position``, ``rotation``, a rotation vector, ``wrench``, all in the world, and ``curvature`` in the
            frame of the rod varies, each (b, count, 3, column), of a wrench (b, count, 6, column).
        arms: What turns with the base, in the world: the ``position`` from the base [m], (b, count, 3), and the ``wrench``
            [N, N m], (b, count, 6).
    """

    columns: dict[str, FloatArray]
    arms: dict[str, FloatArray]

    def of_member(self, count: int, place: int) -> Self:
        """That of one of several rods that each of ``count`` instances has."""
        columns, arms = ({name: of_member(own, count, place) for name, own in each.items()} for each in (self.columns, self.arms))
        return replace(self, columns=columns, arms=arms)

    def where(self, there: NDArray[np.bool_], other: Self) -> Self:
        """This, with what another tells at some places, (b, count)."""
        columns = {name: np.where(there[..., None, None], other.columns[name], own) for name, own in self.columns.items()}
        arms = {name: np.where(there[..., None], other.arms[name], own) for name, own in self.arms.items()}
        return replace(self, columns=columns, arms=arms)

    def carry(self, there: slice) -> None:
        """(D10) In place: columns by a pose that all moves and turns with."""
        if "position" in self.columns:
            self.columns["position"][..., there.start : there.start + 3] += np.eye(3)
        self.turn(np.eye(3)[None], slice(there.start + 3, there.stop))

    def turn(self, turns: FloatArray, there: slice) -> None:
        """(D20) In place: columns by turns of the base, (b, column, 3) in the world."""
        for name, arm in self.arms.items():
            arms = arm.reshape(*arm.shape[:2], -1, 3)
            moved = cross(*np.broadcast_arrays(turns[:, None, None], arms[:, :, :, None]))
            self.columns[name][..., there] += np.swapaxes(moved, 3, 4).reshape(*arm.shape, -1)
        if "rotation" in self.columns:
            self.columns["rotation"][..., there] += np.swapaxes(turns, 1, 2)[:, None]


Told = TypeVar("Told", bound=Along)


@dataclass(frozen=True)
class PosesAlong(Along):
    """Where places along a rod are, besides.

    Attributes:
        rotation: The rod's frames there, body to world, shape (b, count, 3, 3).
    """

    rotation: FloatArray

    def where(self, there: NDArray[np.bool_], other: Self) -> Self:  # noqa: D102
        rotation = np.where(there[..., None, None], other.rotation, self.rotation)
        return replace(super().where(there, other), rotation=rotation)

    def at(self, base: FloatArray) -> PosesSensed:
        """From bases at positions in the world (b or 1, 3)."""
        columns = np.concatenate([self.columns["position"], self.columns["rotation"]], axis=2)
        return PosesSensed(base[:, None] + self.arms["position"], self.rotation, columns)

    def of_member(self, count: int, place: int) -> Self:  # noqa: D102
        return replace(super().of_member(count, place), rotation=of_member(self.rotation, count, place))
