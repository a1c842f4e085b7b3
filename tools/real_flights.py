"""Writes the tables of the real flights in docs/explanation/identification.md: `python -m tools.real_flights [FOLDER]`.

It fits each public log as `twodof identify LOG` does. Seven of them are in the folder TWODOF_FLIGHT_DATA; six more of
the same two repositories, by their names there, are taken from FOLDER. The tables stand between
`<!-- measured: real -->` and `<!-- end -->`.
"""

import math
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from twodof.flightlog.files import read_log
from twodof.identify.estimate import Estimate
from twodof.identify.experiments import cut
from twodof.identify.ready_made import by_output_error, machine_of, structure_for

PAGE = Path(__file__).resolve().parents[1] / "docs" / "explanation" / "identification.md"
BLOCK = re.compile(r"<!-- measured: real -->\n.*?<!-- end -->", re.DOTALL)


@dataclass(frozen=True)
class RealFlight:
    """The longest manoeuvre of a log, its `kind` of experiment, and how the cart was: "rings", "free".

    In the third way, "at rest", the cart is in rings and the rotors stand still.
    """

    log: str
    kind: str
    cart: str = "rings"


_FREE = (
    "velocity-doublets-0.25",
    "log_3_2024-5-22-17-24-38_2dd",
    "log_7_2024-5-22-17-29-46_2dd",
    "position-sweep-default",
    "log_3_2024-5-22-17-30-40_2dd",
)

FLIGHTS: Sequence[RealFlight] = (
    RealFlight("free-response-impulse", "impulse", "at rest"),
    RealFlight("doublet-0.03", "doublet"),
    RealFlight("log_2_2024-5-22-17-25-02_2dd", "doublet"),
    RealFlight("attitude-steps-10deg-default", "attitude"),
    RealFlight("log_1_2024-5-22-17-22-32_2dd", "attitude"),
    RealFlight("attitude-steps-10deg-student", "attitude"),
    RealFlight("log_6_2024-5-22-17-27-44_2dd", "attitude"),
    RealFlight("rate-doublets-30dps-student", "attitude"),
    *(RealFlight(name, kind, "free") for kind in ("attitude", "velocity") for name in _FREE),
)

COLUMNS: Mapping[str, tuple[str, float, str]] = {
    "mu": ("mu, rad/s2", 1.0, ".0f"),
    "tau": ("tau, ms", 1e3, ".1f"),
    "w_n": ("w_n, rad/s", 1.0, ".2f"),
    "xi": ("xi", 1.0, ".3f"),
    "coulomb": ("dry friction", 1.0, ".3f"),
    "k_v": ("k_v, m/s2", 1.0, ".2f"),
    "p_v": ("p_v, 1/s", 1.0, ".2f"),
    "supply": ("supply", 1.0, ".3f"),
}
PITCH, RAIL = ("mu", "tau", "w_n", "xi", "coulomb"), ("k_v", "p_v", "coulomb", "supply")
COMPARED = ("mu", "tau", "w_n", "xi", "k_v", "p_v")
"""Figures that are compared between flights with running rotors; along the rail tau is the range's age."""

_TOLD = 0.01
"""Share of a fit's information on a figure that is from the data; below it they tell nothing beside the prior."""


def real_flights(*folders: Path, kinds: Sequence[str] = ()) -> Iterator[tuple[RealFlight, Estimate]]:
    """Each flight whose log is in one of the folders, with the fit of it that `twodof identify` makes by default."""
    for one in FLIGHTS:
        paths = [path for folder in folders for path in sorted(folder.glob(f"{one.log}*.mat"))]
        if not paths or (kinds and one.kind not in kinds):
            continue
        log = read_log(paths[0])
        record = cut(log, one.kind, name=one.log)
        machine = machine_of(log, record.start, float(record.time[-1]))
        found, _ = by_output_error(one.kind, structure_for(one.kind), [record], machines=[machine])
        assert isinstance(found, Estimate)
        yield one, found


@dataclass(frozen=True)
class Agreement:
    """Weighted `mean` of a figure over n flights, and how well they agree with it.

    Both are of the data alone: the prior, which all fits share, is taken out of each. `square` is chi-square about the
    mean and `point` its 99 % point. `spread` is the standard deviation between flights and `widest` the largest
    standard deviation that a flight claims, of the fits as they are.
    """

    n: int
    mean: float
    sigma: float
    square: float
    point: float
    spread: float
    widest: float


def agreement(found: Sequence[Estimate], figure: str) -> Agreement:
    """How well the flights agree on a figure; a fit whose data do not tell it is left out."""
    told = [one for one in found if figure in (*one.labels, *one.summed) and math.isfinite(one.sigma(figure))]
    values, sigmas = np.array([[one[figure], one.sigma(figure)] for one in told]).T
    centers, widths = np.array([one.prior.get(figure, (0.0, math.inf)) for one in told]).T
    # The information of a posterior is that of the data and that of the prior.
    weights, sums = sigmas**-2.0 - widths**-2.0, values * sigmas**-2.0 - centers * widths**-2.0
    telling = weights * sigmas**2.0 > _TOLD
    values, weights = sums[telling] / weights[telling], weights[telling]
    mean = float(weights @ values / weights.sum())
    square = float(weights @ (values - mean) ** 2)
    n = int(telling.sum())
    spread = float(np.std([one[figure] for one in told], ddof=1))
    return Agreement(
        n, mean, float(weights.sum() ** -0.5), square, float(chi2.ppf(0.99, n - 1)), spread, float(sigmas.max())
    )


def compared(flights: Sequence[tuple[RealFlight, Estimate]], figure: str) -> list[Estimate]:
    """The converged fits that tell a figure of the drone with its rotors running."""
    along = figure in ("k_v", "p_v")
    told = [one for one in flights if one[0].cart != "at rest" and (one[0].kind == "velocity") == along]
    return [found for _, found in told if found.converged]


def table(flights: Sequence[tuple[RealFlight, Estimate]]) -> Iterator[str]:
    """The rows of pitch and rail, and below them how well the flights agree."""
    for kinds, figures in ((("impulse", "doublet", "attitude"), PITCH), (("velocity",), RAIL)):
        yield f"| flight | {' | '.join(COLUMNS[name][0] for name in figures)} |"
        yield f"|{'---|' * (len(figures) + 1)}"
        for one, found in flights:
            if one.kind in kinds:
                cells = [shown(found, name) for name in figures]
                doubt = "" if found.converged else ", did not converge"
                yield f"| {one.log}, {one.cart}{doubt} | {' | '.join(cells)} |"
        yield ""
    yield "| figure | flights | mean | chi-square | its 99 % point | spread | widest claim / spread |"
    yield f"|{'---|' * 7}"
    for figure in COMPARED:
        title, factor, form = COLUMNS[figure]
        all_ = agreement(compared(flights, figure), figure)
        mean, sigma, spread = (f"{factor * one:{form}}" for one in (all_.mean, all_.sigma, all_.spread))
        cells = [f"{all_.n}", f"{mean} +- {sigma}", f"{all_.square:.1f}", f"{all_.point:.1f}", spread]
        yield f"| {title} | {' | '.join(cells)} | {all_.widest / all_.spread:.1f} |"


def shown(found: Estimate, unknown: str) -> str:
    """An unknown and its standard deviation; empty where it was not estimated."""
    if unknown not in (*found.labels, *found.summed):
        return ""
    _, factor, form = COLUMNS[unknown]
    if unknown in found.at_bound:
        return f"{factor * found[unknown]:{form}} (at bound)"
    return f"{factor * found[unknown]:{form}} +- {factor * found.sigma(unknown):{form}}"


if __name__ == "__main__":
    if not all(Path(one).is_dir() for one in sys.argv[1:]):
        raise SystemExit(__doc__)
    folders = [Path(os.environ["TWODOF_FLIGHT_DATA"]), *map(Path, sys.argv[1:])]
    made = "\n".join(["<!-- measured: real -->", "", *table(list(real_flights(*folders))), "", "<!-- end -->"])
    PAGE.write_text(BLOCK.sub(lambda _: made, PAGE.read_text(encoding="utf-8")), encoding="utf-8")
