"""Where the search begins: a network taken apart, put together at once, or put together elsewhere.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import Joints, Loading, Starts, Together
from multirod.models.backbone.inputs import LOADS
from multirod.models.backbone.starts import APART, quasirandom
from multirod.models.joint_kernels import CLAMPED, REVOLUTE, SPHERICAL
from multirod.models.network.elements.elements import GAP_AT
from multirod.models.network.elements.groups import ON_RODS
from multirod.models.network.graph import PUSHED
from multirod.models.network.joining.placing import placed
from multirod.models.network.places import LOADED
from multirod.models.network.poses import fixed_poses, pose_unknowns
from multirod.models.platform.starting.guess import (
    COMPLIANCES,
    SHORT,
    Attachments,
    BeamEquilibrium,
    Legs,
    fitted_platform,
    tip_answers,
)
from multirod.models.platform.starting.starts import crowded
from multirod.status import BoolArray
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem
    from multirod.models.network.state import State

CLOSING = 6  # steps of Newton's method by which a network is put together at once
WIDEST = 3.0  # times the first of them, that any may be
CONTRACTION = 0.3  # largest ratio of Newton's steps that put a network together at once, as of those on a branch
JOINT_CODES = {0: CLAMPED, 1: REVOLUTE, 3: SPHERICAL}  # by the coordinates of a joint
BOW = 2.0  # rad of a whole rod, by which one between what does not move starts bent
BENDING = 0.1  # L^3/EI by which rods give way along themselves where they are bent to first order


@dataclass
class Apart:
    """The network taken apart, at certain inputs.

    Attributes:
        unknowns: [1/m], shape (instance_count, n).
        residual: There, without loads [1/m], shape (instance_count, n).
        gamma: The numbers of ``Gamma`` there that are kept, shape (instance_count, k).
        turned: From the frames of the bases to those of what holds the tips, shape (instance_count, rod, 3, 3).
        beams: How rods answer at their tips, where all bodies stand on rods that may be taken for beams.
        joined: The network put together from there, and what is left of the residual, as soon as that was found.
    """

    unknowns: FloatArray
    residual: FloatArray
    gamma: FloatArray
    turned: FloatArray
    beams: "Beams | None"
    joined: tuple[Together, FloatArray] | None = None


class Beams:
    """Rods at rest, as integrated, for equation (11) of ``docs/parallel.md``; in the frames of their bases, axes (instance, ...).

    Attributes:
        tip, turn: Position (..., rod, 3) and rotation (..., rod, 3, 3) of the tips.
        answers: ``tip_answers`` of each rod, shapes (..., m, 6) and (..., 6, 6).
        state: Of the network taken apart.
    """

    state: "State"

    def __init__(self, problem: "NetworkProblem") -> None:
        shape = problem.instance_count, problem.rod_count
        self.tip, self.turn = np.zeros((*shape, 3)), np.zeros((*shape, 3, 3))
        self.answers = [(np.zeros(0), np.zeros(0))] * problem.rod_count
        for group in problem.groups:
            self.tip[:, group.members], self.turn[:, group.members] = group.tips()
            unknowns, flexibility = tip_answers(group.backbones, (shape[0], len(group.members)))
            for place, rod in enumerate(group.members.tolist()):
                self.answers[rod] = unknowns[:, place], flexibility[:, place]

    def bent(self, problem: "NetworkProblem", x: FloatArray, compliance: float) -> FloatArray:
        """Unknowns of the network put together without loads, its rods beams that give way along themselves by ``compliance``
        [L^3/EI], from those of the network taken apart: body by body, as what stands on a body leaves no wrench on it."""
        x, table, state = np.array(x), problem.graph.ends[1].table, self.state
        for k, (body, rods) in enumerate(problem.graph.standing):
            if k:
                problem.write("unknowns", x)
                state = problem.state()
            base, poses = state.ends[0], state.frames
            legs = self._legs(problem, rods, base.position[:, rods], base.rotation[:, rods]).softened((compliance,))
            arm, frame = (values[:, rods] for values in problem.attachments[1])
            at = Attachments(arm, frame, np.array([JOINT_CODES[k] for k in table.count[rods].tolist()]), table.inner[rods, :, 0])
            shape = len(x), len(rods)
            beams = problem.tool((BeamEquilibrium, *shape), partial(BeamEquilibrium, *shape))
            position, rotation, added = beams.found(legs, at, *fitted_platform(legs, at))
            places, frames = poses.position[:, poses.moving].copy(), poses.rotation[:, poses.moving].copy()
            places[:, body], frames[:, body] = position, rotation
            x[:, problem.first_pose :] = pose_unknowns(problem, places, frames)
            for rod, change in zip(rods.tolist(), added, strict=True):
                x[:, problem.places[rod, : change.shape[1]]] += change
        if not table.free.any():
            return x
        problem.write("unknowns", x)
        base, end = problem.state().ends
        inward = np.swapaxes(end.frame, -1, -2)
        angles = table.fitted(inward @ base.rotation @ self.turn, np.zeros_like(self.tip))
        _set_angles(problem, x, problem.layout.angles_at[1], angles)
        return x

    def _legs(self, problem: "NetworkProblem", rods: NDArray[np.intp], position: FloatArray, rotation: FloatArray) -> Legs:
        """Some rods in the world, their bases at ``position`` and ``rotation``."""
        turns = np.zeros((*position.shape[:2], 6, 6))
        turns[..., :3, :3], turns[..., 3:, 3:] = rotation, rotation
        back = turns.swapaxes(-1, -2)
        flexibility = np.stack([self.answers[rod][1] for rod in rods.tolist()], axis=1)
        return Legs(
            position + (rotation @ self.tip[:, rods, :, None])[..., 0],
            rotation @ self.turn[:, rods],
            turns @ flexibility @ back,
            [self.answers[rod][0] @ back[:, k] for k, rod in enumerate(rods.tolist())],
            problem.length[:, rods],
            problem.stiffness[:, rods],
        )


def taken_apart(problem: "NetworkProblem") -> Apart:
    """The network taken apart at the present inputs, of which those that are no loads matter."""
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
        beams = Beams(problem) if problem.graph.standing else None
        state = _place(problem, x)
        if beams is not None:
            beams.state = state
        problem.write("unknowns", x)
        problem._assemble()
        gamma = np.array(problem.closing.numbers())
        return Apart(x, problem.read("residual"), gamma, _turned(problem, state), beams)


def _turned(problem: "NetworkProblem", state: "State") -> FloatArray:
    """``Apart.turned`` where bodies and bases are so."""
    base, tip = state.ends
    return np.asarray(problem.attachments[1][1] @ np.swapaxes(tip.frame, -1, -2) @ base.rotation)


def _place(problem: "NetworkProblem", x: FloatArray) -> "State":
    """(13) Bodies by the rods as they were integrated, and the angles of joints at tips by both; bodies and bases as they are
    then."""
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
    state = problem.state()
    base, end = state.ends
    inward = np.swapaxes(end.frame, -1, -2)
    apart = base.position + (base.rotation @ tip[..., None])[..., 0] - end.position
    moved = (inward @ apart[..., None])[..., 0] + end.joints.moved
    _set_angles(problem, x, problem.layout.angles_at[1], problem.graph.ends[1].table.fitted(inward @ base.rotation @ turn, moved))
    if not problem.graph.slides.count:
        return state
    problem.write("unknowns", x)
    return problem.state()  # the angle of a hole turns the base of the piece above it too


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
    """Unknowns with the bodies aside by the entries ``numbers``, (instance_count,), of an endless sequence, each its own way, and
    rods between what does not move bent."""
    result = np.array(x)
    L = problem.length[:, problem.rod_count :, None]
    for body in range(problem.body_count):
        at = slice(problem.first_pose + 6 * body, problem.first_pose + 6 * body + 6)
        result[:, at] += np.where(numbers[:, None] == 0, 0.0, crowded(numbers + APART * body)) / L[:, body]
    for rod in np.flatnonzero(problem.graph.held_still).tolist():
        bent = BOW * quasirandom(numbers + APART * (problem.body_count + rod), 2) / problem.length[:, rod, None]
        result[:, problem.places[rod, :2]] += np.where(numbers[:, None] == 0, 0.0, bent)
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
        problem.closing.open_at(unknowns, residual, _turned(problem, problem.state()))

    def together(self) -> Together:
        """Where rods are taken for beams; else (30), by Newton's method from the network taken apart, where its steps soon become
        much shorter."""
        problem, apart = self.problem, self.problem.closing.apart()
        if apart.joined is None:
            apart.joined = self._joined(apart)
        found, residual = apart.joined
        self.shut()
        problem.closing.opening[:] = np.where(found.sound[:, None], residual, 0.0)
        # who asks goes on from there in place
        return Together(*(values.copy() for values in vars(found).values()))

    def _joined(self, apart: Apart) -> tuple[Together, FloatArray]:
        """``Apart.joined``."""
        problem = self.problem
        unknowns, residual = np.array(apart.unknowns), np.zeros_like(apart.residual)
        step = problem.closing.newton_step(apart.gamma, apart.residual)
        first = np.linalg.norm(step, axis=1)
        sound = np.zeros(problem.instance_count, dtype=bool)
        integrations = np.full(problem.instance_count, problem.guess_integrations)
        with problem.closing.unloaded(), np.errstate(all="ignore"):
            # what shares torques that rods rigid in torsion do not answer gives way as beams alone
            rigid = any(group.backbones.sizes.rigid_in_torsion for group in problem.groups)
            far = self._as_beams(np.isfinite(first) | rigid, unknowns, residual, sound, integrations)
            self._by_newton(~sound & np.isfinite(first), step, unknowns, residual, sound, integrations)
        return Together(unknowns, sound, ~far, integrations), residual

    def _by_newton(
        self,
        on: BoolArray,
        step: FloatArray,
        unknowns: FloatArray,
        residual: FloatArray,
        sound: BoolArray,
        integrations: NDArray[np.int_],
    ) -> None:
        """(30) Of those that are ``on``, in place, from the network taken apart, of which ``step`` is the first."""
        problem = self.problem
        first = before = np.linalg.norm(step, axis=1)
        for _ in range(CLOSING):
            if not on.any():
                break
            unknowns[on] += step[on]
            problem.write("unknowns", unknowns)
            with problem.only(on):
                problem.integrate()
            found, faults = problem.read("residual"), problem.buffer("fault") != 0
            residual[on] = found[on]
            integrations += on
            step = problem.closing.newton_step(problem.closing.numbers(), found)
            size = np.linalg.norm(step, axis=1)
            sound |= on & ~faults & (size <= CONTRACTION * before)
            on = on & ~faults & ~sound & (size <= WIDEST * first)
            before = size

    def _as_beams(
        self, on: BoolArray, unknowns: FloatArray, residual: FloatArray, sound: BoolArray, integrations: NDArray[np.int_]
    ) -> BoolArray:
        """Rods as beams, of those that are ``on``, in place: those from which Newton's step is shortest, and none after one from
        which it is short, as ``ParallelRods`` does; of which it is not, shape (instance_count,)."""
        problem, apart = self.problem, self.problem.closing.apart()
        if apart.beams is None:
            return np.zeros_like(on)
        shortest = np.full(len(on), np.inf)
        for compliance in COMPLIANCES:
            if not on.any():
                break
            found = apart.beams.bent(problem, apart.unknowns, compliance)
            problem.write("unknowns", found)
            with problem.only(on):
                problem.integrate()
            left, faults = problem.read("residual"), problem.buffer("fault") != 0
            size = np.linalg.norm(problem.closing.newton_step(problem.closing.numbers(), left), axis=1)
            better = on & ~faults & (size < shortest)
            unknowns[better], residual[better], shortest[better] = found[better], left[better], size[better]
            integrations += on
            sound |= better
            on = on & ~(better & (size <= SHORT * np.linalg.norm(found, axis=1)))
        return on & sound

    def close(self, loading: Loading) -> None:  # noqa: D102
        self.problem.closing.loading[:] = int(loading)

    def shut(self, some: BoolArray | None = None) -> None:  # noqa: D102
        closing, every = self.problem.closing, slice(None) if some is None else some
        closing.opening[every], closing.soft[every], closing.shift[every] = 0.0, 0.0, 0.0

    def unloaded_inputs(self) -> FloatArray | None:  # noqa: D102
        rows = self.problem.read("inputs")
        for name in (*(spec.name for spec in LOADS), *LOADED, *PUSHED, *ON_RODS):
            if name in self.problem._slices:
                rows[:, self.problem.input_slice(name)] = 0.0
        return rows
