"""Records: what grid they choose, what they hold, and what they refuse."""

import numpy as np
import pytest

from twodof.errors import IdentificationError
from twodof.identify.record import Record

T = 0.004 * np.arange(100)


def test_a_uniform_table_is_taken_as_it_is() -> None:
    record = Record.from_columns(T + 7.0, {"u": T, "y": 2.0 * T}, ["u"], ["y"])
    assert record.dt == 0.004
    assert record.start == 7.0
    assert (record.inputs["u"] == T).all()
    assert record.outputs["y"].on_grid
    assert (record.outputs["y"].value == 2.0 * T).all()


def test_jitter_and_gaps_do_not_move_the_grid() -> None:
    rng = np.random.default_rng(0)
    period = 0.0040037
    stamps = 100.0 + period * np.arange(500) + rng.uniform(-1e-4, 1e-4, 500)
    lost = np.ones(500, dtype=bool)
    lost[[50, 51, 200, 333]] = False
    u = np.floor(np.arange(500) / 100.0)
    record = Record.from_channels({"u": (stamps[lost], u[lost]), "y": (stamps, u)}, ["u"], ["y"])
    # The fitted period's error: jitter over the length, 1e-4 / (sqrt(3 * 500) * 250 / 2) and some.
    assert record.dt == pytest.approx(period, abs=5e-8)
    assert record.steps == 500
    held = u.copy()
    held[[50, 51, 200, 333]] = u[[49, 49, 199, 332]]
    assert (record.inputs["u"] == held).all()


def test_records_are_cut_at_gaps_of_inputs() -> None:
    kept = np.ones(100, dtype=bool)
    kept[30:36] = False  # six samples of u: lost from T[29] to T[36]
    kept[60] = False  # a single one does little harm
    other = np.ones(100, dtype=bool)
    other[34:44] = False
    channels = {"u": (T[kept], T[kept]), "w": (T[other], T[other]), "y": (T, T)}
    record = Record.from_channels(channels, ["u", "w"], ["y"])
    assert record.gaps == {"u": ((T[29], T[36]),), "w": ((T[33], T[44]),)}
    first, second = record.pieces()
    # Only what was applied for certain, and what was measured meanwhile.
    assert first.time == pytest.approx(T[:30])
    assert second.time == pytest.approx(T[44:])
    assert second.outputs["y"].value == pytest.approx(T[44:])
    assert not first.gaps
    assert not second.gaps
    assert Record.from_columns(T, {"u": T, "y": T}, ["u"], ["y"]).pieces()[0].steps == 100
    # A gap may reach over the edges of a window, or last until the end.
    channels |= {"v": (T, T), "ends": (T[:61], T[:61])}
    later = Record.from_channels(channels, ["v", "u", "ends"], ["y"], start=float(T[32]), stop=float(T[90]))
    assert later.gaps == {"u": ((T[32], T[36]),), "ends": ((T[60], T[90]),)}
    sooner = Record.from_channels(channels, ["v", "u"], ["y"], stop=float(T[33]))
    assert sooner.gaps == {"u": ((T[29], T[33]),)}
    edge = Record.from_channels(channels, ["u"], ["y"], start=float(T[32]))  # its own clock begins behind the gap
    assert not edge.gaps
    # A channel of events has no rhythm to miss.
    events = np.sort(np.random.default_rng(1).uniform(0.0, 0.39, 40))
    whole = Record.from_channels(
        {"u": (T, T), "e": (np.r_[0.0, events], np.r_[0.0, events]), "y": (T, T)}, ["u", "e"], ["y"]
    )
    assert not whole.gaps


def test_slow_inputs_are_held_and_smooth_ones_interpolated() -> None:
    slow = T[::5]
    record = Record.from_channels(
        {"u": (T, T), "slow": (slow, slow), "y": (T, T)}, ["u", "slow"], ["y"], start=0.1, stop=0.3
    )
    assert np.allclose(record.inputs["slow"], np.floor((record.time + 1e-9) / 0.02) * 0.02, atol=1e-12)
    table = {"u": T, "theta": T**2, "y": T}
    smooth = Record.from_columns(T, table, ["u", "theta"], ["y"], smooth=["theta"])
    assert np.allclose(smooth.inputs["theta"], np.interp(T + 0.002, T, T**2), atol=1e-12)
    assert (smooth.inputs["u"] == T).all()
    with pytest.raises(IdentificationError, match="'v' is named in `smooth`, but it is not an input"):
        Record.from_columns(T, table, ["u"], ["y"], smooth=["v"])


def test_outputs_keep_their_own_stamps() -> None:
    tof = np.arange(0.011, 0.39, 0.0545)
    record = Record.from_channels({"u": (T, T), "y": (tof, np.sin(tof))}, ["u"], ["y"])
    assert np.allclose(record.output_time("y"), tof, atol=1e-12)
    assert not record.outputs["y"].on_grid


def test_a_part_keeps_the_time_axis() -> None:
    record = Record.from_columns(T, {"u": T, "y": T}, ["u"], ["y"]).part(0.1, 0.2)
    assert record.start == pytest.approx(0.1)
    assert record.steps == 26
    assert np.allclose(record.output_time("y"), record.outputs["y"].value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"u": None}, "channel 'u': it is not there.*present are: y"),
        ({"y": (T, np.where(T[7] == T, np.nan, T))}, "channel 'y': sample 7, nan at 0.028 s, is not finite"),
        ({"u": (np.where(T[7] == T, np.nan, T), T)}, "channel 'u': sample 7, 0.028 at nan s, is not finite"),
        ({"u": (T[[0, 1, 3, 2]], T[:4])}, "channel 'u': time does not increase at sample 3"),
        ({"u": (T[[0, 1, 1, 2]], T[:4])}, "does not increase"),
        ({"u": (T, T[:-1])}, "not two equal columns"),
        ({"y": (T + 100.0, T)}, "channel 'y': the window -inf to inf s holds 0 samples"),
    ],
)
def test_bad_channels_are_refused_by_name(change: dict[str, object], said: str) -> None:
    channels = {"u": (T, T), "y": (T, T), **change}
    present = {name: value for name, value in channels.items() if value is not None}
    with pytest.raises(IdentificationError, match=said):
        Record.from_channels(present, ["u"], ["y"])


def test_an_empty_window_says_what_there_is() -> None:
    with pytest.raises(IdentificationError, match=r"window 5 to 6 s holds 0 samples.*spans 0 to 0.396 s"):
        Record.from_channels({"u": (T, T), "y": (T, T)}, ["u"], ["y"], start=5.0, stop=6.0)
    with pytest.raises(IdentificationError, match="holds 0 samples"):
        Record.from_columns(T, {"u": T, "y": T}, ["u"], ["y"]).part(5.0, 6.0)
    with pytest.raises(IdentificationError, match="no input or no output"):
        Record.from_columns(T, {"u": T}, ["u"], [])


def test_a_window_before_an_input_is_refused() -> None:
    with pytest.raises(IdentificationError, match="channel 'late': no sample at or before"):
        Record.from_channels({"u": (T, T), "late": (T + 0.1, T), "y": (T, T)}, ["u", "late"], ["y"])


def test_two_stamps_close_together_are_not_the_step() -> None:
    """Whole milliseconds, 20 +- 8 ms apart, and two of them 1 ms apart."""
    ticks = 20.0 * np.arange(400) + np.random.default_rng(5).integers(-4, 5, 400)
    ticks[200] = ticks[199] + 1.0
    record = Record.from_columns(1e-3 * ticks, {"u": ticks, "y": ticks}, ["u"], ["y"])
    assert record.dt == pytest.approx(0.02, rel=1e-3)  # the stamps' jitter over 8 s is .5 in 1,000 of a step
    assert not record.gaps
