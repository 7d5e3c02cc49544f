"""Rods and bodies in a graph: against the robots that it makes anew, differences, and the balance of every body."""

import numpy as np
import pytest
from conftest import rodrigues
from test_check_assembly import check_assembly

import multirod as mr

RK4 = mr.RK4(50)
EXACT = mr.Shooting(tolerance=1e-11, integrator=RK4)
FINE = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(400))  # whose steps of a free rod and of a held one agree to 1e-11
LEG = mr.Rod.tube(length=0.4, outer_diameter=2e-3, young_modulus=200e9, shear_modulus=80e9, density=7850.0)
BASE_ANGLES, PLATE_ANGLES = (-10, 10, 110, 130, 230, 250), (-50, 50, 70, 170, 190, 290)
FORCE, GRAVITY = np.array([0.5, -0.3, -2.0]), np.array([0, 0, -9.81])


def pose(turn=(0, 0, 0), position=(0, 0, 0)):
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rodrigues(turn), position
    return result


def circle(degrees, radius):
    return np.array([pose(position=radius * np.array([np.cos(a), np.sin(a), 0])) for a in np.radians(degrees)])


def legs(count=6):
    return {f"leg {k}": LEG for k in range(count)}


def hexapod(kind="clamped", base=None):
    plate = mr.Body("plate", mass=0.1, mass_centre=(0.01, 0.02, 0.03))
    on_ground, on_plate = circle(BASE_ANGLES, 0.087), circle(PLATE_ANGLES, 0.087)
    joints = [mr.Joint(f"leg {k}", "base", to=mr.ground, pose=on_ground[k]) for k in range(6)]
    joints += [mr.Joint(f"leg {k}", "tip", to=plate, pose=on_plate[k], kind=kind) for k in range(6)]
    return mr.Network(rods=legs(), bodies=[plate], joints=joints, base=base)


def chain(rod, count):
    """A rod cut into pieces that are clamped to bodies without mass."""
    discs = [mr.Body(f"disc {k}") for k in range(count)]
    joints = []
    for k, disc in enumerate(discs):
        joints.append(mr.Joint(f"piece {k}", "base", to=discs[k - 1] if k else mr.ground))
        joints.append(mr.Joint(f"piece {k}", "tip", to=disc))
    return mr.Network(rods={f"piece {k}": rod for k in range(count)}, bodies=discs, joints=joints)


def test_one_rod_is_a_single_rod(wire):
    """Its tip free, or held by a body without mass."""
    single = mr.SingleRod(wire)
    expected = mr.solve(single, single.inputs(rotation=0.3, tip_force=(1, 0.2, 0.1), tip_moment=(0, 0.05, 0)), solver=FINE)
    tip = mr.Body("tip")
    joints = [mr.Joint("wire", "base", to=mr.ground), mr.Joint("wire", "tip", to=tip)]
    for robot in (
        mr.Network(rods={"wire": wire}, joints=joints[:1]),
        mr.Network(rods={"wire": wire}, bodies=[tip], joints=joints),
    ):
        found = mr.solve(robot, robot.inputs(rotation=0.3, force=(1, 0.2, 0.1), moment=(0, 0.05, 0)), solver=FINE)
        # the same steps of the same equations; residuals of 1e-11, and a tip that answers the base by less than one
        np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-11)
        np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, atol=1e-10)
        np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-9)
        np.testing.assert_allclose(found.rod("wire").moment, expected.rod(0).moment, atol=1e-9)
        assert found.stability is mr.Stability.UNKNOWN  # never said to be stable


@pytest.mark.parametrize("kind", ["clamped", "revolute", "spherical"])
def test_six_legs_are_parallel_rods(kind):
    parallel = mr.ParallelRods(
        legs=[LEG] * 6,
        base=circle(BASE_ANGLES, 0.087),
        platform=circle(PLATE_ANGLES, 0.087),
        joints=kind,
        joint_axes=(1, 0, 0),
        platform_mass=0.1,
        platform_centre=(0.01, 0.02, 0.03),
    )
    given = {"rotation": 0.2, "translation": np.array([0.01, 0, 0, -0.01, 0, 0.005]), "gravity": GRAVITY}
    expected = mr.solve(parallel, parallel.inputs(tip_force=FORCE, tip_moment=(0.01, 0, 0.02), **given), solver=EXACT)
    robot = hexapod(kind)
    found = mr.solve(robot, robot.inputs(force={"plate": FORCE}, moment=(0.01, 0, 0.02), **given), solver=EXACT)
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-10)
    np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, atol=1e-10)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-9)
    for k in range(6):
        for name in ("position", "rotation", "moment", "force"):
            values = getattr(expected.rod(k), name)
            np.testing.assert_allclose(getattr(found.rod(f"leg {k}"), name), values, rtol=1e-9, atol=1e-9)
    columns = found.jacobian("force", "rotation"), expected.jacobian("tip_force", "rotation")
    np.testing.assert_allclose(columns[0], columns[1], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("count", [2, 4, 8])
def test_a_chain_is_one_rod(count):
    whole = mr.Rod(length=0.4, bending_stiffness=(0.2233, 0.3), torsional_stiffness=0.0638, precurvature=(4, 2, 1), linear_density=0.05)
    piece = mr.Rod(
        length=0.4 / count,
        bending_stiffness=(0.2233, 0.3),
        torsional_stiffness=0.0638,
        precurvature=(4, 2, 1),
        linear_density=0.05,
    )
    single, robot = mr.SingleRod(whole), chain(piece, count)
    given = {"gravity": (0, 3.0, -9.81), "distributed_force": (0.5, 0.2, 0.1)}
    expected = mr.solve(single, single.inputs(tip_force=(0.8, 0.2, -0.5), **given), solver=FINE)
    steps = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(400 // count))
    found = mr.solve(robot, robot.inputs(force={f"disc {count - 1}": (0.8, 0.2, -0.5)}, **given), solver=steps)
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-9)
    np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, atol=1e-9)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-9)
    np.testing.assert_allclose(found.rod(0).moment[0], expected.rod(0).moment[0], atol=1e-9)


def test_a_rod_between_grounds_is_a_held_rod():
    rod = mr.Rod(length=0.4, bending_stiffness=(0.2233, 0.3), torsional_stiffness=0.0638, precurvature=(1.0, 0.3, 0.5), linear_density=0.02)
    end = pose((0.3, -0.2, 0.5), (0.07, 0.03, 0.32))
    for kind, base in (("clamped", "clamped"), ("spherical", "revolute"), ("revolute", "spherical")):
        axis = (0.6, 0, 0.8)
        held = mr.HeldRod(rod, end=end, joint=kind, joint_axis=axis, base_joint=base, base_joint_axis=axis)
        given = {"rotation": 0.3, "gravity": (0, 1, 2.0), "distributed_force": (0.2, 0.5, -0.1)}
        expected = mr.solve(held, held.inputs(**given), solver=EXACT)
        joints = [
            mr.Joint("rod", at, to=mr.ground, pose=where, kind=how, axis=axis if how == "revolute" else None)
            for at, where, how in (("base", np.eye(4), base), ("tip", end, kind))
        ]
        whisker = mr.Joint("whisker", "base", to=mr.ground)  # for there is to be an end effector
        robot = mr.Network(rods={"rod": rod, "whisker": rod}, joints=[*joints, whisker])
        found = mr.solve(robot, robot.inputs(**{**given, "rotation": {"rod": 0.3}}), solver=EXACT)
        assert found.status is expected.status is mr.Status.CONVERGED
        for name in ("position", "moment", "force"):
            np.testing.assert_allclose(getattr(found.rod("rod"), name), getattr(expected.rod(0), name), atol=1e-8)
