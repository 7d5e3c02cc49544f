# mypy: ignore-errors
"""States and columns at given arclengths along the rods, each with its rate there; ``docs/derivatives.md``, (D11)."""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.arguments import END, END_MOVER, OUTPUT, Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout, Memory
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors

f64 = wp.float64


def make_given_places(grid: SimpleNamespace) -> SimpleNamespace:
    """Of the grid, whose output nodes stand where they are asked for, the base aside."""
    Sections, section_end, find_end = grid.Sections, grid.section_end, grid.find_end

    @wp.func
    def given_arclength(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], output: int) -> f64:
        """Where an output node is; past the last there are none."""
        if output < call.node_count:
            return call.node_arclength[case.index, output]
        return f64(wp.inf)

    @wp.func(inline=False)
    def find_end_or_place(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], p: int, sections: Sections):
        """As ``find_end``; a place that is asked for does not move."""
        find_end(rods, call, case, p, sections)
        mover = int(-1)
        for i in range(rods.end.shape[1]):
            m = sections[i]
            if m < rods.end.shape[2]:
                if section_end(rods, call, case, i, m) == call.lane[p, END]:
                    mover = i
        call.lane[p, END_MOVER] = f64(mover)

    return SimpleNamespace(output_arclength=given_arclength, find_end=find_end_or_place)


def make_along(layout: Layout, memory: Memory, rates: SimpleNamespace, parts: SimpleNamespace, W: int, d):
    """The function that a lane calls at the end of a stretch, in the place of ``at_end``: columns first."""
    L = lanes(W, d)
    row, one_of = L.row, L.one
    memory_type, Vec3 = wp.array(dtype=d), vectors(W, d).Vec3
    column = L.few(layout.column.size)
    read_column, part_of = column.read, column.part
    SIZE, GROWTH, RATE = layout.column.size, layout.given["growth"], layout.place["rate"]
    Z, PLACE, COLUMNS, COLUMN_SIZE = memory.STRETCH, memory.PLACES, memory.COLUMNS, memory.COLUMN_SIZE
    s, c = layout.state, layout.column
    Q_AT, P_AT, DQ_AT, DP_AT = s["frame"], s["position"], c["frame"], c["position"]
    column_rates, at_end, output_arclength = rates.column_rates, parts.at_end, parts.output_arclength
    wrench, wrench_variation, WRENCH = rates.along.wrench, rates.along.variation, 2 * layout.column.size
    state_in, first_column, column_count = parts.state_in, parts.first_column, parts.column_count

    @wp.func
    def write_wrench(call: wp.ref[Call], t: int, output: int, column: int, n: Vec3, m: Vec3, l: int):
        """Force, then moment, into a column."""
        w = wp.static(WRENCH)
        call.node_columns[t, output, w, column] = f64(one_of(n.x, l))
        call.node_columns[t, output, w + 1, column] = f64(one_of(n.y, l))
        call.node_columns[t, output, w + 2, column] = f64(one_of(n.z, l))
        call.node_columns[t, output, w + 3, column] = f64(one_of(m.x, l))
        call.node_columns[t, output, w + 4, column] = f64(one_of(m.y, l))
        call.node_columns[t, output, w + 5, column] = f64(one_of(m.z, l))

    @wp.func(inline=False)
    def write_columns(call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, o: int, l: int, job: int, output: int):
        """(D11), (D25) The columns of a lane, then the state, at a place that does not move; their rates and what the rods carry
        follow them."""
        t = case.index
        y = state_in(case, memory, o, l)
        a = o + wp.static(PLACE)
        for k in range(column_count(call, job)):
            at = o + wp.static(COLUMNS) + k * wp.static(COLUMN_SIZE)
            g = at + wp.static(SIZE)
            v = read_column(memory, at)
            f = column_rates(memory, o + wp.static(Z), o + wp.static(PLACE), g, v)
            growth = row(memory, g + wp.static(GROWTH))
            for j in range(wp.static(SIZE)):
                rate = part_of(f, wp.static(j)) - growth * row(memory, o + wp.static(PLACE + RATE + j))
                call.node_columns[t, output, wp.static(j), first_column(call, job) + k] = f64(one_of(part_of(v, wp.static(j)), l))
                call.node_columns[t, output, wp.static(SIZE + j), first_column(call, job) + k] = f64(one_of(rate, l))
            dn, dm = wrench_variation(memory, o + wp.static(Z), a, g, v)
            write_wrench(call, t, output, first_column(call, job) + k, dn, dm, l)
        last = call.unknown_columns + call.direction_columns
        for j in range(wp.static(SIZE)):
            value = f64(0.0)
            if wp.static(DQ_AT < 0 or j < DQ_AT):
                value = y[wp.static(j)]
            elif wp.static(DP_AT < 0 or j < DP_AT):
                value = y[wp.static(Q_AT + j - DQ_AT)]
            else:
                value = y[wp.static(P_AT + j - DP_AT)]
            call.node_columns[t, output, wp.static(j), last] = value
            rate = row(memory, o + wp.static(PLACE + RATE + j))
            call.node_columns[t, output, wp.static(SIZE + j), last] = f64(one_of(rate, l))
        n, m = wrench(memory, a)
        write_wrench(call, t, output, last, n, m, l)

    @wp.func(inline=False)
    def at_given(
        rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, o: int, l: int, p: int, job: int
    ):
        """A lane at the end of its stretch."""
        output = int(call.lane[p, OUTPUT]) + 1
        if output < call.node_count and call.lane[p, END] >= output_arclength(rods, call, case, output):
            write_columns(call, case, memory, o, l, job, output)
        at_end(rods, call, case, memory, o, l, p, job)

    return at_given
