# mypy: ignore-errors
"""What several concentric rods add to the equations of one: (7), (8) and their variations.

Numbers in parentheses are those of ``docs/model.md``. ``y`` is the state, ``z`` a stretch between two nodes, ``x`` the
arclength from its start, ``a`` what is known of the backbone there. With one rod nothing of these functions is compiled in.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_layout_kernels import Layout
from multirod.models.features import Features

f64 = wp.float64


def make_point_types(layout: Layout) -> SimpleNamespace:
    """What is known of one place before the rates are."""
    Tubes = wp.types.matrix(shape=(layout.n, 9), dtype=f64)  # columns: see turned_tube
    RodVectors = layout.RodVectors

    @wp.struct
    class Point:
        """The backbone at one place, in the frame of rod 1."""

        q: wp.vec4d
        M: wp.vec3d
        N: wp.vec3d
        u: wp.vec3d
        u_star: wp.vec3d  # of rod 1
        extension: wp.vec3d  # v - e3
        moment_load: wp.vec3d  # R^T l
        tubes: Tubes
        flexibility: wp.vec3d  # xx, xy, yy of (sum K_i)^-1

    @wp.struct
    class Given:
        """What a direction in input space imposes on a column at one place; zero for an unknown."""

        force: wp.vec3d  # R^T dn
        moment_load: wp.vec3d  # R^T dl
        u_star: RodVectors  # du*_i, turned into the frame of rod 1

    return SimpleNamespace(Tubes=Tubes, Point=Point, Given=Given)


def make_tube_functions(layout: Layout, features: Features, types: SimpleNamespace, stretch: SimpleNamespace) -> SimpleNamespace:
    """Equations (7) and (8) of several rods, and their variations."""
    n = layout.n
    State, Column, Stretch = layout.State, layout.Column, layout.Stretch
    Tubes, Point, Given = types.Tubes, types.Point, types.Given
    THETA_AT, TAU_AT = layout.THETA_AT, layout.TAU_AT
    ANISOTROPIC = features.anisotropic
    VARIED_GIVEN = layout.ND > 0 and layout.CURVATURE_TERMS > 1
    precurvature = stretch.precurvature
    TubeRow = wp.types.vector(length=9, dtype=f64)

    @wp.func
    def turned_tube(z: Stretch, i: int, x: f64, theta: f64) -> TubeRow:
        """(7) K_i(theta) as xx, xy, yy, zero where the rod has ended; Rz(theta) u*_i; cos and sin of theta; two places left."""
        c = wp.cos(theta)
        s = wp.sin(theta)
        EI_x = z.material[i, 0]
        EI_y = z.material[i, 1]
        u_star = precurvature(z, i, x)
        row = TubeRow()
        row[0] = z.present[i] * EI_x
        row[2] = z.present[i] * EI_x
        if wp.static(ANISOTROPIC):
            row[0] = z.present[i] * (EI_x * c * c + EI_y * s * s)
            row[1] = z.present[i] * ((EI_x - EI_y) * s * c)
            row[2] = z.present[i] * (EI_x * s * s + EI_y * c * c)
        row[3] = c * u_star[0] - s * u_star[1]
        row[4] = s * u_star[0] + c * u_star[1]
        row[5] = c
        row[6] = s
        return row

    @wp.func
    def turned_tubes(y: State, z: Stretch, x: f64) -> Tubes:
        """(7) The rows of all rods; rod 1 is not turned."""
        tubes = Tubes()
        for i in range(wp.static(n)):
            theta = f64(0.0)
            if wp.static(i > 0):
                theta = y[wp.static(THETA_AT) + i - 1]
            row = turned_tube(z, i, x, theta)
            for j in range(7):
                tubes[i, j] = row[j]
        return tubes

    @wp.func
    def flexibility(tubes: Tubes) -> wp.vec3d:
        """(7) (sum K_i)^-1 as xx, xy, yy."""
        xx = f64(0.0)
        xy = f64(0.0)
        yy = f64(0.0)
        for i in range(wp.static(n)):
            xx += tubes[i, 0]
            xy += tubes[i, 1]
            yy += tubes[i, 2]
        return wp.vec3d(yy, -xy, xx) / (xx * yy - xy * xy)

    @wp.func
    def inner_torque(y: State, z: Stretch) -> f64:
        """(7) tau_1: what the other rods leave of M_z."""
        tau = y[2]
        for i in range(1, wp.static(n)):
            tau -= z.present[i] * y[wp.static(TAU_AT) + i - 1]
        return tau

    @wp.func
    def shared_curvature(y: State, z: Stretch, a: Point) -> wp.vec3d:
        """(7) u of the backbone."""
        bx = a.M[0]
        by = a.M[1]
        for i in range(wp.static(n)):
            bx += a.tubes[i, 0] * a.tubes[i, 3] + a.tubes[i, 1] * a.tubes[i, 4]
            by += a.tubes[i, 1] * a.tubes[i, 3] + a.tubes[i, 2] * a.tubes[i, 4]
        return wp.vec3d(
            a.flexibility[0] * bx + a.flexibility[1] * by,
            a.flexibility[1] * bx + a.flexibility[2] * by,
            z.present[0] * (a.u_star[2] + z.material[0, 5] * inner_torque(y, z)),
        )

    @wp.func
    def with_moments(a: Point) -> Tubes:
        """(7) The rows with m_i,x and m_i,y in their last two places."""
        tubes = a.tubes
        for i in range(wp.static(n)):
            ex = a.u[0] - tubes[i, 3]
            ey = a.u[1] - tubes[i, 4]
            tubes[i, 7] = tubes[i, 0] * ex + tubes[i, 1] * ey
            tubes[i, 8] = tubes[i, 1] * ex + tubes[i, 2] * ey
        return tubes

    @wp.func
    def tube_rate(y: State, z: Stretch, x: f64, a: Point, i: int) -> wp.vec2d:
        """(8) theta_i' and tau_i'; zero where the rod has ended."""
        u_star = precurvature(z, i, x)
        twist = u_star[2] + z.material[i, 5] * y[wp.static(TAU_AT) + i - 1] - a.u[2]
        return wp.vec2d(z.present[i] * twist, a.u[1] * a.tubes[i, 7] - a.u[0] * a.tubes[i, 8])

    @wp.func
    def tube_energy(y: State, z: Stretch, a: Point) -> f64:
        """(14) Twice the energy per length of all rods, shear and extension aside."""
        tau = inner_torque(y, z)
        energy = z.present[0] * z.material[0, 5] * tau * tau
        for i in range(wp.static(n)):
            energy += a.tubes[i, 7] * (a.u[0] - a.tubes[i, 3]) + a.tubes[i, 8] * (a.u[1] - a.tubes[i, 4])
            if wp.static(i > 0):
                tau_i = y[wp.static(TAU_AT) + i - 1]
                energy += z.present[i] * z.material[i, 5] * tau_i * tau_i
        return energy

    @wp.func
    def turn_into_rod_1(a: Point, i: int, b: wp.vec3d) -> wp.vec3d:
        """Rz(theta_i) b."""
        c = a.tubes[i, 5]
        s = a.tubes[i, 6]
        return wp.vec3d(c * b[0] - s * b[1], s * b[0] + c * b[1], b[2])

    @wp.func
    def moment_by_angle(a: Point, i: int) -> wp.vec2d:
        """d(m_i,xy)/d(theta_i) at constant u."""
        return wp.vec2d(
            -a.tubes[i, 8] + a.tubes[i, 0] * a.u[1] - a.tubes[i, 1] * a.u[0],
            a.tubes[i, 7] + a.tubes[i, 1] * a.u[1] - a.tubes[i, 2] * a.u[0],
        )

    @wp.func
    def shared_curvature_variation(z: Stretch, a: Point, column: Column, given: Given) -> wp.vec3d:
        """(17) Variation of (7)."""
        gx = column[0]
        gy = column[1]
        dtau_1 = column[2]
        du_z = f64(0.0)
        for i in range(1, wp.static(n)):
            slope = moment_by_angle(a, i)
            dtheta = column[wp.static(THETA_AT) + i - 1]
            gx -= slope[0] * dtheta
            gy -= slope[1] * dtheta
            dtau_1 -= z.present[i] * column[wp.static(TAU_AT) + i - 1]
        if wp.static(VARIED_GIVEN):
            du_z = given.u_star[0, 2]
            for i in range(wp.static(n)):
                gx += a.tubes[i, 0] * given.u_star[i, 0] + a.tubes[i, 1] * given.u_star[i, 1]
                gy += a.tubes[i, 1] * given.u_star[i, 0] + a.tubes[i, 2] * given.u_star[i, 1]
        return wp.vec3d(
            a.flexibility[0] * gx + a.flexibility[1] * gy,
            a.flexibility[1] * gx + a.flexibility[2] * gy,
            z.present[0] * (du_z + z.material[0, 5] * dtau_1),
        )

    @wp.func
    def tube_rate_variation(z: Stretch, a: Point, column: Column, du: wp.vec3d, given: Given, i: int) -> wp.vec2d:
        """Variation of (8)."""
        slope = moment_by_angle(a, i)
        dtheta = column[wp.static(THETA_AT) + i - 1]
        ex = du[0] - given.u_star[i, 0]
        ey = du[1] - given.u_star[i, 1]
        dmx = a.tubes[i, 0] * ex + a.tubes[i, 1] * ey + slope[0] * dtheta
        dmy = a.tubes[i, 1] * ex + a.tubes[i, 2] * ey + slope[1] * dtheta
        dtwist = given.u_star[i, 2] + z.material[i, 5] * column[wp.static(TAU_AT) + i - 1] - du[2]
        return wp.vec2d(z.present[i] * dtwist, du[1] * a.tubes[i, 7] + a.u[1] * dmx - du[0] * a.tubes[i, 8] - a.u[0] * dmy)

    return SimpleNamespace(
        turned_tubes=turned_tubes,
        flexibility=flexibility,
        shared_curvature=shared_curvature,
        with_moments=with_moments,
        inner_torque=inner_torque,
        tube_rate=tube_rate,
        tube_energy=tube_energy,
        turn_into_rod_1=turn_into_rod_1,
        shared_curvature_variation=shared_curvature_variation,
        tube_rate_variation=tube_rate_variation,
    )
