"""Session 1: a step of the existing controller; then excite the drone, record, and identify the pitch from the logs."""

import sys
from math import radians

from twodof.excitation import Doublet, Impulse
from twodof.fleet import virtual_drone
from twodof.flightlog import numbered, read_log
from twodof.gcs import Drone
from twodof.identify import KINDS, cut, fit, identify_pitch
from twodof.models import pitch_rate, step_figures

# Where the recordings go: impulse.mcap, or impulse-2.mcap where the session is held again.
files = {name: numbered(f"{name}.mcap") for name in ("impulse", "doublet-a", "doublet-b")}

group = int(sys.argv[1]) if len(sys.argv) > 1 else 1  # its number is the seed of its drone's gusts and noise
# A virtual drone of our own. With the real one, or with one of `twodof up`: `with Drone.connect() as drone:`
with virtual_drone("paper", rings=True, seed=group) as url, Drone.connect(url) as drone:
    print(f"{drone.version()}; {drone.state}")

    # The controller that is there: a step of the pitch by 10 degrees.
    drone.run(0.5)
    drone.arm()
    drone.set_pitch(0.0)
    drone.run(6.0)
    with drone.batch(["estimate.theta"]) as rows:
        start, before = drone.tick, drone.theta
        drone.set_pitch(radians(10.0))
        drone.run(3.0)
    drone.disarm()
    seen = step_figures((rows.ticks - start) * 0.004, rows.values[:, 0], start=before, final=radians(10.0))
    print(f"step: rise {seen.rise_time:.3f} s, overshoot {100.0 * seen.overshoot:.1f} %")

    # Experiment 1: at rest, with the rotors standing, M = 0.1 for 0.2 s, then the free response.
    drone.wait_until(lambda: abs(drone.theta) < 0.005 and abs(drone.q) < 0.01, timeout=60.0)
    with drone.record(files["impulse"]):
        drone.run(0.5)
        drone.arm()
        drone.excite(Impulse(0.1, 0.2, lead=0.5, settle=24.0), thrust=0.0)
        drone.disarm()

    # Experiment 2: hold level until the trim moment is found, then a doublet of M about it, played on board. Longer
    # than half a second it would go so near to the stop that the failsafe levels the drone.
    for name in ("doublet-a", "doublet-b"):
        drone.run(1.0)
        drone.wait_until(lambda: abs(drone.theta) < 0.05 and abs(drone.q) < 0.1, timeout=60.0)
        with drone.record(files[name]) as recording:
            drone.arm()
            drone.level_hold()
            drone.run(12.0)
            played = drone.excite(Doublet(0.03, 0.48, lead=0.2, settle=0.4))
            drone.disarm()
        print(f"{name}: {played.state}, {recording.samples} samples, {recording.lost} lost")

kinds = (KINDS["impulse"], KINDS["doublet"], KINDS["doublet"])
impulse, doublet, other = (cut(read_log(files[name]), kind, name=name) for name, kind in zip(files, kinds, strict=True))

# By hand as in the paper, then by output error; the second doublet, which neither has seen, is the judge.
print(identify_pitch(impulse, [doublet]).table())
print("mu[impulse] is of a flight without thrust, mu[doublet-a] of hover, where the same M turns the drone more")
print(fit(pitch_rate(), [impulse, doublet], validation=[other], separate=["mu"]).table())
