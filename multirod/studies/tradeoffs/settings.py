"""What is tried: solvers in the forms that differ in speed or accuracy, by integrators."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, Any

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.integrators import RK4, RK23, RK45, Integrator
from multirod.solver import Solver
from multirod.solvers.energy_descent import EnergyDescent
from multirod.solvers.observer import COUPLINGS, Observer
from multirod.solvers.scipy_shooting import METHODS, ScipyShooting
from multirod.solvers.shooting import PREDICTORS, Shooting

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

PRECISIONS: tuple[dict[str, Any], ...] = ({}, {"precision": "float32"})  # options that every integrator of the grid is tried with
OBSERVERS: dict[str, dict[str, Any]] = {
    "observer": {},
    "observer ff": {"feed_forward": True},
    "observer ff corrected": {"feed_forward": True, "correct_output": True},
    "observer ff newton-scaled": {"feed_forward": True, "scaling": "newton"},
}
COUPLED_STEPS = 50
OWN = (Shooting, Observer, EnergyDescent, ScipyShooting)  # registered too, but tried in forms of their own


@dataclass(frozen=True)
class Setting:
    """A solver on a model of the robot.

    Attributes:
        solver: Ready to use.
        robot: The model.
        inputs: Of the model, with time as the first axis.
        model: Its name; empty for the full one, which the reference is of.
    """

    solver: Solver
    robot: Assembly
    inputs: Inputs
    model: str = ""


def integrators() -> tuple[Integrator, ...]:
    """``RK4`` at 10 to 200 steps, ``RK23`` at two and ``RK45`` at three tolerances, in all precisions."""
    methods: list[tuple[type[Integrator], tuple[float, ...]]] = [(RK4, (steps,)) for steps in (10, 20, 50, 100, 200)]
    methods += [(RK23, tolerances) for tolerances in ((1e-3, 1e-6), (1e-5, 1e-8))]
    methods += [(RK45, tolerances) for tolerances in ((1e-4, 1e-7), (1e-6, 1e-9), (1e-8, 1e-10))]
    found: list[Integrator] = []
    for options in PRECISIONS:
        for kind, numbers in methods:
            with suppress(ValueError):  # a precision may refuse tolerances that it cannot keep
                found.append(kind(*numbers, **options))
    return tuple(found)


def grid(robot: Assembly, inputs: Inputs | None = None, *, tried: Sequence[Integrator] | None = None) -> dict[str, Solver]:
    """The settings that are tried by default.

    Newton's method with each predictor, four forms of the observer, and energy descent where it takes the robot, by all
    integrators; the observer in other couplings, where the robot has several rods to couple, by ``RK4`` at up to 50 steps, as it
    is the lag that they change; the paper's three root finders with ``RK4(50)``.

    Args:
        robot: The assembly: one with a single block of unknowns has one coupling.
        inputs: On which it depends what is unknown.
        tried: Integrators; ``integrators()`` by default.

    Returns:
        Solvers by name. Up to its first comma a name is the family in plots.
    """
    first = robot.accept(inputs)
    while first.batch_shape:
        first = first[0]
    problem = robot.problem(first, integrator=RK4(50))
    columns = robot.problem(first, integrator=RK4(50), pose_sensitivities=True, direction_count=1)
    result: dict[str, Solver] = {}
    for integrator in integrators() if tried is None else tried:
        name = code(integrator)
        for predictor in PREDICTORS:
            result[f"Newton, {predictor}, {name}"] = Shooting(predictor=predictor, integrator=integrator)
        descent = EnergyDescent(integrator=integrator)
        if not descent.unsupported(columns):
            result[f"energy descent, {name}"] = descent
        few = integrator.steps is not None and integrator.steps <= COUPLED_STEPS and len(problem.blocks) > 1
        for coupling in COUPLINGS if few else COUPLINGS[:1]:
            for kind, form in OBSERVERS.items():
                observer = Observer(coupling=coupling, integrator=integrator, **form)
                if not observer.unsupported(problem):
                    result[", ".join([kind if coupling == COUPLINGS[0] else f"{kind} {coupling}", name])] = observer
    for method in METHODS:
        result[f"{method}, {code(RK4(50))}"] = ScipyShooting(method=method, integrator=RK4(50))
    return result


def registered() -> Iterator[tuple[str, Solver | str]]:
    """Solvers of others and those without forms of their own, by name, or why there is none."""
    from importlib.metadata import entry_points

    for point in entry_points(group="multirod.solvers"):
        made = _made(point)
        if not isinstance(made, OWN):
            yield f"{point.name}, as registered", made


def _made(point: "EntryPoint") -> Solver | str:
    try:
        solver = point.load()()
    except Exception as error:  # noqa: BLE001  (of another package: whatever it is, the others go on)
        return f"{type(error).__name__}: {error}"
    return solver if isinstance(solver, Solver) else f"{point.value} makes no Solver"


def settings(
    robot: Assembly, inputs: Inputs, solvers: Mapping[str, Solver], models: Mapping[str, tuple[Assembly, Inputs]]
) -> dict[str, Setting]:
    """Every solver on the robot and on each of its models, by name."""
    every = {"": (robot, inputs), **models}
    return {
        f"{name}, {model}" if model else name: Setting(solver, *every[model], model)
        for name, solver in solvers.items()
        for model in every
    }


def code(thing: object, prefix: str = "") -> str:
    """A solver or integrator as short as it can be written in Python; ``prefix`` stands before the names of classes."""
    if not is_dataclass(thing):
        return repr(thing)
    parts = []
    for place, part in enumerate(field for field in fields(thing) if field.init):
        value = getattr(thing, part.name)
        default = part.default_factory() if part.default_factory is not MISSING else part.default
        if isinstance(thing, Integrator) and place == len(parts) and not part.kw_only and isinstance(value, int | float):
            parts.append(f"{value:g}" if isinstance(value, float) else code(value, prefix))
        elif value != default:
            parts.append(f"{part.name}={code(value, prefix)}")
    return f"{prefix}{type(thing).__name__}({', '.join(parts)})"
