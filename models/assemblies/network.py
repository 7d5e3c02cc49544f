"""Networks: rods and bodies joined in a graph."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Self, Unpack

import numpy as np

from multirod.assembly import Assembly, Backbone
from multirod.batch import IntArray
from multirod.elimination import Elimination
from multirod.frames import pose
from multirod.inputs import Inputs, InputSpec
from multirod.models.assemblies.concentric_tubes import ConcentricTubes
from multirod.models.assemblies.inputs import NetworkInput, NetworkInputs, listed
from multirod.models.assemblies.network_inputs import (
    COORDINATE_INPUTS,
    FIXED_INPUTS,
    INPUTS,
    LOAD_INPUTS,
    NOT_THERE,
    ROD_INPUTS,
    by_itself,
    driven_rods,
    in_order,
    numbers_by_name,
    refuse_around,
    renamed,
    robot_of,
    specs_of,
)
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.checks import check_drives, surely_driven
from multirod.models.backbone.derivatives.designs import AROUND, design_options, refuse_unknown
from multirod.models.backbone.derivatives.ends import ways_back
from multirod.models.backbone.inputs import BY_MATERIAL, DRIVE_INPUTS, DRIVES
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.problem import BackboneProblem
from multirod.models.backbone.terms import scene_features
from multirod.models.network.derivatives.designs import PARAMETERS, columns_of, parameter_size
from multirod.models.network.elements.groups import along, is_on_rods
from multirod.models.network.freedom import refuse_mechanism, refuse_unheld
from multirod.models.network.graph import Graph
from multirod.models.network.joining.bodies import Body, name_of, number_of, place_of
from multirod.models.network.joining.checks import holes_by_rod, joint_called, joints_by_end, segments_by_rod, warn_of_free_tips
from multirod.models.network.joining.joints import Joint
from multirod.models.network.joining.turning import refuse_turning_on
from multirod.models.network.places import FIXED, LOADED
from multirod.models.network.problem import NetworkProblem
from multirod.naming import names_checked
from multirod.read_only import changed
from multirod.reuse import reusable
from multirod.rod import Rod
from multirod.types import Poses
from multirod.validation import FloatArray, refuse, sequence


class Network(Assembly):
    """Rods and rigid bodies in a graph: each end of a rod is joined to a body or the ground, or, of a tip, to nothing.

    ``tip_position`` and ``tip_rotation`` of a solution are those of the end effector, ``solution.body_position(name)`` and
    ``body_rotation(name)`` those of any body, ``joint_angle("arm base")`` and ``joint_slide`` say where a joint is.
    ``solution.rod(name)`` is a rod. What acts on bodies and rods is given by name, ``robot.inputs(force={"plate": (0, 0, -2)},
    rotation={"leg 0": 0.1})``, or as arrays in the order of ``load_places`` and of ``rods``.

    Args:
        rods: The rods by name, each a ``Rod`` or a ``ConcentricTubes`` (whose own base is not used). One with a
            foundation or loads of its own, which go with its base, is clamped there to the ground or a fixed body; one that
            slides through holes is the same all along, and has no lines.
        bodies: The bodies, those that move and those that are fixed.
        joints: One for every base of a rod, and one for every tip that is not free.
        end_effector: A body that moves, or with the name of one of its ``frames``, ``("top", "tool")``; or the name of a rod,
            whose tip it is; by default the last such body, or where there is none, the first rod whose tip is free, or else the
            first.
        base: Pose of the ground in the world, shape (..., 4, 4), or a ``Pose``; the identity by default.
        driven: Names of the rods that motors turn and push, so that tasks choose ``rotation`` and ``translation`` of them alone.
        segments: Into how many a rod is cut, ``{"cable": 8}``, which is long, soft and pulled: multiple shooting of that rod. It
            is the same all along, and has no lines.

    Attributes:
        bodies: As given.
        joints: As given.
        load_places: Names of what ``force`` and ``moment`` act on: the bodies that move, then the rods whose tips are free, then
            the frames of these bodies, ``"tool of top"``.
        fixed_bodies: Names of those that are fixed, in the order of ``fixed_position``.

    Raises:
        ValueError: If a name is given twice, or named and not there; if two joints hold one end; if nothing holds a body or the
            base of a rod; or if a rod or body is free to move without a rod being bent.
        TypeError: If an argument is of another type.
    """

    length_columns: ClassVar[bool] = True

    @names_checked
    def __init__(
        self,
        *,
        rods: Mapping[str, Rod | ConcentricTubes],
        bodies: Sequence[Body] = (),
        joints: Sequence[Joint],
        end_effector: Body | str | tuple[Body | str, str] | None = None,
        base: Poses | None = None,
        driven: Sequence[str] | None = None,
        segments: Mapping[str, int] | None = None,
    ) -> None:
        if not isinstance(rods, Mapping) or not rods:
            raise TypeError("Network.rods must be a mapping of names to Rod or ConcentricTubes, and hold one at least")
        for name in rods:
            name_of("Network.rods", name)
        self.bodies: tuple[Body, ...] = sequence("Network.bodies", bodies, Body, "Body")
        self.joints: tuple[Joint, ...] = sequence("Network.joints", joints, Joint, "Joint")
        names = [*rods, *(body.name for body in self.bodies)]
        for name in names:
            if names.count(name) > 1:
                refuse("Network.bodies", name, "must have a name of its own among rods and bodies")
        robots = [robot_of(rod, name) for name, rod in rods.items()]
        self.rods = tuple(rod for robot in robots for rod in robot.rods)
        self.base, self._motors = pose("Network.base", base), driven_rods(driven, rods)
        joined, holes = joints_by_end(self.joints, rods, self.bodies), holes_by_rod(self.joints, rods)
        cut = segments_by_rod(segments, rods, holes)
        self.graph = Graph(robots, list(rods), self.bodies, joined, self.base, holes, self.joints, cut)
        refuse_around(self.graph)
        refuse_unheld(self.graph)
        refuse_mechanism(self.graph)
        self.load_places = self.graph.load_places
        for frame in self.graph.frames:
            if [*names, *self.load_places].count(place_of(*frame)) > 1:
                refuse("Body.frames", frame, "must not be called as a rod, a body or another frame is, where forces act")
        self.fixed_bodies = tuple(body.name for body in self.graph.fixed)
        self._places = [*(body.name for body in self.graph.bodies), *rods]  # that may be the end effector
        self._end_effector = self._place_of_effector(end_effector)
        warn_of_free_tips(self.graph, self._places[self._end_effector])
        self.mass_carried = float(self.graph.mass.sum())
        self._specs = specs_of(self.rods, len(rods), self.coordinate_names, self.load_places, self.fixed_bodies)

    def _place_of_effector(self, given: object) -> int:
        """Its number among the bodies that move, then the rods."""
        self._frame = ""
        if isinstance(given, (tuple, list)) and len(given) == 2:
            given, frame = given
            names = [body.name for body in self.graph.bodies]
            name = given.name if isinstance(given, Body) else given
            if not isinstance(name, str) or name not in names:
                refuse("Network.end_effector", given, f"must be a body that moves, of which a frame is meant: {names}")
            self.graph.bodies[names.index(name)].frame(frame)
            self._frame = frame
        if given is None:
            bodies = len(self.graph.bodies)
            return bodies - 1 if bodies else self._places.index((*self.load_places, *self._places)[0])
        name = given.name if isinstance(given, Body) else given
        if not isinstance(name, str) or isinstance(given, Body) and given not in self.bodies or name not in self._places:
            refuse("Network.end_effector", given, f"must be a body that moves, or a rod: {', '.join(map(repr, self._places))}")
        return self._places.index(str(name))

    @property
    def end_effector(self) -> str | tuple[str, str]:
        """Name of the body that is the end effector, with that of its frame if that is meant, or of the rod whose tip is."""
        name = self._places[self._end_effector]
        return (name, self._frame) if self._frame else name

    @property
    def effector_name(self) -> str:
        """The same in words."""
        name = self._places[self._end_effector]
        return place_of(name, self._frame) if self._frame else name

    @property
    def effector_frame(self) -> FloatArray:
        """Pose of the end effector in the frame of what it is on, shape (4, 4): the identity but of a body's frame."""
        return self.graph.bodies[self._end_effector].frame(self._frame) if self._frame else np.eye(4)

    @property
    def driven_joints(self) -> tuple[str, ...]:
        """Names of the joints that are driven, ``"arm base"`` of that at the base of the rod ``"arm"``, in the order of the
        numbers of ``angle``, then those that only slide, in that of ``slide``."""
        return tuple(dict.fromkeys([*self.graph.driven, *self.graph.driven_slides]))

    def vectors_on(self, spec: InputSpec) -> tuple[str, ...]:
        """Names of what the vectors of an input act on, bodies and free tips or rods, in their order; none of one that is no
        vector on each of these, such as what drives lines or joints."""
        if spec.name in FIXED:
            return self.fixed_bodies
        if spec.count is None or spec.load is None:
            return ()
        return {"tip": self.load_places, "along": self.graph.whole_names}.get(spec.acts, ())

    @property
    def coordinate_names(self) -> dict[str, tuple[str, ...]]:
        """Of each input by the coordinates of joints the joint of each number, with that of the angle where it has several."""
        every = self.graph.by_coordinate.items()
        return {name: tuple(f"{j} {k}" if n > 1 else j for j, n in own.items() for k in range(n)) for name, own in every}

    def tubes_of(self, name: str) -> range:
        """Where a rod as given, by its name, stands among ``rods``: one number, or one for each of its tubes."""
        first = self.graph.first_tube[self.graph.whole_names.index(name) :]
        return range(int(first[0]), int(first[1]))

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of the rods' parameters and of the poses."""
        return self.graph.batch_shape

    @property
    def elimination(self) -> Elimination | None:  # noqa: D102
        return self.graph.entries.elimination

    if TYPE_CHECKING:
        _input_name: NetworkInput

    @listed(*INPUTS[:2], *COORDINATE_INPUTS, *FIXED_INPUTS, *LOAD_INPUTS, *ROD_INPUTS, *INPUTS[2:], *DRIVE_INPUTS)
    def inputs(self, **values: Unpack[NetworkInputs]) -> Inputs:  # type: ignore[override]  # these, and no others
        """Actuation and loads by name, all optional: numbers or arrays, whose leading axes ``...`` broadcast.

        ``rotation`` and ``translation`` are also taken by names of rods, ``{"leg 0": 0.1}``, of tubes a number each, and so is
        what drives lines, ``tension={"arm": (1, 0)}``; ``force`` and ``moment``, dead or following, by those of
        ``load_places``, ``{"plate": (0, 0, -2), ("top", "tool"): (1, 0, 0)}``; as arrays these have the shape (...,
        place_count, 3), and what acts along single rods, ``rod_force={"leg 0": (0.1, 0, 0)}``, (..., count of rods as given,
        3). Where joints are driven, ``angle`` is taken by those of ``driven_joints``, ``{"arm base": 0.3}``: one number, two or
        three each, and so is ``slide``, one number each; where bodies are fixed, ``fixed_position={"hand": (0, 0, 0.1)}`` by
        those of ``fixed_bodies``. What is not named is zero. A leading axis makes a batch, an instance for each entry.

        Args:
            **values: Those of ``NetworkInputs``.

        Returns:
            The inputs, checked, as ``solve`` and ``simulate`` take them.

        Raises:
            TypeError: If a name is not one of these.
            ValueError: If a value is out of range, not finite or of a wrong shape, names what is not there, or the leading axes
                do not broadcast.
        """
        return super().inputs(**NetworkInputs(**values))

    @property
    def input_specs(self) -> tuple[InputSpec, ...]:  # noqa: D102
        return self._specs

    @property
    def end_loads(self) -> dict[str, slice]:  # noqa: D102
        if self.effector_name not in self.load_places:  # a tip that something holds
            return {}
        first = 3 * self.load_places.index(self.effector_name)
        return dict.fromkeys(LOADED, slice(first, first + 3))

    @property
    def numbers_by_name(self) -> dict[str, dict[str, int]]:  # noqa: D102
        return numbers_by_name(self.graph, self.load_places, self.fixed_bodies)

    @property
    def driven(self) -> tuple[str, ...] | None:  # noqa: D102
        return self._motors

    def make_inputs(self, values: Mapping[str, Any]) -> Inputs:  # noqa: D102
        plain = dict(values)
        for name, own in self.numbers_by_name.items():
            if name in plain:
                if name in NOT_THERE and not own:
                    refuse(name, plain[name], f"must not be given: {NOT_THERE[name]}")
                plain[name] = in_order(name, plain[name], own)
        return super().make_inputs(plain)

    def check(self, inputs: Inputs) -> None:  # noqa: D102
        if not (inputs.batch_shape == () and self.surely_takes("translation", inputs.translation.tolist())):
            for name, rod, own in self._each():
                try:
                    rod.check(Inputs(rod.input_specs, rod.rod_count, {"translation": inputs.translation[..., own]}))
                except ValueError as error:
                    raise ValueError(f"rod {name!r}: {error}") from None
        check_drives(inputs, self.rods)
        refuse_turning_on(self.graph.turning, inputs)
        if inputs.is_active("gravity") and not (self.graph.mass.any() or any(rod.has_mass for rod in self.rods)):
            refuse("gravity", inputs.gravity.tolist(), "must be zero: no rod has a linear_density, and no body a mass")
        if inputs.is_active("magnetic_field") and not any(rod.is_magnetised for rod in self.rods):
            refuse("magnetic_field", inputs.magnetic_field.tolist(), "must be zero: no rod has a magnetisation")

    def surely_takes(self, name: str, values: Sequence[float]) -> bool:  # noqa: D102
        if name == "translation":
            return all(rod.surely_takes(name, values[own]) for _, rod, own in self._each())
        if name in DRIVES:
            return surely_driven(name, values, self.rods)
        return name not in BY_MATERIAL

    def _each(self) -> Iterator[tuple[str, BackboneAssembly, slice]]:
        """Each rod as given: its name, as a robot of its own, and where its tubes stand among ``rods``."""
        graph = self.graph
        for name, rod, (first, end) in zip(graph.whole_names, graph.whole, pairwise(graph.first_tube.tolist()), strict=True):
            yield name, rod, slice(first, end)

    @property
    def backbones(self) -> tuple[Backbone, ...]:  # noqa: D102
        ends, holes = self.graph.joints, self.graph.holes
        return tuple(Backbone(own, (name, "tip") in ends, name, len(holes.get(name, ()))) for name, _, own in self._each())

    @property
    def parameters(self) -> tuple[str, ...]:  # noqa: D102
        return tuple(name for name in PARAMETERS if name not in AROUND or self.graph.embeddable.any())

    def column_count(self, name: str) -> int:  # noqa: D102
        return parameter_size(name, self.graph) if name in PARAMETERS else super().column_count(name)

    def input_directions(self, *names: str) -> dict[str, Any]:
        """Directions for the derivatives by some inputs and parameters: the numbers of different rods share one."""
        for _, rod, _ in self._each():
            refuse_unknown(names, rod.rods)
        if self.graph.alone is not None:
            # which refuses what it cannot tell
            self.graph.alone.input_directions(*(name for name in names if name == "translation"))
        if "length" in names and self.graph.slides.springs[0].any():
            raise NotImplementedError("derivatives by length are not known where springs are at holes: rests are lengths too")
        sizes = {spec.name: spec.size(self.rod_count) for spec in self.input_specs}
        options: dict[str, Any] = {"direction_count": sum(columns.size for columns in columns_of(self.graph, sizes, names))}
        options |= design_options(names)
        options |= {"placed": True} if "joint_pose" in names or self.graph.alone and "base" in names else {}
        return options | ({"lengths": True} if any(self.graph.drives) else {})

    def ends_meet(self, inputs: Inputs) -> bool:  # noqa: D102
        translation = inputs.translation.reshape(-1, self.rod_count)
        return any(ways_back(rod.arrays, translation[:, own], inputs).any() for _, rod, own in self._each())

    @reusable
    def problem(  # noqa: D102
        self,
        inputs: Inputs,
        *,
        instances: IntArray | None = None,
        enabled: Sequence[str] = (),
        **options: Any,  # noqa: ANN401  (its own)
    ) -> NetworkProblem | BackboneProblem:
        alone, graph, given = self.graph.alone, self.graph, inputs
        if alone is not None and not options.get("placed") and not is_on_rods(inputs, enabled):
            return alone.problem(inputs, instances=instances, enabled=enabled, **options)
        if instances is not None:
            whole = np.broadcast_shapes(inputs.batch_shape, self.batch_shape)
            graph, inputs = graph.take(whole, instances), inputs.take(whole, instances)
        frame = self.effector_frame
        result = NetworkProblem(graph, self._end_effector, inputs, effector_frame=frame, enabled=enabled, **options)
        if alone is not None:
            result.by_itself = lambda: by_itself(alone, given, enabled, integrator=options["integrator"], instances=instances)
        return result

    def features(self, inputs: Inputs, *, enabled: Iterable[str] = ()) -> tuple[Features, ...]:  # noqa: D102
        if self.graph.alone is not None and not is_on_rods(inputs, enabled):
            return self.graph.alone.features(inputs, enabled=enabled)
        active = along(inputs, enabled)
        found = []
        for rod in self.graph.rods:
            options: dict[str, Any] = {"rod_count": rod.rod_count, "transmission": rod.transmission, "held": True}
            found.append(scene_features(rod.arrays, active, inputs.profiles, **options))
        return tuple(found)

    def with_rods(self, rods: Sequence[Rod]) -> Self:  # noqa: D102
        robots = [renamed(robot.with_rods(rods[at]), name) for name, robot, at in self._each()]
        all_rods, own = tuple(rod for robot in robots for rod in robot.rods), self.graph
        graph = Graph(robots, own.whole_names, self.bodies, own.joints, self.base, own.holes, self.joints, own.segments)
        refuse_around(graph)
        return changed(self, computed=("longest", "stiffest"), rods=all_rods, graph=graph)

    def with_base(self, base: FloatArray) -> Self:  # noqa: D102
        place, own = pose("Network.base", base), self.graph
        graph = Graph(own.whole, own.whole_names, self.bodies, own.joints, place, own.holes, self.joints, own.segments)
        return changed(self, base=place, graph=graph)

    def frame_of(self, body: Body | str | tuple[Body | str, str]) -> tuple[int, FloatArray]:
        """Number of a body, as of ``body_index``, and the pose of one of its frames in its own, shape (4, 4).

        Args:
            body: The body, whose own frame is meant, or with the name of one of its ``frames``.

        Raises:
            ValueError: If there is no such body or frame.
        """
        whole, frame = body if isinstance(body, tuple) and len(body) == 2 else (body, None)
        index = self.body_index(whole)
        return index, np.eye(4) if frame is None else (*self.graph.bodies, *self.graph.fixed)[index].frame(frame)

    def coordinates_of(self, joint: Joint | str, *, slides: bool) -> tuple[int, int, int | slice]:
        """Of which end, base or tip, of which piece of a rod coordinates of a joint are, and which of that end's: of one that is
        called ``"arm base"`` how far it ``slides``, or its angles. Raises ValueError if it has none."""
        own = joint_called(self.joints, joint, slides=slides)
        pieces = self.graph.slides.of(self.graph.whole_names.index(own.rod))
        which = own.angles if slides else slice(own.angles) if own.angles > 1 else 0
        return (0, pieces[0], which) if own.end == "base" else (1, pieces[-1], which)

    def body_index(self, body: Body | str) -> int:
        """Number of a body, among those that move, then those that are fixed.

        Raises:
            ValueError: If there is no such body.
        """
        return number_of(body, (*self.graph.bodies, *self.graph.fixed))

    def __repr__(self) -> str:
        kinds = (("rod", len(self.rods)), ("bod", len(self.bodies)), ("joint", len(self.joints)))
        counts = [
            f"{count} {name}" + ("y" * (count == 1) + "ies" * (count != 1) if name == "bod" else "s" * (count != 1))
            for name, count in kinds
        ]
        return f"Network({', '.join(counts)}, end effector {self.end_effector!r})"
