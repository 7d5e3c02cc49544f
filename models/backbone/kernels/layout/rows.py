"""Where numbers stand in the rows that kernels read: of the rods' material, of inputs, of what a direction changes."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from multirod.models.backbone.inputs import BACKBONE_INPUTS, CALLED, TIP_CURVATURE

if TYPE_CHECKING:
    from multirod.models.backbone.kernels.loads.load import Load

# EI_x, EI_y, GJ, their inverses, 1/GA_x, 1/GA_y, 1/EA, mass per length, magnetic moment per length, stiffness of the foundation
MATERIAL_SIZE = 16
INPUT_VECTORS = tuple(spec.name for spec in (*BACKBONE_INPUTS, TIP_CURVATURE) if not spec.per_rod)


def input_size(rod_count: int, drive_count: int = 0) -> int:
    """Length of the packed inputs: rotations, translations, the vectors of ``INPUT_VECTORS``, what drives members, scale of the
    load profiles.
    """
    return 2 * rod_count + 3 * len(INPUT_VECTORS) + drive_count + 1


class InputOffsets:
    """Where each input begins in a row of ``ProblemArrays.inputs`` and ``directions``; see ``input_size``."""

    def __init__(self, rod_count: int, drive_count: int = 0) -> None:
        self.ROTATION = 0
        self.TRANSLATION = rod_count
        for k, name in enumerate(INPUT_VECTORS):
            setattr(self, name.upper(), 2 * rod_count + 3 * k)
        self.DRIVES = 2 * rod_count + 3 * len(INPUT_VECTORS)
        self.PROFILE_FACTOR = self.DRIVES + drive_count

    def of(self, name: str) -> int:
        """Where an input begins."""
        return int(getattr(self, CALLED.get(name, name).upper()))


class DesignOffsets:
    """How a direction says, after its inputs, what changes of each section of each rod: the same numbers for each, last those of
    the loads along it, by their names."""

    def __init__(self, curvature_terms: int, loads: Iterable[type["Load"]] = ()) -> None:
        self.END = 0  # arclength of its end
        self.BENDING = 1  # EI_x, EI_y
        self.SOFTNESS = 3  # of the inverse of EI_x, EI_y and GJ, relative to it
        self.SHIFT = 6  # of the law of its precurvature along the rod
        self.PRECURVATURE = 7
        self.SIZE = 7 + 3 * curvature_terms
        self.LOADS: dict[str, int] = {}
        for load in loads:
            if load.of_section:
                self.LOADS[load.of_section] = self.SIZE
                self.SIZE += 3
