"""Networks of all that a ``Network`` may say, drawn by lot, against chains of rigid segments (``graph_energy``)."""

import numpy as np
import pytest
from damped_flow import flowed
from random_graphs import draw, state_of, violation

import multirod as mr

EXACT = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(50))
FEW = {"most_rods": 4, "most_bodies": 2}
CLOSE = 1e-6  # steps of differences, in what counts as one


def place(x=0.0, y=0.0, z=0.0):
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


WITNESSED = (1, 3, 10, 36, 1051, 1016, 1018, 1037, 1048, 2006, 2011, 2015, 3006, 3009, 3010, 3012)  # more kinds from 1000 on


@pytest.mark.parametrize("seed", WITNESSED)
def test_the_witness_is_the_slope_of_its_energy(seed):
    """Gradients of all kinds of joints and rods against differences of the energy alone, and their derivatives against theirs."""
    drawn = draw(seed, **FEW)
    graph, rng = drawn.rods(2), np.random.default_rng(seed)
    aside = 0.1 * graph.scale * rng.standard_normal(graph.size)
    for part in graph.parts:
        aside[graph.at(part.holes)] *= 0.1
    state = graph.moved(graph.straight(drawn.places), aside)
    g, H = graph.system(state)
    for _ in range(6):
        way = rng.standard_normal(graph.size) * graph.scale
        ahead, behind = (graph.moved(state, sense * CLOSE * way) for sense in (1, -1))
        moments = sum(  # have no potential
            way[graph.place_of_turn(turn)] @ (state[0][turn].T @ body["moment"] + body["follower"][1])
            + way[graph.at(at)] @ (state[0][turn] @ body["follower"][0])
            for turn, at, body in zip(graph.body_turn, graph.body_at, graph.bodies, strict=True)
        ) + sum(
            share * graph.length_of(piece, state[1]) * way[graph.place_of_turn(node[0])] @ (state[0][node[0]].T @ span["moment"])
            for part in graph.parts
            for segments, *_ in part.runs
            for node, piece, share, span in segments
        )
        moments -= sum(part.work_of(state, way) for part in graph.parts)
        slope = (graph.system(ahead, energy=True) - graph.system(behind, energy=True)) / (2 * CLOSE) - moments
        assert slope == pytest.approx(g @ way, rel=0, abs=1e-7 * graph.unit * np.sqrt(graph.size))
        curve = way @ (graph.system(ahead)[0] - graph.system(behind)[0]) / (2 * CLOSE)
        assert curve == pytest.approx(way @ H @ way, rel=1e-5)


@pytest.mark.parametrize("seed", [1, 3, 10])
def test_drawn_networks_are_where_their_energy_has_them(seed):
    """Slides, springs, motors, tubes, rods that stretch, a hole; ``benchmarks/random_networks.py --all`` has more."""
    hold_against_their_energy(seed)


@pytest.mark.parametrize("seed", [1001, 1013, 1018, 1023])
def test_drawn_networks_with_fields_are_where_their_energy_has_them(seed):
    """A medium, a push rod, chambers beside a magnet, a magnet in a hole."""
    hold_against_their_energy(seed)


@pytest.mark.parametrize("seed", [2015, 2041])
def test_drawn_networks_whose_lines_end_before_the_tip_are_where_their_energy_has_them(seed):
    """Three tendons of one rod, and one."""
    hold_against_their_energy(seed)


@pytest.mark.parametrize("seed", [3022, 3030])
def test_drawn_networks_whose_rods_have_loads_of_their_own_are_where_their_energy_has_them(seed):
    """Springs that stiffen, around one rod each."""
    hold_against_their_energy(seed)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")  # sections are drawn by lot
def test_what_snaps_beside_springs_of_its_own_comes_to_rest():
    """Where the branch of nine rods ends, one of them on springs and a keel: nothing was told of its stability."""
    drawn = draw(4015)
    solution = mr.solve(drawn.robot, drawn.inputs)
    assert (solution.status, solution.stability) == (mr.Status.SNAPPED, mr.Stability.STABLE)
    assert violation(drawn, solution) < 1e-6
    graph, state = state_of(drawn, solution, 12)
    state, index, _ = graph.settled(state)
    assert index == 0
    own = np.array([solution.body_position(name) for name in drawn.bodies])
    assert np.abs(graph.positions(state) - own).max() < 0.01 * graph.length  # the error of 12 segments


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")  # sections are drawn by lot
@pytest.mark.parametrize(("seed", "part"), [(852, 0.25), (848, 0.25)])
def test_what_has_no_potential_is_pulled_out_of_a_hole_where_damped_dynamics_do_so(seed, part):
    """From where a part of the loads holds it: four segments a rod go to where a piece in a hole has no length."""
    less, drawn = draw(seed, load=part), draw(seed)
    _, state = state_of(less, mr.solve(less.robot, less.inputs).raise_if_failed(), 4)
    state, rests = flowed(graph := drawn.rods(4), state)
    assert not rests
    assert min(graph.length_of(piece, state[1]) for piece in graph.piece) < 0.02 * graph.length
    assert mr.solve(drawn.robot, drawn.inputs).status is mr.Status.OUT_OF_HOLE


def hold_against_their_energy(seed):
    drawn = draw(seed, **FEW)
    solution = mr.solve(drawn.robot, drawn.inputs).raise_if_failed()
    assert violation(drawn, solution) < 1e-6  # of lengths and forces: what the default integrator promises
    own = np.array([solution.body_position(name) for name in drawn.bodies])
    graph, state = state_of(drawn, solution, 6, aside=0.005)
    errors = []
    for _ in range(2):
        state, index, _ = graph.settled(state)
        assert index == 0
        errors.append(graph.positions(state) - own)
        graph, state = graph.refined(state)
    # of the second order: half the segments' length leaves a quarter of the error, and extrapolation little of that
    assert np.abs(errors[1]).max() < 0.01 * graph.length
    assert np.abs(4 * errors[1] - errors[0]).max() / 3 < 0.2 * np.abs(errors[1]).max()
    assert solution.stability is mr.Stability.STABLE


def test_tubes_beside_a_rod_in_a_hole_are_as_they_are_alone():
    """The second tube was turned by what the first is pushed, where any rod of the network went through a hole."""
    inner, outer = (
        mr.Rod(length=length, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(bend, 0, 0))
        for length, bend in ((0.3, 4.0), (0.2, 6.0))
    )
    arm = {"arm": mr.ConcentricTubes([inner, outer])}
    wire = {"wire": mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015)}
    stand = [mr.Joint("arm", "base", to=mr.ground)]
    through = [
        mr.Joint("wire", "base", to=mr.ground, pose=place(0.1)),
        mr.Joint("wire", "along", at=0.1, to=mr.ground, pose=place(0.1, 0, 0.1), kind="spherical"),
    ]
    alone = mr.Network(rods=arm, joints=stand)
    beside = mr.Network(rods=wire | arm, joints=[*stand, *through], end_effector="arm")
    given = {"rotation": {"arm": (0.3, 1.4)}, "translation": {"arm": (-0.05, -0.03)}, "force": {"arm": (0.05, 0.1, 0.0)}}
    expected = mr.solve(alone, alone.inputs(**given), solver=EXACT).raise_if_failed()
    found = mr.solve(beside, beside.inputs(**given), solver=EXACT).raise_if_failed()
    # the force at the base is unknown beside another rod: other rounding, and steps that end where the tubes do
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.base_torque[1:], expected.base_torque, rtol=0, atol=1e-7)


def test_what_drives_lines_is_told_by_their_rods_beside_rods_in_pieces():
    """Names were counted by pieces: of a rod behind one that goes through a hole, they were those of the next."""
    lined = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, lines=[mr.Tendon(offset=(0.005, 0))])
    rods = {"wire": mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015), "one": lined, "two": lined}
    joints = [mr.Joint(name, "base", to=mr.ground, pose=place(0.1 * k)) for k, name in enumerate(rods)]
    ring = mr.Joint("wire", "along", at=0.1, to=mr.ground, pose=place(z=0.1), kind="spherical")
    for options in ({"joints": [*joints, ring]}, {"joints": joints, "segments": {"wire": 3}}):
        robot = mr.Network(rods=rods, end_effector="two", **options)
        np.testing.assert_array_equal(robot.inputs(tension={"one": 1.0, "two": 2.0}).tension, [1.0, 2.0])


@pytest.mark.parametrize("nodes", [4, 5, 12])
def test_rods_through_holes_and_in_segments_are_told_at_any_number_of_nodes(nodes):
    """Two pieces of either, which have other numbers of nodes: a ``KeyError`` where the number is odd."""
    rod = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015)
    joints = [mr.Joint(name, "base", to=mr.ground, pose=place(x)) for name, x in (("wire", 0.0), ("cable", 0.1))]
    joints.append(mr.Joint("wire", "along", at=0.1, to=mr.ground, pose=place(z=0.1), kind="spherical"))
    robot = mr.Network(rods={"wire": rod, "cable": rod}, joints=joints, segments={"cable": 2})
    solution = mr.solve(robot, robot.inputs(force={"wire": (0.1, 0, 0), "cable": (0.1, 0, 0)}), solver=EXACT).raise_if_failed()
    for name in ("wire", "cable"):
        shape, fine = solution.rod(name, nodes=nodes), solution.rod(name, nodes=61)
        assert len(shape.arclength) == nodes
        np.testing.assert_allclose(shape.position[[0, -1]], fine.position[[0, -1]], rtol=0, atol=1e-9)
