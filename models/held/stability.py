"""The second variation of the energy of a rod that is held at both ends.

Numbers in parentheses are those of ``docs/held.md``.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.stability.condensing.by_nodes import compliance_form
from multirod.models.backbone.stability.condensing.inverses import row_condition
from multirod.models.backbone.stability.condensing.second_variation import (
    WORST_CONDITION,
    CondensedForm,
    TipJoint,
    certain_determinant,
    symmetric_eigenvalues,
)
from multirod.models.backbone.stability.stability import BackboneStability
from multirod.models.held.costless import free_in_balls
from multirod.models.held.kernels.arguments import BALL_AND_CLAMP, IN_BALLS, SPINS
from multirod.models.joint_kernels import CLAMPED, SPHERICAL
from multirod.rotations import cross
from multirod.stability import Modes, StabilityAnalysis
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.nodes.node_pass import NodePass
    from multirod.models.held.problem import HeldProblem

FREE = 1e-2  # of the form, and of what is bent: what a turn that costs nothing leaves, by tolerances and the integration's error


class TipByWrench(BackboneStability):
    """Of a backbone whose tip is held, by the wrench on it: the form is regular where that by its rotation has a pole."""

    def _form(
        self, call: "NodePass", chosen: NDArray[np.bool_], unit: FloatArray, joint: TipJoint | None = None
    ) -> CondensedForm:
        """(12)"""
        problem = self.problem
        if problem.judged_often and joint is None:
            return self._compiled(call, chosen, unit, by_wrench=True)
        columns = self._node_columns(call, chosen, np.arange(problem.unknown_count))
        if problem.features.condition_count:
            count = len(columns.ends)
            return CondensedForm.unknown(count, 6)
        return compliance_form(columns, problem.tip_wrench.numpy()[chosen, 3:])

    def by_breakpoints(self) -> CondensedForm:
        """Of what is known so, others have it."""
        return CondensedForm.unknown(len(self.problem.breakpoints), 6)


class HeldStability(StabilityAnalysis):
    """Of a ``HeldProblem``: with both ends held there are several equilibria."""

    def __init__(self, problem: "HeldProblem") -> None:
        self.problem = problem

    def expect(self) -> None:  # noqa: D102
        self.problem.rod.stability.expect()

    def modes(self) -> Modes:
        """(12) to (15) What is left free: angles of the base in its joint, and the moments and forces that hold the tip."""
        problem = self.problem
        problem.to_rod()
        rod, length, turns = problem.rod, problem.length, problem.turns
        if turns:
            rod.launch.launch()  # which finds its columns by what acts along it
        condensed, _ = TipByWrench(rod).condensed_form(tensions_fixed=True)
        matrix = self._with_base(condensed) if turns else condensed.matrix
        wrench = rod.tip_wrench.numpy()
        if problem.breakpoints:
            points, cut = list(problem.breakpoints), rod.cut
            by_segments, wrench = cut.condensed_form(problem.breakpoints), wrench.copy()
            wrench[points] = cut.wrench(problem.breakpoints)
            matrix[points] = by_segments.matrix
            condensed.conjugate[points], condensed.known[points] = by_segments.conjugate, by_segments.known
        condensed.known[~rod.lines.stays_stiff() | rod.stability.place_unknown] = False
        stiffness = np.asarray(rod.sizes.least_stiffness)
        by = self._held_by()
        unit = np.ones((problem.instance_count, by.shape[1]))
        unit[:, turns : turns + 3] = (stiffness / length)[:, None]
        unit[:, turns + 3 :] = (stiffness / length**2)[:, None]
        by *= unit[:, :, None] / np.sqrt(stiffness / length)[:, None, None]
        form = by.swapaxes(1, 2) @ matrix @ by
        known = condensed.known & np.isfinite(form).all(axis=(1, 2))
        potential = self.has_potential
        # (27) of the stability of rods in general
        firm = (condensed.conjugate == 0)[:, None] & (np.arange(form.shape[1]) >= turns)
        told = symmetric_eigenvalues(form, known & potential, firm)
        hidden = condensed.conjugate - np.int32(form.shape[1] - turns)
        diverging = known & ~potential
        if diverging.any():
            sign = np.sign(certain_determinant(form[diverging]))
            diverging[diverging] = sign * (-1.0) ** hidden[diverging] < 0
        for k, neutral in self._neutral(by, form, known & potential, wrench):
            across = np.linalg.svd(neutral)[2][len(neutral) :]
            all_firm = np.full((1, len(across)), firm[k].all())
            own = symmetric_eigenvalues((across @ form[k] @ across.T)[None], np.ones(1, dtype=bool), all_firm)
            for name, rest in (("values", np.inf), ("uncertainty", 0.0), ("neutral_below", 0.0)):
                getattr(told, name)[k] = np.append(getattr(own, name)[0], np.full(len(neutral), rest))
        return told.modes(hidden, known & potential, diverging)

    def _held_by(self) -> FloatArray:
        """Angles of the base, moments across the joint's axes and forces across the slide, as columns in the world."""
        problem = self.problem
        frame, turns, holders = problem.goal()[1], problem.turns, problem.holders
        moments, forces = holders.held_rotations, holders.held_directions
        m = turns + moments.shape[1]
        by = np.zeros((problem.instance_count, turns + 6, m + forces.shape[1]))
        by[:, range(turns), range(turns)] = 1.0
        by[:, turns : turns + 3, turns:m] = frame @ moments
        by[:, turns + 3 :, m:] = frame @ forces
        return by

    def _neutral(
        self, by: FloatArray, form: FloatArray, known: NDArray[np.bool_], wrench: FloatArray
    ) -> list[tuple[int, FloatArray]]:
        """(15), (25) Instances of which turns cost nothing, and how their variables change by each of these, a row, orthonormal;
        ``wrench`` is that on their tips.

        A straight rod has no such turn: forces across it are rounding, and any direction may be theirs. So it is one only where
        the form resists it by nothing, (16).
        """
        problem = self.problem
        found = []
        unit = np.sqrt(problem.rod.sizes.least_stiffness / problem.length)
        for k, turns in self._costless(wrench):
            rows: list[FloatArray] = []
            for turn in turns if known[k] else ():
                change = np.linalg.lstsq(by[k], turn, rcond=None)[0]
                for other in rows:
                    change = change - other * (other @ change)
                size = np.linalg.norm(change)
                if not size:
                    continue
                change, bent = change / size, min(size / unit[k], 1.0)
                if np.linalg.norm(form[k] @ change) <= FREE * bent * np.linalg.norm(form[k], ord=2):
                    rows.append(change)
            if rows:
                found.append((k, np.array(rows)))
        return found

    def _costless(self, wrench: FloatArray) -> list[tuple[int, list[FloatArray]]]:
        """Turns that cost nothing: how they change the angles of the base, times the length, moment and force at the tip."""
        problem, turns = self.problem, self.problem.turns
        base, found = problem.rod.table.base_rotation.numpy(), []
        for k in np.flatnonzero(problem.table.neutral.numpy() != 0).tolist():
            axis = base[k % len(base), :, 2]
            found.append((k, [np.concatenate([np.zeros(turns), cross(axis, wrench[k, 3:]), cross(axis, wrench[k, :3])])]))
        kinds = free_in_balls(problem)
        if not kinds.any():
            return found
        axes, tip = problem.turn_axes(), problem.rod.read("position") - problem.rod.table.base_position.numpy()
        for k in np.flatnonzero(kinds).tolist():
            chord, along = tip[k] / np.linalg.norm(tip[k]), base[k % len(base), :, 2]
            held = [cross(chord, wrench[k, 3:]), cross(chord, wrench[k, :3])]
            rigid, own = (problem.length[k] * np.linalg.solve(axes[k], way) for way in (chord, along))
            if kinds[k] == BALL_AND_CLAMP:
                found.append((k, [np.concatenate([rigid - own, *held])]))
                continue
            ways = [np.concatenate([rigid, *held]), np.concatenate([own, np.zeros(6)])]
            found.append((k, ways[1:] if kinds[k] == SPINS else ways[: 1 + (kinds[k] != IN_BALLS)]))
        return found

    def _with_base(self, condensed: CondensedForm) -> FloatArray:
        """(14) The form with the angles of the base's joint, which stand first."""
        problem = self.problem
        rod, m, turns = problem.rod, problem.rod.unknown_count, problem.turns
        pose, wrench = rod.pose_columns.numpy(), rod.wrench_columns.numpy()[:, [3, 4, 5, 0, 1, 2]]
        force, moment = rod.tip_wrench.numpy()[:, :3], rod.tip_wrench.numpy()[:, 3:]
        arm = rod.read("position") - np.broadcast_to(rod.table.base_position.numpy(), (problem.instance_count, 3))
        axes = problem.turn_axes()
        own = slice(m + problem.direction_count, m + problem.direction_count + turns)
        turned = pose[..., own] + np.concatenate([_each_cross(axes, arm), axes], axis=1)
        by_turn = wrench[..., own] + np.concatenate([_each_cross(axes, moment), _each_cross(axes, force)], axis=1)
        by_unknown, by_turn = (_symmetric(v, w, moment) for v, w in ((wrench[..., :m], pose[..., :m]), (by_turn, turned)))
        sound = condensed.known & np.isfinite(by_unknown).all(axis=(1, 2))
        sound[sound] = row_condition(by_unknown[sound]) < WORST_CONDITION
        condensed.known[~sound] = False
        inverse = np.linalg.inv(np.where(sound[:, None, None], by_unknown, np.eye(6)))
        twist = turned[:, [3, 4, 5, 0, 1, 2]]
        lacking = -axes.swapaxes(1, 2) @ problem.base_moment_columns() @ inverse
        matrix = np.zeros((problem.instance_count, 6 + turns, 6 + turns))
        matrix[:, turns:, turns:] = condensed.matrix
        matrix[:, turns:, :turns] = -twist - condensed.matrix @ by_turn
        matrix[:, :turns, turns:] = lacking
        matrix[:, :turns, :turns] = -lacking @ by_turn - axes.swapaxes(1, 2) @ _each_cross(axes, problem.base_moment())
        # per angle of a joint
        unit = np.ones(6 + turns)[None] * np.where(np.arange(6 + turns) < turns, 1 / problem.length[:, None], 1.0)
        return matrix * unit[:, :, None] * unit[:, None, :]

    @property
    def has_potential(self) -> NDArray[np.bool_]:
        """Whether the loads derive from one, shape (instance_count,): a dead moment does about a fixed axis alone."""
        inputs = self.problem.read("inputs")
        result = self.problem.rod.stability.has_potential
        if self.problem.holders.joint == SPHERICAL:
            result = result & ~inputs[:, self.problem.input_slice("tip_moment")].any(axis=1)
        return np.asarray(result)

    def potential(self) -> FloatArray:
        """Elastic energy less the work of dead forces [J]: along the rod from its base, on its end from where its holder is.

        NaN with a moment on the end, whose work counts turns.
        """
        problem = self.problem
        problem.to_rod()
        total = np.zeros(problem.instance_count)
        for part in problem.rod.shapes.stored_and_lost():
            total += part
        inputs = problem.read("inputs")
        force, moment = (inputs[:, problem.input_slice(name)] for name in ("tip_force", "tip_moment"))
        force = problem.load_factor.numpy()[:, None] * force
        position = problem.rod.shapes.at_nodes(2)[0][0].position[:, -1]
        total -= (force * (position - problem.goal()[0])).sum(axis=1)
        turned = moment.any(axis=1) & (problem.holders.joint != CLAMPED)
        return np.where(self.has_potential & ~turned, total, np.nan)

    @property
    def multistable(self) -> bool:  # noqa: D102
        return True

    @property
    def guess_is_stable(self) -> bool:  # noqa: D102
        return False


def _symmetric(moment_and_force: FloatArray, pose: FloatArray, moment: FloatArray) -> FloatArray:
    """(12) Moments as they vary by rotations along geodesics."""
    result = np.array(moment_and_force)
    result[:, :3] += 0.5 * _each_cross_left(moment, pose[:, 3:])
    return result


def _each_cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Each column of ``a`` (count, 3, k) times ``b`` (count, 3)."""
    return np.asarray(cross(a.swapaxes(1, 2), b[:, None]).swapaxes(1, 2))


def _each_cross_left(b: FloatArray, a: FloatArray) -> FloatArray:
    """``b`` (count, 3) times each column of ``a`` (count, 3, k)."""
    return -_each_cross(a, b)
