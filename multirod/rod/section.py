"""Stretches of a rod: stiffnesses and shape at rest, checked."""

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from multirod import profile
from multirod.naming import Asked, hinted, meant
from multirod.types import AlongRod, Numbers
from multirod.validation import (
    Described,
    FloatArray,
    array,
    positive_array,
    refuse,
)

SHORTEST_SECTION = 1e-300  # m: as good as none


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


if not TYPE_CHECKING:  # which knows what it is given
    _named = hinted("all is named, Section(length=, bending_stiffness=, torsional_stiffness=, precurvature=)")
    Section.__init__ = _named(Section.__init__)


OF_MATERIAL = ("young_modulus", "shear_modulus", "poisson_ratio", "density")  # what stiffnesses are made of
NAMES = tuple(item.name for item in fields(Section) if not item.name.startswith("_"))


class OfSections(Asked):
    """What has numbers by section, and says so where it is asked for one of them itself."""

    sections: tuple[Section, ...]

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

    @classmethod
    def _hint(cls, name: str) -> str:
        if name in NAMES:
            return f": its sections have, rod.sections[0].{name}"
        if name in OF_MATERIAL:
            made = "linear_density" if name == "density" else "bending_stiffness"
            return f": it keeps what follows from it, such as rod.sections[0].{made}"
        if name == "diameter":
            return "; did you mean 'outer_diameter'?"
        return "" if name.startswith("_") else meant(name, NAMES)


def by_section(properties: dict[str, Any]) -> tuple[Section, ...]:
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
        sections.append(by_section({**properties, "length": length, "precurvature": curvature})[0])
    summed = np.asarray(sum(section.length for section in sections))
    if np.any(np.abs(summed - total) > 1e-9 * total):
        refuse("Rod.precurvature", properties["precurvature"], f"section lengths must add up to length = {total.tolist()}")
    return tuple(sections)
