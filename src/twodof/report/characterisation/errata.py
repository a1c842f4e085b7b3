"""Places where the paper's print does not hold, each with the figures that show it, computed here."""

import math
import tomllib

import numpy as np

from twodof.excitation import Doublet, Excitation, Impulse
from twodof.identify.record import Record
from twodof.identify.simple_velocity import read_step
from twodof.models.lti import DelayedStateSpace
from twodof.models.plant import PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX, PAPER_VELOCITY_SIMPLE, PitchRate, Velocity
from twodof.report.content import Erratum
from twodof.report.template_texts import text

_STEP_S = 1e-3
_PERIOD_S = 1.83
_PEAK = 2.40


def unit_peak() -> float:
    """First peak of q [rad/s] after the paper's doublet (0.03, period 0.6 s) with mu = 1 and no delay."""
    model = PitchRate(PAPER_PITCH_RATE.w_n, PAPER_PITCH_RATE.xi, 1.0, 0.0)
    return float(_response(model.state_space(), Doublet(0.03, 0.6), 1.0)[:, 1].max())


def impulse_angle_deg() -> float:
    """Largest pitch [deg] that the paper's model reaches after the paper's impulse (0.1 for 0.2 s)."""
    pitch = _response(PAPER_PITCH_RATE.state_space(), Impulse(0.1, 0.2), 4.0)[:, 0]
    return float(np.degrees(np.abs(pitch).max()))


def doublet_travel(model: Velocity, amplitude_deg: float, half_period_s: float) -> float:
    """Travel [m] of the cart during a doublet of pitch, attitude dynamics left out, from rest."""
    excitation = Doublet(math.radians(amplitude_deg), 2.0 * half_period_s)
    position = _response(model.state_space(), excitation, 2.0 * half_period_s)[:, 0]
    return float(np.ptp(position))


def read_by_hand() -> tuple[float, float]:
    """k_v and p_v that the paper's method by hand reads from its own grey-box model (15 deg, half-period 0.8 s)."""
    lead = 1.0
    pitch = Doublet(math.radians(15.0), 1.6, lead=lead)
    time = np.arange(0.0, lead + 1.6, _STEP_S)
    theta = pitch.at(time)
    v = PAPER_VELOCITY_GREYBOX.state_space().zero_order_hold(_STEP_S).simulate(theta)[:, 1]
    step = read_step(Record.from_columns(time, {"theta0": theta, "v": v}, ["theta0"], ["v"]))
    return step.k_v, step.p_v


def _response(plant: DelayedStateSpace, excitation: Excitation, duration: float) -> np.ndarray:
    time = np.arange(0.0, duration, _STEP_S)
    return plant.zero_order_hold(_STEP_S).simulate(excitation.at(time))


def errata() -> list[Erratum]:
    """What the paper prints and what this work shows, in the order of its pages."""
    pitch, simple, greybox = PAPER_PITCH_RATE, PAPER_VELOCITY_SIMPLE, PAPER_VELOCITY_GREYBOX
    peak = unit_peak()
    rows = text("errata.toml").format(
        pitch=pitch,
        simple=simple,
        greybox=greybox,
        w_n=2.0 * math.pi / _PERIOD_S,
        period_of_w_n=2.0 * math.pi / pitch.w_n,
        damped=100.0 * (1.0 / math.sqrt(1.0 - pitch.xi**2) - 1.0),
        angle=impulse_angle_deg(),
        unit_peak=1e3 * peak,
        mu=_PEAK / peak,
        travels=[doublet_travel(model, 20.0, 1.0) for model in (simple, greybox)],
        read=read_by_hand(),
    )
    return [Erratum(**row) for row in tomllib.loads(rows)["errata"]]
