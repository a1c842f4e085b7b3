/* What the hand-written loop knows: number type, constants, parameters, inputs, outputs, states. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef SINGLE
typedef float real;
#define sin(x) sinf(x)
#define cos(x) cosf(x)
#define atan(x) atanf(x)
#define atan2(y, x) atan2f(y, x)
#define exp(x) expf(x)
#define sqrt(x) sqrtf(x)
#define floor(x) floorf(x)
#define fabs(x) fabsf(x)
#else
typedef double real;
#endif
#define R(number) ((real)(number))

#define TICK R(0.001)   /* of the rig [s] */
#define SAMPLE R(0.004) /* of the sensors and the flight code [s] */
#define TICKS_PER_SAMPLE 4
#define TICKS_PER_BATTERY 40
#define BATTERY R(0.04) /* of the battery [s] */
#define GRAVITY R(9.81)
#define PI R(3.141592653589793)
#define HOVER R(0.4)
#define RAIL_CENTRE R(0.5)
#define COMMANDS 64 /* kept, for the delay of the rotors */
#define PLACES 32   /* kept, for the age of a range sample */
#define STILL R(1e-9)
#define SLOW_PITCH R(0.02)
#define SLOW_CART R(0.005)
#define LONGEST_HOLD (1 << 24)

/* The path of each parameter, its dots as underscores, in the order in which the array of values gives them. */
#define PARAMETERS(X) \
    X(rig_mass_drone) X(rig_mass_cart) X(rig_inertia) X(rig_offset) X(rig_spring) X(rig_softening) \
    X(rig_hardening) X(rig_viscous_idle) X(rig_viscous_run) X(rig_coulomb_idle) X(rig_coulomb_run) X(rig_pitch_stop) \
    X(rig_pitch_bounce) X(rig_rail_viscous) X(rig_rail_coulomb) X(rig_rail_force) X(rig_rail_stop) \
    X(rig_rail_bounce) X(rig_rings) X(rig_ring_place) X(rig_ring_play) X(rig_theta_start) X(rig_q_start) \
    X(rig_x_start) X(rig_v_start) X(rig_pair_thrust) X(rig_curve) X(rig_arm) X(rig_delay) X(rig_lag) X(rig_trim) \
    X(rig_trim_start) X(rig_wake_lag) X(rig_wake_fade) X(rig_wake_start) X(rig_capacity) X(rig_voltage_full) \
    X(rig_voltage_empty) X(rig_resistance) X(rig_polarised_share) X(rig_polarised_time) \
    X(rig_hover_current) X(rig_charge_start) X(rig_polarised_start) X(rig_gust) X(rig_gust_time) X(rig_noise) \
    X(rig_imu_below) X(rig_imu_ahead) X(rig_acc_scale) X(rig_gyro_scale) X(rig_acc_bias) X(rig_gyro_bias) X(rig_acc_x_idle) X(rig_acc_z_idle) X(rig_gyro_idle) \
    X(rig_acc_x_hover) X(rig_acc_z_hover) X(rig_gyro_hover) X(rig_vibration_hz) X(rig_vibration_r2) X(rig_rotor_hz) \
    X(rig_acc_x_line) X(rig_acc_z_line) X(rig_gyro_line) X(rig_ring_shake) X(rig_acc_step) \
    X(rig_gyro_step) X(rig_tof_rate) X(rig_tof_age) X(rig_tof_noise) X(rig_tof_bias) X(rig_tof_step) \
    X(rig_tof_phase) X(rig_tof_stamp) X(flight_estimator_filter_sigma_gyro) \
    X(flight_estimator_filter_sigma_walk) X(flight_estimator_filter_sigma_a) X(flight_estimator_filter_sigma_range) \
    X(flight_estimator_filter_sigma_gravity) X(flight_estimator_filter_sigma_theta_0) \
    X(flight_estimator_filter_sigma_bias_0) X(flight_estimator_filter_sigma_x_0) \
    X(flight_estimator_filter_sigma_v_0) X(flight_hold_settle) X(flight_hold_window) \
    X(flight_arming_samples) X(flight_cascade_position_kp) X(flight_cascade_position_limit) \
    X(flight_cascade_velocity_kp) X(flight_cascade_velocity_ki) X(flight_cascade_projection_T_bar) \
    X(flight_cascade_projection_eta_T) X(flight_cascade_attitude_kp) X(flight_cascade_attitude_limit) \
    X(flight_cascade_rate_kp) X(flight_cascade_rate_ki) X(flight_cascade_rate_kd) X(flight_cascade_rate_N) \
    X(flight_cascade_rate_limit)

typedef struct {
#define MEMBER(name) real name;
    PARAMETERS(MEMBER)
} Parameters;

const char *const hand_parameters[] = {
#define TEXT(name) #name,
    PARAMETERS(TEXT) 0};

typedef struct {
    int32_t mode;
    int32_t use_trim;
    real x0, v0, theta0, q0, thrust, M_open;
} Setpoints;

/* What the compiled diagram returns at each tick, under the same names. */
#define OUTPUTS(X) \
    X(fore) X(aft) X(M) X(T) X(theta) X(q) X(x) X(v) X(x0) X(v0) X(theta0) X(q0) X(M_trim) X(acc_x) X(acc_z) \
    X(gyro_y) X(dist) X(dist_new) X(dist_age) X(true_theta) X(true_q) X(true_x) X(true_v) X(load) X(voltage) X(charge)

typedef struct {
    OUTPUTS(MEMBER)
} Outputs;

const char *const hand_outputs[] = {OUTPUTS(TEXT) 0};

enum { OFF, OPEN_LOOP, RATE, ATTITUDE, VELOCITY, POSITION };

#include "noise.h"

/* The rig's continuous states. */
typedef struct {
    real theta, q, x, v, sine, cosine, fore, aft;
} Motion;

/* What follows from the parameters. */
typedef struct {
    real mass, offset_mass, weight, per_inertia, per_mass, inertia_mass, low, high, bounce;
    real delay_fraction, per_lag, wake_step, per_hover;
    real per_capacity, per_reference, polarise_step, gust_keep, gust_fresh;
    real vibration_gain, vibration_turn, acc_grain, gyro_grain, tof_fraction, tof_grain;
    real half_turn, line_x, line_z, line_q;
    real gyro_q, walk_q, q_xx, q_xv, q_vv, gravity_r, range_r;
    real velocity_ki, rate_ki, rate_decay, rate_rise, hold_window;
    int delay, direct, tof_back, settle;
    uint32_t tof_advance;
} Derived;

typedef struct {
    real w1, w2, y1, y2;
} Vibration;

/* Angle of a rotor, one of each pair, on the unit circle. */
typedef struct {
    real cosine, sine;
} Phase;

/* Covariance of the estimated pitch t, gyro bias b, position x and velocity v. */
typedef struct {
    real tt, tb, tx, tv, bb, bx, bv, xx, xv, vv;
} Covariance;

typedef struct {
    Parameters p;
    Derived c;
    Generator noise;
    uint32_t tick;

    Motion motion;
    real fore_ring[COMMANDS], aft_ring[COMMANDS];
    int ring_place;
    real wake, gust, gust_moment, charge, polarised, battery_load, supply;
    real imu_q, imu_v;
    Vibration shake_x, shake_z, shake_q;
    Phase fore_phase, aft_phase;
    real places[PLACES];
    int place, filled, dist_new;
    uint32_t phase;

    real pitch, bias, x, v;
    Covariance spread;
    real x_published, v_published;
    int started, publisher;
    real previous_pitch, velocity_sum, velocity_carry, rate_sum, rate_carry, slope, rate_error;
    int armed, held;
    real trim;
    Outputs y;
} Loop;

static inline real within(real value, real low, real high)
{
    return value < low ? low : value > high ? high : value;
}
