"""Samples as the blocks that are written together: histories of the instances that are recorded."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from multirod.history import History
from multirod.recording.background import Sample
from multirod.remarks import Remarks
from multirod.solution import Solution
from multirod.solver import Outcome
from multirod.validation import FloatArray


def stack(solutions: Sequence[Solution], times: FloatArray, durations: FloatArray) -> History:
    """Samples of one robot as a history, so that all their shapes are integrated in one batch."""
    first = solutions[0]
    arrays: dict[str, FloatArray] = {}
    for name in first.inputs.given:
        if name not in first.inputs.profiles:
            rows = [getattr(solution.inputs, name) for solution in solutions]
            arrays[name] = np.stack([np.broadcast_to(row, (*first.batch_shape, row.shape[-1])) for row in rows])
    outcome = Outcome.joined([solution._outcome for solution in solutions])
    records = np.concatenate([solution._records for solution in solutions])
    batch_shape = (len(solutions), *first.batch_shape)
    inputs = first.inputs.with_arrays(arrays)
    if not arrays:
        inputs = inputs[np.newaxis][np.zeros(batch_shape, dtype=int)]
    scene = replace(first._scene, batch_shape=batch_shape)
    return History(scene, records, outcome, inputs, time=times, step_time=durations)


def stackable(before: Sample, sample: Sample) -> bool:
    """Whether a sample can be part of the same batch as the one before: same records, same inputs by name."""

    def same(one: Solution | None, other: Solution | None) -> bool:
        if one is None or other is None:
            return one is other
        return one._scene is other._scene or (
            one._scene.fields == other._scene.fields
            and one.inputs.given == other.inputs.given
            and all(other.inputs.profile(name) is profile for name, profile in one.inputs.profiles.items())
        )

    one, other = before.solution._remarks, sample.solution._remarks
    alike = one is other if one is None or other is None else one.like(other)
    return alike and same(before.solution, sample.solution) and same(before.reference, sample.reference)


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
    for name in history.inputs.given:
        if name not in history.inputs.profiles:
            value = getattr(history.inputs, name)
            arrays[name] = np.broadcast_to(value, (*history.batch_shape, value.shape[-1])).reshape(samples, total, -1)[:, :kept]
    return History(
        replace(history._scene, batch_shape=(samples, kept)),
        history._records[rows],
        history._outcome.take(rows),
        history.inputs.with_arrays(arrays),
        time=history.time,
        step_time=history.step_time,
        description=history.description,
    )
