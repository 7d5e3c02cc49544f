"""Whether the derivatives of an assembly are those of its residual and poses, by differences."""

from collections.abc import Callable
from typing import Any

import numpy as np

from multirod.problem import BoundaryProblem
from multirod.testing.study import CLOSE, STEP, Study, same
from multirod.validation import FloatArray


def _differences(function: Callable[[FloatArray], FloatArray], point: FloatArray, step: float) -> FloatArray:
    """Derivative by central differences, one column for each component."""
    columns = [(function(point + step * unit) - function(point - step * unit)) / (2 * step) for unit in np.eye(len(point))]
    return np.asarray(np.stack(columns, axis=-1))


def _pose_change(R: FloatArray, before: FloatArray) -> FloatArray:
    """Rotation vector, to first order, from one rotation (3, 3) to another, in the world."""
    turn = R @ before.T
    return np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2


def _pose_differences(
    problem: BoundaryProblem, evaluate: Callable[[FloatArray], Any], point: FloatArray, step: float
) -> FloatArray:
    """Columns (6, k) of the end effector's pose by differences of what ``evaluate`` leaves in the problem's buffers."""
    columns = []
    for unit in np.eye(len(point)):
        poses = []
        for side in (1, -1):
            evaluate(point + side * step * unit)
            poses.append((problem.read("position")[0], problem.read("rotation")[0].reshape(3, 3)))
        (p, R), (q, S) = poses
        columns.append(np.concatenate([p - q, _pose_change(R, S)]) / (2 * step))
    return np.stack(columns, axis=-1)


def derivatives(study: Study) -> None:
    """``Gamma`` and the pose's columns by the unknowns are those of the residual and the pose, at and off the equilibrium."""
    problem = study.problem(pose_sensitivities=True)
    scale = float(problem.curvature_scale()[0])
    for k, x in enumerate(study.near):
        where = "at the equilibrium" if k == 0 else "off the equilibrium"
        _, gamma = problem.evaluate(x[None])
        pose = np.array(problem.pose_columns.numpy())[0, :, : problem.unknown_count]

        def evaluate(y: FloatArray) -> FloatArray:
            return np.array(problem.evaluate(y[None])[0][0])

        same(f"Gamma {where}", gamma[0], _differences(evaluate, x, STEP * scale), CLOSE)
        by_difference = _pose_differences(problem, evaluate, x, STEP * scale)
        for rows, what in ((slice(0, 3), "position"), (slice(3, 6), "rotation")):
            same(f"pose_columns of the {what} {where}", pose[rows], by_difference[rows], CLOSE, 1e-9)


def input_derivatives(study: Study) -> None:
    """``input_columns`` are those of the residual and the pose by each input, the unknowns fixed."""
    for name in study.names:
        _columns_by(study, name)


def _columns_by(study: Study, name: str) -> None:
    options: dict[str, Any] = dict(study.robot.input_directions(name))
    problem = study.problem(pose_sensitivities=True, enabled=(name,), **options)
    x = problem.adopt(study.solution.unknowns[None])
    problem.write("unknowns", x)
    slopes, pose = problem.input_columns(name)
    row, place = problem.read("inputs"), problem.input_slice(name)
    step = STEP * max(1.0, float(np.abs(row[:, place]).max()))

    def evaluate(values: FloatArray) -> FloatArray:
        changed = row.copy()
        changed[:, place] = values
        problem.write("inputs", changed)
        return np.array(problem.evaluate(x)[0][0])

    same(f"the residual's columns by {name}", slopes[0], _differences(evaluate, row[0, place], step), CLOSE, 1e-8)
    by_difference = _pose_differences(problem, evaluate, row[0, place], step)
    same(f"the pose's columns by {name}", pose[0], by_difference, CLOSE, 1e-8)


def jacobian(study: Study) -> None:
    """``solution.jacobian`` is how the tip of solved equilibria moves with the inputs."""
    for name in study.names:
        given = study.solution.jacobian(name)
        size = given.shape[-1]
        value = np.asarray(getattr(study.inputs, name))
        step = 1e-4 * max(1e-2, float(np.abs(value).max()))
        units = np.concatenate([np.eye(size), -np.eye(size)]) * step
        start = None if name not in study.inputs.given else np.tile(study.solution.unknowns, (2 * size, 1))
        found = study.solve(study.changed(name, units), start).raise_if_failed()
        moved = (found.tip_position[:size] - found.tip_position[size:]) / (2 * step)
        turned = [_pose_change(found.tip_rotation[k], found.tip_rotation[size + k]) / (2 * step) for k in range(size)]
        expected = np.concatenate([moved, np.array(turned)], axis=1).T
        same(f"solution.jacobian({name!r})", given, expected, 1e-4, 1e-7)
