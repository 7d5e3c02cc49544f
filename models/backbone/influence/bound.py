"""What dropping a term of a backbone's equations does to its tip, bounded before anything is solved.

The bound and its derivation are ``docs/explain.md``; numbers in parentheses are its.
"""

from dataclasses import dataclass, field
from math import inf

import numpy as np

from multirod.inputs import Inputs
from multirod.models.backbone.influence.envelope import FORCES, FROM_BASE, NODES, TO_TIP, Envelope, envelopes
from multirod.models.backbone.inputs import LOADS
from multirod.rod import RodArrays
from multirod.validation import FloatArray

MOMENTS_PER_LENGTH = tuple(spec.name for spec in LOADS if spec.acts == "along" and spec.load == "moment")
ROUNDING = 1 + 1 / (2 * NODES**2)  # what the midpoint rule may lack
WHOLE = np.full(NODES, 1 / NODES)  # integrates over the length
ZERO = np.zeros(NODES)
FROM_BASE_AND_TIP = np.vstack([FROM_BASE, WHOLE])  # and from the base to the tip, whose twist turns what follows it


@dataclass(frozen=True)
class Influence:
    """What dropping one term does.

    Attributes:
        group: The dimensionless group that governs it (1), the largest of all instances.
        error: Bound of the tip's change over the length in use (13); ``inf`` where none is known.
        amplification: How many times more that is than without other loads and couplings.
        estimated: Whether ``error`` is an estimate that may be too small, and no bound.
    """

    group: float
    error: float
    amplification: float
    estimated: bool = False

    def joined(self, other: "Influence") -> "Influence":
        """The larger of both."""
        return Influence(*(max(a, b) for a, b in zip(vars(self).values(), vars(other).values(), strict=True)))


@dataclass(frozen=True)
class Source:
    """What dropping a term does by itself, before anything answers; the table of ``docs/explain.md``.

    Attributes:
        moment: Change of the moment, shape (NODES,).
        stretch: Change of ``v``.
        bend: Change of the curvature at a given moment.
        torque: Change of the rate of each rod's torque, shape (n, NODES).
        tip_torque: Change of the torque at the tip.
        twist: Change of the twist of each rod at a given torque, at nodes and at the tip, shape (n, NODES + 1).
    """

    moment: FloatArray = field(default_factory=ZERO.copy)
    stretch: FloatArray = field(default_factory=ZERO.copy)
    bend: FloatArray = field(default_factory=ZERO.copy)
    torque: FloatArray | None = None
    tip_torque: float = 0.0
    twist: FloatArray | None = None


def influences(arrays: RodArrays, inputs: Inputs, batch_shape: tuple[int, ...], *, transmission: bool) -> dict[str, Influence]:
    """The largest relative change of the tip's position that dropping each term makes, over all instances."""
    found: dict[str, Influence] = {}
    for envelope in envelopes(arrays, inputs, batch_shape, transmission=transmission):
        groups = envelope.groups
        systems = [Comparison(envelope, len(envelope.curved))]
        if len(envelope.curved) == 1:
            systems.append(Comparison(envelope, 0))
        for name in systems[0].sources:
            error, free = min(system.tip(system.sources[name]) for system in systems)
            own = Influence(groups[name], error, error / free if free > 0 else 1.0)
            found[name] = own.joined(found.get(name, own))
    return found


class Comparison:
    """The linear system (6) to (11) whose solution bounds the change of an equilibrium.

    Its unknowns are bounds of how fast the rods turn, and of how far each of them twists. With ``rods`` 0 a single rod's twist is
    not told from its bending.

    Attributes:
        sources: Of each term that may be dropped.
    """

    def __init__(self, bounds: Envelope, rods: int) -> None:
        self._bounds, self._rods = bounds, rods
        self._force = force = bounds.force()
        self._across = bounds.shear_anisotropy if len(bounds.curved) == 1 and rods else ZERO
        self._compliance = bounds.bending if rods else bounds.least
        self._stretched = 1 + bounds.shear * force
        self._arm = 1 + 2 * bounds.shear * force  # (6)
        self._moment_per_length = ZERO + sum(bounds.loads.get(name, 0.0) for name in MOMENTS_PER_LENGTH)
        self._dead = self._at_tip("tip_moment")
        self._following = self._at_tip("follower_moment") + bounds.measured
        self._moment = TO_TIP @ (self._stretched * force + self._moment_per_length) + self._dead + self._following
        curved = bounds.curved[:rods]
        self._curvature = self._compliance * (self._moment + curved.sum(axis=0))
        self._uneven = bounds.anisotropy[:rods]
        self._coupled = curved + self._uneven * self._curvature  # (9)
        self._own = np.where(
            self._uneven.any(axis=1, keepdims=True), self._coupled, 0.0
        )  # a rod turns itself by unequal axes alone
        self._places = [slice(start, start + NODES + 1) for start in NODES + (NODES + 1) * np.arange(rods)]
        self._twists = [
            FROM_BASE_AND_TIP @ (compliance[:, None] * TO_TIP) + behind / NODES
            for compliance, behind in zip(bounds.torsion[:rods], bounds.transmission[:rods], strict=True)
        ]  # (10)
        self._tip_twists = [
            (FROM_BASE_AND_TIP @ compliance + behind) * last
            for compliance, behind, last in zip(
                bounds.torsion[:rods], bounds.transmission[:rods], bounds.furthest[:rods], strict=True
            )
        ]
        self._weights = self._influence()
        self.sources = self._loads() | self._properties()

    @property
    def _size(self) -> int:
        return NODES + (NODES + 1) * self._rods

    def _at_tip(self, name: str) -> float:
        return float(np.max(self._bounds.loads.get(name, 0.0)))

    # ---- the system ----

    def _influence(self) -> FloatArray | None:
        """What the tip moves by for each unit of the system's right side (12); None where the system does not bound anything."""
        if len(self._bounds.curved) > 1 and "magnetic_field" in self._bounds.loads:
            return None  # it turns tubes against each other as they turn
        answers = self._answers()
        size = len(answers)
        if not np.isfinite(answers).all():
            return None
        try:
            test = np.linalg.solve(np.eye(size) - answers, np.ones(size))
        except np.linalg.LinAlgError:
            return None
        if not (test > 0).all():
            return None
        return np.asarray(np.linalg.solve((np.eye(size) - answers).T, self._effect()))

    def _effect(self) -> FloatArray:
        """(6) over the length: what the tip moves by where rods turn and twist."""
        effect = np.zeros(self._size)
        effect[:NODES] = WHOLE @ (self._arm[:, None] * FROM_BASE)
        if self._rods:
            effect[self._places[0]][:NODES] = self._force * self._across / NODES
        return effect

    def _answers(self) -> FloatArray:
        """The matrix of the system: no entry is negative."""
        force, c, places = self._force, self._compliance, self._places
        at_tip = np.ones((NODES, 1)) * WHOLE  # turns that add up at the tip
        turned = TO_TIP @ (force[:, None] * self._arm[:, None] * FROM_BASE) + self._moment[:, None] * FROM_BASE
        follower = self._at_tip("follower_force") * (TO_TIP @ self._stretched) + self._following
        turned = turned + follower[:, None] * at_tip  # (7)
        twisted = TO_TIP * (force**2 * self._across)
        uneven_shear = np.diag(force**2 * self._across)
        total = self._coupled.sum(axis=0)

        result = np.zeros((self._size, self._size))
        result[:NODES, :NODES] = c[:, None] * turned
        for k, place in enumerate(places):  # (8)
            result[:NODES, place][:, :NODES] = np.diag(c * self._coupled[k]) + (c[:, None] * twisted if k == 0 else 0.0)
            result[:NODES, place][:, NODES] = c * follower * self._bounds.furthest[k]
        for k, place in enumerate(places):  # (11)
            rate = self._coupled[k] * c
            by_turning = rate[:, None] * turned + (self._moment_per_length + force**2 * self._across)[:, None] * FROM_BASE
            result[place, :NODES] = self._twists[k] @ by_turning + np.outer(self._tip_twists[k], self._dead * WHOLE)
            for j, other in enumerate(places):
                others = total - self._coupled[k] + 3 * self._own[k]
                by_twisting = np.diag(rate * (self._moment + others if j == k else self._coupled[j]))
                if j == 0:
                    by_twisting += rate[:, None] * twisted + (uneven_shear if k == 0 else 0.0)
                result[place, other][:, :NODES] = self._twists[k] @ by_twisting
                result[place, other][:, NODES] = self._twists[k] @ (rate * follower) * self._bounds.furthest[j]
        return result

    def tip(self, source: Source) -> tuple[float, float]:
        """Bound of the tip's change by a source (13), ``inf`` where there is none, and what it is where nothing answers."""
        moment = source.moment + TO_TIP @ (self._force * source.stretch)
        right = np.zeros(self._size)
        right[:NODES] = self._compliance * moment + source.bend
        for k, place in enumerate(self._places):
            rate = self._coupled[k] * self._compliance * moment + (0.0 if source.torque is None else source.torque[k])
            right[place] = self._twists[k] @ rate + self._tip_twists[k] * source.tip_torque
            right[place] += 0.0 if source.twist is None else source.twist[k]
        direct = float(WHOLE @ source.stretch)
        if not right.any() and direct == 0:
            return 0.0, 0.0
        free = ROUNDING * (float(self._effect()[:NODES] @ right[:NODES]) + direct)
        return inf if self._weights is None else ROUNDING * (float(self._weights @ right) + direct), free

    # ---- what each term does by itself ----

    def _loads(self) -> dict[str, Source]:
        every, found = np.ones((self._rods, 1)), {}
        for name, size in self._bounds.loads.items():
            if name in FORCES:
                own, sheared = self._bounds.force((name,)), self._bounds.shear
                torque = every * (self._across * self._force * own)
                found[name] = Source(TO_TIP @ (self._stretched * own), stretch=sheared * own, torque=torque)
            elif name in MOMENTS_PER_LENGTH:
                own = ZERO + size
                found[name] = Source(TO_TIP @ own, torque=every * own)
            else:
                found[name] = Source(ZERO + size, tip_torque=self._at_tip(name))
        return found

    def _properties(self) -> dict[str, Source]:
        bounds, force = self._bounds, self._force
        shear = Source(stretch=bounds.shear * force, torque=np.ones((self._rods, 1)) * (self._across * force**2))
        if not self._rods:
            bend, twist = bounds.varied[:, 0]
            return {
                "shear": shear,
                "torsion": Source(bend=bounds.torsion[0] * self._moment),
                "anisotropy": Source(bend=bounds.uneven[0] * self._compliance * self._moment),
                "precurvature_profile": Source(bend=np.hypot(bend, twist)),
            }
        others = self._coupled.sum(axis=0) - self._coupled + self._own
        rates = self._coupled * self._compliance * (self._moment + others) + self._moment_per_length + self._across * force**2
        at_tip = bounds.furthest[:, None] * (self._dead + self._following)
        twist = (bounds.torsion * (rates @ FROM_BASE + at_tip)) @ FROM_BASE_AND_TIP.T
        twist = twist + bounds.transmission[:, None] * (rates @ WHOLE[:, None] + at_tip)
        uneven = bounds.uneven * (bounds.curved + bounds.stiffness * self._curvature)
        bend, turn = bounds.varied
        varied = bounds.stiffness * bend
        return {
            "shear": shear,
            "torsion": Source(twist=twist),
            "anisotropy": self._bent(uneven),
            "precurvature_profile": self._bent(varied, turn @ FROM_BASE_AND_TIP.T),
        }

    def _bent(self, moments: FloatArray, twist: FloatArray | None = None) -> Source:
        """Of moments by which rods are bent otherwise."""
        return Source(bend=self._compliance * moments.sum(axis=0), torque=self._curvature * moments, twist=twist)
