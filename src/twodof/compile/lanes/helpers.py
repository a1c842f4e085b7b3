"""The C types and functions of lanes: a value is a struct of SIMD vectors, an operation one inline function.

A lane's bits are those of the scalar operation: nothing is contracted, reassociated or approximated. Masks are vectors
as wide as reals, all ones where true. With vectors of 64 bytes they have one bit a lane, as AVX-512's own masks do.
Vectors are GCC's and clang's; what they lack is done lane by lane. `templates/` has what names a processor's own.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib import resources
from string import Template

from twodof.compile.c.operators import BITWISE, C_TYPES, COMPARISONS, OPERATORS
from twodof.compile.lanes.other_kinds import MoreC, helpers_of, other_float, other_reals, other_types, wrapped
from twodof.compile.program.layout import LaneShape

_PARTS = dict(
    part.split("\n", 1)
    for part in resources.files(__package__)
    .joinpath("templates", "vectors.h")
    .read_text(encoding="utf-8")
    .split("//// ")[1:]
)
KINDS = ("real", "int32", "uint32", "bool")
"""Those that every program's C has; `other_kinds` has the rest."""
TYPES = {kind: f"lanes_{kind}" for kind in (*KINDS, "float32", "float64")}
VECTORS = {"real": "lanes_r", "int32": "lanes_i", "uint32": "lanes_u", "bool": "lanes_m"}
VECTORS |= dict.fromkeys(("float32", "float64"), "lanes_x")  # that which is not the build's real
_ORDERED = {"lt": "LT_OQ", "le": "LE_OQ", "eq": "EQ_OQ", "ne": "NEQ_UQ"}
_TESTS = {name: f"{COMPARISONS[name]}, {test}" for name, test in _ORDERED.items()}
_TESTS |= {"gt": ">, GT_OQ", "ge": ">=, GE_OQ"}
"""Comparisons: C's sign, and AVX-512's name of it, of NaNs as in C."""
SCALARS = frozenset(
    ("int32_quot", "int32_rem", "uint32_quot", "uint32_rem", "real_from_bits", "real_from_word", "clamp_index")
)
"""The scalar helpers that the functions here call."""


def _part(name: str, **fields: object) -> str:
    return Template(_PARTS[name]).substitute(fields)


def prelude(shape: LaneShape) -> str:
    """All types and functions."""
    return _types(shape) + "".join(_functions(shape))


def _scalar(row: str, *operands: str) -> str:
    """The C of a scalar operation with these operands, which vectors take as well."""
    return OPERATORS[row].text.format(*operands)


def _types(shape: LaneShape) -> str:
    single = shape.precision == "float32"
    narrow = shape.each * 4
    word = "32" if single else "64"
    vectors = (
        ("real", "lanes_r", shape.size, "reals"),
        (f"int{word}_t", "lanes_f" if shape.bits else "lanes_m", shape.size, "all ones where true"),
        (f"uint{word}_t", "lanes_w", shape.size, "bits of reals"),
        ("int32_t", "lanes_i", narrow, ""),
        ("uint32_t", "lanes_u", narrow, ""),
    )
    # What gcc reorders comes out slower by up to a fifth than what is written.
    order = ("tree-reassoc", "schedule-insns2", "rerun-cse-after-loop", "split-wide-types")
    left = ", ".join(f'"no-{name}"' for name in order)
    gcc = f"#if defined(__GNUC__) && !defined(__clang__)\n#pragma GCC optimize({left})\n#endif\n"
    text = [gcc]
    text += ["#if defined(__AVX2__)\n#include <immintrin.h>\n#endif\n\n"]
    text += [
        f"/* {shape.lanes} lanes: {shape.vectors} vectors of {shape.each}. */\n",
        f"#define LANES_BYTES {shape.size}\n",
    ]
    for of, name, size, remark in vectors:
        comment = f" /* {remark} */" if remark else ""
        text.append(f"typedef {of} {name} __attribute__((vector_size({size}), aligned({size}), may_alias));{comment}\n")
    if shape.bits:
        text.append(f"typedef uint{shape.each}_t lanes_m __attribute__((may_alias)); /* a bit for each lane */\n")
    members = ", ".join(f"v{k}" for k in range(shape.vectors))
    text += [f"typedef struct {{ {VECTORS[kind]} {members}; }} {TYPES[kind]};\n" for kind in KINDS]
    text += ["typedef real lanes_one_real __attribute__((may_alias));\n"]
    text += [f"typedef {C_TYPES[kind]} lanes_one_{kind} __attribute__((may_alias));\n" for kind in ("int32", "uint32")]
    text += [f"typedef {'lanes_m' if shape.bits else f'int{word}_t'} lanes_one_bool __attribute__((may_alias));\n\n"]
    fields = {"ps": "ps", "d": "", "n": "512"} if single else {"ps": "pd", "d": "d", "n": "256"}
    fields["wide"] = "((lanes_m)(x))" if single else "__builtin_convertvector(x, lanes_m)"
    fields["narrow"] = "((lanes_i)(x))" if single else "__builtin_convertvector(x, lanes_i)"
    fields["each"] = str(shape.each)
    text += [
        _part(name, **fields) for name in ("conversions", "bit_masks" if shape.bits else "vector_masks", "choices")
    ]
    return "".join(text) + "\n"


def _vectorwise(shape: LaneShape, result: str, name: str, arguments: str, expression: str) -> str:
    """A function of single vectors, and one of whole values."""
    kinds = dict(part.split(" ") for part in arguments.split(", "))
    single = ", ".join(f"{VECTORS[kind]} {letter}" for letter, kind in kinds.items())
    head = ", ".join(f"{TYPES[kind]} {letter}" for letter, kind in kinds.items())
    calls = [f"lanes_v_{name}({', '.join(f'{x}.v{k}' for x in kinds)})" for k in range(shape.vectors)]
    return (
        f"td_inline {VECTORS[result]} lanes_v_{name}({single})\n{{\n"
        f"    return {expression};\n}}\n\n"
        f"td_inline {TYPES[result]} lanes_{name}({head})\n{{\n"
        f"    return ({TYPES[result]}){{{', '.join(calls)}}};\n}}\n\n"
    )


def _lanewise(shape: LaneShape, result: str, name: str, kinds: Sequence[str], expression: str) -> str:
    """A function that a scalar expression of a, b gives, lane by lane."""
    letters = "ab"[: len(kinds)]
    head = ", ".join(f"{VECTORS[kind]} {letter}" for kind, letter in zip(kinds, letters, strict=True))
    native = (
        f"td_inline {VECTORS[result]} lanes_each_{name}({head})\n{{\n    {VECTORS[result]} y;\n"
        f"    for (int l = 0; l < {shape.each}; l++)\n        y[l] = {expression};\n    return y;\n}}\n\n"
    )
    arguments = ", ".join(f"{letter} {kind}" for kind, letter in zip(kinds, letters, strict=True))
    return native + _vectorwise(shape, result, name, arguments, f"lanes_each_{name}({', '.join(letters)})")


def _same_in_all(shape: LaneShape, kind: str) -> str:
    """A value that all lanes have."""
    value = "-(lanes_one_bool)x" if kind == "bool" else "x"
    one = "{" + ", ".join(["w"] * shape.each) + "}"
    if kind == "bool" and shape.bits:
        value, one = "(lanes_one_bool)-x", "w"
    return _part(
        "same_in_all",
        kind=kind,
        vector=VECTORS[kind],
        whole=TYPES[kind],
        scalar=C_TYPES[kind],
        value=value,
        one=one,
        calls=", ".join([f"lanes_v_{kind}_all(x)"] * shape.vectors),
    )


def more(shape: LaneShape) -> list[MoreC]:
    """The C that only programs with other kinds need."""
    kind = other_float(shape.precision)
    vectorwise, lanewise = partial(_vectorwise, shape), partial(_lanewise, shape)
    text = other_types(kind, shape.each, shape.vectors) + _same_in_all(shape, kind)
    text += other_reals(kind, vectorwise, lanewise) + _elements(shape, kind)
    return [MoreC(f"_{kind}", text, helpers_of(kind)), *wrapped(vectorwise)]


def _functions(shape: LaneShape) -> Iterator[str]:
    single = shape.precision == "float32"
    f = "f" if single else ""
    vectorwise, lanewise = partial(_vectorwise, shape), partial(_lanewise, shape)

    # the same in all lanes
    for kind in KINDS:
        yield _same_in_all(shape, kind)
    # reals
    for name in ("add", "sub", "mul", "div"):
        yield vectorwise("real", f"{name}_real", "a real, b real", _scalar(f"{name}_real", "a", "b"))
    yield vectorwise("real", "neg_real", "a real", _scalar("neg_real", "a"))
    magnitude = "0x7fffffffu" if single else "UINT64_C(0x7fffffffffffffff)"
    yield vectorwise("real", "abs_real", "a real", f"(lanes_r)((lanes_w)a & {magnitude})")
    yield _part("root", each=shape.each, size=shape.size, f=f)
    yield vectorwise("real", "sqrt_real", "a real", "lanes_root(a)")
    # x86's minimum and maximum are a < b ? a : b and a > b ? a : b, of NaNs and zeros too
    yield vectorwise("real", "min_real", "a real, b real", "lanes_least(a, b)")
    yield vectorwise("real", "max_real", "a real, b real", "lanes_most(a, b)")
    # comparisons
    for name, test in _TESTS.items():
        yield vectorwise("bool", f"{name}_real", "a real, b real", f"lanes_test_r(a, {test}, b)")
        if name not in ("gt", "ge"):
            for kind in ("int32", "uint32"):
                tested = f"lanes_test_{kind[0]}(a, {test}, b)"
                yield vectorwise("bool", f"{name}_{kind}", f"a {kind}, b {kind}", tested)
    # truth values
    for name, text in (
        ("and", "a & b"),
        ("or", "a | b"),
        ("xor", "a ^ b"),
        ("ne", "a ^ b"),
        ("eq", "~(a ^ b)"),
    ):
        yield vectorwise("bool", f"{name}_bool", "a bool, b bool", f"(lanes_m)({text})")
    yield vectorwise("bool", "not_bool", "a bool", "(lanes_m)~a")
    # choices
    yield vectorwise("real", "pick_real", "c bool, a real, b real", "lanes_blend_r(c, a, b)")
    yield vectorwise("bool", "pick_bool", "c bool, a bool, b bool", "lanes_blend_m(c, a, b)")
    for kind in ("int32", "uint32"):
        v = VECTORS[kind]
        yield (
            f"td_inline {v} lanes_blend_{v[-1]}(lanes_m c, {v} a, {v} b)\n{{\n    const {v} m = ({v})lanes_i_of_m(c);\n"
            f"    return (m & a) | (~m & b);\n}}\n\n"
        )
        yield vectorwise(kind, f"pick_{kind}", f"c bool, a {kind}, b {kind}", f"lanes_blend_{v[-1]}(c, a, b)")
    # integers
    for kind in ("int32", "uint32"):
        v = VECTORS[kind]
        # What wraps around is done without a sign.
        wrapped = {
            op: f"({v})({_scalar(f'{op}_uint32', '(lanes_u)a', '(lanes_u)b')})" for op in ("add", "sub", "mul", "shl")
        }
        for name in ("add", "sub", "mul"):
            yield vectorwise(kind, f"{name}_{kind}", f"a {kind}, b {kind}", wrapped[name])
        yield vectorwise(kind, f"neg_{kind}", f"a {kind}", f"({v})({_scalar('neg_uint32', '(lanes_u)a')})")
        for name in BITWISE:
            yield vectorwise(kind, f"{name}_{kind}", f"a {kind}, b {kind}", _scalar(f"{name}_{kind}", "a", "b"))
        yield vectorwise(kind, f"not_{kind}", f"a {kind}", _scalar(f"not_{kind}", "a"))
        yield vectorwise(kind, f"shl_{kind}", f"a {kind}, b {kind}", wrapped["shl"])
        yield vectorwise(kind, f"shr_{kind}", f"a {kind}, b {kind}", f"a >> ({v})((lanes_u)b & 31u)")
        for name in ("quot", "rem"):
            yield lanewise(kind, f"{name}_{kind}", (kind, kind), f"{kind}_{name}(a[l], b[l])")
    yield vectorwise("int32", "abs_int32", "a int32", "(lanes_i)(((lanes_u)a ^ (lanes_u)(a < 0)) - (lanes_u)(a < 0))")
    yield vectorwise("uint32", "abs_uint32", "a uint32", "a")
    yield _high(shape)
    yield vectorwise("uint32", "mulhi_uint32", "a uint32, b uint32", "lanes_high(a, b)")
    yield from _conversions(shape, vectorwise, lanewise)
    yield from _memory(shape)


def _high(shape: LaneShape) -> str:
    """The high words of products: those of the even and of the odd elements."""
    size = shape.each * 4
    bits = size * 8
    prefix = "_mm" if bits == 128 else f"_mm{bits}"
    needs = "__AVX512F__" if bits == 512 else "__AVX2__"
    text = """    const lanes_d low = (lanes_d){0} + 0xffffffffu;
    const lanes_d even = (x & low) * (y & low), odd = (x >> 32) * (y >> 32);
"""
    if bits >= 128:
        text = (
            f"#if defined({needs})\n"
            f"    const lanes_d even = (lanes_d){prefix}_mul_epu32((__m{bits}i)x, (__m{bits}i)y);\n"
            f"    const lanes_d odd = (lanes_d){prefix}_mul_epu32((__m{bits}i)(x >> 32), (__m{bits}i)(y >> 32));\n"
            f"#else\n{text}#endif\n"
        )
    return _part("high", size=size, products=text)


def _conversions(
    shape: LaneShape,
    vectorwise: Callable[[str, str, str, str], str],
    lanewise: Callable[[str, str, Sequence[str], str], str],
) -> Iterator[str]:
    """Between types, saturating, and to and from the bits of reals."""
    single = shape.precision == "float32"
    f = "f" if single else ""
    for kind, low, high, least, most in (
        ("int32", f"-0x1p31{f}", f"0x1p31{f}", "INT32_MIN", "INT32_MAX"),
        ("uint32", f"0x0p0{f}", f"0x1p32{f}", "0u", "UINT32_MAX"),
    ):
        v = VECTORS[kind]
        yield _part("saturating", v=v, letter=v[-1], low=low, high=high, least=least, most=most)
        yield vectorwise(kind, f"real_to_{kind}", "a real", f"lanes_real_{v[-1]}(a)")
        yield vectorwise("real", f"{kind}_to_real", f"a {kind}", f"lanes_r_of_{v[-1]}(a)")
        yield vectorwise(kind, f"bool_to_{kind}", "a bool", f"({v})lanes_i_of_m(a) & 1")
    yield vectorwise("real", "bool_to_real", "a bool", "lanes_only_r(a, (lanes_r){0} + 1)")
    yield vectorwise("int32", "uint32_to_int32", "a uint32", "(lanes_i)a")
    yield vectorwise("uint32", "int32_to_uint32", "a int32", "(lanes_u)a")
    if single:
        nan = "lanes_blend_u(lanes_v_ne_real(a, a), (lanes_u){0} + 0x7fc00000u, (lanes_u)a)"
        yield vectorwise("uint32", "real_word_0", "a real", nan)
        yield vectorwise("uint32", "real_word_1", "a real", "(lanes_u)((lanes_w)a & 0u)")
        yield lanewise("real", "real_from_bits", ("uint32", "uint32"), "real_from_bits(a[l], b[l])")
        yield vectorwise("real", "real_from_word", "a uint32", "(lanes_r)a")
        return
    yield _part("bits")
    yield vectorwise("uint32", "real_word_0", "a real", "lanes_u_of_w(lanes_bits(a))")
    yield vectorwise("uint32", "real_word_1", "a real", "lanes_u_of_w(lanes_bits(a) >> 32)")
    yield vectorwise(
        "real",
        "real_from_bits",
        "a uint32, b uint32",
        "(lanes_r)(lanes_w_of_u(b) << 32 | lanes_w_of_u(a))",
    )
    yield lanewise("real", "real_from_word", ("uint32",), "real_from_word(a[l])")


def _memory(shape: LaneShape) -> Iterator[str]:
    """Elements of arrays at an index of each lane's own, and whether anything holds anywhere."""
    lanes, each = shape.lanes, shape.each
    vectors = range(shape.vectors)
    others = " | ".join(f"(i.v{k} ^ first)" for k in vectors)
    within = ", ".join(f"lanes_within(i.v{k}, last)" for k in vectors)
    yield _part("indices", within=within, others=others, compared=_all_zero(each * 32))
    for kind in KINDS:
        yield _elements(shape, kind)
    yield _part("any", masks=lanes // each if shape.bits else lanes)


def _elements(shape: LaneShape, kind: str) -> str:
    """Elements of arrays of one kind."""
    lanes, each = shape.lanes, shape.each
    at = "((const lanes_one_int32 *)i)[l]"
    on = f"((const lanes_one_bool *)c)[{f'l / {each}' if shape.bits else 'l'}]"
    if shape.bits:
        on += f" >> l % {each} & 1"
    one = f"lanes_one_{kind}"
    get = f"(({one} *)y)[l] = ((const {one} *)a)[{at} * {lanes} + l]"
    put = f"(({one} *)a)[{at} * {lanes} + l] = ((const {one} *)x)[l]"
    begun = before = ""
    if kind == "bool" and shape.bits:
        begun = "    *y = *a;\n"
        get, put = f"lanes_copy_bit(y, &a[{at}], l)", f"lanes_copy_bit(&a[{at}], x, l)"
        before = _part("copy_bit", each=each)
    fetched = f"    for (int l = 0; l < {lanes}; l++)\n        {get};\n"
    if kind == "real" and shape.bits:
        fetched = f"#if defined(__AVX512F__)\n{_gathered(shape)}#else\n{fetched}#endif\n"
    whole = TYPES[kind]
    return before + _part("elements", kind=kind, whole=whole, fetched=begun + fetched, lanes=lanes, on=on, put=put)


def _all_zero(bits: int) -> str:
    """Whether a vector of indices, `differ`, is all zero."""
    told = {
        512: ("__AVX512F__", "_mm512_test_epi64_mask((__m512i)differ, (__m512i)differ) == 0"),
        256: ("__AVX2__", "_mm256_testz_si256((__m256i)differ, (__m256i)differ)"),
        128: ("__AVX2__", "_mm_testz_si128((__m128i)differ, (__m128i)differ)"),
    }
    words = bits // 64
    either = " | ".join(f"d[{w}]" for w in range(words))
    plain = f"    uint64_t d[{words}];\n    memcpy(d, &differ, sizeof d);\n    return ({either}) == 0u;\n"
    if bits not in told:
        return plain
    needs, test = told[bits]
    return f"#if defined({needs})\n    return {test};\n#else\n{plain}#endif\n"


def _gathered(shape: LaneShape) -> str:
    """Reals at an index of each lane's own, as AVX-512 fetches them."""
    how, whole, word = ("ps", 512, 4) if shape.precision == "float32" else ("pd", 256, 8)
    text = f"    const lanes_i lane = {{{', '.join(str(l) for l in range(shape.each))}}};\n"
    for k in range(shape.vectors):
        at = f"(__m{whole}i)(i->v{k} * {shape.lanes} + (lane + {k * shape.each}))"
        text += f"    y->v{k} = (lanes_r)_mm512_i32gather_{how}({at}, a, {word});\n"
    return text
