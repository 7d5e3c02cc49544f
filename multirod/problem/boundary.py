"""The boundary problem: all that a solver sees of an assembly."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import Interrupted
from multirod.budget import Budget
from multirod.capabilities import Clamps, Conjugates, Joints, Lines, Parts, ResultTest, Shapes, Starts
from multirod.elimination import Elimination
from multirod.inputs import Inputs
from multirod.problem.buffers import Buffers
from multirod.segments import Breakpoints, Segments
from multirod.stability import StabilityAnalysis
from multirod.status import Status, failures
from multirod.validation import Described, FloatArray, refuse

TOLERANCE = 1e-9  # default of solvers, of the residual [1/m]
LEAST_TOLERANCE = 1e-12  # of the curvature scale: rounding leaves no less
SINGLE_TOLERANCE = 1e-5  # the same where rods are integrated in single precision, of the curvature scale
DOUBLE_ROUNDING = float(np.finfo(np.float64).eps)
NEUTRAL_VALUE = 1e-12  # of the largest singular value of Gamma: with less, straight rods answer a force along themselves
STILL = 1e-6  # of a change of unknowns (norm 1): those that change by less do not
FEW = 8  # instances of which one thread does all, what comes between integrations too


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


def neutral_ways(gamma: FloatArray) -> FloatArray:
    """Changes of the unknowns that ``Gamma`` (n, n) answers by nothing, as orthogonal rows (m, n)."""
    _, sizes, ways = np.linalg.svd(gamma)
    return np.asarray(ways[sizes < NEUTRAL_VALUE * sizes[0]])


class BoundaryProblem(Buffers, ABC):
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

    columns_in_place = True  # whether ``aimed``, by inputs, is what stands in ``residual_directions`` and ``pose_columns``
    eliminates = False  # whether columns by parameters may be at other fixed unknowns than its own: they are eliminated next
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
        self.side = 1  # or -1: to which ``guess`` goes where nothing but a rule tells it

    def renew(self, inputs: Inputs) -> bool:
        """Be as a new problem at other inputs, of the same leading axes and the same that are not zero; False if it cannot, as by
        default."""
        return False

    def _clear(self) -> None:
        super()._clear()
        self.breakpoints, self.stop, self.budget, self.side = {}, None, None, 1

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
        self.heed_stop()
        if self.budget is not None:
            self.budget.spend(int((self.active.numpy()[self.order.numpy()[: self.listed]] != 0).sum()))
        self._integrate()

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

    def takes(self, name: str) -> bool:
        """Whether the terms of an input are compiled into this problem."""
        return True

    def pack(self, inputs: Inputs) -> FloatArray:
        """Rows of ``inputs``, shape (instance_count, input_count), for ``write("inputs", ...)``.

        Raises:
            ValueError: If an input that is not zero has no terms in this problem.
        """
        missing = sorted(name for name in inputs.given if inputs.is_active(name) and not self.takes(name))
        if missing:
            raise ValueError(f"the problem was made without {', '.join(missing)}: name them in enabled, or make a new problem")
        packed = np.zeros((*self.batch_shape, self.input_count))
        for name in inputs.given:
            if name not in inputs.profiles:
                packed[..., self.input_slice(name)] = getattr(inputs, name)
        return packed.reshape(self.instance_count, self.input_count)

    @abstractmethod
    def input_slice(self, name: str) -> slice:
        """Where an input stands in a row of ``inputs`` and ``directions``."""

    def input_columns(self, *names: str) -> tuple[FloatArray, FloatArray]:
        """Derivatives by each component of one input or several, the unknowns fixed; takes one integration.

        The problem was made with ``Assembly.input_directions(*names)``, and with ``pose_sensitivities``.

        Returns:
            Of the residual, shape (instance_count, n, k), and of the end effector's pose, as in ``pose_columns``,
            shape (instance_count, 6, k): the components of each input beside each other, the inputs in the order named.
        """
        self.aim(*names)
        self.integrate()
        return self.aimed(*names)

    def part_ends(self, names: Sequence[str]) -> FloatArray:
        """Move ends of sections that are at one place a hair apart where one of these names would move them: derivatives have a
        side there. Returns what no place may be nearer to an end than [m], zero where none were moved, shape (instance_count,).
        """
        return np.zeros(self.instance_count)

    def aim(self, *names: str) -> None:
        """Point the directions along each component of some inputs: every integration from now on gives its columns."""
        directions = np.zeros(self.directions.shape) if self._direction_view is None else self._direction_view
        column = 0
        for name in names:
            own = self.directions_by(name)
            directions[:, column : column + own.shape[1]] = own
            column += own.shape[1]
        directions[:, column:] = 0.0
        if self._direction_view is None:
            self.directions.assign(directions)

    @cached_property
    def _direction_view(self) -> FloatArray | None:
        """Directions as NumPy sees them in place; None where they are elsewhere."""
        return None if self._host is None else np.asarray(self.directions.numpy())

    def directions_by(self, name: str) -> FloatArray:
        """Directions along each component of an input, shape (instance_count or 1, k, directions.shape[2])."""
        place = self.input_slice(name)
        rows = np.zeros((1, place.stop - place.start, self.directions.shape[2]))
        rows[0, :, place] = np.eye(rows.shape[1])
        return rows

    def aimed(self, *names: str) -> tuple[FloatArray, FloatArray]:
        """What ``input_columns`` returns, of the last integration after ``aim(*names)``."""
        return np.array(self.buffer("residual_directions")), np.array(self.buffer("pose_columns")[:, :, self.unknown_count :])

    def pose_by_unknowns(self) -> FloatArray:
        """How the end effector's pose varies with the unknowns, shape (instance_count, 6, n); to be read at once."""
        return np.asarray(self.buffer("pose_columns")[:, :, : self.unknown_count])

    def along(self, names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:
        """Derivatives of a rod's ``position``, ``rotation`` and ``curvature`` at some places, after ``aim(*names)``.

        Args:
            names: What the problem is aimed at.
            rod: Which rod.
            places: Rising arclengths from the base [m], shape (instance_count, count).

        Returns:
            Each of shape (instance_count, count, 3, n + k): by the unknowns, then by each number named, the unknowns fixed.
            Positions and rotation vectors in the world, curvatures in the frame of the rod.
        """
        raise NotImplementedError(f"{type(self).__name__} does not give derivatives along its rods")

    def sensing(self, places: FloatArray) -> Any:  # noqa: ANN401  (each problem has its own)
        """What may be launched in the place of ``integrate``, by its ``launch()``, and tells more: curvatures at ``places``
        (count,), rising arclengths, which ``sensed`` reads."""
        raise NotImplementedError(f"{type(self).__name__} does not give derivatives along its rods")

    def sensed(self, made: Any, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:  # noqa: ANN401  (of ``sensing``)
        """What the last launch of ``sensing(...)`` said of a rod, after ``aim(*names)``; to be read at once.

        Returns:
            Curvatures in its frame [1/m], shape (instance_count, count, 3), and their derivatives by the unknowns, then by each
            number named, shape (instance_count, count, 3, n + k).
        """
        raise NotImplementedError(f"{type(self).__name__} does not give derivatives along its rods")

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
        if self.rounding == DOUBLE_ROUNDING:
            scale = self.curvature_scale()
            return np.maximum(TOLERANCE * np.minimum(scale, 1.0), LEAST_TOLERANCE * scale)
        return SINGLE_TOLERANCE * self.curvature_scale()

    def load_scale(self) -> FloatArray:
        """Size of the loads against the stiffness, ``F L^2/EI`` and its like, shape (instance_count,).

        Load continuation takes care not to step over more than this says is safe.
        """
        return np.zeros(self.instance_count)

    def turning(self, before: FloatArray | None = None) -> FloatArray:
        """How far rods that share their bending are turned against each other [rad], shape (instance_count,), since the inputs
        ``before``, (instance_count, input_count), or since they were straight and in line; zero where none share it.
        """
        return np.zeros(self.instance_count)

    @property
    def turned(self) -> slice:
        """Where the angles stand among inputs that say what ``turning`` does since other inputs; nowhere where that is zero."""
        return slice(0, 0)

    # ---- what only some offer ----

    @property
    def stability(self) -> StabilityAnalysis | None:
        """Whether equilibria are stable, and what that tells solvers."""
        return None

    @property
    def shapes(self) -> Shapes | None:
        """The rods on nodes along their arclength."""
        return None

    @property
    def lines(self) -> Lines | None:
        """What lines along the rods do."""
        return None

    @property
    def starts(self) -> Starts | None:
        """Guesses that cover where equilibria may lie."""
        return None

    @property
    def parts(self) -> Parts | None:
        """Problems of some of the instances."""
        return None

    @property
    def segments(self) -> Segments | None:
        """The problem cut into segments, for multiple shooting."""
        return None

    @property
    def segments_refused(self) -> str:
        """Why ``segments`` is None, where it is."""
        return "it is not a single rod"

    @property
    def joints(self) -> Joints | None:
        """Joints that may be taken apart."""
        return None

    @property
    def result_test(self) -> ResultTest | None:
        """What any solver's results have to pass."""
        return None

    @property
    def conjugates(self) -> Conjugates | None:
        """Which residuals are forces, and the displacements they do work on; it needs ``pose_sensitivities``."""
        return None

    @property
    def clamps(self) -> Clamps | None:
        """Clamps along the rods, of a problem that ``Parts.clamped`` made."""
        return None

    # ---- what is assumed where nothing is offered ----

    @property
    def may_jump(self) -> bool:
        """Whether a step may end on another branch, and its ends not tell: not unless ``stability`` says so."""
        return self.stability is not None and self.stability.may_jump

    def out_of_reach(self) -> NDArray[np.bool_]:
        """Whether an instance has no equilibrium because ends are farther apart than what is between them can be long, shape
        (instance_count,); False where that is not known."""
        return np.zeros(self.instance_count, dtype=bool)

    @property
    def may_be_taut(self) -> bool:
        """Whether ``taut`` may say so of an instance at some inputs."""
        return False

    def taut(self) -> NDArray[np.bool_]:
        """Whether a rod that does not stretch is held at its full length, shape (instance_count,): it can but be straight, with
        any force along itself, and no branch leads from there or to there."""
        return np.zeros(self.instance_count, dtype=bool)

    def tells_nothing(self, unknowns: FloatArray) -> NDArray[np.bool_]:
        """Whether unknowns (instance_count, n) are those of a rod that is ``taut``: as a guess they lead nowhere. Shape
        (instance_count,)."""
        return np.zeros(self.instance_count, dtype=bool)

    def reasons(self, status: NDArray[np.int32]) -> NDArray[np.int32]:
        """Values of ``Status`` of instances without a result, those of others as they are, shape (instance_count,): what is known
        of why, where that says more than ``status`` does."""
        return np.where(self.out_of_reach() & failures(status), Status.OUT_OF_REACH, status).astype(np.int32)

    @property
    def held_forces(self) -> NDArray[np.intp]:
        """Unknowns, by their numbers, that are forces in rods whose tips are held."""
        return np.zeros(0, dtype=np.intp)

    def undetermined(self) -> NDArray[np.bool_]:
        """Whether forces in rods could change, as far as the last integration says, and nothing else would, shape
        (instance_count,): straight rods that do not stretch share what they carry in ways that nothing determines."""
        result = np.zeros(self.instance_count, dtype=bool)
        if not len(self.held_forces):
            return result
        gamma = self.read("gamma").reshape(self.instance_count, self.unknown_count, self.unknown_count)
        others = np.setdiff1d(np.arange(self.unknown_count), self.held_forces)
        for k in np.flatnonzero(np.isfinite(gamma).all(axis=(1, 2))).tolist():
            neutral = neutral_ways(gamma[k])
            result[k] = len(neutral) > 0 and np.abs(neutral[:, others]).max() < STILL
        return result

    def loose(self) -> list[str]:
        """Of each instance the body that moves most, by its name, where the assembly moves at rest and without loads though no
        rod is bent, a mechanism; ``""`` where it does not. It integrates nothing if ``guess`` was called."""
        return [""] * self.instance_count

    def is_loose(self) -> NDArray[np.bool_]:
        """Whether it moves so, shape (instance_count,)."""
        return np.array([name != "" for name in self.loose()], dtype=bool)

    @property
    def kinks(self) -> NDArray[np.intp]:
        """Unknowns, by their numbers, at whose zero the residual has a kink at the full load, and none at less."""
        return np.zeros(0, dtype=np.intp)

    @property
    def kink_inputs(self) -> NDArray[np.intp]:
        """Inputs, by their numbers, that let out what has ``kinks`` where they are lower."""
        return np.zeros(0, dtype=np.intp)

    def mode_bounds(self) -> FloatArray:
        """As ``StabilityAnalysis.mode_bounds``; where that says nothing, what ``load_scale`` says of columns."""
        found = None if self.stability is None else self.stability.mode_bounds()
        if found is not None:
            return found
        return np.stack([0.5 * self.load_scale(), np.full(self.instance_count, np.inf)], axis=1)

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
