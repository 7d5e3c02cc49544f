# mypy: ignore-errors
"""Following branches of equilibria, many at once: what happens between two integrations.

Each instance goes its own way: it is told after every integration where to be integrated next, whether that is the next of
Newton's steps or the first of the next step along its branch. The tests are those of ``docs/solvers.md``, Which equilibrium.
"""

from functools import cache

import warp as wp

from multirod.kernels.failure_kernels import failure_of
from multirod.kernels.own_module import own_module
from multirod.kernels.repeated_kernels import Calls, launch_all
from multirod.solvers.continuation.acceptance import (
    CONTRACTION,
    LARGEST_RATIO,
    MIN_STEP,
    RATIO_POWERS,
    SMALLEST_RATIO,
    SURPRISE,
)
from multirod.solvers.newton.newton_kernels import NewtonState, begin, make_iteration
from multirod.status import Fault, Status

AGREEMENT = 0.25  # the same from half the way to where twice the step led: half for one that stays a distance away
HALFWAY = 0.1  # largest distance of the equilibrium halfway from the curve through the ends, relative to theirs
HALFWAY_FIRST = 0.35  # the same where that curve is a straight line
NEAR = 0.1  # of a step, that Newton's next may be where it is looked at halfway
DOUBTFUL = 0.65  # first ratio of Newton steps, up to which the whole load at once is looked at at its quarters too
STRETCH = 0.15  # of a step, that is gone with it where no more is left to the full load
ON_THE_WAY = 1.0e-3  # of a step, how far from the equilibrium its end may be where the path goes on
CLEARLY = 1.05  # radius of the disc that eigenvalues are not in when it is told before the equilibrium is found
FALL = 0.1  # of the residual by Newton's last step but one, that tells so
PATIENCE = 2  # halvings of a step, after which the equilibrium that it starts from is found to the tolerance
FAR = 0.05  # of the way, at least, by a step that is looked at, and begun, by few steps of the integrator
UNSETTLED = 0.03  # of a step, that Newton's last was at least, where few steps of the integrator tell the next as well
# a step has not been looked at halfway, is, has been, is by its last integration, or waits for the equilibrium it starts from;
# or is looked at at its first or its last quarter
UNSEEN, LOOKING, SEEN, LAST_LOOK, POLISHING, FIRST_QUARTER, LAST_QUARTER = 0, 1, 2, 3, 4, 5, 6
BEFORE, MIDDLE = 0, 1  # what Gamma is compared with
f64 = wp.float64


@wp.struct
class PathState:
    """State of the paths from level 0 to level 1; the first axis is the instance."""

    newton: NewtonState
    # what a level sets: the load factor, or inputs between two rows of them
    by_inputs: int
    dip: wp.float64  # part of the load that is taken off halfway between two rows of inputs
    load_factor: wp.array[wp.float64]
    inputs: wp.array2d[wp.float64]
    from_inputs: wp.array2d[wp.float64]
    to_inputs: wp.array2d[wp.float64]
    # the path
    status: wp.array[int]
    iterations: wp.array[int]
    integrations: wp.array[int]
    steps: wp.array[int]
    departing: int  # whether paths start from an equilibrium that is known: there is no integration to take in
    known: wp.array[int]  # equilibria known, 3 at most; 0 before the first is evaluated
    points: wp.array3d[wp.float64]  # (instance, 3, n): the last equilibria, the latest first
    levels: wp.array2d[wp.float64]  # (instance, 3): their levels
    reference: wp.array3d[wp.float64]  # Gamma at the latest
    step: wp.array[wp.float64]
    halved: wp.array[int]  # how often it has just been halved: then it does not grow at once
    goal: wp.array[wp.float64]
    expected: wp.array2d[wp.float64]  # unknowns at the goal by extrapolation
    surprise: wp.array2d[wp.float64]  # those found instead
    surprised: wp.array[int]  # whether there are any, at twice the present step
    rough: wp.array[int]  # whether the latest is where Newton's method would go on: its residual is not within the tolerance
    misled: wp.array[int]  # whether Gamma there said another thing of its modes than at the equilibrium: then none is rough
    probed: wp.array[int]  # how far the look halfway is, ``UNSEEN`` and so on
    trial: wp.array2d[wp.float64]  # the unknowns at the goal meanwhile
    halfway: wp.array3d[wp.float64]  # Gamma there, or, where the look is the step's last integration, at the goal
    apart: wp.array[wp.float64]  # how far the equilibrium there was from that curve, of what is allowed
    brief: wp.array[int]  # whether looks, and Newton's first steps, may be by few steps of the integrator
    coarsely: wp.array[int]  # whether the next integration is
    doubted: wp.array[int]  # whether Newton's first steps contracted so slowly that its quarters are looked at too
    middle: wp.array2d[wp.float64]  # unknowns of the equilibrium halfway
    safe_step: wp.array[wp.float64]  # a step that is short enough wherever it starts
    most_step: wp.array[wp.float64]  # no step is longer
    sure_level: wp.array[wp.float64]  # up to here no mode can vanish
    growth: wp.float64  # a step may be as long as this part of the level, if that is longer
    max_steps: int
    remaining: wp.array[int]  # (1,): instances on their way


@cache
def make_path(block: int = 0, border: int = 0, told: bool = False, repeats: bool = False):
    """Kernel that takes each active instance from an integration to the next on its path, or to its end, and puts those that are
    ``departing`` from a known equilibrium on their way.

    The arguments say what ``Gamma`` is like, as for ``make_iteration``. Where it ``repeats``, one thread may do all: with
    ``rounds``, it has what is to be launched in between launched so many times at most, until no instance is on its way.
    """
    iteration = make_iteration(block, border, told)
    iterate, divide, radius, newton_step = iteration.iterate, iteration.divide, iteration.radius, iteration.aim
    CENTRE = 0.5 * (SMALLEST_RATIO + LARGEST_RATIO)
    RADIUS = 0.5 * (LARGEST_RATIO - SMALLEST_RATIO)

    @wp.func(inline=False)
    def alike(state: wp.ref[PathState], t: int, first: int, last: int, slack: f64) -> bool:
        """Whether no mode of Gamma came near zero or changed sign, with more ``slack`` if not 1, since those from ``first`` to
        ``last``: the last equilibrium (``BEFORE``), or the one halfway (``MIDDLE``).
        """
        for which in range(first, last + 1):
            other = state.reference
            if which > 0:
                other = state.halfway
            divide(state.newton, t, other)
            enough = f64(wp.static(1.0 - SMALLEST_RATIO))
            if radius(state.newton, t, other, which, f64(1.0), enough, f64(1.0)) >= enough:
                enough = slack * f64(wp.static(RADIUS))
                most = f64(wp.static(RATIO_POWERS))
                if radius(state.newton, t, other, which, f64(wp.static(CENTRE)), enough, most) >= enough:
                    return False
        return True

    @wp.func(inline=False)
    def expected(state: wp.ref[PathState], t: int) -> bool:
        """Whether the equilibrium lies where the extrapolation led, or half as far as that of twice the step, which did not:
        a branch may turn faster than its last equilibria tell, but what it goes on to shrinks with the step.
        """
        n = state.points.shape[2]
        if state.known[t] < 2:
            return True
        missed = f64(0.0)
        parted = f64(0.0)
        moved = f64(0.0)
        size = f64(0.0)
        for i in range(n):
            x = state.newton.unknowns[t, i]
            half = f64(0.5) * (state.points[t, 0, i] + state.surprise[t, i])
            missed += (x - state.expected[t, i]) * (x - state.expected[t, i])
            parted += (x - half) * (x - half)
            moved += (x - state.points[t, 0, i]) * (x - state.points[t, 0, i])
            size += x * x
        if wp.sqrt(missed) <= f64(wp.static(SURPRISE)) * wp.sqrt(moved) + f64(1.0e-6) * (f64(1.0) + wp.sqrt(size)):
            return True
        return state.surprised[t] != 0 and wp.sqrt(parted) <= f64(wp.static(AGREEMENT)) * wp.sqrt(moved)

    @wp.func(inline=False)
    def set_latest(state: wp.ref[PathState], t: int):
        """The latest equilibrium is the one at hand."""
        for i in range(state.points.shape[2]):
            state.points[t, 0, i] = state.newton.unknowns[t, i]
        for i in range(state.reference.shape[1]):
            for j in range(state.reference.shape[2]):
                state.reference[t, i, j] = state.newton.gamma[t, i, j]

    @wp.func(inline=False)
    def keep(state: wp.ref[PathState], t: int, level: f64):
        """Add the equilibrium at hand to the path."""
        n = state.points.shape[2]
        for r in range(2):
            k = 2 - r
            state.levels[t, k] = state.levels[t, k - 1]
            for i in range(n):
                state.points[t, k, i] = state.points[t, k - 1, i]
        state.levels[t, 0] = level
        set_latest(state, t)
        state.known[t] = wp.min(state.known[t] + 1, 3)

    @wp.func
    def longest_step(state: wp.ref[PathState], t: int) -> f64:
        return wp.min(wp.max(state.safe_step[t], state.growth * state.levels[t, 0]), state.most_step[t])

    @wp.func
    def set_pace(state: wp.ref[PathState], t: int):
        """Whether the next integration is by few steps of the integrator: what these leave is little beside the step."""
        far = state.goal[t] - state.levels[t, 0] >= f64(wp.static(FAR))
        state.coarsely[t] = wp.where(far, state.brief[t], 0)

    @wp.func
    def begin_finely(state: wp.ref[PathState], t: int):
        """Go on with all steps: what few steps left is no ratio of Newton's."""
        state.coarsely[t] = 0
        state.newton.merit[t] = f64(-1.0)

    @wp.func(inline=False)
    def aim(state: wp.ref[PathState], t: int):
        """Put the instance at its next level, its unknowns by the polynomial through the equilibria known there (Newton's
        divided differences).
        """
        n = state.points.shape[2]
        a = state.levels[t, 0]
        b = state.levels[t, 1]
        c = state.levels[t, 2]
        goal = wp.min(f64(1.0), a + state.step[t])
        least = f64(wp.static(MIN_STEP))
        if goal > state.sure_level[t]:  # what is left would be looked at halfway too
            least = wp.max(least, f64(wp.static(STRETCH)) * state.step[t])
        if f64(1.0) - goal < least:
            goal = f64(1.0)
        state.goal[t] = goal
        put(state, t, goal)
        state.probed[t] = wp.where(goal <= state.sure_level[t], wp.static(SEEN), wp.static(UNSEEN))
        state.apart[t] = f64(0.0)
        state.doubted[t] = 0
        set_pace(state, t)
        for i in range(n):
            x = state.points[t, 0, i]
            if state.known[t] > 1:
                first = (state.points[t, 0, i] - state.points[t, 1, i]) / (a - b)
                x += (goal - a) * first
                if state.known[t] > 2:
                    second = (first - (state.points[t, 1, i] - state.points[t, 2, i]) / (b - c)) / (a - c)
                    x += (goal - a) * (goal - b) * second
            state.expected[t, i] = x
            state.newton.unknowns[t, i] = x
        state.steps[t] = state.steps[t] + 1
        begin(state.newton, t)

    @wp.func(inline=False)
    def put(state: wp.ref[PathState], t: int, level: f64):
        """Set what the level sets."""
        if state.by_inputs != 0:
            for i in range(state.inputs.shape[1]):
                state.inputs[t, i] = state.from_inputs[t, i] + level * (state.to_inputs[t, i] - state.from_inputs[t, i])
            if state.dip > f64(0.0):
                state.load_factor[t] = f64(1.0) - f64(4.0) * state.dip * level * (f64(1.0) - level)
        else:
            state.load_factor[t] = level

    @wp.func(inline=False)
    def look_halfway(state: wp.ref[PathState], t: int, probed: int):
        """Go to the level halfway, on the curve through the trial and the equilibria known."""
        n = state.points.shape[2]
        g = state.goal[t]
        a = state.levels[t, 0]
        b = state.levels[t, 1]
        c = state.levels[t, 2]
        level = f64(0.5) * (a + g)
        put(state, t, level)
        set_pace(state, t)
        for i in range(n):
            x = state.newton.unknowns[t, i]
            state.trial[t, i] = x
            first = (x - state.points[t, 0, i]) / (g - a)
            x = state.points[t, 0, i] + (level - a) * first
            if state.known[t] > 1:
                ab = (state.points[t, 0, i] - state.points[t, 1, i]) / (a - b)
                second = (first - ab) / (g - b)
                x += (level - a) * (level - g) * second
                if state.known[t] > 2:
                    bc = (state.points[t, 1, i] - state.points[t, 2, i]) / (b - c)
                    third = (second - (ab - bc) / (a - c)) / (g - c)
                    x += (level - a) * (level - g) * (level - b) * third
            state.newton.unknowns[t, i] = x
        state.probed[t] = probed
        if probed == wp.static(LAST_LOOK):
            for i in range(state.halfway.shape[1]):
                for j in range(state.halfway.shape[2]):
                    state.halfway[t, i, j] = state.newton.gamma[t, i, j]

    @wp.func
    def may_doubt(state: wp.ref[PathState], t: int) -> bool:
        """Whether the first ratio of Newton steps is at hand where the whole load is tried at once."""
        whole = state.known[t] == 1 and state.goal[t] == f64(1.0) and state.probed[t] == wp.static(UNSEEN)
        return wp.static(not told) and whole and state.newton.iterations[t] == 1

    @wp.func(inline=False)
    def look_at_quarter(state: wp.ref[PathState], t: int, probed: int):
        """Go to the first or last quarter of the way, on the parabola through its ends and the equilibrium halfway."""
        a = state.levels[t, 0]
        part = wp.where(probed == wp.static(FIRST_QUARTER), f64(0.25), f64(0.75))
        put(state, t, a + part * (state.goal[t] - a))
        set_pace(state, t)
        for i in range(state.points.shape[2]):
            bent = state.middle[t, i] - f64(0.5) * (state.points[t, 0, i] + state.trial[t, i])
            straight = (f64(1.0) - part) * state.points[t, 0, i] + part * state.trial[t, i]
            state.newton.unknowns[t, i] = straight + f64(0.75) * bent
        state.probed[t] = probed

    @wp.func(inline=False)
    def passed_quarter(state: wp.ref[PathState], t: int) -> bool:
        """Whether there is an equilibrium on that curve, and Gamma there is like that halfway, at the first quarter also like the
        last; leads back to the trial.
        """
        first = wp.where(state.probed[t] == wp.static(FIRST_QUARTER), wp.static(BEFORE), wp.static(MIDDLE))
        off = newton_step(state.newton, t)
        sound = state.newton.fault[t] == 0 and wp.isfinite(off) and alike(state, t, first, wp.static(MIDDLE), f64(1.0))
        moved = f64(0.0)
        for i in range(state.points.shape[2]):
            x = state.trial[t, i]
            state.newton.unknowns[t, i] = x
            moved += (x - state.points[t, 0, i]) * (x - state.points[t, 0, i])
        put(state, t, state.goal[t])
        state.coarsely[t] = 0
        state.probed[t] = wp.static(SEEN)
        return sound and off <= f64(wp.static(HALFWAY)) * wp.sqrt(moved)

    @wp.func(inline=False)
    def passed_halfway(state: wp.ref[PathState], t: int) -> bool:
        """Whether there is an equilibrium halfway on that curve, and Gamma there is like the last; leads back to the trial.

        Where the look is the step's last integration, also like that at its end.
        """
        n = state.points.shape[2]
        sound = state.newton.fault[t] == 0
        off = newton_step(state.newton, t)
        last = state.probed[t] == wp.static(LAST_LOOK)
        others = wp.where(last, wp.static(MIDDLE), wp.static(BEFORE))
        sound = sound and wp.isfinite(off) and alike(state, t, wp.static(BEFORE), others, f64(1.0))
        moved = f64(0.0)
        size = f64(0.0)
        for i in range(n):
            x = state.trial[t, i]
            state.middle[t, i] = state.newton.unknowns[t, i] + state.newton.direction[t, i, 0]
            state.newton.unknowns[t, i] = x
            moved += (x - state.points[t, 0, i]) * (x - state.points[t, 0, i])
            size += x * x
        for i in range(state.halfway.shape[1]):
            for j in range(state.halfway.shape[2]):
                if last:
                    state.newton.gamma[t, i, j] = state.halfway[t, i, j]
                else:
                    state.halfway[t, i, j] = state.newton.gamma[t, i, j]
        most = wp.where(state.known[t] > 1, f64(wp.static(HALFWAY)), f64(wp.static(HALFWAY_FIRST)))
        put(state, t, state.goal[t])
        state.coarsely[t] = 0
        if not last:
            state.probed[t] = wp.static(SEEN)
        state.apart[t] = off / (most * wp.sqrt(moved) + f64(1.0e-6) * (f64(1.0) + wp.sqrt(size)))
        return sound and state.apart[t] <= f64(1.0)

    @wp.func(inline=False)
    def left(state: wp.ref[PathState], t: int) -> f64:
        """Newton's last step, as a part of the way."""
        n = state.points.shape[2]
        last = f64(0.0)
        moved = f64(0.0)
        for i in range(n):
            last += state.newton.step[t, i] * state.newton.step[t, i]
            move = state.newton.unknowns[t, i] - state.points[t, 0, i]
            moved += move * move
        return wp.sqrt(last) / wp.max(wp.sqrt(moved), f64(1.0e-300))

    @wp.func
    def near_enough(state: wp.ref[PathState], t: int, part: f64, merit: f64) -> bool:
        """Whether a path may go on from where Newton's last step, this ``part`` of the way, has led; |eps| was ``merit`` before
        the last but one.

        What is left is no more than that step times the contraction, and is to be little of the next step too.
        """
        on_the_way = state.goal[t] < f64(1.0) and state.newton.iterations[t] > 1
        if wp.static(told):  # of one comparison
            on_the_way = on_the_way and state.goal[t] <= state.sure_level[t]
        on_the_way = on_the_way and state.misled[t] == 0 and state.newton.merit[t] <= f64(wp.static(FALL)) * merit
        ahead = wp.min(f64(1.0), (f64(1.0) - state.goal[t]) / (state.goal[t] - state.levels[t, 0]))
        return on_the_way and part * state.newton.contraction[t] <= f64(wp.static(ON_THE_WAY)) * ahead

    @wp.func(inline=False)
    def why(state: wp.ref[PathState], t: int, found: int) -> int:
        """Status of an instance whose step became too small."""
        n = state.points.shape[2]
        if found == wp.static(int(Status.NONFINITE)) or found == wp.static(int(Status.STEP_LIMIT)):
            return found
        if found == wp.static(int(Status.LINE_LIMIT)):
            return found
        size = f64(0.0)
        largest = f64(0.0)
        for i in range(n):
            largest = wp.max(largest, wp.abs(state.points[t, 0, i]))
        for i in range(state.reference.shape[1]):
            for j in range(state.reference.shape[2]):
                size += state.reference[t, i, j] * state.reference[t, i, j]
        if f64(2.0e-15) * state.newton.rounding * wp.sqrt(size) * largest > state.newton.tolerance[t]:
            return wp.static(int(Status.STALLED))
        return wp.static(int(Status.BRANCH_END))

    @wp.func
    def arrive(state: wp.ref[PathState], t: int) -> int:
        """Take in the equilibrium where the path starts."""
        if state.newton.fault[t] != wp.static(int(Fault.NONE)):
            return failure_of(state.newton.fault[t])
        keep(state, t, f64(0.0))
        state.step[t] = longest_step(state, t)
        return wp.static(int(Status.NOT_RUN))

    @wp.func
    def advance(state: wp.ref[PathState], t: int, found: int, rough: bool) -> int:
        """Keep what Newton's method ended with, or halve the step."""
        n = state.points.shape[2]
        state.iterations[t] = state.iterations[t] + state.newton.iterations[t]
        reached = state.goal[t] - state.levels[t, 0]
        # what was looked at halfway by its last integration has been compared with that
        alone = state.goal[t] <= state.sure_level[t] or state.probed[t] == wp.static(LAST_LOOK)
        others = wp.where(alone, wp.static(BEFORE), wp.static(MIDDLE))
        same_branch = found == wp.static(int(Status.CONVERGED)) and alike(state, t, wp.static(BEFORE), others, f64(1.0))
        if same_branch and expected(state, t):
            state.surprised[t] = 0
            state.rough[t] = wp.where(rough, 1, 0)
            keep(state, t, state.goal[t])
            if state.goal[t] >= f64(1.0):
                return wp.static(int(Status.CONVERGED))
            contraction = wp.max(state.newton.contraction[t], f64(1.0e-6))
            worst = wp.max(contraction / f64(wp.static(0.5 * CONTRACTION)), f64(2.0) * state.apart[t])
            growth = wp.pow(f64(1.0) / worst, f64(1.0) / f64(state.known[t]))
            step = reached * wp.min(wp.max(growth, f64(0.5)), wp.where(state.halved[t] != 0, f64(1.0), f64(3.0)))
            state.step[t] = wp.min(step, longest_step(state, t))
            state.halved[t] = 0
            return wp.static(int(Status.NOT_RUN))
        state.surprised[t] = wp.where(same_branch, 1, 0)
        for i in range(n):
            state.surprise[t, i] = state.newton.unknowns[t, i]
        state.step[t] = f64(0.5) * reached
        state.halved[t] = state.halved[t] + 1
        too_small = state.step[t] < f64(wp.static(MIN_STEP))
        if state.rough[t] != 0 and (too_small or state.halved[t] >= wp.static(PATIENCE)):
            state.step[t] = wp.max(state.step[t], f64(wp.static(MIN_STEP)))
            state.probed[t] = wp.static(POLISHING)
        elif too_small:
            return why(state, t, found)
        return wp.static(int(Status.NOT_RUN))

    @wp.func(inline=False)
    def polish(state: wp.ref[PathState], t: int, found: int) -> int:
        """Keep the equilibrium where the next step starts, as Newton's method ended there."""
        if found != wp.static(int(Status.CONVERGED)):
            return why(state, t, found)
        state.iterations[t] = state.iterations[t] + state.newton.iterations[t]
        if not alike(state, t, wp.static(BEFORE), wp.static(BEFORE), f64(1.0)):
            state.misled[t] = 1
            return wp.static(int(Status.BRANCH_END))
        state.rough[t] = 0
        set_latest(state, t)
        return wp.static(int(Status.NOT_RUN))

    @wp.func(inline=False)
    def back(state: wp.ref[PathState], t: int):
        """To the latest equilibrium."""
        put(state, t, state.levels[t, 0])
        state.coarsely[t] = 0
        for i in range(state.points.shape[2]):
            state.newton.unknowns[t, i] = state.points[t, 0, i]
        begin(state.newton, t)

    @wp.func(inline=False)
    def go_on(state: wp.ref[PathState], t: int, departing: int):
        """One instance, after its integration, or ``departing`` before the first."""
        status = int(wp.static(int(Status.NOT_RUN)))
        if departing != 0:
            state.step[t] = longest_step(state, t)
        else:
            state.integrations[t] = state.integrations[t] + 1
            if state.known[t] == 0:
                status = arrive(state, t)
            else:
                found = int(wp.static(int(Status.STALLED)))
                probed = int(state.probed[t])
                enough = bool(False)
                if probed == wp.static(LOOKING) or probed == wp.static(LAST_LOOK):
                    if passed_halfway(state, t):
                        enough = probed == wp.static(LAST_LOOK)
                        found = int(wp.static(int(Status.NOT_RUN)))
                        if state.doubted[t] != 0:
                            look_at_quarter(state, t, wp.static(FIRST_QUARTER))
                elif probed == wp.static(FIRST_QUARTER) or probed == wp.static(LAST_QUARTER):
                    if passed_quarter(state, t):
                        found = int(wp.static(int(Status.NOT_RUN)))
                        if probed == wp.static(FIRST_QUARTER):
                            look_at_quarter(state, t, wp.static(LAST_QUARTER))
                else:
                    merit = state.newton.merit[t]
                    most = f64(wp.static(CONTRACTION))
                    if may_doubt(state, t):
                        most = f64(wp.static(DOUBTFUL))
                    found = iterate(state.newton, t, 0, most)
                    few = state.coarsely[t] != 0
                    near = found == wp.static(int(Status.CONVERGED))
                    if few and (near or state.newton.fault[t] != 0):
                        # neither that it is an equilibrium nor that there is none: the same with all steps
                        found = int(wp.static(int(Status.NOT_RUN)))
                        near = False
                        begin_finely(state, t)
                    elif found == wp.static(int(Status.NOT_RUN)) and state.newton.contraction[t] > f64(wp.static(CONTRACTION)):
                        # the ratios after this one are to be as small as ever
                        state.doubted[t] = 1
                        state.newton.contraction[t] = f64(0.0)
                    elif found == wp.static(int(Status.NOT_RUN)) and probed != wp.static(POLISHING):
                        part = left(state, t)
                        near = part <= f64(wp.static(NEAR))
                        enough = near_enough(state, t, part, merit)
                        if few and (near or part < f64(wp.static(UNSETTLED))):
                            begin_finely(state, t)
                    if probed == wp.static(UNSEEN) and near:
                        if wp.static(told) or alike(state, t, wp.static(BEFORE), wp.static(BEFORE), f64(wp.static(CLEARLY))):
                            look_halfway(state, t, wp.where(enough, wp.static(LAST_LOOK), wp.static(LOOKING)))
                            found = int(wp.static(int(Status.NOT_RUN)))
                        else:
                            found = int(wp.static(int(Status.STALLED)))
                        enough = False
                if enough:
                    found = int(wp.static(int(Status.CONVERGED)))
                if found != wp.static(int(Status.NOT_RUN)):
                    if probed == wp.static(POLISHING):
                        status = polish(state, t, found)
                        state.probed[t] = wp.static(UNSEEN)
                    else:
                        status = advance(state, t, found, enough)
                elif state.integrations[t] < state.newton.allowed[t]:
                    wp.atomic_add(state.remaining, 0, 1)
                    return
            if status == wp.static(int(Status.NOT_RUN)) and state.steps[t] >= state.max_steps:
                status = int(wp.static(int(Status.MAX_ITERATIONS)))
            if status == wp.static(int(Status.NOT_RUN)) and state.integrations[t] >= state.newton.allowed[t]:
                status = int(wp.static(int(Status.INTEGRATION_LIMIT)))
        state.status[t] = status
        if status == wp.static(int(Status.NOT_RUN)):
            if state.probed[t] == wp.static(POLISHING):
                back(state, t)
            else:
                aim(state, t)
            wp.atomic_add(state.remaining, 0, 1)
        else:
            state.newton.active[t] = 0
            state.coarsely[t] = 0
            for i in range(state.points.shape[2]):
                state.newton.unknowns[t, i] = state.points[t, 0, i]

    @wp.func
    def integrate(state: wp.ref[PathState], calls: Calls, coarse: Calls):
        """Launch what integrates each instance on its way."""
        count = state.status.shape[0]
        some = int(0)
        others = int(0)
        for t in range(count):
            if state.newton.active[t] == 0:
                state.coarsely[t] = 0
            else:
                some += state.coarsely[t]
                others += 1 - state.coarsely[t]
        if others == 0:
            launch_all(coarse)
        elif some == 0:
            launch_all(calls)
        else:
            for t in range(count):
                if state.newton.active[t] != 0 and state.coarsely[t] == 0:
                    state.newton.active[t] = 0
                    state.coarsely[t] = 2
            launch_all(coarse)
            for t in range(count):
                state.newton.active[t] = wp.where(state.coarsely[t] == 2, 1, 0)
            launch_all(calls)
            for t in range(count):
                state.newton.active[t] = wp.where(state.coarsely[t] != 0, 1, 0)
                state.coarsely[t] = wp.where(state.coarsely[t] == 1, 1, 0)

    @own_module(max_unroll=1)
    def path(state: PathState, calls: Calls, coarse: Calls, rounds: int):
        if rounds == 0:
            t = state.newton.order[wp.tid()]
            if state.newton.active[t] != 0:
                go_on(state, t, state.departing)
            return
        if wp.static(repeats):
            count = state.status.shape[0]
            if state.departing != 0:
                for t in range(count):
                    if state.newton.active[t] != 0:
                        go_on(state, t, 1)
            left = int(1)
            done = int(0)
            while left > 0 and done < rounds:
                state.remaining[0] = 0
                integrate(state, calls, coarse)
                for t in range(count):
                    if state.newton.active[t] != 0:
                        go_on(state, t, 0)
                left = state.remaining[0]
                done += 1

    return path
