"""Curves of a history over time."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from multirod.inputs import InputSpec
from multirod.models.assemblies.network import Network
from multirod.plotting.canvas import COMPONENTS, FAILED, FEW, column_of_axes, legend, style_of, title
from multirod.plotting.family import Family, numbers
from multirod.recording.figure import drawn_lines, drawn_rods
from multirod.results.history import History
from multirod.status import Status, failures
from multirod.types import AxesGiven
from multirod.validation import FloatArray, refuse

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TIME = "time [s]"
SMALLEST = 1e-16  # on a logarithmic axis


@dataclass(frozen=True)
class Panel:
    """What one axes shows of a history.

    Attributes:
        label: Of the ordinate.
        values: Shape (sample, instance, component).
        names: Of the components, in the legend; empty where there is but one, and nothing to say of it.
        vector: Whether the components are x, y and z.
        log: Whether the ordinate is logarithmic.
    """

    label: str
    values: FloatArray
    names: tuple[str, ...] = ()
    vector: bool = False
    log: bool = False


def _split(history: History, values: object) -> FloatArray:
    """Values (time, ...[, k]) with axes (sample, instance, component)."""
    given = np.asarray(values, dtype=np.float64)
    tail = given.shape[len(history.batch_shape) :] or (1,)
    return given.reshape(len(history.time), -1, *tail)


def _scalar(name: str, label: str, *, log: bool = False) -> Callable[[History], list[Panel]]:
    return lambda history: [Panel(label, _split(history, getattr(history, name)), log=log)]


def _tip(history: History) -> list[Panel]:
    return [Panel("tip position [m]", _split(history, history.tip_position), ("x", "y", "z"), vector=True)]


def _unknowns(history: History) -> list[Panel]:
    names = tuple(f"x{k + 1}" for k in range(history.unknown_count))
    return [Panel("unknowns [1/m]", _split(history, history.unknowns), names)]


def _step_time(history: History) -> list[Panel]:
    """One a sample, whatever the batch."""
    return [Panel("time of a sample [ms]", 1e3 * np.asarray(history.step_time)[:, None, None], log=True)]


def _inputs(history: History) -> list[Panel]:
    """An axes for each input that was given as numbers."""
    inputs, panels = history.inputs, []
    names = [rod.name for rod in drawn_rods(history.assembly)]
    lines = [line.name for line in drawn_lines(history.assembly, drawn_rods(history.assembly))]
    for spec in history.assembly.input_specs:
        if spec.name not in inputs.given or spec.name in inputs.profiles:
            continue
        values = getattr(inputs, spec.name)
        every = _split(history, np.broadcast_to(values, (*history.batch_shape, values.shape[-1])))
        driven = [
            name
            for name, (_, line) in zip(lines, history.assembly.lines, strict=True)
            if line.drive is not None and line.drive[0] == spec.name
        ]
        own = names if spec.per_rod else driven if spec.count is not None else ["x", "y", "z"]
        vector = not spec.per_rod and spec.count is None
        if isinstance(history.assembly, Network):
            places = history.assembly.vectors_on(spec)
            if places:
                panels += _on_places(places, spec, every)
                continue
            own = list(history.assembly.coordinate_names.get(spec.name, own))
        panels.append(Panel(f"{spec.name}\n[{spec.unit}]", every, tuple(own) if len(own) > 1 else (), vector))
    if not panels:
        refuse("quantity", "inputs", "no input was given as numbers: there is nothing to plot")
    return panels


def _on_places(places: Sequence[str], spec: InputSpec, values: FloatArray) -> list[Panel]:
    """An axes for each body, tip or rod that a load acts on."""
    axes = ("x", "y", "z")
    own = {place: values[..., 3 * k : 3 * k + 3] for k, place in enumerate(places)}
    acting = {place: value for place, value in own.items() if value.any()} or own
    return [Panel(f"{spec.name} on {place}\n[{spec.unit}]", value, axes, vector=True) for place, value in acting.items()]


def _of_lines(name: str, label: str) -> Callable[[History], list[Panel]]:
    def panels(history: History) -> list[Panel]:
        if not history.assembly.lines:
            refuse("quantity", name, "no rod has lines")
        lines = drawn_lines(history.assembly, drawn_rods(history.assembly))
        return [Panel(label, _split(history, getattr(history, name)), tuple(line.name for line in lines))]

    return panels


QUANTITIES: dict[str, Callable[[History], list[Panel]]] = {
    "tip": _tip,
    "inputs": _inputs,
    "unknowns": _unknowns,
    "residual": _scalar("residual", "residual [1/m]", log=True),
    "condition": _scalar("condition", "condition number", log=True),
    "smallest_singular_value": _scalar("smallest_singular_value", "smallest singular value", log=True),
    "energy": _scalar("energy", "elastic energy [J]"),
    "stability_margin": _scalar("stability_margin", "stability margin"),
    "iterations": _scalar("iterations", "iterations"),
    "integrations": _scalar("integrations", "integrations"),
    "step_time": _step_time,
    "tension": _of_lines("tension", "tension [N]"),
    "line_length": _of_lines("line_length", "length of lines [m]"),
}


def draw(
    ax: AxesGiven | None, history: History, name: str, *, instances: int, colour_by: object, colour_label: str
) -> "list[Axes]":
    """Panels of a quantity, one above the other; of a batch, one for each component, coloured by instance."""
    panels = QUANTITIES[name](history)
    batched = len(history.batch_shape) > 1 and panels[0].values.shape[1:2] != (1,)
    if batched:
        panels = [part for panel in panels for part in _parts(panel)]
    every = column_of_axes(ax, [panel.label for panel in panels])
    chosen = _instances(history, instances, colour_by, colour_label) if batched else None
    for axes, panel in zip(every, panels, strict=True):
        _draw(axes, history, panel, chosen)
        axes.set_ylabel(panel.label)
        axes.grid(True, alpha=0.25)
    every[-1].set_xlabel(TIME)
    _mark_failures(every, history)
    for axes in every:
        legend(axes, above=len(axes.get_legend_handles_labels()[1]) > FEW)
    if chosen is not None:
        chosen[1].colorbar(every)
        count = math.prod(history.batch_shape[1:])
        title(every[0], f"{len(chosen[0])} of {count:,} instances" if len(chosen[0]) < count else "")
    return every


def _parts(panel: Panel) -> list[Panel]:
    """A panel for each component."""
    if len(panel.names) < 2:
        return [panel]
    title, _, unit = panel.label.rpartition("[")
    return [
        Panel(f"{title.strip()} {name} [{unit}", panel.values[..., k : k + 1], log=panel.log)
        for k, name in enumerate(panel.names)
    ]


def _instances(history: History, most: int, colour_by: object, colour_label: str) -> tuple[list[int], Family]:
    """Numbers of those that are drawn, evenly chosen, and their colours."""
    shape = history.batch_shape[1:]
    if isinstance(colour_by, str):
        refuse("colour_by", colour_by, f"must be an array of shape {shape}: over time, what has a name changes")
    values, count = numbers(colour_by, shape), math.prod(shape)
    chosen = np.unique(np.round(np.linspace(0, count - 1, min(most, count))).astype(int))
    label = "instance" if colour_by is None else ""
    return chosen.tolist(), Family(history[0], values[chosen], colour_label or label, False, "")


def _draw(axes: "Axes", history: History, panel: Panel, chosen: "tuple[list[int], Family] | None") -> None:
    if panel.log:
        axes.set_yscale("log")
    values = panel.values
    if panel.log:  # which has no place for zero
        values = np.where(values == 0, min(values[values > 0].min(initial=np.inf), SMALLEST), values)
    # a single sample between failed ones is no line
    alone: dict[str, Any] = {"marker": "." if len(history.time) < 40 else "", "ms": 4}
    if chosen is not None:
        for k, color in zip(chosen[0], chosen[1].colors(), strict=True):
            axes.plot(history.time, values[:, k, 0], color=color, lw=1.2, **alone)
        return
    for k in range(values.shape[2]):
        style = {"color": COMPONENTS[k], "linestyle": "-"} if panel.vector else style_of(k)
        label = panel.names[k] if panel.names else None
        width = 2.4 - 1.2 * k / max(values.shape[2] - 1, 1)  # what lies on another does not hide it
        axes.plot(history.time, values[:, 0, k], lw=width, label=label, **style, **alone)


def _mark_failures(every: "list[Axes]", history: History) -> None:
    """A cross on the time axis for each sample in which an instance has no result."""
    status = np.asarray(history.status, dtype=np.int64).reshape(len(history.time), -1)
    failed = failures(status)
    samples = np.flatnonzero(failed.any(axis=1))
    if not len(samples):
        return
    codes = ", ".join(str(Status(int(code))) for code in np.unique(status[failed]))
    label = f"no result in {len(samples):,} of {len(history.time):,} samples: {codes}"
    for k, axes in enumerate(every):
        place = axes.get_xaxis_transform()
        style: dict[str, Any] = {"color": FAILED, "ms": 6, "mew": 1.5, "clip_on": False, "zorder": 5}
        axes.plot(history.time[samples], np.zeros(len(samples)), "x", transform=place, label=None if k else label, **style)
