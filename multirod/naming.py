"""Names that are given: those that nothing has are refused, with the one that was probably meant."""

from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from functools import wraps
from inspect import Parameter, signature
from typing import TYPE_CHECKING, ClassVar, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
Kind = TypeVar("Kind", bound=type)
_OTHER_NAMES: dict[str, tuple[str, ...]] = {
    other: names
    for names, others in {
        ("tip_force",): "force load wrench tip_load tip_wrench",
        ("tip_moment",): "moment torque tip_torque",
        ("rotation",): "angle angles theta alpha base_angle",
        ("translation",): "insertion feed beta shift lengths leg_lengths extension",
        ("gravity", "shear_modulus"): "g",
        ("gravity",): "acceleration weight",
        ("tension",): "tensions tendon_force tendon_tension pull",
        ("magnetic_field",): "field b magnetic",
        ("young_modulus",): "e modulus youngs_modulus elastic_modulus",
        ("poisson_ratio",): "nu poisson poissons_ratio",
        ("bending_stiffness",): "ei eix eiy flexural_rigidity stiffness",
        ("torsional_stiffness",): "gj torsional_rigidity",
        ("axial_stiffness",): "ea",
        ("shear_stiffness",): "ga",
        ("precurvature",): "curvature kappa u_star ustar rest_curvature",
        ("diameter", "outer_diameter"): "d od radius r outer_radius",
        ("inner_diameter",): "id inner_radius",
        ("density", "linear_density"): "rho mass density",
        ("thickness",): "height",
        ("linear_density",): "mass_per_length mass_per_metre mass_per_meter",
        ("length",): "l arclength",
        ("area",): "cross_section hollow",
        ("lines",): "tendons tendon cables chambers",
        ("magnetisation",): "magnetization magnetic_moment remanence",
        ("foundation",): "medium tissue",
        ("revolute",): "hinge hinged pin pinned rotary",
        ("spherical",): "ball ball-and-socket ball_and_socket socket",
        ("clamped",): "fixed rigid welded weld",
        ("universal",): "cardan hooke gimbal",
        ("prismatic",): "slider sliding linear",
        ("tolerance", "rtol"): "tol reltol eps accuracy xtol ftol",
        ("max_iterations",): "max_iter maxiter iterations max_nfev",
        ("time", "dt"): "time dt rate period sample_time timestep time_step t times",
        ("integrator",): "steps step_count n_steps rk4 scheme",
    }.items()
    for other in others.split()
}  # what names are called elsewhere
_SOLVED = "mr.solve(robot, inputs)"
OF_ROBOTS = {
    **dict.fromkeys(("solve", "forward", "forward_kinematics", "fk", "shape"), _SOLVED),
    **dict.fromkeys(("tip_position", "tip_rotation", "position", "jacobian"), f"that of {_SOLVED}"),
    **dict.fromkeys(("inverse_kinematics", "ik", "reach"), "mr.reach(robot, mr.Pose(position=...), free=...)"),
    **dict.fromkeys(("simulate", "step"), "mr.simulate(robot, inputs, time=...), or mr.Tracker(robot)"),
    **dict.fromkeys(("rod", "tube", "leg", "length", "lengths"), "rods, each of which has length and sections"),
}  # what attributes of a robot are called elsewhere
INPUTS_NAMED = "inputs are named, robot.inputs(tip_force=(1, 0, 0)); print(robot.input_specs) lists them"

OPTIONS_NAMED = "options are named, and how rods are integrated is one of them, integrator=RK4(100) or RK45(rtol=1e-10)"
_TAKEN_BY = {
    **dict.fromkeys(("platform_position", "platform_rotation"), "the inverse problem of six legs takes it, robot.inverse()"),
    **dict.fromkeys(("end_position", "end_rotation"), "a HeldRod takes it, whose end is held"),
    **dict.fromkeys(("fixed_position", "fixed_rotation", "joint_torque", "slide_force"), "a Network takes it"),
    **dict.fromkeys(("payload", "tip_mass", "tip_weight"), "a weight is a force, tip_force=(0, 0, -9.81 * mass)"),
}  # by robots, of inputs that are no others'
_OF_STRIPS = {"width", "thickness", "height"}
_PER_VOLUME, _PER_LENGTH = {"rho", "density"}, {"linear_density", "mass_per_length", "mass_per_metre", "mass_per_meter"}
_BY_HALF = {"radius", "r", "outer_radius", "inner_radius"}  # of diameters
_OF_AXES = {"title", "legend", "linewidth", "lw", "color", "view", "elev", "azim", "xlim", "fontsize", "cmap", "units", "label"}
_OF_FIGURES = {"save", "path", "filename", "figsize", "dpi", "show", "fig", "figure"}
OF_PACKAGE = {
    **dict.fromkeys(("TendonRobot", "TendonDrivenRobot", "TDCR"), "mr.SingleRod(mr.Rod(..., lines=[mr.Tendon(...)]))"),
    **dict.fromkeys(("ContinuumRobot", "Robot", "CosseratRod", "Wire", "Beam"), "mr.SingleRod(mr.Rod(...))"),
    **dict.fromkeys(("Tube", "Tubes", "CTR", "ConcentricTubeRobot"), "mr.ConcentricTubes([mr.Rod.tube(...), ...])"),
    **dict.fromkeys(("ParallelRobot", "Platform", "Hexapod", "StewartPlatform"), "mr.ParallelRods(legs=, base=, platform=)"),
    **dict.fromkeys(("workspace", "forward_kinematics", "fk", "forward"), "mr.solve(robot, inputs), of a batch of inputs"),
    **dict.fromkeys(("inverse_kinematics", "ik", "inverse"), "mr.reach(robot, mr.Pose(position=...), free=...)"),
    **dict.fromkeys(("plot", "save", "show"), "that of what was solved, solution.plot()"),
    **dict.fromkeys(("snap", "snaps", "buckling"), "mr.critical_loads(robot, inputs), or solution.stability and events"),
    **dict.fromkeys(("Sensor", "Marker", "Camera"), "mr.Pose(position=..., at=..., sigma=...), or mr.Curvature(...)"),
    **dict.fromkeys(
        ("LoadCell", "ForceSensor", "TorqueSensor"),
        "mr.ForceTorque(force=..., moment=..., sigma=...), or mr.Tension(...) of lines",
    ),
    **dict.fromkeys(("monte_carlo", "montecarlo"), "mr.solve of a robot whose rods have numbers with leading axes"),
}  # what attributes of the package are called elsewhere


class Asked:
    """Says of an attribute that is not there what was probably meant.

    Attributes:
        called: By names from elsewhere, what is asked here.
    """

    called: ClassVar[Mapping[str, str]] = {}

    if not TYPE_CHECKING:  # which knows what there is

        def __getattr__(self, name: str) -> object:
            if hasattr(type(self), name):  # it refused, and says why
                return object.__getattribute__(self, name)
            hint = self._hint(name)
            raise AttributeError(f"{type(self).__name__} has no {name!r}{hint}", name=name, obj=None if hint else self)

    @classmethod
    def _hint(cls, name: str) -> str:
        """What was meant by a name that is not there, as a message ends; Python's own suggestion follows none."""
        return f"; did you mean {cls.called[name]}?" if name in cls.called else ""


def unknown_names(owner: str, given: Iterable[str], allowed: Iterable[str]) -> None:
    """Refuse, by a ``TypeError``, names that are not in ``allowed``."""
    options = tuple(allowed)
    for name in given:
        if name not in options:
            raise TypeError(f"{owner} takes no {name!r}: it takes " + ", ".join(options) + meant(name, options))


def names_checked(function: Callable[P, R]) -> Callable[P, R]:
    """The same function, which says of a name that it does not take which was probably meant, and of more arguments without a
    name than it takes which are named."""
    taken = signature(function).parameters
    kinds = {own.kind for own in taken.values()}
    any_name, any_count = Parameter.VAR_KEYWORD in kinds, Parameter.VAR_POSITIONAL in kinds
    names = [name for name in taken if name != "self"]
    known = set(names)
    plain = [name for name, own in taken.items() if own.kind is own.POSITIONAL_OR_KEYWORD]
    unnamed = [name for name in plain if name != "self"]
    called = function.__name__ if function.__name__ != "__init__" else function.__qualname__.split(".")[-2]

    @wraps(function)
    def checked(*args: P.args, **options: P.kwargs) -> R:
        if not any_name and not known.issuperset(options):
            unknown_names(f"{called}()", options, names)
        if not any_count and len(args) > len(plain):
            first = f"without a name only {', '.join(unnamed)}" if unnamed else "nothing without a name"
            others = ", ".join(f"{name}=" for name, own in taken.items() if own.kind is own.KEYWORD_ONLY)
            raise TypeError(f"{called}() takes {first}, and got {len(args) - len(plain) + len(unnamed)} such; named are {others}")
        return function(*args, **options)

    return checked


def hinted(hint: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """The same function, whose ``TypeError`` about arguments that it does not take ends in a hint."""

    def made(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def checked(*args: P.args, **options: P.kwargs) -> R:
            try:
                return function(*args, **options)
            except TypeError as error:
                taken = signature(function)
                try:
                    taken.bind(*args, **options)
                except TypeError:
                    unknown = [name for name in options if name not in taken.parameters]
                    listed = "; it takes " + ", ".join(name for name in taken.parameters if name not in ("self", "cls"))
                    others = "".join(meant(name, taken.parameters) for name in unknown)
                    raise TypeError(f"{error}: {hint}{listed if unknown and not others else ''}{others}") from None
                raise

        return checked

    return made


def signed_as(function: Callable[..., object]) -> Callable[[R], R]:
    """The same ``__new__``, whose signature, which is that of its class, is told as that of ``function``, the ``__init__``."""

    def made(new: R) -> R:
        setattr(new, "__signature__", signature(function))  # noqa: B010  (mypy refuses the plain one)
        return new

    return made


def fields_hinted(hint: str) -> Callable[[Kind], Kind]:
    """The same class, a dataclass, made by such a function."""

    def made(kind: Kind) -> Kind:
        setattr(kind, "__init__", hinted(hint)(vars(kind)["__init__"]))  # noqa: B010  (mypy refuses the plain one)
        return kind

    return made


def meant(name: str, options: Iterable[str]) -> str:
    """The option that was probably meant by a name that is none, as the end of a message."""
    options = tuple(options)
    if name in _TAKEN_BY:
        return f"; {_TAKEN_BY[name]}"
    if name in _OF_STRIPS and ("bending_stiffness" in options or "outer_diameter" in options or "diameter" in options):
        return "; Rod.strip(length=, width=, thickness=, young_modulus=, ...) makes a rod of a rectangular section"
    close = [option for option in options if option in _OTHER_NAMES.get(name.lower(), ())]
    close = close or get_close_matches(name, options, 1) or [o for o in options if name.lower() == o.lower()]
    if not close and "ax" in options and name in _OF_AXES | _OF_FIGURES:  # of a plot
        return "; the axes that it returns do" + ", or their figure, .figure.savefig(path)" * (name in _OF_FIGURES)
    if name.lower() in _PER_LENGTH and "density" in options:
        return "; density is mass per volume [kg/m^3]: mass per length over the area of the cross-section"
    other = ", twice that" * (name.lower() in _BY_HALF)
    other += ", that times the area of the cross-section" * (name.lower() in _PER_VOLUME and close == ["linear_density"])
    return f"; did you mean {close[0]!r}{other}?" if close else ""
