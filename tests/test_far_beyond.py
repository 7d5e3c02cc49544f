"""Round columns pressed far beyond what buckles them: segments go on, and no step of theirs turns a column about its axis."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipe, ellipkm1

import multirod as mr
from multirod.models.backbone.segments.segments import BackboneSegments
from multirod.solvers.segments.neutral import Neutral
from multirod.solvers.segments.path import SegmentedPaths
from multirod.solvers.segments.place import Place
from multirod.status import Status

Array = NDArray[np.float64]


def column(**more: object) -> mr.SingleRod:
    return mr.SingleRod(mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=0.7), **more)  # type: ignore[arg-type]


def elastica(load: float) -> tuple[float, float]:
    """How far aside the tip of a column of unit length is under ``load`` in ``EI/L^2``, and how high.

    With ``sin(t/2) = k sin f`` the quarter of a wave is ``K(k) = load^(1/2)`` long, the tip is ``2 k/load^(1/2)`` aside and ``2
    E/K - 1`` high. Where ``k`` nears 1, ``1 - k^2`` is looked for by its logarithm.
    """
    root = np.sqrt(load)
    least = brentq(lambda logarithm: ellipkm1(np.exp(logarithm)) - root, -2 * root - 10, -1e-9)
    return 2 * np.sqrt(1 - np.exp(least)) / root, 2 * ellipe(1 - np.exp(least)) / root - 1


@pytest.mark.parametrize("load", [184.0, 300.0, 1000.0, 5000.0])
def test_a_round_column_is_on_its_elastica(load):
    """75 to 2000 times what buckles it; from 180 on it was ``UNSTABLE``, then ``BRANCH_END`` after up to 2900 integrations."""
    robot = column()
    solution = mr.solve(robot, robot.inputs(tip_force=(0, 0, -load))).raise_if_failed()
    assert solution.status == mr.Status.BIFURCATED
    assert solution.stability == mr.Stability.FOLD  # it may turn about its axis, and nothing else
    assert [event.neutral for event in solution.events] == [1]
    aside, high = elastica(load)
    # the tolerance of the residual moves the tip by as much
    np.testing.assert_allclose(solution.tip_position, (aside, 0, high), rtol=0, atol=1e-8)
    assert solution.integrations < 350


def test_columns_that_stand_askew_and_bear_themselves():
    """The same in any frame, to its other side, and under what is distributed: turned with its base and its loads."""
    turn = Rotation.from_rotvec((0.4, -0.9, 0.3))
    base = np.eye(4)
    base[:3, :3] = turn.as_matrix()
    load = {"tip_force": np.array([0, 0, -200.0]), "distributed_force": np.array([0, 0, -300.0])}
    upright, askew = column(), column(base=base)
    solution = mr.solve(upright, upright.inputs(**load)).raise_if_failed()
    turned = mr.solve(
        askew, askew.inputs(rotation=0.7, **{name: turn.apply(own) for name, own in load.items()})
    ).raise_if_failed()
    twin = mr.solve(upright, upright.inputs(**load), solver=mr.Shooting(side="negative")).raise_if_failed()
    assert {own.status for own in (solution, turned, twin)} == {mr.Status.BIFURCATED}
    x, _, z = solution.tip_position
    np.testing.assert_allclose(twin.tip_position, (-x, 0, z), rtol=0, atol=1e-8)
    back = base[:3, :3].T @ turned.tip_position
    np.testing.assert_allclose((np.hypot(*back[:2]), back[2]), (x, z), rtol=0, atol=1e-8)


def test_a_motion_presses_a_column_far_and_lets_it_go():
    """To 300 ``EI/L^2`` and back: from 190 on samples were ``STALLED``, after up to 2800 integrations each."""
    robot, load = column(), 300 * (1 - np.abs(np.linspace(-1, 1, 41)))
    force = load[:, None] * np.array([0, 0, -1.0])
    history = mr.simulate(robot, robot.inputs(tip_force=force), time=np.linspace(0, 1, 41))
    assert not history.failed.any()
    assert [len(events) for events in history.events] == [0, 1, *[0] * 39]
    bent = np.flatnonzero(load > 3)
    found = history.tip_position[bent]
    expected = np.array([elastica(own) for own in load[bent]])
    np.testing.assert_allclose(np.stack([np.hypot(*found.T[:2]), found[:, 2]], axis=1), expected, rtol=0, atol=2e-8)
    assert (history.integrations[12:30] < 60).all()


def test_one_sample_presses_a_column_far_and_others_go_on():
    """At 300 at once it was ``BRANCH_END``, as every sample after it; from the event on it goes by states."""
    robot, load = column(), np.array([0, 300, 320, 1000, 0.5, 500])
    history = mr.simulate(robot, robot.inputs(tip_force=load[:, None] * np.array([0, 0, -1.0])), time=np.arange(6.0))
    history.raise_if_failed()
    assert history.status[[1, 5]].tolist() == [mr.Status.BIFURCATED] * 2
    assert [[event.neutral for event in sample] for sample in history.events] == [[], [1], [], [], [], [1]]
    critical = [sample[0].time for sample in history.events if sample]
    np.testing.assert_allclose(critical, (np.pi**2 / 4 / 300, 4 + (np.pi**2 / 4 - 0.5) / 499.5), rtol=0, atol=1e-6)
    found = history.tip_position[[1, 2, 3, 5]]
    expected = np.array([elastica(own) for own in load[[1, 2, 3, 5]]])
    np.testing.assert_allclose(np.stack([np.hypot(*found.T[:2]), found[:, 2]], axis=1), expected, rtol=0, atol=1e-8)
    assert history.integrations.max() < 350
    tracker = mr.Tracker(robot, inputs=robot.inputs(tip_force=(0, 0, 0)))
    for k, force in enumerate(load):
        np.testing.assert_array_equal(tracker.step(tip_force=(0, 0, -force)).tip_position, history.tip_position[k])


@pytest.mark.parametrize("bend", [1e-6, 1e-4])
def test_what_next_to_nothing_holds_on_its_circle_is_followed_without_an_event(bend):
    """A column that is bent by a millionth at rest was ``BRANCH_END`` from 16 ``EI/L^2`` on; one bent by 1e-4 ``BIFURCATED`` at
    12, where nothing crosses its branch."""
    bent = mr.SingleRod(mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=0.7, precurvature=(bend, -0.7 * bend, 0)))
    load = np.array([0.3, 16.3, 76.0, 25.0, 0.05, 17.0, 12.0])
    history = mr.simulate(bent, bent.inputs(tip_force=load[:, None] * np.array([0, 0, -1.0])), time=np.arange(7.0))
    history.raise_if_failed()
    assert not any(history.events)
    expected = np.array([elastica(own) if own > 3 else (0.0, 1.0) for own in load])
    found = np.stack([np.hypot(*history.tip_position.T[:2]), history.tip_position[:, 2]], axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=bend)  # of the order of how much it is bent
    # to the side to which it is bent, as far as what holds it there is more than the tolerance
    side = np.arctan2(history.tip_position[:, 1], history.tip_position[:, 0])
    np.testing.assert_allclose(side[load > 3], np.arctan2(-1, -0.7), rtol=0, atol=1e-8 / bend)


def test_what_segments_go_on_to_is_known_by_its_states_without_an_event_too():
    """A column that is hardly bent, from 50 to 441 at once: it was ``CONVERGED`` without a ``Gamma``, and the next sample ended
    in a ``LinAlgError``."""
    bent = mr.SingleRod(mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=0.7, precurvature=(2e-4, -2.5e-4, 4e-5)))
    load = np.array([50.0, 441.0, 68.0])
    history = mr.simulate(bent, bent.inputs(tip_force=load[:, None] * np.array([0, 0, -1.0])), time=np.arange(3.0))
    history.raise_if_failed()
    assert history.status[1] == mr.Status.MULTIPLE_SHOOTING
    assert (np.isnan(history.condition) == (history.status == mr.Status.MULTIPLE_SHOOTING)).all()
    expected = np.array([elastica(own) for own in load])
    found = np.stack([np.hypot(*history.tip_position.T[:2]), history.tip_position[:, 2]], axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)  # of the order of how much it is bent


def test_what_rounding_stops_goes_on_in_segments_by_the_steps_that_led_there():
    """Pressed askew by 300 ``EI/L^2`` in one sample it was ``STALLED``: by other steps its unknowns lead elsewhere."""
    robot, force = column(), 300 * np.array([1, 0, -2]) / np.sqrt(5)
    history = mr.simulate(robot, robot.inputs(tip_force=np.outer([0, 1], force)), time=np.arange(2.0)).raise_if_failed()
    alone = mr.solve(robot, robot.inputs(tip_force=force)).raise_if_failed()
    assert alone.stability == history[1].stability == mr.Stability.STABLE
    np.testing.assert_allclose(history.tip_position[1], alone.tip_position, rtol=0, atol=1e-8)


def test_a_guess_by_states_is_not_turned():
    robot = column()
    known = mr.solve(robot, robot.inputs(tip_force=(0, 0, -300)))
    again = mr.solve(robot, robot.inputs(tip_force=(0, 0, -315)), guess=known).raise_if_failed()
    assert again.integrations < 20
    aside, high = elastica(315)
    np.testing.assert_allclose(again.tip_position, (aside, 0, high), rtol=0, atol=1e-8)


# ---- in segments ----


def paths_at(load: float) -> tuple[SegmentedPaths, Array]:
    """The way of a column to a load, and its unknowns under 4 ``EI/L^2``."""
    robot = column()
    bent = mr.solve(robot, robot.inputs(tip_force=(0, 0, -4.0)), solver=mr.Shooting(integrator=mr.RK4(48)))
    segments = robot.problem(robot.inputs(tip_force=(0, 0, -load)), integrator=mr.RK45()).segments
    assert isinstance(segments, BackboneSegments)
    paths = SegmentedPaths(
        segments,
        np.zeros(1, dtype=int),
        tolerance=np.array([1e-9]),
        max_iterations=30,
        max_steps=100,
        allowed=np.array([1000]),
        integrator=mr.RK45(),
    )
    return paths, bent.unknowns


def pressed(load: float) -> tuple[SegmentedPaths, Place]:
    paths, unknowns = paths_at(load)
    steps = np.array([48])
    results = paths.follow(unknowns[None], np.array([load]), np.array([4.0 / load]), steps, 1)
    assert results.status[0] == Status.MULTIPLE_SHOOTING
    return paths, results.place


def test_segments_follow_a_column_whose_tip_turns_over():
    """(25) From where it has just buckled: its tip turns by a half, and the axis in it, along which nothing is asked for."""
    paths, place = pressed(300.0)
    aside, high = elastica(300.0)
    position, _ = paths.segments.tip_pose(place.cuts, place.found)
    np.testing.assert_allclose((np.hypot(*position[0, :2]), position[0, 2]), (aside, high), rtol=0, atol=1e-8)
    assert paths.neutral is not None
    # the axis, in the tip, which lacks some 8 e^-17 rad of hanging, and the turn of the curvature at the base
    np.testing.assert_allclose(np.abs(paths.neutral.left[0, :, 0]), (0, 0, 1), rtol=0, atol=1e-5)
    across = np.cross((0, 0, 1), place.cuts.unknowns[0])
    along = abs(paths.neutral.right[0, :, 0] @ across) / np.linalg.norm(across)
    assert along == pytest.approx(1, abs=1e-6)


def test_what_is_neutral_is_found_from_what_is_near_it():
    """(25) ``J`` and its transpose make nothing of what is found, whatever it was taken for."""
    paths, place = pressed(200.0)
    assert len(place.cuts.start) > 2
    turned = paths.neutral
    rng = np.random.default_rng(4)
    paths.neutral = Neutral(*(np.linalg.qr(own + 0.3 * rng.normal(size=own.shape))[0] for own in (turned.right, turned.left)))
    paths.turn(place)
    for name in ("right", "left"):
        product = getattr(turned, name)[0, :, 0] @ getattr(paths.neutral, name)[0, :, 0]
        assert abs(product) == pytest.approx(1, abs=1e-9)
    gamma = place.gamma(paths.segments.unknown_places)[0]
    size = np.linalg.norm(gamma)
    assert np.linalg.norm(gamma @ paths.neutral.right[0]) < 1e-8 * size
    assert np.linalg.norm(paths.neutral.left[0].T @ gamma) < 1e-8 * size


def test_steps_are_those_of_the_bordered_equations():
    """(24) No step goes along what is neutral, and what is lacking across it is taken away, by all that ``J`` is."""
    paths, place = pressed(200.0)
    systems, rng = paths.systems(place), np.random.default_rng(5)
    step = systems.solve(paths.gaps(replace_gaps(place, rng)))
    neutral = systems.neutral
    assert neutral is not None
    assert np.abs(neutral.right[0].T @ step.own[0]).max() < 1e-12 * np.abs(step.own).max()
    # Gamma by what segments lead to: the first gap, led on to the tip, and so forth
    d, places = paths.segments.variation_size, paths.segments.unknown_places
    gaps, count = paths.gaps(replace_gaps(place, np.random.default_rng(5))), len(place.cuts.start)
    state = np.zeros(d)
    state[places] = step.own[0]
    for k in range(count - 1):
        state = place.found.transition[k, :, :d] @ state - gaps.rows[k]
        np.testing.assert_allclose(state, step.rows[k + 1], rtol=0, atol=1e-8 * np.abs(step.rows).max())
        state = step.rows[k + 1]
    left = place.found.residual_columns[0, :, :d] @ state - gaps.own[0]
    across = left - neutral.left[0] @ (neutral.left[0].T @ left)
    assert np.abs(across).max() < 1e-8 * np.abs(step.rows).max()


def replace_gaps(place: Place, rng: np.random.Generator) -> Place:
    """The same place with gaps that are not small, (2) as it was."""
    end = place.found.end + 1e-2 * rng.normal(size=place.found.end.shape)
    return replace(place, found=replace(place.found, end=end, residual=rng.normal(size=place.found.residual.shape)))
