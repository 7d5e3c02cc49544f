"""The nonlinear observer of Thamo, Dhaliwal and Khadem (ICRA 2021), for the unknowns of any boundary problem."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg
import warp as wp

from multirod.models.integrators import RK45, Integrator
from multirod.problem import BoundaryProblem
from multirod.solver import Outcome, Solver, Track
from multirod.solvers.observer_kernels import ObserverState, make_observer
from multirod.status import Status
from multirod.validation import FloatArray, array, boolean, choice, positive_float, positive_int, refuse

RICCATI = ("steady", "forward", "horizon")
UPDATES = ("exact", "euler")


@dataclass(frozen=True, kw_only=True)
class Observer(Solver):
    """Theorem 1 of the paper: ``x' = -R Gamma^T P eps``, one integration a sample.

    Along a motion it follows the equilibrium with a lag, its error is reported by the residual. ``solve`` runs it at fixed
    inputs until the residual is within ``tolerance``, the loads raised from zero over the first ``ramp`` samples.
    ``docs/observer.md`` derives all readings and says what was measured.

    Attributes:
        R: Gain, a positive number or a symmetric positive definite matrix (n, n).
        Q: Weight of the Riccati equation, likewise.
        P0: Initial (``"forward"``) or final (``"horizon"``) value of P, likewise.
        integrator: Of the spatial equations.
        riccati: ``"steady"``: the steady state at the present Gamma; ``"forward"``: integrated from ``P0`` in time;
            ``"horizon"``: backward over ``horizon`` from ``P0`` at the present Gamma, as the paper's text has it.
        horizon: [s].
        update: ``"exact"``: the exponential solution over the sample, stable at any gain and sample time; ``"euler"``: the
            paper's explicit step, stable while every closed-loop rate times the sample time is below 2.
        feed_forward: Whether the unknowns also follow the inputs' rates, which removes the lag.
        correct_output: Whether the pose is corrected to first order by its sensitivity.
        fold_threshold: Smallest singular value of Gamma below which the status is ``NEAR_FOLD``.
        tolerance: Largest residual for ``solve``, max norm [1/m].
        max_iterations: Samples allowed for ``solve``.
        ramp: Samples over which ``solve`` raises the loads.
        dt: Sample time for ``solve`` [s].

    Raises:
        ValueError: If a field is out of range, or a matrix is not symmetric positive definite.
    """

    R: Any = 120.0
    Q: Any = 30.0
    P0: Any = 0.5
    integrator: Integrator = field(default_factory=RK45)
    riccati: str = "steady"
    horizon: float = 0.5
    update: str = "exact"
    feed_forward: bool = False
    correct_output: bool = False
    fold_threshold: float = 0.05
    tolerance: float = 1e-9
    max_iterations: int = 5000
    ramp: int = 100
    dt: float = 0.005

    def __post_init__(self) -> None:
        self._check_integrator()
        for name in ("R", "Q", "P0"):
            _definite(f"Observer.{name}", getattr(self, name))
        choice("Observer.riccati", self.riccati, RICCATI)
        choice("Observer.update", self.update, UPDATES)
        for name in ("horizon", "tolerance", "dt", "fold_threshold"):
            positive_float(f"Observer.{name}", getattr(self, name))
        for name in ("feed_forward", "correct_output"):
            boolean(f"Observer.{name}", getattr(self, name))
        positive_int("Observer.max_iterations", self.max_iterations)
        positive_int("Observer.ramp", self.ramp)

    @property
    def pose_sensitivities(self) -> bool:  # type: ignore[override]
        """Whether the problem must carry pose columns."""
        return self.correct_output

    @property
    def direction_count(self) -> int:  # type: ignore[override]
        """Columns along input directions that the problem must carry."""
        return int(self.feed_forward)

    def unsupported(self, problem: BoundaryProblem) -> tuple[str, ...]:
        """Gains whose size is not that of the unknowns."""
        n = problem.unknown_count
        reasons = []
        for name in ("R", "Q", "P0"):
            shape = np.shape(getattr(self, name))
            if shape not in ((), (n, n)):
                reasons.append(f"{name} has shape {shape} but there are {n} unknowns")
        return tuple(reasons)

    def track(self, problem: BoundaryProblem, dt: float) -> "ObserverTrack":
        """Follow a motion, one integration a sample."""
        return ObserverTrack(self, problem, dt)

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        count = problem.instance_count
        track = ObserverTrack(self, problem, self.dt)
        ramp = 1 if guess is not None else self.ramp
        if guess is not None:
            track.start(guess)
        outcome = Outcome.zeros(count)
        active = np.ones(count, dtype=bool)
        for iteration in range(self.max_iterations):
            load = min(1.0, (iteration + 1) / ramp)
            problem.load_factor.fill_(load)
            problem.active.assign(active.astype(np.int32))
            track.step()
            outcome.integrations[active] += 1
            status = track.state.status.numpy()
            done = active & (track.state.size.numpy() <= self.tolerance) & (load == 1.0)
            outcome.status[done] = Status.CONVERGED
            outcome.status[active & (status == Status.NONFINITE)] = Status.NONFINITE
            outcome.status[active & (status == Status.EULER_LIMIT)] = Status.EULER_DIVERGED
            if guess is None:
                outcome.status[active & (status == Status.NEAR_FOLD)] = Status.BRANCH_END
            active = outcome.status == Status.NOT_RUN
            if not active.any():
                break
            if not active.all():
                # what has ended stays where its residual was taken
                track.hold(~active)
        outcome.status[active] = Status.MAX_ITERATIONS
        outcome.iterations[:] = outcome.integrations
        problem.load_factor.fill_(1.0)
        return outcome


class ObserverTrack(Track):
    """The observer on the buffers of one problem; ``state`` holds its arrays."""

    def __init__(self, options: Observer, problem: BoundaryProblem, dt: float) -> None:
        self.options = options
        self.problem = problem
        n, count, device = problem.unknown_count, problem.instance_count, problem.device
        state: Any = ObserverState()
        self.state = state
        for name in ("active", "fault", "unknowns", "residual", "gamma", "residual_directions", "position", "rotation"):
            setattr(state, name, getattr(problem, name))
        state.pose_columns = problem.pose_columns
        state.following = wp.zeros((count, n), dtype=wp.float64, device=device)
        state.status = wp.zeros(count, dtype=wp.int32, device=device)
        state.rates = wp.zeros((count, n), dtype=wp.float64, device=device)
        state.size = wp.zeros(count, dtype=wp.float64, device=device)
        state.singular_value = wp.zeros(count, dtype=wp.float64, device=device)
        R, Q, P0 = (_matrix(value, n) for value in (options.R, options.Q, options.P0))
        root = np.real(scipy.linalg.sqrtm(Q))
        matrices = {"gain": R, "weight": Q, "weight_root": root, "weight_inverse_root": np.linalg.inv(root), "initial": P0}
        for name, value in matrices.items():
            setattr(state, name, wp.array(np.ascontiguousarray(value), dtype=wp.float64, device=device))
        state.riccati = wp.array(np.tile(P0, (count, 1, 1)), dtype=wp.float64, device=device)
        state.dt, state.horizon, state.fold_threshold = dt, options.horizon, options.fold_threshold
        kernel = make_observer(n, options.riccati, options.update == "exact", options.feed_forward, options.correct_output)
        self._launch = wp.launch(kernel, dim=count, inputs=[state], device=device, record_cmd=True)
        self._previous: FloatArray | None = None
        self._change: FloatArray | None = None
        self._ones = np.ones(count, dtype=np.int32)
        self._host: tuple[Any, ...] | None = None
        self._directions: FloatArray | None = None
        if wp.get_device(device).is_cpu:
            self._host = (state.following.numpy(), state.status.numpy(), state.size.numpy(), state.rates.numpy())
            self._directions = problem.directions.numpy()
        self.start(problem.guess())

    def start(self, unknowns: FloatArray) -> None:
        """Take ``unknowns`` as those of the first sample."""
        self.state.following.assign(np.ascontiguousarray(unknowns, dtype=np.float64))

    def step(self) -> Outcome:
        """One sample: integrate at the unknowns that the last sample led to, then update them for the next."""
        problem, state = self.problem, self.state
        if self._host is not None:
            problem.write("unknowns", self._host[0])
        else:
            wp.copy(problem.unknowns, state.following)
        if self.options.feed_forward:
            self._aim()
        problem.integrate()
        self._launch.launch()
        status, size, rates = self._host[1:] if self._host else (state.status.numpy(), state.size.numpy(), state.rates.numpy())
        return Outcome(status.copy(), self._ones, self._ones, size.copy(), rates.copy())

    def hold(self, instances: Any) -> None:
        """Keep the unknowns of some instances (bool, (instance_count,)) as they are in the next sample."""
        following = np.array(self.state.following.numpy())
        following[instances] = self.problem.read("unknowns")[instances]
        self.state.following.assign(following)

    def _aim(self) -> None:
        """Point the problem's direction along the change of the inputs expected by the next sample: the last two, extrapolated."""
        inputs = self.problem.read("inputs")
        if self._previous is not None:
            change = inputs - self._previous
            expected = change if self._change is None else 2 * change - self._change
            self._change = change
            if self._directions is not None:
                self._directions[:, 0] = expected
            else:
                self.problem.directions.assign(expected[:, None])
        self._previous = inputs


def _matrix(value: Any, n: int) -> FloatArray:
    value = np.asarray(value, dtype=np.float64)
    return np.asarray(value * np.eye(n) if value.ndim == 0 else value)


def _definite(name: str, value: Any) -> None:
    matrix = array(name, value, finite=False)
    if matrix.ndim == 0 and not isinstance(value, bool):
        positive_float(name, value)
        return
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not matrix.size or not np.isfinite(matrix).all():
        refuse(name, value, "must be a number > 0 or a symmetric positive definite matrix")
    if np.abs(matrix - matrix.T).max() > 1e-12 * np.abs(matrix).max() or np.linalg.eigvalsh(matrix).min() <= 0:
        refuse(name, value, "must be symmetric positive definite")
