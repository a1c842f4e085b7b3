"""Simulink's blocks with a memory or a _clock: delays, integrators, filters, controllers, _noise, sources of time.

Each has the order of operations of MathWorks' C: a Discrete Derivative keeps the scaled input, a filter is in direct
form II.
"""

import math
import zlib
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.bus import Bus
from twodof.blocks.library import (
    CompareToConstant,
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
    ZeroOrderHold,
)
from twodof.slx.data_types import value_of
from twodof.slx.translation import Asked, Made, NotTranslated, Rule, Signal, passes, plain, same


def _initial(c: Asked, *names: str) -> tuple[Any, Signal]:
    """Return initial condition and signal of a _delay, which may be wider than a scalar input."""
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
    c.needs("DelayLengthSource", "Dialog", "Dialog")
    c.needs("InitialConditionSource", "Dialog", "Dialog")
    c.needs("ExternalReset", "None", "None")
    if c.text("ShowEnablePort", "off") != "off":
        raise NotTranslated("ShowEnablePort is not translated")
    initial, signal = _initial(c, "InitialCondition")
    samples = int(c.scalar("DelayLength", "2"))
    if samples == 0:
        return Made(ZeroOrderHold(signal.kind, signal.width), [signal])
    return Made(Delay(samples, None, initial, signal.kind, signal.width), [signal])


def _discrete_integrator(c: Asked) -> Made:
    c.kind("real")
    method = c.text("IntegratorMethod", "Integration: Forward Euler").partition(": ")
    rules = {"Forward Euler": "forward", "Backward Euler": "backward", "Trapezoidal": "trapezoidal"}
    if method[0] != "Integration" or method[2] not in rules:
        raise NotTranslated(f"IntegratorMethod = {''.join(method)!r} is not translated")
    c.needs("ExternalReset", "none", "none")
    c.needs("InitialConditionSource", "internal", "internal")
    for name in ("ShowSaturationPort", "ShowStatePort"):
        c.needs(name, "off", "off")
    initial, signal = _initial(c, "InitialCondition")
    limits = None
    if c.text("LimitOutput", "off") == "on":
        limits = [c.scalar("LowerSaturationLimit", "-inf"), c.scalar("UpperSaturationLimit", "inf")]
    gain = c.scalar("gainval", "1.0")
    return Made(DiscreteIntegrator(rules[method[2]], gain, initial, limits, width=signal.width), [signal])


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
    c.kind("real")
    if c.width is not None:
        raise NotTranslated("a PID of a vector is not translated")
    kind = c.pick("Controller", "PID", {name: name for name in ("PID", "PI", "PD", "P", "I")})
    continuous = c.needs("TimeDomain", "Continuous-time", "Continuous-time", "Discrete-time") == "Continuous-time"
    ideal = c.needs("Form", "Parallel", "Parallel", "Ideal") == "Ideal"
    for name, default in (("ExternalReset", "none"), ("InitialConditionSource", "internal")):
        c.needs(name, default, default)
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
    return Made(d, [Signal()])


def _rational(c: Asked) -> tuple[list[float], list[float]]:
    for name in ("NumeratorSource", "DenominatorSource", "InitialStatesSource"):
        c.needs(name, "Dialog", "Dialog")
    if c.inputs[0].width is not None:
        raise NotTranslated("a _transfer function of a vector is not translated")
    default = "[1 0.5]" if c.block.type.startswith("Discrete") else "[1 1]"
    top, bottom = c.value("Numerator", "[1]"), c.value("Denominator", default)
    if 1 not in top.shape or 1 not in bottom.shape:
        raise NotTranslated("Numerator is a matrix")
    return [float(v) for v in top.flatten()], [float(v) for v in bottom.flatten()]


def _discrete_transfer(c: Asked) -> Made:
    """Direct form II as MathWorks' C computes it: x = (u - a1 x1 - ...) / a0, y = b0 x + b1 x1 + ..."""
    top, bottom = _rational(c)
    reset = c.needs("ExternalReset", "None", "None", "Level hold")
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
    return Made(d, [Signal()]) if reset == "None" else _resettable(c, d)


def _resettable(c: Asked, inner: Diagram) -> Made:
    """Put a diagram whose states are initial while the second input is not 0: Level hold."""
    if len(c.inputs) != 2 or c.inputs[1].width is not None:
        raise NotTranslated("its reset is not one signal")
    d = Diagram("resettable")
    d.input("u")
    d.input("reset", c.inputs[1].kind)
    source = "reset"
    if c.inputs[1].kind != "bool":
        d.add("on", CompareToConstant("!=", 0.0, c.inputs[1].kind), u="reset")
        source = "on"
    d.add("filter", inner, inputs={"u": "u"}, reset=source)
    d.output("y", "filter")
    return Made(d, [Signal()])


def _noise(c: Asked) -> Made:
    variance = c.scalar("Variance", "1")
    if variance < 0.0:
        raise NotTranslated("Variance is negative")
    c.notes.append("other random numbers of the same distribution")
    seed = int(c.scalar("Seed", "0")) % 2**32
    stream = zlib.crc32(f"{c.path}/{c.block.name}".encode())  # one of its own for each block
    return Made(Noise(math.sqrt(variance), c.scalar("Mean", "0"), seed, stream), [Signal()])


def _transport_delay(c: Asked) -> Made:
    if c.width is not None:
        raise NotTranslated("a _delay of a vector is not translated")
    time = c.scalar("DelayTime", "1")
    samples = round(time / c.dt)
    c.notes.append(f"{time:g} s: {samples} of the period's samples")
    if samples == 0:
        return passes(c)
    return Made(Delay(samples, None, c.scalar("InitialOutput", "0")), [Signal()])


def _transfer(c: Asked) -> Made:
    return Made(TransferFunction(*_rational(c)), [Signal()])


def _integrator(c: Asked) -> Made:
    c.kind("real")
    c.needs("ExternalReset", "none", "none")
    c.needs("InitialConditionSource", "internal", "internal")
    for name in ("ShowSaturationPort", "ShowStatePort", "WrapState"):
        c.needs(name, "off", "off")
    initial, signal = _initial(c, "InitialCondition")
    limits = None
    if c.text("LimitOutput", "off") == "on":
        limits = [c.scalar("LowerSaturationLimit", "-inf"), c.scalar("UpperSaturationLimit", "inf")]
    return Made(Integrator(initial, limits, signal.width), [signal])


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
    "DiscreteFilter": _discrete_transfer,
    "DiscreteIntegrator": _discrete_integrator,
    "DiscreteTransferFcn": _discrete_transfer,
    "Integrator": _integrator,
    "Memory": _unit_delay,
    "PID Controller": _pid,
    "RandomNumber": _noise,
    "Relay": _relay,
    "StateSpace": _state_space,
    "Step": _step,
    "TransferFcn": _transfer,
    "TransportDelay": _transport_delay,
    "UnitDelay": _unit_delay,
}
STATEFUL = ("UnitDelay", "Memory", "Delay", "DiscreteIntegrator", "Integrator", "TransferFcn", "StateSpace",
            "TransportDelay")  # fmt: skip
"""Types whose output may be known before their input: where a loop is broken."""
