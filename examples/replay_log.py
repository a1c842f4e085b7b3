"""Feed the inputs of a real flight to the compiled flight code: does it give back what the drone commanded?"""

import sys

from twodof.flight.gains import DEFAULT, STUDENT
from twodof.flightlog import excitations, read_log
from twodof.flightlog.public_data import VARIABLE, available
from twodof.sim.replay import replay

logs = available()
if not logs:
    print(f"no flight logs at hand: set {VARIABLE} to the folder that holds them")
    sys.exit(0)

for name, path in logs.items():
    log = read_log(path)
    gains = STUDENT if "student" in name or "velocity" in name else DEFAULT
    result = replay(log, gains, precision="float32")
    print(f"{name} ({', '.join(found.name for found in excitations(log)) or 'no excitation'})")
    if not result.nrms:
        print("    flown in open loop: nothing to compare")
    for channel, difference in result.nrms.items():
        # RMS of the difference over RMS of the logged signal; a logged float32 is itself only good to 6e-8.
        print(f"    {channel:7} {difference:8.1e}  over {100.0 * result.coverage[channel]:5.1f} % of the flight")
