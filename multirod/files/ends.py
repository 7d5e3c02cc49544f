"""End effectors and inputs as one table of text, a row an instance."""

import csv
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from multirod.files.quaternions import quaternions
from multirod.files.whole import written
from multirod.results.history import History
from multirod.results.solution import Solution
from multirod.status import Status
from multirod.tasks.freed import labels_of
from multirod.validation import FloatArray

SAMPLE = ("sample", "time [s]")  # of a history
POSE = ("x [m]", "y [m]", "z [m]", "qx", "qy", "qz", "qw")


def write(path: Path, solution: Solution) -> None:
    """One row for each instance of each sample: its status, its inputs, the pose of its end effector.

    Args:
        path: Of the file.
        solution: What to write.
    """
    shape = solution.batch_shape
    timed = isinstance(solution, History)
    labels, values = _inputs(solution)
    every = np.concatenate([*values, solution.tip_position, quaternions(solution.tip_rotation)], axis=-1)
    samples = shape[0] if timed else 1
    rows = every.reshape(samples, prod(shape) // samples if samples else 0, every.shape[-1])
    statuses = np.asarray(solution.status).reshape(rows.shape[:2])
    with written(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([*(SAMPLE if timed else ()), "instance", "status", *labels, *POSE])
        for sample in range(len(rows)):
            first: list[Any] = [sample, float(solution.time[sample])] if isinstance(solution, History) else []
            for instance, (status, own) in enumerate(zip(statuses[sample], rows[sample], strict=True)):
                table.writerow([*first, instance, Status(int(status)).name, *own.tolist()])


def _inputs(solution: Solution) -> tuple[list[str], list[FloatArray]]:
    """What each number that was given is called, with its unit, and all of them, of all instances."""
    inputs, labels, values = solution.inputs, [], []
    for name in inputs.given:
        if name in inputs.profiles:
            continue
        own = getattr(inputs, name)
        every = np.broadcast_to(own, (*solution.batch_shape, own.shape[-1]))
        unit = f" [{inputs.specs[name].unit}]" if inputs.specs[name].unit else ""
        labels += [f"{label}{unit}" for label in labels_of(solution.assembly, (name,), (own.shape[-1],))]
        values.append(every)
    return labels, values
