"""Lines: what runs along a rod at an offset from its centreline, and pulls or pushes; ``docs/lines.md``."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np

from multirod import profile
from multirod.batch import IntArray, take
from multirod.models.backbone.members.member import Member
from multirod.types import Numbers
from multirod.validation import FloatArray, array, choice, nonnegative_float, positive_array, positive_float, refuse

if TYPE_CHECKING:
    from multirod.rod import Section

GAUSS = np.polynomial.legendre.leggauss(16)
EVEN = 1e-12  # what a length at rest per length of rod may differ by and count as the same
PARTS = 4  # in each of which a length at rest is integrated by ``GAUSS``
LEAST_LEVER = 1e-3  # of the rod's length: scales the tension of a line that is on the centreline
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
        result = copy(self)
        result.discs = discs
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


def rod_length(sections: "Sequence[Section]") -> FloatArray:
    """Of a rod of these sections [m], shape (...)."""
    return np.asarray(sum(section.length for section in sections))


class Tendon(Line):
    """A tendon that slides along a rod without friction, and pulls where it ends.

    Args:
        offset: From the centreline in the material frame [m], shape (..., 2).
        route: Instead, a smooth function of the arclength [m] from the rod's base that returns two numbers.
        start: Arclength where it enters the rod [m].
        end: Where it is fastened [m]; None, the default, is the end of the rod.
        driven: The input by which it is driven: ``"tension"`` [N], which is >= 0, or ``"displacement"``, how far it is pulled out
            of the base [m]. It is slack where it would have to push.
        axial_stiffness: ``EA`` [N] of one that is driven by displacement, shape (...); infinite by default: it does not stretch.
        rest_length: Its length without tension [m], of one that is driven by displacement; None, the default, is how long it is
            in the rod without load.
        friction: Coefficient of friction between tendon and rod: > 0 while it is being pulled out of the base, so that its
            tension falls towards its end, and < 0 while it goes back, shape (...).
        name: How it is called in results and recordings.

    Raises:
        TypeError: If both or neither of ``offset`` and ``route`` are given.
        ValueError: If a value is out of range; the message names it, its value and what is allowed.
    """

    drive: ClassVar = ("tension", (1, 0))
    convex = True  # (L4): where tensions are not negative
    friction: FloatArray = np.asarray(0.0)

    def __new__(cls, *_: Any, driven: str = "tension", friction: Any = 0.0, **__: Any) -> Self:
        """Of another law, where it is driven by displacement or rubs."""
        choice("Tendon.driven", driven, ("tension", "displacement"))
        if cls is not Tendon:
            return super().__new__(cls)
        rubs = bool(np.any(array("Tendon.friction", friction, ())))
        laws = {"tension": (Tendon, RubbingTendon), "displacement": (DisplacedTendon, RubbingDisplacedTendon)}
        return super().__new__(laws[driven][rubs])  # type: ignore[return-value]

    def __init__(
        self,
        offset: Numbers | None = None,
        *,
        route: Callable[[float], Numbers] | None = None,
        start: float = 0.0,
        end: float | None = None,
        driven: Literal["tension", "displacement"] = "tension",
        axial_stiffness: Numbers | None = None,
        rest_length: float | None = None,
        friction: Numbers = 0.0,
        name: str = "",
    ) -> None:
        for field, value in (("axial_stiffness", axial_stiffness), ("rest_length", rest_length)):
            if value is not None:
                refuse(f"Tendon.{field}", value, 'must not be given where driven = "tension"')
        super().__init__(offset, route=route, start=start, end=end, name=name)

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:  # noqa: D102
        from multirod.models.backbone.kernels.members.lines import tendon_law

        return tendon_law(numbers, len(Tendon.parameters), discs_at=1)


class DrivenByLength(Line):
    """A line whose length is given and whose tension is unknown, (L7)."""

    drive: ClassVar = ("displacement", (1, 0))
    conditioned = True
    condition: FloatArray  # what ``CONDITION`` says, (..., 8)

    def __init__(
        self, offset: Any = None, *, axial_stiffness: Any = None, rest_length: float | None = None, **where: Any
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
        pushed, pulled, result.reach = result._growth(sections)
        straightened = [replace(section, precurvature=np.zeros(3)) for section in sections]
        _, held, result.reach_straight = result._growth(straightened)
        straight = result.length_at_rest(straightened)
        found = (result.lever(sections), rest / self.axial_stiffness, natural, rest - natural, pushed, pulled, straight, held)
        result.condition = np.stack(np.broadcast_arrays(*found), axis=-1)
        return result

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


class DisplacedTendon(DrivenByLength, Tendon):
    """A ``Tendon`` that is driven by displacement: slack where it would have to push, (L8)."""

    drive: ClassVar = DrivenByLength.drive
    slackens = True
    convex = True

    def __init__(self, *args: Any, driven: str = "displacement", friction: Any = 0.0, **options: Any) -> None:
        DrivenByLength.__init__(self, *args, **options)


class RubbingTendon(Tendon):
    """A ``Tendon`` with friction, (L12)."""

    parameters: ClassVar = {**Line.parameters, "friction": (0, 0)}
    functions: ClassVar = {**Line.functions, "left": (0, 0)}
    rubs = True
    convex = False

    def __init__(self, *args: Any, friction: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.friction = array("Tendon.friction", friction, ())

    @property
    def batch_shape(self) -> tuple[int, ...]:  # noqa: D102
        return np.broadcast_shapes(super().batch_shape, self.friction.shape)

    def values(self, section: "Section", s: float) -> FloatArray:  # noqa: D102
        own = super().values(section, s)
        shape = np.broadcast_shapes(own.shape[:-1], self.friction.shape)
        own, count = np.broadcast_to(own, (*shape, own.shape[-1])), len(Line.parameters)
        friction = np.broadcast_to(self.friction, shape)[..., None] * own[..., :1]  # none before it begins
        return np.concatenate([own[..., :count], friction, own[..., count:]], axis=-1)

    def smooth(self) -> Tendon:  # noqa: D102
        result = object.__new__(DisplacedTendon if isinstance(self, DisplacedTendon) else Tendon)
        vars(result).update({name: value for name, value in vars(self).items() if name != "friction"})
        return result

    def polynomials(self, s: float) -> tuple[float, float, FloatArray]:  # noqa: D102
        begin, end, terms = super().polynomials(s)
        return begin, end, np.concatenate([terms, np.zeros((*terms.shape[:-1], 1))], axis=-1)

    def _offset_and_slope(self, s: float) -> tuple[FloatArray, FloatArray]:
        rho, slope = super()._offset_and_slope(s)
        return rho[..., :2], slope[..., :2]

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:  # noqa: D102
        from multirod.models.backbone.kernels.members.lines import tendon_law

        return tendon_law(numbers, len(RubbingTendon.parameters), discs_at=1, friction_at=len(Line.parameters))


class RubbingDisplacedTendon(RubbingTendon, DisplacedTendon):
    """The same, driven by displacement: it does not stretch."""

    drive: ClassVar = DrivenByLength.drive

    def __init__(self, *args: Any, friction: Any, axial_stiffness: Any = None, **options: Any) -> None:
        if axial_stiffness is not None:
            refuse(
                "Tendon.axial_stiffness",
                axial_stiffness,
                "must not be given with friction: its tension is not the same all along",
            )
        super().__init__(*args, friction=friction, **options)


class PushRod(DrivenByLength):
    """A push rod: it slides along a rod without friction, and pushes or pulls where it ends.

    Its input is ``displacement``, how far it is pulled out of the base [m]; negative where it is pushed in.

    Args:
        offset: From the centreline in the material frame [m], shape (..., 2).
        route: Instead, a smooth function of the arclength [m] from the rod's base that returns two numbers.
        start: Arclength where it enters the rod [m].
        end: Where it is fastened [m]; None, the default, is the end of the rod.
        driven: ``"displacement"``, the only way.
        axial_stiffness: ``EA`` [N], shape (...); infinite by default.
        bending_stiffness: ``EI`` [N m^2], shape (...); zero by default. Where it is not, the push rod is straight at rest, as the
            rod has to be, and runs at a constant offset.
        rest_length: Its length without load [m]; None, the default, is how long it is in the rod without load.
        name: How it is called in results and recordings.

    Raises:
        TypeError: If both or neither of ``offset`` and ``route`` are given.
        ValueError: If a value is out of range; the message names it, its value and what is allowed.
    """

    parameters: ClassVar = {**Line.parameters, "bending": (1, 2)}

    def __init__(
        self,
        offset: Numbers | None = None,
        *,
        route: Callable[[float], Numbers] | None = None,
        start: float = 0.0,
        end: float | None = None,
        driven: Literal["displacement"] = "displacement",
        axial_stiffness: Numbers | None = None,
        bending_stiffness: Numbers | None = None,
        rest_length: float | None = None,
        name: str = "",
    ) -> None:
        choice("PushRod.driven", driven, ("displacement",))
        own: dict[str, Any] = {"axial_stiffness": axial_stiffness, "rest_length": rest_length}
        super().__init__(offset, route=route, start=start, end=end, name=name, **own)
        given = bending_stiffness is not None
        self.bending_stiffness = positive_array("PushRod.bending_stiffness", bending_stiffness) if given else np.asarray(0.0)
        if given and route is not None:
            refuse("PushRod.bending_stiffness", bending_stiffness, "must not be given with a route: its offset must be constant")

    @property
    def batch_shape(self) -> tuple[int, ...]:  # noqa: D102
        return np.broadcast_shapes(super().batch_shape, self.bending_stiffness.shape)

    def on(self, sections: "Sequence[Section]", discs: float = 0.0) -> Self:  # noqa: D102
        straight = not any(isinstance(s.precurvature, profile.Profile) or np.any(s.precurvature) for s in sections)
        if self.bending_stiffness.any() and not straight:
            refuse(
                "PushRod.bending_stiffness", self.bending_stiffness.tolist(), "must not be given where the rod is bent at rest"
            )
        return super().on(sections, discs)

    def values(self, section: "Section", s: float) -> FloatArray:  # noqa: D102
        found = super().values(section, s)
        shape = np.broadcast_shapes(found.shape[:-1], self.bending_stiffness.shape)
        found = np.broadcast_to(found, (*shape, found.shape[-1]))
        bending = np.broadcast_to(self.bending_stiffness, shape)[..., None] * found[..., :1]
        own = len(Line.parameters)
        return np.concatenate([found[..., :own], bending, found[..., own:]], axis=-1)

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:  # noqa: D102
        from multirod.models.backbone.kernels.members.lines import tendon_law

        return tendon_law(numbers, len(PushRod.parameters), bending_at=len(Line.parameters), discs_at=1)


def refuse_redundant(lines: "Sequence[Line]", extensible: bool) -> None:
    """Refuse push rods that do not stretch and are more than their lengths determine, by a ``ValueError``."""
    rigid = [
        line for line in lines if isinstance(line, PushRod) and line.offset is not None and np.isinf(line.axial_stiffness).any()
    ]
    for span in {(line.start, line.end) for line in rigid}:
        beside = [line for line in rigid if (line.start, line.end) == span]
        offsets = np.stack(np.broadcast_arrays(*(np.asarray(line.offset) for line in beside)), axis=-2)
        if extensible:
            offsets = np.concatenate([offsets, np.full((*offsets.shape[:-1], 1), np.abs(offsets).max())], axis=-1)
        if np.min(np.linalg.matrix_rank(offsets, tol=1e-9 * np.abs(offsets).max())) < len(beside):
            refuse(
                "PushRod.axial_stiffness",
                np.inf,
                f"must be finite: {len(beside)} push rods beside each other that do not stretch have no tensions of their own",
            )


def refuse_beside_friction(lines: "Sequence[Line]", members: "Sequence[Member]") -> None:
    """Refuse what the equations of friction leave out, by a ``ValueError``."""
    rubbing = [line for line in lines if line.rubs]
    if not rubbing:
        return
    friction = np.asarray(rubbing[0].friction).tolist()  # type: ignore[attr-defined]
    if members:
        refuse("Tendon.friction", friction, "must be zero in a rod with members")


class Chamber(Line):
    """A chamber along a rod, filled with a fluid: its pressure lengthens it.

    Its input is ``pressure`` [Pa], more than around the robot.

    Args:
        offset: Of its middle from the centreline in the material frame [m], shape (..., 2).
        route: Instead, a smooth function of the arclength [m] from the rod's base that returns two numbers.
        area: Of its section [m^2], shape (...).
        area_fixed: What does not change as the rod bends: the area ``"across"`` the chamber's own direction, or that in the
            ``"section"`` of the rod (``docs/lines.md``, L9).
        start: Arclength where it begins [m].
        end: Where it ends [m]; None, the default, is the end of the rod.
        name: How it is called in results and recordings.

    Raises:
        TypeError: If both or neither of ``offset`` and ``route`` are given.
        ValueError: If a value is out of range; the message names it, its value and what is allowed.
    """

    parameters: ClassVar = {"weight": (0, 2), "discs": (0, 2)}
    drive: ClassVar = ("pressure", (1, -2))

    def __new__(cls, *_: Any, area_fixed: str = "across", **__: Any) -> Self:
        """Of another law, where the area in the section is fixed."""
        choice("Chamber.area_fixed", area_fixed, ("across", "section"))
        return super().__new__(SectionChamber if cls is Chamber and area_fixed == "section" else cls)  # type: ignore[return-value]

    def __init__(
        self,
        offset: Numbers | None = None,
        *,
        route: Callable[[float], Numbers] | None = None,
        area: Numbers | None = None,
        area_fixed: Literal["across", "section"] = "across",
        start: float = 0.0,
        end: float | None = None,
        name: str = "",
    ) -> None:
        super().__init__(offset, route=route, start=start, end=end, name=name)
        if area is None:
            raise TypeError("Chamber needs area")
        self.area = positive_array("Chamber.area", area)
        self.weight = -self.area

    @property
    def batch_shape(self) -> tuple[int, ...]:  # noqa: D102
        return np.broadcast_shapes(super().batch_shape, np.shape(self.area))

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:  # noqa: D102
        from multirod.models.backbone.kernels.members.lines import tendon_law

        return tendon_law(numbers, len(Chamber.parameters))


class SectionChamber(Chamber):
    """A ``Chamber`` whose area in the rod's section is fixed, (L9)."""

    convex = True  # the energy is linear

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:  # noqa: D102
        from multirod.models.backbone.kernels.members.lines import section_chamber_law

        return section_chamber_law(numbers, len(Chamber.parameters))
