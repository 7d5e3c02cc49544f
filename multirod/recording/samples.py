"""Samples as the blocks that are written together: histories of the instances that are recorded."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from multirod.recording.background import Sample
from multirod.results.history import History, alike
from multirod.results.remarks import Remarks
from multirod.results.solution import Solution


def stackable(before: Sample, sample: Sample) -> bool:
    """Whether a sample can be part of the same batch as the one before: same records, same inputs by name."""

    def same(one: Solution | None, other: Solution | None) -> bool:
        if one is None or other is None:
            return one is other
        return alike(one, other)

    one, other = before.solution._remarks, sample.solution._remarks
    told_alike = one is other if one is None or other is None else one.like(other)
    return told_alike and same(before.solution, sample.solution) and same(before.reference, sample.reference)


def remarks(samples: Sequence[Sample]) -> list[Remarks]:
    """What tasks said of the samples; empty where they said nothing."""
    return [sample.solution._remarks for sample in samples if sample.solution._remarks is not None]


def first_instances(history: History, count: int) -> History:
    """The history of the first ``count`` instances, its batch axes flattened to one; itself if it has none."""
    samples, *axes = history.batch_shape
    total = math.prod(axes)
    if not axes or (total <= count and len(axes) == 1) or history.assembly.batch_shape:
        return history
    kept = min(count, total)
    rows = np.arange(samples * total).reshape(samples, total)[:, :kept].reshape(-1)
    arrays = {}
    for name in history._applied.arrays:
        value = getattr(history._applied, name)
        arrays[name] = np.broadcast_to(value, (*history.batch_shape, value.shape[-1])).reshape(samples, total, -1)[:, :kept]
    return History(
        replace(history._scene, batch_shape=(samples, kept)),
        history._records[rows],
        history._outcome.take(rows),
        history._applied.with_arrays(arrays, (samples, kept)),
        time=history.time,
        step_time=history.step_time,
        description=history.description,
    )
