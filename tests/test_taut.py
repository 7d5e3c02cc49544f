"""Thin rods that stretch: what they hold by being stretched gives way so little that it is nearly no mode and nearly no way."""

import numpy as np
import pytest

import multirod as mr
from multirod.models.backbone.stability.condensing.second_variation import symmetric_eigenvalues
from multirod.stability import NEUTRAL

YOUNG = 200e9
LENGTH = 0.5
SOFT = 2e-7  # of K/L by which a constraint gives way: less than ``NEUTRAL``


def wire(diameter, length=LENGTH):
    """Of steel."""
    return mr.Rod.tube(length=length, outer_diameter=diameter, young_modulus=YOUNG, poisson_ratio=0.3, extensible=True)


def soft_modes(form, firm):
    """How many eigenvalues of a form count as neutral modes'."""
    told = symmetric_eigenvalues(np.array([form]), np.ones(1, dtype=bool), np.array([firm]))
    modes = told.modes(np.zeros(1, dtype=np.int32), np.ones(1, dtype=bool), np.zeros(1, dtype=bool))
    return int(modes.soft[0])


def test_what_springs_in_line_hold_among_each_other_is_no_mode():
    """(27) by hand: two stiff springs hold a mass between walls. Their forces rise alike, (0, 1, -1), and give way by SOFT."""
    form = [[0.0, 1.0, 1.0], [1.0, -SOFT, 0.0], [1.0, 0.0, -SOFT]]
    assert SOFT < NEUTRAL
    assert soft_modes(form, [False, True, True]) == 0
    assert soft_modes(form, [False, False, True]) == 1  # a spring that may buckle
    # a mass that nothing holds beside a spring to a wall
    assert soft_modes([[0.5 * NEUTRAL, 0.0], [0.0, -1.0]], [False, True]) == 1
    # one that nothing but a spring holds, as soft as a neutral mode by its mass
    weak = np.sqrt(0.5 * NEUTRAL)
    assert soft_modes([[0.0, weak], [weak, -1.0]], [False, True]) == 1


def test_eight_straight_legs_that_stretch_are_stable():
    """Two forces that they hold among each other are no modes: it was `FOLD`."""
    count, top = 8, 0.95 * LENGTH
    angle, sign = 2 * np.pi / count * np.arange(count), np.array([1, -1] * (count // 2))
    base, platform = np.tile(np.eye(4), (2, count, 1, 1))
    legs = []
    for k in range(count):
        foot = 0.1 * np.array([np.cos(angle[k] + 0.2 * sign[k]), np.sin(angle[k] + 0.2 * sign[k]), 0.0])
        head = 0.05 * np.array([np.cos(angle[k] - 0.1 * sign[k]), np.sin(angle[k] - 0.1 * sign[k]), top / 0.05])
        length = np.linalg.norm(head - foot)
        along = (head - foot) / length
        across = np.cross((0.0, 1.0, 0.0), along)
        across /= np.linalg.norm(across)
        base[k, :3, :3] = platform[k, :3, :3] = np.stack([across, np.cross(along, across), along], axis=1)
        base[k, :3, 3], platform[k, :3, 3] = foot, head - (0, 0, top)
        legs.append(wire(1e-3, length))
    robot = mr.ParallelRods(legs=legs, base=base, platform=platform)
    solution = mr.solve(robot, robot.inputs(tip_force=(0.01, 0.005, -0.02)))
    assert solution.status is mr.Status.CONVERGED
    assert solution.stability is mr.Stability.STABLE
    assert np.abs(solution._modes.values).min() < NEUTRAL  # or it would have been before


@pytest.mark.parametrize("diameter", [2e-3, 1e-3, 0.5e-3, 0.2e-3])
def test_a_string_bears_what_it_is_stretched_by(diameter):
    """Pulled by 400 to 40,000 EI/L^2: 17,000 integrations, and no result of the thinner ones, before. As the thinnest one was
    taken for one that does not stretch, its path began pushed together."""
    robot, stretch = mr.HeldRod(wire(diameter)), 2e-4
    solution = mr.solve(robot, robot.inputs(end_position=(0, 0, stretch)))
    assert not solution.failed
    assert solution.integrations < 1500
    assert solution.stability in (mr.Stability.STABLE, mr.Stability.UNKNOWN)
    tension = YOUNG * np.pi / 4 * diameter**2 * stretch / LENGTH
    # residuals of 1e-9 of a turn or length are 1e-9 of the tension by its stiffness
    np.testing.assert_allclose(np.abs(solution.end_force), (0, 0, tension), rtol=1e-7, atol=1e-9 * tension)


@pytest.mark.parametrize("diameter", [2e-3, 1e-3, 0.5e-3])
def test_a_string_is_moved_aside_without_being_pressed_first(diameter):
    """(2b) of docs/held.md: on a straight line the end would come 0.1 mm nearer, and wires of 1 mm buckle by 5 µm: `BRANCH_END`
    after 13,000 integrations."""
    robot, length, aside = mr.HeldRod(wire(diameter)), LENGTH + 2e-4, 0.04 * LENGTH
    solution = mr.solve(robot, robot.inputs(end_position=(aside, 0, np.sqrt(length**2 - aside**2) - LENGTH)))
    assert not solution.failed
    assert solution.integrations < 1500
    assert solution.stability is mr.Stability.STABLE
    x = solution.rod(0).position[:, 0]
    assert x.min() > -1e-9  # a string between clamps, which does not sway
    assert x.max() < aside + 1e-9
    # a beam under tension is straight between layers at its clamps
    tension = np.linalg.norm(solution.end_force)
    ends = np.sqrt(YOUNG * np.pi / 64 * diameter**4 / tension)  # decay length of what clamps bend
    middle = len(x) // 2
    slope = (x[middle + 1] - x[middle - 1]) / (LENGTH * 2 / (len(x) - 1))
    assert slope == pytest.approx(aside / (LENGTH - 2 * ends), rel=1e-2)


@pytest.mark.parametrize(
    ("diameter", "aside", "short"),
    [(1e-3, 0.04, 1e-3), (2e-3, 0.02, 1e-3), (2e-3, 0.005, 1e-4), (4e-3, 0.02, 4e-3), (2e-3, 0.005, 0.99374e-3)],
)
def test_a_wire_that_hardly_gives_way_buckles_as_one_that_does_not(diameter, aside, short):
    """Its end pushed and moved aside, 5 to 100 times beyond where it buckles: 7,000 to 12,000 integrations before, where they
    led to a result at all."""
    length = LENGTH - short
    end = (aside * LENGTH, 0, np.sqrt(length**2 - (aside * LENGTH) ** 2) - LENGTH)
    stiff = mr.Rod.tube(length=LENGTH, outer_diameter=diameter, young_modulus=YOUNG, poisson_ratio=0.3)
    found, expected = (mr.solve(robot, robot.inputs(end_position=end)) for robot in map(mr.HeldRod, (wire(diameter), stiff)))
    assert (found.status, found.stability) == (mr.Status.CONVERGED, mr.Stability.STABLE)
    assert found.integrations < 400
    bow, other = (np.abs(solution.rod(0).position[:, 1]).max() for solution in (found, expected))
    # the shortening that buckles it is made up by stretch, and the bow grows with the root of the rest
    strain = (np.pi * diameter / (2 * LENGTH)) ** 2
    assert bow == pytest.approx(other * np.sqrt(1 - strain * LENGTH / short), rel=1e-2)


def test_a_string_in_a_network_is_stable():
    end = mr.Pose(position=(0, 0, LENGTH + 2e-4), rotation=np.eye(3))
    joints = [mr.Joint("string", "base", to=mr.ground), mr.Joint("string", "tip", to=mr.ground, pose=end)]
    robot = mr.Network(rods={"string": wire(1e-3)}, joints=joints, segments={"string": 8})
    solution = mr.solve(robot, robot.inputs())
    assert solution.status is mr.Status.CONVERGED
    assert solution.stability is mr.Stability.STABLE
