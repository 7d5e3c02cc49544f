"""Parameters of a robot as numbers of a fit, and the robot that has them. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol, TypeAlias

import numpy as np

from multirod.assembly import Assembly
from multirod.profile import Profile
from multirod.read_only import changed
from multirod.rod import Rod, Section
from multirod.rotations import left_jacobian, matrices
from multirod.tasks.estimating.inference import block_diagonal
from multirod.tasks.estimating.priors import Prior
from multirod.validation import FloatArray, refuse

FACTORS = ("bending_stiffness", "torsional_stiffness", "foundation", "magnetisation")  # told over what they were
FACTOR = ", over what it was"
TURNED = 2.0  # by how much a rod may well be bent at rest, from base to tip [rad]
PARAMETERS = (*FACTORS, "precurvature", "base")
SCALED = (*FACTORS, "precurvature")  # may share a factor
Key: TypeAlias = str | tuple[str, ...]  # a parameter, or several that share a factor


class Group(Protocol):
    """Numbers that are fitted together, ``p = 0`` at first.

    Attributes:
        names: Parameters of the robot that they change.
        labels: What each number is.
        likely: (13c) By how much each may well be off, shape (k,).
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    likely: FloatArray

    def told(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What is told of the numbers (k,), and its derivative by them, shapes (k,)."""

    def put(self, robot: Assembly, rods: list[Rod], p: FloatArray) -> Assembly:
        """The robot with them; what they change of its rods is put into ``rods`` instead."""

    def columns(self, robot: Assembly, name: str, p: FloatArray) -> FloatArray:
        """(13) How columns that the robot with them gives by ``name`` vary with the numbers, shape (column, k)."""


class Scaled:
    """Each a factor ``e^p``, of one parameter of a rod or of several together, all sections and axes alike."""

    def __init__(self, labels: Sequence[str], parts: Sequence[Sequence[tuple[str, int]]]) -> None:
        self.labels, self._parts = tuple(labels), parts
        self.names = tuple(dict.fromkeys(name for part in parts for name, _ in part))
        self.likely = np.ones(len(parts))

    def told(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As ``Group`` says."""
        return _factors(p), _factors(p)

    def put(self, robot: Assembly, rods: list[Rod], p: FloatArray) -> Assembly:
        """As ``Group`` says."""
        for part, factor in zip(self._parts, _factors(p), strict=True):
            for name, i in part:
                sections = [replace(own, **{name: _number(own, name) * factor}) for own in rods[i].sections]
                rods[i] = changed(rods[i], sections=tuple(sections))
        return robot

    def columns(self, robot: Assembly, name: str, p: FloatArray) -> FloatArray:
        """As ``Group`` says; by the logarithm."""
        result, table = _table(robot, name, len(p))
        for at, part in enumerate(self._parts):
            for own, i in part:
                if own == name:
                    for section, values in enumerate(robot.rods[i].sections):
                        number = np.asarray(_number(values, name)).reshape(-1)
                        table[i, section, :, at] = np.where(np.isfinite(number), number, 0.0)
        return result


class Bent:
    """What is added to the precurvature of sections, component by component."""

    names: tuple[str, ...] = ("precurvature",)

    def __init__(self, labels: Sequence[str], places: Sequence[tuple[int, int, int]], begin: Assembly) -> None:
        self.labels, self._places = tuple(labels), places
        self._begin = np.array([_precurvature(begin.rods[i].sections[j])[k] for i, j, k in places])
        lengths = np.array([begin.rods[i].length for i, _, _ in places])
        self.likely = np.maximum(TURNED / lengths, np.abs(self._begin))

    def told(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As ``Group`` says."""
        return self._begin + p, np.ones(len(p))

    def put(self, robot: Assembly, rods: list[Rod], p: FloatArray) -> Assembly:
        """As ``Group`` says."""
        for (i, j, k), number in zip(self._places, p, strict=True):
            sections = list(rods[i].sections)
            precurvature = np.array(_precurvature(sections[j]))
            precurvature[k] += number
            sections[j] = replace(sections[j], precurvature=precurvature)
            rods[i] = changed(rods[i], sections=tuple(sections))
        return robot

    def columns(self, robot: Assembly, name: str, p: FloatArray) -> FloatArray:
        """As ``Group`` says."""
        result, table = _table(robot, name, len(p))
        for at, (i, j, k) in enumerate(self._places):
            table[i, j, k, at] = 1.0
        return result


class Moved:
    """How far the base is moved, then turned about itself, in the world."""

    names: tuple[str, ...] = ("base",)
    labels: tuple[str, ...] = (
        *(f"base: moved along {axis} [m]" for axis in "xyz"),
        *(f"base: turned about {axis} [rad]" for axis in "xyz"),
    )

    def __init__(self, begin: Assembly) -> None:
        self.likely = np.repeat([max(rod.length for rod in begin.rods), 1.0], 3)

    def told(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As ``Group`` says."""
        return p, np.ones(len(p))

    def put(self, robot: Assembly, rods: list[Rod], p: FloatArray) -> Assembly:
        """As ``Group`` says."""
        base = np.array(robot.base)  # type: ignore[attr-defined]
        base[:3, 3] += p[:3]
        base[:3, :3] = matrices(p[None, 3:])[0] @ base[:3, :3]
        return robot.with_base(base)

    def columns(self, robot: Assembly, name: str, p: FloatArray) -> FloatArray:
        """As ``Group`` says; turned already, it turns on as the rotation vector's change has it."""
        result = np.eye(6)
        result[3:, 3:] = left_jacobian(p[None, 3:])[0]
        return result


class Parameters:
    """The numbers that are fitted, ``p = 0`` at first, and the robots that go with them.

    Attributes:
        names: Parameters of the robot that they change, each once.
        places: Where the numbers of each group are among all.
        likely: (13c) By how much each may well be off, shape (k,).
    """

    def __init__(self, robot: Assembly, priors: Mapping[Key, Prior]) -> None:
        self.begin = robot
        self.groups: dict[Key, Group] = {key: _group(robot, key) for key in priors}
        self.names = tuple(name for group in self.groups.values() for name in group.names)
        robot.input_directions(*(name for name in self.names if name != "base"))  # which that robot may refuse
        self.labels = tuple(label for group in self.groups.values() for label in group.labels)
        self.places: dict[Key, slice] = {}
        first = 0
        for key, group in self.groups.items():
            self.places[key] = slice(first, first + len(group.labels))
            first += len(group.labels)
        self.count = first
        self.likely = np.concatenate([group.likely for group in self.groups.values()])
        own = [priors[key].variances(said(key), len(group.labels), (), None) for key, group in self.groups.items()]
        self.prior = block_diagonal(own)[0]

    def values(self, p: FloatArray) -> FloatArray:
        """What is told of the numbers, shape (k,)."""
        return self._told(p)[0]

    def covariance(self, p: FloatArray, covariance: FloatArray) -> FloatArray:
        """Of what is told."""
        unit = self._told(p)[1]
        return np.asarray(covariance * unit[:, None] * unit)

    def _told(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = [group.told(p[self.places[key]]) for key, group in self.groups.items()]
        return np.concatenate([value for value, _ in parts]), np.concatenate([unit for _, unit in parts])

    def robot(self, p: FloatArray) -> Assembly:
        """The robot with these numbers, shape (k,)."""
        rods, result = list(self.begin.rods), self.begin
        for key, group in self.groups.items():
            result = group.put(result, rods, p[self.places[key]])
        return result.with_rods(rods) if set(self.names) - {"base"} else result

    def columns(self, robot: Assembly, p: FloatArray) -> FloatArray:
        """(13) How the columns that a robot gives by ``names``, one after another, vary with the numbers, shape (column, k)."""
        result = []
        for key, group in self.groups.items():
            for name in group.names:
                rows = np.zeros((robot.column_count(name), self.count))
                rows[:, self.places[key]] = group.columns(robot, name, p[self.places[key]])
                result.append(rows)
        return np.concatenate(result)


def said(key: Key) -> str:
    """Parameters that are fitted together, in words."""
    return key if isinstance(key, str) else " and ".join(key)


def _table(robot: Assembly, name: str, count: int) -> tuple[FloatArray, FloatArray]:
    """Zeros, of columns by a parameter and ``count`` numbers, and the same as (rod, section, component, number)."""
    result = np.zeros((robot.column_count(name), count))
    sections = max(len(rod.sections) for rod in robot.rods)
    return result, result.reshape(robot.rod_count, sections, -1, count)


def _factors(p: FloatArray) -> FloatArray:
    """Infinite where a step leads beyond all numbers; there is no such robot."""
    with np.errstate(over="ignore"):
        return np.asarray(np.exp(p))


def _number(section: Section, name: str) -> FloatArray:
    return _precurvature(section) if name == "precurvature" else np.asarray(getattr(section, name))


def _precurvature(section: Section) -> FloatArray:
    if isinstance(section.precurvature, Profile):
        raise NotImplementedError("calibrate() by precurvature that is a function of arclength: cut the rod into sections")
    return section.precurvature


def _group(robot: Assembly, key: Key) -> Group:
    """Which numbers a parameter of a robot has, or parameters that share a factor."""
    if key == "base":
        return Moved(robot)
    if not isinstance(key, str):
        part = [(name, i) for name in key for i in _rods(robot, name)]
        return Scaled([f"all rods: {said(key)}, over what {'they were' if len(key) > 1 else 'it was'}"], [part])
    called = [rod.name or f"rod {i + 1}" for i, rod in enumerate(robot.rods)]
    if key in FACTORS:
        rods = _rods(robot, key)
        return Scaled([f"{called[i]}: {key}{FACTOR}" for i in rods], [[(key, i)] for i in rods])
    curved = [(i, j) for i, rod in enumerate(robot.rods) for j, s in enumerate(rod.sections) if _precurvature(s).any()]
    curved = curved or [(i, j) for i, rod in enumerate(robot.rods) for j in range(len(rod.sections))]
    places = [(i, j, k) for i, j in curved for k in range(3)]
    return Bent([f"{called[i]}: precurvature {'xyz'[k]}, section {j + 1} [1/m]" for i, j, k in places], places, robot)


def _rods(robot: Assembly, name: str) -> list[int]:
    """Those that have a parameter, which can be scaled."""
    numbers = [[_number(section, name) for section in rod.sections] for rod in robot.rods]
    rods = [i for i, own in enumerate(numbers) if any(np.isfinite(number).all() and number.any() for number in own)]
    if not rods:
        refuse("parameters", name, "must not be fitted: no rod has one that is finite and not zero")
    return rods
