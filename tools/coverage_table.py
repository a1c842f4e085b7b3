"""Writes the coverage table in docs/explanation/identification.md: `python -m tools.coverage_table [--seeds 300]`.

It takes two hours of processor time, so no test makes it again; `make soak` checks what it shows. It stands between
`<!-- measured: coverage -->` and `<!-- end -->`. The rows are kept in out/coverage, so what was stopped goes on. The
same seeds give the same figures.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from twodof.campaign import campaign
from twodof.campaign.coverage import COLUMNS, FLOWN, IdentifiedByDefault, coverage, drawn_drones, failures
from twodof.rig.parameters import NAMES

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "explanation" / "identification.md"
BLOCK = re.compile(r"<!-- measured: coverage -->\n.*?<!-- end -->", re.DOTALL)
EXPERIMENTS = tuple(name for name in FLOWN if name != "position-sweep")
"""The sweep is not flown to identify from: it drifts for 25 s."""


def table(rig: str, seeds: int, processes: int | None) -> Iterator[str]:
    """The rows of one rig, and how many flights of an experiment were left out."""
    rows = []
    for name in EXPERIMENTS:
        file = ROOT / "out" / "coverage" / f"{rig} {name} {seeds}.jsonl"
        file.parent.mkdir(parents=True, exist_ok=True)
        runs = drawn_drones(rig, [name], range(1, seeds + 1))
        found = campaign(IdentifiedByDefault(rig), runs, file, name=f"{rig} {name}", processes=processes, say=say)
        for one in coverage(found):
            say(f"{rig} | {' | '.join(one.text)}")
        rows += found
    yield from ("", f"**Rig `{rig}`**", "", f"| {' | '.join(COLUMNS)} |", f"|{'---|' * len(COLUMNS)}")
    before = ""
    for one in coverage(rows):
        name, *cells = one.text
        yield f"| {' | '.join([name if name != before else '', *cells])} |"
        before = name
    left = [line.partition(",")[0] for line in failures(rows)]
    if left:
        counts = ", ".join(f"{left.count(name)} of {name}" for name in dict.fromkeys(left))
        yield from ("", f"Left out of {seeds}, because the pitch touched its stop: {counts}.")


def say(line: str) -> None:
    sys.stderr.write(f"{line}\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=300)
    parser.add_argument("--jobs", type=int, default=None, help="processes")
    asked = parser.parse_args()
    rendered = [line for rig in NAMES for line in table(rig, asked.seeds, asked.jobs)]
    made = "\n".join(["<!-- measured: coverage -->", *rendered, "", "<!-- end -->"])
    PAGE.write_text(BLOCK.sub(lambda _: made, PAGE.read_text(encoding="utf-8")), encoding="utf-8")
