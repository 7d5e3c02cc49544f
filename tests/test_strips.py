"""Rods of rectangular section, against tables and series of the theory of elasticity."""

import numpy as np
import pytest

import multirod as mr

E, G, LENGTH = 70e9, 26e9, 0.3
MADE_OF = {"length": LENGTH, "young_modulus": E, "shear_modulus": G}
# Timoshenko, Goodier, Theory of Elasticity, article 109: torsion constant over long short^3, by long over short
TABLE = {1.0: 0.1406, 1.2: 0.166, 1.5: 0.196, 2.0: 0.229, 2.5: 0.249, 3.0: 0.263, 4.0: 0.281, 5.0: 0.291, 10.0: 0.312}


@pytest.mark.parametrize(("ratio", "tabulated"), TABLE.items())
def test_torsion_is_as_tabulated(ratio, tabulated):
    """Whichever side is the longer one."""
    short = 2e-3
    for sides in ({"width": ratio * short, "thickness": short}, {"width": short, "thickness": ratio * short}):
        (section,) = mr.Rod.strip(**MADE_OF, **sides).sections
        # of the last digit of the table
        assert float(section.torsional_stiffness) / (G * ratio * short**4) == pytest.approx(tabulated, abs=6e-4)


def test_torsion_is_the_sum_of_its_series():
    """By as many terms as are more than rounding."""
    width = np.array([2e-3, 2.6e-3, 8e-3, 0.1])
    n = np.arange(1, 4001, 2)[:, None]
    found = mr.Rod.strip(**MADE_OF, width=width, thickness=2e-3).sections[0].torsional_stiffness
    left = 192 / np.pi**5 * 2e-3 / width * (np.tanh(n * np.pi * width / 4e-3) / n**5.0).sum(axis=0)
    np.testing.assert_allclose(found, G * width * 2e-3**3 / 3 * (1 - left), rtol=1e-13)


def test_a_strip_bends_easily_across_its_thickness():
    """By a small force, F L^3/(3 EI)."""
    width, thickness, force = 12e-3, 1e-3, 1e-3
    robot = mr.SingleRod(mr.Rod.strip(**MADE_OF, width=width, thickness=thickness))
    moved = mr.solve(robot, robot.inputs(tip_force=force * np.eye(3)[:2])).tip_position
    for axis, second in ((0, thickness * width**3 / 12), (1, width * thickness**3 / 12)):
        # it is off by the square of the angle, 1e-3
        assert moved[axis, axis] == pytest.approx(force * LENGTH**3 / (3 * E * second), rel=1e-5)


def test_mass_stretch_and_magnetisation_are_of_the_area():
    area, nu = 5e-3 * 2e-3, E / (2 * G) - 1
    made = {"density": 2700.0, "extensible": True, "magnetisation": (0, 0, 1e5)}
    (section,) = mr.Rod.strip(**MADE_OF, width=5e-3, thickness=2e-3, **made).sections
    assert float(section.linear_density) == pytest.approx(2700 * area)
    assert float(section.axial_stiffness) == pytest.approx(E * area)
    np.testing.assert_allclose(section.shear_stiffness, 10 * (1 + nu) / (12 + 11 * nu) * G * area)
    np.testing.assert_allclose(section.magnetisation, (0, 0, 1e5 * area))


def test_one_of_a_batch_is_bitwise_as_it_is_alone():
    width = np.linspace(1e-3, 2e-2, 7)
    batch = mr.Rod.strip(**MADE_OF, width=width, thickness=1.3e-3, extensible=True).sections[0]
    for k, own in enumerate(width):
        (alone,) = mr.Rod.strip(**MADE_OF, width=own, thickness=1.3e-3, extensible=True).sections
        for name in ("bending_stiffness", "torsional_stiffness", "shear_stiffness"):
            np.testing.assert_array_equal(getattr(batch, name)[k], getattr(alone, name))


@pytest.mark.parametrize("ending", ["toml", "npz"])
def test_files_keep_its_sides(ending, tmp_path):
    rod = mr.Rod.strip(**MADE_OF, width=5e-3, thickness=2e-3, precurvature=[(0.1, (0, 0, 0)), (0.2, (3, 0, 0))], name="blade")
    robot, file = mr.SingleRod(rod), tmp_path / f"robot.{ending}"
    if ending == "toml":
        robot.save(file)
        assert "Rod.strip" in file.read_text()
        found = mr.load(file).rod
    else:
        mr.solve(robot).save(file)
        found = mr.load(file).robot.rod
    for own, other in zip(rod.sections, found.sections, strict=True):
        np.testing.assert_array_equal(own.torsional_stiffness, other.torsional_stiffness)
        np.testing.assert_array_equal(own.bending_stiffness, other.bending_stiffness)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 0}, r"Rod\.width = 0 .* > 0"),
        ({"thickness": -1e-3}, r"Rod\.thickness = -0\.001 .* > 0"),
        ({"thickness": (1e-3, np.nan)}, r"Rod\.thickness"),
        ({"width": (1e-3, 2e-3, 3e-3), "thickness": (1e-3, 2e-3)}, "axes of width and thickness, .* do not broadcast"),
        ({"thickness": 1e-200}, r"Rod\.thickness .* so small"),
        ({"width": 1e-30, "thickness": 1e-30}, r"Rod\.young_modulus .* must make EI and GJ"),
    ],
)
def test_what_is_no_strip_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        mr.Rod.strip(**MADE_OF | {"width": 5e-3, "thickness": 1e-3} | changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 5.0}, r"Rod\.width = 5 m is wider than the rod is long, 0\.3 m; if it is in mm, give 0\.005"),
        ({"young_modulus": 70.0, "shear_modulus": None, "poisson_ratio": 0.3}, r"Rod\.young_modulus = 70 Pa is softer"),
    ],
)
def test_what_is_hardly_meant_is_said(changes, message):
    with pytest.warns(mr.PlausibilityWarning, match=message):
        mr.Rod.strip(**MADE_OF | {"width": 5e-3, "thickness": 1e-3} | changes)
