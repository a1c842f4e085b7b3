/* One step of a Kalman filter with N states and M measurements, matrices column after column, as one writes it by hand.
 *
 * x = A x, P = A P A' + Q; then each measurement in turn, as their noises are independent (Grewal, Andrews: Kalman
 * Filtering, 4th ed., 2015, section 5.2): s = h P h' + r, k = P h' / s, x += k (z - h x), P -= k h P.
 */
#include <stddef.h>

typedef struct {
    real A[N * N], Q[N * N], H[M * N], R[M];
} Model;

typedef struct {
    real x[N], P[N * N];
} State;

static void step(const Model *restrict m, State *restrict s, const real *restrict z)
{
    real x[N], AP[N * N], P[N * N], g[N], k[N];
    for (int i = 0; i < N; i++) {
        x[i] = 0;
        for (int l = 0; l < N; l++)
            x[i] += m->A[l * N + i] * s->x[l];
    }
    for (int j = 0; j < N; j++)
        for (int i = 0; i < N; i++) {
            real sum = 0;
            for (int l = 0; l < N; l++)
                sum += m->A[l * N + i] * s->P[j * N + l];
            AP[j * N + i] = sum;
        }
    for (int j = 0; j < N; j++)
        for (int i = 0; i < N; i++) {
            real sum = 0;
            for (int l = 0; l < N; l++)
                sum += AP[l * N + i] * m->A[l * N + j];
            P[j * N + i] = sum + m->Q[j * N + i];
        }
    for (int c = 0; c < M; c++) {
        real innovation = m->R[c], error = z[c];
        for (int i = 0; i < N; i++) {
            g[i] = 0;
            for (int l = 0; l < N; l++)
                g[i] += P[l * N + i] * m->H[l * M + c];
        }
        for (int i = 0; i < N; i++) {
            innovation += m->H[i * M + c] * g[i];
            error -= m->H[i * M + c] * x[i];
        }
        for (int i = 0; i < N; i++) {
            k[i] = g[i] / innovation;
            x[i] += k[i] * error;
        }
        for (int j = 0; j < N; j++)
            for (int i = 0; i < N; i++)
                P[j * N + i] -= k[i] * g[j];
    }
    for (int i = 0; i < N; i++)
        s->x[i] = x[i];
    for (int i = 0; i < N * N; i++)
        s->P[i] = P[i];
}

size_t kalman_size(void)
{
    return sizeof(State);
}

void kalman_run(const real *model, real *state, const real *z, size_t steps)
{
    for (size_t k = 0; k < steps; k++)
        step((const Model *)(const void *)model, (State *)(void *)state, z);
}
