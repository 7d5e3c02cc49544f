# mypy: ignore-errors
"""All members of a rod as one: what each answers, one after another.

``z`` is where the record of a stretch stands in memory, ``a`` where that of a place stands, ``x`` the arclength from the start of
the stretch. Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace
from typing import Any

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.members.response import make_response
from multirod.models.backbone.kernels.members.winding import winding_types
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors

WRITTEN_OUT = 3  # so many members of one law are written out where strains are sought; more are called in a loop


def make_members(layout: Layout, W: int, d, rod: int | None = None) -> SimpleNamespace:
    """The laws of all members, or of those of one of several rods, called as if they were one.

    Their drives are numbered from ``first_drive`` on; ``u``, ``e`` are strains of the rod that carries them, in its own frame.
    """
    OWN = [k for k in range(len(layout.features.members)) if rod is None or layout.features.member_rods[k] == rod]
    FIRST_DRIVE = sum(kind.drive is not None for kind in layout.features.members[: OWN[0]])
    FORCES = layout.features.shear or layout.NODES  # whether it is asked what force members carry
    L, V, R = lanes(W, d), vectors(W, d), make_response(W, d, 6 if FORCES else 3)
    Real, row, put, fill = L.Real, L.row, L.put, L.fill
    Vec3, row3, zero3 = V.Vec3, V.row3, V.zero3
    memory_type = wp.array(dtype=d)
    Response, part_of_response = R.Response, R.part
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column, keep, part_of = state.type, column.type, state.keep, column.part
    SHEAR, m = layout.features.shear, layout.STRAINS
    s, p = layout.stretch, layout.place
    vector = L.few(m)
    Few, keep_one, one_of = vector.type, vector.keep, vector.part
    FUNCTIONS, TERMS = layout.FUNCTIONS, layout.FUNCTION_TERMS
    # functions of members: those that are constant by section stand on the stretch, the others at the place
    FUNCTIONS_AT, ROWS_AT = p["functions"], s["functions"]
    ROUTED, CENTRE, SLOPE = layout.ROUTED, s["centre"] + (rod or 0), s["slope"] + (rod or 0)
    OWN_FUNCTIONS, FIRST_FUNCTION = (
        sum(len(layout.features.members[k].functions) for k in OWN),
        layout.of_member(OWN[0])[1],
    )
    ALONG = layout.ROUTED and layout.DIRECTIONS
    LENGTHS, LENGTHS_AT = layout.LENGTHS, layout.state["lengths"]
    # lengths follow what slides of all rods
    PULLS_AT, SLIDES_AT = p["pulls"], p["slides"] + 3 * max(len(layout.CARRIERS) - 1, 0)
    DRIVES_VARY, FRICTION, DRIVES_GIVEN = layout.DRIVES_VARY, layout.FRICTION, layout.given["drives"]
    GRIPS_AT, DRIVES_AT, HELD_AT = layout.state["grips"], p["drives"], p["grips"]
    COMPLIANCE, SHEAR_AT, EXTENSION_AT = s["compliance"], s["shear"], p["extension"]

    @wp.func
    def value(memory: memory_type, on: int) -> Real:
        return row(memory, on)

    @wp.func
    def slope(memory: memory_type, on: int) -> Real:
        return row(memory, on + wp.static(FUNCTIONS))

    @wp.func
    def bend(memory: memory_type, on: int) -> Real:
        return row(memory, on + wp.static(2 * FUNCTIONS))

    flags = {"SHEAR": SHEAR, "FORCES": FORCES, "VARIED": ROUTED, "DISCS": layout.features.discs, "FRICTION": layout.FRICTION}
    own = {"memory_type": memory_type, "value": value, "slope": slope, "bend": bend, **flags}
    windings = winding_types(W, d)
    numbers = SimpleNamespace(**(vars(L) | vars(V) | vars(R) | vars(windings) | own))
    laws = {kind: kind.law(numbers) for kind in layout.features.members}

    @wp.func
    def at_place(memory: memory_type, z: int, a: int, x: Real):
        """The functions of members, and their derivatives by arclength."""
        by_length = row(memory, z + wp.static(SLOPE))
        t = (x - row(memory, z + wp.static(CENTRE))) * by_length
        count = int(wp.static(OWN_FUNCTIONS))
        for k_own in range(count):
            j = k_own + wp.static(FIRST_FUNCTION)
            first = z + wp.static(ROWS_AT) + j
            y = row(memory, first + wp.static((TERMS - 1) * FUNCTIONS))
            y_t = fill(d(0.0))
            y_tt = fill(d(0.0))
            for k in range(wp.static(TERMS - 1)):
                y_tt = y_t + t * y_tt
                y_t = y + t * y_t
                y = row(memory, first + wp.static(FUNCTIONS * (TERMS - 2 - k))) + t * y
            put(memory, a + wp.static(FUNCTIONS_AT) + j, y)
            put(memory, a + wp.static(FUNCTIONS_AT + FUNCTIONS) + j, by_length * y_t)
            if wp.static(ALONG or FRICTION):
                put(memory, a + wp.static(FUNCTIONS_AT + 2 * FUNCTIONS) + j, d(2.0) * by_length * by_length * y_tt)

    def runs() -> list[tuple[Any, int, int, int, int, int]]:
        """Members of one law that follow each other: the law, how many, where the first stands, how far the next is from it."""
        found: list[list[Any]] = []
        for k in OWN:
            kind = layout.features.members[k]
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
            if wp.static(count <= WRITTEN_OUT):
                for k in range(wp.static(count)):
                    function(memory, numbers_of(z, wp.static(k)), functions_of(z, a, wp.static(k)), u, e, r)
            else:
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
                    put(memory, a + wp.static(PULLS_AT + j) + (drive + k) * wp.static(m), part_of_response(r, j))
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

    respond = chain(responses, no_response)

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

    return SimpleNamespace(
        Response=Response,
        at_place=at_place,
        chain=chain,
        first_drive=FIRST_DRIVE,
        drive_count=sum(layout.features.members[k].drive is not None for k in OWN),
        respond=respond,
        answer=answer,
        energy=chain(energies, no_energy, "energy"),
        work_of_drives=chain(works, no_energy, "pull"),
        put_pulls=chain(pulls, no_pull, "pull"),
        put_slides=chain(slides, no_slide, "slide"),
        keep_lengths=chain(lengths, no_length, "pull"),
        stacked=stacked,
        drive_variation=drive_variation,
        extension_at=extension_at,
        compliances=compliances,
        part_of_response=part_of_response,
        places=R.places,
        change=R.change,
        bounded=all(getattr(laws[layout.features.members[k]], "bounded", False) for k in OWN),
    )
