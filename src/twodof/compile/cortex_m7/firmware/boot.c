/* Start-up of the processor: vector table, memory, floating-point unit; and what a fault says. */
#include "server.h"

extern uint32_t server_stack_top[], data_image[], data_start[], data_end[], bss_start[], bss_end[];

static volatile uint32_t *const CPACR = (volatile uint32_t *)0xe000ed88u;
static volatile uint32_t *const MPU_CTRL = (volatile uint32_t *)0xe000ed94u;
static volatile uint32_t *const MPU_RNR = (volatile uint32_t *)0xe000ed98u;
static volatile uint32_t *const MPU_RBAR = (volatile uint32_t *)0xe000ed9cu;
static volatile uint32_t *const MPU_RASR = (volatile uint32_t *)0xe000eda0u;
static volatile uint32_t *const CFSR = (volatile uint32_t *)0xe000ed28u;
static volatile uint32_t *const HFSR = (volatile uint32_t *)0xe000ed2cu;
static volatile uint32_t *const MMFAR = (volatile uint32_t *)0xe000ed34u;
static volatile uint32_t *const BFAR = (volatile uint32_t *)0xe000ed38u;

/* Fields of MPU_RASR, with the bit that enables the region; SIZE is a power of two. */
enum { READ_ONLY = 6 << 24, READ_WRITE = 3 << 24, NO_CODE = 1 << 28 };
#define SIZE(log2) ((uint32_t)((log2)-1) << 1 | 1u)

void reset(void);
void fault(void);
void report_fault(const uint32_t *frame, uint32_t exc_return);

/* Stack, reset, and the 14 exceptions of the architecture, none of which is expected. */
__attribute__((section(".vectors"), used)) static void *const vectors[16] = {
    server_stack_top, reset, fault, fault, fault, fault, fault, fault,
    fault,            fault, fault, fault, fault, fault, fault, fault,
};

void reset(void)
{
    for (uint32_t *to = data_start, *from = data_image; to < data_end;)
        *to++ = *from++;
    for (uint32_t *to = bss_start; to < bss_end;)
        *to++ = 0;
    /* Only what is there can be accessed, and code cannot be written, as in the flash of a real one: a null pointer or a
       stack that grows too far is a fault. (The board has placeholders around its memories that swallow writes.) */
    static const uint32_t regions[][2] = {
        {0x00000000u, READ_ONLY | SIZE(22)},             /* code: 4 MB */
        {0x20000000u, READ_WRITE | NO_CODE | SIZE(22)},  /* stacks, variables: 4 MB */
        {0x60000000u, READ_WRITE | NO_CODE | SIZE(24)},  /* structs and rows: 16 MB */
        {0x40000000u, READ_WRITE | NO_CODE | SIZE(12)},  /* timer */
    };
    for (uint32_t i = 0; i < sizeof regions / sizeof regions[0]; i++) {
        *MPU_RNR = i;
        *MPU_RBAR = regions[i][0];
        *MPU_RASR = regions[i][1];
    }
    *MPU_CTRL = 1u;
    /* Full access to the floating-point unit. FPSCR stays 0: to nearest, subnormal numbers kept, NaNs propagated. */
    *CPACR |= 0xfu << 20;
    __asm__ volatile("dsb\n\tisb\n\tvmsr fpscr, %0" : : "r"(0) : "memory");
    serve();
}

/* On a stack of its own, because that of the diagram may be what is broken. */
__attribute__((naked)) void fault(void)
{
    __asm__ volatile("mov r0, sp\n\t"
                     "mov r1, lr\n\t"
                     "ldr r2, =fault_stack_top\n\t"
                     "mov sp, r2\n\t"
                     "b report_fault\n\t"
                     ".ltorg");
}

__attribute__((used)) void report_fault(const uint32_t *frame, uint32_t exc_return)
{
    /* What is found here is read by `board.py`: r0 to r3, r12, lr, pc, xpsr of the frame, then these. */
    uint32_t words[14] = {0};
    const uint32_t at = (uint32_t)frame;
    if (at >= 0x20000000u && at <= 0x203fffe0u) /* else the stack left the memory */
        for (int i = 0; i < 8; i++)
            words[i] = frame[i];
    words[8] = at;
    words[9] = exc_return;
    words[10] = *CFSR;
    words[11] = *HFSR;
    words[12] = *MMFAR;
    words[13] = *BFAR;
    send(FRAME_FAULT, words, sizeof words);
    stop(STOP_FAULT);
}
