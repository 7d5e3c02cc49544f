"""Lines: what runs along a rod at an offset from its centreline, and pulls or pushes; ``docs/lines.md``."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypedDict, Unpack

import numpy as np

from multirod import profile
from multirod.batch import IntArray, take
from multirod.models.backbone.members.member import Member
from multirod.read_only import ReadOnly, changed
from multirod.types import Numbers
from multirod.validation import FloatArray, array, nonnegative_float, positive_array, positive_float, refuse

if TYPE_CHECKING:
    from multirod.rod import Section

GAUSS = np.polynomial.legendre.leggauss(16)
EVEN = 1e-12  # what a length at rest per length of rod may differ by and count as the same
PARTS = 4  # in each of which a length at rest is integrated by ``GAUSS``
LEAST_LEVER = 1e-3  # of the rod's length: scales the tension of a line that is on the centreline
DEGREE = 11  # of the polynomials that hold a route: a turn of a helix takes four
ROUNDED = 1e-12  # of the rod's length: what an end may be past the rod's


class Line(ReadOnly, Member):
    """A line along a rod, at an offset ``rho`` from its centreline that is fixed in the material frame, or a route ``rho(s)``.

    Attributes:
        name: How it is called in results and recordings.
        offset: In the plane of the section [m], shape (..., 2); None where a route is given.
        start: Arclength from the rod's base where it begins [m].
        end: Where it ends and is fastened [m]; None is the end of the rod.
        batch_shape: Leading axes of its offset.
    """

    written = frozenset({"offset", "start", "end", "name"})
    instead = "make another line, and a rod with it"
    # zero where the line is not; and what discs take away, (L11)
    parameters: ClassVar = {"weight": (0, 0), "discs": (0, 2)}
    functions: ClassVar = {"x": (0, 1), "y": (0, 1)}
    discs = 0.0  # their spacing [m]; zero where there are none
    reach = np.inf  # how far its rod may be pulled into the base [m]
    reach_straight = np.inf  # the same of a rod that is held straight behind it
    weight: Any = 1.0  # what its length is multiplied by in what its drive works on, and its drive to be a tension

    def __init__(
        self,
        offset: Numbers | None = None,
        *,
        route: Callable[[float], Numbers] | None = None,
        start: float = 0.0,
        end: float | None = None,
        name: str = "",
    ) -> None:
        field = type(self).__name__
        if (offset is None) == (route is None):
            raise TypeError(f"{field} takes either offset or route")
        self.offset = None if offset is None else array(f"{field}.offset", offset, (2,))
        self._route: Any = route
        if route is not None and not callable(route):
            refuse(f"{field}.route", route, "must be a function of arclength that returns two numbers")
        self.start = nonnegative_float(f"{field}.start", start)
        self.end = None if end is None else positive_float(f"{field}.end", end)
        if self.end is not None and self.end <= self.start:
            refuse(f"{field}.end", end, f"must be > start = {self.start:g} m")
        if not isinstance(name, str):
            refuse(f"{field}.name", name, "must be a string")
        self.name = name
        self._resolved: profile.Profile | None = None
        self._last = np.inf

    @property
    def batch_shape(self) -> tuple[int, ...]:  # noqa: D102
        return () if self.offset is None else self.offset.shape[:-1]

    def on(self, sections: "Sequence[Section]", discs: float = 0.0) -> Self:
        """The line on a rod of these sections, its route resolved; through discs of this spacing [m], if it is not zero.

        Raises:
            ValueError: If it leaves the rod, or its route is not two finite numbers.
        """
        lengths = rod_length(sections)
        field, shortest, longest = type(self).__name__, float(lengths.min()), float(lengths.max())
        if self.end is not None and self.end > shortest * (1 + ROUNDED):
            refuse(f"{field}.end", self.end, f"must be at most the length of the rod, {shortest:g} m")
        if self.start >= shortest:
            refuse(f"{field}.start", self.start, f"must be less than the length of the rod, {shortest:g} m")
        result = changed(self, discs=discs)
        if self.end is not None and self.end < shortest * (1 - ROUNDED):
            result._last = self.end
        if self._route is not None:
            size = min(result._last, longest) - self.start
            result._resolved = profile.fit(f"{field}.route", self._route, size, 2, start=self.start, degree=DEGREE)
        return result

    def __getstate__(self) -> dict[str, Any]:
        """Without the function: the polynomials are all that a solve needs."""
        return {**vars(self), "_route": None if self._route is None else self._resolved}

    def smooth(self) -> "Line":
        """The same without friction."""
        return self

    @property
    def cuts(self) -> Sequence[float]:  # noqa: D102
        inner = [] if self._resolved is None else (self.start + self._resolved.ends[:-1]).tolist()
        return [*([self.start] if self.start else []), *inner, *([self._last] if np.isfinite(self._last) else [])]

    def values(self, section: "Section", s: float) -> FloatArray:  # noqa: D102
        weight = np.asarray(self.weight * float(self.start <= s < self._last))
        return np.stack([weight, np.full(weight.shape, self.discs**2 / 24)], axis=-1)

    def polynomials(self, s: float) -> tuple[float, float, FloatArray]:  # noqa: D102
        if self.offset is not None:
            return 0.0, 1.0, self.offset[..., None, :]
        assert self._resolved is not None
        if not self.start <= s <= self._last:  # a polynomial has no bounds beyond its piece
            return 0.0, 1.0, np.zeros_like(self._resolved.coefficients[0])
        begin, end, coefficients = self._resolved.piece(s - self.start)
        return self.start + begin, self.start + end, coefficients

    def lever(self, sections: "Sequence[Section]") -> FloatArray:
        """How far from the centreline it begins [m], shape (...): what scales its tension."""
        least = LEAST_LEVER * float(rod_length(sections).max())
        return np.asarray(np.maximum(np.linalg.norm(self._offset_and_slope(self.start)[0], axis=-1), least))

    def arm(self, sections: "Sequence[Section]") -> float:
        """How far from the centreline it runs at most [m]."""
        last = min(self._last, float(rod_length(sections).max()))
        places = np.linspace(self.start, last, 1 if self.offset is not None else 65)
        return max(float(np.linalg.norm(self._offset_and_slope(s)[0], axis=-1).max()) for s in places)

    def length_at_rest(self, sections: "Sequence[Section]") -> FloatArray:
        """How long the line is in a rod of these sections that nothing loads [m], shape (...)."""
        total = begin = np.asarray(0.0)
        for section in sections:
            end = begin + section.length
            curve = section.precurvature
            own: Any = float(np.max(begin)) + curve.ends if isinstance(curve, profile.Profile) else []
            stops = [begin, *(np.clip(cut, begin, end) for cut in sorted({*self.cuts, *own})), end]
            for start, stop in pairwise(stops):
                if self.start <= np.max(start + stop) / 2 <= self._last:
                    total = total + self._length_between(section, begin, start, stop)
            begin = end
        return np.asarray(total)

    def _length_between(self, section: "Section", begin: FloatArray, start: FloatArray, stop: FloatArray) -> FloatArray:
        """(L1) The same of a stretch from ``start`` to ``stop`` (...) of a section that begins at ``begin``, without cuts."""
        total = np.asarray(0.0)
        for part in range(PARTS):
            for node, weight in zip(*GAUSS, strict=True):
                s = float(np.max(start + (stop - start) * (part + (1 + node) / 2) / PARTS))
                curve = section.precurvature
                u = curve(s - float(np.max(begin))) if isinstance(curve, profile.Profile) else curve
                total = total + self._rate(u, *self._offset_and_slope(s)) * weight / (2 * PARTS)
        return np.asarray(total * (stop - start))

    def _rate(self, u: FloatArray, rho: FloatArray, slope: FloatArray) -> FloatArray:
        """(L1), (L11) Length per length of a rod of curvature ``u`` that does not stretch."""
        x, y = rho[..., 0], rho[..., 1]
        a = (slope[..., 0] - u[..., 2] * y, slope[..., 1] + u[..., 2] * x, 1 + u[..., 0] * y - u[..., 1] * x)
        straight = 1 - self.discs**2 / 24 * (u[..., 0] ** 2 + u[..., 1] ** 2)
        return np.asarray(straight * np.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2))

    def _offset_and_slope(self, s: float) -> tuple[FloatArray, FloatArray]:
        """``rho`` [m] and its derivative by the arclength, each (..., 2)."""
        begin, end, terms = self.polynomials(s)
        t, powers = 2 * (s - begin) / (end - begin) - 1, np.arange(terms.shape[-2])
        slopes = 2 / (end - begin) * powers * t ** np.maximum(powers - 1, 0)
        return t**powers @ terms, slopes @ terms

    def offset_at(self, s: FloatArray, batch_shape: tuple[int, ...], instances: IntArray | None) -> FloatArray:
        """``rho`` [m] at arclengths of the rod (k, node_count) of k instances of a batch, shape (k, node_count, 2).

        NaN where the line is not; what is pushed out of the base goes on as the line begins.
        """
        inside = (s >= self.start * (1 - ROUNDED)) | (self.start == 0)
        inside &= s <= self._last * (1 + ROUNDED)
        if self.offset is not None:
            own = take(self.offset, batch_shape, instances, tail=1) if self.offset.ndim > 1 else self.offset[None]
            found = np.broadcast_to(own[:, None], (*s.shape, 2))
        else:
            assert self._resolved is not None
            values = [self._resolved(x) for x in np.clip(s - self.start, 0.0, self._resolved.ends[-1]).ravel()]
            found = np.reshape(values, (*s.shape, 2))
        return np.where(inside[..., None], found, np.nan)

    def __repr__(self) -> str:
        where = f"offset={self.offset.tolist()}" if self.offset is not None else "route"
        return f"{type(self).__name__}({where}{f', name={self.name!r}' if self.name else ''})"


class Where(TypedDict, total=False):
    """Where a line runs, and how it is called."""

    route: Callable[[float], Numbers] | None
    start: float
    end: float | None
    name: str


class DrivenByLength(Line):
    """A line whose length is given and whose tension is unknown, (L7)."""

    written = Line.written | {"axial_stiffness", "rest_length"}
    drive: ClassVar = ("displacement", (1, 0))
    conditioned = True
    condition: FloatArray  # what ``CONDITION`` says, (..., 8)

    def __init__(
        self,
        offset: Numbers | None = None,
        *,
        axial_stiffness: Numbers | None = None,
        rest_length: float | None = None,
        **where: Unpack[Where],
    ) -> None:
        Line.__init__(self, offset, **where)
        field = type(self).__name__.removeprefix("Displaced")
        self.axial_stiffness = np.inf if axial_stiffness is None else positive_array(f"{field}.axial_stiffness", axial_stiffness)
        self.rest_length = None if rest_length is None else positive_float(f"{field}.rest_length", rest_length)

    @property
    def batch_shape(self) -> tuple[int, ...]:  # noqa: D102
        return np.broadcast_shapes(super().batch_shape, np.shape(self.axial_stiffness))

    def on(self, sections: "Sequence[Section]", discs: float = 0.0) -> Self:  # noqa: D102
        result = super().on(sections, discs)
        lengths = rod_length(sections)
        if result._resolved is not None and np.ptp(lengths) > 0:
            refuse(
                f"{type(self).__name__}.route", "a function", "must not be given for rods of several lengths: make a rod of each"
            )
        natural = result.length_at_rest(sections)
        rest = natural if self.rest_length is None else np.asarray(self.rest_length)
        pushed, pulled, reach = result._growth(sections)
        straightened = [replace(section, precurvature=np.zeros(3)) for section in sections]
        _, held, reach_straight = result._growth(straightened)
        straight = result.length_at_rest(straightened)
        found = (result.lever(sections), rest / self.axial_stiffness, natural, rest - natural, pushed, pulled, straight, held)
        condition = np.stack(np.broadcast_arrays(*found), axis=-1)
        return changed(result, condition=condition, reach=reach, reach_straight=reach_straight)

    def _growth(self, sections: "Sequence[Section]") -> tuple[FloatArray, FloatArray, float]:
        """(L7b) Rest length per length of rod that is pushed out of the base, or pulled into it, and how far that is so."""
        none = np.zeros(())
        if self.start:
            return none, none, self.start  # all of it is beyond
        ends = [float(np.min(end)) for end in np.cumsum([s.length for s in sections], axis=0)]
        places = np.unique([0.0, *self.cuts, *ends])
        places = places[places <= min(self._last, ends[-1])]
        pushed, pulled, reach = self._rest_rate(sections[0], 0.0, moving=False), self._rest_rate(sections[0], 0.0), 0.0
        for a, b in pairwise(places):
            k = int(np.searchsorted(ends, (a + b) / 2))
            section, begin = sections[k], ends[k - 1] if k else 0.0
            curve = section.precurvature
            inside = a + (b - a) * (1 + GAUSS[0]) / 2
            if isinstance(curve, profile.Profile):
                inside = np.concatenate([inside, begin + curve.ends[:-1]])
            rates = [self._rest_rate(section, float(s), begin) for s in inside]
            if not all(np.allclose(rate, pulled, rtol=0, atol=EVEN) for rate in rates):
                break
            reach = float(b)
        return pushed, pulled, reach

    def _rest_rate(self, section: "Section", s: float, begin: float = 0.0, *, moving: bool = True) -> FloatArray:
        """(L1) Its length per length of rod where nothing loads that, in a section that begins at ``begin``; where its offset is
        not ``moving``, as if that were constant."""
        curve = section.precurvature
        u = curve(s - begin) if isinstance(curve, profile.Profile) else curve
        rho, slope = self._offset_and_slope(s)
        return self._rate(u, rho, slope if moving else np.zeros_like(slope))

    def values(self, section: "Section", s: float) -> FloatArray:  # noqa: D102
        own = super().values(section, s)
        return np.concatenate([np.broadcast_to(own, (*self.condition.shape[:-1], own.shape[-1])), self.condition], axis=-1)


def rod_length(sections: "Sequence[Section]") -> FloatArray:
    """Of a rod of these sections [m], shape (...)."""
    return np.asarray(sum(section.length for section in sections))
