"""Studies of one robot, of each instance of a batch."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.batch import broadcast_shapes
from multirod.inputs import Inputs
from multirod.results.solution import IncompleteWarning, Solution, SolveError
from multirod.types import Numbers
from multirod.validation import Described, refuse
from multirod.warning import warn


class Instance:
    """One instance of a batch: its share of what has leading axes.

    Attributes:
        said: What messages about it begin with.
    """

    def __init__(self, place: tuple[int, ...]) -> None:
        self._place = place
        self.said = f"instance {place[0] if len(place) == 1 else place}: "

    def own(self, batch_shape: tuple[int, ...]) -> tuple[int, ...]:
        """Its index in what has these leading axes."""
        last = self._place[len(self._place) - len(batch_shape) :]
        return tuple(0 if size == 1 else k for k, size in zip(last, batch_shape, strict=True))

    def of(self, given: Any) -> Any:  # noqa: ANN401  (a robot, inputs, a solution)
        """Its own of what has a ``batch_shape``."""
        return given[self.own(given.batch_shape)] if given.batch_shape else given

    def guess(self, given: Solution[Any] | Numbers | None) -> Solution[Any] | Numbers | None:
        """Its own of guesses."""
        if given is None or isinstance(given, Solution):
            return None if given is None else self.of(given)
        values = np.asarray(given)
        return values[self.own(values.shape[:-1])] if 1 < values.ndim <= 1 + len(self._place) else given


def leading_axes(robot: Assembly, inputs: Inputs, start: Inputs, guess: Solution[Any] | Numbers | None) -> tuple[int, ...]:
    """Those of a robot, its inputs and what they begin at.

    Raises:
        ValueError: If they do not broadcast, or those of a guess to them.
    """
    whole = broadcast_shapes(robot.batch_shape, inputs.batch_shape)
    shapes = {"start": start.batch_shape}
    if guess is not None:
        shapes["guess"] = guess.batch_shape if isinstance(guess, Solution) else np.asarray(guess).shape[:-1]
    for name, own in shapes.items():
        try:
            together = broadcast_shapes(whole, own)
        except ValueError:
            together = None
        if together is None or (name == "guess" and together != whole):
            refuse(name, Described(f"leading axes {own}"), f"must broadcast to those of robot and inputs, {whole}")
        whole = together
    return whole


def of_each(what: str, batch_shape: tuple[int, ...], study: Callable[[Instance], object]) -> NDArray[np.object_]:
    """What ``study`` finds of each instance of a batch, an array with its leading axes; None where it raises ``SolveError``, as a
    warning says."""
    result = np.empty(batch_shape, dtype=object)
    lost: list[str] = []
    for place in np.ndindex(result.shape):
        instance = Instance(place)
        try:
            result[place] = study(instance)
        except SolveError as error:
            lost.append(f"{instance.said}{error}")
    if lost:
        warn(f"{what} of {len(lost)} of {result.size} instances were not found, they are None; {lost[0]}", IncompleteWarning)
    return result
