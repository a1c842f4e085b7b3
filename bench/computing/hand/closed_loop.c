/* The closed loop of the virtual rig and its flight code, written by hand: the peer of the compiled diagram.

   The equations, sensor rates and noise amounts are those of twodof.rig and twodof.flight; runs without noise and with
   the same noise are compared with the compiled diagram's. What differs is how a person writes it: branches where the
   language selects, libm, fused multiply-add where the compiler likes, a sequential noise generator, and rotor lines
   that turn a point on the unit circle.

   SINGLE makes `real` float. */
#include "loop.h"

#include "rig.h"

#include "flight.h"

static inline real delayed(const Loop *l, const real *ring)
{
    const int at = l->ring_place - l->c.delay;
    const real late = ring[at & (COMMANDS - 1)], early = ring[(at - 1) & (COMMANDS - 1)];
    return late + l->c.delay_fraction * (early - late);
}

static inline void step(Loop *l, const Setpoints *set, Outputs *y)
{
    const Parameters *p = &l->p;
    if (l->tick % TICKS_PER_BATTERY == 0)
        discharge(l);
    Drive d = {.fore = delayed(l, l->fore_ring),
               .aft = delayed(l, l->aft_ring),
               .supply = l->supply,
               .wake_moment = (p->rig_trim - p->rig_trim_start) * l->wake};
    const Thrust now = thrust_of(l, &d, l->motion.fore, l->motion.aft);
    if (l->tick % TICKS_PER_BATTERY == 0)
        l->battery_load = now.load > 0 ? now.load : 0;
    if (l->tick % TICKS_PER_SAMPLE == 0) {
        draw(&l->noise, l->tick);
        sense_motion(l, &now);
        sense_range(l);
        estimate(l);
        control(l, set);
        publish(l);
        l->gust_moment = p->rig_noise * p->rig_gust * now.load * l->gust;
        l->gust = l->c.gust_keep * l->gust + l->c.gust_fresh * normal(&l->noise);
    }
    l->y.true_theta = l->motion.theta;
    l->y.true_q = l->motion.q;
    l->y.true_x = l->motion.x;
    l->y.true_v = l->motion.v;
    l->y.load = now.load;
    *y = l->y;
    d.gust = l->gust_moment;
    Motion next = integrated(l, &d, &l->motion);
    contacts(l, &d, &now, &next);
    next.fore = next.fore < STILL ? 0 : next.fore;
    next.aft = next.aft < STILL ? 0 : next.aft;
    l->motion = next;
    const real slant = p->rig_wake_fade * l->y.true_theta;
    l->wake += l->c.wake_step * (now.load / (1 + slant * slant) - l->wake);
    l->wake = l->wake < STILL ? 0 : l->wake;
    l->fore_ring[l->ring_place] = l->y.fore;
    l->aft_ring[l->ring_place] = l->y.aft;
    l->ring_place = (l->ring_place + 1) & (COMMANDS - 1);
    l->tick++;
}

static void derive(Loop *l)
{
    const Parameters *p = &l->p;
    Derived *c = &l->c;
    c->mass = p->rig_mass_drone + p->rig_mass_cart;
    c->offset_mass = p->rig_mass_drone * p->rig_offset;
    c->weight = c->offset_mass * GRAVITY;
    c->per_inertia = 1 / p->rig_inertia;
    c->per_mass = 1 / c->mass;
    c->inertia_mass = p->rig_inertia * c->mass;
    const int rings = p->rig_rings != 0;
    c->low = rings ? p->rig_ring_place - p->rig_ring_play : -p->rig_rail_stop;
    c->high = rings ? p->rig_ring_place + p->rig_ring_play : p->rig_rail_stop;
    c->bounce = rings ? 0 : p->rig_rail_bounce;

    const real ticks = p->rig_delay > TICK ? p->rig_delay / TICK : 1;
    c->delay = (int)ticks;
    c->delay_fraction = ticks - (real)c->delay;
    c->direct = p->rig_lag < TICK / 2;
    c->per_lag = c->direct ? 0 : 1 / p->rig_lag;
    c->wake_step = TICK / p->rig_wake_lag;
    c->per_hover = R(0.5) / lift(HOVER, p->rig_curve);

    c->per_capacity = 1 / (3600 * p->rig_capacity);
    c->per_reference = 1 / (p->rig_voltage_full - p->rig_resistance * p->rig_hover_current);
    c->polarise_step = 1 - exp(-BATTERY / p->rig_polarised_time);
    c->gust_keep = exp(-SAMPLE / p->rig_gust_time);
    c->gust_fresh = sqrt(1 - c->gust_keep * c->gust_keep);

    const int noisy = p->rig_noise > 0;
    c->vibration_gain = sqrt(R(0.5) * (1 - p->rig_vibration_r2));
    c->vibration_turn = (1 + p->rig_vibration_r2) * cos(R(6.283185307179586) * p->rig_vibration_hz * SAMPLE);
    c->half_turn = PI * SAMPLE * p->rig_rotor_hz;
    const real seen = fabs(passed(c->half_turn, sin(c->half_turn))), per_seen = 1 / (seen > R(1e-3) ? seen : R(1e-3));
    const real shake = rings ? p->rig_ring_shake : 1;
    c->line_x = p->rig_acc_x_line * shake * per_seen;
    c->line_z = p->rig_acc_z_line * shake * per_seen;
    c->line_q = p->rig_gyro_line * per_seen;
    c->acc_grain = noisy ? p->rig_acc_step : 0;
    c->gyro_grain = noisy ? p->rig_gyro_step : 0;
    c->tof_grain = noisy ? p->rig_tof_step : 0;
    c->tof_advance = (uint32_t)(p->rig_tof_rate * SAMPLE * R(4294967296.0));
    c->tof_back = (int)(p->rig_tof_age / SAMPLE);
    c->tof_fraction = p->rig_tof_age / SAMPLE - (real)c->tof_back;

    const real density = p->flight_estimator_filter_sigma_a * p->flight_estimator_filter_sigma_a;
    c->gyro_q = p->flight_estimator_filter_sigma_gyro * p->flight_estimator_filter_sigma_gyro * SAMPLE;
    c->walk_q = p->flight_estimator_filter_sigma_walk * p->flight_estimator_filter_sigma_walk * SAMPLE;
    c->q_xx = density * SAMPLE * SAMPLE * SAMPLE / 3;
    c->q_xv = density * SAMPLE * SAMPLE / 2;
    c->q_vv = density * SAMPLE;
    c->gravity_r = p->flight_estimator_filter_sigma_gravity * p->flight_estimator_filter_sigma_gravity;
    c->range_r = p->flight_estimator_filter_sigma_range * p->flight_estimator_filter_sigma_range;
    c->settle = (int)(p->flight_hold_settle / SAMPLE + R(0.5));
    c->hold_window = p->flight_hold_window / SAMPLE;
    c->velocity_ki = p->flight_cascade_velocity_ki * SAMPLE;
    c->rate_ki = p->flight_cascade_rate_ki * SAMPLE;
    const real lag = 1 / p->flight_cascade_rate_N;
    c->rate_decay = lag / (lag + SAMPLE);
    c->rate_rise = 1 / (lag + SAMPLE);
}

size_t hand_size(void)
{
    return sizeof(Loop);
}

/* Parameters in the order of `hand_parameters`; the rig at rest where they say, everything else at zero. */
void hand_init(Loop *l, const double *values, uint64_t seed)
{
    memset(l, 0, sizeof *l);
    real *p = (real *)&l->p;
    for (size_t i = 0; hand_parameters[i]; i++)
        p[i] = (real)values[i];
    derive(l);
    ziggurat_tables();
#ifdef COUNTER
    l->noise.a = seed;
#else
    /* splitmix64 (Steele, Lea, Flood, 2014) fills the generator's state. */
    uint64_t *words = &l->noise.a;
    for (int i = 0; i < 4; i++) {
        uint64_t z = seed += 0x9e3779b97f4a7c15u;
        z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
        z = (z ^ z >> 27) * 0x94d049bb133111ebu;
        words[i] = z ^ z >> 31;
    }
#endif
    Motion *m = &l->motion;
    m->theta = l->p.rig_theta_start;
    m->q = l->imu_q = l->p.rig_q_start;
    m->x = l->p.rig_x_start;
    m->v = l->imu_v = l->p.rig_v_start;
    m->sine = sin(m->theta);
    m->cosine = cos(m->theta);
    l->wake = l->p.rig_wake_start;
    l->charge = l->p.rig_charge_start;
    l->polarised = l->p.rig_polarised_start;
    l->fore_phase.cosine = l->aft_phase.cosine = 1;
    l->phase = (uint32_t)(l->p.rig_tof_phase * R(4294967296.0));
    l->y.dist = l->p.rig_x_start + RAIL_CENTRE;
    const Parameters *q = &l->p;
    l->spread.tt = q->flight_estimator_filter_sigma_theta_0 * q->flight_estimator_filter_sigma_theta_0;
    l->spread.bb = q->flight_estimator_filter_sigma_bias_0 * q->flight_estimator_filter_sigma_bias_0;
    l->spread.xx = q->flight_estimator_filter_sigma_x_0 * q->flight_estimator_filter_sigma_x_0;
    l->spread.vv = q->flight_estimator_filter_sigma_v_0 * q->flight_estimator_filter_sigma_v_0;
}

/* n ticks; a stride of 0 writes all outputs to the same place. */
void hand_run(Loop *l, const Setpoints *set, Outputs *y, size_t stride, size_t n)
{
    for (size_t k = 0; k < n; k++)
        step(l, set, y + k * stride);
}
