/* Embedded Coder's C of the public flightController behind the interface of our programs, to be called in turn with
   ours. It is included after our C for the same diagram, so that both take the sine from the same function; its own
   files are not ours and are fetched by the person who runs the benchmark. */
#include <math.h>

#define sin(x) td_sin((real)(x))
#define cos(x) td_cos((real)(x))
#include "flightController.c"
#undef sin
#undef cos

typedef struct {
    char unused;
} peer_P;
typedef struct {
    char unused;
} peer_S;
typedef struct {
    CommandBus command;
    statesEstim_t states;
} peer_U;
typedef struct {
    real32_T motors[4], pose[8];
} peer_Y;

const size_t peer_sizes[5] = {sizeof(real), sizeof(peer_P), sizeof(peer_S), sizeof(peer_U), sizeof(peer_Y)};

void peer_defaults(peer_P *p)
{
    (void)p;
}

void peer_prepare(peer_P *p)
{
    (void)p;
}

void peer_init(const peer_P *p, peer_S *s)
{
    (void)p, (void)s;
    flightController_Init();
}

void peer_step(const peer_P *p, peer_S *s, const peer_U *u, peer_Y *y)
{
    (void)p, (void)s;
    flightController_run(&u->command, &u->states, y->motors, y->pose);
}

void peer_run(const peer_P *p, peer_S *s, const peer_U *u, size_t u_stride, peer_Y *y, size_t y_stride, size_t n)
{
    for (size_t k = 0; k < n; k++) {
        peer_step(p, s, u + k * u_stride, y + k * y_stride);
    }
}
