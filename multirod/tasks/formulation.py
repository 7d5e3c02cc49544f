"""The problem that all tasks share: freed inputs beside the unknowns. Numbers in parentheses: ``docs/tasks.md``."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.batch import Instances, IntArray, solved_each
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.problem import BoundaryProblem
from multirod.tasks.freed import columns
from multirod.validation import FloatArray

PosedAt: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray]  # position, rotation, columns by x and by p


@dataclass(frozen=True)
class Evaluation:
    """What one integration says at unknowns ``x`` and freed inputs ``p``; axes (instance, ...), NaN of all where it failed.

    Attributes:
        residual: ``eps`` [1/m], shape (b, n).
        gamma: d(eps)/dx, shape (b, n, n).
        slopes: d(eps)/dp, shape (b, n, k).
        position: Of the end effector in the world [m], shape (b, 3).
        rotation: Its frame, body to world, shape (b, 3, 3).
        pose_by_unknowns: Position rows, then rotation-vector rows, in the world, shape (b, 6, n).
        pose_by_free: The same by ``p`` at fixed ``x``, shape (b, 6, k).
        failed: Whether the integration failed, shape (b,).
    """

    residual: FloatArray
    gamma: FloatArray
    slopes: FloatArray
    position: FloatArray
    rotation: FloatArray
    pose_by_unknowns: FloatArray
    pose_by_free: FloatArray
    failed: NDArray[np.bool_]

    def take(self, instances: Instances) -> Self:
        """That of some instances, by an index of the first axis."""
        return type(self)(**{name: getattr(self, name)[instances] for name in self.__dataclass_fields__})

    def pose_at(self, place: tuple[int, int] | None) -> PosedAt:
        """The pose of the end effector, whose ``place`` is None, and its derivatives by unknowns and by ``p``."""
        assert place is None  # others are told by what looks along the rods
        return self.position, self.rotation, self.pose_by_unknowns, self.pose_by_free

    def by(self, columns: FloatArray) -> Self:
        """By other numbers, with which ``p`` varies by ``columns`` (k, l)."""
        return replace(self, slopes=self.slopes @ columns, pose_by_free=self.pose_by_free @ columns)

    @cached_property
    def eliminated(self) -> tuple[FloatArray, FloatArray]:
        """(2) ``a`` (b, n) and ``B`` (b, n, k): to first order the equilibrium at ``p + dp`` is at ``x + a + B dp``.

        NaN where ``Gamma`` is singular.
        """
        both = np.concatenate([self.residual[..., None], self.slopes], axis=2)
        solved = -solved_each(self.gamma, both)
        return solved[..., 0], solved[..., 1:]

    def condensed(self, errors: FloatArray, by_unknowns: FloatArray, by_free: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(3) ``r`` (b, m) and ``J`` (b, m, k) of rows by their errors and derivatives: what is left of them at the equilibrium
        for ``p``, and how that varies."""
        towards, by = self.eliminated
        return errors + (by_unknowns @ towards[..., None])[..., 0], by_free + by_unknowns @ by


class Task:
    """A boundary problem whose inputs ``free`` are unknown too, beside its own unknowns.

    Args:
        problem: Made with ``options(robot, free)``.
        free: Names of inputs.

    Attributes:
        places: Where the freed numbers stand in a row of the problem's inputs, shape (k,).
    """

    def __init__(self, problem: BoundaryProblem, free: Sequence[str]) -> None:
        self.problem = problem
        self.free = free if isinstance(free, tuple) else tuple(free)
        self._columns, self.places = problem.tool(("places", self.free), self._placed)
        problem.aim(*self.free)

    def _placed(self) -> tuple[NDArray[np.intp] | None, NDArray[np.intp]]:
        """Which columns of what ``aimed`` says are of freed numbers, None of all; and where these stand in a row of inputs."""
        every = [np.arange(self.problem.input_count)[self.problem.input_slice(name)] for name in self.free]
        own = columns(self.free, [len(numbers) for numbers in every])
        places = np.concatenate(every)
        return None if len(own) == len(places) else own, places[own]

    @property
    def in_place(self) -> bool:
        """Whether its columns stand in the problem's buffers as ``aimed`` says them."""
        return self.problem.columns_in_place and self._columns is None

    def aimed(self) -> tuple[FloatArray, FloatArray]:
        """Columns of the residual and of the pose by what is free, of the last integration: shapes (b, n, k) and (b, 6, k)."""
        slopes, moved = self.problem.aimed(*self.free)
        return (slopes, moved) if self._columns is None else (slopes[..., self._columns], moved[..., self._columns])

    def chosen(self, columns: FloatArray) -> FloatArray:
        """Those by freed numbers, of columns (..., n + every number of what is free) by unknowns, then by these."""
        n = self.problem.unknown_count
        return columns if self._columns is None else columns[..., [*range(n), *(n + self._columns)]]

    @classmethod
    def of(
        cls,
        robot: Assembly,
        inputs: Inputs,
        free: Sequence[str],
        *,
        integrator: Integrator,
        device: str = "cpu",
        instances: IntArray | None = None,
    ) -> Self:
        """The task of a robot at ``inputs``: what is not freed stays as it is there, or is given other values by who steps it,
        zero or not."""
        own = options(robot, free)
        own["enabled"] = (*own["enabled"], *inputs.given)
        problem = robot.problem(inputs, integrator=integrator, device=device, instances=instances, **own)
        return cls(problem, free)

    @property
    def count(self) -> int:
        """Freed numbers ``k`` of an instance."""
        return len(self.places)

    def values(self) -> FloatArray:
        """The freed inputs as the problem has them, shape (b, k)."""
        view = self.problem.input_view()
        return np.asarray((self.problem.read("inputs") if view is None else view)[:, self.places])

    def write(self, unknowns: FloatArray, values: FloatArray) -> None:
        """Set ``x`` (b, n) and ``p`` (b, k)."""
        problem = self.problem
        problem.write("unknowns", unknowns)
        view = problem.input_view()
        if view is not None:
            view[:, self.places] = values
            return
        rows = problem.read("inputs")
        rows[:, self.places] = values
        problem.write("inputs", rows)

    def evaluate(self, unknowns: FloatArray, values: FloatArray, chosen: NDArray[np.bool_] | None = None) -> Evaluation:
        """One integration at ``x`` (b, n) and ``p`` (b, k), of all instances, or of those chosen (b,), which alone are returned.

        Raises:
            Interrupted: If the problem's ``stop`` is set.
            RuntimeError: If another thread works on the problem.
        """
        with self.problem.alone:
            self.write(unknowns, values)
            if chosen is None or chosen.all():
                self.integrate()
                return self.last()
            with self.problem.only(chosen):
                self.integrate()
            return self.last(np.flatnonzero(chosen))

    def integrate(self) -> None:
        """One integration at what the problem holds."""
        self.problem.integrate()

    def integrate_some_coarsely(self, coarsely: NDArray[np.int32]) -> None:
        """One integration of those that are active, by few steps where ``coarsely`` (b,) is 1: so the problem offers it on the
        CPU alone."""
        self.problem.integrate_some_coarsely(coarsely)

    def last(self, instances: NDArray[np.intp] | slice = slice(None)) -> Evaluation:
        """What the last integration said of some instances, without another one."""
        problem, n = self.problem, self.problem.unknown_count
        slopes, moved = self.aimed()
        residual, failed = problem.read("residual")[instances], problem.buffer("fault")[instances] != 0
        result = Evaluation(
            residual,
            problem.read("gamma").reshape(-1, n, n)[instances],
            slopes[instances],
            problem.read("position")[instances],
            problem.read("rotation").reshape(-1, 3, 3)[instances],
            np.array(problem.pose_by_unknowns())[instances],
            moved[instances],
            failed,
        )
        if failed.any():
            for name in ("residual", "gamma", "slopes", "position", "rotation", "pose_by_unknowns", "pose_by_free"):
                getattr(result, name)[failed] = np.nan
        return result


def options(robot: Assembly, free: Sequence[str]) -> dict[str, Any]:
    """Options of ``robot.problem`` for a task with these freed inputs."""
    return {"pose_sensitivities": True, "enabled": tuple(free), **robot.input_directions(*free)}


def input_units(robot: Assembly, free: Sequence[str]) -> FloatArray:
    """(9) What counts as one of each freed number, shape (k,): 1 rad, a tenth of the longest rod's length, loads ``EI/L^2``."""
    length, stiffness = robot.longest, robot.stiffest
    sizes = []
    for spec in (spec for name in free for spec in robot.input_specs if spec.name == name):
        unit: FloatArray | float = {"rad": 1.0, "m": 0.1 * length}.get(spec.unit, 1.0)
        if spec.acts == "lines" and spec.load is None:
            unit = np.minimum(unit, robot.arms(spec))  # by which a line bends the rod by one radian
        if spec.load is not None:
            borne = robot.borne(spec)
            unit = np.where(borne > 0, stiffness / length**spec.power / np.where(borne > 0, borne, 1.0), 1.0)
        sizes.append(np.broadcast_to(unit, spec.size(robot.rod_count)))
    return np.concatenate(sizes)[columns(free, [len(own) for own in sizes])]
