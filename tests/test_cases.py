"""Stored reference equilibria of one rod through the public contract."""

from contextlib import nullcontext

import numpy as np
import pytest
from meant import meant
from scipy.integrate import solve_ivp

import multirod as mr

LOADS = {
    "tip_force": "tip_force_world",
    "tip_moment": "tip_moment_world",
    "distributed_force": "distributed_force_world",
    "distributed_moment": "distributed_moment_world",
    "follower_force": "tip_force_material",
    "follower_moment": "tip_moment_material",
}
EXTREME = ("14a_big_force_a1e+06_psi1p571", "14c_torsion_ratio_1e+06")  # of which a user is warned
BUCKLED = ("04c_", "04e_", "07b_")  # stored: beyond a bifurcation, with the tip on the side of a positive x
TIGHT = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-12, atol=1e-14))


def pair(a, b):
    return a if a == b else (a, b)


def robot_and_inputs(case, make_pose):
    with meant() if case["id"] in EXTREME else nullcontext():
        return _robot_and_inputs(case, make_pose)


def _robot_and_inputs(case, make_pose):
    stored = case["inputs"]["rods"][0]
    K, S = stored["K"], stored["S"]
    more = {"shear_stiffness": pair(S[0], S[1]), "axial_stiffness": S[2]} if S else {}
    rod = mr.Rod(
        length=stored["length"],
        bending_stiffness=pair(K[0], K[1]),
        torsional_stiffness=K[2],
        precurvature=tuple(stored["u_star"]),
        **more,
    )
    base = case["inputs"]["base"]
    robot = mr.SingleRod(rod, base=make_pose(base["R0"], base["p0"]))
    loads = case["inputs"]["loads"]
    return robot, robot.inputs(**{name: loads[key] for name, key in LOADS.items() if np.any(loads.get(key) or 0)})


def errors(case, solution):
    """Tip position over length, tip rotation (a third of the norm), base moment over K/L or itself; and their abs_unc.

    The moment is compared where the shape needs no further kernel: under a tip wrench on a rod without shear.
    """
    stored, loads = case["inputs"]["rods"][0], case["inputs"]["loads"]
    length = stored["length"]
    found = {"tip_position": (solution.tip_position, length), "tip_rotation": (solution.tip_rotation, 3.0)}
    if np.any(loads["tip_force_world"]) and solution.inputs.given == ("tip_force",) and not stored["S"]:
        moment = np.array(case["inputs"]["base"]["R0"]) @ solution.rod(0).moment[0]
        scale = max(stored["K"]) / length
        found["base_moment"] = moment, max(scale, np.linalg.norm(case["expected"]["base_moment"]["value"]))
    result = {}
    for name, (value, scale) in found.items():
        expected = case["expected"][name]
        result[name] = np.linalg.norm(value - np.array(expected["value"])) / scale, expected["abs_unc"] / scale
    return result


def test_default_settings_solve_or_say_that_they_do_not(single_rod_case, make_pose):
    """1e-6 is what the default settings promise; a case may fail with a status, but only one that is not standard."""
    if single_rod_case["id"] == "14g_zero_torsion_planar":
        with pytest.raises(ValueError, match="torsional_stiffness"):
            robot_and_inputs(single_rod_case, make_pose)
        return
    robot, inputs = robot_and_inputs(single_rod_case, make_pose)
    solution = mr.solve(robot, inputs)
    buckled = single_rod_case["id"].startswith(BUCKLED)
    assert (solution.status is mr.Status.BIFURCATED) == buckled
    assert not buckled or solution.stability is mr.Stability.STABLE
    if solution.status not in (mr.Status.CONVERGED, mr.Status.MULTIPLE_SHOOTING, mr.Status.BIFURCATED):
        assert single_rod_case["difficulty"] != "standard"
        assert solution.status.failed
        assert np.isnan(solution.tip_position).all()
        return
    if single_rod_case["id"] == "05b_helix_terminal_wrench_a":  # stored: an equilibrium off the natural branch
        sharp = mr.solve(robot, inputs, solver=mr.Shooting(integrator=TIGHT.integrator), guess=solution).raise_if_failed()
        assert np.linalg.norm(solution.tip_position - sharp.tip_position) < 1e-6 * single_rod_case["inputs"]["rods"][0]["length"]
        assert np.linalg.norm(solution.tip_rotation - sharp.tip_rotation) < 3e-6
        check_equilibrium(single_rod_case, sharp)
        return
    if single_rod_case["id"] == "05b_helix_terminal_wrench_c":  # likewise; its natural branch is for test_multiple_shooting
        assert solution.status == mr.Status.MULTIPLE_SHOOTING
        return
    for name, (error, _) in errors(single_rod_case, solution).items():
        assert error < 1e-6, name


def test_tight_settings(single_rod_case, make_pose):
    """Residual 1e-11 1/m and steps of 1e-12 leave 1e-9 where the columns grow by 1e2 along the rod, as in all standard cases."""
    if single_rod_case["difficulty"] != "standard":
        pytest.skip("its columns grow by more")
    robot, inputs = robot_and_inputs(single_rod_case, make_pose)
    solution = mr.solve(robot, inputs, solver=TIGHT).raise_if_failed()
    for name, (error, uncertainty) in errors(single_rod_case, solution).items():
        assert error < 1e-9 + uncertainty, name


def check_equilibrium(case, solution):
    """The base moment, integrated by SciPy in world components, must lead to the tip, and to the applied tip moment there."""
    stored, base, loads = case["inputs"]["rods"][0], case["inputs"]["base"], case["inputs"]["loads"]
    force, moment = np.array(loads["tip_force_world"]), np.array(loads["tip_moment_world"])
    R0 = np.array(base["R0"])

    def rate(s, y):
        R, m = y[3:12].reshape(3, 3), y[12:]
        u = stored["u_star"] + R.T @ m / stored["K"]
        hat = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
        return np.concatenate([R[:, 2], (R @ hat).ravel(), -np.cross(R[:, 2], force)])

    base_moment = np.array(stored["K"]) * (solution.unknowns - stored["u_star"])
    start = np.concatenate([base["p0"], R0.ravel(), R0 @ base_moment])
    end = solve_ivp(rate, (0, stored["length"]), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    # Two integrations at 1e-12 from one base moment, whose difference grows by 1e4 on this looped branch.
    np.testing.assert_allclose(end[:3], solution.tip_position, rtol=0, atol=1e-8 * stored["length"])
    np.testing.assert_allclose(end[3:12].reshape(3, 3), solution.tip_rotation, rtol=0, atol=1e-8)
    np.testing.assert_allclose(end[12:], moment, rtol=0, atol=1e-8 * max(stored["K"]) / stored["length"])
