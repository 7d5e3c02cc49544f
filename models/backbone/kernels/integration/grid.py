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
from multirod.models.backbone.kernels.instance import Instance
from multirod.models.backbone.kernels.layout.arguments import (
    END,
    END_MOVER,
    FORCE,
    JOB,
    OUTPUT,
    START,
    START_MOVER,
    STOP,
    Call,
    RodTable,
)
from multirod.models.backbone.kernels.layout.layout import Layout, Memory
from multirod.models.backbone.kernels.layout.members import columns_in_material, drive_places, driven
from multirod.models.backbone.kernels.layout.rows import MATERIAL_SIZE, InputOffsets
from multirod.models.backbone.kernels.loads.loading import load_of_all
from multirod.models.backbone.kernels.members.loading import load_members_of_tubes
from multirod.models.backbone.kernels.numbers.lanes import lanes

f64 = wp.float64


def make_grid(layout: Layout, memory: Memory, W: int, d) -> SimpleNamespace:
    """Functions that load an instance and walk along it."""
    L = lanes(W, d)
    set_lane, get_lane, copy_lane = L.set, L.get, L.copy
    memory_type = wp.array(dtype=d)
    n, features = layout.n, layout.features
    SEVERAL, ECCENTRIC, HELD, NODES = layout.TUBES, layout.ECCENTRIC, features.held, layout.NODES
    CARRIERS = layout.CARRIERS  # whose members are loaded by themselves
    MEMBERS = bool(features.members) and not CARRIERS
    PROFILE, PROFILE_TERMS, CURVATURE_TERMS = layout.PROFILE, layout.PROFILE_TERMS, layout.CURVATURE_TERMS
    FORCE_PER_LENGTH, MOMENT_PER_LENGTH, VARIED = layout.FORCE_PER_LENGTH, layout.MOMENT_PER_LENGTH, layout.VARIED
    WORLD_FORCE = layout.FORCE and not layout.FORCE_STATE and not layout.WORLD_STATE
    ANISOTROPIC, SHEAR, LOADS = features.anisotropic, features.shear, bool(features.loads)
    DIRECTIONS = layout.DIRECTIONS
    SINGLE = d is wp.float32
    FUNCTIONS, ROUTED = layout.FUNCTIONS * (not CARRIERS), layout.ROUTED
    FUNCTION_TERMS = layout.FUNCTION_TERMS
    *IN_MATERIAL, FUNCTIONS_IN_MATERIAL = columns_in_material(features.members)
    FUNCTION_POWERS = [powers for kind in features.members for powers in kind.functions.values()]
    DRIVES_VARY, PLACES = layout.DRIVES_VARY, drive_places(features.members)
    conditions = make_conditions(layout)
    at = InputOffsets(n, layout.DRIVES)
    DRIVES_AT = at.DRIVES
    TRANSLATION, PROFILE_FACTOR = at.TRANSLATION, at.PROFILE_FACTOR
    TIP_FORCE, TIP_MOMENT, GRAVITY = at.TIP_FORCE, at.TIP_MOMENT, at.GRAVITY
    DISTRIBUTED_FORCE, DISTRIBUTED_MOMENT = at.DISTRIBUTED_FORCE, at.DISTRIBUTED_MOMENT
    Z, COLUMNS, COLUMN_SIZE, GIVEN = memory.STRETCH, memory.COLUMNS, memory.COLUMN_SIZE, layout.column.size
    z_at, given_at = layout.stretch.__getitem__, layout.given.__getitem__
    given_first, given_last = layout.given["distributed_force"], layout.given.size

    @wp.func
    def load_vector(call: wp.ref[Call], t: int, first: int) -> wp.vec3d:
        """A load as it acts: the load factor included."""
        return call.load_factor[t] * wp.vec3d(call.inputs[t, first], call.inputs[t, first + 1], call.inputs[t, first + 2])

    @wp.func
    def direction_vector(call: wp.ref[Call], case: wp.ref[Instance], k: int, first: int) -> wp.vec3d:
        """Part of direction k, of a load as it acts."""
        j = case.direction
        return wp.vec3d(call.directions[j, k, first], call.directions[j, k, first + 1], call.directions[j, k, first + 2])

    @wp.func
    def moved(call: wp.ref[Call], case: wp.ref[Instance], k: int, mover: int) -> f64:
        """How direction k moves a node with its mover."""
        if mover < 0:
            return f64(0.0)
        return call.directions[case.direction, k, wp.static(TRANSLATION) + mover]

    @wp.func
    def section_end(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], i: int, m: int) -> f64:
        """Where section m of rod i ends."""
        return rods.end[case.rods, i, m] + call.inputs[case.index, wp.static(TRANSLATION) + i]

    @wp.func
    def rod_end(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], i: int) -> f64:
        return section_end(rods, call, case, i, rods.end.shape[2] - 1)

    @wp.func
    def section_from(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], i: int, s: f64) -> int:
        """The section of rod i that begins at s or goes on there; their number where the rod has ended."""
        m = int(0)
        while m < rods.end.shape[2] and section_end(rods, call, case, i, wp.min(m, rods.end.shape[2] - 1)) <= s:
            m += int(1)
        return m

    @wp.func(inline=False)
    def load_instance(rods: wp.ref[RodTable], call: wp.ref[Call], t: int) -> Instance:
        """Geometry of an instance, and its loads in the base frame."""
        case = Instance()
        case.index = t
        case.rods = t * rods.stride
        case.direction = t * call.direction_stride
        case.base_position = rods.base_position[t * rods.base_stride]
        case.base_rotation = rods.base_rotation[t * rods.base_stride]
        case.to_base = wp.transpose(case.base_rotation)
        case.scale = rods.length_scale[case.rods]
        case.length = rod_end(rods, call, case, 0)
        for i in range(1, rods.end.shape[1]):
            if rod_end(rods, call, case, i) > case.length:
                case.length = rod_end(rods, call, case, i)
                case.longest = i
        case.tip_force = case.to_base * load_vector(call, t, TIP_FORCE)
        case.tip_moment = case.to_base * load_vector(call, t, TIP_MOMENT)
        case.distributed_force = case.to_base * load_vector(call, t, DISTRIBUTED_FORCE)
        case.distributed_moment = case.to_base * load_vector(call, t, DISTRIBUTED_MOMENT)
        case.gravity = case.to_base * load_vector(call, t, GRAVITY)
        case.profile_factor = call.load_factor[t] * call.inputs[t, PROFILE_FACTOR]
        case.unit = f64(1.0)
        case.stiffness = f64(1.0)
        case.moment = f64(1.0)
        case.force = f64(1.0)
        if wp.static(SINGLE):
            case.unit = case.scale
            case.stiffness = f64(0.0)
            for i in range(rods.end.shape[1]):
                case.stiffness += wp.max(rods.material[case.rods, i, 0, 0], rods.material[case.rods, i, 0, 1])
            case.moment = case.stiffness / case.scale
            case.force = case.moment / case.scale
        return case

    # ---- (3a): the force at the base ----

    @wp.func
    def mass_until(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], s: f64) -> f64:
        """Mass of all rods between the base and s."""
        mass = f64(0.0)
        for i in range(rods.end.shape[1]):
            begin = f64(0.0)
            for m in range(rods.end.shape[2]):
                end = wp.min(section_end(rods, call, case, i, m), s)
                if end > begin:
                    mass += (end - begin) * rods.material[case.rods, i, m, 9]
                    begin = end
        return mass

    @wp.func
    def mass_rate_until(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], s: f64, k: int) -> f64:
        """Its rate for direction k at a fixed s, or at the tip: what is pushed out of the base, and what moves past s."""
        rate = f64(0.0)
        for i in range(rods.end.shape[1]):
            begin = f64(0.0)
            for m in range(rods.end.shape[2]):
                end = section_end(rods, call, case, i, m)
                if end > begin:
                    density = rods.material[case.rods, i, m, 9]
                    if end <= s:
                        rate += density * moved(call, case, k, i)
                    if begin > f64(0.0) and begin <= s:
                        rate -= density * moved(call, case, k, i)
                    begin = end
        return rate

    @wp.func
    def piece_from(rods: wp.ref[RodTable], s: f64) -> int:
        """The piece of the load profiles that begins at s or goes on there; the last one goes on for ever."""
        piece = int(0)
        while piece < rods.profile_end.shape[0] - 1 and rods.profile_end[piece] <= s:
            piece += int(1)
        return piece

    @wp.func
    def piece_centre(rods: wp.ref[RodTable], piece: int) -> f64:
        begin = f64(0.0)
        if piece > 0:
            begin = rods.profile_end[piece - 1]
        return f64(0.5) * (begin + rods.profile_end[piece])

    @wp.func
    def profile_coefficient(rods: wp.ref[RodTable], piece: int, first: int, j: int) -> wp.vec3d:
        """Of force (first = 0) or moment (3) per length, in the world."""
        return wp.vec3d(
            rods.profile[piece, first * wp.static(PROFILE_TERMS) + j],
            rods.profile[piece, (first + 1) * wp.static(PROFILE_TERMS) + j],
            rods.profile[piece, (first + 2) * wp.static(PROFILE_TERMS) + j],
        )

    @wp.func
    def profile_force(rods: wp.ref[RodTable], piece: int, s: f64) -> wp.vec3d:
        """Force per length at s, in the world."""
        centre = piece_centre(rods, piece)
        t = (s - centre) / (rods.profile_end[piece] - centre)
        a = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        for k in range(wp.static(PROFILE_TERMS)):
            a = t * a + profile_coefficient(rods, piece, 0, wp.static(PROFILE_TERMS - 1) - k)
        return a

    @wp.func
    def profile_integral(rods: wp.ref[RodTable], piece: int, start: f64, end: f64) -> wp.vec3d:
        """Integral of the force profile within a piece, in the world."""
        centre = piece_centre(rods, piece)
        half = rods.profile_end[piece] - centre
        t0 = (start - centre) / half
        t1 = (end - centre) / half
        a = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        b = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        for k in range(wp.static(PROFILE_TERMS)):
            j = wp.static(PROFILE_TERMS - 1) - k
            c = profile_coefficient(rods, piece, 0, j) / f64(j + 1)
            a = t1 * a + c
            b = t0 * b + c
        return half * (t1 * a - t0 * b)

    @wp.func
    def profile_until(rods: wp.ref[RodTable], s: f64) -> wp.vec3d:
        """Integral of the force profile from the base to s, in the world, profile factor aside."""
        total = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        start = f64(0.0)
        for piece in range(rods.profile_end.shape[0]):
            end = wp.min(rods.profile_end[piece], s)
            if piece == rods.profile_end.shape[0] - 1:
                end = s
            if end > start:
                total += profile_integral(rods, piece, start, end)
                start = end
        return total

    @wp.func
    def load_until(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], s: f64) -> wp.vec3d:
        """(3a) What is distributed between the base and s."""
        total = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        if wp.static(FORCE_PER_LENGTH):
            total += s * case.distributed_force + mass_until(rods, call, case, s) * case.gravity
        if wp.static(PROFILE):
            total += case.profile_factor * (case.to_base * profile_until(rods, s))
        return total

    @wp.func
    def load_rate_until(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], s: f64, k: int) -> wp.vec3d:
        """(3a) Its rate for direction k at a fixed s, or, but for what the rod grows by, at the tip."""
        rate = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        if wp.static(FORCE_PER_LENGTH):
            rate += s * direction_vector(call, case, k, DISTRIBUTED_FORCE)
            rate += mass_until(rods, call, case, s) * direction_vector(call, case, k, GRAVITY)
        if wp.static(PROFILE):
            rate += call.directions[case.direction, k, PROFILE_FACTOR] * profile_until(rods, s)
        rate = case.to_base * rate
        if wp.static(FORCE_PER_LENGTH):
            rate += mass_rate_until(rods, call, case, s, k) * case.gravity
        return rate

    @wp.func
    def total_load(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance]) -> wp.vec3d:
        """(3a) Force at the base: the tip force and all that is distributed over the length."""
        return case.tip_force + load_until(rods, call, case, case.length)

    @wp.func
    def total_load_rate(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], k: int) -> wp.vec3d:
        """(3a) Its rate for direction k."""
        rate = case.to_base * direction_vector(call, case, k, TIP_FORCE) + load_rate_until(rods, call, case, case.length, k)
        longer = moved(call, case, k, case.longest)
        if wp.static(FORCE_PER_LENGTH):
            rate += longer * case.distributed_force
        if wp.static(PROFILE):
            at_tip = case.to_base * profile_force(rods, piece_from(rods, case.length), case.length)
            rate += (longer * case.profile_factor) * at_tip
        return rate

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

    @wp.func(inline=False)
    def find_end(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], p: int):
        """The next node of a lane: the nearest end of a section or piece of profile, output node, or tip."""
        start = call.lane[p, START]
        s = case.length
        mover = case.longest
        for i in range(rods.end.shape[1]):
            m = section_from(rods, call, case, i, start)
            if m < rods.end.shape[2]:
                end = section_end(rods, call, case, i, m)
                if end < s:
                    s = end
                    mover = i
        if wp.static(PROFILE):
            piece = piece_from(rods, start)
            if piece < rods.profile_end.shape[0] - 1 and rods.profile_end[piece] < s:
                s = rods.profile_end[piece]
                mover = -1
        if wp.static(NODES):
            s = wp.min(s, output_arclength(rods, call, case, int(call.lane[p, OUTPUT]) + 1))
        if call.lane[p, STOP] < s:  # a breakpoint keeps its arclength
            s = call.lane[p, STOP]
            mover = -1
        call.lane[p, END] = s
        call.lane[p, END_MOVER] = f64(mover)

    # ---- stretches ----

    @wp.func
    def counted(case: wp.ref[Instance], value: f64, newtons: f64, metres: f64) -> f64:
        """A number of a unit of these powers, in what numbers in lanes are counted in."""
        if wp.static(SINGLE):
            return value / (wp.pow(case.force, newtons) * wp.pow(case.unit, metres))
        return value

    @wp.func
    def set_number(memory: memory_type, row: int, l: int, a: f64):
        set_lane(memory, row, l, d(a))

    @wp.func
    def set_vector(memory: memory_type, row: int, l: int, a: wp.vec3d):
        for j in range(3):
            set_lane(memory, row + j, l, d(a[j]))

    reach = SimpleNamespace(
        memory_type=memory_type, section_from=section_from, counted=counted, set_number=set_number, set_vector=set_vector,
        load_vector=load_vector, direction_vector=direction_vector,
    )  # fmt: skip
    acting = load_of_all(layout, at, reach)
    load_acting, load_acting_direction = acting.stretch, acting.direction

    def make_drive(k: int):
        """The function that returns T of member k."""
        number = len(driven(features.members[:k]))
        drive = DRIVES_AT + PLACES[number]

        @wp.func
        def given(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance]) -> f64:
            """Raised with the loads: the unloaded rod is where solvers begin."""
            return call.load_factor[case.index] * call.inputs[case.index, wp.static(drive)]

        return conditions.drive_of[number] if features.members[k].conditioned else given

    def load_member(k: int, kind: type, rest):
        """The function that loads the parameters and the drive of member k, then those of the members after it."""
        first, powers = layout.of_member(k)[0], list(kind.parameters.values())
        column = IN_MATERIAL[k]
        driven, unit = kind.drive is not None, kind.drive[1] if kind.drive is not None else (0, 0)
        drive_value = make_drive(k) if driven else None

        @wp.func
        def load(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, z: int, l: int, m: int):
            for j in range(wp.static(len(powers))):
                value = rods.material[case.rods, 0, m, wp.static(column) + j]
                value = counted(case, value, f64(wp.static(powers[j][0])), f64(wp.static(powers[j][1])))
                set_number(memory, z + wp.static(first) + j, l, value)
            if wp.static(driven):
                value = drive_value(rods, call, case)
                value = counted(case, value, f64(wp.static(unit[0])), f64(wp.static(unit[1])))
                set_number(memory, z + wp.static(first + len(powers)), l, value)
            rest(rods, call, case, memory, z, l, m)

        return load

    @wp.func
    def load_no_member(
        rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, z: int, l: int, m: int
    ):
        """After the last."""

    load_members = load_no_member
    for k, kind in reversed(list(enumerate(features.members)) if MEMBERS else []):
        load_members = load_member(k, kind, load_members)

    @wp.func
    def load_functions(rods: wp.ref[RodTable], case: wp.ref[Instance], memory: memory_type, z: int, l: int, m: int):
        """The polynomials of members."""
        terms = int(wp.static(FUNCTION_TERMS))
        for k in range(terms):
            for j in range(wp.static(FUNCTIONS)):
                row = k * wp.static(FUNCTIONS) + j
                value = rods.material[case.rods, 0, m, wp.static(FUNCTIONS_IN_MATERIAL) + row]
                value = counted(case, value, f64(wp.static(FUNCTION_POWERS[j][0])), f64(wp.static(FUNCTION_POWERS[j][1])))
                set_number(memory, z + wp.static(z_at("functions") if FUNCTIONS else -1) + row, l, value)

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
                    value = call.directions[case.direction, direction, wp.static(DRIVES_AT + PLACES[k])]
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

    @wp.func(inline=False)
    def load_sections(
        rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, o: int, l: int, s: f64
    ):
        """Stiffness and precurvature of each rod from s on; a rod that has ended keeps its last section."""
        z = o + wp.static(Z)
        factor = case.unit
        if wp.static(SEVERAL and not HELD):
            # the natural branch of several rods begins where all are straight: their precurvature is raised with the loads, by
            # the root, as torques grow with its square and with the angles
            factor = case.unit * wp.sqrt(call.load_factor[case.index])
        EI = f64(0.0)
        stiffness = f64(0.0)
        for i in range(rods.end.shape[1]):
            from_here = section_from(rods, call, case, i, s)
            m = wp.min(from_here, rods.end.shape[2] - 1)
            present = f64(1.0)
            if from_here == rods.end.shape[2]:
                present = f64(0.0)
            EI_x = rods.material[case.rods, i, m, 0]
            EI_y = rods.material[case.rods, i, m, 1]
            EI += present * EI_x
            stiffness += present * wp.max(EI_x, EI_y)
            if wp.static(SEVERAL):
                set_number(memory, z + wp.static(z_at("present")) + i, l, present)
                set_number(memory, z + wp.static(z_at("bending")) + i, l, present * EI_x / case.stiffness)
                set_number(
                    memory, z + wp.static(z_at("torsion")) + i, l, present * rods.material[case.rods, i, m, 5] * case.stiffness
                )
                if wp.static(ANISOTROPIC):
                    set_number(memory, z + wp.static(z_at("bending_y")) + i, l, present * EI_y / case.stiffness)
                if wp.static(ECCENTRIC):
                    for j in range(2):
                        offset = rods.material[case.rods, i, m, wp.static(MATERIAL_SIZE) + j] / case.unit
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
            if wp.static(MEMBERS):
                load_members(rods, call, case, memory, z, l, m)
            if wp.static(FUNCTIONS > 0):
                load_functions(rods, case, memory, z, l, m)
            for j in range(wp.static(3 * CURVATURE_TERMS)):
                u = factor * rods.precurvature[case.rods, i, m, j]
                set_number(memory, z + wp.static(z_at("precurvature")) + i * wp.static(3 * CURVATURE_TERMS) + j, l, u)
            if wp.static(VARIED or ROUTED):
                begin = f64(0.0)
                if m > 0:
                    begin = rods.end[case.rods, i, m - 1]
                end = rods.end[case.rods, i, m]
                centre = f64(0.5) * (begin + end) + call.inputs[case.index, wp.static(TRANSLATION) + i] - s
                slope = f64(0.0)
                if end > begin:
                    slope = f64(2.0) / (end - begin)
                set_number(memory, z + wp.static(z_at("centre")) + i, l, centre / case.unit)
                set_number(memory, z + wp.static(z_at("slope")) + i, l, slope * case.unit)
        if wp.static(LOADS):
            set_number(memory, z + wp.static(z_at("from_base")), l, s / case.unit)
            load_acting(rods, call, case, memory, z, l, s)
        if wp.static(SEVERAL):
            set_number(memory, z + wp.static(z_at("softness")), l, case.stiffness / EI)
        set_number(memory, z + wp.static(z_at("unit_moment")), l, stiffness / case.scale / case.moment)
        set_number(memory, z + wp.static(z_at("unit_force")), l, stiffness / (case.scale * case.scale) / case.force)
        set_number(memory, z + wp.static(z_at("unit_length")), l, case.scale / case.unit)

    @wp.func
    def density_at(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], s: f64) -> f64:
        """Mass per length of all rods from s on."""
        density = f64(0.0)
        for i in range(rods.end.shape[1]):
            m = section_from(rods, call, case, i, s)
            if m < rods.end.shape[2]:
                density += rods.material[case.rods, i, m, 9]
        return density

    @wp.func
    def distributed_here(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], s: f64) -> wp.vec3d:
        """Uniform part of the force per length, weight included."""
        return case.distributed_force + density_at(rods, call, case, s) * case.gravity

    @wp.func
    def load_profile(rods: wp.ref[RodTable], case: wp.ref[Instance], memory: memory_type, o: int, l: int, s: f64):
        """The piece of the load profiles from s on."""
        z = o + wp.static(Z)
        piece = piece_from(rods, s)
        centre = piece_centre(rods, piece)
        set_number(memory, z + wp.static(z_at("profile_centre")), l, (centre - s) / case.unit)
        set_number(memory, z + wp.static(z_at("profile_slope")), l, case.unit / (rods.profile_end[piece] - centre))
        for j in range(wp.static(PROFILE_TERMS)):
            a = (case.profile_factor * case.unit / case.force) * (case.to_base * profile_coefficient(rods, piece, 0, j))
            set_vector(memory, z + wp.static(z_at("profile_force")) + 3 * j, l, a)
            if wp.static(MOMENT_PER_LENGTH):
                a = (case.profile_factor / case.force) * (case.to_base * profile_coefficient(rods, piece, 3, j))
                set_vector(memory, z + wp.static(z_at("profile_moment")) + 3 * j, l, a)

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
                profile = call.directions[case.direction, k, PROFILE_FACTOR]
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
        if l > 0:  # where the lane before carries another part of the same job, it may stand on this stretch
            before = int(call.lane[p - 1, JOB])
            known = before >= 0 and before // call.parts == job // call.parts and call.lane[p - 1, START] == start
        if known:
            copy_lane(memory, z, wp.static(layout.stretch.size), l, l - 1)
            call.lane[p, END] = call.lane[p - 1, END]
            call.lane[p, END_MOVER] = call.lane[p - 1, END_MOVER]
        else:
            find_end(rods, call, case, p)
            load_sections(rods, call, case, memory, o, l, start)
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

    moved_by_inputs = moved
    if features.along:
        places = make_given_places(SimpleNamespace(section_from=section_from, section_end=section_end, find_end=find_end))
        output_arclength, find_end = places.output_arclength, places.find_end
    if layout.DESIGN:
        known = SimpleNamespace(
            section_from=section_from,
            section_end=section_end,
            set_number=set_number,
            find_end=find_end,
            load_directions=load_directions,
        )
        changed = make_design_grid(layout, memory, W, d, known)
        moved, mass_rate_until = changed.moved, changed.mass_rate_until
        find_end, load_directions = changed.find_end, changed.load_directions
    if CARRIERS:
        parts = SimpleNamespace(section_from=section_from, set_number=set_number, counted=counted, make_drive=make_drive)
        load_stretch = load_members_of_tubes(layout, memory, W, d, parts, load_stretch)
    return SimpleNamespace(
        conditions=conditions,
        load_drive_columns=load_drive_columns,
        load_vector=load_vector,
        direction_vector=direction_vector,
        moved=moved_by_inputs,
        section_end=section_end,
        rod_end=rod_end,
        section_from=section_from,
        load_instance=load_instance,
        total_load=total_load,
        total_load_rate=total_load_rate,
        load_until=load_until,
        load_rate_until=load_rate_until,
        output_arclength=output_arclength,
        load_stretch=load_stretch,
        pass_force=pass_force,
        set_number=set_number,
        set_vector=set_vector,
    )
