"""Images: both compilers, levels of optimisation, the cache, what does not fit, what is missing, sizes."""

import importlib.util
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.blocks.library.samples import random_inputs
from tests.compile.cortex_m7.hand_written import ADD, COMPILERS, STEP, image
from tests.compile.differential import same
from tests.patience import PATIENCE_S
from tests.toolchains import need
from twodof.blocks import Diagram
from twodof.compile import build
from twodof.compile.cortex_m7.image import find_cross_compiler
from twodof.compile.cortex_m7.processor import CortexM7
from twodof.compile.cortex_m7.report import image_sizes
from twodof.compile.toolchain import compilers
from twodof.compile.toolchain.compilers import Compiler
from twodof.errors import CompileError
from twodof.flight.core import core
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_the_second_time_no_compiler_runs(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need("arm-none-eabi-gcc")
    first = image(ADD)
    assert {f.suffix for f in cache.iterdir()} == {".m7", ".m7o"}
    built: list[Sequence[str]] = []

    def counted(compiler: Compiler, arguments: Sequence[str], folder: Path) -> subprocess.CompletedProcess[bytes]:
        built.append(arguments)
        return run(compiler, arguments, folder)

    run = compilers.run_compiler
    monkeypatch.setattr(compilers, "run_compiler", counted)
    assert image(ADD) == first
    assert not built
    image(ADD, optimise="-O1")
    assert [arguments[-1] for arguments in built] == ["program.o", "dispatch.o", "image.elf"]  # the firmware is kept


@pytest.mark.parametrize("name", ["gcc", pytest.param("zig", marks=pytest.mark.soak)])
def test_code_of_five_megabytes_does_not_fit(name: str) -> None:
    if name == "gcc":
        need("arm-none-eabi-gcc")
    table = "static const uint32_t table[1310720] = {1u};\n" + STEP + "{ y->a = table[u->a]; }"
    with pytest.raises(CompileError, match="do not fit into the board's 4 MB"):
        image(table, name)


@pytest.mark.parametrize("name", COMPILERS)
def test_what_a_compiler_refuses_is_an_error_with_its_words(name: str) -> None:
    if name == "gcc":
        need("arm-none-eabi-gcc")
    with pytest.raises(CompileError, match=r"refused the generated C(.|\n)*nonsense"):
        image(STEP + "{ nonsense }", name)
    with pytest.raises(CompileError, match=r"refused the generated C(.|\n)*absent"):
        image("void absent(void);" + STEP + "{ absent(); }", name)


def test_without_a_cross_compiler_the_error_names_package_and_wheel(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(shutil, "which", lambda *_: None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "ziglang" else find(name, *a))
    for name in (None, "gcc", "zig"):
        with pytest.raises(CompileError, match=r"gcc-arm-none-eabi\) or the wheel ziglang"):
            find_cross_compiler(name)
    with pytest.raises(CompileError, match="apt-get install gcc-arm-none-eabi"):
        build(Diagram("empty"), 0.01, target="cortex-m7")


def test_the_sizes_are_those_that_binutils_read(tmp_path: Path) -> None:
    need("arm-none-eabi-gcc")
    made = image("uint32_t seen[25], start[3] = {1u};\n" + STEP + "{ seen[u->a % 25u]++; y->a = start[u->a % 3u]; }")
    file = tmp_path / "image.elf"
    file.write_bytes(made.elf)
    command = ["arm-none-eabi-size", "-A", str(file)]
    rows = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=True).stdout.splitlines()
    theirs = {r.split()[0]: int(r.split()[1]) for r in rows if r.startswith(".")}
    ours = image_sizes(made)
    assert ours.text + ours.rodata == theirs[".text"]
    assert (ours.data, ours.bss) == (theirs[".data"], theirs[".bss"])
    assert ours.data >= 12
    assert ours.bss >= 100


STEPS = 5000


@pytest.mark.parametrize("optimise", ["-O0", "-Os", *(pytest.param(o, marks=pytest.mark.soak) for o in ("-O1", "-O3"))])
def test_the_level_of_optimisation_changes_no_bit(optimise: str) -> None:
    need("qemu-system-arm", "arm-none-eabi-gcc")
    inputs = {
        name: column.astype("float32") if column.dtype.kind == "f" else column
        for name, column in random_inputs(core(), STEPS, 1, False).items()
    }
    machines = [build(core(), PERIOD, "float32", target=t).machine() for t in ("native", CortexM7("gcc", optimise))]
    here, there = (machine.run(STEPS, inputs) for machine in machines)
    assert [name for name in here if not same(here[name], there[name]).all()] == []
    for path in machines[0].program.states:
        assert same(*(np.atleast_1d(np.array(machine.state(path))) for machine in machines)).all(), path
