"""Inputs for a target: reached, held at limits, out of reach; never unstable."""

from dataclasses import replace

import numpy as np
import pytest
from constrained_step import step
from observer_scenes import three_tubes

import multirod as mr
from multirod.models.backbone.passes import shortcuts
from multirod.problem import BoundaryProblem
from multirod.reuse import KEPT
from multirod.rotations import matrices, vectors
from multirod.tasks.formulation import Task, input_units
from multirod.tasks.limits import limit_rows, middle, nearest
from multirod.tasks.reaching.goals import Goals
from multirod.tasks.reaching.search import Search
from multirod.tasks.rows import ON_TARGET

SOLVER = mr.Shooting(integrator=mr.RK4(30))
TUBES, MOTION = three_tubes()
FREE = ("rotation", "translation")
LIMITS = mr.Limits(translation=(-0.19, 0), gap=2e-3)
RANDOM = np.random.default_rng(5)


@pytest.fixture(scope="module")
def start():
    """Three tubes under 0.1 N."""
    return mr.solve(TUBES, MOTION[10], solver=SOLVER).raise_if_failed()


def goals(start, count, turn=0.5, push=0.02):
    """Where tips are whose tubes are turned and pushed by so much."""
    random = np.random.default_rng(5)  # the same in whatever order tests run
    rotation = start.inputs.rotation + random.uniform(-turn, turn, (count, 3))
    translation = start.inputs.translation + random.uniform(-push, push, (count, 1)) + random.uniform(-2e-3, 2e-3, (count, 3))
    inputs = TUBES.inputs(rotation=rotation, translation=np.minimum(translation, 0), tip_force=start.inputs.tip_force)
    return mr.solve(TUBES, inputs, solver=SOLVER, guess=start).raise_if_failed()


def test_positions_are_reached_in_seven_integrations_within_limits_at_every_step(start, monkeypatch):
    tried = []
    ways = {name: getattr(Task, name) for name in ("integrate", "integrate_some_coarsely")}

    def looked_at(name):
        def integrate(self, *coarsely):
            if name != "integrate" or not tried or not np.array_equal(tried[-1], self.values()):  # of those beside coarse ones
                tried.append(self.values())
            ways[name](self, *coarsely)

        return integrate

    for name in ways:
        monkeypatch.setattr(Task, name, looked_at(name))
    there = goals(start, 12)
    found = mr.reach(TUBES, mr.Pose(position=there.tip_position), free=FREE, limits=LIMITS, guess=start, solver=SOLVER)
    assert (found.status == mr.Status.REACHED).all()
    assert found.integrations.max() <= 7  # of which half are coarse
    assert (found.stability == mr.Stability.STABLE).all()
    assert len(tried) == found.integrations.max()
    for p in tried:
        bases = p[:, 3:]
        assert bases.max() <= 0
        assert bases.min() >= -0.19
        assert np.diff(bases, axis=1).min() >= 2e-3
        assert (np.diff(bases, axis=1) <= 0.1 - 2e-3).all()  # each tube is 0.1 m shorter than the one inside
    # by a solve of its own, whose kernel rounds its steps otherwise: 1e-8 m of RK4(30)'s error
    again = mr.solve(TUBES, found.inputs, solver=SOLVER, guess=found)
    np.testing.assert_allclose(again.tip_position, there.tip_position, atol=1e-7)
    np.testing.assert_allclose(found.target_error, 0, atol=1e-7)
    assert np.isnan(found.target_angle).all()


def test_no_small_step_within_limits_leads_nearer_to_what_they_hold_back(start):
    """Of targets towards which full steps swing between limits; each small step is taken by a solve, in 400 directions."""
    place = np.array([(0.0163, -0.0665, 0.2635), (0.0068, -0.0622, 0.2903)])
    axis = np.array([(0.7118, 0.1342, 0.6894), (0.3247, -0.6494, 0.6876)])
    options = {"free": FREE, "limits": LIMITS, "solver": SOLVER}
    found = mr.reach(TUBES, mr.Pose(position=place, axis=axis), guess=start, **options)
    assert (found.status == mr.Status.AT_LIMIT).all()
    rows, unit, length = limit_rows(TUBES, LIMITS, FREE), input_units(TUBES, FREE), TUBES.longest
    random = np.random.default_rng(0)
    for k in range(len(place)):
        held = found[k]

        def left(solution, k=k):
            angle = np.arccos(np.clip(solution.tip_rotation[..., 2] @ (axis[k] / np.linalg.norm(axis[k])), -1, 1))
            return np.hypot(np.linalg.norm(solution.tip_position - place[k], axis=-1) / length, angle)

        p = np.concatenate([held.inputs.rotation, held.inputs.translation])
        step = random.normal(size=(400, len(p)))
        step *= 0.02 / np.linalg.norm(step, axis=1, keepdims=True)
        near = nearest(rows, p + unit * step, unit)
        inputs = TUBES.inputs(rotation=near[:, :3], translation=near[:, 3:], tip_force=start.inputs.tip_force)
        around = mr.solve(TUBES, inputs, solver=SOLVER, guess=held)
        # a step of second order in a valley; without the steps that fall, some of these take off a twentieth and more
        assert left(around).min() >= 0.995 * left(held)


def test_coarse_integrations_lead_to_results_that_those_of_all_steps_say(start, monkeypatch):
    """Targets near, far, beyond reach and already there, alone and in a batch; then by integrations that lead astray."""
    tip, near = start.tip_position, goals(start, 4).tip_position
    targets = np.concatenate([near, goals(start, 3, turn=1.2, push=0.04).tip_position, [tip, tip + 0.5, 2 * tip]])
    called, coarsely = [], BoundaryProblem.integrate_coarsely

    def counted(problem):
        called.append(problem)
        coarsely(problem)

    monkeypatch.setattr(BoundaryProblem, "integrate_coarsely", counted)
    options = {"free": FREE, "limits": LIMITS, "guess": start, "solver": SOLVER}
    found = mr.reach(TUBES, mr.Pose(position=targets), **options)
    assert len(called) >= 2
    alone = [mr.reach(TUBES, mr.Pose(position=target), **options) for target in targets]
    for name in ("unknowns", "target_error", "integrations", "status"):
        np.testing.assert_array_equal([getattr(one, name) for one in alone], getattr(found, name))
    few = mr.reach(TUBES, mr.Pose(position=targets[3:9]), **options)  # all in one launch, coarse ones beside others
    np.testing.assert_array_equal(few.unknowns, found.unknowns[3:9])
    reached = found.status == mr.Status.REACHED
    assert reached[:4].all()
    assert not reached.all()
    for coarser in (None, 30):  # none are coarse; as coarse as one step of a stretch is, which is off by a tenth and more
        monkeypatch.setattr(shortcuts, "WORTH" if coarser is None else "COARSER", coarser or 1000)
        KEPT.forget()
        other = mr.reach(TUBES, mr.Pose(position=targets), **options)
        monkeypatch.undo()
        np.testing.assert_array_equal(other.status, found.status)
        assert other.residual[reached].max() <= 1e-9
        assert other.target_error[reached].max() <= 4e-7 * TUBES.longest  # as ``tolerance`` says
        # places that are reached are solutions of the same equations, whatever led there: by Newton's method to its tolerance
        np.testing.assert_allclose(other.tip_position[reached], found.tip_position[reached], atol=4e-7)
    KEPT.forget()


@pytest.mark.parametrize("pulled", [False, True])
def test_the_compiled_step_is_that_of_the_programme_in_numpy(start, pulled):
    """(7) of a drive's first evaluation: free, at limits, bounded, and pulled to the middle; at targets near and far."""
    random, count = np.random.default_rng(7), 40
    values = np.concatenate([getattr(start.inputs, name) for name in FREE])
    p = values + np.concatenate(
        [random.uniform(-0.4, 0.4, (count, 3)), np.repeat(random.uniform(-0.01, 0, (count, 1)), 3, 1)], axis=1
    )
    near = mr.Limits(translation=(values[3:] - 0.02, values[3:] + 5e-3), rotation=(values[:3] - 0.5, values[:3] + 4), gap=2e-3)
    rows, unit, length = limit_rows(TUBES, near, FREE), input_units(TUBES, FREE), TUBES.longest
    inputs = TUBES.inputs(rotation=p[:, :3], translation=p[:, 3:], tip_force=start.inputs.tip_force)
    task = Task.of(TUBES, inputs, FREE, integrator=mr.RK4(30))
    x = task.problem.adopt(np.tile(start.unknowns, (count, 1)))
    size = 10.0 ** random.uniform(-4, -1, (count, 1))
    pose = mr.Pose(position=start.tip_position + size * random.normal(size=(count, 3)))
    centre = middle(rows) if pulled else None
    target = pose.rows(length, (count,))
    found = task.evaluate(x, p)
    errors, by_x, by_p = target.at(found)
    r, J = found.condensed(errors, by_x, by_p)
    J, at = J * unit, p @ rows.matrix.T
    inset = 1e-10 * np.abs(rows.matrix) @ unit
    own = step(
        J,
        r,
        softness=1e-12 * (J**2).max(axis=(1, 2)),
        pull=(centre - p) / unit if pulled else 0.0,
        limits=rows.matrix * unit,
        low=np.minimum(rows.low + inset - at, 0),
        high=np.maximum(rows.high - inset - at, 0),
    )
    bend = np.abs(found.eliminated[1] * unit @ own.change[..., None])[..., 0].max(axis=1) / (5 * task.problem.curvature_scale())
    wanted = own.change / np.maximum(1, np.maximum(np.abs(own.change).max(axis=1), bend))[:, None]
    tolerance = task.problem.tolerance(None)
    search = Search(task, Goals(target, rows, None, unit, length, 1e-6, tolerance, centre, max_integrations=1), x, p)
    search.drive(np.ones(count, dtype=bool))
    assert (search.status == mr.Status.INTEGRATION_LIMIT).all()
    np.testing.assert_allclose(search.errors, errors, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(search.J, J, atol=1e-11 * np.abs(J).max())
    # softness 1e-12: conditioned by 1e6
    np.testing.assert_allclose((search.here.p - p) / unit, wanted, atol=1e-8)
    np.testing.assert_allclose(search.here.x - x, found.eliminated[0] + (search.by @ wanted[..., None])[..., 0], atol=1e-6)
    held = (own.held != 0).sum(axis=1)
    assert held.min() == 0 or pulled
    assert held.max() >= 3
    assert (np.abs(wanted).max(axis=1) < np.abs(own.change).max(axis=1)).any()


def test_a_batch_is_what_its_instances_are_alone(start):
    there = goals(start, 3)
    batch = mr.reach(TUBES, mr.Pose(position=there.tip_position), free=FREE, limits=LIMITS, guess=start, solver=SOLVER)
    for k in range(3):
        alone = mr.reach(TUBES, mr.Pose(position=there.tip_position[k]), free=FREE, limits=LIMITS, guess=start, solver=SOLVER)
        np.testing.assert_allclose(batch[k].inputs.rotation, alone.inputs.rotation, atol=1e-9)
        assert batch[k].target_error == batch.target_error[k]
        assert int(batch.integrations[k]) == int(alone.integrations)


def test_a_batch_of_no_targets_has_no_results(start):
    for limits in (LIMITS, mr.Limits(curvature=100.0)):
        found = mr.reach(TUBES, mr.Pose(position=np.zeros((0, 3))), free=FREE, limits=limits, guess=start, solver=SOLVER)
        assert found.target_error.shape == found.status.shape == (0,)
        assert found.inputs.rotation.shape == (0, 3)
        assert found.at_limit.shape == (0, 6)
        assert len(found.held_by) == 0


def test_some_results_of_a_batch_say_what_they_said_in_it(start, tmp_path):
    """What is found when it is asked for is found of these alone; files keep it."""
    away = start.tip_position + np.array([[(0, 0, 0.2), (0.002, 0, 0)], [(0.001, 0.001, 0), (0, 0, 0.3)]])
    limits = mr.Limits(translation=(-0.11, -0.012), rotation=(-0.7, 0.7), gap=2e-3)
    batch = mr.reach(TUBES, mr.Pose(position=away), free=FREE, limits=limits, guess=start, solver=SOLVER)
    assert (batch.status == mr.Status.AT_LIMIT).sum() == 2
    part, names = batch[1], batch[1].held_by  # before the whole was asked
    np.testing.assert_array_equal(part.target_error, batch.target_error[1])
    np.testing.assert_array_equal(part.at_limit, batch.at_limit[1])
    assert list(names) == list(batch.held_by[1])
    np.testing.assert_array_equal(part.inputs.translation, batch.inputs.translation[1])
    np.testing.assert_array_equal(part[1].at_limit, batch.at_limit[1, 1])
    assert part[1].at_limit.any()
    np.testing.assert_array_equal(part.target.position, away[1])
    np.testing.assert_array_equal(part[1].target.position, away[1, 1])
    assert part[1].inputs.rotation.shape == (3,)
    for k, found in enumerate((batch, part, part[1])):
        assert_kept(found, tmp_path / f"{k}.npz")


def assert_kept(found, path):
    """That a file keeps all that a reach says, to the bit."""
    found.save(path)
    again = mr.load(path)
    assert type(again) is type(found)
    assert again.free == found.free
    assert again.target.given == found.target.given
    for name in found.target.given:
        np.testing.assert_array_equal(getattr(again.target, name), getattr(found.target, name))
    for name in ("target_error", "target_angle", "at_limit", "tip_position", "status"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    np.testing.assert_array_equal(again.inputs.translation, found.inputs.translation)
    assert np.array_equal(again.held_by, found.held_by)
    assert repr(again) == repr(found)


def test_where_a_limit_holds_every_way_that_it_leaves_leads_away(start):
    """The signs of the multipliers: what the limits allow to first order does not come nearer."""
    target = start.tip_position + (0, 0, 0.2)  # farther out than the tubes may come
    limits = mr.Limits(translation=(-0.11, -0.012), rotation=(-0.7, 0.7), gap=2e-3)
    found = mr.reach(TUBES, mr.Pose(position=target), free=FREE, limits=limits, guess=start, solver=SOLVER)
    assert found.status is mr.Status.AT_LIMIT
    assert not found.failed
    assert found.at_limit[3:].any()
    said = ", ".join(found.held_by)
    assert {"rotation[0]", "translation[1] - translation[0]"} <= set(found.held_by)
    assert f"target_error {float(found.target_error):.3g} m, held_by {said}, residual" in repr(found)
    assert f"{said}</td>" in found._repr_html_()
    away = (found.tip_position - target) / np.linalg.norm(found.tip_position - target)
    assert float(found.target_error) == pytest.approx(np.linalg.norm(found.tip_position - target), rel=1e-9)
    slope = away @ found.jacobian(*FREE)[:3]
    bases = found.inputs.translation
    for _ in range(200):
        d = RANDOM.normal(size=6)
        low = bases + 1e-3 * d[3:]
        inside = low.min() >= -0.11 and low.max() <= -0.012 and np.diff(low).min() >= 2e-3 and np.diff(low).max() <= 0.098
        turned = np.abs(found.inputs.rotation + 1e-3 * d[:3]).max() <= 0.7
        if inside and turned:
            assert slope @ d >= -1e-6 * np.abs(slope).max() * np.abs(d).max()


def controlled(start, target, limits, samples=30):
    """How far off a controller ends that goes there in so many samples, and rests as many, by a solve of its own [m]."""
    loop = mr.Controller(TUBES, dt=1.0, free=FREE, limits=limits, guess=start, integrator=SOLVER.integrator)
    for k in range(2 * samples):
        command = loop.step(position=start.tip_position + min(1.0, (k + 1) / samples) * (target - start.tip_position))
    there = mr.solve(TUBES, command.inputs, guess=command, solver=SOLVER).raise_if_failed()
    return np.linalg.norm(there.tip_position - target)


@pytest.mark.parametrize(
    ("push", "turn", "way"),
    [
        (0.0130, 0.254, (-0.0146, -0.0329, -0.0262)),
        (0.0034, 0.520, (-0.0027, -0.0298, 0.0191)),
        (0.0154, 0.347, (0.0282, -0.0226, -0.0148)),
        (0.0074, 0.589, (0.0353, -0.0127, -0.0051)),
        (0.0148, 0.491, (0.0342, -0.0280, 0.0101)),
    ],
)
def test_within_tight_limits_it_ends_no_farther_off_than_a_controller(start, push, turn, way):
    """Full steps of Gauss and Newton swing from corner to corner here: a tenth to a third farther off. Each comes to a place that
    is nearer than all around it: there may be several, some of them a hundredth apart."""
    bases, angles = start.inputs.translation, start.inputs.rotation
    ranges = {"translation": (bases - push, np.minimum(bases + push, 0)), "rotation": (angles - turn, angles + turn)}
    limits, target = mr.Limits(**ranges, gap=2e-3), start.tip_position + way
    found = mr.reach(TUBES, mr.Pose(position=target), free=FREE, limits=limits, guess=start, solver=SOLVER)
    assert found.status is mr.Status.AT_LIMIT
    assert found.at_limit.any()
    assert float(found.target_error) < 1.02 * controlled(start, target, limits)
    assert float(found.residual) <= 1e-9


def test_a_straight_way_that_leaves_what_can_be_reached_is_not_the_only_one():
    """A force moves the tip of a straight rod that does not stretch on a sheet that is hardly thick."""
    straight = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814))
    solver = mr.Shooting(integrator=mr.RK4(60))
    forces = np.array([(1, 0, 0), (3, 0, 0), (5, 2, 1), (10, 0, 3), (-4, 6, -3)], dtype=float)
    there = mr.solve(straight, straight.inputs(tip_force=forces), solver=solver)
    begin = straight.inputs(tip_force=(0.1, 0.1, 0))
    found = mr.reach(straight, mr.Pose(position=there.tip_position), begin, free="tip_force", solver=solver)
    assert (found.status == mr.Status.REACHED).all()
    assert (found.target_error <= 4e-7 * straight.longest).all()
    assert (found.stability == mr.Stability.STABLE).all()
    again = mr.solve(straight, straight.inputs(tip_force=found.inputs.tip_force), solver=solver)
    np.testing.assert_allclose(again.tip_position, there.tip_position, atol=1e-8)
    beyond = mr.reach(straight, mr.Pose(position=(0.3, 0.1, 0.4)), begin, free="tip_force", solver=solver)
    assert beyond.status is mr.Status.UNREACHABLE
    assert float(beyond.target_error) < 1.01 * (np.linalg.norm((0.3, 0.1, 0.4)) - 0.4) + 0.01


def test_a_target_out_of_reach_and_a_singular_one_say_so(start, wire):
    far = mr.reach(TUBES, mr.Pose(position=(0, 0, 2.0)), free=("rotation",), guess=start, solver=SOLVER)
    assert far.status is mr.Status.UNREACHABLE
    assert np.isnan(far.tip_position).all()
    assert 1.5 < float(far.target_error) < 2.0
    assert not far.at_limit.any()
    straight = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06, precurvature=(3, 1, 0)))
    inputs = straight.inputs(tip_force=(0, 0, 1e-3))
    turned = mr.reach(straight, mr.Pose(position=(0.0, 0.0, 0.1)), inputs, free=("rotation",), solver=mr.Shooting())
    assert turned.status is mr.Status.SINGULAR_TASK or turned.status is mr.Status.UNREACHABLE
    along = mr.reach(
        mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06)),
        mr.Pose(position=(0.1, 0.0, 0.3)),
        free=("rotation",),
        solver=mr.Shooting(),
    )
    assert along.status is mr.Status.SINGULAR_TASK
    assert np.isnan(along.inputs.rotation).all()
    assert (np.abs(along.ended_at.rotation) < 2 * np.pi).all()


def test_a_tight_tolerance_is_met_where_steps_are_short_already(start):
    target = mr.Pose(position=start.tip_position + np.random.default_rng(0).uniform(-0.02, 0.02, (20, 3)))
    found = mr.reach(TUBES, target, free=FREE, guess=start, solver=SOLVER, tolerance=1e-9)
    assert (found.status == mr.Status.REACHED).all()
    assert found.integrations.max() <= 8
    assert found.target_error.max() <= 1e-9 * TUBES.longest**2


def test_no_search_ends_farther_off_than_it_began(start):
    random = np.random.default_rng(7)
    position = start.tip_position + random.uniform(-0.03, 0.03, (200, 3))
    rotation = matrices(random.uniform(-0.6, 0.6, (200, 3))) @ start.tip_rotation
    pose = mr.Pose(position=position, rotation=rotation)
    found = mr.reach(TUBES, pose, free=FREE, guess=start, solver=SOLVER)

    def off(distance, angle):
        return np.hypot(distance / TUBES.longest, angle)  # as rows count

    away = np.linalg.norm(start.tip_position - position, axis=1)
    turned = np.linalg.norm(vectors(start.tip_rotation @ np.swapaxes(rotation, 1, 2)), axis=1)
    # the search's kernel rounds its steps otherwise than that of the start
    assert (off(found.target_error, found.target_angle) <= off(away, turned) * (1 + 1e-5)).all()
    back = np.all([(getattr(found.ended_at, name) == getattr(start.inputs, name)).all(axis=1) for name in FREE], axis=0)
    assert not (back & (found.status == mr.Status.UNREACHABLE)).any()  # damped steps come nearer than full ones did
    limited = found.status == mr.Status.AT_LIMIT
    assert limited.any()
    assert not (back & ~found.failed).any()  # limits hold nothing back where it began
    assert (found.residual[limited] <= 1e-9).all()
    assert (found.stability[~found.failed] == mr.Stability.STABLE).all()
    assert np.isnan(found.tip_position[found.failed]).all()
    for name in FREE:  # what was not found is in no inputs, what was given stays
        np.testing.assert_array_equal(np.isnan(getattr(found.inputs, name)).all(axis=1), found.failed)
        np.testing.assert_array_equal(getattr(found.inputs, name)[~found.failed], getattr(found.ended_at, name)[~found.failed])
    assert np.isfinite(found.inputs.tip_force).all()
    assert np.isnan(found[found.failed].inputs.rotation).all()
    with pytest.raises(ValueError, match="(?s)rotation = .* a task that failed has found none"):
        mr.solve(TUBES, found.inputs, solver=SOLVER)
    again = mr.reach(TUBES, pose, free=FREE, guess=found, solver=SOLVER)
    np.testing.assert_array_equal(again.status[found.failed], found.status[found.failed])  # of a start that failed its status


def test_a_target_whose_equilibrium_is_past_a_fold_is_unstable():
    data = [(0.00387, 0.00301, 0.431, 0.103, 9.0), (0.01717, 0.01402, 0.332, 0.113, 6.0), (0.03977, 0.05022, 0.174, 0.134, 3.5)]
    tubes = [
        mr.Rod(length=L, bending_stiffness=EI, torsional_stiffness=GJ, precurvature=[(L - c, (0, 0, 0)), (c, (k, 0, 0))])
        for EI, GJ, L, c, k in data
    ]
    robot = mr.ConcentricTubes(tubes)
    inputs = robot.inputs(rotation=(0.4, 0.8, -0.3), translation=(-0.28, -0.22, -0.1), tip_force=(0, 0.2, 0.1))
    start = mr.solve(robot, inputs, solver=SOLVER).raise_if_failed()
    # the pose of an unstable equilibrium, by an integration that is not the package's
    pose = mr.Pose(position=(0.04369, 0.01024, 0.17179), axis=(0.21954, -0.06425, 0.97349))
    options = {"free": FREE, "limits": mr.Limits(translation=(-0.4, 0), gap=1e-3), "solver": SOLVER}
    found = mr.reach(robot, pose, guess=start, **options)
    assert found.status is mr.Status.UNSTABLE
    assert np.isnan(found.tip_position).all()
    assert found._aim.tolerance == ON_TARGET / robot.longest
    with pytest.raises(mr.SolveError, match=f"{1e3 * found.target_error:.3g} mm off the target"):
        found.raise_if_failed()
    # of a search that was told to come as near as that alone, it is at the target
    vars(found).update(_aim=replace(found._aim, tolerance=float(found.target_error) / robot.longest**2))
    with pytest.raises(mr.SolveError, match="UNSTABLE") as said:
        found.raise_if_failed()
    assert "off the target" not in str(said.value)
    # target_error is that of where the search ended: a place on the way, solved for loosely
    there = mr.solve(robot, found.ended_at, solver=SOLVER, guess=start)
    assert found.target_error > 1e-3
    assert np.linalg.norm(there.tip_position - pose.position) == pytest.approx(float(found.target_error), abs=1e-4)


def test_moved_together_base_and_target_need_the_same_inputs(start, make_pose):
    moved = make_pose((0.3, -0.8, 0.5), (0.2, -0.1, 0.4))
    there = goals(start, 4)
    pose = mr.Pose(position=there.tip_position, axis=there.tip_rotation[..., 2])
    R, p = moved[:3, :3], moved[:3, 3]
    other = mr.ConcentricTubes(TUBES.tubes, base=moved)
    moved_pose = mr.Pose(position=there.tip_position @ R.T + p, axis=there.tip_rotation[..., 2] @ R.T)
    inputs = other.inputs(**{name: getattr(start.inputs, name) for name in FREE}, tip_force=R @ start.inputs.tip_force)
    here = mr.reach(TUBES, pose, start.inputs, free=FREE, limits=LIMITS, solver=SOLVER)
    there = mr.reach(other, moved_pose, inputs, free=FREE, limits=LIMITS, solver=SOLVER)
    assert (here.status == mr.Status.REACHED).all()
    np.testing.assert_allclose(here.target_angle, 0, atol=1e-6)
    for name in FREE:
        # tolerances of 1e-6 1/m end the search at the same step; rounding is carried by a task nearly singular in 5 rows
        np.testing.assert_allclose(getattr(here.inputs, name), getattr(there.inputs, name), atol=1e-8)


def test_what_is_left_over_serves_what_is_preferred(start):
    target = mr.Pose(position=goals(start, 1).tip_position[0])
    limits = mr.Limits(translation=(-0.19, 0), rotation=(-np.pi, np.pi), gap=2e-3)
    found = {
        prefer: mr.reach(TUBES, target, free=FREE, limits=limits, prefer=prefer, guess=start, solver=SOLVER)
        for prefer in ("smallest motion", "middle", "stability")
    }
    for solution in found.values():
        assert solution.status is mr.Status.REACHED
        np.testing.assert_allclose(solution.tip_position, target.position, atol=1e-6)
    margins = {prefer: float(solution.stability_margin) for prefer, solution in found.items()}
    assert margins["stability"] > margins["smallest motion"]
    moved = {}
    for prefer, solution in found.items():
        turn, push = (getattr(solution.inputs, name) - getattr(start.inputs, name) for name in FREE)
        moved[prefer] = np.linalg.norm([*turn, *(push / 0.04)])  # a tenth of the longest tube counts as a radian
    assert moved["smallest motion"] == min(moved.values())
    centre, unit = middle(limit_rows(TUBES, limits, FREE)), input_units(TUBES, FREE)
    np.testing.assert_allclose(centre[:3], 0, atol=1e-12)
    values = {prefer: np.concatenate([getattr(s.inputs, name) for name in FREE]) for prefer, s in found.items()}
    off = {prefer: np.linalg.norm((value - centre) / unit) for prefer, value in values.items()}
    assert off["middle"] == min(off.values())


def test_limits_of_the_shape_are_kept(start):
    there = goals(start, 4)
    target = mr.Pose(position=there.tip_position)
    plain = mr.reach(TUBES, target, free=FREE, guess=start, solver=SOLVER)
    bent = max(np.abs(plain.rod(k).curvature[..., :2]).max() for k in range(3))
    margin = float(plain.stability_margin.min())
    least = margin + 0.02
    assert (plain.stability_margin < least).any()  # else there would be nothing to keep
    limits = mr.Limits(stability_margin=least, curvature=2 * bent)
    found = mr.reach(TUBES, target, free=FREE, limits=limits, guess=start, solver=SOLVER)
    assert (found.stability_margin[~found.failed] >= least).all()
    assert np.isin(found.status, (mr.Status.REACHED, mr.Status.AT_LIMIT)).all()


def test_limits_of_the_shape_are_kept_where_others_hold_too(start):
    """Where inputs hold the tip back, it would be nearer in a shape that may not be."""
    out = mr.Pose(position=start.tip_position + (0, 0, 0.2))
    inputs = {"translation": (-0.11, -0.012), "rotation": (-0.7, 0.7), "gap": 2e-3}
    plain = mr.reach(TUBES, out, free=FREE, limits=mr.Limits(**inputs), guess=start, solver=SOLVER)
    assert plain.status is mr.Status.AT_LIMIT
    margin = 0.5 * float(plain.stability_margin + start.stability_margin)
    assert plain.stability_margin < margin < start.stability_margin
    limits = mr.Limits(**inputs, stability_margin=margin)
    found = mr.reach(TUBES, out, free=FREE, limits=limits, guess=start, solver=SOLVER)
    assert found.status is mr.Status.AT_LIMIT
    assert found.stability_margin >= margin
    limits = mr.Limits(**inputs, stability_margin=1.1 * float(start.stability_margin))
    beyond = mr.reach(TUBES, out, free=FREE, limits=limits, guess=start, solver=SOLVER)
    assert beyond.status is mr.Status.OUT_OF_LIMITS
    assert np.isnan(beyond.tip_position).all()


def test_it_goes_along_limits_of_the_shape(start):
    """Straight ways lead beyond them here, others do not."""
    limits = mr.Limits(translation=(-0.19, 0), gap=2e-3, stability_margin=0.97 * float(start.stability_margin))
    ways = np.array([(-0.0193, 0.0125, 0.0165), (0.0143, -0.0187, 0.0092), (0.0046, -0.0047, 0.0199), (0.0092, -0.0094, 0.0398)])
    target = start.tip_position + ways
    plain = mr.reach(TUBES, mr.Pose(position=target), free=FREE, limits=LIMITS, guess=start, solver=SOLVER)
    assert (plain.status == mr.Status.REACHED).all()
    assert (plain.stability_margin < limits.stability_margin).all(), "no limit is in the way"
    found = mr.reach(TUBES, mr.Pose(position=target), free=FREE, limits=limits, guess=start, solver=SOLVER)
    assert (found.status == mr.Status.REACHED).all()
    assert (found.stability_margin >= limits.stability_margin).all()
    np.testing.assert_allclose(found.tip_position, target, atol=1e-6)


def test_pictures_lead_along_limits_of_the_shape_too_and_what_holds_is_named(start, tmp_path):
    """A straight way leads beyond the limit; at it, what is free has nothing left that comes nearer."""
    limits = mr.Limits(translation=(-0.19, 0), gap=2e-3, stability_margin=0.97 * float(start.stability_margin))
    direction = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
    ways = 2.5 * np.array([(-0.0193, 0.0125, 0.0165), (0.0143, -0.0187, 0.0092)])
    target = mr.Pose(position=start.tip_position + ways, across=direction)
    plain = mr.reach(TUBES, target, free=FREE, limits=LIMITS, guess=start, solver=SOLVER)
    assert (plain.status == mr.Status.REACHED).all()
    assert (plain.stability_margin < limits.stability_margin).all(), "no limit is in the way"
    found = mr.reach(TUBES, target, free=FREE, limits=limits, guess=start, solver=SOLVER)
    assert found.status.tolist() == [mr.Status.REACHED, mr.Status.AT_LIMIT]
    assert (found.stability_margin >= limits.stability_margin).all()
    off = found.tip_position - target.position
    off -= (off @ direction)[:, None] * direction
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), found.target_error, atol=1e-7)
    assert found.target_error[0] < 1e-6
    assert found.target_error[1] < 0.8 * np.linalg.norm(ways[1] - ways[1] @ direction * direction)  # it slid along the limit
    assert found.held_by[1] == ("stability_margin",)
    assert found.at_limit[1].any()
    assert found.held_by[0] == ()
    assert not found.at_limit[0].any()
    assert found[1].held_by == ("stability_margin",)
    assert "stability_margin" in repr(found[1])
    assert_kept(found, tmp_path / "batch.npz")
    assert_kept(found[1], tmp_path / "one.npz")


def test_six_legs_reach_poses_by_their_translations_alone(hexapod_start):
    robot, here = hexapod_start
    position = here.tip_position + RANDOM.uniform(-0.03, 0.03, (4, 3))
    rotation = matrices(RANDOM.uniform(-0.15, 0.15, (4, 3))) @ here.tip_rotation
    pose = mr.Pose(position=position, rotation=rotation)
    found = mr.reach(robot, pose, free=("translation",), guess=here, solver=SOLVER)
    assert (found.status == mr.Status.REACHED).all()
    assert (found.stability == mr.Stability.STABLE).all()
    assert found.integrations.max() <= 12
    again = mr.solve(robot, found.inputs, solver=SOLVER, guess=found)
    np.testing.assert_allclose(again.tip_position, position, atol=1e-7)
    np.testing.assert_allclose(again.tip_rotation, rotation, atol=1e-6)


def test_legs_are_never_unstable_whichever_way_they_are_found(hexapod_start):
    """By the inverse problem as by reach, which finds the same, but for what the inverse problem finds from other legs: these are
    near where they buckle, not all poses are had."""
    robot, here = hexapod_start
    random = np.random.default_rng(11)
    position = here.tip_position + random.uniform(-0.05, 0.05, (30, 3))
    rotation = matrices(random.uniform(-0.2, 0.2, (30, 3))) @ here.tip_rotation
    pose = mr.Pose(position=position, rotation=rotation)
    reached = mr.reach(robot, pose, here.inputs, free=("translation",), solver=SOLVER)
    inverse = robot.inverse()
    inputs = inverse.inputs(platform_position=position, platform_rotation=vectors(rotation), tip_force=here.inputs.tip_force)
    found = mr.solve(inverse, inputs, solver=SOLVER)
    for solution in (reached, found):
        assert (solution.stability[~solution.failed] == mr.Stability.STABLE).all()
    both = ~reached.failed
    assert not found.failed[both].any()
    assert 20 < both.sum() < 30
    # 1e-6 1/m of a target on legs of 0.4 m, over the least singular value of their poses by translations, some 0.01
    np.testing.assert_allclose(inverse.translations(found)[both], reached.inputs.translation[both], atol=1e-5)


@pytest.fixture(scope="module")
def hexapod_start():
    from observer_scenes import six_legs

    robot, inputs = six_legs()
    return robot, mr.solve(robot, inputs[0], solver=SOLVER).raise_if_failed()


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"target": (0, 0, 1)}, TypeError, "target = .* must be a Pose"),
        ({"target": mr.Pose(position=(0, 0, np.nan))}, ValueError, r"target\.position = .* must be finite"),
        ({"target": mr.Pose(position=np.zeros((2, 3))), "inputs": MOTION[:3]}, ValueError, "target = leading axes"),
        ({"free": ("rotation", "force_point")}, TypeError, "free takes no 'force_point'"),
        ({"free": ()}, ValueError, "free = .* must name one input or several"),
        ({"limits": mr.Limits(translation=(-0.01, 0))}, ValueError, "limits = -0.09.* must be from -0.01 to 0 at the start too"),
        ({"limits": mr.Limits(tip_force=(0, 1))}, ValueError, "Limits.tip_force .* must be of an input that is free"),
        ({"limits": mr.Limits(tip_fource=(0, 1))}, TypeError, "Limits takes no 'tip_fource'"),
        ({"limits": mr.Limits(rotation=((0, 1), 2))}, ValueError, "Limits.rotation .* a number or 3 of them"),
        ({"prefer": "fastest"}, ValueError, "prefer .* must be one of 'smallest motion'"),
        (
            {"prefer": "middle"},
            ValueError,
            r"prefer .* needs limits on both sides .*: rotation\[0\], rotation\[1\], rotation\[2\] have none",
        ),
        (
            {"prefer": "middle", "limits": mr.Limits(rotation=([-4, -np.inf, -4], 4))},
            ValueError,
            r"a middle: rotation\[1\] has none",
        ),
        ({"starts": -1}, ValueError, "starts = -1"),
        ({"tolerance": 0.0}, ValueError, "tolerance = 0.0 .* > 0"),
    ],
)
def test_what_is_refused(start, changes, error, message):
    options = {"target": mr.Pose(position=(0, 0, 0.2)), "inputs": MOTION[10], "free": FREE, "solver": SOLVER}
    with pytest.raises(error, match="(?s)" + message):
        mr.reach(TUBES, **{**options, **changes})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"gap": -1.0}, "Limits.gap = -1.0 .* >= 0"),
        ({"curvature": 0.0}, "Limits.curvature = 0.0 .* > 0"),
        ({"stability_margin": -0.1}, "Limits.stability_margin = -0.1 .* >= 0"),
        ({"rotation": 1.0}, "Limits.rotation = 1.0 .* a pair"),
        ({"rotation": (1, 0)}, "low <= high"),
        ({"rotation": (np.nan, 0)}, "each a number"),
        ({"tension": (-5, 5)}, r"Limits.tension = \(-5, 5\) .* low must be >= 0: tendons do not push; give \(0, 5.0\)"),
        ({"tension": ([0, -1], [3, 4])}, r"tendons do not push; give \(0, \[3.0, 4.0\]\)"),
    ],
)
def test_limits_that_are_refused(given, message):
    with pytest.raises(ValueError, match="(?s)" + message):
        mr.Limits(**given)
    assert mr.Limits(tension=(-np.inf, 5), pressure=(-1e4, 1e5), displacement=(-0.01, 0.01)).inputs["tension"][1] == 5


def pulled_wire(angles, **stretch):
    """Tendons of given length at these angles around a wire."""
    offsets = 0.008 * np.column_stack([np.cos(angles), np.sin(angles)])
    lines = [mr.Tendon(offset, driven="displacement", **stretch) for offset in offsets]
    wire = mr.Rod.wire(length=0.2, diameter=1.4e-3, young_modulus=60e9, shear_modulus=23e9, density=6450, lines=lines)
    return mr.SingleRod(wire)


@pytest.fixture(scope="module")
def segment():
    """Three tendons of given length, under a weight; and inputs at which all are taut."""
    robot = pulled_wire(np.radians([90, 210, 330]), axial_stiffness=2000.0)
    return robot, robot.inputs(displacement=2e-4, tip_force=(0, 0, -0.49), gravity=(0, 0, -9.81))


@pytest.mark.parametrize("most", [2e-3, 1e-3, 5e-4])
def test_what_limits_hold_is_an_equilibrium(segment, most):
    """Where lines turn slack on the way, steps along the limits ended before the rod was at rest."""
    robot, inputs = segment
    limits = mr.Limits(displacement=(-most, most))
    found = mr.reach(robot, mr.Pose(position=(0.04, 0, 0.18)), inputs, free="displacement", limits=limits)
    assert found.status == mr.Status.AT_LIMIT
    solved = mr.solve(robot, found.inputs).raise_if_failed()
    # the residual's tolerance, 1e-9 of the largest curvature, by what the tip makes of it
    np.testing.assert_allclose(found.tip_position, solved.tip_position, rtol=0, atol=1e-8)
    assert found.target_error == pytest.approx(np.linalg.norm(solved.tip_position - (0.04, 0, 0.18)), abs=1e-8)


def test_a_target_comes_before_the_middle(segment):
    """In the middle of the limits all tendons are slack, and nothing moves."""
    robot, inputs = segment
    options = {"free": "displacement", "limits": mr.Limits(displacement=(-0.012, 0.012))}
    target = mr.Pose(axis=(0.3, 0.1, 1))
    assert mr.reach(robot, target, inputs, prefer="smallest motion", **options).status == mr.Status.REACHED
    assert mr.reach(robot, target, inputs, prefer="middle", **options).status == mr.Status.REACHED


def from_slack_lines(robot, angles):
    """Targets that pulled tendons at these angles hold the tip at, sought from where no line is pulled."""
    loads = {"tip_force": (0, 0, -0.2), "gravity": (0, 0, -9.81)}
    pulled = np.array([0.004 * np.cos(angles - turn) - 1e-5 for turn in (0.3, 1.4, 3.0, 5.0)])
    there = mr.solve(robot, robot.inputs(displacement=pulled, **loads)).raise_if_failed()
    for target in (mr.Pose(axis=there.tip_rotation[:, :, 2]), mr.Pose(position=there.tip_position)):
        limits = mr.Limits(displacement=(-0.01, 0.01))
        found = mr.reach(robot, target, robot.inputs(**loads), free="displacement", limits=limits)
        assert (found.status == mr.Status.REACHED).all()
        assert (np.abs(found.inputs.displacement) < 0.01).all()  # no line is let out as far as its limit
        # the target comes before the middle, at which lines that do not stretch would all have to be shorter than they are
        limits = mr.Limits(displacement=(-0.005, 0.01))
        middle = mr.reach(robot, target, robot.inputs(**loads), free="displacement", limits=limits, prefer="middle")
        assert (middle.status == mr.Status.REACHED).all()
        # from nothing, at the same lengths: the tip notices nothing of what does not pull
        solved = mr.solve(robot, found.inputs).raise_if_failed()
        np.testing.assert_allclose(solved.tip_position, found.tip_position, rtol=0, atol=1e-7)
        # as far as lines of given length determine how they share: in all of them together any pull would do
        np.testing.assert_allclose(solved.tension, found.tension, rtol=0, atol=1e-3 * solved.tension.max())


@pytest.mark.parametrize("stretch", [{"axial_stiffness": 2000.0}, {}], ids=["elastic", "inextensible"])
def test_from_slack_lines_targets_are_reached_by_their_tensions(stretch):
    """(19) Nothing that is let out, or pulled while it is slack, moves the tip: all were ``SINGULAR_TASK``, or let out as far as
    limits allowed, and held there."""
    angles = np.radians([90, 210, 330])
    from_slack_lines(pulled_wire(angles, **stretch), angles)


def test_a_target_of_slack_lines_that_is_beyond_a_limit_of_the_shape_is_not_gone_to():
    """It was left beyond that limit, ``OUT_OF_LIMITS``, though the start is within.

    Which way a straight wire under slack lines is bent first is told by rounding: some ways come to an end, ``SINGULAR_TASK``.
    """
    limits = mr.Limits(displacement=(-0.02, 0.02), curvature=1.0)
    for stiffer in (0.0, 1e-12, 1e-9, -1e-9, 1e-7):
        robot = pulled_wire(np.radians([90, 210, 330]), axial_stiffness=2000.0 * (1 + stiffer))
        inputs = robot.inputs(tip_force=(0, 0, -0.2), gravity=(0, 0, -9.81))
        found = mr.reach(robot, mr.Pose(axis=(0.3, 0.1, 1)), inputs, free="displacement", limits=limits)
        assert found.status not in (mr.Status.REACHED, mr.Status.OUT_OF_LIMITS)
        there = mr.solve(robot, found.ended_at).raise_if_failed()
        assert np.linalg.norm(there.rod(0).curvature[:, :2], axis=1).max() <= 1.0


@pytest.mark.parametrize("stretch", [{"axial_stiffness": 2000.0}, {}], ids=["elastic", "inextensible"])
def test_from_four_slack_lines_targets_are_reached(stretch):
    angles = np.radians([0, 90, 180, 270])
    from_slack_lines(pulled_wire(angles, **stretch), angles)


@pytest.mark.parametrize(("curvature", "more_than"), [(18.0, 16), (22.0, 32)])
def test_what_is_surely_stable_is_stable_and_most_of_what_is_stable_is_told_so(curvature, more_than):
    """One launch of few instances against their modes: strongly curved tubes, stable and unstable, one problem after another."""
    strong = mr.ConcentricTubes(
        [
            mr.Rod(
                length=0.4 - 0.1 * k,
                bending_stiffness=0.01 * (1 + k),
                torsional_stiffness=0.0077 * (1 + k),
                precurvature=(curvature - 4 * k, 0, 0),
            )
            for k in range(3)
        ]
    )
    random, seen, segments = np.random.default_rng(3), [], []
    for angles in random.uniform(-1, 1, (12, 2)) * np.repeat([0.4, 3.0], 6)[:, None]:
        inputs = strong.inputs(rotation=(0, *angles), translation=(-0.06, -0.04, -0.02), tip_force=(0, 0.05, 0.02))
        found = mr.solve(strong, inputs, solver=SOLVER, guess=np.zeros(5))
        if found.failed:
            continue
        problem = Task.of(strong, inputs, FREE, integrator=mr.RK4(30)).problem
        problem.write("unknowns", problem.adopt(found.unknowns[None]))
        problem.expect_judging()
        problem.integrate()
        modes = problem.stability.modes()
        seen.append((problem.stability.surely_stable(), int(modes.stability[0]), float(modes.eigenvalue(0)[0])))
        segments.append(problem.tool("surely stable", lambda: None).needed)
        # again, over what the last look left, and after one that no look has nodes enough for
        for called_for in (0.0, 200.0):
            problem.tool("surely stable", lambda: None)._late.append(called_for)
            assert problem.stability.surely_stable() == seen[-1][0]
    assert all(stability == mr.Stability.STABLE for sure, stability, _ in seen if sure)
    assert all(sure for sure, _, margin in seen if margin > 0.1)
    assert {sure for sure, _, _ in seen} == {True, False}
    assert min(segments) > more_than


def test_what_one_step_between_two_nodes_says_is_stable_is_far_from_losing_that():
    """The same tubes, ever more curved, until they lose stability, and at margins that only the integrator's own steps tell."""

    def looked_at(curvature):
        strong = mr.ConcentricTubes(
            [
                mr.Rod(
                    length=0.4 - 0.1 * k,
                    bending_stiffness=0.01 * (1 + k),
                    torsional_stiffness=0.0077 * (1 + k),
                    precurvature=(curvature * (1 - 0.2 * k), 0, 0),
                )
                for k in range(3)
            ]
        )
        inputs = strong.inputs(rotation=(0, np.pi, 0), translation=(-0.06, -0.04, -0.02), tip_force=(0, 0.05, 0.02))
        found = mr.solve(strong, inputs, solver=SOLVER, guess=np.zeros(5))
        problem = Task.of(strong, inputs, FREE, integrator=mr.RK4(30)).problem
        problem.write("unknowns", problem.adopt(found.unknowns[None]))
        problem.expect_judging()
        problem.integrate()
        margin, sure = float(problem.stability.modes().eigenvalue(0)[0]), problem.stability.surely_stable()
        own = problem.tool("surely stable", lambda: None)
        nodes = own.nodes[next(reversed(own.nodes))]
        looks = [own._looked(nodes, one_step=one_step) for one_step in (True, False)]
        forms = [look.form.values("matrix")[0] / look.form.values("unit") for look in looks]
        values = [np.linalg.eigvalsh((form + form.T) / 2) for form in forms]
        return margin, sure, [bool(look.sure[0]) for look in looks], np.abs(values[0] - values[1]).max()

    seen = [looked_at(curvature) for curvature in np.linspace(4, 8, 9)]
    low, high = 4.0, 8.0  # between which the margin vanishes
    for _ in range(20):
        between = 0.5 * (low + high)
        seen.append(looked_at(between))
        low, high = (between, high) if seen[-1][0] > 0 else (low, between)
    for margin, sure, (quick, slow), off in seen:
        assert sure == slow == (margin > 1e-6) or abs(margin) < 2e-6  # which neither tells from neutral
        assert quick == (margin > 1e-2) or abs(margin - 1e-2) < 5e-3
        assert off < 1e-3 or margin < -1
    assert sum(slow and not quick for _, _, (quick, slow), _ in seen) > 3


def test_the_smallest_tensions_that_turn_a_tip_leave_a_tendon_slack():
    """Of three tendons round a rod, what all pull alike does next to nothing: of the least, one does not pull."""
    places = [(0.008 * np.cos(angle), 0.008 * np.sin(angle)) for angle in (0.0, 2.1, 4.2)]
    rod = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, lines=[mr.Tendon(place) for place in places])
    arm = mr.SingleRod(rod)
    start = mr.solve(arm, arm.inputs(tension=(4.0, 3.0, 2.0)), solver=SOLVER)
    there = mr.solve(arm, arm.inputs(tension=(3.0, 3.5, 2.0)), solver=SOLVER)
    target = mr.Pose(axis=there.tip_rotation[:, 2])
    found = {
        prefer: mr.reach(arm, target, free=("tension",), prefer=prefer, guess=start, solver=SOLVER)
        for prefer in ("smallest motion", "smallest tension")
    }
    assert all(one.status == mr.Status.REACHED for one in found.values())
    near, least = (one.inputs.tension for one in found.values())
    assert (least**2).sum() < 0.5 * (near**2).sum()
    assert 0 <= least.min() < 1e-3
    assert found["smallest tension"].target_angle < 1e-6
    with pytest.raises(ValueError, match="needs tension to be free"):
        mr.reach(TUBES, mr.Pose(position=(0, 0, 0.1)), MOTION[0], free=FREE, prefer="smallest tension")


def test_an_axis_half_a_turn_away_is_as_far_as_it_is():
    lines = [mr.Tendon(offset=(0.008 * np.cos(angle), 0.008 * np.sin(angle))) for angle in (0, 2.1, 4.2)]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines))
    start = mr.solve(robot, robot.inputs(tension=(1.5, 0.7, 0.5)))
    target = mr.Pose(axis=-start.tip_rotation[:, 2])
    found = mr.reach(robot, target, start.inputs, free="tension")
    assert found.status == mr.Status.REACHED
    assert abs(np.arccos(np.clip(found.tip_rotation[:, 2] @ target.axis, -1, 1))) < 1e-5
    held = mr.reach(robot, target, start.inputs, free="tension", limits=mr.Limits(tension=(0, 4)))
    assert held.status != mr.Status.REACHED
    assert 1.0 < held.target_angle <= np.pi  # it was 0, with another status


def test_rows_of_an_axis_have_their_derivatives_up_to_half_a_turn():
    axis = np.array([0.6, 0.0, 0.8])
    frame = matrices(np.array([[0.3, 2.0, 1.0]]))[0]
    pose = mr.Pose(axis=axis).rows(1.0)
    zero = np.zeros((1, 3))
    for angle in (0.5, 2.0, 2.2, 3.0, np.pi - 0.011):
        # a tip that is turned from the axis by the angle, about something across it
        across = np.cross(axis, (0.2, 0.5, -0.4))
        tip = matrices((angle * across / np.linalg.norm(across))[None])[0] @ matrices(np.array([[0, np.arctan2(0.6, 0.8), 0]]))[0]
        tip = tip @ matrices(np.array([[0, 0, 0.7]]))[0]
        errors, maps = pose.errors(zero, tip[None])
        np.testing.assert_allclose(np.linalg.norm(errors), angle, rtol=1e-9)
        h = 1e-6
        for j in range(3):
            ahead, behind = (pose.errors(zero, (matrices(s * h * np.eye(3)[[j]])[0] @ tip)[None])[0] for s in (1, -1))
            # of differences: h^2 by the third derivative, of the order of 1/sin^3, and rounding over h
            np.testing.assert_allclose(
                maps[0, :, 3 + j], (ahead - behind)[0] / (2 * h), atol=1e-8 + h**2 / np.sin(angle) ** 3 * 10
            )
    half = mr.Pose(axis=frame[:, 2]).rows(1.0)
    errors, maps = half.errors(zero, (frame @ np.diag([1.0, -1, -1]))[None])
    np.testing.assert_allclose(np.linalg.norm(errors), np.pi, rtol=1e-12)
    # a turn about the direction that was taken leads back as far as it goes
    direction = errors[0] / np.pi
    np.testing.assert_allclose(np.linalg.norm(direction @ maps[0, :, 3:]), 1.0, rtol=1e-9)


def test_a_margin_that_is_not_known_is_not_within_its_limit():
    """A force that follows the tip has no potential."""
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0)))
    start = mr.solve(robot, robot.inputs(follower_force=(0.3, 0, 0.1)))
    assert start.stability is mr.Stability.UNKNOWN
    for margin, status in ((100.0, mr.Status.OUT_OF_LIMITS), (1e-3, mr.Status.OUT_OF_LIMITS), (None, mr.Status.REACHED)):
        found = mr.reach(
            robot,
            mr.Pose(position=start.tip_position),
            start.inputs,
            free=FREE,
            limits=mr.Limits(stability_margin=margin),
        )
        assert found.status is status


def test_a_line_is_reached_where_it_is_near(start):
    """A target anywhere on a line: nothing is asked for along it."""
    direction = np.array([1.0, 0.3, -0.2])
    there = goals(start, 8).tip_position
    target = mr.Pose(position=there + 3 * direction, across=direction)
    assert target.count == 2
    found = mr.reach(TUBES, target, free=FREE, limits=LIMITS, guess=start, solver=SOLVER)
    assert (found.status == mr.Status.REACHED).all()
    off = found.tip_position - there
    assert np.linalg.norm(np.cross(off, direction / np.linalg.norm(direction)), axis=1).max() < 1e-7
    np.testing.assert_allclose(found.target_error, 0, atol=1e-7)
    far = mr.Pose(position=(0.5, 0, 0.1), across=(0, 0, 1))
    beyond = mr.reach(TUBES, far, free=FREE, limits=LIMITS, guess=start, solver=SOLVER)
    assert beyond.status is not mr.Status.REACHED
    assert beyond.target_error > 0.3  # the tubes are 0.4 m long, and bent


@pytest.mark.parametrize("tilted", [False, True])
def test_one_coordinate_is_reached_alone_or_beside_a_tilt(start, tilted, tmp_path):
    """A height and a tilt, each of a batch with a direction of its own: nothing is asked for in the plane across."""
    there = goals(start, 8)
    direction = np.random.default_rng(5).normal(size=(8, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    aside = np.cross(direction, (0.3, 1.0, -0.5))
    axis = {"axis": there.tip_rotation[..., 2]} if tilted else {}
    target = mr.Pose(position=there.tip_position + 2 * aside, along=-3 * direction, **axis)
    assert target.count == 1 + 2 * tilted
    found = mr.reach(TUBES, target, free=FREE, limits=LIMITS, guess=start, solver=SOLVER)
    assert (found.status == mr.Status.REACHED).all()
    off = ((found.tip_position - there.tip_position) * direction).sum(axis=1)
    np.testing.assert_allclose(off, 0, atol=1e-7)
    np.testing.assert_allclose(found.target_error, np.abs(off), atol=1e-9)
    if tilted:
        np.testing.assert_allclose(found.tip_rotation[..., 2], there.tip_rotation[..., 2], atol=1e-6)
    else:
        assert np.linalg.norm(found.tip_position - there.tip_position, axis=1).min() > 1e-4  # it is not where the other was
    found[3].save(tmp_path / "found.npz")
    again = mr.load(tmp_path / "found.npz")
    np.testing.assert_array_equal(again.target.along, found[3].target.along)
    assert float(again.target_error) == float(found[3].target_error)


def test_a_search_that_fails_says_what_its_start_was():
    """A straight column past the load under which it buckles, at the branch that it left and on the one that it went to."""
    rod = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.006, torsional_stiffness=0.0046))
    loads = np.array([(0, 0, -0.6), (0, 0, -0.1)])  # it buckles at 0.37 N
    inputs, far = rod.inputs(tip_force=loads), mr.Pose(position=(0, 0.3, 0.19))
    found = mr.reach(rod, far, inputs, free=("rotation", "translation"), solver=SOLVER)
    assert found.failed.all()
    with pytest.raises(mr.SolveError, match="it began past where the robot buckled or snapped .BIFURCATED.: begin before that"):
        found[0].raise_if_failed()
    assert "began BIFURCATED" in str(found[0])
    for own in (found[1], found[::-1][0]):
        with pytest.raises(mr.SolveError) as said:
            own.raise_if_failed()
        assert "it began" not in str(said.value)
        assert "began" not in str(own)
    straight = mr.solve(rod, inputs, guess=mr.solve(rod, solver=SOLVER), solver=SOLVER)
    assert straight.stability.tolist() == [mr.Stability.UNSTABLE, mr.Stability.STABLE]
    again = mr.reach(rod, far, guess=straight, free=("rotation", "translation"), solver=SOLVER)
    with pytest.raises(mr.SolveError, match="it began at an equilibrium that is unstable, already"):
        again.raise_if_failed()
    with pytest.raises(mr.SolveError) as said:
        again[1].raise_if_failed()
    assert "it began" not in str(said.value)


def test_what_ends_unstable_off_its_target_goes_back_to_the_nearest_that_is_stable():
    """A wire with three tendons, level and with a weight at its tip, and targets out of its reach: 5 of 16 were ``UNSTABLE``."""
    offsets = 6e-3 * np.stack([np.cos([0, 2, 4]), np.sin([0, 2, 4])], axis=-1)
    tendons = [mr.Tendon(offset=xy) for xy in offsets]
    wire = mr.Rod.wire(length=0.2, diameter=1e-3, young_modulus=60e9, poisson_ratio=0.3, lines=tendons)
    robot = mr.SingleRod(wire, base=mr.Pose(position=(0, 0, 0), rotation=[(0, 0, 1), (0, -1, 0), (1, 0, 0)]))
    y, z = np.meshgrid(np.linspace(0.02, 0.08, 4), np.linspace(-0.1, -0.04, 4))
    far = np.stack([np.full(16, 0.15), y.ravel(), z.ravel()], axis=-1)
    begin, options = robot.inputs(tension=1.0, tip_force=(0, 0, -0.5)), {"free": "tension", "limits": mr.Limits(tension=(0, 15))}
    found = mr.reach(robot, mr.Pose(position=far), begin, **options)
    assert np.isin(found.status, (mr.Status.AT_LIMIT, mr.Status.UNREACHABLE)).all()
    # stable all along straight ways to random tensions, and to those where the search ended
    way, random = np.linspace(0, 1, 20)[:, None, None], np.random.default_rng(0)
    ends = np.concatenate([found.ended_at.tension, random.uniform(0, 15, (150, 3)) * random.uniform(0, 1, (150, 1))])
    inputs = robot.inputs(tension=1 + way * (ends - 1), tip_force=np.broadcast_to((0, 0, -0.5), (20, len(ends), 3)))
    along = mr.simulate(robot, inputs, time=way.ravel())
    stable = (along.stability == mr.Stability.STABLE).all(axis=0)
    for k in (4, 5, 6, 9, 14):  # those
        away = np.where(stable, np.linalg.norm(along.tip_position[-1] - far[k], axis=-1), np.inf)
        if k < 9:  # those have nearer ones, on ways that lead away first
            assert found.target_error[k] < 1.05 * away.min()
        if k in (9, 14):  # the others turn on the way there
            assert stable[k]
            assert found.target_error[k] == pytest.approx(away[k], abs=1e-6)


@pytest.mark.parametrize("name", ["magnetic_field", "gravity"])
def test_what_acts_on_nothing_is_not_chosen(name):
    rod = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.006, torsional_stiffness=0.0046))
    asked = {"reach": lambda: mr.reach(rod, mr.Pose(position=(0, 0.1, 0.1)), free=("rotation", name))}
    asked["Controller"] = lambda: mr.Controller(rod, dt=0.01, free=name)
    measured = mr.Pose(position=(0, 0.1, 0.1), sigma=1e-3)
    asked["estimate"] = lambda: mr.estimate(rod, unknown={name: mr.Prior(0, sigma=0.01)}, measured=measured)
    on = {"magnetic_field": "magnetisation", "gravity": "linear_density"}[name]
    for call in asked.values():
        with pytest.raises(ValueError, match=f"{name} does nothing: no rod has a {on}"):
            call()


def test_how_far_off_a_target_is_left_is_told_of_an_equilibrium(start):
    """Of the last iterate before: up to a quarter off, where that was on its way to one."""
    target = start.tip_position + np.random.default_rng(1).normal(size=(20, 3)) * (0.2, 0.2, 0.1)
    found = mr.reach(TUBES, mr.Pose(position=target), free=FREE, limits=LIMITS, guess=start, solver=SOLVER)
    left = np.flatnonzero(found.status == mr.Status.UNREACHABLE)
    assert len(left) > 10
    right = 0
    for k in left:
        part = np.linspace(0, 1, 200)[:, None]
        way = {
            name: getattr(start.inputs, name) + part * (getattr(found.ended_at, name)[k] - getattr(start.inputs, name))
            for name in FREE
        }
        inputs = TUBES.inputs(tip_force=np.tile(start.inputs.tip_force, (200, 1)), **way)
        there = mr.simulate(TUBES, inputs, time=part[:, 0], solver=SOLVER, guess=start).tip_position[-1]
        right += abs(np.linalg.norm(there - target[k]) - found.target_error[k]) < 1e-6
    assert right >= 0.7 * len(left)  # the others went another way there, to another equilibrium


def test_what_no_wider_limits_bring_nearer_is_out_of_reach_and_at_no_limit():
    """(20): all tendons were drawn up to whatever limit there was, 15 or 100 N, for a thousandth of the 0.12 mm that are left."""
    places = [(0.003 * np.cos(angle), 0.003 * np.sin(angle)) for angle in 2 * np.pi / 3 * np.arange(3)]
    lines = [mr.Tendon(place, end=0.06) for place in places] + [mr.Tendon((-x, -y)) for x, y in places]
    robot = mr.SingleRod(mr.Rod.wire(length=0.12, diameter=1e-3, young_modulus=60e9, poisson_ratio=0.3, lines=lines))
    start, target = robot.inputs(tension=1, tip_force=(0, 0.1, 0)), mr.Pose(position=(0.0235, 0, 0.117), axis=(0, 0, 1))
    options = {"free": "tension", "prefer": "smallest tension", "solver": SOLVER}
    found = [mr.reach(robot, target, start, limits=mr.Limits(tension=(0, high)), **options) for high in (15.0, 100.0)]
    assert all(one.status == mr.Status.UNREACHABLE for one in found)
    np.testing.assert_allclose(found[1].ended_at.tension, found[0].ended_at.tension, atol=0.05)
    assert all(one.ended_at.tension.max() < 14.9 for one in found)
    assert all(1.2e-4 < one.target_error < 1.26e-4 for one in found)
    held = mr.reach(robot, target, start, limits=mr.Limits(tension=(0, 8)), **options)
    assert held.status == mr.Status.AT_LIMIT  # wider ones do bring it nearer
    assert held.target_error > 5e-3


@pytest.mark.parametrize("pushed", [0.02, 0.1])
def test_a_straight_strip_that_is_held_is_bent_to_where_its_end_is_to_be(pushed):
    """Straight it is where the search meets that, and stands nowhere."""
    strip = mr.HeldRod(mr.Rod(length=0.4, bending_stiffness=(10, 0.2233), torsional_stiffness=0.0638))
    targets = mr.Pose(position=[(0, 0, 0.4 - pushed), (0.01, 0, 0.4 - pushed)])
    found = mr.reach(strip, targets, strip.inputs(), free="end_position")
    np.testing.assert_array_equal(found.status, mr.Status.REACHED)
    np.testing.assert_array_equal(found.stability, mr.Stability.STABLE)
    solved = mr.solve(strip, strip.inputs(end_position=found.inputs.end_position)).raise_if_failed()
    np.testing.assert_allclose(solved.tip_position, targets.position, atol=1e-9)
    np.testing.assert_allclose(found.energy, solved.energy, rtol=1e-9)
    first = mr.reach(strip, mr.Pose(position=targets.position[0]), strip.inputs(), free="end_position")
    np.testing.assert_array_equal(first.unknowns, found.unknowns[0])


def test_a_straight_strip_is_bent_a_little_from_other_starts():
    """Where straight it is next to what is asked for, one step says nothing of the thrust that it bears."""
    strip = mr.HeldRod(mr.Rod(length=0.4, bending_stiffness=(10, 0.2233), torsional_stiffness=0.0638))
    target = mr.Pose(position=(0, 0, 0.398))
    assert mr.reach(strip, target, strip.inputs(), free="end_position", starts=8).status is mr.Status.REACHED
