"""A study's folder: what it is of, one file a finished chunk, and who may write."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # no such locks on this system: docs/sweep.md says so
    fcntl = None  # type: ignore[assignment]

from multirod.validation import Described, refuse

FORMAT = "multirod study 1"
_PART = ".part"
_LOCK = ".lock"


class Folder:
    """Paths and atomic writes; knows nothing of what the chunks hold.

    Attributes:
        path: The folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.chunks = path / "chunks"
        self.manifest_path = path / "study.json"

    def chunk_path(self, chunk: int) -> Path:
        """The file of a chunk."""
        return self.chunks / f"{chunk:08d}.parquet"

    def finished(self) -> list[int]:
        """Chunks that are there, in order."""
        return sorted(int(path.stem) for path in self.chunks.glob("*.parquet") if path.stem.isdecimal())

    def manifest(self) -> dict[str, Any]:
        """What the study is of.

        Raises:
            ValueError: If the folder holds no study.
        """
        try:
            manifest = json.loads(self.manifest_path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            refuse("out", str(self.path), "it holds no study.json")
        except ValueError:
            manifest = None
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
            refuse("out", str(self.path), f"its study.json is not of a {FORMAT!r}")
        return manifest

    def begin(self, manifest: Mapping[str, Any]) -> None:
        """Make the folder that of a study, or make sure that it is already.

        Raises:
            ValueError: If it holds another study, or something else.
        """
        if self.manifest_path.exists():
            differences = list(_differences(self.manifest(), manifest))
            if differences:
                refuse("out", str(self.path), "it holds another study; there differ " + "; ".join(differences))
        else:
            strangers = sorted(p.name for p in self.path.iterdir() if p.name not in (_LOCK, _PART, self.chunks.name))
            strangers += [str(p.relative_to(self.path)) for p in self.chunks.glob("*")]
            if strangers:
                refuse("out", str(self.path), f"it holds no study.json, but {strangers[0]!r}: give a new or empty folder")
            self.chunks.mkdir(exist_ok=True)
            with self.written(self.manifest_path) as part:
                part.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")

    @contextmanager
    def written(self, target: Path) -> Iterator[Path]:
        """A path to write to, that becomes ``target`` when all of it is on the disk, and never otherwise."""
        part = self.path / _PART  # outside of chunks/, which holds nothing but what is whole
        try:
            yield part
            with part.open("rb+") as file:
                os.fsync(file.fileno())
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
        if os.name == "posix":  # elsewhere a folder cannot be flushed
            descriptor = os.open(target.parent, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from writing; the lock ends with the process, however that ends.

        Raises:
            RuntimeError: If another holds it.
        """
        if self.path.exists() and not self.path.is_dir():
            refuse("out", str(self.path), "must be a folder")
        self.path.mkdir(parents=True, exist_ok=True)
        # closed when a worker is started, so that no worker outlives the lock's owner with it
        with (self.path / _LOCK).open("a+", encoding="utf-8") as file:
            if fcntl is not None:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    file.seek(0)
                    owner = file.read().strip()
                    raise RuntimeError(f"{self.path} is being written by another sweep, process {owner or 'unknown'}") from None
            file.truncate(0)
            file.write(str(os.getpid()))
            file.flush()
            yield


def _differences(there: Mapping[str, Any], here: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """What two manifests differ in, by name; values that say something are shown."""
    for key in dict.fromkeys((*there, *here)):
        name, old, new = prefix + key, there.get(key), here.get(key)
        if old == new:
            continue
        if isinstance(old, dict) and isinstance(new, dict):
            if "digest" not in old:
                yield from _differences(old, new, f"{name}.")
            elif old["digest"] != new["digest"]:
                yield name + (" (its numbers)" if old["is"] == new["is"] else f" ({old['is']} there, {new['is']} here)")
        elif prefix:
            yield name + (" (only there)" if new is None else " (only here)" if old is None else "")
        else:
            yield f"{name} ({Described(old)} there, {Described(new)} here)"
