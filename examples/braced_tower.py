"""A tower of plates on upright wires, without braces and with: how far it sways, and what it bears before it buckles.

The tower is nobody's: put your own dimensions in.

python examples/braced_tower.py [--storeys 3] [--out braced_tower.png]
"""

import argparse
from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np

import multirod as mr

HEIGHT, RADIUS, SIDES = 0.15, 0.05, 3  # of a storey [m]; wires of each
E, G = 200e9, 77e9  # spring steel
LEG, BRACE = 1.5e-3, 0.8e-3  # diameters [m]
NO_SWAY = 4  # times that load bear wires, clamped at both ends, that are kept from swaying
SOLVER = mr.Shooting(tolerance=1e-10, integrator=mr.RK4(40))
NEAR = mr.Shooting(tolerance=1e-4, integrator=mr.RK4(40))  # [1/m]: where a tower is about to buckle, no more can be had
PUSH = np.array([0.05, 0.0, 0.0])  # on the top plate [N]


def wire(length: float, diameter: float) -> mr.Rod:
    """One that gives way along itself too: a straight one that did not would be a rigid brace."""
    return mr.Rod.wire(length=length, diameter=diameter, young_modulus=E, shear_modulus=G, extensible=True)


def corner(k: int) -> np.ndarray:
    angle = 2 * np.pi * k / SIDES
    return RADIUS * np.array([np.cos(angle), np.sin(angle), 0.0])


def pose(place: np.ndarray, along: Sequence[float] | np.ndarray = (0, 0, 1)) -> np.ndarray:
    """Frame at a place whose z is ``along``."""
    z = np.asarray(along) / np.linalg.norm(along)
    x = np.cross((0.0, 1.0, 0.0), z) if abs(z[1]) < 0.9 else np.cross((1.0, 0.0, 0.0), z)
    x /= np.linalg.norm(x)
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = np.stack([x, np.cross(z, x), z], axis=-1), place
    return found


def tower(storeys: int, braced: bool) -> mr.Network:
    plates = [mr.Body(f"plate {k + 1}") for k in range(storeys)]
    rods: dict[str, mr.Rod] = {}
    joints: list[mr.Joint] = []
    for level, plate in enumerate(plates):
        below = plates[level - 1] if level else mr.ground
        for k in range(SIDES):
            leg = f"leg {level + 1}.{k}"
            rods[leg] = wire(HEIGHT, LEG)
            joints += [mr.Joint(leg, end, to=to, pose=pose(corner(k))) for end, to in (("base", below), ("tip", plate))]
            if braced:  # from the foot of a leg to the head of the next; free to turn at both ends, but not about itself
                brace, rise = f"brace {level + 1}.{k}", corner(k + 1) + [0, 0, HEIGHT] - corner(k)
                rods[brace] = wire(float(np.linalg.norm(rise)), BRACE)
                joints.append(mr.Joint(brace, "base", to=below, pose=pose(corner(k), rise), kind="universal", axis=np.eye(3)[:2]))
                joints.append(mr.Joint(brace, "tip", to=plate, pose=pose(corner(k + 1), rise), kind="spherical"))
    return mr.Network(rods=rods, bodies=plates, joints=joints)


def buckles(robot: mr.Network, top: str, about: float) -> float:
    """Load on a plate under which the upright tower ceases to be stable [N], by halving: there it has an unstable mode.

    ``mr.critical_loads`` searches the whole branch for it, and takes the longer.
    """
    upright = mr.solve(robot, solver=SOLVER)
    low, high = 0.8 * about, 1.2 * about
    while high - low > 1e-3 * about:
        middle = 0.5 * (low + high)
        pressed = mr.solve(robot, robot.inputs(force={top: (0, 0, -middle)}), solver=NEAR, guess=upright).raise_if_failed()
        low, high = (low, middle) if pressed.index > 0 else (middle, high)
    return 0.5 * (low + high)


def main(arguments: Sequence[str] | None = None) -> dict[str, tuple[float, float]]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--storeys", type=int, default=3)
    parser.add_argument("--out", default="braced_tower.png")
    options = parser.parse_args(arguments)
    EI = E * np.pi * LEG**4 / 64
    books = {
        "sways": options.storeys * HEIGHT**3 / (12 * SIDES * EI),  # each storey by the four quarters of its wires
        "bears": SIDES * np.pi**2 * EI / HEIGHT**2,  # half a wave of each wire, clamped at both ends and free to sway
    }
    found: dict[str, tuple[float, float]] = {}
    top = f"plate {options.storeys}"
    figure = plt.figure(figsize=(12, 8))
    for place, (name, braced) in enumerate((("without braces", False), ("with braces", True)), 1):
        robot = tower(options.storeys, braced)
        solution = mr.solve(robot, robot.inputs(force={top: PUSH}), solver=SOLVER).raise_if_failed()
        sways = float(solution.jacobian("force")[0, -3])  # of the last body, along x
        bears = buckles(robot, top, books["bears"] * (NO_SWAY if braced else 1))
        found[name] = sways, bears
        print(f"{name}: {robot}")
        print(f"  a newton aside at the top moves it by {1e3 * sways:.4g} mm; it buckles under {bears:.4g} N")
        axes = figure.add_subplot(1, 2, place, projection="3d")
        solution.plot(ax=axes)
        axes.get_legend().remove()
        axes.set_title(name)
    print(f"books, without braces: {1e3 * books['sways']:.4g} mm, {books['bears']:.4g} N")
    figure.savefig(options.out, dpi=80, bbox_inches="tight", metadata={"Software": None})
    plt.close(figure)
    print(f"drawn to {options.out}")
    return found | {"books": (books["sways"], books["bears"])}


if __name__ == "__main__":
    main()
