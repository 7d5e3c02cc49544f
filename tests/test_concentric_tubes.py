"""Concentric tubes through the public classes: reference cases, refusals, sensitivities, every solver."""

from itertools import pairwise

import numpy as np
import pytest

import multirod as mr
from multirod.models.backbone.problem import BackboneProblem

# Turned from aligned under full load; the branch that was followed is another stable one of the listed.
OTHER_LISTED = {"09d_ctr_three_tube_strong_3"}
# Opposite tubes, more strongly curved than L sqrt(c) = pi/2: the symmetric branch, which is stored, has lost its stability.
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
        solution.raise_if_failed()
        rates = case["expected"]["base_torsion_rates"]["value"]
        solution = mr.solve(robot, inputs, guess=(0, 0, *rates))
    expected, length = case["expected"], max(tube["length"] for tube in case["inputs"]["tubes"])
    solution.raise_if_failed()
    if stored in OTHER_LISTED:
        listed = [other for other in expected["all_solutions"]["value"] if other["stable"]]
        gaps = [np.linalg.norm(solution.tip_position - other["tip_position"]) for other in listed]
        assert min(gaps) < 1e-6 * length
        found = mr.equilibria(robot, inputs)
        place = np.argmin(np.linalg.norm(found.tip_position - solution.tip_position, axis=1))
        assert found.stability[place] == mr.Stability.STABLE
        return
    np.testing.assert_allclose(solution.tip_position, expected["tip_position"]["value"], rtol=0, atol=1e-6 * length)
    np.testing.assert_allclose(solution.tip_rotation, expected["tip_rotation_of_longest_tube"]["value"], rtol=0, atol=1e-6)


def test_where_tubes_snap_does_not_depend_on_a_coarse_integration(reference_cases, make_pose):
    case = next(c for c in reference_cases("concentric_tubes") if c["id"] == "14i_ctr_near_fold_1e-06")
    robot, inputs = assembly(case["inputs"], make_pose)
    snap = 3.66305637248192  # as the case says: sqrt(1 - 1e-6) of it is the case
    turned = robot.inputs(rotation=[(0, snap - 2e-6), (0, snap + 2e-6)], translation=inputs.translation)
    # alone, this integrator has them snap 1.4e-5 later, and their tip off by 9.5e-5 where they do not
    found = mr.solve(robot, turned, solver=mr.Shooting(integrator=mr.RK45(1e-5, 1e-7)))
    np.testing.assert_array_equal(found.status, [mr.Status.CONVERGED, mr.Status.LOWEST_ENERGY])
    exact = mr.solve(robot, turned[0], solver=mr.Shooting(tolerance=1e-12, integrator=mr.RK45(1e-12, 1e-14)))
    np.testing.assert_allclose(found.tip_position[0], exact.tip_position, rtol=0, atol=1e-6)


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
    force = {"rotation": 0.4, "tip_force": (0.3, 0.2, 0.1), "tip_moment": (0.01, -0.02, 0.03)}
    tubes, rod = mr.ConcentricTubes([wire]), mr.SingleRod(wire)
    one, other = mr.solve(tubes, tubes.inputs(**force)), mr.solve(rod, rod.inputs(**force))
    # two kernels, as a tube has a transmission: what residuals of 1e-9 1/m leave open
    np.testing.assert_allclose(one.tip_position, other.tip_position, rtol=0, atol=1e-9 * 0.4**2)


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


@pytest.mark.parametrize("translation", [(0.0, 0.0), (-0.05, 0.0), (-0.2, -0.1), (-0.2 + 1e-16, -0.1 + 3e-17)])
def test_tubes_whose_base_or_section_ends_at_the_plate_twist_behind_it_as_they_are_pulled_back(translation):
    """Their columns are of that side, of twist and shape alike: against differences of fourth order, of poses alone."""
    straight, curved = (0.1, (0, 0, 0.8)), (0.12, (9.0, 0, 0))
    inner = mr.Rod(length=0.32, bending_stiffness=0.01, torsional_stiffness=0.0077, precurvature=[(0.2, (0, 0, 0.5)), curved])
    outer = mr.Rod(length=0.17, bending_stiffness=0.03, torsional_stiffness=0.023, precurvature=[straight, (0.07, (5.0, 2.0, 0))])
    robot = mr.ConcentricTubes([inner, outer])
    solver = mr.Shooting(integrator=mr.RK45(rtol=1e-11, atol=1e-12))

    def solved(back):
        where = np.array(translation) - back
        inputs = robot.inputs(rotation=(0.4, -0.9), translation=where, tip_force=(0.3, 0.2, 0.1))
        return mr.solve(robot, inputs, solver=solver).raise_if_failed()

    found, h = solved(0.0).jacobian("translation")[:3], 1e-4
    for direction in np.array([(1.0, 0.0), (1.0, 1.0)]):  # which leave the inner tube's base behind the other's
        tips = [solved(k * h * direction).tip_position for k in range(5)]
        expected = np.array([25 / 12, -4, 3, -4 / 3, 1 / 4]) @ tips / h
        # of 1e-12 of a tip over 1e-4, and of the fourth power of that
        np.testing.assert_allclose(found @ direction, expected, rtol=0, atol=1e-6)


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
        ([(-0.2, -0.12), (-0.1, -0.15)], r"translation\[0\] = -0\.1 at \[1\] is not allowed: must be <= translation\[1\]"),
        ([(-0.1, -0.15)] * 3, r"translation\[0\] = -0\.1 at \[0\], the first of 3, is not allowed: must be <= translation"),
    ],
)
def test_translations_that_cannot_be_are_refused(pair, translation, message):
    with pytest.raises(ValueError, match=message):
        pair.inputs(translation=translation)
    if np.ndim(translation) == 1:
        tracker = mr.Tracker(pair, dt=0.005, inputs=pair.inputs(translation=(-0.15, -0.12)))
        with pytest.raises(ValueError, match=message):
            tracker.step(translation=translation)
        np.testing.assert_array_equal(tracker.inputs.translation, (-0.15, -0.12))


def sized(**diameters):
    return mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.008, **diameters)


@pytest.mark.parametrize(
    ("inner", "outer", "message"),
    [
        (sized(outer_diameter=2e-3), sized(outer_diameter=1.5e-3), r"tubes\[0\]\.outer_diameter = 0\.002 .* must be < the outer"),
        (sized(), sized(outer_diameter=1e-3, inner_diameter=0), r"tubes\[2\]\.inner_diameter = 0\.0 .* must be > 0: tubes\[0\]"),
        (
            sized(outer_diameter=1.2e-3, inner_diameter=1e-3),
            sized(outer_diameter=2e-3, inner_diameter=1.1e-3),
            r"tubes\[0\]\.outer_diameter = 0\.0012 .* must be <= the inner diameter of tubes\[2\]",
        ),
    ],
)
def test_a_wrong_order_is_told_by_the_diameters_of_any_two_tubes(inner, outer, message):
    with pytest.raises(ValueError, match=message):
        mr.ConcentricTubes([inner, sized(), outer])


def test_each_of_a_batch_nests_by_its_own_diameters():
    inner = sized(outer_diameter=[1e-3, 1.2e-3], inner_diameter=5e-4)
    with pytest.raises(ValueError, match=r"tubes\[0\]\.outer_diameter = 0\.0012 .* inner diameter of tubes\[1\], 0\.0011 m"):
        mr.ConcentricTubes([inner, sized(outer_diameter=2e-3, inner_diameter=1.1e-3)])
    assert mr.ConcentricTubes([inner, sized(outer_diameter=2e-3, inner_diameter=[1.1e-3, 1.3e-3])]).batch_shape == (2,)
    with pytest.raises(ValueError, match=r"leading axes \(2,\), \(3,\) do not broadcast"):
        mr.ConcentricTubes([inner, sized(outer_diameter=[2e-3] * 3)])


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
    problem = pair.problem(pair.inputs(tip_force=(0, 0, 1)), integrator=mr.RK45(steps=20))
    assert isinstance(problem, BackboneProblem)
    assert problem.unknown_count == 4


# ---- only what the scene requires, each against the full model ----

KINDS = {"equal": 1.0, "unequal": 1.4}  # EI_y / EI_x


def bent(s):
    return (6 * np.cos(9 * s), 20 * s, 5 - 30 * s)


def three(ratio=1.0, torsion=1.0, bent=bent):
    """Three tubes with sections of different stiffness, also behind the plate, and torsional precurvature."""

    def section(length, EI, curvature):
        return mr.Section(
            length=length, bending_stiffness=(EI, ratio * EI), torsional_stiffness=torsion * 0.8 * EI, precurvature=curvature
        )

    inner = [section(0.04, 0.009, (2, 1, 3)), section(0.1, 0.006, (0, 0, 2)), section(0.08, 0.004, bent)]
    middle = [section(0.03, 0.012, bent), section(0.12, 0.01, (5, -2, 1))]
    outer = [section(0.06, 0.03, (0, 0, -2)), section(0.04, 0.02, (0, 4, 0))]
    return mr.ConcentricTubes([mr.Rod(sections=parts) for parts in (inner, middle, outer)])


EVEN = bent(0.03)  # constant by section, where a test is of something else: kernels that other tests need too
PLACE = {"rotation": (0.3, 1.2, -0.4), "translation": (-0.07, -0.05, -0.02)}
TIGHT = mr.Shooting(tolerance=1e-10, integrator=mr.RK45(1e-11, 1e-13))


def test_without_loads_the_torques_are_all_that_is_unknown():
    robot = three(KINDS["unequal"])
    inputs = robot.inputs(**PLACE)
    solution = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK45(steps=70))).raise_if_failed()
    assert solution.unknown_count == 2
    full = robot.problem(inputs, integrator=mr.RK45(steps=70), enabled=("tip_force", "tip_moment"))
    assert full.unknown_count == 5
    adopted = full.adopt(solution.unknowns[None])
    residual, gamma = full.evaluate(adopted)
    # the same steps on the same grid: to rounding, grown by shooting's condition of 1e3
    assert np.abs(residual).max() < 1e-9
    np.testing.assert_allclose(full.read("position")[0], solution.tip_position, rtol=0, atol=1e-13)
    np.testing.assert_allclose(full.read("rotation")[0].reshape(3, 3), solution.tip_rotation, rtol=0, atol=1e-12)
    # a change of the torques that leaves their sum moves no bending moment: the reduced Gamma stands in the full one
    turn = full.adopt(np.eye(2)).T
    np.testing.assert_allclose((gamma[0] @ turn)[3:], solution.gamma, rtol=0, atol=1e-9 * np.abs(gamma).max())
    np.testing.assert_allclose((gamma[0] @ turn)[:2], 0, rtol=0, atol=1e-9 * np.abs(gamma).max())
    # each tube's moment, at nodes that all have; together they carry none
    length = float(solution.rod(2).arclength[-1])
    world = np.zeros(3)
    for tube in range(3):
        shape = solution.rod(tube, nodes=1001)
        moment = np.einsum("sij,sj->si", shape.rotation, shape.moment)
        at = [np.interp(0.31 * length, shape.arclength, moment[:, j]) for j in range(3)]
        assert np.linalg.norm(at) > 1e-3
        world += at
    # linear interpolation on steps of 1e-4 of the length of moments of up to 0.1 N m
    np.testing.assert_allclose(world, 0, atol=1e-6)


@pytest.mark.parametrize("loads", [{}, {"tip_force": (0.1, 0.2, 0)}])
def test_several_inputs_at_once_are_those_alone_beside_each_other(loads):
    robot = three(bent=EVEN)
    solution = mr.solve(robot, robot.inputs(**PLACE, **loads), solver=TIGHT).raise_if_failed()
    names = ("translation", "rotation", "follower_force", "tip_force")
    found = solution.jacobian(*names)
    assert found.shape == (6, 12)
    for k, name in enumerate(names):
        alone = solution.jacobian(name)
        # without a force, its terms are not compiled in: other sums, and adaptive steps of 1e-12 that Gamma's inverse carries
        np.testing.assert_allclose(found[:, 3 * k : 3 * k + 3], alone, rtol=0, atol=1e-8 * np.abs(alone).max())


MIDDLE_LONGEST = PLACE | {"translation": (-0.131, -0.023, -0.01)}  # no two transitions at one place: see ``docs/model.md``
SENSITIVITIES = [(PLACE, name) for name in ("tip_force", "translation", "follower_force")]


@pytest.mark.parametrize(("place", "name"), [*SENSITIVITIES, (MIDDLE_LONGEST, "translation")])
def test_sensitivities_without_loads(place, name):
    robot = three(KINDS["unequal"]) if name == "translation" else three(bent=EVEN)
    solution = mr.solve(robot, robot.inputs(**place), solver=TIGHT).raise_if_failed()
    found = solution.jacobian(name)
    step = {"rotation": 1e-3, "translation": 1e-4, "tip_moment": 1e-3}.get(name, 1e-2)
    for k in range(3):
        ends = []
        for sign in (1, -1, 2, -2):
            values = dict(place)
            values[name] = np.array(values.get(name, np.zeros(3)), float)
            values[name][k] += sign * step
            ends.append(mr.solve(robot, robot.inputs(**values), solver=TIGHT, guess=solution).raise_if_failed())
        p, m, pp, mm = ends
        slope = (8 * (p.tip_position - m.tip_position) - (pp.tip_position - mm.tip_position)) / (12 * step)
        R = (8 * (p.tip_rotation - m.tip_rotation) - (pp.tip_rotation - mm.tip_rotation)) / (12 * step) @ solution.tip_rotation.T
        turn = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
        # the integrator's 1e-11 over the step, and the fifth derivative
        np.testing.assert_allclose(found[:3, k], slope, rtol=0, atol=1e-6 * np.abs(found).max())
        np.testing.assert_allclose(found[3:, k], np.array(turn) / 2, rtol=0, atol=1e-6 * np.abs(found).max())


RIGID_LOADS = {"tip_force": (0.3, -0.2, 0.1), "tip_moment": (0.01, 0.02, 0.03)}


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
@pytest.mark.parametrize("translation", [(-0.07, -0.05, -0.02), (-0.13, -0.02, -0.01)], ids=["inner longest", "middle longest"])
@pytest.mark.parametrize(("loads", "ratio"), [(RIGID_LOADS, 1.4)], ids=["loaded, unequal"])
def test_tubes_rigid_in_torsion(ratio, loads, translation):
    values = PLACE | {"translation": translation} | loads
    rigid, stiff = three(ratio, np.inf), three(ratio, 1e9)
    found = mr.solve(rigid, rigid.inputs(**values), solver=TIGHT).raise_if_failed()
    full = mr.solve(stiff, stiff.inputs(**values), solver=mr.Shooting(integrator=TIGHT.integrator)).raise_if_failed()
    assert (found.unknown_count, full.unknown_count) == (3, 5 if loads else 2)
    # the torques, of the order of the bending moments, still twist the stiff ones by 1e-9
    np.testing.assert_allclose(found.tip_position, full.tip_position, rtol=0, atol=1e-9 * 0.2)
    np.testing.assert_allclose(found.tip_rotation, full.tip_rotation, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.energy, full.energy, rtol=1e-7)
    for name in ("rotation", "translation", *loads):
        np.testing.assert_allclose(
            found.jacobian(name), full.jacobian(name), rtol=0, atol=1e-6 * np.abs(full.jacobian(name)).max()
        )


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_one_tube_rigid_in_torsion_among_others_is_the_limit():
    def pair_of(GJ):
        return mr.ConcentricTubes(
            [
                mr.Rod(length=0.2, bending_stiffness=0.006, torsional_stiffness=0.005, precurvature=(9, 0, 2)),
                mr.Rod(length=0.15, bending_stiffness=0.02, torsional_stiffness=GJ, precurvature=(4, 2, 0)),
            ]
        )

    values = {"rotation": (0.3, 1.2), "translation": (-0.05, -0.02), "tip_force": (0.1, 0.05, 0.02)}
    one, other = (mr.solve(robot, robot.inputs(**values)).raise_if_failed() for robot in (pair_of(np.inf), pair_of(1e9)))
    assert one.unknown_count == 4
    np.testing.assert_allclose(one.tip_position, other.tip_position, rtol=0, atol=1e-9)


# ---- behind the plate, equation (9) ----


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_a_straight_tube_twists_along_its_whole_length(count):
    """Sections of unequal GJ and torsional precurvature, two of them behind the plate: the closed form of the tip's angle."""
    lengths, GJ, twist = (0.05, 0.04, 0.11), (0.004, 0.002, 0.003), (3.0, -8.0, 5.0)
    parts = [
        mr.Section(length=a, bending_stiffness=0.005, torsional_stiffness=b, precurvature=(0, 0, c))
        for a, b, c in zip(lengths, GJ, twist, strict=True)
    ]
    sheaths = [mr.Rod(length=length, bending_stiffness=0.02, torsional_stiffness=0.01) for length in (0.12, 0.1)]
    robot = mr.ConcentricTubes([mr.Rod(sections=parts), *sheaths][:count])
    beta, torque = -0.07, 0.02
    # what pulls along the tube changes nothing
    loads = {"tip_force": (0, 0, 0.1), "tip_moment": (0, 0, torque)} | ({"distributed_force": (0, 0, 0.3)} if count > 1 else {})
    inputs = robot.inputs(rotation=(0.4, 0, 0)[:count], translation=(beta, -0.01, 0)[:count], **loads)
    solution = mr.solve(robot, inputs).raise_if_failed()
    angle = 0.4 + sum(a * (torque / b + c) for a, b, c in zip(lengths, GJ, twist, strict=True))
    expected = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    np.testing.assert_allclose(solution.tip_rotation, expected, rtol=0, atol=1e-8)
    np.testing.assert_allclose(solution.tip_position, (0, 0, sum(lengths) + beta), rtol=0, atol=1e-12)
    # pushing the tube moves its sections past the plate, and turns nothing; the torque turns all of it
    slide = solution.jacobian("translation")[:, 0]
    np.testing.assert_allclose(slide, (0, 0, 1, 0, 0, 0), rtol=0, atol=1e-7)
    compliance = sum(a / b for a, b in zip(lengths, GJ, strict=True))
    np.testing.assert_allclose(solution.jacobian("tip_moment")[5, 2], compliance, rtol=1e-8)


def test_the_sensitivity_changes_where_a_section_passes_the_plate():
    """A straight tube in a curved one: its twist behind the plate, u*_z there, is the tip's turn against its base."""
    robot = three(KINDS["unequal"])
    for beta in (-0.04 - 1e-7, -0.04 + 1e-7):
        values = {"rotation": PLACE["rotation"], "translation": np.array([beta, -0.02, -0.01])}
        solution = mr.solve(robot, robot.inputs(**values), solver=TIGHT).raise_if_failed()
        found = solution.jacobian("translation")[:3, 0]
        step = np.copysign(1e-4, beta + 0.04)  # away from the section's end
        ends = []
        for k in (1, 2, 3, 4):
            values["translation"][0] = beta + k * step
            ends.append(mr.solve(robot, robot.inputs(**values), solver=TIGHT, guess=solution).raise_if_failed().tip_position)
        slope = (-25 * solution.tip_position + 48 * ends[0] - 36 * ends[1] + 16 * ends[2] - 3 * ends[3]) / (12 * step)
        np.testing.assert_allclose(found, slope, rtol=0, atol=1e-6)


# ---- unknowns of one problem as those of another ----


def test_a_tracker_takes_up_loads_one_after_the_other():
    robot = three(bent=EVEN)
    solver = mr.Shooting(integrator=mr.RK45(steps=40))
    tracker = mr.Tracker(robot, solver=solver, dt=0.005, inputs=robot.inputs(**PLACE))
    sizes = [tracker.step().unknown_count]
    for load in ({"tip_force": (0.02, 0.01, 0)}, {"follower_force": (0, 0.01, 0.02)}, {"gravity": (0, 0, 0)}):
        solution = tracker.step(**load).raise_if_failed()
        sizes.append(solution.unknown_count)
        alone = mr.solve(robot, solution.inputs, solver=solver, guess=solution)
        np.testing.assert_allclose(solution.tip_position, alone.tip_position, rtol=0, atol=1e-9)
        assert solution.iterations <= 4
    assert sizes == [2, 5, 8, 8]


@pytest.mark.parametrize("robot", [three(bent=EVEN), mr.SingleRod(INNER)], ids=["tubes", "rod"])
def test_a_follower_force_of_zero_changes_no_equilibrium(robot):
    place = PLACE if robot.rod_count > 1 else {"rotation": 0.3}
    dead = robot.inputs(**place, tip_force=(0.1, 0.05, -0.02))
    integrator = mr.RK45(steps=60)
    solution = mr.solve(robot, dead, solver=mr.Shooting(integrator=integrator)).raise_if_failed()
    with_force = robot.problem(dead, integrator=integrator, enabled=("follower_force",))
    residual, _ = with_force.evaluate(with_force.adopt(solution.unknowns[None]))
    assert with_force.unknown_count == solution.unknown_count + 3
    assert np.abs(residual).max() < 1e-8  # the tolerance of 1e-9, and rounding
    again = robot.problem(dead, integrator=integrator)
    back = again.adopt(with_force.read("unknowns"))[0]
    assert mr.solve(robot, dead, solver=mr.Shooting(integrator=integrator), guess=back).integrations == 1
    with pytest.raises(ValueError, match=rf"guess = .* is not allowed: must have shape \(\.\.\., {len(back)}\)"):
        mr.solve(robot, dead, guess=with_force.read("unknowns")[0])  # these are of other inputs


@pytest.mark.parametrize("robot", [three(bent=EVEN), mr.SingleRod(INNER)], ids=["tubes", "rod"])
def test_an_unloaded_robot_takes_the_unknowns_of_a_loaded_one(robot):
    """Also those of a force that follows the tip, which it has not: it leaves them out."""
    place = PLACE if robot.rod_count > 1 else {"rotation": 0.3}
    integrator = mr.RK45(steps=60)
    alone = robot.problem(robot.inputs(**place), integrator=integrator)
    more = robot.problem(robot.inputs(**place), integrator=integrator, enabled=("follower_force",)).guess()[0]
    solver = mr.Shooting(integrator=integrator)
    guessed = mr.solve(robot, robot.inputs(**place), solver=solver, guess=more).raise_if_failed()
    kept = mr.solve(robot, robot.inputs(**place), solver=solver, guess=alone.adopt(more[None])[0])
    assert len(more) > guessed.unknown_count
    np.testing.assert_array_equal(guessed.unknowns, kept.unknowns)


def test_unknowns_that_fit_no_problem_are_refused(pair):
    for inputs in (pair.inputs(), pair.inputs(tip_force=(0, 0, 1))):
        with pytest.raises(ValueError, match=r"guess = array of shape \(1, 3\) is not allowed: must have shape \(\.\.\., "):
            mr.solve(pair, inputs, guess=(1, 2, 3))


# ---- the grid ----


@pytest.mark.parametrize("ratio", KINDS.values(), ids=KINDS)
@pytest.mark.parametrize("translation", [(-0.071, -0.052, -0.023), (-0.13, -0.021, -0.0017), (-0.0391, -0.0391, 0)])
def test_order_with_ends_anywhere(ratio, translation):
    robot = three(ratio)
    inputs = robot.inputs(rotation=PLACE["rotation"], translation=translation, tip_force=(0.3, -0.2, 0.1))
    values = []
    for steps in (48, 96, 192, 384):
        problem = robot.problem(inputs, integrator=mr.RK4(steps))
        residual, gamma = problem.evaluate(np.array([[2.0, -3.0, 1.5, -1.0, 2.0]]))
        values.append(np.concatenate([residual[0], 10 * problem.read("position")[0], gamma.ravel() / 10]))
    errors = [np.linalg.norm(a - b) for a, b in pairwise(values)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert errors[-1] > 1e-12, "rounding, not truncation: take fewer steps"
    assert ((orders > 3.9) & (orders < 4.1)).all(), orders


@pytest.mark.parametrize("size", [1e-12, 1e-300])
@pytest.mark.parametrize("where", [0, 1, 2])
def test_sections_of_next_to_no_length_change_nothing(size, where):
    def robot(extra):
        parts = [(0.06, (1, 2, 3)), (0.08, (9, 0, 2))]
        parts[where:where] = extra
        common = {"bending_stiffness": 0.006, "torsional_stiffness": 0.005}
        inner = mr.Rod(sections=[mr.Section(length=a, precurvature=c, **common) for a, c in parts])
        return mr.ConcentricTubes([inner, OUTER])

    values = {"rotation": (0.3, 1.2), "translation": (-0.06, -0.06), "tip_force": (0.1, 0.05, 0.02)}
    solver = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(steps=50))
    plain, cut = robot([]), robot([(size, (50, -30, 20))])
    expected = mr.solve(plain, plain.inputs(**values), solver=solver).raise_if_failed().tip_position
    found = mr.solve(cut, cut.inputs(**values), solver=solver).raise_if_failed().tip_position
    # 1e-12 m of 50 1/m turns by 5e-11 and moves the tip by 5e-12 m; beside that, rounding
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 if size == 1e-12 else 1e-14)


@pytest.mark.parametrize("gap", [1e-10, -1e-10, 0.0])
def test_transition_points_that_differ_by_next_to_nothing(pair, gap):
    """Where the outer and the inner tube begin to be curved: 0.05 m and 0.05 m + gap past the plate."""
    values = {"rotation": (0.3, 1.2), "translation": (-0.15, -0.08 + gap), "tip_force": (0.1, 0.05, 0.02)}
    solver = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(steps=64))
    found = mr.solve(pair, pair.inputs(**values), solver=solver).raise_if_failed()
    values["translation"] = (-0.15, -0.08)
    expected = mr.solve(pair, pair.inputs(**values), solver=solver)
    # the tip moves with the tube, at 10 1/m times the way and 0.1 m
    np.testing.assert_allclose(found.tip_position, expected.tip_position, rtol=0, atol=2 * abs(gap) + 1e-13)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("gap", [1e-16, -1e-16])
def test_the_innermost_of_tubes_that_end_together_but_for_rounding_is_loaded(gap, held):
    """A length and a translation, or sections, are summed with rounding: it must not choose the tube that a load twists."""
    inner = mr.Rod(length=0.375, bending_stiffness=0.05, torsional_stiffness=0.04, precurvature=(4, 0, 0))
    outer = mr.Rod(length=0.25, bending_stiffness=0.08, torsional_stiffness=0.06, precurvature=(3, 0, 0))
    tubes = mr.ConcentricTubes([inner, outer])
    leg = mr.Rod(length=0.25, bending_stiffness=0.05, torsional_stiffness=0.04)
    beside = np.eye(4)
    beside[0, 3] = 0.05
    robot = mr.ParallelRods(legs=[tubes, leg], base=[np.eye(4), beside], platform=[np.eye(4), beside]) if held else tubes
    values = {"rotation": (1.0, -0.5, 0.0)[: 3 if held else 2], "tip_moment": (0.02, 0.0, 0.05), "tip_force": (0.0, 0.3, 0.1)}

    def solved(over):
        translation = np.array([over - 0.125, 0.0, 0.0])[: 3 if held else 2]
        solution = mr.solve(robot, robot.inputs(**values, translation=translation)).raise_if_failed()
        return solution, solution.jacobian("tip_moment")

    together, further = solved(0.0), solved(1e-9)  # where the innermost reaches further
    assert 0.375 + (gap - 0.125) != 0.25
    for (solution, jacobian), apart in ((solved(gap), 1e-13), (further, 1e-7)):
        assert solution.stability == together[0].stability
        # the way between, times how much the tip moves with it; beside that, rounding and where solves end
        np.testing.assert_allclose(solution.tip_position, together[0].tip_position, rtol=0, atol=apart + 1e-9)
        np.testing.assert_allclose(jacobian, together[1], rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("force", [(0.0, 0.0, 0.0), (0.0, 0.3, 0.1)])
def test_tubes_that_end_together_but_for_rounding_are_as_stable_as_together(force):
    """Which angles are free at the tip is told alike: one that is free a hair before it is no part of what resists there."""
    long, short, outer = (
        mr.Rod(length=length, bending_stiffness=0.05, torsional_stiffness=0.04, precurvature=(6, 0, 0))
        for length in (0.375, 0.2, 0.25)
    )
    robot = mr.ConcentricTubes([long, short, outer])
    translation = np.zeros((3, 3))
    translation[:, 0] = [-0.125, -0.125 + 1e-16, -0.125 - 1e-16]
    inputs = robot.inputs(rotation=(0, 1, 2.5), translation=translation, tip_force=force)
    together, *apart = mr.solve(robot, inputs).stability_margin
    assert together > 0.1
    np.testing.assert_allclose(apart, together, rtol=1e-6)  # where solves end


def test_a_loaded_batch_of_three_is_bitwise_what_each_is_alone():
    robot = three(bent=EVEN)
    random = np.random.default_rng(5)
    rotation = random.uniform(-2, 2, (12, 3))
    translation = np.array(PLACE["translation"]) + random.uniform(-0.01, 0.01, (12, 3))
    force = random.uniform(-0.5, 0.5, (12, 3))
    solver = mr.Shooting(integrator=mr.RK45(steps=35))
    together = mr.solve(robot, robot.inputs(rotation=rotation, translation=translation, tip_force=force), solver=solver)
    assert len(set(together.integrations.tolist())) > 2, "all alike: no test of independence"
    for k in range(12):
        inputs = robot.inputs(rotation=rotation[k], translation=translation[k], tip_force=force[k])
        alone = mr.solve(robot, inputs, solver=solver)
        assert alone.status == together.status[k]
        np.testing.assert_array_equal(together.unknowns[k], alone.unknowns)
        np.testing.assert_array_equal(together.tip_position[k], alone.tip_position)


# Loads on tubes of which an outer one reaches furthest: what follows the tip follows that tube, and what twists along the tubes
# twists the innermost that there is.
SHARP = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-11, atol=1e-13))
NEAR_END, FAR_END = 0.12, 0.26  # m in front of the plate
WHERE = {"rotation": np.array([0.6, -0.4]), "translation": np.array([-0.08, -0.05])}
WITH_TIP = {"follower_force": (0.06, 0.2, 0.05), "follower_moment": (0.02, -0.03, 0.01)}


def reaching_tubes(*reaching: float, curvature: float = 6.0) -> mr.ConcentricTubes:
    """Two that reach so far in front of the plate."""
    inner = mr.Rod(length=reaching[0] + 0.08, bending_stiffness=0.004, torsional_stiffness=0.003, precurvature=(0, curvature, 0))
    outer = mr.Rod(length=reaching[1] + 0.05, bending_stiffness=0.012, torsional_stiffness=0.01, precurvature=(curvature, 0, 0))
    return mr.ConcentricTubes([inner, outer])


@pytest.mark.parametrize("count", [3, 31])
def test_a_tip_that_is_drawn_into_a_stiffer_tube_does_not_snap(count: int) -> None:
    """The residual's unit was that of the tubes at the tip, and ``Gamma`` jumped so much that it was taken for another branch."""
    inner = mr.Rod(
        length=0.4, bending_stiffness=0.002, torsional_stiffness=0.0016, precurvature=[(0.3, (0, 0, 0)), (0.1, (8, 0, 0))]
    )
    outer = mr.Rod(
        length=0.32, bending_stiffness=0.03, torsional_stiffness=0.024, precurvature=[(0.25, (0, 0, 0)), (0.07, (5, 0, 0))]
    )
    robot, part = mr.ConcentricTubes([inner, outer]), np.linspace(0, 1, count)
    way = np.stack([-0.217 - 0.025 * part, np.full(count, -0.15)], axis=-1)  # past the other's tip, where it is at -0.23
    history = mr.simulate(robot, robot.inputs(rotation=(0.5, -1), translation=way, tip_force=(0.2, -0.3, 0.1)), time=part)
    assert set(history.status) == {mr.Status.CONVERGED}
    assert not any(history.events)
    assert history.integrations[1:].max() <= 20


@pytest.mark.parametrize("reaching", [(FAR_END, NEAR_END), (NEAR_END, FAR_END)])
@pytest.mark.parametrize("loads", [("follower_force", "follower_moment"), ("follower_moment",)])
def test_what_follows_the_tip_turns_with_its_pose(reaching: tuple[float, float], loads: tuple[str, ...]) -> None:
    """Dead loads that point as these do at their equilibrium leave it as it is."""
    robot = reaching_tubes(*reaching)
    given = {name: np.array(WITH_TIP[name]) for name in loads}
    solution = mr.solve(robot, robot.inputs(**WHERE, **given), solver=SHARP).raise_if_failed()
    dead = {name.replace("follower", "tip"): solution.tip_rotation @ value for name, value in given.items()}
    same = mr.solve(robot, robot.inputs(**WHERE, **dead), solver=SHARP, guess=solution).raise_if_failed()
    # both to 1e-11 of a curvature, which a tip of some 0.3 m in either case multiplies by less than 10
    np.testing.assert_allclose(same.tip_position, solution.tip_position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(same.tip_rotation, solution.tip_rotation, rtol=0, atol=1e-8)
    assert np.linalg.norm(solution.tip_position - mr.solve(robot, robot.inputs(**WHERE)).tip_position) > 5e-3


@pytest.mark.parametrize("reaching", [(FAR_END, NEAR_END), (NEAR_END, FAR_END)])
def test_a_moment_along_straight_tubes_twists_the_innermost_there_is(reaching: tuple[float, float]) -> None:
    """Closed forms: each tube's torque is what acts on it further on, constant behind the plate."""
    robot, l = reaching_tubes(*reaching, curvature=0.0), 0.05
    inputs = robot.inputs(translation=WHERE["translation"], distributed_moment=(0, 0, l))
    solution = mr.solve(robot, inputs, solver=SHARP).raise_if_failed()
    ends, GJ, behind = np.array(reaching), np.array([0.003, 0.01]), np.array([0.08, 0.05])
    borne = np.array([[0.0, ends[0]], [min(ends), max(ends[1], min(ends))]])  # where the moment acts on each
    for k in range(2):
        a, b = borne[k] if ends[k] > borne[k, 0] else (0.0, 0.0)
        torque = l * (b - a)
        angle = torque * (behind[k] + a) / GJ[k] + l * (b - a) ** 2 / (2 * GJ[k])
        shape = solution.rod(k)
        assert -solution.base_torque[k] == pytest.approx(torque, rel=1e-9, abs=1e-13)
        assert np.arctan2(shape.rotation[-1, 1, 0], shape.rotation[-1, 0, 0]) == pytest.approx(angle, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("name", ["rotation", "translation", "follower_force", "follower_moment", "distributed_moment"])
def test_derivatives_by_loads_on_an_outer_tube(name: str) -> None:
    robot = reaching_tubes(NEAR_END, FAR_END)
    loads = {key: np.array(value) for key, value in WITH_TIP.items()} | {"distributed_moment": np.array([0.03, -0.02, 0.08])}
    values = WHERE | loads
    solution = mr.solve(robot, robot.inputs(**values), solver=SHARP).raise_if_failed()
    exact, step = solution.jacobian(name), 1e-3 if name in ("rotation", "follower_force") else 1e-4
    for k, column in enumerate(exact.T):
        ends = []
        for h in (1, -1, 2, -2):
            moved = values[name].copy()
            moved[k] += h * step
            ends.append(mr.solve(robot, robot.inputs(**values | {name: moved}), solver=SHARP, guess=solution).raise_if_failed())
        near, far = (
            np.append(a.tip_position - b.tip_position, (a.tip_rotation - b.tip_rotation) @ solution.tip_rotation.T)
            for a, b in (ends[:2], ends[2:])
        )
        slope = (8 * near - far) / (12 * step)
        turn = slope[3:].reshape(3, 3)
        found = np.append(slope[:3], (turn[2, 1], turn[0, 2], turn[1, 0]))
        # differences of fourth order, by steps of a hundredth of what acts or less
        np.testing.assert_allclose(column, found, rtol=0, atol=1e-7 * np.abs(exact).max())
