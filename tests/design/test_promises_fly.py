"""Designs on random members of identified families, flown on the noisy rig: how many promises hold."""

import pytest

from tools.promises import designed, shares

pytestmark = pytest.mark.slow


@pytest.mark.soak
def test_promises_hold_on_the_noisy_rig() -> None:
    found = shares(designed(200, 1000, seed=2), 2000, flights=5)
    # 95 % of 1,000 flights is 950 +- 6.9. One flight of each design tells it to +- 1.5 % only: there .895 came once in
    # eleven times. 90 to 98 % is what is asked.
    assert all(0.92 <= share <= 0.98 for share in found.values()), found


@pytest.mark.long
def test_promises_of_few_designs_hold() -> None:
    """A small part of the long test: 8 designs, 25 flights of each."""
    found = shares(designed(8, 400, seed=3) * 25, 3000)
    # 190 of 200, +- 3.1 by chance. 8 members and bands of 200 members each add 1 % and .5 %: three times the root of
    # the sum of squares is 6 %.
    assert all(share >= 0.89 for share in found.values()), found
    assert min(found.values()) < 1.0
