# mypy: ignore-errors
"""The kernel that integrates one segment of a backbone of one rod, from a given state, with columns by that state.

Numbers in parentheses are those of ``docs/model.md``. A segment begins and ends at any arclength; several, end to end, carry the
rod (``docs/solvers.md``). The unknowns of a segment are the variations of its first state: the moment in the units of (10), the
rotation over the rod's length, then, where something follows the tip, the base force in the units of (13).
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

from multirod.models.backbone_end_kernels import make_base_functions, make_tip_functions
from multirod.models.backbone_equation_kernels import make_equation_functions
from multirod.models.backbone_fixed_kernels import make_fixed_ends, make_fixed_rates
from multirod.models.backbone_grid_kernels import make_grid_functions
from multirod.models.backbone_layout_kernels import FAULT_NONE, FAULT_NONFINITE, Call, Layout, RodTable
from multirod.models.backbone_precision_kernels import make_walk_functions
from multirod.models.backbone_rates_kernels import make_rate_functions
from multirod.models.backbone_stretch_kernels import make_stretch_functions
from multirod.models.features import Features
from multirod.models.integrators import Tableau

f64 = wp.float64

MOMENT_AT, ROTATION_AT, POSITION_AT, STATE_SIZE = 0, 3, 7, 10  # M, q, p in a segment's state
BASE_FORCE_AT = 6  # of the variations


@dataclass(frozen=True, kw_only=True)
class SegmentFeatures(Features):
    """The terms of a segment: those of a backbone whose unknowns are all that its first state can vary by."""

    @property
    def unknown_count(self) -> int:
        return 9 if self.base_force_unknown else 6


@wp.struct
class SegmentCall:
    """What one launch over segments reads and writes beside ``Call``; the first axis is the segment."""

    instance: wp.array[int]
    start: wp.array[wp.float64]  # arclength [m]
    end: wp.array[wp.float64]
    at_tip: wp.array[int]  # 1 where the segment ends at the tip
    steps: wp.array[int]  # equal steps over the segment, each stretch of it its share; 0: by the integrator's error control
    state: wp.array2d[wp.float64]  # M, q, p at the start, base frame; at the base it is that of the unknowns
    # outputs
    end_state: wp.array2d[wp.float64]
    columns: wp.array3d[wp.float64]  # of the end: moment, rotation in the units of the unknowns, position [m], (.., 9, column)
    fault: wp.array[int]
    energy: wp.array[wp.float64]
    work: wp.array[wp.float64]


@cache
def make_segment_kernel(features: SegmentFeatures, tableau: Tableau):
    """Kernel for one set of features and one integrator; arguments ``(RodTable, Call, SegmentCall)``, one thread a segment."""
    layout = Layout(features)
    stretch = make_stretch_functions(layout)
    rate = make_rate_functions(layout, features, stretch)
    grid = make_grid_functions(layout, features, stretch)
    tip = make_tip_functions(layout, features, stretch, rate, grid)
    base = make_base_functions(layout, features, grid)
    FIXED = features.fixed_moment
    if FIXED:
        rate = make_fixed_rates(layout, features, stretch, rate)
        tip = make_fixed_ends(layout, features, rate, base, grid, tip)
        in_axes, in_frame = rate.in_axes, rate.in_frame
    State, Stretch, Instance = layout.State, layout.Stretch, layout.Instance
    PerDirection = layout.PerDirection
    NX, C = layout.NX, layout.C
    N_AT, Q_AT, P_AT, ENERGY_AT, WORK_AT = layout.N_AT, layout.Q_AT, layout.P_AT, layout.ENERGY_AT, layout.WORK_AT
    STATICS, COLUMN_SIZE, COLUMN_Q_AT, COLUMN_P_AT = layout.STATICS, layout.COLUMN_SIZE, layout.COLUMN_Q_AT, layout.COLUMN_P_AT
    FORCE_STATE, NODES = layout.FORCE_STATE, features.nodes
    load_instance, first_node, next_node, walk_to = grid.load_instance, grid.first_node, grid.next_node, grid.walk_to
    load_stretch, force_at_end, output_arclength = grid.load_stretch, grid.force_at_end, grid.output_arclength
    at_base, unknown_unit = base.at_base, base.unknown_unit
    walk = make_walk_functions(layout, features, tableau, rate.rates, layout.real)
    over_stretch, fixed_steps = walk.over_stretch, walk.fixed_steps
    rotate_inverse = make_equation_functions(layout.real).rotate_inverse
    frame, column_of, column_rotation = rate.frame, rate.column_of, rate.column_rotation
    write_end, write_node = tip.write_end, tip.write_node

    @wp.func
    def from_state(seg: SegmentCall, t: int, base_state: State, n0: wp.vec3d) -> State:
        """The given state; what directions vary is known where the segment begins, so their columns are zero there."""
        y = base_state
        for j in range(3):
            y[j] = seg.state[t, j]
            y[P_AT + j] = seg.state[t, POSITION_AT + j]
        for j in range(4):
            y[Q_AT + j] = seg.state[t, ROTATION_AT + j]
        if wp.static(FORCE_STATE):
            N = rotate_inverse(frame(y), n0)
            for j in range(3):
                y[N_AT + j] = N[j]
        if wp.static(NODES):
            y[ENERGY_AT] = f64(0.0)
        for k in range(wp.static(NX), wp.static(C)):
            for j in range(wp.static(COLUMN_SIZE)):
                y[STATICS + k * COLUMN_SIZE + j] = f64(0.0)
        return y

    @wp.func
    def with_rotation_columns(case: Instance, given: State) -> State:
        """(15) The columns of the unknown rotation, in the frame where the segment begins."""
        y = given
        q = frame(y)
        h = f64(0.5) * case.scale
        for k in range(3):
            o = wp.static(STATICS + COLUMN_Q_AT) + (3 + k) * wp.static(COLUMN_SIZE)
            e = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
            e[k] = h
            r = wp.vec3d(q[0], q[1], q[2])
            v = q[3] * e + wp.cross(r, e)
            for j in range(3):
                y[o + j] = v[j]
            y[o + 3] = -wp.dot(r, e)
        return y

    @wp.func
    def write_segment(rods: RodTable, seg: SegmentCall, case: Instance, t: int, y: State) -> f64:
        """The end of the segment. Returns a number that is not finite if one of them is not."""
        total = f64(0.0)
        for j in range(3):
            seg.end_state[t, j] = y[j]
            seg.end_state[t, POSITION_AT + j] = y[P_AT + j]
            total += wp.abs(y[j])
        for j in range(4):
            seg.end_state[t, ROTATION_AT + j] = y[Q_AT + j]
        q = frame(y)
        unit = unknown_unit(rods, case, 0)
        for k in range(wp.static(C)):
            column = column_of(y, k)
            turn = column_rotation(q, column) / case.scale
            for j in range(3):
                seg.columns[t, j, k] = unit[j] * column[j]
                seg.columns[t, 3 + j, k] = turn[j]
                seg.columns[t, 6 + j, k] = column[wp.static(COLUMN_P_AT) + j]
                total += wp.abs(column[j])
        return total

    @wp.kernel(module="unique", enable_backward=False)
    def integrate(rods: RodTable, call: Call, seg: SegmentCall):
        """From the start of the segment to its end, stretch by stretch; then the residual, if that is the tip."""
        t = wp.tid()
        case = load_instance(rods, call, seg.instance[t])
        start = seg.start[t]
        stop = seg.end[t]
        if seg.at_tip[t] == 1:
            stop = case.length
        node = first_node(rods, case)
        y, n, dn = at_base(rods, call, case, node)
        z = Stretch()
        still = PerDirection()  # a breakpoint keeps its arclength
        # the force where the segment begins, (3a)
        while node.s < start:
            end, end_rate = next_node(rods, call, case, node)
            if wp.static(NODES):
                if end <= start and end >= output_arclength(rods, call, case, node):
                    node.output += 1
            if end > start:
                end = start
                end_rate = still
            z = load_stretch(rods, call, case, node, end, end_rate, n, dn)
            n, dn = force_at_end(z)
            node = walk_to(rods, case, node, end, end_rate)
        if start > f64(0.0):
            y = from_state(seg, t, y, n)
        if wp.static(NX > 0):
            y = with_rotation_columns(case, y)
        if wp.static(FIXED):
            y = in_axes(y)
        h = f64(0.0)
        step_count = int(0)
        fault = int(wp.static(FAULT_NONE))

        while node.s < stop and fault == wp.static(FAULT_NONE):
            end, end_rate = next_node(rods, call, case, node)
            if end > stop:
                end = stop
                end_rate = still
            z = load_stretch(rods, call, case, node, end, end_rate, n, dn)
            if wp.static(NODES):
                if node.s == f64(0.0):
                    write_node(call, case, 0, y, z, f64(0.0), f64(0.0))
            if seg.steps[t] > 0:
                count = int(wp.ceil(f64(seg.steps[t]) * z.length / (stop - start) - f64(1.0e-9)))
                y = fixed_steps(y, z, wp.max(1, count), case.scale)
            else:
                y, h, step_count, fault = over_stretch(y, z, h, step_count, case, call)
            if wp.static(NODES):
                if end >= output_arclength(rods, call, case, node):
                    node.output += 1
                    write_node(call, case, node.output, y, z, z.length, end)
            n, dn = force_at_end(z)
            node = walk_to(rods, case, node, end, end_rate)

        if wp.static(FIXED):
            total = write_segment(rods, seg, case, t, in_frame(y))
        else:
            total = write_segment(rods, seg, case, t, y)
        if seg.at_tip[t] == 1:
            total += write_end(rods, call, case, y, z, n, dn)
        if wp.static(NODES):
            seg.energy[t] = y[ENERGY_AT]
            seg.work[t] = y[WORK_AT]
        if not wp.isfinite(total):
            fault = int(wp.static(FAULT_NONFINITE))
        seg.fault[t] = fault

    return integrate
