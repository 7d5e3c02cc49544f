"""What people get wrong, and what is said then: the table of docs/mistakes.md, which ``python tests/mistakes.py`` writes."""

import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import multirod as mr

PAGE = Path(__file__).parent.parent / "docs" / "mistakes.md"
WARNING = mr.PlausibilityWarning
MOST = 400  # characters of a message in the page

PRELUDE = """\
import numpy as np
import multirod as mr


def tube(**given):
    made_of = {"length": 0.4, "outer_diameter": 3e-3, "inner_diameter": 2e-3, "young_modulus": 60e9, "shear_modulus": 23e9}
    return mr.Rod.tube(**{**made_of, **given})


def wire(**given):
    return mr.Rod.wire(**{"length": 0.4, "diameter": 1e-3, "young_modulus": 200e9, "poisson_ratio": 0.3, **given})


def rod(**given):
    return mr.Rod(**{"length": 0.4, "bending_stiffness": 0.2233, "torsional_stiffness": 0.0638, **given})


def legs(**given):
    base, platform = np.tile(np.eye(4), (2, 6, 1, 1))
    for poses, aside in ((base, 0.35), (platform, -0.35)):  # they cross in pairs
        angle = np.pi / 3 * np.arange(6) + aside * (-1) ** np.arange(6)
        poses[:, :2, 3] = 0.087 * np.stack([np.cos(angle), np.sin(angle)], -1)
    return mr.ParallelRods(**{"legs": [wire()] * 6, "base": base, "platform": platform, **given})


robot = mr.SingleRod(rod())
inner, outer = tube(), tube(length=0.2, outer_diameter=5e-3, inner_diameter=4e-3)
tubes = mr.ConcentricTubes([inner, outer])
pulled = mr.SingleRod(wire(lines=[mr.Tendon((0.01, 0)), mr.PushRod((0, 0.01))]))
blown = mr.SingleRod(rod(lines=[mr.Chamber((0.01, 0), area=1e-4)]))
magnet = mr.SingleRod(wire(magnetisation=(0, 0, 1e5)))
"""


@dataclass(frozen=True)
class Mistake:
    """One of them.

    Attributes:
        name: What was done.
        code: How, after ``PRELUDE``.
        kind: What is raised, or ``PlausibilityWarning``.
        says: A part of the message.
        instead: What to do.
    """

    name: str
    code: str
    kind: type[Exception]
    says: str
    instead: str


def turned(angle: str, rest: str = "") -> str:
    return f"base = np.eye(4); base[:2, :2] = [[np.cos({angle}), -np.sin({angle})], [np.sin({angle}), np.cos({angle})]]{rest}"


GROUPS: dict[str, list[Mistake]] = {
    "Rods: units and material": [
        Mistake("numbers without names", "mr.Rod(0.4, 0.02, 0.015)", TypeError, "all is named", "their names"),
        Mistake(
            "length in mm", "tube(length=400)", WARNING, "length = 400 m is more than 10 m; if it is in mm, give 0.4", "metres"
        ),
        Mistake("length in cm", "tube(length=40)", WARNING, "in cm, give 0.4", "metres"),
        Mistake("length in inches", "tube(length=15.7)", WARNING, "in inches, give 0.39", "metres"),
        Mistake("length in km, or a slip of the exponent", "tube(length=4e-5)", WARNING, "is less than 0.1 mm", "metres"),
        Mistake(
            "a number of a rod's sections asked of the rod",
            "wire().bending_stiffness",
            AttributeError,
            "its sections have, rod.sections[0].bending_stiffness",
            "rod.sections[0].bending_stiffness",
        ),
        Mistake(
            "everything in mm, N and N/mm^2",
            "tube(length=400, outer_diameter=3, inner_diameter=2, young_modulus=60e3, shear_modulus=23e3)",
            WARNING,
            "length = 400 m",
            "SI units throughout",
        ),
        Mistake(
            "diameters in mm",
            "tube(outer_diameter=3, inner_diameter=2)",
            WARNING,
            "outer_diameter = 3 m is thicker than the rod is long, 0.4 m; if it is in mm, give 0.003",
            "metres",
        ),
        Mistake("diameter of a fine wire in mm", "wire(diameter=0.3)", WARNING, "EI/L^2 = ", "metres"),
        Mistake("no diameter", "wire(diameter=0)", ValueError, "must be finite and > 0", "a diameter > 0"),
        Mistake(
            "inner and outer diameter exchanged: a wall below zero",
            "tube(outer_diameter=2e-3, inner_diameter=3e-3)",
            ValueError,
            "smaller than outer_diameter",
            "the larger as outer_diameter",
        ),
        Mistake(
            "moduli in GPa",
            "tube(young_modulus=60, shear_modulus=23)",
            WARNING,
            "young_modulus = 60 Pa is softer than soft rubber, 1e5 Pa; if it is in GPa, give 6e+10",
            "pascals",
        ),
        Mistake(
            "moduli in MPa, or N/mm^2", "tube(young_modulus=60e3, shear_modulus=23e3)", WARNING, "N/mm^2, give 6e+10", "pascals"
        ),
        Mistake("only G in GPa", "tube(shear_modulus=23)", WARNING, "shear_modulus = 23 Pa", "pascals"),
        Mistake("moduli in kPa taken for GPa", "wire(young_modulus=200e15)", WARNING, "stiffer than any material", "pascals"),
        Mistake(
            "E and G exchanged",
            "tube(young_modulus=23e9, shear_modulus=60e9)",
            WARNING,
            "Poisson ratio of -0.808: G is at most about E/2; are young_modulus and shear_modulus exchanged",
            "the larger as young_modulus",
        ),
        Mistake(
            "G of another material",
            "tube(young_modulus=70e9, shear_modulus=10e9)",
            WARNING,
            "Poisson ratio of 2.5: is G too small, or E too large",
            "G is E/3 to E/2 of metals and rubbers",
        ),
        Mistake("Poisson's ratio given for G", "tube(shear_modulus=0.3)", WARNING, "give poisson_ratio=0.3", "poisson_ratio="),
        Mistake(
            "Poisson's ratio in percent", "wire(poisson_ratio=30)", ValueError, "must be > -1 and <= 0.5", "a number such as 0.3"
        ),
        Mistake("G and Poisson's ratio", "tube(poisson_ratio=0.3)", TypeError, "not both", "one of them"),
        Mistake(
            "the modulus under another name",
            "mr.Rod.wire(length=0.4, diameter=1e-3, E=200e9)",
            TypeError,
            "did you mean 'young_modulus'",
            "young_modulus=",
        ),
        Mistake(
            "magnetisation in American English",
            "wire(magnetization=(0, 0, 1e5))",
            TypeError,
            "did you mean 'magnetisation'",
            "magnetisation=",
        ),
        Mistake(
            "mass per length under another name",
            "rod(mass_per_length=0.02)",
            TypeError,
            "mean 'linear_density'",
            "linear_density=",
        ),
        Mistake(
            "mass per volume given to Rod",
            "rod(density=6450)",
            TypeError,
            "'linear_density', that times the area",
            "linear_density=, density times the area; or Rod.wire, Rod.tube",
        ),
        Mistake(
            "mass per length given to Rod.tube", "tube(linear_density=0.02)", TypeError, "density is mass per volume", "density="
        ),
        Mistake(
            "stiffnesses by their symbols",
            "mr.Section(length=0.4, EI=0.2, GJ=0.1)",
            TypeError,
            "did you mean 'bending_stiffness'?; did you mean 'torsional_stiffness'?",
            "bending_stiffness=, torsional_stiffness=",
        ),
        Mistake(
            "moduli given to Rod",
            "mr.Rod(length=0.4, young_modulus=60e9, shear_modulus=23e9)",
            TypeError,
            "Rod.wire, Rod.tube and Rod.strip take moduli",
            "Rod.tube, Rod.wire or Rod.strip",
        ),
        Mistake(
            "no stiffness at all",
            "mr.Rod(length=0.4)",
            TypeError,
            "needs bending_stiffness",
            "EI and GJ, or Rod.tube or Rod.wire",
        ),
        Mistake("density in g/cm^3", "tube(density=6.45)", WARNING, "if it is in g/cm^3, give 6450", "kg/m^3"),
        Mistake("density of a heavy metal in g/cm^3", "wire(density=19.3)", WARNING, "is no material", "kg/m^3"),
        Mistake(
            "mass per length in g/m",
            "rod(linear_density=44, outer_diameter=3e-3)",
            WARNING,
            "means a density of 6.22e+06 kg/m^3, which is heavier than osmium, 3e4 kg/m^3; if it is in g/m, give 0.044",
            "kg/m",
        ),
        Mistake(
            "density given as linear_density",
            "rod(linear_density=6450, outer_diameter=3e-3)",
            WARNING,
            "heavier than osmium",
            "kg/m: density times cross-section",
        ),
        Mistake(
            "stiffnesses in N mm^2",
            "rod(bending_stiffness=223300, torsional_stiffness=63800)",
            WARNING,
            "if EI is in N mm^2, give 0.2233",
            "N m^2",
        ),
        Mistake(
            "stiffnesses in N mm^2, diameter known",
            "rod(bending_stiffness=223300, torsional_stiffness=63800, outer_diameter=3e-3)",
            WARNING,
            "means a Young's modulus of 5.62e+16 Pa",
            "N m^2",
        ),
        Mistake("only GJ in N mm^2", "rod(torsional_stiffness=63800)", WARNING, "in different units", "N m^2"),
        Mistake(
            "EI and GJ exchanged",
            "rod(bending_stiffness=0.0638, torsional_stiffness=0.2233)",
            WARNING,
            "torsional_stiffness = 0.2233 N m^2 is too much",
            "GJ is at most about EI",
        ),
        Mistake(
            "E given for EI", "rod(bending_stiffness=60e9, torsional_stiffness=23e9)", WARNING, "EI/L^2 = 3.75e+11", "E times I"
        ),
        Mistake(
            "E given for EA",
            "rod(axial_stiffness=60e9, outer_diameter=3e-3)",
            WARNING,
            "it is a modulus times an area",
            "E times the cross-section",
        ),
        Mistake("a negative stiffness", "rod(bending_stiffness=-0.2)", ValueError, "must be finite and > 0", "a number > 0"),
        Mistake("a number as text", "rod(length='0.4')", ValueError, "must be numeric", "a number"),
        Mistake(
            "magnetisation of the material given to Rod",
            "rod(magnetisation=(0, 0, 1e5), outer_diameter=1e-3)",
            WARNING,
            "more than any magnet",
            "Rod.tube or Rod.wire, or A/m times the cross-section",
        ),
        Mistake("remanence in T for magnetisation", "wire(magnetisation=(0, 0, 0.12))", WARNING, "remanence in T", "A/m"),
    ],
    "Rods: shape": [
        Mistake(
            "radius given for curvature",
            "tube(precurvature=(0.07, 0, 0))",
            WARNING,
            "if it is a radius in m, give 14.2857",
            "one over the radius [1/m]",
        ),
        Mistake("curvature in 1/mm", "tube(precurvature=(0.014, 0, 0))", WARNING, "in 1/mm, 14", "1/m"),
        Mistake(
            "a radius below the tube's own, such as one in mm",
            "tube(precurvature=(700, 0, 0))",
            WARNING,
            "less than the rod's own, 0.0015 m; if it is a radius in mm, give 1.42857",
            "1/m",
        ),
        Mistake(
            "curvature in degrees per metre",
            "rod(precurvature=(802, 0, 0))",
            WARNING,
            "degrees per m, give 13.99",
            "radians per metre",
        ),
        Mistake("curvature along z", "tube(precurvature=(0, 0, 14))", WARNING, "leaves it straight", "(about x, about y, twist)"),
        Mistake("curvature as one number", "tube(precurvature=14)", ValueError, "give x, y and z", "(about x, about y, twist)"),
        Mistake(
            "curvature as two numbers", "tube(precurvature=(14, 5))", ValueError, "shape (..., 3)", "(about x, about y, twist)"
        ),
        Mistake(
            "sections that do not add up",
            "tube(precurvature=[(0.3, (0, 0, 0)), (0.2, (14, 0, 0))])",
            ValueError,
            "section lengths must add up to length = 0.4",
            "lengths of sections, not where they end",
        ),
        Mistake(
            "a function that returns one number",
            "tube(precurvature=lambda s: 14 * s)",
            ValueError,
            "must be 3 finite numbers",
            "three numbers at each s",
        ),
        Mistake(
            "a function of arclength in mm",
            "robot.inputs(distributed_force=lambda s: (0.5 if 200 < s < 300 else 0, 0, 0))",
            WARNING,
            "distributed_force(s) is zero all along, from s = 0 to 0.4 m, but not at s = ",
            "lambda s: ... 0.2 < s < 0.3 ...",
        ),
        Mistake(
            "a tendon that may push",
            "mr.Limits(tension=(-5, 5))",
            ValueError,
            "tendons do not push; give (0, 5.0)",
            "tension=(0, 5)",
        ),
        Mistake("sections as pairs", "mr.Rod(sections=[(0.3, 0.02)])", ValueError, "list of Section", "mr.Section(...)"),
        Mistake(
            "spacing of discs in mm",
            "wire(lines=[mr.Tendon((0.01, 0))], discs=20)",
            WARNING,
            "if it is in mm, give 0.02",
            "metres",
        ),
        Mistake(
            "how many discs there are",
            "wire(lines=[mr.Tendon((0.01, 0))], discs=12)",
            WARNING,
            "if it is how many there are, their spacing, 0.0333333",
            "their spacing [m]",
        ),
        Mistake(
            "the angle of a route in degrees",
            "wire(lines=[mr.Tendon(route=lambda s: (0.01 * np.cos(900 * s), 0.01 * np.sin(900 * s)))])",
            WARNING,
            "if its angle is in degrees, np.radians makes it 1",
            "np.radians(900 * s)",
        ),
        Mistake("offset of a tendon in mm", "wire(lines=[mr.Tendon((10, 0))])", WARNING, "if it is in mm, give 0.01", "metres"),
        Mistake("offset of a tendon as two numbers", "mr.Tendon(0.01, 0)", TypeError, "one pair", "a pair, (0.01, 0)"),
        Mistake("offset of a tendon as a point", "mr.Tendon((0.01, 0, 0))", ValueError, "two numbers", "x and y in the section"),
        Mistake(
            "end of a tendon in mm", "wire(lines=[mr.Tendon((0.01, 0), end=200)])", ValueError, "at most the length", "metres"
        ),
        Mistake(
            "friction in percent",
            "wire(lines=[mr.Tendon((0.01, 0), friction=10)])",
            WARNING,
            "percent, give 0.1",
            "a coefficient",
        ),
        Mistake(
            "rest length in mm",
            "wire(lines=[mr.Tendon((0.01, 0), driven='displacement', rest_length=400, axial_stiffness=1e4)])",
            WARNING,
            "if it is in mm, give 0.4",
            "metres",
        ),
        Mistake(
            "area of a chamber in mm^2", "wire(lines=[mr.Chamber((0.01, 0), area=100)])", WARNING, "mm^2, give 0.0001", "m^2"
        ),
        Mistake(
            "a soft rod with a chamber that cannot become longer",
            "wire(length=0.1, diameter=0.02, young_modulus=1e6, lines=[mr.Chamber((0.006, 0), area=2e-5)])",
            WARNING,
            "give extensible=True",
            "extensible=True",
        ),
    ],
    "Robots": [
        Mistake(
            "a list of rods for a single one",
            "mr.SingleRod([rod(), rod()])",
            TypeError,
            "make ConcentricTubes",
            "the robot that couples them",
        ),
        Mistake("a rod for a list", "mr.ConcentricTubes(inner)", TypeError, "must be a list of Rod", "a list"),
        Mistake(
            "tubes one by one",
            "mr.ConcentricTubes(inner, outer)",
            TypeError,
            "tubes are one list",
            "one list, ConcentricTubes([inner, outer])",
        ),
        Mistake(
            "tubes outermost first", "mr.ConcentricTubes([outer, inner])", ValueError, "listed innermost first", "innermost first"
        ),
        Mistake(
            "tubes that do not fit",
            "mr.ConcentricTubes([inner, tube(outer_diameter=4e-3, inner_diameter=2.5e-3)])",
            ValueError,
            "must be <= the inner diameter of tubes[1]",
            "diameters that fit",
        ),
        Mistake(
            "a wire around a tube",
            "mr.ConcentricTubes([inner, wire(diameter=5e-3)])",
            ValueError,
            "must be > 0: tubes[0] lies inside",
            "a tube with an inner diameter",
        ),
        Mistake(
            "offsets of tubes in mm", "mr.EccentricTubes([inner, tube()], [(2, 0), (-2, 0)])", WARNING, "give 0.002", "metres"
        ),
        Mistake(
            "offsets of a multibackbone in mm",
            "mr.multibackbone(wire(), [wire()] * 2, offsets=[(3, 0), (0, 3)], discs=2)",
            WARNING,
            "multibackbone.offsets of 3 m are more than half of the length, 0.4 m; if they are in mm, give 0.003",
            "metres",
        ),
        Mistake(
            "rods of a multibackbone that cannot stretch",
            "mr.multibackbone(wire(), [wire()] * 2, offsets=[(3e-3, 0), (-3e-3, 0)], discs=2)",
            WARNING,
            "2 of them do not stretch, and bending gives 1 of their lengths alone",
            "`Rod.wire(..., extensible=True)`",
        ),
        Mistake(
            "a tendon outside of its tube",
            "mr.ConcentricTubes([tube(lines=[mr.Tendon((0.01, 0))]), outer])",
            WARNING,
            "beyond the inside of the tube around it, of radius 0.002 m",
            "within the tube around it",
        ),
        Mistake(
            "a rotation for a pose",
            "mr.SingleRod(rod(), base=np.eye(3))",
            ValueError,
            "give mr.Pose(position=(0, 0, 0)",
            "shape (4, 4)",
        ),
        Mistake(
            "a position for a pose", "mr.SingleRod(rod(), base=(0, 0, 0.1))", ValueError, "give mr.Pose(position=", "shape (4, 4)"
        ),
        Mistake(
            "position and angles for a pose",
            "mr.SingleRod(rod(), base=(0, 0, 0.1, 0, 0, 0))",
            ValueError,
            "position and angles",
            "shape (4, 4)",
        ),
        Mistake(
            "position and quaternion for a pose",
            "mr.SingleRod(rod(), base=(0, 0, 0.1, 0, 0, 0, 1))",
            ValueError,
            "position and quaternion",
            "shape (4, 4)",
        ),
        Mistake(
            "a pose transposed",
            "base = np.eye(4); base[3, :3] = (0, 0, 0.1); mr.SingleRod(rod(), base=base)",
            ValueError,
            "it is transposed",
            "the position in the last column",
        ),
        Mistake(
            "a left-handed frame",
            "mr.SingleRod(rod(), base=np.diag([1, 1, -1, 1]))",
            ValueError,
            "a mirror image",
            "right-handed axes, body to world",
        ),
        Mistake(
            "a rotation with few digits",
            turned("0.1", "; mr.SingleRod(rod(), base=base.round(3))"),
            ValueError,
            "it is rounded, give all digits",
            "full precision",
        ),
        Mistake(
            "a rotation that is none",
            "mr.SingleRod(rod(), base=2 * np.eye(4))",
            ValueError,
            "must be a rotation",
            "a rotation matrix",
        ),
        Mistake(
            "positions of bases in mm",
            "base = np.eye(4); base[0, 3] = 120; mr.SingleRod(rod(), base=base)",
            WARNING,
            "position = 120 m is more than 10 m; if it is in mm, give 0.12",
            "metres",
        ),
        Mistake(
            "positions of legs in dm",
            "poses = np.tile(np.eye(4), (6, 1, 1)); poses[:, 0, 3] = 0.87 * np.arange(6); legs(base=poses)",
            WARNING,
            "legs of at most 0.4 m are 4.35 m apart",
            "metres",
        ),
        Mistake(
            "positions of legs for poses",
            "legs(base=np.zeros((6, 3)))",
            ValueError,
            "of a position alone",
            "shape (leg_count, 4, 4)",
        ),
        Mistake(
            "fewer poses than legs",
            "legs(base=np.tile(np.eye(4), (5, 1, 1)))",
            ValueError,
            "must have shape (..., 6, 4, 4)",
            "one pose a leg",
        ),
        Mistake("mass of the platform in g", "legs(platform_mass=200)", WARNING, "if it is in g, give 0.2", "kg"),
        Mistake(
            "a kind of joint misspelt", "legs(joints='sperical')", ValueError, "did you mean 'spherical'", "one of those listed"
        ),
        Mistake(
            "a joint under another name",
            "mr.Joint('arm', 'base', to=mr.ground, kind='hinge', axis=(1, 0, 0))",
            ValueError,
            "did you mean 'revolute'",
            "kind='revolute'",
        ),
        Mistake(
            "the joint at the tip of a leg forgotten",
            "mr.Network(rods=dict.fromkeys('abc', wire()), bodies=[plate := mr.Body('plate')], joints="
            "[mr.Joint(k, 'base', to=mr.ground) for k in 'abc'] + [mr.Joint(k, 'tip', to=plate) for k in 'ab'])",
            WARNING,
            "if it is a leg too, Joint('c', 'tip', to=...) is missing",
            "a joint for each tip",
        ),
    ],
    "Inputs": [
        Mistake(
            "a name misspelt",
            "robot.inputs(tip_forc=(1, 0, 0))",
            TypeError,
            "did you mean 'tip_force'",
            "robot.input_specs lists them",
        ),
        Mistake(
            "a name from elsewhere",
            "robot.inputs(force=(1, 0, 0))",
            TypeError,
            "did you mean 'tip_force'",
            "robot.input_specs lists them",
        ),
        Mistake(
            "stiffnesses of two instances as two numbers",
            "mr.SingleRod(rod(bending_stiffness=np.linspace(0.2, 0.3, 2))).inputs(tip_force=np.zeros((2, 3)))",
            WARNING,
            "if it is one for each instance, give [[0.2], [0.3]]",
            "shape (n, 1)",
        ),
        Mistake(
            "four angles for three tubes",
            "mr.ConcentricTubes([inner, outer, tube(length=0.1, outer_diameter=7e-3, inner_diameter=6e-3)])"
            ".inputs(rotation=(0, 0, 0, 0))",
            ValueError,
            "one number for each of 3 rods",
            "one for each tube",
        ),
        Mistake("angles in degrees", "robot.inputs(rotation=90)", WARNING, "if it is in degrees, give 1.5708", "radians"),
        Mistake(
            "angles of a motion in degrees",
            "robot.inputs(rotation=np.linspace(0, 47, 100))",
            WARNING,
            "if it is in degrees, give 0.820305",
            "radians",
        ),
        Mistake("translation in mm", "robot.inputs(translation=20)", WARNING, "if it is in mm, give 0.02", "metres"),
        Mistake("more is pulled in than there is", "robot.inputs(translation=-0.5)", ValueError, "no rod is left", "> -length"),
        Mistake(
            "tubes that start before the plate",
            "tubes.inputs(translation=(0.1, 0.05))",
            ValueError,
            "must be <= 0",
            "zero or less",
        ),
        Mistake("translation of tubes in mm", "tubes.inputs(translation=(-100, -50))", ValueError, "or is it in mm?", "metres"),
        Mistake(
            "a direction left out",
            "robot.inputs(tip_force=1)",
            ValueError,
            "one number has no direction: give x, y and z",
            "(x, y, z)",
        ),
        Mistake("gravity as a number", "robot.inputs(gravity=9.81)", ValueError, "such as (0, 0, -1)", "(0, 0, -9.81)"),
        Mistake("a force in a plane", "robot.inputs(tip_force=(1, 0))", ValueError, "in a plane the third is 0", "(x, y, 0)"),
        Mistake(
            "a wrench for a force", "robot.inputs(tip_force=np.zeros(6))", ValueError, "a wrench is two inputs", "tip_moment="
        ),
        Mistake(
            "forces of samples side by side",
            "robot.inputs(tip_force=np.zeros((3, 50)))",
            ValueError,
            "it is transposed: give its .T, shape (50, 3)",
            "shape (samples, 3)",
        ),
        Mistake(
            "rotations of tubes side by side",
            "tubes.inputs(rotation=np.zeros((2, 50)))",
            ValueError,
            "it is transposed: give its .T, shape (50, 2)",
            "shape (samples, tubes)",
        ),
        Mistake(
            "one rotation for all tubes in each sample",
            "tubes.inputs(rotation=np.zeros(50))",
            ValueError,
            "one column for each of 2",
            "shape (samples, tubes)",
        ),
        Mistake(
            "series of two lengths",
            "robot.inputs(rotation=np.zeros(50), tip_force=np.zeros((60, 3)))",
            ValueError,
            "do not broadcast: rotation (50,), tip_force (60,)",
            "the same number of samples",
        ),
        Mistake(
            "a function of time",
            "robot.inputs(tip_force=lambda t: (t, 0, 0))",
            ValueError,
            "what changes with time is an array",
            "an array (samples, 3), for mr.simulate",
        ),
        Mistake("a gap in the data", "robot.inputs(tip_force=(np.nan, 0, 0))", ValueError, "must be finite", "finite numbers"),
        Mistake("a moment in N mm", "robot.inputs(tip_moment=(0, 200, 0))", WARNING, "is it in N mm", "N m"),
        Mistake(
            "a force that no such rod bears",
            "mr.SingleRod(rod(bending_stiffness=2e-7, torsional_stiffness=1e-7)).inputs(tip_force=(1, 0, 0))",
            WARNING,
            "EI/L^2 of a rod of EI = 2e-07 N m^2",
            "look at forces, moduli and diameters",
        ),
        Mistake(
            "gravity in mm/s^2", "mr.SingleRod(wire(density=7850)).inputs(gravity=(0, 0, -9810))", WARNING, "give 9.81", "m/s^2"
        ),
        Mistake("gravity in g", "mr.SingleRod(wire(density=7850)).inputs(gravity=(0, 0, -1))", WARNING, "if it is in g", "m/s^2"),
        Mistake(
            "gravity on what weighs nothing",
            "robot.inputs(gravity=(0, 0, -9.81))",
            ValueError,
            "no rod has a linear_density",
            "density=, or linear_density=",
        ),
        Mistake("a tendon that pushes", "pulled.inputs(tension=-5)", ValueError, "a tendon cannot push", "a number >= 0"),
        Mistake(
            "tension without a tendon", "robot.inputs(tension=5)", ValueError, "no rod has a line", "Rod(lines=[mr.Tendon(...)])"
        ),
        Mistake("tension in mN", "pulled.inputs(tension=2000)", WARNING, "forces are in N", "N"),
        Mistake("displacement in mm", "pulled.inputs(displacement=5)", WARNING, "if it is in mm, give 0.005", "metres"),
        Mistake(
            "pressure in kPa or bar", "blown.inputs(pressure=50)", WARNING, "in kPa, give 50000, in bar, give 5e+06", "pascals"
        ),
        Mistake("a magnetic field in mT", "magnet.inputs(magnetic_field=(20, 0, 0))", WARNING, "if it is in mT, give 0.02", "T"),
        Mistake(
            "where a force acts in mm", "legs().inputs(force_point=(50, 0, 0))", WARNING, "if it is in mm, give 0.05", "metres"
        ),
        Mistake(
            "the pose of a platform that is found",
            "legs().inputs(platform_position=(0, 0, 0.4))",
            TypeError,
            "robot.inverse()",
            "robot.inverse(), or mr.reach",
        ),
        Mistake(
            "an inverse problem without a pose",
            "legs().inverse().inputs()",
            TypeError,
            "platform_position was not given",
            "inputs(platform_position=...)",
        ),
        Mistake(
            "the angle of a platform in degrees",
            "legs().inverse().inputs(platform_position=(0, 0, 0.4), platform_rotation=(0, 0, 15))",
            WARNING,
            "if it is in degrees, give 0.261799",
            "radians",
        ),
        Mistake(
            "the turn of what holds an end in degrees",
            "mr.HeldRod(rod()).inputs(end_rotation=(0, 0, 90))",
            WARNING,
            "if it is in degrees, give 1.5708",
            "radians",
        ),
        Mistake(
            "a base turned that turns back",
            "mr.HeldRod(rod(), base_joint='spherical').inputs(rotation=0.5)",
            WARNING,
            "rotation = 0.5 rad does nothing",
            "another base_joint, or end_rotation",
        ),
        Mistake(
            "a column that is pressed against a clamp that does not slide",
            "mr.HeldRod(rod()).inputs(tip_force=(0, 0, -5))",
            WARNING,
            "tip_force = 5 N does nothing: what holds the end takes it",
            "slide=(0, 0, 1)",
        ),
    ],
    "Solving": [
        Mistake(
            "a rotation matrix for a rotation vector",
            "legs().inverse().inputs(platform_position=(0, 0, 0.4), platform_rotation=np.eye(3))",
            WARNING,
            "platform_rotation, shape (3, 3), is a rotation matrix",
            "its rotation vector",
        ),
        Mistake(
            "a rod for a robot",
            "mr.solve(rod())",
            TypeError,
            "robot must be an assembly such as SingleRod(rod)",
            "mr.SingleRod(rod)",
        ),
        Mistake(
            "inputs of another robot",
            "mr.solve(tubes, robot.inputs(tip_force=(1, 0, 0)))",
            ValueError,
            "made by another robot, which has 1 rod: this ConcentricTubes has 2",
            "tubes.inputs(...)",
        ),
        Mistake(
            "a status compared with a string",
            "mr.Status.CONVERGED == 'CONVERGED'",
            TypeError,
            "its .name == 'CONVERGED'",
            "mr.Status.CONVERGED",
        ),
        Mistake(
            "a status taken for whether all went well",
            "bool(mr.solve(robot, robot.inputs()).status)",
            TypeError,
            "ask its .failed",
            "solution.status.failed, or solution.raise_if_failed()",
        ),
        Mistake(
            "a solution taken for whether all went well",
            "bool(mr.solve(robot, robot.inputs()))",
            TypeError,
            "Solution is neither true nor false: ask its .failed",
            "solution.failed, or solution.raise_if_failed()",
        ),
        Mistake(
            "one of a batch where there is none",
            "mr.solve(robot, robot.inputs(tip_force=(1, 0, 0)))[0]",
            IndexError,
            "this Solution is of one instance",
            "the solution itself",
        ),
        Mistake(
            "a result by its name in brackets",
            "mr.solve(robot, robot.inputs(tip_force=[(1, 0, 0), (0, 1, 0)]))['tip_position']",
            IndexError,
            "asked by name, .tip_position",
            "solution.tip_position",
        ),
        Mistake("an input by its name in brackets", "robot.inputs()['tip_force']", IndexError, ".tip_force", "inputs.tip_force"),
        Mistake(
            "one shape of a batch",
            "mr.solve(robot, robot.inputs(tip_force=[(1, 0, 0), (0, 1, 0)])).rod(0)[1]",
            TypeError,
            "index one of its arrays",
            "solution[1].rod(0), or solution.rod(0).position[1]",
        ),
        Mistake(
            "statuses of a batch compared with a string",
            "mr.solve(robot, robot.inputs(tip_force=[(1, 0, 0), (0, 1, 0)])).status == 'CONVERGED'",
            TypeError,
            "a Status is compared with a Status, not with 'CONVERGED'",
            "mr.Status.CONVERGED",
        ),
        Mistake(
            "tensions by names that lines do not have",
            "pulled.inputs(tension={'first': 1})",
            ValueError,
            "shape (..., 1): they are taken by name where each of these lines has a name of its own",
            "Tendon(name='first', ...), or numbers in the order of the lines",
        ),
        Mistake(
            "inputs without names", "robot.inputs((1, 0, 0))", TypeError, "inputs are named", "robot.inputs(tip_force=(1, 0, 0))"
        ),
        Mistake(
            "a guess by a word",
            "mr.solve(robot, guess='last')",
            ValueError,
            "must be numeric, a Solution or its unknowns",
            "guess=solution",
        ),
        Mistake(
            "a guess of another robot",
            "mr.solve(tubes, guess=mr.solve(robot, robot.inputs(tip_force=(1, 0, 0))))",
            ValueError,
            "a Solution of SingleRod that has 3 unknowns is not allowed: must be of this robot",
            "a solution of the robot",
        ),
        Mistake(
            "names of a Jacobian in a tuple",
            "mr.solve(robot, robot.inputs()).jacobian(('rotation', 'tip_force'))",
            TypeError,
            "give the names one after another",
            "jacobian('rotation', 'tip_force')",
        ),
        Mistake(
            "a place along a rod by a word",
            "mr.solve(robot, robot.inputs()).along('tip')",
            ValueError,
            "an arclength along the rod [m]",
            "tip_position, or along(0.4)",
        ),
        Mistake(
            "inputs as a dictionary",
            "mr.solve(robot, {'tip_force': (1, 0, 0)})",
            TypeError,
            "must be made by robot.inputs(...)",
            "robot.inputs(...)",
        ),
        Mistake(
            "inputs by name",
            "mr.solve(robot, tip_force=(1, 0, 0))",
            TypeError,
            "inputs are made by the robot",
            "mr.solve(robot, robot.inputs(...))",
        ),
        Mistake("a solver's class", "mr.solve(robot, solver=mr.Observer)", TypeError, "make one, Observer()", "mr.Observer()"),
        Mistake(
            "a solver's name",
            "mr.solve(robot, solver='newton')",
            TypeError,
            "must be a Solver such as Shooting()",
            "mr.Shooting()",
        ),
        Mistake(
            "steps of an integrator for a solver's", "mr.Shooting(steps=100)", TypeError, "integrator=RK4(100)", "an integrator"
        ),
        Mistake("a step size for steps", "mr.RK4(0.01)", ValueError, "must be an integer >= 1", "how many steps"),
        Mistake(
            "an option misspelt", "mr.Observer(coupling='perrod')", ValueError, "did you mean 'per-rod'", "one of those listed"
        ),
        Mistake("no time step", "mr.Tracker(robot, solver=mr.Observer())", TypeError, "Observer goes by it", "dt="),
        Mistake(
            "a time step in ms",
            "mr.Tracker(robot, solver=mr.Observer(integrator=mr.RK4(50)), dt=5, inputs=robot.inputs(tip_force=(1, 0, 0)))",
            WARNING,
            "if it is in ms, give 0.005",
            "seconds",
        ),
        Mistake(
            "times that go back",
            "mr.simulate(robot, robot.inputs(), time=[0, 0.2, 0.1])",
            ValueError,
            "must increase from each sample to the next",
            "samples in the order of time",
        ),
        Mistake(
            "fewer inputs than times",
            "mr.simulate(robot, robot.inputs(tip_force=np.zeros((4, 3))), time=np.arange(50) / 200)",
            ValueError,
            "the first must be time, 50 samples",
            "one row a sample",
        ),
        Mistake(
            "a force in mN",
            "mr.solve(mr.SingleRod(rod(outer_diameter=3e-3)), robot.inputs(tip_force=(500, 0, 0)))",
            WARNING,
            "the outer fibre of the rod is strained by",
            "newtons",
        ),
        Mistake(
            "a rod that is not there",
            "mr.solve(robot, robot.inputs(tip_force=(1, 0, 0))).rod(1)",
            ValueError,
            "must be an index below 1",
            "its index or name",
        ),
        Mistake(
            "of which of six legs is not said",
            "mr.solve(legs(), legs().inputs()).rod()",
            ValueError,
            "of 6 rods that stand apart it must be an index below 6",
            "rod(0) to rod(5), or by their names",
        ),
        Mistake(
            "derivatives by a name from elsewhere",
            "mr.solve(robot, robot.inputs(tip_force=(1, 0, 0))).jacobian('force')",
            TypeError,
            "did you mean 'tip_force'",
            "the name of an input",
        ),
        Mistake(
            "critical loads of tubes that nothing loads",
            "mr.critical_loads(tubes, tubes.inputs(rotation=(0, 3), translation=(-0.1, -0.05)))",
            ValueError,
            "to raise the rotation from zero, give start=robot.inputs(translation=inputs.translation)",
            "start=, what is raised left out",
        ),
    ],
    "Steering and estimating": [
        Mistake(
            "a parameter by its symbol",
            "mr.calibrate(robot, parameters=('EI',), measured=mr.Pose(position=(0, 0, 0.4), sigma=1e-3))",
            TypeError,
            "did you mean 'bending_stiffness'",
            "one of those listed",
        ),
        Mistake(
            "a target in mm",
            "mr.reach(robot, mr.Pose(position=(50, 0, 280)), free='tip_force')",
            WARNING,
            "target.position = 280 m is more than 10 m; if it is in mm, give 0.28",
            "metres",
        ),
        Mistake(
            "a position for a target",
            "mr.reach(robot, (0.05, 0, 0.28), free='rotation')",
            TypeError,
            "such as Pose(position=",
            "mr.Pose(position=...)",
        ),
        Mistake(
            "angles for a rotation",
            "mr.Pose(position=(0, 0, 0.3), rotation=(0, 0, 90))",
            ValueError,
            "are made one by SciPy's Rotation",
            "a matrix, body to world",
        ),
        Mistake(
            "a tip of an estimate",
            "mr.estimate(robot, unknown={'tip_force': mr.Prior(0, sigma=1)}, "
            "measured=mr.Pose(position=(0.05, 0, 0.28), sigma=1e-3)).tip_position",
            AttributeError,
            "its equilibrium has: solution.tip_position",
            "found.solution.tip_position",
        ),
        Mistake(
            "a network without names",
            "mr.Network({'a': rod}, [])",
            TypeError,
            "named are rods=, bodies=, joints=",
            "Network(rods={'a': rod}, joints=[...])",
        ),
        Mistake(
            "NaN for a coordinate of a target that is free",
            "mr.reach(robot, mr.Pose(position=(np.nan, np.nan, 0.28)), free='rotation')",
            ValueError,
            "along=direction two",
            "mr.Pose(position=(0, 0, 0.28), along=(0, 0, 1))",
        ),
        Mistake(
            "a magnetic field to be chosen for a rod that is no magnet",
            "mr.reach(robot, mr.Pose(position=(0.05, 0, 0.28)), free='magnetic_field')",
            ValueError,
            "magnetic_field does nothing: no rod has a magnetisation",
            "rods with a magnetisation=",
        ),
        Mistake("a matrix for a pose", "mr.Pose(np.eye(4))", TypeError, "position=T[:3, 3]", "position=, rotation="),
        Mistake(
            "a pose for a position", "mr.Pose(position=np.eye(4))", ValueError, "must have shape (..., 3)", "position=, rotation="
        ),
        Mistake(
            "a free input misspelt",
            "mr.reach(robot, mr.Pose(position=(0.05, 0, 0.28)), free='rotatoin')",
            TypeError,
            "did you mean 'rotation'",
            "the name of an input",
        ),
        Mistake(
            "limits as a pair for each of three tubes",
            "mr.Limits(translation=[(-0.1, 0)] * 3)",
            ValueError,
            "give ([lows], [highs]): ([-0.1, -0.1, -0.1], [0, 0, 0])",
            "all lows, then all highs",
        ),
        Mistake(
            "limits as a pair for each of two tubes",
            "mr.Limits(translation=[(-0.2, 0), (-0.1, 0)])",
            ValueError,
            "give ([lows], [highs]): ([-0.2, -0.1], [0, 0])",
            "all lows, then all highs",
        ),
        Mistake("limits in mm", "mr.Limits(translation=(-120, 0))", WARNING, "if it is in mm, give 0.12", "metres"),
        Mistake("limits in degrees", "mr.Limits(rotation=(-180, 180))", WARNING, "if it is in degrees, give 3.14159", "radians"),
        Mistake(
            "a deviation in mm",
            "mr.Pose(position=(0.05, 0, 0.28), rotation=np.eye(3), sigma=(0.5, 0.01))",
            WARNING,
            "if it is in mm, give 0.0005",
            "metres, and radians",
        ),
        Mistake(
            "a deviation in degrees",
            "mr.Pose(position=(0.05, 0, 0.28), rotation=np.eye(3), sigma=(5e-4, 0.5))",
            WARNING,
            "if it is in degrees, give 0.00872665",
            "metres, and radians",
        ),
        Mistake(
            "a prior in mN",
            "mr.estimate(robot, unknown={'tip_force': mr.Prior(0, sigma=300)}, "
            "measured=mr.Pose(position=(0.05, 0, 0.28), sigma=1e-3))",
            WARNING,
            "if it is in mN, give 0.3",
            "newtons",
        ),
        Mistake(
            "a prior of a push in mm",
            "mr.estimate(robot, unknown={'translation': mr.Prior(0, sigma=2)}, "
            "measured=mr.Pose(position=(0.05, 0, 0.28), sigma=1e-3))",
            WARNING,
            "if it is in mm, give 0.002",
            "metres",
        ),
        Mistake(
            "two deviations for a position alone",
            "mr.Pose(position=(0.05, 0, 0.28), sigma=(5e-4, 5e-3))",
            ValueError,
            "must be one number: of the position",
            "sigma=5e-4, or a rotation too",
        ),
        Mistake(
            "a gate in standard deviations",
            "mr.Estimator(robot, dt=1e-3, unknown={'tip_force': mr.Walk(0.3)}, "
            "sensors=mr.Pose(position=(0.05, 0, 0.28), sigma=1e-3), gate=3)",
            ValueError,
            "must be the part of sound measurements that passes",
            "a probability: 0.997",
        ),
        Mistake(
            "a time step of a loop in ms",
            "mr.Controller(robot, dt=20, free='rotation')",
            WARNING,
            "if it is in ms, give 0.02",
            "seconds",
        ),
        Mistake(
            "targets in mm, sample by sample",
            "mr.Controller(robot, dt=1e-3, free='rotation').step(position=(50, 0, 280))",
            WARNING,
            "Controller.step(position) = 280 m is more than 10 m; if it is in mm, give 0.28",
            "metres",
        ),
        Mistake(
            "a deviation for the mean of a prior",
            "mr.Prior(0.1)",
            ValueError,
            "a deviation alone is sigma=0.1",
            "mr.Prior(sigma=...)",
        ),
        Mistake("limits the wrong way round", "mr.Limits(translation=(0, -0.1))", ValueError, "with low <= high", "(low, high)"),
        Mistake(
            "limits of what is not free",
            "mr.reach(robot, mr.Pose(position=(0.05, 0, 0.28)), free='rotation', limits=mr.Limits(translation=(-0.1, 0)))",
            ValueError,
            "must be of an input that is free: rotation",
            "limits of what is free, or more free",
        ),
        Mistake(
            "a measurement in mm",
            "mr.estimate(robot, unknown={'tip_force': mr.Prior(0, sigma=1)}, measured=mr.Pose(position=(50, 0, 280), sigma=0.5))",
            WARNING,
            "measured[0].position = 280 m",
            "metres, sigma too",
        ),
        Mistake(
            "a measurement without its deviation",
            "mr.estimate(robot, unknown={'tip_force': mr.Prior(0, sigma=1)}, measured=mr.Pose(position=(0.05, 0, 0.28)))",
            ValueError,
            "standard deviations of what is measured",
            "sigma=",
        ),
        Mistake(
            "a number for a prior",
            "mr.estimate(robot, unknown={'tip_force': 0.2}, measured=mr.Pose(position=(0.05, 0, 0.28), sigma=1e-3))",
            TypeError,
            "must be a Prior",
            "mr.Prior(mean, sigma=...)",
        ),
        Mistake(
            "a number of the robot among its loads",
            "mr.estimate(robot, unknown={'bending_stiffness': mr.Prior(1, sigma=0.1)}, "
            "measured=mr.Pose(position=(0.05, 0, 0.28), sigma=1e-3))",
            TypeError,
            "mr.calibrate(parameters='bending_stiffness') finds that",
            "mr.calibrate",
        ),
        Mistake(
            "a load and a number of the robot together",
            "mr.estimate(robot, unknown={'tip_force': mr.Prior(sigma=0.5), 'bending_stiffness': mr.Prior(1, sigma=0.1)}, "
            "measured=mr.Pose(position=(0.05, 0, 0.28), sigma=1e-3))",
            TypeError,
            "unknown='tip_force') finds that from measurements, and the others with it",
            "mr.calibrate(..., unknown=...)",
        ),
        Mistake(
            "measured strains for curvatures",
            "mr.Curvature(at=(0.1, 0.2), value=[(1500, 0), (900, 0)], sigma=5)",
            WARNING,
            "Curvature.value = 1500 1/m winds a rod up 47.7 times within 0.2 m",
            "strain over the distance of the fibre from the axis",
        ),
        Mistake(
            "more unknown than is measured",
            "mr.estimate(robot, unknown={'tip_force': mr.Prior(), 'tip_moment': mr.Prior()}, "
            "measured=mr.Pose(position=(0.05, 0, 0.28), sigma=1e-3))",
            ValueError,
            "give them priors, or measure more",
            "priors with a sigma",
        ),
        Mistake(
            "places of curvatures in mm",
            "mr.estimate(robot, unknown={'tip_force': mr.Prior(0, sigma=1)}, "
            "measured=mr.Curvature(at=(100, 200), value=np.zeros((2, 2)), sigma=0.05))",
            ValueError,
            "where the rod ends",
            "metres from the base",
        ),
        Mistake(
            "a parameter under another name",
            "mr.calibrate(robot, parameters='youngs_modulus', measured=mr.Pose(position=(0.05, 0, 0.28), sigma=1e-3))",
            TypeError,
            "it takes bending_stiffness",
            "one of those listed",
        ),
    ],
}
MISTAKES = [mistake for group in GROUPS.values() for mistake in group]


@cache
def prelude() -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(compile(PRELUDE, "<mistake>", "exec"), names)
    return names


@cache
def said(mistake: Mistake) -> tuple[type[Exception] | None, str]:
    """What is raised, or else the warnings about how plausible it is, and whether they point at the code."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            exec(compile(mistake.code, "<mistake>", "exec"), dict(prelude()))
        except Exception as error:  # noqa: BLE001
            return type(error), str(error)
    assert all(warning.filename == "<mistake>" for warning in caught), mistake.name
    if not caught:
        return None, "nothing"
    return caught[0].category, " — ".join(str(warning.message) for warning in caught)


def page() -> str:
    """docs/mistakes.md."""
    parts = [HEAD]
    for title, group in GROUPS.items():
        parts += [f"\n## {title}\n", "| what you did | what it says | what to do |", "|---|---|---|"]
        for mistake in group:
            kind, message = said(mistake)
            message = " ".join(message.split()).replace("|", "\\|").replace("<", "&lt;")
            message = message if len(message) <= MOST else message[:MOST].rsplit(" ", 1)[0] + " ..."
            name = "?" if kind is None else kind.__name__
            parts.append(f"| {mistake.name}: `{mistake.code}` | `{name}`: {message} | {mistake.instead} |")
    return "\n".join(parts) + "\n"


HEAD = f"""\
# Mistakes, and what is said of them

What cannot be is refused by an error that names the field, its value and what is allowed. What can be, and is hardly meant, is
an `mr.PlausibilityWarning`: once, where the thing is made, with what the number would mean and what was probably meant. The
result is the same with it and without. Who means it says so, and who never does, too:

```python
import warnings
import multirod as mr

warnings.filterwarnings("ignore", category=mr.PlausibilityWarning)  # I mean it
warnings.filterwarnings("error", category=mr.PlausibilityWarning)  # in tests and scripts: stop there
```

Limits are in `multirod/plausibility/limits.py`, in one table. They are wide: published robots pass. So not every mistake is
seen: a radius given for a diameter, degrees below 10, a force in mN, a wrong sign. Forces are warned of from 20,000 `EI/L^2`
on: some 10 bend a rod double, but a long thin wire that carries something, pulled along its axis, may well bear thousands.
Below that it is the strain that tells: give rods their diameters. A `Tracker` looks at the inputs that it starts with and at
those that come as `robot.inputs(...)`, not at every sample by name. The strain of the outer fibre is looked at where a diameter
is known: at the base of a single rod as soon as it is solved, along all rods once a shape is asked for; estimates of an
observer are left out.

The table is what the tests run (`tests/mistakes.py`, which writes this page). Its code comes after this:

```python
{PRELUDE}```
"""

if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
