# mypy: ignore-errors
"""What all loads that depend on the configuration bring to a stretch, one lane at a time."""

from functools import reduce
from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.design import make_section_vector
from multirod.models.backbone.kernels.layout.arguments import Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.layout.members import loads_in_material
from multirod.models.backbone.kernels.layout.rows import InputOffsets

f64 = wp.float64


def load_of_all(layout: Layout, inputs: InputOffsets, reach: SimpleNamespace) -> SimpleNamespace:
    """``Load.loading`` of all loads of the features, one after another; ``reach`` is what it may use."""
    memory_type, features = reach.memory_type, layout.features
    columns = loads_in_material(features)

    def one(load):
        own = {"n": layout.n, "column": columns[load], "input": inputs.of(load.input) if load.input else -1}
        own |= {"section_vector": make_section_vector(layout, load.of_section) if load.of_section else None}
        return load.loading(SimpleNamespace(**(vars(reach) | own | layout.slots_of(load))))

    def both(first, then):
        on_stretch, on_next, of_direction, of_next = first.stretch, then.stretch, first.direction, then.direction

        @wp.func
        def stretch(
            rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, z: int, l: int, s: f64
        ):
            on_stretch(rods, call, case, memory, z, l, s)
            on_next(rods, call, case, memory, z, l, s)

        @wp.func
        def direction(call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, g: int, l: int, k: int, unit: f64):
            of_direction(call, case, memory, g, l, k, unit)
            of_next(call, case, memory, g, l, k, unit)

        return SimpleNamespace(stretch=stretch, direction=direction)

    def both_designs(first, then):
        @wp.func
        def design(
            rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, g: int, l: int, k: int,
            s: f64, unit: f64,
        ):  # fmt: skip
            first(rods, call, case, memory, g, l, k, s, unit)
            then(rods, call, case, memory, g, l, k, s, unit)

        return design

    every = [one(load) for load in features.loads]
    designs = [load.design for load in every if hasattr(load, "design")]
    own = {"stretch": None, "direction": None} if not every else vars(reduce(both, every))
    return SimpleNamespace(**own | {"design": reduce(both_designs, designs) if designs else None})
