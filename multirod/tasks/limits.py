"""Limits of freed inputs, and of the shapes that they lead to. Numbers in parentheses: ``docs/tasks.md``."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from types import MappingProxyType
from typing import Any, TypeAlias
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from multirod import plausibility
from multirod.assembly import Assembly
from multirod.by_name import parts_of
from multirod.models.assemblies.concentric_tubes import ConcentricTubes
from multirod.models.assemblies.network import Network
from multirod.models.assemblies.parallel_rods import ParallelRods
from multirod.naming import names_checked, unknown_names
from multirod.read_only import ReadOnly
from multirod.results.remarks import Remarks
from multirod.tasks.formulation import input_units, options
from multirod.tasks.freed import columns, labels_of, named
from multirod.validation import Described, FloatArray, array, nonnegative_float, number, positive_float, refuse, shown

SHORTEST = 1e-3  # of its length, what of a rod stays in use
ROUNDING = 1e-14  # in units (9)
INSET = 1e-10  # likewise, by what steps keep limits, which rounding does not use up
PROJECTIONS = 1000
MOST_KNOWN = 64  # rows that are kept for who asks for the same again
NEAR = 1e-8  # in units (9), what is at a limit
Pair: TypeAlias = tuple[FloatArray, FloatArray]
ROUNDING_BEYOND = 1e-9  # of what counts as one, what a start may be beyond a limit by rounding


class Limits(ReadOnly):
    """What freed inputs may be, and what shapes they may lead to.

    What a robot cannot do is a limit without being named: tubes begin behind the plate, inner ones no less far back than those
    around them, a rod stays in use, tendons do not push.

    Args:
        gap: Of concentric tubes: the least distance between the bases of neighbours, and between their tips, which then are in
            order too, the innermost furthest out [m]. None, the default, is the order of the bases alone.
        curvature: Largest bending ``|u_xy|`` of any rod [1/m].
        stability_margin: Least ``Solution.stability_margin``. Where that is not known, as of loads without a potential, nothing
            is within it: ``OUT_OF_LIMITS``.
        **inputs: Pairs ``(low, high)`` by the name of an input, each a number or one for each rod or line, such as
            ``translation=([-0.2, -0.1], [0, 0])`` of two tubes; ``inf`` is no limit. Also such pairs by names of rods, lines,
            bodies or joints, ``translation={"rod 0": (-6e-3, 6e-3)}``; what is not named has no limit. Of ``tension``
            none is below 0: what can push is driven by ``displacement`` or ``pressure``.

    Raises:
        ValueError: If a pair is none, or empty, or one for each that leaves none of them any range, or a number is out of range,
            such as a negative tension.

    Warns:
        PlausibilityWarning: Of lengths of more than 10 m, as in mm.
    """

    instead = "make others, Limits(...)"

    @names_checked
    def __init__(
        self,
        *,
        gap: float | None = None,
        curvature: float | None = None,
        stability_margin: float | None = None,
        **inputs: object,
    ) -> None:
        self.gap = None if gap is None else nonnegative_float("Limits.gap", gap)
        self.curvature = None if curvature is None else positive_float("Limits.curvature", curvature)
        margin = None if stability_margin is None else number("Limits.stability_margin", stability_margin)
        if margin is not None and not 0 <= margin < inf:
            refuse("Limits.stability_margin", stability_margin, "must be finite and >= 0: what is below is unstable")
        self.stability_margin = margin
        self._inputs = {name: _pairs(name, value) for name, value in inputs.items()}

    @property
    def inputs(self) -> Mapping[str, Pair | Mapping[str, Pair]]:
        """Limits of inputs, by name: ``(low, high)``, or those by names of what they are of."""
        return MappingProxyType(self._inputs)

    @cached_property
    def key(self) -> tuple[object, ...]:
        """What rows of limits follow from, beside the robot and what is free."""
        every = ((name, part, pair) for name, own in self._inputs.items() for part, pair in _by_part(own))
        return self.gap, *((name, part, low.tobytes(), high.tobytes()) for name, part, (low, high) in every)

    @property
    def of_shape(self) -> bool:
        """Whether shapes are limited too."""
        return self.curvature is not None or self.stability_margin is not None

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Names of the limits of shapes that there are."""
        return tuple(name for name in ("curvature", "stability_margin") if getattr(self, name) is not None)

    def __repr__(self) -> str:
        values = {"gap": self.gap, "curvature": self.curvature, "stability_margin": self.stability_margin}
        parts = [f"{name}={value:g}" for name, value in values.items() if value is not None]
        parts += [f"{name}={_shown(own)}" for name, own in self.inputs.items()]
        return f"Limits({', '.join(parts)})"


def _by_part(own: Pair | Mapping[str, Pair]) -> Iterator[tuple[str, Pair]]:
    """Limits of an input and what each is of, which is empty of the whole."""
    yield from own.items() if isinstance(own, Mapping) else (("", own),)


def _shown(own: Pair | Mapping[str, Pair]) -> str:
    pairs = {part: f"({low.tolist()}, {high.tolist()})" for part, (low, high) in _by_part(own)}
    return f"{{{', '.join(f'{part!r}: {pair}' for part, pair in pairs.items())}}}" if isinstance(own, Mapping) else pairs[""]


def _pairs(name: str, value: object) -> Pair | Mapping[str, Pair]:
    if not isinstance(value, Mapping):
        return _pair(name, f"Limits.{name}", value)
    return MappingProxyType({part: _pair(name, f"Limits.{name}[{part!r}]", own) for part, own in value.items()})


def _pair(name: str, field: str, value: object) -> Pair:
    pair = list(value) if isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.ndim) else []
    if len(pair) != 2:
        refuse(field, value, f"must be a pair (low, high){_by_end(pair)}")
    low, high = (array(field, end, finite=False) for end in pair)
    if low.ndim > 1 or high.ndim > 1 or np.isnan(low).any() or np.isnan(high).any():
        refuse(field, value, "must be (low, high), each a number or one for each")
    if len({end.shape for end in (low, high) if end.ndim}) > 1 or (low > high).any():
        refuse(field, value, "must be (low, high) with low <= high, of the same length")
    listed = isinstance(value, list) and all(isinstance(end, tuple) for end in value)  # as pairs are
    if low.size > 1 and high.size > 1 and ((low == high).all() or (listed and (low == high).any())):
        refuse(field, value, f"must be (low, high), all lows first; as it is, low = high{_by_end(pair)}")
    if name == "tension" and ((low < 0) & np.isfinite(low)).any():
        allowed = f"low must be >= 0: tendons do not push; give (0, {high.tolist()}), or drive push rods by displacement"
        refuse(field, value, allowed)
    plausibility.of_limits(field, name, np.concatenate([low.ravel(), high.ravel()]))
    return low, high


def _by_end(pairs: list[Any]) -> str:
    """How to write a list of pairs, one for each rod, as the end of a message."""
    try:
        lows, highs = zip(*((shown(low), shown(high)) for low, high in pairs), strict=True)
    except (TypeError, ValueError):
        return ""
    return f"; of one pair for each give ([lows], [highs]): ([{', '.join(lows)}], [{', '.join(highs)}])"


@dataclass(frozen=True)
class LimitRows:
    """(10) ``low <= matrix p <= high`` for the freed numbers ``p``.

    Attributes:
        matrix: Shape (c, k).
        low: Shape (c,).
        high: Shape (c,).
        names: What each row is, for messages.
    """

    matrix: FloatArray
    low: FloatArray
    high: FloatArray
    names: tuple[str, ...]

    def inset(self, unit: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``low`` and ``high``, by so much within them that rounding leads beyond none; ``unit`` is (9), shape (k,)."""
        room = np.minimum(INSET * (np.abs(self.matrix) @ unit), 0.25 * (self.high - self.low))
        return self.low + room, self.high - room

    def nearness(self, unit: FloatArray) -> FloatArray:
        """How near to each row is at it, shape (c,)."""
        return NEAR * (np.abs(self.matrix) @ unit)

    def near(self, values: FloatArray, unit: FloatArray) -> NDArray[np.bool_]:
        """Which rows ``p`` (b, k) stands at, shape (b, c)."""
        at, least = values @ self.matrix.T, self.nearness(unit)
        return np.asarray((at - self.low <= least) | (self.high - at <= least))

    def remarks(self, values: FloatArray, target: FloatArray | None, error: float) -> Remarks:
        """What a recording shows of a sample at ``p`` (k,): limits that have two ends, and a target of the position."""
        matrix, low, width, names = self._ranged
        return Remarks(
            target=target,
            target_error=None if target is None else error,
            limits=(matrix @ values - low) / width if names else None,
            limit_names=names,
        )

    @cached_property
    def both_ways(self) -> tuple[FloatArray, FloatArray]:
        """The same as ``p matrix <= ends``, matrix (k, 2 c) and ends (2 c,)."""
        return np.concatenate([self.matrix.T, -self.matrix.T], axis=1), np.concatenate([self.high, -self.low])

    @cached_property
    def _ranged(self) -> tuple[FloatArray, FloatArray, FloatArray, tuple[str, ...]]:
        """Rows that have two ends: matrix, lower ends, widths, names."""
        width = self.high - self.low
        own = np.isfinite(width) & (width > 0)
        names = tuple(name for name, kept in zip(self.names, own.tolist(), strict=True) if kept)
        return self.matrix[own], self.low[own], width[own], names

    def outside(self, values: FloatArray, unit: FloatArray) -> FloatArray:
        """By how much ``p`` (b, k) is beyond each row, at least 0 where it is not, in units of each, shape (b, c)."""
        at = values @ self.matrix.T
        beyond = np.maximum(self.low - at, at - self.high)
        return np.asarray(np.maximum(beyond / np.maximum(np.abs(self.matrix) @ unit, 1e-300), 0.0))


def told(error: float, angle: float, held_by: Sequence[str]) -> dict[str, str]:
    """How near a single result came to its target, for people; what is NaN was not asked for."""
    parts = {
        "target_error": f"{error:.3g} m" if np.isfinite(error) else "",
        "target_angle": f"{angle:.3g} rad" if np.isfinite(angle) else "",
        "held_by": ", ".join(held_by),
    }
    return {name: text for name, text in parts.items() if text}


_KNOWN: dict[Any, tuple[Any, LimitRows, FloatArray, dict[str, Any]]] = {}


def asked_before(robot: Assembly, limits: Limits | None, free: object) -> tuple[LimitRows, FloatArray, dict[str, Any]] | None:
    """What ``known_rows`` found for these names, which so were checked then; None where it was not asked."""
    try:
        found = _KNOWN.get((id(robot), None if limits is None else limits.key, free))
    except TypeError:  # no tuple of names
        return None
    return None if found is None or found[0]() is not robot else found[1:]


def known_rows(robot: Assembly, limits: Limits | None, free: Sequence[str]) -> tuple[LimitRows, FloatArray, dict[str, Any]]:
    """``limit_rows``, ``input_units`` and the ``options`` of problems as they were found before, the same objects, for a target
    after another."""
    key = id(robot), None if limits is None else limits.key, free if isinstance(free, tuple) else tuple(free)
    found = _KNOWN.get(key)
    if found is None or found[0]() is not robot:
        if len(_KNOWN) >= MOST_KNOWN:
            _KNOWN.clear()
        found = _KNOWN[key] = ref(robot), limit_rows(robot, limits, free), input_units(robot, free), options(robot, free)
    return found[1:]


def limit_rows(robot: Assembly, limits: Limits | None, free: Sequence[str]) -> LimitRows:
    """What limits the freed inputs of a robot: what was given, and what it cannot do.

    Raises:
        TypeError: If a limit is of an input that the robot has not.
        ValueError: If a limit is of an input that is not free, has a wrong length, or leaves nothing.
    """
    given = Limits() if limits is None else limits
    specs = {spec.name: spec for spec in robot.input_specs}
    unknown_names("Limits", given.inputs, specs)
    for name, own_limits in given.inputs.items():
        if name not in free:
            refuse(f"Limits.{name}", Described(_shown(own_limits)), f"must be of an input that is free: {', '.join(free)}")
    sizes = [specs[name].size(robot.rod_count) for name in free]
    starts = dict(zip(free, np.cumsum([0, *sizes]).tolist(), strict=False))
    count = sum(sizes)
    low, high = np.full(count, -inf), np.full(count, inf)
    for name, size in zip(free, sizes, strict=True):
        own = slice(starts[name], starts[name] + size)
        low[own], high[own] = _natural(robot, name, size)
        for part, pair in _by_part(given.inputs.get(name, {})):
            place = _place(robot, free, name, part, own)
            for end in pair:
                if end.ndim and len(end) != place.stop - place.start:
                    refuse(f"Limits.{name}", end.tolist(), f"must be a number or {place.stop - place.start} of them")
            low[place], high[place] = np.maximum(low[place], pair[0]), np.minimum(high[place], pair[1])
    labels, own_columns = labels_of(robot, free, sizes), columns(free, sizes)
    kept = (np.isfinite(low) | np.isfinite(high)) & np.isin(np.arange(count), own_columns)
    rows = [np.eye(count)[kept]]
    lows, highs = [low[kept]], [high[kept]]
    names = [label for label, own in zip(labels, kept, strict=True) if own]
    if "translation" in starts:
        for row, least, most, name in _order(robot, given.gap, starts["translation"], labels):
            chosen = np.count_nonzero(row[own_columns])
            if chosen == 1:
                kept_in = f"must be of all tubes in each other, whose bases keep their order ({name} >= {least:g} m)"
                way = "to leave one where it is, give it no room in Limits(translation=...)"
                refuse("free['translation']", getattr(free, "parts", {})["translation"], f"{kept_in}: {way}")
            if not chosen:
                continue
            rows.append(row[None])
            lows.append(np.array([least]))
            highs.append(np.array([most]))
            names.append(name)
    elif given.gap is not None:
        refuse("Limits.gap", given.gap, "must not be given: translation is not free")
    matrix = np.concatenate(rows)[:, own_columns]
    result = LimitRows(matrix, np.concatenate(lows), np.concatenate(highs), tuple(names))
    for k in np.flatnonzero(result.low > result.high):
        refuse(f"Limits ({result.names[k]})", (float(result.low[k]), float(result.high[k])), "must leave something: low <= high")
    return result


def _place(robot: Assembly, free: Sequence[str], name: str, part: str, own: slice) -> slice:
    """Where among all numbers those of an input are that a limit is of: ``own``, or of it those of what is named."""
    if not part:
        return own
    known = parts_of(robot, name)
    named(f"Limits.{name}", part, known, getattr(free, "parts", {}).get(name))
    return slice(own.start + known[part].start, own.start + known[part].stop)


def _backbones(robot: Assembly) -> Iterator[tuple[int, Assembly]]:
    """Each backbone of a robot, and its first rod."""
    if isinstance(robot, ParallelRods):
        yield from zip(robot.geometry.first_rod.tolist(), robot.geometry.legs, strict=False)
    elif isinstance(robot, Network):
        yield from zip(robot.graph.first_tube.tolist(), robot.graph.whole, strict=False)
    else:
        yield 0, robot


def _natural(robot: Assembly, name: str, size: int) -> tuple[FloatArray, FloatArray]:
    """What a robot takes of an input."""
    low, high = np.full(size, -inf), np.full(size, inf)
    if name == "tension":
        low[:] = 0.0
    if name == "translation":
        for first, own in _backbones(robot):
            straight = bool(getattr(own, "transmission", False))
            for k, rod in enumerate(own.rods):
                held = [line.reach_straight if straight else line.reach for line in rod.lines]
                low[first + k] = -min([(1 - SHORTEST) * float(np.min(rod.length)), *held])
                high[first + k] = 0.0 if straight else inf
    return low, high


def _order(
    robot: Assembly, gap: float | None, start: int, labels: Sequence[str]
) -> Iterator[tuple[FloatArray, float, float, str]]:
    """(11) Rows that keep tubes in order: how far each base is behind that of the tube around it."""
    ordered = False
    for first, own in _backbones(robot):
        if not isinstance(own, ConcentricTubes):
            continue
        ordered = True
        for k, (inner, outer) in enumerate(zip(own.rods[:-1], own.rods[1:], strict=True)):
            row, at = np.zeros(len(labels)), start + first + k
            row[at], row[at + 1] = -1.0, 1.0
            most = inf if gap is None else float(np.min(inner.length - outer.length)) - gap
            yield row, gap or 0.0, most, f"{labels[at + 1]} - {labels[at]}"
    if gap is not None and not ordered:
        refuse("Limits.gap", gap, "must not be given: the robot has no concentric tubes")


def refuse_start(field: str, rows: LimitRows, values: FloatArray, robot: Assembly, free: Sequence[str]) -> None:
    """Refuse a start ``p`` (b, k) that is beyond a limit."""
    matrix, ends = rows.both_ways
    if (values.dot(matrix) <= ends).all():
        return
    beyond = rows.outside(values, input_units(robot, free))
    wrong = np.argwhere(beyond > ROUNDING_BEYOND)
    if len(wrong):
        instance, row = wrong[0]
        at = float(values[instance] @ rows.matrix[row])
        allowed = f"{rows.names[row]} must be from {rows.low[row]:g} to {rows.high[row]:g} at the start too"
        refuse(f"{field} (instance {instance})" if len(values) > 1 else field, at, allowed)


def nearest(rows: LimitRows, values: FloatArray, unit: FloatArray) -> FloatArray:
    """The points within all limits that are nearest to ``p`` (..., k) in units (9), of that shape.

    By Dykstra's alternating projections onto (10), by so much within them that rounding leads beyond none. Where there is no
    such point, it is beyond some.
    """
    G, x = rows.matrix * unit, np.atleast_2d(values / unit)
    square = (G**2).sum(axis=1)
    inset = np.minimum(ROUNDING_BEYOND * np.abs(G).sum(axis=1), 0.25 * (rows.high - rows.low))
    low, high = rows.low + inset, rows.high - inset
    shift = np.zeros((len(G), *x.shape))
    for _ in range(PROJECTIONS):
        before = x
        for k, row in enumerate(G):
            back = x + shift[k]
            at = back @ row
            x = back - ((at - np.clip(at, low[k], high[k])) / square[k])[:, None] * row
            shift[k] = back - x
        if np.abs(x - before).max(initial=0.0) <= ROUNDING and not rows.outside(unit * x, unit).any():
            break
    return np.asarray(unit * x).reshape(values.shape)


def middle(rows: LimitRows) -> FloatArray:
    """(12) The point in the middle of all ranges, in the sense of least squares, (k,); NaN the numbers that have no range."""
    centred = np.isfinite(rows.low) & np.isfinite(rows.high)
    matrix, low, high = rows.matrix[centred], rows.low[centred], rows.high[centred]
    if not len(matrix):
        return np.full(rows.matrix.shape[1], np.nan)
    size = np.maximum(0.5 * (high - low), 1e-12)
    result = np.asarray(np.linalg.lstsq(matrix / size[:, None], 0.5 * (low + high) / size)[0])
    along = np.linalg.svd(matrix)[2][np.linalg.matrix_rank(matrix) :]  # what has no range
    result[(np.abs(along) > ROUNDING_BEYOND).any(axis=0)] = np.nan
    return result
