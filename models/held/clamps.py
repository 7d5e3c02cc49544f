"""A rod held at both ends, clamped at places along it, and what the residuals of its ends do work on.

Numbers in parentheses are those of ``docs/held.md``.
"""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from multirod.capabilities import Clamps, Conjugates
from multirod.kernels.warp_types import Array
from multirod.models.backbone.stability.clamps import BackboneClamps, ClampedBackbones
from multirod.models.held.kernels.arguments import ACROSS
from multirod.models.joint_kernels import REVOLUTE, SPHERICAL
from multirod.rotations import left_jacobian, matrices
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.held.problem import HeldProblem

FREE = {REVOLUTE: 1, SPHERICAL: 3}  # how many ways of turning a joint leaves open


class HeldConjugates(Conjugates):
    """Of a ``HeldProblem`` with the pose's columns: what joints leave free.

    The end's turn in its joint, (7), has the moment there as its force, and a turn of the base in its joint, (8), minus the
    moment at the base. The force along a slide, (5), is a condition as those of what does not move: a straight rod moves the end
    along it by what is of the second order alone.
    """

    def __init__(self, problem: "HeldProblem") -> None:
        self.problem = problem
        holders, count, n, m = problem.holders, problem.instance_count, problem.unknown_count, problem.rod.unknown_count
        self.turns = FREE.get(holders.joint, 0)
        self.forces = np.array([*range(6 - self.turns, 6), *range(m, n)], dtype=np.intp)
        shape = (count, len(self.forces))
        unit = np.broadcast_to(problem.stiffness[:, None], shape)
        self.unit: Array = wp.array(np.ascontiguousarray(unit), dtype=wp.float64, device=problem.device)
        self.scale: Array = wp.ones(shape, dtype=wp.float64, device=problem.device)
        self.columns: Array = wp.zeros((*shape, n + problem.direction_count), dtype=wp.float64, device=problem.device)
        self.stiffness = np.asarray(problem.rod.sizes.least_stiffness / problem.length)

    def update(self) -> None:  # noqa: D102
        problem, holders, m = self.problem, self.problem.holders, self.problem.rod.unknown_count
        columns = np.zeros(self.columns.shape)
        tip = problem.read("rotation").reshape(-1, 3, 3)
        axes = np.eye(3) if holders.joint == SPHERICAL else holders.axis[None]
        with np.errstate(invalid="ignore", over="ignore"):  # of points that are not fit
            columns[:, : self.turns] = axes[: self.turns] @ tip.swapaxes(1, 2) @ problem.pose_columns.numpy()[:, 3:]
            if problem.turns:
                x = problem.read("unknowns")[:, m:]
                J = left_jacobian(-problem.length[:, None] * x @ holders.base_axes)
                own = problem.length[:, None, None] * holders.base_axes @ J @ holders.base_axes.T
                columns[:, self.turns :, m : m + problem.turns] = -own
        self.columns.assign(columns)

    def guide(self) -> FloatArray:
        """Two directions across the slide, then the slide, in the world as columns, shape (instance_count, 3, 3)."""
        problem = self.problem
        level, turn = problem.load_factor.numpy()[:, None], problem.read("inputs")[:, problem.input_slice("end_rotation")]
        path = np.where(problem.table.direct.numpy()[:, None] != 0, 1.0, level)
        back = matrices((path - 1) * problem.table.rest_turn.numpy())
        return np.asarray(matrices(path * turn) @ back @ problem.end_frame @ problem.holders.guide)


class HeldClamps(Clamps):
    """Of a ``HeldProblem`` whose rod is in several pieces."""

    def __init__(self, problem: "HeldProblem", chain: ClampedBackbones) -> None:
        self.problem, self._own = problem, BackboneClamps(problem.rod, chain)
        self.size, self.unit = self._own.size, self._own.unit
        self._pairs = HeldConjugates(problem)

    @property
    def pairs(self) -> HeldConjugates:  # noqa: D102
        return self._pairs

    def put(self, moments: FloatArray) -> None:  # noqa: D102
        self._own.put(moments)

    def frames(self) -> FloatArray:  # noqa: D102
        return self._own.frames()

    def give(self) -> FloatArray:  # noqa: D102
        problem, n, m = self.problem, self.problem.unknown_count, self.problem.rod.unknown_count
        result = np.zeros((problem.instance_count, n, n))
        base = np.broadcast_to(problem.rod.table.base_rotation.numpy(), (len(result), 3, 3))
        held = 3 if problem.holders.slide is None else 2
        result[:, :held, m - 3 : m] = (self.pairs.guide().swapaxes(1, 2) @ base)[:, :held]
        return result

    def costless(self) -> tuple[FloatArray, FloatArray] | None:
        """As said: (10) of ``docs/branches.md``, and to where (11) here wants it."""
        problem = self.problem
        neutral = problem.goal_is_neutral()
        if not neutral.any():
            return None
        base, axis = problem.base_frame, problem.base_frame[:, None, :, 2]
        tip = problem.read("rotation").reshape(-1, 1, 3, 3)[:, : self.pairs.turns]  # of a ball, which alone turns here
        frames = np.concatenate([tip, self.frames()], axis=1)
        turns = np.einsum("bpji,bpj->bpi", frames, np.broadcast_to(axis, (*frames.shape[:2], 3))) - [0.0, 0.0, 1.0]
        unknowns, n = np.array(problem.read("unknowns")), problem.rod.unknown_count
        turn = problem.read("inputs")[:, problem.input_slice("end_rotation")] + problem.table.rest_turn.numpy()
        bend = np.einsum("bji,bj->bi", base, turn) * [1.0, 1.0, 0.0]
        bend = np.where(np.linalg.norm(bend, axis=1)[:, None] > ACROSS, bend, [0.0, 1.0, 0.0])
        # to the nearer of both
        along, across = (bend * unknowns[:, :3]).sum(axis=1), bend[:, 0] * unknowns[:, 1] - bend[:, 1] * unknowns[:, 0]
        angle = -np.arctan2(across * np.where(along < 0, -1, 1), np.abs(along))
        back = matrices(angle[:, None] * [0.0, 0.0, 1.0])
        for first in (0, n - 3):
            own = unknowns[:, first : first + 3]
            unknowns[:, first : first + 3] = np.where(neutral[:, None], np.einsum("bij,bj->bi", back, own), own)
        return np.where(neutral[:, None], turns.reshape(len(turns), -1), 0.0), unknowns

    def turned(self) -> FloatArray:  # noqa: D102
        problem, count = self.problem, self.problem.instance_count
        own = self._own.turned()
        result = self._by_unknowns(own.reshape(count, -1, 3, own.shape[-1]))
        axes = problem.turn_axes()[:, None]
        result[..., problem.rod.unknown_count : problem.unknown_count] = self.frames().swapaxes(2, 3) @ axes
        return result.reshape(count, self.size, -1)

    def moved(self) -> FloatArray:  # noqa: D102
        problem, m = self.problem, self.problem.rod.unknown_count
        result = self._by_unknowns(self._own.moved())
        arm = self._own.places() - np.broadcast_to(problem.rod.table.base_position.numpy(), (len(result), 3))[:, None]
        axes = problem.turn_axes().swapaxes(1, 2)
        result[..., m : problem.unknown_count] = np.cross(axes[:, None], arm[:, :, None]).swapaxes(2, 3)
        return result

    def _by_unknowns(self, values: FloatArray) -> FloatArray:
        """(6) Columns (..., m + size) by the unknowns of the rod, as by those of this, (..., n + size)."""
        problem, m, n = self.problem, self.problem.rod.unknown_count, self.problem.unknown_count
        angle = problem.load_factor.numpy()[:, None] * problem.read("inputs")[:, :1] * [0.0, 0.0, 1.0]
        back = matrices(angle).swapaxes(1, 2)[:, None]
        unit = problem.table.moment_unit.numpy()[:, None, :, None] * problem.stiffness[:, None, None, None]
        result = np.zeros((*values.shape[:-1], n + self.size))
        result[..., :3] = values[..., :3] @ (unit * back)
        result[..., 3 : m - 3] = values[..., 3 : m - 3]
        result[..., m - 3 : m] = values[..., m - 3 : m] @ back
        result[..., n:] = values[..., m:]
        return result
