"""Parallel rods: derivatives, joints, equilibrium of the whole robot, reference cases, forward and inverse problem."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_check_assembly import check_assembly

import multirod as mr
from multirod.models.backbone.nodes.node_passes import NodePasses
from multirod.models.platform.problem import ParallelProblem
from multirod.models.platform.starting import closing
from multirod.models.platform.starting.guess import BeamEquilibrium, _joint_stiffness, fitted_platform
from multirod.problem import BoundaryProblem
from multirod.results.strains import strains
from multirod.solvers.continuation.paths import SINGULAR, Paths
from multirod.status import Fault

ROD = mr.Rod(
    length=0.3, bending_stiffness=(0.02, 0.03), torsional_stiffness=0.015, precurvature=(1.0, 0.4, 0), linear_density=0.05
)
SOFT = mr.Rod(
    length=0.32, bending_stiffness=0.02, torsional_stiffness=0.015, shear_stiffness=8.0, axial_stiffness=20.0, linear_density=0.05
)
INNER = mr.Rod(length=0.35, bending_stiffness=0.01, torsional_stiffness=0.008, precurvature=[(0.2, (0, 0, 0)), (0.15, (6, 0, 1))])
OUTER = mr.Rod(length=0.25, bending_stiffness=0.03, torsional_stiffness=0.023, precurvature=(2, 1, 0))


def tubes() -> mr.ConcentricTubes:
    return mr.ConcentricTubes([INNER, OUTER])


def ring(count: int, radius: float, twist: float = 0.0, tilt: float = 0.0) -> np.ndarray:
    """Poses (count, 4, 4) on a circle, turned with it and tilted outwards."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        angle = twist + 2 * np.pi * k / count
        poses[k, :3, :3] = Rotation.from_euler("zy", [angle, tilt]).as_matrix()
        poses[k, :3, 3] = radius * np.array([np.cos(angle), np.sin(angle), 0])
    return poses


def robot(legs, joints="clamped", **options) -> mr.ParallelRods:
    count = len(legs)
    return mr.ParallelRods(
        legs=legs, base=ring(count, 0.06, tilt=0.1), platform=ring(count, 0.03, 0.15, 0.05), joints=joints, **options
    )


LOADS = {
    "tip_force": (0.3, -0.2, -0.4),
    "tip_moment": (0.01, 0.02, -0.01),
    "follower_force": (0.1, 0.05, 0.1),
    "follower_moment": (0.004, -0.003, 0.01),
    "force_point": (0.01, -0.02, 0.03),
    "distributed_force": (0.2, 0.1, -0.3),
    "distributed_moment": (0.01, 0, 0.02),
    "gravity": (0, 1.0, -9.81),
}
EXACT = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-11, atol=1e-13))
FEW = mr.RK45(steps=12)  # fixed, by the kernels of ``EXACT``
HEAVY = {"platform_mass": 0.02, "platform_centre": (0.005, -0.01, 0.02)}
SCENES = {
    "two rods": lambda: robot([ROD, SOFT]),
    "three, every joint": lambda: robot(
        [ROD, SOFT, ROD], ["clamped", "spherical", "revolute"], joint_axes=[(0, 0, 1), (0, 0, 1), (1, 2, 2)], **HEAVY
    ),
    "six rods": lambda: robot([ROD] * 3 + [SOFT] * 3),
    "rod and tubes": lambda: robot([ROD, tubes(), tubes()], ["clamped", "clamped", "revolute"], **HEAVY),
}


def actuation(parallel: mr.ParallelRods, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Rotations and translations that every leg can take."""
    high = 0.0 if any(isinstance(leg, mr.ConcentricTubes) for leg in parallel.legs) else 0.03
    translation = rng.uniform(-0.03, high, len(parallel.rods))
    first = 0
    for leg in parallel.legs:
        count = len(leg.rods) if isinstance(leg, mr.ConcentricTubes) else 1
        translation[first : first + count].sort()  # inner tubes start further back
        first += count
    assert parallel.surely_takes("translation", translation)
    assert not parallel.surely_takes("translation", -translation - 0.4)
    return {"rotation": rng.uniform(-0.5, 0.5, len(parallel.rods)), "translation": translation}


@pytest.mark.parametrize("scene", SCENES)
def test_gamma_and_directions_are_derivatives(scene, difference):
    rng = np.random.default_rng(1)
    parallel = SCENES[scene]()
    values = LOADS | actuation(parallel, rng)
    names = list(values)
    inputs = parallel.inputs(**values)
    count = len(names)
    problem = parallel.problem(inputs, integrator=FEW, pose_sensitivities=True, direction_count=count)
    x = problem.guess() + 0.3 * rng.standard_normal((1, problem.unknown_count))
    steps = {name: rng.standard_normal(np.shape(values[name])) for name in names}
    steps["force_point"] *= 0.1
    steps["translation"] *= 0.01  # so little that no stretch gets another number of steps
    directions = np.zeros(problem.directions.shape)
    for k, name in enumerate(names):
        directions[0, k, problem.input_slice(name)] = steps[name]
    problem.directions.assign(directions)
    gamma = problem.evaluate(x)[1][0]
    by_input = problem.residual_directions.numpy()[0].copy()
    columns = problem.pose_columns.numpy()[0].copy()
    assert np.isfinite(gamma).all()

    def at(y, **changes):
        problem.write("inputs", problem.pack(parallel.inputs(**values | changes)))
        residual = problem.evaluate(y)[0][0]
        return residual, problem.position.numpy()[0].copy(), problem.rotation.numpy()[0].copy()

    R = at(x)[2]

    def all_of(state):
        residual, position, rotation = state
        # rotation matrices differ from R by little: their logarithm to sixth order and beyond
        return np.concatenate([residual, position, Rotation.from_matrix(rotation @ R.T).as_rotvec()])

    n = problem.unknown_count
    expected = np.concatenate([gamma, columns[:, :n]])
    found = np.stack([difference(lambda h, k=k: all_of(at(x + h * np.eye(n)[k])), 1e-2) for k in range(n)], axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * max(1, np.abs(expected).max()))
    expected = np.concatenate([by_input, columns[:, n:]])
    found = np.stack([difference(lambda h, s=s: all_of(at(x, **{s: values[s] + h * steps[s]})), 1e-2) for s in names], axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * max(1, np.abs(expected).max()))


@pytest.mark.parametrize("scene", ["two rods", "rod and tubes"])
def test_jacobian_is_the_derivative_of_the_pose(scene, difference):
    parallel = SCENES[scene]()
    values = LOADS | actuation(parallel, np.random.default_rng(2))
    # the derivative is that of the discretised equations
    solver = mr.Shooting(tolerance=1e-11, integrator=FEW)
    solution = mr.solve(parallel, parallel.inputs(**values), solver=solver).raise_if_failed()
    R = solution.tip_rotation
    for name in values if scene == "two rods" else ("tip_force", "force_point"):
        direction = np.random.default_rng(5).standard_normal(np.shape(values[name]))

        def pose(h, name=name, direction=direction):
            changed = values | {name: np.asarray(values[name]) + h * direction}
            moved = mr.solve(parallel, parallel.inputs(**changed), guess=solution, solver=solver).raise_if_failed()
            turn = Rotation.from_matrix(moved.tip_rotation @ R.T).as_rotvec()
            return np.concatenate([moved.tip_position, turn])

        found = difference(pose, {"translation": 1e-4, "force_point": 1e-3}.get(name, 1e-2))
        expected = solution.jacobian(name) @ direction
        # the pose at equilibrium is right to 1e-11 / sigma_min / h
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("scene", SCENES)
def test_the_whole_robot_is_in_equilibrium(scene):
    """Base wrenches, weights and loads add up to nothing, about any point."""
    parallel = SCENES[scene]()
    values = LOADS | actuation(parallel, np.random.default_rng(2))
    solution = mr.solve(parallel, parallel.inputs(**values), solver=EXACT).raise_if_failed()
    p, R = solution.tip_position, solution.tip_rotation
    mass, centre = parallel.geometry.mass, p + R @ parallel.geometry.mass_centre
    point = p + R @ values["force_point"]
    push = values["tip_force"] + R @ values["follower_force"]
    weight = mass * np.array(values["gravity"])
    force = push + weight
    moment = values["tip_moment"] + R @ values["follower_moment"] + np.cross(point, push) + np.cross(centre, weight)
    index = 0
    for leg in parallel.geometry.legs:
        shapes = [solution.rod(index + i, nodes=2001) for i in range(leg.rod_count)]
        index += leg.rod_count
        longest = max(shapes, key=lambda shape: shape.arclength[-1])
        s, h = longest.arclength, longest.arclength[1]
        simpson = h / 3 * np.array([1, *([4, 2] * 1000)[:-1], 1])
        density = sum(rod.sections[0].linear_density for rod in leg.rods)  # tubes here have none
        spread = np.array(values["distributed_force"]) + density * np.array(values["gravity"])
        force += s[-1] * spread
        moment += np.cross(simpson @ longest.position, spread) + s[-1] * np.array(values["distributed_moment"])
        force -= longest.rotation[0] @ longest.force[0]
        # the moments of concentric tubes act about one centreline and add up
        moment -= sum(shape.rotation[0] @ shape.moment[0] for shape in shapes)
        moment -= np.cross(longest.position[0], longest.rotation[0] @ longest.force[0])
    scale = np.abs(push).sum()
    # what rounding and the tolerance of 1e-11 / m leave of forces of up to 20 N; Simpson's rule is right to 1e-13
    np.testing.assert_allclose(force, 0, atol=1e-9 * scale)
    np.testing.assert_allclose(moment, 0, atol=1e-9 * scale)


@pytest.mark.parametrize("scene", SCENES)
def test_joints_hold_what_they_must(scene):
    parallel = SCENES[scene]()
    values = LOADS | actuation(parallel, np.random.default_rng(2))
    solution = mr.solve(parallel, parallel.inputs(**values), solver=EXACT).raise_if_failed()
    geometry, index = parallel.geometry, 0
    for k, leg in enumerate(geometry.legs):
        shapes = [solution.rod(index + i, nodes=3) for i in range(leg.rod_count)]
        index += leg.rod_count
        tip = max(shapes, key=lambda shape: shape.arclength[-1])
        at = np.eye(4)
        at[:3, :3], at[:3, 3] = solution.tip_rotation, solution.tip_position
        at = at @ geometry.platform[k]
        np.testing.assert_allclose(tip.position[-1], at[:3, 3], atol=1e-10)
        moment, axis = tip.moment[-1], geometry.axes[k]
        kind = ["clamped", "revolute", "spherical"][geometry.joints[k]]
        if kind == "clamped":
            np.testing.assert_allclose(tip.rotation[-1], at[:3, :3], atol=1e-9)
        if kind == "revolute":
            np.testing.assert_allclose(tip.rotation[-1] @ axis, at[:3, :3] @ axis, atol=1e-9)
            assert abs(moment @ axis) < 1e-11
            assert np.linalg.norm(moment) > 1e-4
        if kind == "spherical":
            np.testing.assert_allclose(moment, 0, atol=1e-11)


def test_a_guess_is_where_the_energy_of_the_beams_is_least():
    """(11) By differences of that energy, in which turns add up."""
    parallel = SCENES["three, every joint"]()
    problem = parallel.problem(parallel.inputs(translation=(0.01, 0.0, -0.02)), integrator=FEW)
    with problem.closing.unloaded():
        _, legs, at = problem.closing.unloaded_legs()
    legs, start = legs.softened((1e-3,)), fitted_platform(legs, at)
    position, rotation, _ = BeamEquilibrium(1, 3).found(legs, at, *start)
    assert np.abs(position - start[0]).max() > 1e-4
    arm = at.arm[0] @ rotation[0].T
    frames = rotation[0] @ at.frame[0] @ np.swapaxes(legs.rotation[0], -1, -2)
    deflection, turn = position + arm - legs.position[0], Rotation.from_matrix(frames).as_rotvec()
    t, L, stiffness = legs.rotation[0, :, :, 2], legs.length[0][:, None], _joint_stiffness(legs, at)[0]

    def energy(change):
        d, turned = deflection + change[:3] + np.cross(change[3:], arm), turn + change[3:]
        slope = np.cross(turned, t)
        across = d - (d * t).sum(axis=1, keepdims=True) * t
        quadratic = 1.2 / L * across**2 - 0.2 * across * slope + 2 / 15 * L * slope**2
        strain = np.concatenate([d + 0.5 * quadratic.sum(axis=1, keepdims=True) * t, turned], axis=1)
        return 0.5 * np.einsum("li,lij,lj->", strain, stiffness, strain)

    for step in np.diag([1e-4] * 3 + [1e-3] * 3):
        below, here, above = (energy(k * step) for k in (-1, 0, 1))
        # in such steps: eight iterations that leave a quarter each of 5 cm and half a radian, where legs fit this badly
        assert abs(above - below) / (2 * (above - 2 * here + below)) < 1e-2


def hexapod(legs=None, **options) -> mr.ParallelRods:
    """Six straight legs that cross in pairs, as in a Stewart platform."""
    leg = mr.Rod(length=0.4, bending_stiffness=0.157, torsional_stiffness=0.126, linear_density=0.01)
    base, platform = np.tile(np.eye(4), (6, 1, 1)), np.tile(np.eye(4), (6, 1, 1))
    at = np.radians([-10, 10, 110, 130, 230, 250])
    to = np.radians([-50, 50, 70, 170, 190, 290])
    base[:, :2, 3] = 0.087 * np.stack([np.cos(at), np.sin(at)], 1)
    platform[:, :2, 3] = 0.087 * np.stack([np.cos(to), np.sin(to)], 1)
    return mr.ParallelRods(legs=legs or [leg] * 6, base=base, platform=platform, **options)


def test_the_inverse_problem_undoes_the_forward_one():
    robot = hexapod(platform_mass=0.1)
    translation = np.array([0.01, -0.005, 0.02, 0.0, 0.015, -0.01])
    loads = {"tip_force": (0.5, -0.3, -1.0), "gravity": (0, 0, -9.81), "force_point": (0.01, 0, 0)}
    forward = mr.solve(robot, robot.inputs(translation=translation, **loads), solver=EXACT).raise_if_failed()
    inverse = robot.inverse()
    turn = Rotation.from_matrix(forward.tip_rotation).as_rotvec()
    inputs = inverse.inputs(platform_position=forward.tip_position, platform_rotation=turn, **loads)
    found = mr.solve(inverse, inputs, solver=EXACT).raise_if_failed()
    np.testing.assert_allclose(inverse.translations(found), translation, atol=1e-9)
    np.testing.assert_allclose(found.tip_position, forward.tip_position, atol=1e-15)
    np.testing.assert_allclose(found.tip_rotation, forward.tip_rotation, atol=1e-14)
    for k in range(6):
        np.testing.assert_allclose(found.rod(k).position, forward.rod(k).position, atol=1e-8)
    np.testing.assert_array_equal(found.inputs.translation, inverse.translations(found))  # zeros, before
    assert set(found.inputs.given) == {"platform_position", "platform_rotation", "translation", *loads}
    # (10) counted from what was found, or from elsewhere, a guess is at the same place: nothing is left to be done
    for origin in (found.inputs.translation, 0.01 * np.arange(6)):
        given = inverse.inputs(translation=origin, platform_position=forward.tip_position, platform_rotation=turn, **loads)
        again = mr.solve(inverse, given, solver=EXACT, guess=found).raise_if_failed()
        # counted from elsewhere, rounding of the translations may be worth a step
        assert again.iterations <= 1
        np.testing.assert_allclose(again.inputs.translation, translation, atol=1e-9)


def test_along_legs_of_the_inverse_problem():
    """(D20) What the forward problem's derivatives by translations say, these chosen so that the platform stays, or goes where it
    is told. The end of the first section moves with the translation that is found."""
    sections = [
        mr.Section(length=length, bending_stiffness=EI, torsional_stiffness=0.8 * EI) for length, EI in ((0.15, 0.2), (0.25, 0.1))
    ]
    robot = hexapod(legs=[mr.Rod(sections=sections, outer_diameter=3e-3)] * 6)
    translation, force = np.array([0.01, -0.005, 0.02, 0.0, 0.015, -0.01]), (0.5, -0.3, -1.0)
    forward = mr.solve(robot, robot.inputs(translation=translation, tip_force=force), solver=EXACT).raise_if_failed()
    inverse = robot.inverse()
    found = mr.solve(inverse, inverse_inputs(inverse, forward, tip_force=force), solver=EXACT).raise_if_failed()
    # of the sections where they are, not where they would be if no leg was pushed along
    bent, told = (strains(own, 2, own.rod(2))["bending"] for own in (found, forward))
    np.testing.assert_allclose(bent, told, rtol=0, atol=1e-8 * told.max())
    at, by_pose = (0.1, 0.3), np.linalg.inv(forward.jacobian("translation"))
    for of in ("position", "rotation", "curvature"):
        by_translation, by_force = np.split(forward.jacobian("translation", "tip_force", of=of, at=at, rod=2), [6], axis=-1)
        moved = by_translation @ by_pose
        expected = np.concatenate([moved[..., :3], by_force - moved @ forward.jacobian("tip_force")], axis=-1)
        given = found.jacobian("platform_position", "tip_force", of=of, at=at, rod=2)
        # both are exact, the solutions known to 1e-9
        np.testing.assert_allclose(given, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    # it is as long as the translation that is found makes it
    assert found.jacobian("tip_force", of="position", at=0.42, rod=2).shape == (3, 3)
    with pytest.raises(ValueError, match=r"must be >= 0 and <= 0.42 m"):
        found.jacobian("tip_force", of="position", at=0.421, rod=2)


def columns_integrated(monkeypatch, robot, compute):
    """Directions that each leg integrates beside its unknowns, by each problem that was made on the way."""
    made, whole = [], type(robot).problem

    def problem(self, *arguments, **options):
        made.append(whole(self, *arguments, **options))
        return made[-1]

    with monkeypatch.context() as patch:
        patch.setattr(type(robot), "problem", problem)
        result = compute()
    return result, [[group.backbones.direction_count for group in one.groups] for one in made]


@pytest.mark.parametrize(
    ("name", "columns"),
    [("translation", 1), ("rotation", 1), ("tip_force", 0), ("tip_moment", 0), ("force_point", 0), ("gravity", 3)],
)
def test_a_leg_integrates_the_directions_that_touch_it_alone(monkeypatch, name, columns):
    robot = hexapod(platform_mass=0.1)
    inputs = robot.inputs(tip_force=(0.5, -0.3, -1.0), force_point=(0.01, 0, 0), gravity=(0, 0, -9.81))
    solution = mr.solve(robot, inputs, solver=EXACT).raise_if_failed()
    found, counts = columns_integrated(monkeypatch, robot, lambda: solution.jacobian(name))
    assert counts == [[columns]]
    assert found.shape == (6, 6 if columns == 1 else 3)
    # all columns on every leg, as a solver's direction is integrated
    problem = robot.problem(inputs, integrator=EXACT.integrator, pose_sensitivities=True, direction_count=found.shape[1])
    problem.write("unknowns", solution.unknowns[None])
    BoundaryProblem.aim(problem, name)
    problem.integrate()
    slopes, pose = BoundaryProblem.aimed(problem, name)
    gamma, n = problem.read("gamma").reshape(problem.unknown_count, -1), problem.unknown_count
    whole = pose[0] - problem.pose_columns.numpy()[0, :, :n] @ np.linalg.solve(gamma, slopes[0])
    # the same sums less zeros, and Gamma's condition of 3e3 on their rounding
    np.testing.assert_allclose(found, whole, rtol=0, atol=1e-11 * np.abs(whole).max())


def test_several_inputs_at_once_are_those_alone_beside_each_other(monkeypatch):
    robot = hexapod(platform_mass=0.1)
    inputs = robot.inputs(tip_force=(0.5, -0.3, -1.0), gravity=(0, 0, -9.81), translation=[0.01, 0, 0, 0, 0, 0])
    solution = mr.solve(robot, inputs, solver=EXACT).raise_if_failed()
    names = ("tip_force", "translation", "gravity", "rotation")  # on platform and legs in turn
    found, counts = columns_integrated(monkeypatch, robot, lambda: solution.jacobian(*names))
    assert counts == [[5]]
    alone = np.concatenate([solution.jacobian(name) for name in names], axis=1)
    # the same right-hand sides, solved for together: the last bit may be another
    np.testing.assert_allclose(found, alone, rtol=0, atol=1e-14 * np.abs(alone).max())


def inverse_inputs(inverse, pose, **loads):
    turn = Rotation.from_matrix(pose.tip_rotation).as_rotvec()
    return inverse.inputs(platform_position=pose.tip_position, platform_rotation=turn, **loads)


def heights_of(robot):
    """Poses and a load: legs of 0.4 m would buckle on the way down, and are a third too short on the way up."""
    poses = np.zeros((5, 3))
    poses[:, 2] = np.linspace(0.2, 0.6, 5)
    return {"platform_position": poses, "platform_rotation": (0.1, -0.05, 0.2), "tip_force": (0, 0, -8)}


def test_the_inverse_problem_begins_with_straight_legs_whatever_their_translation():
    """(10b), (11b) From translations as they are two of the heights took hundreds of integrations, or ended at a fold."""
    robot = hexapod()
    inverse = robot.inverse(limits=(-0.3, 0.3))
    given, lengths = heights_of(robot), []
    for translation in (0.0, 0.02 * np.arange(6)):
        found = mr.solve(inverse, inverse.inputs(translation=translation, **given)).raise_if_failed()
        lengths.append(inverse.translations(found))
        there = mr.solve(robot, robot.inputs(translation=lengths[-1], tip_force=(0, 0, -8)))
        np.testing.assert_allclose(there.tip_position[2:], given["platform_position"][2:], rtol=0, atol=1e-7)
        assert (found.stability == mr.Stability.STABLE).all()
        assert found.integrations.max() <= 20  # 10 and 11 were seen
    np.testing.assert_allclose(lengths[0], lengths[1], rtol=0, atol=1e-8)  # the tolerance over the least singular value


def test_each_leg_is_led_to_its_attachment_by_itself(monkeypatch):
    """(11b) By Newton's method on each joint, whose residuals fall by squares, to a quarter at least; no leg is pushed."""
    inverse, left = hexapod().inverse(), []
    for steps in (0, closing.LEG_STEPS):
        monkeypatch.setattr(closing, "LEG_STEPS", steps)
        problem = inverse.problem(inverse.inputs(**heights_of(inverse.robot)), integrator=mr.RK4(50))
        x, legs = problem.guess(), problem.platform.start
        left.append(np.abs(problem.closing.closed().residual[:, :legs]).max(axis=1))
        assert (x[:, problem.held_forces[2::3]] == 0).all()
    assert (problem.guess_integrations <= 4).all()
    assert (left[1] < 0.25 * left[0]).all()


@pytest.fixture(scope="module")
def pressed():
    """A hexapod pressed down until it has lost its stability: each leg buckles between clamps at 4 pi^2 EI/L^2, 232 N for six."""
    robot, found = hexapod(), None
    for force in (0.0, 50.0, 100.0, 150.0, 200.0, 220.0, 240.0):
        found = mr.solve(robot, robot.inputs(tip_force=(0, 0, -force)), guess=found).raise_if_failed()
    assert found.stability is mr.Stability.UNSTABLE
    return robot, found


def test_the_inverse_problem_returns_no_unstable_equilibrium_from_a_guess(pressed):
    robot, there = pressed
    inverse = robot.inverse()
    inputs = inverse_inputs(inverse, there, tip_force=there.inputs.tip_force)
    guess = np.concatenate([there.unknowns[:-6], np.zeros(6)])
    found = mr.solve(inverse, inputs, guess=guess)
    assert found.status is mr.Status.UNSTABLE
    assert np.isnan(inverse.translations(found)).all()
    assert np.isnan(found.inputs.translation).all()
    assert np.isnan(found.tip_position).all()
    # the residual does not tell
    assert found.residual < 1e-9
    tracker = mr.Tracker(inverse, dt=0.01, inputs=inputs, guess=guess)
    assert tracker.step().status is mr.Status.UNSTABLE
    motion = mr.simulate(inverse, inputs, time=[0.0, 0.01], guess=guess)
    assert (motion.status == mr.Status.UNSTABLE).all()


def test_translations_are_those_of_the_instances_at_hand():
    """Legs of several lengths: some of their solutions, in another order, were read by the lengths of others."""
    leg = mr.Rod(length=np.array([0.3, 0.33]), bending_stiffness=0.02, torsional_stiffness=0.015)
    robot = hexapod(legs=[leg] * 6)
    centre = mr.solve(robot).tip_position[0]
    inverse = robot.inverse()
    found = mr.solve(inverse, inverse.inputs(platform_position=centre)).raise_if_failed()
    np.testing.assert_array_equal(inverse.translations(found[::-1]), inverse.translations(found)[::-1])
    np.testing.assert_array_equal(inverse.translations(found[1]), inverse.translations(found)[1])
    np.testing.assert_array_equal(found[1].inputs.translation, inverse.translations(found)[1])
    with pytest.raises(TypeError, match=r"takes a solution of an inverse problem; this is one of ParallelRods$"):
        inverse.translations(mr.solve(robot))


def test_the_inverse_problem_needs_a_position():
    inverse, said = hexapod().inverse(), r"^platform_position was not given: InverseParallelRods needs it, of the platform's"
    for call in (
        inverse.inputs,
        lambda: inverse.inputs(platform_rotation=(0, 0, 0.1)),
        lambda: mr.solve(inverse),
        lambda: mr.solve(inverse, inverse.robot.inputs(tip_force=(0, 0, 1))),  # of the robot itself
        lambda: mr.Tracker(inverse, dt=0.01),
    ):
        with pytest.raises(TypeError, match=said):
            call()


def test_a_pose_that_leaves_a_leg_no_length_is_refused():
    """Legs that stand straight up lead to a platform on the ground: how stiff they are there was a ``LinAlgError``."""
    leg = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015)
    poses = hexapod().base
    inverse = mr.ParallelRods(legs=[leg] * 6, base=poses, platform=poses).inverse()
    for given in ((0, 0, 0), [(0, 0, 0.3), (0, 0, 0)]):
        with pytest.raises(
            ValueError, match=r"^platform_position = \[0.0, 0.0, 0.0\] is not allowed: leg 0 would end where it begins"
        ):
            inverse.inputs(platform_position=given)
    with pytest.warns(mr.PlausibilityWarning, match="lines from bases to attachments depend"):  # all of them in one plane
        turned = inverse.inputs(platform_position=(0, 0, 0), platform_rotation=(0, 0, 0.1))
    assert turned.given == ("platform_position", "platform_rotation")


def test_a_platform_that_is_like_its_base_is_told():
    """The lines of its legs depend on each other wherever it is moved and turned (Ma and Angeles, ICRA 1991)."""
    poses = [mr.Pose(position=(0.1 * np.cos(a), 0.1 * np.sin(a), 0), rotation=np.eye(3)) for a in np.pi / 3 * np.arange(6)]
    inverse = mr.ParallelRods(legs=hexapod().legs, base=poses, platform=poses).inverse()
    for turn in ((0, 0, 0), (0.2, 0.1, 0.5)):
        with pytest.warns(mr.PlausibilityWarning, match="lines from bases to attachments depend on each other at this"):
            inverse.inputs(platform_position=(0.02, 0, 0.39), platform_rotation=turn)
    hexapod().inverse().inputs(platform_position=(0.02, 0, 0.39))  # warnings are errors here


def test_the_inverse_problem_keeps_to_limits():
    robot = hexapod()
    centre = mr.solve(robot).tip_position
    heights = np.array([-0.02, 0.0, 0.03, 0.08])[:, None] * [0, 0, 1]
    free = robot.inverse()
    inputs = free.inputs(platform_position=centre + heights)
    known = mr.solve(free, inputs).raise_if_failed()
    lengths = free.translations(known)
    limits = (-0.01, [0.05] * 5 + [0.1])
    within = ((lengths >= -0.01) & (lengths <= np.array(limits[1]))).all(axis=1)
    assert within.tolist() == [False, True, True, False]
    inverse = robot.inverse(limits=limits)
    for guess in (None, known):
        found = mr.solve(inverse, inputs, guess=guess)
        assert (found.status == np.where(within, mr.Status.CONVERGED, mr.Status.OUT_OF_LIMITS)).all()
        assert (np.isfinite(inverse.translations(found)).all(axis=1) == within).all()
        low, high = inverse.limits
        for k in (0, 3):
            leg = int(np.maximum(low - lengths[k], lengths[k] - high).argmax())
            said = f"the translation of leg {leg} would be {lengths[k, leg]:.4g} m, allowed are -0.01 to {high[leg]:.4g}: "
            with pytest.raises(mr.SolveError, match=f"OUT_OF_LIMITS .*, {said}of inverse"):
                found[k].raise_if_failed()
    assert inverse.with_rods(inverse.rods).limits.tolist() == inverse.limits.tolist()
    assert "limits=[[-0.01" in repr(inverse)
    assert repr(robot) == f"ParallelRods(legs=[{robot.legs[0]!r}] * 6)"
    assert (robot.inverse(limits=(-np.inf, np.inf)).limits == free.limits).all()


@pytest.mark.parametrize(
    "limits",
    [
        0.1,
        (0.1,),
        (0.2, 0.1),
        (np.nan, 0.1),
        ("a", 1),
        (0, [0.1] * 5),
        (0, np.ones((2, 6))),
        (None, 0.1),
        {0: 1, 1: 2},
        (0, 1, 2),
    ],
    ids=repr,
)
def test_bad_limits_are_refused(limits):
    with pytest.raises(ValueError, match=r"(?s)^inverse\.limits = .* is not allowed: must be"):
        hexapod().inverse(limits=limits)


def test_gamma_of_the_inverse_problem(difference):
    inverse = hexapod().inverse()
    values = {"platform_position": (0.01, 0, 0.36), "platform_rotation": (0.05, -0.1, 0.2), "tip_force": (0.2, 0.1, -0.5)}
    inputs = inverse.inputs(**values)
    names = ("platform_position", "platform_rotation", "rotation")
    problem = inverse.problem(inputs, integrator=mr.RK4(10), direction_count=len(names))
    steps = {name: np.random.default_rng(3).standard_normal(3 if name in values else 6) for name in names}
    directions = np.zeros(problem.directions.shape)
    for k, name in enumerate(names):
        directions[0, k, problem.input_slice(name)] = steps[name]
    problem.directions.assign(directions)
    x = problem.guess() + 0.2 * np.random.default_rng(4).standard_normal((1, problem.unknown_count))
    gamma = problem.evaluate(x)[1][0]
    by_input = problem.residual_directions.numpy()[0].copy()
    n = problem.unknown_count
    found = np.stack([difference(lambda h, k=k: problem.evaluate(x + h * np.eye(n)[k])[0][0], 1e-2) for k in range(n)], axis=1)
    np.testing.assert_allclose(found, gamma, rtol=0, atol=1e-8 * np.abs(gamma).max())

    def at(name, h):
        changed = values | {name: np.asarray(values.get(name, np.zeros(6))) + h * steps[name]}
        problem.write("inputs", problem.pack(inverse.inputs(**changed)))
        return problem.evaluate(x)[0][0]

    found = np.stack([difference(lambda h, name=name: at(name, h), 1e-2) for name in names], axis=1)
    np.testing.assert_allclose(found, by_input, rtol=0, atol=1e-8 * np.abs(by_input).max())


def stored_robot(case, make_pose):
    """Robot and inputs of a reference case; its force acts at a point of the platform."""
    stored, platform = case["inputs"]["rods"], case["inputs"]["platform"]
    legs = []
    for rod in stored:
        K, S = rod["K"], rod["S"]
        more = {"shear_stiffness": tuple(S[:2]), "axial_stiffness": S[2]} if S else {}
        legs.append(
            mr.Rod(
                length=rod["length"],
                bending_stiffness=tuple(K[:2]),
                torsional_stiffness=K[2],
                precurvature=tuple(rod["u_star"]),
                **more,
            )
        )
    parallel = mr.ParallelRods(
        legs=legs,
        base=np.stack([make_pose(rod["R0"], rod["p0"]) for rod in stored]),
        platform=np.stack([make_pose(rod["attach_R"], rod["attach_r"]) for rod in stored]),
        joints=["revolute" if rod["twist_free"] else "clamped" for rod in stored],
    )
    return parallel, parallel.inputs(
        tip_force=platform["force_world"],
        tip_moment=platform["moment_world"],
        force_point=platform["force_point_platform"],
        distributed_force=stored[0]["distributed_force_world"],
    )


@pytest.mark.parametrize(("solver", "tolerance"), [(None, 1e-6), (EXACT, 1e-9)], ids=["default", "tight"])
def test_reference_case(parallel_case, make_pose, solver, tolerance):
    parallel, inputs = stored_robot(parallel_case, make_pose)
    solution = mr.solve(parallel, inputs, solver=solver).raise_if_failed()
    expected, length = parallel_case["expected"], parallel_case["inputs"]["rods"][0]["length"]
    np.testing.assert_allclose(solution.tip_position, expected["platform_position"]["value"], rtol=0, atol=tolerance * length)
    np.testing.assert_allclose(solution.tip_rotation, expected["platform_rotation"]["value"], rtol=0, atol=tolerance)
    for k in range(len(parallel.rods)):
        shape = solution.rod(k, nodes=2)
        force, moment = (shape.rotation[0] @ value[0] for value in (shape.force, shape.moment))
        forces, moments = np.array(expected["base_forces"]["value"]), np.array(expected["base_moments"]["value"])
        # stiff directions turn an error of the pose into a force: 1e3 EI/L^3, the condition number
        np.testing.assert_allclose(force, forces[k], rtol=0, atol=1e3 * tolerance * np.abs(forces).max())
        np.testing.assert_allclose(moment, moments[k], rtol=0, atol=1e3 * tolerance * np.abs(moments).max())


def test_cold_start_takes_few_integrations(reference_cases, make_pose):
    """A known code takes 4938 integrations of a leg from the unloaded guess of a robot like these."""
    for case in reference_cases("parallel_continuum_robot"):
        parallel, inputs = stored_robot(case, make_pose)
        solution = mr.solve(parallel, inputs).raise_if_failed()
        assert solution.integrations * len(parallel.rods) <= 100


def test_warm_start_takes_three_integrations(make_pose, reference_cases):
    case = next(c for c in reference_cases("parallel_continuum_robot") if c["id"] == "10d_cpr_stewart_fk_1")
    parallel, _ = stored_robot(case, make_pose)
    t = np.arange(0, 0.5, 0.005)
    phase = 2 * np.pi * t[:, None] + np.arange(6)
    translation = 0.02 * (np.sin(phase) - np.sin(phase[0]))
    force = np.stack([np.sin(t), np.cos(t), -np.ones_like(t)], axis=1)
    inputs = parallel.inputs(translation=translation, tip_force=force)
    history = mr.simulate(parallel, inputs, time=t, solver=mr.Shooting(integrator=mr.RK4(50))).raise_if_failed()
    assert history.integrations[2:].max() <= 3  # the second sample has no slope to start from, and takes 4
    alone = mr.solve(parallel, inputs[60], solver=mr.Shooting(integrator=mr.RK4(50)))
    np.testing.assert_allclose(history.tip_position[60], alone.tip_position, atol=1e-10)


def test_a_batch_is_bitwise_its_instances():
    parallel = SCENES["rod and tubes"]()
    force = np.random.default_rng(0).uniform(-0.2, 0.2, (3, 3))
    inputs = parallel.inputs(tip_force=force)
    batch = mr.solve(parallel, inputs)
    for k in range(3):
        alone = mr.solve(parallel, parallel.inputs(tip_force=force[k]))
        assert np.array_equal(batch.unknowns[k], alone.unknowns)
        assert np.array_equal(batch.tip_position[k], alone.tip_position)
        assert np.array_equal(batch.rod(1).position[k], alone.rod(1).position)


def test_parameters_of_legs_may_vary_by_instance():
    lengths = np.array([0.3, 0.31, 0.29])
    base, platform = ring(3, 0.05), ring(3, 0.03)
    high = np.stack([platform, platform, platform])
    high[:, :, 2, 3] = np.array([0.0, 0.01, -0.01])[:, None]

    def make(length, at):
        leg = mr.Rod(length=length, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(1, 0, 0))
        return mr.ParallelRods(legs=[leg, ROD, SOFT], base=base, platform=at)

    many = make(lengths, high)
    assert many.batch_shape == (3,)
    batch = mr.solve(many, many.inputs(tip_force=(0.1, 0, 0))).raise_if_failed()
    for k in range(3):
        one = make(lengths[k], high[k])
        alone = mr.solve(one, one.inputs(tip_force=(0.1, 0, 0))).raise_if_failed()
        assert np.array_equal(batch.tip_position[k], alone.tip_position)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"legs": [ROD]}, r"ParallelRods.legs = 1 legs is not allowed: must be 2 to 12"),
        ({"legs": [ROD] * 13}, "must be 2 to 12"),
        ({"base": np.eye(4)}, r"ParallelRods.base = array of shape \(4, 4\)"),
        ({"platform": ring(3, 0.03)}, r"must have shape \(..., 2, 4, 4\)"),
        ({"base": 2 * ring(2, 0.03)}, "must be a rotation"),
        ({"joints": "welded"}, "must be one of 'clamped', 'revolute', 'spherical'"),
        ({"joints": "universal"}, "must be one of 'clamped', .*: mr.Network has the others"),
        ({"joints": ["clamped"] * 3}, "one for each of 2 legs"),
        ({"joint_axes": (0, 0, 1)}, r"ParallelRods.joint_axes = \(0, 0, 1\) .* only a 'revolute' joint has an axis"),
        ({"joint_axes": np.eye(3)[:2], "joints": ["spherical", "clamped"]}, "(?s)ParallelRods.joint_axes = .* there is none"),
        ({"joint_axes": (0, 0, 0), "joints": "revolute"}, "ParallelRods.joint_axes = .* must have lengths from 1e-100"),
        ({"platform_mass": -1.0}, "ParallelRods.platform_mass = -1.0"),
        ({"platform_centre": (0, 0)}, "ParallelRods.platform_centre"),
    ],
)
def test_refused(change, message):
    good = {"legs": [ROD, SOFT], "base": ring(2, 0.06), "platform": ring(2, 0.03)}
    mr.ParallelRods(**good)
    with pytest.raises(ValueError, match=message):
        mr.ParallelRods(**good | change)


def test_refused_inputs():
    with pytest.raises(TypeError, match=r"ParallelRods.legs must be a list of Rod or ConcentricTubes"):
        mr.ParallelRods(legs=ROD, base=ring(2, 0.06), platform=ring(2, 0.03))
    with pytest.raises(TypeError, match=r"ParallelRods.legs\[1\] = .* must be a Rod or ConcentricTubes, not SingleRod"):
        mr.ParallelRods(legs=[ROD, mr.SingleRod(ROD)], base=ring(2, 0.06), platform=ring(2, 0.03))
    parallel = robot([ROD, tubes()])
    with pytest.raises(ValueError, match=r"legs\[0\]: translation = -0.3 .*no rod is left in use"):
        parallel.inputs(translation=(-0.3, 0, 0))
    with pytest.raises(ValueError, match=r"legs\[1\]: translation\[0\] = 0.1 .*must be <= 0"):
        parallel.inputs(translation=(0, 0.1, 0.1))
    with pytest.raises(TypeError, match=r"tip_curvature"):
        parallel.inputs(tip_curvature=(0, 0, 0))
    with pytest.raises(ValueError, match="gravity .* no rod has a linear_density, and the platform no mass"):
        robot([INNER, OUTER]).inputs(gravity=(0, 0, -9.81))
    with pytest.raises(ValueError, match="the inverse problem needs 6 legs"):
        parallel.inverse()


def test_legs_stand_anywhere():
    """The whole robot moved and turned, with its loads, is the same robot."""
    values = {"tip_force": np.array((0.3, -0.2, -0.4)), "tip_moment": np.array((0.01, 0.02, -0.01))}
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = Rotation.from_rotvec([1.0, -2.0, 0.5]).as_matrix(), (3.0, -1.0, 2.0)
    here = robot([ROD, SOFT, ROD])
    there = mr.ParallelRods(legs=[ROD, SOFT, ROD], base=move @ ring(3, 0.06, tilt=0.1), platform=ring(3, 0.03, 0.15, 0.05))
    a = mr.solve(here, here.inputs(**values), solver=EXACT).raise_if_failed()
    turned = {name: move[:3, :3] @ value for name, value in values.items()}
    b = mr.solve(there, there.inputs(**turned), solver=EXACT).raise_if_failed()
    np.testing.assert_allclose(b.tip_position, move[:3, :3] @ a.tip_position + move[:3, 3], atol=1e-9)
    np.testing.assert_allclose(b.tip_rotation, move[:3, :3] @ a.tip_rotation, atol=1e-9)


def test_a_leg_that_fails_fails_its_robot_alone():
    parallel = robot([ROD, tubes()])
    problem = parallel.problem(parallel.inputs(tip_force=np.zeros((2, 3))), integrator=FEW)
    x = problem.guess()
    x[1, 0] = 1e200
    residual, gamma = problem.evaluate(x)
    assert np.isfinite(residual[0]).all()
    assert np.isfinite(gamma[0]).all()
    assert np.isnan(residual[1]).all()
    assert np.isnan(gamma[1]).all()
    assert problem.fault.numpy().tolist()[0] == 0


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_impossible_instances_leave_the_others_alone():
    parallel = robot([ROD, SOFT, ROD])
    force = np.array([(0.1, 0, 0), (1e7, 0, 0), (0, 0.1, 0)])
    solution = mr.solve(parallel, parallel.inputs(tip_force=force))
    assert solution.status[0] == solution.status[2] == mr.Status.CONVERGED
    assert mr.Status(solution.status[1]).failed
    assert np.isnan(solution.tip_position[1]).all()
    assert np.isnan(solution.jacobian("tip_force")[1]).all()
    alone = mr.solve(parallel, parallel.inputs(tip_force=force[2]))
    assert np.array_equal(solution.tip_position[2], alone.tip_position)


@pytest.mark.parametrize("coupling", ["full", "per-rod"])
def test_observer_follows_six_legs(coupling, reference_cases, make_pose):
    """From the unloaded guess within 0.5 s at 200 Hz; feed-forward takes the lag away; one integration of each leg a sample."""
    case = next(c for c in reference_cases("parallel_continuum_robot") if c["id"] == "10d_cpr_stewart_fk_1")
    parallel, start = stored_robot(case, make_pose)
    t = np.arange(0, 1.0, 0.005)
    phase = np.pi / 2 * t[:, None] + np.arange(6)
    force = start.tip_force + 0.5 * np.stack([np.sin(t), np.cos(t) - 1, 0 * t], axis=1)
    inputs = parallel.inputs(translation=0.01 * (np.sin(phase) - np.sin(phase[0])), tip_force=force)
    lag = {}
    for feed_forward in (False, True):
        solver = mr.Observer(scaling="newton", coupling=coupling, feed_forward=feed_forward, integrator=mr.RK4(30))
        history = mr.simulate(parallel, inputs, time=t, solver=solver)
        assert (history.status == mr.Status.TRACKING).all()
        assert (history.integrations == 1).all()
        error = np.abs(history.boundary_residual).max(axis=1)
        assert error[0] > 1
        lag[feed_forward] = error[100:].mean()
    assert lag[False] < 0.03
    assert lag[True] < lag[False] / 50


def test_the_default_observer_comes_to_rest_at_the_equilibrium_of_six_legs(reference_cases, make_pose):
    """Their singular values are decades apart: by gains of the problem's own variables they were far off, and said to track."""
    case = next(c for c in reference_cases("parallel_continuum_robot") if c["id"] == "10d_cpr_stewart_fk_1")
    parallel, start = stored_robot(case, make_pose)
    inputs = parallel.inputs(translation=0.01 * np.sin(np.arange(6)), tip_force=start.tip_force)
    found = mr.solve(parallel, inputs, solver=mr.Observer(integrator=mr.RK4(30), max_iterations=400)).raise_if_failed()
    there = mr.solve(parallel, inputs, solver=mr.Shooting(integrator=mr.RK4(30)))
    np.testing.assert_allclose(found.tip_position, there.tip_position, rtol=0, atol=1e-8)  # 1e-8 of the length each


def test_plain_gains_of_six_legs_are_announced(reference_cases, make_pose):
    case = next(c for c in reference_cases("parallel_continuum_robot") if c["id"] == "10d_cpr_stewart_fk_1")
    parallel, inputs = stored_robot(case, make_pose)
    solver = mr.Observer(coupling="per-rod-plain", integrator=mr.RK4(30))
    history = mr.simulate(parallel, inputs, time=0.005 * np.arange(5), solver=solver)
    assert (history.status == mr.Status.UNSTABLE_COUPLING).all()


# ---- what a question costs, and changes ----


def count_integrations(monkeypatch) -> list[int]:
    """Of robots, by solvers and by questions; and passes along the rods, for shapes and modes, which are integrations too."""
    counts = [0, 0]

    def counted(kind, method, place):
        def call(self, *arguments, **options):
            counts[place] += isinstance(self, ParallelProblem) or place
            return method(self, *arguments, **options)

        monkeypatch.setattr(kind, method.__name__, call)

    counted(mr.BoundaryProblem, mr.BoundaryProblem.integrate, 0)
    counted(NodePasses, NodePasses.over, 1)
    return counts


QUESTIONS = {
    "rod": (lambda solution: solution.rod(0).position, 0, 1),
    "energy": (lambda solution: solution.energy, 0, 1),
    "potential": (lambda solution: solution.potential, 0, 1),
    "stability": (lambda solution: solution.stability, 0, 1),
    "jacobian": (lambda solution: solution.jacobian("tip_force"), 1, 0),
}


@pytest.mark.parametrize("failed", [False, True])
@pytest.mark.parametrize("question", QUESTIONS)
@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_a_question_to_a_solution_costs_one_integration(monkeypatch, question, failed):
    """Legs of one build are integrated together: one pass answers for all of them."""
    parallel = SCENES["two rods"]()
    force = [(0, 0, 0.01), (0, 0, 1e9)] if failed else [(0, 0, 0.01), (0, 0, 0.02)]
    solution = mr.solve(parallel, parallel.inputs(tip_force=force), solver=mr.Shooting(integrator=FEW))
    assert [mr.Status(int(status)).failed for status in solution.status] == [False, failed]
    ask, integrations, passes = QUESTIONS[question]
    counts = count_integrations(monkeypatch)
    answer = np.asarray(ask(solution))
    assert counts == [integrations, passes]
    if question not in ("stability", "potential"):
        assert np.isfinite(answer[0]).all()
        assert np.isnan(answer[1]).all() == failed


@pytest.mark.parametrize("first", [1e5, 1e6, 1e10, 1e20])
def test_equal_steps_that_overflow_end_soon(first):
    """A leg took 65,536 before it failed, as they become shorter: a search that tries what is far off took minutes."""
    parallel = SCENES["two rods"]()
    problem = parallel.problem(parallel.inputs(**LOADS), integrator=FEW, pose_sensitivities=True, direction_count=1)
    x = problem.guess()
    x[:, 0] = first
    problem.evaluate(x)
    assert problem.fault.numpy()[0] == Fault.NONFINITE
    assert problem.step_count.numpy()[0] <= 3 * FEW.steps * len(parallel.legs)  # twice those of a leg, and of its few stretches


@pytest.mark.parametrize("scene", SCENES)
def test_what_is_natural_does_not_depend_on_what_was_asked_before(scene, monkeypatch):
    parallel = SCENES[scene]()
    inputs = parallel.inputs(**LOADS, translation=-0.01)

    def fresh():
        return parallel.problem(inputs, integrator=FEW, pose_sensitivities=True, direction_count=1)

    problem, other = fresh(), fresh()
    guess = other.guess()
    natural = problem.natural_singular_value
    assert natural.max() < 0.5  # it says something of this robot
    assert np.array_equal(natural, other.natural_singular_value)
    assert np.array_equal(natural, [min(1, np.linalg.svd(_unloaded_gamma(fresh(), guess), compute_uv=False)[-1])])
    assert np.array_equal(problem.guess(), guess)
    # found once, and anew where the robot has moved
    counts = count_integrations(monkeypatch)
    problem.guess()
    _ = problem.natural_singular_value
    assert counts == [0, 0]
    moved = parallel.inputs(**LOADS, translation=0.0)
    problem.write("inputs", problem.pack(moved))
    expected = parallel.problem(moved, integrator=FEW).natural_singular_value
    np.testing.assert_allclose(problem.natural_singular_value, expected, rtol=1e-12, atol=0)  # of another kernel
    assert counts[0] == 2 * problem.guess_integrations


def _unloaded_gamma(problem, unknowns):
    problem.load_factor.zero_()
    return problem.evaluate(unknowns)[1][0]


def test_asking_what_is_natural_changes_nothing():
    parallel = SCENES["two rods"]()
    inputs = parallel.inputs(**LOADS)
    problem = parallel.problem(inputs, integrator=FEW, pose_sensitivities=True, direction_count=1)
    x = np.random.default_rng(3).standard_normal((1, problem.unknown_count))
    problem.directions.assign(np.ones(problem.directions.shape))
    problem.load_factor.fill_(0.5)
    problem.active.zero_()
    problem.evaluate(x)
    problem.active.fill_(1)
    problem.evaluate(x)
    problem.active.zero_()
    names = ("active", "load_factor", "fault", "step_count", "residual_directions", "pose_columns", "records")
    before = {name: np.array(getattr(problem, name).numpy()) for name in names}
    _ = problem.natural_singular_value
    for name, values in before.items():
        np.testing.assert_array_equal(getattr(problem, name).numpy(), values, err_msg=name)
    problem.active.fill_(1)
    again = problem.evaluate(x)
    assert np.array_equal(again[0].ravel(), before["records"][0, problem.record_fields["residual"]])


def test_a_stalled_step_of_a_robot_tracked_from_a_guess_is_not_the_end_of_its_branch():
    parallel = SCENES["two rods"]()
    solver = mr.Shooting(integrator=FEW)
    inputs = parallel.inputs(tip_force=(0, 0, 0.01))
    solution = mr.solve(parallel, inputs, solver=solver).raise_if_failed()
    problem = parallel.problem(inputs, integrator=solver.integrator)  # nobody has called guess()
    paths = Paths(problem, solver.newton(problem), 100)
    paths.state.reference.assign(np.ascontiguousarray(solution.gamma[None]))
    least = float(solution.smallest_singular_value)
    assert SINGULAR * float(problem.natural_singular_value[0]) < least < SINGULAR  # an ordinary state of this robot
    status, integrations = np.array([mr.Status.BRANCH_END]), np.zeros(1, dtype=int)
    paths._doubt_ends(status, integrations)
    assert status[0] == mr.Status.STALLED


def test_where_the_pose_is_given_the_drives_do_work_too():
    """The potential changes by the force on the platform as it does by the translations that follow, and not by ``-p`` alone: the
    kit does not ask for that. All else of the contract holds."""
    poses = np.tile(np.eye(4), (2, 6, 1, 1))
    for own, radius, degrees in zip(
        poses, (0.08, 0.06), ((-10, 10, 110, 130, 230, 250), (-50, 50, 70, 170, 190, 290)), strict=True
    ):
        own[:, :2, 3] = radius * np.stack([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))], axis=1)
    leg = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, axial_stiffness=2e3)
    robot = mr.ParallelRods(legs=[leg] * 6, base=poses[0], platform=poses[1])
    inverse, force, step = robot.inverse(), np.array([0.3, 0.2, -0.1]), 1e-3
    given = {"platform_position": np.array([0.02, 0.01, 0.29]), "platform_rotation": (0.1, 0.05, 0.02)}
    check_assembly(inverse, inverse.inputs(**given, tip_force=force), tip_rod=None, solvers=("shooting",))
    sides = np.concatenate([np.eye(3), -np.eye(3)])
    found = mr.solve(inverse, inverse.inputs(**given, tip_force=force + step * sides), solver=EXACT)
    slope, follows = ((values[:3] - values[3:]) / (2 * step) for values in (found.potential, inverse.translations(found)))
    there = inverse.translations(mr.solve(inverse, inverse.inputs(**given, tip_force=force), solver=EXACT))
    moved = robot.inputs(tip_force=force, translation=there + 1e-5 * np.concatenate([np.eye(6), -np.eye(6)]))
    driven = mr.solve(robot, moved, solver=EXACT).potential
    by_drives = follows @ (driven[:6] - driven[6:]) / 2e-5
    # differences of the second order leave some 1e-6 of what they are of
    np.testing.assert_allclose(slope, by_drives - given["platform_position"], rtol=0, atol=1e-5 * np.abs(by_drives).max())
    assert np.abs(by_drives).max() > 1e-5
