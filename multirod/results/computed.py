"""What is computed of equilibria when it is first asked for: shapes, lines, energies, stability."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import fields
from functools import cached_property
from math import prod
from threading import Event, Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod import plausibility
from multirod.assembly import Robot_co
from multirod.batch import parts, run
from multirod.by_name import the_only_backbone
from multirod.capabilities import Lines
from multirod.naming import meant
from multirod.problem import BoundaryProblem, LineShape, Shape
from multirod.results.error import finely, may_be_finer, tip_error
from multirod.results.found import Found
from multirod.results.scene import stand_in
from multirod.reuse import Loan, borrowed
from multirod.segments import taken
from multirod.stability import Modes, Stabilities, Stability, modes_of
from multirod.status import settled
from multirod.types import StabilityOrArray
from multirod.validation import FloatArray, frozen, index_of, known_as, positive_int, refuse

if TYPE_CHECKING:
    from multirod.models.backbone.members.lines import Line

DEFAULT_NODE_COUNT = 51


def _potential(problem: BoundaryProblem) -> tuple[FloatArray]:
    return (np.full(problem.instance_count, np.nan) if problem.stability is None else problem.stability.potential(),)


def _modes(problem: BoundaryProblem) -> tuple[Any, ...]:
    return tuple(vars(modes_of(problem)).values())


class Computed(Found[Robot_co]):
    """Found equilibria, and what problems at their unknowns say of them."""

    _last_shapes: tuple[int, tuple[tuple[Shape, ...], FloatArray]] | None = None
    _strain_said = False

    def mind_strain(self, shapes: tuple[Shape, ...] | None = None) -> None:
        """Warn once, by a ``PlausibilityWarning``, where the outer fibre of a rod is strained more than it bears.

        At the base of a single rod, as soon as it is solved; everywhere once its shape is asked for. Estimates and failures are
        left out.
        """
        if self._strain_said or all(rod.outer_diameter is None for rod in self.assembly.rods):
            return
        unsettled = ~settled(self._outcome.status.reshape(-1))
        if shapes is None:
            outer = self.assembly.rods[0].outer_diameter
            if outer is not None:
                unknowns = self._records[:, self._scene.fields["unknowns"]]
                diameter = self._parameter(np.asarray(outer), 0)
                self._strain_said = plausibility.of_bases(self.assembly, unknowns, unsettled, diameter.reshape(-1))
        else:
            from multirod.results.strains import bound, largest

            if bound(self.assembly.rods, shapes) <= plausibility.STRAIN:
                return
            strain = largest(self, [self._whole_shape(shape) for shape in shapes]).reshape(-1, len(shapes))
            self._strain_said = plausibility.of_strains(self.assembly, np.where(unsettled[:, None], np.nan, strain))

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

    @cached_property
    def tip_error(self) -> FloatArray:
        """How far the tip is off [m], shape (...): from that of the same equilibrium, integrated to 1e-11 and solved to 1e-9 1/m.

        It holds what steps along the rods leave, and the residual, such as an observer's. Newton's method goes on from what was
        found; NaN where that does not lead there, as where rounding hides the way (``MULTIPLE_SHOOTING``). What the model leaves
        out is no part of it.
        """
        return np.asarray(frozen(tip_error(self)))

    @property
    def _default_node_count(self) -> int:
        steps = self._scene.integrator.steps
        return DEFAULT_NODE_COUNT if steps is None else steps + 1

    def rod(self, rod: int | str | None = None, *, nodes: int | None = None) -> Shape:
        """Shape of one rod on nodes evenly spaced along its arclength; arrays (..., node_count, ...).

        Args:
            rod: Index or name; not needed where a robot is one rod, or tubes in each other, whose first it is.
            nodes: Number of nodes; by default one a step at fixed steps, else 51. A shape that cannot be told there, of a taut
                rod in too few steps, is NaN (``docs/stability.md``, equation 19).

        Raises:
            ValueError: If there is no such rod, none is said of several that stand apart, or ``nodes`` is not an integer >= 2.
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
        from multirod.results.strains import largest

        return np.asarray(frozen(largest(self, [self.rod(k) for k in range(self.assembly.rod_count)])))

    def _rod_index(self, rod: int | str | None) -> int:
        """Number of a rod, from the first, which it is where a robot has one backbone and none is named."""
        if rod is None:
            return the_only_backbone("rod", self.assembly)
        names = [r.name for r in self.assembly.rods]
        index = index_of("rod", rod, names)
        if index is None:
            tubes = [name for name in names if name and isinstance(rod, str) and name.rpartition(" ")[0] == rod]
            hint = f"; did you mean {tubes[0]!r}, the first of its {len(tubes)} tubes?" if tubes else ""
            refuse("rod", rod, known_as(names) + (hint or (meant(rod, filter(None, names)) if isinstance(rod, str) else "")))
        return index % len(names)

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
            ValueError: If there is no such line, or several of that name, or ``nodes`` is not an integer >= 2.
        """
        lines = self.assembly.lines
        names = [own.name for _, own in lines]
        index = index_of("line", line, names)
        if index is None:
            refuse("line", line, known_as(names))
        rod, own = lines[index]
        shape = self.rod(rod, nodes=nodes)
        s = shape.arclength - np.broadcast_to(self.inputs.translation[..., rod, None], (*self.batch_shape, 1))
        flat = own.offset_at(s.reshape(prod(self.batch_shape), s.shape[-1]), self._axes, self._instances)
        offset = flat.reshape(*s.shape, 2)
        position = shape.position + (shape.rotation[..., :2] @ offset[..., None])[..., 0]
        tension = np.where(np.isnan(offset[..., 0]), np.nan, self.tension[..., index, None])
        if own.rubs:
            tension = tension * self._of_lines(lambda lines: lines.left(s.shape[-1]), s.shape[-1])[..., index, :]
        return LineShape(shape.arclength, position, tension)

    def _lines(self) -> "list[tuple[int, Line]]":
        if not self.assembly.lines:
            raise AttributeError("no rod has lines; what a rod itself pulls or pushes with at an end is wrench(rod)")
        return self.assembly.lines

    def _problem(self, piece: slice | None = None, **options: Any) -> Loan:  # noqa: ANN401  (of the robot's own ``problem``)
        """A problem of a part of the instances at their inputs and unknowns; what failed has zeros, and no answers."""
        scene, instances = self._scene, self._instances
        if piece is not None:
            instances = np.arange(piece.start, piece.stop) if instances is None else instances[piece]
        options |= {"integrator": scene.integrator, "device": scene.device, "instances": instances}
        loan = borrowed(self.assembly, self._whole, **options)
        self._place(loan.problem, piece)
        return loan

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
        pieces = parts(len(self._records), self._scene.threads, self.assembly.rod_count, self._scene.device)
        if len(pieces) == 1:
            with self._problem(**options) as problem:
                return list(compute(problem))
        found: dict[int, tuple[Any, ...]] = {}
        lock = Lock()

        def work(piece: slice, stop: Event) -> None:
            with ExitStack() as held:
                with lock:
                    problem = held.enter_context(self._problem(piece, **options))
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
        shapes = tuple(Shape(*arrays[k : k + count]) for k in range(0, len(arrays), count))
        lost = ~self._failed & np.any([np.isnan(shape.position).any(axis=(1, 2)) for shape in shapes], axis=0)
        if lost.any() and may_be_finer(self._scene.integrator):
            return self._found_finely(lost, shapes, energy)
        return shapes, energy

    def _found_finely(
        self, lost: NDArray[np.bool_], shapes: tuple[Shape, ...], energy: FloatArray
    ) -> tuple[tuple[Shape, ...], FloatArray]:
        """The same, by finer steps of instances that are ``lost``, whose tips those of the solve do not lead to."""
        finer = finely(self, lost.reshape(self.batch_shape), rounded=True)
        others, stored = finer._all_shapes(shapes[0].arclength.shape[1])
        sound = ~finer._failed
        rows = np.flatnonzero(lost)[sound]

        def put(values: FloatArray, other: FloatArray) -> FloatArray:
            result = np.array(values)
            result[rows] = other[sound]
            return result

        every = (
            Shape(**{name: put(values, getattr(other, name)) for name, values in vars(shape).items()})
            for shape, other in zip(shapes, others, strict=True)
        )
        return tuple(every), put(energy, stored)
