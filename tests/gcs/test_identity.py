"""What a client calls itself: a number that no other client on this computer has."""

import subprocess
import sys

import pytest

from twodof.gcs import identity

TWO = (1001, 1002)  # none that a drone of another test may have meanwhile
ANOTHER = f"""
import sys
from twodof.gcs import identity
identity.OWN_SYSTEMS = {TWO}
print(identity.drawn(), flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="numbers are kept apart on Linux only")
def test_the_number_of_a_client_is_drawn_by_no_other_until_it_has_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identity, "OWN_SYSTEMS", TWO)
    other = subprocess.Popen([sys.executable, "-c", ANOTHER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with other:
        assert other.stdout is not None
        theirs = int(other.stdout.readline())
        for _ in range(8):
            ours = identity.drawn()
            assert ours != theirs
            identity.give_back(ours)
        other.kill()
    both = {identity.drawn(), identity.drawn()}
    for number in both:
        identity.give_back(number)
    assert both == set(TWO)
