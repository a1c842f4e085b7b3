/* The flight code: estimator, level hold, cascade, mixer. */
/* F P F' + Q; `slope` is the derivative of the acceleration by the pitch. */
static inline Covariance predicted(const Covariance *p, const Derived *c, real slope)
{
    const real v_t = slope * SAMPLE, x_t = v_t * SAMPLE / 2;
    const real tt = p->tt - SAMPLE * p->tb, tb = p->tb - SAMPLE * p->bb, tx = p->tx - SAMPLE * p->bx,
               tv = p->tv - SAMPLE * p->bv;
    const real xt = x_t * p->tt + p->tx + SAMPLE * p->tv, xx = x_t * p->tx + p->xx + SAMPLE * p->xv,
               xv = x_t * p->tv + p->xv + SAMPLE * p->vv;
    const real vt = v_t * p->tt + p->tv, vv = v_t * p->tv + p->vv;
    return (Covariance){
        .tt = tt - SAMPLE * tb + c->gyro_q,
        .tb = tb,
        .tx = x_t * tt + tx + SAMPLE * tv,
        .tv = v_t * tt + tv,
        .bb = p->bb + c->walk_q,
        .bx = x_t * p->tb + p->bx + SAMPLE * p->bv,
        .bv = v_t * p->tb + p->bv,
        .xx = x_t * xt + xx + SAMPLE * xv + c->q_xx,
        .xv = v_t * xt + xv + c->q_xv,
        .vv = v_t * vt + vv + c->q_vv,
    };
}

/* One scalar measurement: t, b, x, v is P h', the variance that of the innovation. */
static inline void corrected(Loop *l, real t, real b, real x, real v, real variance, real innovation)
{
    Covariance *p = &l->spread;
    const real per_variance = 1 / variance;
    const real k_t = t * per_variance, k_b = b * per_variance, k_x = x * per_variance, k_v = v * per_variance;
    l->pitch += k_t * innovation;
    l->bias += k_b * innovation;
    l->x += k_x * innovation;
    l->v += k_v * innovation;
    p->tt -= k_t * t;
    p->tb -= k_t * b;
    p->tx -= k_t * x;
    p->tv -= k_t * v;
    p->bb -= k_b * b;
    p->bx -= k_b * x;
    p->bv -= k_b * v;
    p->xx -= k_x * x;
    p->xv -= k_x * v;
    p->vv -= k_v * v;
}

static inline void estimate(Loop *l)
{
    Covariance *p = &l->spread;
    if (l->started)
        l->pitch += (l->y.gyro_y - l->bias) * SAMPLE;
    else
        l->pitch = atan2(l->y.acc_x, -l->y.acc_z);
    const real sine = sin(l->pitch), cosine = cos(l->pitch);
    const real acceleration = cosine * l->y.acc_x + sine * l->y.acc_z, slope = cosine * l->y.acc_z - sine * l->y.acc_x;
    if (l->started) {
        l->x += (l->v + SAMPLE / 2 * acceleration) * SAMPLE;
        l->v += acceleration * SAMPLE;
        *p = predicted(p, &l->c, slope);
        const real t = slope * p->tt, b = slope * p->tb, x = slope * p->tx, v = slope * p->tv;
        corrected(l, t, b, x, v, slope * t + l->c.gravity_r, -acceleration);
    }
    if (l->dist_new) {
        const real age = l->p.rig_tof_stamp, half = age * age / 2, h_t = slope * half;
        const real innovation = l->y.dist - RAIL_CENTRE - (l->x - l->v * age + acceleration * half);
        const real t = h_t * p->tt + p->tx - age * p->tv, b = h_t * p->tb + p->bx - age * p->bv;
        const real x = h_t * p->tx + p->xx - age * p->xv, v = h_t * p->tv + p->xv - age * p->vv;
        corrected(l, t, b, x, v, h_t * t + x - age * v + l->c.range_r, innovation);
    }
    l->started = 1;
    l->y.theta = l->pitch;
    l->y.q = l->y.gyro_y - l->bias;
}

/* One term of a compensated sum (Kahan, 1965). */
static inline void accumulate(real *sum, real *carry, real increment)
{
    const real term = increment - *carry, total = *sum + term;
    *carry = (total - *sum) - term;
    *sum = total;
}

static inline void control(Loop *l, const Setpoints *set)
{
    const Parameters *p = &l->p;
    const int mode = set->mode, thrusting = mode >= VELOCITY || (mode >= RATE && set->thrust > 0);
    const int reset = !thrusting || l->armed < p->flight_arming_samples;
    l->armed = thrusting ? l->armed < p->flight_arming_samples ? l->armed + 1 : l->armed : 0;

    real x0 = mode >= VELOCITY ? l->x_published : 0, v0 = set->v0, theta0 = mode == ATTITUDE ? set->theta0 : 0;
    real q0 = set->q0, T = set->thrust;
    if (mode == POSITION) {
        const real limit = p->flight_cascade_position_limit;
        x0 = set->x0;
        v0 = within(p->flight_cascade_position_kp * (x0 - l->x_published), -limit, limit);
    }
    const real velocity_error = v0 - l->v_published;
    if (reset || mode < VELOCITY) {
        l->velocity_sum = l->c.velocity_ki * velocity_error;
        l->velocity_carry = 0;
    } else {
        accumulate(&l->velocity_sum, &l->velocity_carry, l->c.velocity_ki * velocity_error);
    }
    if (mode >= VELOCITY) {
        const real push = p->flight_cascade_velocity_kp * velocity_error + l->velocity_sum;
        theta0 = -atan(push / (p->flight_cascade_projection_T_bar * p->flight_cascade_projection_eta_T));
        T = p->flight_cascade_projection_T_bar / cos(theta0);
    }
    if (mode != RATE) {
        const real limit = p->flight_cascade_attitude_limit;
        q0 = within(p->flight_cascade_attitude_kp * (theta0 - l->previous_pitch), -limit, limit);
    }
    const real rate_error = q0 - l->y.q;
    if (reset || mode < RATE) {
        l->rate_sum = l->c.rate_ki * rate_error;
        l->rate_carry = 0;
    } else {
        accumulate(&l->rate_sum, &l->rate_carry, l->c.rate_ki * rate_error);
    }
    l->slope = l->c.rate_decay * l->slope + l->c.rate_rise * (rate_error - l->rate_error);
    l->rate_error = rate_error;
    const real limit = p->flight_cascade_rate_limit;
    const real looped = within(
        p->flight_cascade_rate_kp * rate_error + l->rate_sum + p->flight_cascade_rate_kd * l->slope, -limit, limit);
    const real opened = set->M_open + (set->use_trim ? l->trim : 0);
    Outputs *y = &l->y;
    y->M = mode == OFF ? 0 : mode == OPEN_LOOP ? opened : looped;
    y->T = mode == OFF ? 0 : T;
    y->fore = within(y->T + y->M, 0, 1);
    y->aft = within(y->T - y->M, 0, 1);
    y->x0 = x0;
    y->v0 = mode >= VELOCITY ? v0 : 0;
    y->theta0 = theta0;
    y->q0 = q0;
    y->x = l->x_published;
    y->v = l->v_published;
    y->M_trim = l->trim;

    l->held = mode != ATTITUDE || set->thrust <= 0 ? 0 : l->held < LONGEST_HOLD ? l->held + 1 : l->held;
    if (l->held > l->c.settle) {
        const real used = (real)(l->held - l->c.settle), window = l->c.hold_window;
        l->trim += (y->M - l->trim) / (used < window ? used : window);
    }
}

/* What is published at a sample, at 100 Hz, is read from the next one on; so is the pitch. */
static inline void publish(Loop *l)
{
    l->previous_pitch = l->pitch;
    l->publisher += 2;
    if (l->publisher >= 5) {
        l->publisher -= 5;
        l->x_published = l->x;
        l->v_published = l->v;
    }
}
