/* An FMU of this program: the functions of FMI ${version} around those above. They use no globals but constant tables,
   so that instances share nothing. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#define EXPORTED(result, function) __attribute__((visibility("default"))) result function

enum { OK = 0, ERROR = 3 };
enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED };

static const double period = ${period}; /* s */
static const double most_periods = 1e8; /* in one step */
static const char token[] = "${token}";

/* All that an instance remembers: what FMI calls its state. */
typedef struct {
    char token[sizeof token];
    int mode;
    bool changed; /* parameters were set: `prepare` has to run */
    double start, time;
    uint64_t ticks;
    ${name}_P p;
    ${name}_S s;
    ${name}_U u;
    ${name}_Y y;
} Memory;

typedef struct {
    Memory now;
    ${name}_S kept;
    void *environment;
    void (*logger)(void);
    char name[];
} Instance;

typedef struct {
    const char *name;
    char causality; /* i input, o output, p parameter, f fixed parameter, or the time */
    char type; /* f float32, d float64, i int32, u uint32, c int8, C uint8, h int16, H uint16, b bool */
    uint32_t count, rows; /* elements; rows of a matrix, which stands column after column, else 1 */
    size_t offset;
    double low, high;
    uint32_t n_members; /* of an enumeration */
    const int32_t *members;
} Variable;

static const Variable variables[] = {
${rows}};

static void tell(const Instance *i, const char *text);

static int fail(const Instance *i, const char *format, ...)
{
    char text[400];
    va_list given;
    va_start(given, format);
    (void)vsnprintf(text, sizeof text, format, given);
    va_end(given);
    tell(i, text);
    return ERROR;
}

static int restart(Memory *m)
{
    memset(m, 0, sizeof *m);
    memcpy(m->token, token, sizeof token);
    ${name}_defaults(&m->p);
    m->changed = true;
    return OK;
}

static Instance *instantiate(const char *name, const char *given, void (*logger)(void), void *environment)
{
    Instance *i = calloc(1, sizeof *i + (name ? strlen(name) : 0) + 1);
    if (!i) {
        return NULL;
    }
    strcpy(i->name, name ? name : "");
    i->logger = logger;
    i->environment = environment;
    (void)restart(&i->now);
    if (given && !strcmp(given, token)) {
        return i;
    }
    (void)fail(i, "the token of modelDescription.xml is another than this binary's: export the FMU again");
    free(i);
    return NULL;
}

static int enter(Memory *m, int mode, double start)
{
    m->mode = mode;
    m->start = m->time = start;
    return OK;
}

/* Derived parameters, and before the first step the initial states, of the parameters as they are now. */
static void settle(Memory *m)
{
    if (m->changed) {
        ${name}_prepare(&m->p);
        if (m->mode < STEPPING) {
            ${name}_init(&m->p, &m->s);
        }
    }
    m->changed = false;
}

/* Before the first step the outputs are those that a tick would have with these inputs. */
static void look_ahead(Instance *i)
{
    settle(&i->now);
    i->kept = i->now.s;
    ${name}_step(&i->now.p, &i->now.s, &i->now.u, &i->now.y);
    i->now.s = i->kept;
}

static int advance(Instance *i, double size)
{
    Memory *m = &i->now;
    const double periods = size / period;
    const double whole = periods > 0.0 && periods < most_periods ? (double)(uint64_t)(periods + 0.5) : 0.0;
    const double beside = periods > whole ? periods - whole : whole - periods;
    if (m->mode != STEPPING) {
        return fail(i, "doStep comes after the initialization and before terminate");
    }
    if (!(whole >= 1.0 && beside <= 1e-6 * whole)) {
        return fail(i, "doStep: %.9g s is not a whole number of periods of %.9g s: step by a multiple of them, at most %g",
            size, period, most_periods);
    }
    settle(m);
    ${name}_run(&m->p, &m->s, &m->u, 0, &m->y, 0, (size_t)whole);
    m->ticks += (uint64_t)whole;
    m->time = m->start + (double)m->ticks * period;
    return OK;
}

/* Element `k` of an array of a type, first set to `*value` unless that is NULL. `double` holds every value exactly. */
static double element(char type, void *array, size_t k, const double *value)
{
    switch (type) {
#define ELEMENT(letter, c_type) case letter: \
    if (value) { ((c_type *)array)[k] = (c_type)*value; } \
    return (double)((c_type *)array)[k];
    ELEMENT('f', float) ELEMENT('d', double) ELEMENT('b', bool) ELEMENT('i', int32_t) ELEMENT('u', uint32_t)
    ELEMENT('c', int8_t) ELEMENT('C', uint8_t) ELEMENT('h', int16_t) ELEMENT('H', uint16_t)
    }
    return 0.0;
}

static int check(const Instance *i, const Variable *v, double value)
{
    const double rounded = v->type == 'f' ? (double)(float)value : value;
    const bool inside = v->type == 'b' || (v->low <= rounded && rounded <= v->high);
    const bool nan_of_input = v->causality == 'i' && value != value;
    bool member = !v->n_members;
    for (uint32_t k = 0; k < v->n_members; k++) {
        member |= v->members[k] == value;
    }
    const char *wrong = !strchr("ipf", v->causality) ? "%s cannot be set"
        : v->causality == 'f' && i->now.mode >= STEPPING ? "%s is fixed after the initialization"
        : !member ? "%s: %.9g is not a member of its enumeration: see modelDescription.xml"
        : !inside && !nan_of_input ? "%s: %.9g is not within %.9g and %.9g" : NULL;
    return wrong ? fail(i, wrong, v->name, value, v->low, v->high) : OK;
}

/* Set or get `n` variables of one of `types` by `room` values of the type `as`. */
static int move(
    Instance *i, bool set, char as, const char *types, const uint32_t references[], size_t n, void *values, size_t room)
{
    if (!set && i->now.mode < STEPPING) {
        look_ahead(i);
    }
    for (size_t j = 0, k = 0; j < n; j++) {
        const bool known = references[j] < sizeof variables / sizeof *variables;
        const Variable *v = variables + (known ? references[j] : 0);
        const char *wrong = !known ? "no variable has the value reference %u"
            : !strchr(types, v->type) ? "the variable with the value reference %u has another type"
            : v->count > room - k ? "the variable with the value reference %u has more elements" : NULL;
        if (wrong) {
            return fail(i, wrong, (unsigned)references[j]);
        }
        for (uint32_t e = 0; e < v->count; e++, k++) {
            const uint32_t columns = v->count / v->rows; /* FMI counts row after row */
            const size_t at = e % columns * v->rows + e / columns;
            char *place = (char *)&i->now + v->offset;
            const double value = set ? element(as, values, k, NULL) : element(v->type, place, at, NULL);
            if (set && check(i, v, value)) {
                return ERROR;
            }
            (void)(set ? element(v->type, place, at, &value) : element(as, values, k, &value));
            i->now.changed |= set && v->causality != 'i';
        }
    }
    return OK;
}

/* The functions that get and set values of one of FMI's types. */
#define VALUES(fmi_type, c_type, as, types, ROOM, room) \
    EXPORTED(int, ${fmi}Get##fmi_type)(void *i, const uint32_t references[], size_t n, c_type values[] ROOM) \
    { return move(i, false, as, types, references, n, values, room); } \
    EXPORTED(int, ${fmi}Set##fmi_type)(void *i, const uint32_t references[], size_t n, const c_type values[] ROOM) \
    { return move(i, true, as, types, references, n, (void *)values, room); }

/* Functions that this FMU does not have; further arguments are not looked at. */
#define REFUSED(function) EXPORTED(int, ${fmi}##function)(void *i) \
    { return fail(i, "${fmi}" #function ": this FMU does not have it, see modelDescription.xml"); }

/* A copy of a state in `*to`, which is made if it is NULL. */
static int keep(Instance *i, void **to, const void *from)
{
    if (!*to && !(*to = malloc(sizeof(Memory)))) {
        return fail(i, "the state does not fit into memory");
    }
    memcpy(*to, from, sizeof(Memory));
    return OK;
}

EXPORTED(const char *, ${fmi}GetVersion)(void) { return "${version}"; }
EXPORTED(int, ${fmi}SetDebugLogging)(Instance *i, ${bool} on, size_t n, const char *const categories[])
{ return (void)i, (void)on, (void)n, (void)categories, OK; } /* it logs errors only */
EXPORTED(void, ${fmi}FreeInstance)(void *i) { free(i); }
EXPORTED(int, ${fmi}ExitInitializationMode)(Instance *i) { look_ahead(i), i->now.mode = STEPPING; return OK; }
EXPORTED(int, ${fmi}Terminate)(Instance *i) { i->now.mode = TERMINATED; return OK; }
EXPORTED(int, ${fmi}Reset)(Instance *i) { return restart(&i->now); }
EXPORTED(int, ${fmi}GetFMU${S}tate)(Instance *i, void **state) { return keep(i, state, &i->now); }
EXPORTED(int, ${fmi}SetFMU${S}tate)(Instance *i, void *state) { i->now = *(Memory *)state; return OK; }
EXPORTED(int, ${fmi}FreeFMU${S}tate)(Instance *i, void **state) { (void)i, free(*state), *state = NULL; return OK; }
EXPORTED(int, ${fmi}SerializedFMU${S}tateSize)(Instance *i, void *state, size_t *size)
{ return (void)i, (void)state, *size = sizeof(Memory), OK; }
EXPORTED(int, ${fmi}SerializeFMU${S}tate)(Instance *i, void *state, char bytes[], size_t size)
{
    void *to = bytes;
    return size < sizeof(Memory) ? fail(i, "there is too little room for the state") : keep(i, &to, state);
}

EXPORTED(int, ${fmi}${D}erializeFMU${S}tate)(Instance *i, const char bytes[], size_t size, void **state)
{
    const bool own = size == sizeof(Memory) && !memcmp(bytes, token, sizeof token);
    return own ? keep(i, state, bytes) : fail(i, "these bytes are not a state of this FMU");
}
