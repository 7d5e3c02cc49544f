"""Tasks are the same for robots of every size: in other units of length and of force, and whatever unit an input has."""

import numpy as np
import pytest

import multirod as mr

pytestmark = pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
SOLVER = mr.Shooting(integrator=mr.RK4(30))
SIZES = [(1e-6, 1e-12), (1e-3, 1e-6), (1.0, 1e-9), (1e3, 1e4)]  # units of length and of force over m and N
PLACES = 1e-6  # of a length or an angle: both are at their targets to 4e-7
ANGLES = np.radians([90, 210, 330])
START = {"rotation": (0.4, 0.2, 0.0), "translation": (-0.15, -0.12, -0.1), "tip_force": (0, 0.1, 0)}
LOADS = ("tip_force", "tension")


def tubes(length=1.0, force=1.0):
    def tube(own, EI, kappa):
        straight = [((own - 0.1) * length, (0, 0, 0)), (0.1 * length, (kappa / length, 0, 0))]
        stiffness = EI * force * length**2
        return mr.Rod(
            length=own * length, bending_stiffness=stiffness, torsional_stiffness=0.77 * stiffness, precurvature=straight
        )

    return mr.ConcentricTubes([tube(0.4, 4e-3, 12), tube(0.3, 17e-3, 8), tube(0.2, 40e-3, 3)])


def posed(length=1.0, force=1.0):
    """The tubes at ``START``, and an equilibrium there."""
    robot, (rotation, translation, load) = tubes(length, force), START.values()
    inputs = robot.inputs(rotation=rotation, translation=np.multiply(translation, length), tip_force=np.multiply(load, force))
    return robot, mr.solve(robot, inputs, solver=SOLVER).raise_if_failed()


def limits(length):
    """That let the first tube be pushed, and hold it at the end."""
    return mr.Limits(translation=(-0.18 * length, -0.09 * length), gap=1e-3 * length)


def wire(length=1.0, force=1.0):
    lines = [mr.Tendon(offset=0.008 * length * np.array([np.cos(a), np.sin(a)])) for a in ANGLES]
    stiffness = 0.01 * force * length**2
    rod = mr.Rod(length=0.2 * length, bending_stiffness=stiffness, torsional_stiffness=0.77 * stiffness, lines=lines)
    return mr.SingleRod(rod)


@pytest.mark.parametrize("driven", ["tension", "displacement"])
def test_two_segments_of_four_tendons_reach_where_other_pulls_had_them(driven):
    """Their pulls are ten to a hundred times ``EI/L^2``: what bends a rod by a radian is the moment of its tendon."""

    def around(first, end, **options):
        angles = first + np.pi / 2 * np.arange(4)
        return [mr.Tendon(offset=(0.006 * np.cos(a), 0.006 * np.sin(a)), end=end, driven=driven, **options) for a in angles]

    options = {"axial_stiffness": 2000.0} if driven == "displacement" else {}
    lines = around(0.0, 0.1, **options) + around(np.pi / 4, 0.2, **options)
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.006, torsional_stiffness=0.0046, lines=lines))
    low, start, high, limits = (0, 0.3, 8, (0, 20)) if driven == "tension" else (-2e-3, 1e-3, 3e-3, (-6e-3, 8e-3))
    pulled = np.random.default_rng(5).uniform(low, high, (40, 8))
    seen = mr.solve(robot, robot.inputs(**{driven: pulled}), solver=SOLVER).raise_if_failed()
    found = mr.reach(
        robot,
        mr.Pose(position=seen.tip_position),
        robot.inputs(**{driven: start}),
        free=driven,
        limits=mr.Limits(**{driven: limits}),
        solver=SOLVER,
    )
    assert (found.status == mr.Status.REACHED).all()


def reached(length=1.0, force=1.0):
    robot, start = posed(length, force)
    places = start.tip_position + length * np.array([(3e-3, 5e-3, -4e-3), (0, 0, 0.08)])  # within reach, and beyond it
    found = mr.reach(
        robot, mr.Pose(position=places), free=("rotation", "translation"), limits=limits(length), guess=start, solver=SOLVER
    )
    return found.status, [found.inputs.rotation[0], found.inputs.translation[0] / length], found.target_error / length


@pytest.mark.parametrize(("length", "force"), SIZES)
def test_reach_is_the_same_at_every_size(length, force):
    status, places, off = reached()
    assert [one.name for one in status] == ["REACHED", "AT_LIMIT"]
    other_status, other_places, other_off = reached(length, force)
    np.testing.assert_array_equal(other_status, status)
    np.testing.assert_allclose(other_places, places, atol=1e-5)  # what a target leaves free is found to what steps leave
    np.testing.assert_allclose(other_off, off, atol=1e-4)  # slides along limits, whose steps shrink to a fiftieth


@pytest.mark.parametrize(("length", "force"), SIZES)
def test_commands_are_the_same_at_every_size(length, force):
    def driven(length=1.0, force=1.0):
        robot, start = posed(length, force)
        loop = mr.Controller(
            robot, dt=0.01, free=("rotation", "translation"), limits=limits(length), guess=start, integrator=mr.RK4(30)
        )
        for k in range(90):  # towards a place beyond the limits
            command = loop.step(position=start.tip_position + length * 1e-3 * k * np.array([0.2, 0.1, 1.0]))
        return command.status.name, command.held_by, [command.inputs.rotation, command.inputs.translation / length]

    status, held_by, places = driven()
    assert status == "AT_LIMIT"
    other_status, other_held_by, other_places = driven(length, force)
    assert (other_status, other_held_by) == (status, held_by)
    np.testing.assert_allclose(other_places, places, atol=PLACES)


@pytest.mark.parametrize(("length", "force"), SIZES)
def test_estimates_at_limits_are_the_same_at_every_size(length, force):
    def estimated(length=1.0, force=1.0):
        robot = wire(length, force)
        acting = {"tip_force": force * np.array([0.1, -0.05, 0.02]), "tension": force * np.array([2, 0, 0.5])}
        truth = mr.solve(robot, robot.inputs(**acting))
        seen = truth.tip_position + length * np.array([5e-4, 0, -5e-4])
        sensor = mr.Pose(position=seen, rotation=truth.tip_rotation, sigma=(2e-4 * length, 2e-3))
        unknown = {"tip_force": mr.Prior(0, sigma=0.2 * force), "tension": mr.Prior(0, sigma=force)}
        found = mr.estimate(robot, unknown=unknown, measured=sensor)
        return found.at_limit, [[found.value(name) / force, found.sigma(name) / force] for name in LOADS]

    at_limit, values = estimated()
    assert at_limit.any()
    assert not at_limit.all()
    other_at_limit, other_values = estimated(length, force)
    np.testing.assert_array_equal(other_at_limit, at_limit)
    np.testing.assert_allclose(other_values, values, atol=1e-3)  # of 0.2 and 1: steps end within a hundredth of a deviation


def silicone():
    """A segment with three chambers."""
    lines = [mr.Chamber(offset=(4e-3 * np.cos(a), 4e-3 * np.sin(a)), area=1.2e-5) for a in ANGLES]
    stiffness = {"bending_stiffness": 5e-4, "torsional_stiffness": 3.5e-4, "shear_stiffness": 15.0, "axial_stiffness": 50.0}
    return mr.SingleRod(mr.Rod(length=0.1, **stiffness, lines=lines, linear_density=0.12))


def magnet():
    """A soft wire with a magnet's axis along it."""
    return mr.SingleRod(mr.Rod(length=0.04, bending_stiffness=3e-9, torsional_stiffness=2e-9, magnetisation=(0, 0, 0.0157)))


SCENES = {
    "pressure": (silicone, (1e4, 1e4, 1e4), (1e4, 4e4, 2e4), 5e4, (0, 1e5), {"gravity": (0, 0, 9.81)}),
    "magnetic_field": (magnet, (1e-4, 0, 2e-4), (2e-4, 1e-4, 5e-4), 5e-4, (-1e-3, 1e-3), {}),
    "gravity": (silicone, (0, 0, 9.81), (5, 3, 8), 5, (-20, 20), {"pressure": (1e4, 4e4, 2e4)}),
}


@pytest.mark.parametrize("name", SCENES)
def test_what_is_freed_may_be_in_any_unit(name):
    """Pascals, teslas, m/s^2: a step of one of them is as good as none, or far too much."""
    make, first, last, sigma, allowed, given = SCENES[name]
    robot = make()
    start = mr.solve(robot, robot.inputs(**{name: first}, **given)).raise_if_failed()
    there = mr.solve(robot, robot.inputs(**{name: last}, **given), guess=start).raise_if_failed()
    target = mr.Pose(position=there.tip_position)
    found = mr.reach(robot, target, free=(name,), limits=mr.Limits(**{name: allowed}), guess=start)
    assert found.status == mr.Status.REACHED
    assert found.target_error < 1e-7
    assert found.integrations < 20  # as of angles
    loop = mr.Controller(robot, dt=0.01, free=(name,), limits=mr.Limits(**{name: allowed}), guess=start)
    for part in np.clip(np.linspace(0, 1.5, 90), 0, 1):
        command = loop.step(position=start.tip_position + part * (there.tip_position - start.tip_position))
    assert command.status == mr.Status.TRACKING
    arrived = mr.solve(robot, command.inputs, guess=command).tip_position
    np.testing.assert_allclose(arrived, there.tip_position, atol=1e-7)  # at rest since 30 samples
    sensor = mr.Pose(position=there.tip_position, rotation=there.tip_rotation, sigma=(1e-5, 1e-4))
    seen = mr.estimate(robot, robot.inputs(**given), unknown={name: mr.Prior(first, sigma=sigma)}, measured=sensor)
    assert seen.status == mr.Status.CONVERGED
    expected = mr.solve(robot, robot.inputs(**{name: seen.value(name)}, **given), guess=there).tip_position
    np.testing.assert_allclose(expected, there.tip_position, atol=3e-5)  # three deviations


def test_inputs_that_hardly_move_the_tip_where_they_begin_are_a_singular_task():
    """A magnet that a hundred times the field that bends it has turned into that field; from a weaker one it is reached."""
    robot, axis = magnet(), mr.Pose(axis=(1, 0, 0.3))
    strong, weak = (mr.solve(robot, robot.inputs(magnetic_field=(field, 0, 0))).raise_if_failed() for field in (0.05, 5e-4))
    assert mr.reach(robot, axis, free=("magnetic_field",), guess=strong).status is mr.Status.SINGULAR_TASK
    assert mr.reach(robot, axis, free=("magnetic_field",), guess=weak).status is mr.Status.REACHED
