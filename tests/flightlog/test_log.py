"""A channel refuses what is not a signal; pairing, slicing and gaps agree with their definitions."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.flightlog.synthetic import attitude_steps, channel
from twodof.errors import LogError
from twodof.flightlog.log import Channel, FlightLog, log_of_rows

pytestmark = pytest.mark.slow

# Multiples of 1/64 s: exact in binary, so that the brute-force comparison needs no tolerance.
STAMPS = st.lists(st.integers(0, 400), min_size=1, max_size=30, unique=True).map(
    lambda ticks: np.array(sorted(ticks)) / 64.0
)
TIMES = st.lists(st.integers(-10, 410), min_size=1, max_size=20).map(lambda ticks: np.array(ticks) / 64.0)


@pytest.mark.parametrize(
    ("time", "value", "says"),
    [
        ([0.0, 1.0, 1.0], [1, 2, 3], "q: time does not increase: sample 2 at 1.0 s follows 1.0 s"),
        ([0.0, 2.0, 1.0], [1, 2, 3], "q: time does not increase: sample 2 at 1.0 s follows 2.0 s"),
        ([0.0, 1.0], [1.0, np.nan], "q: value is nan at sample 1 (time 1.0 s), 1 sample is like this"),
        ([0.0, 1.0], [np.inf, -np.inf], "q: value is inf at sample 0 (time 0.0 s), 2 samples are like this"),
        ([0.0, np.nan], [1.0, 2.0], "q: time is nan at sample 1"),
        ([0.0, 1.0], [1.0], "q: shapes do not match: time (2,), value (1,)"),
        ([[0.0], [1.0]], [1.0, 2.0], "q: shapes do not match"),
        ([0.0, 1.0], ["a", "b"], "q.value: not real numbers"),
        ([0.0, 1.0], [1.0, 1j], "q.value: not real numbers: complex"),
    ],
)
def test_channel_refuses_and_says_where(time: list, value: list, says: str) -> None:
    with pytest.raises(LogError) as caught:
        Channel(time, value, "rad/s", name="q")
    assert says in str(caught.value)


def test_channel_is_a_read_only_copy() -> None:
    value = np.zeros(3)
    channel = Channel(np.arange(3.0), value)
    value[0] = 7.0
    assert channel.value[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        channel.value[0] = 1.0


def test_missing_channel_names_what_there_is() -> None:
    log = FlightLog({"q": Channel([0.0], [1.0]), "theta": Channel([0.0], [1.0])})
    with pytest.raises(LogError, match=r"no channel 'M' .the log has: q, theta"):
        log["M"]
    with pytest.raises(LogError, match="no field 'M'"):
        log["q"].field("M")
    with pytest.raises(LogError, match="at least one channel"):
        FlightLog({})
    with pytest.raises(LogError, match="no channel holds a sample"):
        FlightLog({"q": Channel([], [])}).slice(0.0, 1.0)


@given(STAMPS, TIMES)
def test_pairing_is_what_its_name_says(stamps: np.ndarray, times: np.ndarray) -> None:
    channel = Channel(stamps, np.arange(len(stamps)))
    for t, hold, after in zip(times, channel.index(times), channel.index(times, "next"), strict=True):
        before = [k for k in range(len(stamps)) if stamps[k] <= t]
        later = [k for k in range(len(stamps)) if stamps[k] >= t]
        assert hold == (before[-1] if before else -1)
        assert after == (later[0] if later else -1)


def test_resample_extrapolates_nothing() -> None:
    log = FlightLog({"x": Channel([1.0, 2.0, 3.0], [5.0, 6.0, 7.0], "m")}, {"file": {"name": "a.mat"}})
    with pytest.raises(LogError, match=r"a\.mat: x: no sample for t = 0\.9 s .* spans 1\.0 to 3\.0 s"):
        log.resample("x", [0.9])
    assert log.resample("x", [1.0, 2.9, 3.1]).tolist() == [5.0, 6.0, 7.0]
    with pytest.raises(LogError, match="time is nan"):
        log.resample("x", [np.nan])


@given(STAMPS, st.integers(-5, 405), st.integers(1, 100))
def test_slice_keeps_both_ends(stamps: np.ndarray, start: int, length: int) -> None:
    t0, t1 = start / 64.0, (start + length) / 64.0
    inside = stamps[(stamps >= t0) & (stamps <= t1)]
    log = FlightLog({"q": Channel(stamps, stamps), "lmnf": Channel([], np.empty((0, 5)))})
    if inside.size:
        assert log.slice(t0, t1)["q"].time.tolist() == inside.tolist()
        assert len(log.slice(t0, t1)["lmnf"]) == 0
    else:
        with pytest.raises(LogError, match="no sample between"):
            log.slice(t0, t1)


@pytest.mark.parametrize(("t0", "t1"), [(1.0, 1.0), (2.0, 1.0), (np.nan, 1.0), (0.0, np.nan)])
def test_slice_refuses_an_empty_window(t0: float, t1: float) -> None:
    with pytest.raises(LogError, match="is empty"):
        attitude_steps().slice(t0, t1)


@given(st.sets(st.integers(1, 98), max_size=8))
def test_gaps_are_exactly_the_samples_taken_out(lost: set[int]) -> None:
    kept = np.array([k for k in range(100) if k not in lost])
    random = np.random.default_rng(0)
    # The drone's own jitter on x: 9 to 13 ms where 10 ms is the mean.
    jitter = random.uniform(-0.001, 0.003, 100)
    log = FlightLog({"x": channel("x", (0.010 * np.arange(100) + jitter)[kept], kept.astype(float))})
    gaps = log.gaps("x")
    expected = [(a, b) for a, b in pairwise(kept) if b > a + 1]
    assert len(gaps) == len(expected)
    assert sum(gap.missing for gap in gaps) == len(lost)
    assert not any(gap.armed for gap in gaps)


def test_gaps_say_whether_they_were_armed() -> None:
    log = attitude_steps()
    q = log["q"]
    cut = (q.time - 100.0 < 0.5) | (q.time - 100.0 > 0.52)
    cut &= (q.time - 100.0 < 2.5) | (q.time - 100.0 > 2.54)
    holed = FlightLog({**log.channels, "q": channel("q", q.time[cut], q.value[cut])})
    assert [(gap.missing, gap.armed) for gap in holed.gaps("q")] == [(5, False), (10, True)]
    assert holed.gaps("q")[1].t0 == pytest.approx(102.5, abs=0.004)
    assert log.gaps("q") == []
    assert log.gaps("lmnf") == []


def test_armed_is_first_to_last_sample_with_thrust() -> None:
    thrust = [0.0, 0.4, 0.4, 0.0, 0.0, 0.3]
    log = FlightLog({"T": Channel(np.arange(6.0), thrust)})
    assert log.armed() == [(1.0, 2.0), (5.0, 5.0)]
    with pytest.raises(LogError, match="no channel 'T'"):
        FlightLog({"q": Channel([0.0], [0.0])}).armed()


def test_rows_of_a_plot_become_channels() -> None:
    time = np.arange(4) * 0.004
    theta, x = np.array([1, 2, 3, 4], "<f4"), np.array([np.nan, 5, np.nan, 6], "<f4")
    data = time.astype("<f8").tobytes() + theta.tobytes() + x.tobytes()
    log = log_of_rows(data, ["estimate.theta", "estimate.x"], {"seed": 1})
    assert log["theta"].value.tolist() == [1, 2, 3, 4]
    assert log["theta"].unit == "rad"
    assert log["x"].time.tolist() == [0.004, 0.012]
    assert log["x"].value.tolist() == [5, 6]


@pytest.mark.parametrize(
    ("data", "columns", "what"),
    [
        (b"", ["estimate.theta"], "whole rows"),
        (b"\0" * 13, ["estimate.theta"], "whole rows"),
        (b"\0" * 12, [], "give one"),
        (b"\0" * 16, ["estimate.theta", "estimate.theta"], "each once"),
        (b"\0" * 12, ["estimate.thrust"], "no column"),
        (b"\0" * 12, ["imu.gyro_y"], "no column"),
        (b"\0" * 24, ["estimate.theta"], "does not rise"),
        (b"\xff" * 12, ["estimate.theta"], "not finite"),
    ],
)
def test_rows_that_are_no_log_are_refused(data: bytes, columns: list[str], what: str) -> None:
    with pytest.raises(LogError, match=what):
        log_of_rows(data, columns, {})
