"""Down in energy, from what is no equilibrium to where the robot comes to rest.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
        pose_columns: Shape (6, n).
        position: Of the end effector [m], shape (3,).
        rotation: Shape (3, 3).
        angle: Of the base [rad].
    """

    unknowns: FloatArray
    level: float
    residual: FloatArray
    gamma: FloatArray
    pose_columns: FloatArray
    position: FloatArray
    rotation: FloatArray
    angle: float

    @property
    def size(self) -> float:
        """Largest residual [1/m]; infinite where the integration failed."""
        size = float(np.abs(self.residual).max())
        return size if np.isfinite(size) else np.inf


@dataclass(frozen=True)
class Slope:
    """(2), (3) The potential energy as a function of how the tip is turned, to second order.

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


class Ground:
    """The energy around points of one instance.

    Args:
        problem: With columns of the pose.
        tip: What its residual is.
        instance: Its number.
    """

    def __init__(self, problem: BoundaryProblem, tip: FreeTip, instance: int) -> None:
        self.unit = np.array(tip.moment_unit[instance])
        self.stiffness = float(tip.turn_stiffness[instance])
        self.axes = None if tip.moment_axes is None else np.array(tip.moment_axes[instance])

    def slope(self, point: Point) -> Slope | None:
        """The energy at a point; None where the turn of the tip does not say what the rod is like, or nothing is finite."""
        frame = point.rotation
        if self.axes is not None:
            c, s = np.cos(point.angle), np.sin(point.angle)
            frame = self.axes @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        Y = frame.T @ point.pose_columns[3:]
        if not (np.isfinite(Y).all() and np.isfinite(point.gamma).all()) or np.linalg.cond(Y) * KEPT > 1:
            return None
        A = self.unit[:, None] * point.gamma @ np.linalg.inv(Y)
        values, modes = np.linalg.eigh(0.5 * (A + A.T))
        return Slope(self.unit * point.residual, values / self.stiffness, modes, Y, self.stiffness)


BoolArray = NDArray[np.bool_]
