"""Legs of concentric tubes for ``LegEnergy``: one centreline, an angle of each tube, twist behind the plate.

Nothing of the package is used.
"""

from dataclasses import dataclass

import numpy as np
from leg_energy import Leg
from relaxation import rotation


@dataclass
class TubeOnNodes:
    """One tube on the first segments of a leg.

    ``stiffness`` and ``rest`` are of its segments, (segment, 3); ``turned`` is the angle that is given at its base, ``give`` how
    far it twists behind the plate under a torque of one, ``angle`` its angle from the leg's first tube at its nodes, (node,).
    """

    stiffness: np.ndarray
    rest: np.ndarray
    turned: float
    give: float
    angle: np.ndarray

    @property
    def reach(self) -> int:
        return len(self.rest)


@dataclass
class TubeLeg(Leg):
    """Concentric tubes whose first one reaches the tip: frames are its frames, ``nodes`` where these stand, over the length.

    ``stiffness`` and ``rest`` of ``Leg`` are not used. Where a tube twists behind the plate its angle there is free, held by a
    spring; that of the first turns the frame at the base.
    """

    nodes: np.ndarray
    tubes: list[TubeOnNodes]

    def __post_init__(self) -> None:
        super().__post_init__()
        self.h = self.length * np.diff(self.nodes)
        self.weight = 0.5 * (np.append(self.h, 0.0) + np.append(0.0, self.h))
        self.others = self.tubes[1:]
        start = self.base[:3, :3].T @ self.frames[0]
        self.begun = _turns(np.arctan2(start[1, 0], start[0, 0]), self.tubes[0].turned)
        for tube in self.others:
            tube.angle += _turns(tube.angle[0], tube.turned - self.begun) - tube.angle[0]
            self._hold(tube)

    @property
    def size(self) -> int:
        free = sum(tube.give > 0 for tube in self.tubes)
        return 3 * self.count + free + sum(tube.reach for tube in self.others)

    @property
    def variables(self) -> np.ndarray:
        result, at = [super().variables], 3 * self.count
        if self.tubes[0].give > 0:
            result[0][0, 2] = at
            at += 1
        for tube in self.others:
            own = np.full(self.count + 1, -1)
            free = slice(0 if tube.give > 0 else 1, tube.reach + 1)
            own[free] = at + np.arange(free.stop - free.start)
            at += free.stop - free.start
            ends = np.stack([own[:-1], own[1:]], axis=1)
            ends[tube.reach :] = -1
            result.append(ends)
        return np.concatenate(result, axis=1)

    def curved(self, turns: np.ndarray) -> np.ndarray:
        axis = self.base[:3, 2]
        first = turns[..., :6].copy()
        first[..., 0, :3] = axis * turns[..., 0, 2, None]  # at the base it turns about the leg alone
        return super().curved(first)

    def bent(self, turns: np.ndarray) -> np.ndarray:
        u, begun = self.curved(turns), self.begun + turns[..., 0, 2]
        first = self.tubes[0]
        energy = 0.5 * self.h * ((u - first.rest) ** 2 * first.stiffness).sum(axis=-1)
        if first.give > 0:
            energy[..., 0] += 0.5 / first.give * (begun - first.turned) ** 2
        for k, tube in enumerate(self.others):
            n = tube.reach
            start = turns[..., :n, 6 + 2 * k] + tube.angle[:-1]
            end = turns[..., :n, 7 + 2 * k] + tube.angle[1:]
            if tube.give > 0:
                energy[..., 0] += 0.5 / tube.give * (begun + start[..., 0] - tube.turned) ** 2
            else:
                start[..., 0] = tube.turned - begun
            angle, rate = 0.5 * (start + end), (end - start) / self.h[:n]
            c, s, x, y = np.cos(angle), np.sin(angle), u[..., :n, 0], u[..., :n, 1]
            own = np.stack([c * x + s * y, c * y - s * x, u[..., :n, 2] + rate], axis=-1)
            energy[..., :n] += 0.5 * self.h[:n] * ((own - tube.rest) ** 2 * tube.stiffness).sum(axis=-1)
        return energy

    def move(self, step: np.ndarray) -> None:
        super().move(step)
        at = 3 * self.count
        if self.tubes[0].give > 0:
            self.begun += step[at]
            self.frames[0] = rotation(self.base[:3, 2] * step[at]) @ self.frames[0]
            at += 1
        for tube in self.others:
            held = 0 if tube.give > 0 else 1
            tube.angle[held:] += step[at : at + tube.reach + 1 - held]
            at += tube.reach + 1 - held
            self._hold(tube)

    def _hold(self, tube: TubeOnNodes) -> None:
        """At its base, where it does not twist behind the plate."""
        if tube.give == 0:
            tube.angle[0] = tube.turned - self.begun


def _turns(angle: float, near: float) -> float:
    """An angle by as many whole turns more as lead nearest."""
    return angle + 2 * np.pi * np.round((near - angle) / (2 * np.pi))
