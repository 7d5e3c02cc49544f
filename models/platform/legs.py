"""Legs of one build, integrated in one launch."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from multirod.inputs import Inputs
from multirod.models.backbone.problem import BackboneProblem
from multirod.models.platform import platform_kernels as kernels
from multirod.models.platform.inputs import LEG_INPUTS
from multirod.rod import stack
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem


class LegGroup:
    """Legs of one build, integrated in one launch."""

    def __init__(self, problem: "ParallelProblem", members: Sequence[int], inputs: Inputs, options: dict[str, Any]) -> None:
        geometry = problem.geometry
        self.members = tuple(members)
        legs = [geometry.legs[k] for k in members]
        shape = problem.batch_shape
        arrays = stack([geometry.arrays[k].repeated(shape) for k in members], shape)
        base = np.broadcast_to(geometry.base[..., list(members), :, :], (*shape, len(legs), 4, 4))
        count = len(members)
        given: dict[str, Any] = {name: inputs.profiles[name] for name in kernels.LEG_VECTORS if name in inputs.profiles}
        for name in kernels.LEG_VECTORS:
            if name in inputs.given and name not in given:
                given[name] = np.broadcast_to(getattr(inputs, name)[..., None, :], (*inputs.batch_shape, count, 3))
        reach = max((p.ends[-1] for p in inputs.profiles.values()), default=0.0)
        self.backbones = BackboneProblem(
            legs[0].rods,
            base,
            Inputs(LEG_INPUTS, legs[0].rod_count, given, reach),
            transmission=legs[0].transmission,
            pose_sensitivities=True,
            held=True,
            arrays=arrays,
            pieces=int(problem.pieces[members[0]]),
            first_moment=np.tile(problem.first_moment[list(members)], problem.instance_count),
            varied=not problem.cut,
            **options,
        )
        self._write_constants(problem, base)

    def _write_constants(self, problem: "ParallelProblem", base: FloatArray) -> None:
        device, geometry, own = problem.device, problem.geometry, self.backbones
        legs: Any = kernels.Legs()
        legs.count = len(self.members)
        legs.rods = len(own.rods)
        legs.unknown_count = own.unknown_count
        legs.vectors = own.input_slice(kernels.LEG_VECTORS[0]).start
        legs.drives = own.first_drive
        legs.drive = wp.array(problem.places_of_drives(self.members), dtype=wp.int32, device=device)
        for name, values in (
            ("leg", self.members),
            ("first_rod", geometry.first_rod[list(self.members)]),
            ("first_unknown", geometry.first_unknown[list(self.members)]),
        ):
            setattr(legs, name, wp.array(np.asarray(values, dtype=np.int32), dtype=wp.int32, device=device))
        own.share(legs.problem)
        legs.wrench.values, legs.wrench.columns = own.tip_wrench, own.wrench_columns
        legs.to_base = wp.array(np.swapaxes(base[..., :3, :3], -1, -2).reshape(-1, 3, 3), dtype=wp.mat33d, device=device)
        self.table = legs

    def renew(self, vectors: FloatArray) -> None:
        """As new, with what acts along the legs, shape (instance_count, 9)."""
        own = self.backbones
        own._clear()
        rows = np.zeros((own.instance_count, own.input_count))
        rows[:, self.table.vectors : self.table.vectors + vectors.shape[1]] = np.repeat(vectors, len(self.members), axis=0)
        rows[:, -1] = 1.0
        own.write("inputs", rows)
