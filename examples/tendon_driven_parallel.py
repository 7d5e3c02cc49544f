"""Two arms that tendons bend hold one end effector in a plane: the robot, the path and the model of a thesis; then a load on it.

The robot is that of S. Teetaert, "Towards Learning-Based Control for a Tendon-Driven Parallel Continuum Robot", undergraduate
thesis, University of Toronto, 2023, with its program in github spencerteetaert/pcr_control: strips of spring steel, pinned at
both ends, a tendon on each side. The one that is let out hangs from a weight; that small tension is left out here.
configs/config1.yaml has lengths (0.85 m; the text says 0.8) and bases, scripts/generate_test_trajs.py the circle, the thesis the
strip, the offset and the length of the circle's path, 0.923 m. Its model is a constant curvature: an arm whose ends are a
distance d apart has 2 sin(k L/2)/k = d, and its tendon is pulled by k L r. Where nothing loads pinned arms that is exact, so
these displacements have to move rods along that circle. What the thesis measured on its way includes what the table's friction
and its motors do, and is no equilibrium (0.748 m with such a controller).

Under a load arms are no arcs, and the thesis has no number. The reference is then a planar elastica of both arms by collocation.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

import multirod as mr

LENGTH, OFFSET = 0.85, 0.011  # of an arm, and of its tendon beside it [m]
BASES = np.array([(-0.171, -0.187), (0.662, -0.187)])  # pins [m]
WIDTH, THICKNESS, E, G = 0.75 * 25.4e-3, 0.02 * 25.4e-3, 205e9, 79e9  # spring steel 1095: its moduli are of a handbook
EI = E * WIDTH * THICKNESS**3 / 12
SIDES = np.array([-1.0, 1.0])  # of its arm on which each tendon is: the arms bend apart
CENTRE, RADIUS, SAMPLES = np.array([0.25, 0.25]), 0.15, 50  # of the circle [m]
PUBLISHED = 0.923  # length of the path through these samples [m]
LOAD = np.array([0.15, -0.1])  # on the end effector, in the plane [N]
LOADED = slice(None, None, 10)  # samples that are loaded


def circle() -> np.ndarray:
    angle = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    return CENTRE + RADIUS * np.column_stack([np.sin(angle), -np.cos(angle)])


def displacements(points: np.ndarray) -> np.ndarray:
    """How far the thesis pulls each tendon where the end effector is to be at ``points`` [m], shape (points, 2)."""
    apart = np.linalg.norm(points[:, None] - BASES, axis=-1)
    half = [brentq(lambda x, d=d: np.sin(x) / x - d / LENGTH, 1e-9, np.pi, xtol=1e-14) for d in apart.flat]
    return 2 * OFFSET * np.reshape(half, apart.shape)


def robot() -> mr.Network:
    """At rest both arms are straight; body y is across the plane. Of two hinges at the end effector one is enough."""
    middle = BASES.mean(axis=0)
    apex = middle + (0, np.sqrt(LENGTH**2 - np.sum((BASES[0] - middle) ** 2)))
    end, rods, joints = mr.Body("end effector"), {}, []
    for name, base, side in zip(("left", "right"), BASES, SIDES, strict=True):
        stiffness = (E * WIDTH**3 * THICKNESS / 12, EI)
        tendon = mr.Tendon(offset=(side * OFFSET, 0), driven="displacement")
        twist = G * WIDTH * THICKNESS**3 / 3
        rods[name] = mr.Rod(length=LENGTH, bending_stiffness=stiffness, torsional_stiffness=twist, lines=[tendon])
        along, foot = np.append((apex - base) / LENGTH, 0), np.eye(4)
        foot[:3, 0], foot[:3, 1], foot[:3, 2] = np.cross((0, 0, 1), along), (0, 0, 1), along
        top = foot.copy()
        foot[:2, 3] = base
        joints.append(mr.Joint(name, "base", to=mr.ground, pose=foot, kind="revolute", axis=(0, 1, 0)))
        hinge = {"kind": "revolute", "axis": (0, 1, 0)} if name == "right" else {}
        joints.append(mr.Joint(name, "tip", to=end, pose=top, **hinge))
    return mr.Network(rods=rods, bodies=[end], joints=joints)


def elastica(pulled: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Where the load moves the end effector, by collocation; ``point`` is where it is without.

    Of each arm x' = cos a, y' = sin a, a' = k, m' = -(cos a f_y - sin a f_x), with EI k = m + T r for a tendon T on the left, at
    r > 0, and -T r on the right; w' = k. Pins: m = 0. A tendon that is pulled by q: r w(L) = q. The f of both are the load.
    """
    turned = SIDES * pulled / OFFSET  # by how much each arm is bent, to the left

    def rates(s: np.ndarray, state: np.ndarray, unknown: np.ndarray) -> np.ndarray:
        found, forces = np.empty_like(state), (unknown[2:], LOAD - unknown[2:])
        for k, (side, force) in enumerate(zip(SIDES, forces, strict=True)):
            x, y, a, m, w = found[5 * k : 5 * k + 5]
            _, _, angle, moment, _ = state[5 * k : 5 * k + 5]
            x[:], y[:] = np.cos(angle), np.sin(angle)
            a[:] = w[:] = (moment + side * unknown[k] * OFFSET) / EI
            m[:] = np.sin(angle) * force[0] - np.cos(angle) * force[1]
        return found

    def ends(base: np.ndarray, tip: np.ndarray, unknown: np.ndarray) -> np.ndarray:
        base, tip = base.reshape(2, 5), tip.reshape(2, 5)
        pins, bends = (base[:, :2] - BASES, base[:, 3], tip[:, 3], tip[0, :2] - tip[1, :2]), (base[:, 4], tip[:, 4] - turned)
        return np.concatenate([np.ravel(row) for row in (*pins, *bends)])

    s = np.linspace(0, LENGTH, 41)
    state = np.zeros((10, len(s)))
    for k, bend in enumerate(turned / LENGTH):
        chord = np.arctan2(*(point - BASES[k])[::-1])
        angle = chord + bend * (s - LENGTH / 2)
        state[5 * k] = BASES[k, 0] + (np.sin(angle) - np.sin(angle[0])) / bend
        state[5 * k + 1] = BASES[k, 1] - (np.cos(angle) - np.cos(angle[0])) / bend
        state[5 * k + 2], state[5 * k + 4] = angle, bend * s
    tension = EI * np.abs(turned) / (LENGTH * OFFSET)
    found = solve_bvp(rates, ends, s, state, p=np.concatenate([tension, LOAD / 2]), tol=1e-8, max_nodes=20_000)
    if not found.success:
        raise RuntimeError(found.message)
    return found.y[:2, -1]


def main(arguments: Sequence[str] | None = None) -> tuple[float, float, float]:
    """Length of the path, largest distance from the circle, and under the load from the elastica [m]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", help="picture to write")
    options = parser.parse_args(arguments)
    arms, points = robot(), circle()
    pulled = displacements(points)
    free = mr.solve(arms, arms.inputs(displacement=pulled)).raise_if_failed()
    path = float(np.linalg.norm(np.diff(free.tip_position, axis=0), axis=1).sum())
    apart = float(np.linalg.norm(free.tip_position[:, :2] - points, axis=1).max())
    print(f"path of {path:.4f} m, published {PUBLISHED}; {apart:.0e} m from the circle; tensions to {free.tension.max():.1f} N")
    force = {"end effector": (*LOAD, 0)}
    loaded = mr.solve(arms, arms.inputs(displacement=pulled[LOADED], force=force)).raise_if_failed()
    places = np.array([elastica(q, p) for q, p in zip(pulled[LOADED], points[LOADED], strict=True)])
    gap = float(np.linalg.norm(loaded.tip_position[:, :2] - places, axis=1).max())
    moved = np.linalg.norm(places - points[LOADED], axis=1).mean()
    print(f"{np.linalg.norm(LOAD):.2f} N move it by {1e3 * moved:.1f} mm on average; {gap:.0e} m from the elastica")
    if options.out:
        axes = loaded.plot()
        axes.view_init(elev=90, azim=-90)
        axes.figure.savefig(options.out, dpi=80, bbox_inches="tight", metadata={"Software": None})
    return path, apart, gap


if __name__ == "__main__":
    main()
