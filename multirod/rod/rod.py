"""Rods: lengths, stiffnesses and precurvature, checked at construction."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from multirod import plausibility
from multirod.naming import hinted
from multirod.read_only import ReadOnly
from multirod.rod.cross_section import Diameter, diameter_of, diameters, round_section, shear_modulus_of, stretching, within
from multirod.rod.section import OfSections, Section, by_section
from multirod.types import Numbers, Precurvature
from multirod.validation import (
    LARGEST,
    SMALLEST,
    Described,
    FloatArray,
    array,
    boolean,
    frozen,
    nonnegative_float,
    positive_array,
    positive_float,
    refuse,
)

if TYPE_CHECKING:
    from multirod.models.backbone.kernels.loads.load import Load
    from multirod.models.backbone.members.lines import Line
    from multirod.models.backbone.members.member import Member


_NAMED = "all is named, Rod(length=, bending_stiffness=, torsional_stiffness=, precurvature=); Rod.wire and Rod.tube take moduli"
_OF_MATERIAL = "all is named, such as length=, outer_diameter= of a tube, diameter= of a wire, young_modulus=, precurvature="


class Rod(OfSections, ReadOnly):
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
        magnetisation: Magnetic moment per length in the material frame [A m]: three numbers, that per volume [A/m] times
            cross-section.
        foundation: Stiffness per length of an elastic medium that holds each piece of the rod to its place on the line straight
            out of its base [N/m^2]: one number, or three along the axes of the base.
        members: What the rod carries along itself and that gives way with it (``Member``), whichever way its sections are given.
        lines: What runs along it at an offset and is pulled, such as ``Tendon`` (``docs/lines.md``), likewise.
        discs: Spacing of discs [m], between which tendons and push rods run straight; None, the default, is so close that it does
            not matter.
        loads: Loads along it that depend on its configuration (``Load``, ``docs/extending.md``), one of each kind.
        sections: ``Section`` objects from base to tip, instead of all the above.
        outer_diameter: For drawing, to check that tubes nest, and for strain [m], (...).
        inner_diameter: The same [m].
        name: How the rod is called in results and recordings.

    Raises:
        ValueError: If a parameter is out of range or of a wrong shape; the message names it, its value and what is allowed.
        TypeError: If both or neither of ``length`` and ``sections`` are given.

    Warns:
        PlausibilityWarning: Of what is allowed and hardly meant, such as a length in mm.
    """

    written = frozenset(
        ("sections", "members", "discs", "lines", "loads", "outer_diameter", "inner_diameter", "name", "batch_shape")
    )
    instead = "make another Rod(...), its numbers as they are to be"
    _material: plausibility.Material | None = None  # what a tube was made of, for warnings and files

    @hinted(_NAMED)
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
        loads: Sequence["Load"] = (),
        sections: Sequence[Section] | None = None,
        outer_diameter: Numbers | None = None,
        inner_diameter: Numbers | None = None,
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
                raise TypeError(f"Rod takes sections or {', '.join(properties)}, not both: give each Section its own")
            if not isinstance(sections, (list, tuple)) or not sections or not all(isinstance(s, Section) for s in sections):
                pieces = "; of rods in a row, theirs: [*first.sections, *second.sections]"
                refuse("Rod.sections", sections, f"must be a non-empty list of Section{pieces}")
            self.sections: tuple[Section, ...] = tuple(sections)
        else:
            for key in ("length", "bending_stiffness", "torsional_stiffness"):
                if key not in properties:
                    raise TypeError(f"Rod needs {key} (or sections; Rod.wire and Rod.tube take moduli and diameters)")
            self.sections = by_section(properties)
        if (self.length < SMALLEST).any():
            refuse(
                "Rod.length",
                Described(self.length.tolist()),
                f"must be from {SMALLEST:g} to {LARGEST:g} m, all sections together",
            )
        self.members = _members(members)
        self.discs = None if discs is None else positive_float("Rod.discs", discs)
        self.lines = _lines(lines, self)
        self.loads = _loads(loads)
        self.outer_diameter: Diameter | None
        self.inner_diameter: Diameter | None
        self.outer_diameter, self.inner_diameter = diameters(outer_diameter, inner_diameter)
        if not isinstance(name, str):
            refuse("Rod.name", name, "must be a string")
        self.name = name
        try:
            self.batch_shape: tuple[int, ...] = np.broadcast_shapes(
                *(section.batch_shape for section in self.sections),
                *(line.batch_shape for line in self.lines),
                *(np.shape(size) for size in (self.outer_diameter, self.inner_diameter) if size is not None),
            )
        except ValueError:
            others = " and lines" * bool(lines) + " and diameters" * isinstance(self.outer_diameter, np.ndarray)
            raise ValueError(f"the batch axes of a rod's sections{others} do not broadcast") from None
        plausibility.of_rod(self, self._material)

    @classmethod
    @hinted(_OF_MATERIAL)
    def tube(
        cls,
        *,
        length: Numbers,
        outer_diameter: Numbers,
        inner_diameter: Numbers = 0.0,
        young_modulus: Numbers,
        shear_modulus: Numbers | None = None,
        poisson_ratio: float | None = None,
        extensible: bool = False,
        precurvature: Precurvature | None = None,
        density: float = 0.0,
        magnetisation: Numbers | None = None,
        foundation: Numbers | None = None,
        members: Sequence["Member"] = (),
        lines: Sequence["Line"] = (),
        discs: float | None = None,
        loads: Sequence["Load"] = (),
        name: str = "",
    ) -> "Rod":
        """A round tube: ``EI``, ``GJ`` and mass from its cross-section, and ``EA`` and ``GA`` where it is to stretch.

        Args:
            length: Arclength [m].
            outer_diameter: [m], (...).
            inner_diameter: [m], (...).
            young_modulus: ``E`` [Pa], (...).
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
            foundation: As for ``Rod``, per length of the rod.
            members: As for ``Rod``.
            lines: As for ``Rod``.
            discs: As for ``Rod``.
            loads: As for ``Rod``.
            name: As for ``Rod``.

        Raises:
            ValueError: If a value is out of range, or the inner diameter is not smaller than the outer.
            TypeError: If both of ``shear_modulus`` and ``poisson_ratio`` are given.

        Warns:
            PlausibilityWarning: Of what is allowed and hardly meant, such as moduli in GPa.
        """
        outer, inner = diameters(outer_diameter, inner_diameter)
        if outer is None or inner is None:
            refuse("Rod.outer_diameter" if outer is None else "Rod.inner_diameter", None, "must be a number")
        E = positive_array("Rod.young_modulus", young_modulus)
        G = shear_modulus_of(E, shear_modulus, poisson_ratio)
        rho = nonnegative_float("Rod.density", density)
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            I, A = round_section(E, G, outer, inner)
            EI, GJ, mass = E * I, G * 2 * I, rho * A
        for field_name, given, result in (("young_modulus", young_modulus, EI), ("shear_modulus", shear_modulus, GJ)):
            if not within(result):
                refuse(f"Rod.{field_name}", given, f"must make EI and GJ from {SMALLEST:g} to {LARGEST:g} N m^2")
        stiff: dict[str, FloatArray] = {}
        if boolean("Rod.extensible", extensible):
            EA, GA = stretching(E, G, A, np.asarray(inner) / outer)
            if not (within(EA) and within(GA)):
                refuse("Rod.young_modulus", young_modulus, f"must make EA and GA from {SMALLEST:g} to {LARGEST:g} N")
            stiff = {"axial_stiffness": EA, "shear_stiffness": GA[..., None]}
        if not (mass <= LARGEST).all():
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
            **stiff,
            precurvature=precurvature,
            linear_density=mass,
            magnetisation=None if magnetisation is None else A[..., None] * magnetisation,
            outer_diameter=outer,
            inner_diameter=inner,
            foundation=foundation,
            members=members,
            lines=lines,
            discs=discs,
            loads=loads,
            name=name,
        )
        return rod

    @classmethod
    @hinted(_OF_MATERIAL)
    def wire(
        cls,
        *,
        length: Numbers,
        diameter: Numbers,
        young_modulus: Numbers,
        shear_modulus: Numbers | None = None,
        poisson_ratio: float | None = None,
        extensible: bool = False,
        precurvature: Precurvature | None = None,
        density: float = 0.0,
        magnetisation: Numbers | None = None,
        foundation: Numbers | None = None,
        members: Sequence["Member"] = (),
        lines: Sequence["Line"] = (),
        discs: float | None = None,
        loads: Sequence["Load"] = (),
        name: str = "",
    ) -> "Rod":
        """A solid round wire: ``EI``, ``GJ`` and mass from its cross-section, and ``EA`` and ``GA`` where it is to stretch.

        Args:
            length: Arclength [m].
            diameter: [m], (...).
            young_modulus: ``E`` [Pa], (...).
            shear_modulus: ``G`` [Pa].
            poisson_ratio: Instead, ``nu = E/(2G) - 1``.
            extensible: As for ``Rod.tube``; here ``k = 6 (1 + nu) / (7 + 6 nu)``.
            precurvature: As for ``Rod``.
            density: Mass per volume [kg/m^3].
            magnetisation: As for ``Rod.tube``, per volume [A/m].
            foundation: As for ``Rod``, per length of the rod.
            members: As for ``Rod``.
            lines: As for ``Rod``.
            discs: As for ``Rod``.
            loads: As for ``Rod``.
            name: As for ``Rod``.

        Raises:
            ValueError: If a value is out of range.
            TypeError: If both of ``shear_modulus`` and ``poisson_ratio`` are given.

        Warns:
            PlausibilityWarning: Of what is allowed and hardly meant, such as a diameter in mm.
        """
        return cls.tube(
            length=length,
            outer_diameter=diameter_of("Rod.diameter", diameter),
            young_modulus=young_modulus,
            shear_modulus=shear_modulus,
            poisson_ratio=poisson_ratio,
            extensible=extensible,
            precurvature=precurvature,
            density=density,
            magnetisation=magnetisation,
            foundation=foundation,
            members=members,
            lines=lines,
            discs=discs,
            loads=loads,
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
        from multirod.results import html

        return html.rod(self)

    def __repr__(self) -> str:
        label = f"{self.name!r}, " if self.name else ""
        batch = f"batch {self.batch_shape}"
        size = batch if self.length.ndim else f"{float(self.length):g} m" + f", {batch}" * bool(self.batch_shape)
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


def _loads(given: object) -> "tuple[Load, ...]":
    if isinstance(given, (list, tuple)) and not given:
        return ()
    from multirod.models.backbone.kernels.loads.load import Load

    if not isinstance(given, (list, tuple)) or not all(isinstance(load, Load) for load in given):
        refuse("Rod.loads", given, "must be a list of Load")
    kinds = [type(load).__name__ for load in given]
    if len(set(kinds)) < len(kinds):
        refuse("Rod.loads", kinds, "must be one of each kind")
    return tuple(given)


def _lines(given: object, rod: Rod) -> "tuple[Line, ...]":
    if isinstance(given, (list, tuple)) and not given:
        return ()
    from multirod.models.backbone.members.line_kinds import refuse_beside_friction, refuse_redundant
    from multirod.models.backbone.members.lines import Line

    if not isinstance(given, (list, tuple)) or not all(isinstance(line, Line) for line in given):
        refuse("Rod.lines", given, "must be a list of lines, such as Tendon")
    names = [line.name for line in given if line.name]
    for name in names:
        if names.count(name) > 1:
            refuse("Rod.lines", names, f"must have names of their own, and {name!r} is there twice")
    refuse_redundant(given, any(np.isfinite(section.axial_stiffness).any() for section in rod.sections))
    refuse_beside_friction(given, rod.members)
    return tuple(line.on(rod.sections, rod.discs or 0.0) for line in given)
