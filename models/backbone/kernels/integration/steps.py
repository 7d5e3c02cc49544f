# mypy: ignore-errors
"""Explicit Runge-Kutta steps in lanes, of a size of its own in each: the state first, then its columns through the same places.

Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.integrators import Tableau
from multirod.models.backbone.kernels.layout.layout import Layout, Memory
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)

LONGER, SHORTER = 5.0, 0.2  # most by which a step may grow or shrink
SAFETY = 0.9
TINY = {wp.float64: 1e-300, wp.float32: 1e-36}  # a step as small as that has failed
ROUNDED = {wp.float64: 1e-16, wp.float32: 5e-8}  # and one that is this part of where it begins, which moves nothing
CUT = 1.01  # a step that ends so near before the end of the stretch goes to it
# longest step by which waves of the columns are followed, and of what it is the least, in lengths of the rod
WAVE, SHORTEST_WAVE = 0.6, 1e-3


def make_steps(layout: Layout, memory: Memory, tableau: Tableau, rate: SimpleNamespace, W: int, d) -> SimpleNamespace:
    """The function that takes one step in every lane."""
    L = lanes(W, d)
    Real, fill, row, put, any_less = L.Real, L.fill, L.row, L.put, L.any_less
    absolute, largest, least, where_less, root = L.absolute, L.largest, L.least, L.where_less, L.root
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State = state.type
    part, read_state, write_state, state_where_less = state.part, state.read, state.write, state.where_less
    read_column, write_column = column.read, column.write
    base, columns = L.slopes(layout.state.size, tableau), L.slopes(layout.column.size, tableau)
    Slopes, stage, advance, step_error_of, keep = base.type, base.stage, base.advance, base.error, base.keep
    place_of = base.place
    ColumnSlopes, column_stage, column_advance, keep_column = columns.type, columns.stage, columns.advance, columns.keep
    LAST, LAST_AT = layout.LAST_STRAINS, layout.stretch["strains"]
    read_last, write_last = (L.few(LAST).read, L.few(LAST).write) if LAST else (None, None)
    STAGES = len(tableau.b)
    # the last stages of some methods serve the error estimate only
    COLUMN_STAGES = max(i for i, weight in enumerate(tableau.b) if weight != 0.0) + 1
    ADAPTIVE = len(tableau.error) > 0
    MOMENT, TORQUES = layout.MOMENT, layout.TORQUES
    s, steps, z = layout.state, layout.steps, layout.stretch
    # the moment, or what stands for it where several rods carry none together: their torques
    MOMENT_AT, MOMENT_SIZE = (s["moment"], 3) if MOMENT else (s["torques"], TORQUES)
    UNIT_LENGTH = z["unit_length"]
    UNIT_OF = {"moment": z["unit_moment"], "force": z["unit_force"], "length": UNIT_LENGTH, "1": -1}
    BLOCKS = [(s[slot.name], slot.size, UNIT_OF[slot.unit]) for slot in s.slots if slot.controlled]  # where, how many, by what
    X, LENGTH, SIZE, LEFT = steps["x"], steps["length"], steps["size"], steps["left"]
    ACTIVE, COUNT, REJECTED, LONGEST = steps["active"], steps["count"], steps["rejected"], steps["longest"]
    CONTROLLED = steps["controlled"]
    Z, STATE, PLACE, COLUMNS, COLUMN_SIZE = memory.STRETCH, memory.STATE, memory.PLACES, memory.COLUMNS, memory.COLUMN_SIZE
    GIVEN, PLACE_SIZE = layout.column.size, layout.place.size
    WAVES, FORCE_AT, SEVERAL = layout.features.held or layout.WORLD_STATE, layout.place["force"], layout.TUBES
    spring = rate.spring  # None where no load is one
    SOFT_AT = z["softness"] if SEVERAL else z["compliance"]
    base_rates, column_rates, put_own, NODES = rate.base_rates, rate.column_rates, rate.put_own, layout.NODES
    inverse_root = L.power_root(tableau.order)

    @wp.func
    def block(b: State, first: int, count: int) -> Real:
        """Largest magnitude in a block of the state."""
        size = fill(d(0.0))
        for k in range(count):
            size = largest(size, absolute(part(b, first + k)))
        return size

    @wp.func
    def block_error(e: State, b: State, first: int, count: int, unit: Real, rtol: d, atol: d) -> Real:
        """Error of a block of the state over what is allowed."""
        return block(e, first, count) / (atol * unit + rtol * block(b, first, count))

    @wp.func
    def unit_of(memory: memory_type, z: int, at: int) -> Real:
        """What counts as one: a number of the stretch, or one."""
        if at < 0:
            return fill(d(1.0))
        return row(memory, z + at)

    @wp.func
    def step_error(memory: memory_type, z: int, e: State, b: State, rtol: d, atol: d) -> Real:
        """Largest error of a step over what is allowed, of the state but not of its columns."""
        error = fill(d(0.0))
        for j in range(wp.static(len(BLOCKS))):  # written out: places are constants, or the numbers would go through memory
            unit = unit_of(memory, z, wp.static(BLOCKS[j][2]))
            own = block_error(e, b, wp.static(BLOCKS[j][0]), wp.static(BLOCKS[j][1]), unit, rtol, atol)
            error = largest(error, own)
        total = fill(d(0.0))
        for j in range(wp.static(layout.state.size)):
            total = total + part(e, wp.static(j))
        return error + d(0.0) * total  # the largest of several does not tell what is no number

    @wp.func
    def first_size(memory: memory_type, o: int, b: State, f: State, small: d) -> Real:
        """A step over which the moment changes little."""
        change = block(f, wp.static(MOMENT_AT), wp.static(MOMENT_SIZE)) * row(memory, o + wp.static(Z + UNIT_LENGTH))
        own = block(b, wp.static(MOMENT_AT), wp.static(MOMENT_SIZE)) + small
        longest = row(memory, o + wp.static(LONGEST))
        return least(longest / (d(1.0) + root(change / own)), d(0.1) * longest)

    @wp.func
    def wave_size(memory: memory_type, z: int, a: int) -> Real:
        """Longest step that follows the columns of a held rod, or of one in a medium, under the force at a place, (20b): control
        by a straight rod's state does not see them."""
        force = fill(d(0.0))
        for k in range(3):
            n = row(memory, a + wp.static(FORCE_AT) + k)
            force = force + n * n
        soft = row(memory, z + wp.static(SOFT_AT))
        if wp.static(not SEVERAL):  # of the softer of its axes
            soft = largest(soft, row(memory, z + wp.static(SOFT_AT + 1)))
        rate = soft * root(force)
        if wp.static(spring is not None):
            rate = rate + root(soft * spring(memory, z))
        wave = root(fill(d(1.0)) / rate)
        return largest(d(WAVE) * wave, d(SHORTEST_WAVE) * row(memory, z + wp.static(UNIT_LENGTH)))

    @wp.func
    def column_steps(memory: memory_type, o: int, h: Real, count: int):
        """Each column through the places of the step that was taken."""
        z = o + wp.static(Z)
        for c in range(count):
            at = o + wp.static(COLUMNS) + c * wp.static(COLUMN_SIZE)
            v = read_column(memory, at)
            k = ColumnSlopes()
            for i in range(wp.static(COLUMN_STAGES)):
                a = o + wp.static(PLACE + i * PLACE_SIZE)
                w = column_stage(v, h, k, i)
                keep_column(k, i, column_rates(memory, z, a, at + wp.static(GIVEN), w))
            write_column(memory, at, column_advance(v, h, k))

    @wp.func
    def equal_step(memory: memory_type, o: int, count: int):
        """One of equal steps in every lane; lanes that wait stay."""
        z = o + wp.static(Z)
        b = read_state(memory, o + wp.static(STATE))
        x = row(memory, o + wp.static(X))
        h = row(memory, o + wp.static(ACTIVE)) * row(memory, o + wp.static(SIZE))
        k = Slopes()
        for i in range(wp.static(COLUMN_STAGES)):
            w = stage(b, h, k, i)
            keep(k, i, base_rates(memory, z, o + wp.static(PLACE + i * PLACE_SIZE), x + place_of(i) * h, w))
        write_state(memory, o + wp.static(STATE), advance(b, h, k))
        put(memory, o + wp.static(X), x + h)
        put(memory, o + wp.static(LEFT), row(memory, o + wp.static(LEFT)) - row(memory, o + wp.static(ACTIVE)))
        put(memory, o + wp.static(COUNT), row(memory, o + wp.static(COUNT)) + row(memory, o + wp.static(ACTIVE)))
        column_steps(memory, o, h, count)

    @wp.func
    def controlled_step(memory: memory_type, o: int, count: int, rtol: d, atol: d, small: d):
        """A step in every lane of the size that its error allows, or none where it was too large."""
        z = o + wp.static(Z)
        zero = fill(d(0.0))
        half = fill(d(0.5))
        one = fill(d(1.0))
        b = read_state(memory, o + wp.static(STATE))
        x = row(memory, o + wp.static(X))
        length = row(memory, o + wp.static(LENGTH))
        active = row(memory, o + wp.static(ACTIVE))
        size = row(memory, o + wp.static(SIZE))
        k = Slopes()
        rest = length - x
        last = zero
        step = zero
        for i in range(wp.static(STAGES)):
            w = stage(b, step, k, i)
            f = base_rates(memory, z, o + wp.static(PLACE + i * PLACE_SIZE), x + place_of(i) * step, w)
            keep(k, i, f)
            if wp.static(i == 0):
                if any_less(size, zero):
                    size = where_less(size, zero, first_size(memory, o, b, f, small), size)
                if wp.static(WAVES):  # but of equal steps
                    wave = least(wave_size(memory, z, o + wp.static(PLACE)), size)
                    size = where_less(half, row(memory, o + wp.static(CONTROLLED)), wave, size)
                last = where_less(d(CUT) * size, rest, zero, one)
                step = active * where_less(half, last, rest, size)
        trial = advance(b, step, k)
        controlled = row(memory, o + wp.static(CONTROLLED))
        error = controlled * step_error(memory, z, step_error_of(step, k), trial, rtol, atol)
        # false for what is no number
        taken = where_less(error, fill(d(1.0)), active, zero)
        put(memory, o + wp.static(COUNT), row(memory, o + wp.static(COUNT)) + active)
        write_state(memory, o + wp.static(STATE), state_where_less(half, taken, trial, b))
        put(memory, o + wp.static(X), where_less(half, taken * last, length, x + taken * step))
        put(memory, o + wp.static(LEFT), where_less(half, taken * last, zero, row(memory, o + wp.static(LEFT))))
        # no longer just after a rejected step
        factor = d(SAFETY) * inverse_root(largest(error, fill(d(1.0e-8))))
        factor = largest(least(factor, fill(d(LONGER))), fill(d(SHORTER)))
        factor = where_less(error, fill(d(1.0e30)), factor, fill(d(SHORTER)))
        factor = where_less(half, taken * row(memory, o + wp.static(REJECTED)), least(factor, one), factor)
        put(memory, o + wp.static(REJECTED), active - taken)
        # a step cut short by a node says little about how long the next may be
        next_size = step * factor
        cut = where_less(next_size, size, where_less(factor, one, next_size, size), next_size)
        next_size = where_less(half, taken * last, cut, next_size)
        next_size = where_less(controlled, half, where_less(half, taken, size, next_size), next_size)
        put(memory, o + wp.static(SIZE), where_less(half, active, next_size, size))
        if count > 0 and any_less(half, taken):
            column_steps(memory, o, taken * step, count)

    @wp.func
    def least_size(memory: memory_type, o: int) -> Real:
        """A step that is shorter leads nowhere."""
        return fill(d(wp.static(TINY[d]))) + d(wp.static(ROUNDED[d])) * row(memory, o + wp.static(X))

    @wp.func
    def record_here(memory: memory_type, o: int):
        """The record of the place where each lane stands."""
        b = read_state(memory, o + wp.static(STATE))
        base_rates(memory, o + wp.static(Z), o + wp.static(PLACE), row(memory, o + wp.static(X)), b)
        if wp.static(NODES):
            put_own(memory, o + wp.static(Z), o + wp.static(PLACE), b)

    @wp.func
    def record_aside(memory: memory_type, o: int):
        """The same; where the next strains are sought from, (L20), stays as it was, or what a lane finds would depend on where
        the others stop, in its last digits."""
        last = read_last(memory, o + wp.static(Z + LAST_AT))
        record_here(memory, o)
        write_last(memory, o + wp.static(Z + LAST_AT), last)

    place_here = record_aside if LAST else record_here
    return SimpleNamespace(
        equal_step=equal_step, controlled_step=controlled_step if ADAPTIVE else None, place_here=place_here,
        least_size=least_size,
    )  # fmt: skip
