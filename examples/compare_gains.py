"""Change the gains of the cascade and compare step responses of the pitch on the virtual rig."""

from dataclasses import replace
from math import degrees

import numpy as np

from twodof.experiment import Laboratory, experiment
from twodof.flight.gains import DEFAULT, STUDENT
from twodof.flightlog import setpoint_steps
from twodof.models import step_figures

# Steps of the pitch set-point to +10 deg, 0, -10 deg, 0, two seconds apart, with the cart locked.
steps = experiment("attitude-steps")

candidates = {
    "the drone's own": DEFAULT,
    "a student's": STUDENT,
    "half the attitude gain": replace(DEFAULT, attitude=0.5 * DEFAULT.attitude),
    "rate loop without integral": replace(DEFAULT, rate=(DEFAULT.rate[0], 0.0, DEFAULT.rate[2])),
}

print(f"{'gains':28} {'rise, s':>8} {'overshoot, %':>13} {'settling, s':>12} {'error at end, deg':>18} {'RMS of M':>9}")
for name, gains in candidates.items():
    # Gains are parameters of the compiled flight code: another set needs no other program.
    flight = Laboratory("lab", gains, noise=0.0).fly(steps)
    theta = flight.log["theta_true"]
    first, second = (event.time for event in setpoint_steps(flight.log, "theta0")[:2])
    response = theta.slice(first, second - 0.01)
    asked = flight.log.resample("theta0", [first + 1.0]).item()
    seen = step_figures(response.time - first, response.value, start=0.0, final=asked)
    left = degrees(asked - response.value[-25:].mean())
    effort = np.sqrt(np.mean(flight.log["M"].slice(first, second).value ** 2))
    settled = f"{seen.settling_time:.2f}" if seen.settling_time < np.inf else "never"
    print(f"{name:28} {seen.rise_time:8.3f} {100.0 * seen.overshoot:13.1f} {settled:>12} ", end="")
    print(f"{left:18.2f} {effort:9.4f}")
