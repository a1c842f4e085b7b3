"""Traceability, both ways: every line of the generated step has an owner, every block that runs has lines."""

import re

import pytest

from tests.compile.random_diagrams import Maker
from twodof.blocks import Diagram
from twodof.blocks import library as lib
from twodof.compile.builder import EmittedProgram, emit_program
from twodof.compile.c.functions import COMMENTS
from twodof.compile.c_files.c_files import SourceMap, source_map
from twodof.compile.program.check import compiled
from twodof.flight.core import core
from twodof.rig.rig import rig
from twodof.sim.closed_loop import closed_loop

pytestmark = pytest.mark.slow

BODIES = ("step",)
STATED = {*COMMENTS, "condition", "head", "one step", "unused argument"}


def mapped(diagram: Diagram, dt: float, precision: str = "float64") -> tuple[SourceMap, EmittedProgram]:
    emitted = emit_program(diagram, dt, precision)
    return source_map(emitted), emitted


def conditional() -> Diagram:
    """Rates, edges, enabled and reset sub-diagrams with continuous and discrete states, something nobody needs."""
    inner = Diagram("inner")
    inner.input("v")
    inner.add("memory", lib.UnitDelay(), u="v")
    inner.add("lag", lib.FirstOrder(), u="memory")
    inner.add("late", lib.FractionalDelay(0.0033), u="v")
    inner.add("after", lib.Integrator(), u="late")
    inner.output("w", "lag")
    inner.output("z", "after")
    d = Diagram("conditional")
    d.input("u")
    d.input("on", "bool")
    d.add("sub", inner, enable="on", reset="on", disabled="reset", v="u")
    d.add("slow", lib.ZeroOrderHold(), rate=(3, 1), u="u")
    d.add("mean", lib.MovingAverage(4), rate=(3, 1), u="slow")
    d.add("idle", lib.Gain(3.0), u="u")
    d.output("y", "sub.w")
    d.output("z", "sub.z")
    d.output("m", "mean")
    return d


DIAGRAMS = {
    "core": (core, 0.004),
    "rig": (rig, 0.001),
    "loop": (closed_loop, 0.001),
    "conditional": (conditional, 0.001),
}


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", DIAGRAMS)
def test_each_line_has_an_owner_and_each_block_that_runs_has_lines(name: str, precision: str) -> None:
    make, dt = DIAGRAMS[name]
    found, emitted = mapped(make(), dt, precision)
    check(found, emitted)


@pytest.mark.parametrize("seed", range(8))
def test_random_diagrams_too(seed: int) -> None:
    diagram = Maker(seed).diagram(f"random{seed}")
    found, emitted = mapped(diagram, 0.001)
    check(found, emitted)


def check(found: SourceMap, emitted: EmittedProgram) -> None:
    body = [line for line in found.lines if line.part in BODIES]
    assert body
    assert [line for line in body if line.executable and not line.block and line.role not in STATED] == []
    runs = set(compiled(emitted.flat))
    assert {line.block for line in body if line.block} == runs
    assert set(found.left_out) == set(found.blocks) - runs
    # The member of S or X that a line writes belongs to the block whose line it is.
    layout, program = emitted.layout, emitted.flat
    owner = {layout.states[n, s.name].name: n.path for n in program.nodes for s in n.block.states if not s.continuous}
    owner |= {m.name: s.node.path for s, m in layout.stored.items() if s.node is not None}
    written = 0
    for line in body:
        target = re.match(r"\s*s->(\w+)(?:\[[^\]]*\])? = ", line.text)
        if target and target[1] in owner and line.role != "disabled outputs":
            written += 1
            assert line.block == owner[target[1]], line
    assert written or not owner


def test_a_value_in_the_c_is_found_under_the_block_that_has_it() -> None:
    found, _ = mapped(conditional(), 0.001)
    default = next(line for line in found.lines if line.part == "defaults" and "0.0033" in line.text)
    assert default.block == "sub.late"
    assert found.left_out == ("idle",)
    ranges = found.of("mean")
    assert set(ranges) == {"P", "S", "defaults", "prepare", "init", "step"}
    for part, rows in ranges.items():
        for first, last in rows:
            assert all(line.block == "mean" and line.part == part for line in found.lines[first - 1 : last])
    assert "step" not in found.of("idle")


def test_hostile_texts_claim_no_lines() -> None:
    d = Diagram("hostile", "*/ /* a: Gain */ void hostile_step(")
    d.input("u", unit="*/ } /* what is returned */")
    d.param("k", 2.0, text="/* a: Gain */")
    d.add("a", lib.Gain(input_unit="*/ } /* what is returned */"), u="u", params={"k": "k"})
    d.add("b", lib.Gain(), u="a")
    d.output("y", "b")
    found, emitted = mapped(d, 0.001)
    check(found, emitted)
