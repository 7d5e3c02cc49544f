"""Forces and moments measured where a rod is held, or along it. Numbers in parentheses: ``docs/estimation.md``."""

from typing import ClassVar

import numpy as np

from multirod.naming import hinted
from multirod.tasks.deviations import deviations
from multirod.tasks.rows import vector
from multirod.types import Numbers
from multirod.validation import Described, FloatArray, nonnegative_float, refuse

PARTS = ("force", "moment")
UNITS = ("the force [N]", "the moment [N m]")


class ForceTorque:
    """Force and moment measured where a rod is held, or between two parts of it: a load cell, or a six-axis sensor.

    What lies beyond the sensor exerts on what lies before it, in the axes of the world, about where the sensor is; at a base
    what ``solution.wrench(rod)`` says. Tubes in each other, and lines, count together. What a sensor says in its own axes, turn
    before: ``R @ force``; what it says about another point ``c``, ``moment + cross(c - p, force)``.

    Args:
        force: [N], shape (..., 3), or None of a sensor of moments alone.
        moment: About the place [N m], shape (..., 3), or None of a sensor of forces alone.
        sigma: Standard deviations: of the force [N] and of the moment [N m], a pair, or one of these where only one is given.
            Each is one number, or three along the axes of the world.
        rod: Index or name of the rod; not needed where a robot is one rod, or tubes in each other, whose first it is.
        at: Arclength along it [m], as ``solution.rod(k).arclength``; at the base by default.

    Raises:
        ValueError: If neither is given, ``sigma`` is not > 0, ``at`` is < 0, or leading axes do not broadcast.
    """

    quantity: ClassVar = "wrench"

    @hinted("its parts are named, of a wrench w ForceTorque(force=w.force, moment=w.moment, sigma=(0.05, 1e-3))")
    def __init__(
        self,
        *,
        force: Numbers | None = None,
        moment: Numbers | None = None,
        sigma: Numbers,
        rod: int | str | None = None,
        at: float = 0.0,
    ) -> None:
        if force is None and moment is None:
            raise ValueError("ForceTorque needs a force, a moment, or both")
        given = {name: value for name, value in zip(PARTS, (force, moment), strict=True) if value is not None}
        self._names = tuple(given)
        self.says = ", ".join(self._names)
        self.at = np.array([nonnegative_float("ForceTorque.at", at)])
        self.rod = rod
        self.first = 0 if force is not None else 3  # of its components among those of the quantity
        self.value = self._joined({name: vector(f"ForceTorque.{name}", value) for name, value in given.items()}, "ForceTorque")
        self.batch_shape = self.value.shape[:-2]
        units = [unit for name, unit in zip(PARTS, UNITS, strict=True) if name in given]
        self.sigma = deviations("ForceTorque.sigma", sigma, [(unit, 3, True) for unit in units])

    @property
    def count(self) -> int:
        """Rows."""
        return int(self.value.shape[-1])

    @property
    def places(self) -> FloatArray:
        """Where it is along its rod [m], shape (1,)."""
        return self.at

    def joined(self, field: str, value: object) -> object:
        """What it says at a sample, (..., 1, components); or one NaN for all."""
        if isinstance(value, float) and np.isnan(value):
            return value
        parts = (value,) if len(self._names) == 1 else value
        if not isinstance(parts, (list, tuple, np.ndarray)) or len(parts) != len(self._names):
            refuse(field, value, f"must be ({self.says})")
        return self._joined({name: vector(f"{field}, {name}", own) for name, own in zip(self._names, parts, strict=True)}, field)

    def _joined(self, parts: dict[str, FloatArray], field: str) -> FloatArray:
        """Force and moment beside each other, (..., 1, components)."""
        try:
            return np.concatenate(np.broadcast_arrays(*parts.values()), axis=-1)[..., None, :]
        except ValueError:
            refuse(field, Described(f"leading axes {[value.shape[:-1] for value in parts.values()]}"), "must broadcast")

    def __repr__(self) -> str:
        rod = "" if self.rod is None else f" of rod {self.rod!r}"
        return f"ForceTorque({self.says} at {self.at[0]:g} m{rod}; batch {self.batch_shape})"
