# mypy: ignore-errors
"""What concentric tubes that carry members bring to a stretch, and what nodes say of them.

``s`` is where the stretch begins, ``l`` a lane, ``o`` where the thread's memory begins, ``z`` where the record of the stretch
stands. Numbers in parentheses are those of ``docs/lines.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.instance import Instance
from multirod.models.backbone.kernels.layout.arguments import START, Call, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout, Memory
from multirod.models.backbone.kernels.numbers.lanes import lanes
from multirod.models.backbone.kernels.numbers.scalars import turned_about_z
from multirod.models.backbone.members.member import columns_in_material

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


def write_node_of_tubes(layout: Layout, memory: Memory, base: SimpleNamespace, W: int, d, vector_of, write_node):
    """``write_node`` of tubes, whose moments and forces are those with their members: what is a tube's own, beside it."""
    memory_type = wp.array(dtype=d)
    get_lane, State = lanes(W, d).get, base.State
    PLACE, CARRIERS, p = memory.PLACES, layout.CARRIERS, layout.place
    MEMBER_MOMENT, MEMBER_FORCE, EXCESS = p["member_moment"], p["member_force"], p["excess"]
    THETA_AT = layout.state["angles"]

    @wp.func
    def angle_of(y: State, i: int) -> f64:
        """theta_i"""
        if i == 0:
            return f64(0.0)
        return y[wp.static(THETA_AT - 1) + i]

    @wp.func
    def write_node_with_members(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        y: State,
        output: int,
        s0: f64,
        s: f64,
    ):
        """One tube at an output node at s; the stretch began at s0."""
        write_node(rods, call, case, memory, o, l, y, output, s0, s)
        t = case.index
        a = o + wp.static(PLACE)
        M = call.node_moment[t, output]
        u = call.node_curvature[t, output]
        for j in range(wp.static(len(CARRIERS))):
            if call.node_rod == wp.static(CARRIERS[j]):
                u[2] = u[2] + f64(get_lane(memory, a + wp.static(EXCESS + j), l)) / case.unit
        call.node_curvature[t, output] = u
        if call.unknown_columns == 0:  # a shape
            N = call.node_force[t, output]
            call.node_total_moment[t, output] = M
            call.node_total_force[t, output] = N
            for j in range(wp.static(len(CARRIERS))):
                if call.node_rod == wp.static(CARRIERS[j]):
                    M -= case.moment * vector_of(memory, a + wp.static(MEMBER_MOMENT + 3 * j), l)
            # the force is that of all tubes together, along the axes of tube 1 and then of this one
            carried = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
            for j in range(wp.static(len(CARRIERS))):
                own = vector_of(memory, a + wp.static(MEMBER_FORCE + 3 * j), l)
                carried += turned_about_z(angle_of(y, wp.static(CARRIERS[j]))) * own
            angle = f64(0.0)
            if call.node_rod < rods.end.shape[1]:
                angle = angle_of(y, call.node_rod)
            N -= case.force * (turned_about_z(-angle) * carried)
            call.node_moment[t, output] = M
            call.node_force[t, output] = N

    return write_node_with_members
