"""Networks that are loose at one place: bodies move though no rod is bent."""

from itertools import pairwise

import numpy as np
import pytest
from test_network_rods import at

import multirod as mr
from multirod.solvers.following.downhill import _Rounds

WIRE = mr.Rod.wire(length=0.3, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9)


def swing(**hinge):
    """Two rods between parallel hinges, and a wire on the body that they carry, which moves with it."""
    body, top = mr.Body("table"), mr.Body("top")
    hinge = {"kind": "revolute", "axis": (0, 1, 0)} | hinge
    joints = [
        mr.Joint(f"leg {k}", end, to=to, pose=at(x=x), **hinge)
        for k, x in enumerate((-0.1, 0.1))
        for end, to in (("base", mr.ground), ("tip", body))
    ]
    joints += [mr.Joint("mast", "base", to=body), mr.Joint("mast", "tip", to=top)]
    short = mr.Rod.wire(length=0.05, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9)
    return mr.Network(rods={"leg 0": WIRE, "leg 1": WIRE, "mast": short}, bodies=[body, top], joints=joints)


def three_legs():
    plate = mr.Body("plate")
    universal = {"kind": "universal", "axis": np.eye(3)[:2]}
    angles = np.radians([0, 120, 240])
    joints = [
        mr.Joint(f"leg {k}", end, to=to, pose=at(0.1 * np.cos(a), 0.1 * np.sin(a)), **universal)
        for k, a in enumerate(angles)
        for end, to in (("base", mr.ground), ("tip", plate))
    ]
    return mr.Network(rods={f"leg {k}": WIRE for k in range(3)}, bodies=[plate], joints=joints)


@pytest.mark.parametrize(("made", "names"), [(swing, ("table", "top")), (three_legs, ("plate",))])
def test_mechanisms_are_told_at_once_and_name_what_moves(made, names):
    robot = made()
    found = mr.solve(robot, robot.inputs())
    assert found.status is mr.Status.LOOSE
    assert found.status.failed
    assert found.integrations < 100  # of thousands that other ways are given
    with pytest.raises(mr.SolveError, match=rf"LOOSE .* a mechanism.*\(body '({'|'.join(names)})' moves most\)"):
        found.raise_if_failed()


@pytest.mark.parametrize("moment", [(0.02, 0.05, -0.01), (0.05, 0.01, 0.02)])
def test_what_is_said_of_mechanisms_under_moments_is_bounded(moment):
    """Moments have no potential, and without loads nothing rests: no search goes there, nor beyond what is allowed."""
    robot = swing()
    inputs = robot.inputs(moment={"table": moment}, force={"table": (0.1, -0.2, 0.1)})
    found = mr.solve(robot, inputs)
    assert found.status in (mr.Status.LOOSE, mr.Status.DAMPED)
    assert found.integrations < 3800  # as many and 4200 of a search among what rests without loads before
    few = mr.solve(robot, inputs, solver=mr.Shooting(max_integrations=300))
    assert few.integrations <= 310  # and the few that judge


def test_what_loads_or_springs_hold_is_solved():
    robot = swing()
    hung = mr.solve(robot, robot.inputs(force={"table": (0, 0, 0.5)})).raise_if_failed()
    np.testing.assert_allclose(hung.body_position("table"), (0, 0, 0.3), atol=1e-9)  # straight up, as rods do not stretch
    robot = swing(stiffness=0.1)
    assert mr.solve(robot, robot.inputs()).status is mr.Status.CONVERGED


def test_a_torque_that_turns_a_crank_on_and_on_is_said_to():
    """A crank on a post, and a link beside it that lets it pass where the torque bends both enough."""
    crank = mr.Body("crank")
    lengths = {"post": 0.2, "link": 0.22}
    rods = {name: mr.Rod(length=own, bending_stiffness=0.2, torsional_stiffness=0.15) for name, own in lengths.items()}
    joints = [
        mr.Joint("post", "base", to=mr.ground),
        mr.Joint("post", "tip", to=crank, kind="revolute", axis=(0, 0, 1)),
        mr.Joint("link", "base", to=mr.ground, pose=at(x=0.05)),
        mr.Joint("link", "tip", to=crank, pose=at(x=0.03), kind="spherical"),
    ]
    robot = mr.Network(rods=rods, bodies=[crank], joints=joints)
    torque = np.array([0, 0.03, 0.04])
    inputs = robot.inputs(joint_torque={"post tip": torque}, force={"crank": (0.1, 0.05, -0.1)})
    history = mr.simulate(robot, inputs, time=0.1 * np.arange(3))
    assert [mr.Status(own) for own in history.status] == [mr.Status.BIFURCATED, mr.Status.CONVERGED, mr.Status.LOOSE]
    assert "turns on and on" in mr.Status.LOOSE.message


def test_what_turns_on_and_on_is_told_from_what_is_wound_up():
    """(26) of docs/branches.md, on a circle whose first unknown is an angle, and what others tell the last; and on a helix."""
    periods = np.array([[0.2, np.inf, np.inf, 0.0]])

    def turns_until_told(rise):
        def place(t):
            return np.array([[0.2 * t, np.cos(2 * np.pi * t) + rise * t, np.sin(2 * np.pi * t), 5 * t]])

        rounds = _Rounds(periods, place(0))
        rounds.since(place(0.013))
        steps = np.arange(0.02, 4, 0.016)
        told = [t for last, t in pairwise(steps) if rounds.passes(np.array([0]), place(last), place(t))[0]]
        return told[0] if told else None

    assert turns_until_told(0.0) == pytest.approx(1.013, abs=0.017)
    assert turns_until_told(0.003) == pytest.approx(1.013, abs=0.017)
    assert turns_until_told(0.02) is None
    assert _Rounds(np.zeros((1, 0)), np.zeros((1, 4))).times == 1
