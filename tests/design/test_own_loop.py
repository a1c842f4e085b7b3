"""Loops of users: transfer functions as written, sampled as python-control does, with figures of the textbook."""

import math

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twodof.design import LoopTransfer, final_value, margins, own_loop, read_rational, step_response
from twodof.design.loop_transfer import minimal
from twodof.errors import ParameterError

pytestmark = pytest.mark.slow


def written(text: str, period: float | None = None) -> LoopTransfer:
    return read_rational(text).transfer("test", period)


@pytest.mark.parametrize(
    ("text", "top", "bottom", "delay"),
    [
        ("2 exp(-0.3 s) / (1.5 s + 1)", [2.0], [1.5, 1.0], 0.3),
        ("3 + 1/s", [3.0, 1.0], [1.0, 0.0], 0.0),
        ("2(s+1)(s+2)/s^3", [2.0, 6.0, 4.0], [1.0, 0.0, 0.0, 0.0], 0.0),
        ("-s/(0.01s + 1)", [-1.0, 0.0], [0.01, 1.0], 0.0),
        ("1e-3 / (s + 1e3)", [1e-3], [1.0, 1e3], 0.0),
        ("0.1 z / (z - .9)", [0.1, 0.0], [1.0, -0.9], 0.0),
        ("1 - 1", [0.0], [1.0], 0.0),
    ],
)
def test_a_transfer_function_is_read_as_written(text: str, top: list[float], bottom: list[float], delay: float) -> None:
    found = read_rational(text)
    assert found.top.tolist() == pytest.approx(top)
    assert found.bottom.tolist() == pytest.approx(bottom)
    assert found.delay == delay


@pytest.mark.parametrize(
    "text",
    [
        "",
        "__import__('os')",
        "s^99",
        "1/0",
        "s z",
        "x",
        "exp(s)",
        "1/(s+1) + exp(-s)",
        "1j",
        "s**-1",
        "(" * 300,
        "9" * 500,
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ParameterError):
        read_rational(text)


@settings(deadline=None, max_examples=40)
@given(
    gain=st.floats(0.05, 5.0),
    lags=st.lists(st.floats(0.05, 5.0), min_size=1, max_size=3),
    kp=st.floats(0.1, 5.0),
    ki=st.floats(0.01, 3.0),
    period=st.floats(0.01, 0.5),
)
def test_the_response_is_that_of_python_control(
    gain: float, lags: list[float], kp: float, ki: float, period: float
) -> None:
    plant = written(f"{gain!r} / (" + " * ".join(f"({lag!r} s + 1)" for lag in lags) + ")")
    law = written(f"{kp!r} + {ki!r} / s")
    s = control.tf("s")
    theirs, controller = control.tf([gain], [1.0]), kp + ki / s
    for lag in lags:
        theirs = theirs / (lag * s + 1)
    omega = np.geomspace(0.01, 0.9 * math.pi / period, 30)
    assert own_loop(plant, law).response(omega) == pytest.approx((controller * theirs)(1j * omega), rel=1e-9)
    z = np.exp(1j * omega * period)
    held = control.sample_system(control.ss(theirs), period, "zoh")(z)
    rule = control.sample_system(control.ss(controller), period, "bilinear")(z)
    assert own_loop(plant, law, period).response(omega) == pytest.approx(held * rule, rel=1e-6)


def test_margins_of_an_integrator_with_dead_time_are_those_in_closed_form() -> None:
    # The controller cancels the lag: L = 2 exp(-.3 s) / s.
    found = margins(own_loop(written("2 exp(-0.3 s) / (1.5 s + 1)"), written("1.5 + 1 / s")))
    assert found.crossover == pytest.approx(2.0)
    assert found.phase_margin == pytest.approx(math.pi / 2.0 - 0.6)
    assert found.gain_margin == pytest.approx(math.pi / 2.0 / 0.3 / 2.0)


@pytest.mark.parametrize("period", [None, 0.02])
def test_step_of_a_closed_loop_is_that_in_closed_form(period: float | None) -> None:
    # L = 4 / (s (s + 1.2)): w_n is 2, zeta is .3.
    found = margins(own_loop(written("4 / (s (s + 1.2))"), written("1"), period))
    time, value = step_response(found)
    root = math.sqrt(1.0 - 0.3**2)
    swing = np.exp(-0.6 * time) * (np.cos(2.0 * root * time) + 0.3 / root * np.sin(2.0 * root * time))
    # Sampled, the loop is late by half a step: .01 s of the largest slope, 1.3 1/s, and swings more by as much.
    assert value == pytest.approx(1.0 - swing, abs=1e-9 if period is None else 0.04)
    assert abs(value[-1] - 1.0) < 0.02


@pytest.mark.parametrize(
    ("plant", "law", "period"),
    [
        ("1 / (s + 1)^3", "6", None),  # settles long after its crossover's 60 radians
        ("1 / (s + 1)", "10 + 0.1 / s", None),  # a slow integral's tail
        ("1 / (s^2 + 0.06 s + 1)", "1", None),
        ("1 / (s + 1)", "10 + 0.1 / s", 0.05),
        ("1 / (s + 1)", "2 + 0.02 / s", 0.001),
        ("s / (s + 1)", "1 / s", None),  # the integrator cancels: it ends at 1/2
        ("(s + 0.001) / (s + 1)^2", "1", None),  # rises far above where it ends
    ],
)
def test_a_step_response_goes_on_until_it_has_settled(plant: str, law: str, period: float | None) -> None:
    loop = own_loop(read_rational(plant), read_rational(law), period)
    time, value = step_response(margins(loop))
    # Of python-control the poles and the way from state to state; the response is summed by its modes.
    poles, modes = np.linalg.eig((closed := control.feedback(minimal(loop).state_space())).A)
    final = float(closed.dcgain())
    parts = (closed.C @ modes)[0] * np.linalg.solve(modes, closed.B)[:, 0]
    if period is None:
        grown = np.exp(np.outer(time, poles)) / poles
    else:
        grown = poles ** np.round(time / period)[:, None] / (poles - 1.0)
    assert value == pytest.approx((final + grown @ parts).real, abs=1e-8)
    ahead = time[-1] * np.linspace(1.0, 5.0, 10_000)
    later = np.exp(np.outer(ahead, poles if period is None else np.log(poles) / period))
    later = (later / (poles if period is None else poles - 1.0)) @ parts
    assert np.max(np.abs(later)) < 0.02 * abs(final), "it settles into 2 % within what is shown"
    assert final_value(margins(loop)) == pytest.approx(final)


def test_a_step_response_with_dead_time_settles_when_it_does() -> None:
    # y' = 2 (1 - y(t - 1)) - y, integrated here by steps of half a millisecond.
    late, dt = 2000, 0.0005
    y = np.zeros(120_000)
    for k in range(1, y.size):
        error = 1.0 - y[k - late] if k > late else 0.0
        y[k] = y[k - 1] + dt * (2.0 * error - y[k - 1])
    time, value = step_response(margins(read_rational("2 exp(-s) / (s + 1)").transfer()))
    assert value == pytest.approx(np.interp(time, dt * np.arange(y.size), y), abs=0.01)
    assert time[-1] > dt * np.flatnonzero(np.abs(y - 2.0 / 3.0) > 0.02 * 2.0 / 3.0)[-1]


@pytest.mark.parametrize("text", ["30 / s", "30 exp(-0.02 s) / s", "1e-7 / s", "1e8 / (s (s + 1))"])
def test_python_control_finds_the_crossover_of_integrators(text: str) -> None:
    loop = read_rational(text).transfer()
    _, phase, _, crossover = control.margin(loop.to_control())
    found = margins(loop)
    assert crossover == pytest.approx(found.crossover, rel=0.01)  # 2,000 points interpolated by spline
    assert phase == pytest.approx(math.degrees(found.phase_margin), abs=1.0)


@pytest.mark.parametrize("text", ["1", "(s + 1) / (s + 1)"])
def test_a_loop_of_one_has_a_disk_margin_without_end(text: str) -> None:
    # S is 1/2 at every frequency, so no factor but -1 makes 1 + L zero.
    disk = margins(written(text)).disk
    assert (disk.alpha, disk.gain, disk.phase) == (math.inf, (-1.0, math.inf), math.pi)


@pytest.mark.parametrize(
    "text", ["1 / (2 s)", "(s + 2) / (s + 1)", "0.5 (s + 1) / (s + 2)", "(z + 0.2) / (z - 0.5)", "4 / (s + 1)^3"]
)
def test_a_disk_margins_phase_is_python_controls(text: str) -> None:
    loop = written(text, 0.1 if "z" in text else None)
    found = margins(loop).disk
    top = math.pi / 0.1 if loop.dt else 1e6
    system = control.ss(loop.a, loop.b, loop.c, loop.d, loop.dt or 0)
    alpha, _, phase = control.disk_margins(system, np.clip([found.omega], 1e-6, top))
    assert found.alpha == pytest.approx(alpha, rel=1e-5)
    assert math.degrees(found.phase) == pytest.approx(phase, rel=1e-5)


@pytest.mark.parametrize(
    "text", ["1/s(s+1)", "1/2s", "1/(2s+1)s", "3/(s+1) (s+2)", "1/((s+1)(s+2))(s+3)", "1/-s(s+1)", "1/.5s"]
)
def test_a_quotient_that_has_two_readings_is_refused(text: str) -> None:
    with pytest.raises(ParameterError, match="two ways"):
        read_rational(text)


@pytest.mark.parametrize(
    ("text", "top"), [("(1/s)(s+1)", [1.0, 1.0]), ("1/s*(s+1)", [1.0, 1.0]), ("2/s exp(-s)", [2.0])]
)
def test_a_quotient_with_one_reading_is_read(text: str, top: list[float]) -> None:
    found = read_rational(text)
    assert (found.top.tolist(), found.bottom.tolist()) == (top, [1.0, 0.0])


@pytest.mark.parametrize("text", ["20 s^2 / (s + 1)^3", "s^3 / (s + 2)^4", "0.3 s^2 / (s + 0.1)^3"])
def test_a_loop_with_two_zeros_at_rest_ends_at_0(text: str) -> None:
    assert final_value(margins(written(text))) == 0.0


@pytest.mark.parametrize("text", ["10 s / (s + 1)", "3 (s + 2) / (s + 1)"])
def test_no_delay_is_left_to_a_loop_whose_gain_stays_above_1(text: str) -> None:
    # With a lag T its gain falls through 1 at some D / T, so the delay margin goes to 0 with T.
    found = margins(written(text))
    assert found.delay_margin == 0.0
    lags = [margins(written(f"({text}) * 1 / ({lag!r} s + 1)")).delay_margin for lag in (1e-2, 1e-3, 1e-4)]
    assert lags[0] > 9.0 * lags[1] > 80.0 * lags[2] > 0.0


def test_what_does_not_fit_together_is_refused() -> None:
    with pytest.raises(ParameterError, match="str is not a linear model"):
        own_loop("1 / s", written("1"))
    with pytest.raises(ParameterError, match="no sample time"):
        written("1 / (z - 1)")
    with pytest.raises(ParameterError, match="more zeros than poles"):
        written("s + 1")
    with pytest.raises(ParameterError, match=r"sample times of 0.1, 0.2 s"):
        own_loop(written("1 / (z - 1)", 0.1), written("z / (z - 1)", 0.2))
    with pytest.raises(ParameterError, match="continuous delay"):
        own_loop(written("1 / (z - 1)", 0.1), written("exp(-s) / (s + 1)"))
