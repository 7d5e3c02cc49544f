"""Arrays as columns of the viewer's components, a row a sample."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from multirod.recording.figure import Plate
from multirod.validation import FloatArray

if TYPE_CHECKING:
    import rerun as rr
    from rerun._baseclasses import ComponentColumn

    Index: TypeAlias = list[rr.TimeColumn]  # of rows, on both timelines
    Columns: TypeAlias = "list[ComponentColumn] | rr.ComponentColumnList"
    Send: TypeAlias = Callable[[str, Index, Columns], None]

PULLS, PUSHES, FAINT, LOOSE = 0xFF3B30, 0x2F7DFF, 0xFFF3D6, 0x7A828C  # lines: at full tension, near none, at none
_WITHIN = 2.795  # deviations, within which 95 % of a normal vector of three numbers is
_CORNERS = 24  # of what is drawn as a circle


def index(steps: NDArray[np.int64], times: FloatArray) -> "Index":
    """The two timelines that every row has."""
    import rerun as rr

    return [rr.TimeColumn("step", sequence=steps), rr.TimeColumn("time", duration=times)]


def capsules(nodes: FloatArray, radius: float, colors: NDArray[np.uint32] | None = None) -> list[Any]:
    """A capsule between two nodes, shape of ``nodes`` (row, node, 3); none where a node is not finite. Colours are of rows."""
    import rerun as rr

    start, along = nodes[:, :-1], np.diff(nodes, axis=1)
    length = np.linalg.norm(along, axis=-1)
    sound = np.isfinite(length)
    direction = np.divide(along, length[..., None], out=np.zeros_like(along) + [0.0, 0.0, 1.0], where=length[..., None] > 0)[
        sound
    ]
    x, y, z = direction.T
    # the shortest turn from e3; straight down, where it is not unique, half a turn about x
    quaternion = np.stack([-y, x, np.zeros_like(x), 1 + z], axis=-1)
    quaternion[z < -1 + 1e-12] = (1.0, 0.0, 0.0, 0.0)
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    counts = sound.sum(axis=1)
    some = (counts > 0).astype(int)
    # A radius alone is drawn, as a capsule of length 1: a row without capsules must have none.
    shades = {} if colors is None else {"colors": colors[some == 1]}
    return [
        *rr.Capsules3D.columns(lengths=length[sound], translations=start[sound], quaternions=quaternion).partition(counts),
        *rr.Capsules3D.columns(radii=np.full(some.sum(), radius), **shades).partition(some),
    ]


def strips(strips: FloatArray, colors: NDArray[np.uint32] | None = None) -> list[Any]:
    """Line strips (row, [strip,] node, 2 or 3); one with a node that is not finite is left out. Colours are of rows."""
    import rerun as rr

    values = strips if strips.ndim == 4 else strips[:, None]
    sound = np.isfinite(values).all(axis=(2, 3))
    kind = rr.LineStrips2D if values.shape[-1] == 2 else rr.LineStrips3D
    shades = [] if colors is None else [*kind.columns(colors=colors).partition(np.ones(len(colors), dtype=int))]
    return [*kind.columns(strips=values[sound].astype(np.float32)).partition(sound.sum(axis=1)), *shades]


def circles(position: FloatArray, rotation: FloatArray, radius: float) -> FloatArray:
    """Strips (..., node, 3) around places (..., 3), in the plane of the first two axes of frames (..., 3, 3)."""
    angle = np.linspace(0.0, 2 * np.pi, _CORNERS + 1)
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.asarray(position[..., None, :] + rim @ rotation[..., :2].swapaxes(-1, -2))


def shades(tension: FloatArray, strongest: float) -> NDArray[np.uint32]:
    """Colours (row,) of what pulls, pushes, or does neither."""
    share = np.clip(np.nan_to_num(tension) / strongest, -1.0, 1.0)[:, None]
    full = np.where(share > 0, _channels(PULLS), _channels(PUSHES))
    mixed = np.where(share == 0, _channels(LOOSE), (1 - np.abs(share)) * _channels(FAINT) + np.abs(share) * full)
    red, green, blue = np.rint(mixed).astype(np.uint32).T
    return np.asarray(red << 24 | green << 16 | blue << 8 | 0xFF, dtype=np.uint32)


def _channels(rgb: int) -> FloatArray:
    return np.array([rgb >> 16 & 0xFF, rgb >> 8 & 0xFF, rgb & 0xFF], dtype=np.float64)


def poses(position: FloatArray, rotation: FloatArray) -> tuple[Any, NDArray[np.bool_]]:
    """Transforms (row, 3) and (row, 3, 3), and which rows have one.

    The viewer shows what has no pose at the origin: in such rows nothing may be left to show.
    """
    import rerun as rr
    from scipy.spatial.transform import Rotation

    sound: NDArray[np.bool_] = np.isfinite(np.concatenate([position, rotation.reshape(-1, 9)], axis=1)).all(axis=1)
    quaternion = Rotation.from_matrix(rotation[sound]).as_quat() if sound.any() else np.zeros((0, 4))
    columns = rr.Transform3D.columns(translation=position[sound], quaternion=quaternion)
    return columns.partition(sound.astype(int)), sound


def plates(plate: Plate, shown: NDArray[np.bool_]) -> list[Any]:
    """A plate in the rows that show it, an empty mesh in the others."""
    import rerun as rr

    def rows(values: NDArray[Any]) -> NDArray[Any]:
        return np.tile(values, (int(shown.sum()), 1))

    def counts(values: NDArray[Any]) -> NDArray[np.int64]:
        return len(values) * shown.astype(np.int64)

    return [
        *rr.Mesh3D.columns(vertex_positions=rows(plate.vertices)).partition(counts(plate.vertices)),
        *rr.Mesh3D.columns(vertex_normals=rows(plate.normals)).partition(counts(plate.normals)),
        *rr.Mesh3D.columns(triangle_indices=rows(plate.triangles)).partition(counts(plate.triangles)),
    ]


def ellipsoids(covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Half axes (row, 3) of what holds 95 % of a normal vector, and the quaternions (row, 4) of their frames."""
    from scipy.spatial.transform import Rotation

    sound = np.asarray(np.isfinite(covariances).all(axis=(1, 2)))
    values, axes = np.linalg.eigh(np.where(sound[:, None, None], covariances, np.eye(3)))
    axes[np.linalg.det(axes) < 0, :, 2] *= -1
    half = _WITHIN * np.sqrt(np.maximum(values, 0.0))
    return np.where(sound[:, None], half, np.nan), np.asarray(Rotation.from_matrix(axes).as_quat())


def log10(values: FloatArray) -> FloatArray:
    """NaN at zero: the viewer leaves a gap, where -inf would spoil the axis."""
    return np.asarray(np.log10(values, out=np.full(values.shape, np.nan), where=values > 0))


def rgba(rgb: int, alpha: int = 0xFF) -> int:
    """A colour as the viewer's components take it."""
    return rgb << 8 | alpha
