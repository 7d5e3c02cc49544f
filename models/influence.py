"""What a term of a backbone's equations does to its tip, bounded before anything is solved.

The bounds and their derivation are ``docs/explain.md``; numbers in parentheses are its. All is dimensionless here: arclength and
curvature by the length in use, moments and stiffnesses by the bending stiffness at the base.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, prod

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.inputs import Inputs
from multirod.rod import RodArrays
from multirod.validation import FloatArray

NODES = 20
ROUNDING = 1 + 1 / (2 * NODES**2)  # what the midpoint rule may lack
GROUPS = 16  # of a batch, each of which is bounded as a whole
LARGEST_GROUP = 4096
SAMPLES = 65  # of a load along the length

FORCES = ("tip_force", "follower_force", "distributed_force", "gravity")
MOMENTS = ("tip_moment", "follower_moment", "distributed_moment")
LOADS = FORCES + MOMENTS
ALONG = ("distributed_force", "distributed_moment", "gravity")

_h = 1 / NODES
_t = (np.arange(NODES) + 0.5) * _h
_from_base = _h * (np.tril(np.ones((NODES, NODES)), -1) + 0.5 * np.eye(NODES))
_to_tip = _from_base.T
_whole = np.full(NODES, _h)
_end = np.ones((NODES, 1)) * _whole  # the value at the tip, from rates


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
        """The dimensionless groups of ``docs/explain.md``, (1) to (5)."""
        result = {name: float((np.ones(NODES) * value).mean()) for name, value in self.loads.items() if value.any()}
        force = self.force()
        stretch = _whole @ (self.shear * force)
        twist = (self.torsion / np.where(self.bending > 0, self.bending, inf)).max()
        result |= {"shear": float(stretch), "torsion": float(twist)}
        with np.errstate(divide="ignore", invalid="ignore"):
            uneven = np.nan_to_num(self.anisotropy / self.stiffness)
        result |= {"anisotropy": float(uneven.max()), "precurvature_profile": float(self.varied.max())}
        return result

    def force(self, names: Sequence[str] = FORCES) -> FloatArray:
        """Bound of the internal force by the loads of these names, shape (NODES,)."""
        total = np.zeros(NODES)
        for name in names:
            if name in self.loads:
                total = total + (_to_tip @ self.loads[name] if name in ALONG else self.loads[name])
        return total


def influences(arrays: RodArrays, inputs: Inputs, batch_shape: tuple[int, ...], *, transmission: bool) -> dict[str, "Influence"]:
    """The largest relative change of the tip's position that dropping each term makes, over all instances."""
    found: dict[str, Influence] = {}
    for envelope in envelopes(arrays, inputs, batch_shape, transmission=transmission):
        groups = envelope.groups
        for name, (error, free) in tip_errors(envelope).items():
            new = Influence(groups.get(name, 0.0), error, error / free if free > 0 else 1.0)
            found[name] = new if name not in found else found[name].joined(new)
    return found


@dataclass(frozen=True)
class Influence:
    """What dropping one term does.

    Attributes:
        group: The dimensionless group that governs it, the largest of all instances.
        error: Bound of the tip's change over the length in use; ``inf`` where none is known.
        amplification: How many times more that is than of a rod that carries nothing else.
    """

    group: float
    error: float
    amplification: float

    def joined(self, other: "Influence") -> "Influence":
        """The larger of both."""
        return Influence(
            max(self.group, other.group), max(self.error, other.error), max(self.amplification, other.amplification)
        )


def tip_errors(envelope: Envelope) -> dict[str, tuple[float, float]]:
    """Bounds of the tip's change, (14), and what they would be without other loads and couplings."""
    rods = len(envelope.curved)
    found = _errors(envelope, separate=True)
    if rods == 1:  # bounded in two ways: twist apart from bending, and both together
        other = _errors(envelope, separate=False)
        found = {name: min(found[name], other[name]) for name in found}
    return found


def _errors(bounds: Envelope, *, separate: bool) -> dict[str, tuple[float, float]]:
    """As ``tip_errors``; ``separate`` is (8) to (13), else (6) and (7) with the frame of the rod itself."""
    n = len(bounds.curved) if separate else 0
    alone = len(bounds.curved) == 1
    c = bounds.bending if separate else bounds.least
    load, sigma, uneven_shear = bounds.loads, bounds.shear, bounds.shear_anisotropy if alone else np.zeros(NODES)
    zero = np.zeros(NODES)

    # bounds of what acts, (6)
    force = bounds.force()
    lengthened = 1 + sigma * force
    arm = 1 + 2 * sigma * force
    spread = np.ones(NODES) * load.get("distributed_moment", 0.0)
    dead, following = (float(np.max(load.get(name, 0.0))) for name in ("tip_moment", "follower_moment"))
    following += bounds.measured
    follower = float(np.max(load.get("follower_force", 0.0)))
    moment = _to_tip @ (lengthened * force) + _to_tip @ spread + dead + following

    # how moments answer rotations, (7)
    P = _to_tip @ (force[:, None] * arm[:, None] * _from_base) + moment[:, None] * _from_base
    P = P + (follower * (_to_tip @ lengthened) + following)[:, None] * _end
    Q = _to_tip * (force**2 * uneven_shear) if n else np.zeros((NODES, NODES))

    # the curvature of all rods, and how each answers, (8) to (11)
    curved = bounds.curved[:n]
    turn = c * (moment + curved.sum(axis=0))
    uneven = bounds.anisotropy[:n]
    coupled = curved + uneven * turn
    size = (n + 1) * NODES
    B = np.zeros((size, size))
    B[:NODES, :NODES] = c[:, None] * P
    places = [slice((1 + k) * NODES, (2 + k) * NODES) for k in range(n)]
    twists: list[FloatArray] = []
    for k, place in enumerate(places):
        B[:NODES, place] = np.diag(c * coupled[k])
        if k == 0:
            B[:NODES, place] += c[:, None] * Q
        own = bounds.torsion[k]
        twists.append(_from_base @ (own[:, None] * _to_tip) + bounds.transmission[k] * _end)
    rates = [coupled[k] * c for k in range(n)]
    for k, place in enumerate(places):
        others = coupled.sum(axis=0) - (coupled[k] if not uneven[k].any() else 0.0)
        by_rotation = rates[k][:, None] * P + (spread + (force**2 * uneven_shear))[:, None] * _from_base
        B[place, :NODES] = twists[k] @ by_rotation
        if bounds.furthest[k]:
            B[place, :NODES] += np.outer(_from_base @ bounds.torsion[k] + bounds.transmission[k], dead * _whole)
        for j, other in enumerate(places):
            by_twist = np.diag(rates[k] * (moment + others if j == k else coupled[j]))
            if j == k and uneven[k].any():
                by_twist += np.diag(2 * rates[k] * coupled[k])
            if j == 0:
                by_twist += rates[k][:, None] * Q
                if j == k:
                    by_twist += np.diag(force**2 * uneven_shear)
            B[place, other] = twists[k] @ by_twist

    # what the tip moves by, (12)
    effect = np.zeros(size)
    effect[:NODES] = _whole @ (arm[:, None] * _from_base)
    if n:
        effect[places[0]] = _h * force * uneven_shear
    solved = np.linalg.solve(np.eye(size) - B, np.ones(size)) if np.isfinite(B).all() else -np.ones(size)
    promised = bool(np.isfinite(solved).all() and (solved > 0).all())
    weights = np.linalg.solve((np.eye(size) - B).T, effect) if promised else np.full(size, np.nan)

    def error(
        moment_source: FloatArray,
        bend: FloatArray = zero,
        stretch: FloatArray = zero,
        torque: Sequence[FloatArray] | None = None,
        at_tip: float = 0.0,
        twist: Sequence[FloatArray] | None = None,
    ) -> tuple[float, float]:
        """(13) and (14) for one term."""
        a = moment_source + _to_tip @ (force * stretch)
        source = np.zeros(size)
        source[:NODES] = c * a + bend
        for k, place in enumerate(places):
            rate = rates[k] * a + (zero if torque is None else torque[k])
            source[place] = twists[k] @ rate + (zero if twist is None else twist[k])
            if bounds.furthest[k]:
                source[place] += (_from_base @ bounds.torsion[k] + bounds.transmission[k]) * at_tip
        direct = float(_whole @ stretch)
        if not source.any() and direct == 0:
            return 0.0, 0.0
        free = (float(effect[:NODES] @ source[:NODES]) + direct) * ROUNDING
        return ((float(weights @ source) + direct) * ROUNDING if promised else inf), free

    found: dict[str, tuple[float, float]] = {}
    for name in load:
        if name in FORCES:
            own = bounds.force((name,))
            stretch = sigma * own
            torque = [uneven_shear * force * own] * n
            found[name] = error(_to_tip @ (lengthened * own), stretch=stretch, torque=torque)
        elif name == "distributed_moment":
            found[name] = error(_to_tip @ spread, torque=[spread] * n)
        else:
            found[name] = error(np.ones(NODES) * load[name], at_tip=float(np.max(load[name])))
    found["shear"] = error(zero, stretch=sigma * force, torque=[uneven_shear * force**2] * n)
    if separate:
        torques = [
            _to_tip
            @ (rates[k] * (moment + coupled.sum(axis=0) - (0.0 if uneven[k].any() else coupled[k])) + spread + force**2 * uneven_shear)
            + (dead + following if bounds.furthest[k] else 0.0)
            for k in range(n)
        ]
        twist = [_from_base @ (bounds.torsion[k] * torques[k]) + bounds.transmission[k] * torques[k][0] for k in range(n)]
        found["torsion"] = error(zero, twist=twist)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.nan_to_num(uneven / (2 * bounds.stiffness[:n]))
        lost = share * (curved + bounds.stiffness[:n] * turn)
        found["anisotropy"] = error(zero, bend=c * lost.sum(axis=0), torque=[turn * own for own in lost])
        bend, twisted = bounds.varied
        lost = bounds.stiffness[:n] * bend
        found["precurvature_profile"] = error(
            zero, bend=c * lost.sum(axis=0), torque=[turn * own for own in lost], twist=[_from_base @ own for own in twisted]
        )
    else:
        found["torsion"] = error(zero, bend=bounds.torsion[0] * moment)
        share = np.nan_to_num(bounds.anisotropy[0] / (2 * bounds.stiffness[0]))
        found["anisotropy"] = error(zero, bend=share * c * moment)
        found["precurvature_profile"] = error(zero, bend=np.hypot(*bounds.varied[:, 0]))
    return found


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
    s = _t * length[:, None, None]
    section = (s[..., None] >= ends[:, :, None, :]).sum(axis=-1)
    present = section < ends.shape[2]
    section = np.minimum(section, ends.shape[2] - 1)
    if arrays.degree:  # of what is pushed out of the base too, the piece that it continues
        rod = np.arange(ends.shape[1])[:, None]
        section = section + (arrays.end[np.arange(len(arrays.end))[:, None, None], rod, section] == 0)
    every = (np.arange(len(arrays.end))[:, None, None], np.arange(ends.shape[1])[:, None], section)
    material = arrays.material[every]
    EI = material[..., :2] * present[..., None]
    unit = EI.max(axis=-1)[:, :, 0].sum(axis=1)[:, None]
    with np.errstate(divide="ignore"):
        bending = unit / EI.min(axis=-1).sum(axis=1)
        least = unit / material[:, 0, :, :3].min(axis=-1)
    moment_unit = unit[:, 0] / length
    torsion = material[..., 5] * present * unit[:, None]
    behind = np.zeros(ends.shape[:2])
    if transmission:
        behind = _behind(arrays, translation) * moment_unit[:, None]
    mean, varied = _precurvature(arrays, every, s - translation[:, :, None])
    size = length[:, None, None]
    curved = EI.max(axis=-1) / unit[:, None] * np.linalg.norm(mean[..., :2], axis=-1) * size
    departs = np.stack([np.linalg.norm(varied[..., :2], axis=-1), np.abs(varied[..., 2])]) * size * present
    compliance = material[:, 0, :, 6:9] * unit[:, :, None] / length[:, None, None] ** 2
    loads = _loads(own, material[..., 9] * present, unit[:, 0], length)
    measured = 0.0
    if "tip_curvature" in own.given:
        gap = np.linalg.norm(own.tip_curvature - arrays.precurvature[:, 0, -1, :3], axis=-1)
        measured = float((gap / moment_unit * material[:, 0, -1, :3].max(axis=-1)).max())
    stiffness = EI.max(axis=-1) / unit[:, None]
    curved = curved + stiffness * departs[0]
    return Envelope(
        loads=loads,
        measured=measured,
        bending=bending.max(axis=0),
        least=least.max(axis=0),
        torsion=torsion.max(axis=0),
        transmission=behind.max(axis=0),
        anisotropy=((EI.max(axis=-1) - EI.min(axis=-1)) / unit[:, None]).max(axis=0),
        shear=compliance.max(axis=-1).max(axis=0),
        shear_anisotropy=np.abs(compliance[..., 0] - compliance[..., 1]).max(axis=0),
        curved=curved.max(axis=0),
        varied=departs.max(axis=1),
        stiffness=stiffness.max(axis=0),
        furthest=(ends[..., -1] >= length[:, None] - 1e-12).any(axis=0),
    )


def _behind(arrays: RodArrays, translation: FloatArray) -> FloatArray:
    """Compliance in torsion of each rod behind the plate [1/(N m)], shape (instances, n)."""
    stops = np.minimum(arrays.end, -translation[:, :, None])
    starts = np.concatenate([np.zeros_like(stops[..., :1]), stops[..., :-1]], axis=-1)
    return np.asarray((np.maximum(stops - starts, 0.0) * arrays.material[..., 5]).sum(axis=-1))


def _precurvature(arrays: RodArrays, every: tuple[IntArray, ...], x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean of ``u*`` over the piece at arclengths ``x`` of the rods, and how far it is from that [1/m], (instances, n, NODES, 3)."""
    coefficients = arrays.precurvature[every]
    coefficients = coefficients.reshape(*coefficients.shape[:-1], arrays.degree + 1, 3)
    if arrays.degree == 0:
        return coefficients[..., 0, :], np.zeros_like(coefficients[..., 0, :])
    powers = np.arange(arrays.degree + 1)
    mean = (coefficients * ((powers % 2 == 0) / (powers + 1))[:, None]).sum(axis=-2)
    ends = arrays.end[every]
    starts = np.concatenate([np.zeros_like(arrays.end[..., :1]), arrays.end[..., :-1]], axis=-1)[every]
    with np.errstate(divide="ignore", invalid="ignore"):
        local = np.clip(np.nan_to_num((2 * x - starts - ends) / (ends - starts)), -1, 1)
    value = (coefficients * (local[..., None] ** powers)[..., None]).sum(axis=-2)
    return mean, value - mean


def _loads(own: Inputs, density: FloatArray, unit: FloatArray, length: FloatArray) -> dict[str, FloatArray]:
    """Magnitudes of the loads that act, dimensionless, the largest of all instances."""
    force, result = unit / length**2, {}
    for name in LOADS:
        if not own.is_active(name):
            continue
        scale = force
        if name in ("tip_moment", "follower_moment"):
            scale = force * length
        elif name == "distributed_force":
            scale = force / length
        profile = own.profile(name)
        if profile is not None:
            size = max(float(np.linalg.norm(profile(s))) for s in np.linspace(0, profile.ends[-1], SAMPLES))
            value = np.full(1, size)[:, None]
        else:
            value = np.linalg.norm(getattr(own, name), axis=-1)[:, None]
        if name == "gravity":
            value = value * density.sum(axis=1) / (force / length)[:, None]
        else:
            value = value / scale[:, None]
        result[name] = np.broadcast_to(value.max(axis=0), NODES if name in ALONG else 1)
    return result
