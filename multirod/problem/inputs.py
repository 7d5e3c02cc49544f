"""The inputs of a boundary problem: where they stand, and derivatives by them."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from multirod.inputs import Inputs
from multirod.problem.buffers import Buffers
from multirod.validation import FloatArray


@dataclass(frozen=True)
class PosesSensed:
    """Places along a rod, as an integration told them.

    Attributes:
        position: In the world [m], shape (b, count, 3).
        rotation: Frames of the rod, body to world, shape (b, count, 3, 3).
        columns: Of position rows, then rotation-vector rows in the world, by the unknowns, then by each number named, the
            unknowns fixed, shape (b, count, 6, n + k).
    """

    position: FloatArray
    rotation: FloatArray
    columns: FloatArray


class Sensing(Protocol):
    """An integration of a problem that tells more, at places along its rods."""

    def launch(self) -> None:
        """Integrate."""

    def curvature(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """What the last launch said of a rod, after ``aim(*names)``; to be read at once.

        Returns:
            Curvatures in its frame [1/m], shape (instance_count, count, 3), and their derivatives by the unknowns, then by each
            number named, the unknowns fixed, shape (instance_count, count, 3, n + k).
        """

    def poses(self, names: Sequence[str], rod: int) -> PosesSensed:
        """The same of poses: where the places on a rod are, its frames there, and how both vary."""

    def wrench(self, names: Sequence[str], rod: int) -> tuple[FloatArray, FloatArray]:
        """The same of the force and moment in the world that what lies beyond a place exerts on what lies before it.

        Of all rods in each other and their lines: [N, N m] (instance_count, count, 6), and derivatives (..., count, 6, n + k).
        """


class ByInputs(Buffers, ABC):
    """What a ``BoundaryProblem`` says of its inputs: rows of them, and columns along each."""

    columns_in_place = True  # whether ``aimed``, by inputs, is what stands in ``residual_directions`` and ``pose_columns``
    eliminates = False  # whether columns by parameters may be at other fixed unknowns than its own: they are eliminated next

    @abstractmethod
    def integrate(self) -> None:
        """Evaluate the active instances, as ``BoundaryProblem`` says."""

    def takes(self, name: str) -> bool:
        """Whether the terms of an input are compiled into this problem."""
        return True

    def pack(self, inputs: Inputs) -> FloatArray:
        """Rows of ``inputs``, shape (instance_count, input_count), for ``write("inputs", ...)``.

        Raises:
            ValueError: If an input that is not zero has no terms in this problem.
        """
        missing = sorted(name for name in inputs.given if inputs.is_active(name) and not self.takes(name))
        if missing:
            raise ValueError(f"the problem was made without {', '.join(missing)}: name them in enabled, or make a new problem")
        packed = np.zeros((*self.batch_shape, self.input_count))
        for name, values in inputs.arrays.items():
            packed[..., self.input_slice(name)] = values
        return packed.reshape(self.instance_count, self.input_count)

    @abstractmethod
    def input_slice(self, name: str) -> slice:
        """Where an input stands in a row of ``inputs`` and ``directions``."""

    def input_columns(self, *names: str) -> tuple[FloatArray, FloatArray]:
        """Derivatives by each component of one input or several, the unknowns fixed; takes one integration.

        The problem was made with ``Assembly.input_directions(*names)``, and with ``pose_sensitivities``.

        Returns:
            Of the residual, shape (instance_count, n, k), and of the end effector's pose, as in ``pose_columns``,
            shape (instance_count, 6, k): the components of each input beside each other, the inputs in the order named.
        """
        self.integrate_along(*names)
        return self.aimed(*names)

    def integrate_along(self, *names: str) -> None:
        """``aim``, and integrate."""
        self.aim(*names)
        self.integrate()

    def leaves_columns(self, *names: str) -> bool:
        """Whether ``aimed``, by these names, is what stands in ``residual_directions`` and ``pose_columns`` after an integration,
        and all of ``Gamma`` in ``gamma``; where ``eliminates`` is set, of inputs and parameters."""
        return False

    def part_ends(self, names: Sequence[str]) -> FloatArray:
        """Move ends of sections that are at one place a hair apart where one of these names would move them: derivatives have a
        side there. Returns what no place may be nearer to an end than [m], zero where none were moved, shape (instance_count,).
        """
        return np.zeros(self.instance_count)

    def aim(self, *names: str) -> None:
        """Point the directions along each component of some inputs: every integration from now on gives its columns."""
        key = ("aims", names)
        directions = self._tools.get(key)
        if directions is None:
            directions, column = np.zeros(self.directions.shape), 0
            for name in names:
                own = self.directions_by(name)
                directions[:, column : column + own.shape[1]] = own
                column += own.shape[1]
            # those along inputs are the same wherever the problem is
            if all(("directions", name) in self._tools for name in names):
                self._tools[key] = directions
        if self._direction_view is None:
            self.directions.assign(directions)
        else:
            self._direction_view[:] = directions

    @cached_property
    def _direction_view(self) -> FloatArray | None:
        """Directions as NumPy sees them in place; None where they are elsewhere."""
        return None if self._host is None else np.asarray(self.directions.numpy())

    def directions_by(self, name: str) -> FloatArray:
        """Directions along each component of an input, shape (instance_count or 1, k, directions.shape[2])."""

        def made() -> FloatArray:
            place = self.input_slice(name)
            rows = np.zeros((1, place.stop - place.start, self.directions.shape[2]))
            rows[0, :, place] = np.eye(rows.shape[1])
            return rows

        return self.tool(("directions", name), made)

    def aimed(self, *names: str) -> tuple[FloatArray, FloatArray]:
        """What ``input_columns`` returns, of the last integration after ``aim(*names)``."""
        return np.array(self.buffer("residual_directions")), np.array(self.buffer("pose_columns")[:, :, self.unknown_count :])

    def pose_by_unknowns(self) -> FloatArray:
        """How the end effector's pose varies with the unknowns, shape (instance_count, 6, n); to be read at once."""
        return np.asarray(self.buffer("pose_columns")[:, :, : self.unknown_count])

    def along(self, names: Sequence[str], rod: int, places: FloatArray) -> dict[str, FloatArray]:
        """Derivatives of a rod's ``position``, ``rotation``, ``curvature`` and ``wrench`` at some places, after ``aim(*names)``.

        Args:
            names: What the problem is aimed at.
            rod: Which rod.
            places: Rising arclengths from the base [m], shape (instance_count, count).

        Returns:
            Each of shape (instance_count, count, 3, n + k), a wrench has 6 rows: by the unknowns, then by each number named, the
            unknowns fixed. Positions, rotation vectors and wrenches in the world, curvatures in the frame of the rod.
        """
        raise NotImplementedError(f"{type(self).__name__} does not give derivatives along its rods")

    def sensing(self, places: FloatArray) -> Sensing:
        """What may be launched in the place of ``integrate``, and tells more: curvatures and poses at ``places`` (count,), rising
        arclengths."""
        raise NotImplementedError(f"{type(self).__name__} does not give derivatives along its rods")
