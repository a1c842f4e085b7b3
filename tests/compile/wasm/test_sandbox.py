"""Limits of a module: no imports, bounded time and memory, no calls after a fault."""

import dataclasses
import functools
import gc
import importlib
import time
from typing import Any

import numpy as np
import pytest

from tests.blocks.library.samples import ROOMS, random_inputs
from tests.compile import examples
from tests.compile.whole_library import room
from twodof.blocks import Diagram
from twodof.compile import CompiledMachine, CompiledProgram, build
from twodof.compile.builder import emit_program
from twodof.compile.c.emitter import emit
from twodof.compile.program.lower import lower
from twodof.compile.toolchain import compilers
from twodof.compile.wasm import module, target
from twodof.compile.wasm.module import FUNCTIONS, PAGE, compile_module, find_wasm_compiler, step_fuel
from twodof.compile.wasm.target import Wasm
from twodof.errors import CompileError, ControllerFault
from twodof.sim.closed_loop import closed_loop

pytestmark = pytest.mark.slow

ENDLESS = "for (volatile int k = 0;; k++) {}"


def tampered(place: str, code: str, **options: Any) -> CompiledMachine:
    """The example loop with `code` before `place` in its C, as a faulty compiler could have put it there."""
    program = emit_program(examples.loop(), 0.01)
    assert program.source.count(place) == 1
    program = dataclasses.replace(program, source=program.source.replace(place, f"{code} {place}"))
    (backend,) = Wasm(**options).compile([program])
    return CompiledProgram(program, backend).machine()


def test_a_module_imports_nothing_and_exports_its_functions_and_a_memory_that_cannot_grow() -> None:
    wasmtime = target.wasmtime()
    data = compile_module([emit_program(closed_loop(), 0.001)]).data
    loaded = wasmtime.Module(wasmtime.Engine(), data)
    assert list(loaded.imports) == []
    exports = {e.name: e.type for e in loaded.exports}
    assert set(exports) == {"memory", *(f"closed_loop_{f}" for f in FUNCTIONS)}
    limits = exports["memory"].limits
    assert limits.min == limits.max
    assert limits.min * PAGE < 4 << 20


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (f"if (s->tick == 5u) {ENDLESS}", "fuel"),
        ("if (s->tick == 5u) __builtin_trap();", "unreachable"),
        ("if (s->tick == 5u) *(volatile int *)0xfffffff0u = 1;", "memory out of bounds"),
        ("if (s->tick == 5u) { volatile char big[1 << 22]; big[(int)p->k] = 1; }", "memory out of bounds"),
    ],
    ids=["endless loop", "trap", "outside the memory", "stack too small"],
)
def test_a_fault_stops_the_instance_for_good(code: str, said: str) -> None:
    machine = tampered("s->tick += 1u;", code)
    for k in range(5):
        machine.step({"r": 0.1 * k})
    last = machine.get("k"), machine.state("pendulum.theta")
    start = time.process_time()
    with pytest.raises(ControllerFault, match=said) as caught:
        machine.step()
    assert time.process_time() - start < 1.0
    assert "loop_tick, tick 5" in caught.value.where
    calls = (machine.step, lambda: machine.run(3), machine.reset, lambda: machine.set("k", 1.0))
    for call in calls:
        with pytest.raises(ControllerFault) as again:
            call()
        assert str(again.value) == str(caught.value)
    assert machine.tick == 5
    assert last[0] == machine.get("k")
    fresh = machine.program.machine()
    assert fresh.step({"r": 0.0})["y"] == 0.0


def test_a_fault_in_a_run_is_a_fault_too() -> None:
    machine = tampered("s->tick += 1u;", f"if (s->tick == 5000u) {ENDLESS}")
    with pytest.raises(ControllerFault, match="fuel"):
        machine.run(20_000, {"r": 0.1})
    assert machine.tick == 5000


def test_parameters_stay_where_preparing_them_fails() -> None:
    machine = tampered("p->pendulum_damping =", f"if (p->k == 5.0) {ENDLESS}")
    machine.set_many({"k": 4.0, "pendulum.omega": 3.0})
    before = machine.instance.structs["P"].tobytes()
    with pytest.raises(ControllerFault, match="loop_prepare"):
        machine.set_many({"pendulum.omega": 2.0, "k": 5.0})
    assert machine.instance.structs["P"].tobytes() == before
    assert (machine.get("k"), machine.get("pendulum.omega")) == (4.0, 3.0)


def test_module_that_imports_is_refused() -> None:
    data = target.wasmtime().wat2wasm('(module (import "env" "f" (func)))')
    program = emit_program(examples.loop(), 0.01)
    with pytest.raises(CompileError, match=r"imports env\.f"):
        target.backends(module.WasmModule(data, 1, {"loop": program}, {}))


def test_fuel_can_be_given() -> None:
    """It is looked at where a function begins and at each turn of a loop."""
    scarce = build(examples.loop(), 0.01, target=Wasm(fuel=20)).machine()
    with pytest.raises(ControllerFault, match="loop_run, tick 1: it used up its fuel of 200 instructions"):
        scarce.run(10)
    machine = build(examples.loop(), 0.01, target=Wasm(fuel=5000)).machine()
    assert machine.run(10_000)["y"].shape == (10_000,)
    with pytest.raises(CompileError, match="fuel"):
        build(examples.loop(), 0.01, target=Wasm(fuel=0))


@pytest.mark.long
@pytest.mark.parametrize("optimise", ["-O0", pytest.param("-O3", marks=pytest.mark.soak)])
def test_the_fuel_of_a_step_is_a_bound_with_a_wide_margin(optimise: str) -> None:
    """The fuel, counted in the graphs, bounds the compiler's instructions even without optimisation."""
    worst = 0.0
    diagrams = [
        *(room(name, extra) for name in ROOMS for extra in (False, True)),
        examples.loop(),
        examples.edge(),
        examples.delay(1000),
    ]
    programs = emit([lower(d, 0.004) for d in diagrams])
    for diagram, program, backend in zip(diagrams, programs, Wasm(optimise=optimise).compile(programs), strict=True):
        machine: Any = CompiledProgram(program, backend).machine()
        instance = machine.instance
        inputs = random_inputs(diagram, 40, 1, True)
        for k in range(40):
            machine.step({name: column[k].tolist() for name, column in inputs.items()})
            worst = max(worst, 1.0 - instance._store.get_fuel() / instance.fuel)
    assert 0.0 < worst < 0.2  # .06 is seen without optimisation, .02 with it


def test_a_longer_state_needs_more_fuel() -> None:
    """Setting it to its initial value is work as well; a long delay is started in one call."""
    small, large = (emit_program(examples.delay(n), 0.01) for n in (10, 200_000))
    assert step_fuel(large) > step_fuel(small) + 1_600_000
    (backend,) = Wasm().compile([large])
    assert CompiledProgram(large, backend).machine().run(3, {"u": 1.0})["y"].tolist() == [0.0] * 3


def test_more_memory_than_the_sandbox_has_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LARGEST", 2 << 20)
    with pytest.raises(CompileError, match=r"needs 3 MiB of memory, the sandbox gives 2"):
        build(examples.delay(300_000), 0.01, target="wasm")
    assert build(examples.delay(50_000), 0.01, target="wasm").machine().step({"u": 1.0})["y"] == 0.0


def test_arrays_on_the_memory_outlive_the_machine() -> None:
    def array() -> Any:
        machine = build(examples.delay(1000), 0.01, target="wasm").machine()
        machine.run(1000, {"u": 7.0})
        return machine.instance.structs["S"]["ring_ring"]

    values = array()
    gc.collect()
    others = [build(examples.delay(1000), 0.01, target="wasm").machine() for _ in range(5)]
    assert np.all(values == 7.0)
    assert len(others) == 5


def test_without_wasmtime_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr(importlib, "import_module", missing)
    # Asked for anew, and the one that the programs of other tests have stays theirs.
    monkeypatch.setattr(target, "_engine", functools.cache(target._engine.__wrapped__))
    with pytest.raises(CompileError, match=r"pip install wasmtime"):
        build(examples.loop(), 0.01, target="wasm")


@pytest.mark.parametrize("name", [None, "zig", "clang", "gcc", "/nowhere/clang"])
def test_without_a_compiler_the_error_says_what_to_install(name: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilers.importlib.util, "find_spec", lambda _: None)
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(CompileError, match=r"pip install ziglang"):
        find_wasm_compiler(name)
    with pytest.raises(CompileError, match=r"pip install (wasmtime )?ziglang"):
        build(Diagram("empty"), 0.01, target="wasm", compiler=name)
