"""How lengths and tensions of lines vary by inputs and by the rods' own numbers, where rods hold each other: by differences."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

import multirod as mr

PRECISE = mr.Shooting(tolerance=1e-10, integrator=mr.RK45(rtol=1e-11, atol=1e-13))
LENGTH, LEVER = 0.2, 0.006
FORCE = np.array([0.3, 0.2, -0.4])
DISPLACEMENT = 3e-3  # by which a line is shorter than at rest, so that it is taut [m]
NUMBERS = {"bending_stiffness": (0.01, 0.011), "torsional_stiffness": (0.0077,)}
Build = Callable[..., mr.Assembly]


def rods(count: int, name: str = "", number: int = 0, change: float = 0.0) -> list[mr.Rod]:
    """Of a line that is pulled and one that is driven by its length each; of one of them a number is changed."""
    made = []
    for k in range(count):
        values = {key: np.array(value) for key, value in NUMBERS.items()}
        if name and number // len(NUMBERS[name]) == k:
            values[name][number % len(NUMBERS[name])] += change
        lines = [mr.Tendon((LEVER, 0)), mr.Tendon((0, LEVER), driven="displacement", axial_stiffness=200.0)]
        stiffness = {"bending_stiffness": values["bending_stiffness"], "torsional_stiffness": values["torsional_stiffness"][0]}
        made.append(mr.Rod(length=LENGTH, precurvature=(2, 1, 0.5), lines=lines, **stiffness))
    return made


def at(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def legs(*change: object) -> mr.ParallelRods:
    angles = np.arange(3) * 2 * np.pi / 3
    base, platform = (np.stack([at(r * np.cos(a), r * np.sin(a)) for a in angles]) for r in (0.06, 0.03))
    return mr.ParallelRods(legs=rods(3, *change), base=base, platform=platform)


def held(*change: object) -> mr.HeldRod:
    return mr.HeldRod(rods(1, *change)[0], end=at(0.03, 0, 0.19))


TOP = mr.Body("top")


def network(*change: object) -> mr.Network:
    a, b = rods(2, *change)
    joints = [
        mr.Joint("a", "base", to=mr.ground),
        mr.Joint("b", "base", to=mr.ground, pose=at(0.05)),
        mr.Joint("a", "tip", to=TOP),
        mr.Joint("b", "tip", to=TOP, pose=at(0.05), kind="revolute", axis=(0, 1, 0)),
    ]
    return mr.Network(rods={"a": a, "b": b}, bodies=[TOP], joints=joints, end_effector=TOP)


GIVEN: dict[str, tuple[Build, dict[str, object]]] = {
    "legs": (legs, {"tension": np.array([1.0, 0.5, 0.8]), "displacement": np.full(3, DISPLACEMENT), "tip_force": FORCE}),
    "held": (held, {"tension": np.array([1.0]), "displacement": np.full(1, DISPLACEMENT)}),
    "network": (network, {"tension": np.array([1.0, 0.7]), "displacement": np.full(2, DISPLACEMENT), "force": {"top": FORCE}}),
}


def found(build: Build, given: dict[str, object]) -> np.ndarray:
    """Lengths and tensions of all lines, (2, line)."""
    robot = build()
    solution = mr.solve(robot, robot.inputs(**given), solver=PRECISE).raise_if_failed()
    return np.stack([solution.line_length, solution.tension])


def compare(robot: mr.Assembly, given: dict[str, object], name: str, ahead: list[np.ndarray], behind: list[np.ndarray], h: float):
    solution = mr.solve(robot, robot.inputs(**given), solver=PRECISE).raise_if_failed()
    assert (solution.tension > 0.1).all()
    for k, of in enumerate(("line_length", "tension")):
        J = solution.jacobian(name, of=of).reshape(len(solution.tension), -1)
        slopes = np.stack([(a[k] - b[k]) / (2 * h) for a, b in zip(ahead, behind, strict=True)], axis=1)
        # differences are off by the square of their step, and by the tolerance of two solves over it
        np.testing.assert_allclose(J, slopes, atol=2e-4 * max(np.abs(slopes).max(), 1e-9))


DRIVEN = {"tension": 1e-3, "displacement": 1e-6}
STIFFNESS_STEP = 1e-6


def compare_all(robot: str, name: str) -> None:
    build, given = GIVEN[robot]
    step, sides = DRIVEN.get(name, STIFFNESS_STEP), []
    for sign in (1, -1):
        if name in DRIVEN:
            values = given[name]
            sides.append([found(build, given | {name: values + sign * step * e}) for e in np.eye(len(values))])
        else:
            count = len(build().rods) * len(NUMBERS[name])
            sides.append([found(partial(build, name, k, sign * step), given) for k in range(count)])
    compare(build(), given, name, *sides, step)


@pytest.mark.parametrize("name", [*DRIVEN, *NUMBERS])
def test_of_a_held_rod(name):
    compare_all("held", name)


@pytest.mark.parametrize("name", [*DRIVEN, *NUMBERS])
@pytest.mark.parametrize("robot", ["legs", "network"])
def test_of_rods_that_hold_bodies(robot, name):
    compare_all(robot, name)


@pytest.mark.parametrize("robot", GIVEN)
def test_by_lengths_they_are_not_known(robot):
    with pytest.raises(NotImplementedError, match="with lines are not known: where these end moves too"):
        GIVEN[robot][0]().input_directions("length")


def at_rest(count: int) -> mr.SingleRod:
    """A straight rod between tendons that are held by their lengths at rest."""
    angles = 2 * np.pi * np.arange(count) / count
    offsets = LEVER * np.column_stack([np.cos(angles), np.sin(angles)])
    lines = [mr.Tendon(offset, driven="displacement", axial_stiffness=2000.0) for offset in offsets]
    return mr.SingleRod(mr.Rod(length=LENGTH, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines))


def test_at_rest_a_rod_is_as_stiff_as_what_tightens_to_either_side():
    """(D1b) Beside a tendon of stiffness k at a, a straight rod gives way by L^3/3EI less the part that the tendon takes."""
    robot = at_rest(4)
    forces = [(0, 0, 0), (0.5, 0, 0)]
    both = mr.solve(robot, robot.inputs(tip_force=forces), solver=PRECISE)
    EI, a, k = 0.01, LEVER, 2000.0
    stiffer = EI + k * a**2  # of a section under a constant moment, which tendon and rod share
    taken = (1 - EI / stiffer) * (LENGTH**2 / 2) ** 2 / (EI * LENGTH)  # by the tendon's one tension
    alone = LENGTH**3 / (3 * EI)
    compliance = both[0].jacobian("tip_force")
    np.testing.assert_allclose(compliance[:2, :2], (alone - taken) * np.eye(2), rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(both.jacobian("tip_force")[1], both[1].jacobian("tip_force"))
    direction = np.array([1.0, 2, 0, 0, 0, 3])
    product = both[0].vjp(direction, of="tip_pose", wrt="tip_force")["tip_force"]
    np.testing.assert_allclose(product, compliance.T @ direction, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(both[0].jacobian("displacement"), 0)  # of letting them out


def test_at_rest_a_rod_that_is_stiffer_to_one_side_has_no_compliance():
    robot = at_rest(3)
    solution = mr.solve(robot, robot.inputs(tip_force=(0, 0, 0)))
    with pytest.warns(RuntimeWarning, match="by tip_force are NaN: lines are neither taut nor slack"):
        compliance = solution.jacobian("tip_force")
    assert np.isnan(compliance[:, :2]).all()
    np.testing.assert_allclose(compliance[:, 2], 0, atol=1e-9)  # along itself it does not give way, whatever pulls
    pulled = mr.solve(robot, robot.inputs(displacement=1e-3, tip_force=(0, 0, 0)))
    assert np.isfinite(pulled.jacobian("tip_force")).all()
