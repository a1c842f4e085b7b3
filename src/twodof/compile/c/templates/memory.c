/* The compiler itself calls these. They must not be made into calls of themselves. */
#if defined(__clang__)
#define td_plain __attribute__((no_builtin, noinline))
#else
#define td_plain __attribute__((optimize("no-tree-loop-distribute-patterns"), noinline))
#endif
#undef memset
#undef memcpy
#undef memmove
#undef memcmp
typedef uint32_t __attribute__((may_alias, aligned(1))) td_word;

td_plain void *memset(void *to, int byte, size_t size)
{
    unsigned char *t = to;
    const uint32_t word = 0x01010101u * (unsigned char)byte;
    for (; size >= 4; size -= 4, t += 4)
        *(td_word *)t = word;
    for (; size; size--)
        *t++ = (unsigned char)byte;
    return to;
}

td_plain void *memmove(void *to, const void *from, size_t size)
{
    unsigned char *t = to;
    const unsigned char *f = from;
    if ((uintptr_t)t - (uintptr_t)f >= size) { /* not into what is still to be read */
        for (; size >= 4; size -= 4, t += 4, f += 4)
            *(td_word *)t = *(const td_word *)f;
        for (; size; size--)
            *t++ = *f++;
    } else {
        for (; size; size--)
            t[size - 1] = f[size - 1];
    }
    return to;
}

td_plain void *memcpy(void *restrict to, const void *restrict from, size_t size)
{
    return memmove(to, from, size);
}

td_plain int memcmp(const void *a, const void *b, size_t size)
{
    const unsigned char *x = a, *y = b;
    for (; size; size--, x++, y++)
        if (*x != *y)
            return *x < *y ? -1 : 1;
    return 0;
}
