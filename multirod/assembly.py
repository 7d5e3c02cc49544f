"""What every robot made of rods has in common."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from multirod import plausibility
from multirod.batch import IntArray, broadcast_shapes
from multirod.by_name import arranged, each_named
from multirod.designs import Designs
from multirod.elimination import Elimination
from multirod.inputs import Inputs, InputSpec
from multirod.naming import INPUTS_NAMED, OF_ROBOTS, Asked, hinted, unknown_names
from multirod.problem import BoundaryProblem
from multirod.read_only import ReadOnly
from multirod.rod import Rod
from multirod.validation import FloatArray, refuse

if TYPE_CHECKING:
    from typing_extensions import TypeVar

    from multirod.integrators import Integrator
    from multirod.models.backbone.influence.bound import Influence
    from multirod.models.backbone.kernels.layout.features import Features
    from multirod.models.backbone.members.lines import Line
    from multirod.results.found import Found
    from multirod.results.solution import Solution
    from multirod.solver import Solver
else:
    from typing import TypeVar


@dataclass(frozen=True)
class Backbone:
    """One backbone of a robot, a rod or tubes that bend alike, and what holds it.

    Attributes:
        rods: Which of the robot's rods they are.
        tip: Whether something holds its tip; its base is always held.
        name: That it was given by the robot, if any.
        holes: How many it slides through.
    """

    rods: slice
    tip: bool
    name: str = ""
    holes: int = 0


class Assembly(Asked, Designs, ReadOnly, ABC):
    """Rods, how they are coupled, and what actuates them. Knows nothing of solvers.

    Attributes:
        rods: The rods, in the order of inputs per rod.
        mass_carried: Of rigid bodies that these carry [kg].
    """

    instead = "make another robot, as it is to be"
    called = OF_ROBOTS
    rods: tuple[Rod, ...]
    mass_carried: float = 0.0
    if TYPE_CHECKING:
        _input_name: Any  # of the names of inputs, those that ``Solution.jacobian`` takes: a ``Literal`` where they are known
    end_held: ClassVar[bool] = False  # whether something holds the end of its last rod, whose reactions solutions tell
    length_columns: ClassVar[bool] = False  # whether its problems take ``lengths``, and give how the lengths of lines vary

    @property
    def backbones(self) -> tuple[Backbone, ...]:
        """What holds each backbone, in the order of the rods."""
        raise NotImplementedError(f"{type(self).__name__} does not say what its rods do to what holds them")

    @property
    def end_loads(self) -> dict[str, slice]:
        """Inputs that are the dead force and the dead moment on the end effector, and which of their numbers are."""
        return {"tip_force": slice(0, 3), "tip_moment": slice(0, 3)}

    @property
    def lines(self) -> "list[tuple[int, Line]]":
        """Lines of all rods in their order, each with the index of its rod."""
        return [(k, line) for k, rod in enumerate(self.rods) for line in rod.lines]

    @property
    def elimination(self) -> Elimination | None:
        """How ``Gamma`` is eliminated by its problems on the CPU, where it is mostly zeros."""
        return None

    @property
    @abstractmethod
    def input_specs(self) -> tuple[InputSpec, ...]:
        """The inputs that this assembly takes."""

    @abstractmethod
    def problem(
        self,
        inputs: Inputs,
        *,
        integrator: "Integrator",
        device: str = "cpu",
        pose_sensitivities: bool = False,
        direction_count: int = 0,
        enabled: Sequence[str] = (),
        instances: IntArray | None = None,
    ) -> BoundaryProblem:
        """The boundary problem at ``inputs``.

        Args:
            inputs: Made by ``self.inputs(...)``.
            integrator: Of the spatial equations.
            device: Warp device.
            pose_sensitivities: Whether the columns include the end effector's pose.
            direction_count: Columns for derivatives along directions in input space.
            enabled: Inputs whose terms are compiled in although they are zero now.
            instances: Numbers, in the flattened batch, of the only ones to be solved, shape (instance_count,); all by default.
                What is compiled in is the same as for all. An assembly that does not take this is solved in one piece.
        """

    def features(self, inputs: Inputs, *, enabled: Iterable[str] = ()) -> tuple["Features", ...]:
        """What is compiled in for ``inputs``, and for those named in ``enabled``: the features of each kernel."""
        raise NotImplementedError(f"{type(self).__name__} does not say what is compiled in")

    def influences(self, inputs: Inputs) -> Mapping[str, "Influence"]:
        """What dropping each term does to the end effector, in the worst of all instances; what is not named is not known."""
        return {}

    def input_directions(self, *names: str) -> dict[str, Any]:
        """Options of ``problem`` that give it the directions which ``BoundaryProblem.input_columns`` needs for some inputs, or
        parameters of the robot."""
        return {"direction_count": sum(self.column_count(name) for name in names)}

    @property
    def parameters(self) -> tuple[str, ...]:
        """Parameters of the robot by which its problems give derivatives, beside those by inputs."""
        return ()

    def column_count(self, name: str) -> int:
        """How many columns derivatives by an input have, or by one of ``parameters``."""
        return next(spec.size(self.rod_count) for spec in self.input_specs if spec.name == name)

    @property
    def numbers_by_name(self) -> Mapping[str, Mapping[str, int]]:
        """Of inputs that are taken by name, of rods or lines, how many numbers each of those named has, in their order."""
        return each_named(self.rods, self.input_specs)

    @property
    def driven(self) -> tuple[str, ...] | None:
        """Names of the rods that motors turn and push, of which tasks choose ``rotation`` and ``translation``; None is all."""
        return None

    def ends_meet(self, inputs: Inputs) -> bool:
        """Whether ends of sections are at one place, in any instance, so that derivatives by what moves one have a side."""
        return False

    def with_rods(self, rods: Sequence[Rod]) -> Self:
        """The same assembly of other rods, as many, and as long."""
        raise NotImplementedError(f"{type(self).__name__} cannot change its rods")

    def with_base(self, base: FloatArray) -> Self:
        """The same assembly on a base at another pose in the world, shape (..., 4, 4)."""
        raise NotImplementedError(f"{type(self).__name__} has no base that can be moved")

    @property
    def rod_count(self) -> int:
        """Number of rods."""
        return len(self.rods)

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of the rods' parameters together."""
        return broadcast_shapes(*(rod.batch_shape for rod in self.rods))

    @hinted(INPUTS_NAMED)
    def inputs(self, **values: object) -> Inputs:
        """Actuation and loads by name, all optional: numbers or arrays, whose leading axes ``...`` broadcast.

        What is not named is zero. A leading axis makes a batch, an instance for each entry.

        Args:
            **values: By the names of ``input_specs``.

        Returns:
            The inputs, checked, as ``solve`` and ``simulate`` take them.

        Raises:
            TypeError: If a name is not one of these, no rod has such lines, or what the robot needs is not given.
            ValueError: If a value is out of range, not finite or of a wrong shape, or the leading axes do not broadcast.

        Warns:
            PlausibilityWarning: Of what is allowed and hardly meant, such as angles in degrees.
        """
        result = self.make_inputs(values)
        plausibility.of_inputs(self, result)
        return result

    def make_inputs(self, values: Mapping[str, Any]) -> Inputs:
        """``inputs(**values)``, of values that nobody gave: nothing is said of how plausible they are."""
        from multirod.models.backbone.inputs import DRIVES

        for name in values.keys() & DRIVES:
            if all(spec.name != name for spec in self.input_specs):
                refuse(name, values[name], f"must not be given: no rod has a line that is driven by it{self._driven(name)}")
        if any(isinstance(value, Mapping) for value in values.values()):
            values = self._arranged(values)
        needs_length = any(callable(value) for value in values.values())
        reach = 0.0, np.inf
        if needs_length:
            plain = {name: value for name, value in values.items() if not callable(value)}
            reach = self._reach(Inputs(self.input_specs, self.rod_count, plain))
        result = Inputs(self.input_specs, self.rod_count, values, *reach)
        self._refuse_left_out(result)
        self._check_axes(result)
        self.check(result)
        result.checked_by(self)
        return result

    def _arranged(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Values with those in order that are given by name, where they can be."""
        named = self.numbers_by_name
        return {
            name: arranged(self, name, value) if isinstance(value, Mapping) and named.get(name) else value
            for name, value in values.items()
        }

    def _driven(self, name: str) -> str:
        """What drives the lines that there are in the place of ``name``, as a message ends."""
        drives = [spec.name for spec in self.input_specs if spec.acts == "lines"]
        return f", they are driven by {' and '.join(drives)} (see driven= of Tendon)" if drives else ""

    def beyond_limits(self, solution: "Solution", instance: int) -> str:
        """What of an instance that is ``OUT_OF_LIMITS`` is beyond limits of the robot itself, as a message ends."""
        return ""

    def _refuse_left_out(self, inputs: Inputs) -> None:
        for spec in self.input_specs:
            if spec.required and spec.name not in inputs.given:
                what = f"{spec.description} [{spec.unit}]"
                raise TypeError(f"{spec.name} was not given: {type(self).__name__} needs it, {what}, inputs({spec.name}=...)")

    def accept(self, inputs: Inputs | None, field: str = "inputs") -> Inputs:
        """``inputs`` if they fit this assembly; None is all zero. An error calls them ``field``.

        Raises:
            TypeError: If they are not made by ``inputs(...)``, or name inputs that this assembly does not take.
            ValueError: If a value is out of range here, or a robot made them that has more rods or lines, or fewer.
        """
        if inputs is None:
            return self.inputs()
        if not isinstance(inputs, Inputs):
            raise TypeError(f"{field} must be made by robot.inputs(...), not {type(inputs).__name__}")
        if inputs.was_checked_by(self):
            return inputs
        unknown_names("the robot", inputs.given, (spec.name for spec in self.input_specs))
        inputs.refuse_others(field, type(self).__name__, self.input_specs, self.rod_count)
        self._check_axes(inputs)
        self._refuse_left_out(inputs)
        inputs.refuse_missing()
        self.check(inputs)
        inputs.checked_by(self)
        return inputs

    def compile(
        self,
        inputs: Inputs | None = None,
        *,
        solver: "Solver | None" = None,
        shape: bool = True,
        jacobian: str | Iterable[str] = (),
        stability: bool = False,
        motion: bool = False,
        device: str = "cpu",
        progress: bool | Callable[[int], object] = True,
    ) -> int:
        """Have the kernels of a scene compiled now, several at a time, so that no later call waits for them.

        A kernel holds the terms of one scene: which loads act, by which solver and integrator, and what is asked of the result.
        So a scene is done here once, or the first instances of a batch. It takes seconds the first time, and next to nothing once
        all is in Warp's cache. What only some instances come to, such as another way where a branch ends, is compiled then.

        Args:
            inputs: The scene, made by ``self.inputs(...)``: what is not zero is compiled in. None are all zero.
            solver: ``Shooting()`` by default.
            shape: Whether ``solution.rod(...)`` or ``energy`` will be asked for.
            jacobian: Input, or inputs, that ``solution.jacobian(...)`` will be asked for.
            stability: Whether ``solution.stability``, ``index`` or ``stability_margin`` will be asked for.
            motion: Whether it will be followed, by ``simulate`` or a ``Tracker``: the first axis of ``inputs``, if any, is time.
            device: Warp device.
            progress: Whether to show a bar, in a terminal or a notebook, where it takes more than two seconds; or a function
                that is called with the number of kernels compiled.

        Returns:
            How many kernels were compiled; 0 if all were in Warp's cache.

        Raises:
            TypeError, ValueError: If an argument is not what it must be.
            CompileError: If a kernel cannot be compiled, or the cache not be written.
        """
        from multirod.running.preparing import prepare

        return prepare(
            self,
            inputs,
            solver=solver,
            shape=shape,
            jacobian=jacobian,
            stability=stability,
            motion=motion,
            device=device,
            progress=progress,
        )

    def _repr_html_(self) -> str:
        from multirod.results import html

        return html.robot(self)

    def _check_axes(self, inputs: Inputs) -> None:
        try:
            broadcast_shapes(inputs.batch_shape, self.batch_shape)
        except ValueError:
            raise ValueError(
                f"the inputs' leading axes {inputs.batch_shape} do not broadcast with the rods' {self.batch_shape}"
            ) from None

    def check(self, inputs: Inputs) -> None:
        """Refuse inputs that this assembly cannot take, by a ``ValueError``."""

    def surely_takes(self, name: str, values: Sequence[float]) -> bool:
        """Whether finite numbers of one input, of one instance, are sure to pass ``check``; told within a microsecond.

        A control loop asks this at every sample; where the answer is False, ``check`` decides.
        """
        return True

    def _reach(self, inputs: Inputs) -> tuple[float, float]:
        """Largest arclength in use [m], for functions of arclength, and that of the rod that has least."""
        pushed = inputs.translation
        shortest = min(float(rod.length.min()) for rod in self.rods) + float(np.min(pushed, initial=0.0))
        return self.longest + float(np.max(pushed, initial=0.0)), max(shortest, 0.01 * self.longest)

    def inputs_of(self, found: "Found[Any]") -> Inputs:
        """What is applied in a solution: as it was given, or as its unknowns say."""
        return found._applied

    def begin_at(self, unknowns: FloatArray, found: "Found[Any]", problem: BoundaryProblem, piece: Any) -> FloatArray:  # noqa: ANN401  (an index)
        """Unknowns of a problem, (instance_count, n), by which it begins where a guess was ``found``: that guess has these.

        ``piece`` says which instances of it are those of the problem, if it has more than one.
        """
        return unknowns

    def bent_at_base(self, unknowns: FloatArray) -> FloatArray | None:
        """Curvature less precurvature at the base of a single rod [1/m], shape (k, 2), by unknowns (k, n); None if these do not
        tell."""
        return None

    @cached_property
    def longest(self) -> float:
        """Length of the longest rod [m]."""
        return max(float(rod.length.max()) for rod in self.rods)

    def arms(self, spec: InputSpec) -> FloatArray:
        """How far from the centreline the lines that an input drives run at most [m], one number each; a thousandth of the
        longest rod at least."""
        lines = ((rod, line) for rod in self.rods for line in rod.lines if line.drive is not None and line.drive[0] == spec.name)
        return np.array([max(line.arm(rod.sections), 1e-3 * self.longest) for rod, line in lines])

    def borne(self, spec: InputSpec) -> FloatArray:
        """What a load is multiplied by to be a force or a moment, where there is most of it: a number, ``spec.on``, or one for
        each line, whose force over the longest rod bends as its moment does; 1 of what is one itself. A mass that rods carry
        counts as if the longest had it along itself."""
        if spec.acts == "lines":
            lines = (line for rod in self.rods for line in rod.lines if line.drive is not None and line.drive[0] == spec.name)
            borne = np.array([float(np.max(getattr(line, spec.on))) if spec.on else 1.0 for line in lines])
            return np.asarray(borne * self.arms(spec) / self.longest)
        if not spec.on:
            return np.ones(())
        of_sections = (np.asarray(getattr(section, spec.on)) for rod in self.rods for section in rod.sections)
        most = max(float(np.abs(value).max(initial=0.0)) for value in of_sections)
        return np.asarray(most + self.mass_carried / self.longest * (spec.load == "force"))

    @cached_property
    def stiffest(self) -> float:
        """Bending stiffness of all rods together, where each is stiffest [N m^2]."""
        return sum(max(float(np.max(section.bending_stiffness)) for section in rod.sections) for rod in self.rods)


if TYPE_CHECKING:
    Robot = TypeVar("Robot", bound=Assembly)
    Robot_co = TypeVar("Robot_co", bound=Assembly, covariant=True, default=Assembly)
else:  # without a default, which needs Python 3.13
    Robot = TypeVar("Robot", bound=Assembly)
    Robot_co = TypeVar("Robot_co", bound=Assembly, covariant=True)
