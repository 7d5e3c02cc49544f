"""Down in energy, from what is no equilibrium to where the robot comes to rest.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Conjugates
from multirod.problem import BoundaryProblem
from multirod.validation import FloatArray

SOFT = 1e-6  # of K/L: a mode no stiffer than this is neutral
RADIUS = 0.1  # largest turn in a mode by one step [rad]
NUDGE = 1e-3  # of the radius, along a mode that is unstable where no step is longer
GIVE = 1e-6  # of L^3/EI: what holds the end of a rod with clamps gives way by, in steps alone
BENT = 1e-6  # turn of what costs nothing, below which the rod is straight [rad]
KEPT = 1e-9  # largest condition, in the Frobenius norm, inverted, of a Y that is not singular, its rows as large as each other


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
        moved: How clamps, if any, and last the end effector move with these, in the world, shape (place, 3, n).
        position: Of the end effector [m], shape (3,).
        frames: Of the same places, shape (place, 3, 3).
        stiffness: ``K/L`` [N m].
        costless: How a turn that costs nothing turns what forces do work on, per radian, shape (m,).
        settled: The unknowns of the problem without clamps, turned so to where it wants them [1/m], shape (n,).
        among: The points of the same launch, and which of them it is; None of a point alone.
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
    frames: FloatArray
    stiffness: float
    costless: FloatArray | None = None
    settled: FloatArray | None = None
    among: "tuple[Points, int] | None" = None

    @property
    def size(self) -> float:
        """Largest residual [1/m], of what costs something; infinite where the integration failed."""
        residual, turn = self.residual, self.turn
        if turn is not None:
            residual = np.array(residual)
            residual[self.forces] = turn.without(self.unit * residual[self.forces]) / self.unit
        size = float(np.abs(residual).max())
        return size if np.isfinite(size) else np.inf

    @property
    def turn(self) -> "Costless | None":
        """The turn that costs nothing; None where the rod is straight, and there is none."""
        size = 0.0 if self.costless is None else float(np.linalg.norm(self.costless))
        return None if self.costless is None or not size > BENT else Costless(self.costless / size)


@dataclass(frozen=True)
class Costless:
    """(10) A turn that costs nothing, as how it turns what forces do work on.

    Attributes:
        direction: Of norm 1, shape (m,).
    """

    direction: FloatArray

    def without(self, gradient: FloatArray) -> FloatArray:
        """A gradient (m,) but for what errors of the integration leave along the turn."""
        return gradient - self.direction * (self.direction @ gradient)

    def held(self, H: FloatArray, stiffness: float) -> FloatArray:
        """Second derivatives (m, m), the turn resisted by a stiffness [N m]."""
        t = self.direction
        across = np.eye(len(t)) - np.outer(t, t)
        return across @ H @ across + stiffness * np.outer(t, t)


@dataclass(frozen=True)
class Slope:
    """(1), (2) The potential energy as a function of how the tip is turned, or the clamps and what is free at the ends, to second
    order.

    Attributes:
        gradient: [N m], shape (m,).
        values: Eigenvalues of its second derivative over ``K/L``, ascending, shape (m,).
        modes: Eigenvectors, in columns, shape (m, m).
        ways: Change of the unknowns that turns the tip so, constraints kept, shape (n, m).
        back: The one that meets the constraints, shape (n,).
        facing: Sign of the determinant of what ``ways`` is the inverse of.
        stiffness: ``K/L`` [N m].
        slopes: How the gradient changes with them over ``K/L``, (2), shape (m, m): symmetric at an equilibrium.
        clamps: Whose turns stand last among the displacements.
    """

    gradient: FloatArray
    values: FloatArray
    modes: FloatArray
    ways: FloatArray
    back: FloatArray
    facing: float
    stiffness: float
    slopes: FloatArray
    clamps: int = 0

    @property
    def along(self) -> FloatArray:
        """Slope in each mode over ``K/L``, shape (m,)."""
        return np.asarray(self.modes.T @ self.gradient / self.stiffness)

    @property
    def lowest(self) -> float:
        """The first eigenvalue, as if the place that its mode turns the most were turned by 1."""
        clamps = self.modes[len(self.modes) - 3 * self.clamps :, 0].reshape(-1, 3)
        return float(self.values[0] / ((clamps**2).sum(axis=1).max() if self.clamps else 1.0))

    @property
    def neutral(self) -> int:
        """Modes that cannot be told from neutral ones."""
        return int((np.abs(self.values) <= SOFT).sum())

    @property
    def drive(self) -> float:
        """The turn in a mode that the slope asks for, of soft modes as if they were stiff [rad]."""
        return float((np.abs(self.along) / np.maximum(np.abs(self.values), 1)).max())

    def turn(self, radius: float) -> FloatArray:
        """(4) Turn in each mode: down, by that of Newton's step where it is shorter than the radius [rad], shape (m,)."""
        return np.asarray(downhill(self.along[None], self.values[None], np.array([radius]))[0])

    def step(self, radius: float) -> FloatArray:
        """(4) Change of the unknowns [1/m] that turns it so, shape (n,)."""
        return self.back + self.change(self.modes @ self.turn(radius))

    def missed(self, turn: FloatArray, found: "Slope") -> float:
        """(9) By how much the slope found after a turn in each mode is not that foretold, in turns that make up for it [rad]."""
        foretold = self.along + self.modes.T @ (self.slopes @ (self.modes @ turn))
        return float(
            (np.abs(self.modes.T @ found.gradient / self.stiffness - foretold) / np.maximum(np.abs(self.values), 1)).max()
        )

    def rises(self, turn: FloatArray, found: "Slope") -> bool:
        """Whether a turn in each mode, or part of it, led beyond where the energy is least that way, and up again by as much."""
        return bool(turn @ (self.modes.T @ (self.gradient + found.gradient)) > 0)

    def change(self, turn: FloatArray) -> FloatArray:
        """Change of the unknowns [1/m] that turns the tip so [rad], shape (n,)."""
        return np.asarray(self.ways @ turn)


class Unfit(Exception):
    """The turn of the tip does not say what the rod is like, or nothing is finite."""


def downhill(along: FloatArray, values: FloatArray, radius: FloatArray) -> FloatArray:
    """(4) ``Slope.turn`` of many, (k, m): by the slope in each mode, its stiffness, both over ``K/L``, and radii (k,)."""
    turn = np.minimum(np.abs(along) / np.maximum(np.abs(values), SOFT), radius[:, None])
    balanced = (values[:, 0] < -SOFT) & (turn.max(axis=1) < NUDGE * radius)  # where nothing holds it
    turn[balanced, 0] = NUDGE * radius[balanced]
    return np.where(along > 0, -turn, turn)


def slope_at(point: Point) -> Slope:
    """The energy at a point.

    Raises:
        Unfit: If the tip's turn does not tell it.
    """
    points, k = (Points.of([point]), 0) if point.among is None else point.among
    return points.slopes.slope(k)


@dataclass(frozen=True)
class Points:
    """What one launch says of several instances, of each as a ``Point`` does: the first axis of all is the instance.

    ``forces`` are those of all.
    """

    unknowns: FloatArray
    level: FloatArray
    residual: FloatArray
    gamma: FloatArray
    forces: IntArray
    unit: FloatArray
    turned: FloatArray
    moved: FloatArray
    position: FloatArray
    frames: FloatArray
    stiffness: FloatArray
    costless: FloatArray | None = None
    settled: FloatArray | None = None

    @classmethod
    def of(cls, points: "list[Point]") -> "Points":
        """Several as one."""
        first = points[0]
        names = [name for name in EACH if getattr(first, name) is not None]
        return cls(forces=first.forces, **{name: np.array([getattr(point, name) for point in points]) for name in names})

    def point(self, k: int) -> Point:
        """That of one of them, all of which must be known."""
        own = {name: getattr(self, name)[k] for name in EACH if getattr(self, name) is not None}
        return Point(**(own | {"level": float(self.level[k])}), forces=self.forces, among=(self, k))

    @cached_property
    def slopes(self) -> "Slopes":
        """The energy at all of them."""
        return Slopes(self)


EACH = tuple(field.name for field in fields(Points) if field.name != "forces")  # what there is one of for each instance


class Slopes:
    """(1), (2) ``Slope`` of many points.

    Args:
        points: The points.

    Attributes:
        fit: Whether the tip's turn tells it, shape (k,); the others are NaN.
    """

    def __init__(self, points: Points) -> None:
        both, gamma, forces = points.turned, points.gamma, points.forces
        n, m = gamma.shape[-1], len(forces)
        fit = np.asarray(np.isfinite(both).all(axis=(1, 2)) & np.isfinite(gamma).all(axis=(1, 2)))
        inverse = inverses(np.where(fit[:, None, None], both, np.eye(n)))
        others = np.setdiff1d(np.arange(n), forces)
        with np.errstate(invalid="ignore", over="ignore"):  # of states far from any equilibrium, which are not fit
            # of rows that are made as large: turns are by lengths, constraints have no unit
            square = n * ((both * both).sum(axis=2) * (inverse * inverse).sum(axis=1)).sum(axis=1)
            A = points.unit[:, :, None] * gamma[:, forces] @ inverse[:, :, :m]
            H = 0.5 * (A + A.swapaxes(1, 2))
            back = (-inverse[:, :, m:] @ points.residual[:, others, None])[..., 0]
            led = (gamma[:, forces] @ back[..., None])[..., 0]
            gradient = points.unit * (points.residual[:, forces] + led)
        fit &= (square * KEPT**2 <= 1) & np.isfinite(H).all(axis=(1, 2)) & np.isfinite(gradient).all(axis=1)
        if points.costless is not None:
            for k in np.flatnonzero(fit).tolist():
                if (turn := points.point(k).turn) is not None:
                    H[k], gradient[k] = turn.held(H[k], points.stiffness[k]), turn.without(gradient[k])
        H[~fit] = np.eye(m)
        values, modes = np.linalg.eigh(H)
        self.fit, self.gradient, self.stiffness = fit, gradient, points.stiffness
        self.values, self.modes = values / points.stiffness[:, None], modes
        self.by_turns = A / points.stiffness[:, None, None]
        self.ways, self.back = inverse[:, :, :m], back
        self.facing = np.linalg.slogdet(np.where(fit[:, None, None], both, np.eye(n)))[0]
        self._clamps = points.frames.shape[1] - 1

    def slope(self, k: int) -> Slope:
        """That of one of them.

        Raises:
            Unfit: If the tip's turn does not tell it.
        """
        if not self.fit[k]:
            raise Unfit
        return Slope(
            self.gradient[k],
            self.values[k],
            self.modes[k],
            self.ways[k],
            self.back[k],
            float(self.facing[k]),
            float(self.stiffness[k]),
            self.by_turns[k],
            self._clamps,
        )

    @property
    def along(self) -> FloatArray:
        """``Slope.along`` of all, shape (k, m)."""
        return np.asarray((self.modes.swapaxes(1, 2) @ self.gradient[..., None])[..., 0] / self.stiffness[:, None])


def norms(vectors: FloatArray) -> FloatArray:
    """Of each of many (k, n), as ``np.linalg.norm`` of each alone."""
    return np.asarray(np.sqrt((vectors[:, None, :] @ vectors[:, :, None])[:, 0, 0]))


def inverses(matrices: FloatArray) -> FloatArray:
    """Of each of many (k, n, n); NaN of what is singular."""
    try:
        return np.asarray(np.linalg.inv(matrices))
    except np.linalg.LinAlgError:
        result = np.full_like(matrices, np.nan)
        for k, matrix in enumerate(matrices):
            with suppress(np.linalg.LinAlgError):
                result[k] = np.linalg.inv(matrix)
        return result


class ClampedTurns:
    """The same of a problem with clamps: beside its unknowns stand their moments, beside its residuals what no clamp would need.

    Args:
        problem: With ``clamps``.
    """

    def __init__(self, problem: BoundaryProblem) -> None:
        clamps, n = problem.clamps, problem.unknown_count
        assert clamps is not None  # or there would be nothing to turn
        self.problem, self.clamps, self.size = problem, clamps, n + clamps.size
        self.forces = np.append(clamps.pairs.forces, range(n, self.size))
        self.stiffness = clamps.pairs.stiffness
        self._order = np.append(self.forces, np.setdiff1d(np.arange(n), clamps.pairs.forces))

    def put(self, unknowns: FloatArray) -> None:
        """Unknowns and moments (instance_count, size) to where the next integration finds them."""
        self.problem.write("unknowns", unknowns[:, : self.problem.unknown_count])
        self.clamps.put(unknowns[:, self.problem.unknown_count :])

    def after(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """After an integration: residual (instance_count, size), its derivative, and what ``Turns.after`` says."""
        problem, clamps, n, size = self.problem, self.clamps, self.problem.unknown_count, self.size
        pairs, count = clamps.pairs, problem.instance_count
        pairs.update()
        residual = np.concatenate([problem.read("residual"), -unknowns[:, n:]], axis=1)
        gamma = np.zeros((count, size, size))
        gamma[:, :n, :n] = problem.read("gamma").reshape(count, n, n)
        gamma[:, :n, n:] = problem.residual_directions.numpy()[..., : clamps.size]
        gamma[:, n:, n:] = -np.eye(clamps.size)
        scale = pairs.scale.numpy()
        result = np.array(gamma)
        result[:, pairs.forces] = pairs.columns.numpy()[:, :, :size] / scale[..., None]
        result[:, n:] = clamps.turned()
        give = clamps.give()
        if give is not None:
            result[:, :n, :n] += GIVE * give
        return residual, gamma, np.concatenate([pairs.unit.numpy() * scale, clamps.unit], axis=1), result[:, self._order]


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
        order = np.append(pairs.forces, np.delete(np.arange(n), pairs.forces))
        return pairs.unit.numpy() * scale, result[:, order]
