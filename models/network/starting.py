"""Where the search begins: a network taken apart, put together at once, or put together elsewhere.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Joints, Loading, Starts, Together
from multirod.models.backbone.inputs import LOADS
from multirod.models.backbone.starts import APART
from multirod.models.network.elements.elements import GAP_AT
from multirod.models.network.elements.groups import ON_RODS
from multirod.models.network.joining.placing import placed
from multirod.models.network.poses import fixed_poses, pose_unknowns
from multirod.models.platform.starting.starts import crowded
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem

CLOSING = 6  # steps of Newton's method by which a network is put together at once
WIDEST = 3.0  # times the first of them, that any may be
CONTRACTION = 0.3  # largest ratio of Newton's steps that put a network together at once, as of those on a branch
BENDING = 0.1  # L^3/EI by which rods give way along themselves where they are bent to first order


@dataclass(frozen=True)
class Apart:
    """The network taken apart, at certain inputs.

    Attributes:
        inputs: Those that are no loads on bodies, (instance_count, k).
        unknowns: [1/m], shape (instance_count, n).
        residual: There, without loads [1/m], shape (instance_count, n).
        gamma: The numbers of ``Gamma`` there that are kept, shape (instance_count, k).
        turned: From the frames of the bases to those of what holds the tips, shape (instance_count, rod, 3, 3).
    """

    inputs: FloatArray
    unknowns: FloatArray
    residual: FloatArray
    gamma: FloatArray
    turned: FloatArray


def taken_apart(problem: "NetworkProblem", inputs: FloatArray) -> Apart:
    """The network taken apart; ``inputs`` are the present ones that are no loads on bodies."""
    with problem.closing.unloaded(), np.errstate(all="ignore"):
        x = np.zeros((problem.instance_count, problem.unknown_count))
        for group in problem.groups:
            own = group.backbones.guess().reshape(problem.instance_count, len(group.members), -1)
            x[:, problem.places[group.members][:, : own.shape[2]]] = own
        for at, end in zip(problem.layout.angles_at, problem.graph.ends, strict=True):
            _set_angles(problem, x, at, np.broadcast_to(end.table.rest, (problem.instance_count, *end.table.rest.shape)))
        problem.write("unknowns", x)
        problem.closing.soft[:] = 1.0
        problem.integrate()
        _place(problem, x)
        problem.write("unknowns", x)
        problem._assemble()
        gamma, (base, tip) = np.array(problem.closing.numbers()), problem.state().ends
        turned = problem.attachments[1][1] @ np.swapaxes(tip.frame, -1, -2) @ base.rotation
        return Apart(inputs, x, problem.read("residual"), gamma, turned)


def _place(problem: "NetworkProblem", x: FloatArray) -> None:
    """(13) Bodies by the rods as they were integrated, and the angles of joints at tips by both."""
    shape = (problem.instance_count, problem.rod_count)
    tip, turn = np.zeros((*shape, 3)), np.zeros((*shape, 3, 3))
    for group in problem.groups:
        tip[:, group.members], turn[:, group.members] = group.tips()
    driven = problem.read("inputs")[:, problem.driven_place] if problem.graph.is_driven else None
    placing = problem.graph.placing(problem.instance_count, problem.batch_shape, driven, fixed_poses(problem))
    position, rotation = placed(placing, tip, turn)
    moving = slice(1, 1 + problem.body_count)
    x[:, problem.first_pose :] = pose_unknowns(problem, position[:, moving], rotation[:, moving])
    problem.write("unknowns", x)
    base, end = problem.state().ends
    inward = np.swapaxes(end.frame, -1, -2)
    apart = base.position + (base.rotation @ tip[..., None])[..., 0] - end.position
    moved = (inward @ apart[..., None])[..., 0] + end.joints.moved
    _set_angles(problem, x, problem.layout.angles_at[1], problem.graph.ends[1].table.fitted(inward @ base.rotation @ turn, moved))


def _set_angles(problem: "NetworkProblem", x: FloatArray, at: slice, angles: FloatArray) -> None:
    """Angles (instance_count, rod, 3) as unknowns."""
    places = problem.places[:, at]
    rods, which = np.nonzero(places >= 0)
    x[:, places[rods, which]] = angles[:, rods, which] / problem.length[:, rods]


class NetworkStarts(Starts):
    """Of a ``NetworkProblem``; closed loops, so equilibria need not come in pairs."""

    def __init__(self, problem: "NetworkProblem") -> None:
        self.problem = problem

    @property
    def signs_add_up(self) -> bool:  # noqa: D102
        return False

    def guesses(self, count: int, first: int = 0) -> FloatArray:
        """Poses of the bodies around those of the network taken apart, and rods bent there to first order."""
        problem = self.problem
        x = problem.closing.apart().unknowns
        result = np.empty((count, *x.shape))
        for k, number in enumerate(range(first, first + count)):
            with problem.closing.unloaded():
                numbers = np.full(len(x), number)
                result[k] = problem.twisted(self._bent(moved(problem, x, numbers)), numbers)
        return result

    def _bent(self, x: FloatArray) -> FloatArray:
        """Rods by the linear answer of their tips, which give way a little along themselves."""
        problem = self.problem
        residual, gamma = problem.evaluate(x)
        for rod in range(problem.rod_count):
            own = problem.places[rod, : problem.graph.own[rod]]
            answer = gamma[:, own[:, None], own]
            answer[:, GAP_AT.stop - 1, problem.graph.along[rod]] += BENDING
            sound = np.isfinite(answer).all(axis=(1, 2)) & (np.linalg.det(np.nan_to_num(answer)) != 0)
            x[np.ix_(sound, own)] -= np.linalg.solve(answer[sound], residual[np.ix_(sound, own)][..., None])[..., 0]
        return x


def moved(problem: "NetworkProblem", x: FloatArray, numbers: IntArray) -> FloatArray:
    """Unknowns with the bodies aside by the entries ``numbers``, (instance_count,), of an endless sequence, each its own way."""
    result = np.array(x)
    L = problem.length[:, problem.rod_count :, None]
    for body in range(problem.body_count):
        at = slice(problem.first_pose + 6 * body, problem.first_pose + 6 * body + 6)
        result[:, at] += np.where(numbers[:, None] == 0, 0.0, crowded(numbers + APART * body)) / L[:, body]
    return result


class NetworkJoints(Joints):
    """Of a ``NetworkProblem``: each tip is joined to its body, or leaves a gap there."""

    def __init__(self, problem: "NetworkProblem") -> None:
        self.problem = problem

    def apart(self, numbers: IntArray | None = None) -> FloatArray:
        """Rods at rest and bodies as near to their ends as they can be, or around there."""
        problem = self.problem
        x = np.array(problem.closing.apart().unknowns)
        if numbers is None:
            return problem.guess()
        x = problem.twisted(moved(problem, x, np.asarray(numbers)), np.asarray(numbers))
        self.open(x)
        return x

    def open(self, unknowns: FloatArray) -> None:  # noqa: D102
        problem = self.problem
        self.shut()
        with problem.everyone(), problem.at_load(0.0):
            residual = problem.evaluate(unknowns)[0]
        problem.closing.open_at(unknowns, residual)

    def together(self) -> Together:
        """(30) By Newton's method from the network taken apart, where its steps soon become much shorter."""
        problem = self.problem
        apart = problem.closing.apart()
        step = problem.closing.newton_step(apart.gamma, apart.residual)
        unknowns, residual = np.array(apart.unknowns), np.zeros_like(apart.residual)
        first = before = np.linalg.norm(step, axis=1)
        sound, on = np.zeros(problem.instance_count, dtype=bool), np.isfinite(before)
        integrations = np.full(problem.instance_count, problem.guess_integrations)
        with problem.closing.unloaded(), np.errstate(all="ignore"):
            for _ in range(CLOSING):
                unknowns[on] += step[on]
                problem.write("unknowns", unknowns)
                with problem.only(on):
                    problem.integrate()
                found, faults = problem.read("residual"), problem.fault.numpy() != 0
                residual[on] = found[on]
                integrations += on
                step = problem.closing.newton_step(problem.closing.numbers(), found)
                size = np.linalg.norm(step, axis=1)
                sound |= on & ~faults & (size <= CONTRACTION * before)
                on &= ~faults & ~sound & (size <= WIDEST * first)
                before = size
                if not on.any():
                    break
        self.shut()
        problem.closing.opening[:] = np.where(sound[:, None], residual, 0.0)
        return Together(unknowns, sound, integrations)

    def close(self, loading: Loading) -> None:  # noqa: D102
        self.problem.closing.loading[:] = int(loading)

    def shut(self) -> None:  # noqa: D102
        problem = self.problem
        problem.closing.opening[:], problem.closing.soft[:], problem.closing.shift[:] = 0.0, 0.0, 0.0

    def unloaded_inputs(self) -> FloatArray | None:  # noqa: D102
        rows = self.problem.read("inputs")
        for name in (*(spec.name for spec in LOADS), "force", "moment", *ON_RODS):
            if name in self.problem._slices:
                rows[:, self.problem.input_slice(name)] = 0.0
        return rows
