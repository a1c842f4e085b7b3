"""What is computed ahead of a run gives the bits of the steps one by one, wherever a run begins and ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twodof.blocks import Block, Diagram, Param, Port, State, sqrt, to_int32, to_real, where
from twodof.blocks.elementary.functions import ARGUMENTS, FUNCTIONS
from twodof.blocks.library import Gain
from twodof.blocks.noise import normal4, uniform
from twodof.blocks.reference.interpreter import Reference
from twodof.compile import CompiledProgram, build
from twodof.compile.c.emitter import emit
from twodof.compile.native import Native
from twodof.compile.program.lower import lower

pytestmark = pytest.mark.slow

DT = 0.001
RATES = ((1, 0), (3, 2), (4, 1), (7, 6))
CHUNKS = (1, 2, 63, 64, 65, 1, 30)
ENDS = (0, 2**31 - 5, 2**32 - 70, 2**32 - 64, 2**32 - 1)
"""Ticks at which a run begins: the last ones pass the end of a uint32."""


class Shaky(Block):
    """Noise through a filter, and noise that is read on one side of a choice only."""

    crossing = True

    inputs = (Port("u"),)
    outputs = (Port("y"), Port("z"), Port("n"))
    params = (Param("seed", 5, "uint32"), Param("w", 3.0))
    states = (State("sum"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        a, b, _, _ = normal4(p.seed, 1, t.tick)
        return {"y": x.sum + a, "z": where(u.u < 0.0, b * p.w, x.sum), "n": b}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return 0.9 * x.sum + u.u * normal4(p.seed, 2, t.tick)[3] + uniform(p.seed, 3, t.tick)


class Every(Block):
    """Each elementary function of numbers of the tick: large and small, of both signs, some infinite and NaN."""

    outputs = tuple(Port(name) for name in FUNCTIONS)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        a = normal4(7, 1, t.tick)
        scale = where((to_int32(t.tick) & 7) == 0, 1e300, where((to_int32(t.tick) & 7) == 1, 1e-310, 1.0))
        values = (a[0] * scale + sqrt(a[2]) * 0.0, a[1] * to_real(t.tick & 31))
        return {name: f(*values[: ARGUMENTS[name]]) for name, f in FUNCTIONS.items()}


def diagram() -> Diagram:
    """Blocks of several rates, one of them enabled at times: that one is not computed ahead."""
    d = Diagram("ahead")
    d.input("u")
    d.input("on", "bool")
    for divider, offset in RATES:
        name = f"shaky_{divider}"
        d.add(name, Shaky(), rate=(divider, offset), u="u")
        for port in "yzn":
            d.output(f"{port}{divider}", f"{name}.{port}")
    inner = Diagram("inner")
    inner.input("u")
    inner.add("shaky", Shaky(), u="u")
    inner.add("gain", Gain(2.0), u="shaky.y")
    inner.output("y", "gain")
    d.add("inner", inner, enable="on", u="u")
    d.output("inner", "inner.y")
    return d


def every() -> Diagram:
    d = Diagram("every")
    d.add("all", Every())
    for name in FUNCTIONS:
        d.output(name, f"all.{name}")
    return d


def compiled(d: Diagram, precision: str, optimise: str = "-O3") -> CompiledProgram:
    program = build(d, DT, precision, target=Native(optimise=optimise))
    assert isinstance(program, CompiledProgram)
    return program


def inputs(count: int) -> dict[str, Any]:
    rng = np.random.default_rng(count)
    return {"u": rng.normal(size=count), "on": rng.random(count) < 0.5}


def function(source: str, name: str) -> str:
    """The text of a function."""
    return source.partition(f"void {name}(")[2].partition("\n}\n")[0]


def same(a: dict[str, Any], b: dict[str, Any]) -> bool:
    return all(np.array_equal(np.asarray(a[k]), np.asarray(b[k]), equal_nan=True) for k in a)


@pytest.mark.long
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_run_in_pieces_has_the_bits_of_the_reference(precision: str) -> None:
    program = compiled(diagram(), precision)
    ahead, step = (function(program.source, f"ahead_{name}") for name in ("look_ahead", "advance"))
    assert "shaky_4_t" in ahead
    assert "inner_shaky" not in ahead  # it is computed where it acts
    assert "inner_shaky_t" in step
    machine, reference = program.machine(), Reference(diagram(), DT, precision).machine()
    given = inputs(sum(CHUNKS))
    expected = reference.run(sum(CHUNKS), given)
    at = 0
    for n in CHUNKS:
        made = machine.run(n, {k: v[at : at + n] for k, v in given.items()})
        assert same(made, {k: v[at : at + n] for k, v in expected.items()})
        at += n


@pytest.mark.parametrize("start", ENDS)
def test_a_run_may_begin_at_any_tick(start: int) -> None:
    whole, single = (compiled(diagram(), "float64", o).machine() for o in ("-O3", "-O0"))
    for machine in (whole, single):
        machine._s["tick"] = start
    given = inputs(200)
    rows = [single.step({k: v[i] for k, v in given.items()}) for i in range(200)]
    assert same(whole.run(200, given), {k: np.array([row[k] for row in rows]) for k in rows[0]})
    assert whole.tick == (start + 200) % 2**32


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_functions_without_branches_have_the_same_bits(precision: str) -> None:
    program = compiled(every(), precision)
    assert "td_straight_log(" in program.source
    assert same(program.machine().run(300), Reference(every(), DT, precision).machine().run(300))


def test_parameters_that_change_between_runs_count_from_the_next_tick_on() -> None:
    machine, reference = compiled(diagram(), "float64").machine(), Reference(diagram(), DT).machine()
    for seed in (5, 6):
        for m in (machine, reference):
            for divider, _ in RATES:
                m.set(f"shaky_{divider}.seed", seed)
        given = inputs(50)
        assert same(machine.run(50, given), reference.run(50, given))


def test_firmware_computes_nothing_ahead() -> None:
    assert "look_ahead" not in emit([lower(diagram(), DT)], lean=True)[0].source
