"""Curves along the arclength of rods."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from multirod.plotting.canvas import COMPONENTS, FEW, PALETTE, STYLES, colors_of, column_of_axes, legend
from multirod.plotting.family import Family
from multirod.problem import Shape
from multirod.recording.figure import drawn_lines, drawn_rods
from multirod.results.solution import Solution
from multirod.results.strains import strains
from multirod.types import AxesGiven
from multirod.validation import FloatArray, refuse

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Curves = dict[str, FloatArray]  # by the names of components, each of shape (..., node_count)
ARCLENGTH = "arclength s [m]"
SYMBOLS = {"curvature": ("u", "1/m"), "moment": ("m", "N m"), "force": ("n", "N")}
PERCENT = 100.0


def _components(name: str) -> Callable[[Solution, int, Shape], Curves]:
    symbol = SYMBOLS[name][0]

    def curves(solution: Solution, rod: int, shape: Shape) -> Curves:
        values = getattr(shape, name)
        return {f"{symbol}{k + 1}": values[..., k] for k in range(3)}

    return curves


def _strains(solution: Solution, rod: int, shape: Shape) -> Curves:
    return {name: PERCENT * values for name, values in strains(solution, rod, shape).items()}


def _tensions(solution: Solution, rod: int, shape: Shape) -> Curves:
    """Of the lines of a rod, which are not everywhere; friction takes from them along it."""
    robot, nodes = solution.assembly, shape.arclength.shape[-1]
    names = [line.name for line in drawn_lines(robot, drawn_rods(robot))]
    return {names[k]: solution.line(k, nodes=nodes).tension for k, (own, _) in enumerate(robot.lines) if own == rod}


QUANTITIES = {name: (_components(name), f"{name} [{unit}]") for name, (_, unit) in SYMBOLS.items()}
QUANTITIES["strain"] = (_strains, "strain [%]")
QUANTITIES["tension"] = (_tensions, "tension [N]")
LACKING = {
    "strain": "no rod has an outer_diameter, or an axial_stiffness or shear_stiffness that is finite",
    "tension": "no rod has lines",
}


def draw(ax: AxesGiven | None, family: Family, name: str, rods: list[int], *, nodes: int) -> "list[Axes]":
    """Of one rod of one instance, components in one axes; otherwise an axes for each component, coloured by rod or instance.

    Raises:
        ValueError: If ``ax`` are not as many axes as are needed, or no rod has such a quantity.
    """
    compute, label = QUANTITIES[name]
    solution = family.solution
    shapes = {k: solution.rod(k, nodes=nodes) for k in rods}
    found = {k: compute(solution, k, shape) for k, shape in shapes.items()}
    names = list(dict.fromkeys(component for curves in found.values() for component in curves))
    if not names:
        refuse("quantity", name, LACKING[name])
    if family.single and len(rods) == 1:
        (axes,) = column_of_axes(ax, [name])
        _one_rod(axes, shapes[rods[0]], found[rods[0]] if len(family) else {})
        axes.set(xlabel=ARCLENGTH, ylabel=label)
        return [axes]
    every = column_of_axes(ax, names)
    drawn = drawn_rods(solution.assembly)
    colors = colors_of(drawn)
    for component, axes in zip(names, every, strict=True):
        for order, (k, shape) in enumerate(shapes.items()):
            values = found[k].get(component)
            if values is None or not len(family):
                continue
            if family.single:
                # those of legs may lie on each other: what is below is wider
                width = 2.8 - 1.6 * order / (len(rods) - 1)
                style: dict[str, Any] = {"color": colors[k], "linestyle": STYLES[order // len(PALETTE) % len(STYLES)]}
                axes.plot(shape.arclength, values, label=drawn[k].name, lw=width, **style)
                continue
            dashes = STYLES[order % len(STYLES)]
            label_of = drawn[k].name if len(rods) > 1 else None
            for i, (s, own, color) in enumerate(zip(shape.arclength, values, family.colors(), strict=True)):
                axes.plot(s, own, color=color, lw=1.2, ls=dashes, label=None if i else label_of)
        unit = label[label.index("[") :]
        axes.set_ylabel(f"{component} {unit}")
        _zero_line(axes)
    every[-1].set_xlabel(ARCLENGTH)
    legend(every[0], above=len(rods) > FEW)
    family.colorbar(every)
    return every


def _one_rod(axes: "Axes", shape: Shape, curves: Curves) -> None:
    for k, (component, values) in enumerate(curves.items()):
        color = COMPONENTS[k] if k < len(COMPONENTS) else PALETTE[k % len(PALETTE)]
        axes.plot(shape.arclength, values, color=color, ls=STYLES[k % len(STYLES)], lw=1.8, label=component)
    _zero_line(axes)
    legend(axes)


def _zero_line(axes: "Axes") -> None:
    axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
    axes.grid(True, alpha=0.25)
