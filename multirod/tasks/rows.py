"""Rows of a task: what is asked of an equilibrium, or measured of it. Numbers in parentheses: ``docs/tasks.md``."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from multirod.batch import Instances, IntArray, broadcast_shapes, take
from multirod.frames import Framed
from multirod.naming import hinted
from multirod.plausibility.limits import LENGTH
from multirod.rotations import AIMLESS, BACK, ORTHOGONAL, SIDEWAYS, TURNED, cross, inverse_left_jacobian, refuse_unturned, vectors
from multirod.tasks.formulation import Evaluation
from multirod.tasks.whitening import POSITION_ROWS, Kind, row_count, whitening
from multirod.types import Numbers
from multirod.validation import SMALLEST_AXIS, Described, FloatArray, array, first_of, measurement, nonnegative_float, refuse

ON_TARGET = 4e-7  # of the longest rod, and rad, what is at a target: 0.16 um and 0.4 urad of 0.4 m
NEARBY = LENGTH.high  # within which a place is nothing to warn of [m]
PARTS = ("position", "rotation", "axis", "across", "along")  # of a pose
SIGHTS = PARTS[3:]  # by which part of a position counts: both are kept as one ``direction``
SERIES_BELOW = 1e-3  # of 1 less a cosine, below which the angle over its sine is a series


class Rows(Protocol):
    """Rows of a task for each of its instances."""

    @property
    def count(self) -> int:
        """Rows ``m``."""

    def at(self, found: Evaluation) -> tuple[FloatArray, FloatArray, FloatArray]:
        """``W (h - y)`` (b, m), and its derivatives by the unknowns (b, m, n) and by what is freed (b, m, k)."""


class Pose(Framed):
    """A pose of the end effector, or a part of it: a target, or a measurement; with ``at`` one along a rod, measured.

    Given are a position, and beside it or alone either a rotation (three rows more) or a direction (two). All may have leading
    axes ``...``, one entry an instance. Robots take a position with a rotation in the place of a matrix: ``base=``, ``end=``.

    Args:
        position: In the world [m], shape (..., 3).
        across: Direction in the world across which alone the position counts, of any length, shape (..., 3): a measurement in a
            picture that is taken along it, or a target anywhere on a line along it. All of the position counts by default.
        along: In place of ``across``, direction along which alone it counts: one coordinate, such as a height, (0, 0, 1).
        rotation: Body to world, shape (..., 3, 3).
        axis: Direction in the world that the z axis of the end effector has, of any length, shape (..., 3).
        sigma: Standard deviations of a measurement: of the position [m] and of the angles [rad], a pair, or one of these where
            only one of the two is given. Each is one number, or three along the axes of the world; of an axis, and of a position
            ``across`` or ``along`` a direction, one. None of a target.
        covariance: In place of ``sigma``, of a position (3, 3) [m^2], of a rotation (3, 3) [rad^2], as a rotation vector, or of
            both (6, 6), all in the world: such as ``C @ diag([1e-8, 1e-8, 1e-6]) @ C.T`` of a camera whose axes are the columns
            of ``C``.
        at: Arclength of a marker along a rod [m], as ``solution.rod(k).arclength``: from the base, of tubes from the plate. Of a
            measurement; the end effector by default.
        rod: Index or name of that rod; not needed where a robot is one, or tubes in each other, whose first it is. Its rotation
            is that of its own frame.

    Raises:
        ValueError: If a rotation is none, an axis or another direction is zero, ``sigma`` is not > 0 or ``covariance`` not
            symmetric and positive definite, both or none of rotation and axis are given without a position, ``across`` or
            ``along`` is given without one, or both are, ``at`` is < 0, or leading axes do not broadcast.
    """

    quantity: ClassVar = "poses"

    @hinted("its parts are named, of a matrix T of shape (4, 4) Pose(position=T[:3, 3], rotation=T[:3, :3])")
    def __init__(
        self,
        *,
        position: Numbers | None = None,
        rotation: Numbers | None = None,
        axis: Numbers | None = None,
        sigma: Numbers | None = None,
        across: Numbers | None = None,
        along: Numbers | None = None,
        covariance: Numbers | None = None,
        at: float | None = None,
        rod: int | str | None = None,
    ) -> None:
        if rotation is not None and axis is not None:
            refuse("Pose.axis", axis, "must not be given beside rotation, of which it is a part")
        if position is None and rotation is None and axis is None:
            raise ValueError("Pose needs a position, a rotation or an axis")
        for name, value in zip(SIGHTS, (across, along), strict=True):
            if value is not None and position is None:
                refuse(f"Pose.{name}", value, f"must not be given without a position, which counts {name} it")
        if across is not None and along is not None:
            refuse("Pose.along", along, "must not be given beside across, which says what else of the position counts")
        self.position = None if position is None else vector("Pose.position", position)
        # whether it is a position alone, of one instance, with nothing missing and nothing far: most targets are
        self.ordinary = False
        if rotation is axis is across is along is None and self.position is not None and self.position.ndim == 1:
            self.ordinary = all(-NEARBY <= value <= NEARBY for value in self.position.tolist())
        measured = sigma is not None or covariance is not None
        self.rotation = None if rotation is None else _rotation(rotation, TURNED if measured else ORTHOGONAL)
        self.axis = None if axis is None else _direction("Pose.axis", axis)
        self.across, self.along = (
            None if value is None else _sight(f"Pose.{name}", value) for name, value in zip(SIGHTS, (across, along), strict=True)
        )
        self._kind, self._given = _kind(self), _given(self)
        self.whitening = whitening(self._kind, sigma, covariance)
        if at is not None and np.ndim(at):
            refuse("Pose.at", at, "must be one number: give a Pose for each place, [Pose(position=p, at=s) for p, s in ...]")
        self.at, self.rod = None if at is None else nonnegative_float("Pose.at", at), rod
        if at is None and not (rod is None or isinstance(rod, int) and rod == 0):
            refuse("Pose.rod", rod, "must not be given without at, where along that rod it is: else it is of the end effector")
        try:
            self.batch_shape: tuple[int, ...] = broadcast_shapes(*(value.shape[:-tail] for value, tail in self._parts()))
        except ValueError:
            refuse("Pose", Described(f"leading axes {[v.shape[:-t] for v, t in self._parts()]}"), "must broadcast")

    @property
    def alone(self) -> bool:  # noqa: D102
        return not self.measures and self.at is None and self.across is self.along is None

    @property
    def given(self) -> tuple[str, ...]:
        """Names of what it has, of ``PARTS``."""
        return self._given

    @property
    def measures(self) -> bool:
        """Whether it says how sure it is, as a measurement does."""
        return self.whitening is not None

    @property
    def places(self) -> FloatArray | None:
        """Where it is along its rod [m], shape (1,); None of the end effector."""
        return None if self.at is None else np.array([self.at])

    def _parts(self) -> list[tuple[FloatArray, int]]:
        parts = ((self.position, 1), (self.rotation, 2), (self.axis, 1), (self.across, 1), (self.along, 1))
        return [(value, tail) for value, tail in parts if value is not None]

    @property
    def count(self) -> int:
        """Rows: 3 of a position, 2 of one across a direction, 1 of one along it, 3 of a rotation, 2 of an axis."""
        return row_count(self._kind)

    @property
    def position_rows(self) -> int:
        """Those of the position, which come first."""
        return POSITION_ROWS[self._kind[0]]

    @property
    def kind(self) -> "Kind":
        """What it has, as kernels read it."""
        return self._kind

    @property
    def complete(self) -> NDArray[np.bool_]:
        """Whether all numbers are there, none NaN, shape (...)."""
        result = np.ones(self.batch_shape, dtype=bool)
        for value, tail in self._parts():
            result &= np.isfinite(value).all(axis=tuple(range(-tail, 0)))
        return result

    @property
    def whole(self) -> bool:
        """Whether all are complete."""
        return all(np.count_nonzero(np.isfinite(value)) == value.size for value, _ in self._parts())

    def rows(self, length: float, batch_shape: tuple[int, ...] = (), instances: IntArray | None = None) -> "PoseRows":
        """The rows of some instances of a batch to whose leading axes this broadcasts.

        What is not measured counts as residuals do [1/m]: positions over ``length**2``, angles over ``length``.
        """

        def taken(value: FloatArray | None, tail: int) -> FloatArray | None:
            return None if value is None else np.asarray(take(value, batch_shape, instances, tail=tail))

        weight = np.ones(2) if self.measures else np.array([1 / length**2, 1 / length])
        return PoseRows(
            taken(self.position, 1),
            taken(self.rotation, 2),
            taken(self.axis, 1),
            weight,
            taken(self.across, 1),
            self.whitening,
            along=taken(self.along, 1),
        )

    def __repr__(self) -> str:
        names = [*self.given, *["sigma"] * self.measures]
        where = [] if self.at is None else [f"at {self.at:g} m" + ("" if self.rod is None else f" of rod {self.rod!r}")]
        return f"Pose({', '.join(names + where)}; {self.count} rows, batch {self.batch_shape})"


@dataclass(frozen=True)
class PoseRows:
    """The rows of a ``Pose``, one entry an instance, or one for all.

    Attributes:
        position: Shape (b, 3), or None.
        rotation: Shape (b, 3, 3), or None.
        axis: Unit vectors (b, 3), or None.
        weight: What rows of the position and of the angles are multiplied by, shape (2,).
        across: Unit vectors (b, 3) across which the position counts, or None.
        whitening: Lower triangular, what all rows are multiplied by afterwards, shape (m, m), or one for each instance, where
            what is missing differs, (b, m, m), or None.
        place: Of a marker: its rod, and which of all places it is at. None of the end effector.
        along: In place of ``across``, unit vectors (b, 3) along which the position counts, or None.
    """

    position: FloatArray | None
    rotation: FloatArray | None
    axis: FloatArray | None
    weight: FloatArray
    across: FloatArray | None = None
    whitening: FloatArray | None = None
    place: tuple[int, int] | None = None
    along: FloatArray | None = None

    @cached_property
    def kind(self) -> Kind:
        """What they have, as kernels read it."""
        return _kind(self)

    @cached_property
    def given(self) -> tuple[str, ...]:
        """Names of what they have, of ``PARTS``."""
        return _given(self)

    @cached_property
    def count(self) -> int:
        """Rows."""
        return row_count(self.kind)

    @property
    def position_rows(self) -> int:
        """Those of the position, which come first."""
        return POSITION_ROWS[self.kind[0]]

    def take(self, instances: Instances) -> Self:
        """Those of some instances, by an index of the first axis."""
        own = self.whitening
        whitening = own[instances] if own is not None and own.ndim > 2 else own
        return replace(self, **{name: getattr(self, name)[instances] for name in self.given}, whitening=whitening)

    def at(self, found: Evaluation) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As ``Rows`` say; (4) of a position, (4b) across a direction, (4c) along it, (5) of a rotation, (6) of an axis."""
        position, rotation, by_unknowns, by_free = found.pose_at(self.place)
        errors, maps = self.errors(position, rotation)
        return errors, maps @ by_unknowns, maps @ by_free

    def errors(self, position: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``W (h - y)`` (b, m) at poses, and its derivative by the pose's six rows, shape (b, m, 6)."""
        count = len(position)
        errors, maps = np.zeros((count, self.count)), np.zeros((count, self.count, 6))
        row = self.position_rows
        if self.position is not None:
            sides = np.eye(3) if self.across is None else _sides(self.across)
            sides = sides if self.along is None else self.along[..., None, :]
            errors[:, :row] = self.weight[0] * (sides @ (position - self.position)[..., None])[..., 0]
            maps[:, :row, :3] = self.weight[0] * sides
        if self.rotation is not None:
            turn = vectors(rotation @ np.swapaxes(self.rotation, -1, -2))
            errors[:, row:] = self.weight[1] * turn
            maps[:, row:, 3:] = self.weight[1] * inverse_left_jacobian(turn)
        if self.axis is not None:
            tilt, change = _tilt(rotation[..., :, 2], np.broadcast_to(self.axis, (count, 3)))
            errors[:, row:] = self.weight[1] * tilt
            maps[:, row:, 3:] = self.weight[1] * change
        if self.whitening is not None:
            errors, maps = (self.whitening @ errors[..., None])[..., 0], self.whitening @ maps
        return errors, maps


def _given(parts: "Pose | PoseRows") -> tuple[str, ...]:
    return tuple(name for name in PARTS if getattr(parts, name) is not None)


def _kind(parts: "Pose | PoseRows") -> Kind:
    position = 0 if parts.position is None else 2 if parts.across is not None else 1 if parts.along is None else 3
    return position, int(parts.rotation is not None), int(parts.axis is not None)


def _sides(axis: FloatArray) -> FloatArray:
    """Two directions across unit vectors (..., 3), and across each other, shape (..., 2, 3)."""
    first = cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=-1)])
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, cross(axis, first)], axis=-2)


def _tilt(tangent: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(6) How ``tangent`` (b, 3) is tilted from ``axis`` about two directions across it (b, 2), and its derivative (b, 2, 3)."""
    across = _sides(axis)
    first = across[..., 0, :]
    cosine = (axis * tangent).sum(axis=-1)
    turned = cross(axis, tangent)
    u = 1 - cosine
    near = u < SERIES_BELOW
    angle = np.arctan2(np.linalg.norm(turned, axis=-1), cosine)
    back = cosine <= BACK
    sine2 = np.where(near | back, 1.0, 1 - cosine**2)
    far = angle / np.sqrt(sine2)
    quotient = np.where(near, 1 + u * (1 / 3 + u * (2 / 15 + u * 2 / 35)), far)
    slope = np.where(near, -(1 / 3 + u * (4 / 15 + u * 6 / 35)), (cosine * far - 1) / sine2)
    moved = cosine[..., None, None] * np.eye(3) - tangent[..., :, None] * axis[..., None, :]
    by_cosine = -turned  # cosine changes by w . (tangent x axis)
    change = quotient[..., None, None] * moved + slope[..., None, None] * turned[..., :, None] * by_cosine[..., None, :]
    tilt = quotient[..., None] * turned
    if back.any():
        sine = np.linalg.norm(turned[back], axis=-1, keepdims=True)
        about = np.where(sine > AIMLESS, turned[back] / np.maximum(sine, AIMLESS), first[back])
        tilt[back] = angle[back, None] * about
        quotient, straight = (angle[back, None] / np.maximum(sine, SIDEWAYS))[..., None], about[:, :, None] * about[:, None, :]
        change[back] = quotient * moved[back] + (1 - quotient * cosine[back, None, None]) * straight
    return (across @ tilt[..., None])[..., 0], across @ change


def vector(field: str, value: object) -> FloatArray:
    """Numbers (..., 3), which may be NaN: of a sensor that dropped out."""
    return measurement(field, value, (3,))


def _rotation(value: object, most: float) -> FloatArray:
    """Rotations (..., 3, 3), which may be NaN, whose ``R R^T`` is ``most`` off the identity."""
    result = array("Pose.rotation", value, (3, 3), finite=False)
    refuse_unturned("Pose.rotation", value, result, most)
    return result


def _direction(field: str, value: object) -> FloatArray:
    """Unit vectors (..., 3), which may be NaN."""
    result = vector(field, value)
    size = np.linalg.norm(result, axis=-1, keepdims=True)
    if (size <= SMALLEST_AXIS).any():
        refuse(field, first_of(size[..., 0] <= SMALLEST_AXIS, result, value), "must not be zero")
    return np.asarray(result / size)


def _sight(field: str, value: object) -> FloatArray:
    """Unit vectors (..., 3) that say which part of a position counts."""
    result = _direction(field, value)
    if np.isnan(result).any():
        refuse(field, value, "must be finite: what was not measured is NaN in the position")
    return result
