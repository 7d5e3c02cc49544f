"""Numbers that are allowed and hardly meant: in other units, exchanged, of another quantity; ``docs/mistakes.md``."""

from multirod.plausibility.inputs import of_inputs
from multirod.plausibility.limits import STRAIN
from multirod.plausibility.robots import (
    of_body,
    of_dt,
    of_free_tip,
    of_idle_loads,
    of_idle_rotation,
    of_leg_lines,
    of_legs,
    of_limits,
    of_measured_curvature,
    of_nested_lines,
    of_offsets,
    of_place,
    of_pose,
    of_pose_sigma,
    of_prior_sigma,
    of_rods_through_discs,
)
from multirod.plausibility.rods import Material, of_rod, of_tube_magnetisation
from multirod.plausibility.solutions import of_bases, of_strains
from multirod.plausibility.warning import PlausibilityWarning

__all__ = [
    "STRAIN",
    "Material",
    "PlausibilityWarning",
    "of_bases",
    "of_body",
    "of_dt",
    "of_free_tip",
    "of_idle_loads",
    "of_idle_rotation",
    "of_inputs",
    "of_leg_lines",
    "of_legs",
    "of_limits",
    "of_measured_curvature",
    "of_nested_lines",
    "of_offsets",
    "of_place",
    "of_pose",
    "of_pose_sigma",
    "of_prior_sigma",
    "of_rod",
    "of_rods_through_discs",
    "of_strains",
    "of_tube_magnetisation",
]
