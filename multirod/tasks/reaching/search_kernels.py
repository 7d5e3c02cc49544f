# mypy: ignore-errors
"""The way of a search between two integrations, one instance a thread. Numbers in parentheses: ``docs/tasks.md``."""

from functools import cache

import warp as wp

from multirod.kernels.own_module import own_module
from multirod.kernels.repeated_kernels import Calls, launch_all
from multirod.status import Status
from multirod.tasks.reaching.drive_kernels import (
    LEAST,
    LENGTH,
    PART,
    PULLED,
    RESUMED,
    ROUGH,
    SHAPED,
    TOLERANCE,
    Drive,
    accept,
    at_limit,
    left,
    put,
    put_place,
    solve_step,
    step_size,
)

f64 = wp.float64
LOST = 100.0  # of what was left when a part of the way began, from which it is given up
SHORTENED = 0.25  # what is left of a step that was taken back, or of a part of the way
LEAST_STEP = 0.01  # of a step
AT_REST = 1e-7  # a step in units (9) that is none
IN_PLACE = 1e-3  # the same of what the target leaves free
LOOSE = 1e3  # tolerances of places on the way, in those of the target
NEARLY = 3e-3  # of what is left, in lengths or the scale of curvatures, from which the next integration is no coarse one
MOST_ROUGH = 8  # steps by coarse ones
MOST_STEPS = 40  # towards one goal
MOST_LIMITED = 100  # of those that swing along limits
PLACES = 12  # steps that a target that is reached gets for what it leaves free

# of an instance: ended; under way; to begin
ENDED, OPEN, BEGINNING = 0, 1, 2
# what only the host can tell, before an instance goes on: nothing; whether the shape is beyond its limits at the end of a part of
# the way, where a limit holds, at rest on the way
NOTHING, ARRIVED, HELD, AHEAD = 0, 1, 2, 3
NOT_REACHED = -1  # a status that the host makes another of


@wp.func
def infinite() -> f64:
    return f64(wp.inf)


@wp.func
def end(s: wp.ref[Drive], t: int, status: int):
    s.status[t] = status
    s.phase[t] = wp.static(ENDED)


@wp.func(inline=False)
def begin(s: wp.ref[Drive], t: int, rough: int):
    """A drive, from ``start``."""
    put_place(s.last_x, s.last_p, s.start_x, s.start_p, t)
    put_place(s.base_x, s.base_p, s.start_x, s.start_p, t)
    put_place(s.here_x, s.here_p, s.start_x, s.start_p, t)
    s.rough[t] = rough
    s.roughly[t] = rough
    s.done[t] = f64(0.0)
    s.part[t] = s.settings[wp.static(PART)]
    s.goal[t] = s.part[t]
    s.damping[t] = f64(1.0)
    s.merit[t] = infinite()
    s.fresh[t] = 1
    s.begun[t] = 0
    s.steps[t] = 0
    s.settling[t] = 0
    s.limited[t] = 0
    s.blocked[t] = 0
    s.folded[t] = 0
    s.asked[t] = wp.static(NOTHING)
    s.status[t] = wp.static(int(Status.NOT_RUN))
    s.phase[t] = wp.static(OPEN)


@wp.func
def by_coarse(s: wp.ref[Drive], t: int) -> int:
    """Whether a drive begins by coarse integrations: one that goes all the way at once, and is asked nothing on it, nor ends
    before they do."""
    whole = s.settings[wp.static(PART)] == f64(1.0) and s.settings[wp.static(ROUGH)] != f64(0.0)
    whole = whole and s.allowed[t] - s.integrations[t] >= wp.static(MOST_STEPS)
    if whole and s.settings[wp.static(SHAPED)] == f64(0.0) and s.settings[wp.static(PULLED)] == f64(0.0):
        return 1
    return 0


@wp.func(inline=False)
def shorten(s: wp.ref[Drive], t: int):
    """Try a shorter part of the way, from where the last one ended; without coarse integrations, the start's own too."""
    s.rough[t] = 0
    if s.roughly[t] != 0:
        s.begun[t] = 0
    s.part[t] = s.part[t] * f64(wp.static(SHORTENED))
    if s.part[t] < s.settings[wp.static(LEAST)]:
        put_place(s.last_x, s.last_p, s.base_x, s.base_p, t)
        put(s.errors, s.base_errors, t)
        end(s, t, wp.where(s.blocked[t] != 0, wp.static(int(Status.AT_LIMIT)), wp.static(NOT_REACHED)))
    else:
        put_place(s.here_x, s.here_p, s.base_x, s.base_p, t)
        s.goal[t] = wp.min(f64(1.0), s.done[t] + s.part[t])
        s.fresh[t] = 1
        s.damping[t] = f64(1.0)
        s.steps[t] = 0
        s.merit[t] = infinite()


@wp.func(inline=False)
def go(s: wp.ref[Drive], t: int):
    """To where the last step leads, or a part of it."""
    k = s.unit.shape[0]
    for i in range(s.here_x.shape[1]):
        total = s.towards[t, i]
        if s.limited[t] != 0:  # a part of the way, from an equilibrium
            total = total / s.damping[t]
        for j in range(k):
            total += s.by[t, i, j] * s.change[t, j]
        s.here_x[t, i] = s.last_x[t, i] + s.damping[t] * total
    for j in range(k):
        s.here_p[t, j] = s.last_p[t, j] + s.damping[t] * s.unit[j] * s.change[t, j]


@wp.func
def retreat(s: wp.ref[Drive], t: int):
    """Take back a part of the last step, or all of this part of the way."""
    s.damping[t] = s.damping[t] * f64(wp.static(SHORTENED))
    if s.fresh[t] != 0 or s.damping[t] < f64(wp.static(LEAST_STEP)):
        shorten(s, t)
    else:
        go(s, t)


@wp.func
def on(s: wp.ref[Drive], t: int):
    """The next part of the way, from where an instance is."""
    put_place(s.base_x, s.base_p, s.last_x, s.last_p, t)
    put(s.base_errors, s.errors, t)
    s.done[t] = s.goal[t]
    s.part[t] = wp.min(f64(1.0), f64(2.0) * s.part[t])
    s.goal[t] = wp.min(f64(1.0), s.done[t] + s.part[t])
    s.steps[t] = 0


@wp.func(inline=False)
def arrive(s: wp.ref[Drive], t: int, asked: int) -> bool:
    """What is at its goal is done, or gets the next; whether a step is to follow."""
    final = s.goal[t] == f64(1.0)
    scale = wp.where(final, f64(1.0), f64(wp.static(LOOSE)))
    if left(s, s.errors, t) > scale * s.settings[wp.static(TOLERANCE)]:
        return True
    if s.residual[t] > scale * s.residual_tolerance[t]:
        return True
    # past a fold: the sign of det Gamma is that of the start no more
    wrong = s.sign[t] != s.first_sign[t]
    if asked == wp.static(NOTHING):
        if wrong and final:
            s.folded[t] = 1
            put_place(s.fold_x, s.fold_p, s.last_x, s.last_p, t)
        if not wrong and s.settings[wp.static(SHAPED)] != f64(0.0):
            s.asked[t] = wp.static(ARRIVED)
            return False
    if asked == wp.static(ARRIVED):
        s.blocked[t] = s.verdict[t]
        wrong = s.verdict[t] != 0
    if wrong and s.roughly[t] != 0:
        begin(s, t, 0)
        return False
    if wrong:  # on to the nearer goal from here, not from where the last part ended: measured, fewer got there so
        shorten(s, t)
        return s.phase[t] == wp.static(OPEN)
    if not final:
        on(s, t)
        return True
    # what the target leaves free may need a few steps more
    if s.settings[wp.static(PULLED)] != f64(0.0):
        solve_step(s, t)
        s.settling[t] = s.settling[t] + 1
        if step_size(s, t) > f64(wp.static(IN_PLACE)) and s.settling[t] <= wp.static(PLACES):
            return True
    end(s, t, wp.static(int(Status.REACHED)))
    return False


@wp.func
def rest_at_target(s: wp.ref[Drive], t: int, asked: int):
    """Steps towards the target itself have come to rest and it is not reached."""
    if asked == wp.static(NOTHING):
        if not at_limit(s, t):
            end(s, t, wp.static(NOT_REACHED))
            return
        if s.settings[wp.static(SHAPED)] != f64(0.0):
            s.asked[t] = wp.static(HELD)
            return
    if asked == wp.static(HELD) and s.verdict[t] != 0:
        s.blocked[t] = 1
        shorten(s, t)
        return
    end(s, t, wp.static(int(Status.AT_LIMIT)))


@wp.func(inline=False)
def rest(s: wp.ref[Drive], t: int, asked: int):
    """Steps have come to rest, or are too many."""
    if s.goal[t] == f64(1.0):
        rest_at_target(s, t, asked)
        return
    # what is as near to a place on the way as it comes goes for the target itself, or on if a limit of the shape lies ahead
    if s.blocked[t] != 0:
        if asked == wp.static(NOTHING):
            s.asked[t] = wp.static(AHEAD)
            return
        if s.verdict[t] != 0:
            shorten(s, t)
            return
        on(s, t)
    else:
        s.goal[t] = f64(1.0)
        s.steps[t] = 0
        s.merit[t] = infinite()
        solve_step(s, t)
    go(s, t)


@wp.func(inline=False)
def advance(s: wp.ref[Drive], t: int):
    """Take the next step, or come to rest where there is none."""
    bends = f64(0.0)
    for i in range(s.towards.shape[1]):
        bends = wp.max(bends, wp.abs(s.towards[t, i]))
    bends = bends / s.curvature[t]
    s.merit[t] = wp.max(s.settings[wp.static(LENGTH)] * left(s, s.r, t), bends)
    if s.steps[t] == 0:
        s.first_merit[t] = s.merit[t]
    if s.merit[t] > f64(wp.static(LOST)) * s.first_merit[t]:
        shorten(s, t)
        return
    solve_step(s, t)
    s.steps[t] = s.steps[t] + 1
    if s.rough[t] != 0:
        if s.merit[t] <= f64(wp.static(NEARLY)) or s.steps[t] >= wp.static(MOST_ROUGH):
            s.rough[t] = 0
            s.merit[t] = infinite()  # is of other equations
        go(s, t)
        return
    still = step_size(s, t) <= f64(wp.static(AT_REST)) and bends <= f64(wp.static(AT_REST))
    if still:
        total = f64(0.0)
        for i in range(s.r.shape[1]):
            over = s.step.r[t, i]
            for j in range(s.change.shape[1]):
                over += s.J[t, i, j] * s.change[t, j]
            total += over * over
        still = wp.sqrt(total) > s.settings[wp.static(TOLERANCE)]
    if still or s.steps[t] > wp.where(s.limited[t] != 0, wp.static(MOST_LIMITED), wp.static(MOST_STEPS)):
        rest(s, t, wp.static(NOTHING))
    else:
        go(s, t)


@wp.func
def proceed(s: wp.ref[Drive], t: int):
    """From an integration, or what the host said after it, to the next one's place."""
    asked = s.asked[t]
    s.asked[t] = wp.static(NOTHING)
    if asked == wp.static(NOTHING):
        s.integrations[t] = s.integrations[t] + 1
        if not accept(s, t):
            retreat(s, t)
        elif s.rough[t] != 0:
            advance(s, t)
        elif arrive(s, t, asked):
            advance(s, t)
    elif asked == wp.static(ARRIVED):
        if arrive(s, t, asked):
            advance(s, t)
    else:
        rest(s, t, asked)
    if s.asked[t] == wp.static(NOTHING) and s.phase[t] == wp.static(OPEN) and s.integrations[t] >= s.allowed[t]:
        end(s, t, wp.static(int(Status.INTEGRATION_LIMIT)))


@wp.func(inline=False)
def attend(s: wp.ref[Drive], t: int):
    """One instance, after its integration."""
    if s.phase[t] == wp.static(BEGINNING):
        begin(s, t, by_coarse(s, t))
    elif s.phase[t] == wp.static(OPEN):
        if s.settings[wp.static(RESUMED)] == f64(0.0) or s.asked[t] != wp.static(NOTHING):
            proceed(s, t)
    if s.phase[t] == wp.static(OPEN):
        wp.atomic_add(s.count, 0, 1)
        if s.asked[t] != wp.static(NOTHING):
            wp.atomic_add(s.count, 1, 1)
        put(s.task.unknowns, s.here_x, t)
        for j in range(s.unit.shape[0]):
            s.task.inputs[t, s.task.places[j]] = s.here_p[t, j]


@wp.func
def integrate(s: wp.ref[Drive], calls: Calls, coarse: Calls):
    """Launch what integrates each instance under way: of those that are active, as those are that have not ended."""
    some = int(0)
    others = int(0)
    for t in range(s.phase.shape[0]):
        if s.phase[t] == wp.static(OPEN):
            some += s.rough[t]
            others += 1 - s.rough[t]
    if some == 0:
        launch_all(calls)
    elif others == 0:
        launch_all(coarse)
    else:
        for t in range(s.phase.shape[0]):
            s.active[t] = wp.where(s.phase[t] == wp.static(OPEN), s.rough[t], 0)
        launch_all(coarse)
        for t in range(s.phase.shape[0]):
            s.active[t] = wp.where(s.phase[t] == wp.static(OPEN), 1 - s.rough[t], 0)
        launch_all(calls)
        for t in range(s.phase.shape[0]):
            s.active[t] = wp.where(s.phase[t] == wp.static(OPEN), 1, 0)


@cache
def make_search(repeats: bool):
    """Kernel for all that a search does between two integrations.

    Where it ``repeats``, one thread may do all: with ``rounds``, it has an integration launched so many times at most, and goes
    on after each, until an instance ends or asks; what is to begin begins before.
    """

    @own_module(max_unroll=1)
    def search(s: Drive, calls: Calls, coarse: Calls, rounds: int):
        if rounds == 0:
            attend(s, wp.tid())
            return
        if wp.static(repeats):
            begun = int(0)
            for t in range(s.phase.shape[0]):
                if s.phase[t] == wp.static(BEGINNING):
                    if begun == 0:
                        s.count[0] = 0
                        s.count[1] = 0
                    begun = 1
                    attend(s, t)
            under_way = s.count[0]
            done = int(0)
            while done < rounds and s.count[0] == under_way and s.count[1] == 0:
                integrate(s, calls, coarse)
                s.count[0] = 0
                s.count[1] = 0
                for t in range(s.phase.shape[0]):
                    attend(s, t)
                done += 1

    return search
