"""The second variation of a backbone's energy: what it is made from, columns of sensitivities, and the form that is left.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from multirod.stability import NEUTRAL, Modes
from multirod.validation import FloatArray

Chosen: TypeAlias = NDArray[np.bool_] | NDArray[np.integer[Any]]  # instances of a batch

MOST_NODES = 16385
WORST_CONDITION = 1e12  # of the columns at a node; beyond it rounding may change a sign
HARDLY = 1e-3  # of K/L: no more is what holds a mode that is neutral, if it is held by what is free
ROUNDED = 1e-12  # of K/L: what rounding leaves of an eigenvalue that vanishes
STIFF = 100.0  # times K/L: what stands where a tube's angle has been eliminated


@dataclass(frozen=True)
class NodeColumns:
    """Variations of the configurations of a batch by its unknowns, from the base, where it is clamped, to the tip.

    ``m = n + 2`` for ``n`` rods. The configuration is the rotation vector of the rod that ends at the tip, in the world, then
    the angle from it to each other rod; its momenta are the moment of all rods and the torque of each other rod. A free tip has
    ``c = m`` unknowns; with a held one there are three more, and the force and position of the tip vary too.

    Attributes:
        arclength: Of the nodes, the base left out [m], NaN past the last, shape (batch, node).
        configuration: By the unknowns, shape (batch, node, m, c).
        tip_momenta: By the unknowns, the torque of a rod at its own end, shape (batch, m, c).
        ends: Arclength at which each rod ends, a number that is in ``arclength`` [m], shape (batch, n).
        tip_force: By the unknowns, the internal force at the tip in the world, shape (batch, 3, c); None if the tip is free.
        tip_position: By the unknowns, in the world, shape (batch, 3, c); None if the tip is free.
    """

    arclength: FloatArray
    configuration: FloatArray
    tip_momenta: FloatArray
    ends: FloatArray
    tip_force: FloatArray | None = None
    tip_position: FloatArray | None = None


@dataclass(frozen=True)
class TipJoint:
    """(31) of ``docs/networks.md``: what lets the tip turn, and is eliminated with the rod; in the axes of the columns.

    Attributes:
        free: Projections onto the axes about which it turns, shape (batch, 3, 3).
        spring: Moment about these by a turn of the tip that must be made up for [N m], shape (batch, 3, 3).
    """

    free: FloatArray
    spring: FloatArray

    def take(self, chosen: Chosen | tuple[slice, Chosen]) -> "TipJoint":
        """Of some instances."""
        return TipJoint(self.free[chosen], self.spring[chosen])

    def joined(self) -> "TipJoint":
        """With one axis in the place of the leading ones."""
        return TipJoint(self.free.reshape(-1, 3, 3), self.spring.reshape(-1, 3, 3))

    def given(self, columns: NodeColumns, stiffness: FloatArray) -> NodeColumns:
        """Columns in which, at the tip, moments about the free axes stand for how it is turned about them.

        Args:
            columns: Of a held tip.
            stiffness: Any of the rod's [N m^2], shape (batch,): so moments are told in turns.
        """
        s = columns.arclength
        last, every = s.shape[1] - 1 - (~np.isnan(s))[:, ::-1].argmax(axis=1), np.arange(len(s))
        turn, give = columns.configuration[every, last, :3], (s[every, last] - s[every, last - 1]) / stiffness
        moment = self.free @ columns.tip_momenta[:, :3] + self.spring @ turn
        configuration = np.array(columns.configuration)
        configuration[every, last, :3] = give[:, None, None] * moment + turn - self.free @ turn
        return replace(columns, configuration=configuration)


@dataclass(frozen=True)
class CondensedForm:
    """The second variation of the energy, at given tip forces, as a function of what is free at the tip.

    Attributes:
        matrix: By the rotation vector of the tip, the angle of each other rod and, where the tip is held, the force on it: how
            moment, torques and the negative position of the tip vary, shape (batch, m or m + 3, m or m + 3). Not made symmetric.
            An angle that is free before the tip has ``STIFF`` on the diagonal.
        conjugate: Negative eigenvalues of what was eliminated, shape (batch,).
        known: Whether rounding leaves the signs, shape (batch,).
    """

    matrix: FloatArray
    conjugate: NDArray[np.int32]
    known: NDArray[np.bool_]

    @classmethod
    def unknown(cls, count: int, size: int) -> "CondensedForm":
        """Of which nothing is known yet."""
        return cls(np.full((count, size, size), np.nan), np.zeros(count, dtype=np.int32), np.zeros(count, dtype=bool))

    def put(self, chosen: Chosen | list[int], other: "CondensedForm") -> None:
        """Take the instances ``chosen``, all of those of ``other``, from it."""
        for name, mine in vars(self).items():
            mine[chosen] = getattr(other, name)

    def surely_stable(self) -> bool:
        """Whether all are known to be positive definite: sooner told than eigenvalues."""
        if not self.known.all() or self.conjugate.any():
            return False
        try:
            np.linalg.cholesky(self.matrix + self.matrix.swapaxes(1, 2))
        except np.linalg.LinAlgError:
            return False
        return True

    def modes(self, unit: FloatArray) -> Modes:
        """Of a backbone with a free tip, eigenvalues counted in ``unit`` [N m], shape (batch,)."""
        told = symmetric_eigenvalues(self.matrix / unit[:, None, None], self.known)
        return told.modes(np.array(self.conjugate), np.array(self.known), np.zeros(len(unit), dtype=bool))


@dataclass(frozen=True)
class Eigenvalues:
    """Those of the symmetric part of forms, ascending, shape (batch, n); NaN where they are not known.

    Attributes:
        values: The eigenvalues.
        uncertainty: What the rest of the form does to their eigenvectors.
        neutral_below: (27) The size below which each is a neutral mode's.
    """

    values: FloatArray
    uncertainty: FloatArray
    neutral_below: FloatArray

    def modes(self, hidden: NDArray[np.int32], known: NDArray[np.bool_], diverging: NDArray[np.bool_]) -> Modes:
        """With what they do not show, each of shape (batch,)."""
        return Modes(self.values, hidden, self.uncertainty, known, diverging, self.neutral_below)


def symmetric_eigenvalues(form: FloatArray, known: NDArray[np.bool_], firm: NDArray[np.bool_] | None = None) -> Eigenvalues:
    """Eigenvalues of forms (batch, n, n), where they are ``known``, shape (batch,).

    Args:
        firm: Which variables are multipliers of what holds rods that are stable by themselves, shape (batch, n); none by
            default.
    """
    values, uncertainty, neutral_below = np.full((3, *form.shape[:2]), np.nan)
    turned = form.swapaxes(1, 2)
    chosen = slice(None) if known.all() else known  # which copies nothing
    values[chosen], vectors = np.linalg.eigh((form + turned)[chosen] / 2)
    lacking = (form - turned)[chosen] / 2 @ vectors
    uncertainty[chosen] = np.sqrt((lacking * lacking).sum(axis=1))
    neutral_below[chosen] = neutral_sizes(vectors, None if firm is None else firm[chosen])
    return Eigenvalues(values, uncertainty, neutral_below)


def neutral_sizes(vectors: FloatArray, firm: NDArray[np.bool_] | None) -> FloatArray:
    """(27) The sizes below which eigenvalues are neutral modes', shape (..., n), by eigenvectors (..., n, n), the columns, and
    which variables are ``firm``, shape (..., n)."""
    if firm is None:
        return np.full((*vectors.shape[:-2], vectors.shape[-1]), NEUTRAL)
    share = np.where(firm[..., None], 0.0, vectors * vectors).sum(axis=-2)
    return np.asarray(np.clip(HARDLY * share, ROUNDED, NEUTRAL))


def certain_determinant(matrices: FloatArray) -> FloatArray:
    """Determinants (batch,) of matrices (batch, n, n); NaN where they are so ill conditioned that rounding hides the sign."""
    result = np.full(len(matrices), np.nan)
    finite = np.isfinite(matrices).all(axis=(1, 2))
    sizes = np.linalg.svd(matrices[finite], compute_uv=False)
    determinants = np.linalg.det(matrices[finite])
    result[finite] = np.where(sizes[:, -1] * WORST_CONDITION > sizes[:, 0], determinants, np.nan)
    return result


def segments_needed(
    length: FloatArray, stiffness: FloatArray, velocity_coupling: FloatArray, potential: FloatArray
) -> FloatArray:
    """(7) How many equal segments are sure to hold no conjugate point each, with a factor of 2 to spare.

    Args:
        length: Of the backbone [m].
        stiffness: The least of all rods' [N m^2].
        velocity_coupling: Bound of the terms in a variation and its rate, such as the moment [N m].
        potential: Bound of the terms in a variation alone, such as the force [N].
    """
    first, second = velocity_coupling / (np.pi * stiffness), potential / (np.pi**2 * stiffness)
    return np.asarray(length * (first + np.sqrt(first**2 + 4 * second)))
