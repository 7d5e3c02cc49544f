"""What ends of rods do to what holds them, (23) and (24) of ``docs/model.md``: all that acts on a rod, a body, a robot adds up to
zero, and torques at bases are the slope of the potential."""

import numpy as np
import pytest
from conftest import rodrigues
from scipy.integrate import simpson
from test_network import BENT, circle, mixed
from test_network import GIVEN as ON_NETWORK
from test_sliding import GIVEN as ON_THREADED
from test_sliding import threaded
from test_tube_lines import GIVEN as ON_TUBES
from test_tube_lines import ROBOT as TUBES

import multirod as mr

CLOSE = 1e-9  # of the largest force, and of that times the length: what steps of 1e-12 and residuals of 1e-11 leave
EXACT = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-12, atol=1e-14))
NODES = 1201  # by which Simpson's rule takes the moment of what acts along a rod: its error is below 1e-11 of it
PLACE = np.eye(4)
PLACE[:3, :3], PLACE[:3, 3] = rodrigues((0.3, -0.2, 0.5)), (0.1, 0.2, -0.1)


def along(solution, rod, force, moment=(0, 0, 0)):
    """Force, and moment about the origin, of what acts along a rod [N/m, N], as functions of arclength or the same all along."""
    shape = solution.rod(rod, nodes=NODES)
    s = shape.arclength
    f, m = (np.stack([np.asarray(v(x) if callable(v) else v, float) for x in s]) for v in (force, moment))
    turning = np.cross(shape.position, f) + m
    pieces = np.split(np.arange(len(s)), 1 + np.flatnonzero(np.diff(s) <= 0))  # two nodes stand at each hole
    return [sum(simpson(values[own], x=s[own], axis=0) for own in pieces) for values in (f, turning)]


def hold_balance(wrenches, loads, length):
    """Wrenches on what holds a robot, and loads on it: force, and moment about the origin."""
    every = [(-w.force, -w.about((0, 0, 0)).moment) for w in wrenches] + [(np.asarray(f), np.asarray(m)) for f, m in loads]
    forces, moments = (np.array(values) for values in zip(*every, strict=True))
    size = np.linalg.norm(forces, axis=1).max()
    np.testing.assert_allclose(forces.sum(axis=0), 0, atol=CLOSE * size)
    np.testing.assert_allclose(moments.sum(axis=0), 0, atol=CLOSE * size * length)


def at(place, force, moment=(0, 0, 0)):
    return np.asarray(force, float), np.cross(place, force) + moment


def test_a_rod_hands_on_what_acts_at_its_tip(wire):
    robot, force = mr.SingleRod(wire), np.array([[1.0, 0.2, 0.1], [-0.5, 0.3, 2.0]])
    solution = mr.solve(robot, robot.inputs(tip_force=force), solver=EXACT)
    for k in range(2):
        hold_balance([solution[k].wrench(0, "base")], [at(solution[k].tip_position, force[k])], 0.4)
    found = solution.wrench()
    np.testing.assert_array_equal(found.position, 0)
    assert found.force.shape == found.moment.shape == found.about(solution.tip_position).moment.shape == (2, 3)
    np.testing.assert_allclose(solution.base_torque[:, 0], -found.moment[:, 2], rtol=1e-12)


def test_a_rod_with_lines_under_all_loads():
    """What pulls its lines stands on what holds the base: it is no load."""
    lines = [mr.Tendon(offset=(0.006, 0)), mr.PushRod(offset=(0, 0.005), axial_stiffness=2000.0, driven="displacement")]
    rod = mr.Rod(length=0.2, bending_stiffness=(0.02, 0.03), torsional_stiffness=0.015, linear_density=0.05, lines=lines)
    robot = mr.SingleRod(rod, base=PLACE)
    gravity, tip = np.array([1.0, 0, -9.81]), {"tip_force": (0.2, -0.1, 0.1), "tip_moment": (0.01, 0.02, -0.01)}

    def wind(s):
        return np.array([0.5 * s, 0.2, -s * s])

    inputs = robot.inputs(tension=2.0, displacement=1e-4, gravity=gravity, distributed_force=wind, rotation=0.3, **tip)
    solution = mr.solve(robot, inputs, solver=EXACT)
    assert np.abs(solution.tension).min() > 0.1
    loads = [
        at(solution.tip_position, tip["tip_force"], tip["tip_moment"]),
        along(solution, 0, lambda s: wind(s) + 0.05 * gravity),
    ]
    hold_balance([solution.wrench(0, "base")], loads, 0.2)


def test_tubes_count_together():
    solution = mr.solve(TUBES, TUBES.inputs(**ON_TUBES), solver=EXACT)
    found = solution.wrench("outer", "base")
    np.testing.assert_array_equal(found.moment, solution.wrench("inner").moment)
    hold_balance([found], [at(solution.tip_position, ON_TUBES["tip_force"])], 0.3)


@pytest.mark.parametrize("base_joint", ["clamped", "revolute"])
def test_a_held_rod(base_joint):
    """The load on its end is what its holder does not take: along a slide."""
    robot = mr.HeldRod(BENT, end=PLACE, slide=(0, 0, 1), joint="revolute", base_joint=base_joint)
    given = {
        "gravity": (0, 1, -9.81),
        "distributed_force": (0.1, 0.05, 0.2),
        "tip_force": (0.1, 0.2, -0.3),
        "tip_moment": (0, 0, 0.02),
    }
    solution = mr.solve(robot, robot.inputs(rotation=0.3, **given), solver=EXACT)
    assert not solution.failed
    ends = [solution.wrench(0, end) for end in ("base", "tip")]
    weight = 0.02 * np.array(given["gravity"]) + given["distributed_force"]
    loads = [along(solution, 0, weight), at(solution.tip_position, given["tip_force"], given["tip_moment"])]
    hold_balance(ends, loads, 0.4)
    np.testing.assert_allclose(ends[1].force, -solution.end_force, rtol=1e-12)
    np.testing.assert_allclose(PLACE[:3, 2] @ ends[1].force, 0, atol=CLOSE * np.linalg.norm(ends[0].force))


def test_legs_carry_their_platform():
    """Rods and tubes in each other, whose rods are counted leg by leg."""
    curved = {"bending_stiffness": 0.02, "torsional_stiffness": 0.015}
    pair = mr.ConcentricTubes(
        [mr.Rod(length=0.45, precurvature=(1, 0, 0), **curved), mr.Rod(length=0.35, precurvature=(0.5, 0, 0), **curved)]
    )
    rod = mr.Rod(length=0.38, linear_density=0.03, **curved)
    base, platform = circle((0, 120, 240), 0.08), circle((0, 120, 240), 0.05)
    robot = mr.ParallelRods(
        legs=[pair, rod, rod],
        base=base,
        platform=platform,
        joints=["clamped", "spherical", "clamped"],
        platform_mass=0.05,
        platform_centre=(0.01, 0, 0.02),
    )
    gravity, force, moment, point = np.array([1, 0, -9.81]), (0.3, -0.2, 0.1), (0.01, 0, 0.02), (0.02, 0.01, 0)
    given = {"tip_force": force, "tip_moment": moment, "gravity": gravity, "force_point": point}
    inputs = robot.inputs(rotation=(0.4, -0.2, 0, 0.1), translation=(-0.07, 0, 0, 0.01), **given)
    solution = mr.solve(robot, inputs, solver=EXACT)
    assert not solution.failed
    p, R = solution.tip_position, solution.tip_rotation
    weight = at(p + R @ [0.01, 0, 0.02], 0.05 * gravity)
    loads = [at(p + R @ point, force, moment), weight]
    tips = [solution.wrench(rod, "tip") for rod in (1, 2, 3)]
    for k, tip in enumerate(tips):
        np.testing.assert_allclose(tip.position, p + R @ platform[k, :3, 3], atol=1e-9)
    hold_balance([mr.Wrench(-tip.force, -tip.moment, tip.position) for tip in tips], loads, 0.4)
    np.testing.assert_allclose(tips[1].moment, 0, atol=CLOSE)
    hold_balance([solution.wrench(k) for k in (0, 2, 3)], [*loads, *(along(solution, k, 0.03 * gravity) for k in (2, 3))], 0.4)
    for leg in (2, 3):
        hold_balance([solution.wrench(leg, end) for end in ("base", "tip")], [along(solution, leg, 0.03 * gravity)], 0.4)


def hold_bodies(robot, solution, given):
    """Each body, by the wrenches of all that it holds; and all of the robot on the ground."""
    loads, on_ground = [], []
    gravity = np.array(given["gravity"])
    for body in (mr.ground, *robot.bodies):
        own = []
        for joint in (joint for joint in robot.joints if joint.to is body):
            holes = [other for other in robot.joints if other.rod == joint.rod and other.end == "along"]
            own.append(solution.wrench(joint.rod, holes.index(joint) if joint.end == "along" else joint.end))
        if body is mr.ground:
            on_ground = own
            continue
        p, R = solution.body_position(body.name), solution.body_rotation(body.name)
        zero = np.zeros(3)
        here = [at(p + R @ body.mass_centre, body.mass * gravity)]
        here.append(at(p, given["force"].get(body.name, zero), given.get("moment", {}).get(body.name, zero)))
        hold_balance([mr.Wrench(-w.force, -w.moment, w.position) for w in own], here, 0.4)
        loads += here
    for rod in robot.rods:
        force = np.array(given["distributed_force"]) + rod.sections[0].linear_density * gravity
        loads.append(along(solution, rod.name, force + np.array(given.get("rod_force", {}).get(rod.name, (0, 0, 0)))))
        if rod.name in given["force"]:
            tip = solution.rod(rod.name).position[-1]
            loads.append(at(tip, given["force"][rod.name], given.get("moment", {}).get(rod.name, np.zeros(3))))
    hold_balance(on_ground, loads, 0.4)


def test_bodies_of_a_network_are_in_equilibrium():
    robot = mixed()
    hold_bodies(robot, mr.solve(robot, robot.inputs(**ON_NETWORK), solver=EXACT), ON_NETWORK)


def test_holes_push_on_their_bodies():
    robot = threaded()
    hold_bodies(robot, mr.solve(robot, robot.inputs(**ON_THREADED), solver=EXACT), ON_THREADED)


def test_a_stub_is_a_hinge_of_a_body_on_the_ground():
    """A bar on a hinge and an upright wire, its weight in the middle: each bears half, and the hinge no moment about its axis."""
    short, high = 0.02, 0.3
    wire = mr.Rod.wire(length=high, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9)
    stiff = 50 * float(np.max(wire.sections[0].bending_stiffness))
    stub = mr.Rod(length=short, bending_stiffness=stiff, torsional_stiffness=stiff)
    bar = mr.Body("bar", mass=0.1, mass_centre=(0.1, 0, 0))
    foot, far = np.eye(4), np.eye(4)
    foot[2, 3], far[0, 3] = high - short, 0.2
    joints = [
        mr.Joint("stub", "base", to=mr.ground, pose=foot),
        mr.Joint("stub", "tip", to=bar, kind="revolute", axis=(0, 1, 0)),
        mr.Joint("wire", "base", to=mr.ground, pose=far),
        mr.Joint("wire", "tip", to=bar, pose=far, kind="spherical"),
    ]
    robot = mr.Network(rods={"stub": stub, "wire": wire}, bodies=[bar], joints=joints)
    solution = mr.solve(robot, robot.inputs(gravity=(0, 0, -9.81)))
    assert solution.status == mr.Status.CONVERGED
    assert solution.integrations < 20
    hinge = solution.wrench("stub", "tip")
    # what the default tolerance leaves of residuals
    np.testing.assert_allclose(hinge.force, (0, 0, 0.5 * 9.81 * 0.1), atol=1e-7)
    np.testing.assert_allclose(hinge.moment, 0, atol=1e-8)
    np.testing.assert_allclose(solution.joint_angle("stub tip"), 0, atol=1e-9)


def test_torques_at_bases_are_the_slope_of_the_potential(difference):
    """(24), of tubes behind their plate, rods and legs; turned off what would be symmetric."""
    stiff = {"bending_stiffness": 0.02, "torsional_stiffness": 0.015}
    inner, outer = (mr.Rod(length=length, precurvature=(bend, 0, 0), **stiff) for length, bend in ((0.3, 4.0), (0.2, 3.0)))
    legs = mr.ParallelRods(
        legs=[mr.Rod(length=0.3, precurvature=(1, 0, 0), **stiff)] * 3,
        base=circle((0, 120, 240), 0.08),
        platform=circle((0, 120, 240), 0.05),
    )
    behind = {"translation": (-0.05, -0.02)}
    for robot, rotation, more in (
        (mr.SingleRod(inner), np.array([0.3]), {}),
        (mr.ConcentricTubes([inner, outer]), np.array([0.7, -0.2]), behind),
        (
            mr.EccentricTubes([inner, outer], offsets=[(0.002, 0), (-0.002, 0)]),
            np.array([0.7, -0.2]),
            {"translation": (-0.05, -0.02)},
        ),
        (legs, np.array([0.3, -0.2, 0.1]), {}),
    ):

        def solved(angles, robot=robot, more=more):
            inputs = robot.inputs(rotation=angles, tip_force=(0.1, 0.05, -0.05), **more)
            return mr.solve(robot, inputs, solver=EXACT).raise_if_failed()

        for k, torque in enumerate(solved(rotation).base_torque):
            way = np.eye(len(rotation))[k]
            slope = difference(lambda t, way=way, solved=solved, rotation=rotation: solved(rotation + t * way).potential, 1e-2)
            assert abs(torque) > 1e-5
            # differences of the sixth order of energies right to 1e-13 J
            np.testing.assert_allclose(torque, slope, atol=1e-9)


def test_what_failed_is_no_number_and_time_comes_first(wire):
    robot = mr.HeldRod(wire)
    history = mr.simulate(robot, robot.inputs(end_position=[(0, 0, -0.01), (0, 0, -0.02), (0, 0, 0.5)]), time=[0, 1, 2])
    assert history.failed.tolist() == [False, False, True]
    found = history.wrench(0, "tip")
    np.testing.assert_array_equal(np.isnan(found.force).all(axis=1), history.failed)
    np.testing.assert_array_equal(found.force[1], history[1].wrench(0, "tip").force)
    np.testing.assert_array_equal(np.isnan(history.base_torque[:, 0]), history.failed)


def test_what_has_no_wrench_is_named(wire):
    robot = mr.SingleRod(wire)
    solution = mr.solve(robot, robot.inputs(tip_force=(1, 0, 0)))
    for end, said in (
        ("tip", "nothing holds the tip"),
        ("bas", "did you mean 'base'"),
        (0, "slides through no hole"),
        (None, "'base'"),
    ):
        with pytest.raises(ValueError, match=f"end = .*{said}"):
            solution.wrench(0, end)
    with pytest.raises(ValueError, match="rod = 1"):
        solution.wrench(1)
    with pytest.raises(ValueError, match="point"):
        solution.wrench().about((0, 0))
    with pytest.raises(AttributeError, match=r"wrench\(rod, end\)"):
        _ = solution.base_force
    assert "N m about (0, 0, 0) m" in repr(solution.wrench())
    pair = mr.EccentricTubes([wire, wire], offsets=[(0.002, 0), (-0.002, 0)])
    with pytest.raises(NotImplementedError, match="side by side"):
        _ = pair.backbones
