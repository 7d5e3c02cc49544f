"""The compiled sample of a controller: its arrays, made once, and its launches."""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.kernels.shared import Shared
from multirod.launch import record
from multirod.rotations import matrices
from multirod.status import Status
from multirod.tasks.condensed import condensed
from multirod.tasks.controlling.control_kernels import ANGLE, ERROR, FREE, HELD, SINGULAR, make_control
from multirod.tasks.controlling.control_step_kernels import Control
from multirod.tasks.controlling.pace import Pace, Sample
from multirod.tasks.formulation import Task
from multirod.tasks.limits import LimitRows
from multirod.tasks.programme import programme
from multirod.tasks.programme_kernels import Programme
from multirod.tasks.rows import SIGHTS, PoseRows
from multirod.tasks.watch import Watch
from multirod.tasks.watch_kernels import LOOK
from multirod.tasks.whitening import Kind, row_count
from multirod.types import WarpArray
from multirod.validation import FloatArray

# what the next sample starts from, and where records have it
LOOKED_AT = {"good_unknowns": "unknowns", "tip_position": "position", "tip_rotation": "rotation"}


@dataclass(frozen=True)
class Good:
    """The last good command.

    Attributes:
        record: Of the problem there, shape (1, size).
        told: What was told of it, as ``control_kernels`` says where.
        under: What is not free, as ``ControlStep`` has it.
    """

    record: FloatArray
    told: FloatArray
    under: bytes


class ControlStep:
    """All of a controller's sample that comes after its integration.

    Args:
        task: Aimed at what is free; without leading axes.
        rows: Limits of what is free.
        unit: (9), shape (k,).
        weight: Of rows of the position and of angles, shape (2,).
        gains: (15) Of the offset and of its drift.
        watch: Of the stability of samples.
        centre: Where what targets leave free is pulled to, shape (k,); None is nowhere.
        shaped: Rows of limits of the shape beside ``rows``, which ``limit_shape`` sets.

    Attributes:
        given: By name what to write before ``launch``: parts of a target, ``seen_position``, ``seen_rotation``, and ``seen``, of
            both 0, 1 for measured, -1 for missing.
        under: What is not free, as ``others_changed`` found it last.
    """

    def __init__(
        self,
        task: Task,
        rows: LimitRows,
        unit: FloatArray,
        weight: FloatArray,
        gains: tuple[float, float],
        watch: Watch,
        centre: FloatArray | None,
        shaped: int = 0,
    ) -> None:
        problem = task.problem
        self._whole, self._watch, self._problem, self._kinks, device = task, watch, problem, problem.kinks, problem.device
        self._rows, self._unit, self._gains, self._centre = rows, unit, gains, centre
        self._weight = float(weight[0]), float(weight[1])
        vectors = {"position": wp.vec3d, "rotation": wp.mat33d, "axis": wp.vec3d, "direction": wp.vec3d}
        vectors |= {"seen_position": wp.vec3d, "seen_rotation": wp.mat33d}
        self._given = {name: Shared((1,), dtype, device) for name, dtype in vectors.items()}
        self._given["seen"] = Shared((1, 2), wp.int32, device)
        self.given: dict[str, Any] = {name: each.values[0] for name, each in self._given.items()}
        self.given |= dict.fromkeys(SIGHTS, self.given["direction"])
        self._task: Any
        self._task, self._columns = condensed(task)
        self._count = task.count
        kept: dict[str, tuple[tuple[int, ...], Any]] = dict.fromkeys(("offset", "drift", "motion"), ((2,), wp.vec3d))
        kept |= dict.fromkeys(("since", "gap"), ((2,), wp.int32))
        kept |= dict.fromkeys(("tip_position", "last_position", "last_axis"), ((), wp.vec3d))
        kept |= dict.fromkeys(("tip_rotation", "last_rotation"), ((), wp.mat33d))
        kept |= {"has_tip": ((), wp.int32), "last_kind": ((), wp.vec3i), "begun": ((), wp.float64), "status": ((), wp.int32)}
        kept |= {"foresaw": ((), wp.int32), "foreseen_position": ((), wp.vec3d), "foreseen_rotation": ((), wp.mat33d)}
        kept |= {"doubt": ((), wp.int32), "before_tip": ((), wp.int32)}
        kept |= {"before_position": ((), wp.vec3d), "before_rotation": ((), wp.mat33d)}
        sizes = {"before_unknowns": problem.unknown_count, "before_values": task.count}
        sizes |= {"good_unknowns": problem.unknown_count, "good_values": task.count, "values": task.count, "pull": task.count}
        # the last number that is told: whether a step was given up, as what it leads to is not known to be stable
        sizes |= {"record": problem.records.shape[1], "told": FREE + 8 * task.count + len(rows.low) + shaped + 1}
        kept |= {name: ((size,), wp.float64) for name, size in sizes.items()}
        self._kept: dict[str, Any] = {
            name: wp.zeros((1, *shape), dtype=dtype, device=device) for name, (shape, dtype) in kept.items()
        }
        self._views = [self._kept[name].numpy() for name in ("record", "told", "status", "doubt")]
        self._shared = wp.get_device(device).is_cpu
        c, k = rows.matrix.shape
        each: dict[str, tuple[int, ...]] = dict.fromkeys(("limits", "scaled"), (c + shaped, k))
        each |= dict.fromkeys(("low", "high"), (c + shaped,))
        self._limits = {name: Shared(size, wp.float64, device) for name, size in each.items()}
        self._pace = Pace(unit, self._weight, centre is not None, sizes["told"], device)
        self._offset: FloatArray = self._kept["offset"].numpy()
        self._others = np.delete(np.arange(problem.read("inputs").shape[1]), task.places)  # what is not free
        self.under = self._of_others()
        self._off: dict[Kind, FloatArray] = {}  # rows of each launch, where arrays are shared
        self._put_limits(slice(c), rows.matrix, *rows.inset(self._unit))
        self._put_limits(slice(c, None), np.zeros((shaped, k)), np.full(shaped, -np.inf), np.full(shaped, np.inf))
        self._launches: dict[Kind, Callable[[], None]] = {}
        self._kind: Kind = (0, 0, 0)  # of the last launch
        self._good: Good  # from ``stand`` on
        self._tried: FloatArray | None = None  # what the last sample's step came to, if that was given up
        self._looked = 0.0  # how long the last sample's step was, in units (9), if what it led to was looked at
        self._states: list[Any] = []  # whose arrays the launches work in

    def start(self, unknowns: FloatArray, values: FloatArray, *, afresh: bool = False) -> None:
        """Begin at ``x`` (1, n) and ``p`` (1, k); ``afresh`` after others, the problem being integrated there."""
        self._kept["good_unknowns"].assign(unknowns)
        self._kept["good_values"].assign(values)
        if not afresh:
            return
        for name in ("begun", "last_kind", "motion", "foresaw"):
            self._kept[name].zero_()
        self._pace.begin()

    def stand(self, record: FloatArray) -> None:
        """Samples follow from where the problem has ``record`` (1, size), which is stable."""
        k, told = self._count, np.full(self._kept["told"].shape[1], np.nan)
        told[FREE : FREE + k] = record[:, self._problem.record_fields["inputs"]][0, self._whole.places]
        told[FREE + 7 * k :] = 0.0
        self._good = Good(record, told, self.under)

    @property
    def good_values(self) -> FloatArray:
        """What is free in the last sample that did not fail, shape (1, k)."""
        return np.array(self._kept["good_values"].numpy())

    def prepare(self, *kinds: Kind) -> None:
        """Make the launches for targets of these kinds: one that is not made takes a sample as long as forty do."""
        for kind in kinds:
            self._launches[kind] = self._made(kind)

    def launch(self, kind: Kind) -> tuple[FloatArray, FloatArray, int, int]:
        """From an integration to the next one's place.

        Returns:
            The problem's records at the command, shape (1, size); what is told of it, as ``control_kernels`` says where, shape
            (size,); its status; what has to be done about it, as ``watch_kernels`` says.
        """
        self._columns.update()
        self._kind, self._settled, self._looked, self._tried = kind, False, 0.0, None
        self._watch.strain[:] = 0.0
        if kind not in self._launches:
            self.prepare(kind)
        begun = self._problem.read("unknowns") if len(self._kinks) and self._watch.state.on else None
        if self._shared:
            self._launches[kind]()
            found, told, status, doubt = self._views[0].copy(), self._views[1].copy(), *self._views[2:]
        else:
            for each in self._given.values():
                each.send()
            self._launches[kind]()
            found, told, status, doubt = (self._kept[name].numpy() for name in ("record", "told", "status", "doubt"))
        crossed = begun is not None and not Status(int(status[0])).failed and self._crossed(begun, found)
        return found, told[0], int(status[0]), LOOK if crossed else int(doubt[0])

    def _crossed(self, begun: FloatArray, record: FloatArray) -> bool:
        """Whether a command has a line slack that was taut at the place of its integration, (1, n), or the other way round."""
        own = record[:, self._problem.record_fields["unknowns"]]
        return bool(((begun > 0) != (own > 0))[:, self._kinks].any())

    @property
    def by(self) -> FloatArray:
        """(2) ``B`` of the last sample, shape (n, k)."""
        return np.array(self._task.shift.numpy()[0, :, 1:])

    def refuse(self, told: FloatArray) -> None:
        """Take the last sample back, which is not stable: the next starts from the one before, and ``told`` says so."""
        self._tried, self._looked = told.copy(), self._pace.moved(self._good.told, told)
        kept, k = self._kept, self._count
        names = {"good_unknowns": "unknowns", "good_values": "values"}
        names |= {"tip_position": "position", "tip_rotation": "rotation", "has_tip": "tip"}
        for name, before in names.items():
            kept[name].assign(kept[f"before_{before}"])
        for name in ("last_kind", "motion", "foresaw"):
            kept[name].zero_()
        self._watch.compare()
        values = kept["good_values"].numpy()
        self._whole.write(kept["good_unknowns"].numpy(), values)
        told[[SINGULAR, HELD]], told[[ERROR, ANGLE]] = 0.0, np.nan
        told[FREE : FREE + k], told[FREE + k : FREE + 7 * k], told[FREE + 7 * k :] = values[0], np.nan, 0.0

    def again(self, told: FloatArray) -> tuple[FloatArray, FloatArray, int] | None:
        """In place of a sample that is not known to be stable the last good command: its record, what is told of it, its status.
        None where something that is not free has changed since: then nobody knows of that one either."""
        good, k, c = self._good, self._count, len(self._rows.low)
        if good.under != self.under:
            return None
        tried, own = good.told if self._tried is None else self._tried, told.copy()
        record, fields = good.record.copy(), self._problem.record_fields
        values = record[:, fields["inputs"]][:, self._whole.places]
        holds = self._rows.near(values, self._unit)[0] & (tried[FREE + 8 * k :][:c] != 0)
        own[FREE : FREE + k], own[FREE + k : FREE + 7 * k] = values[0], tried[FREE + k : FREE + 7 * k]
        own[FREE + 7 * k : FREE + 8 * k] = (self._rows.matrix[holds] != 0).any(axis=0)
        own[FREE + 8 * k :], own[-1] = 0.0, 1.0
        own[FREE + 8 * k :][:c] = holds
        own[ERROR], own[ANGLE] = self._off_target(record[:, fields["position"]], record[:, fields["rotation"]])
        own[[SINGULAR, HELD]] = 0.0, holds.any()
        off = Status.AT_LIMIT if holds.any() else Status.OFF_TARGET
        return record, own, int(Status.TRACKING if self._pace.there(own) else off)

    def others_changed(self) -> bool:
        """Whether what is not free has changed since this was asked last."""
        before, self.under = self.under, self._of_others()
        return before != self.under

    def _of_others(self) -> bytes:
        return bytes(self._problem.read("inputs")[0, self._others].tobytes())

    def mind(self, status: int, told: FloatArray, record: FloatArray) -> tuple[int, FloatArray]:
        """Take steps of the next sample as long as what came of this one allows. Its status, and what is told of it."""
        failed, sample = Status(status).failed, None
        strain = float(self._watch.strain[0])
        if told[-1] or failed:
            self._pace.failed(self._looked, strain)
            return status, told
        if self._shared:
            rows = self._off[self._kind]
            target = *(own.tobytes() for own in self.given.values()), self._offset.tobytes()
            sample = Sample(told, sqrt(float(rows @ rows)), len(rows), target, self.under)
        self._pace.after(sample, self._looked, strain)
        if self._settled:
            status, told = self._said(status, told, record)
        self._good = Good(record, told, self.under)
        return status, told

    def _said(self, status: int, told: FloatArray, record: FloatArray) -> tuple[int, FloatArray]:
        """Of a command that was looked at, how far it is off its target itself: no more by what its step was to come to."""
        fields, own = self._problem.record_fields, told.copy()
        own[ERROR], own[ANGLE] = self._off_target(record[:, fields["position"]], record[:, fields["rotation"]])
        rows = self._off.get(self._kind)
        if rows is not None and self._pace.astray(own, sqrt(float(rows @ rows))):
            status = int(Status.OFF_TARGET) if status == Status.TRACKING else status
        return status, own

    def limit_shape(self, matrix: FloatArray, high: FloatArray, longest: float) -> None:
        """``matrix p <= high`` from now on, shapes (shaped, k) and (shaped,), and steps of ``longest`` in units (9) at most."""
        self._pace.limit(longest)
        self._put_limits(slice(len(self._rows.low), None), matrix, np.full(len(high), -np.inf), high)

    def _put_limits(self, places: slice, matrix: FloatArray, low: FloatArray, high: FloatArray) -> None:
        for name, values in {"limits": matrix, "scaled": matrix * self._unit, "low": low, "high": high}.items():
            self._limits[name].values[places] = values
            self._limits[name].send()

    def stay(self, record: FloatArray) -> None:
        """Give the last command again: ``record`` has it, as it is to first order under what else holds in this sample."""
        fields = self._problem.record_fields
        values, given = self._kept["before_values"].numpy(), record[:, fields["inputs"]]
        back = (values - given[:, self._whole.places])[0]
        record[:, fields["unknowns"]] += self.by @ back
        given[:, self._whole.places] = values
        moved = self._task.carried.numpy()[0, :, 1:] @ back
        record[:, fields["position"]] += moved[:3]
        record[:, fields["rotation"]] = (matrices(moved[None, 3:])[0] @ record[0, fields["rotation"]].reshape(3, 3)).ravel()

    def settled(self, record: FloatArray, told: FloatArray) -> None:
        """The command was looked at: ``record`` is that of its own last integration, and the next sample starts from there."""
        self._settled, self._looked = True, self._pace.moved(self._good.told, told)
        record[:] = self._problem.snapshot()
        fields, kept = self._problem.record_fields, self._kept
        for name, field in LOOKED_AT.items():
            kept[name].assign(record[:, fields[field]].reshape(kept[name].numpy().shape))

    def stayed(self, record: FloatArray, told: FloatArray, beyond: NDArray[np.bool_]) -> None:
        """The next sample starts where ``record`` has the last command, and ``told`` says so.

        Which limits of the shape, (shaped,), the step was ``beyond`` is told too.
        """
        fields, kept, k = self._problem.record_fields, self._kept, self._count
        values = record[:, fields["inputs"]][:, self._whole.places]
        for name, field in LOOKED_AT.items():
            kept[name].assign(record[:, fields[field]].reshape(kept[name].numpy().shape))
        kept["good_values"].assign(values)
        for name in ("last_kind", "motion", "foresaw"):
            kept[name].zero_()
        self._whole.write(record[:, fields["unknowns"]], values)
        told[SINGULAR], told[FREE : FREE + k], told[FREE + 8 * k :] = 0.0, values[0], 0.0
        self.hold(told, beyond)
        told[ERROR], told[ANGLE] = self._off_target(record[:, fields["position"]], record[:, fields["rotation"]])

    def hold(self, told: FloatArray, by: NDArray[np.bool_]) -> None:
        """Tell that limits of the shape, (shaped,), hold all that is free."""
        k = self._count
        told[HELD], told[FREE + 7 * k : FREE + 8 * k], told[FREE + 8 * k + len(self._rows.low) : -1] = 1.0, 1.0, by

    def _off_target(self, position: FloatArray, rotation: FloatArray) -> tuple[float, float]:
        """How far a tip (1, 3), (1, 9) is off the target, what was measured taken into account: distance and angle."""
        position_given, rotation_given, axis_given = (bool(own) for own in self._kind)
        moved, turned = (self._kept["offset"].numpy()[0, part] for part in range(2))
        back, given = matrices(-turned[None])[0], self.given
        parts = {"position": given["position"] - moved, "rotation": back @ given["rotation"], "axis": back @ given["axis"]}
        parts = {name: value if own else None for (name, value), own in zip(parts.items(), self._kind, strict=True)}
        parts |= {name: given["direction"] for name, own in zip(SIGHTS, (2, 3), strict=True) if self._kind[0] == own}
        target = PoseRows(weight=np.ones(2), **parts)
        left = target.errors(position, rotation.reshape(1, 3, 3))[0][0]
        first = target.position_rows
        distance, angle = np.linalg.norm(left[:first]), np.linalg.norm(left[first:])
        return (float(distance) if position_given else np.nan), (float(angle) if rotation_given or axis_given else np.nan)

    def _made(self, kind: Kind) -> Callable[[], None]:
        state: Any = Control()
        for name, each in self._given.items():
            setattr(state, name, each.array)
        for name, array in self._kept.items():
            setattr(state, name, array)
        m = row_count(kind)
        state.pulled = int(self._centre is not None and self._count > m)
        state.task, state.step, state.records = self._task, self._programme(m, 2 + state.pulled), self._problem.records
        for name in ("rows", "ahead"):
            setattr(state, name, self._zeros(m))
        if self._shared:
            self._off[kind] = state.rows.numpy()[0]
        constants = {"unit": self._unit, "centre": np.zeros(self._count) if self._centre is None else self._centre}
        for name, values in constants.items():
            setattr(state, name, wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=self._problem.device))
        for name in ("limits", "low", "high"):
            setattr(state, name, self._limits[name].array)
        state.longest, state.nearby = self._pace.longest.array, self._pace.nearby.array
        state.watched, state.curvature = self._watch.state, float(self._problem.curvature_scale()[0])
        state.weight, state.gain, state.kind = wp.vec2d(*self._weight), wp.vec2d(*self._gains), wp.vec3i(*kind)
        self._states.append(state)
        return record(make_control, 1, [state], self._problem.device).launch

    def _programme(self, m: int, sides: int) -> Programme:
        result = programme(1, m, self._count, len(self._limits["low"].values), self._problem.device, sides=sides)
        result.limits = self._limits["scaled"].array
        return result

    def _zeros(self, *shape: int) -> WarpArray:
        return wp.zeros((1, *shape), dtype=wp.float64, device=self._problem.device)
