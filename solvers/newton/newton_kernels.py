# mypy: ignore-errors
"""Newton's method on many boundary problems at once: what happens between two integrations."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from multirod.kernels.failure_kernels import failure_of
from multirod.kernels.linear_algebra_kernels import copy_row, eliminate, squared
from multirod.kernels.own_module import own_module
from multirod.kernels.repeated_kernels import Calls, launch_all
from multirod.kernels.small_systems_kernels import SMALL, small_quotient, small_radius, small_step
from multirod.solvers.newton.bordered_kernels import Arrow, make_bordered
from multirod.status import Fault, Status


@wp.struct
class NewtonState:
    """State of Newton's iteration; the first axis is the instance."""

    # of the problem
    order: wp.array[int]
    active: wp.array[int]
    fault: wp.array[int]
    step_count: wp.array[int]
    unknowns: wp.array2d[wp.float64]
    residual: wp.array2d[wp.float64]
    gamma: wp.array3d[wp.float64]
    # of the iteration
    status: wp.array[int]
    iterations: wp.array[int]
    integrations: wp.array[int]
    accepted: wp.array2d[wp.float64]  # the last accepted unknowns
    step: wp.array2d[wp.float64]  # the Newton step from there
    direction: wp.array3d[wp.float64]  # (instance, n, 1): the Newton step from here
    merit: wp.array[wp.float64]  # |eps| there; negative before the first evaluation
    damping: wp.array[wp.float64]
    contraction: wp.array[wp.float64]  # largest ratio of successive Newton steps
    first_steps: wp.array[int]  # of the integrator, where the iteration began
    hopeless: wp.array[wp.float64]  # (1,): contraction from which on what takes ``WILD`` times as many is given up
    reference: wp.array3d[wp.float64]  # Gamma of the last kept sample
    has_reference: wp.array[int]  # whether there is one
    change: wp.array[wp.float64]  # bound on the eigenvalues of Gamma reference^-1 - I at the end; 0 without a reference
    factor: wp.array3d[wp.float64]  # (instance, n, n): where a dense Gamma is eliminated
    quotient: wp.array3d[wp.float64]  # (instance, n, n): Gamma reference^-1, transposed
    probes: wp.array3d[wp.float64]  # (instance, n, PROBES): to estimate it, where Gamma is an arrow
    probed: wp.array3d[wp.float64]
    arrow: Arrow
    told: wp.array2d[wp.float64]  # (instance, TOLD): what ``eliminated`` says of it, where Gamma is mostly zeros
    remaining: wp.array[int]  # (1,): instances still active
    # options
    tolerance: wp.array[wp.float64]  # (instance,)
    allowed: wp.array[int]  # (instance,): integrations
    max_iterations: int
    line_search: int
    rounding: wp.float64  # of an integration, in multiples of that of double precision
    noise: wp.float64  # relative size of steps that rounding makes


PROBES = 4
TOLD = 4  # bounds on eigenvalues: two tests of two matrices
UNLIKE = 1.0e30
CHANGE_POWERS = 8.0
FORGOTTEN = 0.25  # of how far a sample was missed, at the next
WILD = 30  # times the steps of the integrator that an iteration began with: of shapes that no extrapolation leads to
LARGE_CHANGE = 0.5  # of Gamma: no mode has vanished or changed sign where the change is less than 1
f64 = wp.float64


@wp.func
def begin(state: wp.ref[NewtonState], t: int):
    """The iteration is to start at the present unknowns."""
    state.iterations[t] = 0
    state.merit[t] = f64(-1.0)
    state.contraction[t] = f64(0.0)
    state.change[t] = f64(0.0)


@cache
def make_dense() -> SimpleNamespace:
    """What Newton's method asks of Gamma, by elimination of all of it."""

    @wp.func(inline=False)
    def aim(state: wp.ref[NewtonState], t: int) -> f64:
        """Length of the Newton step, left in ``state.direction``; not finite if Gamma is singular."""
        n = state.residual.shape[1]
        if n <= wp.static(SMALL):
            return small_step(state.gamma, state.residual, state.direction, t)
        for i in range(n):
            state.direction[t, i, 0] = -state.residual[t, i]
            for j in range(n):
                state.factor[t, i, j] = state.gamma[t, i, j]
        eliminate(state.factor, state.direction, t)
        total = f64(0.0)
        for i in range(n):
            total += state.direction[t, i, 0] * state.direction[t, i, 0]
        return wp.sqrt(total)

    @wp.func(inline=False)
    def divide(state: wp.ref[NewtonState], t: int, reference: wp.array3d[wp.float64]):
        """Leave Gamma reference^-1 in ``state.quotient``, transposed."""
        n = state.residual.shape[1]
        if n <= wp.static(SMALL):
            small_quotient(state.gamma, reference, state.quotient, t)
            return
        for i in range(n):
            for j in range(n):
                state.factor[t, i, j] = reference[t, j, i]
                state.quotient[t, i, j] = state.gamma[t, j, i]
        eliminate(state.factor, state.quotient, t)

    @wp.func(inline=False)
    def radius(
        state: wp.ref[NewtonState], t: int, reference: wp.array3d[wp.float64], which: int, centre: f64, enough: f64, most: f64
    ) -> f64:
        """Bound on the distance from ``centre`` of the eigenvalues of Gamma reference^-1, by the Frobenius norm of
        E = Gamma reference^-1 - centre I and its powers, up to ``most`` or until it is ``enough``.

        The matrix is what ``divide`` left; it stays where no powers are taken, as if ``most`` is 1.
        """
        n = state.residual.shape[1]
        if n <= wp.static(SMALL):
            small = small_radius(state.quotient, t, centre, enough, most)
            return wp.where(wp.isfinite(small), small, f64(wp.static(UNLIKE)))
        total = f64(0.0)
        for i in range(n):
            for j in range(n):
                e = state.quotient[t, i, j]
                if i == j:
                    e = e - centre
                total += e * e
        bound = wp.sqrt(total)
        power = f64(1.0)
        if bound > enough and power < most:
            for i in range(n):
                state.quotient[t, i, i] = state.quotient[t, i, i] - centre
        while bound > enough and power < most:
            for i in range(n):
                copy_row(state.factor, state.quotient, t, i, 0, i, 0, n)
            total = squared(state.factor, state.quotient, t)
            power *= f64(2.0)
            bound = wp.min(bound, wp.pow(total, f64(0.5) / power))
        return wp.where(wp.isfinite(bound), bound, f64(wp.static(UNLIKE)))

    return SimpleNamespace(aim=aim, divide=divide, radius=radius)


@cache
def make_arrow(block: int, border: int) -> SimpleNamespace:
    """The same where Gamma is an arrow, in a time that grows linearly with its blocks."""
    one = make_bordered(block, border, 1)
    several = make_bordered(block, border, PROBES)
    solve_one, solve_several, multiply = one.solve, several.solve, several.multiply

    @wp.func
    def sign(i: int, k: int) -> f64:
        """Plus or minus one, without a pattern."""
        state = wp.rand_init(i, k)
        return wp.where(wp.randf(state) < wp.float32(0.5), f64(-1.0), f64(1.0))

    @wp.func(inline=False)
    def aim(state: wp.ref[NewtonState], t: int) -> f64:
        """Length of the Newton step, left in ``state.direction``; not finite if Gamma is singular."""
        n = state.residual.shape[1]
        for i in range(n):
            state.direction[t, i, 0] = -state.residual[t, i]
        solve_one(state.gamma, state.direction, t, state.arrow)
        total = f64(0.0)
        for i in range(n):
            total += state.direction[t, i, 0] * state.direction[t, i, 0]
        return wp.sqrt(total)

    @wp.func
    def divide(state: wp.ref[NewtonState], t: int, reference: wp.array3d[wp.float64]):
        """Nothing: no quotient is made."""

    @wp.func(inline=False)
    def radius(
        state: wp.ref[NewtonState], t: int, reference: wp.array3d[wp.float64], which: int, centre: f64, enough: f64, most: f64
    ) -> f64:
        """The same, with estimates of the norms: the mean of |E z|^2 over vectors z of random signs is the norm's square."""
        n = state.residual.shape[1]
        for i in range(n):
            for k in range(wp.static(PROBES)):
                state.probed[t, i, k] = sign(i, k)
        bound = f64(wp.static(UNLIKE))
        power = f64(0.0)
        while bound > enough and power < most:
            for i in range(n):
                copy_row(state.probes, state.probed, t, i, 0, i, 0, wp.static(PROBES))
            solve_several(reference, state.probes, t, state.arrow)
            total = f64(0.0)
            for i in range(n):
                for k in range(wp.static(PROBES)):
                    state.probed[t, i, k] = -centre * state.probed[t, i, k]
            multiply(state.gamma, state.probes, state.probed, t, state.arrow)
            for i in range(n):
                for k in range(wp.static(PROBES)):
                    total += state.probed[t, i, k] * state.probed[t, i, k]
            power += f64(1.0)
            bound = wp.min(bound, wp.pow(total / f64(wp.static(PROBES)), f64(0.5) / power))
        return wp.where(wp.isfinite(bound), bound, f64(wp.static(UNLIKE)))

    return SimpleNamespace(aim=aim, divide=divide, radius=radius)


@cache
def make_told() -> SimpleNamespace:
    """The same where ``eliminated`` has said it before the launch."""

    @wp.func(inline=False)
    def aim(state: wp.ref[NewtonState], t: int) -> f64:
        """Length of the Newton step, which stands in ``state.direction``; not finite if Gamma is singular."""
        total = f64(0.0)
        for i in range(state.residual.shape[1]):
            total += state.direction[t, i, 0] * state.direction[t, i, 0]
        return wp.sqrt(total)

    @wp.func
    def divide(state: wp.ref[NewtonState], t: int, reference: wp.array3d[wp.float64]):
        """Nothing: that was done."""

    @wp.func(inline=False)
    def radius(
        state: wp.ref[NewtonState], t: int, reference: wp.array3d[wp.float64], which: int, centre: f64, enough: f64, most: f64
    ) -> f64:
        """The bound on the distance from ``centre``, 1 in the first test of the matrix ``which``."""
        return state.told[t, 2 * which + wp.where(centre == f64(1.0), 0, 1)]

    return SimpleNamespace(aim=aim, divide=divide, radius=radius)


@cache
def make_iteration(block: int = 0, border: int = 0, told: bool = False) -> SimpleNamespace:
    """``iterate``, from one integration to the next, ``divide`` and ``radius``, how unlike two ``Gamma`` are, and ``aim``.

    ``aim`` is the Newton step. Gamma is dense, or, with a ``border``, an arrow of blocks of at most ``block`` rows, or what it
    leads to is ``told``. The number of unknowns is that of the arrays.
    """
    linear = make_told() if told else make_arrow(block, border) if border else make_dense()
    aim, divide, radius = linear.aim, linear.divide, linear.radius

    @wp.func
    def iterate(state: wp.ref[NewtonState], t: int, line_search: int, max_contraction: f64) -> int:
        """Put the unknowns where to integrate next; ``NOT_RUN``, or the status in which the iteration ended.

        An instance that contracts more slowly than ``max_contraction`` stops: it may be leaving its branch.
        """
        n = state.residual.shape[1]
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

        good = sound and (first or size <= state.tolerance[t])
        if sound and not first:
            good = good or line_search == 0 or merit <= (f64(1.0) - f64(1.0e-4) * state.damping[t]) * state.merit[t]
        if good:
            if size <= state.tolerance[t]:
                status = int(wp.static(int(Status.CONVERGED)))
                if state.has_reference[t] != 0:
                    divide(state, t, state.reference)
                    state.change[t] = radius(
                        state, t, state.reference, 0, f64(1.0), f64(wp.static(LARGE_CHANGE)), f64(wp.static(CHANGE_POWERS))
                    )
            else:
                length = aim(state, t)
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
                elif length <= f64(4.0e-16) * state.rounding * base:
                    status = int(wp.static(int(Status.STALLED)))
                else:
                    # a step of rounding size says nothing about contraction
                    if not first and length > state.noise * (base + f64(1.0e-3) * before):
                        state.contraction[t] = wp.max(state.contraction[t], length / before)
                    if state.contraction[t] > max_contraction:
                        status = int(wp.static(int(Status.STALLED)))
                    else:
                        for i in range(n):
                            state.accepted[t, i] = state.unknowns[t, i]
                            state.step[t, i] = state.direction[t, i, 0]
                            state.unknowns[t, i] = state.unknowns[t, i] + state.direction[t, i, 0]
                        state.merit[t] = merit
                        state.damping[t] = f64(1.0)
                        state.iterations[t] = state.iterations[t] + 1
        elif first or line_search == 0:
            status = failure_of(state.fault[t])
        else:
            damping = f64(0.5) * state.damping[t]
            state.damping[t] = damping
            if damping < f64(1.0e-4):
                status = int(wp.static(int(Status.STALLED)))
                if state.fault[t] == wp.static(int(Fault.STRAIN_LAW)):
                    status = int(wp.static(int(Status.LINE_LIMIT)))
            for i in range(n):
                state.unknowns[t, i] = state.accepted[t, i] + damping * state.step[t, i]
        return status

    return SimpleNamespace(iterate=iterate, divide=divide, radius=radius, aim=aim)


@wp.struct
class Sample:
    """What a motion keeps from sample to sample; the first axis is the instance."""

    past: wp.array3d[wp.float64]  # (instance, 3, n): unknowns of the last good samples, the latest first
    points: wp.array[int]  # (1,): how many of them there are; no element where there is no motion
    order: int  # of their extrapolation in time, at most
    chooses: int  # whether it is less where the last samples were foretold better so
    misses: wp.array2d[wp.float64]  # (instance, 2): largest error of an unknown by linear and by quadratic extrapolation, of late
    inputs: wp.array2d[wp.float64]
    last_inputs: wp.array2d[wp.float64]  # of the last good sample
    turned: wp.vec2i  # which of them are angles that may turn rods too far, from and to
    most_turn: wp.float64
    weights: wp.array2d[wp.float64]  # (instance, input): how large a load is one of each; no element where that is not told
    most_change: wp.float64  # of loads, or so much of them as
    most_growth: wp.float64  # says
    slow: wp.float64  # contraction from which on a branch may have been left
    most_integrations: int
    good: wp.array[int]  # (1,): whether the sample needs no other look, and is the last good one now


@wp.func
def foreseen(sample: wp.ref[Sample], t: int, i: int, points: int) -> f64:
    """An unknown by extrapolation of so many of the last samples."""
    x = sample.past[t, 0, i]
    if points == 2:
        x = f64(2.0) * x - sample.past[t, 1, i]
    elif points > 2:
        # rounded as NumPy does, which adds what was multiplied by three
        move = x - sample.past[t, 1, i]
        tripled = move + f64(2.0) * move
        x = tripled + sample.past[t, 2, i]
    return x


@wp.func(inline=False)
def foresee(state: wp.ref[NewtonState], sample: wp.ref[Sample], t: int):
    """Unknowns by extrapolation of the last samples, where the iteration begins."""
    points = sample.points[0]
    if sample.chooses != 0 and points > 2 and sample.misses[t, 0] < sample.misses[t, 1]:
        points = 2
    for i in range(state.unknowns.shape[1]):
        state.unknowns[t, i] = foreseen(sample, t, i, points)
    state.allowed[t] = sample.most_integrations
    state.active[t] = 1
    state.status[t] = 0
    state.integrations[t] = 0
    begin(state, t)


@wp.func(inline=False)
def calm(state: wp.ref[NewtonState], sample: wp.ref[Sample], t: int) -> bool:
    """Whether nothing says that the instance failed or may have left its branch."""
    least = f64(wp.inf)
    most = f64(-wp.inf)
    for i in range(sample.turned[0], sample.turned[1]):
        turn = sample.inputs[t, i] - sample.last_inputs[t, i]
        least = wp.min(least, turn)
        most = wp.max(most, turn)
    changed = f64(0.0)
    loaded = f64(0.0)
    for i in range(sample.weights.shape[1]):
        changed += sample.weights[t, i] * wp.abs(sample.inputs[t, i] - sample.last_inputs[t, i])
        loaded += sample.weights[t, i] * wp.abs(sample.inputs[t, i])
    if changed > wp.max(sample.most_change, sample.most_growth * loaded):
        return False
    converged = state.status[t] == wp.static(int(Status.CONVERGED)) and state.contraction[t] <= sample.slow
    return converged and state.change[t] <= f64(wp.static(LARGE_CHANGE)) and not most - least > sample.most_turn


@wp.func(inline=False)
def keep_sample(state: wp.ref[NewtonState], sample: wp.ref[Sample], t: int):
    """Make it the last good one."""
    for k in range(sample.chooses * (sample.points[0] - 1)):
        miss = f64(wp.static(FORGOTTEN)) * sample.misses[t, k]
        for i in range(state.unknowns.shape[1]):
            miss = wp.max(miss, wp.abs(state.unknowns[t, i] - foreseen(sample, t, i, k + 2)))
        sample.misses[t, k] = miss
    for i in range(state.unknowns.shape[1]):
        found, last, before = state.unknowns[t, i], f64(sample.past[t, 0, i]), f64(sample.past[t, 1, i])
        # of what began, or stood still, both orders lead where the linear one does
        sample.past[t, 2, i] = wp.where(before == last, f64(2.0) * last - found, before)
        sample.past[t, 1, i] = last
        sample.past[t, 0, i] = found
    for i in range(sample.inputs.shape[1]):
        sample.last_inputs[t, i] = sample.inputs[t, i]
    for i in range(state.reference.shape[1]):
        copy_row(state.reference, state.gamma, t, i, 0, i, 0, state.reference.shape[2])
    state.has_reference[t] = 1


@cache
def make_newton(block: int = 0, border: int = 0, told: bool = False, repeats: bool = False):
    """Kernel that takes each active instance from an integration to its next trial, or to its end.

    Where it ``repeats``, one thread may do all: with ``rounds``, it has what is to be launched in between launched so many times
    at most, until no instance is active. With a ``sample`` it begins where a motion's next is foreseen, and ends as the last one.
    """
    iterate = make_iteration(block, border, told).iterate

    @wp.func(inline=False)
    def advance(state: wp.ref[NewtonState], t: int):
        """One instance, after its integration."""
        state.integrations[t] = state.integrations[t] + 1
        if state.merit[t] < f64(0.0):
            state.first_steps[t] = state.step_count[t]
        status = iterate(state, t, state.line_search, f64(1.0e300))
        wild = state.step_count[t] > wp.static(WILD) * state.first_steps[t]
        if status == wp.static(int(Status.NOT_RUN)) and wild and state.contraction[t] > state.hopeless[0]:
            status = int(wp.static(int(Status.STALLED)))
        if status == wp.static(int(Status.NOT_RUN)) and state.integrations[t] >= state.allowed[t]:
            status = int(wp.static(int(Status.INTEGRATION_LIMIT)))
        state.status[t] = status
        if status != wp.static(int(Status.NOT_RUN)):
            state.active[t] = 0
        else:
            wp.atomic_add(state.remaining, 0, 1)

    @own_module(max_unroll=1)
    def newton(state: NewtonState, calls: Calls, rounds: int, sample: Sample):
        if rounds == 0:
            t = state.order[wp.tid()]
            if state.active[t] != 0:
                advance(state, t)
            return
        if wp.static(repeats):
            count = state.status.shape[0]
            followed = sample.points.shape[0] > 0
            if followed:
                for t in range(count):
                    foresee(state, sample, t)
            left = int(1)
            done = int(0)
            while left > 0 and done < rounds:
                state.remaining[0] = 0
                launch_all(calls)
                for t in range(count):
                    if state.active[t] != 0:
                        advance(state, t)
                left = state.remaining[0]
                done += 1
            if followed:
                good = left == 0
                for t in range(count):
                    good = good and calm(state, sample, t)
                sample.good[0] = wp.where(good, 1, 0)
                if good:
                    for t in range(count):
                        keep_sample(state, sample, t)
                    sample.points[0] = wp.min(sample.points[0] + 1, sample.order + 1)

    return newton
