"""The C types and functions of lanes: a value is a struct of SIMD vectors, an operation one inline function.

A lane's bits are those of the scalar operation: nothing is contracted, reassociated or approximated. Masks are vectors
as wide as reals, all ones where true. With vectors of 64 bytes they have one bit a lane, as AVX-512's own masks do.
Vectors are GCC's and clang's; what they lack is done lane by lane.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from twodof.compile.c.operators import BITWISE, C_TYPES, COMPARISONS, OPERATORS
from twodof.compile.program.layout import LaneShape

KINDS = tuple(C_TYPES)
TYPES = {kind: f"lanes_{kind}" for kind in KINDS}
VECTORS = {"real": "lanes_r", "int32": "lanes_i", "uint32": "lanes_u", "bool": "lanes_m"}
_ORDERED = {"lt": "LT_OQ", "le": "LE_OQ", "eq": "EQ_OQ", "ne": "NEQ_UQ"}
_TESTS = {name: f"{COMPARISONS[name]}, {test}" for name, test in _ORDERED.items()}
_TESTS |= {"gt": ">, GT_OQ", "ge": ">=, GE_OQ"}
"""Comparisons: C's sign, and AVX-512's name of it, of NaNs as in C."""
SCALARS = frozenset(
    ("int32_quot", "int32_rem", "uint32_quot", "uint32_rem", "real_from_bits", "real_from_word", "clamp_index")
)
"""The scalar helpers that the functions here call."""

_CONVERSIONS = """/* Between vectors of reals and integers, whole and half width; gcc 12 does it in halves untold. */
#if defined(__AVX512DQ__) && LANES_BYTES == 64
#define lanes_r_of_i(x) ((lanes_r)_mm512_cvtepi32_{ps}((__m{n}i)(x)))
#define lanes_r_of_u(x) ((lanes_r)_mm512_cvtepu32_{ps}((__m{n}i)(x)))
#define lanes_i_of_r(x) ((lanes_i)_mm512_cvtt{ps}_epi32((__m512{d})(x)))
#define lanes_u_of_r(x) ((lanes_u)_mm512_cvtt{ps}_epu32((__m512{d})(x)))
#define lanes_w_of_u(x) ((lanes_w)_mm512_cvtepu32_epi64((__m256i)(x)))
#define lanes_u_of_w(x) ((lanes_u)_mm512_cvtepi64_epi32((__m512i)(x)))
#else
#define lanes_r_of_i(x) __builtin_convertvector(x, lanes_r)
#define lanes_r_of_u(x) __builtin_convertvector(x, lanes_r)
#define lanes_i_of_r(x) __builtin_convertvector(x, lanes_i)
#define lanes_u_of_r(x) __builtin_convertvector(x, lanes_u)
#define lanes_w_of_u(x) __builtin_convertvector(x, lanes_w)
#define lanes_u_of_w(x) __builtin_convertvector(x, lanes_u)
#endif
"""
_VECTOR_MASKS = """/* Masks are vectors as wide as reals; of integers, as wide as those. */
#define lanes_test_r(a, sign, how, b) ((lanes_m)((a) sign (b)))
#define lanes_test_i(a, sign, how, b) lanes_m_of_i((a) sign (b))
#define lanes_test_u(a, sign, how, b) lanes_m_of_i((a) sign (b))
#define lanes_m_of_i(x) {wide}
#define lanes_i_of_m(x) {narrow}
#define lanes_only_r(c, a) ((lanes_r)((c) & (lanes_m)(a)))
"""
_BIT_MASKS = """/* Masks are bits. */
#if defined(__AVX512DQ__) && defined(__AVX512VL__)
#define lanes_test_r(a, sign, how, b) ((lanes_m)_mm512_cmp_{ps}_mask((__m512{d})(a), (__m512{d})(b), _CMP_##how))
#define lanes_test_i(a, sign, how, b) ((lanes_m)_mm{n}_cmp_epi32_mask((__m{n}i)(a), (__m{n}i)(b), lanes_how_##how))
#define lanes_test_u(a, sign, how, b) ((lanes_m)_mm{n}_cmp_epu32_mask((__m{n}i)(a), (__m{n}i)(b), lanes_how_##how))
#define lanes_how_LT_OQ _MM_CMPINT_LT
#define lanes_how_LE_OQ _MM_CMPINT_LE
#define lanes_how_EQ_OQ _MM_CMPINT_EQ
#define lanes_how_NEQ_UQ _MM_CMPINT_NE
#define lanes_i_of_m(x) ((lanes_i)_mm{n}_movm_epi32(x))
#define lanes_only_r(c, a) ((lanes_r)_mm512_maskz_mov_{ps}(c, (__m512{d})(a)))
#define lanes_blend_r(c, a, b) ((lanes_r)_mm512_mask_blend_{ps}(c, (__m512{d})(b), (__m512{d})(a)))
#else
td_inline lanes_m lanes_signs(lanes_f x)
{
    lanes_m y = 0;
    for (int l = 0; l < {each}; l++)
        y = (lanes_m)(y | (x[l] < 0 ? 1u << l : 0u));
    return y;
}

td_inline lanes_f lanes_f_of_m(lanes_m x)
{
    lanes_f y;
    for (int l = 0; l < {each}; l++)
        y[l] = -(x >> l & 1);
    return y;
}

#define lanes_test_r(a, sign, how, b) lanes_signs((lanes_f)((a) sign (b)))
#define lanes_test_i(a, sign, how, b) lanes_signs(__builtin_convertvector((a) sign (b), lanes_f))
#define lanes_test_u(a, sign, how, b) lanes_test_i(a, sign, how, b)
#define lanes_i_of_m(x) __builtin_convertvector(lanes_f_of_m(x), lanes_i)
#define lanes_only_r(c, a) ((lanes_r)(lanes_f_of_m(c) & (lanes_f)(a)))
td_inline lanes_r lanes_blend_r(lanes_m c, lanes_r a, lanes_r b)
{
    const lanes_f on = lanes_f_of_m(c);
    return (lanes_r)((on & (lanes_f)a) | (~on & (lanes_f)b));
}
#endif
"""
_BLEND = """/* a where c, else b; `only`: else 0 */
#if defined(__AVX2__) && LANES_BYTES == 32
#define lanes_blend_r(c, a, b) ((lanes_r)_mm256_blendv_{ps}((__m256{d})(b), (__m256{d})(a), (__m256{d})(c)))
#elif LANES_BYTES < 64
#define lanes_blend_r(c, a, b) ((lanes_r)(((c) & (lanes_m)(a)) | (~(c) & (lanes_m)(b))))
#endif
#if defined(__AVX512F__) && LANES_BYTES == 64
#define lanes_least(a, b) ((lanes_r)_mm512_min_{ps}((__m512{d})(a), (__m512{d})(b)))
#define lanes_most(a, b) ((lanes_r)_mm512_max_{ps}((__m512{d})(a), (__m512{d})(b)))
#elif defined(__AVX2__) && LANES_BYTES == 32
#define lanes_least(a, b) ((lanes_r)_mm256_min_{ps}((__m256{d})(a), (__m256{d})(b)))
#define lanes_most(a, b) ((lanes_r)_mm256_max_{ps}((__m256{d})(a), (__m256{d})(b)))
#else
#define lanes_least(a, b) lanes_blend_r(lanes_test_r(a, <, LT_OQ, b), a, b)
#define lanes_most(a, b) lanes_blend_r(lanes_test_r(a, >, GT_OQ, b), a, b)
#endif
#define lanes_blend_m(c, a, b) ((lanes_m)(((c) & (a)) | (~(c) & (b))))
"""


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
    double = {"ps": "pd", "epi": "epi64", "d": "d", "n": "256"}
    suffixes = {"ps": "ps", "epi": "epi32", "d": "", "n": "512"} if single else double
    suffixes["wide"] = "((lanes_m)(x))" if single else "__builtin_convertvector(x, lanes_m)"
    suffixes["narrow"] = "((lanes_i)(x))" if single else "__builtin_convertvector(x, lanes_i)"
    suffixes["each"] = str(shape.each)
    told = _CONVERSIONS + (_BIT_MASKS if shape.bits else _VECTOR_MASKS) + _BLEND
    for key, value in suffixes.items():
        told = told.replace("{" + key + "}", value)
    return "".join(text) + told + "\n"


def _functions(shape: LaneShape) -> Iterator[str]:
    single = shape.precision == "float32"
    f = "f" if single else ""

    def vectorwise(result: str, name: str, arguments: str, expression: str) -> str:
        """A function of single vectors, its arguments' letters marked in `expression`, and one of whole values."""
        kinds = dict(part.split(" ") for part in arguments.split(", "))
        single = ", ".join(f"{VECTORS[kind]} {letter}" for letter, kind in kinds.items())
        head = ", ".join(f"{TYPES[kind]} {letter}" for letter, kind in kinds.items())
        calls = [f"lanes_v_{name}({', '.join(f'{x}.v{k}' for x in kinds)})" for k in range(shape.vectors)]
        return (
            f"td_inline {VECTORS[result]} lanes_v_{name}({single})\n{{\n"
            f"    return {expression.replace('$', '')};\n}}\n\n"
            f"td_inline {TYPES[result]} lanes_{name}({head})\n{{\n"
            f"    return ({TYPES[result]}){{{', '.join(calls)}}};\n}}\n\n"
        )

    def lanewise(result: str, name: str, kinds: Sequence[str], expression: str) -> str:
        """A function that a scalar expression of a, b gives, lane by lane."""
        letters = "ab"[: len(kinds)]
        head = ", ".join(f"{VECTORS[kind]} {letter}" for kind, letter in zip(kinds, letters, strict=True))
        native = (
            f"td_inline {VECTORS[result]} lanes_each_{name}({head})\n{{\n    {VECTORS[result]} y;\n"
            f"    for (int l = 0; l < {shape.each}; l++)\n        y[l] = {expression};\n    return y;\n}}\n\n"
        )
        arguments = ", ".join(f"{letter} {kind}" for kind, letter in zip(kinds, letters, strict=True))
        return native + vectorwise(result, name, arguments, f"lanes_each_{name}({', '.join('$' + x for x in letters)})")

    # the same in all lanes
    for kind in KINDS:
        scalar = C_TYPES[kind]
        value = "-(lanes_one_bool)x" if kind == "bool" else "x"
        one = "{" + ", ".join(["w"] * shape.each) + "}"
        if kind == "bool" and shape.bits:
            value, one = "(lanes_one_bool)-x", "w"
        calls = ", ".join([f"lanes_v_{kind}_all(x)"] * shape.vectors)
        yield (
            f"td_inline {VECTORS[kind]} lanes_v_{kind}_all({scalar} x)\n{{\n    const lanes_one_{kind} w = {value};\n"
            f"    return ({VECTORS[kind]}){one};\n}}\n\n"
            f"td_inline {TYPES[kind]} lanes_{kind}_all({scalar} x)\n{{\n"
            f"    return ({TYPES[kind]}){{{calls}}};\n}}\n\n"
        )
    # reals
    for name in ("add", "sub", "mul", "div"):
        yield vectorwise("real", f"{name}_real", "a real, b real", _scalar(f"{name}_real", "$a", "$b"))
    yield vectorwise("real", "neg_real", "a real", _scalar("neg_real", "$a"))
    magnitude = "0x7fffffffu" if single else "UINT64_C(0x7fffffffffffffff)"
    yield vectorwise("real", "abs_real", "a real", f"(lanes_r)((lanes_w)$a & {magnitude})")
    yield (
        f"td_inline lanes_r lanes_root(lanes_r x)\n{{\n    lanes_one_real e[{shape.each}]"
        f" __attribute__((aligned({shape.size})));\n    memcpy(e, &x, sizeof x);\n"
        f"    for (int l = 0; l < {shape.each}; l++)\n        e[l] = __builtin_sqrt{f}(e[l]);\n"
        f"    memcpy(&x, e, sizeof x);\n    return x;\n}}\n\n"
    )
    yield vectorwise("real", "sqrt_real", "a real", "lanes_root($a)")
    # x86's minimum and maximum are a < b ? a : b and a > b ? a : b, of NaNs and zeros too
    yield vectorwise("real", "min_real", "a real, b real", "lanes_least($a, $b)")
    yield vectorwise("real", "max_real", "a real, b real", "lanes_most($a, $b)")
    # comparisons
    for name, test in _TESTS.items():
        yield vectorwise("bool", f"{name}_real", "a real, b real", f"lanes_test_r($a, {test}, $b)")
        if name not in ("gt", "ge"):
            for kind in ("int32", "uint32"):
                tested = f"lanes_test_{kind[0]}($a, {test}, $b)"
                yield vectorwise("bool", f"{name}_{kind}", f"a {kind}, b {kind}", tested)
    # truth values
    for name, text in (
        ("and", "$a & $b"),
        ("or", "$a | $b"),
        ("xor", "$a ^ $b"),
        ("ne", "$a ^ $b"),
        ("eq", "~($a ^ $b)"),
    ):
        yield vectorwise("bool", f"{name}_bool", "a bool, b bool", f"(lanes_m)({text})")
    yield vectorwise("bool", "not_bool", "a bool", "(lanes_m)~$a")
    # choices
    yield vectorwise("real", "pick_real", "c bool, a real, b real", "lanes_blend_r($c, $a, $b)")
    yield vectorwise("bool", "pick_bool", "c bool, a bool, b bool", "lanes_blend_m($c, $a, $b)")
    for kind in ("int32", "uint32"):
        v = VECTORS[kind]
        yield (
            f"td_inline {v} lanes_blend_{v[-1]}(lanes_m c, {v} a, {v} b)\n{{\n    const {v} m = ({v})lanes_i_of_m(c);\n"
            f"    return (m & a) | (~m & b);\n}}\n\n"
        )
        yield vectorwise(kind, f"pick_{kind}", f"c bool, a {kind}, b {kind}", f"lanes_blend_{v[-1]}($c, $a, $b)")
    # integers
    for kind in ("int32", "uint32"):
        v = VECTORS[kind]
        # What wraps around is done without a sign.
        wrapped = {
            op: f"({v})({_scalar(f'{op}_uint32', '(lanes_u)$a', '(lanes_u)$b')})" for op in ("add", "sub", "mul", "shl")
        }
        for name in ("add", "sub", "mul"):
            yield vectorwise(kind, f"{name}_{kind}", f"a {kind}, b {kind}", wrapped[name])
        yield vectorwise(kind, f"neg_{kind}", f"a {kind}", f"({v})({_scalar('neg_uint32', '(lanes_u)$a')})")
        for name in BITWISE:
            yield vectorwise(kind, f"{name}_{kind}", f"a {kind}, b {kind}", _scalar(f"{name}_{kind}", "$a", "$b"))
        yield vectorwise(kind, f"not_{kind}", f"a {kind}", _scalar(f"not_{kind}", "$a"))
        yield vectorwise(kind, f"shl_{kind}", f"a {kind}, b {kind}", wrapped["shl"])
        yield vectorwise(kind, f"shr_{kind}", f"a {kind}, b {kind}", f"$a >> ({v})((lanes_u)$b & 31u)")
        for name in ("quot", "rem"):
            yield lanewise(kind, f"{name}_{kind}", (kind, kind), f"{kind}_{name}(a[l], b[l])")
    yield vectorwise(
        "int32", "abs_int32", "a int32", "(lanes_i)(((lanes_u)$a ^ (lanes_u)($a < 0)) - (lanes_u)($a < 0))"
    )
    yield vectorwise("uint32", "abs_uint32", "a uint32", "$a")
    yield _high(shape)
    yield vectorwise("uint32", "mulhi_uint32", "a uint32, b uint32", "lanes_high($a, $b)")
    yield from _conversions(shape, vectorwise, lanewise)
    yield from _memory(shape)


def _high(shape: LaneShape) -> str:
    """The high words of products: those of the even and of the odd elements."""
    size = shape.each * 4
    bits = size * 8
    prefix = "_mm" if bits == 128 else f"_mm{bits}"
    needs = "__AVX512F__" if bits == 512 else "__AVX2__"
    told = bits >= 128
    text = "    const lanes_d low = (lanes_d){0} + 0xffffffffu;\n"
    text += "    const lanes_d even = (x & low) * (y & low), odd = (x >> 32) * (y >> 32);\n"
    if told:
        text = (
            f"#if defined({needs})\n"
            f"    const lanes_d even = (lanes_d){prefix}_mul_epu32((__m{bits}i)x, (__m{bits}i)y);\n"
            f"    const lanes_d odd = (lanes_d){prefix}_mul_epu32((__m{bits}i)(x >> 32), (__m{bits}i)(y >> 32));\n"
            f"#else\n{text}#endif\n"
        )
    return (
        f"typedef uint64_t lanes_d __attribute__((vector_size({size}), aligned({size}), may_alias));\n"
        "td_inline lanes_u lanes_high(lanes_u a, lanes_u b)\n{\n"
        f"    const lanes_d x = (lanes_d)a, y = (lanes_d)b;\n{text}"
        "    return (lanes_u)((even >> 32) | (odd >> 32 << 32));\n}\n\n"
    )


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
        yield (
            f"td_inline {v} lanes_real_{v[-1]}(lanes_r x)\n{{\n"
            f"    const lanes_r low = lanes_v_real_all({low}), high = lanes_v_real_all({high});\n"
            "    const lanes_m above = lanes_v_ge_real(x, high), below = lanes_v_le_real(x, low);\n"
            "    const lanes_m inside = lanes_v_and_bool(lanes_v_gt_real(x, low), lanes_v_not_bool(above));\n"
            f"    const {v} y = {v}_of_r(lanes_only_r(inside, x));\n"
            f"    return y | (({v})lanes_i_of_m(above) & {most}) | (({v})lanes_i_of_m(below) & {least});\n}}\n\n"
        )
        yield vectorwise(kind, f"real_to_{kind}", "a real", f"lanes_real_{v[-1]}($a)")
        yield vectorwise("real", f"{kind}_to_real", f"a {kind}", f"lanes_r_of_{v[-1]}($a)")
        yield vectorwise(kind, f"bool_to_{kind}", "a bool", f"({v})lanes_i_of_m($a) & 1")
    yield vectorwise("real", "bool_to_real", "a bool", "lanes_only_r($a, (lanes_r){0} + 1)")
    yield vectorwise("int32", "uint32_to_int32", "a uint32", "(lanes_i)$a")
    yield vectorwise("uint32", "int32_to_uint32", "a int32", "(lanes_u)$a")
    if single:
        nan = "lanes_blend_u(lanes_v_ne_real($a, $a), (lanes_u){0} + 0x7fc00000u, (lanes_u)$a)"
        yield vectorwise("uint32", "word_0", "a real", nan)
        yield vectorwise("uint32", "word_1", "a real", "(lanes_u)((lanes_w)$a & 0u)")
        yield lanewise("real", "from_bits", ("uint32", "uint32"), "real_from_bits(a[l], b[l])")
        yield vectorwise("real", "from_word", "a uint32", "(lanes_r)$a")
        return
    yield (
        "td_inline lanes_w lanes_bits(lanes_r x)\n{\n"
        "    const lanes_w quiet = (lanes_w){0} + UINT64_C(0x7ff8000000000000);\n"
        "    return (lanes_w)lanes_blend_r(lanes_v_eq_real(x, x), x, (lanes_r)quiet);\n}\n\n"
    )
    yield vectorwise("uint32", "word_0", "a real", "lanes_u_of_w(lanes_bits($a))")
    yield vectorwise("uint32", "word_1", "a real", "lanes_u_of_w(lanes_bits($a) >> 32)")
    yield vectorwise(
        "real",
        "from_bits",
        "a uint32, b uint32",
        "(lanes_r)(lanes_w_of_u($b) << 32 | lanes_w_of_u($a))",
    )
    yield lanewise("real", "from_word", ("uint32",), "real_from_word(a[l])")


def _memory(shape: LaneShape) -> Iterator[str]:
    """Elements of arrays at an index of each lane's own, and whether anything holds anywhere."""
    n = shape.lanes
    yield (
        "td_inline lanes_i lanes_within(lanes_i i, int32_t last)\n{\n"
        "    const lanes_i low = i & ~(i < 0), over = low > last;\n"
        "    return (over & last) | (~over & low);\n}\n\n"
        "td_inline lanes_int32 lanes_clamp_index(lanes_int32 i, int32_t last)\n{\n"
        f"    return (lanes_int32){{{', '.join(f'lanes_within(i.v{k}, last)' for k in range(shape.vectors))}}};\n}}\n\n"
    )
    bits = shape.each * 32
    words = bits // 64
    others = " | ".join(f"(i.v{k} ^ first)" for k in range(shape.vectors))
    told = {
        512: ("__AVX512F__", "_mm512_test_epi64_mask((__m512i)differ, (__m512i)differ) == 0"),
        256: ("__AVX2__", "_mm256_testz_si256((__m256i)differ, (__m256i)differ)"),
        128: ("__AVX2__", "_mm_testz_si128((__m128i)differ, (__m128i)differ)"),
    }
    either = " | ".join(f"d[{w}]" for w in range(words))
    plain = f"    uint64_t d[{words}];\n    memcpy(d, &differ, sizeof d);\n    return ({either}) == 0u;\n"
    if bits in told:
        plain = f"#if defined({told[bits][0]})\n    return {told[bits][1]};\n#else\n{plain}#endif\n"
    yield "/* seldom called: does not stand in the way of what is called often */\n"
    yield "#define LANES_APART static __attribute__((noinline, cold, unused))\n\n"
    yield (
        "/* Delay lines of all lanes mostly stand at the same place. */\n"
        f"td_inline bool lanes_same(lanes_int32 i)\n{{\n    const int32_t first = i.v0[0];\n"
        f"    const lanes_i differ = {others};\n{plain}}}\n\n"
    )
    each = shape.each
    on = f"((const lanes_one_bool *)c)[{'l / ' + str(each) if shape.bits else 'l'}]"
    if shape.bits:
        on += f" >> l % {each} & 1"
    for kind in KINDS:
        one, whole = f"lanes_one_{kind}", TYPES[kind]
        got = f"(({one} *)y)[l] = ((const {one} *)a)[((const lanes_one_int32 *)i)[l] * {n} + l]"
        put = f"(({one} *)a)[((const lanes_one_int32 *)i)[l] * {n} + l] = ((const {one} *)x)[l]"
        begun = ""
        if kind == "bool" and shape.bits:
            begun = "    *y = *a;\n"
            got = "lanes_copy_bit(y, &a[((const lanes_one_int32 *)i)[l]], l)"
            put = "lanes_copy_bit(&a[((const lanes_one_int32 *)i)[l]], x, l)"
            yield (
                "/* one lane's of several truth values */\n"
                "td_inline void lanes_copy_bit(lanes_bool *to, const lanes_bool *from, int l)\n{\n"
                f"    const lanes_m bit = (lanes_m)(1u << l % {each}), old = ((const lanes_m *)to)[l / {each}];\n"
                f"    const lanes_m new = ((const lanes_m *)from)[l / {each}];\n"
                f"    ((lanes_m *)to)[l / {each}] = (lanes_m)((old & ~bit) | (new & bit));\n}}\n\n"
            )
        fetched = f"    for (int l = 0; l < {n}; l++)\n        {got};\n"
        if kind == "real" and shape.bits:
            fetched = f"#if defined(__AVX512F__)\n{_gathered(shape)}#else\n{fetched}#endif\n"
        yield (
            f"LANES_APART void lanes_apart_get_{kind}({whole} *y, const {whole} *a, const lanes_int32 *i)\n{{\n"
            f"{begun}{fetched}}}\n\n"
            f"/* a[i], of each lane its own */\n"
            f"td_inline {whole} lanes_get_{kind}(const {whole} *a, lanes_int32 i)\n{{\n"
            f"    if (lanes_same(i))\n        return a[i.v0[0]];\n"
            f"    const lanes_int32 at = i;\n    {whole} y;\n    lanes_apart_get_{kind}(&y, a, &at);\n"
            "    return y;\n}\n\n"
        )
        yield (
            f"LANES_APART void lanes_apart_put_{kind}("
            f"{whole} *a, const lanes_int32 *i, const {whole} *x, const lanes_bool *c)\n{{\n"
            f"    for (int l = 0; l < {n}; l++)\n"
            f"        if ({on})\n            {put};\n}}\n\n"
            f"/* a[i] = x where c */\n"
            f"td_inline void lanes_put_{kind}({whole} *a, lanes_int32 i, {whole} x, lanes_bool c)\n{{\n"
            f"    if (lanes_same(i)) {{\n        a[i.v0[0]] = lanes_pick_{kind}(c, x, a[i.v0[0]]);\n"
            "        return;\n    }\n"
            f"    const lanes_int32 at = i;\n    const {whole} value = x;\n    const lanes_bool on = c;\n"
            f"    lanes_apart_put_{kind}(a, &at, &value, &on);\n}}\n\n"
        )
    yield (
        "td_inline bool lanes_any(lanes_bool c)\n{\n    lanes_one_bool any = 0;\n"
        f"    for (int l = 0; l < {n // each if shape.bits else n}; l++)\n"
        "        any |= ((const lanes_one_bool *)&c)[l];\n    return any;\n}\n\n"
    )


def _gathered(shape: LaneShape) -> str:
    """Reals at an index of each lane's own, as AVX-512 fetches them."""
    how, whole, word = ("ps", 512, 4) if shape.precision == "float32" else ("pd", 256, 8)
    text = f"    const lanes_i lane = {{{', '.join(str(l) for l in range(shape.each))}}};\n"
    for k in range(shape.vectors):
        at = f"(__m{whole}i)(i->v{k} * {shape.lanes} + (lane + {k * shape.each}))"
        text += f"    y->v{k} = (lanes_r)_mm512_i32gather_{how}({at}, a, {word});\n"
    return text
