"""What a scene asks for, what dropping a term truly does against what is promised, and dropping by a bound."""

import os
from math import inf, pi

import numpy as np
import pytest
from dropping import BOUNDS, FAMILIES, SOLVER, measure
from test_conformance import SCENES

import multirod as mr
from multirod import profile
from multirod.models.backbone.influence.envelope import LOADS
from multirod.studies.terms import simplified

COUNT = int(os.environ.get("MULTIROD_SCENES", "100"))  # random scenes of a family; 1000 take a minute each
TRUE = 0.99  # of the scenes, at least, whose tips stay within the bound asked for
# Of the scenes, in how many something is dropped at least at bounds of 1e-2 and 1e-6; of the terms that truly could be, how many.
DROPPED = {"rods": (0.7, 0.35), "columns": (0.45, 0.1), "tubes": (0.8, 0.35), "legs": (0.75, 0.25)}
SHARP = {"rods": 0.65, "columns": 0.4, "tubes": 0.65, "legs": 0.5}


def straight(**options) -> mr.SingleRod:
    """A straight rod of unit length and stiffness."""
    return mr.SingleRod(
        mr.Rod(**{"length": 1.0, "bending_stiffness": 1.0, "torsional_stiffness": 0.8, "linear_density": 1.0} | options)
    )


def moved(robot: mr.Assembly, inputs: mr.Inputs, *names: str) -> float:
    """How far dropping terms moves the tips, at most."""
    full = mr.solve(robot, inputs, solver=SOLVER).raise_if_failed()
    less = mr.solve(*mr.explain(robot, inputs).without(*names), solver=SOLVER).raise_if_failed()
    return float(np.linalg.norm(full.tip_position - less.tip_position, axis=-1).max())


# ---- what is promised ----


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_tips_stay_within_the_bound_asked_for(family):
    found = measure(FAMILIES[family](np.random.default_rng(2026), COUNT))
    for bound in BOUNDS:
        assert found[bound].scenes > 0.8 * COUNT
        assert found[bound].broken <= (1 - TRUE) * found[bound].scenes, (bound, found[bound])
    for bound, least in zip((BOUNDS[0], BOUNDS[-1]), DROPPED[family], strict=True):
        assert found[bound].dropped >= least * found[bound].scenes, (bound, found[bound])
    assert sum(m.terms for m in found.values()) >= SHARP[family] * sum(m.possible for m in found.values())


@pytest.mark.parametrize(
    ("load", "coefficient"),
    [
        ({"tip_force": (1, 0, 0)}, 1 / 3),
        ({"tip_moment": (0, 1, 0)}, 1 / 2),
        ({"distributed_force": (1, 0, 0)}, 1 / 8),
        ({"gravity": (1, 0, 0)}, 1 / 8),
        ({"distributed_moment": (0, 1, 0)}, 1 / 3),
        ({"follower_force": (1, 0, 0)}, 1 / 3),
        ({"follower_moment": (0, 1, 0)}, 1 / 2),
    ],
)
def test_a_small_load_counts_as_on_a_cantilever(load, coefficient):
    length, EI, density, small = 0.5, 3.0, 0.7, 1e-4
    robot = straight(length=length, bending_stiffness=EI, torsional_stiffness=EI, linear_density=density)
    ((name, value),) = load.items()
    power = {"tip_force": 2, "follower_force": 2, "tip_moment": 1, "follower_moment": 1, "distributed_moment": 2}.get(name, 3)
    unit = EI / length**power / (density if name == "gravity" else 1.0)
    term = mr.explain(robot, robot.inputs(**{name: small * unit * np.array(value)}))[name]
    assert term.error == pytest.approx(small * coefficient, rel=2e-3)  # the grid of the bound
    assert term.group == pytest.approx(small)


def test_shear_and_extension_count_by_the_force_and_its_moment():
    """A force across moves the tip by F L/GA more; along, by F L/EA."""
    robot = straight(shear_stiffness=1e4, axial_stiffness=3e4)
    for force, stiffness in ((1e-3, 1e4), (1e-2, 1e4)):
        error = mr.explain(robot, robot.inputs(tip_force=(force, 0, 0)))["shear"].error
        assert error == pytest.approx(force / stiffness, rel=0.02)
    assert moved(robot, robot.inputs(tip_force=(0.01, 0, 0)), "shear") == pytest.approx(0.01 / 1e4, rel=1e-2)


def test_every_load_is_within_its_bound():
    """All loads at once on a curved, sheared rod with unequal axes; each instance of the batch lacks one of them."""
    random = np.random.default_rng(5)
    robot = straight(
        bending_stiffness=(1.0, 1.4),
        shear_stiffness=(50.0, 80.0),
        axial_stiffness=100.0,
        precurvature=(0.8, -0.5, 0.6),
        magnetisation=(0.4, 0.2, 1.0),
    )
    values = {name: 0.04 * random.standard_normal(3) for name in LOADS}
    present = {name: np.array([1.0] + [float(other != name) for other in LOADS]) for name in LOADS}
    found = mr.explain(robot, robot.inputs(**values))
    inputs = robot.inputs(**{name: value * present[name][:, None] for name, value in values.items()})
    tips = mr.solve(robot, inputs, solver=SOLVER).raise_if_failed().tip_position
    for name, tip in zip(LOADS, tips[1:], strict=True):
        change = np.linalg.norm(tip - tips[0])
        assert 0.02 * found[name].error < change < found[name].error < inf, name
    assert moved(robot, robot.inputs(tip_force=values["tip_force"]), "shear", "torsion") < np.inf


def curved(s: float) -> tuple[float, float, float]:
    """A precurvature whose value at the base is far from its mean."""
    return 1.5 * (s - 1) ** 4, 0.2 * s, 0.1 * s


@pytest.mark.parametrize("translation", [0.0, 2.0])
def test_a_varying_precurvature_is_within_its_bound(translation):
    """Also where what is pushed out of the base goes on as the rod begins."""
    robot = mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8, precurvature=curved))
    inputs = robot.inputs(tip_force=(0.005, 0, 0.01), translation=translation)
    term = mr.explain(robot, inputs)["precurvature_profile"]
    assert 0.02 * term.error < moved(robot, inputs, "precurvature_profile") / (1 + translation) < term.error < inf
    assert "precurvature_degree" in term.saves


def test_a_short_section_whose_precurvature_varies_is_within_its_bound():
    """Of 0.03 of the length: none of twenty places lies in it. By hand: the integral of ``(L - s) u*(s)`` is ``-2/3 A w^2``."""
    A, w, length = 2.0, 0.015, 1.0
    own = {"bending_stiffness": 1.0, "torsional_stiffness": 0.8}
    straight, bent = mr.Section(length=0.285, **own), lambda s: (A * (s - w) / w, 0.0, 0.0)
    sections = [straight, mr.Section(length=2 * w, precurvature=bent, **own), mr.Section(length=length - 0.315, **own)]
    robot = mr.SingleRod(mr.Rod(sections=sections))
    inputs = robot.inputs(tip_force=(1e-6, 0, 0))
    error, change = mr.explain(robot, inputs)["precurvature_profile"].error, moved(robot, inputs, "precurvature_profile")
    assert change == pytest.approx(2 / 3 * A * w**2, rel=1e-2)  # of a rod that is bent by so little
    assert change < error < 3 * A * 0.1  # as if it varied so on two of the twenty parts


def test_a_profile_is_dropped_for_its_mean():
    robot = mr.SingleRod(mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8, precurvature=curved))
    less, _ = mr.explain(robot).without("precurvature_profile")
    mean = sum(section.length * section.precurvature for section in less.rods[0].sections)
    np.testing.assert_allclose(mean, (0.3, 0.1, 0.05), rtol=1e-12)  # the integrals from 0 to 1
    assert less.rods[0].length == pytest.approx(1.0)


def test_a_short_soft_section_is_not_overlooked():
    """A hinge much shorter than what the bound looks at."""
    parts = [(0.26, 1.0), (0.002, 1e-3), (0.738, 1.0)]
    rod = mr.Rod(
        sections=[mr.Section(length=l, bending_stiffness=EI, torsional_stiffness=EI, linear_density=1.0) for l, EI in parts]
    )
    robot = mr.SingleRod(rod)
    inputs = robot.inputs(tip_force=(0.01, 0, 0), gravity=(1e-3, 0, 0))
    assert moved(robot, inputs, "gravity") < mr.explain(robot, inputs)["gravity"].error
    assert moved(robot, inputs, "gravity") > 2 * 1e-3 / 8  # the hinge is what moves it


@pytest.mark.parametrize(("start", "width"), [(0.503, 0.002), (0.8763, 0.01), (0.1, 0.5)])
def test_a_narrow_load_is_not_overlooked(start, width):
    """A belt between 65 places along the rod was of no effect, and dropped."""
    robot = straight()
    inputs = robot.inputs(distributed_force=lambda s: (0.1 / width, 0, 0) if start <= s < start + width else (0, 0, 0))
    error = mr.explain(robot, inputs)["distributed_force"].error
    assert moved(robot, inputs, "distributed_force") < error
    assert not mr.solve(robot, inputs, solver=SOLVER, simplify=1e-3).dropped


def test_polynomials_are_nowhere_more_than_their_bound():
    found = np.random.default_rng(3).normal(size=(50, profile.DEGREE + 1, 3))
    powers = np.linspace(-1, 1, 501)[:, None] ** np.arange(profile.DEGREE + 1)
    most, bound = np.linalg.norm(powers @ found, axis=-1).max(axis=1), profile.bounds(found)
    assert np.all(bound >= most)
    assert np.all(bound <= 3 * most)
    np.testing.assert_allclose(profile.bounds(np.array([[[1.0, 2, 2]], [[0.0, 3, 4]]])), (3, 5), rtol=1e-15)


def test_unequal_axes_of_tubes_are_within_their_bound():
    tubes = [
        mr.Rod(length=length, bending_stiffness=(EI, 1.05 * EI), torsional_stiffness=EI / 1.3, precurvature=(curved, 0, 0))
        for length, EI, curved in ((0.3, 0.01, 1.2), (0.2, 0.03, 0.8))
    ]
    robot = mr.ConcentricTubes(tubes)
    inputs = robot.inputs(rotation=(0.4, -0.3), translation=(-0.05, -0.02), tip_force=(0.02, 0.01, 0))
    term = mr.explain(robot, inputs)["anisotropy"]
    assert 0.02 * term.error < moved(robot, inputs, "anisotropy") / 0.25 < term.error < inf
    assert term.saves == ("anisotropic",)


def test_torsion_of_tubes_behind_the_plate_counts():
    """What twists there is longer than what is outside."""
    tubes = [
        mr.Rod(length=0.5, bending_stiffness=EI, torsional_stiffness=EI, precurvature=(k, 0, 0))
        for EI, k in ((0.01, 1.0), (0.02, 1.2))
    ]
    robot = mr.ConcentricTubes(tubes)
    inputs = [robot.inputs(rotation=(0.5, -0.5), translation=(beta, beta), tip_force=(0, 0, 1e-4)) for beta in (-0.4, -0.01)]
    short, long = (mr.explain(robot, i)["torsion"] for i in inputs)
    assert moved(robot, inputs[0], "torsion") / 0.1 < short.error
    assert moved(robot, inputs[1], "torsion") / 0.49 < long.error
    # the same tubes unloaded and outside by a tenth, but held where they come out: nothing twists behind
    shortened = mr.ConcentricTubes(
        [
            mr.Rod(length=0.1, bending_stiffness=EI, torsional_stiffness=EI, precurvature=(k, 0, 0))
            for EI, k in ((0.01, 1.0), (0.02, 1.2))
        ]
    )
    held = mr.explain(shortened, shortened.inputs(rotation=(0.5, -0.5), tip_force=(0, 0, 1e-4)))["torsion"]
    assert short.error > 3 * held.error


def test_nothing_is_promised_past_the_load_that_buckles():
    robot = straight()
    for part, promised in ((0.3, True), (1.01, False), (5.0, False)):
        force = -part * pi**2 / 4  # Euler's load
        term = mr.explain(robot, robot.inputs(tip_force=(0, 0, force), gravity=(1e-9, 0, 0)))["gravity"]
        assert np.isfinite(term.error) == promised
        assert ("no promise" in term.reason) != promised
    near = mr.explain(robot, robot.inputs(tip_force=(0, 0, -0.4 * pi**2 / 4), gravity=(1e-9, 0, 0)))["gravity"]
    assert near.amplification > 1 / (1 - 0.4)  # of a column under 0.4 of Euler's load


def test_tubes_that_could_snap_promise_nothing():
    """Opposite tubes lose stability at L sqrt(EI/GJ) |u*| = pi/2, and no tip force, however small, is dropped past it."""
    for size, promised in ((0.5, True), (1.05, False)):
        k = size * pi / 2
        tube = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=1.0, precurvature=(k, 0, 0))
        robot = mr.ConcentricTubes([tube, tube])
        term = mr.explain(robot, robot.inputs(rotation=(0, 0.5), tip_force=(1e-9, 0, 0)))["tip_force"]
        assert np.isfinite(term.error) == promised


# ---- what is said ----


@pytest.mark.parametrize(("scene", "loads"), [(scene, loads) for scene, given in SCENES.items() for loads in given.inputs])
def test_features_are_those_that_the_problem_compiles(scene, loads):
    robot = SCENES[scene].robot()
    inputs = robot.inputs(**SCENES[scene].inputs[loads])
    problem = robot.problem(inputs, integrator=mr.RK45())
    compiled = [group.backbones.features for group in problem.groups] if scene == "ParallelRods" else [problem.features]
    own = mr.explain(robot, inputs).features
    assert len(own) == len(compiled)
    for said, used in zip(own, compiled, strict=True):
        for name in vars(used):
            if name not in ("pose_sensitivities", "directions"):
                assert getattr(said, name) == getattr(used, name), name


def test_a_table_says_what_asks_for_what():
    robot = straight(shear_stiffness=1e3)
    found = mr.explain(robot, robot.inputs(tip_force=(0.1, 0, 0), gravity=(0, 0, -9.81e-3)))
    text = str(found)
    for part in (
        "inputs.gravity, up to 0.00981 m/s^2",
        "rods[0]: shear_stiffness",
        "F L^2/EI = 0.1",
        "distributed_force, frame",
        "no promise",
    ):
        assert (part in text) == (part != "no promise"), part
    assert [term.name for term in found.terms] == ["tip_force", "gravity", "shear", "torsion", "frame", "pose"]
    assert text.isascii()  # terminals and files of some systems have nothing else
    assert "follower_force" in found.absent
    assert "gravity" not in found.absent
    assert found["torsion"].saves == ()
    assert found["gravity"].because.startswith("inputs.gravity")
    with pytest.raises(KeyError, match="no term 'friction': it has tip_force"):
        found["friction"]


def test_lines_run_along_the_rod_and_slide_where_that_is_dropped():
    own = {"length": 0.2, "bending_stiffness": 0.01, "torsional_stiffness": 0.0077, "precurvature": (0.0, 3.0, 0.0)}

    def robot(discs: float | None, friction: float, driven: str) -> mr.SingleRod:
        line = mr.Tendon(offset=(0.008, 0.001), end=0.15, friction=friction, driven=driven)
        return mr.SingleRod(mr.Rod(**own, lines=[line], discs=discs))

    for name, discs, friction in (("discs", 0.05, 0.0), ("friction", None, 0.2)):
        for driven in ("tension", "displacement"):
            given = robot(discs, friction, driven)
            found = mr.explain(given, given.inputs(**{driven: 1e-3, "tip_force": (0.1, 0, 0)}))
            assert found[name].error == np.inf
            assert found[name].reason == "no promise"
            assert found[name].saves
            assert f"without {name}" in found.models()
            assert {"discs", "friction"} - {name} <= set(found.absent)
            left, _ = found.without(name)
            expected = robot(None, 0.0, driven).arrays
            assert left.arrays.members == expected.members
            np.testing.assert_array_equal(left.arrays.material, expected.material)
            assert given.rods[0].discs == discs
    assert "friction" not in mr.explain(straight()).absent


def test_only_what_can_be_dropped_is():
    robot = straight()
    found = mr.explain(robot, robot.inputs(tip_force=(0.1, 0, 0)))
    for name in ("shear", "gravity", "pose", "tipforce"):
        with pytest.raises(
            ValueError, match=f"without = '{name}' is not allowed: what can be dropped here is tip_force, torsion"
        ):
            found.without(name)
    same, inputs = found.without()
    assert same is robot
    less, inputs = found.without("tip_force", "torsion")
    assert inputs.active == ()
    assert np.isinf(less.rods[0].sections[0].torsional_stiffness)
    assert np.isfinite(robot.rods[0].sections[0].torsional_stiffness)  # the robot itself stays


def test_what_cannot_be_explained_is_refused():
    with pytest.raises(TypeError, match="robot must be an assembly"):
        mr.explain("robot")
    robot = straight()
    with pytest.raises(TypeError, match="inputs must be made by"):
        mr.explain(robot, {"gravity": (0, 0, 1)})


def test_cost_is_of_what_leaving_out_saves():
    robot = straight(shear_stiffness=1e3)
    found = mr.explain(robot, robot.inputs(tip_force=(0.1, 0, 0), gravity=(0, 0, -0.1)), measure=True)
    assert set(found.cost.without) == {"gravity", "shear"}
    assert all(0 < value < found.cost.present for value in found.cost.without.values())
    assert "one integration" in str(found)


# ---- dropping by a bound ----


def test_what_is_dropped_is_said_and_solved_without():
    robot = straight(shear_stiffness=1e5, axial_stiffness=1e5)
    inputs = robot.inputs(tip_force=(0.1, 0, 0), gravity=(0, 0, -1e-4))
    solution = mr.solve(robot, inputs, simplify=1e-4)
    assert [term.name for term in solution.dropped] == ["shear", "gravity"]
    assert sum(term.error for term in solution.dropped) < 1e-4
    assert "w L^3/EI" in solution.dropped[1].why
    assert "dropped shear (tip error < " in repr(solution)
    assert "gravity" in repr(solution[()])
    alone = mr.solve(*mr.explain(robot, inputs).without("shear", "gravity"))
    assert (solution.tip_position == alone.tip_position).all()
    assert solution.rod(0).position.shape == (51, 3)
    full = mr.solve(robot, inputs)
    assert full.dropped == ()
    assert "dropped" not in repr(full)
    assert np.linalg.norm(full.tip_position - solution.tip_position) < sum(term.error for term in solution.dropped)
    start = mr.solve(robot, inputs, guess=solution)  # the unknowns are those of the full robot
    np.testing.assert_allclose(start.tip_position, full.tip_position, rtol=0, atol=1e-9)


def test_errors_add():
    """Each of three terms alone would stay below the bound, together they would not."""
    robot = straight(shear_stiffness=1e3)
    inputs = robot.inputs(tip_force=(0.1, 0, 0), gravity=(6e-4, 0, 0), distributed_moment=(0, 3e-4, 0))
    errors = {term.name: term.error for term in mr.explain(robot, inputs).terms}
    bound = 1.2 * max(errors[name] for name in ("gravity", "distributed_moment", "shear"))
    dropped = simplified(robot, inputs, bound)[2]
    assert 0 < len(dropped) < 3
    assert sum(term.error for term in dropped) < bound


def test_what_saves_nothing_is_kept():
    """Under its weight a rod carries the terms of a force anyway; and a rod's twist is no term of its own."""
    robot = straight()
    inputs = robot.inputs(tip_force=(1e-9, 0, 0), gravity=(0.2, 0, 0))
    assert mr.solve(robot, inputs, simplify=1e-3).dropped == ()


def test_nothing_to_drop_is_bitwise_the_same():
    robot = straight(shear_stiffness=20.0)
    inputs = robot.inputs(tip_force=[(0.5, 0, 0), (0.2, 0.1, 0)], gravity=(0, 0, -0.3))
    plain, asked = mr.solve(robot, inputs), mr.solve(robot, inputs, simplify=1e-6)
    assert asked.dropped == ()
    for name in ("unknowns", "tip_position", "gamma", "residual"):
        assert (getattr(plain, name) == getattr(asked, name)).all()


def test_one_instance_that_needs_a_term_keeps_it_for_all():
    robot = straight(shear_stiffness=1e6)
    weak = np.full((40, 3), [1e-6, 0, 0])
    strong = weak.copy()
    strong[17] = (0.5, 0, 0)
    assert [term.name for term in simplified(robot, robot.inputs(gravity=weak), 1e-4)[2]] == ["shear", "gravity"]
    assert [term.name for term in simplified(robot, robot.inputs(gravity=strong), 1e-4)[2]] == ["shear"]


def test_a_motion_keeps_what_any_sample_needs():
    time = 0.01 * np.arange(5)
    robot = straight(linear_density=np.array([1.0, 1.0, 1.0, 1.0, 1e-7]))  # as many rods as samples
    gravity = np.zeros((5, 3))
    gravity[:4, 0] = 1e-7
    gravity[4, 0] = 0.3  # only the light rod hardly notices
    history = mr.simulate(robot, robot.inputs(gravity=gravity, tip_force=(0.1, 0, 0)), time=time, simplify=1e-4)
    assert history.dropped == ()
    still = mr.simulate(robot, robot.inputs(gravity=gravity[:1], tip_force=(0.1, 0, 0)), time=time, simplify=1e-4)
    assert [term.name for term in still.dropped] == ["gravity"]
    assert "without gravity (tip error < " in still.description  # and so in a recording
    assert still.tip_position.shape == (5, 5, 3)


@pytest.mark.parametrize("value", [0, -1e-3, 1, np.nan, inf, True, "little"])
def test_a_bound_that_is_none_is_refused(value):
    robot = straight()
    with pytest.raises(ValueError, match="simplify = .* is not allowed"):
        mr.solve(robot, robot.inputs(), simplify=value)


def test_legs_that_turn_at_the_platform_promise_nothing():
    robot = SCENES["ParallelRods"].robot()
    inputs = robot.inputs(gravity=(0, 0, -1e-9))
    assert mr.solve(robot, inputs, simplify=1e-2).dropped == ()
    assert mr.explain(robot, inputs)["gravity"].error == inf


@pytest.mark.parametrize("height", [0.0, 0.3])
def test_the_weight_of_a_platform_acts_where_its_mass_is(height):
    """Two legs abreast and gravity across both: they bend as one cantilever, under a force and its moment."""
    leg = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, 1, 3] = 0.001, -0.001
    robot = mr.ParallelRods(legs=[leg] * 2, base=poses, platform=poses, platform_mass=0.004, platform_centre=(0, 0, height))
    inputs = robot.inputs(gravity=(9.81, 0, 0))
    force, bending = 0.004 * 9.81, 2 * 0.02
    moved = (force * 0.3**3 / 3 + force * height * 0.3**2 / 2) / bending / 0.3
    found = mr.explain(robot, inputs)["gravity"]
    assert moved < found.error < 2 * moved  # what is estimated is larger by how far off attachments are, and by what it adds up
    heavy = mr.solve(robot, inputs).raise_if_failed().tip_position[0] / 0.3
    assert 0.9 * moved < heavy < found.error  # rotations of a few hundredths


def pushed_legs():
    """Legs that no load acts on, pushed against each other."""
    made = {"bending_stiffness": (0.02, 0.03), "torsional_stiffness": 0.015, "shear_stiffness": 30.0, "axial_stiffness": 60.0}
    leg = mr.Rod(precurvature=lambda s: (s, 0, 0), length=0.3, **made)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :2, 3] = 0.06 * np.array([(1, 0), (-0.5, 0.9), (-0.5, -0.9)])
    robot = mr.ParallelRods(legs=[leg] * 3, base=poses, platform=poses)
    return robot, robot.inputs(translation=(0.02, 0, 0.01), rotation=(0.5, 0, 0))


def test_of_legs_that_nothing_loads_nothing_is_promised_by_which_they_hold_each_other():
    robot, inputs = pushed_legs()
    found = mr.explain(robot, inputs)
    assert [found[name].error for name in ("shear", "torsion", "anisotropy", "precurvature_profile")] == [inf] * 4
    assert simplified(robot, inputs, 1e-2) == (robot, inputs, ())


def test_what_is_estimated_is_not_said_to_be_a_bound():
    robot, _ = pushed_legs()
    pulled = mr.explain(robot, robot.inputs(tip_force=(1e-4, 0, 0)))
    assert pulled["tip_force"].estimated
    assert f"~ {pulled['tip_force'].error:.1e} L" in str(pulled)
    (left,) = simplified(robot, robot.inputs(distributed_force=(1e-4, 0, 0)), 0.01)[2]
    assert str(left) == f"distributed_force (tip error ~ {left.error:.1e} L)"
    rod = mr.SingleRod(robot.legs[0])
    alone = mr.explain(rod, rod.inputs(tip_force=(1e-4, 0, 0)))
    assert not alone["tip_force"].estimated
    assert f"< {alone['tip_force'].error:.1e} L" in str(alone)


def test_without_extension_the_platform_of_legs_that_nothing_loads_is_elsewhere():
    robot, inputs = pushed_legs()
    assert moved(robot, inputs, "shear") > 0.01 * 0.3
    assert mr.solve(robot, inputs, simplify=1e-2).dropped == ()


def test_an_inverse_problem_can_be_explained():
    rod = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, linear_density=0.05)
    base, platform = np.tile(np.eye(4), (2, 6, 1, 1))
    for poses, aside in ((base, 0.4), (platform, -0.4)):  # legs that cross in pairs
        angle = 2 * pi * np.arange(6) / 6 + aside * (-1) ** np.arange(6)
        poses[:, :2, 3] = 0.06 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inverse = mr.ParallelRods(legs=[rod] * 6, base=base, platform=platform).inverse()
    inputs = inverse.inputs(platform_position=(0, 0, 0.28), gravity=(0, 0, -1.0))
    less, inputs = mr.explain(inverse, inputs).without("gravity", "torsion")
    assert np.isinf(less.robot.legs[0].sections[0].torsional_stiffness)
    assert inputs.active == ("platform_position",)


@pytest.mark.parametrize(
    "loads",
    [
        {"follower_moment": (0, 0.3, 0), "distributed_moment": (0, 0, 0.5)},
        {"follower_force": (0, 0.3, 0), "distributed_moment": (0, 0, 0.5)},
        {"follower_moment": (0, 0.2, 0.3)},
        {"follower_force": (0.2, 0, 0), "tip_moment": (0, 0, 0.3)},
    ],
)
def test_what_follows_the_tip_twists_with_it(loads):
    """Of a straight round rod, which torsion does not couple with bending but through these; alone and as a tube."""
    rod = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.5)
    for robot in (mr.SingleRod(rod), mr.ConcentricTubes([rod])):
        inputs = robot.inputs(**loads)
        found, whole = mr.explain(robot, inputs), mr.solve(robot, inputs).raise_if_failed()
        for name in ("torsion", *loads):
            without = mr.solve(*found.without(name)).raise_if_failed()
            assert np.linalg.norm(without.tip_position - whole.tip_position) <= found[name].error


def test_the_twist_of_what_follows_the_tip_is_counted():
    """Which a torque along the rod turns by ``q L^2 / 2 GJ``, and the moment that bends it with it: by twice the sine of half."""
    rod = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.5)
    robot = mr.SingleRod(rod)
    bending, torque = 0.03, 0.5
    moved = bending / 2 * 2 * np.sin(torque / 2 / 0.5 / 2)  # of small bending, the tip's M L^2 / 2 EI turns about the rod
    found = mr.explain(robot, robot.inputs(follower_moment=(0, bending, 0), distributed_moment=(0, 0, torque)))
    assert found["torsion"].error > moved


def test_loads_of_a_network_are_terms_by_their_own_names():
    """Each as large as the largest vector of it; what drives joints or lines is none."""
    wire = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015)
    plate, top = mr.Body("plate"), mr.Body("top", mass=0.1)
    joints = [mr.Joint("low", "base", to=mr.ground), mr.Joint("low", "tip", to=plate), mr.Joint("high", "base", to=plate)]
    joints.append(mr.Joint("high", "tip", to=top, kind="revolute", axis=(1, 0, 0), stiffness=0.1))
    robot = mr.Network(rods={"low": wire, "high": wire}, bodies=[plate, top], joints=joints)
    loads = {"force": {"plate": (3, 0, 4), "top": (0, 0, -2)}, "follower_force": {"top": (0, 2, 0), "plate": (1, 0, 0)}}
    inputs = robot.inputs(**loads, joint_torque={"high tip": -0.03}, rod_force={"low": (0, 0.1, 0)}, gravity=(0, 0, -9.81))
    found = mr.explain(robot, inputs)
    sizes = {"force": "5 N", "follower_force": "2 N", "joint_torque": "0.03 N m", "rod_force": "0.1 N/m", "gravity": "9.81 m/s^2"}
    for name, size in sizes.items():
        assert found[name].because == f"inputs.{name}, up to {size}"
        assert not found.without(name)[1].is_active(name)
        assert sum(found.without(name)[1].is_active(other) for other in sizes) == len(sizes) - 1
    assert {"moment", "rod_moment"} <= set(found.absent)
    assert "nothing is promised, simplify= drops nothing: what holds the rods of this Network back" in str(found)


def test_what_holds_a_rod_stays_where_it_is_where_its_precurvature_is_dropped():
    """Its end is held where that of the rod at rest is: not of the rod with less."""
    robot = mr.HeldRod(mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8, precurvature=curved))
    found = mr.explain(robot, robot.inputs(end_position=(0.0, 0.0, -0.01)))
    less, _ = found.without("precurvature_profile")
    np.testing.assert_array_equal(less.holders.end, robot.holders.end)
    assert robot.end is None
    assert "tips are held" in str(found)
