"""What the ends of rods do to what holds them: equations (23), (24) of ``docs/model.md``."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from multirod.assembly import Backbone, Robot_co
from multirod.models.backbone.kernels.tips import as_far, longest
from multirod.naming import meant
from multirod.problem import nodes_of_pieces
from multirod.results.jointed import Jointed
from multirod.rotations import cross
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, frozen, measurement, refuse

if TYPE_CHECKING:
    from multirod.problem import Shape

ON_TIP = ("tip_force", "tip_moment")


@dataclass(frozen=True)
class Wrench:
    """A force and a moment about a point, all in the axes of the world; arrays have the batch's leading axes, and are read-only.

    Attributes:
        force: [N], shape (..., 3).
        moment: About ``position`` [N m], shape (..., 3).
        position: The point, from the origin of the world [m], shape (..., 3).
    """

    force: FloatArray
    moment: FloatArray
    position: FloatArray

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, frozen(value))

    def about(self, point: Numbers) -> "Wrench":
        """The same wrench, told about another point [m], in the world, shape (..., 3): such as ``solution.tip_position``.

        Raises:
            ValueError: If it is not such an array, finite or NaN, or its leading axes do not fit.
        """
        there = measurement("Wrench.about.point", point, (3,))
        try:
            np.broadcast_shapes(there.shape, self.force.shape)
        except ValueError:
            allowed = f"its leading axes must broadcast to those of the wrench, {self.force.shape[:-1]}"
            refuse("Wrench.about.point", Described(f"array of shape {there.shape}"), allowed)
        moment = self.moment + cross(*np.broadcast_arrays(self.position - there, self.force))
        return Wrench(self.force, moment, np.broadcast_to(there, moment.shape))

    def __repr__(self) -> str:
        if self.force.ndim > 1:
            return f"Wrench({', '.join(f'{name} {value.shape}' for name, value in vars(self).items())})"
        force, moment, position = (", ".join(f"{x:.5g}" for x in value + 0.0) for value in vars(self).values())
        return f"Wrench(force ({force}) N, moment ({moment}) N m about ({position}) m)"


class Wrenches(Jointed[Robot_co]):
    """Found equilibria, and what rods do to what holds them."""

    def wrench(self, rod: int | str | None = None, end: Literal["base", "tip"] | int = "base") -> Wrench:
        """Force and moment that an end of a rod exerts on what holds it: the ground, a body, the platform, a holder, a plate.

        In the axes of the world, about that end; ``wrench(...).about(point)`` is the same about another point. What holds the end
        exerts the opposite on the rod, its reaction. A rod and its lines count together, and so do tubes in each other: at the
        base, what pulls lines and what turns and pushes tubes stands on what holds it. So the wrenches of all rods on a platform
        or a body, its own loads and its weight add up to zero, and those of both ends of a rod, (23), to what acts along it.

        Args:
            rod: Index or name, as of ``rod(...)``; of tubes in each other any of them, in a ``Network`` also the name that they
                have together.
            end: ``"base"`` or ``"tip"``; or, of a rod that slides through holes, the number of one, from 0 at the base on.

        Raises:
            ValueError: If there is no such rod or hole, no rod is said of several that stand apart, or nothing holds the tip.
            NotImplementedError: If the assembly does not say what holds its rods.
        """
        own = self._backbone(rod)
        if isinstance(end, (int, np.integer)) and not isinstance(end, bool):
            if not 0 <= end < own.holes:
                known = f", or a hole, a number below {own.holes}" if own.holes else ": it slides through no hole"
                refuse("end", end, f"must be 'base' or 'tip'{known}")
            return self._at_hole(own, int(end))
        if not isinstance(end, str) or end not in ("base", "tip"):
            refuse("end", end, f"must be 'base' or 'tip'{meant(end, ('base', 'tip')) if isinstance(end, str) else ''}")
        if end == "tip" and not own.tip:
            refuse("end", end, "must be 'base': nothing holds the tip, and what acts on it is an input")
        shapes = self._shape_pass(self._default_node_count)[0][own.rods]
        return self._as_given(_at_base(shapes) if end == "base" else self._at_tip(shapes))

    @cached_property
    def base_torque(self) -> FloatArray:
        """Torque about its own axis with which what turns the base of each rod or tube holds it [N m], shape (..., rod_count).

        The torque of its motor, positive the way ``rotation`` counts, (24): the derivative of ``potential`` by ``rotation``,
        where loads have one and what holds the base does not turn. Lines of the rod turn with it.
        """
        shapes = self._shape_pass(self._default_node_count)[0]
        torque = np.stack([-shape.total_moment[:, 0, 2] for shape in shapes], axis=1)
        return self._masked(torque, torque.shape[1:])

    def _backbone(self, rod: int | str | None) -> Backbone:
        """The backbone that a rod is on."""
        every = self.assembly.backbones
        named = [own for own in every if own.name and own.name == rod]
        index = named[0].rods.start if named else self._rod_index(rod)
        return next(own for own in every if own.rods.start <= index < own.rods.stop)

    def _at_tip(self, shapes: "tuple[Shape, ...]") -> tuple[FloatArray, ...]:
        """What acts on the holder of a tip, where those rods end that reach as far as any."""
        ends = np.stack([shape.arclength[:, -1] for shape in shapes], axis=1)
        first, there = longest(ends), as_far(ends, ends.max(axis=1, keepdims=True))
        rows = np.arange(len(ends))
        force, moment, position = (np.stack(v, axis=1) for v in zip(*(_in_world(shape, -1) for shape in shapes), strict=True))
        result = -force[rows, first], -(there[..., None] * moment).sum(axis=1), position[rows, first]
        if not self.assembly.end_held:
            return result
        given = (np.broadcast_to(getattr(self.inputs, name), (*self.batch_shape, 3)).reshape(-1, 3) for name in ON_TIP)
        return *(own + load for own, load in zip(result[:2], given, strict=True)), result[2]

    def _at_hole(self, own: Backbone, hole: int) -> Wrench:
        """What acts on the body around a rod: the tip of the piece below the hole, and the base of that above it."""
        pieces = own.holes + 1
        count = max(self._default_node_count, 2 * pieces)
        shape = self._shape_pass(count)[0][own.rods][0]
        above = sum(nodes_of_pieces(count, pieces)[: hole + 1])
        below, beyond = _in_world(shape, above - 1), _in_world(shape, above)
        return self._as_given((beyond[0] - below[0], beyond[1] - below[1], below[2]))

    def _as_given(self, values: tuple[FloatArray, ...]) -> Wrench:
        return Wrench(*(self._masked(value, (3,)) for value in values))


def _in_world(shape: "Shape", node: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Force and moment that rod and lines carry at a node, and where it is, in the world, shapes (batch, 3)."""
    R = shape.rotation[:, node]
    force, moment = ((R @ values[:, node, :, None])[..., 0] for values in (shape.total_force, shape.total_moment))
    return force, moment, shape.position[:, node]


def _at_base(shapes: "tuple[Shape, ...]") -> tuple[FloatArray, FloatArray, FloatArray]:
    """(23) What acts on the holder of the base: the moments of all rods, and the force that each says of all together."""
    found = [_in_world(shape, 0) for shape in shapes]
    return found[0][0], np.sum([moment for _, moment, _ in found], axis=0), found[0][2]
