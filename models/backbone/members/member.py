"""What a rod carries along itself and that gives way with it: members, which add to the energy of its section."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from multirod.models.backbone.kernels.layout.members import CONDITION
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.rod import Section


class Member(ABC):
    """Something that a rod carries along itself: its energy per length ``W(u, v)`` adds to the rod's own.

    A subclass is a law, an object of it a law with numbers. The rod and its members share the strains ``u`` and ``v`` of the
    section, and carry the section's force and moment together (``docs/model.md``, equation 5m). Where the rod is at rest, at ``u
    = u*`` and ``v = e3``, the gradient of ``W`` is zero: the unloaded rod is where solvers begin.

    A member may be driven by an input ``T`` of the robot, one number for each: then ``W + T w(u, v)`` takes the place of ``W``,
    and ``w``, such as the length of a tendon per length of rod, is what ``T`` works on. Its potential is not stored in the rod.
    Or ``T`` is unknown, and the input says what ``w`` has to come to along the rod (``docs/lines.md``, L7).

    Attributes:
        parameters: Names of the numbers that the law needs on each piece of the rod, and their unit as powers of newton and
            metre, such as ``{"stiffness": (1, 2)}`` for N m^2.
        functions: The same for what varies along the rod: functions of its arclength.
        drive: The input that drives it, and the unit of ``T``; None where nothing does.
        conditioned: Whether ``T`` is unknown; the numbers of ``CONDITION`` then follow the parameters in ``values``.
        slackens: Whether an unknown ``T`` is never negative.
        rubs: Whether friction takes from ``T`` along the rod; what is left of it is the last of the functions.
        convex: Whether the energy is convex in the strains, so that the section is stiffer than the rod alone. Where it is not,
            stability is not judged.
    """

    parameters: ClassVar[Mapping[str, tuple[int, int]]]
    functions: ClassVar[Mapping[str, tuple[int, int]]] = {}
    drive: ClassVar[tuple[str, tuple[int, int]] | None] = None
    conditioned: ClassVar[bool] = False
    slackens: ClassVar[bool] = False
    rubs: ClassVar[bool] = False
    convex: ClassVar[bool] = False

    @abstractmethod
    def values(self, section: "Section", s: float) -> FloatArray:
        """The parameters on a piece of the rod, of a section, that lies between two ``cuts``: at any arclength s there, from the
        rod's base [m]; shape (..., value_count())."""

    @classmethod
    def value_count(cls) -> int:
        """How many ``values`` there are."""
        return len(cls.parameters) + cls.conditioned * len(CONDITION)

    @property
    def cuts(self) -> Sequence[float]:
        """Arclengths where parameters jump or polynomials end [m]: there is a node of the grid."""
        return ()

    def polynomials(self, s: float) -> tuple[float, float, FloatArray]:
        """The functions on the piece that lies between two ``cuts``, as polynomials: at any arclength s there.

        Returns:
            Where the polynomials begin and end [m], and their monomial coefficients, lowest first, in a coordinate from -1 to 1
            between these, shape (..., degree + 1, len(functions)).
        """
        return 0.0, 1.0, np.zeros((1, len(self.functions)))

    @staticmethod
    @abstractmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:
        """The law as functions for kernels.

        Args:
            numbers: Types and functions of numbers in lanes: ``Real``, ``Vec3``, ``Response``, ``memory_type``, ``row`` and
                others of ``kernels/numbers``; ``add_moment``, ``add_force`` and ``add_stiffness``; whether forces and second
                derivatives by ``e`` are asked for, ``FORCES``; whether functions vary, ``VARIED``, with ``value``, ``slope``
                and ``bend``.

        Returns:
            ``respond(memory, at, on, u, e, r)``, which adds to the ``Response`` r the derivatives of the energy by ``u`` (a
            moment) and ``e = v - e3`` (a force), and its second derivatives, at row and column of ``(u, e)``, row <= column; and
            ``energy(memory, at, on, u, e)``, which is ``W`` [N]. ``row(memory, at + k)`` is parameter k, and the input after
            them; ``value(memory, on + k)`` function k, ``slope`` and ``bend`` its first and second derivative by arclength.

            Of what is driven also ``pull(memory, at, on, u, e, r)``, which adds the derivatives of ``w`` and returns ``w``; of
            what has functions ``slide(memory, at, on, u, e, r)``, which adds how the derivatives of the energy change along the
            rod at constant strains, and returns how ``w`` does, zero of what is not driven.
        """


def kinds(members: Iterable[Member]) -> tuple[type[Member], ...]:
    """The laws of members, in their order."""
    return tuple(type(member) for member in members)
