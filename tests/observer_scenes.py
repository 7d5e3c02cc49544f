"""Motions that stay clear of folds and then stop, of one rod, three tubes and six legs: what the observer is tried on."""

import json
from pathlib import Path

import numpy as np

import multirod as mr

MOVING, STILL = 30, 30  # samples
INTEGRATOR = mr.RK4(30)
GAINS = tuple((10.0**k, 10.0**k) for k in range(-3, 4)) + ((1e3, 1e-3), (1e-3, 1e3))  # R, Q
TIMES = (1e-3, 1e-2, 0.1, 1.0)


def phase():
    """From 0 to 1 within the moving samples, then 1; shape (sample, 1)."""
    return np.minimum(np.arange(MOVING + STILL) / MOVING, 1.0)[:, None]


def single_rod():
    """The wire of the paper, turned by a radian under a force that turns."""
    w = phase()
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814, precurvature=(14, 5, 0)))
    return robot, robot.inputs(rotation=w, tip_force=np.concatenate([np.sin(2 * w), np.cos(2 * w), 0 * w], axis=1))


def three_tubes():
    """Tubes turned against each other by up to 1.2 rad, and pushed."""
    w = phase()
    rods = []
    for k, (outer, inner, curvature) in enumerate(((0.8, 0.4, (9, 0, 0)), (1.2, 0.9, (6, 1, 0)), (1.8, 1.3, (4, 2, 0)))):
        rods.append(
            mr.Rod.tube(
                length=0.4 - 0.1 * k,
                outer_diameter=1e-3 * outer,
                inner_diameter=1e-3 * inner,
                young_modulus=60e9,
                shear_modulus=23e9,
                precurvature=[(0.25 - 0.05 * k, (0, 0, 0)), (0.15 - 0.05 * k, curvature)],
            )
        )
    robot = mr.ConcentricTubes(rods)
    force = 0.1 * np.concatenate([np.sin(2 * w), np.cos(2 * w), 0 * w], axis=1)
    return robot, robot.inputs(
        rotation=w * [0.6, -0.2, -0.6], translation=np.array([-0.1, -0.05, -0.02]) + 0.005 * w, tip_force=force
    )


def six_legs():
    """A hexapod of slender legs pushed in and out by 5 mm under 2 N."""
    w = phase()
    case = json.loads((Path(__file__).parent / "data" / "10d_cpr_stewart_fk_1.json").read_text(encoding="utf-8"))["inputs"]
    poses = np.tile(np.eye(4), (2, 6, 1, 1))
    legs = []
    for k, rod in enumerate(case["rods"]):
        K = rod["K"]
        legs.append(mr.Rod(length=rod["length"], bending_stiffness=tuple(K[:2]), torsional_stiffness=K[2]))
        poses[0, k, :3, :3], poses[0, k, :3, 3] = rod["R0"], rod["p0"]
        poses[1, k, :3, :3], poses[1, k, :3, 3] = rod["attach_R"], rod["attach_r"]
    robot = mr.ParallelRods(legs=legs, base=poses[0], platform=poses[1])
    force = np.array(case["platform"]["force_world"]) + np.concatenate([np.sin(w), np.cos(w) - 1, 0 * w], axis=1)
    return robot, robot.inputs(translation=0.005 * np.sin(3 * w + np.arange(6)) - 0.005 * np.sin(np.arange(6)), tip_force=force)


MOTIONS = {"single rod": single_rod, "three tubes": three_tubes, "six legs": six_legs}


def follow(name, gain, dt, **options):
    """The history of a motion from the equilibrium of its first sample, by the exact update.

    The modes of parallel rods differ by decades: gains are meant in variables in which all have one rate.
    """
    robot, inputs = MOTIONS[name]()
    start = mr.solve(robot, inputs[0], solver=mr.Shooting(integrator=INTEGRATOR)).raise_if_failed()
    scaling = {"scaling": "newton"} if name == "six legs" else {}
    solver = mr.Observer(R=gain[0], Q=gain[1], integrator=INTEGRATOR, **scaling, **options)
    return mr.simulate(robot, inputs, time=dt * np.arange(MOVING + STILL), solver=solver, guess=start.unknowns)


def measure(amplitude, gain):
    """The single rod's motion with a tip curvature that is measured with white noise of up to ``amplitude`` [1/m], sampled at 1
    Hz."""
    robot, motion = single_rod()
    noise = np.random.default_rng(0).uniform(-1, 1, (MOVING + STILL, 3))
    inputs = robot.inputs(rotation=phase(), tip_force=motion.tip_force, tip_curvature=(14, 5, 0) + amplitude * noise)
    start = mr.solve(robot, inputs[0], solver=mr.Shooting(integrator=INTEGRATOR)).raise_if_failed()
    solver = mr.Observer(R=gain, Q=gain, integrator=INTEGRATOR)
    return mr.simulate(robot, inputs, time=np.arange(MOVING + STILL), solver=solver, guess=start.unknowns)
