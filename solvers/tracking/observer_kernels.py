# mypy: ignore-errors
"""One sample of the nonlinear observer, between two integrations. Numbers are those of ``docs/observer.md``."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from multirod.kernels.failure_kernels import failure_of
from multirod.kernels.linear_algebra_kernels import make_linear_algebra
from multirod.kernels.own_module import own_module
from multirod.status import Status

f64 = wp.float64
SWEEPS = 5  # of the equilibration: each takes the square root of what is left to correct


@wp.struct
class ObserverState:
    """What the observer reads and writes; the first axis is the instance. What is scaled stands in the order of the blocks."""

    # of the problem
    active: wp.array[int]
    fault: wp.array[int]
    unknowns: wp.array2d[wp.float64]
    residual: wp.array2d[wp.float64]
    gamma: wp.array3d[wp.float64]
    residual_directions: wp.array3d[wp.float64]
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    pose_columns: wp.array3d[wp.float64]
    # of the observer
    following: wp.array2d[wp.float64]  # unknowns of the next sample
    riccati: wp.array3d[wp.float64]  # P
    status: wp.array[int]
    rates: wp.array2d[wp.float64]  # closed-loop rates [1/s]
    size: wp.array[wp.float64]  # |eps|, max norm [1/m]
    singular_value: wp.array[wp.float64]  # smallest of the scaled Gamma
    pivot: wp.array2d[wp.float64]  # smallest singular value of each U_ii, (instance, block)
    # blocks
    rows: wp.array[int]  # the residual at each place
    columns: wp.array[int]  # the unknown at each place
    start: wp.array[int]  # where the block of each place starts
    stop: wp.array[int]
    # the scaled Gamma, factored: U_ii on the diagonal, U above, L below
    matrix: wp.array3d[wp.float64]
    inverse: wp.array3d[wp.float64]  # U_ii^-1, (instance, place, column of the block)
    row_scale: wp.array2d[wp.float64]
    column_scale: wp.array2d[wp.float64]
    driving: wp.array2d[wp.float64]  # L^-1 eps
    move: wp.array2d[wp.float64]  # change of the scaled unknowns
    vector: wp.array2d[wp.float64]
    scratch: wp.array2d[wp.float64]
    # options
    gain: wp.array2d[wp.float64]  # R
    weight: wp.array2d[wp.float64]  # Q
    weight_root: wp.array2d[wp.float64]  # Q^1/2
    weight_inverse_root: wp.array2d[wp.float64]  # Q^-1/2
    initial: wp.array2d[wp.float64]  # P0
    dt: wp.array[wp.float64]  # (1,), to the next sample
    horizon: wp.float64
    fold_threshold: wp.array[wp.float64]  # (instance,)


@wp.func
def equilibrate(state: ObserverState, t: int):
    """(15) Row and column scales with which the largest entry of every row and column tends to 1."""
    n = state.rows.shape[0]
    for i in range(n):
        state.row_scale[t, i] = f64(1.0)
        state.column_scale[t, i] = f64(1.0)
    for _sweep in range(wp.static(SWEEPS)):
        for i in range(n):
            row = f64(0.0)
            column = f64(0.0)
            for j in range(n):
                a = state.gamma[t, state.rows[i], state.columns[j]]
                b = state.gamma[t, state.rows[j], state.columns[i]]
                row = wp.max(row, wp.abs(a) * state.column_scale[t, j])
                column = wp.max(column, wp.abs(b) * state.row_scale[t, j])
            state.vector[t, i] = row * state.row_scale[t, i]
            state.scratch[t, i] = column * state.column_scale[t, i]
        for i in range(n):
            if state.vector[t, i] > f64(0.0):
                state.row_scale[t, i] = state.row_scale[t, i] / wp.sqrt(state.vector[t, i])
            if state.scratch[t, i] > f64(0.0):
                state.column_scale[t, i] = state.column_scale[t, i] / wp.sqrt(state.scratch[t, i])


@wp.func
def eliminate(state: ObserverState, t: int, o: int, end: int):
    """(17) Subtract the block of rows from o to end from all rows below; the multipliers stay in its columns."""
    n = state.rows.shape[0]
    for r in range(end, n):
        coupled = f64(0.0)
        for j in range(end - o):
            total = f64(0.0)
            for i in range(end - o):
                total += state.matrix[t, r, o + i] * state.inverse[t, o + i, j]
            state.scratch[t, j] = total
            coupled = wp.max(coupled, wp.abs(total))
        # rods that do not touch each other are not coupled; NaN is
        if not coupled == f64(0.0):
            for j in range(end - o):
                state.matrix[t, r, o + j] = state.scratch[t, j]
            for c in range(end, n):
                total = state.matrix[t, r, c]
                for j in range(end - o):
                    total -= state.scratch[t, j] * state.matrix[t, o + j, c]
                state.matrix[t, r, c] = total


@wp.func
def forward(state: ObserverState, t: int, z: wp.array2d[wp.float64], begin: int):
    """``z = L^-1 z``, where z is zero before ``begin``."""
    for r in range(begin, state.rows.shape[0]):
        total = z[t, r]
        for c in range(begin, state.start[r]):
            total -= state.matrix[t, r, c] * z[t, c]
        z[t, r] = total


@wp.func
def backward(state: ObserverState, t: int, z: wp.array2d[wp.float64]):
    """``z = U^-1 z``."""
    n = state.rows.shape[0]
    end = int(n)
    while end > 0:
        o = state.start[end - 1]
        for r in range(o, end):
            total = z[t, r]
            for c in range(end, n):
                total -= state.matrix[t, r, c] * z[t, c]
            state.scratch[t, r] = total
        for r in range(o, end):
            total = f64(0.0)
            for j in range(end - o):
                total += state.inverse[t, r, j] * state.scratch[t, o + j]
            z[t, r] = total
        end = o


@wp.func
def all_finite(state: ObserverState, t: int, z: wp.array2d[wp.float64]) -> bool:
    total = f64(0.0)
    for i in range(state.rows.shape[0]):
        total += wp.abs(z[t, i])
    return wp.isfinite(total)


@cache
def make_block(n: int, riccati: str, exact: bool, newton: bool):
    """Theorem 1 on one block of n unknowns: ``drive``, and ``invert`` for its U_ii."""
    algebra = make_linear_algebra(n)
    solve, cholesky, eigen = algebra.solve, algebra.cholesky, algebra.eigen
    Vector, Matrix = algebra.Vector, algebra.Matrix
    STEADY = riccati == "steady"
    FORWARD = riccati == "forward"

    @wp.func
    def load(a: wp.array2d[wp.float64], o: int) -> Matrix:
        m = Matrix()
        for i in range(n):
            for j in range(n):
                m[i, j] = a[o + i, o + j]
        return m

    @wp.func
    def riccati_step(P: Matrix, V: Matrix, root: Vector, half: Matrix, inverse_half: Matrix, dt: f64) -> Matrix:
        """(8) Exact solution of P' = Q - P B P over dt; V and root^2 are the eigenvectors and values of Q^1/2 B Q^1/2."""
        Z = wp.transpose(V) * (inverse_half * P * inverse_half) * V
        for i in range(n):
            Z[i, i] = Z[i, i] - f64(1.0) / root[i]
        A = Matrix()
        for i in range(n):
            for j in range(n):
                decay = wp.exp(-f64(2.0) * root[j] * dt)
                A[i, j] = Z[i, j] * f64(0.5) * root[j] * (f64(1.0) - decay)
            A[i, i] = A[i, i] + f64(1.0)
        W = Matrix()
        for j in range(n):
            c = Vector()
            for i in range(n):
                c[i] = Z[i, j]
            c = solve(A, c)
            for i in range(n):
                W[i, j] = c[i] * wp.exp(-(root[i] + root[j]) * dt)
        for i in range(n):
            W[i, i] = W[i, i] + f64(1.0) / root[i]
        W = half * (V * W * wp.transpose(V)) * half
        return f64(0.5) * (W + wp.transpose(W))

    @wp.func
    def invert(state: ObserverState, t: int, o: int):
        U = Matrix()
        for i in range(n):
            for j in range(n):
                U[i, j] = state.matrix[t, o + i, o + j]
        for j in range(n):
            c = Vector()
            c[j] = f64(1.0)
            c = solve(U, c)
            for i in range(n):
                state.inverse[t, o + i, j] = c[i]

    @wp.func
    def drive(state: ObserverState, t: int, o: int, block: int) -> int:
        """Move the block's unknowns, those of the blocks after it having moved; returns its status."""
        status = int(wp.static(int(Status.TRACKING)))
        e = Vector()
        G = Matrix()
        for i in range(n):
            e[i] = state.driving[t, o + i]
            if wp.static(exact):
                for k in range(o + n, state.rows.shape[0]):
                    e[i] = e[i] + state.matrix[t, o + i, k] * state.move[t, k]
            for j in range(n):
                G[i, j] = state.matrix[t, o + i, o + j]
        gram = eigen(G * wp.transpose(G))
        smallest = gram[n, 0]
        for i in range(n):
            smallest = wp.min(smallest, gram[n, i])
        state.pivot[t, block] = wp.sqrt(wp.max(smallest, f64(0.0)))
        if wp.static(newton):
            for i in range(n):
                for j in range(n):
                    G[i, j] = f64(0.0)
                G[i, i] = f64(1.0)

        R = load(state.gain, o)
        half = load(state.weight_root, o)
        B = G * R * wp.transpose(G)
        S = eigen(half * B * half)
        V = Matrix()
        root = Vector()
        largest = f64(0.0)
        for i in range(n):
            largest = wp.max(largest, S[n, i])
        for i in range(n):
            root[i] = wp.sqrt(wp.max(S[n, i], f64(1.0e-28) * largest + f64(1.0e-300)))
            for j in range(n):
                V[i, j] = S[i, j]

        # (5) to (9): P = F F^T with F^T B F = diag(rate)
        F = Matrix()
        rate = Vector()
        if wp.static(STEADY):
            F = half * V
            for j in range(n):
                rate[j] = root[j]
                for i in range(n):
                    F[i, j] = F[i, j] / wp.sqrt(root[j])
        else:
            P = Matrix()
            if wp.static(FORWARD):
                for i in range(n):
                    for j in range(n):
                        P[i, j] = state.riccati[t, o + i, o + j]
            else:
                P = riccati_step(load(state.initial, o), V, root, half, load(state.weight_inverse_root, o), state.horizon)
            L = cholesky(P)
            E = eigen(wp.transpose(L) * B * L)
            for i in range(n):
                rate[i] = E[n, i]
                for j in range(n):
                    for k in range(n):
                        F[i, j] = F[i, j] + L[i, k] * E[k, j]
            if wp.static(FORWARD):
                if wp.static(exact):
                    P = riccati_step(P, V, root, half, load(state.weight_inverse_root, o), state.dt[0])
                else:
                    P = P + state.dt[0] * (load(state.weight, o) - P * B * P)
                    P = f64(0.5) * (P + wp.transpose(P))
                    probe = cholesky(P)
                    sound = f64(0.0)
                    for i in range(n):
                        sound += probe[i, i]
                    if not wp.isfinite(sound):
                        status = int(wp.static(int(Status.EULER_LIMIT)))
                for i in range(n):
                    for j in range(n):
                        state.riccati[t, o + i, o + j] = P[i, j]

        # (10), (11): the update over one sample
        c = wp.transpose(F) * e
        for i in range(n):
            if wp.static(exact):
                z = rate[i] * state.dt[0]
                if z > f64(1.0e-8):
                    c[i] = c[i] * (f64(1.0) - wp.exp(-z)) / rate[i]
                else:
                    c[i] = c[i] * state.dt[0]
            else:
                c[i] = c[i] * state.dt[0]
                if not (rate[i] * state.dt[0] < f64(2.0)):
                    status = int(wp.static(int(Status.EULER_LIMIT)))
            state.rates[t, o + i] = rate[i]
        dx = R * (wp.transpose(G) * (F * c))
        for i in range(n):
            total = f64(0.0)
            if wp.static(newton):
                for j in range(n):
                    total += state.inverse[t, o + i, j] * dx[j]
            else:
                total = dx[i]
            state.move[t, o + i] = -total
        return status

    return SimpleNamespace(drive=drive, invert=invert)


@cache
def make_blocks(sizes: tuple[int, ...], riccati: str, exact: bool, newton: bool):
    """``drive`` and ``invert`` of a block of any of these sizes."""
    size = sizes[0]
    block = make_block(size, riccati, exact, newton)
    if len(sizes) == 1:
        return block
    others = make_blocks(sizes[1:], riccati, exact, newton)
    drive_this, invert_this, drive_other, invert_other = block.drive, block.invert, others.drive, others.invert

    @wp.func
    def invert(state: ObserverState, t: int, o: int):
        if state.stop[o] - o == wp.static(size):
            invert_this(state, t, o)
        else:
            invert_other(state, t, o)

    @wp.func
    def drive(state: ObserverState, t: int, o: int, k: int) -> int:
        status = int(0)
        if state.stop[o] - o == wp.static(size):
            status = drive_this(state, t, o, k)
        else:
            status = drive_other(state, t, o, k)
        return status

    return SimpleNamespace(drive=drive, invert=invert)


@cache
def make_observer(
    sizes: tuple[int, ...], riccati: str, exact: bool, scaling: str, feed_forward: bool, correct_output: bool, alone: bool
):
    """Kernel of one sample for blocks of these sizes (each named once) and one reading of Theorem 1.

    ``alone`` says that there is one block only. Without a scaling, ``matrix`` and ``driving`` are then Gamma and eps themselves.
    """
    blocks = make_blocks(sizes, riccati, exact, scaling == "newton")
    drive, invert = blocks.drive, blocks.invert
    EQUILIBRATED = scaling == "equilibrated"
    COPIED = EQUILIBRATED or not alone
    INVERSES = not alone or scaling == "newton" or feed_forward or correct_output

    @own_module(max_unroll=1)
    def observe(state: ObserverState):
        t = wp.tid()
        if state.active[t] == 0:
            return
        n = state.rows.shape[0]
        size = f64(0.0)
        for i in range(n):
            size = wp.max(size, wp.abs(state.residual[t, i]))
        state.size[t] = size
        if state.fault[t] != 0 or not all_finite(state, t, state.residual):
            state.status[t] = failure_of(state.fault[t])
            return

        if wp.static(EQUILIBRATED):
            equilibrate(state, t)
        if wp.static(COPIED):
            for i in range(n):
                state.driving[t, i] = state.row_scale[t, i] * state.residual[t, state.rows[i]]
                for j in range(n):
                    a = state.gamma[t, state.rows[i], state.columns[j]]
                    state.matrix[t, i, j] = state.row_scale[t, i] * a * state.column_scale[t, j]
        if wp.static(INVERSES):
            begin = int(0)
            while begin < n:
                invert(state, t, begin)
                eliminate(state, t, begin, state.stop[begin])
                begin = state.stop[begin]
        if wp.static(not alone):
            forward(state, t, state.driving, 0)

        status = int(wp.static(int(Status.TRACKING)))
        end = int(n)
        block = state.pivot.shape[1]
        while end > 0:
            block = block - 1
            end = state.start[end - 1]
            one = drive(state, t, end, block)
            if one != wp.static(int(Status.TRACKING)):
                status = one

        if wp.static(alone):
            state.singular_value[t] = state.pivot[t, 0]
        else:
            # (19): the Frobenius norm of the inverse
            total = f64(0.0)
            for k in range(n):
                for i in range(n):
                    state.vector[t, i] = f64(0.0)
                state.vector[t, k] = f64(1.0)
                forward(state, t, state.vector, k)
                backward(state, t, state.vector)
                for i in range(n):
                    total += state.vector[t, i] * state.vector[t, i]
            state.singular_value[t] = f64(0.0)
            if wp.isfinite(total):
                state.singular_value[t] = f64(1.0) / wp.sqrt(total)

        if wp.static(feed_forward):
            # (12): what the known change of the inputs asks for
            for i in range(n):
                state.vector[t, i] = state.row_scale[t, i] * state.residual_directions[t, state.rows[i], 0]
            if wp.static(not alone):
                forward(state, t, state.vector, 0)
            backward(state, t, state.vector)
            if all_finite(state, t, state.vector):
                for i in range(n):
                    state.move[t, i] = state.move[t, i] - state.vector[t, i]
        for i in range(n):
            k = state.columns[i]
            state.following[t, k] = state.unknowns[t, k]
        if all_finite(state, t, state.move):
            for i in range(n):
                k = state.columns[i]
                state.following[t, k] = state.unknowns[t, k] + state.column_scale[t, i] * state.move[t, i]
        elif not state.singular_value[t] < state.fold_threshold[t]:
            status = int(wp.static(int(Status.NONFINITE)))
        if status == wp.static(int(Status.TRACKING)):
            # the last pivot is singular where Gamma is; an earlier one says nothing of Gamma
            early = bool(False)
            for k in range(state.pivot.shape[1] - 1):
                early = early or not (state.pivot[t, k] >= state.fold_threshold[t])
            if early and not state.singular_value[t] > f64(0.0):
                status = int(wp.static(int(Status.SINGULAR_PIVOT)))
            elif state.singular_value[t] < state.fold_threshold[t]:
                status = int(wp.static(int(Status.NEAR_FOLD)))
            elif early:
                status = int(wp.static(int(Status.SINGULAR_PIVOT)))

        if wp.static(correct_output):
            # (13): the pose at the root that one Newton step sees
            for i in range(n):
                state.vector[t, i] = state.driving[t, i]
            backward(state, t, state.vector)
            if all_finite(state, t, state.vector):
                move = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
                turn = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
                for i in range(n):
                    d = state.column_scale[t, i] * state.vector[t, i]
                    for j in range(3):
                        move[j] = move[j] - state.pose_columns[t, j, state.columns[i]] * d
                        turn[j] = turn[j] - state.pose_columns[t, 3 + j, state.columns[i]] * d
                state.position[t] = state.position[t] + move
                angle = wp.length(turn)
                if angle > f64(0.0):
                    axis = turn / angle
                    K = wp.skew(axis)
                    state.rotation[t] = (
                        state.rotation[t] + (wp.sin(angle) * K + (f64(1.0) - wp.cos(angle)) * (K * K)) * state.rotation[t]
                    )
        state.status[t] = status

    return observe
