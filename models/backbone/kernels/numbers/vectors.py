# mypy: ignore-errors
"""Vectors and frames of numbers in lanes; numbers in parentheses are those of ``docs/model.md``."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)


@cache
def vectors(W: int, d=wp.float64) -> SimpleNamespace:
    """``Vec3``, ``Frame``, and their functions."""
    L = lanes(W, d)
    Real, fill = L.Real, L.fill
    floor, where_less = L.floor, L.where_less
    memory_type = wp.array(dtype=d)
    row, put = L.row, L.put

    @wp.struct
    class Vec3:
        x: Real
        y: Real
        z: Real

    @wp.struct
    class Frame:
        """A rotation by a quaternion of any norm."""

        r: Vec3
        w: Real
        two: Real  # 2 / |q|^2

    @wp.func
    def zero3() -> Vec3:
        return Vec3(fill(d(0.0)), fill(d(0.0)), fill(d(0.0)))

    @wp.func
    def row3(memory: memory_type, at: int) -> Vec3:
        return Vec3(row(memory, at), row(memory, at + 1), row(memory, at + 2))

    @wp.func
    def put3(memory: memory_type, at: int, a: Vec3):
        put(memory, at, a.x)
        put(memory, at + 1, a.y)
        put(memory, at + 2, a.z)

    @wp.func
    def cross(a: Vec3, b: Vec3) -> Vec3:
        return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)

    @wp.func
    def ahead_cross(c: Vec3, a: Vec3, b: Vec3) -> Vec3:
        """c + a x b, each product with its sum in one instruction."""
        return Vec3(c.x + a.y * b.z - a.z * b.y, c.y + a.z * b.x - a.x * b.z, c.z + a.x * b.y - a.y * b.x)

    @wp.func
    def dot(a: Vec3, b: Vec3) -> Real:
        return a.x * b.x + a.y * b.y + a.z * b.z

    @wp.func
    def plus(a: Vec3, b: Vec3) -> Vec3:
        return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)

    @wp.func
    def minus(a: Vec3, b: Vec3) -> Vec3:
        return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)

    @wp.func
    def scaled(h: Real, a: Vec3) -> Vec3:
        return Vec3(h * a.x, h * a.y, h * a.z)

    @wp.func
    def ahead3(a: Vec3, h: Real, b: Vec3) -> Vec3:
        """a + h b"""
        return Vec3(a.x + h * b.x, a.y + h * b.y, a.z + h * b.z)

    @wp.func
    def times(a: Vec3, b: Vec3) -> Vec3:
        """By components."""
        return Vec3(a.x * b.x, a.y * b.y, a.z * b.z)

    @wp.func
    def rotate(f: Frame, a: Vec3) -> Vec3:
        """(2b) ``R a``"""
        c = cross(f.r, a)
        return ahead3(a, f.two, ahead3(cross(f.r, c), f.w, c))

    @wp.func
    def rotate_inverse(f: Frame, a: Vec3) -> Vec3:
        """(2b) ``R^T a``"""
        c = cross(f.r, a)
        return ahead3(a, f.two, ahead3(cross(f.r, c), -f.w, c))

    @wp.func
    def tangent(f: Frame) -> Vec3:
        """(1) ``R e3``"""
        x = f.two * (f.r.x * f.r.z + f.w * f.r.y)
        y = f.two * (f.r.y * f.r.z - f.w * f.r.x)
        return Vec3(x, y, d(1.0) - f.two * (f.r.x * f.r.x + f.r.y * f.r.y))

    @wp.func
    def body_rotation(f: Frame, dr: Vec3, dw: Real) -> Vec3:
        """(15) ``2 vec(conj(q) o dq) / |q|^2``"""
        c = cross(f.r, dr)
        return Vec3(
            f.two * (f.w * dr.x - dw * f.r.x - c.x),
            f.two * (f.w * dr.y - dw * f.r.y - c.y),
            f.two * (f.w * dr.z - dw * f.r.z - c.z),
        )

    if d is wp.float64:

        @wp.func
        def reduced(angle: Real, k: Real) -> Real:
            """The angle less k pi/2, which has two parts: k of the first is exact."""
            return (angle - k * d(1.5707963267341256)) - k * d(6.077100506506192e-11)

        @wp.func
        def sine_of(r: Real, z: Real) -> Real:
            """sin(r) where |r| <= pi/4 and z = r^2: Sun's fdlibm."""
            p = z * d(1.58969099521155010221e-10) - d(2.50507602534068634195e-08)
            p = z * p + d(2.75573137070700676789e-06)
            p = z * p - d(1.98412698298579493134e-04)
            p = z * p + d(8.33333333332248946124e-03)
            p = z * p - d(1.66666666666666324348e-01)
            return r + r * z * p

        @wp.func
        def cosine_of(z: Real) -> Real:
            """cos(r), likewise."""
            p = d(2.08757232129817482790e-09) - z * d(1.13596475577881948265e-11)
            p = z * p - d(2.75573143513906633035e-07)
            p = z * p + d(2.48015872894767294178e-05)
            p = z * p - d(1.38888888888741095749e-03)
            p = z * p + d(4.16666666666666019037e-02)
            return d(1.0) - d(0.5) * z + z * z * p

    else:

        @wp.func
        def reduced(angle: Real, k: Real) -> Real:
            """The angle less k pi/2, which has three parts: k of the first two is exact."""
            r = (angle - k * d(1.5703125)) - k * d(4.837512969970703125e-4)
            return r - k * d(7.54978995489188216e-8)

        @wp.func
        def sine_of(r: Real, z: Real) -> Real:
            """sin(r) where |r| <= pi/4 and z = r^2: Moshier's Cephes, for 24 bits."""
            p = d(8.3321608736e-3) - z * d(1.9515295891e-4)
            p = z * p - d(1.6666654611e-1)
            return r + r * z * p

        @wp.func
        def cosine_of(z: Real) -> Real:
            """cos(r), likewise."""
            p = z * d(2.443315711809948e-5) - d(1.388731625493765e-3)
            p = z * p + d(4.166664568298827e-2)
            return d(1.0) - d(0.5) * z + z * z * p

    @wp.func
    def cosine_and_sine(angle: Real):
        """cos and sin together: reduced by multiples of pi/2, then minimax polynomials; no branch, so lanes stay together."""
        k = floor(angle * d(0.6366197723675814) + d(0.5))
        r = reduced(angle, k)
        z = r * r
        sine = sine_of(r, z)
        cosine = cosine_of(z)
        h = d(0.5) * k
        odd = h - floor(h)  # 0 or 1/2
        h = d(0.5) * floor(h)
        lower = h - floor(h)  # 1/2 in quadrants 2 and 3
        h = d(0.5) * floor(d(0.5) * (k + d(1.0)))
        left = h - floor(h)  # 1/2 in quadrants 1 and 2
        quarter = fill(d(0.25))
        c = where_less(odd, quarter, cosine, sine)
        s = where_less(odd, quarter, sine, cosine)
        return c - d(4.0) * left * c, s - d(4.0) * lower * s

    return SimpleNamespace(
        Vec3=Vec3,
        Frame=Frame,
        zero3=zero3,
        row3=row3,
        put3=put3,
        cross=cross,
        ahead_cross=ahead_cross,
        dot=dot,
        plus=plus,
        minus=minus,
        scaled=scaled,
        ahead3=ahead3,
        times=times,
        rotate=rotate,
        rotate_inverse=rotate_inverse,
        tangent=tangent,
        body_rotation=body_rotation,
        cosine_and_sine=cosine_and_sine,
    )
