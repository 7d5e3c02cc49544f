"""Random robots all of whose rods are rigid in torsion: how many are solved, in what, and where those stand that hardly twist.

python tests/benchmarks/rigid_in_torsion.py --robots 120
python tests/benchmarks/rigid_in_torsion.py --networks --robots 60

Two legs to six, straight or bent at rest, round ones and strips, side by side and not, in clamps, balls and on hinges, under
loads to ``5 EI/L^2``. In networks also at their bases, and half of these have a second body, on two masts that stand on the
first.
"""

import argparse
import warnings
from collections import Counter

import numpy as np
from scipy.spatial.transform import Rotation

import multirod as mr
from multirod.status import Status

EI, LENGTH = 0.02, 0.5
HARDLY = 1e6  # times as stiff in torsion as in bending, what is compared with
LONG = 1000  # integrations
TIPS, ALL = ("clamped", "spherical", "revolute"), ("clamped", "spherical", "revolute", "universal")
AXES = {"revolute": {"axis": (0, 0, 1)}, "universal": {"axis": ((1, 0, 0), (0, 1, 0))}}


def draw(number: int, seed: int, ratio: float, network: bool) -> tuple[mr.ParallelRods | mr.Network, mr.Inputs]:
    """A robot whose rods are ``ratio`` times as stiff in torsion as in bending, and its inputs."""
    rng = np.random.default_rng([seed, number, network])
    count = int(rng.integers(2, 7))
    equal, in_order = rng.random() < 0.5, rng.random() < 0.4
    kinds, mixed = ALL if network else TIPS, rng.random() < 0.75
    tips = [str(rng.choice(kinds)) if mixed else "clamped" for _ in range(count)]
    bases = [str(rng.choice(kinds)) if network and mixed and rng.random() < 0.5 else "clamped" for _ in range(count)]
    tips[0] = bases[0] = "clamped"  # nothing turns freely
    bend = 2.0 * rng.random() / LENGTH if rng.random() < 0.6 else 0.0
    strip = rng.random() < 0.4
    elastic = {"axial_stiffness": 1e3} if count > 3 or rng.random() < 0.5 else {}  # else what they share is not determined
    radius = rng.uniform(0.1, 0.3) * LENGTH
    radii, rods, poses = (radius, radius if equal else rng.uniform(0.05, 0.3) * LENGTH), [], ([], [])
    for k in range(count):
        angle = 2 * np.pi * k / count + (0.0 if in_order else rng.uniform(-0.3, 0.3))
        tilts = rng.uniform(-0.3, 0.3, (2, 3)) * (not in_order)
        for own, tilt, far in zip(poses, tilts, radii, strict=True):
            own.append(pose((far * np.cos(angle), far * np.sin(angle), 0.0), tilt))
        rods.append(
            mr.Rod(
                length=LENGTH * (1.0 if in_order else rng.uniform(0.9, 1.1)),
                bending_stiffness=(EI, EI * (1 + strip * rng.random())),
                torsional_stiffness=ratio * EI,
                precurvature=tuple(bend * rng.uniform(-1, 1, 3) * (1, 1, 0.3)),
                **elastic,
            )
        )
    load = 5 * rng.random() if rng.random() < 0.8 else 0.0
    way = rng.standard_normal(3)
    force = load * EI / LENGTH**2 * way / np.linalg.norm(way)
    moment = load * EI / LENGTH * 0.3 * rng.standard_normal(3) if rng.random() < 0.3 else np.zeros(3)
    if not network:
        robot = mr.ParallelRods(legs=rods, base=poses[0], platform=poses[1], joints=tips)
        return robot, robot.inputs(tip_force=force, tip_moment=moment)
    bodies, forces, joints = [mr.Body("plate")], {"plate": force}, []
    for k in range(count):
        for end, to, at, kind in zip(("base", "tip"), (mr.ground, bodies[0]), poses, (bases[k], tips[k]), strict=True):
            joints.append(mr.Joint(f"rod {k}", end, to=to, pose=at[k], kind=kind, **AXES.get(kind, {})))
    if rng.random() < 0.5:
        bodies.append(mr.Body("hat"))
        forces["hat"] = 0.5 * force[[1, 2, 0]]
        for k, side in enumerate((-1, 1)):
            rods.append(mr.Rod(length=0.4 * LENGTH, bending_stiffness=EI, torsional_stiffness=ratio * EI))
            for end, to, far in zip(("base", "tip"), bodies, (0.05, 0.03), strict=True):
                joints.append(mr.Joint(f"rod {count + k}", end, to=to, pose=pose((side * far, 0.0, 0.0))))
    robot = mr.Network(rods={f"rod {k}": rod for k, rod in enumerate(rods)}, bodies=bodies, joints=joints)
    return robot, robot.inputs(force=forces, moment={"plate": moment})


def pose(position, rotation=(0.0, 0.0, 0.0)):
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = Rotation.from_rotvec(rotation).as_matrix(), position
    return result


def main() -> None:
    """Solve, compare, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--networks", action="store_true", help="networks, of which those are left out that are refused")
    options = parser.parse_args()
    warnings.simplefilter("ignore", mr.PlausibilityWarning)
    ends: Counter[str] = Counter()
    taken, off, long, elsewhere = [], [], [], []
    for number in range(options.robots):
        try:
            drawn = [draw(number, options.seed, ratio, options.networks) for ratio in (np.inf, HARDLY)]
        except ValueError:
            continue  # something is free to move
        found, hardly = (mr.solve(*own) for own in drawn)
        status = Status(int(found.status))
        ends[status.name] += 1
        taken.append(int(found.integrations))
        if taken[-1] > LONG:
            long.append(number)
        apart = float(np.abs(found.tip_position - hardly.tip_position).max() / LENGTH)
        if np.isfinite(apart):
            off.append(apart)
            elsewhere += [number] * (apart > 1e-3)
        print(number, status.name, taken[-1], f"GJ {HARDLY:g} EI: {Status(int(hardly.status)).name}, {apart:.1e} off", flush=True)
    print(dict(ends), f"integrations: median {np.median(taken):.0f}, mean {np.mean(taken):.0f}; more than {LONG}: {long}")
    print(f"off, of the length: median {np.median(off):.1e}, most {max(off):.1e}; elsewhere: {elsewhere}")


if __name__ == "__main__":
    main()
