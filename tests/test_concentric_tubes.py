"""Concentric tubes through the public classes: reference cases, refusals, sensitivities, every solver."""

import numpy as np
import pytest

import multirod as mr
from multirod.models.backbone import BackboneProblem

# The branch that raising precurvature and loads reaches is another than the stored one; a guess selects the stored one.
OTHER_BRANCH = {"09b_ctr_two_tube_5", "14i_ctr_near_fold_0.0001", "14i_ctr_near_fold_1e-06"}
# Opposite tubes, more strongly curved than L sqrt(c) = pi/2: the symmetric branch has lost its stability.
BIFURCATED = {"09b_ctr_two_tube_3"}


NAMES = [
    "09b_ctr_two_tube_1",
    "09b_ctr_two_tube_3",
    "09b_ctr_two_tube_5",
    "09c_ctr_three_tube_1",
    "09c_ctr_three_tube_3",
    "09c_ctr_three_tube_5",
    "09c_ctr_three_tube_7",
    "09d_ctr_three_tube_strong_1",
    "09d_ctr_three_tube_strong_3",
    "09e_ctr_helical_tube",
    "14f_ctr_tiny_gap",
    "14i_ctr_near_fold_0.0001",
    "14i_ctr_near_fold_1e-06",
]


def assembly(inputs, make_pose):
    tubes = []
    for tube in inputs["tubes"]:
        straight, curvature = tube["length"] - tube["curved_length"], tuple(tube["u_star"])
        sections = [(straight, (0, 0, 0)), (tube["curved_length"], curvature)] if straight > 1e-12 else curvature
        tubes.append(
            mr.Rod(length=tube["length"], bending_stiffness=tube["EI"], torsional_stiffness=tube["GJ"], precurvature=sections)
        )
    robot = mr.ConcentricTubes(tubes, base=make_pose(inputs["R0"], inputs["p0"]))
    loads = {f"tip_{name}": inputs.get(f"tip_{name}_world", (0.0, 0.0, 0.0)) for name in ("force", "moment")}
    loads = {name: value for name, value in loads.items() if np.any(value)}
    return robot, robot.inputs(rotation=inputs["base_angle_alpha"], translation=inputs["base_position_beta"], **loads)


@pytest.mark.parametrize("stored", NAMES)
def test_reference_case(stored, reference_cases, make_pose):
    case = next(c for c in reference_cases("concentric_tubes") if c["id"] == stored)
    robot, inputs = assembly(case["inputs"], make_pose)
    solution = mr.solve(robot, inputs)
    if stored in BIFURCATED:
        assert solution.status == mr.Status.BRANCH_END
        return
    if stored in OTHER_BRANCH:
        solution.raise_if_failed()
        rates = case["expected"]["base_torsion_rates"]["value"]
        solution = mr.solve(robot, inputs, guess=(0, 0, *rates))
    expected, length = case["expected"], max(tube["length"] for tube in case["inputs"]["tubes"])
    solution.raise_if_failed()
    # near a fold the equilibrium itself moves by the root of any error: 1e-6 from it, by 1e-4 of the integrator's 1e-8
    tolerance = 1e-5 if "near_fold" in stored else 1e-6
    np.testing.assert_allclose(solution.tip_position, expected["tip_position"]["value"], rtol=0, atol=tolerance * length)
    np.testing.assert_allclose(solution.tip_rotation, expected["tip_rotation_of_longest_tube"]["value"], rtol=0, atol=tolerance)


INNER = mr.Rod.tube(
    length=0.30,
    outer_diameter=1.0e-3,
    inner_diameter=0.6e-3,
    young_modulus=60e9,
    shear_modulus=23e9,
    precurvature=[(0.2, (0, 0, 0)), (0.1, (9, 0, 0))],
)
OUTER = mr.Rod.tube(
    length=0.20,
    outer_diameter=1.6e-3,
    inner_diameter=1.1e-3,
    young_modulus=60e9,
    shear_modulus=23e9,
    precurvature=[(0.13, (0, 0, 0)), (0.07, (4, 2, 0))],
)


@pytest.fixture
def pair():
    return mr.ConcentricTubes([INNER, OUTER])


def test_one_tube_is_the_single_rod(wire):
    force = {"rotation": 0.4, "tip_force": (0.3, 0.2, 0.1)}
    tubes, rod = mr.ConcentricTubes([wire]), mr.SingleRod(wire)
    one, other = mr.solve(tubes, tubes.inputs(**force)), mr.solve(rod, rod.inputs(**force))
    np.testing.assert_array_equal(one.tip_position, other.tip_position)


def test_identical_aligned_tubes_are_one_of_the_summed_stiffness():
    tube = {"length": 0.2, "precurvature": (5, 1, 0)}
    two = mr.ConcentricTubes([mr.Rod(bending_stiffness=0.01, torsional_stiffness=0.008, **tube)] * 2)
    one = mr.SingleRod(mr.Rod(bending_stiffness=0.02, torsional_stiffness=0.016, **tube))
    load = {"tip_force": (0.05, 0.02, -0.03)}
    found, expected = mr.solve(two, two.inputs(**load)), mr.solve(one, one.inputs(**load))
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=1e-9 * 0.2)
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-7)


def test_sensitivities_are_derivatives(pair):
    values = {"rotation": (0.3, 1.2), "translation": (-0.15, -0.12), "tip_force": (0.1, 0.05, 0.02)}
    solution = mr.solve(pair, pair.inputs(**values)).raise_if_failed()
    for name, k, step in (("rotation", 0, 1e-4), ("rotation", 1, 1e-4), ("translation", 0, 1e-5), ("tip_force", 2, 1e-4)):
        ends = []
        for sign in (1, -1):
            moved = {key: np.array(value, float) for key, value in values.items()}
            moved[name][k] += sign * step
            ends.append(mr.solve(pair, pair.inputs(**moved), guess=solution).tip_position)
        # central differences of an integration good to 1e-8: 1e-9/step beside the third derivative
        np.testing.assert_allclose(solution.jacobian(name)[:3, k], (ends[0] - ends[1]) / (2 * step), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("solver", [mr.Observer(), mr.ScipyShooting(tolerance=1e-8)], ids=["observer", "scipy"])
def test_other_solvers_find_the_same_equilibrium(pair, solver):
    inputs = pair.inputs(rotation=(0.3, 1.2), translation=(-0.15, -0.12), tip_force=(0.1, 0.05, 0.02))
    newton = mr.solve(pair, inputs).raise_if_failed()
    found = mr.solve(pair, inputs, solver=solver).raise_if_failed()
    # the squared residual is flat at its root: SciPy stops at the root of its tolerance
    np.testing.assert_allclose(
        found.tip_position, newton.tip_position, rtol=0, atol=1e-8 if isinstance(solver, mr.Observer) else 1e-5
    )


def test_a_batch_of_translations_is_bitwise_what_each_is_alone(pair):
    translation = np.array([(-0.15, -0.12), (-0.18, -0.13), (-0.12, -0.1)])
    together = mr.solve(pair, pair.inputs(rotation=(0.3, 1.2), translation=translation))
    for k in range(3):
        alone = mr.solve(pair, pair.inputs(rotation=(0.3, 1.2), translation=translation[k]))
        np.testing.assert_array_equal(together.unknowns[k], alone.unknowns)
        np.testing.assert_array_equal(together.tip_position[k], alone.tip_position)


def test_a_section_of_no_length_is_harmless(pair):
    curve, tiny = (9, 0, 0), 1e-12
    cut = mr.Rod(
        length=0.3 + tiny,
        bending_stiffness=INNER.sections[0].bending_stiffness[0],
        torsional_stiffness=float(INNER.sections[0].torsional_stiffness),
        precurvature=[(0.2, (0, 0, 0)), (tiny, (100, 0, 0)), (0.1, curve)],
    )
    values = {"rotation": (0.3, 1.2), "translation": (-0.15, -0.12), "tip_force": (0.1, 0.05, 0.02)}
    robot = mr.ConcentricTubes([cut, OUTER])
    np.testing.assert_allclose(
        mr.solve(robot, robot.inputs(**values)).tip_position,
        mr.solve(pair, pair.inputs(**values)).tip_position,
        rtol=0,
        atol=1e-9,
    )


@pytest.mark.parametrize(
    ("translation", "message"),
    [
        ((0.01, -0.1), r"translation\[0\] = 0\.01 is not allowed: must be <= 0"),
        ((-0.1, -0.21), r"translation\[1\] = -0\.21 is not allowed: must be > -length = -0\.2 m: the tube is pulled out"),
        ((-0.1, -0.12), r"translation\[0\] = -0\.1 is not allowed: must be <= translation\[1\]"),
    ],
)
def test_translations_that_cannot_be_are_refused(pair, translation, message):
    with pytest.raises(ValueError, match=message):
        pair.inputs(translation=translation)


def test_tubes_that_do_not_nest_are_refused():
    with pytest.raises(ValueError, match=r"tubes\[0\]\.outer_diameter = 0\.0016 is not allowed: must be <= the inner diameter"):
        mr.ConcentricTubes([OUTER, INNER])
    with pytest.raises(ValueError, match="must be 1 to 6"):
        mr.ConcentricTubes([])
    with pytest.raises(TypeError, match="list of Rod"):
        mr.ConcentricTubes(INNER)
    with pytest.raises(ValueError, match="shear_stiffness and axial_stiffness must be inf"):
        mr.ConcentricTubes([mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=1, axial_stiffness=10)])


def test_problem_is_that_of_one_backbone(pair):
    problem = pair.problem(pair.inputs(tip_force=(0, 0, 1)), integrator=mr.RK4(20))
    assert isinstance(problem, BackboneProblem)
    assert problem.unknown_count == 4
