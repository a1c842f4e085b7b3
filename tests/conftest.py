"""What every test may ask for: the real flight logs, and hypothesis runs that give the same examples twice. It sets the
tests' order; `--quick`, which leaves out the files of tests/slow.txt; `--brief` and `--long`, which divide the tests by
tests/long.txt.
"""

import gc
import os
import resource
import signal
from collections import Counter
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis.internal.conjecture.providers import HypothesisProvider
from hypothesis.internal.constants_ast import Constants

PROJECT = Path(__file__).resolve().parents[1]
SLOW, LONG = (Path(__file__).with_name(name) for name in ("slow.txt", "long.txt"))
QUICK_S, BRIEF_S, FOR_NOISE = 0.8, 1.0, 10.0
"""So much processor time takes a file at most with `--quick`, a test with `--brief`; on a loaded machine more."""
SLOW_FILES = pytest.StashKey[dict[Path, float]]()
LONG_TESTS = pytest.StashKey[dict[str, float]]()
SPENT = pytest.StashKey[Counter[Path]]()
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
    """Of this process and of the children that it has waited for [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def slow_files() -> dict[Path, float]:
    """The files that `--quick` leaves out, and the processor time [s] that each takes."""
    return {PROJECT / file: seconds for file, seconds in _measured(SLOW)}


def long_tests() -> dict[str, float]:
    """The tests that `--brief` leaves out, and the processor time [s] that each takes."""
    return dict(_measured(LONG))


def _measured(path: Path) -> Iterator[tuple[str, float]]:
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            seconds, _, what = line.partition(" ")
            yield what, float(seconds)


def pytest_addoption(parser: pytest.Parser) -> None:
    """What `make quick`, `make test` and `make thorough` ask for."""
    parser.addoption("--quick", action="store_true", help="leave out the files that tests/slow.txt names")
    parser.addoption("--brief", action="store_true", help="leave out the tests that tests/long.txt names")
    parser.addoption("--long", action="store_true", help="run the tests that tests/long.txt names, and no others")


def pytest_configure(config: pytest.Config) -> None:
    """Reads the lists once."""
    config.stash[SLOW_FILES] = slow_files() if config.getoption("--quick") else {}
    config.stash[LONG_TESTS] = long_tests() if config.getoption("--brief") or config.getoption("--long") else {}
    config.stash[SPENT] = Counter()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With `--quick` a slow file is not even imported."""
    return True if collection_path in config.stash[SLOW_FILES] else None


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """From here on a test's processor time counts."""
    item.stash[BEGAN] = processor_time()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Each test's processor time is in its report, and in `--junitxml`, from which tools/slow_tests.py makes the list.

    A test with which its file takes too long for `--quick`, or that takes too long itself for `--brief`, fails: so the
    lists stay true.
    """
    report = yield
    if report.when != "teardown":
        return report
    took = processor_time() - item.stash[BEGAN]
    report.user_properties.append(("processor_s", round(took, 3)))
    spent = item.config.stash[SPENT]
    spent[item.path] += took
    file, told = item.path.relative_to(PROJECT), ""
    if item.config.getoption("--quick") and spent[item.path] > QUICK_S * FOR_NOISE:
        told = f"{file} took {spent[item.path]:.1f} s: make it cheaper or name it in tests/slow.txt"
        spent[item.path] = 0.0
    elif item.config.getoption("--brief") and took > BRIEF_S * FOR_NOISE and not in_browser(item):
        told = f"{item.nodeid} took {took:.1f} s: make it cheaper or name it in tests/long.txt"
    if told and report.passed:
        report.outcome, report.longrepr = "failed", told
    return report


def in_browser(item: pytest.Item) -> bool:
    """Whether a test drives the page, which counts the life of a browser that others used, too."""
    return "browser" in getattr(item, "fixturenames", ())


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """What waits for real time to pass comes first, so that the others fill its time.

    What a browser does is the dearest. The processes of xdist take equal parts of the list, and then from each other's
    ends. So the second one begins with it: what is left to the end is cheap, and one browser and one laboratory do.
    """
    if config.getoption("--brief") or config.getoption("--long"):
        long, wanted = config.stash[LONG_TESTS], bool(config.getoption("--long"))
        config.hook.pytest_deselected(items=[item for item in items if (item.nodeid in long) is not wanted])
        items[:] = [item for item in items if (item.nodeid in long) is wanted]
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
    """What stands now stays to the end: thousands of tests, which every full collection would look through again."""
    gc.freeze()


@pytest.fixture(scope="session")
def flight_data() -> Path:
    """Folder of the seven real flight logs; skips, saying so, where it is not at hand."""
    folder = Path(os.environ.get("TWODOF_FLIGHT_DATA", PROJECT / "../shared/flight-data"))
    if not folder.is_dir():
        pytest.skip(f"no flight logs in {folder}: set TWODOF_FLIGHT_DATA to the folder that holds them")
    return folder
