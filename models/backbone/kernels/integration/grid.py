# mypy: ignore-errors
"""The grid of one backbone: its loads and geometry, its nodes, and the stretches between them, one lane at a time.

A node stands wherever a section of a rod or a piece of a load profile ends, and at the tip. Where an input moves it, it moves
with one rod, its mover. ``p`` is the row of ``Call.lane`` that tells where a lane stands, ``l`` the lane in its thread, ``o``
where the thread's memory begins. Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.along import make_given_places
from multirod.models.backbone.kernels.design import make_design_grid
from multirod.models.backbone.kernels.equations.conditions import make_conditions
from multirod.models.backbone.kernels.instance import make_geometry
from multirod.models.backbone.kernels.integration.distributed import make_distributed
from multirod.models.backbone.kernels.layout.arguments import (
    END,
    END_MOVER,
    FORCE,
    OUTPUT,
    START,
    START_MOVER,
    STOP,
    STRETCH_END,
    Call,
    Instance,
    RodTable,
)
from multirod.models.backbone.kernels.layout.layout import Layout, Memory
from multirod.models.backbone.kernels.layout.rows import MATERIAL_SIZE, InputOffsets
from multirod.models.backbone.kernels.loads.loading import load_of_all
from multirod.models.backbone.kernels.members.loading import make_member_loading
from multirod.models.backbone.kernels.numbers.lanes import lanes

f64 = wp.float64


def make_grid(layout: Layout, memory: Memory, W: int, d) -> SimpleNamespace:
    """Functions that load an instance and walk along it."""
    L = lanes(W, d)
    set_lane, get_lane, copy_lane = L.set, L.get, L.copy
    memory_type = wp.array(dtype=d)
    n, features = layout.n, layout.features
    SEVERAL, ECCENTRIC, HELD, NODES = layout.TUBES, layout.ECCENTRIC, features.held, layout.NODES
    CARRIERS, MEMBERS = layout.CARRIERS, bool(features.members)
    PROFILE, CURVATURE_TERMS = layout.PROFILE, layout.CURVATURE_TERMS
    FORCE_PER_LENGTH, MOMENT_PER_LENGTH, VARIED = layout.FORCE_PER_LENGTH, layout.MOMENT_PER_LENGTH, layout.VARIED
    WORLD_FORCE = layout.FORCE and not layout.FORCE_STATE and not layout.WORLD_STATE
    ANISOTROPIC, SHEAR, LOADS = features.anisotropic, features.shear, bool(features.loads)
    DIRECTIONS = layout.DIRECTIONS
    SINGLE = d is wp.float32
    ROUTED = layout.ROUTED
    conditions = make_conditions(layout)
    at = InputOffsets(n, layout.DRIVES)
    TRANSLATION, PROFILE_FACTOR = at.TRANSLATION, at.PROFILE_FACTOR
    GRAVITY = at.GRAVITY
    DISTRIBUTED_FORCE, DISTRIBUTED_MOMENT = at.DISTRIBUTED_FORCE, at.DISTRIBUTED_MOMENT
    Z, COLUMNS, COLUMN_SIZE, GIVEN = memory.STRETCH, memory.COLUMNS, memory.COLUMN_SIZE, layout.column.size
    z_at, given_at = layout.stretch.__getitem__, layout.given.__getitem__
    given_first, given_last = layout.given["distributed_force"], layout.given.size

    geometry = make_geometry(layout, d)
    load_vector, direction_vector, moved = geometry.load_vector, geometry.direction_vector, geometry.moved
    section_end, rod_end, is_shared = geometry.section_end, geometry.rod_end, geometry.is_shared
    section_from, section_at, Sections = geometry.section_from, geometry.section_at, geometry.Sections

    # ---- nodes ----

    @wp.func
    def output_arclength(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], output: int) -> f64:
        """Where an output node is: they are spaced evenly along one rod or all; past its end there are none, whatever it is."""
        s = case.length
        if call.node_rod < wp.static(n):
            s = rod_end(rods, call, case, call.node_rod)
        if output < call.node_count - 1:
            s *= f64(output) / f64(call.node_count - 1)
        if output > call.node_count - 1:
            s = f64(wp.inf)
        return s

    @wp.func
    def find_stop(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], p: int):
        """Where a lane stops next on its stretch; a node that directions move ends it."""
        s = call.lane[p, STRETCH_END]
        if wp.static(NODES):
            s = wp.min(s, output_arclength(rods, call, case, int(call.lane[p, OUTPUT]) + 1))
            if call.direction_columns > 0:
                call.lane[p, STRETCH_END] = s
        call.lane[p, END] = s

    @wp.func(inline=False)
    def find_end(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], p: int, sections: Sections):
        """The end of a stretch, the nearest end of a section or piece of profile, or the tip; and where the lane stops next."""
        start = call.lane[p, START]
        s = case.length
        mover = case.longest
        for i in range(rods.end.shape[1]):
            if sections[i] < rods.end.shape[2]:
                end = section_end(rods, call, case, i, sections[i])
                if end < s:
                    s = end
                    mover = i
        if wp.static(PROFILE):
            piece = piece_from(rods, start)
            if piece < rods.profile_end.shape[0] - 1 and rods.profile_end[piece] < s:
                s = rods.profile_end[piece]
                mover = -1
        if call.lane[p, STOP] < s:  # a breakpoint keeps its arclength
            s = call.lane[p, STOP]
            mover = -1
        call.lane[p, STRETCH_END] = s
        call.lane[p, END_MOVER] = f64(mover)
        find_stop(rods, call, case, p)

    # ---- stretches ----

    @wp.func
    def counted(case: wp.ref[Instance], value: f64, newtons: f64, metres: f64) -> f64:
        """A number of a unit of these powers, in what numbers in lanes are counted in."""
        if wp.static(SINGLE):
            return value / (wp.pow(case.force, newtons) * wp.pow(case.unit, metres))
        return value

    @wp.func
    def relative(case: wp.ref[Instance], EI: f64) -> f64:
        """A stiffness, likewise."""
        if wp.static(SINGLE):
            return EI / case.stiffness
        return EI

    @wp.func
    def set_number(memory: memory_type, row: int, l: int, a: f64):
        set_lane(memory, row, l, d(a))

    @wp.func
    def set_vector(memory: memory_type, row: int, l: int, a: wp.vec3d):
        for j in range(3):
            set_lane(memory, row + j, l, d(a[j]))

    reach = SimpleNamespace(
        memory_type=memory_type, section_at=section_at, counted=counted, set_number=set_number, set_vector=set_vector,
        load_vector=load_vector, direction_vector=direction_vector,
    )  # fmt: skip
    acting = load_of_all(layout, at, reach)
    load_acting, load_acting_direction = acting.stretch, acting.direction
    members = make_member_loading(layout, memory, W, d, conditions, reach)
    load_members = members.load_members

    @wp.func(inline=False)
    def load_sections(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        s: f64,
        sections: Sections,
    ):
        """Stiffness and precurvature of each rod from s on; a rod that has ended keeps its last section."""
        z = o + wp.static(Z)
        factor = case.unit
        if wp.static(SEVERAL and not HELD):
            # the natural branch of several rods begins where all are straight: their precurvature is raised with the loads, by
            # the root, as torques grow with its square and with the angles
            factor = case.unit * wp.sqrt(call.problem.load_factor[case.index])
        EI = f64(0.0)
        stiffness = f64(0.0)
        for i in range(rods.end.shape[1]):
            m = wp.min(sections[i], rods.end.shape[2] - 1)
            present = wp.where(sections[i] == m, f64(1.0), f64(0.0))
            EI_x = rods.material[case.rods, i, m, 0]
            EI_y = rods.material[case.rods, i, m, 1]
            EI += present * EI_x
            stiffness += present * wp.max(EI_x, EI_y)
            if wp.static(SEVERAL):
                set_number(memory, z + wp.static(z_at("present")) + i, l, present)
                set_number(memory, z + wp.static(z_at("bending")) + i, l, relative(case, present * EI_x))
                set_number(
                    memory, z + wp.static(z_at("torsion")) + i, l, present * rods.material[case.rods, i, m, 5] * case.stiffness
                )
                if wp.static(ANISOTROPIC):
                    set_number(memory, z + wp.static(z_at("bending_y")) + i, l, relative(case, present * EI_y))
                if wp.static(ECCENTRIC):
                    for j in range(2):
                        offset = rods.material[case.rods, i, m, wp.static(MATERIAL_SIZE) + j]
                        offset = counted(case, offset, f64(0.0), f64(1.0))
                        set_number(memory, z + wp.static(z_at("offset")) + 2 * i + j, l, offset)
                    sheath = rods.material[case.rods, 0, 0, wp.static(MATERIAL_SIZE) + 2] * case.stiffness
                    set_number(memory, z + wp.static(z_at("sheath")), l, sheath)
            else:
                for j in range(3):
                    compliance = rods.material[case.rods, i, m, 3 + j] * case.stiffness
                    set_number(memory, z + wp.static(z_at("compliance")) + j, l, compliance)
                    if wp.static(SHEAR):
                        shear = rods.material[case.rods, i, m, 6 + j] * case.force
                        set_number(memory, z + wp.static(z_at("shear")) + j, l, shear)
            for j in range(wp.static(3 * CURVATURE_TERMS)):
                u = factor * rods.precurvature[case.rods, i, m, j]
                set_number(memory, z + wp.static(z_at("precurvature")) + i * wp.static(3 * CURVATURE_TERMS) + j, l, u)
            if wp.static(VARIED or ROUTED):
                begin = f64(0.0)
                if m > 0:
                    begin = rods.end[case.rods, i, m - 1]
                end = rods.end[case.rods, i, m]
                centre = f64(0.5) * (begin + end) + call.problem.inputs[case.index, wp.static(TRANSLATION) + i] - s
                slope = f64(0.0)
                if end > begin:
                    slope = f64(2.0) / (end - begin)
                set_number(memory, z + wp.static(z_at("centre")) + i, l, counted(case, centre, f64(0.0), f64(1.0)))
                set_number(memory, z + wp.static(z_at("slope")) + i, l, slope * case.unit)
        if wp.static(MEMBERS):
            load_members(rods, call, case, memory, z, l, s)
        if wp.static(LOADS):
            set_number(memory, z + wp.static(z_at("from_base")), l, counted(case, s, f64(0.0), f64(1.0)))
            load_acting(rods, call, case, memory, z, l, s)
        if wp.static(SEVERAL):
            set_number(memory, z + wp.static(z_at("softness")), l, case.stiffness / EI)
        moment = counted(case, stiffness / case.scale, f64(1.0), f64(1.0))
        force = counted(case, stiffness / (case.scale * case.scale), f64(1.0), f64(0.0))
        set_number(memory, z + wp.static(z_at("unit_moment")), l, moment)
        set_number(memory, z + wp.static(z_at("unit_force")), l, force)
        set_number(memory, z + wp.static(z_at("unit_length")), l, counted(case, case.scale, f64(0.0), f64(1.0)))

    @wp.func
    def load_directions(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        p: int,
        first: int,
        count: int,
    ):
        """What directions vary of the stretch, of a lane's columns from ``first`` on; nothing of those of unknowns."""
        start = call.lane[p, START]
        length = call.lane[p, END] - start
        density = density_at(rods, call, case, start)
        for c in range(count):
            k = first + c - call.unknown_columns
            g = o + wp.static(COLUMNS + GIVEN) + c * wp.static(COLUMN_SIZE)
            if k < 0:
                for j in range(wp.static(given_first), wp.static(given_last)):
                    set_number(memory, g + j, l, f64(0.0))
            else:
                unit = f64(get_lane(memory, g + wp.static(given_at("unit")), l))
                force = direction_vector(call, case, k, DISTRIBUTED_FORCE) + density * direction_vector(call, case, k, GRAVITY)
                force = (case.unit / (case.force * unit)) * (case.to_base * force)
                set_vector(memory, g + wp.static(given_at("distributed_force")), l, force)
                if wp.static(MOMENT_PER_LENGTH):
                    moment = (f64(1.0) / (case.force * unit)) * (
                        case.to_base * direction_vector(call, case, k, DISTRIBUTED_MOMENT)
                    )
                    set_vector(memory, g + wp.static(given_at("distributed_moment")), l, moment)
                profile = call.problem.directions[case.direction, k, PROFILE_FACTOR]
                if case.profile_factor != f64(0.0):
                    profile /= case.profile_factor
                set_number(memory, g + wp.static(given_at("profile")), l, profile / unit)
                if wp.static(LOADS):
                    load_acting_direction(call, case, memory, g, l, k, unit)
                start_rate = moved(call, case, k, int(call.lane[p, START_MOVER]))
                end_rate = moved(call, case, k, int(call.lane[p, END_MOVER]))
                set_number(memory, g + wp.static(given_at("start")), l, start_rate / (case.unit * unit))
                set_number(memory, g + wp.static(given_at("growth")), l, (end_rate - start_rate) / (length * unit))
                for i in range(rods.end.shape[1]):
                    shift = moved(call, case, k, i) / (case.unit * unit)
                    set_number(memory, g + wp.static(given_at("shift")) + i, l, shift)

    @wp.func(inline=False)
    def load_stretch(
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
        """The stretch from the node where a lane stands to the next; arclengths count from its start."""
        start = call.lane[p, START]
        z = o + wp.static(Z)
        known = bool(False)
        if is_shared(call, l, p, job):  # the lane before may stand on this stretch
            known = call.lane[p - 1, START] == start
        if known:
            copy_lane(memory, z, wp.static(layout.stretch.size), l, l - 1)
            call.lane[p, STRETCH_END] = call.lane[p - 1, STRETCH_END]
            call.lane[p, END_MOVER] = call.lane[p - 1, END_MOVER]
            find_stop(rods, call, case, p)  # the other may have begun earlier, and be past the first stop
        else:
            sections = Sections()
            for i in range(rods.end.shape[1]):
                sections[i] = section_from(rods, call, case, i, start)
            find_end(rods, call, case, p, sections)
            load_sections(rods, call, case, memory, o, l, start, sections)
            if wp.static(WORLD_FORCE):
                n0 = wp.vec3d(call.lane[p, FORCE], call.lane[p, wp.static(FORCE + 1)], call.lane[p, wp.static(FORCE + 2)])
                set_vector(memory, z + wp.static(z_at("force")), l, n0 / case.force)
            if wp.static(FORCE_PER_LENGTH):
                force = (case.unit / case.force) * distributed_here(rods, call, case, start)
                set_vector(memory, z + wp.static(z_at("distributed_force")), l, force)
            if wp.static(MOMENT_PER_LENGTH):
                set_vector(memory, z + wp.static(z_at("distributed_moment")), l, case.distributed_moment / case.force)
            if wp.static(PROFILE):
                load_profile(rods, case, memory, o, l, start)
        if wp.static(MEMBERS):
            # what another lane found is none of this one's: results would depend on how columns are shared out
            set_number(memory, z + wp.static(z_at("unanswered")), l, f64(0.0))
        if wp.static(MEMBERS and not CARRIERS):
            for j in range(wp.static(layout.LAST_STRAINS)):
                set_number(memory, z + wp.static(z_at("strains")) + j, l, f64(0.0))
            for j in range(wp.static(layout.STRAINS)):
                set_number(memory, z + wp.static(z_at("last_system")) + j * wp.static(layout.STRAINS + 1), l, f64(1.0))
        if wp.static(DIRECTIONS):
            load_directions(rods, call, case, memory, o, l, p, first, count)

    @wp.func
    def pass_force(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], p: int):
        """(3a) n at the end of a lane's stretch."""
        if wp.static(WORLD_FORCE and FORCE_PER_LENGTH):
            start = call.lane[p, START]
            end = call.lane[p, END]
            taken = (end - start) * distributed_here(rods, call, case, start)
            if wp.static(PROFILE):
                taken += case.profile_factor * (case.to_base * profile_integral(rods, piece_from(rods, start), start, end))
            for j in range(3):
                call.lane[p, FORCE + j] = call.lane[p, FORCE + j] - taken[j]

    moved_by_inputs, mass_rate_until = moved, None
    if features.along:
        places = make_given_places(SimpleNamespace(Sections=Sections, section_end=section_end, find_end=find_end))
        output_arclength, find_end = places.output_arclength, places.find_end
    if layout.DESIGN:
        known = SimpleNamespace(
            Sections=Sections,
            section_at=section_at,
            section_end=section_end,
            set_number=set_number,
            find_end=find_end,
            load_directions=load_directions,
            load_acting_design=acting.design,
        )
        changed = make_design_grid(layout, memory, W, d, known)
        moved, mass_rate_until = changed.moved, changed.mass_rate_until
        find_end, load_directions = changed.find_end, changed.load_directions
    known = SimpleNamespace(
        section_end=section_end, section_at=section_at, moved=moved, mass_rate_until=mass_rate_until,
        direction_vector=direction_vector, set_number=set_number, set_vector=set_vector,
    )  # fmt: skip
    loads = make_distributed(layout, memory, memory_type, known)
    piece_from, profile_integral, density_at = loads.piece_from, loads.profile_integral, loads.density_at
    distributed_here, load_profile = loads.distributed_here, loads.load_profile
    return SimpleNamespace(
        conditions=conditions,
        load_drive_columns=members.load_drive_columns,
        load_vector=load_vector,
        direction_vector=direction_vector,
        moved=moved_by_inputs,
        section_end=section_end,
        rod_end=rod_end,
        section_from=section_from,
        section_at=section_at,
        take_up=geometry.take_up,
        total_load=loads.total_load,
        total_load_rate=loads.total_load_rate,
        load_until=loads.load_until,
        load_rate_until=loads.load_rate_until,
        output_arclength=output_arclength,
        load_stretch=load_stretch,
        find_stop=find_stop,
        pass_force=pass_force,
        set_number=set_number,
        set_vector=set_vector,
    )
