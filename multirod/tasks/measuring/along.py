"""What sensors along the rods and of their lines are told by: one integration, at the places of all of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.batch import Instances
from multirod.by_name import the_only_backbone
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem, PosesSensed
from multirod.results.derivatives import places_on
from multirod.tasks.formulation import Evaluation, PosedAt, Task
from multirod.tasks.measuring.tension import Tension, line_indices
from multirod.validation import FloatArray, index_of, known_as, refuse


class Sensed(Protocol):
    """A sensor.

    Attributes:
        rod: Index or name of its rod; None of one that does not say.
        quantity: What of the rod it sees, as ``Sensing`` has it.
    """

    rod: int | str | None
    quantity: ClassVar[str]

    @property
    def places(self) -> FloatArray | None:
        """Arclengths along its rod [m], rising; None of a sensor of the end effector."""


@dataclass(frozen=True)
class Along:
    """What an integration said along the rods.

    Attributes:
        sensed: By quantity and rod, values and their columns, as ``Sensing`` has them.
        poses: By rod, as ``Sensing.poses`` has them.
    """

    sensed: Mapping[tuple[str, int], tuple[FloatArray, FloatArray]]
    poses: Mapping[int, PosesSensed]


@dataclass(frozen=True)
class AlongEvaluation(Evaluation):
    """What one integration says along the rods too, as ``Along`` has it."""

    sensed: Mapping[tuple[str, int], tuple[FloatArray, FloatArray]]
    poses: Mapping[int, PosesSensed]

    def take(self, instances: Instances) -> Self:
        """That of some instances, by an index of the first axis."""
        own = Evaluation(**{name: getattr(self, name) for name in Evaluation.__dataclass_fields__}).take(instances)
        return type(self)(**vars(own), **vars(_taken(self, instances)))

    def by(self, columns: FloatArray) -> Self:
        """As said."""
        n, own = self.residual.shape[1], super().by(columns)

        def joined(values: FloatArray) -> FloatArray:
            return np.concatenate([values[..., :n], values[..., n:] @ columns], axis=-1)

        sensed = {key: (value, joined(by)) for key, (value, by) in self.sensed.items()}
        poses = {rod: replace(each, columns=joined(each.columns)) for rod, each in self.poses.items()}
        return replace(own, sensed=sensed, poses=poses)

    def pose_at(self, place: tuple[int, int] | None) -> PosedAt:
        """As said; at a place along a rod too."""
        if place is None:
            return super().pose_at(place)
        (rod, index), n = place, self.residual.shape[1]
        found = self.poses[rod]
        columns = found.columns[:, index]
        return found.position[:, index], found.rotation[:, index], columns[..., :n], columns[..., n:]


def _taken(found: Along | AlongEvaluation, instances: Instances) -> Along:
    """Copies of those of some instances."""
    sensed = {key: (np.array(value[instances]), np.array(by[instances])) for key, (value, by) in found.sensed.items()}
    poses = {rod: PosesSensed(*(np.array(own[instances]) for own in vars(each).values())) for rod, each in found.poses.items()}
    return Along(sensed, poses)


class Places:
    """Where all sensors along the rods of a robot are: every place once, and the rods that have one.

    Args:
        robot: The robot.
        inputs: By which rods are pushed along.
        sensors: All, of which some are along rods.

    Attributes:
        at: Rising arclengths [m], shape (count,).
        sensed: Quantities and rods of which they are measured, poses aside.
        posed: Rods of which poses are measured.
        on_lines: Whether tensions are measured.

    Raises:
        ValueError: If there is no such rod or line, or a place is not on it.
    """

    def __init__(self, robot: Assembly, inputs: Inputs, sensors: Sequence[Sensed | Tension]) -> None:
        every: dict[int, tuple[int, FloatArray]] = {}
        sections = [[section.length for section in rod.sections] for rod in robot.rods]
        seen: set[tuple[str, int]] = set()
        own_lines: dict[int, list[int]] = {}
        for sensor in sensors:
            if isinstance(sensor, Tension):
                own_lines[id(sensor)] = line_indices(sensor, [line.name for _, line in robot.lines])
            elif sensor.places is not None:
                rod = rod_index(f"{type(sensor).__name__}.rod", robot, sensor.rod)
                seen.add((sensor.quantity, rod))
                every[id(sensor)] = rod, places_on(sections, inputs.translation, sensor.places, rod)
        self.sensed = tuple(sorted(key for key in seen if key[0] != "poses"))
        self.posed = tuple(sorted(rod for quantity, rod in seen if quantity == "poses"))
        self.at: FloatArray = np.unique(np.concatenate([np.zeros(0), *(at for _, at in every.values())]))
        self._found = {key: (rod, _followed(np.searchsorted(self.at, at))) for key, (rod, at) in every.items()}
        self._found |= {key: (0, _followed(np.array(own, dtype=np.intp))) for key, own in own_lines.items()}
        self.on_lines = bool(own_lines)

    def of(self, sensor: Sensed | Tension) -> tuple[int, NDArray[np.intp] | slice]:
        """The rod of a sensor, and which of all places are its own; of tensions 0, and which lines."""
        return self._found[id(sensor)]

    def one(self, sensor: Sensed) -> tuple[int, int] | None:
        """The same of a sensor at one place; None of one of the end effector."""
        if sensor.places is None:
            return None
        rod, own = self.of(sensor)
        assert isinstance(own, slice)  # as all that follow each other
        return rod, int(own.start)


def rod_index(field: str, robot: Assembly, rod: int | str | None) -> int:
    """Number of a rod, from the first, which it is where a robot has one backbone and none is named."""
    names = [own.name for own in robot.rods]
    if rod is None:
        return the_only_backbone(field, robot)
    index = index_of(field, rod, names)
    if index is None or index < 0:
        refuse(field, rod, known_as(names))
    return index


def _followed(places: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Indices as a slice, which is read sooner, where they follow each other."""
    first = int(places[0])
    return slice(first, first + len(places)) if (np.diff(places) == 1).all() else places


class AlongTask(Task):
    """A task whose integrations tell more at some places too, and their columns, where there are any."""

    def __init__(self, problem: BoundaryProblem, free: Sequence[str], places: Places) -> None:
        super().__init__(problem, free)
        self._sense(places)

    def _sense(self, places: Places) -> None:
        self._along = places
        self._pass = self.problem.sensing(places.at) if len(places.at) else None

    def integrate(self) -> None:
        """As said; of all places too."""
        if self._pass is None:
            self.problem.integrate()
            return
        self.problem.heed_stop()
        self._pass.launch()

    def last(self, instances: NDArray[np.intp] | slice = slice(None)) -> Evaluation:
        """What the last integration said of some instances."""
        found = super().last(instances)
        if self._pass is None and not self._along.on_lines:
            return found
        along = _taken(self.sensed(), instances)
        if found.failed.any():
            for values in (*along.sensed.values(), *(tuple(vars(each).values()) for each in along.poses.values())):
                for own in values:
                    own[found.failed] = np.nan
        return AlongEvaluation(**vars(found), **vars(along))

    def sensed(self) -> Along:
        """What the last integration said of the places; to be read at once."""
        sensed: dict[tuple[str, int], tuple[FloatArray, FloatArray]] = {}
        poses: dict[int, PosesSensed] = {}
        if self._pass is not None:
            sensed = {(name, rod): getattr(self._pass, name)(self.free, rod) for name, rod in self._along.sensed}
            poses = {rod: self._pass.poses(self.free, rod) for rod in self._along.posed}
        if self._along.on_lines:
            lines = self.problem.lines
            assert lines is not None  # as a robot with lines has
            sensed["tension", 0] = lines.tension()[..., None], lines.tension_columns(*self.free)[:, :, None]
        sensed = {key: (value, self.chosen(by)) for key, (value, by) in sensed.items()}
        return Along(sensed, {rod: replace(each, columns=self.chosen(each.columns)) for rod, each in poses.items()})
