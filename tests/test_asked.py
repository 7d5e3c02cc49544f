"""What is asked of results and inputs that they have not is refused by a message that says what to ask instead."""

import re
from dataclasses import replace

import numpy as np
import pytest

import multirod as mr


@pytest.fixture(scope="module")
def robot():
    return mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638))


@pytest.fixture(scope="module")
def one(robot):
    return mr.solve(robot, robot.inputs(tip_force=(0.1, 0, 0)))


@pytest.fixture(scope="module")
def batch(robot):
    return mr.solve(robot, robot.inputs(tip_force=[(0.1, 0, 0), (0.2, 0, 0)]))


@pytest.fixture(scope="module")
def make_tube():
    stuff = {"young_modulus": 60e9, "shear_modulus": 23e9, "precurvature": (0, 5, 0)}
    return lambda length, outer: mr.Rod.tube(length=length, outer_diameter=outer, inner_diameter=outer - 1e-3, **stuff)


def refused(kind, *said):
    return pytest.raises(kind, match=".*".join(map(re.escape, said)))


def test_no_result_is_true_or_false(robot, one, batch):
    motion = mr.simulate(robot, robot.inputs(tip_force=[(0.1, 0, 0), (0.2, 0, 0)]), time=[0.0, 0.1])
    others = (kind.__new__(kind) for kind in (mr.Estimate, mr.Calibration))  # whatever they hold
    for result in (one, batch, motion, *others):
        name = type(result).__name__
        for asked in (bool, lambda own: not own, lambda own: own or None):
            with refused(TypeError, f"{name} is neither true nor false: ask its .failed", ".status", ".raise_if_failed()"):
                asked(result)


def test_what_has_no_instances_to_choose_from_says_so(robot, one):
    for own in (one, one.inputs, robot.inputs()):
        name = type(own).__name__
        with refused(IndexError, f"{name}[0] is not allowed: this {name} is of one instance, without leading axes"):
            own[0]


def test_an_index_beyond_a_batch_names_its_axes(batch):
    for own in (batch, batch.inputs):
        name = type(own).__name__
        with refused(IndexError, f"{name}[5] is not allowed: its leading axes are (2,); index 5 is out of bounds"):
            own[5]
        with refused(IndexError, f"{name}[(0, 0)] is not allowed: its leading axes are (2,); too many indices"):
            own[0, 0]


def test_a_name_is_no_index(one, batch):
    for own, name in ((batch, "tip_position"), (one, "tip_position"), (one.inputs, "tip_force"), (batch.inputs, "tip_force")):
        with refused(IndexError, f"{type(own).__name__}[{name!r}] is not allowed: ", f"asked by name, .{name}"):
            own[name]


def test_indices_of_batches_choose_what_they_did(batch):
    np.testing.assert_array_equal(batch[1].tip_position, batch.tip_position[1])
    np.testing.assert_array_equal(batch[[True, False]].tip_position, batch.tip_position[:1])
    np.testing.assert_array_equal(batch.inputs[::-1].tip_force, batch.inputs.tip_force[::-1])
    assert batch[...].batch_shape == (2,)


def test_which_of_a_batch_is_pulled_in_too_far_is_said(robot):
    pushed = np.zeros((120, 1))
    pushed[100] = -2.0 * robot.longest
    with pytest.raises(ValueError, match=r"translation = -\S+ at \[100\] of shape \(120,\) .*no rod is left in use"):
        robot.inputs(translation=pushed)


def test_statuses_of_a_batch_are_counted(batch):
    assert batch.status.counts() == {mr.Status.CONVERGED: batch.status.size}
    mixed = type(batch.status).of(np.array([[1, 7], [1, 1]], dtype=np.int32))
    assert mixed.counts() == {mr.Status.CONVERGED: 3, mr.Status.BRANCH_END: 1}
    assert [code.name for code in mixed.counts()] == ["CONVERGED", "BRANCH_END"]
    with pytest.raises(AttributeError, match=r"did you mean status.counts\(\), of a batch"):
        _ = batch.counts


def test_shapes_are_not_indexed_their_arrays_are(batch):
    shape = batch.rod(0)
    with refused(TypeError, "Shape[1] is not allowed: index one of its arrays, such as .position, or the solution"):
        shape[1]
    with refused(TypeError, "Shape['position'] is not allowed: what it has is asked by name, .position"):
        shape["position"]
    with pytest.raises(TypeError, match="not iterable"):
        iter(shape)


def test_inputs_are_named(robot):
    hint = "inputs are named, robot.inputs(tip_force=(1, 0, 0)); print(robot.input_specs) lists them"
    with refused(TypeError, "inputs() takes 1 positional argument but 2 were given: ", hint):
        robot.inputs((1, 0, 0))
    with refused(TypeError, "inputs() takes no 'force'", "did you mean 'tip_force'?"):
        robot.inputs(force=(1, 0, 0))


def test_inputs_of_other_robots_say_whose_they_are(robot):
    with refused(TypeError, "takes no 'end_rotation'", "a HeldRod takes it"):  # not a hint at 'rotation', which is alike
        robot.inputs(end_rotation=(0, 0, 0.1))
    circle = [mr.Pose(position=(*at, 0), rotation=np.eye(3)) for at in ((0.1, 0), (-0.1, 0), (0, 0.1))]
    legs = mr.ParallelRods(legs=robot.rods * 3, base=circle, platform=circle)
    for name in ("platform_position", "platform_rotation"):
        with refused(TypeError, f"takes no {name!r}", "the inverse problem of six legs takes it, robot.inverse()"):
            legs.inputs(**{name: (0, 0, 0.39)})
    with refused(TypeError, "unexpected keyword argument 'tip_force': a robot makes them", "robot.inputs(tip_force="):
        mr.Inputs(tip_force=(1, 0, 0))


@pytest.mark.parametrize("kind", [mr.Shooting, mr.Observer, mr.EnergyDescent, mr.MultipleShooting, mr.ScipyShooting])
def test_solvers_have_integrators_that_have_steps(kind):
    with refused(TypeError, "argument 'steps'", "integrator=RK4(100)", "did you mean 'integrator'?"):
        kind(steps=100)
    with refused(TypeError, "argument 'tol'", "did you mean 'tolerance'?"):
        kind(tol=1e-9)
    assert replace(kind(), integrator=mr.RK4(7)).integrator.steps == 7


def test_options_that_are_not_there_say_which_are(robot, one):
    with refused(TypeError, "argument 'wrt'", 'what it is by comes first, jacobian("rotation", "tip_force")'):
        one.jacobian(wrt="rotation")
    with refused(TypeError, "3 were given", 'vjp(cotangent, wrt=("rotation", "tip_force"))'):
        one.vjp((1, 0, 0), "rotation")
    with refused(TypeError, "simulate() takes no 'dt'", "did you mean 'time'?"):
        mr.simulate(robot, robot.inputs(), dt=0.1)
    with refused(TypeError, "Tracker() takes no 'rate'", "did you mean 'dt'?"):
        mr.Tracker(robot, rate=500)
    with refused(TypeError, "estimate() takes no 'unknowns'", "did you mean 'unknown'?"):
        mr.estimate(robot, unknowns={}, measured=mr.Pose(position=(0, 0, 0.4), sigma=1e-3))


def test_what_guesses_may_be(robot, one, make_tube):
    with refused(ValueError, "guess = 'last' is not allowed: must be numeric, a Solution or its unknowns, shape (..., 3)"):
        mr.solve(robot, one.inputs, guess="last")
    tubes = mr.ConcentricTubes([make_tube(0.4, 3e-3), make_tube(0.2, 5e-3)])
    given = "guess = a Solution of SingleRod that has 3 unknowns is not allowed: must be of this robot, which has 1 here"
    with refused(ValueError, given):
        mr.solve(tubes, guess=one)


def test_places_along_a_rod_are_told(one):
    with refused(ValueError, "at = 'tip' is not allowed: must be numeric, an arclength along the rod [m], or several, rising"):
        one.along("tip")


def test_names_of_derivatives_come_one_after_another(one):
    for given in (("tip_force", "tip_moment"), ["tip_force", "tip_moment"]):
        with refused(TypeError, f"takes no {given!r}: give the names one after another, 'tip_force', 'tip_moment'"):
            one.jacobian(given)


def test_numbers_of_a_rod_are_its_sections(make_tube):
    tube = make_tube(0.4, 3e-3)
    for name in ("bending_stiffness", "precurvature", "linear_density", "foundation"):
        assert np.shape(getattr(tube.sections[0], name)) is not None
        with refused(AttributeError, f"Rod has no {name!r}: its sections have, rod.sections[0].{name}"):
            getattr(tube, name)
    for name, instead in (("young_modulus", "bending_stiffness"), ("density", "linear_density")):
        with refused(AttributeError, f"Rod has no {name!r}: it keeps what follows from it, such as rod.sections[0].{instead}"):
            getattr(tube, name)
    for name, meant in (("EI", "bending_stiffness"), ("stiffness", "bending_stiffness"), ("diameter", "outer_diameter")):
        with refused(AttributeError, f"Rod has no {name!r}; did you mean {meant!r}?"):
            getattr(tube, name)
    assert not hasattr(tube, "colour")


@pytest.mark.parametrize(
    ("other", "meant"),
    [("hinge", "revolute"), ("ball", "spherical"), ("fixed", "clamped"), ("cardan", "universal"), ("slider", "prismatic")],
)
def test_joints_under_other_names(other, meant):
    with refused(ValueError, f"Joint.kind = {other!r} is not allowed", f"did you mean {meant!r}?"):
        mr.Joint("arm", "base", to=mr.ground, kind=other)


def test_a_pull_has_no_critical_load_and_a_push_to_the_side_is_not_said_to_be_one(robot):
    said = "no change of stability before that: .*; the loads only stiffen the robot there, as a pull does, so there may be no"
    with pytest.raises(mr.SolveError, match=said):
        mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, 20)))
    with pytest.raises(mr.SolveError) as told:
        mr.critical_loads(robot, robot.inputs(tip_force=(0.05, 0, -5)), max_steps=8)
    assert "no change of stability" in str(told.value)
    assert "stiffen" not in str(told.value)


def test_a_load_that_what_holds_the_end_takes_does_nothing():
    rod = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638)
    held, column = mr.HeldRod(rod), mr.HeldRod(rod, slide=(0, 0, 1))
    said = r"does nothing: what holds the end takes it; "
    with pytest.warns(mr.PlausibilityWarning, match=r"tip_force = 5 N " + said + r"HeldRod\(slide=\(0, 0, 1\)\) lets it act"):
        held.inputs(tip_force=(0, 0, -5), tip_moment=(0, 0, 0.1))
    with pytest.warns(mr.PlausibilityWarning, match=r"tip_moment = 0.1 N m " + said + r'HeldRod\(joint="revolute"'):
        twisted = column.inputs(tip_moment=(0, 0, 0.1))
    for inputs in (held.inputs(tip_force=(0, 0, 0)), held.inputs(end_position=(0, 0, -0.01), tip_force=(0, 0, -5))):
        assert inputs.given  # without a warning
    column.inputs(tip_force=(0, 0, -5))
    with pytest.raises(
        mr.SolveError, match=r"nothing changes up to a load factor of .*: what is raised does not act on the robot"
    ):
        mr.critical_loads(column, twisted)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("platform_position", "tip_position"),
        ("leg", "rod(0)"),
        ("leg_forces", 'wrench(leg, "tip")'),
        ("is_stable", "stability"),
        ("displacement", "line_length"),
        ("translations", "inputs.translation"),
        ("compliance", 'jacobian("tip_force")'),
        ("to_pandas", "to_xarray().to_dataframe()"),
    ],
)
def test_what_a_solution_is_asked_under_other_names(one, name, meant):
    with refused(AttributeError, f"Solution has no {name!r}; did you mean ", meant):
        getattr(one, name)


def test_what_a_robot_and_a_shape_are_asked_under_other_names(robot, one):
    for own, name, meant in (
        (robot, "solve", "mr.solve(robot, inputs)"),
        (robot, "tip_position", "that of mr.solve(robot, inputs)"),
        (robot, "ik", "mr.reach(robot, "),
        (robot, "length", "rods, each"),
        (one.rod(0), "x", "position, whose last axis is x, y, z"),
        (one.rod(0), "u", "curvature"),
    ):
        with refused(AttributeError, f"{type(own).__name__} has no {name!r}; did you mean {meant}"):
            getattr(own, name)
        assert not hasattr(own, "colour")


def test_what_the_package_is_asked_under_other_names():
    for name, meant in (("TendonRobot", "mr.SingleRod(mr.Rod(..., lines="), ("workspace", "of a batch of inputs")):
        with refused(AttributeError, f"module 'multirod' has no attribute {name!r}; did you mean ", meant):
            getattr(mr, name)


def test_components_of_a_batch_are_stacked(robot):
    many, stacked = np.linspace(0, 1, 9), "np.stack(np.broadcast_arrays(...), axis=-1)"
    with refused(ValueError, "tip_force = ", "must be numeric, shape (..., 3); of a batch (9,), ", stacked):
        robot.inputs(tip_force=(many, 0, 0))
    with refused(ValueError, "must have shape (..., 3); one number of each has no direction: of a batch, np.stack("):
        robot.inputs(tip_force=many)
    pair = mr.ConcentricTubes([mr.Rod(length=0.4, bending_stiffness=0.02, torsional_stiffness=0.015)] * 2)
    with refused(ValueError, "rotation = ", "must be numeric", stacked):
        pair.inputs(rotation=(many, 0))
    with refused(ValueError, "tip_force = ['a', 'b', 'c'] is not allowed: must be numeric, shape (..., 3)"):
        robot.inputs(tip_force=["a", "b", "c"])


def test_what_varies_along_a_rod_is_by_section():
    with refused(
        ValueError, "Rod.magnetisation = ", "must be numeric", "is given by sections, Rod(sections=[Section(...), ...])"
    ):
        mr.Rod.wire(
            length=0.08,
            diameter=1e-3,
            young_modulus=3e6,
            poisson_ratio=0.49,
            magnetisation=[(0.07, (0, 0, 0)), (0.01, (0, 0, 1e5))],
        )


def test_a_radius_is_half_a_diameter():
    """Who took the hint at the diameter by its word had a sixteenth of the stiffness."""
    with refused(TypeError, "argument 'radius'", "did you mean 'diameter', twice that?"):
        mr.Rod.wire(length=0.2, radius=5e-4, young_modulus=60e9, poisson_ratio=0.3)


def test_how_files_and_plots_are_had_otherwise(one):
    with refused(ValueError, "must end in", "MATLAB reads .nc, spreadsheets .csv"):
        one.save("result.mat")
    for name, meant in (("legend", "the axes that it returns do"), ("dpi", ".figure.savefig(path)")):
        with refused(TypeError, f"plot() takes no {name!r}", meant):
            one.plot(**{name: None})


def test_options_are_said_to_be_whose_they_are(robot):
    with refused(
        TypeError, "unexpected keyword argument 'tolerance'", "options are the solver's, solver=Shooting(tolerance=1e-9)"
    ):
        mr.solve(robot, tolerance=1e-9)
    with refused(TypeError, "must be a Solver such as Shooting(), not RK4: give it to one, Shooting(integrator=RK4("):
        mr.solve(robot, solver=mr.RK4(50))
    with refused(TypeError, "unexpected keyword argument 'length'", "it is made of a rod, SingleRod(Rod(...)), which has length"):
        mr.SingleRod(length=0.4)
    with refused(TypeError, "inputs() takes no 'leg_lengths'", "did you mean 'translation'?"):
        robot.inputs(leg_lengths=0.4)


@pytest.mark.parametrize("line", [mr.Tendon, mr.PushRod, mr.Chamber])
def test_offsets_are_said_to_be_pairs(line):
    with refused(TypeError, "unexpected keyword argument 'radius': an offset is one pair", "(r*cos(a), r*sin(a))"):
        line(radius=0.008, angle=0.3)


def test_how_lines_are_driven_is_said():
    pulled = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.1, lines=[mr.Tendon((0.01, 0))]))
    with refused(ValueError, "no rod has a line that is driven by it, they are driven by tension (see driven= of Tendon)"):
        pulled.inputs(displacement=1e-3)
