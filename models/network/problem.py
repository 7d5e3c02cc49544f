"""Rods and bodies in a graph: the boundary problem.

Numbers in parentheses are those of ``docs/networks.md``. Each rod is integrated in the frame of its base by the backbone kernels;
what its ends say of the bodies is an element (``elements.py``), and residual and ``Gamma`` are the sums of the elements. They are
put together by ``network_kernels.py``; ``entries.py`` says where they stand, and how ``Gamma`` is eliminated along the graph.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.capabilities import ResultTest
from multirod.inputs import Inputs
from multirod.integrators import Integrator
from multirod.launch import Launch, record
from multirod.models.backbone.derivatives.ends import part_ends
from multirod.models.backbone.passes.lane_pass import width
from multirod.models.backbone.starts import twisted
from multirod.models.network import network_kernels as kernels
from multirod.models.network.buffers import networks_of
from multirod.models.network.capabilities import NetworkLines, NetworkParts, NetworkShapes
from multirod.models.network.closing import Closing, Loaded
from multirod.models.network.derivatives.along import NetworkSensing, columns_along
from multirod.models.network.derivatives.designs import Aim, Columns, columns_of
from multirod.models.network.elements.element_kernels import form
from multirod.models.network.elements.groups import ALONG, ON_RODS, RodGroup, along, builds, is_on_rods
from multirod.models.network.graph import DRIVEN, PUSHED, Graph
from multirod.models.network.joining.cutting import too_long
from multirod.models.network.joining.reach import NetworkReach
from multirod.models.network.joining.turning import result_test_of
from multirod.models.network.places import blocks_of, input_places, place_of_all
from multirod.models.network.poses import body_poses, pushed_axes
from multirod.models.network.stability.clamps import NetworkClamps
from multirod.models.network.stability.conjugates import NetworkConjugates
from multirod.models.network.stability.form_rows import FormRows
from multirod.models.network.stability.stability import NetworkStability
from multirod.models.network.starting import NetworkJoints, NetworkStarts
from multirod.models.network.state import State
from multirod.problem import BoundaryProblem
from multirod.status import Status
from multirod.validation import FloatArray


class NetworkProblem(Loaded):
    """Rods joined to bodies and the ground.

    Unknowns are, rod by rod, moment and force at its base, then the angles of the joints at its base and its tip; then where
    rods are in holes; then the pose of each body. Residuals in the same order: what joins the tip, or is free there, torques of
    joints, what slides, balances of bodies. Of a rod that slides through holes, each piece is a rod.

    Args:
        graph: The network.
        end_effector: Number of the body, or, after the bodies, of the rod as given whose tip it is.
        effector_frame: Pose of the end effector in the frame of that body, shape (4, 4); the identity by default.
        inputs: The inputs.
        integrator, device, pose_sensitivities, direction_count, lengths, design, enabled: As for ``Assembly.problem``.
        placed: Whether directions may be along poses of joints.
        pieces: Of each rod that does not slide through holes; of more than one, there are clamps between them, whose moments are
            the directions.
    """

    guess_integrations: int = 1
    by_itself: Callable[[], BoundaryProblem] | None = None  # of one rod, its problem, with an unknown force at its base

    def __init__(
        self,
        graph: Graph,
        end_effector: int,
        inputs: Inputs,
        *,
        integrator: Integrator,
        device: str = "cpu",
        pose_sensitivities: bool = False,
        direction_count: int = 0,
        lengths: bool = False,
        design: Sequence[str] = (),
        placed: bool = False,
        effector_frame: FloatArray | None = None,
        enabled: Sequence[str] = (),
        pieces: int = 1,
    ) -> None:
        self.graph, self.end_effector, self.pieces = graph, end_effector, pieces
        self.effector_frame: FloatArray = np.eye(4) if effector_frame is None else effector_frame
        self.rod_count, self.body_count = len(graph.rods), len(graph.moving)
        if pieces > 1:
            direction_count = 3 * (pieces - 1) * int((~graph.slides.sliding).sum())
        self.entries = entries = graph.entries
        self.places, self.first_hole, self.first_pose, n = entries.variables, entries.first_hole, entries.first_pose, entries.size
        self.effector_rod = graph.effector_rod(end_effector)
        held = zip(self.places, graph.rods, graph.ends[1].held, strict=True)
        self.held_torques = np.concatenate([own[2 : 2 + rod.rod_count] if tip else own[:0] for own, rod, tip in held])
        self._slices = input_places(graph)
        self.driven_place, self.pushed_place = (place_of_all(self._slices, names) for names in (DRIVEN, PUSHED))
        super().__init__(
            unknown_count=n,
            batch_shape=np.broadcast_shapes(inputs.batch_shape, graph.batch_shape),
            input_count=max(place.stop for place in self._slices.values()),
            blocks=blocks_of(graph, self.places, self.first_hole, n),
            direction_count=direction_count,
            pose_sensitivities=pose_sensitivities,
            device=device,
            elimination=entries.elimination if wp.get_device(device).is_cpu else None,
        )
        self.arrow = entries.arrow
        self.integrator = integrator
        self.inputs_given = inputs
        self.options: dict[str, Any] = {
            "device": device,
            "pose_sensitivities": pose_sensitivities,
            "direction_count": direction_count,
            "enabled": tuple(enabled),
        }
        acting = along(inputs, enabled)
        options = {"integrator": integrator, "device": device, "lengths": lengths, "design": design, "enabled": acting}
        count, shape = self.instance_count, self.batch_shape
        self.layout = graph.layout
        drives = self._slices[ALONG[-1]].stop
        # along directions of inputs what is fixed turns too
        moving = graph.turning_bases | placed | ((direction_count > 0) & graph.on_fixed)
        together = builds(graph, moving if options["enabled"] else None, width(integrator.precision, device))
        self.groups = [RodGroup(graph, members, shape, moving, direction_count, drives, options, pieces) for members in together]
        self.rounding = self.groups[0].backbones.rounding
        size = self.rod_count + self.body_count
        scales = [np.broadcast_to(scale.reshape(*graph.batch_shape, size), (*shape, size)) for scale in graph.scales()]
        self.length, self.stiffness = (scale.reshape(count, size) for scale in scales)
        self.attachments = graph.attachments(count, shape)
        self.reference = graph.reference(self.length[:, : self.rod_count], shape)
        self.fixed = graph.fixed_poses(count, shape)
        self.networks = networks_of(self)
        self.closing, self.gives_way = Closing(self), bool(graph.ends[1].held.any())  # (12)
        self.reach = NetworkReach(self)
        self._launches = self._record()
        self._aims: dict[tuple[str, ...], Aim] = {}
        self._followed: Aim | None = None  # whose directions depend on inputs or unknowns
        self.write("inputs", self.pack(inputs))

    def _record(self) -> list[Any]:
        """Launches of one evaluation, in order: the first, three of each build, and the last."""

        def recorded(kernel: wp.Kernel, dim: int, *arguments: object) -> Launch:
            return record(kernel, dim, arguments, self.device)

        launches: list[Any] = [recorded(kernels.stand, self.instance_count, self.networks)]
        for group in self.groups:
            dim = group.backbones.instance_count
            launches.append(recorded(kernels.hand_over, dim, self.networks, group.table))
            launches.append(group.backbones.launch)
            launches.append(recorded(form, dim, self.networks, group.table))
        launches.append(recorded(kernels.add_up, self.instance_count, self.networks))
        return launches

    # ---- what is offered ----

    @property
    def shapes(self) -> NetworkShapes:  # noqa: D102
        return NetworkShapes(self)

    @property
    def stability(self) -> NetworkStability:  # noqa: D102
        return NetworkStability(self)

    @property
    def lines(self) -> NetworkLines:  # noqa: D102
        return NetworkLines(self)

    @property
    def result_test(self) -> ResultTest | None:  # noqa: D102
        return result_test_of(self)

    @property
    def held_forces(self) -> NDArray[np.intp]:  # noqa: D102
        return self._forces(np.flatnonzero(self.graph.ends[1].held))

    def undetermined(self) -> NDArray[np.bool_]:
        """(32) Told where gaps are closed: taken apart, rods may be straight that are not together."""
        return np.asarray(super().undetermined() & self.closing.is_closed())

    def _forces(self, rods: NDArray[np.intp]) -> NDArray[np.intp]:
        """Unknowns that are forces at the bases of some rods."""
        return np.asarray(self.places[rods[:, None], self.graph.along[rods, None] + np.arange(-2, 1)].reshape(-1))

    @property
    def kinks(self) -> NDArray[np.intp]:  # noqa: D102
        own = [self.places[rod, group.backbones.kinks] for group in self.groups for rod in group.members.tolist()]
        return np.sort(np.concatenate(own))

    @property
    def segments_refused(self) -> str:  # noqa: D102
        return "it is a network: cut its rods by mr.Network(..., segments={...}), for Shooting, Observer or EnergyDescent"

    @property
    def parts(self) -> NetworkParts:  # noqa: D102
        return NetworkParts(self)

    @property
    def starts(self) -> NetworkStarts:  # noqa: D102
        return NetworkStarts(self)

    @property
    def joints(self) -> NetworkJoints:  # noqa: D102
        return NetworkJoints(self)

    @cached_property
    def form_rows(self) -> FormRows:
        """Where what is free stands in the second variation."""
        return FormRows(self)

    @cached_property
    def conjugates(self) -> NetworkConjugates | None:  # noqa: D102
        return NetworkConjugates(self) if self.pose_sensitivities else None

    @cached_property
    def clamps(self) -> NetworkClamps | None:  # noqa: D102
        return NetworkClamps(self) if self.pieces > 1 else None

    # ---- the interface ----

    def input_slice(self, name: str) -> slice:  # noqa: D102
        return self._slices[name]

    def takes(self, name: str) -> bool:  # noqa: D102
        name = ON_RODS.get(name, name)
        return name not in ALONG or all(group.backbones.takes(name) for group in self.groups)

    def _pass_over(self, instances: IntArray | None) -> None:
        super()._pass_over(instances)
        first, *of_groups, last = self._launches
        for k, group in enumerate(self.groups):
            group.pass_over(None if instances is None else np.asarray(instances))
            for launch in of_groups[3 * k : 3 * k + 3 : 2]:
                launch.set_dim(group.backbones.listed)
        for launch in (first, last):
            launch.set_dim(self.listed)

    def adopt(self, unknowns: FloatArray) -> FloatArray:
        """As said; also those of a network that is one rod by itself."""
        if self.by_itself is not None and unknowns.shape[1] != self.unknown_count:
            alone, own = self.by_itself(), self.read("inputs")
            rows = alone.read("inputs")
            for name, place in self._slices.items():  # as they are now: this may have been renewed, or written to
                if place.start < place.stop and name not in ON_RODS:
                    rows[:, alone.input_slice(name)] = own[:, place]
            alone.write("inputs", rows)
            unknowns = alone.adopt(unknowns)
        return super().adopt(unknowns)

    def renew(self, inputs: Inputs) -> bool:  # noqa: D102
        if self.graph.alone is not None and not is_on_rods(inputs, self.options["enabled"]):
            return False  # it is solved by itself
        self._clear()
        self.__dict__.pop("conjugates", None)
        for group in self.groups:
            group.backbones._clear()
        self.closing.clear()
        self.inputs_given = inputs
        self.write("inputs", self.pack(inputs))
        return True

    @property
    def launches(self) -> tuple[Any, ...] | None:
        """Where the rods of each build are one launch, and ``Gamma`` is not eliminated along the graph, which is SciPy's."""
        return None if self._followed else self._bare

    @cached_property
    def _bare(self) -> tuple[Any, ...] | None:
        if self._host is None or self.elimination is not None:
            return None
        result: list[Any] = []
        for k, group in enumerate(self.groups):
            own = group.backbones.launches
            if own is None:
                return None
            result += [self._launches[3 * k + 1], *own, self._launches[3 * k + 3]]
        return (self._launches[0], *result, self._launches[-1])

    def _integrate(self) -> None:
        self.integrate_by(self._launches)

    def integrate_by(self, launches: Sequence[Any]) -> None:
        """Integrate by some of the launches, or by what stands in the place of them, in order."""
        if self._followed:
            self._launch([self._launches[0], *self._launches[1:-1:3]])
            self._followed.write()
        for group in self.groups:
            group.backbones.stop = self.stop
        self._launch(launches)

    def _launch(self, launches: Sequence[Any]) -> None:
        """Some of the launches, in order."""
        if self._host is None:
            self.closing.write()
        for launch in launches:
            launch.launch()
        if launches[-1] is self._launches[-1] and self.elimination is not None and "gamma" in vars(self):  # asked for whole
            numbers = self.numbers_of_gamma(np.arange(self.instance_count))
            self.gamma.assign(self.entries.dense(numbers))

    def hand_over(self) -> None:
        """Unknowns and inputs of all instances to their rods, without an integration."""
        with self.everyone():
            self._launch([self._launches[0], *self._launches[1:-1:3]])

    def integrate_rods(self) -> None:
        """Integrate the rods of all instances at their unknowns; nothing that solvers read is changed."""
        with self.everyone():
            self.integrate_by(self._launches[:-1])

    def _assemble(self) -> None:
        """(5) to (12) Residual, ``Gamma``, columns and pose of all instances, their rods integrated."""
        self._launch([self._launches[0], *self._launches[3:-1:3], self._launches[-1]])

    def reasons(self, status: NDArray[np.int32]) -> NDArray[np.int32]:
        """As said; where a rod was pulled out of a hole on the way, since this was asked last, that was no number."""
        known, pulled_out = super().reasons(status), np.array(self.networks.pulled_out.numpy(), dtype=bool)
        self.networks.pulled_out.zero_()
        return np.where(pulled_out & (known == Status.NONFINITE), Status.OUT_OF_HOLE, known).astype(np.int32)

    def along(self, names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:  # noqa: D102
        return columns_along(self, names, rod, places)

    def sensing(self, places: FloatArray) -> NetworkSensing:  # noqa: D102
        return NetworkSensing(self, places, self._launches)

    # ---- columns ----

    def columns_of(self, names: Sequence[str]) -> list[Columns]:
        """Where columns by inputs and parameters stand among the directions."""
        return columns_of(self.graph, {name: place.stop - place.start for name, place in self._slices.items()}, names)

    def aim_of(self, names: Sequence[str]) -> Aim:
        """What ``aim(*names)`` points along; made once."""
        key = tuple(names)
        if key not in self._aims:
            self._aims[key] = Aim(self, key)
        return self._aims[key]

    def aim(self, *names: str) -> None:
        """As said; what depends on inputs and unknowns is found at each integration."""
        aim = self.aim_of(names)
        self._followed = aim if aim.follows else None
        if not aim.follows:
            aim.write()

    def aimed(self, *names: str) -> tuple[FloatArray, FloatArray]:
        """As said; by parameters too, the unknowns fixed."""
        slopes, moved = super().aimed(*names)
        return self.aim_of(names).found(slopes, moved, self.read("position"))

    def part_ends(self, names: Sequence[str]) -> FloatArray:  # noqa: D102
        start = self.input_slice("translation").start
        own = [slice(*(start + self.graph.first_tube[rod : rod + 2])) for rod in self.graph.slides.owner.tolist()]
        return part_ends(self, names, zip(self.graph.arrays, own, strict=True), self.inputs_given)

    def body_poses(self) -> tuple[FloatArray, FloatArray]:
        """Position (instance_count, body, 3) and rotation (instance_count, body, 3, 3) at ``unknowns``: of the bodies that move,
        then of those that are fixed."""
        return body_poses(self)

    def pushed_axes(self) -> tuple[FloatArray, FloatArray]:  # noqa: D102
        return pushed_axes(self)

    # ---- where the search begins ----

    def guess(self) -> FloatArray:  # noqa: D102
        return self.closing.begin()

    @property
    def natural_singular_value(self) -> FloatArray:  # noqa: D102
        return self.closing.singular_value()

    @property
    def natural_gamma(self) -> FloatArray:  # noqa: D102
        return self.closing.natural_gamma()

    def too_long(self, instance: int) -> str:  # noqa: D102
        return too_long(self, instance)

    def loose(self) -> list[str]:  # noqa: D102
        return self.closing.loose()

    def state(self) -> State:
        """Of all instances."""
        return State(self)

    def twisted(self, x: FloatArray, numbers: IntArray) -> FloatArray:
        """Unknowns with the tubes of rods turned against each other, as ``models.backbone.starts.twisted`` has it; where nothing
        holds their tip they are bent too."""
        members = [(group.backbones, group.members.tolist()) for group in self.groups]
        return twisted(members, x, numbers, lambda rod: self.places[rod], self.graph.free.tolist())

    def curvature_scale(self) -> FloatArray:  # noqa: D102
        own = [group.backbones.curvature_scale().reshape(self.instance_count, -1) for group in self.groups]
        return np.asarray(np.concatenate(own, axis=1).max(axis=1))
