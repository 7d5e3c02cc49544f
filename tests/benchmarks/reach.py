"""Reaching targets and following them: integrations, successes, tracking errors, and times over a bare C loop, interleaved.

Targets of tubes come from an integration and a shooting method of this file, nothing of the package:
python tests/benchmarks/reach.py [--targets N] [--samples N] [--rounds N] [--quick]
"""

import argparse
import ctypes
import gc
import resource
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time, thread_time
from typing import Any

import numpy as np
from concentric_tubes import motion, tubes
from single_rod import c_loop

import multirod as mr
from multirod.rotations import matrices, vectors

STEPS = mr.RK4(50)
SOLVER = mr.Shooting(integrator=STEPS)
FREE = ("rotation", "translation")
FORCE = np.array([0.0, 0.2, 0.1])
LIMITS = mr.Limits(translation=(-0.4, 0), gap=1e-3)
FIRST = 5  # samples of a loop whose memory the system has yet to give
AGAIN = 5  # loops alike whose samples take turns: the least of a sample's times is its own, the others are also the machine's
DATA = np.array(  # EI, GJ, length, curved length, curvature
    [(0.00387, 0.00301, 0.431, 0.103, 9.0), (0.01717, 0.01402, 0.332, 0.113, 6.0), (0.03977, 0.05022, 0.174, 0.134, 3.5)]
)


class Rig:
    """Three tubes under a force on the tip, many at once: the equations of ``docs/model.md``, integrated by RK4.

    30 steps between every two places where a tube begins to bend or ends; solved by Newton's method with differences.
    """

    def __init__(self, data: Any = DATA, force: Any = FORCE) -> None:
        self.EI, self.GJ, self.length, self.curved, self.kappa = np.asarray(data).T
        self.force = np.asarray(force, dtype=float)

    def shoot(self, x: Any, rotation: Any, translation: Any, part: float) -> tuple[Any, Any, Any]:
        """What is left of the conditions (b, 5), the tip (b, 3) and its frame, at base moments and torques (b, 5)."""
        ends = self.length + translation
        bends = np.maximum(ends - self.curved, 0.0)
        nodes = np.sort(np.concatenate([np.zeros((len(x), 1)), bends, ends], axis=1), axis=1)
        torque = x[:, 2:] * self.GJ
        y = np.zeros((len(x), 20))
        y[:, :3] = rotation - translation * x[:, 2:]
        y[:, 3:6], y[:, 6:8] = torque, x[:, :2] * self.EI.sum()
        y[:, 11:] = np.eye(3).reshape(9)
        ended = np.zeros((len(x), 3))
        for a, b in zip(nodes.T[:-1], nodes.T[1:], strict=True):
            middle = 0.5 * (a + b)[:, None]
            on = (middle < ends).astype(float)
            bent = on * (middle > bends) * self.kappa * part
            h = (b - a)[:, None] / 30
            for _ in range(30):
                k1 = self.rates(y, on, bent, part)
                k2 = self.rates(y + 0.5 * h * k1, on, bent, part)
                k3 = self.rates(y + 0.5 * h * k2, on, bent, part)
                k4 = self.rates(y + h * k3, on, bent, part)
                y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            over = np.abs(ends - b[:, None]) < 1e-12
            ended = np.where(over, y[:, 3:6], ended)
            y[:, 3:6] = np.where(over, 0.0, y[:, 3:6])
        left = np.concatenate([y[:, 6:8] / self.EI.sum(), ended / self.GJ], axis=1)
        inner = np.zeros((len(x), 3))
        inner[:, 2] = y[:, 0]  # the frame of the innermost tube against the one that does not turn
        return left, y[:, 8:11], y[:, 11:].reshape(-1, 3, 3) @ matrices(inner)

    def rates(self, y: Any, on: Any, bent: Any, part: float) -> Any:
        """By arclength, of angles, torques, moment, position and frame."""
        theta, tau, M, R = y[:, :3], y[:, 3:6], y[:, 6:8], y[:, 11:].reshape(-1, 3, 3)
        turned = np.stack([np.cos(theta), np.sin(theta)], axis=2) * bent[:, :, None]
        stiff = on * self.EI
        u = (M + (stiff[:, :, None] * turned).sum(axis=1)) / stiff.sum(axis=1, keepdims=True)
        m = stiff[:, :, None] * (u[:, None] - turned)
        N = np.einsum("bji,j->bi", R, part * self.force)
        Mz = (on * tau).sum(axis=1)
        result = np.zeros_like(y)
        result[:, :3] = on * tau / self.GJ
        result[:, 3:6] = -on * (u[:, None, 0] * m[:, :, 1] - u[:, None, 1] * m[:, :, 0])
        result[:, 6], result[:, 7] = -u[:, 1] * Mz + N[:, 1], u[:, 0] * Mz - N[:, 0]
        result[:, 8:11] = R[:, :, 2]
        K = np.zeros((len(y), 3, 3))
        K[:, 0, 2], K[:, 1, 2] = u[:, 1], -u[:, 0]
        K[:, 2, 0], K[:, 2, 1] = -u[:, 1], u[:, 0]
        result[:, 11:] = (R @ K).reshape(-1, 9)
        return result

    def solve(self, rotation: Any, translation: Any) -> tuple[Any, Any, Any]:
        """Tips (b, 3), their frames, and which were found (b,).

        Not found is what has another sign of the determinant than nearly straight tubes without a load: past a fold, unstable.
        """
        x = np.zeros((len(rotation), 5))
        signs = []
        for part in (0.01, 0.25, 0.5, 0.75, 1.0, 1.0):
            for _ in range(6):
                left, p, R = self.shoot(x, rotation, translation, part)
                J = np.stack(
                    [(self.shoot(x + 1e-6 * e, rotation, translation, part)[0] - left) / 1e-6 for e in np.eye(5)], axis=2
                )
                sound = np.isfinite(J).all(axis=(1, 2)) & np.isfinite(left).all(axis=1)
                J[~sound], left[~sound] = np.eye(5), 0.0
                x = x - np.linalg.solve(J, left[..., None])[..., 0]
                if np.abs(left).max() < 1e-9:
                    break
            signs.append(np.sign(np.linalg.det(J)))
        left, p, R = self.shoot(x, rotation, translation, 1.0)
        R = R @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(R, 1, 2) @ R)  # off a rotation by 1e-8, as it was integrated
        return p, R, (np.abs(left).max(axis=1) < 1e-7) & (signs[-1] == signs[0])


def scattered(count: int, random: Any) -> tuple[Any, Any]:
    """Rotations and translations all over the joint space, tubes in order."""
    length = DATA[:, 2]
    b3 = random.uniform(-0.16, -0.005, count)
    b2 = b3 - random.uniform(2e-3, length[1] - length[2] - 2e-3, count)
    b1 = np.maximum(b2 - random.uniform(2e-3, length[0] - length[1] - 2e-3, count), -0.395)
    ordered = b1 < b2 - 2e-3
    return random.uniform(-np.pi, np.pi, (count, 3))[ordered], np.stack([b1, b2, b3], axis=1)[ordered]


def row(what: str, measured: str, meant: str = "") -> None:
    print(f"| {what} | {measured} | {meant} |", flush=True)


def said(solution: Any) -> str:
    names, counts = np.unique(solution.status, return_counts=True)
    return ", ".join(f"{count} {mr.Status(int(name))}" for name, count in zip(names, counts, strict=True))


def spread(values: Any) -> str:
    half, nine, most = np.quantile(values, [0.5, 0.9, 1.0])
    return f"median {half:.0f}, 90 % {nine:.0f}, most {most:.0f}"


class Wrong:
    """Counts results that are not stable, or beyond limits."""

    def __init__(self) -> None:
        self.unstable = self.beyond = self.results = 0

    def look(self, solution: Any, limited: bool = True) -> None:
        """At those that did not fail."""
        good = ~solution.failed
        self.results += int(good.sum())
        self.unstable += int((np.asarray(solution.stability)[good] != mr.Stability.STABLE).sum())
        if limited:
            bases = solution.inputs.translation[good]
            self.beyond += int(((bases.max(axis=1) > 0) | (bases.min(axis=1) < -0.4)).sum())
            self.beyond += int((np.diff(bases, axis=1).min(axis=1) < 1e-3).sum())


def steps_of_tubes(robot: Any, start: Any, count: int, wrong: Wrong) -> None:
    random, rig = np.random.default_rng(1), Rig()
    rotation = start.inputs.rotation + random.uniform(-0.5, 0.5, (count, 3))
    translation = start.inputs.translation + random.uniform(-0.03, 0.03, (count, 3))
    p, _, found = rig.solve(rotation, translation)
    solution = mr.reach(robot, mr.Pose(position=p[found]), free=FREE, limits=LIMITS, guess=start, solver=SOLVER)
    wrong.look(solution)
    row("position, 3 loaded tubes, steps of 0.5 rad and 30 mm", said(solution), "all reached")
    row("its integrations", spread(solution.integrations), "at most 6")
    again = rig.solve(solution.inputs.rotation, solution.inputs.translation)
    off = 1e9 * np.linalg.norm(again[0] - p[found], axis=1)[again[2] & ~solution.failed]
    row("its tips by this file's own equations", f"{np.median(off):.2g} nm off (median), {off.max():.2g} (most)")


def all_over(robot: Any, start: Any, count: int, wrong: Wrong, floor: Callable[[], float] | None) -> None:
    random, rig = np.random.default_rng(2), Rig()
    p, R, found = rig.solve(*scattered(count, random))
    p, R = p[found], R[found]
    few = slice(0, max(10, len(p) // 10))
    for name, pose, starts, meant in (
        ("position", mr.Pose(position=p), 0, ""),
        ("position", mr.Pose(position=p), 64, "99.9 %; 4000 a second on two cores"),
        ("position and axis", mr.Pose(position=p[few], axis=R[few, :, 2]), 64, "99 %"),
        ("pose", mr.Pose(position=p[few], rotation=R[few]), 64, "99 %"),
    ):
        loop = floor() if floor else np.nan
        begin = process_time()
        solution = mr.reach(robot, pose, free=FREE, limits=LIMITS, guess=start, solver=SOLVER, starts=starts)
        each = 1e6 * (process_time() - begin) / len(solution.status)
        wrong.look(solution)
        share = np.mean(solution.status == mr.Status.REACHED)
        cost = (
            f"{solution.integrations.mean():.1f} integrations, {1e6 / each:.0f} a second and core, {each / loop:.0f} C loops each"
        )
        row(f"{name}, targets all over, {starts} starts", f"{share:.1%}: {said(solution)}; {cost}", meant)


def strongly_curved(count: int, wrong: Wrong) -> None:
    """Tubes curved 2.5 times more, which snap."""
    data = DATA * [1, 1, 1, 1, 2.5]
    robot = tubes_of(data)
    start = mr.solve(robot, robot.inputs(**motion(0.0), tip_force=FORCE), solver=SOLVER)
    p, _, found = Rig(data).solve(*scattered(count, np.random.default_rng(3)))
    solution = mr.reach(robot, mr.Pose(position=p[found]), free=FREE, limits=LIMITS, guess=start, solver=SOLVER, starts=64)
    wrong.look(solution)
    row("position, tubes curved 2.5 times more", said(solution))


def tubes_of(data: Any) -> mr.ConcentricTubes:
    return mr.ConcentricTubes(
        [
            mr.Rod(length=L, bending_stiffness=EI, torsional_stiffness=GJ, precurvature=[(L - c, (0, 0, 0)), (c, (k, 0, 0))])
            for EI, GJ, L, c, k in data
        ]
    )


def six_legs() -> tuple[mr.ParallelRods, Any]:
    """A hexapod under 5 N."""
    base, platform = np.tile(np.eye(4), (2, 6, 1, 1))
    for pose, angles in ((base, (-10, 10, 110, 130, 230, 250)), (platform, (-50, 50, 70, 170, 190, 290))):
        pose[:, :2, 3] = 0.087 * np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))], axis=1)
    leg = mr.Rod(length=0.4, bending_stiffness=0.157, torsional_stiffness=0.126)
    robot = mr.ParallelRods(legs=[leg] * 6, base=base, platform=platform)
    return robot, mr.solve(robot, robot.inputs(tip_force=(0, 0, -5.0)), solver=SOLVER)


def poses_of_legs(count: int, wrong: Wrong) -> None:
    robot, start = six_legs()
    random = np.random.default_rng(4)
    position = start.tip_position + random.uniform(-0.05, 0.05, (count, 3))
    rotation = matrices(random.uniform(-0.2, 0.2, (count, 3))) @ start.tip_rotation
    pose = mr.Pose(position=position, rotation=rotation)
    given: dict[str, dict[str, Any]] = {"warm": {"guess": start}, "cold": {"inputs": start.inputs}}
    for name, begin in given.items():
        solution = mr.reach(robot, pose, free=("translation",), solver=SOLVER, **begin)
        wrong.look(solution, limited=False)
        cost = f"integrations a leg: {spread(solution.integrations)}"
        row(f"six legs, 50 mm and 0.2 rad, {name}", f"{said(solution)}; {cost}", "all reached, at most 20")
    inverse = robot.inverse()
    inputs = inverse.inputs(platform_position=position, platform_rotation=vectors(rotation), tip_force=start.inputs.tip_force)
    solution = mr.solve(inverse, inputs, solver=SOLVER)
    wrong.look(solution, limited=False)
    row("the same by inverse(), from nothing", f"{said(solution)}; {spread(solution.integrations)}", "none unstable")


def moved_together(robot: Any, start: Any) -> None:
    """Base, loads and targets turned and shifted."""
    turn, shift = matrices(np.array([[0.2, -0.1, 0.4]]))[0], np.array([0.3, -0.8, 0.5])
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = turn, shift
    other = mr.ConcentricTubes(robot.tubes, base=base)
    random = np.random.default_rng(6)
    rotation = start.inputs.rotation + random.uniform(-0.5, 0.5, (20, 3))
    translation = start.inputs.translation + random.uniform(-0.03, 0.03, (20, 3))
    p, _, found = Rig().solve(rotation, translation)
    p = p[found]
    values = {name: getattr(start.inputs, name) for name in FREE}
    options: dict[str, Any] = {"free": FREE, "limits": LIMITS, "solver": SOLVER, "tolerance": 1e-9}
    here = mr.reach(robot, mr.Pose(position=p), start.inputs, **options)
    there = mr.reach(other, mr.Pose(position=p @ turn.T + shift), other.inputs(**values, tip_force=turn @ FORCE), **options)
    off = max(np.abs(getattr(here.inputs, name) - getattr(there.inputs, name)).max() for name in FREE)
    row("base and target moved together", f"{said(there)}; actuation {off:.1e} rad or m off", "1e-9")


def figure_of_eight(tip: Any, samples: int) -> Any:
    """20 mm across, in a second."""
    w = 2 * np.pi * np.arange(samples) / samples
    return tip + 0.01 * np.stack([np.sin(w), 0.5 * np.sin(2 * w), 0.3 * np.sin(w)], axis=1)


def controlled(robot: Any, start: Any, samples: int) -> None:
    for rate, meant in ((1000, "1 um"), (200, "10 um")):
        path = figure_of_eight(start.tip_position, rate)[:samples]
        loop = mr.Controller(robot, dt=1 / rate, free=FREE, limits=LIMITS, guess=start, integrator=STEPS)
        commands = [loop.step(position=y) for y in path]
        values = {name: np.array([getattr(c.inputs, name) for c in commands]) for name in FREE}
        p, _, found = Rig().solve(values["rotation"], values["translation"])
        off = 1e6 * np.linalg.norm(p - path, axis=1)[found]
        spent = max(int(c.integrations) for c in commands)
        cost = f"{np.sqrt(np.mean(off**2)):.2g} um rms, {off.max():.2g} most; {spent} integration a sample"
        row(f"figure of eight, 20 mm in 1 s, {rate} Hz", cost, meant)
    model = tubes_of(DATA * [1.1, 1.1, 1, 1, 1.05])
    first = mr.solve(model, start.inputs, solver=SOLVER)
    random, path = np.random.default_rng(5), figure_of_eight(start.tip_position, 1000)[:samples]
    for measuring, meant in ((False, ""), (True, "0.1 mm")):
        loop = mr.Controller(model, dt=1e-3, free=FREE, limits=LIMITS, guess=first, integrator=STEPS)
        there, seen, errors = start, None, []
        for y in path:
            command = loop.step(position=y, measured_position=seen)
            values = {name: getattr(command.inputs, name) for name in FREE}
            there = mr.solve(robot, robot.inputs(**values, tip_force=FORCE + [0.12, 0, 0]), solver=SOLVER, guess=there)
            errors.append(np.linalg.norm(there.tip_position - y))
            seen = there.tip_position + 1e-5 * random.normal(size=3) if measuring else None
        rms = 1e3 * np.sqrt(np.mean(np.square(errors[50:])))
        name = f"10 % stiffness, 5 % precurvature and 0.12 N wrong, 10 um noise, {'closed' if measuring else 'open'}"
        row(name, f"{rms:.3g} mm rms", meant)


def bare_loop() -> int:
    """As long as a step, and nothing but arithmetic."""
    total = 0
    for k in range(900):
        total += k * k
    return total


C_LOOP = "double loop(int n) { double x = 1.0; for (int i = 0; i < n; i++) x = x * 0.999999 + 1e-9; return x; }"


def loop_of_c(folder: Path, seconds: float) -> Callable[[], object]:
    """Arithmetic of C alone, that takes so long at best; nothing without a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return lambda: None
    source, library = folder / "loop.c", folder / "loop.so"
    source.write_text(C_LOOP)
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    loop = ctypes.CDLL(str(library)).loop
    loop.restype = ctypes.c_double
    best, count = np.inf, 10000
    for _ in range(100):
        begin = thread_time()
        loop(count)
        best = min(best, thread_time() - begin)
    return lambda: loop(int(count * seconds / best))


class Slow:
    """What happened in samples that took twice the median or more."""

    def __init__(self) -> None:
        self.seen: list[tuple[float, int, int, int]] = []  # time; collections, page faults, interruptions by other programs
        self.collections = 0
        gc.callbacks.append(self.collected)

    def collected(self, phase: str, _: object) -> None:
        self.collections += phase == "start"

    def timed(self, call: Callable[[], object]) -> float:
        """The processor's time of a call."""
        before, had = resource.getrusage(resource.RUSAGE_THREAD), self.collections
        begin = thread_time()
        call()
        spent = thread_time() - begin
        after = resource.getrusage(resource.RUSAGE_THREAD)
        faults, switches = after.ru_minflt - before.ru_minflt, after.ru_nivcsw - before.ru_nivcsw
        self.seen.append((spent, self.collections - had, faults, switches))
        return spent

    def said(self) -> str:
        gc.callbacks.remove(self.collected)
        seen = np.array(self.seen[FIRST:])
        slow = seen[seen[:, 0] >= 2 * np.median(seen[:, 0])]
        counts = (slow[:, 1:] > 0).sum(axis=0).tolist()
        return f"{len(slow)} of {len(seen)}: {counts[0]} with a collection, {counts[1]} a page fault, {counts[2]} interrupted"


def one_reach(robot: Any, start: Any, rounds: int, floor: Callable[[], float] | None) -> None:
    """A single target, warm, by the processor's time."""
    random = np.random.default_rng(7)
    rotation = start.inputs.rotation + random.uniform(-0.5, 0.5, (20, 3))
    translation = start.inputs.translation + random.uniform(-0.03, 0.03, (20, 3))
    targets = mr.solve(robot, robot.inputs(rotation=rotation, translation=translation, tip_force=FORCE), solver=SOLVER)
    targets = targets.tip_position[~targets.failed]
    spent, bare = [], []
    for k in range(rounds):
        begin = thread_time()
        mr.reach(robot, mr.Pose(position=targets[k % len(targets)]), free=FREE, limits=LIMITS, guess=start, solver=SOLVER)
        spent.append(thread_time() - begin)
        if floor and k % 20 == 0:
            bare.append(1e-6 * floor())
    least, middle = np.quantile(spent[rounds // 10 :], [0.05, 0.5]).tolist()
    loops = f"{middle / np.median(bare):.0f} C loops, in the best of twenty {least / np.median(bare):.0f}; " if bare else ""
    row("one reach, warm, steps of 0.5 rad and 30 mm", f"{loops}{1e3 * middle:.2f}, {1e3 * least:.2f} ms here", "0.3 ms")


def limited(rounds: int) -> None:
    """Samples that look at limits of the shape, far from them and beside them, in steps without, which take turns with them."""
    robot, (legs, there) = tubes(), six_legs()
    start = mr.solve(robot, robot.inputs(**motion(0.0), tip_force=FORCE), solver=SOLVER)
    runs: dict[str, tuple[Any, Any, tuple[str, ...]]] = {
        "3 loaded tubes": (robot, start, FREE),
        "six legs": (legs, there, ("translation",)),
    }
    for name, (one, at, free) in runs.items():
        bends = [np.linalg.norm(at.rod(k, nodes=301).curvature[:, :2], axis=1).max() for k in range(len(one.rods))]
        most, margin = float(max(bends)), float(at.stability_margin)
        limits = {
            "no limit": None,
            "a curvature, far": mr.Limits(curvature=2 * most),
            "a curvature, near": mr.Limits(curvature=1.05 * most),
            "a margin, far": mr.Limits(stability_margin=0.3 * margin),
            "a margin, near": mr.Limits(stability_margin=margin - 0.05),
        }
        loops = {
            key: mr.Controller(one, dt=1e-3, free=free, guess=at, limits=own, integrator=STEPS) for key, own in limits.items()
        }
        path = figure_of_eight(at.tip_position, 1000)
        spent: dict[str, list[float]] = {key: [] for key in loops}
        for k in range(rounds):
            target = {"position": path[k % 1000]} | ({"rotation": at.tip_rotation} if one is legs else {})
            for key, loop in loops.items():
                begin = thread_time()
                loop.step(**target)
                spent[key].append(thread_time() - begin)
        least = {key: np.quantile(own[FIRST:], 0.5) for key, own in spent.items()}
        for key, own in least.items():
            row(f"Controller.step, {name}, {key}", f"{1e6 * own:.0f} us, {own / least['no limit']:.1f} of a step without")


def times(rounds: int, floor: Callable[[], float] | None, folder: Path) -> None:
    """Interleaved, so that what else the machine does falls on all."""
    robot = tubes()
    start = mr.solve(robot, robot.inputs(**motion(0.0), tip_force=FORCE), solver=SOLVER)
    legs, there = six_legs()
    runs: dict[str, tuple[Any, Any, tuple[str, ...], str]] = {
        "3 loaded tubes, 6 actuators": (robot, start, FREE, "80 us"),
        "six legs": (legs, there, ("translation",), "300 us"),
    }
    for name, (one, at, free, meant) in runs.items():
        path = figure_of_eight(at.tip_position, 1000)
        loops = [mr.Controller(one, dt=1e-3, free=free, guess=at, integrator=STEPS) for _ in range(AGAIN)]
        loop = loops[0]
        tracker = mr.Tracker(one, solver=SOLVER, inputs=at.inputs, guess=at)
        ours, theirs, bare, jacobian = [], [], [], []
        # of the processor: other programs do not count, but for the caches that they empty, which a bare loop shows
        spent: dict[str, list[float]] = {"step": [], "integration": [], "loop": [], "least": [], "C": []}
        problem = loop._task.problem
        slow, slow_bare, bare_c = Slow(), Slow(), loop_of_c(folder, 6e-5 if one is robot else 2e-4)
        for k in range(rounds):
            target = {"position": path[k % 1000]} | ({"rotation": at.tip_rotation} if one is legs else {})
            commands: list[Any] = []
            begin = perf_counter()
            spent["step"].append(slow.timed(lambda: commands.append(loop.step(**target))))  # noqa: B023
            ours.append(perf_counter() - begin)
            command = commands[0]
            same = [spent["step"][-1]]
            for other in loops[1:]:
                own = thread_time()
                other.step(**target)
                same.append(thread_time() - own)
            spent["least"].append(min(same))
            own = thread_time()
            problem.integrate()
            spent["integration"].append(thread_time() - own)
            own = thread_time()
            bare_loop()
            spent["loop"].append(thread_time() - own)
            spent["C"].append(slow_bare.timed(bare_c))
            values = {key: getattr(command.inputs, key) for key in free}
            begin = perf_counter()
            command.jacobian(*free)
            jacobian.append(perf_counter() - begin)
            begin = perf_counter()
            tracker.step(**values)
            theirs.append(perf_counter() - begin)
            if floor and k % 20 == 0:
                bare.append(1e-6 * floor())
        middle = float(np.median(ours))
        multiple = f"{middle / np.median(bare):.1f} C loops, " if bare else ""
        over = f"{multiple}{middle / np.median(theirs):.2f} Tracker.step, {1e6 * middle:.0f} us here"
        row(f"Controller.step, {name}", over, meant)
        tail = {key: np.quantile(values[FIRST:], 0.999) / np.median(values[FIRST:]) for key, values in spent.items()}
        alone = (
            f"of an integration alone {tail['integration']:.1f}, of bare loops of Python {tail['loop']:.1f}, of C {tail['C']:.1f}"
        )
        row("its 99.9th percentile, of processor time", f"{tail['step']:.1f} times the median, {alone}", "2")
        row("samples of twice the median and more", f"{slow.said()}; of the loop of C {slow_bare.said()}")
        row(f"the same, of each sample the least of {AGAIN}", f"{tail['least']:.2f} times the median", "2")
        row("its jacobian", f"{np.median(jacobian) / middle:.3f} of the step", "1")


def main() -> None:
    """Print the table."""
    np.seterr(over="ignore", invalid="ignore")  # of what this file's Newton's method does not find
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=1000, help="samples of the times")
    parser.add_argument("--targets", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=1000, help="of the figure of eight that is commanded")
    parser.add_argument("--quick", action="store_true", help="a tenth of each")
    options = parser.parse_args()
    targets, samples, rounds = (n // (10 if options.quick else 1) for n in (options.targets, options.samples, options.rounds))
    robot, wrong = tubes(), Wrong()
    start = mr.solve(robot, robot.inputs(**motion(0.0), tip_force=FORCE), solver=SOLVER).raise_if_failed()
    print("| what | measured | meant |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        floor = c_loop(Path(folder), repeats=200)
        steps_of_tubes(robot, start, max(targets // 5, 20), wrong)
        all_over(robot, start, targets, wrong, floor)
        strongly_curved(max(targets // 5, 20), wrong)
        poses_of_legs(max(targets // 10, 20), wrong)
        row("unstable or beyond limits, of all these", f"{wrong.unstable} and {wrong.beyond} of {wrong.results}", "0")
        moved_together(robot, start)
        controlled(robot, start, samples)
        one_reach(robot, start, max(rounds // 5, 40), floor)
        times(rounds, floor, Path(folder))
        limited(rounds)


if __name__ == "__main__":
    main()
