# mypy: ignore-errors
"""One instance of a batch, as kernels hold it, and the units that follow from its rods."""

import warp as wp

from multirod.models.backbone.kernels.layout.arguments import RodTable

f64 = wp.float64


@wp.struct
class Instance:
    """One instance: its geometry, and its loads in the base frame."""

    index: int  # in the batch
    rods: int  # row of ``RodTable``
    direction: int  # row of ``Call.directions``
    base_position: wp.vec3d
    base_rotation: wp.mat33d
    to_base: wp.mat33d  # its transpose
    length: f64
    longest: int  # the rod that ends at the tip
    scale: f64  # what counts as one in positions
    tip_force: wp.vec3d
    tip_moment: wp.vec3d
    distributed_force: wp.vec3d
    distributed_moment: wp.vec3d
    gravity: wp.vec3d
    profile_factor: f64
    # what numbers in lanes are counted in: SI units, or natural ones in single precision, which ends at 1e38
    moment: f64
    force: f64
    unit: f64  # of lengths
    stiffness: f64


@wp.func
def bending_stiffness(rods: wp.ref[RodTable], case: wp.ref[Instance], i: int, m: int) -> f64:
    """The larger one of section m of rod i [N m^2]."""
    return wp.max(rods.material[case.rods, i, m, 0], rods.material[case.rods, i, m, 1])


@wp.func
def section_unit(rods: wp.ref[RodTable], case: wp.ref[Instance], i: int, m: int) -> wp.vec3d:
    """(10), (11) Curvature per moment there; where torsion is stiffer than bending, the bending stiffness scales it."""
    GJ = wp.min(rods.material[case.rods, i, m, 2], bending_stiffness(rods, case, i, m))
    EI_x = rods.material[case.rods, i, m, 0]
    return wp.vec3d(f64(1.0) / EI_x, f64(1.0) / rods.material[case.rods, i, m, 1], f64(1.0) / GJ)
