"""Where to begin with several legs and a platform: taken apart, or from poses around that of the unloaded robot."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.batch import IntArray
from multirod.capabilities import Joints, Loading, Starts, Together
from multirod.models.backbone.inputs import LOADS
from multirod.models.backbone.starts import quasirandom
from multirod.models.joint_kernels import AT_REST
from multirod.models.platform import platform_kernels as kernels
from multirod.models.platform.starting.guess import COMPLIANCES, beam_unknowns, fitted_platform
from multirod.rotations import matrices
from multirod.status import BoolArray
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem

REACH = (0.6, 0.6)  # of starts from the unloaded pose: in lengths, and radians
CROWDING = 1.5  # most equilibria are not far


class PlatformJoints(Joints):
    """Of a ``ParallelProblem``: each leg's end is joined to the platform, or leaves a gap there."""

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem = problem

    def apart(self, numbers: IntArray | None = None) -> FloatArray:
        """Legs that nothing holds, and a platform as near to their tips as it can be, or around there (``docs/parallel.md``).

        The mismatch of each joint is remembered and closes as ``load_factor`` goes from 0 to 1, (9).
        """
        with self.problem.closing.unloaded():
            x, legs, at = self.problem.closing.unloaded_legs()
        if not self.problem.inverse:
            position, rotation = fitted_platform(legs, at)
            if numbers is not None:
                aside = self._around(numbers)
                position = (
                    position + np.broadcast_to(self.problem.length[:, -1:], (self.problem.instance_count, 1)) * aside[:, :3]
                )
                rotation = matrices(aside[:, 3:]) @ rotation
            x[:, self.problem.platform] = self.problem.pose_unknowns(position, rotation)
        if numbers is not None:
            x = self.problem.twisted(x, numbers)
        self.open(x)
        if numbers is not None:  # the other way together leads to other states
            soft = self.problem.robots.soft
            soft.assign(soft.numpy() * (numbers % 2 == 0))
        return x

    def together(self) -> Together | None:
        """As beams, where that is not near an equilibrium; the others begin so by ``guess``."""
        problem = self.problem
        if problem.inverse or problem.closing.closed().near.all():
            return None
        unknowns, near = problem.guess(), problem.closing.closed().near
        return Together(unknowns, ~near, near, np.where(near, 0, problem.guess_integrations))

    def open(self, unknowns: FloatArray) -> None:
        """As said; tips give way on the way where no leg carries a force yet, (9b)."""
        problem = self.problem
        force = np.abs(unknowns[:, problem.held_forces]).max(axis=1)
        problem.robots.opening.zero_()
        problem.robots.soft.assign((force < AT_REST * problem.curvature_scale()).astype(np.float64))
        with problem.everyone(), problem.at_load(0.0):
            problem.robots.opening.assign(problem.evaluate(unknowns)[0])

    def give_way(self, some: BoolArray) -> tuple[FloatArray, int]:
        """Let tips of ``some`` give way, (9b), until ``load_factor`` is 1, from the unknowns that this returns, those of
        ``guess``, and how many integrations it takes to open them."""
        arrays = self.problem.robots.opening, self.problem.robots.soft
        unknowns, before = self.problem.closing.closed().unknowns, [np.array(values.numpy()) for values in arrays]
        self.open(unknowns)
        for values, own in zip(arrays, before, strict=True):
            own[some] = values.numpy()[some]
            values.assign(own)
        return np.array(unknowns), 1

    def close(self, loading: Loading) -> None:  # noqa: D102
        self.problem.robots.loading.fill_(int(loading))

    def shut(self, some: BoolArray | None = None) -> None:  # noqa: D102
        for values in (self.problem.robots.opening, self.problem.robots.soft):
            kept = values.numpy()
            kept[slice(None) if some is None else some] = 0.0
            values.assign(kept)

    def unloaded_inputs(self) -> FloatArray | None:  # noqa: D102
        if self.problem.inputs_given.profiles:
            return None
        rows = self.problem.read("inputs")
        for spec in LOADS:  # a platform's have the names of a backbone's
            rows[:, self.problem.input_slice(spec.name)] = 0.0
        return rows

    @staticmethod
    def _around(numbers: IntArray) -> FloatArray:
        """Those of ``crowded``, but none for the first; shape (k, 6)."""
        return np.where(numbers[:, None] == 0, 0.0, crowded(numbers))


class PlatformStarts(Starts):
    """Of a ``ParallelProblem``; closed loops, so equilibria need not come in pairs."""

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem = problem

    @property
    def signs_add_up(self) -> bool:  # noqa: D102
        return False

    def guesses(self, count: int, first: int = 0) -> FloatArray:
        """Poses of the platform around that of the unloaded robot, its legs taken for beams that reach there."""
        middle = self.problem.closing.closed().unknowns
        with self.problem.closing.unloaded():
            x, legs, at = self.problem.closing.unloaded_legs()
        legs = legs.softened(COMPLIANCES[-1:])
        points = crowded(np.arange(first, first + count))
        length = np.broadcast_to(self.problem.length[:, -1:], (self.problem.instance_count, 1))
        result = np.empty((count, *x.shape))
        for k, point in enumerate(points):
            result[k] = x
            pose = middle[:, self.problem.platform] + point / np.concatenate([length] * 6, axis=1)
            result[k][:, self.problem.platform] = pose
            position, rotation = self.problem.pose_of(pose)
            for own, values in zip(self.problem.own, beam_unknowns(legs, at, position, rotation), strict=True):
                result[k][:, own] += values
            result[k] = self.problem.twisted(result[k], np.full(len(x), first + k))
        return result


def crowded(numbers: IntArray) -> FloatArray:
    """Displacements, in lengths, and rotation vectors by number, that lie the closer the nearer they are to none; shape (k,
    6)."""
    points = quasirandom(numbers, kernels.POSE)
    return np.asarray(np.sign(points) * np.abs(points) ** CROWDING * np.repeat(REACH, 3))
