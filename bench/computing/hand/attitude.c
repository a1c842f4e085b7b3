/* Attitude P and rate PID of the stock cascade at 250 Hz, by hand, in single precision for a Cortex-M7; its
   coefficients are computed in doubles. */
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#define PERIOD 0.004 /* [s] */

typedef struct {
    float attitude_kp, attitude_limit, kp, ki, kd, N, limit;
    float ki_dt, decay, rise; /* follow from the others */
} hand_attitude_P;

typedef struct {
    float sum, carry, slope, error;
} hand_attitude_S;

typedef struct {
    float theta_0, q_0, theta, q;
    bool reset, attitude_enabled;
} hand_attitude_U;

typedef struct {
    float M;
} hand_attitude_Y;

const size_t hand_attitude_sizes[5] = {sizeof(float), sizeof(hand_attitude_P), sizeof(hand_attitude_S),
                                       sizeof(hand_attitude_U), sizeof(hand_attitude_Y)};

static inline float within(float value, float limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

void hand_attitude_defaults(hand_attitude_P *p)
{
    *p = (hand_attitude_P){.attitude_kp = 11.0f, .attitude_limit = 20.0f, .kp = 0.0854f, .ki = 0.251f, .kd = 0.00054f,
                           .N = 100.0f, .limit = 1.0f};
}

void hand_attitude_prepare(hand_attitude_P *p)
{
    const double lag = 1.0 / p->N;
    p->ki_dt = (float)(p->ki * PERIOD);
    p->decay = (float)(lag / (lag + PERIOD));
    p->rise = (float)(1.0 / (lag + PERIOD));
}

void hand_attitude_init(const hand_attitude_P *p, hand_attitude_S *s)
{
    (void)p;
    memset(s, 0, sizeof *s);
}

void hand_attitude_step(const hand_attitude_P *restrict p, hand_attitude_S *restrict s,
                        const hand_attitude_U *restrict u, hand_attitude_Y *restrict y)
{
    float q_0 = u->q_0;
    if (u->attitude_enabled)
        q_0 = within(p->attitude_kp * (u->theta_0 - u->theta), p->attitude_limit);
    const float error = q_0 - u->q, increment = p->ki_dt * error;
    if (u->reset) {
        s->sum = increment;
        s->carry = 0.0f;
    } else { /* compensated sum (Kahan, 1965) */
        const float term = increment - s->carry, total = s->sum + term;
        s->carry = (total - s->sum) - term;
        s->sum = total;
    }
    const float slope = p->decay * s->slope + p->rise * (error - s->error);
    s->slope = slope - slope == 0.0f ? slope : 0.0f; /* never reset, it would stay no number for ever */
    s->error = error;
    y->M = within(p->kp * error + s->sum + p->kd * slope, p->limit);
}
