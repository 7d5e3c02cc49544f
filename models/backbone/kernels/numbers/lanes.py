# mypy: ignore-errors
"""Numbers that stand side by side: ``W`` of them in one ``Real``, which is a vector of the processor (``docs/kernels.md``).

What is computed in one lane does not depend on the others. At W = 1 a ``Real`` is a plain number, and the same source is what a
GPU's thread runs, or a debugger steps through.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

NAMES = {wp.float64: "double", wp.float32: "float"}
INTEGERS = {wp.float64: "long long", wp.float32: "int"}
# of a floating-point number: fraction's scale and exponent's bias
SCALE_AND_BIAS = {wp.float64: (2.0**52, 1023), wp.float32: (2.0**23, 127)}
ROOT_STEPS = 2  # of Newton's method: 1e-4 from a start that is 12 % off


def fused(body: str) -> str:
    """C++ in which a product and the sum it goes into, here or in what is inlined around it, may become one instruction."""
    return f'{{ _Pragma("clang fp contract(fast)") {body} }}'


def vector(W: int, d, name: str = "V") -> str:
    """C++ of the vector type; memory that Warp gives is aligned to its numbers only."""
    aligned = 8 if d is wp.float64 else 4
    return f"typedef {NAMES[d]} {name} __attribute__((ext_vector_type({W}), aligned({aligned}), may_alias)); "


def _returned(W: int, d) -> str:
    return vector(W, d) + f"wp::vec_t<{W},{NAMES[d]}> r; V& o = *(V*)r.c; "


A, B = "(*(const V*)a.c)", "(*(const V*)b.c)"


@cache
def _operators(W: int, d) -> type:
    """A type of lanes, and its overloads of the operators.

    Warp looks operators up by the names ``add``, ``sub``, ``mul``, ``div`` and ``neg`` in the globals of a kernel's
    module: import them there.
    """
    Real = wp.types.vector(length=W, dtype=d)
    H = _returned(W, d)

    @wp.func_native(fused(f"{H} o = {A} + {B}; return r;"))
    def add(a: Real, b: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = {A} + (V)b; return r;"))
    def add(a: Real, b: d) -> Real: ...

    @wp.func_native(fused(f"{H} o = (V)a + {B}; return r;"))
    def add(a: d, b: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = {A} - {B}; return r;"))
    def sub(a: Real, b: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = {A} - (V)b; return r;"))
    def sub(a: Real, b: d) -> Real: ...

    @wp.func_native(fused(f"{H} o = (V)a - {B}; return r;"))
    def sub(a: d, b: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = {A} * {B}; return r;"))
    def mul(a: Real, b: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = {A} * (V)b; return r;"))
    def mul(a: Real, b: d) -> Real: ...

    @wp.func_native(fused(f"{H} o = (V)a * {B}; return r;"))
    def mul(a: d, b: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = {A} / {B}; return r;"))
    def div(a: Real, b: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = {A} / (V)b; return r;"))
    def div(a: Real, b: d) -> Real: ...

    @wp.func_native(fused(f"{H} o = (V)a / {B}; return r;"))
    def div(a: d, b: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = -{A}; return r;"))
    def neg(a: Real) -> Real: ...

    for name, function in {"add": add, "sub": sub, "mul": mul, "div": div, "neg": neg}.items():
        if name not in globals():
            globals()[name] = function
        else:
            for overload in function.user_overloads.values():
                globals()[name].add_overload(overload)
    return Real


_operators(8, wp.float64)  # the names are there when kernels' modules import them


@cache
def lanes(W: int, d=wp.float64) -> SimpleNamespace:
    """Types and functions of numbers in ``W`` lanes of the scalar type ``d``.

    ``Real``, one number a lane; ``few(n)``, n of them that stand together in registers, indexed by constants only; ``row`` and
    ``put``, a Real from and to memory, ``get`` and ``set``, one lane of it, and ``copy``, rows of a lane from those of
    another. Memory is counted in rows of W numbers; at W = 1 its rows may be apart.
    """
    Real = d if W == 1 else _operators(W, d)
    t, integer = NAMES[d], INTEGERS[d]
    memory_type = wp.array(dtype=d)
    if W == 1:
        V, to_row = f"typedef {t} V; ", "(char*)memory.data + (long long)({}) * memory.strides[0]"
        H, a_, b_, x_, y_, v_, h_ = f"{V} V r; V& o = r; ", "a", "b", "x", "y", "v", "h"
        least_, abs_, sqrt_, any_ = "a < b", "fabs(a)", "sqrt(a)", "return a < b;"
        whole, to_whole = f"typedef {integer} I; typedef {t} U; ", "(I)({})"
        of_whole = "(U)({})"
    else:
        V, to_row = vector(W, d), f"memory.data + (long long)({{}}) * {W}"
        H, (a_, b_, x_, y_, v_, h_) = _returned(W, d), (f"(*(const V*){name}.c)" for name in "abxyvh")
        least_, abs_, sqrt_ = f"{a_} < {b_}", *(f"__builtin_elementwise_{name}({a_})" for name in ("abs", "sqrt"))
        any_ = f"auto m = {a_} < {b_}; return __builtin_reduce_or(m) != 0;"
        whole = (
            f"typedef {integer} I __attribute__((ext_vector_type({W}))); typedef {t} U __attribute__((ext_vector_type({W}))); "
        )
        to_whole, of_whole = "__builtin_convertvector({}, I)", "__builtin_convertvector({}, U)"
    number = f"(({t}*)({to_row}))[l]"
    loaded = f"*(const V*)({to_row.format('i')})"
    if W > 1:
        # Clang uses the widest vectors of a processor only in functions that take them by value, and in what
        # such are inlined into
        loaded = f"[](V a) __attribute__((always_inline)) {{ return a; }}({loaded})"

    @wp.func_native(fused(f"{H} o = {abs_}; return r;"))
    def absolute(a: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = {sqrt_}; return r;"))
    def root(a: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = {b_} < {a_} ? {a_} : {b_}; return r;"))
    def largest(a: Real, b: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = {least_} ? {a_} : {b_}; return r;"))
    def least(a: Real, b: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = {least_} ? {x_} : {y_}; return r;"))
    def where_less(a: Real, b: Real, x: Real, y: Real) -> Real: ...

    @wp.func_native(fused(f"{H} o = (V)a; return r;"))
    def fill(a: d) -> Real: ...

    @wp.func_native(fused(f"{V} {any_}"))
    def any_less(a: Real, b: Real) -> bool: ...

    @wp.func_native(fused(f"{H} o = {loaded}; return r;"))
    def row(memory: memory_type, i: int) -> Real: ...

    @wp.func_native(fused(f"{V} *(V*)({to_row.format('i')}) = {v_};"))
    def put(memory: memory_type, i: int, v: Real): ...

    @wp.func_native(fused(f"return {number.format('i')};"))
    def get(memory: memory_type, i: int, l: int) -> d: ...

    @wp.func_native(fused(f"{number.format('i')} = v;"))
    def set(memory: memory_type, i: int, l: int, v: d): ...

    @wp.func_native(f"for (int i = at; i < at + count; i++) {number.format('i')} = (({t}*)({to_row.format('i')}))[of];")
    def copy(memory: memory_type, at: int, count: int, l: int, of: int): ...

    @wp.func_native(fused(f"return ((const {t}*)&a)[l];"))
    def one(a: Real, l: int) -> d: ...

    @cache
    def power_root(order: int):
        """``a^(-1/order)`` to 1e-4, as the length of a step needs it: from the exponent's bits, by Newton's method."""
        scale, bias = SCALE_AND_BIAS[d]
        part = 1 / order
        start = f"({t}){(1 + part) * (bias - 0.045) * scale!r}"
        snippet = (
            f"{H} {whole} U x = {a_}; union {{ U v; I i; }} p; p.v = x;"
            f" p.i = {to_whole.format(f'{start} - ({t}){part!r} * ' + of_whole.format('p.i'))};"
            f" U y = p.v; for (int n = 0; n < {ROOT_STEPS}; n++) {{ U z = x; for (int k = 0; k < {order}; k++) z *= y;"
            f" y *= ({t}){1 + part!r} - ({t}){part!r} * z; }} o = y; return r;"
        )

        @wp.func_native(fused(snippet))
        def inverse_root(a: Real) -> Real: ...

        return inverse_root

    @cache
    def few(n: int) -> SimpleNamespace:
        """Type of n Reals, and what is done with it."""
        Few = wp.types.vector(length=n, dtype=d) if W == 1 else wp.types.matrix(shape=(n, W), dtype=d)
        held = f"wp::vec_t<{n},{t}>" if W == 1 else f"wp::mat_t<{n},{W},{t}>"
        inside = "c" if W == 1 else "data"
        F, each = f"{V} {held} r; V* o = (V*)r.{inside}; ", f'_Pragma("unroll") for (int i = 0; i < {n}; i++)'

        def of(name: str) -> str:
            return f"((const V*){name}.{inside})"

        @wp.func_native(fused(f"{H} o = {of('a')}[i]; return r;"))
        def part(a: Few, i: int) -> Real: ...

        @wp.func_native(fused(f"{V} ((V*)a.{inside})[i] = {v_};"))
        def keep(a: wp.ref[Few], i: int, v: Real): ...

        @wp.func_native(fused(f"{F} {each} o[i] = {x_} < {y_} ? {of('a')}[i] : {of('b')}[i]; return r;"))
        def where_less(x: Real, y: Real, a: Few, b: Few) -> Few: ...

        @wp.func_native(fused(f"{F} {each} o[i] = *(const V*)({to_row.format('at + i')}); return r;"))
        def read(memory: memory_type, at: int) -> Few: ...

        @wp.func_native(fused(f"{V} {each} *(V*)({to_row.format('at + i')}) = {of('a')}[i];"))
        def write(memory: memory_type, at: int, a: Few): ...

        return SimpleNamespace(type=Few, part=part, keep=keep, where_less=where_less, read=read, write=write)

    @cache
    def slopes(n: int, tableau) -> SimpleNamespace:
        """Type of the slopes of a Runge-Kutta step of n Reals, and what is made of them."""
        Few, stages = few(n).type, len(tableau.b)
        Slopes = wp.types.vector(length=n * stages, dtype=d) if W == 1 else wp.types.matrix(shape=(n * stages, W), dtype=d)
        held = f"wp::vec_t<{n},{t}>" if W == 1 else f"wp::mat_t<{n},{W},{t}>"
        inside = "c" if W == 1 else "data"
        F, each = f"{V} {held} r; V* o = (V*)r.{inside}; ", f'_Pragma("unroll") for (int j = 0; j < {n}; j++)'
        K = f"((const V*)k.{inside})"

        def weighted(weights) -> str:
            terms = [f"({t}){w!r} * {K}[{n * m} + j]" for m, w in enumerate(weights) if w != 0.0]
            return " + ".join(terms) or "(V)0"

        def ahead(weights, last: bool) -> str:
            """y and the weighted slopes, of which the latest comes in last: what waits for it is one product and sum."""
            used = [m for m, w in enumerate(weights) if w != 0.0]
            sizes = " ".join(f"const V h{m} = {h_} * ({t}){weights[m]!r};" for m in used)
            y = f"((const V*)y.{inside})[j]"
            *early, late = [f"h{m} * {K}[{n * m} + j]" for m in used]
            total = f"({y} + ({' + '.join(early)})) + {late}" if early else f"{y} + {late}"
            if last:  # rounded once: this is what steps add up
                total = f"{y} + ({' + '.join([*early, late])})"
            return f"{sizes} {each} o[j] = {total};"

        cases = " ".join(f"case {m}: {{ {ahead(weights, False)} break; }}" for m, weights in enumerate(tableau.a) if m > 0)

        @wp.func_native(fused(f"{F} switch (i) {{ {cases} default: return y; }} return r;"))
        def stage(y: Few, h: Real, k: wp.ref[Slopes], i: int) -> Few: ...

        @wp.func_native(fused(f"{F} {ahead(tableau.b, True)} return r;"))
        def advance(y: Few, h: Real, k: wp.ref[Slopes]) -> Few: ...

        @wp.func_native(fused(f"{F} {each} o[j] = {h_} * ({weighted(tableau.error)}); return r;"))
        def error(h: Real, k: wp.ref[Slopes]) -> Few: ...

        @wp.func_native(fused(f"{V} {each} ((V*)k.{inside})[i * {n} + j] = ((const V*)f.{inside})[j];"))
        def keep(k: wp.ref[Slopes], i: int, f: Few): ...

        places = ", ".join(repr(float(c)) for c in tableau.c)

        @wp.func_native(fused(f"static const {t} places[] = {{{places}}}; return places[i];"))
        def place(i: int) -> d: ...

        return SimpleNamespace(type=Slopes, stage=stage, advance=advance, error=error, keep=keep, place=place)

    @cache
    def system(m: int) -> SimpleNamespace:
        """Type of m x m Reals, m = 3 or 6, and how linear equations are solved that need no pivots, such as ``I + C D`` of
        semi-definite C, D."""
        Matrix, Few = few(m * m).type, few(m).type
        held = f"wp::vec_t<{m},{t}>" if W == 1 else f"wp::mat_t<{m},{W},{t}>"
        inside = "c" if W == 1 else "data"

        # by blocks of three, each with one division: A = [P Q; R S], whose P^-1, R P^-1 and (S - R P^-1 Q)^-1 take the places
        def inverted(at: int) -> str:
            """The block that begins there, by its cofactors."""
            e = [[f"A[{at + m * i + j}]" for j in range(3)] for i in range(3)]
            minors = {
                (i, j): f"({e[(j + 1) % 3][(i + 1) % 3]} * {e[(j + 2) % 3][(i + 2) % 3]}"
                f" - {e[(j + 1) % 3][(i + 2) % 3]} * {e[(j + 2) % 3][(i + 1) % 3]})"
                for i in range(3)
                for j in range(3)
            }
            found = " ".join(f"V c{i}{j} = {minor};" for (i, j), minor in minors.items())
            placed = " ".join(f"{e[i][j]} = p * c{i}{j};" for i, j in minors)
            return f"{{ {found} V p = ({t})1 / ({e[0][0]} * c00 + {e[0][1]} * c10 + {e[0][2]} * c20); {placed} }}"

        def product(i: int, j: int, left: int, right: int) -> str:
            """Entry of the product of two blocks."""
            return " + ".join(f"A[{left + m * i + k}] * A[{right + m * k + j}]" for k in range(3))

        def row_by(at: int, i: int, values: str) -> str:
            return " + ".join(f"A[{at + m * i + k}] * {values}{k}" for k in range(3))

        nine = [(i, j) for i in range(3) for j in range(3)]
        eliminate, back = inverted(0), " ".join(f"o[{i}] = {row_by(0, i, 'c')};" for i in range(3))
        load = " ".join(f"V c{i} = c[{i}];" for i in range(3))
        if m == 6:
            R, Q, S = 18, 3, 21
            eliminate += " { " + " ".join(f"V b{i}{j} = {product(i, j, R, 0)};" for i, j in nine)
            eliminate += " ".join(f" A[{R + m * i + j}] = b{i}{j};" for i, j in nine) + " }"
            eliminate += " ".join(f" A[{S + m * i + j}] -= {product(i, j, R, Q)};" for i, j in nine) + inverted(S)
            load += " ".join(f" V d{i} = c[{3 + i}] - ({row_by(R, i, 'c')});" for i in range(3))
            load += " ".join(f" V y{i} = {row_by(S, i, 'd')};" for i in range(3))
            load += " ".join(f" c{i} -= {row_by(Q, i, 'y')}; o[{3 + i}] = y{i};" for i in range(3))

        @wp.func_native(fused(f"{V} V* A = (V*)A_.{inside}; {eliminate}"))
        def factor(A_: wp.ref[Matrix]):
            """In place."""

        @wp.func_native(
            fused(
                f"{V} {held} r; V* o = (V*)r.{inside}; const V* A = (const V*)A_.{inside}; const V* c = (const V*)c_.{inside};"
                f" {load} {back} return r;"
            )
        )
        def solve(A_: Matrix, c_: Few) -> Few: ...

        return SimpleNamespace(type=Matrix, factor=factor, solve=solve)

    return SimpleNamespace(
        W=W,
        d=d,
        Real=Real,
        absolute=absolute,
        root=root,
        largest=largest,
        least=least,
        where_less=where_less,
        fill=fill,
        any_less=any_less,
        row=row,
        put=put,
        get=get,
        set=set,
        copy=copy,
        one=one,
        power_root=power_root,
        few=few,
        slopes=slopes,
        system=system,
    )
