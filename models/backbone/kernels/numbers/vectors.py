# mypy: ignore-errors
"""Vectors and frames of numbers in lanes; numbers in parentheses are those of ``docs/model.md``."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.numbers.angles import make_cosine_and_sine
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)


@cache
def vectors(W: int, d=wp.float64) -> SimpleNamespace:
    """``Vec3``, ``Frame``, and their functions."""
    L = lanes(W, d)
    Real, fill = L.Real, L.fill
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
        cosine_and_sine=make_cosine_and_sine(W, d),
    )
