"""Definitions of the elementary functions, one each, for a `Format` (float64 or float32).

They are made of + - * / sqrt, `where` and bit operations of the block language only. The methods are the textbook ones
(J.-M. Muller, Elementary Functions, 3rd ed., 2016): reduce the argument, evaluate a polynomial
(`coefficients.py`), undo the reduction. Sums and products with their rounding errors are Dekker's and Knuth's. An angle
is reduced by quarter turns (pi/2) to an octant, [-pi/4, pi/4].
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from twodof.blocks.elementary.coefficients import FLOAT32, FLOAT64, Coefficients
from twodof.blocks.expressions.expr import bits_of, from_bits, sqrt, to_int32, to_real, to_uint32, uint32, where

INFINITY = float("inf")
NAN = float("nan")


@dataclass(frozen=True)
class Format:
    """An IEEE binary format and the limits that follow from it."""

    name: str
    coefficients: Coefficients
    fraction: int  # stored bits of the significand
    top: int  # the 32-bit word that holds sign and exponent
    position: int  # of the exponent in that word
    bias: int
    sqrt_half: int  # top word of sqrt(1/2)
    shifter_word: int  # lowest word of the shifter
    overflow: float  # exp of it is infinite
    underflow: float  # exp of it is 0
    last_turn: float  # beyond it sin, cos and tan give up; the last place of x is 2^-8 there

    @property
    def unit(self) -> float:
        """Power of two from which on all reals are integers."""
        return 2.0**self.fraction

    @property
    def shifter(self) -> float:
        """Number that, added to a small real, leaves the nearest integer in the low bits of the sum."""
        return 1.5 * self.unit

    @property
    def splitter(self) -> float:
        """Veltkamp's constant, a product with which divides a significand into halves."""
        return 2.0 ** ((self.fraction + 2) // 2) + 1.0

    def upper(self, x: Any) -> Any:
        """Return the word of `x` that holds its sign and exponent."""
        return bits_of(x, self.top)

    def negative(self, x: Any) -> Any:
        """Return True if the sign bit is set, also for -0.0, for which `x < 0` is false."""
        return to_int32(self.upper(x)) < 0

    def replace_upper(self, x: Any, word: Any) -> Any:
        """Return x with another sign and exponent word."""
        return from_bits(bits_of(x, 0), word) if self.top else from_bits(word)

    def power_of_two(self, n: Any) -> Any:
        """Return 2^n for an int32 n within the exponents of normal numbers."""
        word = to_uint32(n + self.bias) << self.position
        return from_bits(uint32(0), word) if self.top else from_bits(word)


DOUBLE = Format("float64", FLOAT64, 52, 1, 20, 1023, 0x3FE6A09E, 0, 710.0, -746.0, 2.0**44)
SINGLE = Format("float32", FLOAT32, 23, 0, 23, 127, 0x3F3504F3, 0x4B400000, 89.0, -104.0, 2.0**16)


def polynomial(z: Any, coefficients: Sequence[float]) -> Any:
    """Return the sum of coefficients[i] z^i by Estrin's scheme, which has fewer successive steps than Horner's."""
    terms: list[Any] = list(coefficients)
    while len(terms) > 1:
        pairs = [terms[i] + terms[i + 1] * z for i in range(0, len(terms) - 1, 2)]
        terms = pairs + terms[len(pairs) * 2 :]
        z = z * z
    return terms[0]


def _quick_sum(a: Any, b: Any) -> tuple[Any, Any]:
    """Return a + b and its rounding error, for |a| >= |b| or a = 0."""
    high = a + b
    return high, b - (high - a)


def _sum(a: Any, b: Any) -> tuple[Any, Any]:
    """Return a + b and its rounding error."""
    high = a + b
    part = high - a
    return high, (a - (high - part)) + (b - part)


def _halves(f: Format, a: Any) -> tuple[Any, Any]:
    scaled = a * f.splitter
    high = scaled - (scaled - a)
    return high, a - high


def _product(f: Format, a: Any, b: Any) -> tuple[Any, Any]:
    """Return a * b and its rounding error, for products that do not overflow and do not lose bits below."""
    high = a * b
    a1, a2 = _halves(f, a)
    b1, b2 = _halves(f, b)
    return high, ((a1 * b1 - high) + a1 * b2 + a2 * b1) + a2 * b2


def _quarter_turns(f: Format, x: Any) -> tuple[Any, Any, Any]:
    """Return the integer n nearest to x / (pi/2), modulo 2^22, and r = x - n pi/2 with its rounding error.

    The products, and the first difference, are exact while n is short enough (`Coefficients.pi_half`).
    """
    shifted = x * f.coefficients.inverse[0] + f.shifter
    n = shifted - f.shifter
    r, tail = x - n * f.coefficients.pi_half[0], None
    for part in f.coefficients.pi_half[1:]:
        before, product = r, n * part
        r = before - product
        lost = (before - r) - product
        tail = lost if tail is None else tail + lost
    return bits_of(shifted), r, tail


NEAR = 0.78
"""Angle [rad] up to which the reduction changes no bit: a little below pi/4."""


def _nearest_quarter(f: Format, x: Any) -> tuple[Any, Any]:
    """As `_quarter_turns`, without the tail; most angles are near 0, and there is nothing to take away."""
    turns, r, _ = _quarter_turns(f, x)
    near = abs(x) <= NEAR
    return where(near, uint32(0), turns), where(near, x, r)


def sin_octant(f: Format, r: Any) -> Any:
    """Return the sine for |r| <= pi/4."""
    z = r * r
    return r + r * z * polynomial(z, f.coefficients.sin)


def cos_octant(f: Format, r: Any) -> Any:
    """Return the cosine for |r| <= pi/4."""
    z = r * r
    return 1.0 - (z * 0.5 - z * z * polynomial(z, f.coefficients.cos))


def sin(f: Format, x: Any) -> Any:
    """Return the sine: of the octant's sine and cosine, the number of quarter turns selects one and its sign."""
    turns, r = _nearest_quarter(f, x)
    y = where((turns & 1) == 0, sin_octant(f, r), cos_octant(f, r))
    y = where((turns & 2) == 0, y, -y)
    return where(x == 0.0, x, where(abs(x) <= f.last_turn, y, x - x))


def cos(f: Format, x: Any) -> Any:
    """Return the cosine, as `sin` a quarter turn ahead."""
    turns, r = _nearest_quarter(f, x)
    y = where((turns & 1) == 0, cos_octant(f, r), sin_octant(f, r))
    y = where(((turns + 1) & 2) == 0, y, -y)
    return where(abs(x) <= f.last_turn, y, (x - x) + 1.0)


def tan(f: Format, x: Any) -> Any:
    """Return the tangent: sine by cosine of the octant, or -cosine by sine for odd quarter turns."""
    # The quotient adds the errors of both, so both are taken beyond their rounding: the tail of r goes into them.
    turns, r, tail = _quarter_turns(f, x)
    z = r * r
    s = r + (r * z * polynomial(z, f.coefficients.sin) + tail)
    half = z * 0.5
    c, lost = _quick_sum(1.0, -half)
    c = c + (lost + (z * z * polynomial(z, f.coefficients.cos) - r * tail))
    odd = (turns & 1) != 0
    y = where(odd, -c, s) / where(odd, s, c)
    return where(x == 0.0, x, where(abs(x) <= f.last_turn, y, x - x))


def _angle(f: Format, n: Any, d: Any) -> Any:
    """atan(n / d) for 0 <= n <= d, d > 0, by one division: the angle from that of the nearest of 0, 1/2 and 1."""
    c = f.coefficients
    near_0, near_half = 4.0 * n < d, 4.0 * n < 3.0 * d
    above = where(near_0, n, where(near_half, (n + n) - d, n - d))
    below = where(near_0, d, where(near_half, (d + d) + n, d + n))
    high = where(near_0, 0.0, where(near_half, c.atan_half[0], c.pi[0] / 4))
    low = where(near_0, 0.0, where(near_half, c.atan_half[1], c.pi[1] / 4))
    t = above / below
    z = t * t
    return high + (t + (t * z * polynomial(z, c.atan) + low))


def _from(f: Format, halves: int, angle: Any) -> Any:
    """Return halves * pi/2 - angle."""
    high, low = (part * halves / 2 for part in f.coefficients.pi)
    return high - (angle - low)


def atan(f: Format, x: Any) -> Any:
    """Return the arc tangent; for |x| > 1 it is pi/2 less the arc tangent of 1 / |x|, with the sign of x."""
    a = abs(x)
    steep = a > 1.0
    angle = _angle(f, where(steep, 1.0, a), where(steep, a, 1.0))
    angle = where(steep, _from(f, 1, angle), angle)
    return where(f.negative(x), -angle, angle)


def atan2(f: Format, y: Any, x: Any) -> Any:
    """Return the angle of the point (x, y), from the ratio of its shorter to its longer side, the axis and quadrant."""
    a, b = abs(y), abs(x)
    steep = b < a
    long, short = where(steep, a, b), where(steep, b, a)
    huge = 2.0 ** (f.bias - 3) < long  # sums of three sides must not overflow
    n, d = where(huge, short * 0.0625, short), where(huge, long * 0.0625, long)
    # Both sides infinite is the angle of 1:1, both 0 that of 0:1.
    endless = long == INFINITY
    n = where(endless, where(short == INFINITY, 1.0, 0.0), n)
    d = where(endless | (long == 0.0), 1.0, d)
    # Up to 1:1 the angle is counted from the x axis, forward or backward; from there on from the y axis.
    backward = f.negative(x)
    high, low = (where(steep, part / 2, where(backward, part, 0.0)) for part in f.coefficients.pi)
    angle = _angle(f, n, d)
    angle = high + (where(steep == backward, angle, -angle) + low)
    angle = where(f.negative(y), -angle, angle)
    return where((x == x) & (y == y), angle, x + y)


def _arc(f: Format, x: Any) -> tuple[Any, Any, Any]:
    """Return |x| <= 1/2, and asin(x) as a sum if so, else acos(|x|) / 2, the asin of sqrt((1 - |x|) / 2)."""
    a = abs(x)
    small = a <= 0.5
    z = where(small, x * x, 0.5 - 0.5 * a)
    t = where(small, x, sqrt(z))
    return small, t, t * z * polynomial(z, f.coefficients.asin)


def asin(f: Format, x: Any) -> Any:
    """Return the arc sine: a polynomial for |x| <= 1/2, beyond it a quarter turn less twice the half angle."""
    small, t, rest = _arc(f, x)
    high, low = f.coefficients.pi
    large = (high / 2 - (t + t)) - ((rest + rest) - low / 2)
    return where(small, t + rest, where(x < 0.0, -large, large))


def acos(f: Format, x: Any) -> Any:
    """Return the arc cosine: a quarter turn less the arc sine for |x| <= 1/2, beyond it from twice the half angle."""
    small, t, rest = _arc(f, x)
    arc = t + rest
    large = where(x < 0.0, _from(f, 2, arc + arc), arc + arc)
    return where(small, _from(f, 1, arc), large)


def _halvings(f: Format, x: Any) -> tuple[Any, Any, Any]:
    """Return the integer n nearest to x / ln 2 and x - n ln 2, less its last part; for x within the limits of exp."""
    c = f.coefficients
    shifted = x * c.inverse[1] + f.shifter
    n = shifted - f.shifter
    return to_int32(bits_of(shifted) - f.shifter_word), x - n * c.ln2[0], n * c.ln2[1]


def _scaled(f: Format, y: Any, n: Any) -> Any:
    """Return y 2^n in two steps; only the last can round, from infinity down to subnormals and 0."""
    half = n >> 1
    return y * f.power_of_two(half) * f.power_of_two(n - half)


def exp(f: Format, x: Any) -> Any:
    """Return e^x as 2^n e^r with |r| <= ln(2)/2."""
    x = where(f.overflow < x, f.overflow, where(x < f.underflow, f.underflow, x))
    n, most, last = _halvings(f, x)
    r = most - last
    return _scaled(f, 1.0 + (r + r * r * polynomial(r, f.coefficients.exp)), n)


def _mantissa(f: Format, x: Any) -> tuple[Any, Any]:
    """Return m in [sqrt(1/2), sqrt(2)) and the real k with x = m 2^k, for finite x > 0."""
    small = x < 2.0 ** (1 - f.bias)
    x = where(small, x * (4.0 * f.unit), x)
    word = f.upper(x)
    k = to_int32(word - f.sqrt_half) >> f.position
    m = f.replace_upper(x, word - (to_uint32(k) << f.position))
    return m, to_real(k) - where(small, f.fraction + 2.0, 0.0)


def log(f: Format, x: Any) -> Any:
    """Return the logarithm of x = 2^k m as k ln 2 + log m, with m in [sqrt(1/2), sqrt(2)), by the series of atanh."""
    c = f.coefficients
    m, k = _mantissa(f, x)
    g = m - 1.0
    s = g / (2.0 + g)
    z = s * s
    # log(1 + g) = 2 atanh(s) = g - s (g - z p(z)), because 2 s = g - s g.
    y = k * c.ln2[0] + (g - (s * (g - z * polynomial(z, c.log)) - k * c.ln2[1]))
    singular = where(x == 0.0, -INFINITY, where(x < 0.0, NAN, x))
    return where((x > 0.0) & (x < INFINITY), y, singular)


def _log_sum(f: Format, x: Any) -> tuple[Any, Any]:
    """log(x) as a sum of two reals, about 2^-64 (2^-34 in float32) accurate, for finite x > 0."""
    c = f.coefficients
    m, k = _mantissa(f, x)
    g = m - 1.0
    d, d_low = _quick_sum(2.0, g)
    s = g / d
    p, p_low = _product(f, s, d)
    s_low = (((g - p) - p_low) - s * d_low) / d
    z, z_low = _product(f, s, s)
    z_low = z_low + 2.0 * s * s_low
    # log m = 2 s + s u, u = z v, v = 2/3 + z q(z).
    v, v_low = _quick_sum(c.third[0], z * polynomial(z, c.log_tail))
    v_low = v_low + c.third[1]
    u, u_low = _product(f, z, v)
    u_low = u_low + (z * v_low + z_low * v)
    w, w_low = _product(f, s, u)
    w_low = w_low + (s * u_low + s_low * u)
    high, low = _quick_sum(s + s, w)
    low = low + (w_low + (s_low + s_low))
    total, rest = _sum(k * c.ln2[0], high)
    return _quick_sum(total, rest + (low + k * c.ln2[1]))


def pow(f: Format, x: Any, y: Any) -> Any:
    """Return x^y as exp(y log x), with logarithm and product each as a sum of two reals, for an error below 1 ulp."""
    a = abs(x)
    plain = (a > 0.0) & (a < INFINITY)
    log, log_low = _log_sum(f, where(plain, a, 1.0))
    # From here on |y| makes any power but that of 1 overflow or vanish.
    limit = 4.0 * f.unit * 2.0 ** (f.fraction // 3)
    e = where(limit < y, limit, where(y < -limit, -limit, y))
    t, t_low = _product(f, e, log)
    t_low = t_low + e * log_low
    inside = (t <= f.overflow) & (f.underflow <= t)
    t = where(inside, t, where(t < 0.0, f.underflow, f.overflow))
    t_low = where(inside, t_low, 0.0)
    n, most, last = _halvings(f, t)
    r, r_low = _sum(most, t_low - last)
    h, h_low = _quick_sum(1.0, r)
    z = _scaled(f, h + (h_low + (r_low + r * r * polynomial(r, f.coefficients.exp))), n)
    z = where(plain, z, where((a == 0.0) == (y < 0.0), INFINITY, 0.0))
    whole = y == trunc(f, y)
    odd = whole & (trunc(f, y * 0.5) != y * 0.5)
    z = where(odd & f.negative(x), -z, z)
    z = where((x < 0.0) & plain & ~whole, NAN, z)
    z = where((x == x) & (y == y), z, x + y)
    return where((y == 0.0) | (x == 1.0), 1.0, z)


def _nearest(f: Format, x: Any) -> tuple[Any, Any]:
    """Return True if x has a fraction to lose, and then an integer within 1/2 of x with the sign of x."""
    a = abs(x)
    n = (a + f.unit) - f.unit
    return (a > 0.0) & (a < f.unit), where(x < 0.0, -n, n)


def floor(f: Format, x: Any) -> Any:
    """Return the largest integer not above x: the nearest one, less 1 if that is above."""
    fractional, n = _nearest(f, x)
    return where(fractional, where(x < n, n - 1.0, n), x)


def ceil(f: Format, x: Any) -> Any:
    """Return the smallest integer not below x: -floor(-x)."""
    return -floor(f, -x)


def trunc(f: Format, x: Any) -> Any:
    """Return the integer next to x towards 0: the floor of |x| with the sign of x."""
    a = abs(x)
    n = floor(f, a)
    return where(f.negative(x), -n, n)


def round_half_even(f: Format, x: Any) -> Any:
    """Return the integer nearest to x; of two equally near, the even one, as the addition of `f.unit` rounds."""
    fractional, n = _nearest(f, x)
    return where(fractional, n, x)


def round_half_away(f: Format, x: Any) -> Any:
    """Return the integer nearest to x; of two equally near, the one away from 0."""
    a = abs(x)
    n = floor(f, a)
    n = where(a - n < 0.5, n, n + 1.0)
    return where(a < f.unit, where(f.negative(x), -n, n), x)


def tanh(f: Format, x: Any) -> Any:
    """Return the hyperbolic tangent: a polynomial for |x| <= 5/8, beyond it 1 - 2 / (e^2x + 1)."""
    a = abs(x)
    z = x * x
    small = x + x * z * polynomial(z, f.coefficients.tanh)
    large = 1.0 - 2.0 / (exp(f, a + a) + 1.0)
    y = where(a <= 0.625, small, where(x < 0.0, -large, large))
    return where(x == 0.0, x, y)


def hypot(f: Format, x: Any, y: Any) -> Any:
    """Return sqrt(x^2 + y^2), scaled by a power of two on the way, so that nothing overflows or underflows."""
    a, b = abs(x), abs(y)
    long = where(a < b, b, a)
    huge, tiny = 2.0 ** (f.bias // 2 - 1) < long, long < 2.0 ** (f.fraction - f.bias // 2)
    down, up = 2.0 ** -(f.bias // 2 + 2), 2.0 ** (f.bias // 2 + f.fraction)
    scale = where(huge, down, where(tiny, up, 1.0))
    a, b = a * scale, b * scale
    length = sqrt(a * a + b * b) * where(huge, 1.0 / down, where(tiny, 1.0 / up, 1.0))
    return where((abs(x) == INFINITY) | (abs(y) == INFINITY), INFINITY, length)
