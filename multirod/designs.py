"""Robots of many designs: one of them, and files."""

from abc import abstractmethod
from collections.abc import Iterator
from math import prod
from os import PathLike
from typing import Any, Self, cast

import numpy as np

from multirod.batch import along, chosen
from multirod.types import Index


class Designs:
    """What a robot, or a batch of robots of as many designs, offers of these."""

    @property
    @abstractmethod
    def batch_shape(self) -> tuple[int, ...]:
        """Leading axes of its numbers."""

    def __getitem__(self, index: Index) -> Self:
        """The robot of some instances of a batch of designs: ``index`` as for an array with the leading axes ``batch_shape``.

        Raises:
            IndexError: If there are no such instances.
            ValueError: If the robot is, or has, something of another package.
        """
        from multirod.files.instances import of_instances

        shape = self.batch_shape
        return cast(Self, of_instances(cast(Any, self), shape, chosen(self, np.arange(prod(shape)).reshape(shape), index)))

    def __iter__(self) -> Iterator[Self]:
        """Along the first of the leading axes.

        Raises:
            TypeError: If there is none.
        """
        return along(cast(Any, self))

    def save(self, path: str | PathLike[str]) -> None:
        """Write the robot to a file, to be read by ``mr.load(path)`` (``docs/files.md``).

        Args:
            path: File to write, ``.toml`` (text, with units) or ``.npz``; an existing one is replaced.

        Raises:
            ValueError: If it has another ending, or the robot is, or has, something of another package; or, of text, something
                that is a function of arclength.
        """
        from multirod.files.saving import save_robot

        save_robot(path, cast(Any, self))
