"""What happened to a robot on its way: where its branch of equilibria ended, and where it went."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray
from multirod.status import Status
from multirod.validation import FloatArray, frozen

STILL = 1e-9  # m: a tip that is held moves by rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class BranchEvent:
    """A branch of equilibria ended on the way, and the robot went on elsewhere (``docs/branches.md``).

    Attributes:
        status: ``BIFURCATED``, or ``SNAPPED``.
        fold: Whether the load had a maximum there (a limit point); else another branch crosses (a bifurcation).
        load_factor: Of the full load, at which it happened; NaN in a motion.
        progress: Part of the way from the inputs of the last sample that has a result; NaN where loads are raised.
        time: In a history, when that was, as inputs change evenly between samples [s]; else NaN.
        energy_lost: Potential energy of the equilibrium that was left, less that of the one it came to, at the same inputs [J]:
            0 at a bifurcation, else NaN while joints are closed, before any load acts (load factor 0).
        tip_displacement: Of the end effector, from the one to the other, in the world [m], shape (3,); at a bifurcation, the
            unit vector along which it begins to move, (5) of ``docs/branches.md``; zero if that is held.
        rod_displacement: At a bifurcation where that is held, the unit vector in the world along which the place of a rod that
            moves the most begins to move, shape (3,); else zero. The twin, ``Shooting(side=...)``, goes the other way.
        tip_travel: How far the end effector is from where it was at the event, at the next one or at the end of the solve, or of
            the sample, in which it happened [m]; NaN where that is not told. After a bifurcation it moves on steadily.
        neutral: Modes that symmetry leaves neutral where it came to: it might stand anywhere along these.
    """

    status: Status
    fold: bool
    load_factor: float
    progress: float
    energy_lost: float
    tip_displacement: FloatArray
    neutral: int = 0
    time: float = np.nan
    rod_displacement: FloatArray = field(default_factory=lambda: np.zeros(3))
    tip_travel: float = np.nan

    def __post_init__(self) -> None:
        for name in ("tip_displacement", "rod_displacement"):
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name))))

    def __repr__(self) -> str:
        return f"BranchEvent({self.said})"

    @property
    def said(self) -> str:
        """The same in words."""
        where = f"load factor {self.load_factor:.6g}"
        if not np.isnan(self.progress):
            where = f"{self.progress:.3g} of the way" if np.isnan(self.time) else f"{self.time:.6g} s"
        what = f"{self.status.name} at a {'fold' if self.fold else 'bifurcation'}, {where}"
        if self.status is Status.BIFURCATED:
            since = f", tip moved {self.tip_travel:.3g} m since" if self.tip_travel > STILL else ""
            if self.tip_displacement.any():
                return f"{what}, tip along {_components(self.tip_displacement)}{since}"
            if self.rod_displacement.any():
                return f"{what}, rod along {_components(self.rod_displacement)}, its twin against it{since}"
            return f"{what}{since}"
        lost = "as joints were closed" if np.isnan(self.energy_lost) else f"{self.energy_lost:.3g} J lost"
        return f"{what}, {lost}, tip moved {np.linalg.norm(self.tip_displacement):.3g} m"


def _components(direction: FloatArray) -> str:
    return f"({', '.join(f'{x:.3f}' for x in np.round(direction, 3) + 0.0)})"


Events = dict[int, tuple[BranchEvent, ...]]


def taken_events(events: Events, instances: IntArray) -> Events:
    """Those of the instances with these numbers, (k,), by their places among them."""
    return {place: events[int(k)] for place, k in enumerate(instances) if int(k) in events} if events else {}


def placed_events(events: Events, instances: IntArray) -> Events:
    """The reverse: by the numbers of instances, (k,), whose places among them were the keys."""
    return {int(instances[place]): own for place, own in events.items()}


def timed_events(events: Events, time: FloatArray, failed: NDArray[np.bool_]) -> Events:
    """Events of samples, numbered as those of ``failed`` (sample_count, k), with their times."""
    result: Events = {}
    count = failed.shape[1] if failed.size else 1
    for place, own in events.items():
        sample, instance = divmod(place, count)
        good = np.flatnonzero(~failed[:sample, instance])
        before = float(time[good[-1]] if len(good) else time[sample])
        result[place] = tuple(replace(event, time=before + event.progress * (float(time[sample]) - before)) for event in own)
    return result


def joined_events(events: Events) -> dict[str, NDArray[Any]]:
    """Events of all instances as arrays, one after another."""
    every = [(instance, event) for instance, own in events.items() for event in own]
    names = [own.name for own in fields(BranchEvent)]
    columns = {name: np.array([getattr(event, name) for _, event in every]) for name in names}
    return {"instances": np.array([instance for instance, _ in every]), **columns}


def separate_events(joined: Mapping[str, NDArray[Any]]) -> Events:
    """The reverse."""
    result: Events = {}
    for k, instance in enumerate(joined["instances"].tolist()):
        event = BranchEvent(
            status=Status(int(joined["status"][k])),
            fold=bool(joined["fold"][k]),
            neutral=int(joined["neutral"][k]),
            tip_displacement=joined["tip_displacement"][k],
            rod_displacement=joined["rod_displacement"][k] if "rod_displacement" in joined else np.zeros(3),
            tip_travel=float(joined["tip_travel"][k]) if "tip_travel" in joined else np.nan,
            **{name: float(joined[name][k]) for name in ("load_factor", "progress", "energy_lost", "time")},
        )
        result[instance] = (*result.get(instance, ()), event)
    return result
