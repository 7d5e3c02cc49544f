"""What is drawn along the arclength: curvature, moment, force, strain, and the distance from a reference."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from multirod.rod import Rod
from multirod.validation import FloatArray

Shapes = dict[str, FloatArray]


@dataclass(frozen=True)
class Profile:
    """A quantity along rods.

    Attributes:
        name: Its entity, and its tab.
        unit: Of its axis.
        letter: Of its components, where there are three.
        values: From the shape of a rod (fields with axes (sample, instance, node, ...)), the rod, and whether its components are
            drawn: axes (sample, instance, node, component).
        positive: Whether it has no sign, or is drawn by its magnitude.
    """

    name: str
    unit: str
    letter: str
    values: Callable[[Shapes, Rod, bool], FloatArray]
    positive: bool = False


def profiles(rods: Sequence[Rod], *, compared: bool) -> tuple[Profile, ...]:
    """The quantities that a recording shows of these rods."""
    found = [
        Profile("curvature", "1/m", "u", _curvature),
        Profile("moment", "N m", "m", lambda shape, _, parts: _drawn(shape["moment"], parts)),
        Profile("force", "N", "n", lambda shape, _, parts: _drawn(shape["force"], parts)),
    ]
    if all(rod.outer_diameter is not None for rod in rods):
        found.append(Profile("strain", "%", "", lambda shape, _rod, _parts: shape["strain"], positive=True))
    if compared:
        found.append(Profile("difference", "mm", "", lambda shape, _rod, _parts: shape["difference"], positive=True))
    return tuple(found)


def ends(rod: Rod) -> FloatArray | None:
    """Arclengths from its base at which a rod changes [m]; None where they differ from instance to instance."""
    lengths = [np.asarray(section.length) for section in rod.sections]
    return None if any(length.ndim for length in lengths) else np.cumsum([float(length) for length in lengths])


def breaks(rod: Rod) -> FloatArray:
    """Arclengths from its base at which its curvature may jump [m]: where a section or a line ends."""
    sections = ends(rod)
    if sections is None:
        return np.zeros(0)
    lines = [place for line in rod.lines if not line.batch_shape for place in line.cuts]
    return np.unique(np.concatenate([sections, lines]))


def stepped(arclength: FloatArray, values: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two nodes more at each place where values jump, so that a line through all of them is vertical there.

    What is on either side is continued as a straight line, or as it is where another place is near: also to a node on such a
    place, whose own value is of one side or the other, by rounding. It gets the one before.

    Args:
        arclength: Evenly spaced, axes (row, node).
        values: Axes (row, node, component).
        places: Axes (row, place), in any order; those that are not within the rod add nothing to see.
    """
    count = arclength.shape[1]
    start, end = arclength[:, :1], arclength[:, -1:]
    step = (end - start) / (count - 1)
    with np.errstate(invalid="ignore"):
        nearest = start + np.rint((places - start) / step) * step
        places = np.where(np.abs(places - nearest) < 1e-6 * step, nearest, places)
        arclength = start + np.arange(count) * step  # places on nodes are them, to the last digit
        within = (places > start + 1e-9 * step) & (places < end - 1e-9 * step)
        at = np.nan_to_num((places - start) / step)
    last, after = (np.clip(nodes.astype(int), 0, count - 1) for nodes in (np.ceil(at - 1e-6) - 1, np.floor(at + 1e-6) + 1))
    added, heights = [arclength], [np.array(values)]
    for first, second in ((last, last - 1), (after, after + 1)):
        second = np.clip(second, 0, count - 1)
        near, far = (np.take_along_axis(arclength, nodes, axis=1) for nodes in (first, second))
        low, high = np.minimum(near, far), np.maximum(near, far)
        between = (places[:, None, :] > low[..., None] + 1e-6 * step[..., None]) & (
            places[:, None, :] < high[..., None] - 1e-6 * step[..., None]
        )
        near_value, far_value = (np.take_along_axis(values, nodes[..., None], axis=1) for nodes in (first, second))
        straight = within & ~between.any(axis=2) & (near != far)
        slope = np.divide((near_value - far_value), (near - far)[..., None], where=straight[..., None], out=0 * near_value)
        height = near_value + slope * (places - near)[..., None]
        added.append(np.where(within, places, end))
        heights.append(np.where(within[..., None], height, values[:, -1:]))
    row, place = np.nonzero(within & (after - last == 2))
    heights[0][row, last[row, place] + 1] = heights[1][row, place]
    every, every_height = np.concatenate(added, axis=1), np.concatenate(heights, axis=1)
    side = np.repeat([0, 1, 2], [count, places.shape[1], places.shape[1]])
    order = np.lexsort((np.broadcast_to(side, every.shape), every), axis=1)
    return np.take_along_axis(every, order, axis=1), np.take_along_axis(every_height, order[..., None], axis=1)


def _curvature(shape: Shapes, rod: Rod, parts: bool) -> FloatArray:
    return shape["curvature"] if parts else np.linalg.norm(shape["curvature"][..., :2], axis=-1, keepdims=True)


def _drawn(values: FloatArray, parts: bool) -> FloatArray:
    return values if parts else np.linalg.norm(values, axis=-1, keepdims=True)
