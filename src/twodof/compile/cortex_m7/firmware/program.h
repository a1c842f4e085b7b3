/* What an image knows of each of its programs: the functions and sizes that a diagram's C exports. */
#include <stddef.h>
#include <stdint.h>

/* Their pointers are those of the program's own structs, which whoever calls through this table does not know. */
typedef struct {
    void (*defaults)(void *p);
    void (*prepare)(void *p);
    void (*init)(const void *p, void *s);
    void (*step)(const void *p, void *s, const void *u, void *y);
    const size_t *sizes; /* of real, P, S, U, Y */
} Program;

extern const Program programs[];
extern const uint32_t program_count;

#define DECLARE_PROGRAM(name)                                                                                          \
    void name##_defaults(void *p);                                                                                     \
    void name##_prepare(void *p);                                                                                      \
    void name##_init(const void *p, void *s);                                                                          \
    void name##_step(const void *p, void *s, const void *u, void *y);                                                  \
    extern const size_t name##_sizes[5];
#define PROGRAM(name) {name##_defaults, name##_prepare, name##_init, name##_step, name##_sizes},
