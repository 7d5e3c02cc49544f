# mypy: ignore-errors
"""Equations (1) to (5) and (14) to (20) along the backbone, in lanes: the rates of the state, and of a column of it.

``base_rates`` puts what columns need of a place to memory, at ``a``; ``column_rates`` reads it. ``z`` is where the record of the
stretch stands, ``x`` the arclength from its start, ``b`` the state, ``v`` a column, ``g`` where stands what its direction varies.
Numbers in parentheses are those of ``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.equations.innermost import make_innermost
from multirod.models.backbone.kernels.equations.strains import make_strains
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.loads.dead import make_loads
from multirod.models.backbone.kernels.loads.together import make_acting
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors


def make_rates(layout: Layout, W: int, d) -> SimpleNamespace:
    """The rates of the state and of its columns."""
    L, V = lanes(W, d), vectors(W, d)
    Real, fill, row, put = L.Real, L.fill, L.row, L.put
    Vec3, Frame, row3, put3, zero3 = V.Vec3, V.Frame, V.row3, V.put3, V.zero3
    cross, ahead_cross, dot, plus, minus = V.cross, V.ahead_cross, V.dot, V.plus, V.minus
    scaled, ahead3 = V.scaled, V.ahead3
    rotate, rotate_inverse, tangent, body_rotation = V.rotate, V.rotate_inverse, V.tangent, V.body_rotation
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    part, keep, part_of, keep_in = state.part, state.keep, column.part, column.keep
    s, c, p = layout.state, layout.column, layout.place
    M_AT, N_AT, Q_AT, P_AT = s["moment"], s["force"], s["frame"], s["position"]
    ENERGY, WORK = s["energy"], s["work"]
    DM_AT, DN_AT, DQ_AT, DP_AT = c["moment"], c["force"], c["frame"], c["position"]
    X, FRAME_AT, MOMENT_AT, FORCE_AT, CURVATURE_AT = p["x"], p["frame"], p["moment"], p["force"], p["curvature"]
    EXTENSION_AT, WORLD_FORCE_AT, TANGENT_AT, RATE_AT = p["extension"], p["world_force"], p["tangent"], p["rate"]
    GROWTH = layout.given["growth"]
    MOMENT, FORCE, FORCE_STATE, FRAME = layout.MOMENT, layout.FORCE, layout.FORCE_STATE, layout.FRAME
    COLUMN_FRAME, POSE, POSE_COLUMNS, FIXED = layout.COLUMN_FRAME, layout.POSE, layout.POSE_COLUMNS, layout.FIXED
    SHEAR, NODES, MOMENT_PER_LENGTH = layout.features.shear, layout.NODES, layout.MOMENT_PER_LENGTH
    DIRECTIONS, GIVEN_FORCE = layout.DIRECTIONS, layout.GIVEN_FORCE
    STATICS, COLUMN_SIZE = layout.column.size - 4 * COLUMN_FRAME - 3 * POSE_COLUMNS, layout.column.size
    loads, law = make_loads(layout, W, d), make_strains(layout, W, d)
    world_force, distributed_moment = loads.world_force, loads.distributed_moment
    force_variation, moment_variation = loads.force_variation, loads.moment_variation
    WORLD_AT, DWORLD_AT = s["world_force"], c["world_force"]
    WORLD_STATE, FORCE_PER_LENGTH = layout.WORLD_STATE, layout.FORCE_PER_LENGTH
    # loads that depend on the configuration
    acting = make_acting(layout, W, d)
    acting_force, acting_moment, acting_torques, acting_work = acting.force, acting.moment, acting.torques, acting.work
    acting_force_variation, acting_moment_variation = acting.force_variation, acting.moment_variation
    acting_torque_variations = acting.torque_variations
    ACTING, MOMENTS, TURNS = acting_work is not None, acting_moment is not None, acting_torques is not None
    TWISTED, MOMENT_RATE_AT = layout.TWISTED, p["moment_rate"]
    if TWISTED:
        innermost = make_innermost(layout, W, d)
        balance, balance_variation = innermost.balance, innermost.balance_variation
    distributed_force, distributed_force_variation = loads.distributed_force, loads.distributed_force_variation
    strain, own_rates, own_energy = law.strain, law.rates, law.energy_rate
    DRIVEN, LENGTHS = layout.DRIVES > 0, layout.LENGTHS > 0
    FRICTION, MOMENT_RATE = layout.FRICTION, p["pull_rates"]
    if layout.features.members:
        driven_work, length_rates, length_variations = law.driven_work, law.length_rates, law.length_variations
        friction_rates, friction_variations = law.friction_rates, law.friction_variations
    strain_variation, own_rate_variations = law.strain_variation, law.rate_variations

    @wp.func
    def part3(b: State, at: int) -> Vec3:
        return Vec3(part(b, at), part(b, at + 1), part(b, at + 2))

    @wp.func
    def keep3(b: wp.ref[State], at: int, a: Vec3):
        keep(b, at, a.x)
        keep(b, at + 1, a.y)
        keep(b, at + 2, a.z)

    @wp.func
    def part3_of(v: Column, at: int) -> Vec3:
        return Vec3(part_of(v, at), part_of(v, at + 1), part_of(v, at + 2))

    @wp.func
    def keep3_in(v: wp.ref[Column], at: int, a: Vec3):
        keep_in(v, at, a.x)
        keep_in(v, at + 1, a.y)
        keep_in(v, at + 2, a.z)

    @wp.func
    def frame_of(b: State) -> Frame:
        r = part3(b, wp.static(Q_AT))
        w = part(b, wp.static(Q_AT + 3))
        return Frame(r, w, d(2.0) / (dot(r, r) + w * w))

    @wp.func
    def frame_at(memory: memory_type, a: int) -> Frame:
        at = a + wp.static(FRAME_AT)
        return Frame(row3(memory, at), row(memory, at + 3), row(memory, at + 4))

    @wp.func
    def couple(N: Vec3) -> Vec3:
        """N x e3"""
        return Vec3(N.y, -N.x, fill(d(0.0)))

    @wp.func
    def base_rates(memory: memory_type, z: int, a: int, x: Real, b: State) -> State:
        """(1) to (8), (14)"""
        f = State()
        M = zero3()
        N = zero3()
        n = zero3()
        p = zero3()
        if wp.static(POSE):
            p = part3(b, wp.static(P_AT))
        put(memory, a + wp.static(X), x)
        if wp.static(FRAME):
            frame = frame_of(b)
            put3(memory, a + wp.static(FRAME_AT), frame.r)
            put(memory, a + wp.static(FRAME_AT + 3), frame.w)
            put(memory, a + wp.static(FRAME_AT + 4), frame.two)
        if wp.static(MOMENT):
            M = part3(b, wp.static(M_AT))
        if wp.static(FIXED):
            M = rotate_inverse(frame, M)
        if wp.static(FORCE_STATE):
            N = part3(b, wp.static(N_AT))
        if wp.static(FORCE and not FORCE_STATE):
            if wp.static(WORLD_STATE):
                n = part3(b, wp.static(WORLD_AT))
            else:
                n = world_force(memory, z, x)
            N = rotate_inverse(frame, n)
        u = strain(memory, z, a, x, b, M, N)
        put3(memory, a + wp.static(MOMENT_AT), M)
        put3(memory, a + wp.static(FORCE_AT), N)
        put3(memory, a + wp.static(CURVATURE_AT), u)
        if wp.static(SHEAR):
            extension = row3(memory, a + wp.static(EXTENSION_AT))
        if wp.static(POSE or FIXED):
            p_s = tangent(frame)
            if wp.static(SHEAR):
                p_s = plus(p_s, rotate(frame, extension))
            if wp.static(POSE):
                keep3(f, wp.static(P_AT), p_s)
        if wp.static(FIXED):  # (4b)
            m_s = cross(n, p_s)
            if wp.static(MOMENT_PER_LENGTH):
                m_s = minus(m_s, distributed_moment(memory, z, x))
            if wp.static(MOMENTS):
                m_s = minus(m_s, acting_moment(memory, z, a, x, frame, p))
            keep3(f, wp.static(M_AT), m_s)
            put3(memory, a + wp.static(WORLD_FORCE_AT), n)
            put3(memory, a + wp.static(TANGENT_AT), p_s)
            if wp.static(TWISTED):
                put3(memory, a + wp.static(MOMENT_RATE_AT), m_s)
        if wp.static(MOMENT and not FIXED):  # (4)
            M_s = ahead_cross(couple(N), M, u)
            if wp.static(SHEAR):
                M_s = ahead_cross(M_s, N, extension)
            keep3(f, wp.static(M_AT), M_s)
        if wp.static(WORLD_STATE):  # (3e)
            n_s = scaled(fill(d(-1.0)), acting_force(memory, z, a, x, frame, p))
            if wp.static(FORCE_PER_LENGTH):
                n_s = minus(n_s, distributed_force(memory, z, x))
            keep3(f, wp.static(WORLD_AT), n_s)
        if wp.static(FORCE_STATE):  # (3b)
            keep3(f, wp.static(N_AT), cross(N, u))
        if wp.static(FRAME):  # (2a)
            half = fill(d(0.5))
            keep3(f, wp.static(Q_AT), scaled(half, ahead3(cross(frame.r, u), frame.w, u)))
            keep(f, wp.static(Q_AT + 3), d(-0.5) * dot(frame.r, u))
        own_rates(memory, z, a, x, b, u, f)
        if wp.static(LENGTHS):
            length_rates(memory, z, a, u, f)
        if wp.static(TURNS):
            acting_torques(memory, a, f)
        if wp.static(TWISTED):  # (8l)
            M_s = ahead_cross(rotate_inverse(frame, m_s), M, u)
            balance(memory, z, M_s.z, f)
        if wp.static(FRICTION):
            M_s = part3(f, wp.static(M_AT))
            if wp.static(FIXED):
                M_s = ahead_cross(rotate_inverse(frame, M_s), M, u)
            N_s = zero3()
            if wp.static(SHEAR and FORCE):
                N_s = cross(N, u)
                if wp.static(WORLD_STATE):
                    N_s = plus(N_s, rotate_inverse(frame, n_s))
                elif wp.static(FORCE_PER_LENGTH):
                    N_s = minus(N_s, rotate_inverse(frame, distributed_force(memory, z, x)))
            friction_rates(memory, z, a, x, u, M_s, N_s, b, f)
        if wp.static(NODES):
            energy = own_energy(memory, z, a, x, b, M, N, u)
            work = N.z
            if wp.static(SHEAR):
                work = work + dot(N, extension)
            if wp.static(ACTING):
                work = work + acting_work(memory, z, a, x, frame, p)
            if wp.static(DRIVEN):
                work = work + driven_work(memory, z, a, u)
            keep(f, wp.static(ENERGY), d(0.5) * energy)
            keep(f, wp.static(WORK), work)
        if wp.static(DIRECTIONS):
            for j in range(wp.static(STATICS)):
                put(memory, a + wp.static(RATE_AT + j), part(f, j))
            for j in range(wp.static(4 * COLUMN_FRAME)):
                put(memory, a + wp.static(RATE_AT + DQ_AT + j), part(f, wp.static(Q_AT + j)))
            for j in range(wp.static(3 * POSE_COLUMNS)):
                put(memory, a + wp.static(RATE_AT + DP_AT + j), part(f, wp.static(P_AT + j)))
        return f

    @wp.func
    def column_rates(memory: memory_type, z: int, a: int, g: int, v: Column) -> Column:
        """(15) to (20)"""
        f = Column()
        x = row(memory, a + wp.static(X))
        M = row3(memory, a + wp.static(MOMENT_AT))
        N = row3(memory, a + wp.static(FORCE_AT))
        u = row3(memory, a + wp.static(CURVATURE_AT))
        dM = zero3()
        dN = zero3()
        dn = zero3()
        dphi = zero3()
        dp = zero3()
        if wp.static(POSE_COLUMNS):
            dp = part3_of(v, wp.static(DP_AT))
        if wp.static(MOMENT):
            dM = part3_of(v, wp.static(DM_AT))
        if wp.static(COLUMN_FRAME):  # (15)
            frame = frame_at(memory, a)
            dr = part3_of(v, wp.static(DQ_AT))
            dw = part_of(v, wp.static(DQ_AT + 3))
            dphi = body_rotation(frame, dr, dw)
        if wp.static(FIXED):  # (18b)
            dM = ahead_cross(rotate_inverse(frame, dM), M, dphi)
        if wp.static(FORCE_STATE):
            dN = part3_of(v, wp.static(DN_AT))
        elif wp.static(FORCE):  # (16)
            dN = cross(N, dphi)
        if wp.static(GIVEN_FORCE or WORLD_STATE):
            if wp.static(WORLD_STATE):
                dn = part3_of(v, wp.static(DWORLD_AT))
            else:
                dn = force_variation(memory, z, g, x)
            dN = plus(dN, rotate_inverse(frame, dn))
        du, dextension = strain_variation(memory, z, a, g, v, dM, dN)
        if wp.static(SHEAR):
            extension = row3(memory, a + wp.static(EXTENSION_AT))
        if wp.static(POSE_COLUMNS or FIXED):  # (19)
            lever = Vec3(dphi.y, -dphi.x, fill(d(0.0)))
            if wp.static(SHEAR):
                lever = plus(lever, plus(cross(dphi, extension), dextension))
            dp_s = rotate(frame, lever)
            if wp.static(POSE_COLUMNS):
                keep3_in(f, wp.static(DP_AT), dp_s)
        if wp.static(FIXED):  # (18b)
            dm_s = cross(row3(memory, a + wp.static(WORLD_FORCE_AT)), dp_s)
            if wp.static(GIVEN_FORCE or WORLD_STATE):
                dm_s = plus(dm_s, cross(dn, row3(memory, a + wp.static(TANGENT_AT))))
            if wp.static(DIRECTIONS and MOMENT_PER_LENGTH):
                dm_s = minus(dm_s, moment_variation(memory, z, g, x))
            if wp.static(MOMENTS):
                dm_s = minus(dm_s, acting_moment_variation(memory, z, a, g, x, frame, v, dphi, dp))
            keep3_in(f, wp.static(DM_AT), dm_s)
        if wp.static(MOMENT and not FIXED):  # (18)
            dM_s = ahead_cross(ahead_cross(couple(dN), dM, u), M, du)
            if wp.static(SHEAR):
                dM_s = ahead_cross(ahead_cross(dM_s, dN, extension), N, dextension)
            keep3_in(f, wp.static(DM_AT), dM_s)
        if wp.static(WORLD_STATE):  # (18e)
            dn_s = scaled(fill(d(-1.0)), acting_force_variation(memory, z, a, g, x, frame, v, dphi, dp))
            if wp.static(FORCE_PER_LENGTH and DIRECTIONS):
                dn_s = minus(dn_s, distributed_force_variation(memory, z, g, x))
            keep3_in(f, wp.static(DWORLD_AT), dn_s)
        if wp.static(FORCE_STATE):
            keep3_in(f, wp.static(DN_AT), ahead_cross(cross(dN, u), N, du))
        own_rate_variations(memory, z, a, g, v, du, f)
        if wp.static(LENGTHS):
            length_variations(memory, a, g, du, dextension, f)
        if wp.static(TURNS):
            acting_torque_variations(memory, a, g, frame, v, dphi, f)
        if wp.static(TWISTED):  # (8l)
            m_s = rotate_inverse(frame, row3(memory, a + wp.static(MOMENT_RATE_AT)))
            dM_s = ahead_cross(ahead_cross(ahead_cross(rotate_inverse(frame, dm_s), m_s, dphi), M, du), dM, u)
            balance_variation(memory, z, dM_s.z, f)
        if wp.static(FRICTION):
            dM_s = part3_of(f, wp.static(DM_AT))
            if wp.static(FIXED):
                m_s = ahead_cross(row3(memory, a + wp.static(MOMENT_RATE)), u, M)  # R^T m'
                dM_s = ahead_cross(ahead_cross(ahead_cross(rotate_inverse(frame, dM_s), m_s, dphi), M, du), dM, u)
            dN_s = zero3()
            if wp.static(SHEAR and FORCE):
                dN_s = ahead_cross(cross(dN, u), N, du)
                if wp.static(WORLD_STATE or (FORCE_PER_LENGTH and not FORCE_STATE)):
                    n_s_body = ahead_cross(row3(memory, a + wp.static(MOMENT_RATE + 3)), u, N)  # R^T n'
                    dN_s = ahead_cross(dN_s, n_s_body, dphi)
                if wp.static(WORLD_STATE):
                    dN_s = plus(dN_s, rotate_inverse(frame, dn_s))
                elif wp.static(FORCE_PER_LENGTH and DIRECTIONS):
                    dN_s = minus(dN_s, rotate_inverse(frame, distributed_force_variation(memory, z, g, x)))
            friction_variations(memory, z, a, g, v, du, dextension, dM_s, dN_s, f)
        if wp.static(COLUMN_FRAME):  # (19)
            half = fill(d(0.5))
            dr_s = ahead_cross(ahead3(ahead3(cross(dr, u), dw, u), frame.w, du), frame.r, du)
            keep3_in(f, wp.static(DQ_AT), scaled(half, dr_s))
            keep_in(f, wp.static(DQ_AT + 3), d(-0.5) * (dot(dr, u) + dot(frame.r, du)))
        if wp.static(DIRECTIONS):  # (20)
            growth = row(memory, g + wp.static(GROWTH))
            for j in range(wp.static(COLUMN_SIZE)):
                keep_in(f, j, part_of(f, j) + growth * row(memory, a + wp.static(RATE_AT + j)))
        return f

    @wp.func
    def carried(memory: memory_type, a: int):
        """Force and moment that all rods carry at a place, along the axes of the base."""
        frame = frame_at(memory, a)
        n = rotate(frame, row3(memory, a + wp.static(FORCE_AT)))
        return n, rotate(frame, row3(memory, a + wp.static(MOMENT_AT)))

    @wp.func
    def carried_variation(memory: memory_type, z: int, a: int, g: int, v: Column):
        """(D25) of docs/derivatives.md: how both vary with a column."""
        dn = zero3()
        dm = zero3()
        if wp.static(WORLD_STATE):
            dn = part3_of(v, wp.static(DWORLD_AT))
        elif wp.static(GIVEN_FORCE):
            dn = force_variation(memory, z, g, row(memory, a + wp.static(X)))
        if wp.static(FIXED):
            dm = part3_of(v, wp.static(DM_AT))
        elif wp.static(MOMENT):
            frame = frame_at(memory, a)
            dphi = body_rotation(frame, part3_of(v, wp.static(DQ_AT)), part_of(v, wp.static(DQ_AT + 3)))
            dm = rotate(frame, ahead_cross(part3_of(v, wp.static(DM_AT)), dphi, row3(memory, a + wp.static(MOMENT_AT))))
        return dn, dm

    along = SimpleNamespace(wrench=carried, variation=carried_variation) if layout.features.along else None
    return SimpleNamespace(
        base_rates=base_rates, column_rates=column_rates, put_own=law.put_own, spring=acting.spring, along=along
    )
