"""Whatever goes wrong on the processor or with its emulator becomes a typed error in bounded time."""

import gc
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.compile import examples
from tests.compile.cortex_m7.hand_written import ADD, STEP, emulators, image, pair, steps
from tests.patience import PATIENCE_S, patiently
from tests.processes import alive
from tests.toolchains import need
from twodof.compile import CompiledProgram, build
from twodof.compile.cortex_m7 import processor as board
from twodof.compile.cortex_m7.image import Image
from twodof.compile.cortex_m7.processor import DEFAULTS, INIT, PREPARE, CortexM7, Processor
from twodof.compile.cortex_m7.report import ObjectFile
from twodof.compile.target import EmittedProgram
from twodof.errors import CompileError, ControllerFault

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def tools() -> None:
    need("qemu-system-arm", "arm-none-eabi-gcc")


def symbol(made: Image, name: str) -> int:
    """The address of a function."""
    (found,) = [s["st_value"] & ~1 for s in ObjectFile(made.elf).symbols if s.name == name]
    return found


def test_the_four_functions_work_on_their_structs() -> None:
    p, s = pair(), pair()
    with Processor(image(ADD)) as processor:
        processor.call(0, DEFAULTS, p, s)
        assert p[0].item() == (1, 2)
        processor.call(0, PREPARE, p, s)
        assert p[0].item() == (1, 3)
        processor.call(0, INIT, p, s)
        assert s[0].item() == (1, 3)
        u, y = pair(rows=1000), pair(rows=1000)
        u["a"], u["b"] = np.arange(1000), np.arange(1000)[::-1]
        processor.run(0, p, s, u, y, 1000)
        assert np.array_equal(y["a"], 1 + np.cumsum(np.arange(1000) + 1))
        assert np.array_equal(y["b"], u["b"])
        assert s["a"][0] == y["a"][-1]


@pytest.mark.parametrize(("u_rows", "y_rows"), [(1, 700), (700, 1), (1, 1)])
def test_one_row_is_read_or_written_at_each_step(u_rows: int, y_rows: int) -> None:
    """700 steps are more than the 256 that the processor takes at once."""
    p, s, u, y = pair(), pair(), pair(2, 9, rows=u_rows), pair(rows=y_rows)
    with Processor(image(ADD)) as processor:
        processor.run(0, p, s, u, y, 700)
        assert s["a"][0] == y["a"][-1] == 1400
        assert y["a"][0] == (2 if y_rows == 700 else 1400)
        before = y.copy()
        processor.run(0, p, s, u, y, 0)
        assert np.array_equal(before, y)


FAULTS = {
    "undefined instruction": STEP + '{ __asm__ volatile("udf #1"); }',
    "write into code": STEP + "{ *(volatile uint32_t *)0 = 1u; }",
    "access to an address without memory": STEP + "{ y->a = *(volatile uint32_t *)0x30000000u; }",
    "even address": STEP + "{ ((void (*)(void))(uintptr_t)(u->a & ~1u))(); }",
    "memory without code": STEP + "{ ((void (*)(void))0x60000001u)(); }",
    "stack outside of memory": "volatile int deep = 1;\n"
    "__attribute__((noinline)) int down(int n) { volatile int room[64]; room[n & 63] = n;"
    " return deep ? down(n + 1) + room[0] : 0; }\n" + STEP + "{ y->a = (uint32_t)down(0); }",
}


@pytest.mark.parametrize("words", FAULTS)
def test_a_fault_names_its_cause_and_the_registers(words: str) -> None:
    made = image(FAULTS[words])
    with Processor(made) as processor, pytest.raises(ControllerFault, match=words) as caught:
        steps(processor, 3)
    assert caught.value.where == "hand"
    found = re.search(r"pc=([0-9a-f]{8}).* cfsr=([0-9a-f]{8})", str(caught.value))
    assert found is not None
    assert int(found[2], 16) != 0
    if words in ("undefined instruction", "write into code", "access to an address without memory"):
        start = symbol(made, "hand_step")
        assert start <= int(found[1], 16) < start + 32


def test_after_a_fault_the_processor_starts_afresh() -> None:
    step = STEP + "{ if (u->a == 7u) __builtin_trap(); s->a += u->a; }"
    p, s, y = pair(), pair(), pair()
    with Processor(image(step)) as processor:
        processor.run(0, p, s, pair(3), y, 5)
        with pytest.raises(ControllerFault):
            processor.run(0, p, s, pair(7), y, 5)
        assert s["a"][0] == 15  # as before the call that failed
        processor.run(0, p, s, pair(1), y, 5)
        assert s["a"][0] == 20


def test_a_machine_that_faulted_stays_so_and_a_new_one_runs() -> None:
    good = build(examples.loop(), 0.01, target="cortex-m7").emitted
    source = good.source.replace("    s->tick += 1u;", "    if (s->tick == 3u) __builtin_trap();\n    s->tick += 1u;")
    assert source != good.source
    wrong = EmittedProgram(good.flat, source, good.layout, good.precision)
    program = CompiledProgram(wrong, CortexM7().compile([wrong])[0])
    machine = program.machine()
    machine.run(3, {"r": 1.0})
    for _ in range(2):
        with pytest.raises(ControllerFault, match="undefined instruction"):
            machine.step()
    assert machine.tick == 3
    with pytest.raises(ControllerFault):
        machine.set("k", 1.0)
    assert machine.get("k") == 2.0
    assert len(program.machine().run(3, {"r": 1.0})["y"]) == 3


def test_what_the_emulator_said_before_its_end_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault that is told, and the emulator gone, while the host was between its last write and its next look."""
    others = emulators(os.getpid())
    with Processor(image(STEP + "{ __builtin_trap(); }")) as processor:
        processor.call(0, DEFAULTS, pair(), pair())
        (emulator,) = emulators(os.getpid()) - others
        write = os.write

        def slow(descriptor: int, data: bytes) -> int:
            sent = write(descriptor, data)
            end = time.monotonic() + 0.5  # what was sent may not yet be the last of the parts
            while alive(emulator) and time.monotonic() < end:
                time.sleep(0.01)
            return sent

        monkeypatch.setattr(os, "write", slow)
        with pytest.raises(ControllerFault, match="undefined instruction"):
            steps(processor)
        assert not alive(emulator)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("echo no such board >&2; exit 3", "ended with status 3: no such board"),
        ("kill -9 $$", "ended with status -9: no message"),
        ("exec sleep 1000", "sent nothing for 1 s"),
        ("printf 'garbage garbage garbage' > from_target; exec sleep 1000", "an unknown answer of kind"),
        (r"printf '\001\000\000\000\004\000\000\000abc' > from_target; exit 1", "ended with status 1"),
        (
            r"printf '\002\000\000\000\010\000\000\000abcdefgh' > from_target; exec sleep 1000",
            "has 0 bytes, expected 8",
        ),
    ],
)
def test_a_broken_emulator_is_an_error(
    script: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = image(ADD)
    fake = tmp_path / "qemu-system-arm"
    fake.write_text(f"#!/bin/sh\n{script}\n")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr(board, "SILENCE", 1.0 if "sent nothing" in words else PATIENCE_S)
    with Processor(made) as processor, pytest.raises(ControllerFault, match=words):
        processor.call(0, DEFAULTS, pair(), pair())


def test_an_emulator_that_does_not_start_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = image(ADD)
    fake = tmp_path / "qemu-system-arm"
    fake.write_text("no program")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    with Processor(made) as processor, pytest.raises(CompileError, match=r"does not start.*install qemu-system-arm"):
        processor.call(0, DEFAULTS, pair(), pair())


def test_without_qemu_the_error_names_its_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made = image(ADD)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(CompileError, match="apt-get install qemu-system-arm"):
        Processor(made)


def test_structs_that_the_memory_cannot_hold_are_refused_before() -> None:
    wrong = Image(**{**vars(image(ADD)), "sizes": ((4, 8, 2**24, 8, 8),)})
    with Processor(wrong) as processor, pytest.raises(CompileError, match="the board has 16777216"):
        processor.run(0, pair(), pair(), pair(), pair(), 1)


def test_the_emulator_ends_with_its_processor() -> None:
    others = emulators(os.getpid())
    processor = Processor(image(ADD))
    steps(processor)
    assert len(emulators(os.getpid()) - others) == 1
    processor.close()
    assert emulators(os.getpid()) <= others
    steps(processor)  # starts again
    (emulator,) = emulators(os.getpid()) - others
    folder = Path(f"/proc/{emulator}/cwd").resolve()
    assert folder.is_dir()
    del processor
    gc.collect()
    assert not alive(emulator)
    assert not folder.exists()


def test_the_emulator_ends_when_python_is_killed() -> None:
    code = (
        "import time\n"
        "from tests.compile.cortex_m7.hand_written import ADD, image, steps\n"
        "from twodof.compile.cortex_m7.processor import Processor\n"
        "processor = Processor(image(ADD))\n"
        "steps(processor)\n"
        "print('it runs', flush=True)\n"
        "time.sleep(1000)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=PROJECT) as python:
        assert python.stdout is not None
        assert python.stdout.readline() == "it runs\n"
        (emulator,) = emulators(python.pid)
        folder = Path(f"/proc/{emulator}/cwd").resolve()
        python.kill()
        python.wait(PATIENCE_S)
        for _ in patiently():
            if not alive(emulator):
                break
    shutil.rmtree(folder)  # nobody was left to do it
