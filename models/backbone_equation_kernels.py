# mypy: ignore-errors
"""Equations of the backbone that need no knowledge of the scene; numbers in parentheses: ``docs/model.md``."""

import warp as wp


@wp.func
def rotate(q: wp.vec4d, a: wp.vec3d) -> wp.vec3d:
    """(2b) ``R(q) a``; orthonormal for any q != 0, so the norm of q may drift."""
    r = wp.vec3d(q[0], q[1], q[2])
    c = wp.cross(r, a)
    return a + (wp.float64(2.0) / wp.dot(q, q)) * (q[3] * c + wp.cross(r, c))


@wp.func
def rotate_inverse(q: wp.vec4d, a: wp.vec3d) -> wp.vec3d:
    """(2b) ``R(q)^T a``."""
    r = wp.vec3d(q[0], q[1], q[2])
    c = wp.cross(r, a)
    return a + (wp.float64(2.0) / wp.dot(q, q)) * (wp.cross(r, c) - q[3] * c)


@wp.func
def tangent(q: wp.vec4d) -> wp.vec3d:
    """(1) ``R(q) e3``."""
    s = wp.float64(2.0) / wp.dot(q, q)
    return wp.vec3d(
        s * (q[0] * q[2] + q[3] * q[1]), s * (q[1] * q[2] - q[3] * q[0]), wp.float64(1.0) - s * (q[0] * q[0] + q[1] * q[1])
    )


@wp.func
def rotation_matrix(q: wp.vec4d) -> wp.mat33d:
    """(2b) ``R(q)``."""
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    return wp.matrix_from_cols(
        rotate(q, wp.vec3d(one, zero, zero)), rotate(q, wp.vec3d(zero, one, zero)), rotate(q, wp.vec3d(zero, zero, one))
    )


@wp.func
def quaternion_rate(q: wp.vec4d, u: wp.vec3d) -> wp.vec4d:
    """(2a) ``q' = q o (u, 0) / 2``, scalar last."""
    r = wp.vec3d(q[0], q[1], q[2])
    half = wp.float64(0.5)
    a = half * (q[3] * u + wp.cross(r, u))
    return wp.vec4d(a[0], a[1], a[2], -half * wp.dot(r, u))


@wp.func
def body_rotation(q: wp.vec4d, dq: wp.vec4d) -> wp.vec3d:
    """(15) Body-frame rotation vector of the variation dq: ``2 vec(conj(q) o dq) / |q|^2``."""
    r = wp.vec3d(q[0], q[1], q[2])
    dr = wp.vec3d(dq[0], dq[1], dq[2])
    return (wp.float64(2.0) / wp.dot(q, q)) * (q[3] * dr - dq[3] * r - wp.cross(r, dr))


@wp.func
def turn_base(q: wp.vec4d, angle: wp.float64) -> wp.vec4d:
    """(15) Variation of q for a turn about the body's z axis."""
    half = wp.float64(0.5) * angle
    return wp.vec4d(half * q[1], -half * q[0], half * q[3], -half * q[2])


@wp.func
def moment_rate(M: wp.vec3d, u: wp.vec3d, N: wp.vec3d) -> wp.vec3d:
    """(4) ``M' = M x u + N x e3``; shear and the distributed moment are added by the caller."""
    a = wp.cross(M, u)
    return wp.vec3d(a[0] + N[1], a[1] - N[0], a[2])


@wp.func
def force_rate(N: wp.vec3d, u: wp.vec3d) -> wp.vec3d:
    """(3b) ``N' = N x u``: a dead tip force alone, seen from the turning frame."""
    return wp.cross(N, u)


@wp.func
def moment_rate_variation(M: wp.vec3d, dM: wp.vec3d, u: wp.vec3d, du: wp.vec3d, dN: wp.vec3d) -> wp.vec3d:
    """(18) Variation of (4)."""
    a = wp.cross(dM, u) + wp.cross(M, du)
    return wp.vec3d(a[0] + dN[1], a[1] - dN[0], a[2])


@wp.func
def cosine_and_sine(angle: wp.float64):
    """cos and sin together, to one unit in the last place where |angle| < 1e6, and by the library beyond.

    The library's take a tenth of an integration of three loaded tubes longer, a quarter of unloaded ones. Reduced by multiples
    of pi/2 in two parts, then the minimax polynomials of Sun's fdlibm.
    """
    c = wp.float64(0.0)
    s = wp.float64(0.0)
    if wp.abs(angle) < wp.float64(1.0e6):
        k = wp.floor(angle * wp.float64(0.6366197723675814) + wp.float64(0.5))
        r = (angle - k * wp.float64(1.5707963267341256)) - k * wp.float64(6.077100506506192e-11)
        z = r * r
        p = z * wp.float64(1.58969099521155010221e-10) - wp.float64(2.50507602534068634195e-08)
        p = z * p + wp.float64(2.75573137070700676789e-06)
        p = z * p - wp.float64(1.98412698298579493134e-04)
        p = z * p + wp.float64(8.33333333332248946124e-03)
        p = z * p - wp.float64(1.66666666666666324348e-01)
        sine = r + r * z * p
        p = wp.float64(2.08757232129817482790e-09) - z * wp.float64(1.13596475577881948265e-11)
        p = z * p - wp.float64(2.75573143513906633035e-07)
        p = z * p + wp.float64(2.48015872894767294178e-05)
        p = z * p - wp.float64(1.38888888888741095749e-03)
        p = z * p + wp.float64(4.16666666666666019037e-02)
        cosine = wp.float64(1.0) - wp.float64(0.5) * z + z * z * p
        quadrant = int(k) & 3
        c = wp.where((quadrant & 1) == 0, cosine, sine)
        s = wp.where((quadrant & 1) == 0, sine, cosine)
        c = wp.where(quadrant == 1 or quadrant == 2, -c, c)
        s = wp.where(quadrant >= 2, -s, s)
    else:
        c = wp.cos(angle)
        s = wp.sin(angle)
    return c, s


@wp.func
def turned_about_z(angle: wp.float64) -> wp.mat33d:
    """Rz(angle)."""
    c = wp.cos(angle)
    s = wp.sin(angle)
    zero = wp.float64(0.0)
    return wp.mat33d(c, -s, zero, s, c, zero, zero, zero, wp.float64(1.0))
