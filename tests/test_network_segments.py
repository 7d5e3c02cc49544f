"""Rods of networks cut into segments: the same robot, and cables that are not integrated in one piece."""

import ast
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

import multirod as mr
from multirod.testing import check_assembly

WEIGHT, SPAN = 4.905, 0.6  # N/m and m, of a cable that is 1 m long
CABLE = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=1.0)


def at(*place: float, turn: float = 0.0) -> np.ndarray:
    """A pose, turned about y."""
    pose = np.eye(4)
    pose[:3, 3] = place
    pose[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(turn), np.sin(turn), -np.sin(turn), np.cos(turn)
    return pose


def arm(segments: dict[str, int] | None) -> mr.Network:
    """A plate on two rods, one on a ball, and a rod on the plate, on a hinge with a spring, whose tip is free."""
    plate = mr.Body("plate", mass=0.1, mass_centre=(0.01, 0.02, 0.03), frames={"tool": at(0.02, 0.0, 0.05)})
    bent = mr.Rod(length=0.5, bending_stiffness=1.0, torsional_stiffness=0.8, precurvature=(0.8, -0.3, 0.2), linear_density=0.05)
    rods = {
        "bent": bent,
        "straight": mr.Rod(length=0.45, bending_stiffness=1.3, torsional_stiffness=1.1, linear_density=0.05),
        "free": mr.Rod(length=0.3, bending_stiffness=0.7, torsional_stiffness=0.5, precurvature=(0, 1, 0)),
    }
    joints = [
        mr.Joint("bent", "base", to=mr.ground),
        mr.Joint("bent", "tip", to=plate, pose=at(-0.03, 0, 0), kind="spherical"),
        mr.Joint("straight", "base", to=mr.ground, pose=at(0.1, 0, 0)),
        mr.Joint("straight", "tip", to=plate, pose=at(0.03, 0, 0)),
        mr.Joint("free", "base", to=plate, pose=at(0, 0.02, 0), kind="revolute", axis=(0, 1, 0), stiffness=0.4),
    ]
    return mr.Network(rods=rods, bodies=[plate], joints=joints, end_effector=(plate, "tool"), segments=segments)


LOADS: dict[str, Any] = {
    "force": {"plate": (0.5, 0.2, -1.0), "free": (0.2, 0.3, 0.1), ("plate", "tool"): (0.1, 0.3, 0.2)},
    "rotation": {"bent": 0.4, "straight": -0.2, "free": 0.3},
    "translation": {"bent": -0.03, "free": -0.02},
    "gravity": (0, 0, -9.81),
    "distributed_force": (0.3, 0.1, 0.0),
    "rod_force": {"bent": (0, 0.5, 0)},
}
CUT = {"bent": 5, "free": 4}
FINE = mr.Shooting(tolerance=1e-11, integrator=mr.RK4(steps=400))  # 400: both are integrated in the same places, or finer


def solved(robot: mr.Network, **more: Any) -> mr.Solution:
    return mr.solve(robot, robot.inputs(**LOADS | more), solver=FINE, progress=False).raise_if_failed()


@pytest.fixture(scope="module")
def both() -> tuple[mr.Solution, mr.Solution]:
    return solved(arm(None)), solved(arm(CUT))


def test_segments_change_no_result(both: tuple[mr.Solution, mr.Solution]) -> None:
    whole, cut = both
    for name in ("tip_position", "tip_rotation", "potential", "energy", "base_torque", "stiffness"):
        expected = getattr(whole, name)
        assert getattr(cut, name) == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max()), name
    assert cut.stability is whole.stability is mr.Stability.STABLE
    assert cut.body_position("plate") == pytest.approx(whole.body_position("plate"), abs=1e-10)
    assert cut.joint_angle("free base") == pytest.approx(float(whole.joint_angle("free base")), abs=1e-9)
    for rod, end in (("bent", "base"), ("bent", "tip"), ("straight", "tip"), ("free", "base")):
        for name in ("force", "moment"):
            ours, expected = (getattr(s.wrench(rod, end), name) for s in (cut, whole))
            assert ours == pytest.approx(expected, abs=1e-9), (rod, end, name)


def test_a_rod_in_segments_is_one_rod(both: tuple[mr.Solution, mr.Solution]) -> None:
    whole, cut = (s.rod("bent") for s in both)  # 401 nodes in 5 segments are evenly spaced
    assert cut.arclength == pytest.approx(whole.arclength, abs=1e-12)
    for name in ("position", "rotation", "force", "moment", "curvature"):
        assert getattr(cut, name) == pytest.approx(getattr(whole, name), abs=1e-9), name
    arclength = both[1].rod("free").arclength
    assert len(arclength) == len(whole.arclength)
    assert (np.diff(arclength) > 0).all()  # one node between two segments
    assert arclength[-1] == pytest.approx(0.28, abs=1e-12)  # 0.3 m, pulled back by 0.02


@pytest.mark.parametrize(
    "name",
    [
        *("rotation", "translation", "force", "moment", "follower_force", "gravity", "distributed_force", "rod_force"),
        *("bending_stiffness", "torsional_stiffness", "precurvature", "length", "base", "joint_pose"),
    ],
)
def test_derivatives_are_those_of_the_whole_rod(both: tuple[mr.Solution, mr.Solution], name: str) -> None:
    expected, ours = (s.jacobian(name) for s in both)
    assert ours == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("of", ["position", "rotation", "curvature", "wrench"])
def test_what_is_asked_along_a_rod_in_segments(both: tuple[mr.Solution, mr.Solution], of: Any) -> None:
    for rod, length in (("bent", 0.47), ("free", 0.28)):
        at = np.array([0.0, 0.01, 0.2, 0.5, 0.51, 0.99, 1.0]) * length  # where segments begin among them
        expected, ours = (s.along(at, of=of, rod=rod) for s in both)
        assert ours == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
        for name in ("rotation", "force", "bending_stiffness", "base"):
            expected, ours = (s.jacobian(name, of=of, at=at, rod=rod) for s in both)
            assert ours == pytest.approx(expected, abs=1e-8 * np.abs(expected).max()), name
    for name in ("length", "translation"):
        with pytest.raises(NotImplementedError, match=f"along 'bent' by {name} are not known: it moves the ends of its segments"):
            both[1].jacobian(name, of=of, at=0.2, rod="bent")


def test_a_batch_is_as_each_alone_and_files_keep_segments(tmp_path: Path) -> None:
    robot, forces = arm(CUT), np.random.default_rng(0).normal(size=(4, 3))
    batch = mr.solve(robot, robot.inputs(force={"plate": forces}), progress=False)
    for force, place in zip(forces, batch.tip_position, strict=True):
        assert np.array_equal(mr.solve(robot, robot.inputs(force={"plate": force}), progress=False).tip_position, place)
    batch.save(tmp_path / "cut.npz")
    kept = mr.load(tmp_path / "cut.npz")
    assert kept.assembly.graph.segments == CUT
    assert np.array_equal(kept.tip_position, batch.tip_position)


def test_a_robot_in_segments_conforms() -> None:
    robot = arm(CUT)
    check_assembly(robot, robot.inputs(force={"plate": (0.3, 0.2, 0)}, gravity=(0, 0, -9.81)), tip_rod=None)


def pulled(count: int) -> mr.Network:
    plate = mr.Body("plate")
    joints = [mr.Joint("cable", "base", to=mr.ground), mr.Joint("cable", "tip", to=plate)]
    return mr.Network(rods={"cable": CABLE}, bodies=[plate], joints=joints, segments={"cable": count})


def test_it_does_not_matter_into_how_many_segments() -> None:
    found = []
    for count in (1, 2, 5):
        robot = pulled(count)
        found.append(mr.solve(robot, robot.inputs(force={"plate": (15.0, 5.0, 8.0)}), progress=False).raise_if_failed())
    for other in found[1:]:
        # by RK45 as it is by default
        assert other.tip_position == pytest.approx(found[0].tip_position, abs=1e-7)


def test_a_pulled_cable_is_that_of_multiple_shooting() -> None:
    robot, alone = pulled(8), mr.SingleRod(CABLE)
    cut = mr.solve(robot, robot.inputs(force={"plate": (500.0, 0.0, 150.0)}), progress=False)
    expected = mr.solve(alone, alone.inputs(tip_force=(500.0, 0.0, 150.0)), progress=False)
    assert (cut.status, expected.status) == (mr.Status.CONVERGED, mr.Status.MULTIPLE_SHOOTING)
    assert cut.integrations < 300  # 90; in one piece it takes all 15,000, and is not found
    # RK45 as it is by default leaves some 1e-8
    assert cut.tip_position == pytest.approx(expected.tip_position, abs=1e-7)


def hanging(stiffness: float) -> tuple[float, float]:
    """Lowest point [m] and horizontal force at the base [N] of a heavy cable whose ends are clamped level, by collocation."""

    def along(s: np.ndarray, y: np.ndarray, p: np.ndarray) -> np.ndarray:
        _, _, angle, moment = y
        lever = np.cos(angle) * (p[1] + WEIGHT * s) - np.sin(angle) * p[0]
        return np.stack([np.cos(angle), np.sin(angle), moment / stiffness, -lever])

    def ends(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
        del p
        return np.array([a[0], a[1], a[2], b[0] - SPAN, b[1], b[2]])

    size = brentq(lambda c: 2 * c * np.sinh(SPAN / (2 * c)) - 1, SPAN / 50, 50)  # of the catenary, where it begins
    s = np.linspace(0, 1, 2001)
    t, layer = (s - 0.5) / size, np.sqrt(stiffness / (0.5 * WEIGHT))
    angle = np.arctan(t) * (1 - np.exp(-s / layer)) * (1 - np.exp((s - 1) / layer))
    height = size * np.sqrt(1 + t**2)
    first = [SPAN / 2 + size * np.arcsinh(t), height - height[0], angle, stiffness * np.gradient(angle, s)]
    found = solve_bvp(along, ends, s, np.stack(first), p=[WEIGHT * size, -WEIGHT / 2], tol=1e-9, max_nodes=100_000)
    assert found.success
    return float(found.sol(np.linspace(0, 1, 1001))[1].min()), float(found.p[0])


@pytest.mark.parametrize(("stiffness", "count"), [(1e-2, 4), (1e-3, 8)])
def test_a_hanging_cable_is_that_of_collocation(stiffness: float, count: int) -> None:
    rod = mr.Rod(length=1.0, bending_stiffness=stiffness, torsional_stiffness=stiffness, linear_density=WEIGHT / 9.81)
    hand = mr.Body("hand", fixed=True, pose=at(SPAN, 0, 0, turn=np.pi / 2))
    joints = [mr.Joint("cable", "base", to=mr.ground, pose=at(0, 0, 0, turn=np.pi / 2)), mr.Joint("cable", "tip", to=hand)]
    robot = mr.Network(rods={"cable": rod}, bodies=[hand], joints=joints, segments={"cable": count})
    solution = mr.solve(robot, robot.inputs(gravity=(0, 0, -9.81)), progress=False).raise_if_failed()
    lowest, pull = hanging(stiffness)
    assert solution.stability is mr.Stability.STABLE
    # of 80 or 100 nodes: the lowest point lies between two, less than 1e-4 lower
    assert solution.rod("cable").position[:, 2].min() == pytest.approx(lowest, abs=1e-4)
    assert solution.wrench("cable", "base").force[0] == pytest.approx(pull, rel=1e-7)


def test_what_cannot_be_solved_says_how_to_cut_it() -> None:
    robot = pulled(1)
    few = mr.Shooting(max_integrations=500)
    failed = mr.solve(robot, robot.inputs(force={"plate": (500.0, 0.0, 150.0)}), solver=few, progress=False)
    with pytest.raises(mr.SolveError, match=r"rod 'cable' may amplify errors .* segments=\{'cable': 5\}"):
        failed.raise_if_failed()
    light = mr.solve(
        robot, robot.inputs(force={"plate": (50.0, 0.0, 15.0)}), solver=mr.Shooting(max_integrations=9), progress=False
    )
    with pytest.raises(mr.SolveError) as error:
        light.raise_if_failed()
    assert "segments" not in str(error.value)


@pytest.mark.parametrize("count", [3, 6])
def test_a_platform_on_cables_says_how_to_cut_them(count: int) -> None:
    """Three determine all forces; six that do not stretch hold some among each other by next to nothing but these: (27) of
    docs/stability.md, from which `FOLD` was told. By (44) it is known early that they are to be cut: after 14,000 integrations
    before."""
    angle = 2 * np.pi * np.arange(count) / count
    way = np.stack([-0.45 * np.cos(angle), -0.45 * np.sin(angle), np.full(count, -np.sqrt(1 - 0.45**2))], axis=1)
    across = np.cross((0.0, 0.0, 1.0), way) / 0.45
    base, platform = np.tile(np.eye(4), (2, count, 1, 1))
    base[:, :3, :3] = platform[:, :3, :3] = np.stack([across, np.cross(way, across), way], axis=2)
    base[:, :2, 3] = 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    platform[:, :3, 3] = base[:, :3, 3] + way + (0.0, 0.0, 0.9)
    cable = mr.Rod(length=1.0, bending_stiffness=1e-3, torsional_stiffness=1e-3)
    robot = mr.ParallelRods(legs=[cable] * count, base=base, platform=platform, joints="spherical", platform_mass=0.5)
    force, gravity = (0.5, 0.2, 0.0), (0.0, 0.0, -9.81)
    inputs = robot.inputs(tip_force=force, gravity=gravity)
    failed = mr.solve(robot, inputs, progress=False)
    assert failed.status is mr.Status.STALLED
    assert failed.integrations < 700
    with pytest.raises(mr.SolveError) as error:
        failed.raise_if_failed()
    found = re.search(r"mr\.stacked\(robot, segments=(\{.*\})\)", str(error.value))
    assert found is not None
    segments = ast.literal_eval(found[1])
    assert len(segments) == count
    cut = mr.stacked(robot, segments=segments)
    hung = mr.solve(cut, cut.inputs(force={"level 1": force}, gravity=gravity), progress=False).raise_if_failed()
    assert hung.stability is mr.Stability.STABLE
    held = sum(hung.wrench(name, "base").force for name in segments)
    assert np.abs(held) == pytest.approx((0.5, 0.2, 0.5 * 9.81), abs=1e-6)
    most = max(np.linalg.norm(hung.wrench(name, "base").force) for name in segments)
    (least,) = robot.problem(inputs, integrator=mr.RK4(20)).least_growth()
    assert 0.5 * np.sqrt(most / 1e-3) < least <= np.sqrt(most / 1e-3)


def test_of_legs_that_hang_side_by_side_it_is_known_by_how_much_errors_grow() -> None:
    """(44) is exact of upright ones alike, but for how what acts along them changes their pull, from 2.4 N to 2.7 N each."""
    cable = mr.Rod(length=0.8, bending_stiffness=1e-3, torsional_stiffness=1e-3, linear_density=0.02)
    base = [at(x, 0, 0, turn=np.pi) for x in (-0.1, 0.0, 0.1)]
    platform = [at(x, 0, 0, turn=np.pi) for x in (-0.1, 0.0, 0.1)]
    robot = mr.ParallelRods(legs=[cable, cable, cable], base=base, platform=platform, platform_mass=0.5)

    def growth(**inputs: Any) -> np.ndarray:
        return robot.problem(robot.inputs(**inputs), integrator=mr.RK4(20)).least_growth()

    weight, down = 0.02 * 9.81 * 1.0, (0, 0, -9.81)
    (own,) = growth(gravity=down, tip_force=(0, 0, -3), translation=0.2)
    assert own == pytest.approx(np.sqrt(((0.5 * 9.81 + 3) / 3 - weight) / 1e-3), rel=1e-12)
    forces = np.array([(0, 0, 0), (0.9, 0, 0), (0, 0, -9)])
    few = growth(tip_force=(0, 0, -9), follower_force=forces, distributed_force=(0.1, 0, 0))
    pull = (9 - np.linalg.norm(forces, axis=1)) / 3 - 0.08
    np.testing.assert_allclose(few, 0.8 * np.sqrt(np.maximum(pull, 0) / 1e-3), rtol=1e-12)


@pytest.mark.parametrize(
    ("segments", "kind", "said"),
    [
        ({"rope": 3}, ValueError, "must be by names of rods, of 'cable'"),
        ({"cable": 0}, ValueError, r"Network.segments\['cable'\] = 0 is not allowed: must be an integer >= 1"),
        ({"cable": 2.5}, ValueError, "must be an integer >= 1"),
        (3, TypeError, "must be a mapping of names of rods to numbers of segments"),
    ],
)
def test_other_segments_are_refused(segments: Any, kind: type[Exception], said: str) -> None:
    with pytest.raises(kind, match=said):
        mr.Network(rods={"cable": CABLE}, joints=[mr.Joint("cable", "base", to=mr.ground)], segments=segments)


@pytest.mark.parametrize(
    ("rod", "said"),
    [
        (mr.ConcentricTubes([CABLE]), "must be a Rod"),
        (mr.Rod(sections=[mr.Section(length=0.5, bending_stiffness=1, torsional_stiffness=1)] * 2), "must be the same all along"),
        (
            mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=1, lines=[mr.Tendon(offset=(0.01, 0))]),
            "must have no members and no lines",
        ),
        (mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=1, foundation=1.0), "not be cut"),
    ],
)
def test_rods_that_are_not_cut_are_refused(rod: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        mr.Network(rods={"cable": rod}, joints=[mr.Joint("cable", "base", to=mr.ground)], segments={"cable": 3})


def test_a_rod_that_slides_is_refused() -> None:
    disc = mr.Body("disc")
    joints = [
        mr.Joint("cable", "base", to=mr.ground),
        mr.Joint("cable", "along", to=disc, at=0.5, kind="prismatic"),
        mr.Joint("rod", "base", to=mr.ground),
        mr.Joint("rod", "tip", to=disc),
    ]
    with pytest.raises(ValueError, match="slides through holes, and is cut there"):
        mr.Network(rods={"cable": CABLE, "rod": CABLE}, bodies=[disc], joints=joints, segments={"cable": 3})
