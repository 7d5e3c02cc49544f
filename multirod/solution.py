"""Results: an equilibrium of each instance."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields, replace
from functools import cached_property
from math import prod
from os import PathLike
from threading import Event, Lock
from typing import TYPE_CHECKING, Any, Generic, Literal, Self, Unpack

import numpy as np
from numpy.typing import NDArray

from multirod import derivatives, plausibility
from multirod.assembly import Robot_co
from multirod.batch import Instances, IntArray, parts, run, take
from multirod.capabilities import Lines
from multirod.events import BranchEvent
from multirod.inputs import Inputs
from multirod.problem import BoundaryProblem, LineShape, Shape
from multirod.remarks import Remarks
from multirod.reuse import borrowed
from multirod.scene import Scene, stand_in
from multirod.segments import taken
from multirod.solver import SETTLED, Outcome
from multirod.stability import Modes, Stabilities, Stability, modes_of
from multirod.status import Status, Statuses, failures
from multirod.types import (
    AxesGiven,
    AxesOrArray,
    Index,
    Name,
    Named,
    Numbers,
    Parameter,
    Quantity,
    SaveOptions,
    StabilityOrArray,
    StatusOrArray,
)
from multirod.validation import FloatArray, Kind, frozen, meant, names_checked, positive_int, refuse

if TYPE_CHECKING:
    from multirod.models.backbone.members.lines import Line
    from multirod.studies.terms.simplify import Dropped

DEFAULT_NODE_COUNT = 51
_OTHER_NAMES = {
    **dict.fromkeys(("tip", "pose", "tip_pose", "end_effector"), "tip_position and tip_rotation"),
    **dict.fromkeys(
        ("position", "shape", "shapes", "centreline", "arclength", "curvature"), "rod(0), which has position and more"
    ),
    "rotation": "tip_rotation, or rod(0).rotation along a rod",
    **dict.fromkeys(("converged", "success", "ok"), "status, or failed"),
    **dict.fromkeys(("message", "reason"), "status.message"),
    "rods": "rod(0), rod(1), ..., or robot.rods",
}  # what attributes of a solution are called elsewhere


class SolveError(RuntimeError):
    """Raised by ``Solution.raise_if_failed`` where an instance has no result."""


class IncompleteWarning(UserWarning):
    """Of a list that is known to lack something, or may lack something at a place that is known."""


def _potential(problem: BoundaryProblem) -> tuple[FloatArray]:
    return (np.full(problem.instance_count, np.nan) if problem.stability is None else problem.stability.potential(),)


def _modes(problem: BoundaryProblem) -> tuple[Any, ...]:
    return tuple(vars(modes_of(problem)).values())


def _known(names: Sequence[str | None]) -> str:
    """How a rod or line may be called."""
    own = [name for name in names if name]
    return f"must be an index below {len(names)}{f' or one of the names {own}' if own else '; none has a name'}"


class Solution(Generic[Robot_co]):
    """Equilibria of all instances; every array has the batch's leading axes ``...`` and is read-only: change a copy of it.

    An instance that failed has NaN in every array but ``status``, ``residual``, ``iterations`` and ``integrations``,
    which say how it ended. Shapes, energy, stability and Jacobians are computed when they are first asked for: of a large batch,
    ask for those of the instances of interest, ``solution[index].rod(0)``.
    """

    _remarks: Remarks | None = None  # of a task, for recordings

    def __init__(
        self,
        scene: Scene[Robot_co],
        records: FloatArray,
        outcome: Outcome,
        inputs: Inputs | None = None,
        instances: IntArray | None = None,
    ) -> None:
        self._scene = scene
        self._records = records
        self._outcome = outcome
        self._inputs = inputs  # of the whole batch
        self._instances = instances  # of it, in the order of the records; None is all
        self.columns: derivatives.Columns | None = None  # of the pose, where the integrations of a tracker carried them
        self._last_shapes: tuple[int, tuple[tuple[Shape, ...], FloatArray]] | None = None
        self._strain_said = False

    def __getitem__(self, index: Index) -> "Solution[Robot_co]":
        """The solution of some instances: ``index`` as for an array with the leading axes ``batch_shape``.

        Raises:
            IndexError: If there are no such instances.
        """
        numbers: Any = np.arange(len(self._records)).reshape(self.batch_shape)
        rows = numbers[index]
        flat = rows.reshape(-1)
        chosen = flat if self._instances is None else self._instances[flat]
        scene = replace(self._scene, batch_shape=rows.shape)
        return Solution(scene, self._records[flat], self._outcome.take(flat), self._whole, chosen)

    def mind_strain(self, shapes: tuple[Shape, ...] | None = None) -> None:
        """Warn once, by a ``PlausibilityWarning``, where the outer fibre of a rod is strained more than it bears.

        At the base of a single rod, as soon as it is solved; everywhere once its shape is asked for. Estimates and failures are
        left out.
        """
        if self._strain_said or all(rod.outer_diameter is None for rod in self.assembly.rods):
            return
        unsettled = ~np.isin(self._outcome.status.reshape(-1), SETTLED)
        if shapes is None:
            unknowns = self._records[:, self._scene.fields["unknowns"]]
            self._strain_said = plausibility.of_bases(self.assembly, unknowns, unsettled)
        else:
            from multirod.strains import bound, largest

            if bound(self.assembly.rods, shapes) <= plausibility.STRAIN:
                return
            strain = largest(self, [self._whole_shape(shape) for shape in shapes]).reshape(-1, len(shapes))
            self._strain_said = plausibility.of_strains(self.assembly, np.where(unsettled[:, None], np.nan, strain))

    @property
    def dropped(self) -> tuple["Dropped", ...]:
        """The terms that ``simplify`` left out of ``assembly`` and ``inputs``; none by default."""
        return self._scene.dropped

    @property
    def assembly(self) -> Robot_co:
        """The robot."""
        return self._scene.assembly

    @property
    def robot(self) -> Robot_co:
        """The robot, as ``assembly``."""
        return self._scene.assembly

    if not TYPE_CHECKING:  # which knows what there is

        def __getattr__(self, name: str) -> object:
            if hasattr(type(self), name):  # it refused, and says why
                return object.__getattribute__(self, name)
            hint = f"; did you mean {_OTHER_NAMES[name]}?" if name in _OTHER_NAMES else ""
            raise AttributeError(f"{type(self).__name__} has no {name!r}{hint}", name=name, obj=None if hint else self)

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
        """What was applied."""
        if self._instances is None:
            return self._whole
        taken = self._whole.take(self._axes, self._instances)
        arrays = {name: getattr(taken, name) for name in taken.arrays}
        if not taken.batch_shape:
            return taken
        return taken.with_arrays({name: value.reshape(*self.batch_shape, value.shape[-1]) for name, value in arrays.items()})

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

    def body_position(self, body: str) -> FloatArray:
        """Position of the frame of a body in the world [m], shape (..., 3).

        Raises:
            AttributeError: If the assembly has no bodies: ``Network`` has.
            ValueError: If there is no such body.
        """
        index = self._body_index(body)
        return self._masked(self._body_poses[0][:, index], (3,))

    def body_rotation(self, body: str) -> FloatArray:
        """Rotation of a body, body to world, shape (..., 3, 3).

        Raises:
            AttributeError, ValueError: As ``body_position``.
        """
        index = self._body_index(body)
        return self._masked(self._body_poses[1][:, index], (3, 3))

    def _body_index(self, body: str) -> int:
        index: Callable[[str], int] | None = getattr(self.assembly, "body_index", None)
        if index is None:
            raise AttributeError(f"{type(self.assembly).__name__} has no bodies: Network has")
        return index(body)

    @cached_property
    def _body_poses(self) -> list[FloatArray]:
        return self._gather(lambda problem: problem.body_poses())  # type: ignore[attr-defined]  # of a network

    @cached_property
    def end_force(self) -> FloatArray:
        """What holds the end of the rod pulls it with, in the world [N], shape (..., 3).

        Raises:
            AttributeError: If nothing holds it: then it is zero.
        """
        return self._reaction("force")

    @cached_property
    def end_moment(self) -> FloatArray:
        """What holds the end of the rod turns it with, about that end, in the world [N m], shape (..., 3).

        Raises:
            AttributeError: If nothing holds it: then it is zero.
        """
        return self._reaction("moment")

    def _reaction(self, kind: str) -> FloatArray:
        """The wrench on the end less what else acts there."""
        if not self.assembly.end_held:
            raise AttributeError(f"nothing holds the end of {type(self.assembly).__name__}: HeldRod has reactions there")
        shape = self._shape_pass(self._default_node_count)[0][-1]
        carried = np.einsum("bij,bj->bi", shape.rotation[:, -1], getattr(shape, f"total_{kind}")[:, -1])
        given = np.broadcast_to(getattr(self.inputs, f"tip_{kind}"), (*self.batch_shape, 3)).reshape(-1, 3)
        return self._masked(carried - given, (3,))

    @property
    def energy(self) -> FloatArray:
        """Elastic energy of all rods [J], shape (...)."""
        return self._masked(self._shape_pass(self._default_node_count)[1], ())

    @cached_property
    def potential(self) -> FloatArray:
        """Total potential energy [J], shape (...): elastic energy less the work that dead forces and weight did from the base.

        NaN where the loads have no potential: moments, and what follows the tip.
        """
        return self._masked(self._gather(_potential)[0], ())

    @cached_property
    def _modes(self) -> Modes:
        modes = Modes(*self._gather(_modes))
        modes.known[self._failed] = False
        modes.diverging[self._failed] = False
        return modes

    @cached_property
    def index(self) -> NDArray[np.int32] | Any:  # noqa: ANN401  (``types`` says why)
        """Unstable modes of each equilibrium (its Morse index), shape (...); -1 where it cannot be said."""
        return self._shaped(self._modes.index) if self.batch_shape else int(self._modes.index[0])

    @cached_property
    def stability(self) -> StabilityOrArray | Any:  # noqa: ANN401  (``types`` says why)
        """``Stability`` of each equilibrium, shape (...); a ``Stability`` where there are no leading axes."""
        values = self._modes.stability
        return Stabilities.of(self._shaped(values)) if self.batch_shape else Stability(int(values[0]))

    @cached_property
    def stability_margin(self) -> FloatArray:
        """Least eigenvalue of the second variation, condensed to tips and platform, over ``K/L``, shape (...).

        Positive where the equilibrium is stable, zero at a fold or bifurcation, negative beyond, ``-inf`` where an unstable mode
        leaves the tip at rest. It is 1 for an unloaded straight rod of equal section. ``K`` is the least stiffness of a
        backbone's rods, for several legs their mean bending stiffness, ``L`` the length, or the mean of the legs'. NaN where it
        cannot be said.
        """
        return np.asarray(self._shaped(self._modes.eigenvalue(0)))

    @property
    def _default_node_count(self) -> int:
        steps = self._scene.integrator.steps
        return DEFAULT_NODE_COUNT if steps is None else steps + 1

    def rod(self, rod: int | str = 0, *, nodes: int | None = None) -> Shape:
        """Shape of one rod on nodes evenly spaced along its arclength; arrays (..., node_count, ...).

        Args:
            rod: Index or name.
            nodes: Number of nodes; by default one a step at fixed steps, else 51. A shape that cannot be told there, of a taut
                rod in too few steps, is NaN (``docs/stability.md``, equation 19).

        Raises:
            ValueError: If there is no such rod, or ``nodes`` is not an integer >= 2.
        """
        index = self._rod_index(rod)
        count = self._default_node_count if nodes is None else positive_int("nodes", nodes, 2)
        return self._whole_shape(self._shape_pass(count)[0][index])

    def _whole_shape(self, shape: Shape) -> Shape:
        """With the leading axes, and NaN where there is no result."""
        return Shape(**{name: self._masked(value, value.shape[1:]) for name, value in vars(shape).items()})

    @property
    def strain(self) -> FloatArray:
        """Largest strain of the outermost fibre of each rod, shape (..., rod_count); 0.01 is 1 %.

        By bending and stretching, ``r |u_xy - u*_xy| + |v_z - 1|`` with ``2 r`` the outer diameter, on the nodes of ``rod(k)``:
        where it is largest between two of them, or just beyond the end of a section, it is a little more. Torsion and shear are
        no part of it; ``plot("strain")`` draws all four. NaN of rods without an outer diameter.
        """
        from multirod.strains import largest

        return np.asarray(frozen(largest(self, [self.rod(k) for k in range(self.assembly.rod_count)])))

    def _rod_index(self, rod: int | str) -> int:
        """Number of a rod, from the first."""
        names = [r.name for r in self.assembly.rods]
        index = names.index(rod) if isinstance(rod, str) and rod in names else rod
        if isinstance(index, bool) or not isinstance(index, (int, np.integer)) or not -len(names) <= index < len(names):
            tubes = [name for name in names if name and isinstance(rod, str) and name.rpartition(" ")[0] == rod]
            hint = f"; did you mean {tubes[0]!r}, the first of its {len(tubes)} tubes?" if tubes else ""
            refuse("rod", rod, _known(names) + (hint or (meant(rod, filter(None, names)) if isinstance(rod, str) else "")))
        return int(index) % len(names)

    @cached_property
    def tension(self) -> FloatArray:
        """Tension of each line [N], negative where it pushes, shape (..., line_count), in the order of the rods' lines.

        Of a chamber, less its pressure times its area; of a tendon with friction, where it leaves the base.

        Raises:
            AttributeError: If no rod has lines.
        """
        return self._of_lines(lambda lines: lines.tension())

    @cached_property
    def slack(self) -> np.ma.MaskedArray[Any, np.dtype[np.bool_]]:
        """Whether each line hangs loose, shape (..., line_count), in their order; masked where there is no result.

        An array of bools has no NaN: what is masked prints as ``--``, and is neither counted nor chosen by it.

        Raises:
            AttributeError: If no rod has lines.
        """
        loose = self._of_lines(lambda lines: lines.slack())
        return np.ma.MaskedArray(frozen(loose == 1), mask=frozen(np.isnan(loose)))

    @cached_property
    def line_length(self) -> FloatArray:
        """Length of each line between its start and its end on the rod [m], shape (..., line_count).

        Of a chamber whose area in the section is fixed, its volume over that.

        Raises:
            AttributeError: If no rod has lines.
        """
        return self._of_lines(lambda lines: lines.length())

    def _of_lines(self, ask: Callable[[Lines], NDArray[Any]], *tail: int) -> FloatArray:
        """What lines say, shape (..., line_count, *tail)."""
        count = len(self._lines())

        def answers(problem: BoundaryProblem) -> tuple[FloatArray]:
            if problem.lines is None:
                raise NotImplementedError(f"{type(problem).__name__} says nothing of lines")
            return (np.asarray(ask(problem.lines), dtype=np.float64),)

        return self._masked(self._gather(answers)[0], (count, *tail))

    def line(self, line: int | str, *, nodes: int | None = None) -> LineShape:
        """Where a line is, on nodes evenly spaced along its rod; arrays (..., node_count, ...).

        Args:
            line: Index, in the order of the rods' lines, or name.
            nodes: Number of nodes; by default one a step at fixed steps, else 51.

        Raises:
            ValueError: If there is no such line, or ``nodes`` is not an integer >= 2.
        """
        lines = self.assembly.lines
        names = [own.name for _, own in lines]
        index = names.index(line) if isinstance(line, str) and line in names else line
        if isinstance(index, bool) or not isinstance(index, (int, np.integer)) or not -len(names) <= index < len(names):
            refuse("line", line, _known(names))
        rod, own = lines[index]
        shape = self.rod(rod, nodes=nodes)
        s = shape.arclength - np.broadcast_to(self.inputs.translation[..., rod, None], (*self.batch_shape, 1))
        flat = own.offset_at(s.reshape(prod(self.batch_shape), -1), self._axes, self._instances)
        offset = flat.reshape(*s.shape, 2)
        position = shape.position + (shape.rotation[..., :2] @ offset[..., None])[..., 0]
        tension = np.where(np.isnan(offset[..., 0]), np.nan, self.tension[..., index, None])
        if own.rubs:
            tension = tension * self._of_lines(lambda lines: lines.left(s.shape[-1]), s.shape[-1])[..., index, :]
        return LineShape(shape.arclength, position, tension)

    def _lines(self) -> "list[tuple[int, Line]]":
        if not self.assembly.lines:
            raise AttributeError("no rod has lines")
        return self.assembly.lines

    def _each(self, values: FloatArray) -> FloatArray:
        """Rows of an input, one an instance."""
        return np.broadcast_to(values, (*self.batch_shape, values.shape[-1])).reshape(-1, values.shape[-1])

    def _parameter(self, values: FloatArray, tail: int) -> FloatArray:
        """A parameter of the robot, of the instances at hand: itself where it has none but the last ``tail`` axes."""
        if values.ndim == tail:
            return values
        rows = take(values, self._axes, self._instances, tail=tail)
        return np.asarray(rows.reshape(*self.batch_shape, *values.shape[values.ndim - tail :]))

    def jacobian(
        self: "Solution[Named[Name]]",  # type: ignore[type-var]  # a robot, by what its inputs are called
        *names: "Name | Parameter",
        of: Literal["pose", "line_length", "tension", "position", "rotation", "curvature"] = "pose",
        at: Numbers | None = None,
        rod: int | str = 0,
    ) -> FloatArray:
        """Derivative of the end effector's pose by inputs or parameters of the robot, at equilibrium, or of what is along it.

        Several take one integration together: ``jacobian("rotation", "translation")`` has the columns of each beside each other,
        in the order named.

        Args:
            *names: Inputs, such as ``"tip_force"`` (then it is the compliance) or ``"rotation"``, or ``"precurvature"`` [1/m],
                ``"bending_stiffness"``, ``"torsional_stiffness"`` [N m^2], ``"length"`` [m] of each section of each rod,
                ``"base"``, ``"platform"`` (``docs/derivatives.md`` says what stays as it is meanwhile, and of which robots).
            of: ``"pose"`` of the end effector, ``"line_length"`` or ``"tension"`` of lines; or, at places along a rod,
                ``"position"``, ``"rotation"`` or ``"curvature"``.
            at: Of the last three, arclengths from the base [m], one or several, rising, as ``rod(k).arclength``.
            rod: Of them too, index or name of the rod.

        Returns:
            Shape (..., 6, k): position rows [m per unit], then rotation-vector rows [rad per unit], both in the world
            frame; one column for each component of an input, or each rod or line. Of lines, shape (..., line_count, k). Along a
            rod, shape (..., 3, k) or (..., count, 3, k): positions and rotation vectors in the world, curvatures in the frame of
            the rod [1/m]. Columns by parameters run over rods, then over as many sections of each as any has, then over
            components: three of ``precurvature``, ``EI_x`` and ``EI_y`` of ``bending_stiffness``; columns of sections that a rod
            has not are zero. Of ``base`` position, then rotation vector about it, in the world, of each leg of parallel robots;
            of ``platform`` those of each leg's attachment, in the platform's frame.

        Raises:
            TypeError: If the assembly takes no such input, or none is named.
            ValueError: If ``of`` is none of these, or ``at`` is not on the rod.
            NotImplementedError: If the assembly does not give these derivatives.
        """
        return self._jacobian(names, of, at, rod)

    def _jacobian(self, names: tuple[object, ...], of: str, at: Numbers | None, rod: int | str) -> FloatArray:
        return derivatives.jacobian(self, names, of, at, rod)

    def vjp(
        self: "Solution[Named[Name]]",  # type: ignore[type-var]
        cotangent: Numbers,
        *,
        of: Literal["tip_pose", "tip_position"] = "tip_pose",
        wrt: "Sequence[Name | Parameter] | Name | Parameter",
    ) -> Mapping[str, FloatArray]:
        """Derivatives of a scalar that depends on the end effector's pose, by inputs and parameters: one transposed solve.

        Args:
            cotangent: Its derivative by position [per m] and rotation vector [per rad] of the end effector, both in the world,
                shape (..., 6), or by position alone, (..., 3); the leading axes broadcast to the batch's.
            of: ``"tip_pose"`` or ``"tip_position"``.
            wrt: One name or several, as for ``jacobian``.

        Returns:
            By each name, shape (..., k), in the order of the columns of ``jacobian``; NaN where there is no result.

        Raises:
            TypeError, ValueError, NotImplementedError: As for ``jacobian``, or if the cotangent does not fit.
        """
        return derivatives.vjp(self, cotangent, of, wrt)

    @cached_property
    def stiffness(self) -> FloatArray:
        """Stiffness of the end effector, shape (..., 6, 6): force [N], then moment [N m], by its position, then rotation vector.

        What a small displacement of the end effector takes, all inputs as they are: the inverse of the compliance by
        ``tip_force`` and ``tip_moment``. In the axes of the world, about the origin of the end effector. Symmetric where its
        loads have a potential (``docs/derivatives.md``). NaN where nothing moves it some way, as along a straight rod that
        does not stretch, and where there is no result.

        Raises:
            AttributeError: If something holds the end.
        """
        return derivatives.stiffness(self)

    def save(self, path: str | PathLike[str], **options: Unpack[SaveOptions]) -> None:
        """Write the solution to a file, by its ending (``docs/files.md``).

        Args:
            path: File to write; an existing one is replaced, and there is a whole one or none. ``.npz`` holds all of it, for
                ``mr.load``; ``.csv`` the centrelines; ``.nc`` what ``to_xarray`` makes of it; ``.glb``, ``.obj``, ``.ply`` and
                ``.stl`` what ``to_mesh`` does.
            **options: ``nodes`` of a rod, for all but ``.npz``; of meshes also ``corners``.

        Raises:
            TypeError: If there is no such option.
            ValueError: If the ending is none of these, or ``.npz`` cannot hold it: robots of other packages.
            ImportError: If a package is missing that the file needs; the message says what to install.
        """
        from multirod.files.saving import save_result

        save_result(path, self, options)

    def to_xarray(self, *, nodes: int | None = None) -> Any:  # noqa: ANN401  (xarray need not be there)
        """An ``xarray.Dataset`` with named axes, units and the robot, which netCDF and Zarr take as it is.

        Axes are ``time`` of a history, ``instance`` of a batch (``instance_0`` and so on of several axes), ``component``,
        ``rod``, ``line``, ``unknown``. Failed instances are NaN; ``status`` says why.

        Args:
            nodes: Nodes of a rod, for arclength, position, rotation, curvature, moment and force along the rods to be included;
                None, the default, is without.

        Raises:
            ImportError: If xarray is missing: ``pip install "multirod[xarray]"``.
        """
        from multirod.files.datasets import dataset

        return dataset(self, nodes)

    def to_mesh(self, *, nodes: int | None = None, corners: int = 24) -> Any:  # noqa: ANN401  (trimesh need not be there)
        """A ``trimesh.Scene`` of tubes, swept along their centrelines, and platforms [m], each a closed surface of its own name.

        Tubes are as thick as their diameters; what has none is as thick as recordings show it. Failed instances are left out.

        Args:
            nodes: Nodes of a rod, as for ``rod``.
            corners: Of the polygons in the place of circles; they lie on these.

        Raises:
            ValueError: If no instance has a result, or there are more than 100: choose some, ``solution[index]``.
            ImportError: If trimesh is missing: ``pip install "multirod[mesh]"``.
        """
        from multirod.files.meshes import scene

        return scene(self, nodes, corners)

    @names_checked
    def plot(
        self,
        quantity: Quantity = "shape",
        *,
        ax: AxesGiven | None = None,
        rod: int | str | None = None,
        instances: int = 20,
        colour_by: str | Numbers | None = None,
        colour_label: str = "",
        nodes: int | None = None,
        frames: bool = True,
        loads: bool = True,
    ) -> AxesOrArray:
        """Plot the shape in space, or a quantity along the arclength, by matplotlib (``docs/plotting.md``).

        ==============  ==========================================================================================================
        quantity        what is drawn
        ==============  ==========================================================================================================
        ``shape``       the robot in 3-D, to scale: rods, lines, discs, platform, joints; frames at bases and tip; loads as arrows
        ``curvature``   ``u1, u2, u3`` in the frame of each rod [1/m]
        ``moment``      the internal moment of each rod, in its frame [N m]
        ``force``       the internal force in that frame [N], of all concentric rods together
        ``strain``      bending and torsion at the surface of rods that have an outer diameter, extension and shear of rods that
                        stretch or shear [%]
        ==============  ==========================================================================================================

        A batch is drawn as a family of shapes or curves, without lines, discs and loads. Instances that failed are left out, and
        the title says so. ``plt.show()`` is not called.

        Args:
            quantity: One of the above.
            ax: Axes to draw on, 3-D ones for a shape; by default those of a new figure. Along the arclength, several rods or
                instances need an array of them, one for each component.
            rod: Index or name of the only rod to be drawn; all by default.
            instances: How many instances of a batch are drawn at most, evenly chosen among those that have a result.
            colour_by: What instances are coloured by: an array of the batch's shape, or the name of a scalar such as
                ``"residual"`` or ``"energy"``; by default their number.
            colour_label: Of the colour bar.
            nodes: Of each rod; by default 51 in space, 301 along the arclength.
            frames: Whether frames are drawn.
            loads: Whether loads are drawn.

        Returns:
            The axes, or an array of them, shape (k,).

        Raises:
            ValueError: If there is no such quantity or rod, or ``ax`` is not what it takes.
            ImportError: If matplotlib is not there: ``pip install "multirod[plot]"``.
            NotImplementedError: If the assembly offers no shapes.
        """
        from multirod.plotting import plot_solution

        options: dict[str, Any] = {
            "instances": instances,
            "colour_by": colour_by,
            "colour_label": colour_label,
            "nodes": nodes,
            "frames": frames,
            "loads": loads,
        }
        return plot_solution(self, quantity, ax=ax, rod=rod, **options)

    def raise_if_failed(self) -> Self:
        """Return ``self`` if every instance has a result.

        Raises:
            SolveError: Otherwise; the message counts the failures and explains the first.
        """
        failed = self._failed
        if failed.any():
            first = int(np.argmax(failed))
            status = Status(int(self._outcome.status.reshape(-1)[first]))
            where = ""
            if failed.size > 1:
                where = f"{failed.sum()} of {failed.size} instances failed ({self._counts(failed)}); the first is {first}: "
            reached = self._outcome.reached
            moves = self._loose(first) if status is Status.LOOSE else ""
            part = "" if reached is None else f", {reached.reshape(-1)[first]:.1%} of the load reached"
            raise SolveError(
                f"{where}{status.name} after {self._outcome.iterations.reshape(-1)[first]} iterations, "
                f"residual {self.residual.reshape(-1)[first]:.3g} 1/m{part}: {status.message}{moves}"
            )
        return self

    def _loose(self, instance: int) -> str:
        """Which body of a loose network moves most, as the end of a message."""
        with self._problem() as problem:
            name = problem.loose()[instance]
        return f" (body {name!r} moves most)" if name else ""

    @contextmanager
    def _problem(self, piece: slice | None = None, **options: Any) -> Iterator[BoundaryProblem]:  # noqa: ANN401  (of the robot's own ``problem``)
        """A problem of a part of the instances at their inputs and unknowns; what failed has zeros, and no answers."""
        scene, instances = self._scene, self._instances
        if piece is not None:
            instances = np.arange(piece.start, piece.stop) if instances is None else instances[piece]
        options |= {"integrator": scene.integrator, "device": scene.device, "instances": instances}
        with borrowed(self.assembly, self._whole, **options) as problem:
            self._place(problem, piece)
            yield problem

    def _place(self, problem: BoundaryProblem, piece: slice | None) -> None:
        rows = slice(None) if piece is None else piece
        unknowns = problem.adopt(self._records[rows, self._scene.fields["unknowns"]])
        problem.write("unknowns", np.where(self._failed[rows, None], 0.0, unknowns))
        for name in ("position", "rotation"):  # by which a pass over nodes sees that it ends where the solve does
            problem.write(name, self._records[rows, self._scene.fields[name]])
        problem.breakpoints = taken(self._outcome.breakpoints, np.arange(len(self._records))[rows])

    def _gather(
        self,
        compute: Callable[[BoundaryProblem], tuple[Any, ...]],
        **options: Any,  # noqa: ANN401  (of the robot's own ``problem``)
    ) -> list[Any]:
        """Arrays that ``compute`` makes of problems, joined: of a large batch in parts, on the threads that solved it."""
        if not len(self._records):
            problem = stand_in(
                self.assembly, self._whole, integrator=self._scene.integrator, device=self._scene.device, **options
            )
            problem.write("unknowns", problem.guess())
            return [array[:0] for array in compute(problem)]
        pieces = parts(len(self._records), self._scene.threads, self.assembly.rod_count)
        found: dict[int, tuple[Any, ...]] = {}
        lock = Lock()

        def work(piece: slice, stop: Event) -> None:
            with ExitStack() as held:
                with lock:
                    problem = held.enter_context(self._problem(piece if len(pieces) > 1 else None, **options))
                    problem.stop = stop
                found[piece.start] = compute(problem)

        run(work, pieces, self._scene.threads)
        ordered = [found[piece.start] for piece in pieces]
        return [np.concatenate(arrays) if len(arrays) > 1 else arrays[0] for arrays in zip(*ordered, strict=True)]

    def _shape_pass(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:
        """Shapes of all rods and the energy; the last pass is kept, whatever other threads ask for meanwhile."""
        kept = self._last_shapes
        if kept is None or kept[0] != node_count:
            self._last_shapes = kept = node_count, self._all_shapes(node_count)
            self.mind_strain(kept[1][0])
        return kept[1]

    def _all_shapes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:
        names = [field.name for field in fields(Shape)]

        def flat(problem: BoundaryProblem) -> tuple[FloatArray, ...]:
            if problem.shapes is None:
                raise NotImplementedError(f"{type(self.assembly).__name__} offers no shapes")
            shapes, energy = problem.shapes.at_nodes(node_count)
            return energy, *(getattr(shape, name) for shape in shapes for name in names)

        energy, *arrays = self._gather(flat)
        count = len(names)
        return tuple(Shape(*arrays[k : k + count]) for k in range(0, len(arrays), count)), energy

    def __repr__(self) -> str:
        if not self.batch_shape:
            x, y, z = self.tip_position
            tip = "" if self.status.failed else f", tip ({x:.5g}, {y:.5g}, {z:.5g}) m"
            asides = "".join(f", {name} {value}" for name, value in self._asides.items())
            residual = f"{asides}, residual {float(self.residual):.2g} 1/m"
            events = "".join(f"; {event.said}" for event in self.events)
            return f"{type(self).__name__}({self.status.name}{tip}{residual}{self._without}{events})"
        return f"{type(self).__name__}(batch {self.batch_shape}: {self._counts(slice(None))}{self._without})"

    def _repr_html_(self) -> str:
        from multirod import html

        return html.solution(self)

    @property
    def _asides(self) -> dict[str, str]:
        """What a kind of result says beside what all say, by name; of a single one."""
        return {}

    @property
    def _without(self) -> str:
        return f"; dropped {', '.join(map(str, self.dropped))}" if self.dropped else ""

    def _counts(self, chosen: Instances) -> str:
        values, counts = np.unique(self._outcome.status.reshape(-1)[chosen], return_counts=True)
        return ", ".join(f"{count} {Status(int(value))}" for value, count in zip(values, counts, strict=True))
