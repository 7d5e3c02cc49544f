# mypy: ignore-errors
"""Columns by the numbers of the rods themselves: precurvature, stiffnesses, and where sections end.

A direction says, after its inputs, how the numbers of ``RodTable`` change (``DesignOffsets``). The functions here stand in the
place of those that know of inputs alone, and call them. ``z`` is where the record of a stretch stands in memory, ``a`` where that
of a place stands, ``g`` where stands what a column varies. Numbers in parentheses are those of ``docs/derivatives.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.arguments import END, END_MOVER, START, Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout, Memory
from multirod.models.backbone.kernels.layout.rows import DesignOffsets, InputOffsets, input_size
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors

f64 = wp.float64


def _offsets(layout: Layout) -> DesignOffsets:
    return DesignOffsets(layout.CURVATURE_TERMS, layout.features.loads)


def _make_piece_of(layout: Layout):
    n, FIRST, SIZE = layout.n, input_size(layout.n, layout.DRIVES), _offsets(layout).SIZE

    @wp.func
    def piece_of(call: wp.ref[Call], i: int, m: int) -> int:
        """Where section m of rod i begins in a direction; the last of the rod where m is negative."""
        count = (call.problem.directions.shape[2] - wp.static(FIRST)) // wp.static(n * SIZE)
        if m < 0:
            return wp.static(FIRST) + (i * count + count - 1) * wp.static(SIZE)
        return wp.static(FIRST) + (i * count + m) * wp.static(SIZE)

    return piece_of


def make_section_vector(layout: Layout, name: str):
    """What a direction changes of a vector of a section by which a load has derivatives."""
    piece_of, AT = _make_piece_of(layout), _offsets(layout).LOADS[name]

    @wp.func
    def section_vector(call: wp.ref[Call], case: wp.ref[Instance], i: int, m: int, k: int) -> wp.vec3d:
        at = piece_of(call, i, m) + wp.static(AT)
        j = case.direction
        directions = call.problem.directions
        return wp.vec3d(directions[j, k, at], directions[j, k, at + 1], directions[j, k, at + 2])

    return section_vector


def make_design_grid(layout: Layout, memory: Memory, W: int, d, grid: SimpleNamespace) -> SimpleNamespace:
    """What of the grid depends on how the numbers of the rods change; ``grid`` are the functions that know of inputs alone."""
    memory_type = wp.array(dtype=d)
    get_lane = lanes(W, d).get
    n, SEVERAL = layout.n, layout.TUBES
    TERMS = 3 * layout.CURVATURE_TERMS
    TRANSLATION, at = InputOffsets(n).TRANSLATION, _offsets(layout)
    END_AT, BENDING, SOFTNESS, SHIFT_AT, CURVE = at.END, at.BENDING, at.SOFTNESS, at.SHIFT, at.PRECURVATURE
    COLUMNS, COLUMN_SIZE, GIVEN = memory.COLUMNS, memory.COLUMN_SIZE, layout.column.size
    given = layout.given
    UNIT, SHIFT, CURVING, SOFTENING = given["unit"], given["shift"], given["curving"], given["softening"]
    Sections, section_at, section_end, set_number = grid.Sections, grid.section_at, grid.section_end, grid.set_number
    find_end, load_directions, load_acting_design = grid.find_end, grid.load_directions, grid.load_acting_design
    piece_of, LOADS = _make_piece_of(layout), bool(at.LOADS)

    @wp.func
    def moved_with_design(call: wp.ref[Call], case: wp.ref[Instance], k: int, mover: int) -> f64:
        """How direction k moves a node: the end of a rod, numbered as rods are, or, beyond these, of a section."""
        if mover < 0:
            return f64(0.0)
        i = mover % wp.static(n)
        piece = piece_of(call, i, mover // wp.static(n) - 1)
        pushed = call.problem.directions[case.direction, k, wp.static(TRANSLATION) + i]
        return pushed + call.problem.directions[case.direction, k, piece + wp.static(END_AT)]

    @wp.func
    def mass_rate_with_design(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], s: f64, k: int) -> f64:
        """As ``mass_rate_until``: each end of a section moves by itself."""
        rate = f64(0.0)
        for i in range(rods.end.shape[1]):
            begin = f64(0.0)
            begin_rate = f64(0.0)
            for m in range(rods.end.shape[2]):
                end = section_end(rods, call, case, i, m)
                if end > begin:
                    density = rods.material[case.rods, i, m, 9]
                    end_rate = moved_with_design(call, case, k, wp.static(n) + i + wp.static(n) * m)
                    if end <= s:
                        rate += density * end_rate
                    if begin > f64(0.0) and begin <= s:
                        rate -= density * begin_rate
                    begin = end
                    begin_rate = end_rate
        return rate

    @wp.func(inline=False)
    def find_end_of_section(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], p: int, sections: Sections):
        """As ``find_end``; the mover is the section that ends there, or none."""
        find_end(rods, call, case, p, sections)
        mover = int(-1)
        for i in range(rods.end.shape[1]):
            m = sections[i]
            if m < rods.end.shape[2]:
                if section_end(rods, call, case, i, m) == call.lane[p, END]:
                    mover = wp.static(n) + i + wp.static(n) * m
        call.lane[p, END_MOVER] = f64(mover)

    @wp.func
    def load_designs(
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
        """As ``load_directions``, and (D4): stiffnesses relative to themselves, but for bending of several rods."""
        load_directions(rods, call, case, memory, o, l, p, first, count)
        for c in range(count):
            k = first + c - call.unknown_columns
            if k >= 0:
                g = o + wp.static(COLUMNS + GIVEN) + c * wp.static(COLUMN_SIZE)
                unit = f64(get_lane(memory, g + wp.static(UNIT), l))
                j = case.direction
                if wp.static(LOADS):
                    load_acting_design(rods, call, case, memory, g, l, k, call.lane[p, START], unit)
                for i in range(rods.end.shape[1]):
                    m, present = section_at(rods, call, case, i, call.lane[p, START])
                    piece = piece_of(call, i, m)
                    shift = (
                        call.problem.directions[j, k, wp.static(TRANSLATION) + i]
                        + call.problem.directions[j, k, piece + wp.static(SHIFT_AT)]
                    )
                    set_number(memory, g + wp.static(SHIFT) + i, l, shift / (case.unit * unit))
                    for q in range(wp.static(TERMS)):
                        change = case.unit * call.problem.directions[j, k, piece + wp.static(CURVE) + q] / unit
                        set_number(memory, g + wp.static(CURVING) + i * wp.static(TERMS) + q, l, change)
                    for q in range(3):
                        change = call.problem.directions[j, k, piece + wp.static(SOFTNESS) + q] / unit
                        if wp.static(SEVERAL):
                            if q < 2:
                                change = present * call.problem.directions[j, k, piece + wp.static(BENDING) + q]
                                change /= case.stiffness * unit
                        set_number(memory, g + wp.static(SOFTENING) + 3 * i + q, l, change)

    return SimpleNamespace(
        moved=moved_with_design,
        mass_rate_until=mass_rate_with_design,
        find_end=find_end_of_section,
        load_directions=load_designs,
    )


def make_design_precurvature(layout: Layout, W: int, d, law: SimpleNamespace) -> SimpleNamespace:
    """(D4) The law of precurvature, whose variation has the change of its coefficients."""
    L, V = lanes(W, d), vectors(W, d)
    Real, row = L.Real, L.row
    Vec3, row3, ahead3, plus = V.Vec3, V.row3, V.ahead3, V.plus
    memory_type = wp.array(dtype=d)
    TERMS, VARIED = layout.CURVATURE_TERMS, layout.VARIED
    CENTRE, SLOPE, CURVING = layout.stretch["centre"], layout.stretch["slope"], layout.given["curving"]
    along = law.precurvature_variation

    @wp.func
    def precurvature_change(memory: memory_type, z: int, i: int, x: Real, g: int) -> Vec3:
        """Variation of u* for a direction, at a fixed part of the stretch."""
        first = g + wp.static(CURVING) + i * wp.static(3 * TERMS)
        u = row3(memory, first + wp.static(3 * (TERMS - 1)))
        if wp.static(VARIED):
            t = (x - row(memory, z + wp.static(CENTRE) + i)) * row(memory, z + wp.static(SLOPE) + i)
            for k in range(wp.static(TERMS - 1)):
                u = ahead3(row3(memory, first + wp.static(3 * (TERMS - 2 - k))), t, u)
            u = plus(u, along(memory, z, i, x, g))
        return u

    return SimpleNamespace(**(vars(law) | {"precurvature_variation": precurvature_change}))


def make_design_strains(layout: Layout, W: int, d, law: SimpleNamespace) -> SimpleNamespace:
    """(D5) to (D7) The strain law, whose variation has the change of the stiffnesses."""
    if layout.ECCENTRIC:
        return _of_eccentric_rods(layout, W, d, law)
    return _of_one_rod(layout, W, d, law) if layout.n == 1 else _of_several_rods(layout, W, d, law)


def _of_one_rod(layout: Layout, W: int, d, law: SimpleNamespace) -> SimpleNamespace:
    L, V = lanes(W, d), vectors(W, d)
    row, Vec3, row3, plus, minus, times = L.row, V.Vec3, V.row3, V.plus, V.minus, V.times
    memory_type = wp.array(dtype=d)
    Column = L.few(layout.column.size).type
    X, CURVATURE, SOFTENING = layout.place["x"], layout.place["curvature"], layout.given["softening"]
    MEMBERS = bool(layout.features.members)
    precurvature, free = law.precurvature, law.strain_variation
    give_way = law.give_way if MEMBERS else None

    @wp.func
    def strain_change(memory: memory_type, z: int, a: int, g: int, v: Column, dM: Vec3, dN: Vec3):
        """(D5) du and d(v - e3); dM and dN in the frame"""
        du, de = free(memory, z, a, g, v, dM, dN)
        bent = minus(row3(memory, a + wp.static(CURVATURE)), precurvature(memory, z, 0, row(memory, a + wp.static(X))))
        own = times(row3(memory, g + wp.static(SOFTENING)), bent)
        if wp.static(MEMBERS):
            own, slid = give_way(memory, a, own)
            de = plus(de, slid)
        return plus(du, own), de

    return SimpleNamespace(**(vars(law) | {"strain_variation": strain_change}))


def _of_several_rods(layout: Layout, W: int, d, law: SimpleNamespace) -> SimpleNamespace:
    L, V = lanes(W, d), vectors(W, d)
    fill, row, Vec3, row3, plus = L.fill, L.row, V.Vec3, V.row3, V.plus
    memory_type = wp.array(dtype=d)
    column = L.few(layout.column.size)
    Column, part_of, keep_in = column.type, column.part, column.keep
    n, TORQUES, p = layout.n, layout.TORQUES, layout.place
    X, CURVATURE, COSINE, SINE, RATE = p["x"], p["curvature"], p["cosine"], p["sine"], p["rate"]
    PRESENT, SOFTENING = layout.stretch["present"], layout.given["softening"]
    THETA, TAU = layout.column["angles"], layout.column["torques"]  # of rod 2
    precurvature, bent = law.precurvature, law.bent
    free, free_rates = law.strain_variation, law.rate_variations

    @wp.func
    def push(memory: memory_type, z: int, a: int, g: int, i: int) -> Vec3:
        """(D6) -dK_i (u - u*_i), along the axes of rod 1."""
        u_star = precurvature(memory, z, i, row(memory, a + wp.static(X)))
        u = row3(memory, a + wp.static(CURVATURE))
        c = fill(d(1.0))
        s = fill(d(0.0))
        if i > 0:
            c = row(memory, a + wp.static(COSINE) + i)
            s = row(memory, a + wp.static(SINE) + i)
        at = g + wp.static(SOFTENING) + 3 * i
        x = row(memory, at) * (u_star.x - (c * u.x + s * u.y))
        y = row(memory, at + 1) * (u_star.y - (c * u.y - s * u.x))
        return Vec3(c * x - s * y, s * x + c * y, fill(d(0.0)))

    @wp.func
    def strain_change(memory: memory_type, z: int, a: int, g: int, v: Column, dM: Vec3, dN: Vec3):
        """(D6) du, and no shear; dM in the frame"""
        du, de = free(memory, z, a, g, v, dM, dN)
        gx = fill(d(0.0))
        gy = fill(d(0.0))
        for i in range(wp.static(n)):
            own = push(memory, z, a, g, i)
            gx = gx + own.x
            gy = gy + own.y
        ux, uy = bent(memory, z, a, gx, gy)
        uz = fill(d(0.0))
        if wp.static(TORQUES > 0):
            u_star = precurvature(memory, z, 0, row(memory, a + wp.static(X)))
            twist = row(memory, a + wp.static(CURVATURE + 2)) - row(memory, z + wp.static(PRESENT)) * u_star.z
            uz = row(memory, g + wp.static(SOFTENING + 2)) * twist
        return plus(du, Vec3(ux, uy, uz)), de

    @wp.func
    def rate_changes(memory: memory_type, z: int, a: int, g: int, v: Column, du: Vec3, f: wp.ref[Column]):
        """(D6) of angles and torques."""
        free_rates(memory, z, a, g, v, du, f)
        u = row3(memory, a + wp.static(CURVATURE))
        for i in range(1, wp.static(n)):
            if wp.static(TORQUES > 0):
                u_star = precurvature(memory, z, i, row(memory, a + wp.static(X)))
                own = push(memory, z, a, g, i)
                keep_in(f, wp.static(TAU + i - 1), part_of(f, wp.static(TAU + i - 1)) + u.x * own.y - u.y * own.x)
                # what is left of its rate is by its own torque
                twist = row(memory, a + wp.static(RATE + THETA) + i - 1)
                twist = twist - row(memory, z + wp.static(PRESENT) + i) * (u_star.z - u.z)
                change = row(memory, g + wp.static(SOFTENING + 2) + 3 * i) * twist
                keep_in(f, wp.static(THETA + i - 1), part_of(f, wp.static(THETA + i - 1)) + change)

    return SimpleNamespace(**(vars(law) | {"strain_variation": strain_change, "rate_variations": rate_changes}))


def _of_eccentric_rods(layout: Layout, W: int, d, law: SimpleNamespace) -> SimpleNamespace:
    L, V = lanes(W, d), vectors(W, d)
    fill, row, Vec3, row3, plus = L.fill, L.row, V.Vec3, V.row3, V.plus
    memory_type = wp.array(dtype=d)
    column = L.few(layout.column.size)
    Column, part_of, keep_in = column.type, column.part, column.keep
    n, p, s = layout.n, layout.place, layout.stretch
    X, CURVATURE, COSINE, SINE, FLEXIBILITY = p["x"], p["curvature"], p["cosine"], p["sine"], p["flexibility"]
    STRETCHING, TWISTING, TORQUE = p["stretching"], p["twisting"], p["torque"]
    PRESENT, OFFSET, SOFTENING = s["present"], s["offset"], layout.given["softening"]
    THETA, TAU = layout.column["angles"], layout.column["torques"]
    precurvature, free, free_rates = law.precurvature, law.strain_variation, law.rate_variations

    @wp.func
    def answer(memory: memory_type, z: int, a: int, g: int, i: int):
        """(D7) dK_i d along the axes of the frame, what stretching the rod adds to it, and its twist by the change of 1/GJ."""
        u_star = precurvature(memory, z, i, row(memory, a + wp.static(X)))
        u = row3(memory, a + wp.static(CURVATURE))
        lam = row(memory, a + wp.static(STRETCHING) + i)
        c = row(memory, a + wp.static(COSINE) + i)
        s = row(memory, a + wp.static(SINE) + i)
        wx = u.x / lam
        wy = u.y / lam
        ex = c * wx + s * wy - u_star.x
        ey = c * wy - s * wx - u_star.y
        at = g + wp.static(SOFTENING) + 3 * i
        x = row(memory, at) * ex
        y = row(memory, at + 1) * ey
        half = d(0.5) * (ex * x + ey * y)
        mx = c * x - s * y
        my = s * x + c * y
        twist = row(memory, a + wp.static(TWISTING) + i) - row(memory, z + wp.static(PRESENT) + i) * u_star.z
        twist = row(memory, at + 2) * twist
        along = half - wx * mx - wy * my - d(0.5) * twist * row(memory, a + wp.static(TORQUE) + i)
        return mx, my, along, twist

    @wp.func
    def strain_change(memory: memory_type, z: int, a: int, g: int, v: Column, dM: Vec3, dN: Vec3):
        """(D7) du, and no shear; dM in the frame"""
        du, de = free(memory, z, a, g, v, dM, dN)
        gx = fill(d(0.0))
        gy = fill(d(0.0))
        for i in range(wp.static(n)):
            mx, my, along, _ = answer(memory, z, a, g, i)
            gx = gx - mx - along * row(memory, z + wp.static(OFFSET + 1) + 2 * i)
            gy = gy - my + along * row(memory, z + wp.static(OFFSET) + 2 * i)
        f = row3(memory, a + wp.static(FLEXIBILITY))
        return plus(du, Vec3(f.x * gx + f.y * gy, f.y * gx + f.z * gy, fill(d(0.0)))), de

    @wp.func
    def rate_changes(memory: memory_type, z: int, a: int, g: int, v: Column, du: Vec3, f: wp.ref[Column]):
        """(D7) of angles and torques."""
        free_rates(memory, z, a, g, v, du, f)
        u = row3(memory, a + wp.static(CURVATURE))
        for i in range(wp.static(n)):
            mx, my, _, twist = answer(memory, z, a, g, wp.static(i))
            lam = row(memory, a + wp.static(STRETCHING + i))
            keep_in(f, wp.static(THETA + i), part_of(f, wp.static(THETA + i)) + lam * twist)
            keep_in(f, wp.static(TAU + i), part_of(f, wp.static(TAU + i)) - u.x * my + u.y * mx)

    return SimpleNamespace(**(vars(law) | {"strain_variation": strain_change, "rate_variations": rate_changes}))
