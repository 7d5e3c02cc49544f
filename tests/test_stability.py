"""Stability by the index: closed-form critical loads, stored flags, and the Hessian of an independent energy."""

import numpy as np
import pytest
from discrete_energy import DiscreteEnergy, Tube

import multirod as mr

STABLE, UNSTABLE, UNKNOWN, FOLD = mr.Stability.STABLE, mr.Stability.UNSTABLE, mr.Stability.UNKNOWN, mr.Stability.FOLD
NEAR = np.array([0.999, 1.001])  # of a critical load


def column(**values):
    return mr.SingleRod(mr.Rod(**({"length": 1.0, "bending_stiffness": 1.0, "torsional_stiffness": 0.8} | values)))


def straight(robot, **loads):
    """The straight equilibrium, at each of several loads."""
    return mr.solve(robot, robot.inputs(**loads), guess=(0.0, 0.0, 0.0)).raise_if_failed()


def along(vector, sizes):
    return np.multiply.outer(sizes, vector)


def test_unloaded_straight_rods_and_tubes_are_stable():
    tube = {"bending_stiffness": 0.01, "torsional_stiffness": 0.008}
    assert straight(column()).stability is STABLE
    assert straight(column(shear_stiffness=50.0, axial_stiffness=80.0)).stability is STABLE
    for count in (1, 2, 3):
        robot = mr.ConcentricTubes([mr.Rod(length=0.3 - 0.1 * k, **tube) for k in range(count)])
        solution = mr.solve(robot, robot.inputs(translation=[-0.05 + 0.02 * k for k in range(count)]))
        assert (solution.index, solution.stability) == (0, STABLE)


def test_euler_column():
    """Clamped-free: pi^2 EI/(4 L^2), for each axis; the next mode at nine times that."""
    critical = np.pi**2 / 4
    loads = np.concatenate([critical * NEAR, 1.3 * critical * NEAR, 9 * critical * NEAR])
    assert straight(column(bending_stiffness=(1.0, 1.3)), tip_force=along((0, 0, -1), loads)).index.tolist() == [0, 1, 1, 2, 2, 3]


def test_modes_that_cross_together_are_both_counted():
    loads = np.pi**2 / 4 * np.concatenate([NEAR, 9 * NEAR, 25 * NEAR])
    assert straight(column(), tip_force=along((0, 0, -1), loads)).index.tolist() == [0, 2, 2, 4, 4, 6]


def test_nodes_are_as_close_as_the_load_asks_for():
    """45 modes about each axis have (k - 1/2)^2 pi^2 < 2e4: more than there are nodes at first."""
    assert straight(column(), tip_force=(0, 0, -2e4)).index == 90


def test_heavy_column():
    """Greenhill: w L^3/EI = 7.8373, about both axes."""
    solution = straight(column(linear_density=1.0), gravity=along((0, 0, -1), 7.8373 * NEAR))
    assert solution.index.tolist() == [0, 2]
    assert solution.stability.tolist() == [STABLE, UNSTABLE]


def test_shear_and_extension_lower_the_critical_load():
    """Linearised about the compressed column, EI phi'' + P (1 + P/GA - P/EA) phi = 0 (Haringx)."""
    GA, EA = 40.0, 60.0
    roots = np.roots([1 / GA - 1 / EA, 1.0, -(np.pi**2) / 4])
    critical = roots[roots > 0].min()
    robot = column(shear_stiffness=GA, axial_stiffness=EA)
    assert straight(robot, tip_force=along((0, 0, -1), critical * NEAR)).index.tolist() == [0, 2]


def test_lateral_buckling_of_a_narrow_cantilever():
    """Prandtl: 4.0126 sqrt(EI GJ)/L^2; the depth is 1e5 times stiffer, so that the deflection before shifts it by 1e-5."""
    GJ = 0.6
    robot = column(bending_stiffness=(1e5, 1.0), torsional_stiffness=GJ)
    solution = mr.solve(robot, robot.inputs(tip_force=along((0, 1, 0), 4.0126 * np.sqrt(GJ) * NEAR)), guess=(0, 0, 0))
    assert solution.raise_if_failed().index.tolist() == [0, 1]


EI, GJ, L = (0.035, 0.012), (0.027, 0.009), 0.15


def two_tubes(turns, *, behind=0.0, longer=(0.0, 0.0)):
    """Two tubes curved alike over a common length L, with ``turns`` = L sqrt(c); one may go on straight beyond it."""
    c = (turns / L) ** 2
    kappa = np.sqrt(c * (EI[0] + EI[1]) / (EI[0] * EI[1]) / (1 / GJ[0] + 1 / GJ[1]))
    tubes = []
    for k in range(2):
        pieces = [(behind, (0, 0, 0)), (L, (kappa, 0, 0)), (longer[k], (0, 0, 0))]
        pieces = [piece for piece in pieces if piece[0] > 0]
        length = sum(piece[0] for piece in pieces)
        tubes.append(mr.Rod(length=length, bending_stiffness=EI[k], torsional_stiffness=GJ[k], precurvature=pieces))
    return mr.ConcentricTubes(tubes)


def untwisted(turns, angle, behind=0.0, **shape):
    robot = two_tubes(turns, behind=behind, **shape)
    return mr.solve(robot, robot.inputs(rotation=(0.0, angle), translation=-behind), guess=np.zeros(4)).raise_if_failed()


@pytest.mark.parametrize("turns", [0.5, 1.5, 3.0, 6.0])
def test_aligned_tubes_are_stable_however_curved(turns):
    assert untwisted(turns, 0.0).stability is STABLE


@pytest.mark.parametrize("longer", [(0.0, 0.0), (0.06, 0.0), (0.0, 0.06)], ids=["together", "outer ends", "inner ends"])
@pytest.mark.parametrize("mode", [1, 3])
def test_opposite_tubes_lose_stability_at_a_quarter_turn(longer, mode):
    """theta'' = c sin(theta) with theta' = 0 where the shorter ends: L sqrt(c) = pi/2, then 3 pi/2."""
    found = [untwisted(mode * np.pi / 2 * factor, np.pi, longer=longer).index for factor in NEAR]
    assert found == [(mode - 1) // 2, (mode + 1) // 2]


@pytest.mark.parametrize("longer", [(0.06, 0.0), (0.0, 0.06)], ids=["outer ends", "inner ends"])
def test_every_mode_of_opposite_tubes_is_counted(longer):
    """As many as there are (k - 1/2) pi below L sqrt(c), whichever pivot shows them."""
    for turns in np.linspace(0.4, 9.4, 31):
        assert untwisted(turns, np.pi, longer=longer).index == int(turns / np.pi + 0.5), turns


def test_compliance_behind_the_plate_destabilises():
    """theta(0) = pi + b theta'(0) behind the plate: tan(L sqrt(c)) = 1/(b sqrt(c)) on the opposite branch."""
    behind, turns = 0.06, 1.0
    for _ in range(100):
        turns = np.arctan(L / (behind * turns))
    assert turns < 1.2
    assert [untwisted(turns * factor, np.pi, behind).index for factor in NEAR] == [0, 1]


def test_a_fold_is_told_from_either_side():
    """At its critical load the softest mode has no stiffness: 1e-9 away it is neutral, 1e-4 away it is not."""
    critical = np.pi**2 / 4 * np.array([1 - 1e-4, 1 - 1e-9, 1 + 1e-9, 1 + 1e-4])
    solution = straight(column(bending_stiffness=(1.0, 1.3)), tip_force=along((0, 0, -1), critical))
    assert solution.stability.tolist() == [STABLE, FOLD, FOLD, UNSTABLE]


def test_loads_without_a_potential_are_not_judged(wire):
    robot = mr.SingleRod(wire)
    for load in ("tip_moment", "distributed_moment", "follower_force", "follower_moment"):
        solution = mr.solve(robot, robot.inputs(**{load: (0.01, 0.02, 0.0)})).raise_if_failed()
        assert solution.stability is UNKNOWN
        assert solution.index == -1
        assert np.isnan(solution.potential)


def test_what_failed_or_is_rigid_in_torsion_is_not_judged(wire):
    robot = column(torsional_stiffness=np.inf)
    assert straight(robot).stability is UNKNOWN
    robot = mr.SingleRod(wire)
    failed = mr.solve(robot, robot.inputs(tip_force=[(0, 0, 1), (0, 0, -1e3)]))
    assert failed.stability.tolist()[0] == STABLE
    assert (failed.status[1] != mr.Status.CONVERGED) == (failed.stability[1] == UNKNOWN)


def test_single_rod_cases(reference_cases, make_pose):
    """All stored minima of the energy are stable."""
    from test_cases import TIGHT, robot_and_inputs

    count = 0
    for case in reference_cases("single_rod"):
        if not case["verification"].get("stable_energy_minimum"):
            continue
        robot, inputs = robot_and_inputs(case, make_pose)
        guess = None
        if case["difficulty"] == "multiple solutions":
            moment = np.array(case["inputs"]["base"]["R0"]).T @ case["expected"]["base_moment"]["value"]
            stored = case["inputs"]["rods"][0]
            guess = stored["u_star"] + moment / stored["K"]
        solution = mr.solve(robot, inputs, guess=guess, solver=TIGHT)
        if solution.status.failed:
            assert case["difficulty"] != "standard"
            continue
        assert solution.stability is STABLE, case["id"]
        count += 1
    assert count >= 10


# ---- an independent energy ----


def tubes_as_robot(tubes):
    rods = []
    for t in tubes:
        curved = (t.length - t.straight, t.u_star)
        pieces = [(t.straight, (0, 0, 0)), curved] if t.straight else [curved]
        rods.append(mr.Rod(length=t.length, bending_stiffness=t.EI, torsional_stiffness=t.GJ, precurvature=pieces))
    return mr.SingleRod(rods[0]) if len(rods) == 1 else mr.ConcentricTubes(rods)


def sampled(energy, solution):
    """A solution as unknowns of the discrete energy: one tube, or two."""
    tubes, shape = energy.tubes, solution.rod(0, nodes=401)
    u = np.stack([np.interp(energy.middle, shape.arclength, shape.curvature[:, k]) for k in range(3)], axis=1)
    if len(tubes) == 1:
        return u.ravel()
    other = solution.rod(1, nodes=401)
    torque = np.interp(energy.middle, other.arclength, other.moment[:, 2])
    rate = (torque / tubes[1].GJ - u[:, 2])[energy.places[0]]
    base = [shape.moment[0, 2], other.moment[0, 2]]
    turns = [base[k] * tubes[k].behind / tubes[k].GJ for k in energy.turning]
    return np.concatenate([u.ravel(), rate, turns])


def compare_with_hessian(tubes, force, segment_count, inputs):
    robot = tubes_as_robot(tubes)
    found = mr.equilibria(robot, robot.inputs(tip_force=force, **inputs))
    energy = DiscreteEnergy(tubes, force, segment_count)
    for k, index in enumerate(found.index):
        one = mr.solve(robot, robot.inputs(tip_force=force, **inputs), guess=found.unknowns[k])
        q, negative = energy.stationary(sampled(energy, one))
        # strains constant by segment are off by h u'/2: their energy lacks a part (h/L)^2 of order one
        size = max(abs(found.potential).max(), tubes[0].EI / tubes[0].length)
        np.testing.assert_allclose(energy(q[None])[0], found.potential[k], rtol=0, atol=5 * size / segment_count**2)
        assert negative == index
    return found.index.tolist()


def test_the_hessian_of_a_rod_agrees():
    """A precurved rod pushed hard."""
    rod = Tube(length=0.5, straight=0.0, EI=0.02, GJ=0.015, u_star=(2.0, 1.0, 0.0))
    index = compare_with_hessian([rod], np.array([0.02, -0.05, -1.2]), 20, {})
    assert len(index) >= 3
    assert {0, 1} <= set(index)


@pytest.mark.parametrize("force", [(0.0, 0.0, 0.0), (0.1, -0.2, -0.3)], ids=["unloaded", "loaded"])
def test_the_hessian_of_two_tubes_agrees(force):
    """Strongly curved, of unequal ends, and twisting behind the plate."""
    angles, behind = (0.2, 3.1), (0.05, 0.03)
    inner = Tube(length=0.22, straight=0.06, EI=0.012, GJ=0.009, u_star=(16.0, 2.0, 0.0), angle=angles[0], behind=behind[0])
    outer = Tube(length=0.15, straight=0.04, EI=0.035, GJ=0.027, u_star=(10.0, 0.0, 0.0), angle=angles[1], behind=behind[1])
    values = {"rotation": angles, "translation": [-b for b in behind]}
    index = compare_with_hessian([inner, outer], np.array(force), 16, values)
    assert len(index) >= 3
    assert {0, 1} <= set(index)
