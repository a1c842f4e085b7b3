"""The small C functions that give integers and conversions the language's meaning everywhere."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Helper:
    """A C function, by precision where its text depends on that."""

    name: str
    float64: str
    float32: str

    def text(self, precision: str) -> str:
        """The definition for a precision."""
        return self.float32 if precision == "float32" else self.float64


def _same(name: str, text: str) -> Helper:
    return Helper(name, text, text)


def _saturating(name: str, ctype: str, low: str, high: str) -> Helper:
    """Truncation of a real; the first real that is too large is a power of two, exact in both precisions."""
    text = f"""static inline {ctype} {name}(real x)
{{
    return x >= {high} ? {"INT32_MAX" if ctype == "int32_t" else "UINT32_MAX"} : x > {low} ? ({ctype})x : {{other}};
}}
"""
    if ctype == "int32_t":
        text = text.replace("{other}", f"x <= {low} ? INT32_MIN : 0")
    else:
        text = text.replace("{other}", "0u")
    return Helper(name, text, text.replace("p31", "p31f").replace("p32", "p32f").replace("p0", "p0f"))


def _converting(origin: str, target: str) -> Helper:
    """A conversion of what a function returns, for a compiler that warns of a cast there (-Wbad-function-cast)."""
    types = {"bool": "bool", "int32": "int32_t", "uint32": "uint32_t", "real": "real"}
    name = f"{origin}_to_{target}"
    return _same(
        name, f"static inline {types[target]} {name}({types[origin]} x)\n{{\n    return ({types[target]})x;\n}}\n"
    )


CONVERTING = [
    _converting(origin, target)
    for origin in ("bool", "int32", "uint32")
    for target in ("int32", "uint32", "real")
    if origin != target
]
HELPERS: dict[str, Helper] = {
    **{helper.name: helper for helper in CONVERTING},
    "clamp_index": _same(
        "clamp_index",
        """static inline int32_t clamp_index(int32_t i, int32_t last)
{
    return i < 0 ? 0 : i > last ? last : i;
}
""",
    ),
    "real_equal": _same(  # x == y, for a compiler that is told to warn of that
        "real_equal",
        """static inline bool real_equal(real x, real y)
{
    return x <= y && x >= y;
}
""",
    ),
    "int32_add": _same(
        "int32_add",
        """static inline int32_t int32_add(int32_t a, int32_t b)
{
    return (int32_t)((uint32_t)a + (uint32_t)b);
}
""",
    ),
    "int32_sub": _same(
        "int32_sub",
        """static inline int32_t int32_sub(int32_t a, int32_t b)
{
    return (int32_t)((uint32_t)a - (uint32_t)b);
}
""",
    ),
    "int32_mul": _same(
        "int32_mul",
        """static inline int32_t int32_mul(int32_t a, int32_t b)
{
    return (int32_t)((uint32_t)a * (uint32_t)b);
}
""",
    ),
    "int32_neg": _same(
        "int32_neg",
        """static inline int32_t int32_neg(int32_t a)
{
    return (int32_t)(0u - (uint32_t)a);
}
""",
    ),
    "int32_abs": _same(
        "int32_abs",
        """static inline int32_t int32_abs(int32_t a)
{
    return a < 0 ? (int32_t)(0u - (uint32_t)a) : a;
}
""",
    ),
    "int32_quot": _same(
        "int32_quot",
        """static inline int32_t int32_quot(int32_t a, int32_t b)
{
    return b == 0 ? 0 : b == -1 ? (int32_t)(0u - (uint32_t)a) : a / b;
}
""",
    ),
    "int32_rem": _same(
        "int32_rem",
        """static inline int32_t int32_rem(int32_t a, int32_t b)
{
    return b == 0 || b == -1 ? 0 : a % b;
}
""",
    ),
    "int32_shl": _same(
        "int32_shl",
        """static inline int32_t int32_shl(int32_t a, int32_t count)
{
    return (int32_t)((uint32_t)a << ((uint32_t)count & 31u));
}
""",
    ),
    "int32_shr": _same(
        "int32_shr",
        """static inline int32_t int32_shr(int32_t a, int32_t count)
{
    return a >> ((uint32_t)count & 31u);
}
""",
    ),
    "uint32_quot": _same(
        "uint32_quot",
        """static inline uint32_t uint32_quot(uint32_t a, uint32_t b)
{
    return b == 0u ? 0u : a / b;
}
""",
    ),
    "uint32_rem": _same(
        "uint32_rem",
        """static inline uint32_t uint32_rem(uint32_t a, uint32_t b)
{
    return b == 0u ? 0u : a % b;
}
""",
    ),
    "real_to_int32": _saturating("real_to_int32", "int32_t", "-0x1p31", "0x1p31"),
    "real_to_uint32": _saturating("real_to_uint32", "uint32_t", "0x0p0", "0x1p32"),
    "real_word_0": Helper(
        "real_word_0",
        """static inline uint32_t real_word_0(real x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return __builtin_isnan(x) ? 0u : (uint32_t)bits;
}
""",
        """static inline uint32_t real_word_0(real x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return __builtin_isnan(x) ? 0x7fc00000u : bits;
}
""",
    ),
    "real_word_1": Helper(
        "real_word_1",
        """static inline uint32_t real_word_1(real x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return __builtin_isnan(x) ? 0x7ff80000u : (uint32_t)(bits >> 32);
}
""",
        """static inline uint32_t real_word_1(real x)
{
    (void)x;
    return 0u;
}
""",
    ),
    "real_from_bits": Helper(
        "real_from_bits",
        """static inline real real_from_bits(uint32_t low, uint32_t high)
{
    const uint64_t bits = (uint64_t)high << 32 | low;
    real x;
    memcpy(&x, &bits, sizeof x);
    return x;
}
""",
        """static inline real real_from_bits(uint32_t low, uint32_t high)
{
    const uint64_t bits = (uint64_t)high << 32 | low;
    double x;
    memcpy(&x, &bits, sizeof x);
    return (real)x;
}
""",
    ),
    "real_from_word": Helper(
        "real_from_word",
        """static inline real real_from_word(uint32_t word)
{
    float x;
    memcpy(&x, &word, sizeof x);
    return (real)x;
}
""",
        """static inline real real_from_word(uint32_t word)
{
    real x;
    memcpy(&x, &word, sizeof x);
    return x;
}
""",
    ),
}
