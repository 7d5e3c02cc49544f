"""The compiled second variation of backbones with a free tip: its arrays, and its launch."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from multirod.launch import record
from multirod.models.backbone.stability.form_kernels import Form, make_form
from multirod.models.backbone.stability.second_variation import CondensedForm, NodeColumns, condensed_form
from multirod.shared import Shared
from multirod.validation import FloatArray


class CompiledForm:
    """(4) to (6) of ``docs/stability.md`` of what a pass over nodes says, as ``condensed_form`` has it.

    Args:
        call: Arguments of the pass, whose outputs are read.
        size: Numbers that are free at the tip, ``m``.
        rods: How many have ends.
        device: Warp device.
    """

    def __init__(self, call: Any, size: int, rods: int, device: str) -> None:
        state: Any = Form()
        self._state, count = state, len(call.column_arclength)
        state.arclength, state.configuration, state.momenta = call.column_arclength, call.node_columns, call.tip_columns
        given = {"wanted": ((), wp.int32), "ends": ((rods,), wp.float64), "unit": ((), wp.float64)}
        found = {"matrix": ((size, size), wp.float64)} | dict.fromkeys(("conjugate", "known", "open"), ((), wp.int32))
        self._shared: dict[str, Shared] = {}
        for name, (shape, dtype) in (given | found).items():
            self._shared[name] = shared = Shared((count, *shape), dtype, device)
            setattr(state, name, shared.array)
        state.kept = wp.zeros((count, size), dtype=wp.int32, device=device)
        for name in ("basis", "torque", "here", "inverse", "before", "ratio", "work"):
            setattr(state, name, wp.zeros((count, size, size), dtype=wp.float64, device=device))
        self._launch = record(make_form, count, [state], device)

    def of(self, chosen: NDArray[np.bool_], ends: FloatArray, unit: FloatArray) -> CondensedForm:
        """That of the instances chosen (batch,), whose rods end at ``ends`` (batch, rod), ``unit`` being ``K/L`` (batch,)."""
        state, shared = self._state, self._shared
        for name, values in {"wanted": chosen, "ends": ends, "unit": unit}.items():
            shared[name].values[:] = values
            shared[name].send()
        self._launch.launch()
        for name in ("matrix", "conjugate", "known", "open"):
            shared[name].fetch()
        matrix, conjugate, known, left = (shared[name].values[chosen] for name in ("matrix", "conjugate", "known", "open"))
        result = CondensedForm(matrix, conjugate, known != 0)
        if left.any():
            rows = np.flatnonzero(chosen)[left != 0]
            size = matrix.shape[1]
            columns = NodeColumns(
                state.arclength.numpy()[rows],
                state.configuration.numpy()[rows][:, :, :size, :size],
                state.momenta.numpy()[rows][:, :size, :size],
                ends[rows],
            )
            result.put(left != 0, condensed_form(columns, unit[rows]))
        return result
