"""Derivatives by the numbers of the robot itself, ``docs/derivatives.md``, against differences of sixth order."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import multirod as mr
from multirod.models.backbone.problem import BackboneProblem

SOLVER = mr.Shooting(integrator=mr.RK45(rtol=1e-11, atol=1e-13), tolerance=1e-12)
NODES, WEIGHTS = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60  # a derivative, error O(h^6)
STEPS = {"precurvature": 3e-2, "bending_stiffness": 1e-2, "torsional_stiffness": 1e-2, "length": 3e-4}
COMPONENTS = {"precurvature": (3,), "bending_stiffness": (2,), "torsional_stiffness": (), "length": ()}
# length, bending stiffness, torsional stiffness, precurvature of each section
WIRE = [[(0.25, (0.22, 0.25), 0.064, (14, 5, 1)), (0.15, (0.2, 0.18), 0.07, (3, -5, 2))]]
TUBES = [
    [(0.30, (0.004, 0.004), 0.003, (0, 0, 0)), (0.10, (0.0042, 0.0042), 0.0031, (0, 14, 0.5))],
    [(0.20, (0.02, 0.02), 0.016, (0, 0, 0.3)), (0.09, (0.021, 0.021), 0.015, (2, 6, 0))],
    [(0.12, (0.1, 0.1), 0.08, (0, 0, 0)), (0.08, (0.11, 0.11), 0.08, (0, 4, 0))],
]


def sections_of(rods, name=None, steps=0.0):
    """Sections of rods whose numbers of one name are changed: one instance for each number and each node."""
    shape = (len(rods), len(rods[0]), *COMPONENTS.get(name, ()))
    count = int(np.prod(shape))
    change = np.zeros((count, len(NODES), count))
    if name is not None:
        change[np.arange(count), :, np.arange(count)] = steps * NODES
    change = change.reshape(count, len(NODES), *shape)
    made = []
    for i, rod in enumerate(rods):
        own = []
        for m, numbers in enumerate(rod):
            values = dict(zip(("length", "bending_stiffness", "torsional_stiffness", "precurvature"), numbers, strict=True))
            if name is not None:
                at_rest = np.array(values[name])
                values[name] = at_rest + (at_rest if "stiffness" in name else 1.0) * change[:, :, i, m]
            own.append(mr.Section(linear_density=0.01 * (i + m + 1), **values))
        made.append(mr.Rod(sections=own))
    return made


def differences(varied, rotation, step):
    """Derivatives of the pose, (6, k), by what varies along the first axis, from its values along the second."""
    assert not varied.failed.any()
    moved = np.einsum("n,knc->ck", WEIGHTS, varied.tip_position) / step
    turned = np.einsum("n,knij,lj->kil", WEIGHTS, varied.tip_rotation, rotation) / step
    turned = 0.5 * (turned - np.swapaxes(turned, 1, 2))
    return np.concatenate([moved, np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]])])


def by_differences(make, inputs, rods, name, rotation):
    """Derivatives of the pose by the numbers of one name, (6, k); those of stiffnesses relative to themselves."""
    robot = make(sections_of(rods, name, STEPS[name]))
    return differences(mr.solve(robot, robot.inputs(**inputs), solver=SOLVER), rotation, STEPS[name])


def stiffnesses(rods, name):
    values = {
        "bending_stiffness": [n[1] for rod in rods for n in rod],
        "torsional_stiffness": [n[2] for rod in rods for n in rod],
    }
    return np.ravel(values[name]) if name in values else 1.0


LOADS = {"tip_force": (0.05, 0.1, 0.1)}
DRAWN_IN = {"rotation": (-1.2, -0.4, 0.1), "translation": (-0.32, -0.22, -0.14)}  # sections end behind the plate
SLID = {"rotation": (-1.2, -0.4, 0.1), "translation": (-0.16, -0.13, -0.1)}


@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize(
    ("make", "rods", "inputs"),
    [
        pytest.param(lambda rods: mr.SingleRod(*rods), WIRE, {"rotation": 0.3, "translation": 0.02, **LOADS}, id="rod"),
        pytest.param(mr.ConcentricTubes, TUBES, {**SLID, **LOADS, "gravity": (0, 1, -9)}, id="loaded tubes"),
        pytest.param(mr.ConcentricTubes, TUBES, SLID, id="tubes"),
        pytest.param(mr.ConcentricTubes, TUBES, DRAWN_IN, id="tubes drawn in"),
    ],
)
def test_columns_are_derivatives(make, rods, inputs, name):
    """To 1e-9 of the largest: the differences' rounding is 1e-12, their own error less."""
    robot = make(sections_of(rods))
    solution = mr.solve(robot, robot.inputs(**inputs), solver=SOLVER)
    found = solution.jacobian(name) * stiffnesses(rods, name)
    expected = by_differences(make, inputs, rods, name, solution.tip_rotation)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    # lengths scale the unknowns too; of tubes alike about both axes a change of one is a kink in what scales them
    if name != "length" and not (name == "bending_stiffness" and len(rods) > 1):
        at_unknowns(make, rods, inputs, name, solution)


def at_unknowns(make, rods, inputs, name, solution):
    """(D9), of the residual and the pose at fixed unknowns."""
    robot = make(sections_of(rods))
    options = {"integrator": SOLVER.integrator, "pose_sensitivities": True}
    problem = robot.problem(robot.inputs(**inputs), **options, **robot.input_directions(name))
    problem.evaluate(solution.unknowns[None])
    slopes, moved = problem.input_columns(name)
    robot = make(sections_of(rods, name, STEPS[name]))
    varied = robot.problem(robot.inputs(**inputs), **options)
    residual, _ = varied.evaluate(np.broadcast_to(solution.unknowns, (varied.instance_count, solution.unknown_count)))
    scale = stiffnesses(rods, name)
    for found, values in ((slopes, residual), (moved[:, :3], varied.read("position"))):
        expected = np.einsum("n,knc->ck", WEIGHTS, values.reshape(-1, len(NODES), values.shape[-1])) / STEPS[name]
        np.testing.assert_allclose(found[0] * scale, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def side_by_side(name=None, step=0.0):
    """Two tubes, one of which begins to bend and twist more and more behind the plate; their numbers changed by ``step``."""
    laws = [lambda s: np.array([3, 12, 1]), lambda s: np.array([20 * s, 12 - 60 * s, 1 + 40 * s]), lambda s: np.array([8, -4, 1])]
    made = []
    for k, (length, bending, torsional) in enumerate([(0.05, 0.02, 0.016), (0.15, 0.025, 0.018), (0.17, 0.05, 0.03)]):
        values = {"length": length, "bending_stiffness": bending, "torsional_stiffness": torsional}
        values |= {name: values[name] + step * SIDE_BY_SIDE[name][k]} if name in values else {}
        more = step * SIDE_BY_SIDE["precurvature"][k] * (name == "precurvature")
        made.append(mr.Section(**values, precurvature=lambda s, k=k, more=more: laws[k](s) + more))
    tubes = mr.Rod(sections=made[:2]), mr.Rod(sections=made[2:])
    return mr.EccentricTubes(tubes, ((0.003, 0.001), (-0.002, 0.002)))


SIDE_BY_SIDE = {  # along which their numbers change
    "precurvature": np.array([(0.4, -1, 0.8), (1, 0.5, -0.7), (-0.6, 1, 1)]),
    "bending_stiffness": np.array([0.02, -0.02, 0.04]),
    "torsional_stiffness": np.array([0.016, -0.015, 0.03]),
    "length": np.array([1.0, -0.6, 0.4]),
}


@pytest.mark.parametrize("name", STEPS)
def test_columns_of_tubes_side_by_side(name):
    """(D7), and (D8) where precurvature varies behind the plate, along one direction."""
    inputs = {"rotation": (0.4, 1.7), "translation": (-0.08, -0.02), "tip_force": (0.3, -0.2, 0.1)}

    def solved(step):
        robot = side_by_side(name, step)
        return mr.solve(robot, robot.inputs(**inputs), solver=SOLVER)

    solution = solved(0.0)
    changes = np.zeros((2, 2, *COMPONENTS[name]))
    own = SIDE_BY_SIDE[name].reshape(3, *(-1,) * len(COMPONENTS[name]))
    changes[0], changes[1, 0] = own[:2], own[2]
    found = solution.jacobian(name) @ changes.ravel()
    varied = [solved(STEPS[name] * node) for node in NODES]
    moved = WEIGHTS @ np.array([s.tip_position for s in varied]) / STEPS[name]
    turned = np.einsum("n,nij,lj->il", WEIGHTS, [s.tip_rotation for s in varied], solution.tip_rotation) / STEPS[name]
    expected = np.array([*moved, turned[2, 1], turned[0, 2], turned[1, 0]])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def rod_of(name=None, steps=0.0):
    """The robot of one rod, whose number of that name is changed."""
    return mr.SingleRod(*sections_of(WIRE, name, steps))


@pytest.fixture(scope="module")
def bent():
    """One rod under a force."""
    robot = rod_of()
    return mr.solve(robot, robot.inputs(rotation=0.3, **LOADS), solver=SOLVER)


@pytest.mark.parametrize("name", ["tip_force", "rotation", "precurvature", "bending_stiffness"])
def test_along_the_rod(bent, name):
    """Position, curvature and wrench in the middle, which stays where it is along the rod."""
    given = {"rotation": 0.3, **LOADS}
    if name in STEPS:
        step, robot = STEPS[name], rod_of(name, STEPS[name])
    else:
        step, robot = 1e-3, bent.assembly
        at = np.atleast_1d(given[name])
        given[name] = at + step * NODES[:, None] * np.eye(len(at))[:, None]
    moved = mr.solve(robot, robot.inputs(**given), solver=SOLVER)
    varied = moved.rod(nodes=3)
    told = {"position": varied.position[:, :, 1], "curvature": varied.curvature[:, :, 1], "wrench": moved.along(0.2, of="wrench")}
    for of, values in told.items():
        expected = np.einsum("n,knc->ck", WEIGHTS, values) / step
        found = bent.jacobian(name, of=of, at=0.2) * stiffnesses(WIRE, name)
        # the nodes of a shape are steps of the integration too: what that leaves of a curvature
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def followed(bent, places):
    """Position, rotation and curvature of ``bent`` at places, its equations integrated by SciPy from the moment at its base."""
    force = np.array(LOADS["tip_force"])
    (first, K1, GJ1, u1), (_, K2, GJ2, u2) = WIRE[0]

    def strain(s, M):
        return np.array(u1 if s <= first else u2) + M / np.array([*(K1 if s <= first else K2), GJ1 if s <= first else GJ2])

    def rates(s, y):
        R, M = y[3:12].reshape(3, 3), y[12:]
        u = strain(s, M)
        turning = np.array([(0, -u[2], u[1]), (u[2], 0, -u[0]), (-u[1], u[0], 0)])
        return np.concatenate([R[:, 2], (R @ turning).ravel(), -np.cross(u, M) - np.cross((0, 0, 1), R.T @ force)])

    base = np.array([(np.cos(0.3), -np.sin(0.3), 0), (np.sin(0.3), np.cos(0.3), 0), (0, 0, 1)])
    y = np.concatenate([np.zeros(3), base.ravel(), bent.rod(nodes=2).moment[0]])
    found, s = [], 0.0
    for end in places:  # one of them is where the first section ends
        y = solve_ivp(rates, (s, end), y, rtol=1e-12, atol=1e-14, method="DOP853", max_step=0.01).y[:, -1]
        s = np.nextafter(end, 1)
        found.append((y[:3], y[3:12].reshape(3, 3), strain(end, y[12:])))
    return [np.array(values) for values in zip(*found, strict=True)]


def test_between_nodes_a_rod_is_what_its_equations_say(bent):
    """(D11), (D12) The places themselves, to 1e-9: the solve's own error is less."""
    places = np.array([0.0131, 0.0777, 0.25, 0.2513, 0.3999])
    for of, expected in zip(("position", "rotation", "curvature"), followed(bent, places), strict=True):
        found = bent.along(places, of=of)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * max(np.abs(expected).max(), 1.0))
        np.testing.assert_array_equal(bent.along(0.0777, of=of).shape, expected.shape[1:])
    np.testing.assert_allclose(bent.along(0.4), bent.tip_position, rtol=0, atol=1e-12)


def test_along_a_rod_begins_at_its_base(bent):
    """As ``rod(0)`` does: by 1e-12 of the length, times what the shape changes by along it."""
    shape, places = bent.rod(0), np.array([0.0, 0.0777])
    for of, change in (("position", 1.0), ("rotation", 30.0), ("curvature", 1e3)):
        found, base = bent.along(places, of=of), getattr(shape, of)[0]
        np.testing.assert_allclose(found[0], base, rtol=0, atol=1e-12 * 0.4 * change + 1e-14 * np.abs(base).max())
        np.testing.assert_allclose(found[1], bent.along(0.0777, of=of), rtol=0, atol=1e-12)
        np.testing.assert_allclose(bent.along(0, of=of), found[0], rtol=0, atol=1e-12)
    slopes = bent.jacobian("rotation", of="rotation", at=shape.arclength[:2])
    np.testing.assert_allclose(slopes[0].ravel(), (0, 0, 1), rtol=0, atol=1e-10)  # the base turns as it is turned
    np.testing.assert_array_equal(bent.jacobian("tip_force", of="position", at=0.0).round(11), np.zeros((3, 3)))


def test_of_a_batch_places_are_those_of_each(bent):
    """Also of a tube inside others; NaN where there is no result."""
    robot = mr.ConcentricTubes(sections_of(TUBES))
    inputs = robot.inputs(**SLID | {"rotation": np.array([SLID["rotation"], (0.3, 0.2, 0)])}, **LOADS)
    solution = mr.solve(robot, inputs, solver=SOLVER)
    shape = solution.rod(1, nodes=4)
    for of in ("position", "rotation", "curvature"):
        found = solution.along(shape.arclength[0, 1:3], of=of, rod=1)
        np.testing.assert_allclose(found, getattr(shape, of)[:, 1:3], rtol=0, atol=1e-9)
        np.testing.assert_array_equal(found[1], solution[1].along(shape.arclength[0, 1:3], of=of, rod=1))
    lost = mr.solve(bent.assembly, bent.inputs, solver=mr.Shooting(max_integrations=1))
    assert lost.failed
    assert np.isnan(lost.along(0.2)).all()


def test_places_along_some_of_a_batch_of_rods_are_on_these():
    """Lengths that differ, and how far each rod is pushed out, are those of the instances asked, whatever their order."""
    length, out = np.array([0.3, 0.4, 0.5]), np.array([0.0, 0.01, -0.15])

    def pulled(length, out):
        robot = mr.SingleRod(mr.Rod(length=length, bending_stiffness=0.2, torsional_stiffness=0.06, precurvature=(3, 0, 0)))
        return mr.solve(robot, robot.inputs(translation=out, tip_force=(0.1, 0, 0)))

    every = pulled(length, out)
    backward = every[::-1]  # 0.35, 0.41 and 0.3 m reach out
    np.testing.assert_array_equal(backward.along(0.29), every.along(0.29)[::-1])
    for asked in (backward[:2], every[[1, 2]][::-1]):
        np.testing.assert_array_equal(asked.along(0.34)[0], pulled(0.5, -0.15).along(0.34))
        by_force = asked.jacobian("tip_force", of="position", at=0.34)
        np.testing.assert_array_equal(by_force[1], pulled(0.4, 0.01).jacobian("tip_force", of="position", at=0.34))
    assert every[1].along(0.4).shape == (3,)
    for one, end in ((every[0], "0.3 m"), (every[1], "0.41 m"), (every[2], "0.35 m"), (backward, "0.3 m")):
        with pytest.raises(ValueError, match=rf"^at = \[0.42\] .* <= {end}, where the rod ends$"):
            one.along(0.42)


def test_along_the_rods_of_a_batch_of_none():
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06))
    none = mr.solve(robot, robot.inputs(tip_force=np.zeros((2, 0, 3))))
    assert none.along((0.1, 0.2)).shape == (2, 0, 2, 3)
    assert none.along(0.2, of="rotation").shape == (2, 0, 3, 3)
    assert none.jacobian("tip_force", of="position", at=0.2).shape == (2, 0, 3, 3)


def test_along_a_rod_that_is_pushed(bent):
    """(D11) At a place that stays, behind the end of a section that moves; a node of a shape moves with the rod's length."""
    robot, step = bent.assembly, 1e-3
    pushed = robot.inputs(rotation=0.3, translation=step * NODES[:, None], **LOADS)
    varied = mr.solve(robot, pushed, solver=SOLVER).rod(nodes=5).curvature[:, 3]
    near = bent.rod(nodes=401).curvature[300 + NODES]  # 1 mm apart
    expected = WEIGHTS @ varied / step - 0.75 * WEIGHTS @ near / 1e-3
    found = bent.jacobian("translation", of="curvature", at=0.3)[:, 0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_along_a_tube_that_is_not_the_first():
    """In its own frame, which turns about that of the first."""
    robot = mr.ConcentricTubes(sections_of(TUBES))
    solution = mr.solve(robot, robot.inputs(**SLID), solver=SOLVER)
    turned = SLID | {"rotation": np.array(SLID["rotation"]) + 1e-2 * NODES[:, None] * np.eye(3)[:, None]}
    varied = mr.solve(robot, robot.inputs(**turned), solver=SOLVER).rod(1, nodes=3)
    expected = np.einsum("n,knc->ck", WEIGHTS, varied.curvature[:, :, 1]) / 1e-2
    found = solution.jacobian("rotation", of="curvature", at=float(varied.arclength[0, 0, 1]), rod=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


MET = {"rotation": (-1.2, -0.4, 0.1), "translation": (-0.14, -0.05, -0.04), **LOADS}  # a section of the first ends with the third
SIDES = np.arange(7)  # steps to one side
ONE_SIDED = np.linalg.solve(np.vander(SIDES, increasing=True).T.astype(float), np.eye(7)[1])  # error O(h^6)


def to_one_side(make, step):
    """A derivative of the pose by one number, from values to one side of it."""
    values = [mr.solve(*make(k * step), solver=SOLVER) for k in SIDES]
    turned = np.einsum("n,nij,lj->il", ONE_SIDED, [v.tip_rotation for v in values], values[0].tip_rotation)
    turned = 0.5 * (turned - turned.T)
    moved = np.einsum("n,nc->c", ONE_SIDED, [v.tip_position for v in values])
    return np.concatenate([moved, [turned[2, 1], turned[0, 2], turned[1, 0]]]) / step


def tubes_that_meet(translation=(0, 0, 0), lengths=(0, 0, 0)):
    rods = [[(own[0][0] + more, *own[0][1:]), own[1]] for own, more in zip(TUBES, lengths, strict=True)]
    robot = mr.ConcentricTubes(sections_of(rods))
    return robot, robot.inputs(**MET | {"translation": np.array(MET["translation"]) + translation})


@pytest.mark.parametrize(("tube", "side"), [(0, 1), (2, -1), (1, 1), (1, -1)])
def test_where_ends_of_two_tubes_meet_it_is_that_of_one_side(tube, side):
    """There the pose has a kink: that of the outer tube as if it were further back, however it is asked for."""
    solution = mr.solve(*tubes_that_meet(), solver=SOLVER)
    along = np.eye(3)[tube]
    columns = solution.jacobian("translation", "length")
    pushed = to_one_side(lambda step: tubes_that_meet(translation=step * along), side * 1e-4)
    longer = to_one_side(lambda step: tubes_that_meet(lengths=step * along), side * 1e-4)
    scale = np.abs(columns).max()
    np.testing.assert_allclose(columns[:, tube], pushed, rtol=0, atol=1e-7 * scale)
    np.testing.assert_allclose(columns[:, 3 + 2 * tube], longer, rtol=0, atol=1e-7 * scale)
    np.testing.assert_array_equal(solution.jacobian("length"), columns[:, 3:])
    gradient = solution.vjp((1, 0, 0), of="tip_position", wrt="translation")["translation"]
    np.testing.assert_allclose(gradient, columns[0, :3], rtol=0, atol=1e-12 * scale)
    tip = float(solution.rod(0, nodes=2).arclength[1])
    meeting, there = solution.jacobian("translation", of="position", at=(0.16, tip))
    np.testing.assert_allclose(there[:, 1:], columns[:3, 1:3], rtol=0, atol=1e-7 * scale)  # at the first one's tip, not with it
    before = solution.jacobian("translation", of="position", at=0.16 - 1e-6)
    np.testing.assert_allclose(meeting, before, rtol=0, atol=1e-4 * scale)


def test_of_a_batch_only_those_whose_ends_meet_are_asked_beside_it():
    """The others, and inputs that move no end, are bitwise as if all ends were apart."""
    robot, met = tubes_that_meet()
    apart = np.array(MET["translation"]) - (0, 0, 1e-3)
    both = mr.solve(robot, robot.inputs(**MET | {"translation": np.stack([met.translation, apart])}), solver=SOLVER)
    found = both.jacobian("translation")
    beside = mr.solve(robot, robot.inputs(**MET | {"translation": met.translation - (0, 0, 1e-6)}), solver=SOLVER)
    np.testing.assert_allclose(found[0], beside.jacobian("translation"), rtol=0, atol=1e-4 * np.abs(found).max())
    problem = robot.problem(both.inputs, integrator=SOLVER.integrator, **robot.input_directions("translation"))
    before = problem.read("inputs")
    assert not problem.part_ends(("rotation", "tip_force")).any()
    np.testing.assert_array_equal(problem.read("inputs"), before)
    np.testing.assert_array_equal(problem.part_ends(("translation",)) > 0, [True, False])
    np.testing.assert_array_equal(problem.read("inputs")[1], before[1])


def test_a_sample_that_carries_columns_has_those_of_one_side():
    robot, inputs = tubes_that_meet()
    solution = mr.solve(robot, inputs, solver=SOLVER)
    sample = mr.Tracker(robot, solver=SOLVER, inputs=inputs, jacobian="translation").step()
    found, expected = sample.jacobian("translation"), solution.jacobian("translation")
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def stepped_rod(lengths):
    sections = [
        mr.Section(length=length, bending_stiffness=EI, torsional_stiffness=0.8 * EI, precurvature=bend)
        for length, EI, bend in zip(lengths, (0.2, 0.1), ((0, 1, 0), (0, -3, 1)), strict=True)
    ]
    return mr.Rod(sections=sections)


STEPPED = {
    "alone": lambda lengths: mr.SingleRod(stepped_rod(lengths)),
    "held": lambda lengths: mr.HeldRod(
        stepped_rod(lengths), end=[[1, 0, 0, 0.05], [0, 1, 0, 0.02], [0, 0, 1, 0.37], [0, 0, 0, 1]]
    ),
    "a leg": lambda lengths: mr.ParallelRods(legs=[stepped_rod(lengths)] * 2, base=LEGS, platform=LEGS),
}
LEGS = np.tile(np.eye(4), (2, 1, 1))
LEGS[:, 0, 3] = -0.1, 0.1


@pytest.mark.parametrize("kind", STEPPED)
def test_a_load_may_jump_where_a_section_ends(kind):
    """The section moves, the load stays: of one node for both, the load moved too, and the columns were a third off. Differences
    of the second order, at steps by which those of 2e-4 and 1e-4 agree to 1e-6."""

    def step(s):
        return (2.0, 0.5, 0.0) if s >= 0.1 else (0.0, 0.0, 0.0)

    def solved(longer=(0.0, 0.0), translation=0.0):
        robot = STEPPED[kind]((0.1 + longer[0], 0.3 + longer[1]))
        return mr.solve(robot, robot.inputs(distributed_force=step, translation=translation), solver=SOLVER)

    def shape(solution):
        return solution.along(0.2, rod=0)

    h, here = 1e-4, solved()
    ways = {"translation": [solved(translation=h), solved(translation=-h)]}
    ways["length"] = [solved(longer=(h, 0)), solved(longer=(-h, 0))]
    for name, (more, less) in ways.items():
        found = here.jacobian(name, of="position", at=0.2, rod=0)
        found = found.sum(axis=-1) if name == "translation" else found[:, 0::2].sum(axis=-1)  # of all rods alike
        np.testing.assert_allclose(found, (shape(more) - shape(less)) / (2 * h), rtol=0, atol=2e-5 * np.abs(found).max())
    if kind == "alone":
        sample = mr.Tracker(STEPPED[kind]((0.1, 0.3)), solver=SOLVER, inputs=here.inputs, jacobian="translation").step()
        np.testing.assert_allclose(sample.jacobian("translation"), here.jacobian("translation"), rtol=0, atol=1e-8)


def test_the_law_of_precurvature_moves_with_its_section():
    """(D3) A section that bends more and more begins further on where the one before it is longer."""

    def solved(length):
        bent = mr.Section(length=0.15, bending_stiffness=0.2, torsional_stiffness=0.07, precurvature=lambda s: (60 * s, 4, 1))
        first = mr.Section(length=length, bending_stiffness=0.22, torsional_stiffness=0.064, precurvature=(14, 5, 1))
        robot = mr.SingleRod(mr.Rod(sections=[first, bent]))
        return mr.solve(robot, robot.inputs(rotation=0.3, **LOADS), solver=SOLVER)

    expected = WEIGHTS @ np.array([solved(0.25 + 1e-3 * k).tip_position for k in NODES]) / 1e-3
    found = solved(0.25).jacobian("length")[:3, 0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_at_the_tip_it_is_that_of_the_pose_and_several_places_are_those_alone(bent):
    names = ("tip_force", "length", "base")
    pose = bent.jacobian(*names)
    places = bent.jacobian(*names, of="position", at=(0.1, 0.4))
    moving = bent.rod().rotation[-1, :, 2]  # a longer rod has its tip further on, and the same place where it was
    beyond = np.zeros(pose.shape[1])
    beyond[3:5] = 1.0
    np.testing.assert_allclose(places[1] + moving[:, None] * beyond, pose[:3], rtol=0, atol=1e-8)
    np.testing.assert_allclose(places[0], bent.jacobian(*names, of="position", at=0.1), rtol=0, atol=1e-8)
    turned = bent.jacobian("tip_force", "base", of="rotation", at=0.4)
    np.testing.assert_allclose(turned, bent.jacobian("tip_force", "base")[3:], rtol=0, atol=1e-8)


def test_a_transposed_product_is_that_of_the_columns(bent):
    robot = bent.assembly
    several = mr.solve(robot, robot.inputs(rotation=0.3, tip_force=[(0.05, 0.1, 0.1), (0, 0, 0.2)]), solver=SOLVER)
    c = np.array([(1.0, 2, -1, 0.3, 0.1, 0.2), (0, 1, 0, 0, 0, 1)])
    names = ("precurvature", "rotation", "follower_force")
    found = several.vjp(c, wrt=names)
    expected = np.einsum("bc,bck->bk", c, several.jacobian(*names))
    np.testing.assert_allclose(np.concatenate([found[name] for name in names], axis=1), expected, rtol=0, atol=1e-12)
    alone = bent.vjp((1.0, 2, -1), of="tip_position", wrt="rotation")["rotation"]
    np.testing.assert_allclose(alone, np.array([1.0, 2, -1]) @ bent.jacobian("rotation")[:3], rtol=0, atol=1e-12)


def test_what_is_known_by_its_unknowns_makes_no_segments(bent, monkeypatch):
    """These take four times as long as the derivatives of a rod themselves."""
    monkeypatch.setattr(BackboneProblem, "segments", property(lambda problem: pytest.fail("segments were made")))
    assert np.isfinite(bent.jacobian("tip_force")).all()
    assert np.isfinite(bent.vjp((1, 0, 0), of="tip_position", wrt="tip_force")["tip_force"]).all()


def test_the_stiffness_undoes_the_compliance_and_is_symmetric(bent):
    """Where no moment acts on the tip: rotation vectors and a force that is fixed in the world."""
    compliance = bent.jacobian("tip_force", "tip_moment")
    np.testing.assert_allclose(bent.stiffness @ compliance, np.eye(6), rtol=0, atol=1e-9)
    np.testing.assert_allclose(bent.stiffness, bent.stiffness.T, rtol=0, atol=1e-8 * np.abs(bent.stiffness).max())


def test_where_no_load_moves_the_end_the_stiffness_is_said_to_be_infinite():
    """Along a straight rod that does not stretch, however it is turned; beside it a bent one, whose stiffness is finite."""
    base = np.eye(4)
    base[:3, :3] = [(0, 0, 1), (1, 0, 0), (0, 1, 0)]  # z along x
    rod = mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814)
    robot = mr.SingleRod(rod, base=base)
    both = mr.solve(robot, robot.inputs(tip_force=[(0, 0, 0), (0, 0, 0.3)]), solver=SOLVER)
    with pytest.warns(RuntimeWarning, match=r"of 1 of 2 instances is NaN: .* along \(1.0, 0.0, 0.0\) N .*\('tip_force', 'tip_m"):
        stiffness = both.stiffness
    assert np.isnan(stiffness[0]).all()
    assert np.isfinite(stiffness[1]).all()
    compliance = both.jacobian("tip_force", "tip_moment")
    np.testing.assert_allclose(compliance[0] @ (1, 0, 0, 0, 0, 0), 0, atol=1e-15)


def test_the_stiffness_of_a_platform_is_about_its_origin_wherever_forces_act():
    rod = mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814)
    angles = 2 * np.pi * np.arange(3) / 3

    def circle(radius):
        poses = np.tile(np.eye(4), (3, 1, 1))
        poses[:, :2, 3] = radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return poses

    robot = mr.ParallelRods(legs=[rod] * 3, base=circle(0.05), platform=circle(0.03))
    centre = mr.solve(robot, robot.inputs(translation=(0.01, 0, 0), tip_force=(0, 0, 0)))
    aside = mr.solve(robot, robot.inputs(translation=(0.01, 0, 0), tip_force=(0, 0, 0), force_point=(0.02, 0.01, 0)))
    np.testing.assert_allclose(aside.stiffness, centre.stiffness, rtol=0, atol=1e-9 * np.abs(centre.stiffness).max())


def test_a_moved_base_carries_the_robot_and_leaves_the_loads(bent, make_pose):
    expected = []
    for k in range(6):
        poses = [make_pose(*np.split(np.eye(6)[k] * 1e-2 * node, 2)[::-1]) for node in NODES]
        robot = mr.SingleRod(bent.assembly.rods[0], base=np.array(poses))
        varied = mr.solve(robot, robot.inputs(rotation=0.3, **LOADS), solver=SOLVER)
        moved = np.einsum("n,nc->c", WEIGHTS, varied.tip_position) / 1e-2
        turned = np.einsum("n,nij,lj->il", WEIGHTS, varied.tip_rotation, bent.tip_rotation) / 1e-2
        expected.append([*moved, turned[2, 1], turned[0, 2], turned[1, 0]])
    np.testing.assert_allclose(bent.jacobian("base"), np.transpose(expected), rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.jacobian("precurvatur"), "did you mean 'precurvature'"),
        (lambda s: s.jacobian("platform"), "jacobian.name. takes no 'platform'"),
        (lambda s: s.jacobian("rotation", of="curvature"), "at = None is not allowed: must be an arclength"),
        (lambda s: s.jacobian("rotation", of="curvature", at=0.5), "must be >= 0 and <= 0.4 m"),
        (lambda s: s.jacobian("rotation", of="position", at=(0.2, 0.1)), "must be one arclength or several, rising"),
        (lambda s: s.jacobian("rotation", at=0.1), "must not be given of pose"),
        (lambda s: s.along(0.5), "must be >= 0 and <= 0.4 m"),
        (lambda s: s.along(-0.1), "must be >= 0 and <= 0.4 m"),
        (lambda s: s.along((0.2, 0.1)), "must be one arclength or several, rising"),
        (lambda s: s.along(0.1, of="pose"), "of = 'pose'"),
        (lambda s: s.along(0.1, rod=1), "rod = 1"),
        (lambda s: s.jacobian("rotation", rod=0), "must not be given of pose"),
        (lambda s: s.vjp((1, 2), wrt="rotation"), "cotangent"),
        (lambda s: s.vjp((1, 2, 3), of="tip", wrt="rotation"), "of = 'tip'"),
    ],
)
def test_what_cannot_be_asked_for_is_said(bent, call, message):
    with pytest.raises((TypeError, ValueError), match=message):
        call(bent)


def test_what_is_not_known_is_refused(wire):
    robot = mr.SingleRod(mr.Rod(sections=wire.sections, lines=[mr.Tendon(offset=(0.01, 0))]))
    solution = mr.solve(robot, robot.inputs(), solver=SOLVER)
    with pytest.raises(NotImplementedError, match="derivatives by length of a rod with lines"):
        solution.jacobian("length")
