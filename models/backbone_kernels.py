# mypy: ignore-errors
"""Equations of one backbone carried by n >= 1 concentric rods, and the kernel that integrates them.

Numbers in parentheses are those of ``docs/model.md``. The frame ``R`` is the material frame of rod 1, the innermost;
rod ``i`` is turned about it by ``theta_i`` (``theta_1 = 0``) and carries the torque ``tau_i``. ``M`` and ``N`` are the
moment and force of all rods together in that frame. With one rod this is the Cosserat rod of equation (1c) of the paper.

``make_kernel`` compiles the terms that a scene needs (``Features``) with the stages of one integrator (``Tableau``):
one kernel thread integrates one instance with its own grid, steps and status.
"""

from functools import cache

import warp as wp

from multirod.models.features import Features
from multirod.models.integrators import Tableau

FAULT_NONE = 0
FAULT_NONFINITE = 1
FAULT_STEPS = 2

MATERIAL_SIZE = 10  # EI_x, EI_y, GJ, their inverses, 1/GA_x, 1/GA_y, 1/EA, mass per length
INPUT_VECTORS = (
    "tip_force",
    "tip_moment",
    "follower_force",
    "follower_moment",
    "distributed_force",
    "distributed_moment",
    "gravity",
    "tip_curvature",
)


def input_size(rod_count: int) -> int:
    """Length of the packed inputs: rotations, translations, the vectors of ``INPUT_VECTORS``, scale of the load profiles."""
    return 2 * rod_count + 3 * len(INPUT_VECTORS) + 1


@wp.struct
class RodTable:
    """Rods of a backbone; the first axis is the batch or has length 1."""

    stride: int  # 1 if each instance has its own rods, else 0
    end: wp.array3d[wp.float64]  # arclength of section ends from the rod's base [m], (batch, rod, section)
    material: wp.array4d[wp.float64]  # (batch, rod, section, MATERIAL_SIZE)
    precurvature: wp.array4d[wp.float64]  # (batch, rod, section, 3 (degree + 1)), in the section's coordinate -1 to 1
    length_scale: wp.array[wp.float64]  # (batch,) [m]
    base_stride: int
    base_position: wp.array[wp.vec3d]  # (batch,)
    base_rotation: wp.array[wp.mat33d]  # (batch,)
    profile_end: wp.array[wp.float64]  # arclength of the ends of the pieces of load profiles [m], (piece,)
    profile: wp.array2d[wp.float64]  # force and moment coefficients, (piece, 6 (degree + 1))


@wp.struct
class Call:
    """What one launch reads and writes; the first axis is the batch."""

    active: wp.array[int]  # instances with 0 are left untouched
    unknowns: wp.array2d[wp.float64]
    inputs: wp.array2d[wp.float64]
    load_factor: wp.array[wp.float64]  # multiplies every load
    directions: wp.array3d[wp.float64]  # (batch or 1, direction, input)
    direction_stride: int
    steps: wp.float64
    rtol: wp.float64
    atol: wp.float64
    step_limit: int
    node_count: int
    # outputs
    fault: wp.array[int]
    step_count: wp.array[int]
    residual: wp.array2d[wp.float64]  # (batch, unknown) [1/m]
    gamma: wp.array3d[wp.float64]  # (batch, unknown, unknown)
    residual_directions: wp.array3d[wp.float64]  # (batch, unknown, direction)
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    pose_columns: wp.array3d[wp.float64]  # (batch, 6, unknown + direction), world frame
    node_arclength: wp.array2d[wp.float64]  # (batch, node)
    node_position: wp.array2d[wp.vec3d]
    node_rotation: wp.array2d[wp.mat33d]
    node_curvature: wp.array2d[wp.vec3d]
    node_moment: wp.array2d[wp.vec3d]
    node_force: wp.array2d[wp.vec3d]
    energy: wp.array[wp.float64]


# ---- equations that need no knowledge of the scene ----


@wp.func
def rotate(q: wp.vec4d, a: wp.vec3d) -> wp.vec3d:
    """(2b) ``R(q) a``; orthonormal for any q != 0, so the norm of q may drift."""
    r = wp.vec3d(q[0], q[1], q[2])
    c = wp.cross(r, a)
    return a + (wp.float64(2.0) / wp.dot(q, q)) * (q[3] * c + wp.cross(r, c))


@wp.func
def rotate_inverse(q: wp.vec4d, a: wp.vec3d) -> wp.vec3d:
    """(2b) ``R(q)^T a``."""
    r = wp.vec3d(q[0], q[1], q[2])
    c = wp.cross(r, a)
    return a + (wp.float64(2.0) / wp.dot(q, q)) * (wp.cross(r, c) - q[3] * c)


@wp.func
def tangent(q: wp.vec4d) -> wp.vec3d:
    """(1) ``R(q) e3``."""
    s = wp.float64(2.0) / wp.dot(q, q)
    return wp.vec3d(
        s * (q[0] * q[2] + q[3] * q[1]), s * (q[1] * q[2] - q[3] * q[0]), wp.float64(1.0) - s * (q[0] * q[0] + q[1] * q[1])
    )


@wp.func
def rotation_matrix(q: wp.vec4d) -> wp.mat33d:
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    return wp.matrix_from_cols(
        rotate(q, wp.vec3d(one, zero, zero)), rotate(q, wp.vec3d(zero, one, zero)), rotate(q, wp.vec3d(zero, zero, one))
    )


@wp.func
def quaternion_rate(q: wp.vec4d, u: wp.vec3d) -> wp.vec4d:
    """(2a) ``q' = q o (u, 0) / 2``, scalar last."""
    r = wp.vec3d(q[0], q[1], q[2])
    half = wp.float64(0.5)
    a = half * (q[3] * u + wp.cross(r, u))
    return wp.vec4d(a[0], a[1], a[2], -half * wp.dot(r, u))


@wp.func
def body_rotation(q: wp.vec4d, dq: wp.vec4d) -> wp.vec3d:
    """(15) Body-frame rotation vector of the variation dq: ``2 vec(conj(q) o dq) / |q|^2``."""
    r = wp.vec3d(q[0], q[1], q[2])
    dr = wp.vec3d(dq[0], dq[1], dq[2])
    return (wp.float64(2.0) / wp.dot(q, q)) * (q[3] * dr - dq[3] * r - wp.cross(r, dr))


@wp.func
def turn_base(q: wp.vec4d, angle: wp.float64) -> wp.vec4d:
    """(15) Variation of q for a turn about the body's z axis."""
    half = wp.float64(0.5) * angle
    return wp.vec4d(half * q[1], -half * q[0], half * q[3], -half * q[2])


@wp.func
def moment_rate(M: wp.vec3d, u: wp.vec3d, N: wp.vec3d) -> wp.vec3d:
    """(4) ``M' = M x u + N x e3``; shear and the distributed moment are added by the caller."""
    a = wp.cross(M, u)
    return wp.vec3d(a[0] + N[1], a[1] - N[0], a[2])


@wp.func
def force_rate(N: wp.vec3d, u: wp.vec3d) -> wp.vec3d:
    """(3b) ``N' = N x u``: a dead tip force alone, seen from the turning frame."""
    return wp.cross(N, u)


@wp.func
def moment_rate_variation(M: wp.vec3d, dM: wp.vec3d, u: wp.vec3d, du: wp.vec3d, dN: wp.vec3d) -> wp.vec3d:
    """(18) Variation of (4)."""
    a = wp.cross(dM, u) + wp.cross(M, du)
    return wp.vec3d(a[0] + dN[1], a[1] - dN[0], a[2])


@cache
def make_kernel(features: Features, tableau: Tableau):
    """Kernel for one set of features and one integrator; arguments ``(RodTable, Call)``, one thread an instance."""
    f64 = wp.float64
    n = features.rod_count
    NX = features.unknown_count if features.sensitivities else 0
    UNKNOWNS = features.unknown_count
    ND = features.directions
    C = NX + ND
    FORCE = features.force
    FRAME = features.frame
    COLUMN_FRAME = features.column_has_frame
    FORCE_STATE = features.force_is_state
    TIP_MOMENT = features.tip_moment
    FOLLOWER = features.follower_force
    FOLLOWER_MOMENT = features.follower_moment
    MEASURED = features.measured
    SHEAR = features.shear
    PROFILE = features.profile_degree >= 0
    LD = max(features.profile_degree, 0) + 1
    SPREAD_FORCE = features.distributed_force or PROFILE
    SPREAD_MOMENT = features.distributed_moment or PROFILE
    POSE = features.pose or features.nodes or features.pose_sensitivities
    POSE_COLUMNS = features.pose_sensitivities
    NODES = features.nodes
    UD = features.precurvature_degree + 1
    VARIED_CURVATURE = features.precurvature_degree > 0
    TUBES = n > 1
    ANISOTROPIC = features.anisotropic
    TRANSMISSION = features.transmission
    WORLD_COLUMNS = ND > 0 or (FOLLOWER and NX > 0)  # a column may carry a variation of the world force
    ADAPTIVE = len(tableau.error) > 0
    STAGES = len(tableau.b)
    A, B, CN, E = tableau.a, tableau.b, tableau.c, tableau.error
    ROT, TRA, FT, MT, FF, FM, DF, DM, G, UT, PS = 0, n, *range(2 * n, 2 * n + 25, 3)

    # State: M, [N], theta_i, tau_i (i >= 2), columns, [q], [p], [energy]; a column: M, [N], theta_i, tau_i, [q], [p].
    oN = 3
    oT = 3 + (3 if FORCE_STATE else 0)
    oTau = oT + n - 1
    STATICS = oTau + n - 1
    cP = STATICS + (4 if COLUMN_FRAME else 0)
    COL = cP + (3 if POSE_COLUMNS else 0)
    oQ = STATICS + COL * C
    oP = oQ + (4 if FRAME else 0)
    oE = oP + (3 if POSE else 0)
    SIZE = oE + (1 if NODES else 0)
    SIZE += -SIZE % 8  # whole vector registers: measured 15 % faster

    State = wp.types.vector(length=SIZE, dtype=f64)
    Stages = wp.types.matrix(shape=(STAGES, SIZE), dtype=f64)
    PerRod = wp.types.vector(length=n, dtype=f64)
    RodSections = wp.types.vector(length=n, dtype=wp.int32)
    Material = wp.types.matrix(shape=(n, MATERIAL_SIZE), dtype=f64)
    Precurvature = wp.types.matrix(shape=(n, 3 * UD), dtype=f64)
    Coordinates = wp.types.matrix(shape=(n, 3), dtype=f64)  # centre, 1/half length of the section, 1 if present
    Profile = wp.types.matrix(shape=(6, LD), dtype=f64)
    Tube = wp.types.matrix(shape=(n, 8), dtype=f64)
    Bent = wp.types.vector(length=6, dtype=f64)
    ColumnVectors = wp.types.matrix(shape=(max(C, 1), 3), dtype=f64)
    DirectionVectors = wp.types.matrix(shape=(max(ND, 1), 3), dtype=f64)
    DirectionRods = wp.types.matrix(shape=(max(ND, 1), n), dtype=f64)
    Columns = wp.types.matrix(shape=(n, max(C, 1)), dtype=f64)

    @wp.struct
    class Stretch:
        """One stretch of backbone between two nodes: what is constant on it."""

        start: f64
        length: f64
        material: Material
        precurvature: Precurvature
        coordinates: Coordinates
        force: wp.vec3d  # n at the start of the stretch
        weight: wp.vec3d  # uniform force per length
        couple: wp.vec3d  # uniform moment per length
        profile: Profile
        profile_centre: f64
        profile_scale: f64
        force_columns: ColumnVectors  # variation of n at the start
        weight_directions: DirectionVectors
        couple_directions: DirectionVectors
        start_directions: DirectionVectors  # rate of start, rate of end, profile scale
        shift_directions: DirectionRods

    @wp.func
    def precurvature(z: Stretch, i: int, x: f64) -> wp.vec3d:
        """(6) u* of rod i at x from the start of the stretch."""
        if wp.static(VARIED_CURVATURE):
            t = (z.start + x - z.coordinates[i, 0]) * z.coordinates[i, 1]
            a = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
            for k in range(wp.static(UD)):
                j = 3 * (wp.static(UD - 1) - k)
                a = t * a + wp.vec3d(z.precurvature[i, j], z.precurvature[i, j + 1], z.precurvature[i, j + 2])
            return a
        return wp.vec3d(z.precurvature[i, 0], z.precurvature[i, 1], z.precurvature[i, 2])

    @wp.func
    def precurvature_slope(z: Stretch, i: int, x: f64) -> wp.vec3d:
        """d(u*)/ds of rod i."""
        a = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        if wp.static(VARIED_CURVATURE):
            t = (z.start + x - z.coordinates[i, 0]) * z.coordinates[i, 1]
            for k in range(wp.static(UD - 1)):
                m = wp.static(UD - 1) - k
                j = 3 * m
                a = t * a + (f64(m) * z.coordinates[i, 1]) * wp.vec3d(
                    z.precurvature[i, j], z.precurvature[i, j + 1], z.precurvature[i, j + 2]
                )
        return a

    @wp.func
    def profile_value(z: Stretch, row: int, x: f64) -> wp.vec3d:
        """Load profile, force (row 0) or moment (row 3) per length, world frame."""
        a = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        t = (z.start + x - z.profile_centre) * z.profile_scale
        for k in range(wp.static(LD)):
            j = wp.static(LD - 1) - k
            a = t * a + wp.vec3d(z.profile[row, j], z.profile[row + 1, j], z.profile[row + 2, j])
        return a

    @wp.func
    def profile_slope(z: Stretch, row: int, x: f64) -> wp.vec3d:
        a = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        t = (z.start + x - z.profile_centre) * z.profile_scale
        for k in range(wp.static(LD - 1)):
            j = wp.static(LD - 1) - k
            a = t * a + (f64(j) * z.profile_scale) * wp.vec3d(z.profile[row, j], z.profile[row + 1, j], z.profile[row + 2, j])
        return a

    @wp.func
    def profile_force(z: Stretch, x: f64) -> wp.vec3d:
        """Integral of the force profile from the start of the stretch to x."""
        a = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        b = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        t0 = (z.start - z.profile_centre) * z.profile_scale
        t1 = (z.start + x - z.profile_centre) * z.profile_scale
        for k in range(wp.static(LD)):
            j = wp.static(LD - 1) - k
            c = wp.vec3d(z.profile[0, j], z.profile[1, j], z.profile[2, j]) / f64(j + 1)
            a = t1 * a + c
            b = t0 * b + c
        return (t1 * a - t0 * b) / z.profile_scale

    @wp.func
    def world_force(z: Stretch, x: f64) -> wp.vec3d:
        """(3a) n at x from the start of the stretch."""
        force = z.force
        if wp.static(SPREAD_FORCE):
            force -= x * z.weight
        if wp.static(PROFILE):
            force -= profile_force(z, x)
        return force

    @wp.func
    def spread_force(z: Stretch, x: f64) -> wp.vec3d:
        """Force per length at x."""
        force = z.weight
        if wp.static(PROFILE):
            force += profile_value(z, 0, x)
        return force

    @wp.func
    def spread_moment(z: Stretch, x: f64) -> wp.vec3d:
        """Moment per length at x."""
        moment = z.couple
        if wp.static(PROFILE):
            moment += profile_value(z, 3, x)
        return moment

    @wp.func
    def bent_tube(z: Stretch, i: int, theta: f64, us: wp.vec3d) -> Bent:
        """(7) K_i(theta) as xx, xy, yy; u*_i,xy turned by theta; sin and cos are inside."""
        s = wp.sin(theta)
        c = wp.cos(theta)
        kx = z.material[i, 0]
        ky = z.material[i, 1]
        out = Bent()
        out[0] = kx
        out[2] = kx
        if wp.static(ANISOTROPIC):
            out[0] = kx * c * c + ky * s * s
            out[1] = (kx - ky) * s * c
            out[2] = kx * s * s + ky * c * c
        out[3] = c * us[0] - s * us[1]
        out[4] = s * us[0] + c * us[1]
        return out

    @wp.func
    def inner_torque(y: State, z: Stretch) -> f64:
        """Torque of rod 1: what the others leave of M_z."""
        tau = y[2]
        for i in range(1, wp.static(n)):
            tau -= z.coordinates[i, 2] * y[wp.static(oTau) + i - 1]
        return tau

    @wp.func
    def rates(y: State, z: Stretch, x: f64) -> State:
        """Equations (1) to (8) and their variations (15) to (20)."""
        zero = f64(0.0)
        d = State()
        M = wp.vec3d(y[0], y[1], y[2])
        q = wp.vec4d(zero, zero, zero, f64(1.0))
        if wp.static(FRAME):
            q = wp.vec4d(y[oQ], y[oQ + 1], y[oQ + 2], y[oQ + 3])
        N = wp.vec3d(zero, zero, zero)
        if wp.static(FORCE_STATE):
            N = wp.vec3d(y[oN], y[oN + 1], y[oN + 2])
        elif wp.static(FORCE):
            N = rotate_inverse(q, world_force(z, x))

        # (5), (6), (7): strains
        give = wp.vec3d(z.material[0, 3], z.material[0, 4], z.material[0, 5])
        us = precurvature(z, 0, x)
        u = us
        tubes = Tube()
        flex = wp.vec3d(zero, zero, zero)  # inverse of the summed bending stiffness: xx, xy, yy
        if wp.static(TUBES):
            kxx = zero
            kxy = zero
            kyy = zero
            bx = M[0]
            by = M[1]
            for i in range(wp.static(n)):
                theta = zero
                if wp.static(i > 0):
                    theta = y[wp.static(oT) + i - 1]
                here = z.coordinates[i, 2]
                t = bent_tube(z, i, theta, precurvature(z, i, x))
                tubes[i, 0] = here * t[0]
                tubes[i, 1] = here * t[1]
                tubes[i, 2] = here * t[2]
                tubes[i, 3] = t[3]
                tubes[i, 4] = t[4]
                kxx += tubes[i, 0]
                kxy += tubes[i, 1]
                kyy += tubes[i, 2]
                bx += tubes[i, 0] * t[3] + tubes[i, 1] * t[4]
                by += tubes[i, 1] * t[3] + tubes[i, 2] * t[4]
            flex = wp.vec3d(kyy, -kxy, kxx) / (kxx * kyy - kxy * kxy)
            u = wp.vec3d(flex[0] * bx + flex[1] * by, flex[1] * bx + flex[2] * by, us[2] + z.material[0, 5] * inner_torque(y, z))
        else:
            u = us + wp.cw_mul(give, M)
        v = wp.vec3d(zero, zero, f64(1.0))
        extra = wp.vec3d(zero, zero, zero)  # v - e3
        shear = wp.vec3d(z.material[0, 6], z.material[0, 7], z.material[0, 8])
        if wp.static(SHEAR):
            extra = wp.cw_mul(shear, N)
            v += extra

        # (4), (3b), (8)
        dM = moment_rate(M, u, N)
        if wp.static(SHEAR):
            dM += wp.cross(N, extra)
        l = wp.vec3d(zero, zero, zero)
        if wp.static(SPREAD_MOMENT):
            l = rotate_inverse(q, spread_moment(z, x))
            dM -= l
        for k in range(3):
            d[k] = dM[k]
        if wp.static(FORCE_STATE):
            dN = force_rate(N, u)
            for k in range(3):
                d[oN + k] = dN[k]
        for i in range(wp.static(n)):
            if wp.static(TUBES):
                ex = u[0] - tubes[i, 3]
                ey = u[1] - tubes[i, 4]
                mx = tubes[i, 0] * ex + tubes[i, 1] * ey
                my = tubes[i, 1] * ex + tubes[i, 2] * ey
                tubes[i, 5] = mx
                tubes[i, 6] = my
                if wp.static(i > 0):
                    here = z.coordinates[i, 2]
                    usi = precurvature(z, i, x)
                    d[wp.static(oT) + i - 1] = here * (usi[2] + z.material[i, 5] * y[wp.static(oTau) + i - 1] - u[2])
                    d[wp.static(oTau) + i - 1] = u[1] * mx - u[0] * my
        # (2a), (1), (14)
        if wp.static(FRAME):
            dq = quaternion_rate(q, u)
            for k in range(4):
                d[oQ + k] = dq[k]
        if wp.static(POSE):
            dp = tangent(q)
            if wp.static(SHEAR):
                dp += rotate(q, extra)
            for k in range(3):
                d[oP + k] = dp[k]
        if wp.static(NODES):
            energy = wp.dot(N, extra)
            if wp.static(TUBES):
                energy += z.material[0, 5] * inner_torque(y, z) * inner_torque(y, z)
                for i in range(wp.static(n)):
                    energy += tubes[i, 5] * (u[0] - tubes[i, 3]) + tubes[i, 6] * (u[1] - tubes[i, 4])
                    if wp.static(i > 0):
                        tau = y[wp.static(oTau) + i - 1]
                        energy += z.coordinates[i, 2] * z.material[i, 5] * tau * tau
            else:
                energy += wp.dot(M, u - us)
            d[oE] = f64(0.5) * energy

        # (15) to (20): columns
        for c in range(wp.static(C)):
            o = wp.static(STATICS) + c * wp.static(COL)
            dM = wp.vec3d(y[o], y[o + 1], y[o + 2])
            dphi = wp.vec3d(zero, zero, zero)
            dqc = wp.vec4d(zero, zero, zero, zero)
            dsx = zero  # variation of the arclength of this point, of the start of the stretch, relative change of its length
            ds0 = zero
            stretch = zero
            if wp.static(c >= NX):
                ds0 = z.start_directions[c - NX, 0]
                stretch = (z.start_directions[c - NX, 1] - ds0) / z.length
                dsx = ds0 + x * stretch
            if wp.static(COLUMN_FRAME):
                dqc = wp.vec4d(y[o + STATICS], y[o + STATICS + 1], y[o + STATICS + 2], y[o + STATICS + 3])
                dphi = body_rotation(q, dqc)
            dN = wp.vec3d(zero, zero, zero)
            if wp.static(FORCE_STATE):
                dN = wp.vec3d(y[o + 3], y[o + 4], y[o + 5])
            elif wp.static(FORCE):
                dN = wp.cross(N, dphi)
                if wp.static(WORLD_COLUMNS):
                    dn = wp.vec3d(z.force_columns[c, 0], z.force_columns[c, 1], z.force_columns[c, 2])
                    if wp.static(c >= NX):
                        k = c - NX
                        dn -= x * wp.vec3d(z.weight_directions[k, 0], z.weight_directions[k, 1], z.weight_directions[k, 2])
                        if wp.static(SPREAD_FORCE):
                            dn -= dsx * spread_force(z, x) - ds0 * spread_force(z, zero)
                        if wp.static(PROFILE):
                            dn -= z.start_directions[k, 2] * profile_force(z, x)
                    dN += rotate_inverse(q, dn)
            dus = wp.vec3d(zero, zero, zero)
            if wp.static(VARIED_CURVATURE and c >= NX):
                dus = (dsx - z.shift_directions[c - NX, 0]) * precurvature_slope(z, 0, x)
            du = dus
            if wp.static(TUBES):
                gx = dM[0]
                gy = dM[1]
                dtau1 = dM[2]
                for i in range(wp.static(n)):
                    if wp.static(i > 0):
                        dth = y[o + wp.static(oT) + i - 1]
                        gx -= (-tubes[i, 6] + tubes[i, 0] * u[1] - tubes[i, 1] * u[0]) * dth
                        gy -= (tubes[i, 5] + tubes[i, 1] * u[1] - tubes[i, 2] * u[0]) * dth
                        dtau1 -= z.coordinates[i, 2] * y[o + wp.static(oTau) + i - 1]
                    if wp.static(VARIED_CURVATURE and c >= NX):
                        slope = (dsx - z.shift_directions[c - NX, i]) * precurvature_slope(z, i, x)
                        th = zero
                        if wp.static(i > 0):
                            th = y[wp.static(oT) + i - 1]
                        sx = wp.cos(th) * slope[0] - wp.sin(th) * slope[1]
                        sy = wp.sin(th) * slope[0] + wp.cos(th) * slope[1]
                        gx += tubes[i, 0] * sx + tubes[i, 1] * sy
                        gy += tubes[i, 1] * sx + tubes[i, 2] * sy
                du = wp.vec3d(flex[0] * gx + flex[1] * gy, flex[1] * gx + flex[2] * gy, dus[2] + z.material[0, 5] * dtau1)
            elif wp.static(VARIED_CURVATURE and c >= NX):
                du = dus + wp.cw_mul(give, dM)
            else:
                du = wp.cw_mul(give, dM)
            a = moment_rate_variation(M, dM, u, du, dN)
            dv = wp.vec3d(zero, zero, zero)
            if wp.static(SHEAR):
                dv = wp.cw_mul(shear, dN)
                a += wp.cross(dN, extra) + wp.cross(N, dv)
            if wp.static(SPREAD_MOMENT or (ND > 0 and COLUMN_FRAME)):
                a -= wp.cross(l, dphi)
                if wp.static(c >= NX):
                    k = c - NX
                    dl = wp.vec3d(z.couple_directions[k, 0], z.couple_directions[k, 1], z.couple_directions[k, 2])
                    if wp.static(PROFILE):
                        dl += z.start_directions[k, 2] * profile_value(z, 3, x) + dsx * profile_slope(z, 3, x)
                    a -= rotate_inverse(q, dl)
            for k in range(3):
                d[o + k] = a[k]
            if wp.static(FORCE_STATE):
                b = wp.cross(dN, u) + wp.cross(N, du)
                for k in range(3):
                    d[o + 3 + k] = b[k]
            for i in range(1, wp.static(n)):
                here = z.coordinates[i, 2]
                dth = y[o + wp.static(oT) + i - 1]
                sx = zero
                sy = zero
                sz = zero
                if wp.static(VARIED_CURVATURE and c >= NX):
                    slope = (dsx - z.shift_directions[c - NX, i]) * precurvature_slope(z, i, x)
                    th = y[wp.static(oT) + i - 1]
                    sx = wp.cos(th) * slope[0] - wp.sin(th) * slope[1]
                    sy = wp.sin(th) * slope[0] + wp.cos(th) * slope[1]
                    sz = slope[2]
                ex = du[0] - sx
                ey = du[1] - sy
                dmx = tubes[i, 0] * ex + tubes[i, 1] * ey + (-tubes[i, 6] + tubes[i, 0] * u[1] - tubes[i, 1] * u[0]) * dth
                dmy = tubes[i, 1] * ex + tubes[i, 2] * ey + (tubes[i, 5] + tubes[i, 1] * u[1] - tubes[i, 2] * u[0]) * dth
                jt = wp.static(oT) + i - 1
                jm = wp.static(oTau) + i - 1
                d[o + jt] = here * (sz + z.material[i, 5] * y[o + jm] - du[2])
                d[o + jm] = du[1] * tubes[i, 5] + u[1] * dmx - du[0] * tubes[i, 6] - u[0] * dmy
            if wp.static(COLUMN_FRAME):
                b4 = quaternion_rate(dqc, u) + quaternion_rate(q, du)
                for k in range(4):
                    d[o + STATICS + k] = b4[k]
            if wp.static(POSE_COLUMNS):
                b = rotate(q, wp.cross(dphi, v) + dv)
                for k in range(3):
                    d[o + cP + k] = b[k]
            if wp.static(c >= NX):
                # (20): the stretch itself grows
                for k in range(wp.static(STATICS)):
                    d[o + k] += stretch * d[k]
                for k in range(wp.static(cP - STATICS)):
                    d[o + STATICS + k] += stretch * d[oQ + k]
                for k in range(wp.static(COL - cP)):
                    d[o + cP + k] += stretch * d[oP + k]
        return d

    @wp.func
    def stages(y: State, z: Stretch, x: f64, h: f64) -> Stages:
        """Slopes of one step of size h from x."""
        k = Stages()
        for i in range(wp.static(STAGES)):
            w = y
            for j in range(wp.static(STAGES)):
                if wp.static(j < i and A[i][min(j, max(i - 1, 0))] != 0.0):
                    w += (h * wp.static(f64(A[i][j] if j < i else 0.0))) * k[j]
            k[i] = rates(w, z, x + wp.static(f64(CN[i])) * h)
        return k

    @wp.func
    def advance(y: State, k: Stages, h: f64) -> State:
        w = y
        for j in range(wp.static(STAGES)):
            if wp.static(B[j] != 0.0):
                w += (h * wp.static(f64(B[j]))) * k[j]
        return w

    @wp.func
    def block(y: State, first: int, count: int) -> f64:
        size = f64(0.0)
        for k in range(count):
            size = wp.max(size, wp.abs(y[first + k]))
        return size

    @wp.func
    def block_error(e: State, y: State, first: int, count: int, unit: f64, rtol: f64, atol: f64) -> f64:
        """Error of a block of the state over what is allowed; NaN counts as too large."""
        return block(e, first, count) / (atol * unit + rtol * block(y, first, count))

    @wp.func
    def step_error(k: Stages, y: State, h: f64, z: Stretch, scale: f64, rtol: f64, atol: f64) -> f64:
        e = State()
        for j in range(wp.static(STAGES)):
            if wp.static(ADAPTIVE and E[min(j, len(E) - 1)] != 0.0):
                e += (h * wp.static(f64(E[j] if ADAPTIVE else 0.0))) * k[j]
        EI = f64(0.0)
        for i in range(wp.static(n)):
            EI += z.coordinates[i, 2] * wp.max(z.material[i, 0], z.material[i, 1])
        error = block_error(e, y, 0, 3, EI / scale, rtol, atol)
        if wp.static(FORCE_STATE):
            error = wp.max(error, block_error(e, y, 3, 3, EI / (scale * scale), rtol, atol))
        if wp.static(TUBES):
            error = wp.max(error, block_error(e, y, oT, wp.static(n - 1), f64(1.0), rtol, atol))
            error = wp.max(error, block_error(e, y, oTau, wp.static(n - 1), EI / scale, rtol, atol))
        if wp.static(FRAME):
            error = wp.max(error, block_error(e, y, oQ, 4, f64(1.0), rtol, atol))
        if wp.static(POSE):
            error = wp.max(error, block_error(e, y, oP, 3, scale, rtol, atol))
        return error

    @wp.func
    def moment_scale(z: Stretch, i: int) -> wp.vec3d:
        """(10) Curvature per moment; where torsion is stiffer than bending, the bending stiffness scales it."""
        if wp.static(TUBES):
            EI = f64(0.0)
            for j in range(wp.static(n)):
                EI += z.coordinates[j, 2] * wp.max(z.material[j, 0], z.material[j, 1])
            GJ = wp.min(z.material[i, 2], wp.max(z.material[i, 0], z.material[i, 1]))
            return wp.vec3d(f64(1.0) / EI, f64(1.0) / EI, f64(1.0) / GJ)
        kx = z.material[0, 0]
        ky = z.material[0, 1]
        return wp.vec3d(f64(1.0) / kx, f64(1.0) / ky, f64(1.0) / wp.min(z.material[0, 2], wp.max(kx, ky)))

    @wp.func
    def unknown_scale(rods: RodTable, r: int, i: int) -> wp.vec3d:
        """(10) The same for the unknowns, by the first sections: it does not jump when a section is pulled into the base."""
        kx = rods.material[r, i, 0, 0]
        ky = rods.material[r, i, 0, 1]
        GJ = wp.min(rods.material[r, i, 0, 2], wp.max(kx, ky))
        if wp.static(TUBES):
            EI = f64(0.0)
            for j in range(wp.static(n)):
                EI += wp.max(rods.material[r, j, 0, 0], rods.material[r, j, 0, 1])
            return wp.vec3d(f64(1.0) / EI, f64(1.0) / EI, f64(1.0) / GJ)
        return wp.vec3d(f64(1.0) / kx, f64(1.0) / ky, f64(1.0) / GJ)

    @wp.func
    def input_vector(call: Call, t: int, first: int) -> wp.vec3d:
        return call.load_factor[t] * wp.vec3d(call.inputs[t, first], call.inputs[t, first + 1], call.inputs[t, first + 2])

    @wp.func
    def direction_vector(call: Call, t: int, k: int, first: int) -> wp.vec3d:
        j = t * call.direction_stride
        return wp.vec3d(call.directions[j, k, first], call.directions[j, k, first + 1], call.directions[j, k, first + 2])

    @wp.kernel(module="unique", enable_backward=False)
    def integrate(rods: RodTable, call: Call):
        t = wp.tid()
        if call.active[t] == 0:
            return
        zero = f64(0.0)
        one = f64(1.0)
        r = t * rods.stride
        Rb = rods.base_rotation[t * rods.base_stride]
        Rbt = wp.transpose(Rb)
        pb = rods.base_position[t * rods.base_stride]
        sections = rods.end.shape[2]
        scale = rods.length_scale[r]

        z = Stretch()
        shift = PerRod()
        section = RodSections()
        length = zero
        for i in range(wp.static(n)):
            shift[i] = call.inputs[t, TRA + i]
            length = wp.max(length, rods.end[r, i, sections - 1] + shift[i])
        length = rods.end[r, 0, sections - 1] + shift[0]
        dlength = DirectionVectors()
        for k in range(wp.static(ND)):
            for i in range(wp.static(n)):
                z.shift_directions[k, i] = call.directions[t * call.direction_stride, k, TRA + i]
            dlength[k, 0] = z.shift_directions[k, 0]

        # loads, in the base frame
        tip_force = Rbt * input_vector(call, t, FT)
        tip_moment = Rbt * input_vector(call, t, MT)
        follower_force = input_vector(call, t, FF)
        follower_moment = input_vector(call, t, FM)
        spread = Rbt * input_vector(call, t, DF)
        gravity = Rbt * input_vector(call, t, G)
        z.couple = Rbt * input_vector(call, t, DM)
        profile_factor = call.load_factor[t] * call.inputs[t, PS]

        # (3a) n at the base: the tip force and all that is spread over the length; and its variations
        n0 = tip_force
        dn0 = ColumnVectors()
        for k in range(wp.static(ND)):
            dF = Rbt * direction_vector(call, t, k, FT)
            for j in range(3):
                dn0[NX + k, j] = dF[j]
        if wp.static(SPREAD_FORCE and not FOLLOWER):
            n0 += length * spread
            for k in range(wp.static(ND)):
                dF = length * (Rbt * direction_vector(call, t, k, DF)) + dlength[k, 0] * spread
                for j in range(3):
                    dn0[NX + k, j] += dF[j]
            for i in range(wp.static(n)):
                for m in range(sections):
                    lo = zero
                    dlo = zero
                    if m > 0:
                        lo = rods.end[r, i, m - 1] + shift[i]
                        dlo = one
                    if lo <= zero:
                        lo = zero
                        dlo = zero
                    hi = rods.end[r, i, m] + shift[i]
                    if hi > lo:
                        rho = rods.material[r, i, m, 9]
                        n0 += ((hi - lo) * rho) * gravity
                        for k in range(wp.static(ND)):
                            dF = ((hi - lo) * rho) * (Rbt * direction_vector(call, t, k, G)) + (
                                (one - dlo) * z.shift_directions[k, i] * rho
                            ) * gravity
                            for j in range(3):
                                dn0[NX + k, j] += dF[j]
            if wp.static(PROFILE):
                s = zero
                for m in range(rods.profile_end.shape[0]):
                    e = wp.min(rods.profile_end[m], length)
                    if m == rods.profile_end.shape[0] - 1:
                        e = length
                    if e > s:
                        lo = zero
                        if m > 0:
                            lo = rods.profile_end[m - 1]
                        z.start = s
                        z.profile_centre = f64(0.5) * (lo + rods.profile_end[m])
                        z.profile_scale = f64(2.0) / (rods.profile_end[m] - lo)
                        for i in range(6):
                            for j in range(wp.static(LD)):
                                z.profile[i, j] = rods.profile[m, i * wp.static(LD) + j]
                        part = Rbt * profile_force(z, e - s)
                        n0 += profile_factor * part
                        for k in range(wp.static(ND)):
                            dF = call.directions[t * call.direction_stride, k, PS] * part
                            if e >= length:
                                dF += (dlength[k, 0] * profile_factor) * (Rbt * profile_value(z, 0, e - s))
                            for j in range(3):
                                dn0[NX + k, j] += dF[j]
                        s = e

        # sections at the base
        for i in range(wp.static(n)):
            section[i] = int(0)
            while section[i] < sections - 1 and rods.end[r, i, section[i]] + shift[i] <= zero:
                section[i] = section[i] + 1

        y = State()
        started = int(0)
        s = zero
        ds = DirectionVectors()  # rate of the current node for each direction
        piece = int(0)
        node = int(0)
        steps_used = int(0)
        fault = int(wp.static(FAULT_NONE))
        h = zero
        tau_end = PerRod()
        dtau_end = Columns()
        c_tip = wp.vec3d(one, one, one)
        ended = RodSections()

        while s < length and fault == wp.static(FAULT_NONE):
            # the next node: the nearest end of a section or load piece, output node, or the tip
            end = length
            dend = dlength
            for i in range(wp.static(n)):
                if section[i] < sections:
                    e = rods.end[r, i, section[i]] + shift[i]
                    if e < end:
                        end = e
                        for k in range(wp.static(ND)):
                            dend[k, 0] = z.shift_directions[k, i]
            if wp.static(PROFILE):
                if piece < rods.profile_end.shape[0] - 1:
                    e = rods.profile_end[piece]
                    if e < end:
                        end = e
                        dend = DirectionVectors()
            if wp.static(NODES):
                if node + 1 < call.node_count - 1:
                    e = length * f64(node + 1) / f64(call.node_count - 1)
                    end = min(end, e)

            # the stretch
            z.start = s
            z.length = end - s
            density = zero
            for i in range(wp.static(n)):
                m = wp.min(section[i], sections - 1)
                for j in range(wp.static(MATERIAL_SIZE)):
                    z.material[i, j] = rods.material[r, i, m, j]
                lo = zero
                if m > 0:
                    lo = rods.end[r, i, m - 1]
                hi = rods.end[r, i, m]
                z.coordinates[i, 0] = f64(0.5) * (lo + hi) + shift[i]
                z.coordinates[i, 1] = zero
                if hi > lo:
                    z.coordinates[i, 1] = f64(2.0) / (hi - lo)
                z.coordinates[i, 2] = zero
                if section[i] < sections:
                    z.coordinates[i, 2] = one
                    density += rods.material[r, i, m, 9]
                for j in range(wp.static(3 * UD)):
                    z.precurvature[i, j] = rods.precurvature[r, i, m, j]
            z.weight = spread + density * gravity
            for k in range(wp.static(ND)):
                dw = Rbt * (direction_vector(call, t, k, DF) + density * direction_vector(call, t, k, G))
                dl = Rbt * direction_vector(call, t, k, DM)
                for j in range(3):
                    z.weight_directions[k, j] = dw[j]
                    z.couple_directions[k, j] = dl[j]
                z.start_directions[k, 0] = ds[k, 0]
                z.start_directions[k, 1] = dend[k, 0]
                z.start_directions[k, 2] = call.directions[t * call.direction_stride, k, PS]
                if profile_factor != zero:
                    z.start_directions[k, 2] /= profile_factor
            if wp.static(PROFILE):
                lo = zero
                if piece > 0:
                    lo = rods.profile_end[piece - 1]
                z.profile_centre = f64(0.5) * (lo + rods.profile_end[piece])
                z.profile_scale = f64(2.0) / (rods.profile_end[piece] - lo)
                for j in range(wp.static(LD)):
                    for i in range(2):
                        a = (profile_factor * Rbt) * wp.vec3d(
                            rods.profile[piece, (3 * i) * wp.static(LD) + j],
                            rods.profile[piece, (3 * i + 1) * wp.static(LD) + j],
                            rods.profile[piece, (3 * i + 2) * wp.static(LD) + j],
                        )
                        for k in range(3):
                            z.profile[3 * i + k, j] = a[k]

            if started == 0:
                # (9), (10): the state at the base
                started = int(1)
                c = unknown_scale(rods, r, 0)
                base_angle = call.inputs[t, ROT]
                M = wp.vec3d(zero, zero, zero)
                if wp.static(TUBES):
                    M = wp.vec3d(call.unknowns[t, 0] / c[0], call.unknowns[t, 1] / c[1], zero)
                    for i in range(wp.static(n)):
                        ci = unknown_scale(rods, r, i)
                        tau = z.coordinates[i, 2] * call.unknowns[t, 2 + i] / ci[2]
                        M[2] += tau
                        angle = call.inputs[t, ROT + i]
                        if wp.static(TRANSMISSION):
                            angle -= wp.min(shift[i], zero) * tau * z.material[i, 5]
                        if wp.static(i > 0):
                            y[wp.static(oTau) + i - 1] = tau
                            y[wp.static(oT) + i - 1] = angle - base_angle
                        else:
                            base_angle = angle
                else:
                    M = wp.vec3d(
                        (call.unknowns[t, 0] - rods.precurvature[r, 0, 0, 0]) / c[0],
                        (call.unknowns[t, 1] - rods.precurvature[r, 0, 0, 1]) / c[1],
                        (call.unknowns[t, 2] - rods.precurvature[r, 0, 0, 2]) / c[2],
                    )
                for j in range(3):
                    y[j] = M[j]
                sn = wp.sin(f64(0.5) * base_angle)
                cs = wp.cos(f64(0.5) * base_angle)
                q = wp.vec4d(zero, zero, sn, cs)
                N = wp.vec3d(zero, zero, zero)
                force_unit = wp.max(rods.material[r, 0, 0, 0], rods.material[r, 0, 0, 1]) / scale
                if wp.static(FOLLOWER):
                    j = wp.static(UNKNOWNS - 3)
                    N = force_unit * wp.vec3d(call.unknowns[t, j], call.unknowns[t, j + 1], call.unknowns[t, j + 2])
                    n0 = rotate(q, N)
                else:
                    N = rotate_inverse(q, n0)
                z.force = n0
                if wp.static(FORCE_STATE):
                    for j in range(3):
                        y[oN + j] = N[j]
                if wp.static(FRAME):
                    for j in range(4):
                        y[oQ + j] = q[j]

                # (9), (10): the columns at the base
                for k in range(wp.static(C)):
                    o = wp.static(STATICS) + k * wp.static(COL)
                    turn = zero
                    if wp.static(k < NX and k < 3 and not TUBES):
                        y[o + k] = one / c[wp.min(k, 2)]
                    if wp.static(k < NX and TUBES and k < 2):
                        y[o + k] = one / c[wp.min(k, 1)]
                    if wp.static(k < NX and TUBES and k >= 2 and k < 2 + n):
                        ck = unknown_scale(rods, r, k - 2)
                        y[o + 2] = z.coordinates[k - 2, 2] / ck[2]
                        give = zero
                        if wp.static(TRANSMISSION):
                            give = -wp.min(shift[k - 2], zero) * z.coordinates[k - 2, 2] / ck[2] * z.material[k - 2, 5]
                        if wp.static(k > 2):
                            y[o + wp.static(oTau) + k - 3] = z.coordinates[k - 2, 2] / ck[2]
                            y[o + wp.static(oT) + k - 3] = give
                        else:
                            turn = give
                            for i in range(1, wp.static(n)):
                                y[o + wp.static(oT) + i - 1] = -give
                    if wp.static(k >= NX):
                        j = t * call.direction_stride
                        turn = call.directions[j, k - NX, ROT]
                        if wp.static(TUBES):
                            if wp.static(TRANSMISSION):
                                if shift[0] < zero:
                                    turn -= z.shift_directions[k - NX, 0] * inner_torque(y, z) * z.material[0, 5]
                            for i in range(1, wp.static(n)):
                                lead = call.directions[j, k - NX, ROT + i]
                                if wp.static(TRANSMISSION):
                                    if shift[i] < zero:
                                        lead -= z.shift_directions[k - NX, i] * y[wp.static(oTau) + i - 1] * z.material[i, 5]
                                y[o + wp.static(oT) + i - 1] = lead - turn
                    dn = wp.vec3d(dn0[k, 0], dn0[k, 1], dn0[k, 2])
                    if wp.static(FOLLOWER):
                        unit_force = wp.vec3d(zero, zero, zero)
                        if wp.static(k < NX and k >= UNKNOWNS - 3):
                            unit_force[wp.static(k) - wp.static(UNKNOWNS - 3)] = force_unit
                        dn = rotate(q, unit_force + turn * wp.cross(wp.vec3d(zero, zero, one), N))
                    for j in range(3):
                        z.force_columns[k, j] = dn[j]
                    if wp.static(FORCE_STATE):
                        dN = rotate_inverse(q, dn) + turn * wp.vec3d(N[1], -N[0], zero)
                        for j in range(3):
                            y[o + 3 + j] = dN[j]
                    if wp.static(COLUMN_FRAME):
                        dq = turn_base(q, turn)
                        for j in range(4):
                            y[o + STATICS + j] = dq[j]
                if wp.static(NODES):
                    d = rates(y, z, zero)
                    call.node_arclength[t, 0] = zero
                    call.node_position[t, 0] = pb
                    call.node_rotation[t, 0] = Rb * rotation_matrix(q)
                    call.node_moment[t, 0] = M
                    if wp.static(FORCE):
                        call.node_force[t, 0] = N
                    else:
                        call.node_force[t, 0] = wp.vec3d(zero, zero, zero)
                    # curvature from the rate of the frame: u = 2 vec(conj(q) q'), equation (2a)
                    call.node_curvature[t, 0] = body_rotation(q, wp.vec4d(d[oQ], d[oQ + 1], d[oQ + 2], d[oQ + 3]))

            # integrate the stretch
            if call.steps > zero:
                count = wp.max(int(1), int(wp.rint(call.steps * z.length / length)))
                h = z.length / f64(count)
                for j in range(count):
                    y = advance(y, stages(y, z, f64(j) * h, h), h)
                steps_used += count
            else:
                if wp.static(ADAPTIVE):
                    x = zero
                    if h <= zero:
                        d = rates(y, z, zero)
                        w = wp.sqrt(block(d, 0, 3) * scale / (block(y, 0, 3) + f64(1.0e-3) / wp.max(c_tip[0], f64(1.0e-300))))
                        h = wp.min(f64(0.1) * length, length / (one + w))
                    rejected = int(0)
                    while x < z.length and fault == wp.static(FAULT_NONE):
                        last = int(0)
                        step = h
                        if x + f64(1.01) * step >= z.length:
                            step = z.length - x
                            last = int(1)
                        slopes = stages(y, z, x, step)
                        trial = advance(y, slopes, step)
                        error = step_error(slopes, trial, step, z, scale, call.rtol, call.atol)
                        steps_used += int(1)
                        factor = f64(0.2)
                        if error <= one:
                            y = trial
                            x += step
                            if last == 1:
                                x = z.length
                            factor = f64(5.0)
                            if error > f64(1.0e-8):
                                factor = wp.min(f64(5.0), f64(0.9) * wp.pow(error, wp.static(f64(-1.0 / tableau.order))))
                            if rejected == 1:
                                factor = wp.min(factor, one)
                            rejected = int(0)
                            # a step cut short by a node says little about how long the next may be
                            if last == 0 or step * factor > h or factor < one:
                                h = step * factor
                        else:
                            if error < f64(1.0e30):
                                factor = wp.max(factor, f64(0.9) * wp.pow(error, wp.static(f64(-1.0 / tableau.order))))
                            h = step * factor
                            rejected = int(1)
                        if steps_used >= call.step_limit:
                            fault = int(wp.static(FAULT_STEPS))
                        if not (wp.isfinite(block(y, 0, 3)) and h > zero):
                            fault = int(wp.static(FAULT_NONFINITE))

            # pass the node
            if wp.static(FORCE and not FORCE_STATE):
                z_force = world_force(z, z.length)
                if wp.static(WORLD_COLUMNS):
                    for k in range(wp.static(ND)):
                        dn = z.length * wp.vec3d(z.weight_directions[k, 0], z.weight_directions[k, 1], z.weight_directions[k, 2])
                        if wp.static(SPREAD_FORCE):
                            dn += dend[k, 0] * spread_force(z, z.length) - ds[k, 0] * spread_force(z, zero)
                        if wp.static(PROFILE):
                            dn += z.start_directions[k, 2] * profile_force(z, z.length)
                        for j in range(3):
                            z.force_columns[NX + k, j] -= dn[j]
                z.force = z_force
            c_tip = moment_scale(z, 0)
            if wp.static(TUBES):
                for i in range(1, wp.static(n)):
                    if ended[i] == 0 and section[i] < sections:
                        ci = moment_scale(z, i)
                        tau_end[i] = ci[2] * y[wp.static(oTau) + i - 1]
                        for k in range(wp.static(C)):
                            dtau_end[i, k] = ci[2] * y[wp.static(STATICS) + k * wp.static(COL) + wp.static(oTau) + i - 1]
            if wp.static(NODES):
                e = length
                if node + 1 < call.node_count - 1:
                    e = length * f64(node + 1) / f64(call.node_count - 1)
                if end >= e:
                    node += int(1)
                    q = wp.vec4d(y[oQ], y[oQ + 1], y[oQ + 2], y[oQ + 3])
                    d = rates(y, z, z.length)
                    call.node_arclength[t, node] = end
                    call.node_position[t, node] = pb + Rb * wp.vec3d(y[oP], y[oP + 1], y[oP + 2])
                    call.node_rotation[t, node] = Rb * rotation_matrix(q)
                    call.node_moment[t, node] = wp.vec3d(y[0], y[1], y[2])
                    call.node_curvature[t, node] = body_rotation(q, wp.vec4d(d[oQ], d[oQ + 1], d[oQ + 2], d[oQ + 3]))
                    N = wp.vec3d(zero, zero, zero)
                    if wp.static(FORCE_STATE):
                        N = wp.vec3d(y[oN], y[oN + 1], y[oN + 2])
                    elif wp.static(FORCE):
                        N = rotate_inverse(q, z.force)
                    call.node_force[t, node] = N
            s = end
            ds = dend
            for i in range(wp.static(n)):
                while section[i] < sections and rods.end[r, i, wp.min(section[i], sections - 1)] + shift[i] <= s:
                    section[i] = section[i] + 1
                if section[i] >= sections:
                    ended[i] = int(1)
            if wp.static(PROFILE):
                while piece < rods.profile_end.shape[0] - 1 and rods.profile_end[piece] <= s:
                    piece += int(1)

        # (11), (12): residual at the tip
        M = wp.vec3d(y[0], y[1], y[2])
        q = wp.vec4d(zero, zero, zero, one)
        if wp.static(FRAME):
            q = wp.vec4d(y[oQ], y[oQ + 1], y[oQ + 2], y[oQ + 3])
        applied = wp.vec3d(zero, zero, zero)
        if wp.static(TIP_MOMENT):
            applied = rotate_inverse(q, tip_moment)
        gap = M - applied
        if wp.static(FOLLOWER_MOMENT):
            gap -= follower_moment
        unit = c_tip
        if wp.static(MEASURED):
            # (12): the measured curvature takes the place of the boundary condition
            give = wp.vec3d(z.material[0, 3], z.material[0, 4], z.material[0, 5])
            gap = precurvature(z, 0, z.length) + wp.cw_mul(give, M)
            gap -= wp.vec3d(call.inputs[t, UT], call.inputs[t, UT + 1], call.inputs[t, UT + 2])
            unit = wp.vec3d(one, one, one)
        total = zero
        if wp.static(TUBES):
            for i in range(1, wp.static(n)):
                if ended[i] == 0 or rods.end[r, i, sections - 1] + shift[i] >= length:
                    gap[2] -= y[wp.static(oTau) + i - 1]
                call.residual[t, 2 + i] = tau_end[i]
                total += wp.abs(tau_end[i])
        for j in range(3):
            call.residual[t, j] = unit[j] * gap[j]
            total += wp.abs(unit[j] * gap[j])
        tip_unit = scale / wp.max(z.material[0, 0], z.material[0, 1])
        pulled = wp.vec3d(zero, zero, zero)
        if wp.static(FOLLOWER):
            pulled = rotate_inverse(q, tip_force)
            N = rotate_inverse(q, z.force) - pulled - follower_force
            for j in range(3):
                call.residual[t, wp.static(UNKNOWNS - 3) + j] = tip_unit * N[j]
                total += wp.abs(tip_unit * N[j])
        for k in range(wp.static(C)):
            o = wp.static(STATICS) + k * wp.static(COL)
            g = wp.vec3d(y[o], y[o + 1], y[o + 2])
            dphi = wp.vec3d(zero, zero, zero)
            if wp.static(COLUMN_FRAME):
                dphi = body_rotation(q, wp.vec4d(y[o + STATICS], y[o + STATICS + 1], y[o + STATICS + 2], y[o + STATICS + 3]))
            if wp.static(TIP_MOMENT):
                g -= wp.cross(applied, dphi)
            if wp.static(k >= NX):
                if wp.static(COLUMN_FRAME):
                    g -= rotate_inverse(q, Rbt * direction_vector(call, t, k - NX, MT))
                g -= direction_vector(call, t, k - NX, FM)
            if wp.static(MEASURED):
                give = wp.vec3d(z.material[0, 3], z.material[0, 4], z.material[0, 5])
                g = wp.cw_mul(give, wp.vec3d(y[o], y[o + 1], y[o + 2]))
                if wp.static(k >= NX):
                    g -= direction_vector(call, t, k - NX, UT)
                    g += (dlength[k - NX, 0] - z.shift_directions[k - NX, 0]) * precurvature_slope(z, 0, z.length)
            if wp.static(TUBES):
                for i in range(1, wp.static(n)):
                    if ended[i] == 0 or rods.end[r, i, sections - 1] + shift[i] >= length:
                        g[2] -= y[o + wp.static(oTau) + i - 1]
                    if wp.static(k < NX):
                        call.gamma[t, 2 + i, k] = dtau_end[i, k]
                    else:
                        call.residual_directions[t, 2 + i, k - NX] = dtau_end[i, k]
            for j in range(3):
                if wp.static(k < NX):
                    call.gamma[t, j, k] = unit[j] * g[j]
                else:
                    call.residual_directions[t, j, k - NX] = unit[j] * g[j]
                total += wp.abs(g[j])
            if wp.static(FOLLOWER):
                dF = wp.vec3d(zero, zero, zero)
                dn = wp.vec3d(z.force_columns[k, 0], z.force_columns[k, 1], z.force_columns[k, 2])
                if wp.static(k >= NX):
                    dn -= Rbt * direction_vector(call, t, k - NX, FT)
                    dF = direction_vector(call, t, k - NX, FF)
                a = rotate_inverse(q, dn) + wp.cross(rotate_inverse(q, z.force) - pulled, dphi) - dF
                for j in range(3):
                    if wp.static(k < NX):
                        call.gamma[t, wp.static(UNKNOWNS - 3) + j, k] = tip_unit * a[j]
                    else:
                        call.residual_directions[t, wp.static(UNKNOWNS - 3) + j, k - NX] = tip_unit * a[j]
            if wp.static(POSE_COLUMNS):
                a = Rb * wp.vec3d(y[o + cP], y[o + cP + 1], y[o + cP + 2])
                b = Rb * rotate(q, dphi)
                for j in range(3):
                    call.pose_columns[t, j, k] = a[j]
                    call.pose_columns[t, 3 + j, k] = b[j]
        if wp.static(POSE):
            call.position[t] = pb + Rb * wp.vec3d(y[oP], y[oP + 1], y[oP + 2])
            call.rotation[t] = Rb * rotation_matrix(q)
        if wp.static(NODES):
            call.energy[t] = y[oE]
        if not wp.isfinite(total):
            fault = int(wp.static(FAULT_NONFINITE))
        call.fault[t] = fault
        call.step_count[t] = steps_used

    return integrate
