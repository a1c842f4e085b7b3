/* Noise: the generator xoshiro256++ (Blackman and Vigna, 2019) under a ziggurat of 128 layers (Marsaglia and Tsang,
   2000), in double precision; parentheses around a function's name keep it from becoming float. */
#define LAYERS 128
#define TAIL 3.442619855899      /* right edge of the lowest layer's rectangle */
#define AREA 9.91256303526217e-3 /* of each layer */

static double edge[LAYERS + 1], ratio[LAYERS];

static void ziggurat_tables(void)
{
    double density = (exp)(-0.5 * TAIL * TAIL);
    edge[0] = AREA / density;
    edge[1] = TAIL;
    for (int i = 2; i < LAYERS; i++) {
        edge[i] = (sqrt)(-2 * log(AREA / edge[i - 1] + density));
        density = (exp)(-0.5 * edge[i] * edge[i]);
    }
    edge[LAYERS] = 0;
    for (int i = 0; i < LAYERS; i++)
        ratio[i] = edge[i + 1] / edge[i];
}

typedef struct {
    uint64_t a, b, c, d;
} Generator;

static inline uint64_t rotated(uint64_t word, int by)
{
    return word << by | word >> (64 - by);
}

static inline uint64_t word(Generator *g)
{
    const uint64_t result = rotated(g->a + g->d, 23) + g->a, shifted = g->b << 17;
    g->c ^= g->a;
    g->d ^= g->b;
    g->b ^= g->c;
    g->a ^= g->d;
    g->c ^= shifted;
    g->d = rotated(g->d, 45);
    return result;
}

static inline double uniform(Generator *g)
{
    return ((double)(word(g) >> 11) + 0.5) * 0x1p-53;
}

static double unusual(Generator *g, int layer, double share)
{
    for (;;) {
        if (layer == 0) {
            double x, y;
            do {
                x = log(uniform(g)) / TAIL;
                y = log(uniform(g));
            } while (-2 * y < x * x);
            return share < 0 ? x - TAIL : TAIL - x;
        }
        const double z = share * edge[layer];
        const double low = (exp)(-0.5 * (edge[layer] * edge[layer] - z * z));
        const double high = (exp)(-0.5 * (edge[layer + 1] * edge[layer + 1] - z * z));
        if (high + uniform(g) * (low - high) < 1)
            return z;
        const uint64_t bits = word(g);
        layer = bits & (LAYERS - 1);
        share = (double)((int64_t)bits >> 11) * 0x1p-52;
        if ((fabs)(share) < ratio[layer])
            return share * edge[layer];
    }
}

static inline real normal(Generator *g)
{
    const uint64_t bits = word(g);
    const int layer = bits & (LAYERS - 1);
    const double share = (double)((int64_t)bits >> 11) * 0x1p-52;
    if (__builtin_fabs(share) < ratio[layer])
        return (real)(share * edge[layer]);
    return (real)unusual(g, layer, share);
}
