"""Small C functions included in emitted C: operations of the language, and memory functions without a C library."""

from collections.abc import Iterator
from importlib import resources

from twodof.compile.c.operators import C_TYPES

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
NAMES = frozenset(HELPERS["float64"])
_TEMPLATES = resources.files(__package__).joinpath("templates")
FILES = {"string.h": _TEMPLATES.joinpath("string.h").read_text(encoding="utf-8")}
"""Headers for `toolchain.compiled(..., files=FILES)`, given the option `-I.`, to compile without a C library."""
MEMORY = "\n" + _TEMPLATES.joinpath("memory.c").read_text(encoding="utf-8")
"""C to append to a source that is linked without a C library."""
