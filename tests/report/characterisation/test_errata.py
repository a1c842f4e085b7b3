"""The errata's figures against closed forms, independent of the simulation that they are computed with."""

import math

import pytest

from twodof.models.plant import PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX, PAPER_VELOCITY_SIMPLE, Velocity
from twodof.report.characterisation.errata import doublet_travel, errata, impulse_angle_deg, read_by_hand, unit_peak


def test_unit_peak_is_that_of_the_step_response_at_the_doublets_turn() -> None:
    """A step of M gives q = A/w_d exp(-xi w_n t) sin(w_d t). It still rises at 0.3 s, so the peak is at the turn."""
    w_n, xi = PAPER_PITCH_RATE.w_n, PAPER_PITCH_RATE.xi
    w_d = w_n * math.sqrt(1.0 - xi**2)
    exact = 0.03 / w_d * math.exp(-xi * w_n * 0.3) * math.sin(w_d * 0.3)
    assert unit_peak() == pytest.approx(exact, rel=1e-9)
    assert unit_peak() == pytest.approx(6.88e-3, abs=0.005e-3)


def test_the_impulse_would_hit_the_stop() -> None:
    """Undamped and instantaneous, theta peaks at mu M width / w_n = 119.5 deg. Damping takes exp(-xi
    pi/2) of it, the finite width sin(w/2)/(w/2) with w = w_n 0.2 s: 103 deg, here within 1 %.
    """
    w_n, xi = PAPER_PITCH_RATE.w_n, PAPER_PITCH_RATE.xi
    half = w_n * 0.1
    rough = math.degrees(358.5 * 0.1 * 0.2 / w_n) * math.exp(-xi * math.pi / 2.0) * math.sin(half) / half
    assert impulse_angle_deg() == pytest.approx(rough, rel=0.02)
    assert impulse_angle_deg() > 50.0


def test_travel_without_friction_is_the_doublets_double_integral() -> None:
    """Speeding up over T and down over T at k_v A covers k_v A T^2."""
    amplitude, half = math.radians(15.0), 0.8
    exact = 4.0 * amplitude * half**2
    assert doublet_travel(Velocity(4.0, 0.0), 15.0, half) == pytest.approx(exact, rel=2e-3)


def test_the_longest_doublet_that_the_paper_suggests_takes_the_whole_rail() -> None:
    travels = [doublet_travel(model, 20.0, 1.0) for model in (PAPER_VELOCITY_SIMPLE, PAPER_VELOCITY_GREYBOX)]
    # 3 % of the stroke is 24 mm: less than the start's uncertainty and the loop's lag need.
    assert min(travels) > 0.97 * 0.8
    assert max(travels) > 0.8


def test_reading_the_papers_grey_box_model_by_hand_gives_the_papers_other_column() -> None:
    """The line through 10 to 40 % of the peak has the slope at 25 %: 1 - 0.25 (1 - exp(-p_v T)) of the initial one."""
    k_v, p_v = read_by_hand()
    model = PAPER_VELOCITY_GREYBOX
    assert k_v == pytest.approx(model.k_v * (1.0 - 0.25 * -math.expm1(-model.p_v * 0.8)), rel=0.01)
    assert k_v == pytest.approx(PAPER_VELOCITY_SIMPLE.k_v, rel=0.02)
    assert p_v == pytest.approx(PAPER_VELOCITY_SIMPLE.p_v, rel=0.05)


def test_each_erratum_says_where_what_and_why() -> None:
    found = errata()
    assert len(found) == 7
    assert all(one.place and one.printed and one.shown for one in found)
    assert "μ = 348.9" in found[3].shown
