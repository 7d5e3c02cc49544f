"""What a solver found: the records of all instances, as arrays with the leading axes of the batch."""

from functools import cached_property
from typing import TYPE_CHECKING, Any, Generic

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Robot_co
from multirod.batch import IntArray, Undecided, take
from multirod.inputs import Inputs
from multirod.read_only import ReadOnly
from multirod.results.events import BranchEvent
from multirod.results.scene import Scene
from multirod.solver import Outcome
from multirod.status import Status, Statuses, failures
from multirod.types import StatusOrArray
from multirod.validation import FloatArray, Kind, frozen

if TYPE_CHECKING:
    from multirod.studies.terms.simplify import Dropped


class Found(Undecided, ReadOnly, Generic[Robot_co]):
    """What a solver left of each instance; NaN where that is no result.

    Args:
        scene: What the instances have in common.
        records: Of the instances, in their order, shape (instance_count, record size).
        outcome: How each ended.
        inputs: Of the whole batch; by default they are unpacked from the records.
        instances: Numbers of the instances in the batch; all of them by default.
    """

    written = frozenset()
    instead = "copy what you want to change, np.array(...)"
    _scene: Scene[Robot_co]
    _records: FloatArray
    _outcome: Outcome
    _inputs: Inputs | None  # of the whole batch
    _instances: IntArray | None  # of it, in the order of the records; None is all

    def __init__(
        self,
        scene: Scene[Robot_co],
        records: FloatArray,
        outcome: Outcome,
        inputs: Inputs | None = None,
        instances: IntArray | None = None,
    ) -> None:
        vars(self).update(_scene=scene, _records=records, _outcome=outcome, _inputs=inputs, _instances=instances)

    @property
    def dropped(self) -> tuple["Dropped", ...]:
        """The terms that ``simplify`` left out of ``assembly`` and ``inputs``; none by default."""
        return self._scene.dropped

    @property
    def assembly(self) -> Robot_co:
        """What was solved: of some instances of a batch of designs, ``solution[index]``, all of these designs."""
        return self._scene.assembly

    @cached_property
    def robot(self) -> Robot_co:
        """The robot: of some instances of a batch of designs theirs alone, with the solution's leading axes.

        Raises:
            ValueError: If there are fewer than all, and the robot is, or has, something of another package.
        """
        if self._instances is None or not self.assembly.batch_shape:
            return self.assembly
        from multirod.files.instances import of_instances

        return of_instances(self.assembly, self._axes, self._instances.reshape(self.batch_shape))

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading axes."""
        return self._scene.batch_shape

    @cached_property
    def _whole(self) -> Inputs:
        if self._inputs is None:
            assert self._scene.unpack is not None
            return self._scene.unpack(self._records[:, self._scene.fields["inputs"]])
        return self._inputs

    @cached_property
    def inputs(self) -> Inputs:
        """What was applied; where the robot itself finds some of it, as an inverse problem its translations, what was found."""
        return self.assembly.inputs_of(self)

    @cached_property
    def _applied(self) -> Inputs:
        """Those of the instances, also of what failed."""
        if self._instances is None:
            return self._whole
        taken = self._whole.take(self._axes, self._instances)
        arrays = {name: getattr(taken, name) for name in taken.arrays}
        if not taken.batch_shape:
            return taken
        shape = self.batch_shape
        return taken.with_arrays({name: value.reshape(*shape, value.shape[-1]) for name, value in arrays.items()}, shape)

    @property
    def _axes(self) -> tuple[int, ...]:
        """Leading axes of the batch that the instances are numbered in."""
        return np.broadcast_shapes(self._whole.batch_shape, self.assembly.batch_shape)

    def _shaped(self, values: NDArray[Kind], tail: tuple[int, ...] = ()) -> NDArray[Kind]:
        return frozen(np.reshape(values, (*self.batch_shape, *tail)))

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Whether there is no result, ``Status.failed`` of each instance, shape (...)."""
        return np.asarray(self._shaped(self._failed))

    @cached_property
    def _failed(self) -> NDArray[np.bool_]:
        return failures(self._outcome.status.reshape(-1))

    @property
    def load_factor(self) -> FloatArray:
        """Part of the loads that was reached, from none to all at once, shape (...): 1 where there is a result.

        Where there is none because a branch ended, as by ``Shooting(at_fold="stop")``, where it did; in a motion it is the part
        of the way from the last sample. NaN where loads were not raised.
        """
        reached = np.nan if self._outcome.reached is None else self._outcome.reached.reshape(-1)
        return np.asarray(self._shaped(np.where(self._failed, reached, 1.0)))

    def _masked(self, values: FloatArray, tail: tuple[int, ...]) -> FloatArray:
        failed = self._failed
        if failed.any():
            values = np.array(values)
            values[failed] = np.nan
        return np.asarray(self._shaped(values, tail))

    def _record(self, name: str, tail: tuple[int, ...]) -> FloatArray:
        return self._masked(self._records[:, self._scene.fields[name]], tail)

    @cached_property
    def status(self) -> StatusOrArray | Any:  # noqa: ANN401  (``types`` says why)
        """``Status`` of each instance, shape (...); a ``Status`` where there are no leading axes.

        Which of the two it is, inputs say and no type checker: ``multirod.types`` says how it is typed, and why.
        """
        if not self.batch_shape:
            return Status(int(self._outcome.status.reshape(-1)[0]))
        return Statuses.of(self._shaped(self._outcome.status))

    @cached_property
    def events(self) -> tuple[BranchEvent, ...] | NDArray[np.object_] | Any:  # noqa: ANN401  (``types`` says why)
        """What happened on the way: a tuple of ``BranchEvent`` of each instance, shape (...); one where there are no axes.

        It is empty where no branch ended (``docs/branches.md``).
        """
        found = np.empty(len(self._records), dtype=object)
        for k in range(len(found)):
            found[k] = self._outcome.events.get(k, ())
        return self._shaped(found) if self.batch_shape else found[0]

    @cached_property
    def iterations(self) -> NDArray[np.int32]:
        """Iterations, shape (...)."""
        return np.asarray(self._shaped(self._outcome.iterations))

    @cached_property
    def integrations(self) -> NDArray[np.int32]:
        """Initial value problems integrated, per rod, shape (...)."""
        return np.asarray(self._shaped(self._outcome.integrations))

    @cached_property
    def residual(self) -> FloatArray:
        """What the solver drove to zero, max norm [1/m], shape (...)."""
        if self._outcome.residual is not None:
            return np.asarray(self._shaped(self._outcome.residual))
        residual = np.abs(self._records[:, self._scene.fields["residual"]]).max(axis=1)
        for k, points in self._outcome.breakpoints.items():
            residual[k] = points.gap
        return np.asarray(self._shaped(residual))

    @cached_property
    def rates(self) -> FloatArray:
        """Closed-loop rates of an observer [1/s], shape (..., n).

        Raises:
            AttributeError: If another solver was used.
        """
        if self._outcome.rates is None:
            raise AttributeError("only an observer that tracks has closed-loop rates")
        return self._masked(self._outcome.rates, (self.unknown_count,))

    @cached_property
    def boundary_residual(self) -> FloatArray:
        """Residual of the boundary conditions [1/m], shape (..., n)."""
        return self._record("residual", (self.unknown_count,))

    @property
    def unknown_count(self) -> int:
        """Unknowns of an instance."""
        field = self._scene.fields["unknowns"]
        return int(field.stop - field.start)

    @cached_property
    def unknowns(self) -> FloatArray:
        """The unknowns [1/m], for one rod ``u(0)``, shape (..., n)."""
        return self._record("unknowns", (self.unknown_count,))

    @cached_property
    def gamma(self) -> FloatArray:
        """``Gamma = d(residual)/d(unknowns)``, shape (..., n, n)."""
        n, field, elimination = self.unknown_count, self._scene.fields["gamma"], self.assembly.elimination
        if field.stop - field.start == n * n or elimination is None:
            return self._record("gamma", (n, n))
        return self._masked(elimination.dense(self._records[:, field]).reshape(len(self._records), -1), (n, n))

    @cached_property
    def _singular_values(self) -> FloatArray:
        n = self.unknown_count
        gamma = self.gamma.reshape(-1, n, n)
        result = np.full((len(gamma), n), np.nan)
        sound = np.isfinite(gamma).all(axis=(1, 2))
        result[sound] = np.linalg.svd(gamma[sound], compute_uv=False)
        return result

    @cached_property
    def condition(self) -> FloatArray:
        """Condition number of ``gamma``, shape (...)."""
        values = self._singular_values
        with np.errstate(divide="ignore"):
            return np.asarray(self._shaped(values[:, 0] / values[:, -1]))

    @cached_property
    def smallest_singular_value(self) -> FloatArray:
        """Smallest singular value of ``gamma``, shape (...): it vanishes at a fold."""
        return np.asarray(self._shaped(self._singular_values[:, -1]))

    @cached_property
    def determinant(self) -> FloatArray:
        """Determinant of ``gamma``, shape (...)."""
        with np.errstate(invalid="ignore"):
            return np.asarray(frozen(np.linalg.det(self.gamma)))

    @cached_property
    def tip_position(self) -> FloatArray:
        """Position of the end effector in the world [m], shape (..., 3)."""
        return self._record("position", (3,))

    @cached_property
    def tip_rotation(self) -> FloatArray:
        """Rotation of the end effector, body to world, shape (..., 3, 3)."""
        return self._record("rotation", (3, 3))

    def _each(self, values: FloatArray) -> FloatArray:
        """Rows of an input, one an instance."""
        return np.broadcast_to(values, (*self.batch_shape, values.shape[-1])).reshape(-1, values.shape[-1])

    def _parameter(self, values: FloatArray, tail: int) -> FloatArray:
        """A parameter of the robot, of the instances at hand: itself where it has none but the last ``tail`` axes."""
        if values.ndim == tail:
            return values
        rows = take(values, self._axes, self._instances, tail=tail)
        return np.asarray(rows.reshape((*self.batch_shape, *values.shape[values.ndim - tail :])))
