"""Energy descent: a trust region on the potential energy, one integration a sample, through folds and snaps."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from multirod.integrators import RK45, Integrator
from multirod.launch import record
from multirod.naming import OPTIONS_NAMED, fields_hinted
from multirod.problem import BoundaryProblem
from multirod.solver import Outcome, Solver
from multirod.solvers.tracking.energy_descent_kernels import NUDGE, DescentState, make_descent
from multirod.solvers.tracking.sampled import SampledTrack
from multirod.solvers.tracking.symmetric_kernels import ROOM
from multirod.status import BoolArray, IntArray, Status
from multirod.validation import FloatArray, boolean, positive_float, positive_int


@fields_hinted(OPTIONS_NAMED)
@dataclass(frozen=True, kw_only=True)
class EnergyDescent(Solver):
    """Newton's step on the potential energy as a function of what its forces move, kept short and downhill.

    Along a motion it takes exactly one integration a sample, as ``Observer``. Where the equilibrium is stable and near, its
    step is one of Newton's method; where a mode is unstable it goes down along it, so that it passes folds, follows a
    snap to where the robot comes to rest, and does not stay on what is unstable. Of one rod that is how the tip is turned; of
    tubes their angles too; of legs the pose of the platform and what joints leave free. Loads without a potential are followed
    by damped dynamics in its place. Along a motion the pose, and the unknowns, are those after the step, to first order; the
    residual is that before it.
    ``docs/energy_descent.md`` derives it, and says what was measured.

    Attributes:
        integrator: Of the spatial equations.
        radius: Largest turn by one sample in each mode [rad], half of it again for what the inputs' change asks for; a platform's
            move by its legs' length counts as a radian.
        feed_forward: Whether the unknowns also follow the inputs' rates, extrapolated from the last samples.
        fold_threshold: Least stiffness of all modes over ``K/L``, of one rod ``solution.stability_margin``, with the length at
            the start, below which the status is ``NEAR_FOLD``: 1 is a straight unloaded rod. Of networks it counts in units of
            that of the unloaded network, 1 at most, as soft rods may stand beside stiff ones. It is also that where a step was
            longer than an eighth of the radius.
        tolerance: Largest residual for ``solve``, max norm [1/m]; None is that of ``Shooting``.
        max_iterations: Samples allowed for ``solve``.
        ramp: Samples over which ``solve`` raises the loads.

    Raises:
        ValueError: If a field is out of range.
    """

    integrator: Integrator = field(default_factory=RK45)
    radius: float = 0.4
    feed_forward: bool = True
    fold_threshold: float = 0.05
    tolerance: float | None = None
    max_iterations: int = 1000
    ramp: int = 100

    def __post_init__(self) -> None:
        self._check_integrator()
        for name in ("radius", "fold_threshold"):
            positive_float(f"EnergyDescent.{name}", getattr(self, name))
        self._check_tolerance()
        for name in ("max_iterations", "ramp"):
            positive_int(f"EnergyDescent.{name}", getattr(self, name))
        boolean("EnergyDescent.feed_forward", self.feed_forward)

    @property
    def pose_sensitivities(self) -> bool:  # type: ignore[override]
        """Whether the problem must carry pose columns: always."""
        return True

    @property
    def direction_count(self) -> int:  # type: ignore[override]
        """Columns along input directions that the problem must carry."""
        return int(self.feed_forward)

    def unsupported(self, problem: BoundaryProblem) -> tuple[str, ...]:
        """Problems that do not say which of their residuals are forces, and what these do work on."""
        if not problem.pose_sensitivities or problem.direction_count < self.direction_count:
            return ("it carries no columns of the pose, or of the inputs' change",)
        if problem.conjugates is None:
            return ("it does not say which residuals are forces and what they do work on, which energy descent needs",)
        return ()

    def track(self, problem: BoundaryProblem, dt: float) -> "EnergyDescentTrack":
        """Follow a motion, one integration a sample; ``dt`` does not matter."""
        return EnergyDescentTrack(self, problem, corrected=True)

    def _solve(self, problem: BoundaryProblem, guess: FloatArray | None) -> Outcome:
        track = EnergyDescentTrack(self, problem, corrected=False)
        outcome = track.settle(tolerance=self.tolerance, max_iterations=self.max_iterations, ramp=self.ramp, guess=guess)
        found = np.isin(outcome.status, (Status.CONVERGED, Status.DAMPED))
        if guess is not None and problem.stability is not None and found.any():
            # what is unstable though its displacements be held does not show in them
            outcome.status[found & problem.stability.unstable()] = Status.UNSTABLE
            outcome.integrations[found] += 1
        return outcome


class EnergyDescentTrack(SampledTrack):
    """Energy descent on the buffers of one problem; ``state`` holds its arrays."""

    def __init__(self, options: EnergyDescent, problem: BoundaryProblem, *, corrected: bool) -> None:
        count, device, n = problem.instance_count, problem.device, problem.unknown_count
        pairs = problem.conjugates
        assert pairs is not None  # or the problem was refused
        self._pairs, m = pairs, len(pairs.forces)
        first = problem.guess()
        state: Any = DescentState()
        problem.share(state, ("active", "fault", "inputs", "unknowns", "residual", "gamma", "residual_directions"))
        problem.share(state, ("position", "rotation", "pose_columns"))
        state.unit, state.columns, state.scale = pairs.unit, pairs.columns, pairs.scale
        state.stiffness = wp.array(pairs.stiffness, dtype=wp.float64, device=device)
        state.curvature = wp.array(problem.curvature_scale(), dtype=wp.float64, device=device)
        rows, columns, values = (list(each) for each in zip(*pairs.give, strict=True)) if pairs.give else ([], [], [])
        constraints = np.setdiff1d(np.arange(n), pairs.forces)
        lists = {"forces": pairs.forces, "constraints": constraints, "without": pairs.without}
        for name, numbers in (lists | {"give_row": rows, "give_column": columns}).items():
            setattr(state, name, wp.array(np.array(numbers, dtype=np.int32), dtype=wp.int32, device=device))
        give = np.zeros((count, len(values)))
        for k, by in enumerate(values):
            give[:, k] = by
        state.give = wp.array(give, dtype=wp.float64, device=device)
        state.has_potential = int(pairs.has_potential)
        room = {"following": (n,), "size": (), "margin": (), "form": (m, m), "system": (n, n), "sides": (n, m + 2)}
        room |= {"matrix": (m, m), "modes": (m, m), "values": (ROOM * m,), "gradient": (m, 2), "steps": (m, 2)}
        for name, shape in room.items():
            setattr(state, name, wp.zeros((count, *shape), dtype=wp.float64, device=device))
        for name in ("status", "damped"):
            setattr(state, name, wp.zeros(count, dtype=wp.int32, device=device))
        state.corrected = int(corrected)
        state.radius = options.radius
        state.fold_threshold = wp.array(options.fold_threshold * pairs.natural(), dtype=wp.float64, device=device)
        self._damped = np.zeros(count, dtype=bool)
        self._launch = record(partial(make_descent, options.feed_forward), count, [state], device)
        self._bind(problem, state, options.feed_forward, first)

    def _update(self) -> None:
        self._pairs.update()
        self._launch.launch()

    def _settled(self, tolerance: FloatArray) -> BoolArray:
        state, held = self.state, self.state.margin.numpy() > 0
        within = super()._settled(tolerance)
        self._damped |= state.damped.numpy() != 0
        # without a potential a form may be stable whose symmetric part is not definite
        for k in np.flatnonzero(within & ~held & self._without_potential()):
            rates, modes = np.linalg.eig(state.form.numpy()[k])
            fastest = int(rates.real.argmin())
            held[k] = rates[fastest].real > 0
            if not held[k]:
                self._leave(int(k), modes[:, fastest].real)
        return np.asarray(within & held)

    def _leave(self, instance: int, mode: FloatArray) -> None:
        """(16) Off an equilibrium that damped dynamics would leave, though nothing pushes, along a mode (m,)."""
        step = NUDGE * self.state.radius * mode * np.sign(mode[np.abs(mode).argmax()]) / np.linalg.norm(mode)
        following = np.array(self.state.following.numpy())
        following[instance] += self.state.sides.numpy()[instance, :, : len(mode)] @ step
        self.state.following.assign(following)

    def _without_potential(self) -> BoolArray:
        pairs, inputs = self._pairs, self.problem.read("inputs")
        return np.asarray(inputs[:, list(pairs.without)].any(axis=1) | (not pairs.has_potential))

    def _rest(self, instances: BoolArray) -> IntArray:
        return np.where(self._damped[instances], Status.DAMPED, Status.CONVERGED)
