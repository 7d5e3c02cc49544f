"""Robots as functions of JAX."""

import numpy as np
import pytest
import soft_magnet

import multirod as mr

jax = pytest.importorskip("jax", reason="JAX is not installed")
check_grads = pytest.importorskip("jax.test_util").check_grads
FORCE = np.array([0.05, 0.1, 0.1])


@pytest.fixture(autouse=True)
def double():
    """In double precision, as differences need it."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def robot():
    own = {"torsional_stiffness": 0.064, "bending_stiffness": 0.22}
    return mr.SingleRod(mr.Rod(length=0.4, precurvature=[(0.25, (14, 5, 1)), (0.15, (3, -5, 2))], **own))


@pytest.fixture(scope="module")
def tip(robot):
    return mr.jax.function(robot, inputs=robot.inputs(rotation=0.3))


def test_the_function_is_what_solve_says(robot, tip):
    expected = mr.solve(robot, robot.inputs(rotation=0.3, tip_force=FORCE))
    np.testing.assert_array_equal(tip(tip_force=FORCE), expected.tip_position)
    pose = mr.jax.function(robot, of="tip_pose")(rotation=[0.3], tip_force=FORCE)
    np.testing.assert_array_equal(pose[:3, :3], expected.tip_rotation)
    np.testing.assert_array_equal(tip(precurvature=tip.value_of("precurvature"), tip_force=FORCE), expected.tip_position)


def test_derivatives_are_those_of_the_solution_forward_and_reverse(robot, tip):
    solution = mr.solve(robot, robot.inputs(rotation=0.3, tip_force=FORCE))
    given = {"precurvature": tip.value_of("precurvature"), "tip_force": FORCE}
    for differentiate in (jax.jacfwd, jax.jacrev):
        found = jax.jit(differentiate(lambda values: tip(**values)))(given)
        for name in given:
            np.testing.assert_allclose(found[name].reshape(3, -1), solution.jacobian(name)[:3], rtol=0, atol=1e-9)


@pytest.mark.parametrize("of", ["tip_position", "tip_pose"])
def test_numerical_differences_agree(robot, of):
    own = mr.jax.function(robot, of=of, solver=mr.Shooting(integrator=mr.RK45(rtol=1e-11, atol=1e-13), tolerance=1e-12))
    jax.test_util.check_grads(
        lambda f, u: own(tip_force=f, precurvature=u), (FORCE, own.value_of("precurvature")), order=1, eps=1e-4
    )


def test_a_failed_instance_is_nan_and_leaves_the_others_as_they_are_alone(robot, tip):
    """By ``vmap``, of a batch, and one by one, bitwise."""
    few = mr.jax.function(robot, solver=mr.Shooting(max_integrations=20, fallback=False))
    forces = np.array([FORCE, (0, 900.0, 0), (0.02, 0, 0.1), (np.nan, 0, 0)])
    value = jax.jit(lambda f: few(tip_force=f))
    slope = jax.jit(jax.jacrev(lambda f: few(tip_force=f)))
    mapped, slopes = np.asarray(jax.vmap(value)(forces)), np.asarray(jax.vmap(slope)(forces))
    status = few.status(tip_force=forces)
    assert [mr.Status(int(s)).failed for s in status] == [False, True, False, True]
    for k in (0, 2):
        np.testing.assert_array_equal(mapped[k], value(forces[k]))
        np.testing.assert_array_equal(slopes[k], slope(forces[k]))
    assert np.isnan(mapped[[1, 3]]).all()
    assert np.isnan(slopes[[1, 3]]).all()
    np.testing.assert_array_equal(few(tip_force=forces), mapped)


@pytest.mark.parametrize("of", ["tip_position", "tip_pose"])
def test_derivatives_by_medium_and_magnetisation(of):
    """Against differences, and bitwise as alone beside an instance that fails."""
    tip, values = mr.jax.function(soft_magnet.ROBOT, of=of, **soft_magnet.SCENE), soft_magnet.batch()
    failed = [mr.Status(int(s)).failed for s in tip.status(**values)]
    assert failed == [k == soft_magnet.LOST for k in range(4)]
    slope = jax.jit(jax.jacrev(lambda given: tip(**given)))
    together = jax.vmap(slope)(values)
    for k in range(4):
        own = {name: value[k] for name, value in values.items()}
        alone = slope(own)
        for name, columns in alone.items():
            np.testing.assert_array_equal(together[name][k], columns)
            assert np.isnan(columns).all() == failed[k]
        if k == 0:
            for name, step in soft_magnet.STEPS.items():
                way, places = soft_magnet.along(own, name)
                expected = np.tensordot(soft_magnet.WEIGHTS, [tip(**place) for place in places], 1) / step
                found = np.tensordot(alone[name], way, 3)
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_a_shared_value_takes_the_mean_of_the_gradients_that_there_are(robot):
    few = mr.jax.function(robot, solver=mr.Shooting(max_integrations=20, fallback=False))
    forces, shared = np.array([FORCE, (0, 900.0, 0), (0.02, 0, 0.1)]), few.value_of("precurvature")
    each = jax.jit(jax.vmap(jax.grad(lambda u, f: (few(precurvature=u, tip_force=f) ** 2).sum()), in_axes=(None, 0)))
    found = each(shared, forces)
    assert np.isnan(found[1]).all()
    np.testing.assert_array_equal(jax.numpy.nanmean(found, axis=0), (found[0] + found[2]) / 2)


def test_a_guess_saves_integrations_and_nothing_else(robot, tip):
    guess = mr.solve(robot, robot.inputs(rotation=0.3, tip_force=FORCE))
    near = mr.jax.function(robot, inputs=robot.inputs(rotation=0.3), guess=guess)
    forces = FORCE + 0.01 * np.eye(3)
    assert (near.solution(tip_force=forces).integrations < tip.solution(tip_force=forces).integrations).all()
    np.testing.assert_allclose(near(tip_force=forces), tip(tip_force=forces), rtol=0, atol=1e-9)


def test_vmap_over_some_of_the_values(tip):
    forces = np.stack([FORCE, 2 * FORCE])
    curves = tip.value_of("precurvature") + np.arange(2)[:, None, None, None]
    both = jax.vmap(lambda f: tip(tip_force=f, precurvature=curves))(forces)
    assert both.shape == (2, 2, 3)
    np.testing.assert_array_equal(both[1, 0], tip(tip_force=forces[1], precurvature=curves[0]))


def test_a_derivative_that_is_not_known_is_refused_as_it_is_traced():
    """By the error of ``Solution.jacobian``, not by one of JAX around it; values are those of any robot."""
    bent = mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.008, lines=[mr.Tendon(offset=(0.005, 0))])
    pulled = mr.jax.function(mr.SingleRod(bent))
    length = pulled.value_of("length")
    assert np.isfinite(pulled(length=length, tension=[0.5])).all()
    for differentiate in (jax.jacrev, jax.jacfwd, lambda f: jax.jit(jax.jacrev(f))):
        with pytest.raises(NotImplementedError, match="by length of a rod with lines are not known"):
            differentiate(lambda own: pulled(length=own, tension=[0.5]))(length)
        # by what is known it is differentiated all the same
        assert np.isfinite(differentiate(lambda own: pulled(length=length, tension=own))(np.array([0.5]))).all()


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda tip: tip(tip_forces=FORCE), TypeError, "did you mean 'tip_force'"),
        (lambda tip: tip(), TypeError, "values are to be given by name"),
        (lambda tip: tip(tip_force=[1.0]), ValueError, r"must be \(..., 3\)"),
        (lambda tip: tip(tip_force=np.zeros((2, 3)), rotation=np.zeros((3, 1))), ValueError, "leading axes of the values"),
        (lambda tip: mr.jax.function(tip), TypeError, "robot must be an assembly"),
        (lambda tip: mr.jax.function(tip.equilibrium.robot, of="tip"), ValueError, "of = 'tip'"),
    ],
)
def test_what_does_not_fit_is_said(tip, call, error, message):
    with pytest.raises(error, match=message):
        call(tip)
