"""How a rod varies along itself: columns of position, rotation and curvature at given arclengths.

Numbers in parentheses are those of ``docs/derivatives.md``.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.launch import record
from multirod.models.backbone.derivatives.along_kernels import curvatures
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.passes.buffers import holder
from multirod.rotations import cross
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

QUANTITIES = ("position", "rotation", "curvature")
SHARED = ("residual", "gamma", "residual_directions", "pose_columns")


def of_member(values: FloatArray, count: int, place: int) -> FloatArray:
    """Of one of several rods that each of ``count`` instances has, from what is told of all of them together, (all, ...)."""
    return np.asarray(values.reshape(count, -1, *values.shape[1:])[:, place])


def along_member(
    backbones: "BackboneProblem", rod: int, place: int, places: FloatArray
) -> tuple[dict[str, FloatArray], FloatArray]:
    """What ``BackboneProblem.along_itself`` says of one of several members that each instance has, at rising ``places``
    (instance_count, count): of a ``rod`` of the member at ``place``."""
    count = len(places)
    # members of other lengths are asked at the same part of theirs
    ends = backbones.sizes.ends()[:, rod].reshape(count, -1)
    each = places[:, None] * (ends / ends[:, place, None])[..., None]
    each[:, place] = places
    found, lever = backbones.derivatives.along_itself(rod, each.reshape(-1, places.shape[1]))
    return {name: of_member(values, count, place) for name, values in found.items()}, of_member(lever, count, place)


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
        shapes = {
            "residual": (n,),
            "gamma": (n, n),
            "residual_directions": (n, max(problem.direction_count, 1)),
            "pose_columns": (6, columns),
            "node_columns": (count + 1, 2 * self.layout.column.size, columns + 1),
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
        self._launch = problem.lane_pass(features, self._call, columns=(n, problem.direction_count))

    def at(self, places: FloatArray, rod: int) -> tuple[dict[str, FloatArray], FloatArray]:
        """Columns of ``QUANTITIES`` of a rod at rising ``places`` (instance_count, count), by unknowns, then by directions, each
        (instance_count, count, 3, column); and how far they are from the base, in the world, (instance_count, count, 3)."""
        self.place(places)
        self.launch()
        return self._quantities(self._call.node_columns.numpy()[:, 1:], rod)

    def place(self, places: FloatArray) -> None:
        """Be at rising ``places`` (instance_count, count) from now on."""
        self._call.node_arclength.assign(np.concatenate([np.zeros((len(places), 1)), places], axis=1))

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
        angle = layout["angles"] + rod - 1 if rod else -1
        launch = record(lambda: curvatures, len(bent), [found, layout["frame"], layout.size, angle, bent], device)
        return launch, bent, bent.numpy() if wp.get_device(device).is_cpu else None

    def _quantities(self, found: FloatArray, rod: int) -> tuple[dict[str, FloatArray], FloatArray]:
        """(D11), (D12)"""
        size = self.layout.column.size
        found = np.moveaxis(found, 2, -1)  # (instance, place, column, number)
        state, rate = (self.layout.column.split(found[:, :, -1:, half]) for half in (slice(size), slice(size, None)))
        column, change = (self.layout.column.split(found[:, :, :-1, half]) for half in (slice(size), slice(size, None)))
        R = np.broadcast_to(self.problem.table.base_rotation.numpy(), (len(found), 3, 3))
        q, dq = state["frame"], column["frame"]
        inverse = np.concatenate([-q[..., :3], q[..., 3:]], axis=-1) * (2 / (q**2).sum(axis=-1, keepdims=True))
        turn, curvature = _product(inverse, dq)[..., :3], _product(inverse, rate["frame"])[..., :3]
        # of q' = q u / 2
        bent = _product(inverse, change["frame"] - 0.5 * _product(dq, _pure(curvature)))[..., :3]
        unit = q / np.sqrt((q**2).sum(axis=-1, keepdims=True))
        if rod > 0:
            place = rod - 1
            angle, d_angle = state["angles"][..., place : place + 1], column["angles"][..., place : place + 1]
            c, s = np.cos(angle), np.sin(angle)
            x, y = bent[..., :1] + d_angle * curvature[..., 1:2], bent[..., 1:2] - d_angle * curvature[..., :1]
            twist = bent[..., 2:] + change["angles"][..., place : place + 1]
            bent = np.concatenate([c * x + s * y, c * y - s * x, twist], axis=-1)
            turn = turn + np.concatenate([np.zeros_like(d_angle), np.zeros_like(d_angle), d_angle], axis=-1)
        world = {"position": column["position"], "rotation": _rotated(unit, turn)}
        result = {name: np.einsum("bij,bpcj->bpic", R, values) for name, values in world.items()}
        lever = np.einsum("bij,bpj->bpi", R, state["position"][:, :, 0])
        return result | {"curvature": np.swapaxes(bent, -1, -2)}, lever


def _pure(vector: FloatArray) -> FloatArray:
    return np.concatenate([vector, np.zeros_like(vector[..., :1])], axis=-1)


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Of quaternions, scalar last."""
    a, b = np.broadcast_arrays(a, b)
    vector = a[..., 3:] * b[..., :3] + b[..., 3:] * a[..., :3] + cross(a[..., :3], b[..., :3])
    return np.concatenate([vector, a[..., 3:] * b[..., 3:] - (a[..., :3] * b[..., :3]).sum(axis=-1, keepdims=True)], axis=-1)


def _rotated(q: FloatArray, vector: FloatArray) -> FloatArray:
    """``R(q) vector``"""
    inverse = np.concatenate([-q[..., :3], q[..., 3:]], axis=-1)
    return _product(_product(q, _pure(vector)), inverse)[..., :3]
