# mypy: ignore-errors
"""The state of one lane and its columns, in SI units and double precision, from and to the lanes' numbers."""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.arguments import Instance
from multirod.models.backbone.kernels.layout.layout import Layout, Memory
from multirod.models.backbone.kernels.numbers.lanes import lanes

f64 = wp.float64


def make_records(layout: Layout, memory: Memory, base: SimpleNamespace, grid: SimpleNamespace, W: int, d) -> SimpleNamespace:
    """Functions that read and write what a lane carries."""
    get_lane = lanes(W, d).get
    memory_type = wp.array(dtype=d)
    State, Column = base.State, base.Column
    set_number = grid.set_number
    SINGLE, GIVEN_FORCE = d is wp.float32, layout.GIVEN_FORCE
    STATE, COLUMNS, COLUMN_SIZE, GIVEN = memory.STATE, memory.COLUMNS, memory.COLUMN_SIZE, layout.column.size
    UNIT, GIVEN_FORCE_AT = layout.given["unit"], layout.given["force"]

    def make_unit(units: list[str]):
        """What number j of a record is counted in; of a column, its own unit aside."""

        @wp.func
        def unit_of(case: wp.ref[Instance], j: int) -> f64:
            unit = f64(1.0)
            if wp.static(SINGLE):
                for k in range(wp.static(len(units))):
                    if j == k:
                        if wp.static(units[k] == "moment"):
                            unit = case.moment
                        if wp.static(units[k] == "force"):
                            unit = case.force
                        if wp.static(units[k] == "length"):
                            unit = case.unit
            return unit

        return unit_of

    state_unit, column_unit = make_unit(layout.state.units()), make_unit(layout.column.units())

    @wp.func
    def state_in(case: wp.ref[Instance], memory: memory_type, o: int, l: int) -> State:
        """The state of a lane, in SI units."""
        y = State()
        for j in range(wp.static(layout.state.size)):
            y[j] = state_unit(case, j) * f64(get_lane(memory, o + wp.static(STATE) + j, l))
        return y

    @wp.func
    def column_in(case: wp.ref[Instance], memory: memory_type, o: int, l: int, c: int) -> Column:
        """One of its columns."""
        v = Column()
        at = o + wp.static(COLUMNS) + c * wp.static(COLUMN_SIZE)
        unit = f64(1.0)
        if wp.static(SINGLE):
            unit = f64(get_lane(memory, at + wp.static(GIVEN + UNIT), l))
        for j in range(wp.static(layout.column.size)):
            v[j] = unit * column_unit(case, j) * f64(get_lane(memory, at + j, l))
        return v

    @wp.func
    def force_column_in(case: wp.ref[Instance], memory: memory_type, o: int, l: int, c: int) -> wp.vec3d:
        """dn of a column where the lane's stretch begins."""
        dn = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        if wp.static(GIVEN_FORCE):
            at = o + wp.static(COLUMNS + GIVEN) + c * wp.static(COLUMN_SIZE)
            unit = case.force
            if wp.static(SINGLE):
                unit = case.force * f64(get_lane(memory, at + wp.static(UNIT), l))
            for j in range(3):
                dn[j] = unit * f64(get_lane(memory, at + wp.static(GIVEN_FORCE_AT) + j, l))
        return dn

    @wp.func(inline=False)
    def put_state(case: wp.ref[Instance], memory: memory_type, o: int, l: int, y: State):
        """The state to a lane."""
        for j in range(wp.static(layout.state.size)):
            set_number(memory, o + wp.static(STATE) + j, l, y[j] / state_unit(case, j))

    @wp.func(inline=False)
    def put_column(case: wp.ref[Instance], memory: memory_type, o: int, l: int, c: int, v: Column, dn: wp.vec3d):
        """A column and its dn to a lane."""
        at = o + wp.static(COLUMNS) + c * wp.static(COLUMN_SIZE)
        unit = f64(1.0)
        if wp.static(SINGLE):
            size = f64(0.0)
            for j in range(wp.static(layout.column.size)):
                size = wp.max(size, wp.abs(v[j]) / column_unit(case, j))
            if wp.static(GIVEN_FORCE):
                for j in range(3):
                    size = wp.max(size, wp.abs(dn[j]) / case.force)
            if size > f64(0.0):
                unit = size
        for j in range(wp.static(layout.column.size)):
            set_number(memory, at + j, l, v[j] / (unit * column_unit(case, j)))
        set_number(memory, at + wp.static(GIVEN + UNIT), l, unit)
        if wp.static(GIVEN_FORCE):
            for j in range(3):
                set_number(memory, at + wp.static(GIVEN + GIVEN_FORCE_AT) + j, l, dn[j] / (unit * case.force))

    return SimpleNamespace(
        state_in=state_in, column_in=column_in, force_column_in=force_column_in, put_state=put_state, put_column=put_column
    )
