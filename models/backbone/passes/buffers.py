"""What kernels read and write: tables of rods, and the arguments of launches."""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.inputs import Inputs
from multirod.kernels.warp_types import Array, Struct
from multirod.models.backbone.kernels.layout.arguments import Call, RodTable
from multirod.models.backbone.kernels.layout.rows import MATERIAL_SIZE
from multirod.problem.buffers import BUFFERS
from multirod.profile import DEGREE, interpolate
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

NODE_FIELDS = ("arclength", "position", "rotation", "curvature", "moment", "force")
TOTALS = ("total_moment", "total_force")  # where members carry a part
STEP_LIMIT = 65_536
RIGID = 1e6  # torsional over bending stiffness, of a rod rigid in torsion, where its modes are counted


class Buffers:
    """Of a ``BackboneProblem``."""

    def __init__(self, problem: "BackboneProblem") -> None:
        self.problem = problem

    def array(self, value: NDArray[np.generic], dtype: type = wp.float64) -> Array:
        """On the problem's device, in double precision."""
        return wp.array(np.ascontiguousarray(value, dtype=np.float64), dtype=dtype, device=self.problem.device)

    def table(self, inputs: Inputs | None = None) -> Struct:
        """The rods, with the load profiles of ``inputs``, or else those of the problem's own table."""
        problem, arrays = self.problem, self.problem.arrays
        table: Struct = RodTable()
        table.stride = 1 if arrays.batch_shape else 0
        table.end = self.array(arrays.end)
        table.material = self.array(arrays.material)
        table.precurvature = self.array(arrays.precurvature)
        table.length_scale = self.array(arrays.end[:, 0, -1])
        base = problem.base if problem.base.ndim == 2 else np.broadcast_to(problem.base, (*problem.batch_shape, 4, 4))
        base = base.reshape(-1, 4, 4)
        table.base_stride = 1 if problem.base.ndim > 2 else 0
        table.base_position = self.array(base[:, :3, 3], wp.vec3d)
        table.base_rotation = self.array(base[:, :3, :3], wp.mat33d)
        if inputs is None:
            table.profile_end, table.profile = problem.table.profile_end, problem.table.profile
            return table
        ends, coefficients = merged_profiles(inputs)
        table.profile_end = self.array(ends)
        table.profile = self.array(coefficients)
        return table

    def call(self, node_count: int = 0) -> Struct:
        """Arguments of a launch that writes where the problem's own does, and at nodes of its own."""
        problem, drive_count = self.problem, self.problem.drive_count
        call: Struct = Call()
        problem.share(call.problem)
        call.line_length, call.line_length_columns = problem.line_length, problem.line_length_columns
        call.problem.pose_columns = problem.angle_columns
        if problem.held:
            call.wrench.values, call.wrench.columns = problem.tip_wrench, problem.wrench_columns
        call.direction_stride = 1
        call.steps = float(problem.integrator.steps or 0)
        # nodes between base and tip ask for stretches of as few steps as one
        call.step_multiple = 1.0 if node_count > 2 else float(step_multiple(problem.integrator.steps or 1))
        call.rtol = problem.integrator.rtol
        call.atol = problem.integrator.atol
        call.step_limit = STEP_LIMIT
        call.node_count = node_count
        if node_count:
            call.node_arclength = self.zeros(node_count)
            for name in ("position", "curvature", "moment", "force", *(TOTALS if problem.features.members else ())):
                setattr(call, f"node_{name}", self.zeros(node_count, dtype=wp.vec3d))
            call.node_rotation = self.zeros(node_count, dtype=wp.mat33d)
            call.line_length = self.zeros(drive_count)
            call.node_left = self.zeros(node_count, drive_count * problem.features.friction)
            call.energy, call.work = self.zeros(), self.zeros()
        return call

    def call_at_equal_steps(self) -> Struct:
        """The same of whole rods, or of parts one after another, without nodes.

        Equal steps that overflow become shorter, which no others do: twice as many as there are to be end the integration.
        """
        problem, call = self.problem, self.call()
        if problem.integrator.steps:
            stretches = problem.arrays.end[0].size + problem.table.profile_end.shape[0] + 1
            call.step_limit = min(STEP_LIMIT, 2 * int(call.steps + call.step_multiple * stretches))
        return call

    def zeros(self, *tail: int, dtype: type = wp.float64) -> Array:
        """Zeros of shape (instance_count, *tail) on the problem's device."""
        return wp.zeros((self.problem.instance_count, *tail), dtype=dtype, device=self.problem.device)

    def own_ends(self, call: Struct, unknown_count: int) -> None:
        """Give a launch outputs of its own at the tip, but for columns."""
        own = call.problem
        own.residual = self.zeros(unknown_count)
        own.position, own.rotation = self.zeros(dtype=wp.vec3d), self.zeros(dtype=wp.mat33d)

    def twisting_table(self, like: Struct | None = None) -> Struct:
        """The rods, one that is rigid in torsion only ``RIGID`` times stiffer than in bending: columns need to twist it, (8s).

        Its base is that of the table ``like``, the problem's own by default, which may turn in a joint; and it is that table
        where no rod is rigid.
        """
        own = self.problem.table if like is None else like
        material = self.problem.arrays.material
        rigid = np.isinf(material[..., 2])
        if not rigid.any() and not self.problem.features.eccentric:
            return own
        material = np.array(material)
        if self.problem.features.eccentric:
            stiffest = material[..., :2].max(axis=(1, 2, 3), keepdims=True)
            material[..., MATERIAL_SIZE + 2] = 1 / (RIGID * stiffest[..., 0])
        material[..., 5][rigid] = 1 / (RIGID * material[..., :2].max(axis=-1)[rigid])
        table: Struct = self.table()
        table.material = self.array(material)
        table.base_position, table.base_rotation = own.base_position, own.base_rotation
        return table


def holder(call: Struct, name: str) -> Struct:
    """The part of a launch's arguments that has an array of this name: its ``problem`` or itself."""
    return call.problem if name in BUFFERS else call


def step_multiple(steps: int) -> int:
    """Power of two of which the steps of each stretch are a multiple, so that doubling ``steps`` doubles every share.

    Without it, the rounding of the shares spoils the order that halving the step shows. A share is still told from
    another to one part in 8 or better.
    """
    multiple = 1
    while steps % 2 == 0 and steps >= 16:
        steps //= 2
        multiple *= 2
    return multiple


def merged_profiles(inputs: Inputs) -> tuple[FloatArray, FloatArray]:
    """Load profiles on common pieces: ends (piece,), coefficients (piece, 6 (DEGREE + 1))."""
    if not inputs.profiles:
        return np.zeros(1), np.zeros((1, 6))
    ends = np.unique(np.concatenate([p.ends for p in inputs.profiles.values()]))
    result = np.zeros((len(ends), 6, DEGREE + 1))
    for row, name in ((0, "distributed_force"), (3, "distributed_moment")):
        profile = inputs.profile(name)
        if profile is None:
            continue
        start = 0.0
        for piece, end in enumerate(ends):
            result[piece, row : row + 3] = interpolate(profile, start, end).T
            start = end
    return ends, result.reshape(len(ends), -1)
