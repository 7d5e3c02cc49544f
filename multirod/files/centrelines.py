"""Centrelines as one table of text, a row a node."""

import csv
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from multirod.files import ends
from multirod.files.quaternions import quaternions
from multirod.files.whole import written
from multirod.recording.figure import drawn_rods
from multirod.results.history import History
from multirod.results.solution import Solution
from multirod.status import Status
from multirod.validation import FloatArray, choice, refuse

HEADER = ("instance", "status", "rod", "arclength [m]", "x [m]", "y [m]", "z [m]", "qx", "qy", "qz", "qw")


def write(path: Path, solution: Solution, nodes: int | None = None, rows: str = "nodes") -> None:
    """One row for each node of each rod, of each instance of each sample; frames as quaternions, body to world.

    Args:
        path: Of the file.
        solution: What to write.
        nodes: Nodes of a rod, as for ``Solution.rod``.
        rows: ``"nodes"``, or ``"instances"`` for a row each, of its inputs and its end effector.
    """
    if choice("save.rows", rows, ("nodes", "instances")) == "instances":
        if nodes is not None:
            refuse("save.nodes", nodes, "must not be given beside rows='instances', which has no nodes")
        ends.write(path, solution)
        return
    shape = solution.batch_shape
    samples = shape[0] if isinstance(solution, History) else 1
    count = prod(shape) // samples if samples else 0
    statuses = np.reshape(np.asarray(solution.status), (samples, count))
    drawn = drawn_rods(solution.assembly)
    rods = [(rod.name, _nodes(solution, k, samples, count, nodes)) for k, rod in enumerate(drawn)]
    with written(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([*(ends.SAMPLE if isinstance(solution, History) else ()), *HEADER])
        for sample in range(samples):
            first: list[Any] = [sample, float(solution.time[sample])] if isinstance(solution, History) else []
            for instance in range(count):
                status = Status(int(statuses[sample, instance])).name
                for name, values in rods:
                    table.writerows([*first, instance, status, name, *row] for row in values[sample, instance].tolist())


def _nodes(solution: Solution, rod: int, samples: int, count: int, nodes: int | None) -> FloatArray:
    """Arclength, position and quaternion of each node, shape (samples, count, node_count, 8)."""
    shape = solution.rod(rod, nodes=nodes)
    values = np.concatenate([shape.arclength[..., None], shape.position, quaternions(shape.rotation)], axis=-1)
    return values.reshape(samples, count, *values.shape[-2:])
