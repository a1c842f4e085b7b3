"""Signals read under a condition only are computed only then, with the same bits."""

import random
from typing import Any

import numpy as np
import pytest

from tests.compile.differential import Case, differences, emitted, reference_run
from twodof.blocks import Block, Diagram, Param, Port, State, atan, cos, where
from twodof.blocks.library import Trigonometry, ZeroOrderHold
from twodof.compile.c.emitter import emit
from twodof.compile.native import Native
from twodof.compile.program.lower import lower

pytestmark = pytest.mark.slow

DT = 0.01


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


def rows(seed: int) -> list[dict[str, Any]]:
    """Random inputs of 40 steps."""
    rng = np.random.default_rng(seed)
    return [
        {
            **{name: float(rng.normal()) for name in ("u", "v")},
            "mode": int(rng.integers(0, 4)),
            **{name: bool(rng.random() < 0.6) for name in ("on", "awake")},
        }
        for _ in range(40)
    ]


@pytest.mark.long
@pytest.mark.parametrize(
    ("first", "count"), [(0, 15), *(pytest.param(15 + 50 * k, 50, marks=pytest.mark.soak) for k in range(20))]
)
def test_what_is_left_out_changes_no_bit(first: int, count: int) -> None:
    precision = ("float64", "float32")[first // 50 % 2]
    cases = [Case(random_selection(seed), [], rows(seed), {}) for seed in range(first, first + count)]
    expected = [reference_run(case, precision, "rk4") for case in cases]
    assert not differences(cases, expected, emitted(cases, precision, "rk4"), Native(None, "-O1"))
