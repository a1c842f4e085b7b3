/* The C of lanes by parts, each behind four slashes and its name; helpers.py fills in the fields and chooses. */
//// conversions
/* Between vectors of reals and integers, whole and half width; gcc 12 does it in halves untold. */
#if defined(__AVX512DQ__) && LANES_BYTES == 64
#define lanes_r_of_i(x) ((lanes_r)_mm512_cvtepi32_${ps}((__m${n}i)(x)))
#define lanes_r_of_u(x) ((lanes_r)_mm512_cvtepu32_${ps}((__m${n}i)(x)))
#define lanes_i_of_r(x) ((lanes_i)_mm512_cvtt${ps}_epi32((__m512${d})(x)))
#define lanes_u_of_r(x) ((lanes_u)_mm512_cvtt${ps}_epu32((__m512${d})(x)))
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
//// vector_masks
/* Masks are vectors as wide as reals; of integers, as wide as those. */
#define lanes_test_r(a, sign, how, b) ((lanes_m)((a) sign (b)))
#define lanes_test_i(a, sign, how, b) lanes_m_of_i((a) sign (b))
#define lanes_test_u(a, sign, how, b) lanes_m_of_i((a) sign (b))
#define lanes_m_of_i(x) ${wide}
#define lanes_i_of_m(x) ${narrow}
#define lanes_only_r(c, a) ((lanes_r)((c) & (lanes_m)(a)))
//// bit_masks
/* Masks are bits. */
#if defined(__AVX512DQ__) && defined(__AVX512VL__)
#define lanes_test_r(a, sign, how, b) ((lanes_m)_mm512_cmp_${ps}_mask((__m512${d})(a), (__m512${d})(b), _CMP_##how))
#define lanes_test_i(a, sign, how, b) ((lanes_m)_mm${n}_cmp_epi32_mask((__m${n}i)(a), (__m${n}i)(b), lanes_how_##how))
#define lanes_test_u(a, sign, how, b) ((lanes_m)_mm${n}_cmp_epu32_mask((__m${n}i)(a), (__m${n}i)(b), lanes_how_##how))
#define lanes_how_LT_OQ _MM_CMPINT_LT
#define lanes_how_LE_OQ _MM_CMPINT_LE
#define lanes_how_EQ_OQ _MM_CMPINT_EQ
#define lanes_how_NEQ_UQ _MM_CMPINT_NE
#define lanes_i_of_m(x) ((lanes_i)_mm${n}_movm_epi32(x))
#define lanes_only_r(c, a) ((lanes_r)_mm512_maskz_mov_${ps}(c, (__m512${d})(a)))
#define lanes_blend_r(c, a, b) ((lanes_r)_mm512_mask_blend_${ps}(c, (__m512${d})(b), (__m512${d})(a)))
#else
td_inline lanes_m lanes_signs(lanes_f x)
{
    lanes_m y = 0;
    for (int l = 0; l < ${each}; l++)
        y = (lanes_m)(y | (x[l] < 0 ? 1u << l : 0u));
    return y;
}

td_inline lanes_f lanes_f_of_m(lanes_m x)
{
    lanes_f y;
    for (int l = 0; l < ${each}; l++)
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
//// choices
/* a where c, else b; `only`: else 0 */
#if defined(__AVX2__) && LANES_BYTES == 32
#define lanes_blend_r(c, a, b) ((lanes_r)_mm256_blendv_${ps}((__m256${d})(b), (__m256${d})(a), (__m256${d})(c)))
#elif LANES_BYTES < 64
#define lanes_blend_r(c, a, b) ((lanes_r)(((c) & (lanes_m)(a)) | (~(c) & (lanes_m)(b))))
#endif
#if defined(__AVX512F__) && LANES_BYTES == 64
#define lanes_least(a, b) ((lanes_r)_mm512_min_${ps}((__m512${d})(a), (__m512${d})(b)))
#define lanes_most(a, b) ((lanes_r)_mm512_max_${ps}((__m512${d})(a), (__m512${d})(b)))
#elif defined(__AVX2__) && LANES_BYTES == 32
#define lanes_least(a, b) ((lanes_r)_mm256_min_${ps}((__m256${d})(a), (__m256${d})(b)))
#define lanes_most(a, b) ((lanes_r)_mm256_max_${ps}((__m256${d})(a), (__m256${d})(b)))
#else
#define lanes_least(a, b) lanes_blend_r(lanes_test_r(a, <, LT_OQ, b), a, b)
#define lanes_most(a, b) lanes_blend_r(lanes_test_r(a, >, GT_OQ, b), a, b)
#endif
#define lanes_blend_m(c, a, b) ((lanes_m)(((c) & (a)) | (~(c) & (b))))
//// same_in_all
td_inline ${vector} lanes_v_${kind}_all(${scalar} x)
{
    const lanes_one_${kind} w = ${value};
    return (${vector})${one};
}

td_inline ${whole} lanes_${kind}_all(${scalar} x)
{
    return (${whole}){${calls}};
}

//// root
td_inline lanes_r lanes_root(lanes_r x)
{
    lanes_one_real e[${each}] __attribute__((aligned(${size})));
    memcpy(e, &x, sizeof x);
    for (int l = 0; l < ${each}; l++)
        e[l] = __builtin_sqrt${f}(e[l]);
    memcpy(&x, e, sizeof x);
    return x;
}

//// high
typedef uint64_t lanes_d __attribute__((vector_size(${size}), aligned(${size}), may_alias));
td_inline lanes_u lanes_high(lanes_u a, lanes_u b)
{
    const lanes_d x = (lanes_d)a, y = (lanes_d)b;
${products}    return (lanes_u)((even >> 32) | (odd >> 32 << 32));
}

//// saturating
td_inline ${v} lanes_real_${letter}(lanes_r x)
{
    const lanes_r low = lanes_v_real_all(${low}), high = lanes_v_real_all(${high});
    const lanes_m above = lanes_v_ge_real(x, high), below = lanes_v_le_real(x, low);
    const lanes_m inside = lanes_v_and_bool(lanes_v_gt_real(x, low), lanes_v_not_bool(above));
    const ${v} y = ${v}_of_r(lanes_only_r(inside, x));
    return y | ((${v})lanes_i_of_m(above) & ${most}) | ((${v})lanes_i_of_m(below) & ${least});
}

//// bits
td_inline lanes_w lanes_bits(lanes_r x)
{
    const lanes_w quiet = (lanes_w){0} + UINT64_C(0x7ff8000000000000);
    return (lanes_w)lanes_blend_r(lanes_v_eq_real(x, x), x, (lanes_r)quiet);
}

//// indices
td_inline lanes_i lanes_within(lanes_i i, int32_t last)
{
    const lanes_i low = i & ~(i < 0), over = low > last;
    return (over & last) | (~over & low);
}

td_inline lanes_int32 lanes_clamp_index(lanes_int32 i, int32_t last)
{
    return (lanes_int32){${within}};
}

/* seldom called: does not stand in the way of what is called often */
#define LANES_APART static __attribute__((noinline, cold, unused))

/* Delay lines of all lanes mostly stand at the same place. */
td_inline bool lanes_same(lanes_int32 i)
{
    const int32_t first = i.v0[0];
    const lanes_i differ = ${others};
${compared}}

//// copy_bit
/* one lane's of several truth values */
td_inline void lanes_copy_bit(lanes_bool *to, const lanes_bool *from, int l)
{
    const lanes_m bit = (lanes_m)(1u << l % ${each}), old = ((const lanes_m *)to)[l / ${each}];
    const lanes_m new = ((const lanes_m *)from)[l / ${each}];
    ((lanes_m *)to)[l / ${each}] = (lanes_m)((old & ~bit) | (new & bit));
}

//// elements
LANES_APART void lanes_apart_get_${kind}(${whole} *y, const ${whole} *a, const lanes_int32 *i)
{
${fetched}}

/* a[i], of each lane its own */
td_inline ${whole} lanes_get_${kind}(const ${whole} *a, lanes_int32 i)
{
    if (lanes_same(i))
        return a[i.v0[0]];
    const lanes_int32 at = i;
    ${whole} y;
    lanes_apart_get_${kind}(&y, a, &at);
    return y;
}

LANES_APART void lanes_apart_put_${kind}(${whole} *a, const lanes_int32 *i, const ${whole} *x, const lanes_bool *c)
{
    for (int l = 0; l < ${lanes}; l++)
        if (${on})
            ${put};
}

/* a[i] = x where c */
td_inline void lanes_put_${kind}(${whole} *a, lanes_int32 i, ${whole} x, lanes_bool c)
{
    if (lanes_same(i)) {
        a[i.v0[0]] = lanes_pick_${kind}(c, x, a[i.v0[0]]);
        return;
    }
    const lanes_int32 at = i;
    const ${whole} value = x;
    const lanes_bool on = c;
    lanes_apart_put_${kind}(a, &at, &value, &on);
}

//// any
td_inline bool lanes_any(lanes_bool c)
{
    lanes_one_bool any = 0;
    for (int l = 0; l < ${masks}; l++)
        any |= ((const lanes_one_bool *)&c)[l];
    return any;
}

