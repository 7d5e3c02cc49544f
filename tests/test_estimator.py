"""Forces that wander, sample by sample: against measurements of a rod that is integrated by ``measured_rods``."""

import numpy as np
import pytest
from measured_rods import MeasuredRod, turned_by
from rerun.chunk import RrdReader

import multirod as mr

POSITION, ANGLE = 1e-4, np.radians(0.1)
WALK, DT, SAMPLES = 0.3, 0.002, 250  # N/sqrt(s), s
STEPS = mr.RK4(50)


@pytest.fixture(scope="module")
def wandering():
    """Forces of a random walk, and noisy poses of the tip."""
    random = np.random.default_rng(7)
    force = (0.2, -0.1, 0.3) + np.cumsum(WALK * np.sqrt(DT) * random.normal(size=(SAMPLES, 3)), axis=0)
    position, rotation, _, _ = MeasuredRod(0.4, 0.223349, 0.063814, (14, 5, 0)).seen(force)
    position = position + POSITION * random.normal(size=position.shape)
    return force, position, turned_by(ANGLE * random.normal(size=(SAMPLES, 3))) @ rotation


@pytest.fixture
def make(wire):
    def estimator(sigma=(POSITION, ANGLE), start=None, **options):
        sensor = mr.Pose(position=(0, 0, 0.4), rotation=np.eye(3), sigma=sigma)
        walks = {"tip_force": mr.Walk(WALK, start=mr.Prior(0, sigma=0.5) if start is None else start)}
        options = {"integrator": STEPS, "dt": DT, "unknown": walks, "sensors": sensor} | options
        return mr.Estimator(mr.SingleRod(wire), **options)

    return estimator


def test_one_integration_a_sample_and_errors_as_large_as_it_says(make, wandering):
    meter = make()
    assert repr(meter).startswith("Estimator(SingleRod(")
    assert repr(meter).endswith("tip_force walks, Pose(position, rotation, sigma; 6 rows, batch ()), dt 0.002 s)")
    errors, squares = [], []
    for k, (force, position, rotation) in enumerate(zip(*wandering, strict=True)):
        sample = meter.step([(position, rotation)])
        assert k == 0 or (sample.integrations == 1 and sample.status is mr.Status.TRACKING)
        error = sample.value("tip_force") - force
        errors.append(error @ np.linalg.solve(sample.covariance("tip_force"), error))
        squares.append(float(sample.misfit))
    # correlated over some samples: 250 of three dimensions are some 100 independent ones
    assert 0.75 < np.mean(errors) / 3 < 1.3
    # what is not expected is independent: 1500 squares
    assert 0.85 < np.mean(squares) / 6 < 1.15
    # it is as a whole better than each sample alone
    alone = mr.estimate(
        meter.robot,
        unknown={"tip_force": mr.Prior(0, sigma=0.5)},
        measured=mr.Pose(position=wandering[1][-1], rotation=wandering[2][-1], sigma=(POSITION, ANGLE)),
    )
    assert (sample.sigma("tip_force") < 0.8 * alone.sigma("tip_force")).all()
    assert sample.observable["tip_force"].all()


def test_the_filter_of_a_linear_sensor_is_kalmans(make):
    """A stiff rod under small forces is linear: gain and covariance are those of the textbook's recursion."""
    rod = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814))
    compliance = mr.solve(rod, rod.inputs()).jacobian("tip_force")[:2, :2]
    sigma, walk, start = 1e-5, 1e-3, 1e-3
    meter = mr.Estimator(
        rod,
        dt=DT,
        unknown={"tip_force": mr.Walk(walk, start=mr.Prior(0, sigma=start))},
        sensors=mr.Pose(position=(0, 0, 0.4), sigma=sigma),
        integrator=STEPS,
    )
    mean, P = np.zeros(2), start**2 * np.eye(2)
    for k in range(6):
        y = np.array([1e-5 * np.sin(k), 2e-5 * np.cos(k), 0.4])
        sample = meter.step([y])
        P = P + (k > 0) * walk**2 * DT * np.eye(2)
        gain = P @ compliance.T @ np.linalg.inv(compliance @ P @ compliance.T + sigma**2 * np.eye(2))
        mean, P = mean + gain @ (y[:2] - compliance @ mean), (np.eye(2) - gain @ compliance) @ P
        # what a force of a millinewton bends is linear to 1e-6
        np.testing.assert_allclose(sample.value("tip_force")[:2], mean, atol=1e-5 * np.abs(mean).max())
        np.testing.assert_allclose(sample.covariance()[:2, :2], P, rtol=1e-5, atol=1e-6 * P.max())
    # along itself the rod does not move
    np.testing.assert_allclose(sample.covariance()[2, 2], start**2 + 5 * walk**2 * DT, rtol=1e-6)
    np.testing.assert_array_equal(sample.observable["tip_force"], [True, True, False])


def test_a_sensor_that_drops_out_is_gone_without(make, wandering):
    force, position, rotation = wandering
    meter = make()
    for k in range(20):
        sample = meter.step([(position[k], rotation[k])])
    before = sample.covariance()
    for lost in (None, (np.full(3, np.nan), np.full((3, 3), np.nan))):
        sample = meter.step([lost])
        assert sample.missing.all()
        assert sample.degrees == 0
        before = before + WALK**2 * DT * np.eye(3)
        np.testing.assert_allclose(sample.covariance(), before, rtol=1e-12)
    half = meter.step([(position[22], np.full((3, 3), np.nan))])
    assert half.missing.all()
    assert half.degrees == 3
    for k in range(23, 40):
        sample = meter.step([(position[k], rotation[k])])
    assert not sample.missing.any()
    assert (np.abs(sample.value("tip_force") - force[39]) < 5 * sample.sigma("tip_force")).all()
    # from the first sample on
    late = make()
    first = late.step([None])
    np.testing.assert_array_equal(first.value("tip_force"), 0)
    for k in range(15):
        sample = late.step([(position[k], rotation[k])])
    assert (np.abs(sample.value("tip_force") - force[14]) < 5 * sample.sigma("tip_force")).all()


def test_an_outlier_is_left_out_by_the_gate_and_moves_the_estimate_without_it(make, wandering):
    force, position, rotation = wandering
    off = position.copy()
    off[40] += (0.02, 0, 0)
    gated, open_, without = make(gate=0.9999), make(), make(gate=0.9999)
    for k in range(46):
        sample, moved = gated.step([(off[k], rotation[k])]), open_.step([(off[k], rotation[k])])
        blind = without.step([(position[k], rotation[k]) if k != 40 else None])
        assert bool(sample.rejected) == (k == 40)
        assert not moved.rejected.any()
        if k < 40:
            np.testing.assert_array_equal(sample.value("tip_force"), moved.value("tip_force"))
        else:
            assert (np.abs(sample.value("tip_force") - force[k]) < 3 * sample.sigma("tip_force")).all()
        if k == 40:
            assert (np.abs(moved.value("tip_force") - force[k]) > 3 * moved.sigma("tip_force")).any()
            assert not sample.missing.any()
            assert sample.degrees == sample.misfit == 0
            assert "without sensor 0, an outlier" in repr(sample)
        # what is left out is as what dropped out
        np.testing.assert_array_equal(sample.value("tip_force"), blind.value("tip_force"))
        np.testing.assert_array_equal(sample.covariance(), blind.covariance())


def test_the_gate_lets_through_as_many_as_it_says(make, wandering):
    """By chi-square's distribution, of sensors with three and with two rows, each by itself."""
    _, position, rotation = wandering
    sensors = [mr.Pose(position=(0, 0, 0.4), sigma=POSITION), mr.Pose(axis=(0, 0, 1), sigma=ANGLE)]
    meter = make(sensors=sensors, gate=0.9)
    lost = np.array([meter.step([p, R[:, 2]]).rejected for p, R in zip(position, rotation, strict=True)])
    # 250 samples of a tenth: a deviation is 0.019
    assert (np.abs(lost.mean(axis=0) - 0.1) < 0.05).all()
    assert meter.step([position[-1] + 0.02, rotation[-1, :, 2]]).rejected.tolist() == [True, False]
    half = meter.step([position[-1] + (0.02, np.nan, np.nan), rotation[-1, :, 2]])
    assert half.rejected.tolist() == [True, False]
    assert half.degrees == 2


def test_an_outlier_of_one_instance_leaves_the_others(wire, make, wandering):
    _, position, rotation = wandering
    both, alone = make(inputs=mr.SingleRod(wire).inputs(rotation=np.zeros(2)), gate=0.9999), make(gate=0.9999)
    for k in range(6):
        off = position[k] + np.array([[0.02 * (k == 4), 0, 0], [0, 0, 0]])
        batch, one = both.step([(off, rotation[k])]), alone.step([(position[k], rotation[k])])
        assert batch.rejected.tolist() == [[k == 4], [False]]
        assert batch.degrees.tolist() == [0 if k == 4 else 6, 6]
        np.testing.assert_allclose(batch.value("tip_force")[1], one.value("tip_force"), atol=1e-12)


def test_what_is_known_moves_with_it(wire, make):
    """The base turns: the estimate does not take that for a force; a batch is as its instances alone."""
    robot = mr.SingleRod(wire)
    force = np.array([[0.2, -0.1, 0.3], [0.0, 0.4, -0.1]])
    angle = 0.02 * np.arange(30)
    solved = mr.solve(robot, robot.inputs(tip_force=force[:, None], rotation=angle), solver=mr.Shooting(integrator=STEPS))
    seen = np.moveaxis(solved.tip_position, 1, 0), np.moveaxis(solved.tip_rotation, 1, 0)
    both, alone = make(inputs=robot.inputs(rotation=np.zeros(2))), make()
    for k, (p, R) in enumerate(zip(*seen, strict=True)):
        batch, one = both.step([(p, R)], rotation=angle[k]), alone.step([(p[1], R[1])], rotation=angle[k])
    np.testing.assert_allclose(batch.value("tip_force"), force, atol=1e-3)
    np.testing.assert_allclose(batch.value("tip_force")[1], one.value("tip_force"), atol=1e-12)
    # the solution is the equilibrium there, nearly
    again = mr.solve(robot, robot.inputs(rotation=angle[-1], tip_force=one.value("tip_force")))
    np.testing.assert_allclose(one.solution.rod(0).position[-1], again.tip_position, atol=1e-5)


@pytest.mark.usefixtures("written_here")
def test_a_recording_shows_the_force_how_sure_it_is_and_what_was_seen(make, wandering, tmp_path):
    """Also of a sample without a measurement: the ellipsoid grows, and the point is gone."""
    _, position, rotation = wandering
    meter, samples = make(), []
    with mr.Recorder(tmp_path / "run.rrd") as recorder:
        for k in range(6):
            samples.append(meter.step([(position[k], rotation[k]) if k != 3 else None]))
            recorder.log(DT * k, samples[-1].solution)
    chunks = RrdReader(tmp_path / "run.rrd").stream().to_chunks()
    columns = [(chunk.entity_path, chunk.to_record_batch()) for chunk in chunks if not chunk.is_static]

    def column(path, name):
        return [row for entity, batch in columns if entity == path for row in batch.column(name).to_pylist()]

    seen = column("/world/measured", "Points3D:positions")
    assert [len(row) for row in seen] == [1, 1, 1, 0, 1, 1]
    np.testing.assert_allclose(seen[4][0], position[4], atol=1e-7)  # single precision
    half = np.array(column("/world/loads/tip_force/spread", "Ellipsoids3D:half_sizes"))[:, 0]
    for sample, axes in zip(samples, half, strict=True):
        np.testing.assert_allclose((axes / 2.795) ** 2, np.linalg.eigvalsh(sample.covariance("tip_force")), rtol=1e-5)
    assert (half[3] > half[2]).all()
    centres = np.array(column("/world/loads/tip_force/spread", "Ellipsoids3D:centers"))[:, 0]
    np.testing.assert_allclose(centres, [sample.value("tip_force") for sample in samples], rtol=1e-6)


def test_unknowns_go_along_with_the_estimate(make, wire):
    """(12) After a jump of the force the next sample is off its equilibrium by the square of that."""
    robot = mr.SingleRod(wire)
    force = np.array([[0.2, -0.1, 0.3], [0.2, -0.09, 0.3]])
    seen = mr.solve(robot, robot.inputs(tip_force=force), solver=mr.Shooting(integrator=STEPS))
    meter = make(sigma=(1e-7, 1e-6))
    for k in (0, 0, 0, 1, 1):
        sample = meter.step([(seen.tip_position[k], seen.tip_rotation[k])])
    # a hundredth of a newton bends it by 7e-3 1/m at its base
    assert sample.solution.residual < 1e-4


@pytest.mark.parametrize("off", [1e-6, 0.3, 1.4, 2.5])
@pytest.mark.parametrize("told", ["rotation", "axis", "covariance", "gap", "curvature", "marker"])
def test_the_compiled_sample_is_that_of_estimate(wire, make, wandering, off, told, monkeypatch):
    """(10) to (12) by the rows that ``estimate`` has, of a measurement that is far off; reckoned once, without (28)."""
    monkeypatch.setattr("multirod.tasks.estimating.filtering.BENT", np.inf)
    from multirod.tasks.measuring.along import Places
    from multirod.tasks.measuring.sensors import Measured

    robot, sigma = mr.SingleRod(wire), (POSITION, ANGLE)
    shape = mr.solve(robot, robot.inputs(tip_force=wandering[0][0])).rod(0, nodes=5)
    p, R = (shape.position[3], shape.rotation[3]) if told == "marker" else (values[0] for values in wandering[1:])
    # it takes 80 N to turn a rod inside by 2.5, and what is not seen gives way by too much: neither is stable
    off = {"marker": 0.1, "gap": 0.5}.get(told, 1.0) * off
    turned = turned_by(off * np.array([[0.6, 0.0, 0.8]]))[0] @ R

    scale = np.diag(np.repeat(sigma, 3))
    root = scale @ (np.eye(6) + 0.3 * np.tri(6, k=-1))

    def sensors(p, R, bent):
        return {
            "curvature": lambda: [mr.Pose(position=p, sigma=POSITION), mr.Curvature(at=[0.1, 0.3], value=bent, sigma=0.05)],
            "marker": lambda: [mr.Pose(position=p, rotation=R, at=0.3, sigma=((1e-3, 2e-3, 3e-3), ANGLE))],
            "rotation": lambda: [mr.Pose(position=p, rotation=R, sigma=sigma)],
            "covariance": lambda: [mr.Pose(position=p, rotation=R, covariance=root @ root.T)],
            "gap": lambda: [mr.Pose(position=p, rotation=R, covariance=root @ root.T)],
            "axis": lambda: [mr.Pose(position=p, axis=R[:, 2], sigma=sigma)],
        }[told]()

    def said(p, R, bent):
        return {"curvature": [p, bent], "axis": [(p, R[:, 2])]}.get(told, [(p, R)])

    there = shape.curvature[[1, 3], :2]
    meter = make(sensors=sensors(p, R, there))
    first = meter.step(said(p, R, there))
    after = p + 1e-3
    if told == "gap":  # of a covariance, and all of it is there again in the sample before
        meter.step(said(np.array([np.nan, np.nan, p[2]]), R, there))
        first = meter.step(said(p, R, there))
        after[0] = np.nan
    sample = meter.step(said(list(after), turned, there + off))

    mean = first.value("tip_force")
    given = sensors(after, turned, there + off)
    seen = Measured(given, Places(robot, robot.inputs(), given), (), None)
    options = {"pose_sensitivities": True, **robot.input_directions("tip_force")}
    task = seen.task(robot.problem(robot.inputs(tip_force=mean), integrator=STEPS, **options), ("tip_force",))
    found = task.evaluate(first.solution.unknowns[None], mean[None])
    r, J = (values[0] for values in seen.at(found, slice(None)))
    before = first.covariance() + WALK**2 * DT * np.eye(3)
    P = np.linalg.inv(np.linalg.inv(before) + J.T @ J)
    step = -P @ J.T @ r
    # inverses of a matrix whose condition is 1e5
    np.testing.assert_allclose(sample.value("tip_force"), mean + step, rtol=1e-8, atol=1e-9 * np.abs(step).max())
    np.testing.assert_allclose(sample.covariance(), P, atol=1e-8 * P.max())
    np.testing.assert_allclose(sample.misfit, r @ (r + J @ step), rtol=1e-7)
    towards, by = (values[0] for values in found.eliminated)
    np.testing.assert_allclose(sample.solution.unknowns, first.solution.unknowns + towards + by @ step, rtol=1e-7)


def test_one_that_fails_leaves_the_others_as_they_are(wire, make):
    """Of a batch: bitwise. A sample far off leads where there is no stable equilibrium; it says so, and begins anew."""
    robot = mr.SingleRod(wire)
    force = np.array([[0.2, -0.1, 0.3], [0.0, 0.4, -0.1]])
    solved = mr.solve(robot, robot.inputs(tip_force=force), solver=mr.Shooting(integrator=STEPS))
    p, R = np.array(solved.tip_position), np.array(solved.tip_rotation)
    two = robot.inputs(rotation=np.zeros(2))
    far, sound = (
        make(inputs=two, start=mr.Prior([(x, 0, 0), (0, 0, 0)], sigma=0.5), guess=np.array((14.0, 5.0, 0.0))) for x in (1e9, 0.0)
    )
    statuses = []
    for k in range(8):
        lost, kept = far.step([(p, R)]), sound.step([(p if k != 2 else p + [[50, 0, 0], [0, 0, 0]], R)])
        assert lost.failed.tolist() == [True, False]
        assert np.isnan(lost.value("tip_force")[0]).all()
        assert np.isnan(lost.misfit[0])
        assert k == 0 or lost.integrations[1] == 1
        for own, other in ((lost.value("tip_force"), kept.value("tip_force")), (lost.covariance(), kept.covariance())):
            np.testing.assert_array_equal(own[1], other[1])
        statuses.append(mr.Status(kept.status[0]))
    assert statuses[1] is mr.Status.TRACKING
    assert mr.Status.UNSTABLE in statuses
    assert statuses[-1] is mr.Status.TRACKING
    assert (np.abs(kept.value("tip_force") - force) < 1e-3).all()


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"dt": 0}, ValueError, "Estimator.dt"),
        ({"unknown": {"tip_force": mr.Prior(0, sigma=1)}}, TypeError, "must be a Walk"),
        ({"unknown": {"tip_forse": mr.Walk(1)}}, TypeError, "did you mean 'tip_force'"),
        ({"unknown": {"tip_force": mr.Walk(1, start=mr.Prior())}}, ValueError, "a prior without sigma"),
        ({"sensors": mr.Pose(position=(0, 0, 1))}, ValueError, r"sensors\[0\].sigma"),
        ({"sensors": ()}, TypeError, "sensors must be measurements"),
        ({"gate": 3.0}, ValueError, "Estimator.gate = 3.0 .* from 0.5 to below 1, or None"),
        ({"gate": 1}, ValueError, "Estimator.gate = 1 .* from 0.5 to below 1"),
        ({"gate": 0.05}, ValueError, "Estimator.gate = 0.05 .* the part of sound measurements that passes"),
        ({"gate": "99 %"}, ValueError, "Estimator.gate = .99 %. .* must be a number"),
    ],
)
def test_bad_estimators(make, options, error, message):
    with pytest.raises(error, match=message):
        make(**options)


def test_inputs_of_no_instance_are_the_estimators_own(make, wire):
    with pytest.raises(ValueError, match=r"^Estimator.inputs = leading axes \(0,\) .* there must be an instance"):
        make(inputs=mr.SingleRod(wire).inputs(tip_moment=np.zeros((0, 3))))


@pytest.mark.parametrize(
    ("measured", "changes", "error", "message"),
    [
        ([], {}, ValueError, "measured = .* must be a list of 1"),
        ([(np.zeros(3),)], {}, ValueError, r"measured\[0\] = .* must be \(position, rotation\)"),
        ([(np.zeros(2), np.eye(3))], {}, ValueError, r"measured\[0\], position"),
        ([(np.zeros(3), 2 * np.eye(3))], {}, ValueError, "must be a rotation"),
        ([(np.zeros(3), -np.eye(3))], {}, ValueError, "must be a rotation: .* a mirror image"),
        ([(np.array([1e60, -1e60, 0]), np.eye(3))], {}, ValueError, r"must be at most 1e\+50"),
        ([((0, 1e60, 0), np.eye(3))], {}, ValueError, r"must be at most 1e\+50"),
        (
            [mr.Pose(position=(0, 0, 0.4), sigma=1e-4)],
            {},
            ValueError,
            "the numbers alone .* its position, rotation",
        ),
        ([None], {"tip_force": (0, 0, 1)}, TypeError, "takes no 'tip_force': it is estimated"),
        ([None], {"rotatoin": 1.0}, TypeError, "did you mean 'rotation'"),
    ],
)
def test_bad_samples(make, measured, changes, error, message):
    with pytest.raises(error, match=message):
        make().step(measured, **changes)


def test_infinite_numbers_of_a_sensor_are_missing(make, wandering):
    """Two of them of both signs warned of their sum; ``pytest`` makes an error of that."""
    _, position, rotation = (own[0] for own in wandering)
    meter, other = make(), make()
    for each in (meter, other):
        each.step([(position, rotation)])
    found = meter.step([(np.array([np.inf, -np.inf, position[2]]), rotation)])
    assert found.dropped == ("x and y of sensor 0",)
    expected = other.step([(np.array([np.nan, np.nan, position[2]]), rotation)])
    np.testing.assert_array_equal(found.value("tip_force"), expected.value("tip_force"))


def test_a_measured_rotation_may_be_in_single_precision(make, wandering):
    """As a sample's may; a target's is to be exact."""
    _, position, rotation = (own[0].astype(np.float32) for own in wandering)
    sensor = mr.Pose(position=position, rotation=rotation, sigma=(POSITION, ANGLE))
    found = mr.estimate(make().robot, unknown={"tip_force": mr.Prior(0, sigma=0.5)}, measured=sensor)
    exact = mr.Pose(position=wandering[1][0], rotation=wandering[2][0], sigma=(POSITION, ANGLE))
    expected = mr.estimate(make().robot, unknown={"tip_force": mr.Prior(0, sigma=0.5)}, measured=exact)
    # 6e-8 of a position and a rotation, in deviations of 1e-4 and 2e-3
    np.testing.assert_allclose(
        found.value("tip_force"), expected.value("tip_force"), atol=1e-3 * expected.sigma("tip_force").max()
    )
    with pytest.raises(ValueError, match="it is rounded, give all digits"):
        mr.Pose(position=position, rotation=rotation)


def test_a_recorder_is_given_the_solution_of_an_estimate(make, wandering, tmp_path):
    sample = make().step([(wandering[1][0], wandering[2][0])])
    with mr.Recorder(tmp_path / "loop.rrd") as recorder:
        with pytest.raises(TypeError, match=r"the Solution of one sample, not Estimate; give its \.solution"):
            recorder.log(0.0, sample)
        recorder.log(0.0, sample.solution)


def test_a_time_step_in_milliseconds_is_warned_of(make):
    with pytest.warns(mr.PlausibilityWarning, match=r"Estimator.dt = 20 s .* slow for an estimator; if it is in ms, give 0.02"):
        make(dt=20)


def test_nan_hides_nothing(wire, make):
    """What one instance lacks, another must still have right."""
    meter = make(inputs=mr.SingleRod(wire).inputs(rotation=np.zeros(2)))
    with pytest.raises(ValueError, match="must be a rotation"):
        meter.step([(np.zeros(3), np.array([np.full((3, 3), np.nan), 2 * np.eye(3)]))])
    tilted = mr.Pose(position=(0, 0, 0.4), axis=(0, 0, 1), sigma=(POSITION, ANGLE))
    with pytest.raises(ValueError, match=r"measured\[0\], axis.*must not be zero"):
        make(sensors=tilted).step([(np.zeros(3), np.zeros(3))])


def test_bad_walks():
    for sigma in (0, -1, np.inf, np.nan):
        with pytest.raises(ValueError, match="Walk.sigma"):
            mr.Walk(sigma)
    with pytest.raises(TypeError, match="Walk.start must be a Prior"):
        mr.Walk(1.0, start=0.5)


def test_two_modes_that_are_lost_at_once_are_unstable_also_in_a_batch():
    """A straight rod under a force along it: the sign of det Gamma does not change where it buckles to all sides."""
    rod = mr.SingleRod(mr.Rod(length=0.6, bending_stiffness=0.2233, torsional_stiffness=0.0638))
    buckles = np.pi**2 * 0.2233 / (4 * 0.6**2)
    meter = mr.Estimator(
        rod,
        dt=0.01,
        inputs=rod.inputs(tip_force=[(0, 0, -0.8 * buckles), (0, 0, -0.1 * buckles)]),
        unknown={"tip_moment": mr.Walk(0.01, start=mr.Prior(0, sigma=0.001))},
        sensors=mr.Pose(position=(0, 0, 0.6), sigma=1e-3),
        integrator=STEPS,
    )
    said = []
    for part in (0.8, 0.9, 1.03, 1.06):
        sample = meter.step([(0, 0, 0.6)], tip_force=[(0, 0, -part * buckles), (0, 0, -0.1 * buckles)])
        said.append([status.name for status in sample.status])
    assert said[1] == ["TRACKING", "TRACKING"]
    assert [first for first, _ in said[2:]] == ["UNSTABLE", "UNSTABLE"]
    assert [second for _, second in said[1:]] == ["TRACKING"] * 3


def test_forces_on_a_platform_that_is_held_are_estimated_sample_by_sample():
    """The inverse problem has a test of its own of what is found, whose integrations are told."""
    base, platform = np.tile(np.eye(4), (2, 6, 1, 1))
    for pose, angles in ((base, (-10, 10, 110, 130, 230, 250)), (platform, (-50, 50, 70, 170, 190, 290))):
        pose[:, :2, 3] = 0.087 * np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))], axis=1)
    leg = mr.Rod(length=0.4, bending_stiffness=0.157, torsional_stiffness=0.126)
    held = mr.ParallelRods(legs=[leg] * 6, base=base, platform=platform).inverse()
    place = (0.02, 0, 0.39)
    meter = mr.Estimator(
        held,
        dt=0.01,
        inputs=held.inputs(platform_position=place),
        unknown={"tip_force": mr.Walk(0.3)},
        sensors=mr.Pose(position=place, sigma=1e-3),
        integrator=STEPS,
    )
    for k in range(4):
        sample = meter.step([place])
        assert sample.status is (mr.Status.TRACKING if k else mr.Status.CONVERGED)


def as_numbers_alone(make, wandering, sight, counts):
    """A loop by two positions, seen ``across`` or ``along`` x and y, of which all but what ``counts`` is noise: it is checked
    to estimate as one without the numbers that do not count."""
    directions, random = np.eye(3)[:2], np.random.default_rng(4)
    by_sight = make(sensors=[mr.Pose(position=(0, 0, 0.4), **{sight: direction}, sigma=POSITION) for direction in directions])
    by_numbers = make(sensors=[mr.Pose(position=(0, 0, 0.4), sigma=POSITION)] * 2)
    for position in wandering[1][:20]:
        sample = by_sight.step([np.where(counts(direction), position, position + random.normal()) for direction in directions])
        other = by_numbers.step([np.where(counts(direction), position, np.nan) for direction in directions])
        assert "without" not in str(sample)
        np.testing.assert_allclose(sample.value("tip_force"), other.value("tip_force"), atol=1e-9)
        np.testing.assert_allclose(sample.covariance(), other.covariance(), atol=1e-12)
    return by_sight


def test_a_sample_seen_in_two_pictures(make, wandering):
    """Along x and y, each position with another depth: as without the coordinate along the direction."""
    by_pictures = as_numbers_alone(make, wandering, "across", lambda direction: direction == 0)
    blind = by_pictures.step([None, (0.0, np.nan, 0.0)])
    assert "without sensor 0, sensor 1" in str(blind)


def test_a_sample_of_one_coordinate_each(make, wandering):
    as_numbers_alone(make, wandering, "along", lambda direction: direction == 1)


def test_what_moves_twice_as_fast_leaves_four_times_the_error():
    """Measured without noise: what is left is what a sample is told to first order by, which no covariance has."""

    def tube(length, curved, curvature, outer, inner):
        return mr.Rod.tube(
            length=length,
            outer_diameter=outer,
            inner_diameter=inner,
            young_modulus=60e9,
            shear_modulus=23e9,
            precurvature=[(length - curved, (0, 0, 0)), (curved, (0, curvature, 0))],
        )

    sizes = [(0.4, 0.1, 18, 1.2e-3, 0.9e-3), (0.3, 0.09, 10, 1.8e-3, 1.4e-3), (0.2, 0.08, 4, 2.6e-3, 2.0e-3)]
    robot = mr.ConcentricTubes([tube(*size) for size in sizes])
    force, held = np.array([0.05, 0.02, 0.1]), {"translation": (-0.16, -0.13, -0.10)}
    errors = []
    for turned in (0.04, 0.02):
        angles = (-1.2, -0.4, 0.0) + turned * np.arange(20)[:, None] * (1, 0, 0)
        truth = mr.solve(robot, robot.inputs(rotation=angles, tip_force=np.tile(force, (20, 1)), **held))
        meter = mr.Estimator(
            robot,
            dt=1e-3,
            inputs=robot.inputs(rotation=angles[0], **held),
            unknown={"tip_force": mr.Walk(WALK)},
            sensors=mr.Pose(position=(0, 0, 0.4), rotation=np.eye(3), sigma=(2e-4, 2e-3)),
        )
        for angle, position, rotation in zip(angles, truth.tip_position, truth.tip_rotation, strict=True):
            sample = meter.step([(position, rotation)], rotation=angle)
        error = sample.value("tip_force") - force
        errors.append(np.sqrt(error @ np.linalg.solve(sample.covariance("tip_force"), error)))
    assert errors[0] == pytest.approx(0.114, abs=0.005)  # as docs/estimation.md says
    assert 3.5 < errors[0] / errors[1] < 4.5  # of second order, and what is left of higher ones


def finger():
    tendons = [
        mr.Tendon(offset=(0.006 * np.cos(angle), 0.006 * np.sin(angle)), driven="displacement", axial_stiffness=5e3)
        for angle in (0.0, 2.1, 4.2)
    ]
    return mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, lines=tendons))


def pulled_in_turn(k):
    return 1.5e-3 * np.cos(2 * np.pi * k / 100 - np.array([0.0, 2.1, 4.2]))


def test_samples_that_lead_far_know_how_far_they_are_off(make):
    """(28) The rows of where a sample begins are not those of where it ends: reckoned once, the largest square is 36."""
    random, step, dt = np.random.default_rng(1), 0.1, 0.01
    force = np.cumsum(step * random.normal(size=(100, 3)), axis=0)
    position, rotation, _, _ = MeasuredRod(0.4, 0.223349, 0.063814, (14, 5, 0)).seen(force)
    position = position + POSITION * random.normal(size=position.shape)
    rotation = turned_by(ANGLE * random.normal(size=(len(force), 3))) @ rotation
    meter = make(unknown={"tip_force": mr.Walk(step / np.sqrt(dt))}, dt=dt)
    squares, integrations, sample = [], [], None
    for k, (truth, *seen) in enumerate(zip(force, position, rotation, strict=True)):
        before, sample = sample, meter.step([tuple(seen)])
        if k and sample.integrations > 2:  # it ends where an estimate does, which goes on until it leads nowhere
            began = mr.Prior(before.value("tip_force"), covariance=before.covariance("tip_force") + step**2 * np.eye(3))
            measured = mr.Pose(position=seen[0], rotation=seen[1], sigma=(POSITION, ANGLE))
            end = mr.estimate(meter.robot, unknown={"tip_force": began}, measured=measured, guess=before.solution)
            off = sample.value("tip_force") - end.value("tip_force")
            assert off @ np.linalg.solve(end.covariance("tip_force"), off) < 0.1
        error = sample.value("tip_force") - truth
        squares.append(error @ np.linalg.solve(sample.covariance("tip_force"), error) / 3)
        integrations.append(int(sample.integrations))
    assert 0.7 < np.mean(squares) < 1.5
    assert max(squares) < 10
    assert 1 < np.mean(integrations[1:]) < 2
    assert max(integrations[1:]) > 2


def test_samples_in_which_lines_turn_slack_or_taut_know_how_far_they_are_off_across_the_kink():
    robot, walk, dt, sigma = finger(), 0.1, 0.01, (2e-4, 2e-3)
    sensor = mr.Pose(position=(0, 0, 0), rotation=np.eye(3), sigma=sigma)
    unknown = {"tip_force": mr.Walk(walk, start=mr.Prior(0, sigma=0.3))}
    errors, turned = [], 0
    for seed in (0, 1):
        random = np.random.default_rng(seed)
        force = 0.3 * random.normal(size=3) + np.cumsum(walk * np.sqrt(dt) * random.normal(size=(120, 3)), axis=0)
        pulls = np.array([pulled_in_turn(k) for k in range(120)])
        # each solved by itself, to what lengths and forces call for
        truth = mr.solve(robot, robot.inputs(displacement=pulls, tip_force=force), solver=mr.Shooting(integrator=STEPS))
        truth.raise_if_failed()
        turned += np.diff(truth.tension > 0, axis=0).sum()
        position = truth.tip_position + sigma[0] * random.normal(size=(120, 3))
        rotation = turned_by(sigma[1] * random.normal(size=(120, 3))) @ truth.tip_rotation
        meter = mr.Estimator(
            robot, dt=dt, unknown=unknown, sensors=sensor, inputs=robot.inputs(displacement=pulls[0]), integrator=STEPS
        )
        for k in range(120):
            sample = meter.step([(position[k], rotation[k])], displacement=pulls[k])
            assert k == 0 or sample.status is mr.Status.TRACKING
            error = sample.value("tip_force") - force[k]
            errors.append(error @ np.linalg.solve(sample.covariance("tip_force"), error))
    assert turned > 10
    # of three dimensions, correlated over many samples; by columns of the wrong side 3.2 in the mean, and 143
    assert 0.5 < np.mean(errors) / 3 < 2.2
    assert max(errors) < 30


def test_samples_of_a_batch_cross_kinks_as_they_do_alone():
    robot, sensor = finger(), mr.Pose(position=(0, 0, 0), sigma=1e-4)
    force = np.array([(0.1, 0.05, 0), (-0.1, 0.02, 0), (0, 0, 0)])
    options = {"dt": 0.01, "unknown": {"tip_force": mr.Walk(0.3)}, "sensors": sensor, "integrator": STEPS}
    start = robot.inputs(displacement=np.broadcast_to(pulled_in_turn(0), (3, 3)))
    batch = mr.Estimator(robot, inputs=start, **options)
    alone = [mr.Estimator(robot, inputs=robot.inputs(displacement=pulled_in_turn(0)), **options) for _ in force]
    apart = 0
    for k in range(0, 100, 4):
        pull = np.broadcast_to(pulled_in_turn(k), (3, 3))
        seen = mr.solve(robot, robot.inputs(displacement=pull, tip_force=force)).tip_position
        sample = batch.step([seen], displacement=pull)
        for i, one in enumerate(alone):
            own = one.step([seen[i]], displacement=pull[i])
            np.testing.assert_array_equal(sample.value("tip_force")[i], own.value("tip_force"))
            np.testing.assert_array_equal(sample.covariance("tip_force")[i], own.covariance("tip_force"))
            np.testing.assert_array_equal(sample.integrations[i], own.integrations)
            np.testing.assert_array_equal(sample.solution.unknowns[i], own.solution.unknowns)
        apart += k > 0 and len(set(sample.integrations)) > 1
    assert apart > 3  # samples in which not all cross
