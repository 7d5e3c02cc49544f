"""Rods pushed together along the axis of their base: of several sections, under loads along it, and ones that stretch.

Numbers in parentheses are those of ``docs/held.md``.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import multirod as mr
from multirod.models.held.buckling import MODES, _uneven

EI, LENGTH = 0.02, 0.5
ENDS = ["clamped", "spherical"]
KIND = {"bending_stiffness": EI, "torsional_stiffness": 0.75 * EI, "linear_density": 0.1}


def pushed(rod, apart, base_joint="clamped", joint="clamped"):
    """Held on the axis of its base, the ends so far apart."""
    end = np.eye(4)
    end[2, 3] = apart * LENGTH
    return mr.HeldRod(rod, end=end, base_joint=base_joint, joint=joint)


def uneven(first, second, part=0.4, **more):
    """Of two sections, so much stiffer than ``EI``."""
    sections = [
        mr.Section(length=share * LENGTH, bending_stiffness=k * EI, torsional_stiffness=0.75 * k * EI, linear_density=0.1, **more)
        for share, k in ((part, first), (1 - part, second))
    ]
    return mr.Rod(sections=sections)


@pytest.mark.parametrize("end", [False, True], ids=["end held", "end free"])
@pytest.mark.parametrize("base", [False, True], ids=["base held", "base free"])
def test_modes_of_uneven_rods_are_those_of_the_differential_equation(base, end):
    """(33): of even ones those of (23); of others ``(EI t')' + P t + V = 0`` integrated to 1e-10.

    By the error of 48 elements, ``(2 pi/48)^2/6`` at most.
    """
    length, stiffness, cut = 0.7, np.array([2.0, 0.5]), 0.3
    flags = np.array([base]), np.array([end])
    ends = np.array([[cut, length]])
    mode = MODES[base, end]
    units = np.array([2 / length**2, 2 / length, 2 / length, 1])
    expected = units * [mode.thrust, mode.base_moment, mode.tip_moment, mode.base_turn]
    even = _uneven(ends, np.full((1, 2), 2.0), np.array([length]), *flags)[:, 0]
    np.testing.assert_allclose(even, expected, rtol=4e-3, atol=1e-6)

    def shot(P, first, push):
        """Turn, moment, place aside and the part by which it is shortened, at the tip."""
        y = np.array([first, 0.0, 0.0, 0.0] if base else [0.0, first, 0.0, 0.0])
        for k, (a, b) in zip(stiffness, ((0, cut), (cut, length)), strict=True):

            def slope(s, y, k=k):
                return [y[1] / k, -push - P * y[0], y[0], y[0] ** 2 / 2]

            y = solve_ivp(slope, (a, b), y, rtol=1e-10, atol=1e-12).y[:, -1]
        return y

    def gap(P):
        """Determinant of what is to vanish at the tip, by the unknown at the base and the push across."""
        rows = [1 if end else 0, 2]
        return np.linalg.det(np.array([shot(P, 1.0, 0.0)[rows], shot(P, 0.0, 1.0)[rows]]))

    found = _uneven(ends, stiffness[None], np.array([length]), *flags)[:, 0]
    thrust = brentq(gap, 0.9 * found[0], 1.1 * found[0], rtol=1e-12)
    assert found[0] == pytest.approx(thrust, rel=2e-3)
    below = [gap(P) for P in np.linspace(0.02, 0.9, 30) * thrust]
    assert (np.array(below) * below[0] > 0).all()  # the first
    at = shot(thrust, 1.0, 0.0), shot(thrust, 0.0, 1.0)
    push = -at[0][2] / at[1][2]
    tip = shot(thrust, 1.0, push)
    size = np.sqrt(length / tip[3])
    assert found[3 if base else 1] == pytest.approx(size, rel=5e-3)
    assert found[2] == pytest.approx(size * tip[1], rel=5e-3, abs=1e-6)


@pytest.mark.parametrize("stiffer", [(1, 4), (4, 1)], ids=["softer at its base", "softer at its end"])
@pytest.mark.parametrize("joint", ENDS)
@pytest.mark.parametrize("base_joint", ENDS)
def test_rods_of_two_sections_bend_where_they_are_drawn(base_joint, joint, stiffer):
    """Up to 17,000 integrations led to nothing, as they began buckled as a rod does that is equally stiff all along."""
    rod = uneven(*stiffer)
    force = np.array([0.6, -0.8, 0.3]) * EI / LENGTH**3
    for apart in (0.6, 0.75, 0.95):
        robot = pushed(rod, apart, base_joint, joint)
        found = mr.solve(robot, robot.inputs(distributed_force=force)).raise_if_failed()
        assert (found.status, found.stability) == (mr.Status.CONVERGED, mr.Stability.STABLE)
        assert found.integrations < 200
        way = found.rod(0, nodes=3).position[1, :2]
        assert way @ force[:2] > (1 - 1e-6) * np.linalg.norm(way) * np.linalg.norm(force[:2])


@pytest.mark.parametrize("joint", ENDS)
@pytest.mark.parametrize("base_joint", ENDS)
def test_loads_along_the_axis_leave_a_round_rod_to_the_side_that_is_asked_for(base_joint, joint):
    """(24) They tell no plane: bent about ``y``, as if nothing acted. It was ``INTEGRATION_LIMIT`` or ``BRANCH_END``."""
    robot = pushed(mr.Rod(length=LENGTH, **KIND), 0.8, base_joint, joint)
    for size in (-30.0, -1.0, 1.0, 30.0):
        along = {"distributed_force": (0, 0, size * EI / LENGTH**3), "gravity": (0, 0, -size * EI / LENGTH**3)}
        found = [
            mr.solve(robot, robot.inputs(**along), solver=mr.Shooting(side=side)).raise_if_failed()
            for side in ("positive", "negative")
        ]
        assert max(own.integrations for own in found) < 300
        assert [own.stability for own in found] == [mr.Stability.STABLE] * 2
        ways = [own.rod(0, nodes=3).position[1] for own in found]
        assert ways[0][0] > 0.05 * LENGTH
        np.testing.assert_allclose([way[1] for way in ways], 0, atol=1e-7)
        np.testing.assert_allclose(ways[1], ways[0] * [-1, 1, 1], rtol=0, atol=1e-7)
        assert found[0].potential == pytest.approx(found[1].potential, rel=1e-9)
        # its holders bear what acts: the force, less a tenth, by which it weighs against it
        borne = found[0].wrench(0, "base").force[2] - found[0].end_force[2]
        assert borne == pytest.approx(0.9 * size * EI / LENGTH**2, rel=1e-6)


@pytest.mark.parametrize("joint", ENDS)
@pytest.mark.parametrize("base_joint", ENDS)
def test_thick_rods_pushed_far_begin_buckled(base_joint, joint):
    """Their strain is 0.4 % where they buckle: 17,000 integrations led to nothing from the straight one."""
    robot = pushed(mr.Rod(length=LENGTH, axial_stiffness=1e4 * EI / LENGTH**2, **KIND), 0.45, base_joint, joint)
    found = mr.solve(robot, robot.inputs()).raise_if_failed()
    told = mr.Status.CONVERGED if base_joint == joint == "spherical" else mr.Status.BIFURCATED  # no event is told between balls
    assert (found.status, found.stability) == (told, mr.Stability.STABLE)
    assert found.integrations < 60
