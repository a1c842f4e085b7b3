/* The rig: rotors, dynamics, contacts, sensors, battery. */
static inline real lift(real speed, real curve)
{
    return speed * (1 - curve + curve * speed);
}

/* What acts on the rig during one tick. */
typedef struct {
    real fore, aft, supply, gust, wake_moment;
} Drive;

typedef struct {
    real thrust, moment, running, load, load_fore, load_aft;
} Thrust;

static inline Thrust thrust_of(const Loop *l, const Drive *d, real fore, real aft)
{
    const Parameters *p = &l->p;
    if (l->c.direct) {
        fore = d->fore;
        aft = d->aft;
    }
    const real up_fore = lift(fore, p->rig_curve) * d->supply, up_aft = lift(aft, p->rig_curve) * d->supply;
    const real load = (up_fore + up_aft) * l->c.per_hover, speed = (fore + aft) * (R(0.5) / HOVER);
    return (Thrust){
        .thrust = p->rig_pair_thrust * (up_fore + up_aft),
        .moment = p->rig_arm * p->rig_pair_thrust * (up_fore - up_aft) + load * (p->rig_trim_start + d->wake_moment),
        .running = speed < 1 ? speed : 1,
        .load = load,
        .load_fore = 2 * up_fore * l->c.per_hover,
        .load_aft = 2 * up_aft * l->c.per_hover,
    };
}

/* Whether a body stays at rest: stuck, or pressed against a stop. */
static inline int holds(real speed, real load, real friction, real place, real low, real high)
{
    if (speed != 0)
        return 0;
    return fabs(load) <= friction || (place >= high && load > 0) || (place <= low && load < 0);
}

static inline real coulomb_of(const Parameters *p, real running)
{
    return p->rig_coulomb_idle + (p->rig_coulomb_run - p->rig_coulomb_idle) * running;
}

/* The moment about the bearing without dry friction. */
static inline real torque_of(const Loop *l, const Drive *d, const Motion *m, const Thrust *t)
{
    const Parameters *p = &l->p;
    const real viscous = p->rig_viscous_idle + (p->rig_viscous_run - p->rig_viscous_idle) * t->running;
    const real cable = (1 - t->running) * (p->rig_hardening * m->theta * m->theta);
    const real spring = m->theta * (p->rig_spring - p->rig_softening * t->running + cable);
    return t->moment + d->gust - l->c.weight * m->sine - spring - viscous * m->q;
}

static inline Motion rates(const Loop *l, const Drive *d, const Motion *m)
{
    const Parameters *p = &l->p;
    const Derived *c = &l->c;
    const Thrust t = thrust_of(l, d, m->fore, m->aft);
    const real coulomb = coulomb_of(p, t.running), torque = torque_of(l, d, m, &t);
    const real force =
        (c->offset_mass * m->q * m->q - t.thrust) * m->sine + p->rig_rail_force - p->rig_rail_viscous * m->v;
    const real coupling = c->offset_mass * m->cosine, alone = torque * c->per_inertia;
    const int stuck = holds(m->q, torque, coulomb, m->theta, -p->rig_pitch_stop, p->rig_pitch_stop);
    const real load = stuck ? force : force - coupling * alone;
    const int locked = holds(m->v, load, p->rig_rail_coulomb, m->x, c->low, c->high);
    const real cart = locked ? 0 : force * c->per_mass;
    Motion rate = {.theta = m->q, .x = m->v, .sine = m->cosine * m->q, .cosine = -m->sine * m->q};
    if (holds(m->q, torque - coupling * cart, coulomb, m->theta, -p->rig_pitch_stop, p->rig_pitch_stop)) {
        rate.v = cart;
    } else if (locked) {
        rate.q = alone;
    } else {
        const real per_determinant = 1 / (c->inertia_mass - coupling * coupling);
        rate.q = (c->mass * torque - coupling * force) * per_determinant;
        rate.v = (p->rig_inertia * force - coupling * torque) * per_determinant;
    }
    rate.fore = (d->fore - m->fore) * c->per_lag;
    rate.aft = (d->aft - m->aft) * c->per_lag;
    return rate;
}

static inline Motion along(const Motion *m, real h, const Motion *k)
{
    return (Motion){m->theta + h * k->theta, m->q + h * k->q,       m->x + h * k->x,
                    m->v + h * k->v,         m->sine + h * k->sine, m->cosine + h * k->cosine,
                    m->fore + h * k->fore,   m->aft + h * k->aft};
}

static inline Motion integrated(const Loop *l, const Drive *d, const Motion *m)
{
    const Motion k1 = rates(l, d, m);
    const Motion at2 = along(m, TICK / 2, &k1), k2 = rates(l, d, &at2);
    const Motion at3 = along(m, TICK / 2, &k2), k3 = rates(l, d, &at3);
    const Motion at4 = along(m, TICK, &k3), k4 = rates(l, d, &at4);
#define MEAN(part) m->part + TICK / 6 * (k1.part + 2 * k2.part + 2 * k3.part + k4.part)
    return (Motion){MEAN(theta), MEAN(q), MEAN(x), MEAN(v), MEAN(sine), MEAN(cosine), MEAN(fore), MEAN(aft)};
}

/* Friction that can take `loss` of speed within the tick. */
static inline void rub(real *place, real *speed, real loss)
{
    const real lost = within(*speed, -loss, loss);
    *place -= TICK / 2 * lost;
    *speed -= lost;
}

/* Friction on a motion that may turn round within the tick, under the acceleration `drive` of all else. */
static inline void rub_round(real *place, real *speed, real drive, real loss)
{
    const real before = *speed - drive * TICK;
    real after = 0;
    if (*speed == 0)
        return;
    if (before > 0) {
        after = *speed - loss * TICK;
        if (after < 0)
            after = fmin(0, (drive + loss) * (TICK - before / (loss - drive)));
    } else {
        after = *speed + loss * TICK;
        if (after > 0)
            after = fmax(0, (drive - loss) * (TICK + before / (loss + drive)));
    }
    *place -= TICK / 2 * (*speed - after);
    *speed = after;
}

/* A stop gives back a share of the speed; a rebound slower than `rest` ends there. */
static inline void bounce(real *place, real *speed, real low, real high, real restitution, real rest)
{
    real stop;
    if (*place > high && *speed > 0)
        stop = high;
    else if (*place < low && *speed < 0)
        stop = low;
    else
        return;
    const real back = -restitution * *speed;
    *place = fabs(back) < rest ? stop : stop - restitution * (*place - stop);
    *speed = fabs(back) < rest ? 0 : back;
}

static inline void contacts(const Loop *l, const Drive *d, const Thrust *now, Motion *m)
{
    const Parameters *p = &l->p;
    const Derived *c = &l->c;
    const real q = m->q, v = m->v;
    const real coulomb = coulomb_of(p, now->running), torque = torque_of(l, d, m, now);
    rub(&m->x, &m->v, p->rig_rail_coulomb * c->per_mass * TICK);
    const real slid = m->v;
    bounce(&m->x, &m->v, c->low, c->high, c->bounce, SLOW_CART);
    rub_round(&m->theta, &m->q, torque * c->per_inertia, coulomb * c->per_inertia);
    const real turned = m->q;
    bounce(&m->theta, &m->q, -p->rig_pitch_stop, p->rig_pitch_stop, p->rig_pitch_bounce, SLOW_PITCH);
    m->sine = sin(m->theta);
    m->cosine = cos(m->theta);
    const real coupling = c->offset_mass * m->cosine, speed = m->v, turning = m->q;
    m->q -= coupling * c->per_inertia * (speed - (turning == 0 ? slid : v));
    m->v -= coupling * c->per_mass * (turning - (speed == 0 ? turned : q));
}

/* The band-pass is a sample behind, so that its noise is independent of the white one. */
static inline real shaken(const Derived *c, const Parameters *p, Vibration *f, real fresh)
{
    const real behind = f->y1;
    const real y = c->vibration_gain * (fresh - f->w2) + c->vibration_turn * behind - p->rig_vibration_r2 * f->y2;
    *f = (Vibration){.w1 = fresh, .w2 = f->w1, .y1 = y, .y2 = behind};
    return behind;
}

/* The mean of a cosine over a sample, over its middle value. `half` > 0 is half the angle of the sample. */
static inline real passed(real half, real sine_half)
{
    return half > R(1e-3) * PI ? sine_half / half : 1;
}

/* The line of a pair whose rotor is out of balance; then the rotor turns on. The sine of half the sample's angle serves
   both the mean over the sample and the turn. A Newton step of the root keeps the phase on the unit circle. */
static inline Phase line_of(const Derived *c, Phase *at, real load)
{
    const real half = c->half_turn * sqrt(load > STILL ? load : STILL);
    const real sine_half = sin(half), size = load * passed(half, sine_half);
    const real sine = 2 * sine_half * cos(half), cosine = 1 - 2 * sine_half * sine_half;
    const Phase next = {at->cosine * cosine - at->sine * sine, at->sine * cosine + at->cosine * sine};
    const real length = R(1.5) - R(0.5) * (next.cosine * next.cosine + next.sine * next.sine);
    const Phase line = {size * at->cosine, size * at->sine};
    *at = (Phase){length * next.cosine, length * next.sine};
    return line;
}

static inline real rounded(real value, real grain)
{
    return grain > 0 ? floor(value / grain + R(0.5)) * grain : value;
}

static inline void sense_motion(Loop *l, const Thrust *now)
{
    const Parameters *p = &l->p;
    const Derived *c = &l->c;
    const Motion *m = &l->motion;
    const real along_rail = (m->v - l->imu_v) / SAMPLE, turning = (m->q - l->imu_q) / SAMPLE;
    const Phase fore = line_of(c, &l->fore_phase, now->load_fore), aft = line_of(c, &l->aft_phase, now->load_aft);
    const real load = now->load, n_x = normal(&l->noise), n_z = normal(&l->noise), n_q = normal(&l->noise);
    const real e_x = p->rig_acc_x_idle * n_x + p->rig_acc_x_hover * load * shaken(c, p, &l->shake_x, n_x) +
                     c->line_x * (fore.cosine + aft.cosine);
    const real e_z = p->rig_acc_z_idle * n_z + p->rig_acc_z_hover * load * shaken(c, p, &l->shake_z, n_z) +
                     c->line_z * (fore.sine + aft.sine);
    const real e_q = p->rig_gyro_idle * n_q + p->rig_gyro_hover * load * shaken(c, p, &l->shake_q, n_q) +
                     c->line_q * (fore.sine - aft.sine);
    const real own_x = p->rig_imu_below * turning - p->rig_imu_ahead * m->q * m->q;
    const real force_x = m->cosine * along_rail + GRAVITY * m->sine + own_x;
    const real acc_x = p->rig_acc_scale * force_x + p->rig_acc_bias;
    const real acc_z = m->sine * along_rail - GRAVITY * m->cosine - p->rig_imu_below * m->q * m->q - p->rig_imu_ahead * turning;
    l->y.acc_x = rounded(acc_x + p->rig_noise * e_x, c->acc_grain);
    l->y.acc_z = rounded(acc_z + p->rig_noise * e_z, c->acc_grain);
    l->y.gyro_y = rounded(p->rig_gyro_scale * m->q + p->rig_gyro_bias + p->rig_noise * e_q, c->gyro_grain);
    l->imu_q = m->q;
    l->imu_v = m->v;
}

static inline real place_ago(const Loop *l, int back)
{
    if (back < 1)
        return l->motion.x;
    return back <= l->filled ? l->places[(l->place - back) & (PLACES - 1)] : l->p.rig_x_start;
}

static inline void sense_range(Loop *l)
{
    const Parameters *p = &l->p;
    const uint32_t before = l->phase;
    const real n = normal(&l->noise);
    l->phase += l->c.tof_advance;
    l->dist_new = l->phase < before;
    l->y.dist_new = (real)l->dist_new;
    l->y.dist_age = p->rig_tof_stamp;
    if (l->dist_new) {
        const real young = place_ago(l, l->c.tof_back), old = place_ago(l, l->c.tof_back + 1);
        const real measured = young + l->c.tof_fraction * (old - young);
        l->y.dist = rounded(measured + RAIL_CENTRE + p->rig_tof_bias + p->rig_noise * p->rig_tof_noise * n,
                          l->c.tof_grain);
    }
    l->places[l->place] = l->motion.x;
    l->place = (l->place + 1) & (PLACES - 1);
    if (l->filled < PLACES)
        l->filled++;
}

static void discharge(Loop *l)
{
    const Parameters *p = &l->p;
    const real power = l->battery_load * sqrt(l->battery_load), current = p->rig_hover_current * power;
    const real felt = p->rig_hover_current * (power + p->rig_polarised_share * (l->polarised - power));
    const real open = p->rig_voltage_empty + (p->rig_voltage_full - p->rig_voltage_empty) * l->charge;
    const real voltage = open - p->rig_resistance * felt, share = (voltage > 0 ? voltage : 0) * l->c.per_reference;
    l->supply = share * share;
    l->y.voltage = voltage > 0 ? voltage : 0;
    l->y.charge = l->charge;
    l->charge = within(l->charge - current * l->c.per_capacity * BATTERY, 0, 1);
    l->polarised += l->c.polarise_step * (power - l->polarised);
    l->polarised = l->polarised < STILL ? 0 : l->polarised;
}
