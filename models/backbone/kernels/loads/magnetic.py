# mypy: ignore-errors
"""Magnetised rods in a uniform field: the moment per length (3d), their torques (8d), the variations (18d), the energy (14d).

Numbers in parentheses are those of ``docs/model.md``, (D24) that of ``docs/derivatives.md``.
"""

from types import SimpleNamespace

import numpy as np
import warp as wp

from multirod.models.backbone.kernels.layout.arguments import Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.slots import Slot
from multirod.models.backbone.kernels.loads.load import Load
from multirod.models.backbone.kernels.numbers.lanes import add, div, mul, neg, sub  # noqa: F401  (by name)
from multirod.validation import FloatArray

f64 = wp.float64
MAGNETISATION = 10  # where the magnetic moment per length stands in the material


class Magnetic(Load):
    """A uniform field, fixed in the world, that turns each piece of magnetised rods towards itself."""

    moment = by_rod = conservative = True
    input = "magnetic_field"
    of_rod, of_section = "Rod.magnetisation", "magnetisation"

    @classmethod
    def on_stretch(cls, n: int) -> list[Slot]:
        return [Slot("input", 3), Slot("magnetisation", 3 * n, "force")]  # of each rod in its own frame, per tesla

    @classmethod
    def at_place(cls, n: int) -> list[Slot]:
        return [Slot("field", 3), Slot("turned", 3 * n, "force")]  # R^T B, and magnetisation along the axes of rod 1

    @classmethod
    def of_direction(cls, n: int) -> list[Slot]:
        return [*super().of_direction(n), Slot("magnetising", 3 * n, "force")]

    @classmethod
    def size(cls, sizes) -> FloatArray:
        problem = sizes.problem
        table, translation = problem.arrays, problem.read("inputs")[:, problem.input_slice("translation")]
        length = table.end[:, 0, -1] + translation[:, 0]
        return np.asarray(cls.moment_bound(sizes) * length**2 / table.material[:, 0, :, :3].min(axis=(1, 2)))

    @classmethod
    def moment_bound(cls, sizes) -> FloatArray:
        problem = sizes.problem
        strongest = problem.arrays.material[..., MAGNETISATION : MAGNETISATION + 3]
        strongest = np.linalg.norm(strongest, axis=-1).max(axis=2).sum(axis=1)
        field = np.linalg.norm(problem.read("inputs")[:, problem.input_slice(cls.input)], axis=1)
        return np.asarray(problem.each(strongest) * field)

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:
        """Rod 1 has what the sum of all leaves of the torque, as in (7)."""
        Real, Vec3, Frame, memory_type, d = numbers.Real, numbers.Vec3, numbers.Frame, numbers.memory_type, numbers.d
        State, Column, fill, row = numbers.State, numbers.Column, numbers.fill, numbers.row
        part, keep, part_of, keep_in = numbers.part, numbers.keep, numbers.part_of, numbers.keep_in
        row3, put3, zero3, cross, dot, plus = numbers.row3, numbers.put3, numbers.zero3, numbers.cross, numbers.dot, numbers.plus
        rotate, rotate_inverse, layout = numbers.rotate, numbers.rotate_inverse, numbers.layout
        n, TORQUES, DIRECTIONS, DESIGN = layout.n, layout.TORQUES, layout.DIRECTIONS, layout.DESIGN
        FIELD, OWN = numbers.on_stretch("input"), numbers.on_stretch("magnetisation")
        FIELD_AT, TURNED, VARIED = numbers.at_place("field"), numbers.at_place("turned"), numbers.of_direction("input")
        MAGNETISING = numbers.of_direction("magnetising")
        COSINE, SINE = layout.place["cosine"], layout.place["sine"]
        THETA, TAU = layout.state["angles"], layout.state["torques"]

        @wp.func
        def along_first(memory: memory_type, a: int, i: int, own: Vec3) -> Vec3:
            """A vector of rod i along the axes of rod 1."""
            c = row(memory, a + wp.static(COSINE) + i)
            s = row(memory, a + wp.static(SINE) + i)
            return Vec3(c * own.x - s * own.y, s * own.x + c * own.y, own.z)

        @wp.func
        def about_axis(mu: Vec3, turn: Real) -> Vec3:
            """``e3 x mu`` times an angle."""
            return Vec3(-turn * mu.y, turn * mu.x, fill(d(0.0)))

        @wp.func
        def torque_on(mu: Vec3, B: Vec3) -> Real:
            """(8d) ``(mu x B)_z``"""
            return mu.x * B.y - mu.y * B.x

        @wp.func
        def moment(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Vec3:
            """(3d) Of all rods; the angles of the place must stand there already."""
            B = rotate_inverse(frame, row3(memory, z + wp.static(FIELD)))
            put3(memory, a + wp.static(FIELD_AT), B)
            mu = row3(memory, z + wp.static(OWN))
            put3(memory, a + wp.static(TURNED), mu)
            for i in range(1, wp.static(n)):
                own = along_first(memory, a, wp.static(i), row3(memory, z + wp.static(OWN + 3 * i)))
                put3(memory, a + wp.static(TURNED + 3 * i), own)
                mu = plus(mu, own)
            return rotate(frame, cross(mu, B))

        @wp.func
        def torques(memory: memory_type, a: int, f: wp.ref[State]):
            """(8d) What the field takes of tau_i'."""
            B = row3(memory, a + wp.static(FIELD_AT))
            for i in range(1, wp.static(TORQUES + 1)):
                at = wp.static(TAU + i - 1)
                keep(f, at, part(f, at) - torque_on(row3(memory, a + wp.static(TURNED + 3 * i)), B))

        @wp.func
        def energy(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Real:
            """(14d) ``-mu . R^T B`` of all rods, since they stood across the field."""
            B = row3(memory, a + wp.static(FIELD_AT))
            total = fill(d(0.0))
            for i in range(wp.static(n)):
                total = total - dot(row3(memory, a + wp.static(TURNED + 3 * i)), B)
            return total

        @wp.func
        def field_variation(memory: memory_type, a: int, g: int, frame: Frame, dphi: Vec3) -> Vec3:
            """(18d) ``d(R^T B)``"""
            dB = cross(row3(memory, a + wp.static(FIELD_AT)), dphi)
            if wp.static(DIRECTIONS):
                dB = plus(dB, rotate_inverse(frame, row3(memory, g + wp.static(VARIED))))
            return dB

        @wp.func
        def magnetisation_variation(memory: memory_type, a: int, g: int, v: Column, i: int) -> Vec3:
            """(18d), (D24) Of rod i, along the axes of rod 1."""
            change = zero3()
            if wp.static(DESIGN):
                change = row3(memory, g + wp.static(MAGNETISING) + 3 * i)
            if i > 0:
                if wp.static(DESIGN):
                    change = along_first(memory, a, i, change)
                turn = part_of(v, wp.static(THETA - 1) + i)
                change = plus(change, about_axis(row3(memory, a + wp.static(TURNED) + 3 * i), turn))
            return change

        @wp.func
        def moment_variation(
            memory: memory_type, z: int, a: int, g: int, ds: Real, frame: Frame, v: Column, dphi: Vec3, dp: Vec3
        ) -> Vec3:
            """(18d) dl"""
            B = row3(memory, a + wp.static(FIELD_AT))
            dB = field_variation(memory, a, g, frame, dphi)
            mu = zero3()
            dmu = zero3()
            for i in range(wp.static(n)):
                mu = plus(mu, row3(memory, a + wp.static(TURNED + 3 * i)))
                dmu = plus(dmu, magnetisation_variation(memory, a, g, v, wp.static(i)))
            return rotate(frame, plus(cross(dphi, cross(mu, B)), plus(cross(dmu, B), cross(mu, dB))))

        @wp.func
        def torque_variations(memory: memory_type, a: int, g: int, frame: Frame, v: Column, dphi: Vec3, f: wp.ref[Column]):
            """(18d) What the field takes of dtau_i'."""
            B = row3(memory, a + wp.static(FIELD_AT))
            dB = field_variation(memory, a, g, frame, dphi)
            for i in range(1, wp.static(TORQUES + 1)):
                at = wp.static(TAU + i - 1)
                turned = torque_on(magnetisation_variation(memory, a, g, v, wp.static(i)), B)
                keep_in(f, at, part_of(f, at) - turned - torque_on(row3(memory, a + wp.static(TURNED + 3 * i)), dB))

        return SimpleNamespace(
            moment=moment,
            moment_variation=moment_variation,
            torques=torques,
            torque_variations=torque_variations,
            energy=energy,
        )

    @classmethod
    def loading(cls, grid: SimpleNamespace) -> SimpleNamespace:
        memory_type, set_vector = grid.memory_type, grid.set_vector
        section_at, section_vector = grid.section_at, grid.section_vector
        OWN, MAGNETISING = grid.on_stretch("magnetisation"), grid.of_direction("magnetising")
        own_input = super().loading(grid)
        load_input = own_input.stretch

        @wp.func
        def stretch(
            rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, z: int, l: int, s: f64
        ):
            load_input(rods, call, case, memory, z, l, s)
            for i in range(rods.end.shape[1]):
                m, present = section_at(rods, call, case, i, s)
                mu = wp.vec3d()
                for j in range(3):
                    mu[j] = present * rods.material[case.rods, i, m, wp.static(MAGNETISATION) + j] / case.force
                set_vector(memory, z + wp.static(OWN) + 3 * i, l, mu)

        @wp.func
        def design(
            rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, g: int, l: int, k: int,
            s: f64, unit: f64,
        ):  # fmt: skip
            for i in range(rods.end.shape[1]):
                m, present = section_at(rods, call, case, i, s)
                change = (present / (case.force * unit)) * section_vector(call, case, i, m, k)
                set_vector(memory, g + wp.static(MAGNETISING) + 3 * i, l, change)

        return SimpleNamespace(stretch=stretch, direction=own_input.direction, design=design)
