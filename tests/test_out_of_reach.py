"""Rods that would have to stretch: (41) of ``docs/networks.md``, in networks and between legs."""

import numpy as np
import pytest
from random_networks import draw
from scipy.sparse.csgraph import floyd_warshall
from scipy.spatial.transform import Rotation
from test_network_rods import at

import multirod as mr

RK4 = mr.RK4()
STIFFNESS = {"bending_stiffness": 0.05, "torsional_stiffness": 0.04}
WIRE = mr.Rod(length=0.2, **STIFFNESS)
SOFT = mr.Rod(length=0.2, **STIFFNESS, axial_stiffness=1e4)


def arms(left=WIRE, right=WIRE, apart=0.5, **tip):
    """Two rods from the ground and from a post to a plate between, 0.1 m wide."""
    plate, post = mr.Body("plate"), mr.Body("post", pose=at(apart), fixed=True)
    joints = [
        mr.Joint("left", "base", to=mr.ground),
        mr.Joint("left", "tip", to=plate, pose=at(-0.05)),
        mr.Joint("right", "base", to=post),
        mr.Joint("right", "tip", to=plate, pose=at(0.05), **tip),
    ]
    return mr.Network(rods={"left": left, "right": right}, bodies=[plate, post], joints=joints)


def beyond(robot, **given):
    """Whether each instance is out of reach: nothing is integrated."""
    return robot.problem(robot.inputs(**given), integrator=RK4).out_of_reach()


@pytest.mark.parametrize("rounding", [-1e-7, 1e-7])
def test_what_two_rods_and_a_plate_reach_together(rounding):
    assert beyond(arms(apart=0.5 + rounding))[0] == (rounding > 0)
    longer = {"translation": {"left": 0.01, "right": -0.03}}
    assert beyond(arms(apart=0.48 + rounding), **longer)[0] == (rounding > 0)
    nearer = {"fixed_position": {"post": (-0.3, 0, 0.4)}}  # 3, 4, 5 of tenths
    assert beyond(arms(apart=0.6 + rounding), **nearer)[0] == (rounding > 0)
    driven = arms(apart=0.52 + rounding, kind="prismatic", axis=(1, 0, 0), driven=True)
    assert beyond(driven, slide={"right tip": 0.02})[0] == (rounding > 0)


def test_what_bounds_nothing():
    assert beyond(arms())[0] == np.False_
    assert beyond(arms(apart=0.6))[0]
    assert not beyond(arms(apart=0.6, right=SOFT))[0]
    assert not beyond(arms(apart=0.6, kind="prismatic", axis=(1, 0, 0), stiffness=10.0))[0]


def test_a_rod_through_holes_counts_once():
    disc = mr.Body("disc")
    joints = [
        mr.Joint("backbone", "base", to=mr.ground),
        mr.Joint("backbone", "tip", to=disc),
        mr.Joint("slider", "base", to=mr.ground),
        mr.Joint("slider", "along", to=disc, kind="spherical", at=0.1),
    ]
    for apart in (0.199, 0.201):
        post = mr.Body("post", pose=at(apart), fixed=True)
        tip = mr.Joint("slider", "tip", to=post, kind="spherical")
        robot = mr.Network(rods={"backbone": WIRE, "slider": WIRE}, bodies=[disc, post], joints=[*joints, tip])
        assert beyond(robot)[0] == (apart > 0.2)


def test_the_rods_that_are_too_short_are_named():
    robot = arms(apart=0.6)
    solution = mr.solve(robot, robot.inputs())
    assert solution.integrations == 0
    with pytest.raises(mr.SolveError, match=r"\(rods 'left', 'right', with the bodies between, reach 0.5 m of 0.6 m\)"):
        solution.raise_if_failed()
    three = mr.Network(
        rods={name: WIRE for name in ("long way", "short way", "other")},
        bodies=[plate := mr.Body("plate")],
        joints=[
            mr.Joint("long way", "base", to=mr.ground, pose=at(0.1)),
            mr.Joint("short way", "base", to=mr.ground, pose=at(0.3)),
            mr.Joint("other", "base", to=mr.ground, pose=at(-0.2)),
            *(mr.Joint(name, "tip", to=plate) for name in ("long way", "short way", "other")),
        ],
    )
    with pytest.raises(mr.SolveError, match=r"\(rods '(other', 'short way|short way', 'other)', .* reach 0.4 m of 0.5 m\)"):
        mr.solve(three, three.inputs()).raise_if_failed()


def test_others_are_what_they_are_alone():
    robot = arms(apart=0.45)
    moves = np.array([(0, 0, 0), (0.2, 0, 0), (-0.05, 0, 0.02)])
    solution = mr.solve(robot, robot.inputs(fixed_position={"post": moves}))
    assert solution.status[1] == mr.Status.OUT_OF_REACH
    assert np.isnan(solution.tip_position[1]).all()
    for k in (0, 2):
        alone = mr.solve(robot, robot.inputs(fixed_position={"post": moves[k]}))
        assert solution.status[k] == alone.status
        np.testing.assert_array_equal(solution.unknowns[k], alone.unknowns)
    with pytest.raises(mr.SolveError, match=r"1 of 3 instances failed .* the first is 1: OUT_OF_REACH .* reach 0.5 m of 0.65 m"):
        solution.raise_if_failed()
    history = mr.simulate(robot, robot.inputs(fixed_position={"post": moves[:2]}), time=[0.0, 1.0])
    assert [status.name for status in history.status] == ["CONVERGED", "OUT_OF_REACH"]


def shortest(robot, given):
    """Where known points are farther apart than the shortest way between, by SciPy and the joints as they were given."""
    ends = [joint for joint in robot.joints if joint.end in ("base", "tip")]
    count, lengths = len(ends), {rod.name: rod.length for rod in robot.rods}
    way, places, known = np.full((count, count), np.inf), np.zeros((count, 3)), []
    for k, joint in enumerate(ends):
        slide = given.get("slide", {}).get(f"{joint.rod} {joint.end}", 0.0)
        moved = np.asarray(joint.pose)[:3, :3] @ np.asarray(joint.axes)[-1] * slide if slide else 0.0
        places[k] = np.asarray(joint.pose)[:3, 3] + moved
        if joint.to is mr.ground or joint.to.fixed:
            known.append(k)
        if joint.to is not mr.ground and joint.to.fixed:
            name, pose = joint.to.name, np.asarray(joint.to.pose)
            turn = Rotation.from_rotvec(given["fixed_rotation"][name]).as_matrix() @ pose[:3, :3]
            places[k] = pose[:3, 3] + given["fixed_position"][name] + turn @ places[k]
    for i, one in enumerate(ends):
        for j, two in enumerate(ends):
            if one.rod == two.rod:
                way[i, j] = lengths[one.rod] + given["translation"][one.rod]
            if (i in known and j in known) or one.to is two.to:
                way[i, j] = min(way[i, j], np.linalg.norm(places[i] - places[j]))
    apart = np.linalg.norm(places[known][:, None] - places[known], axis=-1)
    return bool((floyd_warshall(way)[np.ix_(known, known)] < apart * (1 - 1e-9)).any())


def closed_loops(rng):
    """Plates between the ground and a post, joined by rods by lot, some about as long as they have to be."""
    plates = [mr.Body(f"plate {k}") for k in range(int(rng.integers(1, 4)))]
    post = mr.Body("post", pose=at(*rng.normal(0, 0.2, 3)), fixed=True)
    chain = [mr.ground, *plates, post]
    pairs = [(k, k + 1) for k in range(len(chain) - 1)] + [tuple(rng.choice(len(chain), 2, replace=False)) for _ in range(3)]
    rods, joints, given = {}, [], {"translation": {}, "slide": {}}
    for k, (a, b) in enumerate(pairs):
        name = f"rod {k}"
        rods[name] = mr.Rod(length=float(rng.uniform(0.05, 0.25)), **STIFFNESS)
        given["translation"][name] = float(rng.uniform(-0.01, 0.01))
        for end, body in (("base", chain[a]), ("tip", chain[b])):
            slides = {"kind": "prismatic", "axis": rng.normal(0, 1, 3), "driven": True} if rng.random() < 0.3 else {}
            joints.append(mr.Joint(name, end, to=body, pose=at(*rng.normal(0, 0.03, 3)), **slides))
            if slides:
                given["slide"][f"{name} {end}"] = float(rng.normal(0, 0.02))
    given |= {"fixed_position": {"post": rng.normal(0, 0.05, 3)}, "fixed_rotation": {"post": rng.normal(0, 0.5, 3)}}
    return mr.Network(rods=rods, bodies=[*plates, post], joints=joints), {k: v for k, v in given.items() if v}


def test_ways_are_the_shortest_that_scipy_finds():
    rng, said = np.random.default_rng(3), []
    for _ in range(20):
        robot, given = closed_loops(rng)
        said.append(bool(beyond(robot, **given)[0]))
        assert said[-1] == shortest(robot, given)
    assert 4 < sum(said) < 16  # of both kinds


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")  # of soft rods, as drawn
def test_what_fits_is_within_reach():
    """Networks drawn so that their rods fit: each would break the bound if a way were counted too short."""
    for seed in range(40):
        drawn = draw(seed)
        assert not drawn.robot.problem(drawn.inputs, integrator=RK4).out_of_reach().any()


# ---- legs ----


def legs(radius, leg=WIRE, count=3):
    base, platform = (
        np.stack([at(r * np.cos(a), r * np.sin(a)) for a in 2 * np.pi / count * np.arange(count)]) for r in (radius, 0.03)
    )
    return mr.ParallelRods(legs=[leg] * count, base=base, platform=platform)


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")  # which says so too, of legs that are not pushed out
def test_legs_that_do_not_reach_their_platform():
    side = 0.03 * np.sqrt(3)
    limit = (0.4 + side) / np.sqrt(3)
    assert not beyond(legs(limit - 1e-7))[0]
    assert beyond(legs(limit + 1e-7))[0]
    assert not beyond(legs(limit + 1e-7, SOFT))[0]
    assert beyond(legs(limit), translation=[[0, 0, 0], [1e-3, 0, -2e-3], [1e-3, 1e-3, 1e-3]]).tolist() == [False, True, False]
    tubes = mr.ConcentricTubes([mr.Rod(length=0.25, **STIFFNESS), mr.Rod(length=0.1, **STIFFNESS)])
    drawn_in = [[-0.05, -0.01] * 3, [-0.06, -0.01] * 3]
    assert beyond(legs(limit, tubes), translation=drawn_in).tolist() == [False, True]
    pushed = legs(0.5, count=6).inverse()
    assert not pushed.problem(pushed.inputs(platform_position=(0, 0, 0.1)), integrator=RK4).out_of_reach().any()
    robot = legs(0.5)
    with pytest.raises(mr.SolveError, match=r"\(legs \d and \d, with the platform between, reach 0.452 m of 0.866 m\)"):
        mr.solve(robot, robot.inputs()).raise_if_failed()
