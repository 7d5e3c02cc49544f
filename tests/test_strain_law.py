"""What results say of each rod by itself: its own moment follows from its own curvature, whatever it shares its bending with."""

import numpy as np
import pytest

import multirod as mr

STIFFNESS, LENGTH = np.array([0.01, 0.01, 0.008]), 0.2
UNEVEN = np.array([0.03, 0.025, 0.02])
INNER, OUTER = np.array([6.0, 2.0, 0.5]), np.array([0.0, 9.0, 0.3])
TURNED = {"rotation": (0.3, 1.2), "tip_force": (0.1, 0.05, 0.0)}


def rod(stiffness=STIFFNESS, precurvature=INNER, **properties) -> mr.Rod:
    own = {"bending_stiffness": stiffness[:2], "torsional_stiffness": stiffness[2], "precurvature": precurvature}
    return mr.Rod(**{"length": LENGTH} | own | properties)


def bodies(outer=STIFFNESS, **properties) -> list[mr.Rod]:
    return [rod(**properties), rod(outer, OUTER, length=0.14)]


SCENES = {
    "rod with tendons": (
        lambda: mr.SingleRod(rod(UNEVEN, lines=[mr.Tendon((0.005, 0)), mr.Tendon((0, 0.005))])),
        {"tension": (1.0, 0.5), "tip_force": (0.1, 0.05, 0.0)},
        [UNEVEN],
    ),
    "tubes": (lambda: mr.ConcentricTubes(bodies()), TURNED, [STIFFNESS, STIFFNESS]),
    "tubes with two stiffnesses": (lambda: mr.ConcentricTubes(bodies(UNEVEN)), TURNED, [STIFFNESS, UNEVEN]),
    "tubes with a tendon": (
        lambda: mr.ConcentricTubes(bodies(UNEVEN, lines=[mr.Tendon((0.001, 0))])),
        TURNED | {"tension": 1.0},
        [STIFFNESS, UNEVEN],
    ),
    "side by side": (
        lambda: mr.EccentricTubes(bodies(), offsets=[(0.002, 0), (-0.002, 0.001)]),
        TURNED,
        [STIFFNESS, STIFFNESS],
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_moment_of_each_rod_is_that_of_its_own_strain(name):
    make, inputs, stiffnesses = SCENES[name]
    robot = make()
    solution = mr.solve(robot, robot.inputs(**inputs))
    assert solution.status == mr.Status.CONVERGED
    for k, stiffness in enumerate(stiffnesses):
        shape = solution.rod(k)
        strain = shape.curvature - robot.rods[k].sections[0].precurvature
        if name == "side by side":  # by the rod's own arclength, that of the twist by the line's
            strain = strain[:, :2]
        size = strain.shape[1]
        assert np.abs(strain).max(axis=0).min() > 0.01  # all of it does something
        np.testing.assert_allclose(shape.moment[:, :size], stiffness[:size] * strain, atol=1e-12)
