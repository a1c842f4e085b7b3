"""Simulink's blocks with a memory or a clock: delays, integrators, filters, controllers, noise, sources of time.

Each has the order of operations of MathWorks' C: a Discrete Derivative keeps the scaled input, a filter is in direct
form II.
"""

import math
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.action_group import resettable_integrator
from twodof.blocks.bus import Bus
from twodof.blocks.elementary.functions import floor, trunc
from twodof.blocks.expressions.expr import to_int32, where
from twodof.blocks.expressions.numbers import WORDS
from twodof.blocks.library import (
    Constant,
    Delay,
    DiscreteIntegrator,
    Gain,
    Integrator,
    Noise,
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
from twodof.slx.composite_blocks import Formula
from twodof.slx.conditions import ControlEdge
from twodof.slx.data_types import value_of
from twodof.slx.translation import Asked, Item, Made, NotTranslated, Rule, Signal, each, expanded, passes, plain, same


def _initial(c: Asked, *names: str) -> tuple[Any, Signal]:
    """Return initial condition and signal of a delay, which may be wider than a scalar input."""
    name = next((one for one in names if one in c.values), names[0])
    known = c.inputs[0]
    if isinstance(known.kind, Bus):
        return value_of(c.structure(name, "0"), known), known
    value = c.value(name, "0")
    width = known.width or (value.size if value.size > 1 else None)
    initial = plain(value.flat[0], known.kind) if value.size == 1 else [plain(v, known.kind) for v in value.flatten()]
    if value.size not in (1, width or 1):
        raise NotTranslated(f"parameter {name} has {value.size} elements and the input {width or 1}")
    return initial, Signal(known.kind, width)


def _unit_delay(c: Asked) -> Made:
    initial, signal = _initial(c, "InitialCondition", "X0")
    return Made(UnitDelay(initial, signal.kind, signal.width), [signal])


def _delay(c: Asked) -> Made:
    ported = c.needs("DelayLengthSource", "Dialog", "Dialog", "Input port") == "Input port"
    c.needs("InitialConditionSource", "Dialog", "Dialog")
    edge = _edge(c)
    if c.text("ShowEnablePort", "off") != "off":
        raise NotTranslated("ShowEnablePort is not translated")
    initial, signal = _initial(c, "InitialCondition")
    if ported:
        most, length, d = int(c.scalar("DelayLengthUpperLimit", "100")), c.inputs[1], Diagram("delay")
        real = length.kind == "real"
        count = Formula(
            lambda t, n: to_int32(where(n > (float(most) if real else most), most, trunc(n) if real else n)),
            [length],
            Signal("int32"),
        )
        d.input("u", signal.kind, signal.width)
        d.add("length", count, u1=d.input("samples", length.kind))
        delay = VariableDelay(most, initial, True, signal.kind, signal.width)
        d.output("y", d.add("y", delay, u="u", samples="length"))
        return Made(d, [signal], expand=False)
    samples = int(c.scalar("DelayLength", "2"))
    if samples == 0:
        return Made(ZeroOrderHold(signal.kind, signal.width), [signal])
    if edge:
        return _resettable(c, Delay(samples, None, initial, signal.kind, signal.width), edge)
    return Made(Delay(samples, None, initial, signal.kind, signal.width), [signal])


def _discrete_integrator(c: Asked) -> Made:
    method = c.text("IntegratorMethod", "Integration: Forward Euler").partition(": ")
    rules = {"Forward Euler": "forward", "Backward Euler": "backward", "Trapezoidal": "trapezoidal"}
    if method[0] not in ("Integration", "Accumulation") or method[2] not in rules:
        raise NotTranslated(f"IntegratorMethod = {''.join(method)!r} is not translated")
    if method[2] != "Forward Euler" and c.text("InitialConditionSetting", "Auto") == "Output":
        raise NotTranslated("InitialConditionSetting = 'Output' is not translated")
    gain, scale = c.scalar("gainval", "1.0"), 1.0
    if c.inputs[0].kind in WORDS:
        return _whole_accumulator(c, gain)
    if method[0] == "Accumulation":  # the input is scaled, and the gain undoes the period
        near = 1.0 / c.dt
        undoing = [one for one in (near, *np.nextafter(near, [0.0, np.inf]).tolist()) if one * c.dt == 1.0]
        if not undoing:
            raise NotTranslated(f"an accumulation every {c.dt} s is not translated")
        gain, scale = undoing[0], gain

    def integrator(initial: Any, limits: Any, reset: bool, width: int | None) -> Item:
        return DiscreteIntegrator(rules[method[2]], gain, initial, limits, reset, width)

    return _integral(c, integrator, scale)


def _whole_accumulator(c: Asked, gain: float) -> Made:
    """Return the sum of whole numbers so far, which wraps around."""
    c.needs("IntegratorMethod", "Integration: Forward Euler", "Accumulation: Forward Euler")
    for name, only in (("ExternalReset", "none"), ("InitialConditionSource", "internal"), ("LimitOutput", "off")):
        c.needs(name, only, only)
    if gain != 1.0:
        raise NotTranslated(f"gainval = {gain:g} of whole numbers is not translated")
    initial, signal = _initial(c, "InitialCondition")
    d = Diagram("accumulator")
    d.input("u", signal.kind, signal.width)
    d.add("sum", Sum("++", signal.number, signal.width), a="x", b="u")
    d.add("x", UnitDelay(initial, signal.kind, signal.width), u="sum")
    d.output("y", "x")
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
    return Made(d, [signal] * (1 + shown), expand=False)


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
    d = Diagram("derivative")
    d.input("u", width=c.width)
    d.add("scaled", Gain(c.scalar("gainval", "1.0") / c.dt, c.width), u="u")
    d.add("UD", UnitDelay(c.scalar("ICPrevScaledInput", "0.0"), "real", c.width), u="scaled")
    d.add("difference", Sum("+-", "real", c.width), a="scaled", b="UD")
    d.output("y", "difference")
    return same(c, d)


def _pid(c: Asked) -> Made:
    """Compute y = (P u + integral) + N (D u - filter state), or P times that in ideal form; in MathWorks' order."""
    if c.inputs[0].kind != "real":
        raise NotTranslated(f"an input that is {c.inputs[0]} is not translated")
    kind = c.pick("Controller", "PID", {name: name for name in ("PID", "PI", "PD", "P", "I")})
    continuous = c.needs("TimeDomain", "Continuous-time", "Continuous-time", "Discrete-time") == "Continuous-time"
    ideal = c.needs("Form", "Parallel", "Parallel", "Ideal") == "Ideal"
    edge = _edge(c)
    c.needs("InitialConditionSource", "internal", "internal")
    c.needs("TrackingMode", "off", "off")
    c.needs("ControllerParametersSource", "internal", "internal")
    if c.text("LimitOutput", "off") == "on":
        c.needs("AntiWindupMode", "none", "none", "back-calculation")
    windup = c.text("LimitOutput", "off") == "on" and c.text("AntiWindupMode", "none") == "back-calculation"
    d = Diagram("pid")
    d.input("u")
    error, terms = "u", list[str]()
    if ideal:
        if kind == "I":
            raise NotTranslated("an integral controller in ideal form is not translated")
        terms.append("u")
    elif "P" in kind:
        d.add("P", Gain(c.scalar("P", "1")), u="u")
        terms.append("P")
    if "I" in kind:
        start = c.scalar("InitialConditionForIntegrator", "0")
        method = c.text("IntegratorMethod", "Forward Euler")
        rules = {"Forward Euler": "forward", "Backward Euler": "backward", "Trapezoidal": "trapezoidal"}
        if method not in rules:
            raise NotTranslated(f"IntegratorMethod = {method!r} is not translated")
        d.add("I", Gain(c.scalar("I", "1")), u=error)
        d.add("integral", Integrator(start) if continuous else DiscreteIntegrator(rules[method], 1.0, start))
        terms.append("integral")
    if "D" in kind:
        c.needs("UseFilter", "on", "on")
        if not continuous:
            c.needs("FilterMethod", "Forward Euler", "Forward Euler")
        start = c.scalar("InitialConditionForFilter", "0")
        d.add("D", Gain(c.scalar("D", "0")), u="u")
        d.add("filter", Integrator(start) if continuous else DiscreteIntegrator("forward", 1.0, start))
        d.add("slope", Sum("+-"), a="D", b="filter")
        d.add("N", Gain(c.scalar("N", "100")), u="slope")
        d.connect("N", "filter.u")
        terms.append("N")
    y = terms[0]
    if len(terms) > 1:
        d.add("sum", Sum("+" * len(terms)), inputs=dict(zip("abc", terms, strict=False)))
        y = "sum"
    if ideal:
        d.add("P", Gain(c.scalar("P", "1")), u=y)
        y = "P"
    if c.text("LimitOutput", "off") == "on":
        low, high = c.scalar("LowerSaturationLimit", "-inf"), c.scalar("UpperSaturationLimit", "inf")
        d.add("limited", Saturation(low, high), u=y)
        if windup and "I" in kind:
            d.add("excess", Sum("+-"), a="limited", b=y)
            d.add("Kb", Gain(c.scalar("Kb", "1")), u="excess")
            d.add("driven", Sum("++"), a="Kb", b="I")
            d.connect("driven", "integral.u")
        y = "limited"
    if "I" in kind and not windup:
        d.connect("I", "integral.u")
    d.output("y", y)
    return Made(d, [Signal()]) if not edge else _resettable(c, d, edge)


def _rational(c: Asked) -> tuple[list[float], list[float]]:
    for name in ("NumeratorSource", "DenominatorSource", "InitialStatesSource"):
        c.needs(name, "Dialog", "Dialog")
    default = "[1 0.5]" if c.block.type.startswith("Discrete") else "[1 2 1]"
    top, bottom = c.value("Numerator", "[1]"), c.value("Denominator", default)
    if 1 not in top.shape or 1 not in bottom.shape:
        raise NotTranslated("Numerator is a matrix")
    return [float(v) for v in top.flatten()], [float(v) for v in bottom.flatten()]


def _discrete_transfer(c: Asked) -> Made:
    """Direct form II as MathWorks' C computes it: x = (u - a1 x1 - ...) / a0, y = b0 x + b1 x1 + ..."""
    top, bottom = _rational(c)
    edge = _edge(c)
    if c.block.type == "DiscreteTransferFcn":  # in powers of z: both begin at the highest
        top = [0.0] * (len(bottom) - len(top)) + top
    order = max(len(top), len(bottom)) - 1
    initial = c.value("InitialStates", "0")
    if len(top) > len(bottom) and c.block.type == "DiscreteTransferFcn":
        raise NotTranslated("Numerator is longer than Denominator")
    top, bottom = top + [0.0] * (order + 1 - len(top)), bottom + [0.0] * (order + 1 - len(bottom))
    if order == 0:
        return same(c, Gain(top[0] / bottom[0]))
    states = [float(initial.flat[min(k, initial.size - 1)]) for k in range(order)]
    d = Diagram("filter")
    d.input("u")
    previous = "u"
    for k in range(1, order + 1):
        d.add(f"a{k}", Gain(bottom[k]), u=f"x{k}")
        d.add(f"less{k}", Sum("+-"), a=previous, b=f"a{k}")
        previous = f"less{k}"
    if bottom[0] != 1.0:
        d.add("a0", Constant(bottom[0]))
        d.add("x0", Product("*/"), a=previous, b="a0")
        previous = "x0"
    for k in range(1, order + 1):
        d.add(f"x{k}", UnitDelay(states[k - 1]), u=previous if k == 1 else f"x{k - 1}")
    total = ""
    for k in range(order + 1):
        if top[k] == 0.0 and (k or total):
            continue
        if top[k] == 0.0:
            continue
        d.add(f"b{k}", Gain(top[k]), u=previous if k == 0 else f"x{k}")
        if total:
            d.add(f"sum{k}", Sum("++"), a=total, b=f"b{k}")
        total = f"sum{k}" if total else f"b{k}"
    if not total:
        raise NotTranslated("Numerator is 0")
    d.output("y", total)
    return Made(d, [Signal()]) if not edge else _resettable(c, d, edge)


def _resettable(c: Asked, item: Item, edge: str) -> Made:
    """Put a block whose states are initial at the edges of the second input."""
    if len(c.inputs) != 2:
        raise NotTranslated("its reset is not one signal")
    one = c.inputs[0]
    inner, d = Diagram("inside"), Diagram("resettable")
    inner.input("u", one.kind, one.width)
    inner.output("y", inner.add("block", item, inputs={"u": "u"}))
    d.input("u", one.kind, one.width)
    d.add("inside", inner, inputs={"u": "u"}, reset=f"{_clears(d, c.inputs[1], edge)}.y")
    d.output("y", "inside")
    return Made(d, [one], expand=False)


def _noise(c: Asked) -> Made:
    variance = c.scalar("Variance", "1")
    if variance < 0.0:
        raise NotTranslated("Variance is negative")
    c.notes.append("other random numbers of the same distribution")
    seed = int(c.scalar("Seed", "0")) % 2**32
    stream = zlib.crc32(f"{c.path}/{c.block.name}".encode())  # one of its own for each block
    return Made(Noise(math.sqrt(variance), c.scalar("Mean", "0"), seed, stream), [Signal()])


def _transport_delay(c: Asked) -> Made:
    time = c.scalar("DelayTime", "1")
    samples = round(time / c.dt)
    c.notes.append(f"{time:g} s: {samples} of the period's samples")
    if samples == 0:
        return passes(c)
    return Made(Delay(samples, None, c.scalar("InitialOutput", "0")), [Signal()])


def _transfer(c: Asked) -> Made:
    return Made(TransferFunction(*_rational(c)), [Signal()])


def _integrator(c: Asked) -> Made:
    def integrator(initial: Any, limits: Any, reset: bool, width: int | None) -> Item:
        if not reset and initial != "input":
            return Integrator(initial, limits, width)
        return resettable_integrator("integrator", "level" if reset else "none", initial, limits, width)

    return _integral(c, integrator)


def _second_order(c: Asked) -> Made:
    """Return two integrators in a row: the position, and its rate."""
    for name, default in (
        ("ICSourceX", "internal"),
        ("ICSourceDXDT", "internal"),
        ("LimitX", "off"),
        ("LimitDXDT", "off"),
    ):
        c.needs(name, default, default)
    c.needs("ExternalReset", "none", "none")
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
    shape = (a.shape[0], b.shape[1], cc.shape[0])
    if b.shape[1] != (c.width or 1):
        raise NotTranslated(f"B has {b.shape[1]} columns and the input {c.width or 1} elements")
    if d.size == 1 and shape[1:] != (1, 1):
        d = np.full(shape[:0:-1], float(d.flat[0]))
    block = StateSpace(a.tolist(), b.tolist(), cc.tolist(), d.tolist(), initial if len(initial) > 1 else initial[0])
    return Made(block, [Signal("real", None if shape[2] == 1 else shape[2])])


def _step(c: Asked) -> Made:
    return Made(Step(c.scalar("Time", "1"), c.scalar("Before", "0"), c.scalar("After", "1")), [Signal()])


def _clock(c: Asked) -> Made:
    d = Diagram("clock")
    d.add("time", Time())
    d.output("y", "time.y")
    return Made(d, [Signal()])


def _relay(c: Asked) -> Made:
    on, off = c.scalar("OnSwitchValue", "eps"), c.scalar("OffSwitchValue", "eps")
    return same(c, Relay(on, off, c.scalar("OnOutputValue", "1"), c.scalar("OffOutputValue", "0")))


DYNAMIC_RULES: dict[str, Rule] = {
    "Clock": _clock,
    "Delay": _delay,
    "DigitalClock": _clock,
    "Discrete Derivative": _discrete_derivative,
    "DiscreteFilter": each(_discrete_transfer),
    "DiscreteIntegrator": _discrete_integrator,
    "DiscreteTransferFcn": each(_discrete_transfer),
    "Integrator": _integrator,
    "Memory": _unit_delay,
    "PID Controller": each(_pid, "P", "I", "D", "N"),
    "RandomNumber": each(_noise, "Mean", "Variance", "Seed"),
    "Relay": each(_relay, "OnSwitchValue", "OffSwitchValue", "OnOutputValue", "OffOutputValue"),
    "SecondOrderIntegrator": _second_order,
    "StateSpace": _state_space,
    "Step": each(_step, "Time", "Before", "After"),
    "TransferFcn": each(_transfer),
    "TransportDelay": each(_transport_delay, "DelayTime", "InitialOutput"),
    "UnitDelay": _unit_delay,
}
STATEFUL = ("UnitDelay", "Memory", "Delay", "DiscreteIntegrator", "Integrator", "SecondOrderIntegrator", "TransferFcn",
            "StateSpace", "TransportDelay")  # fmt: skip
"""Types whose output may be known before their input: where a loop is broken."""
