"""Networks of growing size: processor time of a cold solve, of the verdict on its stability, and what is kept of Gamma.

OPENBLAS_NUM_THREADS=1 python tests/benchmarks/network_sizes.py
"""

import itertools
import time

import numpy as np

import multirod as mr

WIRE = {"diameter": 2e-3, "young_modulus": 60e9, "shear_modulus": 23e9, "density": 6450}
SPACING = 0.1


def chain(pieces):
    """A rod of 0.4 m in so many pieces with bodies between them, bent by a force."""
    bodies = [mr.Body(f"b{k}", mass=1e-3) for k in range(pieces)]
    joints = [mr.Joint(f"r{k}", "tip", to=bodies[k]) for k in range(pieces)]
    joints += [mr.Joint(f"r{k}", "base", to=bodies[k - 1] if k else mr.ground) for k in range(pieces)]
    rod = mr.Rod.wire(length=0.4 / pieces, **WIRE)
    robot = mr.Network(rods={f"r{k}": rod for k in range(pieces)}, bodies=bodies, joints=joints)
    return robot, robot.inputs(force={f"b{pieces - 1}": (0.5, 0.1, 0)})


def along(axis, place=(0, 0, 0)):
    """A pose whose z is an axis of the world."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.roll(np.eye(3), 2 - axis, axis=1), place
    return pose


def lattice(shape):
    """Bodies on a grid, clamped rods between neighbours and up from the ground, pulled at a corner."""
    rod = mr.Rod.wire(length=SPACING, **WIRE)
    bodies, rods, joints = {}, {}, []
    for place in itertools.product(*map(range, shape)):
        bodies[place] = mr.Body("b{}{}{}".format(*place), pose=along(2, SPACING * (np.array(place) + [0, 0, 1])))
        for axis in range(3):
            other = tuple(np.array(place) - np.eye(3, dtype=int)[axis])
            grounded = axis == 2 and place[2] == 0
            if not grounded and other not in bodies:
                continue
            name = "r{}{}{} {}".format(*place, "xyz"[axis])
            foot = along(axis, SPACING * np.array([*place[:2], 0])) if grounded else along(axis)
            joints.append(mr.Joint(name, "base", to=mr.ground if grounded else bodies[other], pose=foot))
            joints.append(mr.Joint(name, "tip", to=bodies[place], pose=along(axis)))
            rods[name] = rod
    robot = mr.Network(rods=rods, bodies=list(bodies.values()), joints=joints)
    return robot, robot.inputs(force={robot.bodies[-1].name: (0.3, 0.1, 0)})


def main() -> None:
    """Solve, and print."""
    print("network                        made [ms]  solved [ms]  integrations  stability [ms]  Gamma [MB]")
    scenes = [(f"chain of {k}", chain, k) for k in (2, 4, 8, 16, 32, 64)]
    scenes += [("lattice {} x {} x {}".format(*shape), lattice, shape) for shape in ((2, 2, 2), (3, 3, 3), (2, 4, 5), (4, 4, 5))]
    mr.solve(*chain(2))
    for name, make, size in scenes:
        times = [time.process_time()]
        robot, inputs = make(size)
        times.append(time.process_time())
        mr.solve(robot, inputs)
        times.append(time.process_time())
        solution = mr.solve(robot, inputs).raise_if_failed()
        times.append(time.process_time())
        verdict = solution.stability
        times.append(time.process_time())
        made, _, solved, judged = 1e3 * np.diff(times)
        kept = 8e-6 * robot.graph.entries.count
        print(f"{name:30s} {made:9.0f} {solved:12.0f} {solution.integrations:13d} {judged:15.0f} {kept:11.2f}  {verdict}")


if __name__ == "__main__":
    main()
