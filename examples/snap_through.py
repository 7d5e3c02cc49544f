"""A blade, pressed until it has buckled, is pushed to and fro across its tip: it snaps from side to side, and back later.

python examples/snap_through.py [--samples 401] [--plot loop.svg]
"""

import argparse

import numpy as np

import multirod as mr


def blade() -> mr.SingleRod:
    """A strip of spring steel, 6 mm by 0.5 mm and 0.2 m long, clamped at its base."""
    E, G, width, thickness = 200e9, 77e9, 6e-3, 0.5e-3
    thin, wide, torsion = E * width * thickness**3 / 12, E * thickness * width**3 / 12, G * width * thickness**3 / 3
    return mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=(wide, thin), torsional_stiffness=torsion))


def motion(robot: mr.SingleRod, samples: int) -> mr.History:
    """Half as much again as its critical load presses it, then a force across its tip goes to and fro, twice."""
    time = np.linspace(0, 10, samples)
    thin = robot.rods[0].sections[0].bending_stiffness[1]
    critical = np.pi**2 / 4 * thin / 0.2**2
    press = -1.5 * critical * np.clip(time / 2, 0, 1)
    push = 0.5 * critical * np.sin(np.pi * np.clip(time - 2, 0, 8) / 2)
    inputs = robot.inputs(tip_force=np.stack([push, 0 * time, press], axis=-1))
    return mr.simulate(robot, inputs, time=time, progress=False)


def main(argv: list[str] | None = None) -> tuple[float, float]:
    """Print where it buckles and snaps, and draw the loop; its area, and the energy that the snaps on it lost [J]."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=401)
    parser.add_argument("--plot", metavar="FILE", help="where the loop is drawn")
    options = parser.parse_args(argv)
    history = motion(blade(), options.samples).raise_if_failed()
    for sample in history.events:
        for event in sample:
            print(event.said)
    once = history.time >= 6  # from one side to the other and back
    force, tip = history.inputs.tip_force[once, 0], history.tip_position[once, 0]
    area = float(0.5 * (force[1:] + force[:-1]) @ np.diff(tip))
    lost = sum(event.energy_lost for sample in history.events[once] for event in sample)
    print(f"the loop of force and displacement holds {area:.3f} J, its snaps lost {lost:.3f} J")
    if options.plot:
        import matplotlib.pyplot as plt

        pushed = history.time >= 2
        figure, ax = plt.subplots(figsize=(6, 4))
        ax.plot(history.inputs.tip_force[pushed, 0], 1e3 * history.tip_position[pushed, 0], color="#1864ab")
        ax.set_xlabel("force across the tip [N]")
        ax.set_ylabel("tip x [mm]")
        figure.savefig(options.plot, bbox_inches="tight")
    return area, lost


if __name__ == "__main__":
    main()
