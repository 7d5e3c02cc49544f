"""What the unknowns of a backbone mean: the rods they belong to, where they begin, and those of a problem with other terms."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.layout import residuals_of, unknowns_of
from multirod.models.backbone.kernels.layout.members import drive_places
from multirod.models.backbone.units import unit_stiffness
from multirod.problem import Block
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem


def blocks_of(features: Features) -> list[Block]:
    """One block a rod with a torque of its own, the outermost first; what is left is the innermost's, and couples the others.

    What is left of rods side by side is that of the line they share. A line that is driven by its displacement has its own,
    before its rod's. An unknown base force, which all rods share, is the last.
    """
    slots = unknowns_of(features)
    rows = residuals_of(slots)

    def block(name: str, residual: str, rod: int | None, numbers: slice = slice(None)) -> Block:
        """Of the unknowns that a residual stands for, or some of them."""
        own = [np.arange(slots.size)[slots.places[slot.name]] for slot in slots.named.values() if slot.residual == residual]
        answered = np.arange(rows.size)[rows.places[residual]]
        return Block(name, _place(np.concatenate(own)[numbers]), _place(answered[numbers]), rod)

    carried_by = features.member_rods or (0,) * len(features.members)
    carriers = [rod for rod, kind in zip(carried_by, features.members, strict=True) if kind.conditioned]
    lines = [block(f"line {k + 1}", "conditions", rod, slice(k, k + 1)) for k, rod in enumerate(carriers)]
    if features.rod_count == 1 or not (features.torque_count or lines):  # one rod, or several that are one
        unknowns = np.delete(np.arange(slots.size), slots.places["drives"])
        residuals = np.delete(np.arange(rows.size), rows.places["conditions"])
        return [*lines, Block("rod 1", _place(unknowns), _place(residuals), 0)]
    apart = features.rod_count - features.torque_count  # that have no torque of their own
    blocks = [
        block(f"tube {k + 1}", "torques", k, slice(k - apart, k - apart + 1))
        for k in range(features.rod_count - 1, apart - 1, -1)
    ]
    bending = str(slots.named["moment"].residual)  # in the joint of a held tip, with the base force
    if features.moment:
        blocks.append(block("tube 1" if apart else "line", bending, 0 if apart else None))
    if features.base_force_unknown and not features.held:
        blocks.append(block("base force", "force", None))
    return lines + blocks


def _place(numbers: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Rising numbers, as a slice where they follow each other."""
    whole = slice(int(numbers[0]), int(numbers[-1]) + 1)
    return whole if whole.stop - whole.start == len(numbers) else numbers


def guess(problem: "BackboneProblem") -> FloatArray:
    """The rods at rest, straight if they are several: unknowns (instance_count, n)."""
    result = np.zeros((problem.instance_count, problem.unknown_count))
    if not problem.features.turning_count:
        result[:, problem.slots.places["moment"]] = problem.arrays.precurvature[:, 0, 0, :3]
    return result


def related(features: Features) -> dict[int, tuple[bool, bool]]:
    """Of problems of the same rods by fewer terms or more, by how many unknowns they have: whether moment and force are among
    these."""
    kinds = [(True, False), (True, True)] + [(False, False)] * (features.torque_count > 0)
    return {unknowns_of(features, moment=moment, force=force).size: (moment, force) for moment, force in kinds}


def adopted(problem: "BackboneProblem", unknowns: FloatArray) -> FloatArray:
    """Unknowns of this problem, from those of a ``related`` one."""
    moment, force = related(problem.features)[unknowns.shape[1]]
    unknowns = unknowns if moment else with_moment(problem, unknowns)
    parts = unknowns_of(problem.features, moment=True, force=force).split(unknowns)
    if problem.features.base_force_unknown and not force:
        parts["force"] = _dead_base_force(problem, unknowns)
    return np.asarray(problem.slots.joined(parts))


def with_moment(problem: "BackboneProblem", unknowns: FloatArray) -> FloatArray:
    """Unknowns of rods that carry a moment, from those of unloaded ones: none, and rod 1 has what the others leave, (8b)."""
    if problem.features.eccentric:
        return np.concatenate([np.zeros((len(unknowns), 3)), unknowns], axis=1)
    unit = unit_stiffness(problem.arrays.material[:, :, 0])[..., 2]
    torques = unknowns[:, unknowns_of(problem.features, moment=False, force=False).places["torques"]]  # what drives lines is none
    inner = -(torques * unit[:, 1:]).sum(axis=1, keepdims=True) / unit[:, :1]
    return np.concatenate([np.zeros((len(unknowns), 2)), inner, unknowns], axis=1)


def _dead_base_force(problem: "BackboneProblem", unknowns: FloatArray) -> FloatArray:
    """The base force in curvature units, equation (13), of dead forces alone, at ``unknowns`` without it."""
    call = problem.nodes.over(2, unknowns=unknowns, dead=True)
    scale = problem.table.length_scale.numpy() / problem.arrays.material[:, 0, 0, :2].max(axis=-1)
    force = call.read("node_total_force" if problem.features.members else "node_force")
    return np.asarray(force[:, 0] * scale[:, None])


def kinks(problem: "BackboneProblem") -> NDArray[np.intp]:
    """Places of the unknown tensions of lines that slacken."""
    slack = [kind.slackens for kind in problem.features.members if kind.conditioned]
    return np.asarray(np.arange(problem.unknown_count)[problem.slots.places["drives"]][np.array(slack, dtype=bool)])


def kink_inputs(problem: "BackboneProblem") -> NDArray[np.intp]:
    """Places of the inputs that say how long these are."""
    laws = problem.features.members
    slack = [kind.conditioned and kind.slackens for kind in laws if kind.drive is not None]
    places = problem.first_drive + np.array(drive_places(laws), dtype=np.intp)
    return np.asarray(places[np.array(slack, dtype=bool)])
