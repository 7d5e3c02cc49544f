"""Equilibria as layers of PyTorch; ``docs/derivatives.md``."""

from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.files.optional import optional
from multirod.inputs import Inputs
from multirod.results.differentiable import Equilibrium
from multirod.results.solution import Solution
from multirod.solver import Solver
from multirod.types import Numbers

torch: Any = optional("torch", "torch", "layers of PyTorch")


class _Solved(torch.autograd.Function):  # type: ignore[misc]  # of a package that need not be there
    """What the forward pass finds, the derivatives included, and what backward makes of it."""

    @staticmethod
    def forward(ctx: Any, own: Equilibrium, names: tuple[str, ...], *tensors: Any) -> Any:
        solution, absent = own.solve({name: t.detach().cpu().numpy() for name, t in zip(names, tensors, strict=True)})
        live = [k for k, needed in enumerate(ctx.needs_input_grad[2:]) if needed]
        columns = own.columns(solution, absent, [names[k] for k in live]) if live else []
        ctx.live, ctx.output = live, own.output
        first = tensors[0]
        like = {"device": first.device, "dtype": first.dtype if first.is_floating_point() else torch.float64}
        ctx.save_for_backward(*(torch.as_tensor(column).to(**like) for column in columns))
        ctx.status = own.status(solution, absent)
        return torch.as_tensor(np.ascontiguousarray(own.value(solution, absent))).to(**like)

    @staticmethod
    def backward(ctx: Any, grad: Any) -> Any:
        found: list[Any] = [None] * len(ctx.needs_input_grad)
        axes = len(ctx.output)
        for k, column in zip(ctx.live, ctx.saved_tensors, strict=True):
            weights = grad.reshape(*grad.shape, *(1,) * (column.ndim - grad.ndim))
            # what nothing depends on has no part in it, though it failed and is NaN
            parts = torch.where(weights == 0, 0.0, column * weights)
            found[2 + k] = parts.sum(dim=tuple(range(grad.ndim - axes, grad.ndim)))
        return tuple(found)


class Layer(torch.nn.Module):  # type: ignore[misc]
    """A robot's end effector at equilibrium as a layer: ``layer(rotation=..., precurvature=...)``, tensors by name.

    It takes what ``multirod.jax.Function`` does, with leading axes that broadcast, and has no weights of its own. All is computed
    in double precision on the processor; the result is of the type and device of the first tensor, of an integer's in double
    precision. An instance that has no result is NaN, and so are its derivatives; ``status`` says why. Where a loss leaves it out,
    by a mask or an index, it adds nothing to the gradient by what the others share.

    Args:
        robot: One robot.
        of: ``"tip_position"`` [m], or ``"tip_pose"``, its homogeneous matrix in the world.
        inputs: Of what is not given by name later; zero by default.
        solver: ``mr.Shooting()`` by default.
        guess: Where each solve starts, as for ``solve``: one equilibrium, or one for each instance. Near what is asked for, it
            saves most of the integrations; without one the natural branch is followed from the unloaded robot.

    Raises:
        TypeError, ValueError: If an argument is not what it must be.
        ImportError: If PyTorch is missing: ``pip install "multirod[torch]"``.
    """

    def __init__(
        self,
        robot: Assembly,
        *,
        of: str = "tip_position",
        inputs: Inputs | None = None,
        solver: Solver | None = None,
        guess: Solution[Any] | Numbers | None = None,
    ) -> None:
        super().__init__()
        self.equilibrium = Equilibrium(robot, of, inputs, solver, guess)

    def forward(self, **values: Any) -> Any:
        """The end effector at equilibrium, shape (..., 3) or (..., 4, 4).

        Raises:
            TypeError: If a name is none of an input or number of the robot.
            ValueError: If a shape is not that of the name, or a value is out of range.
        """
        tensors = {name: torch.as_tensor(value) for name, value in values.items()}
        shape = self.equilibrium.batch_of({name: tuple(tensor.shape) for name, tensor in tensors.items()})
        tails = self.equilibrium.tails
        batched = [tensor.expand(*shape, *tails[name]) for name, tensor in tensors.items()]
        return _Solved.apply(self.equilibrium, tuple(tensors), *batched)

    def status(self, **values: Any) -> Any:
        """Values of ``Status`` at the same values, shape (...)."""
        given = {name: torch.as_tensor(value).detach().cpu().numpy() for name, value in values.items()}
        return torch.as_tensor(self.equilibrium.status(*self.equilibrium.solve(given)))

    def solution(self, **values: Any) -> Solution[Any]:
        """The equilibria themselves."""
        return self.equilibrium.solve({name: torch.as_tensor(value).detach().cpu().numpy() for name, value in values.items()})[0]

    def value_of(self, name: str) -> Any:
        """What the robot or its inputs have where ``name`` is not given: where a search may begin."""
        return torch.as_tensor(self.equilibrium.value_of(name))
