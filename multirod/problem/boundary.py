"""The boundary problem: all that a solver sees of an assembly."""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Event
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from multirod.batch import Interrupted
from multirod.budget import Budget
from multirod.elimination import Elimination
from multirod.inputs import Inputs
from multirod.problem.inputs import ByInputs
from multirod.problem.offers import Offers
from multirod.segments import Breakpoints
from multirod.validation import Described, FloatArray, refuse

TOLERANCE = 1e-9  # default of solvers, of the residual [1/m]
LEAST_TOLERANCE = 1e-12  # of the curvature scale: rounding leaves no less
SINGLE_TOLERANCE = 1e-5  # the same where rods are integrated in single precision, of the curvature scale
DOUBLE_ROUNDING = float(np.finfo(np.float64).eps)
Found = TypeVar("Found")


@dataclass(frozen=True)
class Block:
    """Unknowns and residuals that belong to one rod (or to what couples the rods).

    Attributes:
        name: For messages and plots.
        unknowns: Which of the problem's, a slice or indices.
        residuals: Likewise, as many.
        rod: Index of the rod, or of the outermost of several; None for what couples the rods.
    """

    name: str
    unknowns: slice | NDArray[np.intp]
    residuals: slice | NDArray[np.intp]
    rod: int | None = None


class CoarseLaunch(Protocol):
    """A launch of ``BoundaryProblem.coarse``."""

    @property
    def recorded(self) -> tuple[Any, ...] | None:
        """As ``BoundaryProblem.launches``."""

    def launch(self) -> None:
        """Integrate."""


class BoundaryProblem(ByInputs, Offers):
    """An assembly at some inputs, discretised: unknowns ``x`` to residual ``eps`` and ``Gamma = d(eps)/d(x)``.

    Everything is batched: the first axis of every array is the instance. Solvers written with Warp kernels read and
    write the arrays of ``Buffers`` and call ``integrate``; solvers written with NumPy call ``evaluate``. One thread works on a
    problem at a time: ``Solver.solve`` and ``evaluate`` refuse another.

    A problem implements ``guess``, ``_integrate`` and ``input_slice``. What only some can do are objects that it offers, or None
    (``multirod.capabilities``): ``stability``, ``shapes``, ``lines``, ``starts``, ``parts``, ``segments``, ``joints``,
    ``result_test``, ``conjugates``.

    Attributes:
        blocks: The unknowns and residuals of each rod, then, where something couples the rods, of that.
        arrow: Where ``Gamma`` is an arrow, blocks on the diagonal that meet only in a border of last rows and columns: the first
            index of each, of the border, and ``n``; else empty.
        breakpoints: Instances whose equilibrium is known by its states there, not by ``unknowns`` alone; ``shapes`` and
            ``stability`` are of these states.
        measured: Names of the inputs that are measurements: a solver that follows a motion may extrapolate the others.
        rounding: What a number is rounded by, relative to itself, along the rods: numpy's ``eps`` of the integrator's precision.
        budget: What a study that uses it may still take, of which ``integrate`` spends one an active instance; None is no bound.
        stop: Once it is set, ``integrate`` raises ``Interrupted``: how a batch on several threads is brought to an end.
    """

    instead = "ask the assembly for another problem"
    budget: Budget | None = None

    def __init__(
        self,
        *,
        unknown_count: int,
        batch_shape: tuple[int, ...],
        input_count: int,
        blocks: Sequence[Block],
        direction_count: int = 0,
        pose_sensitivities: bool = False,
        device: str = "cpu",
        elimination: Elimination | None = None,
    ) -> None:
        super().__init__(
            unknown_count=unknown_count,
            batch_shape=batch_shape,
            input_count=input_count,
            direction_count=direction_count,
            pose_sensitivities=pose_sensitivities,
            device=device,
            elimination=elimination,
        )
        self.blocks = tuple(blocks)
        self.arrow: tuple[int, ...] = ()
        self.breakpoints: dict[int, Breakpoints] = {}
        self.measured: tuple[str, ...] = ()
        self.rounding = DOUBLE_ROUNDING
        self.stop: Event | None = None
        self._tolerances: tuple[FloatArray | None, FloatArray] = None, np.zeros(0)  # for which scale, and by it
        self._found: dict[str, tuple[bytes, Any]] = {}  # by name, for what and what
        self.side = 1  # or -1: to which ``guess`` goes where nothing but a rule tells it

    def renew(self, inputs: Inputs) -> bool:
        """Be as a new problem at other inputs, of the same leading axes and the same that are not zero; False if it cannot, as by
        default."""
        return False

    def _clear(self) -> None:
        super()._clear()
        self.breakpoints, self.stop, self.budget, self.side = {}, None, None, 1

    def found_for(self, name: str, given: FloatArray, find: Callable[[], Found]) -> Found:
        """What ``find`` finds, which follows from ``given`` alone: several ask for the same in one solve, and in the next. It is
        the same object for all of them."""
        kept, key = self._found.get(name), given.tobytes()
        if kept is None or kept[0] != key:
            kept = self._found[name] = key, find()
        found: Found = kept[1]
        return found

    def expect_judging(self) -> None:
        """Be told that ``stability`` will be asked for often: what takes a kernel of its own may pay from here on."""

    @property
    def guess_integrations(self) -> NDArray[np.integer[Any]] | int:
        """Integrations per rod that ``guess`` took, or takes at most where it has not been asked for: one number, or one of each
        instance, shape (instance_count,)."""
        return 0

    @abstractmethod
    def guess(self) -> FloatArray:
        """Unknowns [1/m] of the equilibrium where ``load_factor`` is 0, shape (instance_count, n).

        It takes ``guess_integrations`` integrations.
        """

    @property
    def natural_singular_value(self) -> FloatArray:
        """What the smallest singular value of ``Gamma`` is far from any fold, 1 or less, shape (instance_count,).

        How near a fold is, is judged against it: at the present inputs, whether or not ``guess`` was called. It may take
        ``guess_integrations`` integrations too.
        """
        return np.ones(self.instance_count)

    @property
    def natural_gamma(self) -> FloatArray | None:
        """``Gamma`` far from any fold, regular, shape (instance_count, n, n), where its singular values are decades apart there:
        how near a fold is, is told against it. None where they are not. As ``natural_singular_value`` says."""
        return None

    def adopt(self, unknowns: FloatArray) -> FloatArray:
        """Unknowns (instance_count, m) of a problem of the same assembly, as those of this one, (instance_count, n).

        Problems of one assembly differ in their unknowns where they differ in what is compiled in: a solution of one is made
        a guess for another, or the point where the other is differentiated, here and nowhere else.

        Raises:
            ValueError: If they cannot be the unknowns of such a problem.
        """
        if unknowns.shape[1] != self.unknown_count:
            refuse("guess", Described(f"array of shape {unknowns.shape}"), f"must have shape (..., {self.unknown_count})")
        return unknowns

    def integrate(self) -> None:
        """Evaluate residual, ``Gamma`` and the end effector's pose of the active instances: one integration per rod.

        Raises:
            Interrupted: If ``stop`` is set.
            RuntimeError: If that is more than is left of ``budget``.
        """
        self._spend()
        self._integrate()

    def _spend(self) -> None:
        """What is to be looked at before an integration."""
        self.heed_stop()
        if self.budget is not None:
            self.budget.spend(int((self.active.numpy()[self.order.numpy()[: self.listed]] != 0).sum()))

    def heed_stop(self) -> None:
        """Come to an end here if ``stop`` is set: whatever takes long calls it in between.

        Raises:
            Interrupted: If it is.
        """
        if self.stop is not None and self.stop.is_set():
            raise Interrupted

    @abstractmethod
    def _integrate(self) -> None:
        """Do what ``integrate`` says."""

    @property
    def launches(self) -> tuple[Any, ...] | None:
        """The recorded launches that an integration of all instances is, in order, where it is nothing else: a kernel may repeat
        them then. The same object as long as they are the same; None by default."""
        return None

    @property
    def coarse(self) -> CoarseLaunch | None:
        """What integrates as ``launches`` do, by fewer steps, so that it says where an equilibrium is to some six digits, where
        that saves much; None by default. It passes over the instances that are listed now."""
        return None

    def coarse_turning(self) -> FloatArray:
        """By how much rods turn in a step of ``coarse``, as far as precurvature and loads tell [rad], shape (instance_count,)."""
        return np.full(self.instance_count, np.inf)

    def integrate_coarsely(self) -> None:
        """``integrate``, by ``coarse``, which there is."""
        self._spend()
        assert self.coarse is not None
        self.coarse.launch()

    def integrate_some_coarsely(self, coarsely: NDArray[np.int32]) -> None:
        """``integrate``, by ``coarse``, which there is, where ``coarsely``, (instance_count,), is 1."""
        active = self.buffer("active")
        chosen = active * coarsely
        if not chosen.any():
            self.integrate()
            return
        before = active.copy()
        try:
            active[:] = chosen
            self.integrate_coarsely()
            active[:] = before * (1 - coarsely)
            if active.any():
                self.integrate()
        finally:
            active[:] = before

    def integrate_alike(self) -> bool:
        """Integrate one instance for all where they are surely the same, as a batch of loads on one robot is without them.

        Residual and ``Gamma`` of all are then what ``integrate`` would leave; False, and nothing is done, where they may differ,
        as by default.
        """
        return False

    @contextmanager
    def without_poses(self) -> Iterator[None]:
        """Within it, integrations may leave the end effector's pose out, where that saves time; it is found in the end."""
        yield

    def curvature_scale(self) -> FloatArray:
        """Size of the curvatures that arise [1/m], shape (instance_count,): the rods' own, or one over the length."""
        return np.ones(self.instance_count)

    def tolerance(self, given: float | None) -> FloatArray:
        """Largest residual of a solution [1/m], shape (instance_count,): what is given, or the default of the precision.

        That is ``TOLERANCE`` in double precision, and that part of ``curvature_scale`` where it is less than 1/m, as for rods
        longer than a metre. Rounding sets a floor that is proportional to curvature: ``LEAST_TOLERANCE`` of its scale, which rods
        of less than a millimetre come to, and in single precision ``SINGLE_TOLERANCE`` of it (measured: ``docs/solvers.md``,
        Single precision).
        """
        if given is not None:
            return np.full(self.instance_count, float(given))
        scale = self.curvature_scale()
        if scale is not self._tolerances[0]:  # of most problems it is one array, always the same
            if self.rounding == DOUBLE_ROUNDING:
                found = np.maximum(TOLERANCE * np.minimum(scale, 1.0), LEAST_TOLERANCE * scale)
            else:
                found = SINGLE_TOLERANCE * scale
            self._tolerances = scale, found
        return self._tolerances[1].copy()

    def load_scale(self) -> FloatArray:
        """Size of the loads against the stiffness, ``F L^2/EI`` and its like, shape (instance_count,).

        Load continuation takes care not to step over more than this says is safe.
        """
        return np.zeros(self.instance_count)

    def load_change(self, before: FloatArray) -> FloatArray:
        """The same of how much loads differ from those of inputs ``before`` (instance_count, input_count); 0 where it is not
        told."""
        return np.zeros(self.instance_count)

    def mode_bounds(self) -> FloatArray:
        """As ``StabilityAnalysis.mode_bounds``; where that says nothing, what ``load_scale`` says of columns."""
        found = None if self.stability is None else self.stability.mode_bounds()
        if found is not None:
            return found
        return np.stack([0.5 * self.load_scale(), np.full(self.instance_count, np.inf)], axis=1)

    def turning(self, before: FloatArray | None = None) -> FloatArray:
        """How far rods that share their bending are turned against each other [rad], shape (instance_count,), since the inputs
        ``before``, (instance_count, input_count), or since they were straight and in line; zero where none share it.
        """
        return np.zeros(self.instance_count)

    @property
    def turned(self) -> slice:
        """Where the angles stand among inputs that say what ``turning`` does since other inputs; nowhere where that is zero."""
        return slice(0, 0)

    # ---- for solvers written with NumPy, and for all that reads results ----

    def evaluate(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``(eps, Gamma)`` at ``unknowns`` (instance_count, n), as new NumPy arrays; NaN where the integration failed.

        Raises:
            Interrupted: If ``stop`` is set.
            RuntimeError: If another thread works on the problem.
        """
        with self.alone:
            self.write("unknowns", unknowns)
            self.integrate()
            residual, gamma = self.read("residual"), self.read("gamma").reshape(self.instance_count, self.unknown_count, -1)
            failed = self.fault.numpy() != 0
        residual[failed] = np.nan
        gamma[failed] = np.nan
        return residual, gamma
