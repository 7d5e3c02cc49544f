"""Equilibria as functions of JAX, with derivatives, under ``jit``, ``vmap`` and ``grad``; ``docs/derivatives.md``."""

from collections.abc import Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Assembly
from multirod.files.optional import optional
from multirod.inputs import Inputs
from multirod.results.differentiable import Equilibrium
from multirod.results.solution import Solution
from multirod.solver import Solver
from multirod.types import Numbers

jax: Any = optional("jax", "jax", "functions of JAX")


class Function:
    """A function of JAX: ``function(rotation=..., tip_force=..., precurvature=...)``, values by name.

    Values are those of ``robot.inputs(...)``, and the numbers of sections ``precurvature``, ``foundation`` and ``magnetisation``,
    shape (..., rod_count, section_count, 3), ``bending_stiffness`` (..., rod_count, section_count, 2), ``torsional_stiffness``
    and ``length`` (..., rod_count, section_count), with anything for sections that a rod has not. Leading axes broadcast, and are
    a batch that is solved together; so is what ``vmap`` maps over. Derivatives are exact ones of first order, forward and
    reverse, and by the values alone by which they are asked for. All is computed in double precision, whatever JAX holds it in:
    32 bits unless ``jax_enable_x64`` is set.

    An instance that has no result is NaN, and so are its derivatives, whatever weight a loss gives it; ``status`` says why. The
    others are bitwise what they are alone. Of values that a batch shares, take ``vmap(grad(loss))`` and the mean of what is no
    NaN: ``grad`` of the mean itself is NaN if one instance is.
    """

    def __init__(self, equilibrium: Equilibrium) -> None:
        self.equilibrium = equilibrium
        self._of = cache(self._make)

    def __call__(self, **values: Any) -> Any:
        """The end effector at equilibrium, shape (..., 3) or (..., 4, 4).

        Raises:
            TypeError: If a name is none of an input or number of the robot.
            ValueError: If a shape is not that of the name; or, as the robot is solved, a value is out of range.
            NotImplementedError: If it is differentiated by what derivatives of such a robot are not known by.
        """
        return self._of(tuple(values))(*self._batched(values))

    def status(self, **values: Any) -> Any:
        """Values of ``Status`` at the same values, shape (...)."""
        arrays = self._batched(values)
        shape = jax.ShapeDtypeStruct(self._batch(tuple(values), arrays), np.int32)
        return jax.pure_callback(partial(self._status, tuple(values)), shape, *arrays, vmap_method="expand_dims")

    def solution(self, **values: Any) -> Solution[Any]:
        """The equilibria themselves, of values that are known: not within ``jit`` or ``grad``."""
        return self.equilibrium.solve({name: np.asarray(value) for name, value in values.items()})[0]

    def value_of(self, name: str) -> NDArray[np.float64]:
        """What the robot or its inputs have where ``name`` is not given: where a search may begin."""
        return self.equilibrium.value_of(name)

    def _batched(self, values: dict[str, Any]) -> list[Any]:
        """Values, each with all leading axes, so that those of ``vmap`` stand before the same."""
        real = jax.numpy.result_type(float)
        arrays = {name: jax.numpy.asarray(value, dtype=real) for name, value in values.items()}
        shape = self.equilibrium.batch_of({name: array.shape for name, array in arrays.items()})
        tails = self.equilibrium.tails
        return [jax.numpy.broadcast_to(array, (*shape, *tails[name])) for name, array in arrays.items()]

    def _batch(self, names: Sequence[str], arrays: Sequence[Any]) -> tuple[int, ...]:
        return self.equilibrium.batch_of({name: array.shape for name, array in zip(names, arrays, strict=True)})

    def _make(self, names: tuple[str, ...]) -> Any:
        own = self.equilibrium

        def shapes(arrays: Sequence[Any], live: Sequence[int]) -> list[Any]:
            batch, real = self._batch(names, arrays), jax.numpy.result_type(float)
            tails: list[tuple[int, ...]] = [(), *(own.tails[names[k]] for k in live)]
            return [jax.ShapeDtypeStruct((*batch, *own.output, *tail), real) for tail in tails]

        def host(live: tuple[int, ...], *arrays: Any) -> list[NDArray[Any]]:
            given = {name: np.asarray(array) for name, array in zip(names, arrays, strict=True)}
            solution, absent = own.solve(given)
            found = [own.value(solution, absent)]
            if live:
                found += own.columns(solution, absent, [names[k] for k in live])
            return [np.asarray(array, dtype=jax.numpy.result_type(float)) for array in found]

        def call(*arrays: Any) -> Any:
            return jax.pure_callback(partial(host, ()), shapes(arrays, ()), *arrays, vmap_method="expand_dims")[0]

        def rule(arrays: Any, tangents: Any) -> Any:
            live = tuple(k for k, t in enumerate(tangents) if not isinstance(t, jax.custom_derivatives.SymbolicZero))
            own.refuse_unknown([names[k] for k in live])  # here, where JAX traces: an error of the callback is JAX's own
            value, *columns = jax.pure_callback(partial(host, live), shapes(arrays, live), *arrays, vmap_method="expand_dims")
            rates = jax.numpy.zeros_like(value)
            for k, column in zip(live, columns, strict=True):
                batch = value.shape[: value.ndim - len(own.output)]
                flat = column.reshape(*value.shape, -1)
                along = tangents[k].reshape(*batch, *(1,) * len(own.output), -1)
                rates = rates + (flat * along).sum(axis=-1)
            return value, rates

        function = jax.custom_jvp(call)
        function.defjvp(rule, symbolic_zeros=True)
        return function

    def _status(self, names: tuple[str, ...], *arrays: Any) -> NDArray[np.int32]:
        own = self.equilibrium
        return own.status(*own.solve({name: np.asarray(array) for name, array in zip(names, arrays, strict=True)}))

    def __repr__(self) -> str:
        return f"multirod.jax.function({self.equilibrium.robot!r}, of={self.equilibrium.of!r})"


def function(
    robot: Assembly,
    *,
    of: str = "tip_position",
    inputs: Inputs | None = None,
    solver: Solver | None = None,
    guess: Solution[Any] | Numbers | None = None,
) -> Function:
    """A robot's end effector at equilibrium as a function of JAX.

    Args:
        robot: One robot.
        of: ``"tip_position"`` [m], or ``"tip_pose"``, its homogeneous matrix in the world.
        inputs: Of what is not given by name later; zero by default.
        solver: ``mr.Shooting()`` by default.
        guess: Where each solve starts, as for ``solve``: one equilibrium, or one for each instance. Near what is asked for, it
            saves most of the integrations; without one the natural branch is followed from the unloaded robot.

    Returns:
        A ``Function``, which says what it takes.

    Raises:
        TypeError, ValueError: If an argument is not what it must be.
        ImportError: If JAX is missing: ``pip install "multirod[jax]"``.
    """
    return Function(Equilibrium(robot, of, inputs, solver, guess))
