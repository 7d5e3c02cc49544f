"""The path from the network taken apart to the network: what is open where loads are zero, and how it closes.

Numbers in parentheses are those of ``docs/networks.md``.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from multirod.capabilities import Loading
from multirod.models.joint_kernels import AT_REST
from multirod.models.network.elements.elements import GAP_AT, POSE
from multirod.models.network.joining.joints import MOST
from multirod.models.network.places import FOLLOWING, LOADED
from multirod.models.network.starting import Apart, taken_apart
from multirod.problem import STILL, BoundaryProblem, neutral_ways
from multirod.status import BoolArray
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem

CLOSED = 1e-4  # of a length, that a gap is closed to
REGULAR = 1e-8  # least singular value of a network that is not singular, of the largest
AWAY = 1.5  # of the length of all rods together, by which what slides that no spring holds has slid away
GAP_LOAD = 12.0  # EI/L^3: what a rod resists with where its tip is moved across
ARRAYS = ("opening", "soft", "shift", "loading")
BESIDE = ("fault", "step_count", "residual_directions", "pose_columns")  # what an integration writes beside the records


class Closing:
    """Of a ``NetworkProblem``.

    Attributes:
        opening: Residual where ``load_factor`` is 0, shape (instance_count, n).
        soft: Whether ends of rods give way on the way, shape (instance_count,).
        shift: (29) Where tips are held there, in the frames of the bodies [m], shape (instance_count, rod, 3).
        loading: How loads act on the way, values of ``Loading``, shape (instance_count,).
    """

    def __init__(self, problem: "NetworkProblem") -> None:
        self.problem = problem
        # as NumPy sees what the kernels read
        own = problem.networks
        self.opening: FloatArray = own.opening.numpy()
        self.soft: FloatArray = own.soft.numpy()
        self.shift: FloatArray = own.shift.numpy()
        self.loading: NDArray[np.int32] = own.loading.numpy()
        self.clear()

    def clear(self) -> None:
        """As at first."""
        self.opening[:], self.soft[:], self.shift[:] = 0.0, 0.0, 0.0
        self.loading[:] = int(Loading.RISING)

    def write(self) -> None:
        """To the kernels' arrays, where they are elsewhere."""
        for name in ARRAYS:
            getattr(self.problem.networks, name).assign(getattr(self, name))

    def level(self) -> FloatArray:
        """What multiplies the loads of each instance, shape (instance_count,)."""
        factor = self.problem.buffer("load_factor")
        return np.where(self.loading == int(Loading.NONE), 0.0, np.where(self.loading == int(Loading.FULL), 1.0, factor))

    def is_closed(self) -> BoolArray:
        """Whether no gap is open where rods were integrated last, shape (instance_count,)."""
        problem, held = self.problem, self.problem.graph.ends[1].held
        length = np.repeat(problem.length[:, : problem.rod_count][:, held], 3, axis=1)
        gaps = problem.read("residual")[:, problem.places[held, GAP_AT].reshape(-1)] * length
        return np.asarray(np.abs(gaps).max(axis=1, initial=0.0) < CLOSED)

    def begin(self) -> FloatArray:
        """Rods at rest, and bodies where they fit them best (``docs/networks.md``, 13).

        What the residual is there is remembered and closes as ``load_factor`` goes from 0 to 1, (12).
        """
        apart = self.apart()
        self.open_at(apart.unknowns, apart.residual, apart.turned)
        return np.array(apart.unknowns)

    def open_at(self, unknowns: FloatArray, residual: FloatArray, turned: FloatArray) -> None:
        """Make ``unknowns`` an equilibrium where ``load_factor`` is 0, by the residual there and what ``Apart.turned`` is there.

        Ends of rods give way on the way only where no rod carries a force yet.
        """
        held = np.flatnonzero(self.problem.graph.ends[1].held)
        gaps, self.opening[:] = self.problem.places[held, GAP_AT], residual
        # (29) in the frames of what holds the tips
        gap = self.problem.length[:, held, None] ** 2 * residual[:, gaps]
        self.shift[:], self.opening[:, gaps] = 0.0, 0.0
        self.shift[:, held] = (turned[:, held] @ gap[..., None])[..., 0]
        forces = unknowns[:, self.problem._forces(np.arange(self.problem.rod_count))]
        self.soft[:] = np.abs(forces).max(axis=1) < AT_REST * self.problem.curvature_scale()

    def singular_value(self) -> FloatArray:
        """That at ``guess``, 1 at most."""
        gamma, least, own = self.apart().gamma, np.ones(self.problem.instance_count), self.problem.entries
        for k in np.flatnonzero(np.isfinite(gamma).all(axis=1)).tolist():
            if own.elimination is not None:
                least[k] = own.elimination.least_singular_value(gamma[k])
            else:
                least[k] = np.linalg.svd(own.dense(gamma[k]), compute_uv=False)[-1]
        return np.minimum(least, 1.0)

    def natural_gamma(self) -> FloatArray:
        """Of the network taken apart; where that is singular, with ends that give way, as at ``guess``."""
        problem, apart = self.problem, self.apart()
        soft = problem.entries.dense(apart.gamma)
        with self.unloaded(), np.errstate(all="ignore"):
            problem.write("unknowns", apart.unknowns)
            problem.integrate()
            hard = problem.entries.dense(self.numbers())
        values = np.linalg.svd(np.nan_to_num(hard, posinf=0.0, neginf=0.0), compute_uv=False)
        regular = np.isfinite(hard).all(axis=(1, 2)) & (values[:, -1] > REGULAR * values[:, 0])
        return np.where(regular[:, None, None], hard, soft)

    def loose(self) -> list[str]:
        """(33) Told by the network taken apart and unloaded, whose rods give way along themselves."""
        names, gamma = [""] * self.problem.instance_count, self.apart().gamma
        rods = np.concatenate([self.problem.places[k, :own] for k, own in enumerate(self.problem.graph.own.tolist())])
        for k in np.flatnonzero(np.isfinite(gamma).all(axis=1)).tolist() if self.problem.body_count else ():
            neutral = neutral_ways(self.problem.entries.dense(gamma[k]))
            if len(neutral) and np.abs(neutral[:, rods]).max() < STILL:
                moves = neutral[:, self.problem.first_pose :].reshape(len(neutral), self.problem.body_count, POSE).copy()
                moves[..., :3] *= self.problem.length[k, None, self.problem.rod_count :, None]
                names[k] = self.problem.graph.moving[int(np.linalg.norm(moves, axis=(0, 2)).argmax())].name
        return names

    def apart(self) -> Apart:
        """The network taken apart at the present inputs; found once for all who ask."""
        inputs = self.problem.read("inputs")[:, : self.problem.input_slice(LOADED[0]).start]
        return self.problem.found_for("apart", inputs, lambda: taken_apart(self.problem))

    def numbers(self) -> FloatArray:
        """What is kept of ``Gamma``, shape (instance_count, k)."""
        problem = self.problem
        if problem.elimination is None:
            return problem.read("gamma")
        return problem.numbers_of_gamma(np.arange(problem.instance_count))

    def newton_step(self, numbers: FloatArray, residual: FloatArray) -> FloatArray:
        """Newton's step [1/m] by the ``numbers`` that are kept of ``Gamma``, (instance_count, k), shape (instance_count, n); NaN
        where ``Gamma`` is singular."""
        result = np.full(residual.shape, np.nan)
        for k in np.flatnonzero(np.isfinite(residual).all(axis=1) & np.isfinite(numbers).all(axis=1)).tolist():
            if self.problem.elimination is not None:
                result[k] = -self.problem.elimination.solved(numbers[k], residual[k])
                continue
            try:
                result[k] = -np.linalg.solve(self.problem.entries.dense(numbers[k]), residual[k])
            except np.linalg.LinAlgError:
                continue
        return result

    @contextmanager
    def unloaded(self) -> Iterator[None]:
        """Within it, all instances may be evaluated without loads; everything is as it was afterwards."""
        values = [np.array(self.problem.buffer(name)) for name in BESIDE]
        records = self.problem.snapshot()
        own = [np.array(values) for values in (self.opening, self.soft, self.loading, self.shift)]
        self.opening[:], self.soft[:], self.loading[:], self.shift[:] = 0.0, 0.0, int(Loading.NONE), 0.0
        try:
            with self.problem.everyone(), self.problem.at_load(0.0):
                yield
        finally:
            self.problem.restore(records)
            for name, before in zip(BESIDE, values, strict=True):
                self.problem.set_buffer(name, before)
            self.opening[:], self.soft[:], self.loading[:], self.shift[:] = own


class Loaded(BoundaryProblem):
    """What acts on a network, in numbers."""

    @property
    def periods(self) -> FloatArray | None:
        """(47), (48) As of ``BoundaryProblem``, of joints that torques turn, or that slide, and no spring holds."""
        problem = cast("NetworkProblem", self)
        torques, ends = problem._slices.get("joint_torque"), problem.graph.ends
        pushed = torques is not None and bool(problem.read("inputs")[:, torques].any())
        slides = any((end.table.slides & (end.table.stiffness == 0) & ~end.table.driven[:, None]).any() for end in ends)
        if not pushed and not slides:
            return None
        result = np.full((problem.instance_count, problem.unknown_count), np.inf)
        result[:, problem.first_pose :] = 0.0
        length = problem.length
        away = -AWAY * length[:, : problem.rod_count].sum(axis=1, keepdims=True) / length**2
        for end, at in zip(ends, problem.layout.angles_at, strict=True):
            table, places = end.table, problem.places[:, at]
            balls = np.broadcast_to(table.count[:, None] == MOST, places.shape)
            free = ~balls & (table.stiffness == 0)
            turning = 2 * np.pi / length if pushed else np.full(1, np.inf)
            for some, value in ((balls, np.zeros(1)), (free & ~table.slides, turning), (free & table.slides, away)):
                rods, which = np.nonzero(some & (places >= 0))
                result[:, places[rods, which]] = np.broadcast_to(value, problem.length.shape)[:, rods]
        return result

    def unheld(self, instance: int) -> str:
        """Joints without a spring that torques turn, or that slide, (47), (48); rods that what acts along them turns, (46)."""
        problem = cast("NetworkProblem", self)
        graph, found = problem.graph, list[tuple[str, str]]()
        pushes = graph.pushes(problem.read("inputs")[:, problem.pushed_place])
        real = graph.slides.first, graph.slides.last  # ends of rods as given
        for name, end, at, push, ends in zip(("base", "tip"), graph.ends, problem.layout.angles_at, pushes, real, strict=True):
            table = end.table
            free = (problem.places[:, at] >= 0) & (table.stiffness == 0) & ends[:, None]
            turned = free & ~table.slides & (push[instance] != 0)
            for how, some in (("against turning", turned), ("along its slide", free & table.slides)):
                owners = graph.slides.owner[some.any(axis=1)].tolist()
                found += [(f"joint {f'{graph.whole_names[rod]} {name}'!r}", how) for rod in owners]
        if not found and self.result_test is not None:
            found = [(f"rod {own.name!r}", "against turning about itself") for own in graph.turning]
        said = [f"{what} {how}" for what, how in found]
        return f" (nothing holds {', nor '.join(said)})" if said else ""

    def load_scale(self) -> FloatArray:
        """What acts on rods, bodies and tips, and how far tips are from where they are to be: a turn is a moment in ``EI/L``."""
        problem = cast("NetworkProblem", self)
        return problem.found_for("load_scale", problem.read("inputs"), lambda: _load_scale(problem)).copy()

    def load_change(self, before: FloatArray) -> FloatArray:
        """As of ``BoundaryProblem``, of what acts on bodies and tips, and of the weight of bodies."""
        problem = cast("NetworkProblem", self)
        return _load_on_bodies(problem, problem.read("inputs") - before) / _least_part(problem)


def _least_part(problem: "NetworkProblem") -> float:
    """The least stiffness of a rod, in bending or torsion, over the most in bending, which loads are counted in."""
    every = [own.material[..., :3].min(axis=-1) / own.material[..., :2].max(axis=-1) for own in problem.graph.arrays]
    return float(min(part.min() for part in every))


def _load_scale(problem: "NetworkProblem") -> FloatArray:
    problem.hand_over()
    own = [group.backbones.load_scale().reshape(problem.instance_count, -1).max(axis=1) for group in problem.groups]
    total = np.sum(own, axis=0)
    inputs, L, EI = problem.read("inputs"), problem.length, problem.stiffness
    total += _load_on_bodies(problem, inputs)
    for push in problem.graph.pushes(inputs[:, problem.pushed_place]):
        total += (np.abs(push).sum(axis=2) * (L / EI)[:, : problem.rod_count]).sum(axis=1)
    held = problem.graph.ends[1].held
    if held.any():
        gap = problem.closing.apart().residual[:, problem.places[held, :6]] * L[:, : problem.rod_count][:, held, None]
        total += (GAP_LOAD * np.linalg.norm(gap[..., :3], axis=2) + np.linalg.norm(gap[..., 3:], axis=2)).max(axis=1)
    return np.asarray(total)


def _load_on_bodies(problem: "NetworkProblem", inputs: FloatArray) -> FloatArray:
    """What ``inputs`` (instance_count, input_count), or a change of them, are on bodies and tips, shape (instance_count,)."""
    L, EI, total = problem.length, problem.stiffness, np.zeros(problem.instance_count)
    first, bodies = problem.rod_count, slice(problem.rod_count, None)
    rods = [*range(first, first + len(problem.graph.bodies)), *problem.graph.free, *(first + problem.graph.framed)]
    for name, power in zip((*LOADED, *FOLLOWING), (2, 1, 2, 1), strict=True):
        given = inputs[:, problem.input_slice(name)]
        if not given.any():
            continue
        size = np.linalg.norm(given.reshape(problem.instance_count, -1, 3), axis=2)
        total += (size * L[:, rods] ** power / EI[:, rods]).sum(axis=1)
    gravity = np.linalg.norm(inputs[:, problem.input_slice("gravity")], axis=1)
    return np.asarray(total + gravity * (problem.graph.mass * L[:, bodies] ** 2 / EI[:, bodies]).sum(axis=1))
