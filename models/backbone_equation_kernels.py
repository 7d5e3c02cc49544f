# mypy: ignore-errors
"""Equations of the backbone that need no knowledge of the scene; numbers in parentheses: ``docs/model.md``."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_layout_kernels import VECTORS


@cache
def make_equation_functions(real=wp.float64) -> SimpleNamespace:
    """The equations in one scalar type."""
    vec3, vec4, mat33 = VECTORS[real]

    @wp.func
    def rotate(q: vec4, a: vec3) -> vec3:
        """(2b) ``R(q) a``; orthonormal for any q != 0, so the norm of q may drift."""
        r = vec3(q[0], q[1], q[2])
        c = wp.cross(r, a)
        return a + (real(2.0) / wp.dot(q, q)) * (q[3] * c + wp.cross(r, c))

    @wp.func
    def rotate_inverse(q: vec4, a: vec3) -> vec3:
        """(2b) ``R(q)^T a``."""
        r = vec3(q[0], q[1], q[2])
        c = wp.cross(r, a)
        return a + (real(2.0) / wp.dot(q, q)) * (wp.cross(r, c) - q[3] * c)

    @wp.func
    def tangent(q: vec4) -> vec3:
        """(1) ``R(q) e3``."""
        s = real(2.0) / wp.dot(q, q)
        return vec3(s * (q[0] * q[2] + q[3] * q[1]), s * (q[1] * q[2] - q[3] * q[0]), real(1.0) - s * (q[0] * q[0] + q[1] * q[1]))

    @wp.func
    def rotation_matrix(q: vec4) -> mat33:
        """(2b) ``R(q)``."""
        one = real(1.0)
        zero = real(0.0)
        return wp.matrix_from_cols(
            rotate(q, vec3(one, zero, zero)), rotate(q, vec3(zero, one, zero)), rotate(q, vec3(zero, zero, one))
        )

    @wp.func
    def quaternion_rate(q: vec4, u: vec3) -> vec4:
        """(2a) ``q' = q o (u, 0) / 2``, scalar last."""
        r = vec3(q[0], q[1], q[2])
        half = real(0.5)
        a = half * (q[3] * u + wp.cross(r, u))
        return vec4(a[0], a[1], a[2], -half * wp.dot(r, u))

    @wp.func
    def body_rotation(q: vec4, dq: vec4) -> vec3:
        """(15) Body-frame rotation vector of the variation dq: ``2 vec(conj(q) o dq) / |q|^2``."""
        r = vec3(q[0], q[1], q[2])
        dr = vec3(dq[0], dq[1], dq[2])
        return (real(2.0) / wp.dot(q, q)) * (q[3] * dr - dq[3] * r - wp.cross(r, dr))

    @wp.func
    def turn_base(q: vec4, angle: real) -> vec4:
        """(15) Variation of q for a turn about the body's z axis."""
        half = real(0.5) * angle
        return vec4(half * q[1], -half * q[0], half * q[3], -half * q[2])

    @wp.func
    def moment_rate(M: vec3, u: vec3, N: vec3) -> vec3:
        """(4) ``M' = M x u + N x e3``; shear and the distributed moment are added by the caller."""
        a = wp.cross(M, u)
        return vec3(a[0] + N[1], a[1] - N[0], a[2])

    @wp.func
    def force_rate(N: vec3, u: vec3) -> vec3:
        """(3b) ``N' = N x u``: a dead tip force alone, seen from the turning frame."""
        return wp.cross(N, u)

    @wp.func
    def moment_rate_variation(M: vec3, dM: vec3, u: vec3, du: vec3, dN: vec3) -> vec3:
        """(18) Variation of (4)."""
        a = wp.cross(dM, u) + wp.cross(M, du)
        return vec3(a[0] + dN[1], a[1] - dN[0], a[2])

    if real is wp.float64:

        @wp.func
        def reduced(angle: real, k: real) -> real:
            """The angle less k pi/2, which has two parts: k of the first is exact."""
            return (angle - k * real(1.5707963267341256)) - k * real(6.077100506506192e-11)

        @wp.func
        def sine_of(r: real, z: real) -> real:
            """sin(r) where |r| <= pi/4 and z = r^2: Sun's fdlibm."""
            p = z * real(1.58969099521155010221e-10) - real(2.50507602534068634195e-08)
            p = z * p + real(2.75573137070700676789e-06)
            p = z * p - real(1.98412698298579493134e-04)
            p = z * p + real(8.33333333332248946124e-03)
            p = z * p - real(1.66666666666666324348e-01)
            return r + r * z * p

        @wp.func
        def cosine_of(z: real) -> real:
            """cos(r), likewise."""
            p = real(2.08757232129817482790e-09) - z * real(1.13596475577881948265e-11)
            p = z * p - real(2.75573143513906633035e-07)
            p = z * p + real(2.48015872894767294178e-05)
            p = z * p - real(1.38888888888741095749e-03)
            p = z * p + real(4.16666666666666019037e-02)
            return real(1.0) - real(0.5) * z + z * z * p

    else:

        @wp.func
        def reduced(angle: real, k: real) -> real:
            """The angle less k pi/2, which has three parts: k of the first two is exact."""
            r = (angle - k * real(1.5703125)) - k * real(4.837512969970703125e-4)
            return r - k * real(7.54978995489188216e-8)

        @wp.func
        def sine_of(r: real, z: real) -> real:
            """sin(r) where |r| <= pi/4 and z = r^2: Moshier's Cephes, for 24 bits."""
            p = real(8.3321608736e-3) - z * real(1.9515295891e-4)
            p = z * p - real(1.6666654611e-1)
            return r + r * z * p

        @wp.func
        def cosine_of(z: real) -> real:
            """cos(r), likewise."""
            p = z * real(2.443315711809948e-5) - real(1.388731625493765e-3)
            p = z * p + real(4.166664568298827e-2)
            return real(1.0) - real(0.5) * z + z * z * p

    LARGEST_ANGLE = 1.0e6 if real is wp.float64 else 1.0e4

    @wp.func
    def cosine_and_sine(angle: real):
        """cos and sin together, to one unit in the last place where the angle is not huge, and by the library beyond.

        The library's take a tenth of an integration of three loaded tubes longer, a quarter of unloaded ones. Reduced by multiples
        of pi/2, then minimax polynomials.
        """
        c = real(0.0)
        s = real(0.0)
        if wp.abs(angle) < real(LARGEST_ANGLE):
            k = wp.floor(angle * real(0.6366197723675814) + real(0.5))
            r = reduced(angle, k)
            z = r * r
            sine = sine_of(r, z)
            cosine = cosine_of(z)
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
    def turned_about_z(angle: real) -> mat33:
        """Rz(angle)."""
        c = wp.cos(angle)
        s = wp.sin(angle)
        zero = real(0.0)
        return mat33(c, -s, zero, s, c, zero, zero, zero, real(1.0))

    return SimpleNamespace(
        rotate=rotate,
        rotate_inverse=rotate_inverse,
        tangent=tangent,
        rotation_matrix=rotation_matrix,
        quaternion_rate=quaternion_rate,
        body_rotation=body_rotation,
        turn_base=turn_base,
        moment_rate=moment_rate,
        force_rate=force_rate,
        moment_rate_variation=moment_rate_variation,
        cosine_and_sine=cosine_and_sine,
        turned_about_z=turned_about_z,
    )
