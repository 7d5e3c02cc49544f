"""The compiled second variation of backbones: its arrays, and its launch."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.kernels.shared import Shared
from multirod.kernels.warp_types import Array, Launch, Struct
from multirod.launch import record
from multirod.models.backbone.nodes.node_pass import NodePass
from multirod.models.backbone.stability.condensing.by_nodes import compliance_form, condensed_form
from multirod.models.backbone.stability.condensing.form_kernels import Form, make_form
from multirod.models.backbone.stability.condensing.second_variation import CondensedForm, NodeColumns
from multirod.validation import FloatArray


@dataclass(frozen=True)
class HeldTip:
    """What a form by a tip that is held needs beside the columns at nodes.

    Attributes:
        wrench_columns: Of force and moment on it by the unknowns, the kernels' array (batch, 6, c or more).
        wrench: Force and moment on it, the kernels' array (batch, 6).
        by_wrench: Whether the form is that by the wrench, ``compliance_form``.
    """

    wrench_columns: Any
    wrench: Any
    by_wrench: bool = False


def form_of(made: NodePass, size: int, rods: int, device: str, tip: HeldTip | None = None) -> "CompiledForm":
    """What condenses the columns of a pass over nodes to the tip, kept with it."""
    by_wrench = tip is not None and tip.by_wrench
    return made.tool(("form", by_wrench), lambda: CompiledForm(made.call, size, rods, device, tip))


class CompiledForm:
    """(4) to (6), (20), (21) of ``docs/stability.md`` of what a pass over nodes says, as ``condensed_form`` has it, or (12) of
    ``docs/held.md``, as ``compliance_form`` has it.

    Args:
        call: Arguments of the pass, whose outputs are read.
        size: Angles that are free at the tip, ``m``.
        rods: How many have ends.
        device: Warp device.
        tip: Of one that is held; None of a free one.
    """

    def __init__(self, call: Struct, size: int, rods: int, device: str, tip: HeldTip | None = None) -> None:
        state: Any = Form()
        self._state, self._tip, self._free, count = state, tip, size, len(call.column_arclength)
        state.arclength, state.configuration, state.momenta = call.column_arclength, call.node_columns, call.tip_columns
        columns = size
        if tip is not None:
            columns = size + 3
            state.wrench, state.pose, state.by_wrench = tip.wrench_columns, call.problem.pose_columns, int(tip.by_wrench)
            state.tip_wrench = tip.wrench
        given = {"wanted": ((), wp.int32), "ends": ((rods,), wp.float64), "unit": ((), wp.float64)}
        found = {"matrix": ((columns, columns), wp.float64)} | dict.fromkeys(("conjugate", "known", "open"), ((), wp.int32))
        self._shared: dict[str, Shared] = {}
        for name, (shape, dtype) in (given | found).items():
            self._shared[name] = shared = Shared((count, *shape), dtype, device)
            setattr(state, name, shared.array)
        state.kept = wp.zeros((count, size), dtype=wp.int32, device=device)
        for name in ("basis", "torque", "here", "inverse", "before", "ratio", "work"):
            setattr(state, name, wp.zeros((count, columns, columns), dtype=wp.float64, device=device))
        self._launch = record(make_form, count, [state], device)

    @property
    def launch(self) -> Launch:
        """The recorded launch."""
        return self._launch

    def array(self, name: str) -> Array:
        """What kernels share with it: ``ends`` and ``unit``, which it is given, or what it finds."""
        found: Array = self._shared[name].array
        return found

    def values(self, name: str) -> FloatArray:
        """The same as NumPy sees it: on the CPU in place."""
        return self._shared[name].fetched()

    def want_all(self) -> None:
        """Have launches condense all instances."""
        self._shared["wanted"].write(1)

    def of(self, chosen: NDArray[np.bool_], ends: FloatArray, unit: FloatArray) -> CondensedForm:
        """That of the instances chosen (batch,), whose rods end at ``ends`` (batch, rod), ``unit`` being ``K/L`` (batch,)."""
        shared = self._shared
        for name, values in {"wanted": chosen, "ends": ends, "unit": unit}.items():
            shared[name].values[:] = values
            shared[name].send()
        self._launch.launch()
        for name in ("matrix", "conjugate", "known", "open"):
            shared[name].fetch()
        found = (shared[name].values for name in ("matrix", "conjugate", "known", "open"))
        whole = bool(chosen.all())
        matrix, conjugate, known, left = (values.copy() if whole else values[chosen] for values in found)
        result = CondensedForm(matrix, conjugate, known != 0)
        if left.any():
            rows = np.flatnonzero(chosen)[left != 0]
            result.put(left != 0, self._by_numpy(rows, ends[rows], unit[rows]))
        return result

    def _by_numpy(self, rows: NDArray[np.intp], ends: FloatArray, unit: FloatArray) -> CondensedForm:
        """Of instances whose eigenvalues the kernel could not tell apart."""
        state, tip, m = self._state, self._tip, self._free
        n = m if tip is None else m + 3
        arclength, configuration, momenta = (
            array.numpy()[rows] for array in (state.arclength, state.configuration, state.momenta)
        )
        configuration, momenta = configuration[:, :, :m, :n], momenta[:, :m, :n]
        if tip is None:
            return condensed_form(NodeColumns(arclength, configuration, momenta, ends), unit)
        wrench, position = tip.wrench_columns.numpy()[rows, :, :n], state.pose.numpy()[rows, :3, :n]
        momenta = np.concatenate([wrench[:, 3:], momenta[:, 3:]], axis=1)
        columns = NodeColumns(arclength, configuration, momenta, ends, wrench[:, :3], position)
        return compliance_form(columns, tip.wrench.numpy()[rows, 3:]) if tip.by_wrench else condensed_form(columns, unit)
