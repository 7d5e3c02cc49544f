"""Rods: lengths, stiffnesses and precurvature, checked at construction."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from multirod import plausibility
from multirod.naming import hinted
from multirod.read_only import ReadOnly
from multirod.rod.carried import lines_of, loads_of, members_of
from multirod.rod.cross_section import (
    Diameter,
    diameter_of,
    diameters,
    moduli_of,
    rectangle,
    round_section,
)
from multirod.rod.of_material import of_material
from multirod.rod.section import OfSections, Section, by_section
from multirod.types import Numbers, Precurvature
from multirod.validation import (
    LARGEST,
    SMALLEST,
    Described,
    FloatArray,
    frozen,
    nonnegative_float,
    positive_float,
    refuse,
)

if TYPE_CHECKING:
    from multirod.models.backbone.kernels.loads.load import Load
    from multirod.models.backbone.members.lines import Line
    from multirod.models.backbone.members.member import Member


_NAMED = (
    "all is named, Rod(length=, bending_stiffness=, torsional_stiffness=, precurvature=); Rod.wire, Rod.tube and Rod.strip take "
    "moduli"
)
_OF_MATERIAL = (
    "all is named, such as length=, outer_diameter= of a tube, diameter= of a wire, width= and thickness= of a strip, "
    "young_modulus=, precurvature="
)


class Rod(OfSections, ReadOnly):
    """One elastic rod or tube: its length, stiffnesses and shape at rest; ``Rod.tube``, ``wire``, ``strip`` make it from moduli.

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
                    raise TypeError(f"Rod needs {key} (or sections; Rod.wire, Rod.tube and Rod.strip take moduli and sizes)")
            self.sections = by_section(properties)
        if (self.length < SMALLEST).any():
            refuse(
                "Rod.length",
                Described(self.length.tolist()),
                f"must be from {SMALLEST:g} to {LARGEST:g} m, all sections together",
            )
        self.members = members_of(members)
        self.discs = None if discs is None else positive_float("Rod.discs", discs)
        self.lines = lines_of(lines, self)
        self.loads = loads_of(loads)
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
        E, G = moduli_of(young_modulus, shear_modulus, poisson_ratio)
        return of_material(
            cls,
            plausibility.Material(E, G, nonnegative_float("Rod.density", density), shear_given=poisson_ratio is None),
            lambda: round_section(E, G, outer, inner),
            extensible=extensible,
            given={"young_modulus": young_modulus, "shear_modulus": shear_modulus, "density": density},
            magnetisation=magnetisation,
            length=length,
            precurvature=precurvature,
            outer_diameter=outer,
            inner_diameter=inner,
            foundation=foundation,
            members=members,
            lines=lines,
            discs=discs,
            loads=loads,
            name=name,
        )

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
            members, lines, discs, loads, name: As for ``Rod``.

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

    @classmethod
    @hinted(_OF_MATERIAL)
    def strip(
        cls,
        *,
        length: Numbers,
        width: Numbers,
        thickness: Numbers,
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
        """A solid strip of rectangular section, ``width`` along its x axis and ``thickness`` along y: it bends easily about x.

        ``EI_x = E w t^3/12``, ``EI_y = E t w^3/12``, and ``GJ`` by Saint-Venant's series (``docs/model.md``, 5b, 5c). It has no
        outer diameter: its strain is not told, and it is drawn round.

        Args:
            length: Arclength [m].
            width: Of the section, along x [m], (...).
            thickness: Of the section, along y [m], (...); either may be the larger one.
            young_modulus: ``E`` [Pa], (...).
            shear_modulus: ``G`` [Pa].
            poisson_ratio: Instead, ``nu = E/(2G) - 1``.
            extensible: As for ``Rod.tube``; here ``k = 10 (1 + nu) / (12 + 11 nu)``.
            precurvature: As for ``Rod``.
            density: Mass per volume [kg/m^3].
            magnetisation: As for ``Rod.tube``, per volume [A/m].
            foundation: As for ``Rod``, per length of the rod.
            members, lines, discs, loads, name: As for ``Rod``.

        Raises:
            ValueError: If a value is out of range.
            TypeError: If both of ``shear_modulus`` and ``poisson_ratio`` are given.

        Warns:
            PlausibilityWarning: Of what is allowed and hardly meant, such as a width in mm.
        """
        wide, thick = diameter_of("Rod.width", width), diameter_of("Rod.thickness", thickness)
        E, G = moduli_of(young_modulus, shear_modulus, poisson_ratio)
        rho, shear_given = nonnegative_float("Rod.density", density), poisson_ratio is None
        return of_material(
            cls,
            plausibility.Material(E, G, rho, shear_given=shear_given, sides=(wide, thick)),
            lambda: rectangle(E, G, wide, thick),
            extensible=extensible,
            given={"young_modulus": young_modulus, "shear_modulus": shear_modulus, "density": density},
            magnetisation=magnetisation,
            length=length,
            precurvature=precurvature,
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
