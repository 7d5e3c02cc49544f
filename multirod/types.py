"""Types of what is given and what comes back, for type checkers and editors; nothing is computed here.

A result of ``solve`` is one instance or a batch, as its inputs are, and no checker can tell which. So ``StatusOrArray`` and its
like are known to it as arrays that also have what one ``Status`` has: both uses pass, editors complete both, and a name that
neither has is reported. A plain union would refuse whatever one of the two does not allow, ``Any`` would refuse nothing. Where a
function takes one, ``mr.Status(int(solution.status))`` says that it is one. A ``History`` always has a time axis: its are arrays.
"""

from collections.abc import Callable, Iterator, Sequence
from types import EllipsisType
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, Protocol, TypeAlias, TypedDict, TypeVar

import numpy as np
from numpy.typing import NDArray

from multirod.stability import Stability
from multirod.status import Status

if TYPE_CHECKING:
    import warp as wp
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from multirod.frames import Framed
    from multirod.inputs import Inputs
    from multirod.results.history import History

    class SupportsArray(Protocol):
        """What NumPy makes an array of: its own arrays and numbers, series, tensors."""

        def __array__(self) -> NDArray[Any]:
            """As an array."""

    Number: TypeAlias = float | SupportsArray
    Numbers: TypeAlias = Number | Sequence[Number] | Sequence[Sequence[Number]] | Sequence[Sequence[Sequence[Number]]]
    Poses: TypeAlias = Numbers | Framed | Sequence[Numbers | Framed]
    AlongRod: TypeAlias = Numbers | Callable[[float], Numbers]
    Precurvature: TypeAlias = AlongRod | Sequence[tuple[Numbers, AlongRod]]
    Index: TypeAlias = (
        int | np.integer[Any] | slice | EllipsisType | None | NDArray[Any] | Sequence[int] | Sequence[bool] | tuple["Index", ...]
    )

    WarpArray: TypeAlias = wp.array[Any, Any]

    class StatusOrArray(NDArray[np.int32]):
        """A ``Status``; of a batch, an array of its values."""

        @property
        def name(self) -> str:
            """Of one instance: its name, such as ``"CONVERGED"``."""

        @property
        def value(self) -> int:
            """Of one instance: its number."""

        @property
        def message(self) -> str:
            """Of one instance: what happened, and what to try."""

        @property
        def failed(self) -> bool:
            """Of one instance: whether there is no result."""

    class StabilityOrArray(NDArray[np.int32]):
        """A ``Stability``; of a batch, an array of its values."""

        @property
        def name(self) -> str:
            """Of one instance: its name, such as ``"STABLE"``."""

        @property
        def value(self) -> int:
            """Of one instance: its number."""

    AxesGiven: TypeAlias = Axes | Sequence[Axes] | NDArray[Any]

    class AxesOrArray(Axes):
        """What a plot returns: axes, of a shape those in space; of several components or rods an array of them, shape (k,)."""

        figure: Figure

        def set_zlim(self, bottom: float | None = None, top: float | None = None) -> tuple[float, float]:
            """Of axes in space."""

        def get_zlim(self) -> tuple[float, float]:
            """Of axes in space."""

        def set_zlabel(self, zlabel: str) -> None:
            """Of axes in space."""

        def view_init(self, elev: float | None = None, azim: float | None = None, roll: float | None = None) -> None:
            """Of axes in space."""

        def __len__(self) -> int:
            """Of an array."""

        def __getitem__(self, k: int) -> Axes:
            """Of an array."""

        def __iter__(self) -> Iterator[Axes]:
            """Of an array."""

else:  # ``help`` shows these by their names, not what they stand for

    class Numbers:
        """A number, an array, or nested lists or tuples of them."""

    class Poses:
        """Matrices, shape (..., 4, 4), a ``Pose`` with a position and a rotation, or a list of these."""

    class AlongRod:
        """The same as ``Numbers``, or a function of the arclength [m] that returns it."""

    class Precurvature:
        """``Numbers``, a function of the arclength [m], or ``(section length, either)`` pairs."""

    class Index:
        """An index of an array, as NumPy takes it."""

    class AxesGiven:
        """Axes of matplotlib, or several of them."""

    class AxesOrArray:
        """Axes of matplotlib, or an array of them."""

    class WarpArray:
        """An array of Warp, of any kind and number of axes."""

    StatusOrArray = Status | NDArray[np.int32]
    StabilityOrArray = Stability | NDArray[np.int32]


class SaveOptions(TypedDict, total=False):
    """Options of ``Solution.save``."""

    nodes: int
    """Of a rod."""
    rows: Literal["nodes", "instances"]
    """Of a ``.csv``: one for each node of each rod, or for each instance."""
    corners: int
    """Of meshes: of the polygons in the place of circles."""


class RecordingOptions(TypedDict, total=False):
    """Options of ``multirod.recording.save``."""

    nodes: int
    """Of a rod."""
    reference: "History | None"
    """The same samples of another run, drawn in grey."""
    reference_name: str
    """What the reference is called."""
    name: str | None
    """What the viewer calls the recording."""
    instances: int
    """How many instances of a batch are recorded."""
    force_scale: float | None
    """Length of force arrows [m/N]."""
    colour_by: "str | Numbers | None"
    """What colours the rods: a quantity, or an array."""


class HistoryOptions(RecordingOptions, SaveOptions, total=False):
    """Options of ``History.save``."""


class ShowOptions(RecordingOptions, total=False):
    """Options of ``History.show``."""

    width: int | Literal["auto"]
    """Of the viewer [px]."""
    height: int | Literal["auto"]
    """Of the viewer [px]."""


Parameter: TypeAlias = Literal[
    "precurvature", "bending_stiffness", "torsional_stiffness", "length", "foundation", "magnetisation", "base", "platform"
]
"""Of robots, by which ``Solution.jacobian`` differentiates, beside inputs."""

Quantity: TypeAlias = Literal["shape", "tips", "curvature", "moment", "force", "strain", "tension"]
"""What ``Solution.plot`` draws."""

QuantityOverTime: TypeAlias = Literal[
    Quantity,
    "tip",
    "inputs",
    "unknowns",
    "residual",
    "condition",
    "smallest_singular_value",
    "energy",
    "stability_margin",
    "iterations",
    "integrations",
    "step_time",
    "line_length",
]
"""What ``History.plot`` draws."""

P = ParamSpec("P")
Name = TypeVar("Name")


class Takes(Protocol[P]):
    """A robot, by the inputs that it takes."""

    def inputs(self, *args: P.args, **values: P.kwargs) -> "Inputs":
        """Inputs by name."""


class Named(Protocol[Name]):
    """A robot, by the names of its inputs."""

    _input_name: Name
