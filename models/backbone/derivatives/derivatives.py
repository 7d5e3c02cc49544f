"""Derivatives of a backbone by inputs and by parameters of its rods, at its tip and along it.

Numbers in parentheses are those of ``docs/derivatives.md``.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from multirod.models.backbone.derivatives.along import Along, AlongPass
from multirod.models.backbone.derivatives.behind_plate import BehindPlate
from multirod.models.backbone.derivatives.designs import COMPONENTS, DEAD, POSE, Designs, carried, turned_loads
from multirod.problem import FEW, PosesSensed
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem


class BackboneDerivatives:
    """Of a ``BackboneProblem``."""

    def __init__(self, problem: "BackboneProblem") -> None:
        self.problem = problem
        self.followed: tuple[str, ...] = ()  # what directions by inputs and unknowns are by
        self._designs: dict[str, Designs] = {}
        self._behind: dict[tuple[str, ...], BehindPlate] = {}

    def follow(self, names: Sequence[str]) -> None:
        """Be aimed at these: where directions by them depend on inputs and unknowns, they are found at each integration."""
        behind_plate = self.problem.transmission and any(name in COMPONENTS for name in names)
        self.followed = tuple(names) if "base" in names or behind_plate else ()

    def point(self, directions: FloatArray) -> None:
        """Set ``directions`` by ``followed`` but for what depends on inputs and unknowns, which ``refresh`` has to find."""
        names, last = self.followed, 0
        for name in names:
            for own in self._columns_of(names, name):
                directions[:, own] = self._directions_at_rest(name)
                last = max(last, own.stop)
        directions[:, last:] = 0.0

    def _directions_at_rest(self, name: str) -> FloatArray | float:
        if name in COMPONENTS:
            return self.designs(name).rows_at_rest
        return 0.0 if name == "base" else self.problem.directions_by(name)

    def refresh(self, directions: FloatArray | None) -> None:
        """What of the directions by ``followed`` depends on inputs and unknowns, in place, at those of the problem.

        ``directions`` are what NumPy sees of them in place, if it does: else what is by the base stands in them already.
        """
        names = self.followed
        if directions is not None:
            for own in self._columns_of(names, "base"):
                directions[:, own] = self.directions_by("base")
        if self.problem.transmission and any(name in COMPONENTS for name in names):
            if names not in self._behind:
                self._behind[names] = self._behind_plate(names)
            self._behind[names].turn()

    def _behind_plate(self, names: tuple[str, ...]) -> BehindPlate:
        designed = tuple(dict.fromkeys(name for name in names if name in COMPONENTS))
        places = [np.arange(own.start, own.stop) for name in designed for own in self._columns_of(names, name)]
        designs = [self.designs(name) for name in designed for _ in self._columns_of(names, name)]
        return BehindPlate(self.problem, designs, np.concatenate(places), self.problem.directions)

    def directions_by(self, name: str) -> FloatArray:
        """Directions along each number of a parameter, shape (instance_count, k, directions.shape[2])."""
        return turned_loads(self.problem, DEAD) if name == "base" else self.designs(name).rows()

    def fix_unknowns(self, names: Sequence[str], slopes: FloatArray, moved: FloatArray) -> None:
        """(D9) Make of columns of residual and pose by parameters, what is at the base fixed, those with the unknowns fixed."""
        rates, n = self.unknown_rates(names), self.problem.unknown_count
        if rates is not None:
            slopes -= self.problem.read("gamma").reshape(-1, n, n) @ rates
            moved -= self.problem.pose_columns.numpy()[:, :, :n] @ rates
        for own in self._columns_of(names, "base"):
            moved[:, :, own] += carried(self.problem.read("position") - self.base_position())

    def _columns_of(self, names: Sequence[str], wanted: str) -> Iterator[slice]:
        """Where the columns by one of the names stand."""
        if wanted not in names:
            return
        first = 0
        for name in names:
            size = self._size(name)
            if name == wanted:
                yield slice(first, first + size)
            first += size

    def _size(self, name: str) -> int:
        """How many columns are by a name."""
        if name in COMPONENTS:
            return self.designs(name).count
        if name == "base":
            return POSE
        place = self.problem.input_slice(name)
        return int(place.stop - place.start)

    def designs(self, name: str) -> Designs:
        """How the rods change with a parameter: the same as long as there is the problem."""
        if name not in self._designs:
            self._designs[name] = Designs(self.problem, name)
        return self._designs[name]

    def unknown_rates(self, names: Sequence[str]) -> FloatArray | None:
        """(D9) How the unknowns must change with each number for what is at the base to stay, (instance_count, n, k); None where
        they need not."""
        if self.problem.eliminates or not any(name in COMPONENTS for name in names):
            return None
        size = (self.problem.instance_count, self.problem.unknown_count)
        rates = [
            self.designs(name).unknown_rates() if name in COMPONENTS else np.zeros((*size, self._size(name))) for name in names
        ]
        return np.concatenate(rates, axis=2)

    def along(self, names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:
        """What ``ByInputs.along`` says."""
        found = self.along_itself(rod, places)
        self.complete(names, found)
        return found.columns

    def complete(self, names: Sequence[str], found: Along) -> None:
        """(D9), (D10) In place: columns along a rod with the unknowns fixed, and carried by a base that is moved."""
        rates, n = self.unknown_rates(names), self.problem.unknown_count
        if rates is not None:
            for values in found.columns.values():
                values[..., n:] -= values[..., :n] @ rates[:, None]
        for own in self._columns_of(names, "base"):
            found.carry(slice(n + own.start, n + own.stop))

    def along_itself(self, rod: int, places: FloatArray) -> Along:
        """``AlongPass.at`` of the last integration's unknowns, inputs and directions."""
        self._refuse_side_by_side()
        made: AlongPass
        if self.problem.instance_count > FEW:  # it has columns at all places
            made = AlongPass(self.problem, places.shape[1])
        else:
            made = self.problem.tool(("along", places.shape[1]), lambda: AlongPass(self.problem, places.shape[1]))
        return made.at(places, rod)

    def _refuse_side_by_side(self) -> None:
        if self.problem.features.eccentric:
            raise NotImplementedError("derivatives along rods side by side are not known: their frames are not the line's")

    def sensing(self, places: FloatArray) -> AlongPass:
        """A pass that may take the place of an integration, at rising ``places`` (count,) of each instance."""
        self._refuse_side_by_side()
        made = AlongPass(self.problem, len(places), shared=True)
        made.place(np.broadcast_to(places, (self.problem.instance_count, len(places))))
        return made

    def base_position(self) -> FloatArray:
        """Of the base in the world [m], shape (instance_count, 3)."""
        position = self.problem.base[..., :3, 3]
        return np.broadcast_to(position, (*self.problem.batch_shape, 3)).reshape(-1, 3) if position.ndim > 1 else position[None]


class BackboneSensing:
    """A backbone's integration that tells more, at some places along it: a ``Sensing``."""

    def __init__(self, derivatives: BackboneDerivatives, places: FloatArray) -> None:
        self._derivatives, self._pass = derivatives, derivatives.sensing(places)

    def launch(self) -> None:
        """Integrate."""
        self._pass.launch()

    def curvature(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """As ``Sensing`` says."""
        curvature, columns = self._pass.curvature(rod)
        rates, n = self._derivatives.unknown_rates(names), self._derivatives.problem.unknown_count
        if rates is not None:
            columns[..., n:] -= columns[..., :n] @ rates[:, None]
        return curvature, columns

    def poses(self, names: Sequence[str], rod: int) -> PosesSensed:
        """As ``Sensing`` says."""
        found = self._pass.poses(rod)
        self._derivatives.complete(names, found)
        return found.at(self._derivatives.base_position())

    def wrench(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """As ``Sensing`` says."""
        found = self._pass.wrenches()
        self._derivatives.complete(names, found)
        return found.arms["wrench"], found.columns["wrench"]
