"""Session 3: the attitude loop: steps of the pitch by +-10 deg with two gains: rise time, overshoot and peak M."""

import sys
from math import radians

import numpy as np

from twodof.fleet import virtual_drone
from twodof.flightlog import numbered
from twodof.gcs import Drone
from twodof.models import step_figures

STEP = radians(10.0)

file = numbered("attitude.mcap")  # or attitude-2.mcap where the session is held again

group = int(sys.argv[1]) if len(sys.argv) > 1 else 1  # its number is the seed of its drone's gusts and noise
with virtual_drone("lab", rings=True, seed=group) as url, Drone.connect(url) as drone, drone.record(file):
    for gain in (5.0, 11.0):
        drone.parameters["ATT_KP"] = gain
        drone.run(0.5)
        drone.arm()
        drone.set_pitch(0.0)
        drone.run(6.0)
        for goal in (STEP, -STEP):
            before, start = drone.theta, drone.tick
            with drone.batch(["estimate.theta", "command.M"]) as rows:
                drone.set_pitch(goal)
                # What is asked here is asked 50 times a second of the drone's time, on the ground.
                drone.wait_until(lambda goal=goal: abs(drone.theta - goal) < 0.02, timeout=3.0)
                drone.run(2.0)
            drone.set_pitch(0.0)
            drone.run(3.0)
            seen = step_figures((rows.ticks - start) * 0.004, rows.values[:, 0], start=before, final=goal)
            print(f"ATT_KP {gain:4.1f}, to {goal:+.3f} rad: rise {seen.rise_time:.3f} s, ", end="")
            print(f"overshoot {100.0 * seen.overshoot:.1f} %, peak M {np.abs(rows.values[:, 1]).max():.3f}")
        drone.disarm()
