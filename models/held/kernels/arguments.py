# mypy: ignore-errors
"""What the kernels of held rods read and write. Numbers in parentheses are those of ``docs/held.md``."""

import warp as wp

from multirod.kernels.problem_arrays import ProblemArrays
from multirod.models.backbone.kernels.layout.arguments import TipWrench

POSE = 6  # residuals of the end's joint
ON_AXIS = 1e-9  # what counts as on an axis, in lengths, and along it
ACROSS = 1e-6  # turn of the end across the axis of the base from which on it says where the rod bends [rad]
SOFT = 0.025  # of forces and moments in EI/L^2 and EI/L, by which a neutral turn is held: then it is as stiff as others
IN_BALLS, ROUND_IN_BALLS, SPINS = 1, 2, 3  # (28) rods between two balls, such ones that are round, and these under loads across
BALL_AND_CLAMP = 4  # round ones from a ball to a clamp
BESIDE, LED_ON = 1, 2  # (32) what is held against its turn until the full load, and what is there too
ALONG = ("distributed_force", "distributed_moment", "gravity", "magnetic_field")  # as they stand in a row of a rod's inputs
FORCE, TORQUE, WEIGHT, FIELD = (3 * k for k in range(len(ALONG)))  # where, after ``along``


@wp.struct
class Held:
    """Rods that are held at both ends; the first axis is the instance."""

    unknown_count: int
    rod_unknowns: int  # the first of them
    turns: int  # the last of them: angles of the base in its joint
    direction_count: int
    rod_inputs: int  # of a row, the scale of load profiles left out: they stand first in a row of this
    along: int  # where ALONG begin
    tip_loads: int  # tip_force, then tip_moment
    pose: int  # end_position, then end_rotation
    translation: int
    problem: ProblemArrays
    # geometry
    base_frame: wp.array[wp.mat33d]  # of the base's holder
    end_position: wp.array[wp.vec3d]  # of the end's holder where its inputs are zero
    end_frame: wp.array[wp.mat33d]
    rest_position: wp.array[wp.vec3d]  # of the end of the rod at rest
    rest_turn: wp.array[wp.vec3d]  # (2) rotation vector from there to end_frame
    swing: wp.array[wp.vec3d]  # (2b) rotation vector from the line between base and end at rest to that at the full load
    length: wp.array[wp.float64]  # scales
    stiffness: wp.array[wp.float64]
    soft: wp.array[wp.float64]  # the least bending stiffness along the rod
    moment_unit: wp.array[wp.vec3d]  # curvature per base moment
    base_curvature: wp.array[wp.vec3d]  # where that is zero
    joint: int
    axis: wp.vec3d  # of a revolute joint, in the frame of the end's holder
    slides: int
    guide: wp.mat33d  # two directions across the one in which the end slides, then that one, in its holder's frame
    base_axes: wp.array[wp.vec3d]  # (turns,): of the base's joint, in its holder's frame
    opening: wp.array2d[wp.float64]  # residual of the rod at rest where the path begins
    direct: wp.array[int]  # whether the end's holder is where it is to be all along the path
    alike: wp.array[int]  # whether the rod is the same about its axis, whatever holds its end and acts along it
    neutral: wp.array[int]  # whether a turn about the base's axis costs nothing
    clamped: int  # whether clamps tell of that turn, and (11) need not hold it
    balls: wp.array[int]  # (28) which turns of a rod whose base is in a ball cost nothing where no load acts
    least: wp.array2d[wp.float64]  # of the moment on the tip, then of ALONG: as much or less is no load (instance, 5)
    leading: wp.array[wp.float64]  # how the turn that loads are to tell is held where the path begins
    drawn: wp.array[wp.vec3d]  # (31), (32) where a rod is drawn on its way, in the frame of its base
    beside: wp.array[int]  # (32) whether its end is to be held a little beside the axis of its base; 2 where it is led on
    ways: wp.array2d[wp.vec3d]  # along which the rotation vector of its base is held: as the rod spins, and as it turns
    held_at: wp.array2d[wp.float64]  # where [1/m]
    rod: ProblemArrays  # as a backbone whose tip is held
    wrench: TipWrench
    base_position: wp.array[wp.vec3d]
    base_rotation: wp.array[wp.mat33d]  # the base's holder, turned in its joint


@wp.struct
class Ends:
    """Tips of rods that are known by their segments, in the world; the first axis is what ``instance`` lists."""

    instance: wp.array[int]
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    wrench: wp.array2d[wp.float64]
    # how position, rotation, force, moment and, in its own frame, the moment at the base vary (.., 15, column); columns along
    # directions are the last
    columns: wp.array3d[wp.float64]
    # outputs
    residual: wp.array2d[wp.float64]
    residual_columns: wp.array3d[wp.float64]
