"""What does not change once it is made: robots, rods and lines, bodies and joints, inputs and results."""

from copy import copy
from functools import cached_property
from typing import Any, ClassVar, TypeVar

Thing = TypeVar("Thing")


class ReadOnly:
    """Refuses to be written to: what was computed from its numbers would not change with them.

    A public name is written once, where it is made; one that is computed never is.

    Attributes:
        written: The names that may be written once; by default any that is not there.
        instead: What to do, for the error.
    """

    written: ClassVar[frozenset[str] | None] = None
    instead: ClassVar[str]

    def __setattr__(self, name: str, value: object) -> None:
        """Refuse what is there, or computed, by an ``AttributeError``."""
        if not name.startswith("_"):
            known = self.written is None or name in self.written
            computed = isinstance(getattr(type(self), name, None), property | cached_property)
            if not known or computed or name in vars(self):
                raise AttributeError(
                    f"{type(self).__name__}.{name} = ... is not allowed: it does not change once it is made; {self.instead}",
                    name=name,
                )
        object.__setattr__(self, name, value)


def changed(thing: Thing, *, computed: tuple[str, ...] = (), **values: Any) -> Thing:  # noqa: ANN401  (of any attribute)
    """A copy with other values in the place of some, without what was ``computed`` from these."""
    result = copy(thing)
    for name in computed:
        vars(result).pop(name, None)
    vars(result).update(values)
    return result
