"""The operations of the language as C99, one row each, and the small C functions that they call.

`where` is C's conditional (ternary) operator, or an `if` where `branches` makes it one. Memory functions are for
targets without a C library.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.numbers import CONVERSIONS, FLOATS, INTEGERS, TAKES, WORDS

C_TYPES = {"real": "real", "float32": "float", "float64": "double", "bool": "bool"}
C_TYPES |= {kind: f"{kind}_t" for kind in INTEGERS}
# How tightly an expression's text binds.
ATOM, PRODUCT, SUM, SIGNED, COMPARISON, LOOSE = range(6)
COMPARISONS = {"lt": "<", "le": "<=", "eq": "==", "ne": "!="}
PLAIN = {op: f"plain_{op}" for op in ("add", "sub", "mul", "quot", "rem")}
"""Names of the rows for int32 arithmetic whose result cannot wrap around, by operation."""
BITWISE = {"and": "&", "or": "|", "xor": "^"}


@dataclass(frozen=True)
class Operator:
    """C of an operation: `text` with `{0}`, `{1}` for its operands, which may call the function `helper`.

    `operands` are the loosest bindings at which each operand needs no brackets, `binding` is that of the whole text.
    `{f}` is the suffix of C's functions for the build's precision: "f" for float32.
    """

    text: str
    operands: tuple[int, ...] = (LOOSE, LOOSE, LOOSE)
    binding: int = ATOM
    helper: str = ""


def called(name: str, operands: int, helper: str = "") -> Operator:
    """Return the operator that calls the C function `name` with `operands` arguments."""
    return Operator(f"{name}({', '.join(f'{{{i}}}' for i in range(operands))})", helper=helper)


def row(item: Expr, operand: str) -> str:
    """Return the name of the row in OPERATORS for an operation whose first operand is of the type `operand`."""
    if item.op == "where":
        return f"where_{item.kind}"
    if item.op in COMPARISONS:
        return f"{item.op}_{operand}"
    if item.op == "convert":
        return f"{operand}_to_{item.kind}"
    if item.op == "bits":
        return f"{operand}_word_{1 if item.data else 0}"
    if item.op == "from_bits":
        return f"{item.kind}_from_{'bits' if len(item.args) == 2 else 'word'}"
    return f"{item.op}_{item.kind}"


def _rows() -> Iterator[tuple[str, Operator]]:
    for kind in C_TYPES:
        yield f"where_{kind}", Operator("{0} ? {1} : {2}", (COMPARISON, SIGNED, SIGNED), LOOSE)
        for op, sign in COMPARISONS.items():
            if kind in TAKES[op]:
                yield f"{op}_{kind}", Operator(f"{{0}} {sign} {{1}}", (SUM, SUM), COMPARISON)
    for origin, target in CONVERSIONS:
        name = f"{origin}_to_{target}"
        cast = origin not in FLOATS or target in FLOATS
        yield name, Operator(f"({C_TYPES[target]}){{0}}", (ATOM,), SIGNED) if cast else called(name, 1, name)
    for kind in (*FLOATS, "uint32"):
        yield f"add_{kind}", Operator("{0} + {1}", (SUM, PRODUCT), SUM)
        yield f"sub_{kind}", Operator("{0} - {1}", (SUM, PRODUCT), SUM)
        yield f"mul_{kind}", Operator("{0} * {1}", (PRODUCT, ATOM), PRODUCT)
    for kind, f in zip(FLOATS, ("{f}", "f", ""), strict=True):
        yield f"div_{kind}", Operator("{0} / {1}", (PRODUCT, ATOM), PRODUCT)
        yield f"neg_{kind}", Operator("-{0}", (ATOM,), SIGNED)
        yield f"abs_{kind}", called(f"__builtin_fabs{f}", 1)
        yield f"sqrt_{kind}", called(f"__builtin_sqrt{f}", 1)
        for name, operands in (("word_0", 1), ("word_1", 1), ("from_bits", 2), ("from_word", 1)):
            yield f"{kind}_{name}", called(f"{kind}_{name}", operands, f"{kind}_{name}")
    yield "not_bool", Operator("!{0}", (ATOM,), SIGNED)
    for op, sign in (("and", "&&"), ("or", "||"), ("xor", "!=")):
        yield f"{op}_bool", Operator(f"{{0}} {sign} {{1}}", (ATOM, ATOM), LOOSE)
    for kind in WORDS:
        yield f"not_{kind}", Operator("~{0}", (ATOM,), SIGNED)
        for op, sign in BITWISE.items():
            yield f"{op}_{kind}", Operator(f"{{0}} {sign} {{1}}", (ATOM, ATOM), LOOSE)
        for op in ("quot", "rem"):
            yield f"{op}_{kind}", called(f"{kind}_{op}", 2, f"{kind}_{op}")
    for op in ("add", "sub", "mul", "shl", "shr"):
        yield f"{op}_int32", called(f"int32_{op}", 2, f"int32_{op}")
    for op in ("neg", "abs"):
        yield f"{op}_int32", called(f"int32_{op}", 1, f"int32_{op}")
    for op, sign in (("add", "+"), ("sub", "-")):
        yield PLAIN[op], Operator(f"{{0}} {sign} {{1}}", (SUM, PRODUCT), SUM)
    for op, sign in (("mul", "*"), ("quot", "/"), ("rem", "%")):
        yield PLAIN[op], Operator(f"{{0}} {sign} {{1}}", (PRODUCT, ATOM), PRODUCT)
    yield "shl_uint32", Operator("{0} << ({1} & 31u)", (ATOM, ATOM), LOOSE)
    yield "shr_uint32", Operator("{0} >> ({1} & 31u)", (ATOM, ATOM), LOOSE)
    yield "neg_uint32", Operator("0u - {0}", (PRODUCT,), SUM)
    yield "abs_uint32", Operator("{0}", (LOOSE,), LOOSE)
    yield "mulhi_uint32", Operator("(uint32_t)(((uint64_t){0} * {1}) >> 32)", (ATOM, ATOM), SIGNED)


OPERATORS = dict(_rows())
"""The operators, by the name that `row` returns."""


# What a function returns is one expression of its arguments.
_INTEGERS: tuple[tuple[str, str], ...] = (
    ("int32_t clamp_index(int32_t i, int32_t last)", "i < 0 ? 0 : i > last ? last : i"),
    ("int32_t int32_add(int32_t a, int32_t b)", "(int32_t)((uint32_t)a + (uint32_t)b)"),
    ("int32_t int32_sub(int32_t a, int32_t b)", "(int32_t)((uint32_t)a - (uint32_t)b)"),
    ("int32_t int32_mul(int32_t a, int32_t b)", "(int32_t)((uint32_t)a * (uint32_t)b)"),
    ("int32_t int32_neg(int32_t a)", "(int32_t)(0u - (uint32_t)a)"),
    ("int32_t int32_abs(int32_t a)", "a < 0 ? (int32_t)(0u - (uint32_t)a) : a"),
    ("int32_t int32_quot(int32_t a, int32_t b)", "b == 0 ? 0 : b == -1 ? (int32_t)(0u - (uint32_t)a) : a / b"),
    ("int32_t int32_rem(int32_t a, int32_t b)", "b == 0 || b == -1 ? 0 : a % b"),
    ("int32_t int32_shl(int32_t a, int32_t count)", "(int32_t)((uint32_t)a << ((uint32_t)count & 31u))"),
    ("int32_t int32_shr(int32_t a, int32_t count)", "a >> ((uint32_t)count & 31u)"),
    ("uint32_t uint32_quot(uint32_t a, uint32_t b)", "b == 0u ? 0u : a / b"),
    ("uint32_t uint32_rem(uint32_t a, uint32_t b)", "b == 0u ? 0u : a % b"),
)


def _returning(head: str, value: str, *before: str) -> str:
    lines = "".join(f"    {line}\n" for line in (*before, f"return {value};"))
    return f"static inline {head}\n{{\n{lines}}}\n"


def _copying(head: str, declared: str, origin: str, value: str, *before: str) -> str:
    """Return a function that copies the bits of `origin` into a variable of another type."""
    name = declared.split()[1]
    return _returning(head, value, *before, f"{declared};", f"(void)memcpy(&{name}, &{origin}, sizeof {name});")


_JOINED = "const uint64_t bits = (uint64_t)high << 32 | low;"


def _reals(kind: str, precision: str) -> Iterator[str]:
    """Yield the functions of a float kind that has a precision; a NaN is one pattern of bits."""
    real, single = C_TYPES[kind], precision == "float32"
    # The first real that is too large for an integer is a power of two, exact in both precisions.
    most, words = ("0x1p31f", "0x1p32f") if single else ("0x1p31", "0x1p32")
    whole = f"x >= {most} ? INT32_MAX : x > -{most} ? (int32_t)x : x <= -{most} ? INT32_MIN : 0"
    yield _returning(f"int32_t {kind}_to_int32({real} x)", whole)
    positive = f"x >= {words} ? UINT32_MAX : x > 0x0p0{'f' if single else ''} ? (uint32_t)x : 0u"
    yield _returning(f"uint32_t {kind}_to_uint32({real} x)", positive)
    first, second = (f"uint32_t {kind}_word_{k}({real} x)" for k in (0, 1))
    of_bits = f"{real} {kind}_from_bits(uint32_t low, uint32_t high)"
    of_word = f"{real} {kind}_from_word(uint32_t word)"
    if single:
        yield _copying(first, "uint32_t bits", "x", "__builtin_isnan(x) ? 0x7fc00000u : bits")
        yield _returning(second, "0u", "(void)x;")
        yield _copying(of_bits, "double x", "bits", f"({real})x", _JOINED)
        yield _copying(of_word, f"{real} x", "word", "x")
    else:
        yield _copying(first, "uint64_t bits", "x", "__builtin_isnan(x) ? 0u : (uint32_t)bits")
        yield _copying(second, "uint64_t bits", "x", "__builtin_isnan(x) ? 0x7ff80000u : (uint32_t)(bits >> 32)")
        yield _copying(of_bits, f"{real} x", "bits", "x", _JOINED)
        yield _copying(of_word, "float x", "word", f"({real})x")


def _named(precision: str) -> dict[str, str]:
    kinds = {"real": precision, "float64": "float64", "float32": "float32"}
    reals = (text for kind, own in kinds.items() for text in _reals(kind, own))
    texts = (*(_returning(*row) for row in _INTEGERS), *reals)
    return {text.partition("(")[0].split()[-1]: text for text in texts}


HELPERS = {precision: _named(precision) for precision in ("float64", "float32")}
"""The definition of each function, by precision and name."""
HELPER_NAMES = frozenset(HELPERS["float64"])
_TEMPLATES = resources.files(__package__).joinpath("templates")
FREESTANDING_FILES = {"string.h": _TEMPLATES.joinpath("string.h").read_text(encoding="utf-8")}
"""Headers to compile without a C library: `toolchain.compiled(..., files=FREESTANDING_FILES)` with the option `-I.`."""
FREESTANDING_MEMORY = "\n" + _TEMPLATES.joinpath("memory.c").read_text(encoding="utf-8")
"""C to append to a source that is linked without a C library."""
