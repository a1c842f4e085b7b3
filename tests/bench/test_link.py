"""The benchmark of the wire measures answers that came."""

import asyncio
import time

from bench.stack import link


def test_every_round_trip_is_answered() -> None:
    for signed in (False, True):
        taken = asyncio.run(link.round_trips(50, signed))
        assert len(taken) == 50
        assert taken == sorted(taken)
        assert taken[0] > 0.0
    assert asyncio.run(link.lockstep_seconds(50)) > 0.0


def test_the_dialect_s_load_is_timed() -> None:
    start = time.perf_counter()
    load = link.load_seconds("twodof.link.mavlink import dialect", "dialect.load()", 1)
    assert 0.0 < load < time.perf_counter() - start  # a part of what its process took
