"""Session 2: tune the rate loop in flight: set the gains of three designs and compare doublets of the pitch rate."""

import sys
from math import radians

import numpy as np

from twodof.excitation import Doublet
from twodof.fleet import virtual_drone
from twodof.flightlog import numbered
from twodof.gcs import Drone

# Proportional, integral and derivative gain by crossover [rad/s], found by loop shaping on the identified model.
designs = {
    10: {"RATE_KP": 0.02901, "RATE_KI": 0.02789, "RATE_KD": 0.001105},
    30: {"RATE_KP": 0.08535, "RATE_KI": 0.25103, "RATE_KD": 0.000541},
    40: {"RATE_KP": 0.11269, "RATE_KI": 0.44628, "RATE_KD": 0.000268},
}
doublets = Doublet(radians(30.0), 1.0, unit="rad/s", repeat=2, pause=0.5, settle=0.5)

file = numbered("rate.mcap")  # or rate-2.mcap where the session is held again

group = int(sys.argv[1]) if len(sys.argv) > 1 else 1  # its number is the seed of its drone's gusts and noise
with virtual_drone("lab", rings=True, seed=group) as url, Drone.connect(url) as drone, drone.record(file):
    print("crossover  RMS of q0 - q  peak of q  RMS of M")
    for crossover, gains in designs.items():
        drone.parameters.update(gains)  # all of them at one tick, or none
        drone.run(0.5)
        drone.arm()
        drone.level_hold()
        drone.run(5.0)
        with drone.batch(["setpoint.q", "estimate.q", "command.M"]) as rows:
            played = drone.excite(doublets)
        drone.level_hold()
        drone.run(1.0)
        drone.disarm()
        if not played.done:
            print(f"{crossover:9}  {played.reason}")  # the failsafe has stopped it, and says why
            continue
        q0, q, M = rows.values[rows.ticks >= played.start_tick].T.astype(float)
        error, effort = (np.sqrt(np.mean(one**2)) for one in (q0 - q, M - M.mean()))
        print(f"{crossover:9} {np.degrees(error):9.2f} deg/s {np.degrees(q.max()):10.1f} {effort:9.4f}")
    drone.parameters.undo()  # back to the design before the last one
    print("RATE_KP is", drone.parameters["RATE_KP"])
