# mypy: ignore-errors
"""The linear equations of multiple shooting, those of one instance a thread.

With (2) of ``docs/solvers.md``, a segment's columns stand in the rows of its own gap and of that before it. So elimination goes
from segment to segment: the rows left over from the last one and those of this one are all that its columns have, the pivots are
chosen among them, and what is left over goes on to the next. That is Gaussian elimination with partial pivoting of the band.
"""

import warp as wp

f64 = wp.float64
SQUARE = wp.constant(0.1)  # of a vector, that is left of it where what is taken off it need not be looked at again
wp.set_module_options({"max_unroll": 1, "enable_backward": False})


@wp.struct
class Band:
    """Jacobians of several instances, their segments one after another, and room for their factors."""

    first: wp.array[int]  # (count + 1,): where the segments of an instance begin
    places: wp.array[int]  # (n,): variations at the base by which the unknowns are
    transition: wp.array3d[wp.float64]  # (segment, d, d or more)
    tip: wp.array3d[wp.float64]  # (instance, n, d or more)
    factors: wp.array3d[wp.float64]  # (segment, 2 d - n, 2 d): pivots' rows, and by what they were taken from those below
    pivots: wp.array2d[int]  # (segment, d): rows that pivots were chosen from
    singular: wp.array[int]  # (instance,)
    front: wp.array2d[wp.float64]  # (segment, 2 d - n): a right-hand side on its way


@wp.struct
class Sides:
    """Vectors by instance and by segment: right-hand sides, gaps at the ends of segments but for the tip's, which is the
    instance's; or solutions, unknowns of the instance and variations where segments begin but for the first."""

    own: wp.array2d[wp.float64]  # (instance, n)
    rows: wp.array2d[wp.float64]  # (segment, d)


@wp.func
def column_count(band: wp.ref[Band], t: int, k: int) -> int:
    """Columns of segment k of instance t."""
    if k == 0:
        return band.places.shape[0]
    return band.pivots.shape[1]


@wp.func
def row_count(band: wp.ref[Band], t: int, k: int) -> int:
    """Rows in which they stand."""
    n = band.places.shape[0]
    d = band.pivots.shape[1]
    own = d
    if band.first[t] + k == band.first[t + 1] - 1:
        own = n
    if k > 0:
        own += d - n
    return own


@wp.func(inline=False)
def fill(band: wp.ref[Band], t: int, k: int):
    """The rows in which the columns of segment k stand."""
    n = band.places.shape[0]
    d = band.pivots.shape[1]
    s = band.first[t] + k
    last = s == band.first[t + 1] - 1
    F = band.factors
    for i in range(F.shape[1]):
        for j in range(F.shape[2]):
            F[s, i, j] = f64(0.0)
    above = int(0)
    columns = column_count(band, t, k)
    if k > 0:
        above = d - n
        before = column_count(band, t, k - 1)
        for i in range(above):
            for j in range(d):
                F[s, i, j] = F[s - 1, before + i, before + j]
    for i in range(row_count(band, t, k) - above):
        for j in range(columns):
            c = j
            if k == 0:
                c = band.places[j]
            if last:
                F[s, above + i, j] = band.tip[t, i, c]
            else:
                F[s, above + i, j] = band.transition[s, i, c]
        if not last:
            F[s, above + i, columns + i] = f64(-1.0)


@wp.func(inline=False)
def eliminate(band: wp.ref[Band], t: int, k: int):
    """Pivots for the columns of segment k."""
    d = band.pivots.shape[1]
    s = band.first[t] + k
    columns = column_count(band, t, k)
    rows = row_count(band, t, k)
    width = columns + d
    if s == band.first[t + 1] - 1:
        width = columns
    F = band.factors
    for c in range(columns):
        p = int(c)
        most = wp.abs(F[s, c, c])
        for i in range(c + 1, rows):
            size = wp.abs(F[s, i, c])
            if size > most:
                p = i
                most = size
        band.pivots[s, c] = p
        if p != c:
            for j in range(width):
                swap = F[s, c, j]
                F[s, c, j] = F[s, p, j]
                F[s, p, j] = swap
        pivot = F[s, c, c]
        if pivot == f64(0.0) or not wp.isfinite(pivot):
            band.singular[t] = 1
            return
        for i in range(c + 1, rows):
            m = F[s, i, c]
            if m != f64(0.0):
                m = m / pivot
                F[s, i, c] = m
                for j in range(c + 1, width):
                    F[s, i, j] = F[s, i, j] - m * F[s, c, j]


@wp.func(inline=False)
def substitute(band: wp.ref[Band], t: int, right: wp.ref[Sides], x: wp.ref[Sides]):
    """``J^-1`` times a right-hand side."""
    n = band.places.shape[0]
    d = band.pivots.shape[1]
    begin = band.first[t]
    count = band.first[t + 1] - begin
    F = band.factors
    w = band.front
    for k in range(count):
        s = begin + k
        columns = column_count(band, t, k)
        rows = row_count(band, t, k)
        above = int(0)
        if k > 0:
            above = d - n
            before = column_count(band, t, k - 1)
            for i in range(above):
                w[s, i] = w[s - 1, before + i]
        for i in range(rows - above):
            if k == count - 1:
                w[s, above + i] = right.own[t, i]
            else:
                w[s, above + i] = right.rows[s, i]
        for c in range(columns):
            p = band.pivots[s, c]
            swap = w[s, c]
            w[s, c] = w[s, p]
            w[s, p] = swap
        for c in range(columns):
            value = w[s, c]
            for i in range(c + 1, rows):
                w[s, i] = w[s, i] - F[s, i, c] * value
    for b in range(count):
        k = count - 1 - b
        s = begin + k
        columns = column_count(band, t, k)
        for e in range(columns):
            r = columns - 1 - e
            total = w[s, r]
            for j in range(r + 1, columns):
                if k == 0:
                    total -= F[s, r, j] * x.own[t, j]
                else:
                    total -= F[s, r, j] * x.rows[s, j]
            if k < count - 1:
                for j in range(d):
                    total -= F[s, r, columns + j] * x.rows[s + 1, j]
            total = total / F[s, r, r]
            if k == 0:
                x.own[t, r] = total
            else:
                x.rows[s, r] = total


@wp.func(inline=False)
def multiply(band: wp.ref[Band], t: int, x: wp.ref[Sides], right: wp.ref[Sides]):
    """``J`` times a solution."""
    n = band.places.shape[0]
    d = band.pivots.shape[1]
    begin = band.first[t]
    end = band.first[t + 1]
    for s in range(begin, end):
        last = s == end - 1
        for i in range(wp.where(last, n, d)):
            total = f64(0.0)
            if s == begin:
                for j in range(n):
                    c = band.places[j]
                    if last:
                        total += band.tip[t, i, c] * x.own[t, j]
                    else:
                        total += band.transition[s, i, c] * x.own[t, j]
            else:
                for j in range(d):
                    if last:
                        total += band.tip[t, i, j] * x.rows[s, j]
                    else:
                        total += band.transition[s, i, j] * x.rows[s, j]
            if last:
                right.own[t, i] = total
            else:
                right.rows[s, i] = total - x.rows[s + 1, i]


@wp.kernel
def factorise(band: Band):
    """Factors of every Jacobian, and whether it is singular."""
    t = wp.tid()
    band.singular[t] = 0
    for k in range(band.first[t + 1] - band.first[t]):
        fill(band, t, k)
        eliminate(band, t, k)
        if band.singular[t] != 0:
            return


@wp.kernel
def solve(band: Band, right: Sides, x: Sides):
    """Solutions; NaN where the Jacobian is singular."""
    t = wp.tid()
    if band.singular[t] == 0:
        substitute(band, t, right, x)
        return
    for j in range(x.own.shape[1]):
        x.own[t, j] = f64(wp.nan)
    for s in range(band.first[t], band.first[t + 1]):
        for j in range(x.rows.shape[1]):
            x.rows[s, j] = f64(wp.nan)


@wp.struct
class Krylov:
    """The space of Arnoldi's method: what ``J_new J_old^-1 - I`` makes of its own last vector, again and again."""

    own: wp.array3d[wp.float64]  # (instance, vector, n)
    rows: wp.array3d[wp.float64]  # (segment, vector, d)
    projected: wp.array3d[wp.float64]  # (instance, vector, vector): the operator in that space
    left: wp.array[wp.float64]  # (instance,): size of what leads out of it
    along: wp.array2d[wp.float64]  # (instance, vector): room for what lies along each


@wp.func(inline=False)
def size_of(band: wp.ref[Band], space: wp.ref[Krylov], t: int, a: int) -> f64:
    """Of a vector of the space."""
    total = f64(0.0)
    for i in range(space.own.shape[2]):
        total += space.own[t, a, i] * space.own[t, a, i]
    for s in range(band.first[t], band.first[t + 1] - 1):
        for i in range(space.rows.shape[2]):
            total += space.rows[s, a, i] * space.rows[s, a, i]
    return wp.sqrt(total)


@wp.func(inline=False)
def scale(band: wp.ref[Band], space: wp.ref[Krylov], t: int, a: int, factor: f64):
    """A vector of the space becomes so many times itself."""
    for i in range(space.own.shape[2]):
        space.own[t, a, i] = factor * space.own[t, a, i]
    for s in range(band.first[t], band.first[t + 1] - 1):
        for i in range(space.rows.shape[2]):
            space.rows[s, a, i] = factor * space.rows[s, a, i]


@wp.func(inline=False)
def leave(band: wp.ref[Band], space: wp.ref[Krylov], t: int, k: int):
    """Take from vector k + 1 what lies along those before it, all in one sweep over the segments: they do not fit the cache."""
    end = band.first[t + 1] - 1
    own = space.own
    rows = space.rows
    alongs = space.along
    for j in range(k + 1):
        along = f64(0.0)
        for i in range(own.shape[2]):
            along += own[t, j, i] * own[t, k + 1, i]
        alongs[t, j] = along
    for s in range(band.first[t], end):
        for j in range(k + 1):
            along = f64(0.0)
            for i in range(rows.shape[2]):
                along += rows[s, j, i] * rows[s, k + 1, i]
            alongs[t, j] = alongs[t, j] + along
    for j in range(k + 1):
        space.projected[t, j, k] = space.projected[t, j, k] + alongs[t, j]
        for i in range(own.shape[2]):
            own[t, k + 1, i] = own[t, k + 1, i] - alongs[t, j] * own[t, j, i]
    for s in range(band.first[t], end):
        for j in range(k + 1):
            along = alongs[t, j]
            for i in range(rows.shape[2]):
                rows[s, k + 1, i] = rows[s, k + 1, i] - along * rows[s, j, i]


@wp.kernel
def change(before: Band, after: Band, space: Krylov, right: Sides, x: Sides):
    """Arnoldi's method on ``J_new J_old^-1 - I``, from a vector of ones."""
    t = wp.tid()
    n = space.own.shape[2]
    d = space.rows.shape[2]
    most = space.projected.shape[1]
    size = n + d * (before.first[t + 1] - before.first[t] - 1)
    start = f64(1.0) / wp.sqrt(f64(size))
    for i in range(n):
        space.own[t, 0, i] = start
    for s in range(before.first[t], before.first[t + 1] - 1):
        for i in range(d):
            space.rows[s, 0, i] = start
    space.left[t] = f64(0.0)
    for k in range(wp.min(most, size)):
        for i in range(n):
            right.own[t, i] = space.own[t, k, i]
        for s in range(before.first[t], before.first[t + 1] - 1):
            for i in range(d):
                right.rows[s, i] = space.rows[s, k, i]
        substitute(before, t, right, x)
        multiply(after, t, x, right)
        for i in range(n):
            space.own[t, k + 1, i] = right.own[t, i] - space.own[t, k, i]
        for s in range(before.first[t], before.first[t + 1] - 1):
            for i in range(d):
                space.rows[s, k + 1, i] = right.rows[s, i] - space.rows[s, k, i]
        whole = size_of(before, space, t, k + 1)
        leave(before, space, t, k)
        norm = size_of(before, space, t, k + 1)
        if norm < f64(SQUARE) * whole:  # rounding is left, by which vectors are not square to each other
            leave(before, space, t, k)
            norm = size_of(before, space, t, k + 1)
        if k == wp.min(most, size) - 1:
            if most < size:
                space.left[t] = norm
            return
        if norm <= f64(1.0e-12) * whole or norm == f64(0.0):
            return
        space.projected[t, k + 1, k] = norm
        scale(before, space, t, k + 1, f64(1.0) / norm)
