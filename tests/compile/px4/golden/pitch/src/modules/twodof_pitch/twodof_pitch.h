/* twodof_pitch: the controller, without PX4. To be included before PX4's headers and their macros. */
#ifndef TWODOF_PITCH_H
#define TWODOF_PITCH_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    float in_theta_0; /* theta_0 [rad] */
    float in_q_0; /* q_0 [rad/s] */
    float in_theta; /* theta [rad] */
    float in_q; /* q [rad/s] */
    bool in_flag_reset_int; /* FLAG_RESET_INT */
    bool in_flag_attitude_enabled; /* FLAG_ATTITUDE_ENABLED */
} twodof_pitch_Inputs;

/* What the diagram gives, and the signals that are logged. */
typedef struct {
    float out_m; /* M */
    float log_damper_error; /* damper.error [rad] */
    int32_t log_damper_count; /* damper.count */
} twodof_pitch_Outputs;

typedef union {
    float real;
    int32_t integer;
} twodof_pitch_Value;

/* A parameter in PX4: its name, its type (f float, i integer, b boolean), its bounds and its default. A fixed one is
   read when the module starts. */
typedef struct {
    const char *name;
    char type;
    bool fixed;
    float low, high;
    int32_t least, most;
    twodof_pitch_Value standard;
} twodof_pitch_Parameter;

enum {
    twodof_pitch_PARAMETERS = 9,
    twodof_pitch_LIVE = 7, /* the place of TPI_LIVE */
    twodof_pitch_TORQUE = 8, /* the place of TPI_TORQUE */
    twodof_pitch_INPUT_WORDS = 6,
    twodof_pitch_OUTPUT_WORDS = 3
};

extern const twodof_pitch_Parameter twodof_pitch_parameters[twodof_pitch_PARAMETERS];

/* Parameters (those in use and those that are just being checked), states, inputs and outputs of one controller. */
typedef struct {
    uint64_t words[15];
} twodof_pitch_Controller;

/* Defaults and initial states. */
void twodof_pitch_begin(twodof_pitch_Controller *c);

/* Initial states; the parameters stay. */
void twodof_pitch_reset(twodof_pitch_Controller *c);

/* Whether a value is within the bounds of the parameter at `place`. A NaN is in no bounds. */
bool twodof_pitch_within(int32_t place, twodof_pitch_Value value);

/* Takes twodof_pitch_PARAMETERS values over, those of fixed parameters only when `starting`. Returns -1, or, if one is out of
   bounds, its place; then none is changed. */
int32_t twodof_pitch_change(twodof_pitch_Controller *c, const twodof_pitch_Value *values, bool starting);

/* One step of 4000 us. */
void twodof_pitch_tick(twodof_pitch_Controller *c, const twodof_pitch_Inputs *in, twodof_pitch_Outputs *out);

/* Steps since the beginning or the last reset. */
uint32_t twodof_pitch_ticks(const twodof_pitch_Controller *c);

/* A row of a recorded sequence: 32 bits for each real, integer or bool (0 or 1), arrays element by element. */
void twodof_pitch_unpack(const uint32_t *words, twodof_pitch_Inputs *in);
void twodof_pitch_pack(const twodof_pitch_Outputs *out, uint32_t *words);

#ifdef __cplusplus
}
#endif

#endif
