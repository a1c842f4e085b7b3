/* Noise. COUNTER gives the numbers of twodof.blocks.noise, which depend on (seed, stream, tick) alone; SILENT gives
   zeros. By default: the generator xoshiro256++ (Blackman and Vigna, 2019) under a ziggurat of 128 layers (Marsaglia and Tsang,
   2000), in double precision; parentheses around a function's name keep it from becoming float. */
#if defined(SILENT) || defined(COUNTER)
#ifdef SINGLE
#define log(x) logf(x)
#endif

typedef struct {
    uint64_t a, b, c, d; /* by COUNTER: a is the seed */
    real sample[5];
    int drawn;
} Generator;

static void ziggurat_tables(void)
{
}

static inline void philox(uint32_t seed, uint32_t stream, uint32_t tick, uint32_t x[4])
{
    x[0] = tick;
    x[1] = x[2] = x[3] = 0;
    for (int i = 0; i < 10; i++) {
        const uint64_t left = (uint64_t)0xd2511f53u * x[0], right = (uint64_t)0xcd9e8d57u * x[2];
        x[0] = (uint32_t)(right >> 32) ^ x[1] ^ seed;
        x[1] = (uint32_t)right;
        x[2] = (uint32_t)(left >> 32) ^ x[3] ^ stream;
        x[3] = (uint32_t)left;
        seed += 0x9e3779b9u;
        stream += 0xbb67ae85u;
    }
}

/* All normals of a sample (Box and Muller, 1958): four of the sensors, one of the gust. */
static inline void draw(Generator *g, uint32_t tick)
{
#ifdef COUNTER
    uint32_t x[4];
    philox((uint32_t)g->a, 1, tick, x);
    for (int i = 0; i < 4; i += 2) {
        const real radius = sqrt(-2 * log(((real)x[i] + R(0.5)) * R(0x1p-32)));
        const real angle = (real)(int32_t)x[i + 1] * R(3.141592653589793 * 0x1p-31);
        g->sample[i] = radius * cos(angle);
        g->sample[i + 1] = radius * sin(angle);
    }
    philox((uint32_t)g->a, 2, tick, x);
    const real radius = sqrt(-2 * log(((real)x[0] + R(0.5)) * R(0x1p-32)));
    g->sample[4] = radius * cos((real)(int32_t)x[1] * R(3.141592653589793 * 0x1p-31));
    g->drawn = 0;
#endif
}

static inline real normal(Generator *g)
{
#ifdef COUNTER
    return g->sample[g->drawn++];
#else
    (void)g;
    return 0;
#endif
}
#else
static inline void draw(void *g, uint32_t tick)
{
    (void)g;
    (void)tick;
}

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
#endif
