# mypy: ignore-errors
"""What the kernels of a network read and write, and where it stands. Numbers in parentheses are those of ``docs/networks.md``."""

import warp as wp

from multirod.kernels.problem_arrays import ProblemArrays
from multirod.models.backbone.kernels.layout.arguments import RodTable, TipWrench

POSE = 6  # unknowns of a body
TURNING = 3  # directions in which the base of a rod may turn
ALONG_VECTORS = 4  # inputs that act along rods; the third of them is gravity
ROD_VECTORS = 2  # the first of them, that are given for single rods too
# rows of an element after those of its variables
TIP_TURN_AT = 0  # (5) how the tip turns and the force on it changes, in the axes of the base
TIP_FORCE_AT = 3
TENSION_AT = 6  # (22) at the tip, then at the base
TIP_POSE_AT = 8  # of a rod that is the end effector: position, then rotation vector
MORE = 14
CARRIED_AT = 0  # of values, after those of the rows: what acts along the rod, in the world
MORE_VALUES = 3


@wp.struct
class Networks:
    """Whole networks: the first axis is the instance; a rod's index is ``instance * rod_count + rod``."""

    rod_count: int
    body_count: int
    given_bodies: int  # the first of them, on which inputs act; the others are between segments
    unknown_count: int
    direction_count: int
    first_pose: int
    own: int  # variables of an element that are its rod's own
    size: int  # all of them: own, angles at base and tip, poses there, holes at tip and base if there are any
    width: int  # columns of an element: by its variables, along directions, and, with holes, by the length of its piece
    height: int  # rows of an element
    holes: int  # whether rods slide through any
    effector: int  # number of the body that is the end effector, after the ground; 0 where it is a rod
    effector_rod: int  # -1 where it is a body
    effector_position: wp.vec3d  # of the end effector in the frame of the body
    effector_rotation: wp.mat33d
    problem: ProblemArrays  # but for Gamma
    numbers: wp.array2d[wp.float64]  # those that are kept of it
    # where inputs begin
    rotation_at: int
    translation_at: int
    force_at: int  # LOADED, of each load place
    moment_at: int
    follower_force_at: int  # FOLLOWING, likewise
    follower_moment_at: int
    along_at: int
    rod_at: int  # ON_RODS, of each rod as given
    rods_given: int
    fixed_at: int  # how bodies that are held are moved, then how they are turned
    fixed_count: int
    moved: wp.array[int]  # (direction,): along and about which axis the poses of joints at bases, then tips change; -1 of others
    # rods; arrays with two ends say of bases, then of tips
    holder: wp.array2d[int]  # (end, rod): 0 what does not give way, from 1 on a body, -1 nothing
    frame: wp.array2d[int]  # (end, rod): the same, but of bodies that are held where these stand, after the others
    attachment_position: wp.array3d[wp.vec3d]  # (instance, end, rod), frame of what holds it
    attachment_rotation: wp.array3d[wp.mat33d]
    count: wp.array2d[int]  # (end, rod): coordinates of the joint
    inner: wp.array2d[wp.mat33d]  # (2) A_1
    outer: wp.array2d[wp.mat33d]  # A_2
    slide: wp.array2d[wp.mat33d]  # (36) T
    spring: wp.array2d[wp.vec3d]
    rest: wp.array2d[wp.vec3d]
    driven: wp.array3d[int]  # (end, rod, coordinate): which input it is, -1 of an unknown
    pushed: wp.array3d[int]  # (40) (end, rod, coordinate): which input acts along it, -1 of none
    unit: wp.array2d[wp.vec3d]  # (end, rod): of its coordinates
    variable: wp.array2d[int]  # (rod, variable): which unknown, -1 of what there is not
    load_place: wp.array[int]  # (rod,): among what forces act on, of a rod whose tip is free
    length: wp.array2d[wp.float64]  # (instance, rods and bodies): scales
    stiffness: wp.array2d[wp.float64]
    # (20) of pieces
    owner: wp.array[int]  # (rod,): whose rotation and translation it has, of several tubes the first
    whole: wp.array[int]  # (rod,): of which of those given it is a piece
    share: wp.array[wp.float64]
    pieces: wp.array[int]
    shared: wp.array[int]  # whether its base is the hole at the tip of the piece below
    hole_spring: wp.array[wp.float64]  # (37) (rod,): of the hole at the tip of a piece
    push_unit: wp.array3d[wp.float64]  # (instance, end, rod): tips come first
    hole_rest: wp.array[wp.float64]
    below: wp.array[wp.float64]  # share of its rod below that hole
    softness: wp.array3d[wp.float64]  # (instance, rod, 6): inverse stiffnesses, of bending and torsion, then shear and stretching
    at_rest: wp.array2d[wp.vec3d]  # (instance, rod): precurvature
    # bodies
    reference_position: wp.array2d[wp.vec3d]  # (instance, body): where unknown poses are zero
    reference_rotation: wp.array2d[wp.mat33d]
    mass: wp.array[wp.float64]
    mass_centre: wp.array[wp.vec3d]
    frame_count: int  # frames of bodies, on which loads may act
    first_frame: int  # among load places
    frame_body: wp.array[int]  # (frame,): whose
    frame_position: wp.array[wp.vec3d]  # in its frame
    frame_rotation: wp.array[wp.mat33d]
    ground_rotation: wp.array[wp.mat33d]
    fixed_position: wp.array2d[wp.vec3d]  # (instance, body that is held): before it is moved
    fixed_rotation: wp.array2d[wp.mat33d]
    pulled_out: wp.array[int]  # (instance,): whether a rod was pulled out of a hole since this was 0
    # of the path from the network taken apart
    opening: wp.array2d[wp.float64]
    soft: wp.array[wp.float64]
    shift: wp.array2d[wp.vec3d]  # (instance, rod), (29) of where tips are held, in the frames of the bodies [m]
    loading: wp.array[int]
    # where bodies are, after the ground, then those that are held, and what acts on them
    body_position: wp.array2d[wp.vec3d]
    body_rotation: wp.array2d[wp.mat33d]
    body_turns: wp.array2d[wp.mat33d]  # rotation vectors by the unknowns of rotation, in the world
    load: wp.array2d[wp.float64]  # (instance, 6 bodies), as rows of (11)
    load_turns: wp.array4d[wp.float64]  # (instance, body, 6, 3): by the unknowns of rotation
    load_directions: wp.array3d[wp.float64]
    # what each rod says
    value: wp.array3d[wp.float64]  # (instance, rod, row)
    element: wp.array4d[wp.float64]  # (instance, rod, row, column)
    tip_position: wp.array2d[wp.vec3d]  # in the world
    tip_rotation: wp.array2d[wp.mat33d]
    rod_fault: wp.array2d[int]
    rod_steps: wp.array2d[int]
    # what stands where: sums of rows (unknown), and of numbers of elements
    row_start: wp.array[int]
    row_rod: wp.array[int]
    row_row: wp.array[int]
    number_place: wp.array[int]
    number_start: wp.array[int]
    number_at: wp.array[int]  # among the numbers of all elements of an instance
    turn_place: wp.array3d[int]  # (body, 6, 3): where its balance stands by how it turns


@wp.struct
class RodGroup:
    """Rods of one build, a launch of one backbone kernel: the index is ``instance * count + place``."""

    count: int
    rods: int  # concentric rods of each
    transmission: int  # whether they go on behind their plate
    unknown_count: int
    direction_count: int
    drive_count: int  # lines of each that are driven
    drives_at: int  # where what drives them begins in its inputs
    drive: wp.array2d[int]  # (place, line): where that stands in the network's
    lengths: int  # whether there are columns of the lengths of lines
    length_columns: wp.array3d[wp.float64]
    angle_count: int  # tubes of each that turn against the frame
    angle_columns: wp.array3d[wp.float64]  # below the pose's, how these do
    angles_at: int  # rows of an element
    table: RodTable
    turns: int  # whether the first directions are turns of the base
    slides: int  # whether the last is the length
    along_at: int
    rod: wp.array[int]  # (place,): which of its network
    first_force: int  # of the unknowns
    moment_by: wp.array3d[wp.float64]  # (rod of all instances, 3, unknown): moment at the base
    moment_rest: wp.array[wp.vec3d]  # less this
    force_unit: wp.array[wp.float64]
    problem: ProblemArrays
    wrench: TipWrench
