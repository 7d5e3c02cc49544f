# mypy: ignore-errors
"""How a thread carries its jobs: each lane from stretch to stretch, by steps of its own, until none is left.

What happens along a stretch is done in all lanes at once: ``strains``, ``loads``, ``rates``, ``steps``. What happens at the ends
and at nodes is done for one lane, in double precision: ``grid``, ``base``, ``tip``, ``nodes``. What a job is, a whole backbone or
a segment of one, is for the kernels to say (``integrate``, ``segments``). See ``docs/kernels.md``.
"""

from types import SimpleNamespace

import warp as wp

from multirod.integrators import Tableau
from multirod.models.backbone.kernels.along import make_along
from multirod.models.backbone.kernels.equations.base import make_base
from multirod.models.backbone.kernels.equations.rates import make_rates
from multirod.models.backbone.kernels.equations.tip import make_tip
from multirod.models.backbone.kernels.integration.grid import make_grid
from multirod.models.backbone.kernels.integration.nodes import make_nodes
from multirod.models.backbone.kernels.integration.steps import make_steps
from multirod.models.backbone.kernels.layout.arguments import (
    END,
    END_MOVER,
    FAULT,
    FORCE,
    JOB,
    OUTPUT,
    PASSED,
    START,
    START_MOVER,
    STOP,
    STRETCH_END,
    Call,
    Instance,
    RodTable,
)
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.layout import Layout
from multirod.models.backbone.kernels.loads.dead import make_loads
from multirod.models.backbone.kernels.numbers.lanes import lanes
from multirod.models.backbone.kernels.records import make_records
from multirod.status import Fault

f64 = wp.float64
SCALARS = {"float64": wp.float64, "float32": wp.float32}
NEVER = 1e30  # steps left of a lane that waits
BESIDE_BASE = 1e-9  # of the length
SMALL_MOMENT = 1e-3  # [N m], or natural units in single precision: keeps the first step finite without a moment


def make_parts(features: Features, tableau: Tableau, precision: str, W: int) -> SimpleNamespace:
    """What kernels over whole backbones and over segments of them have in common."""
    d = SCALARS[precision]
    layout = Layout(features)
    memory = layout.memory(len(tableau.b))
    L = lanes(W, d)
    fill, any_less, row, get_lane, set_lane, one_of = L.fill, L.any_less, L.row, L.get, L.set, L.one
    memory_type = wp.array(dtype=d)
    grid = make_grid(layout, memory, W, d)
    base = make_base(layout, grid)
    tip = make_tip(layout, base, grid)
    nodes = make_nodes(layout, memory, base, tip, W, d)
    record = make_records(layout, memory, base, grid, W, d)
    rates = make_rates(layout, W, d)
    step = make_steps(layout, memory, tableau, rates, W, d)
    force_variation = make_loads(layout, W, d).force_variation
    load_stretch, find_stop, pass_force, set_number = grid.load_stretch, grid.find_stop, grid.pass_force, grid.set_number
    output_arclength, rod_end, n = grid.output_arclength, grid.rod_end, layout.n
    write_node, write_node_column = nodes.write_node, nodes.write_node_column
    state_in, frame, equal_step, place_here = record.state_in, tip.frame, step.equal_step, step.place_here
    controlled_step, least_size = step.controlled_step or equal_step, step.least_size
    ADAPTIVE = step.controlled_step is not None
    GIVEN_FORCE, DIRECTIONS, FORCE_ACTS = layout.GIVEN_FORCE, layout.DIRECTIONS, layout.FORCE
    s, g, NODES, NODE_COLUMNS = layout.steps, layout.given, layout.NODES, features.node_columns
    X, LENGTH, SIZE, LEFT = s["x"], s["length"], s["size"], s["left"]
    ACTIVE, COUNT, REJECTED, LONGEST, CONTROLLED = s["active"], s["count"], s["rejected"], s["longest"], s["controlled"]
    Z, COLUMNS, COLUMN_SIZE, GIVEN = memory.STRETCH, memory.COLUMNS, memory.COLUMN_SIZE, layout.column.size
    PLACE, CURVATURE_AT, MOMENT_AT, GIVEN_FORCE_AT = memory.PLACES, layout.place["curvature"], layout.place["moment"], g["force"]
    COMPLIANCE_AT, UNANSWERED, MEMBERS = layout.stretch["compliance"], layout.stretch["unanswered"], bool(features.members)

    @wp.func
    def first_column(call: wp.ref[Call], job: int) -> int:
        return (job % call.parts) * call.part_columns

    @wp.func
    def column_count(call: wp.ref[Call], job: int) -> int:
        """Columns of a lane: the last part may have fewer."""
        rest = call.unknown_columns + call.direction_columns - first_column(call, job)
        return wp.max(0, wp.min(call.part_columns, rest))

    @wp.func(inline=False)
    def begin(
        call: wp.ref[Call],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        p: int,
        start: f64,
        stop: f64,
        n0: wp.vec3d,
    ):
        """A lane at ``start``, on its way to ``stop``; its state is there."""
        call.lane[p, START] = start
        call.lane[p, END] = start
        call.lane[p, START_MOVER] = f64(-1.0)
        call.lane[p, STOP] = stop
        call.lane[p, OUTPUT] = f64(0.0)
        call.lane[p, PASSED] = f64(0.0)
        call.lane[p, FAULT] = f64(0.0)
        for j in range(3):
            call.lane[p, FORCE + j] = n0[j]
        set_number(memory, o + wp.static(SIZE), l, f64(-1.0))
        set_number(memory, o + wp.static(COUNT), l, f64(0.0))
        set_number(memory, o + wp.static(REJECTED), l, f64(0.0))
        set_number(memory, o + wp.static(LONGEST), l, case.length / case.unit)

    @wp.func(inline=False)
    def onto_stretch(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        case: wp.ref[Instance],
        memory: memory_type,
        o: int,
        l: int,
        p: int,
        job: int,
        steps: f64,
        multiple: f64,
        over: f64,
    ):
        """A lane on its way to its next stop: by ``steps`` equal ones over a length, or as errors choose where that is 0."""
        begun = call.lane[p, END]
        if call.lane[p, START] < begun:
            find_stop(rods, call, case, p)
        else:
            load_stretch(rods, call, case, memory, o, l, p, job, first_column(call, job), column_count(call, job))
            set_number(memory, o + wp.static(X), l, f64(0.0))
        length = call.lane[p, END] - begun
        set_number(memory, o + wp.static(LENGTH), l, (call.lane[p, END] - call.lane[p, START]) / case.unit)
        set_number(memory, o + wp.static(ACTIVE), l, f64(1.0))
        left = f64(1.0)
        controlled = f64(1.0)
        if steps > f64(0.0):
            share = steps / multiple * (length / over)
            if share < f64(wp.inf):  # else it is of an iterate that is not finite, and ends at once
                left = wp.max(f64(1.0), wp.ceil(share - f64(1.0e-9))) * multiple
            controlled = f64(0.0)
            set_number(memory, o + wp.static(SIZE), l, length / left / case.unit)
        set_number(memory, o + wp.static(LEFT), l, left)
        set_number(memory, o + wp.static(CONTROLLED), l, controlled)

    @wp.func(inline=False)
    def at_end(
        rods: wp.ref[RodTable], call: wp.ref[Call], case: wp.ref[Instance], memory: memory_type, o: int, l: int, p: int, job: int
    ):
        """A lane where it has stopped: outputs there, and, at the end of its stretch, the force from there on."""
        end = call.lane[p, END]
        y = state_in(case, memory, o, l)
        if wp.static(NODES):
            output = int(call.lane[p, OUTPUT]) + 1
            # an iterate may have a length that is none, and so be past all nodes
            if output < call.node_count and end >= output_arclength(rods, call, case, output):
                if job % call.parts == 0:
                    write_node(rods, call, case, memory, o, l, y, output, end)
                call.lane[p, OUTPUT] = f64(output)
        if wp.static(NODE_COLUMNS):
            # what twists behind the plate varies there too, the frame hardly: no inverse has a meaning beside the base
            counted = end > f64(wp.static(BESIDE_BASE)) * case.length
            for i in range(wp.static(n)):
                counted = counted or end == rod_end(rods, call, case, i)
            passed = int(call.lane[p, PASSED])
            if call.node_count > 0 and counted and passed < call.column_arclength.shape[1]:
                q = frame(y)
                for c in range(column_count(call, job)):
                    at = o + wp.static(COLUMNS) + c * wp.static(COLUMN_SIZE)
                    write_node_column(call, case, memory, at, l, passed, q, end, first_column(call, job) + c)
                call.lane[p, PASSED] = f64(passed + 1)
        if end < call.lane[p, STRETCH_END]:
            return
        if wp.static(FORCE_ACTS):
            pass_force(rods, call, case, p)
        if wp.static(GIVEN_FORCE and DIRECTIONS):
            x = row(memory, o + wp.static(X))
            for c in range(call.part_columns):
                at = o + wp.static(COLUMNS + GIVEN) + c * wp.static(COLUMN_SIZE)
                dn = force_variation(memory, o + wp.static(Z), at, x)
                set_lane(memory, at + wp.static(GIVEN_FORCE_AT), l, one_of(dn.x, l))
                set_lane(memory, at + wp.static(GIVEN_FORCE_AT + 1), l, one_of(dn.y, l))
                set_lane(memory, at + wp.static(GIVEN_FORCE_AT + 2), l, one_of(dn.z, l))
        call.lane[p, START] = end
        call.lane[p, START_MOVER] = call.lane[p, END_MOVER]

    @wp.func(inline=False)
    def wait(memory: memory_type, o: int, l: int):
        """A lane without a job."""
        set_number(memory, o + wp.static(ACTIVE), l, f64(0.0))
        set_number(memory, o + wp.static(LEFT), l, f64(NEVER))
        set_number(memory, o + wp.static(LENGTH), l, f64(1.0))
        set_number(memory, o + wp.static(X), l, f64(0.0))
        set_number(memory, o + wp.static(SIZE), l, f64(1.0))
        set_number(memory, o + wp.static(COUNT), l, f64(0.0))
        set_number(memory, o + wp.static(REJECTED), l, f64(0.0))
        set_number(memory, o + wp.static(LONGEST), l, f64(1.0))
        set_number(memory, o + wp.static(CONTROLLED), l, f64(0.0))

    @wp.func(inline=False)
    def free(call: wp.ref[Call], memory: memory_type, o: int, l: int, p: int):
        """A lane that takes the first job it is offered."""
        wait(memory, o, l)
        call.lane[p, JOB] = f64(-1.0)
        set_number(memory, o + wp.static(LEFT), l, f64(0.0))

    @wp.func
    def cause(memory: memory_type, o: int, l: int, fault: int) -> int:
        """Of a fault: the strain law, where it had no answer on this stretch."""
        if wp.static(MEMBERS):
            if get_lane(memory, o + wp.static(Z + UNANSWERED), l) > d(0.5):
                return wp.static(int(Fault.STRAIN_LAW))
        return fault

    @wp.func(inline=False)
    def check(call: wp.ref[Call], memory: memory_type, o: int, p: int):
        """Lanes whose steps came to nothing, or are too many, end as they are."""
        for l in range(wp.static(W)):
            if call.lane[p + l, JOB] >= f64(0.0):
                fault = int(wp.static(int(Fault.NONE)))
                if f64(get_lane(memory, o + wp.static(COUNT), l)) >= f64(call.step_limit):
                    fault = int(wp.static(int(Fault.STEP_LIMIT)))
                if not (get_lane(memory, o + wp.static(SIZE), l) >= one_of(least_size(memory, o), l)):
                    fault = int(wp.static(int(Fault.NONFINITE)))
                if fault != wp.static(int(Fault.NONE)):
                    fault = cause(memory, o, l, fault)
                if fault != wp.static(int(Fault.NONE)):
                    call.lane[p + l, FAULT] = f64(fault)
                    set_number(memory, o + wp.static(LEFT), l, f64(0.0))

    @wp.func
    def some_at_end(memory: memory_type, o: int) -> bool:
        return any_less(row(memory, o + wp.static(LEFT)), fill(d(0.5)))

    @wp.func
    def is_at_end(memory: memory_type, o: int, l: int) -> bool:
        return get_lane(memory, o + wp.static(LEFT), l) < d(0.5)

    @wp.func
    def advance(call: wp.ref[Call], memory: memory_type, o: int, p: int):
        """One step in every lane."""
        if wp.static(ADAPTIVE):
            controlled_step(memory, o, call.part_columns, d(call.rtol), d(call.atol), d(wp.static(SMALL_MOMENT)))
            small = any_less(row(memory, o + wp.static(SIZE)), least_size(memory, o))
            if small or any_less(fill(d(call.step_limit) - d(0.5)), row(memory, o + wp.static(COUNT))):
                check(call, memory, o, p)
        else:
            equal_step(memory, o, call.part_columns)

    @wp.func
    def at_base(call: wp.ref[Call], memory: memory_type, o: int, l: int, p: int) -> bool:
        """Whether a lane that writes nodes stands on its base and has written none yet."""
        there = call.lane[p, JOB] >= f64(0.0) and call.lane[p, START] == f64(0.0) and call.lane[p, OUTPUT] == f64(0.0)
        writes = call.node_count > 0 and int(call.lane[p, JOB]) % call.parts == 0
        return there and writes and get_lane(memory, o + wp.static(X), l) == d(0.0)

    @wp.func
    def force_at(call: wp.ref[Call], p: int) -> wp.vec3d:
        """(3a) n where a lane stands."""
        return wp.vec3d(call.lane[p, FORCE], call.lane[p, wp.static(FORCE + 1)], call.lane[p, wp.static(FORCE + 2)])

    @wp.func
    def precurvature_here(case: wp.ref[Instance], memory: memory_type, o: int, l: int) -> wp.vec3d:
        """u* of the one rod where a lane stands, as (12) needs it; else zero."""
        u_star = wp.vec3d(f64(0.0), f64(0.0), f64(0.0))
        if wp.static(features.measured):
            for j in range(3):
                u = f64(get_lane(memory, o + wp.static(PLACE + CURVATURE_AT) + j, l))
                K = f64(get_lane(memory, o + wp.static(Z + COMPLIANCE_AT) + j, l))
                M = f64(get_lane(memory, o + wp.static(PLACE + MOMENT_AT) + j, l))
                u_star[j] = (u - K * M) / case.unit
        return u_star

    @wp.func
    def step_count(memory: memory_type, o: int, l: int) -> int:
        return int(get_lane(memory, o + wp.static(COUNT), l))

    if features.along:
        known = SimpleNamespace(
            at_end=at_end,
            output_arclength=output_arclength,
            state_in=state_in,
            first_column=first_column,
            column_count=column_count,
        )
        at_end = make_along(layout, memory, rates, known, W, d)
    own = SimpleNamespace(
        layout=layout, memory=memory, memory_type=memory_type, lanes=W, first_column=first_column, column_count=column_count,
        begin=begin, onto_stretch=onto_stretch, at_end=at_end, wait=wait, free=free, some_at_end=some_at_end, is_at_end=is_at_end,
        advance=advance, at_base=at_base, place_here=place_here, force_at=force_at, precurvature_here=precurvature_here,
        step_count=step_count, cause=cause,
    )  # fmt: skip
    return SimpleNamespace(own=own, grid=grid, base=base, tip=tip, nodes=nodes, record=record)


def make_carry(parts: SimpleNamespace, features: Features, jobs: SimpleNamespace):
    """The function with which a thread carries its share of jobs: ``(rods, call, jobs, memory, thread)``.

    Args:
        parts: Of the kernel.
        features: Its terms.
        jobs: What a job is: ``Jobs``, the type of the argument that lists what there is to do, and functions of it: how many
            there are (``count``), whether one is ``wanted``, the instance of one (``instance_of``), a lane at its beginning
            (``enter``), on to its next stretch (``go_on``), and at its end (``finish``).
    """
    own, grid = parts.own, parts.grid
    memory_type, W = own.memory_type, own.lanes
    at_end, wait, free, some_at_end, is_at_end = own.at_end, own.wait, own.free, own.some_at_end, own.is_at_end
    advance, at_base, place_here, take_up = own.advance, own.at_base, own.place_here, grid.take_up
    write_node, state_in = parts.nodes.write_node, parts.record.state_in
    Jobs, count, wanted, instance_of = jobs.Jobs, jobs.count, jobs.wanted, jobs.instance_of
    enter, go_on, finish = jobs.enter, jobs.go_on, jobs.finish
    NODES, MEASURED = own.layout.NODES, features.measured

    @wp.func
    def attend(
        rods: wp.ref[RodTable],
        call: wp.ref[Call],
        jobs: wp.ref[Jobs],
        memory: memory_type,
        o: int,
        l: int,
        p: int,
        coming: int,
        stop: int,
    ) -> int:
        """A lane that is at the end of a stretch, or free, goes on to its next stretch or job. Returns the next job."""
        job = int(call.lane[p, JOB])
        following = coming + int(0)
        fresh = int(0)
        while fresh < 2:
            if job < 0:
                while following < stop and not wanted(call, jobs, wp.min(following, stop - 1) // call.parts):
                    following += int(1)
                if following < stop:
                    job = following
                    following += int(1)
                    fresh = int(1)
                else:
                    fresh = int(3)
            if job >= 0:
                if fresh == 1:
                    take_up(rods, call, instance_of(call, jobs, job // call.parts), l, p, job)
                    enter(rods, call, jobs, call.carried[p], memory, o, l, p, job)
                else:
                    s = call.lane[p, START]
                    if call.lane[p, FAULT] == f64(0.0):
                        at_end(rods, call, call.carried[p], memory, o, l, p, job)
                    if not (call.lane[p, START] < call.lane[p, STOP]) or call.lane[p, FAULT] != f64(0.0):
                        finish(rods, call, jobs, call.carried[p], memory, o, l, p, job, s)
                        job = -1
                if job >= 0:
                    go_on(rods, call, jobs, call.carried[p], memory, o, l, p, job)
                    fresh = int(2)
        if job < 0:
            wait(memory, o, l)
        call.lane[p, JOB] = f64(job)
        return following

    @wp.func
    def carry(rods: wp.ref[RodTable], call: wp.ref[Call], jobs: wp.ref[Jobs], memory: memory_type, thread: int):
        """All lanes of a thread, stretch by stretch, until no job is left."""
        coming = thread * call.chunk
        stop = wp.min(coming + call.chunk, count(call, jobs) * call.parts)
        p = thread * wp.static(W)
        o = 0  # a constant: then so are the addresses of all records but the columns
        for l in range(wp.static(W)):
            free(call, memory, o, l, p + l)
        busy = int(1)
        while busy == 1:
            if some_at_end(memory, o):
                if wp.static(NODES or MEASURED):
                    place_here(memory, o)
                busy = int(0)
                taken = coming + int(0)
                for l in range(wp.static(W)):
                    if is_at_end(memory, o, l):
                        coming = attend(rods, call, jobs, memory, o, l, p + l, coming, stop)
                    if call.lane[p + l, JOB] >= f64(0.0):
                        busy = int(1)
                if wp.static(NODES):
                    if coming > taken:
                        place_here(memory, o)
                        for l in range(wp.static(W)):
                            if at_base(call, memory, o, l, p + l):
                                y = state_in(call.carried[p + l], memory, o, l)
                                write_node(rods, call, call.carried[p + l], memory, o, l, y, 0, f64(0.0))
            if busy == 1:
                advance(call, memory, o, p)

    return carry
