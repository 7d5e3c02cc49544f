# mypy: ignore-errors
"""The strain law of a rod with members: strains from force and moment by Newton's method, (5m), and its variation, (17m).

``z`` is where the record of a stretch stands in memory, ``a`` where that of a place stands, ``x`` the arclength from the start of
the stretch. Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.members.friction import make_friction
from multirod.models.backbone.kernels.members.newton import MOST_ITERATIONS, make_newton
from multirod.models.backbone.kernels.members.together import make_members
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors

MOST_WARM = 8  # after which Newton's method begins anew, where members carry nothing
HUGE = {wp.float64: 1e300, wp.float32: 1e37}


def make_rod_with_members(layout: Layout, W: int, d, law: SimpleNamespace, alone: SimpleNamespace) -> SimpleNamespace:
    """(5m): the rod and its members share the strains, and carry force and moment together; ``alone`` is the rod without."""
    L, V = lanes(W, d), vectors(W, d)
    members = make_members(layout, W, d)
    newton = make_newton(layout, W, d, members)
    friction = make_friction(layout, W, d, law, members, newton)
    Real, row, put, fill, any_less = L.Real, L.row, L.put, L.fill, L.any_less
    absolute, largest, where_less = L.absolute, L.largest, L.where_less
    Vec3, row3, put3, zero3 = V.Vec3, V.row3, V.put3, V.zero3
    minus, dot, ahead3 = V.minus, V.dot, V.ahead3
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column, keep_in = state.type, column.type, column.keep
    SHEAR, NODES, m = layout.features.shear, layout.NODES, layout.STRAINS
    s, p, given = layout.stretch, layout.place, layout.given
    UNIT_LENGTH = s["unit_length"]
    X, EXTENSION_AT, SYSTEM, CURVATURE = p["x"], p["extension"], p["system"], p["curvature"]
    MOMENT_AT, FORCE_AT = p["moment"], p["force"]
    OWN_CURVATURE, TOTAL_MOMENT, OWN_MOMENT, OWN_FORCE = p["own_curvature"], p["total_moment"], p["own_moment"], p["own_force"]
    MEMBER_MOMENT, MEMBER_FORCE, UNANSWERED = p["member_moment"], p["member_force"], s["unanswered"]
    PLACES = members.places
    KNOWN_AT, STRAINS_AT, DRIFT, FIRST_OF_LAST = s["place"], s["strains"], s["drift"], s["strains"]
    FREE_STRAINS, LAST_SYSTEM, BOUNDED = s["free_strains"], s["last_system"], members.bounded
    Matrix, factor, solve = newton.Matrix, newton.factor, newton.solve
    read_matrix, write_matrix, tangent, unsettled = newton.read_matrix, newton.write_matrix, newton.tangent, newton.unsettled
    changed = newton.changed
    vector = L.few(m)
    Few, keep_one, one_of = vector.type, vector.keep, vector.part
    choose, write_vector = vector.where_less, vector.write
    slid, free_strain, free_variation, free_energy = alone.slid, alone.free_strain, alone.strain_variation, alone.energy_rate
    Response, part_of_response, answer = members.Response, members.part_of_response, members.answer
    at_place, extension_at, compliances = members.at_place, members.extension_at, members.compliances
    drive_variation, put_pulls, put_slides = members.drive_variation, members.put_pulls, members.put_slides
    energy_of_members, work_of_drives, keep_lengths = members.energy, members.work_of_drives, members.keep_lengths
    put_grips = friction.put_grips
    ROUTED, ALONG = layout.ROUTED, layout.ROUTED and layout.DIRECTIONS
    DRIVES, LENGTHS, LENGTHS_AT = layout.DRIVES, layout.LENGTHS, layout.state["lengths"]
    PULLS_AT, SLIDES_AT = p["pulls"], p["slides"]
    PULLS, DRIVES_VARY, FRICTION = DRIVES * layout.PULLED, layout.DRIVES_VARY, layout.FRICTION
    GIVEN_START, GROWTH, SHIFT = given["start"], given["growth"], given["shift"]

    @wp.func
    def way(memory: memory_type, z: int, x: Real) -> Real:
        """(L20) What the last drift is multiplied by: the way from the last place, or the square of it."""
        by = x - row(memory, z + wp.static(KNOWN_AT))
        if wp.static(not ROUTED):
            by = by * by
        return by

    @wp.func
    def led_to(memory: memory_type, z: int, start: Few) -> Few:
        """(L20) Where the last strains on this stretch lead, by what strains would be without members; where there are none
        yet, to these."""
        change = Few()
        for i in range(wp.static(m)):
            keep_one(change, i, one_of(start, i) - row(memory, z + wp.static(FREE_STRAINS + i)))
        change = solve(read_matrix(memory, z + wp.static(LAST_SYSTEM)), change)
        q = Few()
        for i in range(wp.static(m)):
            keep_one(q, i, row(memory, z + wp.static(STRAINS_AT + i)) + one_of(change, wp.static(i)))
        return q

    @wp.func
    def remember(memory: memory_type, z: int, x: Real, by: Real, q: Few, led: Few, start: Few, A: Matrix):
        """Strains at x, where ``led`` is where the last ones led."""
        zero = fill(d(0.0))
        elsewhere = where_less(zero, absolute(by), fill(d(1.0)), zero)
        per = elsewhere / (by + (d(1.0) - elsewhere))
        half = fill(d(0.5))
        for i in range(wp.static(m)):
            last = row(memory, z + wp.static(DRIFT + i))
            found = per * (one_of(q, i) - one_of(led, wp.static(i)))
            put(memory, z + wp.static(DRIFT + i), where_less(half, elsewhere, found, last))
        put(memory, z + wp.static(KNOWN_AT), x)
        write_vector(memory, z + wp.static(STRAINS_AT), q)
        write_vector(memory, z + wp.static(FREE_STRAINS), start)
        write_matrix(memory, z + wp.static(LAST_SYSTEM), A)

    @wp.func
    def forget(memory: memory_type, z: int, of: Real):
        """The last strains of the lanes where ``of`` is one: as at the start of the stretch."""
        half = fill(d(0.5))
        zero = fill(d(0.0))
        for j in range(wp.static(layout.LAST_STRAINS)):
            at = z + wp.static(FIRST_OF_LAST) + j
            put(memory, at, where_less(half, of, zero, row(memory, at)))
        for j in range(wp.static(m)):
            at = z + wp.static(LAST_SYSTEM) + j * wp.static(m + 1)
            put(memory, at, where_less(half, of, fill(d(1.0)), row(memory, at)))

    @wp.func
    def strain(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3) -> Vec3:
        """(5m) u, and v - e3 to the place: the zero of ``u* + K^-1 (M - dW/du) - u`` and its like.

        The search for it begins where the last ones on this stretch lead, or where members carry nothing.
        """
        if wp.static(ROUTED):
            at_place(memory, z, a, x)
        if wp.static(FRICTION):
            put_grips(memory, z, a, b, 0)
        c = compliances(memory, z)
        free = free_strain(memory, z, x, M)
        start = Few()
        keep_one(start, 0, free.x)
        keep_one(start, 1, free.y)
        keep_one(start, 2, free.z)
        if wp.static(SHEAR):
            extension = slid(memory, z, N)
            keep_one(start, 3, extension.x)
            keep_one(start, 4, extension.y)
            keep_one(start, 5, extension.z)
        length = row(memory, z + wp.static(UNIT_LENGTH))
        one = fill(d(1.0))
        zero = fill(d(0.0))
        half = fill(d(0.5))
        by = way(memory, z, x)
        led = led_to(memory, z, start)
        q = Few()
        for i in range(wp.static(m)):
            keep_one(q, i, one_of(led, i) + by * row(memory, z + wp.static(DRIFT + i)))
        r = Response()
        A = Matrix()
        step = Few()
        # a lane without a job, or whose rod has run away, has no strains and holds up none of the others
        asked = zero
        for i in range(wp.static(m)):
            asked = asked + absolute(one_of(start, i))
        number = where_less(asked, fill(d(wp.static(HUGE[d]))), one, zero)
        open_ = number
        count = int(0)
        while any_less(zero, open_) and count < wp.static(MOST_WARM + MOST_ITERATIONS):
            for i in range(wp.static(m)):
                # a lane that is done stays where it is, whatever the others do: its last step is taken below
                keep_one(q, i, one_of(q, i) + open_ * one_of(step, wp.static(i)))
            if count == wp.static(MOST_WARM):
                q = choose(half, open_, start, q)
            r = answer(memory, z, a, q)
            A = tangent(c, r)
            factor(A)
            rest = Few()
            for i in range(wp.static(m)):
                keep_one(rest, i, one_of(start, i) - one_of(c, i) * part_of_response(r, i) - one_of(q, wp.static(i)))
            step = solve(A, rest)
            if wp.static(BOUNDED):
                open_ = number * changed(c, r, step)
            else:
                open_ = number
            if any_less(zero, open_):
                open_ = open_ * unsettled(step, q, start, length, one)
            count += int(1)
        for i in range(wp.static(m)):
            keep_one(q, i, one_of(q, i) + one_of(step, i))
        sound = number - open_
        bad = where_less(half, sound, zero, fill(d(0.0) / d(0.0)))  # no number where it did not settle
        remember(memory, z, x, by, q, led, start, A)
        if any_less(sound, half):
            forget(memory, z, one - sound)
            # where what it should settle for is a number, it is the law that fails
            put(memory, z + wp.static(UNANSWERED), largest(row(memory, z + wp.static(UNANSWERED)), open_))
        write_matrix(memory, a + wp.static(SYSTEM), A)
        if wp.static(NODES):
            for i in range(6):
                own = part_of_response(r, i)
                for j in range(wp.static(m)):  # the last step taken
                    own = own + part_of_response(r, wp.static(PLACES[i][j])) * one_of(step, wp.static(j))
                put(memory, a + wp.static(MEMBER_MOMENT + i), own)
        u = Vec3(one_of(q, 0), one_of(q, 1), one_of(q, 2))
        e = zero3()
        if wp.static(SHEAR):
            e = Vec3(one_of(q, 3), one_of(q, 4), one_of(q, 5))
            put3(memory, a + wp.static(EXTENSION_AT), e)
        if wp.static(PULLS > 0):
            put_pulls(memory, z, a, u, e, 0)
        if wp.static(ALONG):
            moving = Response()
            put_slides(memory, z, a, u, e, moving, 0)
            for j in range(wp.static(m)):
                put(memory, a + wp.static(SLIDES_AT + j), part_of_response(moving, j))
        return Vec3(one_of(q, 0) + bad, one_of(q, 1) + bad, one_of(q, 2) + bad)

    @wp.func
    def rates(memory: memory_type, z: int, a: int, x: Real, b: State, u: Vec3, f: wp.ref[State]):
        """No angles, no torques."""

    @wp.func
    def length_rates(memory: memory_type, z: int, a: int, u: Vec3, f: wp.ref[State]):
        """(5l) What drives work on."""
        keep_lengths(memory, z, a, u, extension_at(memory, a), f, 0)

    @wp.func
    def driven_work(memory: memory_type, z: int, a: int, u: Vec3) -> Real:
        """Work per length of what drives members: it pulls, and gives way where they lengthen."""
        return -work_of_drives(memory, z, a, u, extension_at(memory, a))

    @wp.func
    def energy_rate(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3, u: Vec3) -> Real:
        """(14) Twice the energy per length, that of the members with it."""
        own = minus(M, row3(memory, a + wp.static(MEMBER_MOMENT)))
        pull = N
        if wp.static(SHEAR):
            pull = minus(N, row3(memory, a + wp.static(MEMBER_FORCE)))
        energy = free_energy(memory, z, a, x, b, own, pull, u)
        return energy + d(2.0) * energy_of_members(memory, z, a, u, extension_at(memory, a))

    @wp.func
    def put_own(memory: memory_type, z: int, a: int, b: State):
        """To the place: what the rod and its members carry together, and what the rod does itself."""
        M = row3(memory, a + wp.static(MOMENT_AT))
        put3(memory, a + wp.static(OWN_CURVATURE), row3(memory, a + wp.static(CURVATURE)))
        put3(memory, a + wp.static(TOTAL_MOMENT), M)
        put3(memory, a + wp.static(OWN_MOMENT), minus(M, row3(memory, a + wp.static(MEMBER_MOMENT))))
        put3(
            memory,
            a + wp.static(OWN_FORCE),
            minus(row3(memory, a + wp.static(FORCE_AT)), row3(memory, a + wp.static(MEMBER_FORCE))),
        )

    @wp.func
    def moved(memory: memory_type, a: int, g: int) -> Real:
        """How far a place at a fixed part of the stretch moves along the rod, for a direction."""
        x = row(memory, a + wp.static(X))
        return (
            row(memory, g + wp.static(GIVEN_START)) + x * row(memory, g + wp.static(GROWTH)) - row(memory, g + wp.static(SHIFT))
        )

    @wp.func
    def less_pulls(memory: memory_type, a: int, g: int, v: Column, dM: Vec3, dN: Vec3):
        """(17m) dM, dN less what drives change by themselves, for a direction."""
        M = Vec3(dM.x, dM.y, dM.z)
        N = Vec3(dN.x, dN.y, dN.z)
        count = int(wp.static(DRIVES))
        for k in range(count):
            change = -drive_variation(memory, a, g, v, k)
            at = a + wp.static(PULLS_AT) + k * wp.static(m)
            M = ahead3(M, change, row3(memory, at))
            if wp.static(SHEAR):
                N = ahead3(N, change, row3(memory, at + 3))
        return M, N

    @wp.func
    def less_slide(memory: memory_type, a: int, by: Real, dM: Vec3, dN: Vec3):
        """(17m) dM, dN less what changes as members move along with the rod."""
        M = ahead3(dM, -by, row3(memory, a + wp.static(SLIDES_AT)))
        if wp.static(SHEAR):
            return M, ahead3(dN, -by, row3(memory, a + wp.static(SLIDES_AT + 3)))
        return M, dN

    @wp.func
    def strain_variation(memory: memory_type, z: int, a: int, g: int, v: Column, dM_: Vec3, dN_: Vec3):
        """(17m) du and d(v - e3); dM_ and dN_ in the frame"""
        dM = dM_
        dN = dN_
        if wp.static(DRIVES_VARY or FRICTION):
            dM, dN = less_pulls(memory, a, g, v, dM, dN)
        if wp.static(ALONG):
            dM, dN = less_slide(memory, a, moved(memory, a, g), dM, dN)
        c, extension = free_variation(memory, z, a, g, v, dM, dN)
        right = Few()
        keep_one(right, 0, c.x)
        keep_one(right, 1, c.y)
        keep_one(right, 2, c.z)
        if wp.static(SHEAR):
            keep_one(right, 3, extension.x)
            keep_one(right, 4, extension.y)
            keep_one(right, 5, extension.z)
        q = solve(read_matrix(memory, a + wp.static(SYSTEM)), right)
        e = zero3()
        if wp.static(SHEAR):
            e = Vec3(one_of(q, 3), one_of(q, 4), one_of(q, 5))
        return Vec3(one_of(q, 0), one_of(q, 1), one_of(q, 2)), e

    @wp.func
    def give_way(memory: memory_type, a: int, own: Vec3):
        """(D5) du and d(v - e3) where the rod alone would be strained by so much more, carrying the same."""
        right = Few()
        keep_one(right, 0, own.x)
        keep_one(right, 1, own.y)
        keep_one(right, 2, own.z)
        q = solve(read_matrix(memory, a + wp.static(SYSTEM)), right)
        e = zero3()
        if wp.static(SHEAR):
            e = Vec3(one_of(q, 3), one_of(q, 4), one_of(q, 5))
        return Vec3(one_of(q, 0), one_of(q, 1), one_of(q, 2)), e

    @wp.func
    def rate_variations(memory: memory_type, z: int, a: int, g: int, v: Column, du: Vec3, f: wp.ref[Column]):
        """No angles, no torques."""

    @wp.func
    def length_variations(memory: memory_type, a: int, g: int, du: Vec3, de: Vec3, f: wp.ref[Column]):
        """(5l) for a column."""
        count = int(wp.static(LENGTHS))
        for k in range(count):
            at = a + wp.static(PULLS_AT) + k * wp.static(m)
            change = dot(row3(memory, at), du)
            if wp.static(SHEAR):
                change = change + dot(row3(memory, at + 3), de)
            if wp.static(ALONG):
                change = change + moved(memory, a, g) * row(memory, a + wp.static(SLIDES_AT + m) + k)
            keep_in(f, wp.static(LENGTHS_AT) + k, change)

    return SimpleNamespace(
        strain=strain,
        put_own=put_own,
        friction_rates=friction.rates,
        friction_variations=friction.variations,
        rates=rates,
        energy_rate=energy_rate,
        driven_work=driven_work,
        length_rates=length_rates,
        length_variations=length_variations,
        strain_variation=strain_variation,
        give_way=give_way,
        rate_variations=rate_variations,
    )
