"""Down in energy, from what is no equilibrium to where the robot comes to rest.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.rotations import leading_axis
from multirod.solvers.following.arrow import Arrow, inverses
from multirod.validation import FloatArray

SOFT = 1e-6  # of K/L: a mode no stiffer than this is neutral
NEARLY = 1e-4  # singular value of Gamma, below which a mode may be neutral
RADIUS = 0.1  # largest turn in a mode by one step [rad]
VANISHING = 1e-2  # of K/L: a mode as stiff, or less, vanishes at a critical point
NUDGE = 1e-3  # of the radius, along a mode that is unstable where no step is longer
BENT = 1e-6  # turn of what costs nothing, below which the rod is straight [rad]
DRIVEN = 1e-6  # of K/L: a smaller moment along a mode that vanishes is none
KICK = 1e-2  # turn of the tip off what is unstable and in balance [rad]
TOGETHER = 1e-2  # of the lowest: modes that close to it vanish with it
TELLS = 0.1  # of the longest way of any place: where the tip's counts
KEPT = 1e-9  # largest condition, in the Frobenius norm, inverted, of a Y that is not singular, its rows as large as each other


@dataclass(frozen=True)
class Points:
    """What one launch says of several instances at some unknowns and levels; the first axis is the instance, but of ``forces``.

    Attributes:
        unknowns: [1/m], shape (k, n).
        level: Part of the way, shape (k,).
        residual: [1/m], shape (k, n).
        gamma: Shape (k, n, n).
        forces: Rows of the residual that are forces, shape (m,); the others are constraints.
        unit: Moment of one unit of each [N m], shape (k, m).
        turned: ``Y``, how what they do work on is turned by the unknowns; then the rows of ``gamma`` that are constraints, shape
            (k, n, n).
        moved: How clamps, if any, and last the end effector move with these, in the world, shape (k, place, 3, n).
        position: Of the end effector [m], shape (k, 3).
        frames: Of the same places, shape (k, place, 3, 3).
        stiffness: ``K/L`` [N m], shape (k,).
        costless: How a turn that costs nothing turns what forces do work on, per radian, shape (k, m).
        settled: The unknowns of the problem without clamps, turned so to where it wants them [1/m], shape (k, n).
        clamps: Where those of each clamp stand among what forces do work on, -1 where another has more, shape (clamp, turn); None
            without clamps.
        arrow: Where legs stand that meet only at their platform; None where that is not known.
        periods: ``BoundaryProblem.periods``, shape (k, m), without clamps; m is 0 where nothing has one.
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
    clamps: IntArray | None = None
    arrow: Arrow | None = None
    periods: FloatArray = field(default_factory=lambda: np.zeros((1, 0)))

    def __getitem__(self, row: int) -> "Point":
        return Point(self, row)

    def turn(self, row: int) -> "Costless | None":
        """The turn of one of them that costs nothing; None where its rod is straight, and there is none."""
        size = 0.0 if self.costless is None else float(np.linalg.norm(self.costless[row]))
        return None if self.costless is None or not size > BENT else Costless(self.costless[row] / size)

    @cached_property
    def size(self) -> FloatArray:
        """Largest residual [1/m], of what costs something, shape (k,); infinite where the integration failed."""
        residual, forces, unit = np.array(self.residual), self.forces, self.unit
        for row in range(len(residual) if self.costless is not None else 0):
            if (turn := self.turn(row)) is not None:
                residual[row, forces] = turn.without(unit[row] * residual[row, forces]) / unit[row]
        size = np.abs(residual).max(axis=1)
        return np.where(np.isfinite(size), size, np.inf)

    @cached_property
    def singular(self) -> FloatArray:
        """Singular values of ``gamma``, descending, shape (k, n)."""
        return np.linalg.svd(np.nan_to_num(self.gamma), compute_uv=False)

    @cached_property
    def slopes(self) -> "Slopes":
        """The energy at all of them."""
        return Slopes(self)


class Row:
    """One of several that stand in arrays, and all that is said of all, of it alone: the arrays' own rows.

    Args:
        among: All of the same launch.
        row: Which of them it is.
    """

    def __init__(self, among: "Points | Slopes", row: int) -> None:
        self.among, self.row = among, row

    def __getattr__(self, name: str) -> object:
        values = getattr(self.among, name)
        own = self.__dict__[name] = values if values is None else values[self.row]
        return own


class Point(Row):
    """One of several, and all that ``Points`` says, of it alone."""

    among: "Points"
    unknowns: FloatArray
    level: float
    residual: FloatArray
    gamma: FloatArray
    unit: FloatArray
    turned: FloatArray
    moved: FloatArray
    position: FloatArray
    frames: FloatArray
    stiffness: float
    settled: FloatArray | None
    periods: FloatArray
    size: float
    singular: FloatArray

    @property
    def nearly_neutral(self) -> int:
        """How many modes may be neutral: what is not quite in balance shows one by as much."""
        return int((self.singular[1:] < NEARLY).sum())

    @cached_property
    def slope(self) -> "Slope":
        """The energy there.

        Raises:
            Unfit: If the tip's turn does not tell it.
        """
        slopes = self.among.slopes
        if not slopes.fit[self.row]:
            raise Unfit
        return slopes[self.row]


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


class Unfit(Exception):
    """The turn of the tip does not say what the rod is like, or nothing is finite."""


class Slopes:
    """(1), (2) The potential energy as a function of how the tip is turned, or the clamps and what is free at the ends, to second
    order: at many points, the first axis of all.

    Args:
        points: The points.

    Attributes:
        fit: Whether the tip's turn tells it, shape (k,); the others are NaN.
        gradient: [N m], shape (k, m).
        ways: Change of the unknowns that turns the tip so, constraints kept, shape (k, n, m).
        back: The one that meets the constraints, shape (k, n).
        facing: Sign of the determinant of what ``ways`` is the inverse of, shape (k,).
        stiffness: ``K/L`` [N m], shape (k,).
        clamps: Whose turns stand last among the displacements, as many of each.
    """

    def __init__(self, points: Points) -> None:
        both, gamma, forces = points.turned, points.gamma, points.forces
        n, m = gamma.shape[-1], len(forces)
        fit = np.asarray(np.isfinite(both).all(axis=(1, 2)) & np.isfinite(gamma).all(axis=(1, 2)))
        arrow = points.arrow
        regular = both if fit.all() else np.where(fit[:, None, None], both, np.eye(n) if arrow is None else arrow.neutral)
        self._inverse = None if arrow is None or not arrow.fits(regular) else arrow.inverse(regular)
        inverse = inverses(regular) if self._inverse is None else self._inverse.dense()
        others = np.delete(np.arange(n), forces)
        with np.errstate(invalid="ignore", over="ignore"):  # of states far from any equilibrium, which are not fit
            # of rows that are made as large: turns are by lengths, constraints have no unit
            square = n * ((both * both).sum(axis=2) * (inverse * inverse).sum(axis=1)).sum(axis=1)
            back = (-inverse[:, :, m:] @ points.residual[:, others, None])[..., 0]
            led = (gamma[:, forces] @ back[..., None])[..., 0]
            gradient = points.unit * (points.residual[:, forces] + led)
            largest = n * np.abs(points.unit).max(axis=1, initial=0.0) * np.abs(gamma).max(axis=(1, 2), initial=0.0)
            largest *= np.abs(inverse).max(axis=(1, 2), initial=0.0)
        fit &= (square * KEPT**2 <= 1) & np.isfinite(largest) & np.isfinite(gradient).all(axis=1)
        for k in np.flatnonzero(fit).tolist() if points.costless is not None else ():
            if (turn := points.turn(k)) is not None:
                gradient[k] = turn.without(gradient[k])
        self.fit, self.gradient, self.stiffness = fit, gradient, points.stiffness
        self.ways, self.back = inverse[:, :, :m], back
        self.facing = np.linalg.slogdet(regular)[0] if self._inverse is None else self._inverse.sign
        self.clamps: int = points.frames.shape[1] - 1
        self._points, self._clamps = points, points.clamps

    # nobody asks these of what a step was too long to

    @cached_property
    def _changes(self) -> FloatArray:
        """How the gradient changes with the displacements, (2), shape (k, m, m)."""
        points = self._points
        with np.errstate(invalid="ignore", over="ignore"):
            if self._inverse is not None:
                return points.unit[:, :, None] * self._inverse.changes(points.gamma)
            return np.asarray(points.unit[:, :, None] * points.gamma[:, points.forces] @ self.ways)

    @cached_property
    def _modes(self) -> tuple[FloatArray, FloatArray]:
        points, A = self._points, self._changes
        with np.errstate(invalid="ignore", over="ignore"):
            H = 0.5 * (A + A.swapaxes(1, 2))
        for k in np.flatnonzero(self.fit).tolist() if points.costless is not None else ():
            if (turn := points.turn(k)) is not None:
                H[k] = turn.held(H[k], points.stiffness[k])
        H[~self.fit] = np.eye(H.shape[-1])
        values, modes = np.linalg.eigh(H)
        return values / points.stiffness[:, None], modes

    @property
    def values(self) -> FloatArray:
        """Eigenvalues of the second derivative over ``K/L``, ascending, shape (k, m)."""
        return self._modes[0]

    @property
    def modes(self) -> FloatArray:
        """Eigenvectors, in columns, shape (k, m, m)."""
        return self._modes[1]

    @cached_property
    def by_turns(self) -> FloatArray:
        """How the gradient changes with them over ``K/L``, (2), shape (k, m, m): symmetric at an equilibrium."""
        return np.asarray(self._changes / self.stiffness[:, None, None])

    @cached_property
    def along(self) -> FloatArray:
        """Slope in each mode over ``K/L``, shape (k, m)."""
        return np.asarray((self.modes.swapaxes(1, 2) @ self.gradient[..., None])[..., 0] / self.stiffness[:, None])

    def __getitem__(self, row: int) -> "Slope":
        return Slope(self, row)

    @cached_property
    def lowest(self) -> FloatArray:
        """The first eigenvalue, as if the place that its mode turns the most were turned by 1, shape (k,)."""
        if self._clamps is None:
            return np.array(self.values[:, 0])
        first = np.pad(self.modes[:, :, 0], ((0, 0), (0, 1)))[:, self._clamps]
        with np.errstate(divide="ignore"):  # of points that are not fit, whose modes say nothing
            return np.asarray(self.values[:, 0] / (first**2).sum(axis=2).max(axis=1))

    @cached_property
    def neutral(self) -> IntArray:
        """Modes that cannot be told from neutral ones, shape (k,)."""
        return np.asarray((np.abs(self.values) <= SOFT).sum(axis=1))

    @cached_property
    def drive(self) -> FloatArray:
        """The turn in a mode that the slope asks for, of soft modes as if they were stiff [rad], shape (k,)."""
        return np.asarray((np.abs(self.along) / np.maximum(np.abs(self.values), 1)).max(axis=1))

    @cached_property
    def unsettled(self) -> FloatArray:
        """The turn in a mode that is stiff by which it would come to rest [rad], shape (k,)."""
        return np.asarray(np.where(self.values > VANISHING, np.abs(self.along / self.values), 0.0).max(axis=1))

    def steps(self, rows: IntArray, radius: FloatArray) -> FloatArray:
        """(4) Change of the unknowns [1/m] that turns it so, at some points, (k,), by radii (k,); shape (k, n)."""
        turn = (self.modes[rows] @ downhill(self.along[rows], self.values[rows], radius)[..., None])[..., 0]
        return np.asarray(self.back[rows] + (self.ways[rows] @ turn[..., None])[..., 0])


class Slope(Row):
    """That of one of them, and all that ``Slopes`` says, of it alone."""

    among: Slopes
    gradient: FloatArray
    values: FloatArray
    modes: FloatArray
    ways: FloatArray
    back: FloatArray
    facing: float
    stiffness: float
    by_turns: FloatArray
    along: FloatArray
    lowest: float
    neutral: int
    drive: float
    unsettled: float

    @property
    def clamps(self) -> int:
        """As ``Slopes`` has them."""
        return self.among.clamps

    def turn(self, radius: float, among: NDArray[np.bool_] | None = None) -> FloatArray:
        """(4) Turn in each mode, or those ``among`` them, (m,), by no more than the radius [rad]."""
        along, values = (own if among is None else own[among] for own in (self.along, self.values))
        return np.asarray(downhill(along[None], values[None], np.array([radius]))[0])

    def step(self, radius: float) -> FloatArray:
        """(4) Change of the unknowns [1/m] that turns it so, shape (n,)."""
        return np.asarray(self.among.steps(np.array([self.row]), np.array([radius]))[0])

    def missed(self, turn: FloatArray, found: "Slope") -> float:
        """(9) By how much the slope found after a turn in each mode is not that foretold, in turns that make up for it [rad]."""
        foretold = self.along + self.modes.T @ (self.by_turns @ (self.modes @ turn))
        return float(
            (np.abs(self.modes.T @ found.gradient / self.stiffness - foretold) / np.maximum(np.abs(self.values), 1)).max()
        )

    def rises(self, turn: FloatArray, found: "Slope") -> bool:
        """Whether a turn in each mode, or part of it, led beyond where the energy is least that way, and up again by as much."""
        return bool(turn @ (self.modes.T @ (self.gradient + found.gradient)) > 0)

    def change(self, turn: FloatArray) -> FloatArray:
        """Change of the unknowns [1/m] that turns the tip so [rad], shape (n,)."""
        return np.asarray(self.ways @ turn)


def way_out(slope: Slope, moved: FloatArray, longer: float, side: int) -> tuple[FloatArray, bool]:
    """How the tip is turned off a point that is in balance, 0 where a moment drives it, shape (n,), and whether that is so.

    (5) Of the modes that vanish together, the combination by which the tip goes to a positive x of the world; where it hardly
    moves that way, y, then z; to the ``side`` of its sign.

    Args:
        slope: Beyond a critical point.
        moved: How places move there, as ``Points`` has it, shape (place, 3, n).
        longer: By how many times as far as the first step beyond.
        side: 1 or -1.
    """
    count = int((slope.values <= slope.values[0] + TOGETHER * abs(slope.values[0]) + SOFT).sum())
    if np.abs(slope.along[:count]).max() > DRIVEN * max(1.0, longer):
        return np.zeros(len(slope.values)), True
    modes = slope.modes[:, :count]
    places = moved @ slope.change(modes)
    reach = np.linalg.norm(places, axis=(1, 2))
    moves = places[-1 if reach[-1] >= TELLS * reach.max() else int(np.argmax(reach > (1 - TELLS) * reach.max()))]
    size = np.linalg.norm(moves, axis=1)
    axis = int(leading_axis(size))
    with np.errstate(invalid="ignore"):  # where no mode moves the tip there is no way out, and none is found
        return side * KICK * modes @ (moves[axis] / size[axis]), False


def downhill(along: FloatArray, values: FloatArray, radius: FloatArray) -> FloatArray:
    """(4) ``Slope.turn`` of many, (k, m): by the slope in each mode, its stiffness, both over ``K/L``, and radii (k,)."""
    slope, stiffness = np.abs(along), np.maximum(np.abs(values), SOFT)
    cut = slope > radius[:, None] * stiffness
    damped = np.where(cut, slope, 0.0).max(axis=1) / radius
    turn = -along / np.maximum(stiffness, damped[:, None])
    balanced = (values[:, 0] < -SOFT) & (np.abs(turn).max(axis=1) < NUDGE * radius)  # where nothing holds it
    turn[balanced, 0] = (np.where(along[:, 0] > 0, -NUDGE, NUDGE) * radius)[balanced]
    return np.asarray(turn)


def norms(vectors: FloatArray) -> FloatArray:
    """Of each of many (k, n), as ``np.linalg.norm`` of each alone."""
    return np.asarray(np.sqrt((vectors[:, None, :] @ vectors[:, :, None])[:, 0, 0]))


def turn_between(before: FloatArray, after: FloatArray) -> float:
    """The largest angle between frames of the same places, (place, 3, 3), before and after [rad]."""
    traces = np.einsum("kij,kij->k", before, after)
    return float(np.arccos(np.clip(0.5 * (traces - 1), -1, 1)).max())
