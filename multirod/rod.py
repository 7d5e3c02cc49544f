"""Rods: lengths, stiffnesses and precurvature, checked at construction."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from multirod import plausibility, profile
from multirod.batch import IntArray, take
from multirod.types import AlongRod, Numbers, Precurvature
from multirod.validation import (
    LARGEST,
    SMALLEST,
    Described,
    FloatArray,
    Kind,
    array,
    boolean,
    frozen,
    nonnegative_float,
    number,
    positive_array,
    positive_float,
    refuse,
)

if TYPE_CHECKING:
    from multirod.models.backbone.members.lines import Line
    from multirod.models.backbone.members.member import Member

SHORTEST_SECTION = 1e-300  # m: as good as none
SAME_PLACE = 1e-12  # of its arclength: a cut that near the end of a section is there
LARGEST_DIAMETER = 1e12  # m, whose fourth power no modulus makes too large


def _pair(name: str, value: object, *, infinite: bool) -> FloatArray:
    """Stiffness about or along the two bending axes, shape (..., 2), from one value or a pair."""
    result = positive_array(name, value, infinite=infinite)
    if result.ndim == 0 or result.shape[-1] not in (1, 2):
        result = result[..., None]
    return np.broadcast_to(result, (*result.shape[:-1], 2))


def _may_be_batch(given: object, pair: FloatArray) -> bool:
    """Whether two numbers were given as an array or a list, which may have been meant as a batch; a tuple is a pair."""
    plain = isinstance(given, list) or (isinstance(given, np.ndarray) and given.flags.writeable)
    return plain and pair.shape == (2,) and pair[0] != pair[1]


def _foundation(name: str, value: object) -> FloatArray:
    """Stiffness of a medium along three axes, shape (..., 3), from one number or three."""
    result = array(name, value)
    if (result < 0).any():
        refuse(name, value, "must be finite and >= 0")
    if result.ndim == 0 or result.shape[-1] not in (1, 3):
        result = result[..., None]
    return np.broadcast_to(result, (*result.shape[:-1], 3))


def _is_function(value: object) -> bool:
    return callable(value) and not isinstance(value, np.ndarray)


def _is_by_section(value: object) -> bool:
    return (
        isinstance(value, (list, tuple))
        and len(value) > 0
        and all(
            isinstance(item, (list, tuple)) and len(item) == 2 and (_is_function(item[1]) or np.ndim(item[1]) >= 1)
            for item in value
        )
    )


_NONE: Any = 0.0
_ZERO: Any = (0.0, 0.0, 0.0)
_RIGID: Any = math.inf


@dataclass(frozen=True, kw_only=True, eq=False)
class Section:
    """A stretch of rod with one stiffness and one law of precurvature; any parameter may have leading batch axes.

    Attributes:
        length: Arclength [m].
        bending_stiffness: ``EI``, or ``(EI_x, EI_y)`` about the two material axes [N m^2], shape (..., 2) once built.
        torsional_stiffness: ``GJ`` [N m^2]; ``inf`` is rigid.
        precurvature: Stress-free curvature and twist ``u*`` in the material frame [1/m], shape (..., 3), or a function of
            the arclength [m] from the section's start that returns three numbers.
        shear_stiffness: ``GA``, or a pair [N], shape (..., 2) once built; ``inf`` (default) is unshearable.
        axial_stiffness: ``EA`` [N]; ``inf`` (default) is inextensible.
        linear_density: Mass per length [kg/m], for gravity.
        magnetisation: Magnetic moment per length in the material frame [A m], shape (..., 3), for magnetic fields.
        foundation: Stiffness per length of an elastic medium around it [N/m^2], one number, or three along the axes of the base,
            shape (..., 3) once built.

    Raises:
        ValueError: If a field is out of range; the message names the field, its value and what is allowed.
    """

    length: FloatArray
    bending_stiffness: FloatArray
    torsional_stiffness: FloatArray
    precurvature: FloatArray | profile.Profile = _ZERO
    shear_stiffness: FloatArray = _RIGID
    axial_stiffness: FloatArray = _RIGID
    linear_density: FloatArray = _NONE
    magnetisation: FloatArray = _ZERO
    foundation: FloatArray = _NONE
    flat_pairs: ClassVar[tuple[str, ...]] = ()  # of which a batch of two may be meant, for warnings

    if TYPE_CHECKING:  # what is given; the fields are what it becomes

        def __init__(
            self,
            *,
            length: Numbers,
            bending_stiffness: Numbers,
            torsional_stiffness: Numbers,
            precurvature: AlongRod = ...,
            shear_stiffness: Numbers = ...,
            axial_stiffness: Numbers = ...,
            linear_density: Numbers = ...,
            magnetisation: Numbers = ...,
            foundation: Numbers = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        self._check("Section")

    def _check(self, owner: str) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        given = {name: getattr(self, name) for name in ("bending_stiffness", "shear_stiffness")}
        put("length", positive_array(f"{owner}.length", self.length, smallest=SHORTEST_SECTION))
        put("bending_stiffness", _pair(f"{owner}.bending_stiffness", self.bending_stiffness, infinite=False))
        put("torsional_stiffness", positive_array(f"{owner}.torsional_stiffness", self.torsional_stiffness, infinite=True))
        put("shear_stiffness", _pair(f"{owner}.shear_stiffness", self.shear_stiffness, infinite=True))
        put("flat_pairs", tuple(name for name, value in given.items() if _may_be_batch(value, getattr(self, name))))
        put("axial_stiffness", positive_array(f"{owner}.axial_stiffness", self.axial_stiffness, infinite=True))
        density = array(f"{owner}.linear_density", self.linear_density)
        if (density < 0).any():
            refuse(f"{owner}.linear_density", self.linear_density, "must be finite and >= 0")
        put("linear_density", density)
        put("magnetisation", array(f"{owner}.magnetisation", self.magnetisation, (3,)))
        put("foundation", _foundation(f"{owner}.foundation", self.foundation))
        precurvature: Any = self.precurvature
        if _is_function(precurvature):
            if np.ndim(self.length):
                refuse(f"{owner}.length", self.length, "must be one number where precurvature is a function")
            put("precurvature", profile.fit(f"{owner}.precurvature", precurvature, float(self.length)))
        else:
            put("precurvature", array(f"{owner}.precurvature", precurvature, (3,)))
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray) and not value.size:
                refuse(f"{owner}.{item.name}", Described(f"array of shape {value.shape}"), "must have a value")
        _ = self.batch_shape  # refuses axes that do not broadcast

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of the parameters together."""
        shapes = {
            name: np.shape(getattr(self, name)) for name in ("length", "torsional_stiffness", "axial_stiffness", "linear_density")
        }
        shapes |= {
            name: getattr(self, name).shape[:-1]
            for name in ("bending_stiffness", "shear_stiffness", "magnetisation", "foundation")
        }
        if isinstance(self.precurvature, np.ndarray):
            shapes["precurvature"] = self.precurvature.shape[:-1]
        try:
            return np.broadcast_shapes(*shapes.values())
        except ValueError:
            named = ", ".join(f"{name} {shape}" for name, shape in shapes.items() if shape)
            raise ValueError(f"the batch axes of a section's parameters do not broadcast: {named}") from None


class Rod:
    """One elastic rod or tube: its length, stiffnesses and shape at rest; ``Rod.tube`` makes one from diameters and moduli.

    Give one set of stiffnesses with a ``length``, or ``sections``, along which frames are continuous. Material frame: z along the
    unsheared tangent, x and y the principal axes of bending. Any parameter may have leading batch axes; they broadcast.

    Args:
        length: Arclength [m].
        bending_stiffness: ``EI`` or ``(EI_x, EI_y)`` [N m^2]; a batch is given as (..., 1) or (..., 2). Two numbers are always
            ``(EI_x, EI_y)``; (...,) of another size is a batch too.
        torsional_stiffness: ``GJ`` [N m^2]; ``inf`` is rigid.
        precurvature: ``u*`` [1/m]: three numbers; a list of ``(section length, u*)`` pairs whose lengths add up to
            ``length``; or a function of the arclength [m] from the base that returns three numbers.
        shear_stiffness: ``GA`` or a pair [N]; ``inf`` (default) is unshearable.
        axial_stiffness: ``EA`` [N]; ``inf`` (default) is inextensible.
        linear_density: Mass per length [kg/m].
        magnetisation: Magnetic moment per length in the material frame [A m]: three numbers, volume magnetisation times
            cross-section.
        foundation: Stiffness per length of an elastic medium that holds each piece of the rod to its place on the line straight
            out of its base [N/m^2]: one number, or three along the axes of the base.
        members: What the rod carries along itself and that gives way with it (``Member``), whichever way its sections are given.
        lines: What runs along it at an offset and is pulled, such as ``Tendon`` (``docs/lines.md``), likewise.
        discs: Spacing of discs [m], between which tendons and push rods run straight; None, the default, is so close that it does
            not matter.
        sections: ``Section`` objects from base to tip, instead of all the above.
        outer_diameter: For drawing, to check that tubes nest, and for strain [m].
        inner_diameter: The same [m].
        name: How the rod is called in results and recordings.

    Raises:
        ValueError: If a parameter is out of range or of a wrong shape; the message names it, its value and what is allowed.
        TypeError: If both or neither of ``length`` and ``sections`` are given.

    Warns:
        PlausibilityWarning: Of what is allowed and hardly meant, such as a length in mm.
    """

    _material: plausibility.Material | None = None  # what a tube was made of, for warnings and files

    def __init__(
        self,
        *,
        length: Numbers | None = None,
        bending_stiffness: Numbers | None = None,
        torsional_stiffness: Numbers | None = None,
        precurvature: Precurvature | None = None,
        shear_stiffness: Numbers | None = None,
        axial_stiffness: Numbers | None = None,
        linear_density: Numbers | None = None,
        magnetisation: Numbers | None = None,
        foundation: Numbers | None = None,
        members: Sequence["Member"] = (),
        lines: Sequence["Line"] = (),
        discs: float | None = None,
        sections: Sequence[Section] | None = None,
        outer_diameter: float | None = None,
        inner_diameter: float | None = None,
        name: str = "",
    ) -> None:
        given = {
            "length": length,
            "bending_stiffness": bending_stiffness,
            "torsional_stiffness": torsional_stiffness,
            "precurvature": precurvature,
            "shear_stiffness": shear_stiffness,
            "axial_stiffness": axial_stiffness,
            "linear_density": linear_density,
            "magnetisation": magnetisation,
            "foundation": foundation,
        }
        properties = {key: value for key, value in given.items() if value is not None}
        if sections is not None:
            if properties:
                raise TypeError(f"Rod takes sections or {', '.join(properties)}, not both")
            if not isinstance(sections, (list, tuple)) or not sections or not all(isinstance(s, Section) for s in sections):
                refuse("Rod.sections", sections, "must be a non-empty list of Section")
            self.sections: tuple[Section, ...] = tuple(sections)
        else:
            for key in ("length", "bending_stiffness", "torsional_stiffness"):
                if key not in properties:
                    raise TypeError(f"Rod needs {key} (or sections; Rod.wire and Rod.tube take moduli and diameters)")
            self.sections = _by_section(properties)
        if (self.length < SMALLEST).any():
            refuse(
                "Rod.length",
                Described(self.length.tolist()),
                f"must be from {SMALLEST:g} to {LARGEST:g} m, all sections together",
            )
        self.members = _members(members)
        self.discs = None if discs is None else positive_float("Rod.discs", discs)
        self.lines = _lines(lines, self)
        self.outer_diameter, self.inner_diameter = _diameters(outer_diameter, inner_diameter)
        if not isinstance(name, str):
            refuse("Rod.name", name, "must be a string")
        self.name = name
        try:
            self.batch_shape: tuple[int, ...] = np.broadcast_shapes(
                *(section.batch_shape for section in self.sections), *(line.batch_shape for line in self.lines)
            )
        except ValueError:
            raise ValueError(f"the batch axes of a rod's sections{' and lines' * bool(lines)} do not broadcast") from None
        plausibility.of_rod(self, self._material)

    @classmethod
    def tube(
        cls,
        *,
        length: Numbers,
        outer_diameter: float,
        inner_diameter: float = 0.0,
        young_modulus: float,
        shear_modulus: float | None = None,
        poisson_ratio: float | None = None,
        extensible: bool = False,
        precurvature: Precurvature | None = None,
        density: float = 0.0,
        magnetisation: Numbers | None = None,
        members: Sequence["Member"] = (),
        lines: Sequence["Line"] = (),
        discs: float | None = None,
        name: str = "",
    ) -> "Rod":
        """A round tube: ``EI``, ``GJ`` and mass from its cross-section, and ``EA`` and ``GA`` where it is to stretch.

        Args:
            length: Arclength [m].
            outer_diameter: [m].
            inner_diameter: [m].
            young_modulus: ``E`` [Pa].
            shear_modulus: ``G`` [Pa].
            poisson_ratio: Instead, ``nu = E/(2G) - 1``.
            extensible: Whether it stretches and shears: ``axial_stiffness = E A`` and ``shear_stiffness = k G A`` of its section
                ``A``, with Timoshenko's shear coefficient by Cowper (1966),
                ``k = 6 (1 + nu) (1 + m^2)^2 / ((7 + 6 nu) (1 + m^2)^2 + (20 + 12 nu) m^2)``, ``m`` the inner over the outer
                diameter (``docs/model.md``, 5a). By default it does neither.
            precurvature: As for ``Rod``.
            density: Mass per volume [kg/m^3].
            magnetisation: Magnetic moment per volume in the material frame [A/m], three numbers; ``Rod`` itself takes it per
                length.
            members: As for ``Rod``.
            lines: As for ``Rod``.
            discs: As for ``Rod``.
            name: As for ``Rod``.

        Raises:
            ValueError: If a value is out of range, or the inner diameter is not smaller than the outer.
            TypeError: If both of ``shear_modulus`` and ``poisson_ratio`` are given.

        Warns:
            PlausibilityWarning: Of what is allowed and hardly meant, such as moduli in GPa.
        """
        outer, inner = _diameters(outer_diameter, inner_diameter)
        if outer is None or inner is None:
            refuse("Rod.outer_diameter" if outer is None else "Rod.inner_diameter", None, "must be a number")
        E = positive_array("Rod.young_modulus", young_modulus)
        G = _shear_modulus(E, shear_modulus, poisson_ratio)
        rho = nonnegative_float("Rod.density", density)
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            I = math.pi / 64 * (np.float64(outer) ** 4 - np.float64(inner) ** 4)
            A = math.pi / 4 * (np.float64(outer) ** 2 - np.float64(inner) ** 2)
            EI, GJ, mass = E * I, G * 2 * I, rho * A
        if not I > 0:
            refuse("Rod.outer_diameter", outer, "must be > inner_diameter by more than rounding, its fourth power no zero")
        for field_name, given, result in (("young_modulus", young_modulus, EI), ("shear_modulus", shear_modulus, GJ)):
            if not _within(result):
                refuse(f"Rod.{field_name}", given, f"must make EI and GJ from {SMALLEST:g} to {LARGEST:g} N m^2")
        stretching = {}
        if boolean("Rod.extensible", extensible):
            EA, GA = _stretching(E, G, A, np.float64(inner) / outer)
            if not (_within(EA) and _within(GA)):
                refuse("Rod.young_modulus", young_modulus, f"must make EA and GA from {SMALLEST:g} to {LARGEST:g} N")
            stretching = {"axial_stiffness": EA, "shear_stiffness": GA[..., None]}
        if not mass <= LARGEST:
            refuse("Rod.density", density, f"must make the mass per length at most {LARGEST:g} kg/m")
        if magnetisation is not None:
            magnetisation = array("Rod.magnetisation", magnetisation, (3,))
            plausibility.of_tube_magnetisation(magnetisation)
        rod = cls.__new__(cls)
        rod._material = plausibility.Material(E, G, rho, shear_given=poisson_ratio is None)
        rod.__init__(  # type: ignore[misc]  # which says what is not plausible of moduli by their own names
            length=length,
            bending_stiffness=EI[..., None],
            torsional_stiffness=GJ,
            **stretching,
            precurvature=precurvature,
            linear_density=float(mass),
            magnetisation=None if magnetisation is None else float(A) * magnetisation,
            outer_diameter=outer,
            inner_diameter=inner,
            members=members,
            lines=lines,
            discs=discs,
            name=name,
        )
        return rod

    @classmethod
    def wire(
        cls,
        *,
        length: Numbers,
        diameter: float,
        young_modulus: float,
        shear_modulus: float | None = None,
        poisson_ratio: float | None = None,
        extensible: bool = False,
        precurvature: Precurvature | None = None,
        density: float = 0.0,
        magnetisation: Numbers | None = None,
        members: Sequence["Member"] = (),
        lines: Sequence["Line"] = (),
        discs: float | None = None,
        name: str = "",
    ) -> "Rod":
        """A solid round wire: ``EI``, ``GJ`` and mass from its cross-section, and ``EA`` and ``GA`` where it is to stretch.

        Args:
            length: Arclength [m].
            diameter: [m].
            young_modulus: ``E`` [Pa].
            shear_modulus: ``G`` [Pa].
            poisson_ratio: Instead, ``nu = E/(2G) - 1``.
            extensible: As for ``Rod.tube``; here ``k = 6 (1 + nu) / (7 + 6 nu)``.
            precurvature: As for ``Rod``.
            density: Mass per volume [kg/m^3].
            magnetisation: As for ``Rod.tube``, per volume [A/m].
            members: As for ``Rod``.
            lines: As for ``Rod``.
            discs: As for ``Rod``.
            name: As for ``Rod``.

        Raises:
            ValueError: If a value is out of range.
            TypeError: If both of ``shear_modulus`` and ``poisson_ratio`` are given.

        Warns:
            PlausibilityWarning: Of what is allowed and hardly meant, such as a diameter in mm.
        """
        return cls.tube(
            length=length,
            outer_diameter=positive_float("Rod.diameter", diameter),
            young_modulus=young_modulus,
            shear_modulus=shear_modulus,
            poisson_ratio=poisson_ratio,
            extensible=extensible,
            precurvature=precurvature,
            density=density,
            magnetisation=magnetisation,
            members=members,
            lines=lines,
            discs=discs,
            name=name,
        )

    @property
    def length(self) -> FloatArray:
        """Arclength of the whole rod [m], shape (...)."""
        return np.asarray(frozen(np.asarray(sum(section.length for section in self.sections), dtype=np.float64)))

    @property
    def carried(self) -> "tuple[Member, ...]":
        """Members and lines: all that adds to the energy of its sections."""
        return (*self.members, *self.lines)

    @property
    def has_mass(self) -> bool:
        """Whether gravity acts on any of its sections."""
        return any(np.any(section.linear_density) for section in self.sections)

    @property
    def is_magnetised(self) -> bool:
        """Whether a magnetic field acts on any of its sections."""
        return any(np.any(section.magnetisation) for section in self.sections)

    @property
    def is_embedded(self) -> bool:
        """Whether an elastic medium is around any of its sections."""
        return any(np.any(section.foundation) for section in self.sections)

    def _repr_html_(self) -> str:
        from multirod import html

        return html.rod(self)

    def __repr__(self) -> str:
        label = f"{self.name!r}, " if self.name else ""
        size = f"{float(self.length):g} m" if self.length.ndim == 0 else f"batch {self.batch_shape}"
        made, (first, *others) = f"{len(self.sections)} sections", self.sections
        if not others:
            made = "1 section"
        if not others and not first.batch_shape:
            EI = " and ".join(f"{value:.4g}" for value in dict.fromkeys(first.bending_stiffness.tolist()))
            made = f"EI {EI}, GJ {float(first.torsional_stiffness):.4g} N m^2"
        lines = f", {len(self.lines)} line{'s' * (len(self.lines) > 1)}" if self.lines else ""
        return f"Rod({label}{size}, {made}{lines})"


def _members(given: object) -> "tuple[Member, ...]":
    from multirod.models.backbone.members.member import Member

    if not isinstance(given, (list, tuple)) or not all(isinstance(member, Member) for member in given):
        refuse("Rod.members", given, "must be a list of Member")
    return tuple(given)


def _lines(given: object, rod: Rod) -> "tuple[Line, ...]":
    if isinstance(given, (list, tuple)) and not given:
        return ()
    from multirod.models.backbone.members.lines import Line, refuse_beside_friction, refuse_redundant

    if not isinstance(given, (list, tuple)) or not all(isinstance(line, Line) for line in given):
        refuse("Rod.lines", given, "must be a list of lines, such as Tendon")
    names = [line.name for line in given if line.name]
    for name in names:
        if names.count(name) > 1:
            refuse("Rod.lines", names, f"must have names of their own, and {name!r} is there twice")
    refuse_redundant(given, any(np.isfinite(section.axial_stiffness).any() for section in rod.sections))
    refuse_beside_friction(given, rod.members)
    return tuple(line.on(rod.sections, rod.discs or 0.0) for line in given)


def _shear_modulus(E: FloatArray, shear_modulus: object, poisson_ratio: object) -> FloatArray:
    """``G`` [Pa], given or by Poisson's ratio."""
    if poisson_ratio is None:
        if shear_modulus is None:
            refuse("Rod.shear_modulus", None, "must be a number, or give poisson_ratio")
        return positive_array("Rod.shear_modulus", shear_modulus)
    if shear_modulus is not None:
        raise TypeError("Rod.tube and Rod.wire take shear_modulus or poisson_ratio, not both")
    ratio = number("Rod.poisson_ratio", poisson_ratio)
    if not -1 < ratio <= 0.5:
        refuse(
            "Rod.poisson_ratio",
            poisson_ratio,
            "must be > -1 and <= 0.5: no other is of a material that is alike in all directions",
        )
    return np.asarray(E / (2 * (1 + ratio)))


def _within(values: FloatArray) -> bool:
    return bool(((values >= SMALLEST) & (values <= LARGEST)).all())


def _stretching(E: FloatArray, G: FloatArray, A: FloatArray | float, hollow: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """(5a) ``EA`` and ``GA`` [N] of a round section of area ``A`` whose inner diameter is ``hollow`` times the outer."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        q, m2 = E / (2 * G), hollow**2  # 1 + nu
        k = 6 * q * (1 + m2) ** 2 / ((1 + 6 * q) * (1 + m2) ** 2 + (8 + 12 * q) * m2)
        return np.asarray(E * A), np.asarray(k * G * A)


def _diameters(outer: float | None, inner: float | None) -> tuple[float | None, float | None]:
    if outer is not None:
        outer = positive_float("Rod.outer_diameter", outer)
        if outer > LARGEST_DIAMETER:
            refuse("Rod.outer_diameter", outer, f"must be finite and > 0, and at most {LARGEST_DIAMETER:g} m")
    if inner is not None:
        value = number("Rod.inner_diameter", inner)
        limit = math.inf if outer is None else outer
        if not (math.isfinite(value) and 0 <= value < limit):
            refuse("Rod.inner_diameter", inner, "must be finite, >= 0 and smaller than outer_diameter")
        inner = value
    return outer, inner


def _by_section(properties: dict[str, Any]) -> tuple[Section, ...]:
    """The sections of a rod given by one set of properties and a precurvature in any of its three forms."""
    properties = {"precurvature": (0.0, 0.0, 0.0), **properties}
    if not _is_by_section(properties["precurvature"]):
        section = object.__new__(Section)
        for item in fields(Section):
            object.__setattr__(section, item.name, properties.get(item.name, item.default))
        section._check("Rod")
        return (section,)
    total = positive_array("Rod.length", properties["length"])
    sections = []
    for length, curvature in properties["precurvature"]:
        positive_array("Rod.precurvature section length", length, smallest=SHORTEST_SECTION)
        sections.append(_by_section({**properties, "length": length, "precurvature": curvature})[0])
    summed = np.asarray(sum(section.length for section in sections))
    if np.any(np.abs(summed - total) > 1e-9 * total):
        refuse("Rod.precurvature", properties["precurvature"], f"section lengths must add up to length = {total.tolist()}")
    return tuple(sections)


@dataclass(frozen=True)
class RodArrays:
    """Rods lowered to the arrays that kernels read; first axis the batch (1 where nothing varies).

    Attributes:
        end: Arclength of section ends from the base [m], shape (batch, rod_count, section_count); short rods are padded
            with sections of no length.
        material: ``EI_x, EI_y, GJ``, their inverses, ``1/GA_x, 1/GA_y, 1/EA``, mass per length, magnetic moment per length,
            stiffness of the foundation, parameters of members, then their functions, coefficients of one power after those of the
            power below, shape (batch, rod_count, section_count, 16 or more). Of eccentric rods, their
            offsets [m] stand there, and the torsional compliance of the line, which is zero.
        precurvature: Polynomial coefficients, shape (batch, rod_count, section_count, 3 (degree + 1)).
        section: Which of its rod's sections each piece belongs to, shape (batch, rod_count, section_count).
        degree: Degree of the polynomials.
        shear: Whether any rod shears or extends.
        anisotropic: Whether any bending stiffness differs between the axes.
        torsion: Whether any rod twists elastically.
        foundation: Whether a medium is around any rod.
        eccentric: Whether the rods run side by side.
        members: Laws of what the rods carry along themselves, whose parameters and functions are further columns of ``material``.
        member_rods: Of several rods, the one that carries each.
        member_degree: Degree of the polynomials of these functions.
        discs: Whether lines run straight between discs.
        batch_shape: Leading axes; where there are none, the batch axis is 1.
    """

    end: FloatArray
    material: FloatArray
    precurvature: FloatArray
    section: NDArray[np.intp]
    degree: int
    shear: bool
    anisotropic: bool
    torsion: bool
    foundation: bool = False
    eccentric: bool = False
    members: "tuple[type[Member], ...]" = ()
    member_rods: tuple[int, ...] = ()
    member_degree: int = 0
    discs: bool = False
    batch_shape: tuple[int, ...] = field(default=())

    def __post_init__(self) -> None:
        for name in ("end", "material", "precurvature", "section"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def take(self, batch_shape: tuple[int, ...], instances: IntArray | None = None) -> "RodArrays":
        """The arrays of some instances, along one axis, of a batch to whose leading axes these broadcast.

        ``instances`` are their numbers in the flattened batch; all of them, with the batch's own axes, by default. What does not
        vary stays one row.
        """
        if not self.batch_shape or (instances is None and self.batch_shape == batch_shape):
            return self
        return replace(
            self, batch_shape=batch_shape if instances is None else np.shape(instances), **self._rows(batch_shape, instances)
        )

    def repeated(self, batch_shape: tuple[int, ...]) -> "RodArrays":
        """The same with a row for every instance, whether or not it varies."""
        return replace(self, batch_shape=batch_shape, **self._rows(batch_shape, None))

    def _rows(self, batch_shape: tuple[int, ...], instances: IntArray | None) -> dict[str, Any]:
        values = {name: getattr(self, name) for name in ("end", "material", "precurvature", "section")}
        shaped = {name: value.reshape(*self.batch_shape, *value.shape[1:]) for name, value in values.items()}
        return {name: take(value, batch_shape, instances, tail=values[name].ndim - 1) for name, value in shaped.items()}


def stack(backbones: Sequence[RodArrays], batch_shape: tuple[int, ...]) -> RodArrays:
    """Several backbones of as many rods each, side by side along a last batch axis; each is lowered to ``batch_shape``."""
    sections = max(arrays.end.shape[2] for arrays in backbones)
    terms = max(arrays.precurvature.shape[3] for arrays in backbones)
    width = max(arrays.material.shape[3] for arrays in backbones)

    def padded(value: NDArray[Kind]) -> NDArray[Kind]:
        """Rods end with sections of no length, as ``lower`` pads them."""
        last = np.repeat(value[:, :, -1:], sections - value.shape[2], axis=2)
        return np.concatenate([value, last], axis=2)

    def wide(value: FloatArray) -> FloatArray:
        """Functions of members have no terms of higher powers."""
        return np.pad(value, ((0, 0), (0, 0), (0, 0), (0, width - value.shape[3])))

    def joined(values: list[NDArray[Kind]]) -> NDArray[Kind]:
        together = np.stack([padded(value) for value in values], axis=1)
        return together.reshape(-1, *together.shape[2:])

    return RodArrays(
        end=joined([arrays.end for arrays in backbones]),
        material=joined([wide(arrays.material) for arrays in backbones]),
        precurvature=joined(
            [
                np.pad(arrays.precurvature, ((0, 0), (0, 0), (0, 0), (0, terms - arrays.precurvature.shape[3])))
                for arrays in backbones
            ]
        ),
        section=joined([arrays.section for arrays in backbones]),
        degree=max(arrays.degree for arrays in backbones),
        shear=any(arrays.shear for arrays in backbones),
        anisotropic=any(arrays.anisotropic for arrays in backbones),
        torsion=any(arrays.torsion for arrays in backbones),
        foundation=any(arrays.foundation for arrays in backbones),
        members=backbones[0].members,
        member_rods=backbones[0].member_rods,
        member_degree=max(arrays.member_degree for arrays in backbones),
        discs=any(arrays.discs for arrays in backbones),
        batch_shape=(*batch_shape, len(backbones)),
    )


def _values(member: "Member", section: Section, s: float) -> list[FloatArray]:
    """The numbers of a member on a piece of a section, one by one."""
    count = member.value_count()
    values = array(f"{type(member).__name__}.values", member.values(section, s), (count,))
    return [values[..., k] for k in range(count)]


def _carried(
    rods: Sequence[Rod], own: int, section: Section, s: float, start: FloatArray, end: FloatArray, degree: int
) -> list[FloatArray]:
    """Parameters of the members of all rods on a piece of rod ``own`` from ``start`` to ``end`` (...), around s, then their
    functions, power by power; zero of what another rod carries."""
    found: list[FloatArray] = []
    functions = []
    for k, rod in enumerate(rods):
        for member in rod.carried:
            found += _values(member, section, s) if k == own else [np.zeros(())] * member.value_count()
            if member.functions and k == own:
                begin, stop, coefficients = member.polynomials(s)
                moved = profile.recentred(coefficients, begin, stop, start, end)
                functions.append(np.pad(moved, [(0, 0)] * (moved.ndim - 2) + [(0, degree + 1 - moved.shape[-2]), (0, 0)]))
            elif member.functions:
                functions.append(np.zeros((degree + 1, len(member.functions))))
    return found + [values[..., k, j] for k in range(degree + 1) for values in functions for j in range(values.shape[-1])]


def _cut(start: FloatArray, end: FloatArray, cuts: Sequence[float]) -> Iterator[tuple[float, FloatArray, FloatArray]]:
    """Parts of a piece from ``start`` to ``end`` (batch,) between ``cuts``: an arclength between these, start and end."""
    if not cuts:
        yield 0.0, start, end
        return
    begin, last = start, 0.0
    for cut in [*cuts, math.inf]:
        near = np.abs(cut - end) <= SAME_PLACE * end if math.isfinite(cut) else np.zeros(end.shape, dtype=bool)
        stop = np.where(near, end, np.clip(cut, start, end))
        if (stop > begin).any():
            yield (last + cut) / 2 if math.isfinite(cut) else last + 1.0, begin, stop
            begin = stop
        last = cut


def lower(rods: Sequence[Rod], offsets: FloatArray | None = None) -> RodArrays:
    """Arrays of ``rods``, their leading axes broadcast with each other (a batch axis of 1 where there are none).

    ``offsets`` (rod_count, 2) are those of rods that run side by side.
    """
    from multirod.models.backbone.members.member import kinds

    batch_shape = np.broadcast_shapes(*(rod.batch_shape for rod in rods))
    degree = profile.DEGREE if any(isinstance(s.precurvature, profile.Profile) for rod in rods for s in rod.sections) else 0
    carried = [member for rod in rods for member in rod.carried]
    polynomials = [member.polynomials(0.0)[2] for member in carried if member.functions]
    member_degree = max((values.shape[-2] - 1 for values in polynomials), default=0)

    def batch(value: FloatArray | float, tail: tuple[int, ...] = ()) -> FloatArray:
        return np.broadcast_to(np.asarray(value), (*batch_shape, *tail)).reshape(-1, *tail)

    def made_of(rod: int, section: Section, own: list[FloatArray], s: float, start: FloatArray, end: FloatArray) -> FloatArray:
        place = (s, start.reshape(batch_shape), end.reshape(batch_shape))
        return np.stack(own + [batch(value) for value in _carried(rods, rod, section, *place, member_degree)], -1)

    columns: list[list[tuple[Any, ...]]] = []
    for k, rod in enumerate(rods):
        aside = [] if offsets is None else [batch(value) for value in (*offsets[k], 0.0)]
        column: list[tuple[Any, ...]] = []
        end = np.zeros(math.prod(batch_shape))
        cuts = sorted({cut for member in rod.carried for cut in member.cuts})
        for place, section in enumerate(rod.sections):
            which = np.full(end.size, place)
            bending, shear = section.bending_stiffness, section.shear_stiffness
            parts = [bending[..., 0], bending[..., 1], section.torsional_stiffness]
            inverses = [*parts, shear[..., 0], shear[..., 1], section.axial_stiffness]
            own = (
                [batch(p) for p in parts]
                + [batch(1 / np.asarray(p)) for p in inverses]
                + [batch(section.linear_density)]
                + [batch(section.magnetisation[..., k]) for k in range(3)]
                + [batch(section.foundation[..., k]) for k in range(3)]
                + aside
            )

            if isinstance(section.precurvature, profile.Profile):
                pieces = section.precurvature
                at_base, curves = pieces(0.0), list(zip(end + pieces.ends[:, None], pieces.coefficients, strict=True))
            else:
                at_base = batch(section.precurvature, (3,))
                constant = np.zeros((end.size, degree + 1, 3))
                constant[:, 0] = at_base
                curves = [(end + batch(section.length), constant)]
            if not column and (isinstance(section.precurvature, profile.Profile) or member_degree):
                # what is pushed out of the base continues the first section, as it is there
                constant = np.zeros((end.size, degree + 1, 3))
                constant[:, 0] = at_base
                column.append((end, made_of(k, section, own, 0.0, end, end), constant.reshape(end.size, -1), which))
            for last, coefficients in curves:
                for s, start, stop in _cut(end, last, cuts):
                    moved = profile.recentred(coefficients, end, last, start, stop)
                    curved = np.broadcast_to(moved, (end.size, degree + 1, 3)).reshape(end.size, -1)
                    column.append((stop, made_of(k, section, own, s, start, stop), curved, which))
                end = last
        columns.append(column)
    count = max(len(column) for column in columns)
    for column in columns:
        column += [column[-1]] * (count - len(column))
    stacked = [np.stack([np.stack([entry[k] for entry in column], 1) for column in columns], 1) for k in range(4)]
    material = stacked[1]
    return RodArrays(
        end=stacked[0],
        material=material,
        precurvature=stacked[2],
        section=stacked[3],
        degree=degree,
        shear=bool((material[..., 6:9] > 0).any()),
        anisotropic=bool((material[..., 0] != material[..., 1]).any()),
        torsion=bool(np.isfinite(material[..., 2]).any()),
        foundation=bool(material[..., 13:16].any()),
        eccentric=offsets is not None,
        members=kinds(carried),
        member_rods=tuple(k for k, rod in enumerate(rods) for _ in rod.carried) if len(rods) > 1 else (),
        member_degree=member_degree,
        discs=any(rod.discs for rod in rods if rod.lines),
        batch_shape=batch_shape,
    )
