# mypy: ignore-errors
"""The precurvature of rods along a stretch, in lanes, (6), its slope, and its variation where a rod moves along itself.

``z`` is where the record of the stretch stands in memory, ``x`` the arclength from its start and ``g`` where stands what a
column's direction varies. Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors


def make_precurvature(layout: Layout, W: int, d) -> SimpleNamespace:
    """(6) u* of each rod, by Horner's rule, and its slope."""
    L, V = lanes(W, d), vectors(W, d)
    Real, fill, row = L.Real, L.fill, L.row
    Vec3, row3, ahead3, zero3, scaled = V.Vec3, V.row3, V.ahead3, V.zero3, V.scaled
    memory_type = wp.array(dtype=d)
    TERMS, VARIED = layout.CURVATURE_TERMS, layout.VARIED
    CURVE = layout.stretch["precurvature"]
    CENTRE, SLOPE = layout.stretch["centre"], layout.stretch["slope"]
    GIVEN_START, GROWTH, SHIFT = layout.given["start"], layout.given["growth"], layout.given["shift"]

    @wp.func
    def precurvature(memory: memory_type, z: int, i: int, x: Real) -> Vec3:
        first = z + wp.static(CURVE) + i * wp.static(3 * TERMS)
        if wp.static(VARIED):
            t = (x - row(memory, z + wp.static(CENTRE) + i)) * row(memory, z + wp.static(SLOPE) + i)
            u = row3(memory, first + wp.static(3 * (TERMS - 1)))
            for k in range(wp.static(TERMS - 1)):
                u = ahead3(row3(memory, first + wp.static(3 * (TERMS - 2 - k))), t, u)
            return u
        return row3(memory, first)

    @wp.func
    def precurvature_slope(memory: memory_type, z: int, i: int, x: Real) -> Vec3:
        """d(u*)/ds"""
        first = z + wp.static(CURVE) + i * wp.static(3 * TERMS)
        slope = row(memory, z + wp.static(SLOPE) + i)
        t = (x - row(memory, z + wp.static(CENTRE) + i)) * slope
        u = zero3()
        for k in range(wp.static(TERMS - 1)):
            m = wp.static(TERMS - 1) - k
            u = ahead3(scaled(fill(d(m)), row3(memory, first + wp.static(3 * (TERMS - 1 - k)))), t, u)
        return scaled(slope, u)

    @wp.func
    def precurvature_variation(memory: memory_type, z: int, i: int, x: Real, g: int) -> Vec3:
        """Variation of u* for a direction, at a fixed part of the stretch: the rod moves along itself."""
        moved = (
            row(memory, g + wp.static(GIVEN_START))
            + x * row(memory, g + wp.static(GROWTH))
            - row(memory, g + wp.static(SHIFT) + i)
        )
        return scaled(moved, precurvature_slope(memory, z, i, x))

    return SimpleNamespace(
        precurvature=precurvature, precurvature_slope=precurvature_slope, precurvature_variation=precurvature_variation
    )
