# mypy: ignore-errors
"""What lies between a backbone's walk from node to node, in double precision, and its steps, in that of the integrator.

A stretch begins and ends in SI units and double precision. Single precision ends at 1e38 and 1e-38, which stiffnesses of very
thin rods leave: its steps are taken in natural units, the rod's length and its bending stiffness, and each column over its own
size. Back and forth between two stretches, nothing is lost: what was single precision rounds to itself.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_fixed_kernels import make_scene_rates
from multirod.models.backbone_layout_kernels import FAULT_NONE, Call, Layout
from multirod.models.backbone_step_kernels import make_step_functions
from multirod.models.backbone_stretch_kernels import make_stretch_functions
from multirod.models.features import Features
from multirod.models.integrators import Tableau

f64 = wp.float64


def make_walk_functions(layout: Layout, features: Features, tableau: Tableau, rates, real) -> SimpleNamespace:
    """Functions that carry a state over a stretch, both of ``layout``, whose ``rates`` are given, by steps in ``real``."""
    Instance, State, Stretch = layout.Instance, layout.State, layout.Stretch
    ADAPTIVE = len(tableau.error) > 0
    if real is layout.real:
        step = make_step_functions(layout, tableau, rates)
    else:
        step = make_converted_steps(layout, features, tableau, real)
    fixed_steps, adaptive_steps = step.fixed_steps, step.adaptive_steps

    @wp.func
    def share_of_steps(z: Stretch, case: Instance, call: Call) -> int:
        """Share of the equal steps of the whole length, rounded up to a multiple (see ``step_multiple``)."""
        share = call.steps / call.step_multiple * (z.length / case.length)
        return wp.max(int(1), int(wp.ceil(share - f64(1.0e-9)))) * int(call.step_multiple)

    @wp.func
    def over_stretch(y: State, z: Stretch, h: f64, used: int, case: Instance, call: Call):
        """State at the end of the stretch, next step, steps used in all, fault."""
        if call.steps > f64(0.0):
            count = share_of_steps(z, case, call)
            return fixed_steps(y, z, count, case.scale), h, used + count, wp.static(FAULT_NONE)
        if wp.static(ADAPTIVE):
            return adaptive_steps(y, z, h, used, case.scale, case.length, call)
        return y, h, used, wp.static(FAULT_NONE)

    return SimpleNamespace(over_stretch=over_stretch, fixed_steps=fixed_steps)


def make_converted_steps(layout: Layout, features: Features, tableau: Tableau, real) -> SimpleNamespace:
    """The step functions of ``layout``, by steps in ``real``."""
    own = Layout(features, real)
    step = make_step_functions(own, tableau, make_scene_rates(own, features, make_stretch_functions(own)).rates)
    own_fixed_steps, own_adaptive_steps = step.fixed_steps, step.adaptive_steps
    State, Stretch, OwnState, OwnStretch = layout.State, layout.Stretch, own.State, own.Stretch
    own_vec3 = own.vec3
    n, C, NX, ND = layout.n, layout.C, layout.NX, layout.ND
    N_AT, THETA_AT, TAU_AT, STATICS = layout.N_AT, layout.THETA_AT, layout.TAU_AT, layout.STATICS
    COLUMN_SIZE, COLUMN_P_AT, Q_AT, P_AT, END = (
        layout.COLUMN_SIZE,
        layout.COLUMN_P_AT,
        layout.Q_AT,
        layout.P_AT,
        layout.ENERGY_AT,
    )
    CURVATURE_TERMS, PROFILE_TERMS = layout.CURVATURE_TERMS, layout.PROFILE_TERMS
    Rows = wp.types.vector(length=COLUMN_SIZE, dtype=f64)
    PerColumn = wp.types.vector(length=max(C, 1), dtype=f64)

    @wp.struct
    class Units:
        """What counts as one, and what a column is counted in."""

        length: f64  # [m]
        moment: f64  # [N m]
        force: f64  # [N]
        stiffness: f64  # [N m^2]
        rows: Rows  # of a column
        columns: PerColumn

    @wp.func
    def magnitude(a: wp.vec3d) -> f64:
        return wp.max(wp.abs(a[0]), wp.max(wp.abs(a[1]), wp.abs(a[2])))

    @wp.func
    def given_size(z: Stretch, u: Units, c: int) -> f64:
        """Size of what stands in a column's rates beside the column."""
        dn = wp.vec3d(z.force_columns[c, 0], z.force_columns[c, 1], z.force_columns[c, 2])
        size = magnitude(dn) / u.force
        if wp.static(ND > 0):
            k = c - wp.static(NX)
            if k >= 0:
                df = wp.vec3d(z.distributed_force_rate[k, 0], z.distributed_force_rate[k, 1], z.distributed_force_rate[k, 2])
                dl = wp.vec3d(z.distributed_moment_rate[k, 0], z.distributed_moment_rate[k, 1], z.distributed_moment_rate[k, 2])
                size = wp.max(size, wp.max(magnitude(df) * u.length / u.force, magnitude(dl) / u.force))
                size = wp.max(size, wp.abs(z.profile_rate[k]))
                size = wp.max(size, wp.max(wp.abs(z.start_rate[k]), wp.abs(z.end_rate[k])) / u.length)
                for i in range(wp.static(n)):
                    size = wp.max(size, wp.abs(z.shift_rate[k, i]) / u.length)
        return size

    @wp.func
    def natural_units(y: State, z: Stretch, scale: f64) -> Units:
        u = Units()
        u.length = scale
        for i in range(wp.static(n)):
            u.stiffness += z.present[i] * wp.max(z.material[i, 0], z.material[i, 1])
        u.moment = u.stiffness / scale
        u.force = u.moment / scale
        for j in range(wp.static(COLUMN_SIZE)):
            u.rows[j] = f64(1.0)
        for j in range(wp.static(N_AT)):
            u.rows[j] = u.moment
        for j in range(wp.static(N_AT), wp.static(THETA_AT)):
            u.rows[j] = u.force
        for j in range(wp.static(TAU_AT), wp.static(STATICS)):
            u.rows[j] = u.moment
        for j in range(wp.static(COLUMN_P_AT), wp.static(COLUMN_SIZE)):
            u.rows[j] = u.length
        for c in range(wp.static(C)):
            size = given_size(z, u, c)
            for j in range(wp.static(COLUMN_SIZE)):
                size = wp.max(size, wp.abs(y[wp.static(STATICS) + c * wp.static(COLUMN_SIZE) + j]) / u.rows[j])
            u.columns[c] = wp.where(size > f64(0.0), size, f64(1.0))
        return u

    @wp.func
    def narrowed_state(y: State, u: Units) -> OwnState:
        out = OwnState()
        for j in range(wp.static(STATICS)):
            out[j] = real(y[j] / u.rows[j])
        for c in range(wp.static(C)):
            for j in range(wp.static(COLUMN_SIZE)):
                k = wp.static(STATICS) + c * wp.static(COLUMN_SIZE) + j
                out[k] = real(y[k] / (u.rows[j] * u.columns[c]))
        for j in range(wp.static(Q_AT), wp.static(P_AT)):
            out[j] = real(y[j])
        for j in range(wp.static(P_AT), wp.static(END)):
            out[j] = real(y[j] / u.length)
        return out

    @wp.func
    def widened_state(y: OwnState, u: Units) -> State:
        out = State()
        for j in range(wp.static(STATICS)):
            out[j] = f64(y[j]) * u.rows[j]
        for c in range(wp.static(C)):
            for j in range(wp.static(COLUMN_SIZE)):
                k = wp.static(STATICS) + c * wp.static(COLUMN_SIZE) + j
                out[k] = f64(y[k]) * (u.rows[j] * u.columns[c])
        for j in range(wp.static(Q_AT), wp.static(P_AT)):
            out[j] = f64(y[j])
        for j in range(wp.static(P_AT), wp.static(END)):
            out[j] = f64(y[j]) * u.length
        return out

    @wp.func
    def narrowed(a: wp.vec3d, unit: f64) -> own_vec3:
        return own_vec3(real(a[0] / unit), real(a[1] / unit), real(a[2] / unit))

    @wp.func
    def narrowed_stretch(z: Stretch, u: Units) -> OwnStretch:
        """Arclengths are counted from its start, which keeps their differences."""
        out = OwnStretch()
        out.length = real(z.length / u.length)
        out.softness = real(z.softness * u.stiffness)
        shear = u.stiffness / (u.length * u.length)
        for i in range(wp.static(n)):
            out.present[i] = real(z.present[i])
            out.bending[i] = real(z.bending[i] / u.stiffness)
            out.torsion[i] = real(z.torsion[i] * u.stiffness)
            for j in range(3):
                out.material[i, j] = real(z.material[i, j] / u.stiffness)
                out.material[i, 3 + j] = real(z.material[i, 3 + j] * u.stiffness)
                out.material[i, 6 + j] = real(z.material[i, 6 + j] * shear)
            for j in range(wp.static(3 * CURVATURE_TERMS)):
                out.precurvature[i, j] = real(z.precurvature[i, j] * u.length)
            out.section_centre[i] = real((z.section_centre[i] - z.start) / u.length)
            out.section_slope[i] = real(z.section_slope[i] * u.length)
        out.force = narrowed(z.force, u.force)
        out.distributed_force = narrowed(z.distributed_force, u.force / u.length)
        out.distributed_moment = narrowed(z.distributed_moment, u.force)
        for j in range(wp.static(PROFILE_TERMS)):
            for k in range(3):
                out.profile[k, j] = real(z.profile[k, j] * u.length / u.force)
                out.profile[3 + k, j] = real(z.profile[3 + k, j] / u.force)
        out.profile_centre = real((z.profile_centre - z.start) / u.length)
        out.profile_slope = real(z.profile_slope * u.length)
        for c in range(wp.static(C)):
            for j in range(3):
                out.force_columns[c, j] = real(z.force_columns[c, j] / (u.force * u.columns[c]))
        for k in range(wp.static(ND)):
            w = u.columns[wp.static(NX) + k]
            for j in range(3):
                out.distributed_force_rate[k, j] = real(z.distributed_force_rate[k, j] * u.length / (u.force * w))
                out.distributed_moment_rate[k, j] = real(z.distributed_moment_rate[k, j] / (u.force * w))
            out.profile_rate[k] = real(z.profile_rate[k] / w)
            out.start_rate[k] = real(z.start_rate[k] / (u.length * w))
            out.end_rate[k] = real(z.end_rate[k] / (u.length * w))
            for i in range(wp.static(n)):
                out.shift_rate[k, i] = real(z.shift_rate[k, i] / (u.length * w))
        return out

    @wp.func
    def fixed_steps(y: State, z: Stretch, count: int, scale: f64) -> State:
        """As the steps' own."""
        u = natural_units(y, z, scale)
        return widened_state(own_fixed_steps(narrowed_state(y, u), narrowed_stretch(z, u), count, real(1.0)), u)

    @wp.func
    def adaptive_steps(y: State, z: Stretch, h: f64, used: int, scale: f64, length: f64, call: Call):
        """As the steps' own; the next step is in natural units."""
        u = natural_units(y, z, scale)
        end, next_h, steps, fault = own_adaptive_steps(
            narrowed_state(y, u), narrowed_stretch(z, u), real(h), used, real(1.0), real(length / scale), call
        )
        return widened_state(end, u), f64(next_h), steps, fault

    return SimpleNamespace(fixed_steps=fixed_steps, adaptive_steps=adaptive_steps if len(tableau.error) > 0 else None)
