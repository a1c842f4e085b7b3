"""A signal that is read only at the ticks at which it is computed is not kept, and no bit changes."""

import random
from typing import Any

import pytest

from tests.compile.differential import KINDS, Case, emitted, reference_run
from tests.toolchains import need
from twodof.blocks import Diagram
from twodof.blocks.library import DiscreteIntegrator, Gain, Sum, UnitDelay, ZeroOrderHold
from twodof.compile.program.layout import MemoryLayout
from twodof.compile.program.lower import lower

DT = 0.01


def chain(**options: Any) -> Diagram:
    """Two gains one after the other within a part that is enabled; what comes out of it is added to an input."""
    inner = Diagram("inner")
    inner.input("u")
    inner.input("awake", "bool")
    inner.add("first", Gain(2.0), u="u")
    inner.add("second", Gain(3.0), u="first", **options)
    inner.output("y", "second")
    d = Diagram("d")
    d.input("u")
    d.input("on", "bool")
    d.input("awake", "bool")
    d.add("inner", inner, u="u", awake="awake", enable="on")
    d.add("sum", Sum("++"), a="inner.y", b="u")
    d.output("y", "sum")
    return d


def kept(d: Diagram, **options: Any) -> set[str]:
    """The paths of the signals that stand in memory from tick to tick."""
    return {s.path for s in MemoryLayout(lower(d, DT, **options)).stored}


def test_signals_read_outside_are_kept() -> None:
    assert kept(chain()) == {"inner.second.y"}
    assert kept(chain(), log=["inner.first.y"]) == {"inner.first.y", "inner.second.y"}
    assert kept(chain(initial={"y": 2.0})) == {"inner.second.y"}


def test_signals_read_at_another_rate_are_kept() -> None:
    d = Diagram("d")
    d.input("u")
    d.add("slow", ZeroOrderHold(), rate=(3, 1), u="u")
    d.add("gain", Gain(2.0), rate=(3, 1), u="slow")
    d.add("fast", ZeroOrderHold(), u="gain")
    d.output("y", "fast")
    assert kept(d) == {"gain.y"}
    part = Diagram("part")
    part.input("u")
    part.add("sum", DiscreteIntegrator(), u="u")
    part.output("y", "sum")
    d.add("between", ZeroOrderHold(), rate=(6, 1), u="slow")
    d.add("later", part, rate=(6, 1), u="between")
    d.add("last", ZeroOrderHold(), u="later.y")
    d.output("z", "last")
    assert kept(d) == {"gain.y", "slow.y", "later.sum.y"}


def layered(seed: int) -> Diagram:
    """Slow and enabled parts in a row, some of whose signals are read in passing alone."""
    rng = random.Random(seed)
    d = Diagram(f"d{seed}")
    d.input("u")
    d.input("on", "bool")
    for k in range(4):
        inner = Diagram("inner")
        inner.input("u")
        sources = ["u"]
        for i in range(rng.randint(2, 5)):
            block = rng.choice((Gain(1.5), UnitDelay(), DiscreteIntegrator(), Sum("+-")))
            names = ("a", "b") if isinstance(block, Sum) else ("u",)
            inner.add(f"p{rng.randrange(100)}_{i}", block, inputs={n: rng.choice(sources) for n in names})
            sources.append(list(inner.parts)[-1])
        inner.output("y", sources[-1])
        slow, disabled = (3, rng.randrange(3)), rng.choice(("hold", "reset"))
        d.add(f"held{k}", ZeroOrderHold(), rate=slow, u="u" if not k else f"crossed{k - 1}")
        d.add(f"slow{k}", inner, rate=slow, u=f"held{k}")
        d.add(f"crossed{k}", ZeroOrderHold(), u=f"slow{k}")
        d.add(f"enabled{k}", inner, u=f"crossed{k}", enable="on", disabled=disabled)
        d.output(f"y{k}", f"enabled{k}")
    return d


@pytest.mark.parametrize(
    ("kind", "count"), [("gcc-O0", 4), *(pytest.param(kind, 60, marks=pytest.mark.soak) for kind in KINDS)]
)
def test_passing_signals_change_no_bit(kind: str, count: int) -> None:
    need(*KINDS[kind].needs)
    rng = random.Random(count)
    rows = [{"u": rng.gauss(0.0, 1.0), "on": rng.random() < 0.6} for _ in range(30)]
    cases = [Case(layered(seed), [], rows, {}) for seed in range(count)]
    programs = emitted(cases, "float32", "rk4")
    assert all(MemoryLayout(p.flat).passing for p in programs)
    expected = [reference_run(case, "float32", "rk4") for case in cases]
    assert not KINDS[kind].differences(cases, expected, programs)
