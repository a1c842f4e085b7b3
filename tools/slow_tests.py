"""Writes tests/slow.txt and tests/long.txt, which divide the tests: `python -m tools.slow_tests REPORT...`.

A REPORT is what `python -m pytest -n 2 --junitxml=REPORT` wrote on a quiet machine. The first is of every test. What
several tests share counts for the first of them, so a second one is of those that are left (`--brief`): the larger time
of a test counts. A room of tests whose files are all slow keeps its cheapest one, if that takes no more than twice what
is allowed. The processor time of a browser counts for the test that ends it. So each file that drives the page is slow.
None of tests/web is long: `make test` shows that the page works.
"""

import argparse
import xml.etree.ElementTree as ElementTree
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath

from tests.conftest import BRIEF_S, LONG, PROJECT, QUICK_S, SLOW


def tests(report: Path) -> Iterator[tuple[PurePosixPath, str, float]]:
    """The file, the name within it and the processor time [s] of each test in a report. Raises ParseError."""
    for case in ElementTree.parse(report).iter("testcase"):
        parts = case.get("classname", "").split(".")
        last = next(
            (n for n in range(len(parts), 0, -1) if PROJECT.joinpath(*parts[:n]).with_suffix(".py").is_file()), 0
        )
        if last:
            seconds = sum(float(p.get("value", "0")) for p in case.iter("property") if p.get("name") == "processor_s")
            yield (
                PurePosixPath(*parts[:last]).with_suffix(".py"),
                "::".join([*parts[last:], case.get("name", "")]),
                seconds,
            )


def slow(times: Mapping[PurePosixPath, float]) -> list[PurePosixPath]:
    """The files that are left out: those over `QUICK_S`, but the cheapest of a room that would have none, if it may."""
    rooms: dict[str, list[PurePosixPath]] = defaultdict(list)
    for file in times:
        rooms[file.parts[1]].append(file)
    found = {file for file, seconds in times.items() if seconds > QUICK_S or drives_page(file)}
    for room, files in rooms.items():
        if (PROJECT / "tests" / room).is_dir() and found.issuperset(files):
            cheapest = min(files, key=times.__getitem__)
            found -= {cheapest} if times[cheapest] < 2.0 * QUICK_S else set()
    return sorted(found, key=lambda file: file.as_posix())


def drives_page(file: PurePosixPath) -> bool:
    """Whether a file of tests opens the page in a browser."""
    return "open_page" in (PROJECT / file).read_text(encoding="utf-8")


def write(path: Path, rows: Iterator[str]) -> None:
    """The list anew, below what its first line says of it."""
    first = path.read_text(encoding="utf-8").splitlines()[0]
    path.write_text("\n".join([first, *rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reports", type=Path, nargs="+")
    found: dict[tuple[str, str], float] = {}
    for report in parser.parse_args().reports:
        for file, name, seconds in tests(report):
            found[file.as_posix(), name] = max(seconds, found.get((file.as_posix(), name), 0.0))
    times: Counter[PurePosixPath] = Counter()
    for (path, _), seconds in found.items():
        times[PurePosixPath(path)] += seconds
    write(SLOW, (f"{times[file]:.1f} {file}" for file in slow(times)))
    long = sorted(one for one, seconds in found.items() if seconds > BRIEF_S and not one[0].startswith("tests/web/"))
    write(LONG, (f"{found[path, name]:.1f} {path}::{name}" for path, name in long))
