"""Legal names that mean something elsewhere, and texts made to break out: C and WebAssembly hold them all.

Only identifiers come in as names (tests/blocks/schema/test_hostile.py). These are identifiers that C, its headers, its
compilers, the linker or the emitted file itself use.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.compile.differential import KINDS, Case, Judgement, differences, emitted, reference_run
from tests.toolchains import need
from twodof.blocks import Block, Diagram, Param, Port, State, sin, to_int32, to_real, to_uint32
from twodof.blocks.library import Gain
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile.native import Native
from twodof.compile.target import EmittedProgram

pytestmark = pytest.mark.slow

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
LINKED = """main init fini environ start memory stack wasm_export exports module instance abort exit malloc free errno
    memcpy memset memmove run step defaults sizes printf"""
"""Names that a linker, a start-up or a host of a module could take for its own."""
NAMES = sorted({*LINKED.split(), *KEYWORDS.split(), *HEADERS.split(), *OURS.split()})
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


JOINED = [
    *(("int32", "t"), ("int32", "add"), ("real_to", "int32"), ("td", "sin"), ("td", "inline"), ("INT32", "MIN")),
    *(("prog", name) for name in ("X", "P", "Held", "derivative", "integrate", "along", "step")),
]
"""Names of a part and of its ports that mean something once joined; "prog" is the diagram's own name."""


class Named(Block):
    """A gain, a sum and helpers of the emitted C; ports, states and parameters all have the name it is given."""

    def __init__(self, name: str, text: str = "") -> None:
        self.name = name
        self.inputs = [Port(name)]
        self.outputs = [Port(name)]
        self.params = [Param(name, 0.5, low=-2.0, high=2.0, text=text)]
        self.states = [State(name), State(f"{name}_2", 1.0, continuous=True)]

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        n = to_int32(u[self.name])
        return p[self.name] * sin(u[self.name]) + x[self.name] + to_real((n + 1) * n) + to_real(to_uint32(n))

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {self.name: 0.25 * (x[self.name] + u[self.name])}

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {f"{self.name}_2": u[self.name] - x[f"{self.name}_2"]}


def nested(name: str) -> Diagram:
    """A diagram `name` in which everything else has this name too: part, block, ports, states and parameters."""
    inner = Diagram(name)
    inner.input(name)
    inner.add(f"{name}_2", Named(name, TEXTS[len(name) % len(TEXTS)]), inputs={name: name})
    inner.output(name, f"{name}_2")
    return inner


def all_in_one() -> Diagram:
    """Every name, nested in one diagram, so that each could meet every other."""
    d = Diagram("names", "".join(TEXTS))
    for name in NAMES:
        d.input(f"{name}_1")
        d.add(name, nested(name), inputs={name: f"{name}_1"})
        d.output(name, name)
    return d


def passing(name: str, text: str) -> Diagram:
    """A small diagram that itself has the name; its text would end a comment or a string."""
    d = Diagram(name, text)
    d.input(f"{name}_1")
    d.add(name, Gain(2.0), inputs={"u": f"{name}_1"})
    d.output(name, name)
    return d


def cases(diagrams: list[Diagram]) -> list[Case]:
    """Each diagram as it comes from a file."""
    found = [from_json(to_json(d)) for d in diagrams]
    rows = (0.5, -1.0, None, 3.0)
    return [Case(d, [], [dict.fromkeys(d.inputs, u) if u is not None else {} for u in rows], {}) for d in found]


@pytest.fixture(scope="module")
def judged() -> list[tuple[Case, Judgement]]:
    """All names in one diagram; each as a diagram's own; and what the reference says of them."""
    made = cases([all_in_one(), *(passing(n, TEXTS[k % len(TEXTS)]) for k, n in enumerate(NAMES))])
    return [(c, reference_run(c, "float64", "rk4")) for c in made]


TITLES = {"gcc-O0": len(NAMES), "zig-O0": len(NAMES), "m7-gcc": 24, "wasm": 24, "v8": 24}
"""How many names each compiles as a diagram's own: the same gcc and zig read the C of the others."""


Chosen = tuple[list[Case], list[Judgement], list[EmittedProgram]]


@pytest.fixture(scope="module")
def chosen(judged: list[tuple[Case, Judgement]]) -> Callable[[int], Chosen]:
    """All names in one diagram and so many as a diagram's own; what the reference says of them; and their C."""

    @cache
    def made(titles: int) -> Chosen:
        own = sorted(judged[1:], key=lambda pair: pair[0].diagram.name not in LINKED.split())[:titles]
        some, expected = [case for case, _ in (judged[0], *own)], [said for _, said in (judged[0], *own)]
        return some, expected, emitted(some, "float64", "rk4")

    return made


def test_joined_names_do_not_collide() -> None:
    made = []
    for number, (part, port) in enumerate(JOINED):
        d = Diagram(f"prog{number}")
        d.input(port)
        name = d.name if part == "prog" else part
        d.add(name, Named(port), **{port: port})
        d.add("behind", Named(port), **{port: f"{name}.{port}"})
        d.output(port, f"behind.{port}")
        made.append(d)
    some = cases(made)
    expected = [reference_run(case, "float64", "rk4") for case in some]
    assert not differences(some, expected, emitted(some, "float64", "rk4"), Native("gcc", "-O0", cpu=False))


@pytest.mark.long
@pytest.mark.parametrize("kind", TITLES)
def test_any_identifier_may_name_anything(
    kind: str, chosen: Callable[[int], Chosen], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All in one file, so that a name of one diagram could meet that of another."""
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path))
    need(*KINDS[kind].needs)
    some, expected, programs = chosen(TITLES[kind])
    target: Any = KINDS[kind].target
    assert not differences(some, expected, programs, replace(target, optimise="-O0"))
