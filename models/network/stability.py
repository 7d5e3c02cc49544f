"""The second variation of the energy of a network: its equations by what is free, once the rods themselves are eliminated.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.second_variation import WORST_CONDITION, certain_determinant, symmetric_eigenvalues
from multirod.models.network.elements import ANGLES_AT, GAP_AT, OWN, OWN_AT, POSE, TURN_AT, Equations
from multirod.models.network.joints import MOST
from multirod.stability import Modes, StabilityAnalysis
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem, State


class NetworkStability(StabilityAnalysis):
    """Of a ``NetworkProblem``: rods that hold each other have several equilibria."""

    def __init__(self, problem: "NetworkProblem") -> None:
        self.problem = problem

    def modes(self) -> Modes:
        """(15) to (17) Modes of the whole network, counted in the mean stiffness over the mean length of the rods."""
        problem, count = self.problem, self.problem.instance_count
        with problem.everyone(), np.errstate(all="ignore"):
            state = problem.integrated_state()
            equations = problem.equations(state)
            form, sound = self._form(state, equations)
            hidden, known = self._of_rods()
        length, stiffness = (scale[:, : problem.rod_count].mean(axis=1) for scale in (problem.length, problem.stiffness))
        unit = self._units(length, stiffness)
        form *= unit[:, :, None] * unit[:, None] * (length / stiffness)[:, None, None]
        known &= sound & np.isfinite(form).all(axis=(1, 2))
        potential = self.has_potential
        values, uncertainty = symmetric_eigenvalues(form, known & potential)
        if not form.shape[1]:  # rods between fixed places have nothing that is free
            values, uncertainty = np.full((count, 1), np.inf), np.zeros((count, 1))
        # the tip of each rod is held where it is by three constraints
        hidden = hidden - 3 * int(problem.graph.ends[1].held.sum())
        diverging = known & ~potential
        if diverging.any():
            sign = np.sign(certain_determinant(form[diverging]))
            diverging[diverging] = sign * (-1.0) ** hidden[diverging] < 0
        return Modes(values, hidden.astype(np.int32), uncertainty, known & potential, diverging)

    def _of_rods(self) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
        """Unstable modes of the rods between clamped ends, the forces on their tips fixed, and whether they are known."""
        count = self.problem.instance_count
        hidden, known = np.zeros(count, dtype=int), np.ones(count, dtype=bool)
        for group in self.problem.groups:
            form, _ = group.backbones.stability.condensed_form()
            hidden += form.conjugate.reshape(count, -1).sum(axis=1)
            known &= form.known.reshape(count, -1).all(axis=1)
            known &= group.backbones.lines.stays_stiff().reshape(count, -1).all(axis=1)
        return hidden, known

    def _form(self, state: "State", equations: Equations) -> tuple[FloatArray, NDArray[np.bool_]]:
        """(16) By a force on each tip that is held, or the turn of one that is free, then angles of joints, then poses; and where
        rounding lets it be found."""
        problem, rods, n = self.problem, self.problem.rod_count, self.problem.unknown_count
        count, held = problem.instance_count, self.problem.graph.ends[1].held
        gamma = problem.entries.dense(problem.summed(state, equations)[1])
        # what fixes the six unknowns of each rod: how its tip is turned, and the force on it
        turn, force = equations.tip_in_base()
        fixing = np.concatenate([equations.columns[..., TURN_AT, : turn.shape[-1]], force], axis=-2)
        free = np.concatenate([turn, equations.columns[..., GAP_AT, : turn.shape[-1]]], axis=-2)
        fixing = np.where(held[:, None, None], fixing, free)
        own = fixing[..., OWN_AT]
        sound = np.isfinite(fixing).all(axis=(1, 2, 3))
        own = np.where(sound[:, None, None, None], own, np.eye(OWN))
        sound &= (np.linalg.cond(own) < WORST_CONDITION).all(axis=1)
        inverse = np.linalg.inv(np.where(sound[:, None, None, None], own, np.eye(OWN)))
        # unknowns by what is free: the rods' own follow
        others = np.setdiff1d(np.arange(n), problem.places[:, OWN_AT])
        by = np.zeros((count, n, 3 * rods + len(others)))
        by[:, others, 3 * rods + np.arange(len(others))] = 1.0
        for rod in range(rods):
            rows, at = problem.places[rod, OWN_AT], slice(3 * rod, 3 * rod + 3)
            own_rows = inverse[:, rod]
            by[:, rows, at] += own_rows[..., 3:] if held[rod] else own_rows[..., :3]
            for variable, place in enumerate(problem.places[rod][OWN:], OWN):
                if place >= 0:
                    by[:, rows, 3 * rods + int(np.searchsorted(others, place))] -= (own_rows @ fixing[:, rod, :, variable, None])[
                        ..., 0
                    ]
        kept = np.concatenate([problem.places[rod, GAP_AT if held[rod] else TURN_AT] for rod in range(rods)] + [others])
        form = gamma[:, kept] @ by
        return self._in_units_of_energy(form, state, others), sound

    def _in_units_of_energy(self, form: FloatArray, state: "State", others: NDArray[np.intp]) -> FloatArray:
        """(17) Rows as derivatives of the energy, by displacements that are not scaled."""
        problem, rods = self.problem, self.problem.rod_count
        held = problem.graph.ends[1].held
        L, EI = problem.length, problem.stiffness
        rows, columns = np.ones(form.shape[:2]), np.ones(form.shape[:2])
        for rod in range(rods):
            rows[:, 3 * rod : 3 * rod + 3] = (-(L[:, rod] ** 2) if held[rod] else EI[:, rod])[:, None]
        first = 3 * rods
        for rod in range(rods):
            for angles, sense in zip(ANGLES_AT, (-1.0, 1.0), strict=True):
                own = problem.places[rod, angles]
                places = first + np.searchsorted(others, own[own >= 0])
                rows[:, places] = sense * EI[:, rod, None]
                columns[:, places] = 1 / L[:, rod, None]
        poses = [form.shape[1] - POSE * (problem.body_count - body) for body in range(problem.body_count)]
        for body, at in enumerate(poses):
            length, stiffness = L[:, rods + body, None], EI[:, rods + body, None]
            rows[:, at : at + 3], rows[:, at + 3 : at + POSE] = stiffness / length, stiffness
            columns[:, at : at + 3] = 1 / length**2
        form = rows[:, :, None] * form * columns[:, None]
        for body, at in enumerate(poses):
            turns = np.swapaxes(state.frames.axes[:, body + 1], 1, 2) @ state.frames.turns[:, body + 1]
            form[:, :, at + 3 : at + POSE] = form[:, :, at + 3 : at + POSE] @ np.linalg.inv(turns)
        # torques of a ball are told about fixed axes: about those of its coordinates they are the derivatives
        for end, angles in enumerate(ANGLES_AT):
            turns = state.ends[end].joints.turns
            for rod in np.flatnonzero(problem.graph.ends[end].table.count == MOST).tolist():
                places = first + np.searchsorted(others, problem.places[rod, angles])
                form[:, places] = np.swapaxes(turns[:, rod], 1, 2) @ form[:, places]
        return form

    def _units(self, length: FloatArray, stiffness: FloatArray) -> FloatArray:
        """What counts as one in each variable, shape (instance_count, size)."""
        problem, held = self.problem, self.problem.graph.ends[1].held
        force = (stiffness / length**2)[:, None]
        one = np.ones_like(force)
        parts = [force if own else one for own in np.repeat(held, 3)]
        parts += [one] * (problem.first_pose - OWN * problem.rod_count)
        parts += [length[:, None] * one, *[length[:, None]] * 2, one, one, one] * problem.body_count
        return np.concatenate(parts, axis=1)

    @property
    def has_potential(self) -> NDArray[np.bool_]:
        """Whether the loads derive from one, shape (instance_count,)."""
        inputs, count = self.problem.read("inputs"), self.problem.instance_count
        result = ~inputs[:, self.problem.input_slice("moment")].any(axis=1)
        with self.problem.everyone():
            self.problem.hand_over(np.arange(count))
        for group in self.problem.groups:
            result &= group.backbones.stability.has_potential.reshape(count, -1).all(axis=1)
        return np.asarray(result)

    def potential(self) -> FloatArray:
        """Elastic energy of rods and springs less the work of dead forces [J]: on bodies from where their poses are zero, on rods
        from where their bases are there."""
        problem, count, graph = self.problem, self.problem.instance_count, self.problem.graph
        with problem.everyone(), np.errstate(all="ignore"):
            state = problem.integrated_state()
            equations = problem.equations(state)
            total = problem.shapes.of_springs(state.angles)
            for group in problem.groups:
                for part in group.backbones.shapes.stored_and_lost():
                    total += part.reshape(count, -1).sum(axis=1)
        zero = problem.reference_state()
        moved = state.ends[0].position - zero.ends[0].position
        along = (state.ends[0].rotation @ equations.rods.base_force[..., None])[..., 0] - equations.force
        total -= (along * moved).sum(axis=(1, 2))
        force, weight = problem.forces(state)
        for frames, sense in ((state.frames, 1.0), (zero.frames, -1.0)):
            centre = frames.position[:, 1:] + np.einsum("bkij,kj->bki", frames.rotation[:, 1:], graph.mass_centre)
            total -= sense * (weight * centre).sum(axis=(1, 2))
            total -= sense * (force[:, : problem.body_count] * frames.position[:, 1:]).sum(axis=(1, 2))
        tips = equations.tips()[0][:, graph.free] - zero.ends[0].position[:, graph.free]
        total -= (force[:, problem.body_count :] * tips).sum(axis=(1, 2))
        return np.where(self.has_potential, total, np.nan)

    @property
    def multistable(self) -> bool:  # noqa: D102
        return True

    @property
    def guess_is_stable(self) -> bool:  # noqa: D102
        return False  # where every result is tested, whatever it began at
