"""Says which tests and files lack the mark `long` or `slow`, or have it in vain: `python -m tools.slow_tests REPORT`.

A REPORT is what `python -m pytest -n 2 --junitxml=REPORT` wrote on a quiet machine: of every test, or of a few files.
The cost of a fixture that several tests share counts for the first of them.
"""

import argparse
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from tests.conftest import PROJECT, SLOW_FILE

LONG_S, SLOW_S = 1.0, 0.8
"""Processor time of a test with the mark `long`, of a file with the mark `slow`."""
LONG_WAIT_S = 5.0
"""Time of a test with the mark `long`: browsers, servers and drones work in processes of their own."""
LONG_TEST = re.compile(r"@pytest\.mark\.long\n(?:[ @)\]].*\n)*?\s*(?:async )?def (\w+)")


def measured(report: Path) -> dict[Path, dict[str, float]]:
    """Return the processor time [s] of each test function of each file; of a parametrised one, of its longest case."""
    found: dict[Path, dict[str, float]] = defaultdict(dict)
    for case in ElementTree.parse(report).iter("testcase"):
        parts = case.get("classname", "").split(".")
        paths = (PROJECT.joinpath(*parts[:n]).with_suffix(".py") for n in range(len(parts), 0, -1))
        file = next((path for path in paths if path.is_file()), None)
        if file:
            seconds = sum(float(p.get("value", "0")) for p in case.iter("property") if p.get("name") == "processor_s")
            seconds = max(seconds, float(case.get("time", "0")) * LONG_S / LONG_WAIT_S)
            name = case.get("name", "").partition("[")[0]
            found[file][name] = max(seconds, found[file].get(name, 0.0))
    return found


def remarks(times: dict[Path, dict[str, float]]) -> Iterator[str]:
    """Yield a line for each mark that is missing, or that costs twice less than it should."""
    for path, tests in sorted(times.items()):
        text, name = path.read_text(encoding="utf-8"), path.relative_to(PROJECT)
        total, slow = sum(tests.values()), SLOW_FILE.search(text) is not None
        if total > SLOW_S and not slow:
            yield f"{name}: {total:.1f} s: add `pytestmark = pytest.mark.slow`"
        elif total < SLOW_S / 2 and slow and "open_page" not in text:
            yield f"{name}: {total:.1f} s: `pytestmark = pytest.mark.slow` may go"
        long = set(LONG_TEST.findall(text))
        for test, seconds in tests.items():
            if seconds > LONG_S and test not in long:
                yield f"{name}::{test}: {seconds:.1f} s: add `@pytest.mark.long`"
            elif seconds < LONG_S / 2 and test in long:
                yield f"{name}::{test}: {seconds:.1f} s: `@pytest.mark.long` may go"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("report", type=Path)
    for line in remarks(measured(parser.parse_args().report)):
        sys.stdout.write(f"{line}\n")
