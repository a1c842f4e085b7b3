"""Fly the paper's three identification experiments on the virtual rig and identify its models from the logs."""

from twodof.experiment import IDENTIFICATION, Laboratory
from twodof.identify import KINDS, cut, fit, identify_pitch, only
from twodof.models import PAPER_VELOCITY_GREYBOX, pitch_rate, rail, thrust_curve

laboratory = Laboratory("paper")
flights = {name: laboratory.fly(experiment, seed=1) for name, experiment in IDENTIFICATION.items()}
for name, flight in flights.items():
    print(f"{name}: " + ", ".join(f"{check.name} ({check.seen})" for check in flight.checks))

# What was applied and what was measured around each excitation, cut out of the logs.
impulse = cut(flights["impulse"].log, KINDS["impulse"], name="impulse")
doublet = cut(flights["doublet"].log, KINDS["doublet"], name="doublet")
velocity = only(cut(flights["velocity-doublet"].log, KINDS["velocity"], name="velocity"), "x")

# 1. By hand, as the paper does: period and settling time, then the doublet's peak and its delay.
print(identify_pitch(impulse, [doublet]).table())

# 2. By output error. The impulse was flown with the rotors off and the doublet in hover: each has its own gain mu.
pitch = fit(pitch_rate(), [impulse, doublet], separate=["mu"])
print(pitch.table())

# 3. The cart, from the gyro to the range sensor, with the thrust curve that the two gains imply.
curve = thrust_curve(pitch["mu[impulse]"], pitch["mu[doublet]"])
moving = fit(rail(thrust=True), velocity, values={"curve": curve})
print(moving.table())

print(f"paper: k_v {PAPER_VELOCITY_GREYBOX.k_v}, p_v {PAPER_VELOCITY_GREYBOX.p_v}; found in 95 %: ", end="")
print("k_v {:.2f} to {:.2f}, p_v {:.2f} to {:.2f}".format(*moving.interval("k_v"), *moving.interval("p_v")))
