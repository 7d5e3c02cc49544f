"""Robots as functions of numbers that have derivatives: what JAX and PyTorch are given, ``docs/derivatives.md``."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.naming import meant
from multirod.profile import Profile
from multirod.read_only import changed
from multirod.results.solution import Solution
from multirod.rod import Rod, Section
from multirod.rotations import cross_matrix
from multirod.solver import Solver
from multirod.status import Status
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, choice, refuse, shown

OUTPUTS: dict[str, tuple[int, ...]] = {"tip_position": (3,), "tip_pose": (4, 4)}
PARAMETERS = {
    "precurvature": (3,),
    "bending_stiffness": (2,),
    "torsional_stiffness": (),
    "length": (),
    "foundation": (3,),
    "magnetisation": (3,),
}


class Equilibrium:
    """The pose of a robot's end effector at equilibrium, by values of its inputs and of its own numbers.

    Attributes:
        robot: As it is where its numbers are not given.
        of: ``"tip_position"`` [m], shape (..., 3), or ``"tip_pose"``, a homogeneous matrix, (..., 4, 4).
        inputs: Where they are not given.
        solver: That finds the equilibria.
        guess: Where it starts.
    """

    def __init__(
        self, robot: Assembly, of: str, inputs: Inputs | None, solver: Solver | None, guess: "Solution[Any] | Numbers | None"
    ) -> None:
        if not isinstance(robot, Assembly):
            raise TypeError(f"robot must be an assembly, not {type(robot).__name__}")
        if robot.batch_shape:
            refuse("robot", Described(f"leading axes {robot.batch_shape}"), "must be one robot: a batch is made by values")
        self.robot, self.solver, self.guess = robot, solver, guess
        self.of = choice("of", of, OUTPUTS)
        self.output = OUTPUTS[self.of]
        self.inputs = robot.accept(inputs)
        if self.inputs.batch_shape:
            refuse(
                "inputs",
                Described(f"leading axes {self.inputs.batch_shape}"),
                "must be of one instance: a batch is made by values",
            )

    @cached_property
    def tails(self) -> dict[str, tuple[int, ...]]:
        """The last axes of the value of each name that there is."""
        robot = self.robot
        tails: dict[str, tuple[int, ...]] = {spec.name: (spec.size(robot.rod_count),) for spec in robot.input_specs}
        sections = max(len(rod.sections) for rod in robot.rods)
        own = {name: (robot.rod_count, sections, *tail) for name, tail in PARAMETERS.items() if name in robot.parameters}
        return tails | own

    def batch_of(self, shapes: Mapping[str, Sequence[int]]) -> tuple[int, ...]:
        """Leading axes of values of these shapes.

        Raises:
            TypeError: If there is no such input or number, or none is given.
            ValueError: If a shape is not that of the name.
        """
        if not shapes:
            raise TypeError("values are to be given by name: it takes " + ", ".join(self.tails))
        leading = []
        for name, shape in shapes.items():
            if name not in self.tails:
                raise TypeError(f"it takes no {shown(name)}: it takes {', '.join(self.tails)}{meant(name, self.tails)}")
            tail = self.tails[name]
            if tuple(shape)[len(shape) - len(tail) :] != tail or len(shape) < len(tail):
                refuse(name, Described(f"shape {tuple(shape)}"), f"must be (..., {', '.join(map(str, tail))})")
            leading.append(tuple(shape)[: len(shape) - len(tail)])
        try:
            return np.broadcast_shapes(*leading)
        except ValueError:
            named = ", ".join(f"{name} {axes}" for name, axes in zip(shapes, leading, strict=True))
            raise ValueError(f"the leading axes of the values do not broadcast: {named}") from None

    def solve(self, values: Mapping[str, NDArray[Any]]) -> tuple[Solution[Any], NDArray[np.bool_]]:
        """Equilibria at these values, (..., *tail), and which instances have values that are no numbers."""
        from multirod.running.simulation import solve

        shape = self.batch_of({name: np.shape(value) for name, value in values.items()})
        absent = np.zeros(shape, dtype=bool)
        given: dict[str, FloatArray] = {}
        for name, value in values.items():
            tail = self.tails[name]
            full = np.array(np.broadcast_to(value, (*shape, *tail)), dtype=np.float64)
            absent |= ~np.isfinite(full).all(axis=tuple(range(-len(tail), 0)))
            given[name] = full
        for name, full in given.items():
            full[absent] = self._own(name)
        robot = self._robot({name: value for name, value in given.items() if name in PARAMETERS})
        own: dict[str, Any] = self.inputs.arrays
        own |= dict(self.inputs.profiles) | {name: value for name, value in given.items() if name not in PARAMETERS}
        inputs = robot.make_inputs(own)
        return solve(robot, inputs, solver=self.solver, guess=self.guess, progress=False), absent

    def _own(self, name: str) -> FloatArray:
        """The value where none is given."""
        if name not in PARAMETERS:
            return np.asarray(self.inputs.array(name)) if name in self.inputs.given else np.zeros(self.tails[name])
        result = np.zeros(self.tails[name])
        for i, rod in enumerate(self.robot.rods):
            for m, section in enumerate(rod.sections):
                result[i, m] = 0.0 if isinstance(getattr(section, name), Profile) else getattr(section, name)
        return result

    def value_of(self, name: str) -> FloatArray:
        """What the robot or the inputs have: zeros for sections that a rod has not."""
        if name not in self.tails:
            raise TypeError(f"it takes no {shown(name)}: it takes {', '.join(self.tails)}{meant(name, self.tails)}")
        return self._own(name)

    def _robot(self, values: Mapping[str, FloatArray]) -> Assembly:
        if not values:
            return self.robot
        rods = [_changed(rod, i, values) for i, rod in enumerate(self.robot.rods)]
        return self.robot.with_rods(rods)

    def value(self, solution: Solution[Any], absent: NDArray[np.bool_]) -> FloatArray:
        """What is asked for, (..., *output), NaN where there is no result."""
        position = np.array(solution.tip_position)
        position[absent] = np.nan
        if self.of == "tip_position":
            return position
        result = np.zeros((*position.shape[:-1], 4, 4))
        result[..., :3, :3], result[..., :3, 3], result[..., 3, 3] = solution.tip_rotation, position, 1.0
        result[absent | solution.failed] = np.nan
        return result

    def refuse_unknown(self, names: Sequence[str]) -> None:
        """Refuse names by which derivatives are not known, before anything is solved.

        Raises:
            NotImplementedError: If there is one.
        """
        self.robot.input_directions(*names)

    def columns(self, solution: Solution[Any], absent: NDArray[np.bool_], names: Sequence[str]) -> list[FloatArray]:
        """(D15) Derivatives by each name, (..., *output, *tail), NaN where there is no result."""
        found = np.array(solution.jacobian(*names))
        found[absent] = np.nan
        moved, turned = found[..., :3, :], found[..., 3:, :]
        if self.of == "tip_position":
            flat = moved
        else:
            flat = np.zeros((*found.shape[:-2], 4, 4, found.shape[-1]))
            flat[..., :3, 3, :] = moved
            spun = np.einsum("...kij,...jl->...ilk", cross_matrix(np.swapaxes(turned, -1, -2)), solution.tip_rotation)
            flat[..., :3, :3, :] = spun
            flat[absent | solution.failed] = np.nan
        ends = np.cumsum([prod(self.tails[name]) for name in names])
        parts = np.split(flat, ends[:-1], axis=-1)
        return [part.reshape(*part.shape[:-1], *self.tails[name]) for name, part in zip(names, parts, strict=True)]

    def status(self, solution: Solution[Any], absent: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Values of ``Status``, (...); ``NONFINITE`` where a value is no number."""
        status = np.array(solution.status, dtype=np.int32)
        status[absent] = Status.NONFINITE
        return status


def _changed(rod: Rod, i: int, values: Mapping[str, FloatArray]) -> Rod:
    """A rod with values (..., rod, section, ...) in the place of its own."""
    sections: list[Section] = []
    for m, section in enumerate(rod.sections):
        given: dict[str, Any] = {}
        for name, value in values.items():
            if isinstance(getattr(section, name), Profile):
                refuse(name, Described("a function of arclength"), "must be numbers of each section to be a value")
            given[name] = value[..., i, m, :] if PARAMETERS[name] else value[..., i, m]
        sections.append(replace(section, **given))
    batch_shape = np.broadcast_shapes(rod.batch_shape, *(section.batch_shape for section in sections))
    return changed(rod, sections=tuple(sections), batch_shape=batch_shape)
