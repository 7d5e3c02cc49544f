# mypy: ignore-errors
"""How far ``Gamma`` is from where the equilibrium was last known to be stable. Numbers in parentheses: ``docs/tasks.md``."""

import warp as wp

from multirod.tasks.condensed_kernels import Condensed

f64 = wp.float64
REFERENCE_KEPT = 0.4  # left side of (17), up to which the matrix that samples are compared with stays
SURE = 0.8  # up to which no mode was lost; at 1 one may be: the rest is for what a sample's correction adds
FAR = 0.1  # correction, of unknowns in scales of curvature, of values in units (9), that takes a sample where Gamma is not known;
# and the way of samples in a row that need not be compared, where (17) grows as it did
FASTER = 3.0  # (17b) than (17c) has it
UNTOLD = 25.0  # (17b) how fast it grows, at least, where unknowns move by themselves: by 0.01 in scales of curvature is looked at
# the next sample is compared, as something else has changed; is looked at, as the last one was and is lost
ELSE_COMPARE, LOOK_AGAIN = 1.0, 2.0

# what has to be done about a sample: nothing; compare the next ones with it; look whether it is stable
NOTHING, NEXT, LOOK = 0, 1, 2


@wp.struct
class Watched:
    """What samples are compared with; the first axis is the instance."""

    on: int  # whether there is anything to be watched
    anchor: wp.array3d[wp.float64]  # Gamma where it was last known to be stable, (instance, n, n)
    inverse: wp.array3d[wp.float64]  # S^-1 of its inverse, transposed; NaN where none is known
    scale: wp.array2d[wp.float64]  # S, (instance, n)
    room: wp.array3d[wp.float64]  # (instance, 1, n)
    compared: wp.array2d[wp.float64]  # (instance, 2): the left side of (17) at ``place``; what is done with the next sample
    growth: wp.array3d[wp.float64]  # (17c) Q, (instance, k, k)
    least: wp.array2d[wp.float64]  # (17b) q and q_x, (instance, 2)
    # what is free in units (9), (instance, k): where it was compared, of this sample's integration, of its command
    place: wp.array2d[wp.float64]
    here: wp.array2d[wp.float64]
    command: wp.array2d[wp.float64]


OFF = """
const int n = inverse.shape[1];
double* r = &wp::index(room, t, 0, 0);
double total = 0.0;
for (int j = 0; j < n && !(total > most); j++) {
    for (int i = 0; i < n; i++) r[i] = 0.0;
    for (int k = 0; k < n; k++) {
        const double off = wp::index(gamma, t, k, j) - wp::index(anchor, t, k, j);
        if (off == 0.0) continue;
        const double m = wp::index(scale, t, j) * off;
        const double* b = &wp::index(inverse, t, k, 0);
        _Pragma("clang loop interleave_count(1)") for (int i = 0; i < n; i++) r[i] += m * b[i];
    }
    double p = 0.0, q = 0.0;
    for (int i = 0; i + 1 < n; i += 2) { p += r[i] * r[i]; q += r[i + 1] * r[i + 1]; }
    total += p + q + (n % 2 ? r[n - 1] * r[n - 1] : 0.0);
}
r[0] = total;
"""


# of legs most numbers do not change
@wp.func_native(OFF)
def far_off(
    gamma: wp.array3d[wp.float64],
    anchor: wp.array3d[wp.float64],
    inverse: wp.array3d[wp.float64],
    scale: wp.array2d[wp.float64],
    room: wp.array3d[wp.float64],
    t: int,
    most: wp.float64,
):
    """(17) The square of its left side into the first number of ``room``, or more than ``most``."""


@wp.func(inline=False)
def stand(w: Watched, task: Condensed, t: int, unit: wp.array[wp.float64]):
    """Where the integration of a sample was."""
    for j in range(unit.shape[0]):
        w.here[t, j] = task.inputs[t, task.places[j]] / unit[j]


@wp.func
def grows(w: Watched, t: int, place: wp.array2d[wp.float64], aside: f64) -> f64:
    """(17b) By how much the left side of (17) may grow from a place to the command, the unknowns ``aside`` by themselves."""
    total = f64(0.0)
    far = f64(0.0)
    for i in range(place.shape[1]):
        step = w.command[t, i] - place[t, i]
        far = wp.max(far, wp.abs(step))
        for j in range(place.shape[1]):
            total += step * w.growth[t, i, j] * (w.command[t, j] - place[t, j])
    grown = wp.sqrt(wp.max(total, f64(0.0))) + w.least[t, 0] * far + w.least[t, 1] * aside
    return f64(wp.static(FASTER)) * grown


@wp.func(inline=False)
def strayed(w: Watched, task: Condensed, t: int, curvature: f64, always: bool) -> int:
    """(17), (17b) Whether a mode may be lost on the way to a sample's ``command``. ``Gamma`` is that of the place where ``stand``
    says. ``always``: compare, however short the way."""
    if w.on == 0:
        return wp.static(NOTHING)
    if w.compared[t, 1] == f64(wp.static(LOOK_AGAIN)) or not wp.isfinite(w.inverse[t, 0, 0]):
        return wp.static(LOOK)
    aside = f64(0.0)
    for i in range(task.gamma.shape[1]):
        aside = wp.max(aside, wp.abs(task.shift[t, i, 0]) / curvature)
    ahead = f64(0.0)
    for j in range(w.place.shape[1]):
        ahead = wp.max(ahead, wp.abs(w.command[t, j] - w.place[t, j]))
    if not always and w.compared[t, 1] == f64(0.0) and ahead < f64(wp.static(FAR)):
        if w.compared[t, 0] + grows(w, t, w.place, aside) < f64(wp.static(REFERENCE_KEPT)):
            return wp.static(NOTHING)
    far_off(task.gamma, w.anchor, w.inverse, w.scale, w.room, t, f64(wp.static(SURE * SURE)))
    found = wp.sqrt(w.room[t, 0, 0])
    w.compared[t, 0] = found
    w.compared[t, 1] = f64(0.0)
    for j in range(w.place.shape[1]):
        w.place[t, j] = w.here[t, j]
    if not found + grows(w, t, w.here, aside) < f64(wp.static(SURE)):
        return wp.static(LOOK)
    return wp.where(found < f64(wp.static(REFERENCE_KEPT)), wp.static(NOTHING), wp.static(NEXT))
