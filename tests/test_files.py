"""Files: robots, inputs and results written and read back by the same bits, tables, meshes, and what is refused."""

import csv
import inspect
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import xarray
from scipy.spatial.transform import Rotation

import multirod as mr
from multirod.files import archive, kinds, meshes
from multirod.files.describing import described
from multirod.files.saving import robot_text
from multirod.files.whole import written
from multirod.profile import Profile
from multirod.segments import Breakpoints

COARSE = mr.Shooting(integrator=mr.RK4(20))
ROD = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, outer_diameter=2e-3)
TUBES = [
    mr.Rod(length=0.30, bending_stiffness=0.004, torsional_stiffness=0.003, precurvature=(9, 0, 0), name="inner"),
    mr.Rod(length=0.22, bending_stiffness=0.017, torsional_stiffness=0.014, precurvature=(5, 0, 0)),
    mr.Rod(length=0.12, bending_stiffness=0.040, torsional_stiffness=0.030, name="outer"),
]
UNUSUAL = 'a "name"\n\\ with [brackets] = # é 漢 🤖 \x7f'


def poses(radius, degrees=(0, 120, 240)):
    angle = np.radians(degrees)
    found = np.tile(np.eye(4), (len(angle), 1, 1))
    found[:, :2, 3] = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return found


def wire_robot(**more):
    return mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(3, 1, 0), **more))


def helix(s):
    return 0.006 * np.cos(30 * s), 0.006 * np.sin(30 * s)


def lined():
    lines = [
        mr.Tendon(offset=(0.008, 0), driven="displacement", axial_stiffness=2000.0, name="right"),
        mr.Tendon(offset=(-0.008, 0), driven="displacement", axial_stiffness=2000.0, end=0.1),
        mr.Chamber(offset=(0, 0.005), area=2e-5, name="chamber"),
    ]
    return mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, lines=lines, discs=0.05))


def tripod(**more):
    return mr.ParallelRods(legs=[mr.ConcentricTubes(TUBES), ROD, ROD], base=poses(0.05), platform=poses(0.03), **more)


def hexapod():
    base, platform = poses(0.05, [-10, 10, 110, 130, 230, 250]), poses(0.05, [-50, 50, 70, 170, 190, 290])
    return mr.ParallelRods(legs=[ROD] * 6, base=base, platform=platform).inverse(limits=(-0.05, [0.01 * k for k in range(6)]))


def network(rod=ROD, holes=(), **more):
    """All that bodies and joints can be made of, no two alike."""
    frames = {UNUSUAL: poses(0.03)[0], "tool": TURNED}
    plate = mr.Body("plate", mass=0.05, mass_centre=(0.01, 0, 1 / 3), pose=TURNED, frames=frames)
    top, hand = mr.Body(UNUSUAL, pose=np.eye(4)), mr.Body("hand", pose=np.eye(4), fixed=True)
    joints = [
        mr.Joint("left", "base", to=mr.ground, pose=poses(0.05)[0]),
        mr.Joint("left", "tip", to=plate, pose=UNUSUAL, kind="revolute", axis=(0, 1, 3), stiffness=0.2, rest=1 / 3),
        mr.Joint("right", "base", to=hand, pose=poses(0.05)[1], kind="universal", axis=np.eye(3)[:2], stiffness=(0.3, 0)),
        mr.Joint("right", "tip", to=plate, pose=poses(0.03)[1], kind="spherical", stiffness=0.1),
        mr.Joint("upper", "base", to=plate),
        mr.Joint("upper", "tip", to=top, kind="universal", axis=[(0, 0, 3), (0.7, 0.1, 0)], stiffness=0.1, rest=(0.1, -0.2)),
        mr.Joint("feeler", "base", to=top, pose=TURNED, kind="revolute", axis=(0, 1, 2), driven=True),
    ]
    rods = {"left": TUBES[0], "right": rod, "upper": rod, "feeler": ROD}
    if holes:
        rods["thread"] = ROD
        joints += [mr.Joint("thread", "base", to=mr.ground), *(mr.Joint("thread", "along", to=plate, **hole) for hole in holes)]
    return mr.Network(rods=rods, bodies=[plate, top, hand], joints=joints, **more)


def every_line():
    """All that lines can be made of, no two alike."""
    return [
        mr.Tendon(offset=(0.008, 0.001), start=0.02, end=0.15, friction=0.1, name=UNUSUAL),
        mr.Tendon(offset=[(0.001, 0.007), (0.002, 0.007)], driven="displacement", axial_stiffness=[40.0, 50.0], rest_length=0.19),
        mr.Tendon(offset=(-0.004, 0.007), driven="displacement", friction=-0.2),
        mr.PushRod(offset=(0.003, -0.004), axial_stiffness=1e4, rest_length=0.2, name="push"),
        mr.Chamber(offset=(0, 0.005), area=[2e-5, 3e-5], area_fixed="section", start=0.1, end=0.19),
    ]


SECTIONS = [
    mr.Section(
        length=[0.1, 0.11],
        bending_stiffness=(0.02, 0.03),
        torsional_stiffness=np.inf,
        precurvature=[(1, 2, 3), (4, 5, 1 / 3)],
        shear_stiffness=(50.0, 60.0),
        axial_stiffness=90.0,
        linear_density=0.1,
        magnetisation=(0.1, 0.2, 0.3),
        foundation=(1.0, 2.0, 3.0),
    ),
    mr.Section(length=0.3, bending_stiffness=[[0.01], [0.02]], torsional_stiffness=0.01, foundation=5.0),
]
TURNED = np.block([[Rotation.from_rotvec((0.3, -0.2, 0.5)).as_matrix(), np.array([[0.1], [0.2], [0.3]])], [0, 0, 0, 1]])
ROBOTS = {
    "one rod": lambda: wire_robot(name=UNUSUAL, outer_diameter=3e-3, inner_diameter=1e-3),
    "sections": lambda: mr.SingleRod(mr.Rod(sections=SECTIONS, name="batch"), base=TURNED),
    "lines": lambda: mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, lines=every_line())),
    "discs": lined,
    "tubes": lambda: mr.ConcentricTubes(TUBES, base=[TURNED, np.eye(4)]),
    "side by side": lambda: mr.EccentricTubes(TUBES[:2], [(0.003, 0.001), (-0.002, 0.002)], base=TURNED),
    "legs": lambda: tripod(
        joints=["clamped", "revolute", "spherical"],
        joint_axes=[(1, 2, 3), (0, 1, 1), (0.1, 0, 0.7)],
        platform_mass=0.02,
        platform_centre=(0, 1e-3, 1 / 3),
    ),
    "inverse": hexapod,
    "held": lambda: mr.HeldRod(
        ROD,
        base=TURNED,
        end=np.eye(4),
        joint="revolute",
        joint_axis=(1, 2, 3),
        slide=(0, 0.1, 0.7),
        base_joint="revolute",
        base_joint_axis=(0, 1, 1),
    ),
    "network": lambda: network(end_effector="feeler", driven=["left", "right"]),
    "network with holes": lambda: network(
        holes=[
            {"at": 0.05, "kind": "prismatic", "pose": TURNED, "stiffness": 40.0, "rest": 0.06},
            {"at": 0.1, "kind": "cylindrical"},
            {"at": 0.15, "kind": "spherical"},
        ],
        end_effector=("plate", "tool"),
    ),
    "network in a batch": lambda: network(base=[TURNED, np.eye(4)], segments={"feeler": 3}),
    "network of tubes": lambda: network(rod=mr.ConcentricTubes(TUBES)),
}


def assert_same(one, other, where="it"):
    """Two robots, rods, ... are of the same numbers, all of them."""
    assert type(one) is type(other), where
    if isinstance(one, Profile):
        one, other = (one.ends, one.coefficients), (other.ends, other.coefficients)
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, where
        np.testing.assert_array_equal(one, other, err_msg=where)
    elif isinstance(one, (list, tuple)):
        assert len(one) == len(other), where
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_same(a, b, f"{where}[{k}]")
    elif isinstance(one, dict):
        assert list(one) == list(other), where
        for name, value in one.items():
            assert_same(value, other[name], f"{where}[{name!r}]")
    elif type(one).__module__.startswith("multirod") and hasattr(one, "__dict__"):
        # what is kept for later has no place in a file
        kept = ("arrays", "_route", "_specs", "longest", "stiffest")
        ours = {name for name in vars(one) if name not in kept}
        assert ours == {name for name in vars(other) if name not in kept}, where
        for name in ours:
            assert_same(getattr(one, name), getattr(other, name), f"{where}.{name}")
    else:
        assert one == other, where


@pytest.mark.parametrize("ending", [".toml", ".npz"])
@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_is_read_back_by_the_same_bits(name, ending, tmp_path):
    robot = ROBOTS[name]()
    robot.save(tmp_path / f"robot{ending}")
    assert_same(mr.load(tmp_path / f"robot{ending}"), robot)


def test_poses_of_legs_are_read_from_a_robot_that_was_loaded(tmp_path):
    poses = np.tile(np.eye(4), (2, 3, 1, 1))
    poses[:, :, :2, 3] = [[(0.1, 0), (0, 0.1), (-0.1, 0)], [(0.05, 0), (0, 0.05), (-0.05, 0)]]
    leg = mr.Rod(length=0.3, bending_stiffness=0.1, torsional_stiffness=0.08)
    mr.ParallelRods(legs=[leg] * 3, base=poses[0], platform=poses[1]).save(tmp_path / "robot.toml")
    robot = mr.load(tmp_path / "robot.toml")
    np.testing.assert_array_equal([robot.base, robot.platform], poses)
    with pytest.raises(ValueError, match="read-only"):
        robot.platform[0, 0, 3] = 1.0


@pytest.mark.parametrize("ending", [".toml", ".npz"])
def test_diameters_of_a_batch_are_read_back(ending, tmp_path):
    made = {"inner_diameter": [0.0, 1e-3], "young_modulus": [[6e10], [7e10], [8e10]], "shear_modulus": 3e10}
    robot = mr.SingleRod(mr.Rod.tube(length=0.2, outer_diameter=[1e-3, 2e-3], **made))
    robot.save(tmp_path / f"robot{ending}")
    assert_same(mr.load(tmp_path / f"robot{ending}"), robot)


def test_a_row_of_a_table_with_text_says_what_to_do(tmp_path):
    robot = mr.SingleRod(mr.Rod(length=0.3, bending_stiffness=0.1, torsional_stiffness=0.08))
    row = np.array([0.1, 0, 0], dtype=object)
    with pytest.raises(ValueError, match=r"of dtype object: give its \.astype\(float\)"):
        robot.inputs(tip_force=row)
    assert robot.inputs(tip_force=row.astype(float)).tip_force[0] == 0.1


def test_the_robots_tried_have_all_that_a_file_may_hold():
    """Each argument of each class is somewhere not its default; and each number has a unit beside it, or has none."""
    shown = {kind: set() for kind in kinds.CLASSES}

    def look(table, part):
        kind = part.kinds[0] if part.kinds[0] in kinds.OF_A_KIND else table.get("kind", part.kinds[0])
        shown[kind] |= set(table)
        for name, inner in kinds.PARTS.get(kind, {}).items():
            tables = table.get(name, [])
            for item in tables if isinstance(tables, list) else [tables]:
                look(item, inner)

    curved = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=1, torsional_stiffness=1, lines=routed()))
    for robot in [*(make() for make in ROBOTS.values()), curved, stiff_push_rod()]:
        look(described(robot, "robot", functions=True), kinds.Part(kinds.ROBOTS, many=False, named=True))
    shown["Rod"] |= shown["Section"]
    shown["Section"] |= {"precurvature"}
    without_unit = {"name", "driven", "friction", "area_fixed", "joints", "joint_axes", "route", "members", "loads"}
    without_unit |= {"joint", "joint_axis", "slide", "base_joint", "base_joint_axis"}
    without_unit |= {"end_effector", "rod", "end", "to", "kind", "axis", "fixed", "frames", "segments"}
    for kind in (*kinds.ROBOTS, *kinds.LINES, "Rod", "Section", "Body", "Joint"):
        arguments = set(kinds.parameters(kinds.CLASSES[kind]))
        only_default = {"driven"} if kind == "PushRod" else set()  # which has no other value
        assert arguments - shown[kind] <= {"members", "loads"} | only_default, kind
        parts = set(kinds.PARTS.get(kind, {}))
        assert {name for name in arguments - parts if name not in kinds.UNITS} <= without_unit, kind


def routed():
    return [
        line(route=helix, **more) for line, more in ((mr.Tendon, {}), (mr.PushRod, {"start": 0.05}), (mr.Chamber, {"area": 1e-5}))
    ]


def stiff_push_rod():
    push = mr.PushRod(offset=(0.003, 0), bending_stiffness=1e-4, end=0.1)
    return mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, lines=[push]))


def test_a_robot_that_was_read_solves_by_the_same_bits(tmp_path):
    robot, place = tripod(), {"translation": (-0.1, -0.1, -0.05, 0, 0)}
    robot.save(tmp_path / "robot.toml")
    inputs = robot.inputs(**place, tip_force=(0.2, 0, -0.3), follower_force=(0, 0.1, 0.2), force_point=(0, 0, 0.01))
    inputs.save(tmp_path / "inputs.toml")
    there = mr.load(tmp_path / "robot.toml")
    one, other = mr.solve(robot, inputs), mr.solve(there, mr.load(tmp_path / "inputs.toml", robot=there))
    assert one.status == mr.Status.CONVERGED
    np.testing.assert_array_equal(one.unknowns, other.unknowns)
    np.testing.assert_array_equal(one.tip_position, other.tip_position)


def test_units_are_beside_the_numbers_of_a_text(tmp_path):
    wire_robot().save(tmp_path / "robot.toml")
    lines = (tmp_path / "robot.toml").read_text().splitlines()
    assert "length = 0.4  # m" in lines
    assert "precurvature = [3.0, 1.0, 0.0]  # 1/m" in lines
    wire_robot().inputs(tip_force=[(1, 0, 0), (0, 1 / 3, 0)]).save(tmp_path / "inputs.toml")
    text = (tmp_path / "inputs.toml").read_text()
    assert "tip_force = [  # N\n    [1.0, 0.0, 0.0],\n    [0.0, 0.3333333333333333, 0.0],\n]" in text
    assert tomllib.loads(text)["version"] == 1


def test_functions_of_arclength_are_kept_as_resolved(tmp_path):
    """Not in text; in an archive they are the polynomials that kernels read."""
    rod = mr.Rod(length=0.2, bending_stiffness=1, torsional_stiffness=1, precurvature=lambda s: (60 * s, 0, 1), lines=routed())
    robot = mr.SingleRod(rod)
    with pytest.raises(ValueError, match=r"robot\.rod\.precurvature = a function of arclength .*save it as \.npz.*sections"):
        robot.save(tmp_path / "robot.toml")
    plain = mr.SingleRod(mr.Rod(length=0.2, bending_stiffness=1, torsional_stiffness=1, lines=routed()))
    with pytest.raises(ValueError, match=r"robot\.rod\.lines\[0\]\.route = a function"):
        plain.save(tmp_path / "robot.toml")
    robot.save(tmp_path / "robot.npz")
    there = mr.load(tmp_path / "robot.npz")
    assert_same(there, robot)
    inputs = robot.inputs(distributed_force=lambda s: (s, s * s, 0), translation=[[-0.01], [0.02]])
    with pytest.raises(ValueError, match=r"inputs\.distributed_force = 'a function of arclength' is not allowed: .*\.npz"):
        inputs.save(tmp_path / "inputs.toml")
    inputs.save(tmp_path / "inputs.npz")
    again = mr.load(tmp_path / "inputs.npz", robot=there)
    assert_same(again.profile("distributed_force"), inputs.profile("distributed_force"))
    np.testing.assert_array_equal(again.translation, inputs.translation)
    assert not list(tmp_path.glob("*.toml"))  # nothing of what was refused
    (tmp_path / "text.toml").write_text(robot_text(robot), encoding="utf-8")  # what a dataset holds
    assert_same(mr.load(tmp_path / "text.toml"), robot)
    there.save(tmp_path / "again.npz")  # without the functions themselves
    assert_same(mr.load(tmp_path / "again.npz"), robot)
    with pytest.raises(ValueError, match="cannot be resolved anew after pickling, or from a file"):
        mr.Rod(length=0.3, bending_stiffness=1, torsional_stiffness=1, precurvature=there.rods[0].sections[0].precurvature)


class Own(mr.SingleRod):
    """A robot of another package."""


def test_what_is_of_other_packages_is_refused_by_name(tmp_path, wire):
    class Backbone(mr.Rod):
        pass

    class Scheme(mr.RK4):
        pass

    own = Own(wire)
    with pytest.raises(ValueError, match=r"robot = .* is not allowed: a file holds only what multirod .*SingleRod.*no Own"):
        own.save(tmp_path / "robot.toml")
    backbone = Backbone(length=0.4, bending_stiffness=1, torsional_stiffness=1)
    with pytest.raises(ValueError, match=r"robot\.rod = .* and no Backbone"):
        mr.SingleRod(backbone).save(tmp_path / "robot.npz")
    solution = mr.solve(own, solver=COARSE)
    with pytest.raises(ValueError, match=r"no Own.*results can be saved as \.csv, \.nc and meshes"):
        solution.save(tmp_path / "solution.npz")
    assert solution.to_xarray().attrs["robot"] == repr(own)
    with pytest.raises(ValueError, match="integrator = .* and no Scheme"):
        mr.solve(mr.SingleRod(wire), solver=mr.Shooting(integrator=Scheme(20))).save(tmp_path / "solution.npz")
    assert list(tmp_path.iterdir()) == []


HAND_WRITTEN = """
kind = "ConcentricTubes"

[[tubes]]
name = "inner"
length = 0.3
bending_stiffness = 4e-3
torsional_stiffness = 3e-3
precurvature = [[0.2, [0, 0, 0]], [0.1, [9, 0, 0]]]

[[tubes]]
kind = "Rod.tube"
length = 0.2
outer_diameter = 2e-3
inner_diameter = 1.5e-3
young_modulus = 60e9
shear_modulus = 23e9
"""


def test_what_someone_wrote_is_read(tmp_path):
    (tmp_path / "robot.toml").write_text(HAND_WRITTEN)
    inner = mr.Rod(
        name="inner",
        length=0.3,
        bending_stiffness=4e-3,
        torsional_stiffness=3e-3,
        precurvature=[(0.2, (0, 0, 0)), (0.1, (9, 0, 0))],
    )
    outer = mr.Rod.tube(length=0.2, outer_diameter=2e-3, inner_diameter=1.5e-3, young_modulus=60e9, shear_modulus=23e9)
    assert_same(mr.load(tmp_path / "robot.toml"), mr.ConcentricTubes([inner, outer]))


MISTAKES = {
    "unknown key": ("length = 0.3", "lenght = 0.3", r"tubes\[0\]\.lenght = 0\.3 is not allowed: .*no such key: Rod takes length"),
    "unknown key at the top": (
        'kind = "ConcentricTubes"',
        'kind = "ConcentricTubes"\nrods = 2',
        r"rods = 2 is not allowed: .*ConcentricTubes takes tubes",
    ),
    "unknown kind": ('"ConcentricTubes"', '"Concentric"', r"kind = 'Concentric' is not allowed: must be one of 'SingleRod'"),
    "unknown kind inside": ('"Rod.tube"', '"Rod.from_file"', r"tubes\[1\]\.kind = 'Rod\.from_file' .*'Rod', 'Rod\.tube'"),
    "no kind": ('kind = "ConcentricTubes"', "", r"kind = None is not allowed: must be one of"),
    "out of range": ("length = 0.3", "length = -0.3", r"tubes\[0\]: Rod\.length = -0\.3 is not allowed: must be finite and > 0"),
    "wrong type": ("length = 0.3", 'length = "0.3"', r"tubes\[0\]: Rod\.length = '0\.3' is not allowed: must be numeric"),
    "a table for a number": (
        "length = 0.3",
        "length = {m = 1}",
        r"tubes\[0\]\.length = {'m': 1} is not allowed: must be numbers",
    ),
    "a date": ("length = 0.3", "length = 2021-01-01", r"tubes\[0\]: Rod\.length = datetime.* must be numeric"),
    "a number for tables": (HAND_WRITTEN, 'kind = "SingleRod"\nrod = 3', r"rod = 3 is not allowed: must be a table"),
    "a number for a list of tables": (HAND_WRITTEN, 'kind = "ConcentricTubes"\ntubes = 3', r"tubes = 3 .*list of tables"),
    "something missing": ("bending_stiffness = 4e-3", "", r"tubes\[0\]: Rod needs bending_stiffness"),
    "no tubes": (HAND_WRITTEN, 'kind = "ConcentricTubes"', r"tubes is not there: ConcentricTubes needs tubes"),
    "what does not fit": ("inner_diameter = 1.5e-3", "inner_diameter = 0", r"tubes\[1\]\.inner_diameter = 0\.0 .*must be > 0"),
    "an axis of a joint that has none": (
        HAND_WRITTEN,
        'kind = "HeldRod"\njoint_axis = [0, 1, 0]\n[rod]\nlength = 0.3\nbending_stiffness = 0.02\ntorsional_stiffness = 0.01',
        r"HeldRod\.joint_axis = \[0, 1, 0\] is not allowed: must not be given: only a 'revolute' .* joint is 'clamped'",
    ),
    "later version": ("kind = ", "version = 2\nkind = ", r"version = 2 is not allowed: must be 1 to 1"),
    "no version": ("kind = ", 'version = "1"\nkind = ', r"version = '1' is not allowed"),
    "no TOML": ("length = 0.3", "length = 0.3 m", r"it is no TOML: .*line 6"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_in_a_file_are_named_with_their_place(name, tmp_path):
    before, after, message = MISTAKES[name]
    assert before in HAND_WRITTEN
    (tmp_path / "robot.toml").write_text(HAND_WRITTEN.replace(before, after, 1))
    with pytest.raises(ValueError, match=rf"robot\.toml[:'].*{message}"):
        mr.load(tmp_path / "robot.toml")


def test_mistakes_of_who_loads(tmp_path, wire):
    robot = mr.SingleRod(wire)
    robot.save(tmp_path / "robot.toml")
    robot.inputs(rotation=0.1).save(tmp_path / "inputs.toml")
    with pytest.raises(ValueError, match=r"load\.robot = None is not allowed: must be the robot .*inputs\.toml"):
        mr.load(tmp_path / "inputs.toml")
    with pytest.raises(ValueError, match=r"load\.robot = SingleRod.* must not be given: robot\.toml holds no inputs"):
        mr.load(tmp_path / "robot.toml", robot=robot)
    with pytest.raises(TypeError, match=r"load\.robot = 3 is not allowed"):
        mr.load(tmp_path / "inputs.toml", robot=3)
    (tmp_path / "inputs.toml").write_text('kind = "Inputs"\ntip_forc = [1, 0, 0]')
    with pytest.raises(ValueError, match=r"inputs\.toml: inputs\(\) takes no 'tip_forc': it takes rotation"):
        mr.load(tmp_path / "inputs.toml", robot=robot)
    with pytest.raises(ValueError, match=r"must end in \.npz or \.toml"):
        mr.load(tmp_path / "robot.rrd")
    for name in ("none.toml", "none.npz"):
        with pytest.raises(FileNotFoundError, match=f"there is no file .*{name}"):
            mr.load(tmp_path / name)
    with pytest.raises(ValueError, match=r"leading axes \(0,\).*\.npz"):
        robot.inputs(rotation=np.zeros((0, 1))).save(tmp_path / "empty.toml")
    robot.inputs(rotation=np.zeros((0, 1))).save(tmp_path / "empty.npz")
    assert mr.load(tmp_path / "empty.npz", robot=robot).rotation.shape == (0, 1)
    for thing in (robot, robot.inputs()):
        with pytest.raises(ValueError, match=r"must end in \.toml or \.npz"):
            thing.save(tmp_path / "robot.json")


# ---- results ----

ANSWERS = (
    *("status", "iterations", "integrations", "residual", "boundary_residual", "unknowns", "gamma", "condition"),
    *("tip_position", "tip_rotation", "energy"),
)
STABILITY = ("potential", "stability", "index", "stability_margin")


def assert_answers_the_same(one, other, jacobian="tip_force"):
    """In all they can be asked for; of stability and derivatives only where there is an input for these."""
    assert type(one) is type(other)
    assert repr(one) == repr(other)
    for name in (*ANSWERS, *(STABILITY if jacobian else ())):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for k in range(one.assembly.rod_count):
        for name, values in vars(one.rod(k, nodes=11)).items():
            np.testing.assert_array_equal(values, getattr(other.rod(k, nodes=11), name), err_msg=name)
    if jacobian:
        np.testing.assert_array_equal(one.jacobian(jacobian), other.jacobian(jacobian))
    for name in one.inputs.given:
        if name not in one.inputs.profiles:
            np.testing.assert_array_equal(getattr(one.inputs, name), getattr(other.inputs, name), err_msg=name)
    assert one.dropped == other.dropped


def test_a_network_is_read_back_complete(tmp_path):
    """A motion and a part of it, by the same bits; inputs by names too; and the robot solves as before."""
    robot = network()
    force = np.zeros((3, len(robot.load_places), 3))
    force[:, 0, 0] = 0.01, 0.02, 0.03
    given = {"rotation": {"left": 0.1}, "gravity": (0, 0, -9.81)}
    time = 0.1 * np.arange(3)
    inputs = robot.inputs(force=force, **given)
    history = mr.simulate(robot, inputs, time=time, solver=COARSE)
    assert (history.status == mr.Status.CONVERGED).all()
    other = reread(history, tmp_path)
    assert_answers_the_same(history, other, jacobian="force")
    for name in ("plate", UNUSUAL):
        np.testing.assert_array_equal(history.body_position(name), other.body_position(name))
        np.testing.assert_array_equal(history.body_rotation(name), other.body_rotation(name))
    assert_answers_the_same(history[1], reread(history[1], tmp_path), jacobian="force")
    data = history.to_xarray()
    np.testing.assert_array_equal(data["body_position"].sel(body="plate"), history.body_position("plate"))
    np.testing.assert_array_equal(data["body_rotation"].sel(body=UNUSUAL), history.body_rotation(UNUSUAL))
    np.testing.assert_array_equal(data["input_force"].sel(load_place="plate", component="x"), force[:, 0, 0])
    np.testing.assert_array_equal(data["input_rotation"].sel(rod="left"), 0.1)
    robot.save(tmp_path / "robot.toml")
    inputs.save(tmp_path / "inputs.toml")
    there = mr.load(tmp_path / "robot.toml")
    again = mr.simulate(there, mr.load(tmp_path / "inputs.toml", robot=there), time=time, solver=COARSE)
    np.testing.assert_array_equal(history.unknowns, again.unknowns)
    text = 'kind = "Inputs"\ngravity = [0, 0, -9.81]\n[rotation]\nleft = 0.1\n[force]\nplate = [0.01, 0, 0]\n'
    (tmp_path / "inputs.toml").write_text(text)
    by_name, meant = mr.load(tmp_path / "inputs.toml", robot=robot), robot.inputs(force={"plate": (0.01, 0, 0)}, **given)
    for name in ("rotation", "force", "gravity"):
        np.testing.assert_array_equal(getattr(by_name, name), getattr(meant, name))


NETWORK = """
kind = "Network"

[[rods]]
name = "leg"
length = 0.3
bending_stiffness = 4e-3
torsional_stiffness = 3e-3

[[bodies]]
name = "plate"

[[joints]]
rod = "leg"
end = "base"
to = "ground"

[[joints]]
rod = "leg"
end = "tip"
to = "plate"
kind = "clamped"
"""
NETWORK_MISTAKES = {
    "no such body": ('to = "plate"', 'to = "plat"', r"joints\[1\]\.to = 'plat' .*'ground', 'plate'; did you mean 'plate'"),
    "no such kind": ('"clamped"', '"Joint"', r"joints\[1\]: Joint\.kind = 'Joint' .*'clamped', 'revolute'"),
    "a spring of a clamped joint": ('kind = "clamped"', "stiffness = 1", r"joints\[1\]: Joint\.stiffness = 1 .*no axis"),
    "an axis of a joint that has none": (
        'kind = "clamped"',
        "axis = [0, 0, 1]",
        r"joints\[1\]: Joint\.axis = \[0, 0, 1\] is not allowed: must not be given: a clamped joint has none",
    ),
    "no such rod": ('rod = "leg"', 'rod = "log"', r"Network\.joints = Joint\('log'.*no rod 'log'; did you mean 'leg'"),
    "unknown key": ('end = "base"', 'ends = "base"', r"joints\[0\]\.ends = 'base' .*Joint takes rod, end, to"),
    "something missing": ('end = "base"\n', "", r"joints\[0\]\.end is not there: Joint needs end"),
    "no name": ('name = "leg"\n', "", r"rods\[0\]\.name = '' .*needs a name of its own"),
    "a negative mass": ('name = "plate"', 'name = "plate"\nmass = -1', r"bodies\[0\]: Body\.mass = -1 .*>= 0"),
    "a pose that is none": ('to = "ground"', 'to = "ground"\npose = [1, 2]', r"joints\[0\]: Joint\.pose = .*4, 4"),
    "what nothing holds": ('to = "ground"', 'to = "plate"', r"Network\."),
}


@pytest.mark.parametrize("name", NETWORK_MISTAKES)
def test_mistakes_in_the_file_of_a_network_are_named_with_their_place(name, tmp_path):
    before, after, message = NETWORK_MISTAKES[name]
    assert before in NETWORK
    (tmp_path / "robot.toml").write_text(NETWORK)
    assert mr.load(tmp_path / "robot.toml").end_effector == "plate"
    (tmp_path / "robot.toml").write_text(NETWORK.replace(before, after, 1))
    with pytest.raises(ValueError, match=rf"robot\.toml: .*{message}"):
        mr.load(tmp_path / "robot.toml")


ROD_TABLE = """
length = 0.3
bending_stiffness = 4e-3
torsional_stiffness = 3e-3
"""
POSES = "[" + ", ".join(["[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"] * 2) + "]"
AXES_OF_NONE = {
    "HeldRod.joint_axis": f'kind = "HeldRod"\njoint = "spherical"\njoint_axis = [0, 0, 1]\n[rod]{ROD_TABLE}',
    "HeldRod.base_joint_axis": f'kind = "HeldRod"\nbase_joint_axis = [0, 0, 1]\n[rod]{ROD_TABLE}',
    "ParallelRods.joint_axes": f'kind = "ParallelRods"\nbase = {POSES}\nplatform = {POSES}\njoint_axes = [0, 0, 1]\n'
    + 2 * f"[[legs]]{ROD_TABLE}",
}


@pytest.mark.parametrize("field", AXES_OF_NONE)
def test_an_axis_in_a_file_whose_joint_has_none_is_named_and_without_it_the_file_is_read(field, tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(AXES_OF_NONE[field])
    with pytest.raises(ValueError, match=rf"robot\.toml: {field} = \[0, 0, 1\] .*only a 'revolute' joint has an axis"):
        mr.load(path)
    path.write_text(AXES_OF_NONE[field].replace(f"{field.partition('.')[2]} = [0, 0, 1]\n", ""))
    assert type(mr.load(path)).__name__ == field.partition(".")[0]


def with_idle_axes(table):
    """As earlier versions wrote it: axes of all joints, those that have none too."""
    axis = np.array([0.0, 0.0, 1.0])
    if table["kind"] == "Network":
        return table | {"joints": [{"axis": axis} | joint for joint in table["joints"]]}
    if table["kind"] == "HeldRod":
        return {"joint_axis": axis, "base_joint_axis": axis} | table
    return {"joint_axes": axis} | table


def test_archives_with_axes_of_joints_that_have_none_are_read_without_these(tmp_path):
    rod = mr.Rod(length=0.3, bending_stiffness=4e-3, torsional_stiffness=3e-3)
    ends, side = np.tile(np.eye(4), (2, 1, 1)), np.eye(4)
    ends[1, 0, 3] = side[0, 3] = 0.1
    feet = [mr.Joint("one", "base", to=mr.ground), mr.Joint("two", "base", to=mr.ground, pose=side)]
    plate = mr.Body("plate")
    tips = [
        mr.Joint("one", "tip", to=plate, kind="spherical"),
        mr.Joint("two", "tip", to=plate, pose=side, kind="revolute", axis=(0, 1, 0)),
    ]
    robots = [
        mr.Network(rods={"one": rod, "two": rod}, bodies=[plate], joints=[*feet, *tips]),
        mr.HeldRod(rod, end=np.eye(4), joint="spherical"),
        mr.HeldRod(rod, end=np.eye(4), joint="revolute", joint_axis=(0, 1, 0)),
        mr.ParallelRods(legs=[rod] * 2, base=ends, platform=ends, joints="spherical"),
        mr.ParallelRods(legs=[rod] * 2, base=ends, platform=ends, joints=["revolute", "clamped"], joint_axes=(0, 1, 0)),
    ]
    for k, robot in enumerate(robots):
        path, older = tmp_path / f"robot{k}.npz", tmp_path / f"older{k}.npz"
        robot.save(path)
        archive.write(older, with_idle_axes(archive.read(path)))
        assert robot_text(mr.load(older)) == robot_text(robot)


def reread(solution, folder):
    solution.save(folder / "solution.npz")
    return mr.load(folder / "solution.npz")


@pytest.fixture(scope="module")
def history():
    """Of two robots at once; samples 3 and 4 of the second fail: the force jumps, and one iteration does not follow it."""
    robot = wire_robot(outer_diameter=3e-3)
    time = 0.02 * np.arange(6)
    force = np.zeros((6, 2, 3))
    force[:, 0, 0] = 0.1 * time
    force[3:5, 1, 1] = 60.0
    solver = mr.Shooting(integrator=mr.RK4(20), max_iterations=3, max_continuation_steps=2)
    found = mr.simulate(robot, robot.inputs(rotation=0.1, tip_force=force), time=time, solver=solver)
    failed = np.isnan(found.tip_position).any(axis=-1)
    assert failed[3:5, 1].all()
    assert failed.sum() == 2
    return found


def test_a_history_is_read_back_complete(history, tmp_path):
    other = reread(history, tmp_path)
    assert_answers_the_same(history, other)
    for name in ("time", "step_time"):
        np.testing.assert_array_equal(getattr(history, name), getattr(other, name))
    assert history.description == other.description
    with pytest.raises(mr.SolveError) as one:
        history.raise_if_failed()
    with pytest.raises(mr.SolveError) as two:
        other.raise_if_failed()
    assert str(one.value) == str(two.value)
    part = reread(history[2:4, 1], tmp_path)  # some instances of a batch
    assert_answers_the_same(history[2:4, 1], part)
    with np.load(tmp_path / "solution.npz", allow_pickle=False) as arrays:
        assert all(arrays[name].dtype != object for name in arrays.files)
        assert json.loads(str(arrays["multirod"]))["written_by"] == f"multirod {mr.__version__}"


def test_one_solution_is_read_back_also_of_a_tracker(tmp_path):
    robot = wire_robot()
    tracker = mr.Tracker(robot, solver=COARSE, dt=0.02, inputs=robot.inputs(rotation=0.0, tip_force=(0, 0.1, 0)))
    solution = tracker.step(rotation=0.2)
    other = reread(solution, tmp_path)
    assert_answers_the_same(solution, other)
    # and a solve begins from it
    again = mr.solve(other.assembly, other.inputs, solver=COARSE, guess=other)
    np.testing.assert_allclose(again.tip_position, solution.tip_position, rtol=0, atol=1e-9)  # its tolerance


def test_an_observers_rates_and_terms_that_were_dropped_are_kept(tmp_path):
    robot = wire_robot()
    time = 0.02 * np.arange(4)
    inputs = robot.inputs(rotation=time[:, None], tip_force=(0, 0.1, 0), tip_moment=(1e-12, 0, 0))
    history = mr.simulate(robot, inputs, time=time, solver=mr.Observer(integrator=mr.RK4(20)), simplify=1e-4)
    assert [term.name for term in history.dropped] == ["tip_moment"]
    other = reread(history, tmp_path)
    np.testing.assert_array_equal(history.rates, other.rates)
    assert history.dropped == other.dropped
    np.testing.assert_array_equal(history.inputs.tip_moment, other.inputs.tip_moment)
    assert history.to_xarray()["rates"].attrs["units"] == "1/s"


def test_lines_are_read_back(tmp_path):
    robot = lined()
    pulled = 0.002 * np.array([1.0, 0.0, -1.0])
    inputs = robot.inputs(displacement=np.stack([pulled, -pulled], axis=-1), pressure=1e4)
    history = mr.simulate(robot, inputs, time=0.1 * np.arange(3), solver=COARSE)
    other = reread(history, tmp_path)
    assert_answers_the_same(history, other, jacobian="")
    for name in ("tension", "line_length", "slack"):
        np.testing.assert_array_equal(getattr(history, name), getattr(other, name))
    np.testing.assert_array_equal(history.line("chamber").position, other.line("chamber").position)
    data = history.to_xarray()
    assert data.sizes["line"] == 3
    assert data["line"].values.tolist() == ["right", "line 2", "chamber"]
    assert data["line_by_displacement"].values.tolist() == ["right", "line 2"]
    np.testing.assert_array_equal(data["tension"].sel(line="right"), history.tension[:, 0])
    assert data["input_pressure"].attrs["units"] == "Pa"


def test_legs_are_read_back(tmp_path):
    robot = tripod()
    inputs = robot.inputs(translation=(-0.1, -0.1, -0.05, 0, 0), tip_force=(0.2, 0, -0.3), follower_force=(0, 0.1, 0.2))
    assert_answers_the_same(solution := mr.solve(robot, inputs), reread(solution, tmp_path))


def test_breakpoints_are_read_back(tmp_path):
    """A rod that its unknowns at the base alone do not describe, beside one that they do."""
    robot = mr.SingleRod(
        mr.Rod(length=0.4, bending_stiffness=(0.02, 0.03), torsional_stiffness=0.012, precurvature=(4, -2, 6)),
    )
    solution = mr.solve(robot, robot.inputs(tip_force=[(60.0, -50.0, 30.0), (0.1, 0, 0), (80.0, 0, 30.0)]))
    solution = solution.raise_if_failed()
    points = solution._outcome.breakpoints
    assert len(points) == 2
    other = reread(solution, tmp_path)
    assert_answers_the_same(solution, other)
    assert points.keys() == other._outcome.breakpoints.keys()
    for k, own in points.items():
        assert isinstance(own, Breakpoints)
        assert_same(own, other._outcome.breakpoints[k])


def test_a_file_that_is_not_whole_is_refused(history, tmp_path):
    file = tmp_path / "history.npz"
    history.save(file)
    content = file.read_bytes()
    for wrong in (content[: len(content) // 2], b"", b"not a zip", content[:900] + b"\0\1\2\3" + content[904:]):
        file.write_bytes(wrong)
        with pytest.raises(ValueError, match=r"history\.npz' is not allowed: it is"):
            mr.load(file)
    np.savez(file, time=history.time)
    with pytest.raises(ValueError, match="none that multirod wrote"):
        mr.load(file)
    with (
        np.load(rewritten(file, content, lambda about: about | {"batch_shape": [7]})) as _,
        pytest.raises(ValueError, match="12 records"),
    ):
        mr.load(file)
    rewritten(file, content, lambda about: {name: value for name, value in about.items() if name != "outcome"})
    with pytest.raises(ValueError, match="does not hold together"):
        mr.load(file)
    rewritten(file, content, lambda about: about | {"version": 2})
    with pytest.raises(ValueError, match=r"history\.npz: version = 2 is not allowed: .*newer multirod"):
        mr.load(file)


def rewritten(file, content, change):
    """The file with what is no array in it changed."""
    file.write_bytes(content)
    with np.load(file) as arrays:
        held = dict(arrays)
    held["multirod"] = np.array(json.dumps(change(json.loads(str(held["multirod"])))))
    np.savez(file, **held)
    return file


def test_nothing_of_an_archive_is_run(tmp_path):
    """An array of objects, which only unpickling could read."""
    np.savez(tmp_path / "robot.npz", allow_pickle=True, multirod=np.array([object], dtype=object))
    with pytest.raises(ValueError, match="Object arrays cannot be loaded"):
        mr.load(tmp_path / "robot.npz")


@pytest.mark.parametrize("ending", [".txt", ".mat", ".h5", ""])
def test_an_ending_that_is_not_known_is_refused_with_those_that_are(ending, history, tmp_path):
    every = r"must end in \.npz or \.csv or \.nc or \.glb or \.obj or \.ply or \.stl"
    with pytest.raises(ValueError, match=f"{every} or .rrd"):
        history.save(tmp_path / f"run{ending}")
    hint = r": MATLAB reads \.nc, spreadsheets \.csv" if ending else ""
    with pytest.raises(ValueError, match=f"{every}{hint}$"):
        history[0].save(tmp_path / f"run{ending}")
    with pytest.raises(ValueError, match="a recording is of a History"):
        history[0].save(tmp_path / "run.rrd")
    assert list(tmp_path.iterdir()) == []


def test_options_that_an_ending_does_not_take_are_refused(history, tmp_path):
    with pytest.raises(TypeError, match=r"save\(path\), ending in \.csv, takes no 'node': it takes nodes"):
        history.save(tmp_path / "run.csv", node=3)
    with pytest.raises(TypeError, match=r"ending in \.npz, takes no 'nodes': it takes no options"):
        history.save(tmp_path / "run.npz", nodes=3)
    for ending in (".csv", ".nc", ".glb"):
        with pytest.raises(ValueError, match="nodes = 1 is not allowed"):
            history[:, 0].save(tmp_path / f"run{ending}", nodes=1)
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_there_as_a_whole_or_as_before(history, tmp_path, monkeypatch):
    file = tmp_path / "run.npz"
    file.write_bytes(b"before")

    def fail(*_, **__):
        raise OSError("the disk is full")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(OSError, match="full"):
        history.save(file)
    assert file.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [file]
    with written(file) as part:
        part.write_bytes(b"after")
        assert file.read_bytes() == b"before"
        assert part.suffix == ".npz"
    assert file.read_bytes() == b"after"


# ---- tables, datasets, meshes ----


def test_centrelines_as_a_table(history, tmp_path):
    history.save(tmp_path / "run.csv", nodes=4)
    with (tmp_path / "run.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:8] == ["sample", "time [s]", "instance", "status", "rod", "arclength [m]", "x [m]", "y [m]"]
    assert len(rows) == 6 * 2 * 4
    values = np.array([[float(row[name]) for name in list(row)[5:]] for row in rows]).reshape(6, 2, 4, 8)
    shape = history.rod(0, nodes=4)
    np.testing.assert_array_equal(values[..., 0], shape.arclength)
    np.testing.assert_array_equal(values[..., 1:4], shape.position)
    sound = np.isfinite(shape.position).all(axis=-1)
    # of orthogonal matrices to rounding
    np.testing.assert_allclose(Rotation.from_quat(values[sound, 4:]).as_matrix(), shape.rotation[sound], rtol=0, atol=1e-13)
    assert [row["status"] for row in rows[::4]] == [mr.Status(int(code)).name for code in history.status.reshape(-1)]
    assert {float(row["time [s]"]) for row in rows} == set(history.time.tolist())
    history[0, 0].save(tmp_path / "one.csv")
    assert (tmp_path / "one.csv").read_text().startswith("instance,status,rod,arclength [m],x [m]")


def test_a_dataset_has_names_units_and_the_robot(history, tmp_path):
    data = history.to_xarray(nodes=5)
    assert data["tip_position"].dims == ("time", "instance", "component")
    assert data["position"].dims == ("time", "instance", "rod", "node", "component")
    assert dict(data.sizes)["node"] == 5
    assert all(
        {"units", "long_name"} <= set(value.attrs)
        for name, value in data.data_vars.items()
        if name not in ("status", "stability")
    )
    np.testing.assert_array_equal(data["position"].isel(rod=0), history.rod(0, nodes=5).position)
    np.testing.assert_array_equal(data["input_tip_force"], history.inputs.tip_force)
    np.testing.assert_array_equal(data["time"], history.time)
    assert data["strain"].dims == ("time", "instance", "rod")
    np.testing.assert_array_equal(data["strain"], history.strain)
    assert data.attrs["description"] == history.description
    codes = data["status"].attrs
    meaning = dict(zip(codes["flag_values"].tolist(), codes["flag_meanings"].split(), strict=True))
    assert [meaning[code] for code in data["status"].values[:, 1].tolist()] == [mr.Status(k).name for k in history.status[:, 1]]
    assert meaning[int(mr.Status.MAX_ITERATIONS)] in codes["failed"].split()
    codes = data["stability"].attrs
    assert (
        dict(zip(codes["flag_values"].tolist(), codes["flag_meanings"].split(), strict=True))[int(mr.Stability.STABLE)]
        == "STABLE"
    )
    np.testing.assert_array_equal(data["stability"], history.stability)
    (tmp_path / "robot.toml").write_text(data.attrs["robot"])
    assert_same(mr.load(tmp_path / "robot.toml"), history.assembly)
    history.save(tmp_path / "run.nc", nodes=5)
    with xarray.open_dataset(tmp_path / "run.nc") as there:
        xarray.testing.assert_identical(there.load(), data.drop_attrs(deep=False).assign_attrs(there.attrs))
        assert there.attrs == data.attrs
    one = history[0, 0].to_xarray()
    assert one["tip_position"].dims == ("component",)
    assert "position" not in one


def test_axes_of_a_batch_of_several_axes():
    robot = wire_robot()
    solution = mr.solve(robot, robot.inputs(rotation=np.zeros((2, 3, 1)), tip_force=(0, 0.1, 0)), solver=COARSE)
    assert solution.to_xarray()["residual"].dims == ("instance_0", "instance_1")


def ring(radius, corners=24):
    """Area of a regular polygon."""
    return corners / 2 * radius**2 * np.sin(2 * np.pi / corners)


@pytest.mark.parametrize("hollow", [False, True])
def test_tubes_are_closed_and_as_large_as_they_are(hollow):
    robot = wire_robot(outer_diameter=3e-3, **({"inner_diameter": 2e-3} if hollow else {}))
    solution = mr.solve(robot, robot.inputs(tip_force=(0, 0.1, 0)), solver=COARSE)
    (mesh,) = solution.to_mesh(nodes=201).geometry.values()
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    area = ring(1.5e-3) - (ring(1e-3) if hollow else 0.0)
    assert mesh.volume == pytest.approx(area * 0.4, rel=1e-4)  # of chords in the place of arcs
    low, high = mesh.bounds
    points = solution.rod(0, nodes=201).position
    assert (low >= points.min(axis=0) - 1.5e-3 - 1e-12).all()
    assert (high <= points.max(axis=0) + 1.5e-3 + 1e-12).all()


def test_each_of_a_batch_is_as_thick_as_it_is():
    outer = np.array([2e-3, 3e-3, 4e-3])
    made_of = {"young_modulus": 60e9, "shear_modulus": 23e9}
    robot = mr.SingleRod(mr.Rod.tube(length=0.4, outer_diameter=outer, inner_diameter=outer / 2, **made_of))
    solution = mr.solve(robot, robot.inputs(tip_force=(0, 0.1, 0)), solver=COARSE)
    volumes = np.array([mesh.volume for mesh in solution.to_mesh(nodes=201).geometry.values()])
    np.testing.assert_allclose(volumes, (ring(outer / 2) - ring(outer / 4)) * 0.4, rtol=1e-4)  # of chords in the place of arcs
    (mesh,) = solution[1].to_mesh(nodes=201).geometry.values()
    assert mesh.volume == pytest.approx(volumes[1], rel=1e-12)


@pytest.mark.parametrize("inner", [0.0, 0.06])
def test_sections_of_a_tube_turn_about_it_as_little_as_they_can(inner):
    """Along half a circle in a plane, the corners of one row are all as far from that; the volume is that of Pappus."""
    angle = np.linspace(0, np.pi, 401)
    centre = np.stack([1 - np.cos(angle), 0 * angle, np.sin(angle)], axis=-1)
    tangent = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
    vertices, triangles = meshes.tube(centre, tangent, 0.1, inner, 24)
    rows = vertices[: 401 * 24].reshape(401, 24, 3)
    assert np.ptp(rows[..., 1], axis=0).max() < 1e-12  # rounding
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx((ring(0.1) - ring(inner)) * np.pi, rel=1e-4)  # of chords in the place of arcs


def test_a_robot_with_a_platform_as_meshes(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    robot = tripod()
    place = {"translation": (-0.1, -0.1, -0.05, 0, 0), "follower_force": (0, 0.1, 0.2)}
    solution = mr.solve(robot, robot.inputs(**place, tip_force=[(0.2, 0, -0.3), (0.1, 0, 0)]))
    scene = solution.to_mesh(nodes=11)
    names = ["leg_1 inner", "leg_1 rod_1", "leg_1 outer", "leg_2", "leg_3", "platform"]
    assert sorted(scene.geometry) == sorted(f"instance_{k}/{name}" for k in range(2) for name in names)
    assert all(mesh.is_volume for mesh in scene.geometry.values())
    plate = scene.geometry["instance_1/platform"]
    # its middle is the mean of the attachments, the platform's origin
    np.testing.assert_allclose(plate.center_mass, solution.tip_position[1], rtol=0, atol=1e-6)
    for ending in (".glb", ".obj", ".ply", ".stl"):
        solution[1].save(tmp_path / f"robot{ending}", nodes=11, corners=8)
        there = trimesh.load(tmp_path / f"robot{ending}", force="mesh")
        np.testing.assert_allclose(there.bounds, solution[1].to_mesh(nodes=11, corners=8).bounds, rtol=0, atol=1e-7)
    assert sorted(trimesh.load(tmp_path / "robot.glb").geometry) == sorted(names)


def test_meshes_leave_out_what_failed_and_refuse_what_is_none(history, tmp_path):
    assert len(history.to_mesh(nodes=5).geometry) == 10
    with pytest.raises(ValueError, match="to_mesh = Solution.*there must be an instance with a result"):
        history[3:5, 1].to_mesh()
    robot = wire_robot()
    many = mr.solve(robot, robot.inputs(rotation=np.zeros((101, 1)), tip_force=(0, 0.1, 0)), solver=COARSE)
    with pytest.raises(ValueError, match=r"to_mesh = 101 instances is not allowed: at most 100: choose some"):
        many.save(tmp_path / "many.glb")


@pytest.mark.parametrize(("module", "extra", "ask"), [("xarray", "xarray", "to_xarray"), ("trimesh", "mesh", "to_mesh")])
def test_what_is_missing_is_said_with_how_to_get_it(module, extra, ask, history, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(ImportError, match=rf'need {module}: pip install "multirod\[{extra}\]"'):
        getattr(history[:, 0], ask)()


def test_the_page_says_what_is_so(tmp_path):
    page = (Path(__file__).parent.parent / "docs" / "files.md").read_text(encoding="utf-8")
    blocks = [block.split("```")[0] for block in page.split("```toml\n")[1:]]
    robot, line, network, inputs = blocks[:4]
    (tmp_path / "network.toml").write_text(network, encoding="utf-8")
    assert mr.load(tmp_path / "network.toml").joints[1].kind == "revolute"
    (tmp_path / "robot.toml").write_text(robot, encoding="utf-8")
    (tmp_path / "inputs.toml").write_text(inputs, encoding="utf-8")
    there = mr.load(tmp_path / "robot.toml")
    assert isinstance(there, mr.ConcentricTubes)
    assert mr.load(tmp_path / "inputs.toml", robot=there).given == ("rotation", "translation", "tip_force")
    rod = 'kind = "SingleRod"\n[rod]\nlength = 0.2\nbending_stiffness = 0.01\ntorsional_stiffness = 0.008\n'
    (tmp_path / "pulled.toml").write_text(rod + line, encoding="utf-8")
    assert isinstance(mr.load(tmp_path / "pulled.toml").rods[0].lines[0], mr.Tendon)
    for method in (mr.Solution.save, mr.History.save):
        assert "path" in inspect.signature(method).parameters
    for ending in (*meshes.ENDINGS, ".npz", ".toml", ".csv", ".nc", ".rrd"):
        assert f"`{ending}`" in page


def test_a_tube_is_written_by_its_diameters_and_moduli_where_these_make_it(tmp_path):
    made_of = {"outer_diameter": 2e-3, "inner_diameter": 1.5e-3, "young_modulus": 60e9, "shear_modulus": 23e9}
    bent = mr.Rod.tube(length=0.2, **made_of, density=6450.0, precurvature=[(0.15, (0, 0, 0)), (0.05, (9, 0, 0))])
    robot, file = mr.SingleRod(bent), tmp_path / "robot.toml"
    robot.save(file)
    text = file.read_text(encoding="utf-8")
    assert "young_modulus = 60000000000.0  # Pa" in text
    assert "stiffness" not in text
    read = mr.load(file).rods[0]
    for own, other in zip(read.sections, bent.sections, strict=True):
        for name in ("length", "bending_stiffness", "torsional_stiffness", "linear_density", "precurvature"):
            np.testing.assert_array_equal(getattr(own, name), getattr(other, name))
    # what is changed in the file is what is solved
    file.write_text(text.replace("inner_diameter = 0.0015", "inner_diameter = 0.001"), encoding="utf-8")
    thicker = mr.load(file).rods[0].sections[0].bending_stiffness
    np.testing.assert_allclose(thicker / bent.sections[0].bending_stiffness, (2**4 - 1**4) / (2**4 - 1.5**4), rtol=1e-12)
    stretching = mr.SingleRod(mr.Rod.tube(length=0.2, **made_of, extensible=True))
    stretching.save(file)
    assert "extensible = true" in file.read_text(encoding="utf-8")
    assert "stiffness" not in file.read_text(encoding="utf-8")
    assert_same(mr.load(file), stretching)
    # a magnetisation per length is not that of Rod.tube, to the last bit: by its stiffnesses
    mr.SingleRod(mr.Rod.tube(length=0.2, **made_of, magnetisation=(0, 0, 1e5))).save(file)
    assert "young_modulus" not in file.read_text(encoding="utf-8")
    assert mr.load(file).rods[0].is_magnetised


def test_a_table_of_ends_has_a_row_for_each_instance(tmp_path):
    """What failed among them is NaN, and its status says why."""
    tubes = [mr.Rod(length=own, bending_stiffness=0.01, torsional_stiffness=0.008, name=f"{own:g}") for own in (0.3, 0.2)]
    robot = mr.ConcentricTubes(tubes)
    force = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0]], dtype=float)
    history = mr.simulate(robot, robot.inputs(rotation=(0.1, 0.2), tip_force=force), time=[0, 0.5, 1])
    history.save(tmp_path / "ends.csv", rows="instances")
    with (tmp_path / "ends.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["time [s]"] for row in rows] == ["0.0", "0.5", "1.0"]
    assert all(row["status"] == "CONVERGED" and row["instance"] == "0" for row in rows)
    assert [float(row["tip_force[1] [N]"]) for row in rows] == [0, 0, 0.2]
    assert float(rows[0]["rotation['0.2'] [rad]"]) == 0.2
    for row, position, rotation in zip(rows, history.tip_position, history.tip_rotation, strict=True):
        assert [float(row[f"{name} [m]"]) for name in "xyz"] == position.tolist()
        found = Rotation.from_quat([float(row[name]) for name in ("qx", "qy", "qz", "qw")]).as_matrix()
        np.testing.assert_allclose(found, rotation, atol=1e-14)
    target = mr.Pose(position=[(0, 0, 2), history.tip_position[0]])
    batch = mr.reach(robot, target, robot.inputs(), free="rotation")
    batch.save(tmp_path / "batch.csv", rows="instances")
    with (tmp_path / "batch.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows] == [mr.Status(int(status)).name for status in batch.status]
    assert [row["x [m]"] == "nan" for row in rows] == batch.failed.tolist() == [True, False]
    with pytest.raises(ValueError, match=r"save\.nodes = 3 .* beside rows"):
        batch.save(tmp_path / "batch.csv", rows="instances", nodes=3)
    with pytest.raises(ValueError, match=r"save\.rows = 'tips' .* must be one of"):
        batch.save(tmp_path / "batch.csv", rows="tips")
    none = mr.solve(robot, robot.inputs(tip_force=np.zeros((0, 3))))
    none.save(tmp_path / "none.csv", rows="instances")
    assert len((tmp_path / "none.csv").read_text().splitlines()) == 1
