"""Rods and lines on nodes along their arclength: what problems say, and results."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NoReturn

from multirod.naming import Asked
from multirod.validation import FloatArray, frozen, shown

OF_SHAPES = {
    **dict.fromkeys(("x", "y", "z", "p", "xyz", "positions", "centreline", "points"), "position, whose last axis is x, y, z"),
    **dict.fromkeys(("s", "arclengths"), "arclength"),
    **dict.fromkeys(("rotations", "frame", "frames", "R"), "rotation"),
    **dict.fromkeys(("u", "strain", "strains", "curvatures"), "curvature"),
    **dict.fromkeys(("m", "moments"), "moment"),
    **dict.fromkeys(("n", "forces"), "force"),
}  # what attributes of a shape are called elsewhere


class Unindexed(Asked):
    """Arrays by name, which are indexed, not what has them."""

    if not TYPE_CHECKING:  # which knows that there is none
        __iter__ = None

        def __getitem__(self, index: object) -> NoReturn:
            said = f"what it has is asked by name, .{index}"
            if not isinstance(index, str):
                said = "index one of its arrays, such as .position, or the solution that it is of"
            raise TypeError(f"{type(self).__name__}[{shown(index)}] is not allowed: {said}")


@dataclass(frozen=True)
class Shape(Unindexed):
    """Rods of all instances on nodes along their arclength; axes (batch, node, ...) of one rod, read-only.

    Attributes:
        arclength: From the base [m], shape (batch, node_count).
        position: Centreline in the world [m], shape (batch, node_count, 3).
        rotation: Material frames of this rod, body to world, shape (batch, node_count, 3, 3).
        curvature: ``u`` in that frame [1/m], shape (batch, node_count, 3); at a section end, that of the section before.
        moment: Internal moment of this rod, in that frame [N m], shape (batch, node_count, 3).
        force: Internal force in that frame [N], of all concentric rods together, shape (batch, node_count, 3).
        total_moment: The moment of this rod and of its members and lines together, shape (batch, node_count, 3).
        total_force: The same for the force.
    """

    called: ClassVar[Mapping[str, str]] = OF_SHAPES
    arclength: FloatArray
    position: FloatArray
    rotation: FloatArray
    curvature: FloatArray
    moment: FloatArray
    force: FloatArray
    total_moment: FloatArray = None  # type: ignore[assignment]  # the rod's own, by default
    total_force: FloatArray = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for name in ("moment", "force"):
            if getattr(self, f"total_{name}") is None:
                object.__setattr__(self, f"total_{name}", getattr(self, name))
        for name, value in vars(self).items():
            object.__setattr__(self, name, frozen(value))

    def __repr__(self) -> str:
        return f"Shape({', '.join(f'{name} {value.shape}' for name, value in vars(self).items())})"


def nodes_of_pieces(node_count: int, pieces: int) -> list[int]:
    """How many nodes each piece of a rod has that slides through holes, two at least: those below have one more."""
    fewest, more = divmod(node_count, pieces)
    return [max(2, fewest + (k < more)) for k in range(pieces)]


@dataclass(frozen=True)
class LineShape(Unindexed):
    """A line on nodes evenly spaced along its rod; read-only, NaN where the line is not.

    Attributes:
        arclength: Of the rod [m], shape (..., node_count).
        position: In the world [m], shape (..., node_count, 3).
        tension: [N], shape (..., node_count).
    """

    arclength: FloatArray
    position: FloatArray
    tension: FloatArray

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, frozen(value))

    def __repr__(self) -> str:
        return f"LineShape({', '.join(f'{name} {value.shape}' for name, value in vars(self).items())})"
