"""Bad input is refused when it is given, by an error that names the field, the value and what is allowed."""

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import multirod as mr

NAN, INF = math.nan, math.inf
PROPERTIES = {"length": 0.4, "bending_stiffness": 0.02, "torsional_stiffness": 0.015}
TUBE = {"length": 0.4, "outer_diameter": 3e-3, "young_modulus": 70e9, "shear_modulus": 27e9}
VECTORS = ("tip_force", "tip_moment", "follower_force", "follower_moment", "distributed_force", "distributed_moment", "gravity")
VECTOR_INPUTS = (*VECTORS, "tip_curvature")
INTEGRATOR = mr.RK4(50)


def refusal(field: str, value: object, allowed: str, error: type[Exception] = ValueError) -> Any:
    """The error of ``validation.refuse`` for exactly this field and value; ``allowed`` is a regex."""
    return pytest.raises(error, match=f"^{re.escape(field)} = {re.escape(repr(value))} is not allowed: .*(?:{allowed})")


# ---- rods ----

POSITIVE = "> 0|number"
NUMBER_FIELDS = {
    "length": (0, -0.4, NAN, INF, "0.4", True, (0.4, -0.1), ["0.4"]),
    "bending_stiffness": (0, -0.02, NAN, INF, "0.02", True, (0.02, 0), (NAN, 0.02), (0.02, INF)),
    "torsional_stiffness": (0, -0.015, NAN, -INF, "0.015", True, (0.015, 0)),
    "shear_stiffness": (0, -130.0, NAN, -INF, "inf", True, (130.0, -1.0)),
    "axial_stiffness": (0, -390.0, NAN, -INF, "inf", True),
}
NUMBER_CASES = [pytest.param(name, value, id=f"{name}={value!r}") for name, values in NUMBER_FIELDS.items() for value in values]


@pytest.mark.parametrize("owner", [mr.Rod, mr.Section])
@pytest.mark.parametrize(("name", "value"), NUMBER_CASES)
def test_lengths_and_stiffnesses_must_be_positive_numbers(owner: Callable[..., Any], name: str, value: Any) -> None:
    with refusal(f"{owner.__name__}.{name}", value, POSITIVE):
        owner(**{**PROPERTIES, name: value})


@pytest.mark.parametrize("owner", [mr.Rod, mr.Section])
@pytest.mark.parametrize("value", [-0.05, NAN, INF, "0.05", True, (0.05, -0.1)], ids=repr)
def test_linear_density_must_not_be_negative(owner: Callable[..., Any], value: Any) -> None:
    with refusal(f"{owner.__name__}.linear_density", value, ">= 0|finite|number"):
        owner(**PROPERTIES, linear_density=value)


@pytest.mark.parametrize("owner", [mr.Rod, mr.Section])
@pytest.mark.parametrize(
    "value",
    [14, (14, 5), (14, 5, 0, 0), (14, NAN, 0), (14, INF, 0), "14 5 0", ("14", "5", "0"), (14, None, 0), [(1, 2), (3, 4)]],
    ids=repr,
)
def test_precurvature_must_be_three_finite_numbers(owner: Callable[..., Any], value: Any) -> None:
    with refusal(f"{owner.__name__}.precurvature", value, "shape|finite|numeric"):
        owner(**PROPERTIES, precurvature=value)


@pytest.mark.parametrize(
    ("function", "value"),
    [
        (lambda s: (1, 2), "(1, 2)"),
        (lambda s: (1, 2, NAN), "(1, 2, nan)"),
        (lambda s: None, "None"),
        (lambda s: "abc", "'abc'"),
    ],
    ids=["two numbers", "NaN", "None", "string"],
)
def test_precurvature_function_must_return_three_finite_numbers(function: Callable[[float], Any], value: str) -> None:
    with pytest.raises(ValueError, match=rf"^Rod\.precurvature\(0\) = {re.escape(value)} is not allowed: .*3 finite numbers"):
        mr.Rod(**PROPERTIES, precurvature=function)


@pytest.mark.parametrize(
    ("sections", "field", "value", "allowed"),
    [
        (
            [(0.3, (0, 0, 0)), (0.2, (1, 0, 0))],
            "Rod.precurvature",
            [(0.3, (0, 0, 0)), (0.2, (1, 0, 0))],
            "add up to length = 0.4",
        ),
        ([(0.5, (0, 0, 0)), (-0.1, (1, 0, 0))], "Rod.precurvature section length", -0.1, "> 0"),
        ([(0.3, (0, 0, 0)), (0.1, (1, 0))], "Rod.precurvature", (1, 0), r"shape \(\.\.\., 3\)"),
    ],
    ids=["sum", "negative", "two numbers"],
)
def test_precurvature_by_section(sections: list, field: str, value: Any, allowed: str) -> None:
    with refusal(field, value, allowed):
        mr.Rod(**PROPERTIES, precurvature=sections)


@pytest.mark.parametrize("missing", PROPERTIES)
def test_rod_needs_its_properties(missing: str) -> None:
    with pytest.raises(TypeError, match=f"Rod needs {missing}"):
        mr.Rod(**{**PROPERTIES, missing: None})
    with pytest.raises(TypeError, match=missing):
        mr.Section(**{name: value for name, value in PROPERTIES.items() if name != missing})


@pytest.mark.parametrize("value", [[], (), "ab", 3, [1], [PROPERTIES]], ids=repr)
def test_sections_must_be_sections(value: Any) -> None:
    with refusal("Rod.sections", value, "non-empty list of Section"):
        mr.Rod(sections=value)


def test_sections_and_properties_exclude_each_other() -> None:
    with pytest.raises(TypeError, match="sections or length, not both"):
        mr.Rod(sections=[mr.Section(**PROPERTIES)], length=0.4)


@pytest.mark.parametrize("name", [None, 3, True, b"wire"], ids=repr)
def test_name_must_be_a_string(name: Any) -> None:
    with refusal("Rod.name", name, "string"):
        mr.Rod(**PROPERTIES, name=name)


def test_what_takes_no_such_argument_says_what_it_takes() -> None:
    with pytest.raises(
        TypeError, match="'wall': an offset is one pair.*; it takes offset, route, area, area_fixed, start, end, name$"
    ):
        mr.Chamber((6e-3, 0), area=2e-5, wall=1e-3)
    with pytest.raises(TypeError, match="'stiffness': an offset is one pair.*; did you mean 'axial_stiffness'\\?$"):
        mr.Tendon((6e-3, 0), stiffness=1.0)
    with pytest.raises(TypeError, match=r"'thickness': .*; Rod.strip\(length=, width=, thickness=, .*rectangular section"):
        mr.Rod(length=0.3, thickness=5e-4)
    rods = [mr.Rod(**PROPERTIES)] * 2
    with pytest.raises(ValueError, match=r"Rod.sections = .* of rods in a row, theirs: \[\*first.sections, \*second.sections\]"):
        mr.Rod(sections=rods)
    assert len(mr.Rod(sections=[*rods[0].sections, *rods[1].sections]).sections) == 2


def test_unknown_property_is_refused() -> None:
    with pytest.raises(TypeError, match="bending_stifness"):
        mr.Rod(**PROPERTIES, bending_stifness=0.02)
    with pytest.raises(TypeError, match="bending_stifness"):
        mr.Section(**PROPERTIES, bending_stifness=0.02)


@pytest.mark.parametrize("field", ["outer_diameter", "inner_diameter"])
@pytest.mark.parametrize("value", [-1e-3, NAN, INF, "1e-3", True, (1e-3, -1e-3)], ids=repr)
def test_diameters(field: str, value: Any) -> None:
    for owner, given in ((mr.Rod, PROPERTIES), (mr.Rod.tube, TUBE)):
        with refusal(f"Rod.{field}", value, "> 0|>= 0|number"):
            owner(**{**given, field: value})


def test_diameters_whose_leading_axes_do_not_broadcast() -> None:
    two, three = [3e-3, 4e-3], [1e-3, 2e-3, 1e-3]
    for owner, given in ((mr.Rod, PROPERTIES), (mr.Rod.tube, TUBE)):
        with refusal("Rod.inner_diameter", three, r"\(3,\) must broadcast with those of outer_diameter, \(2,\)"):
            owner(**{**given, "outer_diameter": two, "inner_diameter": three})
        with pytest.raises(ValueError, match="the batch axes of a (rod's sections and diameters|section's parameters) do not"):
            owner(**{**given, "length": [0.3, 0.4, 0.5], "outer_diameter": two})
    with pytest.raises(ValueError, match=r"young_modulus, shear_modulus and diameters, \(3,\), \(\) and \(2,\), do not"):
        mr.Rod.tube(**{**TUBE, "young_modulus": [7e10, 6e10, 5e10], "outer_diameter": two})
    with pytest.raises(ValueError, match=r"Rod.inner_diameter = \[0.001, 0.004\] is not allowed: .* smaller than outer_diameter"):
        mr.Rod.tube(**{**TUBE, "outer_diameter": two, "inner_diameter": [1e-3, 4e-3]})


@pytest.mark.parametrize("inner", [3e-3, 4e-3])
def test_inner_diameter_must_be_smaller(inner: float) -> None:
    for owner, given in ((mr.Rod, {**PROPERTIES, "outer_diameter": 3e-3}), (mr.Rod.tube, TUBE)):
        with refusal("Rod.inner_diameter", inner, "smaller than outer_diameter"):
            owner(**given, inner_diameter=inner)


@pytest.mark.parametrize(
    ("field", "value"),
    [(field, value) for field in ("young_modulus", "shear_modulus") for value in (0, -1.0, NAN, INF, "70e9", None, True)]
    + [("density", value) for value in (-1.0, NAN, INF, "1", None, True)]
    + [("outer_diameter", 0), ("outer_diameter", None), ("inner_diameter", None)],
)
def test_tube(field: str, value: Any) -> None:
    with refusal(f"Rod.{field}", value, "> 0|>= 0|number"):
        mr.Rod.tube(**{**TUBE, field: value})


@pytest.mark.parametrize("make", [mr.Rod.tube, mr.Rod.wire])
def test_extensible_is_yes_or_no(make: Callable[..., Any]) -> None:
    size = {"outer_diameter": 3e-3} if make == mr.Rod.tube else {"diameter": 3e-3}
    for value in (1, None, "yes", 0.9):
        with refusal("Rod.extensible", value, "True or False"):
            make(length=0.4, young_modulus=70e9, shear_modulus=27e9, **size, extensible=value)


@pytest.mark.parametrize("name", ["torsional_stiffness", "shear_stiffness", "axial_stiffness"])
def test_rigid_is_allowed_where_the_model_has_it(name: str) -> None:
    rod = mr.Rod(**{**PROPERTIES, name: INF})
    assert np.isinf(getattr(rod.sections[0], name)).all()


@pytest.mark.parametrize("owner", [mr.Rod, mr.Section])
def test_batch_axes_that_do_not_broadcast_are_named(owner: Callable[..., Any]) -> None:
    with pytest.raises(ValueError, match=r"length \(2,\).*torsional_stiffness \(3,\)"):
        owner(**{**PROPERTIES, "length": (0.3, 0.4), "torsional_stiffness": (0.01, 0.02, 0.03)})


def test_three_lines_are_no_vector() -> None:
    lines = [mr.Tendon(offset) for offset in ((0.008, 0), (-0.004, 0.007), (-0.004, -0.007))]
    robot = mr.SingleRod(mr.Rod(**PROPERTIES, lines=lines))
    assert robot.inputs(tension=3).tension.tolist() == [3, 3, 3]
    with pytest.raises(ValueError, match=r"tension = \(1, 2\) is not allowed: .* one number for each of 3, or one for all$"):
        robot.inputs(tension=(1, 2))


# ---- assemblies ----


@pytest.mark.parametrize("rod", [None, "wire", 0.4, PROPERTIES], ids=type)
def test_single_rod_takes_a_rod(rod: Any) -> None:
    with pytest.raises(TypeError, match=f"SingleRod takes a Rod, not {type(rod).__name__}"):
        mr.SingleRod(rod)


def changed_pose(row: int, column: int, value: float) -> np.ndarray:
    result = np.eye(4)
    result[row, column] = value
    return result


@pytest.mark.parametrize(
    ("value", "allowed"),
    [
        (np.eye(3), "shape"),
        (1.0, "shape"),
        ("base", "numeric|shape"),
        (changed_pose(0, 3, NAN), "finite"),
        (changed_pose(1, 1, INF), "finite"),
        (changed_pose(0, 0, 1.1), "rotation"),
        (changed_pose(2, 2, -1.0), "rotation"),
        (changed_pose(0, 1, 0.1), "rotation"),
        (changed_pose(3, 0, 0.1), "last row"),
        (changed_pose(3, 3, 2.0), "last row"),
    ],
    ids=["size", "number", "string", "NaN", "inf", "stretched", "mirrored", "sheared", "projective", "scaled"],
)
def test_base_must_be_a_pose(wire: mr.Rod, value: Any, allowed: str) -> None:
    with refusal("SingleRod.base", value, allowed):
        mr.SingleRod(wire, base=value)


def test_base_batch_must_broadcast_with_the_rod() -> None:
    rod = mr.Rod(**{**PROPERTIES, "length": (0.3, 0.4)})
    with pytest.raises(ValueError, match=r"SingleRod\.base .*\(3,\).*\(2,\)"):
        mr.SingleRod(rod, base=np.tile(np.eye(4), (3, 1, 1)))


# ---- inputs ----


@pytest.mark.parametrize("name", VECTOR_INPUTS)
@pytest.mark.parametrize(
    "value",
    [
        1.0,
        0,
        True,
        "100",
        (1, 0),
        (1, 0, 0, 0),
        (NAN, 0, 0),
        (0, INF, 0),
        (0, None, 0),
        ("1", "0", "0"),
        (True, False, False),
        {},
    ],
    ids=repr,
)
def test_vector_inputs(robot: mr.SingleRod, name: str, value: Any) -> None:
    with refusal(name, value, r"\(\.\.\., 3\)|finite"):
        robot.inputs(**{name: value})


@pytest.mark.parametrize("name", VECTORS)
def test_only_tip_curvature_may_be_none(robot: mr.SingleRod, name: str) -> None:
    with refusal(name, None, r"\(\.\.\., 3\)"):
        robot.inputs(**{name: None})
    assert robot.inputs(tip_curvature=None).given == ()


@pytest.mark.parametrize("name", ["rotation", "translation"])
@pytest.mark.parametrize("value", [NAN, INF, -INF, "0.1", None, True, (0.1, NAN), ["0.1"], {}, math.sin], ids=repr)
def test_inputs_per_rod(robot: mr.SingleRod, name: str, value: Any) -> None:
    with refusal(name, value, "number|finite"):
        robot.inputs(**{name: value})


@pytest.mark.parametrize("value", [-0.4, -0.5, (-0.1, -0.4)], ids=repr)
def test_translation_must_leave_some_rod(robot: mr.SingleRod, value: Any) -> None:
    with refusal("translation", float(np.min(value)), r"> -length = -0\.4 m"):
        robot.inputs(translation=value)


@pytest.mark.parametrize("name", ["tip_force", "tip_moment", "follower_force", "follower_moment", "gravity", "tip_curvature"])
def test_functions_of_arclength_only_where_a_load_is_distributed(robot: mr.SingleRod, name: str) -> None:
    with pytest.raises(ValueError, match=f"^{name} = <function.* is not allowed"):
        robot.inputs(**{name: lambda s: (0, 0, s)})


@pytest.mark.parametrize("name", ["distributed_force", "distributed_moment"])
@pytest.mark.parametrize(
    "function", [lambda s: (1, 2), lambda s: (1, 2, NAN), lambda s: s, lambda s: None], ids=["2", "NaN", "1", "None"]
)
def test_load_functions_must_return_three_finite_numbers(
    robot: mr.SingleRod, name: str, function: Callable[[float], Any]
) -> None:
    with pytest.raises(ValueError, match=rf"^{name}\(0\) = .* is not allowed: must be 3 finite numbers"):
        robot.inputs(**{name: function})


def test_unknown_input_is_refused_and_the_known_are_listed(robot: mr.SingleRod) -> None:
    with pytest.raises(
        TypeError,
        match="inputs.*'tip_fource'.*" + ", ".join(("rotation", "translation", *VECTORS, "magnetic_field", "tip_curvature")),
    ):
        robot.inputs(tip_fource=(1, 0, 0))


def test_inputs_that_do_not_broadcast(robot: mr.SingleRod) -> None:
    with pytest.raises(ValueError, match=r"rotation \(2,\), tip_force \(3,\)"):
        robot.inputs(rotation=(0.1, 0.2), tip_force=np.zeros((3, 3)))
    batch = mr.SingleRod(mr.Rod(**{**PROPERTIES, "length": (0.3, 0.4)}))
    with pytest.raises(ValueError, match=r"\(3,\).*rods' \(2,\)"):
        batch.inputs(tip_force=np.zeros((3, 3)))


def test_unknown_attribute_of_inputs(robot: mr.SingleRod) -> None:
    with pytest.raises(AttributeError, match="'tip_fource'.*tip_force"):
        _ = robot.inputs().tip_fource


# ---- options of solvers and integrators ----

FLOATS = (0, 0.0, -1.0, NAN, INF, "1", None, True, [1.0, 2.0])
BY_PRECISION = tuple(value for value in FLOATS if value is not None)  # None is the default of the precision
COUNTS = (0, -1, 2.0, NAN, "3", None, True)
FLAGS = (0, 1, "yes", None)
NAMES = ("", "Quadratic", None, 1, True)
OPTIONS: dict[Callable[..., Any], dict[str, tuple[tuple[Any, ...], str]]] = {
    mr.Shooting: {
        "tolerance": (BY_PRECISION, POSITIVE),
        "max_iterations": (COUNTS, "integer >= 1"),
        "max_continuation_steps": (COUNTS, "integer >= 1"),
        "max_integrations": (COUNTS, "integer >= 1"),
        "line_search": (FLAGS, "True or False"),
        "predictor": (NAMES, "'none', 'linear', 'quadratic', 'adaptive'"),
        "integrator": ((None, "RK4", 50, mr.RK4), "Integrator"),
    },
    mr.ScipyShooting: {
        "method": (NAMES, "'interior-point', 'quasi-newton', 'nelder-mead'"),
        "tolerance": (FLOATS, POSITIVE),
        "max_residual": (FLOATS, POSITIVE),
        "max_iterations": (COUNTS, "integer >= 1"),
        "exact_gradient": (FLAGS, "True or False"),
        "integrator": ((None, "RK4", 50), "Integrator"),
    },
    mr.Observer: {
        **{
            name: ((0, -1.0, NAN, INF, "1", None, True, [1.0], [[1.0, 2.0]], [[1, 0], [0, -1]]), "> 0|number|definite")
            for name in ("R", "Q", "P0")
        },
        "riccati": (NAMES, "'steady', 'forward', 'horizon'"),
        "update": (NAMES, "'exact', 'euler'"),
        **{name: (FLOATS, POSITIVE) for name in ("horizon", "dt", "fold_threshold")},
        "tolerance": (BY_PRECISION, POSITIVE),
        **{name: (FLAGS, "True or False") for name in ("feed_forward", "correct_output")},
        **{name: (COUNTS, "integer >= 1") for name in ("max_iterations", "ramp")},
        "integrator": ((None, "RK4", 50), "Integrator"),
    },
    mr.RK4: {"steps": (COUNTS, "integer >= 1"), "precision": (NAMES, "'float64', 'float32'")},
    **{
        owner: {
            "rtol": (floats, POSITIVE),
            "atol": (floats, POSITIVE),
            "steps": ((0, -1, 2.0, "3", True), "integer >= 1"),
            "precision": (NAMES, "'float64', 'float32'"),
        }
        for owner, floats in ((mr.RK23, FLOATS), (mr.RK45, BY_PRECISION))
    },
}
OPTION_CASES = [
    pytest.param(owner, name, value, allowed, id=f"{owner.__name__}.{name}={value!r}")
    for owner, options in OPTIONS.items()
    for name, (values, allowed) in options.items()
    for value in values
]


@pytest.mark.parametrize(("owner", "name", "value", "allowed"), OPTION_CASES)
def test_options(owner: Callable[..., Any], name: str, value: Any, allowed: str) -> None:
    with refusal(f"{owner.__name__}.{name}", value, allowed):
        owner(**{name: value})


@pytest.mark.parametrize("owner", OPTIONS, ids=lambda owner: owner.__name__)
def test_unknown_option(owner: Callable[..., Any]) -> None:
    with pytest.raises(TypeError, match="tolerence"):
        owner(tolerence=1e-6)


@pytest.mark.parametrize("owner", [mr.Shooting, mr.ScipyShooting, mr.Observer])
def test_options_are_keyword_only_and_fixed(owner: Callable[..., Any]) -> None:
    with pytest.raises(TypeError, match="positional"):
        owner(1e-6)
    with pytest.raises(AttributeError, match="tolerance"):
        owner().tolerance = -1.0


@pytest.mark.parametrize("name", ["R", "Q", "P0"])
@pytest.mark.parametrize(
    "matrix",
    [
        np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]),
        np.diag([1.0, 1.0, 0.0]),
        np.diag([1.0, -1.0, 1.0]),
        np.diag([1.0, NAN, 1.0]),
        np.zeros((0, 0)),
        np.eye(3)[None],
    ],
    ids=["not symmetric", "singular", "indefinite", "NaN", "empty", "batch"],
)
def test_gain_matrices_must_be_symmetric_positive_definite(name: str, matrix: np.ndarray) -> None:
    with refusal(f"Observer.{name}", matrix, "symmetric positive definite"):
        mr.Observer(**{name: matrix})


@pytest.mark.parametrize("size", [2, 4])
@pytest.mark.parametrize("name", ["R", "Q", "P0"])
def test_gain_matrices_must_have_the_size_of_the_unknowns(robot: mr.SingleRod, name: str, size: int) -> None:
    solver = mr.Observer(**{name: 10.0 * np.eye(size)}, integrator=INTEGRATOR)
    message = rf"Observer cannot take this problem: {name} has shape \({size}, {size}\) but there are 3 unknowns"
    inputs = robot.inputs(tip_force=(1, 0, 0))
    with pytest.raises(ValueError, match=message):
        mr.solve(robot, inputs, solver=solver)
    with pytest.raises(ValueError, match=message):
        mr.simulate(robot, inputs, time=[0.0, 0.1], solver=solver)
    with pytest.raises(ValueError, match=message):
        mr.Tracker(robot, solver=solver, dt=0.1, inputs=inputs)


EULER: dict[str, Any] = {"order": 1, "a": ((),), "b": (1.0,), "c": (0.0,)}
HEUN: dict[str, Any] = {"order": 2, "a": ((), (1.0,)), "b": (0.5, 0.5), "c": (0.0, 1.0)}


@pytest.mark.parametrize(
    ("tableau", "message"),
    [
        ({**EULER, "b": (0.5,)}, "b must sum to 1"),
        ({**HEUN, "c": (0.0, 0.5)}, "rows of a must sum to c"),
        ({**HEUN, "a": ((1.0,),)}, "2 weights need 2 nodes"),
        ({**HEUN, "a": ((0.0,), (1.0,))}, "rows of lengths 0 to 1"),
        ({**HEUN, "c": (0.0,)}, "2 weights need 2 nodes"),
        ({**HEUN, "error": (0.5,)}, "error has length 1: must be 2"),
        ({**HEUN, "b": (NAN, 0.5)}, "b"),
        ({**HEUN, "a": ((), (NAN,))}, "a"),
        ({**HEUN, "error": (NAN, 0.5)}, "error"),
        ({**HEUN, "order": 0}, "order"),
        ({**HEUN, "order": "2"}, "order"),
        ({"order": 1, "a": (), "b": (), "c": ()}, "b"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_tableau(tableau: dict[str, Any], message: str) -> None:
    assert mr.Tableau(**HEUN).order == 2
    with pytest.raises(ValueError, match=f"Tableau.*{message}"):
        mr.Tableau(**tableau)


def test_step_control_needs_an_error_estimate() -> None:
    class Heun(mr.AdaptiveIntegrator):
        tableau = mr.Tableau(**HEUN)

    assert Heun(steps=3).steps == 3
    with pytest.raises(ValueError, match=r"Heun\.steps = None is not allowed: .*no error estimate.*steps >= 1"):
        Heun()


# ---- solve, simulate, Tracker, Solution ----


def calls(robot: Any, inputs: Any = None, **options: Any) -> list[Callable[[], Any]]:
    """The three ways to run a solver, with the same arguments."""
    return [
        lambda: mr.solve(robot, inputs, **options),
        lambda: mr.simulate(robot, inputs, time=[0.0, 0.1], **options),
        lambda: mr.Tracker(robot, inputs=inputs, dt=0.1, **options),
    ]


def test_robot_must_be_an_assembly(wire: mr.Rod) -> None:
    for call in calls(wire):
        with pytest.raises(TypeError, match="robot must be an assembly.*not Rod"):
            call()


@pytest.mark.parametrize("solver", ["newton", mr.Shooting, INTEGRATOR], ids=["string", "class", "integrator"])
def test_solver_must_be_a_solver(robot: mr.SingleRod, solver: Any) -> None:
    for call in calls(robot, robot.inputs(), solver=solver):
        with pytest.raises(TypeError, match=f"solver must be a Solver.*not {type(solver).__name__}"):
            call()


@pytest.mark.parametrize("inputs", [{"tip_force": (1, 0, 0)}, (1, 0, 0), "tip_force"], ids=["dict", "tuple", "string"])
def test_inputs_must_be_made_by_the_robot(robot: mr.SingleRod, inputs: Any) -> None:
    tracker = mr.Tracker(robot, inputs=robot.inputs(tip_force=(1, 0, 0)), solver=mr.Shooting(integrator=INTEGRATOR), dt=0.1)
    for call in [*calls(robot, inputs, solver=mr.Shooting(integrator=INTEGRATOR)), lambda: tracker.step(inputs)]:
        with pytest.raises(TypeError, match=rf"inputs must be .*robot\.inputs\(.*not {type(inputs).__name__}"):
            call()


def test_inputs_of_another_robot_are_checked_again(robot: mr.SingleRod) -> None:
    short = mr.SingleRod(mr.Rod(**{**PROPERTIES, "length": 0.2}))
    inputs = robot.inputs(translation=-0.3)
    tracker = mr.Tracker(short, solver=mr.Shooting(integrator=INTEGRATOR), dt=0.1)
    for call in [*calls(short, inputs, solver=mr.Shooting(integrator=INTEGRATOR)), lambda: tracker.step(inputs)]:
        with pytest.raises(ValueError, match=r"^translation = -0\.3 is not allowed: .*> -length"):
            call()


@pytest.mark.parametrize(
    "guess",
    [1.0, (1, 2), (1, 2, 3, 4), (1, 2, 3) * 2, (NAN, 0, 0), (INF, 0, 0), "zero", ("1", "2", "3"), [(0, 0, 0)] * 2],
    ids=repr,
)
def test_guess(robot: mr.SingleRod, guess: Any) -> None:
    for call in calls(robot, robot.inputs(tip_force=(1, 0, 0)), guess=guess, solver=mr.Shooting(integrator=INTEGRATOR)):
        with pytest.raises(
            ValueError, match=r"^guess = .* is not allowed: must (have|be numeric,|be finite|broadcast to 1 instance)"
        ):
            call()


@pytest.mark.parametrize(
    "time",
    [
        [0.0, 0.1, 0.1],
        [0.0, 0.2, 0.1],
        [0.2, 0.1, 0.0],
        [0.0, NAN, 0.2],
        [0.0, INF, 0.2],
        0.0,
        [[0.0, 0.1]],
        "0 1 2",
        ["0", "1", "2"],
        None,
    ],
    ids=repr,
)
def test_time_must_increase(robot: mr.SingleRod, time: Any) -> None:
    with pytest.raises(ValueError, match=r"^time = .* is not allowed: must (be|have|increase)"):
        mr.simulate(robot, robot.inputs(), time=time)


def test_first_axis_of_inputs_must_be_time(robot: mr.SingleRod) -> None:
    with pytest.raises(ValueError, match=r"^inputs = .*\(4,\).* is not allowed: the first must be time, 3 samples"):
        mr.simulate(robot, robot.inputs(tip_force=np.zeros((4, 3))), time=[0.0, 0.1, 0.2])


@pytest.mark.parametrize("dt", [value for value in FLOATS if value is not None], ids=repr)
def test_tracker_dt(robot: mr.SingleRod, dt: Any) -> None:
    with refusal("Tracker.dt", dt, POSITIVE):
        mr.Tracker(robot, dt=dt)


def test_questions_to_a_solution(robot: mr.SingleRod) -> None:
    solution = mr.solve(robot, robot.inputs(tip_force=(1, 0, 0)), solver=mr.Shooting(integrator=INTEGRATOR))
    for rod in ("outer", 1, -2, 0.0):
        with refusal("rod", rod, "below 1"):
            solution.rod(rod)
    for nodes in (1, 0, 2.0, "3", True):
        with refusal("nodes", nodes, "integer >= 2"):
            solution.rod(nodes=nodes)
    for name in ("tip_fource", 3):
        with pytest.raises(TypeError, match=f"takes no {name!r}: it takes .*tip_force"):
            solution.jacobian(name)
        with pytest.raises(TypeError, match=f"takes no {name!r}: it takes .*tip_force"):
            solution.jacobian("tip_force", name)
    with pytest.raises(TypeError, match="needs an input or several: it takes rotation"):
        solution.jacobian()


def _with(shape: tuple[int, ...], at: tuple[int, ...], value: Any) -> np.ndarray:
    """Zeros, or identities where the last axes are those of matrices, but for ``value`` in one place."""
    values = np.zeros(shape) if shape[-1] != shape[-2] else np.tile(np.eye(shape[-1]), (*shape[:-2], 1, 1))
    values[at] = value
    return values


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (
            lambda robot: robot.inputs(tip_force=_with((9, 5, 3), (7, 1, 2), NAN)),
            "tip_force = nan at [7, 1, 2] of shape (9, 5, 3) ",
        ),
        (lambda robot: robot.inputs(tip_force=_with((9, 5, 3), (7, 1, 2), 1e60)), "tip_force = 1e+60 at [7, 1, 2] of"),
        (lambda robot: mr.Rod(**{**PROPERTIES, "length": np.arange(40.0)[::-1]}), "Rod.length = 0.0 at [39] of shape (40,) "),
        (lambda robot: mr.Rod(**{**PROPERTIES, "length": np.geomspace(1.0, 1e60, 61)}), "Rod.length = 1e+51 at [51] of"),
        (
            lambda robot: mr.SingleRod(robot.rods[0], base=_with((9, 4, 4), (6, 3, 1), 1.0)),
            "0.0, 1.0]] at [6] of shape (9, 4, 4) ",
        ),
        (
            lambda robot: mr.Pose(rotation=_with((9, 3, 3), (6, 0, 1), 0.5)),
            "[[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], ",
        ),
        (
            lambda robot: mr.Pose(axis=_with((20, 3), (slice(1, 19), 0), 1.0)),
            "Pose.axis = [0.0, 0.0, 0.0] at [0] of shape (20, 3) ",
        ),
        (
            lambda robot: mr.Pose(axis=_with((20, 3), (slice(19), 0), 1.0)),
            "Pose.axis = [0.0, 0.0, 0.0] at [19] of shape (20, 3) ",
        ),
        (lambda robot: mr.Prior(sigma=_with((30, 1), (slice(29),), 1.0)), "Prior.sigma = 0.0 at [29, 0] of shape (30, 1) "),
        (lambda robot: mr.solve(robot, guess=_with((10, 3), (4, 1), INF)), "guess = inf at [4, 1] of shape (10, 3) "),
    ],
)
def test_what_is_wrong_in_a_batch_is_named_with_its_place(
    robot: mr.SingleRod, make: Callable[[mr.SingleRod], Any], says: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(says)) as refused:
        make(robot)
    assert len(str(refused.value)) < 300


def test_numbers_of_numpy_are_shown_as_numbers() -> None:
    with pytest.raises(ValueError, match=r"Rod.foundation = \(-0.1, 2, 3.5\) is not allowed"):
        mr.Rod(length=1, bending_stiffness=1, torsional_stiffness=1, foundation=(np.float64(-0.1), np.int64(2), 3.5))
