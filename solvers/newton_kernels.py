# mypy: ignore-errors
"""Newton's method on many boundary problems at once: what happens between two integrations."""

from functools import cache

import warp as wp

from multirod.models.backbone_kernels import FAULT_STEPS
from multirod.solvers.linear_algebra_kernels import make_linear_algebra
from multirod.status import Status


@wp.struct
class NewtonState:
    """State of Newton's iteration; the first axis is the instance."""

    # of the problem
    active: wp.array[int]
    fault: wp.array[int]
    unknowns: wp.array2d[wp.float64]
    residual: wp.array2d[wp.float64]
    gamma: wp.array3d[wp.float64]
    # of the iteration
    status: wp.array[int]
    iterations: wp.array[int]
    integrations: wp.array[int]
    accepted: wp.array2d[wp.float64]  # the last accepted unknowns
    step: wp.array2d[wp.float64]  # the Newton step from there
    merit: wp.array[wp.float64]  # |eps| there; negative before the first evaluation
    damping: wp.array[wp.float64]
    contraction: wp.array[wp.float64]  # largest ratio of successive Newton steps
    reference: wp.array3d[wp.float64]  # Gamma of the last kept sample, or zero
    change: wp.array[wp.float64]  # Frobenius norm of Gamma reference^-1 - I at the end; 0 without a reference
    remaining: wp.array[int]  # (1,): instances still active
    # options
    tolerance: wp.float64
    max_iterations: int
    line_search: int
    max_contraction: wp.float64  # an instance that contracts more slowly stops: it may be leaving its branch


@wp.kernel(module="unique", enable_backward=False)
def restart(state: NewtonState):
    """Make every instance active, its iteration not begun."""
    t = wp.tid()
    state.active[t] = 1
    state.status[t] = 0
    state.iterations[t] = 0
    state.integrations[t] = 0
    state.merit[t] = wp.float64(-1.0)
    state.contraction[t] = wp.float64(0.0)
    state.change[t] = wp.float64(0.0)


@cache
def make_newton(n: int):
    """Kernel that takes each active instance from an integration to its next trial, or to its end."""
    f64 = wp.float64
    algebra = make_linear_algebra(n)
    solve = algebra.solve
    Vector = algebra.Vector
    Matrix = algebra.Matrix

    @wp.kernel(module="unique", enable_backward=False)
    def newton(state: NewtonState):
        t = wp.tid()
        if state.active[t] == 0:
            return
        state.integrations[t] = state.integrations[t] + 1
        status = int(wp.static(int(Status.NOT_RUN)))
        merit = f64(0.0)
        size = f64(0.0)
        for i in range(n):
            e = state.residual[t, i]
            merit += e * e
            size = wp.max(size, wp.abs(e))
        merit = wp.sqrt(merit)
        sound = state.fault[t] == 0 and wp.isfinite(merit)
        first = state.merit[t] < f64(0.0)

        good = sound and (first or size <= state.tolerance)
        if sound and not first:
            good = good or state.line_search == 0 or merit <= (f64(1.0) - f64(1.0e-4) * state.damping[t]) * state.merit[t]
        if good:
            if size <= state.tolerance:
                status = int(wp.static(int(Status.CONVERGED)))
                if state.reference[t, 0, 0] != f64(0.0) or state.reference[t, n - 1, n - 1] != f64(0.0):
                    T = Matrix()
                    for i in range(n):
                        for j in range(n):
                            T[i, j] = state.reference[t, j, i]
                    change = f64(0.0)
                    for i in range(n):
                        row = Vector()
                        for j in range(n):
                            row[j] = state.gamma[t, i, j]
                        row = solve(T, row)
                        row[i] = row[i] - f64(1.0)
                        change += wp.dot(row, row)
                    state.change[t] = wp.sqrt(change)
            else:
                A = Matrix()
                b = Vector()
                for i in range(n):
                    b[i] = -state.residual[t, i]
                    for j in range(n):
                        A[i, j] = state.gamma[t, i, j]
                d = solve(A, b)
                length = wp.sqrt(wp.dot(d, d))
                before = f64(0.0)
                base = f64(0.0)
                for i in range(n):
                    before += state.step[t, i] * state.step[t, i]
                    base = wp.max(base, wp.abs(state.unknowns[t, i]))
                before = wp.sqrt(before)
                if not wp.isfinite(length):
                    status = int(wp.static(int(Status.SINGULAR_JACOBIAN)))
                elif state.iterations[t] >= state.max_iterations:
                    status = int(wp.static(int(Status.MAX_ITERATIONS)))
                elif length <= f64(4.0e-16) * base:
                    status = int(wp.static(int(Status.STALLED)))
                else:
                    # a step of rounding size says nothing about contraction
                    if not first and length > f64(1.0e-10) * (base + f64(1.0e-3) * before):
                        state.contraction[t] = wp.max(state.contraction[t], length / before)
                    if state.contraction[t] > state.max_contraction:
                        status = int(wp.static(int(Status.STALLED)))
                    else:
                        for i in range(n):
                            state.accepted[t, i] = state.unknowns[t, i]
                            state.step[t, i] = d[i]
                            state.unknowns[t, i] = state.unknowns[t, i] + d[i]
                        state.merit[t] = merit
                        state.damping[t] = f64(1.0)
                        state.iterations[t] = state.iterations[t] + 1
        elif first or state.line_search == 0:
            status = int(wp.static(int(Status.NONFINITE)))
            if state.fault[t] == wp.static(FAULT_STEPS):
                status = int(wp.static(int(Status.STEP_LIMIT)))
        else:
            damping = f64(0.5) * state.damping[t]
            state.damping[t] = damping
            if damping < f64(1.0e-4):
                status = int(wp.static(int(Status.STALLED)))
            for i in range(n):
                state.unknowns[t, i] = state.accepted[t, i] + damping * state.step[t, i]
        state.status[t] = status
        if status != wp.static(int(Status.NOT_RUN)):
            state.active[t] = 0
        else:
            wp.atomic_add(state.remaining, 0, 1)

    return newton
