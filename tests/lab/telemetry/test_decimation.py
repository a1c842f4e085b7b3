"""Decimation keeps what a plot must show: each bucket's extremes, each in its time, however the rows come in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twodof.lab.telemetry_rows import Decimation

RATES = st.sampled_from([0.5, 1.0, 7.0, 20.0, 50.0, 60.0, 125.0, 200.0, 249.0])
VALUES = st.lists(
    st.tuples(*[st.one_of(st.floats(-100, 100, width=32), st.just(float("nan")))] * 2), min_size=1, max_size=400
)


@given(VALUES, RATES, st.lists(st.integers(1, 40), min_size=1, max_size=10))
def test_each_bucket_has_its_minimum_and_maximum_and_never_more_rows_than_asked_for(
    values: list[tuple[float, float]], rate: float, pieces: list[int]
) -> None:
    decimation = Decimation(rate)
    rows = np.array(values, dtype=np.float32)
    ticks = np.arange(len(rows), dtype=np.int64)
    times, kept = [], []
    at, turn = 0, 0
    while at < len(rows):
        size = pieces[turn % len(pieces)]
        found = decimation.take(ticks[at : at + size], rows[at : at + size])
        times.append(found[0])
        kept.append(found[1])
        at, turn = at + size, turn + 1
    given_times, given_rows = np.concatenate(times), np.concatenate(kept)
    whole = (len(rows) - 1) // decimation.ticks  # the last bucket is whole once another begins
    assert len(given_rows) == 2 * whole
    assert 2 / (decimation.ticks * 0.004) <= rate * (1 + 1e-12)
    assert (np.diff(given_times) >= 0).all()
    for bucket in range(whole):
        inside = rows[bucket * decimation.ticks : (bucket + 1) * decimation.ticks]
        pair = given_rows[2 * bucket : 2 * bucket + 2]
        for column in range(2):
            seen = inside[:, column][~np.isnan(inside[:, column])]
            if not len(seen):
                assert np.isnan(pair[:, column]).all()
                continue
            assert {float(pair[0, column]), float(pair[1, column])} == {float(seen.min()), float(seen.max())}
            places = [int(np.flatnonzero(inside[:, column] == one)[0]) for one in pair[:, column]]
            assert places == sorted(places)  # a rise is drawn as a rise


@pytest.mark.parametrize("rate", [250.0, 1000.0])
def test_the_full_rate_leaves_nothing_out(rate: float) -> None:
    ticks = np.arange(100, dtype=np.int64)
    rows = np.random.default_rng(1).normal(size=(100, 3)).astype(np.float32)
    times, kept = Decimation(rate).take(ticks, rows)
    assert np.array_equal(times, 10.0 + ticks * 0.004)  # as its logs count, from 10 s on
    assert np.array_equal(kept, rows)
