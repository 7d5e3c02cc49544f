"""Kinds of lines: tendons, push rods and chambers, each with the law that it has by how it is driven and whether it rubs."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, ClassVar, Literal, Self, Unpack

import numpy as np

from multirod import profile
from multirod.models.backbone.kernels.members.lines import section_chamber_law, tendon_law
from multirod.models.backbone.members.lines import DrivenByLength, Line, Where
from multirod.models.backbone.members.member import Member
from multirod.naming import hinted, signed_as
from multirod.types import Numbers
from multirod.validation import FloatArray, array, choice, positive_array, refuse

if TYPE_CHECKING:
    from multirod.rod import Section

AT_AN_OFFSET = "an offset is one pair, {0}((0.008, 0){1}), at a radius r and an angle a (r*cos(a), r*sin(a)), all else is named"


class TendonOptions(Where, total=False):
    """What a ``Tendon`` is made with beside its offset and its friction."""

    driven: Literal["tension", "displacement"]
    axial_stiffness: Numbers | None
    rest_length: float | None


class Tendon(Line):
    """A tendon that slides along a rod, with or without friction, and pulls where it ends.

    Args:
        offset: From the centreline in the material frame [m], shape (..., 2).
        route: Instead, a smooth function of the arclength [m] from the rod's base that returns two numbers.
        start: Arclength where it enters the rod [m].
        end: Where it is fastened [m]; None, the default, is the end of the rod.
        driven: The input by which it is driven: ``"tension"`` [N], which is >= 0, or ``"displacement"``, how far it is pulled out
            of the base [m]. It is slack where it would have to push.
        axial_stiffness: ``EA`` [N] of one that is driven by displacement, shape (...); infinite by default: it does not stretch.
        rest_length: Its length without tension [m], of one that is driven by displacement; None, the default, is how long it is
            in the rod without load.
        friction: Coefficient of friction between tendon and rod: > 0 while it is being pulled out of the base, so that its
            tension falls towards its end, and < 0 while it goes back, shape (...).
        name: How it is called in results and recordings.

    Raises:
        TypeError: If both or neither of ``offset`` and ``route`` are given.
        ValueError: If a value is out of range; the message names it, its value and what is allowed.
    """

    drive: ClassVar = ("tension", (1, 0))
    convex = True  # (L4): where tensions are not negative
    friction: FloatArray = np.asarray(0.0)

    @hinted(AT_AN_OFFSET.format("Tendon", ""))
    def __init__(
        self,
        offset: Numbers | None = None,
        *,
        route: Callable[[float], Numbers] | None = None,
        start: float = 0.0,
        end: float | None = None,
        driven: Literal["tension", "displacement"] = "tension",
        axial_stiffness: Numbers | None = None,
        rest_length: float | None = None,
        friction: Numbers = 0.0,
        name: str = "",
    ) -> None:
        for field, value in (("axial_stiffness", axial_stiffness), ("rest_length", rest_length)):
            if value is not None:
                refuse(f"Tendon.{field}", value, 'must not be given where driven = "tension"')
        super().__init__(offset, route=route, start=start, end=end, name=name)

    @signed_as(__init__)
    def __new__(cls, *_: object, driven: str = "tension", friction: Numbers = 0.0, **__: object) -> Self:
        """Of another law, where it is driven by displacement or rubs."""
        choice("Tendon.driven", driven, ("tension", "displacement"))
        if cls is not Tendon:
            return super().__new__(cls)
        rubs = bool(np.any(array("Tendon.friction", friction, ())))
        laws: dict[str, tuple[type[Tendon], type[Tendon]]] = {
            "tension": (Tendon, RubbingTendon),
            "displacement": (DisplacedTendon, RubbingDisplacedTendon),
        }
        return super().__new__(laws[driven][rubs])  # type: ignore[return-value]

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:  # noqa: D102
        return tendon_law(numbers, len(Tendon.parameters), discs_at=1)


class DisplacedTendon(DrivenByLength, Tendon):
    """A ``Tendon`` that is driven by displacement: slack where it would have to push, (L8)."""

    drive: ClassVar = DrivenByLength.drive
    slackens = True
    convex = True

    def __init__(
        self,
        offset: Numbers | None = None,
        *,
        driven: Literal["tension", "displacement"] = "displacement",
        axial_stiffness: Numbers | None = None,
        rest_length: float | None = None,
        friction: Numbers = 0.0,
        **where: Unpack[Where],
    ) -> None:
        DrivenByLength.__init__(self, offset, axial_stiffness=axial_stiffness, rest_length=rest_length, **where)


class RubbingTendon(Tendon):
    """A ``Tendon`` with friction, (L12)."""

    written = Tendon.written | {"friction"}
    parameters: ClassVar = {**Line.parameters, "friction": (0, 0)}
    functions: ClassVar = {**Line.functions, "left": (0, 0)}
    rubs = True
    convex = False

    def __init__(self, offset: Numbers | None = None, *, friction: Numbers, **options: Unpack[TendonOptions]) -> None:
        super().__init__(offset, **options)
        self.friction = array("Tendon.friction", friction, ())

    @property
    def batch_shape(self) -> tuple[int, ...]:  # noqa: D102
        return np.broadcast_shapes(super().batch_shape, self.friction.shape)

    def values(self, section: "Section", s: float) -> FloatArray:  # noqa: D102
        own = super().values(section, s)
        shape = np.broadcast_shapes(own.shape[:-1], self.friction.shape)
        own, count = np.broadcast_to(own, (*shape, own.shape[-1])), len(Line.parameters)
        friction = np.broadcast_to(self.friction, shape)[..., None] * own[..., :1]  # none before it begins
        return np.concatenate([own[..., :count], friction, own[..., count:]], axis=-1)

    def smooth(self) -> Tendon:  # noqa: D102
        result = object.__new__(DisplacedTendon if isinstance(self, DisplacedTendon) else Tendon)
        vars(result).update({name: value for name, value in vars(self).items() if name != "friction"})
        return result

    def polynomials(self, s: float) -> tuple[float, float, FloatArray]:  # noqa: D102
        begin, end, terms = super().polynomials(s)
        return begin, end, np.concatenate([terms, np.zeros((*terms.shape[:-1], 1))], axis=-1)

    def _offset_and_slope(self, s: float) -> tuple[FloatArray, FloatArray]:
        rho, slope = super()._offset_and_slope(s)
        return rho[..., :2], slope[..., :2]

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:  # noqa: D102
        return tendon_law(numbers, len(RubbingTendon.parameters), discs_at=1, friction_at=len(Line.parameters))


class RubbingDisplacedTendon(RubbingTendon, DisplacedTendon):
    """The same, driven by displacement: it does not stretch."""

    written = RubbingTendon.written | DisplacedTendon.written
    drive: ClassVar = DrivenByLength.drive

    def __init__(self, offset: Numbers | None = None, *, friction: Numbers, **options: Unpack[TendonOptions]) -> None:
        if options.get("axial_stiffness") is not None:
            refuse(
                "Tendon.axial_stiffness",
                options["axial_stiffness"],
                "must not be given with friction: its tension is not the same all along",
            )
        super().__init__(offset, friction=friction, **options)


class PushRod(DrivenByLength):
    """A push rod: it slides along a rod without friction, and pushes or pulls where it ends.

    Its input is ``displacement``, how far it is pulled out of the base [m]; negative where it is pushed in.

    Args:
        offset: From the centreline in the material frame [m], shape (..., 2).
        route: Instead, a smooth function of the arclength [m] from the rod's base that returns two numbers.
        start: Arclength where it enters the rod [m].
        end: Where it is fastened [m]; None, the default, is the end of the rod.
        driven: ``"displacement"``, the only way.
        axial_stiffness: ``EA`` [N], shape (...); infinite by default.
        bending_stiffness: ``EI`` [N m^2], shape (...); zero by default. Where it is not, the push rod is straight at rest, as the
            rod has to be, and runs at a constant offset.
        rest_length: Its length without load [m]; None, the default, is how long it is in the rod without load.
        name: How it is called in results and recordings.

    Raises:
        TypeError: If both or neither of ``offset`` and ``route`` are given.
        ValueError: If a value is out of range; the message names it, its value and what is allowed.
    """

    written = DrivenByLength.written | {"bending_stiffness"}
    parameters: ClassVar = {**Line.parameters, "bending": (1, 2)}

    @hinted(AT_AN_OFFSET.format("PushRod", ""))
    def __init__(
        self,
        offset: Numbers | None = None,
        *,
        route: Callable[[float], Numbers] | None = None,
        start: float = 0.0,
        end: float | None = None,
        driven: Literal["displacement"] = "displacement",
        axial_stiffness: Numbers | None = None,
        bending_stiffness: Numbers | None = None,
        rest_length: float | None = None,
        name: str = "",
    ) -> None:
        choice("PushRod.driven", driven, ("displacement",))
        super().__init__(
            offset, route=route, start=start, end=end, name=name, axial_stiffness=axial_stiffness, rest_length=rest_length
        )
        given = bending_stiffness is not None
        self.bending_stiffness = positive_array("PushRod.bending_stiffness", bending_stiffness) if given else np.asarray(0.0)
        if given and route is not None:
            refuse("PushRod.bending_stiffness", bending_stiffness, "must not be given with a route: its offset must be constant")

    @property
    def batch_shape(self) -> tuple[int, ...]:  # noqa: D102
        return np.broadcast_shapes(super().batch_shape, self.bending_stiffness.shape)

    def on(self, sections: "Sequence[Section]", discs: float = 0.0) -> Self:  # noqa: D102
        straight = not any(isinstance(s.precurvature, profile.Profile) or np.any(s.precurvature) for s in sections)
        if self.bending_stiffness.any() and not straight:
            refuse(
                "PushRod.bending_stiffness", self.bending_stiffness.tolist(), "must not be given where the rod is bent at rest"
            )
        return super().on(sections, discs)

    def values(self, section: "Section", s: float) -> FloatArray:  # noqa: D102
        found = super().values(section, s)
        shape = np.broadcast_shapes(found.shape[:-1], self.bending_stiffness.shape)
        found = np.broadcast_to(found, (*shape, found.shape[-1]))
        bending = np.broadcast_to(self.bending_stiffness, shape)[..., None] * found[..., :1]
        own = len(Line.parameters)
        return np.concatenate([found[..., :own], bending, found[..., own:]], axis=-1)

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:  # noqa: D102
        return tendon_law(numbers, len(PushRod.parameters), bending_at=len(Line.parameters), discs_at=1)


def refuse_redundant(lines: "Sequence[Line]", extensible: bool) -> None:
    """Refuse push rods that do not stretch and are more than their lengths determine, by a ``ValueError``."""
    rigid = [
        line for line in lines if isinstance(line, PushRod) and line.offset is not None and np.isinf(line.axial_stiffness).any()
    ]
    for span in {(line.start, line.end) for line in rigid}:
        beside = [line for line in rigid if (line.start, line.end) == span]
        offsets = np.stack(np.broadcast_arrays(*(np.asarray(line.offset) for line in beside)), axis=-2)
        if extensible:
            offsets = np.concatenate([offsets, np.full((*offsets.shape[:-1], 1), np.abs(offsets).max())], axis=-1)
        if np.min(np.linalg.matrix_rank(offsets, tol=1e-9 * np.abs(offsets).max())) < len(beside):
            refuse(
                "PushRod.axial_stiffness",
                np.inf,
                f"must be finite: {len(beside)} push rods beside each other that do not stretch have no tensions of their own",
            )


def refuse_beside_friction(lines: "Sequence[Line]", members: "Sequence[Member]") -> None:
    """Refuse what the equations of friction leave out, by a ``ValueError``."""
    rubbing = [line for line in lines if line.rubs]
    if not rubbing:
        return
    friction = np.asarray(rubbing[0].friction).tolist()  # type: ignore[attr-defined]
    if members:
        refuse("Tendon.friction", friction, "must be zero in a rod with members")


class Chamber(Line):
    """A chamber along a rod, filled with a fluid: its pressure lengthens it.

    Its input is ``pressure`` [Pa], more than around the robot.

    Args:
        offset: Of its middle from the centreline in the material frame [m], shape (..., 2).
        route: Instead, a smooth function of the arclength [m] from the rod's base that returns two numbers.
        area: Of its section [m^2], shape (...).
        area_fixed: What does not change as the rod bends: the area ``"across"`` the chamber's own direction, or that in the
            ``"section"`` of the rod (``docs/lines.md``, L9).
        start: Arclength where it begins [m].
        end: Where it ends [m]; None, the default, is the end of the rod.
        name: How it is called in results and recordings.

    Raises:
        TypeError: If both or neither of ``offset`` and ``route`` are given.
        ValueError: If a value is out of range; the message names it, its value and what is allowed.
    """

    written = Line.written | {"area"}
    parameters: ClassVar = {"weight": (0, 2), "discs": (0, 2)}
    drive: ClassVar = ("pressure", (1, -2))

    @hinted(AT_AN_OFFSET.format("Chamber", ", area=2e-5"))
    def __init__(
        self,
        offset: Numbers | None = None,
        *,
        route: Callable[[float], Numbers] | None = None,
        area: Numbers | None = None,
        area_fixed: Literal["across", "section"] = "across",
        start: float = 0.0,
        end: float | None = None,
        name: str = "",
    ) -> None:
        super().__init__(offset, route=route, start=start, end=end, name=name)
        if area is None:
            raise TypeError("Chamber needs area")
        self.area = positive_array("Chamber.area", area)

    @signed_as(__init__)
    def __new__(cls, *_: object, area_fixed: str = "across", **__: object) -> Self:
        """Of another law, where the area in the section is fixed."""
        choice("Chamber.area_fixed", area_fixed, ("across", "section"))
        return super().__new__(SectionChamber if cls is Chamber and area_fixed == "section" else cls)  # type: ignore[return-value]

    @property
    def weight(self) -> FloatArray:  # noqa: D102
        return -self.area

    @property
    def batch_shape(self) -> tuple[int, ...]:  # noqa: D102
        return np.broadcast_shapes(super().batch_shape, np.shape(self.area))

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:  # noqa: D102
        return tendon_law(numbers, len(Chamber.parameters))


class SectionChamber(Chamber):
    """A ``Chamber`` whose area in the rod's section is fixed, (L9)."""

    convex = True  # the energy is linear

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:  # noqa: D102
        return section_chamber_law(numbers, len(Chamber.parameters))
