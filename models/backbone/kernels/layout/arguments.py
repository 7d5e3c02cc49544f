# mypy: ignore-errors
"""Arguments of the kernels: the rods, the arrays of a launch, and where its lanes' numbers stand."""

import warp as wp

from multirod.kernels.problem_arrays import ProblemArrays


@wp.struct
class RodTable:
    """Rods of a backbone; the first axis is the batch or has length 1."""

    stride: int  # 1 if each instance has its own rods, else 0
    end: wp.array3d[wp.float64]  # arclength of section ends from the rod's base [m], (batch, rod, section)
    material: wp.array4d[wp.float64]  # (batch, rod, section, MATERIAL_SIZE and members' parameters and functions)
    precurvature: wp.array4d[wp.float64]  # (batch, rod, section, 3 (degree + 1)), in the section's coordinate -1 to 1
    length_scale: wp.array[wp.float64]  # (batch,) [m]
    base_stride: int
    base_position: wp.array[wp.vec3d]  # (batch,)
    base_rotation: wp.array[wp.mat33d]  # (batch,)
    profile_end: wp.array[wp.float64]  # arclength of the ends of the pieces of load profiles [m], (piece,)
    profile: wp.array2d[wp.float64]  # force and moment coefficients, (piece, 6 (degree + 1))


@wp.struct
class TipWrench:
    """What rods carry at a tip that is held, in the world; the first axis is the batch."""

    values: wp.array2d[wp.float64]  # (batch, 6): internal force, then moment
    columns: wp.array3d[wp.float64]  # (batch, 6, unknown + direction)


@wp.struct
class Instance:
    """One instance: its geometry, and its loads in the base frame."""

    index: int  # in the batch
    rods: int  # row of ``RodTable``
    direction: int  # row of ``ProblemArrays.directions``
    base_position: wp.vec3d
    base_rotation: wp.mat33d
    to_base: wp.mat33d  # its transpose
    length: wp.float64
    longest: int  # the rod that ends at the tip
    scale: wp.float64  # what counts as one in positions
    tip_force: wp.vec3d
    tip_moment: wp.vec3d
    distributed_force: wp.vec3d
    distributed_moment: wp.vec3d
    gravity: wp.vec3d
    profile_factor: wp.float64
    # what numbers in lanes are counted in: SI units, or natural ones in single precision, which ends at 1e38
    moment: wp.float64
    force: wp.float64
    unit: wp.float64  # of lengths
    stiffness: wp.float64


@wp.struct
class Call:
    """What one launch reads and writes; the first axis is the batch."""

    # of the problem, or in its place; of several rods ``pose_columns`` have rows below the pose's, how they turn, and a column
    # more, by how much
    problem: ProblemArrays
    wrench: TipWrench
    direction_stride: int
    steps: wp.float64
    step_multiple: wp.float64  # what the steps of a stretch are a multiple of
    rtol: wp.float64
    atol: wp.float64
    step_limit: int
    node_count: int
    node_rod: int  # the rod that the nodes describe and along which they are spaced; the number of rods for all together
    # how instances and their columns are dealt out to lanes
    unknown_columns: int  # columns by unknowns: all of them, or none
    direction_columns: int
    parts: int  # lanes that share the columns of an instance
    part_columns: int  # columns of a lane
    chunk: int  # lanes' jobs, an instance's part each, of a thread
    lane: wp.array2d[wp.float64]  # (lane, LANE_SIZE): where each stands
    carried: wp.array[Instance]  # (lane,): of which instance each has a job
    # outputs
    node_arclength: wp.array2d[wp.float64]  # (batch, node)
    node_position: wp.array2d[wp.vec3d]
    node_rotation: wp.array2d[wp.mat33d]
    node_curvature: wp.array2d[wp.vec3d]
    node_moment: wp.array2d[wp.vec3d]
    node_force: wp.array2d[wp.vec3d]
    node_total_moment: wp.array2d[wp.vec3d]  # with members
    node_total_force: wp.array2d[wp.vec3d]
    node_left: wp.array3d[wp.float64]  # (batch, node, drive): the part of it that friction leaves
    energy: wp.array[wp.float64]
    work: wp.array[wp.float64]  # of the dead forces, from all of the rod at its base, and of what drives members
    line_length: wp.array2d[wp.float64]  # (batch, drive) [m]
    line_length_columns: wp.array3d[wp.float64]  # (batch, drive, unknown + direction)
    # at every node of the grid but the base, in its order; rows past the last are left as they are
    column_arclength: wp.array2d[wp.float64]  # (batch, grid node)
    node_columns: wp.array4d[wp.float64]  # (batch, grid node, n + 2, unknown)
    tip_columns: wp.array3d[wp.float64]  # (batch, n + 2, unknown)


# where a lane stands, in double precision whatever its numbers are: of ``Call.lane``
JOB = 0  # -1: none
START = 1  # arclength of the node where its stretch begins
END = 2  # where it stops next: where its stretch ends, or at an output node on the way there
START_MOVER = 3  # the rod with which this node moves along the backbone, -1 if it stays
END_MOVER = 4
OUTPUT = 5  # output nodes passed
PASSED = 6  # nodes passed
FORCE = 7  # n where the stretch begins, base frame
FAULT = 10
STOP = 11  # arclength where the lane is done
STRETCH_END = 12
LANE_SIZE = 13
