# mypy: ignore-errors
"""The strain law of a rod with members: strains from force and moment by Newton's method, (5m), and its variation, (17m).

``z`` is where the record of a stretch stands in memory, ``a`` where that of a place stands, ``x`` the arclength from the start of
the stretch. Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors

MOST_ITERATIONS = 20
CLOSE = {wp.float64: 1e-8, wp.float32: 1e-4}  # a step of Newton's method after which the next would be lost in rounding
SIZE = 6  # strains: u, then e = v - e3


def place_of(i: int, j: int) -> int:
    """Where the second derivative by strains i <= j stands in a response, after the six first ones."""
    return SIZE + i * SIZE - i * (i - 1) // 2 + j - i


def make_response(W: int, d) -> SimpleNamespace:
    """What members answer to strains: first and second derivatives of their energy."""
    L, V = lanes(W, d), vectors(W, d)
    Real, Vec3 = L.Real, V.Vec3
    numbers = L.few(place_of(SIZE - 1, SIZE - 1) + 1)
    Response, part, keep = numbers.type, numbers.part, numbers.keep
    PLACES = tuple(tuple(place_of(min(i, j), max(i, j)) for j in range(SIZE)) for i in range(SIZE))

    @wp.func
    def add_moment(r: wp.ref[Response], a: Vec3):
        keep(r, 0, part(r, 0) + a.x)
        keep(r, 1, part(r, 1) + a.y)
        keep(r, 2, part(r, 2) + a.z)

    @wp.func
    def add_force(r: wp.ref[Response], a: Vec3):
        keep(r, 3, part(r, 3) + a.x)
        keep(r, 4, part(r, 4) + a.y)
        keep(r, 5, part(r, 5) + a.z)

    @wp.func
    def add_stiffness(r: wp.ref[Response], i: int, j: int, a: Real):
        k = 6 + i * 6 - (i * (i - 1)) // 2 + j - i
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
    L, V, R = lanes(W, d), vectors(W, d), make_response(W, d)
    Real, row, put, fill, any_less = L.Real, L.row, L.put, L.fill, L.any_less
    absolute, largest, where_less = L.absolute, L.largest, L.where_less
    Vec3, row3, put3, zero3 = V.Vec3, V.row3, V.put3, V.zero3
    plus, minus, times, dot = V.plus, V.minus, V.times, V.dot
    memory_type = wp.array(dtype=d)
    Response, part_of_response = R.Response, R.part
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    SHEAR, NODES, m = layout.features.shear, layout.NODES, layout.STRAINS
    s, p = layout.stretch, layout.place
    COMPLIANCE, SHEAR_AT, UNIT_LENGTH = s["compliance"], s["shear"], s["unit_length"]
    X, EXTENSION_AT, SYSTEM, OWN_TWIST = p["x"], p["extension"], p["system"], p["own_twist"]
    MEMBER_MOMENT, MEMBER_FORCE = p["member_moment"], p["member_force"]
    system, matrix, vector = L.system(m), L.few(m * m), L.few(m)
    Matrix, factor, solve = system.type, system.factor, system.solve
    keep_entry, write_matrix, read_matrix = matrix.keep, matrix.write, matrix.read
    Few, keep_one, one_of = vector.type, vector.keep, vector.part
    VARIED = layout.VARIED and layout.DIRECTIONS
    PLACES = R.places
    precurvature, precurvature_variation = law.precurvature, law.precurvature_variation

    numbers = SimpleNamespace(**(vars(L) | vars(V) | vars(R) | {"memory_type": memory_type}))

    def chain(name: str, kinds: list, nothing):
        """One function that calls those of all members, one after another."""
        found = nothing
        for k, kind in reversed(list(enumerate(kinds))):
            at = s[f"{k} {next(iter(kind.parameters))}"]
            found = link(name, getattr(kind.law(numbers), name), at, found)
        return found

    def link(name: str, function, at: int, rest):
        if name == "respond":

            @wp.func
            def respond(memory: memory_type, z: int, x: Real, u: Vec3, e: Vec3, r: wp.ref[Response]):
                function(memory, z + wp.static(at), x, u, e, r)
                rest(memory, z, x, u, e, r)

            return respond

        @wp.func
        def energy(memory: memory_type, z: int, x: Real, u: Vec3, e: Vec3) -> Real:
            return function(memory, z + wp.static(at), x, u, e) + rest(memory, z, x, u, e)

        return energy

    @wp.func
    def no_response(memory: memory_type, z: int, x: Real, u: Vec3, e: Vec3, r: wp.ref[Response]):
        """After the last member."""

    @wp.func
    def no_energy(memory: memory_type, z: int, x: Real, u: Vec3, e: Vec3) -> Real:
        return fill(d(0.0))

    respond = chain("respond", layout.features.members, no_response)
    energy_of_members = chain("energy", layout.features.members, no_energy)

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
    def answer(memory: memory_type, z: int, x: Real, q: Few) -> Response:
        """What all members answer to strains."""
        r = Response()
        u = Vec3(one_of(q, 0), one_of(q, 1), one_of(q, 2))
        e = zero3()
        if wp.static(SHEAR):
            e = Vec3(one_of(q, 3), one_of(q, 4), one_of(q, 5))
        respond(memory, z, x, u, e, r)
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
    def strain(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3) -> Vec3:
        """(5m) u, and v - e3 to the place: the zero of ``u* + K^-1 (M - dW/du) - u`` and its like.

        The search for it begins from where members carry nothing.
        """
        u_star = precurvature(memory, z, 0, x)
        if wp.static(NODES):
            put(memory, a + wp.static(OWN_TWIST), u_star.z)
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
        q = start
        length = row(memory, z + wp.static(UNIT_LENGTH))
        close = fill(d(wp.static(CLOSE[d])))
        one = fill(d(1.0))
        zero = fill(d(0.0))
        open_ = one
        count = int(0)
        while any_less(zero, open_) and count < wp.static(MOST_ITERATIONS):
            r = answer(memory, z, x, q)
            A = tangent_system(c, r)
            rest = Few()
            for i in range(wp.static(m)):
                keep_one(rest, i, one_of(start, i) - one_of(c, i) * part_of_response(r, i) - one_of(q, i))
            step = solve(A, rest)
            size = zero
            total = zero
            for i in range(wp.static(m)):
                # a lane that is done stays as it is, whatever the others do
                keep_one(q, i, one_of(q, i) + open_ * one_of(step, i))
                scale = one
                if wp.static(i < 3):
                    scale = length
                size = largest(size, scale * absolute(one_of(step, i)))
                total = total + one_of(step, i)
            # also what is no number goes on, and is refused below
            open_ = open_ * where_less(size + d(0.0) * total, close, zero, one)
            count += int(1)
        bad = d(0.0) / (one - open_)  # no number where it did not settle
        r = answer(memory, z, x, q)
        write_matrix(memory, a + wp.static(SYSTEM), tangent_system(c, r))
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
        if wp.static(SHEAR):
            put3(memory, a + wp.static(EXTENSION_AT), Vec3(one_of(q, 3), one_of(q, 4), one_of(q, 5)))
        return Vec3(one_of(q, 0) + bad, one_of(q, 1) + bad, one_of(q, 2) + bad)

    @wp.func
    def rates(memory: memory_type, z: int, a: int, x: Real, b: State, u: Vec3, f: wp.ref[State]):
        """No angles, no torques."""

    @wp.func
    def energy_rate(memory: memory_type, z: int, a: int, x: Real, b: State, M: Vec3, N: Vec3, u: Vec3) -> Real:
        """(14) Twice the energy per length, that of the members with it."""
        own = minus(M, row3(memory, a + wp.static(MEMBER_MOMENT)))
        energy = dot(own, times(row3(memory, z + wp.static(COMPLIANCE)), own))
        e = zero3()
        if wp.static(SHEAR):
            pull = minus(N, row3(memory, a + wp.static(MEMBER_FORCE)))
            e = row3(memory, a + wp.static(EXTENSION_AT))
            energy = energy + dot(pull, times(row3(memory, z + wp.static(SHEAR_AT)), pull))
        return energy + d(2.0) * energy_of_members(memory, z, x, u, e)

    @wp.func
    def strain_variation(memory: memory_type, z: int, a: int, g: int, v: Column, dM: Vec3, dN: Vec3):
        """(17m) du and d(v - e3); dM and dN in the frame"""
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

    return SimpleNamespace(
        strain=strain, rates=rates, energy_rate=energy_rate, strain_variation=strain_variation, rate_variations=rate_variations
    )
