"""How long the steps of a controller's samples may be, by what came of those before.

Numbers in parentheses are those of ``docs/tasks.md``.
"""

from dataclasses import dataclass
from math import hypot, isnan, sqrt

import numpy as np
import warp as wp

from multirod.kernels.shared import Shared
from multirod.tasks.controlling.control_kernels import ANGLE, ERROR, FREE, SURPRISE
from multirod.tasks.controlling.control_step_kernels import LONGEST, MOST_PULL
from multirod.tasks.rows import ON_TARGET
from multirod.validation import FloatArray

SHORTEST = 1e-4  # step of a sample, in units (9), after many that failed
ASTRAY = 0.25  # part of what a step was to gain: where more is missing, shorter ones follow
SURE = 0.05  # the same: where no more is, longer ones
NOTED = 0.02  # of what a step leaves over: what it is off by, if it is more, is damped
NEAREST = 0.01  # (16d) the least, in units (9)
# (17f) strain that the next step is to have after one that was taken, and after one that was given up
AFTER_TAKEN, AFTER_GIVEN_UP = 0.6, 0.3
LEAST_CUT, MOST_CUT = 0.5, 0.1  # (17f) parts of a step that was given up, which the next one is at most, and at least
WORTH = 0.01  # of what is left, that a step as long as any is to gain if longer ones are to follow
RESTED = 3  # samples for the same target, the first of which go on to where it was expected, (16)


@dataclass
class Sample:
    """What came of a sample.

    Attributes:
        told: Of it, as ``control_kernels`` says where.
        off: Size of the target's rows before its step.
        rows: How many these are.
        target: What was asked for and measured, and the offset that follows from it.
        under: All inputs that are not free.
    """

    told: FloatArray
    off: float
    rows: int
    target: tuple[bytes, ...]
    under: bytes


@dataclass
class Asked:
    """Samples for one target, of which the last has ``rested`` others before it; ``before`` is the one before it, or itself."""

    last: Sample
    before: Sample
    rested: int


@dataclass
class Gained:
    """What the last sample gained, what it left, what was told of it, and what was not free."""

    gain: float
    left: float
    told: FloatArray
    under: bytes


class Pace:
    """Longest steps, in units (9), for the kernel of a sample.

    Args:
        unit: (9), shape (k,).
        weight: Of rows of the position and of angles.
        pulled: Whether what targets leave free is pulled somewhere, (16c).
        told: How many numbers are told of a sample.
        device: Warp device.

    Attributes:
        longest: Of all that is free, as the kernel reads it.
        nearby: (16d) Along what moves the tip little.
    """

    def __init__(self, unit: FloatArray, weight: tuple[float, float], pulled: bool, told: int, device: str) -> None:
        self._unit, self._weight, self._pulled = unit, weight, pulled
        self.longest, self.nearby = (Shared((1,), wp.float64, device) for _ in range(2))
        for own in (self.longest, self.nearby):
            own.write(LONGEST)
        self._careful = self._by_shape = LONGEST  # that what failed leaves, and limits of the shape
        self._trust = LONGEST  # (16b), for the present target
        self._narrowed = LONGEST  # (16d)
        self._asked: Asked | None = None
        self._gained = Gained(0.0, 0.0, np.zeros(told), b"")

    def begin(self) -> None:
        """Begin elsewhere: nothing is known of a sample before."""
        self._careful, self._asked = LONGEST, None
        self._write()

    def limit(self, longest: float) -> None:
        """Steps of so much at most from now on, by limits of the shape."""
        self._by_shape = longest
        self._write()

    def _write(self) -> None:
        self.longest.write(min(self._careful, self._by_shape))

    def failed(self, step: float, strain: float) -> None:
        """(17f) Shorter steps after a sample that failed, or whose ``step`` (9) was given up, 0 if it is not known: what starts
        from the same place would fail again."""
        self._asked = None
        if step > 0:
            part = sqrt(AFTER_GIVEN_UP / strain) if strain > 0 else LEAST_CUT  # NaN is none
            self._take(min(max(part, MOST_CUT), LEAST_CUT) * min(step, self._careful))
        else:
            self._take(LEAST_CUT * self._careful)

    def after(self, sample: Sample | None, step: float, strain: float) -> None:
        """Shorter steps after one that came to less than foreseen, (16b), or was hardly vouched for, (17f). Longer ones after
        others, up to those that are usual. None is a sample of which nothing is known."""
        most = min(1.5 * self._careful, LONGEST)
        if sample is not None:
            self._narrow(sample)
            most = min(most, self._trusted(sample))
        if strain > 0:
            most = min(most, step * sqrt(AFTER_TAKEN / strain))
        self._take(most)

    def _take(self, longest: float) -> None:
        if longest != self._careful:
            self._careful = max(longest, SHORTEST)
            self._write()

    def there(self, told: FloatArray) -> bool:
        """Whether a sample leaves nothing of its target."""
        return self.left(told) <= self._near

    def left(self, told: FloatArray) -> float:
        """What a sample leaves of its target to first order, as the target's rows count it."""
        off = float(told[ERROR]) * self._weight[0], float(told[ANGLE]) * self._weight[1]
        return hypot(*(0.0 if isnan(part) else part for part in off))

    def astray(self, told: FloatArray, off: float) -> bool:
        """Whether a sample that was ``off`` by so much before its step leaves more of its target than steps are to leave."""
        return self.left(told) > max(ASTRAY * off, self._near)

    @property
    def _near(self) -> float:
        """What is as good as nothing, as the target's rows count it."""
        return ON_TARGET * self._weight[1]

    def moved(self, before: FloatArray, after: FloatArray) -> float:
        """The longest step of what is free from what is told of one sample to that of another, in units (9)."""
        return float(np.abs((after - before)[FREE : FREE + len(self._unit)] / self._unit).max())

    def _narrow(self, sample: Sample) -> None:
        """(16d) How far to go along what moves the tip little, where a target is out of reach and steps lead elsewhere."""
        left, before = self.left(sample.told), self._gained
        if left <= self._near and before.left <= self._near and self._narrowed == LONGEST:
            self._gained = Gained(0.0, left, sample.told, sample.under)
            return
        self._gained = Gained(sample.off - left, left, sample.told, sample.under)
        surprise, longest = float(sample.told[SURPRISE]), self._narrowed
        most = max(ASTRAY * before.gain, NOTED * before.left)
        same = sample.under == before.under  # else a load may have moved the tip
        if surprise > most and before.left > self._near and same:
            longest = max(0.5 * min(longest, self.moved(before.told, sample.told)), NEAREST)
        elif surprise <= ASTRAY * most:
            longest = min(1.5 * longest, LONGEST)
        if self._asked is None or self._asked.rested < RESTED:
            self._narrow_to(longest)

    def _narrow_to(self, longest: float) -> None:
        if longest != self._narrowed:
            self._narrowed = longest
            self.nearby.write(longest)

    def _trusted(self, sample: Sample) -> float:
        """(16b) How long a step may be by what the one before came to, in units (9)."""
        asked = self._asked
        if asked is None or (asked.last.target, asked.last.under) != (sample.target, sample.under):
            self._asked, self._trust = Asked(sample, sample, 0), LONGEST
            return LONGEST
        first, last = asked.before, asked.last
        self._asked = Asked(sample, last, asked.rested + 1)
        if self._asked.rested < RESTED:
            return self._trust
        if self._narrowed < LONGEST:  # from here on (16b) has it
            self._trust = self._narrowed
            self._narrow_to(LONGEST)
        left, step = self.left(last.told), self.moved(first.told, last.told)
        missing, gain = sample.off - left, last.off - left
        # what the pull (16c) moves the tip by, to second order, is no fault of the step before
        pulled = self._pulled and len(self._unit) > sample.rows and left <= self._near
        near = MOST_PULL**2 if pulled else ON_TARGET
        if sample.off <= near * self._weight[1] or step < 0.5 * SHORTEST:  # as of a command that is given again
            return self._trust
        if missing > ASTRAY * gain:
            self._trust = max(0.5 * step, SHORTEST)
        elif missing <= SURE * gain and gain * LONGEST > WORTH * sample.off * step:
            self._trust = min(1.5 * self._trust, LONGEST)
        return self._trust
