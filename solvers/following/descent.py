"""Down in energy, from what is no equilibrium to where the robot comes to rest.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from dataclasses import dataclass

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Conjugates
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
        forces: Rows of the residual that are forces, shape (m,); the others are constraints.
        unit: Moment of one unit of each [N m], shape (m,).
        turned: ``Y``, how what they do work on is turned by the unknowns; then the rows of ``gamma`` that are constraints, shape
            (n, n).
        moved: How the end effector moves with these, in the world, shape (3, n).
        position: Of the end effector [m], shape (3,).
        rotation: Shape (3, 3).
    """

    unknowns: FloatArray
    level: float
    residual: FloatArray
    gamma: FloatArray
    forces: IntArray
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
        gradient: [N m], shape (m,).
        values: Eigenvalues of its second derivative over ``K/L``, ascending, shape (m,).
        modes: Eigenvectors, in columns, shape (m, m).
        ways: Change of the unknowns that turns the tip so, constraints kept, shape (n, m).
        back: The one that meets the constraints, shape (n,).
        facing: Sign of the determinant of what ``ways`` is the inverse of.
        stiffness: ``K/L`` [N m].
    """

    gradient: FloatArray
    values: FloatArray
    modes: FloatArray
    ways: FloatArray
    back: FloatArray
    facing: float
    stiffness: float

    @property
    def along(self) -> FloatArray:
        """Slope in each mode over ``K/L``, shape (m,)."""
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
        return self.back + self.change(self.modes @ np.where(slope > 0, -turn, turn))

    def change(self, turn: FloatArray) -> FloatArray:
        """Change of the unknowns [1/m] that turns the tip so [rad], shape (n,)."""
        return np.asarray(self.ways @ turn)


class Unfit(Exception):
    """The turn of the tip does not say what the rod is like, or nothing is finite."""


def slope_at(point: Point, stiffness: float) -> Slope:
    """The energy at a point; ``stiffness`` is ``K/L`` [N m].

    Raises:
        Unfit: If the tip's turn does not tell it.
    """
    m = len(point.forces)
    kept = np.setdiff1d(np.arange(len(point.unknowns)), point.forces)
    both = point.turned
    if not (np.isfinite(both).all() and np.isfinite(point.gamma).all()) or np.linalg.cond(both) * KEPT > 1:
        raise Unfit
    inverse: FloatArray = np.asarray(np.linalg.inv(both), dtype=np.float64)
    A = point.unit[:, None] * point.gamma[point.forces] @ inverse[:, :m]
    values, modes = np.linalg.eigh(0.5 * (A + A.T))
    gradient, back = point.unit * point.residual[point.forces], -inverse[:, m:] @ point.residual[kept]
    return Slope(gradient, values / stiffness, modes, inverse[:, :m], back, float(np.sign(np.linalg.det(both))), stiffness)


class Turns:
    """Which residuals of a problem are forces, and how what they do work on is turned by the unknowns.

    Args:
        pairs: Of the problem.
    """

    def __init__(self, pairs: Conjugates) -> None:
        self._pairs = pairs
        self.forces = pairs.forces
        self.stiffness = pairs.stiffness  # K/L [N m], shape (instance_count,)

    def after(self, gamma: FloatArray) -> tuple[FloatArray, FloatArray]:
        """After an integration that led to ``gamma``, (instance_count, n, n): the moment of one unit of each force [N m], shape
        (instance_count, m), and ``Point.turned``, shape (instance_count, n, n)."""
        pairs, n = self._pairs, gamma.shape[-1]
        pairs.update()
        scale = pairs.scale.numpy()
        result = np.array(gamma)
        result[:, pairs.forces] = pairs.columns.numpy()[:, :, :n] / scale[..., None]
        for row, unknown, by in pairs.give:
            result[:, row, unknown] += by
        order = np.append(pairs.forces, np.setdiff1d(np.arange(n), pairs.forces))
        return pairs.unit.numpy() * scale, result[:, order]
