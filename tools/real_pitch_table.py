"""Writes the table of the real pitch flights in docs/explanation/identification.md: `python -m tools.real_pitch_table`.

It needs the seven public logs (TWODOF_FLIGHT_DATA). It stands between `<!-- measured: real -->` and `<!-- end -->`.
"""

import math
import os
import re
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from twodof.flightlog.files import read_log
from twodof.identify.disturbance.noise_search import LONG
from twodof.identify.estimate import Estimate
from twodof.identify.greybox import fit
from twodof.identify.ready_made import BEND_PRIOR, FRICTION_PRIOR, machine_of
from twodof.identify.record import Record
from twodof.models.structures import pitch_on_cart, pitch_rate
from twodof.rig.parameters import load_rig
from twodof.rig.steady_state import model_parameters, moment_gain
from twodof.signals import HOVER

PAGE = Path(__file__).resolve().parents[1] / "docs" / "explanation" / "identification.md"
BLOCK = re.compile(r"<!-- measured: real -->\n.*?<!-- end -->", re.DOTALL)

FLIGHTS: Mapping[str, tuple[float, float]] = {
    "doublet-0.03": (244.70, 245.75),
    "attitude-steps-10deg-default": (127.50, 135.80),
    "attitude-steps-10deg-student": (6.70, 15.00),
    "rate-doublets-30dps-student": (346.60, 355.60),
    "velocity-doublets-0.25": (150.80, 160.50),
    "position-sweep-default": (133.00, 159.40),
}
"""Every flight in which the pitch is driven with the rotors running, and its window [s]."""

HEADER = (
    "flight",
    "today: mu",
    "tau, ms",
    "now: mu",
    "tau, ms",
    "bend",
    "M_u, rad/(m s)",
    "noise",
    "largest M",
)

UNKNOWNS = ("mu", "dead_time", "lag", "theta_0", "q_0")

_CHANCE = 0.05
"""Probability from which on a chi-square is no contradiction."""


@dataclass(frozen=True, eq=False)
class RealFlight:
    """The fits of a flight; `today` takes its noise for white and its delay for pure. `clipped` is a share.

    `plain` is `found` without the moment of the cart's speed and without what a large moment lacks. `hardest` is the
    largest |M|, `thrust` the mean T in the window.
    """

    name: str
    today: Estimate
    plain: Estimate
    found: Estimate
    clipped: float
    hardest: float
    thrust: float


def real_flights(folder: Path, names: Collection[str] = tuple(FLIGHTS)) -> Iterator[RealFlight]:
    """Each flight fitted by itself, with w_n and xi held at those that the same drone has while its rotors run."""
    known = load_rig("lab").snapshot()
    rig = model_parameters(known)
    poles = {"w_n": rig["w_n_run"], "xi": rig["xi_run"]}
    for name in names:
        start, stop = FLIGHTS[name]
        log = read_log(folder / f"{name}.mat")
        channels = {"M": "M", "T": "T", "theta": "theta", "gyro": "q"}
        record = Record.from_log(log, channels, {"q": "q"}, start, stop, smooth=["theta"], name=name)
        machine = machine_of(log, start, stop)
        moment, thrust = record.inputs["M"], record.inputs["T"]
        on_cart = {**poles, **machine.values(pitch_on_cart())}
        free = ("M_u",) if machine.free else ()
        yield RealFlight(
            name,
            fit(pitch_rate(), record, disturbance="white"),
            _fitted(record, on_cart, poles, ()),
            _fitted(record, on_cart, poles, ("bend", *free)),
            float(np.mean(np.abs(moment) > thrust)),
            float(np.abs(moment).max()),
            float(thrust.mean()),
        )


def _fitted(
    record: Record, on_cart: Mapping[str, float], poles: Mapping[str, float], more: tuple[str, ...]
) -> Estimate:
    """A long flight with what the calibration knows of the cart, and `more` unknowns; the gust of a short one is found
    with one input.

    Where the log lost the moment for some samples, the flight is fitted in pieces.
    """
    if record.steps < LONG:
        return fit(pitch_rate(lag=True), record, estimate=UNKNOWNS, values=poles)
    known = {**FRICTION_PRIOR, **(BEND_PRIOR if "bend" in more else {})}
    return fit(pitch_on_cart(), record.pieces(), estimate=(*UNKNOWNS, "coulomb", *more), values=on_cart, prior=known)


def agreement(values: np.ndarray, sigmas: np.ndarray) -> tuple[float, float, float, float]:
    """Weighted mean, its standard deviation, chi-square about it, and the probability of so much or more by chance."""
    weights = 1.0 / sigmas**2
    mean = float(weights @ values / weights.sum())
    square = float(weights @ (values - mean) ** 2)
    return mean, float(weights.sum() ** -0.5), square, float(chi2.sf(square, values.size - 1))


def table(flights: Sequence[RealFlight]) -> Iterator[str]:
    """The rows, and below them how well the flights agree."""
    yield f"| {' | '.join(HEADER)} |"
    yield f"|{'---|' * len(HEADER)}"
    for one in flights:
        loud = max((loud.times for loud in one.found.disturbance.louder.values()), default=math.nan)
        cells = [
            shown(one.today, "mu", ".0f"),
            delay(one.today),
            shown(one.found, "mu", ".0f"),
            delay(one.found),
            shown(one.found, "bend", ".1f"),
            shown(one.found, "M_u", ".1f"),
            f"x {loud:.1f}" if math.isfinite(loud) else "",
            f"{one.hardest:.2f}",
        ]
        yield f"| {one.name} | {' | '.join(cells)} |"
    yield ""
    for what, factor, unit in (("mu", 1.0, "rad/s2"), ("tau", 1e3, "ms")):
        fits = {"today": [one.today for one in flights], "now": [one.found for one in flights]}
        fits["now, without bend and M_u"] = [one.plain for one in flights]
        for title, found in fits.items():
            values, sigmas = np.array([[one[what], one.sigma(what)] for one in found]).T * factor
            known = np.isfinite(sigmas)
            mean, sigma, square, chance = agreement(values[known], sigmas[known])
            yield (
                f"- {what}, {title}: {values.min():.4g} to {values.max():.4g} {unit}, mean {mean:.4g} +- {sigma:.2g}, "
                f"chi-square {square:.1f} for {known.sum() - 1} degrees of freedom (probability {chance:.2g})"
            )
    said = " ".join([remaining(flights), *incomplete(flights)])
    yield from ("", *textwrap.wrap(said, 120, break_on_hyphens=False))


def shown(found: Estimate, unknown: str, form: str) -> str:
    """An unknown and its standard deviation; empty where it was not estimated."""
    if unknown not in found.labels:
        return ""
    return f"{found[unknown]:{form}} +- {found.sigma(unknown):{form}}"


def remaining(flights: Sequence[RealFlight]) -> str:
    """What the flights differ by beyond their own doubt, and what clipping and charge have to do with it."""
    values, sigmas = np.array([[one.found["mu"], one.found.sigma("mu")] for one in flights]).T
    mean, _, square, chance = agreement(values, sigmas)
    weights = sigmas**-2.0
    # DerSimonian and Laird (1986): the variance between flights that makes chi-square what it is.
    freedom = weights.sum() - float(weights @ weights) / float(weights.sum())
    between = math.sqrt(max(0.0, square - (len(flights) - 1)) / float(freedom)) / mean
    clipped = 100.0 * max(one.clipped for one in flights)
    rig = load_rig("lab").snapshot()
    slope = np.array([moment_gain(rig, one.thrust) / moment_gain(rig, HOVER) for one in flights])
    level, steeper = agreement(values / slope, sigmas)[2], 100.0 * (slope.max() - 1.0)
    verdict = "So the flights agree within their intervals." if chance > _CHANCE else "So the flights do not agree."
    return (
        f"{verdict} The likeliest difference beyond their own doubt is {100.0 * between:.1f} % in mu. |M| exceeds T in "
        f"{clipped:.1f} % of the samples, so no pair is clipped. The thrust curve is steeper at the higher mean T of "
        f"two flights, by {steeper:.1f} % at most: chi-square {level:.1f}."
    )


def incomplete(flights: Sequence[RealFlight]) -> Iterator[str]:
    """Which fits leave out a part of the response, if any."""
    names = [one.name for one in flights if _leaves_out(one.found)]
    if names:
        yield f"The residual of {' and '.join(names)} still depends on an input: a part of that is still left out."


def _leaves_out(found: Estimate) -> bool:
    """Whether the residual still depends on an input, as it does where the structure lacks a part of the response."""
    return any(not test.causal.passed for one in found.identification for test in one.inputs.values())


def delay(found: Estimate) -> str:
    """tau in ms with its standard deviation."""
    return f"{1e3 * found['tau']:.1f} +- {1e3 * found.sigma('tau'):.1f}"


if __name__ == "__main__":
    rows = table(list(real_flights(Path(os.environ["TWODOF_FLIGHT_DATA"]))))
    made = "\n".join(["<!-- measured: real -->", "", *rows, "", "<!-- end -->"])
    PAGE.write_text(BLOCK.sub(lambda _: made, PAGE.read_text(encoding="utf-8")), encoding="utf-8")
