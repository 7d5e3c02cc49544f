# mypy: ignore-errors
"""What members answer to strains: the first and second derivatives of their energy."""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors


def place_of(i: int, j: int, m: int) -> int:
    """Where the second derivative by strains i <= j of m stands in a response, after the first ones."""
    return m + i * m - i * (i - 1) // 2 + j - i


def make_response(W: int, d, m: int) -> SimpleNamespace:
    """What members answer to m strains, u or u and e = v - e3: first and second derivatives of their energy, and how much the
    second ones change at most with u, (L19) of ``docs/lines.md``."""
    L, V = lanes(W, d), vectors(W, d)
    Real, Vec3 = L.Real, V.Vec3
    CHANGE = place_of(m - 1, m - 1, m) + 1
    numbers = L.few(CHANGE + 1)
    Response, part, keep = numbers.type, numbers.part, numbers.keep
    PLACES = tuple(tuple(place_of(min(i, j), max(i, j), m) for j in range(m)) for i in range(m))
    FORCES = m > 3

    @wp.func
    def add_moment(r: wp.ref[Response], a: Vec3):
        keep(r, 0, part(r, 0) + a.x)
        keep(r, 1, part(r, 1) + a.y)
        keep(r, 2, part(r, 2) + a.z)

    @wp.func
    def add_force(r: wp.ref[Response], a: Vec3):
        if wp.static(FORCES):
            keep(r, 3, part(r, 3) + a.x)
            keep(r, 4, part(r, 4) + a.y)
            keep(r, 5, part(r, 5) + a.z)

    @wp.func
    def add_stiffness(r: wp.ref[Response], i: int, j: int, a: Real):
        if j < wp.static(m):
            k = wp.static(m) + i * wp.static(m) - (i * (i - 1)) // 2 + j - i
            keep(r, k, part(r, k) + a)

    @wp.func
    def add_change(r: wp.ref[Response], a: Real):
        keep(r, wp.static(CHANGE), part(r, wp.static(CHANGE)) + a)

    return SimpleNamespace(
        Response=Response,
        part=part,
        change=CHANGE,
        add_change=add_change,
        add_moment=add_moment,
        add_force=add_force,
        add_stiffness=add_stiffness,
        places=PLACES,
    )
