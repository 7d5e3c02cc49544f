"""Scenes at the extremes, drawn by lot: what is marked converged obeys the equations, is on its branch, and is stable or flagged.

More of them: python tests/benchmarks/extremes.py --scenes 2000
"""

from dataclasses import replace

import numpy as np
import pytest
from random_scenes import draw
from rod_equations import RodEquations
from scene_check import RIGHT, SAME, check, violations

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
    """Whatever is solved is an equilibrium, and no unstable one is called stable; how many are solved is for the command to say."""
    verdicts = [check(draw(kind, seed)) for seed in range(8)]
    assert not [v for v in verdicts if v.wrong]
    assert not [v for v in verdicts if v.unstable and not v.flagged]
    assert not [v for v in verdicts if v.missed]
    assert sum(not v.status.failed for v in verdicts) >= 5


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
