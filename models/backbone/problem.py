"""One backbone as a boundary problem: what it integrates, and what it offers beside.

What a reader may look for stands elsewhere: which terms a scene needs in ``terms``, what the unknowns mean in ``unknowns``, the
arrays of kernels in ``passes.buffers``, passes over nodes in ``nodes``, derivatives by inputs and parameters in ``derivatives``,
lengths, stiffnesses and loads as numbers in ``sizes``.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import Any, TypedDict, Unpack

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import LineTest
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.kernels.warp_types import Struct
from multirod.launch import expect, longest
from multirod.models.backbone import unknowns as meaning
from multirod.models.backbone.derivatives.derivatives import BackboneDerivatives, BackboneSensing
from multirod.models.backbone.derivatives.designs import PARAMETERS
from multirod.models.backbone.derivatives.ends import part_ends
from multirod.models.backbone.inputs import CALLED, DRIVES, NOT_TAKEN
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.layout import residuals_of, unknowns_of
from multirod.models.backbone.kernels.layout.members import drive_slices, drives
from multirod.models.backbone.kernels.layout.rows import INPUT_VECTORS, DesignOffsets, InputOffsets, input_size
from multirod.models.backbone.members.driven import DrivenLines
from multirod.models.backbone.nodes.node_passes import NodePasses
from multirod.models.backbone.parts import BackboneParts
from multirod.models.backbone.passes import shortcuts
from multirod.models.backbone.passes.buffers import Buffers
from multirod.models.backbone.passes.lane_pass import LanePass
from multirod.models.backbone.segments.segments import BackboneSegments
from multirod.models.backbone.shapes import BackboneShapes
from multirod.models.backbone.sizes import Sizes
from multirod.models.backbone.stability.clamps import BackboneClamps, ClampedBackbones
from multirod.models.backbone.stability.condensing.form_kernels import make_form
from multirod.models.backbone.stability.conjugates import BackboneConjugates
from multirod.models.backbone.stability.mode_bounds import may_be_bounded
from multirod.models.backbone.stability.mode_bounds_kernels import make_mode_bounds
from multirod.models.backbone.stability.stability import BackboneStability
from multirod.models.backbone.starts import BackboneStarts
from multirod.models.backbone.terms import problem_features, takes
from multirod.problem import BoundaryProblem
from multirod.profile import DEGREE
from multirod.rod import Rod, RodArrays, lower
from multirod.validation import FloatArray


class ProblemOptions(TypedDict, total=False):
    """How a ``BackboneProblem`` is made, beside its rods, inputs and integrator."""

    device: str
    pose: bool
    pose_sensitivities: bool
    direction_count: int
    lengths: bool
    design: Sequence[str]
    enabled: Sequence[str]
    held: bool
    pieces: int
    first_moment: IntArray | int
    load_directions: int
    varied: bool
    telling: bool


class BackboneProblem(BoundaryProblem):
    """One backbone of n >= 1 concentric rods, clamped at its base, loaded along its length and at its free tip.

    Unknowns are, in curvature units (``docs/model.md``, equation 10): for a single rod the curvature at its base; for several
    the bending moment there, if any load acts, and their torques; then, where a follower force acts, the base force.
    With ``held`` the tip is not free: the base force is unknown too, the pose and wrench of the tip are written out with their
    columns, and of the residual only the torques of the rods that end before it. ``arrays`` are those of ``rods``, or of several
    backbones of the same build along the last batch axis. Of several ``pieces``, the rod is clamped between them by moments that
    stand among the directions, of each instance from the number ``first_moment`` on, one for all or (instance_count,); the
    ``load_directions`` before them change what acts along the rod. Where it is not ``varied``, directions are moments of clamps
    alone, and those of other rods have no columns. What is ``telling`` is integrated by the kernel that tells of solutions, as if
    it had directions, and none besides is compiled.
    """

    def __init__(
        self,
        rods: Sequence[Rod],
        base: FloatArray,
        inputs: Inputs,
        *,
        integrator: Integrator,
        device: str = "cpu",
        transmission: bool = False,
        pose: bool = True,
        pose_sensitivities: bool = False,
        direction_count: int = 0,
        lengths: bool = False,
        design: Sequence[str] = (),
        enabled: Sequence[str] = (),
        held: bool = False,
        arrays: RodArrays | None = None,
        pieces: int = 1,
        first_moment: IntArray | int = 0,
        load_directions: int = 0,
        varied: bool = True,
        telling: bool = False,
    ) -> None:
        arrays = lower(rods) if arrays is None else arrays
        batch_shape = np.broadcast_shapes(inputs.batch_shape, arrays.batch_shape, base.shape[:-2])
        self.rods = tuple(rods)
        self.base = base
        self.integrator = integrator
        self.enabled = frozenset(enabled)
        self.inputs_given = inputs
        self.options: ProblemOptions = {
            "device": device,
            "enabled": tuple(enabled),
            "pose": pose,
            "pose_sensitivities": pose_sensitivities,
            "direction_count": direction_count,
            "lengths": lengths,
            "design": tuple(design),
            "held": held,
            "telling": telling,
        }
        self.transmission = transmission
        self.held = held
        self.arrays = arrays.take(batch_shape)
        self.features = self._features(inputs)
        self.slots = unknowns_of(self.features)
        self.rows = residuals_of(self.slots)
        self.drives = drives(self.features.members)
        self.drive_count = len(self.drives)
        self.first_drive = InputOffsets(len(rods)).DRIVES  # of a row of inputs
        self._slices: dict[str, slice] = {}  # what was asked for: a search asks again and again
        self._taken: dict[str, bool] = {}
        self._form_expected = False
        self.renewals = 0  # how often it has served again
        n = self.slots.size
        super().__init__(
            unknown_count=n,
            batch_shape=batch_shape,
            input_count=input_size(len(rods), self.drive_count),
            blocks=meaning.blocks_of(self.features),
            direction_count=direction_count,
            pose_sensitivities=pose_sensitivities,
            device=device,
        )
        if design:
            offsets = DesignOffsets(self.arrays.degree + 1, self.features.loads)
            width = self.input_count + self.arrays.end[0].size * offsets.SIZE
            self.directions = wp.zeros((self.instance_count, max(direction_count, 1), width), dtype=wp.float64, device=device)
        columns = n + direction_count
        # of lines: what ``lengths`` asks for
        self.line_length: Any = wp.zeros((self.instance_count, self.drive_count), dtype=wp.float64, device=device)
        shape = (self.instance_count, self.drive_count, columns if self.features.lengths or self.features.condition_count else 0)
        self.line_length_columns: Any = wp.zeros(shape, dtype=wp.float64, device=device)
        # of several rods, below the pose's, how each turns against the frame, and beside them by how much it is turned
        self.angle_columns: Any = self.pose_columns
        if pose_sensitivities and self.features.turning_count:
            shape = (self.instance_count, 6 + self.features.turning_count, columns + 1)
            self.angle_columns = wp.zeros(shape, dtype=wp.float64, device=device)
            self.pose_columns = self.angle_columns[:, :6, :columns]
        if held:
            self.tip_wrench: Any = wp.zeros((self.instance_count, 6), dtype=wp.float64, device=device)
            self.wrench_columns: Any = wp.zeros((self.instance_count, 6, columns), dtype=wp.float64, device=device)
        self.rounding = float(np.finfo(integrator.precision).eps)
        self.measured = inputs.measured
        self.sizes, self.buffers = Sizes(self), Buffers(self)
        self.nodes, self.derivatives = NodePasses(self), BackboneDerivatives(self)
        self.table = self.buffers.table(inputs)
        self._packed = self.pack(inputs)
        self.write("inputs", self._packed)
        self.judged_often = self._judged_by_solves  # whether the second variation is condensed by a kernel of its own
        if self.held:  # what is found is judged, always: it is compiled while the others are
            self.expect_form()
        if may_be_bounded(self):
            expect(make_mode_bounds, device)
        self._call = self.buffers.call_at_equal_steps()
        self.launch: LanePass | ClampedBackbones
        if pieces > 1:
            first = np.broadcast_to(first_moment, self.instance_count)
            self.launch = ClampedBackbones(self, pieces, first, load_directions)
        elif varied:
            self.launch = self.lane_pass(self.features, self._call)
        else:
            self.launch = self.lane_pass(replace(self.features, directions=False), self._call, columns=(n, 0))

    def _features(self, inputs: Inputs) -> Features:
        options = self.options
        return problem_features(
            self.arrays,
            (*inputs.active, *self.enabled),
            inputs.profiles,
            self.integrator,
            transmission=self.transmission,
            held=self.held,
            design=options["design"],
            pose=options["pose"],
            lengths=options["lengths"],
            pose_sensitivities=options["pose_sensitivities"],
            directions=options["direction_count"] > 0 or options["telling"],
        )

    # ---- the integration ----

    def lane_pass(
        self, features: Features, call: Struct, table: Struct | None = None, *, columns: tuple[int, int] | None = None
    ) -> LanePass:
        """A launch; ``columns`` by unknowns and by directions, all by default."""
        # what looks at a solution, or judges it, is double precision whatever the solve's own integrations are
        precision = "float64" if features.nodes or features.design else self.integrator.precision
        return LanePass(
            features,
            self.integrator,
            precision,
            table or self.table,
            call,
            (features.unknown_count, self.direction_count) if columns is None else columns,
            self.device,
            longest=max(1, longest(self.device) // len(self.rods)),
            heed=self.heed_stop,
        )

    # ---- what is offered ----

    @property
    def stability(self) -> BackboneStability:  # noqa: D102
        return BackboneStability(self)

    @property
    def shapes(self) -> BackboneShapes:  # noqa: D102
        return BackboneShapes(self)

    @cached_property
    def lines(self) -> DrivenLines:  # noqa: D102
        return DrivenLines(self)

    @property
    def result_test(self) -> LineTest | None:  # noqa: D102
        return LineTest(self.lines) if self.features.discs and self.features.condition_count else None

    @property
    def starts(self) -> BackboneStarts:  # noqa: D102
        return BackboneStarts(self)

    @property
    def parts(self) -> BackboneParts:  # noqa: D102
        return BackboneParts(self)

    @property
    def segments(self) -> BackboneSegments | None:  # noqa: D102
        return None if len(self.rods) > 1 or self.held else self.cut

    @cached_property
    def cut(self) -> BackboneSegments:
        """The segments of a single rod, for those who know that it is one."""
        return BackboneSegments(self)

    @property
    def may_be_clamped(self) -> bool:
        """Whether places along it can be clamped: not along several rods, or by lines of given length, nor under forces of whose
        stability nothing is told."""
        terms = self.features
        told = all(load.is_judged() for load in terms.loads)
        return len(self.rods) == 1 and told and not (terms.condition_count or terms.friction)

    @cached_property
    def clamps(self) -> BackboneClamps | None:  # noqa: D102
        return BackboneClamps(self, self.launch) if isinstance(self.launch, ClampedBackbones) else None

    @cached_property
    def conjugates(self) -> BackboneConjugates | None:  # noqa: D102
        return None if self.held or not self.pose_sensitivities else BackboneConjugates(self)

    @property
    def kinks(self) -> NDArray[np.intp]:  # noqa: D102
        return meaning.kinks(self) if self.features.condition_count else super().kinks

    @property
    def kink_inputs(self) -> NDArray[np.intp]:  # noqa: D102
        return meaning.kink_inputs(self) if self.features.condition_count else super().kink_inputs

    def kinks_give(self) -> NDArray[np.bool_]:  # noqa: D102
        return self.lines.give() if self.features.condition_count else super().kinks_give()

    # ---- the interface ----

    def renew(self, inputs: Inputs) -> bool:  # noqa: D102
        if inputs.profiles or self.inputs_given.profiles or any(name in NOT_TAKEN for name in inputs.given):
            return False
        self._clear()
        if inputs is not self.inputs_given:
            self.inputs_given, self._packed = inputs, self.pack(inputs)
        self.write("inputs", self._packed)
        self.renewals += 1
        return True

    def expect_judging(self) -> None:  # noqa: D102
        if self._may_condense:
            self.judged_often = True
            if not self._form_expected:
                self._form_expected = True
                expect(make_form, self.device)

    def expect_form(self) -> None:
        """Have the kernel that condenses the second variation compiled meanwhile, if it will be asked for."""
        if self.judged_often:
            expect(make_form, self.device)

    @cached_property
    def _may_condense(self) -> bool:
        """Whether a kernel may condense the second variation: without conditions on lines."""
        return not self.features.condition_count

    @cached_property
    def _judged_by_solves(self) -> bool:
        """Whether solves look at stability so often that a kernel pays which all such rods share: on the processor, of what is
        multistable, as rods are whose tips are held."""
        return self._may_condense and (self.held or self.features.turning_count > 0) and self._host is not None

    def _clear(self) -> None:
        super()._clear()
        self.judged_often = self._judged_by_solves
        self.derivatives.followed = ()
        for name in ("cut", "conjugates"):
            self.__dict__.pop(name, None)

    def _zeros(self) -> list[Any]:
        lines = (self.line_length, self.line_length_columns) if self.drive_count else ()
        return [*super()._zeros(), *lines, *((self.tip_wrench, self.wrench_columns) if self.held else ())]

    def takes(self, name: str) -> bool:  # noqa: D102
        if name not in self._taken:
            self._taken[name] = takes(self.features, name)
        return self._taken[name]

    def pack(self, inputs: Inputs) -> FloatArray:  # noqa: D102
        packed = super().pack(inputs)
        packed[:, -1] = 1.0  # scale of the load profiles
        return packed

    def input_slice(self, name: str) -> slice:  # noqa: D102
        found = self._slices.get(name)
        if found is None:
            found = self._slices[name] = self._slice_of(name)
        return found

    def _slice_of(self, name: str) -> slice:
        if name in DRIVES:
            return drive_slices(self.drives, self.first_drive).get(name, slice(self.first_drive, self.first_drive))
        start = InputOffsets(len(self.rods)).of(name)
        return slice(start, start + (3 if CALLED.get(name, name) in INPUT_VECTORS else len(self.rods)))

    def aim(self, *names: str) -> None:
        """As said; what depends on inputs and unknowns is found at each integration."""
        self._point(*names)
        self.derivatives.refresh(self._direction_view)

    def _point(self, *names: str) -> None:
        """Aim, but for what the next integration finds."""
        self.derivatives.follow(names)
        if self.derivatives.followed and self._direction_view is not None:
            self.derivatives.point(self._direction_view)
        else:
            super().aim(*names)

    def integrate_along(self, *names: str) -> None:  # noqa: D102
        self._point(*names)
        self.integrate()

    def leaves_columns(self, *names: str) -> bool:  # noqa: D102
        if len(self.kinks) or not self.pose_sensitivities:
            return False
        return "base" not in names and (self.eliminates or not any(name in PARAMETERS for name in names))

    def part_ends(self, names: Sequence[str]) -> FloatArray:  # noqa: D102
        return part_ends(self, names, [(self.arrays, self.input_slice("translation"))], self.inputs_given)

    def _integrate(self) -> None:
        if self.derivatives.followed:
            if self._direction_view is None:
                super().aim(*self.derivatives.followed)
            self.derivatives.refresh(self._direction_view)
        self.launch.launch()

    @property
    def launches(self) -> tuple[Any, ...] | None:  # noqa: D102
        return self.launch.recorded if isinstance(self.launch, LanePass) and not self.derivatives.followed else None

    @cached_property
    def _coarse(self) -> LanePass | None:
        return shortcuts.coarse(self)

    @property
    def coarse(self) -> LanePass | None:  # noqa: D102
        if self._coarse is not None and self._coarse.listed != self.listed:
            self._coarse.set_dim(self.listed)
        return None if self.derivatives.followed else self._coarse

    def coarse_turning(self) -> FloatArray:  # noqa: D102
        return shortcuts.coarse_turning(self)

    def _pass_over(self, instances: IntArray | None) -> None:
        super()._pass_over(instances)
        self.launch.set_dim(self.listed)

    def integrate_alike(self) -> bool:  # noqa: D102
        return shortcuts.integrate_alike(self)

    @contextmanager
    def without_poses(self) -> Iterator[None]:
        """As said, for many single rods at fixed steps, whose kernels round alike with and without the pose."""
        with shortcuts.without_poses(self, self._call):
            yield

    def guess(self) -> FloatArray:  # noqa: D102
        return meaning.guess(self)

    def adopt(self, unknowns: FloatArray) -> FloatArray:  # noqa: D102
        others = {} if unknowns.shape[1] == self.unknown_count else meaning.related(self.features)
        return meaning.adopted(self, unknowns) if unknowns.shape[1] in others else super().adopt(unknowns)

    def directions_by(self, name: str) -> FloatArray:
        """As said, or along each number of a parameter."""
        return super().directions_by(name) if name not in PARAMETERS else self.derivatives.directions_by(name)

    def aimed(self, *names: str) -> tuple[FloatArray, FloatArray]:
        """As said; by parameters too, the unknowns fixed."""
        slopes, moved = super().aimed(*names)
        self.derivatives.fix_unknowns(names, slopes, moved)
        return slopes, moved

    def along(self, names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:  # noqa: D102
        return self.derivatives.along(names, rod, places)

    def sensing(self, places: FloatArray) -> BackboneSensing:  # noqa: D102
        return BackboneSensing(self.derivatives, places)

    def curvature_scale(self) -> FloatArray:  # noqa: D102
        return self.sizes.curvature

    def load_scale(self) -> FloatArray:  # noqa: D102
        inputs = self.read("inputs")
        return self.found_for("load_scale", inputs, lambda: self.sizes.load(inputs)).copy()

    def load_change(self, before: FloatArray) -> FloatArray:  # noqa: D102
        return self.sizes.load_change(before)

    @property
    def has_potential(self) -> bool:
        """Whether all but vectors of the inputs derives from one: load profiles, and the laws of the tip and of lines."""
        moments = self.features.profile_degree >= 0 and bool(self.table.profile.numpy().reshape(-1, 6, DEGREE + 1)[:, 3:].any())
        conservative = all(load.conservative for load in self.features.loads)
        return conservative and not (moments or self.features.measured or self.features.friction)

    @property
    def turned(self) -> slice:  # noqa: D102
        return self.input_slice("rotation")

    def turning(self, before: FloatArray | None = None) -> FloatArray:  # noqa: D102
        angles = self.read("inputs")[:, self.turned]
        if before is not None:
            return np.asarray(np.ptp(angles - before[:, self.turned], axis=1))
        return np.asarray(angles.max(axis=1) - angles.min(axis=1) + self.sizes.twist)

    @property
    def on_host(self) -> bool:
        """Whether NumPy sees its arrays in place."""
        return self._host is not None

    def each(self, values: FloatArray) -> FloatArray:
        """Values of the rods' batch, one an instance."""
        return np.broadcast_to(values, (self.instance_count, *values.shape[1:]))

    def another(
        self, base: FloatArray, inputs: Inputs, arrays: RodArrays, integrator: Integrator, **changes: Unpack[ProblemOptions]
    ) -> "BackboneProblem":
        """A problem of other instances of the same rods, by the same options but for some."""
        options: ProblemOptions = {**self.options, **changes}
        return BackboneProblem(
            self.rods, base, inputs, integrator=integrator, transmission=self.transmission, arrays=arrays, **options
        )
