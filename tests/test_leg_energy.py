"""The witnesses of branches agree with each other: robots on segments that creep, and the energy of tubes by strains."""

import numpy as np
import pytest
from discrete_energy import DiscreteEnergy, Tube
from leg_energy import Leg, LegEnergy, SleevedLeg
from relaxation import CreepingRods, rotation

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


@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_a_sleeved_leg_is_a_pair_of_tubes(turn):
    """That of ``DiscreteEnergy``, whose tangents are not averaged over segments: 12 of them differ by a hundredth of the tip."""
    stiffness, reach, curved, sleeve = np.array([1, 1, 0.77]), 8, np.array([1.2, 0, 0]), np.array([2.0, 0, 0])
    rest = np.where(np.arange(COUNT)[:, None] < 3, 0.0, curved)
    leg = SleevedLeg(
        1.0,
        stiffness,
        None,
        rest,
        np.eye(4),
        np.eye(4),
        "clamped",
        np.zeros(3),
        frames(rest / COUNT),
        np.zeros(COUNT + 1),
        1.5 * stiffness,
        np.tile(sleeve, (reach, 1)),
        np.full(reach + 1, turn),
    )
    force = np.array([0.3, 0.5, -0.2])
    energy = clamped(leg, force)
    assert energy.creep()
    assert energy.lowest() > 0
    pair = [
        Tube(1.0, 3 / COUNT, 1.0, 0.77, tuple(curved)),
        Tube(reach / COUNT, 0.0, 1.5, 1.5 * 0.77, tuple(sleeve), angle=turn),
    ]
    other = DiscreteEnergy(pair, force, COUNT)
    u = np.concatenate([leg.curved(np.zeros((COUNT, 6))).ravel(), np.diff(leg.angle) * COUNT])
    assert len(u) == other.size
    found, negative = other.stationary(u)
    assert negative == 0
    np.testing.assert_allclose(
        other.tip(found[None, : 3 * COUNT].reshape(1, COUNT, 3), np.zeros(1))[0], energy.position, atol=1e-2
    )
    np.testing.assert_allclose(np.cumsum(found[3 * COUNT :]) / COUNT + turn, leg.angle[1:], atol=2e-2)
