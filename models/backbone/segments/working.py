"""Segments by what works on what: how forces that depend on the places of rods let their variations go on."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.models.backbone.stability.condensing.by_places import held_form_by_places
from multirod.models.backbone.stability.condensing.second_variation import CondensedForm
from multirod.segments import Cuts
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.segments.segments import BackboneSegments

NAMES = ("moment", "place", "rotation", "force")


def work(segments: "BackboneSegments", cuts: Cuts) -> FloatArray:
    """Energy of a unit of what varies, by a unit of its conjugate [N m], shape (count,): ``EI/L``."""
    return np.asarray(segments._force_unit[cuts.instances])


def by_work(segments: "BackboneSegments", transition: FloatArray, cuts: Cuts) -> FloatArray:
    """Transitions as ``form_by_places`` takes them, by rotations in radians and positions over the length."""
    order = np.concatenate([np.arange(segments.variation_size)[segments._varied.places[name]] for name in NAMES])
    unit = np.ones((len(transition), 12))
    unit[:, :3] = segments._stiffness[cuts.instances[cuts.owner]]
    unit[:, :3] /= (work(segments, cuts) * segments._scale[cuts.instances])[cuts.owner, None]
    unit[:, 3:6] = -1.0
    return np.asarray(unit[:, :, None] * transition[:, order[:, None], order] / unit[:, None, :])


def held_form(segments: "BackboneSegments", cuts: Cuts) -> CondensedForm:
    """(22b) of ``docs/stability.md``, of rods on which forces act that depend on where they are."""
    chosen, d = cuts.instances, segments.variation_size
    found = segments._launched(cuts, segments.level(chosen), segments.problem.buffers.twisting_table())
    transition = by_work(segments, found["columns"][:, :d, :d], cuts)
    base, states = segments._base(chosen)[0], found["end_state"]
    ends, moment = base[cuts.owner] @ segments._matrices(states), states[cuts.first[1:] - 1, :3]
    units = work(segments, cuts), segments._scale[chosen]
    return held_form_by_places(transition, ends, cuts.first, *units, base @ segments._axes(chosen), moment)


def added_up(values: FloatArray, cuts: Cuts) -> FloatArray:
    """Values of segments (segment_count, 3), each added to those before it in its instance."""
    result, counts = values.copy(), cuts.counts
    for k in range(1, int(counts.max())):
        rows = cuts.first[:-1][counts > k] + k
        result[rows] += result[rows - 1]
    return result
