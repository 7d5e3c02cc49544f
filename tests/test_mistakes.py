"""Mistakes that people make: each is refused, or warned of, by a message that says what was probably meant."""

import copy
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meant import meant
from mistakes import MISTAKES, PAGE, Mistake, page, said

import multirod as mr

WIRE = {"length": 0.4, "diameter": 1e-3, "young_modulus": 60e9}


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.name)
def test_a_mistake_is_said(mistake: Mistake) -> None:
    kind, message = said(mistake)
    assert kind is mistake.kind, message
    assert mistake.says in message


def test_there_are_as_many_as_there_were_to_be() -> None:
    assert len(MISTAKES) >= 69
    assert len({mistake.name for mistake in MISTAKES}) == len({mistake.code for mistake in MISTAKES}) == len(MISTAKES)


def test_the_page_lists_what_is_said() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python tests/mistakes.py writes it anew"


@pytest.mark.parametrize(
    "given",
    [
        {"length": 2.0, "diameter": 0.3e-3},  # a guide wire
        {"length": 0.08, "diameter": 0.4e-3, "young_modulus": 3e6, "poisson_ratio": 0.5, "density": 1100.0},  # a soft micro-robot
        {"length": 0.1, "diameter": 0.03, "young_modulus": 1.3e5, "poisson_ratio": 0.49, "density": 1070.0},  # of silicone
        {"length": 0.6, "diameter": 125e-6, "young_modulus": 72e9, "poisson_ratio": 0.17, "density": 2200.0},  # a fibre
        {"length": 5.0, "diameter": 0.02, "young_modulus": 230e9, "poisson_ratio": 0.2, "density": 1600.0},  # a boom of carbon
        {"diameter": 1.2e-3, "precurvature": (1 / 0.02, 0, 0)},
        {"precurvature": lambda s: (20 * s, 5, 0)},
        {"length": (0.3, 0.4), "young_modulus": (60e9, 70e9)},
    ],
    ids=lambda given: ", ".join(given),
)
def test_what_is_built_is_plausible(given: dict) -> None:
    robot = mr.SingleRod(mr.Rod.wire(**{"poisson_ratio": 0.3, **WIRE, **given}))
    force = robot.stiffest / robot.longest**2
    robot.inputs(rotation=math.pi / 2, tip_force=(100 * force, 0, 0))
    robot.inputs(rotation=0.0, translation=0.02, tip_moment=(0, 10 * force * robot.longest, 0))
    robot.inputs()


def test_a_wire_is_a_tube_without_a_hole() -> None:
    wire = mr.Rod.wire(**WIRE, shear_modulus=23e9, density=6450.0, precurvature=(3, 0, 0), name="w")
    tube = mr.Rod.tube(length=0.4, outer_diameter=1e-3, young_modulus=60e9, shear_modulus=23e9, density=6450.0)
    for name in ("bending_stiffness", "torsional_stiffness", "linear_density"):
        assert np.array_equal(getattr(wire.sections[0], name), getattr(tube.sections[0], name))
    assert wire.sections[0].bending_stiffness == pytest.approx([60e9 * math.pi / 64 * 1e-12] * 2)
    assert (wire.outer_diameter, wire.inner_diameter, wire.name) == (1e-3, 0.0, "w")
    assert vars(wire).keys() == vars(tube).keys()


def test_poissons_ratio_takes_the_place_of_the_shear_modulus() -> None:
    by_ratio, by_modulus = mr.Rod.wire(**WIRE, poisson_ratio=0.25), mr.Rod.wire(**WIRE, shear_modulus=24e9)
    assert by_ratio.sections[0].torsional_stiffness == pytest.approx(by_modulus.sections[0].torsional_stiffness, rel=1e-14)
    for value in (-1, 0.51, math.nan, "0.3", True):
        with pytest.raises(ValueError, match=r"^Rod\.poisson_ratio = .* is not allowed"):
            mr.Rod.wire(**WIRE, poisson_ratio=value)
    with pytest.warns(mr.PlausibilityWarning, match="Poisson ratio of -0.3"):
        mr.Rod.wire(**WIRE, poisson_ratio=-0.3)
    with pytest.raises(ValueError, match=r"^Rod\.shear_modulus = None is not allowed: must be a number, or give poisson_ratio"):
        mr.Rod.wire(**WIRE)


def only_on_the_rod(s: float) -> tuple[float, float, float]:
    if s > 0.5:
        raise ValueError("beyond the data")
    return (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "function",
    [
        lambda s: (0, 0, 0),
        lambda s: (1.0 if s > 0.5 else 0, 0, 0),  # of a longer rod, or one that is pushed out
        lambda s: (1.0 if 1 < s < 3.9 else 0, 0, 0),
        lambda s: (math.nan if s > 1 else 0, 0, 0),
        only_on_the_rod,
    ],
    ids=["nothing", "behind the tip", "not ten times as far", "undefined", "refused"],
)
def test_a_function_that_is_zero_may_be_meant(thick: mr.SingleRod, function: Any) -> None:
    thick.inputs(distributed_force=function)
    mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.1, precurvature=function)


def test_a_function_in_mm_is_none_in_metres() -> None:
    said = r"^Rod.precurvature\(s\) is zero all along, from s = 0 to 0.4 m, but not at s = 202; is it a function of s in mm\?$"
    with pytest.warns(mr.PlausibilityWarning, match=said):
        mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.1, precurvature=lambda s: (14 * (s > 200), 0, 0))


@pytest.mark.parametrize("value", [0, -1e-3, math.nan, "1e-3", None, True])
def test_the_diameter_of_a_wire_is_a_number_above_zero(value: object) -> None:
    with pytest.raises(ValueError, match=r"^Rod\.diameter = .* is not allowed"):
        mr.Rod.wire(**{**WIRE, "diameter": value}, poisson_ratio=0.3)


def test_one_mistake_is_said_once() -> None:
    with pytest.warns(mr.PlausibilityWarning) as caught:
        mr.Rod.wire(**{**WIRE, "length": 400.0}, poisson_ratio=0.3)
    assert len(caught) == 1
    assert caught[0].filename == __file__


def strained(solution: mr.Solution) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        solution.rod(0)
    return [str(warning.message) for warning in caught]


@pytest.fixture
def thick(wire: mr.Rod) -> mr.SingleRod:
    return mr.SingleRod(
        mr.Rod(
            length=0.4, bending_stiffness=wire.sections[0].bending_stiffness, torsional_stiffness=0.063814, outer_diameter=3e-3
        )
    )


def test_strain_is_that_of_the_outer_fibre(thick: mr.SingleRod) -> None:
    """By a moment M, EI u = M along the whole rod: the limit is where M d / (2 EI) is 8 %."""
    EI = thick.rods[0].sections[0].bending_stiffness[0]
    moment = 0.08 * 2 * EI / 3e-3
    below = mr.solve(thick, thick.inputs(tip_moment=(0, 0.99 * moment, 0))).raise_if_failed()
    np.testing.assert_allclose(below.strain, [0.99 * 0.08], rtol=1e-6)  # what the solver leaves
    with pytest.warns(mr.PlausibilityWarning, match=r"the outer fibre of the rod is strained by 8\.08 %, more than 8 %"):
        mr.solve(thick, thick.inputs(tip_moment=[(0, 0.5 * moment, 0), (0, 1.01 * moment, 0)])).raise_if_failed()


def test_strain_is_said_once_and_along_the_rod_when_its_shape_is_asked_for(thick: mr.SingleRod) -> None:
    with pytest.warns(mr.PlausibilityWarning, match="strained"):
        at_base = mr.solve(thick, thick.inputs(tip_force=(500.0, 0, 0)))
    assert strained(at_base) == []
    with meant():  # a tracker does not look
        tracked = mr.Tracker(thick, inputs=thick.inputs(tip_force=(500.0, 0, 0))).step()
    (message,) = strained(tracked)
    assert message.startswith("solution: the outer fibre of the rod is strained by 10 %")


def test_the_softer_section_is_strained_more_than_the_stiffest() -> None:
    """What is said is what ``strain`` is, of the section at hand."""
    stiff = mr.Section(length=0.2, bending_stiffness=0.4, torsional_stiffness=0.3)
    soft = mr.Section(length=0.2, bending_stiffness=0.1, torsional_stiffness=0.075)
    robot = mr.SingleRod(mr.Rod(sections=[stiff, soft], outer_diameter=3e-3))
    solution = mr.solve(robot, robot.inputs(tip_moment=(0, 6.0, 0))).raise_if_failed()  # 2.2 % at the base: nothing is said
    with pytest.warns(mr.PlausibilityWarning, match=r"the rod is strained by 9 %"):
        np.testing.assert_allclose(solution.strain, [0.09], rtol=1e-6)


def test_each_is_strained_by_its_own_diameter() -> None:
    """The thick one is bent less, and strained more."""
    EI, outer = np.array([[0.1], [0.2]]), np.array([2e-3, 4e-3])
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=EI, torsional_stiffness=0.07, outer_diameter=outer))
    with pytest.warns(mr.PlausibilityWarning, match=r"the rod is strained by 12 %"):
        solution = mr.solve(robot, robot.inputs(tip_moment=(0, 12.0, 0)))
    np.testing.assert_allclose(solution.strain, [[0.12], [0.12]], rtol=1e-6)
    with pytest.warns(mr.PlausibilityWarning, match=r"outer_diameter = 0.5 m is thicker than the rod is long, 0.4 m"):
        mr.Rod.wire(length=[0.3, 0.4], diameter=[1e-3, 0.5], young_modulus=60e9, poisson_ratio=0.3)
    with pytest.warns(mr.PlausibilityWarning, match=r"bending_stiffness = 0.2 N m\^2 at outer_diameter = 0.0001 m means a Young"):
        mr.Rod(length=0.4, bending_stiffness=EI, torsional_stiffness=0.07, outer_diameter=[2e-3, 1e-4])
    with pytest.warns(mr.PlausibilityWarning, match=r"linear_density = 44 kg/m means a density of 3.5e\+06 kg"):
        mr.Rod(length=0.4, bending_stiffness=EI, torsional_stiffness=0.07, outer_diameter=outer, linear_density=[1e-2, 44])


def test_failed_instances_are_not_strained(thick: mr.SingleRod) -> None:
    hopeless = mr.Shooting(max_iterations=1, max_continuation_steps=1, max_integrations=2, fallback=False)
    solution = mr.solve(thick, thick.inputs(tip_force=(5000.0, 0, 0)), solver=hopeless)
    assert solution.status.failed
    assert np.isnan(solution.strain).all()


def test_a_tracker_takes_a_time_step_where_it_is_used(wire: mr.Rod) -> None:
    robot = mr.SingleRod(wire)
    inputs = robot.inputs(tip_force=(1, 0, 0))
    steps = [mr.Tracker(robot, inputs=inputs, dt=dt).step() for dt in (None, 0.005)]
    assert np.array_equal(*(step.tip_position for step in steps))
    for solver in (mr.EnergyDescent(), mr.ScipyShooting(), mr.MultipleShooting()):
        assert not solver.needs_dt
    with pytest.raises(TypeError, match="Tracker needs dt, the time between samples .*: Observer goes by it"):
        mr.Tracker(robot, inputs=inputs, solver=mr.Observer())


def test_a_pair_is_told_from_a_batch_of_two() -> None:
    forces = np.zeros((2, 3))
    with pytest.warns(mr.PlausibilityWarning, match=r"give \[\[0.2\], \[0.3\]\], shape \(2, 1\); if it is the pair, a tuple"):
        pair(np.array([0.2, 0.3])).inputs(tip_force=forces)
    for plain in ((0.2, 0.3), [[0.2], [0.3]], [0.2, 0.2], [[0.2, 0.3]]):
        pair(plain).inputs(tip_force=forces)
    pair([0.2, 0.3]).inputs(tip_force=np.zeros((3, 3)))
    pair([0.2, 0.3]).inputs(tip_force=np.zeros(3))


def pair(bending_stiffness: object) -> mr.SingleRod:
    return mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=bending_stiffness, torsional_stiffness=0.1))


def test_a_pair_of_a_file_is_one(tmp_path: Path) -> None:
    for ending in ("toml", "npz"):
        pair([0.2, 0.3]).save(tmp_path / f"robot.{ending}")
        mr.load(tmp_path / f"robot.{ending}").inputs(tip_force=np.zeros((2, 3)))


def test_inputs_of_as_many_rods_may_be_of_another_robot() -> None:
    rod = mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.1)
    lines = [mr.Tendon((0.01, 0)), mr.Tendon((-0.01, 0))]
    one, two = (mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.1, lines=lines[:k])) for k in (1, 2))
    given = mr.SingleRod(rod).inputs(tip_force=(1, 0, 0))
    assert one.accept(given) is given
    with pytest.raises(ValueError, match="its tension is 1 number, that of this SingleRod 2"):
        two.accept(one.inputs(tension=1.0))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("tip", "did you mean tip_position and tip_rotation"),
        ("position", "did you mean rod\\(0\\)"),
        ("converged", "did you mean status, or failed"),
        ("tip_positon", "^Solution has no 'tip_positon'$"),
        ("rates", "only an observer that tracks has closed-loop rates"),
    ],
)
def test_a_solution_says_what_it_calls_things(thick: mr.SingleRod, name: str, message: str) -> None:
    solution = mr.solve(thick, thick.inputs())
    assert solution.robot is solution.assembly is thick
    assert copy.deepcopy(solution).tip_position.tolist() == solution.tip_position.tolist()
    with pytest.raises(AttributeError, match=message):
        getattr(solution, name)


def test_files_that_are_no_results_say_what_to_do(thick: mr.SingleRod, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"a picture is solution.plot\(\).figure.savefig\(path\)$"):
        mr.solve(thick, thick.inputs()).save(tmp_path / "a.png")
    with pytest.raises(ValueError, match=r"\.csv is written for other programs and not read back: save as \.npz too$"):
        mr.load(tmp_path / "a.csv")


def test_a_mean_without_a_deviation_is_where_to_begin_if_that_is_said() -> None:
    assert np.isinf(mr.Prior(0.1, sigma=math.inf).sigma)
    assert np.isinf(mr.Prior(0.0).sigma)


def test_a_stiffness_stands_beside_the_modulus_that_it_means() -> None:
    sections = [mr.Section(length=0.1, bending_stiffness=EI, torsional_stiffness=EI) for EI in (5.0, 1e-3)]
    with pytest.warns(mr.PlausibilityWarning, match=r"bending_stiffness = 0.001 N m\^2 .* modulus of 5.22e\+04 Pa"):
        mr.Rod(sections=sections, outer_diameter=0.025)
