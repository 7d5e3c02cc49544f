"""Objects that work in buffers of their own: never copied, and one thread at a time."""

from threading import RLock
from typing import ClassVar, NoReturn


class Uncopied:
    """What cannot be copied: a copy would work in the same buffers, or write to the same file.

    Attributes:
        instead: What to do in place of a copy, for the error.
    """

    instead: ClassVar[str]

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        """Refuse ``copy.copy``, ``copy.deepcopy`` and ``pickle``, by a ``TypeError``."""
        raise TypeError(
            f"a {type(self).__name__} cannot be copied or pickled, a copy would share what it works on: {self.instead}"
        )


class Exclusive:
    """A lock that no thread waits for: while one holds it, others are refused.

    Waiting would order the threads but not what they mean: each counts on the state that its own last call left. The thread that
    holds it may take it again.

    Args:
        refusal: What the ``RuntimeError`` says: what is in use, and what to do.
    """

    def __init__(self, refusal: str) -> None:
        self._lock = RLock()
        self._refusal = refusal

    def __enter__(self) -> None:
        if not self._lock.acquire(False):
            raise RuntimeError(self._refusal)

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self._lock.release()
