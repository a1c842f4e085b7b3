"""A user's program: flies an experiment and records it, saying what is on the disk, until it is killed.

python -m tests.faults.pilot_child URL FILE
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from twodof.experiment import fly
from twodof.experiment.protocol import EXPERIMENTS
from twodof.gcs.drone import Drone


def main(url: str, file: str) -> None:
    """Prints a line for each look at the flight: what it does last, and how many samples are acknowledged."""
    doing = ""

    with Drone.connect(url, system=250) as drone, drone.record(Path(file)) as recording:

        def tell(text: str, share: float) -> None:
            nonlocal doing
            doing = text or doing
            sys.stdout.write(f"{doing} {recording.acknowledged.samples}\n")
            sys.stdout.flush()

        flight = fly(replace(EXPERIMENTS["attitude-steps"], hold=2.0), drone, progress=tell)
        sys.stdout.write(f"end {flight.reason}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
