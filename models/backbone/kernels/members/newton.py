# mypy: ignore-errors
"""Newton's method for the strains that a rod and its members share, (5m) of ``docs/model.md``: its matrix, and where it ends."""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)

MOST_ITERATIONS = 20
CLOSE = {wp.float64: 1e-11, wp.float32: 1e-5}  # the last step of Newton's method, over the length or, if larger, the strain
CHANGED = {wp.float64: 1e-12, wp.float32: 1e-6}  # (L19) what the last step may change in the matrix
ROUNDED = {wp.float64: 1e-15, wp.float32: 1e-6}  # what rounding makes of strains where members carry nothing


def make_newton(layout: Layout, W: int, d, members: SimpleNamespace) -> SimpleNamespace:
    """For the members of ``make_members``."""
    L = lanes(W, d)
    Real, fill, absolute, largest, where_less = L.Real, L.fill, L.absolute, L.largest, L.where_less
    m = layout.SOLVED
    system, matrix, vector = L.system(m), L.few(m * m), L.few(m)
    Matrix, keep_entry, Few, one_of = system.type, matrix.keep, vector.type, vector.part
    Response, part_of_response, PLACES = members.Response, members.part_of_response, members.places
    CHANGE = members.change

    @wp.func
    def tangent(c: Few, r: Response) -> Matrix:
        """I + C D."""
        A = Matrix()
        for i in range(wp.static(m)):
            for j in range(wp.static(m)):
                value = one_of(c, i) * part_of_response(r, wp.static(PLACES[i][j]))
                if wp.static(i == j):
                    value = value + d(1.0)
                keep_entry(A, wp.static(i * m + j), value)
        return A

    @wp.func
    def changed(c: Few, r: Response, step: Few) -> Real:
        """(L19) 0 where a step of Newton's method for u changes its matrix so little that it is the last one, else 1."""
        softest = largest(one_of(c, 0), largest(one_of(c, 1), one_of(c, 2)))
        way = absolute(one_of(step, 0)) + absolute(one_of(step, 1)) + absolute(one_of(step, 2))
        most = softest * part_of_response(r, wp.static(CHANGE)) * way
        return where_less(most, fill(d(wp.static(CHANGED[d]))), fill(d(0.0)), fill(d(1.0)))

    @wp.func
    def unsettled(step: Few, q: Few, start: Few, of_u: Real, of_e: Real) -> Real:
        """0 where a step of Newton's method from q is the last one, else 1, also where it is no number; the factors make numbers
        of curvatures and of what else there is."""
        size = fill(d(0.0))
        total = fill(d(0.0))
        enough = fill(d(wp.static(CLOSE[d])))
        for i in range(wp.static(m)):
            scale = of_e
            if wp.static(i < 3):
                scale = of_u
            size = largest(size, scale * absolute(one_of(step, i)))
            noise = d(wp.static(ROUNDED[d])) * absolute(one_of(start, i)) + d(wp.static(CLOSE[d])) * absolute(one_of(q, i))
            enough = enough + scale * noise
            total = total + one_of(step, i)
        return where_less(size + d(0.0) * total, enough, fill(d(0.0)), fill(d(1.0)))

    return SimpleNamespace(
        Matrix=Matrix,
        entry=matrix.part,
        keep_entry=keep_entry,
        read_matrix=matrix.read,
        write_matrix=matrix.write,
        factor=system.factor,
        solve=system.solve,
        tangent=tangent,
        unsettled=unsettled,
        changed=changed if members.bounded else None,
    )
