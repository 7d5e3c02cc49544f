# mypy: ignore-errors
"""Rods in an elastic medium, in lanes: the force per length (3e), its variation (18e), and the energy (14e).

``z`` is where the record of the stretch stands in memory, ``x`` the arclength from its start, ``p`` the position in the frame of
the base and ``g`` where stands what a column's direction varies. Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors


def make_foundation(layout: Layout, W: int, d) -> SimpleNamespace:
    """Functions of the medium: it holds each piece to its place on the line straight out of the base."""
    L, V = lanes(W, d), vectors(W, d)
    Real, row = L.Real, L.row
    Vec3, row3, times, dot = V.Vec3, V.row3, V.times, V.dot
    memory_type = wp.array(dtype=d)
    STIFFNESS, FROM_BASE = layout.stretch["foundation"], layout.stretch["from_base"]
    GIVEN_START, GROWTH, DIRECTIONS = layout.given["start"], layout.given["growth"], layout.DIRECTIONS

    @wp.func
    def departure(memory: memory_type, z: int, x: Real, p: Vec3) -> Vec3:
        """p - s e3"""
        return Vec3(p.x, p.y, p.z - (row(memory, z + wp.static(FROM_BASE)) + x))

    @wp.func
    def foundation_force(memory: memory_type, z: int, x: Real, p: Vec3) -> Vec3:
        """(3e) What holds the rod, the negative of what the medium pushes it by: ``k (p - s e3)``."""
        return times(row3(memory, z + wp.static(STIFFNESS)), departure(memory, z, x, p))

    @wp.func
    def foundation_variation(memory: memory_type, z: int, g: int, x: Real, dp: Vec3) -> Vec3:
        """(18e) Its variation, at a fixed part of the stretch."""
        moved = dp
        if wp.static(DIRECTIONS):
            ds = row(memory, g + wp.static(GIVEN_START)) + x * row(memory, g + wp.static(GROWTH))
            moved = Vec3(dp.x, dp.y, dp.z - ds)
        return times(row3(memory, z + wp.static(STIFFNESS)), moved)

    @wp.func
    def foundation_work(memory: memory_type, z: int, x: Real, p: Vec3) -> Real:
        """(14e) What makes of the internal force's work that of the dead loads, less the energy of the medium, per length."""
        force = foundation_force(memory, z, x, p)
        return dot(force, p) - d(0.5) * dot(force, departure(memory, z, x, p))

    return SimpleNamespace(
        foundation_force=foundation_force, foundation_variation=foundation_variation, foundation_work=foundation_work
    )
