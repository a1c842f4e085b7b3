/* memcpy and its kin under the names of the run-time ABI for the Arm architecture (IHI 0043, section 4.3.4), which clang
   calls. In assembly, because clang would make calls of these very names of them. */

#define ALIASES(name)                                                                                                  \
    void name##4(void) __attribute__((alias(#name)));                                                                  \
    void name##8(void) __attribute__((alias(#name)));

__attribute__((naked)) void __aeabi_memcpy(void)
{
    __asm__ volatile("b.w memcpy");
}
ALIASES(__aeabi_memcpy)

__attribute__((naked)) void __aeabi_memmove(void)
{
    __asm__ volatile("b.w memmove");
}
ALIASES(__aeabi_memmove)

/* (to, bytes, value) instead of (to, value, bytes) */
__attribute__((naked)) void __aeabi_memset(void)
{
    __asm__ volatile("mov r3, r1\n\t"
                     "mov r1, r2\n\t"
                     "mov r2, r3\n\t"
                     "b.w memset");
}
ALIASES(__aeabi_memset)

/* (to, bytes) */
__attribute__((naked)) void __aeabi_memclr(void)
{
    __asm__ volatile("mov r2, r1\n\t"
                     "movs r1, #0\n\t"
                     "b.w memset");
}
ALIASES(__aeabi_memclr)
