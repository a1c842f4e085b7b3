"""Blocks as a function in MATLAB's language: tables from signals, and of toolboxes filters, a fit, an estimator.

A function has the order of operations of MathWorks' C. What a block's dialog offers beyond it is refused by its name.
Source: reference pages of Simulink, Control System Toolbox and DSP System Toolbox.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.errors import DiagramError
from twodof.slx.composite_blocks import Formula
from twodof.slx.matlab.function_block import MatlabFunction
from twodof.slx.translation import Asked, Made, NotTranslated, Rule, Signal, passes

TOOLBOXES = ("aerolibutil", "ctrlSharedLib", "dspbuff3", "dspmtrx3", "dsppolyfun", "dspsrcs4", "dspstat3",
             "mcbcontrolslib", "sharedutil")  # fmt: skip
"""Libraries of these blocks: of another block in them a file is looked for."""


def _function(c: Asked, code: str, constants: Mapping[str, Any] | None = None) -> Made:
    """Return the block of a function, whose first arguments are the inputs and the others `constants`."""
    try:
        item = MatlabFunction(code, c.inputs, constants)
    except DiagramError as reason:
        raise NotTranslated(reason.what) from None
    return Made(item)


def _median(c: Asked) -> Made:
    """Return the median of the last samples, which are 0 before the start."""
    c.needs("SpecifyWindowLength", "on", "on")
    return _samples(c, int(c.scalar("WindowLength", "5")), True, "median(w)", "")


def _average(c: Asked) -> Made:
    """Return the mean of the last samples, which are 0 before the start, by sums forwards and backwards."""
    c.only(Method="Sliding window", SpecifyWindowLength="on")
    if c.inputs[0].width is not None:
        raise NotTranslated("a mean of a vector is not translated")
    code = """function y = f(u, n)
    persistent total back k
    if isempty(total), total = 0; back = zeros(n - 1, 1); k = 1; end
    total = total + u;
    y = (back(k) + total) / n;
    back(k) = u;
    if k < n - 1
      k = k + 1;
    else
      k = 1; total = 0;
      for i = n - 2:-1:1, back(i) = back(i) + back(i + 1); end
    end"""
    return _function(c, code, {"n": c.value("WindowLength", "4")})


def _line(c: Asked) -> Made:
    """Return the last samples, the oldest first; with the present one where it feeds through."""
    c.only(enable_output="off", hold_output="off")
    return _samples(c, int(c.scalar("siz", "64")), c.text("directfeed", "on") == "on", "w", "ic")


def _taps(c: Asked) -> Made:
    if c.inputs[0].width is not None:
        raise NotTranslated("a delay of a vector is not translated")
    present, newest = c.text("includeCurrent", "off") == "on", c.text("DelayOrder", "Oldest") == "Newest"
    return _samples(c, int(c.scalar("NumDelays", "4")) + present, present, "w(end:-1:1)" if newest else "w", "vinit")


def _samples(c: Asked, count: int, present: bool, order: str, initial: str) -> Made:
    keep, start = "w = [w(2:end); u];", c.value(initial, "0") if initial else np.zeros((1, 1))
    code = f"""function y = f(u, n, x0)
    persistent w
    if isempty(w), w = x0 .* ones(n, 1); end
    {f"{keep} y = {order};" if present else f"y = {order}; {keep}"}"""
    return _function(c, code, {"n": np.array([[float(count)]]), "x0": start.reshape(-1, 1)})


def _flip_flop(c: Asked) -> Made:
    """Return Q and not Q of a set and a reset, whose table gives 0 for both where both are true."""
    if any(one.kind != "bool" or one.width is not None for one in c.inputs):
        raise NotTranslated("its inputs are not single booleans")
    code = """function [q, notq] = f(s, r, x0)
    persistent x
    if isempty(x), x = x0; end
    q = ~r & (s | x); notq = ~s & (r | ~x); x = q;"""
    return _function(c, code, {"x0": c.value("initial_condition", "0") != 0})


def _polynomial(c: Asked) -> Made:
    """Return the coefficients of the polynomial that fits the input at fixed places, the highest power first."""
    places = c.value("X", "[1 2 3 4 5]'").flatten().astype(float)
    fit = np.linalg.pinv(np.vander(places, int(c.scalar("N", "4")) + 1))
    c.notes.append("the fit is one product with a matrix: some units in the last place from a solver's")
    return _function(c, "function p = f(u, k)\np = k * u;", {"k": fit})


def _kalman(c: Asked) -> Made:
    """Return the estimate of a discrete Kalman filter whose noise acts on each state.

    Its gains are those of the steady state, but where an input says a covariance or the first estimate.
    """
    for name, wanted in (("TimeDomain", "Discrete-Time"), ("ModelSource", "Individual A, B, C, D matrices")):
        c.needs(name, "", wanted)
    c.only(UseK="off", UseGH="off", OutputEstimatedY="off", OutputP="off", ExternalReset="None", TimeInvariantN="on")
    if c.value("N", "0").any():
        raise NotTranslated("noises that depend on one another are not translated")
    ports = ["y", *(["x0", "P0"] if c.text("InitialEstimateSource", "Dialog") == "Input port" else [])]
    ports += [name for name in "QR" if c.text(f"TimeInvariant{name}", "on") == "off"]
    if ports == ["y"]:
        return _steady_kalman(c)
    c.only(AddInputPort="off", AddEnablePort="off")
    if c.inputs[0].width is not None:
        raise NotTranslated("several measurements with a covariance that varies are not translated")
    constants = {
        name: c.value(name.capitalize(), "1") for name in ("A", "C", "x0", "P0", "Q", "R") if name not in ports
    }
    now = "M * e + x" if c.text("UseCurrentEstimator", "on") == "on" else "x"
    code = f"""function xhat = f({", ".join([*ports, *constants])})
    persistent P x
    if isempty(P)
      x = x0 .* ones(size(A, 1), 1); P = covariance(P0, size(A, 1));
    end
    V = R;
    if V <= 0, V = 2^-23; end
    s = C * P * C' + V;
    L = A * P * C' / s; M = P * C' / s;
    e = y - C * x;
    xhat = {now};
    x = A * x + L * e;
    K = eye(size(A, 1)) - M * C;
    P = A * (K * P * K' + M * V * M') * A' + covariance(Q, size(A, 1));
    end
    function S = covariance(s, n)
    if size(s, 1) == size(s, 2) && size(s, 1) == n
      S = s;
    else
      S = diag(max(s, 0) .* ones(n, 1));
    end
    end"""
    return _function(c, code, constants)


def _steady_kalman(c: Asked) -> Made:
    """Return a Kalman filter with the gains of its steady state; without an enable no measurement counts."""
    from scipy.linalg import solve_discrete_are  # imported late: the server starts without it

    a, measured = c.value("A", "1"), c.value("C", "1")

    def covariance(name: str, size: int) -> Any:
        given = c.value(name, "1").astype(float)
        return given if given.shape == (size, size) else np.diag(given.flatten() * np.ones(size))

    noise = covariance("R", len(measured))
    try:
        p = solve_discrete_are(a.T, measured.T, covariance("Q", len(a)), noise)
        gain = np.linalg.solve(measured @ p @ measured.T + noise, measured @ p).T
    except (ValueError, np.linalg.LinAlgError) as reason:
        raise NotTranslated(f"it has no steady state: {reason}") from None
    c.notes.append("its gains are those of our solver: some units in the last place from MATLAB's")
    inputs = ["u"] * (c.text("AddInputPort", "on") == "on") + ["y"] + ["on"] * (c.text("AddEnablePort", "off") == "on")
    names = {"A": a, "B": c.value("B", "1"), "C": measured, "D": c.value("D", "0"), "M": gain, "L": a @ gain}
    names |= {"x0": c.value("X0", "0").reshape(-1, 1) * np.ones((len(a), 1))}
    known = "u" in inputs
    now = "x + m" if c.text("UseCurrentEstimator", "on") == "on" else "x"
    code = f"""function xhat = f({", ".join([*inputs, *names])})
    persistent x
    if isempty(x), x = x0; end
    e = y - ({"D * u + " if known else ""}C * x);
    m = M * e; l = L * e;
    {"if ~on, m = zeros(size(x)); l = m; end" if "on" in inputs else ""}
    xhat = {now};
    x = {"B * u + " if known else ""}A * x + l;"""
    return _function(c, code, names)


_PLACE = """k = 1;
    for i = 2:numel(p) - 1
      if u >= p(i), k = i; end
    end
    r = (u - p(k)) / (p(k + 1) - p(k));"""
"""The place of u among breakpoints: that of the one below, and the share of the way to the next one."""
_WITHIN = "r = min(max(r, 0), 1);"


def _prelookup(c: Asked) -> Made:
    """Return the place of the input among breakpoints, from 0, and its share of the interval."""
    c.only(OutputSelection="Index and fraction", BreakpointsDataSource="Dialog")
    c.only(BreakpointsSpecification="Explicit values")
    kind = c.pick("IndexDataTypeStr", "uint32", {"uint32": "uint32", "int32": "int32"})
    within = c.pick("ExtrapMethod", "Clip", {"Clip": _WITHIN, "Linear": ""})
    code = f"function [n, r] = f(u, p)\n{_PLACE}\n{within}\nn = {kind}(k - 1);"
    return _function(c, code, {"p": c.value("BreakpointsData", "[10:10:110]").astype(float)})


def _interpolation(c: Asked) -> Made:
    """Return the value of a table at the places and shares that Prelookup blocks give."""
    count = int(c.scalar("NumberOfTableDimensions", "2"))
    if len(c.inputs) != 2 * count or count > 2 or c.scalar("NumSelectionDims", "0"):
        raise NotTranslated(f"a table of {count} dimensions with {len(c.inputs)} inputs is not translated")
    c.needs("TableSource", "Dialog", "Dialog")
    c.needs("InterpMethod", "Linear", "Linear", "Linear point-slope")
    within = c.pick("ExtrapMethod", "Clip", {"Clip": _WITHIN, "None - Clip": _WITHIN, "Linear": ""})
    names = ["n", "r", "m", "q"][: 2 * count]
    last = "" if count == 1 else ", double(m) + j"
    code = f"""function y = f({", ".join(names)}, T)
    {within} {within.replace("r", "q") if count > 1 else ""}
    y = zeros({count}, 1);
    for j = 1:{count}
      a = T(double(n) + 1{last}); y(j) = (T(double(n) + 2{last}) - a) * r + a;
    end
    y = {"y(1)" if count == 1 else "(y(2) - y(1)) * q + y(1)"};"""
    return _function(c, code, {"T": c.value("Table", "sqrt([1:11]' * [1:11])").astype(float)})


def _dynamic_lookup(c: Asked) -> Made:
    """Return the value of a table whose breakpoints and values are signals."""
    if c.inputs[0].width is not None:
        raise NotTranslated("a table of a vector is not translated")
    said = c.text("OutDataTypeStr", "double")
    if said not in ("double", "fixdt('double')") and not said.startswith("Inherit"):
        raise NotTranslated(f"OutDataTypeStr = {said!r} is not translated")
    between = "y = (t(k + 1) - t(k)) * r + t(k);"
    methods = {"Interpolation-Extrapolation": between, "Interpolation-Use End Values": f"{_WITHIN} {between}",
               "Use Input Nearest": "y = t(k + (r >= 0.5));", "Use Input Below": "y = t(k + (r >= 1));",
               "Use Input Above": "y = t(k + (r > 0));"}  # fmt: skip
    return _function(
        c, f"function y = f(u, p, t)\n{_PLACE}\n{c.pick('LookUpMeth', 'Interpolation-Use End Values', methods)}"
    )


def _transformed(*each: Callable[..., Any], **only: str) -> Rule:
    """Return the rule of a change of coordinates: a function of the inputs for each output, for the choices `only`."""

    def rule(c: Asked) -> Made:
        c.kind("real")
        c.only(PhaseInput="Two inputs", **only)
        d = Diagram("transform")
        sources = {d.input(f"u{k}", width=one.width): f"u{k}" for k, one in enumerate(c.inputs, start=1)}
        for k, of in enumerate(each, start=1):
            item = Formula(lambda t, *u, of=of: of(*u), c.inputs, Signal())
            d.output(f"y{k}", f"{d.add(f'of{k}', item, inputs=sources)}.y")
        return Made(d, [Signal()] * len(each))

    return rule


_SINES = {"ThetaInput": "Sine and Cosine electrical position", "AxisAlignment": "D-axis"}
_ROOT = math.sqrt(3.0)


def _combined(c: Asked) -> Made:
    """Return the row of a truth table that the inputs' truth, the first as the highest bit, is the number of."""
    table = c.value("TruthTable", "[0 0;0 1;0 1;1 0;0 1;1 0;1 0;1 1]").astype(float)
    width = c.inputs[0].width or 1
    if table.shape[0] != 2**width:
        raise NotTranslated(f"TruthTable has {table.shape[0]} rows and the input {width} elements")
    return _function(c, "function y = f(u, B, T)\ny = T(1 + B * (u(:) ~= 0), :)';",
                     {"B": 2.0 ** np.arange(width - 1, -1, -1)[None, :], "T": table != 0})  # fmt: skip


TOOLBOX_RULES: dict[str, Rule] = {
    "Clarke Transform": _transformed(lambda a, b: a, lambda a, b: ((a + b) + b) * (1.0 / _ROOT), EnPowerInv="off"),
    "CombinatorialLogic": _combined,
    "Delay Line": _line,
    "FrameConversion": passes,
    "Interpolation_n-D": _interpolation,
    "Inverse Clarke Transform": _transformed(
        lambda a, b: a,
        lambda a, b: b * (_ROOT / 2.0) - 0.5 * a,
        lambda a, b: (0.0 - 0.5 * a) - b * (_ROOT / 2.0),
        EnPowerInv="off",
    ),
    "Inverse Park Transform": _transformed(
        lambda d, q, sin, cos: d * cos - q * sin, lambda d, q, sin, cos: q * cos + d * sin, **_SINES
    ),
    "Kalman Filter": _kalman,
    "Least Squares Polynomial Fit": _polynomial,
    "Lookup Table Dynamic": _dynamic_lookup,
    "Median Filter": _median,
    "Moving Average": _average,
    "Park Transform": _transformed(
        lambda a, b, sin, cos: a * cos + b * sin, lambda a, b, sin, cos: b * cos - a * sin, **_SINES
    ),
    "PreLookup": _prelookup,
    "S-R Flip-Flop": _flip_flop,
    "Cartesian to Polar": partial(_function, code="function [r, a] = f(x, y)\nr = hypot(x, y); a = atan2(y, x);"),
    "Polar to Cartesian": partial(_function, code="function [x, y] = f(r, a)\nx = r .* cos(a); y = r .* sin(a);"),
    "Tapped Delay": _taps,
}
"""Rule of each of these, by the library block's name."""
