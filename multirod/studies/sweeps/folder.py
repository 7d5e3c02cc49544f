"""A study's folder: what it is of, one file a finished chunk, and who may write."""

import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from hashlib import blake2b
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # no such locks on this system: docs/sweep.md says so
    fcntl = None  # type: ignore[assignment]

from multirod.files.whole import written
from multirod.validation import Described, refuse

FORMAT = "multirod study 2"  # 1 had no checksums
_CHUNK = re.compile(r"(\d{8,})-([0-9a-f]{32})\.parquet")
_PART = ".part"
_LOCK = ".lock"


class Broken(RuntimeError):
    """A file does not hold what was written; the message names it."""


class Folder:
    """Paths, checksums and atomic writes; knows nothing of what the chunks hold.

    A chunk's file has its checksum in its name: both are there by one rename, or neither is. The checksum is keyed by that of the
    manifest, so that a chunk of another study is not taken for one of this.

    Args:
        path: The folder.
        field: What errors call it.

    Attributes:
        path: The folder.
    """

    def __init__(self, path: Path, field: str = "out") -> None:
        self.path = path
        self._field = field
        self.chunks = path / "chunks"
        self.manifest_path = path / "study.json"
        self._key: bytes | None = None
        self._checked: dict[Path, tuple[tuple[int, ...], bool]] = {}

    def present(self) -> dict[int, Path]:
        """Files of chunks, whole or not, by their numbers in order."""
        named = ((path, _CHUNK.fullmatch(path.name)) for path in sorted(self.chunks.glob("*.parquet")))
        return {int(match[1]): path for path, match in named if match}

    def finished(self) -> list[int]:
        """Chunks that are there as they were written, in order; a file is read again only where it has changed."""
        return [chunk for chunk, path in self.present().items() if self._is_whole(path)]

    def read(self, path: Path) -> bytes:
        """What a chunk's file holds.

        Raises:
            Broken: If it is not what was written.
        """
        content = path.read_bytes()
        match = _CHUNK.fullmatch(path.name)
        if match is None or self._checksum(int(match[1]), content) != match[2]:
            raise Broken(
                f"{path} is broken: its checksum is not that in its name; the same sweep again redoes it, and nothing else"
            )
        return content

    def keep(self, chunk: int, content: bytes) -> None:
        """Write a chunk's file, as a whole or not at all."""
        with self.written(self.chunks / f"{chunk:08d}-{self._checksum(chunk, content)}.parquet") as part:
            part.write_bytes(content)

    def remove_broken(self) -> dict[int, Path]:
        """Remove files of chunks that are not what was written; returns them by their numbers."""
        broken = {chunk: path for chunk, path in self.present().items() if not self._is_whole(path)}
        for path in broken.values():
            path.unlink(missing_ok=True)
        return broken

    def _is_whole(self, path: Path) -> bool:
        try:
            found = path.stat()
        except FileNotFoundError:  # a sweep has just removed it
            return False
        identity = found.st_ino, found.st_mtime_ns, found.st_size
        known = self._checked.get(path)
        if known is None or known[0] != identity:
            try:
                self.read(path)
                known = identity, True
            except Broken:
                known = identity, False
            self._checked[path] = known
        return known[1]

    def _checksum(self, chunk: int, content: bytes) -> str:
        if self._key is None:
            self._key = bytes.fromhex(self.manifest()["checksum"])
        return blake2b(content, digest_size=16, key=self._key, salt=chunk.to_bytes(8, "little")).hexdigest()

    def manifest(self) -> dict[str, Any]:
        """What the study is of.

        Raises:
            ValueError: If the folder holds no study, or its ``study.json`` is not what was written.
        """
        try:
            manifest = json.loads(self.manifest_path.read_text(encoding="utf-8"))
        except (FileNotFoundError, NotADirectoryError):
            refuse(self._field, str(self.path), "it holds no study.json")
        except ValueError:
            manifest = None
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
            refuse(self._field, str(self.path), f"its study.json is not of a {FORMAT!r}")
        if manifest.get("checksum") != _sealed(manifest)["checksum"]:
            refuse(self._field, str(self.path), "its study.json is broken, its checksum not that of what it says: restore it")
        return manifest

    def begin(self, manifest: Mapping[str, Any]) -> None:
        """Make the folder that of a study, or make sure that it is already.

        Raises:
            ValueError: If it holds another study, or something else.
        """
        if self.manifest_path.exists():
            there = {key: value for key, value in self.manifest().items() if key != "checksum"}
            differences = list(_differences(there, manifest))
            if differences:
                refuse(self._field, str(self.path), "it holds another study; there differ " + "; ".join(differences))
        else:
            strangers = sorted(p.name for p in self.path.iterdir() if p.name not in (_LOCK, _PART, self.chunks.name))
            strangers += [str(p.relative_to(self.path)) for p in self.chunks.glob("*")]
            if strangers:
                refuse(self._field, str(self.path), f"it holds no study.json, but {strangers[0]!r}: give a new or empty folder")
            self.chunks.mkdir(exist_ok=True)
            with self.written(self.manifest_path) as part:
                part.write_text(json.dumps(_sealed(manifest), indent=2) + "\n", encoding="utf-8")

    def written(self, target: Path) -> AbstractContextManager[Path]:
        """A path to write to, that becomes ``target`` when all of it is on the disk, and never otherwise."""
        return written(target, self.path / _PART)  # outside of chunks/, which holds nothing but what is whole

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from writing; the lock ends with the process, however that ends.

        Raises:
            RuntimeError: If another holds it.
        """
        if self.path.exists() and not self.path.is_dir():
            refuse(self._field, str(self.path), "must be a folder")
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


def _sealed(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """A manifest with its checksum, which is of all else in it, however it is laid out."""
    content = {key: value for key, value in manifest.items() if key != "checksum"}
    said = json.dumps(content, sort_keys=True).encode()
    return {**content, "checksum": blake2b(said, digest_size=16).hexdigest()}


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
