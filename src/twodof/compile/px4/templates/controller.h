/* ${module}: the controller, without PX4. To be included before PX4's headers and their macros. */
#ifndef ${MODULE}_H
#define ${MODULE}_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
${inputs}
} ${module}_Inputs;

/* What the diagram gives, and the signals that are logged. */
typedef struct {
${outputs}
} ${module}_Outputs;

typedef union {
    float real;
    int32_t integer;
} ${module}_Value;

/* A parameter in PX4: its name, its type (f float, i integer, b boolean), its bounds and its default. A fixed one is
   read when the module starts. */
typedef struct {
    const char *name;
    char type;
    bool fixed;
    float low, high;
    int32_t least, most;
    ${module}_Value standard;
} ${module}_Parameter;

enum {
    ${module}_PARAMETERS = ${parameters},
${own}    ${module}_INPUT_WORDS = ${input_words},
    ${module}_OUTPUT_WORDS = ${output_words}
};

extern const ${module}_Parameter ${module}_parameters[${module}_PARAMETERS];

/* Parameters (those in use and those that are just being checked), states, inputs and outputs of one controller. */
typedef struct {
    uint64_t words[${words}];
} ${module}_Controller;

/* Defaults and initial states. */
void ${module}_begin(${module}_Controller *c);

/* Initial states; the parameters stay. */
void ${module}_reset(${module}_Controller *c);

/* Whether a value is within the bounds of the parameter at `place`. A NaN is in no bounds. */
bool ${module}_within(int32_t place, ${module}_Value value);

/* Takes ${module}_PARAMETERS values over, those of fixed parameters only when `starting`. Returns -1, or, if one is out of
   bounds, its place; then none is changed. */
int32_t ${module}_change(${module}_Controller *c, const ${module}_Value *values, bool starting);

/* One step of ${period} us. */
void ${module}_tick(${module}_Controller *c, const ${module}_Inputs *in, ${module}_Outputs *out);

/* Steps since the beginning or the last reset. */
uint32_t ${module}_ticks(const ${module}_Controller *c);

/* A row of a recorded sequence: 32 bits for each real, integer or bool (0 or 1), arrays element by element. */
void ${module}_unpack(const uint32_t *words, ${module}_Inputs *in);
void ${module}_pack(const ${module}_Outputs *out, uint32_t *words);

#ifdef __cplusplus
}
#endif

#endif
