"""One experiment three ways: simulated, flown over MAVLink on a virtual drone, and on the drone at a URL.

python examples/fly_experiment.py                              # simulated, and flown on its own virtual drone
python examples/fly_experiment.py udp://127.0.0.1:14580        # flown there: on `twodof up` or a real drone
"""

import sys

import numpy as np

from twodof.experiment import Flight, Laboratory, fly
from twodof.fleet import virtual_drone
from twodof.gcs import Drone
from twodof.identify import KINDS, cut, fit
from twodof.models import pitch_rate


def told(flight: Flight) -> None:
    """Print the checks, and the estimates of a good flight; a failed flight keeps its samples."""
    for check in flight.checks:
        print(f"  {'ok    ' if check.passed else 'FAILED'} {check.name}: {check.seen}")
    if flight.good:
        found = fit(pitch_rate(), cut(flight.log, KINDS["doublet"]))
        print(f"  mu = {found['mu']:.2f} rad/s2, tau = {1e3 * found['tau']:.2f} ms")


if len(sys.argv) > 1:
    with Drone.connect(sys.argv[1]) as drone:
        told(fly("doublet", drone))
else:
    simulated = Laboratory("paper").fly("doublet", seed=3)
    print("simulated")
    told(simulated)
    with virtual_drone("paper") as url, Drone.connect(url) as drone:
        flown = fly("doublet", drone, seed=3)
    print("flown over MAVLink, in a process of its own")
    told(flown)
    wire = simulated.log["q"].value.astype(np.float32)
    print(f"q differs from the simulation's float32 in {np.sum(flown.log['q'].value != wire)} of {len(wire)} samples")
