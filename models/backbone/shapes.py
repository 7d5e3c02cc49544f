"""One backbone between base and tip: shapes and energies by passes over nodes."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.capabilities import Shapes
from multirod.models.backbone.derivatives.bending import BackboneBending, may_tell_bending
from multirod.models.backbone.passes.buffers import NODE_FIELDS, TOTALS
from multirod.problem import Shape
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem


class BackboneShapes(Shapes):
    """Of a ``BackboneProblem``; instances that are known by their breakpoints, by these."""

    def __init__(self, problem: "BackboneProblem") -> None:
        self.problem = problem

    def at_nodes(self, node_count: int) -> tuple[tuple[Shape, ...], FloatArray]:  # noqa: D102
        fields = (*NODE_FIELDS, *(TOTALS if self.problem.features.members else ()))
        calls = [self.problem.nodes.over(node_count, rod=rod) for rod in range(len(self.problem.rods))]
        shapes = [{name: np.array(call.read(f"node_{name}")) for name in fields} for call in calls]
        energy = np.array(calls[0].read("energy"))
        if self.problem.breakpoints:
            others, stored, _ = self.problem.cut.shapes(self.problem.breakpoints, node_count)
            for k in self.problem.breakpoints:
                energy[k] = stored[k]
                for shape, other in zip(shapes, others, strict=True):
                    for name in fields:
                        shape[name][k] = getattr(other, name)[k]
        return tuple(Shape(**shape) for shape in shapes), energy

    def jumps(self) -> tuple[FloatArray, ...]:
        """As said: where a piece of any rod ends, counted from where all come out."""
        problem = self.problem
        out = problem.read("inputs")[:, problem.input_slice("translation")]
        ends = problem.each(problem.arrays.end) + out[..., None]
        return (ends.reshape(len(out), -1),) * len(problem.rods)

    def bending(self, node_count: int) -> BackboneBending | None:  # noqa: D102
        return BackboneBending(self.problem, node_count) if may_tell_bending(self.problem) else None

    def stored_and_lost(self) -> tuple[FloatArray, FloatArray]:
        """Elastic energy, and the potential energy of what acts along a held rod but not at its tip [J], shape
        (instance_count,)."""
        call = self.problem.nodes.over(2)
        base = np.broadcast_to(self.problem.table.base_position.numpy(), (self.problem.instance_count, 3))
        force, position = np.array(self.problem.tip_wrench.numpy()[:, :3]), np.array(call.read("position"))
        stored, work = np.array(call.read("energy")), np.array(call.read("work"))
        driven = self.problem.features.condition_count > 0
        lengths = np.array(call.read("line_length")) if driven else np.zeros(0)
        if self.problem.breakpoints:
            (shape,), energy, done = self.problem.cut.shapes(self.problem.breakpoints, 2)
            for k in self.problem.breakpoints:
                stored[k], work[k], position[k] = energy[k], done[k], shape.position[k, -1]
                force[k] = shape.rotation[k, -1] @ shape.total_force[k, -1]
            if driven:
                lengths = self.problem.lines.length()
        lost = (force * (position - base)).sum(axis=1) - work
        if driven:
            lost += self.problem.lines.stretch_energy(lengths)
        return stored, np.asarray(lost)
