"""Margins: loops whose margins one knows by hand, what a margin promises, the course's designs, and bad input."""

import math

import numpy as np
import pytest
from scipy import signal

from twodof.design import LoopTransfer, margins, root_locus
from twodof.design.closed_loop_poles import closed_loop_poles
from twodof.errors import ParameterError
from twodof.models import PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX, DelayedStateSpace
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow


def loop(top: list[float], bottom: list[float], dt: float | None = None, delay: float = 0.0) -> LoopTransfer:
    a, b, c, d = signal.tf2ss(top, bottom)
    return LoopTransfer(a, b, c, float(d[0, 0]), dt, delay)


def test_an_integrator_with_delay_by_hand() -> None:
    k, tau = 2.0, 0.15
    found = margins(loop([k], [1.0, 0.0], delay=tau))
    assert found.stable
    assert found.crossover == pytest.approx(k, rel=1e-13)
    assert found.phase_margin == pytest.approx(math.pi / 2 - k * tau, rel=1e-12)
    assert found.delay_margin == pytest.approx(math.pi / (2 * k) - tau, rel=1e-12)
    assert found.increase is not None
    assert found.increase.omega == pytest.approx(math.pi / (2 * tau), rel=1e-12)
    assert found.increase.factor == pytest.approx(math.pi / (2 * k * tau), rel=1e-12)
    # s exp(s tau) = -k is Lambert's equation.
    assert found.poles[0] == pytest.approx(_lambert(-k * tau) / tau, rel=1e-9)


def _lambert(x: float) -> complex:
    from scipy.special import lambertw

    both = [complex(lambertw(x, branch)) for branch in (0, -1)]
    return max(both, key=lambda w: (w.real, w.imag))


def test_with_too_much_delay_it_swings_and_grows() -> None:
    found = margins(loop([2.0], [1.0, 0.0], delay=0.9))
    assert not found.stable
    root = _lambert(-2.0 * 0.9) / 0.9
    assert found.motion is not None
    assert found.motion.omega == pytest.approx(abs(root.imag), rel=1e-9)
    assert found.motion.growth == pytest.approx(root.real, rel=1e-9)
    assert found.motion.text == f"swings at {abs(root.imag):.3g} rad/s, growing"
    assert math.isinf(found.ms)
    assert found.disk.alpha == 0.0


@pytest.mark.parametrize(
    "one",
    [
        loop([1.0], [1.0, 0.0, 0.0]),
        loop([2.0], [1.0, -1.0], PERIOD),
        # A state at -1 that nothing reaches stands beside the pole that the feedback moves there.
        LoopTransfer(
            np.array([[1.0, 1.0], [0.0, -1.0]]), np.array([[2.0], [0.0]]), np.array([[1.0, 2.0]]), 0.0, PERIOD
        ),
    ],
)
def test_a_loop_on_the_border_has_infinite_peaks(one: LoopTransfer) -> None:
    found = margins(one)
    assert not found.stable
    assert (found.ms, found.mt, found.disk.alpha) == (math.inf, math.inf, 0.0)
    assert math.isnan(found.ms_at)


def test_an_unstable_plant_needs_its_gain() -> None:
    """k / (s - 1): stable from k = 1 on, at frequency 0, and with as much more gain as one likes."""
    found = margins(loop([3.0], [1.0, -1.0]))
    assert found.stable
    assert found.increase is None
    assert found.decrease is not None
    assert (found.decrease.omega, found.decrease.factor) == (0.0, pytest.approx(1.0 / 3.0))
    assert not margins(loop([0.9], [1.0, -1.0])).stable


def test_a_double_integrator_bears_any_less_gain() -> None:
    """k (s + .5) / (s^2 (s + 20)): by Routh stable for every k > 0, so no rounding at frequency 0 is a margin."""
    found = margins(loop([1.0, 0.5], [1.0, 20.0, 0.0, 0.0]))
    assert found.stable
    assert found.gains == ()


def test_a_loop_prints_which_way_its_gain_may_go() -> None:
    """2 / (s - 1) is unstable below half its gain; |L| of 0.5 / (s + 1) is 1 nowhere."""
    assert repr(margins(loop([2.0], [1.0, -1.0]))).startswith(
        "<LoopMargins stable: gain margin -6.0 dB, phase margin 60"
    )
    assert repr(margins(loop([0.5], [1.0, 1.0]))) == "<LoopMargins stable: gain margin none, no crossover>"


def test_an_unstable_loop_prints_its_motion_and_no_margins() -> None:
    """0.9 / (s - 1) closed has its pole at 0.1; 1 / (s^2 - 0.2 s + 3) closed swings at 2 rad/s."""
    assert repr(margins(loop([0.9], [1.0, -1.0]))) == "<LoopMargins unstable: runs away, growing by a factor e in 10 s>"
    assert repr(margins(loop([1.0], [1.0, -0.2, 3.0]))) == "<LoopMargins unstable: swings at 2 rad/s, growing>"


def test_a_narrow_resonance_is_not_missed() -> None:
    """Peaks a ten-thousandth wide, between the points of any reasonable grid: two crossings."""
    slow = [1.0, 1e-4, 37.0**2]
    peak = np.polymul([1e-3, 0.0], [0.05, 1.0])  # 1e-3 s / slow: 10 high
    found = margins(loop(list(np.polyadd(np.polymul([0.3], slow), peak)), list(np.polymul(slow, [0.05, 1.0]))))
    assert [p.omega for p in found.phases] == pytest.approx([37.0, 37.0], abs=0.01)
    assert found.mt_at == pytest.approx(37.0, abs=1e-2) or found.ms_at == pytest.approx(37.0, abs=1e-2)


def test_a_delay_margin_is_where_stability_ends() -> None:
    spare = margins(loop([40.0], [1.0, 6.0, 8.0, 0.0])).delay_margin
    assert margins(loop([40.0], [1.0, 6.0, 8.0, 0.0], delay=spare * (1 - 1e-6))).stable
    assert not margins(loop([40.0], [1.0, 6.0, 8.0, 0.0], delay=spare * (1 + 1e-6))).stable


@pytest.mark.parametrize("skew", [-1.0, 0.0, 0.5, 1.0])
def test_factors_within_the_disk_margin_are_stable(skew: float) -> None:
    """Seiler, Packard and Gahinet 2020, theorem 1, by trial with random complex factors."""
    one = loop([40.0], [1.0, 6.0, 8.0, 0.0])
    found = margins(one, skew)
    alpha, r = found.disk.alpha, np.random.default_rng(3)

    def factor(d: complex) -> complex:
        return (1 + (1 - skew) / 2 * d) / (1 - (1 + skew) / 2 * d)

    def worst(f: complex) -> float:
        return float(np.linalg.eigvals(one.a - f * one.b @ one.c).real.max())

    for _ in range(200):
        assert worst(factor(0.999 * alpha * np.exp(2j * np.pi * r.random()) * np.sqrt(r.random()))) < 0.0
    l = complex(one.response(found.disk.omega)[0])
    d = 1.0 / (1.0 / (1.0 + l) + (skew - 1) / 2)  # the paper's destabilising one: f L = -1 at that frequency
    assert abs(d) == pytest.approx(alpha, rel=1e-9)
    assert factor(-d) * l == pytest.approx(-1.0, rel=1e-9) or factor(d) * l == pytest.approx(-1.0, rel=1e-9)
    low, high = found.disk.gain
    assert found.increase is not None
    assert low < 1.0 < high <= found.increase.factor * (1 + 1e-9)
    assert found.disk.phase <= abs(found.phase_margin) * (1 + 1e-9)


def test_bodes_integral_of_the_sensitivity() -> None:
    """The area under log |S| is pi times the sum of the unstable open-loop poles: a check of S over all frequencies."""
    one = loop([12.0, 12.0], [1.0, 3.0, -4.0, 0.0])
    assert margins(one).stable
    omega = np.geomspace(1e-6, 1e5, 20_001)
    area = np.trapezoid(np.log(np.abs(1.0 / (1.0 + one.response(omega)))), omega)
    tail = 12.0 / 1e5  # log |S| goes as -Re L = 12 / omega^2
    assert area + tail == pytest.approx(math.pi * 1.0, abs=1e-4)  # below 1e-6 rad/s |log S| is under 20


def test_a_zero_gain_has_infinite_margins() -> None:
    found = margins(loop([1.0], [1.0, 1.0]).scaled(0.0))
    assert found.stable
    assert (found.ms, found.mt, found.bandwidth) == (pytest.approx(1.0), 0.0, 0.0)
    assert math.isinf(found.gain_margin)
    assert math.isinf(found.delay_margin)
    assert math.isnan(found.crossover)


# The course


def pid(kp: float, ki: float, kd: float = 0.0, n: float = 100.0) -> LoopTransfer:
    """Kp + Ki Ts z / (z - 1) + Kd (z - 1) / ((1/N + Ts) z - 1/N), as the drone's."""
    lag = 1.0 / n + PERIOD
    keep = 1.0 / n / lag
    row = np.array([[ki * PERIOD, kd / lag * (keep - 1.0)]])
    return LoopTransfer(np.diag([1.0, keep]), np.ones((2, 1)), row, kp + ki * PERIOD + kd / lag, PERIOD)


def forward_pi(kp: float, ki: float) -> LoopTransfer:
    return LoopTransfer(np.eye(1), np.ones((1, 1)), np.array([[ki * PERIOD]]), kp, PERIOD)


def tustin(plant: DelayedStateSpace, output: int) -> LoopTransfer:
    """The plant by the trapezoidal rule, as the course discretises it, and its delay in whole samples."""
    a, b, c, d, _ = signal.cont2discrete((plant.a, plant.b, plant.c, plant.d), PERIOD, "bilinear")
    made = LoopTransfer(a, b, c[output : output + 1], float(d[output, 0]), PERIOD)
    n = round(plant.delay / PERIOD)
    return made if n == 0 else made.times(loop([1.0], [1.0] + [0.0] * n, PERIOD))


def closed(one: LoopTransfer) -> LoopTransfer:
    k = 1.0 / (1.0 + one.d)
    return LoopTransfer(one.a - k * one.b @ one.c, k * one.b, k * one.c, 1.0 - k, one.dt)


BACKWARD = LoopTransfer(np.eye(1), np.ones((1, 1)), np.full((1, 1), PERIOD), PERIOD, PERIOD)
RATES = {10: (0.02901, 0.02789, 0.001105), 30: (0.08535, 0.25103, 0.000541), 40: (0.11269, 0.44628, 0.000268)}


def test_the_course_cascade_has_its_published_margins() -> None:
    """Each to half of its last digit. The pitch and the position are sums up to their own sample (backward Euler)."""
    rate = pid(*RATES[30]).times(tustin(PAPER_PITCH_RATE.state_space(), 1))
    found = margins(rate)
    assert found.crossover == pytest.approx(33.5, abs=0.05)
    assert found.phase_margin_deg == pytest.approx(57.7, abs=0.05)
    assert found.gain_margin_db == pytest.approx(6.9, abs=0.05)
    attitude = LoopTransfer.of_gain(11.0, PERIOD).times(BACKWARD).times(closed(rate))
    found = margins(attitude)
    assert found.crossover == pytest.approx(11.7, abs=0.05)
    assert found.phase_margin_deg == pytest.approx(71.5, abs=0.055)  # 71.45
    # theta0 = -force / (T_bar eta_T), and G_v = -k_v / (s + p_v): both signs cancel.
    tilt = LoopTransfer.of_gain(-1.0 / (0.4 * 6.3386), PERIOD)
    cart = tustin(PAPER_VELOCITY_GREYBOX.state_space(), 1)
    velocity = forward_pi(2.4, 2.81).times(tilt).times(cart).times(closed(attitude))
    found = margins(velocity)
    assert found.crossover == pytest.approx(4.24, abs=0.005)
    assert found.phase_margin_deg == pytest.approx(68.9, abs=0.055)  # 68.85
    position = LoopTransfer.of_gain(1.5, PERIOD).times(BACKWARD).times(closed(velocity))
    found = margins(position)
    assert found.crossover == pytest.approx(1.49, abs=0.005)
    assert found.phase_margin_deg == pytest.approx(70.9, abs=0.055)  # 70.85


@pytest.mark.parametrize(("name", "crossover", "phase"), [(10, 12.7, 98.9), (30, 33.0, 58.5), (40, 42.1, 42.0)])
def test_course_rate_controllers_on_the_papers_model(name: int, crossover: float, phase: float) -> None:
    """On the paper's model, and by hand. Named 10, 30 and 40 rad/s, they cross over a little above."""
    kp, ki, kd = RATES[name]
    n = 100.0
    controller = DelayedStateSpace.of([[0.0, 0.0], [0.0, -n]], [1.0, 1.0], [ki, -kd * n * n], kp + kd * n)
    found = margins(LoopTransfer.of(controller).times(LoopTransfer.of(PAPER_PITCH_RATE.state_space(), 0, 1)))
    assert found.crossover == pytest.approx(crossover, abs=0.05)
    assert found.phase_margin_deg == pytest.approx(phase, abs=0.05)
    s = 1j * found.crossover
    p = PAPER_PITCH_RATE
    plant = p.mu * s * np.exp(-s * p.tau) / (s * s + 2 * p.xi * p.w_n * s + p.w_n**2)
    by_hand = (kp + ki / s + kd * s / (1 + s / n)) * plant
    assert abs(by_hand) == pytest.approx(1.0, rel=1e-10)
    assert math.pi + np.angle(by_hand) == pytest.approx(found.phase_margin, abs=1e-10)
    assert found.stable


# Root locus


def test_the_root_locus_crosses_at_the_gain_margin() -> None:
    one = loop([1.0], [1.0, 6.0, 8.0, 0.0])
    border = margins(one).increase
    assert border is not None
    assert border.factor == pytest.approx(48.0, rel=1e-12)  # Routh: 6 * 8
    gains = np.geomspace(0.1, 100.0, 400)
    found = root_locus(one, gains)
    assert found.shape == (400, 3)
    assert np.abs(np.diff(found, axis=0)).max() < 0.2
    np.testing.assert_allclose(found.sum(axis=1), -6.0, atol=1e-9)  # the poles' sum stays
    assert np.array_equal(gains > 48.0, found.real.max(axis=1) > 0.0)


# Bad input


@pytest.mark.long
def test_wrong_loops_are_refused_with_a_remedy() -> None:
    good = loop([1.0], [1.0, 1.0])
    with pytest.raises(ParameterError, match="not a loop of one input"):
        LoopTransfer(np.eye(2), np.ones((2, 2)), np.ones((1, 2)), 0.0)
    with pytest.raises(ParameterError, match="not all matrices"):
        LoopTransfer([[0.0]], [[1.0]], [[1.0]], 0.0)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="not a linear model"):
        margins([1.0, 2.0])
    with pytest.raises(ParameterError, match="NaN or infinity"):
        LoopTransfer(np.full((1, 1), np.nan), np.ones((1, 1)), np.ones((1, 1)), 0.0)
    with pytest.raises(ParameterError, match="not well posed"):
        margins(LoopTransfer.of_gain(-1.0))
    with pytest.raises(ParameterError, match="around a direct path"):
        LoopTransfer(np.eye(1), np.ones((1, 1)), np.ones((1, 1)), 1.0, None, 0.1)
    with pytest.raises(ParameterError, match="sample times"):
        good.times(LoopTransfer.of_gain(1.0, 0.1))
    with pytest.raises(ParameterError, match="not a linear model"):
        LoopTransfer.of("nothing")
    with pytest.raises(ParameterError, match="no output 7"):
        LoopTransfer.of(PAPER_PITCH_RATE.state_space(), 0, 7)
    with pytest.raises(ParameterError, match="skew"):
        margins(good, math.nan)
    with pytest.raises(ParameterError, match="gains of shape"):
        root_locus(good, [])
    with pytest.raises(ParameterError, match="601 states"):
        LoopTransfer(np.eye(601), np.ones((601, 1)), np.ones((1, 601)), 0.0)
    with pytest.raises(ParameterError, match="turns the loop"):
        margins(loop([1.0], [1.0, 1.0], delay=1e5))
    assert closed_loop_poles(LoopTransfer.of_gain(0.5)).size == 0
    assert margins(LoopTransfer.of_gain(0.5)).stable
