"""What notebooks show of rods, robots, inputs and results: small tables in plain HTML."""

from collections.abc import Iterable, Sequence
from html import escape
from math import prod
from typing import TYPE_CHECKING, cast

import numpy as np

from multirod.status import Status, Statuses, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.assembly import Assembly
    from multirod.inputs import Inputs, InputSpecs
    from multirod.results.history import History
    from multirod.results.solution import Solution
    from multirod.rod import Rod
    from multirod.studies.critical_loads import CriticalLoad
    from multirod.studies.equilibria import Equilibria
    from multirod.studies.terms import Explanation
    from multirod.studies.tradeoffs import Tradeoff

ROWS = 8  # of a batch or a history that are shown, evenly chosen
SECTIONS = 8
EVENTS = 8
LONGEST_TRADEOFF = 30  # rows
MOST_EQUILIBRIA = 20
_LEFT = "text-align:left"
_RIGHT = "text-align:right"

Cells = Sequence[object]


def table(title: str, header: Cells, rows: Iterable[Cells], notes: Iterable[str] = ()) -> str:
    """A table; numbers stand to the right, all text is escaped."""
    body = "".join(f"<tr>{''.join(_cell(cell) for cell in row)}</tr>" for row in rows)
    head = "".join(f'<th style="{_LEFT}">{escape(str(cell))}</th>' for cell in header)
    head = f"<thead><tr>{head}</tr></thead>" if header else ""
    caption = f'<div style="margin-bottom:0.3em"><b>{escape(title)}</b></div>' if title else ""
    said = "".join(f"<div><small>{escape(note)}</small></div>" for note in notes)
    return f"<div>{caption}<table>{head}<tbody>{body}</tbody></table>{said}</div>"


def _cell(value: object) -> str:
    if isinstance(value, str):
        return f'<td style="{_LEFT}">{escape(value)}</td>'
    return f'<td style="{_RIGHT}">{escape(_number(value))}</td>'


def _number(value: object) -> str:
    """Four digits; nothing where there is no number."""
    if value is None or (isinstance(value, (float, np.floating)) and np.isnan(value)):
        return "–"
    return f"{value:,}" if isinstance(value, (int, np.integer)) else f"{float(cast(float, value)):.4g}"


def _vector(values: FloatArray) -> str:
    return ", ".join(_number(float(value)) for value in np.ravel(values))


def _range(values: object, tail: int = 0) -> str:
    """One number or vector, or the range of those of a batch."""
    given = np.asarray(values, dtype=np.float64)
    if given.ndim <= tail:
        same = tail and given.size > 1 and (given == given.ravel()[0]).all()
        return _number(float(given.ravel()[0])) if same or given.size == 1 else f"({_vector(given)})"
    low, high = given.min(axis=tuple(range(given.ndim - tail))), given.max(axis=tuple(range(given.ndim - tail)))
    if (low == high).all():
        return _range(low, tail)
    return f"{_range(low, tail)} to {_range(high, tail)}"


def rod(own: "Rod") -> str:
    """A row for each section."""
    header = ["length [m]", "EI [N m²]", "GJ [N m²]", "u* [1/m]"]
    optional = {
        "GA [N]": ("shear_stiffness", 1, np.inf),
        "EA [N]": ("axial_stiffness", 0, np.inf),
        "mass [kg/m]": ("linear_density", 0, 0.0),
        "magnetisation [A m]": ("magnetisation", 1, 0.0),
        "foundation [N/m²]": ("foundation", 1, 0.0),
    }
    given = {
        label: (name, tail)
        for label, (name, tail, usual) in optional.items()
        if any((np.asarray(getattr(section, name)) != usual).any() for section in own.sections)
    }
    rows = []
    for section in own.sections[:SECTIONS]:
        curved = section.precurvature
        row = [
            _range(section.length),
            _range(section.bending_stiffness, 1),
            _range(section.torsional_stiffness),
            "a function of arclength" if callable(curved) else _range(curved, 1),
        ]
        rows.append(row + [_range(getattr(section, name), tail) for name, tail in given.values()])
    notes = []
    if len(own.sections) > SECTIONS:
        notes.append(f"the first {SECTIONS} of {len(own.sections)} sections")
    if own.outer_diameter is not None:
        hollow = np.multiply(1e3, 0.0 if own.inner_diameter is None else own.inner_diameter)
        inner = f", inner {_range(hollow)} mm" if np.any(hollow) else ""
        notes.append(f"outer diameter {_range(np.multiply(1e3, own.outer_diameter))} mm{inner}")
    notes += [f"line: {line!r}" for line in own.lines] + [f"carries {type(member).__name__}" for member in own.members]
    notes += [f"under {type(load).__name__}" for load in own.loads]
    if own.discs is not None:
        notes.append(f"discs every {1e3 * own.discs:g} mm")
    name = f"Rod {own.name!r}" if own.name else "Rod"
    batch = f", batch {own.batch_shape}" if own.batch_shape else ""
    return table(f"{name}, length {_range(own.length)} m{batch}", [*header, *given], rows, notes)


def robot(assembly: "Assembly") -> str:
    """A row for each rod, and the inputs that it takes."""
    from multirod.models.assemblies.network import Network
    from multirod.recording.figure import bodies_in_words, drawn_rods, joined_to

    rows: list[Cells] = []
    for drawn, own in zip(drawn_rods(assembly), assembly.rods, strict=True):
        diameter = None if own.outer_diameter is None else _range(np.multiply(1e3, own.outer_diameter))
        first = own.sections[0]
        stiffness = _range(first.bending_stiffness, 1), _range(first.torsional_stiffness)
        count = len(own.sections)
        rows.append([drawn.name, _range(own.length), diameter, *stiffness, count, len(own.lines)])
    header = ["rod", "length [m]", "diameter [mm]", "EI [N m²]", "GJ [N m²]", "sections", "lines"]
    if isinstance(assembly, Network):
        header += ["base on", "tip on"]
        rows = [[*row, *held] for row, held in zip(rows, joined_to(assembly), strict=True)]
    batch = f", batch {assembly.batch_shape}" if assembly.batch_shape else ""
    takes = ", ".join(f"{spec.name} [{spec.unit}]" for spec in assembly.input_specs)
    notes = [f"takes {takes}"]
    if any(len(own.sections) > 1 for own in assembly.rods):
        notes.insert(0, "stiffnesses are those of the first section")
    if isinstance(assembly, Network):
        said = f"bodies: {bodies_in_words(assembly)}; " if assembly.bodies else ""
        notes.insert(0, f"{said}end effector: {assembly.effector_name}")
    count = assembly.rod_count
    return table(f"{type(assembly).__name__} of {count} rod{'s' * (count > 1)}{batch}", header, rows, notes)


def input_specs(specs: "InputSpecs") -> str:
    """A row for each."""
    notes = ["* or a function of the arclength"] * any(spec.function for spec in specs)
    return table("Inputs", ["input", "unit", "shape", "what"], specs.rows(), notes)


def inputs(given: "Inputs") -> str:
    """A row for each that was given."""
    rows = []
    for name in given.given:
        spec = given._specs[name]
        profile = given.profile(name)
        value = "a function of arclength" if profile is not None else _range(getattr(given, name), 1)
        rows.append([name, value, spec.unit.replace("^2", "²"), spec.description])
    batch = f", batch {given.batch_shape}" if given.batch_shape else ""
    notes = ["all others are zero"] if rows else ["all are zero"]
    return table(f"Inputs{batch}", ["input", "value", "unit", "what"] if rows else [], rows, notes)


def solution(found: "Solution") -> str:
    """What a single one came to; of a batch how many ended how, the spread, and some of it. Nothing is computed for it."""
    title = f"{type(found).__name__} of {type(found.assembly).__name__}"
    if not found.batch_shape:
        return _single(found, title)
    index = [np.unravel_index(k, found.batch_shape) for k in _some(prod(found.batch_shape))]
    labels = [", ".join(str(int(i)) for i in place) for place in index]
    rows = [[label, *_row(found, place)] for label, place in zip(labels, index, strict=True)]
    return table(f"{title}, batch {found.batch_shape}", ["instance", *_HEADER], rows, _summary(found, len(rows), "instances"))


def history(found: "History") -> str:
    """The same over time."""
    count, *axes = found.batch_shape
    title = f"History of {type(found.assembly).__name__}, {count:,} samples"
    if count:
        title += f", {found.time[0]:g} to {found.time[-1]:g} s"
    if axes:
        title += f", batch {tuple(axes)}"
    first = (0,) * len(axes)
    chosen = _some(count) if all(axes) else []
    rows = [[float(found.time[k]), *_row(found, (k, *first))] for k in chosen]
    notes = _summary(found, len(rows), "samples")
    if axes and rows:
        notes.append(f"rows are of instance {', '.join(map(str, first))}")
    measured = found.step_time[np.isfinite(found.step_time)]
    if len(measured):
        slow = np.percentile(measured, 95)
        notes.append(f"a sample took {1e6 * np.median(measured):.0f} µs in the median, 95 % within {1e6 * slow:.0f} µs")
    if found.description:
        notes.append(found.description)
    return table(title, ["time [s]", *_HEADER], rows, notes)


_HEADER = ("status", "tip x [m]", "tip y [m]", "tip z [m]", "residual [1/m]", "iterations")


def _row(found: "Solution", place: tuple[int | np.intp, ...]) -> Cells:
    status = Status(int(np.asarray(found.status)[place]))
    values = [*found.tip_position[place], np.asarray(found.residual)[place], np.asarray(found.iterations)[place]]
    return [status.name, *values]


def _single(found: "Solution", title: str) -> str:
    status = Status(int(np.asarray(found.status)))
    rows: list[Cells] = [["status", status.name]]
    if not status.failed:
        rows += [
            ["tip position [m]", _vector(found.tip_position)],
            ["tip axis z", _vector(found.tip_rotation[:, 2])],
            ["condition", _number(float(found.condition))],
        ]
    rows += [
        *([name, value] for name, value in found._asides.items()),
        ["residual [1/m]", _number(float(found.residual))],
        ["iterations, integrations", f"{int(found.iterations)}, {int(found.integrations)}"],
    ]
    notes = [status.message] if status is not Status.CONVERGED else []
    return table(title, [], rows, [*notes, *(event.said for event in found.events), *_dropped(found)])


def _dropped(found: "Solution") -> list[str]:
    return [f"left out: {', '.join(map(str, found.dropped))}"] if found.dropped else []


def _some(count: int) -> list[int]:
    return np.unique(np.round(np.linspace(0, count - 1, min(count, ROWS))).astype(int)).tolist() if count else []


def _summary(found: "Solution", shown: int, noun: str) -> list[str]:
    """How many ended how, and the largest residual of those that have a result."""
    status = np.asarray(found.status, dtype=np.int64).reshape(-1)
    notes = [", ".join(f"{count:,} {code}" for code, count in Statuses.of(status).counts().items()) or "empty"]
    sound = ~failures(status)
    residual: FloatArray = np.asarray(found.residual, dtype=np.float64).reshape(-1)[sound]
    if len(residual):
        notes.append(f"residual {np.median(residual):.2g} 1/m in the median, {residual.max():.2g} at most")
    total = found.batch_shape[0] if noun == "samples" else len(status)
    if shown < total:
        notes.append(f"{shown} of {total:,} {noun} are shown")
    return notes + _events(found) + _dropped(found)


def _events(found: "Solution") -> list[str]:
    """The first of what happened on the way."""
    events = found._outcome.events
    every = [event.said for place in sorted(events) for event in events[place]]
    more = [f"and {len(every) - EVENTS} more events"] if len(every) > EVENTS else []
    return every[:EVENTS] + more


def equilibria(found: "Equilibria") -> str:
    """A row for each, the one of lowest potential energy first."""
    from multirod.stability import Stability

    header = ["", "stability", "unstable modes", "potential [J]", "tip x [m]", "tip y [m]", "tip z [m]", "condition"]
    rows: list[Cells] = []
    potential = found.potential
    total = found.batch_shape[0]
    for k in range(min(total, MOST_EQUILIBRIA)):
        index = int(found.index[k])
        stability = Stability(int(found.stability[k])).name + ", a whole circle" * bool(found.continuum[k])
        row = [k, stability, index if index >= 0 else None, potential[k]]
        rows.append([*row, *found.tip_position[k], found.condition[k]])
    missing = {None: "whether others are missing is not known", 0: "none is known to be missing"}
    count = found.missing
    note = missing.get(count, f"{count} missing at least, by what is unstable of those found")
    notes = [note] if len(rows) == total else [f"the first {len(rows)} of {total:,} are shown", note]
    return table(f"Equilibria of {type(found.assembly).__name__}: {total:,} found", header, rows, notes)


def critical_loads(found: "Sequence[CriticalLoad]", notes: Iterable[str] = ()) -> str:
    """A row for each, in the order of the branch."""
    header = ["load factor", "kind", "unstable modes before", "after", "tip x [m]", "tip y [m]", "tip z [m]"]
    rows = [
        [
            one.load_factor,
            "fold: it snaps" if one.fold else "bifurcation: it buckles",
            one.index_before,
            one.index_after,
            *one.solution.tip_position,
        ]
        for one in found
    ]
    return table(f"Critical loads: {len(rows) or 'none'} found", header if rows else [], rows, notes)


def explanation(found: "Explanation") -> str:
    """A row for each term."""
    head, columns, rows, note = found.as_table()
    return table(head, columns, rows, [note])


def tradeoff(found: "Tradeoff") -> str:
    """A row for each setting, the fastest first; those that no other beats in both are marked."""
    front = {row.name for row in found.pareto()}
    header = ["", "setting", "tip [m]", "shape [m]", "median [µs]", "95 % [µs]", "integrations", "failed"]
    every = sorted(found.rows, key=lambda row: row.median)
    shown = every if len(every) <= LONGEST_TRADEOFF else [row for row in every if row.name in front]
    rows = [
        [
            "*" if row.name in front else "",
            row.name,
            row.position,
            row.shape,
            1e6 * row.median,
            1e6 * row.slow,
            row.integrations,
            row.failed,
        ]
        for row in shown
    ]
    notes = ["* no other setting is both faster and more accurate", *found.notes()]
    if len(shown) < len(every):
        notes.insert(1, f"only these {len(shown)} of {len(every)} settings are shown: print it for all")
    return table(f"Tradeoff: {len(every)} settings", header, rows, notes)
