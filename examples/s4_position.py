"""Session 4: the cart is free: velocity and position along the rail with two position gains, recorded; the failsafe."""

import sys

from twodof.fleet import virtual_drone
from twodof.flightlog import numbered, read_log, write_log
from twodof.gcs import Drone
from twodof.models import step_figures

STEP = 0.15

file = numbered("position.mcap")  # or position-2.mcap where the session is held again

group = int(sys.argv[1]) if len(sys.argv) > 1 else 1  # its number is the seed of its drone's gusts and noise
with virtual_drone("lab", seed=group) as url, Drone.connect(url) as drone, drone.record(file) as recording:
    drone.parameters.update({"VEL_KP": 2.4, "VEL_KI": 2.81})  # the paper's design; crossover 4.2 rad/s
    drone.run(0.5)
    drone.arm()
    drone.set_position(0.0)
    drone.run(4.0)

    for v in (0.15, -0.15):
        drone.set_velocity(v)
        drone.run(1.0)
        print(f"v {drone.v:+.3f} m/s, asked for {v:+.3f}")

    for gain in (0.7, 1.5):
        drone.parameters["POS_KP"] = gain  # in flight
        drone.set_position(0.0)
        drone.run(6.0)
        with drone.batch(["estimate.x"]) as rows:
            start, before = drone.tick, drone.x
            drone.set_position(STEP)
            drone.run(6.0)
        new = rows.values[:, 0] == rows.values[:, 0]  # the place is estimated 100 times a second; NaN between
        seen = step_figures((rows.ticks[new] - start) * 0.004, rows.values[new, 0], start=before, final=STEP)
        print(f"POS_KP {gain}: rise {seen.rise_time:.2f} s, overshoot {100.0 * seen.overshoot:.0f} %")

    # A set-point that nobody sends any more: half a second later the drone levels itself, and says why.
    drone.stop_setpoints()
    drone.wait_until(lambda: drone.state.safety.action != "none", timeout=2.0)
    print(drone.state)
    drone.disarm()

print(f"{recording.samples} samples recorded, {recording.lost} lost")
log = read_log(file)
write_log(log, file.with_suffix(".mat"))  # the layout of the drone's own logs, for MATLAB
print(", ".join(log.channels))
for time, severity, text in log.provenance["texts"]:
    print(f"{time:8.3f} s  {severity}: {text}")
