"""What a solve or a motion came to, gathered from its parts."""

from threading import Lock
from typing import Any

import numpy as np

from multirod.batch import IntArray
from multirod.problem import BoundaryProblem
from multirod.results.events import Events, placed_events
from multirod.segments import Breakpoints, placed
from multirod.solver import Outcome
from multirod.validation import FloatArray


class Results:
    """Records and outcomes of all samples and instances, filled in part by part; nothing is kept twice."""

    def __init__(self, samples: int, count: int) -> None:
        self._shape = (samples, count)
        self._lock = Lock()
        self._outcome: dict[str, Any] = {}
        self._breakpoints: dict[int, Breakpoints] = {}
        self._events: Events = {}
        self.fields: dict[str, slice] = {}
        self.records: FloatArray = np.zeros(0)

    def put_none(self, problem: BoundaryProblem) -> None:
        """Take the shapes of a problem, where there is nothing to be solved."""
        outcome = Outcome.zeros(0)
        self.fields, width = problem.fields_found
        self.records = np.empty((*self._shape, width))
        self._outcome = {name: value.reshape(self._shape) for name, value in outcome.arrays.items()}

    def put(self, sample: int, piece: IntArray, records: FloatArray, outcome: Outcome, problem: BoundaryProblem) -> None:
        """Take in what some of the instances, (k,), came to; on any thread."""
        values = outcome.arrays
        with self._lock:
            if outcome.breakpoints or outcome.events:
                numbers = sample * self._shape[1] + piece
                self._breakpoints |= placed(outcome.breakpoints, numbers)
                self._events |= placed_events(outcome.events, numbers)
            if self._shape == (1, len(piece)):  # all at once, in their order
                self.fields, width = problem.fields_found
                self.records = np.array(records[None, :, :width])
                self._outcome = {name: np.array(value[None]) for name, value in values.items()}
                return
            if not self.fields:
                self.fields, width = problem.fields_found
                self.records = np.empty((*self._shape, width))
                self._outcome = {name: np.empty((*self._shape, *v.shape[1:]), v.dtype) for name, v in values.items()}
            for name in self._outcome.keys() - values.keys():
                del self._outcome[name]  # not all parts have it
        self.records[sample, piece] = records[:, : self.records.shape[-1]]
        for name in self._outcome.keys() & values.keys():
            self._outcome[name][sample, piece] = values[name]

    def outcome(self) -> Outcome:
        """The outcomes of all samples, one after another."""
        arrays = {name: value.reshape(-1, *value.shape[2:]) for name, value in self._outcome.items()}
        return Outcome(**arrays, breakpoints=self._breakpoints, events=self._events)
