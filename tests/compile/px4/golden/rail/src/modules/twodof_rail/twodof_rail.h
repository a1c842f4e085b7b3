/* twodof_rail: the controller, without PX4. To be included before PX4's headers and their macros. */
#ifndef TWODOF_RAIL_H
#define TWODOF_RAIL_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    float in_x_0; /* x_0 [m] */
    float in_vx_0; /* vx_0 [m/s] */
    float in_x; /* x [m] */
    float in_vx; /* vx [m/s] */
    float in_ax_0; /* ax_0 [m/s2] */
    bool in_flag_reset_int_vel; /* FLAG_RESET_INT_VEL */
    bool in_flag_position_enabled; /* FLAG_POSITION_ENABLED */
} twodof_rail_Inputs;

/* What the diagram gives, and the signals that are logged. */
typedef struct {
    float out_thrust; /* thrust */
    float out_theta_0; /* theta_0 */
} twodof_rail_Outputs;

typedef union {
    float real;
    int32_t integer;
} twodof_rail_Value;

/* A parameter in PX4: its name, its type (f float, i integer, b boolean), its bounds and its default. A fixed one is
   read when the module starts. */
typedef struct {
    const char *name;
    char type;
    bool fixed;
    float low, high;
    int32_t least, most;
    twodof_rail_Value standard;
} twodof_rail_Parameter;

enum {
    twodof_rail_PARAMETERS = 4,
    twodof_rail_LIVE = 3, /* the place of TRA_LIVE */
    twodof_rail_INPUT_WORDS = 7,
    twodof_rail_OUTPUT_WORDS = 2
};

extern const twodof_rail_Parameter twodof_rail_parameters[twodof_rail_PARAMETERS];

/* Parameters (those in use and those that are just being checked), states, inputs and outputs of one controller. */
typedef struct {
    uint64_t words[9];
} twodof_rail_Controller;

/* Defaults and initial states. */
void twodof_rail_begin(twodof_rail_Controller *c);

/* Initial states; the parameters stay. */
void twodof_rail_reset(twodof_rail_Controller *c);

/* Whether a value is within the bounds of the parameter at `place`. A NaN is in no bounds. */
bool twodof_rail_within(int32_t place, twodof_rail_Value value);

/* Takes twodof_rail_PARAMETERS values over, those of fixed parameters only when `starting`. Returns -1, or, if one is out of
   bounds, its place; then none is changed. */
int32_t twodof_rail_change(twodof_rail_Controller *c, const twodof_rail_Value *values, bool starting);

/* One step of 4000 us. */
void twodof_rail_tick(twodof_rail_Controller *c, const twodof_rail_Inputs *in, twodof_rail_Outputs *out);

/* Steps since the beginning or the last reset. */
uint32_t twodof_rail_ticks(const twodof_rail_Controller *c);

/* A row of a recorded sequence: 32 bits for each real, integer or bool (0 or 1), arrays element by element. */
void twodof_rail_unpack(const uint32_t *words, twodof_rail_Inputs *in);
void twodof_rail_pack(const twodof_rail_Outputs *out, uint32_t *words);

#ifdef __cplusplus
}
#endif

#endif
