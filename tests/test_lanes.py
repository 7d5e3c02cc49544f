"""Instances side by side in the lanes of one thread: none sees another, and how they are dealt out does not matter."""

import numpy as np
import programs
import pytest
import warp as wp

import multirod as mr
from multirod.models.backbone.kernels.integration.integrate import make_kernel
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.numbers.lanes import lanes
from multirod.models.backbone.passes import lane_pass
from multirod.studies.scenes import SCENES
from multirod.tasks.formulation import options

RK4, RK45 = mr.RK4(20), mr.RK45()


@pytest.fixture(params=["rod", "tubes"])
def robot(request):
    if request.param == "rod":
        section = mr.Section(length=0.15, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(3, 0, 1))
        return mr.SingleRod(mr.Rod(sections=[section, mr.Section(length=0.1, bending_stiffness=0.05, torsional_stiffness=0.03)]))
    tube = {"bending_stiffness": 0.02, "torsional_stiffness": 0.015}
    return mr.ConcentricTubes(
        [mr.Rod(length=0.3, precurvature=(4, 0, 0), **tube), mr.Rod(length=0.2, precurvature=(0, 3, 1), **tube)]
    )


def problem_of(robot, integrator, count, **options):
    rng = np.random.default_rng(0)
    rotation = rng.uniform(-1, 1, (count, robot.rod_count))
    inputs = robot.inputs(rotation=rotation, tip_force=rng.normal(size=(count, 3)) * np.geomspace(0.01, 1, count)[:, None])
    problem = robot.problem(inputs, integrator=integrator, pose_sensitivities=True, direction_count=2, **options)
    problem.unknowns.assign(problem.guess() + rng.normal(size=problem.unknowns.shape))
    directions = np.zeros(problem.directions.shape)
    directions[:, 0, problem.input_slice("translation")] = 1.0
    directions[:, 1, problem.input_slice("tip_force")] = 1.0
    problem.directions.assign(directions)
    return problem


def results(problem):
    problem.integrate()
    names = ("residual", "gamma", "residual_directions", "position", "rotation", "pose_columns", "fault", "step_count")
    return {name: getattr(problem, name).numpy().reshape(problem.instance_count, -1).copy() for name in names}


@pytest.mark.parametrize("integrator", [RK4, RK45], ids=str)
def test_lanes_do_not_see_each_other(robot, integrator):
    """Nor do they where others hold no numbers, or end with a fault, and take different numbers of steps."""
    problem = problem_of(robot, integrator, 11)
    good = results(problem)
    assert not good["fault"].any()
    if integrator is RK45:
        assert len(np.unique(good["step_count"])) > 2
    unknowns = problem.unknowns.numpy()
    unknowns[[1, 2, 5, 9]] = [[np.nan], [1e300], [np.inf], [1e9]]
    problem.unknowns.assign(unknowns)
    found = results(problem)
    assert found["fault"][[1, 2, 5]].all()
    others = np.setdiff1d(np.arange(11), [1, 2, 5, 9])
    for name, value in good.items():
        np.testing.assert_array_equal(found[name][others], value[others], err_msg=name)


@pytest.mark.parametrize("integrator", [RK4, RK45], ids=str)
@pytest.mark.parametrize("parts", [2, 3, 20])
def test_columns_may_stand_in_lanes_of_their_own(robot, integrator, parts, monkeypatch):
    monkeypatch.setattr(lane_pass, "parts_of", lambda count, columns, lanes: 1)
    together = results(problem_of(robot, integrator, 3))
    monkeypatch.setattr(lane_pass, "parts_of", lambda count, columns, lanes: min(parts, columns))
    apart = results(problem_of(robot, integrator, 3))
    for name, value in together.items():
        np.testing.assert_array_equal(apart[name], value, err_msg=name)


@pytest.mark.parametrize("integrator", [RK4, RK45], ids=str)
def test_nodes_and_columns_there_may_stand_in_lanes_of_their_own(robot, integrator, monkeypatch):
    """Also where lanes take parts of one instance at different times, and so stand on different nodes of one stretch."""

    def found(parts):
        monkeypatch.setattr(lane_pass, "parts_of", lambda count, columns, lanes: min(parts, columns))
        made = problem_of(robot, integrator, 11).nodes.of_all(9)
        made.launch.launch()
        return {name: made.read(name).copy() for name in made._outputs}

    together = found(1)
    assert np.isfinite(together["node_columns"]).all()
    assert together["node_columns"].any()
    for parts in (2, 3, 5):
        apart = found(parts)
        for name, value in together.items():
            np.testing.assert_array_equal(apart[name], value, err_msg=name)


@pytest.mark.parametrize("width", [1, 8])
def test_more_and_fewer_lanes(robot, width, monkeypatch):
    """Other code of the same equations: to rounding."""
    usual = results(problem_of(robot, RK4, 5))
    monkeypatch.setitem(lane_pass.WIDTH, "float64", width)
    other = results(problem_of(robot, RK4, 5))
    for name, value in usual.items():
        np.testing.assert_allclose(other[name], value, rtol=0, atol=1e-12 * max(1.0, np.abs(value).max()), err_msg=name)


def test_a_lone_robot_gets_a_lane_a_column_and_a_batch_none():
    assert lane_pass.parts_of(1, 3, 4) == 3
    assert lane_pass.parts_of(1, 12, 4) == 4
    assert lane_pass.parts_of(1000, 12, 4) == 1
    assert lane_pass.parts_of(1, 0, 4) == 1
    assert lane_pass.parts_of(1, 12, 1) == 1


@pytest.mark.parametrize(("scalar", "width"), [(wp.float64, 1), (wp.float64, 4), (wp.float32, 8)])
@pytest.mark.parametrize("order", [2, 3, 5, 8])
def test_step_factors_are_roots(scalar, width, order):
    """``x^(-1/order)`` as it is needed for the length of a step."""
    kit = lanes(width, scalar)
    row, put, root = kit.row, kit.put, kit.power_root(order)

    @wp.kernel(module="unique", enable_backward=False)
    def take(x: wp.array(dtype=scalar), out: wp.array(dtype=scalar)):
        put(out, wp.tid(), root(row(x, wp.tid())))

    x = np.geomspace(1e-8, 1e20, 64)
    out = wp.zeros(64, dtype=scalar, device="cpu")
    wp.launch(take, 64 // width, inputs=[wp.array(x, dtype=scalar, device="cpu"), out], device="cpu")
    np.testing.assert_allclose(out.numpy(), x ** (-1 / order), rtol=2e-3)


def test_a_gpu_can_run_the_same_source(tmp_path):
    """One lane a thread: compiled to PTX, which takes no GPU, with every term that several rods can have."""
    features = Features(
        rod_count=3,
        precurvature_degree=1,
        profile_degree=1,
        force=True,
        tip_moment=True,
        distributed_moment=True,
        follower_force=True,
        follower_moment=True,
        torsion=True,
        anisotropic=True,
        transmission=True,
        directions=True,
        pose_sensitivities=True,
    )
    module = make_kernel(features, RK4.tableau, "float64", 1).module
    wp.compile_aot_module(module, device=None, arch=80, module_dir=str(tmp_path), use_ptx=True)
    assert [file.suffix for file in tmp_path.iterdir()].count(".ptx") == 1


KERNELS_OF_A_SCENE = """
import sys, tempfile
from pathlib import Path
import warp as wp
wp.config.optimization_level = 1  # what is compiled matters here, not how fast it is
import multirod as mr
from multirod.kernels.compiling import COMPILER
from multirod.kernels.index import INDEX
from multirod.models.backbone.passes import lane_pass
from multirod.studies.scenes import load
lane_pass.WIDTH.update(float64=1, float32=1)  # a lane a thread, as on a GPU
modules, request = {}, COMPILER.request
def remember(module, device):
    modules[module.name] = module
    return request(module, device)
COMPILER.request = remember
INDEX.find = lambda maker: (None, None)  # what was compiled before is made again
motion = load(sys.argv[1]).first(6)
robot = motion.robot
solution = mr.solve(robot, motion.inputs[0]).raise_if_failed()
solution.rod(0), solution.jacobian("tip_force"), solution.stability, solution.energy
for solver in mr.Shooting(), mr.Observer(feed_forward=True):
    mr.simulate(robot, motion.inputs, time=motion.time, solver=solver)
for name, module in modules.items():
    with tempfile.TemporaryDirectory() as folder:
        wp.compile_aot_module(module, device=None, arch=80, module_dir=folder, use_ptx=True)
        assert len(list(Path(folder).glob("*.ptx"))) == 1, name
    print(name)
"""


@pytest.mark.parametrize("scene", SCENES)
def test_a_gpu_can_run_every_kernel_of_a_scene(scene: str) -> None:
    """Of solves, shapes, derivatives, stability and motions by Newton's method and by the observer, compiled to PTX."""
    done = programs.run("-c", KERNELS_OF_A_SCENE, scene)
    assert done.returncode == 0, done.stderr
    kernels = done.stdout.split()
    for kind in "integrate", "newton":
        assert any(kind in kernel for kernel in kernels), kernels


ANGLES = 2 * np.pi * np.arange(3) / 3
COUNT, CHOSEN = 40, 20


@pytest.fixture(scope="module")
def told_beside():
    """What an integration at some unknowns tells of the first of some instances, by their numbers."""
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


def test_a_rod_with_lines_is_bitwise_the_same_beside_any_other(told_beside):
    alone = told_beside([CHOSEN])
    for other in range(COUNT):  # which stop at other steps; at two of them the last digits differed
        for own, beside in zip(alone, told_beside([CHOSEN, other]), strict=True):
            np.testing.assert_array_equal(beside, own, err_msg=str(other))
