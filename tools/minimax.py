"""Fits the polynomials of the elementary functions and prints `src/twodof/blocks/elementary/coefficients.py`.

Each polynomial is a weighted least-squares fit of one smooth function on Chebyshev points, which is nearly minimax. Its
coefficients are rounded to the format from the lowest power up. After each rounding the higher ones are fitted again,
so that they make up for it.

    python tools/minimax.py > src/twodof/blocks/elementary/coefficients.py

The largest weighted error of each fit, in units of 2^-53 or 2^-24, goes to the standard error stream.
"""

import sys
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mpmath import mp, mpf

mp.prec = 500
GRID = 100
WIDTH = 120


@dataclass(frozen=True)
class Fit:
    """Polynomial in z for `target` on [low, high], with the number of coefficients in each format."""

    name: str
    text: str
    target: Callable[[Any], Any]
    weight: Callable[[Any], Any]
    low: Any
    high: Any
    float64: int
    float32: int


def atanh_ratio(z: Any) -> Any:
    """2 atanh(s) / s with z = s^2."""
    s = mp.sqrt(z)
    return 2 * mp.atanh(s) / s


def sin_ratio(z: Any) -> Any:
    return mp.sin(mp.sqrt(z)) / mp.sqrt(z)


def atan_ratio(z: Any) -> Any:
    return mp.atan(mp.sqrt(z)) / mp.sqrt(z)


def asin_ratio(z: Any) -> Any:
    return mp.asin(mp.sqrt(z)) / mp.sqrt(z)


def tanh_ratio(z: Any) -> Any:
    return mp.tanh(mp.sqrt(z)) / mp.sqrt(z)


# A little beyond the ideal interval: the reduced argument may end just outside it.
MARGIN = mpf(1001) / 1000
OCTANT = (mp.pi / 4 * MARGIN) ** 2
HALF_LN2 = mp.log(2) / 2 * MARGIN
ATANH = ((mp.sqrt(2) - 1) / (mp.sqrt(2) + 1) * MARGIN) ** 2

FITS = (
    Fit(
        "sin",
        "sin(r) = r + r z p(z), z = r^2, |r| <= pi/4",
        lambda z: (sin_ratio(z) - 1) / z,
        lambda z: z / sin_ratio(z),
        mpf(0),
        OCTANT,
        6,
        3,
    ),
    Fit(
        "cos",
        "cos(r) = 1 - z/2 + z^2 p(z), z = r^2, |r| <= pi/4",
        lambda z: (mp.cos(mp.sqrt(z)) - 1 + z / 2) / z**2,
        lambda z: z**2 / mp.cos(mp.sqrt(z)),
        mpf(0),
        OCTANT,
        6,
        3,
    ),
    Fit(
        "exp",
        "exp(r) = 1 + r + r^2 p(r), |r| <= ln(2)/2",
        lambda r: (mp.exp(r) - 1 - r) / r**2,
        lambda r: r**2 / mp.exp(r),
        -HALF_LN2,
        HALF_LN2,
        10,
        5,
    ),
    Fit(
        "log",
        "2 atanh(s) = 2 s + s z p(z), z = s^2, |s| <= (sqrt(2) - 1)^2",
        lambda z: (atanh_ratio(z) - 2) / z,
        lambda z: z / atanh_ratio(z),
        mpf(0),
        ATANH,
        7,
        3,
    ),
    Fit(
        "log_tail",
        "2 atanh(s) = 2 s + s z (2/3 + z p(z)), for pow: about 13 bits more than log",
        lambda z: ((atanh_ratio(z) - 2) / z - mpf(2) / 3) / z,
        lambda z: z**2 / atanh_ratio(z),
        mpf(0),
        ATANH,
        8,
        3,
    ),
    Fit(
        "atan",
        "atan(t) = t + t z p(z), z = t^2, |t| <= 1/4",
        lambda z: (atan_ratio(z) - 1) / z,
        lambda z: z / atan_ratio(z),
        mpf(0),
        mpf(1) / 16 * MARGIN,
        8,
        4,
    ),
    Fit(
        "asin",
        "asin(t) = t + t z p(z), z = t^2, |t| <= 1/2",
        lambda z: (asin_ratio(z) - 1) / z,
        lambda z: z / asin_ratio(z),
        mpf(0),
        mpf(1) / 4,
        12,
        5,
    ),
    Fit(
        "tanh",
        "tanh(t) = t + t z p(z), z = t^2, |t| <= 5/8",
        lambda z: (tanh_ratio(z) - 1) / z,
        lambda z: z / tanh_ratio(z),
        mpf(0),
        mpf(25) / 64,
        11,
        5,
    ),
)


def rounded(value: Any, bits: int) -> Any:
    """`value` rounded to nearest with `bits` significant bits."""
    if value == 0:
        return mpf(0)
    scale = mpf(2) ** (bits - 1 - int(mp.floor(mp.log(abs(value), 2))))
    return mp.nint(value * scale) / scale


def grid(low: Any, high: Any) -> list[Any]:
    """Points dense towards the ends, where a minimax error alternates fastest; without the ends and their middle."""
    return [
        (low + high) / 2 + (high - low) / 2 * mp.cos(mp.pi * (2 * i + 1) / (2 * GRID)) for i in reversed(range(GRID))
    ]


def solve(z: list[Any], target: list[Any], weight: list[Any], first: int, count: int) -> list[Any]:
    """The `count` coefficients of z^first, ... that minimise the sum of (weight * (target - p))^2.

    On points with the Chebyshev density the error is nearly a multiple of one Chebyshev polynomial, so nearly minimax.
    The normal equations are ill-conditioned; `mp.prec` is chosen to afford that.
    """
    columns = [[w * x ** (first + j) for x, w in zip(z, weight, strict=True)] for j in range(count)]
    right = [w * t for t, w in zip(target, weight, strict=True)]
    matrix = mp.matrix([[mp.fdot(a, b) for b in columns] for a in columns])
    return list(mp.lu_solve(matrix, mp.matrix([mp.fdot(a, right) for a in columns])))


def coefficients(fit: Fit, count: int, bits: int) -> list[Any]:
    """The fit's coefficients, lowest power first, each rounded to `bits`."""
    z = grid(fit.low, fit.high)
    weight = [fit.weight(x) for x in z]
    rest = [fit.target(x) for x in z]
    result: list[Any] = []
    while len(result) < count:
        power = len(result)
        result.append(rounded(solve(z, rest, weight, power, count - power)[0], bits))
        rest = [t - result[-1] * x**power for x, t in zip(z, rest, strict=True)]
    worst = max(abs(w * t) for t, w in zip(rest, weight, strict=True))
    sys.stderr.write(f"{fit.name:10} {bits} bits, {count:2} coefficients: {float(worst * 2**bits):.2g}\n")
    return result


def parts(value: Any, sizes: tuple[int, ...]) -> list[Any]:
    """`value` as a sum of numbers with these many significant bits."""
    result = []
    for bits in sizes:
        result.append(rounded(value - sum(result), bits))
    return result


def constants(bits: int) -> dict[str, tuple[str, list[Any]]]:
    """Numbers that are kept as unevaluated sums, short parts first so that their products with an integer are exact."""
    exponent = 11 if bits == 53 else 8
    turns = (37, 37, 53) if bits == 53 else (12, 12, 12, 24)
    return {
        "pi_half": ("pi/2", parts(mp.pi / 2, turns)),
        "ln2": ("ln 2", parts(mp.log(2), (bits - exponent, bits))),
        "third": ("2/3", parts(mpf(2) / 3, (bits, bits))),
        "atan_half": ("atan 1/2", parts(mp.atan(mpf(1) / 2), (bits, bits))),
        "pi": ("pi", parts(mp.pi, (bits, bits))),
        "inverse": ("2/pi, 1/ln 2", [rounded(2 / mp.pi, bits), rounded(1 / mp.log(2), bits)]),
    }


def row(name: str, values: list[Any]) -> str:
    digits = " ".join(float(v).hex() for v in values)
    single = f'    {name}=_row("{digits}"),'
    if len(single) <= WIDTH:
        return f"{single}\n"
    lines = textwrap.wrap(digits, WIDTH - 11)
    if len(digits) <= WIDTH - 10:
        lines = [digits]
    body = "".join(f'        "{line} "\n' for line in lines[:-1]) + f'        "{lines[-1]}"'
    return f"    {name}=_row(\n{body}\n    ),\n"


HEAD = '''"""Coefficients of the elementary functions, lowest power first, exact in their format.

Printed by `tools/minimax.py`, which computes them; do not edit by hand.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Coefficients:
    """Polynomials and split constants of one precision, each with what it is for."""

'''


def main() -> None:
    """Print the module."""
    texts = {fit.name: fit.text for fit in FITS}
    texts |= {key: text if key == "inverse" else f"{text}, as a sum" for key, (text, _) in constants(53).items()}
    out = [HEAD]
    out += [f"    {name}: tuple[float, ...]  # {text}\n" for name, text in texts.items()]
    out.append(
        "\n\ndef _row(text: str) -> tuple[float, ...]:\n"
        "    return tuple(float.fromhex(word) for word in text.split())\n"
    )
    for name, bits in (("FLOAT64", 53), ("FLOAT32", 24)):
        out.append(f"\n\n{name} = Coefficients(\n")
        for fit in FITS:
            count = fit.float64 if bits == 53 else fit.float32
            out.append(row(fit.name, coefficients(fit, count, bits)))
        for key, (_, values) in constants(bits).items():
            out.append(row(key, values))
        out.append(")\n")
    sys.stdout.write("".join(out))


if __name__ == "__main__":
    main()
