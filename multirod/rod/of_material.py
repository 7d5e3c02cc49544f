"""Rods by their cross-sections and moduli."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from multirod import plausibility
from multirod.rod.cross_section import CrossSection, stiffnesses
from multirod.types import Numbers
from multirod.validation import array, boolean

if TYPE_CHECKING:
    from multirod.rod.rod import Rod


def of_material(
    kind: "type[Rod]",
    material: plausibility.Material,
    section: Callable[[], CrossSection],
    *,
    extensible: object,
    given: Mapping[str, object],
    magnetisation: Numbers | None,
    **options: Any,  # noqa: ANN401  (of ``Rod``, which checks them)
) -> "Rod":
    """A rod of a cross-section; ``given`` is how its material was, for errors; other arguments are the rod's."""
    found, area = stiffnesses(material, section, boolean("Rod.extensible", extensible), given)
    stiff: dict[str, Any] = dict(found)
    if found["bending_stiffness"].ndim == 1:
        stiff["bending_stiffness"] = tuple(found["bending_stiffness"].tolist())  # an array might be meant as a batch
    if magnetisation is not None:
        magnetisation = array("Rod.magnetisation", magnetisation, (3,))
        plausibility.of_tube_magnetisation(magnetisation)
        magnetisation = area[..., None] * magnetisation
    rod = kind.__new__(kind)
    rod._material = material
    # which says what is not plausible of moduli by their own names
    rod.__init__(**stiff, magnetisation=magnetisation, **options)  # type: ignore[misc]
    return rod
