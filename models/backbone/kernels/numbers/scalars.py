# mypy: ignore-errors
"""Frames and vectors of one instance, in double precision: what happens at the ends of a backbone and at its nodes.

Numbers in parentheses are those of ``docs/model.md``.
"""

import warp as wp

f64 = wp.float64


@wp.func
def rotate(q: wp.vec4d, a: wp.vec3d) -> wp.vec3d:
    """(2b) ``R(q) a``; orthonormal for any q != 0, so the norm of q may drift."""
    r = wp.vec3d(q[0], q[1], q[2])
    c = wp.cross(r, a)
    return a + (f64(2.0) / wp.dot(q, q)) * (q[3] * c + wp.cross(r, c))


@wp.func
def rotate_inverse(q: wp.vec4d, a: wp.vec3d) -> wp.vec3d:
    """(2b) ``R(q)^T a``."""
    r = wp.vec3d(q[0], q[1], q[2])
    c = wp.cross(r, a)
    return a + (f64(2.0) / wp.dot(q, q)) * (wp.cross(r, c) - q[3] * c)


@wp.func
def rotation_matrix(q: wp.vec4d) -> wp.mat33d:
    """(2b) ``R(q)``."""
    one = f64(1.0)
    zero = f64(0.0)
    return wp.matrix_from_cols(
        rotate(q, wp.vec3d(one, zero, zero)), rotate(q, wp.vec3d(zero, one, zero)), rotate(q, wp.vec3d(zero, zero, one))
    )


@wp.func
def body_rotation(q: wp.vec4d, dq: wp.vec4d) -> wp.vec3d:
    """(15) Body-frame rotation vector of the variation dq: ``2 vec(conj(q) o dq) / |q|^2``."""
    r = wp.vec3d(q[0], q[1], q[2])
    dr = wp.vec3d(dq[0], dq[1], dq[2])
    return (f64(2.0) / wp.dot(q, q)) * (q[3] * dr - dq[3] * r - wp.cross(r, dr))


@wp.func
def axes_rotation(q: wp.vec4d, dq: wp.vec4d) -> wp.vec3d:
    """(15) The same vector along the base's axes: ``2 vec(dq o conj(q)) / |q|^2``."""
    r = wp.vec3d(q[0], q[1], q[2])
    dr = wp.vec3d(dq[0], dq[1], dq[2])
    return (f64(2.0) / wp.dot(q, q)) * (q[3] * dr - dq[3] * r + wp.cross(r, dr))


@wp.func
def turn_base(q: wp.vec4d, angle: f64) -> wp.vec4d:
    """(15) Variation of q for a turn about the body's z axis."""
    half = f64(0.5) * angle
    return wp.vec4d(half * q[1], -half * q[0], half * q[3], -half * q[2])


@wp.func
def turned_about_z(angle: f64) -> wp.mat33d:
    """Rz(angle)."""
    c = wp.cos(angle)
    s = wp.sin(angle)
    zero = f64(0.0)
    return wp.mat33d(c, -s, zero, s, c, zero, zero, zero, f64(1.0))


@wp.func
def total_magnitude(a: wp.vec3d) -> f64:
    """Not finite if a component is not."""
    return wp.abs(a[0]) + wp.abs(a[1]) + wp.abs(a[2])
