"""What the table of tasks and robots says is refused (``docs/tasks.md``): each raises an error that names it."""

import numpy as np
import pytest

import multirod as mr

WIRE = mr.Rod(length=0.3, bending_stiffness=0.2233, torsional_stiffness=0.0638)
LENGTH, STIFFNESSES, NUMBERS = ("length",), ("bending_stiffness", "torsional_stiffness"), ("precurvature", "length")
OWN = (*STIFFNESSES, *NUMBERS)


def lined(**line):
    return mr.SingleRod(
        mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=[mr.Tendon(offset=(0.008, 0), **line)])
    )


def tubes(kind, lines=(), **options):
    both = [
        mr.Rod(length=length, bending_stiffness=EI, torsional_stiffness=EI / 1.3, precurvature=(4, 0, 0), lines=own)
        for length, EI, own in ((0.3, 0.004, lines), (0.2, 0.02, ()))
    ]
    return kind(both, **options)


def circle(*degrees):
    poses = np.tile(np.eye(4), (len(degrees), 1, 1))
    poses[:, 0, 3], poses[:, 1, 3] = 0.087 * np.cos(np.radians(degrees)), 0.087 * np.sin(np.radians(degrees))
    return poses


def legs():
    return mr.ParallelRods(legs=[WIRE] * 6, base=circle(-10, 10, 110, 130, 230, 250), platform=circle(-50, 50, 70, 170, 190, 290))


def chain():
    middle = mr.Body("middle")
    joints = [mr.Joint("lower", "base", to=mr.ground), mr.Joint("lower", "tip", to=middle), mr.Joint("upper", "base", to=middle)]
    return mr.Network(rods={"lower": WIRE, "upper": WIRE}, bodies=[middle], joints=joints, end_effector="upper")


def held(shift=0.0):
    end = np.eye(4)
    end[:3, 3] = shift, 0, 0.28
    return mr.HeldRod(WIRE, **({"end": end} if shift else {}))


MADE = {
    "tendon": lambda: (lined(), {"tension": (0.5,)}),
    "displaced": lambda: (lined(driven="displacement", axial_stiffness=300.0), {"displacement": (1e-4,)}),
    "tubes with a line": lambda: (
        tubes(mr.ConcentricTubes, lines=[mr.Tendon(offset=(0.001, 0))]),
        {"translation": (-0.1, -0.05), "tension": (0.5,)},
    ),
    "side by side": lambda: (tubes(mr.EccentricTubes, offsets=[(0.002, 0), (-0.003, 0)]), {"tip_force": (0.1, 0, 0)}),
    "legs": lambda: (legs(), {"tip_force": (0.1, 0, 0)}),
    "inverse": lambda: (legs().inverse(), {"platform_position": (0.02, 0, 0.29)}),
    "held": lambda: (held(), {"end_position": (0.01, 0, -0.02)}),
    "held at an end": lambda: (held(0.05), {}),
    "network": lambda: (chain(), {"force": {"middle": (0.05, 0, 0)}}),
}
_FOUND = {}


def solved(name):
    """Each robot is solved once."""
    if name not in _FOUND:
        robot, given = MADE[name]()
        _FOUND[name] = mr.solve(robot, robot.inputs(**given)).raise_if_failed()
    return _FOUND[name]


def refused_columns():
    for name, numbers in (
        ("tendon", LENGTH),
        ("displaced", NUMBERS),
        ("tubes with a line", (*STIFFNESSES, *LENGTH)),
        ("inverse", (*OWN, "base")),
        ("held", (*OWN, "base")),
        ("held at an end", ("base",)),
    ):
        for number in numbers:
            yield name, number


def refused_fits():
    for name, numbers in (
        ("displaced", ("precurvature",)),
        ("tubes with a line", STIFFNESSES),
        ("legs", ("base",)),
        ("inverse", (*STIFFNESSES, "precurvature", "base")),
        ("held", (*STIFFNESSES, "precurvature", "base")),
        ("held at an end", ("base",)),
    ):
        for number in numbers:
            yield name, number


@pytest.mark.parametrize(("name", "number"), list(refused_columns()))
def test_derivatives_that_are_refused(name, number):
    """``jacobian`` and ``vjp``: by what is not known, and by what such a robot has not."""
    found = solved(name)
    with pytest.raises((NotImplementedError, TypeError), match=number):
        found.jacobian(number)
    with pytest.raises((NotImplementedError, TypeError), match=number):
        found.vjp((1, 0, 0), of="tip_position", wrt=(number,))


@pytest.mark.parametrize(("name", "number"), [each for each in refused_columns() if each[1] != "base"])
def test_derivatives_of_jax_that_are_refused(name, number):
    jax = pytest.importorskip("jax", reason="JAX is not installed")
    found = solved(name)
    function = mr.jax.function(found.robot, inputs=found.inputs)
    at = jax.numpy.ones(())
    if number in function.equilibrium.tails:
        at = function.value_of(number)
    with pytest.raises((NotImplementedError, TypeError), match=number):
        jax.jacrev(lambda own: function(**{number: own}))(at)


@pytest.mark.parametrize(("name", "number"), list(refused_fits()))
def test_fits_that_are_refused(name, number):
    found = solved(name)
    seen = mr.Pose(position=found.tip_position, sigma=1e-3)
    with pytest.raises(NotImplementedError, match=number):
        mr.calibrate(found.robot, found.inputs, parameters={number: mr.Prior(sigma=0.1)}, measured=seen)


@pytest.mark.parametrize(("name", "said"), [("side by side", "rods side by side"), ("inverse", "the inverse problem")])
def test_sensors_along_rods_that_are_refused(name, said):
    found = solved(name)
    own = {"at": 0.1, "rod": 0}
    for sensor in (mr.Curvature(value=(1, 0), sigma=0.05, **own), mr.Pose(position=(0, 0, 0.1), sigma=1e-3, **own)):
        with pytest.raises(NotImplementedError, match=said):
            mr.estimate(found.robot, found.inputs, unknown={"tip_force": mr.Prior(0, sigma=1)}, measured=sensor)


def test_sensors_along_one_of_several_rods_say_which():
    """They were of the first."""
    robot, told = MADE["legs"]()[0], {"sigma": 1e-3, "at": 0.1}
    sensors = [mr.Curvature(value=(1, 0), **told), mr.Pose(position=(0, 0, 0.1), **told)]
    for sensor in (*sensors, mr.ForceTorque(force=(0, 0, 1), **told)):
        name = type(sensor).__name__
        with pytest.raises(ValueError, match=rf"{name}\.rod is not given: of \d+ rods that stand apart it must be an index"):
            mr.estimate(robot, unknown={"tip_force": mr.Prior(0, sigma=1)}, measured=sensor)


@pytest.mark.parametrize("name", ["legs", "side by side"])
def test_what_is_along_one_of_several_rods_says_which(name):
    """It was along the first."""
    found = solved(name)
    asked = (
        [found.rod]
        if name == "side by side"
        else [
            found.rod,
            found.wrench,
            lambda **rod: found.along(0.1, **rod),
            lambda **rod: found.jacobian("tip_force", of="curvature", at=0.1, **rod),
        ]
    )
    for ask in asked:
        with pytest.raises(ValueError, match=r"^rod is not given: of \d+ rods that stand apart it must be an index below"):
            ask()
        ask(rod=0)


def test_of_tubes_in_each_other_the_first_is_meant():
    """They are bent alike."""
    told = {"sigma": 1e-3, "at": 0.1}
    tubes = mr.ConcentricTubes([mr.Rod(length=own, bending_stiffness=0.01, torsional_stiffness=0.008) for own in (0.3, 0.2)])
    one, other = (
        mr.estimate(tubes, unknown={"tip_force": mr.Prior(0, sigma=1)}, measured=mr.Curvature(value=(1, 0), **told, **rod))
        for rod in ({}, {"rod": 0})
    )
    np.testing.assert_array_equal(one.value("tip_force"), other.value("tip_force"))
    assert one.value("tip_force").any()
    bent = mr.solve(tubes, tubes.inputs(tip_force=(0.1, 0, 0)))
    columns = {"of": "curvature", "at": 0.1}
    np.testing.assert_array_equal(bent.jacobian("tip_force", **columns), bent.jacobian("tip_force", **columns, rod=0))
    np.testing.assert_array_equal(bent.rod().position, bent.rod(0).position)


def test_derivatives_along_rods_side_by_side_are_refused():
    with pytest.raises(NotImplementedError, match="derivatives along rods side by side"):
        solved("side by side").jacobian("tip_force", of="curvature", at=0.1, rod=0)


@pytest.mark.parametrize("name", ["inverse", "held", "held at an end"])
def test_ends_that_are_held_have_no_stiffness(name):
    with pytest.raises(AttributeError, match="has no stiffness of its end: something holds it"):
        _ = solved(name).stiffness


def test_other_starts_are_for_one_robot():
    several = mr.SingleRod(mr.Rod(length=np.array([0.2, 0.3]), bending_stiffness=0.01, torsional_stiffness=0.008))
    with pytest.raises(NotImplementedError, match="starts need a robot whose parameters have no leading axes"):
        mr.reach(several, mr.Pose(position=(0.1, 0, 0.1)), free=("rotation", "translation"), starts=4)


@pytest.mark.parametrize("name", ["tendon", "side by side", "legs", "network"])
def test_ends_that_are_free_have_one(name):
    assert np.isfinite(solved(name).stiffness).all()


def test_what_the_table_lets_through_of_networks():
    """A grating on a rod of a network, and columns along it."""
    found = solved("network")
    assert found.jacobian("force", of="curvature", at=0.1, rod="lower").shape == (3, found.inputs.force.size)
    bent = mr.Curvature(at=0.1, value=found.rod("lower").curvature[0, :2], sigma=1e3, rod="lower")
    estimated = mr.estimate(found.robot, found.inputs, unknown={"force": mr.Prior(sigma=0.1)}, measured=bent)
    assert estimated.status is mr.Status.CONVERGED
