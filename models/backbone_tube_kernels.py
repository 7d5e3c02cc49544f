# mypy: ignore-errors
"""What several concentric rods add to the equations of one: (7), (8) and their variations.

Numbers in parentheses are those of ``docs/model.md``. ``y`` is the state, ``z`` a stretch between two nodes, ``x`` the
arclength from its start, ``a`` what is known of the backbone there. With one rod nothing of these functions is compiled in.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_equation_kernels import make_equation_functions
from multirod.models.backbone_layout_kernels import Layout
from multirod.models.features import Features


def make_point_types(layout: Layout) -> SimpleNamespace:
    """What is known of one place before the rates are."""
    real, vec3, vec4 = layout.real, layout.vec3, layout.vec4
    Tubes = wp.types.matrix(shape=(layout.n, 9), dtype=real)  # columns: see turned_tube
    RodVectors = layout.RodVectors

    @wp.struct
    class Point:
        """The backbone at one place, in the frame of rod 1."""

        q: vec4
        M: vec3
        N: vec3
        u: vec3
        u_star: vec3  # of rod 1
        extension: vec3  # v - e3
        moment_load: vec3  # R^T l
        tubes: Tubes
        flexibility: vec3  # xx, xy, yy of (sum K_i)^-1

    @wp.struct
    class Given:
        """What a direction in input space imposes on a column at one place; zero for an unknown."""

        force: vec3  # R^T dn
        moment_load: vec3  # R^T dl
        u_star: RodVectors  # du*_i, turned into the frame of rod 1

    return SimpleNamespace(Tubes=Tubes, Point=Point, Given=Given)


def make_tube_functions(layout: Layout, features: Features, types: SimpleNamespace, stretch: SimpleNamespace) -> SimpleNamespace:
    """Equations (7) and (8) of several rods, and their variations."""
    n, real, vec3 = layout.n, layout.real, layout.vec3
    State, Column, Stretch = layout.State, layout.Column, layout.Stretch
    Tubes, Point, Given = types.Tubes, types.Point, types.Given
    THETA_AT, TAU_AT, TORQUES, MOMENT = layout.THETA_AT, layout.TAU_AT, layout.TORQUES, layout.MOMENT
    ANISOTROPIC = features.anisotropic
    VARIED_GIVEN = layout.ND > 0 and layout.CURVATURE_TERMS > 1
    precurvature = stretch.precurvature
    cosine_and_sine = make_equation_functions(real).cosine_and_sine
    TubeRow = wp.types.vector(length=9, dtype=real)

    @wp.func
    def turned_tube(z: Stretch, i: int, x: real, theta: real) -> TubeRow:
        """(7) What rod i brings in where it is turned by theta; nothing where it has ended.

        ``K_i`` as xx, xy, yy; ``b_i = K_i Rz(theta) u*_i``, and its derivative by theta at constant u; cos and sin of theta.
        Unequal bending stiffness changes places 3 to 6 later, ``with_turned_stiffness``.
        """
        c = real(1.0)
        s = real(0.0)
        if wp.static(n > 1):
            if i > 0:  # rod 1 is not turned
                c, s = cosine_and_sine(theta)
        u_star = precurvature(z, i, x)
        bx = c * u_star[0] - s * u_star[1]
        by = s * u_star[0] + c * u_star[1]
        row = TubeRow()
        row[0] = z.bending[i]
        row[2] = z.bending[i]
        if wp.static(ANISOTROPIC):
            EI_y = z.present[i] * z.material[i, 1]
            row[0] = z.bending[i] * c * c + EI_y * s * s
            row[1] = (z.bending[i] - EI_y) * s * c
            row[2] = z.bending[i] * s * s + EI_y * c * c
            row[3] = row[0] * bx + row[1] * by
            row[4] = row[1] * bx + row[2] * by
        else:
            row[3] = z.bending[i] * bx
            row[4] = z.bending[i] * by
        row[5] = -row[4]
        row[6] = row[3]
        row[7] = c
        row[8] = s
        return row

    @wp.func
    def turned_tubes(y: State, z: Stretch, x: real) -> Tubes:
        """(7) The rows of all rods."""
        tubes = Tubes()
        for i in range(wp.static(n)):
            theta = real(0.0)
            if wp.static(i > 0):
                theta = y[wp.static(THETA_AT) + i - 1]
            row = turned_tube(z, i, x, theta)
            for j in range(9):
                tubes[i, j] = row[j]
        return tubes

    @wp.func
    def flexibility(z: Stretch, tubes: Tubes) -> vec3:
        """(7) (sum K_i)^-1 as xx, xy, yy."""
        if wp.static(not ANISOTROPIC):
            return vec3(z.softness, real(0.0), z.softness)
        xx = real(0.0)
        xy = real(0.0)
        yy = real(0.0)
        for i in range(wp.static(n)):
            xx += tubes[i, 0]
            xy += tubes[i, 1]
            yy += tubes[i, 2]
        return vec3(yy, -xy, xx) / (xx * yy - xy * xy)

    @wp.func
    def bent_by(a: Point, gx: real, gy: real, u_z: real) -> vec3:
        """(7) u or its variation: (sum K_i)^-1 (gx, gy), and u_z."""
        if wp.static(ANISOTROPIC):
            return vec3(a.flexibility[0] * gx + a.flexibility[1] * gy, a.flexibility[1] * gx + a.flexibility[2] * gy, u_z)
        return vec3(a.flexibility[0] * gx, a.flexibility[0] * gy, u_z)

    @wp.func
    def inner_torque(y: State, z: Stretch, M_z: real) -> real:
        """(7) tau_1: what the other rods leave of M_z."""
        tau = M_z
        for i in range(1, wp.static(TORQUES + 1)):
            tau -= z.present[i] * y[wp.static(TAU_AT) + i - 1]
        return tau

    @wp.func
    def shared_curvature(y: State, z: Stretch, a: Point) -> vec3:
        """(7) u of the backbone."""
        gx = a.M[0]
        gy = a.M[1]
        for i in range(wp.static(n)):
            gx += a.tubes[i, 3]
            gy += a.tubes[i, 4]
        return bent_by(a, gx, gy, z.present[0] * a.u_star[2] + z.torsion[0] * inner_torque(y, z, a.M[2]))

    @wp.func
    def with_turned_stiffness(a: Point) -> Tubes:
        """(8) The rows with ``b_i - K_i u`` and its derivative by theta at constant u in places 3 to 6.

        Equal bending stiffness needs neither: ``K_i u`` is then parallel to u, which drops out of (8), and does not turn.
        """
        tubes = a.tubes
        if wp.static(ANISOTROPIC):
            for i in range(wp.static(n)):
                cx = tubes[i, 3] - tubes[i, 0] * a.u[0] - tubes[i, 1] * a.u[1]
                cy = tubes[i, 4] - tubes[i, 1] * a.u[0] - tubes[i, 2] * a.u[1]
                tubes[i, 3] = cx
                tubes[i, 4] = cy
                tubes[i, 5] = -cy - tubes[i, 0] * a.u[1] + tubes[i, 1] * a.u[0]
                tubes[i, 6] = cx - tubes[i, 1] * a.u[1] + tubes[i, 2] * a.u[0]
        return tubes

    @wp.func
    def angle_rate(y: State, z: Stretch, x: real, a: Point, i: int) -> real:
        """(8) theta_i'; zero where the rod has ended."""
        u_star = precurvature(z, i, x)
        rate = z.present[i] * (u_star[2] - a.u[2])
        if wp.static(TORQUES > 0):
            rate += z.torsion[i] * y[wp.static(TAU_AT) + i - 1]
        return rate

    @wp.func
    def torque_rate(a: Point, i: int) -> real:
        """(8) tau_i'; zero where the rod has ended."""
        return a.u[0] * a.tubes[i, 4] - a.u[1] * a.tubes[i, 3]

    @wp.func
    def tube_energy(y: State, z: Stretch, x: real, a: Point) -> real:
        """(14) Twice the energy per length of all rods, shear and extension aside."""
        tau = inner_torque(y, z, a.M[2])
        energy = z.torsion[0] * tau * tau
        for i in range(wp.static(n)):
            u_star = turn_into_rod_1(a, i, precurvature(z, i, x))
            ex = a.u[0] - u_star[0]
            ey = a.u[1] - u_star[1]
            energy += ex * (a.tubes[i, 0] * ex + a.tubes[i, 1] * ey) + ey * (a.tubes[i, 1] * ex + a.tubes[i, 2] * ey)
        for i in range(1, wp.static(TORQUES + 1)):
            tau_i = y[wp.static(TAU_AT) + i - 1]
            energy += z.torsion[i] * tau_i * tau_i
        return energy

    @wp.func
    def turn_into_rod_1(a: Point, i: int, b: vec3) -> vec3:
        """Rz(theta_i) b."""
        c = a.tubes[i, 7]
        s = a.tubes[i, 8]
        return vec3(c * b[0] - s * b[1], s * b[0] + c * b[1], b[2])

    @wp.func
    def shared_curvature_variation(z: Stretch, a: Point, column: Column, given: Given) -> vec3:
        """(17) Variation of (7)."""
        gx = real(0.0)
        gy = real(0.0)
        dtau_1 = real(0.0)
        du_z = real(0.0)
        if wp.static(MOMENT):
            gx = column[0]
            gy = column[1]
            dtau_1 = column[2]
        for i in range(1, wp.static(n)):
            dtheta = column[wp.static(THETA_AT) + i - 1]
            gx += a.tubes[i, 5] * dtheta
            gy += a.tubes[i, 6] * dtheta
        for i in range(1, wp.static(TORQUES + 1)):
            dtau_1 -= z.present[i] * column[wp.static(TAU_AT) + i - 1]
        if wp.static(VARIED_GIVEN):
            du_z = z.present[0] * given.u_star[0, 2]
            for i in range(wp.static(n)):
                gx += a.tubes[i, 0] * given.u_star[i, 0] + a.tubes[i, 1] * given.u_star[i, 1]
                gy += a.tubes[i, 1] * given.u_star[i, 0] + a.tubes[i, 2] * given.u_star[i, 1]
        if wp.static(TORQUES > 0):
            du_z += z.torsion[0] * dtau_1
        return bent_by(a, gx, gy, du_z)

    @wp.func
    def angle_rate_variation(z: Stretch, column: Column, du: vec3, given: Given, i: int) -> real:
        """Variation of (8), theta_i'."""
        rate = -z.present[i] * du[2]
        if wp.static(TORQUES > 0):
            rate += z.torsion[i] * column[wp.static(TAU_AT) + i - 1]
        if wp.static(VARIED_GIVEN):
            rate += z.present[i] * given.u_star[i, 2]
        return rate

    @wp.func
    def torque_rate_variation(a: Point, column: Column, du: vec3, given: Given, i: int) -> real:
        """Variation of (8), tau_i'."""
        dtheta = column[wp.static(THETA_AT) + i - 1]
        gx = a.tubes[i, 5] * dtheta
        gy = a.tubes[i, 6] * dtheta
        if wp.static(VARIED_GIVEN):
            gx += a.tubes[i, 0] * given.u_star[i, 0] + a.tubes[i, 1] * given.u_star[i, 1]
            gy += a.tubes[i, 1] * given.u_star[i, 0] + a.tubes[i, 2] * given.u_star[i, 1]
        if wp.static(ANISOTROPIC):
            gx -= a.tubes[i, 0] * du[0] + a.tubes[i, 1] * du[1]
            gy -= a.tubes[i, 1] * du[0] + a.tubes[i, 2] * du[1]
        return du[0] * a.tubes[i, 4] - du[1] * a.tubes[i, 3] + a.u[0] * gy - a.u[1] * gx

    return SimpleNamespace(
        turned_tubes=turned_tubes,
        flexibility=flexibility,
        inner_torque=inner_torque,
        shared_curvature=shared_curvature,
        with_turned_stiffness=with_turned_stiffness,
        angle_rate=angle_rate,
        torque_rate=torque_rate,
        tube_energy=tube_energy,
        turn_into_rod_1=turn_into_rod_1,
        shared_curvature_variation=shared_curvature_variation,
        angle_rate_variation=angle_rate_variation,
        torque_rate_variation=torque_rate_variation,
    )
