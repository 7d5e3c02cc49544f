# mypy: ignore-errors
"""What the residuals of a tip are counted in, found once for all of its columns. Numbers in parentheses are those of
``docs/model.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.instance import bending_stiffness, section_unit
from multirod.models.backbone.kernels.layout.arguments import Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.tips import reaches

f64 = wp.float64


def make_tip_units(layout: Layout, base: SimpleNamespace, grid: SimpleNamespace) -> SimpleNamespace:
    """``Ends``, and the function that finds them."""
    TUBES, MEASURED = layout.TUBES, layout.features.measured
    PerRod, section_at = base.PerRod, grid.section_at

    @wp.struct
    class Ends:
        """What the tip's residuals are counted in, and which torques rod 1 hands on."""

        bending: wp.vec2d  # (11) curvature per moment
        twist: PerRod  # (11) curvature per torque of each rod
        force: f64  # (13) L/EI of rod 1
        compliance: wp.vec3d  # (12) of the one rod
        beside: PerRod  # 1 of a rod that reaches as far as rod 1, else 0

    @wp.func(inline=False)
    def find_ends(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], s: f64) -> Ends:
        """Of the sections at s, where the last stretch began; a rod that has ended keeps its last."""
        ends = Ends()
        for i in range(rods.end.shape[1]):
            m, _present = section_at(rods, call, case, i, s)
            unit = section_unit(rods, case, i, m)
            ends.twist[i] = unit[2]
            if i == 0:
                EI = bending_stiffness(rods, case, 0, m)
                ends.bending = wp.vec2d(unit[0], unit[1])
                if wp.static(TUBES):  # of all that reach there it would jump, and Gamma, where one is drawn past the tip
                    ends.bending = wp.vec2d(f64(1.0) / EI, f64(1.0) / EI)
                ends.force = case.scale / EI
                if wp.static(MEASURED):
                    for j in range(3):
                        ends.compliance[j] = rods.material[case.rods, 0, m, 3 + j]
            else:
                if reaches(rods.end, case.rods, call.problem.inputs, case.index, i, 0):
                    ends.beside[i] = f64(1.0)
        return ends

    return SimpleNamespace(Ends=Ends, find_ends=find_ends)
