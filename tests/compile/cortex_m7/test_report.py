"""Bytes, stack and instructions of programs whose cost is known in advance."""

import json

import numpy as np
import pytest

from tests.compile import examples
from tests.compile.cortex_m7.hand_written import ADD, COMPILERS, STEP, image, pair
from tests.toolchains import need
from twodof.compile import build
from twodof.compile.cortex_m7.processor import Processor
from twodof.compile.cortex_m7.report import CortexM7Report, Usage, measure
from twodof.compile.machine import CompiledProgram
from twodof.errors import CompileError
from twodof.flight.core import core

pytestmark = pytest.mark.slow

NAKED = "__attribute__((naked)) void hand_step(const Pair *p, Pair *s, const Pair *u, Pair *y)"


@pytest.fixture(autouse=True)
def tools() -> None:
    need("qemu-system-arm", "arm-none-eabi-gcc")


@pytest.mark.parametrize(
    ("repeats", "compiler"), [(1, "gcc"), (2, "gcc"), (1000, "gcc"), (100_000, "gcc"), (17, "zig")]
)
def test_the_instructions_of_a_loop_are_counted_one_by_one(repeats: int, compiler: str) -> None:
    """Two for the counter, two in each round; the return is not counted."""
    loop = f'{{ __asm__ volatile("movw r3, #{repeats & 0xFFFF}\\n\\tmovt r3, #{repeats >> 16}\\n\\t1: subs r3, #1\\n\\t'
    step = NAKED + loop + 'bne 1b\\n\\tbx lr"); }'
    with Processor(image(step, compiler), counting=True) as processor:
        counts, _ = processor.count(0, pair(), pair(), pair(), 20)
    assert (counts == 2 + 2 * repeats).all()


def test_each_step_has_its_own_count() -> None:
    """u.a rounds of two instructions: 1 to load, 2 each, the return not counted."""
    step = NAKED + '{ __asm__ volatile("ldr r3, [r2]\\n\\t1: subs r3, #1\\n\\tbne 1b\\n\\tbx lr"); }'
    rounds = np.random.default_rng(1).integers(1, 5000, 600)
    u = pair(rows=600)
    u["a"] = rounds
    with Processor(image(step), counting=True) as processor:
        counts, _ = processor.count(0, pair(), pair(), u, 600)
    assert np.array_equal(counts, 1 + 2 * rounds)


def test_a_processor_that_does_not_count_says_so() -> None:
    with Processor(image(ADD)) as processor, pytest.raises(CompileError, match="counting=True"):
        processor.count(0, pair(), pair(), pair(), 1)


def seen(processor: Processor) -> int:
    """The stack that a step used, by the paint."""
    return processor.run(0, pair(), pair(), pair(), pair(), 1, watch=True)


NESTED = """
__attribute__((noinline)) void inner(volatile uint8_t *x)
{
    volatile uint8_t own[200];
    for (int i = 0; i < 200; i++)
        own[i] = x[i];
}
__attribute__((noinline)) void outer(void)
{
    volatile uint8_t own[400];
    for (int i = 0; i < 400; i++)
        own[i] = 1;
    inner(own);
}
"""


@pytest.mark.parametrize("compiler", COMPILERS)
def test_the_stack_of_nested_calls_is_the_sum_of_their_frames(compiler: str) -> None:
    """600 bytes of arrays, and what three functions save: at most 16 words each."""
    made = image(NESTED + STEP + "{ outer(); y->a = 1u; }", compiler)
    bound = Usage(made).stack("hand_step")
    assert bound is not None
    with Processor(made) as processor:
        assert 600 <= seen(processor) <= bound <= 600 + 3 * 64


@pytest.mark.parametrize(
    "step",
    [
        "int down(int n) { return n < 2 ? n : down(n - 1) + down(n - 2); }\n" + STEP + "{ y->a = (uint32_t)down(3); }",
        STEP + "{ volatile char room[u->a + 1u]; room[0] = 1; y->a = (uint32_t)room[0]; }",
        STEP + "{ y->a = (uint32_t)((uint64_t)u->a * 0x123456789u / (u->b + (uint64_t)s->a + 1u)); }",
    ],
    ids=["recursion", "variable-frame", "library"],
)
def test_a_stack_without_a_bound_is_none(step: str) -> None:
    assert Usage(image(step)).stack("hand_step") is None


@pytest.mark.parametrize("compiler", COMPILERS)
def test_the_bytes_are_those_of_what_is_called_and_read(compiler: str) -> None:
    table = "static const uint32_t table[250] = {1u, 2u};\nstatic const uint32_t idle[500] = {3u};\n"
    table += "static uint32_t count[10];\nuint32_t unused(int i) { return idle[i]; }\n"
    usage = Usage(image(table + STEP + "{ y->a = table[u->a % 250u]; count[u->b % 10u]++; }", compiler))
    sizes = usage.sizes(["hand_step"])
    assert (sizes.rodata, sizes.data, sizes.bss) == (1000, 0, 40)
    assert 10 <= sizes.text <= 200
    assert usage.sizes(["hand_step", "unused"]).rodata == 3000
    with pytest.raises(CompileError, match="has no function 'hand_stop'"):
        usage.sizes(["hand_stop"])


@pytest.mark.parametrize(("compiler", "precision"), [("gcc", "float64"), ("gcc", "float32"), ("zig", "float32")])
def test_the_flight_core_stays_within_its_bound(compiler: str, precision: str) -> None:
    program = build(core(), 0.004, precision, target="cortex-m7", compiler=compiler)
    assert isinstance(program, CompiledProgram)
    r = np.random.default_rng(1)
    rows = {
        name: r.normal(size=500) if p.kind == "real" else r.integers(0, 2, 500).astype(p.kind)
        for name, p in program.flat.inputs.items()
    }
    report = measure(program, 500, rows)
    assert isinstance(report, CortexM7Report)
    assert report.stack is not None
    assert 0 < report.stack_seen <= report.stack
    assert report.structs == {k: program.dtypes[k].itemsize for k in "PSUY"}
    assert report.code.ram == 0  # no globals
    assert 0 < report.step.flash <= report.flash < report.image.flash
    assert report.instructions.shape == (500,)
    assert report.instructions.min() > 100
    assert json.loads(json.dumps(report.to_json()))["stack_bytes_bound"] == report.stack


def test_only_a_program_for_this_target_can_be_measured() -> None:
    program = build(examples.loop(), 0.01)
    assert isinstance(program, CompiledProgram)
    with pytest.raises(CompileError, match='target="cortex-m7"'):
        measure(program)
