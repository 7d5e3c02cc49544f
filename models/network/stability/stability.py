"""The second variation of the energy of a network: its equations by what is free, once the rods themselves are eliminated.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.capabilities import Loading
from multirod.models.backbone.stability.condensing.inverses import row_condition
from multirod.models.backbone.stability.condensing.second_variation import (
    STIFF,
    WORST_CONDITION,
    Eigenvalues,
    TipJoint,
    certain_determinant,
    symmetric_eigenvalues,
)
from multirod.models.network.elements.elements import GAP_AT, OWN, TURN_AT, Elements, counted, torque_units
from multirod.models.network.joining.joints import MOST
from multirod.models.network.joining.sliding import push_units, slid
from multirod.models.network.stability.in_clamps import in_clamps, short_enough, turned_for_nothing
from multirod.models.network.stability.spectrum import NEAREST, SPARSE, Scales, nearest_to_zero
from multirod.models.network.state import forces_on, reference_state
from multirod.stability import NEUTRAL, Modes, StabilityAnalysis
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem
    from multirod.models.network.state import State


CONDITION = GAP_AT.stop  # how far behind an unknown of a rod's lines its row is: those of the tip come first
LOOSE = 1e-18  # part of its tension by its unknown that a slack line keeps, so that its row can be scaled
STRESS = 100.0  # EI/L^2 that forces are told in where rods slide: side by side they hardly give way to what they hold among them


DOUBTFUL, BETTER = 1e4, 1e-3  # condition of what fixes a rod, beyond which another is looked at, and what share of it that has


@dataclass(frozen=True)
class Elimination:
    """(16), (31) What the unknowns of rods are eliminated by; axes (instance, rod, ...), columns by the variables of elements.

    Attributes:
        fixing: What is given, by the variables, shape (..., k, size).
        own: The variables that it fixes, k.
        rows: What the form is made of, by the variables: three of the tip, those of lengths, and what is no rod's own.
        gap: The first three of these.
        freed: Of which the angles at the tip are eliminated too, shape (...).
        sound: Where rounding lets it be done, shape (instance,).
    """

    fixing: FloatArray
    own: list[int]
    rows: FloatArray
    gap: FloatArray
    freed: NDArray[np.bool_]
    sound: NDArray[np.bool_]


class NetworkStability(StabilityAnalysis):
    """Of a ``NetworkProblem``: rods that hold each other have several equilibria."""

    def __init__(self, problem: "NetworkProblem") -> None:
        self.problem = problem
        self.rows = problem.form_rows

    def expect(self) -> None:  # noqa: D102
        for group in self.problem.groups:
            group.backbones.stability.expect()

    def modes(self) -> Modes:
        """(15) to (17) Modes of the whole network, counted in the mean stiffness over the mean length of the rods."""
        problem, count = self.problem, self.problem.instance_count
        with problem.everyone(), np.errstate(all="ignore"):
            problem.integrate_rods()
            state = problem.state()
            elements = Elements(problem)
            elimination = self._elimination(elements)
            joints = self._freed(state, elimination)
            form = self._form(state, elements, elimination)
            alone, known = self._of_rods(joints)
        sparse = isinstance(form, list)
        known &= elimination.sound & np.array([np.isfinite(own.data if sparse else own).all() for own in form])
        potential = self.has_potential
        blocks = self.rows.constraints
        hidden = alone.sum(axis=1) - sum(map(len, blocks.values()))
        firm = np.zeros((count, self.rows.size), dtype=bool)
        for rod, places in blocks.items():
            firm[:, places] = (alone[:, rod] == 0)[:, None]
        if sparse:
            told = Eigenvalues(*np.full((3, count, NEAREST), np.nan))
            for k in np.flatnonzero(known & potential).tolist():
                found = nearest_to_zero(form[k], list(blocks.values()), firm[k], NEAREST)
                known[k] = found is not None
                if found is not None:
                    own, below = found
                    told.values[k], told.uncertainty[k], told.neutral_below[k] = own.values, own.uncertainty, own.neutral_below
                    hidden[k] += below
        else:
            told = symmetric_eigenvalues(form, known & potential, firm)
        if not form[0].shape[0]:  # rods between fixed places have nothing that is free
            told = Eigenvalues(np.full((count, 1), np.inf), *np.zeros((2, count, 1)))
        doubtful = ~elimination.sound | turned_for_nothing(problem, state)
        with np.errstate(invalid="ignore"):  # what is hidden by rounding alone
            size = np.abs(told.values)
            doubtful |= ((size <= told.neutral_below + told.uncertainty) & (told.uncertainty > told.neutral_below)).any(axis=1)
        self._ask_clamps(told, hidden, known, potential & doubtful)
        diverging = known & ~potential
        if diverging.any():
            matrices = np.stack([form[k].toarray() if sparse else form[k] for k in np.flatnonzero(diverging).tolist()])
            diverging[diverging] = np.sign(certain_determinant(matrices)) * (-1.0) ** hidden[diverging] < 0
        return told.modes(hidden.astype(np.int32), known & potential, diverging)

    def _ask_clamps(
        self, told: Eigenvalues, hidden: NDArray[np.int_], known: NDArray[np.bool_], doubtful: NDArray[np.bool_]
    ) -> None:
        """(45) What clamps along rods tell, in the place of what is told, of those that are ``doubtful``."""
        rows = np.flatnonzero(doubtful & short_enough(self.problem)) if doubtful.any() else np.zeros(0, dtype=np.intp)
        found = in_clamps(self.problem, rows) if len(rows) else None
        if found is not None:
            width = min(told.values.shape[1], found.values.shape[1])
            told.values[rows], told.uncertainty[rows], told.neutral_below[rows] = np.inf, 0.0, NEUTRAL
            told.values[rows, :width], told.uncertainty[rows, :width] = found.values[:, :width], found.uncertainty[:, :width]
            hidden[rows], known[rows] = (found.values[:, width:] < -NEUTRAL).sum(axis=1), True

    def _of_rods(self, joints: TipJoint | None) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
        """Unstable modes of each rod between clamped ends, but for ``joints`` at tips, shape (instance, rod, ...), the forces on
        these and the tensions of their lines fixed, shape (instance, rod); and whether they are known, shape (instance,)."""
        count = self.problem.instance_count
        hidden, known = np.zeros((count, self.problem.rod_count), dtype=int), np.ones(count, dtype=bool)
        for group in self.problem.groups:
            own = None if joints is None else joints.take((slice(None), group.members)).joined()
            form, _ = group.backbones.stability.condensed_form(own, tensions_fixed=True)
            hidden[:, group.members] = form.conjugate.reshape(count, -1)
            known &= form.known.reshape(count, -1).all(axis=1)
            known &= group.backbones.lines.stays_stiff().reshape(count, -1).all(axis=1)
            if len(group.backbones.rods) > 1:  # tubes whose tips turn against the first are free to
                free = form.matrix[:, 3:-3, 3:-3]
                told = symmetric_eigenvalues(free, form.known)
                hidden[:, group.members] += (told.values < 0).sum(axis=1).reshape(count, -1)
                known &= (np.abs(told.values) > told.uncertainty).all(axis=1).reshape(count, -1).all(axis=1)
        return hidden, known

    def _elimination(self, elements: Elements) -> "Elimination":
        """(16) What fixes the unknowns of each rod: how its tip is turned and the force on it, of a free tip how it is turned and
        moved; and what else is its own. (31) Where that hardly does, what leaves the joint at the tip without torque."""
        layout, graph = self.problem.layout, self.problem.graph
        held, m, size = graph.ends[1].held, layout.own, layout.size - 2 * layout.holes
        angles = layout.angles_at[1]
        # by the variables but holes; in their place, (20), the length of the piece is one more
        kept = [*range(size), *([-1] if layout.holes else [])]
        turn, force, columns = (own[..., kept] for own in (elements.tip_turn, elements.tip_force, elements.columns))
        fixing = np.concatenate([columns[..., TURN_AT, :], force], axis=-2)
        fixing = np.where(held[:, None, None], fixing, np.concatenate([turn, columns[..., GAP_AT, :]], axis=-2))
        angle = np.zeros((*fixing.shape[:2], MOST, len(kept)))
        angle[..., range(MOST), range(angles.start, angles.stop)] = 1.0
        fixing = np.concatenate([fixing, columns[..., OWN:m, :], angle], axis=-2)
        rod, at = np.nonzero(np.arange(m) >= graph.own[:, None])
        fixing[:, rod, at, at] = 1.0
        tensions = self.rows.tensions
        rod, which = np.nonzero(tensions >= 0)
        fixing[:, rod, CONDITION + tensions[rod, which]] = 0.0
        fixing[:, rod, CONDITION + tensions[rod, which], tensions[rod, which]] = 1.0
        own = [*range(m), *range(angles.start, angles.stop)]
        condition = row_condition(fixing[..., own])
        # what a hole leaves free is that of two pieces
        tips = graph.ends[1].table
        turning = np.where((graph.slides.upper < 0) & ~tips.slides.any(axis=1), tips.free, 0)
        freed = np.zeros(condition.shape, dtype=bool)
        doubtful = (condition > DOUBTFUL) & (turning > 0)
        if doubtful.any():
            torque = np.where((np.arange(MOST) < turning[:, None])[..., None], columns[..., angles, :], angle)
            other = np.concatenate([fixing[..., :m, :], torque], axis=-2)
            instead = row_condition(other[..., own])
            freed = doubtful & (instead < BETTER * condition)
            fixing = np.where(freed[..., None, None], other, fixing)
            condition = np.where(freed, instead, condition)
        sound: NDArray[np.bool_] = np.asarray((condition < WORST_CONDITION).all(axis=1))
        gap = np.where(held[:, None, None], columns[..., GAP_AT, :], columns[..., TURN_AT, :])
        lengths = columns[:, np.arange(len(held))[:, None], CONDITION + np.maximum(tensions, 0)]
        rows = np.concatenate([gap, lengths, columns[..., m:size, :]], axis=-2)
        return Elimination(fixing, own, rows, gap, freed, sound)

    def _freed(self, state: "State", elimination: "Elimination") -> TipJoint | None:
        """(31) Joints that are eliminated with the rods at whose tips they are, in the axes of the bases, none in the place of
        others, shape (instance, rod, 3, 3); None where none is."""
        if not elimination.freed.any():
            return None
        problem, table, (base, tip) = self.problem, self.problem.graph.ends[1].table, state.ends
        axes, turns = tip.joints.axes, np.linalg.pinv(tip.joints.turns)
        back = np.linalg.pinv(axes)
        frame = np.swapaxes(base.rotation, -1, -2) @ tip.frame
        moment = np.zeros((*elimination.freed.shape, 3))
        for group in problem.groups:
            moment[:, group.members] = group.backbones.tip_wrench.numpy()[:, 3:].reshape(len(moment), -1, 3)
        moment = np.einsum("brji,brj->bri", frame, moment)
        # torques by the angles, at the same moment: springs, and axes that turn, (3)
        first, second = (np.swapaxes(own, -1, -2) for own in (tip.joints.first, tip.joints.second))
        stiffness = np.einsum("brjkc,brc->brkj", np.cross(first[..., :, None, :], second[..., None, :, :]), moment)
        stiffness[..., range(MOST), range(MOST)] += table.stiffness
        here = elimination.freed[..., None, None]
        free, spring = axes @ back, np.swapaxes(back, -1, -2) @ stiffness @ turns
        turned = np.swapaxes(frame, -1, -2)
        return TipJoint(*(np.where(here, frame @ own @ turned, 0.0) for own in (free, spring)))

    def _form(self, state: "State", elements: Elements, elimination: "Elimination") -> Any:  # noqa: ANN401  (SciPy's)
        """(16), (16b) By a force on each tip that is held, or the turn of one that is free, then tensions, then angles of joints,
        then poses, in units of energy, shape (instance, size, size); where that is large, a list of sparse matrices."""
        problem, layout = self.problem, self.problem.layout
        count, held, m = problem.instance_count, self.problem.graph.ends[1].held, layout.own
        angles = layout.angles_at[1]
        fixing, own, rows = elimination.fixing, elimination.own, elimination.rows
        regular = fixing[..., own]
        regular = np.where(elimination.sound[:, None, None, None], regular, np.eye(len(own)))
        inverse = np.linalg.inv(regular)
        # of each element, what is left once its own are eliminated
        if layout.holes:
            rows = np.concatenate([rows, slid(problem, state, elements, elimination.gap)], axis=-2)
        others = np.setdiff1d(np.arange(fixing.shape[-1]), own)
        own_rows = rows[..., own]
        tensions = self.rows.tensions
        first = 3 + tensions.shape[1]  # where what is left of the variables begins
        gone = slice(first - m + angles.start, first - m + angles.stop)
        every, at = np.arange(problem.rod_count)[:, None], CONDITION + np.maximum(tensions, 0)
        by_own = np.zeros((*rows.shape[:-1], first - m + fixing.shape[-1]))
        by_own[..., :3] = own_rows @ np.where(held[:, None, None], inverse[..., 3:6], inverse[..., :3])
        by_own[..., 3:first] = own_rows @ np.moveaxis(inverse[:, every, :, at], 2, 0).swapaxes(-1, -2)
        by_own[..., gone] = own_rows @ inverse[..., m:]
        by_own[..., first - m + others] = rows[..., others] - own_rows @ inverse @ fixing[..., others]
        if layout.holes:
            by_length = by_own[..., -1:] * problem.length[:, : problem.rod_count, None, None] ** 2
            by_own = np.concatenate([by_own[..., :-1], by_length, -by_length], axis=-1)
            scale = problem.length[:, : problem.rod_count] ** 3 / problem.stiffness[:, : problem.rod_count]
            by_own[..., -2, -2] -= scale * problem.graph.slides.springs[0]  # (37)
        by_own[..., gone][elimination.freed], by_own[..., gone, :][elimination.freed] = 0.0, 0.0
        numbers = by_own.reshape(count, -1)
        loads = -problem.networks.load_turns.numpy()[:, : problem.body_count].reshape(count, -1)
        total, (row, column) = self.rows.size, self.rows.of_numbers
        values = np.concatenate([numbers[:, self.rows.of_elements[0]], loads], axis=1)
        left, right = self._in_units_of_energy(state)
        stiff = np.zeros((count, total))
        for k in np.flatnonzero(elimination.freed.any(axis=1)).tolist():
            at = problem.places[elimination.freed[k], angles]
            stiff[k, self.rows.of(at[at >= 0])] = STIFF
        if total >= SPARSE:
            from scipy.sparse import csc_matrix, diags

            whole = [csc_matrix((own, (row, column)), shape=(total, total)) for own in values]
            return [csc_matrix(left.sparse(k) @ own @ right.sparse(k) + diags(stiff[k])) for k, own in enumerate(whole)]
        added = [np.bincount(row * total + column, weights=own, minlength=total**2) for own in values]
        dense = left.before(right.after(np.array(added, dtype=np.float64).reshape(count, total, total)))
        dense[:, range(total), range(total)] += stiff
        return dense

    def _in_units_of_energy(self, state: "State") -> tuple[Scales, Scales]:
        """(16b), (17) What makes rows derivatives of the energy, by displacements that are not scaled but in units of what is
        one: what stands on the left and on the right of the form."""
        problem, count, L = self.problem, self.problem.instance_count, self.problem.length
        slides, poses, places = problem.graph.slides, self.rows.of_poses, self.rows.of_tensions
        if self.rows.scales is None:
            self.rows.scales = self._constant_scales()
        rows, columns, unit, mean = self.rows.scales
        rows, columns = rows.copy(), columns.copy()
        for group in problem.groups:
            stiffness, rate = group.backbones.lines.tension_rates()
            for rod, own, part in zip(
                group.members,
                *(np.moveaxis(v.reshape(count, len(group.members), -1), 1, 0) for v in (stiffness, rate)),
                strict=True,
            ):
                there = places[rod, : own.shape[1]]
                soft = np.sqrt(np.maximum(part, LOOSE))
                rows[:, there], columns[:, there] = -own * soft, 1 / (L[:, rod, None] * soft)
        rows, columns = rows * unit * mean[:, None], columns * unit
        turns = np.swapaxes(state.frames.axes, -1, -2) @ state.frames.turns[:, state.frames.moving]
        turns = np.linalg.inv(turns) * unit[:, poses[:, 3:]][..., None, :] / unit[:, poses[:, 3:]][..., :, None]
        # torques of a ball are told about fixed axes: about those of its coordinates they are the derivatives
        balls, blocks = [np.zeros((0, 3), dtype=np.intp)], [np.zeros((count, 0, 3, 3))]
        for end, angles in enumerate(problem.layout.angles_at):
            ball = problem.graph.ends[end].table.free == MOST
            if end == 0:
                ball = ball & ~slides.shared  # those are at the tips of the pieces below
            spherical = np.flatnonzero(ball)
            balls.append(self.rows.of(problem.places[spherical, angles]))
            blocks.append(np.swapaxes(state.ends[end].joints.turns[:, spherical], -1, -2))
        at, block = np.concatenate(balls), np.concatenate(blocks, axis=1)
        turned = poses[:, 3:]
        return (
            Scales(rows, at, block * rows[:, at][:, :, None, :]),
            Scales(columns, turned, turns * columns[:, turned][..., None]),
        )

    def _constant_scales(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """(16b), (17) What stands on the left and on the right where only lengths and stiffnesses say it, one elsewhere, and
        ``_units``, those of joints and holes as they are counted."""
        problem, rods, size = self.problem, self.problem.rod_count, self.rows.size
        held = problem.graph.ends[1].held
        L, EI = problem.length, problem.stiffness
        count = problem.instance_count
        rows, columns, (unit, mean) = np.ones((count, size)), np.ones((count, size)), self._units()
        rows[:, : 3 * rods] = np.repeat(np.where(held, -(L[:, :rods] ** 2), EI[:, :rods]), 3, axis=1)
        for end, (angles, sense) in enumerate(zip(problem.layout.angles_at, (-1.0, 1.0), strict=True)):
            at = problem.places[:, angles]
            rod, which = np.nonzero(at >= 0)
            places = self.rows.of(at[rod, which])
            torques = torque_units(problem, end)[:, rod, which]
            rows[:, places], columns[:, places] = sense * torques, 1 / L[:, rod]
            unit[:, places] = counted(torques, EI[:, rod])
        slides = problem.graph.slides
        below = np.flatnonzero(slides.upper >= 0)
        holes = self.rows.of(np.array(problem.first_hole)) + slides.upper[below]
        rows[:, holes], columns[:, holes] = -EI[:, below] / L[:, below], 1 / L[:, below] ** 2
        poses = self.rows.of_poses
        length, stiffness = L[:, rods:, None], EI[:, rods:, None]
        rows[:, poses[:, :3]], rows[:, poses[:, 3:]] = stiffness / length, stiffness
        columns[:, poses[:, :3]] = 1 / length**2
        unit[:, holes] *= counted(push_units(problem)[:, 0, below], EI[:, below])
        return rows, columns, unit, mean

    def _units(self) -> tuple[FloatArray, FloatArray]:
        """What counts as one in each variable, (instance_count, size), and one over the stiffness that values are told in."""
        problem, held = self.problem, self.problem.graph.ends[1].held
        length, stiffness = (scale[:, : problem.rod_count].mean(axis=1) for scale in (problem.length, problem.stiffness))
        length = length * problem.graph.depth
        force = (stiffness / length**2)[:, None]
        if problem.layout.holes:
            force = STRESS * force
        one = np.ones_like(force)
        parts = [force if own else one for own in np.repeat(held, 3)]
        parts += [one] * (self.rows.of(np.array(problem.first_hole)) - 3 * problem.rod_count)
        parts += [length[:, None] * one] * problem.graph.slides.count
        parts += [length[:, None] * one, *[length[:, None]] * 2, one, one, one] * problem.body_count
        return np.concatenate(parts, axis=1), length / stiffness

    @property
    def has_potential(self) -> NDArray[np.bool_]:
        """Whether the loads that act derive from one, shape (instance_count,)."""
        inputs, count = self.problem.read("inputs"), self.problem.instance_count
        specs = self.problem.inputs_given.specs.values()
        names = [spec.name for spec in specs if spec.acts == "tip" and spec.load is not None and not spec.potential]
        places = [self.problem.input_slice(name) for name in names]
        result = ~np.any([inputs[:, place].any(axis=1) for place in places], axis=0)
        result |= self.problem.closing.loading == int(Loading.NONE)
        self.problem.hand_over()
        for group in self.problem.groups:
            result &= group.backbones.stability.has_potential.reshape(count, -1).all(axis=1)
        return np.asarray(result)

    def potential(self) -> FloatArray:
        """Elastic energy of rods and springs less the work of dead forces [J]: on bodies from where their poses are zero, on rods
        from where their bases are there."""
        problem, count, graph = self.problem, self.problem.instance_count, self.problem.graph
        with problem.everyone(), np.errstate(all="ignore"):
            problem.integrate_rods()
            state = problem.state()
            elements = Elements(problem)
            carried, tip_position = np.array(elements.carried), np.array(elements.tip_position)
            total = problem.shapes.of_springs(state.angles)
            pushes = graph.pushes(problem.read("inputs")[:, problem.pushed_place])
            for push, angles in zip(pushes, state.angles, strict=True):  # (40)
                total -= state.level * (push * angles).sum(axis=(1, 2))
            for group in problem.groups:
                for part in group.backbones.shapes.stored_and_lost():
                    total += part.reshape(count, -1).sum(axis=1)
        zero = reference_state(problem)
        # of a rod in pieces, whose weights change, from where its first piece begins
        slides = graph.slides
        first = np.array([slides.of(rod)[0] for rod in slides.owner.tolist()])
        begin = zero.ends[0].origin
        moved = state.ends[0].position - begin[:, first]
        total -= (carried * moved).sum(axis=(1, 2))
        force, weight = forces_on(problem, state)
        given = len(graph.bodies)
        tips_at = slice(given, given + len(graph.free))
        on_tips, on_bodies = force[:, tips_at], np.delete(force, tips_at, axis=1)
        for frames, sense in ((state.frames, 1.0), (zero.frames, -1.0)):
            position, rotation = frames.position[:, frames.moving], frames.rotation[:, frames.moving]
            centre = position + np.einsum("bkij,kj->bki", rotation, graph.mass_centre)
            total -= sense * (weight * centre).sum(axis=(1, 2))
            framed = position[:, graph.framed] + np.einsum("bkij,kj->bki", rotation[:, graph.framed], graph.frame_poses[:, :3, 3])
            total -= sense * (on_bodies * np.concatenate([position[:, :given], framed], axis=1)).sum(axis=(1, 2))
        tips = tip_position[:, graph.free] - begin[:, first[graph.free]]
        total -= (on_tips * tips).sum(axis=(1, 2))
        return np.where(self.has_potential, total, np.nan)

    @property
    def multistable(self) -> bool:  # noqa: D102
        return True

    @property
    def guess_is_stable(self) -> bool:  # noqa: D102
        return False  # where every result is tested, whatever it began at
