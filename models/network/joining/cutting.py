"""Into how many segments rods should be cut. Numbers in parentheses are those of ``docs/networks.md``."""

from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from multirod.models.network.joining.sliding import densities, may_be_cut
from multirod.models.network.places import FOLLOWING, LOADED
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem

EACH = 5.0  # by whose exponential an error may grow along one segment
LONGEST = 10.0  # by which it may along a rod before it is said that it should be cut


def too_long(problem: "NetworkProblem", instance: int) -> str:
    """(42) As ``NetworkProblem.too_long``."""
    graph, slides, pull = problem.graph, problem.graph.slides, _pull(problem, instance)
    wanted = {}
    for rod, name in enumerate(graph.whole_names):
        first = slides.of(rod)[0]
        length = float(slides.pieces[first] * problem.length[instance, first])
        growth = length * np.sqrt(pull / problem.stiffness[instance, first])
        count = ceil(growth / EACH)
        if growth > LONGEST and count > graph.segments.get(name, 1) and may_be_cut(graph.whole[rod].rods, graph.holes.get(name)):
            wanted[name] = count
    if not wanted:
        return ""
    which = f"rod{'s' * (len(wanted) > 1)} {', '.join(map(repr, wanted))}"
    return f" ({which} may amplify errors too much to be integrated in one piece: mr.Network(..., segments={wanted}))"


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
