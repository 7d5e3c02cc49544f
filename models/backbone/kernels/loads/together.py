# mypy: ignore-errors
"""All loads that depend on the configuration as one, in lanes: their forces, moments and torques summed, and their variations.

``z`` is where the record of the stretch stands in memory, ``x`` the arclength from its start, ``a`` where that of the place
stands, ``v`` a column of the state and ``g`` where stands what its direction varies.
"""

from functools import reduce
from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.numbers.lanes import add, div, lanes, mul, neg, sub  # noqa: F401  (by name)
from multirod.models.backbone.kernels.numbers.vectors import vectors


def make_acting(layout: Layout, W: int, d) -> SimpleNamespace:
    """Functions of the loads of the features, each None where no load has such."""
    L, V = lanes(W, d), vectors(W, d)
    Real, row, fill = L.Real, L.row, L.fill
    Vec3, Frame, plus, dot = V.Vec3, V.Frame, V.plus, V.dot
    memory_type = wp.array(dtype=d)
    state, column = L.few(layout.state.size), L.few(layout.column.size)
    State, Column = state.type, column.type
    FROM_BASE, GIVEN_START, GROWTH = layout.stretch["from_base"], layout.given["start"], layout.given["growth"]
    DIRECTIONS, loads = layout.DIRECTIONS, layout.features.loads
    own = {"memory_type": memory_type, "layout": layout, "State": State, "Column": Column, "d": d}
    own |= {"part": state.part, "keep": state.keep, "part_of": column.part, "keep_in": column.keep}
    laws = {load: load.law(SimpleNamespace(**(vars(L) | vars(V) | own | layout.slots_of(load)))) for load in loads}

    def those_with(name: str) -> list:
        return [getattr(law, name) for law in laws.values() if hasattr(law, name)]

    @wp.func
    def arclength(memory: memory_type, z: int, x: Real) -> Real:
        """s"""
        return row(memory, z + wp.static(FROM_BASE)) + x

    @wp.func
    def arclength_variation(memory: memory_type, g: int, x: Real) -> Real:
        """Change of s for a direction, at a fixed part of the stretch."""
        if wp.static(DIRECTIONS):
            return row(memory, g + wp.static(GIVEN_START)) + x * row(memory, g + wp.static(GROWTH))
        return fill(d(0.0))

    def both(one, other):
        """Two laws of one load each as one."""

        @wp.func
        def sum_of(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Vec3:
            return plus(one(memory, z, a, s, frame, p), other(memory, z, a, s, frame, p))

        return sum_of

    def both_variations(one, other):
        @wp.func
        def sum_of(memory: memory_type, z: int, a: int, g: int, ds: Real, frame: Frame, v: Column, dphi: Vec3, dp: Vec3) -> Vec3:
            first = one(memory, z, a, g, ds, frame, v, dphi, dp)
            return plus(first, other(memory, z, a, g, ds, frame, v, dphi, dp))

        return sum_of

    def of_all(functions: list, add_up):
        """The function of all of them at a place that is ``x`` from the start of the stretch."""
        if not functions:
            return None
        whole = reduce(add_up, functions)

        @wp.func
        def acting(memory: memory_type, z: int, a: int, x: Real, frame: Frame, p: Vec3) -> Vec3:
            return whole(memory, z, a, arclength(memory, z, x), frame, p)

        return acting

    def of_all_variations(functions: list):
        if not functions:
            return None
        whole = reduce(both_variations, functions)

        @wp.func
        def varying(memory: memory_type, z: int, a: int, g: int, x: Real, frame: Frame, v: Column, dphi: Vec3, dp: Vec3) -> Vec3:
            return whole(memory, z, a, g, arclength_variation(memory, g, x), frame, v, dphi, dp)

        return varying

    def works(law: SimpleNamespace, rest):
        """(14d), (14e) What makes of the internal force's work that of the dead loads, less the energy of a load, per length."""
        FORCE, ENERGY = hasattr(law, "force"), hasattr(law, "energy")
        force, energy = getattr(law, "force", None), getattr(law, "energy", None)

        @wp.func
        def work(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Real:
            total = rest(memory, z, a, s, frame, p)
            if wp.static(FORCE):
                total = total - dot(force(memory, z, a, s, frame, p), p)
            if wp.static(ENERGY):
                total = total - energy(memory, z, a, s, frame, p)
            return total

        return work

    @wp.func
    def no_work(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Real:
        return fill(d(0.0))

    work_of_all = reduce(lambda rest, law: works(law, rest), laws.values(), no_work)

    @wp.func
    def work(memory: memory_type, z: int, a: int, x: Real, frame: Frame, p: Vec3) -> Real:
        return work_of_all(memory, z, a, arclength(memory, z, x), frame, p)

    def both_torques(one, other):
        @wp.func
        def take(memory: memory_type, a: int, f: wp.ref[State]):
            one(memory, a, f)
            other(memory, a, f)

        return take

    def both_torque_variations(one, other):
        @wp.func
        def take(memory: memory_type, a: int, g: int, frame: Frame, v: Column, dphi: Vec3, f: wp.ref[Column]):
            one(memory, a, g, frame, v, dphi, f)
            other(memory, a, g, frame, v, dphi, f)

        return take

    def chained(name: str, chain):
        functions = those_with(name)
        return reduce(chain, functions) if functions else None

    def both_springs(one, other):
        @wp.func
        def sum_of(memory: memory_type, z: int) -> Real:
            return one(memory, z) + other(memory, z)

        return sum_of

    return SimpleNamespace(
        spring=chained("spring", both_springs),
        force=of_all(those_with("force"), both),
        force_variation=of_all_variations(those_with("force_variation")),
        moment=of_all(those_with("moment"), both),
        moment_variation=of_all_variations(those_with("moment_variation")),
        torques=chained("torques", both_torques),
        torque_variations=chained("torque_variations", both_torque_variations),
        work=work if loads else None,
    )
