"""A boundary problem around another: what is the same is handed on, so that only what differs is written."""

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import Parts, Shapes, Starts
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem, Shape
from multirod.segments import Breakpoints, Cuts, Propagation, Segments
from multirod.validation import FloatArray

COPIED = ("residual", "gamma", "position", "rotation")


class WrappedProblem(BoundaryProblem):
    """A problem of the same unknowns and inputs as ``inner``, which it integrates at inputs of its own, ``inner_inputs``.

    A subclass says in ``inner_inputs`` what the inner problem's inputs are, adds in ``_corrected`` what that changes in the
    derivatives, and makes itself again around another inner problem in ``around``. Scales, tolerances, guess, shapes, starts and
    parts are those of the inner problem. Not offered, because they are not the same: ``stability``, ``segments``,
    ``conjugates``.

    Args:
        inner: The problem within.
        direction_count: Directions in input space; the first ones of ``inner``, which may have more for the subclass.
    """

    def __init__(self, inner: BoundaryProblem, *, direction_count: int = 0) -> None:
        super().__init__(
            unknown_count=inner.unknown_count,
            batch_shape=inner.batch_shape,
            input_count=inner.input_count,
            blocks=inner.blocks,
            direction_count=direction_count,
            pose_sensitivities=inner.pose_sensitivities,
            device=inner.device,
        )
        self.inner = inner
        self.arrow, self.rounding, self.measured = inner.arrow, inner.rounding, inner.measured
        for name in ("inputs", "unknowns"):
            self.write(name, inner.read(name))

    @property
    def guess_integrations(self) -> NDArray[np.integer[Any]] | int:  # noqa: D102
        return self.inner.guess_integrations

    # ---- what a subclass says ----

    def inner_inputs(self, unknowns: FloatArray) -> FloatArray:
        """Rows of the inner problem's inputs at ``unknowns`` (instance_count, n), shape (instance_count, input_count)."""
        return self.read("inputs")

    def _corrected(self, gamma: FloatArray, directions: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``Gamma`` and the pose's columns by the unknowns, of this problem instead of the inner one.

        Args:
            gamma: Of the inner problem, shape (instance_count, n, n).
            directions: Derivatives of its residual by all its directions, shape (instance_count, n, k).
            pose: Its pose columns, shape (instance_count, 6, n + k), by unknowns then directions; (instance_count, 6, 1) without.
        """
        return gamma, pose[:, :, : self.unknown_count]

    @abstractmethod
    def around(self, inner: BoundaryProblem, instances: IntArray) -> Self:
        """The same of some instances, (k,), around a part of ``inner``."""

    # ---- the same as within ----

    @contextmanager
    def presented(self) -> Iterator[None]:
        """Within it, the inner problem is at the unknowns, inputs and loads of this one, of the instances that are active here;
        then its loads and its instances are as they were."""
        inner, unknowns = self.inner, self.read("unknowns")
        inner.stop, inner.breakpoints = self.stop, self.breakpoints
        inner.write("unknowns", unknowns)
        inner.write("inputs", self.inner_inputs(unknowns))
        with inner.at_load(self.buffer("load_factor")), inner.only(self.buffer("active") != 0):
            yield

    def _integrate(self) -> None:
        inner, active, count = self.inner, self.active.numpy() != 0, self.direction_count
        own = inner.directions.numpy().copy()
        own[:, :count] = self.directions.numpy()[:, :count]
        inner.directions.assign(own)
        with self.presented():
            inner.integrate()
        n = self.unknown_count
        slopes, columns = inner.residual_directions.numpy(), inner.pose_columns.numpy()
        gamma, pose = self._corrected(inner.read("gamma").reshape(-1, n, n), slopes, columns)
        found = {name: inner.read(name) for name in COPIED} | {"gamma": gamma.reshape(len(gamma), -1)}
        for name, values in found.items():
            self.write(name, np.where(active[:, None], values, self.read(name)))
        for mine, theirs in ((self.fault, inner.fault), (self.step_count, inner.step_count)):
            mine.assign(np.where(active, theirs.numpy(), mine.numpy()))
        if count:
            before = self.residual_directions.numpy()
            self.residual_directions.assign(np.where(active[:, None, None], slopes[:, :, :count], before))
        if self.pose_sensitivities:
            both = np.concatenate([pose, columns[:, :, n : n + count]], axis=2)
            self.pose_columns.assign(np.where(active[:, None, None], both, self.pose_columns.numpy()))

    def guess(self) -> FloatArray:  # noqa: D102
        return self.inner.guess()

    def unheld(self, instance: int) -> str:  # noqa: D102
        return self.inner.unheld(instance)

    def loose(self) -> list[str]:  # noqa: D102
        return self.inner.loose()

    @property
    def natural_singular_value(self) -> FloatArray:  # noqa: D102
        with self.presented():
            return self.inner.natural_singular_value

    @property
    def natural_gamma(self) -> FloatArray | None:  # noqa: D102
        with self.presented():
            return self.inner.natural_gamma

    def adopt(self, unknowns: FloatArray) -> FloatArray:  # noqa: D102
        return self.inner.adopt(unknowns)

    def takes(self, name: str) -> bool:  # noqa: D102
        return self.inner.takes(name)

    def pack(self, inputs: Inputs) -> FloatArray:  # noqa: D102
        return self.inner.pack(inputs)

    def part_ends(self, names: Sequence[str]) -> FloatArray:  # noqa: D102
        self.inner.write("inputs", self.read("inputs"))
        apart = self.inner.part_ends(names)
        self.write("inputs", self.inner.read("inputs"))
        return apart

    def input_slice(self, name: str) -> slice:  # noqa: D102
        return self.inner.input_slice(name)

    def curvature_scale(self) -> FloatArray:  # noqa: D102
        return self.inner.curvature_scale()

    def load_scale(self) -> FloatArray:  # noqa: D102
        with self.presented():
            return self.inner.load_scale()

    def load_change(self, before: FloatArray) -> FloatArray:  # noqa: D102
        with self.presented():
            return self.inner.load_change(before)

    def turning(self, before: FloatArray | None = None) -> FloatArray:  # noqa: D102
        with self.presented():
            return self.inner.turning(before)

    @property
    def shapes(self) -> Shapes | None:  # noqa: D102
        return None if self.inner.shapes is None else WrappedShapes(self)

    @property
    def periods(self) -> FloatArray | None:  # noqa: D102
        return self.inner.periods

    @property
    def kinks(self) -> NDArray[np.intp]:  # noqa: D102
        return self.inner.kinks

    @property
    def kink_inputs(self) -> NDArray[np.intp]:  # noqa: D102
        return self.inner.kink_inputs

    def kinks_give(self) -> NDArray[np.bool_]:  # noqa: D102
        return self.inner.kinks_give()

    @property
    def starts(self) -> Starts | None:  # noqa: D102
        return self.inner.starts

    @property
    def parts(self) -> Parts | None:  # noqa: D102
        return None if self.inner.parts is None else WrappedParts(self)


class WrappedShapes(Shapes):
    """The inner problem's, at the unknowns of the outer one."""

    def __init__(self, problem: WrappedProblem) -> None:
        self.problem = problem

    def at_nodes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:  # noqa: D102
        inner = self.problem.inner.shapes
        assert inner is not None  # or nothing was offered
        with self.problem.presented():
            return inner.at_nodes(node_count)

    def jumps(self) -> tuple[FloatArray, ...]:  # noqa: D102
        inner = self.problem.inner.shapes
        assert inner is not None
        with self.problem.presented():
            return inner.jumps()


class WrappedParts(Parts):
    """Parts of the inner problem, each with the outer one around it again."""

    def __init__(self, problem: WrappedProblem) -> None:
        self.problem = problem

    def of(self, instances: IntArray, *, double: bool = False, poses: bool = False) -> BoundaryProblem:  # noqa: D102
        assert self.problem.inner.parts is not None
        return self._around(self.problem.inner.parts.of(instances, double=double, poses=poses), instances)

    @property
    def may_be_finer(self) -> bool:  # noqa: D102
        inner = self.problem.inner.parts
        return inner is not None and inner.may_be_finer

    def finer(self, instances: IntArray, *, poses: bool = False) -> BoundaryProblem | None:  # noqa: D102
        assert self.problem.inner.parts is not None
        part = self.problem.inner.parts.finer(instances, poses=poses)
        return None if part is None else self._around(part, instances)

    def _around(self, inner: BoundaryProblem, instances: IntArray) -> WrappedProblem:
        result = self.problem.around(inner, instances)
        result.stop = self.problem.stop
        for name in ("inputs", "unknowns"):
            result.write(name, self.problem.read(name)[instances])
        return result


class WrappedSegments(Segments):
    """Segments of the inner problem, for a subclass that changes where they begin, or what follows from the unknowns there."""

    def __init__(self, inner: Segments) -> None:
        self.inner = inner
        self.variation_size, self.device = inner.variation_size, inner.device
        self.unknown_places: NDArray[np.intp] = inner.unknown_places

    @property
    def direction_count(self) -> int:  # noqa: D102
        return self.inner.direction_count

    def length(self, instances: IntArray) -> FloatArray:  # noqa: D102
        return self.inner.length(instances)

    def base_state(self, instances: IntArray, unknowns: FloatArray) -> FloatArray:  # noqa: D102
        return self.inner.base_state(instances, unknowns)

    def propagate(self, cuts: Cuts, level: FloatArray) -> Propagation:  # noqa: D102
        return self.inner.propagate(cuts, level)

    def difference(self, instances: IntArray, states: FloatArray, others: FloatArray) -> FloatArray:  # noqa: D102
        return self.inner.difference(instances, states, others)

    def moved(self, instances: IntArray, states: FloatArray, variations: FloatArray) -> FloatArray:  # noqa: D102
        return self.inner.moved(instances, states, variations)

    def growth(self, cuts: Cuts, found: Propagation) -> FloatArray:  # noqa: D102
        return self.inner.growth(cuts, found)

    def tip_pose(self, cuts: Cuts, found: Propagation) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        return self.inner.tip_pose(cuts, found)

    def tip_pose_columns(self, cuts: Cuts, found: Propagation, variations: FloatArray) -> FloatArray:  # noqa: D102
        return self.inner.tip_pose_columns(cuts, found, variations)

    def shapes(self, points: dict[int, Breakpoints], node_count: int) -> tuple[tuple[Shape, ...], FloatArray, FloatArray]:  # noqa: D102
        return self.inner.shapes(points, node_count)
