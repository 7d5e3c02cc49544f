"""Speed against accuracy: what is measured is so, and what is promised is kept."""

import csv
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
from rerun.chunk import RrdReader

import multirod as mr
from multirod.running.simulation import Runner
from multirod.studies.experiment import motion
from multirod.studies.scenes import six_legs, three_tubes
from multirod.studies.tradeoffs import Measurement, grid, limit, measurement, reference
from multirod.studies.tradeoffs.promise import kept
from multirod.studies.tradeoffs.settings import code, integrators, settings

PUBLIC = {name: getattr(mr, name) for name in mr.__all__}
STUDY = motion(duration=0.5)
COARSE = mr.RK4(10)
SOLVERS = {
    "Newton, coarse": mr.Shooting(integrator=mr.RK4(10)),
    "Newton, fine": mr.Shooting(integrator=mr.RK4(50)),
    "observer, fine": mr.Observer(integrator=mr.RK4(50)),
    "observer, fed forward": mr.Observer(feed_forward=True, integrator=mr.RK4(50)),
}


def measure(solvers: dict[str, mr.Solver], **options: object) -> mr.Tradeoff:
    given = {"budget": 1e4, **options}  # also where all kernels are compiled, on a busy machine
    return mr.tradeoff(STUDY.robot, STUDY.inputs, time=STUDY.time, solvers=solvers, progress=False, **given)


@pytest.fixture(scope="module")
def measured() -> mr.Tradeoff:
    return measure(SOLVERS)


def test_errors_are_those_of_a_run_of_ones_own(measured):
    exact = mr.simulate(STUDY.robot, STUDY.inputs, time=STUDY.time, solver=mr.Shooting(integrator=mr.RK45(1e-12, 1e-14)))
    for row in measured.rows:
        own = mr.simulate(STUDY.robot, STUDY.inputs, time=STUDY.time, solver=SOLVERS[row.name])
        settled = STUDY.time >= 0.3
        gap = np.linalg.norm(own.tip_position - exact.tip_position, axis=1)[settled].max()
        assert row.position == pytest.approx(gap, rel=1e-3, abs=1e-12)
        turn = np.einsum("tji,tjk->tik", exact.tip_rotation, own.tip_rotation)[settled]
        angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)).max()
        assert row.rotation == pytest.approx(angle, abs=1e-7)  # what arccos can tell
        assert row.residual == pytest.approx(own.residual[settled].max(), rel=1e-6)
        assert row.shape > 0
        assert row.samples == len(STUDY.time)
        assert row.failed == 0
        assert 0 < row.median <= row.slow
    assert measured.checked
    assert measured.reference_gap < 1e-9


def test_what_is_known_of_these_settings_is_found(measured):
    rows = {row.name: row for row in measured.rows}
    assert rows["Newton, coarse"].position > 100 * rows["Newton, fine"].position  # fourth order: 625
    assert rows["observer, fine"].position > 10 * rows["observer, fed forward"].position
    assert rows["observer, fine"].integrations == 1
    assert rows["Newton, fine"].integrations > 1.9


def test_the_front_holds_what_nothing_beats(measured):
    front = measured.pareto()
    times, errors = [row.median for row in front], [row.position for row in front]
    assert times == sorted(times)
    assert errors == sorted(errors, reverse=True)
    for row in measured.rows:
        beaten = any(
            other.median <= row.median and other.position <= row.position and other is not row for other in measured.rows
        )
        assert (row in front) != beaten
    assert measured.best(error=1e-5).position <= 1e-5
    assert measured.best(time=1.0).position == min(row.position for row in measured.rows)
    with pytest.raises(ValueError, match=r"error = 1e-20 is not allowed: the most accurate setting, Newton, fine, is off by"):
        measured.best(error=1e-20)
    with pytest.raises(ValueError, match=r"time = 1e-09 is not allowed: the fastest setting, .* takes"):
        measured.best(time=1e-9)
    with pytest.raises(TypeError, match="takes error or time"):
        measured.best()
    with pytest.raises(ValueError, match="error = 'colour' is not allowed"):
        measured.pareto(error="colour")


def test_a_table_and_a_file_say_the_same(measured, tmp_path):
    path = tmp_path / "table.csv"
    measured.to_csv(path)
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == list(SOLVERS)
    assert [float(row["position"]) for row in rows] == [row.position for row in measured.rows]
    assert eval(rows[0]["solver"], PUBLIC) == SOLVERS["Newton, coarse"]  # ready to be pasted
    text = str(measured)
    assert all(name in text for name in SOLVERS)
    assert "agree within" in text


def test_a_reference_that_cannot_be_checked_is_said(monkeypatch):
    monkeypatch.setattr("multirod.studies.tradeoffs.reference.CHECK", mr.Shooting(tolerance=1e-11, integrator=mr.RK4(20)))
    few = {"Newton, coarse": SOLVERS["Newton, coarse"]}
    result = measure(few)
    assert not result.checked
    assert "DO NOT AGREE" in str(result)
    with pytest.raises(ValueError, match="the reference could not be checked"):
        mr.tune(STUDY.robot, STUDY.inputs, time=STUDY.time, error=1e-3, solvers=few, progress=False)


def test_a_reference_within_tolerance_is_not_compared_with_itself():
    """Where the pose of the platform is unknown, a check that starts at the reference could return it as it is."""
    legs = six_legs(duration=0.1)
    few = {"Newton": mr.Shooting(integrator=mr.RK4(50))}
    result = mr.tradeoff(legs.robot, legs.inputs, time=legs.time, solvers=few, settle=0, progress=False)
    assert 0 < result.reference_gap < 1e-9


def test_a_motion_that_the_reference_cannot_follow_is_said(monkeypatch):
    """A straight column is pressed beyond the load at which it buckles: up to there errors are told, and promises are refused."""
    for name in ("REFERENCE", "CHECK"):
        solver = getattr(reference, name)
        monkeypatch.setattr(reference, name, replace(solver, at_fold="stop"))
    column = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))
    time = np.arange(101) / 100
    buckling = np.pi**2 * 0.2233 / (4 * 0.4**2)
    inputs = column.inputs(tip_force=np.stack([0 * time, 0 * time, -1.5 * buckling * time], axis=-1))
    few = {"Newton": SOLVERS["Newton, fine"]}
    result = mr.tradeoff(column, inputs, time=time, solvers=few, progress=False)
    lost = int((~result.reference.known).sum())
    assert 25 <= lost <= 40  # 1 - 1 / 1.5 of 101, or a little more: the branch ends where it can no longer be told
    assert not result.checked
    assert f"FAILED in {lost} of 101 samples" in str(result)
    assert result.rows[0].position < 1e-9
    with pytest.raises(ValueError, match="the reference could not be checked"):
        mr.tune(column, inputs, time=time, rate=10, solvers=few, progress=False)


class Clock:
    """Time that integrations, compiling and some solvers take, and nothing else."""

    def __init__(self, monkeypatch):
        self.time = self.integration = self.compiling = 0.0
        that, heed_stop = self, mr.BoundaryProblem.heed_stop

        def heed(problem):
            that.time += that.integration
            heed_stop(problem)

        class Compiled(Runner):
            def __init__(self, *arguments, **options):
                that.time += that.compiling
                super().__init__(*arguments, **options)

        monkeypatch.setattr(limit, "now", lambda: self.time)
        monkeypatch.setattr("multirod.running.simulation.perf_counter", lambda: self.time)
        monkeypatch.setattr(mr.BoundaryProblem, "heed_stop", heed)
        monkeypatch.setattr(measurement, "Runner", Compiled)

    def take(self, seconds):
        self.time += seconds


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


@pytest.fixture
def reference_cost(clock):
    """Integrations of the reference, a second each."""
    clock.integration = 1.0
    Measurement(STUDY.robot, STUDY.inputs, time=STUDY.time, solvers=SOLVERS, budget=1e9)
    cost, clock.time = clock.time, 0.0
    return cost


@pytest.mark.parametrize("part", [1.0, 1.5, 6.0])
@pytest.mark.parametrize("compiling", [0.0, 0.3, 10.0])
def test_all_of_it_is_over_after_twice_the_budget(clock, reference_cost, part, compiling):
    budget = part * reference_cost
    clock.compiling = compiling * budget
    result = measure(SOLVERS, budget=budget)
    assert clock.time <= 2 * budget + clock.compiling + 10  # a sample's integrations
    assert set(result.skipped) | {row.name for row in result.rows} == set(SOLVERS)
    if compiling == 10.0:
        assert "no time was left" in str(result)
    if part == 6.0 and compiling < 1:
        assert result.rows
    if part == 6.0 and compiling == 0:
        assert not result.skipped


def test_a_reference_that_takes_longer_than_the_budget_is_an_error_and_ends_in_time(clock, reference_cost, tmp_path):
    budget = 0.5 * reference_cost
    path = tmp_path / "rows.csv"
    with pytest.raises(ValueError, match=rf"budget = .* the reference alone takes longer: \d+ of {len(STUDY.time)} samples"):
        measure(SOLVERS, budget=budget, csv=path)
    assert clock.time <= budget + 10
    assert path.read_text().startswith("name,position,")


def test_what_a_promise_runs_again_is_within_twice_the_budget(clock, reference_cost):
    budget = 6 * reference_cost
    options = {"solvers": {"good": SOLVERS["Newton, fine"]}, "progress": False}
    mr.tune(STUDY.robot, STUDY.inputs, time=STUDY.time, error=1.0, budget=budget, **options)
    assert clock.time <= 2 * budget + 10
    measured = Measurement(STUDY.robot, STUDY.inputs, time=STUDY.time, solvers=SOLVERS, budget=budget)
    clock.time += 2 * budget
    with pytest.raises(ValueError, match="budget = .* is not allowed: twice as many seconds were over before Newton, fine"):
        measured.repeat("Newton, fine")


@pytest.mark.parametrize("name", ["rows.txt", "rows", "rows.csv.gz"])
def test_rows_are_written_to_csv_only(tmp_path, measured, name):
    for write in (lambda path: measure(SOLVERS, csv=path), measured.to_csv):
        with pytest.raises(ValueError, match=r"csv = .* is not allowed: must end in \.csv"):
            write(tmp_path / name)
    assert not list(tmp_path.iterdir())


@dataclass(frozen=True)
class Slow(mr.Solver):
    """Newton's method that takes its time."""

    clock: Clock
    pause: float
    integrator: mr.Integrator = COARSE

    def _solve(self, problem, guess):
        self.clock.take(self.pause)
        return mr.Shooting(integrator=self.integrator).solve(problem, guess)


@dataclass(frozen=True)
class Endless(mr.Solver):
    """One that never returns by itself."""

    clock: Clock
    integrator: mr.Integrator = COARSE

    def _solve(self, problem, guess):
        while True:
            self.clock.take(1e-3)
            problem.integrate()


@dataclass(frozen=True)
class Lost(mr.Solver):
    """One that finds nothing."""

    integrator: mr.Integrator = COARSE

    def _solve(self, problem, guess):
        problem.integrate()
        outcome = mr.Outcome.zeros(problem.instance_count)
        outcome.status[:] = mr.Status.MAX_ITERATIONS
        return outcome


@dataclass(frozen=True)
class Broken(mr.Solver):
    """One that raises, after ``good`` samples."""

    error: type[BaseException] = ZeroDivisionError
    good: int = 0
    integrator: mr.Integrator = COARSE

    def track(self, problem, dt):
        inner, count = mr.Shooting(integrator=self.integrator).track(problem, dt), [0]

        class Track(mr.Track):
            def __init__(self):
                self.problem = problem

            def step(self):
                count[0] += 1
                if count[0] > that.good:
                    raise that.error("seven")
                return inner.step()

        that = self
        return Track()

    def _solve(self, problem, guess):
        raise self.error("seven")


def test_the_budget_is_kept(clock):
    """What is slow runs on fewer samples, what is slower not at all, what does not return is stopped."""
    pauses = {"good": 1e-4, "slow": 1e-3, "slower": 0.1}
    solvers = {name: Slow(clock, pause) for name, pause in pauses.items()} | {"endless": Endless(clock)}
    result = measure(solvers, budget=6.0)
    assert 1.0 < clock.time < 6.0
    rows = {row.name: row for row in result.rows}
    assert set(rows) == {"good", "slow"}
    assert rows["good"].samples == len(STUDY.time)
    assert set(result.skipped) == {"slower", "endless"}
    assert "too slow for the time that was left" in result.skipped["slower"]
    assert "longer than its share" in result.skipped["endless"]


def test_what_ran_on_less_of_the_motion_is_not_on_the_front(measured):
    accurate = measured.pareto()[-1]
    short = replace(accurate, name="short", samples=80, position=0.1 * accurate.position)
    table = mr.Tradeoff([*measured.rows, short], {}, measured.reference, measured.tips, measured.settle)
    assert table.pareto() == measured.pareto()


def test_what_fails_in_every_sample_is_never_best():
    result = measure({"lost": Lost(), "good": SOLVERS["Newton, fine"]})
    lost = result.rows[0]
    assert lost.failed == lost.samples == len(STUDY.time)
    assert lost.position == lost.rotation == lost.shape == np.inf
    assert [row.name for row in result.pareto()] == ["good"]
    assert result.best(time=1.0).name == "good"
    only = measure({"lost": Lost()})
    with pytest.raises(ValueError, match="no setting has a result in every sample"):
        only.best(error=1.0)
    with pytest.raises(ValueError, match="no setting has a result in every sample"):
        mr.tune(STUDY.robot, STUDY.inputs, time=STUDY.time, rate=1, solvers={"lost": Lost()}, progress=False)


def test_solvers_that_raise_or_cannot_take_the_robot_are_said_and_others_go_on():
    tubes = three_tubes(duration=0.5)
    solvers = {"broken": Broken(), "multiple": mr.MultipleShooting(), "good": mr.Shooting(integrator=mr.RK4(50))}
    result = mr.tradeoff(tubes.robot, tubes.inputs, time=tubes.time, solvers=solvers, progress=False)
    assert [row.name for row in result.rows] == ["good"]
    assert result.skipped["broken"] == "ZeroDivisionError: seven"
    assert "it is not a single rod" in result.skipped["multiple"]
    assert "broken: ZeroDivisionError: seven" in str(result)


def test_what_is_stopped_leaves_its_rows(tmp_path):
    """Ctrl-C in the run of the third setting: two rows stand in the file."""
    path = tmp_path / "rows.csv"
    solvers = {"a": SOLVERS["Newton, coarse"], "b": SOLVERS["Newton, fine"], "c": Broken(error=KeyboardInterrupt, good=50)}
    with pytest.raises(KeyboardInterrupt):
        measure(solvers, csv=path)
    with path.open(encoding="utf-8") as file:
        assert [row["name"] for row in csv.DictReader(file)] == ["a", "b"]
    measurement = Measurement(STUDY.robot, STUDY.inputs, time=STUDY.time, solvers=solvers)
    with pytest.raises(KeyboardInterrupt):
        list(measurement.run())
    assert [row.name for row in measurement.table.rows] == ["a", "b"]
    assert measurement.table.skipped == {"c": "the run ended before"}


def test_rows_are_in_the_file_while_others_run(tmp_path):
    path, lines = tmp_path / "rows.csv", []
    mr.tradeoff(**vars(STUDY), solvers=SOLVERS, csv=path, progress=lambda done: lines.append(len(path.read_text().splitlines())))
    assert lines == [1, 1, 3, 5]  # all are tried first; then two runs for each call, below the header


def test_where_the_tip_is_held_all_of_the_rod_counts():
    """Its holder says where the tip is, however few the steps: within 1e-12 m of the tip was what was off by microns."""
    robot = mr.HeldRod(mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(1, 0, 0)))
    t = 0.01 * np.arange(6)
    inputs = robot.inputs(end_position=np.stack([0.1 * t, 0 * t, -0.02 - t], axis=-1))
    solvers = {f"{n}": mr.Shooting(integrator=mr.RK4(n)) for n in (20, 60)}
    table = mr.tradeoff(robot, inputs, time=t, solvers=solvers, settle=0.0, budget=1e4, progress=False)
    assert table.checked
    few, more = sorted(table.rows, key=lambda row: int(row.name))
    exact = mr.simulate(robot, inputs, time=t, solver=mr.Shooting(integrator=mr.RK45(1e-12, 1e-14)))
    own = mr.simulate(robot, inputs, time=t, solver=solvers["20"])
    off = np.linalg.norm(own.rod(0, nodes=21).position - exact.rod(0, nodes=21).position, axis=-1).max()
    assert few.position == few.shape == pytest.approx(off, rel=1e-6)
    assert 1e-7 < few.position > 20 * more.position  # steps of fourth order, a third as long
    assert np.linalg.norm(own.tip_position - exact.tip_position, axis=-1).max() < 1e-12
    assert [row.name for row in table.fitting(error=0.5 * off)] == ["60"]
    table.reference.history = own  # what is compared with the second reference
    table.reference._compare(robot)
    assert not table.checked


def test_an_assembly_without_shapes_has_the_other_errors(monkeypatch):
    monkeypatch.setattr("multirod.models.backbone.problem.BackboneProblem.shapes", None)
    row = measure({"Newton, fine": SOLVERS["Newton, fine"]}).rows[0]
    assert 0 < row.position < 1e-5
    assert np.isnan(row.shape)


def test_a_model_with_less_is_measured_against_the_full_one():
    """Without the force along z: the error is what leaving it out does, on top of the solver's own."""
    force = STUDY.inputs.tip_force * np.array([1, 1, 0])
    less = STUDY.robot.inputs(rotation=STUDY.inputs.rotation, translation=STUDY.inputs.translation, tip_force=force)
    solvers = {"Newton, fine": SOLVERS["Newton, fine"], "observer": SOLVERS["observer, fine"]}
    result = measure(solvers, models={"without F_z": (STUDY.robot, less)})
    rows = {row.name: row for row in result.rows}
    assert list(rows) == ["Newton, fine", "Newton, fine, without F_z", "observer", "observer, without F_z"]
    assert [row.model for row in result.rows] == ["", "without F_z"] * 2
    assert rows["observer, without F_z"].family == "observer, without F_z"
    run = [mr.simulate(STUDY.robot, i, time=STUDY.time, solver=SOLVERS["Newton, fine"]) for i in (STUDY.inputs, less)]
    apart = np.linalg.norm(run[0].tip_position - run[1].tip_position, axis=1)[STUDY.time >= 0.3].max()
    assert rows["Newton, fine, without F_z"].position == pytest.approx(apart, rel=1e-2)
    tubes = three_tubes(duration=0.5)
    with pytest.raises(ValueError, match=r"models\['tubes'\] = 3 rods is not allowed: must be 1 as the robot's"):
        measure(solvers, models={"tubes": (tubes.robot, tubes.inputs)})


def test_a_robot_that_stands_still_is_measured():
    for inputs in (STUDY.inputs[0], STUDY.inputs[:1]):  # with an axis of one sample, too, as ``simulate`` takes it
        result = mr.tradeoff(STUDY.robot, inputs, time=STUDY.time, solvers=SOLVERS, budget=1e4, settle=0.0, progress=False)
        assert not result.skipped
        assert len(result.rows) == len(SOLVERS)


def test_batches_are_refused():
    inputs = STUDY.robot.inputs(tip_force=np.ones((101, 2, 3)))
    with pytest.raises(ValueError, match=r"inputs = leading axes \(101, 2\) is not allowed: there must be one, time"):
        mr.tradeoff(STUDY.robot, inputs, time=STUDY.time, solvers=SOLVERS)
    two = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=[0.2, 0.3], torsional_stiffness=0.06))
    with pytest.raises(ValueError, match="there must be one, time"):
        mr.tradeoff(two, two.inputs(tip_force=np.ones((101, 1, 3))), time=STUDY.time, solvers=SOLVERS)
    with pytest.raises(TypeError, match="solvers.*must be a Solver such as"):
        measure({"none": 3})


def test_a_tuned_setting_keeps_its_promise():
    setting = mr.tune(STUDY.robot, STUDY.inputs, time=STUDY.time, error=1e-5, solvers=SOLVERS, progress=False)
    again = measure({"again": setting.solver})
    assert again.rows[0].position <= 1e-5
    # a rate that all of them keep up with by four decades, so that a busy machine does not choose
    fast = mr.tune(STUDY.robot, STUDY.inputs, time=STUDY.time, rate=1, solvers=SOLVERS, progress=False)
    assert fast.slow < 1
    # the first samples are not counted, and start elsewhere: from there on it is the same run
    assert fast.position == pytest.approx(min(row.position for row in measure(SOLVERS).rows), rel=1e-6)
    with pytest.raises(TypeError, match="takes error= .* or rate= "):
        mr.tune(STUDY.robot, STUDY.inputs, time=STUDY.time)


def test_a_promise_that_holds_on_a_part_of_the_motion_only_is_not_made(monkeypatch):
    """The force trebles after 3 s; the grid ran on the calm part. What is promised holds for all of it."""
    study = motion(duration=4.0)
    wild = study.inputs.tip_force * np.where(study.time < 3, 1.0, 3.0)[:, None]
    inputs = study.robot.inputs(rotation=study.inputs.rotation, translation=study.inputs.translation, tip_force=wild)
    two = {"coarse": SOLVERS["Newton, coarse"], "fine": SOLVERS["Newton, fine"]}
    monkeypatch.setattr(Measurement, "_common", lambda self, trials: 500)  # as if there were time for so many samples
    measurement = Measurement(study.robot, inputs, time=study.time, solvers=two)
    coarse, fine = (row for _, row in measurement.run() if row is not None)
    assert coarse.samples == fine.samples == 500
    whole = measurement.repeat("coarse").position
    promised = 0.5 * (coarse.position + whole)
    assert coarse.position < promised < whole
    chosen = kept(measurement, error=promised)
    assert (chosen.name, chosen.samples) == ("fine", 801)


def test_a_rate_that_nothing_keeps_up_with_is_refused_with_what_there_is(clock):
    slow = {"slow": Slow(clock, 0.01)}
    with pytest.raises(
        ValueError, match=r"rate = 200 is not allowed: the fastest setting, slow, takes 10[0-9]{3} µs .* samples a second"
    ):
        mr.tune(STUDY.robot, STUDY.inputs, time=STUDY.time, rate=200, solvers=slow, progress=False)


def test_the_default_grid_has_the_forms_that_make_a_difference_to_the_robot():
    tried = [mr.RK4(10), mr.RK45()]
    wire = grid(STUDY.robot, STUDY.inputs, tried=tried)
    assert len(wire) == 2 * (4 + 4 + 1) + 3
    assert {type(solver) for solver in wire.values()} == {mr.Shooting, mr.Observer, mr.EnergyDescent, mr.ScipyShooting}
    tubes = three_tubes(duration=0.5)
    assert any(isinstance(solver, mr.EnergyDescent) for solver in grid(tubes.robot, tubes.inputs, tried=tried).values())
    couplings = [s.coupling for s in grid(tubes.robot, tubes.inputs, tried=tried).values() if isinstance(s, mr.Observer)]
    assert [couplings.count(c) for c in ("full", "per-rod", "per-rod-plain")] == [8, 4, 1]
    registered = settings(STUDY.robot, STUDY.inputs, wire, {})
    assert registered.keys() == wire.keys()
    assert any(name.startswith("multiple_shooting") for name in Measurement(**vars(STUDY)).settings)
    with pytest.raises(ValueError, match="solvers = {} is not allowed"):
        measure({})
    with pytest.raises(ValueError, match="settle = 3 is not allowed"):
        measure(SOLVERS, settle=3)


def test_solvers_are_written_as_short_as_they_can_be():
    for solver in grid(STUDY.robot, STUDY.inputs).values():
        assert eval(code(solver), PUBLIC) == solver
    assert code(mr.Shooting(integrator=mr.RK4(20)), "mr.") == "mr.Shooting(integrator=mr.RK4(20))"
    assert code(mr.RK45(1e-6, 1e-9, steps=7)) == "RK45(1e-06, 1e-09, steps=7)"
    names = [code(integrator) for integrator in integrators()]
    assert len(set(names)) == len(names)


def test_plots_are_written(measured, tmp_path):
    pytest.importorskip("matplotlib", reason="an extra: plot")
    for ending in ("png", "svg"):
        measured.plot(tmp_path / f"front.{ending}", time="slow")
        assert (tmp_path / f"front.{ending}").stat().st_size > 5000
    with pytest.raises(ValueError, match="must end in .* or .png or"):
        measured.plot(tmp_path / "front.docx")


def test_plots_are_drawn_on_axes_that_are_given(measured):
    plt = pytest.importorskip("matplotlib.pyplot", reason="an extra: plot")
    ax = plt.figure().add_subplot()
    assert measured.plot(ax=ax, title="mine") is ax
    assert {line.get_label() for line in ax.lines} >= {row.family for row in measured.rows if np.isfinite(row.position)}
    assert ax.get_title() == "mine"
    own = measured.plot()
    assert own.figure is not ax.figure
    plt.close("all")


def test_plots_without_matplotlib_say_what_to_install(measured, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r'pip install "multirod\[plot\]"'):
        measured.plot(tmp_path / "front.png")


def test_a_recording_shows_every_setting_and_the_errors_of_the_best(measured, tmp_path):
    path = tmp_path / "tradeoff.rrd"
    measured.save(path)
    chunks = list(RrdReader(str(path)).stream().collect().stream())
    points = {}
    for chunk in chunks:
        if str(chunk.entity_path).startswith("/work_precision/settings/"):
            batch = chunk.to_record_batch()
            for label in batch.column("Points2D:labels").to_pylist()[0]:
                points[label.split(":")[0]] = chunk.is_static
    assert points == dict.fromkeys(SOLVERS, True)
    front = measured.pareto()
    errors = {str(chunk.entity_path): chunk for chunk in chunks if str(chunk.entity_path).startswith("/error/tip_log10/")}
    assert len(errors) == len(front)
    chunk = next(
        c
        for c in chunks
        if front[-1].name.replace(" ", "\\ ").replace(",", "\\,") in str(c.entity_path)
        and not c.is_static
        and str(c.entity_path).startswith("/error")
    )
    values = np.array([value[0].as_py() for value in chunk.to_record_batch().column("Scalars:scalars")])
    tips = measured.tips[front[-1].name] - measured.reference.history.tip_position
    np.testing.assert_allclose(10 ** values[60:], np.linalg.norm(tips, axis=1)[60:], rtol=1e-9)
    with pytest.raises(ValueError, match="there is nothing to show"):
        measure({"lost": Lost()}).save(tmp_path / "none.rrd")
    with pytest.raises(ValueError, match=r"save.path = .* is not allowed"):
        measured.save(tmp_path / "no" / "folder.rrd")


def test_models_leave_out_what_a_scene_can_do_without():
    rod = mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.15, linear_density=0.002)
    robot = mr.SingleRod(rod)
    inputs = robot.inputs(tip_force=(0.4, 0, 0), gravity=(0, 0, -9.81))
    models = mr.explain(robot, inputs).models()
    assert models.keys() == {"without gravity"}
    lighter, given = models["without gravity"]
    assert lighter.rods == robot.rods
    assert given.active == ("tip_force",)
