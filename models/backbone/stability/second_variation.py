"""The second variation of a backbone's energy from columns of sensitivities: conjugate points, and the form that is left.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.rotations import cross
from multirod.stability import Modes
from multirod.validation import FloatArray

MOST_NODES = 16385
WORST_CONDITION = 1e12  # of the columns at a node; beyond it rounding may change a sign
RIGID = 1e-9  # of what a line's tension does to its length with the tip free; less with the tip held, and it holds the tip
REDUNDANT = 1e-6  # of how turns of the tip change lengths; less, and lines that hold the tip do not determine their tensions
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

    def take(self, chosen: Any) -> "TipJoint":
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

    def put(self, chosen: Any, other: "CondensedForm") -> None:
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
        values, uncertainty = symmetric_eigenvalues(self.matrix / unit[:, None, None], self.known)
        return Modes(values, np.array(self.conjugate), uncertainty, np.array(self.known), np.zeros(len(values), dtype=bool))


def symmetric_eigenvalues(form: FloatArray, known: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues (batch, n) of the symmetric part, and what the rest does to their eigenvectors (batch, n); NaN where not
    known."""
    values, uncertainty = np.full((2, *form.shape[:2]), np.nan)
    turned = form.swapaxes(1, 2)
    chosen = slice(None) if known.all() else known  # which copies nothing
    values[chosen], vectors = np.linalg.eigh((form + turned)[chosen] / 2)
    lacking = (form - turned)[chosen] / 2 @ vectors
    uncertainty[chosen] = np.sqrt((lacking * lacking).sum(axis=1))
    return values, uncertainty


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


def condensed_form(columns: NodeColumns, unit: FloatArray) -> CondensedForm:
    """(4) to (6): eliminate all but the tip of a backbone clamped at its base; ``unit`` is ``K/L`` [N m], shape (batch,)."""
    count = len(columns.ends)
    held = columns.tip_force is not None
    size = columns.tip_momenta.shape[1] + (3 if held else 0)
    matrix = np.zeros((count, size, size))
    matrix[:, range(size), range(size)] = STIFF * unit[:, None]
    result = CondensedForm(matrix, np.zeros(count, dtype=np.int32), np.zeros(count, dtype=bool))
    longest = np.argmax(columns.ends, axis=1)
    order = np.argsort(columns.ends, axis=1, kind="stable")
    short = np.take_along_axis(columns.ends, order, 1) < columns.ends.max(axis=1)[:, None]
    patterns = np.column_stack([longest, np.where(short, order, -1)])
    alike = (patterns == patterns[:1]).all()
    for pattern in patterns[:1] if alike else np.unique(patterns, axis=0):
        chosen = np.flatnonzero((patterns == pattern).all(axis=1))
        ended = [int(rod) for rod in pattern[1:] if rod >= 0]
        form, rows, conjugate, known = _of_pattern(columns, chosen, int(pattern[0]), ended)
        rows += range(size - 3, size) if held else ()
        matrix[np.ix_(chosen, np.array(rows), np.array(rows))] = form
        result.conjugate[chosen], result.known[chosen] = conjugate, known
    return result


def compliance_form(columns: NodeColumns, moment: FloatArray) -> CondensedForm:
    """The second variation of a single rod whose tip is held, by the wrench on it ((12) of ``docs/held.md``).

    Args:
        columns: With those of the tip's force and position.
        moment: At the tip, in the world [N m], shape (batch, 3).

    Returns:
        How the negative rotation and position of the tip vary with the moment and the force on it, and the index of the rod with
        a free tip under these.
    """
    assert columns.tip_force is not None
    assert columns.tip_position is not None
    count, s = len(moment), columns.arclength
    every, last = np.arange(count), s.shape[1] - 1 - (~np.isnan(s))[:, ::-1].argmax(axis=1)
    rotation = columns.configuration[every, last]
    # a moment varies by rotations along geodesics: so its second derivatives are symmetric
    momenta = columns.tip_momenta - 0.5 * cross(rotation.swapaxes(1, 2), moment[:, None]).swapaxes(1, 2)
    dead = _by_force(columns.tip_force)[..., :3]
    Y = columns.configuration @ dead[:, None]
    Y[np.isnan(s)] = np.eye(3)
    inverse, sound = _inverse(Y)
    before = np.arange(s.shape[1] - 1) < last[:, None]
    with np.errstate(all="ignore"):  # what is not sound need not be finite
        ratio = Y[:, 1:] @ inverse[:, :-1]
        # the tip is free: its own rotation is eliminated before that of the last node
        ratio[every, last - 1] = (momenta @ dead) @ inverse[every, last - 1]
        conjugate = np.where(before, _negative(ratio), 0).sum(axis=1)
    wrench = np.concatenate([momenta, columns.tip_force], axis=1)
    known = (sound[:, :-1] | ~before).all(axis=1) & np.isfinite(wrench).all(axis=(1, 2))
    known[known] = np.linalg.cond(wrench[known]) < WORST_CONDITION
    by_wrench = np.linalg.inv(np.where(known[:, None, None], wrench, np.eye(6)))
    matrix = -np.concatenate([rotation, columns.tip_position], axis=1) @ by_wrench
    return CondensedForm(matrix, conjugate.astype(np.int32), known)


def with_conditions(
    form: CondensedForm,
    columns: NodeColumns,
    tensions: NodeColumns,
    gaps: FloatArray,
    own_gaps: FloatArray,
    taut: NDArray[np.bool_],
) -> CondensedForm:
    """(18) Of one rod with lines that are driven by their lengths: their tensions are eliminated, each of which is a condition.

    Args:
        form: With all tensions fixed.
        columns: By which that is made, c of them.
        tensions: The same by tensions.
        gaps: How what each line is too long by changes with ``columns``, shape (batch, line, c).
        own_gaps: The same with tensions, shape (batch, line, line).
        taut: Which lines are, shape (batch, line).
    """
    last = -1 - (~np.isnan(columns.arclength))[:, ::-1].argmax(axis=1)
    every, c = np.arange(len(last)), columns.configuration.shape[-1]

    def at_tip(of: NodeColumns) -> tuple[FloatArray, FloatArray]:
        """What is given there, and what follows from it."""
        if of.tip_force is None or of.tip_position is None:
            return of.configuration[every, last], of.tip_momenta
        given = np.concatenate([of.configuration[every, last], of.tip_force], axis=1)
        return given, np.concatenate([of.tip_momenta, -of.tip_position], axis=1)

    (given, follows), (by_given, by_follows) = at_tip(columns), at_tip(tensions)
    known = form.known & np.isfinite(own_gaps).all(axis=(1, 2))
    known &= np.isfinite(given).all(axis=(1, 2))
    given = np.where(known[:, None, None], given, np.eye(c))
    known &= np.linalg.cond(given) < WORST_CONDITION
    given = np.where(known[:, None, None], given, np.eye(c))
    at_given = np.linalg.solve(given, np.concatenate([np.broadcast_to(np.eye(c), given.shape), -by_given], axis=2))
    couple, lengths = follows @ at_given[:, :, c:] + by_follows, gaps @ at_given
    size = np.abs(own_gaps).max(axis=(1, 2), initial=1.0)
    form = replace(form, known=known)
    return without_tensions(form, couple, lengths[:, :, :c], lengths[:, :, c:] + own_gaps, size, taut)


def without_tensions(
    form: CondensedForm, couple: FloatArray, turns: FloatArray, own: FloatArray, size: FloatArray, taut: NDArray[np.bool_]
) -> CondensedForm:
    """(18) ``form`` with the tensions eliminated that are not fixed.

    Args:
        form: With all tensions fixed, of c variations of the tip.
        couple: What these tensions do there where it is held, shape (batch, c, line).
        turns: How what each line is too long by changes with the tip, shape (batch, line, c).
        own: The same with tensions where the tip is held, shape (batch, line, line).
        size: Of such changes where it is free, shape (batch,).
        taut: Which lines are, shape (batch, line).
    """
    count, known = taut.shape[1], form.known
    given = np.where(taut[:, :, None] & taut[:, None], own, -np.eye(count))
    own = np.where(known[:, None, None], given, -np.eye(count))
    couple, turns = np.where(taut[:, None], couple, 0.0), np.where(taut[:, :, None], turns, 0.0)
    rigid = (np.abs(np.linalg.eigvals(own)) < RIGID * size[:, None]).any(axis=1) & known
    known = known & ((np.linalg.cond(own) < WORST_CONDITION) | rigid)
    own = np.where((known & ~rigid)[:, None, None], own, -np.eye(count))
    negative = (np.linalg.eigvals(own).real < 0).sum(axis=1)
    matrix = form.matrix - couple @ np.linalg.solve(own, turns)
    for k in np.flatnonzero(rigid):
        matrix[k], negative[k], known[k] = _held(form.matrix[k], couple[k], turns[k], given[k])
    return CondensedForm(matrix, form.conjugate + (negative - count).astype(np.int32), known)


def _held(matrix: FloatArray, couple: FloatArray, turns: FloatArray, own: FloatArray) -> tuple[FloatArray, int, bool]:
    """(18) Where lines by themselves hold some turns of the tip: those are left out, as what is infinitely stiff.

    Of one instance: the form, its number of negative eigenvalues of ``S_TT`` and whether both are known.
    """
    values, vectors = np.linalg.eigh((own + own.T) / 2)
    rigid = np.abs(values) < RIGID * max(1.0, np.abs(values).max())
    give = (vectors[:, ~rigid].T @ turns) / values[~rigid, None]
    result = matrix - couple @ vectors[:, ~rigid] @ give
    _, sizes, axes = np.linalg.svd(vectors[:, rigid].T @ turns)
    known = rigid.sum() <= len(matrix) and bool(sizes[-1] > REDUNDANT * np.abs(turns).max())
    held = axes[: rigid.sum()]
    free = np.eye(len(matrix)) - held.T @ held
    stiff = STIFF * np.abs(matrix).max()
    return free @ result @ free + stiff * held.T @ held, int((values[~rigid] < 0).sum() + rigid.sum()), known


def form_by_segments(
    transition: FloatArray, frames: FloatArray, ends: FloatArray, first: NDArray[np.integer[Any]], unit: FloatArray
) -> tuple[CondensedForm, FloatArray]:
    """(4), (5) from what each segment makes of a variation, so that columns cannot grow apart, (12).

    Args:
        transition: Of moment and lengths of lines, then of rotation and tensions, in the frames where segments begin and end,
            shape (segment, 6 + 2 line, 6 + 2 line); the segments of one instance after those of another.
        frames: Where they begin, body to world, shape (segment, 3, 3).
        ends: Where they end, likewise.
        first: Where the segments of each instance begin, then how many there are, shape (batch + 1,).
        unit: Moment per rotation of the units in ``transition`` [N m], shape (batch, 3).

    Returns:
        With all tensions fixed; and how the tip's moment [N m] and the lengths vary with its rotation, in the world, and with the
        tensions, shape (batch, 3 + line, 3 + line).
    """
    count, lengths, h = len(first) - 1, np.diff(first), transition.shape[1] // 2
    conjugate, known = np.zeros(count, dtype=np.int32), np.zeros(count, dtype=bool)
    W = np.zeros((count, h, h))
    turns, inverses = np.empty((2, len(transition), 3, 3))
    with np.errstate(all="ignore"):  # what is not sound need not be finite
        for k in range(int(lengths.max())):
            # the k-th segment of all that have one
            on = np.flatnonzero(lengths > k)
            rows = first[on] + k
            T = transition[rows]
            if k == 0:
                begin = np.delete(T, np.s_[3 : h + 3], axis=2)  # by the moment there, and by tensions
                Y, P = begin[:, h:], begin[:, :h]
            else:
                Y, P = T[:, h:, h:] + T[:, h:, :h] @ W[on], T[:, :h, h:] + T[:, :h, :h] @ W[on]
            turns[rows], inverses[rows] = Y[:, :3, :3], _by_cofactors(Y[:, :3, :3])
            # tensions stay as they are
            W[on] = np.concatenate([P[:, :, :3] @ inverses[rows], P[:, :, 3:]], axis=2)
            W[on, :, 3:] -= W[on, :, :3] @ Y[:, :3, 3:]
        sound, later = _sound(turns, inverses), np.ones(len(turns), dtype=bool)
        later[first[:-1]] = False
        known[:] = np.logical_and.reduceat(sound, first[:-1])
        negative = _negative(ends @ turns @ frames.swapaxes(1, 2))
    conjugate[:] = np.add.reduceat(np.where(later, negative, 0), first[:-1])
    # the rotation of the tip in the world
    tip = ends[first[1:] - 1]
    W[:, :3] = tip @ (unit[:, :, None] * W[:, :3])
    W[:, :, :3] = W[:, :, :3] @ tip.swapaxes(1, 2)
    W[~known], conjugate[~known] = np.nan, 0
    return CondensedForm(W[:, :3, :3].copy(), conjugate, known), W


@dataclass(frozen=True)
class HeldUnits:
    """What variations of segments of held rods are counted in.

    Attributes:
        stiffness: Moment [N m^2] by axis, shape (batch, 3).
        length: Rotation, and position by its square [m], shape (batch,).
        bending: Force, over the length [N m^2], shape (batch,).
        base: Frame in which positions and forces are told, body to world, shape (batch, 3, 3).
    """

    stiffness: FloatArray
    length: FloatArray
    bending: FloatArray
    base: FloatArray


def compliance_by_segments(
    transition: FloatArray,
    frames: FloatArray,
    ends: FloatArray,
    first: NDArray[np.integer[Any]],
    units: HeldUnits,
    moment: FloatArray,
) -> CondensedForm:
    """``compliance_form`` from what each segment makes of a variation, ((22) of ``docs/held.md``).

    Args:
        transition: Of moment, position and moments about free axes of the base [N m], then of rotation, force and angles about
            these, shape (segment, 12 + 2 turns, 12 + 2 turns); the segments of one instance after those of another, two or more.
        frames: Where they begin, body to world, shape (segment, 3, 3).
        ends: Where they end, likewise.
        first: Where the segments of each instance begin, then how many there are, shape (batch + 1,).
        units: Of these.
        moment: At the tip, in the world [N m], shape (batch, 3).

    Returns:
        How the negative moments about the base's axes, rotation and position of the tip vary with angles of the base, moment and
        force on the tip, shape (batch, turns + 6, turns + 6), and the index of the rod with a free tip under these.
    """
    count, lengths, h = len(first) - 1, np.diff(first), transition.shape[1] // 2
    turns = h - 6
    result = CondensedForm.unknown(count, turns + 6)
    conjugate = np.zeros(count, dtype=np.int32)
    known = np.ones(count, dtype=bool)
    W, at_tip = np.zeros((count, h, h)), np.zeros((count, 2 * h, h))
    with np.errstate(all="ignore"):  # what is not sound need not be finite
        for k in range(int(lengths.max())):
            on = np.flatnonzero(lengths > k)
            rows, last = first[on] + k, lengths[on] == k + 1
            T = transition[rows]
            led = np.delete(T, np.s_[3 : h + 3], axis=2) if k == 0 else T[:, :, h:] + T[:, :, :h] @ W[on]
            Y, P = led[:, h : h + 3], led[:, :h]
            turned = ends[rows] @ Y[:, :, :3] @ frames[rows].swapaxes(1, 2)
            if last.any():
                some, own = on[last], rows[last]
                at_tip[some] = led[last]
                # the tip is free: its own rotation is eliminated before that of the last breakpoint
                turned[last] = _tip_moment(led[last], ends[own], some, units, moment)[:, :, :3] @ frames[own].swapaxes(1, 2)
            if k > 0:
                conjugate[on] += _negative(turned).astype(np.int32)
            inverse = _by_cofactors(Y[:, :, :3])
            known[on] &= last | _sound(Y[:, :, :3], inverse)
            W[on] = np.concatenate([P[:, :, :3] @ inverse, P[:, :, 3:]], axis=2)
            W[on, :, 3:] -= W[on, :, :3] @ Y[:, :, 3:]
        tip = ends[first[1:] - 1]
        every, L = np.arange(count), units.length[:, None, None]
        rotation = L * (tip @ at_tip[:, h : h + 3])
        position = L**2 * (units.base @ at_tip[:, 3:6])
        force = np.zeros((count, 3, h))
        force[:, :, 3:6] = units.base * (units.bending / units.length)[:, None, None]
        # per length, as the unknowns are: so that one condition number has a meaning
        K = (units.bending / units.length)[:, None, None]
        given = [at_tip[:, h + 6 :], _tip_moment(at_tip, tip, every, units, moment) / K, force / (K / L)]
        follows = [at_tip[:, 6:h] / K, rotation, position / L]
        by, wrench = np.concatenate(follows, axis=1), np.concatenate(given, axis=1)
    known &= np.isfinite(wrench).all(axis=(1, 2)) & np.isfinite(by).all(axis=(1, 2))
    wrench = np.where(known[:, None, None], wrench, np.eye(h))
    size = np.abs(wrench).max(axis=1, keepdims=True)  # of each column, whose units are any
    known &= np.linalg.cond(wrench / size) < WORST_CONDITION
    wrench = np.where(known[:, None, None], wrench, np.eye(h))
    matrix = -by @ np.linalg.inv(wrench)
    back = np.ones((count, h, 1))
    back[:, :turns], back[:, turns + 3 :] = K, L
    ahead = np.ones((count, 1, h))
    ahead[:, :, turns : turns + 3], ahead[:, :, turns + 3 :] = 1 / K, L / K
    result.matrix[:], result.conjugate[:], result.known[:] = back * matrix * ahead, np.where(known, conjugate, 0), known
    return result


def _tip_moment(led: FloatArray, tip: FloatArray, chosen: NDArray[np.intp], units: HeldUnits, moment: FloatArray) -> FloatArray:
    """How the moment on tips with these frames varies by rotations along geodesics, in the world [N m], (k, 3, h); ``led`` has
    variations at the tip (k, 2 h, h)."""
    h = led.shape[2]
    rotation = units.length[chosen, None, None] * (tip @ led[:, h : h + 3])
    own = tip @ (units.stiffness[chosen, :, None] * led[:, :3])
    return np.asarray(own + 0.5 * cross(rotation.swapaxes(1, 2), moment[chosen, None]).swapaxes(1, 2))


def _of_pattern(
    columns: NodeColumns, chosen: NDArray[np.intp], longest: int, ended: list[int]
) -> tuple[FloatArray, list[int], NDArray[np.int_], NDArray[np.bool_]]:
    """Form, its rows, conjugate points and whether they are known, where rods end in the same order, ``ended`` before the tip."""
    s, P = columns.arclength[chosen], columns.tip_momenta[chosen]
    Y = np.array(columns.configuration[chosen])
    m = Y.shape[-2]
    Y[np.isnan(s)] = np.eye(m, Y.shape[-1])
    position = np.zeros((len(chosen), 0, m))
    if columns.tip_force is not None and columns.tip_position is not None:
        # columns without a force on the tip, then one for each component of it
        basis = _by_force(columns.tip_force[chosen])
        Y, P, position = Y @ basis[:, None], P @ basis, columns.tip_position[chosen] @ basis
    rods = [rod for rod in range(columns.ends.shape[1]) if rod != longest]
    rows = list(range(m))  # of the rods that have not ended
    conjugate = np.zeros(len(chosen), dtype=int)
    known = np.ones(len(chosen), dtype=bool)
    first = np.zeros(len(chosen), dtype=int)
    passed = 0  # nodes before all that are left, of which Y has none
    every = np.arange(len(chosen))
    for rod in [*ended, -1]:
        end = columns.ends[chosen].max(axis=1) if rod < 0 else columns.ends[chosen, rod]
        last = np.argmax(s >= end[:, None], axis=1)
        reached = int(last.max()) + 1 - passed
        Y_here = Y[:, :reached, :, : len(rows)]
        inverse, sound = _inverse(Y_here)
        k = passed + np.arange(reached - 1)
        inside = (k >= first[:, None]) & (k < last[:, None])
        known &= (sound[:, :-1] | ~inside).all(axis=1)
        with np.errstate(all="ignore"):  # what is not sound need not be finite
            ratio = Y_here[:, 1:] @ inverse[:, :-1]
        conjugate += np.where(inside, _negative(ratio), 0).sum(axis=1)
        here = inverse[every, last - passed]
        known &= sound[every, last - passed]
        if rod < 0:
            break
        # (6) the angle of this rod is free from here on: eliminate it, and keep to the columns that leave its end without torque
        row = 3 + rods.index(rod)
        place = rows.index(row)
        conjugate += (P[:, :, : len(rows)] @ here)[:, place, place] < 0
        free = _without_torque(P[:, place], len(rows))
        rows.remove(row)
        done, passed = int(last.min()) - passed, int(last.min())
        Y = np.delete(Y[:, done:], place, axis=2) @ free[:, None]
        P, position = np.delete(P, place, axis=1) @ free, position @ free
        first = last
    # (5), (21)
    r = len(rows)
    by_tip = np.zeros((len(chosen), P.shape[-1], P.shape[-1]))
    by_tip[:, :r, :r] = here
    by_tip[:, :r, r:] = -here @ Y[every, last - passed][:, :, r:]
    by_tip[:, range(r, P.shape[-1]), range(r, P.shape[-1])] = 1.0
    form = np.concatenate([P, -position], axis=1) @ by_tip
    known &= np.isfinite(form).all(axis=(1, 2))
    return form, rows, conjugate, known


def _by_force(tip_force: FloatArray) -> FloatArray:
    """(20) Combinations of columns (batch, c, c): those by which the force (batch, 3, c) stays, then one a component of it."""
    count, c = len(tip_force), tip_force.shape[-1]
    basis = np.broadcast_to(np.eye(c), (count, c, c)).copy()
    sound = np.isfinite(tip_force).all(axis=(1, 2)) & (np.linalg.det(np.nan_to_num(tip_force[:, :, -3:])) != 0)
    inverse = np.linalg.inv(np.where(sound[:, None, None], tip_force[:, :, -3:], np.eye(3)))
    basis[:, -3:, :-3] = -inverse @ np.where(sound[:, None, None], tip_force[:, :, :-3], np.nan)
    basis[:, -3:, -3:] = inverse
    return basis


def _without_torque(torque: FloatArray, r: int) -> FloatArray:
    """(6), (20) Combinations (batch, c, c - 1) of columns that leave a torque (batch, c) as it is: of the first r alone, then of
    each other."""
    count, c = torque.shape
    free = np.zeros((count, c, c - 1))
    own = torque[:, :r]
    # the reflection that takes it into the first direction: its other columns are across it
    axis = np.array(own)
    axis[:, 0] += np.copysign(np.sqrt((own**2).sum(axis=1)), own[:, 0])
    share = 2 / np.maximum((axis**2).sum(axis=1), 1e-300)
    free[:, :r, : r - 1] = np.eye(r)[:, 1:] - (share[:, None] * axis)[:, :, None] * axis[:, None, 1:]
    free[:, :r, r - 1 :] = -own[:, :, None] * (torque[:, r:] / (own**2).sum(axis=1, keepdims=True))[:, None, :]
    free[:, range(r, c), range(r - 1, c - 1)] = 1.0
    return free


def _inverse(Y: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Inverses, and whether rounding leaves them their signs."""
    with np.errstate(all="ignore"):
        if Y.shape[-1] == 3:  # several times faster than LAPACK
            inverse = _by_cofactors(Y)
        else:
            inverse = np.empty_like(Y)
            try:
                inverse[:] = np.linalg.inv(Y)
            except np.linalg.LinAlgError:
                regular = np.linalg.det(np.nan_to_num(Y)) != 0
                inverse[:] = np.linalg.inv(np.where(regular[..., None, None], Y, np.eye(Y.shape[-1])))
                inverse[~regular] = np.nan
        return inverse, _sound(Y, inverse)


def _by_cofactors(Y: FloatArray) -> FloatArray:
    """Inverses of matrices (..., 3, 3)."""
    a, b, c = (Y[..., k] for k in range(3))
    # each row of the inverse's transpose is the product of the next two columns
    products = cross(np.stack([b, c, a], axis=-2), np.stack([c, a, b], axis=-2))
    return np.asarray(products / (a * products[..., 0, :]).sum(axis=-1)[..., None, None])


def _sound(Y: FloatArray, inverse: FloatArray) -> NDArray[np.bool_]:
    """Whether rounding leaves inverses their signs."""
    size = np.einsum("...ij,...ij", Y, Y) * np.einsum("...ij,...ij", inverse, inverse)
    return np.asarray(size < WORST_CONDITION**2)


def _negative(ratio: FloatArray) -> NDArray[np.int_]:
    """How many eigenvalues of each matrix have a negative real part."""
    n = ratio.shape[-1]
    trace = np.einsum("...ii", ratio)
    with np.errstate(all="ignore"):
        # none has where the matrix is nearer to some positive multiple of the identity than that is to zero
        far = ~((trace > 0) & (trace**2 > (n - 1) * np.einsum("...ij,...ij", ratio, ratio)))
    far &= np.isfinite(ratio).all(axis=(-2, -1))
    result = np.zeros(ratio.shape[:-2], dtype=int)
    if far.any():
        result[far] = (np.linalg.eigvals(ratio[far]).real < 0).sum(axis=-1)
    return result
