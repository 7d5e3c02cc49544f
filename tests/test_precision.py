"""Integration in single precision: its error, its floor, what is refused, and that units, batches and nodes do not matter.

Bounds are in ``EPS``, what float32 rounds by. A rod is integrated in some 200 evaluations of the rates, each rounded a few times;
as roundings do not all point one way, a few tens of ``EPS`` are what a component of order one may be off.
"""

import numpy as np
import pytest

import multirod as mr
from multirod.inputs import Inputs
from multirod.models.backbone.inputs import BACKBONE_INPUTS
from multirod.models.backbone.problem import BackboneProblem
from multirod.problem import SINGLE_TOLERANCE

EPS = float(np.finfo(np.float32).eps)
DOUBLE = mr.RK4(50)
SINGLE = mr.RK4(50, precision="float32")
ROUNDED = 30 * EPS  # of a component of order one, by an integration


def loaded_rod(length: float = 0.3, stiffness: float = 0.01) -> tuple[mr.SingleRod, mr.Inputs]:
    """A rod with shear under all kinds of dead loads; what is given is the unit of everything."""
    k, L = stiffness, length
    force = k / L**2
    robot = mr.SingleRod(
        mr.Rod(
            length=L,
            bending_stiffness=(k, 1.3 * k),
            torsional_stiffness=0.8 * k,
            shear_stiffness=300 * force,
            axial_stiffness=1000 * force,
            precurvature=[(0.4 * L, (1 / L, 0.5 / L, 0)), (0.6 * L, (0, 2 / L, 0.3 / L))],
            linear_density=force / L,
        )
    )
    loads = np.array([(1, 0.5, -0.3), (-2, 1, 0.5), (0, 0, 0)]) * force
    return robot, robot.inputs(
        tip_force=loads, tip_moment=(0.1 * force * L, 0, 0), distributed_force=(0, 0.3 * force / L, 0), gravity=(0, 0, -1.0)
    )


def three_tubes() -> tuple[mr.ConcentricTubes, mr.Inputs]:
    data = ((0.00387, 0.00301, 0.431, 0.103, 9.0), (0.01717, 0.01402, 0.332, 0.113, 6.0), (0.03977, 0.05022, 0.174, 0.134, 3.5))
    robot = mr.ConcentricTubes(
        [
            mr.Rod(length=L, bending_stiffness=EI, torsional_stiffness=GJ, precurvature=[(L - c, (0, 0, 0)), (c, (u, 0, 0))])
            for EI, GJ, L, c, u in data
        ]
    )
    force = [(0.1, 0.2, -0.1), (0.0, 0.0, 0.0), (0.3, -0.2, 0.1)]
    return robot, robot.inputs(rotation=(0.4, 0.8, -0.3), translation=(-0.28, -0.22, -0.1), tip_force=force)


def six_legs() -> tuple[mr.ParallelRods, mr.Inputs]:
    leg = mr.Rod(length=0.4, bending_stiffness=0.157, torsional_stiffness=0.126)
    base, platform = np.tile(np.eye(4), (6, 1, 1)), np.tile(np.eye(4), (6, 1, 1))
    lean = np.radians(40) * (-1.0) ** np.arange(6)
    for poses, twist in ((base, 0.0), (platform, lean)):
        angle = twist + 2 * np.pi * np.arange(6) / 6
        poses[:, :2, 3] = 0.087 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    robot = mr.ParallelRods(legs=[leg] * 6, base=base, platform=platform)
    return robot, robot.inputs(translation=0.01 * np.sin(np.arange(6)), tip_force=[(0.5, 0.2, -1.0), (0.0, 0.4, 0.3)])


SCENES = {"loaded rod": loaded_rod, "three tubes": three_tubes, "six legs": six_legs}


@pytest.mark.parametrize("scene", SCENES)
def test_error_against_double_precision(scene):
    """The residual, by double precision, is the tolerance and an integration's rounding; the tip follows from it by Gamma."""
    robot, inputs = SCENES[scene]()
    double = mr.solve(robot, inputs, solver=mr.Shooting(integrator=DOUBLE)).raise_if_failed()
    single = mr.solve(robot, inputs, solver=mr.Shooting(integrator=SINGLE)).raise_if_failed()
    problem = robot.problem(inputs, integrator=DOUBLE)
    residual, gamma = problem.evaluate(single.unknowns)
    growth = np.linalg.norm(gamma, ord=2, axis=(1, 2))
    size = np.abs(residual).max(axis=1)
    allowed = (SINGLE_TOLERANCE + ROUNDED * growth) * problem.curvature_scale()
    assert (size <= allowed).all()
    assert (single.residual <= SINGLE_TOLERANCE * problem.curvature_scale()).all()
    # a change of x turns no part of the rod by more than x L, and moves none by more than x L^2
    length = max(float(np.max(rod.length)) for rod in robot.rods)
    off = np.linalg.norm(residual, axis=1) / np.linalg.svd(gamma, compute_uv=False)[:, -1] * length + ROUNDED
    assert (np.linalg.norm(single.tip_position - double.tip_position, axis=1) <= off * length).all()
    assert (np.abs(single.tip_rotation - double.tip_rotation).max(axis=(1, 2)) <= off).all()
    # and it was single precision
    rounded = robot.problem(inputs, integrator=SINGLE).evaluate(single.unknowns)[0]
    assert (np.abs(rounded - residual).max(axis=1) > EPS / 100 * problem.curvature_scale()).any()


@pytest.mark.parametrize("scene", ["loaded rod", "three tubes"])
def test_rk4_converges_to_the_floor(scene):
    """The error of the method falls with the fourth power of the steps; that of rounding stays where it is."""
    robot, inputs = SCENES[scene]()
    found = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK4(400))).raise_if_failed()
    errors = []
    for steps in (4, 16, 64, 512):
        problem = robot.problem(inputs, integrator=mr.RK4(steps, precision="float32"))
        residual, gamma = problem.evaluate(found.unknowns)
        errors.append(np.abs(residual).max() / problem.curvature_scale()[0])
        floor = ROUNDED * np.linalg.norm(gamma, ord=2, axis=(1, 2)).max()
        twin = robot.problem(inputs, integrator=mr.RK4(steps)).evaluate(found.unknowns)[0]
        assert np.abs(residual - twin).max() <= floor * problem.curvature_scale()[0]
    # 256 times less where it is the method's, which ends in a few EPS
    assert errors[0] > 100 * errors[1] or errors[1] < 5 * EPS
    assert errors[0] > 10 * errors[1]
    # more steps are more roundings
    assert EPS / 10 < errors[2] < errors[3] <= floor


@pytest.mark.parametrize(
    ("length", "stiffness"), [(0.1, 1e-37), (1e-12, 1e-37), (1000.0, 1e6), (1000.0, 1e30)], ids=lambda value: f"{value:g}"
)
@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_units_do_not_matter(length, stiffness):
    """Sections of 1e-12 m have EI = 1e-37 N m^2, which float32 does not hold: steps are taken in natural units."""
    scaled = {}
    for unit in ((1.0, 1.0), (length, stiffness)):
        robot, inputs = loaded_rod(*unit)
        found = mr.solve(robot, inputs, solver=mr.Shooting(integrator=SINGLE)).raise_if_failed()
        L, k = unit
        compliance = found.jacobian("tip_force") * k / L**2
        compliance[:, :3] /= L
        scaled[unit] = np.concatenate(
            [found.tip_position / L, found.tip_rotation.reshape(3, -1), found.unknowns * L, compliance.reshape(3, -1)], axis=1
        )
    first, second = scaled.values()
    # the conversions are double precision, so both round to the same numbers but where they are halfway
    assert np.abs(first - second).max() < 10 * EPS


@pytest.mark.parametrize("integrator", [SINGLE, mr.RK45(precision="float32")], ids=str)
def test_no_node_is_lost(wire, integrator):
    """A section far shorter than float32 tells places apart by changes nothing."""
    tips = []
    for parts in (1, 3):
        sections = [(0.2, (3, 0, 0)), (1e-12, (5, 0, 1)), (0.2 - 1e-12, (0, 2, 0))]
        if parts == 1:
            sections = [(0.2, (3, 0, 0)), (0.2, (0, 2, 0))]
        robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.1, precurvature=sections))
        found = mr.solve(robot, robot.inputs(tip_force=(1, 0, 0.2)), solver=mr.Shooting(integrator=integrator)).raise_if_failed()
        tips.append(found.tip_position)
        shape = found.rod(nodes=41)
        assert np.abs(shape.arclength - np.linspace(0, 0.4, 41)).max() < 1e-15
        assert np.abs(shape.position[-1] - found.tip_position).max() < 0.4 * ROUNDED
    # the tolerance moves the tip
    assert np.abs(tips[0] - tips[1]).max() < SINGLE_TOLERANCE * 3 * 0.4**2 + 0.4 * ROUNDED


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_step_control_comes_to_an_end():
    """At the finest tolerances allowed it takes about as many steps as double precision, however the rod is loaded."""
    robot, _ = loaded_rod()
    rng = np.random.default_rng(0)
    force = 10.0 ** rng.uniform(-12, 4, (100, 1)) * rng.standard_normal((100, 3))
    spread = {"distributed_force": (0, 1e-3, 0), "distributed_moment": (0, 0, 1e-6), "gravity": (0, 0, -1.0)}
    inputs = robot.inputs(tip_force=force, tip_moment=(1e-6, 0, 0), **spread)
    counts = {}
    for precision in ("float32", "float64"):
        problem = robot.problem(inputs, integrator=mr.RK45(1e-6, 1e-7, precision=precision))
        problem.evaluate(problem.guess())
        counts[precision] = problem.step_count.numpy() * (problem.fault.numpy() == 0)
    both = (counts["float32"] > 0) & (counts["float64"] > 0)
    assert both.sum() > 80
    assert (counts["float32"] <= 1.5 * counts["float64"] + 5)[both].all()


@pytest.mark.parametrize("scene", SCENES)
def test_an_instance_is_bitwise_the_same_alone(scene):
    robot, inputs = SCENES[scene]()
    together = mr.solve(robot, inputs, solver=mr.Shooting(integrator=SINGLE))
    count = len(together.status)
    for k in range(count):
        alone = mr.solve(robot, inputs, solver=mr.Shooting(integrator=SINGLE), instances=[k])
        if scene == "three tubes" and not np.asarray(inputs.tip_force)[k].any():
            continue  # an unloaded one has other unknowns alone
        for name in ("unknowns", "gamma", "tip_position", "tip_rotation"):
            assert (getattr(together, name)[k] == getattr(alone, name)[0]).all()


def test_double_precision_is_the_default_and_unaffected(wire):
    robot = mr.SingleRod(wire)
    inputs = robot.inputs(tip_force=(1, 0, 0))
    before = mr.solve(robot, inputs, solver=mr.Shooting(integrator=DOUBLE))
    mr.solve(robot, inputs, solver=mr.Shooting(integrator=SINGLE))
    after = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK4(50, precision="float64")))
    assert (before.unknowns == after.unknowns).all()
    assert (before.gamma == after.gamma).all()
    assert before.residual < 1e-9


def test_refusals():
    with pytest.raises(ValueError, match=r"RK4.precision = 'float16' is not allowed: must be one of 'float64', 'float32'"):
        mr.RK4(50, precision="float16")
    with pytest.raises(ValueError, match="RK23.precision"):
        mr.RK23(precision=32)
    with pytest.raises(ValueError, match=r"RK45.rtol = 1e-08 is not allowed: must be >= 1e-06 in float32"):
        mr.RK45(1e-8, precision="float32")
    with pytest.raises(ValueError, match=r"RK45.atol = 1e-10 is not allowed: must be >= 1e-07 in float32"):
        mr.RK45(1e-5, 1e-10, precision="float32")
    with pytest.raises(ValueError, match=r"ScipyShooting.integrator .* must be in float64"):
        mr.ScipyShooting(integrator=SINGLE)
    mr.ScipyShooting(integrator=SINGLE, exact_gradient=True)


def test_names():
    assert str(SINGLE) == "RK4(50, float32)"
    assert str(mr.RK4(50)) == "RK4(50)"
    assert str(mr.RK45(precision="float32")) == "RK45(rtol=1e-06, atol=1e-07, float32)"
    assert "float32" in repr(mr.Shooting(integrator=SINGLE))
    assert mr.RK45() == mr.RK45(1e-8, 1e-10)


def test_stability_and_rescue_are_double_precision():
    """What single precision cannot follow is solved by multiple shooting, in double; so is every test of stability."""
    assert mr.MultipleShooting(integrator=SINGLE).integrator == DOUBLE
    robot = mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8))
    inputs = robot.inputs(tip_force=[(60.0, 0, 3.0), (0.5, 0, 0)])
    single = mr.solve(robot, inputs, solver=mr.Shooting(integrator=mr.RK45(precision="float32")))
    double = mr.solve(robot, inputs, solver=mr.Shooting())
    single.raise_if_failed()
    assert (single.index == double.index).all()
    assert np.abs(single.stability_margin - double.stability_margin).max() < 1e-4
    assert single.residual[0] < 1e-9 < single.residual[1]
    assert np.abs(single.tip_position - double.tip_position)[0].max() < 1e-5  # RK45 at 1e-6


def solved_again_in_double(robot, inputs, single, double):
    """A tolerance below the floor of single precision: the same branch, not the lowest of all that a search comes to."""
    found, expected = (mr.solve(robot, inputs, solver=mr.Shooting(integrator=own, tolerance=1e-9)) for own in (single, double))
    assert (expected.status == mr.Status.CONVERGED).all()
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_array_equal(found.unknowns, expected.unknowns)
    assert (found.integrations > expected.integrations).all()


def test_what_single_precision_does_not_reach_is_solved_in_double(wire):
    """By its own steps: those of the same tolerances."""
    robot = mr.SingleRod(wire)
    inputs = robot.inputs(tip_force=[(1, 0.5, 0.3), (-2, 1, 0.5)])
    solved_again_in_double(robot, inputs, mr.RK45(precision="float32"), mr.RK45(rtol=1e-6, atol=1e-7))


@pytest.mark.parametrize("scene", [three_tubes, six_legs])
def test_so_are_tubes_and_legs(scene):
    solved_again_in_double(*scene(), SINGLE, DOUBLE)


def test_observer(wire):
    robot = mr.SingleRod(wire)
    t = np.arange(0, 0.2, 0.005)
    inputs = robot.inputs(tip_force=np.stack([np.sin(t), np.cos(t), 0 * t], axis=-1))
    tips = [
        mr.simulate(robot, inputs, time=t, solver=mr.Observer(integrator=integrator)).tip_position
        for integrator in (SINGLE, DOUBLE)
    ]
    assert np.abs(tips[0] - tips[1]).max() < 0.4 * ROUNDED
    still = mr.solve(robot, robot.inputs(tip_force=(1, 0, 0)), solver=mr.Observer(integrator=SINGLE)).raise_if_failed()
    assert still.residual <= SINGLE_TOLERANCE * 19


# ---- natural units ----

SMALL, SOFT = 2.0**-20, 2.0**-44  # powers of two: numbers are scaled without rounding


def everything(length, stiffness):
    """Residual, columns and pose of three rods under every load, scaled in length and stiffness."""
    force, weight = stiffness / length**2, stiffness / length**3

    def rod(size, EI, GJ, u):
        return mr.Rod(
            length=size * length,
            bending_stiffness=(EI * stiffness, 1.5 * EI * stiffness),
            torsional_stiffness=GJ * stiffness,
            shear_stiffness=200 * force,
            axial_stiffness=500 * force,
            precurvature=lambda s: (np.sin(3 * s / length) * u / length, u / length, 0.5 / length + 0 * s),
            linear_density=weight,
        )

    rods = [rod(1.0, 1.0, 0.8, 2.0), rod(0.75, 1.25, 1.0, 1.0), rod(0.5, 2.0, 1.5, 3.0)]
    values = {
        "rotation": (0.1, 0.5, -0.7),
        "translation": (-0.125 * length, -0.0625 * length, 0.0),
        "tip_force": np.array([0.5, 1.0, -0.25]) * force,
        "tip_moment": np.array([0.25, -0.5, 0.125]) * force * length,
        "follower_force": np.array([0.125, 0.25, 0.5]) * force,
        "follower_moment": np.array([0.125, 0.0, 0.25]) * force * length,
        "distributed_force": lambda s: (weight * np.cos(2 * s / length), weight * s / length, 0 * s),
        "distributed_moment": lambda s: (force * s / length, 0 * s, force * np.sin(s / length)),
        "gravity": (0.5, 0.25, -1.0),
    }
    problem = BackboneProblem(
        rods, np.eye(4), Inputs(BACKBONE_INPUTS, 3, values, length), integrator=mr.RK4(steps=16, precision="float32"),
        transmission=True, direction_count=3, pose_sensitivities=True,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    problem.unknowns.assign(rng.normal(size=problem.unknowns.shape) / length)
    directions = rng.normal(size=problem.directions.shape)
    scales = {"rotation": 1.0, "translation": length, "gravity": 1.0, "distributed_force": weight, "distributed_moment": force}
    scales |= {name: force * length if "moment" in name else force for name in values if name.startswith(("tip", "follower"))}
    for name, scale in scales.items():
        directions[..., problem.input_slice(name)] *= scale
    directions[..., -1] = 0.5
    problem.directions.assign(directions)
    problem.integrate()
    assert problem.fault.numpy()[0] == 0
    pose = problem.pose_columns.numpy()[0]
    return {
        "residual": problem.read("residual") * length,
        "gamma": problem.read("gamma"),
        "directions": problem.residual_directions.numpy() * length,
        "position": problem.read("position") / length,
        "positions by unknowns": pose[:3, : problem.unknown_count] / length**2,
        "positions by directions": pose[:3, problem.unknown_count :] / length,
        "rotations by unknowns": pose[3:, : problem.unknown_count] / length,
        "rotations by directions": pose[3:, problem.unknown_count :],
    }


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_every_number_is_counted_in_natural_units():
    """A rod 1e6 times smaller and 2e13 times softer has the same numbers in them, to the last bit."""
    whole, small = everything(1.0, 1.0), everything(SMALL, SOFT)
    for name, value in whole.items():
        assert np.abs(value).max() > 0, name
        np.testing.assert_allclose(small[name], value, rtol=1e-13, atol=1e-13 * np.abs(value).max(), err_msg=name)
