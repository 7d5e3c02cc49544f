"""Columns that integrations carry, against differences."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import multirod as mr


def check_exact_columns(robot: Any, given: mr.Inputs) -> None:
    """Of residual and tip by the unknowns, away from equilibrium, and by translations, which move what loads depend on."""
    options = robot.input_directions("translation")
    problem = robot.problem(given, integrator=mr.RK45(steps=20), pose_sensitivities=True, **options)
    x = problem.guess() + 0.3 * np.sin(1 + np.arange(problem.unknown_count))
    problem.write("unknowns", x)
    columns, pose = problem.input_columns("translation")
    _, gamma = problem.evaluate(x)
    unknown_pose = problem.pose_columns.numpy()[0, :3, : problem.unknown_count].copy()
    h = 1e-6
    for k, e in enumerate(np.eye(problem.unknown_count)):
        ahead, tip = problem.evaluate(x + h * e)[0], problem.read("position")
        behind, other = problem.evaluate(x - h * e)[0], problem.read("position")
        size = max(1.0, np.abs(gamma[0, :, k]).max())
        np.testing.assert_allclose(gamma[0, :, k], (ahead - behind)[0] / (2 * h), atol=1e-7 * size)
        np.testing.assert_allclose(unknown_pose[:, k], (tip - other)[0] / (2 * h), atol=1e-8)
    rows = problem.read("inputs")
    place = problem.input_slice("translation")
    for k in range(place.start, place.stop):
        ends = []
        for sign in (1, -1):
            changed = rows.copy()
            changed[:, k] += sign * h
            problem.write("inputs", changed)
            ends.append((problem.evaluate(x)[0], problem.read("position")))
        rate, moved = ((a - b)[0] / (2 * h) for a, b in zip(*ends, strict=True))
        np.testing.assert_allclose(columns[0, :, k - place.start], rate, atol=1e-6 * max(1.0, np.abs(rate).max()))
        np.testing.assert_allclose(pose[0, :3, k - place.start], moved, atol=1e-7)


def along_inputs(
    robot: Any, given: mr.Inputs, names: Sequence[str]
) -> tuple[Any, NDArray[np.float64], NDArray[np.float64], Callable[[float], NDArray[np.float64]]]:
    """Residual and tip position, one after the other, away from equilibrium along a way through some inputs: the problem, its
    unknowns, their rate by exact columns, and they themselves some way on."""
    options = {"pose_sensitivities": True, "enabled": names, **robot.input_directions(*names)}
    problem = robot.problem(given, integrator=mr.RK4(20), **options)
    x = problem.guess() + np.random.default_rng(3).standard_normal(problem.unknown_count)
    problem.write("unknowns", x)
    slopes, rows = problem.input_columns(*names)
    row, way = problem.read("inputs"), np.random.default_rng(4).standard_normal(slopes.shape[2])
    where = np.concatenate([np.arange(row.shape[1])[problem.input_slice(name)] for name in names])

    def moved(t: float) -> NDArray[np.float64]:
        changed = row.copy()
        changed[:, where] += t * way
        problem.write("inputs", changed)
        return np.concatenate([problem.evaluate(x)[0][0], problem.read("position")[0]])

    return problem, x, np.concatenate([slopes[0] @ way, rows[0, :3] @ way]), moved
