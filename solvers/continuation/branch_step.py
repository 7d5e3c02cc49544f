"""What happens to the stability of equilibria within one step along their branch.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from multirod.solvers.continuation.crossings import at, cubic, settled
from multirod.stability import NEUTRAL, Modes
from multirod.validation import FloatArray

WIDEST = 0.26  # part of a step that is judged
NARROWEST = 1e-5  # part that is cut no further
SAFETY = 2.0  # of the whole's error for its halves, where a sixteenth is usual
CUTS = 256  # of one step, at most
LOST = "Newton's method fails: the branch ends, or rounding hides it"
BESIDE = 3e-3  # of a part's length, how far from the cubic through its ends the branch may pass
BLUR = 1e-7  # and by how much more: what tolerances leave of a place
RETURN = 0.5  # smallest cosine between the tangents of a step
EXACT = 1e-8  # of an eigenvalue over K/L: what the integration leaves of it, where columns do not tell
SAME = 1e-5  # of a step: changes no further apart are one, of several modes
NUDGE = 1e-7  # of a step
HIDDEN = 1e-8  # of how far a branch leads: within which a change is told by what is on both sides of it
LEVEL = 1e-3  # slope of the load along the branch under which it has a fold


@dataclass(frozen=True)
class Point:
    """An equilibrium on a branch.

    Attributes:
        place: Unknowns times a length, then the load factor in its unit, shape (n + 1,).
        tangent: Of the branch, unit length, shape (n + 1,).
        gamma: Shape (n, n).
        modes: Of the one instance.
    """

    place: FloatArray
    tangent: FloatArray
    gamma: FloatArray
    modes: Modes

    @property
    def index(self) -> int:
        """Unstable modes, one that is nearly neutral by its sign."""
        return int(self.modes.hidden[0] + (self.modes.values[0] < 0).sum())


@dataclass(frozen=True)
class Change:
    """Where a branch loses or regains stability.

    Attributes:
        point: There.
        fold: Whether the load turns there, else another branch crosses.
        before: Unstable modes before.
        after: And after.
    """

    point: Point
    fold: bool
    before: int
    after: int


@dataclass(frozen=True)
class Step:
    """A step along a branch.

    Attributes:
        before: Where it begins.
        after: Where it ends.
        changes: Of the number of unstable modes, in their order.
        undecided: Parts, by points on them, in which a mode comes so near to neutral that two changes may have been missed.
    """

    before: Point
    after: Point
    changes: tuple[Change, ...]
    undecided: tuple[tuple[Point, ...], ...]

    def along(self, point: Point) -> float:
        """How far from its beginning a point is, along the tangent there."""
        return float(self.before.tangent @ (point.place - self.before.place))

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Places at both ends and how they change over the step, (2, n + 1) each."""
        points = (self.before, self.after)
        slopes = [self.along(self.after) / (point.tangent @ self.before.tangent) * point.tangent for point in points]
        return np.array([point.place for point in points]), np.array(slopes)


class Apart(RuntimeError):
    """The ends of a step are not on one smooth branch, as far as can be seen."""


class Unknown(Apart):
    """Stability is not known at a place."""


class Follower(Protocol):
    """Finds equilibria on a branch."""

    def on_branch(self, place: FloatArray, ahead: FloatArray) -> Point | None:
        """The equilibrium near ``place`` in the plane across ``ahead``; None if it is not found."""

    def slopes(self, point: Point, numbers: range) -> FloatArray:
        """How ``heights`` change along the branch, per length."""


def heights(modes: Modes, numbers: range) -> FloatArray:
    """(16) Eigenvalues, 0 the lowest, on a scale from -1 to 1 on which they are continuous through conjugate points."""
    with np.errstate(invalid="ignore"):
        return 2 / np.pi * np.arctan([float(modes.eigenvalue(k)[0]) for k in numbers])


@dataclass(frozen=True)
class _Sample:
    """A point of a step, at a distance along the tangent where the step begins."""

    distance: float
    point: Point


@dataclass(frozen=True)
class _Part:
    """A part of a step, and how far eigenvalues may be from their cubics on it; None if that is not known yet."""

    left: _Sample
    right: _Sample
    error: FloatArray | None

    @property
    def length(self) -> float:
        return self.right.distance - self.left.distance


class Inspection:
    """Cuts a step in two until the signs of eigenvalues at the ends of each part say all that happens in it.

    Args:
        follower: Of the branch.
        before: Where the step begins.
        after: Where it ends, in the plane across the tangent there at a distance ``length``.
        length: Of the step.
        cuts: After which it is cut no further; 0 takes the signs at its ends for all that happens.
    """

    def __init__(self, follower: Follower, before: Point, after: Point, length: float, cuts: int = CUTS) -> None:
        self._follower, self._cuts = follower, cuts
        self._before, self._after, self._length = before, after, length
        self._numbers = range(max(before.index, after.index) + 2)
        self._slopes: dict[float, FloatArray] = {}  # by the distance
        self._points: dict[float, Point] = {}  # where eigenvalues vanish, by the distance
        self._neutral: frozenset[int] = frozenset()  # all along the step

    def step(self) -> Step:
        """What happens within the step.

        Raises:
            Apart: If its ends are not on one smooth branch, as far as can be seen.
        """
        open_ = [_Part(_Sample(0.0, self._before), _Sample(self._length, self._after), None)]
        places: list[tuple[float, int]] = []
        stretches: list[list[_Sample]] = []  # that are undecided
        cuts = 0
        while open_:
            part = open_.pop()
            wide = self._cuts > 0 and (part.error is None or part.length > WIDEST * self._length)
            sure = part.error is not None and not wide and self._sure(part)
            if wide or (not sure and cuts < self._cuts and part.length > NARROWEST):
                middle, error = self._cut(part)
                if part.error is None:
                    self._neutral = _neutral([self._before, middle.point, self._after])
                open_ += [_Part(middle, part.right, error), _Part(part.left, middle, error)]
                cuts += 1
                continue
            places += self._places(part)
            if not sure:
                if stretches and stretches[-1][-1] is part.left:
                    stretches[-1].append(part.right)
                else:
                    stretches.append([part.left, part.right])
        changes = self._changes(_by_stretch(self._merged(places), stretches))
        undecided = tuple(tuple(sample.point for sample in stretch) for stretch in stretches)
        if self._neutral:
            undecided = ((self._before, self._after),)
        return Step(self._before, self._after, changes, undecided)

    def _cut(self, part: _Part) -> tuple[_Sample, FloatArray]:
        """The middle of a part, and how far eigenvalues may be from their cubics on either side of it."""
        left, right = part.left, part.right
        middle = self._at(part, 0.5 * (left.distance + right.distance))
        self._numbers = range(max(self._numbers.stop, middle.point.index + 2))
        t = (middle.distance - left.distance) / part.length
        found = heights(middle.point.modes, self._numbers)
        with np.errstate(invalid="ignore"):
            missed = np.abs(at(cubic(*self._ends(part, self._numbers)), t) - found)
        blurred = np.max([_uncertainty(sample.point.modes, self._numbers) for sample in (left, middle, right)], axis=0)
        return middle, SAFETY * missed + blurred + EXACT

    def _sure(self, part: _Part) -> bool:
        """Whether the signs of eigenvalues at the ends say all that happens in a part."""
        assert part.error is not None
        indices = (part.left.point.index, part.right.point.index)
        # those below the first keep their sign if it does, those above the last too
        numbers = range(max(min(indices) - 1, 0), max(indices) + 1)
        if numbers.stop > len(part.error):
            return False
        sure = settled(*self._ends(part, numbers), part.error[numbers.start : numbers.stop])
        return all(yes or k in self._neutral for k, yes in zip(numbers, sure, strict=True))

    def _ends(self, part: _Part, numbers: range) -> tuple[FloatArray, FloatArray]:
        """Eigenvalues at both ends of a part, and how they change over it, (2, k) each."""
        samples = (part.left, part.right)
        values = np.array([heights(sample.point.modes, numbers) for sample in samples])
        return values, part.length * np.array([self._slope(sample, numbers) for sample in samples])

    def _slope(self, sample: _Sample, numbers: range) -> FloatArray:
        """How eigenvalues change with the distance along the step."""
        known = self._slopes.get(sample.distance)
        if known is None or len(known) < numbers.stop:
            everyone = range(max(numbers.stop, self._numbers.stop))
            known = self._follower.slopes(sample.point, everyone) / (sample.point.tangent @ self._before.tangent)
            self._slopes[sample.distance] = known
        return known[numbers.start : numbers.stop]

    def _at(self, part: _Part, distance: float) -> _Sample:
        """The point at a distance in a part, a little further if stability is not known there."""
        for place in (distance, distance + NUDGE * part.length):
            samples = (part.left, part.right)
            slopes = [part.length * s.point.tangent / (s.point.tangent @ self._before.tangent) for s in samples]
            path = cubic(np.array([s.point.place for s in samples]), np.array(slopes))
            expected = at(path, (place - part.left.distance) / part.length)
            point = self._follower.on_branch(expected, self._before.tangent)
            if point is None:
                raise Apart(LOST)
            if (
                np.linalg.norm(point.place - expected) > BESIDE * part.length + BLUR
                or point.tangent @ self._before.tangent < RETURN
            ):
                raise Apart("another branch is too near to be told apart")
            if point.modes.known[0]:
                return _Sample(place, point)
        raise Unknown("stability is not known: rounding hides it")

    def _places(self, part: _Part) -> list[tuple[float, int]]:
        """Where eigenvalues change their sign, and how the number of unstable modes changes; not of modes that stay neutral."""
        before, after = part.left.point.index, part.right.point.index
        low, high = min(before, after), max(before, after)
        return [(self._root(part, k), 1 if after > before else -1) for k in range(low, high) if k not in self._neutral]

    def _root(self, part: _Part, k: int) -> float:
        """How far along the step eigenvalue ``k`` vanishes."""
        from scipy.optimize import brentq

        left, right = part.left, part.right
        seen = {left.distance: left.point, right.distance: right.point}

        def value(place: float) -> float:
            if place not in seen:
                seen[place] = self._at(part, place).point
            return float(heights(seen[place].modes, range(k, k + 1))[0])

        try:
            place = float(brentq(value, left.distance, right.distance, xtol=1e-12 * part.length, rtol=1e-14))
            value(place)
        except Unknown:  # of a mode that no eigenvalue shows, its place is where rounding hides whether there is one
            place = max(own for own in seen if (value(own) < 0) == (value(left.distance) < 0))
            if min(own for own in seen if own > place) - place > HIDDEN * max(1.0, np.abs(left.point.place).max()):
                raise
        self._points[place] = seen[place]
        return place

    def _merged(self, places: list[tuple[float, int]]) -> list[tuple[float, int]]:
        """Changes in their order, those at one place as one."""
        merged: list[tuple[float, int]] = []
        for place, sign in sorted(places):
            if merged and sign * merged[-1][1] > 0 and place - merged[-1][0] < SAME * self._length:
                merged[-1] = (merged[-1][0], merged[-1][1] + sign)
            else:
                merged.append((place, sign))
        return merged

    def _changes(self, places: list[tuple[float, int]]) -> tuple[Change, ...]:
        """The changes at places in their order, and by how much."""
        result: list[Change] = []
        index = self._before.index
        for place, difference in places:
            point = self._points[place]
            fold = abs(difference) == 1 and abs(point.tangent[-1]) < LEVEL
            result.append(Change(point, fold, index, index + difference))
            index += difference
        return tuple(result)


def _by_stretch(changes: list[tuple[float, int]], stretches: Sequence[Sequence[_Sample]]) -> list[tuple[float, int]]:
    """Changes to and fro on a stretch that is undecided, beyond which there are more unstable modes than before it, or fewer, as
    one, where the most change: of modes that vanish together signs are noise next to there."""
    for first, *_, last in stretches:
        own = [change for change in changes if first.distance <= change[0] <= last.distance]
        net = sum(difference for _, difference in own)
        if net and max(difference for _, difference in own) > 0 > min(difference for _, difference in own):
            place = max(own, key=lambda change: abs(change[1]))[0]
            changes = sorted([*(change for change in changes if change not in own), (place, net)])
    return changes


def _neutral(points: Sequence[Point]) -> frozenset[int]:
    """Eigenvalues that are neutral at all of some points."""
    last = max(point.index for point in points) + 1
    numbers = range(max(min(point.index for point in points) - 1, 0), last)
    return frozenset(k for k in numbers if all(abs(point.modes.eigenvalue(k)[0]) <= NEUTRAL for point in points))


def _uncertainty(modes: Modes, numbers: range) -> FloatArray:
    """Of ``heights``."""
    own = modes.uncertainty[0]
    places = np.array(numbers) - int(modes.hidden[0])
    inside = (places >= 0) & (places < len(own))
    return np.where(inside, 2 / np.pi * own[np.clip(places, 0, len(own) - 1)], 0.0)
