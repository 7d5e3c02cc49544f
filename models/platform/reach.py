"""Whether legs can reach their platform: (41) of ``docs/networks.md`` between two of them."""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.platform.buffers import batched
from multirod.out_of_reach import TAUT, Reach
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem


class PlatformReach(Reach):
    """Of a ``ParallelProblem``; what legs that are as long as they have to be, or that stretch, can reach is not known."""

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem = problem
        self.is_known = not problem.inverse and sum(not arrays.shear for arrays in problem.geometry.arrays) > 1

    def exceeded(self) -> NDArray[np.bool_]:
        """As said."""
        if not self.is_known:
            return np.zeros(self.problem.instance_count, dtype=bool)
        apart, reach = self._pairs()
        return np.asarray((apart * (1 - TAUT) > reach).any(axis=(1, 2)))

    def said(self, instance: int) -> str:  # noqa: D102
        apart, reach = (values[instance] for values in self._pairs())
        first, second = divmod(int((apart - reach).argmax()), len(apart))
        least, asked = reach[first, second], apart[first, second]
        return f" (legs {first} and {second}, with the platform between, reach {least:.4g} m of {asked:.4g} m)"

    @cached_property
    def _fixed(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Arclengths at which rods end [m], ``inf`` where these stretch, shape (instance or 1, rod), and how far legs are apart
        at their bases and at the platform, (instance or 1, leg, leg)."""
        problem, geometry = self.problem, self.problem.geometry
        own = [np.where(a.shear, np.inf, a.repeated(geometry.batch_shape).end[:, :, -1]) for a in geometry.arrays]
        ends = np.concatenate(own, axis=1).reshape(*geometry.batch_shape, -1)
        legs = len(geometry.legs)
        places = (batched(problem, poses[..., :3, 3], (legs, 3)) for poses in (geometry.base, geometry.platform))
        base, platform = (np.linalg.norm(own[:, :, None] - own[:, None], axis=-1) for own in places)
        return batched(problem, ends, ends.shape[-1:]), base, platform

    def _pairs(self) -> tuple[FloatArray, FloatArray]:
        """How far the bases of two legs are apart [m], and how far these and the platform between them reach, shape (instance,
        leg, leg)."""
        problem, (ends, base, platform) = self.problem, self._fixed
        in_use = ends + problem.read("inputs")[:, problem.input_slice("translation")]
        length = np.maximum.reduceat(in_use, problem.geometry.first_rod[:-1], axis=1)
        return np.broadcast_to(base, (len(length), *base.shape[1:])), length[:, :, None] + length[:, None] + platform
