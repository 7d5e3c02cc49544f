"""The conformance kit for those who write assemblies, over the package's own robots and over the example's."""

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_conformance import SCENES, single_rod

import multirod as mr
from multirod.problem import BoundaryProblem
from multirod.testing import Nonconformance, check_assembly
from multirod.wrapped import WrappedProblem

EXAMPLES = Path(__file__).parent.parent / "examples"
WIRE = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0))
STRAIGHT = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638)


def example(name: str) -> Any:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("scene", "given", "tip_rod"),
    [("SingleRod", "tip force", 0), ("ConcentricTubes", "dead loads", 0), ("ParallelRods", "loads", None)],
)
def test_own_assemblies_conform(scene: str, given: str, tip_rod: int | None) -> None:
    robot = SCENES[scene].robot()
    inputs = robot.inputs(**SCENES[scene].inputs[given])[0]
    check_assembly(robot, inputs, tip_rod=tip_rod, vary=("tip_force", "rotation", "translation"))


def at(x: float = 0, y: float = 0, z: float = 0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def held_rod() -> tuple[mr.Assembly, mr.Inputs]:
    robot = mr.HeldRod(STRAIGHT, end=at(0.05, 0, 0.37))
    return robot, robot.inputs(distributed_force=(0.1, 0.2, 0))


def eccentric_tubes() -> tuple[mr.Assembly, mr.Inputs]:
    def tube(outer: float, inner: float, curvature: float) -> mr.Rod:
        sizes = {"length": 0.15, "outer_diameter": outer, "inner_diameter": inner}
        return mr.Rod.tube(**sizes, young_modulus=60e9, shear_modulus=23e9, precurvature=(0, curvature, 0))

    robot = mr.EccentricTubes([tube(1e-3, 0.7e-3, 5), tube(1.2e-3, 0.8e-3, -3)], offsets=[(1e-3, 0), (-1e-3, 0)])
    return robot, robot.inputs(tip_force=(0.05, 0.02, 0))


def tendons() -> tuple[mr.Assembly, mr.Inputs]:
    lines = [mr.Tendon(offset=(0.008 * np.cos(a), 0.008 * np.sin(a))) for a in (0, 2.1, 4.2)]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines))
    return robot, robot.inputs(tension=(1.5, 0.7, 0.5), tip_force=(0.1, 0.05, 0))


def network() -> tuple[mr.Assembly, mr.Inputs]:
    top = mr.Body("top", mass=0.02)
    places = {"left": at(-0.05), "right": at(0.05)}
    joints = [mr.Joint(name, "base", to=mr.ground, pose=pose) for name, pose in places.items()]
    joints += [mr.Joint(name, "tip", to=top, pose=pose) for name, pose in places.items()]
    robot = mr.Network(rods=dict.fromkeys(places, STRAIGHT), bodies=[top], joints=joints, end_effector=top)
    return robot, robot.inputs(force={"top": (0.3, 0.2, 0)}, gravity=(0, 0, -9.81))


@pytest.mark.parametrize("made", [held_rod, eccentric_tubes, tendons, network])
def test_other_own_assemblies_conform(made: Callable[[], tuple[mr.Assembly, mr.Inputs]]) -> None:
    robot, inputs = made()
    check_assembly(robot, inputs, tip_rod=0 if made is tendons else None)


@pytest.mark.parametrize("inputs", [{"tip_force": (0.3, 0.2, 0.1), "rotation": 0.4}, {"follower_force": (0.2, 0.1, 0)}])
def test_the_example_conforms(inputs: dict[str, Any]) -> None:
    robot = example("new_assembly").SprungRod(WIRE, spring=0.05)
    check_assembly(robot, robot.inputs(**inputs), vary=("tip_force", "rotation", "translation"))


class Wrong(WrappedProblem):
    """A clamped rod that is wrong in one way."""

    def __init__(self, inner: BoundaryProblem, way: str, direction_count: int) -> None:
        super().__init__(inner, direction_count=direction_count)
        self.way = way

    def around(self, inner: BoundaryProblem, instances: np.ndarray) -> "Wrong":
        return Wrong(inner, self.way, self.direction_count)

    def guess(self) -> np.ndarray:
        return super().guess() + (0.1 if self.way == "guess" else 0.0)

    def load_scale(self) -> np.ndarray:
        if self.way == "questions":
            self.load_factor.fill_(0.5)
        return super().load_scale()

    def inner_inputs(self, unknowns: np.ndarray) -> np.ndarray:
        inputs = super().inner_inputs(unknowns)
        if self.way == "batches":
            inputs[:, 0] += unknowns[:, 0].sum()
        return inputs

    def _corrected(self, gamma: np.ndarray, directions: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gamma, pose = super()._corrected(gamma, directions, pose)
        return gamma * (1.001 if self.way == "derivatives" else 1.0), pose * (1.001 if self.way == "pose" else 1.0)


class WrongRod(mr.Assembly):
    def __init__(self, way: str) -> None:
        self.right, self.way = mr.SingleRod(WIRE), way
        self.rods = self.right.rods

    @property
    def input_specs(self) -> tuple[mr.InputSpec, ...]:
        return self.right.input_specs

    def problem(self, inputs: mr.Inputs, *, direction_count: int = 0, **options: Any) -> Wrong:
        return Wrong(self.right.problem(inputs, direction_count=direction_count, **options), self.way, direction_count)


@pytest.mark.parametrize(
    ("way", "said"),
    [
        ("guess", "guess: at a load_factor of 0 the residual of guess"),
        ("questions", "questions: asking for load_scale changes load_factor"),
        ("batches", "batches: the residual of instance 0 of a batch, against it alone"),
        ("derivatives", r"derivatives: Gamma at the equilibrium\["),
        ("pose", "derivatives: pose_columns of the position"),
    ],
)
def test_what_is_wrong_is_named(way: str, said: str) -> None:
    robot = WrongRod(way)
    with pytest.raises(Nonconformance, match=said):
        check_assembly(robot, robot.inputs(tip_force=(0.3, 0.2, 0.1)), vary=("tip_force",), solvers=("shooting",))


def test_loads_and_instances_within_are_as_they_were() -> None:
    robot = WrongRod("in no way")
    inputs = robot.inputs(tip_force=0.1 * np.eye(3))
    problem = robot.problem(inputs, integrator=mr.RK4(20))
    problem.write("unknowns", problem.guess())
    problem.residual.fill_(np.nan)
    with problem.at_load(0.5), problem.only(np.array([True, False, True])):
        problem.integrate()
        assert problem.load_scale().shape == (3,)
    assert np.isfinite(problem.read("residual")).all(axis=1).tolist() == [True, False, True]
    for buffer in (problem.inner.load_factor, problem.inner.active):
        np.testing.assert_array_equal(buffer.numpy(), 1)
    assert problem.inner.listed == 3


def test_a_batch_is_refused() -> None:
    robot = single_rod()
    with pytest.raises(ValueError, match="takes one instance"):
        check_assembly(robot, robot.inputs(tip_force=np.zeros((2, 3))))


def test_inputs_say_what_they_mean() -> None:
    specs = {spec.name: spec for spec in single_rod().input_specs}
    assert {name: spec.power for name, spec in specs.items() if spec.load} == {
        "tip_force": 2,
        "tip_moment": 1,
        "follower_force": 2,
        "follower_moment": 1,
        "distributed_force": 3,
        "distributed_moment": 2,
        "gravity": 3,
        "magnetic_field": 2,
    }
    conservative = {"tip_force", "distributed_force", "gravity", "magnetic_field"}
    assert {name for name, spec in specs.items() if spec.potential} == conservative
    assert [specs[name].size(3) for name in ("rotation", "tip_force")] == [3, 3]
