"""Session 4: the cart is free: velocity and position set-points along the rail, recorded; what the failsafe does."""

from twodof.cli.own_drone import own_drone
from twodof.flightlog import read_log, write_log
from twodof.gcs import Drone

with own_drone("lab") as url, Drone.connect(url) as drone, drone.record("position.mcap") as recording:
    drone.run(0.5)
    drone.arm()
    drone.set_position(0.0)
    drone.run(4.0)

    for v in (0.15, -0.15):
        drone.set_velocity(v)
        drone.run(1.0)
        print(f"v {drone.v:+.3f} m/s, asked for {v:+.3f}")

    for x in (-0.15, 0.15, 0.0):
        drone.set_position(x)
        drone.run(5.0)
        print(f"x {drone.x:+.3f} m, asked for {x:+.3f}")

    # A set-point that nobody sends any more: half a second later the drone levels itself, and says why.
    drone.stop_setpoints()
    drone.wait_until(lambda: drone.state.safety.action != "none", timeout=2.0)
    print(drone.state)
    drone.disarm()

print(f"{recording.samples} samples recorded, {recording.lost} lost")
log = read_log("position.mcap")
write_log(log, "position.mat")  # the layout of the drone's own logs, for MATLAB
print(", ".join(log.channels))
for tick, severity, text in log.provenance["texts"]:
    print(f"{tick * 0.004:8.3f} s  {severity}: {text}")
