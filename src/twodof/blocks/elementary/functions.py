"""Elementary functions, written in the block language, so that every target computes the same bits.

On a number a function computes, on an Expr it records a call by name; a compiler makes one function of each definition
in `DEFINITIONS`. No platform's libm is ever called. The result of a float32 or float64 has the same kind, and is
computed in that precision in every build.

Errors against mpmath are at most 2.5 ulp in float64 and 4 ulp in float32 over the whole range of each function. For
sin, cos and tan this holds while |x| <= 1e5 (float64) or 6400 (float32). `tests/blocks/elementary` measures them.
Infinities, NaN and signed zeros are those of C99, Annex F. Compute numbers under `numbers.precision`, which silences
the IEEE exceptions of the branches that `where` discards.
"""

from collections.abc import Callable
from functools import partial
from inspect import isfunction
from typing import Any

from twodof.blocks.elementary import definitions
from twodof.blocks.elementary.definitions import DOUBLE, SINGLE
from twodof.blocks.expressions import expr, numbers
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.numbers import rules


def _apply(name: str, *values: Any) -> Any:
    if expr.arrays_among(*values):
        return rules.spread(partial(_apply, name), *values)
    if expr.recording() or any(isinstance(v, Expr) for v in values):
        return expr.call(name, *values)
    kind = expr.float_kind(values)
    given = [numbers.cast(v, kind) for v in values]
    precision = numbers.scalar_types()[kind].__name__
    if kind == "real":
        return DEFINITIONS[name][precision](*given)
    with numbers.precision(precision):  # the definitions are written in reals
        return DEFINITIONS[name][precision](*given)


def sin(x: Any) -> Any:
    """Return the sine of x [rad], in [-1, 1]; NaN for an infinity.

    Beyond |x| = 1e5 (6400 in float32) the error is at most one ulp of x; beyond 2^44 (2^16) the result is 0. Wrap an
    angle that grows, as its rounding error grows with it.
    """
    return _apply("sin", x)


def cos(x: Any) -> Any:
    """Return the cosine of x [rad], in [-1, 1], as accurate as `sin`; 1 beyond 2^44 (2^16), NaN for an infinity."""
    return _apply("cos", x)


def sin_octant(x: Any) -> Any:
    """Return the sine of x [rad] for |x| <= pi/4 only, faster than `sin`; 0.0 for -0.0."""
    return _apply("sin_octant", x)


def cos_octant(x: Any) -> Any:
    """Return the cosine of x [rad] for |x| <= pi/4 only, faster than `cos`."""
    return _apply("cos_octant", x)


def tan(x: Any) -> Any:
    """Return the tangent of x [rad], as accurate as `sin`; 0 beyond 2^44 (2^16), NaN for an infinity."""
    return _apply("tan", x)


def atan(x: Any) -> Any:
    """Return the angle in [-pi/2, pi/2] rad whose tangent is x."""
    return _apply("atan", x)


def atan2(y: Any, x: Any) -> Any:
    """Return the angle in [-pi, pi] rad of the point (x, y), also for signed zeros and infinities."""
    return _apply("atan2", y, x)


def asin(x: Any) -> Any:
    """Return the angle in [-pi/2, pi/2] rad whose sine is x; NaN beyond [-1, 1]."""
    return _apply("asin", x)


def acos(x: Any) -> Any:
    """Return the angle in [0, pi] rad whose cosine is x; NaN beyond [-1, 1]."""
    return _apply("acos", x)


def exp(x: Any) -> Any:
    """Return e to the power x; subnormal or 0 for small x, infinite for large x."""
    return _apply("exp", x)


def log(x: Any) -> Any:
    """Return the natural logarithm of x; -inf for 0, NaN for x < 0."""
    return _apply("log", x)


def pow(x: Any, y: Any) -> Any:
    """Return x to the power y; NaN for a negative x if y is not an integer. An exact result is exact."""
    return _apply("pow", x, y)


def floor(x: Any) -> Any:
    """Return the largest integer not above x, as a real."""
    return _apply("floor", x)


def ceil(x: Any) -> Any:
    """Return the smallest integer not below x, as a real."""
    return _apply("ceil", x)


def trunc(x: Any) -> Any:
    """Return the integer next to x towards 0, as a real."""
    return _apply("trunc", x)


def round_half_even(x: Any) -> Any:
    """Return the integer nearest to x, as a real; of two equally near, the even one."""
    return _apply("round_half_even", x)


def round_half_away(x: Any) -> Any:
    """Return the integer nearest to x, as a real; of two equally near, the one away from 0."""
    return _apply("round_half_away", x)


def tanh(x: Any) -> Any:
    """Return the hyperbolic tangent of x."""
    return _apply("tanh", x)


def hypot(x: Any, y: Any) -> Any:
    """Return sqrt(x^2 + y^2) without overflow or underflow on the way; infinite if x or y is, even beside a NaN."""
    return _apply("hypot", x, y)


FUNCTIONS: dict[str, Callable[..., Any]] = {
    name: function for name, function in dict(vars()).items() if isfunction(function) and name in vars(definitions)
}
ARGUMENTS: dict[str, int] = {name: function.__code__.co_argcount for name, function in FUNCTIONS.items()}
DEFINITIONS: dict[str, dict[str, Callable[..., Any]]] = {
    name: {f.name: partial(getattr(definitions, name), f) for f in (DOUBLE, SINGLE)} for name in FUNCTIONS
}
