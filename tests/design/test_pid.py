"""PID forms: the platform's printed gains and margins, and the closed forms against their loops."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest

from twodof.design.cascade import CascadeDesign, CascadeLoops, cascade_design
from twodof.design.pid import PidGains, pid_at, shaped_pid
from twodof.errors import ParameterError
from twodof.flight.gains import DEFAULT
from twodof.models.plant import PAPER_PITCH_RATE, PitchRate

PRINTED = {10: (0.02901, 0.02789, 0.001105), 30: (0.08535, 0.25103, 0.000541), 40: (0.11269, 0.44628, 0.000268)}
"""Crossover [rad/s] -> Kp, Ki, Kd of the course's rate PID on the paper's model."""


@pytest.mark.parametrize("crossover", PRINTED)
def test_course_gains_follow_their_rule(crossover: int) -> None:
    # With a mu of 358.52, which the paper prints as 358.5, every printed digit comes out.
    found = shaped_pid(358.52, crossover)
    for own, printed, digits in zip((found.kp, found.ki, found.kd), PRINTED[crossover], (5, 5, 6), strict=True):
        assert round(own, digits) == printed


@pytest.mark.parametrize(
    ("form", "crossover", "margin"),
    [("P", 20.0, None), ("PI", 12.0, 50.0), ("PD", 18.0, 115.0), ("PID", 30.0, 55.0), ("PID", 15.0, 95.0)],
)
def test_form_meets_crossover_and_margin(form: str, crossover: float, margin: float | None) -> None:
    loops = CascadeLoops(PAPER_PITCH_RATE)
    gains = pid_at(complex(loops.q.response(crossover)[0]), crossover, math.radians(margin or 60.0), form)
    value = loops.rate(gains, crossover)
    assert abs(value) == pytest.approx(1.0, rel=1e-9)
    # P has one gain, and meets the crossover alone.
    assert margin is None or 180.0 + math.degrees(float(np.angle(value))) == pytest.approx(margin, abs=1e-6)
    assert (gains.ki == 0.0) == ("I" not in form)
    assert (gains.kd == 0.0) == ("D" not in form)


@pytest.mark.parametrize(("natural", "asked"), [(1.5, 35.0), (3.4, 5.0)])
def test_margin_is_read_at_the_crossover_asked_for(natural: float, asked: float) -> None:
    """Both loops have |L| = 1 at more than one frequency, and the nearest to -pi is another one."""
    pitch = PitchRate(natural, 0.02, 350.0, 0.0401 if asked > 10.0 else 0.01)
    made = cascade_design(pitch, asked)
    loops, rate = CascadeLoops(pitch), PidGains(*made.gains.rate)
    for name, omega, of in (("rate", asked, loops.rate), ("attitude", asked / 5.0, loops.theta_by_q0)):
        at = made.crossovers[name]
        value = of(rate, at) * (made.gains.attitude if name == "attitude" else 1.0)
        assert abs(value) == pytest.approx(1.0, rel=1e-6)
        assert math.remainder(made.phase_margins[name] - math.pi - cmath.phase(value), 2.0 * math.pi) == pytest.approx(
            0.0, abs=1e-6
        )
        assert omega / 1.01 < at < 1.6 * omega


def test_a_loop_below_one_has_no_crossover() -> None:
    found = CascadeDesign.of(PAPER_PITCH_RATE, replace(DEFAULT, rate=(0.0, 0.0, 0.0)))
    assert all(math.isnan(figure) for figure in (*found.crossovers.values(), *found.phase_margins.values()))


@pytest.mark.parametrize(
    "call",
    [
        lambda: shaped_pid(-1.0, 30.0),
        lambda: shaped_pid("350", 30.0),
        lambda: cascade_design(PAPER_PITCH_RATE, None),
        lambda: shaped_pid(358.5, 60.0),
        lambda: shaped_pid(358.5, math.nan),
        lambda: pid_at(1.0 + 0.0j, 10.0, form="PIDD"),
        lambda: pid_at(0.0j, 10.0),
        lambda: pid_at(1.0j, 10.0, math.radians(170.0), "PI"),
        lambda: pid_at(1.0j, -10.0),
        lambda: cascade_design(PAPER_PITCH_RATE, 30.0, separation=0.5),
    ],
)
def test_refuses_with_a_remedy(call: object) -> None:
    with pytest.raises(ParameterError) as caught:
        call()  # type: ignore[operator]
    assert caught.value.remedy
