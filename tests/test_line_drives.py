"""Lines driven by displacement and pressure: closed forms, tensions that do the same, differences, slack, stability."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq, fsolve
from scipy.special import ellipk, jv

import multirod as mr
from multirod.models.backbone.stability.condensing.second_variation import CondensedForm, NodeColumns
from multirod.models.backbone.stability.condensing.tensions import with_conditions
from multirod.solvers.tracking.kinks import follows

EI, GJ, LENGTH, R = 0.01, 0.0077, 0.2, 0.008
OWN = {"length": LENGTH, "bending_stiffness": EI, "torsional_stiffness": GJ}
FIRM = {"shear_stiffness": 4000.0, "axial_stiffness": 9000.0}  # so that the kernels are those of rods with shear
SOFT = {"shear_stiffness": 40.0, "axial_stiffness": 90.0}
PRECISE = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-12, atol=1e-14))
STOPS = mr.Shooting(tolerance=1e-6, fallback=False, at_fold="stop")
FORCE = (0.1, 0.3, -0.2)


def helix(s):
    return 0.006 * np.cos(30 * s), 0.006 * np.sin(30 * s)


def pulled() -> mr.SingleRod:
    """An elastic tendon, an inextensible one over a part, an elastic one on a helix, on a rod that is bent at rest."""
    lines = [
        mr.Tendon(offset=(R, 0), driven="displacement", axial_stiffness=40.0, name="right"),
        mr.Tendon(offset=(-0.004, 0.007), driven="displacement", end=0.14),
        mr.Tendon(route=helix, driven="displacement", axial_stiffness=60.0),
    ]
    return mr.SingleRod(mr.Rod(**OWN, **FIRM, precurvature=(1.0, -0.5, 0.3), lines=lines))


ROBOT = pulled()
PULL = np.array([0.003, 0.004, 0.002])


def solved(displacement=PULL, force=FORCE, **more) -> mr.Solution:
    return mr.solve(ROBOT, ROBOT.inputs(displacement=displacement, tip_force=force, **more), solver=PRECISE).raise_if_failed()


@pytest.fixture(scope="module")
def solution() -> mr.Solution:
    return solved()


def unloaded(robot: mr.SingleRod, **given: object) -> mr.Solution:
    """Without a force: beside another under one, so that its kernel is one that other tests need too."""
    inputs = robot.inputs(tip_force=[(0.0, 0.0, 0.0), FORCE], **given)
    return mr.solve(robot, inputs, solver=PRECISE)[0]


def by_tension(robot: mr.SingleRod) -> mr.SingleRod:
    """The same robot, whose lines are driven by their tensions."""
    (rod,) = robot.rods
    lines = [
        mr.Tendon(offset=o, route=r, end=e)
        for o, r, e in (((R, 0), None, None), ((-0.004, 0.007), None, 0.14), (None, helix, None))
    ]
    return mr.SingleRod(mr.Rod(**OWN, **FIRM, precurvature=rod.sections[0].precurvature, lines=lines))


# ---- displacement ----


def test_one_line_bends_a_rod_into_an_arc() -> None:
    # its length is L - q = L (1 - r kappa), whatever holds it; the moment is T r
    for line in (mr.Tendon(offset=(R, 0), driven="displacement"), mr.PushRod(offset=(R, 0))):
        robot = mr.SingleRod(mr.Rod(**OWN, lines=[line]))
        q = 0.004
        found = mr.solve(robot, robot.inputs(displacement=[q]), solver=PRECISE).raise_if_failed()
        kappa = q / (R * LENGTH)
        tip = np.array([1 - np.cos(kappa * LENGTH), 0, np.sin(kappa * LENGTH)]) / kappa
        np.testing.assert_allclose(found.tip_position, tip, atol=1e-11)
        np.testing.assert_allclose(found.tension, [EI * kappa / R], rtol=1e-9)
        np.testing.assert_allclose(found.line_length, [LENGTH - q], rtol=1e-12)


def test_a_push_rod_pushes_where_a_tendon_is_slack() -> None:
    robots = [
        mr.SingleRod(mr.Rod(**OWN, lines=[line(offset=(R, 0), **how)]))
        for line, how in ((mr.PushRod, {}), (mr.Tendon, {"driven": "displacement"}))
    ]
    rod, tendon = (mr.solve(robot, robot.inputs(displacement=[-0.004]), solver=PRECISE).raise_if_failed() for robot in robots)
    np.testing.assert_allclose(rod.tension, [-EI * 0.004 / (R * LENGTH) / R], rtol=1e-9)
    assert not rod.slack.any()
    assert tendon.slack.all()
    assert tendon.tension == [0.0]
    np.testing.assert_allclose(tendon.tip_position, (0, 0, LENGTH), atol=1e-14)


def test_tensions_that_were_found_drive_the_same_robot_to_the_same_place(solution: mr.Solution) -> None:
    twin = by_tension(ROBOT)
    other = mr.solve(twin, twin.inputs(tension=solution.tension, tip_force=FORCE), solver=PRECISE).raise_if_failed()
    assert (solution.tension > 0.05).all()
    np.testing.assert_allclose(other.tip_position, solution.tip_position, atol=1e-11)
    np.testing.assert_allclose(other.line_length, solution.line_length, rtol=1e-11)


def test_lengths_are_what_is_left_of_those_at_rest(solution: mr.Solution) -> None:
    # (L7), with the length at rest that the unloaded robot says
    rest = unloaded(ROBOT).line_length
    given = np.array([40.0, np.inf, 60.0])
    np.testing.assert_allclose(solution.line_length, rest - PULL + rest / given * solution.tension, rtol=1e-11)
    np.testing.assert_allclose(ROBOT.rods[0].lines[2].length_at_rest(ROBOT.rods[0].sections), rest[2], rtol=1e-11)


def test_a_length_at_rest_is_that_of_the_route_in_each_section() -> None:
    # bent by 3 per metre, and from a kink within the second section on by 20 per square metre
    stiffness = {"bending_stiffness": EI, "torsional_stiffness": GJ}
    rod = mr.Rod(
        sections=[
            mr.Section(length=0.08, precurvature=(0, 3, 0), **stiffness),
            mr.Section(length=0.12, precurvature=lambda s: (0, 20 * max(0.0, s - 0.0467), 0), **stiffness),
        ],
        lines=[mr.Tendon(offset=(0.006, 0), driven="displacement")],
    )
    exact = 0.2 - 0.006 * (3 * 0.08 + 20 * (0.12 - 0.0467) ** 2 / 2)
    np.testing.assert_allclose(rod.lines[0].length_at_rest(rod.sections), exact, atol=1e-13)


def test_a_rest_length_is_that_without_tension() -> None:
    def robot(**more) -> mr.SingleRod:
        line = mr.Tendon(offset=(R, 0), driven="displacement", axial_stiffness=40.0, **more)
        return mr.SingleRod(mr.Rod(**OWN, lines=[line, mr.Tendon(offset=(0, R), driven="displacement")]))

    (straight,) = {robot().rods[0].length.item()}
    for rest in (straight, straight - 0.003):
        found = unloaded(robot(rest_length=rest), displacement=(0.004 - straight + rest, 0.002))
        # the arc takes r^2 L/EI, the line its own length over EA
        np.testing.assert_allclose(found.tension[0], 0.004 / (R**2 * LENGTH / EI + rest / 40), rtol=1e-9)


def test_derivatives_are_those_of_differences(solution: mr.Solution) -> None:
    pose, lengths, step = solution.jacobian("displacement"), solution.jacobian("displacement", of="line_length"), 1e-5
    compliance, by_force = solution.jacobian("tip_force"), solution.jacobian("tip_force", of="line_length")
    for k in range(3):
        away = np.eye(3)[k] * step
        ahead, behind = solved(PULL + away), solved(PULL - away)
        np.testing.assert_allclose(pose[:3, k], (ahead.tip_position - behind.tip_position) / (2 * step), rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(lengths[:, k], (ahead.line_length - behind.line_length) / (2 * step), rtol=1e-5, atol=1e-6)
        ahead, behind = solved(force=FORCE + away), solved(force=FORCE - away)
        np.testing.assert_allclose(
            compliance[:3, k], (ahead.tip_position - behind.tip_position) / (2 * step), rtol=1e-5, atol=1e-8
        )
        np.testing.assert_allclose(by_force[:, k], (ahead.line_length - behind.line_length) / (2 * step), rtol=1e-5, atol=1e-8)


def test_who_pulls_a_line_out_does_the_work_that_the_robot_gains(solution: mr.Solution) -> None:
    step = 1e-5
    for k in range(3):
        ahead, behind = (solved(PULL + sign * step * np.eye(3)[k]).potential for sign in (1, -1))
        np.testing.assert_allclose((ahead - behind) / (2 * step), solution.tension[k], rtol=1e-5)


def test_what_is_slack_is_longer_than_it_needs_and_what_is_taut_is_not() -> None:
    rng = np.random.default_rng(5)
    pulls, forces = rng.uniform(-0.003, 0.005, (60, 3)), 0.4 * rng.normal(size=(60, 3))
    found = mr.solve(ROBOT, ROBOT.inputs(displacement=pulls, tip_force=forces)).raise_if_failed()
    rest = unloaded(ROBOT).line_length
    left = rest - pulls
    stretched = left + rest / np.array([40.0, np.inf, 60.0]) * found.tension
    assert 0.1 < found.slack.mean() < 0.6
    assert (found.tension[found.slack] == 0).all()
    assert (found.tension[~found.slack] >= 0).all()
    assert (found.line_length[found.slack] < left[found.slack]).all()
    # the tolerance of the residual, in lengths
    np.testing.assert_allclose(found.line_length[~found.slack], stretched[~found.slack], atol=1e-9)
    assert (found.index == 0).all()
    alone = [mr.solve(ROBOT, ROBOT.inputs(displacement=pulls[k], tip_force=forces[k])) for k in (0, 7)]
    for k, one in zip((0, 7), alone, strict=True):
        np.testing.assert_array_equal(one.unknowns, found.unknowns[k])


def test_of_antagonists_that_do_not_stretch_one_goes_slack() -> None:
    lines = [mr.Tendon(offset=(R * np.cos(a), R * np.sin(a)), driven="displacement") for a in np.arange(4) * np.pi / 2]
    robot = mr.SingleRod(mr.Rod(**OWN, lines=lines))
    rng = np.random.default_rng(3)
    pair, force = rng.uniform(-0.004, 0.004, (80, 2)), 0.3 * rng.normal(size=(80, 3))
    pulls = np.concatenate([pair, -pair - rng.uniform(0, 0.002, (80, 2))], axis=1)
    found = mr.solve(robot, robot.inputs(displacement=pulls, tip_force=force)).raise_if_failed()
    gaps = found.line_length - (LENGTH - pulls)
    assert (gaps < 1e-9).all()
    assert (gaps[found.slack] < 0).all()
    np.testing.assert_allclose(gaps[~found.slack], 0, atol=1e-9)
    assert not (found.tension[found.slack] != 0).any()
    # in one plane both at once would leave the rod no room
    assert (found.slack[:, :2] | found.slack[:, 2:]).all()


def test_a_tracker_and_an_observer_follow_displacements(solution: mr.Solution) -> None:
    motion = [PULL + 1e-4 * np.sin(0.3 * k) * np.array([1, 0.5, -1]) for k in range(12)]
    tracker = mr.Tracker(ROBOT, dt=0.005, inputs=ROBOT.inputs(displacement=motion[0], tip_force=FORCE))
    for pull in motion:
        sample = tracker.step(displacement=pull)
        assert not sample.status.failed
    np.testing.assert_allclose(sample.tip_position, solved(motion[-1]).tip_position, atol=1e-8)
    observed = mr.solve(ROBOT, ROBOT.inputs(displacement=PULL, tip_force=FORCE), solver=mr.Observer()).raise_if_failed()
    np.testing.assert_allclose(observed.tip_position, solution.tip_position, atol=1e-7)


def test_observers_of_each_line_and_the_rod_follow_from_rest() -> None:
    """A motion at 200 Hz: there after half a second, and with feed-forward nearer by far."""
    time = 0.005 * np.arange(241)
    motion = PULL + 1e-3 * np.sin(2 * time[:, None] + np.arange(3))
    inputs = ROBOT.inputs(displacement=motion, tip_force=FORCE)
    exact = mr.simulate(ROBOT, inputs, time=time).raise_if_failed()
    names = [block.name for block in ROBOT.problem(inputs[0], integrator=mr.RK45()).blocks]
    assert names == ["line 1", "line 2", "line 3", "rod 1"]
    errors = []
    for feed_forward in (False, True):
        found = mr.simulate(ROBOT, inputs, time=time, solver=mr.Observer(coupling="per-rod", feed_forward=feed_forward))
        assert (found.status == mr.Status.TRACKING).all()
        errors.append(np.linalg.norm(found.tip_position - exact.tip_position, axis=1))
    late = np.array(errors)[:, 100:]
    assert late[0].max() < 0.1 * errors[0][0]
    assert late[1].mean() < late[0].mean() / 50


def test_single_precision_is_as_near_as_its_digits(solution: mr.Solution) -> None:
    inputs = ROBOT.inputs(displacement=PULL, tip_force=FORCE)
    found = mr.solve(ROBOT, inputs, solver=mr.Shooting(integrator=mr.RK45(1e-5, 1e-7, precision="float32"))).raise_if_failed()
    # 24 bits, and as much as tensions and moment multiply them by
    np.testing.assert_allclose(found.tip_position, solution.tip_position, atol=1e-5 * LENGTH)
    np.testing.assert_allclose(found.tension, solution.tension, rtol=1e-3)


def test_a_robot_whose_lines_have_lengths_survives_a_copy(solution: mr.Solution) -> None:
    robot = pickle.loads(pickle.dumps(ROBOT))
    found = mr.solve(robot, robot.inputs(displacement=PULL, tip_force=FORCE), solver=PRECISE)
    np.testing.assert_array_equal(found.tip_position, solution.tip_position)


@pytest.mark.parametrize("translation", [0.03, -0.04])
def test_a_rod_that_is_pushed_takes_its_lines_along(translation: float) -> None:
    """As one that was built longer or shorter: a line is longer at rest by what was pushed out of the base."""

    def robot(length: float, compliance: float) -> mr.SingleRod:
        lines = [
            mr.Tendon(offset=(R, 0), driven="displacement", axial_stiffness=1 / compliance),
            mr.Tendon(offset=(-0.004, 0.007), driven="displacement"),
            mr.Tendon(route=lambda s: (0.001 + 0 * s, -0.006 + 0 * s), driven="displacement", axial_stiffness=1 / compliance),
        ]
        return mr.SingleRod(mr.Rod(**(OWN | {"length": length}), **FIRM, precurvature=(1.0, -0.5, 0.3), lines=lines))

    pull, pushed = (0.004, 0.003, -0.002), robot(LENGTH, 1 / 40)

    def at(t: float) -> mr.Solution:
        inputs = pushed.inputs(displacement=pull, tip_force=FORCE, translation=t)
        return mr.solve(pushed, inputs, solver=PRECISE).raise_if_failed()

    solution = at(translation)
    # what stretches is all of the tendon, also what is behind the base
    built = robot(LENGTH + translation, LENGTH / (LENGTH + translation) / 40)
    twin = mr.solve(built, built.inputs(displacement=pull, tip_force=FORCE), solver=PRECISE).raise_if_failed()
    np.testing.assert_allclose(solution.tip_position, twin.tip_position, atol=1e-11)
    np.testing.assert_allclose(solution.tension, twin.tension, rtol=1e-8, atol=1e-10)
    step = 1e-6
    ahead, behind = at(translation + step), at(translation - step)
    slope = (ahead.tip_position - behind.tip_position) / (2 * step)
    np.testing.assert_allclose(solution.jacobian("translation")[:3, 0], slope, atol=1e-8)
    longer = (ahead.line_length - behind.line_length) / (2 * step)
    np.testing.assert_allclose(solution.jacobian("translation", of="line_length")[:, 0], longer, atol=1e-8)


# ---- push rods ----


@pytest.mark.parametrize("axial", [None, 500.0])
def test_stiff_push_rods_share_the_bending_of_an_arc(axial: float | None) -> None:
    # two beside the backbone: each is an arc of its own radius, and its own length stretches it
    own, EA, offsets, pull = 0.004, 800.0, np.array([R, -0.5 * R]), np.array([0.003, -0.002])
    lines = [mr.PushRod(offset=(x, 0), bending_stiffness=own, axial_stiffness=EA) for x in offsets]
    more = {} if axial is None else {"shear_stiffness": 200.0, "axial_stiffness": axial}
    robot = mr.SingleRod(mr.Rod(**OWN, lines=lines, **more))
    found = unloaded(robot, displacement=pull).raise_if_failed()

    def slopes(x):
        kappa, e = x
        m = 1 + e - kappa * offsets
        tension = EA * (m - 1 + pull / LENGTH)
        moment = EI * kappa + (own * (kappa / m + kappa**2 * offsets / (2 * m**2)) - tension * offsets).sum()
        force = e if axial is None else axial * e + (tension - own * kappa**2 / (2 * m**2)).sum()
        return moment, force

    kappa, e = fsolve(slopes, (found.rod(0).curvature[0, 1], 0.0), xtol=1e-13)
    m = 1 + e - kappa * offsets
    np.testing.assert_allclose(found.rod(0).curvature[:, 1], kappa, rtol=1e-9)
    np.testing.assert_allclose(found.line_length, LENGTH * m, rtol=1e-10)
    np.testing.assert_allclose(found.tension, EA * (m - 1 + pull / LENGTH), rtol=1e-7)
    bent = EI * kappa**2 / 2 + (own * kappa**2 / (2 * m)).sum() + (0 if axial is None else axial * e**2 / 2)
    np.testing.assert_allclose(found.energy, bent * LENGTH, rtol=1e-9)


@pytest.mark.parametrize("more", [{}, {"shear_stiffness": 60.0, "axial_stiffness": 200.0}], ids=["stiff", "shear"])
def test_stiff_push_rods_have_exact_derivatives_and_the_energy_that_loads_leave(more: dict[str, float]) -> None:
    lines = [mr.PushRod(offset=o, bending_stiffness=0.006, axial_stiffness=600.0) for o in ((R, 0.001), (-0.003, -R))]
    robot = mr.SingleRod(mr.Rod(**OWN, lines=lines, **more))
    pull, force, step = np.array([0.002, -0.003]), np.array([0.5, -0.8, 0.3]), 1e-4

    def at(force: np.ndarray) -> mr.Solution:
        return mr.solve(robot, robot.inputs(displacement=pull, tip_force=force), solver=PRECISE).raise_if_failed()

    found = at(force)
    compliance = found.jacobian("tip_force")[:3]
    for k, away in enumerate(step * np.eye(3)):
        ahead, behind = at(force + away), at(force - away)
        slope = (ahead.tip_position - behind.tip_position) / (2 * step)
        np.testing.assert_allclose(compliance[:, k], slope, atol=1e-6 * np.abs(compliance).max())
        # what a dead force leaves of the potential is less the way of the tip
        np.testing.assert_allclose((ahead.potential - behind.potential) / (2 * step), -found.tip_position[k], atol=1e-7)
    np.testing.assert_allclose(compliance, compliance.T, atol=1e-8 * np.abs(compliance).max())


def test_more_push_rods_than_lengths_determine_are_refused() -> None:
    three = [mr.PushRod(offset=(R * np.cos(a), R * np.sin(a))) for a in (0, 2.1, 4.2)]
    with pytest.raises(ValueError, match=r"PushRod\.axial_stiffness = inf is not allowed: must be finite: 3 push rods"):
        mr.Rod(**OWN, lines=three)
    with pytest.raises(ValueError, match="2 push rods beside each other"):
        mr.Rod(**OWN, lines=[mr.PushRod(offset=(R, 0)), mr.PushRod(offset=(-R, 0))])
    assert mr.Rod(**OWN, **SOFT, lines=three).lines
    assert mr.Rod(**OWN, lines=[mr.PushRod(offset=(R, 0)), mr.PushRod(offset=(0, R))]).lines


# ---- discs ----


def between_discs(count: int, tension: float, parts: int = 16) -> np.ndarray:
    """Tip (x, z) of a rod in its plane whose tendon runs straight between discs: least energy of a chain of short pieces."""
    ds = LENGTH / count / parts
    walk = np.tril(np.ones((count * parts, count * parts))) * ds

    def energy(kappa):
        # angle at the middle of a piece, positions at its ends, the line where discs are
        angle = walk @ kappa
        middle = angle - kappa * ds / 2
        x, z = (np.concatenate([[0.0], np.cumsum(f(middle)) * ds]) for f in (np.sin, np.cos))
        turned = np.concatenate([[0.0], angle])
        at = slice(None, None, parts)
        line = np.column_stack([x + R * np.cos(turned), z - R * np.sin(turned)])[at]
        return EI / 2 * (kappa**2).sum() * ds + tension * np.linalg.norm(np.diff(line, axis=0), axis=1).sum(), (x[-1], z[-1])

    def slope(kappa):
        step = 1e-4
        return np.array([(energy(kappa + e)[0] - energy(kappa - e)[0]) / (2 * step) for e in step * np.eye(len(kappa))])

    start = np.full(count * parts, tension * R / EI)
    stiff = EI * ds * np.eye(len(start))
    for _ in range(12):  # the bending is most of the second derivative: fixed point
        start = start - np.linalg.solve(stiff, slope(start))
    return np.array(energy(start)[1])


def test_a_tendon_runs_straight_between_discs() -> None:
    tension, count = 4.0, 8
    lines = [mr.Tendon(offset=(R, 0))]
    near = mr.SingleRod(mr.Rod(**OWN, lines=lines))
    # two more that hang loose, so that the kernel is one that other tests need too
    loose = [mr.Tendon(offset=(-R, y), driven="displacement", axial_stiffness=300.0) for y in (-0.004, 0.004)]
    spaced = mr.SingleRod(mr.Rod(**OWN, lines=lines + loose, discs=LENGTH / count))
    ignored = unloaded(near, tension=[tension]).raise_if_failed()
    found = unloaded(spaced, tension=[tension], displacement=(-0.02, -0.02)).raise_if_failed()
    assert found.slack.tolist() == [False, True, True]
    # in the plane, (L11) is a root
    k = (LENGTH / count) ** 2 / 24
    kappa = brentq(lambda u: EI * u - tension * (R * (1 - k * u**2) + 2 * k * u * (1 - R * u)), 0, 10)
    np.testing.assert_allclose(found.rod(0).curvature[:, 1], kappa, rtol=1e-9)
    np.testing.assert_allclose(found.line_length[0], LENGTH * (1 - R * kappa) * (1 - k * kappa**2), rtol=1e-10)
    # and the rod with real discs is nearer to it by far than to the line that follows the rod
    real = between_discs(count, tension)
    off, left = (np.linalg.norm(one.tip_position[[0, 2]] - real) for one in (ignored, found))
    assert left < 0.02 * off


def test_lines_between_discs_have_exact_derivatives_and_no_energy_of_their_own() -> None:
    lines = [mr.Tendon(route=helix), mr.Tendon(offset=(-R, 0.002)), mr.Tendon(offset=(0.001, R), start=0.03)]
    robot = mr.SingleRod(mr.Rod(**OWN, **SOFT, precurvature=(1.0, -0.5, 0.3), lines=lines, discs=0.03))
    tension = np.array([1.0, 2.0, 1.5])

    def at(part: float) -> mr.Solution:
        return unloaded(robot, tension=part * tension).raise_if_failed()

    whole = at(1.0)
    by_tension = whole.jacobian("tension", of="line_length")
    np.testing.assert_allclose(by_tension, by_tension.T, atol=1e-11 * np.abs(by_tension).max())
    nodes, weights = np.polynomial.legendre.leggauss(12)
    done = 0.0
    for node, weight in zip((1 + nodes) / 2, weights / 2, strict=True):
        found = at(node)
        done -= weight * found.tension @ found.jacobian("tension", of="line_length") @ tension
    np.testing.assert_allclose(whole.energy, done, rtol=1e-10)
    # pushed in, where the routes go on: at zero they turn a corner
    there = {"tip_force": np.array([0.1, 0.0, 0.2]), "translation": np.array([-0.01])}
    moved = mr.solve(robot, robot.inputs(tension=tension, **there), solver=PRECISE).raise_if_failed()
    for name, step in (("tip_force", 1e-4), ("translation", 1e-5)):
        pose = moved.jacobian(name)
        for k in range(pose.shape[1]):
            away = np.eye(pose.shape[1])[k] * step
            inputs = [robot.inputs(tension=tension, **{**there, name: there[name] + sign * away}) for sign in (1, -1)]
            ahead, behind = (mr.solve(robot, one, solver=PRECISE).tip_position for one in inputs)
            np.testing.assert_allclose(pose[:3, k], (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-7)
    with pytest.raises(ValueError, match=r"tension = .* together: between discs the rod buckles"):
        robot.inputs(tension=(50, 50, 50))
    with pytest.raises(ValueError, match="between discs the rod buckles"):
        mr.Tracker(robot, dt=0.005, inputs=robot.inputs(tension=tension, tip_force=FORCE)).step(tension=(50, 50, 50))


def test_a_displacement_beyond_what_a_line_can_do_says_so() -> None:
    """Where a tenth of its length is left, or its tension buckles the rod between discs."""
    spacing = 0.05
    for discs, most in ((None, 0.9 * LENGTH), (spacing, None)):
        rod = mr.Rod(**OWN, lines=[mr.Tendon(offset=(R, 0), driven="displacement")], discs=discs)
        robot = mr.SingleRod(rod)
        displacement = np.linspace(0.02, 0.1, 9) if most is None else most * np.array([0.97, 1.02, 1.3])
        solution = mr.solve(robot, robot.inputs(displacement=displacement[:, None], tip_force=(0, 0.01, 0)))
        failed = np.array([status == mr.Status.LINE_LIMIT for status in solution.status])
        assert (solution.status[~failed] == mr.Status.CONVERGED).all()
        assert failed.any()
        assert not failed.all()
        assert (np.diff(failed.astype(int)) >= 0).all()
        assert np.isnan(solution.tension[failed]).all()
        if most is None:
            tension = solution.tension[~failed, 0]
            # the next step would have been too far: they rise by less than that from one to the next
            assert tension.max() < np.pi**2 * EI / spacing**2 < tension.max() + 2 * np.diff(tension)[-1]
        else:
            assert failed.tolist() == [False, True, True]
    loop = mr.Tracker(robot, dt=0.005, inputs=robot.inputs(displacement=0.02, tip_force=(0, 0.01, 0)))
    assert loop.step().status == mr.Status.CONVERGED
    assert loop.step(displacement=displacement[failed][0]).status == mr.Status.LINE_LIMIT


def test_displacements_that_cannot_all_be_say_so() -> None:
    """Two tendons that do not stretch, opposite each other, cannot both be pulled."""
    lines = [mr.Tendon(offset=(sign * R, 0), driven="displacement") for sign in (1, -1)]
    robot = mr.SingleRod(mr.Rod(**OWN, lines=lines))
    pulls = np.array([(5e-4, 5e-4), (1e-3, -5e-4), (1e-3, -2e-3), (3e-3, 1e-3)])
    found = mr.solve(robot, robot.inputs(displacement=pulls, tip_force=(0.1, 0.05, 0)))
    assert (found.status == mr.Status.CONVERGED).tolist() == [False, False, True, False]
    assert (found.status[[0, 1, 3]] == mr.Status.LINES_TOO_SHORT).all()
    assert found.slack.tolist() == [[None, None], [None, None], [True, True], [None, None]]
    assert not found[0].slack.any()


# ---- where all lines are exactly as long as the bent rod has them ----

COMMANDS = np.linspace(0.0, 0.006, 5)[:, None]
IN_PLANE, ACROSS = (0.05, 0.0, 0.0), (0.05, 0.02, 0.0)


def around(count: int, turn: float = 0.0) -> tuple[mr.SingleRod, np.ndarray]:
    """Tendons around a rod that do not stretch, and the law by which they bend it."""
    angles = 2 * np.pi * np.arange(count) / count
    lines = [mr.Tendon(offset=(R * np.cos(a), R * np.sin(a)), driven="displacement") for a in angles]
    return mr.SingleRod(mr.Rod(**OWN, lines=lines)), COMMANDS * np.cos(angles - turn)


@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_tendons_pulled_and_let_out_by_the_law_bend_in_arcs(count: int, turn: float) -> None:
    robot, displacement = around(count, turn)
    curvature = COMMANDS[:, 0] * (np.cos(turn) if count == 2 else 1.0) / (LENGTH * R)
    inputs = robot.inputs(displacement=displacement)
    solution = mr.solve(robot, inputs).raise_if_failed()
    assert solution.integrations.max() < 200  # what creeps to the kink, and the way with a hair
    motion = mr.simulate(robot, inputs, time=0.1 * np.arange(len(COMMANDS)))
    loop = mr.Tracker(robot, dt=0.1, inputs=inputs[0])
    steps = [loop.step(displacement=row) for row in displacement]
    chord = LENGTH * np.sinc(curvature * LENGTH / 2 / np.pi)
    for found in (solution, motion):
        assert (found.status == mr.Status.CONVERGED).all()
        np.testing.assert_allclose(np.linalg.norm(found.tip_position, axis=1), chord, rtol=1e-9)
        # the least that hold it: no tension in all together
        np.testing.assert_allclose(found.tension, solution.tension, atol=1e-6)
        assert (found.tension.min(axis=1) < 1e-6).all()
    assert [step.status for step in steps] == [mr.Status.CONVERGED] * len(COMMANDS)
    np.testing.assert_allclose([step.tip_position for step in steps], solution.tip_position, atol=1e-9)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_tendons_by_the_law_under_loads(count: int) -> None:
    """In their plane there is an equilibrium; one that twists the rod wants a hair of slack, or no tensions are enough."""
    robot, displacement = around(count)
    loaded = mr.solve(robot, robot.inputs(displacement=displacement, tip_force=IN_PLANE)).raise_if_failed()
    assert (loaded.status == mr.Status.CONVERGED).all()
    np.testing.assert_allclose(loaded.line_length, LENGTH - displacement, atol=1e-10)
    robot, displacement = around(count, 0.4)
    hair = 1e-6 * LENGTH
    exact = mr.solve(robot, robot.inputs(displacement=displacement[1:], tip_force=ACROSS))
    looser = mr.solve(robot, robot.inputs(displacement=displacement[1:] - hair, tip_force=ACROSS)).raise_if_failed()
    assert (exact.status == mr.Status.LINES_TOO_SHORT).all()
    assert (looser.status == mr.Status.CONVERGED).all()
    assert looser.tension.max() < 10.0
    assert (LENGTH - displacement[1:] + hair - looser.line_length > -1e-10).all()


@pytest.mark.parametrize("count", [2, 3, 4])
def test_lines_at_their_kinks_are_let_out_first(count: int) -> None:
    """(L8c) Displacements that sum to zero: 100 integrations and more, where the way of the loads ended first."""
    angles = 2 * np.pi / count * np.arange(count)
    random = np.random.default_rng(2)
    moved = 2e-3 * random.uniform(0.3, 1, (8, 1)) * np.cos((random.uniform(0, 6, (8, 1)) if count > 2 else 0) - angles)
    found = []
    for axial in (None, 1e7):
        lines = [mr.Tendon((6e-3 * np.cos(a), 6e-3 * np.sin(a)), driven="displacement", axial_stiffness=axial) for a in angles]
        robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.006, torsional_stiffness=0.0046, lines=lines))
        found.append(mr.solve(robot, robot.inputs(displacement=moved), progress=False).raise_if_failed())
    assert found[0].integrations.max() <= 45
    np.testing.assert_allclose(found[0].tip_position, found[1].tip_position, atol=2e-6)
    assert (found[0].stability == mr.Stability.STABLE).all()


def test_a_motion_past_kinks_takes_few_integrations() -> None:
    """(L8e) Stiff tendons whose tensions are thousands of those that bend: Gamma jumps by as much."""
    angles = 2 * np.pi * np.arange(3) / 3
    lines = [mr.Tendon(offset=(R * np.cos(a), R * np.sin(a)), driven="displacement", axial_stiffness=1e5) for a in angles]
    robot = mr.SingleRod(mr.Rod(**OWN, lines=lines))
    time = 0.01 * np.arange(110)[:, None]
    motion = 0.002 * np.cos(3 * time - angles) + 0.0004 * np.cos(9 * time)
    loop = mr.Tracker(robot, dt=0.01, inputs=robot.inputs(displacement=motion[0]))
    steps = [loop.step(displacement=row) for row in motion]
    assert not any(step.status.failed for step in steps)
    slack = np.array([step.slack for step in steps])
    crossed = 1 + np.flatnonzero((slack[1:] != slack[:-1]).any(axis=1))
    assert len(crossed) >= 3  # the motion is meant to cross
    assert max(step.integrations for step in steps[1:]) < 15  # 3; without (L8e) 186, by quadratic extrapolation 15
    again = mr.solve(robot, robot.inputs(displacement=motion[crossed])).raise_if_failed()
    np.testing.assert_array_equal(again.slack, slack[crossed])
    # the tolerance of the residual, over the stiffness of what is taut
    np.testing.assert_allclose([steps[k].tip_position for k in crossed], again.tip_position, atol=1e-8)


def test_which_jumps_of_gamma_a_branch_passes() -> None:
    """(L8e) One line that becomes taut: the branch goes on where the determinant keeps its sign, and ends where it does not."""
    last = np.array([[2.0, 0.5, 0.0], [0.3, 1.0, 0.0], [0.7, -0.4, 1.0]])
    for size, passed in ((300.0, True), (-300.0, False)):
        taut = last.copy()
        taut[:, 2] = (5.0, -2.0, size)
        assert follows(last, taut, np.array([2])) is passed
    other = taut @ np.diag([-1.0, 1.0, -1.0])  # another mode has changed its sign beside
    assert np.linalg.det(other) * np.linalg.det(last) < 0
    assert not follows(last, other, np.array([2]))
    # two at once, each of which could alone, and that take each other's room: (1, 2; 2, 1) is no P-matrix
    both = np.eye(2)
    assert follows(both, np.array([[1.0, 0.2], [0.2, 1.0]]), np.arange(2))
    assert not follows(both, np.array([[1.0, 2.0], [2.0, 1.0]]), np.arange(2))


def test_commands_without_slack_at_rest() -> None:
    """All at zero, or one pair pulled as the other: what loads leave of it, and what cannot be."""
    robot, _ = around(4)
    pulls = np.array([(0, 0, 0, 0), (0, 0, 0, 0), (0.001, 0.001, -0.001, -0.001), (-0.002, 0, -0.002, 0), (0.002, 0, 0.002, 0)])
    forces = np.array([IN_PLANE, (0, 0, -0.2), (0, 0, 0), (0, 0, 0), (0, 0, 0)])
    found = mr.solve(robot, robot.inputs(displacement=pulls, tip_force=forces))
    assert [mr.Status(status).name for status in found.status] == ["CONVERGED"] * 4 + ["LINES_TOO_SHORT"]
    np.testing.assert_allclose(found.tension[1:4].max(axis=1), [0, EI * 0.001 / (LENGTH * R**2), 0], atol=1e-6)


# ---- stability ----


def test_lines_that_are_held_keep_a_column_from_buckling() -> None:
    EA = 30.0
    lines = [mr.Tendon(offset=(sign * R, 0), driven="displacement", axial_stiffness=EA) for sign in (1, -1)]
    robot = mr.SingleRod(mr.Rod(**OWN, lines=lines))
    # two lines are a torsional spring on the tip, k, in their plane: x cot x = -k L/EI; in the other, nothing holds it
    k = 2 * EA * R**2 / LENGTH
    x = brentq(lambda x: x / np.tan(x) + k * LENGTH / EI, np.pi / 2 + 1e-9, np.pi - 1e-9)
    loads = np.array([np.pi**2 / 4, x**2]) * EI / LENGTH**2

    def at(load: float, guess: mr.Solution | None = None) -> mr.Solution:
        inputs = robot.inputs(displacement=(0.001, 0.001), tip_force=(0, 0, -load))
        return mr.solve(robot, inputs, guess=guess).raise_if_failed()

    straight = at(0.9 * loads[0])
    np.testing.assert_allclose(straight.tension, EA * 0.001 / LENGTH, rtol=1e-9)
    indices = [at(part * load, straight).index for load in loads for part in (0.999, 1.001)]
    assert indices == [0, 1, 1, 2]
    assert abs(at(0.999 * loads[0]).stability_margin) < 0.01


def test_a_column_buckles_between_lines_that_hold_it_in_one_plane_and_beside_slack_ones() -> None:
    # bent across the plane of two lines it keeps their lengths, and so it does beside slack ones: an elastica alone
    lines = [mr.Tendon(offset=(sign * R, 0), driven="displacement", axial_stiffness=30.0) for sign in (1, -1)]
    robot = mr.SingleRod(mr.Rod(**OWN, lines=lines))
    load = 1.3
    root = np.pi / 2 * np.sqrt(load)
    modulus = brentq(lambda k: ellipk(k * k) - root, 1e-6, 1 - 1e-9)
    force = (0, 0, -load * np.pi**2 / 4 * EI / LENGTH**2)
    found = mr.solve(robot, robot.inputs(displacement=[(0.001, 0.001), (-0.05, -0.05)], tip_force=force)).raise_if_failed()
    assert (found.status == mr.Status.BIFURCATED).all()
    deflection = np.linalg.norm(found.tip_position[:, :2], axis=1)
    np.testing.assert_allclose(deflection, 2 * modulus / root * LENGTH, atol=1e-6 * LENGTH)
    np.testing.assert_allclose(found.tip_position[0, 0], 0, atol=1e-8 * LENGTH)
    np.testing.assert_array_equal(found.slack, [[False, False], [True, True]])
    # beside slack lines a round column may go to any side
    assert found.stability.tolist() == [mr.Stability.STABLE, mr.Stability.FOLD]
    ((taut,), (slack,)) = found.events
    assert (taut.neutral, slack.neutral) == (0, 1)
    # a little early by step control
    np.testing.assert_allclose([taut.load_factor, slack.load_factor], 1 / load, rtol=1e-3)


def test_a_route_counts_only_where_its_line_is() -> None:
    # a polynomial has no bounds beyond its piece: it would warn of an offset in metres, and make all steps tiny
    winding = mr.Tendon(route=lambda s: (0.003 * np.cos(150 * s), 0.003 * np.sin(150 * s)), start=0.08, end=0.14)
    (line,) = mr.Rod(**OWN, lines=[winding]).lines
    for place, here in ((0.02, False), (0.1, True), (0.18, False)):
        coefficients = line.polynomials(place)[2]
        assert coefficients.any() == here
        assert np.abs(coefficients).max() < 0.004


def test_columns_that_do_not_tell_the_tip_leave_stability_unknown() -> None:
    one = np.zeros((1, 1, 3, 3))
    columns = NodeColumns(np.array([[0.2]]), one, np.ones((1, 3, 3)), np.array([[0.2]]))
    form = CondensedForm(np.eye(3)[None], np.zeros(1, dtype=np.int32), np.ones(1, dtype=bool))
    line = NodeColumns(np.array([[0.2]]), one[..., :1], np.ones((1, 3, 1)), np.array([[0.2]]))
    found = with_conditions(form, columns, line, np.ones((1, 1, 3)), -np.ones((1, 1, 1)), np.ones((1, 1), dtype=bool))
    assert not found.known[0]


def test_inextensible_push_rods_keep_a_column_straight_up_to_four_times_the_load() -> None:
    # its tip cannot turn: pi^2 EI/L^2
    robot = mr.SingleRod(mr.Rod(**OWN, lines=[mr.PushRod(offset=(R, 0)), mr.PushRod(offset=(0, R))]))
    critical = np.pi**2 * EI / LENGTH**2
    below = mr.solve(robot, robot.inputs(tip_force=(0, 0, -0.99 * critical))).raise_if_failed()
    above = mr.solve(robot, robot.inputs(tip_force=(0, 0, -1.01 * critical)), guess=below).raise_if_failed()
    assert (below.index, above.index) == (0, 2)
    # the lines hold the tip: what is left to it is the turn about the rod's own axis, which no load touches
    np.testing.assert_allclose(below.stability_margin, 1.0, rtol=1e-6)
    # bent in space they are what stiff ones tend to
    margins = []
    for stiffness in (None, 1e8):
        lines = [mr.PushRod(offset=offset, axial_stiffness=stiffness) for offset in ((R, 0), (0, R))]
        held = mr.SingleRod(mr.Rod(**OWN, lines=lines))
        inputs = held.inputs(displacement=(0.002, -0.001), tip_force=(0.3, 0.2, -0.3))
        margins.append(mr.solve(held, inputs).raise_if_failed().stability_margin)
    np.testing.assert_allclose(*margins, rtol=1e-6)


@pytest.mark.parametrize("stored", ["10e_multibackbone_1", "10e_multibackbone_3"])
def test_three_push_rods_bend_a_section_by_their_lengths_alone(stored: str) -> None:
    """The closed form; one of them stretches, else all three have no tensions of their own."""
    case = json.loads((Path(__file__).parent / "data" / f"{stored}.json").read_text())
    given, expected = case["inputs"], {name: np.array(entry["value"]) for name, entry in case["expected"].items()}
    azimuths = np.array(given["secondary_azimuths"])
    offsets = given["r"] * np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1)
    lines = [
        mr.PushRod(offset, bending_stiffness=given["EI_secondary"], axial_stiffness=stiffness)
        for offset, stiffness in zip(offsets, (None, None, 1e4), strict=True)
    ]
    rod = mr.Rod(
        length=given["L"], bending_stiffness=given["EI_central"], torsional_stiffness=given["EI_central"] / 1.3, lines=lines
    )
    robot = mr.SingleRod(rod)
    found = mr.solve(robot, robot.inputs(displacement=-np.array(given["rod_length_changes"]))).raise_if_failed()
    np.testing.assert_allclose(found.tip_position, expected["tip_position"], atol=1e-9)
    np.testing.assert_allclose(found.tip_rotation, expected["tip_rotation"], atol=1e-9)
    direction = np.array([np.cos(expected["delta"]), np.sin(expected["delta"])])
    np.testing.assert_allclose(found.tension @ offsets @ direction, expected["generalized_bending_moment"], rtol=1e-9)
    assert found.stability == mr.Stability.STABLE


# ---- chambers ----


def test_a_chamber_bends_a_rod_away_from_itself() -> None:
    # in the section: M = P A r exactly; both are the same without shear and twist
    for fixed in ("across", "section"):
        robot = mr.SingleRod(mr.Rod(**OWN, lines=[mr.Chamber(offset=(-R, 0), area=2e-5, area_fixed=fixed)]))
        found = mr.solve(robot, robot.inputs(pressure=[3e5]), solver=PRECISE).raise_if_failed()
        kappa = 3e5 * 2e-5 * R / EI
        tip = np.array([1 - np.cos(kappa * LENGTH), 0, np.sin(kappa * LENGTH)]) / kappa
        np.testing.assert_allclose(found.tip_position, tip, atol=1e-11)
        np.testing.assert_allclose(found.line_length, [LENGTH * (1 + R * kappa)], rtol=1e-10)
        np.testing.assert_allclose(found.tension, [-6.0])


def segment_of_silicone(area: float) -> mr.SingleRod:
    """The segment of docs/recipes.md."""
    angles = np.radians([0, 120, 240])
    chambers = [mr.Chamber(offset=(0.0065 * np.cos(a), 0.0065 * np.sin(a)), area=area) for a in angles]
    made = {"length": 0.1, "outer_diameter": 0.022, "young_modulus": 0.6e6, "poisson_ratio": 0.49, "density": 1080}
    return mr.SingleRod(mr.Rod.tube(**made, extensible=True, lines=chambers))


def test_chambers_lengthen_a_segment_of_silicone() -> None:
    """Straight, three alike and its weight: v_z - 1 = (sum of P A + weight below) / EA."""
    area = 5e-5
    segment = segment_of_silicone(area)
    pressure = np.array([(0, 0, 0), (4e4, 4e4, 4e4), (6e4, 0, 0)])
    found = mr.solve(segment, segment.inputs(pressure=pressure, gravity=(0, 0, 9.81))).raise_if_failed()
    section = np.pi / 4 * 0.022**2
    stretch = (pressure.sum(axis=1) * area / section + 1080 * 9.81 * 0.1 / 2) / 0.6e6
    np.testing.assert_allclose(found.tip_position[:2, 2], 0.1 * (1 + stretch[:2]), rtol=1e-8)
    np.testing.assert_allclose(found.line_length.mean(axis=1), 0.1 * (1 + stretch), rtol=2e-4)  # bent, it hangs less
    # one chamber bends it away: curvature P A r / EI, along a rod of its first length
    turn = 6e4 * area * 0.0065 / (0.6e6 * np.pi / 64 * 0.022**4) * 0.1
    np.testing.assert_allclose(np.arctan2(-found.tip_rotation[2, 0, 2], found.tip_rotation[2, 2, 2]), turn, rtol=0.06)


@pytest.mark.parametrize("part", [0.05, 0.004, 1e-3])
def test_a_short_section_that_pressure_takes_the_stiffness_of_is_not_overlooked(part: float) -> None:
    """(L9b) Soft in torsion, ``GJ = sum of P A r^2``, wherever it is; it was seen where one of 65 places was on it."""
    (section,) = segment_of_silicone(5e-5).rods[0].sections
    stiff = {name: getattr(section, name) for name in ("bending_stiffness", "shear_stiffness", "axial_stiffness")}
    GJ = 0.05 * float(section.torsional_stiffness)
    lengths, torsion = (0.0413, 0.1 * part, 0.0587 - 0.1 * part), (20 * GJ, GJ, 20 * GJ)
    sections = [mr.Section(length=length, torsional_stiffness=own, **stiff) for length, own in zip(lengths, torsion, strict=True)]
    robot = mr.SingleRod(mr.Rod(sections=sections, lines=segment_of_silicone(5e-5).rods[0].lines))
    limit = GJ / (3 * 5e-5 * 0.0065**2)
    found = mr.solve(robot, robot.inputs(pressure=limit * np.repeat([[0.9], [1.2]], 3, axis=1))).raise_if_failed()
    assert list(found.stability) == [mr.Stability.STABLE, mr.Stability.UNSTABLE]


@pytest.mark.parametrize("modes", [2, 12, 22])
def test_modes_of_what_pressure_leaves_little_stiffness_are_all_counted(modes: int) -> None:
    """(7b) of docs/stability.md: a strip beside chambers that leave a thirtieth of its torsional stiffness tips over by as
    many modes as there are zeros of J_-1/4 below F L^2 / (2 sqrt(EI GJ)), Prandtl's, shorter than those of the strip alone."""
    x = np.linspace(0.1, 100, 20001)
    zeros = x[1:][np.diff(np.sign(jv(-0.25, x))) != 0]
    force = (zeros[modes - 1] + zeros[modes]) * np.sqrt(0.5 * 0.02)
    places = [(0.05 * np.cos(angle), 0.05 * np.sin(angle)) for angle in np.radians((0, 120, 240))]
    lines = [mr.Chamber(offset=place, area=1e-3) for place in places]
    strip = mr.SingleRod(mr.Rod(length=1, bending_stiffness=(1e4, 0.5), torsional_stiffness=0.6, lines=lines))
    inputs = strip.inputs(tip_force=(0, force, 0), pressure=0.58 / (3 * 1e-3 * 0.05**2))
    found = mr.solve(strip, inputs, guess=np.zeros(3), solver=STOPS).raise_if_failed()
    assert found.index == modes
    assert found.stability == mr.Stability.UNSTABLE


def test_pressure_beyond_what_a_section_resists_is_unstable() -> None:
    """(L9b) Wide and soft as it is, across it: ``GA = sum of P A/lam``, at the tip ``lam = 1 + sum of P A/EA``. There is an
    equilibrium still, but it is no minimum."""
    area = 5e-5
    segment = segment_of_silicone(area)
    (section,) = segment.rods[0].sections
    GA, EA = section.shear_stiffness[0], section.axial_stiffness
    limit = GA / (3 * area * (1 - GA / EA))
    pressure = limit * np.repeat([[0.99], [1.01]], 3, axis=1)
    found = mr.solve(segment, segment.inputs(pressure=pressure, gravity=(0, 0, 9.81))).raise_if_failed()
    assert found.stability.tolist() == [mr.Stability.STABLE, mr.Stability.UNSTABLE]


def soft() -> mr.SingleRod:
    """A tendon between chambers of both kinds, one of them routed, on a rod that shears."""
    lines = [
        mr.Chamber(route=helix, area=1e-5, area_fixed="section", name="helix"),
        mr.Tendon(offset=(R, 0)),
        mr.Chamber(offset=(-0.004, -0.006), area=2e-5, start=0.03),
    ]
    return mr.SingleRod(mr.Rod(**OWN, **SOFT, lines=lines))


def test_work_of_pressure_and_tension_is_the_energy_that_is_stored() -> None:
    robot = soft()
    pressure, tension = np.array([2e5, 1e5]), 1.5

    def at(part: float) -> mr.Solution:
        return mr.solve(robot, robot.inputs(pressure=part * pressure, tension=[part * tension]), solver=PRECISE).raise_if_failed()

    # dE = -sum of T dl, with T in step with the load: a Gauss rule of the work along the way
    nodes, weights = np.polynomial.legendre.leggauss(12)
    done = 0.0
    for node, weight in zip((1 + nodes) / 2, weights / 2, strict=True):
        found = at(node)
        slopes = (
            found.jacobian("pressure", of="line_length") @ pressure + found.jacobian("tension", of="line_length")[:, 0] * tension
        )
        done -= weight * found.tension @ slopes
    np.testing.assert_allclose(at(1.0).energy, done, rtol=1e-10)


def test_lengths_by_pressures_are_symmetric_and_those_of_differences() -> None:
    robot, step = soft(), 1.0
    pressure = np.array([2e5, 1e5])
    found = mr.solve(robot, robot.inputs(pressure=pressure, tension=[1.5]), solver=PRECISE).raise_if_failed()
    by_pressure, by_tension = found.jacobian("pressure", of="line_length"), found.jacobian("tension", of="line_length")
    # in tensions: dT = -A dP
    all_by_tension = np.column_stack([by_pressure[:, 0] / -1e-5, by_tension[:, 0], by_pressure[:, 1] / -2e-5])
    np.testing.assert_allclose(all_by_tension, all_by_tension.T, atol=1e-11 * np.abs(all_by_tension).max())
    for k in range(2):
        more = [robot.inputs(pressure=pressure + sign * step * np.eye(2)[k], tension=[1.5]) for sign in (1, -1)]
        ahead, behind = (mr.solve(robot, inputs, solver=PRECISE).line_length for inputs in more)
        np.testing.assert_allclose(by_pressure[:, k], (ahead - behind) / (2 * step), rtol=1e-4, atol=1e-13)


# ---- what is refused ----


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match=r"Chamber\.area_fixed = 'none' is not allowed"):
        mr.Chamber(offset=(R, 0), area=1e-5, area_fixed="none")
    with pytest.raises(TypeError, match="Chamber needs area"):
        mr.Chamber(offset=(R, 0))
    with pytest.raises(ValueError, match=r"Tendon\.axial_stiffness = 40\.0 is not allowed"):
        mr.Tendon(offset=(R, 0), axial_stiffness=40.0)
    with pytest.raises(ValueError, match=r"PushRod\.axial_stiffness = -1"):
        mr.PushRod(offset=(R, 0), axial_stiffness=-1)
    with pytest.raises(ValueError, match=r"displacement = .* is not allowed: must have shape"):
        ROBOT.inputs(displacement=(0.1, 0.2))
    with pytest.raises(ValueError, match="pressure = 1.* must not be given: no rod has a line that is driven by it"):
        ROBOT.inputs(pressure=1e5)
    with pytest.raises(ValueError, match=r"translation = .* must be >= 0 m: beyond, the length at rest of line '' varies"):
        ROBOT.inputs(translation=-0.01)
    with pytest.raises(ValueError, match=r"translation = .* must be >= 0 m: beyond, the length at rest of line '' varies"):
        mr.Tracker(ROBOT, dt=0.005, inputs=ROBOT.inputs(displacement=PULL, tip_force=FORCE)).step(translation=-0.01)
    with pytest.raises(ValueError, match=r"route = 'a function' is not allowed: must not be given for rods of several lengths"):
        mr.Rod(**(OWN | {"length": [0.2, 0.3]}), lines=[mr.PushRod(route=helix)])
    rods = mr.SingleRod(mr.Rod(**(OWN | {"length": [0.2, 0.3]}), lines=[mr.PushRod(offset=(R, 0))]))
    bent = mr.solve(rods, rods.inputs(displacement=[0.004])).raise_if_failed()
    np.testing.assert_allclose(bent.line_length[:, 0], [0.196, 0.296], rtol=1e-10)


def test_a_motion_beside_kinks_is_let_out_before_it_is_led_there():
    """Lengths of opposite tendons that sum to zero: 121 integrations a sample by steps of the inputs first, 11 as it is."""
    quarters, time = np.pi / 2 * np.arange(4), 0.005 * np.arange(40)
    lines = [mr.Tendon(offset=(0.006 * np.cos(a), 0.006 * np.sin(a)), driven="displacement") for a in quarters]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.006, torsional_stiffness=0.0046, lines=lines))
    inputs = robot.inputs(displacement=0.002 * np.cos(3 * time[:, None] - quarters))
    motion = mr.simulate(robot, inputs, time=time).raise_if_failed()
    alone = mr.solve(robot, inputs).raise_if_failed()
    # both within their tolerances, of some 1e-9 1/m
    np.testing.assert_allclose(motion.tip_position, alone.tip_position, atol=1e-9)
    np.testing.assert_allclose(motion.tension, alone.tension, atol=1e-6)
    assert (motion.tension.min(axis=1) < 1e-6).all()
    assert np.median(motion.integrations) < 20
