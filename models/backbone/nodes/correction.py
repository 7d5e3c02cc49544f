"""How passes over nodes are held to the solve whose result they look at.

A pass over nodes ends stretches at nodes, so that its steps need not be those of the solve. Along a rod under a strong pull a
difference grows by ``exp(L sqrt(F / EI))``, and the same unknowns then lead elsewhere. Numbers in parentheses are those of
``docs/stability.md``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.nodes.node_pass import NodePass
from multirod.rotations import vectors
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

Again = Callable[[FloatArray, NDArray[np.bool_], bool], NodePass]

NEAR = 1e-3  # [rad], and of the length: what ends that near each other differ by is what the integration leaves of a shape
LOST = 0.1  # the same: what ends that far from the solve, corrected or not, is another shape
SETTLED = 1e-6  # the same: corrections that move the tip by less are not made
LONGEST_MOVE = 0.5  # the same: within that the tip moves about as its columns say
MOST_CORRECTIONS = 24


class Read(Protocol):
    """What has arrays to be read."""

    def read(self, name: str) -> FloatArray:
        """One of them."""
        ...


class Ends:
    """Where rods of a batch end.

    Args:
        position: In the world [m], shape (batch, 3).
        rotation: Body to world, shape (batch, 3, 3).
    """

    def __init__(self, position: FloatArray, rotation: FloatArray) -> None:
        self.position, self.rotation = position, rotation.reshape(-1, 3, 3)

    @classmethod
    def of(cls, source: Read) -> "Ends":
        """Of what has them to be read."""
        return cls(source.read("position"), source.read("rotation"))

    def apart(self, other: "Ends", length: FloatArray) -> FloatArray:
        """How far they are from others [rad], or parts of the length where that is more, shape (batch,); NaN where unknown."""
        change = self.rotation - other.rotation
        turned = np.sqrt((change * change).sum(axis=(1, 2)) / 8)  # the sine of half the angle
        with np.errstate(invalid="ignore"):
            angle = 2 * np.arcsin(np.minimum(turned, 1.0))
        return np.asarray(np.maximum(angle, np.linalg.norm(self.position - other.position, axis=1) / length))

    def surely_near(self, other: "Ends", length: FloatArray) -> bool:
        """Whether all are within ``NEAR`` because no number differs by more than a third of it: soon known, of most."""
        turned = np.abs(self.rotation - other.rotation).max(initial=0.0)
        moved = np.abs(self.position - other.position).max(initial=0.0)
        return bool(turned < NEAR / 3 and moved < NEAR / 3 * length.min(initial=np.inf))


@dataclass(frozen=True)
class Slopes:
    """How a pass changes with its unknowns: copies of what one by columns wrote."""

    gamma: FloatArray
    pose: FloatArray
    arclength: FloatArray
    rotations: FloatArray

    @classmethod
    def of(cls, made: NodePass) -> "Slopes":
        """Of a pass by columns."""
        names = ("gamma", "pose_columns", "column_arclength", "node_columns")
        return cls(*(np.array(made.read(name)) for name in names))


def held_to_solve(problem: "BackboneProblem", made: NodePass, again: Again, ran: NDArray[np.bool_]) -> NodePass:
    """The pass itself where it ends as the solve does; else one at unknowns that lead there by its own steps.

    (19) Newton's method, by columns of the pass, leaves the residual that the solve has at its unknowns; of a tip that is held,
    whose residual others know, the pose too. What does not come to end near the solve is lost: its outputs are NaN.

    Args:
        problem: Whose unknowns they are.
        made: A pass that ran.
        again: Launches one like it at other unknowns of some instances, with columns if that is asked for.
        ran: Instances that it ran over, shape (instance_count,).
    """
    length = problem.sizes.furthest_end()
    if Ends.of(made).surely_near(Ends.of(problem), length):
        return made
    far = ran & ~(Ends.of(made).apart(Ends.of(problem), length) < NEAR)
    if not far.any():
        return made
    solve = problem.nodes.bare(2, far)  # the records may be of other unknowns
    there = Ends.of(solve)
    far &= ~(Ends.of(made).apart(there, length) < NEAR)
    if not far.any():
        return made
    if problem.integrator.adaptive:  # which chooses steps by what states there are
        solve = problem.nodes.to_tip(far)
        there = Ends.of(solve)
    result = made
    if made.read("residual").shape[1] == solve.read("residual").shape[1]:
        correction = Correction(problem, solve, again)
        unknowns = problem.read("unknowns")
        correction.make(unknowns, far)
        if not made.columns:  # its steps may carry the force in another way than those with columns do
            slopes = Slopes.of(again(unknowns, far, True))
            unknowns = problem.read("unknowns")
            correction.make(unknowns, far, slopes)
        result = again(unknowns, ran, made.columns)
    lost = far & ~(Ends.of(result).apart(there, length) < LOST)
    if lost.any():
        result.lose(lost)
    return result


class Correction:
    """What makes passes over nodes end where the solve does.

    Args:
        problem: Whose unknowns they are.
        solve: Its ends.
        again: As ``held_to_solve`` has it.
    """

    def __init__(self, problem: "BackboneProblem", solve: NodePass, again: Again) -> None:
        self.problem, self.again = problem, again
        self.there, self.left = Ends.of(solve), np.array(solve.read("residual"))
        self.length = problem.sizes.furthest_end()

    def make(self, unknowns: FloatArray, chosen: NDArray[np.bool_], slopes: Slopes | None = None) -> None:
        """Change the unknowns of instances that are ``chosen``: of a pass by columns, or, by the ``slopes`` of one, without."""
        self._approach(unknowns, chosen.copy(), slopes)
        self._settle(unknowns, chosen.copy(), slopes)

    def _approach(self, unknowns: FloatArray, open_: NDArray[np.bool_], given: Slopes | None) -> None:
        """Bring single free rods near the solve all along, node by node from the base: a difference that has turned the tip over
        is still small where it began.

        The solve's own shape is known where its steps end: of a rod of one section.
        """
        problem, steps = self.problem, self.problem.integrator.steps
        if steps is None or len(problem.rods) > 1 or problem.unknown_count != 3:
            return
        shape = problem.nodes.bare(steps + 1, open_)
        open_ &= Ends.of(shape).apart(self.there, self.length) < NEAR
        places, frames = np.array(shape.read("node_arclength")), np.array(shape.read("node_rotation"))
        for _ in range(MOST_CORRECTIONS):
            if not open_.any():
                return
            found = self.again(unknowns, open_, given is None)
            slopes = given or Slopes.of(found)
            nodes, rotations = found.read("node_arclength"), found.read("node_rotation")
            for k in np.flatnonzero(open_):
                entries = [np.interp(nodes[k], places[k], entry) for entry in frames[k].reshape(-1, 9).T]
                own = np.array(entries).T.reshape(-1, 3, 3)
                turns = vectors(np.nan_to_num(own @ rotations[k].swapaxes(1, 2)))
                near = np.linalg.norm(turns, axis=1) < LONGEST_MOVE
                last = len(near) - 1 if near.all() else int(np.argmin(near)) - 1
                open_[k] = 0 < last < len(near) - 1
                if open_[k]:
                    place = int(np.nanargmin(np.abs(slopes.arclength[k] - nodes[k, last])))
                    unknowns[k] += np.linalg.lstsq(slopes.rotations[k, place], turns[last], rcond=None)[0]

    def _settle(self, unknowns: FloatArray, open_: NDArray[np.bool_], given: Slopes | None) -> None:
        """Newton's method, until the pass leaves what the solve does."""
        for _ in range(MOST_CORRECTIONS):
            if not open_.any():
                return
            found = self.again(unknowns, open_, given is None)
            slopes = given or Slopes.of(found)
            lacking, matrix = self.left - found.read("residual"), slopes.gamma
            if self.problem.held:
                here = Ends.of(found)
                turn = vectors(np.nan_to_num(self.there.rotation @ here.rotation.swapaxes(1, 2)))
                lacking = np.concatenate([lacking, self.there.position - here.position, turn], axis=1)
                matrix = np.concatenate([matrix, slopes.pose], axis=1)
            for values in (lacking, matrix, slopes.pose):
                open_ &= np.isfinite(values.reshape(len(open_), -1)).all(axis=1)
            for k in np.flatnonzero(open_):
                step = np.linalg.lstsq(matrix[k], lacking[k], rcond=None)[0]
                moved = np.abs(slopes.pose[k] @ step)
                move = max(moved[:3].max() / self.length[k], moved[3:].max())
                open_[k] = move > SETTLED
                if open_[k]:
                    unknowns[k] += min(1.0, LONGEST_MOVE / move) * step
