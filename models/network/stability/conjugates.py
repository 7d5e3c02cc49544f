"""What the residuals of a network do work on.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import Conjugates
from multirod.models.backbone.inputs import LOADS
from multirod.models.backbone.kernels.tips import as_far, longest
from multirod.models.backbone.units import unit_stiffness
from multirod.models.network.elements.elements import GAP_AT, OWN, POSE, TURN_AT, Elements, counted, torque_units
from multirod.models.network.joining.joints import MOST
from multirod.models.network.joining.sliding import push_units
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem

GIVE = 1e-8  # of ``L^3/EI``: what a tip gives way by, so that straight rods that do not stretch are no exception
POTENTIAL = {spec.name: spec.potential for spec in LOADS}


@dataclass(frozen=True)
class Tubes:
    """Tubes of one rod, all but the one that is held or loaded at the tip, in the order of the rod's own rows.

    Attributes:
        rod: Number of the rod.
        others: Which they are, shape (instance, tube).
        longest: The one that ends at the tip, shape (instance,).
        reach: Whether each reaches as far as the first, shape (instance, tube).
        torsion: Torsional stiffness at their ends [N m^2], shape (instance, tube).
    """

    rod: int
    others: IntArray
    longest: IntArray
    reach: NDArray[np.bool_]
    torsion: FloatArray


class NetworkConjugates(Conjugates):
    """(25) Of a ``NetworkProblem`` with the columns of the pose: gaps and mismatches of tips, forces on tips that nothing holds,
    and the lengths of lines are constraints.

    Args:
        problem: The network.
        turns_alone: Whether the forces on bodies, and what slides, are constraints too: where these hold, places follow from how
            all is turned.
    """

    def __init__(self, problem: "NetworkProblem", *, turns_alone: bool = False) -> None:
        self.problem = problem
        graph, places, bodies = problem.graph, problem.places, problem.body_count
        L, EI = problem.length, problem.stiffness
        count, n, rods = problem.instance_count, problem.unknown_count, problem.rod_count
        length = L[:, :rods].mean(axis=1) * graph.depth
        unit, scale = np.zeros((2, count, n))  # zero of constraints
        for tubes in self._tubes():
            unit[:, self._rows(tubes)] = tubes.torsion
        for rod in graph.free.tolist():
            unit[:, places[rod, TURN_AT]] = EI[:, rod, None]
        scale[unit != 0] = 1.0
        for end, at in enumerate(problem.layout.angles_at):
            rod, which = np.nonzero(places[:, at] >= 0)
            own = places[rod, at.start + which]
            unit[:, own] = torque_units(problem, end)[:, rod, which]
            scale[:, own] = counted(unit[:, own], EI[:, rod])
        below = np.flatnonzero(graph.slides.upper >= 0)
        holes = problem.first_hole + graph.slides.upper[below]
        pushes = push_units(problem)[:, 0, below]
        unit[:, holes], scale[:, holes] = pushes / L[:, below], length[:, None] * counted(pushes, EI[:, below])
        poses = problem.first_pose + np.arange(POSE * bodies).reshape(-1, POSE)
        unit[:, poses[:, :3]], scale[:, poses[:, :3]] = (EI / L)[:, rods:, None], length[:, None, None]
        unit[:, poses[:, 3:]], scale[:, poses[:, 3:]] = EI[:, rods:, None], 1.0
        if turns_alone:
            unit[:, holes], unit[:, poses[:, :3]] = 0.0, 0.0
        self.forces = np.flatnonzero(unit[0])
        shape = (count, len(self.forces), n + problem.direction_count)
        device = problem.device
        self.unit: Any = wp.array(unit[:, self.forces], dtype=wp.float64, device=device)
        self.scale: Any = wp.array(scale[:, self.forces], dtype=wp.float64, device=device)
        self.columns: Any = wp.zeros(shape, dtype=wp.float64, device=device)
        softest = np.zeros((count, rods))
        for group in problem.groups:
            softest[:, group.members] = group.backbones.sizes.least_stiffness.reshape(count, -1)
        self.stiffness = softest.mean(axis=1) / length
        held = graph.ends[1].held
        gaps, forces = places[held, GAP_AT], places[held, OWN - 3 : OWN]
        self.give = tuple((int(row), int(own), GIVE) for row, own in zip(gaps.flat, forces.flat, strict=True))
        without = [name for name in problem._slices if name == "moment" or not POTENTIAL.get(name, True)]
        self.without = tuple(k for name in without for k in range(problem.input_count)[problem.input_slice(name)])
        self.has_potential = all(group.backbones.has_potential for group in problem.groups)

    def natural(self) -> FloatArray:
        """That of the unloaded network, whose rods give way along themselves: where soft rods stand beside stiff ones, it is far
        below 1."""
        problem, result = self.problem, np.ones(self.problem.instance_count)
        apart = problem.closing.apart().unknowns
        with problem.closing.unloaded(), np.errstate(all="ignore"):
            problem.write("unknowns", apart)
            problem.closing.soft[:] = 1.0
            problem.integrate()
            try:
                form = self.reduced(problem).form
            except np.linalg.LinAlgError:
                return result
        for k in np.flatnonzero(np.isfinite(form).all(axis=(1, 2))).tolist():
            least = float(np.linalg.eigvalsh(0.5 * (form[k] + form[k].T))[0]) / self.stiffness[k]
            result[k] = least if 0 < least < 1 else 1.0
        return result

    def _rows(self, tubes: Tubes) -> NDArray[np.intp]:
        """Where the torques of tubes are residuals."""
        return np.asarray(self.problem.places[tubes.rod, OWN : OWN + tubes.others.shape[1]])

    def _tubes(self) -> Iterator[Tubes]:
        """Those of each rod that is made of several, as they are pushed out where they were integrated last."""
        for group in self.problem.groups:
            own, count = group.backbones, len(group.backbones.rods)
            if not own.features.torque_count:
                continue
            reach = own.arrays.end[:, :, -1] + own.read("inputs")[:, own.input_slice("translation")]
            at_tip = longest(reach)
            all_ = np.broadcast_to(np.arange(count), reach.shape)
            others = all_[all_ != at_tip[:, None]].reshape(len(reach), count - 1)
            torsion = own.each(unit_stiffness(own.arrays.material[:, :, -1, :3])[..., 2])
            far = np.take_along_axis(as_far(reach, reach[:, :1]), others, axis=1)
            stiff = np.take_along_axis(torsion, others, axis=1)
            for place, rod in enumerate(group.members.tolist()):
                mine = slice(place, None, len(group.members))
                yield Tubes(rod, others[mine], at_tip[mine], far[mine], stiff[mine])

    def update(self) -> None:  # noqa: D102
        problem = self.problem
        all_tubes = list(self._tubes())  # which one ends at the tip, inputs say
        if all_tubes:
            unit = np.array(self.unit.numpy())
            for tubes in all_tubes:
                unit[:, np.searchsorted(self.forces, self._rows(tubes))] = tubes.torsion
            self.unit.assign(unit)
        with np.errstate(all="ignore"):  # what is not finite is said by its fault
            found = self._displaced(all_tubes)[:, self.forces]
        listed = problem.buffer("order")[: problem.listed]
        rows = listed[problem.buffer("active")[listed] != 0]
        columns = np.array(self.columns.numpy())
        columns[rows] = found[rows]
        self.columns.assign(columns)

    def _displaced(self, all_tubes: Sequence[Tubes]) -> FloatArray:
        """(25) What each row of the residual does work on by the unknowns, then along directions, shape
        (instance_count, n, n + direction_count); zero of constraints."""
        problem = self.problem
        state, L = problem.state(), problem.length
        n, d, graph, places, size = (
            problem.unknown_count,
            problem.direction_count,
            problem.graph,
            problem.places,
            problem.layout.size,
        )
        result = np.zeros((problem.instance_count, n, n + d))
        elements = Elements(problem)
        turn = elements.tip_turn
        for tubes in all_tubes:
            known, rows = np.flatnonzero(places[tubes.rod] >= 0), self._rows(tubes)
            against = np.insert(elements.angles[:, tubes.rod], 0, 0.0, axis=1)  # the frame, which is that of the first
            angles = np.take_along_axis(against, tubes.others[..., None], axis=1)
            angles -= tubes.reach[..., None] * np.take_along_axis(against, tubes.longest[:, None, None], axis=1)
            result[:, rows[:, None], places[tubes.rod, known]] = angles[..., known]
            result[:, rows, n:] = angles[..., size : size + d]
        for rod in graph.free.tolist():
            known = np.flatnonzero(places[rod] >= 0)
            rows = places[rod, TURN_AT]
            result[:, rows[:, None], places[rod, known]] = turn[:, rod][..., known]
            result[:, rows, n:] = turn[:, rod, :, size : size + d]
        for end, (at, sense) in enumerate(zip(problem.layout.angles_at, (-1.0, 1.0), strict=True)):
            table, turns = graph.ends[end].table, state.ends[end].joints.turns
            for rod in np.flatnonzero(table.free).tolist():
                if end == 0 and graph.slides.shared[rod]:  # told by the tip of the piece below
                    continue
                rows = places[rod, at][: table.free[rod]]
                by_angles = turns[:, rod] if table.free[rod] == MOST else np.eye(int(table.free[rod]))
                result[:, rows[:, None], rows] = sense * L[:, rod, None, None] * by_angles
        below = np.flatnonzero(graph.slides.upper >= 0)
        holes = problem.first_hole + graph.slides.upper[below]
        result[:, holes, holes] = -(L[:, below] ** 2)
        turned = np.swapaxes(state.frames.axes, -1, -2) @ state.frames.turns[:, state.frames.moving]
        for body in range(problem.body_count):
            rows = problem.first_pose + POSE * body + np.arange(POSE)
            result[:, rows[:3], rows[:3]] = L[:, problem.rod_count + body, None] ** 2
            result[:, rows[3:, None], rows[3:]] = turned[:, body]
        return result
