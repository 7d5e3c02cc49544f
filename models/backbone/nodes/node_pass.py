"""A pass over nodes, which writes what it finds to arrays of its own."""

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from multirod.kernels.warp_types import Struct
from multirod.models.backbone.passes.buffers import NODE_FIELDS, TOTALS, holder
from multirod.models.backbone.passes.lane_pass import LanePass

Tool = TypeVar("Tool")


class NodePass:
    """A pass over nodes, which may be launched again.

    Args:
        call: Its arguments, with outputs of its own.
        launch: Its launch.
        columns: Whether it carries columns.
        members: Whether the rod carries members.
        host: Whether NumPy sees its arrays in place.
    """

    def __init__(self, call: Struct, launch: LanePass, columns: bool, members: bool, host: bool) -> None:
        self.call, self.launch, self.columns, self._in_place = call, launch, columns, host
        self._outputs = [*(f"node_{name}" for name in NODE_FIELDS), "energy", "work", "residual", "position", "rotation"]
        if members:
            self._outputs += [*(f"node_{name}" for name in TOTALS), "line_length", "node_left"]
        if columns:
            self._outputs += ["node_columns", "tip_columns", "gamma", "pose_columns", "column_arclength"]
        self._seen: dict[str, Any] = {}
        self._tools: dict[Hashable, Any] = {}

    def tool(self, key: Hashable, make: Callable[[], Tool]) -> Tool:
        """What works on its outputs: made once, under a key."""
        if key not in self._tools:
            self._tools[key] = make()
        found: Tool = self._tools[key]
        return found

    def read(self, name: str) -> NDArray[Any]:
        """An output, as it is until the next launch."""
        if name not in self._seen or not self._in_place:
            self._seen[name] = getattr(holder(self.call, name), name).numpy()
        found: NDArray[Any] = self._seen[name]
        return found

    def write(self, name: str, values: ArrayLike) -> None:
        """Set an argument."""
        if self._in_place:
            self.read(name)[:] = values
        else:
            target = getattr(holder(self.call, name), name)
            target.assign(np.asarray(values, dtype=np.int32 if target.dtype is wp.int32 else np.float64))

    def clear(self) -> None:
        """Outputs as they were at first, where they are seen in place."""
        for name in self._outputs:
            self.read(name).fill(np.nan if name == "column_arclength" else 0.0)

    def lose(self, instances: NDArray[np.bool_]) -> None:
        """Nothing is known of these instances: NaN but for where nodes are."""
        for name in self._outputs:
            if name not in ("node_arclength", "column_arclength") and getattr(holder(self.call, name), name).size:
                values = np.array(self.read(name))
                values[instances] = np.nan
                self.write(name, values)
