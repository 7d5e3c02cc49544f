# mypy: ignore-errors
"""The grid of one backbone: its loads and geometry, its nodes, and the stretches between them.

A node stands wherever a section of a rod or a piece of a load profile ends, and at the tip. Numbers in parentheses are those
of ``docs/model.md``; what a function returns for directions is the derivative along each direction in input space.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone_layout_kernels import MATERIAL_SIZE, Call, InputOffsets, Layout, RodTable
from multirod.models.features import Features

f64 = wp.float64


def make_grid_functions(layout: Layout, features: Features, stretch: SimpleNamespace) -> SimpleNamespace:
    """Functions that load an instance and walk along it."""
    n, NX, ND = layout.n, layout.NX, layout.ND
    Stretch, Instance, Node = layout.Stretch, layout.Instance, layout.Node
    PerDirection, ColumnVectors = layout.PerDirection, layout.ColumnVectors
    FORCE, FORCE_STATE, SPREAD_FORCE = layout.FORCE, layout.FORCE_STATE, layout.SPREAD_FORCE
    PROFILE, PROFILE_TERMS, CURVATURE_TERMS = layout.PROFILE, layout.PROFILE_TERMS, layout.CURVATURE_TERMS
    NODES = features.nodes
    profile_value, profile_integral = stretch.profile_value, stretch.profile_integral
    world_force, world_force_rate = stretch.world_force, stretch.world_force_rate

    at = InputOffsets(n)
    TRANSLATION, PROFILE_FACTOR = at.TRANSLATION, at.PROFILE_FACTOR
    TIP_FORCE, TIP_MOMENT, GRAVITY = at.TIP_FORCE, at.TIP_MOMENT, at.GRAVITY
    DISTRIBUTED_FORCE, DISTRIBUTED_MOMENT = at.DISTRIBUTED_FORCE, at.DISTRIBUTED_MOMENT

    @wp.func
    def load_vector(call: Call, t: int, first: int) -> wp.vec3d:
        """A load as it acts: the load factor included."""
        return call.load_factor[t] * wp.vec3d(call.inputs[t, first], call.inputs[t, first + 1], call.inputs[t, first + 2])

    @wp.func
    def direction_vector(call: Call, case: Instance, k: int, first: int) -> wp.vec3d:
        """Part of direction k, of a load as it acts."""
        j = case.direction
        return wp.vec3d(call.directions[j, k, first], call.directions[j, k, first + 1], call.directions[j, k, first + 2])

    @wp.func
    def section_end(rods: RodTable, case: Instance, i: int, m: int) -> f64:
        """Where section m of rod i ends."""
        return rods.end[case.rods, i, m] + case.shift[i]

    @wp.func
    def load_instance(rods: RodTable, call: Call, t: int) -> Instance:
        """Geometry of an instance, and its loads in the base frame."""
        case = Instance()
        case.index = t
        case.rods = t * rods.stride
        case.direction = t * call.direction_stride
        case.base_position = rods.base_position[t * rods.base_stride]
        case.base_rotation = rods.base_rotation[t * rods.base_stride]
        case.to_base = wp.transpose(case.base_rotation)
        case.scale = rods.length_scale[case.rods]
        for i in range(wp.static(n)):
            case.shift[i] = call.inputs[t, wp.static(TRANSLATION) + i]
            for k in range(wp.static(ND)):
                case.shift_rate[k, i] = call.directions[case.direction, k, wp.static(TRANSLATION) + i]
        case.length = section_end(rods, case, 0, rods.end.shape[2] - 1)
        for i in range(1, wp.static(n)):
            if section_end(rods, case, i, rods.end.shape[2] - 1) > case.length:
                case.length = section_end(rods, case, i, rods.end.shape[2] - 1)
                case.longest = i
        for k in range(wp.static(ND)):
            case.length_rate[k] = case.shift_rate[k, case.longest]
        case.tip_force = case.to_base * load_vector(call, t, TIP_FORCE)
        case.tip_moment = case.to_base * load_vector(call, t, TIP_MOMENT)
        case.distributed_force = case.to_base * load_vector(call, t, DISTRIBUTED_FORCE)
        case.distributed_moment = case.to_base * load_vector(call, t, DISTRIBUTED_MOMENT)
        case.gravity = case.to_base * load_vector(call, t, GRAVITY)
        case.profile_factor = call.load_factor[t] * call.inputs[t, PROFILE_FACTOR]
        return case

    # ---- (3a): the force at the base ----

    @wp.func
    def mass_in_use(rods: RodTable, case: Instance):
        """Mass of all rods out of the base, and its rates: a section in the base grows as the rod is pushed out."""
        mass = f64(0.0)
        rate = PerDirection()
        for i in range(wp.static(n)):
            for m in range(rods.end.shape[2]):
                begin = f64(0.0)
                moves = f64(0.0)  # 1 if the section's start moves with its end
                if m > 0:
                    begin = section_end(rods, case, i, m - 1)
                    moves = f64(1.0)
                if begin <= f64(0.0):
                    begin = f64(0.0)
                    moves = f64(0.0)
                end = section_end(rods, case, i, m)
                if end > begin:
                    density = rods.material[case.rods, i, m, 9]
                    mass += (end - begin) * density
                    for k in range(wp.static(ND)):
                        rate[k] += (f64(1.0) - moves) * case.shift_rate[k, i] * density
        return mass, rate

    @wp.func
    def with_profile(rods: RodTable, z: Stretch, piece: int, factor: wp.mat33d) -> Stretch:
        """The stretch with a piece of the load profiles, times a factor."""
        begin = f64(0.0)
        if piece > 0:
            begin = rods.profile_end[piece - 1]
        out = z
        out.profile_centre = f64(0.5) * (begin + rods.profile_end[piece])
        out.profile_slope = f64(2.0) / (rods.profile_end[piece] - begin)
        for j in range(wp.static(PROFILE_TERMS)):
            for i in range(2):  # force, moment
                a = factor * wp.vec3d(
                    rods.profile[piece, (3 * i) * wp.static(PROFILE_TERMS) + j],
                    rods.profile[piece, (3 * i + 1) * wp.static(PROFILE_TERMS) + j],
                    rods.profile[piece, (3 * i + 2) * wp.static(PROFILE_TERMS) + j],
                )
                for k in range(3):
                    out.profile[3 * i + k, j] = a[k]
        return out

    @wp.func
    def profile_total(rods: RodTable, case: Instance):
        """Integral of the force profile over the length, and its value at the tip, profile factor aside."""
        total = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        tip = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        z = Stretch()
        s = f64(0.0)
        for piece in range(rods.profile_end.shape[0]):
            end = wp.min(rods.profile_end[piece], case.length)
            if piece == rods.profile_end.shape[0] - 1:
                end = case.length  # the last piece goes on
            if end > s:
                z = with_profile(rods, z, piece, case.to_base)
                z.start = s
                total += profile_integral(z, end - s)
                tip = profile_value(z, 0, end - s)
                s = end
        return total, tip

    @wp.func
    def total_load(rods: RodTable, call: Call, case: Instance):
        """(3a) Force at the base: the tip force and all that is spread over the length; and its columns."""
        total = case.tip_force
        columns = ColumnVectors()
        mass = f64(0.0)
        mass_rate = PerDirection()
        profile = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        profile_tip = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        if wp.static(SPREAD_FORCE):
            mass, mass_rate = mass_in_use(rods, case)
            total += case.length * case.distributed_force + mass * case.gravity
        if wp.static(PROFILE):
            profile, profile_tip = profile_total(rods, case)
            total += case.profile_factor * profile
        for k in range(wp.static(ND)):
            rate = direction_vector(call, case, k, TIP_FORCE)
            if wp.static(SPREAD_FORCE):
                rate += case.length * direction_vector(call, case, k, DISTRIBUTED_FORCE)
                rate += mass * direction_vector(call, case, k, GRAVITY)
            rate = case.to_base * rate
            if wp.static(SPREAD_FORCE):
                rate += case.length_rate[k] * case.distributed_force + mass_rate[k] * case.gravity
            if wp.static(PROFILE):
                rate += call.directions[case.direction, k, PROFILE_FACTOR] * profile
                rate += (case.length_rate[k] * case.profile_factor) * profile_tip
            for j in range(3):
                columns[NX + k, j] = rate[j]
        return total, columns

    # ---- nodes ----

    @wp.func
    def first_node(rods: RodTable, case: Instance) -> Node:
        """The base: sections that are pulled into it are passed, all but the last."""
        node = Node()
        for i in range(wp.static(n)):
            m = int(0)
            while m < rods.end.shape[2] - 1 and section_end(rods, case, i, m) <= f64(0.0):
                m += int(1)
            node.section[i] = m
        return node

    @wp.func
    def output_arclength(rods: RodTable, call: Call, case: Instance, node: Node) -> f64:
        """Where the next output node is: they are spaced evenly along one rod or all; past its end there are none."""
        s = case.length
        if call.node_rod < wp.static(n):
            s = section_end(rods, case, call.node_rod, rods.end.shape[2] - 1)
        if node.output + 1 < call.node_count - 1:
            s *= f64(node.output + 1) / f64(call.node_count - 1)
        if node.output + 1 > call.node_count - 1:
            s = f64(2.0) * case.length
        return s

    @wp.func
    def next_node(rods: RodTable, call: Call, case: Instance, node: Node):
        """Arclength of the next node and its rates: the nearest end of a section or piece of profile, output node, or tip."""
        s = case.length
        rate = case.length_rate
        for i in range(wp.static(n)):
            if node.section[i] < rods.end.shape[2]:
                end = section_end(rods, case, i, node.section[i])
                if end < s:
                    s = end
                    for k in range(wp.static(ND)):
                        rate[k] = case.shift_rate[k, i]
        if wp.static(PROFILE):
            if node.piece < rods.profile_end.shape[0] - 1:
                if rods.profile_end[node.piece] < s:
                    s = rods.profile_end[node.piece]
                    rate = PerDirection()
        if wp.static(NODES):
            s = wp.min(s, output_arclength(rods, call, case, node))
        return s, rate

    @wp.func
    def walk_to(rods: RodTable, case: Instance, node: Node, s: f64, rate: PerDirection) -> Node:
        """The node at s; sections and pieces that end there, or have no length, are passed."""
        out = node
        out.s = s
        out.rate = rate
        for i in range(wp.static(n)):
            m = node.section[i] + int(0)
            while m < rods.end.shape[2] and section_end(rods, case, i, wp.min(m, rods.end.shape[2] - 1)) <= s:
                m += int(1)
            out.section[i] = m
        if wp.static(PROFILE):
            piece = node.piece + int(0)
            while piece < rods.profile_end.shape[0] - 1 and rods.profile_end[piece] <= s:
                piece += int(1)
            out.piece = piece
        return out

    # ---- stretches ----

    @wp.func
    def load_sections(rods: RodTable, case: Instance, node: Node) -> Stretch:
        """A stretch with stiffness and precurvature of each rod's section; a rod that has ended keeps its last."""
        z = Stretch()
        EI = f64(0.0)
        for i in range(wp.static(n)):
            m = wp.min(node.section[i], rods.end.shape[2] - 1)
            if node.section[i] < rods.end.shape[2]:
                z.present[i] = f64(1.0)
            z.bending[i] = z.present[i] * rods.material[case.rods, i, m, 0]
            z.torsion[i] = z.present[i] * rods.material[case.rods, i, m, 5]
            EI += z.bending[i]
            for j in range(wp.static(MATERIAL_SIZE)):
                z.material[i, j] = rods.material[case.rods, i, m, j]
            for j in range(wp.static(3 * CURVATURE_TERMS)):
                z.precurvature[i, j] = rods.precurvature[case.rods, i, m, j]
            begin = f64(0.0)
            if m > 0:
                begin = rods.end[case.rods, i, m - 1]
            end = rods.end[case.rods, i, m]
            z.section_centre[i] = f64(0.5) * (begin + end) + case.shift[i]
            if end > begin:
                z.section_slope[i] = f64(2.0) / (end - begin)
        z.softness = f64(1.0) / EI
        return z

    @wp.func
    def load_stretch(
        rods: RodTable, call: Call, case: Instance, node: Node, end: f64, end_rate: PerDirection, n0: wp.vec3d, dn0: ColumnVectors
    ) -> Stretch:
        """The stretch from a node to ``end``, with the force ``n0`` and its columns at its start."""
        z = load_sections(rods, case, node)
        if wp.static(n > 1 and not features.held):
            # the natural branch of several rods begins where all are straight: their precurvature is raised with the loads, by
            # the root, as torques grow with its square and with the angles
            z.precurvature *= wp.sqrt(call.load_factor[case.index])
        z.start = node.s
        z.length = end - node.s
        z.force = n0
        z.force_columns = dn0
        density = f64(0.0)
        for i in range(wp.static(n)):
            density += z.present[i] * z.material[i, 9]
        z.distributed_force = case.distributed_force + density * case.gravity
        z.distributed_moment = case.distributed_moment
        if wp.static(PROFILE):
            z = with_profile(rods, z, node.piece, case.profile_factor * case.to_base)
        z.start_rate = node.rate
        z.end_rate = end_rate
        z.shift_rate = case.shift_rate
        for k in range(wp.static(ND)):
            force = direction_vector(call, case, k, DISTRIBUTED_FORCE) + density * direction_vector(call, case, k, GRAVITY)
            force = case.to_base * force
            moment = case.to_base * direction_vector(call, case, k, DISTRIBUTED_MOMENT)
            for j in range(3):
                z.distributed_force_rate[k, j] = force[j]
                z.distributed_moment_rate[k, j] = moment[j]
            z.profile_rate[k] = call.directions[case.direction, k, PROFILE_FACTOR]
            if case.profile_factor != f64(0.0):
                z.profile_rate[k] /= case.profile_factor
        return z

    @wp.func
    def force_at_end(z: Stretch):
        """(3a) n and its columns at the end of a stretch; those of unknowns do not change along the rod."""
        force = z.force
        columns = z.force_columns
        if wp.static(FORCE and not FORCE_STATE):
            force = world_force(z, z.length)
            for k in range(wp.static(ND)):
                rate = world_force_rate(z, z.length, k)
                for j in range(3):
                    columns[NX + k, j] = rate[j]
        return force, columns

    return SimpleNamespace(
        load_vector=load_vector,
        direction_vector=direction_vector,
        section_end=section_end,
        load_instance=load_instance,
        total_load=total_load,
        first_node=first_node,
        output_arclength=output_arclength,
        next_node=next_node,
        walk_to=walk_to,
        load_stretch=load_stretch,
        force_at_end=force_at_end,
    )
