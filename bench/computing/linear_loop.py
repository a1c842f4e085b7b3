"""The linear loop in python-control: the cascade, continuous, on the rig linearised in hover, by forced_response.

It is imported where it is used: it takes seconds, which each of the tests' processes would spend on it.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bench.measure import timed
from twodof.flight.gains import DEFAULT
from twodof.models.plant import PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX

if TYPE_CHECKING:
    import control

TICK = 0.001
N, T_BAR, ETA_T = 100.0, 0.4, 6.3386


def linear_loop() -> control.StateSpace:
    """From the position set-point [m] to x [m]: G_q with a first-order lag for its delay, G_v, all four controllers."""
    import control

    pitch, cart = PAPER_PITCH_RATE, PAPER_VELOCITY_GREYBOX
    kp, ki, kd = DEFAULT.rate
    s = control.tf("s")
    rotors = 1.0 / (pitch.tau * s + 1.0)
    plant = pitch.mu * s / (s**2 + 2.0 * pitch.xi * pitch.w_n * s + pitch.w_n**2) * rotors
    rate = control.feedback((kp + ki / s + kd * N * s / (s + N)) * plant, 1)
    attitude = control.feedback(DEFAULT.attitude * rate / s, 1)
    velocity_kp, velocity_ki = DEFAULT.velocity
    # theta0 = -force / (T_bar eta_T) and v' = -k_v theta - p_v v: the two signs cancel.
    along = attitude * cart.k_v / (T_BAR * ETA_T) / (s + cart.p_v)
    velocity = control.feedback((velocity_kp + velocity_ki / s) * along, 1)
    return control.ss(control.minreal(control.feedback(DEFAULT.position * velocity / s, 1), verbose=False))


def linear_loop_seconds(ticks: int, repeats: int) -> float:
    """Median time [s] of the response to a step of the set-point over `ticks` steps of 1 ms."""
    import control

    system = linear_loop()
    time = TICK * np.arange(ticks)
    step = np.full(ticks, 0.1)
    (timing,) = timed([partial(control.forced_response, system, time, step)], repeats)
    return timing.median
