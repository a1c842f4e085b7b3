"""Your own loop: L of a plant and a controller, its step response, and transfer functions as written.

They are written as 2 exp(-0.3 s) / (1.5 s + 1), or 0.1 z / (z - 0.9) of a sampled system.
"""

import ast
import math
import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.design.loop_transfer import LoopTransfer, minimal
from twodof.design.margins import LoopMargins
from twodof.errors import ParameterError, shown
from twodof.models.lti import DelayedStateSpace

Array = NDArray[np.float64]

_SAME_TIME = 1e-3
"""Share by which sample times may differ: clocks of one machine do."""
_FIRST, _SHORTEST, _STEPS = 60.0, 6.0, 6000
"""Of a step response: times in 1 / crossover, and the samples of the first."""
_LONGEST, _SETTLED = 100.0, 0.002
"""So many times the first time a step response goes on, until its last part is this near to its final value."""
DELAY_STEPS = 200
"""Steps of a continuous delay that is sampled, at the most."""
_MOST_TEXT, _MOST_POWER, _MOST_ORDER = 400, 20, 40
_ROUNDED = 1e-9
"""A T at rest below this share of its peak is 0 but for rounding."""
_PRODUCT = re.compile(r"(?<=[\d.)sz])\s*(?=[sz(]|exp)(?<!exp)|(?<=[sz)])\s*(?=\d)|(?<=\d)\s+(?=\d)")


@dataclass(frozen=True, eq=False)
class Rational:
    """`top` / `bottom` exp(-delay s): polynomials in `letter` ("s", "z" or none), the highest power first."""

    top: Array
    bottom: Array
    delay: float = 0.0
    letter: str = ""

    def transfer(self, where: str = "the transfer function", period: float | None = None) -> LoopTransfer:
        """Return it as matrices, sampled with `period` [s] if it is one of z.

        Raises ParameterError for more zeros than poles, and for z without a period.
        """
        if self.letter == "z" and period is None:
            raise ParameterError("a transfer function of z has no sample time", where, "give the period (--period)")
        if self.top.size > self.bottom.size:
            remedy = "give it a pole more, such as a lag of the derivative: s / (0.01 s + 1)"
            raise ParameterError("there are more zeros than poles", where, remedy)
        top, bottom = self.top / self.bottom[0], self.bottom / self.bottom[0]
        n = bottom.size - 1
        top = np.concatenate([np.zeros(n + 1 - top.size), top])
        a, b = np.eye(n, k=-1), np.eye(n, 1)
        a[:1] = -bottom[1:]
        row = (top[1:] - top[0] * bottom[1:])[None]
        return LoopTransfer(a, b, row, float(top[0]), period if self.letter == "z" else None, self.delay)


def read_rational(text: str) -> Rational:
    """Return the transfer function that `text` writes with + - * / ^, brackets, s or z, and exp(-T s) as a factor.

    A product needs no sign: 2 (s + 1). Raises ParameterError for anything else, and for orders over 40.
    """
    remedy = 'write one as "2 exp(-0.3 s) / (1.5 s + 1)"'
    refusal = ParameterError(f"{shown(text)} is not a transfer function", "", remedy)
    if not 0 < len(text) <= _MOST_TEXT or "@" in text:
        raise refusal
    # A product without a sign is Python's @, which binds as * does, so that the tree tells them apart.
    source = _PRODUCT.sub("@", text.strip()).replace("^", "**")
    try:
        tree = ast.parse(source, mode="eval").body
        if any(_has_two_readings(node, source) for node in ast.walk(tree)):
            what = f"{shown(text)} can be read in two ways"
            raise ParameterError(what, "", "put what is below the fraction in brackets, 1 / (s (s + 1)), or write a *")
        found = _value(tree)
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError) as error:
        raise refusal from error
    top, bottom = (np.trim_zeros(one, "f") for one in (found.top, found.bottom))
    if not bottom.size or not np.isfinite([*top, *bottom, found.delay]).all() or found.delay < 0.0:
        raise refusal
    if found.delay and found.letter == "z":
        raise ParameterError("a delay of exp(-T s) beside z", shown(text), "write it as a power of z: / z^3")
    return Rational(top if top.size else np.zeros(1), bottom, found.delay, found.letter)


def _has_two_readings(node: ast.AST, source: str) -> bool:
    """Return True for a fraction with a factor behind it and no sign between: 1/s(s + 1) is (s + 1)/s for some."""
    match node:
        case ast.BinOp(left=ast.BinOp(op=ast.Div()) as left, op=ast.MatMult(), right=right):
            bracketed = source[left.end_col_offset :].lstrip().startswith(")")
            return not bracketed and not isinstance(right, ast.Call)  # a delay belongs to the whole
    return False


def _value(node: ast.expr) -> Rational:
    """Return the value of an expression. Raises ValueError for anything else."""
    one = np.ones(1)
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return Rational(np.array([float(number)]), one)
        case ast.Name(id="s" | "z" as letter):
            return Rational(np.array([1.0, 0.0]), one, letter=letter)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            found = _value(inner)
            return Rational(-found.top, found.bottom, found.delay, found.letter)
        case ast.UnaryOp(op=ast.UAdd(), operand=inner):
            return _value(inner)
        case ast.Call(func=ast.Name(id="exp"), args=[inner], keywords=[]):
            late = _value(inner)
            if late.letter == "s" and late.top.size == 2 and late.top[1] == 0.0 and late.bottom.size == 1:
                return Rational(one, one, -late.top[0] / late.bottom[0], "s")
        case ast.BinOp(left=base, op=ast.Pow(), right=ast.Constant(value=int() as power)) if power <= _MOST_POWER:
            found = Rational(one, one)
            for _ in range(power):
                found = _joined(found, _value(base), ast.Mult())
            return found
        case ast.BinOp(left=left, op=operator, right=right):
            return _joined(_value(left), _value(right), operator)
    raise ValueError


def _joined(left: Rational, right: Rational, operator: ast.operator) -> Rational:
    letters = {left.letter, right.letter} - {""}
    if len(letters) > 1 or left.bottom.size + right.bottom.size + left.top.size + right.top.size > 2 * _MOST_ORDER:
        raise ValueError
    letter = letters.pop() if letters else ""
    if isinstance(operator, ast.Mult | ast.MatMult | ast.Div):
        top, bottom, late = right.top, right.bottom, right.delay
        if isinstance(operator, ast.Div):
            top, bottom, late = bottom, top, -late
        return Rational(np.convolve(left.top, top), np.convolve(left.bottom, bottom), left.delay + late, letter)
    if not isinstance(operator, ast.Add | ast.Sub) or not math.isclose(left.delay, right.delay):
        raise ValueError
    sign = 1.0 if isinstance(operator, ast.Add) else -1.0
    total = np.polyadd(np.convolve(left.top, right.bottom), sign * np.convolve(right.top, left.bottom))
    return Rational(
        np.atleast_1d(np.asarray(total, dtype=float)), np.convolve(left.bottom, right.bottom), left.delay, letter
    )


def own_loop(plant: Any, controller: Any, period: float | None = None) -> LoopTransfer:
    """Return L of `controller` and `plant`; where one is sampled or a `period` [s] is given, the whole loop is.

    Each is what `read_rational` returns or a model that `LoopTransfer.of` takes. A continuous plant is held over each
    step, exactly; a continuous controller is sampled by Tustin's rule, as it would be programmed. Raises ParameterError
    for another type and for two sample times.
    """
    of_plant, law = _transfer(plant, period), _transfer(controller, period)
    times = {one for one in (period, of_plant.dt, law.dt) if one is not None}
    if max(times, default=0.0) > (1.0 + _SAME_TIME) * min(times, default=0.0):
        several = ", ".join(f"{one:g}" for one in sorted(times))
        raise ParameterError(f"sample times of {several} s", "loop", "give plant and controller the same one")
    if not times:
        return law.times(of_plant)
    dt = max(times)
    of_plant = held(of_plant, dt) if of_plant.dt is None else replace(of_plant, dt=dt)
    if law.dt is None:
        if law.delay:
            raise ParameterError("a controller with a continuous delay", "loop", "write it in z: / z^3")
        law = _tustin(law, dt)
    return replace(law, dt=dt).times(of_plant)


def _transfer(model: Any, period: float | None) -> LoopTransfer:
    return model.transfer(period=period) if isinstance(model, Rational) else LoopTransfer.of(model)


def held(loop: LoopTransfer, dt: float) -> LoopTransfer:
    """Return a continuous transfer with its input held over steps of `dt` [s]; its delay becomes states."""
    model = DelayedStateSpace.of(loop.a, loop.b, loop.c, [[loop.d]], loop.delay)
    return LoopTransfer.of(model.zero_order_hold(dt))


def _tustin(loop: LoopTransfer, dt: float) -> LoopTransfer:
    from scipy.signal import cont2discrete  # imported late: most commands start without it

    if not len(loop.a):
        return LoopTransfer.of_gain(loop.d, dt)
    a, b, c, d, _ = cont2discrete((loop.a, loop.b, loop.c, np.array([[loop.d]])), dt, method="bilinear")
    return LoopTransfer(a, b, c, float(d[0, 0]), dt)


def speed_of(m: LoopMargins) -> float:
    """Return the crossover, or the slowest closed-loop pole of a loop without one [rad/s]."""
    sizes = np.abs(m.poles_rad)
    sizes = sizes[np.isfinite(sizes) & (sizes > 1e-9)]
    return m.crossover if m.phases else float(sizes.min()) if sizes.size else 1.0


def final_value(m: LoopMargins) -> float:
    """Return T at rest, where the step response of a stable loop ends; NaN for an unstable one."""
    if not m.stable:
        return math.nan
    # A pole and a zero at rest may cancel.
    at_rest = complex(minimal(m.loop).at(0.0 if m.loop.dt is None else 1.0)[0])
    final = (at_rest / (1.0 + at_rest)).real if np.isfinite(at_rest) else 1.0
    return final if abs(final) > _ROUNDED * m.mt else 0.0


def step_response(m: LoopMargins) -> tuple[Array, Array]:
    """Return (time [s], value) of T after a unit step: how the loop follows its set-point, until it has settled.

    The samples of a continuous loop are exact; with a delay the error is held over steps of .01 / crossover or a
    200th of the delay. They lie further apart the longer it takes. An unstable loop is shown for 60 / crossover; one
    that has not settled after 100 times as long is cut there.
    """
    loop, speed, final = m.loop, speed_of(m), final_value(m)
    end, k = _FIRST / speed, 1.0 / (1.0 + loop.d)
    dt = loop.dt or max(end / _STEPS, loop.delay / DELAY_STEPS)
    if loop.delay:  # what is held is late by half a step on average
        loop = held(replace(loop, delay=loop.delay - 0.5 * dt), dt)
    closed = LoopTransfer(loop.a - k * loop.b @ loop.c, k * loop.b, k * loop.c, k * loop.d, loop.dt)
    if closed.dt is None:
        closed = held(closed, dt)
    n, count = len(closed.a), max(2, min(_STEPS, round(end / dt)))
    advance = np.block([[closed.a, closed.b], [np.zeros((1, n)), np.ones((1, 1))]])  # of the states and the step
    row, x = np.append(closed.c[0], closed.d), np.append(np.zeros(n), 1.0)
    time, value, begin, stride = np.empty(0), np.empty(0), 0, 1  # begin and stride in samples
    while True:
        more = np.empty(count)
        for i in range(count):
            more[i], x = row @ x, advance @ x
        time, value = np.append(time, dt * (begin + stride * np.arange(count))), np.append(value, more)
        span = float(np.ptp(value))
        away = np.abs(value - (final if m.stable else value[-1])) / max(min(span, abs(final) or span), 1e-300)
        settled = not m.stable or away[-(count // 5) - 1 :].max() <= _SETTLED
        if (settled and time[-1] >= end - dt * stride) or time[-1] >= _LONGEST * end:
            break
        advance, begin, stride = advance @ advance, begin + stride * count, 2 * stride
    outside = np.flatnonzero(away > 0.01)
    shown = max(_SHORTEST / speed, 1.3 * time[outside[-1]] if outside.size else 0.0)
    kept = max(2, int(np.searchsorted(time, shown, side="right")))
    return time[:kept], value[:kept]
