# mypy: ignore-errors
"""Loads along a stretch, in lanes: force (3a), moment per length, and their variations.

``z`` is where the record of the stretch stands in memory, ``x`` the arclength from its start, ``g`` where stands what a column's
direction varies. Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors


def make_loads(layout: Layout, W: int, d) -> SimpleNamespace:
    """Functions of the loads that the features name."""
    L, V = lanes(W, d), vectors(W, d)
    Real, fill, row = L.Real, L.fill, L.row
    Vec3, row3, zero3, plus, minus, scaled, ahead3 = V.Vec3, V.row3, V.zero3, V.plus, V.minus, V.scaled, V.ahead3
    memory_type = wp.array(dtype=d)
    s, given = layout.stretch, layout.given
    FORCE, DISTRIBUTED, MOMENT = s["force"], s["distributed_force"], s["distributed_moment"]
    PROFILE_FORCE, PROFILE_MOMENT, CENTRE, SLOPE = (
        s["profile_force"],
        s["profile_moment"],
        s["profile_centre"],
        s["profile_slope"],
    )
    GIVEN_FORCE, GIVEN_DISTRIBUTED, GIVEN_MOMENT = given["force"], given["distributed_force"], given["distributed_moment"]
    GIVEN_PROFILE, GIVEN_START, GROWTH = given["profile"], given["start"], given["growth"]
    TERMS, PROFILE = layout.PROFILE_TERMS, layout.PROFILE
    FORCE_PER_LENGTH, DIRECTIONS = layout.FORCE_PER_LENGTH, layout.DIRECTIONS

    @wp.func
    def coordinate(memory: memory_type, z: int, x: Real) -> Real:
        """-1 to 1 on the piece of the load profiles"""
        return (x - row(memory, z + wp.static(CENTRE))) * row(memory, z + wp.static(SLOPE))

    @wp.func
    def profile(memory: memory_type, z: int, first: int, x: Real) -> Vec3:
        """A load profile, per length."""
        t = coordinate(memory, z, x)
        a = zero3()
        for k in range(wp.static(TERMS)):
            a = ahead3(row3(memory, z + first + wp.static(3 * (TERMS - 1 - k))), t, a)
        return a

    @wp.func
    def profile_derivative(memory: memory_type, z: int, first: int, x: Real) -> Vec3:
        """Its derivative by s."""
        t = coordinate(memory, z, x)
        a = zero3()
        for k in range(wp.static(TERMS - 1)):
            j = wp.static(TERMS - 1) - k
            a = ahead3(scaled(fill(d(j)), row3(memory, z + first + wp.static(3 * (TERMS - 1 - k)))), t, a)
        return scaled(row(memory, z + wp.static(SLOPE)), a)

    @wp.func
    def profile_integral(memory: memory_type, z: int, x: Real) -> Vec3:
        """Integral of the force profile from the start of the stretch to x."""
        t0 = coordinate(memory, z, fill(d(0.0)))
        t1 = coordinate(memory, z, x)
        a = zero3()
        b = zero3()
        for k in range(wp.static(TERMS)):
            j = wp.static(TERMS - 1) - k
            c = scaled(fill(d(1.0) / d(j + 1)), row3(memory, z + wp.static(PROFILE_FORCE + 3 * (TERMS - 1 - k))))
            a = ahead3(c, t1, a)
            b = ahead3(c, t0, b)
        return scaled(d(1.0) / row(memory, z + wp.static(SLOPE)), minus(scaled(t1, a), scaled(t0, b)))

    @wp.func
    def distributed_force(memory: memory_type, z: int, x: Real) -> Vec3:
        """f, the force per length."""
        f = row3(memory, z + wp.static(DISTRIBUTED))
        if wp.static(PROFILE):
            f = plus(f, profile(memory, z, wp.static(PROFILE_FORCE), x))
        return f

    @wp.func
    def world_force(memory: memory_type, z: int, x: Real) -> Vec3:
        """(3a) n: that at the start of the stretch less what is distributed from there to x."""
        n = row3(memory, z + wp.static(FORCE))
        if wp.static(FORCE_PER_LENGTH):
            n = ahead3(n, -x, row3(memory, z + wp.static(DISTRIBUTED)))
        if wp.static(PROFILE):
            n = minus(n, profile_integral(memory, z, x))
        return n

    @wp.func
    def distributed_moment(memory: memory_type, z: int, x: Real) -> Vec3:
        """l, the moment per length."""
        l = row3(memory, z + wp.static(MOMENT))
        if wp.static(PROFILE):
            l = plus(l, profile(memory, z, wp.static(PROFILE_MOMENT), x))
        return l

    @wp.func
    def arclength_variation(memory: memory_type, g: int, x: Real) -> Real:
        """Change of s for a direction, at a fixed part of the stretch."""
        return row(memory, g + wp.static(GIVEN_START)) + x * row(memory, g + wp.static(GROWTH))

    @wp.func
    def force_variation(memory: memory_type, z: int, g: int, x: Real) -> Vec3:
        """(3a) Variation of n, at a fixed part of the stretch."""
        dn = row3(memory, g + wp.static(GIVEN_FORCE))
        if wp.static(DIRECTIONS):
            dn = ahead3(dn, -x, row3(memory, g + wp.static(GIVEN_DISTRIBUTED)))
            if wp.static(FORCE_PER_LENGTH):
                dn = ahead3(dn, -arclength_variation(memory, g, x), distributed_force(memory, z, x))
                dn = ahead3(dn, row(memory, g + wp.static(GIVEN_START)), distributed_force(memory, z, fill(d(0.0))))
            if wp.static(PROFILE):
                dn = ahead3(dn, -row(memory, g + wp.static(GIVEN_PROFILE)), profile_integral(memory, z, x))
        return dn

    @wp.func
    def moment_variation(memory: memory_type, z: int, g: int, x: Real) -> Vec3:
        """Variation of l, at a fixed part of the stretch."""
        dl = row3(memory, g + wp.static(GIVEN_MOMENT))
        if wp.static(PROFILE):
            dl = ahead3(dl, row(memory, g + wp.static(GIVEN_PROFILE)), profile(memory, z, wp.static(PROFILE_MOMENT), x))
            slope = profile_derivative(memory, z, wp.static(PROFILE_MOMENT), x)
            dl = ahead3(dl, arclength_variation(memory, g, x), slope)
        return dl

    @wp.func
    def distributed_force_variation(memory: memory_type, z: int, g: int, x: Real) -> Vec3:
        """Variation of f, at a fixed part of the stretch."""
        df = row3(memory, g + wp.static(GIVEN_DISTRIBUTED))
        if wp.static(PROFILE):
            df = ahead3(df, row(memory, g + wp.static(GIVEN_PROFILE)), profile(memory, z, wp.static(PROFILE_FORCE), x))
            slope = profile_derivative(memory, z, wp.static(PROFILE_FORCE), x)
            df = ahead3(df, arclength_variation(memory, g, x), slope)
        return df

    return SimpleNamespace(
        distributed_force=distributed_force,
        distributed_force_variation=distributed_force_variation,
        world_force=world_force,
        distributed_moment=distributed_moment,
        force_variation=force_variation,
        moment_variation=moment_variation,
    )
