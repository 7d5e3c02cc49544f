"""How many unstable modes concentric tubes can have, whatever their configuration, from their precurvatures and stiffnesses alone.

Numbers in parentheses are those of ``docs/stability.md``.
"""

from itertools import product

import numpy as np

from multirod.validation import FloatArray


def bound_modes(
    start: FloatArray, end: FloatArray, compliance: FloatArray, EI: FloatArray, kappa: FloatArray, force: FloatArray
) -> FloatArray:
    """(14) and (15) with what dead forces add, shape (batch, 2): see ``BoundaryProblem.mode_bounds``.

    Args:
        start: Of each rod [m], shape (batch, n).
        end: Of its sections, from there [m], shape (batch, n, section).
        compliance: ``1/GJ`` [1/(N m^2)], shape (batch, n, section).
        EI: [N m^2], shape (batch, n, section).
        kappa: ``|u*_xy|`` [1/m], shape (batch, n, section).
        force: Bound of the internal force [N], shape (batch,).
    """
    count, n = start.shape
    end = end + start[..., None]
    begin = np.concatenate([start[..., None], end[..., :-1]], axis=2)
    tips = np.sort(end[:, :, -1], axis=1)

    def twisted(s: FloatArray) -> FloatArray:
        """How far a unit torque at ``s``, (batch, 1, 1), twists each rod there."""
        return np.asarray((np.clip(s - begin, 0.0, end - begin) * compliance).sum(axis=2))

    # where nothing but the compliances changes, and these linearly; the constraint is where the last pair of rods ends
    cuts = np.sort(np.concatenate([np.zeros((count, 1)), np.maximum(end, 0.0).reshape(count, -1)], axis=1), axis=1)
    constrained = twisted(tips[:, -2, None, None])
    pull = np.zeros((count, n, n))
    stretches = []
    bent = np.zeros(count)
    arm = np.zeros(count)
    load = np.zeros(count)
    for k in range(cuts.shape[1] - 1):
        size = cuts[:, k + 1] - cuts[:, k]
        middle = cuts[:, k] + 0.5 * size
        here = (begin <= middle[:, None, None]) & (middle[:, None, None] < end) & (size > 0)[:, None, None]
        together = (EI * here).sum(axis=(1, 2))
        together[together == 0] = np.inf  # between ends that rounding parts
        bend = (EI * kappa * here).sum(axis=2)
        form = -bend[:, :, None] * bend[:, None] / together[:, None, None]
        form[:, range(n), range(n)] = 0.0
        form[:, range(n), range(n)] = -form.sum(axis=2)
        twist = twisted(middle[:, None, None])
        root = np.sqrt(twist)
        pull += size[:, None, None] * form * root[:, :, None] * root[:, None]
        stretches.append((size, form, twist, twisted(cuts[:, k, None, None]), twisted(cuts[:, k + 1, None, None])))
        if not force.any():
            continue
        # what the loads add: the force turns the frame, the moment bends what pulls
        each = size / together
        moment = force * (tips[:, -1] - middle)
        arm += moment**2 * (bent + 0.5 * each) * each
        load += size * (force * (bent + 0.5 * each) + moment / together * (twist * bend).max(axis=1))
        bent += each
    # (15) the direction that is pulled most
    direction = np.linalg.eigh(pull)[1][:, :, -1] / np.sqrt(np.where(constrained > 0, constrained, np.inf))
    first, trace, taken = np.zeros((3, count))
    for size, form, twist, *ends in stretches:
        root = np.sqrt(twist)
        first += size * np.linalg.eigvalsh(form * root[:, :, None] * root[:, None])[:, -1]
        for i in range(n):
            trace += size * form[:, i, i] * twist[:, i]
        for part, at in ((1 / 6, ends[0]), (4 / 6, twist), (1 / 6, ends[1])):
            reach = np.minimum(at, constrained) * direction
            # in one order, whatever the batch: bitwise the same alone
            for i, j in product(range(n), repeat=2):
                taken += part * size * reach[:, i] * form[:, i, j] * reach[:, j]
    scale = np.maximum((direction**2 * constrained).sum(axis=1), 1e-300)
    load += np.sqrt(arm)
    return np.stack([first + load, trace - taken / scale + load], axis=1)
