# mypy: ignore-errors
"""Loads along the rods that depend on their configuration: what one is, and how its numbers get to a stretch."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import SimpleNamespace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.models.backbone.kernels.layout.arguments import Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.slots import Slot
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.sizes import Sizes
    from multirod.rod import Section

f64 = wp.float64


class Load(ABC):
    """A force ``f(p, R, s)`` and a moment ``l(p, R, s)`` per length, along the axes of the base.

    ``p`` is the position and ``R`` the frame of the rods there, from the base, ``s`` the arclength. A subclass is a law, an
    object of it a law with numbers, which a rod is given. The functions of the law are those of one place, in all lanes; what
    they need to know beyond these stands where their slots are.

    Where a force depends on the configuration, the internal force ``n`` is a state, ``n' = -f``, and its value at the base is
    unknown (``docs/model.md``, equation 3e). A moment stands in (4b).

    Attributes:
        force: Whether there is a force.
        moment: Whether there is a moment.
        by_rod: Whether its law says what of the moment acts on each of several rods, by ``torques``.
        by_place: Whether they depend on the position: then that is integrated, and is part of every column.
        conservative: Whether they derive from an energy per length.
        convex: Whether that, where it depends on the position, is convex in it and a part by itself, as of springs that pull back
            to their places: then it takes stability from no short stretch, and is told. Of other forces ``push_bound`` says how
            short stretches are to be.
        of_rod: The argument of ``Rod`` that gives it.
        input: The vector input of the robot on which they depend, fixed in the world and raised with the loads; None of others.
        parameters: Names of the numbers that the law needs of each rod, and their unit as powers of newton and metre. They are
            constant on a section.
        raised: Those of them by which the load is multiplied: they are raised with the loads, as the unloaded rods are where
            solvers begin.
        of_section: The vector of ``Section`` by which there are derivatives, (D24) of ``docs/derivatives.md``; None of others.
    """

    force: ClassVar[bool] = False
    moment: ClassVar[bool] = False
    by_rod: ClassVar[bool] = False
    by_place: ClassVar[bool] = False
    conservative: ClassVar[bool] = False
    convex: ClassVar[bool] = False
    of_rod: ClassVar[str] = "Rod.loads"
    input: ClassVar[str | None] = None
    parameters: ClassVar[Mapping[str, tuple[int, int]]] = {}
    raised: ClassVar[tuple[str, ...]] = ()
    of_section: ClassVar[str | None] = None

    def values(self, section: "Section") -> FloatArray:
        """The parameters on a section of the rod that has this load, shape (..., len(parameters))."""
        return np.zeros(len(self.parameters))

    @classmethod
    @abstractmethod
    def size(cls, sizes: "Sizes") -> FloatArray:
        """How much it can bend the rods, ``F L^2/EI`` of a force, shape (instance_count,): a bound, or about that."""

    @classmethod
    def moment_bound(cls, sizes: "Sizes") -> FloatArray:
        """Bound of the moment per length on all rods [N], shape (instance_count,); infinite, as by default where there is one,
        and stability is not judged."""
        return np.full(sizes.problem.instance_count, np.inf if cls.moment else 0.0)

    @classmethod
    def spring_bound(cls, sizes: "Sizes") -> FloatArray:
        """The most by which a force per length grows with the position [N/m^2], shape (instance_count,); zero of a law without
        ``spring``."""
        return np.zeros(sizes.problem.instance_count)

    @classmethod
    def push_bound(cls, sizes: "Sizes") -> FloatArray:
        """The most by which a force per length pushes further away as the position moves: by which the energy, a part by itself,
        is concave in that [N/m^2], shape (instance_count,); without it stability is not judged of a force that is not convex."""
        return np.full(sizes.problem.instance_count, np.inf if cls.force and not cls.convex else 0.0)

    @classmethod
    def is_judged(cls) -> bool:
        """Whether stability is told under its force, if there is one."""
        return not cls.force or cls.convex or cls.push_bound.__func__ is not Load.push_bound.__func__  # type: ignore[attr-defined]  # of the method

    @classmethod
    def same_across(cls, sizes: "Sizes") -> NDArray[np.bool_]:
        """Whether it tells no directions across the axis of the base apart, shape (rods,) or (1,)."""
        return np.zeros(1, dtype=bool)

    @classmethod
    def on_stretch(cls, n: int) -> list[Slot]:
        """What is constant on a stretch, of n rods: the parameters of each rod one after another, zero past its end, then the
        input along the axes of the base."""
        own = [Slot(name, n) for name in cls.parameters]
        return [*own, *([Slot("input", 3)] if cls.input else [])]

    @classmethod
    def at_place(cls, n: int) -> list[Slot]:
        """What ``force`` and ``moment`` put to a place for the variations."""
        return []

    @classmethod
    def of_direction(cls, n: int) -> list[Slot]:
        """What a direction in input space varies: the input, along the axes of the base."""
        return [Slot("input", 3)] if cls.input else []

    @staticmethod
    @abstractmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:
        """The law as functions for kernels.

        Args:
            numbers: Types and functions of numbers in lanes (``kernels/numbers``), those of states and columns (``State``,
                ``part``, ``keep``, ``Column``, ``part_of``, ``keep_in``), the ``layout``, and where slots stand:
                ``on_stretch(name)`` counts from ``z``, ``at_place(name)`` from ``a``, ``of_direction(name)`` from ``g``.

        Returns:
            Where there is a force, ``force(memory, z, a, s, frame, p)`` and ``force_variation(memory, z, a, g, ds, frame, v,
            dphi, dp)``; where there is a moment, ``moment`` and ``moment_variation`` of the same arguments: vectors along the
            axes of the base. ``frame`` is R, ``dphi`` its rotation along its own axes, ``dp`` and ``ds`` are the changes of p and
            s, ``v`` is the column. Of what is conservative ``energy(memory, z, a, s, frame, p)``, per length. Of several rods,
            where it is ``by_rod``, ``torques(memory, a, f)`` and ``torque_variations(memory, a, g, frame, v, dphi, f)``, which
            take from the rates of their torques what acts on each; else all of a moment about the axis acts on the innermost that
            there is. Optionally ``spring(memory, z)``, the most by which a force per length grows with the position, which steps
            that are controlled by their error heed, (20b).
        """

    @classmethod
    def loading(cls, grid: SimpleNamespace) -> SimpleNamespace:
        """How a lane gets its numbers at the start of a stretch, one lane at a time and in SI units.

        Args:
            grid: ``n``, ``column``, where its parameters stand in the material, ``input``, where its input begins in a row;
                ``on_stretch(name)``, ``of_direction(name)`` as for ``law``; ``set_number(memory, row, lane, value)``,
                ``set_vector``, ``section_at``, ``load_vector``, ``direction_vector``, ``section_vector`` and ``counted``.

        Returns:
            ``stretch(rods, call, case, memory, z, l, s)`` and ``direction(call, case, memory, g, l, k, unit)``; of a law with
            ``of_section`` also ``design(rods, call, case, memory, g, l, k, s, unit)``.
        """
        memory_type, n, COLUMN, INPUT = grid.memory_type, grid.n, grid.column, grid.input
        set_number, set_vector, section_at, counted = grid.set_number, grid.set_vector, grid.section_at, grid.counted
        load_vector, direction_vector = grid.load_vector, grid.direction_vector
        powers, RAISED = list(cls.parameters.values()), [name in cls.raised for name in cls.parameters]
        FIRST = grid.on_stretch(next(iter(cls.parameters))) if powers else -1
        INPUT_AT, VARIED_AT = (grid.on_stretch("input"), grid.of_direction("input")) if cls.input else (-1, -1)

        @wp.func
        def stretch(
            rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, z: int, l: int, s: f64
        ):
            for i in range(rods.end.shape[1]):
                m, present = section_at(rods, call, case, i, s)
                for j in range(wp.static(len(powers))):
                    value = present * rods.material[case.rods, i, m, wp.static(COLUMN + j)]
                    if wp.static(RAISED[j]):
                        value *= call.problem.load_factor[case.index]
                    value = counted(case, value, f64(wp.static(powers[j][0])), f64(wp.static(powers[j][1])))
                    set_number(memory, z + wp.static(FIRST + n * j) + i, l, value)
            if wp.static(INPUT >= 0):
                vector = case.to_base * load_vector(call, case.index, wp.static(INPUT))
                set_vector(memory, z + wp.static(INPUT_AT), l, vector)

        @wp.func
        def direction(call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, g: int, l: int, k: int, unit: f64):
            if wp.static(INPUT >= 0):
                vector = (f64(1.0) / unit) * (case.to_base * direction_vector(call, case, k, wp.static(INPUT)))
                set_vector(memory, g + wp.static(VARIED_AT), l, vector)

        return SimpleNamespace(stretch=stretch, direction=direction)
