"""A program's header: a user's own C and C++ calls the program through it, with the bits of the reference."""

import re
import subprocess
from pathlib import Path

import pytest

from tests.compile import examples
from tests.toolchains import need
from twodof.blocks import Diagram
from twodof.blocks.library import Gain, Sum
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.c_files.c_files import CFiles, c_files
from twodof.errors import DiagramError, LogError

pytestmark = pytest.mark.slow

STRICT = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow", "-Wundef"]
OF_C = ["-Wmissing-prototypes", "-Wstrict-prototypes"]  # C++ has no functions without a prototype
COMPILERS = {"c99": ("gcc", "-std=c99"), "c11": ("gcc", "-std=c11"), "c++": ("g++", "-std=c++11")}
STEPS = 12

MAIN = r"""
#include <math.h>
#include <stdio.h>
#include "loop.h"
#include "slow.h"

int main(void)
{
    static loop_P p;
    static loop_S s;
    static loop_U u;
    static loop_Y y;
    static slow_P slow_p;
    static slow_S slow_s;
    static slow_U slow_u;
    static slow_Y slow_y;
    loop_defaults(&p);
    p.k = 1.5;
    loop_prepare(&p);
    loop_init(&p, &s);
    slow_defaults(&slow_p);
    slow_prepare(&slow_p);
    slow_init(&slow_p, &slow_s);
    for (int k = 0; k < 12; k++) {
        u.r = 0.1 * k;
        loop_step(&p, &s, &u, &y);
        slow_u.r = 0.25f * (float)k;
        slow_step(&slow_p, &slow_s, &slow_u, &slow_y);
        printf("%a %a %a\n", y.y, s.x.pendulum_q, (double)slow_y.theta);
    }
    return (int)(sizeof(loop_S) - LOOP_BYTES) + (int)(sizeof(slow_S) - SLOW_BYTES);
}
"""


def compiled(language: str, folder: Path, source: str, *more: str) -> Path:
    """`source` as an object file, by a strict compiler of this language."""
    compiler, _ = COMPILERS[language]
    need(compiler)
    file = folder / f"main.{'cpp' if compiler == 'g++' else 'c'}"
    file.write_text(source, encoding="utf-8")
    return compile_file(language, file, *more)


def compile_file(language: str, file: Path, *more: str) -> Path:
    compiler, standard = COMPILERS[language]
    strict = [*STRICT, *(OF_C if compiler == "gcc" else [])]
    target = file.with_suffix(".o")
    command = [compiler, standard, *strict, "-ffp-contract=off", *more, "-c", str(file), "-o", str(target)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return target


@pytest.fixture(scope="module")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CFiles, CFiles]:
    """Two programs of one diagram in one folder: in double, and in float at another rate with the tables."""
    folder = tmp_path_factory.mktemp("firmware")
    loop = c_files(examples.loop(), 0.01)
    slow = c_files(examples.loop(), 0.02, "float32", name="slow", tables=True)
    loop.write(folder)
    slow.write(folder)
    return folder, loop, slow


def judged() -> list[list[float]]:
    """Return the numbers that MAIN prints, by the reference."""
    loop = Reference(examples.loop(), 0.01, "float64").machine()
    slow = Reference(examples.loop(), 0.02, "float32").machine()
    loop.set("k", 1.5)
    loop.reset()
    rows = []
    for k in range(STEPS):
        y = loop.step({"r": 0.1 * k})["y"]
        theta = slow.step({"r": 0.25 * k})["theta"]
        rows.append([float(v) for v in (y, loop.state("pendulum.q"), theta)])
    return rows


@pytest.mark.parametrize("language", COMPILERS)
def test_two_programs_in_one_firmware_give_the_references_bits(
    language: str, firmware: tuple[Path, CFiles, CFiles], tmp_path: Path
) -> None:
    folder, loop, slow = firmware
    sizes = [f"-DLOOP_BYTES={loop.emitted.sizes[2]}u", f"-DSLOW_BYTES={slow.emitted.sizes[2]}u"]
    main = compiled(language, tmp_path, MAIN, f"-I{folder}", *sizes)
    own = "c99" if language == "c++" else language
    objects = [compile_file(own, folder / f"{n}.c", "-O1") for n in ("loop", "slow")]
    program = tmp_path / "main"
    subprocess.run([COMPILERS[language][0], "-o", str(program), str(main), *map(str, objects)], check=True)
    said = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert said.returncode == 0  # the sizes are as stated
    assert [[float.fromhex(v) for v in line.split()] for line in said.stdout.splitlines()] == judged()


def typed() -> Diagram:
    """Ports of each type, an array and a matrix, with names that C++ keeps for itself."""
    d = Diagram("typed", "ports of each type")
    d.input("new", unit="m")
    d.input("class", "int32")
    d.input("this", "bool")
    d.input("vector", width=3)
    d.input("m", shape=(2, 3))
    for kind in ("int8", "uint8", "int16", "uint16", "float32", "float64"):
        d.input(f"of_{kind}", kind)
        d.output(f"{kind}_out", f"of_{kind}")
    d.param("errno", 1.0)
    for name in ("new", "class", "this", "vector", "m"):
        d.output(f"{name}_out", name)
    d.add("template", Gain(), u="new", params={"k": "errno"})
    d.output("private", "template")
    return d


@pytest.mark.parametrize("language", ["c99", "c++"])
def test_the_loop_in_the_header_compiles(language: str, tmp_path: Path) -> None:
    """As it stands there; what reads and writes is the user's. C++ takes each name."""
    made = c_files(typed(), 0.01)
    made.write(tmp_path)
    example = re.search(r"uses them:\n\n(.*?\n\n.*?)\n\n", made.header, re.DOTALL)
    assert example
    shown = re.sub(r"^ *\.\.\. .*\n", "", example[1], flags=re.MULTILINE)  # "and 5 more"
    declared, body = shown.split("\n\n")
    given = dict.fromkeys(re.findall(r"\bread_\w+\(\)", body), "1")  # a number; else a function takes an array
    taken = {f"{name}(a)": "((void)(a))" for name in re.findall(r"\b((?:read|write)_\w+)\([^)]", body)}
    macros = "".join(f"#define {call} {value}\n" for call, value in {**given, **taken}.items())
    source = f'#include <errno.h>\n#include "typed.h"\n{macros}int main(void)\n{{\n{declared}\n{body}\n}}\n'
    compiled(language, tmp_path, source, f"-I{tmp_path}", "-fsyntax-only")


def test_the_header_says_units_bounds_defaults_and_the_order_of_a_matrix() -> None:
    text = c_files(typed(), 0.01).header
    assert "double m[6]; /* 2 x 3, column after column */" in text
    assert "[m]" in text
    loop = c_files(examples.loop(), 0.01).header
    assert "double k; /* gain of the feedback; default 2, at least 0, at most 10 */" in loop
    assert "double sum_limit; /* sum.limit [rad] largest magnitude of the integral; default 1, at least 0 */" in loop
    assert "Sizes [bytes] where a double is aligned to 8: P 64, S 40, U 8, Y 16." in loop


def test_nothing_visible_is_without_the_prefix(firmware: tuple[Path, CFiles, CFiles]) -> None:
    """The functions, types, macros and tables of two programs in one firmware do not clash."""
    for made in firmware[1:]:
        code = re.sub(r"/\*.*?\*/", "", made.header, flags=re.DOTALL)
        names = re.findall(r"^(?:#define |\} ?|void |extern const \w+ )(\w+)", code, flags=re.MULTILINE)
        assert len(names) > 8
        assert all(n.startswith(f"{made.name}_") for n in names), names
        assert re.findall(r"\breal\b", code) == []  # the other program's may be another type


def test_a_name_that_hides_a_header_of_c_is_refused() -> None:
    d = Diagram("string")
    d.input("u")
    d.output("y", "u")
    with pytest.raises(DiagramError, match=r"string\.h is a standard header of C"):
        c_files(d, 0.01)
    assert sorted(c_files(d, 0.01, name="text").files) == ["text.c", "text.h"]


def test_neither_file_is_written_if_one_is_there(tmp_path: Path) -> None:
    d = Diagram("sums")
    d.input("u")
    d.add("sum", Sum("++"), a="u", b="u")
    d.output("y", "sum")
    made = c_files(d, 0.01)
    (tmp_path / "sums.c").write_text("mine", encoding="utf-8")
    with pytest.raises(LogError, match="is there already"):
        made.write(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["sums.c"]
    assert [p.name for p in made.write(tmp_path, overwrite=True)] == ["sums.h", "sums.c"]
    assert (tmp_path / "sums.c").read_text(encoding="utf-8") == made.emitted.source
