"""A batch is its instances: bitwise, whatever the axes, and whatever becomes of the others."""

import numpy as np
import pytest

import multirod as mr
from multirod.models.backbone.problem import BackboneProblem

ARRAYS = ("tip_position", "tip_rotation", "unknowns", "gamma", "residual", "iterations", "integrations", "condition")


def assert_same(batch, index, alone):
    assert batch.status[index] == alone.status
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(batch, name)[index], getattr(alone, name), err_msg=name)
    one, many = alone.rod(0), batch.rod(0)
    for name in vars(one):
        np.testing.assert_array_equal(getattr(many, name)[index], getattr(one, name), err_msg=name)


def test_leading_axes_broadcast_and_equal_instances_alone(wire):
    robot = mr.SingleRod(wire)
    forces = np.random.default_rng(1).uniform(-1, 1, (2, 1, 3))
    angles = np.linspace(-1, 1, 3)
    batch = mr.solve(robot, robot.inputs(tip_force=forces, rotation=angles[:, None])).raise_if_failed()
    assert batch.tip_position.shape == (2, 3, 3)
    assert batch.tip_rotation.shape == (2, 3, 3, 3)
    assert batch.rod(0).position.shape == (2, 3, 51, 3)
    assert batch.energy.shape == batch.status.shape == (2, 3)
    for i, j in np.ndindex(2, 3):
        alone = mr.solve(robot, robot.inputs(tip_force=forces[i, 0], rotation=angles[j]))
        assert_same(batch, (i, j), alone)
        np.testing.assert_array_equal(batch.energy[i, j], alone.energy)


def test_rods_and_bases_with_leading_axes(make_pose):
    lengths, stiffness = np.array([0.3, 0.4, 0.5]), np.array([[0.2, 0.2], [0.1, 0.3]])
    curvature = np.array([(14, 5, 0), (3, -2, 1)])
    base = np.stack([make_pose((0.1 * k, 0.2, -0.3), (k, 0, 0)) for k in range(3)])
    force = (0.5, -0.2, 0.3)
    rod = mr.Rod(
        length=lengths,
        bending_stiffness=stiffness[:, None],
        torsional_stiffness=0.06,
        precurvature=curvature[:, None],
    )
    robot = mr.SingleRod(rod, base=base)
    batch = mr.solve(robot, robot.inputs(tip_force=force)).raise_if_failed()
    assert batch.tip_position.shape == (2, 3, 3)
    for i, j in np.ndindex(2, 3):
        one = mr.Rod(length=lengths[j], bending_stiffness=stiffness[i], torsional_stiffness=0.06, precurvature=curvature[i])
        robot = mr.SingleRod(one, base=base[j])
        assert_same(batch, (i, j), mr.solve(robot, robot.inputs(tip_force=force)))


def test_each_has_a_cross_section_of_its_own():
    """Moduli and diameters with leading axes: stiffnesses, mass and strain are those of each alone, bitwise."""
    lengths, outer, E = np.array([0.3, 0.4, 0.5]), np.array([[1e-3], [3e-3]]), np.array([60e9, 70e9, 200e9])
    inner, loads = 0.7 * outer, {"tip_force": (0.03, -0.02, 0.1), "gravity": (0, 0, -9.81)}
    made = {"poisson_ratio": 0.3, "density": 6450.0}
    robot = mr.SingleRod(mr.Rod.tube(length=lengths, outer_diameter=outer, inner_diameter=inner, young_modulus=E, **made))
    batch = mr.solve(robot, robot.inputs(**loads)).raise_if_failed()
    assert batch.strain.shape == (2, 3, 1)
    for i, j in np.ndindex(2, 3):
        d, hollow = float(outer[i, 0]), float(inner[i, 0])
        one = mr.Rod.tube(length=lengths[j], outer_diameter=d, inner_diameter=hollow, young_modulus=E[j], **made)
        alone = mr.SingleRod(one)
        solution = mr.solve(alone, alone.inputs(**loads))
        assert_same(batch, (i, j), solution)
        np.testing.assert_array_equal(batch.strain[i, j], solution.strain)
        curvature = np.linalg.norm(solution.rod(0).curvature[:, :2], axis=-1)
        np.testing.assert_allclose(solution.strain, [d / 2 * curvature.max()], rtol=1e-9)  # rounding
    wires = mr.Rod.wire(length=0.3, diameter=outer[:, 0], young_modulus=60e9, poisson_ratio=0.3)
    np.testing.assert_allclose(wires.sections[0].bending_stiffness[:, 0], 60e9 * np.pi / 64 * outer[:, 0] ** 4, rtol=1e-14)
    assert repr(wires) == "Rod(0.3 m, batch (2,), 1 section)"


def test_an_impossible_instance_leaves_the_others_as_they_are():
    column = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06))
    solver = mr.Shooting(integrator=mr.RK4(40), at_fold="stop")
    forces = np.array([(0.3, 0.0, 0.5), (0.0, 0.0, -1e3), (0.0, 0.4, -0.2)])
    batch = mr.solve(column, column.inputs(tip_force=forces), solver=solver)
    assert mr.Status(int(batch.status[1])) == mr.Status.BRANCH_END
    for name in ("tip_position", "tip_rotation", "unknowns", "gamma", "condition", "determinant", "energy"):
        assert np.isnan(getattr(batch, name)[1]).all(), name
    for name, value in vars(batch.rod(0)).items():
        assert np.isnan(value[1]).all(), name
    assert np.isnan(batch.jacobian("tip_force")[1]).all()
    for k in (0, 2):
        alone = mr.solve(column, column.inputs(tip_force=forces[k]), solver=solver).raise_if_failed()
        assert_same(batch, k, alone)
        np.testing.assert_array_equal(batch.jacobian("tip_force")[k], alone.jacobian("tip_force"))
    with pytest.raises(mr.SolveError, match=r"1 of 3 instances failed \(1 BRANCH_END\); the first is 1: BRANCH_END"):
        batch.raise_if_failed()


# ---- nothing ----

ARRAYS = {
    **dict.fromkeys(("status", "residual", "iterations", "integrations", "condition", "determinant", "index", "stability"), ()),
    **dict.fromkeys(("energy", "potential", "stability_margin", "smallest_singular_value"), ()),
    "tip_position": (3,),
    "tip_rotation": (3, 3),
}
FEW = mr.Shooting(integrator=mr.RK4(10))


def nothing(axes, kind):
    """Solutions of no instance, with these axes."""
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06))
    count = max(1, int(np.prod([size for size in axes if size])))
    some = robot.inputs(tip_force=np.full((count, 3), 0.1))
    if kind == "solve":
        return mr.solve(robot, robot.inputs(tip_force=np.zeros((*axes, 3))), solver=FEW)
    if kind == "simulate":
        return mr.simulate(robot, robot.inputs(tip_force=np.zeros((*axes, 3))), time=np.arange(axes[0]), solver=FEW)
    if kind == "instances":
        return mr.solve(robot, some, solver=FEW, instances=[])
    return mr.solve(robot, some, solver=FEW)[[]]


@pytest.mark.parametrize(
    ("axes", "kind"),
    [((0,), "solve"), ((2, 0), "solve"), ((0, 2), "solve"), ((0,), "simulate"), ((3, 0), "simulate"), ((0, 2), "simulate")]
    + [((0,), "instances"), ((0,), "index")],
)
def test_a_batch_of_none_has_results_of_none(axes, kind):
    found = nothing(axes, kind)
    assert found.batch_shape == axes
    for name, tail in ARRAYS.items():
        assert np.shape(getattr(found, name)) == (*axes, *tail), name
    assert found.unknowns.shape == (*axes, found.unknown_count)
    assert found.rod(0, nodes=5).position.shape == (*axes, 5, 3)
    assert found.jacobian("tip_force").shape == (*axes, 6, 3)
    assert found.inputs.tip_force.shape == (*axes, 3)
    assert found.raise_if_failed() is found
    assert repr(found)


def test_a_batch_of_none_has_lines_of_none():
    """An axis whose length is to be found cannot be where there is nothing."""
    lines = [mr.Tendon((0.006, 0)), mr.Tendon((0, 0.006), name="other")]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines))
    for axes in ((0,), (2, 0)):
        found = mr.solve(robot, robot.inputs(tension=np.ones((*axes, 2))), solver=FEW).line("other", nodes=5)
        assert found.position.shape == (*axes, 5, 3)
        assert found.tension.shape == (*axes, 5)


def test_what_a_batch_of_none_needs_is_explained():
    pose = np.tile(np.eye(4), (2, 1, 1))
    pose[:, 0, 3] = -0.05, 0.05
    leg = mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077)
    robot = mr.ParallelRods(legs=[leg] * 2, base=pose, platform=pose)
    terms = mr.explain(robot, robot.inputs(tip_force=np.zeros((0, 3)), rotation=(0.1, 0))).terms
    assert "pose" in [term.name for term in terms]


@pytest.mark.parametrize("solver", [mr.Observer(), mr.EnergyDescent(), mr.ScipyShooting(), mr.MultipleShooting()], ids=repr)
def test_every_solver_takes_a_batch_of_none(solver, wire):
    robot = mr.SingleRod(wire)
    assert mr.solve(robot, robot.inputs(tip_force=np.zeros((0, 3))), solver=solver).tip_position.shape == (0, 3)


def test_a_control_loop_of_none_is_refused(wire):
    robot = mr.SingleRod(wire)
    with pytest.raises(ValueError, match=r"Tracker\.inputs = leading axes \(0,\) is not allowed: there must be an instance"):
        mr.Tracker(robot, dt=0.01, inputs=robot.inputs(tip_force=np.zeros((0, 3))))


def test_loads_on_one_robot_take_one_integration_of_the_unloaded_robot(wire, monkeypatch):
    robot, solver = mr.SingleRod(wire), mr.Shooting(integrator=mr.RK4(50))
    forces = np.random.default_rng(2).uniform(-1, 1, (20, 3))
    shared = []
    found = BackboneProblem.integrate_alike

    def noted(self):
        shared.append(found(self))
        return shared[-1]

    monkeypatch.setattr(BackboneProblem, "integrate_alike", noted)
    batch = mr.solve(robot, robot.inputs(tip_force=forces), solver=solver, threads=1)
    assert shared == [True]
    for k in range(0, len(forces), 5):
        assert_same(batch, k, mr.solve(robot, robot.inputs(tip_force=forces[k]), solver=solver))
    shared.clear()
    # turned at their bases, or pushed out, they are not the same
    for name, values in {"rotation": np.linspace(0, 1, 20), "translation": np.linspace(0, 0.01, 20)}.items():
        given = {name: values[:, None], "tip_force": forces}
        batch = mr.solve(robot, robot.inputs(**given), solver=solver, threads=1)
        assert_same(batch, 7, mr.solve(robot, robot.inputs(tip_force=forces[7], **{name: values[7]}), solver=solver))
    assert not any(shared)


@pytest.mark.parametrize("batch", [(), (2,)])
def test_a_motion_to_which_nothing_is_applied_is_asked_as_any(batch, wire, make_pose, tmp_path):
    base = np.stack([np.eye(4), make_pose((0.3, 0, 0), (0, 0, 0.1))]) if batch else np.eye(4)
    robot, time = mr.SingleRod(wire, base=base), 0.1 * np.arange(3)
    motion = mr.simulate(robot, robot.inputs(), time=time).raise_if_failed()
    at_rest = mr.solve(robot, robot.inputs())
    assert motion.inputs.batch_shape == motion.batch_shape == (3, *batch)
    np.testing.assert_array_equal(motion.tip_position, np.broadcast_to(at_rest.tip_position, (3, *batch, 3)))
    np.testing.assert_array_equal(motion.rod(0).position[1], at_rest.rod(0).position)
    assert motion.energy.shape == (3, *batch)
    assert motion[1].inputs.batch_shape == batch
    np.testing.assert_array_equal(motion[1].rod(0).position, at_rest.rod(0).position)
    motion.save(tmp_path / "motion.npz")
    motion.save(tmp_path / "motion.rrd", instances=1)
    np.testing.assert_array_equal(mr.load(tmp_path / "motion.npz").rod(0).position, motion.rod(0).position)
