# mypy: ignore-errors
"""Finite rotations in kernels: rotation vectors and their derivatives. Numbers in parentheses: ``docs/parallel.md``."""

import warp as wp

_SMALL = 1.0e-4  # angle below which the quotients are series, right to rounding


@wp.func
def rotation_from_vector(a: wp.vec3d) -> wp.mat33d:
    """(2) Exp(a): the rotation by |a| about a."""
    one = wp.float64(1.0)
    angle2 = wp.dot(a, a)
    angle = wp.sqrt(angle2)
    s = one - angle2 / wp.float64(6.0)  # sin(angle) / angle
    c = wp.float64(0.5) - angle2 / wp.float64(24.0)  # (1 - cos(angle)) / angle^2
    if angle > wp.float64(wp.static(_SMALL)):
        half = wp.sin(wp.float64(0.5) * angle)
        s = wp.sin(angle) / angle
        c = wp.float64(2.0) * half * half / angle2
    K = wp.skew(a)
    return wp.identity(3, dtype=wp.float64) + s * K + c * (K * K)


@wp.func
def left_jacobian(a: wp.vec3d) -> wp.mat33d:
    """(2) J(a): the rotation vector, in the outer frame, of the change of Exp(a) is J(a) da."""
    angle2 = wp.dot(a, a)
    angle = wp.sqrt(angle2)
    c = wp.float64(0.5) - angle2 / wp.float64(24.0)  # (1 - cos(angle)) / angle^2
    d = wp.float64(1.0) / wp.float64(6.0) - angle2 / wp.float64(120.0)  # (angle - sin(angle)) / angle^3
    if angle > wp.float64(1.0e-2):
        half = wp.sin(wp.float64(0.5) * angle)
        c = wp.float64(2.0) * half * half / angle2
        d = (angle - wp.sin(angle)) / (angle * angle2)
    elif angle > wp.float64(wp.static(_SMALL)):
        half = wp.sin(wp.float64(0.5) * angle)
        c = wp.float64(2.0) * half * half / angle2
        d += angle2 * angle2 / wp.float64(5040.0)
    K = wp.skew(a)
    return wp.identity(3, dtype=wp.float64) + c * K + d * (K * K)


@wp.func
def rotation_vector(Q: wp.mat33d) -> wp.vec3d:
    """(3) Log(Q), of length at most pi; from the largest component of its quaternion, so it is right at any angle."""
    one = wp.float64(1.0)
    half = wp.float64(0.5)
    trace = Q[0, 0] + Q[1, 1] + Q[2, 2]
    v = wp.vec3d(Q[2, 1] - Q[1, 2], Q[0, 2] - Q[2, 0], Q[1, 0] - Q[0, 1])
    w = wp.float64(0.0)
    if trace >= wp.float64(0.0):
        w = half * wp.sqrt(one + trace)
        v = v / (wp.float64(4.0) * w)
    else:
        i = int(0)
        if Q[1, 1] > Q[0, 0]:
            i = int(1)
        if Q[2, 2] > Q[i, i]:
            i = int(2)
        j = (i + 1) % 3
        k = (i + 2) % 3
        big = half * wp.sqrt(one + Q[i, i] - Q[j, j] - Q[k, k])
        w = v[i] / (wp.float64(4.0) * big)
        v[i] = big
        v[j] = (Q[i, j] + Q[j, i]) / (wp.float64(4.0) * big)
        v[k] = (Q[i, k] + Q[k, i]) / (wp.float64(4.0) * big)
    if w < wp.float64(0.0):
        v = -v
        w = -w
    size = wp.length(v)
    if size > wp.float64(1.0e-8):
        return (wp.float64(2.0) * wp.atan2(size, w) / size) * v
    return (wp.float64(2.0) / w) * v


@wp.func
def inverse_right_jacobian(a: wp.vec3d) -> wp.mat33d:
    """(4) Change of Log(Q) = a by the rotation vector, in the inner frame, of the change of Q."""
    angle2 = wp.dot(a, a)
    angle = wp.sqrt(angle2)
    half = wp.float64(0.5)
    c = wp.float64(1.0) / wp.float64(12.0) + angle2 / wp.float64(720.0)
    if angle > wp.float64(1.0e-2):
        c = (wp.float64(1.0) - half * angle * wp.cos(half * angle) / wp.sin(half * angle)) / angle2
    K = wp.skew(a)
    return wp.identity(3, dtype=wp.float64) + half * K + c * (K * K)


@wp.func
def swing(cosine: wp.float64) -> wp.vec2d:
    """(6) f = angle / sin(angle) and df/d(cosine), of the angle whose cosine is given."""
    one = wp.float64(1.0)
    u = one - cosine
    if u < wp.float64(1.0e-3):
        f = one + u * (
            one / wp.float64(3.0) + u * (wp.float64(2.0 / 15.0) + u * (wp.float64(2.0 / 35.0) + u * wp.float64(8.0 / 315.0)))
        )
        slope = -(
            one / wp.float64(3.0) + u * (wp.float64(4.0 / 15.0) + u * (wp.float64(6.0 / 35.0) + u * wp.float64(32.0 / 315.0)))
        )
        return wp.vec2d(f, slope)
    s2 = wp.max(one - cosine * cosine, wp.float64(1.0e-300))
    f = wp.acos(cosine) / wp.sqrt(s2)
    return wp.vec2d(f, (cosine * f - one) / s2)
