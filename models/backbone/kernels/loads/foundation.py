# mypy: ignore-errors
"""Rods in an elastic medium: the force per length (3e), its variation (18e), and the energy (14e).

Numbers in parentheses are those of ``docs/model.md``, (D24) that of ``docs/derivatives.md``.
"""

from types import SimpleNamespace

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.models.backbone.kernels.layout.arguments import Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.slots import Slot
from multirod.models.backbone.kernels.loads.load import Load
from multirod.models.backbone.kernels.numbers.lanes import add, div, mul, neg, sub  # noqa: F401  (by name)
from multirod.validation import FloatArray

f64 = wp.float64
MEDIUM = 13  # where the stiffness of the medium stands in the material


class Foundation(Load):
    """A medium that holds each piece of the rods to its place on the line straight out of the base."""

    force = by_place = conservative = convex = True
    of_rod, of_section = "Rod.foundation", "foundation"
    rises = False  # with the loads around straight rods too

    @classmethod
    def on_stretch(cls, n: int) -> list[Slot]:
        return [Slot("stiffness", 3, "force per area")]  # of what is around all rods

    @classmethod
    def at_place(cls, n: int) -> list[Slot]:
        return [Slot("departure", 3, "length")]

    @classmethod
    def of_direction(cls, n: int) -> list[Slot]:
        return [Slot("stiffening", 3, "force per area")]

    @classmethod
    def size(cls, sizes) -> FloatArray:
        """How much it bends rods that are not straight, ``k L^4/EI`` times their bend."""
        problem, table = sizes.problem, sizes.problem.arrays
        length = table.end[:, 0, -1]
        stiffness = cls.spring_bound(sizes) * length**4 / table.material[:, 0, :, :3].min(axis=(1, 2))
        _, kappa = sizes.by_section
        return np.asarray(stiffness * np.minimum(kappa.max(axis=(1, 2)) * problem.each(length), 1.0))

    @classmethod
    def spring_bound(cls, sizes) -> FloatArray:
        """Of a rod in it, of several the most that one brings."""
        return sizes.problem.each(sizes.problem.arrays.material[..., MEDIUM : MEDIUM + 3].max(axis=(1, 2, 3)))

    @classmethod
    def same_across(cls, sizes) -> NDArray[np.bool_]:
        k = sizes.problem.arrays.material[..., MEDIUM : MEDIUM + 2]
        return np.asarray((k[..., 0] == k[..., 1]).all(axis=(1, 2)))

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:
        Real, Vec3, Frame, Column, memory_type, d = (
            numbers.Real,
            numbers.Vec3,
            numbers.Frame,
            numbers.Column,
            numbers.memory_type,
            numbers.d,
        )
        row3, put3, times, minus = numbers.row3, numbers.put3, numbers.times, numbers.minus
        dot, largest, DESIGN = numbers.dot, numbers.largest, numbers.layout.DESIGN
        STIFFNESS, DEPARTURE = numbers.on_stretch("stiffness"), numbers.at_place("departure")
        STIFFENING = numbers.of_direction("stiffening")

        @wp.func
        def departure(s: Real, p: Vec3) -> Vec3:
            """p - s e3"""
            return Vec3(p.x, p.y, p.z - s)

        @wp.func
        def push(memory: memory_type, z: int, by: Vec3) -> Vec3:
            """``-k`` times a way from the place."""
            held = times(row3(memory, z + wp.static(STIFFNESS)), by)
            return Vec3(-held.x, -held.y, -held.z)

        @wp.func
        def force(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Vec3:
            """(3e) ``-k (p - s e3)``"""
            way = departure(s, p)
            if wp.static(DESIGN):
                put3(memory, a + wp.static(DEPARTURE), way)
            return push(memory, z, way)

        @wp.func
        def force_variation(
            memory: memory_type, z: int, a: int, g: int, ds: Real, frame: Frame, v: Column, dphi: Vec3, dp: Vec3
        ) -> Vec3:
            """(18e), (D24)"""
            df = push(memory, z, departure(ds, dp))
            if wp.static(DESIGN):
                way = row3(memory, a + wp.static(DEPARTURE))
                df = minus(df, times(row3(memory, g + wp.static(STIFFENING)), way))
            return df

        @wp.func
        def spring(memory: memory_type, z: int) -> Real:
            """The largest of ``k``."""
            k = row3(memory, z + wp.static(STIFFNESS))
            return largest(largest(k.x, k.y), k.z)

        @wp.func
        def energy(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Real:
            """(14e)"""
            way = departure(s, p)
            return d(-0.5) * dot(push(memory, z, way), way)

        return SimpleNamespace(force=force, force_variation=force_variation, spring=spring, energy=energy)

    @classmethod
    def loading(cls, grid: SimpleNamespace) -> SimpleNamespace:
        memory_type, set_vector, section_at = grid.memory_type, grid.set_vector, grid.section_at
        section_vector, RISES = grid.section_vector, cls.rises
        STIFFNESS, STIFFENING = grid.on_stretch("stiffness"), grid.of_direction("stiffening")

        @wp.func
        def bent_at_rest(rods: wp.ref[RodTable], case: wp.ref[Instance]) -> bool:
            """Whether a rod leaves the line straight out of the base, where the medium holds it, though nothing acts."""
            bent = int(0)
            for i in range(rods.precurvature.shape[1]):
                for m in range(rods.precurvature.shape[2]):
                    for c in range(rods.precurvature.shape[3]):
                        if c % 3 < 2 and rods.precurvature[case.rods, i, m, c] != f64(0.0):
                            bent = int(1)
            return bent == 1

        @wp.func
        def scale(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance]) -> f64:
            """Raised with the loads around rods that it bends, as solvers begin at unloaded ones; there around straight ones."""
            whole = case.unit * case.unit / case.force
            factor = call.problem.load_factor[case.index]
            if factor != f64(1.0):  # or nothing depends on how it is bent
                if wp.static(RISES) or bent_at_rest(rods, case):
                    whole *= factor
            return whole

        @wp.func
        def stretch(
            rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, z: int, l: int, s: f64
        ):
            medium = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
            for i in range(rods.end.shape[1]):
                m, present = section_at(rods, call, case, i, s)
                for j in range(3):
                    medium[j] = medium[j] + present * rods.material[case.rods, i, m, wp.static(MEDIUM) + j]
            set_vector(memory, z + wp.static(STIFFNESS), l, scale(rods, call, case) * medium)

        @wp.func
        def direction(call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, g: int, l: int, k: int, unit: f64):
            """No input."""

        @wp.func
        def design(
            rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, g: int, l: int, k: int,
            s: f64, unit: f64,
        ):  # fmt: skip
            change = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
            for i in range(rods.end.shape[1]):
                m, present = section_at(rods, call, case, i, s)
                change += present * section_vector(call, case, i, m, k)
            set_vector(memory, g + wp.static(STIFFENING), l, (scale(rods, call, case) / unit) * change)

        return SimpleNamespace(stretch=stretch, direction=direction, design=design)


class RisingFoundation(Foundation):
    """The same around a rod that begins buckled, as it would without a medium."""

    rises = True
