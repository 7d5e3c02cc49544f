"""Derivatives of solutions at equilibrium, by inputs and by the robot's own numbers; equations of ``docs/derivatives.md``."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from multirod.naming import meant
from multirod.problem import BoundaryProblem
from multirod.results import sides
from multirod.results.eliminating import eliminated, pose_derivative, pulled_back, warn_of_nan, warn_of_singular
from multirod.results.segment_system import pose_jacobians
from multirod.results.telling import told_by_loop
from multirod.rotations import cross_matrix
from multirod.types import Numbers
from multirod.validation import FloatArray, array, choice, frozen, refuse, shown
from multirod.warning import warn

if TYPE_CHECKING:
    from multirod.assembly import Assembly
    from multirod.inputs import Inputs
    from multirod.results.solution import Solution

POSE = 6
ALONG = {"position": 3, "rotation": 3, "curvature": 3, "wrench": 6}  # at places along a rod, and the rows of each
OF = ("pose", "line_length", "tension", *ALONG)
OF_TIP = {"tip_pose": slice(0, POSE), "tip_position": slice(0, 3)}
ROUNDED = 1e-9  # of the largest number of a load, what is not shown
SINGULAR = 1e-14  # of the largest: a singular value of the compliance that rounding may have left

_OPTIONS: "WeakKeyDictionary[Assembly, dict[tuple[str, ...], dict[str, Any]]]" = WeakKeyDictionary()

# of a problem, its columns of the pose by numbers at fixed unknowns, and what ends at one place were moved apart
Rows = Callable[[Any, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Columns:
    """What an integration carried along, at fixed unknowns.

    Attributes:
        places: By each name, where its columns stand.
        slopes: Of the residual, shape (instance, n, k).
        rows: Of the end effector's pose, by the unknowns, then by the names, shape (instance, 6, n + k).
        gamma: Shape (instance, n, n).
        one_sided: Whether a line is neither taut nor slack.
    """

    places: dict[str, NDArray[np.intp]]
    slopes: FloatArray
    rows: FloatArray
    gamma: FloatArray
    one_sided: bool

    @classmethod
    def of(cls, problem: BoundaryProblem, places: dict[str, NDArray[np.intp]]) -> "Columns":
        """Those of the last integration, after ``aim(*places)``."""
        slopes, moved = problem.aimed(*places)
        one_sided = len(problem.kinks) > 0 and bool(sides.at_kinks(problem).any())
        return cls(places, slopes, _pose_rows(problem, moved), np.array(_gamma(problem)), one_sided)

    def by(self, names: Sequence[object]) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """The columns by these names, slopes, rows and ``gamma``; None where some are not there, or not enough."""
        if self.one_sided:
            return None
        if tuple(names) == tuple(self.places):
            return self.slopes, self.rows, self.gamma
        places = [self.places[name] for name in names if isinstance(name, str) and name in self.places]
        if not places or len(places) < len(names):
            return None
        chosen = np.concatenate(places)
        n = self.gamma.shape[-1]
        return self.slopes[:, :, chosen], self.rows[:, :, np.concatenate([np.arange(n), n + chosen])], self.gamma


def names_of(solution: "Solution[Any]", names: Sequence[object], call: str = "jacobian(name)") -> list[str]:
    """Inputs and parameters that are there, or a ``TypeError``."""
    return known_names(solution.assembly, names, call)


def known_names(assembly: "Assembly", names: Sequence[object], call: str) -> list[str]:
    """The same of an assembly."""
    allowed = (*(spec.name for spec in assembly.input_specs), *assembly.parameters)
    if not names:
        raise TypeError(f"{call} needs an input or several: it takes " + ", ".join(allowed))
    known: list[str] = []
    for name in names:
        if not isinstance(name, str) or name not in allowed:
            hint = meant(name, allowed) if isinstance(name, str) else ""
            if isinstance(name, (list, tuple)) and all(isinstance(own, str) for own in name):
                raise TypeError(f"{call} takes no {shown(name)}: give the names one after another, {', '.join(map(repr, name))}")
            raise TypeError(f"{call} takes no {shown(name)}: it takes " + ", ".join(allowed) + hint)
        known.append(name)
    return known


def jacobian(
    solution: "Solution[Any]", names: Sequence[object], of: str, at: Numbers | None, rod: int | str | None
) -> FloatArray:
    """What ``Solution.jacobian`` says."""
    choice("of", of, OF)
    if of not in ALONG and rod is not None:
        refuse("rod", rod, f"must not be given of {of}: it is for {', '.join(ALONG)}; columns by a parameter run over all rods")
    kept = _kept(solution, names) if of == "pose" and at is None else None
    if kept is not None:
        left, silent = eliminated(*kept)
        warn_of_singular(names, silent & ~solution._failed)
        return solution._masked(left, (POSE, kept[0].shape[-1]))
    told = told_by_loop(solution, names) if of == "pose" and at is None and rod is None else None
    if told is not None:
        return solution._masked(told, (POSE, told.shape[-1]))
    known = names_of(solution, names)
    if of not in ALONG and at is not None:
        refuse("at", at, f"must not be given of {of}: it is for {', '.join(ALONG)}")
    # a follower force is an unknown's worth of equations more, but to first order only its direction counts
    twins = twins_of(solution.assembly, lambda: solution.inputs, known)
    stand_ins = [twin or name for name, twin in zip(known, twins, strict=True)]
    tail, rows = _rows(solution, stand_ins, of, at, rod)
    result = _by(solution, stand_ins, rows, tail)
    if not any(twins):
        return result
    parts = split(solution, known, result)
    R = solution.tip_rotation.reshape(*solution.batch_shape, *(1,) * (len(tail) - 1), 3, 3)
    turned = [part @ R if twin else part for part, twin in zip(parts, twins, strict=True)]
    return np.asarray(frozen(np.concatenate(turned, axis=-1)))


def twins_of(assembly: "Assembly", inputs: "Callable[[], Inputs]", names: Sequence[str]) -> list[str]:
    """Of each name the dead load that stands in for it, or none; inputs are asked for where there may be one."""
    specs = {spec.name: spec.dead_twin for spec in assembly.input_specs}
    return [specs[name] if specs.get(name) and not inputs().is_active(name) else "" for name in names]


def split(solution: "Solution[Any]", names: Sequence[str], columns: FloatArray) -> list[FloatArray]:
    """Columns (..., k) by each name."""
    return np.split(columns, np.cumsum([solution.assembly.column_count(name) for name in names])[:-1], axis=-1)


def _pose_rows(problem: BoundaryProblem, moved: FloatArray, apart: FloatArray | None = None) -> FloatArray:
    return np.concatenate([problem.pose_by_unknowns(), moved], axis=2)


def _rows(
    solution: "Solution[Any]", names: list[str], of: str, at: Numbers | None, rod: int | str | None
) -> tuple[tuple[int, ...], Rows]:
    """The axes of what is asked for, and what gives its derivatives by unknowns and by numbers, (instance, rows, n + k)."""
    assembly = solution.assembly
    if of == "pose":
        return (POSE,), _pose_rows
    if of in ALONG:
        index = solution._rod_index(rod)
        places = places_of(solution, at, index)
        tail = (places.size, ALONG[of]) if np.ndim(np.asarray(at)) else (ALONG[of],)

        def along(problem: BoundaryProblem, moved: FloatArray, apart: FloatArray) -> FloatArray:
            own = np.maximum(places - apart[:, None], places / 2)
            values = problem.along(names, index, own)[of]
            return np.asarray(values.reshape(problem.instance_count, -1, values.shape[-1]))

        return tail, along
    count = len(solution._lines())
    if not assembly.length_columns:
        raise NotImplementedError(f"{type(assembly).__name__} does not give the derivatives of its lines' lengths")

    def lines(problem: BoundaryProblem, moved: FloatArray, apart: FloatArray) -> FloatArray:
        assert problem.lines is not None  # as an assembly with lines has
        ask = problem.lines.length_columns if of == "line_length" else problem.lines.tension_columns
        return np.asarray(ask(*names))

    return (count,), lines


def places_of(solution: "Solution[Any]", at: Numbers | None, rod: int) -> FloatArray:
    """Checked arclengths along a rod (count,): where a section ends, those just before it."""
    if at is None:
        refuse("at", at, "must be an arclength along the rod [m], or several, rising")
    places = np.atleast_1d(array("at", at, wanted="an arclength along the rod [m], or several, rising"))
    if places.ndim != 1 or not places.size or (np.diff(places) <= 0).any():
        refuse("at", at, "must be one arclength or several, rising")
    sections = [[solution._parameter(section.length, 0) for section in own.sections] for own in solution.assembly.rods]
    return places_on(sections, solution.inputs.translation, places, rod)


def places_on(sections: Sequence[Sequence[FloatArray]], translation: FloatArray, places: FloatArray, rod: int) -> FloatArray:
    """Rising arclengths along a rod (count,), which must be on it: where a section ends, those just before it; of each rod the
    lengths of its sections (...), of the instances that all rods are pushed out in by ``translation`` (..., rod)."""
    end = sum(sections[rod], translation[..., rod])
    if places[0] < 0 or (places[-1] > end * (1 + SINGULAR)).any():
        refuse("at", places.tolist(), f"must be >= 0 and <= {float(np.min(end, initial=np.inf)):g} m, where the rod ends")
    gap = 1e-12 * float(np.max(end, initial=0.0))
    result = np.maximum(places, gap)  # a step ends there, so it is not at the base itself
    for k, lengths in enumerate(sections):
        shape = np.broadcast_shapes(translation.shape[:-1], *(length.shape for length in lengths))
        ends = np.cumsum([np.broadcast_to(length, shape) for length in lengths], axis=0)
        ends = (ends + translation[..., k]).reshape(-1, 1)
        near = np.where(np.abs(ends - places) <= gap, ends - gap, np.inf).min(axis=0, initial=np.inf)
        result = np.minimum(result, near)
    return result


def along(solution: "Solution[Any]", at: Numbers, of: str, rod: int | str | None) -> FloatArray:
    """What ``Solution.along`` says."""
    choice("of", of, ALONG)
    index = solution._rod_index(rod)
    places = places_of(solution, at, index)

    def told(problem: BoundaryProblem) -> tuple[FloatArray]:
        sensing = problem.sensing(places)
        sensing.launch()
        if of in ("position", "rotation"):
            found = np.array(getattr(sensing.poses((), index), of))
        else:
            found = np.array(getattr(sensing, of)((), index)[0])
        for k in problem.breakpoints:
            found[k] = np.nan
        return (found,)

    tail = (3, 3) if of == "rotation" else (ALONG[of],)
    options = solution.assembly.input_directions()
    found = solution._gather(told, pose_sensitivities=True, **options)[0]
    return solution._masked(found, (places.size, *tail) if np.ndim(np.asarray(at)) else tail)


def _by(solution: "Solution[Any]", names: list[str], rows: Rows, tail: tuple[int, ...]) -> FloatArray:
    """(D1) Derivatives by parameters, and by inputs whose terms are compiled in, (..., *tail, k), in one integration."""

    def columns(problem: BoundaryProblem) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        at_once = pose_derivative(problem, names) if rows is _pose_rows else None
        if at_once is None:
            slopes, own, gamma, none = _told(solution, problem, names, rows)
            result, silent = eliminated(slopes, own, gamma)
        else:
            (result, silent), none = at_once, np.zeros(problem.instance_count, dtype=bool)
        for k, by_states in pose_jacobians(problem, solution.assembly, names if rows is _pose_rows else None).items():
            result[k], silent[k] = by_states, False
        return result, none, silent

    result, none, silent = _gathered(solution, names, columns)
    _warn_of_sides(names, none)
    warn_of_singular(names, silent & ~solution._failed)
    return solution._masked(result, (*tail, result.shape[-1]))


def _told(
    solution: "Solution[Any]", problem: BoundaryProblem, names: list[str], rows: Rows
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Slopes, rows and ``Gamma`` by which (D1) is told; and of which instances some of it cannot be, shape (b,).

    Where lines are at their kinks, (D1b) stands in the rows, and nothing is left of the unknowns.
    """
    slopes, own = _fixed(problem, names, rows)
    gamma, none = _gamma(problem), np.zeros(problem.instance_count, dtype=bool)
    if not len(problem.kinks):
        return slopes, own, gamma, none
    kinks = sides.at_kinks(problem)
    kinks[list(problem.breakpoints)] = False
    here: NDArray[np.bool_] = np.array(kinks.any(axis=1))
    if not here.any():
        return slopes, own, gamma, none
    slopes, own, gamma = np.array(slopes), np.array(own), np.array(gamma)
    specs = {spec.name: spec for spec in solution.assembly.input_specs}
    lengths = [name in specs and specs[name].acts == "lines" and specs[name].load is None for name in names]
    loosened = np.repeat(lengths, [solution.assembly.column_count(name) for name in names])
    sided = sides.sided(problem, kinks, lambda: (*_fixed(problem, names, rows), _gamma(problem)), loosened)
    n = problem.unknown_count
    slopes[here], gamma[here], own[here, :, :n], own[here, :, n:] = 0.0, np.eye(n), 0.0, sided[here]
    return slopes, own, gamma, here & np.isnan(sided).any(axis=(1, 2))


def _warn_of_sides(names: Sequence[str], none: NDArray[np.bool_]) -> None:
    """Say that there are no derivatives, of some instances (b,)."""
    warn_of_nan(
        names,
        none,
        ": lines are neither taut nor slack, so that the robot is not as stiff to one side as to the other; pull them a little "
        "(displacement=1e-3, with an axial_stiffness)",
    )


def _kept(solution: "Solution[Any]", names: Sequence[object]) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Slopes, rows and ``Gamma`` that the solution has by these names; None where it has not."""
    if solution._columns is None or ("translation" in names and solution.assembly.ends_meet(solution.inputs)):
        return None
    return solution._columns.by(names)


def _gamma(problem: BoundaryProblem) -> FloatArray:
    n = problem.unknown_count
    return problem.read("gamma").reshape(-1, n, n)


def _fixed(problem: BoundaryProblem, names: list[str], rows: Rows) -> tuple[FloatArray, FloatArray]:
    """Columns of the residual by the names, the unknowns fixed, and rows by unknowns, then by the names."""
    apart = problem.part_ends(names)
    problem.eliminates = True
    slopes, moved = problem.input_columns(*names)
    found = slopes, rows(problem, moved, apart)
    problem.eliminates = False  # after an error it is not used again
    return found


def _gathered(solution: "Solution[Any]", names: list[str], columns: Callable[[Any], tuple[Any, ...]]) -> list[Any]:
    return solution._gather(columns, **_options(solution.assembly, tuple(names)))


def _options(assembly: "Assembly", names: tuple[str, ...]) -> dict[str, Any]:
    """Of problems that give derivatives by these names; found once, as it takes as long as a small integration."""
    known = _OPTIONS.setdefault(assembly, {})
    if names not in known:
        enabled = tuple(name for name in names if name not in assembly.parameters)
        known[names] = {"pose_sensitivities": True, "enabled": enabled, **assembly.input_directions(*names)}
    return known[names]


def vjp(solution: "Solution[Any]", cotangent: Numbers, of: str, wrt: object) -> Mapping[str, FloatArray]:
    """What ``Solution.vjp`` says; (D13)."""
    part = OF_TIP[choice("of", of, OF_TIP)]
    known = names_of(solution, tuple(wrt) if isinstance(wrt, (tuple, list)) else (wrt,), "vjp(wrt=...)")
    rows = part.stop - part.start
    given = array("cotangent", cotangent, (rows,))
    try:
        given = np.broadcast_to(given, (*solution.batch_shape, rows))
    except ValueError:
        refuse("cotangent", f"shape {given.shape}", f"must broadcast to {(*solution.batch_shape, rows)}")
    twins = twins_of(solution.assembly, lambda: solution.inputs, known)
    names = [twin or name for name, twin in zip(known, twins, strict=True)]

    def columns(problem: BoundaryProblem) -> tuple[Any, ...]:
        slopes, carried, gamma, none = _told(solution, problem, names, _pose_rows)
        if problem.breakpoints:
            slopes, gamma, n = np.array(slopes), np.array(gamma), problem.unknown_count
        for k, by_states in pose_jacobians(problem, solution.assembly, names).items():  # nothing is left of the unknowns
            slopes[k], gamma[k], carried[k, :, :n], carried[k, :, n:] = 0.0, np.eye(n), 0.0, by_states
        return slopes, carried, gamma, none

    slopes, carried, gamma, *none = _kept(solution, names) or _gathered(solution, names, columns)
    for own in none:
        _warn_of_sides(names, own)
    result, silent = pulled_back(given.reshape(-1, rows), slopes, carried[:, part], gamma)
    warn_of_singular(names, silent & ~solution._failed)
    result = solution._masked(result, result.shape[1:])
    pieces = split(solution, known, result)
    R = solution.tip_rotation
    turned = [(own[..., None, :] @ R)[..., 0, :] if twin else own for own, twin in zip(pieces, twins, strict=True)]
    return {name: np.asarray(frozen(piece)) for name, piece in zip(known, turned, strict=True)}


def stiffness(solution: "Solution[Any]") -> FloatArray:
    """What ``Solution.stiffness`` says; (D14)."""
    assembly = solution.assembly
    names = {spec.name for spec in assembly.input_specs}
    loads = assembly.end_loads
    if assembly.end_held or not loads or not set(loads) <= names or "platform_position" in names:
        raise AttributeError(f"{type(assembly).__name__} has no stiffness of its end: something holds it")
    parts = [np.arange(assembly.column_count(name))[own] for name, own in loads.items()]
    columns = np.concatenate([parts[0], assembly.column_count(next(iter(loads))) + parts[1]])
    compliance = np.array(jacobian(solution, tuple(loads), "pose", None, None)[..., columns])
    arm = solution.inputs.force_point if "force_point" in names else np.zeros(3)
    if np.any(arm):
        arm = (solution.tip_rotation @ arm[..., None])[..., 0]
        compliance[..., :3] -= compliance[..., 3:] @ cross_matrix(arm)
    scale = np.ones(POSE)
    scale[3:] = assembly.longest
    scaled = compliance * scale[:, None] * scale
    result = np.full(compliance.shape, np.nan)
    sound = np.asarray(np.isfinite(scaled).all(axis=(-2, -1)))
    _, values, loads_along = np.linalg.svd(np.where(sound[..., None, None], scaled, 0.0))
    rigid = sound & ~(values[..., -1] > SINGULAR * values[..., 0])
    sound &= ~rigid
    result[sound] = np.linalg.inv(scaled[sound]) * scale[:, None] * scale
    if rigid.any():
        _warn_of_rigid(rigid, loads_along[rigid][0, -1] * scale, tuple(loads))
    return np.asarray(frozen(result))


def _warn_of_rigid(rigid: NDArray[np.bool_], load: FloatArray, names: tuple[str, ...]) -> None:
    """Say that the stiffness of some instances is infinite, and the force and moment (6,) that move the end of the first by
    nothing."""
    rounded = [0.0 if abs(value) < ROUNDED else float(f"{value:.4g}") for value in load / load[np.abs(load).argmax()]]
    said = f"a force along {tuple(rounded[:3])} N with a moment of {tuple(rounded[3:])} N m moves the end by nothing"
    of = f" of {rigid.sum()} of {rigid.size} instances" if rigid.size > 1 else ""
    warn(
        f"stiffness{of} is NaN: it is infinite one way, as {said}; jacobian{names} tells how it gives way otherwise, and with "
        "an axial_stiffness it is finite",
        RuntimeWarning,
    )
