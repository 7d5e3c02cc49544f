"""The witnesses of branches agree with each other, robots on segments that creep and the energy of tubes by strains, and the
package with them."""

from copy import deepcopy

import numpy as np
import pytest
from discrete_energy import DiscreteEnergy, Tube
from leg_energy import Leg, LegEnergy
from legs_on_segments import on_segments
from random_legs import draw
from relaxation import CreepingRods, rotation
from tube_leg_energy import TubeLeg, TubeOnNodes

import multirod as mr

COUNT = 12


def clamped(leg, force):
    """One leg whose end is the platform."""
    return LegEnergy([leg], leg.tip(), leg.frames[-1].copy(), np.asarray(force, float))


def frames(turns):
    """Of nodes, from the rotations of all segments."""
    result = [np.eye(3)]
    for turn in turns:
        result.append(result[-1] @ rotation(turn))
    return np.array(result)


def test_a_leg_creeps_to_where_a_rod_does():
    """The same segments, so the same state but for what is left when both rest."""
    precurvature, stiffness, force = np.array([9.0, -3.0, 1.0]), np.array([1, 1, 0.3]), np.array([8.0, 5.0, -12.0])
    rods = CreepingRods(np.ones(1), stiffness[None], precurvature[None], COUNT)
    leg = Leg(
        1.0,
        stiffness,
        None,
        precurvature,
        np.eye(4),
        np.eye(4),
        "clamped",
        np.zeros(3),
        np.array(rods.R[0]),
        np.zeros(COUNT + 1),
    )
    energy = clamped(leg, force)
    for level in np.linspace(0, 1, 5):
        assert rods.settle(level * force[None], tolerance=1e-6).all()
        energy.force = level * force
        assert energy.creep()
        np.testing.assert_allclose(energy.position, rods.tip[0], rtol=0, atol=1e-4)
    assert energy.lowest() > 0


@pytest.mark.parametrize("axial", [None, 50.0], ids=["stiff", "stretches"])
def test_loads_along_a_leg_are_slopes_of_its_energy(axial):
    """By differences, whose error is 1e-10 and 1e-6 of them; and the work is that of the forces on the way of the nodes."""
    rng, count, step = np.random.default_rng(0), 6, 1e-4
    stretch = np.zeros(count + 1) if axial is None else 0.1 * rng.standard_normal(count + 1)
    own = frames(0.3 * rng.standard_normal((count, 3))), stretch
    stiffness, force = np.array([1, 1.5, 0.8]), rng.standard_normal((count, 3))
    leg = Leg(1.1, stiffness, axial, np.array([0.5, 0.2, 0.1]), np.eye(4), np.eye(4), "clamped", np.zeros(3), *own)
    leg.carry(force)

    def energy(move):
        moved = deepcopy(leg)
        moved.move(move)
        tangents = moved.frames[..., 2] * (1 + moved.stretch)[:, None]
        places = np.cumsum(np.append(np.zeros((1, 3)), 0.5 * leg.h * (tangents[1:] + tangents[:-1]), axis=0), axis=0)
        work = 0.5 * leg.h * (force * (places[1:] + places[:-1])).sum()
        stretched = 0.0 if axial is None else 0.5 * axial * (leg.weight * moved.stretch**2).sum()
        assert (leg.load * tangents).sum() == pytest.approx(work, rel=1e-12)
        return moved.bent(np.zeros((count, 6))).sum() + stretched - work

    whole = clamped(leg, np.zeros(3))
    whole.pull = np.zeros(len(whole.system()[1]))
    gradient, _, _, H = whole.system()
    slopes = [(energy(step * way) - energy(-step * way)) / (2 * step) for way in np.eye(leg.size)]
    np.testing.assert_allclose(gradient[: leg.size], slopes, rtol=0, atol=1e-6)
    for _ in range(3):
        way, far = rng.standard_normal(leg.size), 1e-3
        second = (energy(far * way) + energy(-far * way) - 2 * energy(0 * way)) / far**2
        assert way @ H[: leg.size, : leg.size] @ way == pytest.approx(second, rel=1e-5)


@pytest.mark.parametrize(
    ("turn", "behind"), [(0.0, (0.0, 0.0)), (2.0, (0.0, 0.0)), (2.0, (0.25, 0.5)), (2.0, (0.0, 0.5)), (2.0, (0.25, 0.0))], ids=str
)
def test_a_leg_of_tubes_is_a_pair_of_tubes(turn, behind):
    """That of ``DiscreteEnergy``, whose tangents are not averaged over segments: 16 of them differ by a hundredth of the tip."""
    count, reach, EI, GJ = 16, 10, np.array([1.0, 1.5]), np.array([0.77, 1.1])
    curved = np.array([[1.2, 0, 0], [2.0, 0, 0]])
    rest = [np.where(np.arange(count)[:, None] < 4, 0.0, curved[0]), np.tile(curved[1], (reach, 1))]
    turned = (0.3, 0.3 + turn)
    tubes = [
        TubeOnNodes(np.tile([EI[i], EI[i], GJ[i]], (len(rest[i]), 1)), rest[i], turned[i], behind[i] / GJ[i], np.full(n, turn))
        for i, n in enumerate((count + 1, reach + 1))
    ]
    start = rotation(np.array([0, 0, turned[0]])) @ frames(rest[0] / count)
    leg = TubeLeg(
        1.0,
        np.zeros(3),
        None,
        np.zeros(3),
        np.eye(4),
        np.eye(4),
        "clamped",
        np.zeros(3),
        start,
        np.zeros(count + 1),
        np.linspace(0, 1, count + 1),
        tubes,
    )
    force = np.array([0.3, 0.5, -0.2])
    energy = clamped(leg, force)
    assert energy.creep()
    assert energy.lowest() > 0
    pair = [
        Tube(behind[0] + 1.0, behind[0] + 4 / count, EI[0], GJ[0], tuple(curved[0]), turned[0], behind[0]),
        Tube(behind[1] + reach / count, 0.0, EI[1], GJ[1], tuple(curved[1]), turned[1], behind[1]),
    ]
    other = DiscreteEnergy(pair, force, count)
    angle = leg.others[0].angle
    base = [leg.begun - turned[0], leg.begun + angle[0] - turned[1]]
    u = np.concatenate([leg.curved(np.zeros((count, 6))).ravel(), np.diff(angle) * count, [base[k] for k in other.turning]])
    assert len(u) == other.size
    found, negative = other.stationary(u)
    assert negative == 0
    turns = np.zeros(2)
    turns[other.turning] = found[3 * count + reach :]
    np.testing.assert_allclose(
        other.tip(found[None, : 3 * count].reshape(1, count, 3), turned[:1] + turns[:1])[0], energy.position, atol=1e-2
    )
    np.testing.assert_allclose(np.cumsum(found[3 * count : 3 * count + reach]) / count + angle[0], angle[1:], atol=2e-2)
    np.testing.assert_allclose(turns, base, atol=2e-2)


@pytest.mark.parametrize("number", [3, 8, 17, 30])
def test_legs_of_tubes_have_the_modes_of_their_energy_on_segments(number):
    """At every equilibrium that is found of robots whose tubes snap: up to nine unstable modes."""
    drawn = draw(number, 3, 3, 5.0, 8.0)
    found = mr.equilibria(drawn.robot, drawn.inputs, starts=64, solver=mr.Shooting(max_integrations=6000))
    assert len(found.status) > 1
    for own in (found[k] for k in range(len(found.status))):
        energy = on_segments(drawn, own, 24)
        place = energy.position
        assert energy.settle() < 1e-6  # Newton's method: far below what segments err by
        np.testing.assert_allclose(energy.position, place, rtol=0, atol=0.02)  # of segments: some (1/24)^2 of bent legs
        assert (energy.modes() < 0).sum() == own.index


def circle(degrees, radius):
    """Poses on a circle, upright."""
    poses = np.tile(np.eye(4), (len(degrees), 1, 1))
    poses[:, :2, 3] = radius * np.stack([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))], axis=-1)
    return poses


def test_a_triangulated_platform_on_strips_snaps_to_a_minimum():
    """Clamped at both ends: some modes vanish nearly together, and the platform falls and turns over."""
    length, stiffness = 0.25, np.array([0.1333, 0.0333, 0.0513])
    base = circle([-10, 10, 110, 130, 230, 250], 0.08)
    platform = circle([-50, 50, 70, 170, 190, 290], 0.05)
    strip = mr.Rod(length=length, bending_stiffness=tuple(stiffness[:2]), torsional_stiffness=stiffness[2])
    robot = mr.ParallelRods(legs=[strip] * 6, base=base, platform=platform)
    (critical,) = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1)))
    force = 1.05 * critical.load_factor * np.array([0, 0, -1])
    found = mr.solve(robot, robot.inputs(tip_force=force))
    assert found.status is mr.Status.SNAPPED
    assert found.stability is mr.Stability.STABLE
    base[:, :3, 3] /= length
    platform[:, :3, 3] /= length
    legs = [
        Leg(
            1.0,
            stiffness / stiffness[0],
            None,
            np.zeros(3),
            base[k],
            platform[k],
            "clamped",
            np.zeros(3),
            np.array(found.rod(k, nodes=COUNT + 1).rotation),
            np.zeros(COUNT + 1),
        )
        for k in range(6)
    ]
    place = np.array(found.tip_position) / length
    energy = LegEnergy(legs, place, np.array(found.tip_rotation), force * length**2 / stiffness[0])
    assert energy.settle() < 1e-6  # Newton's method: far below what segments err by
    np.testing.assert_allclose(energy.position, place, rtol=0, atol=0.02)  # of segments: some (1/12)^2
    assert energy.lowest() > 0


# beyond a fold as joints close, beyond one whose floor is long, and as loads are raised
@pytest.mark.parametrize(("seed", "number"), [(2024, 204), (31, 324), (0, 91), (901, 80)])
def test_legs_that_are_pushed_together_close_past_their_folds(seed, number):
    """They were ``INTEGRATION_LIMIT``: a step of a thousandth beyond a fold led far off, the way down from nearer bends within a
    hundredth of a radian, and rods that are pulled hard have no end near theirs by other steps. Where (4) took all its steps, or
    loads were raised, the floor was not tried."""
    drawn = draw(number, seed, 12, 5.0)
    found = mr.solve(drawn.robot, drawn.inputs, solver=mr.Shooting(fallback=False))  # not in pieces
    assert found.status is mr.Status.SNAPPED
    assert found.integrations < 12_000
    assert_a_minimum(drawn, found)


# pulled by 170 to 240 EI/L^2; the last one has a fold on its way, which is followed in pieces
@pytest.mark.parametrize(
    ("seed", "number", "status"),
    [(7, 16, "CONVERGED"), (901, 20, "CONVERGED"), (2024, 138, "CONVERGED"), (31, 209, "SNAPPED")],
)
def test_legs_that_are_pulled_hard_are_solved_in_pieces(seed, number, status):
    """They were ``INTEGRATION_LIMIT``: what is off at the base of such a leg grows a million times, steps were 1e-5 long."""
    drawn = draw(number, seed, 12, 5.0)
    found = mr.solve(drawn.robot, drawn.inputs)
    assert found.status.name == status
    assert found.stability is mr.Stability.STABLE
    assert found.residual < 1e-6  # a thousand times the default tolerance
    assert found.integrations < 12_000
    assert_a_minimum(drawn, found)


def assert_a_minimum(drawn, found):
    energy = on_segments(drawn, found, 24)
    before = energy.position
    assert energy.settle() < 1e-5
    np.testing.assert_allclose(energy.position, before, rtol=0, atol=0.02)  # of segments
    assert energy.lowest() > 0
