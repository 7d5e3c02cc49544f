# mypy: ignore-errors
"""The kernel that integrates one backbone carried by n >= 1 concentric rods.

The equations are those of ``docs/model.md``; numbers in parentheses are theirs. The frame ``R`` is the material frame of
rod 1, the innermost; rod ``i`` is turned about it by ``theta_i`` (``theta_1 = 0``) and carries the torque ``tau_i``. ``M``
and ``N`` are the moment and force of all rods together in that frame. With one rod this is the Cosserat rod of equation
(1c) of the paper.

``make_kernel`` compiles the terms that a scene needs (``Features``) with the stages of one integrator (``Tableau``):
one kernel thread integrates one instance with its own grid, steps and status. Its parts are

- ``backbone_layout_kernels``: the arrays of a launch, and how the state is packed;
- ``backbone_equation_kernels``: equations that need no knowledge of the scene;
- ``backbone_stretch_kernels``: precurvature (6), stiffness and loads at a place of a stretch;
- ``backbone_tube_kernels``: what several rods add, (7) and (8);
- ``backbone_rates_kernels``: the rates of the state and its columns, (1) to (5) and (14) to (20);
- ``backbone_step_kernels``: Runge-Kutta steps;
- ``backbone_precision_kernels``: a stretch from its one end to the other, by steps in either precision;
- ``backbone_grid_kernels``: loads, nodes, and the stretches between them, (3a);
- ``backbone_end_kernels``: the base (9), (10), the residual at the tip (11) to (13), outputs;
- ``backbone_held_kernels``: the tip's wrench (22), where something else holds the tip;
- ``backbone_fixed_kernels``: the moment along fixed axes (4b), (11b), where one acts that is fixed in the world.

Each part is a factory: what a scene does not need is pruned by ``wp.static`` when the code is generated. Scalar and vector types
are those of a ``Layout``, ``real``, ``vec3`` and so on: the equations, rates and steps of an integrator in ``"float32"`` are made
from a second one. All that is loaded, the walk from node to node, base, tip and what is written are double precision always, so
arrays are the same for both, and no place along the rod is told from another by rounded numbers. A state is converted at both
ends of each stretch.
"""

from functools import cache

import warp as wp

from multirod.models.backbone_end_kernels import make_base_functions, make_tip_functions
from multirod.models.backbone_fixed_kernels import make_fixed_ends, make_fixed_rates
from multirod.models.backbone_grid_kernels import make_grid_functions
from multirod.models.backbone_held_kernels import make_held_functions
from multirod.models.backbone_layout_kernels import (
    FAULT_NONE,
    FAULT_NONFINITE,
    FAULT_STEPS,
    INPUT_VECTORS,
    MATERIAL_SIZE,
    Call,
    Layout,
    RodTable,
    input_size,
)
from multirod.models.backbone_precision_kernels import make_walk_functions
from multirod.models.backbone_rates_kernels import make_rate_functions
from multirod.models.backbone_stretch_kernels import make_stretch_functions
from multirod.models.features import Features
from multirod.models.integrators import Tableau

__all__ = [
    "FAULT_NONE",
    "FAULT_NONFINITE",
    "FAULT_STEPS",
    "INPUT_VECTORS",
    "MATERIAL_SIZE",
    "Call",
    "RodTable",
    "input_size",
    "make_kernel",
]

f64 = wp.float64
SCALARS = {"float64": wp.float64, "float32": wp.float32}


def compiler_flags(features: Features, precision: str) -> str | None:
    """Warp's own for one rod; for several, multiplications and additions are fused across functions, in shorter vectors.

    That saves a quarter of the time. One rod is left out, so that an instance without a load stays bitwise the same in the
    kernel of a batch that has the load's terms; of several, an unloaded one has fewer unknowns alone. In single precision the
    compiler's vectors cost more shuffling than they save: without them a rod with its pose takes a fifth less.
    """
    flags = [wp.config.cpu_compiler_flags or ""]
    if features.rod_count > 1:
        flags.append("-ffp-contract=fast -mprefer-vector-width=256")
    if precision == "float32":
        flags.append("-fno-slp-vectorize")
    return " ".join(flags) if len(flags) > 1 else None


@cache
def make_kernel(features: Features, tableau: Tableau, precision: str = "float64"):
    """Kernel for one set of features, one integrator and the precision of its steps; arguments ``(RodTable, Call)``, one thread an instance."""
    layout = Layout(features)
    stretch = make_stretch_functions(layout)
    rate = make_rate_functions(layout, features, stretch)
    grid = make_grid_functions(layout, features, stretch)
    base = make_base_functions(layout, features, grid)
    tip = make_tip_functions(layout, features, stretch, rate, grid)
    write_end, at_base = tip.write_end, base.at_base
    if features.fixed_moment:
        rate = make_fixed_rates(layout, features, stretch, rate)
        tip = make_fixed_ends(layout, features, rate, base, grid, tip)
        write_end, at_base = tip.write_end, tip.at_base
    elif features.held:
        write_end = make_held_functions(layout, features, rate, tip).write_end

    Stretch, NODES = layout.Stretch, features.nodes
    load_instance, first_node, next_node, walk_to = grid.load_instance, grid.first_node, grid.next_node, grid.walk_to
    load_stretch, force_at_end, output_arclength = grid.load_stretch, grid.force_at_end, grid.output_arclength
    over_stretch = make_walk_functions(layout, features, tableau, rate.rates, SCALARS[precision]).over_stretch
    write_tip, write_node = tip.write_tip, tip.write_node
    write_node_columns, write_tip_columns = tip.write_node_columns, tip.write_tip_columns
    NODE_COLUMNS = features.nodes and features.sensitivities

    options = {"cpu_compiler_flags": compiler_flags(features, precision)}

    @wp.kernel(module="unique", enable_backward=False, module_options=options)
    def integrate(rods: RodTable, call: Call):
        """From the base to the tip, stretch by stretch; then the residual."""
        t = call.order[wp.tid()]
        if call.active[t] == 0:
            return
        case = load_instance(rods, call, t)
        node = first_node(rods, case)
        y, n, dn = at_base(rods, call, case, node)
        z = Stretch()
        h = f64(0.0)
        step_count = int(0)
        fault = int(wp.static(FAULT_NONE))
        passed = int(0)  # nodes

        while node.s < case.length and fault == wp.static(FAULT_NONE):
            end, end_rate = next_node(rods, call, case, node)
            z = load_stretch(rods, call, case, node, end, end_rate, n, dn)
            if wp.static(NODES):
                if node.s == f64(0.0):
                    write_node(call, case, 0, y, z, f64(0.0), f64(0.0))

            y, h, step_count, fault = over_stretch(y, z, h, step_count, case, call)

            if wp.static(NODES):
                if end >= output_arclength(rods, call, case, node):
                    node.output += 1
                    write_node(call, case, node.output, y, z, z.length, end)
            if wp.static(NODE_COLUMNS):
                write_node_columns(call, case, passed, y, end)
                passed += 1
            n, dn = force_at_end(z)
            node = walk_to(rods, case, node, end, end_rate)

        total = write_end(rods, call, case, y, z, n, dn)
        write_tip(call, case, y)
        if wp.static(NODE_COLUMNS):
            write_tip_columns(call, case, y)
        if not wp.isfinite(total):
            fault = int(wp.static(FAULT_NONFINITE))
        call.fault[t] = fault
        call.step_count[t] = step_count

    return integrate
