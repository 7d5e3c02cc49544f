"""Integers with names, as kernels, files and recordings hold them, and arrays of them."""

from enum import IntEnum
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, Self, cast

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    Integers = NDArray[np.int32]
else:
    Integers = np.ndarray


class Code(IntEnum):
    """An integer with a name. Compared with a string by ``==`` it raises ``TypeError``, where Python would say that they differ;
    so does ``if code:``, where Python would take all but the first for true, failures too.

    Equal to its name it could not be: what is equal has one hash, and it is equal to its number.
    """

    def __bool__(self) -> bool:
        kind, name = type(self).__name__, self.name
        ask = "ask its .failed, or compare it" if hasattr(self, "failed") else "compare it"
        raise TypeError(f"a {kind} is neither true nor false, and {name} would be true: {ask}, as in == mr.{kind}.{name}")

    def __str__(self) -> str:
        return self.name

    def __eq__(self, other: object) -> bool:
        if isinstance(other, str):
            self.refuse_text(other)
        return int.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        if isinstance(other, str):
            self.refuse_text(other)
        return int.__ne__(self, other)

    __hash__ = int.__hash__

    @classmethod
    def refuse_text(cls, text: str) -> NoReturn:
        """Say what is compared in the place of a string."""
        kind, name = cls.__name__, text if text in cls.__members__ else list(cls.__members__)[1]
        raise TypeError(f"a {kind} is compared with a {kind}, not with {text!r}: mr.{kind}.{name}, or its .name == {name!r}")


class Codes(Integers):
    """An array of the values of ``kind``: its elements have names, which it prints, and strings are refused as by one of them.

    Of a plain array NumPy says that no element equals a string, and a batch reads as if nothing had converged. What is computed
    from it is plain.
    """

    kind: ClassVar[type[Code]]

    @classmethod
    def of(cls, values: object) -> Self:
        """A view."""
        return np.asarray(values).view(cls)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: object, **options: Any) -> Any:  # noqa: ANN401  (as NumPy has it)
        for given in inputs:
            if isinstance(given, (str, list, tuple, np.ndarray)) and np.asarray(given).dtype.kind == "U":
                self.kind.refuse_text(str(np.asarray(given).flat[0]))
        if "out" in options:
            options["out"] = tuple(map(_plain, options["out"]))
        return getattr(ufunc, method)(*map(_plain, inputs), **options)

    def __getitem__(self, index: Any) -> Any:  # noqa: ANN401  (as NumPy has it)
        found = super().__getitem__(index)
        return self.kind(int(found)) if isinstance(found, np.int32) else found

    if not TYPE_CHECKING:  # which takes one for an array that has what one has

        def __getattr__(self, name: str) -> NoReturn:
            of_each = f": it is an array, of which each has one: [k].{name}" if hasattr(next(iter(self.kind)), name) else ""
            raise AttributeError(f"{type(self).__name__} has no {name!r}{of_each}", name=name)

    def counts(self) -> dict[Code, int]:
        """How many elements have each value, of those that there are: ``{Status.CONVERGED: 1669, Status.SNAPPED: 331}``."""
        values, counts = np.unique(self.view(np.ndarray), return_counts=True)
        return {self.kind(value): count for value, count in zip(values.tolist(), counts.tolist(), strict=True)}

    def __repr__(self) -> str:
        start = f"{type(self).__name__}("
        return f"{start}{self._listed(', ', start)})"

    def __str__(self) -> str:
        return self._listed()

    def _listed(self, separator: str = " ", prefix: str = "") -> str:
        names = {int(code): code.name for code in self.kind}

        def name(value: object) -> str:
            return names.get(int(cast(int, value)), str(value))

        return np.array2string(self.view(np.ndarray), separator=separator, prefix=prefix, formatter={"int": name})


def _plain(values: object) -> object:
    return values.view(np.ndarray) if isinstance(values, Codes) else values
