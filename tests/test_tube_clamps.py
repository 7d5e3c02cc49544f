"""Concentric tubes that would snap though their tips were held: clamps along them (``docs/branches.md``, (15), (16))."""

import numpy as np
import pytest
from creeping_tubes import CreepingTubes, Curved
from medium_energy import TubesInMedium
from random_motions import DURATION, draw

import multirod as mr
from multirod.solvers.following.serving.turns import ClampedTurns

pytestmark = pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")  # of unit stiffness and length
PIECES = 6


def tubes_of(curved):
    """The same tubes for the package."""
    rods = []
    for tube in curved:
        sections = [(tube.straight, (0, 0, 0))] * (tube.straight > 0) + [(tube.reach - tube.straight, (tube.curvature, 0, 0))]
        stiffness = {"bending_stiffness": tube.bending, "torsional_stiffness": tube.torsion}
        rods.append(mr.Rod(length=tube.reach, precurvature=sections, **stiffness))
    return mr.ConcentricTubes(rods)


def test_tubes_on_segments_fall_as_their_energy_does():
    """The judge itself: its gradient by differences, its second derivative by those of the gradient."""
    tubes = CreepingTubes([Curved(1.0, 1.0, 0.8, 0.3, 4.0), Curved(0.9, 1.5, 1.2, 0.3, 3.0), Curved(0.7, 2.0, 1.5, 0.3, 2.0)], 10)
    rng, eps = np.random.default_rng(3), 1e-5
    tubes.angle[:] = rng.normal(size=tubes.angle.shape)
    way = rng.normal(size=tubes.angle.shape) * (np.pad(tubes.on, ((0, 0), (1, 0))))  # what is free
    before, found = tubes.angle.copy(), []
    for sign in (1, -1):
        tubes.angle[:] = before + sign * eps * way
        found.append((tubes.energy(), tubes.gradient()))
    tubes.angle[:] = before
    assert (found[0][0] - found[1][0]) / (2 * eps) == pytest.approx((tubes.gradient() * way).sum(), rel=1e-8)
    # a step by a shift that is large goes against the gradient: with that, the second derivative times it is what is left
    shift = 1e3
    step = tubes._step(shift)
    by_step = []
    for sign in (1, -1):
        tubes.angle[:] = before + sign * 1e-2 * step
        by_step.append(tubes.gradient())
    tubes.angle[:] = before
    second = (by_step[0] - by_step[1]) / 2e-2
    free = np.pad(tubes.on, ((0, 0), (1, 0)))
    np.testing.assert_allclose((second + shift * step + tubes.gradient())[free], 0, rtol=0, atol=1e-7)


def clamped_of(problem):
    """With clamps, and what tells of them; unknowns and moments drawn by lot."""
    part = problem.parts.clamped(np.array([0]), PIECES)
    turns = ClampedTurns(part)
    unknowns = np.random.default_rng(5).normal(size=(1, problem.unknown_count)) * 0.4
    return part, turns, unknowns


@pytest.mark.parametrize(
    "kind", ["free", "loaded", "in a medium", "side by side", "side by side, loaded", "some rigid in torsion"]
)
def test_pieces_between_clamps_are_the_tubes_and_vary_as_they_say(kind):
    """Clamps without moments change nothing; by unknowns and moments, residuals, turns of clamps and the pose vary as foretold.

    The third tube ends before the last clamp: there a spring stands in for it.
    """
    sizes = [(1.0, 3.0, 1.0), (0.9, 2.5, 1.3), (0.6, 2.0, 1.6)]
    given = {} if kind in ("free", "side by side") else {"tip_force": (0.7, -0.4, 0.2), "distributed_force": (0.2, 0, 0.3)}
    torsion = [0.8, np.inf if "rigid" in kind else 1.04, 1.28]
    medium = (20.0, 10.0, 5.0) if kind == "in a medium" else 0.0
    rods = [
        mr.Rod(
            length=L,
            bending_stiffness=EI,
            torsional_stiffness=GJ,
            precurvature=[(0.3, (0, 0, 0)), (L - 0.3, (c, 0, 0.2))],
            foundation=medium,
        )
        for (L, c, EI), GJ in zip(sizes, torsion, strict=True)
    ]
    offsets = [(0.02, 0), (-0.01, 0.02), (0, -0.03)]
    robot = mr.EccentricTubes(rods, offsets) if "side" in kind else mr.ConcentricTubes(rods)
    inputs = robot.inputs(rotation=[0.3, 1.0, -2.0], translation=[-0.1, -0.05, -0.02], **given)
    problem = robot.problem(inputs, integrator=mr.RK45(rtol=1e-11, atol=1e-13))
    part, turns, unknowns = clamped_of(problem)
    whole = problem.parts.followed(np.array([0]))
    whole.write("unknowns", unknowns)
    whole.integrate()
    n, clamps = problem.unknown_count, turns.clamps.size
    soft = "side" in kind or "rigid" in kind  # what gives way to torsion for the clamps alone, by a millionth
    exact = 1e-5 if soft else 1e-9  # else the integrator's tolerance
    every = {"free": 2, "side by side": 3, "side by side, loaded": 6}
    assert clamps == (PIECES - 1) * every.get(kind, 5)

    def at(values):
        turns.put(values)
        part.integrate()
        residual, gamma, unit, turned = (found[0].copy() for found in turns.after(values))
        chain = part.launch
        frames = [*chain.frames[0].copy(), part.read("rotation")[0].reshape(3, 3)]
        return residual, gamma, unit, turned, frames, chain.turned[0].copy(), part.angle_columns.numpy()[0].copy()

    at(np.pad(unknowns, ((0, 0), (0, clamps))))
    for name in ("residual", "gamma", "position", "rotation"):
        np.testing.assert_allclose(part.read(name), whole.read(name), rtol=0, atol=exact)
    ours, theirs = part.angle_columns.numpy()[..., [*range(n), -1]], whole.angle_columns.numpy()[..., [*range(n), -1]]
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=exact)

    values = np.concatenate([unknowns, 0.3 * np.random.default_rng(6).normal(size=(1, clamps))], axis=1)
    _, gamma, units, turned, frames, by_clamps, pose = at(values)
    eps = 1e-5
    for k in range(n + clamps):
        there, back = (at(values + sign * eps * np.eye(n + clamps)[k]) for sign in (1, -1))
        # differences of the second order, and of what the integrator leaves over eps
        np.testing.assert_allclose((there[0] - back[0]) / (2 * eps), gamma[:, k], rtol=0, atol=1e-6)
        turns_found = []
        for frame, before, after in zip(frames, back[4], there[4], strict=True):
            spin = frame.T @ (after - before) / (2 * eps)
            turns_found.append((spin[2, 1], spin[0, 2], spin[1, 0]))
        if given:
            np.testing.assert_allclose(turns_found[:-1], by_clamps[:, :3, k], rtol=0, atol=1e-6)
        np.testing.assert_allclose(turns_found[-1], frames[-1].T @ pose[3:6, k], rtol=0, atol=1e-6)
    size = np.linalg.norm(turned, axis=1, keepdims=True)
    assert np.linalg.cond(turned / size) < (1e8 if soft else 1e6)  # no turn is told twice
    if not given:  # of an energy, whose second derivative is symmetric: along axes that turn it is where it rests alone
        second = units[:, None] * gamma[turns.forces] @ np.linalg.inv(turned)[:, : len(turns.forces)]
        np.testing.assert_allclose(second, second.T, rtol=0, atol=(1e-5 if soft else 1e-9) * np.abs(second).max())
        np.testing.assert_allclose(second[-1], np.eye(len(second))[-1] * torsion[-1] / 1.0, rtol=0, atol=1e-9)  # GJ/L


def snaps_of(history, curved, bases):
    """Of each snap the sample, and how far from where creeping tubes end, from the sample before it on."""
    result = []
    for k in np.flatnonzero(history.status == mr.Status.SNAPPED).tolist():
        tubes = CreepingTubes(curved)
        tubes.angle[:, 0] = bases[k - 1]
        tubes.place(history[k - 1])
        for part in np.linspace(0, 1, 9):
            assert tubes.creep((1 - part) * bases[k - 1] + part * bases[k])
        result.append((k, float(np.linalg.norm(tubes.tip() - history.tip_position[k]))))
    return result


@pytest.mark.parametrize(
    "curved",
    [
        [Curved(1.7, 1.0, 1.0, 0.7, 4.0)] * 3,
        [Curved(1.0, 1.3, 1.0, 0.25, 5.4), Curved(0.95, 0.7, 0.5, 0.25, 4.0), Curved(0.6, 1.8, 1.3, 0.25, 6.0)],
    ],
    ids=["equal", "others"],
)
def test_three_tubes_snap_to_where_creeping_ones_come_to_rest(curved):
    """These were ``BRANCH_END`` from their first snap on, at 9.15 rad of the equal ones."""
    robot = tubes_of(curved)
    time = np.linspace(0, 1, 121)
    bases = np.outer(time, (0, 18.0, 0))
    history = mr.simulate(robot, robot.inputs(rotation=bases), time=time)
    assert not history.failed.any()
    assert (history.stability == mr.Stability.STABLE).all()
    assert history.integrations.max() < 1000
    events = [event for sample in history.events for event in sample]
    assert len(events) >= 2
    assert all(event.status is mr.Status.SNAPPED and event.fold and event.energy_lost > 0 for event in events)
    for k, off in snaps_of(history, curved, bases):
        assert off < 0.02, k  # of 160 segments; other equilibria are farther than 0.1


@pytest.mark.parametrize("kind", ["next to no medium", "side by side on one line"])
def test_what_is_all_but_three_tubes_snaps_as_these_do(kind):
    """Tubes in a medium of next to no stiffness, and tubes side by side without offsets, which ended ``BRANCH_END``."""
    curved = [Curved(1.7, 1.0, 1.0, 0.7, 4.0)] * 3
    plain = tubes_of(curved)
    k = 1e-6 if kind == "next to no medium" else 0.0
    rods = [
        mr.Rod(
            length=1.7,
            bending_stiffness=1,
            torsional_stiffness=1,
            precurvature=[(0.7, (0, 0, 0)), (1.0, (4, 0, 0))],
            foundation=k,
        )
        for _ in curved
    ]
    robot = mr.ConcentricTubes(rods) if k else mr.EccentricTubes(rods, np.zeros((3, 2)))
    time = np.linspace(0, 1, 61)[28:33]  # about the first snap
    bases = np.outer(time, (0, 18.0, 0))
    ours, theirs = (mr.simulate(own, own.inputs(rotation=bases), time=time) for own in (robot, plain))
    np.testing.assert_array_equal(ours.status, theirs.status)
    assert (ours.status == mr.Status.SNAPPED).sum() == 1
    assert (ours.stability == mr.Stability.STABLE).all()
    (event,), (other,) = ([event for sample in own.events for event in sample] for own in (ours, theirs))
    assert event.progress == pytest.approx(other.progress, rel=1e-5)
    assert event.energy_lost == pytest.approx(other.energy_lost, rel=1e-5)
    np.testing.assert_allclose(ours.tip_position, theirs.tip_position, rtol=0, atol=1e-5)


def test_tubes_in_a_medium_snap_to_a_minimum_of_their_energy():
    """Which an energy on segments says, that shares no code with the package: it has less there, and no way down."""
    k, count = np.array([2.0, 3.0, 1.0]), 34
    bent = np.where(np.arange(count)[:, None] < 14, 0.0, np.array([4.0, 0, 0]))
    rods = [
        mr.Rod(
            length=1.7,
            bending_stiffness=1,
            torsional_stiffness=1,
            precurvature=[(0.7, (0, 0, 0)), (1.0, (4, 0, 0))],
            foundation=own,
        )
        for own in (tuple(k), 0.0, 0.0)
    ]
    robot, time = mr.ConcentricTubes(rods), np.linspace(0, 1, 61)[28:33]
    bases = np.outer(time, (0, 18.0, 0))
    history = mr.simulate(robot, robot.inputs(rotation=bases), time=time)
    (snapped,) = np.flatnonzero(history.status == mr.Status.SNAPPED)
    assert not history.failed.any()
    values = []
    for sample in (snapped - 1, snapped):
        energy = TubesInMedium(1.7, [(1.0, 1.0, bent)] * 3, bases[snapped], k, np.zeros(3), count)
        own = energy.of(history[sample], range(3))
        values.append(energy(own[None])[0])
        if sample == snapped:
            there, modes = energy.stationary(own)
            assert modes[0] > 0
            assert np.abs(there - own).max() < 0.1 * np.abs(own).max()
    assert values[0] > values[1] + 0.5


def test_clamps_end_within_the_integrations_that_are_allowed():
    """A descent by clamps takes some hundred: fewer end it, and the sample says so."""
    robot = tubes_of([Curved(1.7, 1.0, 1.0, 0.7, 4.0)] * 3)
    time = np.linspace(0, 1, 31)
    bases = np.outer(time, (0, 10.0, 0))
    free = mr.simulate(robot, robot.inputs(rotation=bases), time=time)
    (snapped,) = np.flatnonzero(free.status == mr.Status.SNAPPED)
    needed = int(free.integrations[snapped])
    few = mr.simulate(robot, robot.inputs(rotation=bases), time=time, solver=mr.Shooting(max_integrations=needed // 2))
    assert few.status[snapped] == mr.Status.INTEGRATION_LIMIT
    assert few.integrations[snapped] <= needed // 2 + 10  # those that judge come on top
    np.testing.assert_array_equal(few.tip_position[:snapped], free.tip_position[:snapped])


def test_legs_of_tubes_in_pieces_are_the_legs_and_vary_as_they_say():
    """The same of a platform on legs of tubes, which twist behind their plates: their tips are held."""
    rod = {"bending_stiffness": 1.0, "torsional_stiffness": 0.8}
    pair = [mr.Rod(length=1.0, precurvature=(2.0, 0, 0), **rod), mr.Rod(length=0.8, precurvature=(1.5, 0.5, 0), **rod)]
    base, platform = np.tile(np.eye(4), (2, 3, 1, 1))
    base[:, :2, 3], platform[:, :2, 3] = [(0.3, 0), (-0.2, 0.2), (-0.1, -0.3)], [(0.2, 0), (-0.1, 0.1), (-0.1, -0.2)]
    legs = [mr.ConcentricTubes(pair), mr.ConcentricTubes(pair), mr.Rod(length=1.0, **rod)]
    robot = mr.ParallelRods(legs=legs, base=base, platform=platform, joints=["clamped", "spherical", "clamped"])
    inputs = robot.inputs(
        rotation=(0.3, 1.0, -0.4, 0.8, 0.1), translation=(-0.1, -0.05, -0.1, -0.02, 0), tip_force=(0.3, 0.2, -0.5)
    )
    problem = robot.problem(inputs, integrator=mr.RK4(steps=60))
    assert problem.parts.clampings == 2  # the single rod alone, then all
    sizes = [problem.parts.clamped(np.array([0]), PIECES, 1, clamping).clamps.size for clamping in (0, 1)]
    assert sizes == [(PIECES - 1) * 3, (PIECES - 1) * (4 + 4 + 3)]
    part, whole = problem.parts.clamped(np.array([0]), PIECES, 1, 1), problem.parts.followed(np.array([0]))
    turns, n = ClampedTurns(part), problem.unknown_count
    unknowns = problem.guess() + 0.1 * np.random.default_rng(2).normal(size=(1, n))
    whole.write("unknowns", unknowns)
    whole.integrate()

    def at(values):
        turns.put(values)
        part.integrate()
        return tuple(found[0].copy() for found in turns.after(values))

    residual, gamma, _, _ = at(np.pad(unknowns, ((0, 0), (0, sizes[1]))))
    # equal steps over pieces are not those over whole legs
    np.testing.assert_allclose(residual[:n], whole.read("residual")[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(gamma[:n, :n], whole.read("gamma")[0].reshape(n, n), rtol=0, atol=1e-5)
    values = np.concatenate([unknowns, 0.2 * np.random.default_rng(6).normal(size=(1, sizes[1]))], axis=1)
    _, gamma, _, turned = at(values)
    eps = 1e-5
    for k in range(values.shape[1]):
        there, back = (at(values + sign * eps * np.eye(values.shape[1])[k]) for sign in (1, -1))
        np.testing.assert_allclose((there[0] - back[0]) / (2 * eps), gamma[:, k], rtol=0, atol=1e-6)
    assert np.linalg.matrix_rank(turned) == values.shape[1]  # no turn is told twice


def test_legs_of_tubes_that_snap_though_their_tips_are_held_go_where_creeping_ones_come_to_rest():
    """This was ``BRANCH_END`` at its sixth sample."""
    motion, time = draw("tube legs", 14, 13), np.linspace(0, DURATION, 41)[:7]
    inputs = motion.robot.inputs(**motion.at(time))
    history = mr.simulate(motion.robot, inputs, time=time, solver=mr.Shooting(integrator=mr.RK4(50)))
    assert not history.failed.any()
    assert (history.stability == mr.Stability.STABLE).all()
    (snapped,) = np.flatnonzero(history.status == mr.Status.SNAPPED)
    energy = motion.on_segments(history[snapped - 1], time[snapped - 1])
    for now in np.linspace(time[snapped - 1], time[snapped], 9):
        motion.place(energy, now)
        assert energy.creep()
    off = np.linalg.norm(energy.position - history.tip_position[snapped] / motion.length)
    assert off < 0.02  # of legs on 32 segments
