"""The observer of several rods: what each coupling and scaling does, what it guarantees, and how it says that it does not."""

import importlib.util
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg

import multirod as mr
from multirod.problem import Block
from multirod.solvers import observer as observer_module

INTEGRATOR = mr.RK4(20)
DT = 0.005


class Linear(mr.BoundaryProblem):
    """``eps = Gamma x - inputs``: the observer's frozen case, of any size; ``gamma`` may be changed between samples."""

    def __init__(self, gamma: Any, sizes: Any, *, orders: Any = None, directions: int = 0) -> None:
        gammas = np.array(gamma, dtype=float)
        n = gammas.shape[-1]
        ends = np.cumsum(sizes)
        own = [slice(int(end - size), int(end)) for end, size in zip(ends, sizes, strict=True)]
        rows, columns = orders or (own, own)
        blocks = [Block(f"rod {k + 1}", columns[k], rows[k]) for k in range(len(sizes))]
        super().__init__(unknown_count=n, batch_shape=gammas.shape[:-2], input_count=n, blocks=blocks, direction_count=directions)
        self.write("gamma", gammas.reshape(self.instance_count, -1))

    @property
    def matrices(self) -> np.ndarray:
        return self.read("gamma").reshape(self.instance_count, self.unknown_count, self.unknown_count)

    def guess(self) -> np.ndarray:
        return np.zeros((self.instance_count, self.unknown_count))

    def input_slice(self, name: str) -> slice:
        return slice(0, self.unknown_count)

    def _integrate(self) -> None:
        self.write("residual", (self.matrices @ self.read("unknowns")[..., None])[..., 0] - self.read("inputs"))
        if self.direction_count:
            self.residual_directions.assign(-self.directions.numpy().transpose(0, 2, 1))


def step(problem: Linear, start: Any, track: Any) -> np.ndarray:
    """Change of the unknowns over a sample from ``start``."""
    start = np.atleast_2d(np.asarray(start, dtype=float))
    track.start(start)
    track.step()
    return track.state.following.numpy() - start


def propagator(problem: Linear, track: Any) -> np.ndarray:
    """What takes eps from a sample to the next."""
    n = problem.unknown_count
    gamma = problem.matrices[0]
    return np.eye(n) + gamma @ np.array([step(problem, np.linalg.solve(gamma, e), track)[0] for e in np.eye(n)]).T


def definite(generator: np.random.Generator, n: int, size: float) -> np.ndarray:
    A = generator.normal(size=(n, n))
    return size * (np.eye(n) + 0.1 * A @ A.T)


def regular(seed: int, n: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, n)) + 2 * np.eye(n)


def block_lu(gamma: np.ndarray, blocks: list[slice]) -> tuple[np.ndarray, np.ndarray]:
    """Unit lower and upper block-triangular factors, by their definition."""
    n = len(gamma)
    L, U = np.eye(n), gamma.copy()
    for b in blocks[:-1]:
        E = np.eye(n)
        E[b.stop :, b] = -U[b.stop :, b] @ np.linalg.inv(U[b, b])
        U, L = E @ U, L @ np.linalg.inv(E)
    return L, U


def steady(B: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """P > 0 with P B P = Q, by SciPy's solver of Riccati equations."""
    return scipy.linalg.solve_continuous_are(np.zeros_like(B), np.linalg.cholesky(B), Q, np.eye(len(B)))


SIZES = (1, 3, 1)  # as those of tubes: kernels that tests of them need too
BLOCKS = [slice(0, 1), slice(1, 4), slice(4, 5)]


def gains(last: int = SIZES[-1]) -> dict[str, tuple[Any, ...]]:
    generator = np.random.default_rng(3)
    return {
        "R": (100.0, definite(generator, 3, 120.0), definite(generator, last, 80.0)),
        "Q": (definite(generator, 1, 30.0), 20.0, definite(generator, last, 30.0)),
        "P0": (0.5, definite(generator, 3, 0.4), 0.6),
    }


def as_matrix(entry: Any, size: int) -> np.ndarray:
    return np.array(entry) if np.ndim(entry) else entry * np.eye(size)


# ---- one sample at frozen Gamma, against SciPy ----


@pytest.mark.parametrize("in_kernel", [True, False], ids=["kernel", "LAPACK"])
@pytest.mark.parametrize("update", ["exact", "euler"])
@pytest.mark.parametrize("coupling", ["full", "per-rod", "per-rod-plain"])
def test_update_is_theorem_1_on_each_block(coupling: str, update: str, in_kernel: bool, monkeypatch: Any) -> None:
    if not in_kernel:
        monkeypatch.setattr(observer_module, "LARGEST_IN_KERNEL", 0)
    # every block of another size, in one of the two
    last = 2 if update == "exact" else 1
    n, sizes = 4 + last, (1, 3, last)
    gamma, given = regular(0, n), gains(last)
    problem = Linear(gamma, sizes)
    track = mr.Observer(coupling=coupling, update=update, **given).track(problem, DT)
    start = np.random.default_rng(1).normal(size=n)
    move = step(problem, start, track)[0]

    R, Q = (scipy.linalg.block_diag(*(as_matrix(*e) for e in zip(given[name], sizes, strict=True))) for name in ("R", "Q"))
    blocks = [slice(0, n)] if coupling == "full" else [slice(0, 1), slice(1, 4), slice(4, n)]
    L, U = (np.eye(n), gamma) if coupling == "per-rod-plain" else block_lu(gamma, blocks)
    assert np.allclose(L @ U, gamma)
    driving = np.linalg.solve(L, gamma @ start)
    expected = np.zeros(n)
    for b in reversed(blocks):
        G = U[b, b]
        P = steady(G @ R[b, b] @ G.T, Q[b, b])
        e = driving[b]
        if update == "euler":
            expected[b] = -DT * R[b, b] @ G.T @ P @ e
            continue
        if coupling == "per-rod":
            e = e + U[b, b.stop :] @ expected[b.stop :]  # those after it have moved
        expected[b] = np.linalg.solve(G, scipy.linalg.expm(-DT * G @ R[b, b] @ G.T @ P) @ e - e)
    # SciPy's Riccati solver is good to 1e-11
    np.testing.assert_allclose(move, expected, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize(("update", "expected"), [("exact", lambda d: np.exp(-DT * d)), ("euler", lambda d: 1 - DT * d)])
@pytest.mark.parametrize("coupling", ["full", "per-rod"])
def test_predicted_rates_are_observed(coupling: str, update: str, expected: Any) -> None:
    problem = Linear(regular(4, 5), SIZES)
    track = mr.Observer(coupling=coupling, update=update, **gains()).track(problem, DT)
    factors = np.linalg.eigvals(propagator(problem, track))
    # a block-triangular propagator with Theorem 1's own on the diagonal: the blocks' rates are its eigenvalues
    np.testing.assert_allclose(np.sort(factors.real), np.sort(expected(track.state.rates.numpy()[0])), rtol=0, atol=1e-11)
    assert np.abs(factors.imag).max() < 1e-7  # the root of rounding, where two nearly coincide


def test_plain_rates_are_those_of_its_closed_loop() -> None:
    problem, dt = Linear(regular(4, 5), SIZES), 1e-6
    track = mr.Observer(coupling="per-rod-plain", **gains()).track(problem, dt)
    rates = (1 - np.linalg.eigvals(propagator(problem, track)).real) / dt
    # the step is of first order: rate^2 dt, (500/s)^2 1e-6 s, and the cancellation in 1 - factor
    np.testing.assert_allclose(np.sort(rates), np.sort(track.state.rates.numpy()[0]), rtol=0, atol=0.5)


def test_elimination_order_is_that_of_the_blocks_wherever_they_stand() -> None:
    gamma = regular(5, 5)
    rows, columns = np.array([3, 0, 1, 4, 2]), np.array([2, 4, 0, 1, 3])
    straight = Linear(gamma, SIZES)
    mixed = np.zeros((5, 5))
    mixed[np.ix_(rows, columns)] = gamma
    mixed_problem = Linear(mixed, SIZES, orders=([rows[b] for b in BLOCKS], [columns[b] for b in BLOCKS]))
    start = np.random.default_rng(2).normal(size=5)
    mixed_start = np.zeros(5)
    mixed_start[columns] = start
    for in_kernel, coupling in itertools.product((True, False), ("full", "per-rod", "per-rod-plain")):
        solver = mr.Observer(coupling=coupling, **gains())
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(observer_module, "LARGEST_IN_KERNEL", 8 if in_kernel else 0)
            one = step(straight, start, solver.track(straight, DT))[0]
            other = step(mixed_problem, mixed_start, solver.track(mixed_problem, DT))[0]
        np.testing.assert_allclose(other[columns], one, rtol=0, atol=1e-12)


# ---- scaling ----


def test_equilibrated_gains_are_those_of_the_scaled_variables() -> None:
    generator = np.random.default_rng(6)
    gamma = np.diag(10.0 ** generator.uniform(-2, 2, 5)) @ regular(6, 5) @ np.diag(10.0 ** generator.uniform(-2, 2, 5))
    r, c = np.ones(5), np.ones(5)
    for _ in range(5):
        size = np.abs(r[:, None] * gamma * c)
        r, c = r / np.sqrt(size.max(axis=1)), c / np.sqrt(size.max(axis=0))
    problem, start = Linear(gamma, (5,)), generator.normal(size=5)
    scaled = mr.Observer(scaling="equilibrated").track(problem, DT)
    explicit = mr.Observer(R=120 * np.diag(c**2), Q=30 * np.diag(r**2)).track(problem, DT)
    # four decades of units: the kernel's eigenvalues of a Gram matrix lose twice as many digits
    np.testing.assert_allclose(step(problem, start, scaled), step(problem, start, explicit), rtol=1e-5)
    np.testing.assert_allclose(np.sort(scaled.state.rates.numpy()), np.sort(explicit.state.rates.numpy()), rtol=1e-5)
    # entries from 1e-4 to 1e4: five square roots leave (1e4)^(1/32) = 1.33
    largest = np.abs(r[:, None] * gamma * c).max(axis=0)
    assert (largest > 1 / 1.34).all()
    assert (largest < 1.34).all()


@pytest.mark.parametrize("coupling", ["full", "per-rod"])
def test_newton_scaling_gives_every_mode_one_rate_in_any_units(coupling: str) -> None:
    generator = np.random.default_rng(7)
    D, E = (10.0 ** generator.uniform(-2, 2, 5) for _ in range(2))
    gamma, start = regular(7, 5), generator.normal(size=5)
    plain, other = Linear(gamma, SIZES), Linear(D[:, None] * gamma * E, SIZES)
    solver = mr.Observer(scaling="newton", coupling=coupling)
    one, two = solver.track(plain, DT), solver.track(other, DT)
    np.testing.assert_allclose(step(other, start / E, two) * E, step(plain, start, one), rtol=1e-10)
    np.testing.assert_allclose(one.state.rates.numpy(), 60.0)  # sqrt(120 * 30)
    if coupling == "full":
        np.testing.assert_allclose(step(plain, start, one)[0], -(1 - np.exp(-60 * DT)) * start, rtol=1e-12)
        G = np.linalg.inv(gamma)
        explicit = mr.Observer(R=120 * G @ G.T).track(plain, DT)
        np.testing.assert_allclose(step(plain, start, explicit), step(plain, start, one), rtol=1e-9)


# ---- what is proved ----


def turning(t: float) -> np.ndarray:
    """A Gamma that turns by itself, by 2 rad/s on one side and -3 rad/s on the other, and breathes: far from frozen."""
    K = np.array([[0, 1, 0.5], [-1, 0, 0.3], [-0.5, -0.3, 0]])
    stretch = np.diag([3.0, 1.0 + 0.5 * np.sin(5 * t), 0.4])
    return scipy.linalg.expm(2 * K * t) @ stretch @ scipy.linalg.expm(-3 * K * t)


@pytest.mark.parametrize("matrices", [False, True], ids=["numbers", "matrices"])
def test_error_is_bounded_whatever_gamma_does(matrices: bool) -> None:
    """(23): |Q^1/2 eps| decays at the rate of the slowest mode, to the drift over that rate; Gamma is not frozen."""
    generator = np.random.default_rng(8)
    R, Q = (definite(generator, 3, 120.0), definite(generator, 3, 30.0)) if matrices else (120.0 * np.eye(3), 30.0 * np.eye(3))
    dt, drift, steps = 1e-3, np.array([0.5, -1.0, 2.0]), 800
    R_root, Q_root = np.real(scipy.linalg.sqrtm(R)), np.real(scipy.linalg.sqrtm(Q))
    problem = Linear(turning(0.0), (3,))
    track = mr.Observer(R=R, Q=Q).track(problem, dt)
    sizes, rates, slopes = [], [], []
    eps = np.array([1.0, 2.0, -1.0])
    for k in range(steps):
        gamma = turning(k * dt)
        problem.write("gamma", gamma.ravel())
        # eps is kept as the state: it moves by Gamma x' and by its own drift
        x = np.linalg.solve(gamma, eps)
        eps = eps + gamma @ step(problem, x, track)[0] + dt * drift * np.cos(3 * k * dt)
        sizes.append(np.linalg.norm(Q_root @ eps))
        slopes.append(np.linalg.norm(Q_root @ drift) * abs(np.cos(3 * k * dt)))
        rates.append(np.linalg.svd(Q_root @ gamma @ R_root, compute_uv=False)[-1])
        np.testing.assert_allclose(track.state.rates.numpy().min(), rates[-1], rtol=1e-9)
    slowest = min(rates)
    time = dt * (1 + np.arange(steps))
    bound = np.exp(-slowest * time) * np.linalg.norm(Q_root @ [1.0, 2.0, -1.0]) + max(slopes) / slowest
    # the discrete sum exceeds the integral by half a sample of the drift
    assert (np.array(sizes) <= bound * (1 + slowest * dt)).all()
    assert max(sizes[steps // 2 :]) > 0.2 * max(slopes) / slowest  # and it is no empty bound


def test_bound_is_attained() -> None:
    gamma = np.diag([2.0, 0.5])
    problem, dt = Linear(gamma, (2,)), 1e-3
    track = mr.Observer().track(problem, dt)
    for k in range(2000):
        problem.write("inputs", np.array([0.0, -k * dt]))  # eps_t = 1 in the slow mode
        track.step()
    # dt / (1 - exp(-30 dt)): the bound 1/30 and half a sample
    np.testing.assert_allclose(track.state.size.numpy()[0], dt / (1 - np.exp(-30 * dt)), rtol=1e-9)
    assert dt / (1 - np.exp(-30 * dt)) == pytest.approx(1 / 30 + dt / 2, rel=1e-3)


def chained(t: float, speed: float) -> np.ndarray:
    """Gamma = L U of two rods with L turning at ``speed`` and U constant."""
    angle = speed * t
    L, U = np.eye(4), np.diag([1.0, 0.8, 1.2, 0.9])
    L[2:, :2] = 1.5 * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    U[:2, 2:] = [[0.3, 0.2], [-0.1, 0.4]]
    return L @ U


@pytest.mark.parametrize("speed", [1.0, 10.0, 30.0])
def test_elimination_is_bounded_by_how_fast_its_factors_change(speed: float) -> None:
    """(25): full coupling has no such condition."""
    dt, steps, halves = 5e-4, 1200, [slice(0, 2), slice(2, 4)]
    _, U = block_lu(chained(0.0, speed), halves)
    # eps~' = -T eps~ at frozen Gamma: Theorem 1 on the diagonal, and what the second rod does to the first
    T = np.zeros((4, 4))
    for b in halves:
        T[b, b] = 60.0 * scipy.linalg.polar(U[b, b], side="left")[1]
    T[:2, 2:] = 60.0 * U[:2, 2:] @ scipy.linalg.polar(U[2:, 2:])[0].T
    W = scipy.linalg.solve_continuous_lyapunov(T.T, 2 * np.eye(4))
    root = np.real(scipy.linalg.sqrtm(W))
    decay = 1 / np.linalg.eigvalsh(W).max()
    problem = Linear(chained(0.0, speed), (2, 2))
    track = mr.Observer(coupling="per-rod").track(problem, dt)
    eps, sizes, changes = np.array([1.0, -2.0, 0.5, 1.0]), [], []
    for k in range(steps):
        gamma = chained(k * dt, speed)
        problem.write("gamma", gamma.ravel())
        L, after = (block_lu(chained(t, speed), halves)[0] for t in (k * dt, (k + 1) * dt))
        changes.append(np.linalg.norm(root @ np.linalg.solve(L, (after - L) / dt) @ np.linalg.inv(root), 2))
        sizes.append(np.linalg.norm(root @ np.linalg.solve(L, eps)))
        eps = eps + gamma @ step(problem, np.linalg.solve(gamma, eps), track)[0]
    bound = sizes[0] * np.exp(-(decay - max(changes)) * dt * np.arange(steps))
    # continuous time: the update differs by half a sample of the fastest rate, 72/s, which is 2 %
    assert (np.array(sizes) <= 1.02 * bound).all()
    assert (max(changes) < decay) == (speed < 30)
    assert sizes[-1] < 1e-9 * sizes[0]


# ---- concentric tubes ----


def tube(k: int, length: float, curved: float, curvature: Any) -> mr.Rod:
    return mr.Rod.tube(
        length=length,
        outer_diameter=(0.8e-3, 1.2e-3, 1.8e-3)[k],
        inner_diameter=(0.4e-3, 0.9e-3, 1.3e-3)[k],
        young_modulus=60e9,
        shear_modulus=23e9,
        precurvature=[(length - curved, (0, 0, 0)), (curved, curvature)],
    )


@pytest.fixture(scope="module")
def tubes() -> mr.ConcentricTubes:
    return mr.ConcentricTubes([tube(0, 0.4, 0.15, (9, 0, 0)), tube(1, 0.3, 0.1, (6, 1, 0)), tube(2, 0.2, 0.08, (4, 2, 0))])


@pytest.fixture(scope="module")
def strong() -> mr.ConcentricTubes:
    """Two tubes on a motion that no equilibrium leaves, though each tube's own Gamma_ii changes sign."""
    shared = {"young_modulus": 60e9, "shear_modulus": 23e9}
    inner = mr.Rod.tube(
        length=0.3, outer_diameter=1.0e-3, inner_diameter=0.6e-3, precurvature=[(0.1, (0, 0, 0)), (0.2, (14, 0, 0))], **shared
    )
    outer = mr.Rod.tube(
        length=0.2, outer_diameter=1.6e-3, inner_diameter=1.1e-3, precurvature=[(0.1, (0, 0, 0)), (0.1, (12, 0, 0))], **shared
    )
    return mr.ConcentricTubes([inner, outer])


TIME = DT * np.arange(600)


def motion(robot: mr.ConcentricTubes, force: float, bases: Any) -> mr.Inputs:
    """Tubes that turn against each other and slide, under a force that turns."""
    w = 2 * np.pi / 10 * TIME[:, None]
    turn = np.array([1.0, -0.5, -1.0])[: len(bases)]
    loads = force * np.concatenate([np.sin(w), np.cos(w), np.sin(w)], axis=1)
    return robot.inputs(
        rotation=w * turn, translation=np.array(bases) + 0.005 * np.sin(w + np.arange(len(bases))), tip_force=loads
    )


def run(robot: mr.ConcentricTubes, inputs: mr.Inputs, **options: Any) -> mr.History:
    return mr.simulate(robot, inputs, time=TIME, solver=mr.Observer(integrator=INTEGRATOR, **options))


def error(history: mr.History) -> np.ndarray:
    return np.linalg.norm(history.boundary_residual, axis=-1)


def test_tubes_name_one_block_each_outermost_first(tubes: mr.ConcentricTubes) -> None:
    unloaded = tubes.problem(tubes.inputs(), integrator=mr.RK45())
    torques = [("tube 3", slice(1, 2), 2), ("tube 2", slice(0, 1), 1)]
    assert unloaded.blocks == tuple(Block(name, place, place, rod) for name, place, rod in torques)
    problem = tubes.problem(tubes.inputs(tip_force=(0.1, 0, 0)), integrator=mr.RK45())
    own = [("tube 3", slice(4, 5), 2), ("tube 2", slice(3, 4), 1), ("tube 1", slice(0, 3), 0)]
    assert problem.blocks == tuple(Block(name, place, place, rod) for name, place, rod in own)
    follower = tubes.problem(tubes.inputs(follower_force=(0.1, 0, 0)), integrator=mr.RK45())
    assert follower.blocks == (*problem.blocks, Block("base force", slice(5, 8), slice(5, 8)))
    single = mr.SingleRod(tubes.rods[0])
    assert single.problem(single.inputs(), integrator=mr.RK45()).blocks == (Block("rod 1", slice(0, 3), slice(0, 3), 0),)


def test_order_of_the_tubes_keeps_the_pivots_regular(strong: mr.ConcentricTubes) -> None:
    inputs = motion(strong, 0.2, (-0.1, -0.06))
    gammas = mr.simulate(strong, inputs, time=TIME, solver=mr.Shooting(integrator=INTEGRATOR)).raise_if_failed().gamma[::10]
    smallest = {}
    for name, order in {"torque first": [3, 0, 1, 2], "bending first": [0, 1, 2, 3]}.items():
        first = 1 if name == "torque first" else 3
        halves = [slice(0, first), slice(first, 4)]
        pivots = [block_lu(gamma[np.ix_(order, order)], halves)[1] for gamma in gammas]
        smallest[name] = min(np.linalg.svd(U[b, b], compute_uv=False)[-1] for U in pivots for b in halves)
    assert smallest["torque first"] > 0.5
    assert smallest["bending first"] < 0.05


@pytest.mark.parametrize("options", [{}, {"riccati": "forward", "update": "euler", "P0": 0.2}, {"scaling": "newton"}])
def test_one_rod_is_the_same_in_every_coupling(wire: mr.Rod, options: dict[str, Any]) -> None:
    robot = mr.SingleRod(wire)
    inputs = robot.inputs(tip_force=np.stack([0.5 * np.sin(TIME), np.cos(TIME), 0.3 + 0 * TIME], axis=-1)[:50])
    found = [
        mr.simulate(robot, inputs, time=TIME[:50], solver=mr.Observer(integrator=INTEGRATOR, coupling=coupling, **options))
        for coupling in ("full", "per-rod", "per-rod-plain")
    ]
    for other in found[1:]:
        for name in ("unknowns", "tip_position", "rates", "status"):
            np.testing.assert_array_equal(getattr(other, name), getattr(found[0], name))


@pytest.mark.parametrize("coupling", ["full", "per-rod"])
def test_three_tubes_are_followed_from_the_unloaded_guess(tubes: mr.ConcentricTubes, coupling: str) -> None:
    inputs = motion(tubes, 0.1, (-0.1, -0.05, -0.02))
    plain, aided = (run(tubes, inputs, coupling=coupling, feed_forward=aid) for aid in (False, True))
    late = TIME >= 0.5
    for history in (plain, aided):
        assert (history.integrations == 1).all()
        assert error(history)[0] > 5
        assert np.isfinite(history.unknowns).all()
    assert error(plain)[late].max() < 0.5  # 0.03 of where it starts
    # measured: 330 (full) and 640 (per rod) times
    assert error(plain)[late].mean() > 50 * error(aided)[late].mean()
    assert error(aided)[late].max() < 0.01


def test_feed_forward_and_scaling_reach_the_truth(tubes: mr.ConcentricTubes) -> None:
    inputs = motion(tubes, 0.1, (-0.1, -0.05, -0.02))
    truth = mr.simulate(tubes, inputs, time=TIME, solver=mr.Shooting(integrator=INTEGRATOR)).raise_if_failed()
    late = TIME >= 0.5
    for coupling, scaling in itertools.product(("full", "per-rod"), ("none", "newton")):
        history = run(tubes, inputs, coupling=coupling, scaling=scaling, feed_forward=True)
        distance = np.linalg.norm(history.tip_position - truth.tip_position, axis=-1)[late]
        # residuals of 0.001 1/m over singular values from 0.02 up, times half a length squared of 0.08 m^2
        assert distance.max() < 1e-3
        assert distance.mean() < 1e-4


READINGS = [
    {},
    {"update": "euler", "R": 1.2, "Q": 0.3},
    {"riccati": "forward"},
    {"riccati": "forward", "update": "euler", "R": 1.2, "Q": 0.3, "P0": 0.05},
    {"riccati": "horizon"},
    {"feed_forward": True, "correct_output": True},
    {"scaling": "equilibrated"},
    {"scaling": "newton", "feed_forward": True},
]


@pytest.mark.parametrize(
    ("coupling", "options"),
    [*(("per-rod", options) for options in READINGS), *(("full", options) for options in READINGS[::3])],
    ids=repr,
)
def test_lapack_does_what_the_kernel_does(
    tubes: mr.ConcentricTubes, coupling: str, options: dict[str, Any], monkeypatch: Any
) -> None:
    inputs = motion(tubes, 0.1, (-0.1, -0.05, -0.02))[:40]
    solver = mr.Observer(integrator=INTEGRATOR, coupling=coupling, **options)
    one = mr.simulate(tubes, inputs, time=TIME[:40], solver=solver)
    monkeypatch.setattr(observer_module, "LARGEST_IN_KERNEL", 0)
    other = mr.simulate(tubes, inputs, time=TIME[:40], solver=solver)
    # eigenvalues of Gram matrices (kernel) against singular values (LAPACK): 1e-14, carried over 40 samples
    for name in ("unknowns", "tip_position", "tip_rotation", "residual"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=0, atol=1e-11)
    np.testing.assert_allclose(np.sort(other.rates), np.sort(one.rates), rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(other.status, one.status)


OF_ONE = (observer_module.LARGEST_IN_KERNEL,)
OF_ALL = tuple(range(1, observer_module.LARGEST_IN_KERNEL + 1))  # blocks of every size that a kernel takes, in one kernel


@pytest.mark.parametrize(
    ("sizes", "options"),
    [*((OF_ALL, options | {"correct_output": False}) for options in READINGS), (OF_ONE, {})],
    ids=repr,
)
def test_lapack_does_what_the_kernel_does_at_every_size(
    sizes: tuple[int, ...], options: dict[str, Any], monkeypatch: Any
) -> None:
    generator, n = np.random.default_rng(20), sum(sizes)
    # a general and a symmetric Gamma, all pivots with singular values from 0.7 to 3.6
    part = generator.normal(size=(n, n)) / np.sqrt(n)
    gammas = 2 * np.eye(n) + np.array([part, (part + part.T) / 2])
    start, drift = generator.normal(size=(2, n)), generator.normal(size=(2, n))
    solver = mr.Observer(coupling="per-rod", **options)
    names = ("following", "rates", "pivot", "riccati", "singular_value", "size", "status")
    found = []
    for largest in (observer_module.LARGEST_IN_KERNEL, 0):
        monkeypatch.setattr(observer_module, "LARGEST_IN_KERNEL", largest)
        problem = Linear(gammas, sizes, directions=solver.direction_count)
        track = solver.track(problem, DT)
        track.start(start)
        samples: dict[str, list[np.ndarray]] = {name: [] for name in names}
        for k in range(5):
            problem.write("inputs", DT * k * drift)
            track.step()
            for name in names:
                samples[name].append(getattr(track.state, name).numpy().copy())
        found.append({name: np.array(values) for name, values in samples.items()})
    kernel, lapack = found
    for values in found:
        # each in an order of its own
        values["rates"] = np.concatenate(
            [np.sort(rates, axis=-1) for rates in np.split(values["rates"], np.cumsum(sizes)[:-1], axis=-1)], axis=-1
        )
    np.testing.assert_array_equal(kernel.pop("status"), mr.Status.TRACKING)
    np.testing.assert_array_equal(lapack.pop("status"), mr.Status.TRACKING)
    for name in kernel:
        # the kernel takes eigenvalues of Gram matrices: rounding times (3.6 / 0.7)^2, eight terms a sum, five samples: 2e-13
        np.testing.assert_allclose(lapack[name], kernel[name], rtol=1e-12, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("coupling", ["full", "per-rod"])
def test_static_solve_finds_the_equilibrium(tubes: mr.ConcentricTubes, coupling: str) -> None:
    inputs = motion(tubes, 0.1, (-0.1, -0.05, -0.02))[[0, 100, 300]]
    truth = mr.solve(tubes, inputs, solver=mr.Shooting(integrator=INTEGRATOR)).raise_if_failed()
    solver = mr.Observer(integrator=INTEGRATOR, coupling=coupling, scaling="newton", fold_threshold=1e-3)
    found = mr.solve(tubes, inputs, solver=solver).raise_if_failed()
    np.testing.assert_allclose(found.unknowns, truth.unknowns, rtol=0, atol=1e-6)  # 1e-9 over singular values of 0.003


# ---- where a coupling does not work, and says so ----


def test_plain_gains_that_are_unstable_are_announced(strong: mr.ConcentricTubes) -> None:
    inputs = motion(strong, 0.2, (-0.1, -0.06))
    found = {coupling: run(strong, inputs, coupling=coupling) for coupling in ("full", "per-rod", "per-rod-plain")}
    late = TIME >= 0.5
    for coupling in ("full", "per-rod"):
        assert np.isin(found[coupling].status, (mr.Status.TRACKING, mr.Status.NEAR_FOLD)).all()
        assert error(found[coupling])[late].max() < 0.5
    plain = found["per-rod-plain"]
    unstable = plain.status == mr.Status.UNSTABLE_COUPLING
    assert unstable.mean() > 0.3
    assert error(plain)[late].max() > 20 * error(found["full"])[late].max()
    # in continuous time or, where every rate is positive, over the sample
    np.testing.assert_array_equal(unstable | (plain.rates.min(axis=1) > 0), True)


@pytest.mark.parametrize("update", ["exact", "euler"])
def test_plain_stability_is_in_the_right_half_plane(update: str) -> None:
    for off, stable in ((0.9, True), (1.1, False)):
        problem = Linear([[1.0, off], [off, 1.0]], (1, 1))  # eigenvalues 1 +- off
        track = mr.Observer(coupling="per-rod-plain", update=update).track(problem, DT)
        track.start(np.array([[1.0, -1.0]]))
        for _ in range(200):
            track.step()
        expected = mr.Status.TRACKING if stable else mr.Status.UNSTABLE_COUPLING
        assert track.state.status.numpy()[0] == expected
        np.testing.assert_allclose(np.sort(track.state.rates.numpy()[0]), [60 * (1 - off), 60 * (1 + off)], rtol=1e-12)
        assert (track.state.size.numpy()[0] < 0.1) == stable


@pytest.mark.parametrize("in_kernel", [True, False], ids=["kernel", "LAPACK"])
def test_singular_pivots_and_folds_are_told_apart(in_kernel: bool, monkeypatch: Any) -> None:
    if not in_kernel:
        monkeypatch.setattr(observer_module, "LARGEST_IN_KERNEL", 0)
    cases = {
        "regular": ([[1.0, 1.0], [0.0, 1.0]], mr.Status.TRACKING),
        "singular pivot": ([[0.0, 1.0], [1.0, 0.0]], mr.Status.SINGULAR_PIVOT),
        "nearly": ([[0.01, 1.0], [1.0, 0.0]], mr.Status.SINGULAR_PIVOT),
        "fold": ([[1.0, 1.0], [1.0, 1.01]], mr.Status.NEAR_FOLD),
        "at the fold": ([[1.0, 1.0], [1.0, 1.0]], mr.Status.NEAR_FOLD),
    }
    problem = Linear([gamma for gamma, _ in cases.values()], (1, 1))
    track = mr.Observer(coupling="per-rod").track(problem, DT)
    move = step(problem, np.ones((len(cases), 2)), track)
    assert [mr.Status(s) for s in track.state.status.numpy()] == [status for _, status in cases.values()]
    assert [bool(m.any()) for m in move] == [True, False, True, True, True]  # held where elimination cannot go on
    smallest = [np.linalg.svd(gamma, compute_uv=False)[-1] for gamma, _ in cases.values()]
    reported = track.state.singular_value.numpy()
    for k in (0, 2, 3):  # the Frobenius norm of the inverse: sigma_min by a factor between 1 and the root of two
        assert smallest[k] / np.sqrt(2) - 1e-12 <= reported[k] <= smallest[k] + 1e-12
    full = mr.Observer().track(problem, DT)
    step(problem, np.ones((len(cases), 2)), full)
    assert [mr.Status(s).name for s in full.state.status.numpy()] == ["TRACKING"] * 3 + ["NEAR_FOLD"] * 2


def test_new_statuses_are_appended_and_hold_an_estimate() -> None:
    assert (int(mr.Status.SINGULAR_PIVOT), int(mr.Status.UNSTABLE_COUPLING)) == (13, 14)
    for status in (mr.Status.SINGULAR_PIVOT, mr.Status.UNSTABLE_COUPLING):
        assert not status.failed
        assert "coupling='full'" in status.message or "'full'" in status.message


def test_example_shows_where_each_coupling_works() -> None:
    path = Path(__file__).parent.parent / "examples" / "couplings.py"
    spec = importlib.util.spec_from_file_location("couplings", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    errors = module.main(["--time", "1.5"])
    assert len(errors) == 4
    for found in errors.values():
        assert found["per-rod"] < 1.6 * found["full"]  # 0.96 to 1.44 times
        assert found["full, ff"] < found["full"] / 50
        assert found["per-rod, ff"] < found["per-rod"] / 50
    assert errors["14, 12 1/m, 0.2 N"]["plain"] > 10 * errors["14, 12 1/m, 0.2 N"]["full"]


# ---- many unknowns ----


def arrow(legs: int) -> tuple[np.ndarray, tuple[int, ...]]:
    """Gamma of rods that touch nothing but a platform, which comes last."""
    generator = np.random.default_rng(9)
    n = 6 * legs + 6
    gamma = np.zeros((n, n))
    for k in range(legs + 1):
        b = slice(6 * k, 6 * k + 6)
        gamma[b, b] = 0.3 * generator.normal(size=(6, 6)) + 2 * np.eye(6)
        if k < legs:
            gamma[b, -6:] = 0.3 * generator.normal(size=(6, 6))
            gamma[-6:, b] = 0.3 * generator.normal(size=(6, 6))
    return gamma, (6,) * (legs + 1)


@pytest.mark.parametrize("coupling", ["full", "per-rod"])
def test_six_legs_converge_at_the_predicted_rates(coupling: str) -> None:
    gamma, sizes = arrow(6)
    problem = Linear(gamma, sizes)
    track = mr.Observer(coupling=coupling).track(problem, DT)
    if coupling == "full":
        expected = 60 * np.linalg.svd(gamma, compute_uv=False)
    else:
        blocks = [slice(6 * k, 6 * k + 6) for k in range(7)]
        U = block_lu(gamma, blocks)[1]
        expected = 60 * np.concatenate([np.linalg.svd(U[b, b], compute_uv=False) for b in blocks])
        assert track.state.inverse.shape == (1, 42, 6)  # nothing larger than a block is factored
    start = np.random.default_rng(10).normal(size=42)
    np.testing.assert_allclose(np.linalg.eigvals(propagator(problem, track)).real.max(), np.exp(-DT * expected.min()), rtol=1e-6)
    np.testing.assert_allclose(np.sort(track.state.rates.numpy()[0]), np.sort(expected), rtol=1e-9)
    track.start(start[None])
    for _ in range(200):
        track.step()
    assert track.state.size.numpy()[0] < 10 * 42 * np.exp(-200 * DT * expected.min()) + 1e-12


# ---- gains ----


def test_gains_by_block_are_a_block_diagonal_matrix_in_full_coupling() -> None:
    gamma, given = regular(11, 5), gains()
    problem, start = Linear(gamma, SIZES), np.ones(5)
    whole = {
        name: scipy.linalg.block_diag(*(as_matrix(*e) for e in zip(value, SIZES, strict=True))) for name, value in given.items()
    }
    one = step(problem, start, mr.Observer(**given).track(problem, DT))
    np.testing.assert_array_equal(one, step(problem, start, mr.Observer(**whole).track(problem, DT)))


def test_each_rod_has_its_own_rate() -> None:
    problem = Linear(regular(12, 5), SIZES)
    base = mr.Observer(coupling="per-rod").track(problem, DT)
    faster = mr.Observer(coupling="per-rod", R=(120.0, 480.0, 120.0)).track(problem, DT)
    for track in (base, faster):
        step(problem, np.ones(5), track)
    ratio = faster.state.rates.numpy()[0] / base.state.rates.numpy()[0]
    np.testing.assert_allclose(ratio, [1, 2, 2, 2, 1], rtol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"R": (1.0, 2.0)}, r"R has 2 entries but there are 3 blocks \(rod 1, rod 2, rod 3\)"),
        ({"Q": (1.0, np.eye(2), 1.0)}, r"Q\[1\] has shape \(2, 2\) but rod 2 has 3 unknowns"),
        ({"P0": np.eye(5), "coupling": "per-rod"}, "P0 is one matrix, which couples the rods: give a tuple"),
        ({"coupling": "per-rod-plain", "feed_forward": True}, "feed_forward needs what couples the rods"),
        ({"coupling": "per-rod-plain", "correct_output": True}, "correct_output needs what couples the rods"),
    ],
)
def test_what_does_not_fit_the_blocks_is_refused(options: dict[str, Any], message: str) -> None:
    problem = Linear(regular(0, 5), SIZES)
    with pytest.raises(ValueError, match=f"Observer cannot take this problem: {message}"):
        mr.Observer(**options).solve(problem)


def test_blocks_that_are_no_blocks_are_refused() -> None:
    skewed = Linear(regular(0, 5), SIZES, orders=([slice(0, 2), slice(2, 4), slice(4, 5)], BLOCKS))
    with pytest.raises(ValueError, match="rod 1 has 1 unknowns but 2 residuals; rod 2 has 3 unknowns but 2 residuals"):
        mr.Observer(coupling="per-rod").solve(skewed)
    partial = Linear(regular(0, 5), SIZES, orders=(BLOCKS, [slice(0, 1), slice(1, 4), slice(3, 4)]))
    with pytest.raises(ValueError, match="the blocks do not share out the 5 unknowns"):
        mr.Observer(coupling="per-rod").solve(partial)
    assert step(partial, np.ones(5), mr.Observer().track(partial, DT)).any()  # full coupling needs no blocks


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"coupling": "diagonal"}, r"Observer\.coupling = 'diagonal' is not allowed: must be one of 'full', 'per-rod'"),
        ({"scaling": "auto"}, r"Observer\.scaling = 'auto' is not allowed: must be one of 'none', 'equilibrated', 'newton'"),
        ({"R": (1.0, -1.0)}, r"Observer\.R\[1\] = -1\.0 is not allowed: must be finite and > 0"),
        ({"Q": (np.diag([1.0, -1.0]),)}, r"Observer\.Q\[0\] = (.|\n)* must be symmetric positive definite"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        mr.Observer(**options)
