# mypy: ignore-errors
"""What drives a line by its length: its tension is unknown, its length a condition, (L7), (L8) of ``docs/lines.md``."""

from types import SimpleNamespace

import warp as wp

from multirod.models.backbone.kernels.instance import bending_stiffness
from multirod.models.backbone.kernels.layout.arguments import Call, Instance, RodTable
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.layout.members import columns_in_material, drive_places, driven
from multirod.models.backbone.kernels.layout.rows import InputOffsets

f64 = wp.float64


def make_conditions(layout: Layout) -> SimpleNamespace:
    """Functions of the members whose drive is unknown.

    ``y`` and ``v`` are the state at the tip and a column of it, in SI units: lengths stand alike in both.
    """
    members = layout.features.members
    inputs, PLACES = InputOffsets(layout.n, layout.DRIVES), drive_places(members)
    DRIVES_AT, TRANSLATION = inputs.DRIVES, inputs.TRANSLATION
    FIRST, ROW, LENGTHS_AT = layout.unknowns.places["drives"].start, layout.row("lengths"), layout.state["lengths"]
    State = wp.types.vector(length=layout.state.size, dtype=f64)
    Column = wp.types.vector(length=layout.column.size, dtype=f64)
    # of each: its number among those that are driven, where ``CONDITION`` stands in the material, whether it slackens
    number = [k for k, kind in enumerate(driven(members)) if kind.conditioned]
    columns = columns_in_material(members)
    at = [columns[k] + len(kind.parameters) for k, kind in enumerate(members) if kind.conditioned]
    slackens = [kind.slackens for kind in members if kind.conditioned]
    carried_by = layout.features.member_rods or (0,) * len(members)
    rod_of = [carried_by[k] for k, kind in enumerate(members) if kind.conditioned]
    STRAIGHT = layout.TUBES  # behind the base plate
    RAISED = layout.TUBES and not layout.features.held  # precurvature, with the loads

    @wp.func
    def rounding_of(call: wp.ref[Call], case: wp.ref[Instance]) -> f64:
        """(L8b) How far the kink is rounded on the way to the load [1/m], not at all at its end."""
        return wp.max(f64(1.0) - call.problem.load_factor[case.index], f64(0.0)) / case.scale

    @wp.func
    def positive_part(z: f64, mu: f64) -> f64:
        """(L8b) max(z, 0)"""
        return f64(0.5) * (z + wp.sqrt(z * z + mu * mu) - mu)

    @wp.func
    def positive_rate(z: f64, mu: f64) -> f64:
        """(L8b) Its derivative."""
        size = wp.sqrt(z * z + mu * mu)
        if size > f64(0.0):
            return f64(0.5) * (f64(1.0) + z / size)
        return f64(0.0)

    @wp.func
    def tension_unit(rods: wp.ref[RodTable], case: wp.ref[Instance], i: int, lever: int) -> f64:
        """(L7) T per unknown [N m], of the line of rod i whose lever stands there."""
        return bending_stiffness(rods, case, i, 0) / rods.material[case.rods, i, 0, lever]

    def make_drive(j: int):
        lever, row, rod = at[j], FIRST + j, rod_of[j]

        @wp.func
        def drive(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance]) -> f64:
            """(L7) T"""
            z = call.problem.unknowns[case.index, wp.static(row)]
            if wp.static(slackens[j]):  # (L8)
                z = positive_part(z, rounding_of(call, case))
            return tension_unit(rods, case, wp.static(rod), wp.static(lever)) * z

        return drive

    drives = [make_drive(j) for j in range(len(number))]

    def make_rate(j: int):
        """The derivative of T by its own unknown."""
        lever, rod = at[j], rod_of[j]

        @wp.func
        def rate(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance]) -> f64:
            unit = tension_unit(rods, case, wp.static(rod), wp.static(lever))
            if wp.static(slackens[j]):
                unit *= positive_rate(call.problem.unknowns[case.index, wp.static(FIRST + j)], rounding_of(call, case))
            return unit

        return rate

    rates = [make_rate(j) for j in range(len(number))]

    @wp.func
    def loose(rods: wp.ref[RodTable], case: wp.ref[Instance], i: int, lever: int) -> f64:
        """(L8) What a slack line's condition varies by with its unknown: as much as that of a taut one in a straight rod."""
        r = rods.material[case.rods, i, 0, lever]
        c = rods.material[case.rods, i, 0, lever + 1]
        natural = rods.material[case.rods, i, 0, lever + 2]
        return (natural + c * tension_unit(rods, case, i, lever) / r) / case.scale

    @wp.func
    def growth(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], i: int, lever: int) -> f64:
        """(L7b) Rest length per translation, one number for each way."""
        if wp.static(STRAIGHT):
            return rods.material[case.rods, i, 0, lever + 7]
        if call.problem.inputs[case.index, wp.static(TRANSLATION)] < f64(0.0):
            return rods.material[case.rods, i, 0, lever + 5]
        return rods.material[case.rods, i, 0, lever + 4]

    def make_writers(j: int, rest):
        """Functions that write condition j, and its column k, then those after it; they return the sum of what they write."""
        lever, drive, rate, length, row = at[j], drives[j], rates[j], LENGTHS_AT + number[j], FIRST + j
        place, slack, residual = DRIVES_AT + PLACES[number[j]], slackens[j], ROW + j
        rod, translation = rod_of[j], TRANSLATION + rod_of[j]
        rest_of, rest_of_column = rest

        @wp.func
        def write(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], y: State) -> f64:
            r = rods.material[case.rods, wp.static(rod), 0, wp.static(lever)]
            c = rods.material[case.rods, wp.static(rod), 0, wp.static(lever + 1)]
            natural = rods.material[case.rods, wp.static(rod), 0, wp.static(lever + 2)]
            excess = rods.material[case.rods, wp.static(rod), 0, wp.static(lever + 3)]
            if wp.static(RAISED):  # (L7c) tubes are straight where continuation begins
                straight = rods.material[case.rods, wp.static(rod), 0, wp.static(lever + 6)]
                natural = straight + wp.sqrt(call.problem.load_factor[case.index]) * (natural - straight)
            asked = natural + call.problem.load_factor[case.index] * (excess - call.problem.inputs[case.index, wp.static(place)])
            asked += (
                growth(rods, call, case, wp.static(rod), wp.static(lever))
                * call.problem.inputs[case.index, wp.static(translation)]
            )
            gap = (asked + c * drive(rods, call, case) - y[wp.static(length)]) / (r * case.scale)
            if wp.static(slack):
                z = call.problem.unknowns[case.index, wp.static(row)]
                gap += loose(rods, case, wp.static(rod), wp.static(lever)) * (z - positive_part(z, rounding_of(call, case)))
            call.problem.residual[case.index, wp.static(residual)] = gap
            return wp.abs(gap) + rest_of(rods, call, case, y)

        @wp.func
        def write_column(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], v: Column, k: int) -> f64:
            unit = rods.material[case.rods, wp.static(rod), 0, wp.static(lever)] * case.scale
            change = -v[wp.static(length)]
            if k == wp.static(row):
                change += rods.material[case.rods, wp.static(rod), 0, wp.static(lever + 1)] * rate(rods, call, case)
            if k < call.unknown_columns:
                change = change / unit
                if wp.static(slack):
                    if k == wp.static(row):
                        z = call.problem.unknowns[case.index, wp.static(row)]
                        held_less = f64(1.0) - positive_rate(z, rounding_of(call, case))
                        change += loose(rods, case, wp.static(rod), wp.static(lever)) * held_less
                call.problem.gamma[case.index, wp.static(residual), k] = change
            else:
                direction = k - call.unknown_columns
                change -= (
                    call.problem.load_factor[case.index] * call.problem.directions[case.direction, direction, wp.static(place)]
                )
                shift = call.problem.directions[case.direction, direction, wp.static(translation)]
                change += growth(rods, call, case, wp.static(rod), wp.static(lever)) * shift
                call.problem.residual_directions[case.index, wp.static(residual), direction] = change / unit
            return wp.abs(change) + rest_of_column(rods, call, case, v, k)

        return write, write_column

    @wp.func
    def write_none(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], y: State) -> f64:
        """After the last."""
        return f64(0.0)

    @wp.func
    def write_no_column(rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], v: Column, k: int) -> f64:
        """After the last."""
        return f64(0.0)

    writers = (write_none, write_no_column)
    for j in reversed(range(len(number))):
        writers = make_writers(j, writers)

    def make_length(j: int, rest):
        """Where length j stands in a state and in a column, and how long one is, and those after it."""
        lever, rod, length = at[j], rod_of[j], LENGTHS_AT + number[j]
        rest_place, rest_unit = rest

        @wp.func
        def length_place(i: int) -> int:
            if i == wp.static(j):
                return wp.static(length)
            return rest_place(i)

        @wp.func
        def length_unit(rods: wp.ref[RodTable], case: wp.ref[Instance], i: int) -> f64:
            """(L7) Length per residual [m^2]."""
            if i == wp.static(j):
                return rods.material[case.rods, wp.static(rod), 0, wp.static(lever)] * case.scale
            return rest_unit(rods, case, i)

        return length_place, length_unit

    @wp.func
    def no_place(i: int) -> int:
        """After the last."""
        return -1

    @wp.func
    def no_unit(rods: wp.ref[RodTable], case: wp.ref[Instance], i: int) -> f64:
        """After the last."""
        return f64(1.0)

    lengths = (no_place, no_unit)
    for j in reversed(range(len(number))):
        lengths = make_length(j, lengths)

    return SimpleNamespace(
        first=FIRST,
        length_place=lengths[0],
        length_unit=lengths[1],
        drive_of=dict(zip(number, drives, strict=True)),
        rate_of=dict(zip(number, rates, strict=True)),
        write=writers[0],
        write_column=writers[1],
    )
