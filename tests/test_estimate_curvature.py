"""Forces from curvatures along a rod: against measurements and bounds of a rod that is integrated by ``measured_rods``."""

import numpy as np
import pytest
from measured_rods import STEPS, MeasuredRod

import multirod as mr

WIRE = {"length": 0.4, "bending_stiffness": 0.223349, "torsional_stiffness": 0.063814, "precurvature": (14, 5, 0)}
NODES = tuple(range(5, STEPS, 5))
AT = np.array(NODES) * 0.4 / STEPS
SIGMA, BENT = 0.25, 0.05  # [N], [1/m]
PRIOR = {"tip_force": mr.Prior(0, sigma=SIGMA)}


@pytest.fixture(scope="module")
def gratings():
    """Forces, and what noisy gratings say of the bending at nine places."""
    random = np.random.default_rng(5)
    force = SIGMA * random.normal(size=(200, 3))
    bent = MeasuredRod(**WIRE).seen(force, NODES)[2][..., :2]
    return force, bent + BENT * random.normal(size=bent.shape)


def test_force_from_curvatures_is_as_good_as_can_be(wire, gratings):
    robot = mr.SingleRod(wire)
    force, bent = gratings
    found = mr.estimate(robot, unknown=PRIOR, measured=mr.Curvature(at=AT, value=bent, sigma=BENT)).raise_if_failed()
    assert found.integrations[found.consistent].max() <= 6  # another is looked for elsewhere too, which takes a solve, (24)
    assert (found.degrees == 18).all()
    error, covariance = found.value("tip_force") - force, found.covariance("tip_force")
    # of 600 squares: 0.8 to 1.2 is some four standard deviations
    assert 0.8 < np.einsum("bi,bij,bj->", error, np.linalg.inv(covariance), error) / 600 < 1.2
    few = slice(0, 8)
    told = MeasuredRod(**WIRE).information(force[few], at=NODES, curvature=BENT, components=2)
    bound = np.linalg.inv(told + np.eye(3) / SIGMA**2)
    np.testing.assert_allclose(np.trace(covariance[few], axis1=1, axis2=2), np.trace(bound, axis1=1, axis2=2), rtol=0.2)
    # without noise it is the force
    exact = MeasuredRod(**WIRE).seen(force[few], NODES)[2]
    sharp = mr.estimate(robot, unknown=PRIOR, measured=mr.Curvature(at=AT, value=exact, sigma=1e-4))
    np.testing.assert_allclose(sharp.value("tip_force"), force[few], atol=1e-3)
    # one of them, and the solution is the equilibrium that goes with it
    one = mr.estimate(robot, unknown=PRIOR, measured=mr.Curvature(at=AT, value=bent[0], sigma=BENT))
    again = mr.solve(robot, robot.inputs(tip_force=one.value("tip_force")))
    np.testing.assert_allclose(one.solution.tip_position, again.tip_position, atol=1e-7)
    np.testing.assert_array_equal(one.value("tip_force"), found.value("tip_force")[0])


def test_a_grating_that_drops_out_is_gone_without(wire, gratings):
    robot = mr.SingleRod(wire)
    bent = np.array(gratings[1][0])
    bent[3:] = np.nan
    lost = mr.estimate(robot, unknown=PRIOR, measured=mr.Curvature(at=AT, value=bent, sigma=BENT))
    fewer = mr.estimate(robot, unknown=PRIOR, measured=mr.Curvature(at=AT[:3], value=bent[:3], sigma=BENT))
    np.testing.assert_allclose(lost.value("tip_force"), fewer.value("tip_force"), atol=1e-4)
    assert lost.missing.all()
    assert lost.degrees == 6


def test_gratings_and_a_pose_in_a_loop(wire, gratings):
    """One integration a sample, whatever sensors there are."""
    force, _ = gratings
    steps = mr.RK4(50)
    robot = mr.SingleRod(wire)
    truth = mr.solve(robot, robot.inputs(tip_force=force[0]))
    bent = MeasuredRod(**WIRE).seen(force[:1], NODES)[2][0, :, :2]
    sensors = [mr.Curvature(at=AT, value=bent, sigma=BENT), mr.Pose(position=(0, 0, 0), sigma=1e-4)]
    meter = mr.Estimator(robot, dt=1e-3, unknown={"tip_force": mr.Walk(0.1)}, sensors=sensors, integrator=steps)
    for k in range(10):
        sample = meter.step([bent, truth.tip_position if k % 3 else None])
        assert k == 0 or sample.integrations == 1
    np.testing.assert_array_equal(sample.missing, [False, True])
    # drawn to the prior's mean: by less than it says that it may be off
    assert (np.abs(sample.value("tip_force") - force[0]) < 2 * sample.sigma("tip_force")).all()


def test_columns_of_tubes_by_differences():
    """Of every tube, in its own frame: value and derivatives of what one integration tells."""
    from multirod.tasks.formulation import options
    from multirod.tasks.measuring.along import AlongTask, Places

    def tube(length, bending, torsion, curved):
        at_rest = [(length - 0.1, (0, 0, 0)), (0.1, curved)]
        return mr.Rod(length=length, bending_stiffness=bending, torsional_stiffness=torsion, precurvature=at_rest)

    robot = mr.ConcentricTubes([tube(0.4, 4e-3, 3e-3, (0, 14, 0)), tube(0.3, 2e-2, 1.6e-2, (3, 6, 0))])
    inputs = robot.inputs(rotation=(0.5, 0), translation=(-0.16, -0.12), tip_force=(0, 0.1, 0))
    solution = mr.solve(robot, inputs)
    at = np.array([0.04, 0.1, 0.15])
    sensors = [mr.Curvature(at=at, value=np.zeros((3, 3)), sigma=1.0, rod=k) for k in range(2)]
    names = ("tip_force", "rotation")
    problem = robot.problem(inputs, integrator=mr.RK45(), **options(robot, names))
    task = AlongTask(problem, names, Places(robot, inputs, sensors))
    x, p = solution.unknowns[None], task.values()
    found = task.evaluate(x, p)
    for k in range(2):
        shape = solution.rod(k, nodes=2001)
        for j in range(3):
            there = np.interp(at, shape.arclength, shape.curvature[:, j])
            np.testing.assert_allclose(found.sensed["curvature", k][0][0, :, j], there, atol=1e-3)
    n, h = x.shape[1], 1e-5
    for k in range(n + 5):
        ends = []
        for sign in (1, -1):
            change = sign * h * np.eye(n + 5)[k]
            there = task.evaluate(x + change[:n], p + change[n:]).sensed
            ends.append(np.array([there["curvature", rod][0][0] for rod in range(2)]))
        slope = (ends[0] - ends[1]) / (2 * h)
        columns = np.array([found.sensed["curvature", rod][1][0] for rod in range(2)])
        # the integrator's tolerance over h, of columns of some 10
        np.testing.assert_allclose(columns[..., k], slope, atol=1e-3 + 1e-4 * np.abs(slope).max())


def test_a_gauge_at_the_clamp(wire):
    """The bending at the base is the moment there, and says two numbers of the force: what is left is the prior's."""
    robot, force = mr.SingleRod(wire), np.array([0.1, -0.05, 0.2])
    truth = mr.solve(robot, robot.inputs(tip_force=force))
    bent = truth.along(0.0, of="curvature")[:2]
    found = mr.estimate(robot, unknown=PRIOR, measured=mr.Curvature(at=0.0, value=bent, sigma=1e-3)).raise_if_failed()
    there = found.solution.along(0.0, of="curvature")[:2]
    # the prior pulls by about sigma^2 times force over SIGMA^2, over the compliance of some 10 1/(m N)
    np.testing.assert_allclose(there, bent, rtol=0, atol=1e-4)
    by_force = found.solution.jacobian("tip_force", of="curvature", at=0.0)[:2]
    information = by_force.T @ by_force / 1e-6 + np.eye(3) / SIGMA**2
    np.testing.assert_allclose(found.covariance("tip_force"), np.linalg.inv(information), rtol=1e-4, atol=1e-9)
    both = [mr.Curvature(at=(0.0, 0.2), value=truth.along((0.0, 0.2), of="curvature"), sigma=1e-3)]
    # where a marker at the base is, loads do not tell, nor does it spoil anything
    both.append(mr.Pose(position=(0, 0, 0), at=0.0, sigma=1e-3))
    found = mr.estimate(robot, unknown=PRIOR, measured=both).raise_if_failed()
    np.testing.assert_allclose(found.value("tip_force"), force, atol=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"at": (0.2, 0.1)}, "Curvature.at = .*rising"),
        ({"at": (-0.1, 0.1)}, "Curvature.at = .*>= 0"),
        ({"value": np.zeros((3, 2))}, r"Curvature.value.*must be \(..., 2, 2\)"),
        ({"value": np.zeros((2, 4))}, "Curvature.value"),
        ({"sigma": 0}, "Curvature.sigma = 0 .*> 0"),
        ({"sigma": (1, 2, 3)}, "Curvature.sigma.*must be one number, or 2"),
        ({"rod": 1}, "Curvature.rod = 1"),
        ({"at": (0.2, 0.5)}, "at = .*must be >= 0 and <= 0.4 m"),
    ],
)
def test_bad_curvatures(wire, options, message):
    def use():
        sensor = mr.Curvature(**({"at": (0.1, 0.2), "value": np.zeros((2, 2)), "sigma": 0.1} | options))
        mr.estimate(mr.SingleRod(wire), unknown=PRIOR, measured=sensor)

    with pytest.raises(ValueError, match=message):
        use()


def test_robots_that_do_not_tell_say_so(wire):
    robot = mr.EccentricTubes([wire, wire], offsets=[(0.002, 0), (-0.002, 0)])
    with pytest.raises(NotImplementedError, match="derivatives along rods side by side are not known"):
        mr.estimate(robot, unknown=PRIOR, measured=mr.Curvature(at=0.1, value=(0, 0), sigma=0.1, rod=0))


def test_where_the_start_fails_the_estimate_says_so():
    """The end of a rod of 0.4 m that does not stretch is held 0.5 m away: an array of no instances has rows too."""
    held = mr.HeldRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))
    bent = mr.Curvature(at=0.2, value=(1, 0), sigma=BENT)
    found = mr.estimate(held, held.inputs(end_position=(0, 0, 0.1)), unknown=PRIOR, measured=bent)
    assert found.status is mr.Status.OUT_OF_REACH
    assert np.isnan(found.value("tip_force")).all()


def test_why_there_is_no_estimate_does_not_depend_on_others():
    """With a guess nothing is solved before: that an end is out of reach was told only where another instance had an estimate."""
    held = mr.HeldRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))
    place = np.array([(0, 0, -0.1), (0, 0, 0.1)])
    options = {"unknown": PRIOR, "measured": mr.Curvature(at=0.2, value=(1, 0), sigma=BENT)}
    options["guess"] = mr.solve(held, held.inputs(end_position=place[0]))
    both = mr.estimate(held, held.inputs(end_position=place), **options)
    assert both.status[1] is mr.Status.OUT_OF_REACH
    for k in (0, 1):
        alone = mr.estimate(held, held.inputs(end_position=place[k]), **options)
        assert alone.status is both.status[k]
        np.testing.assert_array_equal(alone.value("tip_force"), both.value("tip_force")[k])


def test_steps_from_what_is_no_equilibrium_do_not_stall():
    """A chain of two rods sways: on the way the squares are less than at any equilibrium that is near."""
    half = mr.Rod.wire(length=0.2, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9)
    middle, end = mr.Body("middle", mass=0.05), mr.Body("end", mass=0.05)
    joints = [
        mr.Joint("first", "base", to=mr.ground),
        mr.Joint("first", "tip", to=middle),
        mr.Joint("second", "base", to=middle),
        mr.Joint("second", "tip", to=end),
    ]
    chain = mr.Network(rods={"first": half, "second": half}, bodies=[middle, end], joints=joints)
    known = {"rotation": {"second": 0.5}, "gravity": (1.0, 0, -9.81)}
    solver = mr.Shooting(integrator=mr.RK4(50))
    truth = mr.solve(chain, chain.inputs(**known, force={"end": (0.1, 0, 0)}), solver=solver)
    tip = mr.Pose(position=truth.tip_position, rotation=truth.tip_rotation, sigma=(5e-4, 5e-3))
    unknown = {"force": mr.Prior(0, sigma=0.25)}
    for rod in (0, 1):
        shape = truth.rod(rod, nodes=201)
        for node in (50, 100, 150):
            bent = mr.Curvature(at=float(shape.arclength[node]), value=shape.curvature[node], sigma=BENT, rod=rod)
            found = mr.estimate(chain, chain.inputs(**known), unknown=unknown, measured=[tip, bent], solver=solver)
            assert found.status is mr.Status.CONVERGED
            assert found.integrations <= 45  # of which 24 find the start
            near = mr.estimate(chain, chain.inputs(**known), unknown=unknown, measured=[tip, bent], solver=solver, guess=truth)
            # each is a hundredth of a standard deviation off at most
            off = np.abs(found.value("force") - near.value("force")) / near.sigma("force")
            assert off.max() < 0.02
