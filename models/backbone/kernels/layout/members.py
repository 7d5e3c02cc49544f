"""Where the numbers of members and loads stand: in the table of rods, in a row of inputs. Told by their laws alone."""

from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING

from multirod.models.backbone.kernels.layout.rows import MATERIAL_SIZE

if TYPE_CHECKING:
    from multirod.models.backbone.kernels.layout.features import Features
    from multirod.models.backbone.kernels.loads.load import Load
    from multirod.models.backbone.members.member import Member

# (L7) what the condition of an unknown ``T`` takes: a lever that scales it, the line's compliance, how long it is in the rod at
# rest, and how much longer it would be alone
# of what is driven by its length: ``pushed`` and ``pulled`` are its rest length per translation, out of the base and into it;
# how long it is where its rod is held straight, and that per length of rod
CONDITION = {
    "lever": (0, 1),
    "compliance": (-1, 1),
    "natural": (0, 1),
    "excess": (0, 1),
    "pushed": (0, 0),
    "pulled": (0, 0),
    "straight": (0, 1),
    "held": (0, 0),
}


def columns_in_material(laws: Iterable[type["Member"]]) -> list[int]:
    """Where the values of each member stand in ``RodTable.material``, and at last the functions of all."""
    return list(accumulate((law.value_count() for law in laws), initial=MATERIAL_SIZE))


def driven(laws: Iterable[type["Member"]]) -> list[type["Member"]]:
    """Those of the laws that are driven, in their order."""
    return [law for law in laws if law.drive is not None]


def drives(laws: Iterable[type["Member"]]) -> list[str]:
    """The inputs that drive members of these laws, one entry a member that is driven, in their order."""
    return [law.drive[0] for law in laws if law.drive is not None]


def drive_places(laws: Iterable[type["Member"]]) -> list[int]:
    """Where that of each member that is driven stands in a row of inputs: all of one input side by side, in their order."""
    names = drives(laws)
    slices = drive_slices(names)
    return [slices[name].start + names[:k].count(name) for k, name in enumerate(names)]


def drive_slices(names: Sequence[str], first: int = 0) -> dict[str, slice]:
    """Where the numbers of each input stand that drives members, in a row of inputs from ``first`` on, by the names of all."""
    slices = {}
    for name in sorted(set(names)):
        slices[name] = slice(first, first + names.count(name))
        first = slices[name].stop
    return slices


def loads_in_material(features: "Features") -> dict[type["Load"], int]:
    """Where the parameters of loads that depend on the configuration begin in the material: after all of members."""
    functions = sum(len(law.functions) for law in features.members)
    first = columns_in_material(features.members)[-1] + functions * (features.member_degree + 1)
    starts = accumulate((len(load.parameters) for load in features.loads), initial=first)
    return dict(zip(features.loads, starts, strict=False))
