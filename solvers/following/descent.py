"""Down in energy, from what is no equilibrium to where the robot comes to rest.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from dataclasses import dataclass

import numpy as np

from multirod.capabilities import FreeTip
from multirod.problem import BoundaryProblem
from multirod.validation import FloatArray

SOFT = 1e-6  # of K/L: a mode no stiffer than this is neutral
RADIUS = 0.1  # largest turn in a mode by one step [rad]
NUDGE = 1e-3  # of the radius, along a mode that is unstable where no step is longer
KEPT = 1e-9  # largest condition, inverted, of a Y that is not singular


@dataclass(frozen=True)
class Point:
    """What an integration says of some unknowns at some level.

    Attributes:
        unknowns: [1/m], shape (n,).
        level: Part of the way.
        residual: [1/m], shape (n,).
        gamma: Shape (n, n).
        unit: Moment of one unit of each residual [N m^2], shape (n,).
        turned: ``Y``, how the tip turns with the unknowns, along the axes of the residual, shape (n, n).
        moved: How it moves with them, in the world, shape (3, n).
        position: Of the end effector [m], shape (3,).
        rotation: Shape (3, 3).
    """

    unknowns: FloatArray
    level: float
    residual: FloatArray
    gamma: FloatArray
    unit: FloatArray
    turned: FloatArray
    moved: FloatArray
    position: FloatArray
    rotation: FloatArray

    @property
    def size(self) -> float:
        """Largest residual [1/m]; infinite where the integration failed."""
        size = float(np.abs(self.residual).max())
        return size if np.isfinite(size) else np.inf


@dataclass(frozen=True)
class Slope:
    """(1), (2) The potential energy as a function of how the tip is turned, to second order.

    Attributes:
        gradient: [N m], shape (n,).
        values: Eigenvalues of its second derivative over ``K/L``, ascending, shape (n,).
        modes: Eigenvectors, in columns, shape (n, n).
        turned: ``Y``, how the tip turns with the unknowns, shape (n, n).
        stiffness: ``K/L`` [N m].
    """

    gradient: FloatArray
    values: FloatArray
    modes: FloatArray
    turned: FloatArray
    stiffness: float

    @property
    def along(self) -> FloatArray:
        """Slope in each mode over ``K/L``, shape (n,)."""
        return np.asarray(self.modes.T @ self.gradient / self.stiffness)

    @property
    def neutral(self) -> int:
        """Modes that cannot be told from neutral ones."""
        return int((np.abs(self.values) <= SOFT).sum())

    def step(self, radius: float) -> FloatArray:
        """(4) Change of the unknowns [1/m]: down in every mode, Newton's step where that is shorter, shape (n,)."""
        slope, values = self.along, self.values
        turn = np.minimum(np.abs(slope) / np.maximum(np.abs(values), SOFT), radius)
        if values[0] < -SOFT and turn.max() < NUDGE * radius:  # in balance where nothing holds it
            turn[0] = NUDGE * radius
        return self.change(self.modes @ np.where(slope > 0, -turn, turn))

    def change(self, turn: FloatArray) -> FloatArray:
        """Change of the unknowns [1/m] that turns the tip so [rad], shape (n,)."""
        return np.asarray(np.linalg.solve(self.turned, turn))


class Unfit(Exception):
    """The turn of the tip does not say what the rod is like, or nothing is finite."""


def slope_at(point: Point, stiffness: float) -> Slope:
    """The energy at a point; ``stiffness`` is ``K/L`` [N m].

    Raises:
        Unfit: If the tip's turn does not tell it.
    """
    Y = point.turned
    if not (np.isfinite(Y).all() and np.isfinite(point.gamma).all()) or np.linalg.cond(Y) * KEPT > 1:
        raise Unfit
    A = point.unit[:, None] * point.gamma @ np.linalg.inv(Y)
    values, modes = np.linalg.eigh(0.5 * (A + A.T))
    return Slope(point.unit * point.residual, values / stiffness, modes, Y, stiffness)


class TipTurn:
    """How the tips of a problem turn with the unknowns, along the axes of the residual: ``Y`` of all its instances.

    Args:
        problem: With columns of the pose.
        tip: What its residual is.
    """

    def __init__(self, problem: BoundaryProblem, tip: FreeTip) -> None:
        self._problem, self._tip = problem, tip

    @property
    def unit(self) -> FloatArray:
        """Moment of one unit of the residual [N m^2], shape (instance_count, n)."""
        return self._tip.moment_unit

    @property
    def stiffness(self) -> FloatArray:
        """``K/L`` [N m], shape (instance_count,)."""
        return self._tip.turn_stiffness

    def columns(self) -> FloatArray:
        """``Y`` after an integration, shape (instance_count, n, n)."""
        problem, n = self._problem, self._problem.unknown_count
        frame = problem.read("rotation").reshape(-1, 3, 3)
        if self._tip.moment_axes is not None:
            angle = problem.read("inputs")[:, problem.input_slice("rotation").start]
            turn = np.zeros((len(angle), 3, 3))
            turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
            turn[:, 1, 0], turn[:, 2, 2] = np.sin(angle), 1.0
            turn[:, 0, 1] = -turn[:, 1, 0]
            frame = self._tip.moment_axes @ turn
        return np.asarray(np.swapaxes(frame, 1, 2) @ problem.pose_columns.numpy()[:, 3:, :n])
