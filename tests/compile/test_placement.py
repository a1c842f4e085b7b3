"""Values read under a condition are computed only there, and kept only if they are read later; no bit changes."""

import random
import re
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.compile.differential import KINDS, Case, emitted, reference_run
from tests.toolchains import need
from twodof.blocks import Block, Diagram, Param, Port, State, atan, cos, maximum, minimum, sqrt, store, to_int32, where
from twodof.blocks.library import Trigonometry, ZeroOrderHold
from twodof.compile.c.emitter import emit
from twodof.compile.program.layout import MemoryLayout
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


class Dear(Block):
    """Two values that take long and share most of what they compute."""

    inputs = (Port("u"),)
    outputs = (Port("a"), Port("b"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        angle = atan(u.u)
        return {"a": angle, "b": 1.0 / cos(angle)}


class Choice(Block):
    """One of two signals, or neither, by mode and parameter; `form` says how it is written."""

    inputs = (Port("mode", "int32"), Port("on", "bool"), Port("a"), Port("b"))
    outputs = (Port("y"), Port("z", "bool"))
    params = (Param("least", 2, kind="int32"),)

    def __init__(self, form: int = 0) -> None:
        self.form = form
        self.states = (State("kept"),) if form == 3 else ()

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        high = u.mode >= p.least
        chosen = (
            where(u.on, where(high, u.a, 0.5), where(~high, u.b, -0.5)) if self.form != 1 else where(high, u.a, u.b)
        )
        also = (u.on & (u.a > 0.0)) if self.form == 2 else (u.on | high | (u.b < 0.2)) if self.form == 1 else u.on
        return {"y": chosen, "z": also}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"kept": where(u.on, u.a, x.kept)} if self.form == 3 else {}


class FastChoice(Choice):
    """It may read what is computed at a slower rate."""

    crossing = True


def step_of(d: Diagram, **options: Any) -> str:
    """Return the C of the step."""
    source = emit([lower(d, DT, **options)])[0].source
    return source[source.index(f"td_inline void {d.name}_advance(") :]


def within(step: str, call: str) -> bool:
    """Return True if the call stands under a condition."""
    (line,) = (line for line in step.splitlines() if call in line)
    return line.startswith(" " * 8)


def test_a_block_runs_only_where_the_selected_signal_needs_it() -> None:
    d = Diagram("d")
    for name, kind in (("u", "real"), ("mode", "int32"), ("on", "bool")):
        d.input(name, kind)
    d.add("before", Trigonometry("sin"), u="u")
    d.add("dear", Dear(), u="before")
    d.add("choice", Choice(2), mode="mode", on="on", a="dear.a", b="u")
    d.output("y", "choice.y")
    assert within(step_of(d), "td_sin(")
    assert within(step_of(d), "td_atan(")
    assert not within(step_of(d, log=["dear.b"]), "td_sin(")
    step = step_of(d, log=["before.y"])
    assert not within(step, "td_sin(")
    assert within(step, "td_atan(")


class Counter(Block):
    """1, 2, 3, ... as a real: what it gives depends on how often it runs."""

    outputs = (Port("y"),)
    states = (State("n"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.n + cos(x.n)

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.n + 1.0


def _add_slow(d: Diagram, name: str, u: str, rng: random.Random) -> None:
    """Add an expensive block at a slow rate, read by a choice of that rate and perhaps by one of the base rate."""
    if "slow_mode" not in d.parts:
        d.add("slow_mode", Held("int32"), rate=(3, 1), u="mode")
        d.add("slow_on", Held("bool"), rate=(3, 1), u="on")
    d.add(f"held_{name}", ZeroOrderHold(), rate=(3, 1), u=u)
    d.add(f"dear_{name}", Trigonometry("atan"), rate=(3, 1), u=f"held_{name}")
    slow = {"mode": "slow_mode", "on": "slow_on", "a": f"dear_{name}", "b": f"held_{name}"}
    d.add(f"slow_{name}", Choice(rng.randrange(4)), rate=(3, 1), inputs=slow)
    a = rng.choice((f"dear_{name}", f"held_{name}"))
    d.add(name, FastChoice(rng.randrange(4)), mode="mode", on="on", a=a, b=f"slow_{name}.y")


def random_selection(seed: int) -> Diagram:
    """Dear blocks in layers with choices between them, at two rates and in sub-diagrams that are enabled."""
    rng = random.Random(seed)
    d = Diagram(f"d{seed}")
    for name, kind in (("u", "real"), ("v", "real"), ("mode", "int32"), ("on", "bool"), ("awake", "bool")):
        d.input(name, kind)
    inner = Diagram("inner")
    inner.input("u")
    inner.input("mode", "int32")
    inner.input("on", "bool")
    inner.add("dear", Dear(), u="u")
    inner.add("count", Counter())
    inner.add("choice", Choice(rng.randrange(4)), mode="mode", on="on", a="dear.b", b="count")
    inner.output("y", "choice.y")
    inner.output("raw", "dear.a")
    signals, flags, numbers = ["u", "v"], ["on", "awake"], rng.randint(6, 14)
    for k in range(numbers):
        name = f"{rng.choice('abcdefgh')}{k}"  # parts stand in the order of their names where nothing else decides
        kind = rng.random()
        u = rng.choice(signals)
        if kind < 0.4:
            d.add(name, Dear() if rng.random() < 0.3 else Trigonometry("atan"), u=u)
            signals += [f"{name}.{port.name}" for port in d.parts[name].item.outputs]
        elif kind < 0.8:
            a, b = rng.choice(signals), rng.choice(signals)
            d.add(name, Choice(rng.randrange(4)), mode="mode", on=rng.choice(flags), a=a, b=b)
            signals.append(f"{name}.y")
            flags.append(f"{name}.z")
        elif kind < 0.9:
            disabled = rng.choice(("hold", "reset"))
            d.add(name, inner, u=u, mode="mode", on=rng.choice(flags), enable="awake", disabled=disabled)
            signals += [f"{name}.y", f"{name}.raw"]
        else:
            _add_slow(d, name, u, rng)
            signals.append(f"{name}.y")
    for k, name in enumerate(signals[-3:]):
        d.output(f"y{k}", name)
    return d


class Held(Block):
    """A signal of another rate."""

    crossing = True

    def __init__(self, kind: str) -> None:
        self.inputs, self.outputs = (Port("u", kind),), (Port("y", kind),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.u


def nested_case(seed: int) -> Case:
    """A random block with random inputs, and now and then a number that is none, or 0."""
    rng = random.Random(seed)
    rows = [
        {
            **{n: rng.choice(SPECIAL) if rng.random() < 0.1 else rng.gauss(0.0, 2.0) for n in ("u", "v")},
            "mode": rng.randint(-1, 4),
            "on": rng.random() < 0.5,
        }
        for _ in range(12)
    ]
    return Case(alone(Nested(seed), f"d{seed}"), [], rows, {})


def selection_case(seed: int) -> Case:
    """Dear blocks and choices with random inputs of 40 steps."""
    rng = np.random.default_rng(seed)
    rows = [
        {
            **{name: float(rng.normal()) for name in ("u", "v")},
            "mode": int(rng.integers(0, 4)),
            **{name: bool(rng.random() < 0.6) for name in ("on", "awake")},
        }
        for _ in range(40)
    ]
    return Case(random_selection(seed), [], rows, {})


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize(
    ("case", "kind", "first", "count"),
    [
        (nested_case, "gcc-O0", 0, 5),
        (nested_case, "m7-gcc", 5, 2),
        (selection_case, "gcc-O0", 0, 8),
        *(pytest.param(nested_case, kind, 100, 60, marks=pytest.mark.soak) for kind in KINDS),
        *(pytest.param(nested_case, "gcc-O3", 1000 + 100 * k, 100, marks=pytest.mark.soak) for k in range(10)),
        *(pytest.param(selection_case, "gcc-O3", 8 + 50 * k, 50, marks=pytest.mark.soak) for k in range(20)),
    ],
)
def test_late_placement_changes_no_bit(
    case: Callable[[int], Case], kind: str, first: int, count: int, precision: str
) -> None:
    need(*KINDS[kind].needs)
    cases = [case(seed) for seed in range(first, first + count)]
    programs = emitted(cases, precision, "rk4")
    assert len(re.findall(r"\n +if \(", programs[0].source)) > count
    assert case is nested_case or any(MemoryLayout(p.flat).passing for p in programs)
    expected = [reference_run(one, precision, "rk4") for one in cases]
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
