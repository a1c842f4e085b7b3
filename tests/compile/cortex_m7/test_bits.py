"""The emulated Cortex-M7 computes what this machine does, to the bit: flight core, rig, library and special values."""

from __future__ import annotations

import itertools
import random
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.compile import examples
from tests.compile.differential import Case, random_cases, same
from tests.compile.random_diagrams import SPECIAL
from tests.toolchains import need
from twodof.blocks import Block, Diagram, Port, maximum, minimum, sqrt, to_int32, to_uint32, where
from twodof.blocks.elementary.functions import atan2, cos, exp, log, sin
from twodof.blocks.expressions import numbers
from twodof.compile import CompiledProgram
from twodof.compile.c.emitter import emit
from twodof.compile.cortex_m7.target import CortexM7
from twodof.compile.native import Native
from twodof.compile.program.lower import lower
from twodof.compile.target import EmittedProgram, Target
from twodof.flight.core import core
from twodof.rig.rig import rig

pytestmark = pytest.mark.slow

STEPS = 5000
PRECISIONS = ("float64", "float32")


class Arithmetic(Block):
    """Each operation of the language on reals, alone."""

    inputs = (Port("a"), Port("b"))
    names = ("add", "sub", "mul", "div", "min", "max", "root", "size", "sine", "cosine", "angle", "power", "logarithm")
    outputs = (
        *(Port(n) for n in names),
        *(Port(n, "bool") for n in ("lt", "le", "eq", "ne", "chosen")),
        Port("whole", "int32"),
        Port("natural", "uint32"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        a, b = u.a, u.b
        return {
            "add": a + b,
            "sub": a - b,
            "mul": a * b,
            "div": a / b,
            "min": minimum(a, b),
            "max": maximum(a, b),
            "root": sqrt(a),
            "size": abs(a),
            "sine": sin(a),
            "cosine": cos(a),
            "angle": atan2(a, b),
            "power": exp(a),
            "logarithm": log(a),
            "lt": a < b,
            "le": a <= b,
            "eq": a == b,
            "ne": a != b,
            "chosen": where(a < 0.0, a == a, b == b),
            "whole": to_int32(a),
            "natural": to_uint32(a),
        }


def arithmetic() -> Diagram:
    """`Arithmetic` with its inputs and outputs to the outside."""
    d = Diagram("arithmetic")
    d.input("a")
    d.input("b")
    d.add("all", Arithmetic(), a="a", b="b")
    for port in Arithmetic.outputs:
        d.output(port.name, f"all.{port.name}")
    return d


def inputs(diagram: Diagram, hostile: bool) -> dict[str, NDArray[Any]]:
    """A row for each step; with `hostile` one in fifty reals is a special value."""
    r = np.random.default_rng(len(diagram.inputs) + 2 * hostile)
    made: dict[str, NDArray[Any]] = {}
    for name, port in diagram.inputs.items():
        shape = (STEPS,) if port.width is None else (STEPS, port.width)
        if port.kind == "real":
            values = r.normal(0.0, 1.0, shape)
            made[name] = np.where(r.random(shape) < 0.02, r.choice(SPECIAL, shape), values) if hostile else values
        elif port.kind == "bool":
            made[name] = r.random(shape) < 0.2
        else:
            made[name] = r.integers(0, 6, shape).astype(port.kind)
    return made


def samples() -> list[Diagram]:
    """The stock flight core, the rig, and diagrams with rates, enables, resets, edges and rings."""
    return [core(), rig(), arithmetic(), examples.loop(), examples.switched("reset"), examples.edge(), examples.delay()]


def emitted(diagrams: Sequence[Diagram], precision: str) -> list[EmittedProgram]:
    """All in one source."""
    with numbers.precision(precision):
        return emit([lower(d, 0.004) for d in diagrams], precision)


def programs(sources: Sequence[EmittedProgram], target: Target) -> list[CompiledProgram]:
    """Each with its own functions in the one library or image."""
    return [CompiledProgram(e, b) for e, b in zip(sources, target.compile(sources), strict=True)]


def different(left: CompiledProgram, right: CompiledProgram, rows: dict[str, NDArray[Any]]) -> list[str]:
    """The outputs and, afterwards, structs that are not the same, of `STEPS` steps on each."""
    machines = left.machine(), right.machine()
    here, there = (m.run(STEPS, rows) for m in machines)
    found = [name for name in here if not same(here[name], there[name]).all()]
    for path in left.states:
        states = [np.atleast_1d(np.array(m.state(path))) for m in machines]
        if not same(*states).all():
            found.append(path)
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    ("compiler", "precision"),
    [
        ("gcc", "float64"),
        ("gcc", "float32"),
        ("zig", "float32"),
        pytest.param("zig", "float64", marks=pytest.mark.soak),
    ],
)
def test_every_sample_runs_5000_steps_as_here(compiler: str, precision: str) -> None:
    need("qemu-system-arm", *(["arm-none-eabi-gcc"] if compiler == "gcc" else []))
    sources = emitted(samples(), precision)
    m7, native = programs(sources, CortexM7(compiler)), programs(sources, Native(optimise="-O1"))
    for diagram, left, right in zip(samples(), native, m7, strict=True):
        for hostile in (False, True):
            assert different(left, right, inputs(diagram, hostile)) == [], (diagram.name, hostile)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_pair_of_special_values_gives_the_same_bits(precision: str) -> None:
    need("qemu-system-arm", "arm-none-eabi-gcc")
    tiny = float(np.finfo(precision).smallest_subnormal)
    special = [*SPECIAL, tiny, -3.0 * tiny, float(np.finfo(precision).tiny), 2.0**31, -(2.0**31) - 1.0, 2.0**32, 0.1]
    pairs = np.array(list(itertools.product(special, special)))
    with np.errstate(over="ignore"):
        rows = {"a": pairs[:, 0].astype(precision), "b": pairs[:, 1].astype(precision)}
    sources = emitted([arithmetic()], precision)
    results = [programs(sources, t)[0].machine().run(len(pairs), rows) for t in (Native(), CortexM7("gcc"))]
    for name, here in results[0].items():
        assert same(here, results[1][name]).all(), name
    # The rules themselves: subnormal numbers are kept, zeros signed, infinities and NaN made.
    y = results[1]
    below = (rows["a"] == tiny) & (rows["b"] == 1.0)
    assert below.any()
    assert (y["mul"][below] == np.array(tiny, precision)).all()
    assert np.signbit(y["mul"][(rows["a"] == 0.0) & np.signbit(rows["a"]) & (rows["b"] == 1.0)]).all()
    assert np.isnan(y["add"][np.isposinf(rows["a"]) & np.isneginf(rows["b"])]).all()
    assert np.isposinf(y["div"][(rows["a"] == 1.0) & (rows["b"] == 0.0) & ~np.signbit(rows["b"])]).all()


@pytest.mark.parametrize("precision", [pytest.param("float64", marks=pytest.mark.soak), "float32"])
def test_random_diagrams_run_as_here(precision: str) -> None:
    """The differential test over all targets has many more. These few fail first when this target is wrong."""
    need("qemu-system-arm")
    cases: list[Case] = random_cases(range(300, 306), STEPS)
    sources = emitted([c.diagram for c in cases], precision)
    m7, native = programs(sources, CortexM7()), programs(sources, Native(optimise="-O1"))
    for case, left, right in zip(cases, native, m7, strict=True):
        assert different(left, right, case.columns(STEPS)) == [], case.diagram.name


@pytest.mark.parametrize("optimise", ["-O0", "-Os", *(pytest.param(o, marks=pytest.mark.soak) for o in ("-O1", "-O3"))])
def test_the_level_of_optimisation_changes_no_bit(optimise: str) -> None:
    need("qemu-system-arm", "arm-none-eabi-gcc")
    sources = emitted([core()], "float32")
    (left,), (right,) = programs(sources, Native()), programs(sources, CortexM7("gcc", optimise))
    assert different(left, right, inputs(core(), hostile=False)) == []


def test_contraction_left_on_is_caught() -> None:
    """The processor has fused multiply-add, and gcc uses it unless it is told not to."""
    need("qemu-system-arm", "arm-none-eabi-gcc")
    (source,) = emitted([core()], "float32")
    loose = re.sub(r"#if defined\(__clang__\)\n.*?#endif\n", "", source.source, count=1, flags=re.DOTALL)
    assert loose != source.source
    contracted = EmittedProgram(source.flat, loose, source.layout, source.precision)
    (left,) = programs([source], Native())
    (right,) = programs([contracted], CortexM7("gcc", flags=("-ffp-contract=fast",)))
    assert different(left, right, inputs(core(), hostile=False)) != []


def test_step_by_step_is_as_all_at_once_and_machines_do_not_mix() -> None:
    need("qemu-system-arm")
    (program,) = programs(emitted([examples.loop()], "float64"), CortexM7())
    r = random.Random(1)
    rows = np.array([r.gauss(0, 1) for _ in range(300)])
    once, first, second = (program.machine() for _ in range(3))
    second.set("k", 5.0)
    together = once.run(300, {"r": rows})
    ours, theirs = [], []
    for value in rows:
        ours.append(first.step({"r": value})["y"])
        theirs.append(second.step({"r": -value})["y"])
    assert np.array_equal(together["y"], ours)
    assert not np.array_equal(together["y"], np.negative(theirs))  # another gain
    assert first.tick == second.tick == 300
