"""Coefficients of the elementary functions, lowest power first, exact in their format.

Printed by `tools/minimax.py`, which computes them; do not edit by hand.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Coefficients:
    """Polynomials and split constants of one precision, each with what it is for."""

    sin: tuple[float, ...]  # sin(r) = r + r z p(z), z = r^2, |r| <= pi/4
    cos: tuple[float, ...]  # cos(r) = 1 - z/2 + z^2 p(z), z = r^2, |r| <= pi/4
    exp: tuple[float, ...]  # exp(r) = 1 + r + r^2 p(r), |r| <= ln(2)/2
    log: tuple[float, ...]  # 2 atanh(s) = 2 s + s z p(z), z = s^2, |s| <= (sqrt(2) - 1)^2
    log_tail: tuple[float, ...]  # 2 atanh(s) = 2 s + s z (2/3 + z p(z)), for pow: about 13 bits more than log
    atan: tuple[float, ...]  # atan(t) = t + t z p(z), z = t^2, |t| <= 1/4
    asin: tuple[float, ...]  # asin(t) = t + t z p(z), z = t^2, |t| <= 1/2
    tanh: tuple[float, ...]  # tanh(t) = t + t z p(z), z = t^2, |t| <= 5/8
    pi_half: tuple[float, ...]  # pi/2, as a sum
    ln2: tuple[float, ...]  # ln 2, as a sum
    third: tuple[float, ...]  # 2/3, as a sum
    atan_half: tuple[float, ...]  # atan 1/2, as a sum
    pi: tuple[float, ...]  # pi, as a sum
    inverse: tuple[float, ...]  # 2/pi, 1/ln 2


def _row(text: str) -> tuple[float, ...]:
    return tuple(float.fromhex(word) for word in text.split())


FLOAT64 = Coefficients(
    sin=_row(
        "-0x1.5555555555548p-3 0x1.111111110f74bp-7 -0x1.a01a019bee91cp-13 0x1.71de355b25330p-19 "
        "-0x1.ae5e50f2facc0p-26 0x1.5d8d16251620fp-33"
    ),
    cos=_row(
        "0x1.555555555554ap-5 -0x1.6c16c16c14e3dp-10 0x1.a01a019c666fap-16 -0x1.27e4f7d6eb822p-22 "
        "0x1.1ee9cb18b1596p-29 -0x1.8f9e6ce6e6e00p-37"
    ),
    exp=_row(
        "0x1.000000000000cp-1 0x1.5555555555515p-3 0x1.555555554fe40p-5 0x1.111111112119bp-7 0x1.6c16c185f760fp-10 "
        "0x1.a01a014dbc99ep-13 0x1.a01995e460d9dp-16 0x1.71ded720eda62p-19 0x1.28b0d4566b2bbp-22 0x1.adfa45d221166p-26"
    ),
    log=_row(
        "0x1.5555555555595p-1 0x1.999999997f1eep-2 0x1.249249428873ap-2 0x1.c71c519501a28p-3 0x1.74665612a08efp-3 "
        "0x1.399f6d90079aep-3 0x1.2f1c7a888290ap-3"
    ),
    log_tail=_row(
        "0x1.9999999999995p-2 0x1.2492492493156p-2 0x1.c71c71c5630c4p-3 0x1.745d183eb16f4p-3 0x1.3b135fc122d20p-3 "
        "0x1.11211d3b9b852p-3 0x1.de244b63ea746p-4 0x1.eb868a1b185e9p-4"
    ),
    atan=_row(
        "-0x1.55555555554bfp-2 0x1.9999999973ee9p-3 -0x1.2492490a9672ap-3 0x1.c71c605d87048p-4 -0x1.7459d97026709p-4 "
        "0x1.3ab923b26376dp-4 -0x1.0b4626a793cabp-4 0x1.7949ad09c2a8cp-5"
    ),
    asin=_row(
        "0x1.5555555555399p-3 0x1.333333336d0c6p-4 0x1.6db6db438bf1dp-5 0x1.f1c72bdb3836fp-6 0x1.6e89fd4d337c6p-6 "
        "0x1.1c6b575742861p-6 0x1.c70876a6feda2p-7 0x1.8e7ce740fc94ep-7 0x1.ae2946e15bc09p-8 0x1.3e5cdb40af60fp-6 "
        "-0x1.075a90079030dp-6 0x1.04975b2137fa3p-5"
    ),
    tanh=_row(
        "-0x1.55555555554f9p-2 0x1.111111110a79dp-3 -0x1.ba1ba1b4d37dep-5 0x1.664f4772eeaa0p-6 -0x1.226e157319413p-7 "
        "0x1.d6cf12fb7eabfp-9 -0x1.7d67dd1e84383p-10 0x1.3361643c7a234p-11 -0x1.df32372eccf59p-13 "
        "0x1.4345fb3785c34p-14 -0x1.0d1ca4041bdf4p-16"
    ),
    pi_half=_row("0x1.921fb54440000p+0 0x1.68c234c4c0000p-39 0x1.98a2e03707345p-77"),
    ln2=_row("0x1.62e42fefa3800p-1 0x1.ef35793c76730p-45"),
    third=_row("0x1.5555555555555p-1 0x1.5555555555555p-55"),
    atan_half=_row("0x1.dac670561bb4fp-2 0x1.a2b7f222f65e2p-56"),
    pi=_row("0x1.921fb54442d18p+1 0x1.1a62633145c07p-53"),
    inverse=_row("0x1.45f306dc9c883p-1 0x1.71547652b82fep+0"),
)


FLOAT32 = Coefficients(
    sin=_row("-0x1.5555440000000p-3 0x1.1106e40000000p-7 -0x1.992bd20000000p-13"),
    cos=_row("0x1.55554a0000000p-5 -0x1.6c0c280000000p-10 0x1.99e8180000000p-16"),
    exp=_row(
        "0x1.fffff80000000p-2 0x1.55548e0000000p-3 0x1.555b9a0000000p-5 0x1.123bf00000000p-7 0x1.684fe40000000p-10"
    ),
    log=_row("0x1.55557a0000000p-1 0x1.995eca0000000p-2 0x1.31e2ce0000000p-2"),
    log_tail=_row("0x1.999a040000000p-2 0x1.24511c0000000p-2 0x1.dfdce80000000p-3"),
    atan=_row("-0x1.5555500000000p-2 0x1.9992da0000000p-3 -0x1.2342340000000p-3 0x1.9333d40000000p-4"),
    asin=_row(
        "0x1.5555c80000000p-3 0x1.3302460000000p-4 0x1.7472120000000p-5 0x1.8caece0000000p-6 0x1.58f4600000000p-5"
    ),
    tanh=_row(
        "-0x1.5555320000000p-2 0x1.1106fe0000000p-3 -0x1.b837800000000p-5 0x1.52095e0000000p-6 -0x1.7567ec0000000p-8"
    ),
    pi_half=_row("0x1.9220000000000p+0 -0x1.2ae0000000000p-18 -0x1.dea0000000000p-31 0x1.1846980000000p-44"),
    ln2=_row("0x1.62e4000000000p-1 0x1.7f7d1c0000000p-20"),
    third=_row("0x1.5555560000000p-1 -0x1.5555560000000p-26"),
    atan_half=_row("0x1.dac6700000000p-2 0x1.586ed40000000p-28"),
    pi=_row("0x1.921fb60000000p+1 -0x1.777a5c0000000p-24"),
    inverse=_row("0x1.45f3060000000p-1 0x1.7154760000000p+0"),
)
