"""Ends at one place. Of two tubes the pose has a kink there, and a derivative has a side. Of a section and a load it has none,
but there is one node, which cannot both move and stay."""

from collections.abc import Iterable
from functools import partial

import numpy as np

from multirod.inputs import Inputs
from multirod.models.backbone.influence.envelope import SAME_PLACE
from multirod.problem import BoundaryProblem
from multirod.rod import RodArrays
from multirod.validation import FloatArray

APART = 1e-9  # of the length in use, by which ends at one place are moved apart
MOVED_BY = ("translation", "length")


def move_ends(names: Iterable[object]) -> bool:
    """Whether any of these inputs or parameters moves ends of sections."""
    return any(name in MOVED_BY for name in names)


def ways_back(arrays: RodArrays, translation: FloatArray, given: Inputs) -> FloatArray:
    """How far each rod is moved back: further than those before it, so that no ends of two are at one place, and so that none is
    at the plate but for rounding, nor where a piece of a load ends that is a function of arclength; zero where none are.

    Args:
        arrays: The rods.
        translation: Shape (instance, n).
        given: What has the functions: their pieces end at fixed arclengths, whatever moves the rods.

    Returns:
        Shape (instance, n).
    """
    ends = arrays.end + translation[:, :, None]
    places = ends.reshape(len(ends), -1)
    owners, places = places.argsort(axis=1) // arrays.end.shape[2], np.sort(places, axis=1)
    near = places[:, 1:] - places[:, :-1] <= SAME_PLACE
    at_plate = (places > 0) & (places <= SAME_PLACE)  # one that is there is pulled back as it is
    if not (given.profiles or near.any() or at_plate.any()):
        return np.zeros(translation.shape)
    same = near & (owners[:, 1:] != owners[:, :-1]) & (places[:, 1:] > SAME_PLACE)
    meet = at_plate.any(axis=1, keepdims=True)
    if given.profiles:
        fixed = np.unique(np.concatenate([profile.ends for profile in given.profiles.values()]))
        nearest = np.abs(places[:, :, None] - fixed).min(axis=2)
        meet |= ((nearest <= SAME_PLACE) & (places > SAME_PLACE)).any(axis=1, keepdims=True)
    apart = same.any(axis=1, keepdims=True) * np.arange(translation.shape[1]) + meet
    return np.asarray(APART * ends[:, :, -1].max(axis=1, keepdims=True) * apart)


def part_ends(
    problem: BoundaryProblem, names: Iterable[object], rods: Iterable[tuple[RodArrays, slice]], given: Inputs
) -> FloatArray:
    """``BoundaryProblem.part_ends``, by the inputs of a problem of backbones.

    Args:
        problem: Whose inputs are changed where that is needed.
        names: By which derivatives are taken.
        rods: Of each backbone, and where its translations stand in a row of inputs.
        given: With which the problem was made.

    Returns:
        Shape (instance_count,).
    """
    furthest = np.zeros(problem.instance_count)
    if not move_ends(names):
        return furthest
    inputs = problem.read("inputs")
    for place, (arrays, own) in enumerate(rods):
        back = problem.found_for(f"ways back {place}", inputs[:, own], partial(ways_back, arrays, inputs[:, own], given)).copy()
        for k, points in problem.breakpoints.items():  # which keep their arclength
            ends = arrays.end[k % len(arrays.end)] + inputs[k, own, None]
            if not back[k].any() and (np.abs(ends[..., None] - points.arclength[1:-1]) <= SAME_PLACE).any():
                back[k] = APART * ends.max()
        inputs[:, own] -= back
        furthest = np.maximum(furthest, 2 * back[:, -1])
    if furthest.any():
        problem.write("inputs", inputs)
    return furthest
