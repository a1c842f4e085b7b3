/* memcpy and its kin under the names of the run-time ABI for the Arm architecture (IHI 0043, section 4.3.4), which clang
   calls. */
#include <string.h>

#define COPIES(name)                                                                                                   \
    void __aeabi_##name(void *to, const void *from, size_t bytes)                                                      \
    {                                                                                                                  \
        name(to, from, bytes);                                                                                         \
    }                                                                                                                  \
    void __aeabi_##name##4(void *, const void *, size_t) __attribute__((alias("__aeabi_" #name)));                     \
    void __aeabi_##name##8(void *, const void *, size_t) __attribute__((alias("__aeabi_" #name)));
COPIES(memcpy)
COPIES(memmove)

void __aeabi_memset(void *to, size_t bytes, int value)
{
    memset(to, value, bytes);
}
void __aeabi_memset4(void *, size_t, int) __attribute__((alias("__aeabi_memset")));
void __aeabi_memset8(void *, size_t, int) __attribute__((alias("__aeabi_memset")));

void __aeabi_memclr(void *to, size_t bytes)
{
    memset(to, 0, bytes);
}
void __aeabi_memclr4(void *, size_t) __attribute__((alias("__aeabi_memclr")));
void __aeabi_memclr8(void *, size_t) __attribute__((alias("__aeabi_memclr")));
