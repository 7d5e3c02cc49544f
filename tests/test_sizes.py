"""A robot in other units of length and of force is the same robot: micrometres and kilometres, nanonewtons and giganewtons."""

import numpy as np
import pytest

import multirod as mr

pytestmark = pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
SIZES = [(1e-6, 1e-12), (1e-3, 1e-6), (1e4, 1e8)]  # units of length and of force over m and N
FORCES = np.random.default_rng(9).normal(size=(4, 3))
AROUND = np.radians([0, 120, 240])


def rod(length, force, own=0.3, EI=(0.05, 0.04), **more):
    stiffness = force * length**2 * np.array(EI)
    return mr.Rod(
        length=own * length, bending_stiffness=tuple(stiffness), torsional_stiffness=0.8 * float(stiffness.max()), **more
    )


def with_lines(length=1.0, force=1.0):
    """By displacement: one pulls, one pushes, one is slack."""
    kinds = [(mr.Tendon, {"driven": "displacement", "axial_stiffness": 2e3 * force}), (mr.PushRod, {})]
    kinds += kinds[:1]
    offsets = 0.01 * length * np.array([(1, 0), (0, 1), (-1, 0)])
    robot = mr.SingleRod(rod(length, force, lines=[kind(at, **own) for at, (kind, own) in zip(offsets, kinds, strict=True)]))
    displacement = 1e-3 * length * np.array([(1, 1, -1), (0.5, -1, -0.5), (1, 0.5, -1), (-1, 1, 1)])
    return robot, robot.inputs(tip_force=0.2 * force * FORCES, displacement=displacement)


def mast(length=1.0, force=1.0):
    """A rod on a plate on three legs, in balls."""

    def at(radius, angle):
        pose = np.eye(4)
        pose[:2, 3] = radius * length * np.array([np.cos(angle), np.sin(angle)])
        return pose

    plate, top = mr.Body("plate"), mr.Body("top")
    joints = [mr.Joint("mast", "base", to=plate), mr.Joint("mast", "tip", to=top)]
    for k, angle in enumerate(AROUND):
        joints.append(mr.Joint(f"leg {k}", "base", to=mr.ground, pose=at(0.08, angle)))
        joints.append(mr.Joint(f"leg {k}", "tip", to=plate, pose=at(0.06, angle), kind="spherical"))
    rods = {f"leg {k}": rod(length, force) for k in range(3)} | {"mast": rod(length, force)}
    robot = mr.Network(rods=rods, bodies=[plate, top], joints=joints)
    return robot, robot.inputs(force={"top": 0.2 * force * FORCES})


def pressed(length=1.0, force=1.0):
    """Clamped at both ends, its end on a slide, pressed to half its load, and twice."""
    robot = mr.HeldRod(rod(length, force), slide=(0, 0, 1))
    load = 4 * np.pi**2 * 0.04 / 0.3**2 * force
    return robot, robot.inputs(tip_force=load * np.array([(0, 0, -0.5), (0.01, 0, -1.2)]))


@pytest.mark.parametrize(("length", "force"), SIZES)
@pytest.mark.parametrize("make", [with_lines, mast, pressed])
def test_equilibria_and_their_stability_are_the_same(make, length, force):
    expected, found = mr.solve(*make()), mr.solve(*make(length, force))
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_array_equal(found.stability, expected.stability)
    assert (expected.stability == mr.Stability.STABLE).all()
    # to what the default tolerances leave, 1e-8, where a mode is soft ten times that
    np.testing.assert_allclose(found.tip_position / length, expected.tip_position, atol=1e-8)
    np.testing.assert_allclose(found.stability_margin, expected.stability_margin, rtol=1e-5)


@pytest.mark.parametrize(("length", "force"), SIZES[::2])
@pytest.mark.parametrize("make", [mast, pressed])
def test_critical_loads_are_the_same(make, length, force):
    loads = []
    for sizes in ((1.0, 1.0), (length, force)):
        robot, _ = make(*sizes)
        down = np.array([0, 0, -1.0]) * sizes[1]
        inputs = robot.inputs(force={"top": down}) if make is mast else robot.inputs(tip_force=down)
        loads.append(mr.critical_loads(robot, inputs)[0].load_factor)
    np.testing.assert_allclose(loads[1], loads[0], rtol=1e-7)  # each within 1e-9 of what is exact
