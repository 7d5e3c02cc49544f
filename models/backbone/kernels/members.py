# mypy: ignore-errors
"""The strain law of a rod with members: strains from force and moment by Newton's method, (5m), and its variation, (17m).

``z`` is where the record of a stretch stands in memory, ``a`` where that of a place stands, ``x`` the arclength from the start of
the stretch. Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace
from typing import Any

import warp as wp

from multirod.models.backbone.kernels.friction import winding_types
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors

MOST_ITERATIONS = 20
MOST_WARM = 8  # after which Newton's method begins anew, where members carry nothing
HUGE = {wp.float64: 1e300, wp.float32: 1e37}
CLOSE = {wp.float64: 1e-11, wp.float32: 1e-5}  # the last step of Newton's method, over the length or, if larger, the strain
ROUNDED = {wp.float64: 1e-15, wp.float32: 1e-6}  # what rounding makes of strains where members carry nothing


def place_of(i: int, j: int, m: int) -> int:
    """Where the second derivative by strains i <= j of m stands in a response, after the first ones."""
    return m + i * m - i * (i - 1) // 2 + j - i


def make_response(W: int, d, m: int) -> SimpleNamespace:
    """What members answer to m strains, u or u and e = v - e3: first and second derivatives of their energy."""
    L, V = lanes(W, d), vectors(W, d)
    Real, Vec3 = L.Real, V.Vec3
    numbers = L.few(place_of(m - 1, m - 1, m) + 1)
    Response, part, keep = numbers.type, numbers.part, numbers.keep
    PLACES = tuple(tuple(place_of(min(i, j), max(i, j), m) for j in range(m)) for i in range(m))
    FORCES = m > 3

    @wp.func
    def add_moment(r: wp.ref[Response], a: Vec3):
        keep(r, 0, part(r, 0) + a.x)
        keep(r, 1, part(r, 1) + a.y)
        keep(r, 2, part(r, 2) + a.z)

    @wp.func
    def add_force(r: wp.ref[Response], a: Vec3):
        if wp.static(FORCES):
            keep(r, 3, part(r, 3) + a.x)
            keep(r, 4, part(r, 4) + a.y)
            keep(r, 5, part(r, 5) + a.z)

    @wp.func
    def add_stiffness(r: wp.ref[Response], i: int, j: int, a: Real):
        if j < wp.static(m):
            k = wp.static(m) + i * wp.static(m) - (i * (i - 1)) // 2 + j - i
            keep(r, k, part(r, k) + a)

    return SimpleNamespace(
        Response=Response,
        part=part,
        add_moment=add_moment,
        add_force=add_force,
        add_stiffness=add_stiffness,
        places=PLACES,
    )


def make_rod_with_members(layout: Layout, W: int, d, law: SimpleNamespace) -> SimpleNamespace:
    """(5m): the rod and its members share the strains, and carry force and moment together."""
    FORCES = layout.features.shear or layout.NODES  # whether it is asked what force members carry
    L, V, R = lanes(W, d), vectors(W, d), make_response(W, d, 6 if FORCES else 3)
    Real, row, put, fill, any_less = L.Real, L.row, L.put, L.fill, L.any_less
    absolute, largest, where_less = L.absolute, L.largest, L.where_less
    Vec3, row3, put3, zero3 = V.Vec3, V.row3, V.put3, V.zero3
    plus, minus, times, dot, ahead3 = V.plus, V.minus, V.times, V.dot, V.ahead3
    memory_type = wp.array(dtype=d)
    Response, part_of_response = R.Response, R.part
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    SHEAR, NODES, m = layout.features.shear, layout.NODES, layout.STRAINS
    s, p = layout.stretch, layout.place
    COMPLIANCE, SHEAR_AT, UNIT_LENGTH = s["compliance"], s["shear"], s["unit_length"]
    X, EXTENSION_AT, SYSTEM, OWN_TWIST, CURVATURE = p["x"], p["extension"], p["system"], p["own_twist"], p["curvature"]
    MEMBER_MOMENT, MEMBER_FORCE, UNANSWERED = p["member_moment"], p["member_force"], s["unanswered"]
    KNOWN, KNOWN_AT, STRAINS_AT = s["known"], s["place"], s["strains"]
    BEFORE_AT, STRAINS_BEFORE = s["place_before"], s["strains_before"]
    system, matrix, vector = L.system(m), L.few(m * m), L.few(m)
    Matrix, factor, solve = system.type, system.factor, system.solve
    keep_entry, entry, write_matrix, read_matrix = matrix.keep, matrix.part, matrix.write, matrix.read
    Few, keep_one, one_of = vector.type, vector.keep, vector.part
    choose, read_vector, write_vector = vector.where_less, vector.read, vector.write
    VARIED = layout.VARIED and layout.DIRECTIONS
    PLACES = R.places
    precurvature, precurvature_variation = law.precurvature, law.precurvature_variation

    # functions of members: those that are constant by section stand on the stretch, the others at the place
    FUNCTIONS_AT, ROWS_AT, FUNCTIONS, TERMS = p["functions"], s["functions"], layout.FUNCTIONS, layout.FUNCTION_TERMS
    ROUTED, CENTRE, SLOPE = layout.ROUTED, s["centre"], s["slope"]
    ALONG = layout.ROUTED and layout.DIRECTIONS
    DRIVES, LENGTHS, LENGTHS_AT, PULLS_AT, SLIDES_AT = (
        layout.DRIVES,
        layout.LENGTHS,
        layout.state["lengths"],
        p["pulls"],
        p["slides"],
    )
    PULLS, DRIVES_VARY, FRICTION = DRIVES * layout.PULLED, layout.DRIVES_VARY, layout.FRICTION
    GRIPS_AT, DRIVES_AT, HELD_AT = layout.state["grips"], p["drives"], p["grips"]
    STRAIN_RATES, RATE_SYSTEM, PULL_RATES = p["strain_rates"], p["rate_system"], p["pull_rates"]
    CURVED, precurvature_slope = layout.VARIED, law.precurvature_slope
    keep, keep_in, part, part_of = state.keep, column.keep, state.part, column.part
    given = layout.given
    DRIVES_GIVEN, GIVEN_START, GROWTH, SHIFT = given["drives"], given["start"], given["growth"], given["shift"]

    @wp.func
    def value(memory: memory_type, on: int) -> Real:
        return row(memory, on)

    @wp.func
    def slope(memory: memory_type, on: int) -> Real:
        return row(memory, on + wp.static(FUNCTIONS))

    @wp.func
    def bend(memory: memory_type, on: int) -> Real:
        return row(memory, on + wp.static(2 * FUNCTIONS))

    flags = {"FORCES": FORCES, "VARIED": ROUTED, "DISCS": layout.features.discs, "FRICTION": layout.FRICTION}
    own = {"memory_type": memory_type, "value": value, "slope": slope, "bend": bend, **flags}
    windings = winding_types(W, d)
    numbers = SimpleNamespace(**(vars(L) | vars(V) | vars(R) | vars(windings) | own))
    laws = {kind: kind.law(numbers) for kind in layout.features.members}

    @wp.func
    def at_place(memory: memory_type, z: int, a: int, x: Real):
        """The functions of members, and their derivatives by arclength."""
        by_length = row(memory, z + wp.static(SLOPE))
        t = (x - row(memory, z + wp.static(CENTRE))) * by_length
        count = int(wp.static(FUNCTIONS))
        for j in range(count):
            first = z + wp.static(ROWS_AT) + j
            y = row(memory, first + wp.static((TERMS - 1) * FUNCTIONS))
            y_t = fill(d(0.0))
            y_tt = fill(d(0.0))
            for k in range(wp.static(TERMS - 1)):
                y_tt = y_t + t * y_tt
                y_t = y + t * y_t
                y = row(memory, first + wp.static(FUNCTIONS) * (wp.static(TERMS - 2) - k)) + t * y
            put(memory, a + wp.static(FUNCTIONS_AT) + j, y)
            put(memory, a + wp.static(FUNCTIONS_AT + FUNCTIONS) + j, by_length * y_t)
            if wp.static(ALONG or FRICTION):
                put(memory, a + wp.static(FUNCTIONS_AT + 2 * FUNCTIONS) + j, d(2.0) * by_length * by_length * y_tt)

    def runs() -> list[tuple[Any, int, int, int, int, int]]:
        """Members of one law that follow each other: the law, how many, where the first stands, how far the next is from it."""
        found: list[list[Any]] = []
        for k, kind in enumerate(layout.features.members):
            if found and found[-1][0] is kind:
                found[-1][1] += 1
            else:
                at, function = layout.of_member(k)
                found.append([kind, 1, at, function, len(kind.parameters) + (kind.drive is not None), len(kind.functions)])
        return [tuple(run) for run in found]

    def chain(make, nothing, name: str = "respond", *, whole: bool = False):
        """One function that calls those of all members, one after another; those of one law in a loop, to be compiled once.

        ``make(function, count, numbers_of, functions_of, rest)`` is the loop; the drives of its members, if they have any, are
        numbered from ``drive`` on. Where ``whole``, it takes the law in place of one function.
        """
        found = nothing
        for kind, count, at, on, step, functions in reversed(runs()):
            if hasattr(laws[kind], name):
                function = laws[kind] if whole else getattr(laws[kind], name)
                found = make(function, count, *addresses(at, on, step, functions), found)
        return found

    def addresses(at: int, on: int, step: int, functions: int):
        """Where the numbers of member k of a run stand, and its functions."""
        first = on + (FUNCTIONS_AT if ROUTED else ROWS_AT)

        @wp.func
        def numbers_of(z: int, k: int) -> int:
            return z + wp.static(at) + k * wp.static(step)

        @wp.func
        def functions_of(z: int, a: int, k: int) -> int:
            if wp.static(ROUTED):
                return a + wp.static(first) + k * wp.static(functions)
            return z + wp.static(first) + k * wp.static(functions)

        return step, numbers_of, functions_of

    def responses(function, count: int, step: int, numbers_of, functions_of, rest):
        @wp.func
        def respond(memory: memory_type, z: int, a: int, u: Vec3, e: Vec3, r: wp.ref[Response]):
            last = int(wp.static(count))
            for k in range(last):
                function(memory, numbers_of(z, k), functions_of(z, a, k), u, e, r)
            rest(memory, z, a, u, e, r)

        return respond

    def energies(function, count: int, step: int, numbers_of, functions_of, rest):
        @wp.func
        def energy(memory: memory_type, z: int, a: int, u: Vec3, e: Vec3) -> Real:
            total = rest(memory, z, a, u, e)
            last = int(wp.static(count))
            for k in range(last):
                total = total + function(memory, numbers_of(z, k), functions_of(z, a, k), u, e)
            return total

        return energy

    def works(function, count: int, step: int, numbers_of, functions_of, rest):
        @wp.func
        def work(memory: memory_type, z: int, a: int, u: Vec3, e: Vec3) -> Real:
            total = rest(memory, z, a, u, e)
            last = int(wp.static(count))
            for k in range(last):
                r = Response()
                w = function(memory, numbers_of(z, k), functions_of(z, a, k), u, e, r)
                total = total + row(memory, numbers_of(z, k) + wp.static(step - 1)) * w
            return total

        return work

    def pulls(function, count: int, step: int, numbers_of, functions_of, rest):
        @wp.func
        def pull(memory: memory_type, z: int, a: int, u: Vec3, e: Vec3, drive: int):
            last = int(wp.static(count))
            for k in range(last):
                r = Response()
                function(memory, numbers_of(z, k), functions_of(z, a, k), u, e, r)
                for j in range(wp.static(m)):
                    put(memory, a + wp.static(PULLS_AT) + (drive + k) * wp.static(m) + j, part_of_response(r, j))
            rest(memory, z, a, u, e, drive + wp.static(count))

        return pull

    def slides(function, count: int, step: int, numbers_of, functions_of, rest):
        @wp.func
        def slide(memory: memory_type, z: int, a: int, u: Vec3, e: Vec3, r: wp.ref[Response], drive: int):
            last = int(wp.static(count))
            for k in range(last):
                w = function(memory, numbers_of(z, k), functions_of(z, a, k), u, e, r)
                if wp.static(LENGTHS > 0):
                    put(memory, a + wp.static(SLIDES_AT + m) + drive + k, w)
            rest(memory, z, a, u, e, r, drive + wp.static(count))

        return slide

    def lengths(function, count: int, step: int, numbers_of, functions_of, rest):
        @wp.func
        def length(memory: memory_type, z: int, a: int, u: Vec3, e: Vec3, f: wp.ref[State], drive: int):
            last = int(wp.static(count))
            for k in range(last):
                r = Response()
                w = function(memory, numbers_of(z, k), functions_of(z, a, k), u, e, r)
                keep(f, wp.static(LENGTHS_AT) + drive + k, w)
            rest(memory, z, a, u, e, f, drive + wp.static(count))

        return length

    @wp.func
    def no_response(memory: memory_type, z: int, a: int, u: Vec3, e: Vec3, r: wp.ref[Response]):
        """After the last member."""

    @wp.func
    def no_energy(memory: memory_type, z: int, a: int, u: Vec3, e: Vec3) -> Real:
        return fill(d(0.0))

    @wp.func
    def no_pull(memory: memory_type, z: int, a: int, u: Vec3, e: Vec3, drive: int):
        """After the last member."""

    @wp.func
    def no_slide(memory: memory_type, z: int, a: int, u: Vec3, e: Vec3, r: wp.ref[Response], drive: int):
        """After the last member."""

    @wp.func
    def no_length(memory: memory_type, z: int, a: int, u: Vec3, e: Vec3, f: wp.ref[State], drive: int):
        """After the last member."""

    def grips(law, count: int, step: int, numbers_of, functions_of, rest):
        rubs = law.friction_at > 0

        @wp.func
        def grip(memory: memory_type, z: int, a: int, b: State, drive: int):
            last = int(wp.static(count))
            for k in range(last):
                left = part(b, wp.static(GRIPS_AT) + drive + k)
                put(memory, a + wp.static(HELD_AT) + drive + k, left)
                put(memory, a + wp.static(DRIVES_AT) + drive + k, row(memory, numbers_of(z, k) + wp.static(step - 1)))
                if wp.static(rubs):
                    put(memory, functions_of(z, a, k) + 2, left)
            rest(memory, z, a, b, drive + wp.static(count))

        return grip

    def winds(law, count: int, step: int, numbers_of, functions_of, rest):
        function, rubs = law.wind, law.friction_at > 0

        @wp.func
        def wind(
            memory: memory_type,
            z: int,
            a: int,
            u: Vec3,
            e: Vec3,
            u_s: Vec3,
            e_s: Vec3,
            c: Few,
            gap: wp.ref[Few],
            A: wp.ref[Matrix],
            f: wp.ref[State],
            drive: int,
        ):
            last = int(wp.static(count))
            for k in range(last):
                own = function(memory, numbers_of(z, k), functions_of(z, a, k), u, e, u_s, e_s)
                answers = stacked(own.moment, own.force)
                pull = stacked(own.pull_moment, own.pull_force)
                by = stacked(own.by_u, own.by_e)
                slip = -own.slip * own.T
                for i in range(wp.static(m)):
                    keep_one(gap, i, one_of(gap, i) + one_of(c, i) * one_of(answers, i))
                    if wp.static(rubs):
                        for j in range(wp.static(m)):
                            more = slip * one_of(c, i) * one_of(pull, i) * one_of(by, j)
                            keep_entry(A, wp.static(i * m + j), entry(A, wp.static(i * m + j)) + more)
                rate = fill(d(0.0))
                if wp.static(rubs):
                    rate = -own.slip * own.turn * row(memory, a + wp.static(HELD_AT) + drive + k)
                keep(f, wp.static(GRIPS_AT) + drive + k, rate)
            rest(memory, z, a, u, e, u_s, e_s, c, gap, A, f, drive + wp.static(count))

        return wind

    def variations(law, count: int, step: int, numbers_of, functions_of, rest):
        function = law.vary_winding

        @wp.func
        def vary(
            memory: memory_type,
            z: int,
            a: int,
            g: int,
            v: Column,
            u: Vec3,
            e: Vec3,
            u_s: Vec3,
            e_s: Vec3,
            du: Vec3,
            de: Vec3,
            total: wp.ref[Few],
            drive: int,
        ):
            last = int(wp.static(count))
            for k in range(last):
                at = numbers_of(z, k)
                dT = row(memory, at) * drive_variation(memory, a, g, v, drive + k)
                own = function(memory, at, functions_of(z, a, k), u, e, u_s, e_s, du, de, dT)
                change = stacked(own.moment, own.force)
                for i in range(wp.static(m)):
                    keep_one(total, i, one_of(total, i) + one_of(change, i))
            rest(memory, z, a, g, v, u, e, u_s, e_s, du, de, total, drive + wp.static(count))

        return vary

    def turns(law, count: int, step: int, numbers_of, functions_of, rest):
        wind, vary_winding, rubs = law.wind, law.vary_winding, law.friction_at > 0

        @wp.func
        def turn(
            memory: memory_type,
            z: int,
            a: int,
            g: int,
            v: Column,
            u: Vec3,
            e: Vec3,
            u_s: Vec3,
            e_s: Vec3,
            du: Vec3,
            de: Vec3,
            du_s: Vec3,
            de_s: Vec3,
            f: wp.ref[Column],
            drive: int,
        ):
            last = int(wp.static(count))
            for k in range(last):
                rate = fill(d(0.0))
                if wp.static(rubs):
                    at = numbers_of(z, k)
                    on = functions_of(z, a, k)
                    own = wind(memory, at, on, u, e, u_s, e_s)
                    change = vary_winding(memory, at, on, u, e, u_s, e_s, du, de, fill(d(0.0)))
                    turned = change.turn + dot(own.by_u, du_s) + dot(own.by_e, de_s)
                    left = row(memory, a + wp.static(HELD_AT) + drive + k)
                    rate = -own.slip * (turned * left + own.turn * part_of(v, wp.static(GRIPS_AT) + drive + k))
                keep_in(f, wp.static(GRIPS_AT) + drive + k, rate)
            rest(memory, z, a, g, v, u, e, u_s, e_s, du, de, du_s, de_s, f, drive + wp.static(count))

        return turn

    @wp.func
    def stacked(u: Vec3, e: Vec3) -> Few:
        q = Few()
        keep_one(q, 0, u.x)
        keep_one(q, 1, u.y)
        keep_one(q, 2, u.z)
        if wp.static(SHEAR):
            keep_one(q, 3, e.x)
            keep_one(q, 4, e.y)
            keep_one(q, 5, e.z)
        return q

    @wp.func
    def drive_variation(memory: memory_type, a: int, g: int, v: Column, k: int) -> Real:
        """What a column varies of what is left of drive k."""
        change = fill(d(0.0))
        if wp.static(DRIVES_VARY):
            change = row(memory, g + wp.static(DRIVES_GIVEN) + k)
        if wp.static(FRICTION):
            left = row(memory, a + wp.static(HELD_AT) + k)
            change = left * change + row(memory, a + wp.static(DRIVES_AT) + k) * part_of(v, wp.static(GRIPS_AT) + k)
        return change

    @wp.func
    def no_grip(memory: memory_type, z: int, a: int, b: State, drive: int):
        """After the last member."""

    @wp.func
    def no_wind(
        memory: memory_type,
        z: int,
        a: int,
        u: Vec3,
        e: Vec3,
        u_s: Vec3,
        e_s: Vec3,
        c: Few,
        gap: wp.ref[Few],
        A: wp.ref[Matrix],
        f: wp.ref[State],
        drive: int,
    ):
        """After the last member."""

    @wp.func
    def no_variation(
        memory: memory_type,
        z: int,
        a: int,
        g: int,
        v: Column,
        u: Vec3,
        e: Vec3,
        u_s: Vec3,
        e_s: Vec3,
        du: Vec3,
        de: Vec3,
        total: wp.ref[Few],
        drive: int,
    ):
        """After the last member."""

    @wp.func
    def no_turn(
        memory: memory_type,
        z: int,
        a: int,
        g: int,
        v: Column,
        u: Vec3,
        e: Vec3,
        u_s: Vec3,
        e_s: Vec3,
        du: Vec3,
        de: Vec3,
        du_s: Vec3,
        de_s: Vec3,
        f: wp.ref[Column],
        drive: int,
    ):
        """After the last member."""

    put_grips, wind_all, vary_all, turn_all = no_grip, no_wind, no_variation, no_turn
    if FRICTION:
        put_grips = chain(grips, no_grip, "pull", whole=True)
        wind_all = chain(winds, no_wind, "wind", whole=True)
        vary_all = chain(variations, no_variation, "wind", whole=True)
        turn_all = chain(turns, no_turn, "wind", whole=True)

    respond = chain(responses, no_response)
    energy_of_members = chain(energies, no_energy, "energy")
    work_of_drives = chain(works, no_energy, "pull")
    put_pulls = chain(pulls, no_pull, "pull")
    put_slides = chain(slides, no_slide, "slide")
    keep_lengths = chain(lengths, no_length, "pull")

    @wp.func
    def extension_at(memory: memory_type, a: int) -> Vec3:
        """v - e3 at a place."""
        if wp.static(SHEAR):
            return row3(memory, a + wp.static(EXTENSION_AT))
        return zero3()

    @wp.func
    def compliances(memory: memory_type, z: int) -> Few:
        """Diagonal of C."""
        c = Few()
        K = row3(memory, z + wp.static(COMPLIANCE))
        keep_one(c, 0, K.x)
        keep_one(c, 1, K.y)
        keep_one(c, 2, K.z)
        if wp.static(SHEAR):
            S = row3(memory, z + wp.static(SHEAR_AT))
            keep_one(c, 3, S.x)
            keep_one(c, 4, S.y)
            keep_one(c, 5, S.z)
        return c

    @wp.func
    def answer(memory: memory_type, z: int, a: int, q: Few) -> Response:
        """What all members answer to strains."""
        r = Response()
        u = Vec3(one_of(q, 0), one_of(q, 1), one_of(q, 2))
        e = zero3()
        if wp.static(SHEAR):
            e = Vec3(one_of(q, 3), one_of(q, 4), one_of(q, 5))
        respond(memory, z, a, u, e, r)
        return r

    @wp.func
    def tangent_system(c: Few, r: Response) -> Matrix:
        """I + C D, factored."""
        A = Matrix()
        for i in range(wp.static(m)):
            for j in range(wp.static(m)):
                value = one_of(c, i) * part_of_response(r, wp.static(PLACES[i][j]))
                if wp.static(i == j):
                    value = value + d(1.0)
                keep_entry(A, wp.static(i * m + j), value)
        factor(A)
        return A

    @wp.func
    def led_to(memory: memory_type, z: int, x: Real) -> Few:
        """Where the strains that are known on this stretch lead at x."""
        at = row(memory, z + wp.static(KNOWN_AT))
        back = at - row(memory, z + wp.static(BEFORE_AT))
        zero = fill(d(0.0))
        one = fill(d(1.0))
        two = where_less(fill(d(1.5)), row(memory, z + wp.static(KNOWN)), one, zero)
        # a step that was too long ends further back than it began
        far = where_less(d(2.0) * absolute(back), absolute(x - at), zero, two)
        t = far * (x - at) / (back + one - two)
        q = Few()
        for i in range(wp.static(m)):
            last = row(memory, z + wp.static(STRAINS_AT) + i)
            keep_one(q, i, last + t * (last - row(memory, z + wp.static(STRAINS_BEFORE) + i)))
        return q

    @wp.func
    def remember(memory: memory_type, z: int, x: Real, q: Few, sound: Real):
        """Strains at x, in the place of the last where those are there too, of a lane that is ``sound``; else none are known."""
        zero = fill(d(0.0))
        one = fill(d(1.0))
        known = row(memory, z + wp.static(KNOWN))
        at = row(memory, z + wp.static(KNOWN_AT))
        elsewhere = where_less(zero, absolute(x - at), where_less(fill(d(0.5)), known, one, zero), zero)
        half = fill(d(0.5))
        before = row(memory, z + wp.static(BEFORE_AT))
        put(memory, z + wp.static(BEFORE_AT), where_less(half, elsewhere, at, before))
        last = read_vector(memory, z + wp.static(STRAINS_AT))
        write_vector(
            memory,
            z + wp.static(STRAINS_BEFORE),
            choose(half, elsewhere, last, read_vector(memory, z + wp.static(STRAINS_BEFORE))),
        )
        put(memory, z + wp.static(KNOWN_AT), x)
        write_vector(memory, z + wp.static(STRAINS_AT), q)
        most = where_less(half, elsewhere, fill(d(2.0)), where_less(half, known, known, one))
        put(memory, z + wp.static(KNOWN), sound * most)

    @wp.func
    def unsettled(step: Few, q: Few, start: Few, of_u: Real, of_e: Real) -> Real:
        """0 where a step of Newton's method from q is the last one, else 1, also where it is no number; the factors make numbers
        of curvatures and of what else there is."""
        size = fill(d(0.0))
        total = fill(d(0.0))
        enough = fill(d(wp.static(CLOSE[d])))
        for i in range(wp.static(m)):
            scale = of_e
            if wp.static(i < 3):
                scale = of_u
            size = largest(size, scale * absolute(one_of(step, i)))
            noise = d(wp.static(ROUNDED[d])) * absolute(one_of(start, i)) + d(wp.static(CLOSE[d])) * absolute(one_of(q, i))
            enough = enough + scale * noise
            total = total + one_of(step, i)
        return where_less(size + d(0.0) * total, enough, fill(d(0.0)), fill(d(1.0)))

    @wp.func
    def strain(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3) -> Vec3:
        """(5m) u, and v - e3 to the place: the zero of ``u* + K^-1 (M - dW/du) - u`` and its like.

        The search for it begins where the last two on this stretch lead, or where members carry nothing.
        """
        u_star = precurvature(memory, z, 0, x)
        if wp.static(NODES):
            put(memory, a + wp.static(OWN_TWIST), u_star.z)
        if wp.static(ROUTED):
            at_place(memory, z, a, x)
        if wp.static(FRICTION):
            put_grips(memory, z, a, b, 0)
        c = compliances(memory, z)
        free = plus(u_star, times(row3(memory, z + wp.static(COMPLIANCE)), M))
        start = Few()
        keep_one(start, 0, free.x)
        keep_one(start, 1, free.y)
        keep_one(start, 2, free.z)
        if wp.static(SHEAR):
            slid = times(row3(memory, z + wp.static(SHEAR_AT)), N)
            keep_one(start, 3, slid.x)
            keep_one(start, 4, slid.y)
            keep_one(start, 5, slid.z)
        length = row(memory, z + wp.static(UNIT_LENGTH))
        one = fill(d(1.0))
        zero = fill(d(0.0))
        half = fill(d(0.5))
        known = row(memory, z + wp.static(KNOWN))
        q = choose(half, known, led_to(memory, z, x), start)
        r = Response()
        A = Matrix()
        step = Few()
        open_ = one
        count = int(0)
        while any_less(zero, open_) and count < wp.static(MOST_WARM + MOST_ITERATIONS):
            for i in range(wp.static(m)):
                # a lane that is done stays where it is, whatever the others do: its last step is taken below
                keep_one(q, i, one_of(q, i) + open_ * one_of(step, i))
            if count == wp.static(MOST_WARM):
                q = choose(half, known * open_, start, q)
            r = answer(memory, z, a, q)
            A = tangent_system(c, r)
            rest = Few()
            for i in range(wp.static(m)):
                keep_one(rest, i, one_of(start, i) - one_of(c, i) * part_of_response(r, i) - one_of(q, i))
            step = solve(A, rest)
            open_ = unsettled(step, q, start, length, one)
            count += int(1)
        for i in range(wp.static(m)):
            keep_one(q, i, one_of(q, i) + one_of(step, i))
        bad = d(0.0) / (one - open_)  # no number where it did not settle
        remember(memory, z, x, q, one - open_)
        if any_less(zero, open_):
            # where what it should settle for is a number, it is the law that fails
            asked = zero
            for i in range(wp.static(m)):
                asked = asked + absolute(one_of(start, i))
            known = where_less(asked, fill(d(wp.static(HUGE[d]))), one, zero)
            put(memory, z + wp.static(UNANSWERED), largest(row(memory, z + wp.static(UNANSWERED)), open_ * known))
        write_matrix(memory, a + wp.static(SYSTEM), A)
        if wp.static(NODES):
            put3(
                memory,
                a + wp.static(MEMBER_MOMENT),
                Vec3(part_of_response(r, 0), part_of_response(r, 1), part_of_response(r, 2)),
            )
            put3(
                memory,
                a + wp.static(MEMBER_FORCE),
                Vec3(part_of_response(r, 3), part_of_response(r, 4), part_of_response(r, 5)),
            )
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
                put(memory, a + wp.static(SLIDES_AT) + j, part_of_response(moving, j))
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
        energy = dot(own, times(row3(memory, z + wp.static(COMPLIANCE)), own))
        if wp.static(SHEAR):
            pull = minus(N, row3(memory, a + wp.static(MEMBER_FORCE)))
            energy = energy + dot(pull, times(row3(memory, z + wp.static(SHEAR_AT)), pull))
        return energy + d(2.0) * energy_of_members(memory, z, a, u, extension_at(memory, a))

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
        c = times(row3(memory, z + wp.static(COMPLIANCE)), dM)
        if wp.static(VARIED):
            c = plus(c, precurvature_variation(memory, z, 0, row(memory, a + wp.static(X)), g))
        right = Few()
        keep_one(right, 0, c.x)
        keep_one(right, 1, c.y)
        keep_one(right, 2, c.z)
        if wp.static(SHEAR):
            slid = times(row3(memory, z + wp.static(SHEAR_AT)), dN)
            keep_one(right, 3, slid.x)
            keep_one(right, 4, slid.y)
            keep_one(right, 5, slid.z)
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

    @wp.func
    def friction_rates(memory: memory_type, z: int, a: int, x: Real, u: Vec3, M_s: Vec3, N_s: Vec3, b: State, f: wp.ref[State]):
        """(L12), (L13): how the strains change along the rod, by Newton's method, and with them what is left of tensions."""
        e = extension_at(memory, a)
        c = compliances(memory, z)
        D = answer(memory, z, a, stacked(u, e))
        carried = stacked(M_s, N_s)
        start = Few()
        if wp.static(CURVED):
            start = stacked(precurvature_slope(memory, z, 0, x), zero3())
        for i in range(wp.static(m)):
            put(memory, a + wp.static(PULL_RATES) + i, one_of(carried, i))
            keep_one(start, i, one_of(start, i) + one_of(c, i) * one_of(carried, i))
        q = Few()
        length = row(memory, z + wp.static(UNIT_LENGTH))
        one = fill(d(1.0))
        zero = fill(d(0.0))
        open_ = one
        A = Matrix()
        step = Few()
        count = int(0)
        while any_less(zero, open_) and count < wp.static(MOST_ITERATIONS):
            for i in range(wp.static(m)):
                keep_one(q, i, one_of(q, i) - open_ * one_of(step, i))
            u_s = Vec3(one_of(q, 0), one_of(q, 1), one_of(q, 2))
            e_s = zero3()
            if wp.static(SHEAR):
                e_s = Vec3(one_of(q, 3), one_of(q, 4), one_of(q, 5))
            gap = Few()
            for i in range(wp.static(m)):
                keep_one(gap, i, one_of(q, i) - one_of(start, i))
                for j in range(wp.static(m)):
                    value = one_of(c, i) * part_of_response(D, wp.static(PLACES[i][j]))
                    if wp.static(i == j):
                        value = value + d(1.0)
                    keep_entry(A, wp.static(i * m + j), value)
            wind_all(memory, z, a, u, e, u_s, e_s, c, gap, A, f, 0)
            factor(A)
            step = solve(A, gap)
            open_ = unsettled(step, q, start, length * length, length)
            count += int(1)
        bad = d(0.0) / (one - open_)
        for i in range(wp.static(m)):
            put(memory, a + wp.static(STRAIN_RATES) + i, one_of(q, i) - one_of(step, i) + bad)
        write_matrix(memory, a + wp.static(RATE_SYSTEM), A)
        grips_count = int(wp.static(DRIVES))
        for k in range(grips_count):
            keep(f, wp.static(GRIPS_AT) + k, part(f, wp.static(GRIPS_AT) + k) + bad)

    @wp.func
    def friction_variations(
        memory: memory_type,
        z: int,
        a: int,
        g: int,
        v: Column,
        du: Vec3,
        de: Vec3,
        dM_s: Vec3,
        dN_s: Vec3,
        f: wp.ref[Column],
    ):
        """(L14)"""
        u = row3(memory, a + wp.static(CURVATURE))
        e = extension_at(memory, a)
        c = compliances(memory, z)
        u_s = row3(memory, a + wp.static(STRAIN_RATES))
        e_s = zero3()
        if wp.static(SHEAR):
            e_s = row3(memory, a + wp.static(STRAIN_RATES + 3))
        total = Few()
        vary_all(memory, z, a, g, v, u, e, u_s, e_s, du, de, total, 0)
        carried = stacked(dM_s, dN_s)
        right = Few()
        for i in range(wp.static(m)):
            keep_one(right, i, one_of(c, i) * (one_of(carried, i) - one_of(total, i)))
        q = solve(read_matrix(memory, a + wp.static(RATE_SYSTEM)), right)
        du_s = Vec3(one_of(q, 0), one_of(q, 1), one_of(q, 2))
        de_s = zero3()
        if wp.static(SHEAR):
            de_s = Vec3(one_of(q, 3), one_of(q, 4), one_of(q, 5))
        turn_all(memory, z, a, g, v, u, e, u_s, e_s, du, de, du_s, de_s, f, 0)

    return SimpleNamespace(
        strain=strain,
        friction_rates=friction_rates,
        friction_variations=friction_variations,
        rates=rates,
        energy_rate=energy_rate,
        driven_work=driven_work,
        length_rates=length_rates,
        length_variations=length_variations,
        strain_variation=strain_variation,
        rate_variations=rate_variations,
    )
