"""The seam for loads that depend on the configuration: loads that are not in the package, each a law and its numbers."""

import numpy as np
import pytest
from exact_columns import check_exact_columns
from own_loads import Drag, Spring
from scipy.integrate import solve_ivp

import multirod as mr

STIFFNESS, LENGTH = np.array([0.01, 0.015, 0.008]), 0.2
PRECISE = mr.Shooting(tolerance=1e-10, integrator=mr.RK45(rtol=1e-12, atol=1e-14))
FORCE = np.array([0.5, 0.3, -0.2])


def drag_acts(p, R, s, along=1.5, across=4.0):
    t = R[:, 2]
    return (along - across) * (t @ Drag.flow) * t + across * Drag.flow, np.zeros(3)


def spring_acts(p, R, s, stiffness=60.0, rest=0.03, keel=0.4):
    r = p - [0, 0, s]
    return stiffness * (rest / np.sqrt(r @ r + rest**2) - 1) * r, keel * np.cross(R[:, 0], [0, 1, 0])


def both_act(p, R, s):
    return tuple(sum(values) for values in zip(drag_acts(p, R, s), spring_acts(p, R, s), strict=True))


DRAG, SPRING = Drag(1.5, 4.0), Spring(60.0, 0.03, 0.4)
LAWS = {"drag": ((DRAG,), drag_acts), "springs and a keel": ((SPRING,), spring_acts), "both": ((DRAG, SPRING), both_act)}
U_STAR = np.array([4.0, -2.0, 1.0])


def rod(*loads: mr.Load, **properties) -> mr.Rod:
    basic = {"length": LENGTH, "bending_stiffness": STIFFNESS[:2], "torsional_stiffness": STIFFNESS[2], "loads": loads}
    return mr.Rod(**basic | {"precurvature": U_STAR} | properties)


@pytest.mark.parametrize("name", LAWS)
def test_equilibrium_is_that_of_an_independent_integration(name):
    loads, acts = LAWS[name]
    robot = mr.SingleRod(rod(*loads))
    solution = mr.solve(robot, robot.inputs(tip_force=FORCE), solver=PRECISE)
    assert solution.status == mr.Status.CONVERGED

    def rates(s, y):
        R, m, n = y[3:12].reshape(3, 3), y[12:15], y[15:]
        f, l = acts(y[:3], R, s)
        u = U_STAR + R.T @ m / STIFFNESS
        spin = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
        return np.concatenate([R[:, 2], (R @ spin).ravel(), -np.cross(R[:, 2], n) - l, -f])

    moment = STIFFNESS * (solution.unknowns[:3] - U_STAR)
    start = np.concatenate([np.zeros(3), np.eye(3).ravel(), moment, STIFFNESS[:2].max() / LENGTH * solution.unknowns[3:]])
    end = solve_ivp(rates, (0, LENGTH), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(end[15:], FORCE, atol=1e-8)
    np.testing.assert_allclose(end[12:15], 0, atol=1e-9)
    np.testing.assert_allclose(solution.tip_position, end[:3], atol=1e-10)
    free = mr.SingleRod(rod())
    assert np.linalg.norm(mr.solve(free, free.inputs(tip_force=FORCE)).tip_position - end[:3]) > 0.01  # the load does something


@pytest.mark.parametrize("name", ["drag", "both"])
def test_a_held_rod_is_that_of_an_independent_integration(name):
    loads, acts = LAWS[name]
    held = mr.HeldRod(rod(*loads, shear_stiffness=40.0, axial_stiffness=90.0))
    moved = held.inputs(end_position=(0.01, -0.02, -0.03), end_rotation=(0.2, 0, 0.1))
    solution = mr.solve(held, moved, solver=PRECISE).raise_if_failed()
    shape = solution.rod(0, nodes=2)

    def rates(s, y):
        R, m, n = y[3:12].reshape(3, 3), y[12:15], y[15:]
        f, l = acts(y[:3], R, s)
        u, v = U_STAR + R.T @ m / STIFFNESS, [0, 0, 1] + R.T @ n / [40.0, 40.0, 90.0]
        spin = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
        return np.concatenate([R @ v, (R @ spin).ravel(), -np.cross(R @ v, n) - l, -f])

    start = np.concatenate([np.zeros(3), np.eye(3).ravel(), shape.moment[0], shape.force[0]])
    end = solve_ivp(rates, (0, LENGTH), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(end[:3], solution.tip_position, atol=1e-9)
    np.testing.assert_allclose(end[15:], solution.end_force, atol=1e-7)
    assert str(solution.stability) in ("UNKNOWN", "UNSTABLE")  # neither is convex


def sheathed() -> mr.ConcentricTubes:
    """Tubes, each with a load of its own."""
    outer = rod(Drag(0.5, 1.0), length=0.14, bending_stiffness=0.03, torsional_stiffness=0.02, precurvature=(0, 9.0, 0))
    return mr.ConcentricTubes([rod(DRAG), outer])


SCENES = {
    "drag": (lambda: mr.SingleRod(rod(DRAG)), {"rotation": 0.3, "translation": 0.01}),
    "springs that shear": (
        lambda: mr.SingleRod(rod(SPRING, shear_stiffness=40.0, axial_stiffness=90.0)),
        {"rotation": 0.3, "translation": 0.01},
    ),
    "both": (lambda: mr.SingleRod(rod(DRAG, SPRING)), {"distributed_force": (0.1, 0.2, 0.3), "translation": 0.01}),
    "tubes": (sheathed, {"rotation": (0.3, 1.2), "translation": (-0.03, -0.01)}),
}


@pytest.mark.parametrize("name", SCENES)
def test_gamma_and_input_columns_are_exact(name):
    make, inputs = SCENES[name]
    robot = make()
    check_exact_columns(robot, robot.inputs(tip_force=FORCE, **inputs))


def test_segments_lead_to_where_shooting_does():
    """Of forces that depend on the frame alone, and on the place too."""
    for robot in (mr.SingleRod(rod(DRAG)), mr.SingleRod(rod(DRAG, SPRING))):
        inputs = robot.inputs(tip_force=FORCE, rotation=0.3)
        by_shooting, by_segments = (mr.solve(robot, inputs, solver=own) for own in (mr.Shooting(), mr.MultipleShooting()))
        np.testing.assert_allclose(by_segments.tip_position, by_shooting.tip_position, atol=1e-9)
        np.testing.assert_allclose(by_segments.jacobian("rotation"), by_shooting.jacobian("rotation"), atol=1e-7)


def test_energy_changes_with_the_force_by_the_tip():
    robot = mr.SingleRod(rod(SPRING))
    h = 1e-4

    def at(force):
        return mr.solve(robot, robot.inputs(tip_force=force), solver=PRECISE)

    tip = at(FORCE).tip_position
    slopes = [(at(FORCE + h * e).potential - at(FORCE - h * e).potential) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(slopes, -tip, atol=1e-7)


def test_a_batch_is_what_each_is_alone_and_single_precision_agrees():
    robot = mr.SingleRod(rod(DRAG, SPRING))
    forces = FORCE * np.linspace(-1, 1, 5)[:, None]
    batch = mr.solve(robot, robot.inputs(tip_force=forces))
    alone = mr.solve(robot, robot.inputs(tip_force=forces[1:2]))
    np.testing.assert_array_equal(batch.tip_position[1], alone.tip_position[0])
    single = mr.solve(robot, robot.inputs(tip_force=forces), solver=mr.Shooting(integrator=mr.RK4(50, precision="float32")))
    np.testing.assert_allclose(single.tip_position, batch.tip_position, atol=1e-5 * LENGTH)


def test_what_is_not_known_is_not_said():
    robot = mr.SingleRod(rod(DRAG))
    solution = mr.solve(robot, robot.inputs(tip_force=FORCE))
    assert str(solution.stability) == "UNKNOWN"
    assert np.isnan(solution.potential)


def test_where_loads_are_not_modelled_they_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"HeldRod.base_joint = .* a foundation or loads of its own turn with its base"):
        mr.HeldRod(rod(DRAG), end=np.eye(4), base_joint="spherical")
    with pytest.raises(ValueError, match=r"Rod.loads = .* must be one of each kind"):
        rod(DRAG, DRAG)
    with pytest.raises(ValueError, match=r"Rod.loads = .* must be a list of Load"):
        rod("drag")
    with pytest.raises(ValueError, match=r"no loads of other classes"):
        mr.SingleRod(rod(DRAG)).save(tmp_path / "robot.toml")
