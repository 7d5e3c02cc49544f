"""Robots fitted to shapes, against rods that are integrated by ``measured_rods``."""

import re

import numpy as np
import pytest
from measured_rods import MeasuredRod, turned_by
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

import multirod as mr

POSITION, ANGLE = 1e-4, 1e-3
NONE = (0, 0, 1e-9)  # N
FITTED = ("bending_stiffness", "torsional_stiffness", "precurvature")
TWISTING = {"torsional_stiffness": 0.063814, "precurvature": (14, 5, 0)}
REAL = {"bending_stiffness": 0.24, "torsional_stiffness": 0.06, "precurvature": (14.4, 4.7, 0.15)}


@pytest.fixture(scope="module")
def shapes():
    """Forces, and what a noisy sensor says of the pose that each leads to of another wire than the one that is fitted."""
    random = np.random.default_rng(3)
    force = random.normal(size=(12, 3))
    position, rotation, _, _ = MeasuredRod(0.4, **REAL).seen(force)
    position = position + POSITION * random.normal(size=(12, 3))
    return force, position, turned_by(ANGLE * random.normal(size=(12, 3))) @ rotation


def poses(shapes):
    return mr.Pose(position=shapes[1], rotation=shapes[2], sigma=(POSITION, ANGLE))


def test_a_wire_is_found_by_its_shapes(wire, shapes):
    robot = mr.SingleRod(wire)
    fit = mr.calibrate(robot, robot.inputs(tip_force=shapes[0]), parameters=FITTED, measured=poses(shapes)).raise_if_failed()
    truth = [0.24 / 0.223349, 0.06 / 0.063814, 14.4, 4.7, 0.15]
    found = np.concatenate([fit.value(name) for name in FITTED])
    error = found - truth
    # five normal numbers: 99.9 % of their squares' sums are below 20
    assert error @ np.linalg.solve(fit.covariance(), error) < 20
    # 67 squares: four standard deviations
    assert abs(fit.misfit - 67) < 4 * np.sqrt(2 * 67)
    assert fit.degrees == 67
    assert all(own.all() for own in fit.observable.values())
    section = fit.robot.rod.sections[0]
    np.testing.assert_allclose(section.bending_stiffness, 0.223349 * found[0])
    np.testing.assert_allclose(section.precurvature, found[2:])
    np.testing.assert_allclose(fit.solution.tip_position, mr.solve(fit.robot, fit.solution.inputs).tip_position, atol=1e-8)
    np.testing.assert_array_equal(robot.rod.sections[0].precurvature, (14, 5, 0))
    assert "precurvature y, section 1 [1/m]" in repr(fit)
    # what is told of stiffnesses is over what they were: seen from the fitted robot, over what they are
    again = mr.calibrate(fit.robot, fit.solution.inputs, parameters=FITTED, measured=poses(shapes), guess=fit.solution)
    for name in FITTED[:2]:
        np.testing.assert_allclose(fit.sigma(name), again.sigma(name) * fit.value(name), rtol=1e-3)
    # a step of all shapes takes one integration of each
    assert fit.iterations <= 5


def test_a_model_that_cannot_explain_the_shapes_is_fitted_as_well_as_it_can_be(wire, shapes):
    """The stiffness alone, of a wire whose precurvature is another: the squares on the way are less than at any equilibrium."""
    robot = mr.SingleRod(wire)
    fit = mr.calibrate(robot, robot.inputs(tip_force=shapes[0]), parameters="bending_stiffness", measured=poses(shapes))
    fit.raise_if_failed()

    def square(factor):
        softer = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.223349 * factor, **TWISTING))
        tips = mr.solve(softer, softer.inputs(tip_force=shapes[0]))
        turned = Rotation.from_matrix(shapes[2] @ tips.tip_rotation.swapaxes(1, 2)).as_rotvec()
        return float(((tips.tip_position - shapes[1]) ** 2).sum() / POSITION**2 + (turned**2).sum() / ANGLE**2)

    least = minimize_scalar(square, bracket=(1.0, 1.1), tol=1e-8)
    # a step that is no longer than a hundredth of a standard deviation is the last
    assert fit.value("bending_stiffness")[0] == pytest.approx(least.x, abs=0.02 * fit.sigma("bending_stiffness")[0])
    assert fit.misfit == pytest.approx(least.fun, rel=1e-6)
    assert not fit.consistent


def far_off(wire, real, parameter):
    """One parameter of the wire fitted to six poses of another that it cannot explain; what it leaves, by ``measured_rods``."""
    robot, force = mr.SingleRod(wire), 2 * np.random.default_rng(3).normal(size=(6, 3))
    position, rotation, _, _ = MeasuredRod(0.4, 0.24, 0.06, real).seen(force)
    seen = mr.Pose(position=position, rotation=rotation, sigma=(POSITION, ANGLE))

    def square(factor):
        tips, turned, _, _ = MeasuredRod(0.4, **TWISTING | {"bending_stiffness": 0.223349 * factor}).seen(force)
        off = Rotation.from_matrix(turned @ rotation.swapaxes(1, 2)).as_rotvec()
        return float(((tips - position) ** 2).sum() / POSITION**2 + (off**2).sum() / ANGLE**2)

    return mr.calibrate(robot, robot.inputs(tip_force=force), parameters=parameter, measured=seen), square


def test_steps_that_overshoot_are_taken_at_equilibria_alone(wire):
    """(21) Where misfits are large, a step of Gauss and Newton's leads beyond the least of (1), to and fro: it was
    ``MAX_ITERATIONS`` beside that."""
    fit, square = far_off(wire, (17, 2, -4), "bending_stiffness")
    fit.raise_if_failed()
    least = minimize_scalar(square, bracket=(0.6, 0.65), tol=1e-8)
    # a hundredth of a standard deviation is where steps end; of tens of thousands, the model integrates to a few
    assert fit.value("bending_stiffness")[0] == pytest.approx(least.x, abs=1e-4)
    assert fit.misfit == pytest.approx(least.fun, rel=1e-5)
    assert not fit.consistent


def test_a_fit_that_leads_to_no_end_says_so(wire):
    """The stiffer the wire the less is left: its stiffness grows beyond all numbers, where there was a warning of NumPy's."""
    fit, square = far_off(wire, (16, 9, 3), "bending_stiffness")
    assert square(1e2) > square(1e3) > square(1e4)
    assert fit.status is mr.Status.STALLED


def test_the_base_is_found_with_the_load_staying_where_it_is(wire, shapes, make_pose):
    base = make_pose((0.1, -0.2, 0.3), (0.01, -0.02, 0.005))
    robot = mr.SingleRod(wire)
    inputs = robot.inputs(tip_force=shapes[0][:6])
    moved = mr.solve(mr.SingleRod(wire, base=base), inputs)
    seen = mr.Pose(position=moved.tip_position, rotation=moved.tip_rotation, sigma=(POSITION, ANGLE))
    known = {"base": mr.Prior(), "bending_stiffness": mr.Prior(sigma=0.2)}
    fit = mr.calibrate(robot, inputs, parameters=known, measured=seen)
    np.testing.assert_allclose(fit.robot.base, base, atol=1e-6)
    np.testing.assert_allclose(fit.value("base"), (0.01, -0.02, 0.005, 0.1, -0.2, 0.3), atol=1e-6)
    np.testing.assert_allclose(fit.value("bending_stiffness"), 1, atol=1e-3)


def test_a_base_that_is_turned_far_turns_on_about_itself(wire):
    """(13) By differences: its columns are by what turns it in the world, its numbers those of one rotation vector."""
    from multirod.rotations import vectors
    from multirod.tasks.estimating.parameters import Parameters

    robot = mr.SingleRod(wire)
    numbers = Parameters(robot, {"base": mr.Prior()})
    p, h = np.array([0.1, 0.2, -0.1, 0.4, -0.7, 0.9]), 1e-6
    columns = numbers.columns(numbers.robot(p), p)
    for k in range(6):
        ends = [numbers.robot(p + sign * h * np.eye(6)[k]).base for sign in (1, -1)]
        turned = vectors((ends[0][:3, :3] @ ends[1][:3, :3].T)[None])[0]
        moved = ends[0][:3, 3] - ends[1][:3, 3]
        np.testing.assert_allclose(columns[:, k], np.concatenate([moved, turned]) / (2 * h), atol=1e-8)


def test_a_shape_that_does_not_fit_the_others_is_named(wire, shapes, tmp_path):
    """(26) One that was measured 50 mm off; also read from a file."""
    robot, inputs = mr.SingleRod(wire), mr.SingleRod(wire).inputs(tip_force=shapes[0])
    position = np.array(shapes[1])
    position[7] += (0.05, 0, 0)
    fit = mr.calibrate(robot, inputs, parameters=FITTED, measured=poses((shapes[0], position, shapes[2])))
    assert not fit.consistent
    said = "without shape 7 the others fit"
    assert said in repr(fit)
    fit.save(tmp_path / "fit.npz")
    assert said in repr(mr.load(tmp_path / "fit.npz"))


def test_what_shapes_do_not_tell_keeps_its_prior(wire, shapes):
    """Without a load the stiffnesses do nothing; a shape whose sensor dropped out counts for nothing."""
    robot = mr.SingleRod(wire)
    hardly = robot.inputs(rotation=(0.0, 0.5), tip_force=(1e-9, 0, 0))  # so that kernels are those of a force
    rest = mr.solve(robot, hardly)
    position = np.array(rest.tip_position)
    position[1] = np.nan
    seen = mr.Pose(position=position, rotation=rest.tip_rotation, sigma=(POSITION, ANGLE))
    known = {"bending_stiffness": mr.Prior(sigma=0.1), "precurvature": mr.Prior()}
    fit = mr.calibrate(robot, hardly, parameters=known, measured=seen)
    np.testing.assert_array_equal(fit.missing, [[False], [True]])
    assert fit.degrees == 6
    np.testing.assert_allclose(fit.sigma("bending_stiffness"), 0.1, rtol=1e-9)
    assert not fit.observable["bending_stiffness"].any()
    assert fit.observable["precurvature"].all()
    assert "(known by its prior alone)" in repr(fit)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"parameters": "stiffness"}, TypeError, "takes no 'stiffness': it takes bending_stiffness"),
        ({"parameters": ()}, TypeError, "parameters = "),
        ({"parameters": {"base": 0.1}}, TypeError, "must be a Prior"),
        ({"parameters": {"base": mr.Prior(0, sigma=1)}}, ValueError, "it is what the robot has"),
        ({"parameters": ("base", "precurvature")}, ValueError, "9 numbers without a prior.*at most as many as are measured, 6"),
        ({"measured": mr.Pose(position=np.full(3, np.nan), sigma=1e-3)}, ValueError, "NaN in all rows"),
    ],
)
def test_bad_input(wire, options, error, message):
    robot = mr.SingleRod(wire)
    seen = mr.Pose(position=(0, 0, 0.4), rotation=np.eye(3), sigma=(1e-3, 1e-2))
    with pytest.raises(error, match=message):
        mr.calibrate(robot, **({"parameters": "precurvature", "measured": seen} | options))


def test_a_stiffness_is_found_by_curvatures_of_several_shapes():
    """Of a rod of two sections, by what another that is stiffer says along itself."""

    def made(factor):
        stiffness = {"bending_stiffness": 0.2 * factor, "torsional_stiffness": 0.06}
        return mr.SingleRod(mr.Rod(sections=[mr.Section(length=0.2, **stiffness), mr.Section(length=0.1, **stiffness)]))

    force = np.random.default_rng(1).normal(size=(5, 3))
    real, robot = made(1.2), made(1.0)
    shape = mr.solve(real, real.inputs(tip_force=force)).rod(0, nodes=301)
    sensor = mr.Curvature(at=(0.1, 0.25), value=shape.curvature[:, [100, 250], :2], sigma=1e-2)
    fit = mr.calibrate(robot, robot.inputs(tip_force=force), parameters="bending_stiffness", measured=sensor).raise_if_failed()
    np.testing.assert_allclose(fit.value("bending_stiffness"), 1.2, rtol=1e-4)


def test_numbers_that_are_hardly_seen_are_named_where_they_lead_nowhere():
    """The torsional stiffness of a straight rod that next to nothing twists, by positions alone."""
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))
    real = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.25, torsional_stiffness=0.0638))
    force, moment = np.array([(0.3, 0, 0), (0.2, 0, 0), (0.1, 0, 0.1)]), np.array([(0, 0, 1e-7)] * 3)
    inputs = robot.inputs(tip_force=force, tip_moment=moment)
    tips = mr.solve(real, real.inputs(tip_force=force, tip_moment=moment))
    seen = mr.Pose(position=tips.tip_position + (0, 1e-5, 0), sigma=POSITION)
    fit = mr.calibrate(robot, inputs, parameters=("bending_stiffness", "torsional_stiffness"), measured=seen)
    assert fit.failed
    with pytest.raises(mr.SolveError):
        _ = fit.robot
    assert not any(own.any() for own in fit.observable.values())
    with pytest.raises(mr.SolveError, match="next to nothing of rod 1: torsional_stiffness.*: give these a Prior"):
        fit.raise_if_failed()
    assert "give these a Prior" in repr(fit)
    fitted = {"bending_stiffness": mr.Prior(), "torsional_stiffness": mr.Prior(sigma=0.3)}
    known = mr.calibrate(robot, inputs, parameters=fitted, measured=seen).raise_if_failed()
    assert known.value("bending_stiffness")[0] == pytest.approx(0.25 / 0.2233, abs=4 * known.sigma("bending_stiffness")[0])


def test_one_rod_of_several_is_fitted_by_priors(make_pose):
    """Of the others the prior leaves nothing to be found."""
    legs = [mr.Rod(length=0.3, bending_stiffness=0.05, torsional_stiffness=0.04) for _ in range(3)]
    places = [make_pose((0, 0, 0), (0.06 * np.cos(a), 0.06 * np.sin(a), 0)) for a in (0, 2.1, 4.2)]
    robot = mr.ParallelRods(legs=legs, base=places, platform=places)
    stiffer = mr.Rod(length=0.3, bending_stiffness=0.06, torsional_stiffness=0.04)
    real = mr.ParallelRods(legs=[legs[0], stiffer, legs[2]], base=places, platform=places)
    pulls = {"tip_force": 0.5 * np.array([(1, 0, 0), (0, 1, 0), (1, 1, 0)]), "translation": [0.01, 0, 0]}
    tips = mr.solve(real, real.inputs(**pulls))
    seen = mr.Pose(position=tips.tip_position, rotation=tips.tip_rotation, sigma=(POSITION, ANGLE))
    alone = {"bending_stiffness": mr.Prior(sigma=[1e-9, np.inf, 1e-9])}
    fit = mr.calibrate(robot, robot.inputs(**pulls), parameters=alone, measured=seen).raise_if_failed()
    np.testing.assert_allclose(fit.value("bending_stiffness"), (1, 1.2, 1), atol=1e-4)


def tubes(bending=1.0, torsion=1.0, curvature=1.0):
    """Two tubes that are curved at their ends, their numbers so many times as large."""
    made = []
    for length, EI, GJ, curved in ((0.4, 4e-3, 3e-3, 14), (0.3, 2e-2, 1.6e-2, 6)):
        at_rest = [(length - 0.1, (0, 0, 0)), (0.1, (0, curvature * curved, 0))]
        made.append(mr.Rod(length=length, bending_stiffness=bending * EI, torsional_stiffness=torsion * GJ, precurvature=at_rest))
    return mr.ConcentricTubes(made)


@pytest.fixture(scope="module")
def pulls():
    random = np.random.default_rng(7)
    return {"rotation": (0.5, 0), "translation": (-0.16, -0.12), "tip_force": 0.15 * random.normal(size=(6, 3))}


def test_one_factor_of_all_rods(pulls):
    """A modulus that all tubes share, beside a curvature that all lost a part of; told of by fewer numbers, better known."""
    robot, real = tubes(), tubes(1.2, 1.2, 0.9)
    tips = mr.solve(real, real.inputs(**pulls))
    seen = mr.Pose(position=tips.tip_position, rotation=tips.tip_rotation, sigma=(POSITION, ANGLE))
    modulus, inputs = ("bending_stiffness", "torsional_stiffness"), robot.inputs(**pulls)
    fit = mr.calibrate(robot, inputs, parameters=[modulus, ("precurvature",)], measured=seen).raise_if_failed()
    np.testing.assert_allclose(fit.value(modulus), 1.2, atol=1e-5)
    np.testing.assert_allclose(fit.value(("precurvature",)), 0.9, atol=1e-5)
    np.testing.assert_allclose(fit.robot.rods[1].sections[1].precurvature, (0, 5.4, 0), atol=1e-4)
    np.testing.assert_allclose(fit.robot.rods[0].sections[0].bending_stiffness, 1.2 * 4e-3, rtol=1e-5)
    assert "all rods: bending_stiffness and torsional_stiffness, over what they were" in repr(fit)
    apart = mr.calibrate(robot, inputs, parameters={"bending_stiffness": mr.Prior(sigma=0.5)}, measured=seen)
    assert fit.sigma(modulus)[0] < apart.sigma("bending_stiffness").min()
    axes, part = apart.directions("bending_stiffness")
    left = apart.covariance("bending_stiffness") @ np.linalg.solve(apart._found.prior, axes)
    np.testing.assert_allclose(left, axes * part, atol=1e-9)  # (9): P P0^-1 d = kappa d
    assert 1 >= part[0] > part[-1] > 0


def test_a_mixture_that_is_not_seen_is_named(pulls):
    """Of tubes that nothing loads only ratios of stiffnesses are seen; a load that is none is integrated as others are."""
    robot, real, turned = (
        tubes(),
        tubes(1.1, 1.1, 0.95),
        {"rotation": [(k, 0) for k in (0.5, 1.0, 1.5, 2.0)], "translation": (-0.16, -0.12)},
    )
    tips = mr.solve(real, real.inputs(**turned, tip_force=NONE))
    seen = mr.Pose(position=tips.tip_position, rotation=tips.tip_rotation, sigma=(POSITION, ANGLE))
    names, inputs = ("bending_stiffness", "torsional_stiffness", ("precurvature",)), robot.inputs(**turned, tip_force=NONE)
    blind = mr.calibrate(robot, inputs, parameters=names, measured=seen)
    said = r"a mixture, 0\.50 rod 1: bending_stiffness \+ 0\.50 rod 2: bending_stiffness \+ .*give one of these a Prior"
    assert re.search(said, repr(blind))  # whether it came to an end or not
    known = dict.fromkeys(names[:2], mr.Prior(sigma=0.2)) | {names[2]: mr.Prior()}
    fit = mr.calibrate(robot, inputs, parameters=known, measured=seen).raise_if_failed()
    axes, part = fit.directions()
    assert axes.shape == (5, 4)
    assert not axes[4].any()  # it has no prior
    np.testing.assert_allclose(np.abs(axes[:4, 0]), 0.5, atol=1e-2)
    assert part[0] > 0.99
    assert part[1] < 0.5
    assert "the prior alone tells, 100% of its variance is kept: 0.50 rod 1: bending_stiffness + " in repr(fit)


def test_columns_of_a_factor_are_differences(pulls):
    """(13) Of the tip, by a factor that stiffnesses share and one of the precurvature."""
    from multirod.tasks.estimating.parameters import Parameters

    begin, names = tubes(), ("bending_stiffness", "torsional_stiffness")
    numbers = Parameters(begin, {names: mr.Prior(), ("precurvature",): mr.Prior()})
    p, h = np.array([0.1, -0.2]), 1e-4
    inputs = begin.inputs(**{**pulls, "tip_force": pulls["tip_force"][0]})
    solver = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-10, atol=1e-11))
    there = mr.solve(numbers.robot(p), inputs, solver=solver)
    columns = there.jacobian(*numbers.names)[:3] @ numbers.columns(there.assembly, p)
    for k in range(2):
        ends = [mr.solve(numbers.robot(p + sign * h * np.eye(2)[k]), inputs, solver=solver).tip_position for sign in (1, -1)]
        np.testing.assert_allclose(columns[:, k], (ends[0] - ends[1]) / (2 * h), atol=1e-7)  # h squared


def test_a_misfit_that_sensors_do_not_explain_is_said(wire, shapes):
    """(18) Of a sensor that is worse than it says, and of a model that lacks a curvature."""
    robot, inputs = mr.SingleRod(wire), mr.SingleRod(wire).inputs(tip_force=shapes[0])
    fit = mr.calibrate(robot, inputs, parameters=FITTED, measured=poses(shapes))
    assert fit.consistent
    assert "inconsistent" not in repr(fit)
    sharp = mr.Pose(position=shapes[1], rotation=shapes[2], sigma=(POSITION / 2, ANGLE / 2))
    for parameters, measured in ((FITTED, sharp), (FITTED[:2], poses(shapes))):
        wrong = mr.calibrate(robot, inputs, parameters=parameters, measured=measured).raise_if_failed()
        assert not wrong.consistent
        assert "inconsistent: the misfit is" in repr(wrong)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ([("bending_stiffness", "base")], "which may share a factor"),
        ([("bending_stiffness", "torsional_stiffness"), "bending_stiffness"], "must name each once"),
        ([()], "must name parameters that share a factor"),
    ],
)
def test_factors_that_are_refused(wire, shapes, parameters, message):
    robot = mr.SingleRod(wire)
    with pytest.raises(ValueError, match=message):
        mr.calibrate(robot, robot.inputs(tip_force=shapes[0]), parameters=parameters, measured=poses(shapes))


def three_tubes(bending=(1, 1, 1), torsional=(1, 1, 1)):
    """Curved at their ends, and stiffer by these factors."""
    numbers = [(0.35, 0.1, 12, 4e-3), (0.27, 0.09, 8, 1.2e-2), (0.19, 0.08, 4, 4e-2)]
    tubes = [
        mr.Rod(
            length=length,
            bending_stiffness=EI * b,
            torsional_stiffness=0.77 * EI * t,
            precurvature=[(length - curved, (0, 0, 0)), (curved, (kappa, 0, 0))],
        )
        for (length, curved, kappa, EI), b, t in zip(numbers, bending, torsional, strict=True)
    ]
    return mr.ConcentricTubes(tubes)


def test_a_shape_that_has_snapped_is_left_out_first():
    """(26) The last shape is one snap farther in the tubes that are measured than in those that are fitted: fitted by all at
    once it is explained by stiffnesses that are wrong by half."""
    robot = three_tubes()
    given = {
        "rotation": [
            [1.83, 1.848, 0.092],
            [-1.285, -2.676, -0.7],
            [-0.549, -2.728, -2.707],
            [2.995, 0.914, -1.593],
            [-1.371, 2.278, -2.615],
        ],
        "translation": [
            [-0.036, -0.022, -0.008],
            [-0.033, -0.023, -0.003],
            [-0.045, -0.027, -0.011],
            [-0.032, -0.025, -0.01],
            [-0.05, -0.02, -0.011],
        ],
        "tip_force": [
            [-0.047, -0.051, 0.192],
            [-0.236, 0.148, -0.22],
            [-0.066, -0.168, 0.29],
            [0.114, 0.486, 0.128],
            [-0.073, -0.03, 0.048],
        ],
    }
    truth = np.array([1.13, 1.07, 1.06, 0.69, 1.03, 1.0])
    measured = three_tubes(truth[:3], truth[3:])
    shapes = mr.solve(measured, measured.inputs(**given))
    names = ("bending_stiffness", "torsional_stiffness")
    priors = dict.fromkeys(names, mr.Prior(sigma=0.1))
    seen = mr.Pose(position=shapes.tip_position, sigma=3e-4)
    fit = mr.calibrate(robot, robot.inputs(**given), parameters=priors, measured=seen).raise_if_failed()
    assert fit.consistent
    found = np.concatenate([fit.value(name) for name in names])
    spread = np.concatenate([fit.sigma(name) for name in names])
    # nothing but the priors draws it away, by no more than what is not known
    assert (np.abs(np.log(found / truth)) < 3 * spread).all()
    # the robot that is measured is as it is fitted, also where it snapped
    np.testing.assert_allclose(fit.solution.tip_position, shapes.tip_position, atol=3 * 3e-4)


def test_shapes_far_from_the_robot_as_it_is_are_left_out_first():
    """(26) All curvatures are a tenth off, and some of twenty shapes are on other branches: all at once come to no end, nor they
    without the one that fits worst there."""
    rng = np.random.default_rng(3)
    rotation, translation = (
        rng.uniform(-np.pi, np.pi, (30, 3)),
        np.array([-0.30, -0.23, -0.09]) + rng.uniform(-0.02, 0.02, (30, 1)),
    )
    force, chosen = rng.normal(0, 0.2, (30, 3)), [*range(19), 11]
    given = {"rotation": rotation[chosen], "translation": translation[chosen], "tip_force": force[chosen]}

    def arm(curved, stiff):
        numbers = [
            ("inner", 0.431, 0.103, 12, 3.868e-3, 3.011e-3),
            ("middle", 0.332, 0.113, 7, stiff * 1.7168e-2, 1.4018e-2),
            ("outer", 0.174, 0.134, 3.5, 3.9768e-2, 5.0224e-2),
        ]
        tubes = [
            mr.Rod(
                name=name,
                length=length,
                bending_stiffness=EI,
                torsional_stiffness=GJ,
                precurvature=[(length - b, (0, 0, 0)), (b, (curved * kappa, 0, 0))],
            )
            for name, length, b, kappa, EI, GJ in numbers
        ]
        return mr.ConcentricTubes(tubes)

    robot, real = arm(1.0, 1.0), arm(1.1, 0.9)
    shapes = mr.solve(real, real.inputs(**given)).raise_if_failed()
    position = shapes.tip_position + 5e-4 * rng.normal(size=(20, 3))
    turned = (Rotation.from_rotvec(5e-3 * rng.normal(size=(20, 3))) * Rotation.from_matrix(shapes.tip_rotation)).as_matrix()
    priors = {"precurvature": mr.Prior(), "bending_stiffness": mr.Prior(sigma=[1e-9, np.inf, 1e-9])}
    seen = mr.Pose(position=position, rotation=turned, sigma=(5e-4, 5e-3))
    fit = mr.calibrate(robot, robot.inputs(**given), parameters=priors, measured=seen).raise_if_failed()
    assert fit.consistent
    off = np.append(fit.value("precurvature")[::3] - 1.1 * np.array([12, 7, 3.5]), fit.value("bending_stiffness")[1] - 0.9)
    # four numbers, each within four deviations
    assert (np.abs(off) < 4 * np.append(fit.sigma("precurvature")[::3], fit.sigma("bending_stiffness")[1])).all()


@pytest.mark.parametrize(("stiffness", "bent"), [(0.03, 0.0), (0.03, 0.001), (0.02, 0.0), (0.013, 0.0)])
def test_a_fit_from_a_straight_rod_ends_where_one_from_a_bent_rod_does(stiffness, bent):
    """(13c) How a straight rod is twisted at rest tips do not tell: the first step wound it a thousand times, and after as many
    integrations of such rods the fit was ``STALLED``, and what is seen was said to be hardly so."""

    def made(EI, precurvature):
        return mr.SingleRod(mr.Rod(length=0.3, bending_stiffness=EI, torsional_stiffness=0.0125, precurvature=precurvature))

    force = np.random.default_rng(0).normal(0, 0.15, (10, 3))
    real = made(0.023, (6, 2, 0))
    tips = mr.solve(real, real.inputs(tip_force=force)).tip_position
    seen = mr.Pose(position=tips + np.random.default_rng(1).normal(0, 5e-4, tips.shape), sigma=5e-4)
    found = []
    for EI, precurvature in ((0.02, (5, 0, 0)), (stiffness, (bent, 0, 0))):
        robot = made(EI, precurvature)
        names = ("bending_stiffness", "precurvature")
        fit = mr.calibrate(robot, robot.inputs(tip_force=force), parameters=names, measured=seen).raise_if_failed()
        found.append([EI * fit.value("bending_stiffness")[0], *fit.value("precurvature")])
    assert fit.integrations < 40
    spread = np.array([stiffness * fit.sigma("bending_stiffness")[0], *fit.sigma("precurvature")])
    assert np.abs(np.subtract(*found) / spread).max() < 0.03  # each ends where a step is less than a hundredth of it
    assert np.abs((np.array(found[1]) - (0.023, 6, 2, 0)) / spread).max() < 4
