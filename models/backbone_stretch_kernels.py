# mypy: ignore-errors
"""Precurvature, stiffness and loads at a place of a stretch between two nodes, and their variations.

Numbers in parentheses are those of ``docs/model.md``. ``z`` is the stretch, ``x`` the arclength from its start.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_layout_kernels import Layout


def make_stretch_functions(layout: Layout) -> SimpleNamespace:
    """Precurvature (6), stiffness and loads (3a) at a place of a stretch."""
    real, vec3, Stretch = layout.real, layout.vec3, layout.Stretch
    SPREAD_FORCE = layout.SPREAD_FORCE
    PROFILE, PROFILE_TERMS = layout.PROFILE, layout.PROFILE_TERMS
    CURVATURE_TERMS = layout.CURVATURE_TERMS
    VARIED_CURVATURE = CURVATURE_TERMS > 1

    @wp.func
    def precurvature(z: Stretch, i: int, x: real) -> vec3:
        """(6) u* of rod i, by Horner's rule."""
        if wp.static(VARIED_CURVATURE):
            t = (z.start + x - z.section_centre[i]) * z.section_slope[i]
            a = vec3(real(0.0), real(0.0), real(0.0))
            for k in range(wp.static(CURVATURE_TERMS)):
                j = 3 * (wp.static(CURVATURE_TERMS - 1) - k)
                a = t * a + vec3(z.precurvature[i, j], z.precurvature[i, j + 1], z.precurvature[i, j + 2])
            return a
        return vec3(z.precurvature[i, 0], z.precurvature[i, 1], z.precurvature[i, 2])

    @wp.func
    def precurvature_slope(z: Stretch, i: int, x: real) -> vec3:
        """d(u*)/ds of rod i."""
        a = vec3(real(0.0), real(0.0), real(0.0))
        if wp.static(VARIED_CURVATURE):
            t = (z.start + x - z.section_centre[i]) * z.section_slope[i]
            for k in range(wp.static(CURVATURE_TERMS - 1)):
                m = wp.static(CURVATURE_TERMS - 1) - k
                j = 3 * m
                a = t * a + (real(m) * z.section_slope[i]) * vec3(
                    z.precurvature[i, j], z.precurvature[i, j + 1], z.precurvature[i, j + 2]
                )
        return a

    @wp.func
    def compliance(z: Stretch) -> vec3:
        """Diagonal of K^-1 of rod 1."""
        return vec3(z.material[0, 3], z.material[0, 4], z.material[0, 5])

    @wp.func
    def shear_compliance(z: Stretch) -> vec3:
        """Diagonal of S^-1."""
        return vec3(z.material[0, 6], z.material[0, 7], z.material[0, 8])

    @wp.func
    def profile_value(z: Stretch, row: int, x: real) -> vec3:
        """Load profile, force (row 0) or moment (row 3) per length."""
        a = vec3(real(0.0), real(0.0), real(0.0))
        t = (z.start + x - z.profile_centre) * z.profile_slope
        for k in range(wp.static(PROFILE_TERMS)):
            j = wp.static(PROFILE_TERMS - 1) - k
            a = t * a + vec3(z.profile[row, j], z.profile[row + 1, j], z.profile[row + 2, j])
        return a

    @wp.func
    def profile_derivative(z: Stretch, row: int, x: real) -> vec3:
        """Its derivative by s."""
        a = vec3(real(0.0), real(0.0), real(0.0))
        t = (z.start + x - z.profile_centre) * z.profile_slope
        for k in range(wp.static(PROFILE_TERMS - 1)):
            j = wp.static(PROFILE_TERMS - 1) - k
            a = t * a + (real(j) * z.profile_slope) * vec3(z.profile[row, j], z.profile[row + 1, j], z.profile[row + 2, j])
        return a

    @wp.func
    def profile_integral(z: Stretch, x: real) -> vec3:
        """Integral of the force profile from the start of the stretch to x."""
        a = vec3(real(0.0), real(0.0), real(0.0))
        b = vec3(real(0.0), real(0.0), real(0.0))
        t0 = (z.start - z.profile_centre) * z.profile_slope
        t1 = (z.start + x - z.profile_centre) * z.profile_slope
        for k in range(wp.static(PROFILE_TERMS)):
            j = wp.static(PROFILE_TERMS - 1) - k
            c = vec3(z.profile[0, j], z.profile[1, j], z.profile[2, j]) / real(j + 1)
            a = t1 * a + c
            b = t0 * b + c
        return (t1 * a - t0 * b) / z.profile_slope

    @wp.func
    def spread_force(z: Stretch, x: real) -> vec3:
        """f, the force per length."""
        f = z.distributed_force
        if wp.static(PROFILE):
            f += profile_value(z, 0, x)
        return f

    @wp.func
    def spread_moment(z: Stretch, x: real) -> vec3:
        """l, the moment per length."""
        l = z.distributed_moment
        if wp.static(PROFILE):
            l += profile_value(z, 3, x)
        return l

    @wp.func
    def world_force(z: Stretch, x: real) -> vec3:
        """(3a) n: that at the start of the stretch less what is spread from there to x."""
        n = z.force
        if wp.static(SPREAD_FORCE):
            n -= x * z.distributed_force
        if wp.static(PROFILE):
            n -= profile_integral(z, x)
        return n

    @wp.func
    def growth(z: Stretch, k: int) -> real:
        """(20) dl_k / l_k: relative change of the length of the stretch for direction k."""
        return (z.end_rate[k] - z.start_rate[k]) / z.length

    @wp.func
    def arclength_rate(z: Stretch, x: real, k: int) -> real:
        """Change of s for direction k, at a fixed part of the stretch."""
        return z.start_rate[k] + x * growth(z, k)

    @wp.func
    def world_force_rate(z: Stretch, x: real, k: int) -> vec3:
        """(3a) Variation of n for direction k, at a fixed part of the stretch."""
        column = wp.static(layout.NX) + k
        dn = vec3(z.force_columns[column, 0], z.force_columns[column, 1], z.force_columns[column, 2])
        dn -= x * vec3(z.distributed_force_rate[k, 0], z.distributed_force_rate[k, 1], z.distributed_force_rate[k, 2])
        if wp.static(SPREAD_FORCE):
            dn -= arclength_rate(z, x, k) * spread_force(z, x) - z.start_rate[k] * spread_force(z, real(0.0))
        if wp.static(PROFILE):
            dn -= z.profile_rate[k] * profile_integral(z, x)
        return dn

    @wp.func
    def spread_moment_rate(z: Stretch, x: real, k: int) -> vec3:
        """Variation of l for direction k, at a fixed part of the stretch."""
        dl = vec3(z.distributed_moment_rate[k, 0], z.distributed_moment_rate[k, 1], z.distributed_moment_rate[k, 2])
        if wp.static(PROFILE):
            dl += z.profile_rate[k] * profile_value(z, 3, x) + arclength_rate(z, x, k) * profile_derivative(z, 3, x)
        return dl

    @wp.func
    def precurvature_rate(z: Stretch, i: int, x: real, k: int) -> vec3:
        """Variation of u* of rod i for direction k, at a fixed part of the stretch: the rod moves along itself."""
        return (arclength_rate(z, x, k) - z.shift_rate[k, i]) * precurvature_slope(z, i, x)

    return SimpleNamespace(
        precurvature=precurvature,
        compliance=compliance,
        shear_compliance=shear_compliance,
        profile_value=profile_value,
        profile_integral=profile_integral,
        spread_moment=spread_moment,
        world_force=world_force,
        growth=growth,
        world_force_rate=world_force_rate,
        spread_moment_rate=spread_moment_rate,
        precurvature_rate=precurvature_rate,
    )
