"""Which sample the controller had in its hands, and where a loop, not a message, made a signal."""

import numpy as np
import pytest

from twodof.errors import LogError
from twodof.flightlog.log import Channel, FlightLog
from twodof.sim.time_alignment import align_log, driven, runs


def test_a_loop_moves_at_each_step_and_a_message_stands_still_between() -> None:
    rng = np.random.default_rng(1)
    loop = rng.standard_normal(200)
    message = np.repeat(rng.standard_normal(40), 5)
    found = driven(np.concatenate([message, loop, message]))
    assert runs(found) == [(200, 400)]


def test_a_loop_that_reads_at_100_hz_is_a_loop() -> None:
    at_100_hz = np.repeat(np.random.default_rng(2).standard_normal(200), np.tile([2, 3], 100))
    assert driven(at_100_hz).mean() > 0.98


def test_a_loop_may_stand_still_for_two_steps_and_lasts_25() -> None:
    loop = np.random.default_rng(3).standard_normal(60)
    # Of a value that stands still the first step may be the message's, unless the log ends with it.
    assert [driven(np.append(loop, np.full(n, 9.0))).sum() for n in range(1, 6)] == [61, 61, 61, 60, 60]
    assert [driven(np.append(loop[:n], np.full(9, 9.0))).sum() for n in (25, 26)] == [0, 26]


def test_a_constant_is_no_loop() -> None:
    assert not driven(np.full(100, 0.4)).any()


def _channels(n: int = 100) -> dict[str, Channel]:
    t = 10.0 + 0.004 * np.arange(n)
    k = np.arange(n, dtype=float)
    return {
        "M": Channel(t, k),
        **{name: Channel(t + 8e-6, k) for name in ("q0", "theta0", "v0")},
        "T": Channel(t, np.full(n, 0.4)),
        "q": Channel(t - 0.4e-3, k),
        "theta": Channel(t + 0.3e-3, k),
        "v": Channel(t[::5] + 1e-3, k[::5]),
    }


def test_set_points_pair_ahead_and_measurements_behind() -> None:
    paired = align_log(FlightLog(_channels()))
    k = np.arange(100.0)
    np.testing.assert_array_equal(paired.value["q0"], k)
    np.testing.assert_array_equal(paired.value["q"], k)
    # The pitch stamped .3 ms after M is the next step's.
    np.testing.assert_array_equal(paired.value["theta"][1:], k[:-1])
    lost = {name: np.flatnonzero(flags).tolist() for name, flags in paired.lost.items() if flags.any()}
    assert lost == {"theta": [0], "v": [0]}
    np.testing.assert_array_equal(paired.value["v"][1:], 5.0 * ((np.arange(1, 100) - 1) // 5))


@pytest.mark.parametrize("name", ["q", "theta", "q0", "v0"])
def test_a_sample_that_is_missing_is_lost_at_its_step_alone(name: str) -> None:
    channels = _channels()
    whole = channels[name]
    channels[name] = Channel(np.delete(whole.time, 50), np.delete(whole.value, 50))
    lost = align_log(FlightLog(channels)).lost[name]
    step = 51 if name == "theta" else 50
    assert runs(lost[10:-10]) == [(step - 10, step - 9)]


def test_a_missing_step_and_a_missing_slow_sample_are_lost() -> None:
    channels = _channels()
    channels["M"] = Channel(np.delete(channels["M"].time, 40), np.delete(channels["M"].value, 40))
    channels["v"] = Channel(np.delete(channels["v"].time, 10), np.delete(channels["v"].value, 10))
    paired = align_log(FlightLog(channels))
    assert np.flatnonzero(paired.lost["M"]).tolist() == [40]
    # The sample of step 50 is first read at step 51; the next one, of step 55, at step 56. One step less in the grid.
    assert runs(paired.lost["v"][1:95]) == [(49, 54)]


def test_a_log_without_a_channel_is_refused() -> None:
    channels = _channels()
    del channels["theta0"]
    with pytest.raises(LogError, match="theta0"):
        align_log(FlightLog(channels))


def test_a_channel_of_one_sample_is_refused() -> None:
    channels = _channels()
    channels["v"] = Channel(channels["v"].time[:1], channels["v"].value[:1])
    with pytest.raises(LogError, match="v: "):
        align_log(FlightLog(channels))
