"""Derivatives along the rods of networks, against differences of solves, and what is read from gratings on them."""

import numpy as np
import pytest
from test_network import pose

import multirod as mr
from multirod.rotations import vectors

SOLVER = mr.Shooting(tolerance=1e-12, integrator=mr.RK4(50))
NODES, NODE = 11, 6
WIRE = mr.Rod.wire(length=0.3, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9, density=6450)
FINGER = mr.Rod(length=0.15, bending_stiffness=0.02, torsional_stiffness=0.015, lines=[mr.Tendon(offset=(0.006, 0.002))])
GIVEN = {
    "force": np.array([[0.0, 0, 0], [0.2, 0.1, 0], [0, 0, 0]]),
    "rotation": np.array([0.1, 0.2, 0.0, 0.0]),
    "angle": np.array([0.2]),
    "tension": np.array([1.0]),
    "gravity": np.array([0.0, 0.5, -9.81]),
}


@pytest.fixture(scope="module")
def robot():
    """Two legs hold a plate; a mast, whose joint is driven, and a finger with a tendon, whose joint is sprung, stand on it."""
    plate, top = mr.Body("plate", mass=0.05), mr.Body("top")
    joints = [
        mr.Joint("left", "base", to=mr.ground, pose=pose((0, 0, 0), (-0.08, 0, 0))),
        mr.Joint("left", "tip", to=plate, pose=pose((0, 0, 0), (-0.06, 0, 0))),
        mr.Joint("right", "base", to=mr.ground, pose=pose((0, 0, 0), (0.08, 0, 0))),
        mr.Joint("right", "tip", to=plate, pose=pose((0, 0, 0), (0.06, 0, 0)), kind="spherical"),
        mr.Joint("mast", "base", to=plate, kind="revolute", axis=(0, 1, 0), driven=True),
        mr.Joint("mast", "tip", to=top),
        mr.Joint(
            "finger",
            "base",
            to=plate,
            pose=pose((0.2, 0, 0), (0, 0.03, 0.01)),
            kind="universal",
            axis=np.eye(3)[:2],
            stiffness=0.4,
        ),
    ]
    rods = {"left": WIRE, "right": WIRE, "mast": WIRE, "finger": FINGER}
    return mr.Network(rods=rods, bodies=[plate, top], joints=joints, end_effector=top)


@pytest.mark.parametrize("name", list(GIVEN))
def test_columns_along_rods_are_those_of_differences(robot, difference, name):
    """(D21) At the middle of a rod on the ground, of one whose joint is driven and of one with a line whose base swings."""
    found = mr.solve(robot, robot.inputs(**GIVEN), solver=SOLVER).raise_if_failed()
    rng = np.random.default_rng(list(GIVEN).index(name))
    way = rng.standard_normal(GIVEN[name].shape)
    for rod in ("left", "mast", "finger"):
        here = found.rod(rod, nodes=NODES)

        def there(t, rod=rod, here=here):
            moved = GIVEN | {name: GIVEN[name] + t * way}
            moved_to = mr.solve(robot, robot.inputs(**moved), solver=SOLVER, guess=found)
            own = moved_to.rod(rod, nodes=NODES)
            turn = vectors(own.rotation[NODE : NODE + 1] @ here.rotation[NODE].T)[0]
            carried = moved_to.along(float(here.arclength[NODE]), of="wrench", rod=rod)
            return np.concatenate([own.position[NODE], turn, own.curvature[NODE], carried])

        expected = difference(there, 0.02)
        for k, of in enumerate(("position", "rotation", "curvature", "wrench")):
            columns = found.jacobian(name, of=of, at=float(here.arclength[NODE]), rod=rod)
            own = expected[3 * k : 3 * k + len(columns)]
            # what rounding and the sixth order leave of differences
            np.testing.assert_allclose(columns @ way.reshape(-1), own, rtol=0, atol=1e-8 * max(1.0, np.abs(own).max()))


def test_a_force_is_read_from_gratings_on_rods_of_a_network(robot):
    """A force on the plate and one on the body on top of the mast, alone and from an estimator's sample."""
    at = np.array([0.05, 0.1, 0.14])
    real = mr.solve(robot, robot.inputs(**GIVEN), solver=SOLVER).raise_if_failed()
    sensors = []
    for rod in ("left", "mast", "finger"):
        shape = real.rod(rod, nodes=401)
        value = np.array([np.interp(at, shape.arclength, shape.curvature[:, k]) for k in range(2)]).T
        sensors.append(mr.Curvature(at=at, value=value, sigma=1e-3, rod=rod))
    known = {name: value for name, value in GIVEN.items() if name != "force"}
    found = mr.estimate(robot, robot.inputs(**known), unknown={"force": mr.Prior(0, sigma=1.0)}, measured=sensors)
    spread = np.sqrt(np.diag(found.raise_if_failed().covariance("force")))
    error = np.abs(found.value("force").reshape(-1) - GIVEN["force"].reshape(-1))
    # curvatures between nodes are off by far less than their sigma
    assert (error < spread).all()
    assert (spread[3:5] < 0.01).all()


def test_the_load_of_one_body_is_read_along_rods_too(robot):
    """By what each sensor sees: as of a prior that knows what acts on the others; from an estimator's sample likewise."""
    real = mr.solve(robot, robot.inputs(**GIVEN), solver=SOLVER).raise_if_failed()
    held = real.wrench("left")
    sensors = [
        mr.Curvature(at=0.1, value=real.along(0.1, of="curvature", rod="mast"), sigma=1e-2, rod="mast"),
        mr.Pose(position=real.along(0.2, rod="mast"), at=0.2, rod="mast", sigma=1e-4),
        mr.ForceTorque(force=held.force, moment=held.moment, sigma=(1e-2, 1e-3), rod="left"),
        mr.Tension(value=real.tension, sigma=1e-2),
    ]
    known = robot.inputs(**{name: value for name, value in GIVEN.items() if name != "force"})
    prior, sure = mr.Prior(0, sigma=0.5), np.array([1e-9] * 3 + [0.5] * 3 + [1e-9] * 3)
    for sensor in sensors:
        options = {"measured": sensor, "solver": SOLVER}
        named = mr.estimate(robot, known, unknown={"force": {"top": prior}}, **options).raise_if_failed()
        every = mr.estimate(robot, known, unknown={"force": mr.Prior(0, sigma=sure)}, **options).raise_if_failed()
        # both end within a hundredth of a deviation
        np.testing.assert_allclose(named.value("force"), every.value("force")[3:6], atol=0.02 * named.sigma("force").max())
        np.testing.assert_allclose(named.covariance("force"), every.covariance("force")[3:6, 3:6], atol=1e-2 * 0.5**2)
    walks = {"force": {"top": mr.Walk(0.3, start=prior)}}
    meter = mr.Estimator(robot, dt=0.01, inputs=known, unknown=walks, sensors=sensors[:1], integrator=SOLVER.integrator)
    first = meter.step([sensors[0].value[0]])
    named = mr.estimate(robot, known, unknown={"force": {"top": prior}}, measured=sensors[0], solver=SOLVER)
    np.testing.assert_allclose(first.value("force"), named.value("force"), atol=0.02 * named.sigma("force").max())
    assert meter.step([sensors[0].value[0]]).status == mr.Status.TRACKING


def test_rods_that_slide_have_no_place_at_an_arclength():
    joints = [
        mr.Joint("wire", "base", to=mr.ground),
        mr.Joint("wire", "along", at=0.1, to=mr.ground, pose=pose((0, 0, 0), (0, 0, 0.1)), kind="prismatic"),
    ]
    robot = mr.Network(rods={"wire": WIRE}, joints=joints)
    held = mr.solve(robot, robot.inputs(force={"wire": (0.1, 0, 0)}), solver=SOLVER).raise_if_failed()
    with pytest.raises(NotImplementedError, match="along 'wire' are not known: it slides through holes"):
        held.jacobian("force", of="position", at=0.2)
