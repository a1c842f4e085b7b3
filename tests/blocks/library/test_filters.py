"""Filters set by physical parameters against scipy.signal's designs of the same analogue filters."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from tests.blocks.library.harness import assert_close, few, noise, run_y
from twodof.blocks.library import HighPass, LeadLag, LowPass, LowPass2, Notch

pytestmark = pytest.mark.slow

DT = 0.004
FS = 1 / DT


@pytest.mark.parametrize("cutoff", [0.5, 10.0, 60.0])
@pytest.mark.parametrize(("method", "name"), [("forward", "euler"), ("backward", "backward_diff"), ("zoh", "zoh")])
def test_a_low_pass_is_its_rule(method: str, name: str, cutoff: float) -> None:
    w = 2 * np.pi * cutoff
    b, a, _ = signal.cont2discrete(([w], [1.0, w]), DT, method=name)
    u = noise(200)
    assert_close(run_y(LowPass(cutoff, method), u, DT), signal.lfilter(np.ravel(b), a, u))


@few
@given(st.floats(0.1, 120.0))
def test_trapezoidal_filters_are_butterworth(cutoff: float) -> None:
    u = noise(100)
    # tan and cos near a quarter turn lose three digits at 0.1 Hz: 1 - cos(x) of x = 2.5e-3.
    for block, order, kind in (
        (LowPass(cutoff), 1, "lowpass"),
        (LowPass2(cutoff), 2, "lowpass"),
        (HighPass(cutoff), 1, "highpass"),
    ):
        b, a = signal.butter(order, cutoff, kind, fs=FS)
        assert_close(run_y(block, u, DT), signal.lfilter(b, a, u), 1e-9)


@few
@given(st.floats(0.01, 2.0))
def test_a_damped_low_pass_is_the_bilinear_transform(damping: float) -> None:
    cutoff = 30.0
    w = 2 * FS * np.tan(np.pi * cutoff * DT)
    b, a = signal.bilinear([w * w], [1.0, 2 * damping * w, w * w], FS)
    u = noise(100)
    assert_close(run_y(LowPass2(cutoff, damping), u, DT), signal.lfilter(b, a, u))


@few
@given(st.floats(1.0, 120.0), st.floats(0.01, 0.7))
def test_a_notch_is_iirnotch(frequency: float, width: float) -> None:
    centre = 2 * np.pi * frequency * DT
    # iirnotch is told the digital bandwidth: the analogue one, warped.
    bandwidth = 2 * np.arctan(width * np.sin(centre))
    b, a = signal.iirnotch(frequency, centre / bandwidth, fs=FS)
    u = noise(100)
    assert_close(run_y(Notch(frequency, width), u, DT), signal.lfilter(b, a, u), 1e-11)


def test_a_shallow_notch_has_its_depth_at_its_frequency() -> None:
    t = DT * np.arange(3000)
    y = run_y(Notch(20.0, 0.2, depth=0.25), np.sin(2 * np.pi * 20.0 * t), DT)
    # After 6 s of a time constant of 1/(0.2 * 2 pi 20) = 40 ms nothing of the start is left; 250 Hz samples the
    # peaks of 20 Hz in 12.5 phases a turn, so that RMS over whole turns is exact.
    tail = y[-500:]
    assert_close(np.sqrt(2 * np.mean(tail**2)), 0.25, 1e-9)


@few
@given(st.floats(1e-3, 0.5), st.floats(1e-3, 0.5), st.floats(0.1, 3))
def test_a_lead_lag_is_the_bilinear_transform(lead: float, lag: float, gain: float) -> None:
    b, a = signal.bilinear([gain * lead, gain], [lag, 1.0], FS)
    u = noise(100)
    # scipy scales by powers of sqrt(2 fs) and loses digits where the gain at high frequency, lead / lag, is large.
    assert_close(run_y(LeadLag(gain, lead, lag), u, DT), signal.lfilter(b, a, u), 1e-10)


@pytest.mark.parametrize(
    ("block", "gain"),
    [
        *((LowPass(7.0, method, initial=3.0), 1.0) for method in ("forward", "backward", "trapezoidal", "zoh")),
        (LowPass2(7.0, initial=3.0), 1.0),
        (Notch(7.0, initial=3.0), 1.0),
        (LeadLag(2.0, initial=3.0), 2.0),
        (HighPass(7.0, initial=3.0), 0.0),
    ],
)
def test_a_filter_starts_at_rest(block: LowPass, gain: float) -> None:
    y = run_y(block, np.full(50, 3.0), DT)
    np.testing.assert_allclose(y, 3.0 * gain, rtol=0, atol=1e-13)


def test_a_cut_off_beyond_the_sampling_stays_stable() -> None:
    for block in (LowPass(500.0), LowPass2(500.0), HighPass(500.0), Notch(500.0)):
        assert np.max(np.abs(run_y(block, noise(300), DT))) < 10.0


def test_rules_without_feed_through_have_none() -> None:
    through = {m: bool(LowPass(1.0, m).trace.feedthrough["y"]) for m in ("forward", "backward", "trapezoidal", "zoh")}
    assert through == {"forward": False, "backward": True, "trapezoidal": True, "zoh": False}
