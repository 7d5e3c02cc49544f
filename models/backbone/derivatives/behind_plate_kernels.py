# mypy: ignore-errors
"""What turns rods behind the plate as their numbers change, compiled. Numbers in parentheses: ``docs/derivatives.md``."""

import warp as wp

from multirod.kernels.own_module import own_module

f64 = wp.float64
NOTHING, OWN, SUM, ALONE = range(4)  # what is known of the first rod's torque that is not among ``torques``


@wp.struct
class BehindPlateArrays:
    """Rods, one row of them or one an instance, and where their numbers stand."""

    end: wp.array3d[wp.float64]  # (b, rod, piece)
    material: wp.array4d[wp.float64]  # (b, rod, piece, number)
    precurvature: wp.array4d[wp.float64]  # (b, rod, piece, number)
    rest: wp.array[wp.float64]  # of one rod: torsion at rest at its base, (b,)
    unit: wp.array2d[wp.float64]  # of torques, (b, rod)
    weights: wp.array4d[wp.float64]  # by each number, of what is found here, (b, rod, direction, piece and quantity)
    places: wp.array[int]  # of the directions, (direction,)
    rotation: int  # in a row of inputs
    translation: int
    torques: int  # in a row of unknowns
    first: int  # rod whose torque is the first of these
    torsion: int  # what else is known of the first rod's: nothing, its own unknown, that the torques add to zero, or it is alone


@wp.func
def base_torque(s: BehindPlateArrays, unknowns: wp.array2d[wp.float64], t: int, b: int, i: int) -> f64:
    """What twists a rod behind the plate, (10) of ``docs/model.md``."""
    if s.torsion == wp.static(ALONE):
        return (unknowns[t, 2] - s.rest[b]) * s.unit[b, 0]
    if i >= s.first:
        return unknowns[t, s.torques + i - s.first] * s.unit[b, i]
    if s.torsion == wp.static(OWN):
        return unknowns[t, 2] * s.unit[b, 0]
    total = f64(0.0)
    if s.torsion == wp.static(SUM):
        for j in range(s.first, s.end.shape[1]):
            total -= unknowns[t, s.torques + j - s.first] * s.unit[b, j]
    return total


@wp.func
def add(s: BehindPlateArrays, directions: wp.array3d[wp.float64], t: int, b: int, i: int, quantity: int, value: f64):
    """To the angle of a rod by each number, what one quantity makes of it."""
    if value != f64(0.0):
        for k in range(s.places.shape[0]):
            directions[t, s.places[k], s.rotation + i] += s.weights[b, i, k, quantity] * value


@own_module()
def turn_behind_plate(
    s: BehindPlateArrays,
    unknowns: wp.array2d[wp.float64],
    inputs: wp.array2d[wp.float64],
    directions: wp.array3d[wp.float64],
):
    """(D8) In the directions by numbers of rods, how each rod turns more behind the plate."""
    t = wp.tid()
    b = t % s.end.shape[0]
    terms = s.precurvature.shape[3] // 3
    for i in range(s.end.shape[1]):
        for k in range(s.places.shape[0]):
            directions[t, s.places[k], s.rotation + i] = f64(0.0)
        depth = -inputs[t, s.translation + i]
        torque = base_torque(s, unknowns, t, b, i)
        begin = f64(0.0)
        for m in range(s.end.shape[2]):
            end = s.end[b, i, m]
            half = f64(0.5) * (end - begin)
            size = wp.max(wp.min(end, depth) - begin, f64(0.0))
            part = f64(-1.0)
            if half > f64(0.0):
                part = size / half - f64(1.0)
            twisted = s.material[b, i, m, 5] * torque
            at_end = twisted
            at_begin = twisted
            slid = f64(0.0)
            power = f64(1.0)
            sign = f64(1.0)
            first = m * (terms + 4)
            for q in range(terms):
                bent = s.precurvature[b, i, m, 3 * q + 2]
                at_end += bent
                at_begin += sign * bent
                slid += bent * (power - sign)
                power = power * part
                add(s, directions, t, b, i, first + q, half / f64(q + 1) * (power + sign))
                sign = -sign
            add(s, directions, t, b, i, first + terms, size * twisted)
            # an end that moves behind the plate leaves more to the piece before it, and less to the one after
            if end <= depth:
                add(s, directions, t, b, i, first + terms + 1, at_end)
            if begin <= depth:
                add(s, directions, t, b, i, first + terms + 2, at_begin)
            add(s, directions, t, b, i, first + terms + 3, slid)
            begin = end
