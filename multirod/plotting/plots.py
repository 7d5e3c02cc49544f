"""What ``Solution.plot`` and ``History.plot`` call."""

from dataclasses import replace

import numpy as np

from multirod.plotting import along, over_time, scene, tips
from multirod.plotting.canvas import axes_in_space, returned, title
from multirod.plotting.family import Family, family_of
from multirod.results.history import History
from multirod.results.solution import Solution
from multirod.types import AxesGiven, AxesOrArray, Numbers
from multirod.validation import boolean, choice, positive_int, refuse

SHAPE, TIPS = "shape", "tips"
IN_SPACE, ALONG = 51, 301  # nodes of a rod: along the arclength steps are to look like steps
EVERY = 2**31 - 1
FEW, SOME = 20, 12  # instances of a batch, and times of a motion, that are drawn at most, but for tips
OF_SOLUTIONS = (SHAPE, TIPS, *along.QUANTITIES)
OF_HISTORIES = tuple(dict.fromkeys((*OF_SOLUTIONS, *over_time.QUANTITIES)))


def plot_solution(
    solution: Solution,
    quantity: str = SHAPE,
    *,
    ax: AxesGiven | None = None,
    rod: int | str | None = None,
    instances: int | None = None,
    colour_by: str | Numbers | None = None,
    colour_label: str = "",
    nodes: int | None = None,
    frames: bool = True,
    loads: bool = True,
) -> AxesOrArray:
    """See ``Solution.plot``."""
    if isinstance(quantity, str) and quantity in over_time.QUANTITIES and quantity not in OF_SOLUTIONS:
        refuse("quantity", quantity, f"must be one of {', '.join(map(repr, OF_SOLUTIONS))}: that is of a motion, over its time")
    choice("quantity", quantity, OF_SOLUTIONS)
    family = family_of(solution, _most(instances, quantity, FEW), colour_by, colour_label)
    return _drawn(family, quantity, ax, rod, nodes, frames, loads)


def plot_history(
    history: History,
    quantity: str = SHAPE,
    *,
    ax: AxesGiven | None = None,
    rod: int | str | None = None,
    instance: int | tuple[int, ...] = 0,
    instances: int | None = None,
    colour_by: str | Numbers | None = None,
    colour_label: str = "",
    nodes: int | None = None,
    frames: bool = True,
    loads: bool = True,
) -> AxesOrArray:
    """See ``History.plot``."""
    choice("quantity", quantity, OF_HISTORIES)
    if quantity in over_time.QUANTITIES:
        count = _most(instances, quantity, SOME)
        return returned(over_time.draw(ax, history, quantity, instances=count, colour_by=colour_by, colour_label=colour_label))
    if colour_by is not None:
        refuse("colour_by", colour_by, "must be None: shapes and curves of a motion are coloured by time")
    motion, chosen = _motion(history, instance)
    family = family_of(motion, _most(instances, quantity, SOME), history.time, over_time.TIME, "samples")
    family = replace(family, title="; ".join(filter(None, (chosen, family.title))))
    return _drawn(family, quantity, ax, rod, nodes, frames, loads, motion)


def _most(instances: int | None, quantity: str, default: int) -> int:
    """How many are drawn at most; all tips, which take little room."""
    if instances is None:
        return EVERY if quantity == TIPS else default
    return positive_int("instances", instances)


def _motion(history: History, instance: object) -> tuple[Solution, str]:
    """One instance over time, shape (sample,), and which it is, where there are several."""
    axes = history.batch_shape[1:]
    if not axes:
        return history[:], ""
    index = instance if isinstance(instance, tuple) else np.unravel_index(_within(instance, axes), axes)
    try:
        motion = history[(slice(None), *index)]
    except IndexError:
        motion = history[:]
    if len(motion.batch_shape) != 1:
        refuse("instance", instance, f"must be the number of an instance, or an index into the batch axes {axes}")
    return motion, f"instance {instance} of {int(np.prod(axes)):,}"


def _within(instance: object, axes: tuple[int, ...]) -> int:
    number = positive_int("instance", instance, 0)
    if number >= np.prod(axes):
        refuse("instance", instance, f"must be below the number of instances, {int(np.prod(axes))}")
    return number


def _drawn(
    family: Family,
    quantity: str,
    ax: AxesGiven | None,
    rod: int | str | None,
    nodes: int | None,
    frames: bool,
    loads: bool,
    motion: Solution | None = None,
) -> AxesOrArray:
    rods = _rods(family.solution, rod)
    count = (IN_SPACE if quantity == SHAPE else ALONG) if nodes is None else positive_int("nodes", nodes, 2)
    options = {"frames": boolean("frames", frames), "loads": boolean("loads", loads)}
    if quantity not in (SHAPE, TIPS):
        axes = along.draw(ax, family, quantity, rods, nodes=count)
        title(axes[0], family.title)
        return returned(axes)
    in_space: AxesOrArray = axes_in_space(ax)
    if quantity == TIPS:
        tips.draw(in_space, family, frames=options["frames"])
    else:
        path = None if motion is None else motion.tip_position
        scene.draw(in_space, family, rods, nodes=count, path=path, **options)
    family.colorbar(in_space)
    title(in_space, family.title)
    return in_space


def _rods(solution: Solution, rod: int | str | None) -> list[int]:
    if rod is None:
        return list(range(solution.assembly.rod_count))
    return [solution._rod_index(rod)]
