"""Stability by the index: closed-form critical loads, stored flags, and the Hessian of an independent energy."""

from types import SimpleNamespace

import numpy as np
import pytest
from discrete_energy import DiscreteEnergy, DiscretePlatform, Tube
from observer_scenes import three_tubes
from scipy.spatial.transform import Rotation
from test_parallel_rods import LOADS, SCENES, actuation, ring

import multirod as mr
from multirod.models.backbone.stability.condensing.by_nodes import compliance_form, condensed_form
from multirod.models.backbone.stability.condensing.forms import form_of
from multirod.models.backbone.stability.node_numbers import nodes_for
from multirod.models.backbone.stability.stability import BackboneStability
from multirod.models.held.stability import TipByWrench
from multirod.solvers.continuation.natural import natural_branch

STABLE, UNSTABLE, UNKNOWN, FOLD = mr.Stability.STABLE, mr.Stability.UNSTABLE, mr.Stability.UNKNOWN, mr.Stability.FOLD
NEAR = np.array([0.999, 1.001])  # of a critical load


def column(**values):
    return mr.SingleRod(mr.Rod(**({"length": 1.0, "bending_stiffness": 1.0, "torsional_stiffness": 0.8} | values)))


def straight(robot, **loads):
    """The straight equilibrium, at each of several loads."""
    return mr.solve(robot, robot.inputs(**loads), guess=(0.0, 0.0, 0.0)).raise_if_failed()


def along(vector, sizes):
    return np.multiply.outer(sizes, vector)


def test_unloaded_straight_rods_and_tubes_are_stable():
    tube = {"bending_stiffness": 0.01, "torsional_stiffness": 0.008}
    assert straight(column()).stability is STABLE
    soft = column(shear_stiffness=50.0, axial_stiffness=80.0)
    # beside another that is loaded: a kernel that other tests need too
    assert straight(soft, tip_force=[(0, 0, 0), (0, 0, 0.1)]).stability.tolist() == [STABLE] * 2
    one = mr.ConcentricTubes([mr.Rod(length=0.3, **tube)])
    loads = {"tip_force": [(0, 0, 0), (0, 0, 0.1)], "tip_moment": [(0, 0, 0), (0, 0, 0.001)]}  # likewise
    alone = mr.solve(one, one.inputs(translation=[-0.05], **loads))[0]
    assert (alone.index, alone.stability) == (0, STABLE)
    for count in (2, 3):
        robot = mr.ConcentricTubes([mr.Rod(length=0.3 - 0.1 * k, **tube) for k in range(count)])
        solution = mr.solve(robot, robot.inputs(translation=[-0.05 + 0.02 * k for k in range(count)]))
        assert (solution.index, solution.stability) == (0, STABLE)


def test_euler_column():
    """Clamped-free: pi^2 EI/(4 L^2), for each axis; the next mode at nine times that."""
    critical = np.pi**2 / 4
    loads = np.concatenate([critical * NEAR, 1.3 * critical * NEAR, 9 * critical * NEAR])
    assert straight(column(bending_stiffness=(1.0, 1.3)), tip_force=along((0, 0, -1), loads)).index.tolist() == [0, 1, 1, 2, 2, 3]


def test_modes_that_cross_together_are_both_counted():
    loads = np.pi**2 / 4 * np.concatenate([NEAR, 9 * NEAR, 25 * NEAR])
    assert straight(column(), tip_force=along((0, 0, -1), loads)).index.tolist() == [0, 2, 2, 4, 4, 6]


def test_nodes_are_as_close_as_the_load_asks_for():
    """45 modes about each axis have (k - 1/2)^2 pi^2 < 2e4: more than there are nodes at first."""
    assert straight(column(), tip_force=(0, 0, -2e4)).index == 90


@pytest.mark.parametrize(
    ("rods", "steps", "segments", "nodes"),
    [
        (1, 50, 12.0, 26),  # where two steps end
        (3, 50, 12.0, 17),  # fewer, and their own ends are no multiple of a step either
        (3, 50, 8.5, 11),
        (3, 50, 20.0, 26),
        (1, 53, 12.0, 54),
        (3, 53, 12.0, 17),
        (1, None, 12.0, 17),
        (3, None, 12.0, 17),
    ],
)
def test_no_more_nodes_than_that_where_steps_are_equal(rods, steps, segments, nodes):
    problem = SimpleNamespace(rods=[None] * rods, integrator=SimpleNamespace(steps=steps))
    assert nodes_for(problem, np.array([segments])) == nodes


def test_what_many_are_told_by_one_step_between_two_nodes_is_as_by_all(monkeypatch):
    """Three tubes ever more curved, turned half round, until they lose stability: only what is near there is asked for all."""
    count = 80
    curvatures = np.linspace(3, 8, count)
    bent = np.zeros((3, count, 3))
    bent[..., 0] = curvatures * (1 - 0.2 * np.arange(3))[:, None]
    rods = [
        mr.Rod(
            length=0.4 - 0.1 * k,
            bending_stiffness=0.01 * (1 + k),
            torsional_stiffness=0.0077 * (1 + k),
            precurvature=bent[k],
        )
        for k in range(3)
    ]
    robot = mr.ConcentricTubes(rods)
    inputs = robot.inputs(rotation=(0, np.pi, 0), translation=(-0.06, -0.04, -0.02), tip_force=(0, 0.05, 0.02))
    integrator = mr.RK4(30)
    found = mr.solve(robot, inputs, solver=mr.Shooting(integrator=integrator), guess=np.zeros(5)).raise_if_failed()
    problem = robot.problem(inputs, integrator=integrator)
    problem.write("unknowns", problem.adopt(found.unknowns))
    problem.integrate()
    by_all = problem.stability._unstable()
    asked, every = [], BackboneStability._unstable
    monkeypatch.setattr(BackboneStability, "_unstable", lambda own: asked.append(own.problem.instance_count) or every(own))
    np.testing.assert_array_equal(problem.stability.unstable(), by_all)
    assert 10 < by_all.sum() < count - 10
    assert len(asked) == 1
    assert by_all.sum() <= asked[0] < by_all.sum() + 5


def test_heavy_column():
    """Greenhill: w L^3/EI = 7.8373, about both axes."""
    solution = straight(column(linear_density=1.0), gravity=along((0, 0, -1), 7.8373 * NEAR))
    assert solution.index.tolist() == [0, 2]
    assert solution.stability.tolist() == [STABLE, UNSTABLE]


def test_shear_and_extension_lower_the_critical_load():
    """Linearised about the compressed column, EI phi'' + P (1 + P/GA - P/EA) phi = 0 (Haringx)."""
    GA, EA = 40.0, 60.0
    roots = np.roots([1 / GA - 1 / EA, 1.0, -(np.pi**2) / 4])
    critical = roots[roots > 0].min()
    robot = column(shear_stiffness=GA, axial_stiffness=EA)
    assert straight(robot, tip_force=along((0, 0, -1), critical * NEAR)).index.tolist() == [0, 2]


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_lateral_buckling_of_a_narrow_cantilever():
    """Prandtl: 4.0126 sqrt(EI GJ)/L^2; the depth is 1e5 times stiffer, so that the deflection before shifts it by 1e-5."""
    GJ = 0.6
    robot = column(bending_stiffness=(1e5, 1.0), torsional_stiffness=GJ)
    solution = mr.solve(robot, robot.inputs(tip_force=along((0, 1, 0), 4.0126 * np.sqrt(GJ) * NEAR)), guess=(0, 0, 0))
    assert solution.raise_if_failed().index.tolist() == [0, 1]


EI, GJ, L = (0.035, 0.012), (0.027, 0.009), 0.15


def two_tubes(turns, *, behind=0.0, longer=(0.0, 0.0), past=0.0):
    """Two tubes curved alike over a common length L, with ``turns`` = L sqrt(c); one may go on straight beyond it.

    What is straight ends ``past`` the plate.
    """
    c = (turns / L) ** 2
    kappa = np.sqrt(c * (EI[0] + EI[1]) / (EI[0] * EI[1]) / (1 / GJ[0] + 1 / GJ[1]))
    tubes = []
    for k in range(2):
        pieces = [(behind + past, (0, 0, 0)), (L - past, (kappa, 0, 0)), (longer[k], (0, 0, 0))]
        pieces = [piece for piece in pieces if piece[0] > 0]
        length = sum(piece[0] for piece in pieces)
        tubes.append(mr.Rod(length=length, bending_stiffness=EI[k], torsional_stiffness=GJ[k], precurvature=pieces))
    return mr.ConcentricTubes(tubes)


def untwisted(turns, angle, behind=0.0, **shape):
    robot = two_tubes(turns, behind=behind, **shape)
    return mr.solve(robot, robot.inputs(rotation=(0.0, angle), translation=-behind), guess=np.zeros(4)).raise_if_failed()


@pytest.mark.parametrize("turns", [0.5, 1.5, 3.0, 6.0])
def test_aligned_tubes_are_stable_however_curved(turns):
    assert untwisted(turns, 0.0).stability is STABLE


@pytest.mark.parametrize("longer", [(0.0, 0.0), (0.06, 0.0), (0.0, 0.06)], ids=["together", "outer ends", "inner ends"])
@pytest.mark.parametrize("mode", [1, 3])
def test_opposite_tubes_lose_stability_at_a_quarter_turn(longer, mode):
    """theta'' = c sin(theta) with theta' = 0 where the shorter ends: L sqrt(c) = pi/2, then 3 pi/2."""
    found = [untwisted(mode * np.pi / 2 * factor, np.pi, longer=longer).index for factor in NEAR]
    assert found == [(mode - 1) // 2, (mode + 1) // 2]


@pytest.mark.parametrize("longer", [(0.06, 0.0), (0.0, 0.06)], ids=["outer ends", "inner ends"])
def test_every_mode_of_opposite_tubes_is_counted(longer):
    """As many as there are (k - 1/2) pi below L sqrt(c), whichever pivot shows them."""
    for turns in np.linspace(0.4, 9.4, 31):
        assert untwisted(turns, np.pi, longer=longer).index == int(turns / np.pi + 0.5), turns


@pytest.mark.parametrize("past", [0.0, -1e-17, 2e-17, 1e-13, 1e-9, 1e-5])
def test_compliance_behind_the_plate_destabilises(past):
    """theta(0) = pi + b theta'(0) behind the plate: tan(L sqrt(c)) = 1/(b sqrt(c)) on the opposite branch.

    So it does where tubes are drawn back by what is straight of them, as far as rounding lets them.
    """
    behind, turns = 0.06, 1.0
    for _ in range(100):
        turns = np.arctan(L / (behind * turns))
    assert turns < 1.2
    assert [untwisted(turns * factor, np.pi, behind, past=past).index for factor in NEAR] == [0, 1]


def test_a_fold_is_told_from_either_side():
    """At its critical load the softest mode has no stiffness: 1e-9 away it is neutral, 1e-4 away it is not."""
    critical = np.pi**2 / 4 * np.array([1 - 1e-4, 1 - 1e-9, 1 + 1e-9, 1 + 1e-4])
    solution = straight(column(bending_stiffness=(1.0, 1.3)), tip_force=along((0, 0, -1), critical))
    assert solution.stability.tolist() == [STABLE, FOLD, FOLD, UNSTABLE]


def test_loads_without_a_potential_are_not_judged(wire):
    """Each in an instance of its own, beside one that has none of them; in batches whose kernels other tests need too."""
    robot = mr.SingleRod(wire)
    load, none = (0.01, 0.02, 0.0), (0.0, 0.0, 0.0)
    dead = {"tip_moment": [load, none, none], "distributed_moment": [none, load, none], "distributed_force": (0.0, 0.0, 0.01)}
    following = {"follower_force": [load, none, none], "follower_moment": [none, load, none]}
    for loads in (dead, following):
        solution = mr.solve(robot, robot.inputs(tip_force=(0.1, 0.0, 0.05), **loads)).raise_if_failed()
        assert solution.stability.tolist() == [UNKNOWN, UNKNOWN, STABLE]
        assert solution.index.tolist() == [-1, -1, 0]
        assert np.isnan(solution.potential).tolist() == [True, True, False]


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_rods_rigid_in_torsion_are_judged():
    """Euler's column has no use for torsion; a narrow cantilever that cannot twist does not tip over."""
    rigid = column(torsional_stiffness=np.inf)
    assert straight(rigid).stability is STABLE
    solution = straight(rigid, tip_force=along((0, 0, -1), np.pi**2 / 4 * np.concatenate([NEAR, 9 * NEAR])))
    assert solution.index.tolist() == [0, 2, 2, 4]
    narrow = column(bending_stiffness=(1e5, 1.0), torsional_stiffness=np.inf)
    tipped = mr.solve(narrow, narrow.inputs(tip_force=(0, 10.0, 0)), guess=(0, 0, 0)).raise_if_failed()
    assert tipped.stability is STABLE
    # as a rod that is far stiffer in torsion than in bending
    margins = []
    for torsion in (np.inf, 1e5):
        robot = column(bending_stiffness=(1.0, 1.4), torsional_stiffness=torsion, precurvature=(2.0, 1.0, 0.0))
        found = mr.solve(robot, robot.inputs(tip_force=(3.0, -2.0, -5.0))).raise_if_failed()
        assert found.stability is STABLE
        margins.append(found.stability_margin)
    np.testing.assert_allclose(*margins, rtol=1e-3)


def test_what_is_said_of_an_instance_does_not_depend_on_its_batch(wire):
    robot = mr.SingleRod(wire)
    force = np.array([(0, 0, 0), (1, 0, 0), (0, 2, 40), (3, 5, 300.0)])
    batch = mr.solve(robot, robot.inputs(tip_force=force)).raise_if_failed()
    alone = [mr.solve(robot, robot.inputs(tip_force=f)).stability_margin for f in force]
    np.testing.assert_array_equal(batch.stability_margin[1:], alone[1:])
    np.testing.assert_allclose(batch.stability_margin[0], alone[0], rtol=1e-14)  # without a load alone: another kernel
    assert (batch.stability == STABLE).all()


def test_what_failed_is_not_judged(wire):
    robot = mr.SingleRod(wire)
    solver = mr.Shooting(max_integrations=20)
    failed = mr.solve(robot, robot.inputs(tip_force=[(0, 0, 1), (0, 0, -1e3)]), solver=solver)
    assert failed.failed.tolist() == [False, True]
    assert failed.stability.tolist() == [STABLE, UNKNOWN]


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
@pytest.mark.parametrize("kind", ["some", "legs"])
def test_tubes_rigid_in_torsion_are_judged(kind):
    """As tubes that are far stiffer in torsion than in bending; not where all are, alone, and carry no torques."""
    margins = []
    for torsion in (np.inf, 1e6):
        tubes = [
            mr.Rod(length=L, bending_stiffness=EI, torsional_stiffness=GJ, precurvature=(c, 0, 0))
            for L, EI, c, GJ in ((1.0, 1.0, 2.0, torsion), (0.7, 1.5, 2.5, 1.2 if kind == "some" else torsion))
        ]
        robot, given = mr.ConcentricTubes(tubes), {"rotation": (0, 2.5)}
        if kind == "legs":
            assert torsion < np.inf or mr.solve(robot, robot.inputs(tip_force=(0, 0, -1), **given)).stability is UNKNOWN
            poses = np.tile(np.eye(4), (2, 1, 1))
            poses[:, 0, 3] = -0.2, 0.2
            robot, given = mr.ParallelRods(legs=[robot] * 2, base=poses, platform=poses), {"rotation": (0, 2.5, 0.3, -2)}
        found = mr.solve(robot, robot.inputs(tip_force=[(0.3, 0.2, -1), (0.3, 0.2, -4)], **given)).raise_if_failed()
        assert (found.stability == STABLE).all()
        margins.append(found.stability_margin)
    np.testing.assert_allclose(*margins, rtol=1e-4)


@pytest.mark.parametrize("scene", ["tubes", "tubes that end together", "rod"])
def test_the_compiled_form_is_that_of_numpy(scene):
    """Form, conjugate points and what is known, wherever the shooting stands: few of these states are stable."""
    random, count = np.random.default_rng(4), 60
    tubes, motion = three_tubes()
    robot, inputs = tubes, motion[:1].broadcast_to((count,))
    if scene == "rod":
        robot = mr.SingleRod(tubes.rods[0])
        inputs = robot.inputs(tip_force=random.normal(size=(count, 3)))
    elif scene == "tubes that end together":
        ends = np.array([rod.length for rod in tubes.rods])
        inputs = robot.inputs(translation=np.tile(ends[2] - ends, (count, 1)), tip_force=random.normal(size=(count, 3)))
    problem = robot.problem(inputs, integrator=mr.RK4(30))
    # no equilibria, and more bent than so many steps tell: a pass at unknowns of its own ends where it does
    unknowns = problem.guess() + 10 * random.normal(size=(count, problem.unknown_count))
    every, unit = np.ones(count, dtype=bool), problem.sizes.stiffness_over_length()
    stability, call = problem.stability, problem.nodes.over(17, every, columns=True, unknowns=unknowns)
    ends = stability._column_ends()
    found = form_of(call, stability._free(), ends.shape[1], "cpu").of(every, ends, unit)
    finite = np.isfinite(call.read("tip_columns")).all(axis=(1, 2))  # the last steps of some overflow
    own = condensed_form(stability._node_columns(call, finite, np.arange(stability._free())), unit[finite])
    assert own.known.sum() > 40
    np.testing.assert_array_equal(np.flatnonzero(found.known), np.flatnonzero(finite)[own.known])
    np.testing.assert_array_equal(found.conjugate[found.known], own.conjugate[own.known])
    assert len(np.unique(own.conjugate[own.known])) >= 3
    size = np.abs(own.matrix).max(axis=(1, 2))[own.known]
    # rounding, carried by columns whose condition may be 1e6 here
    off = np.abs(found.matrix[found.known] - own.matrix[own.known]).max(axis=(1, 2)) / size
    assert off.max() < 1e-8


@pytest.mark.parametrize("scene", ["legs", "legs of tubes", "held rod"])
def test_the_compiled_form_of_held_tips_is_that_of_numpy(scene):
    """The same where the tip is held: by the turns of the tip and the force on it, or by the wrench on it."""
    random, count = np.random.default_rng(5), 40
    rod = {"bending_stiffness": 0.02, "torsional_stiffness": 0.015}
    if scene == "legs of tubes":
        leg = mr.ConcentricTubes([mr.Rod(length=0.3 - 0.06 * k, precurvature=(9 - 5 * k, k, 0), **rod) for k in range(3)])
    else:
        leg = mr.Rod(length=0.3, precurvature=(1, 2, 0), **rod)
    if scene == "held rod":
        whole = mr.HeldRod(leg)
        problem = whole.problem(whole.inputs(end_position=np.full((count, 3), (0.02, 0, -0.01))), integrator=mr.RK4(30)).rod
    else:
        whole = mr.ParallelRods(legs=[leg] * 2, base=ring(2, 0.3), platform=ring(2, 0.3))
        inputs = whole.inputs(tip_force=random.normal(size=(count // 2, 3)))
        problem = whole.problem(inputs, integrator=mr.RK4(30)).groups[0].backbones
    n, length = problem.unknown_count, 0.3
    unknowns = problem.guess() + np.where(np.arange(n) < n - 3, 10, 100) * random.normal(size=(count, n))
    every, unit = np.ones(count, dtype=bool), problem.sizes.stiffness_over_length()
    stability = TipByWrench(problem) if scene == "held rod" else problem.stability
    call = problem.nodes.over(17, every, columns=True, unknowns=unknowns)
    found = stability._form(call, every, unit)
    assert found.matrix.shape == (count, n, n)
    columns = stability._node_columns(call, every, np.arange(n))
    moment = problem.tip_wrench.numpy()[:, 3:]
    own = compliance_form(columns, moment) if scene == "held rod" else condensed_form(columns, unit)
    assert own.known.sum() > 25
    np.testing.assert_array_equal(found.known, own.known)
    np.testing.assert_array_equal(found.conjugate[found.known], own.conjugate[own.known])
    assert len(np.unique(own.conjugate[own.known])) >= 3
    # moments by turns, by forces over stiffness, and positions by both: in units in which they are alike
    scale = np.where(np.arange(n) < n - 3, 1.0, 1 / length)
    scale = 1 / scale if scene == "held rod" else scale
    matrices = [form.matrix[own.known] * scale[:, None] * scale for form in (found, own)]
    # rounding, carried by columns whose condition may be 1e6 here
    off = np.abs(matrices[0] - matrices[1]).max(axis=(1, 2)) / np.abs(matrices[1]).max(axis=(1, 2))
    assert off.max() < 1e-8
    # some alone, and of each what it is among all
    some = random.random(count) < 0.4
    np.testing.assert_array_equal(stability._form(call, some, unit).matrix, found.matrix[some])


def test_single_rod_cases(reference_cases, make_pose):
    """All stored minima of the energy are stable."""
    from test_cases import TIGHT, robot_and_inputs

    count = 0
    for case in reference_cases("single_rod"):
        if not case["verification"].get("stable_energy_minimum"):
            continue
        robot, inputs = robot_and_inputs(case, make_pose)
        guess = None
        if case["difficulty"] == "multiple solutions":
            moment = np.array(case["inputs"]["base"]["R0"]).T @ case["expected"]["base_moment"]["value"]
            stored = case["inputs"]["rods"][0]
            guess = stored["u_star"] + moment / stored["K"]
        solution = mr.solve(robot, inputs, guess=guess, solver=TIGHT)
        if solution.status.failed:
            assert case["difficulty"] != "standard"
            continue
        assert solution.stability is STABLE, case["id"]
        count += 1
    assert count >= 10


def test_what_a_solve_returns_is_stable(reference_cases, make_pose):
    """The natural branch of every stored parallel robot, and of rods under random loads: where it is reached at all."""
    from test_parallel_rods import stored_robot

    judged = 0
    for case in reference_cases("parallel_continuum_robot"):
        parallel, inputs = stored_robot(case, make_pose)
        solution = mr.solve(parallel, inputs).raise_if_failed()
        assert solution.stability in (STABLE, UNKNOWN)
        judged += solution.stability is STABLE
    assert judged >= 3
    robot = column(bending_stiffness=(1.0, 1.4), precurvature=(1.0, 0.5, 0.3))
    force = 10 * np.random.default_rng(2).normal(size=(200, 3))
    solution = mr.solve(robot, robot.inputs(tip_force=force))
    good = solution.status == mr.Status.CONVERGED
    assert good.sum() > 100
    assert (solution.stability[good] == STABLE).all()


def test_an_unstable_state_that_a_cold_start_leads_to_is_no_result():
    """Legs turned and pushed: the state that beams suggest is beyond a snap; put together anew it is stable, as where it is led
    in steps."""
    robot = SCENES["six rods"]()
    values = {name: 0.3 * value for name, value in actuation(robot, np.random.default_rng(1)).items()}
    inputs = robot.inputs(**values)
    problem = robot.problem(inputs, integrator=mr.RK45())
    method = mr.Shooting()
    assert natural_branch(problem, method.newton(problem), 1000).status[0] == mr.Status.CONVERGED
    assert problem.stability.modes().stability[0] == UNSTABLE
    cold = mr.solve(robot, inputs)
    assert cold.status is mr.Status.CONVERGED
    assert cold.stability == STABLE
    part = np.linspace(0, 1, 31)[:, None]
    history = mr.simulate(robot, robot.inputs(**{name: part * value for name, value in values.items()}), time=part[:, 0])
    assert history.raise_if_failed().stability.tolist() == [STABLE] * len(part)


# ---- an independent energy ----


def tubes_as_robot(tubes):
    rods = []
    for t in tubes:
        curved = (t.length - t.straight, t.u_star)
        pieces = [(t.straight, (0, 0, 0)), curved] if t.straight else [curved]
        rods.append(mr.Rod(length=t.length, bending_stiffness=t.EI, torsional_stiffness=t.GJ, precurvature=pieces))
    return mr.SingleRod(rods[0]) if len(rods) == 1 else mr.ConcentricTubes(rods)


def sampled(energy, solution):
    """A solution as unknowns of the discrete energy: one tube, or two."""
    tubes, shape = energy.tubes, solution.rod(0, nodes=401)
    u = np.stack([np.interp(energy.middle, shape.arclength, shape.curvature[:, k]) for k in range(3)], axis=1)
    if len(tubes) == 1:
        return u.ravel()
    other = solution.rod(1, nodes=401)
    torque = np.interp(energy.middle, other.arclength, other.moment[:, 2])
    rate = (torque / tubes[1].GJ - u[:, 2])[energy.places[0]]
    base = [shape.moment[0, 2], other.moment[0, 2]]
    turns = [base[k] * tubes[k].behind / tubes[k].GJ for k in energy.turning]
    return np.concatenate([u.ravel(), rate, turns])


def compare_with_hessian(tubes, force, segment_count, inputs):
    robot = tubes_as_robot(tubes)
    found = mr.equilibria(robot, robot.inputs(tip_force=force, **inputs))
    energy = DiscreteEnergy(tubes, force, segment_count)
    for k, index in enumerate(found.index):
        one = mr.solve(robot, robot.inputs(tip_force=force, **inputs), guess=found.unknowns[k])
        q, negative = energy.stationary(sampled(energy, one))
        # strains constant by segment are off by h u'/2: their energy lacks a part (h/L)^2 of order one
        size = max(abs(found.potential).max(), tubes[0].EI / tubes[0].length)
        np.testing.assert_allclose(energy(q[None])[0], found.potential[k], rtol=0, atol=5 * size / segment_count**2)
        assert negative == index
    return found.index.tolist()


def test_the_hessian_of_a_rod_agrees():
    """A precurved rod pushed hard."""
    rod = Tube(length=0.5, straight=0.0, EI=0.02, GJ=0.015, u_star=(2.0, 1.0, 0.0))
    index = compare_with_hessian([rod], np.array([0.02, -0.05, -1.2]), 20, {})
    assert len(index) >= 3
    assert {0, 1} <= set(index)


@pytest.mark.parametrize("force", [(0.0, 0.0, 0.0), (0.1, -0.2, -0.3)], ids=["unloaded", "loaded"])
def test_the_hessian_of_two_tubes_agrees(force):
    """Strongly curved, of unequal ends, and twisting behind the plate."""
    angles, behind = (0.2, 3.1), (0.05, 0.03)
    inner = Tube(length=0.22, straight=0.06, EI=0.012, GJ=0.009, u_star=(16.0, 2.0, 0.0), angle=angles[0], behind=behind[0])
    outer = Tube(length=0.15, straight=0.04, EI=0.035, GJ=0.027, u_star=(10.0, 0.0, 0.0), angle=angles[1], behind=behind[1])
    values = {"rotation": angles, "translation": [-b for b in behind]}
    index = compare_with_hessian([inner, outer], np.array(force), 16, values)
    assert len(index) >= 3
    assert {0, 1} <= set(index)


# ---- parallel robots ----


DEAD = {name: LOADS[name] for name in ("tip_force", "force_point", "distributed_force", "gravity")}


@pytest.mark.parametrize("scene", SCENES)
def test_the_form_of_a_parallel_robot_is_symmetric(scene):
    """As it is for every joint, tubes, weights and loads beside the origin, only if all its terms are there."""
    robot = SCENES[scene]()
    # tubes that twist behind their plates
    values = DEAD | {name: 0.2 * value for name, value in actuation(robot, np.random.default_rng(1)).items()}
    solution = mr.solve(robot, robot.inputs(**values)).raise_if_failed()
    assert solution._modes.uncertainty.max() < 1e-7
    assert solution.stability is STABLE
    assert solution.stability_margin > 1e-3
    for load in ("tip_moment", "follower_force", "follower_moment", "distributed_moment"):
        loaded = mr.solve(robot, robot.inputs(**values | {load: LOADS[load]})).raise_if_failed()
        assert (loaded.stability, loaded.index) == (UNKNOWN, -1)
        assert np.isnan(loaded.potential)
        assert np.isnan(loaded.stability_margin)


@pytest.mark.parametrize("scene", SCENES)
def test_the_potential_of_a_parallel_robot_is_moved_by_its_load(scene):
    """dE/dF is the negative displacement of the point where F acts."""
    robot, step = SCENES[scene](), 1e-3
    solver = mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-11, atol=1e-13))
    forces = np.array(DEAD["tip_force"]) + step * np.array([(1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1), (0, 0, 0)])
    found = mr.solve(robot, robot.inputs(**DEAD | {"tip_force": forces}), solver=solver).raise_if_failed()
    where = found.tip_position[4] + found.tip_rotation[4] @ np.array(DEAD["force_point"])
    geometry = robot.geometry
    origin, rotation = geometry.reference()
    start = origin + rotation @ np.array(DEAD["force_point"])
    slope = np.array([found.potential[0] - found.potential[1], found.potential[2] - found.potential[3]]) / (2 * step)
    # central differences: the third derivative times step^2
    np.testing.assert_allclose(slope, -(where - start)[[0, 2]], atol=1e-5 * np.linalg.norm(where - start))


def columns_under_platform(count, force):
    """The straight state of columns of length and stiffness 1 under a load on their platform, for each of several loads."""
    leg = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8)
    robot = mr.ParallelRods(legs=[leg] * count, base=ring(count, 0.3), platform=ring(count, 0.3))
    guess = np.zeros((len(force), 6 * count + 6))
    guess[:, 5 : 6 * count : 6] = -force[:, None] / count
    guess[:, 6 * count + 2] = 1.0
    return mr.solve(robot, robot.inputs(tip_force=along((0, 0, -1), force)), guess=guess).raise_if_failed()


def test_columns_sway_under_a_platform():
    """pi^2 EI/L^2 each, in both directions at once. Two legs do not keep it from tilting: then pi^2/4, as for a free tip."""
    assert columns_under_platform(3, 3 * np.pi**2 * NEAR).index.tolist() == [0, 2]
    assert columns_under_platform(2, np.concatenate([2 * np.pi**2 / 4 * NEAR, 2 * np.pi**2 * NEAR])).index.tolist() == [
        0,
        1,
        1,
        2,
    ]


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_a_column_clamped_at_both_ends_buckles_at_four_times_that():
    """A column that grows between its base and a platform which stiff legs hold. Extended, P (1 - P/EA) = 4 pi^2 EI/l^2."""
    EA = 4000.0
    thin = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8, axial_stiffness=EA)
    thick = mr.Rod(length=1.0, bending_stiffness=1e7, torsional_stiffness=1e7, axial_stiffness=1e9)
    base = np.tile(np.eye(4), (3, 1, 1))
    base[1:, 0, 3] = 0.5, -0.5
    robot = mr.ParallelRods(legs=[thin, thick, thick], base=base, platform=base)
    # compressed to the length 1, it is l = 1/(1 - P/EA) long
    force = 4 * np.pi**2 / (1 + 4 * np.pi**2 / EA) * NEAR
    guess = np.zeros((2, 24))
    guess[:, 5], guess[:, 20] = -force, 1.0
    translation = np.zeros((2, 3))
    translation[:, 0] = force / (EA - force)
    found = mr.solve(robot, robot.inputs(translation=translation), guess=guess).raise_if_failed()
    # stiff legs give way by 1e-8
    np.testing.assert_allclose(found.rod(0).force[:, 0, 2], -force, rtol=1e-5)
    assert found.index.tolist() == [0, 2]


@pytest.mark.parametrize(
    ("joints", "load", "segments", "indices"),
    [(["clamped"] * 2, 8.0, 10, {0, 1, 2}), (["clamped", "spherical"], 8.0, 10, {0, 1}), (["clamped"] * 3, 45.0, 8, {0, 2})],
)
def test_the_hessian_of_a_parallel_robot_agrees(joints, load, segments, indices):
    """An independent energy, its constraints projected out, at every equilibrium found."""
    count, EA = len(joints), 200.0
    base, platform, force = ring(count, 0.3, tilt=0.1), ring(count, 0.2, 0.15, 0.05), np.array([0.3, 0.2, -load])
    leg = mr.Rod(length=1.0, bending_stiffness=1.0, torsional_stiffness=0.8, axial_stiffness=EA)
    robot = mr.ParallelRods(legs=[leg] * count, base=base, platform=platform, joints=joints)
    found = mr.equilibria(robot, robot.inputs(tip_force=force), starts=128)
    energy = DiscretePlatform([(1.0, 1.0, 0.8, EA)] * count, base, platform, joints, force, segments)
    middle = (np.arange(segments) + 0.5) / segments
    assert indices <= set(found.index.tolist())
    seen = set()
    for k, index in enumerate(found.index):
        if index in seen:
            continue
        seen.add(index)
        one = mr.solve(robot, robot.inputs(tip_force=force), guess=found.unknowns[k])
        q = []
        for number in range(count):
            shape = one.rod(number, nodes=8 * segments + 1)
            strains = [*shape.curvature.T, shape.force[:, 2] / EA]
            q.append(np.column_stack([np.interp(middle, shape.arclength, strain) for strain in strains]).ravel())
        pose = np.concatenate([one.tip_position, Rotation.from_matrix(one.tip_rotation).as_rotvec()])
        q, negative = energy.index(np.concatenate([*q, pose]))
        potential = one.potential - force @ robot.geometry.reference()[0]
        # strains constant by segment are off by h u'/2: their energy lacks a part (h/L)^2 of order one
        assert abs(energy.parts(q[None])[0][0] - potential) < 5 * load / segments**2
        assert negative == index


def test_an_odd_number_of_modes_that_grow_is_seen_without_a_potential():
    """A column beyond its load with a twisting moment at its tip: det Gamma has changed its sign."""
    robot = column(bending_stiffness=(1.0, 1.3))
    forces = np.pi**2 / 4 * np.array([0.9, 1.1, 1.4])
    for moment in ({"tip_moment": (0, 0, 1e-3)}, {"follower_moment": (0, 0, 1e-3)}):
        solution = mr.solve(
            robot, robot.inputs(tip_force=along((0, 0, -1), forces), **moment), guess=(0, 0, 1e-3 / 0.8)
        ).raise_if_failed()
        assert solution.stability.tolist() == [UNKNOWN, UNSTABLE, UNKNOWN]
        assert solution.index.tolist() == [-1, -1, -1]


@pytest.mark.filterwarnings("ignore::multirod.PlausibilityWarning")
def test_the_margin_vanishes_at_the_critical_load():
    """Of a column: sqrt(P) cot(sqrt(P)) of each axis, over EI/L; -inf where it is unstable though its tip be held."""
    loads = np.array([1e-9, 1.0, 2.0, 2.4, 3.0, 12.0])
    solution = straight(column(bending_stiffness=(1.0, 1.3), torsional_stiffness=4.0), tip_force=along((0, 0, -1), loads))
    expected = np.sqrt(loads) / np.tan(np.sqrt(loads))
    # the steps between nodes, which error control does not shorten for a straight rod, leave 1e-7
    np.testing.assert_allclose(solution.stability_margin[:5], expected[:5], rtol=0, atol=1e-6)
    assert solution.stability_margin[5] == -np.inf
