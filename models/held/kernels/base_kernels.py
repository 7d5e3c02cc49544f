# mypy: ignore-errors
"""The base of a held rod, which may turn in a joint: unknowns and inputs to the rod, and its columns by these unknowns.

Numbers in parentheses are those of ``docs/held.md``.
"""

import warp as wp

from multirod.kernels.own_module import own_module
from multirod.models.held.kernels.arguments import ALONG, BESIDE, FIELD, FORCE, LED_ON, ON_AXIS, TORQUE, WEIGHT, Held
from multirod.models.joint_kernels import vector
from multirod.models.rotation_kernels import left_jacobian, rotation_from_vector

f64 = wp.float64


@wp.func
def turn_of(held: Held, b: int) -> wp.vec3d:
    """(8) Rotation vector by which the base is turned in its joint, in the frame of its holder."""
    a = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
    for j in range(held.turns):
        a += (held.length[b] * held.problem.unknowns[b, held.rod_unknowns + j]) * held.base_axes[j]
    return a


@wp.func
def turn_axis(held: Held, b: int, j: int) -> wp.vec3d:
    """(8) Rotation vector of the rod by unknown j of its base's joint, in the world."""
    return held.length[b] * (held.base_frame[b] * (left_jacobian(turn_of(held, b)) * held.base_axes[j]))


@wp.func
def on_axis(held: Held, b: int) -> bool:
    """(10) Whether the end is to be held on the axis of the base and along it."""
    axis = held.base_frame[b] * wp.vec3d(f64(0.0), f64(0.0), f64(1.0))
    away = held.end_position[b] + vector(held.problem.inputs, b, held.pose) - held.base_position[b]
    frame = rotation_from_vector(vector(held.problem.inputs, b, held.pose + 3)) * held.end_frame[b]
    tangent = wp.vec3d(frame[0, 2], frame[1, 2], frame[2, 2])
    off = wp.max(wp.length(wp.cross(axis, away)) / held.length[b], wp.length(wp.cross(axis, tangent)))
    return off < f64(wp.static(ON_AXIS))


@wp.func
def acts(held: Held, b: int, place: int, kind: int) -> bool:
    """Whether a load is more than none, (24)."""
    return wp.length(vector(held.problem.inputs, b, place)) > held.least[b, kind]


@wp.func
def lies_along(v: wp.vec3d, axis: wp.vec3d) -> bool:
    return wp.length(wp.cross(v, axis)) <= f64(wp.static(ON_AXIS)) * wp.length(v) * wp.length(axis)


@wp.func
def acts_across(held: Held, b: int) -> bool:
    """(24) Whether any load along the rod tells directions across the axis of the base apart: not forces along that."""
    axis = held.base_frame[b] * wp.vec3d(f64(0.0), f64(0.0), f64(1.0))
    pushed = acts(held, b, held.along + wp.static(FORCE), 1)
    heavy = acts(held, b, held.along + wp.static(WEIGHT), 3)
    drawn = pushed and not lies_along(vector(held.problem.inputs, b, held.along + wp.static(FORCE)), axis)
    drawn = drawn or (heavy and not lies_along(vector(held.problem.inputs, b, held.along + wp.static(WEIGHT)), axis))
    return drawn or acts(held, b, held.along + wp.static(TORQUE), 2) or acts(held, b, held.along + wp.static(FIELD), 4)


@wp.func
def leading(held: Held, b: int) -> f64:
    """(28) The spring that holds on the way what loads are to tell."""
    return wp.max(f64(1.0) - held.problem.load_factor[b], f64(0.0)) * held.leading[b]


@wp.func
def drawn_or(held: Held, b: int, other: wp.vec3d) -> wp.vec3d:
    """(31) Where loads draw the rod on the way, in the frame of the base."""
    return wp.where(wp.length(held.drawn[b]) > f64(0.0) and acts_across(held, b), held.drawn[b], other)


@wp.func
def is_neutral(held: Held, b: int) -> bool:
    """(10) The same of a rod that is alike about it, and on which nothing acts along it, or along this axis alone."""
    return held.alike[b] != 0 and on_axis(held, b) and not acts_across(held, b)


@wp.func
def weight_of_phase(held: Held, b: int) -> f64:
    """(11), (31), (32) How the turn about the base's axis is held."""
    if held.beside[b] == wp.static(LED_ON):
        return f64(1.0)
    if held.beside[b] == wp.static(BESIDE):
        return wp.max(f64(1.0) - held.problem.load_factor[b], f64(0.0))
    if held.alike[b] == 0 or not on_axis(held, b):
        return f64(0.0)
    return wp.where(acts_across(held, b), leading(held, b), f64(1.0))


@wp.func
def base_moment(held: Held, b: int) -> wp.vec3d:
    """(6) Moment at the base, in the frame of the base."""
    return held.stiffness[b] * vector(held.problem.unknowns, b, 0)


@wp.func
def base_turn(held: Held, b: int) -> wp.vec2d:
    """Cosine and sine of the angle of the rod at its base."""
    angle = held.problem.load_factor[b] * held.problem.inputs[b, 0]
    return wp.vec2d(wp.cos(angle), wp.sin(angle))


@wp.func
def turned_back(held: Held, b: int, v: wp.vec3d) -> wp.vec3d:
    """From the frame of the base to that of the rod there."""
    turn = base_turn(held, b)
    return wp.vec3d(turn[0] * v[0] + turn[1] * v[1], turn[0] * v[1] - turn[1] * v[0], v[2])


@own_module()
def hand_over(held: Held):
    """Unknowns, inputs and directions to the rod, and its base as it is turned."""
    b = held.problem.order[wp.tid()]
    held.rod.active[b] = held.problem.active[b]
    if held.problem.active[b] == 0:
        return
    held.neutral[b] = int(is_neutral(held, b))
    path = held.problem.load_factor[b]
    held.rod.load_factor[b] = path
    for i in range(3, held.rod_unknowns - 3):
        held.rod.unknowns[b, i] = held.problem.unknowns[b, i]
    # (6) the rod's own turn with it
    M = turned_back(held, b, base_moment(held, b))
    N = turned_back(held, b, vector(held.problem.unknowns, b, held.rod_unknowns - 3))
    for j in range(3):
        held.rod.unknowns[b, j] = held.base_curvature[b][j] + held.moment_unit[b][j] * M[j]
        held.rod.unknowns[b, held.rod_unknowns - 3 + j] = N[j]
    held.rod.inputs[b, 0] = path * held.problem.inputs[b, 0]
    held.rod.inputs[b, 1] = held.problem.inputs[b, 1]
    for i in range(held.along, held.rod_inputs):
        held.rod.inputs[b, i] = held.problem.inputs[b, i]
    scale = held.problem.inputs.shape[1] - 1
    held.rod.inputs[b, held.rod_inputs] = held.problem.inputs[b, scale]
    for k in range(held.direction_count):
        held.rod.directions[b, k, 0] = path * held.problem.directions[b, k, 0]
        held.rod.directions[b, k, 1] = held.problem.directions[b, k, 1]
        for i in range(held.along, held.rod_inputs):
            held.rod.directions[b, k, i] = held.problem.directions[b, k, i]
        held.rod.directions[b, k, held.rod_inputs] = held.problem.directions[b, k, scale]
    held.base_rotation[b] = held.base_frame[b] * rotation_from_vector(turn_of(held, b))
    for j in range(held.turns):
        axis = turn_axis(held, b, j)
        for i in range(wp.static(len(ALONG))):
            first = held.along + 3 * i
            turned = wp.cross(axis, vector(held.problem.inputs, b, first))
            for c in range(3):
                # (9) the base turned back: what acts along the rod turns instead
                held.rod.directions[b, held.direction_count + j, first + c] = -path * turned[c]


@wp.func
def to_unknowns(held: Held, b: int, values: wp.array3d[wp.float64], others: wp.array3d[wp.float64], first: int, row: int):
    """(6) A row of columns by the unknowns of the rod, as by those of this; directions stand in ``others`` from ``first`` on."""
    turn = base_turn(held, b)
    M = turned_back(held, b, base_moment(held, b))
    n = held.rod_unknowns - 3
    N = turned_back(held, b, vector(held.problem.unknowns, b, n))
    unit = held.moment_unit[b]
    by_moment = wp.vec3d(values[b, row, 0] * unit[0], values[b, row, 1] * unit[1], values[b, row, 2] * unit[2])
    by_force = wp.vec3d(values[b, row, n], values[b, row, n + 1], values[b, row, n + 2])
    for k in range(held.direction_count):
        rate = held.problem.load_factor[b] * held.problem.directions[b, k, 0]
        change = by_moment[0] * M[1] - by_moment[1] * M[0] + by_force[0] * N[1] - by_force[1] * N[0]
        others[b, row, first + k] = others[b, row, first + k] + rate * change
    values[b, row, 0] = held.stiffness[b] * (turn[0] * by_moment[0] - turn[1] * by_moment[1])
    values[b, row, 1] = held.stiffness[b] * (turn[1] * by_moment[0] + turn[0] * by_moment[1])
    values[b, row, 2] = held.stiffness[b] * by_moment[2]
    values[b, row, n] = turn[0] * by_force[0] - turn[1] * by_force[1]
    values[b, row, n + 1] = turn[1] * by_force[0] + turn[0] * by_force[1]
