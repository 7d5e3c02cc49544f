# mypy: ignore-errors
"""What members bring to a stretch, and what columns vary of their drives.

``s`` is where the stretch begins, ``g`` where stands what a column varies, ``l`` a lane, ``o`` where the thread's memory begins,
``z`` where the record of the stretch stands. Numbers in parentheses are those of ``docs/lines.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.arguments import Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout, Memory
from multirod.models.backbone.kernels.layout.members import columns_in_material, drive_places, driven
from multirod.models.backbone.kernels.layout.rows import InputOffsets
from multirod.models.backbone.kernels.numbers.lanes import lanes

f64 = wp.float64


def make_member_loading(layout: Layout, memory: Memory, W: int, d, conditions: SimpleNamespace, reach: SimpleNamespace):
    """Functions that load the numbers of members, and what columns vary of their drives; ``reach`` is what they use."""
    get_lane, memory_type = lanes(W, d).get, wp.array(dtype=d)
    features, CARRIERS = layout.features, layout.CARRIERS
    FUNCTIONS, TERMS, FUNCTIONS_AT = layout.FUNCTIONS, layout.FUNCTION_TERMS, layout.stretch["functions"]
    *IN_MATERIAL, FUNCTIONS_IN_MATERIAL = columns_in_material(features.members)
    DRIVES_VARY, PLACES, DRIVES_AT = layout.DRIVES_VARY, drive_places(features.members), InputOffsets(layout.n).DRIVES
    COLUMNS, COLUMN_SIZE, GIVEN = memory.COLUMNS, memory.COLUMN_SIZE, layout.column.size
    given_at = layout.given.__getitem__
    counted, set_number, section_at = reach.counted, reach.set_number, reach.section_at

    def make_drive(k: int):
        """The function that returns T of member k."""
        number = len(driven(features.members[:k]))
        drive = DRIVES_AT + PLACES[number]

        @wp.func
        def given(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance]) -> f64:
            """Raised with the loads: the unloaded rod is where solvers begin."""
            return call.problem.load_factor[case.index] * call.problem.inputs[case.index, wp.static(drive)]

        return conditions.drive_of[number] if features.members[k].conditioned else given

    def load_member(k: int, kind: type, rest):
        """The function that loads the parameters, the drive and the functions of member k from s on, then those of the members
        after it; where its rod has ended its parameters are zero."""
        rod, column = features.member_rods[k] if CARRIERS else 0, IN_MATERIAL[k]
        first, function = layout.of_member(k)
        powers, function_powers = list(kind.parameters.values()), list(kind.functions.values())
        driven, unit = kind.drive is not None, kind.drive[1] if kind.drive is not None else (0, 0)
        drive_value = make_drive(k) if driven else None

        @wp.func
        def load(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, z: int, l: int, s: f64):
            m, present = section_at(rods, call, case, wp.static(rod), s)
            for j in range(wp.static(len(powers))):
                value = present * rods.material[case.rods, wp.static(rod), m, wp.static(column) + j]
                value = counted(case, value, f64(wp.static(powers[j][0])), f64(wp.static(powers[j][1])))
                set_number(memory, z + wp.static(first) + j, l, value)
            if wp.static(driven):
                value = drive_value(rods, call, case)
                value = counted(case, value, f64(wp.static(unit[0])), f64(wp.static(unit[1])))
                set_number(memory, z + wp.static(first + len(powers)), l, value)
            for j in range(wp.static(len(function_powers))):
                for t in range(wp.static(TERMS)):
                    row = t * wp.static(FUNCTIONS) + wp.static(function + j)
                    value = rods.material[case.rods, wp.static(rod), m, wp.static(FUNCTIONS_IN_MATERIAL) + row]
                    power = f64(wp.static(function_powers[j][0]))
                    value = counted(case, value, power, f64(wp.static(function_powers[j][1])))
                    set_number(memory, z + wp.static(FUNCTIONS_AT) + row, l, value)
            rest(rods, call, case, memory, z, l, s)

        return load

    @wp.func
    def load_no_member(
        rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, z: int, l: int, s: f64
    ):
        """After the last."""

    load_members = load_no_member
    for k, kind in reversed(list(enumerate(features.members))):
        load_members = load_member(k, kind, load_members)

    def load_drive_column(k: int, own: type, rest):
        """The function that loads what a column varies of drive k, then of those after it."""
        unit, conditioned = own.drive[1], own.conditioned
        rate = conditions.rate_of[k] if conditioned else None
        unknown = conditions.first + sum(kind.conditioned for kind in driven(features.members)[:k])

        @wp.func
        def load(
            rods: wp.ref[RodTable],
            call: wp.ref[Call],
            case: wp.ref[Instance],
            memory: memory_type,
            g: int,
            l: int,
            column: int,
            scale: f64,
        ):
            value = f64(0.0)
            if wp.static(conditioned):
                if column == wp.static(unknown):
                    value = rate(rods, call, case)
            else:
                direction = column - call.unknown_columns
                if direction >= 0:
                    value = call.problem.directions[case.direction, direction, wp.static(DRIVES_AT + PLACES[k])]
            value = counted(case, value / scale, f64(wp.static(unit[0])), f64(wp.static(unit[1])))
            set_number(memory, g + wp.static(given_at("drives") + k), l, value)
            rest(rods, call, case, memory, g, l, column, scale)

        return load

    @wp.func
    def load_no_drive_column(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        case: wp.ref[Instance],
        memory: memory_type,
        g: int,
        l: int,
        column: int,
        scale: f64,
    ):
        """After the last."""

    chain_of_columns = load_no_drive_column
    if DRIVES_VARY:
        for k, kind in reversed(list(enumerate(driven(features.members)))):
            chain_of_columns = load_drive_column(k, kind, chain_of_columns)

    @wp.func(inline=False)
    def load_drive_columns(
        rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, o: int, l: int, c: int, k: int
    ):
        """What column k, a lane's c-th, varies of the drives: the same all along the rod."""
        g = o + wp.static(COLUMNS + GIVEN) + c * wp.static(COLUMN_SIZE)
        chain_of_columns(rods, call, case, memory, g, l, k, f64(get_lane(memory, g + wp.static(given_at("unit")), l)))

    return SimpleNamespace(
        load_members=load_members,
        load_drive_columns=load_drive_columns,
    )
