# mypy: ignore-errors
"""One sample of energy descent, between two integrations. Numbers are those of ``docs/energy_descent.md``."""

from functools import cache

import warp as wp

from multirod.kernels.failure_kernels import failure_of
from multirod.kernels.linear_algebra_kernels import add_row, eliminate, fill_row
from multirod.kernels.own_module import own_module
from multirod.models.rotation_kernels import rotation_from_vector
from multirod.solvers.tracking.symmetric_kernels import FEW, diagonalise, is_definite, least_eigenvalue
from multirod.status import Status

f64 = wp.float64
LARGE = 0.125  # of the radius: a step whose square says that the tip may be far off
NUDGE = 1e-3  # of the radius, at least, along a mode that is unstable: its equilibrium is left though nothing pushes
REACH = 5.0  # of the radius: what a step may change any unknown by, in curvatures of the problem, where constraints bend the way


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
    # its forces, their displacements, and its constraints
    forces: wp.array[int]
    constraints: wp.array[int]
    unit: wp.array2d[wp.float64]
    columns: wp.array3d[wp.float64]
    scale: wp.array2d[wp.float64]
    stiffness: wp.array[wp.float64]  # what counts as one in the form [N m]
    curvature: wp.array[wp.float64]  # what counts as one in the unknowns [1/m]
    give_row: wp.array[int]
    give_column: wp.array[int]
    give: wp.array2d[wp.float64]
    without: wp.array[int]  # inputs that have no potential
    has_potential: int
    # of the descent
    following: wp.array2d[wp.float64]  # unknowns of the next sample
    status: wp.array[int]
    size: wp.array[wp.float64]  # |eps|, max norm [1/m]
    margin: wp.array[wp.float64]  # smallest eigenvalue of H over ``stiffness``; of many displacements the threshold, if above it
    damped: wp.array[int]  # whether the step was one of damped dynamics, (13)
    form: wp.array3d[wp.float64]  # A, by displacements in units of ``scale``
    # room
    system: wp.array3d[wp.float64]  # (instance, n, n)
    sides: wp.array3d[wp.float64]  # (instance, n, m + 2): unknowns by displacements, on to the constraints, with the inputs
    matrix: wp.array3d[wp.float64]  # (instance, m, m)
    modes: wp.array3d[wp.float64]
    values: wp.array2d[wp.float64]
    gradient: wp.array3d[wp.float64]  # (instance, m, 2): of the energy, and its change with the inputs
    steps: wp.array3d[wp.float64]  # (instance, m, 2)
    # options
    corrected: int  # whether the pose and the unknowns are to be those after the step
    radius: wp.float64
    fold_threshold: wp.array[wp.float64]  # of the margin, in units of what is natural


@cache
def make_descent(feed_forward: bool):
    """Kernel for one sample: from the integration at the present unknowns to those of the next sample, and its status."""

    @wp.func
    def potential(state: DescentState, t: int) -> bool:
        """Whether the loads have one."""
        found = state.has_potential != 0
        for k in range(state.without.shape[0]):
            if state.inputs[t, state.without[k]] != f64(0.0):
                found = False
        return found

    @wp.func(inline=False)
    def reduce(state: DescentState, t: int):
        """(10) The unknowns by the displacements, the constraints kept."""
        n = state.gamma.shape[1]
        m = state.forces.shape[0]
        for i in range(m):
            r = state.forces[i]
            for j in range(n):
                state.system[t, r, j] = state.columns[t, i, j]
            for k in range(m + 2):
                state.sides[t, r, k] = f64(0.0)
            state.sides[t, r, i] = state.scale[t, i]
            if wp.static(feed_forward):
                state.sides[t, r, m + 1] = -state.columns[t, i, n]
        for i in range(state.constraints.shape[0]):
            r = state.constraints[i]
            for j in range(n):
                state.system[t, r, j] = state.gamma[t, r, j]
            for k in range(m):
                state.sides[t, r, k] = f64(0.0)
            state.sides[t, r, m] = -state.residual[t, r]
            state.sides[t, r, m + 1] = f64(0.0)
            if wp.static(feed_forward):
                state.sides[t, r, m + 1] = -state.residual_directions[t, r, 0]
        for i in range(state.give.shape[1]):
            r = state.give_row[i]
            state.system[t, r, state.give_column[i]] = state.system[t, r, state.give_column[i]] + state.give[t, i]
        eliminate(state.system, state.sides, t)

    @wp.func(inline=False)
    def find_form(state: DescentState, t: int):
        """(2), (3), (11): the gradient where the constraints hold, its change with the inputs, and the form."""
        n = state.gamma.shape[1]
        m = state.forces.shape[0]
        for i in range(m):
            r = state.forces[i]
            force = state.unit[t, i] * state.scale[t, i]
            fill_row(state.form, t, i, 0, m, f64(0.0))
            left = f64(0.0)
            change = f64(0.0)
            for j in range(n):
                g = state.gamma[t, r, j]
                add_row(state.form, state.sides, t, i, 0, j, 0, m, g)
                left += g * state.sides[t, j, m]
                change += g * state.sides[t, j, m + 1]
            for k in range(m):
                state.form[t, i, k] = force * state.form[t, i, k]
            state.gradient[t, i, 0] = force * (state.residual[t, r] + left)
            if wp.static(feed_forward):
                change += state.residual_directions[t, r, 0]
            state.gradient[t, i, 1] = force * change

    @wp.func
    def take_form(state: DescentState, t: int):
        """(3) H"""
        m = state.forces.shape[0]
        for i in range(m):
            for k in range(m):
                state.matrix[t, i, k] = f64(0.5) * (state.form[t, i, k] + state.form[t, k, i])

    @wp.func(inline=False)
    def find_least(state: DescentState, t: int) -> f64:
        """The least eigenvalue of H alone."""
        take_form(state, t)
        return least_eigenvalue(state.matrix, state.values, t)

    @wp.func(inline=False)
    def find_modes(state: DescentState, t: int) -> f64:
        """The modes of H, and the least of its eigenvalues."""
        m = state.forces.shape[0]
        take_form(state, t)
        diagonalise(state.matrix, state.modes, state.values, t)
        least = state.values[t, 0]
        for i in range(1, m):
            least = wp.min(least, state.values[t, i])
        return least

    @wp.func
    def length_of(state: DescentState, t: int, side: int) -> f64:
        """Of a step."""
        size = f64(0.0)
        for i in range(state.forces.shape[0]):
            size += state.steps[t, i, side] * state.steps[t, i, side]
        return wp.sqrt(size)

    @wp.func
    def moved_by(state: DescentState, t: int) -> f64:
        """The displacements between the last sample's integration and this one's."""
        size = f64(0.0)
        for i in range(state.forces.shape[0]):
            step = state.steps[t, i, 0]
            if wp.static(feed_forward):
                step += state.steps[t, i, 1]
            size += step * step
        return wp.sqrt(size)

    @wp.func(inline=False)
    def newton(state: DescentState, t: int):
        """(4) Of the gradient, and of its change."""
        m = state.forces.shape[0]
        for i in range(m):
            for k in range(m):
                state.matrix[t, i, k] = state.form[t, i, k]
            for side in range(2):
                state.steps[t, i, side] = -state.gradient[t, i, side]
        eliminate(state.matrix, state.steps, t)

    @wp.func(inline=False)
    def down(state: DescentState, t: int, side: int, radius: f64):
        """(5) Down in each mode."""
        m = state.forces.shape[0]
        for i in range(m):
            state.steps[t, i, side] = f64(0.0)
        for k in range(m):
            slope = f64(0.0)
            for i in range(m):
                slope += state.modes[t, i, k] * state.gradient[t, i, side]
            turn = radius
            if wp.abs(slope) < radius * wp.abs(state.values[t, k]):
                turn = wp.abs(slope / state.values[t, k])
            if state.values[t, k] < f64(0.0):
                turn = wp.max(turn, f64(wp.static(NUDGE)) * radius)
            if slope > f64(0.0):
                turn = -turn
            for i in range(m):
                state.steps[t, i, side] = state.steps[t, i, side] + turn * state.modes[t, i, k]

    @wp.func(inline=False)
    def damp(state: DescentState, t: int, side: int, radius: f64, least: f64):
        """(13) One implicit step of damped dynamics, as long as keeps within the radius."""
        m = state.forces.shape[0]
        size = f64(0.0)
        for i in range(m):
            size += state.gradient[t, i, side] * state.gradient[t, i, side]
        damping = wp.max(wp.sqrt(size) / radius, state.fold_threshold[t] * state.stiffness[t]) - least
        damping = wp.max(damping, f64(0.0))
        other = 1 - side
        for i in range(m):
            for k in range(m):
                state.matrix[t, i, k] = state.form[t, i, k]
            state.matrix[t, i, i] = state.matrix[t, i, i] + damping
            state.modes[t, i, 0] = state.steps[t, i, other]
            state.steps[t, i, side] = -state.gradient[t, i, side]
        eliminate(state.matrix, state.steps, t)
        for i in range(m):
            state.steps[t, i, other] = state.modes[t, i, 0]

    @wp.func
    def unknown_step(state: DescentState, t: int, j: int, side: int) -> f64:
        """What a step changes unknown j by, the constraints, or the inputs, followed."""
        m = state.forces.shape[0]
        total = state.sides[t, j, m + side]
        for k in range(m):
            total += state.sides[t, j, k] * state.steps[t, k, side]
        return total

    @wp.func
    def within_reach(state: DescentState, t: int, side: int) -> f64:
        """(14) The part of a step that changes no unknown by more than it may."""
        if state.constraints.shape[0] == 0 and potential(state, t):
            return f64(1.0)
        largest = f64(0.0)
        for j in range(state.gamma.shape[1]):
            largest = wp.max(largest, wp.abs(unknown_step(state, t, j, side)))
        reach = f64(wp.static(REACH)) * state.radius * state.curvature[t]
        return wp.where(largest > reach, reach / largest, f64(1.0))

    @wp.func
    def correct_pose(state: DescentState, t: int):
        """The pose after the step, to first order; ``following`` holds the step."""
        move = wp.vec3d()
        turn = wp.vec3d()
        for k in range(state.gamma.shape[1]):
            for j in range(3):
                move[j] = move[j] + state.pose_columns[t, j, k] * state.following[t, k]
                turn[j] = turn[j] + state.pose_columns[t, 3 + j, k] * state.following[t, k]
        state.position[t] = state.position[t] + move
        state.rotation[t] = rotation_from_vector(turn) * state.rotation[t]

    @own_module(max_unroll=1)
    def descend(state: DescentState):
        t = wp.tid()
        if state.active[t] == 0:
            return
        n = state.gamma.shape[1]
        m = state.forces.shape[0]
        size = f64(0.0)
        total = f64(0.0)
        for i in range(n):
            state.following[t, i] = state.unknowns[t, i]
            size = wp.max(size, wp.abs(state.residual[t, i]))
            total += state.residual[t, i]
        state.size[t] = size
        before = state.margin[t]
        state.margin[t] = f64(0.0)
        state.damped[t] = 0
        if state.fault[t] != 0 or not wp.isfinite(total):
            state.status[t] = failure_of(state.fault[t])
            return

        reduce(state, t)
        find_form(state, t)
        enough = state.fold_threshold[t] * state.stiffness[t]
        # of many displacements what is sought is found only where it is asked for
        least = enough
        modes_known = m <= wp.static(FEW)
        known = modes_known
        if modes_known:
            least = find_modes(state, t)
        elif not is_definite(state.form, state.matrix, t, enough):
            least = find_least(state, t)
            known = True
        state.margin[t] = least / state.stiffness[t]
        near = least < enough  # of the margin rounding may leave less than the threshold
        moved = moved_by(state, t)
        newton(state, t)
        if state.corrected != 0:  # (17)
            step = length_of(state, t, 0)
            fall = before - state.margin[t]
            near = near or fall * step > f64(0.25) * state.margin[t] * wp.max(step, moved)
        for side in range(wp.static(1 + int(feed_forward))):
            radius = state.radius
            if side == 1:
                radius = f64(0.5) * radius
            if not (least > f64(0.0) and length_of(state, t, side) <= radius):
                if potential(state, t):
                    if not modes_known:
                        find_modes(state, t)
                        modes_known = True
                    down(state, t, side, radius)
                else:
                    if not known:
                        least = find_least(state, t)
                        known = True
                    damp(state, t, side, radius, least)
                    if side == 0:
                        state.damped[t] = 1
        total = f64(0.0)
        for i in range(n):
            total += unknown_step(state, t, i, 0)
            if wp.static(feed_forward):
                total += unknown_step(state, t, i, 1)
        if not wp.isfinite(total):
            state.status[t] = wp.static(int(Status.NONFINITE))
            return
        part = within_reach(state, t, 0)
        for i in range(n):
            state.following[t, i] = part * unknown_step(state, t, i, 0)
        if state.corrected != 0:
            correct_pose(state, t)
        ahead = f64(1.0)
        if wp.static(feed_forward):
            ahead = within_reach(state, t, 1)
        for i in range(n):
            x = state.unknowns[t, i] + state.following[t, i]
            state.following[t, i] = x
            if wp.static(feed_forward):
                state.following[t, i] = x + ahead * unknown_step(state, t, i, 1)
            if state.corrected != 0:
                state.unknowns[t, i] = x
        status = int(wp.static(int(Status.TRACKING)))
        far = length_of(state, t, 0) >= f64(wp.static(LARGE)) * state.radius or wp.min(part, ahead) < f64(1.0)
        if near or far:
            status = int(wp.static(int(Status.NEAR_FOLD)))
        state.status[t] = status

    return descend
