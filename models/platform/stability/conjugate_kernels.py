# mypy: ignore-errors
"""What the residuals of legs on a platform do work on. Numbers are those of ``docs/energy_descent.md``."""

import warp as wp

from multirod.kernels.own_module import own_module
from multirod.models.backbone.kernels.tips import longest_of, reaches
from multirod.models.backbone.stability.conjugate_kernels import angle_of
from multirod.models.joint_kernels import REVOLUTE, SPHERICAL, column
from multirod.models.platform.platform_kernels import POSE, Legs, Robots

f64 = wp.float64


@wp.struct
class LegPairs:
    """Of legs of one build, and of the robots that they belong to."""

    first: wp.array[int]  # (place,): the first pair of each leg
    angle_columns: wp.array3d[wp.float64]  # of the legs: pose of the tip, then how each rod turns against the frame
    end: wp.array3d[wp.float64]
    stride: int
    torques: int  # of each leg, that are residuals
    torsion: wp.array2d[wp.float64]  # (leg of all instances or 1, rod)
    # of the robots, outputs
    unit: wp.array2d[wp.float64]
    columns: wp.array3d[wp.float64]


@own_module()
def find_leg_displacements(robots: Robots, legs: Legs, pairs: LegPairs):
    """(12) The turn of a tip in a joint that lets it turn, and the angles of tubes that end before it."""
    t = legs.problem.order[wp.tid()]
    b = t // legs.count
    if robots.problem.active[b] == 0:
        return
    place = t % legs.count
    leg = legs.leg[place]
    m = legs.unknown_count
    own = t * pairs.stride
    longest = longest_of(pairs.end, own, legs.problem.inputs, t)
    to_tip = wp.transpose(legs.problem.rotation[t])
    joint = robots.joint[leg]
    axis = robots.axis[leg]
    for k in range(m + robots.leg_direction_count):
        at = legs.first_unknown[place] + k
        if k >= m:
            at = robots.unknown_count + k - m
        row = pairs.first[place]
        turn = to_tip * column(legs.problem.pose_columns, t, 3, k)
        if joint == wp.static(SPHERICAL):
            for j in range(3):
                pairs.columns[b, row + j, at] = turn[j]
            row += 3
        if joint == wp.static(REVOLUTE):
            pairs.columns[b, row, at] = wp.dot(axis, turn)
            row += 1
        for i in range(legs.rods):
            if pairs.torques > 0 and i != longest:
                angle = angle_of(pairs.angle_columns, t, 1, i, k)
                if reaches(pairs.end, own, legs.problem.inputs, t, i, 0):
                    angle -= angle_of(pairs.angle_columns, t, 1, longest, k)
                pairs.columns[b, row, at] = angle
                pairs.unit[b, row] = pairs.torsion[own, i]
                row += 1
    for k in range(3):  # against the platform
        at = robots.unknown_count - wp.static(POSE) + 3 + k
        row = pairs.first[place]
        turn = to_tip * column(robots.problem.pose_columns, b, 3, at)
        if joint == wp.static(REVOLUTE):
            pairs.columns[b, row, at] = -wp.dot(axis, turn)
        if joint == wp.static(SPHERICAL):
            for j in range(3):
                pairs.columns[b, row + j, at] = -turn[j]


@own_module()
def find_platform_displacements(robots: Robots, columns: wp.array3d[wp.float64]):
    """(12) The pose of the platform, in the last rows."""
    b = robots.problem.order[wp.tid()]
    if robots.problem.active[b] == 0:
        return
    first = columns.shape[1] - wp.static(POSE)
    for j in range(wp.static(POSE)):
        for k in range(columns.shape[2]):
            columns[b, first + j, k] = robots.problem.pose_columns[b, j, k]
