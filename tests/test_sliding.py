"""Rods that slide through holes of bodies: against differences, energies, and what a frictionless sleeve pushes with."""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize
from test_check_assembly import check_assembly, example
from test_network import BENT, EXACT, RK4, hold_gamma_against_differences, pose

import multirod as mr

PIECE = mr.Rod(length=0.1, bending_stiffness=0.2, torsional_stiffness=0.15, linear_density=0.02)
STRAIGHT = mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.15)
KINDS = ("prismatic", "cylindrical", "spherical")
GIVEN = {
    "rotation": {"rod": 0.3, "two": 0.1},
    "translation": {"rod": 0.01, "one": 0.005},
    "force": {"b": (0.3, 0.2, -0.2), "rod": (0.1, 0.05, -0.1)},
    "gravity": (0, 1, -9.81),
    "distributed_force": (0.1, 0.05, 0.2),
}


def threaded(kinds=KINDS, base=None):
    """A rod beside a chain of three, through a hole in each of its bodies; its tip is free."""
    bodies = [mr.Body(name, mass=0.01) for name in "abc"]
    joints = [
        mr.Joint("rod", "base", to=mr.ground, pose=pose(position=(0.03, 0, 0)), kind="revolute", axis=(1, 0, 0), stiffness=0.3)
    ]
    for k, (name, body, kind) in enumerate(zip(("one", "two", "three"), bodies, kinds, strict=True)):
        joints += [mr.Joint(name, "base", to=bodies[k - 1] if k else mr.ground), mr.Joint(name, "tip", to=body)]
        hole = pose((0.1 * k, 0, 0), (0.03, 0.01 * k, 0))
        joints.append(mr.Joint("rod", "along", at=0.1 * (k + 1), to=body, pose=hole, kind=kind))
    rods = dict.fromkeys(("one", "two", "three"), PIECE) | {"rod": BENT}
    return mr.Network(rods=rods, bodies=bodies, joints=joints, end_effector="rod", base=base)


def through(kind, tip=None, at=0.15, place=None, rod=STRAIGHT):
    """One rod from the ground through a hole of the ground."""
    joints = [
        mr.Joint("rod", "base", to=mr.ground),
        mr.Joint("rod", "along", at=at, to=mr.ground, pose=pose(position=(0, 0, at)) if place is None else place, kind=kind),
    ]
    if tip is not None:
        joints.append(mr.Joint("rod", "tip", to=mr.ground, pose=tip))
    return mr.Network(rods={"rod": rod}, joints=joints)


@pytest.mark.parametrize("level", [1.0, 0.4])
def test_gamma_by_differences_of_the_sixth_order(difference, level):
    """Off the equilibrium, and on the way there, by all unknowns: those of holes among them."""
    hold_gamma_against_differences(threaded(), GIVEN, level, difference)


def test_derivatives():
    """``check_assembly`` holds columns and poses by all inputs against differences, and instances alone against a batch."""
    robot = threaded()
    vary = ("rotation", "translation", "force", "gravity", "distributed_force")
    check_assembly(robot, robot.inputs(**GIVEN), tip_rod=3, vary=vary, solvers=("shooting",))


@pytest.mark.parametrize("kind", KINDS)
def test_the_second_variation_is_symmetric(kind):
    """Which it is not unless what slides is the derivative of the energy by where the hole is; with what acts along the rod."""
    robot = threaded((kind,) * 3)
    solution = mr.solve(robot, robot.inputs(**GIVEN), solver=EXACT)
    assert solution.stability is mr.Stability.STABLE
    # what RK4(50) leaves of sensitivities and their own derivatives; without the load in (23) it is 1e-4
    assert solution._modes.uncertainty.max() < 1e-8 * np.abs(solution._modes.values).max()


def test_a_frictionless_sleeve_pushes_by_the_square_of_the_moment():
    """``M^2/2EI``: Bigoni, Dal Corso, Bosi, Misseroni, J. Mech. Phys. Solids 80 (2015). The part outside is a cantilever."""
    force = np.array([0.9, 0.4, -0.3])
    robot = through("prismatic")
    solution = mr.solve(robot, robot.inputs(force=force), solver=EXACT)
    outside = mr.SingleRod(mr.Rod(length=0.25, bending_stiffness=0.2, torsional_stiffness=0.15))
    cantilever = mr.solve(outside, outside.inputs(tip_force=force), solver=EXACT)
    np.testing.assert_allclose(solution.tip_position, cantilever.tip_position + [0, 0, 0.15], atol=1e-9)
    moment = cantilever.rod(0).moment[0]
    shape = solution.rod("rod")
    np.testing.assert_allclose(shape.arclength[-1], 0.4, rtol=1e-12)
    # inside it is straight, and carries along itself what the load does, and what the sleeve does
    np.testing.assert_allclose(shape.curvature[0], 0, atol=1e-9)
    np.testing.assert_allclose(shape.force[0], [0, 0, force[2] + moment @ moment / 0.4], atol=1e-7)


PLACE = pose((0, 0.5, 0), (0.03, 0.01, 0.17))  # of a hole that bends the rod below it, too
LOAD = {"force": (0.5, 0.3, -0.4), "gravity": (2.0, 0, -9.81), "distributed_force": (0.1, 0.2, 0.0)}


def test_it_slides_to_the_least_potential():
    """That of two rods of given lengths, clamped on both sides of the hole, by their lengths: nothing that slides is used."""
    robot = through("prismatic", at=0.2, place=PLACE, rod=BENT)
    steep = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(200))  # a nanometre is 1e-4 N here, where the lower rod is nearly taut
    found = mr.solve(robot, robot.inputs(**LOAD), solver=steep)
    assert found.stability is mr.Stability.STABLE
    arclength = found.rod("rod").arclength
    below = arclength[np.flatnonzero(np.diff(arclength) < 1e-12)[0]]
    joints = [
        mr.Joint("lower", "base", to=mr.ground),
        mr.Joint("lower", "tip", to=mr.ground, pose=PLACE),
        mr.Joint("upper", "base", to=mr.ground, pose=PLACE),
    ]
    half = mr.Rod(
        length=0.2, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(1.0, 0.3, 0.5), linear_density=0.02
    )
    cut = mr.Network(rods={"lower": half, "upper": half}, joints=joints)
    steps = 2e-5 * np.arange(-3, 4)
    moved = below + steps - 0.2
    inputs = cut.inputs(translation={"lower": moved, "upper": -moved}, **LOAD)
    given = mr.solve(cut, inputs, solver=steep)
    np.testing.assert_allclose(given.tip_position[3], found.tip_position, atol=1e-9)
    # both hang from the ground: as in ``Solution.potential``, each from where its own base is; here from that of the lower one
    density = np.array(LOAD["distributed_force"]) + 0.02 * np.array(LOAD["gravity"])
    potential = given.potential - (0.4 - below - steps) * (density @ PLACE[:3, 3])
    slope = (45 * (potential[4] - potential[2]) - 9 * (potential[5] - potential[1]) + potential[6] - potential[0]) / 0.0012
    curve = np.diff(potential[[2, 3, 4]], 2)[0] / 4e-10
    assert curve > 1e5  # N/m
    np.testing.assert_allclose(slope, 0, atol=1e-6)
    np.testing.assert_allclose(found.energy, given.energy[3], rtol=1e-9)


def test_a_ring_against_a_chain_of_links():
    """The energy of many straight links, joined by springs, that pass a point: minimised by their angles and by which it is."""
    robot = through("spherical", at=0.2, place=pose(position=(0.03, 0, 0.17)))
    force = (0.5, 0, -0.4)
    found = mr.solve(robot, robot.inputs(force=force), solver=EXACT)
    errors = []
    for links in (40, 80):
        tip, slid = _of_links(links, force, (0.03, 0.17))
        arclength = found.rod("rod").arclength
        below = arclength[np.flatnonzero(np.diff(arclength) < 1e-12)[0]]
        errors.append([tip - found.tip_position[[0, 2]], [slid - below, 0]])
    first, second = np.abs(errors).max(axis=(1, 2))
    assert second < 1e-4
    assert first / second > 3  # links converge by the square of their length: it is this place that they go to


def _of_links(count, force, ring):
    h, EI, F = 0.4 / count, 0.2, np.array([force[0], force[2]])
    middles = (np.arange(count) + 0.5) * h

    def points(angles):
        return h * np.cumsum(np.stack([np.sin(angles), np.cos(angles)], axis=1), axis=0)

    def energy(v):
        angles = v[:-1]
        bent = 0.5 * EI / h * (np.sum(np.diff(angles) ** 2) + 2 * angles[0] ** 2)
        return bent - F @ points(angles)[-1]

    def slope(v):
        angles = v[:-1]
        result = np.zeros_like(v)
        turn = np.diff(angles)
        result[:-1][1:] += EI / h * turn
        result[:-1][:-1] -= EI / h * turn
        result[0] += 2 * EI / h * angles[0]
        result[:-1] -= h * (F[0] * np.cos(angles) - F[1] * np.sin(angles))
        return result

    def gap(v):
        angles, s = v[:-1], v[-1]
        reached = np.clip(s - (middles - h / 2), 0, h)
        return np.array([(reached * np.sin(angles)).sum(), (reached * np.cos(angles)).sum()]) - ring

    def gap_slope(v):
        angles, s = v[:-1], v[-1]
        reached = np.clip(s - (middles - h / 2), 0, h)
        k = min(int(s / h), count - 1)
        by = np.stack([reached * np.cos(angles), -reached * np.sin(angles)])
        return np.concatenate([by, [[np.sin(angles[k])], [np.cos(angles[k])]]], axis=1)

    start = np.concatenate([np.full(count, 0.2), [0.18]])
    rule = {"type": "eq", "fun": gap, "jac": gap_slope}
    found = minimize(energy, start, jac=slope, constraints=[rule], method="SLSQP", options={"maxiter": 1000, "ftol": 1e-14})
    assert found.success
    return points(found.x[:-1])[-1], found.x[-1]


def test_a_column_that_goes_through_a_ring_buckles_where_it_must():
    """Clamped, held aside by the ring, and free: a determinant says at which load."""
    below, above, EI = 0.2, 0.3, 1.0
    rod = mr.Rod(length=below + above, bending_stiffness=EI, torsional_stiffness=0.8)
    robot = through("spherical", at=below, rod=rod)
    (load,) = mr.critical_loads(robot, robot.inputs(force=(0, 0, -1)))

    def gap(P):
        k = np.sqrt(P / EI)

        # below y = a (cos ks - 1) + b (sin ks - ks), above it is c sin k(L - s) about the line of the force
        def lower(s):
            return np.array([[np.cos(k * s) - 1, np.sin(k * s) - k * s], [-k * np.sin(k * s), k * np.cos(k * s) - k]])

        bent = np.array([-(k**2) * np.cos(k * below), -(k**2) * np.sin(k * below)])
        (y, turn), upper = lower(below), np.array([-k * np.cos(k * above), -(k**2) * np.sin(k * above)])
        return np.linalg.det(np.array([[*y, 0.0], [*turn, -upper[0]], [*bent, -upper[1]]]))

    grid = np.linspace(1.0, 60, 600)
    values = [gap(P) for P in grid]
    k = int(np.flatnonzero(np.diff(np.sign(values)))[0])
    assert load.multiplicity == 2
    np.testing.assert_allclose(load.load_factor, brentq(gap, grid[k], grid[k + 1]), rtol=1e-6)


def test_what_is_wrong_with_a_hole_is_named():
    def network(rod=STRAIGHT, count=1, **made):
        hole = mr.Joint("rod", "along", **({"at": 0.2, "to": mr.ground, "kind": "prismatic"} | made))
        return mr.Network(rods={"rod": rod}, joints=[mr.Joint("rod", "base", to=mr.ground), *[hole] * count])

    def refused(match, **made):
        with pytest.raises(ValueError, match=match):
            network(**made)

    refused("Joint.at = None is not allowed: must say about where along the rod the hole is", at=None)
    refused("Joint.at = 0.5 is not allowed: must be less than the length of rod 'rod', 0.4 m", at=0.5)
    refused("Joint.at = -1 is not allowed", at=-1)
    refused("Joint.kind = 'clamped' is not allowed", kind="clamped")
    refused(r"Joint.axis = \(1, 0, 0\) is not allowed: .* z of its pose is where the rod goes", axis=(1, 0, 0))
    refused(r"Joint.stiffness = \(0.1, 0.2\) is not allowed: must be one number of a hole", stiffness=(0.1, 0.2))
    with pytest.raises(ValueError, match="Joint.at = 0.1 is not allowed: must not be given: the joint is at the tip"):
        mr.Joint("rod", "tip", to=mr.ground, at=0.1)
    refused("another hole of rod 'rod' is there", count=2)
    curved = {"bending_stiffness": 0.2, "torsional_stiffness": 0.15}
    by_place = mr.Rod(length=0.4, precurvature=lambda s: (3 * s, 0 * s, 0 * s), **curved)
    in_two = mr.Rod(length=0.4, precurvature=[(0.2, (0, 0, 0)), (0.2, (1, 0, 0))], **curved)
    for rod in (by_place, in_two):
        refused(r"Network.rods\['rod'\] = .* must be the same all along, of one section", rod=rod)
    # a ring and a sleeve let a rod turn about itself where its ends do, and hold no body along it
    body = mr.Body("body")
    joints = [mr.Joint("rod", "base", to=mr.ground), mr.Joint("rod", "along", at=0.2, to=body, kind="prismatic")]
    with pytest.raises(ValueError, match="body 'body' is free to move in 1 way without a rod being bent"):
        mr.Network(rods={"rod": STRAIGHT}, bodies=[body], joints=joints)


def test_a_rod_that_is_pulled_out_of_a_hole_is_no_result():
    robot = through("prismatic", at=0.35, place=pose(position=(0, 0, 0.35)))
    solution = mr.solve(robot, robot.inputs(translation=-0.1), solver=mr.Shooting(integrator=RK4))
    assert solution.status is mr.Status.OUT_OF_HOLE
    assert np.isnan(solution.tip_position).all()


def test_a_rod_that_is_drawn_out_of_a_hole_in_a_motion_is_said_to_be():
    """Each sample beyond was ``NONFINITE``, which says to begin nearer."""
    robot = through("prismatic", at=0.35, place=pose(position=(0, 0, 0.35)))
    back = -np.linspace(0, 0.1, 6)[:, None]
    history = mr.simulate(robot, robot.inputs(translation=back), time=np.arange(6.0), solver=mr.Shooting(integrator=RK4))
    assert [mr.Status(own).name for own in history.status] == ["CONVERGED"] * 3 + ["OUT_OF_HOLE"] * 3


def test_a_rod_that_is_pulled_out_as_a_network_snaps_is_said_to_be():
    """A shuttle on a buckled arch, above which too little of a guide is left for where it snaps to."""
    half = mr.Rod(length=0.158, bending_stiffness=0.02, torsional_stiffness=0.015)

    def arch(above):
        shuttle = mr.Body("shuttle", pose=pose(position=(0, 0, -0.03)))
        guide = mr.Rod(length=0.17 + above, bending_stiffness=0.02, torsional_stiffness=0.015)
        joints = [
            mr.Joint("guide", "base", to=mr.ground, pose=pose(position=(0, 0, -0.2))),
            mr.Joint("guide", "along", at=0.14, to=shuttle, kind="prismatic", stiffness=3.0, rest=0.14),
        ]
        for name, sign in (("left", -1), ("right", 1)):
            inward = (0, -0.5 * np.pi * sign, 0)
            joints.append(mr.Joint(name, "base", to=mr.ground, pose=pose(inward, (0.15 * sign, 0, 0))))
            joints.append(mr.Joint(name, "tip", to=shuttle, pose=pose(inward)))
        return mr.Network(rods={"left": half, "right": half, "guide": guide}, bodies=[shuttle], joints=joints)

    def statuses(above, **more):
        robot, pushes = arch(above), np.zeros((9, 3))
        pushes[:, 2] = np.linspace(0, 2, 9)
        given = robot.inputs(force={"shuttle": pushes, "guide": (0.05, 0.03, 0)}, **more)
        return [mr.Status(own).name for own in mr.simulate(robot, given, time=0.1 * np.arange(9)).status]

    assert statuses(0.04) == ["CONVERGED"] * 5 + ["OUT_OF_HOLE"] * 4
    assert statuses(0.1) == ["CONVERGED"] * 5 + ["SNAPPED"] + ["CONVERGED"] * 3
    moment = {"shuttle": (0, 1e-4, 0)}  # which has no potential: damped dynamics say the same
    assert statuses(0.04, moment=moment) == ["CONVERGED"] * 5 + ["OUT_OF_HOLE"] * 4
    assert statuses(0.1, moment=moment) == ["CONVERGED"] * 5 + ["DAMPED"] + ["CONVERGED"] * 3


def test_a_rod_through_holes_is_saved_and_drawn_whole(tmp_path):
    robot = threaded()
    robot.save(tmp_path / "robot.toml")
    found = mr.load(tmp_path / "robot.toml")
    assert [(joint.end, joint.kind, joint.at) for joint in found.joints] == [(j.end, j.kind, j.at) for j in robot.joints]
    first, second = (mr.solve(own, own.inputs(**GIVEN), solver=EXACT) for own in (robot, found))
    np.testing.assert_array_equal(first.tip_position, second.tip_position)
    for nodes in (3, 6, 9, 50):
        shape = first.rod("rod", nodes=nodes)
        assert shape.arclength.shape == (nodes,)
        np.testing.assert_allclose(shape.arclength[[0, -1]], [0, 0.41], rtol=1e-12)
        assert (np.diff(shape.arclength) > -1e-15).all()
        np.testing.assert_allclose(shape.position[-1], first.tip_position, atol=1e-12)


def test_more_discs_converge_to_continuous_push_rods_by_the_fourth_order(tmp_path):
    """Rods through discs against ``PushRod``, whose model has no discs; the theory is in ``docs/networks.md``."""
    errors = example("multibackbone_discs").main(["--out", str(tmp_path / "discs.png")])
    assert errors[-1] < 1e-6  # of a tip that is 35 mm aside
    np.testing.assert_allclose(np.log2(errors[1] / errors[2]), 4, atol=0.15)


def test_a_multibackbone_is_checked():
    rod = mr.Rod.wire(length=0.1, diameter=1e-3, young_modulus=60e9, shear_modulus=23e9)

    def refused(match, error=ValueError, **made):
        given = {"backbone": rod, "rods": [rod], "offsets": [(0.004, 0)], "discs": 3} | made
        with pytest.raises(error, match=match):
            mr.multibackbone(**given)

    refused("multibackbone.discs = 0 is not allowed", discs=0)
    refused(r"multibackbone.offsets = .* must have shape \(1, 2\)", offsets=[(0.004, 0)] * 2)
    refused("must be as long as the backbone, 0.1 m", rods=[STRAIGHT])
    refused("multibackbone.rods = .* give one at least", rods=[], offsets=np.zeros((0, 2)))
    refused("multibackbone.hole = 'clamped' is not allowed", hole="clamped")
    refused(r"multibackbone.rods\[0\] = 3 is not allowed: must be a Rod", TypeError, rods=[3])
    refused(r"multibackbone.rods = Rod.* must be a list of Rod, one for each pair of offsets$", TypeError, rods=rod)
    robot = mr.multibackbone(rod, [rod] * 2, offsets=[(0.004, 0), (0, 0.004)], discs=3, disc_mass=0.001)
    assert repr(robot) == "Network(5 rods, 3 bodies, 14 joints, end effector 'disc 3')"


def test_gamma_of_rods_that_stretch(difference):
    """What they store by that slides with them."""
    rod = mr.Rod.wire(length=0.1, diameter=1e-3, young_modulus=60e9, shear_modulus=23e9)
    stretching = mr.Rod(length=0.1, bending_stiffness=1e-3, torsional_stiffness=8e-4, axial_stiffness=2.0)
    robot = mr.multibackbone(rod, [stretching] * 2, offsets=[(0.004, 0), (0, 0.004)], discs=3)
    problem = robot.problem(robot.inputs(force={"disc 3": (0.3, 0.1, -0.2)}), integrator=mr.RK4(40))
    rng = np.random.default_rng(3)
    x = problem.guess() + rng.standard_normal(problem.unknown_count)
    with problem.at_load(1.0):
        _, gamma = problem.evaluate(x)
        for _ in range(3):
            way = rng.standard_normal(problem.unknown_count)
            by_difference = difference(lambda t, way=way: problem.evaluate(x + t * way)[0][0], 1e-2)
            np.testing.assert_allclose(gamma[0] @ way, by_difference, atol=1e-8)
