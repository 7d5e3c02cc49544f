# mypy: ignore-errors
"""Which equilibria are stable beyond doubt, by a pass over nodes and the form that it leaves. Numbers: ``docs/stability.md``."""

from functools import cache

import warp as wp

from multirod.kernels.own_module import own_module
from multirod.kernels.repeated_kernels import Calls, launch_all

f64 = wp.float64


@wp.struct
class Sure:
    """What is looked at, of few instances; the first axis is the instance."""

    # of the problem
    inputs: wp.array2d[wp.float64]
    first: int  # where the translations stand in a row of inputs
    fault: wp.array[int]
    position: wp.array[wp.vec3d]  # of the tip, as the solve has it
    rotation: wp.array[wp.mat33d]
    length: wp.array2d[wp.float64]  # of the rods, as they are before they are pushed [m]
    stiffness: wp.array[wp.float64]  # the least [N m^2]
    bend: wp.array3d[wp.float64]  # of sections: EI |u*| [N m], |u*| [1/m]
    kappa: wp.array3d[wp.float64]
    near: wp.float64  # by how much the pass may end elsewhere than the solve, of numbers of a rotation, and of the length
    least: wp.float64  # what eigenvalues are to be more than, over ``K/L``, and by so many times what the form lacks of symmetry
    spare: wp.float64
    # of the pass, and of what condenses its columns
    column_arclength: wp.array2d[wp.float64]
    node_curvature: wp.array2d[wp.vec3d]
    node_moment: wp.array2d[wp.vec3d]
    node_force: wp.array2d[wp.vec3d]
    node_position: wp.array[wp.vec3d]
    node_rotation: wp.array[wp.mat33d]
    ends: wp.array2d[wp.float64]
    unit: wp.array[wp.float64]
    matrix: wp.array3d[wp.float64]
    conjugate: wp.array[int]
    known: wp.array[int]
    open: wp.array[int]
    # found
    work: wp.array3d[wp.float64]
    needed: wp.array[wp.float64]  # (7)
    sure: wp.array[int]
    told: wp.array[int]  # whether the form is known, and nothing unstable is hidden from it


@wp.func
def ends_of(s: wp.ref[Sure], t: int):
    """Where rods end, and what stiffnesses are counted in."""
    furthest = f64(0.0)
    for i in range(s.ends.shape[1]):
        s.ends[t, i] = s.length[t, i] + s.inputs[t, s.first + i]
        furthest = wp.max(furthest, s.ends[t, i])
    s.unit[t] = s.stiffness[t] / furthest
    for i in range(s.column_arclength.shape[1]):
        s.column_arclength[t, i] = f64(wp.nan)


@wp.func
def segments(s: wp.ref[Sure], t: int) -> f64:
    """(7)"""
    moment, force, curvature = f64(0.0), f64(0.0), f64(0.0)
    for k in range(s.node_moment.shape[1]):
        moment = wp.max(moment, wp.length(s.node_moment[t, k]))
        force = wp.max(force, wp.length(s.node_force[t, k]))
        curvature = wp.max(curvature, wp.length(s.node_curvature[t, k]))
    for i in range(s.bend.shape[1]):
        least, most = f64(0.0), f64(0.0)
        for j in range(s.bend.shape[2]):
            least = wp.max(least, s.bend[t, i, j])
            most = wp.max(most, s.bend[t, i, j] * (s.kappa[t, i, j] + curvature))
        moment += least
        force += most
    first = moment / (f64(wp.static(wp.PI)) * s.stiffness[t])
    second = force / (f64(wp.static(wp.PI * wp.PI)) * s.stiffness[t])
    return s.stiffness[t] / s.unit[t] * (first + wp.sqrt(first * first + f64(4.0) * second))


@wp.func
def as_solved(s: wp.ref[Sure], t: int) -> bool:
    """Whether the pass ends where the solve does."""
    moved = s.node_position[t] - s.position[t]
    turned = s.node_rotation[t] - s.rotation[t]
    far = f64(0.0)
    for i in range(3):
        far = wp.max(far, wp.abs(moved[i]) * s.unit[t] / s.stiffness[t])
        for j in range(3):
            far = wp.max(far, wp.abs(turned[i, j]))
    return far < s.near and wp.isfinite(wp.length(moved)) and wp.isfinite(wp.trace(turned))


@wp.func
def positive(s: wp.ref[Sure], t: int) -> bool:
    """Whether all eigenvalues of the form are surely more than the least: its symmetric part, less that and what the rest may do
    to them, has a Cholesky factor."""
    m = s.matrix.shape[1]
    lacking = f64(0.0)
    for i in range(m):
        for j in range(m):
            half = f64(0.5) / s.unit[t]
            s.work[t, i, j] = half * (s.matrix[t, i, j] + s.matrix[t, j, i])
            other = half * (s.matrix[t, i, j] - s.matrix[t, j, i])
            lacking += other * other
    least = s.least + s.spare * wp.sqrt(lacking)
    for k in range(m):
        pivot = s.work[t, k, k] - least
        for l in range(k):
            pivot -= s.work[t, k, l] * s.work[t, k, l]
        if not pivot > f64(0.0) or not wp.isfinite(pivot):
            return False
        root = wp.sqrt(pivot)
        for i in range(k + 1, m):
            total = s.work[t, i, k]
            for l in range(k):
                total -= s.work[t, i, l] * s.work[t, k, l]
            s.work[t, i, k] = total / root
    return True


@cache
def make_sure():
    """Kernel, of one thread, that launches a pass over nodes and, if these are enough, what condenses it, and looks at what they
    leave."""

    @own_module(max_unroll=1)
    def sure(s: Sure, nodes: Calls, form: Calls):
        for t in range(s.sure.shape[0]):
            ends_of(s, t)
        launch_all(nodes)
        all_good = bool(True)
        for t in range(s.sure.shape[0]):
            s.sure[t] = 0
            s.told[t] = 0
            s.needed[t] = segments(s, t)
            good = s.needed[t] < f64(s.node_moment.shape[1]) and s.fault[t] == 0 and as_solved(s, t)
            all_good = all_good and good
        if all_good:
            launch_all(form)
            for t in range(s.sure.shape[0]):
                good = s.known[t] != 0 and s.open[t] == 0 and s.conjugate[t] == 0
                s.told[t] = wp.where(good, 1, 0)
                s.sure[t] = wp.where(good and positive(s, t), 1, 0)

    return sure
