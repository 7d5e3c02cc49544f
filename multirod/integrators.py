"""How the spatial equations are integrated: explicit Runge-Kutta methods given by their Butcher tableau."""

from copy import copy
from dataclasses import dataclass, field
from fractions import Fraction
from typing import ClassVar, Self

from multirod.validation import choice, finite_float, positive_float, positive_int, refuse, sequence

PRECISIONS = ("float64", "float32")
SINGLE_RTOL = 1e-6  # the finest that step control can keep in single precision, which rounds to 6e-8: measured, docs/solvers.md
SINGLE_ATOL = 1e-7


@dataclass(frozen=True)
class Tableau:
    """Butcher tableau of an explicit Runge-Kutta method, with an embedded error estimate where it has one.

    Attributes:
        order: Order of convergence of the solution.
        a: Stage coefficients, row ``i`` of length ``i``.
        b: Weights of the solution, shape (stage_count,).
        c: Nodes, shape (stage_count,).
        error: ``b - b_embedded``, shape (stage_count,); empty if there is no embedded method.

    Raises:
        ValueError: If the lengths do not fit, the rows of ``a`` do not sum to ``c``, or ``b`` does not sum to 1.
    """

    order: int
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    error: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        positive_int("Tableau.order", self.order)
        for name in ("a", "b", "c", "error"):
            sequence(
                f"Tableau.{name}",
                getattr(self, name),
                (list, tuple) if name == "a" else object,
                "rows" if name == "a" else "numbers",
            )
        for name, values in {"a": [v for row in self.a for v in row], "b": self.b, "c": self.c, "error": self.error}.items():
            for value in values:
                finite_float(f"Tableau.{name}", value)
        count = len(self.b)
        if len(self.a) != count or len(self.c) != count or any(len(row) != i for i, row in enumerate(self.a)):
            raise ValueError(f"Tableau.a, b, c: {count} weights need {count} nodes and rows of lengths 0 to {count - 1}")
        if self.error and len(self.error) != count:
            raise ValueError(f"Tableau.error has length {len(self.error)}: must be {count} or empty")
        if any(abs(sum(row) - c) > 1e-12 for row, c in zip(self.a, self.c, strict=True)) or abs(sum(self.b) - 1) > 1e-12:
            raise ValueError("Tableau: rows of a must sum to c, and b must sum to 1")


class Integrator:
    """An explicit Runge-Kutta method. Subclass ``FixedStepIntegrator`` or ``AdaptiveIntegrator`` and name a ``tableau``.

    The grid has a node wherever a section ends or a load profile changes, so piecewise properties cost no order.

    Unknowns, residual and ``Gamma`` are double precision whatever ``precision`` is, and so is everything but the solver's own
    integrations: shapes, energies, stability, multiple shooting (``docs/solvers.md``, Single precision).

    Attributes:
        tableau: The method's coefficients.
        steps: Number of equal steps over the whole length; each stretch between nodes gets its share, rounded up so that
            doubling ``steps`` doubles every share.
            ``None``: steps are chosen by the embedded error estimate.
        rtol: Largest local error of a step relative to the state, when ``steps`` is None.
        atol: The same, absolute, in natural units: 1 for rotations, the rod's length for positions, its inverse for curvatures.
        precision: Of the arithmetic along the rods, ``"float64"`` or ``"float32"``.
    """

    tableau: ClassVar[Tableau]
    steps: int | None
    rtol: float
    atol: float
    precision: str = "float64"

    @property
    def adaptive(self) -> bool:
        """Whether steps are chosen by the error estimate."""
        return self.steps is None

    def in_double(self) -> Self:
        """The same in double precision."""
        if self.precision == "float64":
            return self
        result = copy(self)
        object.__setattr__(result, "precision", "float64")
        return result

    def __str__(self) -> str:
        detail = f"rtol={self.rtol:g}, atol={self.atol:g}" if self.adaptive else f"{self.steps}"
        if self.precision != "float64":
            detail += f", {self.precision}"
        return f"{type(self).__name__}({detail})"


@dataclass(frozen=True)
class FixedStepIntegrator(Integrator):
    """An explicit Runge-Kutta method at fixed steps: a subclass only names its ``tableau``.

    Raises:
        ValueError: If ``steps`` is not an integer >= 1, or ``precision`` is none that there is.
    """

    steps: int = 50
    rtol: float = field(default=0.0, init=False, repr=False)
    atol: float = field(default=0.0, init=False, repr=False)
    precision: str = field(default="float64", kw_only=True)

    def __post_init__(self) -> None:
        name = type(self).__name__
        object.__setattr__(self, "steps", positive_int(f"{name}.steps", self.steps))
        choice(f"{name}.precision", self.precision, PRECISIONS)


@dataclass(frozen=True)
class AdaptiveIntegrator(Integrator):
    """An embedded Runge-Kutta pair with step control, or at fixed ``steps``: a subclass names its ``tableau``.

    Raises:
        ValueError: If a field is out of range, step control is asked of a tableau without an error estimate, or of
            ``"float32"`` an accuracy that it has not.
    """

    rtol: float = 1e-6
    atol: float = 1e-9
    steps: int | None = field(default=None, kw_only=True)
    precision: str = field(default="float64", kw_only=True)

    def __post_init__(self) -> None:
        name = type(self).__name__
        object.__setattr__(self, "rtol", positive_float(f"{name}.rtol", self.rtol))
        object.__setattr__(self, "atol", positive_float(f"{name}.atol", self.atol))
        choice(f"{name}.precision", self.precision, PRECISIONS)
        if self.adaptive and self.precision == "float32":
            for field_name, finest in (("rtol", SINGLE_RTOL), ("atol", SINGLE_ATOL)):
                if getattr(self, field_name) < finest:
                    refuse(
                        f"{name}.{field_name}",
                        getattr(self, field_name),
                        f"must be >= {finest:g} in float32, which rounds every number to 6e-8 of itself",
                    )
        if self.steps is not None:
            object.__setattr__(self, "steps", positive_int(f"{name}.steps", self.steps))
        elif not self.tableau.error:
            raise ValueError(f"{name}.steps = None is not allowed: the method has no error estimate, so give steps >= 1")


def _floats(*values: Fraction | int) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


_F = Fraction


class RK4(FixedStepIntegrator):
    """The classical fourth-order method at fixed steps."""

    tableau: ClassVar[Tableau] = Tableau(
        order=4,
        a=((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
        b=_floats(_F(1, 6), _F(1, 3), _F(1, 3), _F(1, 6)),
        c=(0.0, 0.5, 0.5, 1.0),
    )


@dataclass(frozen=True)
class RK23(AdaptiveIntegrator):
    """Bogacki and Shampine's 3(2) pair (Appl. Math. Lett. 2, 1989), the paper's method; defaults as in MATLAB's ``ode23``."""

    tableau: ClassVar[Tableau] = Tableau(
        order=3,
        a=((), (0.5,), (0.0, 0.75), _floats(_F(2, 9), _F(1, 3), _F(4, 9))),
        b=_floats(_F(2, 9), _F(1, 3), _F(4, 9), 0),
        c=(0.0, 0.5, 0.75, 1.0),
        error=_floats(_F(-5, 72), _F(1, 12), _F(1, 9), _F(-1, 8)),
    )
    rtol: float = 1e-3
    atol: float = 1e-6


@dataclass(frozen=True)
class RK45(AdaptiveIntegrator):
    """Dormand and Prince's 5(4) pair (J. Comput. Appl. Math. 6, 1980): the default.

    The default tolerances, 1e-8 and 1e-10, keep the tip within 1e-6 of the length (measured: ``docs/model.md``). In float32 they
    are the finest that it can keep, 1e-6 and 1e-7.
    """

    tableau: ClassVar[Tableau] = Tableau(
        order=5,
        a=(
            (),
            _floats(_F(1, 5)),
            _floats(_F(3, 40), _F(9, 40)),
            _floats(_F(44, 45), _F(-56, 15), _F(32, 9)),
            _floats(_F(19372, 6561), _F(-25360, 2187), _F(64448, 6561), _F(-212, 729)),
            _floats(_F(9017, 3168), _F(-355, 33), _F(46732, 5247), _F(49, 176), _F(-5103, 18656)),
            _floats(_F(35, 384), 0, _F(500, 1113), _F(125, 192), _F(-2187, 6784), _F(11, 84)),
        ),
        b=_floats(_F(35, 384), 0, _F(500, 1113), _F(125, 192), _F(-2187, 6784), _F(11, 84), 0),
        c=(0.0, 0.2, 0.3, 0.8, 8 / 9, 1.0, 1.0),
        error=_floats(_F(71, 57600), 0, _F(-71, 16695), _F(71, 1920), _F(-17253, 339200), _F(22, 525), _F(-1, 40)),
    )
    # None, until they are chosen by the precision
    rtol: float = None  # type: ignore[assignment]
    atol: float = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        single = choice("RK45.precision", self.precision, PRECISIONS) == "float32"
        for name, value in (("rtol", SINGLE_RTOL if single else 1e-8), ("atol", SINGLE_ATOL if single else 1e-10)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        super().__post_init__()
