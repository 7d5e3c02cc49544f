"""What a sample of a controller asks for."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Robot_co
from multirod.inputs import Inputs
from multirod.results.remarks import Remarks
from multirod.results.solution import Solution
from multirod.tasks.controlling.control_kernels import ANGLE, ERROR, FREE, OFFSET, SINGULAR, TARGET
from multirod.tasks.freed import masked, with_values
from multirod.tasks.limits import LimitRows, told
from multirod.types import Numbers
from multirod.validation import FloatArray, frozen


class Command(Solution[Robot_co]):
    """What a sample of a controller asks for: a ``Solution`` at ``inputs``, to first order from the place of its integration.

    Attributes:
        missing: Whether a measurement was given that is NaN, and left out.
    """

    missing: bool
    _free: tuple[str, ...]
    _told: FloatArray
    _rows: LimitRows
    _limits: tuple[str, ...]  # names of them, and of those of the shape
    _aims: bool  # at a position

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the inputs that were chosen."""
        return self._free

    @cached_property
    def inputs(self) -> Inputs:
        """For the drives: what was chosen, and all else as it was given. Of a sample that failed what is free is NaN;
        ``last_good`` has a command then."""
        return masked(self._applied, self._free, self.failed)

    @property
    def last_good(self) -> Inputs:
        """What is free as the last sample has it that did not fail, this one if it did not: for drives that need a command. All
        else is as in this sample; whether the robot is stable under loads that have changed nobody has looked."""
        return with_values(self._applied, self._free, self._by_free(0)[0])

    @property
    def target_error(self) -> float:
        """Distance of the model's tip from the position asked for, what was measured taken into account [m]; NaN if none was."""
        return float(self._told[ERROR])

    @property
    def target_angle(self) -> float:
        """Angle of the model's tip from the rotation or the axis asked for, likewise [rad]."""
        return float(self._told[ANGLE])

    @property
    def singular(self) -> bool:
        """Whether the freed inputs cannot bring the tip where it is to be: the step was bounded."""
        return bool(self._told[SINGULAR])

    @property
    def offset(self) -> FloatArray:
        """By how much the robot's tip is off the model's, as the measurements say [m], shape (3,); zero without."""
        return np.asarray(frozen(self._told[OFFSET:TARGET]))

    @property
    def at_limit(self) -> NDArray[np.bool_]:
        """Which of the freed numbers take part in a limit that holds, shape (k,)."""
        return np.asarray(frozen(self._by_free(7)[0] != 0))

    @property
    def held_by(self) -> tuple[str, ...]:
        """Limits that hold, whether they hold the tip back or others make up for it: such as ``"translation[0]"``,
        ``"translation[1] - translation[0]"`` for a gap, ``"translation['rod 0']"`` of a ``Network``, ``"curvature"``,
        ``"stability_margin"``; and ``"stability"``, which is none that was given: the step that was to follow is given up, as
        what it leads to is not known to be stable, and this is the last command again."""
        holds = self._told[FREE + 8 * len(self.at_limit) :] != 0
        return tuple(name for name, own in zip(self._limits, holds, strict=True) if own)

    def _by_free(self, first: int, count: int = 1) -> FloatArray:
        """Rows of what is told of each freed number: p, the pose by it, whether it is held; shape (count, k)."""
        k = self._rows.matrix.shape[1]
        return self._told[FREE + first * k :][: count * k].reshape(count, k)

    @cached_property
    def _remarks(self) -> Remarks:  # type: ignore[override]  # found when it is asked for
        return self._rows.remarks(self._by_free(0)[0], self._told[TARGET:ANGLE] if self._aims else None, self.target_error)

    @property
    def _asides(self) -> dict[str, str]:
        return told(self.target_error, self.target_angle, self.held_by) | ({"singular": "yes"} if self.singular else {})

    def _jacobian(self, names: tuple[object, ...], of: str, at: Numbers | None, rod: int | str | None) -> FloatArray:
        """By the inputs that are free, without another integration: the columns of the sample's own."""
        if of == "pose" and names == self.free and at is None and rod is None:
            found = self._by_free(1, 6)
            if self.failed or np.isfinite(found).all():  # where it stands from the start on none was told
                return np.asarray(frozen(found))
        return super()._jacobian(names, of, at, rod)
