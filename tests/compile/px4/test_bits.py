"""The C of a module, built with all of PX4's flags, gives the bits of the host."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.compile.differential import Case, random_cases, same
from tests.compile.px4.build import C_FLAGS, PX4_FLAGS, run
from tests.compile.px4.host import build_controller, controller_files, replay
from twodof.blocks import Block, Diagram, Port, sqrt
from twodof.compile import build
from twodof.compile.program.lower import lower
from twodof.compile.px4.controller import DT, EXACT, TYPES

pytestmark = pytest.mark.slow

STEPS = 2_000
FMA = Path("/proc/cpuinfo").exists() and " fma " in Path("/proc/cpuinfo").read_text()
LOGGED = 12  # of the signals of a random diagram; more do not fit into a message


def differing(
    case: Case, folder: Path, flags: Sequence[str] = EXACT, edit: Callable[[Path], None] | None = None
) -> list[str]:
    """The signals of `case` in which the module's C and the host's native program are not the same, bit for bit."""
    kinds = {name: signal.kind for name, signal in lower(case.diagram, DT, case.paths).outputs.items()}
    for name in [n for n in case.diagram.outputs if kinds[n] not in TYPES]:
        del case.diagram.outputs[name]
    log = [path for path in dict.fromkeys(case.paths) if kinds[path] in TYPES][:LOGGED]
    columns = case.columns(STEPS)
    program, found = build_controller(case.diagram, log, folder, flags, edit)
    given = replay(program, found, columns)
    expected: dict[str, NDArray[Any]] = (
        build(case.diagram, DT, "float32", log).machine().run(STEPS, {k: _float32(v) for k, v in columns.items()})
    )
    assert set(given) == set(expected)
    return [path for path in expected if not np.all(same(given[path], expected[path]))]


def _float32(column: NDArray[Any]) -> NDArray[Any]:
    with np.errstate(over="ignore"):
        return column.astype(np.float32) if column.dtype.kind == "f" else column


@pytest.mark.parametrize(
    "seed", [*range(700, 704), *(pytest.param(n, marks=pytest.mark.soak) for n in range(704, 720))]
)
def test_random_diagrams_give_the_same_bits_under_px4s_flags_without_a_warning(seed: int, tmp_path: Path) -> None:
    (case,) = random_cases([seed], STEPS)
    assert differing(case, tmp_path) == []


def swings() -> Case:
    """Quotients and products of sums, in which PX4's flags change bits."""
    d = Diagram("swings")
    for name in ("a", "b", "c"):
        d.input(name)
    d.add("swing", Swing(), a="a", b="b", c="c")
    d.output("y", "swing.y")
    d.output("z", "swing.z")
    random = np.random.default_rng(7)
    rows = [{n: float(np.float32(v)) for n, v in zip("abc", random.normal(0, 1, 3), strict=True)} for _ in range(STEPS)]
    return Case(d, [], rows, {})


class Swing(Block):
    """Two numbers divided by a third, which PX4's flags would multiply by its reciprocal; a product and a sum."""

    inputs = (Port("a"), Port("b"), Port("c"))
    outputs = (Port("y"), Port("z"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"y": u.a / u.c + u.b / u.c + (u.a * u.b) / u.c, "z": u.b * u.c + u.a}


def test_px4s_flags_alone_change_bits(tmp_path: Path) -> None:
    assert differing(swings(), tmp_path) == []
    assert differing(swings(), tmp_path, ()) == ["y"]


def test_nothing_is_called_but_memory_functions(tmp_path: Path) -> None:
    d = Diagram("root")
    d.input("q")
    d.add("root", Root(), u="q")
    d.output("M", "root")
    _, path = controller_files(d, [], tmp_path)
    flags = [*C_FLAGS, "-O2", *PX4_FLAGS.split(), *EXACT, f"-I{tmp_path}"]
    run(["gcc", *flags, "-c", str(path), "-o", str(tmp_path / "c.o")])
    assert set(re.findall(r"^ +U (\w+)$", run(["nm", str(tmp_path / "c.o")]), re.MULTILINE)) <= {"memcpy", "memset"}


class Root(Block):
    """A square root and a quotient, which a library might be called for."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return sqrt(u.u) + abs(u.u) / (1.0 + u.u)


@pytest.mark.skipif(not FMA, reason="this processor has no fused multiply-add to contract to")
def test_a_contraction_would_be_seen(tmp_path: Path) -> None:
    # The pragma in the C file forbids it whatever the command line says, so it is taken out here.
    def contracting(path: Path) -> None:
        text = path.read_text()
        changed = text.replace('"fp-contract=off", ', "")
        assert changed != text
        path.write_text(changed)

    assert differing(swings(), tmp_path, (*EXACT, "-ffp-contract=fast", "-mfma"), contracting) == ["z"]
