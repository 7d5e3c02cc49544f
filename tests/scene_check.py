"""What the package says of a scene against equations that are none of its own."""

from dataclasses import dataclass
from time import process_time

import numpy as np
from leg_equations import LegEquations
from random_scenes import Scene
from reference_branch import ReferenceBranch
from rod_equations import RodEquations
from tube_equations import TubeEquations, base_of

import multirod as mr

RIGHT = 1e-6  # of the units of ``RodEquations.units``: what the default integrator promises
SAME = 1e-3  # of the length: two tips of one branch; another branch leads elsewhere
NEUTRAL = 1e-4  # of EI/L: a margin below which a stability is not told from the other
STRONGEST = 2e3  # load in EI/L^2 up to which the branch is followed anew
FINER = (1, 2, 4)  # intervals of the branch that is followed anew: soft torsion needs more; another branch stays another
MOST_TURNS = 40.0
MOST_INTERVALS = 24000


@dataclass
class Verdict:
    """How one scene went.

    Attributes:
        status: Of the solution.
        seconds: Processor time that the solve took.
        gap: Largest violation of the equations between two nodes, NaN where the solve failed.
        error: Distance of the tip over the length from that of the equilibrium nearby, infinite where there is none.
        shape: Violation of the conditions at the tip by the shape, and its distance there from the tip that is given.
        missed: Unstable modes by the second variation less those by the package, None where either does not say.
        unstable: Whether the second variation has an unstable mode.
        flagged: Whether the package says anything but ``STABLE``.
        reference: Distance of the tips over the length, None where the branch was not followed anew to its end.
        ends: Part of the load at which the branch that was followed anew is lost, None where it was not followed.
    """

    status: mr.Status
    seconds: float
    gap: float = np.nan
    error: float = np.nan
    shape: float = np.nan
    missed: int | None = None
    unstable: bool = False
    flagged: bool = False
    reference: float | None = None
    ends: float | None = None

    @property
    def wrong(self) -> bool:
        """Whether what is marked converged is no equilibrium."""
        return not self.status.failed and not max(self.gap, self.error) <= RIGHT


def violations(solution: mr.Solution, rod: RodEquations) -> tuple[float, float, float]:
    """Of a single rod: the equations from node to node; the tip, by the equilibrium nearby; conditions at the tip and pose of the
    shape."""
    shape = solution.rod(0, nodes=rod.node_count(solution.rod(0)))
    gap = max(rod.gap(shape), np.abs(shape.position[0]).max() / rod.length, np.abs(shape.rotation[0] - np.eye(3)).max())
    pose = np.abs(shape.position[-1] - solution.tip_position).max() / rod.length
    error, before, intervals = np.inf, np.inf, min(6 * len(shape.arclength), MOST_INTERVALS)
    # finer for as long as it is the reference that is coarse
    while error > RIGHT / 2 and intervals <= MOST_INTERVALS:
        exact = ReferenceBranch(*rod.given, intervals).near(shape)
        if exact is not None:
            before, error = error, np.linalg.norm(exact[-1, :3] - solution.tip_position) / rod.length
            if error > before / 2:
                break
        intervals *= 2
    return gap, float(error), float(max(rod.tip(shape), pose))


def check(scene: Scene, *, reference: bool = False) -> Verdict:
    """Solve a scene at default settings and judge what comes out."""
    begin = process_time()
    solution = mr.solve(scene.robot, scene.inputs)
    verdict = Verdict(solution.status, process_time() - begin)
    if isinstance(scene.robot, mr.SingleRod):
        _judge_rod(scene, solution, verdict, reference)
    elif isinstance(scene.robot, mr.ConcentricTubes):
        _judge_tubes(scene, solution, verdict)
    else:
        _judge_legs(scene, solution, verdict)
    return verdict


def _judge_rod(scene: Scene, solution: mr.Solution, verdict: Verdict, reference: bool) -> None:
    rod = RodEquations(scene.rods[0], scene.loads)
    if not solution.status.failed:
        verdict.gap, verdict.error, verdict.shape = violations(solution, rod)
        if set(scene.loads) <= {"tip_force", "distributed_force", "gravity"}:
            _judge_stability(solution, verdict, *rod.index(solution.rod(0, nodes=2 * rod.node_count(solution.rod(0)) + 61)))
    turns = rod.length * np.abs(rod.u_star).max() / (2 * np.pi)
    if reference and scene.load <= STRONGEST and turns <= MOST_TURNS:
        intervals = int(max(80, 12 * (np.sqrt(scene.load) + 2 * np.pi * turns)))
        for finer in FINER:
            states, verdict.ends = ReferenceBranch(*rod.given, finer * intervals).follow(min(1.0, 0.5 / scene.load))
            if states is None or solution.status.failed:
                break
            verdict.reference = float(np.linalg.norm(states[-1, :3] - solution.tip_position) / rod.length)
            if verdict.reference <= SAME:
                break


def _judge_tubes(scene: Scene, solution: mr.Solution, verdict: Verdict) -> None:
    if solution.status.failed:
        return
    loads = scene.loads
    tubes = TubeEquations(scene.rods, loads["rotation"], loads["translation"], loads["tip_force"])
    moment, torque = base_of(solution, tubes.count)
    found = tubes.solve(moment, torque)
    if found is None:
        verdict.error = np.inf
        return
    start, tip, verdict.gap = found
    verdict.error = float(np.abs(tip[:3] - solution.tip_position).max() / tubes.length)
    verdict.shape = float(np.abs(solution.rod(0, nodes=3).position[-1] - solution.tip_position).max() / tubes.length)
    if tubes.ends[0] == tubes.length:
        _judge_stability(solution, verdict, *tubes.index(start))


def _judge_legs(scene: Scene, solution: mr.Solution, verdict: Verdict) -> None:
    if solution.status.failed:
        return
    legs = LegEquations(scene.rods, scene.loads)
    verdict.gap = max(leg.gap(solution.rod(k, nodes=leg.node_count(solution.rod(k)))) for k, leg in enumerate(legs.legs))
    found = legs.solve(legs.starts(solution), solution.tip_position, solution.tip_rotation)
    verdict.error = np.inf
    if found is not None:
        verdict.error = float(np.abs(found[0] - solution.tip_position).max() / legs.length)
        verdict.shape = float(np.abs(found[2]).max())


def _judge_stability(solution: mr.Solution, verdict: Verdict, unstable: int, margin: float) -> None:
    verdict.unstable = unstable > 0
    verdict.flagged = solution.stability is not mr.Stability.STABLE
    if margin > 0 and abs(solution.stability_margin) > NEUTRAL and solution.index >= 0:
        verdict.missed = unstable - solution.index
