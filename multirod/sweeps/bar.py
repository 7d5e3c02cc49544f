"""A progress bar on whatever takes longer than two seconds."""

from threading import Timer
from types import TracebackType
from typing import Any, Self

DELAY = 2.0  # [s]


class Bar:
    """Shows how many instances are done, on a terminal only.

    Args:
        total: Instances.
        console: Standard error by default.
    """

    def __init__(self, total: int, console: Any = None) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(stderr=True) if console is None else console
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=console, transient=True)
        self._visible: bool = console.is_terminal
        self._task = self._progress.add_task("sweep", total=total)
        self._timer = Timer(DELAY, self._progress.start)
        self._timer.daemon = True

    def __call__(self, done: int) -> None:
        """Show that so many instances are done."""
        self._progress.update(self._task, completed=done)

    def __enter__(self) -> Self:
        if self._visible:
            self._timer.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._visible:
            self._timer.cancel()
            self._timer.join()
            self._progress.stop()
