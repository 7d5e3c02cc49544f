"""Where damped dynamics lead a network of rigid segments (``graph_energy``), by implicit Euler: what has no potential has a place
to rest, or none, and no energy to tell."""

import numpy as np

REST = 1e-8  # of what is lacking, over the energy's unit
LONGEST, WANTED = 0.15, 0.05  # rad and lengths in a step: no longer, and from which on the next is not
LAST = 1e-4  # as long, that leads to where a piece of a rod in a hole has no length


def flowed(graph, state, steps=1000):
    """Where it comes to, and whether that is rest. Each variable moves by what is lacking in it, in what counts as one there, and
    constraints are met: ``(J/dt + H) z = -g``, ``J`` one of what is free and zero of multipliers."""
    scale, damped, dt = graph.scale, np.zeros(graph.size), 1e-3
    damped[: graph.free] = 1.0
    for _ in range(steps):
        g, H = graph.system(state)
        slope = scale * g / graph.unit
        if np.linalg.norm(slope) < REST:
            return state, True
        way = np.linalg.solve(scale[:, None] * H * scale / graph.unit + np.diag(damped) / dt, -slope)
        size = np.abs(way[: graph.free]).max()
        trial = graph.moved(state, scale * way) if size <= LONGEST else None
        if trial is None or not graph.is_possible(trial):
            if size < LAST:
                break
            dt *= 0.3
            continue
        state, dt = trial, dt * (1.5 if size < WANTED else 1.0)
    return state, False
