"""Robots as layers of PyTorch, which is large: the tests run where it is installed."""

import numpy as np
import pytest
import soft_magnet

import multirod as mr

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
FORCE = np.array([0.05, 0.1, 0.1])
TOO_MUCH = (0, 900.0, 0)  # for so few integrations


@pytest.fixture(scope="module")
def robot():
    own = {"torsional_stiffness": 0.064, "bending_stiffness": 0.22}
    return mr.SingleRod(mr.Rod(length=0.4, precurvature=[(0.25, (14, 5, 1)), (0.15, (3, -5, 2))], **own))


def tensor(value, **options):
    return torch.tensor(np.asarray(value), dtype=torch.float64, **options)


def test_the_layer_is_what_solve_says(robot):
    expected = mr.solve(robot, robot.inputs(rotation=0.3, tip_force=FORCE))
    layer = mr.torch.Layer(robot, of="tip_pose", inputs=robot.inputs(rotation=0.3))
    force = tensor(FORCE, requires_grad=True)
    pose = layer(tip_force=force)
    np.testing.assert_array_equal(pose[:3, :3].detach(), expected.tip_rotation)
    np.testing.assert_array_equal(pose[:3, 3].detach(), expected.tip_position)
    for k in range(3):
        (row,) = torch.autograd.grad(pose[k, 3], force, retain_graph=True)
        np.testing.assert_allclose(row, expected.jacobian("tip_force")[k], rtol=0, atol=1e-9)


def test_what_follows_from_integers_is_none(robot):
    layer = mr.torch.Layer(robot)
    for whole in (1, torch.tensor(1)):
        found = layer(rotation=whole, tip_force=tensor(FORCE))
        assert found.dtype == torch.float64
        assert torch.equal(found, layer(rotation=tensor(1.0), tip_force=tensor(FORCE)))


@pytest.mark.parametrize("of", ["tip_position", "tip_pose"])
def test_gradcheck_passes_with_an_instance_that_fails(robot, of):
    """The others are bitwise what they are alone, and so are their gradients."""
    integrator = mr.RK45(rtol=1e-11, atol=1e-13)
    few = mr.Shooting(integrator=integrator, tolerance=1e-12, max_integrations=40, fallback=False)
    layer = mr.torch.Layer(robot, of=of, solver=few)
    forces = tensor([FORCE, (0.02, 0, 0.1)], requires_grad=True)
    curves = torch.as_tensor(layer.value_of("precurvature")).requires_grad_()
    lost = tensor([TOO_MUCH])

    def batch(forces, curves):
        return layer(tip_force=torch.cat([forces[:1], lost, forces[1:]]), precurvature=curves)[::2]

    assert torch.autograd.gradcheck(batch, (forces, curves), eps=1e-4, atol=1e-7)
    every = torch.cat([forces[:1], lost, forces[1:]]).detach().requires_grad_()
    given = {"tip_force": every, "precurvature": curves.detach()}
    assert [mr.Status(int(s)).failed for s in layer.status(**given)] == [False, True, False]
    value = layer(**given)
    value.sum().backward()
    assert torch.isnan(value[1]).all()
    assert torch.isnan(every.grad[1]).all()
    for k in (0, 2):
        alone = every[k].detach().requires_grad_()
        own = layer(tip_force=alone, precurvature=curves.detach())
        own.sum().backward()
        assert torch.equal(own, value[k])
        assert torch.equal(alone.grad, every.grad[k])


@pytest.mark.parametrize("of", ["tip_position", "tip_pose"])
def test_gradients_by_medium_and_magnetisation(of):
    """Against differences, and bitwise as alone beside an instance that fails."""
    layer, values = mr.torch.Layer(soft_magnet.ROBOT, of=of, **soft_magnet.SCENE), soft_magnet.batch()
    failed = [mr.Status(int(s)).failed for s in layer.status(**values)]
    assert failed == [k == soft_magnet.LOST for k in range(4)]
    weights = tensor(np.random.default_rng(1).standard_normal(layer.equilibrium.output))

    def gradients(values):
        given = {name: tensor(value, requires_grad=True) for name, value in values.items()}
        (weights * layer(**given)).sum().backward()
        return {name: own.grad for name, own in given.items()}

    together = gradients(values)
    for k in range(4):
        own = {name: value[k] for name, value in values.items()}
        for name, alone in gradients(own).items():
            np.testing.assert_array_equal(together[name][k], alone)
            assert torch.isnan(alone).all() == failed[k]
            if k == 0:
                way, places = soft_magnet.along(own, name)
                losses = np.array([float((weights * layer(**place)).sum()) for place in places])
                expected = soft_magnet.WEIGHTS @ losses / soft_magnet.STEPS[name]
                size = np.abs(soft_magnet.WEIGHTS) @ np.abs(losses) / soft_magnet.STEPS[name]
                assert float((alone * tensor(way)).sum()) == pytest.approx(expected, rel=1e-9, abs=1e-12 * size)


def test_single_precision_stays_so_and_what_does_not_fit_is_said(robot):
    layer = mr.torch.Layer(robot)
    force = torch.tensor(FORCE, dtype=torch.float32, requires_grad=True)
    value = layer(tip_force=force)
    value.sum().backward()
    assert value.dtype is force.grad.dtype is torch.float32
    with pytest.raises(TypeError, match="did you mean 'tip_force'"):
        layer(tip_forces=force)
    with pytest.raises(ValueError, match=r"must be \(..., 3\)"):
        layer(tip_force=force[:2])
