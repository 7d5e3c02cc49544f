# mypy: ignore-errors
"""Where the energy of beams that hold a platform is least: equation (11) of ``docs/parallel.md``."""

import warp as wp

from multirod.models.platform.platform_kernels import hand_over
from multirod.models.rotation_kernels import rotation_from_vector, rotation_vector

f64 = wp.float64
vec6 = wp.types.vector(length=6, dtype=wp.float64)
mat66 = wp.types.matrix(shape=(6, 6), dtype=wp.float64)

ITERATIONS = 8  # 4 are enough for the tip to move by less than 1 % of what the beams are off
SETTLED = 1e-6  # of the longest step, from which on a step of a guess is its last: each is some 1e-2 of the one before
# what is known of a beam, in a row: position and tangent of its tip, arm and frame on the platform, length, stiffness (6 x 6)
TIP_AT, TANGENT_AT, ARM_AT, FRAME_AT, LENGTH_AT, STIFFNESS_AT, BEAM_SIZE = 0, 3, 6, 9, 18, 19, 55


@wp.func
def vector_at(beams: wp.array3d[wp.float64], b: int, leg: int, first: int) -> wp.vec3d:
    return wp.vec3d(beams[b, leg, first], beams[b, leg, first + 1], beams[b, leg, first + 2])


@wp.func
def matrix_at(beams: wp.array3d[wp.float64], b: int, leg: int, first: int) -> wp.mat33d:
    return wp.matrix_from_rows(
        vector_at(beams, b, leg, first), vector_at(beams, b, leg, first + 3), vector_at(beams, b, leg, first + 6)
    )


@wp.func
def solved(matrix: mat66, side: vec6) -> vec6:
    """``matrix^-1 side`` by pivots."""
    A, x = mat66(matrix), vec6(side)
    for k in range(6):
        p = int(k)
        for i in range(k + 1, 6):
            if wp.abs(A[i, k]) > wp.abs(A[p, k]):
                p = i
        for j in range(6):
            swap = A[k, j]
            A[k, j] = A[p, j]
            A[p, j] = swap
        swap = x[k]
        x[k] = x[p]
        x[p] = swap
        for i in range(k + 1, 6):
            factor = A[i, k] / A[k, k]
            for j in range(k, 6):
                A[i, j] = A[i, j] - factor * A[k, j]
            x[i] = x[i] - factor * x[k]
    for m in range(6):
        k = 5 - m
        for j in range(k + 1, 6):
            x[k] = x[k] - A[k, j] * x[j]
        x[k] = x[k] / A[k, k]
    return x


@wp.kernel(enable_backward=False, module=hand_over.module)
def settle_beams(beams: wp.array3d[wp.float64], poses: wp.array2d[wp.float64]):
    """(11) Newton's method from a pose of the platform, position and rotation in a row."""
    b = wp.tid()
    legs = beams.shape[1]
    position = wp.vec3d(poses[b, 0], poses[b, 1], poses[b, 2])
    rotation = wp.matrix_from_rows(
        wp.vec3d(poses[b, 3], poses[b, 4], poses[b, 5]),
        wp.vec3d(poses[b, 6], poses[b, 7], poses[b, 8]),
        wp.vec3d(poses[b, 9], poses[b, 10], poses[b, 11]),
    )
    size = f64(0.0)
    for leg in range(legs):
        size += beams[b, leg, LENGTH_AT]
    size = size / f64(legs)
    iteration = int(0)
    while iteration < ITERATIONS:
        iteration += 1
        gradient = vec6()
        hessian = mat66()
        for leg in range(legs):
            t = vector_at(beams, b, leg, TANGENT_AT)
            L = beams[b, leg, LENGTH_AT]
            arm = rotation * vector_at(beams, b, leg, ARM_AT)
            d = position + arm - vector_at(beams, b, leg, TIP_AT)
            turn = rotation_vector(rotation * matrix_at(beams, b, leg, FRAME_AT))
            slope = wp.cross(turn, t)
            across = d - wp.dot(d, t) * t
            by_across = f64(1.2) / L * across - f64(0.1) * slope
            by_slope = f64(2.0) / f64(15.0) * L * slope - f64(0.1) * across
            # half the integral of the squared slope of the cubic with this end deflection and end slope
            shortening = f64(0.5) * (wp.dot(across, by_across) + wp.dot(slope, by_slope))
            moved = d + shortening * t
            by_move = wp.identity(n=3, dtype=wp.float64) + wp.outer(t, by_across)
            by_turn = wp.outer(t, wp.cross(t, by_slope)) - by_move * wp.skew(arm)
            strain = vec6()
            by_pose = mat66()
            for i in range(3):
                strain[i] = moved[i]
                strain[3 + i] = turn[i]
                by_pose[3 + i, 3 + i] = f64(1.0)
                for j in range(3):
                    by_pose[i, j] = by_move[i, j]
                    by_pose[i, 3 + j] = by_turn[i, j]
            stiffness = mat66()
            for i in range(6):
                for j in range(6):
                    stiffness[i, j] = beams[b, leg, STIFFNESS_AT + 6 * i + j]
            pulled = wp.transpose(by_pose) * stiffness
            gradient += pulled * strain
            hessian += pulled * by_pose
        step = -solved(hessian, gradient)
        share = f64(0.0)
        for i in range(3):
            share = wp.max(share, wp.abs(step[i]) / (f64(0.1) * size))
            share = wp.max(share, wp.abs(step[3 + i]) / f64(0.3))
        step = step / wp.max(f64(1.0), share)
        position += wp.vec3d(step[0], step[1], step[2])
        rotation = rotation_from_vector(wp.vec3d(step[3], step[4], step[5])) * rotation
        if share < f64(SETTLED):
            iteration = ITERATIONS
    for i in range(3):
        poses[b, i] = position[i]
        for j in range(3):
            poses[b, 3 + 3 * i + j] = rotation[i, j]
