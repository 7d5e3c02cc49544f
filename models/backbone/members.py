"""What a rod carries along itself and that gives way with it: members, which add to the energy of its section."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.rod import Section


class Member(ABC):
    """Something that a rod carries along itself: its energy per length ``W(u, v)`` adds to the rod's own.

    A subclass is a law, an object of it a law with numbers. The rod and its members share the strains ``u`` and ``v`` of the
    section, and carry the section's force and moment together (``docs/model.md``, equation 5m). Where the rod is at rest, at ``u
    = u*`` and ``v = e3``, the gradient of ``W`` is zero: the unloaded rod is where solvers begin.

    Attributes:
        parameters: Names of the numbers that the law needs at each section, and their unit as powers of newton and metre, such as
            ``{"stiffness": (1, 2)}`` for N m^2.
        convex: Whether ``W`` is convex in the strains, so that the section is stiffer than the rod alone. Where it is not,
            stability is not judged.
    """

    parameters: ClassVar[Mapping[str, tuple[int, int]]]
    convex: ClassVar[bool] = False

    @abstractmethod
    def values(self, section: "Section") -> FloatArray:
        """The parameters at a section of the rod, shape (..., len(parameters))."""

    @staticmethod
    @abstractmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:
        """The law as functions for kernels.

        Args:
            numbers: Types and functions of numbers in lanes: ``Real``, ``Vec3``, ``Response``, ``memory_type``, ``row`` and
                others of ``kernels/numbers``; ``add_moment``, ``add_force`` and ``add_stiffness``.

        Returns:
            ``respond(memory, at, x, u, e, r)``, which adds to the ``Response`` r the derivatives of ``W`` by ``u`` (a moment) and
            ``e = v - e3`` (a force), and its second derivatives, at row and column of ``(u, e)``, row <= column; and
            ``energy(memory, at, x, u, e)``, which is ``W`` [N]. ``row(memory, at + k)`` is parameter k, ``x`` the arclength from
            the start of the stretch.
        """


def kinds(members: Any) -> tuple[type[Member], ...]:
    """The laws of members, in their order."""
    return tuple(type(member) for member in members)
