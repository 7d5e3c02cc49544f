"""Rods of one build, integrated in one launch, each in the frame of its own base.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.inputs import Inputs
from multirod.models.backbone.problem import BackboneProblem
from multirod.models.backbone.units import unit_stiffness
from multirod.models.network.elements import OWN, TURNING, Integrated
from multirod.models.network.graph import Graph
from multirod.models.platform.platform_kernels import LEG_VECTORS
from multirod.models.platform.problem import LEG_INPUTS
from multirod.rod import stack
from multirod.rotations import cross, matrices
from multirod.validation import FloatArray

ALONG = LEG_VECTORS  # inputs that act along rods
AXIS = np.array([0.0, 0.0, 1.0])


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
        self.direction_count = direction_count
        self.slides, self.any_slides = bool(graph.slides.cut[self.members].any()), bool(graph.slides.count)
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
        start = self.backbones.input_slice(ALONG[0]).start
        self.along = slice(start, start + 3 * len(ALONG))
        section = arrays.material[:, 0, 0]
        self.moment_unit = unit_stiffness(section)
        self.force_unit = section[:, :2].max(axis=1) / arrays.end[:, 0, -1]
        self.at_rest = arrays.precurvature[:, 0, 0, :3]

    def places(self, rows: IntArray) -> IntArray:
        """Where the rods of some instances, (k,), stand among the backbones."""
        size = len(self.members)
        return np.asarray((rows[:, None] * size + np.arange(size)).reshape(-1))

    def focus(self, rows: IntArray | None) -> None:
        """Let launches pass over the rods of these instances alone."""
        self.backbones.focus(None if rows is None else self.places(rows))

    def hand_over(
        self,
        rows: IntArray,
        unknowns: FloatArray,
        inputs: FloatArray,
        along: FloatArray,
        directions: FloatArray,
        along_directions: FloatArray,
        level: FloatArray,
        to_base: FloatArray,
    ) -> None:
        """(6) Unknowns, inputs and directions of the instances ``rows``, (k,), to their rods.

        Args:
            rows: Which.
            unknowns: Of the rods, shape (k, rod, 6).
            inputs: Angle and translation of each rod, shape (k, rod, 2).
            along: What acts along rods, in the world, shape (k, 4, 3).
            directions: Of angle and translation, shape (k, rod, direction_count, 2).
            along_directions: Of what acts along rods, shape (k, direction_count, 4, 3).
            level: What multiplies loads, shape (k,).
            to_base: From the world to the frames of the bases, shape (k, rod, 3, 3).
        """
        own, places, size = self.backbones, self.places(rows), len(self.members)
        back = to_base[:, self.members]
        local = np.einsum("brij,bvj->brvi", back, along)
        values = own.read("unknowns")
        values[places] = unknowns[:, self.members].reshape(-1, OWN)
        own.write("unknowns", values)
        values = own.read("inputs")
        values[places, :2] = inputs[:, self.members].reshape(-1, 2)
        values[places, self.along] = local.reshape(len(places), -1)
        own.write("inputs", values)
        put(own.load_factor, places, np.repeat(level, size))
        put(own.active, places, 1)
        if not own.direction_count:
            return
        ways = np.zeros((len(rows), size, own.direction_count, own.input_count))
        first = TURNING * self.turns
        if self.turns:
            by_turn = cross(local[:, :, None], np.eye(3)[:, None])  # (6) rod, axis, vector
            ways[:, :, :first, self.along] = level[:, None, None, None] * by_turn.reshape(len(rows), size, TURNING, -1)
        if self.direction_count:
            last = first + self.direction_count
            ways[:, :, first:last, :2] = directions[:, self.members]
            turned = np.einsum("brij,bdvj->brdvi", back, along_directions)
            ways[:, :, first:last, self.along] = turned.reshape(len(rows), size, self.direction_count, -1)
        if self.slides:
            ways[:, :, -1, 1] = 1.0
        put(own.directions, places, ways.reshape(len(places), own.direction_count, -1))

    def leave_out(self, rows: IntArray) -> None:
        """Integrate no rods of these instances."""
        put(self.backbones.active, self.places(rows), 0)

    def read(self, rows: IntArray, angle: FloatArray, angle_directions: FloatArray) -> "Integrated":
        """What the last integration says of the rods of the instances ``rows``, (k,).

        ``angle`` (k, rod) is that of their bases, and ``angle_directions`` (k, rod, direction_count) how it changes.
        """
        own, places = self.backbones, self.places(rows)
        shape = (len(rows), len(self.members))

        def read(values: FloatArray, *tail: int) -> FloatArray:
            return np.asarray(values[places].reshape(*shape, *tail))

        wrench = read(own.tip_wrench.numpy(), 6)
        force, moment, base_columns = self._at_base(places, angle, angle_directions)
        return Integrated(
            read(own.read("position"), 3),
            read(own.read("rotation"), 3, 3),
            wrench[..., :3],
            wrench[..., 3:],
            force,
            moment,
            self._whole(read(own.pose_columns.numpy(), 6, OWN + own.direction_count)),
            self._whole(read(own.wrench_columns.numpy(), 6, OWN + own.direction_count)),
            base_columns,
        )

    def _whole(self, columns: FloatArray) -> FloatArray:
        """With columns by turns of the base and by the length, where these do nothing."""
        parts = [columns]
        if not self.turns:
            parts = [columns[..., :OWN], np.zeros((*columns.shape[:-1], TURNING)), columns[..., OWN:]]
        if self.any_slides and not self.slides:
            parts.append(np.zeros((*columns.shape[:-1], 1)))
        return np.concatenate(parts, axis=-1) if len(parts) > 1 else columns

    def _at_base(
        self, places: IntArray, angle: FloatArray, angle_directions: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Force and moment in the rods at their bases, in the frames of these, and their columns."""
        shape = angle[:, self.members].shape
        x = self.backbones.read("unknowns")[places].reshape(*shape, OWN)
        turned = matrices(angle[:, self.members].reshape(-1, 1) * AXIS).reshape(*shape, 3, 3)
        unit = self.moment_unit[places].reshape(*shape, 3)
        pull = self.force_unit[places].reshape(*shape, 1)
        moment = (turned @ (unit * (x[..., :3] - self.at_rest[places].reshape(*shape, 3)))[..., None])[..., 0]
        force = (turned @ (pull * x[..., 3:])[..., None])[..., 0]
        last = OWN + TURNING + self.direction_count
        columns = np.zeros((*shape, 6, last + self.any_slides))
        columns[..., 3:, :3] = turned * unit[..., None, :]
        columns[..., :3, 3:OWN] = turned * pull[..., None]
        rates = angle_directions[:, self.members][..., None, :]
        columns[..., :3, OWN + TURNING : last] = cross(AXIS, force)[..., None] * rates
        columns[..., 3:, OWN + TURNING : last] = cross(AXIS, moment)[..., None] * rates
        return force, moment, columns

    def faults(self, rows: IntArray) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Why an integration failed, and steps, of all rods of each of the instances ``rows``, (k,)."""
        places, shape = self.places(rows), (len(rows), len(self.members))
        fault, steps = (array.numpy()[places].reshape(shape) for array in (self.backbones.fault, self.backbones.step_count))
        return fault.max(axis=1), steps.sum(axis=1)


def builds(graph: Graph) -> list[list[int]]:
    """Rods by their build, what one kernel integrates, and by how many pieces they are cut into."""
    found: dict[Any, list[int]] = {}
    for k, arrays in enumerate(graph.arrays):
        found.setdefault((arrays.members, arrays.member_rods, int(graph.slides.pieces[k])), []).append(k)
    return list(found.values())


def put(array: Any, rows: IntArray, values: Any) -> None:
    """Set some rows of an array of Warp's."""
    host = array.numpy()
    host[rows] = values
    if not array.device.is_cpu:
        array.assign(host)
