"""Tubes side by side: closed forms, concentric tubes, an integration by the energy alone, energy balance, refusals."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize, root

import multirod as mr
from multirod.results.differentiable import Equilibrium
from multirod.testing import check_assembly

FINE = mr.Shooting(integrator=mr.RK45(1e-11, 1e-12))
TUBES = [
    mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.016, precurvature=(3, 12, 1)),
    mr.Rod(length=0.17, bending_stiffness=0.05, torsional_stiffness=0.03, precurvature=(8, -4, 0.5)),
]
OFFSETS = ((0.003, 0.001), (-0.002, 0.002))
BASE = {"rotation": (0.4, 1.7), "translation": (-0.03, -0.02)}
LOADED = {**BASE, "tip_force": (0.3, -0.2, 0.1)}


@pytest.fixture(scope="module")
def robot():
    return mr.EccentricTubes(TUBES, OFFSETS)


@pytest.mark.parametrize("stored", ["13a_eccentric_planar_1", "13a_eccentric_planar_3"])
def test_planar_closed_form(stored, reference_cases):
    case = next(c for c in reference_cases("eccentric_bundle_planar") if c["id"] == stored)
    given, expected = case["inputs"], case["expected"]
    tubes = [
        mr.Rod(length=given["length"], bending_stiffness=EI, torsional_stiffness=EI / 1.3, precurvature=(0, k, 0))
        for EI, k in zip(given["EI"], given["precurvature"], strict=True)
    ]
    robot = mr.EccentricTubes(tubes, [(x, 0) for x in given["offset_x"]])
    solution = mr.solve(robot, robot.inputs(), solver=FINE)
    np.testing.assert_allclose(solution.tip_position, expected["tip_position"]["value"], atol=1e-12)
    np.testing.assert_allclose(solution.tip_rotation, expected["tip_rotation"]["value"], atol=1e-11)
    kappa = float(expected["kappa"]["value"])
    for k, x in enumerate(given["offset_x"]):
        own = kappa / (1 - kappa * x)
        assert solution.stability is mr.Stability.STABLE
        np.testing.assert_allclose(solution.rod(k, nodes=2).curvature, [(0, own, 0)] * 2, atol=1e-9)


@pytest.mark.parametrize("given", [BASE, LOADED], ids=["unloaded", "loaded"])
def test_without_offsets_they_are_concentric(given):
    """What keeps the line from twisting has nothing to do there, unless a moment twists the tip."""
    robot, other = mr.EccentricTubes(TUBES, np.zeros((2, 2))), mr.ConcentricTubes(TUBES)
    solution, expected = (mr.solve(r, r.inputs(**given), solver=FINE) for r in (robot, other))
    np.testing.assert_allclose(solution.tip_position, expected.tip_position, atol=1e-11)
    np.testing.assert_allclose(solution.energy, expected.energy, rtol=1e-10)
    for k in range(2):
        for name, error in {"position": 1e-11, "rotation": 1e-9, "curvature": 1e-8, "moment": 1e-9}.items():
            own, others = (getattr(s.rod(k, nodes=9), name) for s in (solution, expected))
            np.testing.assert_allclose(own, others, atol=error)
    for name in ("rotation", "translation", "tip_force"):
        J, K = (s.jacobian(name)[:3] for s in (solution, expected))
        np.testing.assert_allclose(J, K, atol=1e-10 * np.abs(K).max())


def density(u, theta, theta_s, tube, offset):
    """Energy per length of the line of one tube, (7o) as it is defined: bending and twisting of its own material."""
    lam = 1 + u[0] * offset[1] - u[1] * offset[0]
    x, y, z = tube.sections[0].precurvature
    c, s = np.cos(theta), np.sin(theta)
    own = (c * x - s * y, s * x + c * y)
    bending, torsion = tube.sections[0].bending_stiffness[0], tube.sections[0].torsional_stiffness
    bent = sum((u[j] / lam - own[j]) ** 2 for j in range(2))
    return lam * (bending * bent + torsion * (theta_s / lam - z) ** 2) / 2


def test_an_integration_by_the_energy_alone_ends_at_the_tip(robot):
    """Strains and torques from numerical derivatives of the energy, the moment of the line from statics: no equation of ours."""
    solution = mr.solve(robot, robot.inputs(**LOADED), solver=FINE)
    end, force = solution.tip_position, np.array(LOADED["tip_force"])
    ends = [tube.length + beta for tube, beta in zip(TUBES, BASE["translation"], strict=True)]
    tau = np.array([solution.rod(k).moment[0, 2] for k in range(2)])
    GJ = np.array([tube.sections[0].torsional_stiffness for tube in TUBES])
    twist = np.array([tube.sections[0].precurvature[2] for tube in TUBES]) + tau / GJ
    theta = np.array(BASE["rotation"]) - np.array(BASE["translation"]) * twist

    def gradient(q, theta, present):
        """dW/d(u, theta') and dW/dtheta at q = (u_x, u_y, theta'_0, theta'_1), by complex steps."""

        def total(q, theta):
            return sum(density(q[:2], theta[k], q[2 + k], TUBES[k], OFFSETS[k]) for k in range(2) if present[k])

        h = 1e-30
        by_q = [total(q + 1j * h * step, theta + 0j).imag / h for step in np.eye(4)]
        by_theta = [total(q + 0j, theta + 1j * h * step).imag / h for step in np.eye(2)]
        return np.array(by_q), np.array(by_theta)

    def rate(s, y, present, start):
        p, R, theta, tau = y[:3], y[3:12].reshape(3, 3), y[12:14], y[14:]
        M = R.T @ np.cross(end - p, force)
        right = np.concatenate([M[:2], np.where(present, tau, 0)])

        def lacking(q):
            return gradient(q, theta, present)[0] + np.concatenate([[0, 0], np.where(present, 0, q[2:])]) - right

        found = root(lacking, start["q"], tol=1e-13)
        start["q"] = q = found.x
        turn = np.array([[0, 0, q[1]], [0, 0, -q[0]], [-q[1], q[0], 0]])
        tau_s = np.where(present, gradient(q, theta, present)[1], 0)
        return np.concatenate([R[:, 2], (R @ turn).ravel(), np.where(present, q[2:], 0), tau_s])

    y, first = np.concatenate([np.zeros(3), np.eye(3).ravel(), theta, tau]), 0.0
    start = {"q": np.array([3.0, 3.0, 1.0, 1.0])}
    for last in sorted(ends):
        present = np.array([e >= last for e in ends])
        y = solve_ivp(rate, (first, last), y, args=(present, start), method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        first = last
    np.testing.assert_allclose(y[:3], end, atol=1e-10)
    np.testing.assert_allclose(y[3:12].reshape(3, 3), solution.tip_rotation, atol=1e-9)
    np.testing.assert_allclose(y[14:], 0, atol=1e-10)  # no torque at a free end


def test_energy_balance(robot):
    """What is stored changes by the work of the force and of the torques at the bases: shapes, torques and energy agree."""
    h = 1e-3
    rng = np.random.default_rng(5)
    turned, pulled = rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 3)

    def at(t):
        return robot.inputs(
            rotation=BASE["rotation"] + t * turned,
            translation=BASE["translation"],
            tip_force=LOADED["tip_force"] + 0.3 * t * pulled,
        )

    def change(h):
        near, far = (mr.solve(robot, at(t), solver=FINE) for t in (-h, h))
        force = np.array(LOADED["tip_force"])
        middle = mr.solve(robot, at(0.0), solver=FINE)
        # (7o): the torque at the base of a tube is that where it enters, as it is straight behind the plate
        torque = np.array([middle.rod(k).moment[0, 2] for k in range(2)])
        work = force @ (far.tip_position - near.tip_position) / (2 * h) - torque @ turned
        return (far.energy - near.energy) / (2 * h) - work, abs(work)

    (coarse, size), (fine, _) = change(h), change(h / 2)
    assert abs(4 * fine - coarse) / 3 < 1e-7 * size


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_a_tube_inside_a_bend_is_never_squeezed_to_nothing():
    """One tube would bend the line as tight as 120/m; the other, 20 mm inside, would have no length left at 50/m."""
    stiff, soft, rho = 1.0, 0.01, 0.02
    tubes = [
        mr.Rod(length=0.1, bending_stiffness=stiff, torsional_stiffness=100.0, precurvature=(0, 120, 0)),
        mr.Rod(length=0.1, bending_stiffness=soft, torsional_stiffness=100.0),
    ]
    robot = mr.EccentricTubes(tubes, [(0, 0), (rho, 0)])
    solution = mr.solve(robot, robot.inputs(), solver=FINE)

    def slope(kappa):
        lam = 1 - rho * kappa
        return stiff * (kappa - 120) + soft * (kappa / lam + rho * kappa**2 / (2 * lam**2))

    kappa = brentq(slope, 0, 0.9999 / rho, xtol=1e-13)
    expected = [(1 - np.cos(0.1 * kappa)) / kappa, 0, np.sin(0.1 * kappa) / kappa]
    np.testing.assert_allclose(solution.tip_position, expected, atol=1e-10)


def test_snapping_without_offsets_is_that_of_concentric_tubes():
    """Nearly opposite tubes beyond their fold: both find the stable equilibrium, and both refuse the symmetric one."""
    tubes = [mr.Rod(length=x, bending_stiffness=0.02, torsional_stiffness=0.016, precurvature=(12, 0, 0)) for x in (0.2, 0.18)]
    robot, other = mr.EccentricTubes(tubes, np.zeros((2, 2))), mr.ConcentricTubes(tubes)
    solution, expected = (mr.solve(r, r.inputs(rotation=(0, 3.5))) for r in (robot, other))
    assert solution.stability is expected.stability is mr.Stability.STABLE
    np.testing.assert_allclose(solution.energy, expected.energy, rtol=1e-8)
    opposite, others = (mr.solve(r, r.inputs(rotation=(0, np.pi)), guess=np.zeros(size)) for r, size in ((robot, 2), (other, 1)))
    assert opposite.stability is others.stability is mr.Stability.UNSTABLE
    np.testing.assert_allclose(opposite.energy, others.energy, rtol=1e-8)


@pytest.mark.parametrize(("part", "stability"), [(0.995, mr.Stability.UNSTABLE), (1.005, mr.Stability.STABLE)])
def test_where_a_bend_towards_a_tube_gives_way(part, stability):
    """A tube that bends another one on its inside would rather bend away from it.

    Without loads the strains follow the angles, by an energy V(theta); both twist by ``GJ theta'^2 / (2 lam)``. Clamped at the
    base and free at the tip, the plane shape is stable as long as ``(pi/2L)^2 GJ/lam + V''`` is positive.
    """
    length, EI, kappa, offsets = 0.15, (0.05, 0.02), (15.0, 6.0), ((0.0, 0.0), (0.006, 0.0))

    def energy(u, theta):
        total = 0.0
        for k in range(2):
            lam = 1 + u[0] * offsets[k][1] - u[1] * offsets[k][0]
            own = kappa[k] * np.array([-np.sin(theta[k]), np.cos(theta[k])])
            total += lam * EI[k] / 2 * np.sum((np.asarray(u) / lam - own) ** 2)
        return total

    def at_rest(theta):
        return minimize(energy, (0.0, 10.0), args=(theta,), method="BFGS", options={"gtol": 1e-11}).fun

    h = 0.02
    steps = np.eye(2) * h
    second = [[(at_rest(a + b) - at_rest(a - b) - at_rest(b - a) + at_rest(-a - b)) / (4 * h * h) for b in steps] for a in steps]
    bend = minimize(energy, (0.0, 10.0), args=(np.zeros(2),), method="BFGS", options={"gtol": 1e-11}).x
    lam = 1 - bend[1] * np.array(offsets)[:, 0]
    # both tubes have the same torsional stiffness: the least at which no eigenvalue of the sum is negative
    critical = -np.linalg.eigvals(np.diag(lam) @ second).real.min() * (2 * length / np.pi) ** 2
    tubes = [
        mr.Rod(length=length, bending_stiffness=EI[k], torsional_stiffness=part * critical, precurvature=(0, kappa[k], 0))
        for k in range(2)
    ]
    robot = mr.EccentricTubes(tubes, offsets)
    solution = mr.solve(robot, robot.inputs(), guess=np.zeros(2))
    np.testing.assert_allclose(solution.rod(0, nodes=2).curvature[:, 1], bend[1], rtol=1e-6)
    assert solution.stability is stability


def test_it_conforms(robot):
    """Derivatives by unknowns and inputs, every solver, batches: the tip is the line's, not a tube's."""
    check_assembly(robot, robot.inputs(**LOADED), tip_rod=None, vary=("tip_force", "rotation", "translation"))


def test_precurvature_may_be_a_function(difference):
    """(17o) with precurvature that moves with the tube: derivatives by translation are those of differences."""
    curved = mr.Rod(
        length=0.2, bending_stiffness=0.02, torsional_stiffness=0.016, precurvature=lambda s: (20 * s, 12 - 60 * s, 1 + 5 * s)
    )
    robot = mr.EccentricTubes([curved, TUBES[1]], OFFSETS)
    solution = mr.solve(robot, robot.inputs(**LOADED), solver=FINE)
    J = solution.jacobian("translation")[:3]

    def tip(k):
        def moved(t):
            beta = np.array(BASE["translation"])
            beta[k] += t
            return mr.solve(robot, robot.inputs(**{**LOADED, "translation": beta}), solver=FINE).tip_position

        return moved

    differences = np.stack([difference(tip(k), 2e-3) for k in range(2)], axis=-1)
    np.testing.assert_allclose(J, differences, atol=2e-8 * np.abs(J).max())


def test_one_tube_alone_bends_about_itself():
    """A precurved tube at an offset keeps its curvature, and the line beside it has another."""
    tube = mr.Rod(length=0.1, bending_stiffness=0.02, torsional_stiffness=0.016, precurvature=(0, 10, 0))
    robot = mr.EccentricTubes([tube], [(0.005, 0)])
    solution = mr.solve(robot, robot.inputs(), solver=FINE)
    kappa = 10 / (1 + 10 * 0.005)
    expected = [(1 - np.cos(0.1 * kappa)) / kappa, 0, np.sin(0.1 * kappa) / kappa]
    np.testing.assert_allclose(solution.tip_position, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"offsets": [(0, 0)]}, r"EccentricTubes.offsets = .*must be \(2, 2\)|EccentricTubes.offsets"),
        ({"offsets": [(0, np.nan), (0, 0)]}, r"EccentricTubes.offsets"),
        ({"tubes": []}, r"EccentricTubes.tubes = .* must be 1 to 6"),
        ({"tubes": [TUBES[0], mr.Rod(length=0.1, bending_stiffness=(1, 2), torsional_stiffness=1)]}, r"tubes\[1\] .*both axes"),
    ],
    ids=["too few offsets", "no number", "no tubes", "anisotropic"],
)
def test_refusals(change, message):
    with pytest.raises(ValueError, match=message):
        mr.EccentricTubes(**{"tubes": TUBES, "offsets": OFFSETS, **change})


def test_refused_inputs(robot):
    with pytest.raises(ValueError, match=r"translation\[1\] = 0.01 is not allowed: must be <= 0"):
        robot.inputs(translation=(0, 0.01))
    with pytest.raises((TypeError, ValueError), match="gravity"):
        robot.inputs(gravity=(0, 0, -9.81))


def test_stiffnesses_that_come_later_are_checked_too(robot):
    """Where tubes are functions of their stiffnesses, those that differ between the axes would be taken for the first."""
    given = np.array([[[0.02, 0.02]], [[0.05, 0.04]]])
    with pytest.raises(ValueError, match=r"EccentricTubes.tubes\[1\] .* must be the same about both axes"):
        Equilibrium(robot, "tip_position", robot.inputs(**BASE), None, None).solve({"bending_stiffness": given})
