"""Results: an equilibrium of each instance."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal, Self, Unpack

import numpy as np

from multirod.assembly import Robot_co
from multirod.batch import Instances, along, chosen
from multirod.naming import Asked, hinted, names_checked
from multirod.results import derivatives
from multirod.results.remarks import Remarks
from multirod.results.wrenches import Wrenches
from multirod.status import Status, Statuses
from multirod.types import AxesGiven, AxesOrArray, Index, Name, Named, Numbers, Parameter, Quantity, SaveOptions
from multirod.validation import FloatArray

_OTHER_NAMES = {
    **dict.fromkeys(("tip", "pose", "tip_pose", "end_effector"), "tip_position and tip_rotation"),
    **dict.fromkeys(
        ("position", "shape", "shapes", "centreline", "arclength", "curvature"), "rod(0), which has position and more"
    ),
    **dict.fromkeys(("at", "point", "interpolate"), "along(arclength)"),
    **dict.fromkeys(("angle", "angles", "joint_angles", "joint_coordinates"), "joint_angle(name), of a joint of a Network"),
    **dict.fromkeys(("slide", "slides", "joint_slides"), "joint_slide(name), of a joint of a Network"),
    **dict.fromkeys(
        ("reaction", "reactions", "base_force", "base_moment", "base_wrench", "joint_force", "joint_wrench", "wrenches"),
        "wrench(rod, end), what an end of a rod does to what holds it",
    ),
    **dict.fromkeys(("torque", "motor_torque", "actuator_torque", "joint_torque"), "base_torque, or wrench(rod, end)"),
    "rotation": "tip_rotation, or rod(0).rotation along a rod",
    **dict.fromkeys(("converged", "success", "ok"), "status, or failed"),
    **dict.fromkeys(("message", "reason"), "status.message"),
    **dict.fromkeys(("counts", "statuses"), "status.counts(), of a batch"),
    **dict.fromkeys(("platform_position", "platform_rotation", "platform_pose"), "tip_position and tip_rotation, the platform's"),
    **dict.fromkeys(("leg", "tube"), "rod(0), by its number or its name"),
    **dict.fromkeys(("leg_force", "leg_forces", "leg_wrench", "leg_wrenches"), 'wrench(leg, "tip"), of each leg on the platform'),
    **dict.fromkeys(("error", "errors", "accuracy", "error_estimate"), "tip_error, in metres, or residual"),
    **dict.fromkeys(("reached", "part", "load_level", "load_factor_reached"), "load_factor"),
    **dict.fromkeys(("is_stable", "stable"), "stability"),
    **dict.fromkeys(("displacement", "displacements", "line_lengths"), "line_length, or inputs.displacement"),
    **dict.fromkeys(("tensions", "line_tension", "line_tensions"), "tension"),
    **dict.fromkeys(("translation", "translations"), "inputs.translation"),
    **dict.fromkeys(("rods", "backbone", "centerline", "centerlines"), "rod(0), rod(1), ..., or robot.rods"),
    **dict.fromkeys(("compliance", "tip_compliance", "flexibility"), 'jacobian("tip_force"), or stiffness'),
    **dict.fromkeys(("stiffness_matrix", "tip_stiffness"), "stiffness"),
    **dict.fromkeys(("J", "manipulability", "jacobians"), 'jacobian("rotation"), by the names of inputs'),
    **dict.fromkeys(("snapped", "snap", "snaps", "buckled"), "events, or status"),
    **dict.fromkeys(("to_csv", "to_netcdf"), 'save("name.csv") or save("name.nc")'),
    **dict.fromkeys(("to_pandas", "to_dataframe"), 'to_xarray().to_dataframe(), or save("name.csv")'),
    **dict.fromkeys(("show", "animate"), "plot(), or those of a motion, mr.simulate(...).show()"),
}  # what attributes of a solution are called elsewhere


class SolveError(RuntimeError):
    """Raised by ``Solution.raise_if_failed`` where an instance has no result."""


class IncompleteWarning(UserWarning):
    """Of a list that is known to lack something, or may lack something at a place that is known."""


class Solution(Asked, Wrenches[Robot_co]):
    """Equilibria of all instances; every array has the batch's leading axes ``...`` and is read-only: change a copy of it.

    An instance that failed has NaN in every array but ``status``, ``residual``, ``iterations`` and ``integrations``,
    which say how it ended; a solution is neither true nor false, ``if solution:`` raises ``TypeError``. Shapes, energy, stability
    and Jacobians are computed when they are first asked for: of a large batch, ask for those of the instances of interest,
    ``solution[index].rod(0)``.
    """

    called = _OTHER_NAMES
    _remarks: Remarks | None = None  # of a task, for recordings
    _columns: derivatives.Columns | None = None  # of the pose, where the integrations of a tracker carried them

    def __getitem__(self, index: Index) -> "Solution[Robot_co]":
        """The solution of some instances: ``index`` as for an array with the leading axes ``batch_shape``.

        Raises:
            IndexError: If there are no such instances.
        """
        rows = chosen(self, np.arange(len(self._records)).reshape(self.batch_shape), index)
        flat = rows.reshape(-1)
        instances = flat if self._instances is None else self._instances[flat]
        scene = replace(self._scene, batch_shape=rows.shape)
        return Solution(scene, self._records[flat], self._outcome.take(flat), self._whole, instances)

    def __iter__(self) -> "Iterator[Solution[Robot_co]]":
        """Along the first of the leading axes.

        Raises:
            TypeError: If there is none.
        """
        return along(self)

    def jacobian(
        self: "Solution[Named[Name]]",  # type: ignore[type-var]  # a robot, by what its inputs are called
        *names: "Name | Parameter",
        of: Literal["pose", "line_length", "tension", "position", "rotation", "curvature", "wrench"] = "pose",
        at: Numbers | None = None,
        rod: int | str | None = None,
    ) -> FloatArray:
        """Derivative of the end effector's pose by inputs or parameters of the robot, at equilibrium, or of what is along it.

        Several take one integration together: ``jacobian("rotation", "translation")`` has the columns of each beside each other,
        in the order named.

        Args:
            *names: Inputs, such as ``"tip_force"`` (then it is the compliance) or ``"rotation"``, or ``"precurvature"`` [1/m],
                ``"bending_stiffness"``, ``"torsional_stiffness"`` [N m^2], ``"length"`` [m], ``"foundation"`` [N/m^2],
                ``"magnetisation"`` [A m] of each section of each rod, ``"base"``, ``"platform"`` (``docs/derivatives.md`` says
                what stays as it is meanwhile, and of which robots).
            of: ``"pose"`` of the end effector, ``"line_length"`` or ``"tension"`` of lines; or, at places along a rod,
                ``"position"``, ``"rotation"``, ``"curvature"`` or ``"wrench"``, as of ``along``.
            at: Of the last four, arclengths from the base [m], one or several, rising, as ``rod(k).arclength``, which begins
                with 0.
            rod: Of them too, index or name of the rod; not needed of one rod, or of tubes in each other, whose first it is.

        Returns:
            Shape (..., 6, k): position rows [m per unit], then rotation-vector rows [rad per unit], both in the world frame;
            one column for each component of an input, or each rod or line. Of lines, shape (..., line_count, k). Along a rod,
            shape (..., 3, k) or (..., count, 3, k), with 6 rows of wrenches: positions, rotation vectors and wrenches in the
            world, curvatures in the frame of the rod [1/m]. Columns by parameters run over rods, then over as many sections of
            each as any has, then over components: three of vectors, ``EI_x`` and ``EI_y`` of ``bending_stiffness``; columns of
            sections that a rod has not are zero. Of ``base`` position, then rotation vector about it, in the world, of each leg
            of parallel robots; of ``platform`` those of each leg's attachment, in the platform's frame.

        Raises:
            TypeError: If the assembly takes no such input, or none is named.
            ValueError: If ``of`` is none of these, ``at`` is not on the rod, no rod is said of several that stand
                apart, or ``at`` or ``rod`` is given of another.
            NotImplementedError: If the assembly does not give these derivatives.
        """
        return self._jacobian(names, of, at, rod)

    def _jacobian(self, names: tuple[object, ...], of: str, at: Numbers | None, rod: int | str | None) -> FloatArray:
        return derivatives.jacobian(self, names, of, at, rod)

    if not TYPE_CHECKING:  # which knows its names
        jacobian = hinted('what it is by comes first, jacobian("rotation", "tip_force")')(jacobian)

    def along(
        self,
        at: Numbers,
        *,
        of: Literal["position", "rotation", "curvature", "wrench"] = "position",
        rod: int | str | None = None,
    ) -> FloatArray:
        """What a rod is at given arclengths: of what ``jacobian(..., of=, at=, rod=)`` has the derivatives.

        By an integration that ends a step at each place: as exact as the solve, where ``rod(k)`` has nodes and nothing between.

        Args:
            at: Arclengths from the base [m], one or several, rising, as ``rod(k).arclength``; where a section ends, just before,
                and at the base, 0, just behind: by 1e-12 of the length.
            of: ``"position"`` in the world [m], ``"rotation"`` of the rod's own frame, body to world, ``"curvature"`` in that
                frame [1/m], or ``"wrench"``: force [N] and moment about the place [N m], in the world, that what lies beyond the
                place exerts on what lies before it, of all tubes in each other and their lines: at 0 what ``wrench()`` says, at a
                tip that something holds the opposite of ``wrench(rod, "tip")``.
            rod: Index or name of the rod, as of ``jacobian``.

        Returns:
            Shape (..., 3), of rotations (..., 3, 3), of wrenches (..., 6), or with several arclengths (..., count, 3) and so on.
            NaN where there is no result, and of what multiple shooting found.

        Raises:
            ValueError: If ``of`` is none of these, there is no such rod, none is said, or ``at`` is not on it.
            NotImplementedError: If the assembly does not give this.
        """
        return derivatives.along(self, at, of, rod)

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

    if not TYPE_CHECKING:
        vjp = hinted('what it is by is named, vjp(cotangent, wrt=("rotation", "tip_force"))')(vjp)

    @cached_property
    def stiffness(self) -> FloatArray:
        """Stiffness of the end effector, shape (..., 6, 6): force [N], then moment [N m], by its position, then rotation vector.

        What a small displacement of the end effector takes, all inputs as they are: the inverse of the compliance by
        ``tip_force`` and ``tip_moment``, so that a column moves it one way and holds the five others. A force alone meets less,
        often far less: ``np.linalg.inv(solution.jacobian("tip_force")[..., :3, :])``. In the axes of the world, about the origin
        of the end effector. Symmetric where its loads have a potential (``docs/derivatives.md``). NaN where nothing moves it some
        way, as along a straight rod that does not stretch, which a ``RuntimeWarning`` says, and where there is no result.

        Raises:
            AttributeError: If something holds the end.
        """
        return derivatives.stiffness(self)

    def save(self, path: str | PathLike[str], **options: Unpack[SaveOptions]) -> None:
        """Write the solution to a file, by its ending (``docs/files.md``).

        Args:
            path: File to write; an existing one is replaced, and there is a whole one or none. ``.npz`` holds all of it, for
                ``mr.load``; ``.csv`` the centrelines, or ends; ``.nc`` what ``to_xarray`` makes; ``.glb``, ``.obj``, ``.ply`` and
                ``.stl`` what ``to_mesh`` does.
            **options: ``nodes`` of a rod, for all but ``.npz``; of meshes also ``corners``; of ``.csv`` ``rows="instances"``.

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
        instances: int | None = None,
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
        ``tips``        the end effector of each instance, a point in 3-D
        ``curvature``   ``u1, u2, u3`` in the frame of each rod [1/m]
        ``moment``      the internal moment of each rod, in its frame [N m]
        ``force``       the internal force in that frame [N], of all concentric rods together
        ``strain``      bending and torsion at the surface of rods that have an outer diameter, extension and shear of rods that
                        stretch or shear [%]
        ``tension``     what each line pulls with along its rod [N]; of a history, over time
        ==============  ==========================================================================================================

        A batch is drawn as a family of shapes or curves, without lines, discs and loads. Instances that failed are left out, and
        the title says so. ``plt.show()`` is not called.

        Args:
            quantity: One of the above.
            ax: Axes to draw on, 3-D ones for a shape; by default those of a new figure. Along the arclength, several rods or
                instances need an array of them, one for each component.
            rod: Index or name of the only rod to be drawn; all by default.
            instances: How many instances of a batch are drawn at most, evenly chosen among those that have a result; by default
                20, of tips all.
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
            reached = float(self.load_factor.reshape(-1)[first])
            named = self._named(status, first)
            beyond = self.assembly.beyond_limits(self, first) if status is Status.OUT_OF_LIMITS else ""
            part = "" if np.isnan(reached) else f", {reached:.1%} of the load reached"
            raise SolveError(
                f"{where}{status.name} after {self._outcome.iterations.reshape(-1)[first]} iterations, "
                f"residual {self.residual.reshape(-1)[first]:.3g} 1/m{part}{beyond}: {status.message}{named}"
            )
        return self

    def _named(self, status: Status, instance: int) -> str:
        """Which part of the assembly it is, where there are several, as the end of a message."""
        sensitive = status in (Status.STALLED, Status.MAX_ITERATIONS, Status.INTEGRATION_LIMIT)
        if not sensitive and status not in (Status.LOOSE, Status.OUT_OF_REACH):
            return ""
        with self._problem() as problem:
            if sensitive:
                return problem.too_long(instance)
            if status is Status.OUT_OF_REACH:
                return problem.reach.said(instance) if problem.reach is not None else ""
            name = problem.loose()[instance]
            return f" (body {name!r} moves most)" if name else problem.unheld(instance)

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
        from multirod.results import html

        return html.solution(self)

    @property
    def _asides(self) -> dict[str, str]:
        """What a kind of result says beside what all say, by name; of a single one."""
        return {}

    @property
    def _without(self) -> str:
        return f"; dropped {', '.join(map(str, self.dropped))}" if self.dropped else ""

    def _counts(self, chosen: Instances) -> str:
        counts = Statuses.of(self._outcome.status.reshape(-1)[chosen]).counts()
        return ", ".join(f"{count} {status}" for status, count in counts.items())
