"""Where the end effectors of a batch are: a point each."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.plotting.family import Family
from multirod.plotting.scene import TRIAD, finite, frame_view, triad
from multirod.recording.figure import bases

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]

MANY = 300  # points, from where on they are drawn smaller
SIZES = (18.0, 4.0)  # of few and of many [pt^2]


def draw(ax: "Axes3D", family: Family, *, frames: bool) -> None:
    """Draw the end effector of each instance as a point, and what the robot stands on as frames."""
    tips = family.solution.tip_position.reshape(-1, 3)[: len(family)]
    poses = list(bases(family.solution.assembly).values())
    every = finite([np.array([pose[:3, 3] for pose in poses]), tips])
    frame_view(ax, every)
    size = SIZES[len(tips) > MANY]
    ax.scatter(*tips.T, c=family.values, cmap=family.colormap, norm=family.norm, s=size, linewidths=0, plotnonfinite=True)
    length = TRIAD * (float(np.linalg.norm(np.ptp(every, axis=0))) or 1.0)
    for pose in poses if frames else []:
        triad(ax, pose[:3, 3], pose[:3, :3], length, letters=len(poses) == 1)
