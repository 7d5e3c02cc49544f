"""Rods of one build, integrated in one launch, each in the frame of its own base.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.inputs import Inputs
from multirod.models.backbone.problem import BackboneProblem
from multirod.models.backbone.units import unit_stiffness
from multirod.models.network import network_kernels as kernels
from multirod.models.network.elements import TURNING
from multirod.models.network.graph import Graph
from multirod.models.platform.platform_kernels import LEG_VECTORS
from multirod.models.platform.problem import LEG_INPUTS
from multirod.rod import stack
from multirod.validation import FloatArray

ALONG = LEG_VECTORS  # inputs that act along rods


class RodGroup:
    """Several rods of all instances as backbones whose tips are held.

    Args:
        graph: The network.
        members: Which of its rods.
        batch_shape: Of the instances.
        direction_count: Directions of inputs.
        options: Of ``BackboneProblem``.
        pieces: Of each rod, clamps between them, whose moments are the directions.

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
        direction_count: int,
        options: dict[str, Any],
        pieces: int = 1,
    ) -> None:
        self.members: NDArray[np.intp] = np.array(members)
        base = graph.ends[0]
        moving = (base.frame[self.members] != 0) | (base.table.count[self.members] > 0)
        self.turns = bool(options["enabled"]) and bool(moving.any())
        self.slides = bool(graph.slides.cut[self.members].any())
        arrays = stack([graph.arrays[k].repeated(batch_shape) for k in members], batch_shape)
        first = graph.rods[members[0]]
        turning, size = TURNING * self.turns, int(np.prod(batch_shape))
        self.backbones = BackboneProblem(
            first.rods,
            np.eye(4),
            Inputs(LEG_INPUTS, first.rod_count, {}),
            pose_sensitivities=True,
            held=True,
            arrays=arrays,
            direction_count=direction_count + turning + self.slides,
            pieces=pieces,
            first_moment=np.tile(turning + 3 * (pieces - 1) * self.members, size),
            load_directions=turning,
            **options,
        )
        self.table = self._make_table(options["device"])

    def _make_table(self, device: str) -> Any:
        own = self.backbones
        table: Any = kernels.RodGroup()
        m, arrays = own.unknown_count, own.arrays
        table.count, table.unknown_count, table.direction_count = len(self.members), m, own.direction_count
        table.turns, table.slides = int(self.turns), int(self.slides)
        table.along_at = own.input_slice(ALONG[0]).start
        table.rod = wp.array(self.members.astype(np.int32), dtype=wp.int32, device=device)
        # (5b) by what unknowns the moment and the force at the base are
        moment_by = np.zeros((own.instance_count, 3, m))
        units = unit_stiffness(arrays.material[:, 0, 0])
        moment_by[:, range(3), range(3)] = units
        table.first_force = own.slots.places["force"].start
        table.moment_by = wp.array(moment_by, dtype=wp.float64, device=device)
        rest = units * arrays.precurvature[:, 0, 0, :3]
        table.moment_rest = wp.array(np.ascontiguousarray(rest), dtype=wp.vec3d, device=device)
        force_unit = arrays.material[:, 0, 0, :2].max(axis=1) / arrays.end[:, 0, -1]
        table.force_unit = wp.array(np.ascontiguousarray(force_unit), dtype=wp.float64, device=device)
        own.share(table)
        table.wrench, table.wrench_columns = own.tip_wrench, own.wrench_columns
        return table

    def focus(self, rows: IntArray | None) -> None:
        """Let launches pass over the rods of these instances alone."""
        size = len(self.members)
        self.backbones.focus(None if rows is None else (rows[:, None] * size + np.arange(size)).reshape(-1))

    def tips(self) -> tuple[FloatArray, FloatArray]:
        """Position (instance, rod, 3) and rotation (instance, rod, 3, 3) of the tips in the frames of the bases, integrated."""
        own, size = self.backbones, len(self.members)
        return own.read("position").reshape(-1, size, 3), own.read("rotation").reshape(-1, size, 3, 3)


def builds(graph: Graph) -> list[list[int]]:
    """Rods by their build, what one kernel integrates, and by how many pieces they are cut into."""
    found: dict[Any, list[int]] = {}
    for k, arrays in enumerate(graph.arrays):
        found.setdefault((arrays.members, arrays.member_rods, int(graph.slides.pieces[k])), []).append(k)
    return list(found.values())
