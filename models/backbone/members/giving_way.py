"""Whether sections give way to a change of strain with the lines that they carry, (L9b) of ``docs/lines.md``."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.members.line_kinds import SectionChamber
from multirod.models.backbone.members.lines import Line
from multirod.problem import Shape
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.members.driven import DrivenLines

SECTIONS = 65  # places along the rod, beside the middle of each section
STRAIN_STEPS = 8  # of Newton's method, from the strains at a node nearby
RIGID = 1e6  # what counts as infinite, over the bending stiffness
E3 = np.array([0.0, 0.0, 1.0])


def least_stiffness(lines: "DrivenLines", rod: int) -> tuple[FloatArray, FloatArray]:
    """Of the sections of one rod and what it carries, against changes of strain, [N m^2], and the least over the bending
    stiffness there, shape (instance_count,). What shears or stretches by 1 counts as a bend by 1 over the length of the rod."""
    problem = lines.problem
    shape = problem.shapes.at_nodes(SECTIONS)[0][rod]
    translation = problem.read("inputs")[:, problem.input_slice("translation")][:, rod, None]
    end, material = problem.each(problem.arrays.end[:, rod]), problem.each(problem.arrays.material[:, rod])
    s = shape.arclength - translation
    section = np.minimum((s[:, :, None] > end[:, None]).sum(axis=2), end.shape[1] - 1)
    # the middle of each, however short; of one that is not in use the first node stands there
    begin = np.maximum(np.concatenate([-translation, end[:, :-1]], axis=1), -translation)
    used = end > begin
    s = np.concatenate([s, np.where(used, (begin + end) / 2, s[:, :1])], axis=1)
    section = np.concatenate([section, np.where(used, np.arange(end.shape[1]), section[:, :1])], axis=1)
    here = np.take_along_axis(material, section[:, :, None], axis=1)
    rho, slope = _offsets(lines, s, end, section, here)
    u, v = _strains(lines, rod, shape, s + translation, section, (here, rho, slope))
    stiffness = np.zeros((*s.shape, 6, 6))
    with np.errstate(divide="ignore"):
        stiffness[..., range(3), range(3)] = here[..., :3]
        stiffness[..., range(3, 6), range(3, 6)] = 1 / here[..., 6:9]
    stiffness += _pulls(lines, rod, (here, rho, slope), u, v)[1]
    unit = np.ones((*end[:, -1].shape, 6))
    unit[..., 3:] = end[:, -1, None]
    stiffness *= (unit[:, :, None] * unit[:, None])[:, None]
    finite = np.where(np.isfinite(stiffness), stiffness, RIGID * here[..., :1, None])
    least = np.linalg.eigvalsh(finite)[..., 0]
    return np.asarray(least.min(axis=1)), np.asarray((least / here[..., 0]).min(axis=1))


def _strains(
    lines: "DrivenLines",
    rod: int,
    shape: Shape,
    s: FloatArray,
    section: NDArray[np.int_],
    places: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Curvature and stretch at arclengths ``s`` from the base, the first of which are the nodes of a shape.

    At the others they are what is carried there asks for, (5m) of ``docs/model.md``, which does not jump as strains do; of
    several rods, which share a curvature, they are those of the node before.
    """
    count = shape.arclength.shape[1]
    step = shape.arclength[:, -1:] / (count - 1)
    part = s / np.where(step > 0, step, 1.0)
    node = np.clip(np.nan_to_num(part).astype(int), 0, count - 2)
    node[:, :count] = np.arange(count)
    compliance = places[0][..., 3:9]
    u = np.take_along_axis(shape.curvature, node[:, :, None], axis=1)
    v = E3 + compliance[..., 3:] * np.take_along_axis(shape.force, node[:, :, None], axis=1)
    if len(lines.problem.rods) > 1:
        return u, v
    node, part, C = node[:, count:, None], part[:, count:, None], compliance[:, count:]
    total = np.concatenate([shape.total_moment, shape.total_force], axis=-1)
    carried = (1 - part + node) * np.take_along_axis(total, node, axis=1)
    carried += (part - node) * np.take_along_axis(total, node + 1, axis=1)
    rest = lines.problem.each(lines.problem.arrays.precurvature[:, rod, :, :3])
    rest = np.take_along_axis(rest, section[:, count:, None], axis=1)
    free = C * carried + np.concatenate([rest, np.zeros_like(rest)], axis=-1)
    here = (places[0][:, count:], places[1][:, count:], places[2][:, count:])
    q = np.concatenate([u[:, count:], v[:, count:] - E3], axis=-1)
    for _ in range(STRAIN_STEPS):
        pull, stiffness = _pulls(lines, rod, here, q[..., :3], q[..., 3:] + E3)
        dq = np.linalg.solve(np.eye(6) + C[..., None] * stiffness, (free - C * pull - q)[..., None])[..., 0]
        q = np.where(np.isfinite(dq), q + dq, q)
    u[:, count:], v[:, count:] = q[..., :3], q[..., 3:] + E3
    return u, v


def _pulls(
    lines: "DrivenLines", rod: int, places: tuple[FloatArray, FloatArray, FloatArray], u: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(L2), (L4), (L9) Moment and force that the lines of a rod carry at places, and their derivatives by strains, shapes
    (instance_count, place, 6) and (..., 6, 6)."""
    here, rho, slope = places
    carried, stiffness = np.zeros((*u.shape[:-1], 6)), np.zeros((*u.shape[:-1], 6, 6))
    drives, k = lines.tension() / lines.weights(), 0
    for j, kind in enumerate(lines.problem.features.members):
        if kind.drive is None:
            continue
        if lines.rods[j] == rod:
            T = drives[:, k, None] * here[..., lines.first[j]]
            lever, a = _tangent(rho[:, :, j], slope[:, :, j], u, v)
            t = np.broadcast_to(E3, a.shape)
            if not issubclass(kind, SectionChamber):
                t = a / np.linalg.norm(a, axis=-1, keepdims=True)
                stiffness += line_stiffness(T, rho[:, :, j], slope[:, :, j], u, v)
            carried += T[..., None] * np.concatenate([np.cross(lever, t), t], axis=-1)
        k += 1
    return carried, stiffness


def _offsets(
    lines: "DrivenLines", s: FloatArray, end: FloatArray, section: NDArray[np.int_], here: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """``rho`` [m] of each member that is a line, and its derivative, at arclengths of the rod, (instance_count, place, member,
    2)."""
    members, terms = lines.problem.features.members, lines.terms(here)
    stop = np.take_along_axis(end, section, axis=1)
    start = np.where(section > 0, np.take_along_axis(end, np.maximum(section - 1, 0), axis=1), 0.0)
    half = np.where(stop > start, (stop - start) / 2, np.inf)
    t, powers = (s - (start + stop) / 2) / half, np.arange(terms.shape[-2])
    values = (t[..., None, None] ** powers @ terms)[..., 0, :]
    slopes = (powers * t[..., None, None] ** np.maximum(powers - 1, 0) @ terms)[..., 0, :] / half[..., None]
    rho, slope = np.zeros((2, *s.shape, len(members), 2))
    first = 0
    for j, kind in enumerate(members):
        if issubclass(kind, Line):
            rho[:, :, j], slope[:, :, j] = values[..., first : first + 2], slopes[..., first : first + 2]
        first += len(kind.functions)
    return rho, slope


def _tangent(rho: FloatArray, slope: FloatArray, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(L1) The lever and ``a`` of lines at rho (..., 2) with derivative ``slope``, (..., 3) each."""
    lever = np.concatenate([rho, np.zeros((*rho.shape[:-1], 1))], axis=-1)
    return lever, v + np.cross(u, lever) + np.concatenate([slope, np.zeros((*slope.shape[:-1], 1))], axis=-1)


def line_stiffness(T: FloatArray, rho: FloatArray, slope: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """(L4) by (u, v) of lines of tension T (...), at rho (..., 2) with derivative ``slope``, shape (..., 6, 6)."""
    lever, a = _tangent(rho, slope, u, v)
    size = np.linalg.norm(a, axis=-1)[..., None, None]
    t = a[..., None] / size
    across = T[..., None, None] / size * (np.eye(3) - t @ t.swapaxes(-1, -2))
    # da = dv - [rho]x du
    by = np.concatenate(
        [np.cross(np.eye(3), lever[..., None, :]).swapaxes(-1, -2), np.broadcast_to(np.eye(3), (*size.shape[:-2], 3, 3))], axis=-1
    )
    return np.asarray(by.swapaxes(-1, -2) @ across @ by)
