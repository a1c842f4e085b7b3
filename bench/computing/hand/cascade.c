/* The whole stock cascade at 250 Hz (position, velocity, projection on pitch, attitude, rate), by hand, in single
   precision for a Cortex-M7, with the C library's atanf and cosf. Its
   coefficients are computed in doubles. */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define PERIOD 0.004 /* [s] */

enum { OFF, OPEN_LOOP, RATE, ATTITUDE, VELOCITY, POSITION };

typedef struct {
    float position_kp, position_limit, velocity_kp, velocity_ki, T_bar, eta_T, attitude_kp, attitude_limit;
    float rate_kp, rate_ki, rate_kd, rate_N, rate_limit;
    float velocity_ki_dt, rate_ki_dt, rate_decay, rate_rise; /* follow from the others */
} hand_cascade_P;

typedef struct {
    float velocity_sum, velocity_carry, rate_sum, rate_carry, slope, error;
} hand_cascade_S;

typedef struct {
    int32_t mode;
    bool reset;
    float x0, v0, theta0, q0, thrust, M_open, x, v, theta, q;
} hand_cascade_U;

typedef struct {
    float M, T, q0, theta0, v0, x0;
} hand_cascade_Y;

const size_t hand_cascade_sizes[5] = {sizeof(float), sizeof(hand_cascade_P), sizeof(hand_cascade_S),
                                      sizeof(hand_cascade_U), sizeof(hand_cascade_Y)};

static inline float within(float value, float limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

/* One term of a compensated sum (Kahan, 1965). */
static inline void accumulate(float *sum, float *carry, float increment)
{
    const float term = increment - *carry, total = *sum + term;
    *carry = (total - *sum) - term;
    *sum = total;
}

void hand_cascade_defaults(hand_cascade_P *p)
{
    *p = (hand_cascade_P){.position_kp = 1.5f, .position_limit = 1.0f, .velocity_kp = 2.4f, .velocity_ki = 2.81f,
                          .T_bar = 0.4f, .eta_T = 6.3386f, .attitude_kp = 11.0f, .attitude_limit = 20.0f,
                          .rate_kp = 0.0854f, .rate_ki = 0.251f, .rate_kd = 0.00054f, .rate_N = 100.0f,
                          .rate_limit = 1.0f};
}

void hand_cascade_prepare(hand_cascade_P *p)
{
    const double lag = 1.0 / p->rate_N;
    p->velocity_ki_dt = (float)(p->velocity_ki * PERIOD);
    p->rate_ki_dt = (float)(p->rate_ki * PERIOD);
    p->rate_decay = (float)(lag / (lag + PERIOD));
    p->rate_rise = (float)(1.0 / (lag + PERIOD));
}

void hand_cascade_init(const hand_cascade_P *p, hand_cascade_S *s)
{
    (void)p;
    memset(s, 0, sizeof *s);
}

void hand_cascade_step(const hand_cascade_P *restrict p, hand_cascade_S *restrict s,
                       const hand_cascade_U *restrict u, hand_cascade_Y *restrict y)
{
    const int32_t mode = u->mode;
    float v0 = u->v0, theta0 = mode == ATTITUDE ? u->theta0 : 0.0f, q0 = u->q0, T = u->thrust;
    if (mode == POSITION)
        v0 = within(p->position_kp * (u->x0 - u->x), p->position_limit);
    const float velocity_error = v0 - u->v, push = p->velocity_ki_dt * velocity_error;
    if (u->reset || mode < VELOCITY) {
        s->velocity_sum = push;
        s->velocity_carry = 0.0f;
    } else {
        accumulate(&s->velocity_sum, &s->velocity_carry, push);
    }
    if (mode >= VELOCITY) {
        theta0 = -atanf((p->velocity_kp * velocity_error + s->velocity_sum) / (p->T_bar * p->eta_T));
        T = p->T_bar / cosf(theta0);
    }
    if (mode != RATE)
        q0 = within(p->attitude_kp * (theta0 - u->theta), p->attitude_limit);
    const float error = q0 - u->q, increment = p->rate_ki_dt * error;
    if (u->reset || mode < RATE) {
        s->rate_sum = increment;
        s->rate_carry = 0.0f;
    } else {
        accumulate(&s->rate_sum, &s->rate_carry, increment);
    }
    const float slope = p->rate_decay * s->slope + p->rate_rise * (error - s->error);
    s->slope = slope - slope == 0.0f ? slope : 0.0f; /* never reset, it would stay no number for ever */
    s->error = error;
    const float M = within(p->rate_kp * error + s->rate_sum + p->rate_kd * slope, p->rate_limit);
    y->M = mode == OFF ? 0.0f : mode == OPEN_LOOP ? u->M_open : M;
    y->T = mode == OFF ? 0.0f : T;
    y->q0 = q0;
    y->theta0 = theta0;
    y->v0 = mode >= VELOCITY ? v0 : 0.0f;
    y->x0 = mode == POSITION ? u->x0 : mode == VELOCITY ? u->x : 0.0f;
}
