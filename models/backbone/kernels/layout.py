# mypy: ignore-errors
"""How the numbers of a backbone stand: its state and columns, a stretch, a place, and the arrays of a launch.

A record is a list of ``Slot``; offsets, sizes and units follow from it. Numbers in parentheses are those of ``docs/model.md``.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import warp as wp

from multirod.models.backbone.features import Features

FAULT_NONE = 0
FAULT_NONFINITE = 1
FAULT_STEPS = 2

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


class InputOffsets:
    """Where each input begins in a row of ``Call.inputs`` and ``Call.directions``; see ``input_size``."""

    def __init__(self, rod_count: int) -> None:
        self.ROTATION = 0
        self.TRANSLATION = rod_count
        for k, name in enumerate(INPUT_VECTORS):
            setattr(self, name.upper(), 2 * rod_count + 3 * k)
        self.PROFILE_FACTOR = 2 * rod_count + 3 * len(INPUT_VECTORS)


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
    # how instances and their columns are dealt out to lanes
    unknown_columns: int  # columns by unknowns: all of them, or none
    direction_columns: int
    parts: int  # lanes that share the columns of an instance
    part_columns: int  # columns of a lane
    chunk: int  # lanes' jobs, an instance's part each, of a thread
    lane: wp.array2d[wp.float64]  # (lane, LANE_SIZE): where each stands
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


# where a lane stands, in double precision whatever its numbers are: of ``Call.lane``
JOB = 0  # -1: none
START = 1  # arclength of the node where its stretch begins
END = 2
START_MOVER = 3  # the rod with which this node moves along the backbone, -1 if it stays
END_MOVER = 4
OUTPUT = 5  # output nodes passed
PASSED = 6  # nodes passed
FORCE = 7  # n where the stretch begins, base frame
FAULT = 10
STOP = 11  # arclength where the lane is done
LANE_SIZE = 12


@dataclass(frozen=True)
class Slot:
    """One entry of a record: its name, how many numbers, and what they are counted in: "moment", "force", "length" or "1"."""

    name: str
    size: int
    unit: str = "1"


class Record:
    """Numbers that stand together: where each begins (``at``; -1 if it is not there) and how many there are (``size``)."""

    def __init__(self, slots: Iterable[Slot]) -> None:
        self.slots = [slot for slot in slots if slot.size]
        self.at: dict[str, int] = {}
        self.size = 0
        for slot in self.slots:
            self.at[slot.name] = self.size
            self.size += slot.size

    def __getitem__(self, name: str) -> int:
        return self.at.get(name, -1)

    def units(self) -> list[str]:
        """Of each number."""
        return [slot.unit for slot in self.slots for _ in range(slot.size)]


class Layout:
    """The records of a backbone with certain features. How many columns there are is known to a launch only.

    Attributes:
        state: What is integrated of the backbone itself.
        column: What is integrated of one column, the derivative of the state by an unknown or along a direction of inputs.
        given: What stands beside a column: what its direction varies of the loads and of the stretch.
        stretch: What is constant between two nodes.
        place: What columns need to know of the backbone at one place.
        steps: Where a lane stands on its stretch.
    """

    def __init__(self, features: Features) -> None:
        f = self.features = features
        self.n = n = f.rod_count
        self.UNKNOWNS = f.unknown_count
        self.MOMENT, self.TORQUES = f.moment, f.torque_count
        self.FRAME, self.COLUMN_FRAME = f.frame, f.column_has_frame
        self.FORCE, self.FORCE_STATE = f.force, f.force_is_state
        self.PROFILE = f.profile_degree >= 0
        self.SPREAD_FORCE = f.distributed_force or self.PROFILE
        self.SPREAD_MOMENT = f.distributed_moment
        self.PROFILE_TERMS = max(f.profile_degree, 0) + 1
        self.CURVATURE_TERMS = f.precurvature_degree + 1
        self.VARIED = self.CURVATURE_TERMS > 1
        self.POSE = f.pose or f.nodes or f.pose_sensitivities
        self.POSE_COLUMNS = f.pose_sensitivities
        self.NODES = f.nodes
        self.FIXED = f.fixed_moment
        self.DIRECTIONS = f.directions
        # an unknown base force, or a direction, makes n depend on it
        self.GIVEN_FORCE = f.force and not f.force_is_state and (f.directions or f.base_force_unknown)
        statics = [
            Slot("moment", 3 * self.MOMENT, "moment"),
            Slot("force", 3 * self.FORCE_STATE, "force"),
            Slot("angles", n - 1),
            Slot("torques", self.TORQUES, "moment"),
        ]
        self.state = Record(
            [
                *statics,
                Slot("frame", 4 * self.FRAME),
                Slot("position", 3 * self.POSE, "length"),
                Slot("energy", 1 * f.nodes, "moment"),
                Slot("work", 1 * f.nodes, "moment"),
            ]
        )
        self.column = Record([*statics, Slot("frame", 4 * self.COLUMN_FRAME), Slot("position", 3 * self.POSE_COLUMNS, "length")])
        directed = 1 * self.DIRECTIONS
        self.given = Record(
            [
                Slot("unit", 1),
                Slot("force", 3 * self.GIVEN_FORCE, "force"),  # dn at the start of the stretch, base frame
                Slot("distributed_force", 3 * directed, "force per length"),
                Slot("distributed_moment", 3 * directed * self.SPREAD_MOMENT, "force"),
                Slot("profile", directed),  # relative
                Slot("start", directed, "length"),  # of the arclength of the start
                Slot("growth", directed),  # (20) of the stretch, relative
                Slot("shift", n * directed, "length"),  # of the rods, along themselves
            ]
        )
        several = n > 1
        self.stretch = Record(
            [
                Slot("present", n * several),  # 1 if the rod reaches this far, else 0
                Slot("bending", n * several, "stiffness"),  # EI_x, zero where it has ended
                Slot("bending_y", n * f.anisotropic, "stiffness"),
                Slot("softness", 1 * several, "1/stiffness"),  # 1 / sum of bending
                Slot("torsion", n * several, "1/stiffness"),  # 1/GJ, zero where it has ended
                Slot("compliance", 3 * (not several), "1/stiffness"),
                Slot("shear", 3 * f.shear, "1/force"),
                Slot("precurvature", 3 * self.CURVATURE_TERMS * n, "1/length"),
                Slot("centre", n * self.VARIED, "length"),
                Slot("slope", n * self.VARIED, "1/length"),
                Slot("force", 3 * (f.force and not f.force_is_state), "force"),  # n at the start
                Slot("distributed_force", 3 * self.SPREAD_FORCE, "force per length"),
                Slot("distributed_moment", 3 * self.SPREAD_MOMENT, "force"),
                Slot("profile_force", 3 * self.PROFILE_TERMS * self.PROFILE, "force per length"),
                Slot("profile_moment", 3 * self.PROFILE_TERMS * (self.PROFILE and self.SPREAD_MOMENT), "force"),
                Slot("profile_centre", 1 * self.PROFILE, "length"),
                Slot("profile_slope", 1 * self.PROFILE, "1/length"),
                Slot("unit_moment", 1, "moment"),  # what counts as one in the errors of a step
                Slot("unit_force", 1, "force"),
                Slot("unit_length", 1, "length"),
            ]
        )
        tube = n if several else 0
        self.place = Record(
            [
                Slot("x", 1),
                Slot("frame", 5 * self.FRAME),  # and 2 / |q|^2
                Slot("moment", 3),
                Slot("force", 3),
                Slot("curvature", 3),
                Slot("extension", 3 * f.shear),  # v - e3
                Slot("world_force", 3 * self.FIXED),  # n
                Slot("tangent", 3 * self.FIXED),  # p'
                # (7), (8): b_i - K_i u, its derivative by theta at constant u, K_i as xx, xy, yy, and cos, sin of theta_i
                Slot("tube_x", tube),
                Slot("tube_y", tube),
                Slot("slope_x", tube),
                Slot("slope_y", tube),
                Slot("stiffness", 3 * n * f.anisotropic),
                Slot("flexibility", 3 * f.anisotropic),
                Slot("cosine", tube),
                Slot("sine", tube),
                Slot("own_twist", n * f.nodes, "1/length"),  # u*_i,z
                Slot("rate", self.column.size * directed),  # of what of the state stands in a column
            ]
        )
        self.steps = Record(
            [
                Slot("x", 1),  # from the start of the stretch
                Slot("length", 1),
                Slot("size", 1),  # of the next step
                Slot("left", 1),  # equal steps left of the stretch; below 1/2 it is done
                Slot("active", 1),
                Slot("count", 1),
                Slot("rejected", 1),
                Slot("longest", 1),  # first step
                Slot("controlled", 1),  # 1 if errors choose the steps, 0 if they are equal
            ]
        )

    def memory(self, stages: int) -> "Memory":
        """Where the records of a thread stand in its memory."""
        return Memory(self, stages)


class Memory:
    """Offsets of the records of one thread, in rows of lanes; the columns come last."""

    def __init__(self, layout: Layout, stages: int) -> None:
        self.STEPS = 0
        self.STRETCH = layout.steps.size
        self.STATE = self.STRETCH + layout.stretch.size
        self.PLACES = self.STATE + layout.state.size
        self.COLUMNS = self.PLACES + stages * layout.place.size
        self.COLUMN_SIZE = layout.column.size + layout.given.size

    def rows(self, columns: int) -> int:
        """Of a thread whose lanes carry so many columns each."""
        return self.COLUMNS + columns * self.COLUMN_SIZE
