"""A new integrator is a Butcher tableau: Kutta's 3/8 rule, checked against its order."""

from typing import ClassVar

import numpy as np

import multirod as mr


class ThreeEighths(mr.FixedStepIntegrator):
    """Kutta's 3/8 rule, fourth order (Hairer, Norsett and Wanner, *Solving Ordinary Differential Equations I*, II.1)."""

    tableau: ClassVar[mr.Tableau] = mr.Tableau(
        order=4,
        a=((), (1 / 3,), (-1 / 3, 1.0), (1.0, -1.0, 1.0)),
        b=(1 / 8, 3 / 8, 3 / 8, 1 / 8),
        c=(0.0, 1 / 3, 2 / 3, 1.0),
    )


def main() -> float:
    rod = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0))
    robot = mr.SingleRod(rod)
    inputs = robot.inputs(tip_force=(1, 0, 0.5))
    exact = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK45(1e-12, 1e-14))).tip_position
    errors = []
    for steps in (20, 40, 80):
        solution = mr.solve(robot, inputs, solver=mr.Shooting(integrator=ThreeEighths(steps)))
        errors.append(float(np.linalg.norm(solution.tip_position - exact)))
        print(f"{steps:3} steps: tip error {errors[-1]:.2e} m")
    order = float(np.log2(errors[1] / errors[2]))
    print(f"order {order:.2f}")
    return order


if __name__ == "__main__":
    main()
