# mypy: ignore-errors
"""One instance of a batch, as kernels hold it: its rods, its loads, and the units that follow from them."""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.arguments import JOB, Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.layout.rows import InputOffsets
from multirod.models.backbone.kernels.tips import longest_of, tip_of

f64 = wp.float64


@wp.func
def bending_stiffness(rods: wp.ref[RodTable], case: wp.ref[Instance], i: int, m: int) -> f64:
    """The larger one of section m of rod i [N m^2]."""
    return wp.max(rods.material[case.rods, i, m, 0], rods.material[case.rods, i, m, 1])


@wp.func
def section_unit(rods: wp.ref[RodTable], case: wp.ref[Instance], i: int, m: int) -> wp.vec3d:
    """(10), (11) Curvature per moment there; where torsion is stiffer than bending, the bending stiffness scales it."""
    GJ = wp.min(rods.material[case.rods, i, m, 2], bending_stiffness(rods, case, i, m))
    EI_x = rods.material[case.rods, i, m, 0]
    return wp.vec3d(f64(1.0) / EI_x, f64(1.0) / rods.material[case.rods, i, m, 1], f64(1.0) / GJ)


def make_geometry(layout: Layout, d) -> SimpleNamespace:
    """Functions that load an instance, and know where its sections are and how directions move them."""
    at = InputOffsets(layout.n, layout.DRIVES)
    TRANSLATION, PROFILE_FACTOR, SINGLE = at.TRANSLATION, at.PROFILE_FACTOR, d is wp.float32
    TIP_FORCE, TIP_MOMENT, GRAVITY = at.TIP_FORCE, at.TIP_MOMENT, at.GRAVITY
    DISTRIBUTED_FORCE, DISTRIBUTED_MOMENT = at.DISTRIBUTED_FORCE, at.DISTRIBUTED_MOMENT
    Sections = wp.types.vector(length=layout.n, dtype=int)  # one of each rod

    @wp.func
    def load_vector(call: wp.ref[Call], t: int, first: int) -> wp.vec3d:
        """A load as it acts: the load factor included."""
        return call.problem.load_factor[t] * wp.vec3d(
            call.problem.inputs[t, first], call.problem.inputs[t, first + 1], call.problem.inputs[t, first + 2]
        )

    @wp.func
    def direction_vector(call: wp.ref[Call], case: wp.ref[Instance], k: int, first: int) -> wp.vec3d:
        """Part of direction k, of a load as it acts."""
        j = case.direction
        return wp.vec3d(
            call.problem.directions[j, k, first],
            call.problem.directions[j, k, first + 1],
            call.problem.directions[j, k, first + 2],
        )

    @wp.func
    def moved(call: wp.ref[Call], case: wp.ref[Instance], k: int, mover: int) -> f64:
        """How direction k moves a node with its mover."""
        if mover < 0:
            return f64(0.0)
        return call.problem.directions[case.direction, k, wp.static(TRANSLATION) + mover]

    @wp.func
    def section_end(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], i: int, m: int) -> f64:
        """Where section m of rod i ends."""
        return rods.end[case.rods, i, m] + call.problem.inputs[case.index, wp.static(TRANSLATION) + i]

    @wp.func
    def rod_end(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], i: int) -> f64:
        return section_end(rods, call, case, i, rods.end.shape[2] - 1)

    @wp.func
    def section_from(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], i: int, s: f64) -> int:
        """The section of rod i that begins at s or goes on there; their number where the rod has ended."""
        m = int(0)
        while m < rods.end.shape[2] and section_end(rods, call, case, i, wp.min(m, rods.end.shape[2] - 1)) <= s:
            m += int(1)
        return m

    @wp.func
    def section_at(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], i: int, s: f64):
        """The section of rod i at s, and 1; where the rod has ended its last, and 0: so much of its material is present."""
        section = section_from(rods, call, case, i, s)
        present = f64(1.0)
        if section == rods.end.shape[2]:
            present = f64(0.0)
        return wp.min(section, rods.end.shape[2] - 1), present

    @wp.func(inline=False)
    def load_instance(rods: wp.ref[RodTable], call: wp.ref[Call], t: int) -> Instance:
        """Geometry of an instance, and its loads in the base frame."""
        case = Instance()
        case.index = t
        case.rods = t * rods.stride
        case.direction = t * call.direction_stride
        case.base_position = rods.base_position[t * rods.base_stride]
        case.base_rotation = rods.base_rotation[t * rods.base_stride]
        case.to_base = wp.transpose(case.base_rotation)
        case.scale = rods.length_scale[case.rods]
        case.length = tip_of(rods.end, case.rods, call.problem.inputs, t)
        case.longest = longest_of(rods.end, case.rods, call.problem.inputs, t)
        case.tip_force = case.to_base * load_vector(call, t, TIP_FORCE)
        case.tip_moment = case.to_base * load_vector(call, t, TIP_MOMENT)
        case.distributed_force = case.to_base * load_vector(call, t, DISTRIBUTED_FORCE)
        case.distributed_moment = case.to_base * load_vector(call, t, DISTRIBUTED_MOMENT)
        case.gravity = case.to_base * load_vector(call, t, GRAVITY)
        case.profile_factor = call.problem.load_factor[t] * call.problem.inputs[t, PROFILE_FACTOR]
        case.unit = f64(1.0)
        case.stiffness = f64(1.0)
        case.moment = f64(1.0)
        case.force = f64(1.0)
        if wp.static(SINGLE):
            case.unit = case.scale
            case.stiffness = f64(0.0)
            for i in range(rods.end.shape[1]):
                case.stiffness += wp.max(rods.material[case.rods, i, 0, 0], rods.material[case.rods, i, 0, 1])
            case.moment = case.stiffness / case.scale
            case.force = case.moment / case.scale
        return case

    @wp.func
    def is_shared(call: wp.ref[Call], l: int, p: int, job: int) -> bool:
        """Whether the lane before carries another part of the same job."""
        before = int(-1)
        if l > 0:
            before = int(call.lane[p - 1, JOB])
        return before >= 0 and before // call.parts == job // call.parts

    @wp.func
    def take_up(rods: wp.ref[RodTable], call: wp.ref[Call], t: int, l: int, p: int, job: int):
        """An instance for a lane that begins its job."""
        if is_shared(call, l, p, job):
            call.carried[p] = call.carried[p - 1]
        else:
            call.carried[p] = load_instance(rods, call, t)

    return SimpleNamespace(
        load_vector=load_vector,
        direction_vector=direction_vector,
        moved=moved,
        section_end=section_end,
        rod_end=rod_end,
        section_from=section_from,
        section_at=section_at,
        Sections=Sections,
        is_shared=is_shared,
        take_up=take_up,
    )
