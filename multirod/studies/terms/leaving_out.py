"""The same scene without some of its terms: what is dropped is made rigid, round, uniform, smooth, or zero."""

from collections.abc import Callable, Sequence
from dataclasses import fields
from math import inf

import numpy as np

from multirod.assembly import Assembly, Robot
from multirod.inputs import Inputs
from multirod.models.backbone.influence.envelope import LOADS
from multirod.profile import Profile
from multirod.read_only import changed
from multirod.rod import Rod, Section
from multirod.validation import FloatArray


def _changed(section: Section, **values: FloatArray) -> Section:
    """A section with other parameters, checked already: functions of arclength are not resolved anew."""
    result = object.__new__(Section)
    for field in fields(Section):
        object.__setattr__(result, field.name, values.get(field.name, getattr(section, field.name)))
    return result


def _rigid(*names: str) -> Callable[[Section], list[Section]]:
    return lambda section: [_changed(section, **{name: np.full_like(getattr(section, name), inf) for name in names})]


def _round(section: Section) -> list[Section]:
    stiffness = section.bending_stiffness
    return [_changed(section, bending_stiffness=np.repeat(stiffness.mean(axis=-1, keepdims=True), 2, axis=-1))]


def _uniform(section: Section) -> list[Section]:
    """A section for each piece that a function of arclength was resolved into, with its mean."""
    pieces = section.precurvature
    if not isinstance(pieces, Profile):
        return [section]
    powers = np.arange(pieces.coefficients.shape[1])
    mean = np.einsum("pkw,k->pw", pieces.coefficients, (powers % 2 == 0) / (powers + 1))
    lengths = np.diff(pieces.ends, prepend=0.0)
    return [_changed(section, length=np.array(length), precurvature=value) for length, value in zip(lengths, mean, strict=True)]


SECTIONS = {
    "shear": _rigid("shear_stiffness", "axial_stiffness"),
    "torsion": _rigid("torsional_stiffness"),
    "anisotropy": _round,
    "precurvature_profile": _uniform,
}
LINES = {
    "discs": lambda rod, line: line.on(rod.sections),
    "friction": lambda rod, line: line.smooth(),
}


def loads_of(robot: Assembly) -> tuple[str, ...]:
    """Names of the loads that a robot takes, but for what drives its lines: those of a backbone first."""
    taken = [spec.name for spec in robot.input_specs if spec.load is not None and spec.acts != "lines"]
    return (*(name for name in LOADS if name in taken), *(name for name in taken if name not in LOADS))


def droppable(robot: Assembly) -> tuple[str, ...]:
    """Names of all that may be left out of scenes of a robot."""
    return (*loads_of(robot), *SECTIONS, *(LINES if any(rod.lines for rod in robot.rods) else ()))


def left_out(robot: Robot, inputs: Inputs, names: Sequence[str]) -> tuple[Robot, Inputs]:
    """The robot and the inputs without these terms; what they do not touch is shared."""
    changes = [name for name in (*SECTIONS, *LINES) if name in names]
    loads = [name for name in names if name not in changes]
    if changes:
        robot = robot.with_rods([_without(rod, changes) for rod in robot.rods])
    return robot, inputs.without(loads) if loads else inputs


def _without(rod: Rod, names: Sequence[str]) -> Rod:
    sections, lines = rod.sections, rod.lines
    for name in names:
        if name in SECTIONS:
            sections = tuple(new for section in sections for new in SECTIONS[name](section))
        else:
            lines = tuple(LINES[name](rod, line) for line in lines)
    return changed(rod, sections=sections, lines=lines, discs=None if "discs" in names else rod.discs)
