# mypy: ignore-errors
"""Explicit Runge-Kutta steps along one stretch of backbone, fixed or with error control, for one layout and tableau."""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_layout_kernels import FAULT_NONE, FAULT_NONFINITE, FAULT_STEPS, Call, Layout
from multirod.models.integrators import Tableau


def make_step_functions(layout: Layout, tableau: Tableau, rates) -> SimpleNamespace:
    """Functions that carry a state over one stretch."""
    n, real = layout.n, layout.real
    State, Stretch = layout.State, layout.Stretch
    N_AT, THETA_AT, TAU_AT, Q_AT, P_AT = layout.N_AT, layout.THETA_AT, layout.TAU_AT, layout.Q_AT, layout.P_AT
    MOMENT, TORQUES = layout.MOMENT, layout.TORQUES
    FORCE_STATE, FRAME, POSE = layout.FORCE_STATE, layout.FRAME, layout.POSE
    # the moment, or what stands for it where several rods carry none together: their torques
    MOMENT_AT, MOMENT_SIZE = (0, 3) if MOMENT else (TAU_AT, TORQUES)
    A, B, PLACES, ERROR = tableau.a, tableau.b, tableau.c, tableau.error
    STAGES = len(B)
    ADAPTIVE = len(ERROR) > 0
    Stages = wp.types.matrix(shape=(STAGES, len(State())), dtype=real)

    def a_of(i: int, j: int) -> float:
        """Coefficient of stage j in stage i, also where the tableau has none: all pairs are looked up at code generation."""
        return A[i][j] if j < i else 0.0

    def error_of(j: int) -> float:
        """Weight of stage j in the error estimate."""
        return ERROR[j] if ADAPTIVE else 0.0

    @wp.func
    def stages(y: State, z: Stretch, x: real, h: real) -> Stages:
        """Slopes of one step of size h from x."""
        k = Stages()
        for i in range(wp.static(STAGES)):
            w = y
            for j in range(wp.static(STAGES)):
                if wp.static(a_of(i, j) != 0.0):
                    w += (h * wp.static(real(a_of(i, j)))) * k[j]
            k[i] = rates(w, z, x + wp.static(real(PLACES[i])) * h)
        return k

    @wp.func
    def advance(y: State, k: Stages, h: real) -> State:
        """The state after the step."""
        w = y
        for j in range(wp.static(STAGES)):
            if wp.static(B[j] != 0.0):
                w += (h * wp.static(real(B[j]))) * k[j]
        return w

    @wp.func
    def block(y: State, first: int, count: int) -> real:
        """Largest magnitude in a block of the state."""
        size = real(0.0)
        for k in range(count):
            size = wp.max(size, wp.abs(y[first + k]))
        return size

    @wp.func
    def block_error(e: State, y: State, first: int, count: int, unit: real, call: Call) -> real:
        """Error of a block of the state over what is allowed."""
        return block(e, first, count) / (real(call.atol) * unit + real(call.rtol) * block(y, first, count))

    @wp.func
    def step_error(k: Stages, y: State, h: real, z: Stretch, scale: real, call: Call) -> real:
        """Largest error of a step over what is allowed, of the state but not of its columns."""
        e = State()
        for j in range(wp.static(STAGES)):
            if wp.static(error_of(j) != 0.0):
                e += (h * wp.static(real(error_of(j)))) * k[j]
        EI = real(0.0)
        for i in range(wp.static(n)):
            EI += z.present[i] * wp.max(z.material[i, 0], z.material[i, 1])
        error = block_error(e, y, MOMENT_AT, MOMENT_SIZE, EI / scale, call)
        if wp.static(FORCE_STATE):
            error = wp.max(error, block_error(e, y, N_AT, 3, EI / (scale * scale), call))
        if wp.static(n > 1):
            error = wp.max(error, block_error(e, y, THETA_AT, wp.static(n - 1), real(1.0), call))
        if wp.static(MOMENT and TORQUES > 0):
            error = wp.max(error, block_error(e, y, TAU_AT, TORQUES, EI / scale, call))
        if wp.static(FRAME):
            error = wp.max(error, block_error(e, y, Q_AT, 4, real(1.0), call))
        if wp.static(POSE):
            error = wp.max(error, block_error(e, y, P_AT, 3, scale, call))
        return error

    @wp.func
    def fixed_steps(y: State, z: Stretch, count: int, scale: real) -> State:
        """The state at the end of the stretch, by equal steps; ``scale`` is what counts as one in positions."""
        w = y
        h = z.length / real(count)
        for j in range(count):
            w = advance(w, stages(w, z, real(j) * h, h), h)
        return w

    @wp.func
    def first_step(y: State, z: Stretch, scale: real, length: real) -> real:
        """A step over which the moment changes little; 1e-3 N m keeps it finite without a moment."""
        d = rates(y, z, real(0.0))
        w = wp.sqrt(block(d, MOMENT_AT, MOMENT_SIZE) * scale / (block(y, MOMENT_AT, MOMENT_SIZE) + real(1.0e-3)))
        return wp.min(real(0.1) * length, length / (real(1.0) + w))

    @wp.func
    def step_factor(error: real, rejected: int) -> real:
        """How much longer or shorter the next step may be: by 5 at most, and no longer just after a rejected step."""
        factor = real(0.2)
        if error <= real(1.0):
            factor = real(5.0)
            if error > real(1.0e-8):
                factor = wp.min(real(5.0), real(0.9) * wp.pow(error, wp.static(real(-1.0 / tableau.order))))
            if rejected == 1:
                factor = wp.min(factor, real(1.0))
        else:
            if error < real(1.0e30):  # false for NaN
                factor = wp.max(factor, real(0.9) * wp.pow(error, wp.static(real(-1.0 / tableau.order))))
        return factor

    @wp.func
    def adaptive_steps(y: State, z: Stretch, h0: real, used: int, scale: real, length: real, call: Call):
        """State at the end of the stretch, next step, steps used in all, fault; ``h0`` is 0 on the first stretch."""
        w = y
        h = h0
        if h <= real(0.0):
            h = first_step(y, z, scale, length)
        x = real(0.0)
        count = used + int(0)
        rejected = int(0)
        fault = int(wp.static(FAULT_NONE))
        while x < z.length and fault == wp.static(FAULT_NONE):
            last = int(0)
            step = h
            if x + real(1.01) * step >= z.length:
                step = z.length - x
                last = int(1)
            slopes = stages(w, z, x, step)
            trial = advance(w, slopes, step)
            error = step_error(slopes, trial, step, z, scale, call)
            factor = step_factor(error, rejected)
            count += int(1)
            if error <= real(1.0):
                w = trial
                x += step
                if last == 1:
                    x = z.length
                rejected = int(0)
                # a step cut short by a node says little about how long the next may be
                if last == 0 or step * factor > h or factor < real(1.0):
                    h = step * factor
            else:
                h = step * factor
                rejected = int(1)
            if count >= call.step_limit:
                fault = int(wp.static(FAULT_STEPS))
            if not (wp.isfinite(block(w, MOMENT_AT, MOMENT_SIZE)) and h > real(0.0)):
                fault = int(wp.static(FAULT_NONFINITE))
        return w, h, count, fault

    return SimpleNamespace(fixed_steps=fixed_steps, adaptive_steps=adaptive_steps)
