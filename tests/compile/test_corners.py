"""Corners that random diagrams seldom reach, on the reference and compiled.

These are edges of every fraction, several stores into one array, and loops beside loops. All are within sub-diagrams
that are enabled, reset and slow, while parameters and states are set from outside and the tick wraps around.
"""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest

from tests.compile.differential import same
from twodof.blocks import (
    Block,
    Diagram,
    Param,
    Port,
    State,
    array_of,
    fold,
    minimum,
    store,
    sum,
    to_int32,
    to_real,
    vector,
    where,
)
from twodof.blocks.library import Compare, Constant, DiscreteIntegrator, Integrator, UnitDelay, ZeroOrderHold
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import CompiledProgram, build

pytestmark = pytest.mark.slow


class Edged(Block):
    """Two edges that feed update and project. Their fractions are NaN, below 0, 0, 1, above 1 or equal."""

    inputs = (Port("u"),)
    outputs = (Port("y"), Port("z"))
    params = (Param("f", 0.3),)
    states = (State("k", 0, "int32"), State("m", 0.25), State("c", "f", continuous=True))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"y": x.m, "z": x.m * 2.0}

    def edges(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        fractions = vector([0.5, 0.5, p.f, float("nan"), -0.5, 1.0, 0.0, 2.0, 0.999, 1e-300])
        return {
            "y": (fractions[x.k], where(x.k == 3, x.m, u.u)),
            "z": (fractions[x.k + to_int32(x.m)], x.m + u.u),
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"k": (x.k * 7 + 3) % 11, "m": u.u + 0.1 * x.c}

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"c": u.u - x.c + x.m}

    def project(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"c": where(abs(x.c) > 0.4, u.u * 0.01 + 0.02 * to_real(x.k), x.c)}


class Arrays(Block):
    """Two array states, one with three stores in a tick at computed places; indices beyond the ends of short arrays."""

    inputs = (Port("u"), Port("i", "int32"))
    outputs = (Port("y"), Port("a", width=4))
    params = (Param("g", 0.5), Param("start", 0.5, width=5))
    derived = (Port("scaled", width=5),)
    states = (State("a", "start", width=5), State("b", "scaled", width=5), State("k", 0, "int32"))

    def prepare(self, p: Any, t: Any) -> Any:
        return {"scaled": array_of(5, lambda i: p.start[i] * p.g + to_real(i))}

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        short = array_of(3, lambda i: x.b[i] * p.g)
        (total,) = fold(2, [short[u.i]], lambda i, s: [s + array_of(3, lambda j: to_real(j) + short[i])[i]])
        return {
            "y": x.a[u.i] + total,
            "a": array_of(4, lambda i: short[i] + fold(2, [p.g], lambda j, q: [q + short[j]])[0]),
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        a = store(x.a, u.i, u.u)
        a = store(a, x.k, 0.5 * a[u.i] + 0.25 * x.b[x.k])
        a = store(a, x.k - 1, 0.9 * a[x.k])
        return {"a": a, "b": array_of(5, lambda i: x.a[i] * 0.5 + x.b[4 - i] * 0.25), "k": (x.k + 1) % 7}


def corners() -> Diagram:
    """Slow and fast blocks two conditional sub-diagrams deep; one sub-diagram's signal resets another."""
    inner = Diagram("inner")
    inner.input("u")
    inner.input("i", "int32")
    inner.add("edged", Edged(), u="u")
    inner.add("held", ZeroOrderHold(), rate=(3, 1), u="u")
    inner.add("slow", DiscreteIntegrator(), rate=(3, 1), u="held")
    inner.add("arrays", Arrays(), u="u", i="i")
    inner.add("integral", Integrator(), u="edged.z")
    for name, source in (("e", "edged.y"), ("s", "slow"), ("y", "arrays.y"), ("c", "integral")):
        inner.output(name, source)
    middle = Diagram("middle")
    middle.input("u")
    middle.input("i", "int32")
    middle.input("on", "bool")
    middle.input("again", "bool")
    middle.add("inner", inner, u="u", i="i", enable="on", reset="again", disabled="reset")
    middle.add("limit", Constant(0.02))
    middle.add("above", Compare(">"), a="inner.c", b="limit")
    middle.output("c", "inner.c")
    middle.output("above", "above")
    other = Diagram("other")
    other.input("u")
    other.add("integral", Integrator(), u="u")
    other.add("last", UnitDelay(1.0), u="integral")
    other.output("y", "last")
    d = Diagram("corners")
    d.input("u")
    d.input("i", "int32")
    for flag in ("on", "again", "awake"):
        d.input(flag, "bool")
    d.add("middle", middle, u="u", i="i", on="on", again="again", enable="awake")
    d.add("other", other, u="middle.c", enable="on", reset="middle.above")
    d.output("y", "other.y")
    d.output("through", "u")
    return d


LOGGED = tuple(
    f"middle.inner.{path}" for path in ("edged.y", "edged.z", "slow.y", "arrays.y", "arrays.a", "integral.y")
)


@pytest.mark.parametrize(
    ("precision", "integrator", "travelled"),
    [
        ("float64", "rk4", False),
        ("float32", "rk4", True),
        ("float32", "euler", False),
        *(
            pytest.param(*slot, marks=pytest.mark.soak)
            for slot in (("float64", "rk4", True), ("float32", "rk4", False))
        ),
        *(pytest.param(p, "euler", t, marks=pytest.mark.soak) for p, t in (("float64", False), ("float64", True))),
    ],
)
def test_corners_have_the_bits_of_the_reference(precision: str, integrator: str, travelled: bool) -> None:
    d = from_json(to_json(corners())) if travelled else corners()
    program = build(d, 0.01, precision, LOGGED, integrator, optimise="-O1")
    assert isinstance(program, CompiledProgram)
    ours, theirs = program.machine(), Reference(d, 0.01, precision, LOGGED, integrator).machine()
    ours.instance.structs["S"]["tick"][0] = theirs._tick = 2**32 - 75
    rng = random.Random(1)
    for k in range(200):
        row = {"u": rng.gauss(0, 1), "i": rng.randint(-2, 7), "on": rng.random() < 0.7}
        row |= {"again": rng.random() < 0.1, "awake": rng.random() < 0.8}
        if k % 20 == 7:
            for machine in (ours, theirs):
                machine.set_many({"middle.inner.edged.f": 0.1 + k / 500, "middle.inner.arrays.g": k / 400})
                machine.set_state("middle.inner.arrays.b", [k, 1.0, -1.0, 0.5, 0.1])
        want, found = theirs.step(row), ours.step(row)
        for path, value in want.items():
            assert same(np.atleast_1d(np.array(value)), np.atleast_1d(np.array(found[path]))).all(), (k, path)
        for path in program.states:
            pair = (np.atleast_1d(np.array(m.state(path))) for m in (theirs, ours))
            assert same(*pair).all(), (k, path)


class OwnReader(Block):
    """`shown`, `long` and the next state read what `kept` gives, by way of a wire from this output to an input."""

    inputs = (Port("back", shape=(3, 3)), Port("z"))
    outputs = (Port("kept", shape=(3, 3)), Port("shown"), Port("long", width=12))
    states = (State("x", 0.5, shape=(3, 3)), State("n"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        total = sum(u.back @ u.back)
        return {"kept": x.x + 1.0, "shown": total * total, "long": array_of(12, lambda i: total + u.back[i // 4, 0])}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"x": minimum(5.0, u.back * u.z), "n": x.n + u.back[1, 1]}


def test_a_block_that_reads_its_own_output_computes_that_first() -> None:
    d = Diagram("own")
    d.input("z")
    d.add("block", OwnReader(), z="z")
    d.connect("block.kept", "block.back")
    for name in ("kept", "shown", "long"):
        d.output(name, f"block.{name}")
    reference, native = Reference(d, 0.1).machine(), build(d, 0.1, optimise="-O1").machine()
    for k in range(4):
        expected, found = reference.step({"z": 0.3 * k}), native.step({"z": 0.3 * k})
        for name in expected:
            assert np.array_equal(np.asarray(expected[name]), np.asarray(found[name]))
    assert native.state("block.n") == reference.state("block.n")
