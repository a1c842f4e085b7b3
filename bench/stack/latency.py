"""Set-point sent to first motor change: a client's call in one process, the motors' commands in another, one clock."""

import random
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bench.measure import Figure
from bench.stack.drone_process import START_S, DroneProcess
from bench.stack.programs import running
from twodof.gcs.drone import Drone

LATENCY_US = 6_000.0  # one and a half control periods
THRUST = 0.4
MOMENT = 0.004  # around the trim, so that the drone stays near level however long it takes
BETWEEN_S = (0.008, 0.016)  # at any phase of the control period, and never twice in one


def latencies(drone: DroneProcess, url: str, count: int) -> list[float]:
    """As `lateness`, of `count` set-points at random moments."""
    rng = random.Random(1)
    sent: dict[float, int] = {}
    with Drone.connect(url) as pilot:
        pilot.run(0.5)  # a drone that has just been started arms when all its sensors were heard
        pilot.arm()
        pilot.set_moment(0.0, THRUST)
        time.sleep(0.5)
        drone.report()
        for k in range(count):
            moment = float(np.float32((-1) ** k * MOMENT * (1.0 + k / count)))
            sent[moment] = time.monotonic_ns()
            pilot.set_moment(moment, THRUST)
            time.sleep(rng.uniform(*BETWEEN_S))
        changes = until_acted(drone, moment)
    return lateness(sent, changes)


def until_acted(drone: DroneProcess, moment: float) -> list[tuple[int, float]]:
    """Return the notes up to the first change by `moment`. Raises RuntimeError if none comes."""
    changes: list[tuple[int, float]] = []
    end = time.monotonic() + START_S
    while all(asked != moment for _, asked in changes):
        if time.monotonic() > end:
            raise RuntimeError(f"the motors did not follow the last of the set-points within {START_S:g} s")
        time.sleep(0.1)
        changes += drone.report()["changes"]
    return changes


def lateness(sent: dict[float, int], changes: list[tuple[int, float]]) -> list[float]:
    """Microseconds from each of `sent` (moment, when) to the first of `changes` (when, moment) by it, in rising order.

    One that a later one overtook before a control period began is late until that one acts; without either for ever.
    """
    acted: dict[float, int] = {}
    for when, moment in changes:
        acted.setdefault(moment, when)
    found, next_at = [], float("inf")
    for moment, when in reversed(sent.items()):
        next_at = acted.get(moment, next_at)
        found.append((next_at - when) * 1e-3)
    return sorted(found)


def run(quick: bool) -> list[Figure]:
    """Median and 99th percentile, to the flight controller itself and through a companion."""
    count = 50 if quick else 2_500
    figures = []
    with DroneProcess() as drone, TemporaryDirectory() as folder:
        fcu = drone.url.replace("tcpin", "tcp")
        measured = {"direct": latencies(drone, fcu, count)}
        command = ("companion", "--fcu", fcu, "--onboard", "tcpin://127.0.0.1:0")
        with running(*command, urls=1, folder=Path(folder)) as companion:
            measured["through the companion"] = latencies(drone, companion.urls[0].replace("tcpin", "tcp"), count)
        missed = drone.report()["missed"]
    for how, times in measured.items():
        p99 = times[len(times) * 99 // 100]
        figures += [
            Figure(f"set-point to motors, {how}, median", times[len(times) // 2], "us"),
            Figure(
                f"set-point to motors, {how}, p99", p99, "us", LATENCY_US, at_most=True, remark=f"{count} set-points"
            ),
            Figure(f"set-point to motors, {how}, worst", times[-1], "us"),
        ]
    return [*figures, Figure("control periods left out meanwhile", missed, "")]
