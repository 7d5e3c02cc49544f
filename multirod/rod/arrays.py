"""Rods lowered to the arrays that kernels read."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod import profile
from multirod.batch import IntArray, take
from multirod.rod.rod import Rod
from multirod.rod.section import Section
from multirod.validation import (
    FloatArray,
    Kind,
    array,
    frozen,
)

if TYPE_CHECKING:
    from multirod.models.backbone.kernels.loads.load import Load
    from multirod.models.backbone.members.member import Member

DENSITY = 9  # which column of ``RodArrays.material`` is the mass per length
SAME_PLACE = 1e-12  # of its arclength: a cut that near the end of a section is there


@dataclass(frozen=True)
class RodArrays:
    """Rods lowered to the arrays that kernels read; first axis the batch (1 where nothing varies).

    Attributes:
        end: Arclength of section ends from the base [m], shape (batch, rod_count, section_count); short rods are padded
            with sections of no length.
        material: ``EI_x, EI_y, GJ``, their inverses, ``1/GA_x, 1/GA_y, 1/EA``, mass per length, magnetic moment per length,
            stiffness of the foundation, parameters of members, then their functions, coefficients of one power after those of the
            power below, shape (batch, rod_count, section_count, 16 or more). Of eccentric rods, their
            offsets [m] stand there, and the torsional compliance of the line, which is zero.
        precurvature: Polynomial coefficients, shape (batch, rod_count, section_count, 3 (degree + 1)).
        section: Which of its rod's sections each piece belongs to, shape (batch, rod_count, section_count).
        degree: Degree of the polynomials.
        shear: Whether any rod shears or extends.
        anisotropic: Whether any bending stiffness differs between the axes.
        torsion: Whether any rod twists elastically.
        loads: Laws of the loads that depend on the configuration and act by what the rods are: their parameters are the last
            columns of ``material``.
        eccentric: Whether the rods run side by side.
        members: Laws of what the rods carry along themselves, whose parameters and functions are further columns of ``material``.
        member_rods: Of several rods, the one that carries each.
        member_degree: Degree of the polynomials of these functions.
        discs: Whether lines run straight between discs.
        batch_shape: Leading axes; where there are none, the batch axis is 1.
    """

    end: FloatArray
    material: FloatArray
    precurvature: FloatArray
    section: NDArray[np.intp]
    degree: int
    shear: bool
    anisotropic: bool
    torsion: bool
    loads: "tuple[type[Load], ...]" = ()
    eccentric: bool = False
    members: "tuple[type[Member], ...]" = ()
    member_rods: tuple[int, ...] = ()
    member_degree: int = 0
    discs: bool = False
    batch_shape: tuple[int, ...] = field(default=())

    def __post_init__(self) -> None:
        for name in ("end", "material", "precurvature", "section"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def build(self) -> tuple[Any, ...]:
        """What rods have alike that one launch integrates side by side, ``stack``: members and loads, whose numbers stand in the
        material one after another."""
        return self.members, self.member_rods, self.loads

    @property
    def is_round(self) -> bool:
        """Whether all rods are round and straight at rest, and carry nothing that tells how they are turned about themselves."""
        bent = self.precurvature.reshape(*self.precurvature.shape[:3], -1, 3)[..., :2].any()
        sheared = (self.material[..., 6] != self.material[..., 7]).any()
        carried = self.eccentric or self.members or self.loads or self.material[..., 10:12].any()
        return not (self.anisotropic or bent or sheared or carried)

    def take(self, batch_shape: tuple[int, ...], instances: IntArray | None = None) -> "RodArrays":
        """The arrays of some instances, along one axis, of a batch to whose leading axes these broadcast.

        ``instances`` are their numbers in the flattened batch; all of them, with the batch's own axes, by default. What does not
        vary stays one row.
        """
        if not self.batch_shape or (instances is None and self.batch_shape == batch_shape):
            return self
        return replace(
            self, batch_shape=batch_shape if instances is None else np.shape(instances), **self._rows(batch_shape, instances)
        )

    def repeated(self, batch_shape: tuple[int, ...]) -> "RodArrays":
        """The same with a row for every instance, whether or not it varies."""
        return replace(self, batch_shape=batch_shape, **self._rows(batch_shape, None))

    def hardly_twists(self, ratio: float) -> NDArray[np.bool_]:
        """Whether some section of some rod is more than ``ratio`` times as stiff in torsion as in bending, shape (batch,)."""
        return np.asarray((self.material[..., 2] > ratio * self.material[..., :2].max(axis=-1)).any(axis=(1, 2)))

    def eased(self, ratio: float) -> "RodArrays":
        """(36) of ``docs/held.md``: the same, these so many times as stiff."""
        material = np.array(self.material)
        material[..., 2] = np.minimum(material[..., 2], ratio * material[..., :2].max(axis=-1))
        material[..., 5] = 1 / material[..., 2]
        return replace(self, material=material, torsion=True)

    def _rows(self, batch_shape: tuple[int, ...], instances: IntArray | None) -> dict[str, Any]:
        values = {name: getattr(self, name) for name in ("end", "material", "precurvature", "section")}
        shaped = {name: value.reshape(*self.batch_shape, *value.shape[1:]) for name, value in values.items()}
        return {name: take(value, batch_shape, instances, tail=values[name].ndim - 1) for name, value in shaped.items()}


def stack(backbones: Sequence[RodArrays], batch_shape: tuple[int, ...]) -> RodArrays:
    """Several backbones of as many rods each, side by side along a last batch axis; each is lowered to ``batch_shape``."""
    sections = max(arrays.end.shape[2] for arrays in backbones)
    terms = max(arrays.precurvature.shape[3] for arrays in backbones)
    width = max(arrays.material.shape[3] for arrays in backbones)

    def padded(value: NDArray[Kind]) -> NDArray[Kind]:
        """Rods end with sections of no length, as ``lower`` pads them."""
        last = np.repeat(value[:, :, -1:], sections - value.shape[2], axis=2)
        return np.concatenate([value, last], axis=2)

    def wide(value: FloatArray) -> FloatArray:
        """Functions of members have no terms of higher powers."""
        return np.pad(value, ((0, 0), (0, 0), (0, 0), (0, width - value.shape[3])))

    def joined(values: list[NDArray[Kind]]) -> NDArray[Kind]:
        together = np.stack([padded(value) for value in values], axis=1)
        return together.reshape(-1, *together.shape[2:])

    return RodArrays(
        end=joined([arrays.end for arrays in backbones]),
        material=joined([wide(arrays.material) for arrays in backbones]),
        precurvature=joined(
            [
                np.pad(arrays.precurvature, ((0, 0), (0, 0), (0, 0), (0, terms - arrays.precurvature.shape[3])))
                for arrays in backbones
            ]
        ),
        section=joined([arrays.section for arrays in backbones]),
        degree=max(arrays.degree for arrays in backbones),
        shear=any(arrays.shear for arrays in backbones),
        anisotropic=any(arrays.anisotropic for arrays in backbones),
        torsion=any(arrays.torsion for arrays in backbones),
        loads=tuple(dict.fromkeys(load for arrays in backbones for load in arrays.loads)),
        members=backbones[0].members,
        member_rods=backbones[0].member_rods,
        member_degree=max(arrays.member_degree for arrays in backbones),
        discs=any(arrays.discs for arrays in backbones),
        batch_shape=(*batch_shape, len(backbones)),
    )


def _values(member: "Member", section: Section, s: float) -> list[FloatArray]:
    """The numbers of a member on a piece of a section, one by one."""
    count = member.value_count()
    values = array(f"{type(member).__name__}.values", member.values(section, s), (count,))
    return [values[..., k] for k in range(count)]


def _carried(
    rods: Sequence[Rod], own: int, section: Section, s: float, start: FloatArray, end: FloatArray, degree: int
) -> list[FloatArray]:
    """Parameters of the members of all rods on a piece of rod ``own`` from ``start`` to ``end`` (...), around s, then their
    functions, power by power; zero of what another rod carries."""
    found: list[FloatArray] = []
    functions = []
    for k, rod in enumerate(rods):
        for member in rod.carried:
            found += _values(member, section, s) if k == own else [np.zeros(())] * member.value_count()
            if member.functions and k == own:
                begin, stop, coefficients = member.polynomials(s)
                moved = profile.recentred(coefficients, begin, stop, start, end)
                functions.append(np.pad(moved, [(0, 0)] * (moved.ndim - 2) + [(0, degree + 1 - moved.shape[-2]), (0, 0)]))
            elif member.functions:
                functions.append(np.zeros((degree + 1, len(member.functions))))
    return found + [values[..., k, j] for k in range(degree + 1) for values in functions for j in range(values.shape[-1])]


def _loading(rod: Rod, section: Section, kinds: "tuple[type[Load], ...]") -> list[FloatArray]:
    """Parameters of loads of these kinds on a section of a rod; zero of what does not act on it."""
    found: list[FloatArray] = []
    for kind in kinds:
        own = [load for load in rod.loads if type(load) is kind]
        count = len(kind.parameters)
        values = array(f"{kind.__name__}.values", own[0].values(section), (count,)) if own else np.zeros(count)
        found += [values[..., k] for k in range(count)]
    return found


def _cut(start: FloatArray, end: FloatArray, cuts: Sequence[float]) -> Iterator[tuple[float, FloatArray, FloatArray]]:
    """Parts of a piece from ``start`` to ``end`` (batch,) between ``cuts``: an arclength between these, start and end."""
    if not cuts:
        yield 0.0, start, end
        return
    begin, last = start, 0.0
    for cut in [*cuts, math.inf]:
        near = np.abs(cut - end) <= SAME_PLACE * end if math.isfinite(cut) else np.zeros(end.shape, dtype=bool)
        stop = np.where(near, end, np.clip(cut, start, end))
        if (stop > begin).any():
            yield (last + cut) / 2 if math.isfinite(cut) else last + 1.0, begin, stop
            begin = stop
        last = cut


def lower(rods: Sequence[Rod], offsets: FloatArray | None = None) -> RodArrays:
    """Arrays of ``rods``, their leading axes broadcast with each other (a batch axis of 1 where there are none).

    ``offsets`` (rod_count, 2) are those of rods that run side by side.
    """
    from multirod.models.backbone.kernels.loads.foundation import Foundation
    from multirod.models.backbone.members.member import kinds

    loads = tuple(dict.fromkeys(type(load) for rod in rods for load in rod.loads))
    batch_shape = np.broadcast_shapes(*(rod.batch_shape for rod in rods))
    degree = profile.DEGREE if any(isinstance(s.precurvature, profile.Profile) for rod in rods for s in rod.sections) else 0
    carried = [member for rod in rods for member in rod.carried]
    polynomials = [member.polynomials(0.0)[2] for member in carried if member.functions]
    member_degree = max((values.shape[-2] - 1 for values in polynomials), default=0)

    def batch(value: FloatArray | float, tail: tuple[int, ...] = ()) -> FloatArray:
        return np.broadcast_to(np.asarray(value), (*batch_shape, *tail)).reshape(-1, *tail)

    def made_of(rod: int, section: Section, own: list[FloatArray], s: float, start: FloatArray, end: FloatArray) -> FloatArray:
        place = (s, start.reshape(batch_shape), end.reshape(batch_shape))
        further = [*_carried(rods, rod, section, *place, member_degree), *_loading(rods[rod], section, loads)]
        return np.stack(own + [batch(value) for value in further], -1)

    columns: list[list[tuple[Any, ...]]] = []
    for k, rod in enumerate(rods):
        aside = [] if offsets is None else [batch(value) for value in (*offsets[k], 0.0)]
        column: list[tuple[Any, ...]] = []
        end = np.zeros(math.prod(batch_shape))
        cuts = sorted({cut for member in rod.carried for cut in member.cuts})
        for place, section in enumerate(rod.sections):
            which = np.full(end.size, place)
            bending, shear = section.bending_stiffness, section.shear_stiffness
            parts = [bending[..., 0], bending[..., 1], section.torsional_stiffness]
            inverses = [*parts, shear[..., 0], shear[..., 1], section.axial_stiffness]
            own = (
                [batch(p) for p in parts]
                + [batch(1 / np.asarray(p)) for p in inverses]
                + [batch(section.linear_density)]
                + [batch(section.magnetisation[..., k]) for k in range(3)]
                + [batch(section.foundation[..., k]) for k in range(3)]
                + aside
            )

            if isinstance(section.precurvature, profile.Profile):
                pieces = section.precurvature
                at_base, curves = pieces(0.0), list(zip(end + pieces.ends[:, None], pieces.coefficients, strict=True))
            else:
                at_base = batch(section.precurvature, (3,))
                constant = np.zeros((end.size, degree + 1, 3))
                constant[:, 0] = at_base
                curves = [(end + batch(section.length), constant)]
            if not column and (isinstance(section.precurvature, profile.Profile) or member_degree):
                # what is pushed out of the base continues the first section, as it is there
                constant = np.zeros((end.size, degree + 1, 3))
                constant[:, 0] = at_base
                column.append((end, made_of(k, section, own, 0.0, end, end), constant.reshape(end.size, -1), which))
            for last, coefficients in curves:
                for s, start, stop in _cut(end, last, cuts):
                    moved = profile.recentred(coefficients, end, last, start, stop)
                    curved = np.broadcast_to(moved, (end.size, degree + 1, 3)).reshape(end.size, -1)
                    column.append((stop, made_of(k, section, own, s, start, stop), curved, which))
                end = last
        columns.append(column)
    count = max(len(column) for column in columns)
    for column in columns:
        column += [column[-1]] * (count - len(column))
    stacked = [np.stack([np.stack([entry[k] for entry in column], 1) for column in columns], 1) for k in range(4)]
    material = stacked[1]
    return RodArrays(
        end=stacked[0],
        material=material,
        precurvature=stacked[2],
        section=stacked[3],
        degree=degree,
        shear=bool((material[..., 6:9] > 0).any()),
        anisotropic=bool((material[..., 0] != material[..., 1]).any()),
        torsion=bool(np.isfinite(material[..., 2]).any()),
        loads=(*([Foundation] if any(rod.is_embedded for rod in rods) else []), *loads),
        eccentric=offsets is not None,
        members=kinds(carried),
        member_rods=tuple(k for k, rod in enumerate(rods) for _ in rod.carried) if len(rods) > 1 else (),
        member_degree=member_degree,
        discs=any(rod.discs for rod in rods if rod.lines),
        batch_shape=batch_shape,
    )
