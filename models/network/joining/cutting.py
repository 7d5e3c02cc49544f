"""Into how many segments rods should be cut. Numbers in parentheses are those of ``docs/networks.md``."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.models.backbone.segments.cutting import advice, may_be_cut, needed
from multirod.models.network.joining.sliding import densities
from multirod.models.network.places import FOLLOWING, LOADED
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem


def too_long(problem: "NetworkProblem", instance: int) -> str:
    """(42) As ``NetworkProblem.too_long``."""
    graph, slides, pull = problem.graph, problem.graph.slides, _pull(problem, instance)
    wanted = {}
    for rod, name in enumerate(graph.whole_names):
        first = slides.of(rod)[0]
        length = float(slides.pieces[first] * problem.length[instance, first])
        growth = length * np.sqrt(pull / problem.stiffness[instance, first])
        count = needed(growth)
        if count > graph.segments.get(name, 1) and may_be_cut(graph.whole[rod].rods) and not graph.holes.get(name):
            wanted[name] = count
    return advice(wanted, "rod", "mr.Network(..., segments={})")


def _pull(problem: "NetworkProblem", instance: int) -> float:
    """All that may pull at a rod: the sum of the magnitudes of all forces [N]."""
    graph, inputs = problem.graph, problem.read("inputs")[instance]

    def sizes(name: str) -> FloatArray:
        return np.asarray(np.linalg.norm(inputs[problem.input_slice(name)].reshape(-1, 3), axis=1))

    length = problem.length[instance, : problem.rod_count]
    density = densities(problem)[instance]
    total = sum(sizes(name).sum() for name in (LOADED[0], FOLLOWING[0]))
    total += sizes("distributed_force").sum() * length.sum() + (sizes("rod_force")[graph.slides.owner] * length).sum()
    return float(total + sizes("gravity").sum() * (graph.mass.sum() + (density * length).sum()))
