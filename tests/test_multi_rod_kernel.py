"""The equations of several concentric rods: stored equilibria, an independent integration, and their columns."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import warp as wp
from scipy.integrate import quad_vec, solve_ivp

import multirod as mr
from multirod.inputs import Inputs
from multirod.models.assemblies.single_rod import BACKBONE_INPUTS
from multirod.models.backbone.kernels.numbers.lanes import lanes as numbers
from multirod.models.backbone.kernels.numbers.vectors import vectors
from multirod.models.backbone.problem import BackboneProblem

TIGHT = mr.RK45(rtol=1e-12, atol=1e-14)


class Tubes(BackboneProblem):
    """Tubes that twist behind the base plate, with chosen features."""

    def __init__(self, rods, base, values, *, changes=None, **options):
        self.changes = {"transmission": True} | (changes or {})
        super().__init__(rods, base, Inputs(BACKBONE_INPUTS, len(rods), values, 0.2), **options)

    def _features(self, *args):
        return replace(super()._features(*args), **self.changes)


def turn(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def longest_first(case):
    """The inputs with the tube that reaches furthest as rod 1: the kernel integrates to its end."""
    inputs = dict(case["inputs"])
    reach = [tube["length"] + beta for tube, beta in zip(inputs["tubes"], inputs["base_position_beta"], strict=True)]
    order = sorted(range(len(reach)), key=lambda i: -reach[i])
    for name in ("tubes", "base_position_beta", "base_angle_alpha"):
        inputs[name] = [inputs[name][i] for i in order]
    return inputs, np.array(case["expected"]["base_torsion_rates"]["value"])[order]


def tubes_of(inputs):
    rods = []
    for tube in inputs["tubes"]:
        straight = tube["length"] - tube["curved_length"]
        curved = tuple(tube["u_star"])
        precurvature = [(straight, (0, 0, 0)), (tube["curved_length"], curved)] if straight > 1e-12 else curved
        rods.append(
            mr.Rod(length=tube["length"], bending_stiffness=tube["EI"], torsional_stiffness=tube["GJ"], precurvature=precurvature)
        )
    return rods


def base_unknowns(inputs, torsion_rates, tip_position):
    """The stored base torsions and the base moment that balances the tip wrench, as the kernel's unknowns."""
    tubes = inputs["tubes"]
    beta = np.array(inputs["base_position_beta"])
    GJ, EI = (np.array([tube[name] for tube in tubes]) for name in ("GJ", "EI"))
    straight = np.array([tube["length"] - tube["curved_length"] for tube in tubes])
    twist = np.array([tube["u_star"][2] for tube in tubes]) * (straight + beta <= 0)
    tau = GJ * (torsion_rates - twist)
    arm = np.array(tip_position) - inputs["p0"]
    force, moment = (np.array(inputs.get(f"tip_{name}_world", (0, 0, 0)), float) for name in ("force", "moment"))
    M = np.array(inputs["R0"]).T @ (moment + np.cross(arm, force))
    first = inputs["base_angle_alpha"][0] - beta[0] * tau[0] / GJ[0]  # from the Bishop frame to tube 1
    return np.concatenate([(turn(-first) @ M)[:2] / EI.sum(), tau / np.minimum(GJ, EI)]), tau.sum() - M[2]


def test_stored_equilibria(tube_case, make_pose):
    inputs, torsion_rates = longest_first(tube_case)
    expected = tube_case["expected"]
    values = {"rotation": inputs["base_angle_alpha"], "translation": inputs["base_position_beta"]}
    values |= {f"tip_{name}": inputs.get(f"tip_{name}_world", (0.0, 0.0, 0.0)) for name in ("force", "moment")}
    base = make_pose(inputs["R0"], inputs["p0"])
    problem = Tubes(tubes_of(inputs), base, values, integrator=TIGHT, enabled=("tip_force", "tip_moment", "gravity"))
    x, torque_gap = base_unknowns(inputs, torsion_rates, expected["tip_position"]["value"])
    problem.unknowns.assign(x[None])
    problem.integrate()
    assert problem.fault.numpy()[0] == 0
    # The base torsions are known to abs_unc; on the way to the tip it grows by the condition of shooting, 1e3 at most.
    uncertainty = 1e3 * expected["base_torsion_rates"]["abs_unc"] + 1e-10
    length = max(tube["length"] for tube in inputs["tubes"])
    assert np.abs(problem.read("residual")).max() < uncertainty
    assert abs(torque_gap) < uncertainty * max(tube["GJ"] for tube in inputs["tubes"])
    np.testing.assert_allclose(problem.read("position")[0], expected["tip_position"]["value"], rtol=0, atol=uncertainty * length)
    rotation = problem.read("rotation")[0].reshape(3, 3)
    np.testing.assert_allclose(rotation, expected["tip_rotation_of_longest_tube"]["value"], rtol=0, atol=uncertainty)


# ---- three tubes of unequal bending stiffness under every load, at arbitrary unknowns ----

BETA = np.array([-0.03, -0.02, -0.012])
ALPHA = np.array([0.3, -0.8, 1.4])
LENGTHS = [(0.08, 0.09), (0.05, 0.07), (0.04, 0.03)]
STIFFNESS = [(0.010, 0.014, 0.009), (0.020, 0.017, 0.025), (0.050, 0.060, 0.045)]
DENSITY = (0.1, 0.2, 0.3)
LOADS = {
    "tip_force": (0.3, -0.2, 0.25),
    "tip_moment": (0.01, 0.02, -0.015),
    "gravity": (2.0, -3.0, 1.0),
    "distributed_moment": (0.03, -0.02, 0.05),
}


def bent(s):
    return np.array([9 * np.cos(8 * s), 30 * s, 4 + 20 * s])


PRECURVATURE = [((2, -3, 1), bent), (bent, (8, 1, -2)), ((5, 4, 0), (-3, 6, 2))]
BASE = np.array([[0.36, 0.48, -0.8, 0.1], [-0.8, 0.6, 0.0, -0.2], [0.48, 0.64, 0.6, 0.3], [0, 0, 0, 1]])


def three_tubes(**options):
    rods = []
    for lengths, (kx, ky, kz), density, laws in zip(LENGTHS, STIFFNESS, DENSITY, PRECURVATURE, strict=True):
        common = {"bending_stiffness": (kx, ky), "torsional_stiffness": kz, "linear_density": density}
        pieces = zip(lengths, laws, strict=True)
        rods.append(mr.Rod(sections=[mr.Section(length=size, precurvature=law, **common) for size, law in pieces]))
    values = {"rotation": ALPHA, "translation": BETA} | LOADS
    return Tubes(rods, BASE, values, **options)


def precurvature(i, s, middle):
    """u* of tube i at s from the plate, on the stretch around ``middle``."""
    x = s - BETA[i]
    later = middle - BETA[i] > LENGTHS[i][0]
    law = PRECURVATURE[i][int(later)]
    return law(x - LENGTHS[i][0] * later) if callable(law) else np.array(law, float)


def integrate_bishop(unknowns):
    """DESIGN's equations in the Bishop frame by SciPy: tip pose, what the moment at the tip lacks, torques at the ends."""
    EI, GJ = np.array(STIFFNESS)[:, :2], np.array(STIFFNESS)[:, 2]
    ends = np.array([sum(pair) for pair in LENGTHS]) + BETA
    inner = np.array([pair[0] for pair in LENGTHS]) + BETA
    tau = unknowns[2:] * np.minimum(GJ, EI.max(axis=1))
    behind = [quad_vec(lambda s, i=i: precurvature(i, s, BETA[i])[2], BETA[i], 0.0, epsabs=1e-14)[0] for i in range(3)]
    theta = ALPHA - BETA * tau / GJ + behind
    M = turn(theta[0])[:2, :2] @ (unknowns[:2] * EI.max(axis=1).sum())
    R0, p0 = BASE[:3, :3], BASE[:3, 3]
    force, moment, g, l = (np.array(LOADS[name]) for name in ("tip_force", "tip_moment", "gravity", "distributed_moment"))

    def rate(s, y, middle):
        R, theta, tau, M = y[3:12].reshape(3, 3), y[12:15], y[15:18], y[18:20]
        here = middle < ends
        weight = sum(rho * max(end - s, 0) for rho, end in zip(DENSITY, ends, strict=True))
        N = R.T @ (force + weight * g)
        lb = R.T @ l
        total, drive = np.zeros((2, 2)), np.array(M)
        K, bend = [], []
        for i in range(3):
            Rz = turn(theta[i])[:2, :2]
            us = precurvature(i, s, middle)
            K.append(here[i] * Rz @ np.diag(EI[i]) @ Rz.T)
            bend.append((Rz @ us[:2], us[2]))
            total += K[i]
            drive += K[i] @ bend[i][0]
        u = np.linalg.solve(total, drive)
        dtheta = np.array([here[i] * (bend[i][1] + tau[i] / GJ[i]) for i in range(3)])
        dtau = np.zeros(3)
        for i in range(3):
            m = K[i] @ (u - bend[i][0])
            dtau[i] = -(u[0] * m[1] - u[1] * m[0])
        dtau[0] -= lb[2]  # what twists the backbone from outside acts on tube 1
        Mz = (here * tau).sum()
        dM = [-u[1] * Mz + N[1] - lb[0], u[0] * Mz - N[0] - lb[1]]
        hat = np.array([[0, 0, u[1]], [0, 0, -u[0]], [-u[1], u[0], 0]])
        return np.concatenate([R[:, 2], (R @ hat).ravel(), dtheta, dtau, dM])

    y = np.concatenate([p0, R0.ravel(), theta, tau, M])
    nodes = np.unique([0, *ends, *inner[inner > 0]])
    torque_at_end = np.zeros(3)
    for a, b in pairwise(nodes):
        y = solve_ivp(rate, (a, b), y, args=((a + b) / 2,), method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        torque_at_end = np.where(ends == b, y[15:18], torque_at_end)
        # Zero at equilibrium; elsewhere the kernel hands the torque that a tube has at its end to tube 1.
        y[15] += y[16:18][ends[1:] == b].sum()
    R1 = y[3:12].reshape(3, 3) @ turn(y[12])
    M1 = np.append(turn(-y[12])[:2, :2] @ y[18:20], y[15])
    gap = (BASE[:3, :3] @ turn(ALPHA[0])).T @ (R1 @ M1 - moment)
    scale = np.array([1 / EI[0].max(), 1 / EI[0].max(), 1 / min(GJ[0], EI[0].max())])
    return y[:3], R1, np.concatenate([scale * gap, torque_at_end[1:] / np.minimum(GJ, EI.max(axis=1))[1:]])


X = np.array([1.5, -2.0, 3.0, -2.5, 1.2])


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_against_the_bishop_frame():
    """The fixed grid leaves less than the bounds at 400 steps of fifth order."""
    problem = three_tubes(integrator=mr.RK45(steps=400), pose_sensitivities=True, direction_count=1)
    residual, _ = problem.evaluate(X[None])
    position, R, expected = integrate_bishop(X)
    np.testing.assert_allclose(problem.read("position")[0], position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(problem.read("rotation")[0].reshape(3, 3), R, rtol=0, atol=1e-8)
    np.testing.assert_allclose(residual[0], expected, rtol=0, atol=1e-8)


def rates(difference, f, h):
    """Derivatives of residual, position and world rotation vector by differences of ``f(t)``."""
    R = f(0.0)[2]
    d = difference(lambda t: np.concatenate([part.ravel() for part in f(t)]), h)
    spin = d[-9:].reshape(3, 3) @ R.T
    return d[:-12], np.array([*d[-12:-9], spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]]) * (
        [1, 1, 1, 0.5, 0.5, 0.5]
    )


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_columns_are_derivatives(difference):
    """On the same grid (no stretch has a whole share of 41 steps), so only the differences' own error is left."""
    problem = three_tubes(integrator=mr.RK45(steps=41), pose_sensitivities=True, direction_count=1)
    row = problem.inputs.numpy().copy()

    def outputs(x, inputs):
        problem.inputs.assign(inputs)
        residual, _ = problem.evaluate(x)
        return residual[0], problem.read("position")[0], problem.read("rotation")[0].reshape(3, 3)

    def check(columns, residual, pose, f, h, name):
        slope, motion = rates(difference, f, h)
        assert np.abs(residual - slope).max() < 1e-8 * max(np.abs(slope).max(), 1e-3), (
            f"residual by {name}: {residual}, not {slope}"
        )
        assert np.abs(pose - motion).max() < 1e-8 * max(np.abs(motion).max(), 1e-3), f"pose by {name}: {pose}, not {motion}"

    _, gamma = problem.evaluate(X[None])
    columns = problem.pose_columns.numpy()[0].copy()
    for k, step in enumerate(np.eye(5)):
        check(columns, gamma[0, :, k], columns[:, k], lambda t, step=step: outputs((X + t * step)[None], row), 0.05, f"x{k}")
    places = [(name, problem.input_slice(name)) for name in LOADS]
    places += [(f"rotation {i + 1}", i) for i in range(3)] + [(f"translation {i + 1}", 3 + i) for i in range(3)]
    for name, place in places:
        direction = np.zeros_like(row)
        direction[0, place] = 1e-3 if name.startswith("translation") else 0.3
        problem.directions.assign(direction[:, None])
        outputs(X[None], row)
        found = problem.residual_directions.numpy()[0, :, 0].copy()
        pose = problem.pose_columns.numpy()[0, :, -1].copy()
        check(columns, found, pose, lambda t, d=direction: outputs(X[None], row + t * d), 0.02, name)


def turned(angle, lanes, scalar):
    """cos and sin of angles, a multiple of the lanes, shape (count, 2)."""
    kit, cosine_and_sine = numbers(lanes, scalar), vectors(lanes, scalar).cosine_and_sine
    row, put = kit.row, kit.put

    @wp.kernel(module="unique", enable_backward=False)
    def turn_all(angle: wp.array(dtype=scalar), out: wp.array(dtype=scalar)):
        t = wp.tid()
        c, s = cosine_and_sine(row(angle, t))
        put(out, 2 * t, c)
        put(out, 2 * t + 1, s)

    given = wp.array(angle, dtype=scalar, device="cpu")
    out = wp.zeros(2 * len(angle), dtype=scalar, device="cpu")
    wp.launch(turn_all, dim=len(angle) // lanes, inputs=[given, out], device="cpu")
    return out.numpy().reshape(-1, 2, lanes).transpose(0, 2, 1).reshape(-1, 2)


@pytest.mark.parametrize("lanes", [1, 4, 8])
def test_cosine_and_sine(lanes):
    """To one unit in the last place of 1, in every quadrant; of huge angles to their own rounding."""
    random = np.random.default_rng(2)
    angle = np.concatenate(
        [
            random.uniform(-10, 10, 4000),
            random.uniform(-1e6, 1e6, 4000),
            random.uniform(1e6, 1e9, 103),
            np.arange(-40, 41) * np.pi / 4,
            [0.0, -0.0, 5e-324, 1e-9, np.nan, np.inf, -np.inf, 1.0],
        ]
    )
    with np.errstate(invalid="ignore"):
        exact = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    error = np.abs(turned(angle, lanes, wp.float64) - exact)
    finite = np.isfinite(angle)
    size = np.abs(angle[finite])
    assert (error[finite] < 2.3e-16 * np.where(size < 1e6, 1, size)[:, None]).all()
    assert np.isnan(error[~finite]).all()


@pytest.mark.parametrize("lanes", [1, 8])
def test_cosine_and_sine_in_single_precision(lanes):
    random = np.random.default_rng(2)
    angle = np.concatenate([random.uniform(-10, 10, 4000), random.uniform(-9e3, 9e3, 4004), [0.0, np.pi / 4, -np.pi / 2, 8e3]])
    angle = angle.astype(np.float32)
    exact = np.stack([np.cos(angle.astype(float)), np.sin(angle.astype(float))], axis=1)
    assert np.abs(turned(angle, lanes, wp.float32) - exact).max() < np.finfo(np.float32).eps


@pytest.mark.parametrize("translation", [-1.0, np.inf, np.nan])
def test_an_iterate_of_no_length_ends_and_writes_no_node(translation, wire):
    """Where translations are unknown an iterate may have any: who writes nodes must not look for the ones past the last."""
    robot = mr.SingleRod(wire)
    options = {"integrator": mr.RK4(10), "pose_sensitivities": True, "direction_count": 1}
    problem = robot.problem(robot.inputs(tip_force=(1, 0, 0)), **options)
    inputs = problem.read("inputs").copy()
    inputs[:, problem.input_slice("translation")] = translation
    problem.write("inputs", inputs)
    problem.evaluate(problem.guess())
    problem.write("unknowns", problem.guess())
    shape = problem.nodes.over(5, unknowns=problem.guess()).read("node_position")
    assert shape.shape == (1, 5, 3)
