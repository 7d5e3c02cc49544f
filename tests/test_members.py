"""The seam for what rods carry along themselves: members that are not in the package, each a law and its numbers in one class."""

from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
import warp as wp
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root

import multirod as mr
from multirod.models.backbone.kernels.numbers.lanes import add, div, mul, neg, sub  # noqa: F401  (operators: looked up by name)

EI, GJ, GA, EA, LENGTH = 0.01, 0.008, 40.0, 90.0, 0.2
PRECISE = mr.Shooting(tolerance=1e-10, integrator=mr.RK45(rtol=1e-12, atol=1e-14))


class Stiffening(mr.Member):
    """``W = c/4 (u_x^2 + u_y^2)^2``: a rod that resists large bending more."""

    parameters: ClassVar = {"quartic": (1, 4)}
    convex = True

    def __init__(self, coefficient):
        self.coefficient = coefficient

    def values(self, section, s):
        return np.asarray([self.coefficient])

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:
        Real, Vec3, Response, memory_type = numbers.Real, numbers.Vec3, numbers.Response, numbers.memory_type
        row, d = numbers.row, numbers.d
        add_moment, add_stiffness = numbers.add_moment, numbers.add_stiffness

        @wp.func
        def respond(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, r: wp.ref[Response]):
            c = row(memory, at)
            bend = c * (u.x * u.x + u.y * u.y)
            add_moment(r, Vec3(bend * u.x, bend * u.y, bend * d(0.0)))
            add_stiffness(r, 0, 0, bend + d(2.0) * c * u.x * u.x)
            add_stiffness(r, 0, 1, d(2.0) * c * u.x * u.y)
            add_stiffness(r, 1, 1, bend + d(2.0) * c * u.y * u.y)

        @wp.func
        def energy(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3) -> Real:
            square = u.x * u.x + u.y * u.y
            return d(0.25) * row(memory, at) * square * square

        return SimpleNamespace(respond=respond, energy=energy)


class OffsetSpring(mr.Member):
    """``W = k/2 (e_z + h u_x)^2``: a fibre bonded to the rod, beside its centreline, that resists being stretched."""

    parameters: ClassVar = {"stiffness": (1, 0), "offset": (0, 1)}
    convex = True

    def __init__(self, stiffness, offset):
        self.numbers = stiffness, offset

    def values(self, section, s):
        return np.asarray(self.numbers)

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:
        Real, Vec3, Response, memory_type = numbers.Real, numbers.Vec3, numbers.Response, numbers.memory_type
        row, fill, d = numbers.row, numbers.fill, numbers.d
        add_moment, add_force, add_stiffness = numbers.add_moment, numbers.add_force, numbers.add_stiffness

        @wp.func
        def respond(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3, r: wp.ref[Response]):
            k = row(memory, at)
            h = row(memory, at + 1)
            pull = k * (e.z + h * u.x)
            zero = fill(d(0.0))
            add_moment(r, Vec3(h * pull, zero, zero))
            add_force(r, Vec3(zero, zero, pull))
            add_stiffness(r, 0, 0, k * h * h)
            add_stiffness(r, 0, 5, k * h)
            add_stiffness(r, 5, 5, k)

        @wp.func
        def energy(memory: memory_type, at: int, on: int, u: Vec3, e: Vec3) -> Real:
            stretch = e.z + row(memory, at + 1) * u.x
            return d(0.5) * row(memory, at) * stretch * stretch

        return SimpleNamespace(respond=respond, energy=energy)


def rod(*members: mr.Member, shear: bool = False, **properties) -> mr.Rod:
    soft = {"shear_stiffness": GA, "axial_stiffness": EA} if shear else {}
    basic = {"length": LENGTH, "bending_stiffness": (EI, 1.5 * EI), "torsional_stiffness": GJ, "members": members}
    return mr.Rod(**basic | soft | properties)


LAWS = {
    "stiffening": lambda: (rod(Stiffening(1e-4)), stiffening_strains),
    "fibre": lambda: (rod(OffsetSpring(60.0, 0.01), shear=True), fibre_strains),
    "both": lambda: (rod(OffsetSpring(60.0, 0.01), Stiffening(1e-4), shear=True), both_strains),
}


def stiffening_strains(M, N, c=1e-4):
    """Of ``M = K u + c |u_xy|^2 u_xy``, by SciPy."""
    K = np.array([EI, 1.5 * EI])
    found = root(lambda u: K * u + c * (u @ u) * u - M[:2], M[:2] / K, tol=1e-14)
    assert np.abs(found.fun).max() < 1e-12
    return np.array([*found.x, M[2] / GJ]), np.zeros(3)


def fibre_strains(M, N):
    """Of one linear law with a coupling."""
    k, h = 60.0, 0.01
    law = np.diag([EI, 1.5 * EI, GJ, GA, GA, EA]) + k * np.outer([h, 0, 0, 0, 0, 1], [h, 0, 0, 0, 0, 1])
    x = np.linalg.solve(law, [*M, *N])
    return x[:3], x[3:]


def both_strains(M, N, c=1e-4):
    k, h = 60.0, 0.01
    law = np.diag([EI, 1.5 * EI, GJ, GA, GA, EA]) + k * np.outer([h, 0, 0, 0, 0, 1], [h, 0, 0, 0, 0, 1])
    bend = np.array([1.0, 1, 0, 0, 0, 0])
    found = root(lambda x: law @ x + c * (x @ (bend * x)) * bend * x - [*M, *N], np.linalg.solve(law, [*M, *N]), tol=1e-14)
    return found.x[:3], found.x[3:]


def cross(a, b):
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def tip_by_scipy(strains, M0, force):
    """Tip position, rotation and moment of a rod clamped at the origin, from its base moment, under a dead tip force."""

    def rates(s, y):
        R, M = y[3:12].reshape(3, 3), y[12:]
        N = R.T @ force
        u, e = strains(M, N)
        v = e + [0, 0, 1]
        spin = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
        return np.concatenate([R @ v, (R @ spin).ravel(), cross(M, u) + cross(N, v)])

    start = np.concatenate([np.zeros(3), np.eye(3).ravel(), M0])
    end = solve_ivp(rates, (0, LENGTH), start, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    return end[:3], end[3:12].reshape(3, 3), end[12:]


def test_one_step_for_strains_is_enough_beside_lines():
    """(L19), (L20): columns are those of a search that goes on until steps vanish, which a law of one's own asks for."""
    lines = [mr.Tendon(offset=(0.012, 0)), mr.Tendon(offset=(-0.006, 0.01)), mr.Tendon(offset=(-0.006, -0.01))]
    given = {"tension": (6.0, 1.0, 3.0), "tip_force": (0.3, -0.2, 0.4)}
    found = []
    for members in ((), (Stiffening(0.0),)):
        robot = mr.SingleRod(rod(*members, lines=lines, precurvature=(1.0, 2.0, 9.0)))
        solution = mr.solve(robot, robot.inputs(**given), solver=mr.Shooting(integrator=mr.RK4(40), tolerance=1e-10))
        found.append((solution.raise_if_failed().tip_position, solution.jacobian("tension"), solution.jacobian("tip_force")))
    for some, other in zip(*found, strict=True):
        # 1e-12 of the matrix at each stage, (L19)
        np.testing.assert_allclose(some, other, rtol=0, atol=1e-11 * np.abs(other).max())


@pytest.mark.parametrize("name", LAWS)
def test_equilibrium_is_that_of_an_independent_integration(name):
    one, strains = LAWS[name]()
    robot = mr.SingleRod(one)
    force = np.array([0.5, 0.4, -0.3])
    solution = mr.solve(robot, robot.inputs(tip_force=force), solver=PRECISE)
    assert solution.status == mr.Status.CONVERGED
    stiffness = np.array([EI, 1.5 * EI, GJ])
    position, rotation, moment = tip_by_scipy(strains, stiffness * solution.unknowns, force)  # x = K^-1 M(0)
    assert np.abs(moment / stiffness).max() < 1e-7  # what both integrations leave, over the length of the rod
    np.testing.assert_allclose(solution.tip_position, position, atol=1e-9)
    np.testing.assert_allclose(solution.tip_rotation, rotation, atol=1e-8)


@pytest.mark.parametrize("moment", [0.01, 0.1, 1.0, 30.0])
def test_a_bent_rod_is_the_circle_that_its_law_says(moment):
    """``EI kappa + c kappa^3 = M``, from where the members do little to where they carry nearly all."""
    c = 1e-4
    robot = mr.SingleRod(rod(Stiffening(c)))
    solution = mr.solve(robot, robot.inputs(tip_moment=(moment, 0, 0)), solver=PRECISE)
    kappa = brentq(lambda k: EI * k + c * k**3 - moment, 0, moment / EI, xtol=1e-14)
    shape = solution.rod(0, nodes=5)
    np.testing.assert_allclose(shape.curvature[:, 0], kappa, rtol=1e-10)
    np.testing.assert_allclose(shape.moment[:, 0], EI * kappa, rtol=1e-10)  # the rod's own part
    np.testing.assert_allclose(solution.energy, LENGTH * (EI * kappa**2 / 2 + c * kappa**4 / 4), rtol=1e-10)


@pytest.mark.parametrize("name", LAWS)
def test_derivatives_and_energy_are_exact(name):
    one, _ = LAWS[name]()
    robot = mr.SingleRod(one)
    force = np.array([0.5, 0.4, -0.3])

    def at(value, guess=None):
        return mr.solve(robot, robot.inputs(tip_force=value, rotation=0.3), solver=PRECISE, guess=guess)

    solution = at(force)
    compliance = solution.jacobian("tip_force")[:3]
    h = 1e-4
    for k, e in enumerate(np.eye(3)):
        ends = at(force + h * e, solution), at(force - h * e, solution)
        np.testing.assert_allclose(
            compliance[:, k], (ends[0].tip_position - ends[1].tip_position) / (2 * h), atol=1e-6 * np.abs(compliance).max()
        )
        # the total energy is stationary: it changes with a dead force by minus the tip's position
        np.testing.assert_allclose((ends[0].potential - ends[1].potential) / (2 * h), -solution.tip_position[k], atol=1e-7)
    np.testing.assert_allclose(compliance, compliance.T, atol=1e-9 * np.abs(compliance).max())
    assert str(solution.stability) == "STABLE"


def test_a_batch_is_bitwise_what_each_is_alone_whatever_stands_beside_it():
    robot = mr.SingleRod(rod(Stiffening(1e-4)))
    forces = np.array([[0.5, 0.4, -0.3], [0, 0, 0], [9.0, 0, 0], [0.01, 0, 0], [0.2, 3.0, 1.0]])
    batch = mr.solve(robot, robot.inputs(tip_force=forces))
    for k in range(len(forces)):
        alone = mr.solve(robot, robot.inputs(tip_force=np.array([forces[k]])))
        np.testing.assert_array_equal(batch.tip_position[k], alone.tip_position[0])


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_single_precision_counts_in_natural_units():
    for scale in (1e-3, 1.0, 1e3):
        bent = mr.Rod(
            length=LENGTH * scale,
            bending_stiffness=EI * scale**4,
            torsional_stiffness=GJ * scale**4,
            members=[Stiffening(1e-4 * scale**6)],
        )
        robot = mr.SingleRod(bent)
        inputs = robot.inputs(tip_force=np.array([0.5, 0.4, -0.3]) * scale**2)
        single = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK4(50, precision="float32")))
        double = mr.solve(robot, inputs)
        np.testing.assert_allclose(single.tip_position, double.tip_position, atol=1e-5 * LENGTH * scale)


def test_legs_carry_members():
    angles = np.arange(3) * 2 * np.pi / 3
    base, platform = np.tile(np.eye(4), (2, 3, 1, 1))
    base[:, :2, 3] = 0.06 * np.stack([np.cos(angles), np.sin(angles)], 1)
    platform[:, :2, 3] = 0.03 * np.stack([np.cos(angles), np.sin(angles)], 1)
    stiff = mr.ParallelRods(legs=[rod(Stiffening(1e-4))] * 2 + [rod()], base=base, platform=platform)
    force = np.array([0.5, 0.2, -0.4])
    h = 1e-4

    def at(value):
        return mr.solve(stiff, stiff.inputs(tip_force=value), solver=PRECISE)

    for k, e in enumerate(np.eye(3)):
        slope = (at(force + h * e).potential - at(force - h * e).potential) / (2 * h)
        np.testing.assert_allclose(slope, -at(force).tip_position[k], atol=1e-7)


def test_what_is_not_modelled_is_refused():
    with pytest.raises(ValueError, match=r"Rod.members = .* is not allowed: must be a list of Member"):
        rod("a tendon")
    with pytest.raises(ValueError, match=r"must have no members"):
        mr.ConcentricTubes([rod(Stiffening(1e-4))])
    robot = mr.SingleRod(rod(Stiffening(1e-4)))
    with pytest.raises(ValueError, match=r"tip_curvature = .* is not allowed: must not be given: the rod has members"):
        robot.inputs(tip_curvature=(1, 0, 0))
