"""A progress bar for what takes long."""

import sys
from collections.abc import Callable
from html import escape
from importlib import import_module
from threading import Lock
from time import monotonic
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from multirod.validation import refuse

if TYPE_CHECKING:
    from rich.progress import Progress

PATIENCE = 2.0  # seconds before a bar is worth showing
REFRESH = 0.2  # seconds between two states of a bar in a notebook


class Watch:
    """Counts what is done, and once it has taken two seconds shows it by a bar on a terminal or in a notebook, or tells a
    function.

    Args:
        label: What is counted.
        total: How many there are.
        progress: Whether to show a bar, or a function that is called with the number done.
        shares: Calls of ``advance`` that make up one of those counted.

    Raises:
        ValueError: If ``progress`` is neither.
    """

    def __init__(self, label: str, total: int, progress: bool | Callable[[int], Any], shares: int = 1) -> None:
        if not isinstance(progress, bool) and not callable(progress):
            refuse("progress", progress, "must be True, False or a function of the number done")
        self._label, self._total, self._shares = label, total, shares
        self._tell = progress if callable(progress) else None
        self._wanted = progress is True
        self._bar: Any = None
        self._begin = monotonic()
        self._done = 0
        self._lock = Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.stop()

    def begin(self, done: int) -> None:
        """Say what was done before."""
        self._done = done * self._shares
        if self._tell is not None:
            self._tell(done)

    def count(self, done: int) -> None:
        """Note that one more is to be done, with 0, or is done, with 1: where the total is not known before; on any thread."""
        if not done:
            with self._lock:
                self._total += 1
                if self._bar is not None:
                    self._bar.update(self._bar.task_ids[0], total=self._total)
        self.advance(done)

    def advance(self, count: int = 1) -> None:
        """Note that so many more shares are done; on any thread."""
        with self._lock:
            before, self._done = self._done // self._shares, self._done + count
            done = self._done // self._shares
            if self._tell is not None and done > before:
                self._tell(done)
            if self._wanted and self._bar is None and monotonic() - self._begin > PATIENCE:
                self._bar = _bar(self._label, self._total)
                self._wanted = self._bar is not None
            if self._bar is not None:
                self._bar.update(self._bar.task_ids[0], completed=done)


def _bar(label: str, total: int) -> "Progress | _NotebookBar | None":
    """A bar in a notebook, or on the terminal of the standard error stream; None where neither is."""
    if in_notebook():
        return _NotebookBar(label, total)
    return _terminal_bar(label, total)


def in_notebook() -> bool:
    """Whether a kernel runs this, whose front end draws what is displayed."""
    shell = sys.modules.get("IPython")
    running = None if shell is None else shell.get_ipython()
    return hasattr(running, "kernel")


class _NotebookBar:
    """A bar of plain HTML below the cell, drawn anew at most five times a second, gone in the end; calls are those of rich's."""

    task_ids = (0,)

    def __init__(self, label: str, total: int) -> None:
        self._label, self._total, self._done = label, total, 0
        self._page: Any = import_module("IPython.display")
        self._drawn = monotonic()
        self._handle = self._page.display(self._page.HTML(self._text()), display_id=True)

    def update(self, task: int, *, completed: int | None = None, total: int | None = None) -> None:
        self._done = self._done if completed is None else completed
        self._total = self._total if total is None else total
        if monotonic() - self._drawn > REFRESH:
            self._drawn = monotonic()
            self._handle.update(self._page.HTML(self._text()))

    def stop(self) -> None:
        self._handle.update(self._page.HTML(""))

    def _text(self) -> str:
        bar = f'<progress value="{self._done}" max="{self._total}"></progress>'
        return f"<small>{escape(self._label)} {bar} {self._done:,}/{self._total:,}</small>"


def _terminal_bar(label: str, total: int) -> "Progress | None":
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        return None
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
    bar.add_task(label, total=total)
    bar.start()
    return bar
