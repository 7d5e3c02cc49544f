"""How the equilibrium of a platform varies with where its legs stand and hold it, and with the legs' own numbers.

Numbers in parentheses are those of ``docs/derivatives.md``.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from multirod.models.backbone.derivatives.designs import COMPONENTS
from multirod.models.platform import platform_kernels as kernels
from multirod.rotations import cross_matrix
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.derivatives.columns import InputColumns
    from multirod.models.platform.geometry import Geometry
    from multirod.models.platform.legs import LegGroup
    from multirod.models.platform.problem import ParallelProblem

POSE = kernels.POSE
PARAMETERS = (*COMPONENTS, "base", "platform")
PLACES = ("base", "platform")  # a pose for each leg


def most_sections(geometry: "Geometry") -> int:
    """The most that a rod has."""
    return max(len(rod.sections) for rod in geometry.rods)


def parameter_size(name: str, geometry: "Geometry") -> int:
    """How many columns derivatives by a parameter have."""
    if name in PLACES:
        return POSE * len(geometry.legs)
    return len(geometry.rods) * most_sections(geometry) * COMPONENTS[name]


def design_rows(problem: "ParallelProblem", group: "LegGroup", name: str) -> FloatArray:
    """Directions of legs of one build along each of their own numbers, as many as if every rod had the most sections.

    Shape (instance_count, leg, k, width).
    """
    rows = group.backbones.derivatives.designs(name).rows()
    return _padded(problem, group, rows.reshape(problem.instance_count, len(group.members), *rows.shape[1:]), name)


def _padded(problem: "ParallelProblem", group: "LegGroup", rows: FloatArray, name: str) -> FloatArray:
    rods, count, width = len(group.backbones.rods), COMPONENTS[name], rows.shape[-1]
    own = rows.reshape(*rows.shape[:2], rods, -1, count, width)
    more = most_sections(problem.geometry) - own.shape[3]
    return np.pad(own, ((0, 0), (0, 0), (0, 0), (0, more), (0, 0), (0, 0))).reshape(*rows.shape[:2], -1, width)


class Places:
    """What the last integration says of each leg's base and attachment.

    Attributes:
        rotation: Of the platform, shape (instance_count, 3, 3).
        arm: From its origin to each attachment, world frame [m], shape (instance_count, leg, 3).
    """

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem = problem
        geometry, count = problem.geometry, problem.instance_count
        shape = (*problem.batch_shape, len(geometry.legs), 4, 4)
        self._base = np.broadcast_to(geometry.base, shape).reshape(count, *shape[-3:])
        self._platform = np.broadcast_to(geometry.platform, shape).reshape(count, *shape[-3:])
        self._position, self.rotation = problem.pose()
        self.arm = np.einsum("bij,blj->bli", self.rotation, self._platform[..., :3, 3])
        n = problem.unknown_count
        self._gamma = problem.read("gamma").reshape(-1, n, n)
        self._length = np.broadcast_to(problem.length, (count, len(geometry.legs) + 1))
        self._turn = problem.pose_columns.numpy()[:, 3:, n - 3 : n]  # of the platform, by its unknowns

    def slopes(self, name: str) -> FloatArray:
        """(D16), (D17) Of the residual, the legs carried along as they are, shape (instance_count, n, 6 leg)."""
        problem, count = self.problem, self.problem.instance_count
        legs, place = len(problem.geometry.legs), problem.platform
        law = problem.robots.law.numpy().reshape(count, legs, -1)
        force, total = law[..., kernels.FORCE_AT :][..., :3], law[..., kernels.MOMENT_AT :][..., :3]
        bent = 1 / np.broadcast_to(problem.stiffness[:, -1], count)[:, None, None]
        pull = self._length[:, -1, None, None] * bent
        slopes = np.zeros((count, problem.unknown_count, legs, POSE))
        for leg, own in enumerate(problem.own):
            gap, angles = slice(own.start, own.start + 3), slice(own.start + 3, own.start + POSE)
            to_gap = np.swapaxes(self._base[:, leg, :3, :3], 1, 2) / self._length[:, leg, None, None] ** 2
            by_turn = self._gamma[:, angles, place.start + 3 : place.stop] @ np.linalg.inv(self._turn)
            n, arm = force[:, leg], self.arm[:, leg]
            if name == "platform":
                slopes[:, gap, leg, :3] = -to_gap @ self.rotation
                slopes[:, angles, leg, 3:] = by_turn @ self.rotation
                slopes[:, place.start + 3 : place.stop, leg, :3] = -bent * cross_matrix(n) @ self.rotation
            else:
                lever = self._position + arm - self._base[:, leg, :3, 3]
                slopes[:, gap, leg, :3] = to_gap
                slopes[:, gap, leg, 3:] = -to_gap @ cross_matrix(lever)
                slopes[:, angles, leg, 3:] = -by_turn
                slopes[:, place.start : place.start + 3, leg, 3:] = -pull * cross_matrix(n)
                moment = total[:, leg] - np.cross(arm, n)
                twist = cross_matrix(moment) + cross_matrix(arm) @ cross_matrix(n)
                slopes[:, place.start + 3 : place.stop, leg, 3:] = -bent * twist
        return slopes.reshape(count, problem.unknown_count, -1)

    def unknown_rates(self, name: str) -> FloatArray:
        """(D18) By how much the unknowns must change for the platform to stay, shape (instance_count, n, 6 leg)."""
        problem, count, legs = self.problem, self.problem.instance_count, self._base.shape[1]
        reference = np.broadcast_to(problem.reference[1], (count, 3, 3))
        own = np.swapaxes(reference, 1, 2)[:, None] @ self._base[..., :3, :3] @ np.swapaxes(self._platform[..., :3, :3], -1, -2)
        answer = np.linalg.inv(_spread(own.sum(axis=1)))[:, None]
        if name == "base":
            turned = answer @ _spread(own) @ np.swapaxes(reference, 1, 2)[:, None]
        else:
            turned = -answer @ _spread(np.swapaxes(own, 2, 3))
        rates = np.zeros((count, problem.unknown_count, legs, POSE))
        place = problem.platform
        back = np.linalg.solve(self._turn, self.rotation)[:, None] @ turned
        rates[:, place.start + 3 : place.stop, :, 3:] = -np.swapaxes(back, 1, 2)
        if name == "base":
            rates[:, place.start : place.start + 3, :, :3] = (
                -(np.eye(3) / legs)[:, None] / self._length[:, -1, None, None, None] ** 2
            )
        return rates.reshape(count, problem.unknown_count, -1)


def _spread(matrices: FloatArray) -> FloatArray:
    """The matrix of ``a`` in ``[a]x M + M^T [a]x``, as a vector."""
    return np.asarray(np.trace(matrices, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - matrices)


def leg_rates(problem: "ParallelProblem", columns: "InputColumns") -> FloatArray:
    """(D9) of the legs, shape (instance_count, n, numbers)."""
    rates = np.zeros((problem.instance_count, problem.unknown_count, columns.numbers))
    for group in problem.groups:
        own = group.backbones.derivatives.designs(columns.name).unknown_rates()
        own = np.swapaxes(own, 1, 2).reshape(problem.instance_count, len(group.members), -1, own.shape[1])
        own = _padded(problem, group, own, columns.name)
        for place, leg in enumerate(group.members):
            first, count = columns.shares[leg]
            rates[:, problem.own[leg], first : first + count] = np.swapaxes(own[:, place], 1, 2)
    return rates


def unknown_rates(problem: "ParallelProblem", every: Sequence["InputColumns"]) -> FloatArray:
    """How the unknowns must change for what they stand for to stay, by each number, shape (instance_count, n, k)."""
    parts = []
    for columns in every:
        if columns.name in PLACES:
            parts.append(Places(problem).unknown_rates(columns.name))
        elif columns.name in COMPONENTS:
            parts.append(leg_rates(problem, columns))
        else:
            parts.append(np.zeros((problem.instance_count, problem.unknown_count, columns.numbers)))
    return np.concatenate(parts, axis=2)
