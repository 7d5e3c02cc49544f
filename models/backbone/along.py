"""How a rod varies along itself: columns of position, rotation and curvature at given arclengths.

Numbers in parentheses are those of ``docs/derivatives.md``.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.rotations import cross, cross_matrix
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

QUANTITIES = ("position", "rotation", "curvature")
SHARED = ("residual", "gamma", "residual_directions", "pose_columns")
NODE_GAP = 1e-12  # of the length: a place this close to the end of a section is just before it


def _linear(matrix: Callable[[FloatArray], FloatArray], size: int) -> FloatArray:
    """What a vector of so many numbers is multiplied by, from the right, to give the numbers of a matrix that is linear in it."""
    return np.stack([matrix(unit).reshape(-1) for unit in np.eye(size)])


def _by_inverse(q: FloatArray) -> FloatArray:
    """Of the vector part of ``q^-1`` times a quaternion, scalar last, ``q`` of unit length."""
    return np.concatenate([q[3] * np.eye(3) - cross_matrix(q[:3]), -q[:3, None]], axis=1)


def _by_curvature(u: FloatArray) -> FloatArray:
    """Of half a quaternion times ``u``."""
    return 0.5 * np.block([[-cross_matrix(u), u[:, None]], [-u, np.zeros(1)]])


BY_INVERSE, BY_CURVATURE = _linear(_by_inverse, 4), _linear(_by_curvature, 3)


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
        self._call: Any = problem._make_call(count + 1)
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
                setattr(self._call, name, wp.zeros((batch, *shape), dtype=wp.float64, device=device))
        if not shared:
            self._call.position = wp.zeros(batch, dtype=wp.vec3d, device=device)
            self._call.rotation = wp.zeros(batch, dtype=wp.mat33d, device=device)
        self._found: FloatArray | None = None
        self._launch = problem._record(features, self._call, columns=(n, problem.direction_count))

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
        """Of the last launch: ``u`` of a rod (instance_count, count, 3), and its columns as of ``at``, by few products."""
        if self._found is None or not wp.get_device(self.problem.device).is_cpu:
            self._found = self._call.node_columns.numpy()
        found, layout, size = self._found[:, 1:], self.layout.column, self.layout.column.size
        first = layout["frame"]
        frame, rate = found[:, :, first : first + 4], found[:, :, size + first : size + first + 4]
        q = frame[..., -1]
        by_inverse = ((q * (2 / (q**2).sum(axis=-1, keepdims=True))) @ BY_INVERSE).reshape(*q.shape[:2], 3, 4)
        u = (by_inverse @ rate[..., -1:])[..., 0]
        columns = by_inverse @ (rate[..., :-1] - (u @ BY_CURVATURE).reshape(*q.shape[:2], 4, 4) @ frame[..., :-1])
        if rod == 0:
            return u, columns
        place = layout["angles"] + rod - 1
        angle, turning = found[:, :, place, -1], found[:, :, size + place]
        turn = np.zeros((*q.shape[:2], 3, 3))
        c, s = np.cos(angle), np.sin(angle)
        turn[..., 0, 0], turn[..., 0, 1], turn[..., 1, 0], turn[..., 1, 1], turn[..., 2, 2] = c, s, -s, c, 1.0
        columns = columns + np.stack([u[..., 1], -u[..., 0], 0 * c], axis=-1)[..., None] * found[:, :, place, None, :-1]
        columns, u = turn @ columns, (turn @ u[..., None])[..., 0]
        u[..., 2] += turning[..., -1]
        columns[..., 2, :] += turning[..., :-1]
        return u, columns

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
