"""What a network leaves free: bodies that nobody holds, rods and bodies that move without a rod being bent.

Numbers in parentheses are those of ``docs/networks.md``.
"""

import numpy as np

from multirod.models.network.graph import GROUND, Graph
from multirod.models.network.joining.joints import KINDS
from multirod.rotations import cross, cross_matrix, matrices
from multirod.validation import FloatArray, refuse

SINGULAR = 1e-9  # of the largest singular value
SIX = 6


def refuse_unheld(graph: Graph) -> None:
    """Refuse, by a ``ValueError`` that names it, a body or a rod that no chain of rods joins to the ground."""
    frames = [end.frame for end in graph.ends]
    for k, body in enumerate(graph.fixed, len(graph.moving) + 1):
        if not any((end.stand == k).any() for end in graph.ends):
            refuse("Network.bodies", body, f"nothing holds on to body {body.name!r}: no rod is joined to it")
    if (frames[0] < GROUND).any():
        name = graph.names[int(np.argmax(frames[0] < GROUND))]
        refuse("Network.joints", name, f"nothing holds the base of rod {name!r}: only a tip may be free")
    known = {GROUND}
    while True:
        more = {int(frames[1 - k][rod]) for k in (0, 1) for rod in range(len(graph.rods)) if int(frames[k][rod]) in known}
        if more <= known | {-1}:
            break
        known |= more - {-1}
    for k, body in enumerate(graph.moving):
        if k + 1 in known:
            continue
        if not any((own == k + 1).any() for own in frames):
            refuse("Network.bodies", body, f"nothing holds body {body.name!r}: no rod is joined to it")
        refuse(
            "Network.joints",
            body,
            f"nothing holds body {body.name!r}: no chain of rods joins it to the ground; of what floats, hold one body, "
            "fixed=True: where loads balance, it bears nothing",
        )


def refuse_mechanism(graph: Graph) -> None:
    """(14) Refuse, by a ``ValueError`` that names it, a rod or body that is free to move though rods are as stiff as they are.

    It is looked for at poses drawn by lot: what is found there is so wherever the bodies are.
    """
    rng = np.random.default_rng(0)
    bodies = len(graph.moving)
    moved = bodies + len(graph.fixed)
    position = np.concatenate([np.zeros((1, 3)), rng.standard_normal((moved, 3))])
    rotation = np.concatenate([np.eye(3)[None], matrices(rng.standard_normal((moved, 3)))])
    arms = [own.pose.reshape(-1, *own.pose.shape[-3:])[0] for own in graph.ends]
    size = max(float(np.abs(arm[:, :3, 3]).max()) for arm in arms) or 1.0
    wrenches: list[FloatArray] = []
    slides = graph.slides
    for whole, name in enumerate(graph.whole_names):
        pieces = slides.of(whole)
        free = []
        for own, arm, rod in zip(graph.ends, arms, (pieces[0], pieces[-1]), strict=True):
            holder, count = own.stand[rod], int(own.table.count[rod])
            if holder < GROUND:
                # nothing holds the tip: the rod passes on no wrench at all
                free.append(np.eye(SIX))
                continue
            frame = rotation[holder] @ arm[rod, :3, :3]
            loose = (own.table.stiffness[rod, :count] == 0) & ~own.table.driven[rod]
            angles = rng.standard_normal((1, len(graph.names), 3)) * (np.arange(3) < own.table.count[:, None])
            turns = own.table.at(angles)
            place = position[holder] + rotation[holder] @ (arm[rod, :3, 3] / size + arm[rod, :3, :3] @ turns.moved[0, rod])
            axes, along = ((frame @ values)[:, :count][:, loose].T for values in (turns.axes[0, rod], turns.slides[rod]))
            along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)  # (36)
            free.append(np.concatenate([cross(axes, np.broadcast_to(-place, axes.shape)) + along, axes], axis=1))
        held = graph.ends[1].held[pieces[-1]]
        turning = len(free[0])
        conditions = np.zeros((len(free[0]) + len(free[1]), SIX * len(pieces)))
        conditions[:turning, :SIX], conditions[turning:, -SIX:] = free
        # (14) what a hole passes on to its body is neither along the rod nor about an axis about which the rod turns there
        for k, rod in enumerate(pieces[:-1] if slides.sliding[pieces[0]] else ()):
            own, arm = graph.ends[1], arms[1]
            frame = rotation[own.stand[rod]] @ arm[rod, :3, :3]
            place = position[own.stand[rod]] + rotation[own.stand[rod]] @ arm[rod, :3, 3] / size
            count = int(own.table.count[rod])
            axes = (frame @ own.table.inner[rod])[:, :count].T
            along = frame[:, 2] if count < KINDS["spherical"] else rng.standard_normal(3)
            jump = [np.concatenate([along, np.zeros(3)])]
            jump += [np.concatenate([np.cross(axis, -place), axis]) for axis in axes]
            rows = np.zeros((len(jump), SIX * len(pieces)))
            rows[:, SIX * k : SIX * k + SIX], rows[:, SIX * k + SIX : SIX * k + 2 * SIX] = jump, -np.array(jump)
            conditions = np.concatenate([conditions, rows])
        if (not held and turning) or (held and _rank(conditions) < len(conditions)):
            how = "its base turns, and nothing holds its tip" if not held else "its joints let it turn about itself"
            refuse("Network.joints", name, f"rod {name!r} is free to move: {how}; clamp an end, or give a joint stiffness")
        wrenches.append(_kernel(conditions))
    if not bodies:
        return
    columns = []
    for whole, passed in enumerate(wrenches):
        column = np.zeros((SIX * bodies, passed.shape[1]))
        for place_in_rod, rod in enumerate(slides.of(whole)):
            by_piece = passed[SIX * place_in_rod : SIX * place_in_rod + SIX]
            for own, sense in zip(graph.ends, (-1.0, 1.0), strict=True):
                k = own.frame[rod] - 1
                if k >= 0:
                    about = np.eye(SIX)
                    about[3:, :3] = -cross_matrix(position[k + 1])
                    column[SIX * k : SIX * k + SIX] += sense * about @ by_piece
        columns.append(column)
    balance = np.concatenate(columns, axis=1)
    if _rank(balance) == SIX * bodies:
        return
    motion = _kernel(balance.T)
    body = graph.moving[int(np.argmax(np.linalg.norm(motion.reshape(bodies, SIX, -1), axis=(1, 2))))]
    missing = SIX * bodies - _rank(balance)
    refuse(
        "Network.joints",
        body.name,
        f"body {body.name!r} is free to move in {missing} way{'s' * (missing > 1)} without a rod being bent: "
        "clamp more ends, add rods, or give joints stiffness",
    )


def _rank(matrix: FloatArray) -> int:
    values = np.linalg.svd(matrix, compute_uv=False)
    return int((values > SINGULAR * max(float(values.max(initial=0.0)), 1e-300)).sum())


def _kernel(matrix: FloatArray) -> FloatArray:
    """What a matrix maps to zero, as columns."""
    if not len(matrix):
        return np.eye(matrix.shape[1])
    return np.asarray(np.linalg.svd(matrix)[2][_rank(matrix) :].T)
