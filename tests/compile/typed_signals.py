"""Diagrams over enumerations and buses, and beside each a loop that says in Python what it does."""

import random
from collections import deque
from enum import IntEnum
from typing import Any

from tests.compile.differential import Case
from tests.compile.semantics import STEPS, Told, told
from tests.compile.semantics import TOLD as TOLD
from twodof.blocks import Block, Bus, Diagram, Enumeration, Param, Port, State, to_enumeration, where
from twodof.blocks.action_group import action_group
from twodof.blocks.library import (
    BusAssign,
    BusCreate,
    BusSelect,
    CompareToConstant,
    Constant,
    Convert,
    DataStore,
    Delay,
    Gain,
    MultiportSwitch,
    Mux,
    StoreRead,
    StoreWrite,
    Switch,
    UnitDelay,
    VariableDelay,
    ZeroOrderHold,
)


class Mode(IntEnum):
    """Modes whose values have gaps."""

    idle = 0
    armed = 1
    flying = 5
    broken = -(2**31)


Light = Enumeration("Light", green=0, red=1)


class ModeLogic(Block):
    """Armed flies when told to go; broken stays broken until told twice."""

    inputs = (Port("asked", Mode), Port("go", "bool"))
    outputs = (Port("mode", Mode), Port("light", Light), Port("two", Mode, width=2))
    states = (State("last", Mode.idle, Mode), State("light", kind=Light))
    params = (Param("after", "armed", Mode),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        free = where(u.go & (u.asked == Mode.armed), Mode.flying, u.asked)
        mode = where((x.last == Mode.broken) & ~u.go, x.last, where(x.last == Mode.flying, p.after, free))
        light = to_enumeration(Light, mode // 2)
        return {"mode": mode, "light": where(u.go, light, Light.red), "two": [mode, x.last]}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"last": self.output(u, x, p, t)["mode"]}


def constant(name: str, mode: Mode) -> Diagram:
    """A sub-diagram whose output is a mode."""
    d = Diagram(name)
    d.add("one", Constant(mode, Mode))
    d.output("mode", "one")
    return d


@told
def enumerated() -> Told:
    """Modes computed, converted, delayed, held, stored, chosen and merged."""
    d = Diagram("enumerated")
    d.input("number", "int32")
    d.input("go", "bool")
    d.input("asked", Mode)
    d.add("convert", Convert("int32", Mode), u="number")
    d.add("logic", ModeLogic(), asked="convert", go="go")
    d.add("late", Delay(2, initial=Mode.armed, kind=Mode), u="logic.mode")
    d.add("chosen", Switch(Mode), condition="go", a="late", b="asked")
    d.add("group", action_group("group", {"a": constant("a", Mode.armed), "b": constant("b", Mode.flying)}))
    d.connect("go", "group.if_a")
    d.add("flies", CompareToConstant("==", Mode.flying, Mode), u="late")
    d.connect("flies", "group.if_b")
    held = Diagram("held")
    held.input("u", Mode)
    held.add("past", UnitDelay("idle", Mode), u="u")
    held.output("y", "past")
    d.add("held", held, u="logic.mode", enable="go", initial={"y": "broken"})
    d.add("store", DataStore(Mode.flying, Mode))
    d.add("write", StoreWrite("store", Mode), u="chosen")
    d.add("read", StoreRead("store", Mode))
    d.add("any", MultiportSwitch(3, Mode), index="number", a="read", b="held.y", c="group.mode")
    d.add("both", Mux(2, Mode), a="any", b="logic.mode")
    outputs = {"mode": "logic.mode", "light": "logic.light", "two": "logic.two", "late": "late", "chosen": "chosen"}
    for name, source in {**outputs, "held": "held.y", "group": "group.mode", "both": "both"}.items():
        d.output(name, source)
    r = random.Random(7)
    inputs: list[dict[str, Any]] = []
    expected: list[dict[str, Any]] = []
    last, shown, past, merged = 0, int(Mode.broken), 0, 0
    stored, late = int(Mode.flying), deque([1, 1])
    for _ in range(STEPS):
        number, go, asked = r.choice((0, 1, 2, 5, 5, -(2**31), 7)), r.random() < 0.6, int(r.choice(list(Mode)))
        inputs.append({"number": number, "go": go, "asked": asked})
        converted = number if number in list(Mode) else 0
        free = 5 if go and converted == 1 else converted
        mode = last if last == Mode.broken and not go else (1 if last == 5 else free)
        light = (1 if int(mode / 2) == 1 else 0) if go else 1
        delayed = late[0]
        chosen = delayed if go else asked
        merged = 1 if go else 5 if delayed == 5 else merged
        shown, past = (past, mode) if go else (shown, past)
        any_ = (stored, shown, merged)[min(max(number, 0), 2)]
        expected.append(
            {"mode": mode, "light": light, "two": [mode, last], "late": delayed, "chosen": chosen, "held": shown}
            | {"group": merged, "both": [any_, mode]}
        )
        late.popleft()
        late.append(mode)
        last, stored = mode, chosen
    return Told(Case(d, [], inputs, {}), expected)


RATES = Bus("Rates", [Port("p", unit="rad/s"), Port("count", "int32")])
STATE = Bus(
    "State",
    [Port("roll", unit="rad"), Port("rates", RATES), Port("ok", "bool"), Port("mode", Mode), Port("v", width=2)],
)


class Turned(Block):
    """A state in which all is turned round, and its rates alone."""

    inputs = (Port("s", STATE), Port("gain"))
    outputs = (Port("s", STATE), Port("rates", RATES))
    states = (State("past", {"roll": 7.0, "rates": {"count": 2}}, STATE),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        rates = RATES(p=u.s.rates.p * u.gain, count=u.s.rates.count + x.past.rates.count)
        turned = STATE(roll=-u.s.roll + x.past.roll, rates=rates, ok=~u.s.ok, mode=x.past.mode, v=[u.s.v[1], u.s.v[0]])
        return {"s": turned, "rates": u.s.rates}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"past": u.s}


def _inner() -> Diagram:
    """Make a sub-diagram with a bus as an input and as an output."""
    d = Diagram("inner")
    d.input("s", STATE)
    d.input("gain")
    d.add("turned", Turned(), s="s", gain="gain")
    d.add("late", UnitDelay(kind=STATE, initial={"roll": 0.5, "mode": "armed"}), u="turned.s")
    d.output("s", "late")
    d.output("rates", "turned.rates")
    d.output("count", "s.rates.count")
    return d


def _turn(s: dict[str, Any], gain: float, past: dict[str, Any]) -> dict[str, Any]:
    rates = {"p": s["rates"]["p"] * gain, "count": s["rates"]["count"] + past["rates"]["count"]}
    roll = past["roll"] - s["roll"]
    return {"roll": roll, "rates": rates, "ok": not s["ok"], "mode": past["mode"], "v": s["v"][::-1]}


def _flat(name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        return {name: value}
    return {path: one for field, inner in value.items() for path, one in _flat(f"{name}.{field}", inner).items()}


@told
def bused() -> Told:
    """A bus into a sub-diagram that is enabled at times, through delays and switches, taken apart and put together."""
    d = Diagram("bused")
    d.input("s", STATE)
    d.input("gain")
    d.input("go", "bool")
    d.add("inner", _inner(), s="s", gain="gain", enable="go", initial={"s.roll": 3.0})
    d.add("choice", Switch(STATE), condition="s.ok", a="inner.s", b="s")
    d.add("doubled", Gain(2.0, unit="rad"), u="choice.roll")
    d.add("changed", BusAssign(STATE, ["roll", "rates.p"]), u="choice", roll="doubled", rates_p="inner.rates.p")
    d.add("store", DataStore({"mode": Mode.flying}, STATE))
    d.add("write", StoreWrite("store", STATE), u="changed")
    d.add("read", StoreRead("store", STATE))
    d.add("parts", BusSelect(STATE, ["rates", "rates.p", "v"]), bus="read")
    d.add("made", BusCreate(Bus("Made", [Port("n", "int32"), Port("both", RATES)])), n="inner.count")
    d.connect("parts.rates", "made.both")
    d.add("again", Turned(), gain="gain")
    for field in ("roll", "rates", "ok", "mode"):  # field by field
        d.connect(f"changed.y.{field}", f"again.s.{field}")
    d.connect("parts.v", "again.s.v")
    for name, source in {"s": "again.s", "rates": "inner.rates", "made": "made", "p": "parts.rates_p"}.items():
        d.output(name, source)
    r = random.Random(11)
    inputs: list[dict[str, Any]] = []
    expected: list[dict[str, Any]] = []
    zero: dict[str, Any] = {"roll": 0, "rates": {"p": 0, "count": 0}, "ok": False, "mode": 0, "v": [0, 0]}
    first = {**zero, "roll": 7, "rates": {"p": 0, "count": 2}}
    past, again_past, store = first, first, {**zero, "mode": 5}
    late, shown, rates = {**zero, "roll": 0.5, "mode": 1}, {**zero, "roll": 3}, {"p": 0, "count": 0}
    for _ in range(STEPS):
        vector = [float(r.randint(-9, 9)) for _ in range(2)]
        s = {"roll": float(r.randint(-9, 9)), "rates": {"p": float(r.randint(-9, 9)), "count": r.randint(-9, 9)}}
        s |= {"ok": r.random() < 0.5, "mode": int(r.choice(list(Mode))), "v": vector}
        gain, go = float(r.randint(-3, 3)), r.random() < 0.6
        inputs.append({**_flat("s", s), "gain": gain, "go": go})
        if go:
            shown, rates = late, s["rates"]
            late, past = _turn(s, gain, past), s
        choice = shown if s["ok"] else s
        changed = {**choice, "roll": 2.0 * choice["roll"], "rates": {**choice["rates"], "p": rates["p"]}}
        mixed = {**changed, "v": store["v"]}
        made = {"n": s["rates"]["count"], "both": store["rates"]}
        out = _flat("s", _turn(mixed, gain, again_past)) | _flat("rates", rates) | _flat("made", made)
        expected.append({**out, "p": store["rates"]["p"]})
        again_past, store = mixed, changed
    return Told(Case(d, [], inputs, {}), expected)


class Corner(Block):
    """One element of a matrix."""

    inputs = (Port("m", shape=(2, 2)),)
    outputs = (Port("y"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.m[0, 1]


@told
def bus_delayed() -> Told:
    """A bus with arrays, delayed by a fixed and by a varying number of samples, at half the rate."""
    v, m = Port("v", "int8", width=3), Port("m", shape=(2, 2))
    bus = Bus("Wide", [v, m, Port("rates", RATES), Port("mode", Mode), Port("ok", "bool")])
    names = ("v", "rates.p", "rates.count", "mode", "ok")
    first: dict[str, Any] = {"m": 4.0, "rates": {"p": -1.5}, "mode": "flying"}
    before = {"v": [0, 0, 0], "m": 4.0, "rates.p": -1.5, "rates.count": 0, "mode": int(Mode.flying), "ok": False}
    d = Diagram("bus_delayed")
    d.input("s", bus)
    d.input("samples", "int32")
    d.add("held", ZeroOrderHold(bus), rate=(2, 1), u="s")
    d.add("fixed", Delay(3, 5, first, bus), rate=(2, 1), u="held")
    d.add("varying", VariableDelay(4, first, kind=bus), u="s", samples="samples")
    d.add("last", VariableDelay(1, first, False, bus), u="varying", samples="samples")
    for name in ("fixed", "varying", "last"):
        d.add(f"{name}_corner", Corner(), rate=(2, 1) if name == "fixed" else (1, 0), m=f"{name}.y.m")
        d.output(f"{name}_m", f"{name}_corner")
        for field in names:
            d.output(f"{name}_{field.replace('.', '_')}", f"{name}.y.{field}")
    r = random.Random(12)
    inputs: list[dict[str, Any]] = []
    expected: list[dict[str, Any]] = []
    seen: list[dict[str, Any]] = []
    moved: list[dict[str, Any]] = []
    slow: list[dict[str, Any]] = []
    shown: dict[str, Any] = dict.fromkeys([*names, "m"], 0) | {"v": [0, 0, 0], "ok": False}
    for k in range(STEPS):
        corner = float(r.randint(-9, 9))
        s = {"v": [r.randint(-128, 127) for _ in range(3)], "m": corner, "mode": int(r.choice(list(Mode)))}
        s |= {"rates.p": float(r.randint(-9, 9)), "rates.count": r.randint(-9, 9), "ok": r.random() < 0.5}
        samples = r.randint(-1, 6)
        matrix = [[1.0, corner], [2.0, 3.0]]
        inputs.append({**{f"s.{name}": s[name] for name in names}, "s.m": matrix, "samples": samples})
        seen.append(s)
        back = min(max(samples, 0), 4)
        moved.append(seen[k - back] if back <= k else before)
        if k % 2 == 1:
            slow.append(s)
            shown = slow[-4] if len(slow) > 3 else before
        last = moved[k - 1] if k else before
        given = {"fixed": shown, "varying": moved[k], "last": last}
        values = {f"{port}_{name}": at[name] for port, at in given.items() for name in ("m", *names)}
        expected.append({name.replace(".", "_"): value for name, value in values.items()})
    return Told(Case(d, [], inputs, {}), expected)


UNIT = Bus("Unit", [Port("speed", unit="rad/s"), Port("at", width=2), Port("rates", RATES), Port("mode", Mode)])
UNITS = 3


class Crew(Block):
    """Several buses side by side: read one by one, by a computed index, and field by field."""

    inputs = (Port("units", UNIT, width=UNITS), Port("which", "int32"))
    outputs = (Port("units", UNIT, width=UNITS), Port("one", UNIT), Port("total", unit="rad/s"))
    states = (State("last", [{"speed": 1.0}, {"speed": 2.0}, {"speed": 4.0}], UNIT, width=UNITS),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        made = [
            UNIT(speed=new.speed - last.speed, at=[new.at[1], last.at[0]], rates=last.rates, mode=new.mode)
            for new, last in zip(u.units, x.last, strict=True)
        ]
        return {"units": made, "one": u.units[u.which], "total": sum(u.units.speed)}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"last": u.units}


def _fields(unit: dict[str, Any]) -> dict[str, Any]:
    """The values of a unit by output: a vector's elements one by one."""
    flat = _flat("", unit)
    at = flat.pop(".at")
    return {**{name[1:].replace(".", "_"): value for name, value in flat.items()}, "at_0": at[0], "at_1": at[1]}


class Element(Block):
    """One of several units, as numbers."""

    inputs = (Port("units", UNIT, width=UNITS),)
    outputs = (
        *(Port("speed", unit="rad/s"), Port("at_0"), Port("at_1"), Port("rates_p", unit="rad/s")),
        *(Port("rates_count", "int32"), Port("mode", Mode)),
    )

    def __init__(self, which: int) -> None:
        self.which = which

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        unit = u.units[self.which]
        rates = {"rates_p": unit.rates.p, "rates_count": unit.rates.count}
        return {"speed": unit.speed, "at_0": unit.at[0], "at_1": unit.at[1], **rates, "mode": unit.mode}


@told
def bus_arrays() -> Told:
    """An array of buses through a block, an enabled sub-diagram, a switch and a delay."""
    d = Diagram("bus_arrays")
    d.input("units", UNIT, width=UNITS)
    d.input("which", "int32")
    d.input("go", "bool")
    d.add("crew", Crew(), units="units", which="which")
    inner = Diagram("inner")
    inner.input("units", UNIT, width=UNITS)
    inner.add("late", Delay(2, 3, {"speed": [7.0, 8.0, 9.0], "mode": "armed"}, UNIT, UNITS), u="units")
    inner.output("units", "late")
    d.add("inner", inner, enable="go", units="crew.units")
    d.add("choice", Switch(UNIT, UNITS), condition="go", a="inner.units", b="units")
    for name, source in (("crew", "crew.units"), ("choice", "choice")):
        for i in range(UNITS):
            element = d.add(f"{name}{i}", Element(i), units=source)
            for port in Element.outputs:
                d.output(f"{name}{i}_{port.name}", f"{element}.{port.name}")
    for name in ("speed", "rates.p", "rates.count", "mode"):
        d.output(f"one_{name.replace('.', '_')}", f"crew.one.{name}")
    d.output("total", "crew.total")
    r = random.Random(13)
    inputs: list[dict[str, Any]] = []
    expected: list[dict[str, Any]] = []
    zero = {"speed": 0.0, "at": [0.0, 0.0], "rates": {"p": 0.0, "count": 0}, "mode": 0}
    last = [{**zero, "speed": speed} for speed in (1.0, 2.0, 4.0)]
    before = [{**zero, "speed": speed, "mode": 1} for speed in (7.0, 8.0, 9.0)]
    late, shown = [before, before], [zero] * UNITS
    for _ in range(STEPS):
        units = [
            {
                "speed": float(r.randint(-9, 9)),
                "at": [float(r.randint(-9, 9)), float(r.randint(-9, 9))],
                "rates": {"p": float(r.randint(-9, 9)), "count": r.randint(-9, 9)},
                "mode": int(r.choice(list(Mode))),
            }
            for _ in range(UNITS)
        ]
        which, go = r.randint(-2, 4), r.random() < 0.5
        by_field = {name: [_flat("", unit)[name] for unit in units] for name in _flat("", units[0])}
        inputs.append({**{f"units{name}": values for name, values in by_field.items()}, "which": which, "go": go})
        made = [
            {**old, "speed": new["speed"] - old["speed"], "at": [new["at"][1], old["at"][0]], "mode": new["mode"]}
            for new, old in zip(units, last, strict=True)
        ]
        if go:
            shown = late.pop(0)
            late.append(made)
        choice = shown if go else units
        row: dict[str, Any] = {"total": (units[0]["speed"] + units[1]["speed"]) + units[2]["speed"]}
        for name, given in (("crew", made), ("choice", choice)):
            for i, unit in enumerate(given):
                row |= {f"{name}{i}_{port}": value for port, value in _fields(unit).items()}
        one = _fields(units[min(max(which, 0), UNITS - 1)])
        expected.append(row | {f"one_{name}": v for name, v in one.items() if not name.startswith("at")})
        last = units
    return Told(Case(d, [], inputs, {}), expected)
