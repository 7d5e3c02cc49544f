"""A recording inside a notebook, by Rerun's own widget."""

from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, Unpack

from multirod.recording.recorder import save
from multirod.results.history import History
from multirod.types import RecordingOptions
from multirod.validation import positive_int, refuse

INSTALL = 'a recording in a notebook needs Rerun\'s widget: pip install "multirod[notebook]"'


def show(
    history: History,
    *,
    width: int | Literal["auto"] = "auto",
    height: int | Literal["auto"] = 640,
    **options: Unpack[RecordingOptions],
) -> None:
    """Show a recording of ``history`` where a notebook's cell prints, as ``save`` would write it.

    The viewer is a web page that Rerun's widget fetches from its makers, and needs the network for. Set
    ``RERUN_NOTEBOOK_ASSET=inline`` in the environment, before Rerun is imported, to have it from the installed package.

    Args:
        history: What to show.
        width: Of the viewer [px]; ``"auto"`` is that of the cell.
        height: The same; ``"auto"`` is 9/16 of the width.
        options: For ``save``.

    Raises:
        ImportError: If Rerun's widget is not there: ``pip install "multirod[notebook]"``.
        TypeError, ValueError: If an argument is not what it must be.
    """
    try:
        import_module("rerun_notebook")
        from rerun.notebook import Viewer
    except ImportError:
        raise ImportError(INSTALL) from None
    wide, high = _pixels("show.width", width), _pixels("show.height", height)
    titled: RecordingOptions = {"name": "history", **options}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "recording.rrd"
        save(path, history, **titled)
        recording = path.read_bytes()
    viewer = Viewer(width=wide, height=high, use_global_recording=False)
    # what a stream would send bit by bit; it waits in the widget until the page is there
    viewer._viewer.send_rrd(recording)
    viewer.display()


def _pixels(field: str, value: object) -> int | Literal["auto"]:
    if value == "auto":
        return "auto"
    if isinstance(value, str):
        refuse(field, value, "must be a number of pixels, or 'auto'")
    return positive_int(field, value)
