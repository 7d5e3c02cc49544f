"""What a result, inputs, a rod or a robot hands out cannot be written to; what they were made of may change afterwards."""

import pickle
from collections.abc import Iterator

import numpy as np
import pytest

import multirod as mr

INTEGRATOR = mr.RK4(50)
NEWTON = mr.Shooting(integrator=INTEGRATOR)
OBSERVER = mr.Observer(integrator=INTEGRATOR)
FORCE = (0.5, 1.0, 0.3)
TIME = 0.005 * np.arange(3)


def arrays_of(thing: object) -> Iterator[tuple[str, np.ndarray]]:
    """Every array among its public attributes; those that it does not have are passed over."""
    for name in (*dir(thing), *(thing.given if isinstance(thing, mr.Inputs) else ())):
        if not name.startswith("_"):
            try:
                value = getattr(thing, name)
            except AttributeError:
                continue
            if isinstance(value, np.ndarray):
                yield name, value


def solution(robot: mr.Assembly, batch: bool) -> mr.Solution:
    force = [FORCE, (0, 0, 0.1)] if batch else FORCE
    return mr.solve(robot, robot.inputs(tip_force=force), solver=NEWTON)


def tracked(robot: mr.Assembly, solver: mr.Solver) -> mr.Solution:
    return mr.Tracker(robot, solver=solver, dt=0.005, inputs=robot.inputs(tip_force=FORCE)).step()


def history(robot: mr.Assembly) -> mr.History:
    inputs = robot.inputs(tip_force=np.linspace(0, 1, 3)[:, None] * FORCE)
    return mr.simulate(robot, inputs, time=TIME, solver=OBSERVER)


def failed(robot: mr.Assembly) -> mr.Solution:
    return mr.solve(
        robot, robot.inputs(tip_force=[FORCE, (0, 0, 0)]), solver=mr.Observer(integrator=INTEGRATOR, max_iterations=20)
    )


HANDED_OUT = {
    "solution": lambda robot: solution(robot, batch=False),
    "batch": lambda robot: solution(robot, batch=True),
    "part of a batch": lambda robot: solution(robot, batch=True)[0],
    "failed": failed,
    "Newton's sample": lambda robot: tracked(robot, NEWTON),
    "observer's sample": lambda robot: tracked(robot, OBSERVER),
    "history": history,
    "shape": lambda robot: solution(robot, batch=True).rod(0, nodes=7),
    "inputs": lambda robot: robot.inputs(rotation=0.1, tip_force=[FORCE, FORCE]),
    "inputs of a solution": lambda robot: solution(robot, batch=True)[1].inputs,
    "robot": lambda robot: robot,
    "lowered robot": lambda robot: robot.arrays,
    "section": lambda robot: robot.rods[0].sections[0],
    "rod": lambda robot: robot.rods[0],
    "profile": lambda robot: robot.inputs(distributed_force=lambda s: (s, 0, 0)).profile("distributed_force"),
    "unpickled profile": lambda robot: pickle.loads(
        pickle.dumps(robot.inputs(distributed_force=lambda s: (s, 0, 0)).profile("distributed_force"))
    ),
    "critical load": lambda robot: mr.critical_loads(column(), column().inputs(tip_force=(0, 0, -1.0)))[0],
    "solver": lambda robot: mr.Observer(R=np.eye(3), Q=[[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
}


def column() -> mr.SingleRod:
    return mr.SingleRod(mr.Rod(length=0.5, bending_stiffness=0.02, torsional_stiffness=0.015))


@pytest.mark.parametrize("name", HANDED_OUT)
def test_arrays_that_are_handed_out_are_read_only(robot: mr.SingleRod, name: str) -> None:
    found = dict(arrays_of(HANDED_OUT[name](robot)))
    assert found or name == "robot"
    writable = [field for field, value in found.items() if value.flags.writeable]
    assert not writable


WRITTEN = {
    "inputs": ("tip_force", "tip_forse", "given", "batch_shape"),
    "solution": ("tip_position", "status", "unknowns", "energy", "inputs", "anything"),
    "part of a batch": ("tip_position", "stability"),
    "history": ("time", "tip_position", "anything"),
    "Newton's sample": ("tip_position", "columns"),
    "robot": ("base", "rods", "arrays", "batch_shape"),
    "rod": ("sections", "length", "bending_stiffness", "name"),
}


@pytest.mark.parametrize("name", ["kind", "stiffness", "pose"])
def test_a_joint_is_not_written_to(name: str) -> None:
    joint = mr.Joint("wire", "tip", to=mr.Body("plate"))
    with pytest.raises(AttributeError, match=rf"Joint\.{name} = \.\.\. is not allowed: .*make another Joint"):
        setattr(joint, name, np.zeros(3))


@pytest.mark.parametrize("name", ["mass", "pose", "name"])
def test_a_body_is_not_written_to(name: str) -> None:
    body = mr.Body("plate", mass=0.1)
    with pytest.raises(AttributeError, match=rf"Body\.{name} = \.\.\. is not allowed: .*make another Body"):
        setattr(body, name, 5.0)
    assert body.mass == 0.1


LINES = {
    "tendon": (lambda: mr.Tendon((0.01, 0)), ("offset", "end", "friction", "discs", "tension")),
    "rubbing tendon": (lambda: mr.Tendon((0.01, 0), friction=0.1), ("friction", "name")),
    "tendon of given length": (
        lambda: mr.Tendon((0.01, 0), driven="displacement", axial_stiffness=300.0),
        ("axial_stiffness", "rest_length", "driven"),
    ),
    "push rod": (lambda: mr.PushRod((0.01, 0), bending_stiffness=1e-3), ("bending_stiffness", "offset", "condition")),
    "chamber": (lambda: mr.Chamber((0.01, 0), area=2e-5), ("area", "weight", "start")),
}


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, (_, names) in LINES.items() for name in names])
def test_a_line_is_not_written_to(kind: str, name: str) -> None:
    """Neither by itself nor in its rod, which has a copy that knows of the rod."""
    line = LINES[kind][0]()
    rod = mr.Rod(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, lines=[line])
    for own in (line, rod.lines[0]):
        before = repr(getattr(own, name, None))
        with pytest.raises(AttributeError, match=rf"\.{name} = \.\.\. is not allowed: .*make another line"):
            setattr(own, name, 0.5)
        assert repr(getattr(own, name, None)) == before


@pytest.mark.parametrize(("thing", "name"), [(thing, name) for thing, names in WRITTEN.items() for name in names])
def test_nothing_is_written_to(robot: mr.SingleRod, thing: str, name: str) -> None:
    """It would be told, and not used: what was computed does not change with it."""
    made = HANDED_OUT[thing](robot)
    before = repr(made), repr(getattr(made, name, None))
    with pytest.raises(AttributeError, match=rf"{type(made).__name__}\.{name} = \.\.\. is not allowed: it does not change"):
        setattr(made, name, np.zeros(3))
    assert (repr(made), repr(getattr(made, name, None))) == before


def test_what_is_computed_on_demand_is_read_only(robot: mr.SingleRod) -> None:
    found = solution(robot, batch=True)
    for values in (found.jacobian("tip_force"), found.jacobian("follower_force"), found.energy, found.unknowns):
        with pytest.raises(ValueError, match="read-only"):
            values += 3
    with pytest.raises(TypeError):
        robot.inputs(distributed_force=lambda s: (s, 0, 0)).profiles["tip_force"] = None  # type: ignore[index]


def test_a_guess_made_of_a_solution_leaves_it_as_it_is(robot: mr.SingleRod) -> None:
    found = solution(robot, batch=False)
    tip, guess = np.array(found.tip_position), found.unknowns
    with pytest.raises(ValueError, match="read-only"):
        guess += 3
    guess = found.unknowns + 3
    np.testing.assert_allclose(found.rod().position[-1], tip, rtol=0, atol=1e-9)
    again = mr.solve(robot, found.inputs, solver=NEWTON, guess=guess)
    np.testing.assert_allclose(again.tip_position, tip, rtol=0, atol=1e-9)


def test_poses_of_parallel_rods_are_read_only(wire: mr.Rod) -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 0.1
    given = poses.copy()
    robot = mr.ParallelRods(legs=[wire, wire], base=given, platform=given, joints="revolute")
    for name, value in arrays_of(robot.geometry):
        assert not value.flags.writeable, name
    given[:] = 0
    np.testing.assert_array_equal(robot.geometry.base, poses)


def test_what_things_are_made_of_may_change_afterwards(wire: mr.Rod) -> None:
    """Arrays are copied where they are given: a caller may use his buffers again."""
    made = {
        "length": np.array(0.4),
        "bending_stiffness": np.array([0.2, 0.3]),
        "torsional_stiffness": np.array(0.06),
        "precurvature": np.array([3.0, 1.0, 0.0]),
    }
    base, force, time = np.eye(4), np.tile(FORCE, (3, 1)) * 1.0, np.array(TIME)
    rotation, gain = np.array([0.1]), np.diag([100.0, 120.0, 140.0])
    robot = mr.SingleRod(mr.Rod(**made), base=base)
    inputs = robot.inputs(tip_force=force, rotation=rotation)
    solver = mr.Observer(R=gain, integrator=INTEGRATOR)
    first = robot.inputs(tip_force=FORCE, rotation=0.1)
    guess = np.array(mr.solve(robot, first, solver=NEWTON).unknowns)
    start = mr.Tracker(robot, solver=solver, dt=0.005, inputs=first, guess=guess)
    expected = mr.simulate(robot, inputs, time=time, solver=solver, guess=guess)
    tip, energy = np.array(expected.tip_position), np.array(expected.energy)
    kept = guess.copy()
    for buffer in (*made.values(), base, force, time, rotation, gain, guess):
        buffer[...] = 7.0
    again = mr.simulate(robot, inputs, time=TIME, solver=solver, guess=kept)
    assert np.array_equal(again.tip_position, tip)
    assert np.array_equal(expected.energy, energy)
    assert np.array_equal(expected.time, TIME)
    assert np.array_equal(start.step().unknowns, kept)


def test_statuses_of_a_batch_have_names_and_refuse_strings():
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))
    for found, kind in ((solution(robot, batch=True).status, mr.Status), (solution(robot, batch=True).stability, mr.Stability)):
        name = kind(1).name
        assert found[0].name == name
        assert str(found) == f"[{name} {name}]"
        assert type(found == kind(1)) is np.ndarray
        assert (found == kind(1)).all()
        assert str(pickle.loads(pickle.dumps(found))) == str(found)
        for compare in (lambda a, b: a == b, lambda a, b: b != a, lambda a, b: b in a, lambda a, b: a == [b, b]):
            with pytest.raises(TypeError, match=f"a {kind.__name__} is compared with a {kind.__name__}, not with '{name}'"):
                compare(found, name)
        with pytest.raises(TypeError, match=f"a {kind.__name__} is neither true nor false"):
            bool(found[0])
        with pytest.raises(AttributeError, match=r"\[k\]\.name"):
            _ = found.name


@pytest.mark.parametrize("solver", [NEWTON, mr.Observer(integrator=INTEGRATOR)], ids=["Newton", "observer"])
def test_what_failed_is_no_guess(solver):
    """Each instance starts as it would alone: by bits from its guess, or without one."""
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0)))
    lost = failed(robot)
    assert lost.failed.any()
    inputs = lost.inputs
    found = mr.solve(robot, inputs, solver=solver, guess=lost).raise_if_failed()
    alone = mr.solve(robot, inputs, solver=solver)
    np.testing.assert_array_equal(found.unknowns[lost.failed], alone.unknowns[lost.failed])
    tracker = mr.Tracker(robot, solver=solver, dt=0.005, inputs=inputs, guess=lost)
    for _ in range(2):
        assert not tracker.step().failed.any()
