"""Random numbers as a pure function of (seed, stream, tick): nothing is stored, any sample can be computed alone.

The generator is Philox 4x32-10. Source: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC
2011. The key is (seed, stream), and the counter is (tick, 0, 0, 0). One evaluation gives four words, so ask for several
numbers of one tick together (`normal4`), and give each source of noise a stream of its own. All arguments are uint32 or
int literals.
"""

from collections.abc import Sequence
from math import pi
from typing import Any

from twodof.blocks.elementary.functions import cos_octant, log, sin_octant
from twodof.blocks.expressions.expr import multiply_high, sqrt, to_int32, to_real, uint32

SEEDS = 2**32
"""Seeds of the noise are integers from 0 up to this, it excluded."""

ROUNDS = 10
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
KEY_STEPS = (0x9E3779B9, 0xBB67AE85)  # golden ratio and sqrt(3) - 1, as fractions of 2^32


def _word(value: Any) -> Any:
    return uint32(value) if type(value) is int else value


def philox(counter: Sequence[Any], key: Sequence[Any]) -> tuple[Any, Any, Any, Any]:
    """Philox 4x32-10: four uint32 from a counter of four and a key of two."""
    a, b, c, d = (_word(v) for v in counter)
    k0, k1 = (_word(v) for v in key)
    m0, m1 = (uint32(m) for m in MULTIPLIERS)
    for i in range(ROUNDS):
        if i:
            k0, k1 = k0 + KEY_STEPS[0], k1 + KEY_STEPS[1]
        a, b, c, d = multiply_high(m1, c) ^ b ^ k0, m1 * c, multiply_high(m0, a) ^ d ^ k1, m0 * a
    return a, b, c, d


def words(seed: Any, stream: Any, tick: Any) -> tuple[Any, Any, Any, Any]:
    """Four random uint32 of one tick."""
    return philox((tick, 0, 0, 0), (seed, stream))


def uniform4(seed: Any, stream: Any, tick: Any) -> tuple[Any, ...]:
    """Four independent numbers, uniform on [0, 1): multiples of 2^-24, the same values in both precisions."""
    return tuple(to_real(word >> 8) * 2.0**-24 for word in words(seed, stream, tick))


def normals(length: Any, direction: Any) -> tuple[Any, Any]:
    """Two independent standard normals from two words (Box and Muller, 1958).

    The first word is the radius's quantile; half a step added keeps it from 0, so that |z| <= 6.77. The second is a
    quarter of the angle, within +-pi/4, which needs no reduction; doubled twice it reaches all round without a branch
    that nobody could predict.
    """
    radius = sqrt(-2.0 * log((to_real(length) + 0.5) * 2.0**-32))
    quarter = to_real(to_int32(direction)) * (pi / 4 * 2.0**-31)
    s, c = sin_octant(quarter), cos_octant(quarter)
    s, c = 2.0 * s * c, 1.0 - 2.0 * s * s
    return radius * (1.0 - 2.0 * s * s), radius * (2.0 * s * c)


def normal(seed: Any, stream: Any, tick: Any) -> Any:
    """Return a standard normal number (mean 0, variance 1), |z| <= 6.77."""
    a, b, _, _ = words(seed, stream, tick)
    return normals(a, b)[0]


def normal4(seed: Any, stream: Any, tick: Any) -> tuple[Any, Any, Any, Any]:
    """Four independent standard normals at less than twice the price of one; the first is `normal`'s."""
    a, b, c, d = words(seed, stream, tick)
    return *normals(a, b), *normals(c, d)
