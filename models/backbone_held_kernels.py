# mypy: ignore-errors
"""The tip of a backbone that something else holds: its wrench, and the torques of the rods that end before it, (22).

What holds the tip (``parallel_kernels``) turns pose and wrench into residuals. Numbers in parentheses are those of
``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_equation_kernels import make_equation_functions
from multirod.models.backbone_layout_kernels import Call, Layout, RodTable
from multirod.models.features import Features

f64 = wp.float64


def make_held_functions(layout: Layout, features: Features, rate: SimpleNamespace, tip: SimpleNamespace) -> SimpleNamespace:
    """Functions that write what acts on a held tip; the rod that ends there is the one that is held."""
    n, C = layout.n, layout.C
    State, Stretch, Instance, ColumnVectors = layout.State, layout.Stretch, layout.Instance, layout.ColumnVectors
    TAU_AT, STATICS, COLUMN_SIZE = layout.TAU_AT, layout.STATICS, layout.COLUMN_SIZE
    frame, column_of, column_rotation = rate.frame, rate.column_of, rate.column_rotation
    outer_torque, torque_unit, write_column = tip.outer_torque, tip.torque_unit, tip.write_column
    rotate = make_equation_functions(layout.real).rotate
    POSE_ROWS = 6  # of the residual, before the torques

    @wp.func
    def free_torque(rods: RodTable, case: Instance, y: State, i: int, first: int) -> f64:
        """Torque, or its variation, of a rod that ends before the tip; ``first`` is where M_x, tau_2 of it stand in y."""
        if i == 0:
            return y[first + 2] - outer_torque(rods, case, y, first + wp.static(TAU_AT))
        return y[first + wp.static(TAU_AT) + i - 1]

    @wp.func
    def free_row(case: Instance, i: int) -> int:
        """Residual of the torque of rod i, which is not the one that is held."""
        row = wp.static(POSE_ROWS) + i
        if i > case.longest:
            row -= 1
        return row

    @wp.func
    def write_vectors(values: wp.array2d[wp.float64], t: int, n_tip: wp.vec3d, m_tip: wp.vec3d) -> f64:
        total = f64(0.0)
        for j in range(3):
            values[t, j] = n_tip[j]
            values[t, 3 + j] = m_tip[j]
            total += wp.abs(n_tip[j]) + wp.abs(m_tip[j])
        return total

    @wp.func
    def write_end(
        rods: RodTable, call: Call, case: Instance, y: State, z: Stretch, n_tip: wp.vec3d, dn_tip: ColumnVectors
    ) -> f64:
        """(22) Wrench and free torques, and their columns. Returns a number that is not finite if one of them is not."""
        t = case.index
        q = frame(y)
        M = wp.vec3d(y[0], y[1], y[2])
        total = write_vectors(call.tip_wrench, t, case.base_rotation * n_tip, case.base_rotation * rotate(q, M))
        for i in range(wp.static(n)):
            if wp.static(n > 1):
                if i != case.longest:
                    call.residual[t, free_row(case, i)] = torque_unit(z, i) * free_torque(rods, case, y, i, 0)
        for k in range(wp.static(C)):
            column = column_of(y, k)
            dM = wp.vec3d(column[0], column[1], column[2]) + wp.cross(column_rotation(q, column), M)
            dm = case.base_rotation * rotate(q, dM)
            dn = case.base_rotation * wp.vec3d(dn_tip[k, 0], dn_tip[k, 1], dn_tip[k, 2])
            for j in range(3):
                call.wrench_columns[t, j, k] = dn[j]
                call.wrench_columns[t, 3 + j, k] = dm[j]
                total += wp.abs(dm[j])
            for i in range(wp.static(n)):
                if wp.static(n > 1):
                    if i != case.longest:
                        torque = free_torque(rods, case, y, i, wp.static(STATICS) + k * wp.static(COLUMN_SIZE))
                        write_column(call, case, free_row(case, i), k, torque_unit(z, i) * torque)
        return total

    return SimpleNamespace(write_end=write_end, free_torque=free_torque)
