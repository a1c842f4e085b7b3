#ifndef TWODOF_STRING_H
#define TWODOF_STRING_H
#include <stddef.h>
void *memset(void *to, int byte, size_t size);
void *memcpy(void *restrict to, const void *restrict from, size_t size);
void *memmove(void *to, const void *from, size_t size);
int memcmp(const void *a, const void *b, size_t size);
/* So that copies of a few bytes stay instructions with -ffreestanding too. */
#define memset __builtin_memset
#define memcpy __builtin_memcpy
#define memmove __builtin_memmove
#define memcmp __builtin_memcmp
#endif
