"""A user's program: flies an experiment and records it, saying what is on the disk, until it is killed.

python -m tests.faults.pilot_child URL FILE EXPERIMENT
"""

from __future__ import annotations

import sys
from pathlib import Path

from twodof.experiment import fly
from twodof.gcs.drone import Drone


def main(url: str, file: str, experiment: str) -> None:
    """Prints a line for each look at the flight: what it does last, and how many samples are acknowledged."""
    doing = ""

    with Drone.connect(url) as drone, drone.record(Path(file)) as recording:

        def tell(text: str, share: float) -> None:
            nonlocal doing
            doing = text or doing
            sys.stdout.write(f"{doing} {recording.acknowledged.samples}\n")
            sys.stdout.flush()

        flight = fly(experiment, drone, progress=tell)
        sys.stdout.write(f"end {flight.reason}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
