"""Magnetised rods in a uniform field: analytic solutions, the energy, and exact derivatives."""

import numpy as np
import pytest
from scipy.integrate import simpson, solve_bvp
from scipy.linalg import eigh

import multirod as mr

EI, GJ, LENGTH = 0.01, 0.008, 0.2
PRECISE = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-11, atol=1e-13))


def wire(**properties) -> mr.Rod:
    return mr.Rod(
        **{"length": LENGTH, "bending_stiffness": EI, "torsional_stiffness": GJ, "magnetisation": (0, 0, 2.0)} | properties
    )


def tubes() -> mr.ConcentricTubes:
    inner = wire(precurvature=(6.0, 2.0, 0.5), magnetisation=(0.6, -0.9, 2.0))
    outer = wire(
        length=0.14,
        bending_stiffness=(0.03, 0.025),
        torsional_stiffness=0.02,
        precurvature=(0, 9.0, 0),
        magnetisation=(-0.8, 0.5, 0.7),
    )
    return mr.ConcentricTubes([inner, outer])


def hexapod() -> mr.ParallelRods:
    angles = np.arange(3) * 2 * np.pi / 3
    base, platform = np.tile(np.eye(4), (2, 3, 1, 1))
    base[:, :2, 3] = 0.06 * np.stack([np.cos(angles), np.sin(angles)], 1)
    platform[:, :2, 3] = 0.03 * np.stack([np.cos(angles), np.sin(angles)], 1)
    return mr.ParallelRods(legs=[wire(magnetisation=(0.5, 0, 1.5))] * 3, base=base, platform=platform)


ROBOTS = {
    "rod": (lambda: mr.SingleRod(wire(precurvature=(3, 1, 2), magnetisation=(0.4, -0.2, 2.0))), {"tip_force": (0.1, 0.2, -0.1)}),
    "rod without other loads": (lambda: mr.SingleRod(wire()), {}),
    "rod that shears": (
        lambda: mr.SingleRod(wire(shear_stiffness=40.0, axial_stiffness=90.0, linear_density=0.1)),
        {"gravity": (0, 9.81, 0)},
    ),
    "tubes": (tubes, {"rotation": (0.3, 1.2), "translation": (-0.03, -0.01)}),
    "tubes under a force": (tubes, {"rotation": (0.3, 1.2), "tip_force": (0.1, 0.05, 0.0)}),
    "rods on a platform": (hexapod, {"tip_force": (0.3, 0.1, -0.2)}),
}
FIELD = np.array([0.05, -0.03, 0.02])


@pytest.fixture(params=ROBOTS)
def scene(request):
    make, inputs = ROBOTS[request.param]
    return make(), inputs


@pytest.mark.parametrize("strength", [0.02, 0.1, 1.0])
def test_planar_rod_across_the_field(strength):
    """``EI theta'' = -mu B cos(theta)``, solved as a boundary value problem by SciPy."""
    k = 2.0 * strength / EI
    s = np.linspace(0, LENGTH, 200)
    start = np.vstack([0.1 * s / LENGTH, 0.1 + 0 * s])
    exact = solve_bvp(
        lambda _, y: np.vstack([y[1], -k * np.cos(y[0])]),
        lambda a, b: np.array([a[0], b[1]]),
        s,
        start,
        tol=1e-11,
        max_nodes=50_000,
    )
    assert exact.success
    fine = np.linspace(0, LENGTH, 4001)
    angle = exact.sol(fine)[0]
    robot = mr.SingleRod(wire())
    found = mr.solve(robot, robot.inputs(magnetic_field=(strength, 0, 0)), solver=PRECISE)
    tip = simpson(np.sin(angle), x=fine), 0.0, simpson(np.cos(angle), x=fine)
    np.testing.assert_allclose(found.tip_position, tip, atol=1e-9)  # what SciPy's tolerance leaves
    assert str(found.stability) == "STABLE"


def test_a_rod_against_its_field_buckles_where_theory_says():
    """``mu B L^2/EI = pi^2/4`` and ``9 pi^2/4``: a cantilever whose moment per length points against the field."""
    robot = mr.SingleRod(wire(bending_stiffness=(EI, 4 * EI)))
    unit = np.pi**2 / 4 * EI / (2.0 * LENGTH**2)
    found = mr.critical_loads(robot, robot.inputs(magnetic_field=(0, 0, -unit)), count=2, solver=mr.Shooting())
    np.testing.assert_allclose([load.load_factor for load in found], [1.0, 4.0], rtol=1e-6)


@pytest.mark.parametrize(("k", "part"), [(10.0, 1.8), (100.0, 6.0)])
def test_a_magnet_in_tissue_buckles_in_a_solve_as_in_a_motion(k, part):
    """Against its field, in a medium of ``k EI/L^4``; its shape as SciPy has it."""
    k *= EI / LENGTH**4
    robot, strength = mr.SingleRod(wire(foundation=k)), part * np.pi**2 / 4 * EI / (2.0 * LENGTH**2)
    found = mr.solve(robot, robot.inputs(magnetic_field=(0, 0, -strength)))
    assert found.status is mr.Status.BIFURCATED
    time = np.linspace(0, 1, 9)
    moved = mr.simulate(robot, robot.inputs(magnetic_field=np.outer(time, (0, 0, -strength))), time=time)
    assert not moved.failed.any()
    np.testing.assert_allclose(moved[-1].tip_position, found.tip_position, atol=1e-7 * LENGTH)

    def rates(s, y):
        x, z, angle, shear, thrust, moment = y
        turns = np.cos(angle) * shear - np.sin(angle) * thrust
        more = moment / EI, k * x, k * (z - s), -turns - 2.0 * strength * np.sin(angle)
        return np.vstack([np.sin(angle), np.cos(angle), *more])

    shape = found.rod(0, nodes=101)
    force, moment = ((shape.rotation @ values[..., None])[..., 0] for values in (shape.force, shape.moment))
    angle = np.arctan2(shape.rotation[:, 0, 2], shape.rotation[:, 2, 2])
    start = np.vstack([shape.position[:, 0], shape.position[:, 2], angle, force[:, 0], force[:, 2], moment[:, 1]])
    exact = solve_bvp(rates, lambda a, b: np.append(a[:3], b[3:]), shape.arclength, start, tol=1e-9, max_nodes=50_000)
    assert exact.success
    np.testing.assert_allclose(found.tip_position[[0, 2]], exact.y[:2, -1], atol=1e-7 * LENGTH)  # what both tolerances leave
    np.testing.assert_allclose(moment[:, 1], exact.sol(shape.arclength)[5], atol=1e-5 * EI / LENGTH)


@pytest.mark.parametrize("part", [1.2, 2.0])
def test_a_field_that_turns_until_it_is_against_a_round_magnet(part):
    """Where it is exactly so, nothing holds the bent magnet against a turn about its axis; beyond it goes around at once."""
    robot, strength = mr.SingleRod(wire()), part * np.pi**2 / 4 * EI / (2.0 * LENGTH**2)
    time = np.linspace(0, 2, 21)
    field = strength * np.stack([np.sin(np.pi * time), 0 * time, np.cos(np.pi * time)], axis=-1)
    turned = mr.simulate(robot, robot.inputs(magnetic_field=field), time=time)
    assert not turned.failed.any()
    assert turned[10].stability is mr.Stability.FOLD
    at_once = mr.solve(robot, robot.inputs(magnetic_field=field[10]))
    assert at_once.status is mr.Status.BIFURCATED
    np.testing.assert_allclose(turned[10].tip_position, at_once.tip_position, atol=1e-8 * LENGTH)
    (event,) = (event for sample in turned.events for event in sample)
    assert event.status is mr.Status.SNAPPED
    assert turned.status[11] is mr.Status.SNAPPED
    # what it goes around to is a mirror image, of the same energy; it was said to lose a hundredth of it
    assert event.energy_lost == pytest.approx(0, abs=1e-6 * EI / LENGTH)
    # mirror images by the plane across the field that was against it
    np.testing.assert_allclose(
        turned.tip_position[12:], turned.tip_position[8::-1][: len(turned.time[12:])] * (-1, 1, 1), atol=1e-7
    )


@pytest.mark.parametrize("last", [187, 189, 195])
def test_a_round_magnet_goes_around_where_the_field_is_against_it_however_long_the_sample(last):
    """There it turns about its axis for nothing, which was taken for neutral on all of the sample: the snap was said to be where
    another mode vanishes, 7 degrees beyond and more."""
    soft = mr.Rod.wire(length=0.05, diameter=1.5e-3, young_modulus=2e6, poisson_ratio=0.49)
    tip = mr.Rod.wire(length=0.01, diameter=1.5e-3, young_modulus=160e9, poisson_ratio=0.24, magnetisation=(0, 0, 5.66e5))
    robot = mr.SingleRod(mr.Rod(sections=[*soft.sections, *tip.sections]))
    angle = np.radians([*range(0, 171, 10), 175, last])
    field = 0.02 * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
    time = np.arange(len(angle), dtype=float)
    turned = mr.simulate(robot, robot.inputs(magnetic_field=field), time=time)
    assert turned.status[-1] is mr.Status.SNAPPED
    assert turned[-1].stability is mr.Stability.STABLE
    (event,) = (event for sample in turned.events for event in sample)
    x = field[-2:, 0]
    assert event.time == pytest.approx(time[-2] + x[0] / (x[0] - x[1]), abs=1e-5)


def dipole(solution: mr.Solution, robot: mr.Assembly, nodes: int = 2001) -> np.ndarray:
    """Magnetic moment of all rods in the world [A m^2], by their shapes."""
    total = np.zeros(3)
    for k, rod in enumerate(robot.rods):
        shape = solution.rod(k, nodes=nodes)
        total += simpson(shape.rotation @ rod.sections[0].magnetisation, x=shape.arclength, axis=0)
    return total


def test_energy_changes_with_the_field_by_the_dipole(scene):
    """Where the total energy is stationary, its rate with the field is the explicit one, minus the dipole moment."""
    robot, inputs = scene
    h = 1e-4

    def potential(field):
        solution = mr.solve(robot, robot.inputs(magnetic_field=field, **inputs), solver=PRECISE)
        assert solution.status == mr.Status.CONVERGED
        return solution.potential

    rates = [(potential(FIELD + h * e) - potential(FIELD - h * e)) / (2 * h) for e in np.eye(3)]
    solution = mr.solve(robot, robot.inputs(magnetic_field=FIELD, **inputs), solver=PRECISE)
    expected = -dipole(solution, robot)
    np.testing.assert_allclose(rates, expected, atol=2e-6 * np.abs(expected).max())  # differences of second order


def test_derivatives_are_exact(scene):
    robot, inputs = scene
    solution = mr.solve(robot, robot.inputs(magnetic_field=FIELD, **inputs), solver=PRECISE)
    for name, value in (("magnetic_field", FIELD), ("rotation", np.broadcast_to(inputs.get("rotation", 0.0), robot.rod_count))):
        jacobian = solution.jacobian(name)
        h = 1e-5
        for k, e in enumerate(np.eye(len(value))):
            ends = []
            for sign in (1, -1):
                changed = {**inputs, "magnetic_field": FIELD, name: value + sign * h * e}
                ends.append(mr.solve(robot, robot.inputs(**changed), solver=PRECISE, guess=solution))
            moved = (ends[0].tip_position - ends[1].tip_position) / (2 * h)
            turned = ends[0].tip_rotation @ ends[1].tip_rotation.T / (2 * h)
            spin = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2
            size = np.abs(jacobian).max()
            np.testing.assert_allclose(jacobian[:3, k], moved, atol=1e-6 * size)
            np.testing.assert_allclose(jacobian[3:, k], spin, atol=1e-6 * size)


def test_gamma_is_exact(scene):
    robot, inputs = scene
    problem = robot.problem(robot.inputs(magnetic_field=FIELD, **inputs), integrator=mr.RK45(steps=20))
    x = problem.guess() + 0.3 * np.sin(1 + np.arange(problem.unknown_count))
    _, gamma = problem.evaluate(x)
    h = 1e-6
    for k, e in enumerate(np.eye(problem.unknown_count)):
        difference = (problem.evaluate(x + h * e)[0] - problem.evaluate(x - h * e)[0]) / (2 * h)
        np.testing.assert_allclose(gamma[0, :, k], difference[0], atol=1e-7 * max(1.0, np.abs(gamma).max()))


def test_a_batch_is_bitwise_what_each_is_alone():
    robot = tubes()
    fields = FIELD * np.linspace(-1, 1, 7)[:, None]
    batch = mr.solve(robot, robot.inputs(magnetic_field=fields, rotation=(0.3, 1.2)))
    for k in (1, 5):
        alone = mr.solve(robot, robot.inputs(magnetic_field=fields[k], rotation=(0.3, 1.2)))
        np.testing.assert_array_equal(batch.tip_position[k], alone.tip_position)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_single_precision_finds_the_same_in_any_unit():
    for scale in (1e-3, 1.0, 1e3):
        rod = wire(length=LENGTH * scale, bending_stiffness=EI * scale**4, torsional_stiffness=GJ * scale**4)
        robot = mr.SingleRod(rod)
        field = np.array([0.05, 0, 0.01]) * scale**2
        single = mr.solve(
            robot, robot.inputs(magnetic_field=field), solver=mr.Shooting(integrator=mr.RK4(50, precision="float32"))
        )
        double = mr.solve(robot, robot.inputs(magnetic_field=field))
        assert single.status == double.status == mr.Status.CONVERGED
        np.testing.assert_allclose(single.tip_position, double.tip_position, atol=1e-5 * LENGTH * scale)


def out_of_plane(angle: float, strength: float, curvature: float, more: float, count: int = 400) -> float:
    """Least eigenvalue of the energy's second variation out of the plane, of a rod curved about y in a field along (sin, 0,
    cos) of an angle, at the equilibrium in it that is bent by so much ``more`` or so; over that of an unloaded straight rod."""
    pull = 2.0 * strength

    def rates(s, y):
        return np.stack([y[1], pull / EI * np.sin(y[0] - angle)])

    s = np.linspace(0, LENGTH, 201)
    start = np.stack([(curvature + more) * s, 0 * s + curvature + more])
    plane = solve_bvp(rates, lambda a, b: np.array([a[0], b[1] - curvature]), s, start, tol=1e-9, max_nodes=20_000)
    assert plane.success
    # turns (p, 0, q) about the rod's axes, linear between nodes: with u = (0, v, 0), M = (0, m, 0) and the field (b, 0, c) there,
    # EI (p' + v q)^2 + GJ (q' - v p)^2 - m (v (p^2 + q^2) + q p' - p q') - pull (b p q - c p^2)
    h = LENGTH / count
    theta, v = plane.sol((np.arange(count) + 0.5) * h)
    form, unit = np.zeros((2, 2 * count + 2, 2 * count + 2))
    p, q = np.array([0.5, 0, 0.5, 0]), np.array([0, 0.5, 0, 0.5])
    dp, dq = np.array([-1, 0, 1, 0]) / h, np.array([0, -1, 0, 1]) / h
    for k in range(count):
        m, b, c = EI * (v[k] - curvature), np.sin(angle - theta[k]), np.cos(angle - theta[k])
        bent, twisted = dp + v[k] * q, dq - v[k] * p
        own = EI * np.outer(bent, bent) + GJ * np.outer(twisted, twisted)
        own = own - m * (v[k] * (np.outer(p, p) + np.outer(q, q)) + np.outer(q, dp) - np.outer(p, dq))
        own = own - pull * (b * np.outer(p, q) - c * np.outer(p, p))
        at = slice(2 * k, 2 * k + 4)
        form[at, at] += 0.5 * h * (own + own.T)
        unit[at, at] += h * (EI * np.outer(dp, dp) + GJ * np.outer(dq, dq))
    return float(eigh(form[2:, 2:], unit[2:, 2:], eigvals_only=True, subset_by_index=(0, 0))[0])


@pytest.mark.parametrize("strength", [0.5, 1.0])
def test_a_curved_magnet_swings_out_of_its_plane_and_back_into_it_with_the_field(strength):
    """A field that turns in the plane of a curved rod, to and fro: the rod leaves the plane at one angle and is back at another,
    and on the way back the same. What comes back into its plane has not buckled: it had no result, or was said to."""
    robot = mr.SingleRod(wire(precurvature=(0, 8.0, 0)))
    angle = np.radians(np.arange(170, 250, 3.0))
    angle = np.concatenate([angle, angle[-2::-1]])
    field = strength * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
    time = np.arange(len(angle), dtype=float)
    motion = mr.simulate(robot, robot.inputs(magnetic_field=field), time=time)
    assert not motion.failed.any()
    out, back = (event for sample in motion.events for event in sample)
    assert out.status == back.status == mr.Status.BIFURCATED
    away = np.abs(motion.tip_position[:, 1]) > 1e-6 * LENGTH
    left, right = (np.interp(event.time, time, angle) for event in (out, back))
    np.testing.assert_array_equal(away, (angle > left) & (angle < right))  # the same to and fro: nothing snaps
    np.testing.assert_allclose(motion.potential, motion.potential[::-1], rtol=0, atol=1e-9 * EI / LENGTH)
    for critical, more in ((left, 12.0), (right, -24.0)):  # 5e-3 of a degree from where the mode vanishes
        nearer, here, beyond = (out_of_plane(critical + turn, strength, 8.0, more) for turn in np.radians((-1, 0, 1)))
        assert abs(here) < 5e-3 * abs(beyond - nearer) / 2


def test_a_magnet_swings_by_much_at_once_and_has_not_snapped():
    """A soft one is turned out of its plane by 0.7 rad in a fifth of a degree. That was said to be a snap, which lost energy."""
    sections = [(0.06, 0.0, 0.0), (0.012, 0.177, 15.0), (0.015, 0.0, 15.0), (0.018, 0.177, 15.0)]
    rod = mr.Rod(
        sections=[
            mr.Section(
                length=length,
                bending_stiffness=1.2425e-6,
                torsional_stiffness=8.569e-7,
                magnetisation=(0, 0, magnetisation),
                precurvature=(0, curvature, 0),
            )
            for length, magnetisation, curvature in sections
        ]
    )
    robot = mr.SingleRod(rod)
    angle = np.radians(np.arange(186, 208, 3.0))
    angle = np.concatenate([angle, angle[-2::-1]])
    for strength in (0.03, 0.06):
        field = strength * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
        time = np.arange(len(angle), dtype=float)
        motion = mr.simulate(robot, robot.inputs(magnetic_field=field), time=time)
        events = [event for sample in motion.events for event in sample]
        assert [event.status for event in events] == [mr.Status.BIFURCATED] * 2
        assert all(event.energy_lost == 0 for event in events)
        np.testing.assert_allclose(motion.tip_position, motion.tip_position[::-1], rtol=0, atol=1e-7)


def test_a_field_without_a_magnetised_rod_is_refused():
    robot = mr.SingleRod(wire(magnetisation=None))
    with pytest.raises(ValueError, match=r"magnetic_field = .* is not allowed: must be zero: no rod has a magnetisation"):
        robot.inputs(magnetic_field=(0, 0, 1))
    tracker = mr.Tracker(robot, solver=mr.Shooting(), dt=0.01)
    with pytest.raises(ValueError, match="no rod has a magnetisation"):
        tracker.step(magnetic_field=(0, 0, 1))


def test_a_tube_takes_magnetisation_per_volume():
    tube = mr.Rod.tube(
        length=0.1, outer_diameter=2e-3, inner_diameter=1e-3, young_modulus=1e9, shear_modulus=4e8, magnetisation=(0, 0, 1e5)
    )
    np.testing.assert_allclose(tube.sections[0].magnetisation, (0, 0, 1e5 * np.pi / 4 * 3e-6), rtol=1e-15)
