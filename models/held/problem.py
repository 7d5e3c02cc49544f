"""A rod that is held at both ends: the boundary problem, its buffers and launches."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import LineTest
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.kernels.warp_types import Array
from multirod.launch import Launch, record
from multirod.models.backbone.derivatives.designs import COMPONENTS
from multirod.models.backbone.derivatives.ends import part_ends
from multirod.models.backbone.inputs import DRIVES
from multirod.models.backbone.stability.clamps import ClampedBackbones
from multirod.models.held.along import HeldSensing, Launches, aim_at_numbers, columns_along, unknown_rates
from multirod.models.held.buckling import begin_bent, straight
from multirod.models.held.capabilities import HeldLines, HeldParts, HeldReach, HeldShapes, HeldStarts
from multirod.models.held.clamps import HeldClamps
from multirod.models.held.costless import alike, free_in_balls, hold_bases_alone, led_on
from multirod.models.held.holders import POSE_INPUTS, POSE_SIZE, ROD_INPUTS, TIP_LOADS, HeldOptions, Holders, load_scale
from multirod.models.held.kernels.arguments import BESIDE, LED_ON
from multirod.models.held.kernels.base_kernels import hand_over
from multirod.models.held.kernels.holding_kernels import hold
from multirod.models.held.segments import HeldBackbone, HeldSegments
from multirod.models.held.stability import HeldStability
from multirod.models.held.start import INTEGRATIONS_AT_REST, Begun, begin, begun_without_medium
from multirod.models.held.table import make_table
from multirod.problem import BegunAgain, Block, BoundaryProblem
from multirod.rotations import left_jacobian, matrices
from multirod.segments import Breakpoints
from multirod.validation import FloatArray


class HeldProblem(BoundaryProblem):
    """One rod whose ends are held (``docs/held.md``).

    Unknowns are moment and force at the base, in its frame, in ``EI`` and ``EI/L`` (6), between them the tensions of lines whose
    lengths are given, and last the angles of the base in a joint there; residuals those of the end (5), (7), of the rod's lines,
    and of the joint at the base (8).
    """

    guess_integrations: IntArray | int = INTEGRATIONS_AT_REST
    leads_on = False
    reach: HeldReach

    def __init__(
        self,
        holders: Holders,
        inputs: Inputs,
        *,
        integrator: Integrator,
        device: str = "cpu",
        pose_sensitivities: bool = False,
        direction_count: int = 0,
        lengths: bool = False,
        design: Sequence[str] = (),
        enabled: Sequence[str] = (),
        pieces: int = 1,
    ) -> None:
        self.holders = holders
        direction_count = 3 * (pieces - 1) if pieces > 1 else direction_count
        shape = np.broadcast_shapes(inputs.batch_shape, holders.batch_shape)
        self.turns = len(holders.base_axes)
        self.rod = self._make_rod(inputs, shape, integrator, device, direction_count, lengths, design, enabled, pieces)
        n = self.rod.unknown_count + self.turns
        super().__init__(
            unknown_count=n,
            batch_shape=shape,
            input_count=self.rod.input_count + POSE_SIZE,
            blocks=[Block("rod 1", slice(0, n), slice(0, n), 0)],
            direction_count=direction_count,
            pose_sensitivities=pose_sensitivities,
            device=device,
        )
        self.integrator = integrator
        self.inputs_given = inputs
        self.options: HeldOptions = {
            "device": device,
            "pose_sensitivities": pose_sensitivities,
            "direction_count": direction_count,
            "lengths": lengths,
            "enabled": tuple(enabled),
        }
        self.rounding = self.rod.rounding
        self._natural: FloatArray | None = None
        self.bends = np.zeros(self.instance_count, dtype=np.int32)  # BENT: begins so, though it would give way; LED: and is led
        self._begun: tuple[object, Begun] | None = None  # as ``guess`` found it, and at which inputs
        base, end = (np.array(np.broadcast_to(own, (*shape, 4, 4)).reshape(-1, 4, 4)) for own in (holders.base, holders.end))
        self.base_frame, self.end_position, self.end_frame = base[:, :3, :3], end[:, :3, 3], end[:, :3, :3]
        self.length = np.array(self.rod.each(self.rod.arrays.end[:, 0, -1]))
        self.stiffness = np.array(self.rod.each(self.rod.arrays.material[:, 0, 0, :2]).max(axis=1))
        self.alike, self.reach = alike(self), HeldReach(self)
        self.table = make_table(self, pieces)
        self._launches = self._record()
        self.write("inputs", self.pack(inputs))
        hold_bases_alone(self)

    def _make_rod(
        self,
        inputs: Inputs,
        shape: tuple[int, ...],
        integrator: Integrator,
        device: str,
        direction_count: int,
        lengths: bool,
        design: Sequence[str],
        enabled: Sequence[str],
        pieces: int,
    ) -> HeldBackbone:
        """The rod as a backbone whose tip is held, as many as there are instances."""
        holders, rod = self.holders, self.holders.rod
        names = [spec.name for spec in ROD_INPUTS] + [name for name in DRIVES if name in inputs.specs]
        given: dict[str, Any] = {name: inputs.profiles[name] for name in names if name in inputs.profiles}
        given |= {name: inputs.array(name) for name in names if name in inputs.given and name not in given}
        reach = max((p.ends[-1] for p in inputs.profiles.values()), default=0.0)
        specs = tuple(spec for spec in rod.input_specs if spec.name in names)
        result = HeldBackbone(
            rod.rods,
            np.broadcast_to(holders.base, (*shape, 4, 4)),
            Inputs(specs, rod.rod_count, given, reach),
            integrator=integrator,
            device=device,
            pose_sensitivities=True,
            direction_count=direction_count + self.turns,
            lengths=lengths,
            design=design,
            enabled=[name for name in names if name in enabled or inputs.is_active(name)],
            held=True,
            arrays=begun_without_medium(holders),
            pieces=pieces,
        )
        result.whole = self
        return result

    def _record(self) -> Launches:
        """Launches of one evaluation, in order."""
        first, last = (record(kernel, self.instance_count, (self.table,), self.device) for kernel in (hand_over, hold))
        return first, self.rod.launch, last

    # ---- what is offered ----

    @property
    def stability(self) -> HeldStability:  # noqa: D102
        return HeldStability(self)

    @property
    def shapes(self) -> HeldShapes:  # noqa: D102
        return HeldShapes(self)

    @property
    def lines(self) -> HeldLines:  # noqa: D102
        return HeldLines(self)

    @property
    def segments(self) -> HeldSegments:  # noqa: D102
        return self.rod.cut

    @property
    def breakpoints(self) -> dict[int, Breakpoints]:
        """As said; the rod's too."""
        return self.rod.breakpoints

    @breakpoints.setter
    def breakpoints(self, points: dict[int, Breakpoints]) -> None:
        self.rod.breakpoints = points

    @property
    def parts(self) -> HeldParts:  # noqa: D102
        return HeldParts(self)

    @cached_property
    def clamps(self) -> HeldClamps | None:  # noqa: D102
        return HeldClamps(self, self.rod.launch) if isinstance(self.rod.launch, ClampedBackbones) else None

    @property
    def may_be_clamped(self) -> bool:
        """Whether places along the rod can be: not where its base turns and what acts along the rod does not turn with it."""
        terms = self.rod.features
        along = terms.distributed_force or terms.distributed_moment or terms.loads or terms.profile_degree >= 0
        return self.rod.may_be_clamped and not (self.turns and along)

    @property
    def starts(self) -> HeldStarts:  # noqa: D102
        return HeldStarts(self)

    @property
    def result_test(self) -> LineTest | None:  # noqa: D102
        return None if self.rod.result_test is None else LineTest(self.lines)

    @property
    def kinks(self) -> NDArray[np.intp]:  # noqa: D102
        return self.rod.kinks

    @property
    def kink_inputs(self) -> NDArray[np.intp]:  # noqa: D102
        return self.rod.kink_inputs

    # ---- the interface ----

    def _pass_over(self, instances: IntArray | None) -> None:
        super()._pass_over(instances)
        self.rod._pass_over(instances)
        for launch in self._launches[::2]:
            launch.set_dim(self.listed)

    @cached_property
    def launches(self) -> tuple[Launch, ...] | None:  # noqa: D102
        own = self.rod.launches
        return None if own is None else (self._launches[0], *own, self._launches[2])

    def _integrate(self) -> None:
        self.rod.stop = self.stop
        for launch in self._launches:
            launch.launch()

    def to_rod(self) -> None:
        """Unknowns and inputs of all instances to the rod, without an integration."""
        with self.everyone():
            self._launches[0].launch()

    def renew(self, inputs: Inputs) -> bool:  # noqa: D102
        if inputs.profiles or self.inputs_given.profiles:
            return False
        self._clear()
        self.rod._clear()
        self.inputs_given, self._natural, self._begun, self.bends[:] = inputs, None, None, 0
        self.write("inputs", self.pack(inputs))
        hold_bases_alone(self)
        return True

    def _zeros(self) -> list[Array]:
        own = ("opening", "direct", "neutral", "leading", "drawn", "beside")
        return [*super()._zeros(), *(getattr(self.table, name) for name in own)]

    def takes(self, name: str) -> bool:  # noqa: D102
        return name in (*POSE_INPUTS, *TIP_LOADS) or self.rod.takes(name)

    def pack(self, inputs: Inputs) -> FloatArray:  # noqa: D102
        packed = super().pack(inputs)
        packed[:, -1] = 1.0  # scale of the load profiles
        return packed

    def input_slice(self, name: str) -> slice:  # noqa: D102
        if name in POSE_INPUTS:
            start = self.rod.input_count - 1 + 3 * POSE_INPUTS.index(name)
            return slice(start, start + 3)
        return self.rod.input_slice(name)

    def part_ends(self, names: Sequence[str]) -> FloatArray:  # noqa: D102
        return part_ends(self, names, [(self.rod.arrays, self.input_slice("translation"))], self.inputs_given)

    def aim(self, *names: str) -> None:
        """As said; along the rod's own numbers too, of which the rod alone knows."""
        super().aim(*names)
        aim_at_numbers(self, names)

    def directions_by(self, name: str) -> FloatArray:
        """As said; none along a number of the rod."""
        if name in COMPONENTS:
            return np.zeros((1, self.rod.derivatives.designs(name).count, self.directions.shape[2]))
        return super().directions_by(name)

    def aimed(self, *names: str) -> tuple[FloatArray, FloatArray]:
        """As said; by the rod's numbers too, the unknowns fixed."""
        slopes, moved = super().aimed(*names)
        rates, n = unknown_rates(self, names), self.unknown_count
        if rates is not None:
            slopes -= self.read("gamma").reshape(-1, n, n) @ rates
            moved -= self.pose_columns.numpy()[:, :, :n] @ rates
        return slopes, moved

    def along(self, names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:  # noqa: D102
        return columns_along(self, names, places)

    def sensing(self, places: FloatArray) -> HeldSensing:  # noqa: D102
        return HeldSensing(self, places, self._launches)

    def adopt(self, unknowns: FloatArray) -> FloatArray:
        """As said; what holds turns that cost nothing, (29), holds them there, if these are as many as there are instances."""
        result = super().adopt(unknowns)
        if len(result) == self.instance_count:
            hold_bases_alone(self, result)
        return result

    def guess(self) -> FloatArray:
        """The rod at rest, its end where that is; where it is straight there and its end does not slide, a little bent.

        What is left of the residual is remembered and closes as ``load_factor`` goes from 0 to 1, (3).
        """
        at = self.read("inputs").tobytes(), self.side, self.bends.tobytes()
        if self._begun is None or self._begun[0] != at:
            self._natural = np.ones(self.instance_count)  # what begins it knows where the rod is at rest
            records = self.snapshot()
            self._begun = at, begin(self)
            self.restore(records)
        begun = self._begun[1]
        self.guess_integrations, self.passed = begun.integrations, begun.passed
        self.table.opening.assign(begun.residual)
        self.table.beside.assign(begun.beside * (LED_ON if self.leads_on else BESIDE))
        self._natural = np.minimum(1.0, begun.least)
        return np.array(begun.unknowns)

    def begin_again(self, status: NDArray[np.int32], reached: FloatArray, tried: int) -> BegunAgain | None:  # noqa: D102
        return begin_bent(self, status, reached, tried)

    def standing(self, status: NDArray[np.int32]) -> tuple[NDArray[np.bool_], FloatArray] | None:  # noqa: D102
        return straight(self, status)

    def know_rest(self) -> None:
        """Have it found where the end of the rod at rest is, where no ``guess`` has."""
        if self._natural is None:
            self.guess()

    @property
    def natural_singular_value(self) -> FloatArray:
        """That at ``guess``."""
        self.know_rest()
        assert self._natural is not None
        return self._natural

    def turn_axes(self) -> FloatArray:
        """(8) Rotation vectors of the rod by each unknown of its base's joint, in the world, shape (instance_count, 3, turns)."""
        x = self.read("unknowns")[:, self.rod.unknown_count :]
        a = self.length[:, None] * x @ self.holders.base_axes
        J = left_jacobian(a)
        return np.asarray(self.length[:, None, None] * np.einsum("bij,bjk,lk->bil", self.base_frame, J, self.holders.base_axes))

    def base_moment(self) -> FloatArray:
        """Moment at the base, in the world [N m], shape (instance_count, 3)."""
        moment = self.read("unknowns")[:, :3] * self.stiffness[:, None]
        return np.asarray((self.rod.table.base_rotation.numpy() @ moment[:, :, None])[:, :, 0])

    def base_moment_columns(self) -> FloatArray:
        """Its change by the unknowns of the rod as a backbone, shape (instance_count, 3, rod.unknown_count)."""
        result = np.zeros((self.instance_count, 3, self.rod.unknown_count))
        result[:, :, :3] = self._rod_at_base() / self.table.moment_unit.numpy()[:, None, :]
        return result

    def _rod_at_base(self) -> FloatArray:
        """Frame of the rod at its base, in the world."""
        turned = matrices(self.read("inputs")[:, :1] * [0.0, 0.0, 1.0])
        return np.asarray(np.broadcast_to(self.rod.table.base_rotation.numpy(), turned.shape) @ turned)

    def goal(self) -> tuple[FloatArray, FloatArray]:
        """(1), (2) Position (instance_count, 3) and rotation (instance_count, 3, 3) of the end's holder."""
        inputs = self.read("inputs")
        position, turn = (inputs[:, self.input_slice(name)] for name in POSE_INPUTS)
        return self.end_position + position, matrices(turn) @ self.end_frame

    @property
    def held_forces(self) -> NDArray[np.intp]:  # noqa: D102
        return np.arange(self.rod.unknown_count - 3, self.rod.unknown_count)

    def goal_is_neutral(self) -> NDArray[np.bool_]:
        """(10) As the last evaluation found it, shape (instance_count,)."""
        return np.asarray(self.table.neutral.numpy() != 0)

    def led_on(self) -> AbstractContextManager[None]:  # noqa: D102
        return led_on(self)

    @property
    def led(self) -> NDArray[np.bool_]:  # noqa: D102
        return np.asarray(self.table.beside.numpy() != 0)

    def turning_angle(self) -> FloatArray:
        """How far the ends are turned against each other on the way from rest, at most [rad], shape (instance_count,)."""
        self.know_rest()
        inputs = self.read("inputs")
        turn = np.linalg.norm(inputs[:, self.input_slice("end_rotation")], axis=1)
        turn += np.linalg.norm(self.table.rest_turn.numpy(), axis=1)
        return np.asarray(turn + np.abs(inputs[:, 0]))

    def length_in_use(self) -> FloatArray:
        """Of the rod, from its base on, by which ``translation`` it is pushed out [m], shape (instance_count,)."""
        return np.asarray(self.length + self.read("inputs")[:, self.input_slice("translation")][:, 0])

    @property
    def may_be_taut(self) -> bool:  # noqa: D102
        return self.reach.ends

    def taut(self) -> NDArray[np.bool_]:  # noqa: D102
        return self.reach.attained()

    def free_turns(self) -> IntArray | None:  # noqa: D102
        return free_in_balls(self) if self.table.balls.numpy().any() else None

    def tells_nothing(self, unknowns: FloatArray) -> NDArray[np.bool_]:  # noqa: D102
        return self.reach.tells_nothing(unknowns)

    def curvature_scale(self) -> FloatArray:  # noqa: D102
        return np.maximum(self.rod.curvature_scale(), self.turning_angle() / self.length)

    def load_scale(self) -> FloatArray:  # noqa: D102
        return load_scale(self)
