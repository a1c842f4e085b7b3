"""Writes the coverage table in docs/explanation/identification.md: `python -m tools.coverage_table [--seeds 100]`.

It takes minutes, so no test makes it again; `make soak` checks what it shows. It stands between
`<!-- measured: coverage -->` and `<!-- end -->`. The same seeds give the same figures.
"""

import argparse
import math
import re
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from inspect import signature
from itertools import repeat
from pathlib import Path

from tools.coverage import Case, Outcome, campaign, cases, promised
from twodof.experiment.flight import Laboratory
from twodof.identify.greybox import fit
from twodof.rig.parameters import NAMES, load_rig

PAGE = Path(__file__).resolve().parents[1] / "docs" / "explanation" / "identification.md"
BLOCK = re.compile(r"<!-- measured: coverage -->\n.*?<!-- end -->", re.DOTALL)
WHITE: dict[str, str] = {"disturbance": "white"} if "disturbance" in signature(fit).parameters else {}
HEADER = (
    "experiment (flights)",
    "",
    "truth",
    "white: bias",
    "spread",
    "covers, %",
    "auto: bias",
    "spread",
    "claimed",
    "covers, %",
    "spread / bound",
    "promised / spread",
)
UNITS = {"mu": (1.0, "rad/s2"), "tau": (1e3, "ms"), "k_v": (1.0, "m/s2"), "p_v": (1.0, "1/s")}


def rows(rig: str, case: Case, seeds: range) -> Iterator[str]:
    """The rows of one experiment: what white noise assumed gives beside what the disturbance model gives."""
    white = campaign(rig, case, seeds, **WHITE)
    auto = campaign(rig, case, seeds)
    promise = promised(Laboratory(rig), case)
    title = f"{case.name} ({len(auto.values)})"
    for i, figure in enumerate(case.figures):
        factor, unit = UNITS[figure]

        def plain(value: float, factor: float = factor) -> str:
            return f"{factor * value:.3g}"

        cells = [
            title if i == 0 else "",
            f"{figure}, {unit}",
            f"{factor * auto.truth[i]:.4g}",
            plain(white.bias[i]),
            plain(white.spread[i]),
            covered(white, i),
            plain(auto.bias[i]),
            plain(auto.spread[i]),
            plain(auto.claimed[i]),
            covered(auto, i),
            f"{auto.spread[i] / auto.bound[i]:.2f}",
            f"{promise[i] / auto.spread[i]:.2f}",
        ]
        yield f"| {' | '.join(cells)} |"


def covered(outcome: Outcome, i: int) -> str:
    """Coverage in per cent with its binomial standard error."""
    share, count = float(outcome.coverage[i]), len(outcome.values)
    likely = (share * count + 1.0) / (count + 2.0)  # not 0 or 1, so that its error is not 0 either
    error = math.sqrt(likely * (1.0 - likely) / count)
    return f"{100.0 * share:.0f} +- {100.0 * error:.0f}"


def measured(rig: str, name: str, seeds: range) -> list[str]:
    """The rows of one experiment, said as they come: what one process does."""
    found = list(rows(rig, cases(load_rig(rig).snapshot())[name], seeds))
    sys.stderr.write(f"{rig}\n" + "".join(f"{row}\n" for row in found))
    return found


def table(seeds: range, only: Sequence[str], before: str, jobs: int) -> Iterator[str]:
    """The whole table, a rig after the other; of experiments that are not in `only` the rows that the page has."""
    asked = [(rig, name) for rig in NAMES for name in cases(load_rig(rig).snapshot())]
    asked = [one for one in asked if not only or "/".join(one) in only]
    with ProcessPoolExecutor(jobs) as pool:
        found = dict(zip(asked, pool.map(measured, *zip(*asked, strict=True), repeat(seeds)), strict=True))
    for rig in NAMES:
        _, _, kept = before.partition(f"**Rig `{rig}`**")
        yield from ("", f"**Rig `{rig}`**", "")
        yield f"| {' | '.join(HEADER)} |"
        yield f"|{'---|' * len(HEADER)}"
        for name, case in cases(load_rig(rig).snapshot()).items():
            yield from found[rig, name] if (rig, name) in found else _kept(kept, name, case)
    yield ""


def _kept(page: str, name: str, case: Case) -> Iterator[str]:
    """The rows of an experiment that the page has for the rig whose table begins it."""
    lines = page.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith(f"| {name} ("))
    yield from lines[first : first + len(case.figures)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--only", nargs="*", default=(), help="these experiments, as lab/doublet; the others stay")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    asked = parser.parse_args()
    rendered = list(table(range(1, asked.seeds + 1), asked.only, PAGE.read_text(encoding="utf-8"), asked.jobs))
    made = "\n".join(["<!-- measured: coverage -->", *rendered, "<!-- end -->"])
    PAGE.write_text(BLOCK.sub(lambda _: made, PAGE.read_text(encoding="utf-8")), encoding="utf-8")
