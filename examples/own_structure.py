"""Fit your own structure, any diagram with parameters, to the columns of any table."""

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.library import FirstOrder
from twodof.identify import Record, fit
from twodof.models import Structure

motor = Diagram("motor", "speed of a motor from its voltage")
motor.input("u", unit="V")
motor.param("gain", 1.0, low=0.0, high=1000.0, text="speed for one volt [rad/(s V)]")
motor.param("time_constant", 0.1, unit="s", low=0.001, high=10.0)
motor.add("lag", FirstOrder(unit="rad/s"), u="u", params={"gain": "gain", "time_constant": "time_constant"})
motor.output("speed", "lag")
structure = Structure(motor, estimate=("gain", "time_constant"))

# A table from anywhere: here a step response with the noise of a cheap tachometer.
generator = np.random.default_rng(1)
time = np.arange(0.0, 2.0, 0.01)
voltage = np.where(time >= 0.2, 6.0, 0.0)
speed = np.where(time >= 0.2, 120.0 * (1.0 - np.exp(-(time - 0.2) / 0.35)), 0.0)
table = {"u": voltage, "speed": speed + generator.normal(0.0, 2.0, time.size)}

found = fit(structure, Record.from_columns(time, table, ["u"], ["speed"], name="step"))
print(found.table())
low, high = found.interval("time_constant")
print(f"time constant {found['time_constant']:.3f} s, 95 % sure between {low:.3f} and {high:.3f} s (true: 0.350)")
