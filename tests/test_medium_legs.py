"""Legs and rods of networks in a medium and with loads of their own: an independent integration, columns on springs, energies."""

from itertools import pairwise

import numpy as np
import pytest
from conftest import rodrigues
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from test_check_assembly import check_assembly
from test_loads import DRAG, LENGTH, PRECISE, SPRING, STIFFNESS, U_STAR, both_act, rod, spring_acts
from test_network_branches import hold_forces_against_the_potential

import multirod as mr


def at(x=0.0, y=0.0, turn=(0, 0, 0)):
    pose = np.eye(4)
    pose[:3, :3], pose[:2, 3] = rodrigues(turn), (x, y)
    return pose


FEET = np.array([at(0.05, turn=(0, 0, 0.4)), at(-0.03, 0.04, (0.1, 0, 1.0)), at(-0.03, -0.04, (0, 0.1, -0.5))])
PLATE = np.array([at(0.04), at(-0.024, 0.032), at(-0.024, -0.032)])


def as_both(**robot):
    """Legs on a platform, and the same as a network; inputs by names of legs for either."""
    legs = mr.ParallelRods(**robot)
    network = mr.stacked(legs, names=["plate"])
    return {
        "legs": (legs, lambda force, **given: legs.inputs(tip_force=force, **given)),
        "network": (network, lambda force, **given: network.inputs(force={"plate": force}, **given)),
    }


@pytest.mark.parametrize("form", ["legs", "network"])
def test_legs_with_loads_of_their_own_are_those_of_an_independent_integration(form):
    """Each leg from the moment and force at its base, its loads along the axes of that: tips are on the plate, and carry it. Each
    has other loads, and one none."""
    legs = [(rod(SPRING), spring_acts), (rod(), lambda p, R, s: np.zeros((2, 3))), (rod(DRAG, SPRING), both_act)]
    robot, inputs = as_both(legs=[leg for leg, _ in legs], base=FEET, platform=PLATE)[form]
    force = np.array([0.2, -0.1, 0.3])
    solution = mr.solve(robot, inputs(force, rotation=(0.3, 0, -0.2)), solver=PRECISE).raise_if_failed()
    total = np.zeros(6)
    for k, (base, (_, acts)) in enumerate(zip(FEET, legs, strict=True)):
        shape, B = solution.rod(k, nodes=2), base[:3, :3]

        def rates(s, y, B=B, base=base, acts=acts):
            R, m, n = y[3:12].reshape(3, 3), y[12:15], y[15:]
            f, l = (B @ own for own in acts(B.T @ (y[:3] - base[:3, 3]), B.T @ R, s))
            u = U_STAR + R.T @ m / STIFFNESS
            spin = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
            return np.concatenate([R[:, 2], (R @ spin).ravel(), -np.cross(R[:, 2], n) - l, -f])

        R = shape.rotation[0]  # of the section, in whose axes moment and force are told
        start = np.concatenate([base[:3, 3], R.ravel(), R @ shape.moment[0], R @ shape.force[0]])
        end = solve_ivp(rates, (0, LENGTH), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        place = solution.tip_position + solution.tip_rotation @ PLATE[k, :3, 3]
        np.testing.assert_allclose(end[:3], place, atol=1e-9)
        np.testing.assert_allclose(end[3:12].reshape(3, 3), solution.tip_rotation @ PLATE[k, :3, :3], atol=1e-8)
        total += [*end[15:], *(end[12:15] + np.cross(place - solution.tip_position, end[15:]))]
    np.testing.assert_allclose(total, [*force, 0, 0, 0], atol=1e-7)
    assert solution.stability is mr.Stability.UNKNOWN  # neither load is convex


L, EI = 0.2, 0.02


def strip(k, **more):
    return mr.Rod(length=L, bending_stiffness=(0.5, EI), torsional_stiffness=0.015, foundation=(k, k, 0.0), **more)


def frame(k, **more):
    """Two upright strips that carry a beam, each in a medium."""
    poses = np.array([at(-0.1), at(0.1)])
    return as_both(legs=[strip(k, **more)] * 2, base=poses, platform=poses)


def sways_at(k: float) -> float:
    """The least load of both, ``EI w^(4) + P w^(2) + k w = 0``, clamped at the base, and at the top ``w' = w''' = 0``."""

    def lacking(P):
        roots = np.roots([EI, 0, P, 0, k]).astype(complex)
        start = np.exp(-np.abs(roots.real) * L)
        end = np.exp(roots * L - np.abs(roots.real) * L)
        rows = np.array([start, roots * start, roots * end, roots**3 * end])
        # over the determinant of powers of the roots it is smooth, and real
        return (np.linalg.det(rows) / np.linalg.det(np.vander(roots / abs(roots[0]), increasing=True).T)).real

    loads = np.linspace(0.2, 3, 3000) * (2 * np.sqrt(k * EI) + 20 * EI / L**2)
    values = [lacking(P) for P in loads]
    between = pairwise(zip(loads, values, strict=True))
    return 2 * next(brentq(lacking, a, b, xtol=1e-12) for (a, f), (b, g) in between if f * g < 0)


@pytest.mark.parametrize("k", [60.0, 600.0])
@pytest.mark.parametrize("form", ["legs", "network"])
def test_a_frame_sways_where_beams_on_springs_do(form, k):
    robot, inputs = frame(k)[form]
    (found,) = mr.critical_loads(robot, inputs((0, 0, -1.0)))
    assert found.load_factor == pytest.approx(sways_at(k), rel=2e-8)
    assert (found.index_before, found.index_after) == (0, 1)


@pytest.mark.parametrize("form", ["legs", "network"])
def test_a_frame_goes_on_where_it_sways(form):
    robot, inputs = frame(600.0)[form]
    solution = mr.solve(robot, inputs((0, 0, -1.02 * sways_at(600.0))))
    assert solution.status in (mr.Status.BIFURCATED, mr.Status.SNAPPED)
    assert solution.stability is mr.Stability.STABLE
    assert solution.events[0].load_factor == pytest.approx(1 / 1.02, rel=1e-6)  # the medium is there before the load


def test_the_form_of_legs_is_that_of_a_network():
    """(22b) of stability.md, a matrix of each leg, turned at its base, against columns of the graph; both are symmetric."""
    found = {}
    for form, (robot, inputs) in frame(60.0, precurvature=(0.5, 1.0, 0.3), linear_density=0.05).items():
        given = {"rotation": (0.3, -0.2), "gravity": (1.0, 0, -9.81)}
        found[form] = mr.solve(robot, inputs((0.5, 0.1, -5), **given), solver=PRECISE).raise_if_failed()
        assert found[form].stability is mr.Stability.STABLE
        assert found[form]._modes.uncertainty.max() < 1e-8
    np.testing.assert_allclose(found["legs"]._modes.values, found["network"]._modes.values, rtol=1e-8)
    np.testing.assert_allclose(found["legs"].tip_position, found["network"].tip_position, rtol=0, atol=1e-10)


@pytest.mark.parametrize("form", ["legs", "network"])
def test_derivatives_and_energy(form):
    """``check_assembly`` holds ``Gamma``, columns, potential and index against differences, and a batch against each alone."""
    robot, inputs = frame(60.0, precurvature=(0.5, 1.0, 0.3), linear_density=0.05)[form]
    given = inputs((0.3, 0.1, -2), rotation=(0.3, -0.2), translation=(0.004, 0), gravity=(1.0, 0, -9.81))
    vary = ("tip_force" if form == "legs" else "force", "translation", "gravity")
    check_assembly(robot, given, tip_rod=None, vary=vary, solvers=("shooting",))


def test_forces_of_a_network_are_the_slope_of_its_potential():
    """(25) of networks.md, in a medium."""
    robot, _ = frame(60.0, linear_density=0.05)["network"]
    hold_forces_against_the_potential(robot, {"force": {"plate": (0.3, 0.1, -2)}, "gravity": (1.0, 0, -9.81)}, push=0.02)


def on_a_hand(turned=(0, 0, 0)):
    """A strip that stands on a hand, in a medium, and one on the ground hold a body; its foot is turned about x of the foot."""
    hand = mr.Body("hand", pose=at(0.02, 0.01, (0.1, 0, 0.2)), fixed=True)
    top, foot = mr.Body("top", mass=0.02), at(-0.1, turn=(0, 0.1, 0)) @ at(turn=turned)
    joints = [mr.Joint("held", "base", to=hand, pose=foot), mr.Joint("held", "tip", to=top, pose=at(-0.1))]
    joints += [mr.Joint("other", "base", to=mr.ground, pose=at(0.1))]
    joints += [mr.Joint("other", "tip", to=top, pose=at(0.1), kind="spherical")]
    rods = dict.fromkeys(("held", "other"), strip(60.0, precurvature=(0.5, 1.0, 0.3), linear_density=0.05))
    return mr.Network(rods=rods, bodies=[hand, top], joints=joints), foot


ON_A_HAND = {
    "force": {"top": (0.3, 0.1, -1)},
    "fixed_position": {"hand": (0.005, 0, 0.002)},
    "fixed_rotation": {"hand": (0.1, 0.05, 0.2)},
    "rotation": {"held": 0.3},
    "gravity": (1.0, 0, -9.81),
}


def test_where_a_hand_turns_the_medium_does_and_weight_does_not(difference):
    """Columns by where it is, and by the pose of the joint there, against differences."""
    robot, foot = on_a_hand()
    inputs = robot.inputs(**ON_A_HAND)
    check_assembly(robot, inputs, tip_rod=None, vary=("fixed_position", "fixed_rotation", "rotation"), solvers=("shooting",))
    solver = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(100))
    found = mr.solve(robot, inputs, solver=solver).raise_if_failed()

    def turned(t):
        return mr.solve(on_a_hand((t, 0, 0))[0], inputs, solver=solver, guess=found).raise_if_failed().tip_position

    by = found.jacobian("joint_pose")[:3, 3:6] @ foot[:3, 0]
    np.testing.assert_allclose(by, difference(turned, 1e-2), rtol=0, atol=1e-8)


def test_a_base_that_moves_is_refused():
    """The medium would go with it, and push what it moves with."""
    body, embedded = mr.Body("body"), strip(60.0)
    plain = mr.Rod(length=L, bending_stiffness=EI, torsional_stiffness=0.015)
    mast = [mr.Joint("mast", "base", to=mr.ground), mr.Joint("mast", "tip", to=body)]
    for joint in (
        mr.Joint("strip", "base", to=body),
        mr.Joint("strip", "base", to=mr.ground, kind="revolute", axis=(0, 1, 0), stiffness=1.0),
    ):
        with pytest.raises(ValueError, match=r"Network.rods\['strip'\] .* must be clamped at its base to the ground"):
            mr.Network(rods={"mast": plain, "strip": embedded}, bodies=[body], joints=[*mast, joint])
