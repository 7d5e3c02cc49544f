"""Random robots of one rod with lines, each with the equations that it must obey written anew (``line_equations``)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from line_equations import LineEquations, LineModel, Section, SegmentEnergy

import multirod as mr

EI, GJ, LENGTH = 0.01, 0.0077, 0.2
OWN = {"bending_stiffness": EI, "torsional_stiffness": GJ}
SHEARS = {"shear_stiffness": 500.0, "axial_stiffness": 1500.0}
K, S = np.array([EI, EI, GJ]), np.array([500.0, 500.0, 1500.0])
STRONGEST = 10.0  # loads, in EI/L^2
RIGHT = 1e-6  # of the length, or of what is largest of its kind
NEUTRAL = 1e-2  # of EI/L: nearer to zero, segments may judge otherwise
SEGMENTS = 16
STEPS, FINER = 150, 4  # equal ones of the equations written anew, and how many times as many where these may not do

Routes = Callable[[int | slice], LineEquations]


@dataclass(frozen=True)
class Kind:
    """Robots of one build.

    Attributes:
        robot: With a batch of its own, or none.
        inputs: As ``robot.inputs`` takes them.
        equations: Those of one instance, or of all.
        weight: Per length in the world [N/m], (count, 3).
    """

    name: str
    robot: mr.SingleRod
    inputs: dict[str, np.ndarray]
    equations: Routes
    weight: np.ndarray


@dataclass
class Verdict:
    """Of each instance of a kind: whether it has a result, how far that is from the equations, and what both say of stability.

    ``unflagged`` is whether segments say unstable and the package stable.
    """

    status: np.ndarray
    solved: np.ndarray
    gap: np.ndarray
    slack: np.ndarray
    judged: int = 0
    unflagged: int = 0
    overcautious: int = 0

    @property
    def wrong(self) -> int:
        """How many are marked solved and are no equilibrium."""
        return int((~(self.gap[self.solved] <= RIGHT)).sum())


def constant(offset: np.ndarray, k: int | slice) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
    """The route of a line at a constant offset (count, 2) or (2,)."""
    own = offset[k] if offset.ndim > 1 else offset
    return lambda s: (own, np.zeros(2))


def ring(count: int, turn: float = 0.0, radius: float = 0.008) -> np.ndarray:
    angles = 2 * np.pi * np.arange(count) / count + turn
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def helix(turns: float) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
    a, r = 2 * np.pi * turns / LENGTH, 0.006
    return lambda s: (r * np.array([np.cos(a * s), np.sin(a * s)]), r * a * np.array([-np.sin(a * s), np.cos(a * s)]))


def cone(s: float) -> tuple[np.ndarray, np.ndarray]:
    """Converging routes."""
    return np.array([0.009 - 0.02 * s, 0.001 + 0.01 * s]), np.array([-0.02, 0.01])


def routed(route: Callable[[float], tuple[np.ndarray, np.ndarray]]) -> Callable[[float], Any]:
    return lambda s: tuple(route(s)[0])


def plain(count: int, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Loads of any direction."""
    force = random.normal(size=(count, 3))
    force *= STRONGEST * EI / LENGTH**2 * random.uniform(0, 1, (count, 1)) ** 2 / np.linalg.norm(force, axis=1, keepdims=True)
    return {"tip_force": force}


def kinds(count: int, seed: int = 1) -> dict[str, Callable[[], Kind]]:
    """Each build, made when it is asked for; ``count`` instances of each."""

    def make(name: str) -> Kind:
        random = np.random.default_rng([seed, sum(map(ord, name))])
        inputs, weight, more = plain(count, random), np.zeros((count, 3)), {}
        sections = [Section(LENGTH, K)]
        lines: list[Any]
        models: Callable[[int | slice], list[LineModel]]
        if name == "three tendons":
            offsets = random.uniform(-0.009, 0.009, (3, count, 2))
            lines = [mr.Tendon(offset=own) for own in offsets]
            inputs["tension"] = random.uniform(0, 4, (count, 3))
            models = lambda k: [LineModel(constant(own, k)) for own in offsets]
        elif name == "four that do not stretch":
            offsets = ring(4)
            lines = [mr.Tendon(offset=own, driven="displacement") for own in offsets]
            pair = random.uniform(-0.004, 0.004, (count, 2))
            inputs["displacement"] = np.concatenate([pair, -pair - random.uniform(0, 0.002, (count, 2))], axis=1)
            models = lambda k: [LineModel(constant(own, k)) for own in offsets]
        elif name == "two segments, six elastic":
            near, far = ring(3), ring(3, 1.0)
            lines = [mr.Tendon(offset=own, end=LENGTH / 2, driven="displacement", axial_stiffness=300.0) for own in near]
            lines += [mr.Tendon(offset=own, driven="displacement", axial_stiffness=300.0) for own in far]
            sections = [Section(LENGTH / 2, K * [2, 2, 1]), Section(LENGTH / 2, K)]
            inputs["displacement"] = random.uniform(-0.004, 0.006, (count, 6))
            models = lambda k: [
                *(LineModel(constant(own, k), end=LENGTH / 2) for own in near),
                *(LineModel(constant(own, k)) for own in far),
            ]
        elif name == "a helix, shear, precurvature":
            sections, more = [Section(LENGTH, K, S, np.array([3.0, -4.0, 2.0]))], SHEARS
            winding, elastic = helix(1.0), {"driven": "displacement", "axial_stiffness": 300.0}
            lines = [mr.Tendon(route=routed(winding), end=0.15, driven="displacement")]
            lines += [mr.Tendon(offset=own, **elastic) for own in ((0.007, 0), (-0.003, -0.006))]
            inputs["displacement"] = random.uniform(-0.004, 0.006, (count, 3))
            models = lambda k: [
                LineModel(winding, end=0.15),
                LineModel(constant(np.array([0.007, 0]), k)),
                LineModel(constant(np.array([-0.003, -0.006]), k)),
            ]
        elif name == "three push rods":
            offsets = ring(3)
            lines = [mr.PushRod(offset=own, bending_stiffness=0.004, axial_stiffness=1000.0) for own in offsets]
            pull = random.uniform(-0.004, 0.006, (count, 3))
            inputs["displacement"] = pull - 0.95 * pull.mean(axis=1, keepdims=True)
            models = lambda k: [LineModel(constant(own, k), bending=0.004) for own in offsets]
        elif name in ("chambers, across", "chambers, in the section"):
            offsets, hole = ring(3, 0.3), name.endswith("section")
            sections, more = [Section(LENGTH, K, S)], SHEARS
            area = 2e-5
            lines = [mr.Chamber(offset=own, area=area, area_fixed="section" if hole else "across") for own in offsets]
            # the torsion that three of them take away is GJ at 1.0
            part = random.dirichlet([1, 1, 1], count) * random.uniform(0, 0.5, (count, 1))
            inputs["pressure"] = part * GJ / (area * 0.008**2)
            models = lambda k: [LineModel(constant(own, k), hole=hole) for own in offsets]
        elif name == "a helix with weight":
            sections, more = [Section(LENGTH, K, S)], {**SHEARS, "linear_density": 0.3}
            winding = helix(2.0)
            lines = [mr.Tendon(route=routed(winding), start=0.03, end=0.16), mr.Tendon(offset=(0.0, 0.007), end=0.12)]
            inputs["tension"] = random.uniform(0, 5, (count, 2))
            gravity = random.normal(size=(count, 3))
            inputs["gravity"] = 9.81 * gravity / np.linalg.norm(gravity, axis=1, keepdims=True)
            weight = 0.3 * inputs["gravity"]
            models = lambda k: [
                LineModel(winding, start=0.03, end=0.16),
                LineModel(constant(np.array([0.0, 0.007]), k), end=0.12),
            ]
        elif name == "discs":
            offsets = ring(3)
            more = {"discs": 0.02}
            lines = [
                mr.Tendon(offset=offsets[0]),
                *(mr.Tendon(offset=own, driven="displacement", axial_stiffness=300.0) for own in offsets[1:]),
            ]
            inputs["tension"] = random.uniform(0, 5, (count, 1))
            inputs["displacement"] = random.uniform(-0.003, 0.005, (count, 2))
            models = lambda k: [LineModel(constant(own, k), discs=0.02) for own in offsets]
        elif name == "converging":
            lines = [mr.Tendon(route=routed(cone)), mr.Tendon(offset=(-0.008, 0.0), driven="displacement")]
            inputs["tension"] = random.uniform(0, 4, (count, 1))
            inputs["displacement"] = random.uniform(-0.005, 0.01, (count, 1))
            models = lambda k: [LineModel(cone), LineModel(constant(np.array([-0.008, 0.0]), k))]
        else:
            raise KeyError(name)
        if len(sections) > 1:
            own = [
                mr.Section(length=one.length, bending_stiffness=one.K[0], torsional_stiffness=one.K[2], **more)
                for one in sections
            ]
            rod = mr.Rod(sections=own, lines=lines)
        else:
            bent = sections[0].u_star
            rod = mr.Rod(length=LENGTH, **OWN, **more, lines=lines, precurvature=(0, 0, 0) if bent is None else tuple(bent))
        return Kind(name, mr.SingleRod(rod), inputs, lambda k: LineEquations(sections, models(k)), weight)

    names = (
        "three tendons",
        "four that do not stretch",
        "two segments, six elastic",
        "a helix, shear, precurvature",
        "three push rods",
        "chambers, across",
        "chambers, in the section",
        "a helix with weight",
        "discs",
        "converging",
    )
    return {name: (lambda name=name: make(name)) for name in names}


def check(kind: Kind, *, judge: int = 0) -> Verdict:
    """Solve at default settings and compare; the stability of the first ``judge`` instances too."""
    robot, lines = kind.robot, kind.robot.rods[0].lines
    inputs = robot.inputs(**kind.inputs)
    found = mr.solve(robot, inputs, progress=False)
    status = np.asarray(found.status)
    solved = np.isfinite(found.tip_position[:, 0])
    force, rows = kind.inputs["tip_force"], np.flatnonzero(solved)
    gap = np.full(len(status), np.nan)
    if len(rows):
        gap[rows] = _gap(kind, found, rows, STEPS)
        if len(far := np.flatnonzero(gap > RIGHT)):  # by the solution, or by these steps?
            gap[far] = _gap(kind, found, far, FINER * STEPS)
    verdict = Verdict(status, solved, gap, found.slack)
    held = np.array([hasattr(line, "rest_length") for line in lines])
    rest = _rest(kind)
    stretch = np.array([line.axial_stiffness / l0 if h else np.inf for line, l0, h in zip(lines, rest, held, strict=True)])
    for k in rows[rows < judge]:
        segments = SegmentEnergy(kind.equations(int(k)), SEGMENTS)
        x = _strains(found[int(k)], segments)
        taut = held & ~found.slack[k]
        index, nearest = segments.index(x, force[k], kind.weight[k], found.tension[k], taut, stretch)
        if abs(nearest) < NEUTRAL:
            continue
        verdict.judged += 1
        says = found[int(k)].stability
        verdict.unflagged += index > 0 and says == mr.Stability.STABLE
        verdict.overcautious += index == 0 and says == mr.Stability.UNSTABLE
    return verdict


def _gap(kind: Kind, found: mr.Solution, rows: np.ndarray, steps: int) -> np.ndarray:
    """How far these instances are from the equations, integrated by so many steps."""
    force, T = kind.inputs["tip_force"][rows], found.tension[rows]
    base = found.rod(0, nodes=2).total_moment[:, 0][rows]
    own = kind.equations(rows if kind.robot.batch_shape else slice(None))  # type: ignore[arg-type]
    tip = own.integrate(T, force, base, kind.weight[rows], steps)
    at_tip = np.linalg.norm(tip.moment, axis=1) * LENGTH / EI
    apart = np.linalg.norm(tip.position - found.tip_position[rows], axis=1) / LENGTH
    turned = np.abs(tip.rotation - found.tip_rotation[rows]).max(axis=(1, 2))
    longer = np.abs(tip.length - found.line_length[rows]).max(axis=1) / LENGTH
    stored = np.abs(tip.energy - found.energy[rows]) / (EI / LENGTH)
    gaps = [at_tip, apart, turned, longer, stored, _conditions(kind, rows, tip.length, T, found.slack[rows])]
    return np.asarray(np.max(gaps, axis=0))


def _rest(kind: Kind) -> np.ndarray:
    """How long each line is in the rod without load."""
    equations, none = kind.equations(0), np.zeros((1, 3))
    return np.asarray(equations.integrate(np.zeros((1, len(equations.lines))), none, none).length[0])


def _conditions(kind: Kind, rows: np.ndarray, length: np.ndarray, T: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """How far lines that are driven by displacement are from what that says, over the length of the rod (count,)."""
    result, k = np.zeros(len(T)), 0
    rest = _rest(kind)
    for i, line in enumerate(kind.robot.rods[0].lines):
        if not hasattr(line, "rest_length"):
            continue
        over = length[:, i] - (rest[i] * (1 + T[:, i] / line.axial_stiffness) - kind.inputs["displacement"][rows, k])
        result = np.maximum(result, np.where(slack[:, i], np.maximum(over, 0), np.abs(over)) / LENGTH)
        if isinstance(line, mr.Tendon):
            result = np.where(T[:, i] < 0, np.inf, result)
        k += 1
    return result


def _strains(solution: mr.Solution, segments: SegmentEnergy) -> np.ndarray:
    """Those of the solution in the middle of each segment."""
    shape = solution.rod(0, nodes=801)
    u = np.stack([np.interp(segments.middle, shape.arclength, shape.curvature[:, j]) for j in range(3)], axis=1)
    if not segments.shears:
        return u.ravel()
    force = np.stack([np.interp(segments.middle, shape.arclength, shape.force[:, j]) for j in range(3)], axis=1)
    return np.concatenate([u, np.array([0, 0, 1.0]) + force / S], axis=1).ravel()
