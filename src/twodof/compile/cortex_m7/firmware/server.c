/* Runs the programs of the image as the host asks: reads a request and its data, calls, sends the results back.

   A request is the words OPERATION, PROGRAM, STEPS, U_STRIDE, Y_STRIDE, WATCH, the sizes of real, P, S, U and Y, and then
   P, S and U as the operation reads them; the answer is data in frames, and a last frame with the depth of the stack in
   bytes, if WATCH asked for it. The host side is `processor.py`. */
#include "server.h"

#include <string.h>

#include "program.h"
#include "semihosting.h"

enum { DEFAULTS, PREPARE, INIT, RUN, COUNT };
enum { OPERATION, PROGRAM_INDEX, STEPS, U_STRIDE, Y_STRIDE, WATCH, SIZES, REQUEST_WORDS = SIZES + 5 };
enum { MOST_ROWS = 256, MOST_BYTES = 32768 }; /* between two frames, so that the host sees that something goes on */

static const uint32_t PAINT = 0x5eaf00d5u;
static volatile uint32_t *const TIMER_CTRL = (volatile uint32_t *)0x40000000u; /* CMSDK timer 0, counts down at 25 MHz */
static volatile uint32_t *const TIMER_VALUE = (volatile uint32_t *)0x40000004u;
static volatile uint32_t *const TIMER_RELOAD = (volatile uint32_t *)0x40000008u;

extern uint32_t diagram_stack_bottom[], diagram_stack_top[];
extern unsigned char pool_start[], pool_end[];

static int32_t from_host, to_host;

void stop(uint32_t reason)
{
    for (;;)
        semihosting(SYS_EXIT, (const void *)reason);
}

/* Reads exactly `bytes`; when the host has closed its end, the work is done. */
static void receive(void *data, uint32_t bytes)
{
    unsigned char *at = data;
    while (bytes) {
        const uint32_t arguments[3] = {(uint32_t)from_host, (uint32_t)at, bytes};
        const uint32_t left = (uint32_t)semihosting(SYS_READ, arguments);
        if (left >= bytes)
            stop(STOP_DONE);
        at += bytes - left;
        bytes = left;
    }
}

static void deliver(const void *data, uint32_t bytes)
{
    const unsigned char *at = data;
    while (bytes) {
        const uint32_t arguments[3] = {(uint32_t)to_host, (uint32_t)at, bytes};
        const uint32_t left = (uint32_t)semihosting(SYS_WRITE, arguments);
        if (left >= bytes)
            stop(STOP_FAULT);
        at += bytes - left;
        bytes = left;
    }
}

void send(uint32_t kind, const void *data, uint32_t bytes)
{
    const uint32_t head[2] = {kind, bytes};
    deliver(head, sizeof head);
    deliver(data, bytes);
}

/* Calls a function of the diagram on the diagram's stack. */
__attribute__((naked)) static void call(void *function, const void *p, void *s, const void *u, void *y)
{
    __asm__ volatile("push {r4, lr}\n\t"
                     "mov r12, r0\n\t"
                     "mov r0, r1\n\t"
                     "mov r1, r2\n\t"
                     "mov r2, r3\n\t"
                     "ldr r3, [sp, #8]\n\t"
                     "mov r4, sp\n\t"
                     "ldr lr, =diagram_stack_top\n\t"
                     "mov sp, lr\n\t"
                     "blx r12\n\t"
                     "mov sp, r4\n\t"
                     "pop {r4, pc}\n\t"
                     ".ltorg");
}

__attribute__((naked)) static void nothing(void)
{
    __asm__ volatile("bx lr");
}

/* Not inlined, so that it costs the same whatever it calls. */
__attribute__((noinline)) static uint32_t ticks(void *function, const void *p, void *s, const void *u, void *y)
{
    const uint32_t before = *TIMER_VALUE;
    call(function, p, s, u, y);
    return before - *TIMER_VALUE;
}

static void paint(void)
{
    for (uint32_t *word = diagram_stack_bottom; word < diagram_stack_top; word++)
        *word = PAINT;
}

static uint32_t depth(void)
{
    const uint32_t *word = diagram_stack_bottom;
    while (word < diagram_stack_top && *word == PAINT)
        word++;
    return (uint32_t)((unsigned char *)diagram_stack_top - (unsigned char *)word);
}

static void refuse(uint32_t why)
{
    send(FRAME_REFUSED, &why, sizeof why);
    stop(STOP_FAULT);
}

static unsigned char *taken(unsigned char **free, uint32_t bytes)
{
    unsigned char *const start = *free;
    if (bytes > (uint32_t)(pool_end - start))
        refuse(2);
    *free = start + ((bytes + 7u) & ~7u);
    return start;
}

/* Rows of inputs in, rows of outputs (or with COUNT of timer ticks) back. */
static void run(const uint32_t *request, const Program *program, const void *p, void *s, unsigned char *u, unsigned char *y)
{
    const int counting = request[OPERATION] == COUNT;
    const uint32_t u_size = program->sizes[3], y_size = program->sizes[4], row = counting ? 4u : y_size;
    const uint32_t u_stride = request[U_STRIDE] ? u_size : 0u, y_stride = request[Y_STRIDE] ? row : 0u;
    uint32_t most = MOST_BYTES / (u_size > row ? u_size : row);
    most = most < 1u ? 1u : most > MOST_ROWS ? MOST_ROWS : most;
    if (!u_stride && request[STEPS])
        receive(u, u_size);
    unsigned char *const counts = y + ((y_size + 7u) & ~7u);
    for (uint32_t done = 0; done < request[STEPS];) {
        const uint32_t left = request[STEPS] - done, rows = left < most ? left : most;
        if (u_stride)
            receive(u, rows * u_size);
        for (uint32_t k = 0; k < rows; k++) {
            if (counting) {
                const uint32_t count = ticks(program->step, p, s, u + k * u_stride, y);
                memcpy(counts + k * y_stride, &count, sizeof count);
            } else {
                call(program->step, p, s, u + k * u_stride, y + k * y_stride);
            }
        }
        done += rows;
        if (y_stride)
            send(FRAME_DATA, counting ? counts : y, rows * row);
        else
            send(FRAME_DATA, y, done < request[STEPS] ? 0u : row);
    }
}

static void answer(const uint32_t *request)
{
    if (request[PROGRAM_INDEX] >= program_count)
        refuse(0);
    const Program *const program = &programs[request[PROGRAM_INDEX]];
    for (int i = 0; i < 5; i++)
        if (request[SIZES + i] != program->sizes[i])
            refuse(1);
    unsigned char *free = pool_start;
    const uint32_t rows = request[OPERATION] >= RUN ? MOST_ROWS : 0u;
    unsigned char *const p = taken(&free, program->sizes[1]), *const s = taken(&free, program->sizes[2]);
    const uint32_t u_size = program->sizes[3], y_size = program->sizes[4];
    unsigned char *const u = taken(&free, rows ? u_size + MOST_BYTES : 0u);
    unsigned char *const y = taken(&free, rows ? y_size + MOST_BYTES + 8u : 0u);

    if (request[OPERATION] != DEFAULTS)
        receive(p, program->sizes[1]);
    if (request[OPERATION] >= RUN)
        receive(s, program->sizes[2]);
    if (request[WATCH])
        paint();
    switch (request[OPERATION]) {
    case DEFAULTS:
        memset(p, 0, program->sizes[1]);
        call(program->defaults, p, 0, 0, 0);
        send(FRAME_DATA, p, program->sizes[1]);
        break;
    case PREPARE:
        call(program->prepare, p, 0, 0, 0);
        send(FRAME_DATA, p, program->sizes[1]);
        break;
    case INIT:
        call(program->init, p, s, 0, 0);
        send(FRAME_DATA, s, program->sizes[2]);
        break;
    default:
        run(request, program, p, s, u, y);
        send(FRAME_DATA, s, program->sizes[2]);
    }
    uint32_t last[2] = {0, 0};
    if (request[WATCH])
        last[0] = depth();
    if (request[OPERATION] == COUNT)
        last[1] = ticks(nothing, p, s, u, y);
    send(FRAME_END, last, sizeof last);
}

void serve(void)
{
    static const char input[] = "to_target", output[] = "from_target";
    const uint32_t reading[3] = {(uint32_t)input, MODE_READ, sizeof input - 1};
    const uint32_t writing[3] = {(uint32_t)output, MODE_WRITE, sizeof output - 1};
    from_host = semihosting(SYS_OPEN, reading);
    to_host = semihosting(SYS_OPEN, writing);
    if (from_host < 0 || to_host < 0)
        stop(STOP_FAULT);
    *TIMER_RELOAD = 0xffffffffu;
    *TIMER_VALUE = 0xffffffffu;
    *TIMER_CTRL = 1u;
    for (;;) {
        uint32_t request[REQUEST_WORDS];
        receive(request, sizeof request);
        answer(request);
    }
}
