"""Where inputs stand in a row, and which unknowns and residuals belong together."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.kernels.layout.members import drive_slices
from multirod.models.network.elements.elements import GAP_AT
from multirod.models.network.elements.groups import ALONG, ON_RODS
from multirod.models.network.graph import DRIVEN, PUSHED
from multirod.problem import Block

if TYPE_CHECKING:
    from multirod.models.network.graph import Graph

PER_ROD = ("rotation", "translation")
FIXED = ("fixed_position", "fixed_rotation")  # of bodies that are held
LOADED = ("force", "moment")  # of bodies and tips
FOLLOWING = ("follower_force", "follower_moment")  # of the same, in their frames


def input_places(graph: "Graph") -> dict[str, slice]:
    """Where each input stands in a row; those before ``LOADED`` are no loads, and what drives lines is last."""
    sizes = dict.fromkeys(PER_ROD, int(graph.first_tube[-1]))
    sizes |= {name: sum(own.values()) for name, own in graph.by_coordinate.items() if own and name in DRIVEN}
    sizes |= dict.fromkeys(FIXED, 3 * len(graph.fixed)) if graph.fixed else {}
    sizes |= dict.fromkeys((*LOADED, *FOLLOWING), 3 * len(graph.load_places))
    sizes |= {name: sum(own.values()) for name, own in graph.by_coordinate.items() if own and name in PUSHED}
    sizes |= dict.fromkeys(ON_RODS, 3 * len(graph.whole)) | dict.fromkeys(ALONG, 3)
    ends = np.cumsum([0, *sizes.values()]).tolist()
    drives = [name for own in graph.drives for name in own]
    return {name: slice(ends[k], ends[k + 1]) for k, name in enumerate(sizes)} | drive_slices(drives, ends[-1])


def place_of_all(slices: dict[str, slice], names: Sequence[str]) -> slice:
    """Where several inputs stand that follow each other, such as the coordinates of joints that are driven; empty of none."""
    own = [slices[name] for name in names if name in slices]
    return slice(own[0].start, own[-1].stop) if own else slice(0, 0)


def blocks_of(graph: "Graph", places: NDArray[np.intp], first: int, n: int) -> list[Block]:
    """One block a rod, then one of all bodies and of the holes through which rods slide.

    A straight inextensible rod does not answer a force along itself: where its tip is held, that force and the gap along the base
    stand with the bodies, and what is left of each rod is regular by itself.
    """
    blocks: list[Block] = []
    forces: list[int] = []
    gaps: list[int] = []
    held, slides = graph.ends[1].held, graph.slides
    turns: list[int] = []  # of holes, which belong to two pieces, and what slides
    for k, name in enumerate(graph.names):
        own = places[k][: graph.layout.poses_at[0].start].copy()
        if slides.shared[k]:
            own[graph.layout.angles_at[0]] = -1
        for at, end in zip(graph.layout.angles_at, graph.ends, strict=True):
            if first < n and end.table.slides[k].any():  # along the rod, the force there is told by it alone
                sliding = own[at][end.table.slides[k]]
                turns += sliding[sliding >= 0].tolist()
                own[at] = np.where(end.table.slides[k], -1, own[at])
        if slides.upper[k] >= 0:
            turns += [place for place in own[graph.layout.angles_at[1]].tolist() if place >= 0]
            own[graph.layout.angles_at[1]] = -1
        own = own[own >= 0]
        force, gap = int(places[k, graph.along[k]]), int(places[k, GAP_AT.stop - 1])
        rod = int(slides.owner[k])
        if held[k] and first < n:
            blocks.append(Block(name, own[own != force], own[own != gap], rod))
            forces, gaps = [*forces, force], [*gaps, gap]
        else:
            blocks.append(Block(name, own, own, rod))
    if first < n:
        rest = [*turns, *range(first, n)]
        unknowns, residuals = (np.array([*along, *rest], dtype=np.intp) for along in (forces, gaps))
        blocks.append(Block("bodies", unknowns, residuals))
    return blocks
