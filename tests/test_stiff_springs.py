"""Springs in joints that are many orders stiffer than the rods: solved as the clamps that they nearly are."""

import numpy as np
import pytest
from test_network import circle

import multirod as mr

STIFF = 1e9  # N m/rad and N/m, of rods of 0.1 and less
STEEL = {"young_modulus": 60e9, "shear_modulus": 23e9}
AXES = {"revolute": (0, 1, 0), "universal": np.eye(3)[:2], "prismatic": (0, 1, 0), "cylindrical": (0, 1, 0)}
LEG = mr.Rod.wire(length=0.3, diameter=2e-3, density=6450, **STEEL)


def held(rod, end, kind, **where):
    """A joint that hardly gives way."""
    if kind == "clamped":
        return mr.Joint(rod, end, **where)
    axis = {"axis": AXES[kind]} if kind in AXES else {}
    return mr.Joint(rod, end, kind=kind, stiffness=(STIFF, STIFF) if kind == "cylindrical" else STIFF, **axis, **where)


def six_legs(kind):
    """Six legs and a plate."""
    plate, joints = mr.Body("plate", mass=0.05), []
    for k, angle in enumerate(60.0 * np.arange(6)):
        sense = (-1) ** k
        joints.append(held(f"leg {k}", "base", kind, to=mr.ground, pose=circle([angle + 11 * sense], 0.08)[0]))
        joints.append(held(f"leg {k}", "tip", kind, to=plate, pose=circle([angle + 17 * sense], 0.06)[0]))
    return mr.Network(rods=dict.fromkeys((f"leg {k}" for k in range(6)), LEG), bodies=[plate], joints=joints)


@pytest.mark.parametrize("kind", ["universal", "revolute", "spherical", "prismatic", "cylindrical"])
def test_legs_on_stiff_springs_are_clamped(kind):
    """Torques over ``EI`` alone would leave 2105 integrations of universal joints, and the lowest energy, where 106 do."""
    clamped, sprung = six_legs("clamped"), six_legs(kind)
    given = {
        "force": {"plate": (0.3, 0.1, -1.0)},
        "translation": {"leg 0": 0.01, "leg 3": -0.005},
        "gravity": (0, 0, -9.81),
    }
    one, other = (mr.solve(robot, robot.inputs(**given)) for robot in (clamped, sprung))
    assert other.status is mr.Status.CONVERGED
    assert other.stability is mr.Stability.STABLE
    assert other.integrations <= 1.2 * one.integrations
    # springs give way by moments of 0.1 and forces of 1 over 1e9, and both are solved to residuals of 1e-9
    np.testing.assert_allclose(other.tip_position, one.tip_position, rtol=0, atol=1e-8)
    np.testing.assert_allclose(other.stability_margin, one.stability_margin, rtol=1e-6)
    np.testing.assert_allclose(other.jacobian("force"), one.jacobian("force"), rtol=0, atol=1e-6)


def frame(kind):
    """Two strips and a beam."""
    strip, beam, joints = mr.Rod(length=0.2, bending_stiffness=(0.5, 0.02), torsional_stiffness=0.015), mr.Body("beam"), []
    for name, angle in (("left", 180), ("right", 0)):
        joints.append(held(name, "base", kind, to=mr.ground, pose=circle([angle], 0.1)[0]))
        joints.append(held(name, "tip", kind, to=beam, pose=circle([angle], 0.1)[0]))
    return mr.Network(rods={"left": strip, "right": strip}, bodies=[beam], joints=joints)


def test_gamma_with_stiff_springs_is_as_regular_as_with_clamps():
    """Told over ``EI`` alone, torques make it 1e10 times as singular."""
    clamped, sprung = frame("clamped"), frame("universal")
    load = {"force": {"beam": (0.1, 0.05, -2.0)}}
    one, other = (mr.solve(robot, robot.inputs(**load)).raise_if_failed() for robot in (clamped, sprung))
    np.testing.assert_allclose(other.tip_position, one.tip_position, rtol=0, atol=1e-8)
    assert np.linalg.cond(other.gamma) < 10 * np.linalg.cond(one.gamma)


def test_a_frame_on_stiff_springs_sways_where_a_clamped_one_does():
    """The event at the same load, and the place to the same 1e-6 of the length that branches are found to."""
    force = {"beam": (0, 0, -1.1 * 2 * np.pi**2 * 0.02 / 0.2**2)}
    one, other = (mr.solve(robot, robot.inputs(force=force)) for robot in map(frame, ("clamped", "universal")))
    assert one.status is other.status is mr.Status.BIFURCATED
    assert other.integrations <= 1.2 * one.integrations
    np.testing.assert_allclose(other.events[0].load_factor, one.events[0].load_factor, rtol=1e-6)
    np.testing.assert_allclose(other.tip_position, one.tip_position, rtol=0, atol=2e-7)


def test_rods_on_stiff_springs_in_holes_are_clamped_there():
    """(37) Against rods that end on the disc and begin there anew: told in ``L/EI`` alone such springs were not solved."""
    inner = mr.Rod.wire(length=0.05, diameter=1e-3, **STEEL)
    half, whole = (mr.Rod.wire(length=length, diameter=8e-4, extensible=True, **STEEL) for length in (0.05, 0.1))
    found = []
    for cut in (False, True):
        disc, top = mr.Body("disc"), mr.Body("top")
        joints = [mr.Joint("inner 0", "base", to=mr.ground), mr.Joint("inner 0", "tip", to=disc)]
        joints += [mr.Joint("inner 1", "base", to=disc), mr.Joint("inner 1", "tip", to=top)]
        rods = {"inner 0": inner, "inner 1": inner}
        for k in range(3):
            place, lower, upper = circle([120 * k], 0.004)[0], f"rod {k}", f"upper {k}" if cut else f"rod {k}"
            rods |= {lower: half, upper: half} if cut else {lower: whole}
            joints += [mr.Joint(lower, "base", to=mr.ground, pose=place), mr.Joint(upper, "tip", to=top, pose=place)]
            if cut:
                joints += [mr.Joint(lower, "tip", to=disc, pose=place), mr.Joint(upper, "base", to=disc, pose=place)]
            else:
                hole = {"kind": "prismatic", "stiffness": STIFF}
                joints.append(mr.Joint(lower, "along", at=0.05, to=disc, pose=place, **hole))
        robot = mr.Network(rods=rods, bodies=[disc, top], joints=joints)
        found.append(mr.solve(robot, robot.inputs(force={"top": (0.1, 0, 0)})))
    sliding, ended = found
    assert sliding.status is ended.status is mr.Status.CONVERGED
    assert sliding.stability is mr.Stability.STABLE
    # the springs give way by newtons over 1e9, and the tip by that over what the rods are apart, 0.004 of 0.1
    np.testing.assert_allclose(sliding.tip_position, ended.tip_position, rtol=0, atol=1e-7)
