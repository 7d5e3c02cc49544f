"""Whether commands of a controller may be given: those of samples that ask. Numbers in parentheses: ``docs/tasks.md``."""

import numpy as np
from numpy.typing import NDArray

from multirod.status import Status
from multirod.tasks.controlling.control import ControlStep
from multirod.tasks.controlling.control_kernels import SINGULAR
from multirod.tasks.controlling.shape_limits import Look, ShapeLimits
from multirod.tasks.formulation import Task
from multirod.tasks.watch import Watch
from multirod.validation import FloatArray

THE_ONE = np.arange(1)  # the number of the only instance


class Judge:
    """Looks at commands.

    Args:
        task: Of the controller.
        watch: Of its samples.
        step: That they are of.
    """

    def __init__(self, task: Task, watch: Watch, step: ControlStep) -> None:
        self._task, self._watch, self._step = task, watch, step

    def in_shape(self, shape: ShapeLimits, record: FloatArray, told: FloatArray, status: int) -> int:
        """(18) A command that is beyond a limit of the shape is not given: the last one is, if that is within them still."""
        fields = self._task.problem.record_fields

        def looked() -> Look:
            return shape.look(record[:, fields["unknowns"]], record[:, fields["inputs"]], self._step.by)

        shape.integrations = 0
        found = looked()
        short = shape.shortened(found, bool(told[SINGULAR]))
        beyond = shape.refuses(found)
        if beyond.any():
            self._step.stay(record)
            found = looked()
            if shape.within(found):
                for name, values in shape.settled(found).items():
                    record[0, fields[name]] = values
            self._step.stayed(record, told, beyond)
            status = int(Status.AT_LIMIT if shape.within(found) else Status.OUT_OF_LIMITS)
        elif short.any():
            told[SINGULAR] = 0.0
            self._step.hold(told, short)
            status = int(Status.AT_LIMIT)
        self._step.limit_shape(*shape.rows(found), shape.longest)
        return status

    def unstable(self, record: FloatArray, told: FloatArray) -> tuple[bool, NDArray[np.int32]]:
        """Whether a command is unstable: by an integration at it, and where ``Gamma`` there does not say so, by its modes; and
        how many that took."""
        problem, fields = self._task.problem, self._task.problem.record_fields
        names = "unknowns", "inputs"
        ahead = [problem.read(name) for name in names]
        for name in names:
            problem.write(name, record[:, fields[name]])
        stable, spent = self._watch.look(THE_ONE)
        if stable[0]:
            ahead[0] += problem.read("unknowns") - record[:, fields["unknowns"]]
            self._step.settled(record, told)
        for name, values in zip(names, ahead, strict=True):
            problem.write(name, values)
        return not stable[0], spent
