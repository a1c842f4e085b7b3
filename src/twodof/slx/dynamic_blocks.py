"""Simulink's blocks with a memory or a clock: delays, integrators, filters, controllers, noise, sources of time.

Each has the order of operations of MathWorks' C: a Discrete Derivative keeps the scaled input, a filter is in direct
form II.
"""

import math
import operator
from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.action_group import resettable_integrator
from twodof.blocks.block import Block, Clock
from twodof.blocks.bus import Bus
from twodof.blocks.declarations import State
from twodof.blocks.elementary.functions import floor
from twodof.blocks.elementwise import clamp, elementwise, port_series
from twodof.blocks.expressions.expr import convert, int32, where
from twodof.blocks.expressions.numbers import INTEGER_TYPES, INTEGERS, WORDS
from twodof.blocks.library import (
    Bias,
    Constant,
    Convert,
    Delay,
    Demux,
    DiscreteIntegrator,
    DiscreteStateSpace,
    Gain,
    Integrator,
    Product,
    Relay,
    Saturation,
    StateSpace,
    Step,
    Sum,
    Time,
    TransferFunction,
    UnitDelay,
    VariableDelay,
    ZeroOrderHold,
)
from twodof.slx.arithmetic import exact, fitted
from twodof.slx.composite_blocks import Formula, Next, formula
from twodof.slx.conditions import ControlEdge
from twodof.slx.data_types import kind_of, value_of
from twodof.slx.translation import (
    Asked,
    Item,
    Made,
    NotTranslated,
    Rule,
    Signal,
    each,
    expanded,
    names_of,
    passes,
    plain,
    row,
)


def _initial(c: Asked, *names: str) -> tuple[Any, Signal]:
    """Return initial condition and signal of a delay, which may be wider than a scalar input."""
    name = next((one for one in names if one in c.values), names[0])
    known = c.inputs[0]
    if isinstance(known.kind, Bus):
        return value_of(c.structure(name, "0"), known), known
    value = c.value(name, "0")
    width = known.width or (value.size if value.size > 1 else None)
    initial = (
        plain(value.flat[0], known.kind) if value.size == 1 else [plain(v, known.kind) for v in value.flatten("F")]
    )
    if value.size not in (1, width or 1):
        raise NotTranslated(f"parameter {name} has {value.size} elements and the input {width or 1}")
    return initial, Signal(known.kind, width)


def _library_delay(c: Asked) -> Made:
    values = {"DelayLength": c.text("NumDelays", "4"), "InitialCondition": c.text("vinit", "0.0")}
    return _delay(replace(c, values=values))


def _unit_delay(c: Asked) -> Made:
    initial, signal = _initial(c, "InitialCondition", "X0")
    return Made(UnitDelay(initial, signal.kind, signal.width), [signal])


def _delay(c: Asked) -> Made:
    """Return a delay; its inputs are the signal, and as far as it has them the length, the reset, the initial value."""
    ported = c.needs("DelayLengthSource", "Dialog", "Dialog", "Input port") == "Input port"
    given = c.needs("InitialConditionSource", "Dialog", "Dialog", "Input port") == "Input port"
    edge, one = _edge(c), c.inputs[0]
    if c.text("ShowEnablePort", "off") != "off":
        raise NotTranslated("ShowEnablePort is not translated")
    if given and one.width is None:
        one = replace(one, width=c.inputs[-1].width)
    values = {name: text for name, text in c.values.items() if not given or name != "InitialCondition"}
    initial, signal = _initial(replace(c, inputs=[one], values=values), "InitialCondition")
    samples = int(c.scalar("DelayLengthUpperLimit", "100") if ported else c.scalar("DelayLength", "2"))
    if not ported and samples == 0:
        return Made(ZeroOrderHold(signal.kind, signal.width), [signal])
    fixed = Delay(samples, None, initial, signal.kind, signal.width)
    if not (ported or given):
        return _resettable(c, fixed, edge) if edge else Made(fixed, [signal])
    names = ["u", *["samples"] * ported, *["reset"] * bool(edge), *["x0"] * given]
    d, inner = Diagram("delay"), Diagram("inside")
    reset: str | None = None
    for name, port in zip(names, c.inputs, strict=True):
        if name == "reset":
            reset = f"{_clears(d, port, edge)}.y"
            continue
        for at in (d, inner):
            at.input(name, port.kind, port.width)
    item = VariableDelay(samples, initial, True, signal.kind, signal.width) if ported else fixed
    inputs = {"u": expanded(inner, "u", c.inputs[0], signal.width)}
    length = inner.add("length", Convert(c.inputs[1].number, "int32"), u="samples") if ported else inner.add(
        "length", Constant(samples, "int32")
    )  # fmt: skip
    y = inner.add("past", item, inputs=inputs | ({"samples": length} if ported else {}))
    if given:
        start, kind = {"real": 0.0, "bool": False}.get(signal.number, 0), signal.number
        held: Any = lambda t, past, x0, n, k, x: where(k == 0, x0, as_kind(x, kind))  # noqa: E731
        kept = "int32" if kind in INTEGERS else kind
        as_kind: Any = convert if kept != kind else lambda value, _: value
        count = (0, lambda t, past, x0, n, k, x: where(k < samples, k + 1, k))

        def delayed(t: Any, past: Any, x0: Any, n: Any, k: Any, x: Any) -> Any:
            return where(clamp(int32(not ported), int32(samples), n) > k, held(t, past, x0, n, k, x), past)

        first = Formula(
            delayed,
            [signal, signal, Signal("int32")],
            signal,
            {"k": count, "x": (start, lambda *v: as_kind(held(*v), kept))},
        )
        x0 = expanded(inner, "x0", c.inputs[-1], signal.width, signal.kind)
        n = expanded(inner, length, Signal("int32"), signal.width)
        y = f"{inner.add('y', first, u1=y, u2=x0, u3=n)}.y"
    inner.output("y", y)
    d.output("y", d.add("inside", inner, inputs={name: name for name in names if name != "reset"}, reset=reset))
    return Made(d, [signal])


class StartsWithOutput(Block):
    """A discrete integrator whose output, not its state, is the initial value at the start and at a reset."""

    def __init__(self, item: DiscreteIntegrator) -> None:
        self.item = item
        self.inputs, self.outputs, self.params, self.derived = item.inputs, item.outputs, item.params, item.derived
        self.states = [*item.states, State("started", False, "bool")]

    def prepare(self, p: Any, t: Clock) -> Any:
        """Compute the step."""
        return self.item.prepare(p, t)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Return the integral; at a start and a reset its initial value."""
        rule, bound = self.item.rule, self.item._bound
        starts = rule.starts(u, x)
        fresh = ~x.started if starts is None else ~x.started | starts
        initial = u.x0 if rule.external else p.initial
        y = self.item.output(u, x, p, t)
        return elementwise(lambda now, first: where(fresh, bound(first, p), now), y, initial)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Integrate from the output on."""
        y = self.output(u, x, p, t)
        if self.item.method != "backward":
            y = elementwise(lambda v, s: self.item._bound(s + p.step * v, p), u.u, y)
        return {"x": y, **self.item.rule.update(u), "started": True | x.started}


def _discrete_integrator(c: Asked) -> Made:
    method = c.text("IntegratorMethod", "Integration: Forward Euler").partition(": ")
    if method[0] not in ("Integration", "Accumulation") or method[2] not in _METHODS:
        raise NotTranslated(f"IntegratorMethod = {''.join(method)!r} is not translated")
    gain, scale = c.scalar("gainval", "1.0"), 1.0
    if c.inputs[0].kind in (*INTEGERS, "bool"):
        return _whole_accumulator(c, gain)
    if method[0] == "Accumulation":  # the input is scaled, and the gain undoes the period
        near = 1.0 / c.dt
        undoing = [one for one in (near, *np.nextafter(near, [0.0, np.inf]).tolist()) if one * c.dt == 1.0]
        if not undoing:
            raise NotTranslated(f"an accumulation every {c.dt} s is not translated")
        gain, scale = undoing[0], gain

    def integrator(initial: Any, limits: Any, reset: bool, width: int | None) -> Item:
        item = DiscreteIntegrator(_METHODS[method[2]], gain, initial, limits, reset, width)
        shown = method[2] != "Forward Euler" and c.text("InitialConditionSetting", "Output") == "Output"
        return StartsWithOutput(item) if shown else item

    return _integral(c, integrator, scale)


def _whole_accumulator(c: Asked, gain: float) -> Made:
    """Return the sum of whole numbers so far, which wraps around, or is held within the limits."""
    c.needs("IntegratorMethod", "Integration: Forward Euler", "Accumulation: Forward Euler")
    c.only(InitialConditionSource="internal", ShowSaturationPort="off", WrapState="off")
    edge, said, one = _edge(c), c.text("OutDataTypeStr", "Inherit: Inherit via internal rule"), c.inputs[0]
    kind = one.number if said.startswith("Inherit") else str(kind_of(said, c.names))
    control = c.inputs.pop(1) if edge else Signal("bool")
    limits = [c.scalar(f"{end}SaturationLimit", "0") for end in ("Lower", "Upper")]
    limited, start = c.text("LimitOutput", "off") == "on", int(c.scalar("InitialCondition", "0"))
    if gain != 1.0 or kind not in WORDS or not all(map(float.is_integer, limits if limited else [])):
        raise NotTranslated(f"gainval = {gain:g}, or limits {limits}, of whole numbers {kind} are not translated")

    def within(value: Any) -> Any:
        low, high = (INTEGER_TYPES[kind](int(v)) for v in (limits if limited else (0, 0)))
        return clamp(low, high, value) if limited else value

    def now(t: Any, u: Any, clear: Any, x: Any) -> Any:
        return within(where(clear, INTEGER_TYPES[kind](start), convert(x, kind)))

    after: Any = lambda *v: convert(within(now(*v) + convert(v[1], kind)), "int32")  # noqa: E731
    d, signal = Diagram("accumulator"), Signal(kind, one.width)
    item = Formula(now, [one, Signal("bool")], signal, {"x": (int(np.int32(np.uint32(start % 2**32))), after)})
    d.input("u", one.kind, one.width)
    clear = f"{_clears(d, control, edge)}.y" if edge else d.add("never", Constant(False, "bool"))
    clear = expanded(d, clear, Signal("bool"), one.width)
    d.output("y", d.add("y", item, u1="u", u2=clear))
    return Made(d, [signal])


def _integral(c: Asked, integrator: Callable[[Any, Any, bool, int | None], Item], scale: float = 1.0) -> Made:
    """Return an integrator with the ports that its dialog shows, made of initial value, limits, reset and width."""
    edge, external = _edge(c), c.needs("InitialConditionSource", "internal", "internal", "external") == "external"
    c.needs("ShowStatePort", "off", "off")
    control = c.inputs.pop(1) if edge and len(c.inputs) > 1 else Signal("bool")
    c.kind("real")
    limits = None
    if c.text("LimitOutput", "off") == "on":
        limits = [c.scalar("LowerSaturationLimit", "-inf"), c.scalar("UpperSaturationLimit", "inf")]
    initial, signal = ("input", Signal("real", c.width)) if external else _initial(c, "InitialCondition")
    item = integrator(initial, limits, bool(edge), signal.width)
    shown, wraps = c.text("ShowSaturationPort", "off") == "on", c.text("WrapState", "off") == "on"
    if not (edge or external or shown or wraps or scale != 1.0):
        return Made(item, [signal])
    d = Diagram("integral")
    d.input("u", width=c.inputs[0].width)
    inputs, y = {"u": expanded(d, "u", c.inputs[0], signal.width)}, "integrator.y"
    if scale != 1.0:
        inputs["u"] = d.add("scaled", Gain(scale, signal.width), u=inputs["u"])
    if edge:
        inputs["clear"] = f"{_clears(d, control, edge)}.y"
    if external:
        d.input("x0", width=c.inputs[-1].width)
        inputs["x0"] = expanded(d, "x0", c.inputs[-1], signal.width)
    d.add("integrator", item, inputs=inputs)
    if wraps:
        c.notes.append("the output is wrapped, the state is not")
        low, high = c.scalar("WrappedStateLowerValue", "-pi"), c.scalar("WrappedStateUpperValue", "pi")
        turn = Formula(lambda t, y: y - floor((y - low) / (high - low)) * (high - low), [signal], signal)
        y = f"{d.add('wrapped', turn, u1=y)}.y"
    d.output("y", y)
    if shown:
        least, most = limits or [-math.inf, math.inf]
        limit = Formula(lambda t, y: where(y >= most, 1.0, where(y <= least, -1.0, 0.0)), [signal], signal)
        d.output("limited", d.add("limit", limit, u1="integrator.y"))
    return Made(d, [signal] * (1 + shown))


def _edge(c: Asked) -> str:
    """Return the edge of a block's reset input; "" without one."""
    said = c.text("ExternalReset", "none").lower()
    if said not in ("none", "rising", "falling", "either", "level", "sampled level", "level hold"):
        raise NotTranslated(f"ExternalReset = {said!r} is not translated")
    return {"none": "", "sampled level": "level hold"}.get(said, said)


def _clears(d: Diagram, control: Signal, edge: str) -> str:
    """Add the input `reset` to a diagram, and the block that is true when it resets."""
    if control.width is not None:
        raise NotTranslated("its reset is a vector")
    d.input("reset", control.kind)
    return d.add("clears", ControlEdge(edge, control.number, True), u="reset")


def _discrete_derivative(c: Asked) -> Made:
    """Keep the scaled input: y = K u / T less the last one of it."""
    c.kind("real")
    gain = c.scalar("gainval", "1.0") / c.dt
    last = (c.scalar("ICPrevScaledInput", "0.0"), lambda t, u, x: gain * u)
    return formula(c, lambda t, u, x: gain * u - x, x=last)


def _pid(c: Asked) -> Made:
    """Compute y = (P u + integral) + N (D u - filter state), or P times that in ideal form; in MathWorks' order.

    With two degrees of freedom u is b r - y for P, r - y for I, and c r - y for D.
    """
    if {one.kind for one in c.inputs[:1]} != {"real"}:
        raise NotTranslated(f"an input that is {c.inputs[0]} is not translated")
    kind = c.needs("Controller", "PID", "PID", "PI", "PD", "P", "I")
    continuous = c.needs("TimeDomain", "Continuous-time", "Continuous-time", "Discrete-time") == "Continuous-time"
    ideal = c.needs("Form", "Parallel", "Parallel", "Ideal") == "Ideal"
    filtered = c.needs("UseFilter", "on", "on", "off") == "on"
    edge, limited = _edge(c), c.text("LimitOutput", "off") == "on"
    c.needs("LimitIntegratorOutput", "off", "off")
    windup = c.needs("AntiWindupMode", "none", "none", "back-calculation", "clamping") if limited else "none"
    tracks, bounded = c.text("TrackingMode", "off") != "off", c.text("SatLimitsSource", "internal") != "internal"
    started = c.text("InitialConditionSource", "internal") != "internal"
    method = "forward" if continuous else c.pick("IntegratorMethod", "Forward Euler", dict(_METHODS))
    start = c.scalar("InitialConditionForFilter", "0")
    turned = not continuous and filtered and c.text("FilterMethod", "Forward Euler") == "Trapezoidal" and not start
    in_one = (tracks or started or bounded or method != "forward" or turned) and not continuous
    ported = tracks or started or bounded
    if (ported and (continuous or (tracks and bounded))) or (in_one and ideal and (tracks or limited)):
        raise NotTranslated("tracking, or an initial value or limits from ports, are not translated in this form")
    external = c.needs("ControllerParametersSource", "internal", "internal", "external") == "external"
    d, both = Diagram("pid"), "2DOF" in c.block.kind
    for name in ("r", "u") if both else ("u",):
        d.input(name)
    for name in (*kind, *("N" * ("D" in kind and filtered))) if external else ():
        d.input(name)
    clear = ""
    if in_one:
        clear = f"{_clears(d, c.inputs[len(d.inputs)], edge)}.y" if edge else d.add("never", Constant(False, "bool"))
        more = [*["I0"] * ("I" in kind), *["D0"] * ("D" in kind and filtered)] if started else []
        for name in (*more, *["high", "low"] * bounded, *["TR"] * tracks):
            d.input(name)
        c.notes += ["the filter begins at 0, whatever D0 is"] * ("D0" in more)
    weights = {"P": c.scalar("b", "1"), "D": c.scalar("c", "1")} if both else {}

    def error(term: str) -> str:
        if not both:
            return "u"
        reference = "r" if term == "I" else d.add(f"weighted_{term}", Gain(weights[term]), u="r")
        return d.add(f"error_{term}", Sum("+-"), a=reference, b="u")

    def times(name: str, source: str, default: str) -> str:
        if not external:
            return d.add(name, Gain(c.scalar(name, default)), u=source)
        return d.add(f"{name}_times", Product("**"), a=name, b=source)

    terms = list[str]()
    if ideal or "P" in kind:
        terms.append(error("P") if ideal else times("P", error("P"), "1"))
    if "I" in kind:
        rate, first = times("I", error("I"), "1"), c.scalar("InitialConditionForIntegrator", "0")
        terms.append("integral")
        if not in_one:
            d.add("integral", Integrator(first) if continuous else DiscreteIntegrator(method, 1.0, first))
    if "D" in kind:
        slope = times("D", error("D"), "0")
        if not filtered and continuous:
            raise NotTranslated("UseFilter = 'off' in continuous time is not translated")
        if not filtered:
            now = (0.0, lambda t, u, x: u)
            terms.append(
                d.add("N", Formula(lambda t, u, x: (u - x) / c.dt, [Signal()], Signal(), {"x": now}), u1=slope)
            )
        elif turned:
            n = "N" if external else d.add("N", Constant(c.scalar("N", "100")))
            terms.append(f"{d.add('slope', _turned_filter(c.dt), u1=slope, u2=n, u3=clear)}.y")
        elif continuous or c.text("FilterMethod", "Forward Euler") == "Forward Euler":
            d.add("filter", Integrator(start) if continuous else DiscreteIntegrator("forward", 1.0, start))
            terms.append(times("N", d.add("slope", Sum("+-"), a=slope, b="filter"), "100"))
            d.connect(terms[-1], "filter.u")
        else:  # solved for the output, on which the state depends at once
            share = c.pick("FilterMethod", "", {"Backward Euler": c.dt, "Trapezoidal": c.dt / 2.0})
            c.notes.append("the filter is solved for its output: some units in the last place from MathWorks' C")
            of: Callable[..., Any] = lambda t, u, n, x: n * (u - x) / (1.0 + n * share)  # noqa: E731
            x = (start, lambda t, u, n, x: x + of(t, u, n, x) * c.dt)
            n = "N" if external else d.add("N", Constant(c.scalar("N", "100")))
            terms.append(d.add("slope", Formula(of, [Signal()] * 2, Signal(), {"x": x}), u1=slope, u2=n))
    low, high = (c.scalar(f"{end}SaturationLimit", f"{sign}inf") for end, sign in (("Lower", "-"), ("Upper", "")))
    if "I" in kind and in_one:
        wanted = {"rate": rate, "clear": clear, "p": terms[0] * ("P" in kind), "n": terms[-1] * ("D" in kind)}
        wanted |= {"x0": "I0" * started, "high": "high" * bounded, "low": "low" * bounded, "TR": "TR" * tracks}
        ports = {name: source for name, source in wanted.items() if source}
        gains = {"back-calculation": c.scalar("Kb", "1"), "clamping": None, "none": None}
        kb = c.scalar("Kt", "1") if tracks else gains[windup]
        item = _integral_of_pid(c.dt, method, first, (low, high), windup, kb, list(ports))
        d.add("integral", item, inputs={f"u{k}": source for k, source in enumerate(ports.values(), start=1)})
        terms = [f"{one}.y" if one == "integral" else one for one in terms]
    summed = dict(zip("abc", terms, strict=False))
    y = terms[0] if len(terms) == 1 else d.add("sum", Sum("+" * len(terms)), inputs=summed)
    y = times("P", y, "1") if ideal else y
    if limited and bounded:
        within = Formula(
            lambda t, y, high, low: where(y > high, high, where(y < low, low, y)), [Signal()] * 3, Signal()
        )
        y = f"{d.add('limited', within, u1=y, u2='high', u3='low')}.y"
    elif limited:
        before, y = y, d.add("limited", Saturation(low, high), u=y)
        if in_one:
            pass
        elif windup == "back-calculation" and "I" in kind:
            d.add("excess", Sum("+-"), a=y, b=before)
            rate = d.add("driven", Sum("++"), a=d.add("Kb", Gain(c.scalar("Kb", "1")), u="excess"), b=rate)
        elif windup == "clamping" and "I" in kind:  # not while it is limited and would go further
            hold = lambda t, u, y: where(((y > high) & (u > 0.0)) | ((y < low) & (u < 0.0)), 0.0, u)  # noqa: E731
            rate = d.add("clamped", Formula(hold, [Signal()] * 2, Signal()), u1=rate, u2=before)
    if "I" in kind and not in_one:
        d.connect(rate, "integral.u")
    d.output("y", y)
    return _resettable(c, d, edge) if edge and not in_one else Made(d, [Signal()])


def _turned_filter(dt: float) -> Formula:
    """Return the trapezoidal filter of a PID's slope as MathWorks' C computes it: of slope, N and reset."""

    def stepped(t: Any, u: Any, n: Any, clear: Any, x: Any) -> tuple[Any, Any]:
        turn, before = n * (dt / 2.0), where(clear, 0.0, x)
        share = 1.0 / (turn + 1.0)
        now = u - (turn - 1.0) * share * before
        return (now - before) * share * n, now

    state = (0.0, lambda *v: stepped(*v)[1])
    return Formula(lambda *v: stepped(*v)[0], [Signal(), Signal(), Signal("bool")], Signal(), {"x": state})


def _integral_of_pid(
    dt: float, method: str, first: float, limits: tuple[float, float], windup: str, gain: float | None, ports: list[str]
) -> Formula:
    """Return the integral of a PID of the signals `ports`: what it follows is compared with P, D and its last state.

    `gain` is that of the tracking, or of the back-calculation.
    """
    step = dt / 2.0 if method == "trapezoidal" else dt

    def stepped(t: Any, *v: Any) -> tuple[Any, Any]:
        given, (x, begun) = dict(zip(ports, v, strict=False)), v[len(ports) :]
        back, rate = given["p"] + x if "p" in given else x, given["rate"]
        back = back + given["n"] if "n" in given else back
        low, high = given.get("low", limits[0]), given.get("high", limits[1])
        if "TR" in given:
            rate = (given["TR"] - back) * gain + rate
        elif windup == "back-calculation":
            rate = (where(back > high, high, where(back < low, low, back)) - back) * gain + rate
        elif windup == "clamping":
            rate = where(((back > high) & (rate > 0.0)) | ((back < low) & (rate < 0.0)), 0.0, rate)
        begins = given.get("x0", first)
        x = where(given["clear"], begins, where(begun, x, begins) if "x0" in given else x)
        change = rate * step
        y = x if method == "forward" else change + x
        return y, y if method == "backward" else y + change

    signals = [Signal("bool") if name == "clear" else Signal() for name in ports]
    begun = (False, lambda *v: True | v[-1])
    initial = 0.0 if "x0" in ports else first
    state = (initial, lambda *v: stepped(*v)[1])
    return Formula(lambda *v: stepped(*v)[0], signals, Signal(), {"x": state, "begun": begun})


_METHODS = {"Forward Euler": "forward", "Backward Euler": "backward", "Trapezoidal": "trapezoidal"}


def _polynomial(c: Asked, name: str, default: str) -> list[Any]:
    value = c.value(name, default)
    if 1 not in value.shape:
        raise NotTranslated(f"{name} is a matrix")
    return [float(v) for v in value.flatten()]


def _transfer(c: Asked) -> Made:
    c.only(NumeratorSource="Dialog", DenominatorSource="Dialog", InitialStatesSource="Dialog")
    top, bottom = _polynomial(c, "Numerator", "[1]"), _polynomial(c, "Denominator", "[1 2 1]")
    while len(bottom) > 1 and bottom[0] == 0.0:
        bottom = bottom[1:]
    if len(bottom) == 1 and len(top) == 1:
        return Made(Gain(top[0] / bottom[0]))
    return Made(TransferFunction(top, bottom))


def _filter(c: Asked) -> Made:
    """Direct form II as MathWorks' C computes it: x = (u - a1 x1 - ...) / a0, y = b0 x + b1 x1 + ...

    Transposed it is y = (b0 u + x1) / a0, and xk becomes (x(k+1) + bk u) - ak y. A coefficient is a number, or the
    place of an input.
    """
    edge, form = _edge(c), c.text("FilterStructure", "Direct form II")
    c.needs("InitialStatesSource", "Dialog", "Dialog")
    d, ports, sources, rational = Diagram("filter"), c.inputs[1:], ["u"], list[list[float | int]]()
    d.input("u")
    for name, default in (("Numerator", "[1]"), ("Denominator", "[1 0.5]")):
        if c.text(f"{name}Source", "Dialog") == "Dialog":
            rational.append(_polynomial(c, name, default))
            continue
        one, place = ports.pop(0), d.input(name, c.inputs[1].kind, c.inputs[1].width)
        if one.width is not None:
            place = d.add(f"{name}s", Demux(one.width, one.number), u=place)
        names = [place] if one.width is None else [f"{place}.{at}" for at in port_series(one.width)]
        rational.append(list(range(len(sources), len(sources) + len(names))))
        sources += names
    top, bottom = rational
    if c.block.type == "DiscreteTransferFcn":  # in powers of z: both begin at the highest
        top = [*([0.0] * (len(bottom) - len(top))), *top]
        if len(top) > len(bottom):
            raise NotTranslated("Numerator is longer than Denominator")
    order = max(len(top), len(bottom)) - 1
    top, bottom = ([*one, *[0.0] * (order + 1 - len(one))] for one in (top, bottom))
    if not any(one != 0.0 for one in top):
        raise NotTranslated("Numerator is 0")
    if form not in ("Direct form II", "Direct form II transposed"):
        c.notes.append(f"FilterStructure = {form!r}: computed in direct form II, with other roundings")

    def computed(*v: Any) -> tuple[Any, list[Any]]:
        """Return the output and the next states."""
        a, b = ([v[one] if isinstance(one, int) else one for one in many] for many in (bottom, top))
        x = [*v[len(sources) :]]
        if form == "Direct form II transposed":
            y = b[0] * v[0] + x[0] if order and top[0] != 0.0 else x[0] if order else b[0] * v[0]
            y = y if bottom[0] == 1.0 else y / a[0]
            after = [*x[1:], None]
            fed = [b[k + 1] * v[0] if one is None else one + b[k + 1] * v[0] for k, one in enumerate(after[:order])]
            return y, [one - a[k + 1] * y for k, one in enumerate(fed)]
        now = v[0]
        for k in range(order):
            now = now - a[k + 1] * x[k]
        now = now if bottom[0] == 1.0 else now / a[0]
        terms = [b[k] * one for k, one in enumerate([now, *x]) if top[k] != 0.0]
        return reduce(operator.add, terms), [now, *x[:-1]]

    initial = c.value("InitialStates", "0")
    states = {
        f"x{k + 1}": (float(initial.flat[min(k, initial.size - 1)]), lambda t, *v, k=k: computed(*v)[1][k])
        for k in range(order)
    }
    block = Formula(lambda t, *v: computed(*v)[0], [Signal()] * len(sources), Signal(), states)
    d.output("y", d.add("y", block, inputs={f"u{k}": one for k, one in enumerate(sources, start=1)}))
    return Made(d, [Signal()]) if not edge else _resettable(c, d, edge)


def _filters(c: Asked) -> Made:
    ported = "Input port" in (c.text("NumeratorSource"), c.text("DenominatorSource"))
    return _filter(c) if ported else each(_filter)(c)


def _fir(c: Asked) -> Made:
    """Return a filter without a denominator."""
    c.only(CoefSource="Dialog parameters", FilterStructure="Direct form")
    values = {"Numerator": c.text("Coefficients", "[0.5 0.5]"), "Denominator": "1", "FilterStructure": "Direct form II"}
    return _filters(replace(c, values={**c.values, **values}))


def _resettable(c: Asked, item: Item, edge: str) -> Made:
    """Put a block whose states are initial at the edges of the last input."""
    names = names_of(item)
    if len(c.inputs) != len(names) + 1:
        raise NotTranslated("its reset is not one signal")
    inner, d = Diagram("inside"), Diagram("resettable")
    for name, one in zip(names, c.inputs, strict=False):
        inner.input(name, one.kind, one.width)
        d.input(name, one.kind, one.width)
    inner.output("y", inner.add("block", item, inputs={name: name for name in names}))
    d.add("inside", inner, inputs={name: name for name in names}, reset=f"{_clears(d, c.inputs[-1], edge)}.y")
    d.output("y", "inside")
    return Made(d, [c.inputs[0]])


def _transport_delay(c: Asked) -> Made:
    time = c.scalar("DelayTime", "1")
    samples = round(time / c.dt)
    c.notes.append(f"{time:g} s: {samples} of the period's samples")
    if samples == 0:
        return passes(c)
    return Made(Delay(samples, None, c.scalar("InitialOutput", "0")))


def _integrator(c: Asked) -> Made:
    def integrator(initial: Any, limits: Any, reset: bool, width: int | None) -> Item:
        if not reset and initial != "input":
            return Integrator(initial, limits, width)
        return resettable_integrator("integrator", "level" if reset else "none", initial, limits, width)

    return _integral(c, integrator)


def _second_order(c: Asked) -> Made:
    """Return two integrators in a row: the position, and its rate."""
    c.only(ICSourceX="internal", ICSourceDXDT="internal", LimitX="off", LimitDXDT="off", ExternalReset="none")
    c.kind("real")
    d, signals = Diagram("second_order"), {"x": Signal("real", c.width), "rate": Signal("real", c.width)}
    d.input("u", width=c.width)
    d.add("rate", Integrator(c.scalar("ICDXDT", "0.0"), None, c.width), u="u")
    d.add("x", Integrator(c.scalar("ICX", "0.0"), None, c.width), u="rate")
    shown = c.pick("ShowOutput", "both", {"both": ["x", "rate"], "x": ["x"], "dx": ["rate"]})
    for name in shown:
        d.output(f"y_{name}", name)
    return Made(d, [signals[name] for name in shown])


def _state_space(c: Asked) -> Made:
    c.kind("real")
    a, b, cc, d = (c.value(name, "1") for name in "ABCD")
    initial = c.value("InitialCondition" if "InitialCondition" in c.values else "X0", "0").flatten().tolist()
    shape = (cc.shape[0], b.shape[1])
    if d.size == 1 and shape != (1, 1):
        d = np.full(shape, float(d.flat[0]))
    if (b.shape[1] != (c.width or 1) and not c.loose) or d.shape != shape:
        raise NotTranslated(f"B has {b.shape[1]} columns, D {d.shape}, and the input {c.width or 1} elements")
    block: Callable[..., Item] = StateSpace if c.block.type == "StateSpace" else DiscreteStateSpace
    item = block(*(one.tolist() for one in (a, b, cc, d)), initial if len(initial) > 1 else initial[0])
    return Made(item, [Signal("real", None if shape[0] == 1 else shape[0])])


_RELAY = (("OnSwitchValue", "eps"), ("OffSwitchValue", "eps"), ("OnOutputValue", "1"), ("OffOutputValue", "0"))


def _relay(c: Asked) -> Made:
    on_at, off_at, high, low = (c.scalar(*one) for one in _RELAY)
    one, said = c.inputs[0], c.text("OutDataTypeStr", "Inherit: All ports same datatype")
    kind = str(one.number if said.startswith("Inherit") else kind_of(said, c.names)).replace("float32", "real")
    if one.number == kind == "real":
        return Made(Relay(on_at, off_at, high, low))
    if one.number != "real":  # the numbers have the input's type
        on_at, off_at = (math.floor(at + 0.5) for at in (on_at, off_at))

    def on(t: Any, u: Any, x: Any) -> Any:
        u = exact(c)(u)
        return (u >= on_at) | (x & ~(u <= off_at))

    return formula(c, lambda *v: fitted(where(on(*v), high, low), kind, True, "Nearest"), kind, x=(False, on))


def _hit_crossing(c: Asked) -> Made:
    """Say that the input is at the offset, or has just crossed it: then for one step, as in MathWorks' C."""
    edge = c.needs("HitCrossingDirection", "either", "either", "rising", "falling")
    offset, _ = c.scalar("HitCrossingOffset", "0"), c.kind("real")
    at: Next = lambda t, u, hit, y, was: where(was, y & (u == offset), where(hit, ~y, u == offset))  # noqa: E731
    states = {"y": (False, at), "was": (False, lambda t, u, hit, y, was: hit & ~was)}
    d = Diagram("hit_crossing")
    d.add("hit", ControlEdge(edge), u=d.add("less", Bias(-offset), u=d.input("u")))
    d.add("y", Formula(at, [Signal(), Signal("bool")], Signal("bool"), states), u1="u", u2="hit")
    d.output("y", "y")
    return Made(d, [Signal("bool")]) if c.text("ShowOutputPort", "on") == "on" else Made(None, [])


def _clock(c: Asked) -> Made:
    d = Diagram("clock")
    d.add("time", Time())
    d.output("y", "time.y")
    return Made(d, [Signal()])


DYNAMIC_RULES: dict[str, Rule] = {
    "Clock": _clock,
    "Delay": _delay,
    "DigitalClock": _clock,
    "Discrete Derivative": _discrete_derivative,
    "DiscreteFilter": _filters,
    "DiscreteFir": _fir,
    "DiscreteIntegrator": _discrete_integrator,
    "DiscreteTransferFcn": _filters,
    "HitCross": each(_hit_crossing),
    "Integer Delay": _library_delay,
    "Integrator": _integrator,
    "Memory": _unit_delay,
    **dict.fromkeys(("PID Controller", "PID Controller (2DOF)"), each(_pid, "P", "I", "D", "N")),
    "Relay": each(_relay, *(name for name, _ in _RELAY)),
    "SecondOrderIntegrator": _second_order,
    **dict.fromkeys(("DiscreteStateSpace", "StateSpace"), _state_space),
    "Step": row(Step, ("Time", "1"), ("Before", "0"), ("After", "1")),
    "TransferFcn": each(_transfer),
    "TransportDelay": each(_transport_delay, "DelayTime", "InitialOutput"),
    "UnitDelay": _unit_delay,
}
STATEFUL = ("UnitDelay", "Memory", "Delay", "DiscreteIntegrator", "Integrator", "SecondOrderIntegrator", "TransferFcn",
            "StateSpace", "TransportDelay")  # fmt: skip
"""Types whose output may be known before their input: where a loop is broken."""
