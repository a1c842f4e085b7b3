"""Which modules the sandbox takes: only closed ones, and nothing but a CompileError from any other bytes."""

from __future__ import annotations

import random

import pytest

from tests.compile import examples
from twodof.compile.builder import emit_program
from twodof.compile.wasm import engine
from twodof.compile.wasm.binary import closed
from twodof.compile.wasm.module import FUNCTIONS, STACK, compile_module
from twodof.errors import CompileError

NAMES = [f"loop_{f}" for f in FUNCTIONS]


def assembled(text: str) -> bytes:
    return bytes(engine.wasmtime().wat2wasm(f"(module {text})"))


def plain(name: str) -> str:
    return f'(func (export "{name}"))'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('(import "env" "f" (func)) (memory (export "memory") 1) ' + plain("f"), "imports"),
        ('(func $f) (start $f) (memory (export "memory") 1) ' + plain("f"), "runs something"),
        ('(memory (export "memory") 1)', "exports function f"),
        ('(memory (export "memory") 1) ' + plain("f") + plain("g"), "exports function g"),
        ('(memory (export "memory") 1) (global (export "f") i32 (i32.const 1))', "exports"),
        ('(memory (export "memory") 1 2 shared) ' + plain("f"), "plain memory"),
        ('(memory (export "memory") i64 1) ' + plain("f"), "plain memory"),
        (plain("f"), "exports memory memory"),
    ],
)
def test_what_is_not_closed_is_refused(text: str, said: str) -> None:
    with pytest.raises(CompileError, match=said):
        closed(assembled(text), ["f"], "here")


@pytest.mark.parametrize("limits", ["3", "3 9", "200 65536"])
def test_the_memory_cannot_grow(limits: str) -> None:
    wasmtime = engine.wasmtime()
    grow = '(func (export "f") (result i32) (memory.grow (i32.const 1)))'
    data, pages = closed(assembled(f'(memory (export "memory") {limits}) {grow}'), ["f"], "here")
    assert pages == int(limits.split()[0])
    store = wasmtime.Store()
    exports = wasmtime.Instance(store, wasmtime.Module(store.engine, data), []).exports(store)
    assert exports["memory"].size(store) == pages
    assert exports["f"](store) == -1


@pytest.mark.parametrize(
    ("stack", "constants", "taken"),
    [
        ("1000", ['(data (i32.const 70000) "x")'], True),
        ("1000", [], True),
        ("1001", [], False),
        ("70000", [], False),
        ("-16", [], False),
        ("1000", ['(data (i32.const 69999) "x")'], False),
        ("1000", ['(data (i32.const 70000) "xyz")', '(data (i32.const 8) "x")'], False),
        ("1000", ["(global $g i32 (i32.const 80000))", '(data (global.get $g) "x")'], False),
    ],
)
def test_stack_and_constants_stay_away_from_the_structs(stack: str, constants: list[str], taken: bool) -> None:
    """Structs from 1000 to 70000: the stack, whose start is the first global, before them, constants behind them."""
    text = f'(global (mut i32) (i32.const {stack})) (memory (export "memory") 2) {plain("f")} {" ".join(constants)}'
    module = assembled(text)
    if taken:
        assert closed(module, ["f"], "here", (1000, 70_000))[1] == 2
    else:
        with pytest.raises(CompileError, match="stack or the constants"):
            closed(module, ["f"], "here", (1000, 70000))


def test_the_memory_contains_the_structs() -> None:
    module = assembled('(memory (export "memory") 1) ' + plain("f"))
    assert [closed(module, ["f"], "here", (0, end))[1] for end in (65_536, 65_537, 400_000)] == [1, 2, 7]


def test_damaged_modules_give_only_compile_errors() -> None:
    whole = compile_module([emit_program(examples.loop(), 0.01)]).data
    assert closed(whole, NAMES, "loop")[0] == whole  # closing is idempotent
    rng = random.Random(1)
    refused = 0
    for _ in range(3000):
        data = bytearray(whole[: rng.randrange(len(whole) + 1)] if rng.random() < 0.5 else whole)
        for _ in range(rng.randrange(4)):
            if data:
                data[rng.randrange(min(len(data), 300))] = rng.randrange(256)
        try:
            closed(bytes(data), NAMES, "loop", (STACK, STACK + 1000))
        except CompileError:
            refused += 1
    assert refused > 1000
