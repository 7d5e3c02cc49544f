# mypy: ignore-errors
"""What the kernels of a backbone share: the arrays of a launch, how they are packed, and the types of one scene.

Numbers in parentheses are those of ``docs/model.md``.
"""

import warp as wp

from multirod.models.features import Features

FAULT_NONE = 0
FAULT_NONFINITE = 1
FAULT_STEPS = 2

# vectors and matrix of a scalar type
VECTORS = {wp.float64: (wp.vec3d, wp.vec4d, wp.mat33d), wp.float32: (wp.vec3f, wp.vec4f, wp.mat33f)}

MATERIAL_SIZE = 10  # EI_x, EI_y, GJ, their inverses, 1/GA_x, 1/GA_y, 1/EA, mass per length
INPUT_VECTORS = (
    "tip_force",
    "tip_moment",
    "follower_force",
    "follower_moment",
    "distributed_force",
    "distributed_moment",
    "gravity",
    "tip_curvature",
)


def input_size(rod_count: int) -> int:
    """Length of the packed inputs: rotations, translations, the vectors of ``INPUT_VECTORS``, scale of the load profiles."""
    return 2 * rod_count + 3 * len(INPUT_VECTORS) + 1


@wp.struct
class RodTable:
    """Rods of a backbone; the first axis is the batch or has length 1."""

    stride: int  # 1 if each instance has its own rods, else 0
    end: wp.array3d[wp.float64]  # arclength of section ends from the rod's base [m], (batch, rod, section)
    material: wp.array4d[wp.float64]  # (batch, rod, section, MATERIAL_SIZE)
    precurvature: wp.array4d[wp.float64]  # (batch, rod, section, 3 (degree + 1)), in the section's coordinate -1 to 1
    length_scale: wp.array[wp.float64]  # (batch,) [m]
    base_stride: int
    base_position: wp.array[wp.vec3d]  # (batch,)
    base_rotation: wp.array[wp.mat33d]  # (batch,)
    profile_end: wp.array[wp.float64]  # arclength of the ends of the pieces of load profiles [m], (piece,)
    profile: wp.array2d[wp.float64]  # force and moment coefficients, (piece, 6 (degree + 1))


@wp.struct
class Call:
    """What one launch reads and writes; the first axis is the batch."""

    order: wp.array[int]  # instances that a launch passes over
    active: wp.array[int]  # instances with 0 are left untouched
    unknowns: wp.array2d[wp.float64]
    inputs: wp.array2d[wp.float64]
    load_factor: wp.array[wp.float64]  # multiplies every load
    directions: wp.array3d[wp.float64]  # (batch or 1, direction, input)
    direction_stride: int
    steps: wp.float64
    step_multiple: wp.float64  # what the steps of a stretch are a multiple of
    rtol: wp.float64
    atol: wp.float64
    step_limit: int
    node_count: int
    node_rod: int  # the rod that the nodes describe and along which they are spaced; the number of rods for all together
    # outputs
    fault: wp.array[int]
    step_count: wp.array[int]
    residual: wp.array2d[wp.float64]  # (batch, unknown) [1/m]
    gamma: wp.array3d[wp.float64]  # (batch, unknown, unknown)
    residual_directions: wp.array3d[wp.float64]  # (batch, unknown, direction)
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    pose_columns: wp.array3d[wp.float64]  # (batch, 6, unknown + direction), world frame
    node_arclength: wp.array2d[wp.float64]  # (batch, node)
    node_position: wp.array2d[wp.vec3d]
    node_rotation: wp.array2d[wp.mat33d]
    node_curvature: wp.array2d[wp.vec3d]
    node_moment: wp.array2d[wp.vec3d]
    node_force: wp.array2d[wp.vec3d]
    energy: wp.array[wp.float64]
    work: wp.array[wp.float64]  # of the dead forces, from all of the rod at its base
    # of a held tip
    tip_wrench: wp.array2d[wp.float64]  # (batch, 6): internal force, then moment, world frame
    wrench_columns: wp.array3d[wp.float64]  # (batch, 6, unknown + direction)
    # at every node of the grid but the base, in its order; rows past the last are left as they are
    column_arclength: wp.array2d[wp.float64]  # (batch, grid node)
    node_columns: wp.array4d[wp.float64]  # (batch, grid node, n + 2, unknown)
    tip_columns: wp.array3d[wp.float64]  # (batch, n + 2, unknown)


class Layout:
    """How the state of a backbone with certain features is packed, and the types that follow, all of the scalar type ``real``.

    The state is ``[M], [N], theta_i, [tau_i] (i >= 2), columns, [q], [p], [energy, work]``; a column, the derivative of the
    state by one unknown or direction, is ``[dM], [dN], dtheta_i, [dtau_i], [dq], [dp]``. What is in brackets is there when a feature
    needs it. Names that end in ``_AT`` are offsets. The unknowns' columns come first, then those of the directions.
    """

    def __init__(self, features: Features, real=wp.float64) -> None:
        self.real = real
        self.vec3, self.vec4, self.mat33 = VECTORS[real]
        self.n = n = features.rod_count
        self.UNKNOWNS = features.unknown_count
        self.NX = features.unknown_count if features.sensitivities else 0  # columns by unknowns
        self.ND = features.directions  # columns by directions
        self.C = columns = self.NX + self.ND

        self.MOMENT = features.moment
        self.TORQUES = features.torque_count
        self.FRAME = features.frame
        self.COLUMN_FRAME = features.column_has_frame
        self.FORCE = features.force
        self.FORCE_STATE = features.force_is_state
        self.SPREAD_FORCE = features.distributed_force or features.profile_degree >= 0
        self.SPREAD_MOMENT = features.distributed_moment or features.profile_degree >= 0
        self.PROFILE = features.profile_degree >= 0
        self.PROFILE_TERMS = max(features.profile_degree, 0) + 1
        self.CURVATURE_TERMS = features.precurvature_degree + 1
        self.POSE = features.pose or features.nodes or features.pose_sensitivities
        self.POSE_COLUMNS = features.pose_sensitivities

        self.N_AT = 3 if self.MOMENT else 0
        self.THETA_AT = self.N_AT + (3 if self.FORCE_STATE else 0)  # of rod 2
        self.TAU_AT = self.THETA_AT + n - 1  # of rod 2
        self.STATICS = self.TAU_AT + self.TORQUES  # size of what (4), (3b) and (8) govern; there the columns begin
        self.COLUMN_Q_AT = self.STATICS
        self.COLUMN_P_AT = self.COLUMN_Q_AT + (4 if self.COLUMN_FRAME else 0)
        self.COLUMN_SIZE = self.COLUMN_P_AT + (3 if self.POSE_COLUMNS else 0)
        self.Q_AT = self.STATICS + self.COLUMN_SIZE * columns
        self.P_AT = self.Q_AT + (4 if self.FRAME else 0)
        self.ENERGY_AT = self.P_AT + (3 if self.POSE else 0)
        self.WORK_AT = self.ENERGY_AT + 1
        size = self.ENERGY_AT + (2 if features.nodes else 0)
        size += -size % 8  # whole vector registers: measured 15 % faster

        self.State = wp.types.vector(length=size, dtype=real)
        self.Column = wp.types.vector(length=self.COLUMN_SIZE, dtype=real)
        self.PerRod = wp.types.vector(length=n, dtype=real)
        self.PerDirection = wp.types.vector(length=max(self.ND, 1), dtype=real)
        self.RodVectors = wp.types.matrix(shape=(n, 3), dtype=real)
        self.ColumnVectors = wp.types.matrix(shape=(max(columns, 1), 3), dtype=real)
        self.DirectionVectors = wp.types.matrix(shape=(max(self.ND, 1), 3), dtype=real)
        self.DirectionRods = wp.types.matrix(shape=(max(self.ND, 1), n), dtype=real)
        self.Stretch = self._make_stretch()
        self.Instance = self._make_instance()
        self.Node = self._make_node()

    def _make_stretch(self):
        real, vec3 = self.real, self.vec3
        Material = wp.types.matrix(shape=(self.n, MATERIAL_SIZE), dtype=real)
        Precurvature = wp.types.matrix(shape=(self.n, 3 * self.CURVATURE_TERMS), dtype=real)
        Profile = wp.types.matrix(shape=(6, self.PROFILE_TERMS), dtype=real)
        PerRod, PerDirection, DirectionRods = self.PerRod, self.PerDirection, self.DirectionRods
        ColumnVectors, DirectionVectors = self.ColumnVectors, self.DirectionVectors

        @wp.struct
        class Stretch:
            """One stretch of backbone between two nodes: what is constant on it."""

            start: real
            length: real
            present: PerRod  # 1 if the rod reaches this far, else 0
            bending: PerRod  # of several rods: EI_x of each, zero where it has ended
            softness: real  # 1 / their sum
            torsion: PerRod  # of several rods: 1/GJ of each, zero where it has ended
            material: Material
            precurvature: Precurvature
            section_centre: PerRod
            section_slope: PerRod  # of the section's coordinate -1 to 1: 1 / half length
            force: vec3  # n at the start of the stretch
            distributed_force: vec3  # uniform part, weight included
            distributed_moment: vec3  # uniform part
            profile: Profile
            profile_centre: real
            profile_slope: real
            # variations
            force_columns: ColumnVectors  # of n at the start
            distributed_force_rate: DirectionVectors
            distributed_moment_rate: DirectionVectors
            profile_rate: PerDirection  # relative
            start_rate: PerDirection  # of the arclength of the start
            end_rate: PerDirection
            shift_rate: DirectionRods  # of the rods, along themselves

        return Stretch

    def _make_instance(self):
        real, vec3, mat33 = self.real, self.vec3, self.mat33
        PerRod, PerDirection, DirectionRods = self.PerRod, self.PerDirection, self.DirectionRods

        @wp.struct
        class Instance:
            """One instance: its geometry, and its loads in the base frame."""

            index: int  # in the batch
            rods: int  # row of ``RodTable``
            direction: int  # row of ``Call.directions``
            base_position: vec3
            base_rotation: mat33
            to_base: mat33  # its transpose
            length: real
            length_rate: PerDirection
            longest: int  # the rod that ends at the tip
            scale: real  # what counts as one in positions
            shift: PerRod  # the inputs ``translation``
            shift_rate: DirectionRods
            tip_force: vec3
            tip_moment: vec3
            distributed_force: vec3
            distributed_moment: vec3
            gravity: vec3
            profile_factor: real

        return Instance

    def _make_node(self):
        real = self.real
        Sections = wp.types.vector(length=self.n, dtype=wp.int32)
        PerDirection = self.PerDirection

        @wp.struct
        class Node:
            """A node of the grid: where the walk along the backbone stands."""

            s: real
            rate: PerDirection  # of s
            section: Sections  # of each rod, that begins here or goes on; their number where the rod has ended
            piece: int  # of the load profiles
            output: int  # output nodes passed

        return Node


class InputOffsets:
    """Where each input begins in a row of ``Call.inputs`` and ``Call.directions``; see ``input_size``."""

    def __init__(self, rod_count: int) -> None:
        self.ROTATION = 0
        self.TRANSLATION = rod_count
        for k, name in enumerate(INPUT_VECTORS):
            setattr(self, name.upper(), 2 * rod_count + 3 * k)
        self.PROFILE_FACTOR = 2 * rod_count + 3 * len(INPUT_VECTORS)
