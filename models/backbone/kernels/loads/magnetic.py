# mypy: ignore-errors
"""Magnetised rods in a uniform field, in lanes: the moment per length (3d), their torques (8d), and the variations (18d).

``z`` is where the record of the stretch stands in memory, ``a`` that of the place, ``b`` the state, ``v`` a column of it and
``g`` where stands what its direction varies. Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors


def make_magnetic(layout: Layout, W: int, d) -> SimpleNamespace:
    """Functions of what a field does to the rods; rod 1 has what their sum leaves of the torque, as in (7)."""
    L, V = lanes(W, d), vectors(W, d)
    Real, row, fill = L.Real, L.row, L.fill
    Vec3, Frame, row3, put3, zero3 = V.Vec3, V.Frame, V.row3, V.put3, V.zero3
    cross, dot, plus, rotate, rotate_inverse = V.cross, V.dot, V.plus, V.rotate, V.rotate_inverse
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    part, keep, part_of, keep_in = state.part, state.keep, column.part, column.keep
    n, TORQUES = layout.n, layout.TORQUES
    FIELD, MAGNETISATION = layout.stretch["field"], layout.stretch["magnetisation"]
    FIELD_AT, TURNED = layout.place["field"], layout.place["turned_magnetisation"]
    COSINE, SINE, GIVEN_FIELD = layout.place["cosine"], layout.place["sine"], layout.given["field"]
    THETA, TAU = layout.state["angles"], layout.state["torques"]
    DIRECTIONS = layout.DIRECTIONS

    @wp.func
    def about_axis(mu: Vec3, turn: Real) -> Vec3:
        """``e3 x mu`` times an angle."""
        return Vec3(-turn * mu.y, turn * mu.x, fill(d(0.0)))

    @wp.func
    def torque_on(mu: Vec3, B: Vec3) -> Real:
        """(8d) ``(mu x B)_z``"""
        return mu.x * B.y - mu.y * B.x

    @wp.func
    def magnetic_moment(memory: memory_type, z: int, a: int, frame: Frame) -> Vec3:
        """(3d) Moment per length of all rods, along the axes of the base; the angles of the place must stand there already."""
        B = rotate_inverse(frame, row3(memory, z + wp.static(FIELD)))
        put3(memory, a + wp.static(FIELD_AT), B)
        mu = row3(memory, z + wp.static(MAGNETISATION))
        put3(memory, a + wp.static(TURNED), mu)
        for i in range(1, wp.static(n)):
            own = row3(memory, z + wp.static(MAGNETISATION + 3 * i))
            c = row(memory, a + wp.static(COSINE + i))
            s = row(memory, a + wp.static(SINE + i))
            own = Vec3(c * own.x - s * own.y, s * own.x + c * own.y, own.z)
            put3(memory, a + wp.static(TURNED + 3 * i), own)
            mu = plus(mu, own)
        return rotate(frame, cross(mu, B))

    @wp.func
    def magnetic_torques(memory: memory_type, a: int, f: wp.ref[State]):
        """(8d) What the field takes of tau_i'."""
        B = row3(memory, a + wp.static(FIELD_AT))
        for i in range(1, wp.static(TORQUES + 1)):
            at = wp.static(TAU + i - 1)
            keep(f, at, part(f, at) - torque_on(row3(memory, a + wp.static(TURNED + 3 * i)), B))

    @wp.func
    def magnetic_work(memory: memory_type, a: int) -> Real:
        """(14d) ``mu . R^T B`` of all rods: the work of the field, per length, since the rods stood across it."""
        B = row3(memory, a + wp.static(FIELD_AT))
        work = fill(d(0.0))
        for i in range(wp.static(n)):
            work = work + dot(row3(memory, a + wp.static(TURNED + 3 * i)), B)
        return work

    @wp.func
    def field_variation(memory: memory_type, a: int, g: int, frame: Frame, dphi: Vec3) -> Vec3:
        """(18d) ``d(R^T B)``"""
        dB = cross(row3(memory, a + wp.static(FIELD_AT)), dphi)
        if wp.static(DIRECTIONS):
            dB = plus(dB, rotate_inverse(frame, row3(memory, g + wp.static(GIVEN_FIELD))))
        return dB

    @wp.func
    def magnetic_moment_variation(memory: memory_type, a: int, frame: Frame, v: Column, dphi: Vec3, dB: Vec3) -> Vec3:
        """(18d) dl, along the axes of the base."""
        B = row3(memory, a + wp.static(FIELD_AT))
        mu = zero3()
        dmu = zero3()
        for i in range(wp.static(n)):
            own = row3(memory, a + wp.static(TURNED + 3 * i))
            mu = plus(mu, own)
            if wp.static(i > 0):
                dmu = plus(dmu, about_axis(own, part_of(v, wp.static(THETA + i - 1))))
        return rotate(frame, plus(cross(dphi, cross(mu, B)), plus(cross(dmu, B), cross(mu, dB))))

    @wp.func
    def magnetic_torque_variations(memory: memory_type, a: int, v: Column, dB: Vec3, f: wp.ref[Column]):
        """(18d) What the field takes of dtau_i'."""
        B = row3(memory, a + wp.static(FIELD_AT))
        for i in range(1, wp.static(TORQUES + 1)):
            at = wp.static(TAU + i - 1)
            mu = row3(memory, a + wp.static(TURNED + 3 * i))
            turned = torque_on(about_axis(mu, part_of(v, wp.static(THETA + i - 1))), B)
            keep_in(f, at, part_of(f, at) - turned - torque_on(mu, dB))

    return SimpleNamespace(
        magnetic_moment=magnetic_moment,
        magnetic_torques=magnetic_torques,
        magnetic_work=magnetic_work,
        field_variation=field_variation,
        magnetic_moment_variation=magnetic_moment_variation,
        magnetic_torque_variations=magnetic_torque_variations,
    )
