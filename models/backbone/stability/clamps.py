"""Rods clamped at places along them: every piece is integrated from the end of the one before it, and takes up a moment there.

Numbers in parentheses are those of ``docs/branches.md``.
"""

from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Clamps, Conjugates
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.tips import as_far, longest
from multirod.models.backbone.segments.chain import Chain
from multirod.rotations import from_quaternions, matrices
from multirod.status import BoolArray
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem


def clamped(backbones: "BackboneProblem") -> "ClampedBackbones":
    """The launch of backbones that are in pieces."""
    chain = backbones.launch
    assert isinstance(chain, ClampedBackbones)
    return chain


def moments_of_a_clamp(features: Features) -> int:
    """(8), (15) How many moments a clamp adds: that on all rods together, if they carry one, and the torque of each that turns
    against the frame."""
    return 3 * features.moment + features.torque_count


class ClampedBackbones:
    """Rods of a ``BackboneProblem`` with clamps, as its ``launch``: it leaves in the problem's buffers what that does.

    The moments of the clamps stand among the directions: so many columns of each instance, from a number of its own on. Each
    clamp has ``each``: that on all rods together, in the axes of the frame there, if they carry one, and the torque of each rod
    that turns against the frame. A rod that ends before a clamp is not held there: a spring of its own takes up that torque.

    Args:
        problem: With as many directions as all clamps have moments, and ``loads`` before them.
        pieces: Of each rod, clamps between them.
        first: Number of the first direction of each instance that is a moment of its own, shape (instance_count,).
        loads: Directions, from the first on, along which what acts along the rods changes.

    Attributes:
        each: Moments of one clamp.
        moments: That each clamp adds, over ``unit`` [1/m], shape (instance_count, pieces - 1, each).
        unit: Moment of one [N m^2], shape (instance_count, each).
        turned: How each clamp is turned, in its own axes, by the unknowns, along the ``loads``, then by the moments of all
            [rad m], shape (instance_count, pieces - 1, each, n + loads + each (pieces - 1)).
        moved: How it moves, in the world [m^2], likewise.
        frames: Of the rod at each clamp in the world, shape (instance_count, pieces - 1, 3, 3).
        places: Where it is [m], shape (instance_count, pieces - 1, 3).
    """

    def __init__(self, problem: "BackboneProblem", pieces: int, first: IntArray, loads: int = 0) -> None:
        self.problem, self.pieces, self.first, self.loads = problem, pieces, first, loads
        self._chain = chain = Chain(problem, loads)
        self._features, self._state, variations = chain.features, chain.state, chain.variations
        self._turn, d = variations.places["rotation"], variations.size
        self.each, every, states = moments_of_a_clamp(self._features), np.arange(d), np.arange(self._state.size)
        # in what of a state clamps add to, how that varies, and which variations these work on
        self._added = np.concatenate([states[self._state.places[name]] for name in ("moment", "torques")])
        self._varied = np.concatenate([every[variations.places[name]] for name in ("moment", "torques")])
        self._angles = every[variations.places["angles"]]
        self._worked = np.append(every[self._turn][: 3 * self._features.moment], self._angles[: self._features.torque_count])
        count = problem.instance_count
        self.unit = chain.units
        clamps, columns = pieces - 1, problem.unknown_count + loads + self.each * (pieces - 1)
        self.moments = np.zeros((count, clamps, self.each))
        self.turned, self.moved = np.zeros((count, clamps, self.each, columns)), np.zeros((count, clamps, 3, columns))
        self.frames, self.places = np.zeros((count, clamps, 3, 3)), np.zeros((count, clamps, 3))
        self._states = np.zeros((count, pieces, self._state.size))

    def _edges(self) -> tuple[FloatArray, BoolArray]:
        """Where pieces begin and end [m], shape (instance_count, pieces + 1), and which moments a clamp adds, the others being of
        rods that have ended, (instance_count, pieces - 1, each). Of several rods, clamps stand where two are, as what turns them
        against each other does."""
        ends = self.problem.sizes.ends()
        tip = of_two = ends.max(axis=1)
        if self._features.torque_count > 1 or (self._features.torque_count and not self._features.eccentric):
            of_two = np.minimum(ends[:, 0], np.sort(ends, axis=1)[:, -2])
        edges = np.linspace(0.0, 1.0, self.pieces + 1) * of_two[:, None]
        edges[:, -1] = tip
        there = np.ones((len(ends), self.pieces - 1, self.each), dtype=bool)
        if self._features.torque_count:
            torques = slice(3 * self._features.moment, None)
            own = ends[:, None, ends.shape[1] - self._features.torque_count :]
            there[..., torques] = np.logical_not(as_far(edges[:, 1:-1, None], own))
        return edges, there

    def set_dim(self, count: int) -> None:
        """All instances are integrated, however few are asked for."""

    @np.errstate(over="ignore", invalid="ignore")  # of rods that amplify without bound: who asks finds no equilibrium
    def launch(self) -> None:
        """One integration of all instances, a piece after another."""
        problem, chain, n = self.problem, self._chain, self.problem.unknown_count
        own, wrench = chain.call.problem, chain.call.wrench
        count, d = problem.instance_count, chain.variations.size
        chain.begin()
        scale = chain.scale
        edges, there = self._edges()
        state, frame_at = np.zeros((count, self._state.size)), self._state.places["frame"]
        columns = np.zeros((count, d, self.turned.shape[-1]))
        columns[:, chain.whole, range(n)] = 1.0
        moved = np.zeros((count, 3, columns.shape[2]))
        base = np.broadcast_to(problem.table.base_rotation.numpy(), (count, 3, 3))
        fault, taken = np.zeros(count, dtype=np.int32), np.zeros(count)
        for piece in range(self.pieces):
            last = piece == self.pieces - 1
            state, found, own_fault, own_taken = chain.over(state, edges[:, piece], edges[:, piece + 1], last=last)
            begin, fault, taken = columns, np.maximum(fault, own_fault), taken + own_taken
            onward = self._onward(found[:, d:], begin)
            moved = onward if self._features.loads_by_place else moved + onward
            columns = self._onward(found[:, :d], begin)
            if last:
                break
            self._states[:, piece], self.moved[:, piece] = state, base @ moved
            self.turned[:, piece] = columns[:, self._worked] * scale[:, None, None]
            held, first = there[:, piece], n + self.loads + self.each * piece
            state[:, self._added] += np.where(held, self.unit * self.moments[:, piece], 0.0)
            columns[:, self._varied, range(first, first + self.each)] += held
            self.turned[:, piece][~held] = 0.0
            self.turned[:, piece, range(self.each), range(first, first + self.each)] -= np.where(held, 0.0, scale[:, None])
        self._states[:, -1] = state
        frames = from_quaternions(self._states.reshape(-1, self._state.size)[:, frame_at]).reshape(count, -1, 3, 3)
        frames = base[:, None] @ frames
        position = problem.table.base_position.numpy()
        places = position[:, None] + np.einsum("bij,bkj->bki", base, self._states[:, :, self._state.places["position"]])
        self.frames, self.places, frame = frames[:, :-1], places[:, :-1], frames[:, -1]
        problem.write("position", places[:, -1])
        if self._features.turning_count:
            self._write_turned(frame, state, columns, base @ moved, scale)
        else:
            problem.write("rotation", frame.reshape(count, 9))
            turn = frame @ (columns[:, self._turn] * scale[:, None, None])
            problem.set_buffer("pose_columns", self._by_all(np.concatenate([base @ moved, turn], axis=1)))
        if problem.held:
            problem.tip_wrench.assign(wrench.values.numpy())
            problem.wrench_columns.assign(self._by_all(self._onward(wrench.columns.numpy(), begin)))
        if not problem.held or self._features.torque_count:
            problem.write("residual", own.residual.numpy())
            columns = np.concatenate([own.gamma.numpy(), own.residual_directions.numpy()[..., : self.loads]], axis=2)
            gamma = self._onward(columns, begin)
            problem.write("gamma", gamma[..., :n].reshape(count, n * n))
            problem.set_buffer("residual_directions", self._by_all(gamma)[..., n:])
        problem.set_buffer("fault", fault)
        problem.set_buffer("step_count", taken)

    def _write_turned(
        self, frame: FloatArray, state: FloatArray, columns: FloatArray, moved: FloatArray, scale: FloatArray
    ) -> None:
        """The pose of rods that turn against the frame: that of the one that ends at the tip, and how each turns so."""
        problem, count, given = self.problem, len(frame), 1 - self._features.eccentric  # of the rod whose frame it is
        angles = np.pad(state[:, self._state.places["angles"]], ((0, 0), (given, 0)))
        by_angles = np.pad(columns[:, self._angles] * scale[:, None, None], ((0, 0), (given, 0), (0, 0)))
        turn = columns[:, self._turn] * scale[:, None, None]
        if given:  # else it is the frame that ends at the tip
            own, rows = longest(problem.sizes.ends()), np.arange(count)
            turn[:, 2] += by_angles[rows, own]
            problem.write("rotation", (frame @ matrices(angles[rows, own, None] * [0.0, 0.0, 1.0])).reshape(count, 9))
        else:
            problem.write("rotation", frame.reshape(count, 9))
        result = np.zeros(problem.angle_columns.shape)
        result[..., :-1] = self._by_all(np.concatenate([moved, frame @ turn, by_angles[:, given:]], axis=1))
        result[:, 6:, -1] = angles[:, given:]
        problem.angle_columns.assign(result)

    def _onward(self, found: FloatArray, begin: FloatArray) -> FloatArray:
        """Columns at the end of a piece, which has ``found`` them by the state where it begins, then along the loads."""
        n, d = self.problem.unknown_count, begin.shape[1]
        result = found[..., :d] @ begin
        result[..., n : n + self.loads] += found[..., d:]
        return np.asarray(result)

    def _by_all(self, values: FloatArray) -> FloatArray:
        """Columns by unknowns, loads and moments as the problem has them: zero by the moments of other rods."""
        problem, n = self.problem, self.problem.unknown_count
        last = n + self.loads
        result = np.zeros((problem.instance_count, values.shape[1], n + problem.direction_count))
        result[..., :last] = values[..., :last]
        places = n + self.first[:, None] + np.arange(values.shape[2] - last)
        np.put_along_axis(result, np.broadcast_to(places[:, None], values[..., last:].shape), values[..., last:], axis=2)
        return result


class BackboneClamps(Clamps):
    """Of a ``BackboneProblem`` whose rod is in several pieces."""

    def __init__(self, problem: "BackboneProblem", chain: ClampedBackbones) -> None:
        self.problem, self._chain = problem, chain
        count, clamps = problem.instance_count, chain.pieces - 1
        self.size = chain.each * clamps
        self.unit = np.broadcast_to(chain.unit[:, None], (count, clamps, chain.each)).reshape(count, self.size)

    @property
    def first(self) -> IntArray:  # noqa: D102
        return np.arange(0, self.size, self._chain.each)

    @property
    def pairs(self) -> Conjugates:  # noqa: D102
        pairs = self.problem.conjugates
        assert pairs is not None  # of a free tip
        return pairs

    def put(self, moments: FloatArray) -> None:  # noqa: D102
        self._chain.moments[:] = moments.reshape(self._chain.moments.shape)

    def turned(self) -> FloatArray:  # noqa: D102
        return self._chain.turned.reshape(len(self.unit), self.size, -1)

    def moved(self) -> FloatArray:  # noqa: D102
        return self._chain.moved

    def frames(self) -> FloatArray:  # noqa: D102
        return self._chain.frames

    def places(self) -> FloatArray:
        """Where the clamps are [m], shape (instance_count, clamp, 3)."""
        return self._chain.places
