"""Random robots with lines, at default settings: no wrong result, and none that is unstable without a word."""

import numpy as np
import pytest
import random_lines

import multirod as mr

# some of the builds, as each needs kernels of its own; all of them: python tests/benchmarks/random_lines.py
BUILDS = ("a helix, shear, precurvature", "three push rods", "discs")


@pytest.mark.parametrize("build", BUILDS)
def test_solutions_obey_equations_written_anew(build: str) -> None:
    kind = random_lines.kinds(16, seed=2)[build]()
    verdict = random_lines.check(kind, judge=1)
    assert verdict.wrong == 0
    assert verdict.solved.mean() > 0.9
    assert verdict.judged > 0
    assert verdict.unflagged == 0
    assert verdict.overcautious == 0


def test_a_wrong_equation_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The check fails where a line runs elsewhere than it is told; no finer steps are needed to see that."""
    monkeypatch.setattr(random_lines, "FINER", 1)
    kind = random_lines.kinds(3, seed=2)["three push rods"]()
    elsewhere = random_lines.ring(3, 1e-4)
    lines = [random_lines.LineModel(random_lines.constant(own, 0), bending=0.004) for own in elsewhere]
    moved = random_lines.LineEquations([random_lines.Section(random_lines.LENGTH, random_lines.K)], lines)
    wrong = random_lines.Kind(kind.name, kind.robot, kind.inputs, lambda _: moved, kind.weight)
    verdict = random_lines.check(wrong)
    assert verdict.wrong == verdict.solved.sum() > 0
    assert (verdict.status == mr.Status.CONVERGED).all()
    assert np.nanmedian(verdict.gap) > 1e-6
