"""A user's program: flies an experiment over and over and records it, saying what is on the disk, until it is killed.

python -m tests.faults.pilot_child URL FILE
"""

import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from tests.patience import PATIENCE_S
from twodof.errors import Rejected, Timeout
from twodof.experiment import fly
from twodof.experiment.experiments import EXPERIMENTS
from twodof.gcs.drone import Drone


def main(url: str, file: str) -> None:
    """Prints a line for each look at the flight: what it does last, and how many samples are acknowledged."""
    doing = ""

    with Drone.connect(url, timeout=PATIENCE_S, system=250) as drone, drone.record(Path(file)) as recording:

        def tell(text: str, share: float) -> None:
            nonlocal doing
            doing = text or doing
            sys.stdout.write(f"{doing} {recording.acknowledged.samples}\n")
            sys.stdout.flush()

        while True:  # a flight in which something stood still is broken off
            with suppress(Rejected, Timeout):
                flight = fly(replace(EXPERIMENTS["attitude-steps"], hold=2.0), drone, progress=tell)
                tell(f"ended: {flight.reason},", 1.0)


if __name__ == "__main__":
    main(*sys.argv[1:])
