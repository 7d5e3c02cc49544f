"""Networks that are loose at one place: bodies move though no rod is bent."""

from itertools import pairwise

import numpy as np
import pytest
from test_network_rods import at

import multirod as mr
from multirod.solvers.following.serving.rounds import Rounds

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
    assert "turns a joint on and on" in mr.Status.LOOSE.message
    found = mr.solve(robot, robot.inputs(joint_torque={"post tip": 0.04}, force={"crank": (0.1, 0.05, -0.1)}))
    assert found.status is mr.Status.LOOSE
    assert found.integrations < 4500  # of which 1500 looked for rest elsewhere
    with pytest.raises(mr.SolveError, match=r"\(nothing holds joint 'post tip' against turning\)$"):
        found.raise_if_failed()


def on_two_rails(**spring):
    """A link between a rail on the ground and one on a plate that a post carries, which are nearly side by side."""
    plate, rod = mr.Body("plate"), mr.Rod(length=0.3, bending_stiffness=0.05, torsional_stiffness=0.04)
    rail = {"kind": "prismatic", "pose": at(x=0.1)}
    joints = [
        mr.Joint("post", "base", to=mr.ground),
        mr.Joint("post", "tip", to=plate),
        mr.Joint("link", "base", to=mr.ground, axis=(1, 0, 0), **rail),
        mr.Joint("link", "tip", to=plate, axis=(1, 0.2, 0), **rail, **spring),
    ]
    return mr.Network(rods={"post": rod, "link": rod}, bodies=[plate], joints=joints)


def test_what_slides_away_is_said_to():
    """The post turns until rails are side by side, which costs no more than that; a link that hardly is pushed does not do so."""
    robot = on_two_rails()

    def pushed(force):
        return mr.solve(robot, robot.inputs(slide_force={"link base": force}, force={"plate": (0, 0.3, -0.2)}))

    assert pushed(0.01).status is mr.Status.CONVERGED
    found = pushed(1.0)
    assert found.status is mr.Status.LOOSE
    assert "slides it away" in found.status.message
    with pytest.raises(mr.SolveError, match=r"\(nothing holds joint 'link base' along its slide, nor joint 'link tip' along"):
        found.raise_if_failed()
    assert found.integrations < 2500
    moment = {"plate": (0, 0.001, 0.002)}  # which has no potential
    turned = mr.solve(robot, robot.inputs(slide_force={"link base": 1.0}, force={"plate": (0, 0.3, -0.2)}, moment=moment))
    assert turned.status is mr.Status.LOOSE


def test_what_slides_far_on_a_soft_spring_comes_to_rest():
    robot = on_two_rails(stiffness=0.2)
    rests = mr.solve(robot, robot.inputs(slide_force={"link base": 1.0}, force={"plate": (0, 0.3, -0.2)}))
    assert rests.status is mr.Status.CONVERGED
    assert rests.stability is mr.Stability.STABLE
    assert float(rests.joint_slide("link tip")) == pytest.approx(1.0 / 0.2, rel=0.01)  # the push over the stiffness, nearly


def test_what_turns_on_and_on_is_told_from_what_is_wound_up():
    """(26) of docs/branches.md, on a circle whose first unknown is an angle, and what others tell the last; and on a helix."""
    periods = np.array([[0.2, np.inf, np.inf, 0.0]])

    def turns_until_told(rise):
        def place(t):
            return np.array([[0.2 * t, np.cos(2 * np.pi * t) + rise * t, np.sin(2 * np.pi * t), 5 * t]])

        rounds = Rounds(periods, place(0))
        rounds.since(place(0.013))
        steps = np.arange(0.02, 4, 0.016)
        told = [t for last, t in pairwise(steps) if rounds.passes(np.array([0]), place(last), place(t))[0]]
        return told[0] if told else None

    assert turns_until_told(0.0) == pytest.approx(1.013, abs=0.017)
    assert turns_until_told(0.003) == pytest.approx(1.013, abs=0.017)
    assert turns_until_told(0.02) is None
    assert Rounds(np.zeros((1, 0)), np.zeros((1, 4))).times == 1


def test_what_slides_away_is_told_from_what_changes_as_it_does():
    """(28) of docs/branches.md: the first unknown slides, and what others tell is the last."""

    def slides_until_told(rise, way=1.0):
        def place(t):
            return np.array([[way * t, rise * t, 0.0, 5 * t]])

        rounds = Rounds(np.array([[-3.0, np.inf, np.inf, 0.0]]), place(0))
        steps = np.arange(0.0, 6, 0.1)
        told = [t for last, t in pairwise(steps) if rounds.passes(np.array([0]), place(last), place(t))[0]]
        return told[0] if told else None

    assert slides_until_told(0.0) == pytest.approx(3.05, abs=0.06)
    assert slides_until_told(0.05, way=-1.0) == pytest.approx(3.05, abs=0.06)
    assert slides_until_told(0.2) is None  # what holds it may grow with that
