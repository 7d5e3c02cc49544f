"""A bent rod, held in every way and loaded in every way."""

import numpy as np

import multirod as mr

BENT = mr.Rod(
    length=0.4, bending_stiffness=(0.2233, 0.3), torsional_stiffness=0.0638, precurvature=(1.0, 0.3, 0.5), linear_density=0.02
)
PLACE = np.array([[1.0, 0, 0, 0.05], [0, 1, 0, 0.02], [0, 0, 1, 0.33], [0, 0, 0, 1]])
HELD = {
    "clamped": {},
    "revolute, sliding": {"joint": "revolute", "joint_axis": (0.6, 0, 0.8), "slide": (0, 0.6, 0.8)},
    "spherical, revolute base": {"joint": "spherical", "base_joint": "revolute", "base_joint_axis": (0, 0.6, 0.8)},
    "sliding, spherical base": {"slide": (0, 0, 1), "base_joint": "spherical"},
}
GIVEN = {
    "rotation": 0.3,
    "end_position": (0.02, 0.01, -0.01),
    "end_rotation": (0.3, -0.2, 0.5),
    "tip_force": (0.3, 0.2, -0.5),
    "distributed_force": (0.2, 0.5, -0.1),
    "gravity": (0, 1, 2.0),
}
