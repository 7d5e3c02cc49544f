# mypy: ignore-errors
"""The strain law of concentric tubes that carry members, such as lines: their shared bending, and the twist of each that does.

``z`` is where the record of a stretch stands in memory, ``b`` the state, ``a`` where the record of a place stands, ``v`` a column
of the state and ``g`` where stands what its direction varies. Numbers in parentheses are those of ``docs/lines.md``; what the
tubes do without members is ``several``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.members.friction import make_grips
from multirod.models.backbone.kernels.members.newton import MOST_ITERATIONS, make_newton
from multirod.models.backbone.kernels.members.together import make_members
from multirod.models.backbone.kernels.members.tube_friction import make_tube_friction
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors

HUGE = {wp.float64: 1e300, wp.float32: 1e37}


def make_tubes_with_members(layout: Layout, W: int, d, law: SimpleNamespace, several: SimpleNamespace) -> SimpleNamespace:
    """(L15) to (L18): tubes share their bending with all members, and each its twist with its own."""
    L, V = lanes(W, d), vectors(W, d)
    Real, row, put, fill, any_less = L.Real, L.row, L.put, L.fill, L.any_less
    absolute, largest, where_less = L.absolute, L.largest, L.where_less
    Vec3, row3, put3, zero3, dot, minus = V.Vec3, V.row3, V.put3, V.zero3, V.dot, V.minus
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    part, keep, part_of, keep_in = state.part, state.keep, column.part, column.keep
    n, m, CARRIERS, TORQUES = layout.n, layout.SOLVED, layout.CARRIERS, layout.TORQUES
    FIRST_TWISTS = CARRIERS[0] == 0  # the frame turns with it
    members = {i: make_members(layout, W, d, i) for i in CARRIERS}
    newton = make_newton(layout, W, d, members[CARRIERS[0]])
    unsettled = newton.unsettled
    Response, part_of_response = members[CARRIERS[0]].Response, members[CARRIERS[0]].part_of_response
    PLACES = members[CARRIERS[0]].places
    drive_variation = members[CARRIERS[0]].drive_variation
    vector = L.few(m)
    Few, keep_one, one_of = vector.type, vector.keep, vector.part
    ANISOTROPIC, NODES = layout.features.anisotropic, layout.NODES
    VARIED = (layout.VARIED or layout.DESIGN) and layout.DIRECTIONS
    s, p, given = layout.stretch, layout.place, layout.given
    PRESENT, TORSION, UNIT_LENGTH, UNANSWERED = s["present"], s["torsion"], s["unit_length"], s["unanswered"]
    X, CURVATURE, COSINE, SINE, STIFFNESS = p["x"], p["curvature"], p["cosine"], p["sine"], p["stiffness"]
    TUBE_X, TUBE_Y, SLOPE_X, SLOPE_Y = p["tube_x"], p["tube_y"], p["slope_x"], p["slope_y"]
    SYSTEM, MEMBER_MOMENT, MEMBER_FORCE = p["system"], p["member_moment"], p["member_force"]
    OWN_STRAINS, EXCESS, MEMBER_STIFFNESS, TWIST_CHANGES = (
        p["own_strains"],
        p["excess"],
        p["member_stiffness"],
        p["twist_changes"],
    )
    PULLS_AT, SLIDES_AT, PULLED, ROUTED = p["pulls"], p["slides"], layout.PULLED, layout.ROUTED
    FORCE_AT, OWN_CURVATURE, TOTAL_MOMENT = p["force"], p["own_curvature"], p["total_moment"]
    OWN_MOMENT, OWN_FORCE = p["own_moment"], p["own_force"]
    ALONG, DRIVES_VARY, FRICTION = layout.ROUTED and layout.DIRECTIONS, layout.DRIVES_VARY, layout.FRICTION
    LENGTHS, LENGTHS_AT, SLID = layout.LENGTHS > 0, layout.state["lengths"], p["slides"] + 3 * len(CARRIERS)
    THETA, TAU = layout.state["angles"], layout.state["torques"]  # of tube 2; a column's stand alike
    GIVEN_START, GROWTH, SHIFT = given["start"], given["growth"], given["shift"]
    precurvature = law.precurvature
    bent, inner_torque, put_bent, put_free = several.bent, several.inner_torque, several.put_bent, several.put_own
    turned_variation, free_strain, free_rates = several.turned_variation, several.strain, several.rates
    free_variation, free_rate_variations, free_energy = (
        several.strain_variation,
        several.rate_variations,
        several.energy_rate,
    )

    def over_carriers(make, nothing):
        """One function that does something for each tube that carries members: ``make(number, tube, its members, rest)``."""
        found = nothing
        for j, i in reversed(list(enumerate(CARRIERS))):
            found = make(j, i, members[i], found)
        return found

    @wp.func
    def turned(memory: memory_type, a: int, i: int, v: Vec3) -> Vec3:
        """A vector of tube i along the axes of tube 1."""
        if i == 0:
            return v
        c = row(memory, a + wp.static(COSINE) + i)
        s = row(memory, a + wp.static(SINE) + i)
        return Vec3(c * v.x - s * v.y, s * v.x + c * v.y, v.z)

    @wp.func
    def turned_back(memory: memory_type, a: int, i: int, v: Vec3) -> Vec3:
        """A vector along the axes of tube 1, along those of tube i."""
        if i == 0:
            return v
        c = row(memory, a + wp.static(COSINE) + i)
        s = row(memory, a + wp.static(SINE) + i)
        return Vec3(c * v.x + s * v.y, c * v.y - s * v.x, v.z)

    @wp.func
    def put_stiffness(memory: memory_type, D: int, a: int, i: int, softness: Real, r: Response):
        """(L17) D of tube i by bending along the axes of tube 1, xx, xy, yy; by bending and twist, xz, yz; and what is left of
        a change of twist that its members resist."""
        xx = part_of_response(r, wp.static(PLACES[0][0]))
        xy = part_of_response(r, wp.static(PLACES[0][1]))
        yy = part_of_response(r, wp.static(PLACES[1][1]))
        w = Vec3(part_of_response(r, wp.static(PLACES[0][2])), part_of_response(r, wp.static(PLACES[1][2])), fill(d(0.0)))
        if i > 0:
            c = row(memory, a + wp.static(COSINE) + i)
            s = row(memory, a + wp.static(SINE) + i)
            twice = d(2.0) * c * s * xy
            across = c * s * (xx - yy) + (c * c - s * s) * xy
            along = c * c * xx - twice + s * s * yy
            yy = s * s * xx + twice + c * c * yy
            xx = along
            xy = across
            w = turned(memory, a, i, w)
        put(memory, D, xx)
        put(memory, D + 1, xy)
        put(memory, D + 2, yy)
        put(memory, D + 3, w.x)
        put(memory, D + 4, w.y)
        put(memory, D + 5, d(1.0) / (d(1.0) + softness * part_of_response(r, wp.static(PLACES[2][2]))))

    @wp.func
    def own_torque(memory: memory_type, z: int, b: State, i: int, M_z: Real) -> Real:
        """tau_i, which a tube and its members carry together."""
        if wp.static(TORQUES == 0):
            return fill(d(0.0))
        if i == 0:
            return inner_torque(memory, z, b, M_z)
        return part(b, wp.static(TAU) + i - 1)

    # ---- (L16): strains ----

    def start_of(j: int, i: int, own: SimpleNamespace, rest):
        at_place, put_grips, first = own.at_place, make_grips(layout, W, d, own), own.first_drive

        @wp.func
        def begin(memory: memory_type, z: int, a: int, x: Real, b: State, M_z: Real, start: wp.ref[Few]):
            if wp.static(ROUTED):
                at_place(memory, z, a, x)
            if wp.static(FRICTION):
                put_grips(memory, z, a, b, wp.static(first))
            u_star = precurvature(memory, z, wp.static(i), x)
            twist = row(memory, z + wp.static(PRESENT + i)) * u_star.z
            twist = twist + row(memory, z + wp.static(TORSION + i)) * own_torque(memory, z, b, wp.static(i), M_z)
            keep_one(start, wp.static(2 + j), twist)
            rest(memory, z, a, x, b, M_z, start)

        return begin

    @wp.func
    def no_start(memory: memory_type, z: int, a: int, x: Real, b: State, M_z: Real, start: wp.ref[Few]):
        """After the last."""

    @wp.func
    def own_strains(memory: memory_type, a: int, i: int, j: int, q: Few) -> Vec3:
        """(L15) u_i of tube i, the j-th that carries members."""
        u = turned_back(memory, a, i, Vec3(one_of(q, 0), one_of(q, 1), fill(d(0.0))))
        return Vec3(u.x, u.y, one_of(q, 2 + j))

    def answer_of(j: int, i: int, own: SimpleNamespace, rest):
        respond = own.respond

        @wp.func
        def answer(memory: memory_type, z: int, a: int, q: Few, carried: wp.ref[Few]):
            u = own_strains(memory, a, wp.static(i), wp.static(j), q)
            r = Response()
            respond(memory, z, a, u, zero3(), r)
            g = Vec3(part_of_response(r, 0), part_of_response(r, 1), part_of_response(r, 2))
            put3(memory, a + wp.static(OWN_STRAINS + 3 * j), u)
            put3(memory, a + wp.static(MEMBER_MOMENT + 3 * j), g)
            if wp.static(NODES):
                own_force = Vec3(part_of_response(r, 3), part_of_response(r, 4), part_of_response(r, 5))
                put3(memory, a + wp.static(MEMBER_FORCE + 3 * j), own_force)
            softness = row(memory, z + wp.static(TORSION + i))
            put_stiffness(memory, a + wp.static(MEMBER_STIFFNESS + 6 * j), a, wp.static(i), softness, r)
            G = turned(memory, a, wp.static(i), g)
            keep_one(carried, 0, one_of(carried, 0) + G.x)
            keep_one(carried, 1, one_of(carried, 1) + G.y)
            keep_one(carried, wp.static(2 + j), G.z)
            rest(memory, z, a, q, carried)

        return answer

    @wp.func
    def no_answer(memory: memory_type, z: int, a: int, q: Few, carried: wp.ref[Few]):
        """After the last."""

    @wp.func
    def give(memory: memory_type, z: int, a: int, r: Few) -> Few:
        """C r: strains by a moment that bends, and the torques of the tubes that carry members."""
        q = Few()
        ux, uy = bent(memory, z, a, one_of(r, 0), one_of(r, 1))
        keep_one(q, 0, ux)
        keep_one(q, 1, uy)
        for j in range(wp.static(len(CARRIERS))):
            keep_one(q, wp.static(2 + j), row(memory, z + wp.static(TORSION + CARRIERS[j])) * one_of(r, wp.static(2 + j)))
        return q

    @wp.func
    def factor(memory: memory_type, z: int, a: int):
        """(L17) The inverse of I + C D where the twists are eliminated: each is coupled to the bending alone."""
        xx = fill(d(0.0))
        xy = fill(d(0.0))
        yy = fill(d(0.0))
        for j in range(wp.static(len(CARRIERS))):
            D = a + wp.static(MEMBER_STIFFNESS + 6 * j)
            wx = row(memory, D + 3)
            wy = row(memory, D + 4)
            less = row(memory, D + 5) * row(memory, z + wp.static(TORSION + CARRIERS[j]))
            xx = xx + row(memory, D) - less * wx * wx
            xy = xy + row(memory, D + 1) - less * wx * wy
            yy = yy + row(memory, D + 2) - less * wy * wy
        a_xx, a_yx = bent(memory, z, a, xx, xy)
        a_xy, a_yy = bent(memory, z, a, xy, yy)
        a_xx = a_xx + d(1.0)
        a_yy = a_yy + d(1.0)
        scale = d(1.0) / (a_xx * a_yy - a_xy * a_yx)
        put(memory, a + wp.static(SYSTEM), scale * a_yy)
        put(memory, a + wp.static(SYSTEM + 1), -scale * a_xy)
        put(memory, a + wp.static(SYSTEM + 2), -scale * a_yx)
        put(memory, a + wp.static(SYSTEM + 3), scale * a_xx)

    @wp.func
    def solve(memory: memory_type, z: int, a: int, r: Few) -> Few:
        """(L17) (I + C D)^-1 r"""
        x = fill(d(0.0))
        y = fill(d(0.0))
        for j in range(wp.static(len(CARRIERS))):
            D = a + wp.static(MEMBER_STIFFNESS + 6 * j)
            twist = row(memory, D + 5) * one_of(r, wp.static(2 + j))
            x = x + twist * row(memory, D + 3)
            y = y + twist * row(memory, D + 4)
        back_x, back_y = bent(memory, z, a, x, y)
        rx = one_of(r, 0) - back_x
        ry = one_of(r, 1) - back_y
        ux = row(memory, a + wp.static(SYSTEM)) * rx + row(memory, a + wp.static(SYSTEM + 1)) * ry
        uy = row(memory, a + wp.static(SYSTEM + 2)) * rx + row(memory, a + wp.static(SYSTEM + 3)) * ry
        q = Few()
        keep_one(q, 0, ux)
        keep_one(q, 1, uy)
        for j in range(wp.static(len(CARRIERS))):
            D = a + wp.static(MEMBER_STIFFNESS + 6 * j)
            couple = row(memory, z + wp.static(TORSION + CARRIERS[j])) * (row(memory, D + 3) * ux + row(memory, D + 4) * uy)
            keep_one(q, wp.static(2 + j), row(memory, D + 5) * (one_of(r, wp.static(2 + j)) - couple))
        return q

    def settled_of(j: int, i: int, own: SimpleNamespace, rest):
        put_pulls, put_slides, first = own.put_pulls, own.put_slides, own.first_drive

        @wp.func
        def settle(memory: memory_type, z: int, a: int, q: Few, start: Few):
            u = row3(memory, a + wp.static(OWN_STRAINS + 3 * j))
            put(memory, a + wp.static(EXCESS + j), u.z - one_of(start, wp.static(2 + j)))
            D = a + wp.static(MEMBER_STIFFNESS + 6 * j)
            xy = row(memory, D + 1)
            G = turned(memory, a, wp.static(i), row3(memory, a + wp.static(MEMBER_MOMENT + 3 * j)))
            ux = one_of(q, 0)
            uy = one_of(q, 1)
            x = row(memory, a + wp.static(SLOPE_X + i)) + G.y + xy * ux - row(memory, D) * uy
            y = row(memory, a + wp.static(SLOPE_Y + i)) - G.x + row(memory, D + 2) * ux - xy * uy
            put(memory, a + wp.static(SLOPE_X + i), x)
            put(memory, a + wp.static(SLOPE_Y + i), y)
            put(memory, a + wp.static(TUBE_X + i), row(memory, a + wp.static(TUBE_X + i)) - G.x)
            put(memory, a + wp.static(TUBE_Y + i), row(memory, a + wp.static(TUBE_Y + i)) - G.y)
            if wp.static(PULLED):
                put_pulls(memory, z, a, u, zero3(), wp.static(first))
            if wp.static(ALONG):
                moving = Response()
                put_slides(memory, z, a, u, zero3(), moving, wp.static(first))
                for k in range(3):
                    put(memory, a + wp.static(SLIDES_AT + 3 * j) + k, part_of_response(moving, k))
            rest(memory, z, a, q, start)

        return settle

    @wp.func
    def not_settled(memory: memory_type, z: int, a: int, q: Few, start: Few):
        """After the last."""

    begin_all = over_carriers(start_of, no_start)
    answer_all = over_carriers(answer_of, no_answer)
    settle_all = over_carriers(settled_of, not_settled)

    @wp.func
    def bend_tubes(memory: memory_type, a: int, ux: Real, uy: Real, from_x: Real, from_y: Real):
        """(8) of docs/model.md: what the place holds of tubes that are not equally stiff about both axes, at another bending."""
        for i in range(wp.static(n)):
            k = row3(memory, a + wp.static(STIFFNESS) + 3 * i)
            x = ux - from_x
            y = uy - from_y
            cx = row(memory, a + wp.static(TUBE_X) + i) - k.x * x - k.y * y
            cy = row(memory, a + wp.static(TUBE_Y) + i) - k.y * x - k.z * y
            put_bent(memory, a, i, cx, cy, ux, uy)

    @wp.func
    def strain(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3) -> Vec3:
        """(L16) u, by Newton's method from where members carry nothing; what columns need is put to the place."""
        free = free_strain(memory, z, a, x, b, M, N)
        start = Few()
        keep_one(start, 0, free.x)
        keep_one(start, 1, free.y)
        begin_all(memory, z, a, x, b, M.z, start)
        length = row(memory, z + wp.static(UNIT_LENGTH))
        one = fill(d(1.0))
        zero = fill(d(0.0))
        q = Few()
        for i in range(wp.static(m)):
            keep_one(q, i, one_of(start, i))
        step = Few()
        open_ = one
        count = int(0)
        while any_less(zero, open_) and count < wp.static(MOST_ITERATIONS):
            for i in range(wp.static(m)):
                # a lane that is done stays where it is, whatever the others do: its last step is taken below
                keep_one(q, i, one_of(q, i) + open_ * one_of(step, i))
            carried = Few()
            answer_all(memory, z, a, q, carried)
            factor(memory, z, a)
            back = give(memory, z, a, carried)
            gap = Few()
            for i in range(wp.static(m)):
                keep_one(gap, i, one_of(start, i) - one_of(back, i) - one_of(q, i))
            step = solve(memory, z, a, gap)
            open_ = unsettled(step, q, start, length, length)
            count += int(1)
        for i in range(wp.static(m)):
            keep_one(q, i, one_of(q, i) + one_of(step, i))
        bad = d(0.0) / (one - open_)  # no number where it did not settle
        if any_less(zero, open_):
            # where what it should settle for is a number, it is the law that fails
            asked = zero
            for i in range(wp.static(m)):
                asked = asked + absolute(one_of(start, i))
            known = where_less(asked, fill(d(wp.static(HUGE[d]))), one, zero)
            put(memory, z + wp.static(UNANSWERED), largest(row(memory, z + wp.static(UNANSWERED)), open_ * known))
        last = Few()
        answer_all(memory, z, a, q, last)
        factor(memory, z, a)
        if wp.static(ANISOTROPIC):
            bend_tubes(memory, a, one_of(q, 0), one_of(q, 1), free.x, free.y)
        settle_all(memory, z, a, q, start)
        uz = free.z
        if wp.static(FIRST_TWISTS):
            uz = one_of(q, 2)
        return Vec3(one_of(q, 0) + bad, one_of(q, 1) + bad, uz + bad)

    # ---- (L15): rates, lengths, energies ----

    def rates_of(j: int, i: int, own: SimpleNamespace, rest):
        keep_lengths, first = own.keep_lengths, own.first_drive

        @wp.func
        def rates(memory: memory_type, z: int, a: int, f: wp.ref[State]):
            if wp.static(i > 0):
                at = wp.static(THETA + i - 1)
                keep(f, at, part(f, at) + row(memory, a + wp.static(EXCESS + j)))
            if wp.static(LENGTHS):
                keep_lengths(memory, z, a, row3(memory, a + wp.static(OWN_STRAINS + 3 * j)), zero3(), f, wp.static(first))
            rest(memory, z, a, f)

        return rates

    @wp.func
    def no_rates(memory: memory_type, z: int, a: int, f: wp.ref[State]):
        """After the last."""

    rates_all = over_carriers(rates_of, no_rates)

    @wp.func
    def rates(memory: memory_type, z: int, a: int, x: Real, b: State, u: Vec3, f: wp.ref[State]):
        """(8) of docs/model.md, and what drives work on, (L5)."""
        free_rates(memory, z, a, x, b, u, f)
        rates_all(memory, z, a, f)

    @wp.func
    def length_rates(memory: memory_type, z: int, a: int, u: Vec3, f: wp.ref[State]):
        """With the other rates."""

    def energy_of(j: int, i: int, own: SimpleNamespace, rest):
        energy_of_members = own.energy

        @wp.func
        def energy(memory: memory_type, z: int, a: int, b: State, M_z: Real) -> Real:
            g = row(memory, a + wp.static(MEMBER_MOMENT + 3 * j + 2))
            tau = own_torque(memory, z, b, wp.static(i), M_z)
            twisted = row(memory, z + wp.static(TORSION + i)) * g * (g - d(2.0) * tau)
            u = row3(memory, a + wp.static(OWN_STRAINS + 3 * j))
            return twisted + d(2.0) * energy_of_members(memory, z, a, u, zero3()) + rest(memory, z, a, b, M_z)

        return energy

    @wp.func
    def no_energy(memory: memory_type, z: int, a: int, b: State, M_z: Real) -> Real:
        return fill(d(0.0))

    energy_of_all = over_carriers(energy_of, no_energy)

    @wp.func
    def energy_rate(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3, u: Vec3) -> Real:
        """(14) of docs/model.md: a tube is twisted by what its members leave of its torque. Theirs with it."""
        return free_energy(memory, z, a, x, b, M, N, u) + energy_of_all(memory, z, a, b, M.z)

    def work_of(j: int, i: int, own: SimpleNamespace, rest):
        work_of_drives = own.work_of_drives

        @wp.func
        def work(memory: memory_type, z: int, a: int) -> Real:
            u = row3(memory, a + wp.static(OWN_STRAINS + 3 * j))
            return work_of_drives(memory, z, a, u, zero3()) + rest(memory, z, a)

        return work

    @wp.func
    def no_work(memory: memory_type, z: int, a: int) -> Real:
        return fill(d(0.0))

    work_of_all = over_carriers(work_of, no_work)

    @wp.func
    def driven_work(memory: memory_type, z: int, a: int, u: Vec3) -> Real:
        """Work per length of what drives members."""
        return -work_of_all(memory, z, a)

    # ---- (L15): what each tube has itself ----

    def own_of(j: int, i: int, own: SimpleNamespace, rest):
        @wp.func
        def put(memory: memory_type, a: int):
            at = a + wp.static(OWN_CURVATURE + 3 * i)
            u = row3(memory, at)
            put3(memory, at, Vec3(u.x, u.y, u.z + row(memory, a + wp.static(EXCESS + j))))
            carried = turned(memory, a, wp.static(i), row3(memory, a + wp.static(MEMBER_MOMENT + 3 * j)))
            put3(memory, a + wp.static(OWN_MOMENT + 3 * i), minus(row3(memory, a + wp.static(TOTAL_MOMENT + 3 * i)), carried))
            pull = turned(memory, a, wp.static(i), row3(memory, a + wp.static(MEMBER_FORCE + 3 * j)))
            put3(memory, a + wp.static(OWN_FORCE), minus(row3(memory, a + wp.static(OWN_FORCE)), pull))
            rest(memory, a)

        return put

    @wp.func
    def no_own(memory: memory_type, a: int):
        """After the last."""

    put_own_of_all = over_carriers(own_of, no_own)

    @wp.func
    def put_own(memory: memory_type, z: int, a: int, b: State):
        """To the place: what each tube and its members have together, and what it has itself; its force is that of all tubes."""
        put_free(memory, z, a, b)
        for i in range(wp.static(n)):
            put3(memory, a + wp.static(OWN_MOMENT + 3 * i), row3(memory, a + wp.static(TOTAL_MOMENT + 3 * i)))
        put3(memory, a + wp.static(OWN_FORCE), row3(memory, a + wp.static(FORCE_AT)))
        put_own_of_all(memory, a)

    # ---- (L18): columns ----

    @wp.func
    def moved(memory: memory_type, a: int, g: int, i: int) -> Real:
        """How far a place at a fixed part of the stretch moves along tube i, for a direction."""
        x = row(memory, a + wp.static(X))
        shift = row(memory, g + wp.static(SHIFT) + i)
        return row(memory, g + wp.static(GIVEN_START)) + x * row(memory, g + wp.static(GROWTH)) - shift

    @wp.func
    def pushed(memory: memory_type, a: int, g: int, v: Column, i: int, j: int, first: int, count: int) -> Vec3:
        """What the members of tube i answer more where strains and angle do not change, along the axes of tube 1: by their
        drives, and by their way along the tube."""
        total = zero3()
        if wp.static(DRIVES_VARY or FRICTION):
            for k in range(count):
                change = drive_variation(memory, a, g, v, first + k)
                pull = row3(memory, a + wp.static(PULLS_AT) + 3 * (first + k))
                total = Vec3(total.x + change * pull.x, total.y + change * pull.y, total.z + change * pull.z)
        if wp.static(ALONG):
            by = moved(memory, a, g, i)
            slide = row3(memory, a + wp.static(SLIDES_AT) + 3 * j)
            total = Vec3(total.x + by * slide.x, total.y + by * slide.y, total.z + by * slide.z)
        return turned(memory, a, i, total)

    @wp.func
    def turn_of(v: Column, i: int) -> Real:
        """How a column turns tube i against tube 1."""
        if i == 0:
            return fill(d(0.0))
        return part_of(v, wp.static(THETA) + i - 1)

    def right_of(j: int, i: int, own: SimpleNamespace, rest):
        first, count = own.first_drive, own.drive_count

        @wp.func
        def right(memory: memory_type, z: int, a: int, g: int, v: Column, twist_1: Real, free: wp.ref[Few], less: wp.ref[Few]):
            softness = row(memory, z + wp.static(TORSION + i))
            twist = twist_1
            if wp.static(i > 0):
                twist = fill(d(0.0))
                if wp.static(TORQUES > 0):
                    twist = softness * part_of(v, wp.static(TAU + i - 1))
                if wp.static(VARIED):
                    e = turned_variation(memory, z, a, wp.static(i), g)
                    twist = twist + row(memory, z + wp.static(PRESENT + i)) * e.z
            keep_one(free, wp.static(2 + j), twist)
            more = pushed(memory, a, g, v, wp.static(i), wp.static(j), wp.static(first), wp.static(count))
            keep_one(less, 0, one_of(less, 0) + more.x)
            keep_one(less, 1, one_of(less, 1) + more.y)
            # the bending goes round in the frame of the tube as that turns
            u = row3(memory, a + wp.static(CURVATURE))
            D = a + wp.static(MEMBER_STIFFNESS + 6 * j)
            by_turn = row(memory, D + 3) * u.y - row(memory, D + 4) * u.x
            keep_one(less, wp.static(2 + j), more.z + by_turn * turn_of(v, wp.static(i)))
            rest(memory, z, a, g, v, twist_1, free, less)

        return right

    @wp.func
    def no_right(memory: memory_type, z: int, a: int, g: int, v: Column, twist_1: Real, free: wp.ref[Few], less: wp.ref[Few]):
        """After the last."""

    right_all = over_carriers(right_of, no_right)

    @wp.func
    def strain_variation(memory: memory_type, z: int, a: int, g: int, v: Column, dM: Vec3, dN: Vec3):
        """(L18) du, and no shear; dM in the frame"""
        without, none = free_variation(memory, z, a, g, v, dM, dN)
        free = Few()
        less = Few()
        keep_one(free, 0, without.x)
        keep_one(free, 1, without.y)
        right_all(memory, z, a, g, v, without.z, free, less)
        back = give(memory, z, a, less)
        right = Few()
        for i in range(wp.static(m)):
            keep_one(right, i, one_of(free, i) - one_of(back, i))
        q = solve(memory, z, a, right)
        for j in range(wp.static(len(CARRIERS))):
            twist = one_of(q, 2 + j)
            put(memory, a + wp.static(TWIST_CHANGES) + 2 * j, twist)
            put(memory, a + wp.static(TWIST_CHANGES) + 2 * j + 1, twist - one_of(free, 2 + j))
        uz = without.z
        if wp.static(FIRST_TWISTS):
            uz = one_of(q, 2)
        return Vec3(one_of(q, 0), one_of(q, 1), uz), none

    def rate_variations_of(j: int, i: int, own: SimpleNamespace, rest):
        first, count = own.first_drive, own.drive_count

        @wp.func
        def vary(memory: memory_type, a: int, g: int, v: Column, du: Vec3, f: wp.ref[Column]):
            u = row3(memory, a + wp.static(CURVATURE))
            twist = row(memory, a + wp.static(TWIST_CHANGES + 2 * j))
            if wp.static(i > 0):
                at = wp.static(THETA + i - 1)
                keep_in(f, at, part_of(f, at) + row(memory, a + wp.static(TWIST_CHANGES + 2 * j + 1)))
                if wp.static(TORQUES > 0):
                    more = pushed(memory, a, g, v, wp.static(i), wp.static(j), wp.static(first), wp.static(count))
                    D = a + wp.static(MEMBER_STIFFNESS + 6 * j)
                    x = more.x + row(memory, D) * du.x + row(memory, D + 1) * du.y + row(memory, D + 3) * twist
                    y = more.y + row(memory, D + 1) * du.x + row(memory, D + 2) * du.y + row(memory, D + 4) * twist
                    at_tau = wp.static(TAU + i - 1)
                    keep_in(f, at_tau, part_of(f, at_tau) - (u.x * y - u.y * x))
            if wp.static(LENGTHS):
                turn = turn_of(v, wp.static(i))
                bend = Vec3(du.x + turn * u.y, du.y - turn * u.x, twist)
                own_change = turned_back(memory, a, wp.static(i), bend)
                for k in range(wp.static(count)):
                    change = dot(row3(memory, a + wp.static(PULLS_AT + 3 * first) + 3 * k), own_change)
                    if wp.static(ALONG):
                        slid = row(memory, a + wp.static(SLID + first) + k)
                        change = change + moved(memory, a, g, wp.static(i)) * slid
                    keep_in(f, wp.static(LENGTHS_AT + first) + k, change)
            rest(memory, a, g, v, du, f)

        return vary

    @wp.func
    def no_rate_variations(memory: memory_type, a: int, g: int, v: Column, du: Vec3, f: wp.ref[Column]):
        """After the last."""

    rate_variations_all = over_carriers(rate_variations_of, no_rate_variations)

    @wp.func
    def rate_variations(memory: memory_type, z: int, a: int, g: int, v: Column, du: Vec3, f: wp.ref[Column]):
        """(L18)"""
        free_rate_variations(memory, z, a, g, v, du, f)
        rate_variations_all(memory, a, g, v, du, f)

    @wp.func
    def length_variations(memory: memory_type, a: int, g: int, du: Vec3, de: Vec3, f: wp.ref[Column]):
        """With the other rates."""

    own = {"bent": bent, "turned": turned, "turned_back": turned_back, "give": give, "pushed": pushed, "turn_of": turn_of}
    own |= {"stiffened": several.stiffened, "slope": several.slope}
    own |= {"over_carriers": over_carriers, "unsettled": unsettled, "drive_variation": drive_variation}
    friction = make_tube_friction(layout, W, d, law, SimpleNamespace(**own)) if FRICTION else None
    return SimpleNamespace(
        put_own=put_own,
        strain=strain,
        rates=rates,
        energy_rate=energy_rate,
        driven_work=driven_work,
        length_rates=length_rates,
        length_variations=length_variations,
        strain_variation=strain_variation,
        rate_variations=rate_variations,
        friction_rates=friction.rates if friction else None,
        friction_variations=friction.variations if friction else None,
    )
