"""Plots along the arclength, whose scales grow with what is drawn."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.recording import columns
from multirod.recording.columns import rgba
from multirod.recording.framing import round_up
from multirod.recording.layout import PLOT_HEIGHT, PLOT_WIDTH
from multirod.recording.profiles import Profile, Shapes, breaks, stepped
from multirod.recording.stage import Stage
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.recording.columns import Index, Send

Curves = dict[str, list[tuple[FloatArray, FloatArray]]]
_LABEL_COLOR = 0xDEE2E6


class AlongPlots:
    """Writes them, a sample a row.

    Args:
        stage: What is recorded.
        send: Sends columns to an entity.
    """

    def __init__(self, stage: Stage, send: "Send") -> None:
        self._stage, self._send = stage, send
        self._limits: dict[str, tuple[float, float]] = {}

    def curves(self, shapes: Sequence[Shapes]) -> Curves:
        """Arclengths, axes (sample, instance, node), and values (sample, instance, node, component), of each profile and rod."""
        found: Curves = {profile.name: [] for profile in self._stage.profiles}
        for index, (rod, shape) in enumerate(zip(self._stage.assembly.rods, shapes, strict=True)):
            places = self._places(index, shapes)
            s = shape["arclength"]
            for profile in self._stage.profiles:
                values = profile.values(shape, rod, self._stage.by_component)
                if places is None:
                    found[profile.name].append((s, values))
                else:
                    flat = values.reshape(-1, *values.shape[-2:])
                    every, heights = stepped(s.reshape(-1, s.shape[-1]), flat, places)
                    found[profile.name].append(
                        (every.reshape(*s.shape[:2], -1), heights.reshape(*s.shape[:2], -1, values.shape[-1]))
                    )
        return found

    def _places(self, index: int, shapes: Sequence[Shapes]) -> FloatArray | None:
        """Where the rod or another tube of its leg changes, axes (row, place); None where there is no such place."""
        places = []
        for rod, drawn, shape in zip(self._stage.assembly.rods, self._stage.rods, shapes, strict=True):
            if drawn.leg == self._stage.rods[index].leg:
                places.append(shape["arclength"][..., -1:] - float(np.max(rod.length)) + breaks(rod))
        every = np.concatenate(places, axis=-1) if places else np.zeros((1, 0))
        return every.reshape(-1, every.shape[-1]) if every.shape[-1] > 1 else None

    def write_limits(self, curves: Curves, steps: NDArray[np.int64], times: FloatArray) -> None:
        """Choose the scales, anew where values outgrow them; the tick labels are data, so each row has its own."""
        for profile in self._stage.profiles:
            reach = max(_largest(s) for s, _ in curves[profile.name])
            largest = max(_largest(values) for _, values in curves[profile.name])
            length, top = self._limits.get(profile.name, (0.0, 0.0))
            if profile.name in self._limits and largest <= top and reach <= length:
                continue
            live = self._stage.live
            if largest > top:
                top = round_up((1.5 if live else 1.05) * largest)
            if reach > length:
                length = round_up((1.1 if live else 1.0) * reach)
            self._limits[profile.name] = length, top
            self._write_labels(profile, length or 1.0, top or 1.0, columns.index(steps[:1], times[:1]))

    def _write_labels(self, profile: Profile, length: float, top: float, index: "Index") -> None:
        import rerun as rr

        w, h = PLOT_WIDTH, 0.5 * PLOT_HEIGHT
        left = -0.05 * w
        ticks = (top, 0.5 * top, 0.0) if self._positive(profile) else (top, 0.0, -top)
        below = 1.05 * h  # labels hang from their places
        positions = [(left, -1.25 * h), (left, -0.25 * h), (left, 0.75 * h), (0.0, below), (0.5 * w, below), (w, below)]
        labels = [f"{value:.4g}" for value in (*ticks, 0.0, 500 * length)] + [f"{1e3 * length:.4g} mm"]
        colors = np.full(len(labels), rgba(_LABEL_COLOR), dtype=np.uint32)
        points = rr.Points2D.columns(positions=positions, labels=labels, colors=colors, radii=[0.0] * len(labels))
        self._send(f"/{profile.name}/axes/labels", index, points.partition([len(labels)]))

    def _positive(self, profile: Profile) -> bool:
        return profile.positive or not self._stage.by_component

    def write(self, curves: Curves, k: int, rod: int, index: "Index", rows: slice) -> None:
        """Send some rows of all profiles of a rod of an instance."""
        for profile in self._stage.profiles:
            s, every = curves[profile.name][rod]
            length, top = self._limits[profile.name]
            values = every[rows, k] / (top or 1.0)
            x = PLOT_WIDTH / (length or 1.0) * s[rows, k]
            y = PLOT_HEIGHT * (0.5 - values if self._positive(profile) else -0.5 * values)  # 2D views point down
            strips = np.stack([np.broadcast_to(x[..., None], y.shape), y], axis=-1)
            self._send(self._stage.profile(profile.name, k, rod), index, columns.strips(np.moveaxis(strips, 2, 1)))


def _largest(values: FloatArray) -> float:
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if known.size else 0.0
