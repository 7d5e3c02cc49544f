"""What errors are measured against: a motion solved so well that two ways of solving it agree."""

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.batch import IntArray, Interrupted
from multirod.inputs import Inputs
from multirod.integrators import RK4, RK45
from multirod.results.history import History
from multirod.results.solution import Solution
from multirod.running.simulation import Runner, simulate, solve
from multirod.solvers.shooting import Shooting
from multirod.studies.tradeoffs.limit import Limited
from multirod.validation import FloatArray, refuse

REFERENCE = Shooting(tolerance=1e-11, integrator=RK45(1e-12, 1e-14))
CHECK = Shooting(tolerance=1e-11, integrator=RK4(2000))
AGREEMENT = 1e-9  # of the length, and of a radian, that both must agree within
CHECKED_SAMPLES = 20
START_OFF = 1e-4  # of the largest unknown, that the check starts off the reference
SHAPE_NODES = 21
SHAPE_SAMPLES = 25  # a shape costs more than a sample


@dataclass(frozen=True)
class Errors:
    """How far a history is off; NaN where it or the reference has no result.

    Attributes:
        position: Distance of the tips [m], a number a sample.
        rotation: Angle between the end effector's frames [rad], a number a sample.
        shape: Largest distance of two nodes of a rod [m], at some of the samples; NaN where the assembly offers no shapes.
    """

    position: FloatArray
    rotation: FloatArray
    shape: FloatArray


def load_kernels(robot: Assembly, inputs: Inputs) -> None:
    """Compile, or load, what the reference and its check integrate with: this cannot be stopped."""
    first = inputs[0] if inputs.batch_shape else inputs
    for solver in (REFERENCE, CHECK):
        Runner(robot, solver, first, 1.0, "cpu", inputs.active).problem.integrate()


class Reference:
    """Newton's method to 1e-11 with ``RK45(1e-12, 1e-14)``, compared with ``RK4(2000)`` at some of the samples.

    Attributes:
        history: The motion.
        known: Samples in which it has a result, shape (sample_count,).
        gap: How far both are apart, relative to the length, and in the end effector's angle; infinite where one failed.
        by_shape: Whether inputs say where the tip is, so that it tells nothing, and all of the rods count in its place.

    Raises:
        ValueError: If it takes longer than ``budget`` [s].
    """

    def __init__(self, robot: Assembly, inputs: Inputs, time: FloatArray, *, budget: float) -> None:
        done = [0]
        self.by_shape = robot.end_held or "platform_position" in (spec.name for spec in robot.input_specs)
        method, self._check = Limited(REFERENCE, budget), Limited(CHECK, budget)
        try:
            self.history: History = simulate(robot, inputs, time=time, solver=method, progress=lambda k: done.append(k))
            self._compare(robot)
        except Interrupted:
            allowed = f"the reference alone takes longer: {done[-1]} of {len(time)} samples were done in so many seconds"
            refuse("budget", budget, f"{allowed}; give more, or fewer samples")

    def _compare(self, robot: Assembly) -> None:
        self.known = np.asarray(np.isfinite(self.history.tip_position).all(axis=-1))
        self._nodes: dict[int, FloatArray] = {}
        self.length = max(float(np.max(rod.length)) for rod in robot.rods)
        self.gap = self._gap()

    @property
    def checked(self) -> bool:
        """Whether both agree to 1e-9, and no sample failed."""
        return bool(self.gap <= AGREEMENT)

    def errors(self, history: History, settled: NDArray[np.bool_]) -> Errors:
        """How far the first samples are off; shapes at some of those that are ``settled``, the worst for the tip among them."""
        count = len(history.time)
        own = self.history
        position = np.linalg.norm(history.tip_position - own.tip_position[:count], axis=-1)
        counted = np.flatnonzero(settled[:count])
        chosen = _evenly(counted, SHAPE_SAMPLES)
        if len(counted):
            worst = counted[np.argmax(np.nan_to_num(position[counted]))]
            chosen = np.unique(np.append(chosen, worst))
        there = self._nodes_at(chosen)
        apart = np.linalg.norm(_nodes(history, chosen) - there, axis=-1)
        shape = apart.max(axis=(1, 2)) if apart.size else np.full(1, np.nan)
        return Errors(position, _angle(own.tip_rotation[:count], history.tip_rotation), shape)

    def _nodes_at(self, chosen: IntArray) -> FloatArray:
        """Of the rods in some samples, shape (chosen, rod, node, 3), each computed once."""
        new = np.array([k for k in chosen if k not in self._nodes], dtype=np.intp)
        for k, nodes in zip(new, _nodes(self.history, new), strict=True):
            self._nodes[k] = nodes
        return np.array([self._nodes[k] for k in chosen]).reshape(len(chosen), -1, SHAPE_NODES, 3)

    def _gap(self) -> float:
        if not self.known.all():
            return inf
        own, count = self.history, len(self.history.time)
        chosen = _evenly(np.arange(count), CHECKED_SAMPLES)
        inputs = own.inputs.take((count,), chosen)
        unknowns = own.unknowns[chosen]
        # off the solution, or one that is within the tolerance of both would be taken as it is, and agree with itself
        aside = START_OFF * np.abs(unknowns).max(axis=-1, keepdims=True) * np.random.default_rng(0).uniform(-1, 1, unknowns.shape)
        other = solve(own.assembly, inputs, solver=self._check, guess=unknowns + aside, progress=False)
        apart = np.linalg.norm(other.tip_position - own.tip_position[chosen], axis=-1) / self.length
        if self.by_shape:
            shapes = self._nodes_at(chosen) - _nodes(other, np.arange(len(chosen)))
            apart = np.maximum(apart, np.linalg.norm(shapes, axis=-1).max(axis=(1, 2)) / self.length)
        gap = np.maximum(apart, _angle(own.tip_rotation[chosen], other.tip_rotation))
        return float(gap.max()) if np.isfinite(gap).all() else inf


def _evenly(samples: IntArray, count: int) -> IntArray:
    """Some of the samples, evenly."""
    return np.asarray(samples[np.unique(np.linspace(0, len(samples) - 1, count).astype(int))]) if len(samples) else samples


def _nodes(history: History | Solution, chosen: IntArray) -> FloatArray:
    """Of the rods in some samples, shape (chosen, rod, node, 3); no rods where the assembly offers no shapes."""
    if not len(chosen):
        return np.zeros((0, history.assembly.rod_count, SHAPE_NODES, 3))
    some = history[chosen]
    try:
        return np.stack([some.rod(k, nodes=SHAPE_NODES).position for k in range(history.assembly.rod_count)], axis=1)
    except NotImplementedError:
        return np.zeros((len(chosen), 0, SHAPE_NODES, 3))


def _angle(one: FloatArray, other: FloatArray) -> FloatArray:
    """Between frames (..., 3, 3); by the sine where it is small, which the cosine cannot tell from none."""
    turned = np.swapaxes(one, -1, -2) @ other
    sine = np.linalg.norm(turned - np.swapaxes(turned, -1, -2), axis=(-2, -1)) / np.sqrt(8)
    return np.asarray(np.arctan2(sine, (np.trace(turned, axis1=-2, axis2=-1) - 1) / 2))
