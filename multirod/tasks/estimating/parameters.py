"""Parameters of a robot as numbers of a fit, and the robot that has them. Numbers in parentheses: ``docs/estimation.md``."""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from multirod.assembly import Assembly
from multirod.profile import Profile
from multirod.rod import Rod, Section
from multirod.rotations import left_jacobian, matrices
from multirod.tasks.estimating.iteration import block_diagonal
from multirod.tasks.estimating.priors import Prior
from multirod.validation import FloatArray, refuse

STIFFNESSES = ("bending_stiffness", "torsional_stiffness")
PARAMETERS = (*STIFFNESSES, "precurvature", "base")


@dataclass(frozen=True)
class Group:
    """Numbers of one parameter: the rod, section and component of each, or none."""

    name: str
    places: tuple[tuple[int, int, int], ...]
    labels: tuple[str, ...]


class Parameters:
    """The numbers that are fitted, ``p = 0`` at first, and the robots that go with them."""

    def __init__(self, robot: Assembly, priors: Mapping[str, Prior]) -> None:
        self.begin = robot
        groups = {name: _group(robot, name) for name in priors}
        self.labels = tuple(label for group in groups.values() for label in group.labels)
        self.groups = groups
        self.places: dict[str, slice] = {}
        first = 0
        for name, group in groups.items():
            self.places[name] = slice(first, first + len(group.labels))
            first += len(group.labels)
        self.count = first
        own = [priors[name].variances(name, len(group.labels), (), None) for name, group in groups.items()]
        self.prior = block_diagonal(own)[0]

    def values(self, p: FloatArray) -> FloatArray:
        """What is told of the numbers, shape (k,)."""
        result = np.array(p)
        for name, group in self.groups.items():
            own = self.places[name]
            if name in STIFFNESSES:
                result[own] = np.exp(p[own])
            elif name == "precurvature":
                result[own] += [_precurvature(self.begin.rods[i].sections[j])[k] for i, j, k in group.places]
        return result

    def covariance(self, p: FloatArray, covariance: FloatArray) -> FloatArray:
        """Of what is told."""
        unit = np.ones(len(p))
        for name, own in self.places.items():
            if name in STIFFNESSES:
                unit[own] = np.exp(p[own])
        return np.asarray(covariance * unit[:, None] * unit)

    def robot(self, p: FloatArray) -> Assembly:
        """The robot with these numbers, shape (k,)."""
        rods = [copy(rod) for rod in self.begin.rods]
        for name, group in self.groups.items():
            if name == "base":
                continue
            for (i, j, k), number in zip(group.places, p[self.places[name]], strict=True):
                rods[i].sections = tuple(
                    section if j not in (-1, at) else CHANGES[name](section, k, float(number))
                    for at, section in enumerate(rods[i].sections)
                )
        result = self.begin.with_rods(rods) if set(self.groups) - {"base"} else self.begin
        if "base" in self.groups:
            moved = p[self.places["base"]]
            base = np.array(self.begin.base)  # type: ignore[attr-defined]
            base[:3, 3] += moved[:3]
            base[:3, :3] = matrices(moved[None, 3:])[0] @ base[:3, :3]
            result = result.with_base(base)
        return result

    def columns(self, robot: Assembly, p: FloatArray) -> FloatArray:
        """(13) How the columns that a robot gives, all parameters one after another, vary with the numbers, shape (column, k)."""
        result = []
        for name, group in self.groups.items():
            own = np.zeros((robot.column_count(name), len(group.labels)))
            if name == "base":
                # turned already, it turns on as the rotation vector's change has it
                own[:3, :3], own[3:, 3:] = np.eye(3), left_jacobian(p[self.places[name]][None, 3:])[0]
            else:
                size = COMPONENTS[name]
                sections = own.shape[0] // (size * robot.rod_count)
                table = own.reshape(robot.rod_count, sections, size, -1)
                for at, (i, j, k) in enumerate(group.places):
                    if name == "precurvature":
                        table[i, j, k, at] = 1.0
                        continue
                    for section, values in enumerate(robot.rods[i].sections):  # by its logarithm
                        stiffness = np.asarray(getattr(values, name)).reshape(-1)
                        table[i, section, :, at] = np.where(np.isfinite(stiffness), stiffness, 0.0)
            result.append(own)
        full = np.zeros((sum(len(own) for own in result), self.count))
        row = column = 0
        for own in result:
            full[row : row + own.shape[0], column : column + own.shape[1]] = own
            row, column = row + own.shape[0], column + own.shape[1]
        return full


BASE = (*(f"moved along {axis} [m]" for axis in "xyz"), *(f"turned about {axis} [rad]" for axis in "xyz"))
COMPONENTS = {"bending_stiffness": 2, "torsional_stiffness": 1, "precurvature": 3}


def _scaled(name: str) -> Callable[[Section, int, float], Section]:
    return lambda section, _, number: replace(section, **{name: getattr(section, name) * np.exp(number)})


def _bent(section: Section, component: int, number: float) -> Section:
    changed = np.array(_precurvature(section))
    changed[component] += number
    return replace(section, precurvature=changed)


CHANGES = {
    "bending_stiffness": _scaled("bending_stiffness"),
    "torsional_stiffness": _scaled("torsional_stiffness"),
    "precurvature": _bent,
}


def _precurvature(section: Section) -> FloatArray:
    if isinstance(section.precurvature, Profile):
        raise NotImplementedError("calibrate() by precurvature that is a function of arclength: cut the rod into sections")
    return section.precurvature


def _group(robot: Assembly, name: str) -> Group:
    """Which numbers a parameter of a robot has."""
    if name == "base":
        return Group(name, ((-1, -1, -1),) * 6, tuple(f"base: {said}" for said in BASE))
    called = [rod.name or f"rod {i + 1}" for i, rod in enumerate(robot.rods)]
    if name in STIFFNESSES:
        rods = [i for i, rod in enumerate(robot.rods) if _finite(rod, name)]
        if not rods:
            refuse("parameters", name, "must not be fitted: no rod has one that is finite")
        return Group(name, tuple((i, -1, 0) for i in rods), tuple(f"{called[i]}: {name}, over what it was" for i in rods))
    curved = [(i, j) for i, rod in enumerate(robot.rods) for j, s in enumerate(rod.sections) if np.any(_precurvature(s))]
    curved = curved or [(i, j) for i, rod in enumerate(robot.rods) for j in range(len(rod.sections))]
    places = tuple((i, j, k) for i, j in curved for k in range(3))
    return Group(name, places, tuple(f"{called[i]}: precurvature {'xyz'[k]}, section {j + 1} [1/m]" for i, j, k in places))


def _finite(rod: Rod, name: str) -> bool:
    return any(np.isfinite(getattr(section, name)).all() for section in rod.sections)
