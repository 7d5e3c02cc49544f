"""What comes of a reach: a solution, and how near it came to its target. What it says beside is found when it is asked for."""

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Robot_co
from multirod.batch import Instances, IntArray, take
from multirod.inputs import Inputs
from multirod.results.remarks import Remarks
from multirod.results.scene import Scene
from multirod.results.solution import Solution
from multirod.solver import Outcome
from multirod.stability import Stability
from multirod.status import Status
from multirod.tasks.freed import masked, values_of, with_values
from multirod.tasks.limits import LimitRows, told
from multirod.tasks.rows import Pose
from multirod.types import Index
from multirod.validation import FloatArray, frozen

SETTLED = 2.0  # tolerances of a target, by which one that was met may be off once the rest of the robot is at rest


@dataclass
class Chosen:
    """Inputs of a reach, by rows of a problem's: a ``Scene``'s ``unpack``, which can be pickled.

    Attributes:
        others: All that is not free.
        free: Names of what is.
        places: Of it in a row, shape (k,).
        batch_shape: Leading axes.
    """

    others: Inputs
    free: tuple[str, ...]
    places: NDArray[np.intp]
    batch_shape: tuple[int, ...]

    def __call__(self, rows: FloatArray) -> Inputs:
        """Those of rows (count, input_count)."""
        return with_values(self.others, self.free, rows[:, self.places].reshape(*self.batch_shape, len(self.places)))


@dataclass(frozen=True)
class ShapeHolds:
    """What limits of the shape hold; axes (instance, ...).

    Attributes:
        numbers: Which freed numbers take part, shape (count, k).
        limits: Which limits these are, shape (count, s).
    """

    numbers: NDArray[np.bool_]
    limits: NDArray[np.bool_]

    def take(self, instances: Instances) -> "ShapeHolds":
        """Those of some instances."""
        return ShapeHolds(self.numbers[instances], self.limits[instances])


@dataclass
class Ends:
    """Where instances ended; axes (instance, ...).

    Attributes:
        errors: Of the target's rows [1/m], shape (count, m).
        by_shape: What limits of the shape hold, if there are any.
    """

    errors: FloatArray
    by_shape: ShapeHolds | None

    def take(self, instances: Instances) -> "Ends":
        """Those of some instances."""
        return Ends(self.errors[instances], None if self.by_shape is None else self.by_shape.take(instances))

    @classmethod
    def joined(cls, ends: "list[Ends]") -> "Ends":
        """All of the parts of a batch."""
        held = [own.by_shape for own in ends if own.by_shape is not None]
        by_shape = None
        if held:
            by_shape = ShapeHolds(np.concatenate([own.numbers for own in held]), np.concatenate([own.limits for own in held]))
        return cls(np.concatenate([own.errors for own in ends]), by_shape)


@dataclass
class Aim:
    """What all instances of a reach have in common.

    Attributes:
        target: Of the end effector.
        free: Names of the freed inputs.
        limits: Of these.
        unit: (9) of ``docs/tasks.md``, shape (k,).
        shape_names: Names of the limits of shapes that there are.
        weight: Of rows of the position and of angles, shape (2,).
        tolerance: Of the search, in these rows [1/m]; NaN of older files, which do not say.
    """

    target: Pose
    free: tuple[str, ...]
    limits: LimitRows
    unit: FloatArray
    shape_names: tuple[str, ...]
    weight: FloatArray
    tolerance: float = nan


@dataclass(frozen=True)
class Start:
    """Where the search of each instance began.

    Attributes:
        first: Equilibria.
        numbers: Of that of each instance among them, flattened, shape (count,).
    """

    first: Solution[Any]
    numbers: IntArray

    @classmethod
    def of(cls, first: Solution[Any], batch_shape: tuple[int, ...]) -> "Start":
        """Of a batch with leading axes to which those of ``first`` broadcast."""
        numbers = np.arange(prod(first.batch_shape)).reshape(first.batch_shape)
        return cls(first, np.broadcast_to(numbers, batch_shape).reshape(-1))

    def status(self, instance: int) -> Status:
        """Of the equilibrium where one began."""
        return Status(int(self.first._outcome.status.reshape(-1)[self.numbers[instance]]))

    def unstable(self, instance: int) -> bool:
        """Whether it is known to be unstable; that may take an integration."""
        axes, number = self.first.batch_shape, self.numbers[instance]
        alone = self.first[np.unravel_index(number, axes)] if axes else self.first
        return alone.stability is Stability.UNSTABLE


class Reached(Solution[Robot_co]):
    """Equilibria whose end effectors are at their targets, or as near as limits let them be: a ``Solution``, and how near."""

    _aim: Aim
    _ends: Ends
    _start: Start | None = None  # of what was loaded from a file, none is known

    def __init__(
        self,
        scene: Scene[Robot_co],
        records: FloatArray,
        outcome: Outcome,
        aim: Aim,
        ends: Ends,
        inputs: Inputs | None = None,
        instances: IntArray | None = None,
    ) -> None:
        super().__init__(scene, records, outcome, inputs, instances)
        vars(self).update(_aim=aim, _ends=ends)

    @property
    def target(self) -> Pose:
        """What was asked for."""
        return self._aim.target

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the inputs that were chosen; ``inputs`` has their values, NaN where none were found."""
        return self._aim.free

    @cached_property
    def inputs(self) -> Inputs:
        """For the drives: what was chosen, and all else as it was given. Of an instance that failed what is ``free`` is NaN, like
        all else that was not found; ``ended_at`` says where its search ended."""
        return masked(self._applied, self.free, self.failed)

    @property
    def ended_at(self) -> Inputs:
        """Where searches ended: ``inputs``, and of an instance that failed the last place on the way that held, near what can be
        reached, at which the robot need not be stable."""
        return self._applied

    @cached_property
    def target_error(self) -> FloatArray:
        """Distance from the position asked for [m], shape (...); also of an instance that failed, how near it came. NaN if no
        position was asked for."""
        rows = self._aim.target.position_rows
        return self._size(self._ends.errors[:, :rows], self._aim.weight[0])

    @cached_property
    def target_angle(self) -> FloatArray:
        """Angle from the rotation or the axis asked for [rad], likewise."""
        rows = self._aim.target.position_rows
        return self._size(self._ends.errors[:, rows:], self._aim.weight[1])

    def _size(self, rows: FloatArray, weight: float) -> FloatArray:
        found = np.linalg.norm(rows / weight, axis=1) if rows.shape[1] else np.full(len(rows), np.nan)
        return np.asarray(self._shaped(found))

    @cached_property
    def at_limit(self) -> NDArray[np.bool_]:
        """Which of the freed numbers, in the order of ``free``, take part in a limit that they stand at, shape (..., k); of a
        limit of the shape those that change what it limits."""
        numbers = (self._near[:, :, None] & (self._aim.limits.matrix != 0)).any(axis=1)
        if self._ends.by_shape is not None:
            numbers |= self._ends.by_shape.numbers
        return np.asarray(self._shaped(numbers, (len(self._aim.unit),)))

    @cached_property
    def _near(self) -> NDArray[np.bool_]:
        """Which limits of the freed inputs results stand at, shape (count, c)."""
        values = self._values.reshape(-1, len(self._aim.unit))
        return self._aim.limits.near(values, self._aim.unit) & ~self._failed[:, None]

    @property
    def _values(self) -> FloatArray:
        """The freed numbers, shape (..., k)."""
        return values_of(self._applied, self.free)

    @property
    def held_by(self) -> tuple[str, ...] | NDArray[np.object_]:
        """Names of the limits that it stands at, as of a controller's command: such as ``"translation[0]"``,
        ``"translation[1] - translation[0]"`` for a gap, ``"curvature"``; of a batch an array of these, shape (...)."""
        holds, names = self._near, self._aim.limits.names + self._aim.shape_names
        if self._ends.by_shape is not None:
            holds = np.concatenate([holds, self._ends.by_shape.limits], axis=1)
        found = np.empty(len(holds), dtype=object)
        for row, own in enumerate(holds):
            found[row] = tuple(names[j] for j in np.flatnonzero(own))
        return np.asarray(found.reshape(self.batch_shape)) if self.batch_shape else found[0]

    @cached_property
    def _remarks(self) -> Remarks | None:  # type: ignore[override]  # found when it is asked for
        if self.batch_shape or self.target.batch_shape:
            return None
        return self._aim.limits.remarks(self._values, self.target.position, float(self.target_error))

    @property
    def _asides(self) -> dict[str, str]:
        said = told(float(self.target_error), float(self.target_angle), list(self.held_by))
        if self._start is not None and self.status.failed and (began := self._start.status(0)).event:
            said["began"] = began.name
        return said

    def _named(self, status: Status, instance: int) -> str:
        """Also whether it is off the target, and what there is to know of where it began."""
        said = super()._named(status, instance)
        missed = float(np.ravel(self.target_error)[instance])
        if status is Status.UNSTABLE and missed * self._aim.weight[0] > SETTLED * self._aim.tolerance:
            said += f"; and it is {1e3 * missed:.3g} mm off the target, which may be out of reach: with starts= others are tried"
        if self._start is None or (began := self._start.status(instance)).failed:
            return said
        if began.event:
            past = f"it began past where the robot buckled or snapped ({began.name})"
            return f"{said}; {past}: begin before that, by other inputs or a guess"
        if self._start.unstable(instance):
            return f"{said}; it began at an equilibrium that is unstable, already: begin at one that is not"
        return said

    def __getitem__(self, index: Index) -> "Reached[Robot_co]":
        """The result of some instances: ``index`` as for an array with the leading axes ``batch_shape``."""
        plain: Any = super().__getitem__(index)
        numbers: Any = np.arange(len(self._records)).reshape(self.batch_shape)
        result = object.__new__(Reached)
        result.__dict__.update(plain.__dict__)
        chosen = np.asarray(numbers[index])
        result._aim = replace(self._aim, target=_of_some(self.target, self.batch_shape, chosen))
        result._ends = self._ends.take(chosen.reshape(-1))
        result._start = None if self._start is None else replace(self._start, numbers=self._start.numbers[chosen.reshape(-1)])
        return result


def _of_some(target: Pose, batch_shape: tuple[int, ...], numbers: NDArray[np.intp]) -> Pose:
    """That of some instances, by their numbers (...) in a batch to whose leading axes it broadcasts."""
    result = copy(target)
    for name in target.given:
        value = getattr(target, name)
        tail = 2 if name == "rotation" else 1
        own = take(value, batch_shape, numbers.reshape(-1), tail=tail)
        setattr(result, name, frozen(own.reshape(*numbers.shape, *own.shape[1:])))
    result.batch_shape = numbers.shape
    return result
