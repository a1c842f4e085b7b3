"""What every test may ask for: the real flight logs; hypothesis runs that give the same examples twice; their order."""

import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis.internal.conjecture.providers import HypothesisProvider
from hypothesis.internal.constants_ast import Constants

PROJECT = Path(__file__).resolve().parents[1]

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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What waits for real time to pass comes first, so that the others fill its time."""
    items.sort(key=lambda item: item.get_closest_marker("waits") is None)


@pytest.fixture(scope="session")
def flight_data() -> Path:
    """Folder of the seven real flight logs; skips, saying so, where it is not at hand."""
    folder = Path(os.environ.get("TWODOF_FLIGHT_DATA", PROJECT / "../shared/flight-data"))
    if not folder.is_dir():
        pytest.skip(f"no flight logs in {folder}: set TWODOF_FLIGHT_DATA to the folder that holds them")
    return folder
