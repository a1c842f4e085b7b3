"""Small C functions included in emitted C: operations of the language, and memory functions without a C library."""

import re
from importlib import resources

from twodof.compile.c.operators import C_TYPES

# What a function returns is one expression of its arguments. `{f}` is the suffix of float32's constants. The first real
# that is too large for an integer is a power of two, exact in both precisions.
_EXPRESSIONS: tuple[tuple[str, str], ...] = (
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
    (
        "int32_t real_to_int32(real x)",
        "x >= 0x1p31{f} ? INT32_MAX : x > -0x1p31{f} ? (int32_t)x : x <= -0x1p31{f} ? INT32_MIN : 0",
    ),
    ("uint32_t real_to_uint32(real x)", "x >= 0x1p32{f} ? UINT32_MAX : x > 0x0p0{f} ? (uint32_t)x : 0u"),
)


def _returning(head: str, value: str, *before: str) -> str:
    lines = "".join(f"    {line}\n" for line in (*before, f"return {value};"))
    return f"static inline {head}\n{{\n{lines}}}\n"


def _copying(head: str, declared: str, origin: str, value: str, *before: str) -> str:
    """Return a function that copies the bits of `origin` into a variable of another type."""
    name = declared.split()[1]
    return _returning(head, value, *before, f"{declared};", f"(void)memcpy(&{name}, &{origin}, sizeof {name});")


_FIRST, _SECOND = "uint32_t real_word_0(real x)", "uint32_t real_word_1(real x)"
_OF_BITS, _OF_WORD = "real real_from_bits(uint32_t low, uint32_t high)", "real real_from_word(uint32_t word)"
_JOINED = "const uint64_t bits = (uint64_t)high << 32 | low;"
# A NaN is one pattern of bits.
_BITS = {
    "float64": (
        _copying(_FIRST, "uint64_t bits", "x", "__builtin_isnan(x) ? 0u : (uint32_t)bits"),
        _copying(_SECOND, "uint64_t bits", "x", "__builtin_isnan(x) ? 0x7ff80000u : (uint32_t)(bits >> 32)"),
        _copying(_OF_BITS, "real x", "bits", "x", _JOINED),
        _copying(_OF_WORD, "float x", "word", "(real)x"),
    ),
    "float32": (
        _copying(_FIRST, "uint32_t bits", "x", "__builtin_isnan(x) ? 0x7fc00000u : bits"),
        _returning(_SECOND, "0u", "(void)x;"),
        _copying(_OF_BITS, "double x", "bits", "(real)x", _JOINED),
        _copying(_OF_WORD, "real x", "word", "x"),
    ),
}


def _named(precision: str, suffix: str) -> dict[str, str]:
    texts = [_returning(head, value.replace("{f}", suffix)) for head, value in _EXPRESSIONS]
    return {text.partition("(")[0].split()[-1]: text for text in (*texts, *_BITS[precision])}


_REAL = re.compile(r"\breal(?=_|\b)|(?<=_to_)real\b")


def _of(kind: str, texts: dict[str, str]) -> dict[str, str]:
    """Return functions of reals as functions of the float kind that has their precision."""
    made = {}
    for name, text in texts.items():
        own = _REAL.sub(kind, name)
        if own != name and own not in texts:
            made[own] = re.sub(rf"\b{kind}\b", C_TYPES[kind], _REAL.sub(kind, text))
    return made


_PRECISE = {"float64": _named("float64", ""), "float32": _named("float32", "f")}
HELPERS = {
    precision: texts | {name: text for kind in _PRECISE for name, text in _of(kind, _PRECISE[kind]).items()}
    for precision, texts in _PRECISE.items()
}
"""The definition of each function, by precision and name."""
NAMES = frozenset(HELPERS["float64"])
_TEMPLATES = resources.files(__package__).joinpath("templates")
FILES = {"string.h": _TEMPLATES.joinpath("string.h").read_text(encoding="utf-8")}
"""Headers for `toolchain.compiled(..., files=FILES)` with the option `-I.` where there is no C library."""
MEMORY = "\n" + _TEMPLATES.joinpath("memory.c").read_text(encoding="utf-8")
"""C to append to a source that is linked without a C library."""
