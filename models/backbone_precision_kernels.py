# mypy: ignore-errors
"""What lies between a backbone's walk from node to node, in double precision, and its steps, in that of the integrator.

A stretch begins and ends in SI units and double precision. Single precision ends at 1e38 and 1e-38, which stiffnesses of very
thin rods leave: its steps are taken in natural units, the rod's length and its bending stiffness, and each column over its own
size. Back and forth between two stretches, nothing is lost: what was single precision rounds to itself.
"""

import hashlib
import linecache
from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_fixed_kernels import make_scene_rates
from multirod.models.backbone_layout_kernels import FAULT_NONE, Call, Layout
from multirod.models.backbone_step_kernels import make_step_functions
from multirod.models.backbone_stretch_kernels import make_stretch_functions
from multirod.models.features import Features
from multirod.models.integrators import Tableau

f64 = wp.float64

# An entry {a} of each field of a stretch in natural units; i and j are its row and column. Arclengths are counted from the start
# of the stretch, which keeps their differences.
IN_NATURAL_UNITS = {
    "start": "{a} - z.start",
    "length": "{a} / u.length",
    "present": "{a}",
    "bending": "{a} / u.stiffness",
    "softness": "{a} * u.stiffness",
    "torsion": "{a} * u.stiffness",
    "material": "natural_material({a}, j, u)",
    "precurvature": "{a} * u.length",
    "section_centre": "({a} - z.start) / u.length",
    "section_slope": "{a} * u.length",
    "force": "{a} / u.force",
    "distributed_force": "{a} * u.length / u.force",
    "distributed_moment": "{a} / u.force",
    "profile": "natural_profile({a}, i, u)",
    "profile_centre": "({a} - z.start) / u.length",
    "profile_slope": "{a} * u.length",
    "force_columns": "{a} / (u.force * column_unit(i, u))",
    "distributed_force_rate": "{a} * u.length / (u.force * direction_unit(i, u))",
    "distributed_moment_rate": "{a} / (u.force * direction_unit(i, u))",
    "profile_rate": "{a} / direction_unit(i, u)",
    "start_rate": "{a} / (u.length * direction_unit(i, u))",
    "end_rate": "{a} / (u.length * direction_unit(i, u))",
    "shift_rate": "{a} / (u.length * direction_unit(i, u))",
}


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
    State, Stretch, OwnState = layout.State, layout.Stretch, own.State
    n, C, NX, ND = layout.n, layout.C, layout.NX, layout.ND
    N_AT, THETA_AT, TAU_AT, STATICS = layout.N_AT, layout.THETA_AT, layout.TAU_AT, layout.STATICS
    COLUMN_SIZE, COLUMN_P_AT, Q_AT, P_AT, END = (
        layout.COLUMN_SIZE,
        layout.COLUMN_P_AT,
        layout.Q_AT,
        layout.P_AT,
        layout.ENERGY_AT,
    )
    Units = make_units(layout)

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

    narrowed_stretch = make_narrowed_stretch(layout, own, Units)

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


def make_units(layout: Layout):
    """Type of the units of one stretch."""
    Rows = wp.types.vector(length=layout.COLUMN_SIZE, dtype=f64)
    PerColumn = wp.types.vector(length=max(layout.C, 1), dtype=f64)

    @wp.struct
    class Units:
        """What counts as one, and what a column is counted in."""

        length: f64  # [m]
        moment: f64  # [N m]
        force: f64  # [N]
        stiffness: f64  # [N m^2]
        rows: Rows  # of a column
        columns: PerColumn

    return Units


def make_narrowed_stretch(layout: Layout, own: Layout, Units):
    """The function that turns a stretch of ``layout`` into one of ``own``, in the units given.

    It is written out from the fields that the type of a stretch has: one that ``IN_NATURAL_UNITS`` does not name is refused here,
    where left out it would be zero.

    Raises:
        TypeError: If a field has no natural unit.
    """
    C, NX = layout.C, layout.NX

    @wp.func
    def natural_material(a: f64, j: int, u: Units) -> f64:
        if j < 3:
            return a / u.stiffness
        if j < 6:
            return a * u.stiffness
        if j < 9:
            return a * (u.stiffness / (u.length * u.length))
        return a * u.length / u.force  # the weight under an acceleration of one

    @wp.func
    def natural_profile(a: f64, i: int, u: Units) -> f64:
        if i < 3:
            return a * u.length / u.force
        return a / u.force

    @wp.func
    def column_unit(k: int, u: Units) -> f64:
        if k < wp.static(C):
            return u.columns[k]
        return f64(1.0)  # rows that only make the type's size

    @wp.func
    def direction_unit(k: int, u: Units) -> f64:
        return column_unit(k + wp.static(NX), u)

    lines = ["def narrowed_stretch(z: Stretch, u: Units) -> OwnStretch:", "    out = OwnStretch()"]
    for name, field in layout.Stretch.vars.items():
        if name not in IN_NATURAL_UNITS:
            raise TypeError(f"Stretch.{name} has no natural unit: name it in IN_NATURAL_UNITS")
        shape = getattr(field.type, "_shape_", ())
        index = "".join(["[", ", ".join("ij"[: len(shape)]), "]"]) if shape else ""
        for depth, (letter, size) in enumerate(zip("ij", shape, strict=False)):
            lines.append(f"{'    ' * (depth + 1)}for {letter} in range({size}):")
        entry = IN_NATURAL_UNITS[name].format(a=f"z.{name}{index}")
        lines.append(f"{'    ' * (len(shape) + 1)}out.{name}{index} = real({entry})")
    lines.append("    return out")
    scope = {
        "Stretch": layout.Stretch,
        "OwnStretch": own.Stretch,
        "Units": Units,
        "real": own.real,
        "natural_material": natural_material,
        "natural_profile": natural_profile,
        "column_unit": column_unit,
        "direction_unit": direction_unit,
    }
    return wp.func(_written("narrowed_stretch", "\n".join(lines) + "\n", scope))


def _written(name: str, source: str, scope: dict):
    """A function of a source that is in no file: Warp reads it from Python's cache of source lines."""
    place = f"<{name} {hashlib.sha256(source.encode()).hexdigest()[:16]}>"
    linecache.cache[place] = (len(source), None, source.splitlines(keepends=True), place)
    scope["__name__"] = __name__
    exec(compile(source, place, "exec"), scope)  # noqa: S102  (made here, of the fields of a type)
    return scope[name]
