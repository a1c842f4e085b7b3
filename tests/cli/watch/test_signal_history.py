"""The last seconds of a signal: smallest and largest of each column, against a count by hand."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twodof.cli.watch.signal_history import SignalHistory
from twodof.signals import PERIOD


@given(
    st.lists(st.integers(1, 40), max_size=60),
    st.integers(1, 30),
    st.lists(st.floats(-100.0, 100.0), min_size=60, max_size=60),
)
def test_columns_are_those_counted_by_hand(steps: list[int], count: int, values: list[float]) -> None:
    """Ticks with gaps, in pieces; a column is [k, k + 1) of the window's parts."""
    ticks = np.cumsum(steps, dtype=np.int64)
    # All of it is in the window, so that what is held from before the window does not matter here.
    span = (int(ticks[-1]) + 1) if len(ticks) else 1
    history = SignalHistory(60 * 40 * PERIOD)
    for k, tick in enumerate(ticks):
        history.add(tick * PERIOD, values[k])
    # Edges in the middle between ticks: no sample is on one by rounding.
    low, high = history.columns(count, (span - 0.5) * PERIOD, span * PERIOD)
    held = float("nan")
    for k in range(count):
        edges = (k * span / count - 0.5, (k + 1) * span / count - 0.5)
        inside = [
            values[n]
            for n, tick in enumerate(ticks)
            if edges[0] <= tick < edges[1] and min(abs(edges[0] - tick), abs(edges[1] - tick)) > 1e-6
        ]
        if any(abs(edge - tick) < 1e-6 for edge in edges for tick in ticks):
            return  # which side a sample on an edge is on is not stated
        last = len(ticks) and ticks[-1] >= edges[0]
        expected = (min(inside), max(inside)) if inside else (held, held) if last else (np.nan, np.nan)
        np.testing.assert_equal((low[k], high[k]), expected)
        held = inside[-1] if inside else held


def test_it_keeps_the_window_and_no_more_memory() -> None:
    history = SignalHistory(1.0)
    for k in range(3000):
        history.add(k * PERIOD, float(k))
    low, high = history.columns(1, 2999 * PERIOD, 0.999)
    assert (low[0], high[0]) == (2750.0, 2999.0)
    assert len(history._time) == 2 * 251


def test_a_peak_of_one_sample_is_seen() -> None:
    history = SignalHistory(20.0)
    value = np.zeros(5000)
    value[2345] = 7.0
    history.add(np.arange(5000) * PERIOD, value)
    assert history.columns(60, 20.0, 20.0)[1].max() == 7.0


def test_no_number_is_no_sample_and_a_drone_that_began_anew_is_followed() -> None:
    history = SignalHistory(1.0)
    history.add([1.0, 1.004], [np.nan, 2.0])
    assert (history.latest, history.newest) == (2.0, 1.004)
    history.add(0.004, 5.0)
    low, _ = history.columns(4, 0.004, 0.016)
    assert history.latest == 5.0
    assert np.isnan(low[:3]).all()
    assert low[3] == 5.0


def test_nothing_is_known_of_an_empty_one() -> None:
    history = SignalHistory(1.0)
    assert history.latest is None
    assert np.isnan(history.columns(3, 0.0, 1.0)).all()
