"""Inside a block too, what is read under a condition is computed only there, and no bit changes."""

from __future__ import annotations

import random
import re
import time
from typing import Any

import pytest

from tests.compile.differential import KINDS, Case, emitted, reference_run
from tests.toolchains import need
from twodof.blocks import Block, Diagram, Port, State, atan, maximum, minimum, sqrt, store, to_int32, where
from twodof.compile.c.emitter import emit
from twodof.compile.program.lower import lower

pytestmark = pytest.mark.slow

DT = 0.01
INPUTS = (("u", "real"), ("v", "real"), ("mode", "int32"), ("on", "bool"))
SPECIAL = (0.0, -0.0, 1e-310, 1e30, float("inf"), float("nan"))


class Nested(Block):
    """Choices within choices, drawn by `seed`. They share values with one another, with the next states and with what
    is read in any case. Quotients by 0 and elements that are not there are among them.
    """

    inputs = tuple(Port(name, kind) for name, kind in INPUTS)
    outputs = (Port("y"), Port("z", "bool"), Port("n", "int32"))
    states = (State("kept"), State("past", width=4))

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def _values(self, u: Any, x: Any) -> tuple[Any, Any, Any, Any]:
        """Three reals and a flag."""
        rng = random.Random(self.seed)
        reals, flags = [u.u, u.v, x.kept], [u.on, u.mode == 1, u.mode >= 2, u.u < u.v]

        def flag(depth: int) -> Any:
            kind = rng.random()
            if depth == 0 or kind < 0.4:
                return rng.choice(flags)
            a, b = real(depth - 1), real(depth - 1)
            flags.append(rng.choice(flags) & (a / b > 0.5) if kind < 0.6 else rng.choice(flags) | (a < b))
            return ~flags[-1] if kind > 0.9 else flags[-1]

        def real(depth: int) -> Any:
            kind = rng.random()
            if depth == 0 or kind < 0.1:
                return rng.choice(reals)
            if kind < 0.6:
                made = where(flag(depth - 1), real(depth - 1), real(depth - 1))
            elif kind < 0.7:
                made = x.past[where(flag(depth - 1), u.mode // to_int32(real(depth - 1)), u.mode * 3)]
            else:
                a, b = real(depth - 1), real(depth - 1)
                made = rng.choice((a / b, a * b + a, atan(a) - b, sqrt(a), minimum(1.5, maximum(-1.5, a))))
            if rng.random() < 0.3:
                reals.append(made)
            return made

        return real(4), real(5), real(4), flag(4)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        a, b, _, flag = self._values(u, x)
        return {"y": where(flag, a, b), "z": flag, "n": to_int32(b)}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        a, b, c, flag = self._values(u, x)
        kept = where(flag, a, c)
        return {"kept": where(abs(kept) < 1e3, kept, 0.5), "past": store(x.past, to_int32(b), where(u.on, kept, 0.25))}


def alone(block: Block, name: str = "d") -> Diagram:
    """A diagram of one block."""
    d = Diagram(name)
    for port in block.inputs:
        d.input(port.name, port.kind)
    d.add("part", block, inputs={port.name: port.name for port in block.inputs})
    for port in block.outputs:
        d.output(port.name, f"part.{port.name}")
    return d


def nested_cases(first: int, count: int, steps: int = 12) -> list[Case]:
    """Random blocks with random inputs, and now and then a number that is none, or 0."""
    cases = []
    for seed in range(first, first + count):
        rng = random.Random(seed)
        rows = [
            {
                **{n: rng.choice(SPECIAL) if rng.random() < 0.1 else rng.gauss(0.0, 2.0) for n in ("u", "v")},
                "mode": rng.randint(-1, 4),
                "on": rng.random() < 0.5,
            }
            for _ in range(steps)
        ]
        cases.append(Case(alone(Nested(seed), f"d{seed}"), [], rows, {}))
    return cases


def lines_of(block: Block) -> list[str]:
    """The lines of the C of its step."""
    text = emit([lower(alone(block), DT)])[0].source
    return text[text.rindex("void d_advance(") :].partition("\n}\n")[0].splitlines()


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize(
    ("kind", "first", "count"),
    [
        ("gcc-O0", 0, 5),
        ("m7-gcc", 5, 2),
        *(pytest.param(kind, 100, 60, marks=pytest.mark.soak) for kind in KINDS),
        *(pytest.param("gcc-O3", 1000 + 100 * k, 100, marks=pytest.mark.soak) for k in range(10)),
    ],
)
def test_branches_change_no_bit(kind: str, first: int, count: int, precision: str) -> None:
    need(*KINDS[kind].needs)
    cases = nested_cases(first, count)
    programs = emitted(cases, precision, "rk4")
    assert len(re.findall(r"\n +if \(", programs[0].source)) > count
    expected = [reference_run(case, precision, "rk4") for case in cases]
    assert not KINDS[kind].differences(cases, expected, programs)


class Chain(Block):
    """Chain of choices on one condition, with a value that all choices read."""

    inputs = tuple(Port(name, kind) for name, kind in INPUTS)
    outputs = (Port("y"),)

    def __init__(self, length: int) -> None:
        self.length = length

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        shared, y = atan(u.u), u.v
        free = 0.0
        for _ in range(self.length):
            y = where(u.on, shared * y + u.u, u.v)
            y = y * u.u + 1.0
            free = free + y
        return y + free


def test_a_long_chain_on_one_condition_takes_its_time_only() -> None:
    d = alone(Chain(600))
    program = lower(d, DT)
    start = time.process_time()
    emit([program])
    assert time.process_time() - start < 5.0
