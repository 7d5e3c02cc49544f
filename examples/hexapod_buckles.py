"""A platform on six strips is pressed until these buckle, then pushed to and fro across: they snap from side to side together.

python examples/hexapod_buckles.py [--samples 41] [--plot hexapod.png]
"""

import argparse

import numpy as np

import multirod as mr

LENGTH, RADIUS, LEGS = 0.25, 0.08, 6
WIDTH, THICKNESS = 2e-3, 1e-3  # of each strip, which bends about y the more easily
E, G = 200e9, 77e9
STIFFNESS = E * WIDTH * THICKNESS**3 / 12
EULER = LEGS * np.pi**2 / 4 * STIFFNESS / LENGTH**2  # each leg is clamped at its base, and has a ball at the platform
PRESSED = 2.0  # when the load is all there [s]


def hexapod() -> mr.ParallelRods:
    """Six strips of spring steel on a circle, upright, their ends in balls of the platform."""
    strips = [
        mr.Rod(
            length=LENGTH,
            bending_stiffness=(E * THICKNESS * WIDTH**3 / 12, STIFFNESS),
            torsional_stiffness=G * WIDTH * THICKNESS**3 / 3,
            precurvature=(
                bend,
                0,
                0,
            ),  # a little, to either side: if all were straight, nothing would say what each of them bears
        )
        for bend in LEGS // 2 * (-0.2, 0.2)
    ]
    poses = np.tile(np.eye(4), (LEGS, 1, 1))
    angle = 2 * np.pi * np.arange(LEGS) / LEGS
    poses[:, :2, 3] = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return mr.ParallelRods(legs=strips, base=poses, platform=poses, joints=["spherical"] * LEGS)


def motion(robot: mr.ParallelRods, samples: int) -> mr.History:
    """It is pressed by a third more than it bears, then pushed to and fro."""
    time = np.linspace(0, 6, samples)
    press = -1.3 * EULER * np.clip(time / PRESSED, 0, 1)
    push = 0.4 * EULER * np.sin(np.pi * np.clip(time - PRESSED, 0, 4) / 2)
    inputs = robot.inputs(tip_force=np.stack([push, 0 * time, press], axis=-1))
    return mr.simulate(robot, inputs, time=time, progress=False)


def main(argv: list[str] | None = None) -> tuple[float, int]:
    """Print what happens, and draw it; the load at which the legs buckle over Euler's, and how often they snap."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=41)
    parser.add_argument("--plot", metavar="FILE", help="where it is drawn")
    options = parser.parse_args(argv)
    history = motion(hexapod(), options.samples).raise_if_failed()
    events = [event for sample in history.events for event in sample]
    for event in events:
        print(event.said)
    buckled = next(event for event in events if event.status is mr.Status.BIFURCATED)
    share = 1.3 * buckled.time / PRESSED
    print(f"they buckle under {share * EULER:.3f} N, {share:.5f} of Euler's load")
    if options.plot:
        draw(history, options.plot)
    return share, sum(event.status is mr.Status.SNAPPED for event in events)


def draw(history: mr.History, path: str) -> None:
    """From aside, before and after it buckled and snapped; and where the platform goes."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    snapped = int(np.flatnonzero(history.status == mr.Status.SNAPPED)[0])
    shown = ((0, "#adb5bd", "unloaded"), (snapped - 1, "#1864ab", "buckled"), (snapped, "#d9480f", "snapped"))
    for sample, color, label in shown:
        ends = []
        for leg in range(LEGS):
            x, _, z = 1e3 * history.rod(leg).position[sample].T
            left.plot(x, z, color=color, label=label if leg == 0 else None)
            ends.append((x[-1], z[-1]))
        left.plot(*np.array(sorted(ends)).T, color=color, linewidth=3)
    left.set_xlabel("x [mm]")
    left.set_ylabel("z [mm]")
    left.set_aspect("equal")
    left.legend(frameon=False)
    pushed = history.time >= PRESSED
    right.plot(history.inputs.tip_force[pushed, 0], 1e3 * history.tip_position[pushed, 0], color="#1864ab")
    right.set_xlabel("force across the platform [N]")
    right.set_ylabel("platform x [mm]")
    figure.savefig(path, bbox_inches="tight")


if __name__ == "__main__":
    main()
