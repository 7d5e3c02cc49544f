# mypy: ignore-errors
"""One sample of the nonlinear observer, between two integrations. Numbers are those of ``docs/observer.md``."""

from functools import cache

import warp as wp

from multirod.solvers.linear_algebra_kernels import make_linear_algebra
from multirod.status import Status


@wp.struct
class ObserverState:
    """What the observer reads and writes; the first axis is the instance."""

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
    singular_value: wp.array[wp.float64]  # smallest of Gamma
    # options
    gain: wp.array2d[wp.float64]  # R
    weight: wp.array2d[wp.float64]  # Q
    weight_root: wp.array2d[wp.float64]  # Q^1/2
    weight_inverse_root: wp.array2d[wp.float64]  # Q^-1/2
    initial: wp.array2d[wp.float64]  # P0
    dt: wp.float64
    horizon: wp.float64
    fold_threshold: wp.float64


@cache
def make_observer(n: int, riccati: str, exact: bool, feed_forward: bool, correct_output: bool):
    """Kernel of one sample for n unknowns and one reading of Theorem 1."""
    f64 = wp.float64
    algebra = make_linear_algebra(n)
    solve, cholesky, eigen = algebra.solve, algebra.cholesky, algebra.eigen
    Vector, Matrix = algebra.Vector, algebra.Matrix
    STEADY = riccati == "steady"
    FORWARD = riccati == "forward"

    @wp.func
    def load(a: wp.array2d[wp.float64]) -> Matrix:
        m = Matrix()
        for i in range(n):
            for j in range(n):
                m[i, j] = a[i, j]
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

    @wp.kernel(module="unique", enable_backward=False)
    def observe(state: ObserverState):
        t = wp.tid()
        if state.active[t] == 0:
            return
        e = Vector()
        G = Matrix()
        size = f64(0.0)
        for i in range(n):
            e[i] = state.residual[t, i]
            size = wp.max(size, wp.abs(e[i]))
            for j in range(n):
                G[i, j] = state.gamma[t, i, j]
        state.size[t] = size
        if state.fault[t] != 0 or not wp.isfinite(size):
            state.status[t] = int(wp.static(int(Status.NONFINITE)))
            return
        status = int(wp.static(int(Status.TRACKING)))

        R = load(state.gain)
        half = load(state.weight_root)
        B = G * R * wp.transpose(G)
        S = eigen(half * B * half)
        V = Matrix()
        root = Vector()
        largest = f64(0.0)
        for i in range(n):
            largest = wp.max(largest, S[n, i])
        for i in range(n):
            root[i] = wp.sqrt(wp.max(S[n, i], f64(1.0e-28) * largest))
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
                        P[i, j] = state.riccati[t, i, j]
            else:
                P = riccati_step(load(state.initial), V, root, half, load(state.weight_inverse_root), state.horizon)
            L = cholesky(P)
            E = eigen(wp.transpose(L) * B * L)
            for i in range(n):
                rate[i] = E[n, i]
                for j in range(n):
                    for k in range(n):
                        F[i, j] = F[i, j] + L[i, k] * E[k, j]
            if wp.static(FORWARD):
                if wp.static(exact):
                    P = riccati_step(P, V, root, half, load(state.weight_inverse_root), state.dt)
                else:
                    P = P + state.dt * (load(state.weight) - P * B * P)
                    P = f64(0.5) * (P + wp.transpose(P))
                    probe = cholesky(P)
                    sound = f64(0.0)
                    for i in range(n):
                        sound += probe[i, i]
                    if not wp.isfinite(sound):
                        status = int(wp.static(int(Status.EULER_LIMIT)))
                for i in range(n):
                    for j in range(n):
                        state.riccati[t, i, j] = P[i, j]

        # (10), (11): the update over one sample
        c = wp.transpose(F) * e
        for i in range(n):
            if wp.static(exact):
                z = rate[i] * state.dt
                if z > f64(1.0e-8):
                    c[i] = c[i] * (f64(1.0) - wp.exp(-z)) / rate[i]
                else:
                    c[i] = c[i] * state.dt
            else:
                c[i] = c[i] * state.dt
                if not (rate[i] * state.dt < f64(2.0)):
                    status = int(wp.static(int(Status.EULER_LIMIT)))
            state.rates[t, i] = rate[i]
        dx = R * (wp.transpose(G) * (F * c))
        moved = f64(0.0)
        for i in range(n):
            dx[i] = state.unknowns[t, i] - dx[i]
        if wp.static(feed_forward):
            # (12): what the known change of the inputs asks for
            b = Vector()
            for i in range(n):
                b[i] = state.residual_directions[t, i, 0]
            b = solve(G, b)
            if wp.isfinite(wp.dot(b, b)):
                dx = dx - b
        for i in range(n):
            moved += wp.abs(dx[i])
        for i in range(n):
            if wp.isfinite(moved):
                state.following[t, i] = dx[i]
            else:
                state.following[t, i] = state.unknowns[t, i]
        if not wp.isfinite(moved):
            status = int(wp.static(int(Status.NONFINITE)))

        gram = eigen(G * wp.transpose(G))
        smallest = gram[n, 0]
        for i in range(n):
            smallest = wp.min(smallest, gram[n, i])
        state.singular_value[t] = wp.sqrt(wp.max(smallest, f64(0.0)))
        if status == wp.static(int(Status.TRACKING)) and state.singular_value[t] < state.fold_threshold:
            status = int(wp.static(int(Status.NEAR_FOLD)))

        if wp.static(correct_output):
            # (13): the pose at the root that one Newton step sees
            d = solve(G, e)
            if wp.isfinite(wp.dot(d, d)):
                move = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
                turn = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
                for k in range(n):
                    for j in range(3):
                        move[j] = move[j] - state.pose_columns[t, j, k] * d[k]
                        turn[j] = turn[j] - state.pose_columns[t, 3 + j, k] * d[k]
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
