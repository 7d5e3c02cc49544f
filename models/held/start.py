"""Where the path of a held rod begins that is straight at rest and cannot give way there: bent to an arc, or as it buckles."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.held.held_kernels import ACROSS
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.held.problem import HeldProblem

ANGLE = 1.0  # of an arc [rad]
ASIDE = 0.3  # part of that across the plane in which the end moves: no symmetry lets a branch end on the way
SHORTENED = 0.3  # of its length, the most that a buckled rod begins with


def bent_rods(problem: "HeldProblem", unknowns: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(4) What is straight at rest, at ``unknowns`` (instance_count, n), bent.

    To an arc, by a moment at its end; as a clamped column buckles, where a turn about the axis of the base will cost nothing, or
    where it is a strip whose end is not turned across that axis; or, if its end is turned by more than ``ANGLE``, to an arc of
    that turn. It bends about the axis about which the end is turned, if that is across the axis of the base; else about the
    softer of its own axes, of two alike about y, so that the moment at the base of a column that buckles is about the positive
    axis.

    Returns:
        Unknowns, and whether the path leads straight from there to the end, shape (instance_count,).
    """
    L, m = problem.length[:, None], problem.rod.unknown_count
    turn = problem.read("inputs")[:, problem.input_slice("end_rotation")] + problem.table.rest_turn.numpy()
    across = np.einsum("bji,bj->bi", problem.base_frame, turn) * [1.0, 1.0, 0.0]
    size = np.linalg.norm(across, axis=1)[:, None]
    stiffness = problem.rod.each(problem.rod.arrays.material[:, 0, 0, :2])
    axis = np.where(stiffness[:, :1] < stiffness[:, 1:], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    turned = size > ACROSS
    axis = np.where(turned, across / np.maximum(size, ACROSS), -axis)
    aside = np.stack([axis[:, 1], -axis[:, 0], axis[:, 2]], axis=1)
    neutral = problem.goal_is_neutral()[:, None]
    direct = neutral & (size > ANGLE)
    base = np.broadcast_to(problem.rod.table.base_position.numpy(), axis.shape)
    # of a strip that begins aside of the plane in which it buckles, the path ends in an unstable state
    aligned = neutral | (~turned & (stiffness.max(axis=1) > stiffness.min(axis=1))[:, None])
    short = 1 - np.linalg.norm(problem.goal()[0] - base, axis=1)[:, None] / L
    # half the integral of the squared slope of the buckled shape
    buckled = 4 * np.pi * np.sqrt(np.clip(short, 0.0, SHORTENED))
    result = np.array(unknowns)
    bend = np.where(direct, across, np.where(aligned, -buckled * axis, ANGLE * (axis + ASIDE * aside))) / L
    result[:, :2] += bend[:, :2] * stiffness / problem.stiffness[:, None]
    thrust = 4 * np.pi**2 * stiffness.min(axis=1) / problem.stiffness / problem.length
    result[:, m - 1] -= np.where((aligned & ~direct)[:, 0], thrust, 0.0)
    return result, direct[:, 0]
