"""Rods of one build, integrated in one launch, each in the frame of its own base.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.inputs import Inputs
from multirod.kernels.warp_types import Struct
from multirod.models.backbone.passes.lane_pass import cost_of
from multirod.models.backbone.problem import BackboneProblem
from multirod.models.backbone.units import unit_stiffness
from multirod.models.network.elements import records
from multirod.models.network.elements.elements import TURNING
from multirod.models.network.graph import Graph
from multirod.models.platform.inputs import LEG_INPUTS
from multirod.models.platform.platform_kernels import LEG_VECTORS
from multirod.rod import stack
from multirod.validation import FloatArray

ALONG = LEG_VECTORS  # inputs that act along rods
ON_RODS = {"rod_force": ALONG[0], "rod_moment": ALONG[1]}  # inputs that are the same for single rods


def along(inputs: Inputs, enabled: Iterable[str] = ()) -> list[str]:
    """Of ``ALONG`` those that any rod has to be integrated with."""
    active = {name for name in (*ALONG, *ON_RODS) if name in enabled or inputs.is_active(name)}
    return [name for name in ALONG if name in active or any(ON_RODS.get(own) == name for own in active)]


def is_on_rods(inputs: Inputs, enabled: Iterable[str] = ()) -> bool:
    """Whether any of ``ON_RODS`` is given or may be."""
    return any(name in ON_RODS for name in (*inputs.given, *enabled))


class RodGroup:
    """Several rods of all instances as backbones whose tips are held.

    Args:
        graph: The network.
        members: Which of its rods.
        batch_shape: Of the instances.
        moving: Whose bases turn, shape (rod_count,).
        direction_count: Directions of inputs.
        first_drive: Where what drives lines begins among the inputs.
        options: Of ``BackboneProblem``.
        pieces: Of each rod that does not slide, clamps between them, whose moments are the directions.

    Attributes:
        turns: Whether columns say what turning a base does to what acts along the rod: not where nothing acts, or no base turns.
        slides: Whether columns say, last, what a change of the length of a piece does.
        table: What the kernels read of it.
    """

    def __init__(
        self,
        graph: Graph,
        members: Sequence[int],
        batch_shape: tuple[int, ...],
        moving: NDArray[np.bool_],
        direction_count: int,
        first_drive: int,
        options: dict[str, Any],
        pieces: int = 1,
    ) -> None:
        self.members: NDArray[np.intp] = np.array(members)
        self.turns = bool(options["enabled"]) and bool(moving[self.members].any())
        self.slides = bool(graph.slides.sliding[self.members].any())
        pieces = 1 if self.slides else pieces  # how long those are would move their clamps
        arrays = stack([graph.arrays[k].repeated(batch_shape) for k in members], batch_shape)
        first = graph.rods[members[0]]
        self.drive = first_drive + graph.drive[self.members, : len(graph.drives[members[0]])]
        self.angles_at = graph.layout.size + records.MORE + max(map(len, graph.drives))
        turning, size = TURNING * self.turns, int(np.prod(batch_shape))
        self.backbones = BackboneProblem(
            first.rods,
            np.eye(4),
            Inputs(LEG_INPUTS, first.rod_count, {}),
            transmission=first.transmission,
            pose_sensitivities=True,
            held=True,
            arrays=arrays,
            direction_count=direction_count + turning + self.slides,
            pieces=pieces,
            first_moment=np.tile(turning + 3 * (pieces - 1) * graph.slides.still[self.members], size),
            load_directions=turning,
            **options,
        )
        self.table = self._make_table(options["device"])

    def _make_table(self, device: str) -> Struct:
        own = self.backbones
        table: Struct = records.RodGroup()
        m = own.unknown_count
        table.count, table.unknown_count, table.direction_count = len(self.members), m, own.direction_count
        table.turns, table.slides = int(self.turns), int(self.slides)
        table.along_at = own.input_slice(ALONG[0]).start
        table.rod = wp.array(self.members.astype(np.int32), dtype=wp.int32, device=device)
        table.rods, table.transmission, table.table = len(own.rods), int(own.transmission), own.table
        table.drive_count, table.drives_at = own.drive_count, own.first_drive
        table.drive = wp.array(self.drive.astype(np.int32), dtype=wp.int32, device=device)
        table.lengths, table.length_columns = int(own.line_length_columns.shape[2] > 0), own.line_length_columns
        table.angle_count, table.angle_columns = own.features.turning_count, own.angle_columns
        table.angles_at = self.angles_at
        table.first_force = own.slots.places["force"].start
        moment_by, rest, force_unit = self._base_units()
        table.moment_by = wp.array(moment_by, dtype=wp.float64, device=device)
        table.moment_rest = wp.array(rest, dtype=wp.vec3d, device=device)
        table.force_unit = wp.array(force_unit, dtype=wp.float64, device=device)
        own.share(table.problem)
        table.wrench.values, table.wrench.columns = own.tip_wrench, own.wrench_columns
        return table

    def _base_units(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(5b) Moment at the base by the unknowns, (rod of all instances, 3, m), and less what, (..., 3); unit of the force."""
        own, arrays = self.backbones, self.backbones.arrays
        moment_by = np.zeros((own.instance_count, 3, own.unknown_count))
        units, stiffness = unit_stiffness(arrays.material[:, :, 0]), arrays.material[:, :, 0, :2].max(axis=2)
        force_unit = np.ascontiguousarray(own.each(stiffness[:, 0] / arrays.end[:, 0, -1]))
        if len(own.rods) == 1:
            moment_by[:, range(3), range(3)] = own.each(units[:, 0])
            return moment_by, np.ascontiguousarray(own.each(units[:, 0] * arrays.precurvature[:, 0, 0, :3])), force_unit
        moment_by[:, range(2), range(2)] = own.each(stiffness.sum(axis=1, keepdims=True))
        moment_by[:, 2, 2 : 2 + len(own.rods)] = own.each(units[..., 2])
        return moment_by, np.zeros((own.instance_count, 3)), force_unit

    def pass_over(self, rows: IntArray | None) -> None:
        """Let launches pass over the rods of these instances alone, or over all, as the network does."""
        size = len(self.members)
        self.backbones._pass_over(None if rows is None else (rows[:, None] * size + np.arange(size)).reshape(-1))

    def end_moments(self, end: int) -> FloatArray:
        """Moment in each rod at its base (0) or its tip (1), in the axes of the section there [N m], shape (rod of all instances,
        3), integrated."""
        own = self.backbones
        if end == 0:
            moment_by, rest = self.table.moment_by.numpy(), self.table.moment_rest.numpy()
            return np.asarray(np.einsum("tij,tj->ti", moment_by, own.read("unknowns")) - rest)
        return np.asarray(np.einsum("tji,tj->ti", own.read("rotation").reshape(-1, 3, 3), own.tip_wrench.numpy()[:, 3:]))

    def tips(self) -> tuple[FloatArray, FloatArray]:
        """Position (instance, rod, 3) and rotation (instance, rod, 3, 3) of the tips in the frames of the bases, integrated."""
        own, size = self.backbones, len(self.members)
        return own.read("position").reshape(-1, size, 3), own.read("rotation").reshape(-1, size, 3, 3)


def builds(graph: Graph, moving: NDArray[np.bool_] | None, lanes: int) -> list[list[int]]:
    """Rods by their build, what one kernel integrates, and by how many pieces they are cut into.

    Where something acts along rods, those whose bases turn have columns more, and are launched by themselves if that takes less
    of one instance: those of a batch are integrated as they are alone.

    Args:
        graph: The network.
        moving: Whose bases turn, shape (rod_count,); None where nothing acts along rods.
        lanes: Of a launch.
    """
    found: dict[Any, list[int]] = {}
    for k, (rod, arrays) in enumerate(zip(graph.rods, graph.arrays, strict=True)):
        key = (rod.rod_count, rod.transmission, arrays.build, int(graph.slides.pieces[k]), bool(graph.slides.sliding[k]))
        found.setdefault(key, []).append(k)
    if moving is None:
        return list(found.values())
    result = []
    for members in found.values():
        still, turned = ([k for k in members if moving[k] == which] for which in (False, True))
        columns = int(graph.own[members[0]])
        apart = cost_of(len(still), columns, lanes) + cost_of(len(turned), columns + TURNING, lanes)
        split = still and turned and apart < cost_of(len(members), columns + TURNING, lanes)
        result += [still, turned] if split else [members]
    return result
