"""Three segments that bend by the same angle: a tendon, three chambers, and three push rods beside a backbone.

The tendon robot is that of github JohnDTill/ContinuumRobotExamples, 01_Statics/05_Tendon_Robot: a steel rod of 1 mm radius, half
a metre long, a tendon 15.06 mm beside it. The chambers are in silicone; the push rods have the size of those in a surgical snake.
"""

import numpy as np

import multirod as mr

ANGLE = 0.6  # [rad]
THREE = np.arange(3) * 2 * np.pi / 3


def around(radius: float) -> np.ndarray:
    return radius * np.column_stack([np.cos(THREE), np.sin(THREE)])


def tendon() -> mr.Solution:
    """Pulled out by the angle times its offset."""
    offset = 0.01506
    line = mr.Tendon(offset=(offset, 0), driven="displacement")
    rod = mr.Rod.tube(length=0.5, outer_diameter=2e-3, young_modulus=200e9, shear_modulus=80e9, lines=[line])
    robot = mr.SingleRod(rod)
    return mr.solve(robot, robot.inputs(displacement=[ANGLE * offset]))


def chambers() -> mr.Solution:
    """One of three is filled: its pressure, times its area and its offset, is the moment."""
    EI, length, area = 0.00785, 0.12, 1.9635e-5
    lines = [mr.Chamber(offset=offset, area=area) for offset in around(-0.0055)]
    robot = mr.SingleRod(mr.Rod(length=length, bending_stiffness=EI, torsional_stiffness=0.00524, lines=lines))
    return mr.solve(robot, robot.inputs(pressure=(EI * ANGLE / length / (area * 0.0055), 0, 0)))


def push_rods() -> mr.Solution:
    """Each is moved by the angle times how far it is from the axis of bending; they stretch a little."""
    offsets = around(0.004)
    lines = [mr.PushRod(offset=offset, bending_stiffness=0.012, axial_stiffness=1e6) for offset in offsets]
    robot = mr.SingleRod(mr.Rod(length=0.08, bending_stiffness=0.03, torsional_stiffness=0.025, lines=lines))
    return mr.solve(robot, robot.inputs(displacement=ANGLE * offsets[:, 0]))


def main() -> list[float]:
    angles = []
    for name, solve in (("tendon", tendon), ("chambers", chambers), ("push rods", push_rods)):
        solution = solve().raise_if_failed()
        angles.append(float(np.arctan2(solution.tip_rotation[0, 2], solution.tip_rotation[2, 2])))
        tension = ", ".join(f"{value:.3f}" for value in solution.tension)
        print(f"{name:10} bent by {angles[-1]:.6f} rad, tip {np.round(1e3 * solution.tip_position, 3)} mm, tension {tension} N")
    return angles


if __name__ == "__main__":
    main()
