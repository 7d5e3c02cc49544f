# mypy: ignore-errors
"""The second variation of a backbone, condensed to its tip, free or held, one instance a thread: ``condensed_form`` compiled.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from functools import cache

import warp as wp

from multirod.kernels.own_module import own_module
from multirod.models.backbone.kernels.tips import is_as_far
from multirod.models.backbone.stability.condensing.second_variation import STIFF, WORST_CONDITION

f64 = wp.float64
PASSES = 60  # of the matrix sign function, whose error is squared in each once it is near
SAME = 1e-9  # relative change from which on it stands


@wp.struct
class Form:
    """What is condensed, and room for it; the first axis is the instance, ``m`` angles are free at the tip.

    ``c`` is ``m``, or ``m + 3`` where the tip is held: as many unknowns are looked at, forces on the tip among them last.
    """

    wanted: wp.array[int]
    arclength: wp.array2d[wp.float64]  # of the nodes [m], NaN past the last
    configuration: wp.array4d[wp.float64]  # (instance, node, m or more, c or more)
    momenta: wp.array3d[wp.float64]  # of the tip, likewise
    wrench: wp.array3d[wp.float64]  # force and moment on a tip that is held, (instance, 6, c or more)
    pose: wp.array3d[wp.float64]  # position and rotation of that, likewise
    by_wrench: int  # whether the form is by the wrench on the tip of a single rod, (12) of docs/held.md
    tip_wrench: wp.array2d[wp.float64]  # force and moment on that, (instance, 6)
    ends: wp.array2d[wp.float64]  # of the rods [m]
    unit: wp.array[wp.float64]  # K/L [N m]
    # found
    matrix: wp.array3d[wp.float64]  # (instance, c, c)
    conjugate: wp.array[int]
    known: wp.array[int]
    open: wp.array[int]  # whether eigenvalues could not be told apart: the host does it
    # room, (instance, c, c)
    kept: wp.array2d[int]  # rows of the rods that have not ended, in order, (instance, m)
    basis: wp.array3d[wp.float64]  # combinations of columns: those that keep the force, then one for each component of it
    torque: wp.array3d[wp.float64]  # momenta of rows and combinations that are left
    here: wp.array3d[wp.float64]  # configuration at a node
    inverse: wp.array3d[wp.float64]
    before: wp.array3d[wp.float64]  # inverse at the node before
    ratio: wp.array3d[wp.float64]
    work: wp.array3d[wp.float64]


# matrices of an instance, their rows one after another: Warp's own loops find the place of each number anew
_OWN = "double* __restrict {0} = &wp::index({0}_, t, 0, 0); const int {0}w = {0}_.shape[2]; "


def _own(*names: str) -> str:
    return "".join(_OWN.format(name) for name in names)


@wp.func_native(
    _own("work", "inverse")
    + """
    double determinant = 1.0;
    for (int i = 0; i < r; ++i)
        for (int j = 0; j < r; ++j)
            inverse[i * inversew + j] = i == j ? 1.0 : 0.0;
    for (int k = 0; k < r; ++k) {
        int p = k;
        for (int i = k + 1; i < r; ++i)
            if (wp::abs(work[i * workw + k]) > wp::abs(work[p * workw + k])) p = i;
        double* pivots = work + k * workw;
        double* own = inverse + k * inversew;
        if (p != k) {
            determinant = -determinant;
            double* other = work + p * workw;
            double* others = inverse + p * inversew;
            for (int j = 0; j < r; ++j) {
                double swap = pivots[j]; pivots[j] = other[j]; other[j] = swap;
                swap = own[j]; own[j] = others[j]; others[j] = swap;
            }
        }
        const double pivot = pivots[k];
        determinant *= pivot;
        for (int j = 0; j < r; ++j) {
            pivots[j] /= pivot;
            own[j] /= pivot;
        }
        for (int i = 0; i < r; ++i) {
            const double factor = work[i * workw + k];
            if (i == k || factor == 0.0) continue;
            for (int j = 0; j < r; ++j) {
                work[i * workw + j] -= factor * pivots[j];
                inverse[i * inversew + j] -= factor * own[j];
            }
        }
    }
    return determinant;
    """
)
def invert(work_: wp.array3d[wp.float64], inverse_: wp.array3d[wp.float64], t: int, r: int) -> wp.float64:
    """The inverse of the first ``r`` rows and columns of ``work``, which is used up, by pivots; returns the determinant."""


@wp.func_native(
    _own("basis", "here", "work")
    + """
    for (int i = 0; i < r; ++i) {
        const double* row = &wp::index(configuration, t, node, wp::index(kept, t, i), 0);
        for (int j = 0; j < r; ++j) {
            double total = 0.0;
            for (int l = 0; l < basisw; ++l)
                total += row[l] * basis[l * basisw + j];
            here[i * herew + j] = total;
            work[i * workw + j] = total;
        }
    }
    """
)
def combined(
    configuration: wp.array4d[wp.float64],
    kept: wp.array2d[int],
    basis_: wp.array3d[wp.float64],
    here_: wp.array3d[wp.float64],
    work_: wp.array3d[wp.float64],
    t: int,
    node: int,
    r: int,
):
    """The rows of a node's configuration that are kept, by the combinations of ``basis``, into ``here`` and ``work``."""


@wp.func_native(
    _own("here", "before", "ratio")
    + """
    for (int i = 0; i < r; ++i)
        for (int j = 0; j < r; ++j) {
            double total = 0.0;
            for (int l = 0; l < r; ++l)
                total += here[i * herew + l] * before[l * beforew + j];
            ratio[i * ratiow + j] = total;
        }
    """
)
def multiplied(here_: wp.array3d[wp.float64], before_: wp.array3d[wp.float64], ratio_: wp.array3d[wp.float64], t: int, r: int):
    """``here`` times ``before``, of the first ``r`` rows and columns, into ``ratio``."""


@wp.func(inline=False)
def square(values: wp.array3d[wp.float64], t: int, r: int) -> f64:
    total = f64(0.0)
    for i in range(r):
        for j in range(r):
            total += values[t, i, j] * values[t, i, j]
    return total


@wp.func
def trace_of(values: wp.array3d[wp.float64], t: int, r: int) -> f64:
    total = f64(0.0)
    for i in range(r):
        total += values[t, i, i]
    return total


@wp.func(inline=False)
def negative(s: wp.ref[Form], t: int, r: int) -> int:
    """How many eigenvalues of ``ratio`` have a negative real part: by its sign function, which Newton's method finds.

    It has eigenvalues of 1 and -1 in the place of those with a positive and a negative real part.
    """
    size = square(s.ratio, t, r)
    trace = trace_of(s.ratio, t, r)
    if not wp.isfinite(size):
        return 0
    # none has where the matrix is nearer to some positive multiple of the identity than that is to zero
    if trace > f64(0.0) and trace * trace > f64(r - 1) * size:
        return 0
    for _pass in range(wp.static(PASSES)):
        for i in range(r):
            for j in range(r):
                s.work[t, i, j] = s.ratio[t, i, j]
        determinant = wp.abs(invert(s.work, s.inverse, t, r))
        # the scale by which eigenvalues are as far above 1 as below
        scale = wp.pow(determinant, f64(-1.0) / f64(r))
        change = f64(0.0)
        for i in range(r):
            for j in range(r):
                value = f64(0.5) * (scale * s.ratio[t, i, j] + s.inverse[t, i, j] / scale)
                change += (value - s.ratio[t, i, j]) * (value - s.ratio[t, i, j])
                s.ratio[t, i, j] = value
        if not wp.isfinite(change):
            break
        if change <= f64(wp.static(SAME * SAME)) * square(s.ratio, t, r):
            return int(wp.round(f64(0.5) * (f64(r) - trace_of(s.ratio, t, r))))
    s.open[t] = 1
    return 0


@wp.func(inline=False)
def look_at(s: wp.ref[Form], t: int, node: int, r: int) -> bool:
    """Configurations at a node by the combinations that are left, and their inverse; whether rounding leaves the signs."""
    combined(s.configuration, s.kept, s.basis, s.here, s.work, t, node, r)
    invert(s.work, s.inverse, t, r)
    size = square(s.here, t, r) * square(s.inverse, t, r)
    return size < f64(wp.static(WORST_CONDITION * WORST_CONDITION))


@wp.func
def farthest(s: wp.ref[Form], t: int) -> f64:
    """Where the tip is."""
    tip = s.ends[t, 0]
    for i in range(1, s.ends.shape[1]):
        tip = wp.max(tip, s.ends[t, i])
    return tip


@wp.func
def next_rod(s: wp.ref[Form], t: int, after: f64, rod: int) -> int:
    """The rod that ends next before the tip, after one that ends at ``after``; -1 if there is none."""
    tip = farthest(s, t)
    found = int(-1)
    for i in range(s.ends.shape[1]):
        own = s.ends[t, i]
        if not is_as_far(own, tip) and (own > after or (own == after and i > rod)):
            if found < 0 or own < s.ends[t, found]:
                found = i
    return found


@wp.func(inline=False)
def release(s: wp.ref[Form], t: int, place: int, r: int):
    """(6), (20) The angle in a row is free from here on: keep to the combinations that leave its end without torque.

    These are the columns, but the first, of the reflection that takes the torque's row into the first direction.
    """
    size = f64(0.0)
    for j in range(r):
        size += s.torque[t, place, j] * s.torque[t, place, j]
    square_of_own = size
    size = wp.sqrt(size)
    # v = own +- |own| e_1, in the first row of ``ratio``; what forces are to take of own, and own, in the first two of ``work``
    total = f64(0.0)
    for j in range(r):
        value = s.torque[t, place, j]
        s.work[t, 1, j] = value
        if j == 0:
            value += wp.where(value >= f64(0.0), size, -size)
        s.ratio[t, 0, j] = value
        total += value * value
    total = wp.max(total, f64(1.0e-300))
    forces = s.basis.shape[1] - s.kept.shape[1]
    for k in range(forces):
        s.work[t, 0, k] = s.torque[t, place, r + k] / square_of_own
    for i in range(s.basis.shape[1]):
        along, by_own = f64(0.0), f64(0.0)
        for j in range(r):
            along += s.basis[t, i, j] * s.ratio[t, 0, j]
            by_own += s.basis[t, i, j] * s.work[t, 1, j]
        for j in range(1, r):
            s.basis[t, i, j - 1] = s.basis[t, i, j] - f64(2.0) * along / total * s.ratio[t, 0, j]
        for k in range(forces):
            s.basis[t, i, r + k - 1] = s.basis[t, i, r + k] - by_own * s.work[t, 0, k]
    for i in range(r):
        along, by_own = f64(0.0), f64(0.0)
        for j in range(r):
            along += s.torque[t, i, j] * s.ratio[t, 0, j]
            by_own += s.torque[t, i, j] * s.work[t, 1, j]
        to = wp.where(i > place, i - 1, i)
        if i != place:
            for j in range(1, r):
                s.torque[t, to, j - 1] = s.torque[t, i, j] - f64(2.0) * along / total * s.ratio[t, 0, j]
            for k in range(forces):
                s.torque[t, to, r + k - 1] = s.torque[t, i, r + k] - by_own * s.work[t, 0, k]
    for i in range(place, r - 1):
        s.kept[t, i] = s.kept[t, i + 1]


@wp.func(inline=False)
def combine(s: wp.ref[Form], t: int):
    """Columns that are looked at: all of a free tip; of one that is held, those that keep the force on it, then one for each
    component of it, (20); and the momenta by these."""
    m, c = s.kept.shape[1], s.basis.shape[1]
    for i in range(c):
        for j in range(c):
            s.basis[t, i, j] = wp.where(i == j, f64(1.0), f64(0.0))
    if c > m:
        by_last = wp.mat33d()
        for k in range(3):
            for j in range(3):
                by_last[k, j] = s.wrench[t, k, m + j]
        inverse = wp.inverse(by_last)
        sound = wp.determinant(by_last) != f64(0.0)
        for k in range(3):
            for j in range(m):
                total = f64(0.0)
                for l in range(3):
                    total += inverse[k, l] * s.wrench[t, l, j]
                s.basis[t, m + k, j] = wp.where(sound, -total, f64(wp.nan))
            for j in range(3):
                s.basis[t, m + k, m + j] = inverse[k, j]
    for i in range(m):
        for j in range(c):
            total = f64(0.0)
            for l in range(c):
                value = s.momenta[t, i, l]
                if c > m and i < 3:
                    value = s.wrench[t, 3 + i, l]
                total += value * s.basis[t, l, j]
            s.torque[t, i, j] = total


@wp.func(inline=False)
def write_form(s: wp.ref[Form], t: int, node: int, r: int) -> bool:
    """(5), (21) The form by what is left, at the last node; whether it is finite."""
    m, c = s.kept.shape[1], s.basis.shape[1]
    finite = bool(True)
    # how configurations vary by forces, and with that taken back to zero by the other columns
    for i in range(r):
        for k in range(c - m):
            total = f64(0.0)
            for l in range(c):
                total += s.configuration[t, node, s.kept[t, i], l] * s.basis[t, l, r + k]
            s.here[t, i, k] = total
    for i in range(r):
        for k in range(c - m):
            total = f64(0.0)
            for l in range(r):
                total += s.inverse[t, i, l] * s.here[t, l, k]
            s.work[t, i, k] = total
    for i in range(r):
        for j in range(r):
            total = f64(0.0)
            for l in range(r):
                total += s.torque[t, i, l] * s.inverse[t, l, j]
            s.matrix[t, s.kept[t, i], s.kept[t, j]] = total
            finite = finite and wp.isfinite(total)
        for k in range(c - m):
            total = s.torque[t, i, r + k]
            for l in range(r):
                total -= s.torque[t, i, l] * s.work[t, l, k]
            s.matrix[t, s.kept[t, i], m + k] = total
            finite = finite and wp.isfinite(total)
    # the negative position of the tip, by the same
    for i in range(c - m):
        for j in range(r + c - m):
            total = f64(0.0)
            for l in range(c):
                total += s.pose[t, i, l] * s.basis[t, l, j]
            s.ratio[t, i, j] = total
        for j in range(r):
            total = f64(0.0)
            for l in range(r):
                total -= s.ratio[t, i, l] * s.inverse[t, l, j]
            s.matrix[t, m + i, s.kept[t, j]] = total
            finite = finite and wp.isfinite(total)
        for k in range(c - m):
            total = -s.ratio[t, i, r + k]
            for l in range(r):
                total += s.ratio[t, i, l] * s.work[t, l, k]
            s.matrix[t, m + i, m + k] = total
            finite = finite and wp.isfinite(total)
    return finite


@wp.func
def longest_rod(s: wp.ref[Form], t: int) -> int:
    """The one that ends at the tip, whose rotation comes first in the columns."""
    tip = farthest(s, t)
    longest = int(0)
    while longest < s.ends.shape[1] - 1 and not is_as_far(s.ends[t, longest], tip):
        longest += int(1)
    return longest


@wp.func(inline=False)
def step_back(s: wp.ref[Form], t: int, r: int):
    """``ratio`` of what is found at a node to what stands in ``before``, where ``inverse`` then takes its place."""
    multiplied(s.here, s.before, s.ratio, t, r)
    # the sign function has its own use of what stands in ``inverse``
    for i in range(r):
        for j in range(r):
            s.before[t, i, j] = s.inverse[t, i, j]


@wp.func(inline=False)
def by_wrench(s: wp.ref[Form], t: int):
    """(12) of docs/held.md: ``compliance_form``."""
    m, c = s.kept.shape[1], s.basis.shape[1]
    last, node = int(0), int(0)
    while last + 1 < s.arclength.shape[1] and not wp.isnan(s.arclength[t, last + 1]):
        last += 1
    known = look_at(s, t, 0, m)
    conjugate = int(0)
    while node < last:
        for i in range(m):
            for j in range(m):
                s.before[t, i, j] = s.inverse[t, i, j]
        node += 1
        if node < last:
            known = look_at(s, t, node, m) and known
        else:
            # the tip is free: its own rotation is eliminated before that of the last node
            for j in range(c):
                turn = wp.vec3d(s.configuration[t, last, 0, j], s.configuration[t, last, 1, j], s.configuration[t, last, 2, j])
                moment = wp.vec3d(s.tip_wrench[t, 3], s.tip_wrench[t, 4], s.tip_wrench[t, 5])
                # a moment varies by rotations along geodesics: so its second derivatives are symmetric
                change = f64(0.5) * wp.cross(turn, moment)
                for i in range(3):
                    s.torque[t, i, j] = s.wrench[t, 3 + i, j] - change[i]
                    s.torque[t, 3 + i, j] = s.wrench[t, i, j]
            for i in range(m):
                for j in range(m):
                    total = f64(0.0)
                    for l in range(c):
                        total += s.torque[t, i, l] * s.basis[t, l, j]
                    s.here[t, i, j] = total
        step_back(s, t, m)
        conjugate += negative(s, t, m)
        for i in range(m):
            for j in range(m):
                s.inverse[t, i, j] = s.before[t, i, j]
    for i in range(c):
        for j in range(c):
            s.work[t, i, j] = s.torque[t, i, j]
    invert(s.work, s.inverse, t, c)
    # moments and forces, each in a unit of its own: rows are made as large as each other
    size = f64(0.0)
    for i in range(c):
        row = f64(0.0)
        column = f64(0.0)
        for j in range(c):
            row += s.torque[t, i, j] * s.torque[t, i, j]
            column += s.inverse[t, j, i] * s.inverse[t, j, i]
        size += f64(c) * row * column
    known = known and size < f64(wp.static(WORST_CONDITION * WORST_CONDITION))
    for i in range(c):
        for j in range(c):
            total = f64(0.0)
            for l in range(c):
                if i < m:
                    total -= s.configuration[t, last, i, l] * s.inverse[t, l, j]
                else:
                    total -= s.pose[t, i - m, l] * s.inverse[t, l, j]
            s.matrix[t, i, j] = total
    s.conjugate[t] = conjugate
    s.known[t] = wp.where(known, 1, 0)


@cache
def make_form():
    """Kernel for (4) to (6), and (20), (21) of a tip that is held, or (12) of docs/held.md."""

    @own_module(max_unroll=1)
    def form(s: Form):
        t = wp.tid()
        if s.wanted[t] == 0:
            return
        m = s.kept.shape[1]
        for i in range(m):
            s.kept[t, i] = i
        for i in range(s.basis.shape[1]):
            for j in range(s.basis.shape[1]):
                s.matrix[t, i, j] = wp.where(i == j, f64(wp.static(STIFF)) * s.unit[t], f64(0.0))
        s.open[t] = 0
        combine(s, t)
        if s.by_wrench != 0:
            by_wrench(s, t)
            return
        r = int(m)
        known = bool(True)
        conjugate = int(0)
        longest = longest_rod(s, t)
        rod = int(-1)
        end = f64(-wp.inf)
        node = int(0)
        going = bool(True)
        while going:
            rod = next_rod(s, t, end, rod)
            going = rod >= 0
            end = farthest(s, t)
            if going:
                end = s.ends[t, rod]
            known = look_at(s, t, node, r) and known
            while node + 1 < s.arclength.shape[1] and not s.arclength[t, node] >= end:
                for i in range(r):
                    for j in range(r):
                        s.before[t, i, j] = s.inverse[t, i, j]
                node += 1
                known = look_at(s, t, node, r) and known
                step_back(s, t, r)
                conjugate += negative(s, t, r)
                for i in range(r):
                    for j in range(r):
                        s.inverse[t, i, j] = s.before[t, i, j]
            if going:
                row = 3 + wp.where(rod > longest, rod - 1, rod)
                place = int(0)
                for i in range(r):
                    if s.kept[t, i] == row:
                        place = i
                total = f64(0.0)
                for l in range(r):
                    total += s.torque[t, place, l] * s.inverse[t, l, place]
                if total < f64(0.0):
                    conjugate += 1
                release(s, t, place, r)
                r -= 1
        known = write_form(s, t, node, r) and known
        s.conjugate[t] = conjugate
        s.known[t] = wp.where(known, 1, 0)

    return form
