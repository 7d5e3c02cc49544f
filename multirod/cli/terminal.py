"""What commands share: kinds of arguments, and progress."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from multirod.validation import file_path

FULL_WIDTH = 96
_UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}


def positive(text: str) -> float:
    """A finite number > 0."""
    value = float(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"{text} is not allowed: must be finite and > 0")
    return value


def nonnegative(text: str) -> float:
    """A finite number >= 0."""
    value = float(text)
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"{text} is not allowed: must be finite and >= 0")
    return value


def count(text: str) -> int:
    """An integer >= 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not allowed: must be an integer >= 1")
    return value


def duration(text: str) -> float:
    """Seconds, as a number or with a unit."""
    number = text.rstrip("abcdefghijklmnopqrstuvwxyz ")
    unit = text[len(number) :].strip() or "s"
    try:
        value = float(number) * _UNITS[unit]
    except (KeyError, ValueError):
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"{text} is not allowed: must be a duration > 0 such as 90, 60s or 2min")
    return value


def file_of(*endings: str) -> Callable[[str], Path]:
    """A kind of argument: a file with one of these endings, in a folder that exists."""

    def check(text: str) -> Path:
        try:
            return file_path("path", text, *endings)
        except ValueError as error:
            allowed = str(error).partition(" is not allowed: ")[2]
            raise argparse.ArgumentTypeError(f"{text} is not allowed: {allowed}") from None

    return check


def progress_bar(console: Console) -> Progress:
    """Bars with a description, for a terminal."""
    columns = (TextColumn("{task.description:24}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
