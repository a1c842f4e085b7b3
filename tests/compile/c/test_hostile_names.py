"""Legal names that mean something elsewhere, and texts made to break out: C and WebAssembly hold them all.

Only identifiers come in as names (tests/blocks/schema/test_hostile.py). These are identifiers that C, its headers, its
compilers, the linker or the emitted file itself use.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.compile.differential import KINDS, Case, Judgement, differences, emitted, reference_run
from tests.toolchains import need
from twodof.blocks import Block, Diagram, Param, Port, State
from twodof.blocks.schema.json_form import from_json, to_json

KEYWORDS = """auto break case char const continue default do double else enum extern float for goto if inline int long
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while asm
    typeof bool true false alignas alignof constexpr nullptr thread_local static_assert class new delete this template
    typename namespace using public private virtual operator and or not xor try catch throw export import friend"""
HEADERS = """NULL size_t ptrdiff_t wchar_t int32_t uint32_t uint64_t intptr_t INT32_MAX INT32_MIN UINT32_MAX UINT32_C
    offsetof memcpy memset memmove strlen printf malloc free abort exit errno stdin EOF INFINITY NAN M_PI I complex
    linux unix i386 arm wasm assert main step advance init fini environ abs floor sin exp log pow sqrt y0 j1 gamma"""
OURS = """real p s u y x k n i j t P S U Y X tick none td td_inline td_sin td_exp defaults prepare run sizes parameters
    signals Entry Held derivative integrate path unit where type count offset low high due held next initial counter
    memory stack wasm_export exports module instance start e E0 f L0 nan inf"""
NAMES = sorted({*KEYWORDS.split(), *HEADERS.split(), *OURS.split()})
TEXTS = (
    '"',
    "\\",
    "*/ int evil; /*",
    "??/",
    "%s%n",
    "\n#error broken\n",
    "é θ ² µ",
    "//\\",
    "`$(id)`",
    "</script>",
    "'",
)


class Named(Block):
    """A gain, a sum and a counter whose ports, states and parameters all have the name it is given."""

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        self.inputs = [Port(name)]
        self.outputs = [Port(name)]
        self.params = [Param(name, 0.5, low=-2.0, high=2.0, text=text)]
        self.states = [State(name), State(f"{name}_2", 1.0, continuous=True)]

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return p[self.name] * u[self.name] + x[self.name]

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {self.name: 0.25 * (x[self.name] + u[self.name])}

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {f"{self.name}_2": u[self.name] - x[f"{self.name}_2"]}


def diagram(name: str, text: str) -> Diagram:
    """A diagram `name` in which everything else has this name too: part, block, ports, states and parameters."""
    inner = Diagram(name)
    inner.input(name)
    inner.add(f"{name}_2", Named(name, text), inputs={name: name})
    inner.output(name, f"{name}_2")
    d = Diagram(name, text)
    d.input(f"{name}_1")
    d.add(name, inner, inputs={name: f"{name}_1"})
    d.output(name, name)
    return d


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    """Each diagram as it comes from a file; some with texts that would end a comment or a string."""
    made = [from_json(to_json(diagram(n, TEXTS[k % len(TEXTS)]))) for k, n in enumerate(NAMES)]
    rows = [{"u": 0.5}, {"u": -1.0}, {}, {"u": 3.0}]
    return [Case(d, [], [{f"{d.name}_1": r["u"]} if r else {} for r in rows], {}) for d in made]


@pytest.fixture(scope="module")
def expected(cases: list[Case]) -> list[Judgement]:
    """What the reference says of them."""
    return [reference_run(c, "float64", "rk4") for c in cases]


# An engine gives each program all exports of its module: more in one would cost the square of their number.
TOGETHER = {"gcc-O0": len(NAMES), "zig-O0": len(NAMES), "m7-gcc": len(NAMES), "wasm": 24, "v8": 24}


@pytest.mark.parametrize("kind", TOGETHER)
def test_any_identifier_may_name_anything(
    kind: str, cases: list[Case], expected: list[Judgement], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Many in one file, so that a name of one diagram could meet that of another."""
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path))
    need(*KINDS[kind].needs)
    for at in range(0, len(cases), TOGETHER[kind]):
        some = slice(at, at + TOGETHER[kind])
        program = emitted(cases[some], "float64", "rk4")
        assert not differences(cases[some], expected[some], program, KINDS[kind].target)
