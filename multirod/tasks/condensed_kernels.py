# mypy: ignore-errors
"""A task after its integration, compiled: unknowns eliminated, rows of a pose. Numbers in parentheses: ``docs/tasks.md``."""

import warp as wp

from multirod.kernels.linear_algebra_kernels import eliminate
from multirod.models.rotation_kernels import inverse_right_jacobian, rotation_vector, swing
from multirod.rotations import AIMLESS, BACK, SIDEWAYS

f64 = wp.float64


@wp.struct
class Condensed:
    """What the last integration said, and what is left of it once the unknowns are eliminated; the first axis is the instance."""

    # of the problem
    fault: wp.array[int]
    unknowns: wp.array2d[wp.float64]
    inputs: wp.array2d[wp.float64]
    residual: wp.array2d[wp.float64]
    gamma: wp.array3d[wp.float64]
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    pose_columns: wp.array3d[wp.float64]
    slopes: wp.array3d[wp.float64]  # d(eps)/dp, (instance, n, k or more)
    moved: wp.array3d[wp.float64]  # of the pose, by p, from column ``first`` on
    first: int
    places: wp.array[int]  # of p, in a row of the inputs
    # found
    system: wp.array3d[wp.float64]  # (instance, n, n): room
    shift: wp.array3d[wp.float64]  # (2) a and B beside each other, (instance, n, 1 + k)
    carried: wp.array3d[wp.float64]  # the pose's change with a, and by p where x follows, (instance, 6, 1 + k)
    sign: wp.array[wp.float64]  # of det Gamma


@wp.func(inline=False)
def condense(s: Condensed, t: int):
    """(2), and what it does to the pose."""
    n = s.gamma.shape[1]
    k = s.places.shape[0]
    for i in range(n):
        for j in range(n):
            s.system[t, i, j] = s.gamma[t, i, j]
        s.shift[t, i, 0] = -s.residual[t, i]
        for j in range(k):
            s.shift[t, i, 1 + j] = -s.slopes[t, i, j]
    s.sign[t] = eliminate(s.system, s.shift, t)
    for i in range(6):
        for j in range(1 + k):
            total = f64(0.0)
            if j > 0:
                total = s.moved[t, i, s.first + j - 1]
            for l in range(n):
                total += s.pose_columns[t, i, l] * s.shift[t, l, j]
            s.carried[t, i, j] = total


@wp.func
def place_row(
    s: Condensed,
    r: wp.array2d[wp.float64],
    J: wp.array3d[wp.float64],
    t: int,
    row: int,
    error: f64,
    by: wp.vec3d,
    first: int,
    weight: f64,
):
    """(3) One row, which varies by ``by`` with rows of the pose from ``first`` on."""
    total = error
    for i in range(3):
        total += by[i] * s.carried[t, first + i, 0]
    r[t, row] = weight * total
    for j in range(J.shape[2]):
        total = f64(0.0)
        for i in range(3):
            total += by[i] * s.carried[t, first + i, 1 + j]
        J[t, row, j] = weight * total


@wp.func
def across(axis: wp.vec3d) -> wp.mat33d:
    """Rows: two directions across, and zeros."""
    least = int(0)
    for i in range(1, 3):
        if wp.abs(axis[i]) < wp.abs(axis[least]):
            least = i
    side = wp.vec3d()
    side[least] = f64(1.0)
    first = wp.normalize(wp.cross(axis, side))
    return wp.matrix_from_rows(first, wp.cross(axis, first), wp.vec3d())


@wp.func
def position_count(kind: int) -> int:
    """How many rows a position has: all, across a direction, along it."""
    return wp.where(kind == 0, 0, 4 - kind)


@wp.func
def counted(kind: int, direction: wp.vec3d) -> wp.mat33d:
    """Rows: the directions that a position counts in, across one or along it, and zeros."""
    if kind == 2:
        return across(direction)
    return wp.matrix_from_rows(direction, wp.vec3d(), wp.vec3d())


@wp.func(inline=False)
def position_rows(
    s: Condensed, r: wp.array2d[wp.float64], J: wp.array3d[wp.float64], t: int, row: int, goal: wp.vec3d, weight: f64
):
    """(4)"""
    error = s.position[t] - goal
    for i in range(3):
        by = wp.vec3d()
        by[i] = f64(1.0)
        place_row(s, r, J, t, row + i, error[i], by, 0, weight)


@wp.func(inline=False)
def sighted_rows(
    s: Condensed,
    r: wp.array2d[wp.float64],
    J: wp.array3d[wp.float64],
    t: int,
    row: int,
    goal: wp.vec3d,
    kind: int,
    direction: wp.vec3d,
    weight: f64,
):
    """(4b), (4c)"""
    frame = counted(kind, direction)
    error = frame * (s.position[t] - goal)
    for i in range(position_count(kind)):
        place_row(s, r, J, t, row + i, error[i], wp.vec3d(frame[i, 0], frame[i, 1], frame[i, 2]), 0, weight)


@wp.func(inline=False)
def rotation_rows(
    s: Condensed, r: wp.array2d[wp.float64], J: wp.array3d[wp.float64], t: int, row: int, goal: wp.mat33d, weight: f64
):
    """(5)"""
    turn = rotation_vector(s.rotation[t] * wp.transpose(goal))
    change = inverse_right_jacobian(turn)
    for i in range(3):
        by = wp.vec3d(change[0, i], change[1, i], change[2, i])  # that of the outer frame is its transpose
        place_row(s, r, J, t, row + i, turn[i], by, 3, weight)


@wp.func
def about(turned: wp.vec3d, axis: wp.vec3d) -> wp.vec3d:
    """The direction about which a tangent is turned from the axis, whose product with it is ``turned``."""
    if wp.length(turned) > f64(wp.static(AIMLESS)):
        return wp.normalize(turned)
    frame = across(axis)
    return wp.vec3d(frame[0, 0], frame[0, 1], frame[0, 2])


@wp.func
def tilt(tangent: wp.vec3d, axis: wp.vec3d) -> wp.vec3d:
    """(6) Before it is taken across."""
    cosine = wp.dot(axis, tangent)
    turned = wp.cross(axis, tangent)
    if cosine > f64(wp.static(BACK)):
        return swing(cosine)[0] * turned
    return wp.atan2(wp.length(turned), cosine) * about(turned, axis)


@wp.func(inline=False)
def axis_rows(s: Condensed, r: wp.array2d[wp.float64], J: wp.array3d[wp.float64], t: int, row: int, goal: wp.vec3d, weight: f64):
    """(6)"""
    R = s.rotation[t]
    tangent = wp.vec3d(R[0, 2], R[1, 2], R[2, 2])
    cosine = wp.dot(goal, tangent)
    turned = wp.cross(goal, tangent)
    moved = cosine * wp.identity(3, dtype=f64) - wp.outer(tangent, goal)
    change = wp.mat33d()
    if cosine > f64(wp.static(BACK)):
        found = swing(cosine)
        change = found[0] * moved - found[1] * wp.outer(turned, turned)
    else:
        direction = about(turned, goal)
        quotient = wp.atan2(wp.length(turned), cosine) / wp.max(wp.length(turned), f64(wp.static(SIDEWAYS)))
        change = quotient * moved + (f64(1.0) - quotient * cosine) * wp.outer(direction, direction)
    frame = across(goal)
    error = frame * tilt(tangent, goal)
    by = frame * change
    for i in range(2):
        place_row(s, r, J, t, row + i, error[i], wp.vec3d(by[i, 0], by[i, 1], by[i, 2]), 3, weight)


@wp.func(inline=False)
def place_errors(
    s: Condensed,
    errors: wp.array2d[wp.float64],
    t: int,
    kind: wp.vec3i,
    position: wp.vec3d,
    rotation: wp.mat33d,
    axis: wp.vec3d,
    direction: wp.vec3d,
    weight: wp.vec2d,
):
    """``W (h - y)`` alone, as (4) to (6) have it, of what a target has: a position, all, across a direction or along it, a
    rotation, an axis."""
    row = int(0)
    if kind[0] != 0:
        error = s.position[t] - position
        row = position_count(kind[0])
        if kind[0] > 1:
            error = counted(kind[0], direction) * error
        for i in range(row):
            errors[t, i] = weight[0] * error[i]
    if kind[1] != 0:
        turn = rotation_vector(s.rotation[t] * wp.transpose(rotation))
        for i in range(3):
            errors[t, row + i] = weight[1] * turn[i]
    if kind[2] != 0:
        R = s.rotation[t]
        tilted = across(axis) * tilt(wp.vec3d(R[0, 2], R[1, 2], R[2, 2]), axis)
        for i in range(2):
            errors[t, row + i] = weight[1] * tilted[i]
