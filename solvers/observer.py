"""The nonlinear observer of Thamo, Dhaliwal and Khadem (ICRA 2021), for the unknowns of any boundary problem."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar, Literal, TypeAlias, get_args

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.integrators import RK45, Integrator
from multirod.kernels.warp_types import Struct
from multirod.launch import Launch, record
from multirod.naming import OPTIONS_NAMED, fields_hinted
from multirod.problem import Block, BoundaryProblem
from multirod.solver import Outcome, Solver
from multirod.solvers.tracking.observer_kernels import ObserverState, make_observer
from multirod.solvers.tracking.observer_lapack import LargeSample
from multirod.solvers.tracking.sampled import SampledTrack
from multirod.types import Numbers
from multirod.validation import FloatArray, array, boolean, choice, positive_float, positive_int, refuse

Riccati: TypeAlias = Literal["steady", "forward", "horizon"]
Update: TypeAlias = Literal["exact", "euler"]
Coupling: TypeAlias = Literal["full", "per-rod", "per-rod-plain"]
Scaling: TypeAlias = Literal["none", "equilibrated", "newton"]
RICCATI: tuple[Riccati, ...] = get_args(Riccati)
UPDATES: tuple[Update, ...] = get_args(Update)
COUPLINGS: tuple[Coupling, ...] = get_args(Coupling)
SCALINGS: tuple[Scaling, ...] = get_args(Scaling)
SPACES = {"R": "unknowns", "Q": "residuals", "P0": "residuals"}
LARGEST_IN_KERNEL = 8  # unknowns of a block; a larger one takes longer to compile than LAPACK takes in thousands of samples


@fields_hinted(OPTIONS_NAMED)
@dataclass(frozen=True, kw_only=True)
class Observer(Solver):
    """Theorem 1 of the paper: ``x' = -R Gamma^T P eps``, one integration of each rod a sample.

    Along a motion it follows the equilibrium with a lag, its error is reported by the residual. ``solve`` runs it at fixed
    inputs until the residual is within ``tolerance``, the loads raised from zero over the first ``ramp`` samples.
    ``docs/observer.md`` derives all readings, couplings and scalings, and says what was measured.

    Attributes:
        R: Gain: a positive number, a symmetric positive definite matrix (n, n), or a tuple with a number or a matrix for
            each block of the problem, in the order of ``problem.blocks``.
        Q: Weight of the Riccati equation, likewise.
        P0: Initial (``"forward"``) or final (``"horizon"``) value of P, likewise.
        integrator: Of the spatial equations.
        coupling: ``"full"``: one P for all unknowns; ``"per-rod"``: a P for each block after elimination, as stable as
            ``"full"`` at frozen Gamma where the pivots are regular; ``"per-rod-plain"``: a P for each block, which sees its
            own part of Gamma only and can be unstable.
        scaling: The variables in which R, Q and P0 are meant. ``"none"``: those of the problem; ``"equilibrated"``: those in
            which the largest entry of each row and column of Gamma is 1; ``"newton"``: those in which Gamma is the identity, so
            that all modes decay at the same rate, sqrt(R Q). None is ``"none"``, and ``"newton"`` of networks and where tips are
            held, as of legs on a platform.
        riccati: ``"steady"``: the steady state at the present Gamma; ``"forward"``: integrated from ``P0`` in time;
            ``"horizon"``: backward over ``horizon`` from ``P0`` at the present Gamma, as the paper's text has it.
        horizon: [s].
        update: ``"exact"``: the exponential solution over the sample, stable at any gain and sample time; ``"euler"``: the
            paper's explicit step, stable while every closed-loop rate times the sample time is below 2.
        feed_forward: Whether the unknowns also follow the inputs' rates, which removes the lag.
        correct_output: Whether the pose is corrected to first order by its sensitivity.
        fold_threshold: Smallest singular value of the scaled Gamma (of Gamma for ``"newton"``) below which the status is
            ``NEAR_FOLD``, and of a pivot below which it is ``SINGULAR_PIVOT``; in units of what is natural to the problem, 1
            but for parallel rods, whose Gamma has small singular values where nothing is near a fold. Of networks, but
            equilibrated, it is the smallest eigenvalue by size of Gamma times the inverse of what it is unloaded, (26).
        tolerance: Largest residual for ``solve``, max norm [1/m]; None is that of ``Shooting``.
        max_iterations: Samples allowed for ``solve``.
        ramp: Samples over which ``solve`` raises the loads.
        dt: Sample time for ``solve`` [s].

    Raises:
        ValueError: If a field is out of range, or a matrix is not symmetric positive definite.
    """

    needs_dt: ClassVar[bool] = True
    takes_uneven: ClassVar[bool] = True

    R: Numbers = 120.0
    Q: Numbers = 30.0
    P0: Numbers = 0.5
    integrator: Integrator = field(default_factory=RK45)
    coupling: Coupling = "full"
    scaling: Scaling | None = None
    riccati: Riccati = "steady"
    horizon: float = 0.5
    update: Update = "exact"
    feed_forward: bool = False
    correct_output: bool = False
    fold_threshold: float = 0.05
    tolerance: float | None = None
    max_iterations: int = 5000
    ramp: int = 100
    dt: float = 0.005

    def __post_init__(self) -> None:
        self._check_integrator()
        for name in ("R", "Q", "P0"):
            value = getattr(self, name)
            if isinstance(value, tuple):
                value = tuple(_definite(f"Observer.{name}[{k}]", part) for k, part in enumerate(value))
            else:
                value = _definite(f"Observer.{name}", value)
            object.__setattr__(self, name, value)
        choice("Observer.coupling", self.coupling, COUPLINGS)
        if self.scaling is not None:
            choice("Observer.scaling", self.scaling, SCALINGS)
        choice("Observer.riccati", self.riccati, RICCATI)
        choice("Observer.update", self.update, UPDATES)
        self._check_tolerance()
        for name in ("horizon", "dt", "fold_threshold"):
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
        """Gains whose size is not that of the unknowns or blocks, and blocks that cannot be told apart."""
        n, blocks = problem.unknown_count, problem.blocks
        reasons = []
        for name in ("R", "Q", "P0"):
            value = getattr(self, name)
            if isinstance(value, tuple):
                if len(value) != len(blocks):
                    names = ", ".join(block.name for block in blocks)
                    reasons.append(f"{name} has {len(value)} entries but there are {len(blocks)} blocks ({names})")
                    continue
                for k, (part, block) in enumerate(zip(value, blocks, strict=True)):
                    size = len(_places(n, [block], "unknowns"))
                    if np.shape(part) not in ((), (size, size)):
                        reasons.append(f"{name}[{k}] has shape {np.shape(part)} but {block.name} has {size} unknowns")
            elif np.shape(value) not in ((), (n, n)):
                reasons.append(f"{name} has shape {np.shape(value)} but there are {n} unknowns")
            elif np.ndim(value) and self.coupling != "full" and len(blocks) > 1:
                reasons.append(f"{name} is one matrix, which couples the rods: give a tuple with one for each block")
        if self.coupling != "full" or any(isinstance(value, tuple) for value in (self.R, self.Q, self.P0)):
            for block in blocks:
                unknowns, residuals = (len(_places(n, [block], what)) for what in ("unknowns", "residuals"))
                if unknowns != residuals:
                    reasons.append(f"{block.name} has {unknowns} unknowns but {residuals} residuals")
            for what in ("unknowns", "residuals"):
                if sorted(_places(n, blocks, what).tolist()) != list(range(n)):
                    reasons.append(f"the blocks do not share out the {n} {what}")
        if self.coupling == "per-rod-plain" and len(blocks) > 1:
            for name in ("feed_forward", "correct_output"):
                if getattr(self, name):
                    reasons.append(f"{name} needs what couples the rods, which coupling='per-rod-plain' leaves out")
        return tuple(reasons)

    def track(self, problem: BoundaryProblem, dt: float) -> "ObserverTrack":
        """Follow a motion, one integration a sample."""
        return ObserverTrack(self, problem, dt)

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        track = ObserverTrack(self, problem, self.dt)
        return track.settle(tolerance=self.tolerance, max_iterations=self.max_iterations, ramp=self.ramp, guess=guess)


class ObserverTrack(SampledTrack):
    """The observer on the buffers of one problem; ``state`` holds its arrays."""

    def __init__(self, options: Observer, problem: BoundaryProblem, dt: float) -> None:
        natural = problem.natural_gamma
        if options.scaling is None:  # rods whose tips are held are stiff along themselves: singular values are decades apart
            spread = natural is not None or len(problem.held_forces) > 0
            options = replace(options, scaling="newton" if spread else "none")
        self.options = options
        self.problem = problem
        n, count, device = problem.unknown_count, problem.instance_count, problem.device
        blocks: Sequence[Block] = problem.blocks
        gains = {}
        for name, what in SPACES.items():
            gains[name] = _matrix(getattr(options, name), [_places(n, [block], what) for block in blocks], n)
        if options.coupling == "full":
            blocks = (Block("all", slice(0, n), slice(0, n)),)
        for name, what in SPACES.items():
            order = _places(n, blocks, what)
            gains[name] = gains[name][np.ix_(order, order)]
        sizes = [len(_places(n, [block], "unknowns")) for block in blocks]
        first = problem.guess()
        state: Struct = ObserverState()
        self.state = state
        problem.share(state, ("active", "fault", "unknowns", "residual", "gamma", "residual_directions"))
        problem.share(state, ("position", "rotation", "pose_columns"))
        for name in ("following", "rates", "driving", "move", "vector", "scratch"):
            setattr(state, name, wp.zeros((count, n), dtype=wp.float64, device=device))
        for name in ("row_scale", "column_scale"):
            setattr(state, name, wp.ones((count, n), dtype=wp.float64, device=device))
        for name in ("size", "singular_value"):
            setattr(state, name, wp.zeros(count, dtype=wp.float64, device=device))
        fold = options.fold_threshold * problem.natural_singular_value
        state.fold_threshold = wp.array(fold, dtype=wp.float64, device=device)
        state.dt = wp.array([dt], dtype=wp.float64, device=device)
        state.status = wp.zeros(count, dtype=wp.int32, device=device)
        state.pivot = wp.zeros((count, len(blocks)), dtype=wp.float64, device=device)
        state.riccati = wp.array(np.tile(gains["P0"], (count, 1, 1)), dtype=wp.float64, device=device)
        self._large: LargeSample | None = None
        if max(sizes) > LARGEST_IN_KERNEL or (options.coupling == "per-rod-plain" and len(blocks) > 1):
            self._large = LargeSample(
                rows=_places(n, blocks, "residuals"),
                columns=_places(n, blocks, "unknowns"),
                sizes=sizes,
                gains=gains,
                options=options,
                dt=dt,
                natural=natural,
            )
        else:
            self._launch = self._record(blocks, sizes, gains)
        self._host_rates = state.rates.numpy() if wp.get_device(device).is_cpu else None
        self._bind(problem, state, options.feed_forward, first)

    def _record(self, blocks: Sequence[Block], sizes: list[int], gains: dict[str, FloatArray]) -> Launch:
        from scipy.linalg import sqrtm

        options, state, problem = self.options, self.state, self.problem
        n, count, device = problem.unknown_count, problem.instance_count, problem.device
        alone = len(blocks) == 1
        ends = np.cumsum(sizes)
        places = {
            "rows": _places(n, blocks, "residuals"),
            "columns": _places(n, blocks, "unknowns"),
            "start": np.repeat(ends - sizes, sizes),
            "stop": np.repeat(ends, sizes),
        }
        for name, place in places.items():
            setattr(state, name, wp.array(place, dtype=wp.int32, device=device))
        if alone and options.scaling != "equilibrated":
            state.matrix, state.driving = problem.gamma, problem.residual
        else:
            state.matrix = wp.zeros((count, n, n), dtype=wp.float64, device=device)
        state.inverse = wp.zeros((count, n, max(sizes)), dtype=wp.float64, device=device)
        root = np.real(sqrtm(gains["Q"]))
        matrices = {"gain": gains["R"], "weight": gains["Q"], "weight_root": root, "weight_inverse_root": np.linalg.inv(root)}
        for name, value in (matrices | {"initial": gains["P0"]}).items():
            setattr(state, name, wp.array(np.ascontiguousarray(value), dtype=wp.float64, device=device))
        state.horizon = options.horizon
        variant = (options.riccati, options.update == "exact", options.scaling, options.feed_forward, options.correct_output)
        return record(partial(make_observer, tuple(sorted(set(sizes))), *variant, alone), count, [state], device)

    def pace(self, before: float, after: float) -> None:
        """By what time (8), (10) and (11) take the next step, and what (12) looks ahead."""
        super().pace(before, after)
        self.state.dt.assign(np.array([after]))
        if self._large is not None:
            self._large.dt = after

    def _update(self) -> None:
        if self._large is None:
            self._launch.launch()
        else:
            self._large.step(self.problem, self.state)

    def _rates(self) -> FloatArray:
        return np.array(self.state.rates.numpy() if self._host_rates is None else self._host_rates)


def _places(n: int, blocks: Sequence[Block], what: str) -> NDArray[np.intp]:
    """Which of n unknowns or residuals the blocks hold, in their order."""
    return np.concatenate([np.arange(0), *(np.arange(n)[getattr(block, what)] for block in blocks)])


def _matrix(value: float | FloatArray | tuple[float | FloatArray, ...], parts: Sequence[NDArray[np.intp]], n: int) -> FloatArray:
    """A gain as a matrix (n, n), in the order of the problem."""
    if not isinstance(value, tuple):
        return np.array(value * np.eye(n) if np.ndim(value) == 0 else value, dtype=np.float64)
    result = np.zeros((n, n))
    for entry, part in zip(value, parts, strict=True):
        result[np.ix_(part, part)] = entry if np.ndim(entry) else entry * np.eye(len(part))
    return result


def _definite(name: str, value: Numbers) -> Numbers:
    """A checked gain: the number as it was given, or a copy of the matrix."""
    matrix = array(name, value, finite=False)
    if matrix.ndim == 0 and not isinstance(value, bool):
        gain = positive_float(name, value)
        return gain if isinstance(value, np.ndarray) else value
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not matrix.size or not np.isfinite(matrix).all():
        refuse(name, value, "must be a number > 0 or a symmetric positive definite matrix")
    if np.abs(matrix - matrix.T).max() > 1e-12 * np.abs(matrix).max() or np.linalg.eigvalsh(matrix).min() <= 0:
        refuse(name, value, "must be symmetric positive definite")
    return matrix
