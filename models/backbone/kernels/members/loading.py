# mypy: ignore-errors
"""What concentric tubes that carry members bring to a stretch.

``s`` is where the stretch begins, ``l`` a lane, ``o`` where the thread's memory begins, ``z`` where the record of the stretch
stands. Numbers in parentheses are those of ``docs/lines.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.instance import Instance
from multirod.models.backbone.kernels.layout.arguments import START, Call, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout, Memory
from multirod.models.backbone.kernels.layout.members import columns_in_material

f64 = wp.float64


def load_members_of_tubes(layout: Layout, memory: Memory, W: int, d, grid: SimpleNamespace, load_stretch):
    """``load_stretch`` of tubes, and then their members; nothing of those of a tube that has ended."""
    memory_type = wp.array(dtype=d)
    features, Z, TERMS, FUNCTIONS = layout.features, memory.STRETCH, layout.FUNCTION_TERMS, layout.FUNCTIONS
    *IN_MATERIAL, FUNCTIONS_IN_MATERIAL = columns_in_material(features.members)
    UNANSWERED, FUNCTIONS_AT = layout.stretch["unanswered"], layout.stretch["functions"]
    section_from, set_number, counted, make_drive = grid.section_from, grid.set_number, grid.counted, grid.make_drive

    def load_member(k: int, kind: type, rest):
        """The function that loads the parameters, the drive and the functions of member k, then those of the members after it."""
        tube, column = features.member_rods[k], IN_MATERIAL[k]
        first, function = layout.of_member(k)
        powers, function_powers = list(kind.parameters.values()), list(kind.functions.values())
        driven, unit = kind.drive is not None, kind.drive[1] if kind.drive is not None else (0, 0)
        drive_value = make_drive(k) if driven else None

        @wp.func
        def load(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, z: int, l: int, s: f64):
            section = section_from(rods, call, case, wp.static(tube), s)
            m = wp.min(section, rods.end.shape[2] - 1)
            present = f64(1.0)
            if section == rods.end.shape[2]:
                present = f64(0.0)
            for j in range(wp.static(len(powers))):
                value = present * rods.material[case.rods, wp.static(tube), m, wp.static(column) + j]
                value = counted(case, value, f64(wp.static(powers[j][0])), f64(wp.static(powers[j][1])))
                set_number(memory, z + wp.static(first) + j, l, value)
            if wp.static(driven):
                value = drive_value(rods, call, case)
                value = counted(case, value, f64(wp.static(unit[0])), f64(wp.static(unit[1])))
                set_number(memory, z + wp.static(first + len(powers)), l, value)
            for j in range(wp.static(len(function_powers))):
                for t in range(wp.static(TERMS)):
                    row = t * wp.static(FUNCTIONS) + wp.static(function + j)
                    value = rods.material[case.rods, wp.static(tube), m, wp.static(FUNCTIONS_IN_MATERIAL) + row]
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

    @wp.func(inline=False)
    def load_stretch_of_tubes(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        p: int,
        job: int,
        first: int,
        count: int,
    ):
        """The stretch from the node where a lane stands to the next."""
        load_stretch(rods, call, case, memory, o, l, p, job, first, count)
        z = o + wp.static(Z)
        load_members(rods, call, case, memory, z, l, call.lane[p, START])
        set_number(memory, z + wp.static(UNANSWERED), l, f64(0.0))

    return load_stretch_of_tubes
