# mypy: ignore-errors
"""What of a moment along the rods no rod takes by a law of its own twists the innermost that there is, (8l) of ``docs/model.md``,
in lanes.

Rod 1 has what the others leave of the moment of all, (7), as long as it is there: ``balance`` has the innermost of the others
take it from where rod 1 has ended, by the rates of their torques. ``z`` is where the record of the stretch stands in memory.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)


def make_innermost(layout: Layout, W: int, d) -> SimpleNamespace:
    """``balance`` for the rates of the state, ``balance_variation`` for those of a column."""
    L = lanes(W, d)
    Real, fill, row = L.Real, L.fill, L.row
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    PRESENT, TORQUES, TAU = layout.stretch["present"], layout.TORQUES, layout.state["torques"]  # a column's stand alike

    def make(few, Few):
        part, keep = few.part, few.keep

        @wp.func
        def take(memory: memory_type, z: int, M_z: Real, f: wp.ref[Few]):
            """``M_z`` is the rate of the moment of all about the axis of the frame."""
            left = M_z
            for i in range(wp.static(TORQUES)):
                left = left - part(f, wp.static(TAU + i))
            nobody = fill(d(1.0)) - row(memory, z + wp.static(PRESENT))
            for i in range(wp.static(TORQUES)):
                there = row(memory, z + wp.static(PRESENT + 1 + i))
                keep(f, wp.static(TAU + i), part(f, wp.static(TAU + i)) + nobody * there * left)
                nobody = nobody * (fill(d(1.0)) - there)

        return take

    return SimpleNamespace(balance=make(state, State), balance_variation=make(column, Column))
