"""Memory functions without a C library, and the check of the structs' layout."""

import ctypes
import dataclasses
import random

import pytest

from tests.compile import examples
from twodof.compile import native as target
from twodof.compile.builder import emit_program
from twodof.compile.c.operators import FREESTANDING_MEMORY
from twodof.compile.target import layout_checks
from twodof.compile.toolchain import compilers
from twodof.errors import CompileError


@pytest.fixture(scope="module")
def library() -> ctypes.CDLL:
    source = f"#include <stddef.h>\n#include <stdint.h>\n{FREESTANDING_MEMORY}"
    flags = ("-ffreestanding", "-Wl,-Bsymbolic")  # its own functions, not those of this process
    return target.load(source, compilers.find_compiler(), flags=flags)


def test_memory_is_moved_filled_and_compared_at_any_offset(library: ctypes.CDLL) -> None:
    """Against Python's slices: moves that overlap in both directions, sizes that are not multiples of a word."""
    rng = random.Random(2)
    memcmp = library.memcmp
    for _ in range(3000):
        before = rng.randbytes(80)
        buffer = ctypes.create_string_buffer(before, 80)
        at = ctypes.addressof(buffer)
        to, source, size = rng.randrange(40), rng.randrange(40), rng.randrange(40)
        expected = bytearray(before)
        call = rng.choice(("memset", "memmove", "memcpy", "memcmp"))
        if call == "memset":
            byte = rng.randrange(-300, 300)
            library.memset(ctypes.c_void_p(at + to), byte, ctypes.c_size_t(size))
            expected[to : to + size] = bytes([byte % 256]) * size
        elif call == "memcmp":
            first, second = before[to : to + size], before[source : source + size]
            same = rng.random() < 0.5
            found = memcmp(
                ctypes.c_void_p(at + to), ctypes.c_void_p(at + (to if same else source)), ctypes.c_size_t(size)
            )
            wanted = 0 if same else (first > second) - (first < second)
            assert (found > 0) - (found < 0) == wanted
        elif call == "memmove" or abs(to - source) >= size:
            getattr(library, call)(ctypes.c_void_p(at + to), ctypes.c_void_p(at + source), ctypes.c_size_t(size))
            expected[to : to + size] = before[source : source + size]
        assert buffer.raw == bytes(expected), (call, to, source, size)


@pytest.mark.parametrize(
    ("declared", "instead"),
    [
        ("double pendulum_omega;", "float pendulum_omega;"),
        ("uint32_t tick;", "uint8_t tick;"),
        ("double pendulum_theta;", "double moved; double pendulum_theta;"),
    ],
)
def test_a_struct_that_numpy_sees_otherwise_does_not_compile(declared: str, instead: str) -> None:
    program = emit_program(examples.loop(), 0.01)
    source = program.source.replace("real ", "double ")
    checks = layout_checks([program])
    compiler = compilers.find_compiler()
    assert target.load(source + checks, compiler, "-O0") is not None
    assert source.count(declared) >= 1
    wrong = dataclasses.replace(program, source=source.replace(declared, instead))
    with pytest.raises(CompileError, match="_Static_assert"):
        target.load(wrong.source + checks, compiler, "-O0")
