"""Strains of a rod's material, from its internal moment and force."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from multirod.problem import Shape
from multirod.rod import Rod, Section
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.results.found import Found


def largest(solution: "Found", shapes: Sequence[Shape]) -> FloatArray:
    """The largest strain of the outermost fibre of each rod, ``bending + |extension|`` of ``strains``, shape (..., rod_count).

    NaN where there is no shape, or no outer diameter.

    Args:
        solution: Whose shapes these are.
        shapes: ``solution.rod(k)`` of each rod.
    """
    result = np.full((*solution.batch_shape, len(shapes)), np.nan)
    for k, (rod, shape) in enumerate(zip(solution.assembly.rods, shapes, strict=True)):
        if rod.outer_diameter is not None:
            found = strains(solution, k, shape)
            result[..., k] = (found["bending"] + np.abs(found.get("extension", 0.0))).max(axis=-1)
    return result


def bound(rods: Sequence[Rod], shapes: Sequence[Shape]) -> float:
    """What ``largest`` is of none of these rods more than; NaN where a shape is."""
    each = [0.0]
    for rod, shape in zip(rods, shapes, strict=True):
        if rod.outer_diameter is not None:
            softest = min(float(np.min(section.bending_stiffness)) for section in rod.sections)
            stretches = min(float(np.min(section.axial_stiffness)) for section in rod.sections)
            bent, pulled = (np.abs(values).max(initial=0.0) for values in (shape.moment[..., :2], shape.force[..., 2]))
            each.append(0.5 * float(np.max(rod.outer_diameter)) * np.sqrt(2) * bent / softest + pulled / stretches)
    return float(np.max(each))


def strains(solution: "Found", rod: int, shape: Shape) -> dict[str, FloatArray]:
    """Strains along one rod, each of shape (..., node_count), by name; only what its parameters tell.

    ``bending`` is that of the outermost fibre, ``r |u_xy - u*_xy|``, and ``torsion`` the shear strain at the surface,
    ``r |u_z - u*_z|``, of a rod with an outer diameter ``2 r``. ``extension`` is ``v_z - 1`` and ``shear`` is ``|v_xy|``, of a
    rod that stretches or shears.

    Args:
        solution: Of which ``shape`` is the shape of one rod.
        rod: Index of that rod.
        shape: ``solution.rod(rod)``.
    """
    own = solution.assembly.rods[rod]
    shift = np.broadcast_to(solution.inputs.translation[..., rod, None], (*solution.batch_shape, 1))
    compliance = _compliances(solution, own, np.asarray(shape.arclength) - shift)
    found = {}
    if own.outer_diameter is not None:
        radius = 0.5 * solution._parameter(np.asarray(own.outer_diameter), 0)[..., None, None]
        turned = radius * compliance[..., :3] * shape.moment
        found["bending"] = np.hypot(turned[..., 0], turned[..., 1])
        found["torsion"] = np.abs(turned[..., 2])
    stretched = compliance[..., 3:] * shape.force
    if any(np.isfinite(section.axial_stiffness).any() for section in own.sections):
        found["extension"] = stretched[..., 2]
    if any(np.isfinite(section.shear_stiffness).any() for section in own.sections):
        found["shear"] = np.hypot(stretched[..., 0], stretched[..., 1])
    return found


def _compliances(solution: "Found", rod: Rod, s: FloatArray) -> FloatArray:
    """``1/EI_x, 1/EI_y, 1/GJ, 1/GA_x, 1/GA_y, 1/EA`` at arclengths (..., node), shape (..., node, 6)."""
    result = np.broadcast_to(_compliance(solution, rod.sections[-1]), (*s.shape, 6))
    ends = np.cumsum([np.broadcast_to(section.length, rod.length.shape) for section in rod.sections], axis=0)
    for section, end in reversed(list(zip(rod.sections[:-1], ends[:-1], strict=True))):
        # the end of a section is its own, but for rounding
        last = solution._parameter(end, 0)[..., None] * (1 + 1e-12)
        result = np.where((s <= last)[..., None], _compliance(solution, section), result)
    return result


def _compliance(solution: "Found", section: Section) -> FloatArray:
    """The same of a section, shape (..., 1, 6)."""
    parts = [
        section.bending_stiffness[..., 0],
        section.bending_stiffness[..., 1],
        section.torsional_stiffness,
        section.shear_stiffness[..., 0],
        section.shear_stiffness[..., 1],
        section.axial_stiffness,
    ]
    stiffness = np.stack(np.broadcast_arrays(*parts), axis=-1)
    return np.asarray(1 / solution._parameter(stiffness, 1)[..., None, :])
