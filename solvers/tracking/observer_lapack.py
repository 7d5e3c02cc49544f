"""One sample of the observer by LAPACK: for blocks too large for a kernel's registers, and for the plain coupling.

The same equations as in ``observer_kernels.py``, batched over the instances. Numbers are those of ``docs/observer.md``. Kernels
alone would not do: Jacobi's rotations take as long as this for 24 unknowns, three times as long for 42, those of six legs, and
eight times for 72 (``python tests/benchmarks/observer_sizes.py``).
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.kernels.warp_types import Struct
from multirod.problem import BoundaryProblem
from multirod.rotations import matrices
from multirod.solvers.tracking.observer_kernels import SWEEPS
from multirod.status import BoolArray, Fault, Status
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.solvers.observer import Observer


class LargeSample:
    """What one observer keeps between samples, and the sample itself.

    Args:
        rows: The residual at each place, in the order of the blocks.
        columns: The unknown at each place.
        sizes: Of the blocks.
        gains: R, Q and P0 as matrices, in the order of the blocks.
        options: Of the observer.
        dt: Sample time [s].
        natural: ``BoundaryProblem.natural_gamma``, which Gamma is told against where it is not equilibrated.
    """

    def __init__(
        self,
        *,
        rows: NDArray[np.intp],
        columns: NDArray[np.intp],
        sizes: list[int],
        gains: dict[str, FloatArray],
        options: "Observer",
        dt: float,
        natural: FloatArray | None = None,
    ) -> None:
        from scipy.linalg import sqrtm

        ends = np.cumsum(sizes)
        self.blocks = [slice(int(end - size), int(end)) for end, size in zip(ends, sizes, strict=True)]
        self.rows, self.columns, self.options, self.dt = rows, columns, options, dt
        self.eliminated = options.coupling != "per-rod-plain"
        self._against: FloatArray | None = None
        if natural is not None and options.scaling != "equilibrated":
            self._against = _inverse(natural[:, rows][:, :, columns])
        self.R, self.Q, self.P0 = gains["R"], gains["Q"], gains["P0"]
        self.R_root = np.real(sqrtm(self.R))
        self.Q_root = np.real(sqrtm(self.Q))

    def step(self, problem: BoundaryProblem, state: Struct) -> None:
        """Take the active instances from an integration to the unknowns of the next sample."""
        n, options = problem.unknown_count, self.options
        eps, gamma = problem.read("residual"), problem.read("gamma").reshape(-1, n, n)
        active = problem.active.numpy() != 0
        sound = active & (problem.fault.numpy() == 0) & np.isfinite(eps).all(axis=1) & np.isfinite(gamma).all(axis=(1, 2))
        kept = {
            name: getattr(state, name).numpy().copy() for name in ("status", "size", "following", "rates", "riccati", "pivot")
        }
        kept["singular_value"] = state.singular_value.numpy().copy()
        kept["size"][active] = np.abs(eps[active]).max(axis=1)
        kept["status"][active] = [Fault(fault).status for fault in problem.fault.numpy()[active]]
        if sound.any():
            slopes = problem.residual_directions.numpy()[sound, :, 0] if options.feed_forward else np.zeros((sound.sum(), n))
            found, newton = self._update(
                eps[sound], gamma[sound], slopes, kept["riccati"][sound], state.fold_threshold.numpy()[sound], sound
            )
            found["following"] += problem.read("unknowns")[sound]
            for name, values in found.items():
                kept[name][sound] = values
            if options.correct_output:
                _correct(problem, np.flatnonzero(sound), newton)
        for name, values in kept.items():
            getattr(state, name).assign(values)

    def _update(
        self, eps: FloatArray, gamma: FloatArray, slopes: FloatArray, riccati: FloatArray, fold: FloatArray, chosen: BoolArray
    ) -> tuple[dict[str, Any], FloatArray]:
        """New values of the state's arrays (``following``: the change of the unknowns), and Newton's step."""
        options, blocks, newton = self.options, self.blocks, self.options.scaling == "newton"
        scaled = gamma[:, self.rows][:, :, self.columns]
        row_scale: Any = np.ones_like(eps)
        column_scale: Any = row_scale
        if options.scaling == "equilibrated":
            row_scale, column_scale = _equilibrate(scaled)
            scaled = row_scale[:, :, None] * scaled * column_scale[:, None, :]
        alone = len(blocks) == 1
        # eps, eps_t and, for the norm of the inverse, the identity
        columns = np.stack([row_scale * eps[:, self.rows], row_scale * slopes[:, self.rows]], axis=-1)
        if self.eliminated and not alone:
            columns = np.concatenate([columns, np.broadcast_to(np.eye(eps.shape[1]), scaled.shape)], axis=-1)
        matrix = scaled.copy()
        solves = self.eliminated and (not alone or options.feed_forward or options.correct_output)
        inverses = self._eliminate(matrix, columns) if solves or newton else []

        exact = options.update == "exact"
        move, rates, pivot = np.zeros_like(eps), np.zeros_like(eps), np.zeros((len(eps), len(blocks)))
        K, A = np.zeros_like(gamma), np.zeros_like(gamma)  # gain, and gain over the sample
        beyond = np.zeros(len(eps), dtype=bool)
        for k, b in reversed(list(enumerate(blocks))):
            e = columns[:, b, 0]
            if exact and self.eliminated:
                e = e + (matrix[:, b, b.stop :] @ move[:, b.stop :, None])[..., 0]
            # a singular pivot makes NaN of what comes after it; eps carries them on
            U = np.nan_to_num(matrix[:, b, b])
            pivot[:, k] = np.linalg.svd(U, compute_uv=False)[:, -1]
            driven = np.broadcast_to(np.eye(U.shape[1]), U.shape) if newton else U
            left, rate, right, riccati[:, b, b], lost = self._law(driven, b, riccati[:, b, b])
            if newton:
                left = inverses[k] @ left
            z = np.maximum(rate * self.dt, 1e-300)
            K[:, b, b] = left @ right
            A[:, b, b] = (left * (-np.expm1(-z) / z)[:, None, :]) @ right if exact else K[:, b, b]
            move[:, b] = -self.dt * (A[:, b, b] @ e[..., None])[..., 0]
            rates[:, b] = rate
            beyond |= lost | ((rate * self.dt >= 2).any(axis=1) & (not exact))

        unstable = np.zeros(len(eps), dtype=bool)
        if not self.eliminated:
            # (20): the closed loop in continuous time, and over a sample
            smallest = np.linalg.svd(scaled, compute_uv=False)[:, -1]
            loops = np.nan_to_num(scaled @ K, nan=-1.0), np.nan_to_num(scaled @ A, nan=-1.0)
            rates = np.asarray(np.linalg.eigvals(loops[0]).real, dtype=np.float64)
            growth = np.abs(1 - self.dt * np.linalg.eigvals(loops[1])).max(axis=1)
            unstable = (rates.min(axis=1) <= 0) | ((growth >= 1) & exact)
            beyond |= ~unstable & (growth >= 1)
        else:
            smallest = pivot[:, 0]
            if solves:
                self._back_substitute(matrix, inverses, columns)
            if not alone:
                norm = np.sqrt((columns[..., 2:] ** 2).sum(axis=(1, 2)))
                smallest = np.where(np.isfinite(norm), 1 / norm, 0.0)
        if options.feed_forward:
            move -= np.where(np.isfinite(columns[..., 1]).all(axis=1, keepdims=True), columns[..., 1], 0.0)
        held = ~np.isfinite(move).all(axis=1)
        move[held] = 0.0

        early = (pivot[:, :-1] < fold[:, None]).any(axis=1) & self.eliminated
        if self._against is not None:  # (26)
            relative = np.abs(np.linalg.eigvals(np.nan_to_num(scaled @ self._against[chosen]))).min(axis=1)
            smallest, fold = np.where(smallest > 0, relative, 0.0), np.full_like(fold, options.fold_threshold)
        status = np.select(
            [beyond, unstable, held & (smallest >= fold), early & (smallest == 0), smallest < fold, early],
            [
                int(Status.EULER_LIMIT),
                int(Status.UNSTABLE_COUPLING),
                int(Status.NONFINITE),
                int(Status.SINGULAR_PIVOT),
                int(Status.NEAR_FOLD),
                int(Status.SINGULAR_PIVOT),
            ],
            int(Status.TRACKING),
        )
        order = np.argsort(self.columns)
        found = {"status": status, "rates": rates, "riccati": riccati, "pivot": pivot, "singular_value": smallest}
        found["following"] = (column_scale * move)[:, order]
        return found, (column_scale * columns[..., 0])[:, order]

    def _eliminate(self, matrix: FloatArray, columns: FloatArray) -> list[FloatArray]:
        """(17) In place: U in ``matrix``, on and above its blocks' diagonal, and L^-1 ``columns``. Returns each U_ii^-1."""
        inverses = []
        for b in self.blocks:
            inverses.append(_inverse(matrix[:, b, b]))
            if self.eliminated:
                L = matrix[:, b.stop :, b] @ inverses[-1]
                matrix[:, b.stop :, b.stop :] -= L @ matrix[:, b, b.stop :]
                columns[:, b.stop :] -= L @ columns[:, b]
        return inverses

    def _back_substitute(self, matrix: FloatArray, inverses: list[FloatArray], columns: FloatArray) -> None:
        for b, inverse in zip(reversed(self.blocks), reversed(inverses), strict=True):
            columns[:, b] = inverse @ (columns[:, b] - matrix[:, b, b.stop :] @ columns[:, b.stop :])

    def _law(self, U: FloatArray, b: slice, P: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:
        """(5) to (9) on one block: ``left, rate, right, next P, lost`` with R U^T P = left right and right U left = diag(rate).

        ``lost`` says where an explicit step of P would have lost P > 0; P is then left as it was.
        """
        options = self.options
        R, Q, R_root, Q_root = self.R[b, b], self.Q[b, b], self.R_root[b, b], self.Q_root[b, b]
        lost = np.zeros(len(U), dtype=bool)
        if options.riccati == "steady":
            W, rate, V = np.linalg.svd(Q_root @ U @ R_root)
            # what Gamma does not see has no direction to move in
            V *= (rate > 1e-14 * rate[:, :1])[:, :, None]
            return R_root @ np.swapaxes(V, 1, 2), rate, np.swapaxes(W, 1, 2) @ Q_root, P, lost
        B = U @ R @ np.swapaxes(U, 1, 2)
        present = _riccati_step(self.P0[b, b], B, Q_root, options.horizon) if options.riccati == "horizon" else P
        factor = np.linalg.cholesky(present)
        rate, E = np.linalg.eigh(np.swapaxes(factor, 1, 2) @ B @ factor)
        F = factor @ E
        if options.riccati == "forward" and options.update == "exact":
            P = _riccati_step(P, B, Q_root, self.dt)
        elif options.riccati == "forward":
            explicit = P + self.dt * (Q - P @ B @ P)
            explicit = (explicit + np.swapaxes(explicit, 1, 2)) / 2
            lost = ~(np.linalg.eigvalsh(explicit)[:, 0] > 0)
            P = np.where(lost[:, None, None], P, explicit)
        return R @ np.swapaxes(U, 1, 2) @ F, rate, np.swapaxes(F, 1, 2), P, lost


def _riccati_step(P: FloatArray, B: FloatArray, Q_root: FloatArray, dt: float) -> FloatArray:
    """(8) Exact solution of P' = Q - P B P over dt."""
    values, V = np.linalg.eigh(Q_root @ B @ Q_root)
    root = np.sqrt(np.maximum(values, 1e-28 * values[:, -1:]))
    inverse_root = np.linalg.inv(Q_root)
    steady = np.eye(B.shape[1]) / root[:, None, :]
    Z = np.swapaxes(V, 1, 2) @ inverse_root @ P @ inverse_root @ V - steady
    growth = 0.5 * root * -np.expm1(-2 * root * dt)
    decay = np.exp(-root * dt)
    # Z (I + G Z)^-1 = (I + Z G)^-1 Z
    Z = np.linalg.solve(np.eye(B.shape[1]) + Z * growth[:, None, :], Z)
    P = Q_root @ V @ (decay[:, :, None] * Z * decay[:, None, :] + steady) @ np.swapaxes(V, 1, 2) @ Q_root
    return np.asarray((P + np.swapaxes(P, 1, 2)) / 2)


def _inverse(matrices: FloatArray) -> FloatArray:
    """Inverses, NaN where there is none."""
    try:
        return np.asarray(np.linalg.inv(matrices), dtype=np.float64)
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full_like(matrices, np.nan)
        return np.concatenate([_inverse(one[None]) for one in matrices])


def _equilibrate(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(15) Row and column scales with which the largest entry of every row and column tends to 1."""
    rows: Any = np.ones(matrix.shape[:2])
    columns: Any = np.ones(matrix.shape[:2])
    for _ in range(SWEEPS):
        size = np.abs(rows[:, :, None] * matrix * columns[:, None, :])
        largest = size.max(axis=2), size.max(axis=1)
        rows, columns = (
            scale / np.sqrt(np.where(size > 0, size, 1.0)) for scale, size in zip((rows, columns), largest, strict=True)
        )
    return rows, columns


def _correct(problem: BoundaryProblem, chosen: NDArray[np.intp], newton: FloatArray) -> None:
    """(13) Move the reported pose of the instances ``chosen`` by Newton's step."""
    n = problem.unknown_count
    shift = -(problem.pose_columns.numpy()[chosen][:, :, :n] @ newton[..., None])[..., 0]
    shift[~np.isfinite(shift).all(axis=1)] = 0.0
    position, rotation = problem.read("position"), problem.read("rotation")
    position[chosen] += shift[:, :3]
    rotation = rotation.reshape(-1, 3, 3)
    rotation[chosen] = matrices(shift[:, 3:]) @ rotation[chosen]
    problem.position.assign(position)
    problem.rotation.assign(rotation)
