# mypy: ignore-errors
"""Dead loads along one backbone: the force at its base and how it changes on the way, (3a), and what is constant on a stretch.

One lane at a time, in double precision. Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.arguments import Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout, Memory
from multirod.models.backbone.kernels.layout.rows import InputOffsets

f64 = wp.float64


def make_distributed(layout: Layout, memory: Memory, memory_type, geometry: SimpleNamespace) -> SimpleNamespace:
    """Functions of the dead loads; ``geometry`` knows where sections are, and how directions move them."""
    at = InputOffsets(layout.n, layout.DRIVES)
    TIP_FORCE, DISTRIBUTED_FORCE, GRAVITY, PROFILE_FACTOR = at.TIP_FORCE, at.DISTRIBUTED_FORCE, at.GRAVITY, at.PROFILE_FACTOR
    PROFILE, PROFILE_TERMS, Z = layout.PROFILE, layout.PROFILE_TERMS, memory.STRETCH
    FORCE_PER_LENGTH, MOMENT_PER_LENGTH, z_at = layout.FORCE_PER_LENGTH, layout.MOMENT_PER_LENGTH, layout.stretch.__getitem__
    section_end, section_at, moved = geometry.section_end, geometry.section_at, geometry.moved
    direction_vector, set_number, set_vector = geometry.direction_vector, geometry.set_number, geometry.set_vector

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
            rate += call.problem.directions[case.direction, k, PROFILE_FACTOR] * profile_until(rods, s)
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

    @wp.func
    def density_at(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], s: f64) -> f64:
        """Mass per length of all rods from s on."""
        density = f64(0.0)
        for i in range(rods.end.shape[1]):
            m, present = section_at(rods, call, case, i, s)
            density += present * rods.material[case.rods, i, m, 9]
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

    if geometry.mass_rate_until is not None:
        mass_rate_until = geometry.mass_rate_until
    return SimpleNamespace(
        piece_from=piece_from,
        profile_integral=profile_integral,
        load_until=load_until,
        load_rate_until=load_rate_until,
        total_load=total_load,
        total_load_rate=total_load_rate,
        density_at=density_at,
        distributed_here=distributed_here,
        load_profile=load_profile,
    )
