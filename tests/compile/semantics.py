"""When parts act, what they hold and when they start afresh: diagrams, and beside each a loop that says it in Python.

All numbers are small whole ones, which both precisions hold exactly.
"""

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.compile.differential import DT, Case
from twodof.blocks import Block, Diagram, Port, State
from twodof.blocks.action_group import action_group, resettable_integrator
from twodof.blocks.block import EDGES
from twodof.blocks.library import (
    CompareToConstant,
    Constant,
    DataStore,
    DiscreteIntegrator,
    Gain,
    Integrator,
    Mux,
    StoreRead,
    StoreWrite,
    Sum,
    VariableDelay,
    ZeroOrderHold,
)
from twodof.blocks.library.discrete import RESETS

Row = Mapping[str, Any]
STEPS = 80


@dataclass(frozen=True)
class Told:
    """A diagram with its inputs, and what a loop in Python says of its outputs, row by row."""

    case: Case
    expected: Sequence[Row]


TOLD: dict[str, Callable[[], Told]] = {}


def told(make: Callable[[], Told]) -> Callable[[], Told]:
    """Decorator: one of those that are tested."""
    TOLD[make.__name__] = make
    return make


def rows(seed: int, bools: Sequence[str], numbers: Sequence[str] = ("u",)) -> list[dict[str, Any]]:
    """Inputs of each tick: bools that stay for some ticks, numbers that change at each."""
    r = random.Random(seed)
    now = dict.fromkeys(bools, False)
    found: list[dict[str, Any]] = []
    for _ in range(STEPS):
        now |= {name: r.random() < 0.6 for name in bools if r.random() < 0.3}
        found.append({**now, **{name: float(r.randint(-5, 5)) for name in numbers}})
    return found


class Total(Block):
    """The sum of u since the start, which is 10."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    states = (State("sum", 10.0),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.sum + u.u

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.sum + u.u


def totalling(name: str) -> Diagram:
    """A sub-diagram that is a Total."""
    d = Diagram(name)
    d.input("u")
    d.add("total", Total(), u="u")
    d.output("y", "total")
    return d


def whole(name: str, *bools: str) -> Diagram:
    """An empty diagram with the input u and bools."""
    d = Diagram(name)
    d.input("u")
    for name in bools:
        d.input(name, "bool")
    return d


@told
def restarting() -> Told:
    """Within a diagram that is enabled, one that restarts; in that, one that is slower and one enabled by itself."""
    middle = Diagram("middle")
    middle.input("u")
    middle.input("deep", "bool")
    middle.add("fast", totalling("fast"), u="u")
    middle.add("held", ZeroOrderHold(), u="u", rate=(2, 1))
    middle.add("slow", totalling("slow"), u="held", rate=(2, 1))
    middle.add("deeper", totalling("deeper"), u="u", enable="deep")
    outer = Diagram("outer")
    for name in ("go", "deep"):
        outer.input(name, "bool")
    outer.input("u")
    outer.add("middle", middle, u="u", deep="deep", enable="go", enabling="restart")
    outer.add("kept", totalling("kept"), u="u", enable="go")
    for name in ("fast", "slow", "deeper"):
        middle.output(name, name)
        outer.output(name, f"middle.{name}")
    outer.output("kept", "kept")
    d = whole("restarting", "on", "go", "deep")
    d.add("outer", outer, u="u", go="go", deep="deep", enable="on")
    for name in outer.outputs:
        d.output(name, f"outer.{name}")
    given = rows(1, ("on", "go", "deep"))
    y, total = dict.fromkeys(outer.outputs, 0.0), dict.fromkeys(outer.outputs, 10.0)
    before, expected = True, []
    for k, row in enumerate(given):
        acts = row["on"] and row["go"]
        if acts and not before:
            total |= {"fast": 10.0, "slow": 10.0, "deeper": 10.0}
        before = acts
        for name, also in (("fast", True), ("slow", k % 2 == 1), ("deeper", row["deep"]), ("kept", True)):
            if acts and also:
                y[name] = total[name] = total[name] + row["u"]
        expected.append(dict(y))
    return Told(Case(d, [], given, {}), expected)


@told
def triggered() -> Told:
    """A part acts at the edges of a bool; one also while it is enabled; one, at a third of the rate, looks less often.

    The part around them is enabled: while it is not, nobody looks at the trigger. At its first look it has no edge.
    """
    outer = Diagram("outer")
    outer.input("u")
    for name in ("pulse", "go"):
        outer.input(name, "bool")
    for edge in EDGES:
        outer.add(edge, totalling(edge), u="u", trigger="pulse", edge=edge)
    outer.add("both", totalling("both"), u="u", trigger="pulse", enable="go", disabled="reset", enabling="restart")
    outer.add("held", ZeroOrderHold(), u="u", rate=(3, 2))
    outer.add("slow", totalling("slow"), u="held", rate=(3, 2), trigger="pulse", edge="either")
    d = whole("triggered", "on", "pulse", "go")
    for name in (*EDGES, "both", "slow"):
        outer.output(name, name)
    d.add("outer", outer, u="u", pulse="pulse", go="go", enable="on")
    for name in outer.outputs:
        d.output(name, f"outer.{name}")
    given = rows(2, ("on", "pulse", "go"))
    y, total = dict.fromkeys(outer.outputs, 0.0), dict.fromkeys(outer.outputs, 10.0)
    before: dict[str, bool] = {}
    enabled, expected = True, []
    for k, row in enumerate(given):
        if row["on"] and row["go"] and not enabled:
            total["both"] = 10.0
        enabled = row["on"] and row["go"]
        edges = {"rising": [(False, True)], "falling": [(True, False)], "either": [(False, True), (True, False)]}
        for name in outer.outputs if row["on"] else ():
            if name == "slow" and k % 3 != 2:
                continue
            edge = {"both": "rising", "slow": "either"}.get(name, name)
            acts = name in before and (before[name], row["pulse"]) in edges[edge]
            before[name] = row["pulse"]
            if acts and (name != "both" or row["go"]):
                y[name] = total[name] = total[name] + row["u"]
        if not row["go"]:
            y["both"] = 0.0
        expected.append(dict(y))
    return Told(Case(d, [], given, {}), expected)


@told
def starting_elsewhere() -> Told:
    """Outputs that hold, or are put back to, other values than 0: of parts that are disabled, late or triggered."""
    inner = Diagram("inner")
    inner.input("u")
    inner.add("total", Total(), u="u")
    inner.add("pair", Mux(2), a="u", b="total")
    inner.add("positive", CompareToConstant(">", 0.0), u="u")
    for name, source in (("y", "total"), ("pair", "pair"), ("positive", "positive")):
        inner.output(name, source)
    middle = Diagram("middle")
    middle.input("u")
    middle.add("inner", inner, u="u")
    for name in inner.outputs:
        middle.output(name, f"inner.{name}")
    d = whole("starting_elsewhere", "on")
    initial = {"y": -3.0, "pair": [4.0, 5.0], "positive": True}
    d.add("hold", middle, u="u", enable="on", initial=initial)
    d.add("back", middle, u="u", enable="on", initial=initial, disabled="reset")
    elsewhere = {"y": 6.5, "positive": False}
    d.add("elsewhere", middle, u="u", enable="on", initial=initial, disabled=elsewhere)
    d.add("edge", middle, u="u", trigger="on", initial={"y": 7.0})
    d.add("late", ZeroOrderHold(), u="u", rate=(5, 4), initial={"y": 9.0})
    d.output("late", "late")
    for part in ("hold", "back", "elsewhere", "edge"):
        for name in inner.outputs:
            d.output(f"{part}_{name}", f"{part}.{name}")
    given = [{**row, "on": row["on"] and k > 6} for k, row in enumerate(rows(3, ("on",)))]
    start: dict[str, Any] = {"y": -3.0, "pair": [4.0, 5.0], "positive": True}
    y = {"hold": start, "back": start, "elsewhere": start, "edge": {"y": 7.0, "pair": [0.0, 0.0], "positive": False}}
    total = dict.fromkeys(y, 10.0)
    late, before, expected = 9.0, True, []
    for k, row in enumerate(given):
        late = row["u"] if k % 5 == 4 else late
        for name in y:
            if row["on"] and not (name == "edge" and before):
                total[name] += row["u"]
                y[name] = {"y": total[name], "pair": [row["u"], total[name]], "positive": row["u"] > 0}
            elif name in ("back", "elsewhere"):
                y[name] = start if name == "back" else start | elsewhere
        before = row["on"]
        expected.append({"late": late, **{f"{part}_{n}": v for part, now in y.items() for n, v in now.items()}})
    return Told(Case(d, [], given, {}), expected)


def scaled(name: str, factor: float) -> Diagram:
    """u * factor, how often it has acted since it started, and the two as an array."""
    d = Diagram(name)
    d.input("u")
    d.add("gain", Gain(factor), u="u")
    d.add("one", Constant(1.0))
    d.add("count", Total(), u="one")
    d.add("pair", Mux(2), a="gain", b="count")
    d.output("y", "gain")
    d.output("count", "count")
    d.output("pair", "pair")
    return d


def acting(case: Diagram, parts: dict[str, float], turns: Sequence[str], given: list[dict[str, Any]]) -> Told:
    """Return the case and rows of an action group whose parts act in these `turns` ("": none) and restart."""
    count = dict.fromkeys(parts, 10.0)
    now: Row = {"y": 0.0, "count": -1.0, "pair": [0.0, 0.0]}
    expected, before = [], next(iter(parts))
    for row, turn in zip(given, turns, strict=True):
        if turn:
            count[turn] = (count[turn] if turn == before else 10.0) + 1.0
            y = row["u"] * parts[turn]
            now = {"y": y, "count": count[turn], "pair": [y, count[turn]]}
        before = turn
        expected.append(now)
    return Told(Case(case, [], given, {}), expected)


def group_of(factors: dict[str, float], name: str, **options: Any) -> Diagram:
    """A group within a diagram, whose inputs and outputs are the group's."""
    actions = {action: scaled(action, factor) for action, factor in factors.items()}
    otherwise = actions.pop("otherwise", None)
    group = action_group("group", actions, otherwise, enabling="restart", initial={"count": -1.0}, **options)
    d = Diagram(name)
    for port in group.inputs.values():
        d.input(port.name, port.kind)
    d.add("group", group, inputs={n: n for n in group.inputs})
    for output in group.outputs:
        d.output(output, f"group.{output}")
    return d


@told
def if_else() -> Told:
    """if, else if, else: conditions in order, exactly one part acts and starts afresh."""
    factors = {"first": 2.0, "second": 3.0, "otherwise": 5.0}
    given = rows(4, ("if_first", "if_second"))
    given[0] |= {"if_first": True}
    turns = ["first" if r["if_first"] else "second" if r["if_second"] else "otherwise" for r in given]
    return acting(group_of(factors, "if_else"), factors, turns, given)


@told
def switch_case() -> Told:
    """switch without default: where no part acts the last one's value stays. The first case that names 2 has it."""
    factors = {"low": 2.0, "high": 3.0}
    d = group_of(factors, "switch_case", values={"low": [-1, 2], "high": [2, 5, 5]})
    given = [{"u": row["u"], "case": 2 if k == 0 else int(row["u"])} for k, row in enumerate(rows(5, ()))]
    turns = ["low" if r["case"] in (-1, 2) else "high" if r["case"] == 5 else "" for r in given]
    return acting(d, factors, turns, given)


@told
def stored() -> Told:
    """A store is written in one diagram, at times, and read in others, faster and slower: as it was before the tick.

    An inner store of the same name hides it. One that stands in a slower diagram changes at that one's ticks.
    """
    writer = Diagram("writer")
    writer.input("u")
    writer.add("write", StoreWrite("cell"), u="u")
    writer.add("read", StoreRead("cell"))
    writer.output("own", "read")
    hidden = Diagram("hidden")
    hidden.input("u")
    hidden.add("cell", DataStore(7.0))
    hidden.add("write", StoreWrite("cell"), u="u")
    hidden.add("read", StoreRead("cell"))
    hidden.output("inner", "read")
    slow = Diagram("slow")
    slow.add("read", StoreRead("cell"))
    slow.output("late", "read")
    d = whole("stored", "on")
    d.add("reader", StoreRead("cell"))
    d.add("writer", writer, u="u", enable="on")
    d.add("hidden", hidden, u="u")
    d.add("slow", slow, rate=(4, 1))
    d.add("cell", DataStore(3.0))
    for name, source in (("y", "reader"), ("own", "writer"), ("inner", "hidden"), ("late", "slow"), ("wired", "cell")):
        d.output(name, source)
    given = [{**row, "on": row["on"] and k > 5} for k, row in enumerate(rows(6, ("on",)))]
    cell, inner, own, late, expected = 3.0, 7.0, 0.0, 0.0, []
    for k, row in enumerate(given):
        own = cell if row["on"] else own
        late = cell if k % 4 == 1 else late
        expected.append({"y": cell, "own": own, "inner": inner, "late": late, "wired": cell})
        cell, inner = row["u"] if row["on"] else cell, row["u"]
    return Told(Case(d, [], given, {}), expected)


@told
def delayed_variably() -> Told:
    """u[k - n[k]], n clamped to 0 .. 7, or 1 .. 7; in a part that is enabled at times, of scalars and of arrays."""
    part = Diagram("part")
    part.input("u")
    part.input("n", "int32")
    part.add("pair", Mux(2), a="u", b="seven")
    part.add("seven", Constant(7.0))
    part.add("direct", VariableDelay(7, -1.0), u="u", samples="n")
    part.add("late", VariableDelay(7, -1.0, direct=False), u="u", samples="n")
    part.add("pairs", VariableDelay(7, [1.0, 2.0], width=2), u="pair", samples="n")
    part.add("loop", Sum("++"), a="u", b="back")
    part.add("back", VariableDelay(1, direct=False), u="loop", samples="n")
    d = whole("delayed_variably", "on")
    d.input("n", "int32")
    d.add("part", part, u="u", n="n", enable="on")
    names = ("direct", "late", "pairs", "loop")
    for name in names:
        part.output(name, name)
        d.output(name, f"part.{name}")
    given = [{**row, "n": int(row["n"] * 2) + 3} for row in rows(7, ("on",), ("u", "n"))]
    now: Row = {"direct": 0.0, "late": 0.0, "pairs": [0.0, 0.0], "loop": 0.0}
    past: list[float] = []
    total, expected = 0.0, []
    for row in given:
        if row["on"]:
            past.append(row["u"])
            total += row["u"]
            n = min(max(row["n"], 0), 7)
            least = max(n, 1)
            now = {
                "direct": past[-1 - n] if n < len(past) else -1.0,
                "late": past[-1 - least] if least < len(past) else -1.0,
                "pairs": [past[-1 - n], 7.0] if n < len(past) else [1.0, 2.0],
                "loop": total,
            }
        expected.append(now)
    return Told(Case(d, [], given, {}), expected)


@told
def integrated_afresh() -> Told:
    """Discrete integrators that start from a signal, and again at levels and edges of a bool."""
    inner = Diagram("inner")
    d = whole("integrated_afresh", "on", "clear")
    for name, kind in (("u", "real"), ("x0", "real"), ("clear", "bool")):
        inner.input(name, kind)
    d.input("x0")
    for reset in RESETS:
        for method in ("forward", "backward"):
            part = f"{reset}_{method}"
            block = DiscreteIntegrator(method, 1 / DT, "input", reset=reset)
            cleared = {} if reset == "none" else {"clear": "clear"}
            inner.add(part, block, inputs={"u": "u", "x0": "x0", **cleared})
            inner.output(part, part)
            d.output(part, f"inner.{part}")
    inner.add("own", DiscreteIntegrator("forward", 1 / DT, 4.0, reset="falling"), u="u", clear="clear")
    inner.output("own", "own")
    d.output("own", "inner.own")
    d.add("inner", inner, u="u", x0="x0", clear="clear", enable="on")
    given = rows(8, ("on", "clear"), ("u", "x0"))
    now = dict.fromkeys(inner.outputs, 0.0)
    total, before, expected = dict.fromkeys(inner.outputs, 4.0), -1, []
    for row in given:
        if row["on"]:
            edge = {(0, 1): ("rising", "either"), (1, 0): ("falling", "either")}.get((before, int(row["clear"])), ())
            for name in inner.outputs:
                reset, _, method = name.partition("_")
                first = before < 0 and name != "own"
                if first or (reset == "level" and row["clear"]) or ("falling" if name == "own" else reset) in edge:
                    total[name] = 4.0 if name == "own" else row["x0"]
                now[name] = total[name] + row["u"] if method == "backward" else total[name]
                total[name] += row["u"]
            before = int(row["clear"])
        expected.append(dict(now))
    return Told(Case(d, [], given, {}), expected)


def resetting(precision: str) -> Told:
    """A lag whose integrator starts at its own input's double, where that is beyond bounds: both move inside the step.

    The numbers are those of the precision, by Runge and Kutta's method of order 4 as the language writes it.
    """
    d = whole("resetting")
    d.add("other", Integrator(), u="u")
    d.add("x0", Gain(2.0), u="other")
    d.add("beyond", CompareToConstant(">", 0.02), u="other")
    given = rows(9, (), ("u",))
    resets = [reset for reset in RESETS if reset != "none"]
    for reset in resets:
        lag = resettable_integrator("lag", reset, "input", limits=(-1.0, 1.0))
        d.add(f"to_{reset}", Sum("+-"), a="u", b=reset)
        d.add(reset, lag, u=f"to_{reset}", x0="x0", clear="beyond")
        d.output(reset, reset)
    real = {"float64": np.float64, "float32": np.float32}[precision]
    h, two = real(DT), real(2.0)
    half, sixth = h * real(0.5), h * real(1 / 6)

    def moved(x: Any, slope: Callable[[Any], Any]) -> Any:
        k1 = slope(x)
        k2 = slope(x + half * k1)
        k3 = slope(x + half * k2)
        k4 = slope(x + h * k3)
        return x + sixth * (((k1 + two * k2) + two * k3) + k4)

    def bounded(x: Any) -> Any:
        return max(real(-1.0), min(real(1.0), x))

    other, before = real(0.0), -1
    x = dict.fromkeys(resets, real(0.0))
    expected = []
    for row in given:
        u, now = real(row["u"]), int(other > real(0.02))
        edge = {(0, 1): ("rising", "either"), (1, 0): ("falling", "either")}.get((before, now), ())
        for reset in resets:
            if before < 0 or (reset == "level" and now) or reset in edge:
                x[reset] = real(2.0) * other
        before = now
        expected.append({reset: bounded(value).item() for reset, value in x.items()})
        x = {reset: bounded(moved(value, lambda y, u=u: u - bounded(y))) for reset, value in x.items()}
        other = moved(other, lambda _, u=u: u)
    return Told(Case(d, [], given, {}), expected)
