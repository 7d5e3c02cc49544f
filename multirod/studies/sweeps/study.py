"""A study on disk, read."""

import math
import os
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.naming import unknown_names
from multirod.status import Status
from multirod.studies.sweeps.chunk import FURTHER
from multirod.studies.sweeps.folder import Broken, Folder
from multirod.studies.sweeps.table import Arrays, Tails, blank, column_names, from_table, tails_in
from multirod.validation import path_of, shown


class Study:
    """The results of a sweep, as far as they are done; reads the folder anew at each call, also while it is being written.

    Every file that is read is checked against its checksum: one that is truncated or altered is not among
    ``finished_chunks``, and arrays that it is part of raise a ``RuntimeError`` that names it.

    ``study["tip_position"]`` is a whole array in the batch's axes, ``study.chunks(...)`` goes through it chunk by chunk. The
    files are Parquet: ``docs/sweep.md`` opens them without this package.

    Args:
        folder: What was ``out`` of the sweep.

    Attributes:
        path: The folder.
        manifest: What the study is of: its ``study.json``.
        batch_shape: Leading axes of the arrays.
        instance_count: Instances, done or not.
        chunk: Instances of a chunk; the last may have fewer.
        chunk_count: Chunks, done or not.

    Raises:
        ValueError: If the folder holds no study, or its ``study.json`` is not what was written.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self._folder = Folder(path_of("folder", folder), "folder")
        self.path = self._folder.path
        self.manifest = self._folder.manifest()
        self.batch_shape: tuple[int, ...] = tuple(self.manifest["batch_shape"])
        self.instance_count = math.prod(self.batch_shape)
        self.chunk: int = self.manifest["chunk"]
        self.chunk_count: int = -(-self.instance_count // self.chunk)

    def instances(self, chunk: int) -> NDArray[np.intp]:
        """Flat indices of the instances of a chunk."""
        return np.arange(chunk * self.chunk, min((chunk + 1) * self.chunk, self.instance_count))

    @property
    def finished_chunks(self) -> tuple[int, ...]:
        """Chunks that are done, their files as they were written."""
        return tuple(self._folder.finished())

    @property
    def done(self) -> NDArray[np.bool_]:
        """Whether each instance is done, shape (...)."""
        result = np.zeros(self.instance_count, dtype=bool)
        for chunk in self.finished_chunks:
            result[self.instances(chunk)] = True
        return result.reshape(self.batch_shape)

    @property
    def finished(self) -> bool:
        """Whether every instance is done."""
        return len(self.finished_chunks) == self.chunk_count

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays: inputs, then results.

        Raises:
            RuntimeError: If no chunk is done yet.
        """
        return tuple(self._tails)

    @cached_property
    def _tails(self) -> Tails:
        paths = list(self._folder.present().values())
        if not paths:
            raise RuntimeError(f"no chunk of {self.path} is done yet")
        return tails_in(self._opened(paths[0]).schema_arrow.metadata)

    def _opened(self, path: Path) -> Any:  # noqa: ANN401  (pyarrow has no types)
        """A chunk's file, what was checked and no other bytes."""
        import pyarrow as pa  # type: ignore[import-untyped]
        import pyarrow.parquet as pq  # type: ignore[import-untyped]

        return pq.ParquetFile(pa.BufferReader(self._folder.read(path)))

    def chunks(self, *names: str) -> Iterator[tuple[NDArray[np.intp], Arrays]]:
        """Each chunk that is done, in order: flat indices of its instances, and arrays (instance, ...) by name.

        Args:
            *names: Of the arrays; all by default.

        Raises:
            TypeError: If there is no array of a name.
            RuntimeError: If a file is not what was written; the message names it.
        """
        present = self._folder.present()
        if not present:
            return
        tails = self._tails
        unknown_names("a study", names, tails)
        wanted = names or tuple(tails)
        columns = [column for name in wanted for column in column_names(name, tails[name])]
        for chunk, path in present.items():
            yield self.instances(chunk), from_table(self._opened(path).read(columns=columns), wanted, tails)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """An array (..., its own axes); where an instance is not done: NaN, ``Status.NOT_RUN``, and -1 for other integers.

        Raises:
            RuntimeError: If no chunk is done yet, or a file is not what was written; the message names it.
            TypeError: If there is no array of that name.
        """
        result: Any = None
        if not isinstance(name, str):
            raise TypeError(
                f"a study takes the name of an array, study['tip_position'], not {shown(name)}: index what that gives"
            )
        if name in FURTHER and name not in self.names:
            raise TypeError(f"this study has not kept {name!r}: it is kept where sweep(..., quantities=[{name!r}]) asks for it")
        unknown_names("a study", [name], self.names)
        for instances, arrays in self.chunks(name):
            values = arrays[name]
            if result is None:
                result = blank(name, values.dtype, (self.instance_count, *values.shape[1:]))
            result[instances] = values
        return np.asarray(result.reshape((*self.batch_shape, *result.shape[1:])))

    def counts(self) -> dict[Status, int]:
        """How many instances ended with each status; those that are not done are ``NOT_RUN``."""
        total = np.zeros(max(Status) + 1, dtype=int)
        for _, arrays in self.chunks("status"):
            total += np.bincount(arrays["status"], minlength=len(total))
        total[Status.NOT_RUN] += self.instance_count - total.sum()
        return {Status(code): int(count) for code, count in enumerate(total) if count}

    def __repr__(self) -> str:
        try:
            said = ", ".join(f"{count} {status}" for status, count in self.counts().items())
        except Broken as error:
            said = str(error)
        return f"Study({str(self.path)!r}, batch {self.batch_shape}: {said})"
