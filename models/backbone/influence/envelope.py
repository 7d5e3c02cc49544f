"""Bounds of what acts on a backbone and of what it is made of, from base to tip, over groups of instances.

All is dimensionless (``docs/explain.md``): arclength and curvature by the length in use, moments and stiffnesses by the bending
stiffness of all rods at the base.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, prod

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.inputs import Inputs
from multirod.models.backbone.inputs import LOADS as SPECS
from multirod.profile import bounds, recentred
from multirod.rod import DENSITY, RodArrays
from multirod.validation import FloatArray

SAME_PLACE = 1e-12  # [m]: ends this close are at the same place
NODES = 20  # midpoints of as many equal parts of the length
PARTS = 8  # of a piece on which precurvature is a polynomial, each bounded by itself
GROUPS = 16  # of a batch, each of which is bounded as a whole
LARGEST_GROUP = 4096

FORCES = tuple(spec.name for spec in SPECS if spec.load == "force")
MOMENTS = tuple(spec.name for spec in SPECS if spec.load == "moment")
LOADS = FORCES + MOMENTS
ALONG = tuple(spec.name for spec in SPECS if spec.acts == "along")
POWER = {spec.name: spec.power for spec in SPECS}

FROM_BASE = (np.tril(np.ones((NODES, NODES)), -1) + 0.5 * np.eye(NODES)) / NODES  # integrates from the base to each node
TO_TIP = FROM_BASE.T  # from each node to the tip


@dataclass(frozen=True)
class Envelope:
    """Bounds of a backbone's loads and rods over a group of instances, at nodes from base to tip.

    Attributes:
        loads: Magnitude of each, (1,) at the tip and (NODES,) along the rods: forces by ``EI/L^2``, moments by ``EI/L``.
        measured: Moment that a measured tip curvature stands for.
        bending: Compliance in bending of all rods together, the larger of both axes, shape (NODES,).
        least: The same of the least stiff direction of all, torsion included, shape (NODES,).
        torsion: Compliance in torsion of each rod, shape (n, NODES).
        transmission: What a torque turns a rod behind the plate, shape (n,).
        anisotropy: Difference of both bending stiffnesses, shape (n, NODES).
        shear: Largest compliance in shear or extension, in ``EI/L^2``, shape (NODES,).
        shear_anisotropy: Difference of those of both axes, shape (NODES,).
        curved: ``EI u*_xy`` of each rod, shape (n, NODES).
        varied: How far ``u*`` is from its mean over a piece: bending and twist, shape (2, n, NODES).
        stiffness: ``EI`` of each rod, shape (n, NODES).
        furthest: Whether a rod may be the one that ends at the tip, shape (n,).
    """

    loads: Mapping[str, FloatArray]
    measured: float
    bending: FloatArray
    least: FloatArray
    torsion: FloatArray
    transmission: FloatArray
    anisotropy: FloatArray
    shear: FloatArray
    shear_anisotropy: FloatArray
    curved: FloatArray
    varied: FloatArray
    stiffness: FloatArray
    furthest: NDArray[np.bool_]

    @property
    def groups(self) -> dict[str, float]:
        """The dimensionless group of each term, (1)."""
        result = {name: float(value.mean()) for name, value in self.loads.items()}
        result["shear"] = float((self.shear * self.force()).mean())
        result["torsion"] = float((self.torsion / self.bending).max())
        result["anisotropy"] = float(2 * self.uneven.max())
        result["precurvature_profile"] = float(self.varied.max())
        return result

    @property
    def uneven(self) -> FloatArray:
        """Half the difference of both bending stiffnesses over the larger: what the mean of both is off by, shape (n, NODES)."""
        return np.asarray(self.anisotropy / (2 * np.where(self.stiffness > 0, self.stiffness, inf)))

    def force(self, names: Sequence[str] = FORCES) -> FloatArray:
        """Bound of the internal force by the loads of these names, shape (NODES,)."""
        total = np.zeros(NODES)
        for name in names:
            if name in self.loads:
                total = total + (TO_TIP @ self.loads[name] if name in ALONG else self.loads[name])
        return total


def envelopes(arrays: RodArrays, inputs: Inputs, batch_shape: tuple[int, ...], *, transmission: bool) -> Iterator[Envelope]:
    """Bounds over groups of instances that stand together in a batch, or along a motion."""
    count = prod(batch_shape)
    width = max(1, min(LARGEST_GROUP, -(-count // GROUPS)))
    for first in range(0, count, width):
        chosen = np.arange(first, min(first + width, count))
        yield _envelope(arrays, inputs, batch_shape, chosen, transmission=transmission)


def _envelope(
    arrays: RodArrays, inputs: Inputs, batch_shape: tuple[int, ...], chosen: IntArray, *, transmission: bool
) -> Envelope:
    arrays, own = arrays.take(batch_shape, chosen), inputs.take(batch_shape, chosen)
    translation = own.translation
    if not arrays.batch_shape and (translation == translation[0]).all():
        translation = translation[:1]  # the rods are the same in all
    ends = arrays.end + translation[:, :, None]
    length = ends[..., -1].max(axis=1)
    size = length[:, None, None]
    high, low, rod = _materials(arrays, ends, length)
    unit = high[:, :, 0].sum(axis=1)[:, None]
    departs = np.zeros((2, *high.shape))
    if arrays.degree:
        departs = _departures(arrays, translation, length) * size
    stiffness = high / unit[:, None]
    measured = 0.0
    if "tip_curvature" in own.given:
        gap = np.linalg.norm(own.tip_curvature - _polynomials(arrays)[:, 0, -1].sum(axis=-2), axis=-1)
        measured = float((gap * length / unit[:, 0] * arrays.material[:, 0, -1, :3].max(axis=-1)).max())
    behind = _behind(arrays, translation) * (unit / length[:, None]) if transmission else np.zeros((1, high.shape[1]))
    return Envelope(
        loads=_loads(own, rod["density"], rod["magnetisation"], unit[:, 0], length),
        measured=measured,
        bending=(unit / low.sum(axis=1)).max(axis=0),
        least=(unit * rod["least"][:, 0]).max(axis=0),
        torsion=(rod["torsion"] * unit[:, None]).max(axis=0),
        transmission=behind.max(axis=0),
        anisotropy=(rod["uneven"] / unit[:, None]).max(axis=0),
        shear=(rod["shear"][:, 0] * unit / length[:, None] ** 2).max(axis=0),
        shear_anisotropy=(rod["across"][:, 0] * unit / length[:, None] ** 2).max(axis=0),
        curved=(rod["curved"] / unit[:, None] * size + stiffness * departs[0]).max(axis=0),
        varied=departs.max(axis=1),
        stiffness=stiffness.max(axis=0),
        furthest=(ends[..., -1] >= length[:, None] - SAME_PLACE).any(axis=0),
    )


def _materials(arrays: RodArrays, ends: FloatArray, length: FloatArray) -> tuple[FloatArray, FloatArray, dict[str, FloatArray]]:
    """Largest and least bending stiffness of each rod about each node, and the largest of other quantities, (instances, n,
    NODES).

    Of all sections that reach into a node's part of the length, however short they are.
    """
    EI, material = arrays.material[..., :2], arrays.material
    precurvature = _polynomials(arrays)
    quantities = {
        "high": EI.max(axis=-1),
        "compliant": 1 / EI.min(axis=-1),
        "uneven": EI.max(axis=-1) - EI.min(axis=-1),
        "torsion": material[..., 5],
        "least": 1 / material[..., :3].min(axis=-1),
        "shear": material[..., 6:9].max(axis=-1),
        "across": np.abs(material[..., 6] - material[..., 7]),
        "density": material[..., DENSITY],
        "magnetisation": np.linalg.norm(material[..., 10:13], axis=-1),
        "curved": EI.max(axis=-1) * np.linalg.norm(_mean(precurvature)[..., :2], axis=-1),
    }
    found = _largest(quantities, ends, length)
    soft = found.pop("compliant")
    ended = ends[..., -1:] < np.arange(1, NODES + 1) / NODES * length[:, None, None] - SAME_PLACE
    low = np.where(ended | (soft == 0), 0.0, 1 / np.where(soft == 0, 1.0, soft))
    return found.pop("high"), low, found


def _largest(quantities: Mapping[str, FloatArray], ends: FloatArray, length: FloatArray) -> dict[str, FloatArray]:
    """The largest of quantities of rods' pieces, none negative, about each node, (instances, n, NODES); what is pushed out of the
    base continues the first piece.

    Of all pieces that reach into a node's part of the length, however short they are.
    """
    edges = np.arange(NODES + 1) / NODES * length[:, None, None]
    left, right = edges[..., :-1] + SAME_PLACE, edges[..., 1:] - SAME_PLACE
    found = {name: np.zeros((*ends.shape[:2], NODES)) for name in quantities}
    begins = np.full(ends.shape[:2], -inf)
    for k in range(ends.shape[2]):
        stops = ends[..., k]
        inside = (stops[..., None] > left) & (begins[..., None] < right) & (stops > begins)[..., None]
        for name, values in quantities.items():
            np.maximum(found[name], np.where(inside, values[..., k, None], 0.0), out=found[name])
        begins = np.where(stops > begins, stops, begins)
    return found


def _behind(arrays: RodArrays, translation: FloatArray) -> FloatArray:
    """Compliance in torsion of each rod behind the plate [1/(N m)], shape (instances, n)."""
    stops = np.minimum(arrays.end, -translation[:, :, None])
    starts = np.concatenate([np.zeros_like(stops[..., :1]), stops[..., :-1]], axis=-1)
    return np.asarray((np.maximum(stops - starts, 0.0) * arrays.material[..., 5]).sum(axis=-1))


def _polynomials(arrays: RodArrays) -> FloatArray:
    """Of ``u*`` on each piece, from -1 to 1, shape (instances, n, pieces, degree + 1, 3).

    What is pushed out of the base has that of the first piece that has a length, which it continues.
    """
    found = arrays.precurvature.reshape(*arrays.precurvature.shape[:-1], arrays.degree + 1, 3)
    following = np.concatenate([found[:, :, 1:], found[:, :, -1:]], axis=2)
    return np.where((arrays.end == 0)[..., None, None], following, found)


def _mean(coefficients: FloatArray) -> FloatArray:
    """Of polynomials from -1 to 1."""
    powers = np.arange(coefficients.shape[-2])
    return np.asarray((coefficients * ((powers % 2 == 0) / (powers + 1))[:, None]).sum(axis=-2))


def _departures(arrays: RodArrays, translation: FloatArray, length: FloatArray) -> FloatArray:
    """How far ``u*`` is anywhere about each node from its mean over the piece: bending and twist [1/m], shape (2, instances, n,
    NODES).

    Each piece is bounded part by part: on a short one no power of its polynomial does much but the first.
    """
    coefficients = _polynomials(arrays)
    varied = np.array(coefficients)
    varied[..., 0, :] -= _mean(coefficients)
    steps = np.linspace(-1.0, 1.0, PARTS + 1)
    varied = recentred(varied[..., None, :, :], -1.0, 1.0, steps[:-1], steps[1:])
    starts = np.concatenate([np.zeros_like(arrays.end[..., :1]), arrays.end[..., :-1]], axis=-1)
    ends = starts[..., None] + (arrays.end - starts)[..., None] * (steps[1:] + 1) / 2
    ends = ends.reshape(*ends.shape[:2], -1) + translation[:, :, None]
    values = {"bend": bounds(varied[..., :2]), "twist": bounds(varied[..., 2:])}
    found = _largest({name: value.reshape(*value.shape[:2], -1) for name, value in values.items()}, ends, length)
    return np.stack([found["bend"], found["twist"]])


def _loads(
    own: Inputs, density: FloatArray, magnetisation: FloatArray, unit: FloatArray, length: FloatArray
) -> dict[str, FloatArray]:
    """Magnitudes of the loads that act, dimensionless, the largest of all instances."""
    result = {}
    for name in LOADS:
        if not own.is_active(name):
            continue
        scale = unit / length ** POWER[name]
        profile = own.profile(name)
        most = profile.bound if profile is not None else np.linalg.norm(getattr(own, name), axis=-1)[:, None]
        value = most / scale[:, None]
        if name == "gravity":  # by mass per length: a force per length
            value = value * density.sum(axis=1)
        if name == "magnetic_field":  # by magnetisation: a moment per length, at most
            value = value * magnetisation.sum(axis=1)
        result[name] = np.broadcast_to(value.max(axis=0), NODES if name in ALONG else 1)
    return result
