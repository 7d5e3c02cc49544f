"""Scenes at the extremes, drawn by lot: what is marked converged obeys the equations, is on its branch, and is stable or flagged.

More of them: python tests/benchmarks/extremes.py --scenes 2000
"""

from dataclasses import replace

import numpy as np
import pytest
from random_scenes import draw
from rod_equations import RodEquations
from scene_check import RIGHT, SAME, check, violations
from tube_equations import TubeEquations, base_of

import multirod as mr

SEEDS = {
    "force": [seed for seed in range(24) if seed not in (1, 6)],  # which take a second each and more
    "all dead": [3, 4, 6, 7, 9, 10, 11, 13],
}


@pytest.mark.parametrize("kind", SEEDS)
def test_single_rods(kind):
    """Those that fixed seeds draw, of two kinds whose kernels other tests compile too."""
    verdicts = [check(draw(kind, seed), reference=seed % 4 == 0) for seed in SEEDS[kind]]
    assert not [v for v in verdicts if v.wrong]
    assert not [v for v in verdicts if v.unstable and not v.flagged]
    assert not [v for v in verdicts if v.missed]
    assert not [v for v in verdicts if v.reference is not None and v.reference > SAME]
    assert not [v for v in verdicts if v.ends == 1 and v.status.failed]
    assert sum(not v.status.failed for v in verdicts) >= 0.9 * len(verdicts)


@pytest.mark.parametrize("kind", ["two tubes", "three legs"])
def test_robots_of_several_rods(kind):
    """Whatever is solved is an equilibrium, and no unstable one is called stable; how many are solved is for the command to
    say."""
    verdicts = [check(draw(kind, seed)) for seed in range(8)]
    assert not [v for v in verdicts if v.wrong]
    assert not [v for v in verdicts if v.unstable and not v.flagged]
    assert not [v for v in verdicts if v.missed]
    assert sum(not v.status.failed for v in verdicts) >= 5


def test_shapes_of_legs_that_are_pulled_hard_are_told_by_any_nodes():
    """400 EI/L^2 in the softest of three, whose errors grow a hundred million times along it."""
    scene = draw("three legs", 4)
    solution = mr.solve(scene.robot, scene.inputs).raise_if_failed()
    batch = mr.solve(scene.robot, scene.inputs.broadcast_to((2,)))
    coarse = solution.rod(2, nodes=11).position
    for nodes in (51, 61, 81):
        own = solution.rod(2, nodes=nodes).position
        np.testing.assert_allclose(own[:: (nodes - 1) // 10], coarse, atol=1e-4 * scene.robot.longest)
        np.testing.assert_array_equal(batch[1].rod(2, nodes=nodes).position, own)
    assert np.isfinite(solution.energy)


def test_a_segment_that_cannot_be_integrated_fails_its_step_alone():
    """Torsion 6e-5 times as stiff as bending, under 3e4 EI/L^2 of the softest section: on the way a trial overflows, which once
    raised."""
    verdict = check(draw("force and shear", 11004))
    assert not verdict.status.failed
    assert not verdict.wrong


@pytest.fixture(scope="module")
def loaded():
    """A rod under 31 EI/L^2, its solution and its equations."""
    scene = draw("force", 3)
    return mr.solve(scene.robot, scene.inputs).raise_if_failed(), RodEquations(scene.rods[0], scene.loads)


@pytest.mark.parametrize("name", ["position", "rotation", "moment", "force"])
def test_the_check_sees_a_shape_that_is_off_by_a_hundred_thousandth(loaded, name):
    solution, rod = loaded
    shape = solution.rod(0, nodes=rod.node_count(solution.rod(0)))
    assert rod.gap(shape) < RIGHT / 10
    value = getattr(shape, name).copy()
    value[len(value) // 2] += 1e-5 * np.abs(value).max()
    assert rod.gap(replace(shape, **{name: value})) > RIGHT


@pytest.mark.parametrize("load", ["tip_force", "weight", "precurvature"])
def test_the_check_sees_other_equations(loaded, load):
    """A force, a weight or a precurvature that the solution does not know of, of a millionth of what acts or a little more."""
    solution, rod = loaded
    sections, loads = rod.given
    other = dict(loads)
    section = dict(sections[0])
    if load == "tip_force":
        other["tip_force"] = loads["tip_force"] * (1 + 1e-5)
    elif load == "weight":
        other["distributed_force"] = 1e-4 * loads["tip_force"] / rod.length
    else:
        section["precurvature"] = np.array(section["precurvature"]) + 1e-4 / rod.length
    gap, error, _ = violations(solution, RodEquations([section], other))
    assert max(gap, error) > RIGHT


def test_the_check_sees_another_branch(loaded):
    """The same force on the other side of the rod: its mirror image is an equilibrium of another scene."""
    solution, rod = loaded
    sections, loads = rod.given
    gap, error, _ = violations(solution, RodEquations(sections, {"tip_force": -loads["tip_force"]}))
    assert gap > 1e-3 or error > SAME


def test_the_second_variation_counts_the_modes_of_columns():
    """Clamped-free: pi^2 EI/(4 L^2) (2 k + 1)^2, here about two axes that differ by 1.3; the straight column is an equilibrium at
    any load."""
    section = {"length": 1.0, "bending_stiffness": (1.0, 1.3), "torsional_stiffness": 0.8}
    robot = mr.SingleRod(mr.Rod(sections=[mr.Section(**section)]))
    for load, modes in ((0.99, 0), (1.01, 1), (1.29, 1), (1.31, 2), (8.9, 2), (9.1, 3)):
        force = (0, 0, -load * np.pi**2 / 4)
        solution = mr.solve(robot, robot.inputs(tip_force=force), guess=(0.0, 0.0, 0.0))
        assert RodEquations([section], {"tip_force": force}).index(solution.rod(0, nodes=401))[0] == modes == solution.index


def test_the_second_variation_counts_the_modes_of_tubes():
    """Opposite tubes under 8 N against their tips have equilibria with 0, 2 and 3 unstable modes: the package's count at each."""
    rods = []
    for length, EI, curvature in ((0.4, 0.01, (6, 1, 0.3)), (0.3, 0.03, (3, 1, 0.3))):
        stiffness = {"bending_stiffness": EI, "torsional_stiffness": 0.7 * EI}
        straight = {"length": 0.2, "precurvature": (0, 0, 0)} | stiffness
        rods.append([straight, {"length": length - 0.2, "precurvature": curvature} | stiffness])
    robot = mr.ConcentricTubes([mr.Rod(sections=[mr.Section(**s) for s in sections]) for sections in rods])
    alpha, beta, force = (0.3, 3.1), (-0.1, -0.05), (0, 0, -8)
    found = mr.equilibria(robot, robot.inputs(rotation=alpha, translation=beta, tip_force=force))
    tubes = TubeEquations(rods, alpha, beta, force)
    counts = []
    for k in range(found.batch_shape[0]):
        start, tip, _ = tubes.solve(*base_of(found[k], 2))
        np.testing.assert_allclose(tip[:3], found[k].tip_position, rtol=0, atol=RIGHT * tubes.length)
        counts.append(tubes.index(start)[0])
        assert counts[-1] == found[k].index
    assert max(counts) >= 2
