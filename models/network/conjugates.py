"""What the residuals of a network do work on.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.capabilities import Conjugates
from multirod.models.backbone.inputs import LOADS
from multirod.models.network.elements import ANGLES_AT, GAP_AT, OWN, POSE, SIZE, TURN_AT
from multirod.models.network.entries import Sums
from multirod.models.network.groups import put
from multirod.models.network.joints import MOST
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem

GIVE = 1e-8  # of ``L^3/EI``: what a tip gives way by, so that straight rods that do not stretch are no exception
POTENTIAL = {spec.name: spec.potential for spec in LOADS}


class NetworkConjugates(Conjugates):
    """(25) Of a ``NetworkProblem`` with the columns of the pose: gaps and mismatches of tips, and the forces on tips that nothing
    holds, are constraints.

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
        for rod in graph.free.tolist():
            unit[:, places[rod, TURN_AT]] = EI[:, rod, None]
        for at in ANGLES_AT:
            rod, which = np.nonzero(places[:, at] >= 0)
            unit[:, places[rod, at.start + which]] = EI[:, rod]
        scale[unit != 0] = 1.0
        below = np.flatnonzero(graph.slides.upper >= 0)
        holes = problem.first_hole + graph.slides.upper[below]
        unit[:, holes], scale[:, holes] = (EI / L)[:, below], length[:, None]
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
            softest[:, group.members] = group.backbones.least_stiffness().reshape(count, -1)
        self.stiffness = softest.mean(axis=1) / length
        held = graph.ends[1].held
        gaps, forces = places[held, GAP_AT], places[held, OWN - 3 : OWN]
        self.give = tuple((int(row), int(own), GIVE) for row, own in zip(gaps.flat, forces.flat, strict=True))
        without = [name for name in problem._slices if name == "moment" or not POTENTIAL.get(name, True)]
        self.without = tuple(k for name in without for k in range(problem.input_count)[problem.input_slice(name)])
        self.has_potential = all(group.backbones.has_potential for group in problem.groups)

    def update(self) -> None:  # noqa: D102
        assert self.problem.seen is not None  # or nothing was integrated
        put(self.columns, self.problem.seen[0].rows, self._displaced()[:, self.forces])

    def _displaced(self) -> FloatArray:
        """(25) What each row of the residual does work on by the unknowns, then along directions, shape (k, n, n +
        direction_count); zero of constraints."""
        problem = self.problem
        assert problem.seen is not None  # as before
        state, equations = problem.seen
        n, d, graph, places = problem.unknown_count, problem.direction_count, problem.graph, problem.places
        result = np.zeros((len(state.rows), n, n + d))
        L = problem.length[state.rows]
        turn = equations.driven(equations.tip_in_base()[0])
        for rod in graph.free.tolist():
            own = turn[:, rod]
            columns = Sums(places[rod], n)(own[..., :SIZE])
            if problem.sliding:
                columns += problem.sliding.by_unknowns(own, rod, state.rows)
            result[:, places[rod, TURN_AT]] = np.concatenate([columns, own[..., SIZE : SIZE + d]], axis=-1)
        for end, (at, sense) in enumerate(zip(ANGLES_AT, (-1.0, 1.0), strict=True)):
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
        turned = np.swapaxes(state.frames.axes[:, 1:], -1, -2) @ state.frames.turns[:, 1:]
        for body in range(problem.body_count):
            rows = problem.first_pose + POSE * body + np.arange(POSE)
            result[:, rows[:3], rows[:3]] = L[:, problem.rod_count + body, None] ** 2
            result[:, rows[3:, None], rows[3:]] = turned[:, body]
        return result
