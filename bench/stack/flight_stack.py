"""The flight stack as it is used: latency, recording at full rate, eight drones at once, lockstep over MAVLink.

Real time is real here: what a busy machine does to it shows in the figures.
"""

import asyncio
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.measure import Figure
from bench.stack import latency
from bench.stack.programs import START_S, Running, running
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone import Drone

MOST_OF_A_CORE = 0.5
TIMES_REAL_TIME = 20.0  # as PX4 in simulation
DRONES = 8
PERIOD_S = 0.004
PX4 = "PX4 SITL with its default streams: 19-24, quoted, not measured here"


def start_pair(stack: ExitStack, folder: Path, index: int) -> tuple[Running, Running, str]:
    """A flight controller and its companion, and where the companion listens."""
    command = ["fcu", "--index", str(index), "--listen", "tcpin://127.0.0.1:0", "--rings", "--state", f"drone-{index}"]
    fcu = stack.enter_context(running(*command, urls=1, folder=folder))
    command = ["companion", "--index", str(index), "--fcu", outward(fcu), "--onboard", "tcpin://127.0.0.1:0"]
    companion = stack.enter_context(running(*command, urls=1, folder=folder))
    return fcu, companion, outward(companion)


def outward(program: Running) -> str:
    """The URL by which one connects to a program that listens."""
    return program.urls[0].replace("tcpin:", "tcp:")


def recording(seconds: float) -> list[Figure]:
    """All topics at the full rate, through the companion, onto the disk."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        fcu, companion, url = start_pair(stack, folder, 0)
        drone = stack.enter_context(Drone.connect(url))
        drone.run(0.5)  # until all its sensors were heard
        drone.arm()
        drone.level_hold()
        begun = (time.process_time(), fcu.cpu_seconds(), companion.cpu_seconds())
        with drone.record(folder / "flight.mcap") as recorded:
            drone.run(seconds)
        ended = (time.process_time(), fcu.cpu_seconds(), companion.cpu_seconds())
        client, flies, passes = ((b - a) / seconds for a, b in zip(begun, ended, strict=True))
        lost, samples = recorded.lost + sum(recorded.dropped.values()), recorded.samples
    return [
        Figure("recording: samples", samples / seconds, "1/s", remark=f"every topic at full rate for {seconds:g} s"),
        Figure("recording: lost", lost, "samples", 0.0, at_most=True),
        Figure("recording: one core", client + flies + passes, "", MOST_OF_A_CORE, at_most=True, remark="all three:"),
        Figure("- client and recorder", client, ""),
        Figure("- flight controller and rig", flies, ""),
        Figure("- companion", passes, ""),
    ]


async def fly_all(urls: list[str], seconds: float) -> tuple[list[float], int]:
    """Flies all at once by set-points of attitude; the worst lateness [us] of each drone in a second, missed ticks."""
    late = [0.0] * len(urls)
    missed = [0] * len(urls)

    async def fly(number: int, url: str) -> None:
        async with await AsyncDrone.connect(url, timeout=30.0, drone=number + 1) as drone:
            await drone.run(0.5)
            await drone.arm()
            theta, before, end = 0.05, None, time.monotonic() + seconds
            with drone.session.listen("TWODOF_TIMING") as timings:  # one a second
                while time.monotonic() < end:
                    await drone.set_pitch(theta, 0.4)
                    theta = -theta
                    timing = await timings.next(drone.session.now + START_S)
                    if timing is None:
                        raise RuntimeError(f"drone {number + 1} does not say how it keeps its time")
                    if before is None:
                        before = timing.missed
                    else:
                        late[number] = max(late[number], timing.late_worst)
                        missed[number] = timing.missed - before

    await asyncio.gather(*(fly(number, url) for number, url in enumerate(urls)))
    return late, sum(missed)


def many(seconds: float, count: int) -> list[Figure]:
    """`count` drones at once, each with a flight controller, a companion and default streams; one client flies all."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        pairs = [start_pair(stack, Path(name), index) for index in range(count)]
        programs = [program for fcu, companion, _ in pairs for program in (fcu, companion)]
        begun = [program.cpu_seconds() for program in programs]
        cpu, wall = time.process_time(), time.monotonic()
        late, missed = asyncio.run(fly_all([url for _, _, url in pairs], seconds))
        wall = time.monotonic() - wall
        client = (time.process_time() - cpu) / wall
        drones = sum(program.cpu_seconds() for program in programs) - sum(begun)
    return [
        Figure(
            f"{count} drones: periods missed",
            missed,
            "",
            0.0,
            at_most=True,
            remark=f"of {count * seconds / PERIOD_S:.0f}",
        ),
        Figure(f"{count} drones: latest start of a period", max(late), "us"),
        Figure(f"{count} drones: cores of all drones", drones / wall, "", 2.0, at_most=True),
        Figure(f"{count} drones: cores of the one client", client, ""),
    ]


def lockstep(seconds: float) -> list[Figure]:
    """Simulated time over MAVLink, one drone, default streams, set-points at 50 Hz."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        command = ("fcu", "--lockstep", "--listen", "tcpin://127.0.0.1:0", "--rings", "--state", "state")
        fcu = stack.enter_context(running(*command, urls=1, folder=Path(name)))
        drone = stack.enter_context(Drone.connect(outward(fcu)))
        drone.run(1.0)
        drone.arm()
        drone.set_pitch(0.0, 0.4)
        drone.run(1.0)
        begun, cpu, wall = fcu.cpu_seconds(), time.process_time(), time.monotonic()
        drone.run(seconds)
        wall = time.monotonic() - wall
        ticks = seconds / PERIOD_S
        ours, theirs = time.process_time() - cpu, fcu.cpu_seconds() - begun
    return [
        Figure("lockstep over MAVLink", seconds / wall, "x real time", TIMES_REAL_TIME, remark=PX4),
        Figure("- a tick, on the wall", wall / ticks * 1e6, "us"),
        Figure("- a tick, processor of the drone", theirs / ticks * 1e6, "us"),
        Figure("- a tick, processor of the client", ours / ticks * 1e6, "us"),
    ]


def run(quick: bool) -> list[Figure]:
    """All figures of the flight stack; `quick` takes short times and one drone."""
    return [
        *latency.run(quick),
        *recording(1.0 if quick else 60.0),
        *many(2.5 if quick else 20.0, 1 if quick else DRONES),
        *lockstep(2.0 if quick else 60.0),
    ]
