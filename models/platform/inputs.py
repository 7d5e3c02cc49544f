"""What parallel robots take, and where it stands in a row of inputs."""

from collections.abc import Sequence
from dataclasses import replace

from multirod.inputs import InputSpec
from multirod.models.backbone.inputs import BACKBONE_INPUTS
from multirod.models.backbone.kernels.layout.members import drive_slices
from multirod.models.platform import platform_kernels as kernels

PER_ROD = ("rotation", "translation")
LEG_INPUTS = tuple(spec for spec in BACKBONE_INPUTS if spec.acts in ("base", "along"))  # what acts on a leg itself
_ON_PLATFORM = {
    "tip_force": "dead force on the platform at force_point, world frame",
    "tip_moment": "dead moment on the platform, world frame",
    "follower_force": "force on the platform at force_point, fixed in its frame",
    "follower_moment": "moment on the platform, fixed in its frame",
}
PLATFORM_INPUTS = (
    *(
        replace(spec, description=_ON_PLATFORM[spec.name], dead_twin="")  # legs have the unknowns that a twin would save
        for spec in BACKBONE_INPUTS
        if spec.name in _ON_PLATFORM
    ),
    InputSpec(name="force_point", unit="m", acts="tip", description="where forces act on the platform, platform frame"),
)


def input_places(rod_count: int, inverse: bool, drives: Sequence[str] = ()) -> dict[str, slice]:
    """Where each input stands in a row; one number more, the scale of load profiles, comes last."""
    places = {"rotation": slice(0, rod_count), "translation": slice(rod_count, 2 * rod_count)}
    vectors = (*(kernels.POSE_VECTORS if inverse else ()), *kernels.PLATFORM_VECTORS, *kernels.LEG_VECTORS)
    for k, name in enumerate(vectors):
        places[name] = slice(2 * rod_count + 3 * k, 2 * rod_count + 3 * k + 3)
    return places | drive_slices(drives, 2 * rod_count + 3 * len(vectors))
