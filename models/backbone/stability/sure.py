"""Stability that is beyond doubt, of few instances in one launch, of many by few steps: of most results nothing else is asked."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.kernels.repeated_kernels import callable_from_kernels
from multirod.kernels.shared import Shared
from multirod.launch import record
from multirod.models.backbone.nodes.correction import NEAR, Ends
from multirod.models.backbone.nodes.node_pass import NodePass
from multirod.models.backbone.passes.lane_pass import LanePass
from multirod.models.backbone.stability.condensing.forms import CompiledForm, form_of
from multirod.models.backbone.stability.node_numbers import FEWEST_NODES
from multirod.models.backbone.stability.sure_kernels import Sure, make_sure
from multirod.stability import NEUTRAL
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

LATE = 8  # looks
MOST_NODES = 33  # of many instances
MISSES = 8  # of looks by one step between two nodes, where the integrator's own then say more: from then on these come first
# by one step between two nodes: how much nearer the solve it is to end, and what eigenvalues are to be more than over ``K/L``,
# beside so many times what the form lacks of symmetry: near where stability is lost they were off by 1e-4
NEARER, CLEAR, SPARE = 10.0, 1e-2, 100.0


def may_be_sure(problem: "BackboneProblem") -> bool:
    """Whether a problem is one of those that ``SureStability`` looks at: free rods under loads with a potential, on the CPU."""
    own = problem.features
    others = (own.members, own.eccentric, own.loads, own.measured, own.friction, own.profile_degree >= 0)
    return (
        own.moment
        and not any(others)
        and not (problem.held or problem.breakpoints or (own.turning_count and problem.sizes.rigid_in_torsion))
        and wp.get_device(problem.device).is_cpu
        and isinstance(problem.launch, LanePass)
    )


def surely_stable(
    problem: "BackboneProblem", expected: FloatArray, segments_of: Callable[[NodePass], FloatArray]
) -> NDArray[np.bool_]:
    """Which of many instances are surely stable by one step between two nodes, shape (instance_count,); of the others it says
    nothing.

    Args:
        problem: Of which ``may_be_sure`` holds, all of whose loads have a potential.
        expected: How many segments each will call for, shape (instance_count,).
        segments_of: How many each calls for, by the pass.
    """
    most = min(np.nanmax(expected, initial=0.0), MOST_NODES - 2.0)
    made = problem.nodes.of_all(max(FEWEST_NODES, 1 + ceil(most + 1e-6)), one_step=True)
    made.launch.launch()
    apart = Ends.of(made).apart(Ends.of(problem), problem.sizes.furthest_end())
    enough = segments_of(made) < len(made.read("node_moment")[0])
    result = np.asarray((made.read("fault") == 0) & (apart < NEAR / NEARER) & enough)
    if not result.any():
        return result
    unit = problem.sizes.stiffness_over_length()
    condensed = form_of(made, 3 + problem.features.turning_count, len(problem.rods), problem.device)
    form = condensed.of(result, problem.sizes.ends(), unit)
    result[result] = form.known & (form.conjugate == 0) & _clearly_positive(form.matrix / unit[result, None, None])
    return result


def _clearly_positive(form: FloatArray) -> NDArray[np.bool_]:
    """Whether all eigenvalues of forms (k, m, m) over ``K/L`` are so clearly positive that one step between two nodes tells."""
    turned = form.swapaxes(1, 2)
    result: NDArray[np.bool_] = np.asarray(np.isfinite(form).all(axis=(1, 2)))
    lacking = np.sqrt(((form - turned)[result] ** 2).sum(axis=(1, 2))) / 2
    result[result] = np.linalg.eigvalsh((form + turned)[result] / 2)[:, 0] > CLEAR + SPARE * lacking
    return result


class SureStability:
    """Finds which equilibria of few instances are surely stable, as ``BackboneStability.modes`` would.

    Args:
        problem: Of which ``may_be_sure`` holds.

    Attributes:
        needed: Segments that the last look called for; 0 before the first.
        usual: The most that looks of late called for: one that comes short costs more than nodes that were not called for.
        nodes: How many of them so many segments take, as far as was asked.
    """

    def __init__(self, problem: "BackboneProblem") -> None:
        self._problem = problem
        self.needed = 0.0
        self.nodes: dict[tuple[int, bool], int] = {}
        self._late: deque[float] = deque([0.0], maxlen=LATE)
        self._looks: dict[tuple[int, bool], _Look | None] = {}  # by nodes and steps; None where a kernel cannot launch others
        self._missed = 0

    @property
    def has_potential(self) -> bool:
        """Whether all loads on all instances have a potential: of what ``may_be_sure`` lets through only those of the tip may
        have none."""
        inputs = self._problem.input_view()
        return inputs is not None and not (len(self._without) and np.count_nonzero(inputs[:, self._without]))

    @cached_property
    def _without(self) -> NDArray[np.intp]:
        """Where loads without a potential stand in a row of inputs, of those that are compiled in: others are zero."""
        problem = self._problem
        every, loads = np.arange(problem.input_count), problem.sizes.loads
        return np.concatenate(
            [every[:0], *(every[own] for spec, own in loads if not spec.potential and problem.takes(spec.name))]
        )

    @property
    def usual(self) -> float:  # noqa: D102
        return max(self._late)

    def holds(self, nodes: int) -> bool:
        """Whether all instances are stable at the problem's unknowns, by so many nodes; False says nothing.

        One step between two nodes tells what is far from losing stability in half of the time; what it does not is told by the
        integrator's own steps.
        """
        if self._missed < MISSES:
            look = self._looked(nodes, one_step=True)
            if look is not None and all(look.sure.tolist()):
                return True
            if self.needed >= nodes:
                return False
        look = self._looked(nodes)
        sure = look is not None and all(look.sure.tolist())
        self._missed += sure
        return sure

    def lowest(self, nodes: int) -> FloatArray | None:
        """The lowest eigenvalue of all instances by so many nodes, as ``Modes`` has it, shape (instance_count,); None says
        nothing."""
        look = self._looked(nodes)
        if look is None or not all(look.told.tolist()):
            return None
        unit = look.form.values("unit")[:, None, None]
        form = look.form.values("matrix") / unit
        return np.asarray(np.linalg.eigvalsh((form + form.swapaxes(1, 2)) / 2)[:, 0])

    def _looked(self, nodes: int, *, one_step: bool = False) -> "_Look | None":
        """By so many nodes, launched."""
        key = nodes, one_step
        if key not in self._looks:
            self._looks[key] = self._made(nodes, one_step)
        look = self._looks[key]
        if look is not None:
            look.launch()
            self.needed = max(look.needed.tolist())  # of few: NumPy's own take longer
            self._late.append(self.needed)
        return look

    def _made(self, nodes: int, one_step: bool) -> "_Look | None":
        problem = self._problem
        made: NodePass = problem.nodes.of_all(nodes, one_step=one_step)
        free, n, device, count = 3 + problem.features.turning_count, len(problem.rods), problem.device, problem.instance_count
        form = form_of(made, free, n, device)
        form.want_all()
        if made.launch.recorded is None:
            return None
        calls = [callable_from_kernels(launches) for launches in (made.launch.recorded, (form.launch,))]
        if None in calls:
            return None
        state: Any = Sure()
        problem.share(state, ("inputs", "fault", "position", "rotation"))
        state.first, state.near = problem.input_slice("translation").start, NEAR / 3 / (NEARER if one_step else 1.0)
        state.least, state.spare = (CLEAR, SPARE) if one_step else (NEUTRAL, 1.0)
        bend, _, kappa = problem.sizes.bend_by_section
        if not problem.features.turning_count:
            bend, kappa = np.zeros_like(bend), np.zeros_like(kappa)
        constants = {"length": problem.each(problem.arrays.end[:, :, -1]), "stiffness": problem.sizes.least_stiffness}
        for name, values in (constants | {"bend": bend, "kappa": kappa}).items():
            setattr(state, name, wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=device))
        for name in ("column_arclength", "node_curvature", "node_moment", "node_force"):
            setattr(state, name, getattr(made.call, name))
        state.node_position, state.node_rotation = made.call.problem.position, made.call.problem.rotation
        for name in ("ends", "unit", "matrix", "conjugate", "known", "open"):
            setattr(state, name, form.array(name))
        needed, sure, told = (Shared((count,), kind, device) for kind in (wp.float64, wp.int32, wp.int32))
        state.needed, state.sure, state.told = needed.array, sure.array, told.array
        state.work = wp.zeros((count, free, free), dtype=wp.float64, device=device)
        launch = record(make_sure, 1, [state, *calls], device)
        return _Look(launch.launch, needed.values, sure.values, told.values, form, (made, state, *calls))


@dataclass(frozen=True)
class _Look:
    """By some number of nodes.

    Attributes:
        launch: Looks.
        needed: Segments that each instance called for, shape (instance_count,).
        sure: Which are surely stable, likewise.
        told: Of which the form is known, with no unstable mode that it does not show, likewise.
        form: What condenses the columns.
        kept: What the launch works in.
    """

    launch: Callable[[], None]
    needed: FloatArray
    sure: NDArray[np.int32]
    told: NDArray[np.int32]
    form: CompiledForm
    kept: tuple[Any, ...]
