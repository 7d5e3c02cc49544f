# mypy: ignore-errors
"""Curvatures and poses at places along a rod, and their columns.

Numbers in parentheses are those of ``docs/estimation.md``, with a D of ``docs/derivatives.md``.
"""

import warp as wp

from multirod.kernels.own_module import own_module

f64 = wp.float64


@wp.func
def pick(found: wp.array4d[wp.float64], t: int, place: int, first: int, column: int) -> wp.vec3d:
    """Three numbers of a column of the state, or of its rate."""
    return wp.vec3d(
        found[t, place, first, column],
        found[t, place, first + 1, column],
        found[t, place, first + 2, column],
    )


@wp.func
def by_inverse(v: wp.vec3d, w: f64, a: wp.vec3d, b: f64) -> wp.vec3d:
    """Of the quaternion ``q = (v, w)``, scalar last, ``2 vec(q^-1 (a, b))``."""
    return (f64(2.0) / (wp.dot(v, v) + w * w)) * (w * a - b * v - wp.cross(v, a))


@own_module(max_unroll=1)
def curvatures(found: wp.array4d[wp.float64], frame: int, size: int, angle: int, bent: wp.array4d[wp.float64]):
    """(14) At each place, ``u`` and its columns beside it, in the frame of a rod.

    Args:
        found: States and, from ``size`` on, their rates at the base and the places, the state after its columns, shape
            (instance, 1 + place, 2 size, column + 1).
        frame: Where the quaternion stands.
        size: Of a state.
        angle: Where the angle of the rod stands against that frame; -1 of the rod whose frame it is.
        bent: Shape (instance, place, 3, 1 + column).
    """
    t = wp.tid()
    last = found.shape[3] - 1
    for p in range(bent.shape[1]):
        v = pick(found, t, p + 1, frame, last)
        w = found[t, p + 1, frame + 3, last]
        u = by_inverse(v, w, pick(found, t, p + 1, size + frame, last), found[t, p + 1, size + frame + 3, last])
        turned = wp.identity(3, dtype=f64)
        if angle >= 0:
            c = wp.cos(found[t, p + 1, angle, last])
            s = wp.sin(found[t, p + 1, angle, last])
            turned = wp.mat33d(c, s, f64(0.0), -s, c, f64(0.0), f64(0.0), f64(0.0), f64(1.0))
        for k in range(1 + last):
            own = u
            if k > 0:
                # of q' = q u / 2
                a = pick(found, t, p + 1, frame, k - 1)
                b = found[t, p + 1, frame + 3, k - 1]
                rate = pick(found, t, p + 1, size + frame, k - 1) - f64(0.5) * (b * u + wp.cross(a, u))
                own = by_inverse(v, w, rate, found[t, p + 1, size + frame + 3, k - 1] + f64(0.5) * wp.dot(a, u))
                if angle >= 0:
                    d_angle = found[t, p + 1, angle, k - 1]
                    own += d_angle * wp.vec3d(u[1], -u[0], f64(0.0))
            own = turned * own
            if angle >= 0:
                column = last
                if k > 0:
                    column = k - 1
                own[2] = own[2] + found[t, p + 1, size + angle, column]
            for i in range(3):
                bent[t, p, i, k] = own[i]


@own_module(max_unroll=1)
def poses(
    found: wp.array4d[wp.float64],
    frame: int,
    position: int,
    angle: int,
    base: wp.array[wp.mat33d],
    lever: wp.array2d[wp.vec3d],
    rotation: wp.array2d[wp.mat33d],
    moved: wp.array4d[wp.float64],
):
    """(D12) At each place, where it is from the base, its frame, and how both vary, in the world.

    Args:
        found: As of ``curvatures``.
        frame: Where the quaternion stands.
        position: Where the position in the frame of the base stands.
        angle: Where the angle of the rod stands against that frame; -1 of the rod whose frame it is.
        base: Frames of the base, one for all or of each instance.
        lever: Shape (instance, place).
        rotation: Shape (instance, place).
        moved: Columns of the position, then of the rotation vector, shape (instance, place, 6, column).
    """
    t = wp.tid()
    last = found.shape[3] - 1
    world = base[wp.min(t, base.shape[0] - 1)]
    for p in range(lever.shape[1]):
        v = pick(found, t, p + 1, frame, last)
        w = found[t, p + 1, frame + 3, last]
        size = wp.sqrt(wp.dot(v, v) + w * w)
        turned = world * wp.quat_to_matrix(wp.quatd(v[0] / size, v[1] / size, v[2] / size, w / size))
        own = wp.identity(3, dtype=f64)
        if angle >= 0:
            c = wp.cos(found[t, p + 1, angle, last])
            s = wp.sin(found[t, p + 1, angle, last])
            own = wp.mat33d(c, -s, f64(0.0), s, c, f64(0.0), f64(0.0), f64(0.0), f64(1.0))
        lever[t, p] = world * pick(found, t, p + 1, position, last)
        rotation[t, p] = turned * own
        for k in range(last):
            shift = world * pick(found, t, p + 1, position, k)
            turn = by_inverse(v, w, pick(found, t, p + 1, frame, k), found[t, p + 1, frame + 3, k])
            if angle >= 0:
                turn[2] = turn[2] + found[t, p + 1, angle, k]
            turn = turned * turn
            for i in range(3):
                moved[t, p, i, k] = shift[i]
                moved[t, p, 3 + i, k] = turn[i]
