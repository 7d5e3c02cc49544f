"""Work against accuracy of the integrators on one rod: steps, time and tip error, for the paper's rod or your own."""

from time import perf_counter

import numpy as np

import multirod as mr


def main() -> dict[str, float]:
    rod = mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814, precurvature=(14, 5, 0))
    robot = mr.SingleRod(rod)
    inputs = robot.inputs(tip_force=(1, 0, 0.5))
    exact = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK45(1e-13, 1e-15))).tip_position
    choices = [mr.RK4(steps) for steps in (12, 25, 50, 100, 200)]
    choices += [mr.RK23(), mr.RK23(1e-6, 1e-8)] + [mr.RK45(rtol, rtol / 100) for rtol in (1e-5, 1e-6, 1e-7, 1e-8, 1e-9)]
    errors = {}
    print(f"{'integrator':32}{'steps':>6}{'time [µs]':>11}{'tip error / length':>20}")
    for integrator in choices:
        solution = mr.solve(robot, inputs, solver=mr.Shooting(integrator=integrator))
        problem = robot.problem(inputs, integrator=integrator)
        problem.write("unknowns", solution.unknowns)
        times = []
        for _ in range(200):
            begin = perf_counter()
            problem.integrate()
            times.append(perf_counter() - begin)
        errors[str(integrator)] = float(np.linalg.norm(solution.tip_position - exact)) / float(rod.length)
        steps = int(problem.step_count.numpy()[0])
        print(f"{integrator!s:32}{steps:6}{1e6 * np.median(times):11.1f}{errors[str(integrator)]:20.1e}")
    return errors


if __name__ == "__main__":
    main()
