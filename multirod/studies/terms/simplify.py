"""Dropping terms that do not matter, within a bound of what all of them together may do."""

from dataclasses import dataclass

from multirod.assembly import Robot
from multirod.inputs import Inputs
from multirod.studies.terms.explanation import Explanation
from multirod.studies.terms.leaving_out import left_out
from multirod.validation import number, refuse


@dataclass(frozen=True)
class Dropped:
    """A term that ``simplify`` left out.

    Attributes:
        name: As in ``explain``.
        error: Bound of what this does to the tip's position, over the length in use, in the worst of all instances.
        why: What it rests on.
        estimated: Whether ``error`` is an estimate that may be too small, and no bound.
    """

    name: str
    error: float
    why: str
    estimated: bool = False

    def __str__(self) -> str:
        return f"{self.name} (tip error {'~' if self.estimated else '<'} {self.error:.1e} L)"


def simplified(
    robot: Robot, inputs: Inputs, bound: object, over: Inputs | None = None
) -> tuple[Robot, Inputs, tuple[Dropped, ...]]:
    """The scene without the terms that may all be dropped within ``bound``; as it is where that is None.

    Terms are taken from the least on while their sum stays below the bound. One whose absence would leave the kernel as it is, is
    kept: that would cost accuracy and save nothing. ``over`` are the inputs with all axes, where they
    are not those of ``inputs``.

    Raises:
        ValueError: If ``bound`` is not a number between 0 and 1.
    """
    if bound is None:
        return robot, inputs, ()
    limit = number("simplify", bound)
    if not 0 < limit < 1:
        refuse("simplify", bound, "must be > 0 and < 1: a bound of the tip's error over the length, or None")
    found = Explanation(robot, inputs if over is None else over)
    names = _chosen(found, limit)
    if not names:
        return robot, inputs, ()
    terms = [found[name] for name in names]
    return *left_out(robot, inputs, names), tuple(Dropped(t.name, t.error, t.reason, t.estimated) for t in terms)


def _chosen(found: Explanation, limit: float) -> list[str]:
    """Names of terms, the least first, whose errors together stay below the limit and of which each saves something."""
    candidates = sorted((term for term in found.terms if term.droppable), key=lambda term: term.error)
    while True:
        total, names = 0.0, []
        for term in candidates:
            total += term.error
            if total >= limit:
                break
            names.append(term.name)
        needless = [name for name in names if _without(found, names, name) == found.features_without(names)]
        if not needless:
            return names
        # what it leaves of the limit may serve another
        candidates = [term for term in candidates if term.name != needless[-1]]


def _without(found: Explanation, names: list[str], kept: str) -> object:
    return found.features_without([name for name in names if name != kept])
