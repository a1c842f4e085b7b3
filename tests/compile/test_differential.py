"""Faults in the emitter, in the compiler's flags and in the processor, found by the comparison of targets."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compile.differential import KINDS, M7, Case, Judgement, changed, differences, emitted, reference_run, same
from tests.compile.whole_library import SPECIAL, WORDS
from tests.toolchains import need
from twodof.blocks import Diagram
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.library import Convert, DiscreteFilter, Divide, Minimum, Product, Sum
from twodof.compile.c import expressions
from twodof.compile.cortex_m7.processor import CortexM7
from twodof.compile.native import Native
from twodof.compile.target import EmittedProgram, Target
from twodof.compile.wasm.target import Wasm

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("own_cache")]

GCC = Native("gcc", "-O1", cpu=False)
ON_M7 = CortexM7("gcc")


def pairs() -> Case:
    """A minimum, a conversion and an integer quotient of every pair of special values, and sums of products."""
    d = Diagram("pairs")
    for name, kind in (("a", "real"), ("b", "real"), ("c", "real"), ("i", "uint32"), ("j", "uint32")):
        d.input(name, kind)
    d.add("least", Minimum(2), a="a", b="b")
    d.add("quotient", Divide("uint32"), a="i", b="j")
    d.add("whole", Convert("real", "int32"), u="a")
    # Side by side, as the last by name of what waits for nothing: gcc fuses only within one basic block.
    d.add("widened", Product("**"), a="a", b="b")
    d.add("shifted", Sum("++"), a="widened", b="c")
    d.output("shifted", "shifted")
    d.output("least", "least")
    d.output("whole", "whole")
    d.output("quotient", "quotient")
    words = [w % 2**32 for w in WORDS]
    rows = [{"a": a, "b": b} for a in SPECIAL for b in SPECIAL]
    rows += [{"a": 1.0 + k / 7.0, "b": 2.0 / (k + 3.0), "c": k / 3.0} for k in range(40)]
    return Case(d, [], [*rows, *({"i": i, "j": j} for i in words for j in words)], {})


@pytest.fixture(scope="module")
def judged() -> tuple[list[Case], list[Judgement]]:
    """Pairs of special values, with what the reference says of them."""
    cases = [pairs()]
    return cases, [reference_run(c, "float64", "rk4") for c in cases]


@pytest.fixture(scope="module")
def sound(judged: tuple[list[Case], list[Judgement]]) -> Callable[[Target], bool]:
    """Cached test of a target against the reference."""
    cases, expected = judged
    return cache(lambda target: not differences(cases, expected, emitted(cases, "float64", "rk4"), target))


def needs(target: Target) -> None:
    """Skip the test, or fail it, where the target's tools are not there."""
    need(*{"native": ["gcc"], "wasm": [], "cortex-m7": [M7, "arm-none-eabi-gcc"]}[target.name])


_OPERATION = expressions.Renderer._operation


def _swapped(self: expressions.Renderer, name: str, args: Any) -> Any:
    return _OPERATION(self, {"add_real": "sub_real", "sub_real": "add_real"}.get(name, name), args)


_EXPRESSION = expressions.Renderer._expression


def with_reads(text: str, args: Sequence[expressions.Text]) -> expressions.Text:
    return expressions.Text(text, expressions.ATOM, frozenset[str]().union(*(a.reads for a in args)))


def _with_minimum_by(function: str) -> Any:
    def faulty(self: expressions.Renderer, item: Expr, args: Sequence[expressions.Text]) -> expressions.Text:
        compared = [id(a) for a in item.args[0].args] if item.args and item.args[0].op == "lt" else []
        if item.op == "where" and item.kind == "real" and compared == [id(a) for a in item.args[1:]]:
            return with_reads(f"{function}({args[1].text}, {args[2].text})", args)
        return _EXPRESSION(self, item, args)

    return faulty


def _with_plain_conversion(
    self: expressions.Renderer, item: Expr, args: Sequence[expressions.Text]
) -> expressions.Text:
    if item.op == "convert" and item.kind == "int32" and item.args[0].kind == "real":
        return with_reads(f"(int32_t)({args[0].text})", args)
    return _EXPRESSION(self, item, args)


def _with_plain_quotient(self: expressions.Renderer, item: Expr, args: Sequence[expressions.Text]) -> expressions.Text:
    if item.op == "quot" and item.kind == "uint32":
        return with_reads(f"(({args[0].text}) / (({args[1].text}) | ({args[1].text} == 0u)))", args)
    return _EXPRESSION(self, item, args)


@pytest.mark.parametrize(
    ("where", "name", "fault", "target"),
    [
        *((expressions.Renderer, "_operation", _swapped, t) for t in (GCC, Wasm(), ON_M7)),
        (expressions.Renderer, "_expression", _with_minimum_by("__builtin_fmin"), GCC),
        (expressions.Renderer, "_expression", _with_minimum_by("__builtin_fmin"), ON_M7),
        (expressions.Renderer, "_expression", _with_minimum_by("__builtin_wasm_min_f64"), Wasm()),
        (expressions.Renderer, "_expression", _with_plain_conversion, GCC),
        *((expressions.Renderer, "_expression", _with_plain_quotient, t) for t in (GCC, Wasm(), ON_M7)),
    ],
    ids=[
        *(f"plus-for-minus-{n}" for n in ("native", "wasm", "m7")),
        *(f"minimum-of-the-{n}" for n in ("library", "m7", "wasm")),
        "unclamped-conversion",
        *(f"quotient-by-zero-{n}" for n in ("native", "wasm", "m7")),
    ],
)
def test_a_fault_in_the_emitter_is_caught(
    where: Any,
    name: str,
    fault: Any,
    target: Target,
    judged: tuple[list[Case], list[Judgement]],
    sound: Callable[[Target], bool],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    needs(target)
    cases, expected = judged
    right = emitted(cases, "float64", "rk4")
    assert sound(target)
    monkeypatch.setattr(where, name, fault)
    wrong = emitted(cases, "float64", "rk4")
    assert wrong[0].source != right[0].source
    assert differences(cases, expected, wrong, target)


def _loose(source: str) -> str:
    """The source without what forbids contraction in the file itself."""
    return re.sub(r"#if defined\(__clang__\)\n.*?#endif\n", "", source, count=1, flags=re.DOTALL)


CONTRACTED = {
    "native-gcc": (Native("gcc", "-O3", flags=("-ffp-contract=fast",)), ["gcc"]),
    "native-zig": (Native("zig", "-O3", flags=("-ffp-contract=fast",)), []),
    "m7-gcc": (CortexM7("gcc", flags=("-ffp-contract=fast",)), [M7, "arm-none-eabi-gcc"]),
    "m7-zig": (CortexM7("zig", flags=("-ffp-contract=fast",)), [M7]),
}


@pytest.mark.parametrize("name", CONTRACTED)
def test_contraction_is_caught(
    name: str, judged: tuple[list[Case], list[Judgement]], sound: Callable[[Target], bool]
) -> None:
    """a * b + c in one rounding: what compilers do for processors with FMA unless they are told not to."""
    target, programs = CONTRACTED[name]
    need(*programs)
    if name.startswith("native") and "fma" not in Path("/proc/cpuinfo").read_text(encoding="utf-8").split():
        pytest.skip("this processor has no FMA")
    cases, expected = judged
    program = emitted(cases, "float64", "rk4")
    assert differences(cases, expected, changed(program, _loose), target)
    assert sound(replace(target, flags=()))


@pytest.fixture(scope="module")
def decaying() -> tuple[list[Case], list[Judgement], list[EmittedProgram]]:
    """A filter that decays through the subnormal numbers and stays there."""
    d = Diagram("decay")
    d.input("u")
    d.add("f", DiscreteFilter([1.0], [1.0, -0.5]), u="u")
    d.output("y", "f")
    rows = [{"u": 1.0}, *({"u": 0.0} for _ in range(1100))]
    cases = [Case(d, [], rows, {})]
    return cases, [reference_run(cases[0], "float64", "rk4")], emitted(cases, "float64", "rk4")


def _flushing_here(source: str) -> str:
    """Flush-to-zero and denormals-are-zero while the steps of a run last."""
    call = "        decay_advance(p, s, u + k * u_stride, y + k * y_stride);"
    on, off = (f"__builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() {bits});" for bits in ("| 0x8040u", "& ~0x8040u"))
    return source.replace(call, f"{{ {on}\n{call}\n{off} }}")


def _flushing_on_arm(source: str) -> str:
    """FPSCR.FZ, set at the beginning of each step."""
    read, write = '"vmrs %0, fpscr" : "=r"(td_bits)', '"vmsr fpscr, %0" : : "r"(td_bits | 1u << 24)'
    flush = f"unsigned td_bits; __asm__ volatile({read}); __asm__ volatile({write});"
    return re.sub(r"(void decay_advance\([^;{]*\n\{\n)", lambda head: f"{head[1]}    {flush}\n", source)


FLUSH = {"native": (Native("gcc", "-O2", cpu=False), _flushing_here), "m7": (ON_M7, _flushing_on_arm)}


@pytest.mark.parametrize("where", FLUSH)
def test_subnormals_rounded_to_zero_are_caught(
    where: str, decaying: tuple[list[Case], list[Judgement], list[EmittedProgram]]
) -> None:
    """A library built with -ffast-math flushes subnormals in its process, FPSCR.FZ at start-up in a controller."""
    target, change = FLUSH[where]
    needs(target)
    cases, expected, programs = decaying
    assert not differences(cases, expected, programs, target)
    assert differences(cases, expected, changed(programs, change), target)


def test_one_bit_of_one_state_is_found(decaying: tuple[list[Case], list[Judgement], list[EmittedProgram]]) -> None:
    cases, expected, programs = decaying
    states = {k: dict(v) for k, v in expected[0].states.items()}
    (path,) = states[1101]
    states[1101][path] = [-0.0] if isinstance(states[1101][path], list) else -0.0
    assert differences(cases, [replace(expected[0], states=states)], programs, KINDS["zig-O0"].target)


def test_every_nan_is_one_value_and_minus_zero_is_another() -> None:
    a = np.array([0.0, np.nan, 1.0])
    assert same(a, np.array([0.0, -np.nan, 1.0])).all()
    assert list(same(a, np.array([-0.0, 1.0, np.nextafter(1.0, 2.0)]))) == [False, False, False]
