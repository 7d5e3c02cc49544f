"""Rods in space under many loads against shooting by SciPy, with a rotation matrix and world stresses."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import multirod as mr

TIGHT = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-12, atol=1e-14))


def scene(seed):
    """Two or three sections of a rod, a base, and loads of about EI/L^2, all drawn by lot."""
    rng = np.random.default_rng(seed)
    sections = []
    for _ in range(2 + seed % 2):
        EI, GA = rng.uniform(0.02, 0.08, 2), rng.uniform(5, 20, 2)
        numbers = {
            "length": rng.uniform(0.1, 0.25),
            "bending_stiffness": tuple(EI),
            "torsional_stiffness": rng.uniform(0.02, 0.06),
            "precurvature": tuple(rng.uniform(-5, 5, 3)),
            "shear_stiffness": tuple(GA),
            "axial_stiffness": rng.uniform(10, 40),
            "linear_density": rng.uniform(0, 0.1),
        }
        sections.append(numbers)
    loads = {
        "tip_force": rng.uniform(-0.3, 0.3, 3),
        "tip_moment": rng.uniform(-0.05, 0.05, 3),
        "distributed_moment": rng.uniform(-0.1, 0.1, 3),
        "gravity": rng.uniform(-5, 5, 3),
    }
    return sections, loads, rng.uniform(-2, 2, 3), rng.uniform(-0.5, 0.5, 3)


def integrate(sections, loads, pose, m0):
    """World position, rotation and moment at the tip from the base moment, DESIGN's equations in world components."""
    weight = sum(s["length"] * s["linear_density"] for s in sections) * loads["gravity"]
    y = np.concatenate([pose[:3, 3], pose[:3, :3].ravel(), loads["tip_force"] + weight, m0])
    ends = np.cumsum([0, *(s["length"] for s in sections)])
    for section, span in zip(sections, pairwise(ends), strict=True):
        K = np.array([*section["bending_stiffness"], section["torsional_stiffness"]])
        S = np.array([*section["shear_stiffness"], section["axial_stiffness"]])

        def rate(s, y, section=section, K=K, S=S):
            R, n, m = y[3:12].reshape(3, 3), y[12:15], y[15:]
            u = section["precurvature"] + (R.T @ m) / K
            dp = R @ ([0, 0, 1] + (R.T @ n) / S)
            dR = R @ np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
            dn = -section["linear_density"] * loads["gravity"]
            return np.concatenate([dp, dR.ravel(), dn, -np.cross(dp, n) - loads["distributed_moment"]])

        y = solve_ivp(rate, span, y, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    return y[:3], y[3:12].reshape(3, 3), y[15:]


def shoot(sections, loads, pose):
    """Base moment by Newton's method with differences, the loads raised in ten steps."""
    m0 = np.zeros(3)
    for factor in np.linspace(0, 1, 11):
        raised = {name: factor * value for name, value in loads.items()}
        for _ in range(20):
            gap = integrate(sections, raised, pose, m0)[2] - raised["tip_moment"]
            if np.abs(gap).max() < 1e-12:
                break
            columns = [
                (integrate(sections, raised, pose, m0 + d)[2] - raised["tip_moment"] - gap) / 1e-6 for d in 1e-6 * np.eye(3)
            ]
            m0 = m0 - np.linalg.solve(np.transpose(columns), gap)
        else:
            pytest.fail("the independent solution does not converge")
    return m0


@pytest.mark.parametrize("seed", [2, 3, 4])
@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_random_rods(seed, make_pose):
    """Both at 1e-12 a step and residuals of 1e-12: 1e-8 covers what the columns, of size 1e2, make of it."""
    sections, loads, turn, place = scene(seed)
    pose = make_pose(turn, place)
    robot = mr.SingleRod(mr.Rod(sections=[mr.Section(**s) for s in sections]), base=pose)
    solution = mr.solve(robot, robot.inputs(**loads), solver=TIGHT).raise_if_failed()
    m0 = shoot(sections, loads, pose)
    position, rotation, _ = integrate(sections, loads, pose, m0)
    assert np.linalg.norm(position - pose[:3, 3] - sum(s["length"] for s in sections) * pose[:3, 2]) > 0.05  # it does bend
    np.testing.assert_allclose(solution.tip_position, position, rtol=0, atol=1e-8)
    np.testing.assert_allclose(solution.tip_rotation, rotation, rtol=0, atol=1e-8)
    K = [*sections[0]["bending_stiffness"], sections[0]["torsional_stiffness"]]
    strain = sections[0]["precurvature"] + (pose[:3, :3].T @ m0) / K
    scale = np.minimum(K, max(K[:2])) / K  # a rod stiffer in torsion than in bending has its unknown scaled by bending
    unknown = sections[0]["precurvature"] + (strain - sections[0]["precurvature"]) / scale
    np.testing.assert_allclose(solution.unknowns, unknown, rtol=0, atol=1e-7)
