"""A platform on six steel rods that is kept where it is while a load moves across it: the rods are pushed in and out.

Geometry and material are those of ``hexapod_load.py``, of github JohnDTill/ContinuumRobotExamples,
01_Statics/02_CSG_Inverse_Kinematics, a robot of the class of C. B. Black, J. Till, D. C. Rucker, IEEE T-RO 34(1), 29-47, 2018.
The controller is told where the load is, and takes one integration of each rod a sample.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from hexapod_load import BASE_ANGLES, LENGTHS, PLATFORM_ANGLES, circle

import multirod as mr

STEPS = mr.RK4(50)
LOAD, REACH = -8.0, 0.07  # [N], and how far it moves from the middle [m]
LIMITS = mr.Limits(translation=(-0.05, 0.05))


def turned(rotations: np.ndarray, start: np.ndarray) -> float:
    """Largest angle from where it started [deg]: the chord between frames is sqrt(8) sin(angle / 2)."""
    chord = np.linalg.norm(rotations - start, axis=(1, 2))
    return float(2 * np.degrees(np.arcsin(chord / np.sqrt(8))).max())


def main(arguments: Sequence[str] | None = None) -> tuple[float, float]:
    """By how much the platform moves with its drives still, and kept still by them [mm]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="hexapod_still_platform.rrd")
    parser.add_argument("--samples", type=int, default=500)
    options = parser.parse_args(arguments)
    legs = [mr.Rod.tube(length=l, outer_diameter=2e-3, young_modulus=200e9, shear_modulus=80e9) for l in LENGTHS]
    robot = mr.ParallelRods(legs=legs, base=circle(BASE_ANGLES), platform=circle(PLATFORM_ANGLES))
    t = np.linspace(0, 10, options.samples)
    phase = 2 * np.pi * t / t[-1]
    point = REACH * np.stack([np.sin(phase), np.sin(2 * phase), 0 * t], axis=-1)  # a figure of eight
    loads = {"tip_force": (0, 0, LOAD), "force_point": point}
    solver = mr.Shooting(integrator=STEPS)
    still = mr.simulate(robot, robot.inputs(**loads), time=t, solver=solver, progress=False).raise_if_failed()

    start, dt = still[0], t[1]
    loop = mr.Controller(robot, dt=dt, free=("translation",), limits=LIMITS, guess=start, integrator=STEPS)
    commands = []
    with mr.Recorder(
        options.out, description="mr.Controller; in grey with drives that stand still", when_full="wait"
    ) as recorder:
        for k in range(options.samples):
            command = loop.step(position=start.tip_position, rotation=start.tip_rotation, force_point=point[k])
            commands.append(command.raise_if_failed())
            recorder.log(t[k], command, reference=still[k])

    # the robot itself, at what was commanded
    drives = np.array([command.inputs.translation for command in commands])
    kept = mr.simulate(robot, robot.inputs(translation=drives, **loads), time=t, solver=solver, progress=False).raise_if_failed()
    away = [1e3 * np.linalg.norm(h.tip_position - start.tip_position, axis=1).max() for h in (still, kept)]
    tilts = [turned(h.tip_rotation, start.tip_rotation) for h in (still, kept)]
    print(f"drives that stand still: the platform moves by {away[0]:.1f} mm and turns by {tilts[0]:.2f} deg")
    moved = 1e3 * np.ptp(drives, axis=0).max()
    print(f"kept still: {1e3 * away[1]:.2f} µm and {tilts[1]:.1e} deg, by drives that move {moved:.1f} mm")
    print(f"recorded to {options.out}")
    return float(away[0]), float(away[1])


if __name__ == "__main__":
    main()
