"""(46) of ``docs/networks.md``: rods that turn about their own centreline though they are bent, as nothing resists it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.capabilities import LineTest, ResultTest
from multirod.inputs import Inputs
from multirod.models.network.joining.joints import MOST
from multirod.status import Status
from multirod.validation import FloatArray, refuse

if TYPE_CHECKING:
    from multirod.models.network.graph import Ends, Graph
    from multirod.models.network.problem import NetworkProblem

AXIS = 1 - 1e-9  # least cosine between the axis of a joint and the rod's own
BALANCED = 1e-9  # of the torques, that may be left of them
HELD = 1e-6  # turn in the springs that hold them, beyond which these have a torque [rad]
TURNED_BY = ("distributed_moment", "rod_moment")  # loads along rods


@dataclass(frozen=True)
class Turning:
    """One of them.

    Attributes:
        name: Of the rod.
        turned: By how much that turns the coordinates of joints that torques act on, shape (count,), of ``joint_torque``.
        joints: Names of the joints of these, shape (count,).
        held: The end, 0 or 1, the piece and the coordinate of the joint by which it is held.
    """

    name: str
    turned: FloatArray
    joints: NDArray[np.str_]
    held: tuple[int, int, int]


def hold_turning(graph: "Graph") -> tuple[Turning, ...]:
    """Hold all of them by springs, which have no torque where nothing turns them so."""
    joints, found = np.repeat(list(graph.pushed), list(graph.pushed.values())), []
    for whole, name in enumerate(graph.whole_names):
        pieces = graph.slides.of(whole)
        # the segments of a cable are clamped to each other, and turn together
        tips = pieces if graph.slides.sliding[pieces[0]] else pieces[-1:]
        ends = [(0, pieces[0]), *((1, rod) for rod in tips)]
        along = [_along(graph.ends[end], rod) for end, rod in ends]
        place = next((k for k in (0, len(ends) - 1) if graph.ends[ends[k][0]].table.count[ends[k][1]] < MOST), None)
        arrays = graph.arrays[pieces[0]]
        if place is None or any(np.linalg.norm(own) < AXIS for own in along) or not arrays.is_round:
            continue
        turned = np.zeros(len(joints))
        for own, (end, rod) in zip(along, ends, strict=True):
            at = graph.pushed_at[end][rod]
            told = (at >= 0) & (at < len(turned))
            turned[at[told]] += own[told]
        (end, rod), which = ends[place], int(np.abs(along[place]).argmax())
        graph.ends[end].table.stiffness[rod, which] = arrays.material[..., 0].mean() / arrays.end[:, 0, -1].mean()
        found.append(Turning(name, turned, joints, (end, rod, which)))
    return tuple(found)


def _along(own: "Ends", rod: int) -> FloatArray:
    """By how much a turn of a rod about itself turns the coordinates of the joint at one end, as far as these are free, (3,)."""
    table = own.table
    free = own.held[rod] & (table.stiffness[rod] == 0) & ~table.driven[rod] & ~table.slides[rod]
    last = table.outer[rod] if table.outer[rod].any() else table.inner[rod]  # what goes with the rod
    return np.asarray(last[2] * free)


def refuse_turning_on(rods: Sequence[Turning], inputs: Inputs) -> None:
    """Refuse, by a ``ValueError`` that names the joint, torques that turn a rod about itself, which nothing resists."""
    if not rods or not inputs.is_active("joint_torque"):
        return
    torques = inputs.joint_torque
    for rod in rods:
        if (np.abs(torques @ rod.turned) > BALANCED * np.abs(torques).max()).any():
            which = str(rod.joints[int(np.abs(rod.turned).argmax())])
            refuse(
                "joint_torque",
                {which: torques[..., rod.joints == which].tolist()},
                f"must not turn rod {rod.name!r} about itself: round and straight at rest, it is free to move so between its "
                "joints, and nothing holds it; clamp an end, or give a joint stiffness",
            )


class TurnTest(ResultTest):
    """Where what acts along rods turns one about itself a spring alone would hold it: there is no equilibrium.

    Args:
        problem: Whose.
        before: Another test, of whose results this is asked; None if there is none.
    """

    def __init__(self, problem: "NetworkProblem", before: ResultTest | None) -> None:
        self.problem, self.before = problem, before

    def refusals(self, settled: NDArray[np.bool_]) -> NDArray[np.int32]:  # noqa: D102
        problem, x = self.problem, self.problem.read("unknowns")
        turns = np.zeros(len(x), dtype=bool)
        for end, rod, which in (own.held for own in problem.graph.turning):
            turns |= np.abs(x[:, problem.places[rod, problem.layout.angles_at[end]][which]]) * problem.length[:, rod] > HELD
        refused = np.where(turns, Status.LOOSE, Status.NOT_RUN).astype(np.int32)
        if self.before is None:
            return refused
        known = self.before.refusals(settled)
        return np.where(known == Status.NOT_RUN, refused, known).astype(np.int32)


def result_test_of(problem: "NetworkProblem") -> ResultTest | None:
    """Of lines between discs, and of rods that may turn about themselves."""
    between_discs = any(group.backbones.features.discs and group.backbones.features.condition_count for group in problem.groups)
    lines = LineTest(problem.lines) if between_discs else None
    acts = any(name in problem.options["enabled"] or problem.inputs_given.is_active(name) for name in TURNED_BY)
    return TurnTest(problem, lines) if acts and problem.graph.turning else lines
