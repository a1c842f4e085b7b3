"""Kinds beside real and the integers of 32 bits in lanes: which vectors they are, and the C of those that need more.

The float that is not the build's real has vectors of its own, with as many lanes. Integers of 8 and 16 bits stand in
vectors of int32.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from twodof.blocks.expressions.kinds import BY_NAME, STORED, WORDS
from twodof.compile.c.operators import ATOM, C_TYPES, COMPARISONS, OPERATORS, Operator, called

_SAME = Operator("{0}", (ATOM,), ATOM)  # a conversion that changes nothing
_ORDER = {**COMPARISONS, "gt": ">", "ge": ">="}

Vectorwise = Callable[[str, str, str, str], str]
Lanewise = Callable[[str, str, Sequence[str], str], str]


@dataclass(frozen=True)
class MoreC:
    """C that stands before a program if its text has the `mark`, and the scalar helpers that it calls."""

    mark: str
    text: str
    helpers: frozenset[str] = frozenset()


def other_float(precision: str) -> str:
    """The float kind that is not the real of a build."""
    return "float32" if precision == "float64" else "float64"


def lane_kinds(precision: str) -> dict[str, str]:
    """The kind whose vectors each kind has."""
    made = {name: kind.computes for name, kind in BY_NAME.items()}
    return {**made, precision: "real"}


def lane_operators(precision: str) -> dict[str, Operator]:
    """The rows of C's operators as functions of vectors."""
    kinds = lane_kinds(precision)
    made: dict[str, Operator] = {}
    for name, operator in OPERATORS.items():
        origin, _, target = name.partition("_to_")
        if target and target not in STORED and kinds[origin] == kinds[target]:
            made[name] = _SAME
        else:
            own = name if target in STORED else "_".join(kinds.get(word, word) for word in name.split("_"))
            made[name] = called(f"lanes_v_{own}", operator.arity)
    return made


def wrapped(vectorwise: Vectorwise) -> Iterator[MoreC]:
    """int32 to the kinds of 8 and 16 bits: the low bits, as an int32."""
    for kind in STORED:
        bits = 32 - (BY_NAME[kind].high - BY_NAME[kind].low).bit_length()
        shifted = f"(lanes_i)((lanes_u)a << {bits}) >> {bits}" if BY_NAME[kind].low else f"a & {BY_NAME[kind].high}"
        name = f"int32_to_{kind}"
        yield MoreC(f"lanes_v_{name}", vectorwise("int32", name, "a int32", shifted))


def other_reals(kind: str, vectorwise: Vectorwise, lanewise: Lanewise) -> str:
    """Arithmetic, comparisons, choices and conversions of the other float."""
    single = kind == "float32"
    text = ""
    for name, sign in (("add", "+"), ("sub", "-"), ("mul", "*"), ("div", "/")):
        text += vectorwise(kind, f"{name}_{kind}", f"a {kind}, b {kind}", f"a {sign} b")
    text += vectorwise(kind, f"neg_{kind}", f"a {kind}", "-a")
    magnitude = "0x7fffffff" if single else "INT64_C(0x7fffffffffffffff)"
    text += vectorwise(kind, f"abs_{kind}", f"a {kind}", f"(lanes_x)((lanes_y)a & {magnitude})")
    text += lanewise(kind, f"sqrt_{kind}", (kind,), f"__builtin_sqrt{'f' if single else ''}(a[l])")
    for name, sign in _ORDER.items():
        told = f"lanes_test_i(__builtin_convertvector(a {sign} b, lanes_i), !=, NEQ_UQ, (lanes_i){{0}})"
        text += vectorwise("bool", f"{name}_{kind}", f"a {kind}, b {kind}", told)
    on = "__builtin_convertvector(lanes_i_of_m(c), lanes_y)"
    text += vectorwise(kind, f"pick_{kind}", f"c bool, a {kind}, b {kind}", f"lanes_blend_x({on}, a, b)")
    for origin in ("real", *WORDS):
        text += vectorwise(kind, f"{origin}_to_{kind}", f"a {origin}", "__builtin_convertvector(a, lanes_x)")
    text += vectorwise("real", f"{kind}_to_real", f"a {kind}", "__builtin_convertvector(a, lanes_r)")
    for word in WORDS:
        text += lanewise(word, f"{kind}_to_{word}", (kind,), f"{kind}_to_{word}(a[l])")
    bits = "(lanes_z)lanes_blend_x(a != a, (lanes_x)((lanes_z){0} + QUIET), a)"
    quiet = "0x7fc00000u" if single else "UINT64_C(0x7ff8000000000000)"
    lower = f"__builtin_convertvector({bits.replace('QUIET', quiet)}, lanes_u)"
    text += vectorwise("uint32", f"{kind}_word_0", f"a {kind}", lower)
    if single:
        text += lanewise("uint32", f"{kind}_word_1", (kind,), f"{kind}_word_1(a[l])")
        text += lanewise(kind, f"{kind}_from_bits", ("uint32", "uint32"), f"{kind}_from_bits(a[l], b[l])")
        return text + vectorwise(kind, f"{kind}_from_word", "a uint32", "(lanes_x)a")
    text += vectorwise("uint32", f"{kind}_word_1", f"a {kind}", lower.replace(", lanes_u", " >> 32, lanes_u"))
    wide = "(lanes_x)(__builtin_convertvector(b, lanes_z) << 32 | __builtin_convertvector(a, lanes_z))"
    text += vectorwise(kind, f"{kind}_from_bits", "a uint32, b uint32", wide)
    return text + lanewise(kind, f"{kind}_from_word", ("uint32",), f"{kind}_from_word(a[l])")


def other_types(kind: str, each: int, vectors: int) -> str:
    """The types of the other float in so many vectors of `each` lanes, and integers as wide."""
    word = "32" if kind == "float32" else "64"
    size = each * int(word) // 8
    members = ", ".join(f"v{k}" for k in range(vectors))
    aligned = f"__attribute__((vector_size({size}), aligned({min(size, 64)}), may_alias))"
    return (
        f"typedef {C_TYPES[kind]} lanes_x {aligned};\n"
        f"typedef int{word}_t lanes_y {aligned};\ntypedef uint{word}_t lanes_z {aligned};\n"
        f"typedef struct {{ lanes_x {members}; }} lanes_{kind};\n"
        f"typedef {C_TYPES[kind]} lanes_one_{kind} __attribute__((may_alias));\n\n"
        "td_inline lanes_x lanes_blend_x(lanes_y c, lanes_x a, lanes_x b)\n{\n"
        "    return (lanes_x)((c & (lanes_y)a) | (~c & (lanes_y)b));\n}\n\n"
    )


def helpers_of(kind: str) -> frozenset[str]:
    """The scalar helpers that the functions of the other float call."""
    named = [f"{kind}_to_{word}" for word in WORDS] + [f"{kind}_word_{n}" for n in (0, 1)]
    return frozenset([*named, f"{kind}_from_bits", f"{kind}_from_word"])
