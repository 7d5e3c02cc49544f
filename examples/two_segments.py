"""A robot of two segments, three tendons each, against a published code; then driven by displacement at 200 Hz.

The robot is that of Rao, Peyron, Lilge and Burgner-Kahrs, "How to Model Tendon-Driven Continuum Robots and Benchmark Modelling
Performance", Frontiers in Robotics and AI 2021, with the tensions of the program beside it (github SvenLilge/tdcr-modeling,
c++/main.cpp). Its Cosserat rod takes tendons to follow the backbone; its rods between discs take the discs as they are.
"""

import numpy as np

import multirod as mr

LENGTH, DISCS, PITCH, RADIUS, E = 0.2, 0.02, 0.01, 0.7e-3, 54e9  # of each segment [m], between discs [m], [m], [m], [Pa]
ANGLES = np.array([np.pi / 2, -np.pi / 6, 7 * np.pi / 6])
OFFSETS = PITCH * np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
TENSION = (4, 0, 0, 0, 2, 0)  # [N]
# what that program finds; the first one integrated to 1e-11 in place of its 1e-3
PUBLISHED = {
    "Cosserat rod": (0.12760770076, 0.143467497046, 0.336406705861),
    "rods between discs": (0.129371, 0.145941, 0.334201),
}


def robot(driven: str = "tension", discs: float | None = None, **options: float) -> mr.SingleRod:
    """Three tendons end at the first segment's end, three go through to the tip."""
    I, A, G = np.pi / 4 * RADIUS**4, np.pi * RADIUS**2, E / 2.6
    section = mr.Section(
        length=LENGTH,
        bending_stiffness=E * I,
        torsional_stiffness=2 * G * I,
        shear_stiffness=G * A,
        axial_stiffness=E * A,
    )
    near = [mr.Tendon(offset, end=LENGTH, driven=driven, **options) for offset in OFFSETS]
    far = [mr.Tendon(offset, driven=driven, **options) for offset in OFFSETS]
    return mr.SingleRod(mr.Rod(sections=[section, section], lines=near + far, discs=discs))


def compare() -> dict[str, float]:
    """Distance of the tip from the published one, over the length."""
    found = {}
    for (name, tip), discs in zip(PUBLISHED.items(), (None, DISCS), strict=True):
        solution = mr.solve(one := robot(discs=discs), one.inputs(tension=TENSION)).raise_if_failed()
        found[name] = float(np.linalg.norm(solution.tip_position - tip)) / (2 * LENGTH)
        print(f"{name:20s} tip {1e3 * solution.tip_position} mm, {found[name]:.1e} of the length from the published one")
    return found


def follow() -> float:
    """Both segments turn; one integration a sample. Mean error of the tip from half a second on [mm]."""
    time = 0.005 * np.arange(401)
    turn = ANGLES - 2 * np.pi * time[:, None]
    pull = 0.003 * np.concatenate([np.cos(turn), np.cos(turn) + np.cos(turn / 2)], axis=1)
    driven = robot("displacement", axial_stiffness=2000.0)
    inputs = driven.inputs(displacement=pull)
    exact = mr.simulate(driven, inputs, time=time).raise_if_failed()
    observer = mr.Observer(coupling="per-rod", feed_forward=True)
    found = mr.simulate(driven, inputs, time=time, solver=observer).raise_if_failed()
    error = 1e3 * np.linalg.norm(found.tip_position - exact.tip_position, axis=1)[100:].mean()
    print(f"by displacement      {found.slack.mean():.0%} of the tendons slack, observer's tip {error:.2g} mm off on average")
    return float(error)


def main() -> tuple[dict[str, float], float]:
    """Print what is found."""
    return compare(), follow()


if __name__ == "__main__":
    main()
