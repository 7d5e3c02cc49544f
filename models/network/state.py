"""Where bodies, joints and the ends of rods are. Numbers in parentheses are those of ``docs/networks.md``."""

from typing import TYPE_CHECKING

import numpy as np

from multirod.models.network.elements.elements import Holding
from multirod.models.network.places import FIXED, LOADED
from multirod.models.network.poses import frames_of
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.network.problem import NetworkProblem


class State:
    """Bodies and ends of rods of all instances at their unknowns and inputs, for what is asked once; axes (instance, rod, ...).

    Attributes:
        angles: Coordinates of the joints at bases, then at tips, by which they slide in lengths of rods, shape (instance, rod,
            3).
    """

    def __init__(self, problem: "NetworkProblem") -> None:
        own = problem
        x = own.read("unknowns")
        self.inputs = own.read("inputs")
        self.level = own.closing.level()
        self.frames = frames_of(own)
        length = own.length[:, : own.rod_count]
        padded = np.concatenate([x, np.zeros((len(x), 1))], axis=1)
        # laid out alike in every batch, and so summed in one order
        self.angles = [length[..., None] * np.ascontiguousarray(padded[:, own.places[:, at]]) for at in own.layout.angles_at]
        if own.graph.is_driven:  # (24)
            driven = own.graph.driven_angles(self.inputs[..., own.driven_place])
            self.angles = [free + given for free, given in zip(self.angles, driven, strict=True)]
        left = (1 - own.buffer("load_factor"))[:, None, None]
        arms = own.attachments[0][0], own.attachments[1][0] + left * own.closing.shift  # (29)
        self.ends = [
            Holding(self.frames, end.stand, (arms[k], own.attachments[k][1]), end.table.at(self.angles[k]))
            for k, end in enumerate(own.graph.ends)
        ]

        self._units = [end.table.unit for end in own.graph.ends]

    @property
    def coordinates(self) -> FloatArray:
        """Coordinates of the joints in radians and metres, shape (instance, end, rod, 3); bases come first."""
        return np.stack([own * unit for own, unit in zip(self.angles, self._units, strict=True)], axis=1)

    def take(self, problem: "NetworkProblem", name: str) -> FloatArray:
        """An input, shape (instance, size)."""
        return np.asarray(self.inputs[..., problem.input_slice(name)])


def reference_state(problem: "NetworkProblem") -> State:
    """All instances where the poses of bodies are zero and those that are fixed have not been moved."""
    kept = {name: problem.read(name) for name in ("unknowns", "inputs")}
    unmoved = {name: values.copy() for name, values in kept.items()}
    unmoved["unknowns"][:, problem.first_pose :] = 0.0
    for name in FIXED if problem.graph.fixed else ():
        unmoved["inputs"][:, problem.input_slice(name)] = 0.0
    for name, values in unmoved.items():
        problem.write(name, values)
    state = problem.state()
    for name, values in kept.items():
        problem.write(name, values)
    return state


def forces_on(problem: "NetworkProblem", state: State) -> tuple[FloatArray, FloatArray]:
    """Dead forces on bodies and tips, and weights of bodies, shapes (instance, place, 3), (instance, body, 3)."""
    level = state.level[:, None, None]
    weight = level * problem.graph.mass[:, None] * state.take(problem, "gravity")[:, None]
    values = state.take(problem, LOADED[0])
    return level * values.reshape(*values.shape[:-1], len(problem.graph.load_places), 3), weight
