"""Every solver on networks, against ``Shooting``."""

import numpy as np
import pytest
from test_network import GIVEN, mixed
from test_network_rods import LINED, TUBES, at

import multirod as mr

E = {"young_modulus": 60e9, "shear_modulus": 23e9}
RK4 = mr.RK4(50)


@pytest.mark.parametrize("thick", [0.5e-3, 1.2e-3, 2e-3, 4e-3])
def test_soft_rods_beside_stiff_ones_are_not_near_a_fold(thick):
    """Stiffnesses differ by the fourth power of diameters, up to 4096: what is natural to the soft rod is no fold."""
    rods = {name: mr.Rod.wire(length=0.2, diameter=d, **E) for name, d in (("soft", 0.5e-3), ("stiff", thick))}
    joints = [mr.Joint(name, "base", to=mr.ground, pose=at(x=x)) for name, x in (("soft", 0.0), ("stiff", 0.1))]
    robot = mr.Network(rods=rods, joints=joints, end_effector="soft")
    inputs = robot.inputs(force={"soft": (1e-3, 0, 0)})
    expected, found = (mr.solve(robot, inputs, solver=s) for s in (mr.Shooting(integrator=RK4), mr.EnergyDescent(integrator=RK4)))
    assert found.status is mr.Status.CONVERGED
    # both to residuals of 1e-9 of K/L at most, in metres of a rod of 0.2 m
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-8)


def test_what_buckles_is_near_a_fold():
    """The threshold counts in units of the unloaded network: a column close to its critical load is told."""
    rod = mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077)
    robot = mr.Network(rods={"arm": rod}, joints=[mr.Joint("arm", "base", to=mr.ground)])
    critical = np.pi**2 / 4 * 0.01 / 0.2**2
    for part, expected in ((0.8, mr.Status.CONVERGED), (0.98, mr.Status.BRANCH_END)):
        solution = mr.solve(robot, robot.inputs(force=(0, 0, -part * critical)), solver=mr.EnergyDescent(integrator=RK4))
        assert solution.status is expected, part


def test_multiple_shooting_says_why_it_refuses_networks():
    robot, given = of_a_hole()
    with pytest.raises(ValueError, match=r"it is a network: cut its rods by mr.Network\(..., segments="):
        mr.solve(robot, robot.inputs(**given), solver=mr.MultipleShooting())


def of_joints():
    robot = mixed()
    return robot, GIVEN


def of_tubes_and_lines():
    rods = {"arm": TUBES, "finger": LINED}
    joints = [mr.Joint(name, "base", to=mr.ground, pose=at(x=0.1 * k)) for k, name in enumerate(rods)]
    given = {"tension": {"finger": 0.8}, "pressure": {"finger": 1e4}, "translation": {"arm": (-0.05, -0.02)}}
    return mr.Network(rods=rods, joints=joints), given | {"rotation": {"arm": (0.4, -0.2)}, "force": {"arm": (0.02, 0.03, 0.1)}}


def of_a_hole():
    wire = mr.Rod.wire(length=0.3, diameter=1e-3, extensible=True, **E)
    disc = mr.Body("disc")
    joints = [mr.Joint(name, "base", to=mr.ground, pose=at(x=x)) for name, x in (("post", 0.0), ("slider", 0.02))]
    joints.append(mr.Joint("post", "tip", to=disc))
    joints.append(mr.Joint("slider", "along", at=0.2, to=disc, pose=at(x=0.02), kind="prismatic"))
    post = mr.Rod.wire(length=0.2, diameter=1e-3, extensible=True, **E)
    return mr.Network(rods={"post": post, "slider": wire}, bodies=[disc], joints=joints), {"force": {"disc": (0.05, 0.02, 0)}}


def of_discs(count=2):
    """Rods between holes hardly stretch: the least singular value is 1e-5 of the largest, and no fold is near."""
    inner = mr.Rod.wire(length=0.1, diameter=1e-3, **E)
    beside = [mr.Rod.wire(length=0.1, diameter=0.8e-3, extensible=True, **E)] * 3
    offsets = [(0.004, 0), (-0.002, 0.002 * np.sqrt(3)), (-0.002, -0.002 * np.sqrt(3))]
    robot = mr.multibackbone(inner, beside, offsets=offsets, discs=count)
    return robot, {"translation": {"rod 0": 0.002, "rod 1": -0.001, "rod 2": -0.001}, "force": {f"disc {count}": (0.2, 0, -0.2)}}


SOLVERS = {
    "observer": mr.Observer(integrator=RK4),
    "observer per rod": mr.Observer(coupling="per-rod", integrator=RK4),
    "energy descent": mr.EnergyDescent(integrator=RK4),
    "slow energy descent": mr.EnergyDescent(integrator=RK4, ramp=1000, max_iterations=2000),
}


CASES = [(network, name) for network in (of_joints, of_tubes_and_lines, of_a_hole) for name in list(SOLVERS)[:3]]


def of_one_disc():
    """Four rods side by side: what their ends give way by at 0.99 of the load is more than they do. In a hundred samples energy
    descent would take steps as long as near a fold."""
    return of_discs(1)


DISCS = [(of_one_disc, "observer"), (of_one_disc, "slow energy descent"), (of_discs, "observer"), (of_discs, "energy descent")]


@pytest.mark.parametrize(("network", "name"), [*CASES, *DISCS])
def test_solvers_agree_with_shooting(network, name):
    robot, given = network()
    solver = SOLVERS[name]
    inputs = robot.inputs(**given)
    expected = mr.solve(robot, inputs, solver=mr.Shooting(integrator=RK4)).raise_if_failed()
    found = mr.solve(robot, inputs, solver=solver).raise_if_failed()
    # the same equations at the same steps: what differs is the residual that is left, by a compliance of L^2 or so
    np.testing.assert_allclose(found.tip_position, expected.tip_position, atol=1e-8)
    np.testing.assert_allclose(found.tip_rotation, expected.tip_rotation, atol=1e-7)


def test_the_observer_says_where_discs_buckle():
    """Its number without scale falls as ``1 - F/F_c``, whatever else is nearly singular."""
    robot, _ = of_discs(5)
    (critical,) = mr.critical_loads(robot, robot.inputs(force={"disc 5": (0, 0, -1.0)}))
    for part, expected in ((0.9, mr.Status.CONVERGED), (0.98, mr.Status.BRANCH_END), (1.1, mr.Status.BRANCH_END)):
        inputs = robot.inputs(force={"disc 5": (0, 0, -part * critical.load_factor)})
        assert mr.solve(robot, inputs, solver=mr.Observer(integrator=RK4)).status is expected, part
