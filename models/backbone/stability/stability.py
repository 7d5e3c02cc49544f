"""Stability of one backbone: its second variation by columns at nodes, its potential, and what its rods say beforehand."""

from collections.abc import Callable
from math import ceil
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.kernels.layout.layout import residuals_of, unknowns_of
from multirod.models.backbone.segments.segments import LOOKED_AT
from multirod.models.backbone.stability.condensing.by_nodes import condensed_form
from multirod.models.backbone.stability.condensing.forms import HeldTip, form_of
from multirod.models.backbone.stability.condensing.second_variation import (
    MOST_NODES,
    CondensedForm,
    NodeColumns,
    TipJoint,
    certain_determinant,
    segments_needed,
)
from multirod.models.backbone.stability.condensing.tensions import with_conditions
from multirod.models.backbone.stability.in_pieces import form_in_pieces
from multirod.models.backbone.stability.mode_bounds import ModeBounds, may_be_bounded
from multirod.models.backbone.stability.node_numbers import nodes_for, number_for
from multirod.models.backbone.stability.sure import SureStability, may_be_sure, surely_stable
from multirod.models.backbone.terms import judging
from multirod.problem import FEW
from multirod.profile import DEGREE
from multirod.rod import DENSITY
from multirod.segments import Breakpoints
from multirod.stability import Modes, Stability, StabilityAnalysis
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.nodes.node_pass import NodePass
    from multirod.models.backbone.problem import BackboneProblem

T = TypeVar("T")
MOST_NODES_AT_FIRST = 33
MOST_NODES_IN_A_LAUNCH = 129  # of few rods: asking step by step takes as long as these
MANY = 64  # instances, of which it is first asked which are surely stable
OFTEN = 8  # solves of one problem, from which a kernel pays that tells only what is surely stable


class BackboneStability(StabilityAnalysis):
    """Of a ``BackboneProblem``, free at its tip or held there."""

    def __init__(self, problem: "BackboneProblem") -> None:
        self.problem = problem
        self._stiffness: FloatArray = problem.sizes.least_stiffness

    @property
    def multistable(self) -> bool:  # noqa: D102
        return self.problem.features.turning_count > 0

    @property
    def has_potential(self) -> NDArray[np.bool_]:  # noqa: D102
        inputs, turned = self.problem.read("inputs"), 2 * len(self.problem.rods)  # and pushed, which is no load
        return self.problem.found_for("has_potential", inputs[:, turned:], lambda: self._has_potential(inputs)).copy()

    def _has_potential(self, inputs: FloatArray) -> NDArray[np.bool_]:
        problem, features = self.problem, self.problem.features
        conservative = all(load.conservative for load in features.loads)
        acting = np.full(problem.instance_count, features.measured or features.friction or not conservative)
        for spec in problem.sizes.acting(inputs):
            if not spec.potential:
                acting |= inputs[:, problem.input_slice(spec.name)].any(axis=1)
        if features.profile_degree >= 0:
            moments = problem.table.profile.numpy().reshape(-1, 6, DEGREE + 1)[:, 3:]
            acting |= bool(moments.any()) & (inputs[:, -1] != 0)
        return np.asarray(~acting)

    @property
    def judged(self) -> NDArray[np.bool_]:
        """Of which instances the second variation is told, shape (instance_count,)."""
        return np.asarray(self.has_potential & self.problem.lines.stays_stiff() & (not self.place_unknown))

    @property
    def place_unknown(self) -> bool:
        """Whether forces depend on the configuration in a way of which stability is not told."""
        problem = self.problem
        known = not problem.features.condition_count and not (problem.held and problem.features.turning_count)
        return not known and problem.features.world_force_is_state or not all(load.is_judged() for load in problem.features.loads)

    def potential(self) -> FloatArray:  # noqa: D102
        call = self.problem.nodes.over(2)
        stored, work = np.array(call.read("energy")), np.array(call.read("work"))
        if self.problem.breakpoints:
            _, energy, done = self.problem.cut.shapes(self.problem.breakpoints, 2)
            for k in self.problem.breakpoints:
                stored[k], work[k] = energy[k], done[k]
        if self.problem.features.condition_count:
            stored += self.problem.lines.stretch_energy(self.problem.lines.length())
        return np.where(self.has_potential, stored - work, np.nan)

    def expect(self) -> None:  # noqa: D102
        # once: what kernels these are is told in a tenth of a cold solve's time
        self.problem.tool(("expected", self.problem.judged_often), self._expect)

    def _expect(self) -> None:
        terms = self.problem.features
        by_nodes = not (terms.world_force_is_state or self.place_unknown or (terms.turning_count and not terms.torque_count))
        if by_nodes:
            self.problem.expect_form()
            self.problem.nodes.expect_columns()

    def surely_stable(self) -> bool:  # noqa: D102
        # nothing is told of these nodes, so that they may be other than those of modes
        return bool(self._by_one_launch(lambda own, nodes: own.holds(nodes), few=len(self.problem.rods) > 1))

    def lowest(self) -> FloatArray | None:  # noqa: D102
        return self._by_one_launch(lambda own, nodes: own.lowest(nodes))

    def _by_one_launch(self, ask: Callable[[SureStability, int], T], *, few: bool = False) -> T | None:
        """What ``ask`` says of the launch that looks at few rods by so many nodes, of as many as it calls for, or hardly more
        where these are to be ``few``; None where there is no such launch, or none of as many."""
        problem = self.problem
        if not problem.judged_often or problem.breakpoints:
            return None
        may_be = problem.instance_count <= FEW and may_be_sure(problem)
        own: SureStability | None = problem.tool("surely stable", lambda: SureStability(problem) if may_be else None)
        if own is None or not own.has_potential:
            return None
        # by as many nodes as looks of late called for, then by as many as this one does
        tried, needed, found = 0, min(own.usual, MOST_NODES_IN_A_LAUNCH - 2.0), None
        while tried <= needed < MOST_NODES_IN_A_LAUNCH - 1:
            segments = ceil(needed + 1e-6)  # as whole numbers decide
            key = segments, few
            tried = own.nodes.get(key, 0) or own.nodes.setdefault(key, number_for(self.problem, needed, few=few))
            found = ask(own, tried)
            if found is not None and found is not False:
                break
            needed = own.needed
        return found

    def unstable(self) -> NDArray[np.bool_]:  # noqa: D102
        problem = self.problem
        if problem.renewals >= OFTEN and self.surely_stable():
            return np.zeros(problem.instance_count, dtype=bool)
        if problem.instance_count < MANY or not may_be_sure(problem) or not self.has_potential.all():
            return self._unstable()
        result = ~surely_stable(problem, self._segments_expected(), self._segments_of)
        left = np.flatnonzero(result)
        if len(left):
            part = problem.parts.of(left).stability
            result[left] = part._unstable()
        return result

    def _unstable(self) -> NDArray[np.bool_]:
        """By nodes that the integrator's own steps lead to."""
        form, determinant = self.condensed_form()
        terms = self.problem.features
        if not (terms.members or terms.world_force_is_state) and self.has_potential.all() and form.surely_stable():
            return np.zeros(self.problem.instance_count, dtype=bool)
        return np.asarray(self._modes(form, determinant).stability == Stability.UNSTABLE)

    def modes(self) -> Modes:  # noqa: D102
        return self._modes(*self.condensed_form())

    def _modes(self, form: CondensedForm, determinant: FloatArray) -> Modes:
        modes = form.modes(self.problem.sizes.stiffness_over_length())
        potential, lines, judged = self.has_potential, self.problem.lines, self.judged
        if not judged.all():
            modes.known[~judged] = False
            modes.values[~judged] = np.nan
        # det Gamma is positive where nothing acts
        modes.diverging[:] = self._told_by_sign(potential) & (determinant < 0) | potential & lines.gives_way()
        return modes

    def _told_by_sign(self, potential: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Where the sign of ``det Gamma`` is all that tells of instability, shape (instance_count,)."""
        return np.asarray((~potential | self.place_unknown) & (not self.problem.features.measured))

    def condensed_form(self, joint: TipJoint | None = None, *, tensions_fixed: bool = False) -> tuple[CondensedForm, FloatArray]:
        """The second variation at ``unknowns``, condensed to the tip, or to what a ``joint`` gives there, and ``det Gamma``
        (instance_count,), where that tells more; NaN of breakpoints, of a held tip and where rounding hides its sign. Where
        ``tensions_fixed``, those of lines of given length are not eliminated.

        One integration over as many nodes as the loads call for; where the moments found call for more, another one. Of what is
        symmetric a node may be just where a part of the rod has a mode, and its columns are singular there: then one over one
        segment more follows, which has no node inside at the same place.
        """
        unit = self.problem.sizes.stiffness_over_length()
        size = self._free() + (3 if self.problem.held else 0)
        count = self.problem.instance_count
        form: CondensedForm | None = None
        determinant = np.full(count, np.nan)
        if self.problem.features.turning_count and not self.problem.features.torque_count:
            # all rigid in torsion: a torque of each that nothing determines
            return CondensedForm.unknown(count, size), determinant
        self._stiffness = self.problem.lines.least_stiffness()  # before a pass over nodes: it takes one of its own
        # each instance has its own number of nodes, whatever stands beside it in the batch
        expected = self._segments_expected()
        nodes = nodes_for(self.problem, np.minimum(np.where(np.isnan(expected), 0.0, expected), MOST_NODES_AT_FIRST - 2))
        open_, shifted = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
        if self.problem.features.world_force_is_state and not self.place_unknown:
            asked = self._told_by_sign(self.has_potential) & (self.problem.features.turning_count > 0)
            if asked.any():
                determinant[asked] = certain_determinant(
                    self.problem.nodes.over(LOOKED_AT, asked, columns=True).read("gamma")[asked]
                )
            return self._by_place(), determinant
        if self.place_unknown and self.problem.held:  # of a free one ``Gamma`` tells
            return CondensedForm.unknown(count, size), determinant
        if self.problem.breakpoints:
            cut = list(self.problem.breakpoints)
            form = CondensedForm.unknown(count, size)
            form.put(cut, self.by_breakpoints())
            open_[cut] = False
        while open_.any():
            node_count = int(nodes[open_].min())
            chosen = open_ & (nodes == node_count)
            call = self.problem.nodes.over(node_count, chosen, columns=True)
            needed = self._segments_of(call)
            done, again = chosen & (needed < node_count), np.zeros(count, dtype=bool)
            if done.any():
                own = self._form(call, done, unit, joint)
                if self.problem.features.condition_count and not tensions_fixed:
                    own = self._tensions_eliminated(own, call, done)
                again[done] = ~own.known & ~shifted[done]
                if done.all() and not again.any():
                    form = own
                else:
                    form = CondensedForm.unknown(count, size) if form is None else form
                    form.put(done, own)
                if not self.problem.held and (asked := done & self._told_by_sign(self.has_potential)).any():
                    determinant[asked] = certain_determinant(call.read("gamma")[asked])
                if done.all() and not again.any():
                    break
            more = chosen & ~done & (needed < MOST_NODES - 1)
            nodes[more] = nodes_for(self.problem, needed[more])
            nodes[again] += 1
            shifted |= again
            open_ &= ~chosen | more | again
        return CondensedForm.unknown(count, size) if form is None else form, determinant

    def _by_place(self) -> CondensedForm:
        """(22), (23) Of all instances whose forces depend on where they are, by segments between which they lead on."""
        if self.problem.features.turning_count:
            needed = self._segments_of(self.problem.nodes.over(LOOKED_AT))
            return form_in_pieces(self.problem, np.maximum(needed, self.problem.sizes.segments()))
        problem, cut = self.problem, self.problem.cut
        everyone, unknowns = np.arange(problem.instance_count), cut.asked.read("unknowns")
        length, states = cut.length(everyone), cut.base_state(everyone, unknowns)
        steps = np.array([problem.integrator.steps or 0], dtype=np.int32)
        points = {k: Breakpoints(np.array([0.0, length[k]]), states[k : k + 1], unknowns[k], steps) for k in everyone.tolist()}
        form = cut.condensed_form(points | problem.breakpoints)
        if problem.held and cut.asked is problem:  # who holds it reads what holds it, as a pass over nodes leaves it
            problem.tip_wrench.assign(cut.call.wrench.values)
        return form

    def by_breakpoints(self) -> CondensedForm:
        """The same of instances that are known by their breakpoints, in their order."""
        return self.problem.cut.condensed_form(self.problem.breakpoints)

    def _free(self) -> int:
        """Angles of a free tip: three of what ends there, and how each rod turns against it."""
        return 3 + self.problem.features.turning_count

    def _form(
        self, call: "NodePass", chosen: NDArray[np.bool_], unit: FloatArray, joint: TipJoint | None = None
    ) -> CondensedForm:
        """(4) to (6) by what a pass over nodes says of the instances ``chosen``; ``unit`` is ``K/L`` [N m] of all."""
        if self.problem.judged_often and joint is None:
            return self._compiled(call, chosen, unit)
        return condensed_form(self._given(call, chosen, self._other_columns(), joint), unit[chosen])

    def _compiled(
        self, call: "NodePass", chosen: NDArray[np.bool_], unit: FloatArray, *, by_wrench: bool = False
    ) -> CondensedForm:
        """The same by a kernel, or (12) of docs/held.md."""
        problem, ends = self.problem, self._column_ends()
        tip = HeldTip(problem.wrench_columns, problem.tip_wrench, by_wrench) if problem.held else None
        return form_of(call, self._free(), ends.shape[1], problem.device, tip).of(chosen, ends, unit)

    def _other_columns(self) -> NDArray[np.intp]:
        """Columns by which the form is made, where all tensions are fixed."""
        # base forces that follow a load are no variations that keep the forces, and those of unloaded tubes carry a moment here
        if not self.problem.held:
            return np.arange(self._free())
        drives = self.problem.slots.places["drives"]
        return np.delete(np.arange(self.problem.unknown_count), np.arange(drives.start, drives.stop))

    def _tensions_eliminated(self, form: CondensedForm, call: "NodePass", chosen: NDArray[np.bool_]) -> CondensedForm:
        """(18)"""
        problem, others = self.problem, self._other_columns()
        slots = unknowns_of(judging(problem.features))  # of the pass: of unloaded tubes it carries a moment, the problem none
        drives = slots.places["drives"]
        tensions = np.arange(drives.start, drives.stop)
        lacking = call.read("gamma")[chosen][:, residuals_of(slots).places["conditions"]]
        by_others, by_tensions = (self._node_columns(call, chosen, columns) for columns in (others, tensions))
        taut = problem.lines.taut()[chosen]
        return with_conditions(form, by_others, by_tensions, -lacking[:, :, others], -lacking[:, :, tensions], taut)

    def _given(
        self, call: "NodePass", chosen: NDArray[np.bool_], columns: NDArray[np.intp], joint: TipJoint | None
    ) -> NodeColumns:
        """The same with what a ``joint`` gives at the tip."""
        found = self._node_columns(call, chosen, columns)
        return found if joint is None else joint.take(chosen).given(found, self.problem.sizes.least_stiffness[chosen])

    def _node_columns(self, call: "NodePass", chosen: NDArray[np.bool_], columns: NDArray[np.intp]) -> NodeColumns:
        """What a pass over nodes says of variations of the instances ``chosen`` by some of the unknowns."""
        rows = self._free()
        ends = self._column_ends()[chosen]
        arclength = call.read("column_arclength")[chosen]
        configuration = call.read("node_columns")[chosen, :, :rows][..., columns]
        momenta = call.read("tip_columns")[chosen, :rows][..., columns]
        if not self.problem.held:
            return NodeColumns(arclength, configuration, momenta, ends)
        wrench = self.problem.wrench_columns.numpy()[chosen][..., columns]
        momenta = np.concatenate([wrench[:, 3:], momenta[:, 3:]], axis=1)
        position = call.read("pose_columns")[chosen, :3][..., columns]
        return NodeColumns(arclength, configuration, momenta, ends, wrench[:, :3], position)

    def _column_ends(self) -> FloatArray:
        """Where rods end [m], shape (instance_count, n or more)."""
        ends = self.problem.sizes.ends()
        if self.problem.features.eccentric:  # the line is what ends at the tip, as the longest rod does
            ends = np.concatenate([ends.max(axis=1, keepdims=True), ends], axis=1)
        return ends

    def _segments_expected(self) -> FloatArray:
        """(7) by what the moments cannot exceed."""
        length, scale = self.problem.sizes.furthest_end(), self.problem.load_scale()
        if self.problem.held:
            x = np.abs(self.problem.read("unknowns") - self.problem.guess())
            stiffest = (
                self.problem.each(self.problem.arrays.material[..., :2].max(axis=(1, 2, 3))) / self.problem.sizes.least_stiffness
            )
            scale = scale + stiffest * length * (np.linalg.norm(x[:, :-3], axis=1) + np.linalg.norm(x[:, -3:], axis=1))
        unit = self.problem.sizes.least_stiffness / length
        return self._segments(scale * unit, scale * unit / length, scale / length)

    def segments(self) -> FloatArray:
        """(7) How many equal segments are sure to have no mode of their own each, with a factor of 2 to spare, shape
        (instance_count,)."""
        self._stiffness = self.problem.lines.least_stiffness()
        return self._segments_of(self.problem.nodes.over(LOOKED_AT))

    def _segments_of(self, call: "NodePass") -> FloatArray:
        """(7) by the moments, forces and curvatures of a pass over nodes."""
        values = (call.read(f"node_{name}") for name in ("moment", "force", "curvature"))
        return self._segments(*(np.sqrt((own * own).sum(axis=2).max(axis=1)) for own in values))

    def _segments(self, moment: FloatArray, force: FloatArray, curvature: FloatArray) -> FloatArray:
        """(7) from bounds [N m], [N], [1/m], shape (instance_count,)."""
        coupling, potential = moment, force + self.problem.sizes.moment_per_length()
        if self.problem.features.turning_count:
            bend, most, kappa = self.problem.sizes.bend_by_section
            coupling = moment + most
            potential = potential + (bend * (kappa + curvature[:, None, None])).max(axis=2).sum(axis=1)
        return segments_needed(self.problem.sizes.furthest_end(), self._stiffness, coupling, potential)

    def mode_bounds(self) -> FloatArray | None:  # noqa: D102
        if not may_be_bounded(self.problem):
            return super().mode_bounds()
        own: ModeBounds = self.problem.tool("mode bounds", lambda: ModeBounds(self.problem))
        bounds, potential = own.under(self._dead_load()), self.has_potential
        if not potential.all():
            bounds[:, 0] += np.where(potential, 0.0, 0.5 * self.problem.load_scale())
            bounds[~potential, 1] = np.inf
        if self.problem.features.anisotropic or self.problem.features.loads:
            # they resist being turned against their neighbours even where all are straight, or forces follow from where they are
            bounds = np.maximum(bounds, (1.0, np.inf))
        return np.asarray(bounds)

    def _dead_load(self) -> FloatArray:
        """Bound of the dead forces' part of the internal force [N], shape (instance_count,)."""
        inputs = self.problem.read("inputs")
        length, total = self.problem.sizes.furthest_end, np.zeros(len(inputs))
        for spec in self.problem.sizes.acting(inputs):
            if spec.load != "force" or spec.follows:
                continue
            size = np.linalg.norm(inputs[:, self.problem.input_slice(spec.name)], axis=1)
            if spec.name == "gravity":
                size = size * self.problem.each(self.problem.arrays.material[..., DENSITY].max(axis=2).sum(axis=1))
            total += size * length() if spec.acts == "along" else size
        if self.problem.features.profile_degree >= 0:
            profile = np.abs(self.problem.table.profile.numpy())
            most = profile.reshape(len(profile), 6, -1).sum(-1).max(0)[:3].sum()
            total = total + most * length() * np.abs(inputs[:, -1])
        return np.asarray(total)
