# mypy: ignore-errors
"""How many unstable modes concentric tubes can have, one robot a thread. Numbers: ``docs/stability.md``."""

from functools import cache

import warp as wp

from multirod.kernels.linear_algebra_kernels import jacobi
from multirod.kernels.own_module import own_module

f64 = wp.float64
LEAST = 1e-300  # work of what nothing pulls
# rows of numbers of each rod: C where the last two part, d, the torque carried, C at the end of a stretch and where it starts
HELD, D, TORQUE, AFTER, BEFORE = range(ROWS := 5)


@wp.struct
class Bounds:
    """What is asked, and room to work in; the first axis is the instance but where it is said to be that of the rods."""

    inputs: wp.array2d[wp.float64]  # of the problem
    first: int  # where the translations stand in a row of these
    stride: int  # 1 where each instance has rods of its own, 0 where all are of the same
    end: wp.array3d[wp.float64]  # (rods, n, section): of sections, from the start of their rod [m]
    compliance: wp.array3d[wp.float64]  # the same: 1/GJ [1/(N m^2)]
    EI: wp.array3d[wp.float64]  # [N m^2]
    kappa: wp.array3d[wp.float64]  # |u*_xy| [1/m]
    force: wp.array[wp.float64]  # bound of the internal force [N]
    cuts: wp.array2d[wp.float64]  # (batch, n section + 1): where anything but compliances changes [m]
    together: wp.array2d[wp.float64]  # (batch, stretch): sum of EI, 0 where there is nothing
    bend: wp.array3d[wp.float64]  # (batch, stretch, n): k of (13)
    rows: wp.array3d[wp.float64]  # (batch, ROWS, n)
    whole: wp.array3d[wp.float64]  # (batch, n, n)
    matrix: wp.array3d[wp.float64]
    vectors: wp.array3d[wp.float64]
    bounds: wp.array2d[wp.float64]  # (batch, 2): b_1 and b_2


@wp.func
def start_of(b: wp.ref[Bounds], t: int, i: int) -> f64:
    return b.inputs[t, b.first + i]


@wp.func
def twist(b: wp.ref[Bounds], t: int, i: int, s: f64) -> f64:
    """C: how far a unit torque at ``s`` twists a rod there."""
    g = t * b.stride
    result = f64(0.0)
    begin = start_of(b, t, i)
    start = begin
    for m in range(b.end.shape[2]):
        end = start + b.end[g, i, m]
        result += wp.min(wp.max(s - begin, f64(0.0)), end - begin) * b.compliance[g, i, m]
        begin = end
    return result


@wp.func
def cut(b: wp.ref[Bounds], t: int) -> f64:
    """Where stretches end, in their order; returns where the last but one of the rods ends."""
    g = t * b.stride
    sections = b.end.shape[2]
    b.cuts[t, 0] = f64(0.0)
    count = int(1)
    longest = f64(-wp.inf)
    second = f64(-wp.inf)
    for i in range(b.end.shape[1]):
        for m in range(sections):
            place = wp.max(start_of(b, t, i) + b.end[g, i, m], f64(0.0))
            k = int(count)
            while k > 0 and b.cuts[t, wp.max(k - 1, 0)] > place:
                b.cuts[t, k] = b.cuts[t, k - 1]
                k -= 1
            b.cuts[t, k] = place
            count += 1
        tip = start_of(b, t, i) + b.end[g, i, sections - 1]
        second = wp.max(second, wp.min(tip, longest))
        longest = wp.max(longest, tip)
    return second


@wp.func
def see(b: wp.ref[Bounds], t: int, k: int):
    """What of the rods is in a stretch."""
    g = t * b.stride
    size = b.cuts[t, k + 1] - b.cuts[t, k]
    middle = b.cuts[t, k] + f64(0.5) * size
    total = f64(0.0)
    for i in range(b.end.shape[1]):
        start = start_of(b, t, i)
        begin = start
        own = f64(0.0)
        for m in range(b.end.shape[2]):
            end = start + b.end[g, i, m]
            if size > f64(0.0) and not (middle < begin or middle >= end):
                total += b.EI[g, i, m]
                own = b.EI[g, i, m] * b.kappa[g, i, m]
            begin = end
        b.bend[t, k, i] = own
    b.together[t, k] = total


@wp.func
def largest(b: wp.ref[Bounds], t: int) -> int:
    """Of the eigenvalues of ``matrix``, which are on its diagonal then."""
    n = b.end.shape[1]
    jacobi(b.matrix, b.vectors, t, n)
    best = int(0)
    for i in range(1, n):
        if b.matrix[t, i, i] > b.matrix[t, best, best]:
            best = i
    return best


@wp.func
def turned(b: wp.ref[Bounds], t: int, i: int, row: int) -> f64:
    """r of a rod, by its C in a row."""
    return wp.min(b.rows[t, row, i], b.rows[t, wp.static(HELD), i]) * b.rows[t, wp.static(D), i]


@wp.func
def traced(b: wp.ref[Bounds], t: int):
    """(14), the trace of (15), and what dead forces add to both; ``whole`` is the sum of all stretches' matrices."""
    n = b.end.shape[1]
    stretches = b.cuts.shape[1] - 1
    last = b.cuts[t, stretches]
    force = b.force[t]
    for i in range(n):
        for j in range(n):
            b.whole[t, i, j] = f64(0.0)
    first = f64(0.0)
    trace = f64(0.0)
    load = f64(0.0)
    squared = f64(0.0)
    bent = f64(0.0)
    for k in range(stretches):
        see(b, t, k)
        if b.together[t, k] > f64(0.0):
            size = b.cuts[t, k + 1] - b.cuts[t, k]
            middle = b.cuts[t, k] + f64(0.5) * size
            share = size / b.together[t, k]
            pull = f64(0.0)
            most = f64(0.0)
            for i in range(n):
                own = twist(b, t, i, middle)
                pull += b.bend[t, k, i]
                most = wp.max(most, own * b.bend[t, k, i])
                b.rows[t, wp.static(BEFORE), i] = own
            for i in range(n):
                own = b.rows[t, wp.static(BEFORE), i]
                for j in range(n):
                    rooted = wp.sqrt(own * b.rows[t, wp.static(BEFORE), j])
                    b.matrix[t, i, j] = -share * b.bend[t, k, i] * b.bend[t, k, j] * rooted
                b.matrix[t, i, i] = share * b.bend[t, k, i] * (pull - b.bend[t, k, i]) * own
                trace += b.matrix[t, i, i]
            for i in range(n):
                for j in range(n):
                    b.whole[t, i, j] += b.matrix[t, i, j]
            best = largest(b, t)
            first += b.matrix[t, best, best]
            # the force turns the frame, the moment bends what pulls
            moment = force * (last - middle)
            along = bent + f64(0.5) * share
            load += size * force * along + moment * share * most
            squared += moment * moment * along * share
            bent += share
    return first, trace, load + wp.sqrt(squared)


@wp.func
def quotient(b: wp.ref[Bounds], t: int, second: f64) -> f64:
    """Schwarz's of (15), which the first eigenvalue is no less than; ``second`` is s_p."""
    n = b.end.shape[1]
    stretches = b.cuts.shape[1] - 1
    for i in range(n):
        for j in range(n):
            b.matrix[t, i, j] = b.whole[t, i, j]
    best = largest(b, t)
    for i in range(n):
        held = twist(b, t, i, second)
        b.rows[t, wp.static(HELD), i] = held
        b.rows[t, wp.static(D), i] = f64(0.0)
        if held > f64(0.0):
            b.rows[t, wp.static(D), i] = b.vectors[t, i, best] / wp.sqrt(held)
        b.rows[t, wp.static(TORQUE), i] = f64(0.0)
        b.rows[t, wp.static(AFTER), i] = twist(b, t, i, b.cuts[t, stretches])
    work = f64(0.0)
    stored = f64(0.0)
    for back in range(stretches):
        k = stretches - 1 - back
        if b.together[t, k] > f64(0.0):
            share = (b.cuts[t, k + 1] - b.cuts[t, k]) / b.together[t, k]
            pull = f64(0.0)
            left = f64(0.0)
            right = f64(0.0)
            for i in range(n):
                b.rows[t, wp.static(BEFORE), i] = twist(b, t, i, b.cuts[t, k])
                pull += b.bend[t, k, i]
                left += b.bend[t, k, i] * turned(b, t, i, wp.static(BEFORE))
                right += b.bend[t, k, i] * turned(b, t, i, wp.static(AFTER))
            for i in range(n):
                r0 = turned(b, t, i, wp.static(BEFORE))
                r1 = turned(b, t, i, wp.static(AFTER))
                # P r at both ends, between which it is linear, times their distance
                a = share * b.bend[t, k, i] * (pull * r0 - left)
                c = share * b.bend[t, k, i] * (pull * r1 - right)
                work += (a * (f64(2.0) * r0 + r1) + c * (r0 + f64(2.0) * r1)) / f64(6.0)
                # tau, quadratic between them
                torque = b.rows[t, wp.static(TORQUE), i]
                rise = f64(0.5) * (c - a)
                square = torque * (torque + a + f64(4.0) / f64(3.0) * rise)
                square += a * (a / f64(3.0) + f64(5.0) / f64(6.0) * rise) + f64(8.0) / f64(15.0) * rise * rise
                stored += (b.rows[t, wp.static(AFTER), i] - b.rows[t, wp.static(BEFORE), i]) * square
                b.rows[t, wp.static(TORQUE), i] = torque + a + rise
                b.rows[t, wp.static(AFTER), i] = b.rows[t, wp.static(BEFORE), i]
    for i in range(n):  # behind the plate
        stored += twist(b, t, i, f64(0.0)) * b.rows[t, wp.static(TORQUE), i] * b.rows[t, wp.static(TORQUE), i]
    return stored / wp.max(work, f64(wp.static(LEAST)))


@cache
def make_mode_bounds():
    """The kernel that finds both bounds."""

    @own_module(max_unroll=1)
    def mode_bounds(b: Bounds):
        t = wp.tid()
        second = cut(b, t)
        first, trace, load = traced(b, t)
        b.bounds[t, 0] = first + load
        b.bounds[t, 1] = trace - quotient(b, t, second) + load

    return mode_bounds
