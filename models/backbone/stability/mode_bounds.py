"""How many unstable modes concentric tubes can have, whatever their configuration, from their precurvatures and stiffnesses
alone.

Numbers in parentheses are those of ``docs/stability.md``.
"""

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
        """How far a unit torque at ``s``, (batch, k), twists each rod there, (batch, k, n)."""
        return np.asarray(
            (np.clip(s[..., None, None] - begin[:, None], 0.0, (end - begin)[:, None]) * compliance[:, None]).sum(axis=3)
        )

    # where nothing but the compliances changes, and these linearly; the constraint is where the last pair of rods ends
    cuts = np.sort(np.concatenate([np.zeros((count, 1)), np.maximum(end, 0.0).reshape(count, -1)], axis=1), axis=1)
    constrained = twisted(tips[:, -2:-1])[:, 0]
    size = np.diff(cuts, axis=1)
    middle = cuts[:, :-1] + 0.5 * size
    inside = middle[..., None, None]
    here = (begin[:, None] <= inside) & (inside < end[:, None]) & (size > 0)[..., None, None]
    together = (EI[:, None] * here).sum(axis=(2, 3))
    together[together == 0] = np.inf  # between ends that rounding parts
    bend = ((EI * kappa)[:, None] * here).sum(axis=3)
    form = -bend[..., :, None] * bend[..., None, :] / together[..., None, None]
    form[..., range(n), range(n)] = 0.0
    form[..., range(n), range(n)] = -form.sum(axis=3)
    twist = twisted(middle)
    root = np.sqrt(twist)
    pulled = form * root[..., :, None] * root[..., None, :]
    pull = (size[..., None, None] * pulled).sum(axis=1)
    load = np.zeros(count)
    if force.any():
        # what the loads add: the force turns the frame, the moment bends what pulls
        each = size / together
        bent = np.cumsum(each, axis=1) - 0.5 * each
        moment = force[:, None] * (tips[:, -1:] - middle)
        load = (size * (force[:, None] * bent + moment / together * (twist * bend).max(axis=2))).sum(axis=1)
        load += np.sqrt((moment**2 * bent * each).sum(axis=1))
    # (15) the direction that is pulled most
    direction = np.linalg.eigh(pull)[1][:, :, -1] / np.sqrt(np.where(constrained > 0, constrained, np.inf))
    first = (size * np.linalg.eigvalsh(pulled)[..., -1]).sum(axis=1)
    trace = (size * (form[..., range(n), range(n)] * twist).sum(axis=2)).sum(axis=1)
    at = np.stack([twisted(cuts[:, :-1]), twist, twisted(cuts[:, 1:])])
    reach = np.minimum(at, constrained[:, None]) * direction[:, None]
    # sums of products, not einsum, which adds in an order that depends on the batch: bitwise the same alone
    products = (reach[..., :, None] * form * reach[..., None, :]).sum(axis=(3, 4))
    taken = (size * (products[0] / 6 + products[1] * (4 / 6) + products[2] / 6)).sum(axis=1)
    scale = np.maximum((direction**2 * constrained).sum(axis=1), 1e-300)
    return np.stack([first + load, trace - taken / scale + load], axis=1)
