"""Held rods by segments: pulled harder than one integration bears, against networks of pieces, a closed form and collocation."""

import numpy as np
import pytest
from held_ways import BENT, GIVEN, HELD, PLACE
from meant import meant
from scipy.integrate import simpson, solve_bvp
from scipy.spatial.transform import Rotation

import multirod as mr
from multirod.results.segment_system import System
from multirod.segments import Cuts

EI, LENGTH = 0.02, 0.4
STIFF = {"bending_stiffness": 1.0, "torsional_stiffness": 0.8, "axial_stiffness": 1e4, "shear_stiffness": 5e3}


@pytest.mark.parametrize("name", HELD)
@meant()  # a base that turns back in its joint is turned for nothing
def test_matrices_of_segments_are_derivatives_of_their_gaps(name):
    """The Jacobian of all segments and its right-hand sides by inputs, by differences, on the way to the load."""
    robot = mr.HeldRod(BENT, end=PLACE, **HELD[name])
    names = ("rotation", "end_position", "end_rotation", "tip_force", "gravity")
    inputs = robot.inputs(**GIVEN)
    options = {"integrator": mr.RK4(40), "pose_sensitivities": True, **robot.input_directions(*names)}
    problem = robot.problem(inputs, enabled=names, **options)
    guess = problem.guess()
    problem.aim(*names)
    segments, level = problem.segments, np.array([0.7])
    random = np.random.default_rng(3)
    n, d = problem.unknown_count, segments.variation_size
    x = guess + 0.5 * random.normal(size=guess.shape)
    begin = segments.base_state(np.zeros(1, dtype=int), x)
    edges, steps = np.linspace(0.0, 0.4, 4), np.full(3, 10, dtype=np.int32)
    states = np.concatenate([begin] * 3)
    every = np.zeros(1, dtype=int)
    for _ in range(2):  # states to which the segments lead: there a gap varies as its two sides do
        cuts = Cuts(every, np.array([0, 3]), edges[:-1], edges[1:], states, x, steps)
        states = np.concatenate([begin, segments.propagate(cuts, level).end[:2]])
    cuts = Cuts(every, np.array([0, 3]), edges[:-1], edges[1:], states, x, steps)

    def gaps(step):
        own, rows = step[:n], step[n:].reshape(2, d)
        moved = segments.moved(np.zeros(2, dtype=int), states[1:], rows)
        here = Cuts(every, cuts.first, cuts.start, cuts.end, np.concatenate([begin, moved]), x + own, steps)
        found = segments.propagate(here, level)
        between = segments.difference(np.zeros(2, dtype=int), found.end[:2], moved)
        return np.concatenate([between.ravel(), found.residual[0]])

    found = segments.propagate(cuts, level)
    system, h = System(found, segments.unknown_places), 1e-6
    # what all segments share follows from the unknowns, at every breakpoint alike
    shared = np.r_[np.arange(d)[segments._force], np.arange(d)[segments._base_moment]]
    steps_of_all = np.eye(n + 2 * d)
    for k in range(2):
        steps_of_all[n + k * d + shared, :n] = system.first[shared]
    steps_of_all = np.delete(steps_of_all, np.r_[n + shared, n + d + shared], axis=1)
    columns = [(gaps(h * e) - gaps(-h * e)) / (2 * h) for e in steps_of_all.T]
    np.testing.assert_allclose(system.dense() @ steps_of_all, np.transpose(columns), atol=2e-7 * np.abs(system.dense()).max())
    level[:] = 1.0  # where derivatives by inputs are asked for
    for _ in range(2):
        found = segments.propagate(cuts, level)
        states = np.concatenate([begin, found.end[:2]])
        cuts = Cuts(every, cuts.first, cuts.start, cuts.end, states, x, steps)
    found = segments.propagate(cuts, level)
    slopes = np.concatenate([*found.transition[:-1, :, d:], found.residual_columns[0, :, d:]])
    sides = []
    for sign in (1, -1):
        for name_ in names:
            for k in range(np.size(GIVEN[name_]) if name_ in GIVEN else 3):
                value = np.atleast_1d(np.array(GIVEN[name_], float))
                value[k] += sign * h
                problem.write("inputs", problem.pack(robot.inputs(**GIVEN | {name_: value if len(value) > 1 else value[0]})))
                sides.append(gaps(np.zeros(n + 2 * d)))
    half = len(sides) // 2
    expected = (np.transpose(sides[:half]) - np.transpose(sides[half:])) / (2 * h)
    np.testing.assert_allclose(slopes, expected, atol=2e-7 * max(1, np.abs(slopes).max()))


@pytest.mark.parametrize("name", HELD)
@meant()  # a base that turns back in its joint is turned for nothing
def test_segments_lead_where_shooting_leads(name, monkeypatch):
    """What one integration bears too: shape, energy, reactions, modes and derivatives, known by segments alone."""
    robot = mr.HeldRod(BENT, end=PLACE, **HELD[name])
    inputs = robot.inputs(**GIVEN)
    expected = mr.solve(robot, inputs, solver=mr.Shooting(tolerance=1e-10))
    monkeypatch.setattr("multirod.solvers.multiple_shooting.POLISH", 0)
    found = mr.solve(robot, inputs, solver=mr.MultipleShooting(tolerance=1e-10))
    assert found.status is mr.Status.MULTIPLE_SHOOTING
    assert (found.stability, found.index) == (expected.stability, expected.index)
    # what two integrations, to 1e-8 each, leave
    for of in ("tip_position", "tip_rotation", "end_force", "end_moment", "energy", "potential", "stability_margin", "unknowns"):
        np.testing.assert_allclose(getattr(found, of), getattr(expected, of), rtol=1e-5, atol=1e-6, err_msg=of)
    for of in ("position", "rotation", "curvature", "moment", "force"):
        np.testing.assert_allclose(getattr(found.rod(0), of), getattr(expected.rod(0), of), atol=1e-6, err_msg=of)
    for of in ("end_rotation", "end_position", "tip_force", "rotation", "gravity"):
        np.testing.assert_allclose(found.jacobian(of), expected.jacobian(of), atol=1e-5, err_msg=of)


@pytest.mark.parametrize("place", [1.02, 1.05])  # beyond the first, steps are halved where the axial stiffness pulls
@pytest.mark.parametrize("solver", [mr.MultipleShooting(), mr.Shooting()], ids=repr)
def test_a_network_of_pieces_agrees(solver, place):
    end = np.eye(4)
    end[:3, :3], end[2, 3] = Rotation.from_rotvec((1.5, 0, 0)).as_matrix(), place
    whole = mr.HeldRod(mr.Rod(length=1, **STIFF), end=end)
    found = mr.solve(whole, whole.inputs(), solver=solver).raise_if_failed()
    pieces = [f"piece {k}" for k in range(4)]
    between = [mr.Body(f"after {name}") for name in pieces[:-1]]
    joints = [mr.Joint(name, "base", to=to) for name, to in zip(pieces, [mr.ground, *between], strict=True)]
    joints += [mr.Joint(name, "tip", to=body) for name, body in zip(pieces, between, strict=False)]
    joints += [mr.Joint(pieces[-1], "tip", to=mr.ground, pose=end)]
    cut = mr.Network(rods=dict.fromkeys(pieces, mr.Rod(length=0.25, **STIFF)), bodies=between, joints=joints)
    expected = mr.solve(cut, cut.inputs()).raise_if_failed()
    assert found.stability is expected.stability is mr.Stability.STABLE
    # what integrations to 1e-8 leave
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-7)
    last = expected.rod(pieces[-1])
    np.testing.assert_allclose(found.end_force, last.rotation[-1] @ last.force[-1], rtol=1e-7, atol=1e-5)
    shape = found.rod(0, nodes=33)
    assert np.isfinite(shape.position).all()
    middle = np.concatenate([expected.rod(name, nodes=9).position[k > 0 :] for k, name in enumerate(pieces)])
    np.testing.assert_allclose(shape.position, middle, atol=1e-6)


@pytest.mark.parametrize("pull", [400.0, 1e4])
def test_a_string_with_stiff_ends_sags_as_its_closed_form_says(pull):
    """Clamped at both ends, its end on a slide pulled by F, under a load w across that sags it little: y'''' - k^2 y'' = w/EI,
    with layers of width 1/k at its ends; what is neglected is of the square of the slope."""
    rod = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8)
    robot, load = mr.HeldRod(rod, slide=(0, 0, 1)), 1e-3 * pull
    inputs = robot.inputs(tip_force=(0, 0, pull), distributed_force=(load, 0, 0))
    found = mr.solve(robot, inputs, solver=mr.MultipleShooting()).raise_if_failed()
    s, k = np.linspace(0, 1, 51), np.sqrt(pull)
    ends = np.exp(-k * s) + np.exp(-k * (1 - s))
    sag = load / pull * (s * (1 - s) / 2 - (1 + np.exp(-k) - ends) / (2 * k * (1 - np.exp(-k))))
    np.testing.assert_allclose(found.rod(0, nodes=51).position[:, 0], sag, atol=1e-6 * load / pull)
    assert found.stability is mr.Stability.STABLE
    np.testing.assert_allclose(found.end_force[0], -load / 2, rtol=1e-6)
    # a finite difference of solutions: 1e-6 of the load at a step of a thousandth
    step = np.array([[0.0, 0, 1e-3], [0, 0, -1e-3]]) * pull + (0, 0, pull)
    sides = mr.solve(robot, robot.inputs(tip_force=step, distributed_force=(load, 0, 0)), solver=mr.MultipleShooting())
    slope = (sides.tip_position[0] - sides.tip_position[1]) / (2e-3 * pull)
    np.testing.assert_allclose(found.jacobian("tip_force")[:3, 2], slope, rtol=1e-4, atol=1e-12)


def test_collocation_agrees():
    """A planar rod that stretches and shears, its end turned and pulled out: solve_bvp of p, the angle, moment and force."""
    pulled, turn = 0.05, 1.0
    end = np.eye(4)
    end[:3, :3], end[2, 3] = Rotation.from_rotvec((0, turn, 0)).as_matrix(), 1 + pulled
    robot = mr.HeldRod(mr.Rod(length=1, **STIFF), end=end)
    found = mr.solve(robot, robot.inputs(), solver=mr.MultipleShooting()).raise_if_failed()

    def slope(s, y, force):
        _, _, angle, moment = y
        sine, cosine = np.sin(angle), np.cos(angle)
        along, across = force[0] * sine + force[1] * cosine, force[0] * cosine - force[1] * sine
        stretch, shear = 1 + along / 1e4, across / 5e3
        dx, dz = stretch * sine + shear * cosine, stretch * cosine - shear * sine
        return np.stack([dx, dz, moment, force[0] * dz * -1 + force[1] * dx])

    def gap(a, b, force):
        return np.array([a[0], a[1], a[2], b[0], b[1] - 1 - pulled, b[2] - turn])

    shape = found.rod(0, nodes=201)
    angle = np.arctan2(shape.rotation[:, 0, 2], shape.rotation[:, 2, 2])
    start = np.stack([shape.position[:, 0], shape.position[:, 2], angle, shape.moment[:, 1]])
    # from a state that is clearly off, so that it finds what it finds by itself
    solution = solve_bvp(slope, gap, shape.arclength, start * 1.02, p=found.end_force[[0, 2]] * 0.95, tol=1e-9, max_nodes=20000)
    assert solution.status == 0
    np.testing.assert_allclose(found.end_force[[0, 2]], solution.p, rtol=1e-6)
    np.testing.assert_allclose(shape.moment[:, 1], solution.sol(shape.arclength)[3], atol=1e-5 * np.abs(shape.moment).max())


@pytest.mark.parametrize(("joint", "thrust", "times"), [("clamped", 4 * np.pi**2, 5), ("spherical", 4.493409457909064**2, 12)])
def test_what_a_thrust_turns_over_is_followed_to_a_hard_pull(joint, thrust, times):
    """Round rods that buckle, snap to the other side of their base and are pulled there, by 197 and 242 ``EI/L^2``.

    They were `BRANCH_END`, as an integration from the base by other steps led elsewhere from the same unknowns.
    """
    axial = 1e4 * EI / LENGTH**2
    rod = mr.Rod(length=LENGTH, bending_stiffness=EI, torsional_stiffness=0.75 * EI, axial_stiffness=axial)
    robot = mr.HeldRod(rod, slide=(0, 0, 1), **{"joint": joint} if joint != "clamped" else {})
    critical = axial / 2 * (1 - np.sqrt(1 - 4 * thrust * EI / LENGTH**2 / axial))  # (26) of docs/held.md, rigid in shear
    solution = mr.solve(robot, robot.inputs(tip_force=(0, 0, -times * thrust * EI / LENGTH**2)))
    assert solution.status is mr.Status.SNAPPED
    assert solution.stability is mr.Stability.STABLE
    assert solution.integrations < 8000  # some of them with clamps, each of which is six
    assert [event.status for event in solution.events] == [mr.Status.BIFURCATED, mr.Status.SNAPPED]
    if joint == "clamped":
        assert solution.events[0].load_factor == pytest.approx(critical / (times * thrust * EI / LENGTH**2), rel=2e-5)
    # an equilibrium: balances, what is conserved, and that the frames lead to where the rod is
    shape = solution.rod(0, nodes=401)
    n, m = (np.einsum("kij,kj->ki", shape.rotation, own) for own in (shape.force, shape.moment))
    unit = EI / LENGTH**2
    np.testing.assert_allclose(n - n[0], 0, atol=1e-6 * unit)
    assert n[0, 2] == pytest.approx(-times * thrust * unit, rel=1e-9)
    np.testing.assert_allclose(m - m[0] + np.cross(shape.position - shape.position[0], n[0]), 0, atol=1e-6 * EI / LENGTH)
    along = shape.force[:, 2]
    conserved = (shape.moment**2 / [EI, EI, 0.75 * EI]).sum(axis=1) / 2 + along**2 / axial / 2 + along
    np.testing.assert_allclose(conserved, conserved[0], atol=1e-6 * unit)
    tangent = shape.rotation[:, :, 2] * (1 + along / axial)[:, None]
    np.testing.assert_allclose(simpson(tangent, x=shape.arclength, axis=0), shape.position[-1], atol=1e-6 * LENGTH)
    np.testing.assert_allclose(solution.tip_position[:2], 0, atol=1e-8 * LENGTH)
    if joint == "clamped":
        np.testing.assert_allclose(solution.tip_rotation[:, 2], (0, 0, 1), atol=1e-8)
    else:
        np.testing.assert_allclose(m[-1, :2], 0, atol=1e-8 * EI / LENGTH)
    assert solution.tip_position[2] < -0.5 * LENGTH  # it has turned over
