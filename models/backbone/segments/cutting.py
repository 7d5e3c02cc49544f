"""Rods cut into equal segments: which may be, and into how many. Numbers in parentheses are those of ``docs/networks.md``."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import ceil

import numpy as np

from multirod.read_only import changed
from multirod.rod import Rod

EACH = 5.0  # by whose exponential an error may grow along one segment
LONGEST = 10.0  # by which it may along a rod before it is said that it should be cut


def uniform(rod: Rod) -> bool:
    """Whether a rod is the same all along: of one section, whose precurvature is no function of arclength."""
    return len(rod.sections) == 1 and isinstance(rod.sections[0].precurvature, np.ndarray)


def piece(rod: Rod, count: int) -> Rod:
    """One of ``count`` equal pieces of a uniform rod."""
    if count == 1:
        return rod
    (section,) = rod.sections
    return changed(rod, sections=(replace(section, length=section.length / count),))


def may_be_cut(rods: Sequence[Rod]) -> bool:
    """Whether a rod, or tubes in each other, may be cut into segments."""
    return len(rods) == 1 and uniform(rods[0]) and not rods[0].carried


def needed(growth: float) -> int:
    """(42), (43) Segments of a rod along which an error grows by the exponential of ``growth``; 1 if it is short enough."""
    return ceil(growth / EACH) if growth > LONGEST else 1


def advice(segments: Mapping[str, int], one: str, call: str) -> str:
    """The end of a message: which rods, each of which is ``one``, should be cut, and the ``call`` that does it, with what the
    names stand for in its braces; empty where there is none."""
    if not segments:
        return ""
    which = f"{one}{'s' * (len(segments) > 1)} {', '.join(map(repr, segments))}"
    return f" ({which} may amplify errors too much to be integrated in one piece: {call.format(dict(segments))})"
