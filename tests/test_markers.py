"""Markers along rods, and deviations that differ by direction: against rods that are integrated by ``measured_rods``."""

import numpy as np
import pytest
from measured_rods import STEPS, MeasuredRod, turned_by
from scipy.spatial.transform import Rotation

import multirod as mr
from multirod.rotations import vectors
from multirod.tasks.formulation import options
from multirod.tasks.measuring.along import AlongTask, Places
from multirod.tasks.whitening import of_what_is_there, whitening

WIRE = {"length": 0.4, "bending_stiffness": 0.223349, "torsional_stiffness": 0.063814, "precurvature": (14, 5, 0)}
NODES = (15, 30, 45)
AT = np.array(NODES) * 0.4 / STEPS
SIGMA, POSITION = 0.25, 1e-3  # [N], [m]
PRIOR = {"tip_force": mr.Prior(0, sigma=SIGMA)}


def markers(position, sigma=POSITION, at=AT, **own):
    """A sensor for each place, of positions (..., place, 3)."""
    return [mr.Pose(position=position[..., k, :], at=place, sigma=sigma, **own) for k, place in enumerate(at)]


def marked(force):
    """Where the markers are under forces (row, 3), shape (row, place, 3), and frames there."""
    rod = MeasuredRod(**WIRE)
    states = rod.along(rod.equilibrium(force), np.asarray(force, float))[list(NODES)]
    return np.moveaxis(states[..., :3], 0, 1), np.moveaxis(states[..., 3:12], 0, 1).reshape(-1, len(NODES), 3, 3)


@pytest.fixture(scope="module")
def seen():
    """Forces, and what noisy markers say of where they are at three places."""
    random = np.random.default_rng(5)
    force = SIGMA * random.normal(size=(200, 3))
    exact = marked(force)[0]
    return force, exact, exact + POSITION * random.normal(size=exact.shape)


def information(force):
    """Fisher's, of markers at the places, by differences of another integration, shape (row, 3, 3)."""
    h = 1e-4
    columns = [(marked(force + h * e)[0] - marked(force - h * e)[0]).reshape(len(force), -1) / (2 * h) for e in np.eye(3)]
    J = np.stack(columns, axis=-1) / POSITION
    return np.swapaxes(J, 1, 2) @ J


def test_force_from_markers_is_as_good_as_can_be(wire, seen):
    robot = mr.SingleRod(wire)
    force, exact, noisy = seen
    found = mr.estimate(robot, unknown=PRIOR, measured=markers(noisy)).raise_if_failed()
    assert found.integrations.max() <= 6
    assert (found.degrees == 9).all()
    error, covariance = found.value("tip_force") - force, found.covariance("tip_force")
    # of 600 squares: 0.8 to 1.2 is some four standard deviations
    assert 0.8 < np.einsum("bi,bij,bj->", error, np.linalg.inv(covariance), error) / 600 < 1.2
    few = slice(0, 8)
    bound = np.linalg.inv(information(force[few]) + np.eye(3) / SIGMA**2)
    np.testing.assert_allclose(np.trace(covariance[few], axis1=1, axis2=2), np.trace(bound, axis1=1, axis2=2), rtol=0.2)
    # without noise it is the force
    sharp = mr.estimate(robot, unknown=PRIOR, measured=markers(exact[few], sigma=1e-6))
    np.testing.assert_allclose(sharp.value("tip_force"), force[few], atol=1e-3)
    one = mr.estimate(robot, unknown=PRIOR, measured=markers(noisy[0]))
    np.testing.assert_array_equal(one.value("tip_force"), found.value("tip_force")[0])


def test_a_marker_that_drops_out_is_gone_without_in_a_loop_too(wire, seen):
    """One integration a sample, but for the second, before which nothing says how ``Gamma`` grows; each marker is a sensor."""
    force, exact, _ = seen
    robot, given = mr.SingleRod(wire), markers(exact[0])
    meter = mr.Estimator(robot, dt=1e-3, unknown={"tip_force": mr.Walk(0.1)}, sensors=given, gate=0.999, integrator=mr.RK4(50))
    for k in range(10):
        off = (0.02, 0, 0) if k == 9 else (0, 0, 0)  # another point was taken for the marker
        sample = meter.step([exact[0, 0], exact[0, 1] if k % 3 else None, exact[0, 2] + off])
        assert k < 2 or sample.integrations == 1
    np.testing.assert_array_equal(sample.missing, [False, True, False])
    np.testing.assert_array_equal(sample.rejected, [False, False, True])
    assert (np.abs(sample.value("tip_force") - force[0]) < 3 * sample.sigma("tip_force")).all()


def test_a_wire_is_fitted_to_markers(wire):
    """And to a frame there: another wire, by poses of its middle."""
    force = np.random.default_rng(3).normal(size=(6, 3))
    real = MeasuredRod(0.4, bending_stiffness=0.24, torsional_stiffness=0.06, precurvature=(14.4, 4.7, 0.15))
    states = real.along(real.equilibrium(force), force)[25]
    frame = Rotation.from_matrix(states[:, 3:12].reshape(6, 3, 3)).as_matrix()  # steps leave it one to 1e-7
    sensor = mr.Pose(position=states[:, :3], rotation=frame, at=0.2, sigma=(1e-6, 1e-5))
    robot, names = mr.SingleRod(wire), ("bending_stiffness", "torsional_stiffness", "precurvature")
    fit = mr.calibrate(robot, robot.inputs(tip_force=force), parameters=names, measured=sensor).raise_if_failed()
    found = np.concatenate([fit.value(name) for name in names])
    # steps of the other integration leave 1e-6 m
    np.testing.assert_allclose(found, (0.24 / 0.223349, 0.06 / 0.063814, 14.4, 4.7, 0.15), rtol=1e-3, atol=1e-3)


def tube(length, bending, torsion, curved):
    at_rest = [(length - 0.1, (0, 0, 0)), (0.1, curved)]
    return mr.Rod(length=length, bending_stiffness=bending, torsional_stiffness=torsion, precurvature=at_rest)


def tubes():
    robot = mr.ConcentricTubes([tube(0.4, 4e-3, 3e-3, (0, 14, 0)), tube(0.3, 2e-2, 1.6e-2, (3, 6, 0))])
    return robot, {"rotation": (0.5, 0), "translation": (-0.16, -0.12), "tip_force": (0, 0.1, 0)}, 2, 0.15


def legs():
    rod = mr.Rod(length=0.3, bending_stiffness=0.05, torsional_stiffness=0.04, precurvature=(1, 0, 0))
    places = np.tile(np.eye(4), (3, 1, 1))
    places[:, :3, 3] = [(0.06 * np.cos(a), 0.06 * np.sin(a), 0) for a in (0, 2.1, 4.2)]
    places[:, :3, :3] = turned_by(0.1 * np.eye(3))
    robot = mr.ParallelRods(legs=[rod] * 3, base=places, platform=places, joints="spherical")
    return robot, {"tip_force": (0.3, 0, 0.1), "rotation": (0.2, 0, 0)}, 3, 0.2


def held():
    rod = mr.Rod(length=0.3, bending_stiffness=0.05, torsional_stiffness=0.04, precurvature=(1, 0, 0))
    return mr.HeldRod(rod), {"end_position": (0.01, 0, -0.02), "rotation": 0.3, "distributed_force": (0.1, 0, 0)}, 1, 0.2


def chain():
    half = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(2, 0, 0))
    middle = mr.Body("middle", mass=0.01)
    joints = [mr.Joint("lower", "base", to=mr.ground), mr.Joint("lower", "tip", to=middle), mr.Joint("upper", "base", to=middle)]
    robot = mr.Network(rods={"lower": half, "upper": half}, bodies=[middle], joints=joints, end_effector="upper")
    return robot, {"force": {"middle": (0.1, 0, 0)}, "gravity": (1.0, 0, -9.81)}, 2, 0.15


@pytest.mark.parametrize("made", [tubes, legs, held, chain])
def test_poses_along_rods_and_their_columns(made):
    """Places and frames are those of the shape, columns those of differences, at fixed unknowns."""
    robot, given, count, at = made()
    inputs = robot.inputs(**given)
    solution = mr.solve(robot, inputs).raise_if_failed()
    sensors = [mr.Pose(position=(0, 0, 0), at=at, rod=k, sigma=1e-3) for k in range(count)]
    free = tuple(given)
    problem = robot.problem(inputs, integrator=mr.RK45(rtol=1e-11, atol=1e-12), **options(robot, free))
    task = AlongTask(problem, free, Places(robot, inputs, sensors))
    x, p = problem.adopt(solution.unknowns[None]), task.values()
    found = task.evaluate(x, p)
    for k in range(count):
        shape = solution.rod(k, nodes=2001)
        node = int(np.argmin(np.abs(shape.arclength - at)))
        off = at - shape.arclength[node]
        # from the node that is nearest, 0.1 mm away at most, along the tangent
        there = shape.position[node] + off * shape.rotation[node, :, 2]
        np.testing.assert_allclose(found.poses[k].position[0, 0], there, atol=1e-7)
        np.testing.assert_allclose(found.poses[k].rotation[0, 0], shape.rotation[node], atol=2 * 14 * abs(off) + 1e-7)
    n, size, h = x.shape[1], x.shape[1] + p.shape[1], 1e-5
    for j in range(size):
        change = h * np.eye(size)[j]
        ahead, back = (task.evaluate(x + sign * change[:n], p + sign * change[n:]).poses for sign in (1, -1))
        for k in range(count):
            moved = (ahead[k].position[0, 0] - back[k].position[0, 0]) / (2 * h)
            turned = vectors(ahead[k].rotation[0] @ np.swapaxes(back[k].rotation[0], -1, -2))[0] / (2 * h)
            columns = found.poses[k].columns[0, 0, :, j]
            scale = max(np.abs(moved).max(), np.abs(turned).max(), 1e-2)
            # h squared, and the integrator's tolerance over h
            np.testing.assert_allclose(columns, np.concatenate([moved, turned]), atol=1e-6 + 1e-5 * scale)


def test_a_camera_sees_depth_worse(wire, seen):
    """As in a world that is turned with camera, robot and force, in which its axes are those of the world."""
    noisy = seen[2]
    robot, camera = mr.SingleRod(wire), turned_by(np.array([[0.4, -0.7, 0.2]]))[0]
    deviations = np.array([2e-4, 3e-4, 5e-3])
    covariance = camera @ np.diag(deviations**2) @ camera.T
    found = mr.estimate(robot, unknown=PRIOR, measured=mr.Pose(position=noisy[0, 2], at=AT[2], covariance=covariance))
    base = np.eye(4)
    base[:3, :3] = camera.T
    turned = mr.estimate(
        mr.SingleRod(wire, base=base),
        unknown=PRIOR,
        measured=mr.Pose(position=camera.T @ noisy[0, 2], at=AT[2], sigma=deviations),
    )
    # a hundredth of a standard deviation may be left
    np.testing.assert_allclose(camera @ turned.value("tip_force"), found.value("tip_force"), atol=0.02 * SIGMA)
    P = camera @ turned.covariance("tip_force") @ camera.T
    np.testing.assert_allclose(P, found.covariance("tip_force"), atol=1e-3 * P.max())
    blunt = mr.estimate(robot, unknown=PRIOR, measured=mr.Pose(position=noisy[0, 2], at=AT[2], sigma=deviations))
    assert np.abs(blunt.covariance("tip_force") - P).max() > 0.1 * P.max()  # axes matter


@pytest.mark.parametrize("missing", [(0,), (1,), (2,), (0, 2)])
def test_what_is_missing_is_as_if_it_had_never_been_measured(wire, seen, missing):
    """Of a full covariance; each instance of a batch by itself."""
    robot, position = mr.SingleRod(wire), np.array(seen[2][0, 2])
    root = 1e-3 * np.array([(1, 0, 0), (0.5, 1, 0), (0.2, -0.4, 1)])
    lost = position.copy()
    lost[list(missing)] = np.nan
    sensor = mr.Pose(position=[lost, position], at=AT[2], covariance=root @ root.T)
    found = mr.estimate(robot, unknown=PRIOR, measured=sensor)
    assert found.degrees.tolist() == [3 - len(missing), 3]
    alone = mr.estimate(robot, unknown=PRIOR, measured=mr.Pose(position=lost, at=AT[2], covariance=root @ root.T))
    assert alone.dropped == (" and ".join("xyz"[k] for k in missing) + " of sensor 0",)
    whole = root @ root.T
    for k in missing:
        whole[k, k] = 1e4  # as good as not measured; what it says of the others is nothing then
    vague = mr.estimate(robot, unknown=PRIOR, measured=mr.Pose(position=position, at=AT[2], covariance=whole))
    np.testing.assert_allclose(found.value("tip_force")[0], vague.value("tip_force"), atol=1e-3 * SIGMA)
    P = vague.covariance("tip_force")
    np.testing.assert_allclose(found.covariance("tip_force")[0], P, atol=1e-4 * P.max())
    all_ = mr.estimate(robot, unknown=PRIOR, measured=mr.Pose(position=position, at=AT[2], covariance=root @ root.T))
    np.testing.assert_allclose(found.value("tip_force")[1], all_.value("tip_force"), atol=1e-3 * SIGMA)


def test_what_is_all_there_counts_as_it_does_alone():
    """To the last bit, beside others of which a number is missing."""
    root = np.random.default_rng(3).normal(size=(6, 6))
    alone = whitening((1, 1, 0), None, 1e-6 * root @ root.T)
    there = np.array([[True] * 6, [True] * 5 + [False], [False] * 6])
    found = of_what_is_there(alone, there)
    np.testing.assert_array_equal(found[0], alone)
    np.testing.assert_array_equal(found[2], 0)


def test_rounding_mixes_no_rows(wire, seen):
    """The inverse of a lower triangle, computed, may have a little above its diagonal: rows before what is missing stay."""
    robot, position = mr.SingleRod(wire), np.array(seen[2][0, 2])
    lost = np.where([False, False, True], np.nan, position)
    for seed in range(8):  # at some of them there is
        root = np.random.default_rng(seed).normal(size=(3, 3))
        covariance = 1e-7 * root @ root.T + 1e-8 * np.eye(3)
        found = mr.estimate(robot, unknown=PRIOR, measured=mr.Pose(position=lost, at=AT[2], covariance=covariance))
        assert found.dropped == ("z of sensor 0",)
        assert found.degrees == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"at": -0.1}, "Pose.at = -0.1 .*>= 0"),
        ({"at": 0.5}, "at = .*must be >= 0 and <= 0.4 m"),
        ({"at": 0.2, "rod": "inner"}, "Pose.rod = 'inner'"),
        ({"sigma": (1e-3, 1e-3)}, "Pose.sigma.*three along the axes of the world"),
        ({"sigma": (1e-3, 0.0, 1e-3)}, "Pose.sigma.*> 0"),
        ({"across": (0, 0, 1), "sigma": (1e-3,) * 3}, "Pose.sigma.*must be one number: of the position"),
        ({"along": (0, 0, 1), "sigma": (1e-3,) * 3}, "Pose.sigma.*must be one number: of the position"),
        ({"along": (0, 0, 1), "across": (1, 0, 0)}, "Pose.along.*must not be given beside across"),
        ({"along": (0, 0, 0)}, "Pose.along.*must not be zero"),
        ({"along": (0, np.nan, 1)}, "Pose.along.*must be finite"),
        ({"rotation": np.eye(3), "sigma": (1e-3, (1e-3, 1e-3))}, "Pose.sigma.*must be a pair"),
        ({"sigma": None}, "sigma = None .*must be given"),
        ({"covariance": np.eye(3)}, "Pose.sigma.*beside covariance"),
        ({"sigma": None, "covariance": np.eye(6)}, "Pose.covariance.*3"),
        ({"sigma": None, "covariance": -np.eye(3)}, "Pose.covariance must be symmetric and positive definite"),
        (
            {"sigma": None, "covariance": np.eye(3), "across": (0, 0, 1)},
            "Pose.covariance must not be .*give sigma",
        ),
    ],
)
def test_bad_markers(wire, options, message):
    with pytest.raises(ValueError, match=message):
        mr.estimate(mr.SingleRod(wire), unknown=PRIOR, measured=mr.Pose(**({"position": (0, 0, 0.2), "sigma": 1e-3} | options)))


def test_a_marker_is_no_target(wire):
    robot = mr.SingleRod(wire)
    for own in ({"at": 0.2}, {"sigma": 1e-3}):
        with pytest.raises(ValueError, match="target.*must be without sigma, covariance and at"):
            mr.reach(robot, mr.Pose(position=(0, 0, 0.2), **own), free=("rotation",))


@pytest.mark.parametrize(("made", "unknown"), [(tubes, "tip_force"), (legs, "tip_force"), (chain, "force")])
def test_forces_are_read_off_markers_at_once_and_in_a_loop(made, unknown):
    robot, given, count, at = made()
    truth = mr.solve(robot, robot.inputs(**given)).raise_if_failed()
    sensors = []
    for k in range(count):
        shape = truth.rod(k, nodes=2001)
        node = int(np.argmin(np.abs(shape.arclength - at)))
        pose = {"position": shape.position[node], "rotation": shape.rotation[node], "at": float(shape.arclength[node])}
        sensors.append(mr.Pose(**pose, rod=k, sigma=(1e-6, 1e-5)))
    value = getattr(truth.inputs, unknown)
    known = robot.inputs(**{name: own for name, own in given.items() if name != unknown})
    found = mr.estimate(robot, known, unknown={unknown: mr.Prior(0 * value, sigma=0.3)}, measured=sensors)
    # from zero to 1e-6 of what it may be
    np.testing.assert_allclose(found.raise_if_failed().value(unknown), value, atol=1e-6)
    meter = mr.Estimator(
        robot, dt=1e-2, unknown={unknown: mr.Walk(0.3)}, sensors=sensors, inputs=known, integrator=mr.RK45(rtol=1e-9, atol=1e-10)
    )
    for _ in range(3):
        sample = meter.step([(own.position, own.rotation) for own in sensors])
    np.testing.assert_allclose(sample.value(unknown), value, atol=1e-6)
    assert sample.integrations == 1
