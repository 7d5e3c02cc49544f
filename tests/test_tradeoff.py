"""Speed against accuracy: what is measured is so, and what is promised is kept."""

import csv

import numpy as np
import pytest

import multirod as mr
from multirod.experiment import motion
from multirod.tradeoffs import grid

STUDY = motion(duration=0.5)
SOLVERS = {
    "Newton, coarse": mr.Shooting(integrator=mr.RK4(10)),
    "Newton, fine": mr.Shooting(integrator=mr.RK4(50)),
    "observer, fine": mr.Observer(integrator=mr.RK4(50)),
    "observer, fed forward": mr.Observer(feed_forward=True, integrator=mr.RK4(50)),
}


@pytest.fixture(scope="module")
def measured() -> mr.Tradeoff:
    return mr.tradeoff(STUDY.robot, STUDY.inputs, time=STUDY.time, solvers=SOLVERS, progress=False)


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
    with pytest.raises(ValueError, match=r"error = 1e-20 is not allowed: the most accurate setting is off by"):
        measured.best(error=1e-20)
    with pytest.raises(ValueError, match=r"time = 1e-09 is not allowed: the fastest setting takes"):
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
    assert eval(rows[0]["solver"], vars(mr)) == SOLVERS["Newton, coarse"]  # ready to be pasted
    text = str(measured)
    assert all(name in text for name in SOLVERS)
    assert "agree within" in text


def test_a_reference_that_cannot_be_checked_is_said(monkeypatch, measured):
    monkeypatch.setattr("multirod.tradeoffs.CHECK", mr.Shooting(tolerance=1e-11, integrator=mr.RK4(20)))
    few = {"Newton, coarse": SOLVERS["Newton, coarse"]}
    result = mr.tradeoff(STUDY.robot, STUDY.inputs, time=STUDY.time, solvers=few, progress=False)
    assert not result.checked
    assert "DO NOT AGREE" in str(result)
    with pytest.raises(ValueError, match="the reference could not be checked"):
        mr.tune(STUDY.robot, STUDY.inputs, time=STUDY.time, error=1e-3, solvers=few, progress=False)


def test_the_budget_is_kept():
    """What is left runs on fewer samples, then not at all."""
    result = mr.tradeoff(STUDY.robot, STUDY.inputs, time=STUDY.time, solvers=SOLVERS, budget=1e-6, progress=False)
    assert result.skipped
    assert set(result.skipped) | {row.name for row in result.rows} == set(SOLVERS)
    assert "no time was left for" in str(result)


def test_a_tuned_setting_keeps_its_promise():
    setting = mr.tune(STUDY.robot, STUDY.inputs, time=STUDY.time, error=1e-5, solvers=SOLVERS, progress=False)
    again = mr.tradeoff(STUDY.robot, STUDY.inputs, time=STUDY.time, solvers={"again": setting.solver}, progress=False)
    assert again.rows[0].position <= 1e-5
    fast = mr.tune(STUDY.robot, STUDY.inputs, time=STUDY.time, rate=20, solvers=SOLVERS, progress=False)
    assert fast.slow < 1 / 20
    assert fast.position == min(
        row.position for row in mr.tradeoff(STUDY.robot, STUDY.inputs, time=STUDY.time, solvers=SOLVERS).rows
    )
    with pytest.raises(TypeError, match="takes error or rate"):
        mr.tune(STUDY.robot, STUDY.inputs, time=STUDY.time)


def test_the_default_grid_has_each_form_with_each_integrator():
    settings = grid([mr.RK4(10), mr.RK45()])
    assert len(settings) == 14
    assert {type(solver) for solver in settings.values()} == {mr.Shooting, mr.Observer}
    with pytest.raises(ValueError, match="solvers = {} is not allowed"):
        mr.tradeoff(STUDY.robot, STUDY.inputs, time=STUDY.time, solvers={})
    with pytest.raises(ValueError, match="settle = 3 is not allowed"):
        mr.tradeoff(STUDY.robot, STUDY.inputs, time=STUDY.time, settle=3)


def test_plots_are_written(measured, tmp_path):
    pytest.importorskip("matplotlib", reason="an extra: plot")
    for ending in ("png", "svg"):
        measured.plot(tmp_path / f"front.{ending}", time="slow")
        assert (tmp_path / f"front.{ending}").stat().st_size > 5000
