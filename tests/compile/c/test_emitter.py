"""The emitted C: readable, without globals or allocation, accepted by strict compilers, usable from C."""

import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from tests.blocks.library.samples import LIBRARY
from tests.compile import differential, examples
from tests.compile.whole_library import library_cases
from twodof.blocks import Block, Diagram, Port, State, store
from twodof.blocks.expressions import numbers
from twodof.blocks.library import Compare, Logic
from twodof.compile import build
from twodof.compile import native as target
from twodof.compile.builder import emit_program
from twodof.compile.c.emitter import emit
from twodof.compile.c.statements import constant
from twodof.compile.program.lower import lower
from twodof.compile.toolchain import compilers
from twodof.flight.core import core
from twodof.flight.starters import STARTERS, starter
from twodof.rig.rig import rig

pytestmark = pytest.mark.slow

STRICT = ["-std=c99", "-ffp-contract=off", "-pedantic", "-Werror", "-Wall", "-Wextra", "-Wshadow", "-Wundef"]
STRICT += ["-Wconversion", "-Wsign-conversion", "-Wmissing-prototypes", "-Wstrict-prototypes", "-Wcast-qual"]
LEAN = ["-Wfloat-equal", "-Wdouble-promotion"]  # what flight controllers' builds warn of in addition
ALL = [examples.loop, examples.switched, examples.edge, examples.delay]


def strictly(compiler: str, source: str, folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    file = folder / "emitted.c"
    file.write_text(source, encoding="utf-8")
    found = compilers.find_compiler(compiler)
    command = [*found.command, *STRICT, *found.flags, *more, "-c", "-o", str(folder / "emitted.o"), str(file)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


class Stores(Block):
    """An array in which elements are replaced `count` times before as many are read."""

    inputs: ClassVar = [Port("i", "int32")]
    outputs: ClassVar = [Port("y")]
    states: ClassVar = [State("a", width=20)]

    def __init__(self, count: int) -> None:
        self.count = count

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        a = x.a
        for k in range(self.count):
            a = store(a, u.i * (k + 1), a[u.i - k] + float(k))
        total = 0.0
        for k in range(self.count):
            total = total + a[u.i + 3 * k]
        return total

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"a": store(store(x.a, u.i, x.a[u.i + 1] + 1.0), u.i + 2, 0.5)}


def stores(count: int) -> Diagram:
    d = Diagram("stores")
    d.input("i", "int32")
    d.add("b", Stores(count), i="i")
    d.output("y", "b")
    return d


def test_reading_what_was_stored_costs_what_is_written() -> None:
    """Each reader asking for each store grew with the square: 300 gave five megabytes."""
    small, large = (len(emit_program(stores(n), 0.01).source) for n in (100, 200))
    assert large < 2.2 * small  # twice, and names that are a digit longer


def test_equal_diagrams_give_equal_c() -> None:
    """The order of objects in memory must not matter: a cache of compiled programs has the text as its key."""
    made = [library_cases(["delays"], 1, True)[0].diagram for _ in range(8)]
    assert len({emit_program(d, 0.01).source for d in made}) == 1


SLOTS = [
    pytest.param("gcc", "float32", marks=pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is missing")),
    ("zig", "float64"),
]


@pytest.mark.long
@pytest.mark.parametrize(("compiler", "precision"), SLOTS)
def test_strict_compilers_do_not_complain(compiler: str, precision: str, tmp_path: Path) -> None:
    cases = differential.random_cases(range(300, 303), 1)
    with numbers.precision(precision):
        sources = [emit([lower(make(), 0.01) for make in ALL], precision)[0].source]
    sources.append(differential.emitted(cases, precision, "rk4")[0].source)
    for source in sources:
        done = strictly(compiler, source, tmp_path, "-O2")
        assert done.returncode == 0, done.stderr


SPARE = (343, 349)
"""Random diagrams that name what they do not read in the end."""


def itself() -> Diagram:
    """Signals that are compared with themselves."""
    d = Diagram("itself")
    d.input("n", "int32")
    d.input("flag", "bool")
    d.add("less", Compare("<", "int32"), a="n", b="n")
    d.add("other", Logic("xor"), a="flag", b="flag")
    d.output("never", "less")
    d.output("no", "other")
    return d


def lean_source(diagrams: Sequence[Diagram], precision: str) -> str:
    with numbers.precision(precision):
        return emit([lower(d, 0.01) for d in diagrams], precision, lean=True)[0].source


@pytest.mark.parametrize(("compiler", "precision"), SLOTS)
def test_lean_c_passes_what_firmware_is_built_with(compiler: str, precision: str, tmp_path: Path) -> None:
    spare = [case.diagram for case in differential.random_cases(SPARE, 1)]
    diagrams = [*(starter(name) for name in ("stock-position", "lqr-attitude")), itself(), *spare]
    done = strictly(compiler, lean_source(diagrams, precision), tmp_path, *LEAN, "-O0")
    assert done.returncode == 0, done.stderr


@pytest.mark.soak
@pytest.mark.parametrize("compiler", ["gcc", "zig"])
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_all_lean_c_passes(compiler: str, precision: str, tmp_path: Path) -> None:
    """The flight core, the rig, all starters, the whole library, and random diagrams."""
    rooms = sorted({block.__module__.rpartition(".")[2] for block in LIBRARY.values()})
    library = [case.diagram for extra in (False, True) for case in library_cases(rooms, 1, extra)]
    drawn = [case.diagram for case in differential.random_cases(range(300, 420), 1)]
    for diagrams in ([core(), rig(), *(starter(name) for name in STARTERS)], library, drawn):
        done = strictly(compiler, lean_source(diagrams, precision), tmp_path, *LEAN, "-O2")
        assert done.returncode == 0, done.stderr


def test_fast_math_is_refused(tmp_path: Path) -> None:
    done = strictly("zig", emit_program(examples.loop(), 0.01).source, tmp_path, "-O2", "-ffast-math")
    assert done.returncode != 0
    assert "fast-math" in done.stderr


def test_the_c_is_readable() -> None:
    source = emit_program(examples.loop(), 0.01, log=("pendulum.q",)).source
    code = re.sub(r"/\*.*?\*/", "", source, flags=re.DOTALL)
    assert not re.search(r"\b(malloc|calloc|free|goto|fmin|fmax|sin|cos|pow|sqrt)\s*\(", code)
    assert "math.h" not in code
    # File scope: types, functions and constant tables, nothing that can change.
    for line in code.splitlines():
        if re.match(r"[A-Za-z]", line) and line.rstrip().endswith((";", "{")) and "(" not in line:
            assert re.match(r"(typedef|extern const|const|static const) ", line), line
    assert not re.search(r"\bstatic (?!inline|const|void|real)", code)
    # Nothing is called step or advance, and all that is visible bears the diagram's name.
    visible = re.findall(r"^(?:void|real|int|bool|const \w+) \*?(\w+)[(\[]", code, flags=re.MULTILINE)
    assert visible
    assert all(name.startswith("loop_") for name in visible), visible
    for path in ("held", "gain", "back", "error", "sum", "pendulum"):
        assert f"/* {path}: " in source
    assert "real k; /* gain of the feedback; default 2, at least 0, at most 10 */" in source
    assert "s->gain_y" in source  # names come from paths
    step = source[source.index("void loop_advance") :]
    order = [step.index(text) for text in ("/* pendulum:", "if (due_4_1)", "/* gain:", "/* error:")]
    assert order == sorted(order)
    assert step.count("if (due_4_1)") == 1  # blocks of one rate share one guard
    assert max(map(len, source.splitlines())) < 260


def test_outputs_and_next_states_share_their_terms() -> None:
    source = emit_program(starter("stock-attitude"), 0.004, "float32").source
    step = source[source.index("void stock_attitude_advance(") :]
    for once in ("u->FLAG_RESET_INT", "s->rate_slope +", "s->rate_error)", "- s->rate_carry"):
        assert step.count(once) == 1, once


def test_whole_numbers_that_are_known_are_not_computed() -> None:
    source = emit_program(rig(), 0.001).source  # the counter of its random numbers is (tick, 0, 0, 0)
    assert not re.search(r"\^ 0u|\b0u \^|\d{5,}u \* 0u", source)
    assert not re.search(r"\((\w+) && \1\)", source)


def test_a_users_text_cannot_leave_its_comment() -> None:
    hostile = Diagram("hostile", "*/ int main(void); /* ??/ \n #include")
    hostile.input("u", unit='"*/\\')
    hostile.param("k", 1.0, unit="%s\n", text="*/ #error /*")
    hostile.output("y", "u")
    source = emit_program(hostile, 0.01).source
    code = re.sub(r"/\*.*?\*/", "", source, flags=re.DOTALL)
    assert "main" not in code
    assert "#error /" not in code
    assert not re.search(r'"[^"\n]*\n', re.sub(r'"[^"\n]*"', "", code))
    assert target.load(source, compilers.find_compiler("zig"), "-O0") is not None


def test_constants_are_exact() -> None:
    rng = np.random.default_rng(1)
    values = [*rng.normal(size=50), 0.0, -0.0, 0.1, 1e-310, 5e-324, 1.7e308, -1 / 3]
    for value in values:
        text = constant(float(value), "real", "float64").text
        assert read(text).hex() == float(value).hex()
        single = constant(float(value), "real", "float32").text
        with np.errstate(all="ignore"):
            rounded = float(np.float32(value))
            if np.isfinite(rounded):
                assert single.endswith("f")
                assert float(np.float32(read(single[:-1]))).hex() == rounded.hex()
    assert constant(2.4, "real", "float32").text == "2.4f"
    assert constant(float("nan"), "real", "float32").text == '__builtin_nanf("")'
    assert constant(-float("inf"), "real", "float64").text == "-__builtin_inf()"
    assert constant(-(2**31), "int32", "float64").text == "INT32_MIN"


def read(text: str) -> float:
    """Return a literal's value."""
    return float.fromhex(text) if "0x" in text else float(text)


MAIN = r"""
#include <stdio.h>
int main(void)
{
    loop_P p;
    loop_S s;
    loop_U u[3] = {{0}};
    loop_Y y[3];
    loop_defaults(&p);
    loop_prepare(&p);
    loop_init(&p, &s);
    u[0].r = u[1].r = u[2].r = 0.5;
    loop_run(&p, &s, u, 1, y, 1, 3);
    for (const loop_Entry *e = loop_parameters; e->path; e++)
        printf("%s [%s] %c %.17g\n", e->path, e->unit, e->type, *(const real *)((const char *)&p + e->offset));
    for (const loop_Entry *e = loop_signals; e->path; e++)
        if (e->where == 'S' && e->type == 'r')
            printf("%s %.17g\n", e->path, *(const real *)((const char *)&s + e->offset));
    printf("y %.17g\n", y[2].y);
    return 0;
}
"""


def test_tables_lead_to_parameters_and_signals(tmp_path: Path) -> None:
    (tmp_path / "main.c").write_text(emit_program(examples.loop(), 0.01).source + MAIN, encoding="utf-8")
    found = compilers.find_compiler()
    command = [*found.command, "-std=c99", *found.flags, "-o", str(tmp_path / "main"), str(tmp_path / "main.c")]
    subprocess.run(command, check=True)
    said = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=True).stdout.splitlines()
    assert "k [] r 2" in said
    assert "sum.limit [rad] r 1" in said
    assert "pendulum.stiffness [] r 4" in said
    machine = build(examples.loop(), 0.01).machine()
    y = machine.run(3, {"r": 0.5})["y"][-1]
    assert f"y {y:.17g}" in said
    assert f"sum.sum {machine.state('sum.sum'):.17g}" in said
    assert f"pendulum.theta {machine.state('pendulum.theta'):.17g}" in said
