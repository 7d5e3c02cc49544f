"""Results over time."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from multirod.assembly import Robot_co
from multirod.inputs import Inputs
from multirod.naming import names_checked
from multirod.results.events import timed_events
from multirod.results.scene import Scene
from multirod.results.solution import Solution
from multirod.solver import Outcome
from multirod.status import failures
from multirod.types import AxesGiven, AxesOrArray, HistoryOptions, Numbers, QuantityOverTime, ShowOptions
from multirod.validation import FloatArray, array, frozen, number, refuse, sequence


class History(Solution[Robot_co]):
    """A time series of equilibria: the fields of ``Solution`` with time as the first axis.

    Attributes:
        time: Of each sample [s], shape (sample_count,).
        step_time: Measured time that each sample took [s], shape (sample_count,).
        description: What was run, for tables and recordings.
    """

    written = frozenset({"time", "step_time", "description"})

    def __init__(
        self,
        scene: Scene[Robot_co],
        records: FloatArray,
        outcome: Outcome,
        inputs: Inputs,
        *,
        time: FloatArray,
        step_time: FloatArray,
        description: str = "",
    ) -> None:
        super().__init__(scene, records, outcome, inputs)
        self.time: FloatArray = frozen(time)
        if outcome.events:
            failed = failures(np.reshape(outcome.status, (len(time), -1)))
            outcome.events = timed_events(outcome.events, self.time, failed)
        self.step_time: FloatArray = frozen(step_time)
        self.description = description

    @staticmethod
    def of(
        samples: Sequence[Solution[Robot_co]],
        *,
        time: Numbers,
        step_time: Numbers | None = None,
        description: str = "",
    ) -> "History[Robot_co]":
        """Samples of a loop as one history, as ``simulate`` gives it: of a ``Tracker``, a ``Controller`` or an ``Estimator``.

        What a ``Command`` or an ``Estimate`` says beyond a ``Solution`` stays with the samples.

        Args:
            samples: Solutions of one robot, of the same inputs by name; of an ``Estimate`` its ``solution``.
            time: Of each [s], increasing, shape (sample_count,).
            step_time: That each took [s], shape (sample_count,); NaN by default.
            description: Of what was run, for tables and recordings.

        Raises:
            TypeError: If a sample is no ``Solution``.
            ValueError: If there are none, they are not of one kind, or times are not as many, or do not increase.
        """
        several = sequence(
            "History.of.samples", samples, Solution, "Solutions, such as a Tracker's samples, or the solution of each Estimate"
        )
        if not several:
            refuse("History.of.samples", samples, "must be one or more")
        first = several[0]
        for k, sample in enumerate(several):
            same_robot = sample.assembly is first.assembly and sample.batch_shape == first.batch_shape
            if not (same_robot and alike(first, sample)):
                said = "must be of the same robot, leading axes and inputs by name as the first"
                refuse(f"History.of.samples[{k}]", sample, f"{said}; a load that comes later must be named at the start")
        count = (len(several),)
        times = array("History.of.time", time, count)
        if not (np.diff(times) > 0).all():
            refuse("History.of.time", time, "must increase from each sample to the next")
        took = np.full(count, np.nan) if step_time is None else array("History.of.step_time", step_time, count, finite=False)
        return stack(several, times, took, description)

    if TYPE_CHECKING:  # time is an axis

        @cached_property
        def status(self) -> NDArray[np.int32]:
            """Values of ``Status``, shape (sample_count, ...)."""

        @cached_property
        def index(self) -> NDArray[np.int32]:
            """Unstable modes of each equilibrium, shape (sample_count, ...); -1 where it cannot be said."""

        @cached_property
        def stability(self) -> NDArray[np.int32]:
            """Values of ``Stability``, shape (sample_count, ...)."""

    def inputs_at(self, time: float) -> Inputs:
        """The inputs at any time, as they change evenly from each sample to the next: of an event, what acted when it happened.

        Args:
            time: [s], from that of the first sample to that of the last, such as ``event.time``.

        Returns:
            The inputs, without the axis of time.

        Raises:
            ValueError: If ``time`` is another.
        """
        at = number("History.inputs_at.time", time)
        if not self.time[0] <= at <= self.time[-1]:
            refuse("History.inputs_at.time", time, f"must be from {self.time[0]:g} to {self.time[-1]:g}, times of samples, in s")
        after = min(int(np.searchsorted(self.time, at)), len(self.time) - 1)
        before = max(after - 1, 0)
        part = (at - self.time[before]) / (self.time[after] - self.time[before]) if after else 1.0
        whole = {name: getattr(self._applied, name) for name in self._applied.arrays}
        arrays = {name: (1 - part) * values[before] + part * values[after] for name, values in whole.items()}
        return self._applied.with_arrays(arrays, self.batch_shape[1:])

    def save(self, path: str | PathLike[str], **options: Unpack[HistoryOptions]) -> None:
        """Write the history to a file, by its ending: what ``Solution.save`` says, or ``.rrd``.

        Args:
            path: File to write; an existing one is replaced. ``.rrd`` is a recording for the Rerun viewer; options are those of
                ``multirod.recording.save``.
            **options: As for ``Solution.save``; of ``.rrd``, as said.

        Raises:
            TypeError, ValueError, ImportError: As for ``Solution.save``.
        """
        from multirod.files.saving import save_result

        save_result(path, self, options)

    def show(self, **options: Unpack[ShowOptions]) -> None:
        """Show a recording in a notebook, by Rerun's widget; options as for ``multirod.recording.notebook.show``.

        Raises:
            ImportError: If the widget is not there: ``pip install "multirod[notebook]"``.
        """
        from multirod.recording.notebook import show

        show(self, **options)

    def _repr_html_(self) -> str:
        from multirod.results import html

        return html.history(self)

    @names_checked
    def plot(
        self,
        quantity: QuantityOverTime = "shape",
        *,
        ax: AxesGiven | None = None,
        rod: int | str | None = None,
        instance: int | tuple[int, ...] = 0,
        instances: int | None = None,
        colour_by: str | Numbers | None = None,
        colour_label: str = "",
        nodes: int | None = None,
        frames: bool = True,
        loads: bool = True,
    ) -> AxesOrArray:
        """Plot shapes at some times, a quantity along the arclength at some times, or a quantity over time.

        The quantities of ``Solution.plot`` (``shape``, ``tips``, ``curvature``, ``moment``, ``force``, ``strain``) are drawn at
        ``instances`` times, coloured by time; ``shape`` also has the path of the tip. Over time there are:

        ============================================  ============================================================================
        quantity                                      what is drawn
        ============================================  ============================================================================
        ``tip``                                       position of the tip [m]
        ``inputs``                                    inputs that were given as numbers, an axes for each
        ``unknowns``                                  [1/m]
        ``residual``                                  [1/m], logarithmic
        ``condition``, ``smallest_singular_value``    of ``Gamma``, logarithmic
        ``energy``                                    elastic energy [J]
        ``stability_margin``                          as the property of this name
        ``iterations``, ``integrations``              of each sample
        ``step_time``                                 time that each sample took [ms]
        ``tension``, ``line_length``                  of lines [N], [m]
        ============================================  ============================================================================

        Samples without a result are marked by crosses on the time axis. Instances of a batch are drawn over time in one axes for
        each component, coloured by ``colour_by``.

        Args:
            quantity: One of the above.
            ax: Axes to draw on, as many as the quantity needs; by default those of a new figure.
            rod: Index or name of the only rod to be drawn; all by default.
            instance: Of a batch, which one is drawn in space or along the arclength: its number, or an index.
            instances: How many samples (in space, along the arclength) or instances (over time) are drawn at most, evenly chosen;
                by default 12, of tips all.
            colour_by: Over time, what instances are coloured by: an array of the batch's shape; by default their number.
            colour_label: Of the colour bar.
            nodes: Of each rod; by default 51 in space, 301 along the arclength.
            frames: Whether frames are drawn.
            loads: Whether loads are drawn, of a single sample.

        Returns:
            The axes, or an array of them, shape (k,).

        Raises:
            ValueError: If there is no such quantity, rod or instance, or ``ax`` is not what it takes.
            ImportError: If matplotlib is not there: ``pip install "multirod[plot]"``.
            NotImplementedError: If the assembly offers no shapes.
        """
        from multirod.plotting import plot_history

        options: dict[str, Any] = {
            "instances": instances,
            "colour_by": colour_by,
            "colour_label": colour_label,
            "nodes": nodes,
            "frames": frames,
            "loads": loads,
        }
        return plot_history(self, quantity, ax=ax, rod=rod, instance=instance, **options)


def alike(one: Solution[Any], other: Solution[Any]) -> bool:
    """Whether two samples of a robot can be part of one history: the same records, the same inputs by name."""
    return one._scene is other._scene or (
        one._scene.fields == other._scene.fields
        and one._applied.given == other._applied.given
        and all(other._applied.profile(name) is profile for name, profile in one._applied.profiles.items())
    )


def stack(
    samples: Sequence[Solution[Robot_co]], times: FloatArray, durations: FloatArray, description: str = ""
) -> History[Robot_co]:
    """Samples that are ``alike`` as a history, so that all their shapes are integrated in one batch."""
    first = samples[0]
    arrays: dict[str, FloatArray] = {}
    for name in first._applied.arrays:
        rows = [getattr(sample._applied, name) for sample in samples]
        arrays[name] = np.stack([np.broadcast_to(row, (*first.batch_shape, row.shape[-1])) for row in rows])
    outcome = Outcome.joined([sample._outcome for sample in samples])
    records = np.concatenate([sample._records for sample in samples])
    batch_shape = (len(samples), *first.batch_shape)
    inputs = first._applied.with_arrays(arrays, batch_shape)
    scene = replace(first._scene, batch_shape=batch_shape)
    return History(scene, records, outcome, inputs, time=times, step_time=durations, description=description)
