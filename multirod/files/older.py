"""What earlier versions wrote to archives and constructors refuse by now: left out, as it said nothing."""

from typing import Any

from multirod.models.network.joining.joints import AXES

HINGES = {"joint_axis": "joint", "base_joint_axis": "base_joint", "joint_axes": "joints"}  # axes, and what says if there is one


def without_idle_axes(value: Any) -> Any:  # noqa: ANN401  (tables as they stand in files)
    """A table, or a list of tables, without the axes of joints that have none."""
    if isinstance(value, list):
        return [without_idle_axes(item) for item in value]
    if not isinstance(value, dict):
        return value
    idle = {axis for axis, kinds in HINGES.items() if "revolute" not in _listed(value.get(kinds))}
    if "rod" in value and "to" in value and not (value.get("kind") in AXES and value.get("end") in ("base", "tip")):
        idle.add("axis")
    return {name: without_idle_axes(item) for name, item in value.items() if name not in idle}


def _listed(kinds: object) -> list[object]:
    return kinds if isinstance(kinds, list) else [kinds]
