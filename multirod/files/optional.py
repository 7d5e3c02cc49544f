"""Packages that only some files need."""

from importlib import import_module
from types import ModuleType


def optional(module: str, extra: str, purpose: str) -> ModuleType:
    """A module of a package that need not be installed.

    Raises:
        ImportError: If it is not; the message says which extra brings it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0]:
            raise
        raise ImportError(f'{purpose} need {error.name}: pip install "multirod[{extra}]"') from None
