"""How bent a backbone is all along, and how that varies: a pass over nodes that takes the place of an integration."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from multirod.capabilities import Bending
from multirod.models.backbone.derivatives.along import AlongPass
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem


class BackboneBending(Bending):
    """Of a ``BackboneProblem``, whose rods are all bent as the first is; of any number of instances, each of which counts as a
    backbone."""

    def __init__(self, problem: "BackboneProblem", node_count: int) -> None:
        self._problem, self._nodes = problem, problem.nodes.bare_of_all(node_count)
        self._pass = AlongPass(problem, 2, shared=True)

    def jumps(self) -> FloatArray:  # noqa: D102
        return self._problem.shapes.jumps()[0]

    def survey(self) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        self._nodes.launch.launch()
        return self._nodes.read("node_arclength"), self._nodes.read("node_curvature")[..., :2]

    def place(self, places: FloatArray) -> None:
        """Look at ``places`` (instance_count, 2) in launches from now on."""
        self._pass.place(places)

    def launch(self) -> None:
        """Integrate, as the problem's own launch does."""
        self._pass.launch()

    def integrate(self, places: FloatArray) -> None:  # noqa: D102
        self._problem.heed_stop()
        self.place(places)
        self.launch()

    def at_places(self, names: Sequence[str], backbone: int) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        curvature, columns = self._pass.curvature(0)
        return curvature[backbone, :, :2], columns[backbone, :, :2]


def may_tell_bending(problem: "BackboneProblem") -> bool:
    """Whether columns along its rods are known, and all are bent alike."""
    return problem.on_host and not problem.features.eccentric and not problem.breakpoints
