"""Programs in C by hand, with the four functions that an image wants, to be wrong or measured in known ways."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.processes import alive, children
from twodof.compile.cortex_m7.image import Image, build_image, find_cross_compiler
from twodof.compile.cortex_m7.processor import Processor

COMPILERS = {"gcc": "arm-none-eabi-gcc", "zig": "zig"}
WORD = 4
SIZES = (WORD, 8, 8, 8, 8)
HEAD = """#include <stddef.h>
#include <stdint.h>
#include <string.h>
typedef struct { uint32_t a, b; } Pair;
const size_t hand_sizes[5] = {4, 8, 8, 8, 8};
void hand_defaults(Pair *p) { p->a = 1u; p->b = 2u; }
void hand_prepare(Pair *p) { p->b = 3u * p->a; }
void hand_init(const Pair *p, Pair *s) { s->a = p->a; s->b = p->b; }
"""
STEP = "void hand_step(const Pair *p, Pair *s, const Pair *u, Pair *y)"
ADD = STEP + "{ s->a += u->a + p->a; y->a = s->a; y->b = u->b; }\n"


def image(step: str, compiler: str = "gcc", optimise: str = "-O2", **options: Any) -> Image:
    """The image of one program `hand` with this `step` (and the functions it calls) in C."""
    return build_image(HEAD + step, [("hand", SIZES)], find_cross_compiler(compiler), optimise, **options)


def pair(a: int = 0, b: int = 0, rows: int = 1) -> NDArray[Any]:
    """Structs with the words a and b."""
    made = np.zeros(rows, [("a", "<u4"), ("b", "<u4")])
    made["a"], made["b"] = a, b
    return made


def steps(processor: Processor, count: int = 1) -> tuple[NDArray[Any], NDArray[Any]]:
    """S and Y after `count` steps from zero."""
    p, s, u, y = pair(), pair(), pair(), pair(rows=count)
    processor.run(0, p, s, u, y, count)
    return s, y


def emulators(python: int) -> set[int]:
    """The emulators that this process has started and that still run."""
    return {n for n, words in children(python).items() if alive(n) and "qemu-system-arm" in "".join(words[:1])}
