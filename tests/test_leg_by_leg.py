"""What is told of legs one by one is what is told of all together (``docs/branches.md``, (19), (20)), and legs fall in few steps
by (4) and (23)."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from random_legs import draw

import multirod as mr
from multirod.solvers.following.arrow import Arrow
from multirod.solvers.following.descent import Slopes, downhill
from multirod.solvers.following.serving.requests import Clamp, Judge
from multirod.solvers.following.serving.together import Together

BORDER, PIECES = 6, 6


def arrow_of(sizes, turns, rng):
    """Legs of so many unknowns, so many of whose residuals are forces, in any order; the platform's are all. Points in rows."""
    n = sum(sizes) + BORDER
    numbers = rng.permutation(n)
    blocks = np.split(numbers, np.cumsum(sizes))
    forces = rng.permutation(np.concatenate([*(own[:k] for own, k in zip(blocks[:-1], turns, strict=True)), blocks[-1]]))
    order = np.append(forces, rng.permutation(np.setdiff1d(np.arange(n), forces)))
    both, gamma = np.zeros((2, n, n)), np.zeros((2, n, n))
    for own in blocks:
        for place in (own, blocks[-1]):
            gamma[:, own[:, None], place] = rng.standard_normal((2, len(own), len(place)))
            gamma[:, place[:, None], own] = rng.standard_normal((2, len(place), len(own)))
            both[:, own[:, None], place] = rng.standard_normal((2, len(own), len(place)))
    return Arrow(blocks[:-1], blocks[-1], order, forces), both[:, order], gamma, forces


@pytest.mark.parametrize(("sizes", "turns"), [((5, 5, 5), (2, 2, 2)), ((7, 4, 9, 6), (3, 0, 6, 1)), ((3,), (1,))])
def test_an_arrow_is_inverted_leg_by_leg(sizes, turns):
    """Against LAPACK on the whole; of several orders, as the sign of the determinant is that of permutations too."""
    for seed in range(8):
        arrow, both, gamma, forces = arrow_of(sizes, turns, np.random.default_rng(seed))
        assert arrow.fits(both)
        assert abs(np.linalg.det(arrow.neutral)) == 1
        assert arrow.fits(arrow.neutral[None])
        found, inverse = arrow.inverse(both), np.linalg.inv(both)
        # rounding, times the condition of what is drawn by lot and of its blocks
        close = partial(np.testing.assert_allclose, rtol=0, atol=1e-14 * np.linalg.cond(both).max() ** 2 * np.abs(inverse).max())
        close(found.dense(), inverse)
        np.testing.assert_array_equal(found.sign, np.sign(np.linalg.det(both)))
        close(found.changes(gamma), gamma[:, forces] @ inverse[:, :, : len(forces)])
        other = np.setdiff1d(np.arange(both.shape[1]), arrow.border)[-1]
        both[1, arrow.border_rows[2], other] = 1e-12
        assert not arrow.fits(both)


def test_legs_with_clamps_are_told_leg_by_leg():
    """Clamped, in balls and in hinges, some of them tubes: at an equilibrium of none of them, where nothing is small."""
    drawn = draw(1, 7, 11, 5.0)  # 11 legs of all kinds
    assert set(drawn.joints) == {"clamped", "spherical", "revolute"}
    assert {len(leg) for leg in drawn.sections} == {1, 2}
    problem = drawn.robot.problem(drawn.inputs, integrator=mr.RK4(20))
    own = np.array([0])
    together = Together(problem.parts.followed(own), None, [lambda some: problem.parts.clamped(own[some], PIECES)])
    unknowns = problem.guess()[0]
    unknowns += 0.1 * np.abs(unknowns).max() * np.random.default_rng(0).standard_normal(len(unknowns))
    points = together._integrate_clamped({0: Clamp(unknowns, 1.0, 0)})[0].among
    assert points.arrow is not None
    told, whole = Slopes(points), Slopes(replace(points, arrow=None))
    assert told.fit.all()
    assert points.arrow.fits(points.turned)
    np.testing.assert_array_equal(told.facing, whole.facing)
    for name in ("ways", "back", "gradient", "by_turns", "values"):
        exact = getattr(whole, name)  # conditions are some 1e4
        np.testing.assert_allclose(getattr(told, name), exact, rtol=0, atol=1e-10 * np.abs(exact).max(), err_msg=name)


def test_what_does_not_ask_waits_where_it_began(monkeypatch):
    """All of a batch are looked at together: what a trial left of another one may take a hundred times as long."""
    column = mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=(0.02, 0.02), torsional_stiffness=0.015))
    inputs = column.inputs(tip_force=np.array([[0, 0.01, -0.1], [0, 0.02, -0.1], [0, 0.03, -0.1]]))
    problem = column.problem(inputs, integrator=mr.RK4(50))
    part = problem.parts.followed(np.arange(3))
    begins, levels = np.arange(9.0).reshape(3, 3), np.array([0.25, 0.5, 0.75])
    together = Together(part, None, (), (begins.copy(), levels.copy()))
    together.evaluate(np.array([0, 1]), np.full((2, 3), 300.0), np.array([0.1, 0.9]))
    asked, seen = {2: Judge(np.array([1.0, 2.0, 3.0]), 0.9)}, []
    modes = type(part.stability).modes

    def looked_at(own):
        seen.extend((part.read("unknowns"), part.buffer("load_factor").copy()))
        return modes(own)

    monkeypatch.setattr(type(part.stability), "modes", looked_at)
    assert set(together._judge(asked)) == {2}
    np.testing.assert_array_equal(seen[0], [*begins[:2], asked[2].unknowns])
    np.testing.assert_array_equal(seen[1], [0.25, 0.5, 0.9])
    # where they are is what is kept in the end
    np.testing.assert_array_equal(part.read("unknowns"), [[300.0] * 3] * 2 + [asked[2].unknowns])
    np.testing.assert_array_equal(together.levels, [0.1, 0.9, 0.9])


def test_dampers_keep_a_step_down_to_its_radius():
    """(4) The mode that goes farthest is cut to it, the others damped by as much; Newton's step where it is shorter, along each
    mode down; an unstable mode that nothing drives is nudged."""
    along, values = np.array([[3.0, -1.0, 0.2, 0.5]] * 2), np.array([[-2.0, 1.0, 4.0, 70.0]] * 2)
    short, whole = downhill(along, values, np.array([0.1, 9.0]))
    np.testing.assert_allclose(short, [-0.1, 1 / 30, -0.2 / 30, -0.5 / 70], rtol=1e-12)
    np.testing.assert_allclose(whole, -along[0] / np.abs(values[0]), rtol=1e-12)
    np.testing.assert_allclose(downhill(0 * along[:1], values[:1], np.array([0.1])), [[1e-4, 0, 0, 0]], atol=1e-15)


def test_platforms_that_fall_do_so_in_few_steps():
    """Off six round legs, in a batch as alone: the fall is told by the energy, 700 times what a branch would go down."""
    angles, leg = np.arange(6) * np.pi / 3, mr.Rod(length=0.4, bending_stiffness=0.02, torsional_stiffness=0.014)
    base, platform = np.zeros((2, 6, 4, 4)) + np.eye(4)
    for ends, radius, turned in ((base, 0.15, 0.2), (platform, 0.08, -0.2)):
        ends[:, 0, 3] = radius * np.cos(angles + turned * (-1.0) ** np.arange(6))
        ends[:, 1, 3] = radius * np.sin(angles + turned * (-1.0) ** np.arange(6))
    robot = mr.ParallelRods(legs=[leg] * 6, base=base, platform=platform)
    forces = np.array([[0, 0, -34.0], [0, 0, -10.0], [0, 0, -52.0]])
    found = mr.solve(robot, robot.inputs(tip_force=forces))
    assert [mr.Status(own).name for own in found.status] == ["SNAPPED", "CONVERGED", "SNAPPED"]
    assert (found.integrations[[0, 2]] < 2000).all()
    for k in (0, 2):
        (event,) = found.events[k]
        assert event.energy_lost == pytest.approx(12.3, rel=0.01)
        alone = mr.solve(robot, robot.inputs(tip_force=forces[k]))
        assert np.array_equal(alone.tip_position, found.tip_position[k])
        assert alone.integrations == found.integrations[k]
