"""The same on a GPU as on the processor; where there is none, on the processor as if it were one (tests/machine/elsewhere.py)."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp

import multirod as mr
from multirod.studies.scenes import load

sys.path.insert(0, str(Path(__file__).parent / "machine"))
from elsewhere import elsewhere

RK4 = mr.RK4(50)
NEWTON, OBSERVER = mr.Shooting(integrator=RK4), mr.Observer(feed_forward=True, integrator=RK4)


@pytest.fixture
def gpu() -> Iterator[str]:
    if wp.is_cuda_available():
        yield "cuda"
    else:
        with elsewhere() as device:
            yield device


def agree(found: Callable[[str], dict[str, Any]], gpu: str) -> None:
    """What is found there is what is found here: fused multiply-adds differ, nothing else does."""
    here, there = found("cpu"), found(gpu)
    for name, value in here.items():
        np.testing.assert_allclose(there[name], value, rtol=1e-8, atol=1e-9, err_msg=name)


def all_of(solution: mr.Solution) -> dict[str, Any]:
    return {
        "status": solution.status,
        "tip": solution.tip_position,
        "shape": solution.rod(0).position,
        "jacobian": solution.jacobian("tip_force"),
        "stability": solution.stability,
        "energy": solution.energy,
    }


def forces(count: int) -> np.ndarray:
    return np.random.default_rng(3).uniform(-0.6, 0.6, (count, 3))


def test_a_solve(robot, gpu):
    """Also of ``make test``: what only a GPU does would rot unseen."""
    inputs = robot.inputs(tip_force=forces(8))

    def found(device: str) -> dict[str, Any]:
        solution = mr.solve(robot, inputs, solver=NEWTON, device=device)
        return {"status": solution.status, "tip": solution.tip_position, "shape": solution.rod(0).position}

    agree(found, gpu)


@pytest.mark.parametrize("solver", [NEWTON, mr.Observer(integrator=RK4), mr.Shooting()], ids=["newton", "observer", "adaptive"])
def test_a_batch(solver, robot, gpu):
    inputs = robot.inputs(tip_force=forces(64), rotation=np.linspace(0, 1, 64))
    agree(lambda device: all_of(mr.solve(robot, inputs, solver=solver, device=device)), gpu)


def test_a_batch_of_several_parts(robot, gpu):
    """On a GPU it is one."""
    inputs = robot.inputs(tip_force=forces(1000))
    agree(lambda device: all_of(mr.solve(robot, inputs, solver=NEWTON, device=device, threads=2)), gpu)


@pytest.mark.parametrize("solver", [NEWTON, OBSERVER, mr.EnergyDescent(integrator=RK4)], ids=["newton", "observer", "descent"])
def test_a_motion(solver, robot, gpu):
    time = np.arange(40) / 200
    inputs = robot.inputs(rotation=time, tip_force=np.stack([np.sin(time), np.cos(time), 0 * time], axis=-1))

    def found(device: str) -> dict[str, Any]:
        tracker = mr.Tracker(robot, solver=solver, dt=0.005, inputs=inputs[0], device=device)
        followed = [tracker.step(rotation=0.005 * k).tip_position for k in range(3)]
        return {"followed": followed, "tip": mr.simulate(robot, inputs, time=time, solver=solver, device=device).tip_position}

    agree(found, gpu)


@pytest.mark.parametrize("scene", ["three-tubes", "six-legs"])
def test_the_scenes(scene, gpu):
    motion = load(scene).first(6)

    def found(device: str) -> dict[str, Any]:
        given = {"solver": NEWTON, "device": device}
        moved = mr.simulate(motion.robot, motion.inputs, time=motion.time, **given)
        observed = mr.simulate(motion.robot, motion.inputs, time=motion.time, solver=OBSERVER, device=device)
        solved = mr.solve(motion.robot, motion.inputs, **given)
        return all_of(solved) | {"moved": moved.tip_position, "observed": observed.tip_position}

    agree(found, gpu)


def test_tubes_under_a_load(gpu):
    robot = load("three-tubes").robot
    inputs = robot.inputs(tip_force=0.3 * forces(16), rotation=np.random.default_rng(0).uniform(-2, 2, (16, 3)))
    agree(lambda device: all_of(mr.solve(robot, inputs, device=device)), gpu)


def test_a_network(gpu):
    leg = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015)
    plate, joints = mr.Body("plate"), []
    for k in range(3):
        place = np.eye(4)
        place[:2, 3] = 0.05 * np.cos(2.1 * k), 0.05 * np.sin(2.1 * k)
        joints.append(mr.Joint(f"leg {k}", "base", to=mr.ground, pose=place))
        joints.append(mr.Joint(f"leg {k}", "tip", to=plate, pose=place))
    robot = mr.Network(rods={f"leg {k}": leg for k in range(3)}, bodies=[plate], joints=joints)
    inputs = robot.inputs(force={"plate": 0.2 * forces(4)})

    def found(device: str) -> dict[str, Any]:
        solution = mr.solve(robot, inputs, solver=NEWTON, device=device)
        return {"status": solution.status, "shape": solution.rod(0).position, "stability": solution.stability}

    agree(found, gpu)


def test_a_rod_held_at_both_ends_buckles(gpu):
    rod = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015)
    end = np.tile(np.eye(4), (3, 1, 1))
    end[:, 2, 3] = 0.29, 0.27, 0.25
    robot = mr.HeldRod(rod, end=end)
    inputs = robot.inputs()

    def found(device: str) -> dict[str, Any]:
        solution = mr.solve(robot, inputs, solver=NEWTON, device=device)
        return {"status": solution.status, "shape": solution.rod(0).position, "stability": solution.stability}

    agree(found, gpu)


def test_a_column_goes_where_the_energy_leads(gpu):
    column = mr.SingleRod(mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015))
    inputs = column.inputs(tip_force=[(0, 0, -2.0), (1e-3, 0, -1.5), (0, 0.2, -4.0)])

    def found(device: str) -> dict[str, Any]:
        solution = mr.solve(column, inputs, solver=NEWTON, device=device)
        return {"status": solution.status, "tip": solution.tip_position, "stability": solution.stability}

    agree(found, gpu)


def test_several_equilibria_and_critical_loads(robot, gpu):
    inputs = robot.inputs(tip_force=(0, 0, -4.0))

    def found(device: str) -> dict[str, Any]:
        states = mr.equilibria(robot, inputs, starts=16, solver=NEWTON, device=device)
        critical = mr.critical_loads(robot, inputs, solver=NEWTON, device=device)
        return {"energy": states.energy, "critical": [load.load_factor for load in critical]}

    agree(found, gpu)


def test_tendons(gpu):
    around = [mr.Tendon(offset=(0.008 * np.cos(a), 0.008 * np.sin(a))) for a in (0, 2.1, 4.2)]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=around))
    inputs = robot.inputs(tension=np.random.default_rng(2).uniform(0, 1.5, (8, 3)), tip_force=0.1 * forces(8))
    agree(lambda device: all_of(mr.solve(robot, inputs, solver=NEWTON, device=device)), gpu)


def test_multiple_shooting(gpu):
    rod = mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=0.01, torsional_stiffness=0.008))
    inputs = rod.inputs(tip_force=[(0.5, 0, -1.0), (0.0, 2.0, 0.1)])
    solver = mr.MultipleShooting(integrator=RK4)

    def found(device: str) -> dict[str, Any]:
        solution = mr.solve(rod, inputs, solver=solver, device=device)
        return {"status": solution.status, "tip": solution.tip_position}

    agree(found, gpu)


def test_control(robot, gpu):
    """Reached, followed, estimated, calibrated and filtered."""
    truth = mr.solve(robot, robot.inputs(rotation=0.3, tip_force=(0.2, -0.1, 0.3)))
    pose = mr.Pose(position=truth.tip_position, rotation=truth.tip_rotation, sigma=(5e-4, 5e-3))

    def found(device: str) -> dict[str, Any]:
        solver, given = {"solver": NEWTON, "device": device}, {"integrator": RK4, "device": device}
        aim = mr.Pose(position=truth.tip_position + (0, 0.003, 0))
        reached = mr.reach(robot, aim, free=("rotation", "translation"), starts=4, **solver)
        estimate = mr.estimate(robot, unknown={"tip_force": mr.Prior(0, sigma=0.25)}, measured=pose, **solver)
        loop = mr.Controller(robot, dt=1e-3, free=("rotation", "translation"), **given)
        for k in range(4):
            sample = loop.step(position=truth.tip_position + (0, 1e-5 * k, 0))
        meter = mr.Estimator(robot, dt=1e-3, unknown={"tip_force": mr.Walk(0.3)}, sensors=pose, **given)
        for _ in range(4):
            met = meter.step([(truth.tip_position, truth.tip_rotation)])
        return {
            "rotation": reached.inputs.rotation,
            "force": estimate.value("tip_force"),
            "sample": sample.tip_position,
            "met": met.value("tip_force"),
        }

    agree(found, gpu)
