"""Limits of shapes, kept by a controller from sample to sample. Numbers in parentheses: ``docs/tasks.md``."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.batch import IntArray
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.problem import BoundaryProblem
from multirod.stability import modes_of
from multirod.tasks.controlling.control_step_kernels import LONGEST
from multirod.tasks.formulation import Task
from multirod.tasks.limits import Limits
from multirod.validation import FloatArray

NODES = 101  # of each rod, where its curvature is looked at
PROBE = 1e-3  # in units (9): steps of the differences (18)
ASKED_BELOW = 0.1  # room, of a limit of the curvature or in stability margin, below which (18) is asked for
# of that room, which a command that is accepted leaves: what a look is off to higher order, and rounding, after it
LEAST_ROOM = 1e-4
FLAT = 1e-4  # change of that room by a unit (9), below which it is rounding: a rod as bent at rest as its limit stays so
ROUNDED = np.array([1e-6, 0.0])  # of that room of either limit, what is rounding: of a curvature that is integrated
FULL = 0.99  # of the longest step, what is as long
INSET = 2e-3  # of that room, which steps leave: what they are off to second order


def largest_bending(problem: BoundaryProblem) -> FloatArray:
    """Largest ``|u_xy|`` of any rod at what the problem holds [1/m], shape (b,); zero of a robot without shapes."""
    if problem.shapes is None:
        return np.zeros(problem.instance_count)
    shapes, _ = problem.shapes.at_nodes(NODES)
    jumps = problem.shapes.jumps() or (np.zeros((problem.instance_count, 0)),) * len(shapes)
    most = [
        _most(np.linalg.norm(shape.curvature[..., :2], axis=-1), shape.arclength, own)
        for shape, own in zip(shapes, jumps, strict=True)
    ]
    return np.asarray(np.max(most, axis=0))


def _most(bent: FloatArray, arclength: FloatArray, jumps: FloatArray) -> FloatArray:
    """Most of what is known at nodes (b, node), and of what it goes on to from either side where it may jump, shape (b,)."""
    every, last = np.arange(len(bent)), bent.shape[1] - 1
    most, jumps = np.fmax.reduce(bent, axis=1), np.sort(jumps, axis=1)
    for j, at in enumerate(jumps.T):
        before = (arclength <= at[:, None]).sum(axis=1) - 1
        within = (before >= 0) & (before < last)
        for near, step, other in ((before, -1, j - 1), (before + 1, 1, j + 1)):
            near, far = np.clip(near, 0, last), np.clip(near + step, 0, last)
            stretch = arclength[every, near] - arclength[every, far]
            known = within & (stretch != 0)
            if 0 <= other < jumps.shape[1]:  # both nodes on this side of the next jump
                known &= (arclength[every, far] - jumps[:, other]) * step < 0
            slope = (bent[every, near] - bent[every, far]) / np.where(known, stretch, 1.0)
            most = np.fmax(most, np.where(known, bent[every, near] + slope * (at - arclength[every, near]), 0.0))
    return np.asarray(most)


def room(problem: BoundaryProblem, limits: Limits, rows: IntArray | None = None) -> FloatArray:
    """What each limit of the shape leaves at the equilibria that the problem holds, of all or some, >= 0 within: of the curvature
    as a part of its limit, then of the stability margin; shape (b, 1 or 2). NaN where it is not known."""
    left = []
    if limits.curvature is not None:
        left.append(1 - largest_bending(problem)[slice(None) if rows is None else rows] / limits.curvature)
    if limits.stability_margin is not None:
        left.append(modes_of(problem, rows).eigenvalue(0) - limits.stability_margin)
    return np.stack(left, axis=1)


@dataclass(frozen=True)
class Look:
    """A command, looked at.

    Attributes:
        unknowns: Of its equilibrium, shape (1, n).
        inputs: A row of the problem's, shape (1, size).
        by: (2) ``B``: how the unknowns vary with what is free along equilibria, shape (n, k).
        room: What is left of each limit of the shape, shape (count,).
    """

    unknowns: FloatArray
    inputs: FloatArray
    by: FloatArray
    room: FloatArray


class ShapeLimits:
    """Looks at commands, and says how steps are limited where one is near a limit of the shape.

    Args:
        robot: Without leading axes.
        inputs: Where it begins.
        free: Names of freed inputs.
        limits: Of the shape, at least one.
        unit: (9), shape (k,).
        integrator: Of the spatial equations.
        device: Warp device.

    Attributes:
        names: Limits of the shape.
        last: What was found at the last command.
        longest: Step that the next sample may take, in units (9).
        integrations: Of looks, each of an instance or of its shape, since it was last set to zero.
    """

    def __init__(
        self,
        robot: Assembly,
        inputs: Inputs,
        free: tuple[str, ...],
        limits: Limits,
        unit: FloatArray,
        integrator: Integrator,
        device: str,
    ) -> None:
        self._limits, self._unit = limits, unit
        self._one = Task.of(robot, inputs, free, integrator=integrator, device=device)
        many = inputs.with_arrays({name: np.tile(value, (len(unit), 1)) for name, value in inputs.arrays.items()})
        self._probes = Task.of(robot, many, free, integrator=integrator, device=device)
        self.names = limits.shape_names
        self.last: Look
        self._rounded = ROUNDED[[limits.curvature is not None, limits.stability_margin is not None]]
        self.integrations = 0
        self.longest = LONGEST
        self._refused: NDArray[np.bool_] = np.zeros(len(self.names), dtype=bool)  # by the last that was

    def look(self, unknowns: FloatArray, inputs: FloatArray) -> Look:
        """At unknowns (1, n), which are an equilibrium's to first order, and a row of the problem's inputs (1, size)."""
        problem = self._one.problem
        with problem.alone:
            self._place(problem, unknowns, inputs)
            self._one.integrate()
            self.integrations += 1
            towards, by = self._one.last().eliminated
        there = unknowns + towards
        return Look(there, np.array(inputs), by[0], self._room(self._one, there, inputs)[0])

    def within(self, found: Look) -> bool:
        """Whether a look found all within limits; what is not known is not."""
        return bool((found.room >= -self._rounded).all())

    def shortened(self, found: Look) -> NDArray[np.bool_]:
        """Which limits, (count,), made the step to a command as short as it is: those that one was beyond not long ago."""
        short = self.longest < LONGEST and self._step(found) > FULL * self.longest
        return self._refused & short

    def _step(self, found: Look) -> float:
        """The longest part of the step from the last command, in units (9)."""
        return float((np.abs(found.inputs - self.last.inputs)[0, self._one.places] / self._unit).max())

    def refuses(self, found: Look) -> NDArray[np.bool_]:
        """Which limits, (count,), a command is beyond, or nearly so and nearer than the last one: then the next step is half as
        long as the one between them, from then on each twice as long as the one before."""
        no_nearer = (found.room >= -self._rounded) & (found.room >= self.last.room - 0.1 * self._rounded)
        refused = ~((found.room >= LEAST_ROOM) | no_nearer)
        if refused.any():
            self._refused = refused
            self.longest = 0.5 * min(self.longest, self._step(found))
        else:
            self.longest = min(2 * self.longest, LONGEST)
        return refused

    def said(self, found: Look) -> str:
        """What a look has found, in words."""
        parts, room = [], iter(found.room.tolist())
        if self._limits.curvature is not None:
            parts.append(f"the largest curvature is {self._limits.curvature * (1 - next(room)):.4g} 1/m")
        if self._limits.stability_margin is not None:
            margin = self._limits.stability_margin + next(room)
            parts.append(f"the stability margin is {'not known' if np.isnan(margin) else f'{margin:.4g}'}")
        return " and ".join(parts)

    def rows(self, found: Look) -> tuple[FloatArray, FloatArray]:
        """(18) ``matrix p <= high``, shapes (count, k) and (count,), of steps from a command, which is the last from now on."""
        self.last = found
        matrix, high = np.zeros((len(self.names), len(self._unit))), np.full(len(self.names), np.inf)
        near = found.room < ASKED_BELOW if self.longest == LONGEST else np.ones(len(self.names), dtype=bool)
        if near.any():
            places, step = self._probes.places, PROBE * self._unit
            many = np.repeat(found.inputs, len(step), axis=0)
            many[:, places] += np.diag(step)
            probed = self._room(self._probes, found.unknowns + found.by.T * step[:, None], many)
            slope = (probed - found.room).T / step
            slope[np.abs(slope) * self._unit < FLAT] = 0.0
            near &= np.isfinite(slope).all(axis=1)
            matrix[near] = -slope[near]
            high[near] = np.maximum(found.room - INSET, 0.0)[near] + matrix[near] @ found.inputs[0, places]
        return matrix, high

    def _room(self, task: Task, unknowns: FloatArray, inputs: FloatArray) -> FloatArray:
        problem = task.problem
        with problem.alone:
            self._place(problem, unknowns, inputs)
            self.integrations += len(inputs)
            return room(problem, self._limits)

    @staticmethod
    def _place(problem: BoundaryProblem, unknowns: FloatArray, inputs: FloatArray) -> None:
        problem.write("unknowns", unknowns)
        problem.write("inputs", inputs)
