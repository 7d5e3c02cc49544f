"""Down valleys, where next to nothing holds a robot in one mode: round columns under next to no load across
(``docs/branches.md``, (13))."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipk

import multirod as mr
from multirod.solvers.following.descent import Points
from multirod.solvers.following.valley import FIRST, LONGEST, LOOKS, along_floor, by_residuals, by_turns, down_valley

EI, LENGTH = 0.02, 0.2
EULER = 4 * np.pi**2 * EI / LENGTH**2
FINE = mr.RK45(rtol=1e-11, atol=1e-13)
ACROSS, BESIDE = np.array([0.6, -0.8, 0.0]), np.array([0.8, 0.6, 0.0])


class Moat:
    """A valley around a circle of radius 2, ``walls (r - 2)^2/2 - slope r cos(angle - 1)``: its lowest place is known."""

    def __init__(self, slope, walls=1.0):
        self.slope, self.walls, self.looks = slope, walls, 0

    def at(self, x, level):
        self.looks += 1
        r = np.linalg.norm(x)
        out = x / r
        gradient = self.walls * (r - 2) * out - self.slope * np.array([np.cos(1), np.sin(1)])
        second = self.walls * (np.outer(out, out) + (r - 2) / r * (np.eye(2) - np.outer(out, out)))
        none, both = np.zeros(3), np.arange(2)
        said = x, level, gradient, second
        more = np.ones(2), np.eye(2), none[None, :, None], none, np.eye(3)[None], 1.0
        return Points(*(np.array([own]) for own in said), both, *(np.array([own]) for own in more))[0]
        yield  # as what asks for integrations does

    def across(self, x):
        """Newton's method but for the last singular vector."""
        for _ in range(20):
            point = yield from self.at(x, 1.0)
            u, s, v = np.linalg.svd(point.gamma)
            if abs(u[:, 0] @ point.residual) < 1e-12:
                return point
            x = x - v[0] * (u[:, 0] @ point.residual) / s[0]


@pytest.mark.parametrize("slope", [1e-3, 1e-6])
@pytest.mark.parametrize(("way", "angle"), [("turns", 3.9), ("turns", -1.2), ("residuals", 2.2), ("residuals", 0.1)])
def test_the_lowest_place_of_a_valley_is_found_around_its_bend(slope, way, angle):
    """By residuals, which do not tell the lowest place from the highest, from nearer than the middle between them."""
    moat, tolerance = Moat(slope), 1e-6 * slope
    floor = by_turns(moat.at, 1.0, 1.0) if way == "turns" else by_residuals(moat.across)
    walk = down_valley(floor, 2 * np.array([np.cos(angle), np.sin(angle)]), FIRST, LONGEST, tolerance)
    with pytest.raises(StopIteration) as end:
        next(walk)
    point = end.value.value
    # the slope along it falls by itself within a radian
    np.testing.assert_allclose(point.unknowns, (2 + slope) * np.array([np.cos(1), np.sin(1)]), atol=4e-6)
    assert point.slope.values[0] > 0
    assert moat.looks < 60


@pytest.mark.parametrize("walls", [10.0, 1e4])
@pytest.mark.parametrize("kick", [0.0, 0.02])
def test_steps_on_a_floor_bend_with_it_however_stiff_its_walls_are(walls, kick):
    """(21) of docs/branches.md. Steps as short as (9) has them are of some hundredth here, or less."""
    moat = Moat(0.5, walls)
    with pytest.raises(StopIteration) as begun:
        next(moat.at(2 * np.array([np.cos(1 + np.pi), np.sin(1 + np.pi)]) + (0.01, 0.0), 1.0))
    start = begun.value.value
    first = kick * np.array([-np.sin(1 + np.pi), np.cos(1 + np.pi)])
    with pytest.raises(StopIteration) as end:
        next(along_floor(moat.at, start, start.slope, first, 1e-9))
    np.testing.assert_allclose(end.value.value.unknowns, (2 + 0.5 / walls) * np.array([np.cos(1), np.sin(1)]), atol=1e-8)
    assert moat.looks < 45


def test_steps_on_a_floor_that_leads_nowhere_come_to_an_end():
    """Down a slope without an end."""
    looks = []

    def at(x, level):
        looks.append(x)
        point = yield from Moat(0.0, 1e4).at(np.array([2.0, 0.0]), level)
        return replace(point.among, unknowns=x[None], residual=np.array([[0.0, 0.3]]))[0]

    with pytest.raises(StopIteration) as begun:
        next(at(np.array([2.0, 0.0]), 1.0))
    start = begun.value.value
    with pytest.raises(StopIteration) as end:
        next(along_floor(at, start, start.slope, np.zeros(2), 1e-9))
    assert end.value.value is None
    assert len(looks) == LOOKS + 1


def test_a_valley_without_a_lowest_place_has_none():
    moat = Moat(0.0)

    def at(x, level):  # a slope all around, as errors make it
        point = yield from moat.at(x, level)
        aside = 1e-6 * np.array([-x[1], x[0]])
        return replace(point.among, residual=point.among.residual + aside)[0]

    with pytest.raises(StopIteration) as end:
        next(down_valley(by_turns(at, 1.0, 1.0), np.array([2.0, 0.0]), FIRST, LONGEST, 1e-9))
    assert end.value.value is None
    assert moat.looks < 200


def column(torsion=0.8):
    """Clamped at both ends, one of which slides."""
    return mr.HeldRod(mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=torsion * EI), slide=(0, 0, 1))


def solved(load, share, **options):
    """Under ``load`` times Euler's load, and ``share`` of it across."""
    robot, thrust = column(), load * EULER
    across = share * thrust / LENGTH * ACROSS
    return mr.solve(robot, robot.inputs(tip_force=(0, 0, -thrust), distributed_force=across), **options)


@pytest.mark.parametrize("share", [1e-7, 1e-5])
def test_next_to_no_load_across_tells_the_side_of_the_elastica(share):
    found = solved(1.05, share)
    assert found.status is mr.Status.CONVERGED
    k = brentq(lambda k: 2 * ellipk(k * k) / np.pi - np.sqrt(1.05), 1e-6, 0.99)
    middle = found.rod(0, nodes=3).position[1]
    # four quarters; the load bends it by its share, over by how much the column is beyond Euler's load, more
    np.testing.assert_allclose(middle @ ACROSS, LENGTH * k / ellipk(k * k), rtol=1e-5 + 10 * share)
    assert abs(middle @ BESIDE) < 1e-3 * LENGTH


@pytest.mark.parametrize("load", [1.5, 3.0])
@pytest.mark.parametrize("share", [1e-7, 1e-5, 1e-3])
def test_a_column_that_leaves_its_plane_goes_where_next_to_no_load_across_takes_it(load, share):
    """It was ``BRANCH_END`` after 14,000 integrations. Of all ways that one without that load may be turned about its axis it has
    the one in which that does the most work: it has no moment about the axis, exactly."""
    found, free = (solved(load, own, solver=mr.Shooting(integrator=FINE)) for own in (share, 0))
    assert found.status is mr.Status.SNAPPED
    assert found.stability in (mr.Stability.STABLE, mr.Stability.FOLD)
    assert found.integrations < 12_000  # a look with clamps is six
    own, other = (solution.rod(0, nodes=201).position for solution in (found, free))
    apart = [np.linalg.norm(places[100, :2]) for places in (own, other)]
    assert apart[0] == pytest.approx(apart[1], rel=1e-5 + share)
    np.testing.assert_allclose(own[:, 2], other[:, 2], atol=LENGTH * (1e-5 + share))
    work, moment = np.trapezoid(own @ ACROSS), np.trapezoid(own @ BESIDE)
    assert work > 0.8 * np.trapezoid(np.linalg.norm(own[:, :2], axis=1))
    # what is missing may be 1e-9/m, of which the load across is 0.6/m for each share of the thrust
    assert abs(moment / work) < 1e-5 + 2e-9 / share


def test_what_is_bent_to_one_side_is_bent_to_the_other_by_a_load_against_it():
    found, against = solved(2.0, 1e-5), solved(2.0, -1e-5)
    np.testing.assert_allclose(
        found.rod(0, nodes=3).position[1] * (-1, -1, 1), against.rod(0, nodes=3).position[1], atol=1e-4 * LENGTH
    )
