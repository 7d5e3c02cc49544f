"""Which instances of a batch are drawn, and in which colours."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.plotting.canvas import matplotlib
from multirod.results.quantities import SCALARS
from multirod.results.solution import Solution
from multirod.status import Status, failures
from multirod.validation import Described, FloatArray, array, instance, positive_int, refuse

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap, Normalize

COLORMAP = "viridis"
UNKNOWN = "0.65"  # the colour of what has no value
DARKEST_TO_LIGHTEST = (0.0, 0.9)  # of the colour map: its end is lost on white


@dataclass(frozen=True)
class Family:
    """Instances to be drawn together.

    Attributes:
        solution: Of those that are drawn, shape (k,); itself where there is no batch axis.
        values: What they are coloured by, shape (k,).
        label: Of that.
        single: Whether there is no batch axis, and colours tell rods or components apart.
        title: What has been left out, in words; empty where nothing has.
    """

    solution: Solution
    values: FloatArray
    label: str
    single: bool
    title: str

    def __len__(self) -> int:
        return len(self.values)

    @property
    def norm(self) -> "Normalize":
        """From values to the part of the colour map that is used."""
        known = self.values[np.isfinite(self.values)]
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
        norm: Normalize = matplotlib("colors").Normalize(low, high if high > low else low + 1.0)
        return norm

    @property
    def colormap(self) -> "Colormap":
        """Colours of the family."""
        shades = matplotlib("pyplot").get_cmap(COLORMAP)(np.linspace(*DARKEST_TO_LIGHTEST, 256))
        colormap: Colormap = matplotlib("colors").ListedColormap(shades, name="multirod").with_extremes(bad=UNKNOWN)
        return colormap

    def colors(self) -> FloatArray:
        """One an instance."""
        return np.asarray(self.colormap(self.norm(self.values)))

    def colorbar(self, axes: "Axes | list[Axes]") -> None:
        """Beside one axes, or a list of them."""
        if self.single or len(self) < 2:
            return
        mappable = matplotlib("cm").ScalarMappable(norm=self.norm, cmap=self.colormap)
        some = axes if isinstance(axes, list) else [axes]
        bar = some[0].figure.colorbar(
            mappable, ax=some, label=self.label, shrink=0.75, pad=0.08 if some[0].name == "3d" else 0.02
        )
        if (self.values == np.round(self.values)).all():
            bar.ax.yaxis.set_major_locator(matplotlib("ticker").MaxNLocator(integer=True))


def family_of(
    solution: Solution, instances: int, colour_by: object = None, colour_label: str = "", noun: str = "instances"
) -> Family:
    """At most so many instances with a result, evenly chosen.

    Raises:
        ValueError: If ``colour_by`` is neither a name of a scalar nor of the batch's shape, or ``instances`` is not positive.
    """
    most = positive_int("instances", instances)
    instance("colour_label", colour_label, str, "a string")
    status = np.asarray(solution.status, dtype=np.int64).reshape(-1)
    failed = failures(status)
    if not solution.batch_shape:
        if colour_by is not None:
            refuse("colour_by", colour_by, "must be None: there is no batch axis")
        title = f"no result: {Status(int(status[0]))}" if failed[0] else ""
        return Family(solution, np.zeros(0 if failed[0] else 1), "", True, title)
    sound = np.flatnonzero(~failed)
    chosen = sound if len(sound) <= most else sound[np.round(np.linspace(0, len(sound) - 1, most)).astype(int)]
    drawn = solution[np.unravel_index(chosen, solution.batch_shape)]
    title = _left_out(status, chosen, failed, noun)
    if isinstance(colour_by, str):
        values, label = _named(drawn, colour_by), SCALARS[colour_by]
    else:
        values = numbers(colour_by, solution.batch_shape)[chosen]
        label = "instance" if colour_by is None else ""
    return Family(drawn, values, colour_label or label, False, title)


def numbers(colour_by: object, shape: tuple[int, ...]) -> FloatArray:
    """A number of each instance of a batch, shape (k,): their own where none are given."""
    if colour_by is None:
        return np.arange(math.prod(shape), dtype=np.float64)
    given = array("colour_by", colour_by, finite=False)
    try:
        return np.array(np.broadcast_to(given, shape), dtype=np.float64).reshape(-1)
    except ValueError:
        refuse("colour_by", Described(f"array of shape {given.shape}"), f"must have the batch's shape, {shape}")


def _named(solution: Solution, name: str) -> FloatArray:
    """The same by the name of a property, which is computed of what is drawn only."""
    if name not in SCALARS:
        refuse("colour_by", name, f"must be an array of the batch's shape, or one of {', '.join(map(repr, SCALARS))}")
    return np.array(getattr(solution, name), dtype=np.float64).reshape(-1)


def _left_out(status: IntArray, chosen: IntArray, failed: NDArray[np.bool_], noun: str) -> str:
    words = []
    if len(chosen) < (~failed).sum():
        words.append(f"{len(chosen)} of {len(status):,} {noun}")
    if failed.any():
        codes, counts = np.unique(status[failed], return_counts=True)
        each = [f"{count:,} {Status(int(code))}" for code, count in zip(codes, counts, strict=True)]
        why = ", ".join(each) if len(each) > 1 else str(Status(int(codes[0])))
        words.append(f"{failed.sum():,} of {len(status):,} without a result: {why}")
    return "; ".join(words)
