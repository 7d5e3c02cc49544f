"""Limits of shapes, kept by a controller from sample to sample. Numbers in parentheses: ``docs/tasks.md``."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.batch import IntArray, solved_each
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.problem import BoundaryProblem
from multirod.rotations import matrices
from multirod.stability import modes_of
from multirod.tasks.controlling.bent import Bent
from multirod.tasks.controlling.control_step_kernels import LONGEST
from multirod.tasks.formulation import Task
from multirod.tasks.limits import Limits
from multirod.validation import FloatArray

NODES = 101  # of each rod, where its curvature is looked at
PROBE = 1e-3  # in units (9): steps of the differences (18c)
IN_TURN = 3  # of the freed numbers, by which differences are taken anew in a sample
FORESEEN = 1e-3  # of room, by which a look may differ from what is known of slopes, which then serve on
ASKED_BELOW = 0.1  # room, of a limit of the curvature or in stability margin, below which (18) is asked for
# of that room, which a command that is accepted leaves: what a look is off to higher order, and rounding, after it
LEAST_ROOM = 1e-4
FLAT = 1e-4  # change of that room by a unit (9), below which it is rounding: a rod as bent at rest as its limit stays so
ROUNDED = np.array([1e-6, 0.0])  # of that room of either limit, what is rounding: of a curvature that is integrated
FULL = 0.99  # of the longest step, what is as long
SETTLED = 1e-4  # of the scale of curvatures: a step to an equilibrium that is no longer is off it by its square
SETTLING = 4  # such steps
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
    every, last = np.arange(len(bent))[:, None], bent.shape[1] - 1
    most, jumps = np.fmax.reduce(bent, axis=1), np.sort(jumps, axis=1)
    before = (arclength[:, None] <= jumps[:, :, None]).sum(axis=2) - 1
    within, none = (before >= 0) & (before < last), np.full((len(bent), 1), np.inf)
    previous, following = np.concatenate([-none, jumps[:, :-1]], axis=1), np.concatenate([jumps[:, 1:], none], axis=1)
    for near, step, other in ((before, -1, previous), (before + 1, 1, following)):
        near, far = np.clip(near, 0, last), np.clip(near + step, 0, last)
        stretch = arclength[every, near] - arclength[every, far]
        # both nodes on this side of the next jump
        known = within & (stretch != 0) & ((arclength[every, far] - other) * step < 0)
        slope = (bent[every, near] - bent[every, far]) / np.where(known, stretch, 1.0)
        reached = np.where(known, bent[every, near] + slope * (jumps - arclength[every, near]), 0.0)
        most = np.fmax(most, np.fmax.reduce(reached, axis=1, initial=0.0))
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
        towards: (2) ``a``, by which the last integration was off that equilibrium, shape (n,).
        by: (2) ``B``: how the unknowns vary with what is free along equilibria, shape (n, k).
        room: What is left of each limit of the shape, shape (count,).
        slopes: How that varies with what is free along equilibria, shape (count, k); NaN where the look does not tell.
    """

    unknowns: FloatArray
    inputs: FloatArray
    towards: FloatArray
    by: FloatArray
    room: FloatArray
    slopes: FloatArray


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
        self._curvature, self._margin = limits.curvature or np.inf, limits.stability_margin or 0.0
        self._one = Task.of(robot, inputs, free, integrator=integrator, device=device)
        self._turn, self._known = 0, np.full((len(limits.shape_names), len(unit)), np.nan)
        shared = min(IN_TURN, len(unit))
        many = inputs.with_arrays({name: np.tile(value, (shared, 1)) for name, value in inputs.arrays.items()})
        self._probes = Task.of(robot, many, free, integrator=integrator, device=device)
        shapes = self._one.problem.shapes
        bending = None if limits.curvature is None or shapes is None else shapes.bending(NODES)
        self._bent = None if bending is None else Bent(self._one, bending)
        for task in (self._one, self._probes) if limits.stability_margin is not None else ():
            task.problem.expect_judging()
        self.names = limits.shape_names
        self.last: Look
        self._rounded = ROUNDED[[limits.curvature is not None, limits.stability_margin is not None]]
        self.integrations = 0
        self.longest = LONGEST
        self._refused: NDArray[np.bool_] = np.zeros(len(self.names), dtype=bool)  # by the last that was

    def look(self, unknowns: FloatArray, inputs: FloatArray, by: FloatArray) -> Look:
        """At unknowns (1, n), which are an equilibrium's to first order, and a row of the problem's inputs (1, size).

        ``by`` is (2) ``B`` (n, k), there or nearby.
        """
        problem, bend = self._one.problem, None
        with problem.alone:
            problem.write("inputs", inputs)
            for _ in range(SETTLING):
                problem.write("unknowns", unknowns)
                if self._bent is None:
                    self._one.integrate()
                else:
                    bend = self._bent.integrate()
                self.integrations += 1
                n = problem.unknown_count
                towards = -solved_each(problem.read("gamma").reshape(1, n, n), problem.read("residual")[..., None])[..., 0]
                unknowns = unknowns + towards
                if not np.abs(towards).max() > SETTLED * problem.curvature_scale()[0]:
                    break
            else:
                unknowns = np.full_like(unknowns, np.nan)  # no equilibrium is near
            problem.write("unknowns", unknowns)
            left, slopes = np.full(len(self.names), np.nan), np.full((len(self.names), len(self._unit)), np.nan)
            for j, name in enumerate(self.names):
                if name == "stability_margin":
                    left[j] = self._margins(problem)[0]
                elif bend is None:
                    left[j] = self._straightness(problem)[0]
                else:
                    left[j] = 1 - (bend.most + bend.by_unknowns @ towards[0]) / self._curvature
                    slopes[j] = -(bend.by_free + bend.by_unknowns @ by) / self._curvature
        return Look(unknowns, np.array(inputs), towards[0], by, left, slopes)

    def settled(self, found: Look) -> dict[str, FloatArray]:
        """``unknowns``, ``position`` and ``rotation`` of the equilibrium that the last look found, as records have them."""
        problem = self._one.problem
        moved = problem.pose_by_unknowns()[0] @ found.towards
        turned = matrices(moved[None, 3:])[0] @ problem.read("rotation").reshape(3, 3)
        return {
            "unknowns": found.unknowns[0],
            "position": problem.read("position")[0] + moved[:3],
            "rotation": turned.ravel(),
        }

    def _margins(self, problem: BoundaryProblem) -> FloatArray:
        """What is left of the stability margin at what a problem holds, shape (b,)."""
        self.integrations += problem.instance_count
        lowest = None if problem.stability is None else problem.stability.lowest()
        return np.asarray((modes_of(problem).eigenvalue(0) if lowest is None else lowest) - self._margin)

    def _straightness(self, problem: BoundaryProblem) -> FloatArray:
        """What is left of the curvature, as a part of its limit, shape (b,)."""
        self.integrations += problem.instance_count
        return np.asarray(1 - largest_bending(problem) / self._curvature)

    def within(self, found: Look) -> bool:
        """Whether a look found all within limits; what is not known is not."""
        return bool((found.room >= -self._rounded).all())

    def shortened(self, found: Look, left_over: bool) -> NDArray[np.bool_]:
        """Which limits, (count,), made the step to a command as short as it is: those that one was beyond not long ago. It is, if
        nothing else holds it and it ``left_over`` some of what was asked for."""
        short = self.longest < LONGEST and (left_over or self._step(found) > FULL * self.longest)
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
            self._refused, self._known[:] = refused, np.nan
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
        before, self.last = self.last, found
        matrix, high = np.zeros((len(self.names), len(self._unit))), np.full(len(self.names), np.inf)
        near = found.room < ASKED_BELOW if self.longest == LONGEST else np.ones(len(self.names), dtype=bool)
        if near.any():
            places, slope = self._probes.places, self._probed(found, near, before)
            slope[np.abs(slope) * self._unit < FLAT] = 0.0
            near &= np.isfinite(slope).all(axis=1)
            matrix[near] = -slope[near]
            high[near] = np.maximum(found.room - INSET, 0.0)[near] + matrix[near] @ found.inputs[0, places]
        else:
            self._known[:] = np.nan
        return matrix, high

    def _probed(self, found: Look, asked: NDArray[np.bool_], before: Look) -> FloatArray:
        """(18) How the room of the limits that are asked for, (count,), varies along equilibria, shape (count, k); where the look
        did not tell, by its differences: (18d) some of the numbers in turn, or all, where these slopes are not known, or did not
        foresee the room that has come since the look ``before``, or steps are short since one was refused."""
        slopes, open_ = found.slopes.copy(), asked & np.isnan(found.slopes).any(axis=1)
        known, every = self._known, np.arange(len(self._unit))
        with np.errstate(invalid="ignore"):
            missed = found.room - before.room - known @ (found.inputs - before.inputs)[0, self._one.places]
            serve = self.longest == LONGEST and bool((np.abs(missed) <= FORESEEN)[open_].all())
        known[~open_] = np.nan
        if not open_.any():
            return slopes
        shared = self._probes.problem.instance_count
        turn = (self._turn + np.arange(shared)) % len(every) if serve else every
        self._turn = int(turn[-1]) + 1
        for first in range(0, len(turn), shared):
            own = turn[first : first + shared]
            own = np.concatenate([own, own[:1].repeat(shared - len(own))])  # as many as there are instances
            known[np.ix_(open_, own)] = self._differences(found, open_, own)
        slopes[open_] = known[open_]
        return slopes

    def _differences(self, found: Look, asked: NDArray[np.bool_], own: IntArray) -> FloatArray:
        """(18c) By some of the freed numbers, as many as there are instances; shape (asked, len(own))."""
        problem, step = self._probes.problem, PROBE * self._unit[own]
        many = np.repeat(found.inputs, len(own), axis=0)
        many[range(len(own)), self._probes.places[own]] += step
        with problem.alone:
            problem.write("unknowns", found.unknowns + found.by[:, own].T * step[:, None])
            problem.write("inputs", many)
            problem.integrate()
            names = np.array(self.names)[asked]
            probed = [self._margins(problem) if name == "stability_margin" else self._straightness(problem) for name in names]
        return np.asarray((np.array(probed) - found.room[asked, None]) / step)
