"""Random scenes, and what dropping terms truly does to their tips, against what was promised.

python tests/dropping.py [--scenes N] [--seed N] [--families NAME ...]
"""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain, combinations
from time import process_time
from typing import Any

import numpy as np

import multirod as mr
from multirod.studies.terms import simplified

BOUNDS = (1e-2, 1e-3, 1e-4, 1e-6)
SOLVER = mr.Shooting(integrator=mr.RK45(steps=30), tolerance=1e-11)  # equal steps, by kernels that other tests need too


@dataclass(frozen=True)
class Family:
    """Scenes of one kind, all made at once.

    Attributes:
        build: The robot and the inputs of some scenes, by their numbers, (k,) for a batch, and by terms that some of them have
            not: 1 or 0 for each. So scenes with and without a term are one batch, solved by one kernel.
        terms: What may be dropped.
        count: Scenes.
        length: In use, shape (count,).
    """

    build: Callable[..., tuple[mr.Assembly, mr.Inputs]]
    terms: tuple[str, ...]
    count: int
    length: np.ndarray


def log(random: np.random.Generator, low: float, high: float, *shape: int) -> np.ndarray:
    """Numbers whose logarithms are spread evenly."""
    return np.exp(random.uniform(np.log(low), np.log(high), shape))


def direction(random: np.random.Generator, count: int) -> np.ndarray:
    """Unit vectors."""
    vectors = random.standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def or_zero(load: np.ndarray, kept: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """A load, zero in the scenes that do without it."""
    return load * kept[name][:, None] if name in kept else load


def or_rigid(stiffness: np.ndarray, kept: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """A stiffness, infinite in the scenes that do without its term."""
    return np.where(kept[name] > 0, stiffness, np.inf) if name in kept else stiffness


def rods(random: np.random.Generator, count: int) -> Family:
    """Single rods, slender to stubby, straight to strongly precurved, under loads from none to strong."""
    length = log(random, 0.05, 2.0, count)
    EI = log(random, 1e-3, 10.0, count)
    bending = EI[:, None] * log(random, 0.5, 1.0, count, 2)
    torsion = EI * random.uniform(0.3, 1.0, count)
    slender = log(random, 1e-7, 3e-2, count)  # EI/(GA L^2)
    shear = EI / (slender * length**2)
    turns = log(random, 0.05, 4.0, count)[:, None] * direction(random, count) / length[:, None]
    weight = log(random, 1e-7, 2.0, count) * EI / length**3
    force = (log(random, 1e-7, 12.0, count) * EI / length**2)[:, None] * direction(random, count)
    gravity = 9.81 * direction(random, count)

    def build(k: Any, **kept: Any) -> tuple[mr.Assembly, mr.Inputs]:
        rod = mr.Rod(
            length=length[k],
            bending_stiffness=bending[k],
            torsional_stiffness=torsion[k],
            shear_stiffness=or_rigid(shear[k], kept, "shear")[..., None],
            axial_stiffness=2.6 * or_rigid(shear[k], kept, "shear"),
            precurvature=turns[k],
            linear_density=weight[k] / 9.81,
        )
        robot = mr.SingleRod(rod)
        return robot, robot.inputs(tip_force=or_zero(force[k], kept, "tip_force"), gravity=or_zero(gravity[k], kept, "gravity"))

    return Family(build, ("tip_force", "gravity", "shear"), count, length)


def columns(random: np.random.Generator, count: int) -> Family:
    """Straight rods pressed along their axis from far below their buckling load to beyond it, with a little weight across."""
    ones = np.ones(count)
    force = -np.pad(np.linspace(0.02, 1.2, count)[:, None] * np.pi**2 / 4, ((0, 0), (2, 0)))
    force[:, :2] = 1e-3 * direction(random, count)[:, :2]
    weight, shear = log(random, 1e-7, 1e-2, count), 1 / log(random, 1e-7, 1e-2, count)

    def build(k: Any, **kept: Any) -> tuple[mr.Assembly, mr.Inputs]:
        rod = mr.Rod(
            length=ones[k],
            bending_stiffness=ones[k][..., None],
            torsional_stiffness=ones[k] / 1.3,
            shear_stiffness=or_rigid(shear[k], kept, "shear")[..., None],
            axial_stiffness=2.6 * or_rigid(shear[k], kept, "shear"),
            linear_density=weight[k],
        )
        robot = mr.SingleRod(rod)
        gravity = np.broadcast_to([1.0, 0, 0], (*np.shape(k), 3))
        return robot, robot.inputs(tip_force=force[k], gravity=or_zero(gravity, kept, "gravity"))

    return Family(build, ("gravity", "shear"), count, ones)


def tubes(random: np.random.Generator, count: int) -> Family:
    """Two concentric tubes, weakly to strongly precurved, under a tip force and their weight."""
    longer = log(random, 0.1, 0.5, count)
    lengths = np.stack([longer, longer * random.uniform(0.5, 0.9, count)], axis=1)
    behind = -lengths * random.uniform(0.1, 0.4, (count, 1))
    EI = log(random, 1e-3, 1e-2, count, 2) * [1, 4]
    torsion = EI * random.uniform(0.5, 1.0, (count, 2))
    turns = log(random, 1e-4, 2.0, count, 2)[..., None] * np.pad(np.ones((count, 2, 1)), ((0, 0), (0, 0), (0, 2)))
    reach = (lengths + behind).max(axis=1)
    rotation = random.uniform(-np.pi / 2, np.pi / 2, (count, 2))
    weight = log(random, 1e-7, 1.0, count) * EI.sum(axis=1) / reach**3
    force = (log(random, 1e-7, 2.0, count) * EI.sum(axis=1) / reach**2)[:, None] * direction(random, count)
    gravity = 9.81 * direction(random, count)

    def build(k: Any, **kept: Any) -> tuple[mr.Assembly, mr.Inputs]:
        both = [
            mr.Rod(
                length=lengths[k, i],
                bending_stiffness=EI[k, i, None],
                torsional_stiffness=or_rigid(torsion[k, i], kept, "torsion"),
                precurvature=turns[k, i] / reach[k, None],
                linear_density=weight[k] / 9.81 / 2,
            )
            for i in range(2)
        ]
        robot = mr.ConcentricTubes(both)
        loads = {"tip_force": or_zero(force[k], kept, "tip_force"), "gravity": or_zero(gravity[k], kept, "gravity")}
        return robot, robot.inputs(rotation=rotation[k], translation=behind[k], **loads)

    return Family(build, ("tip_force", "gravity", "torsion"), count, reach)


def legs(random: np.random.Generator, count: int) -> Family:
    """Three legs clamped to a platform, pushed out by unequal amounts, under a force on the platform and their weight."""
    length = log(random, 0.2, 0.6, count)
    EI = log(random, 1e-2, 1.0, count)
    radius = length * random.uniform(0.1, 0.4, count)
    twist = random.uniform(-0.5, 0.5, count)
    turns = log(random, 0.01, 1.0, count)[:, None] * direction(random, count) / length[:, None]
    push = length[:, None] * random.uniform(-0.03, 0.03, (count, 3))
    weight = log(random, 1e-7, 1.0, count) * EI / length**3
    spread = (log(random, 1e-7, 1.0, count) * EI / length**2)[:, None] * direction(random, count)
    force = (log(random, 1e-3, 5.0, count) * EI / length**2)[:, None] * direction(random, count)
    gravity = 9.81 * direction(random, count)

    def build(k: Any, **kept: Any) -> tuple[mr.Assembly, mr.Inputs]:
        rod = mr.Rod(
            length=length[k],
            bending_stiffness=EI[k][..., None],
            torsional_stiffness=EI[k] / 1.3,
            axial_stiffness=1e5 * EI[k] / length[k] ** 2,
            precurvature=turns[k],
            linear_density=weight[k] / 9.81,
        )
        poses = []
        for size, turn in ((radius[k], 0 * twist[k]), (0.7 * radius[k], twist[k])):
            pose = np.zeros((*np.shape(size), 3, 4, 4)) + np.eye(4)
            angle = turn[..., None] + 2 * np.pi * np.arange(3) / 3
            pose[..., :2, 3] = size[..., None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            poses.append(pose)
        robot = mr.ParallelRods(legs=[rod] * 3, base=poses[0], platform=poses[1])
        loads = {
            "gravity": or_zero(gravity[k], kept, "gravity"),
            "distributed_moment": or_zero(spread[k], kept, "distributed_moment"),
        }
        return robot, robot.inputs(translation=push[k], tip_force=force[k], **loads)

    return Family(build, ("gravity", "distributed_moment"), count, length)


FAMILIES = {"rods": rods, "columns": columns, "tubes": tubes, "legs": legs}


@dataclass(frozen=True)
class Measured:
    """What came of one family at one bound.

    Attributes:
        scenes: That have a result.
        dropped: Scenes in which something was dropped.
        terms: Terms dropped.
        possible: Terms that could have been dropped: most of all sets that truly leave the tip within the bound.
        broken: Scenes in which the tip moved by more than the bound.
        worst: Largest move of a tip over the bound.
    """

    scenes: int
    dropped: int
    terms: int
    possible: int
    broken: int
    worst: float
    taken: float


def tips(family: Family) -> dict[frozenset[str], np.ndarray]:
    """Tips of all scenes without each set of terms, NaN where a solve failed, shape (count, 3)."""
    sets = list(chain.from_iterable(combinations(family.terms, k) for k in range(len(family.terms) + 1)))
    kept = {name: np.repeat([float(name not in names) for names in sets], family.count) for name in family.terms}
    robot, inputs = family.build(np.tile(np.arange(family.count), len(sets)), **kept)
    found = mr.solve(robot, inputs, solver=SOLVER, progress=False).tip_position.reshape(len(sets), family.count, 3)
    return {frozenset(names): tip for names, tip in zip(sets, found, strict=True)}


def measure(family: Family) -> dict[float, Measured]:
    """Decide each scene by itself, and look what that did."""
    tip = tips(family)
    full = tip[frozenset()]
    moved = {names: np.linalg.norm(value - full, axis=1) / family.length for names, value in tip.items()}
    sound = np.flatnonzero(np.isfinite(full).all(axis=1))
    results = {}
    for bound in BOUNDS:
        dropped = terms = possible = broken = 0
        worst, times = 0.0, []
        for k in sound:
            robot, inputs = family.build(int(k))
            begin = process_time()
            names = frozenset(term.name for term in simplified(robot, inputs, bound)[2])
            times.append(process_time() - begin)
            error = moved[names][k]
            possible += max(len(others) for others, size in moved.items() if size[k] <= bound)
            dropped += bool(names)
            terms += len(names)
            broken += not error <= bound  # a failed solve too
            worst = max(worst, error / bound if np.isfinite(error) else np.inf)
        results[bound] = Measured(len(sound), dropped, terms, possible, broken, worst, float(np.median(times)))
    return results


def main() -> None:
    """Print a table for each family."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    options = parser.parse_args()
    print(
        "| scenes | bound | solved | something dropped | terms dropped, of what could be "
        "| bound broken | worst, of the bound | ms |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name in options.families:
        for bound, m in measure(FAMILIES[name](np.random.default_rng(options.seed), options.scenes)).items():
            cells = (name, f"{bound:g}", m.scenes, f"{m.dropped / m.scenes:.0%}", f"{m.terms} of {m.possible}", m.broken)
            print("| " + " | ".join(map(str, (*cells, f"{m.worst:.2f}", f"{1e3 * m.taken:.1f}"))) + " |")


if __name__ == "__main__":
    main()
