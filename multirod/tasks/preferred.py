"""Where what a target leaves free is pulled to. Numbers in parentheses: ``docs/tasks.md``."""

from collections.abc import Sequence

import numpy as np

from multirod.assembly import Assembly
from multirod.tasks.freed import columns, labels_of
from multirod.tasks.limits import LimitRows, middle
from multirod.validation import FloatArray, refuse


def centre_of(
    field: str, prefer: str, robot: Assembly, free: Sequence[str], rows: LimitRows, begin: FloatArray
) -> FloatArray | None:
    """Of what is free and begins at ``begin`` (b, k), shape (k,); None where nothing is pulled.

    Raises:
        ValueError: If there is no such place.
    """
    if prefer == "smallest tension":
        return _slack(field, robot, free, begin)
    if prefer != "middle":
        return None
    centre = middle(rows)
    if (lost := np.isnan(centre)).any():
        sizes = [spec.size(robot.rod_count) for name in free for spec in robot.input_specs if spec.name == name]
        labels = np.array(labels_of(robot, free, sizes))[columns(free, sizes)][lost]
        missing = f"{', '.join(labels)} {'have' if len(labels) > 1 else 'has'} none"
        refuse(field, prefer, f"needs limits on both sides of every freed input, which have a middle: {missing}")
    return centre


def _slack(field: str, robot: Assembly, free: Sequence[str], begin: FloatArray) -> FloatArray:
    """Where no line is tense and all else that is free is as at first."""
    if "tension" not in free:
        refuse(field, "smallest tension", "needs tension to be free")
    sizes = {spec.name: spec.size(robot.rod_count) for spec in robot.input_specs}
    others = np.concatenate([np.full(sizes[name], name != "tension") for name in free])
    others = others[columns(free, [sizes[name] for name in free])]
    if np.ptp(begin[:, others], axis=0).any():
        refuse(field, "smallest tension", "needs what else is free to begin at one place for all targets")
    return np.where(others, begin[0] if len(begin) else 0.0, 0.0)
