"""Tendons of legs that hold a platform: derivatives, and the energy that says where all of it must be."""

import numpy as np
import pytest

import multirod as mr

PRECISE = mr.Shooting(tolerance=1e-10, integrator=mr.RK45(rtol=1e-11, atol=1e-13))
TENSION, FORCE = np.array([1.0, 0.5, 0.8]), np.array([0.3, 0.2, -0.4])
STEP = 1e-3


def leg(line: mr.Tendon) -> mr.Rod:
    return mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=[line])


def make_robot() -> mr.ParallelRods:
    angles = np.arange(3) * 2 * np.pi / 3
    base, platform = np.tile(np.eye(4), (2, 3, 1, 1))
    base[:, :2, 3] = 0.06 * np.stack([np.cos(angles), np.sin(angles)], 1)
    platform[:, :2, 3] = 0.03 * np.stack([np.cos(angles), np.sin(angles)], 1)
    routed = mr.Tendon(route=lambda s: (0.005 * np.cos(9 * s), 0.005 * np.sin(9 * s)), name="routed")
    lines = [mr.Tendon((0.006, 0)), mr.Tendon((0, 0.006), end=0.12), routed]
    return mr.ParallelRods(legs=[leg(line) for line in lines], base=base, platform=platform)


ROBOT = make_robot()


def solved(tension=TENSION, force=FORCE) -> mr.Solution:
    return mr.solve(ROBOT, ROBOT.inputs(tension=tension, tip_force=force), solver=PRECISE)


def test_derivatives_are_exact_and_the_energy_is_that_of_rods_loads_and_lines():
    solution = solved()
    assert solution.status == mr.Status.CONVERGED
    pose, slopes = solution.jacobian("tension"), []
    for k, e in enumerate(STEP * np.eye(3)):
        pulled = solved(TENSION + e), solved(TENSION - e)
        np.testing.assert_allclose(
            pose[:3, k], (pulled[0].tip_position - pulled[1].tip_position) / (2 * STEP), atol=1e-7 * np.abs(pose).max()
        )
        np.testing.assert_allclose((pulled[0].potential - pulled[1].potential) / (2 * STEP), solution.line_length[k], atol=1e-9)
        slopes.append((pulled[0].line_length - pulled[1].line_length) / (2 * STEP))
        pushed = solved(force=FORCE + e), solved(force=FORCE - e)
        np.testing.assert_allclose((pushed[0].potential - pushed[1].potential) / (2 * STEP), -solution.tip_position[k], atol=1e-9)
    np.testing.assert_allclose(np.array(slopes), np.transpose(slopes), atol=1e-11)
    by_tension = solution.jacobian("tension", of="line_length")
    np.testing.assert_allclose(by_tension, np.transpose(slopes), atol=1e-7 * np.abs(slopes).max())
    np.testing.assert_allclose(by_tension, by_tension.T, atol=1e-11 * np.abs(by_tension).max())
    # what a force does to the lengths is what tensions do to where it acts
    np.testing.assert_allclose(solution.jacobian("tip_force", of="line_length"), -pose[:3].T, atol=1e-10 * np.abs(pose).max())


def test_lengths_follow_legs_that_are_pushed_and_turned():
    there = {"rotation": np.array([0.1, -0.2, 0.3]), "translation": np.array([0.004, 0.0, -0.003]), "gravity": np.zeros(3)}

    def at(**given) -> mr.Solution:
        inputs = ROBOT.inputs(tension=TENSION, tip_force=FORCE, **(there | given))
        return mr.solve(ROBOT, inputs, solver=PRECISE).raise_if_failed()

    solution = at()
    for name, step in (("rotation", 1e-4), ("translation", 1e-5), ("tip_moment", 1e-4)):
        slopes = solution.jacobian(name, of="line_length")
        for k, e in enumerate(step * np.eye(3)):
            value = there.get(name, np.zeros(3))
            ahead, behind = (at(**{name: value + sign * e}).line_length for sign in (1, -1))
            np.testing.assert_allclose(slopes[:, k], (ahead - behind) / (2 * step), atol=1e-6 * np.abs(slopes).max())
    end = solution.line("routed", nodes=3).position[-1]
    shape = solution.rod(2, nodes=3)
    rho = 0.005 * np.array([np.cos(1.8), np.sin(1.8), 0])
    np.testing.assert_allclose(end, shape.position[-1] + shape.rotation[-1] @ rho, atol=1e-12)


def driven(*lines: mr.Tendon | mr.PushRod | mr.Chamber) -> mr.ParallelRods:
    """The same robot with other lines."""
    return mr.ParallelRods(legs=[leg(line) for line in lines], base=ROBOT.geometry.base, platform=ROBOT.geometry.platform)


def test_legs_are_driven_by_displacement_and_pressure_too():
    area = 1e-5
    elastic = mr.PushRod((0.006, 0), axial_stiffness=300.0)
    robot = driven(elastic, mr.Chamber((0, 0.006), end=0.12, area=area), mr.PushRod((0.004, 0.004)))
    pull, pressure = np.array([0.0006, -0.0003]), np.array([1e5])

    def at(pull=pull, pressure=pressure, force=FORCE) -> mr.Solution:
        return mr.solve(
            robot, robot.inputs(displacement=pull, pressure=pressure, tip_force=force), solver=PRECISE
        ).raise_if_failed()

    solution = at()
    # lengths are those that are given, and the tensions that were found do the same
    tension = solution.tension
    np.testing.assert_allclose(tension[1], -area * pressure[0], rtol=1e-12)
    taut = 0.2 - pull + np.array([0.2 / 300, 0]) * tension[[0, 2]]
    np.testing.assert_allclose(solution.line_length[[0, 2]], taut, rtol=1e-10)
    assert tension[0] > 0 > tension[2]
    # the tendon by a route, though it is straight: the kernel of ``ROBOT``
    straight = mr.Tendon(route=lambda s: (0.006 + 0 * s, 0 * s))
    twin = driven(straight, mr.Chamber((0, 0.006), end=0.12, area=area), mr.Chamber((0.004, 0.004), area=area))
    pushed = np.array([pressure[0], -tension[2] / area])
    other = mr.solve(twin, twin.inputs(tension=[tension[0]], pressure=pushed, tip_force=FORCE), solver=PRECISE).raise_if_failed()
    np.testing.assert_allclose(other.tip_position, solution.tip_position, atol=1e-10)
    # derivatives, and the work of who pulls
    pose, step = solution.jacobian("displacement"), 1e-6
    for k, e in enumerate(step * np.eye(2)):
        ahead, behind = at(pull + e), at(pull - e)
        np.testing.assert_allclose(pose[:3, k], (ahead.tip_position - behind.tip_position) / (2 * step), rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose((ahead.potential - behind.potential) / (2 * step), tension[[0, 2]][k], rtol=1e-5)
    ahead, behind = at(pressure=pressure + 10), at(pressure=pressure - 10)
    slope = solution.jacobian("pressure")[:3, 0]
    np.testing.assert_allclose(slope, (ahead.tip_position - behind.tip_position) / 20, rtol=1e-4)
    # what is held is as long as its displacement says: shorter by that, longer by what its tension stretches it
    lengths = solution.jacobian("displacement", of="line_length")
    by_pull = [(at(pull + e).line_length - at(pull - e).line_length) / (2 * step) for e in step * np.eye(2)]
    np.testing.assert_allclose(lengths, np.transpose(by_pull), atol=1e-5)
    np.testing.assert_allclose(lengths[2], [0, -1], atol=1e-10)
    # a robot whose lines are held is stiffer, and judged: a tension that is given takes nothing away from that
    assert solution.index == 0
    assert solution.stability_margin > other.stability_margin


def test_what_cannot_be_is_refused_by_name():
    with pytest.raises(ValueError, match=r"tension = .* is not allowed: must be >= 0"):
        ROBOT.inputs(tension=(1, -1, 0))
    with pytest.raises(ValueError, match=r"tension = .* is not allowed: .*must have shape \(\.\.\., 3\)"):
        ROBOT.inputs(tension=(1, 1))
