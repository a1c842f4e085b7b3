"""Fixtures and hooks of all tests: the real flight logs, reproducible hypothesis runs, the tests' order and `--quick`.

Two marks divide the tests. `long` is a test that takes more than 1 s of processor time, or 5 s of time: `make test`
leaves it out and `make thorough` runs it. `slow` (`pytestmark = pytest.mark.slow`) is a file that takes more than .8 s,
or opens a browser: `make quick` leaves it out. `python -m tools.slow_tests` says where a mark is missing.
"""

import gc
import os
import re
import resource
import signal
from collections.abc import Generator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in `twodof`; before numpy is loaded

import pytest
from hypothesis import settings
from hypothesis.internal.conjecture.providers import HypothesisProvider
from hypothesis.internal.constants_ast import Constants

from twodof.flightlog.public_data import PUBLIC_LOGS, cache_folder

PROJECT = Path(__file__).resolve().parents[1]
SLOW_FILE = re.compile(r"^pytestmark = (?:\[\n *)?.*\bpytest\.mark\.slow\b", re.MULTILINE)
BEGAN = pytest.StashKey[float]()

# A shared, loaded machine must not turn a slow example into a failure; the same examples every run.
settings.register_profile("twodof", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("twodof")
# It also tries the numbers and words that stand in those modules of ours that are loaded: which these are depends on
# the tests that the same process has run before, and so would the examples (tests/test_same_examples.py).
HypothesisProvider._local_constants = Constants()

# Who starts a shell's job in the background, or by nohup, has Ctrl-C ignored in all that it starts, the programs here
# that are to be ended by it too.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def processor_time() -> float:
    """Return the processor time of this process and of the children that it has waited for [s]."""
    used = [resource.getrusage(processes) for processes in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option of `make quick`."""
    parser.addoption("--quick", action="store_true", help="leave out the files with the mark `slow`, unread")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With `--quick`, do not even import a slow file."""
    if config.getoption("--quick") and collection_path.suffix == ".py":
        return True if SLOW_FILE.search(collection_path.read_text(encoding="utf-8")) else None
    return None


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Begin to count a test's processor time."""
    item.stash[BEGAN] = processor_time()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Write each test's processor time into its report, so into `--junitxml` for tools/slow_tests.py."""
    report = yield
    if report.when == "teardown":
        report.user_properties.append(("processor_s", round(processor_time() - item.stash[BEGAN], 3)))
    return report


def in_browser(item: pytest.Item) -> bool:
    """Return True for a test that drives the page."""
    return "browser" in getattr(item, "fixturenames", ())


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put tests that wait for real time first, so that the others fill their time; then those in a browser.

    Each process of xdist begins with an equal part of the list, then takes work from the ends of the others' parts. The
    second one begins with all tests in a browser: the cheap tests are left to the end, and one browser and one
    laboratory serve all.
    """
    items.sort(key=lambda item: item.get_closest_marker("waits") is None)
    processes = getattr(config, "workerinput", {}).get("workercount", 1)
    if processes > 1:
        first = len(items) // processes
        fixtures = {item: getattr(item, "fixturenames", ()) for item in items}
        browsers = [item for item in items if in_browser(item) and not item.get_closest_marker("waits")]
        browsers.sort(key=lambda item: "shared_server" not in fixtures[item])
        rest = [item for item in items if item not in {*browsers}]
        items[:] = rest[:first] + browsers + rest[first:]


def pytest_collection_finish() -> None:
    """Keep the thousands of collected tests out of every later garbage collection."""
    gc.freeze()


@pytest.fixture(scope="session")
def log_folder() -> Path | None:
    """Folder of the seven real flight logs, or None where they are not at hand."""
    named = os.environ.get("TWODOF_FLIGHT_DATA")
    folders = [Path(named)] if named else [PROJECT / "../shared/flight-data", cache_folder()]
    there = (folder.resolve() for folder in folders if all((folder / f"{name}.mat").is_file() for name in PUBLIC_LOGS))
    return next(there, None)


@pytest.fixture(scope="session")
def flight_data(log_folder: Path | None) -> Path:
    """Folder of the seven real flight logs; skips, saying so, where they are not at hand."""
    if log_folder is None:
        pytest.skip("no real flight logs: fetch them by `twodof log fetch`, or set TWODOF_FLIGHT_DATA to their folder")
    return log_folder
