"""Plots: that what is drawn is what was solved, and that axes, colours and titles are as they are said to be."""

import importlib.util
import re
import sys
from pathlib import Path
from runpy import run_path

import matplotlib
import numpy as np
import pytest

import multirod as mr
from multirod.plotting.plots import OF_HISTORIES, OF_SOLUTIONS
from multirod.results.strains import strains

matplotlib.use("Agg")
plt = pytest.importorskip("matplotlib.pyplot")

ROOT = Path(__file__).parent.parent
SOLVER = mr.Shooting(integrator=mr.RK4(20))  # as in test_recording.py, whose kernels these are
NODES = 1e-6  # [m]: shapes are integrated over other nodes than tips, and instances are millimetres apart
TUBES = [
    mr.Rod(length=0.30, bending_stiffness=0.004, torsional_stiffness=0.003, precurvature=(9, 0, 0), name="inner"),
    mr.Rod(length=0.22, bending_stiffness=0.017, torsional_stiffness=0.014, precurvature=[(0.1, (0, 0, 0)), (0.12, (5, 0, 0))]),
    mr.Rod(length=0.12, bending_stiffness=0.040, torsional_stiffness=0.030, name="outer"),
]


@pytest.fixture(autouse=True)
def _closed():
    """And nothing that a user has set is changed."""
    before = dict(matplotlib.rcParams)
    yield
    plt.close("all")
    assert dict(matplotlib.rcParams) == before


def make_robot(**options):
    return mr.SingleRod(
        mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(3, 1, 0), **options)
    )


@pytest.fixture(scope="module")
def robot():
    return make_robot(outer_diameter=3e-3)


@pytest.fixture(scope="module")
def solution(robot):
    return mr.solve(robot, robot.inputs(rotation=0.3, tip_force=(0.3, 0.1, 0)), solver=SOLVER)


@pytest.fixture(scope="module")
def batch(robot):
    force = np.linspace(-0.5, 0.5, 30).reshape(6, 5, 1) * [1, 0, 0]
    return mr.solve(robot, robot.inputs(tip_force=force), solver=SOLVER).raise_if_failed()


@pytest.fixture(scope="module")
def history(robot):
    """Samples 10 to 14 fail: the force jumps, and a few iterations do not follow it."""
    tip_force = np.zeros((20, 3))
    tip_force[:, 0] = 0.1 + 0.01 * np.arange(20)
    tip_force[10:15, 1] = 60.0
    solver = mr.Shooting(integrator=mr.RK4(20), max_iterations=3, max_continuation_steps=2)
    result = mr.simulate(robot, robot.inputs(tip_force=tip_force), time=0.02 * np.arange(20), solver=solver)
    np.testing.assert_array_equal(np.isnan(result.tip_position[:, 0]), [10 <= k < 15 for k in range(20)])
    return result


@pytest.fixture(scope="module")
def tubes():
    robot = mr.ConcentricTubes(TUBES)
    return mr.solve(robot, robot.inputs(rotation=(0.6, 0.3, 0), translation=(-0.12, -0.1, -0.05)))


def in_space(ax):
    """Nodes of every line (node, 3)."""
    return [np.array(line.get_data_3d()).T for line in ax.lines]


def drawn(ax, nodes):
    """The line that is drawn through these nodes."""
    found = [line for line, own in zip(ax.lines, in_space(ax), strict=True) if own.shape == nodes.shape and (own == nodes).all()]
    assert len(found) == 1
    return found[0]


def labels(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()] if ax.get_legend() else []


def with_result(history):
    return np.isfinite(history.tip_position[:, 0])


def test_the_shape_is_drawn_to_scale_with_frames_and_loads(solution):
    ax = solution.plot()
    drawn(ax, solution.rod(0, nodes=51).position)
    limits = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
    extent = np.ptp(limits, axis=1)
    np.testing.assert_allclose(extent / ax._box_aspect, (extent / ax._box_aspect)[0], rtol=1e-9)
    nodes = solution.rod(0).position
    assert ((nodes >= limits[:, 0]) & (nodes <= limits[:, 1])).all()
    axes = [own[1] - own[0] for own in in_space(ax) if len(own) == 2]  # three of the base, three of the tip
    turned = np.concatenate([np.eye(3), solution.tip_rotation.T])
    np.testing.assert_allclose([axis / np.linalg.norm(axis) for axis in axes], turned, atol=1e-12)
    (arrow,) = [c for c in ax.collections if c.get_label() == "tip force 0.316 N"]
    end, origin = np.array(arrow._segments3d[0])
    np.testing.assert_allclose(origin, solution.tip_position, atol=1e-12)
    np.testing.assert_allclose((end - origin) / np.linalg.norm(end - origin), np.array([3, 1, 0]) / np.sqrt(10), atol=1e-12)
    assert labels(ax) == ["tip force 0.316 N"]
    plain = solution.plot(frames=False, loads=False)
    assert len(plain.lines) == 1
    assert not plain.collections


def test_axes_are_taken_and_returned_and_no_figure_of_others_is_touched(solution):
    other = plt.figure()
    empty = other.add_subplot()
    assert solution.plot().figure is not other
    assert not empty.lines
    figure = plt.figure()
    space, flat = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    assert solution.plot(ax=space) is space
    assert solution.plot("moment", ax=flat) is flat
    with pytest.raises(ValueError, match="ax = .* must be 3-D axes"):
        solution.plot(ax=flat)
    with pytest.raises(ValueError, match="ax = .* must be 2-D axes"):
        solution.plot("moment", ax=space)


def test_a_second_shape_in_the_same_axes_leaves_the_first_in_view(solution, batch):
    ax = solution.plot()
    batch[0, 0].plot(ax=ax)
    low, high = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()]).T
    for one in (solution, batch[0, 0]):
        nodes = one.rod(0).position
        assert ((nodes >= low) & (nodes <= high)).all()


@pytest.mark.parametrize(("name", "unit", "symbol"), [("curvature", "1/m", "u"), ("moment", "N m", "m"), ("force", "N", "n")])
def test_components_of_one_rod_are_in_one_axes(solution, name, unit, symbol):
    ax = solution.plot(name, nodes=21)
    shape = solution.rod(0, nodes=21)
    for k, line in enumerate(ax.lines[:3]):
        np.testing.assert_array_equal(line.get_xdata(), shape.arclength)
        np.testing.assert_array_equal(line.get_ydata(), getattr(shape, name)[:, k])
    assert labels(ax) == [f"{symbol}{k}" for k in (1, 2, 3)]
    assert len({line.get_color() for line in ax.lines[:3]} | {line.get_linestyle() for line in ax.lines[:3]}) == 6
    assert ax.get_ylabel() == f"{name} [{unit}]"
    assert ax.get_xlabel() == "arclength s [m]"


def test_several_rods_have_an_axes_for_each_component(tubes):
    axes = tubes.plot("curvature", nodes=21)
    assert axes.shape == (3,)
    assert labels(axes[0]) == ["inner", "rod_1", "outer"]
    for k, ax in enumerate(axes):
        for i, line in enumerate(ax.lines[:3]):
            np.testing.assert_array_equal(line.get_ydata(), tubes.rod(i, nodes=21).curvature[:, k])
    own = plt.subplots(3)[1]
    assert list(tubes.plot("curvature", ax=own)) == list(own)
    with pytest.raises(ValueError, match=r"ax = .* must be 3 2-D axes \(u1, u2, u3\), as of plt.subplots\(3\)"):
        tubes.plot("curvature", ax=own[0])
    for rod in ("inner", 0, -3):
        (line, *_) = tubes.plot("curvature", rod=rod, nodes=21).lines
        np.testing.assert_array_equal(line.get_ydata(), tubes.rod(0, nodes=21).curvature[:, 0])
    with pytest.raises(ValueError, match="rod = 'third' is not allowed"):
        tubes.plot("curvature", rod="third")


def test_tubes_are_as_wide_as_they_are_and_lie_on_what_is_inside(tubes):
    ax = tubes.plot()
    lines = [drawn(ax, tubes.rod(k, nodes=51).position) for k in range(3)]
    widths, orders = [line.get_linewidth() for line in lines], [line.get_zorder() for line in lines]
    assert widths == sorted(set(widths))
    assert orders == sorted(set(orders))
    assert labels(ax) == ["inner", "rod_1", "outer"]
    wide = {}
    for diameter in (2e-3, 4e-3):
        robot = make_robot(outer_diameter=diameter)
        own = mr.solve(robot, robot.inputs(tip_force=(0.3, 0.1, 0)), solver=SOLVER)
        wide[diameter] = drawn(own.plot(loads=False), own.rod(0, nodes=51).position)
    np.testing.assert_allclose(wide[4e-3].get_linewidth(), 2 * wide[2e-3].get_linewidth(), rtol=1e-9)
    robot = make_robot(outer_diameter=[2e-3, 4e-3])
    both = mr.solve(robot, robot.inputs(tip_force=(0.3, 0.1, 0)), solver=SOLVER)
    for k, diameter in enumerate((2e-3, 4e-3)):
        own = drawn(both[k].plot(loads=False), both[k].rod(0, nodes=51).position)
        np.testing.assert_allclose(own.get_linewidth(), wide[diameter].get_linewidth(), rtol=1e-9)


def test_a_platform_and_its_joints_are_where_they_are():
    """The tripod of the recordings' tests."""
    angle = 2 * np.pi * np.arange(3) / 3
    poses = np.tile(np.eye(4), (2, 3, 1, 1))
    poses[:, :, :2, 3] = np.array([0.05, 0.03])[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rod = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, outer_diameter=2e-3)
    robot = mr.ParallelRods(legs=[rod] * 3, base=poses[0], platform=poses[1])
    found = mr.solve(robot, robot.inputs(tip_force=(0.2, 0, -0.3)), solver=mr.Shooting(integrator=mr.RK4(12)))
    ax = found.plot()
    tips = np.array([found.rod(k).position[-1] for k in range(3)])
    (joints,) = [own for line, own in zip(ax.lines, in_space(ax), strict=True) if line.get_label() == "clamped"]
    np.testing.assert_allclose(joints, tips, atol=1e-9)
    (plate,) = [c for c in ax.collections if type(c).__name__ == "Poly3DCollection"]
    corners = plate._faces[0]
    normal = found.tip_rotation[:, 2]
    assert np.ptp(corners @ normal) < 1e-9  # flat, and through its attachments but for half its thickness
    assert abs((corners - tips[0]) @ normal).max() < 2e-3
    assert labels(ax) == ["leg_1", "leg_2", "leg_3", "clamped", "tip force 0.361 N"]
    several = mr.solve(robot, robot.inputs(tip_force=[(0.2, 0, -0.3), (0, 0.2, 0)]), solver=mr.Shooting(integrator=mr.RK4(12)))
    assert len([c for c in several.plot().collections if type(c).__name__ == "Poly3DCollection"]) == 2


def test_lines_say_their_tension():
    line = mr.Tendon(offset=(0.01506, 0), driven="displacement", name="left")
    rod = mr.Rod.tube(length=0.5, outer_diameter=2e-3, young_modulus=200e9, shear_modulus=80e9, lines=[line])
    robot = mr.SingleRod(rod)
    found = mr.solve(robot, robot.inputs(displacement=[0.009]))
    ax = found.plot()
    drawn(ax, found.line("left", nodes=51).position)
    assert labels(ax) == [f"left, {found.tension[0]:.3g} N"]


def test_chambers_say_their_pressure_and_are_within_the_rod():
    robot = run_path(str(ROOT / "examples" / "silicone_segment.py"))["segment"]()
    found = mr.solve(robot, robot.inputs(pressure=(0, 6e4, 6e4), gravity=(0, 0, 9.81)))  # with kernels that other tests need too
    ax = found.plot()
    assert labels(ax) == ["chamber 1, 0 kPa", "chamber 2, 60 kPa", "chamber 3, 60 kPa", "gravity 9.81 m/s²"]
    body = next(line for line in ax.lines if line.get_alpha() == 0.25)
    assert body.get_linewidth() > max(line.get_linewidth() for line in ax.lines if line is not body)


def test_discs_are_around_the_rod():
    robot = make_robot(discs=0.1)
    found = mr.solve(robot, robot.inputs(tip_force=(0.3, 0.1, 0)), solver=SOLVER)
    rims = [own for own in in_space(found.plot()) if len(own) == 25]
    assert len(rims) == 5  # every 0.1 m from the base
    shape = found.rod(0, nodes=5)
    for k, rim in enumerate(rims):
        arms = rim - shape.position[k]
        # a place between nodes is on the chord, at most an eighth of curvature times spacing squared inside
        assert np.linalg.norm(arms[:-1].mean(axis=0)) < 4 * 0.008**2 / 8
        assert abs(arms @ shape.rotation[k, :, 2]).max() < 1e-4


def test_loads_along_the_rod_and_moments_are_drawn(monkeypatch):
    """Of a result as it would be: what a scene of its own needs would be compiled."""
    robot = make_robot(linear_density=0.02)
    found = mr.solve(robot, robot.inputs(tip_force=(0.3, 0.1, 0)), solver=SOLVER)
    loads = robot.inputs(
        distributed_force=lambda s: (0.5 * s, 0, 0), gravity=(0, 0, -9.81), tip_moment=(0, 0.05, 0), follower_force=(0, 0.2, 0)
    )
    monkeypatch.setitem(found.__dict__, "_applied", loads)
    ax = found.plot()
    moment, follower, distributed, gravity = labels(ax)
    assert (moment, follower) == ("tip moment 0.05 N m", "follower force 0.2 N")
    assert (distributed, gravity) == ("distributed force up to 0.2 N/m", "gravity 9.81 m/s²")
    arrows = {c.get_label(): np.swapaxes(c._segments3d, 0, 1) for c in ax.collections}
    assert len(ax.collections) == 5  # a moment has two heads

    def direction(name):
        end, origin = arrows[name][0][0], arrows[name][1][0]
        return (end - origin) / np.linalg.norm(end - origin)

    np.testing.assert_allclose(direction(moment), (0, 1, 0), atol=1e-12)
    np.testing.assert_allclose(direction(follower), found.tip_rotation[:, 1], atol=1e-12)
    np.testing.assert_allclose(direction(gravity), (0, 0, -1), atol=1e-12)
    end, origin = arrows[distributed][:, :9]
    shape = found.rod(0, nodes=51)
    nodes = [int(np.argmin(np.linalg.norm(shape.position - place, axis=1))) for place in origin]
    np.testing.assert_array_equal(origin, shape.position[nodes])
    assert np.diff(nodes).min() > 4
    lengths = (end - origin)[:, 0]
    np.testing.assert_allclose(lengths, lengths[-1] * shape.arclength[nodes] / 0.4, atol=1e-12)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_strains_are_those_of_the_curvature_and_of_the_centreline():
    """Told by moment and stiffness; here by geometry."""
    rod = mr.Rod(
        sections=[
            mr.Section(
                length=0.1, bending_stiffness=0.03, torsional_stiffness=0.02, axial_stiffness=390.0, precurvature=(2, 0, 1)
            ),
            mr.Section(length=0.2, bending_stiffness=(0.02, 0.05), torsional_stiffness=0.015, shear_stiffness=130.0),
        ],
        outer_diameter=4e-3,
    )
    robot = mr.SingleRod(rod)
    found = mr.solve(robot, robot.inputs(translation=0.02, tip_force=(0.1, 0.3, 0.2)))
    shape = found.rod(0, nodes=640)
    own = strains(found, 0, shape)
    first = shape.arclength < 0.12  # what is pushed out of the base continues the first section
    bent = shape.curvature - np.where(first[:, None], (2, 0, 1), 0.0)
    np.testing.assert_allclose(own["bending"], 2e-3 * np.hypot(bent[:, 0], bent[:, 1]), atol=1e-12)
    np.testing.assert_allclose(own["torsion"], 2e-3 * np.abs(bent[:, 2]), atol=1e-12)
    # differences of the centreline are of second order in the spacing; not across the end of a section
    v = np.einsum("sij,si->sj", shape.rotation[1:-1], (shape.position[2:] - shape.position[:-2]) / (2 * shape.arclength[1]))
    smooth = np.abs(shape.arclength[1:-1] - 0.12) > 1e-3
    np.testing.assert_allclose(own["extension"][1:-1][smooth], (v[:, 2] - 1)[smooth], atol=1e-6)
    np.testing.assert_allclose(own["shear"][1:-1][smooth], np.hypot(v[:, 0], v[:, 1])[smooth], atol=1e-6)
    ax = found.plot("strain")
    # the largest of both on the nodes of rod()
    again = found.rod(0)
    first = again.arclength <= 0.12
    bent = again.curvature - np.where(first[:, None], (2, 0, 1), 0.0)
    stretched = np.where(first, np.abs(again.force[:, 2]) / 390.0, 0.0)
    np.testing.assert_allclose(found.strain, [(2e-3 * np.hypot(bent[:, 0], bent[:, 1]) + stretched).max()], atol=1e-12)
    assert labels(ax) == ["bending", "torsion", "extension", "shear"]
    assert ax.get_ylabel() == "strain [%]"
    np.testing.assert_allclose(ax.lines[0].get_ydata(), 100 * strains(found, 0, found.rod(0, nodes=301))["bending"])


def test_strains_of_some_instances_of_rods_that_vary():
    lengths = np.array([0.3, 0.4, 0.35])
    rod = mr.Rod(length=lengths, bending_stiffness=np.array([[0.2], [0.1], [0.3]]), torsional_stiffness=0.06, outer_diameter=3e-3)
    robot = mr.SingleRod(rod)
    found = mr.solve(robot, robot.inputs(tip_force=(0.3, 0.1, 0)), solver=SOLVER)
    every = strains(found, 0, found.rod(0, nodes=11))["bending"]
    one = strains(found[2], 0, found[2].rod(0, nodes=11))["bending"]
    np.testing.assert_array_equal(one, every[2])
    bent = found.rod(0, nodes=11).curvature
    np.testing.assert_allclose(every, 1.5e-3 * np.hypot(bent[..., 0], bent[..., 1]), atol=1e-12)


def test_the_largest_strain_of_each_rod_is_nan_where_there_is_none(history, batch, tubes):
    assert history.strain.shape == (20, 1)
    np.testing.assert_array_equal(np.isnan(history.strain[:, 0]), history.failed)
    assert batch.strain.shape == (6, 5, 1)
    bent = batch.rod(0).curvature - (3, 1, 0)
    np.testing.assert_allclose(batch.strain[..., 0], 1.5e-3 * np.hypot(bent[..., 0], bent[..., 1]).max(axis=-1), atol=1e-12)
    np.testing.assert_array_equal(batch[1:3].strain, batch.strain[1:3])
    np.testing.assert_array_equal(tubes.strain, [np.nan] * 3)  # no diameters
    assert not batch.strain.flags.writeable


def test_a_name_that_is_none_is_refused_with_what_was_meant(history, solution, tmp_path):
    for call in (solution.plot, history.plot, lambda **given: history.save(tmp_path / "run.rrd", **given)):
        with pytest.raises(TypeError, match=r"takes no 'color_by': it takes .*; did you mean 'colour_by'\?"):
            call(color_by="energy")
    assert not (tmp_path / "run.rrd").exists()


def test_strain_without_diameter_or_compliance_is_refused(tubes):
    with pytest.raises(ValueError, match="quantity = 'strain' is not allowed: no rod has an outer_diameter"):
        tubes.plot("strain")


def test_a_batch_is_a_family_evenly_chosen(batch):
    ax = batch.plot(instances=4, frames=False)
    chosen = [0, 10, 19, 29]
    flat = batch.tip_position.reshape(-1, 3)
    np.testing.assert_allclose([own[-1] for own in in_space(ax)], flat[chosen], atol=NODES)
    assert ax.get_title() == "4 of 30 instances"
    assert len(in_space(batch.plot(frames=False))) == 20
    every = batch.plot(frames=False, instances=1000)
    assert len(in_space(every)) == 30
    assert every.get_title() == ""


def test_tips_are_points_of_all_instances(batch, history, solution):
    flat = batch.tip_position.reshape(-1, 3)
    ax = batch.plot("tips", colour_by="energy", frames=False)
    (points,) = ax.collections
    np.testing.assert_array_equal(np.stack(points._offsets3d, axis=1), flat)
    np.testing.assert_array_equal(points.get_array(), batch.energy.reshape(-1))
    assert ax.figure.axes[-1].get_ylabel() == "elastic energy [J]"
    assert not ax.get_title()
    few = batch.plot("tips", instances=4)
    np.testing.assert_array_equal(np.stack(few.collections[0]._offsets3d, axis=1), flat[[0, 10, 19, 29]])
    assert few.get_title() == "4 of 30 instances"
    for one in (solution, history):
        count = np.count_nonzero(~np.asarray(one.failed))
        assert np.stack(one.plot("tips").collections[0]._offsets3d, axis=1).shape == (count, 3)


def test_a_family_is_coloured_by_what_is_asked_for(batch):
    force = batch.inputs.tip_force[..., 0]
    ax = batch.plot("moment", colour_by=-force, colour_label="pull [N]", instances=30)[0]
    bar = ax.figure.axes[-1]
    assert bar.get_ylabel() == "pull [N]"
    np.testing.assert_allclose(bar.get_ylim(), (-0.5, 0.5))
    light = [sum(line.get_color()[:3]) for line in ax.lines[:30]]
    assert (np.diff(light) < 0).all()  # the colour map is ordered by lightness, and so is whoever reads it in grey
    np.testing.assert_array_equal(ax.lines[7].get_ydata(), batch.rod(0, nodes=301).moment[1, 2, :, 0])
    by_name = batch.plot(colour_by="energy").figure.axes[-1]
    assert by_name.get_ylabel() == "elastic energy [J]"
    with pytest.raises(ValueError, match=r"colour_by = array of shape \(4,\) .* must have the batch's shape, \(6, 5\)"):
        batch.plot(colour_by=np.zeros(4))
    with pytest.raises(ValueError, match="colour_by = 'weight' .* or one of 'residual', 'condition'"):
        batch.plot(colour_by="weight")
    values = np.where(force > 0, np.nan, force)
    grey = batch.plot("moment", colour_by=values, instances=30)[0].lines[29].get_color()
    np.testing.assert_allclose(grey, (0.65, 0.65, 0.65, 1))
    with pytest.raises(ValueError, match="must be None: there is no batch axis"):
        batch[0, 0].plot(colour_by=[1.0])


def test_what_failed_is_left_out_and_said(history):
    some = history[5:15]
    ax = some.plot(frames=False)
    np.testing.assert_allclose([own[-1] for own in in_space(ax)], history.tip_position[5:10], atol=NODES)
    assert ax.get_title() == "5 of 10 without a result: MAX_ITERATIONS"
    assert some.plot("force")[0].get_title() == ax.get_title()
    one = history[12].plot(frames=False)
    assert not one.lines
    assert one.get_title() == "no result: MAX_ITERATIONS"
    assert history[12].plot("curvature").get_title() == one.get_title()
    assert not history[10:15].plot(frames=False).lines


def test_a_motion_is_drawn_at_some_times_with_the_path_of_its_tip(history):
    ax = history.plot(instances=3, frames=False)
    path, *shapes = in_space(ax)
    np.testing.assert_array_equal(path, history.tip_position)
    sound = np.flatnonzero(with_result(history))
    np.testing.assert_allclose([own[-1] for own in shapes], history.tip_position[sound[[0, 7, 14]]], atol=NODES)
    assert ax.get_title() == "3 of 20 samples; 5 of 20 without a result: MAX_ITERATIONS"
    bar = ax.figure.axes[-1]
    assert bar.get_ylabel() == "time [s]"
    np.testing.assert_allclose(bar.get_ylim(), (0, 0.38))
    with pytest.raises(ValueError, match="must be None: shapes and curves of a motion are coloured by time"):
        history.plot(colour_by=history.time)


def test_curves_over_time_mark_what_failed(history):
    ax = history.plot("tip")
    for k in range(3):
        np.testing.assert_array_equal(ax.lines[k].get_ydata(), history.tip_position[:, k])
        np.testing.assert_array_equal(ax.lines[k].get_xdata(), history.time)
    (crosses,) = [line for line in ax.lines if line.get_marker() == "x"]
    np.testing.assert_array_equal(crosses.get_xdata(), history.time[10:15])
    assert labels(ax) == ["x", "y", "z", "no result in 5 of 20 samples: MAX_ITERATIONS"]
    np.testing.assert_array_equal(history.plot("step_time").lines[0].get_ydata(), 1e3 * history.step_time)
    assert history.plot("residual").get_yscale() == "log"


def test_zero_has_a_place_on_a_logarithmic_axis(robot):
    still = mr.simulate(robot, robot.inputs(), time=[0.0, 0.1, 0.2], solver=SOLVER)
    assert (still.residual == 0).all()
    np.testing.assert_array_equal(still.plot("residual").lines[0].get_ydata(), 1e-16)


@pytest.fixture(scope="module")
def motions(robot):
    inputs = robot.inputs(rotation=np.linspace(0, 0.3, 30).reshape(5, 3, 2)[..., None], tip_force=(0, 0.1, 0))
    return mr.simulate(robot, inputs, time=0.02 * np.arange(5), solver=SOLVER)


def test_a_batch_of_motions(motions):
    axes = motions.plot("tip", instances=3)
    assert axes.shape == (3,)
    for k, ax in enumerate(axes):
        curves = [line.get_ydata() for line in ax.lines]
        np.testing.assert_array_equal(np.transpose(curves), motions.tip_position.reshape(5, 6, 3)[:, [0, 2, 5], k])
    assert axes[0].get_title() == "3 of 6 instances"
    for instance in (5, (2, 1)):
        ax = motions.plot(instance=instance, frames=False)
        np.testing.assert_array_equal(in_space(ax)[0], motions.tip_position[:, 2, 1])
        assert ax.get_title() == f"instance {instance} of 6"
    with pytest.raises(ValueError, match="instance = 6 is not allowed"):
        motions.plot(instance=6)
    with pytest.raises(ValueError, match=r"instance = \(0,\) is not allowed: .* batch axes \(3, 2\)"):
        motions.plot(instance=(0,))
    with pytest.raises(ValueError, match=r"colour_by = 'energy' is not allowed: must be an array of shape \(3, 2\)"):
        motions.plot("tip", colour_by="energy")
    inputs = motions.plot("inputs")
    assert [ax.get_ylabel() for ax in inputs] == ["rotation\n[rad]", "tip_force x [N]", "tip_force y [N]", "tip_force z [N]"]


@pytest.mark.parametrize("quantity", [name for name in OF_HISTORIES if name not in ("tension", "line_length", "force", "strain")])
def test_every_quantity_is_drawn(motions, quantity):
    axes = np.ravel(np.asarray(motions.plot(quantity, instances=2), dtype=object))
    assert all(ax.lines for ax in axes)
    if quantity in ("shape", "inputs", "residual"):
        axes[0].figure.canvas.draw()


def test_lines_over_time_are_refused_where_there_are_none(history):
    for name in ("tension", "line_length"):
        with pytest.raises(ValueError, match=f"quantity = '{name}' is not allowed: no rod has lines"):
            history.plot(name)


def test_a_quantity_that_is_not_there_lists_those_that_are(solution, history):
    with pytest.raises(ValueError, match="quantity = 'bend' .* must be one of 'shape', 'tips', 'curvature', 'moment', 'force'"):
        solution.plot("bend")
    with pytest.raises(ValueError, match="quantity = 'tip' is not allowed"):
        solution.plot("tip")
    with pytest.raises(ValueError, match="'strain', 'tension', 'tip'.*'step_time', 'line_length'"):
        history.plot("time")


def test_quantities_are_documented():
    page = (ROOT / "docs" / "plotting.md").read_text(encoding="utf-8")
    for name in OF_HISTORIES:
        assert f'`"{name}"`' in page, name
        assert f"``{name}``" in mr.History.plot.__doc__, name
    for name in OF_SOLUTIONS:
        assert f"``{name}``" in mr.Solution.plot.__doc__, name


def test_an_assembly_without_shapes_says_so(solution, monkeypatch):
    monkeypatch.setattr("multirod.models.backbone.problem.BackboneProblem.shapes", None)
    monkeypatch.setattr(solution, "_last_shapes", None)
    with pytest.raises(NotImplementedError, match="SingleRod offers no shapes"):
        solution.plot()


def test_without_matplotlib_the_extra_is_named(solution, history, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    for plot in (solution.plot, history.plot):
        with pytest.raises(ImportError, match=r'pip install "multirod\[plot\]"'):
            plot()
    with pytest.raises(ImportError, match=r'pip install "multirod\[plot\]"'):
        history.plot("tip")


def test_the_pictures_of_pages_are_made_by_their_code(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("make_plots", ROOT / "docs" / "make_plots.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for name, pictures in module.PICTURES.items():
        page = (ROOT / name).read_text(encoding="utf-8")
        assert set(re.findall(r"images/(plot_.*?|readme)\.png", page)) == set(pictures)
        for line in pictures.values():
            assert f"\n{line}" in page
    page, pictures = ROOT / "docs" / "plotting.md", module.PICTURES["docs/plotting.md"]
    monkeypatch.chdir(tmp_path)
    module.draw(page, pictures, tmp_path)
    for name in pictures:
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
        assert 10_000 < (ROOT / "docs" / "images" / f"{name}.png").stat().st_size < 150_000


def test_tensions_are_drawn_along_rods_where_lines_are():
    lines = [mr.Tendon((0.006, 0), name="long", friction=0.2), mr.Tendon((0, 0.006), end=0.1)]
    robot = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077, lines=lines))
    found = mr.solve(robot, robot.inputs(tension=(1.5, 0.8)))
    ax = found.plot("tension", nodes=41)
    assert ax.get_ylabel() == "tension [N]"
    drawn_by_name = {line.get_label(): line.get_ydata() for line in ax.lines[:2]}
    assert list(drawn_by_name) == ["long", "line 2"]
    for k, values in enumerate(drawn_by_name.values()):
        np.testing.assert_allclose(values, found.line(k, nodes=41).tension)
    assert drawn_by_name["long"][0] == 1.5 > drawn_by_name["long"][-1]
    assert np.isnan(drawn_by_name["line 2"][-1])
    bare = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.01, torsional_stiffness=0.0077))
    with pytest.raises(ValueError, match="no rod has lines"):
        mr.solve(bare, bare.inputs()).plot("tension")
