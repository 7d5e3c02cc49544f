"""One of two curved tubes is turned by a whole turn in the other, and back: they snap across, at another angle each way.

python examples/tube_pair_hysteresis.py [--samples 181] [--plot loop.svg]
"""

import argparse

import numpy as np

import multirod as mr

LENGTH, RADIUS = 0.12, 0.06  # of both, and of their curves [m]


def pair() -> mr.ConcentricTubes:
    """Two tubes of superelastic nickel-titanium, curved over all of their length, one in the other."""
    E, G = 60e9, 23e9
    tubes = []
    for inner, outer in ((0.8e-3, 1.2e-3), (1.4e-3, 1.7e-3)):
        area = np.pi * (outer**4 - inner**4) / 64
        tubes.append(
            mr.Rod(
                length=LENGTH,
                bending_stiffness=E * area,
                torsional_stiffness=2 * G * area,
                precurvature=(1 / RADIUS, 0, 0),
            )
        )
    return mr.ConcentricTubes(tubes)


def motion(robot: mr.ConcentricTubes, samples: int) -> mr.History:
    """The inner tube is turned by a whole turn, and back."""
    time = np.linspace(0, 20, samples)
    turn = 2 * np.pi * np.interp(time, (0, 10, 20), (0, 1, 0))
    inputs = robot.inputs(rotation=np.stack([turn, 0 * turn], axis=-1))
    return mr.simulate(robot, inputs, time=time, progress=False)


def main(argv: list[str] | None = None) -> tuple[float, float]:
    """Print where it snaps, and draw the loop; the work that turning it took, and the energy that the snaps lost [J]."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=181)
    parser.add_argument("--plot", metavar="FILE", help="where the loop is drawn")
    options = parser.parse_args(argv)
    history = motion(pair(), options.samples).raise_if_failed()
    turn = history.inputs.rotation[:, 0]
    for sample in history.events:
        for event in sample:
            print(f"{event.said}; turned by {np.degrees(np.interp(event.time, history.time, turn)):.0f} degrees")
    # that turns the inner tube at its base; the bending moments there are about its diameters
    torque = -history.rod(0).moment[:, 0, 2]
    work = float(0.5 * (torque[1:] + torque[:-1]) @ np.diff(turn))
    lost = sum(event.energy_lost for sample in history.events for event in sample)
    print(f"turning it to and fro took {1e3 * work:.2f} mJ, its snaps lost {1e3 * lost:.2f} mJ")
    if options.plot:
        draw(history, torque, options.plot)
    return work, lost


def draw(history: mr.History, torque: np.ndarray, path: str) -> None:
    """The loop of torque and angle, and where the tip goes."""
    import matplotlib.pyplot as plt

    turn = np.degrees(history.inputs.rotation[:, 0])
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    there = history.time <= 10
    for chosen, color, label in ((there, "#1864ab", "there"), (~there, "#d9480f", "back")):
        left.plot(turn[chosen], 1e3 * torque[chosen], color=color, label=label)
        right.plot(1e3 * history.tip_position[chosen, 0], 1e3 * history.tip_position[chosen, 1], color=color, label=label)
    left.set_xlabel("inner tube turned by [degrees]")
    left.set_ylabel("torque [mN m]")
    left.legend(frameon=False)
    right.set_xlabel("tip x [mm]")
    right.set_ylabel("tip y [mm]")
    right.set_aspect("equal")
    figure.savefig(path, bbox_inches="tight")


if __name__ == "__main__":
    main()
