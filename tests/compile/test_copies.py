"""Many copies of a block: they share their C, which changes no bit, and what they cost grows with their kinds."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, ClassVar

import pytest

from bench.computing.copies import bank, flash
from tests.compile.c.test_emitter import LEAN, strictly
from tests.compile.differential import KINDS, Case, differences, emitted, reference_run
from tests.compile.random_diagrams import Maker, random_inputs
from tests.toolchains import need
from twodof.blocks import Block, Diagram, Param, Port, State, to_real
from twodof.blocks.expressions import numbers
from twodof.blocks.library import Gain, LowPass, Pid, UnitDelay, ZeroOrderHold
from twodof.compile import CompiledProgram, build
from twodof.compile.builder import emit_program
from twodof.compile.c.emitter import emit
from twodof.compile.c.text import pieces
from twodof.compile.c_files.source_map import source_map
from twodof.compile.program import block_kinds
from twodof.compile.program.lower import lower
from twodof.flight.core import core
from twodof.sim.closed_loop import closed_loop

pytestmark = pytest.mark.slow


@pytest.fixture
def forced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two copies share, however small they are, and functions are cut into pieces of a few lines."""
    monkeypatch.setattr(block_kinds, "FEWEST", 2)
    monkeypatch.setattr(block_kinds, "WORTH", 0)
    monkeypatch.setattr(pieces, "LONGEST", 30)
    monkeypatch.setattr(pieces, "PIECE", 10)


def twins(seed: int, steps: int) -> Case:
    """A random diagram that stands twice in another one, in which blocks therefore have copies."""
    d = Diagram(f"twins{seed}")
    paths: list[str] = []
    for part in ("a", "b"):
        maker = Maker(seed)
        inner = maker.diagram(part)
        for name, port in inner.inputs.items():
            if name not in d.inputs:
                d.input(name, port.kind, width=port.width)
        d.add(part, inner, **{name: name for name in inner.inputs})
        paths += [f"{part}.{path}" for path in maker.paths]
    return Case(d, paths, random_inputs(seed, steps), {})


def shared(cases: list[Case], integrator: str, precision: str, targets: list[str]) -> tuple[str, list[str]]:
    """The C of the cases, and how targets differ from the reference."""
    expected = [reference_run(c, precision, integrator) for c in cases]
    programs = emitted(cases, precision, integrator)
    found = [d for t in targets for d in differences(cases, expected, programs, KINDS[t].target)]
    return programs[0].source, found


@pytest.mark.usefixtures("forced")
@pytest.mark.parametrize(
    ("first", "integrator", "precision", "target"),
    [
        (0, "rk4", "float64", "gcc-O3"),
        (4, "euler", "float32", "gcc-O0"),
        (8, "rk4", "float32", "wasm"),
        (20, "euler", "float64", "m7-gcc"),
    ],
)
def test_random_diagrams_whose_blocks_share_keep_their_bits(
    first: int, integrator: str, precision: str, target: str
) -> None:
    need(*KINDS[target].needs)
    source, found = shared([twins(first, 12)], integrator, precision, [target])
    assert not found
    assert len(re.findall("td_(?:apart|shared) ", source)) > 20


@pytest.mark.soak
@pytest.mark.usefixtures("forced")
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("first", range(0, 60, 4))
def test_many_more_of_them_on_all_targets(first: int, precision: str) -> None:
    targets = [name for name, kind in KINDS.items() if kind.needs != ("node",)]
    need("gcc", "qemu-system-arm", "arm-none-eabi-gcc")
    cases = [twins(seed, 60) for seed in range(first, first + 4)]
    assert not shared(cases, "rk4" if first % 8 else "euler", precision, targets)[1]


class TwoWays(Block):
    """The second output reads an input, which may be the first output; so does the next state."""

    inputs: ClassVar = [Port("u"), Port("v")]
    outputs: ClassVar = [Port("first"), Port("second"), Port("row", width=3)]
    states: ClassVar = [State("x", "start"), State("line", width=4)]
    params: ClassVar = [Param("start", 0.5), Param("k", 2.0), Param("shape", [1.0, -2.0, 3.0], width=3)]

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        line = x.line
        return {
            "first": p.k * x.x + u.u,
            "second": u.v - x.x + line[1],
            "row": [p.shape[0] * u.u, p.shape[1] + x.x, p.shape[2] * to_real(t.tick)],
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"x": 0.5 * x.x + u.v, "line": [u.u, *(x.line[k] for k in range(3))]}


def knotted(count: int) -> Diagram:
    """Copies that read their own output, one input twice, each other's outputs, and a parameter that all share."""
    d = Diagram("knotted")
    d.input("u")
    d.input("on", "bool")
    d.param("common", 0.25)
    for k in range(count):
        d.add(f"loop{k}", TwoWays(), u=f"loop{k - 1}.second" if k else "u", v=f"loop{k}.first")
        d.add(f"same{k}", TwoWays(), u="u", v="u", params={"k": "common"})
        for part in ("loop", "same"):
            d.output(f"{part}_{k}", f"{part}{k}.second")
            d.output(f"{part}_row_{k}", f"{part}{k}.row")
    inner = Diagram("inner")
    inner.input("u")
    for k in range(count):
        inner.add(f"held{k}", TwoWays(), u="u", v=f"held{k}.first")
        inner.output(f"y{k}", f"held{k}.second")
    d.add("inner", inner, enable="on", reset="on", u="u")
    d.add("slowly", ZeroOrderHold(), u="u", rate=(2, 0))
    for k in range(count):
        d.add(f"slow{k}", TwoWays(), u="slowly", v=f"slow{k}.first", params={"k": "common"}, rate=(2, 0))
        d.output(f"slow_{k}", f"slow{k}.second")
    for k in range(count):
        d.output(f"held_{k}", f"inner.y{k}")
    return d


@pytest.mark.parametrize("target", ["gcc-O3", "wasm"])
def test_copies_that_read_themselves_and_each_other(target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(block_kinds, "FEWEST", 3)
    rows = [{"u": 0.3 * k - 1.0, "on": k % 3 != 1} for k in range(12)]
    source, found = shared([Case(knotted(3), [], rows, {})], "rk4", "float64", [target])
    assert not found
    assert "TwoWays[6];" in source


def test_a_parameter_of_one_copy_changes_that_copy_alone() -> None:
    program = build(bank(20), 0.001)
    assert isinstance(program, CompiledProgram)
    assert "pid[20]" in program.source
    machine, other = program.machine(), program.machine()
    machine.set("pid7.Kp", 5.0)
    assert machine.get("pid7.Kp") == 5.0
    errors = {f"e{k}": 1.0 for k in range(20)}
    one, two = machine.step(errors), other.step(errors)
    assert {path for path in one if one[path] != two[path]} == {"M7"}
    machine.set_state("pid3.i", 9.0)
    assert machine.state("pid3.i") == 9.0
    assert machine.state("pid4.i") != 9.0


def test_flash_grows_with_kinds_and_little_with_copies() -> None:
    need("arm-none-eabi-gcc")
    few, many = flash(32, "float32"), flash(64, "float32")
    assert many < 4500
    parameters, call = 8 * 4, 8 * 4  # bytes: what each copy is given, and some instructions that call
    assert (many - few) / 32 <= parameters + call


@pytest.mark.soak
@pytest.mark.parametrize("compiler", ["gcc", "zig"])
def test_64_controllers_fit_into_8_kb_in_float64_too(compiler: str) -> None:
    need("arm-none-eabi-gcc")
    assert flash(64, "float64", compiler) <= 8000


def function(source: str, name: str) -> list[str]:
    """The lines of a function."""
    head = re.search(rf"(?m)^[^\n]*\b{name}\([^\n;]*\)\n{{\n", source)
    assert head is not None, name
    return source[head.end() : source.index("\n}\n", head.end())].splitlines()


def test_the_text_of_all_but_the_calls_stays_as_long() -> None:
    lengths = []
    for count in (20, 40):
        source = emit_program(bank(count), 0.001).source
        names = re.findall(r"(?m)^(?:td_(?:apart|shared) \w+|(?:td_inline )?void) (bank_\w+)\([^\n]*\)\n{", source)
        lengths.append({re.sub(r"bank_\d+", "", n): len(function(source, n)) for n in names})
    few, many = lengths
    assert few.keys() == many.keys() >= {"_pid_prepare", "_pid_init", "_pid_step", "_prepare", "_init", "_advance"}
    grown = {name: many[name] - few[name] for name in few if many[name] != few[name]}
    # A row of parameters each; a comment, a call and what is returned each.
    assert grown == {"_defaults": 20, "_advance": 60}


def test_what_exists_few_times_stays_as_it_was() -> None:
    for d in (closed_loop(), core(), bank(block_kinds.FEWEST - 1)):
        source = emit_program(d, 0.001).source
        assert not re.search(r"(?m)^td_apart void (?!closed_loop_(look_ahead|ticks)\()", source)
        assert not re.search(r"\[0\]\.\w+;", source)


def test_cheap_blocks_share_their_structs_and_stay_in_place() -> None:
    d = Diagram("cheap")
    d.input("u")
    for k in range(20):
        d.add(f"gain{k}", Gain(0.1 * k), u="u")
        d.add(f"low{k}", LowPass(1.0 + k), u=f"gain{k}")
        d.output(f"y{k}", f"low{k}")
    source = emit_program(d, 0.001).source
    assert "const real gain3_y = p->gain[3].k * u->u;" in source
    assert "cheap_gain_output" not in source
    assert "cheap_low_pass_prepare(&p->low_pass[i]);" in source


@pytest.mark.usefixtures("forced")
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_shared_c_passes_strict_compilers(precision: str, tmp_path: Path) -> None:
    need("gcc")
    with numbers.precision(precision):
        source = emit([lower(d, 0.01) for d in (bank(4), knotted(4))], precision, lean=True)[0].source
    assert "_Work work;" in source
    done = strictly("gcc", source, tmp_path, *LEAN, "-O0")
    assert done.returncode == 0, done.stderr[:2000]


def test_names_of_shared_functions_meet_no_others() -> None:
    d = bank(20)
    d.name = "bank"
    other = Diagram("bank_pid")
    other.input("u")
    other.add("bank_pid_step", UnitDelay(), u="u")
    other.add("bank_pid_2_step", Pid(), e="bank_pid_step")
    other.output("y", "bank_pid_2_step")
    cases = [Case(x, [], [{}, {}], {}) for x in (d, other)]
    assert not shared(cases, "rk4", "float64", ["gcc-O0"])[1]


@pytest.mark.usefixtures("forced")
def test_each_line_still_has_an_owner_and_a_copy_its_functions() -> None:
    program = emit_program(bank(20), 0.001)
    found = source_map(program.flat, program.source, program.layout)
    body = [line for line in found.lines if line.part == "advance" and line.executable]
    assert [line for line in body if not (line.block or line.role)] == []
    assert {line.block for line in body if line.block} == {f"pid{k}" for k in range(20)}
    parts = found.of("pid7")
    assert {"pid.prepare", "pid.init", "pid.step", "pid.P", "pid.S", "advance", "defaults"} == set(parts)
    ((first, last),) = parts["advance"]
    assert any("&p->pid[7]" in line.text for line in found.lines[first - 1 : last])
