"""What emitted C needs where there is no C library: four functions on memory, and a check of the structs' layout."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from twodof.compile.program.layout import Member
from twodof.compile.target import EmittedProgram

STRING_H = """#ifndef TWODOF_STRING_H
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
"""

FILES = {"string.h": STRING_H}
"""For `toolchain.compiled(..., files=FILES)` with the option `-I.`."""

MEMORY = """
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
"""
"""C to append to a source that is linked without a C library."""


def layout_checks(programs: Sequence[EmittedProgram]) -> str:
    """C to append to the source of `programs`, which does not compile if a struct is not where numpy expects it."""
    lines = []
    for program in programs:
        for kind, size in zip("PSUY", program.sizes[1:], strict=True):
            struct = f"{program.name}_{kind}"
            lines.append(f'_Static_assert(sizeof({struct}) == {size}, "size of {struct}");')
            for member, offset, width in _members(program, kind):
                place = f"offsetof({struct}, {member}) == {offset} && sizeof((({struct} *)0)->{member}) == {width}"
                lines.append(f'_Static_assert({place}, "place of {member}");')
    return "\n" + "\n".join(lines) + "\n"


def _members(program: EmittedProgram, kind: str) -> Iterator[tuple[str, int, int]]:
    """Each member's name in C, offset and size; the names are the layout's own, which are identifiers of C."""
    layout, dtype = program.layout, program.dtypes[kind]
    members: dict[str, Iterable[Member]] = {
        "P": layout.p.members,
        "S": layout.s.members,
        "U": layout.u.members,
        "Y": layout.y.members,
    }
    fields: Mapping[str, Any] = dtype.fields or {}
    for m in members[kind]:
        yield m.name, fields[m.name][1], fields[m.name][0].itemsize
    if kind == "S" and "x" in fields:
        x, start = fields["x"][:2]
        inner: Mapping[str, Any] = x.fields or {}
        for m in layout.x.members:
            yield f"x.{m.name}", start + inner[m.name][1], inner[m.name][0].itemsize
