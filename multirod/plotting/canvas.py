"""Axes to draw on, and colours that a colour-blind reader can tell."""

from collections.abc import Sequence
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from multirod.recording.figure import DrawnRod
from multirod.types import AxesGiven, AxesOrArray
from multirod.validation import Described, refuse

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]

# after M. Okabe and K. Ito, without yellow, which is lost on white
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
COMPONENTS = ("#D55E00", "#009E73", "#0072B2")  # of x, y and z
STYLES = ("-", "--", "-.", ":")  # where colours begin anew
FAILED = "#B00020"
_PALEST = 0.5  # how much white is in the colour of a leg's innermost tube
WIDEST_IN_LEGEND = 4.0  # [pt]
FEW = 3  # curves whose legend finds room in the axes


def matplotlib(module: str = "pyplot") -> ModuleType:
    """A module of matplotlib, or the package itself.

    Raises:
        ImportError: If it is not there; the message says what to install.
    """
    try:
        return import_module(f"matplotlib.{module}" if module else "matplotlib")
    except ImportError:
        raise ImportError('plots need matplotlib: pip install "multirod[plot]"') from None


def in_space(module: str) -> ModuleType:
    """A module of matplotlib's that draws in three dimensions."""
    return import_module(f"mpl_toolkits.mplot3d.{module}")


def colors_of(drawn: Sequence[DrawnRod]) -> list[str]:
    """A colour for each rod, as matplotlib takes it; tubes of one leg share a hue, the innermost is the palest."""
    legs = list(dict.fromkeys(rod.path[0] for rod in drawn))
    found = []
    for rod in drawn:
        own = [other for other in drawn if other.path[0] == rod.path[0]]
        white = _PALEST * (len(own) - 1 - own.index(rod)) / max(len(own) - 1, 1)
        color = matplotlib("colors").to_rgb(PALETTE[legs.index(rod.path[0]) % len(PALETTE)])
        found.append(matplotlib("colors").to_hex([channel + white * (1 - channel) for channel in color]))
    return found


def axes_in_space(ax: AxesGiven | None) -> "Axes3D":
    """``ax``, or 3-D axes in a figure of their own."""
    if ax is None:
        # constrained layout does not know of labels in space
        return matplotlib().figure(figsize=(7.0, 6.0)).add_axes((0.08, 0.02, 0.9, 0.9), projection="3d")
    if getattr(ax, "name", "") != "3d":
        refuse("ax", ax, 'must be 3-D axes, as of plt.figure().add_subplot(projection="3d")')
    return ax


def column_of_axes(ax: AxesGiven | None, names: Sequence[str], height: float = 2.1) -> "list[Axes]":
    """``ax`` as a list of axes, one for each of ``names``, or new ones above each other that share the abscissa."""
    count = len(names)
    if ax is None:
        size = (7.0, 4.2 if count == 1 else height * count + 0.8)
        grid = matplotlib().figure(figsize=size, layout="constrained").subplots(count, 1, sharex=True, squeeze=False)
        return [row[0] for row in grid]
    given = list(np.ravel(np.asarray(ax, dtype=object)))
    if len(given) != count or not all(hasattr(one, "plot") and getattr(one, "name", "") != "3d" for one in given):
        wanted = "2-D axes" if count == 1 else f"{count} 2-D axes ({', '.join(names)}), as of plt.subplots({count})[1]"
        refuse("ax", ax if len(given) == 1 else Described(f"{len(given)} axes"), f"must be {wanted}")
    return given


def returned(axes: "Sequence[Axes]") -> AxesOrArray:
    """One axes, or an array of them, shape (k,)."""
    result: Any = axes[0]
    if len(axes) > 1:
        result = np.empty(len(axes), dtype=object)
        result[:] = axes
    found: AxesOrArray = result
    return found


def style_of(k: int) -> dict[str, Any]:
    """Colour and dashes of the k-th of several curves."""
    return {"color": PALETTE[k % len(PALETTE)], "linestyle": STYLES[k // len(PALETTE) % len(STYLES)]}


def legend(ax: "Axes", *, above: bool = False, **place: object) -> None:
    """A legend, if there is anything to say in it; above the axes, so that it hides nothing, or in them."""
    count = len(ax.get_legend_handles_labels()[1])
    if not count:
        return
    options: dict[str, Any] = {"fontsize": "small", "framealpha": 0.85, **place}
    if above:
        options |= {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "ncols": min(count, 6)}
    made = ax.legend(**options)
    for line in made.get_lines():
        line.set_linewidth(min(line.get_linewidth(), WIDEST_IN_LEGEND))


def title(ax: "Axes", text: str) -> None:
    """What has been left out; above a legend that is above the axes."""
    if text:
        own = ax.get_legend()
        above = own is not None and own.get_bbox_to_anchor().y0 >= ax.bbox.y1
        ax.set_title(text, fontsize="medium", pad=26 if above else 6)
