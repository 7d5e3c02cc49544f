"""What rods carry at places along them: values against wrenches of ends, (D25) of ``docs/derivatives.md`` against differences."""

import numpy as np
import pytest
from test_held_rod import BENT, GIVEN, HELD, PLACE
from test_platform_derivatives import LOADS, VALUES, made

import multirod as mr

NODES, WEIGHTS = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60  # a derivative, error O(h^6)
SOLVER = mr.Shooting(tolerance=1e-12, integrator=mr.RK45(rtol=1e-11, atol=1e-13))
WIRE = mr.Rod.wire(length=0.3, diameter=2e-3, young_modulus=60e9, shear_modulus=23e9, density=6450)
LINED = mr.Rod(
    length=0.2,
    bending_stiffness=0.02,
    torsional_stiffness=0.015,
    precurvature=(1, 0.5, 0),
    linear_density=0.1,
    lines=[mr.Tendon(offset=(0.006, 0.002)), mr.Tendon(offset=(-0.005, 0.003), driven="displacement", axial_stiffness=5e3)],
)
FELT = mr.Rod(
    length=0.3,
    bending_stiffness=0.02,
    torsional_stiffness=0.015,
    linear_density=0.05,
    magnetisation=(0.01, 0, 0.05),
    foundation=2.0,
)
TUBES = mr.ConcentricTubes(
    [
        mr.Rod.tube(
            length=length,
            inner_diameter=inner,
            outer_diameter=outer,
            young_modulus=60e9,
            shear_modulus=23e9,
            density=6450,
            precurvature=(curved, 0, 0),
        )
        for length, inner, outer, curved in ((0.4, 0.8e-3, 1.2e-3, 8.0), (0.25, 1.6e-3, 2.2e-3, 4.0))
    ]
)
# robot, inputs, by which of them, rods and places
SINGLE = {
    "dead loads": (
        mr.SingleRod(WIRE),
        {"rotation": 0.3, "tip_force": (0.1, 0.2, 0.05), "tip_moment": (0.01, 0, 0.02), "gravity": (0, 1.0, -9.0)},
    ),
    "a follower": (mr.SingleRod(WIRE), {"rotation": 0.3, "follower_force": (0.2, 0.1, -0.2), "distributed_force": (0.3, 0, 0.2)}),
    "lines": (mr.SingleRod(LINED), {"tension": 1.0, "displacement": 1e-3, "tip_force": (0.1, 0.05, 0)}),
    "field and medium": (mr.SingleRod(FELT), {"magnetic_field": (0.5, 0.2, 0.3), "tip_force": (0.1, 0.05, 0), "rotation": 0.2}),
    "tubes": (
        TUBES,
        {"rotation": (0.3, -0.6), "translation": (-0.05, -0.04), "tip_force": (0.2, 0.1, 0), "gravity": (0, 0, -9.0)},
    ),
    "pushed": (mr.SingleRod(WIRE), {"translation": -0.04, "gravity": (0, 9.0, 0), "tip_force": (0.1, 0, 0)}),
}
STEPS = {"displacement": 3e-4, "translation": 1e-3, "tension": 3e-2, "rotation": 3e-3, "tip_moment": 3e-3}
STEPS |= {"end_position": 2e-4, "end_rotation": 2e-3, "follower_moment": 2e-3, "force_point": 3e-3}
SHARE = 0.37  # of the rod: where no node of an integration is


def told(solution, at, rod):
    return solution.along(at, of="wrench", rod=rod)


def scene(name):
    """The robot, its inputs, and rods with places on them."""
    if name in SINGLE:
        robot, given = SINGLE[name]
        return robot, given, [(k, SHARE * 0.2) for k in range(robot.rod_count)]
    if name in HELD:
        return mr.HeldRod(BENT, end=PLACE, **HELD[name]), GIVEN, [(0, SHARE * 0.4)]
    robot = made(name)
    return (
        robot,
        LOADS | VALUES[name],
        [(0, 0.05), (min(robot.rod_count - 1, 3), 0.08)],
    )  # an inner tube, which reaches the platform


EVERY = [*SINGLE, *HELD, "every joint", "rod and tubes"]


@pytest.fixture(scope="module", params=EVERY)
def solved(request):
    robot, given, places = scene(request.param)
    return robot, given, places, mr.solve(robot, robot.inputs(**given), solver=SOLVER).raise_if_failed()


@pytest.mark.filterwarnings("ignore:rotation = .* does nothing")
def test_at_the_ends_it_is_what_holds_these(solved):
    """At the base ``wrench()``; at the tip of a leg the opposite of what it does to the platform."""
    robot, _, places, solution = solved
    for rod, _ in places:
        ends = [("base", 0.0, 1)]
        if isinstance(robot, mr.ParallelRods):
            ends.append(("tip", float(solution.rod(rod).arclength[-1]), -1))
        for end, at, sign in ends:
            own = solution.wrench(rod, end)
            expected = sign * np.concatenate([own.force, own.moment])
            # a place that is 1e-12 of the length away from the end
            np.testing.assert_allclose(told(solution, at, rod), expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.filterwarnings("ignore:rotation = .* does nothing")
def test_columns_are_those_of_differences(solved):
    """(D25), (D20) Of all inputs; at one place within and at the base."""
    robot, given, places, solution = solved
    for name, value in given.items():
        step, at = STEPS.get(name, 1e-2), np.atleast_1d(value).astype(float)
        varied = given | {name: at + step * NODES[:, None] * np.eye(len(at))[:, None]}
        moved = mr.solve(robot, robot.inputs(**varied), solver=SOLVER, guess=solution).raise_if_failed()
        for rod, place in places:
            where = (0.0, place)
            expected = np.einsum("n,knpc->pck", WEIGHTS, told(moved, where, rod)) / step
            found = solution.jacobian(name, of="wrench", at=where, rod=rod)
            scale = max(np.abs(expected).max(), 1e-3 * np.abs(told(solution, where, rod)).max() / step)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * scale, err_msg=f"{name} of rod {rod}")


def test_a_wrench_is_told_at_places_on_a_rod(wire):
    solution = mr.solve(mr.SingleRod(wire))
    with pytest.raises(ValueError, match="^at = None is not allowed: must be an arclength"):
        solution.jacobian("tip_force", of="wrench")
    with pytest.raises(ValueError, match=r"^of = 'force' is not allowed: must be .*'wrench'"):
        solution.along(0.1, of="force")
