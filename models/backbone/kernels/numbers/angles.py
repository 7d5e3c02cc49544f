# mypy: ignore-errors
"""Cosine and sine of numbers in lanes, together and without a branch.

The angle is less k pi/2 by a number that has parts, of which k times all but the last is exact. Adding 1.5 times the power of two
above which a floating-point number has no fraction rounds to the nearest k, and leaves the last bits of k as those of the sum:
they say which polynomial is the sine, and the signs.
"""

from functools import cache

import warp as wp

from multirod.models.backbone.kernels.numbers.lanes import NAMES, fused, lanes, vector

WHOLE = {wp.float64: ("unsigned long long", 64, 1.5 * 2.0**52), wp.float32: ("unsigned int", 32, 1.5 * 2.0**23)}
# of pi/2
PARTS = {
    wp.float64: (1.5707963267341256, 6.077100506506192e-11),
    wp.float32: (1.5703125, 4.837512969970703125e-4, 7.54978995489188216e-8),
}
# (sin(r) - r) / r^3 and (cos(r) - 1 + r^2/2) / r^4 by powers of r^2, for |r| <= pi/4: Sun's fdlibm; for 24 bits Moshier's Cephes
SINE = {
    wp.float64: (
        -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
        2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
    ),
    wp.float32: (-1.6666654611e-1, 8.3321608736e-3, -1.9515295891e-4),
}  # fmt: skip
COSINE = {
    wp.float64: (
        4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
        -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
    ),
    wp.float32: (4.166664568298827e-2, -1.388731625493765e-3, 2.443315711809948e-5),
}  # fmt: skip


def _in_pairs(t: str, coefficients: tuple[float, ...]) -> str:
    """A polynomial in z, whose square is zz: by pairs, as what waits for one another is then half as long as by Horner's rule."""
    pairs = [f"(({t}){a!r} + z * ({t}){b!r})" for a, b in zip(coefficients[::2], coefficients[1::2], strict=False)]
    if len(coefficients) % 2:
        pairs.append(f"({t}){coefficients[-1]!r}")
    result = pairs.pop()
    for pair in reversed(pairs):
        result = f"({pair} + zz * {result})"
    return result


@cache
def make_cosine_and_sine(W: int, d):
    """``cosine_and_sine(angle)`` of W lanes."""
    L, t = lanes(W, d), NAMES[d]
    Real, fill = L.Real, L.fill
    integer, bits, rounding = WHOLE[d]
    of = (lambda name: name) if W == 1 else (lambda name: f"(*({'const ' * (name == 'angle')}V*){name}.c)")
    if W == 1:
        types = f"typedef {t} U; typedef {integer} N;"
    else:
        lane = f"__attribute__((ext_vector_type({W})))"
        types = f"{vector(W, d)} typedef {t} U {lane}; typedef {integer} N {lane};"
    rest = f"x - k * ({t}){PARTS[d][0]!r}"
    for part in PARTS[d][1:]:
        rest = f"({rest}) - k * ({t}){part!r}"
    snippet = (
        f"{types} union Bits {{ U v; N n; }}; U x = {of('angle')}; Bits turns, c, s;"
        f" turns.v = x * ({t})0.6366197723675814 + ({t}){rounding!r}; U k = turns.v - ({t}){rounding!r};"
        f" U r = {rest}; U z = r * r; U zz = z * z;"
        f" U sine = r + r * z * {_in_pairs(t, SINE[d])};"
        f" U cosine = ({t})1 - ({t})0.5 * z + zz * {_in_pairs(t, COSINE[d])};"
        f" const N one = (N)1, sign = (N)1 << {bits - 1};"
        " c.v = (turns.n & one) == (N)0 ? cosine : sine; s.v = (turns.n & one) == (N)0 ? sine : cosine;"
        f" c.n ^= ((turns.n + one) << {bits - 2}) & sign; s.n ^= (turns.n << {bits - 2}) & sign;"
        f" {of('of_cosine')} = c.v; {of('of_sine')} = s.v;"
    )

    @wp.func_native(fused(snippet))
    def turn(angle: Real, of_cosine: wp.ref[Real], of_sine: wp.ref[Real]): ...

    @wp.func
    def cosine_and_sine(angle: Real):
        c = fill(d(0.0))
        s = fill(d(0.0))
        turn(angle, c, s)
        return c, s

    return cosine_and_sine
