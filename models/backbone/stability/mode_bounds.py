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
    # sums over the few rods and sections are written out: those along short last axes would take most of the time
    count, n = start.shape
    end, compliance, EI, kappa = (np.moveaxis(values, 2, 0) for values in (end, compliance, EI, kappa))
    end = end + start
    begin = np.concatenate([start[None], end[:-1]])
    tips = np.sort(end[-1], axis=1)

    # where nothing but the compliances changes, and these linearly; the constraint is where the last pair of rods ends
    cuts = np.sort(np.concatenate([np.zeros((count, 1)), *np.maximum(end, 0.0)], axis=1), axis=1)
    size = np.diff(cuts, axis=1)
    middle = cuts[:, :-1] + 0.5 * size
    # how far a unit torque twists each rod there, (batch, place, n)
    places = np.concatenate([cuts, middle, tips[:, -2:-1]], axis=1)[..., None]
    twists = sum(
        np.minimum(np.maximum(places - a[:, None], 0.0), (b - a)[:, None]) * soft[:, None]
        for a, b, soft in zip(begin, end, compliance, strict=True)
    )
    at_cuts, twist, constrained = twists[:, : cuts.shape[1]], twists[:, cuts.shape[1] : -1], twists[:, -1]
    inside, some = middle[..., None], (size > 0)[..., None]
    here = [(a[:, None] <= inside) & (inside < b[:, None]) & some for a, b in zip(begin, end, strict=True)]
    together = _over_rods(sum(own[:, None] * present for own, present in zip(EI, here, strict=True)))
    together[together == 0] = np.inf  # between ends that rounding parts
    bend = sum(own[:, None] * present for own, present in zip(EI * kappa, here, strict=True))
    # (13) P, of which this is the diagonal
    pull = _over_rods(bend)
    own = bend * (pull[..., None] - bend) / together[..., None]
    rooted = bend * np.sqrt(twist)
    pulled = -rooted[..., :, None] * rooted[..., None, :] / together[..., None, None]
    pulled[..., range(n), range(n)] = own * twist
    load = np.zeros(count)
    if force.any():
        # what the loads add: the force turns the frame, the moment bends what pulls
        each = size / together
        bent = np.cumsum(each, axis=1) - 0.5 * each
        moment = force[:, None] * (tips[:, -1:] - middle)
        load = (size * (force[:, None] * bent + moment / together * (twist * bend).max(axis=2))).sum(axis=1)
        load += np.sqrt((moment**2 * bent * each).sum(axis=1))
    # (15) d, of the direction that is pulled most
    whole = (size[..., None, None] * pulled).sum(axis=1)
    direction = np.linalg.eigh(whole)[1][:, :, -1] / np.sqrt(np.where(constrained > 0, constrained, np.inf))
    first = (size * np.linalg.eigvalsh(pulled)[..., -1]).sum(axis=1)
    trace = (size * _over_rods(own * twist)).sum(axis=1)

    # r, and P r, which is linear along each stretch
    reach = np.minimum(at_cuts, constrained[:, None]) * direction[:, None]
    left, right = (
        bend * (pull[..., None] * turn - _over_rods(bend * turn)[..., None]) / together[..., None]
        for turn in (reach[:, :-1], reach[:, 1:])
    )
    # the torques that this adds up to, quadratic along it: what they store, and the work of P r on r
    long, rise = size[..., None], 0.5 * (right - left)
    added = long * (left + rise)
    carried = np.cumsum(added[:, ::-1], axis=1)[:, ::-1]
    beyond = carried - added
    squared = beyond * (beyond + long * (left + 4 / 3 * rise)) + long**2 * (left * (left / 3 + 5 / 6 * rise) + 8 / 15 * rise**2)
    stored = _over_rods((np.diff(at_cuts, axis=1) * squared).sum(axis=1) + at_cuts[:, 0] * carried[:, 0] ** 2)
    work = left * (2 * reach[:, :-1] + reach[:, 1:]) + right * (reach[:, :-1] + 2 * reach[:, 1:])
    work = np.maximum(_over_rods((long * work).sum(axis=1)) / 6, 1e-300)
    return np.stack([first + load, trace - stored / work + load], axis=1)


def _over_rods(values: FloatArray) -> FloatArray:
    """The sum along the last axis."""
    return np.asarray(sum(values[..., i] for i in range(values.shape[-1])))
