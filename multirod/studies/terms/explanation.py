"""What a scene asks for, term by term."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from math import inf, isfinite, isnan, prod
from time import process_time

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.integrators import RK4, Integrator
from multirod.models.backbone.inputs import LOADS as SPECS
from multirod.models.backbone.kernels.layout.features import Features
from multirod.naming import names_checked
from multirod.rod import Rod
from multirod.studies.terms.leaving_out import droppable, left_out, loads_of
from multirod.validation import boolean, positive_int, refuse

SYMBOLS = {"tip_force": "F", "follower_force": "F", "tip_moment": "M", "follower_moment": "M"}
SYMBOLS |= {"distributed_force": "f", "distributed_moment": "l", "gravity": "w", "magnetic_field": "mu B"}
POWERS = {1: "L", 2: "L^2", 3: "L^3"}
GROUPS = {
    **{spec.name: f"{SYMBOLS[spec.name]} {POWERS[spec.power]}/EI" for spec in SPECS},
    "shear": "N/GA",
    "torsion": "EI/GJ",
    "anisotropy": "dEI/EI",
    "precurvature_profile": "du* L",
}
RODS = {
    "shear": "shear_stiffness or axial_stiffness is finite",
    "torsion": "torsional_stiffness is finite",
    "anisotropy": "bending_stiffness differs between its axes",
    "precurvature_profile": "precurvature is a function of arclength",
    "discs": "lines run straight between discs",
    "friction": "tendons rub against it",
}
MODELLED = (
    "gravity",
    "shear",
    "torsion",
    "anisotropy",
    "precurvature_profile",
    "discs",
    "friction",
)  # not what is done to the robot, but how it is seen
FRAMELESS = ("tip_force", "force", "follower_moment")  # what is known without the frames of a rod, on its tip
READ_AS = {"frame": "loads_need_frame"}  # with the pose alone it stands beside the equations that are solved
LAUNCHES = 30


@dataclass(frozen=True)
class Term:
    """One term of the equations that a scene asks for.

    Attributes:
        name: As ``without`` takes it.
        because: What asks for it.
        droppable: Whether ``without`` takes it; the others are a consequence of terms, or how the robot is built.
        saves: Features that are no longer compiled in without it alone; none where other terms ask for them too.
        group: The dimensionless group that says how much it does, the largest of all instances; NaN where there is none.
        error: What the tip may move by if it is dropped, over the length in use, in the worst of all instances; ``inf`` where
            nothing can be promised, and for what is not droppable.
        amplification: How many times more that is than of a rod that carries nothing else.
        estimated: Whether ``error`` is an estimate that may be too small, and no bound, as of loads of parallel robots.
    """

    name: str
    because: str
    droppable: bool = False
    saves: tuple[str, ...] = ()
    group: float = float("nan")
    error: float = inf
    amplification: float = 1.0
    estimated: bool = False

    @property
    def reason(self) -> str:
        """What ``error`` rests on, in words."""
        if not self.droppable:
            return ""
        if isnan(self.group):
            return "no promise"
        group = f"{GROUPS[self.name]} = {self.group:.2g}"
        if self.error == 0:
            return f"{group}, of no effect here"
        if not isfinite(self.error):
            return f"{group}: no promise"
        return group if self.amplification < 1.05 else f"{group}, amplified {self.amplification:.1f}"


@dataclass(frozen=True)
class Cost:
    """Measured processor time of one integration of one instance with residual and ``Gamma`` [s].

    Attributes:
        present: Of the scene as it is.
        without: Without each term that it can do without, by name.
    """

    present: float
    without: dict[str, float]


class Explanation:
    """The terms that a scene asks for, why, and what dropping each would do; printed, it is a table.

    Attributes:
        robot: The assembly.
        inputs: Its inputs.
        features: What is compiled in, of each kernel.
        terms: What the scene asks for.
        absent: Names of the droppable terms that it does not ask for: they are not compiled in.
        cost: What each term costs, once ``measure`` has been called.
    """

    def __init__(self, robot: Assembly, inputs: Inputs) -> None:
        self.robot = robot
        self.inputs = inputs
        self._kernels: dict[frozenset[str], tuple[Features, ...]] = {}
        self.features = self.features_without(())
        self.terms = tuple(self._terms())
        names = [term.name for term in self.terms]
        self.absent = tuple(name for name in droppable(robot) if name not in names)
        self.cost: Cost | None = None

    def __getitem__(self, name: str) -> Term:
        """The term of this name.

        Raises:
            KeyError: If the scene has none.
        """
        for term in self.terms:
            if term.name == name:
                return term
        raise KeyError(f"the scene has no term {name!r}: it has " + ", ".join(term.name for term in self.terms))

    def models(self) -> dict[str, tuple[Assembly, Inputs]]:
        """The scene without each term that can be left out and saves something, as ``tradeoff`` takes them.

        Of loads other than weight, only those whose error is known to be finite: without the others it is another scene.
        """
        terms = [term for term in self.terms if term.droppable and term.saves and (term.name in MODELLED or isfinite(term.error))]
        return {f"without {term.name}": self.without(term.name) for term in terms}

    def without(self, *names: str) -> tuple[Assembly, Inputs]:
        """The robot and the inputs without these terms, ready to be solved.

        Loads become zero; ``shear`` and ``torsion`` rigid; ``anisotropy`` the mean of both axes; ``precurvature_profile`` the
        mean over each piece that the function was resolved into; without ``discs`` lines follow the rod, without ``friction``
        they slide.

        Raises:
            ValueError: If a name is not one of a droppable term of this scene; the message lists them.
        """
        options = [term.name for term in self.terms if term.droppable]
        for name in names:
            if name not in options:
                refuse("without", name, "what can be dropped here is " + (", ".join(options) or "nothing"))
        return left_out(self.robot, self.inputs, names)

    def features_without(self, names: Iterable[str]) -> tuple[Features, ...]:
        """What would be compiled in without these terms."""
        key = frozenset(names)
        if key not in self._kernels:
            robot, inputs = left_out(self.robot, self.inputs, tuple(key))
            self._kernels[key] = robot.features(inputs)
        return self._kernels[key]

    def measure(self, *, integrator: Integrator | None = None, batch: int = 64, rounds: int = 7) -> "Explanation":
        """Measure what each droppable term costs, rounds interleaved, and return ``self``; kernels are compiled where they must.

        Args:
            integrator: ``RK4(50)`` by default.
            batch: Instances that are integrated in one launch.
            rounds: Of which the medians are taken.
        """
        method = RK4(50) if integrator is None else integrator
        positive_int("measure.batch", batch)
        scenes = {"": (self.robot, self.inputs)}
        scenes |= {term.name: left_out(self.robot, self.inputs, [term.name]) for term in self.terms if term.saves}
        runs = {name: _launch(robot, inputs, method, batch) for name, (robot, inputs) in scenes.items()}
        times: dict[str, list[float]] = {name: [] for name in runs}
        for k in range(positive_int("measure.rounds", rounds) + 1):
            for name, run in runs.items():
                taken = run()
                if k:  # the first round compiles
                    times[name].append(taken / batch)
        medians = {name: float(np.median(values)) for name, values in times.items()}
        self.cost = Cost(medians.pop(""), medians)
        return self

    # ---- rows ----

    def _terms(self) -> Iterable[Term]:
        known = self.robot.influences(self.inputs)
        for name in droppable(self.robot):
            because = self._because(name)
            if not because:
                continue
            saves = _fewer(self.features, self.features_without([name]))
            found = known.get(name)
            estimate = {} if found is None else vars(found)
            yield Term(name, because, droppable=True, saves=saves, **estimate)
        yield from self._consequences()

    def _consequences(self) -> Iterable[Term]:
        """What is compiled in beside the terms themselves."""
        loads = [name for name in loads_of(self.robot) if self.inputs.is_active(name)]
        if any(f.measured for f in self.features):
            yield Term("measured", "inputs.tip_curvature takes the place of the condition at the tip")
        embedded = [f"rods[{k}]" for k, rod in enumerate(self.robot.rods) if rod.is_embedded]
        if embedded:
            yield Term("foundation", f"{', '.join(embedded)}: an elastic medium is around them")
        loaded = [f"rods[{k}]" for k, rod in enumerate(self.robot.rods) if rod.loads]
        if loaded:
            yield Term("loads", f"{', '.join(loaded)}: loads of their own act that depend on the configuration")
        lines = [f"rods[{k}]" for k, rod in enumerate(self.robot.rods) if rod.lines]
        if lines:
            yield Term("lines", f"{', '.join(lines)}: lines run along them")
        carrying = [f"rods[{k}]" for k, rod in enumerate(self.robot.rods) if rod.members]
        if carrying:
            yield Term("members", f"{', '.join(carrying)}: carry something that gives way with them")
        profiles = [f"inputs.{name}" for name in self.inputs.profiles]
        if profiles:
            yield Term("load_profile", f"{', '.join(profiles)}: a function of arclength")
        if any(f.moment and f.torque_count for f in self.features):
            yield Term("moment", f"tubes carry a moment together under {', '.join(loads) or 'what holds their tip'}")
        if any(f.loads_need_frame for f in self.features):
            held = any(f.held for f in self.features)
            asking = ["what holds tips"] if held else [name for name in loads if name not in FRAMELESS]
            yield Term("frame", f"{', '.join(asking) or 'where the rods are'}: known in the world frame")
        if any(f.transmission for f in self.features):
            yield Term("transmission", "tubes twist behind the plate")
        if any(f.held for f in self.features):
            yield Term("held", "tips are held: base forces are unknown")
        yield Term("pose", "the pose of the tip is a result")

    def _because(self, name: str) -> str:
        """What asks for a droppable term; nothing does where that is empty."""
        if name not in ASKS:
            return self._load(name) if self.inputs.is_active(name) else ""
        if name == "anisotropy" and self.robot.rod_count == 1:
            return ""  # no term of its own
        asking = [f"rods[{k}]" for k, rod in enumerate(self.robot.rods) if ASKS[name](rod)]
        shown = ", ".join(asking) if len(asking) < 4 else f"{asking[0]} to {asking[-1]}"
        return f"{shown}: {RODS[name]}" if asking else ""

    def _load(self, name: str) -> str:
        if name in self.inputs.profiles:
            return f"inputs.{name}, a function of arclength"
        spec = next(spec for spec in self.robot.input_specs if spec.name == name)
        values = np.asarray(getattr(self.inputs, name))
        each = values[..., None] if spec.acts == "joints" else values.reshape(*values.shape[:-1], -1, 3)  # a vector each place
        largest = np.linalg.norm(each, axis=-1).max(initial=0.0)
        return f"inputs.{name}, up to {largest:.3g} {spec.unit}"

    def as_table(self) -> tuple[str, list[str], list[list[str]], str]:
        """What is printed: a line above, names of columns, a row for each term, and a line below."""
        shape = np.broadcast_shapes(self.inputs.batch_shape, self.robot.batch_shape)
        head = f"{type(self.robot).__name__} of {self.robot.rod_count} rod{'s' * (self.robot.rod_count > 1)}"
        head += f", {prod(shape)} instances" if shape else ""
        columns = ["term", "asked for by", "tip moves without it", "because", "that saves"]
        if self.cost is not None:
            head += f"; one integration {1e6 * self.cost.present:.2f} us"
            columns.append("us without it")
        rows = []
        for term in self.terms:
            known = f"{'~' if term.estimated else '<'} {term.error:.1e} L" if isfinite(term.error) else "?"
            moves = known if term.droppable else ""
            saved = (", ".join(term.saves) or "nothing") if term.droppable else ""
            row = [term.name, term.because, moves if term.error else "0", term.reason, saved]
            if self.cost is not None:
                value = self.cost.without.get(term.name)
                row.append("" if value is None else f"{1e6 * value:.2f}")
            rows.append(row)
        below = "not asked for, not compiled in: " + (", ".join(self.absent) or "nothing")
        left = [term for term in self.terms if term.droppable]
        if left and all(isnan(term.group) for term in left):
            lined = [f"rods[{k}]" for k, rod in enumerate(self.robot.rods) if rod.lines]
            holding = f"lines of {', '.join(lined)} hold" if lined else f"holds the rods of this {type(self.robot).__name__}"
            below += (
                f"\nnothing is promised, simplify= drops nothing: what {holding} back is not bounded;"
                " solve(*explanation.without(name)) says what a term does"
            )
        return head, columns, rows, below

    def __str__(self) -> str:
        head, columns, found, below = self.as_table()
        rows = [columns, *found]
        widths = [max(len(row[k]) for row in rows) for k in range(len(columns))]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        return "\n".join([head, "", *lines, "", below])

    def _repr_html_(self) -> str:
        from multirod.results import html

        return html.explanation(self)

    def __repr__(self) -> str:
        return f"Explanation({', '.join(term.name for term in self.terms)})"


def _fewer(present: Sequence[Features], without: Sequence[Features]) -> tuple[str, ...]:
    """Names of what differs between kernels."""
    names = [field.name for field in fields(Features)] + ["moment", "frame"]
    every = zip(present, without, strict=True)
    changed = {
        name
        for a, b in every
        for name in names
        if getattr(a, READ_AS.get(name, name)) != getattr(b, READ_AS.get(name, name))
        and not (name == "moment" and a.rod_count == 1)
    }
    return tuple(name for name in names if name in changed)


def _any(test: Callable[..., bool], *names: str) -> Callable[[Rod], bool]:
    return lambda rod: any(test(getattr(section, name)) for section in rod.sections for name in names)


def _finite(value: np.ndarray) -> bool:
    return bool(np.isfinite(value).any())


ASKS: dict[str, Callable[[Rod], bool]] = {
    "shear": _any(_finite, "shear_stiffness", "axial_stiffness"),
    "torsion": _any(_finite, "torsional_stiffness"),
    "anisotropy": _any(lambda value: bool((value[..., 0] != value[..., 1]).any()), "bending_stiffness"),
    "precurvature_profile": _any(callable, "precurvature"),
    "discs": lambda rod: any(line.discs for line in rod.lines),
    "friction": lambda rod: any(line.rubs for line in rod.lines),
}


def _launch(robot: Assembly, inputs: Inputs, integrator: Integrator, batch: int) -> Callable[[], float]:
    """Processor time of one evaluation of a batch [s]."""
    count = prod(np.broadcast_shapes(inputs.batch_shape, robot.batch_shape))
    problem = robot.problem(inputs, integrator=integrator, instances=np.arange(batch) % count)
    problem.write("unknowns", problem.guess())

    def measure() -> float:
        times = []
        for _ in range(LAUNCHES):
            begin = process_time()
            problem.integrate()
            times.append(process_time() - begin)
        return float(np.median(times))

    return measure


@names_checked
def explain(robot: Assembly, inputs: Inputs | None = None, *, measure: bool = False) -> Explanation:
    """Say which terms of the equations a scene asks for, why, and what dropping each would do to the tip (``docs/explain.md``).

    Args:
        robot: The assembly.
        inputs: Made by ``robot.inputs(...)``; none are all zero.
        measure: Whether to measure what each term costs as well, which takes seconds where kernels have to be compiled.

    Returns:
        The terms; print it for a table.

    Raises:
        TypeError: If ``robot`` is no assembly, or ``inputs`` are not made by it.
        NotImplementedError: If the assembly does not say what is compiled in.
    """
    if not isinstance(robot, Assembly):
        raise TypeError(f"robot must be an assembly such as SingleRod(rod), not {type(robot).__name__}")
    wanted = boolean("measure", measure)
    found = Explanation(robot, robot.accept(inputs))
    return found.measure() if wanted else found
