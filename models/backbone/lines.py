"""Lines: what runs along a rod at an offset from its centreline and is pulled; ``docs/lines.md``."""

from collections.abc import Callable, Sequence
from copy import copy
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from multirod import profile
from multirod.batch import IntArray, take
from multirod.models.backbone.members import Member
from multirod.validation import FloatArray, array, choice, nonnegative_float, positive_float, refuse

if TYPE_CHECKING:
    from multirod.rod import Section

DEGREE = 11  # of the polynomials that hold a route: a turn of a helix takes four
ROUNDED = 1e-12  # of the rod's length: what an end may be past the rod's


class Line(Member):
    """A line along a rod, at an offset ``rho`` from its centreline that is fixed in the material frame, or a route ``rho(s)``.

    Attributes:
        name: How it is called in results and recordings.
        offset: In the plane of the section [m], shape (..., 2); None where a route is given.
        start: Arclength from the rod's base where it begins [m].
        end: Where it ends and is fastened [m]; None is the end of the rod.
        batch_shape: Leading axes of its offset.
    """

    parameters: ClassVar = {"present": (0, 0)}
    functions: ClassVar = {"x": (0, 1), "y": (0, 1)}

    def __init__(self, offset: Any, route: Callable[[float], Any] | None, start: float, end: float | None, name: str) -> None:
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

    def on(self, lengths: FloatArray) -> Self:
        """The line on a rod of these lengths [m], its route resolved.

        Raises:
            ValueError: If it leaves the rod, or its route is not two finite numbers.
        """
        field, shortest, longest = type(self).__name__, float(lengths.min()), float(lengths.max())
        if self.end is not None and self.end > shortest * (1 + ROUNDED):
            refuse(f"{field}.end", self.end, f"must be at most the length of the rod, {shortest:g} m")
        if self.start >= shortest:
            refuse(f"{field}.start", self.start, f"must be less than the length of the rod, {shortest:g} m")
        result = copy(self)
        if self.end is not None and self.end < shortest * (1 - ROUNDED):
            result._last = self.end
        if self._route is not None:
            size = min(result._last, longest) - self.start
            result._resolved = profile.fit(f"{field}.route", self._route, size, 2, start=self.start, degree=DEGREE)
        return result

    def __getstate__(self) -> dict[str, Any]:
        """Without the function: the polynomials are all that a solve needs."""
        return {**vars(self), "_route": None if self._route is None else self._resolved}

    @property
    def cuts(self) -> Sequence[float]:  # noqa: D102
        inner = [] if self._resolved is None else (self.start + self._resolved.ends[:-1]).tolist()
        return [*([self.start] if self.start else []), *inner, *([self._last] if np.isfinite(self._last) else [])]

    def values(self, section: "Section", s: float) -> FloatArray:  # noqa: D102
        return np.array([float(self.start <= s < self._last)])

    def polynomials(self, s: float) -> tuple[float, float, FloatArray]:  # noqa: D102
        if self.offset is not None:
            return 0.0, 1.0, self.offset[..., None, :]
        assert self._resolved is not None
        begin, end, coefficients = self._resolved.piece(s - self.start)
        return self.start + begin, self.start + end, coefficients

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


class Tendon(Line):
    """A tendon that slides along a rod without friction, and pulls where it ends with the tension that it is given.

    Args:
        offset: From the centreline in the material frame [m], shape (..., 2).
        route: Instead, a smooth function of the arclength [m] from the rod's base that returns two numbers.
        start: Arclength where it enters the rod [m].
        end: Where it is fastened [m]; None, the default, is the end of the rod.
        driven: ``"tension"``, the input by which it is driven: its tension [N], which is >= 0.
        name: How it is called in results and recordings.

    Raises:
        TypeError: If both or neither of ``offset`` and ``route`` are given.
        ValueError: If a value is out of range; the message names it, its value and what is allowed.
    """

    drive: ClassVar = ("tension", (1, 0))
    convex = True  # (L4): where tensions are not negative

    def __init__(
        self,
        offset: Any = None,
        *,
        route: Callable[[float], Any] | None = None,
        start: float = 0.0,
        end: float | None = None,
        driven: str = "tension",
        name: str = "",
    ) -> None:
        choice("Tendon.driven", driven, ("tension",))
        super().__init__(offset, route, start, end, name)

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:  # noqa: D102
        from multirod.models.backbone.kernels.lines import tendon_law

        return tendon_law(numbers)
