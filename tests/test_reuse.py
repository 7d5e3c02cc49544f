"""Problems that are kept between calls: nothing that went before shows in a result."""

import gc
from threading import Thread
from weakref import ref

import numpy as np
import pytest

import multirod as mr
from multirod.models.backbone.segments.segments import BackboneSegments
from multirod.models.backbone.stability.stability import OFTEN
from multirod.models.held.segments import HeldSegments
from multirod.problem import FEW, SMALL
from multirod.reuse import KEPT, MOST, ROOM
from multirod.studies.scenes import six_legs, three_tubes

WIRE = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0))
END = np.eye(4)
END[:3, 3] = 0.1, -0.05, 0.25  # where the end of the rod at rest is not
ROBOTS = {
    "rod": mr.SingleRod(WIRE),
    "tubes": three_tubes().robot,
    "legs": six_legs().robot,
    "held": mr.HeldRod(WIRE, end=END, slide=(0.2, 0, 1)),
}
SCENES = {
    "rod": [
        {"rotation": 0.1, "tip_force": (1, 0, 0)},
        {"rotation": -0.6, "tip_force": (0, 40, 9)},
        {"rotation": 0.1, "tip_force": (0, 0, -300)},
    ],
    "tubes": [
        {"rotation": (a, 0.1, 0.0), "translation": (-0.30, -0.22, -0.0945), "tip_force": force}
        for a, force in ((0.3, (0.1, 0.05, 0)), (2.9, (0.4, -0.2, 0.1)), (0.3, (0.2, 0, 0)))
    ],
    "held": [
        {"end_position": (x, 0.02, -0.02), "end_rotation": (0.3, -0.2, 0.5), "tip_force": (0, 0, z)}
        for x, z in ((0.01, -3.0), (0.03, 5.0), (0.01, -30.0))
    ],
    "legs": [{"tip_force": (x, 0, -8.0), "translation": [t, 0, 0, 0, 0, 0]} for x, t in ((1, 0), (-40, 0.01), (3, 0))],
}
QUESTIONS = ["status", "unknowns", "gamma", "tip_position", "iterations", "integrations", "stability_margin", "index"]


def answers(robot, values, solver=None):
    """All that is asked of a solution, as bytes."""
    solution = mr.solve(robot, robot.inputs(**values), solver=solver)
    found = [np.asarray(getattr(solution, name)) for name in QUESTIONS]
    found += [solution.jacobian(name) for name in ("tip_force", "rotation")]
    for nodes in (7, None):
        found += list(vars(solution.rod(0, nodes=nodes)).values())
    return [np.asarray(solution.energy).tobytes(), *(value.tobytes() for value in found)]


@pytest.mark.parametrize("solver", [None, mr.Shooting(tolerance=1e-6)], ids=["default", "coarse"])
@pytest.mark.parametrize("name", ROBOTS)
def test_what_went_before_does_not_show(name, solver):
    fresh = []
    for values in SCENES[name]:
        KEPT.forget()
        fresh.append(answers(ROBOTS[name], values, solver))
    KEPT.forget()
    for order in ((0, 1, 2), (2, 0, 1), (1, 1, 0)):
        for k in order:
            assert answers(ROBOTS[name], SCENES[name][k], solver) == fresh[k]


def test_what_went_before_does_not_show_in_networks():
    """What is known of the network taken apart is kept, and follows from no load and nothing that drives lines."""
    line = mr.Tendon(offset=(0.008, 0), driven="displacement", axial_stiffness=200.0)
    rod = mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, linear_density=0.02, lines=[line])
    aside = np.eye(4)
    aside[:3, 3] = 0.05, 0.02, 0.0
    plate = mr.Body("plate", mass=0.05)
    hinge = {"kind": "revolute", "axis": (1, 0, 0), "stiffness": 0.01}
    joints = [mr.Joint("one", "base", to=mr.ground), mr.Joint("two", "base", to=mr.ground, pose=aside)]
    joints += [mr.Joint("one", "tip", to=plate), mr.Joint("two", "tip", to=plate, pose=aside, **hinge)]
    robot = mr.Network(rods={"one": rod, "two": rod}, bodies=[plate], joints=joints)
    scenes = [
        {"rotation": turns, "displacement": {"one": pulled}, "force": {"plate": (x, 0, 0.3)}, "rod_force": {"two": (y, 0, 0)}}
        for turns, pulled, x, y in (((0.3, 0), 1e-3, 0.2, 0.5), ((0.3, 0), -5e-4, -0.4, 0.1), ((0, -0.2), 1e-3, 0.2, 0.5))
    ]

    def found(values):
        solution = mr.solve(robot, robot.inputs(**values)).raise_if_failed()
        own = [np.asarray(getattr(solution, name)) for name in (*QUESTIONS, "potential")]
        return [value.tobytes() for value in (*own, solution.jacobian("force"))]

    fresh = []
    for values in scenes:
        KEPT.forget()
        fresh.append(found(values))
    KEPT.forget()
    for k in (0, 1, 2, 0, 1, 1, 0):
        assert found(scenes[k]) == fresh[k]


def test_what_is_solved_often_is_judged_alike():
    robot, fresh = ROBOTS["tubes"], []
    for values in SCENES["tubes"]:
        KEPT.forget()
        fresh.append(answers(robot, values))
    for _ in range(OFTEN):
        for values, expected in zip(SCENES["tubes"], fresh, strict=True):
            assert answers(robot, values) == expected
    assert max(problem.renewals for _, problem, _ in KEPT._problems.values()) > OFTEN


@pytest.mark.parametrize("name", ROBOTS)
def test_results_keep_what_they_hold(name):
    robot = ROBOTS[name]
    first = mr.solve(robot, robot.inputs(**SCENES[name][0]))
    held = [first.unknowns, first.jacobian("tip_force"), *vars(first.rod(0)).values()]
    copies = [np.array(value) for value in held]
    answers(robot, SCENES[name][1])
    for value, copy in zip(held, copies, strict=True):
        np.testing.assert_array_equal(value, copy)


def batch_of(name, scenes, count):
    """Inputs of so many instances, which take the scenes in turn."""
    values = {key: np.array([SCENES[name][k].get(key) for k in scenes], dtype=float) for key in SCENES[name][scenes[0]]}
    if name == "rod":
        values["rotation"] = values["rotation"][:, None]
    return {key: np.resize(value, (count, value.shape[1])) for key, value in values.items()}


@pytest.mark.parametrize("name", ROBOTS)
def test_what_went_before_does_not_show_in_batches(name):
    batches = [batch_of(name, scenes, 2 * FEW) for scenes in ((0, 2), (1, 0), (2, 1))]
    fresh = []
    for values in batches:
        KEPT.forget()
        fresh.append(answers(ROBOTS[name], values))
    assert KEPT._problems
    for k in (1, 0, 0, 2, 1):
        assert answers(ROBOTS[name], batches[k]) == fresh[k]


def test_small_problems_are_kept_as_long_as_there_is_room_and_their_robot():
    KEPT.forget()
    robots = []
    for count in range(1, MOST + 8):
        robots.append(mr.SingleRod(mr.Rod(length=0.1 * count, bending_stiffness=1.0, torsional_stiffness=1.0)))
        mr.solve(robots[-1], robots[-1].inputs(tip_force=(0.1, 0, 0)))
    assert len(KEPT._problems) == MOST
    robot = ROBOTS["rod"]
    robots.clear()
    gc.collect()
    mr.solve(robot, robot.inputs(tip_force=(0.1, 0, 0)))
    assert {owner() for owner, _, _ in KEPT._problems.values()} == {robot}
    numbers = next(reversed(KEPT._problems.values()))[1].records.size
    for count in np.linspace(0.6, 0.9, 6) * SMALL / numbers:
        mr.solve(robot, robot.inputs(tip_force=np.full((int(count), 3), 0.1)), threads=1, progress=False)
        assert KEPT._size == sum(problem.records.size for _, problem, _ in KEPT._problems.values()) <= ROOM
    problem = robot.problem(robot.inputs(tip_force=np.zeros((SMALL // numbers + 1, 3))), integrator=mr.RK45())
    assert not problem.may_be_kept


def test_a_robot_that_takes_the_place_of_another_has_problems_of_its_own():
    tips = []
    for length in (0.2, 0.3):
        robot = mr.SingleRod(mr.Rod(length=length, bending_stiffness=1.0, torsional_stiffness=1.0))
        tips.append(mr.solve(robot, robot.inputs(tip_force=(0.1, 0, 0))).tip_position[2])
        del robot
        gc.collect()
    assert tips[0] < 0.2 < tips[1]


def test_an_error_leaves_no_problem_behind():
    class Failing(mr.Shooting):
        def _solve(self, problem, guess):
            problem.records.fill_(np.nan)
            raise ArithmeticError

    KEPT.forget()
    robot = ROBOTS["rod"]
    with pytest.raises(ArithmeticError):
        mr.solve(robot, solver=Failing())
    assert not KEPT._problems


def test_threads_have_problems_of_their_own():
    robot, found = ROBOTS["rod"], {}
    expected = [answers(robot, values) for values in SCENES["rod"]]

    def work(k):
        for _ in range(20):
            found.setdefault(k, []).append(answers(robot, SCENES["rod"][k]) == expected[k])

    threads = [Thread(target=work, args=(k,)) for k in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [all(found[k]) for k in range(3)] == [True] * 3


@pytest.mark.parametrize("name", ROBOTS)
def test_instances_of_a_batch_are_what_they_are_in_it(name):
    robot = ROBOTS[name]
    values = {key: np.array([scene.get(key, np.zeros(3)) for scene in SCENES[name]]) for key in SCENES[name][0]}
    if name == "rod":
        values["rotation"] = values["rotation"][:, None]
    solution = mr.solve(robot, robot.inputs(**values))
    shape, jacobian = solution.rod(0), solution.jacobian("tip_force")
    for _ in range(2):
        for k in (2, 0, 1):
            np.testing.assert_array_equal(solution[k].rod(0).position, shape.position[k])
            np.testing.assert_array_equal(solution[k].jacobian("tip_force"), jacobian[k])


@pytest.mark.parametrize("name", ["rod", "held"])
def test_segments_are_made_for_those_that_ask(name, monkeypatch):
    def refuse(*_):
        raise AssertionError("segments were made for a solve that has no use for them")

    KEPT.forget()
    for kind in (BackboneSegments, HeldSegments):
        monkeypatch.setattr(kind, "__init__", refuse)
    robot = ROBOTS[name]
    assert mr.solve(robot, robot.inputs(**SCENES[name][0])).status is mr.Status.CONVERGED
    KEPT.forget()


@pytest.mark.parametrize("name", ROBOTS)
def test_a_kept_problem_keeps_no_robot(name):
    robot = ROBOTS[name].with_rods(ROBOTS[name].rods)
    mr.solve(robot, robot.inputs(**SCENES[name][0]))
    there = ref(robot)
    del robot
    gc.collect()
    assert there() is None
