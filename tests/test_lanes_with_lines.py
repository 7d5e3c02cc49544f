"""Rods with lines in lanes: where a lane's strains are sought from does not depend on where the others stop."""

import numpy as np
import pytest

import multirod as mr
from multirod.tasks.formulation import options

ANGLES = 2 * np.pi * np.arange(3) / 3
COUNT, CHOSEN = 40, 20


@pytest.fixture(scope="module")
def told():
    """What an integration at some unknowns tells of some instances, by their numbers."""
    lines = [mr.Tendon(0.006 * np.array([np.cos(a), np.sin(a)]), driven="displacement", axial_stiffness=300.0) for a in ANGLES]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines, discs=0.04))
    rng = np.random.default_rng(0)
    displacement, force = rng.uniform(-0.001, 0.004, (COUNT, 3)), rng.normal(size=(COUNT, 3)) * 0.4
    found = mr.solve(robot, robot.inputs(displacement=displacement, tip_force=force), progress=False)
    unknowns = np.nan_to_num(found.unknowns) + rng.normal(size=found.unknowns.shape) * 0.3

    def of(places):
        inputs = robot.inputs(displacement=displacement[places], tip_force=force[places])
        problem = robot.problem(inputs, integrator=mr.RK45(), **options(robot, ("tip_force",)))
        problem.write("unknowns", unknowns[places])
        problem.aim("tip_force")
        problem.integrate()
        slopes, moved = problem.aimed("tip_force")
        first = [np.array(problem.read(name))[0] for name in ("residual", "gamma", "position")]
        return [*first, np.array(slopes)[0], np.array(moved)[0]]

    return of


def test_an_instance_is_bitwise_the_same_beside_any_other(told):
    alone = told([CHOSEN])
    for other in range(COUNT):  # which stop at other steps; at two of them the last digits differed
        for own, beside in zip(alone, told([CHOSEN, other]), strict=True):
            np.testing.assert_array_equal(beside, own, err_msg=str(other))
