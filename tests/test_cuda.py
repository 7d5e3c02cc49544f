"""The same kernels on a GPU: skipped, and said so, where there is none."""

import numpy as np
import pytest
import warp as wp

import multirod as mr

pytestmark = pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")

SOLVERS = [mr.Shooting(integrator=mr.RK4(50)), mr.Observer(integrator=mr.RK4(50)), mr.Shooting()]


@pytest.mark.parametrize("solver", SOLVERS, ids=["newton", "observer", "adaptive"])
def test_a_batch_on_the_gpu_is_that_on_the_cpu(solver, wire):
    robot = mr.SingleRod(wire)
    force = np.random.default_rng(3).uniform(-0.6, 0.6, (64, 3))
    inputs = robot.inputs(tip_force=force, rotation=np.linspace(0, 1, 64))
    cpu = mr.solve(robot, inputs, solver=solver)
    gpu = mr.solve(robot, inputs, solver=solver, device="cuda")
    np.testing.assert_array_equal(gpu.status, cpu.status)
    # fused multiply-adds differ, nothing else does
    np.testing.assert_allclose(gpu.tip_position, cpu.tip_position, atol=1e-10)
    np.testing.assert_allclose(gpu.rod(0).position, cpu.rod(0).position, atol=1e-9)
    np.testing.assert_allclose(gpu.jacobian("tip_force"), cpu.jacobian("tip_force"), atol=1e-8)


@pytest.mark.parametrize("solver", [mr.Shooting(integrator=mr.RK4(50)), mr.Observer(feed_forward=True, integrator=mr.RK4(50))])
def test_a_motion_on_the_gpu_is_that_on_the_cpu(solver, wire):
    robot = mr.SingleRod(wire)
    time = np.arange(40) / 200
    inputs = robot.inputs(rotation=time, tip_force=np.stack([np.sin(time), np.cos(time), 0 * time], axis=-1))
    cpu = mr.simulate(robot, inputs, time=time, solver=solver)
    gpu = mr.simulate(robot, inputs, time=time, solver=solver, device="cuda")
    np.testing.assert_allclose(gpu.tip_position, cpu.tip_position, atol=1e-10)
    tracker = mr.Tracker(robot, solver=solver, dt=0.005, inputs=inputs[0], device="cuda")
    np.testing.assert_allclose(tracker.step().tip_position, cpu.tip_position[0], atol=1e-10)
