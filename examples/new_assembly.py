"""A new assembly: a rod whose base turns about its axis against a torsional spring.

The base angle is ``alpha - M_z(0) / spring`` instead of ``alpha``. The boundary problem wraps that of the rod: it sets the
base angle that belongs to the unknowns, and adds to ``Gamma`` what the angle's change adds, by the rod's own sensitivity.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

import multirod as mr


class SprungRod(mr.Assembly):
    """One rod on a torsional spring of stiffness ``spring`` [N m/rad]; inputs as for ``SingleRod``."""

    def __init__(self, rod: mr.Rod, *, spring: float) -> None:
        self.clamped = mr.SingleRod(rod)
        self.rods = (rod,)
        self.spring = spring

    @property
    def input_specs(self) -> tuple[mr.InputSpec, ...]:
        return self.clamped.input_specs

    def problem(
        self, inputs: mr.Inputs, *, direction_count: int = 0, enabled: Sequence[str] = (), **options: Any
    ) -> "SprungProblem":
        if direction_count or options.get("pose_sensitivities"):
            raise ValueError(
                "SprungRod offers no derivatives by its inputs: use a solver without feed-forward or corrected output"
            )
        inner = self.clamped.problem(inputs, direction_count=1, enabled=enabled, **options)
        return SprungProblem(inner, self.spring)


class SprungProblem(mr.BoundaryProblem):
    """Unknowns and residual are the rod's own."""

    def __init__(self, inner: mr.BoundaryProblem, spring: float) -> None:
        super().__init__(
            unknown_count=3,
            batch_shape=inner.batch_shape,
            input_count=inner.input_count,
            blocks=inner.blocks,
            device=inner.device,
        )
        self.inner = inner
        self.rounding = inner.rounding
        self.measured = inner.measured
        rod = inner.rods[0]
        self.give = float(rod.sections[0].torsional_stiffness) / spring  # angle of the spring per twist at the base
        self.write("inputs", inner.read("inputs"))
        turn = np.zeros(inner.directions.shape)
        turn[:, 0, inner.input_slice("rotation")] = 1.0
        inner.directions.assign(turn)

    def guess(self) -> np.ndarray:
        return self.inner.guess()

    def curvature_scale(self) -> np.ndarray:
        return self.inner.curvature_scale()

    def input_slice(self, name: str) -> slice:
        return self.inner.input_slice(name)

    def pack(self, inputs: mr.Inputs) -> np.ndarray:
        return self.inner.pack(inputs)

    def takes(self, name: str) -> bool:
        return self.inner.takes(name)

    def load_scale(self) -> np.ndarray:
        return self.inner.load_scale()

    def _integrate(self) -> None:
        unknowns, inputs = self.read("unknowns"), self.read("inputs")
        inputs[:, self.input_slice("rotation")] -= self.give * (unknowns[:, 2:] - self.inner.guess()[:, 2:])
        self.inner.write("unknowns", unknowns)
        self.inner.write("inputs", inputs)
        self.inner.load_factor.assign(self.load_factor.numpy())
        self.inner.integrate()
        gamma = self.inner.read("gamma").reshape(-1, 3, 3)
        gamma[:, :, 2] -= self.give * self.inner.residual_directions.numpy()[:, :, 0]
        active = self.active.numpy() != 0
        for name in ("residual", "position", "rotation"):
            self.write(name, np.where(active[:, None], self.inner.read(name), self.read(name)))
        self.write("gamma", np.where(active[:, None], gamma.reshape(len(gamma), -1), self.read("gamma")))
        self.fault.assign(np.where(active, self.inner.fault.numpy(), self.fault.numpy()))

    def shapes(self, node_count: int) -> Any:
        self.integrate()
        return self.inner.shapes(node_count)


def main() -> float:
    rod = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0))
    robot = SprungRod(rod, spring=0.05)
    solution = mr.solve(robot, robot.inputs(tip_force=(0.3, 0.2, 0))).raise_if_failed()
    torque = solution.rod(0).moment[0, 2]
    clamped = mr.solve(robot.clamped, robot.clamped.inputs(rotation=-torque / robot.spring, tip_force=(0.3, 0.2, 0)))
    error = float(np.linalg.norm(solution.tip_position - clamped.tip_position))
    print(f"base torque {torque:.4f} N m turns the spring by {-torque / robot.spring:.4f} rad")
    print(f"the clamped rod at that angle is {error:.1e} m away")
    return error


if __name__ == "__main__":
    main()
