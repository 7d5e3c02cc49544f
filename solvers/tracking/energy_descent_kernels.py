# mypy: ignore-errors
"""One sample of energy descent, between two integrations. Numbers are those of ``docs/energy_descent.md``."""

from functools import cache

import warp as wp

from multirod.models.rotation_kernels import rotation_from_vector
from multirod.solvers.newton.linear_algebra_kernels import make_linear_algebra
from multirod.solvers.newton.newton_kernels import failure_of
from multirod.status import Status

f64 = wp.float64
LARGE = 0.125  # of the radius: a turn whose square says that the tip may be far off
NUDGE = 1e-3  # of the radius, at least, along a mode that is unstable: its equilibrium is left though nothing pushes


@wp.struct
class DescentState:
    """What energy descent reads and writes; the first axis is the instance."""

    # of the problem
    active: wp.array[int]
    fault: wp.array[int]
    inputs: wp.array2d[wp.float64]
    unknowns: wp.array2d[wp.float64]
    residual: wp.array2d[wp.float64]
    gamma: wp.array3d[wp.float64]
    residual_directions: wp.array3d[wp.float64]
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    pose_columns: wp.array3d[wp.float64]
    moment_unit: wp.array2d[wp.float64]  # moment of one unit of each residual [N m^2]
    fixed_axes: int  # whether the residual stands along these, turned by the input, or along the tip's
    base_axes: wp.array[wp.mat33d]
    rotation_at: int
    # of the descent
    following: wp.array2d[wp.float64]  # unknowns of the next sample
    status: wp.array[int]
    size: wp.array[wp.float64]  # |eps|, max norm [1/m]
    margin: wp.array[wp.float64]  # smallest eigenvalue of H over that of the unloaded rod
    stiffness: wp.array[wp.float64]  # K_min / L [N m]
    # options
    corrected: int  # whether the pose and the unknowns are to be those after the step
    radius: wp.float64
    fold_threshold: wp.float64


@cache
def make_descent(feed_forward: bool):
    """Kernel for one sample: from the integration at the present unknowns to those of the next sample, and its status."""
    algebra = make_linear_algebra(3)
    solve, eigen, Vector, Matrix, Eigen = algebra.solve, algebra.eigen, algebra.Vector, algebra.Matrix, algebra.Eigen

    @wp.func
    def to_axes(state: DescentState, t: int) -> wp.mat33d:
        """From the world to the axes along which the residual stands."""
        if state.fixed_axes == 0:
            return wp.transpose(state.rotation[t])
        turn = rotation_from_vector(wp.vec3d(f64(0.0), f64(0.0), state.inputs[t, state.rotation_at]))
        return wp.transpose(state.base_axes[t] * turn)

    @wp.func
    def turned_columns(state: DescentState, t: int) -> Matrix:
        """Y: how the tip turns with the unknowns, along these axes."""
        Y = Matrix()
        R = to_axes(state, t)
        for k in range(3):
            phi = wp.vec3d(state.pose_columns[t, 3, k], state.pose_columns[t, 4, k], state.pose_columns[t, 5, k])
            phi = R * phi
            for i in range(3):
                Y[i, k] = phi[i]
        return Y

    @wp.func
    def form(state: DescentState, t: int, Y: Matrix) -> Matrix:
        """(3) A = K Gamma Y^-1, row by row."""
        A = Matrix()
        transposed = wp.transpose(Y)
        for i in range(3):
            row = Vector()
            for j in range(3):
                row[j] = state.moment_unit[t, i] * state.gamma[t, i, j]
            row = solve(transposed, row)
            for j in range(3):
                A[i, j] = row[j]
        return A

    @wp.func
    def step(A: Matrix, modes: Eigen, g: Vector, radius: f64) -> Vector:
        """(4) Newton's where the form is positive and the step short; else (5), down in each mode."""
        if modes[3, 0] > f64(0.0) and modes[3, 1] > f64(0.0) and modes[3, 2] > f64(0.0):
            newton = -solve(A, g)
            if wp.dot(newton, newton) <= radius * radius:
                return newton
        down = Vector()
        for k in range(3):
            slope = f64(0.0)
            for i in range(3):
                slope += modes[i, k] * g[i]
            turn = radius
            if wp.abs(slope) < radius * wp.abs(modes[3, k]):
                turn = wp.abs(slope / modes[3, k])
            if modes[3, k] < f64(0.0):
                turn = wp.max(turn, f64(wp.static(NUDGE)) * radius)
            if slope > f64(0.0):
                turn = -turn
            for i in range(3):
                down[i] = down[i] + turn * modes[i, k]
        return down

    @wp.func
    def correct_pose(state: DescentState, t: int, dx: Vector):
        """(7) The pose of the tip after the step, to first order."""
        move = wp.vec3d()
        turn = wp.vec3d()
        for k in range(3):
            for j in range(3):
                move[j] = move[j] + state.pose_columns[t, j, k] * dx[k]
                turn[j] = turn[j] + state.pose_columns[t, 3 + j, k] * dx[k]
        state.position[t] = state.position[t] + move
        state.rotation[t] = rotation_from_vector(turn) * state.rotation[t]

    @wp.func
    def by_inputs(state: DescentState, t: int, Y: Matrix, A: Matrix, modes: Eigen) -> Vector:
        """(6) What the expected change of inputs asks for: the tip held in the world, then turned by the moment this takes."""
        turn = wp.vec3d(state.pose_columns[t, 3, 3], state.pose_columns[t, 4, 3], state.pose_columns[t, 5, 3])
        turn = to_axes(state, t) * turn
        held = -solve(Y, Vector(turn[0], turn[1], turn[2]))
        g = Vector()
        for i in range(3):
            g[i] = state.residual_directions[t, i, 0]
            for j in range(3):
                g[i] = g[i] + state.gamma[t, i, j] * held[j]
            g[i] = state.moment_unit[t, i] * g[i]
        return held + solve(Y, step(A, modes, g, f64(0.5) * state.radius))

    @wp.func
    def finite(a: Vector) -> bool:
        return wp.isfinite(a[0] + a[1] + a[2])

    @wp.kernel(module="unique", enable_backward=False, module_options={"max_unroll": 1})
    def descend(state: DescentState):
        t = wp.tid()
        if state.active[t] == 0:
            return
        g = Vector()  # (2)
        size = f64(0.0)
        for i in range(3):
            state.following[t, i] = state.unknowns[t, i]
            g[i] = state.moment_unit[t, i] * state.residual[t, i]
            size = wp.max(size, wp.abs(state.residual[t, i]))
        state.size[t] = size
        state.margin[t] = f64(0.0)
        if state.fault[t] != 0 or not finite(g):
            state.status[t] = failure_of(state.fault[t])
            return

        Y = turned_columns(state, t)
        A = form(state, t, Y)
        modes = eigen(f64(0.5) * (A + wp.transpose(A)))
        least = wp.min(modes[3, 0], wp.min(modes[3, 1], modes[3, 2]))
        state.margin[t] = least / state.stiffness[t]
        turn = step(A, modes, g, state.radius)
        dx = solve(Y, turn)

        ahead = Vector()
        if wp.static(feed_forward):
            ahead = by_inputs(state, t, Y, A, modes)
        if not finite(dx) or not finite(ahead):
            state.status[t] = wp.static(int(Status.NONFINITE))
            return
        for i in range(3):
            state.following[t, i] = state.unknowns[t, i] + dx[i] + ahead[i]
        if state.corrected != 0:
            correct_pose(state, t, dx)
            for i in range(3):
                state.unknowns[t, i] = state.unknowns[t, i] + dx[i]
        status = int(wp.static(int(Status.TRACKING)))
        if state.margin[t] < state.fold_threshold or wp.length(turn) >= f64(wp.static(LARGE)) * state.radius:
            status = int(wp.static(int(Status.NEAR_FOLD)))
        state.status[t] = status

    return descend
